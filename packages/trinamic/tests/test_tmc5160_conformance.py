"""The TMC5160 keeps what every chip promises, and turns as the example of its data sheet says; runs without a checkout."""

from pulsestage_trinamic.tmc5160 import TMC5160
from stage.testing import chip_conformance

test_conformance = chip_conformance.tests(TMC5160, programs=2)


def test_a_turn_to_the_left():
    chip = TMC5160()
    for datagram in (
        "A4000003E8", "A50000C350", "A6000001F4", "A700030D40", "A8000002BC", "AA00000578", "AB0000000A", "A000000000",
        "ADFFFF3800",
    ):  # fmt: skip
        chip.transfer(bytes.fromhex(datagram))
    chip.advance(20_846_721)
    assert (chip.values()["XACTUAL"], chip.busy()) == (-51_200, False)
