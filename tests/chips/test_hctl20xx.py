"""HCTL-20xx: counters that a host reads byte by byte, which never tear."""

import pytest

from stage import ArgumentError
from stage.chips import HCTL1100
from stage.chips.hctl20xx import HCTL2000, HCTL2016, HCTL2017, HCTL2020, HCTL2021, HCTL2022, HCTL2032

TWO_BYTES = (HCTL2000, HCTL2016, HCTL2017, HCTL2020, HCTL2021)


class Shaft:
    """An encoder that shows what it is told."""

    def __init__(self, count=0):
        self.count = count

    def __call__(self):
        return self.count


@pytest.mark.parametrize("cls", TWO_BYTES)
def test_the_count_is_that_of_the_encoder_in_so_many_bits(cls):
    shaft = Shaft(77)
    counter = cls(shaft)
    assert counter.count() == 0, "it starts at 0 wherever the shaft is"
    for count in (78, 76, 77 + 0x0ABC, 77 - 1, 77 + 70_000):
        shaft.count = count
        assert counter.count() == (count - 77) % (1 << cls.BITS)


@pytest.mark.parametrize("cls", TWO_BYTES)
def test_bytes_read_high_first_belong_together_while_the_shaft_turns(cls):
    shaft = Shaft()
    counter = cls(shaft)
    shaft.count = 0x01FF
    counter.sel, counter.oe = 0, True
    assert counter.data == 0x01
    shaft.count = 0x0200
    counter.sel = 1
    assert counter.data == 0xFF, "latched"
    counter.sel = 0
    assert counter.data == 0x01, "still latched"
    counter.oe = False
    assert counter.data is None
    counter.oe = True
    assert counter.data == 0x02, "latched anew"


def test_the_low_byte_alone_is_not_latched():
    shaft = Shaft()
    counter = HCTL2016(shaft)
    counter.sel, counter.oe = 1, True
    shaft.count = 5
    assert counter.data == 5
    shaft.count = 6
    assert counter.data == 6


def test_the_high_byte_latches_when_it_is_selected_while_the_outputs_are_on():
    shaft = Shaft(0x0101)
    counter = HCTL2016(shaft)
    shaft.count = 0x0202 + 0x0101
    counter.sel, counter.oe = 1, True
    counter.sel = 0
    shaft.count = 0
    assert counter.data == 0x02
    counter.sel = 1
    assert counter.data == 0x02


def test_of_four_bytes_the_highest_alone_latches():
    shaft = Shaft()
    counter = HCTL2022(shaft)
    counter.select, counter.oe = (1, 0), True
    for shaft.count in (5, 6):
        assert counter.data == shaft.count
    counter.select = (0, 1)
    shaft.count = 0x01020304
    counter.select = (1, 0)
    assert counter.data == 6


@pytest.mark.parametrize("cls", [*TWO_BYTES, HCTL2022])
def test_rst_clears(cls):
    shaft = Shaft()
    counter = cls(shaft)
    shaft.count = 9
    counter.reset()
    assert counter.count() == 0
    shaft.count = 12
    assert counter.count() == 3


@pytest.mark.parametrize("cls", [HCTL2020, HCTL2021])
def test_the_cascade_says_how_often_the_count_went_over_its_end(cls):
    shaft = Shaft()
    counter = cls(shaft)
    for count, cascade in ((65_535, 0), (65_536, 1), (65_535, 0), (-1, -1), (200_000, 3)):
        shaft.count = count
        assert counter.cascade == cascade
        assert counter.cascade << 16 | counter.count() == count


@pytest.mark.parametrize(("mode", "divisor"), [((1, 0), 1), ((0, 1), 2), ((1, 1), 4)])
def test_count_modes_are_x4_x2_x1(mode, divisor):
    shaft = Shaft()
    counter = HCTL2022(shaft, mode)
    for count in (0, 1, 2, 3, 4, 100_003, -1, -4, -5):
        shaft.count = count
        assert counter.count() == count // divisor % (1 << 32)


def test_an_illegal_count_mode_is_refused():
    for mode in ((0, 0), (2, 1)):
        with pytest.raises(ArgumentError, match=r"\(0, 0\) is illegal"):
            HCTL2022(Shaft(), mode)


def test_each_byte_of_32_bits_has_its_select_levels_and_all_are_latched():
    shaft = Shaft()
    counter = HCTL2022(shaft)
    shaft.count = 0x12345678
    counter.select, counter.oe = (0, 1), True
    assert counter.data == 0x12
    shaft.count = -1
    for levels, byte in (((1, 1), 0x34), ((0, 0), 0x56), ((1, 0), 0x78)):
        counter.select = levels
        assert counter.data == byte
    counter.oe = False
    assert counter.data is None
    assert counter.count() == 0xFFFFFFFF


def test_the_two_counters_of_the_2032_are_chosen_by_xy_and_reset_apart():
    x, y = Shaft(), Shaft()
    counter = HCTL2032(x, y, (0, 1))
    x.count, y.count = 1000, -6
    assert counter.count() == 500
    counter.xy = 1
    assert counter.count() == 0xFFFFFFFD
    counter.reset(1)
    assert counter.count() == 0
    counter.xy = 0
    assert counter.count() == 500
    counter.reset()
    assert counter.count() == 0


def test_a_counter_reads_the_encoder_of_a_chip():
    chip = HCTL1100()
    counter = HCTL2016(lambda: chip.encoder)
    chip.see(0, 0.125)
    chip.advance(800)
    assert counter.count() == 100
    low = chip.read(0x14)
    assert chip.read(0x13) << 8 | low == 100
