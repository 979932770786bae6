"""Origin return of the PCL-240MK and PCL-240MS: ORG alone, and EZ edges counted after it (spec section 8)."""

import numpy as np
import pytest
from support.pcl240k_bench import FOREVER, clocks_while, commands, operating
from support.pcl240ms_bench import LINEAR, load
from support.pcl240ms_hands import begun, read_back, wait_for

from stage.chips import PCL240MK, PCL240MS

BOTH = pytest.mark.parametrize("make", [PCL240MK, PCL240MS])
STARTS = pytest.mark.parametrize("start", [0x10, 0x11, 0x15], ids=["FL", "FH", "ramp to FH"])
USES_EZ, FROM_FL, ORG_POSITIVE = 1 << 21, 1 << 20, 1 << 23  # bits of R13
EZ_POSITIVE = 1 << 12  # of R12
FL_PERIOD, FH_PERIOD = 8192 * 2 / 50, 8192 * 2 / 800


def returning(make, start=0x15, count=0, bits=USES_EZ, control=0x41, **registers):
    """Start an origin return, and let its ramp pass if it has one."""
    chip = begun(make, control, start, R13=bits | count << 16, **registers)
    chip.advance(30_000)
    return chip


def edge(chip):
    """Make one EZ pulse of some clocks, and return whether the chip still operates."""
    chip.pins.ez = True
    chip.advance(3)
    chip.pins.ez = False
    chip.advance(200)  # a pulse in progress is completed by then
    return operating(chip)


def edges_to_stop(chip):
    for n in range(1, 40):
        if not edge(chip):
            return n
    raise AssertionError("EZ edges do not stop it")


def count(chip):
    return read_back(chip, "R17") >> 16 & 15


def period(chip):
    """Return the mean number of clocks from pulse to pulse."""
    return np.diff(chip.trace(20_000)["clock"]).mean()


@BOTH
@STARTS
@pytest.mark.parametrize("timing", [0, FROM_FL], ids=["from ORG", "from FL"])
@pytest.mark.parametrize("n", range(16))
def test_a_count_of_n_stops_at_the_n_plus_first_edge(make, start, timing, n):
    chip = returning(make, start, n, USES_EZ | timing)
    chip.pins.org = True
    chip.advance(100_000)
    assert operating(chip)
    assert edges_to_stop(chip) == n + 1
    assert chip.pins.hold


@BOTH
def test_the_run_stops_in_the_clock_of_the_edge_and_completes_its_pulse(make):
    chip = returning(make, 0x11, 1)
    chip.pins.org = True
    edge(chip)
    clocks_while(chip, lambda chip: not chip.pins.pout)
    chip.pins.ez = True
    assert clocks_while(chip, "pout") == 11
    assert chip.pins.hold
    chip = returning(make, 0x11, 0)
    chip.pins.org = True
    clocks_while(chip, lambda chip: not chip.pins.pout)
    clocks_while(chip, "pout")
    chip.pins.ez = True
    chip.advance(1)
    assert chip.pins.hold, "no pulse, nothing to complete"


@BOTH
@STARTS
def test_edges_before_org_do_not_count(make, start):
    chip = returning(make, start, 2)
    for _ in range(20):
        assert edge(chip)
    chip.pins.org = True
    chip.advance(100_000)
    assert edges_to_stop(chip) == 3


@BOTH
def test_a_level_is_no_edge(make):
    chip = returning(make, 0x10, 0)
    chip.pins.ez = True
    chip.advance(10)
    chip.pins.org = True
    chip.advance(10_000)
    assert operating(chip), "asserted before ORG, and ever since"
    chip.pins.ez = False
    chip.advance(1000)
    assert operating(chip), "the other edge"
    assert not edge(chip)


@BOTH
def test_with_timing_0_edges_count_from_org_on_while_it_still_ramps_down(make):
    chip = returning(make, 0x15, 3)
    chip.pins.org = True
    chip.advance(10)
    assert chip.pins.fdown
    assert edges_to_stop(chip) == 4
    assert chip.clock < 32_000, "far above FL"


@BOTH
def test_with_timing_1_edges_count_from_reaching_fl_on(make):
    chip = returning(make, 0x15, 3, USES_EZ | FROM_FL)
    chip.pins.org = True
    chip.advance(10)
    for _ in range(20):
        assert edge(chip)
        assert chip.pins.fdown
    clocks_while(chip, "fdown")
    chip.advance(1)
    assert edges_to_stop(chip) == 4


@BOTH
@pytest.mark.parametrize("start", [0x10, 0x11])
def test_reaching_fl_is_met_at_once_in_a_constant_speed_run_which_keeps_its_speed(make, start):
    chip = returning(make, start, 3, USES_EZ | FROM_FL)
    chip.pins.org = True
    chip.advance(1)
    assert period(chip) == pytest.approx(FL_PERIOD if start == 0x10 else FH_PERIOD, rel=0.01)
    assert edges_to_stop(chip) == 4
    chip = returning(make, start, 3, USES_EZ | FROM_FL)
    chip.pins.org = True
    chip.advance(1)
    assert edges_to_stop(chip) == 4


@BOTH
@pytest.mark.parametrize("clocks", [1, 5000, FOREVER])
def test_a_high_speed_run_ramps_down_to_fl_after_org_even_if_org_lets_go(make, clocks):
    chip = returning(make, 0x15, 1, R14=LINEAR)
    assert chip.pins.fkeep
    begin = chip.clock
    chip.pins.org = True
    if clocks < FOREVER:
        chip.advance(clocks)
        chip.pins.org = False
    wait_for(chip, "fdown")
    clocks_while(chip, "fdown")
    assert chip.clock - begin == pytest.approx(750 * 30, abs=2)
    assert period(chip) == pytest.approx(FL_PERIOD, rel=0.01)
    chip.advance(1_000_000)
    assert period(chip) == pytest.approx(FL_PERIOD, rel=0.01), "for the whole run"
    assert edges_to_stop(chip) == 2


@BOTH
def test_org_during_the_ramp_up_begins_a_ramp_down(make):
    chip = begun(make, 0x41, 0x15, R13=USES_EZ)
    chip.advance(9000)
    assert chip.pins.fup
    chip.pins.org = True
    chip.advance(1)
    assert chip.pins.fdown
    clocks_while(chip, "fdown")
    assert period(chip) == pytest.approx(FL_PERIOD, rel=0.01)


@BOTH
def test_the_next_run_has_forgotten_org(make):
    chip = returning(make, 0x15, 5)
    chip.pins.org = True
    chip.advance(50_000)
    edge(chip)
    edge(chip)
    chip.pins.org = False
    commands(chip, 0x08)
    chip.advance(200)
    commands(chip, 0x15)
    clocks_while(chip, "fup")
    assert period(chip) == pytest.approx(FH_PERIOD, rel=0.01)
    assert edge(chip), "no ORG, no counting"
    chip.pins.org = True
    chip.advance(50_000)
    assert edges_to_stop(chip) == 6, "a count that was begun does not carry over"


@BOTH
@STARTS
@pytest.mark.parametrize("bits", [0, FROM_FL], ids=["b20 = 0", "b20 = 1"])
def test_without_r13_bit_21_org_stops_at_once(make, start, bits):
    chip = returning(make, start, 3, bits)
    for _ in range(5):
        assert edge(chip)
    chip.pins.org = True
    chip.advance(1)
    assert chip.advance(100_000) == 0
    assert chip.pins.hold


@BOTH
@STARTS
def test_neither_org_nor_ez_means_anything_outside_an_origin_return(make, start):
    chip, quiet = (returning(make, start, 0, control=0x40) for _ in range(2))
    chip.pins.org = True
    for _ in range(5):
        assert edge(chip)
    quiet.advance(chip.clock - quiet.clock)
    assert (chip.trace(30_000) == quiet.trace(30_000)).all()


@BOTH
@STARTS
@pytest.mark.parametrize(("control", "limit", "other"), [(0x41, "el_plus", "el_minus"), (0x49, "el_minus", "el_plus")])
@pytest.mark.parametrize("org", [False, True], ids=["before ORG", "after ORG"])
def test_the_end_limit_still_stops(make, start, control, limit, other, org):
    chip = returning(make, start, 3, control=control)
    chip.pins.org = org
    chip.advance(500)
    setattr(chip.pins, other, True)
    chip.advance(500)
    assert operating(chip)
    setattr(chip.pins, limit, True)
    chip.advance(1)
    assert chip.advance(100_000) == 0
    assert chip.pins.hold


@BOTH
def test_reset_command_and_decelerating_stop_still_stop(make):
    for command in (0x08, 0x1D):
        chip = returning(make, 0x15, 3)
        chip.pins.org = True
        chip.advance(1000)
        commands(chip, command)
        chip.advance(100_000)
        assert chip.pins.hold


@BOTH
def test_int_comes_at_the_stop_and_the_position_counter_counts_to_the_last_pulse(make):
    chip = begun(make, 0x69, 0x35, R13=USES_EZ | 2 << 16)
    pulses = chip.advance(30_000)
    chip.pins.org = True
    for last in (False, False, True):
        pulses += chip.advance(20_000)
        assert not chip.pins.irq
        chip.pins.ez = True
        pulses += chip.advance(200)
        assert chip.pins.irq == last
        chip.pins.ez = False
    assert read_back(chip, "R10") == -pulses & 0xFFFFFF


@BOTH
def test_status_bit_1_shows_org(make):
    chip = returning(make)
    assert not chip.read(0) & 0x02
    chip.pins.org = True
    assert chip.read(0) & 0x02


# The monitor, R17: bits 20 to 16 "are added" with the MS


def test_r17_of_the_mk_monitors_nothing():
    """PCL240MK, R13 = 0F0000h, EZ asserted: R17 reads 0, at rest, in a return and as EZ counts"""
    chip = begun(PCL240MK, 0x41, 0x08, R13=USES_EZ | 15 << 16)
    chip.pins.ez = True
    assert read_back(chip, "R17") == chip.values()["R17"] == 0
    commands(chip, 0x15)
    chip.pins.org = True
    chip.advance(30_000)
    for _ in range(3):
        assert edge(chip)
        chip.pins.ez = True
        chip.advance(3)
        assert read_back(chip, "R17") == chip.values()["R17"] == 0
        chip.pins.ez = False
    load(chip, R17=0xFFFFFF)
    assert read_back(chip, "R17") == 0xE0FFFF, "the other bits store what is written"


@pytest.mark.parametrize("n", [0, 1, 7, 15])
def test_r17_counts_down_from_r13_with_every_edge_and_reloads_at_the_stop(n):
    chip = begun(PCL240MS, 0x41, 0x08, R13=USES_EZ | n << 16)
    assert count(chip) == n, "at rest"
    commands(chip, 0x15)
    chip.advance(30_000)
    edge(chip)
    assert count(chip) == n, "before ORG"
    chip.pins.org = True
    chip.advance(30_000)
    assert count(chip) == n, "before the first counted edge"
    for left in range(n - 1, -1, -1):
        assert edge(chip)
        assert count(chip) == left
    assert not edge(chip)
    assert count(chip) == n, "back to what R13 sets"


def test_r17_follows_r13_at_rest():
    chip = PCL240MS()
    for n in (0, 5, 15, 1):
        load(chip, R13=n << 16)
        assert count(chip) == n


def test_r17_bit_20_shows_ez_as_r12_bit_12_reads_its_pin():
    """The pin that nobody drives is high: with positive logic that is asserted."""
    for polarity in (0, EZ_POSITIVE):
        chip = PCL240MS()
        load(chip, R12=polarity)
        for level in (False, True, False):
            chip.pins.ez = level
            assert bool(read_back(chip, "R17") & 1 << 20) == (level != bool(polarity))
        assert read_back(chip, "R12") == polarity


@BOTH
@pytest.mark.parametrize("polarity", [0, EZ_POSITIVE])
def test_the_polarity_of_ez_chooses_which_edge_of_its_pin_counts(make, polarity):
    chip = make()
    chip.pins.ez = bool(polarity)  # not asserted, as it is read
    load(chip, R1=50, R2=800, R4=30, R5=30, R7=2, R13=USES_EZ | 1 << 16, R12=polarity)
    commands(chip, 0x41, 0x10)
    chip.pins.org = True
    chip.advance(30_000)
    for left in (0, None):
        chip.pins.ez = not polarity
        chip.advance(10)
        chip.pins.ez = bool(polarity)
        chip.advance(1000)
        assert operating(chip) == (left is not None)
        assert left is None or make is PCL240MK or count(chip) == left


def test_a_chip_with_inverted_org_logic_starts_no_origin_return():
    chip = begun(PCL240MS, 0x41, 0x08, R13=ORG_POSITIVE)
    assert chip.read(0) & 0x02, "nobody drives the pin"
    commands(chip, 0x15)
    assert chip.advance(100_000) == 0
    assert "ORG" in chip.diagnostics[-1].message
    chip.pins.org = True
    assert not chip.read(0) & 0x02
    commands(chip, 0x15)
    assert chip.advance(20_000) > 0
    chip.pins.org = False
    chip.advance(1)
    assert not chip.advance(10_000)
    assert chip.pins.hold


def test_with_the_logic_of_its_sensor_a_return_ends_at_the_same_clock():
    ends = []
    for bits in (0, ORG_POSITIVE):
        chip = begun(PCL240MS, 0x41, 0x08, R13=bits)
        chip.pins.org = bool(bits)
        commands(chip, 0x15)
        chip.advance(30_000)
        chip.pins.org = not bits
        ends.append((clocks_while(chip, operating), chip.values()["R0"]))
    assert ends[0] == ends[1]


def test_the_org_polarity_of_the_mk_is_fixed_as_0():
    chip = PCL240MK()
    load(chip, R13=0xFFFFFF)
    assert read_back(chip, "R13") & ORG_POSITIVE == 0
