"""Lines and arcs of the MCX514: where each pulse is beside the ideal path, and when it comes."""

import math
import time
from fractions import Fraction

import pytest
from reference.nova_paths import (
    angles,
    line_errors,
    line_ticks,
    octant_ahead,
    points,
)
from reference.nova_profile import SECOND, ceil_clock, mp
from support.covers import covers
from support.nova_bench import (
    DSNDE,
    SEED,
    Move,
    U,
    X,
    Y,
    Z,
    assert_pulses,
    command,
    driving,
    examples,
    get_signed,
    load,
    log_uniform,
    prepare,
)
from support.nova_interpolation_bench import (
    AXES,
    DECELERATE,
    ENOUGH,
    PERIOD,
    STEADY,
    arc,
    assert_circular,
    assert_even,
    line,
    list_axes,
    prepared,
    random_axes,
    rotations,
    ticks,
)

from stage.chips import MCX514
from stage.chips.nova.interpolation import line as linear

# Lines


def assert_line(chip, finish, axes, main=STEADY, ends=None):
    """`ends`: the main profile's P and the like; None: a steady speed."""
    note = f"{finish} {axes:X}h {main} PULSESTAGE_SEED={SEED}"
    line(chip, finish, axes)
    when, steps = ticks(chip, axes=axes)
    waveforms, length = points(steps), max(map(abs, finish))
    assert len(steps) == length, f"the long axis steps at every tick\n{note}"
    assert waveforms[-1] == tuple(finish), note
    assert max(line_errors(waveforms, finish)) <= Fraction(1, 2), note
    drive = main._replace(P=length).reference() if ends is None else ends
    assert_pulses(when, drive, note, None if drive.end_clock else when[-1])
    assert not driving(chip), note


@pytest.mark.parametrize("count", [2, 3, 4])
def test_any_line_is_within_half_an_lsb_at_every_pulse_and_ends_on_its_finish_point(count):
    for rng in examples(0.1):
        axes = random_axes(rng, count)
        finish = [rng.choice([-1, 1]) * log_uniform(rng, 1, 3000) * (rng.random() < 0.9) for _ in range(count)]
        if any(finish):
            assert_line(prepared(axes), finish, axes)


@covers("MCX514", "LHK1", "LHK2", "LHK3", "LHK4")
def test_lines_of_one_to_four_axes_end_on_their_finish_point():
    """One axis alone is what several chips share a line by."""
    for finish in ((-30,), (30, -20), (10, -30, 0), (5, 20, 30, -29)):
        axes = 0xF >> 4 - len(finish)
        assert_line(prepared(axes), finish, axes)


@pytest.mark.parametrize("finish", [(1, 0), (0, -1), (7, 7), (-6, 3), (1000, 1), (999, -998), (2, 20_000)])
def test_named_lines_are_within_half_an_lsb(finish):
    assert_line(prepared(), finish, X | Y)


def test_a_line_to_where_it_is_ends_at_once():
    chip = prepared()
    line(chip, (0, 0))
    assert not driving(chip)
    assert chip.advance(SECOND) == 0


def test_counters_stand_at_the_finish_point():
    chip, axes = prepared(Y | Z | U), Y | Z | U
    for axis in list_axes(axes):
        load(chip, axis, LP=100)
    line(chip, (30, -50, 7), axes)
    chip.advance(ENOUGH)
    assert [get_signed(chip, 0x30, axis) for axis in AXES] == [0, 130, 50, 107]


def test_the_main_axis_gives_the_speed_though_another_is_longer():
    main = Move(SV=4000, DV=4000)
    chip = prepared(X | Y, main)
    prepare(chip, Move(SV=777, DV=777), Y)
    assert_line(chip, (10, 60), X | Y, main)


@pytest.mark.parametrize("finish", [(3000, 1000), (500, -3000), (200, 40), (30, 29)])
@pytest.mark.parametrize("s_curve", [False, True], ids=["linear", "S-curve"])
def test_with_deceleration_enabled_a_line_is_the_main_axis_fixed_pulse_drive_and_ends_at_sv(finish, s_curve):
    main = Move(SV=1000, DV=8000, AC=50_000, JK=2_000_000, s_curve=s_curve)
    chip = prepared(main=main)
    command(chip, DECELERATE, 0)
    assert_line(chip, finish, X | Y, main)


def test_asymmetric_ramps_run_in_lines_too():
    main = Move(SV=1000, DV=8000, AC=50_000, DC=30_000, asymmetric=True)
    assert main.wr3((0, 0)) == DSNDE
    chip = prepared(main=main)
    command(chip, DECELERATE, 0)
    assert_line(chip, (3000, 1234), X | Y, main)


def test_without_deceleration_enabled_a_line_accelerates_and_ends_at_dv():
    main = Move(SV=1000, DV=8000, AC=50_000)
    assert_line(prepared(main=main), (3000, 1234), X | Y, main, main.reference())


def test_an_instant_stop_of_the_main_axis_ends_the_line():
    chip = prepared()
    line(chip, (1000, 500))
    when, _ = ticks(chip, 100 * PERIOD)
    command(chip, 0x57, X)
    assert len(when) == 100
    assert not driving(chip)
    assert chip.advance(SECOND) == 0


def test_ticks_of_a_ramp_are_whole_clocks_of_the_profile_on_every_axis():
    main = Move(SV=1000, DV=8000, AC=50_000)
    chip = prepared(main=main)
    command(chip, DECELERATE, 0)
    began = chip.clock
    line(chip, (300, 300))
    trace = chip.trace(ENOUGH)
    due = [ceil_clock(t) for t in main._replace(P=300).reference().pulse_times()]
    for axis in (0, 1):
        assert (trace["clock"][trace["axis"] == axis] - began).tolist() == due


# Arcs


def assert_arc(chip, centre, finish, clockwise, axes=X | Y, period=PERIOD):
    note = f"centre {centre} finish {finish} {'cw' if clockwise else 'ccw'} PULSESTAGE_SEED={SEED}"
    arc(chip, centre, finish, clockwise, axes)
    when, steps = ticks(chip, axes=axes)
    assert_even(when, period)
    assert_circular(steps, centre, finish, clockwise, note)
    assert not driving(chip), note


@rotations
def test_any_arc_is_within_one_lsb_at_every_pulse_and_ends_on_its_finish_point(clockwise):
    for rng in examples(0.15):
        radius, begin, end = 5 * 400 ** rng.random(), rng.random() * math.tau, rng.random() * math.tau
        centre = round(radius * math.cos(begin)), round(radius * math.sin(begin))
        true = math.hypot(*centre)
        finish = centre[0] + round(true * math.cos(end)), centre[1] + round(true * math.sin(end))
        if max(map(abs, finish)) > 2:  # beside the start a turn or none is the rounding's choice
            axes = random_axes(rng, 2)
            assert_arc(prepared(axes), centre, finish, clockwise, axes)


@rotations
def test_any_full_circle_ends_where_it_began(clockwise):
    for rng in examples(0.1):
        radius, begin = 1 + 1000 ** rng.random(), rng.random() * math.tau
        centre = round(radius * math.cos(begin)), round(radius * math.sin(begin))
        assert_arc(prepared(), centre, (0, 0), clockwise)


@rotations
@pytest.mark.parametrize("radius", [1, 2, 3, 4, 5, 7, 10])
def test_the_smallest_circles_close(radius, clockwise):
    for centre in ((radius, 0), (0, radius), (-radius, 0), (0, -radius), (radius, radius), (-radius, radius)):
        assert_arc(prepared(), centre, (0, 0), clockwise)


@rotations
@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_quarters_of_a_circle_end_on_the_axes(quarters, clockwise):
    for k in range(4):
        centre = [(100, 0), (0, 100), (-100, 0), (0, -100)][k]
        turned = k + (-quarters if clockwise else quarters)
        ahead = [(-100, 0), (0, -100), (100, 0), (0, 100)][turned % 4]
        assert_arc(prepared(), centre, (centre[0] + ahead[0], centre[1] + ahead[1]), clockwise)


@rotations
def test_a_finish_point_before_the_start_in_its_octant_is_nearly_a_full_turn(clockwise):
    sign = 1 if clockwise else -1
    chip = prepared()
    arc(chip, (-500, -100), (0 + 5, sign * 20), clockwise)
    _, steps = ticks(chip)
    assert angles(points(steps), (-500, -100), clockwise)[-1] > 0.9 * math.tau
    chip = prepared()
    arc(chip, (-500, -100), (0 + 5, -sign * 20), clockwise)
    _, steps = ticks(chip)
    assert len(steps) == 20


def test_the_zone_is_the_octant():
    centre = (-300, 40)
    for clockwise in (False, True):
        chip = prepared()
        arc(chip, centre, (0, 0), clockwise)
        at, observed = (0, 0), set()
        while driving(chip):
            zone = chip.read(0) >> 8 & 7
            x, y = at[0] - centre[0], at[1] - centre[1]
            if min(abs(x), abs(y), abs(abs(x) - abs(y))) > 2:
                assert zone == octant_ahead(x, y, clockwise), f"at {at}"
                observed.add(zone)
            _, steps = ticks(chip, PERIOD)
            at = tuple(a + s for a, s in zip(at, steps[0], strict=True))
        assert observed == set(range(8))


# Constant vector speed


@pytest.mark.parametrize("mode", [0x40, 0xC0], ids=["simple", "high accuracy"])
def test_with_constant_vector_speed_a_diagonal_tick_lasts_root_2_periods(mode):
    chip = prepared(ipm=mode)
    line(chip, (700, 300))
    assert_lengths(*ticks(chip))
    chip = prepared(ipm=mode)
    arc(chip, (-200, 30), (0, 0), False)
    assert_lengths(*ticks(chip))


def test_with_three_axes_a_tick_of_all_lasts_root_3_periods():
    axes = X | Y | Z
    chip = prepared(axes, ipm=0x80)
    line(chip, (701, 400, -101), axes)
    when, steps = ticks(chip, axes=axes)
    assert {sum(map(abs, step)) for step in steps} == {1, 2, 3}
    assert_lengths(when, steps)


def assert_lengths(when, steps):
    """A tick of several axes takes the length of its diagonal; the way up to pulse k is the length of the first k ticks."""
    roots = [sum(abs(s) for s in step) for step in steps]
    counts = [[roots[: k + 1].count(n) for n in (1, 2, 3)] for k in range(len(roots))]
    due = [PERIOD * (one + two * mp.sqrt(2) + three * mp.sqrt(3)) for one, two, three in counts]
    assert when == [ceil_clock(t) for t in due]


def counted(finish, looked, max_length=0, fine=1):
    """Return the tick counts of a line that the chip computes: those that move one axis, two, and three."""
    chip = MCX514()
    queue, ip = chip.state["queue"][0], chip.state["ip"]
    queue["axis_count"], queue["vector_axes"], queue["inner_ticks"] = len(finish), looked, fine
    queue["tick_count"] = max(max_length, *map(abs, finish))
    queue["finish"][: len(finish)] = finish
    return linear.count_line_ticks(ip, queue)


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("looked", [2, 3])
def test_the_length_of_a_line_of_constant_vector_speed_is_reckoned_as_its_ticks_are(count, looked):
    for rng in examples(0.3):
        finish = [rng.choice([-1, 1]) * log_uniform(rng, 1, 300) * (rng.random() < 0.9) for _ in range(count)]
        finish[rng.randrange(count)] = rng.choice(finish)  # two alike
        moved = [sum(map(abs, step[:looked])) for step in line_ticks(finish)]
        one, two, three = counted(finish, min(looked, count))
        assert (one, two, three) == (sum(m < 2 for m in moved), moved.count(2), moved.count(3)), (
            f"{finish} PULSESTAGE_SEED={SEED}"
        )


def test_a_line_below_a_maximum_of_the_hosts_is_reckoned_as_its_ticks_are():
    longer = line_ticks((30, 20, 7, 100))
    moved = [sum(map(abs, step[:3])) for step in longer]
    assert counted((30, 20, 7), 3, max_length=100) == (sum(m < 2 for m in moved), moved.count(2), moved.count(3))
    assert counted((30, 20), 2, max_length=100, fine=8)[1] == 8 * sum(a and b for a, b, *_ in longer)


def test_the_longest_line_of_three_axes_begins_at_once():
    """A thousand million ticks, whose diagonals are not counted one by one: that took more than ten seconds."""
    chip = prepared(X | Y | Z, Move(SV=4000, DV=8_000_000), ipm=0x80)
    command(chip, DECELERATE, 0)
    began = time.process_time()
    line(chip, (2**30 - 1, 700_000_001, -123_456_789), X | Y | Z)
    assert time.process_time() - began < 1
    assert driving(chip, X | Y | Z)
