"""Section 3 of the MK/MS data sheet: its formulas and examples, against what the chip does through the bus and the pins."""

import math

import numpy as np
import pytest
from support.pcl240k_bench import SEED, clocks_while
from support.pcl240ms_bench import (
    LINEAR,
    NO_CORRECTION,
    RecordedMove,
    Registers,
    automatic,
    corrected_r2,
    minimum_linear,
    minimum_trapezoid,
    minimum_trapezoid_with_linear,
    r6,
    r6_with_linear,
    random_registers,
    revised_r2,
    revised_r2_with_linear,
    span_of,
    started,
    step_clocks,
    tsd,
    tsd_with_linear,
    tsu,
    tsu_with_linear,
)

from stage.chips import PCL240MK, PCL240MS

CONTINUOUS, PRESET = 0x40, 0x44
CLOCK_HZ = 4_915_200
LONG = 1 << 33  # clocks; longer than any ramp
RNG = np.random.default_rng(SEED)
CURVED = [Registers(50, 800, 300, 200, 20), Registers(25, 500, 65535, 701, 30, 238, 4000), Registers(1, 8191, 2, 3, 2)]
WITH_LINEAR = [
    Registers(50, 800, 300, 200, 20, 100, 250),
    Registers(25, 500, 1500, 2500, 30, 60, 60),
    Registers(7, 8191, 3, 2, 2, 4000, 1),
]


def over(cases, linear, count=6):
    """Parametrize a test by the cases and by random legal registers."""
    chosen = [pytest.param(random_registers(RNG, linear), id=f"random{n}") for n in range(count)]
    return pytest.mark.parametrize("r", [*cases, *chosen])


curved, with_linear = over(CURVED, False), over(WITH_LINEAR, True)
any_shape = over([*CURVED, *WITH_LINEAR], False, 3)


@pytest.fixture(autouse=True)
def report(request):
    print(request.node.callspec.params if hasattr(request.node, "callspec") else "", f"PULSESTAGE_SEED={SEED}")


# 3-3 acceleration and deceleration time


@curved
def test_tsu_with_no_linear_part(r):
    assert clocks_while(started(r, control=CONTINUOUS), "fup") == tsu(r)


@with_linear
def test_tsu_with_a_linear_part(r):
    assert clocks_while(started(r, control=CONTINUOUS), "fup") == math.ceil(tsu_with_linear(r))


def slowing_down(r, bits=0):
    """Clocks of FDOWN: those of the last step too, which runs at FL already as the first of a ramp-up does."""
    chip = started(r, control=CONTINUOUS, bits=bits)
    clocks_while(chip, "fup")
    chip.write(0, 0x14)
    assert chip.pins.fdown
    return clocks_while(chip, "fdown")


@curved
def test_tsd_with_no_linear_part(r):
    assert slowing_down(r) == tsd(r)


@with_linear
def test_tsd_with_a_linear_part(r):
    assert slowing_down(r) == math.ceil(tsd_with_linear(r))


@curved
def test_linear_ramps_take_the_time_of_an_s_curve_with_no_linear_part(r):
    assert clocks_while(started(r, control=CONTINUOUS, bits=LINEAR), "fup") == tsu(r)
    assert slowing_down(r, LINEAR) == tsd(r)


def until_the_end(waveforms, clocks):
    """So many clocks of FDOWN, or those that are left: the last pulse, too, ends it."""
    return min(clocks, waveforms.end - waveforms.clock[waveforms.pin("fdown")][0])


@curved
def test_with_the_automatic_point_r4_replaces_r5(r):
    r0 = math.ceil(minimum_trapezoid(automatic(r))) + 50
    waveforms = RecordedMove(started(r, r0, r6=5))
    assert waveforms.clocks("fup") == tsu(r)
    assert waveforms.clocks("fdown") == until_the_end(waveforms, tsd(automatic(r)) - 1), (
        "the point was in its first clock"
    )


@with_linear
def test_with_the_automatic_point_r4_replaces_r5_also_with_a_linear_part(r):
    r = r._replace(R14=max(r.R14, r.R15))  # "typically"
    r0 = 2 * math.ceil(minimum_trapezoid_with_linear(automatic(r))) + 50
    waveforms = RecordedMove(started(r, r0, r6=5))
    assert waveforms.clocks("fup") == math.ceil(tsu_with_linear(r))
    assert waveforms.clocks("fdown") == until_the_end(waveforms, math.ceil(tsd_with_linear(automatic(r))) - 1)


def test_the_mk_takes_r4_for_r5_too():
    waveforms = RecordedMove(started(Registers(50, 800, 300, 200, 20), 5000, r6=5, cls=PCL240MK))
    assert waveforms.clocks("fup") == 750 * 300
    assert waveforms.clocks("fdown") == 750 * 300 - 1


# 3-4 minimum of pulses for a trapezoid. The speed rises in steps and so falls short of the sheet's curve by half a step on
# average, (ramp time) / (16384 R7) pulses; four more pulses are for rounding: of R6, of R0 < R6, of both ramps' phases


def reaches_fh(r, r0, r6=0, **settings):
    return RecordedMove(started(r, int(r0), int(r6), **settings)).peak == r.R2


@curved
def test_minimum_of_pulses_for_a_trapezoid_with_no_linear_part(r):
    least, steps = minimum_trapezoid(r), tsu(r) / (r.R7 * 16384)
    assert reaches_fh(r, math.ceil(least), r6(r), control=PRESET)
    assert not reaches_fh(r, least - steps - 4, r6(r), control=PRESET)


@with_linear
def test_minimum_of_pulses_for_a_trapezoid_with_a_linear_part(r):
    least, steps = minimum_trapezoid_with_linear(r), tsu_with_linear(r) / (r.R7 * 16384)
    assert reaches_fh(r, math.ceil(least), r6_with_linear(r), control=PRESET)
    assert not reaches_fh(r, least - steps - 4, r6_with_linear(r), control=PRESET)


@curved
def test_minimum_of_pulses_for_a_trapezoid_with_the_automatic_point(r):
    least, steps = minimum_trapezoid(automatic(r)), 2 * tsu(r) / (r.R7 * 16384)
    assert reaches_fh(r, math.ceil(least), bits=NO_CORRECTION)
    assert not reaches_fh(r, least - steps - 4, bits=NO_CORRECTION)


@with_linear
def test_minimum_of_pulses_for_a_trapezoid_with_the_automatic_point_and_a_linear_part(r):
    r = r._replace(R15=r.R14)  # the automatic point reckons with a ramp-down as long as the ramp-up
    least, steps = minimum_trapezoid_with_linear(automatic(r)), 2 * tsu_with_linear(r) / (r.R7 * 16384)
    assert reaches_fh(r, math.ceil(least), bits=NO_CORRECTION)
    assert not reaches_fh(r, least - steps - 4, bits=NO_CORRECTION)


# 3-4.2 minimum of pulses for a linear part

three_cases = pytest.mark.parametrize("spans", [(300, 300), (300, 120), (120, 300)], ids=["equal", "R14>", "R14<"])


@three_cases
def test_minimum_of_pulses_for_a_linear_part_is_a_trapezoid_over_twice_the_longer_span(spans):
    """At FH = FL + twice the longer span that ramp has no linear part left."""
    r = Registers(100, 100 + 2 * max(spans), 6000, 4000, 90, *spans)
    least, steps = minimum_linear(r), tsu_with_linear(r) / (r.R7 * 16384)
    assert reaches_fh(r, math.ceil(least), r6_with_linear(r), control=PRESET)
    assert not reaches_fh(r, least - steps - 4, r6_with_linear(r), control=PRESET)


def started_late(r, r0, **settings):
    """With R6 = -R0 / 2 the automatic point comes late enough for the chip to reach the FH it has in mind; with a shorter R15
    than R14 it would else start down before."""
    return started(r, r0, -(r0 // 2) % (1 << 24), **settings)


def linear_steps(waveforms, rate):
    """Return the steps of the ramp-up that take rate / 2 clocks."""
    clocks, speeds = waveforms.steps()
    rising = np.diff(clocks[: np.argmax(speeds) + 1])
    return int((abs(rising - rate / 2) <= 1).sum())


@three_cases
def test_a_move_beyond_the_minimum_for_a_linear_part_has_one_and_below_it_has_none(spans):
    r = Registers(100, 8000, 7 * 8192, 4000, 500, *spans)
    least, longer = int(minimum_linear(automatic(r))), max(spans)
    assert least == minimum_linear(automatic(r)), "so that R0 can be just this"
    for r0 in (least // 10, least // 2, least):
        low = RecordedMove(started_late(r, r0))
        assert low.peak == revised_r2(automatic(r), r0) <= r.R1 + 2 * longer
        assert spans[0] < longer or linear_steps(low, r.R4) <= 1
    for r0 in (least + 1, least * 6 // 5, 3 * least):
        high = RecordedMove(started_late(r, r0))
        assert high.peak >= r.R1 + 2 * longer
        assert linear_steps(high, r.R4) == pytest.approx(high.peak - r.R1 - 2 * spans[0], abs=4)


# 3-4 revised R2


def assert_peak(r, r0, peak, **settings):
    chip = started_late(r, r0, **settings)
    assert RecordedMove(chip).peak == peak, r0
    return chip


def short_moves(least, maximum, count=8):
    """Draw pulse counts above `least` and up to `maximum`, including both ends."""
    low, high = math.floor(least) + 1, math.floor(maximum)
    between = np.random.default_rng(SEED).integers(low, max(low, high) + 1, count)
    return [low, high, *(int(v) for v in between)] if low <= high else []


@curved
@pytest.mark.parametrize("bits", [{}, {"bits": LINEAR}], ids=["S-curves", "linear ramps"])
def test_revised_r2_with_no_linear_part(r, bits):
    a = automatic(r)
    for r0 in short_moves(0, minimum_trapezoid(a)):
        assert_peak(r, r0, revised_r2(a, r0), **bits)
    if not bits:
        assert_peak(r, math.floor(minimum_trapezoid(a)) + 1, r.R2)


@with_linear
def test_revised_r2_with_a_linear_part(r):
    for spans in (r, r._replace(R15=r.R14), r._replace(R14=r.R15, R15=r.R14)):
        a = automatic(spans)
        for r0 in short_moves(minimum_linear(a), minimum_trapezoid_with_linear(a)):
            assert_peak(spans, r0, revised_r2_with_linear(a, r0))
        assert_peak(spans, math.floor(minimum_trapezoid_with_linear(a)) + 1, r.R2)


@with_linear
def test_revised_r2_is_that_with_no_linear_part_up_to_the_minimum_for_one(r):
    a = automatic(r)
    for r0 in short_moves(0, minimum_linear(a)):
        assert_peak(r, r0, revised_r2(a, r0))


@any_shape
@pytest.mark.parametrize("start", [0x15, 0x17], ids=["FH1", "FH2"])
def test_fh_correction_acts_on_the_selected_fh_and_changes_no_register(r, start):
    r0 = math.floor(minimum_trapezoid(automatic(r))) // 3
    fh1, fh2 = (r.R2, r.R1) if start == 0x15 else (r.R1, r.R2)
    chip = assert_peak(r._replace(R2=fh1), r0, corrected_r2(r, r0), start=start, fh2=fh2)
    after = chip.values()
    assert {name: after[name] for name in r._fields} == r._replace(R2=fh1)._asdict()
    assert after["R3"] == fh2


@curved
def test_no_fh_correction_when_bit_15_is_set_or_the_automatic_point_is_off(r):
    """The ramp-up goes on until the down point comes, beyond the revised R2."""
    r0 = int(0.8 * minimum_trapezoid(automatic(r)))
    revised = revised_r2(automatic(r), r0)
    assert reaches_fh(r, r0, control=PRESET)
    assert RecordedMove(started(r, r0)).peak == revised
    assert RecordedMove(started(r, r0, bits=NO_CORRECTION)).peak > revised


# 3-4 R6 with the automatic point off


def at_fl(r, r6, r0, bits=0):
    """Return the pulses at FL at the end of a preset move; None if it does not end at FL."""
    waveforms = RecordedMove(started(r, r0, r6, control=PRESET, bits=bits))
    assert waveforms.pulses == r0
    assert waveforms.peak == r.R2
    assert waveforms.r0[-1] == 0
    return int(waveforms.r0[np.flatnonzero(waveforms.speed > r.R1)[-1] + 1]) if waveforms.speed[-1] == r.R1 else None


def assert_r6_is_right(r, psd, minimum, time):
    """Of 5 pulses more, at least 4 remain for FL (R0 < R6 comes a pulse after R6), and few others: half a step for each clock of
    the ramp, the clocks of its last step, and rounding."""
    last = r.R5 * math.sqrt(span_of(r.R15, r.R2 - r.R1))
    more = float(time / 2 + last * r.R1) / (r.R7 * 8192) + 3
    r0 = math.ceil(minimum) + 100
    assert 4 <= at_fl(r, math.ceil(psd) + 5, r0) <= 4 + more
    less = math.floor(psd - more)
    assert less < 1 or at_fl(r, less, r0) is None, "less than R6 is not enough"


@curved
def test_r6_with_no_linear_part(r):
    assert_r6_is_right(r, r6(r), minimum_trapezoid(r), tsd(r))


@with_linear
def test_r6_with_a_linear_part(r):
    assert_r6_is_right(r, r6_with_linear(r), minimum_trapezoid_with_linear(r), tsd_with_linear(r))


# 3-1, 3-2 the setting examples


def assert_linear_between(low, high, rates, steps_taken, clocks):
    """From `low` to `high` pps each step takes `clocks`; outside, the less the nearer to there."""
    inside = (rates >= low) & (rates < high)
    assert inside.sum() >= 1000
    assert set(steps_taken[inside]) == {clocks}
    assert (np.diff(steps_taken[rates < low]) < 0).all(), "curved below"
    assert (np.diff(steps_taken[rates >= high]) > 0).all(), "curved above"


def test_example_of_3_1_r14_of_1000_at_x10_curves_100_to_10100_and_40000_to_50000_pps():
    r = Registers(10, 5000, 20_000, 3000, 60, R14=1000, R15=7)
    clocks, speeds = RecordedMove(started(r, 1_000_000, math.ceil(r6_with_linear(r)), control=PRESET)).steps()
    rates = np.r_[r.R1, speeds] * CLOCK_HZ / (8192 * r.R7)
    top = np.argmax(rates)
    assert (rates[0], rates[top]) == (100, 50_000)
    assert_linear_between(10_100, 40_000, rates[:top], np.diff(clocks[:top], prepend=0), r.R4 // 2)


def test_example_of_3_2_r15_of_1000_at_x20_curves_500_to_20500_and_80000_to_100000_pps():
    r = Registers(25, 5000, 3000, 20_000, 30, R14=7, R15=1000)
    clocks, speeds = RecordedMove(started(r, 2_000_000, math.ceil(r6_with_linear(r)) + 5, control=PRESET)).steps()
    rates = speeds * CLOCK_HZ / (8192 * r.R7)
    top = np.argmax(rates)
    assert (rates[-1], rates[top]) == (500, 100_000)
    down = slice(top + 1, -1)
    assert_linear_between(20_500, 80_000, rates[down][::-1], np.diff(clocks[top + 1 :])[::-1], r.R5 // 2)


# the shape


def steps_up(r):
    chip = started(r, control=CONTINUOUS)
    journal = chip.journal()
    chip.advance(clocks_while(chip, "fup") + 1)
    edges = journal.replay_waveforms().edges
    at = np.flatnonzero(np.diff(edges["speed"])) + 1
    return edges["clock"][at], edges["speed"][at]


def steps_down(r):
    """Clocks from the ramp's first tick, which makes the first step."""
    chip = started(r, control=CONTINUOUS)
    clocks_while(chip, "fup")
    chip.write(0, 0x14)
    journal = chip.journal()
    chip.advance(LONG)
    edges = journal.replay_waveforms().edges
    at = np.flatnonzero(np.diff(edges["speed"])) + 1
    return edges["clock"][at] - edges["clock"][0] - 1, edges["speed"][at]


any_registers = over([*CURVED, *WITH_LINEAR], True, 4)


@any_registers
def test_steps_come_when_the_curve_says_to_the_clock(r):
    gain = r.R2 - r.R1
    clocks, speeds = steps_up(r)
    assert speeds.tolist() == list(range(r.R1 + 1, r.R2 + 1)), "one by one, none twice"
    due = step_clocks(gain, span_of(r.R14, gain), r.R4)[1:]
    assert (np.abs(clocks - due) <= 1).all()


@any_registers
def test_a_ramp_is_symmetric_about_its_middle(r):
    clocks, _ = steps_up(r)
    clocks = np.r_[0, clocks]
    assert np.ptp(clocks + clocks[::-1]) <= 2


@any_registers
def test_a_ramp_down_is_the_mirror_image_of_a_ramp_up(r):
    r = r._replace(R5=r.R4, R15=r.R14)
    (up, rising), (down, falling) = steps_up(r), steps_down(r)
    assert (falling + 1 == rising[::-1]).all()
    assert np.ptp(down + up[::-1]) <= 2, "the step to a speed after as long as the step from it before the end"


def test_acceleration_starts_at_0_grows_evenly_stays_and_falls_to_0_again():
    """At twice 1 / R4 steps a clock in the linear part, half of that on average in the curved ones."""
    r = Registers(500, 4500, 60_000, 60_000, 20, 1000, 1000)
    clocks, speeds = steps_up(r)
    gone = speeds - r.R1

    def speed_at(clock):
        return np.interp(clock, clocks, gone)

    curve = r.R4 * 1000  # clocks of each curved part: 1000 steps at half the slope
    end = clocks[-1]
    assert end == 2 * curve + 2000 * r.R4 // 2
    assert speed_at(curve) == pytest.approx(1000, abs=1)
    assert speed_at(end - curve) == pytest.approx(3000, abs=1)
    t = np.linspace(0, 1, 11)[1:]
    assert speed_at(t * curve) == pytest.approx(1000 * t**2, abs=1), "acceleration grows evenly from 0"
    assert 4000 - speed_at(end - t * curve) == pytest.approx(1000 * t**2, abs=1), "and falls evenly to 0"
    assert clocks[0] == math.ceil(r.R4 * math.sqrt(1000)), "the first step is the longest"


def test_ms_and_mk_ramp_alike_with_linear_ramps():
    r = Registers(50, 800, 300, 200, 20, 100, 100)
    courses = [RecordedMove(started(r, 5000, bits=bits, cls=c)) for c, bits in ((PCL240MS, LINEAR), (PCL240MK, 0))]
    assert (courses[0].clock == courses[1].clock).all()
    assert (courses[0].speed == courses[1].speed).all()
