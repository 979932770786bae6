"""What an agent can look up of a chip, by the names of its data sheet."""

import pytest

from stage.agents.bus_tools import describe_entry
from stage.chips import HCTL1100, MCX304, PCL240MS
from stage.errors import ArgumentError


@pytest.mark.parametrize(
    ("chip", "name", "parts"),
    [
        (PCL240MS, "R2", ["R2: ", "; 13 bits, ", "1 to 8191"]),
        (PCL240MS, "r13", ["R13: ", "\n  b"]),
        (MCX304, "WR1", ["WR1: ", "\n  b"]),
        (MCX304, "STOP_DEC", ["STOP_DEC 26h: ", "decelerating stop"]),
        (MCX304, "F_DRV_P", ["F_DRV_P 20h: ", "; starts a drive"]),
        (MCX304, "R", ["R: ", "16000 to 8000000", "8000000 after reset", "R 00h: ", "4 bytes of data"]),
        (HCTL1100, "R0F", ["R0F: ", "8 bits"]),
    ],
)
def test_a_register_word_or_command_is_described_with_bits_range_and_evidence(chip, name, parts):
    text = describe_entry(chip.MAP, name)
    for part in parts:
        assert part.lower() in text.lower()
    assert text.split("\n")[0].endswith("]") or "WR" in name


def test_a_name_that_the_chip_does_not_know_is_refused_with_near_ones():
    with pytest.raises(ArgumentError, match=r"PCL240MS register, word or command: .R99. is not known. Known: R0, R1,"):
        describe_entry(PCL240MS.MAP, "R99")
