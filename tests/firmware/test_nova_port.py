"""`ChipPort` of a NOVA chip: mode words and their bits."""

import pytest

from stage import ArgumentError
from stage.chips import MCX304, MCX514
from stage.firmware import Bench
from stage.firmware.nova.chip_port import ChipPort


@pytest.mark.parametrize("chip", [MCX304, MCX514])
def test_bits_of_a_mode_word_are_set_and_cleared_and_the_others_stay(chip):
    """port.set_mode_bits("WR2", 0x0003); port.set_mode_bits("WR2", 0x0001, False)"""
    port = ChipPort(Bench(chip()).axes["x"])

    journal = port.chip.journal()
    port.write_mode_words(WR2=0x0010)
    port.set_mode_bits("WR2", 0x0003)
    port.set_mode_bits("WR2", 0x0001, False)
    assert [e.b for e in journal.entries if e.a == 2] == [0x0010, 0x0013, 0x0012]
    with pytest.raises(ArgumentError, match="WR9 is no mode word"):
        port.write_mode_words(WR9=1)
