"""PCL-240MK and MS: the automatic ramp-down point, statement by statement (data sheet 3-4, 3-5)."""

import numpy as np
import pytest
from support.pcl240k_bench import FOREVER, clocks_while, commands, counter, operating
from support.pcl240ms_bench import AUTOMATIC, LINEAR, NO_CORRECTION, load
from support.pcl240ms_hands import (
    AT_FH,
    AT_FL,
    BITS,
    BOTH,
    NAMES,
    PLAIN,
    SWITCH_OFF,
    begun,
    last_gaps,
    select,
    wait_for,
)

from stage.chips import PCL240MK, PCL240MS

# Automatic ramp-down point


@BOTH
@pytest.mark.parametrize("rates", [(30, 30), (30, 300), (300, 30), (30, 2)], ids=str)
def test_the_automatic_point_decelerates_on_r4_and_leaves_r5_alone(make, rates):
    up, down = rates
    r0 = 1000 * up
    chip = begun(make, AUTOMATIC, 0x15, R0=r0, R4=up, R5=down, R6=10)
    same = begun(make, AUTOMATIC, 0x15, R0=r0, R4=up, R5=up, R6=10)
    assert (chip.trace(FOREVER) == same.trace(FOREVER)).all()
    assert not operating(chip)


def test_the_automatic_ramp_down_of_the_mk_is_linear_with_r4():
    chip = begun(PCL240MK, AUTOMATIC, 0x15, R0=3000, R4=30, R5=77, R6=10)
    assert clocks_while(chip, "fup") == 750 * 30
    wait_for(chip, "fdown")
    assert clocks_while(chip, "fdown") == 750 * 30 - 1, "its first clock is gone: the pulse at the point was in it"
    assert 8 <= counter(chip) <= 12, "R6 = 10 pulses early"


@BOTH
def test_a_deceleration_before_the_automatic_point_is_on_r5(make):
    chip = begun(make, AUTOMATIC, 0x15, R0=50_000, R4=30, R5=77, R14=LINEAR)
    clocks_while(chip, "fup")
    chip.write(0, 0x14)
    assert clocks_while(chip, "fdown") == 750 * 77


@BOTH
def test_r6_is_an_offset_positive_earlier_negative_later(make):
    points = []
    for offset in (200, 0, -200):
        chip = begun(make, AUTOMATIC, 0x15, R0=3000, R6=offset & 0xFFFFFF)
        clocks_while(chip, "fup")
        wait_for(chip, "fdown")
        points.append(counter(chip))
        assert chip.advance(FOREVER) == points[-1]
    assert np.diff(points).tolist() == [-200, -200]


@BOTH
def test_r6_reaches_from_the_most_negative_to_the_most_positive_offset(make):
    sign = 1 << BITS[make]["R6"] - 1
    never = begun(make, AUTOMATIC, 0x15, R0=3000, R6=sign)
    assert set(last_gaps(never)) <= set(AT_FH)
    at_once = begun(make, AUTOMATIC, 0x15, R0=3000, R6=sign - 1)
    assert set(np.diff(at_once.trace(FOREVER)["clock"])) == set(AT_FL), "no ramp-up at all"


@BOTH
def test_a_ramp_up_after_sd_adds_to_the_count_of_the_automatic_point(make):
    chip = begun(make, AUTOMATIC | 0x02, 0x15, R0=5000, R14=LINEAR)
    rising = chip.advance(750 * 30)
    chip.pins.sd_plus = True
    chip.advance(750 * 30)
    chip.pins.sd_plus = False
    rising += chip.advance(750 * 30)
    assert rising > 1000
    wait_for(chip, "fdown")
    assert counter(chip) == pytest.approx(rising, abs=2)


@pytest.mark.parametrize("r14", [0, LINEAR, 100], ids=["S-curve", "linear", "with a linear part"])
def test_the_fh_correction_makes_no_triangle_and_changes_no_register(r14):
    """A triangle goes from FUP to FDOWN; corrected, the chip keeps its top speed for some clocks."""
    for bits, kept_at_top in ((0, True), (NO_CORRECTION, False)):
        chip = begun(PCL240MS, AUTOMATIC, 0x15, R0=700, R14=r14 | bits, R15=r14 & 0xFFF)
        before = [chip.values()[name] for name in NAMES[1:]]
        journal = chip.journal()
        chip.advance(FOREVER)
        assert [chip.values()[name] for name in NAMES[1:]] == before
        waveforms = journal.replay_waveforms()
        speed = waveforms.edges["speed"]
        assert 400 < speed.max() < 800
        assert (waveforms.pin("fkeep") & (speed == speed.max())).any() == kept_at_top


@BOTH
def test_without_the_automatic_point_r6_is_the_point_itself(make):
    chip = begun(make, PLAIN, 0x15, R0=3000, R6=700)
    clocks_while(chip, lambda chip: not chip.pins.lt)
    assert counter(chip) == 699
    assert chip.pins.fdown
    assert set(last_gaps(chip)) <= set(AT_FL)


@BOTH
@pytest.mark.parametrize("when", [5000, 40_000], ids=["ramping up", "at FH"])
@pytest.mark.parametrize("name", NAMES)
def test_r1_r4_r5_r14_r15_written_in_motion_disable_the_automatic_point_and_no_other_register_does(make, name, when):
    """Written with the value that it holds already, collectively, so that nothing but the writing can act."""
    chip, undisturbed = (begun(make, AUTOMATIC, 0x15, R0=4000) for _ in range(2))
    chip.advance(when)
    value = chip.values()[name]
    chip.write(0, select(name) | 0x20)
    for address in (3, 2, 1):
        chip.write(address, value >> 8 * (address - 1) & 0xFF)
    undisturbed.advance(when)
    rest, usual = (c.trace(FOREVER)["clock"] for c in (chip, undisturbed))
    assert len(rest) == len(usual)
    if name in SWITCH_OFF:
        assert set(np.diff(rest[-5:])) <= set(AT_FH)
    else:
        assert (rest == usual).all()
    load(chip, R0=4000)
    begin = chip.clock
    commands(chip, 0x08, 0x15)
    fresh = begun(make, AUTOMATIC, 0x15, R0=4000)
    assert (chip.trace(FOREVER)["clock"] - begin == fresh.trace(FOREVER)["clock"]).all(), "the next run has it again"


@BOTH
@pytest.mark.parametrize("name", SWITCH_OFF)
def test_when_it_is_disabled_the_rule_r0_below_r6_is_back_and_the_deceleration_is_on_r5(make, name):
    chip = begun(make, AUTOMATIC, 0x15, R0=4000, R4=30, R5=40, R6=900, R14=LINEAR)
    chip.advance(5000)
    load(chip, **{name: chip.values()[name]})
    clocks_while(chip, "fup")
    wait_for(chip, "fdown")
    assert counter(chip) == 899
    assert clocks_while(chip, "fdown") == 750 * 40 - 1


@BOTH
@pytest.mark.parametrize("name", SWITCH_OFF)
def test_a_deceleration_in_progress_continues(make, name):
    chip, undisturbed = (begun(make, AUTOMATIC, 0x15, R0=4000) for _ in range(2))
    wait_for(chip, "fdown")
    chip.advance(3000)
    undisturbed.advance(chip.clock)
    load(chip, **{name: chip.values()[name]})
    assert (chip.trace(FOREVER) == undisturbed.trace(FOREVER)).all()
    assert chip.clock == undisturbed.clock


@BOTH
def test_registers_written_at_rest_disable_nothing(make):
    chip, undisturbed = (begun(make, AUTOMATIC, 0x08, R0=4000) for _ in range(2))
    load(chip, **{name: chip.values()[name] for name in SWITCH_OFF})
    for c in (chip, undisturbed):
        c.write(0, 0x15)
    assert (chip.trace(FOREVER) == undisturbed.trace(FOREVER)).all()
