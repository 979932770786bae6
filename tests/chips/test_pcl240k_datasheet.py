"""The PCL-240K data sheet's formulas, through the bus and the pins alone."""

import math
import time

import numpy as np
import pytest
from support.pcl240k_bench import (
    FOREVER,
    clocks_while,
    commands,
    counter,
    operating,
    pins_clock_by_clock,
    speeds,
    started,
)
from support.programs import load_registers


def exact_ramp_pulses(fl, fh, rate, mult):
    """Pulses of the staircase from FL to FH, rate clocks on each step: its phase over 8192 R7."""
    return rate * sum(range(fl, fh)) / (8192 * mult)


@speeds
def test_tsu_is_fh_minus_fl_times_r4_clocks(fl, fh, up, down, mult):
    chip = started(fl, fh, up, down, mult)
    assert chip.pins.fup
    assert clocks_while(chip, "fup") == (fh - fl) * up
    assert chip.pins.fkeep


@speeds
def test_tsd_is_fh_minus_fl_times_r5_clocks_and_fdown_lasts_so_long(fl, fh, up, down, mult):
    """A ramp-down is the mirror image of a ramp-up: its first step comes at once, its last R5 - 1 clocks before its end."""
    chip = started(fl, fh, up, down, mult)
    chip.advance((fh - fl) * up + 10)
    chip.write(0, 0x14)
    assert chip.pins.fdown
    assert clocks_while(chip, "fdown") == (fh - fl) * down


@speeds
@pytest.mark.parametrize("start", [0x10, 0x11, 0x13])
def test_output_frequency_is_clock_times_speed_over_8192_r7_exactly(fl, fh, up, down, mult, start):
    """In 8192 R7 clocks times 1000 there are Rf times 1000 pulses, neither one more nor one less."""
    chip = started(fl, fh, up, down, mult, start=start, fh2=fh // 2 + 1)
    chip.advance(12345)
    assert chip.advance(8192 * mult * 1000) == {0x10: fl, 0x11: fh, 0x13: fh // 2 + 1}[start] * 1000


@speeds
@pytest.mark.parametrize("start", [0x10, 0x11])
def test_the_first_pulse_begins_after_one_period_rounded_up_to_a_clock(fl, fh, up, down, mult, start):
    chip = started(fl, fh, up, down, mult, start=start)
    first = math.ceil(8192 * mult / (fl if start == 0x10 else fh))
    assert chip.advance(first - 1) == 0
    assert chip.trace(1).tolist() == [(first, 0, 1)]


@pytest.mark.parametrize(("speed", "mult"), [(8191, 2), (4096, 2), (3000, 2), (777, 3), (100, 2)])
def test_each_pulse_is_low_for_half_a_period_within_a_clock_and_high_for_the_other_half(speed, mult):
    chip = started(speed, speed, 2, 2, mult, start=0x10)
    period = 8192 * mult / speed
    low = pins_clock_by_clock(chip, int(40 * period), "pout")[:, 0]
    edges = np.flatnonzero(np.diff(low.astype(int))) + 1
    assert len(edges) >= 70
    assert low[edges[0]], "the first edge falls"
    spans = np.diff(edges)
    assert (np.abs(spans - period / 2) < 1).all(), spans
    assert spans[::2].mean() == pytest.approx(period / 2, abs=1 / 2)


@speeds
def test_a_ramp_up_makes_the_pulses_of_its_staircase_exactly(fl, fh, up, down, mult):
    """Psu = (FH^2 - FL^2) R4 / (16384 R7), less (FH - FL) R4 / (16384 R7) for the steps."""
    chip = started(fl, fh, up, down, mult)
    psu = (fh**2 - fl**2) * up / (16384 * mult)
    pulses = chip.advance((fh - fl) * up)
    assert pulses == math.floor(exact_ramp_pulses(fl, fh, up, mult))
    assert psu - (fh - fl) * up / (16384 * mult) - 1 < pulses <= psu


@speeds
def test_a_ramp_down_makes_the_pulses_of_its_staircase_to_one(fl, fh, up, down, mult):
    """The phase at its start is worth up to one pulse."""
    chip = started(fl, fh, up, down, mult)
    chip.advance((fh - fl) * up + 1000)
    chip.write(0, 0x14)
    chip.advance(1)
    pulses = chip.advance((fh - fl) * down)
    assert 0 <= pulses - math.floor(exact_ramp_pulses(fl, fh, down, mult)) <= 1


@speeds
def test_equal_rates_make_equal_pulse_counts_up_and_down(fl, fh, up, down, mult):
    chip = started(fl, fh, up, up, mult)
    rising = chip.advance((fh - fl) * up)
    chip.advance(8192 * mult)
    chip.write(0, 0x14)
    chip.advance(1)
    assert chip.advance((fh - fl) * up) == pytest.approx(rising, abs=1)


@speeds
def test_r6_of_psd_rounded_up_plus_5_ends_with_at_least_5_pulses_at_fl(fl, fh, up, down, mult):
    """And with hardly more: the steps of the staircase make (FH - FL) R5 / (16384 R7) pulses fewer than Psd."""
    psd, psu = ((fh**2 - fl**2) * rate / (16384 * mult) for rate in (down, up))
    r6 = math.ceil(psd) + 5
    r0 = math.ceil(psu) + r6 + 50
    assert r6 <= 0xFFFFF
    assert r0 <= 0xFFFFFF
    chip = started(fl, fh, up, down, mult, r0=r0, r6=r6, control=0x44)
    clocks_while(chip, lambda chip: not chip.pins.lt)
    assert counter(chip) == r6 - 1, "ramping down starts when R6 is larger than R0"
    assert clocks_while(chip, lambda chip: chip.state["speed"] > fl) == (fh - fl - 1) * down, "from FH all the way down"
    at_fl = counter(chip)
    fewer = (fh - fl) * down / (16384 * mult) + down * fl / (8192 * mult)  # of the staircase; of its last R5 clocks
    assert 5 <= at_fl <= 6 + math.ceil(fewer)
    last = chip.trace(FOREVER)["clock"]
    assert len(last) == at_fl
    assert set(np.diff(last)) <= {8192 * mult // fl, math.ceil(8192 * mult / fl)}, "at FL, and nothing else"


def triangle(fl, fh, up, down, mult):
    """Return the pulse clocks of a preset move with six tenths of the pulses of a full trapezoid, R6 = R0 R5 / (R4 + R5)."""
    r0 = int(0.6 * (fh**2 - fl**2) * (up + down) / (16384 * mult))
    r6 = r0 * down // (up + down)
    if r0 < 20:
        pytest.skip("ramps of a few pulses make no triangle")
    chip = started(fl, fh, up, down, mult, r0=r0, r6=r6, control=0x44)
    clocks = chip.trace(FOREVER)["clock"]
    assert counter(chip) == 0
    assert len(clocks) == r0, "never beyond"
    assert not operating(chip)
    return clocks, r6


@speeds
def test_triangular_drive_peaks_once_below_fh_and_ends_on_its_last_pulse(fl, fh, up, down, mult):
    clocks, r6 = triangle(fl, fh, up, down, mult)
    gaps = np.diff(clocks)
    assert gaps.min() > 8192 * mult / fh - 1, "never faster than FH"
    peak = len(clocks) - r6
    assert (np.diff(gaps[:peak]) <= 1).all(), "only up before the down point (periods round to a clock)"
    assert (np.diff(gaps[peak:]) >= -1).all(), "only down after it"


@speeds
def test_a_triangular_drive_with_equal_rates_is_symmetric(fl, fh, up, down, mult):
    clocks, _ = triangle(fl, fh, up, up, mult)
    gaps = np.diff(clocks)
    half = len(gaps) // 2
    rising, falling = gaps[:half], gaps[::-1][:half]
    delayed = 3 + math.ceil(up * fh / (8192 * mult))  # pulses: the step that the down point cuts short, and the phases
    if half <= 2 * delayed:
        pytest.skip("the steps are longer than the ramps")
    assert (falling[:-delayed] >= rising[delayed:] - 1).all(), "not faster than as many pulses from the start"
    assert (falling[delayed:] <= rising[:-delayed] + 1).all(), "nor slower"


def test_fh_minus_fl_of_nothing_is_a_run_at_fl():
    chip = started(500, 500, 10, 10, 2)
    assert chip.pins.fkeep
    assert chip.advance(8192 * 2 * 10) == 5000


@pytest.mark.parametrize(("mult", "pps_per_step"), [(600, 1), (60, 10), (20, 30)])
def test_at_4_9152_mhz_r7_of_600_60_and_20_are_the_1x_10x_and_30x_modes(mult, pps_per_step):
    chip = started(100, 8191, 2, 2, mult, start=0x11)
    assert chip.advance(4_915_200) == 8191 * pps_per_step


def test_the_maximum_preset_move_advances_in_milliseconds():
    def seconds(r0):
        chip = started(50, 8000, 300, 300, 2, r0=r0, r6=120_000, control=0x44)
        begin = time.perf_counter()
        assert chip.advance(FOREVER) == r0
        return time.perf_counter() - begin

    seconds(1000)
    assert min(seconds(16_777_215) for _ in range(3)) < 0.02


def test_the_counter_wraps_below_zero_to_the_maximum():
    chip = started(500, 800, 30, 30, 2, r0=1, start=0x11)
    observed = [counter(chip)]
    for _ in range(3):
        assert len(chip.trace(clocks_to_next_pulse(chip))) == 1
        observed.append(counter(chip))
    assert observed == [1, 0, 0xFFFFFF, 0xFFFFFE]


def clocks_to_next_pulse(chip):
    state = chip.snapshot()
    clock, ahead = chip.clock, chip.trace(8192 * 2)["clock"][0]
    chip.restore(state)
    return int(ahead - clock)


def test_r6_above_r0_before_the_start_means_no_ramp_up():
    chip = started(50, 800, 30, 30, 2, r0=20, r6=21, control=0x44)
    assert chip.pins.lt
    assert chip.pins.fkeep
    gaps = np.diff(chip.trace(FOREVER)["clock"])
    assert len(gaps) == 19
    assert set(gaps) <= {327, 328}, "FL speed is effective: 16384 / 50 clocks"
    level = started(50, 800, 30, 30, 2, r0=21, r6=21, control=0x44)
    assert level.pins.fup, "R6 = R0 is not larger"


def test_speed_values_written_in_succession_accelerate_in_any_curve():
    """Q&A: rewrite the selected register during the ramp."""
    chip = started(50, 100, 30, 30, 2)
    for fh in (100, 180, 300, 450):
        load_registers(chip, R2=fh)
        clocks_while(chip, "fup")
        assert chip.pins.fkeep
    chip.write(0, 0x11)
    chip.advance(1)
    assert chip.advance(8192 * 2 * 10) == 4500


def test_commands_by_their_bytes_choose_the_speed_of_their_register():
    rates = {}
    for start in (0x10, 0x11, 0x13, 0x12, 0x14, 0x15, 0x17, 0x16):
        chip = started(50, 400, 5, 5, 2, fh2=900, start=start)
        chip.advance(10_000)
        rates[start] = chip.advance(8192 * 2 * 4) / 4
        commands(chip, 0x08)
    assert rates == {0x10: 50, 0x11: 400, 0x13: 900, 0x12: 50, 0x14: 50, 0x15: 400, 0x17: 900, 0x16: 50}
