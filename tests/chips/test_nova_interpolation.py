"""Interpolation of the MCX514: where each pulse is beside the ideal path, and when it comes."""

import math
from fractions import Fraction
from itertools import groupby, pairwise

import pytest
from nova_bench import (
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
from reference.nova_paths import (
    END,
    OCTANTS,
    angles,
    arc_angle,
    bit_pattern_ticks,
    circle_errors,
    helix_errors,
    line_errors,
    octant_ahead,
    octant_behind,
    points,
)
from reference.nova_profile import SECOND, ceil_clock

from stage.chips import MCX514

AXES = (X, Y, Z, U)
LINEAR, BIT_PATTERN = {1: 0x60, 2: 0x61, 3: 0x62, 4: 0x63}, {2: 0x66, 3: 0x67, 4: 0x68}
CW, CCW, HELIX_CW, HELIX_CCW = 0x64, 0x65, 0x69, 0x6A
COUNT_CW, COUNT_CCW = 0x6B, 0x6C  # helical calculation
DECELERATE, ENOUGH = 0x6D, 1 << 40  # clocks
STEADY = Move(SV=10_000, DV=10_000)
PERIOD = SECOND // 10_000
rotations = pytest.mark.parametrize("clockwise", [True, False], ids=["cw", "ccw"])


def prepared(axes=X | Y, main=STEADY, ipm=0):
    """An MCX514 whose lowest axis has the speed of the path."""
    chip = MCX514()
    prepare(chip, main, axes & -axes)
    load(chip, IPM=axes | ipm)
    return chip


def chosen(axes):
    """Axis bits, the lowest first."""
    return [axis for axis in AXES if axes & axis]


def line(chip, finish, axes=X | Y):
    """Write a straight segment and its command."""
    for axis, value in zip(chosen(axes), finish, strict=True):
        load(chip, axis, TP=value)
    command(chip, LINEAR[len(finish)], 0)


def arc(chip, centre, finish, clockwise, axes=X | Y):
    for axis, c, f in zip(chosen(axes), centre, finish, strict=True):
        load(chip, axis, CP=c, TP=f)
    command(chip, CW if clockwise else CCW, 0)


def ticks(chip, clocks=ENOUGH, axes=X | Y):
    """Let it run: the clock since now of each tick, and the steps of the axes in it."""
    began, numbers = chip.clock, [AXES.index(axis) for axis in chosen(axes)]
    trace = chip.trace(clocks)
    pulses = zip((trace["clock"] - began).tolist(), trace["axis"].tolist(), trace["direction"].tolist(), strict=True)
    when, steps = [], []
    for clock, group in groupby(sorted(pulses), key=lambda pulse: pulse[0]):
        step = dict.fromkeys(numbers, 0)
        for _, axis, direction in group:
            assert step[axis] == 0, f"axis {axis} steps twice at {clock}"
            step[axis] = direction
        when.append(clock)
        steps.append(tuple(step.values()))
    return when, steps


def assert_even(when, period=PERIOD):
    assert when == [period * k for k in range(1, len(when) + 1)]


# Lines


def assert_line(chip, finish, axes, main=STEADY, ends=None):
    """`ends`: the main profile's P and the like; None: a steady speed."""
    note = f"{finish} {axes:X}h {main} PULSESTAGE_SEED={SEED}"
    line(chip, finish, axes)
    when, steps = ticks(chip, axes=axes)
    course, length = points(steps), max(map(abs, finish))
    assert course[-1] == tuple(finish), note
    assert len(steps) == length, f"the long axis steps at every tick\n{note}"
    assert max(line_errors(course, finish)) <= Fraction(1, 2), note
    drive = main._replace(P=length).reference() if ends is None else ends
    assert_pulses(when, drive, note, None if drive.end_clock else when[-1])
    assert not driving(chip), note


def random_axes(rng, count):
    return sum(rng.sample(AXES, count))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_any_line_is_within_half_an_lsb_at_every_pulse_and_ends_on_its_finish_point(count):
    for rng in examples(0.1):
        axes = random_axes(rng, count)
        finish = [rng.choice([-1, 1]) * log_uniform(rng, 1, 3000) * (rng.random() < 0.9) for _ in range(count)]
        if any(finish):
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
    for axis in chosen(axes):
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
    assert main.wr3(0) == DSNDE
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


# Arcs


def assert_arc(chip, centre, finish, clockwise, axes=X | Y, period=PERIOD):
    note = f"centre {centre} finish {finish} {'cw' if clockwise else 'ccw'} PULSESTAGE_SEED={SEED}"
    arc(chip, centre, finish, clockwise, axes)
    when, steps = ticks(chip, axes=axes)
    assert_even(when, period)
    assert_circular(steps, centre, finish, clockwise, note)
    assert not driving(chip), note


def assert_circular(steps, centre, finish, clockwise, note):
    course, radius = points(steps), math.hypot(*centre)
    assert max(circle_errors(course, centre)) <= 1 + 1e-9, note
    if finish == (0, 0):
        assert course[-1] == (0, 0), f"a closed circle ends where it began\n{note}"
    assert_ends(course[-1], centre, finish, clockwise, note)
    # the finish point is rounded, the end is beside it: some 3 LSB of arc
    missed = angles(course, centre, clockwise)[-1] - arc_angle(centre, finish, clockwise)
    assert abs(missed) * radius < 3, f"{missed} rad, {len(steps)} ticks\n{note}"
    assert_the_faster_axis_steps(steps, course, centre, clockwise, note)


def assert_ends(at, centre, finish, clockwise, note):
    """In the finish octant the faster axis is where the finish point is; beside a border the octant may end first."""
    x, y = (f - c for f, c in zip(finish, centre, strict=True))
    fast = OCTANTS[octant_behind(x, y, clockwise)][0]
    assert abs(at[fast] - finish[fast]) <= (abs(abs(x) - abs(y)) <= 1), f"ends at {at}\n{note}"
    assert max(abs(a - f) for a, f in zip(at, finish, strict=True)) <= 1, f"ends at {at}\n{note}"


def assert_the_faster_axis_steps(steps, course, centre, clockwise, note):
    at = (0, 0)
    for k, (step, after) in enumerate(zip(steps, course, strict=True), 1):
        x, y = (a - c for a, c in zip(at, centre, strict=True))
        if abs(abs(x) - abs(y)) > 2:  # at a border between octants either axis may
            fast, ahead, _ = OCTANTS[octant_ahead(x, y, clockwise)]
            assert step[fast] == (-ahead if clockwise else ahead), f"tick {k} from {at}: {step}\n{note}"
        at = after


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
def test_a_finish_behind_the_start_in_its_octant_is_nearly_a_full_turn(clockwise):
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
        at, seen = (0, 0), set()
        while driving(chip):
            zone = chip.read(0) >> 8 & 7
            x, y = at[0] - centre[0], at[1] - centre[1]
            if min(abs(x), abs(y), abs(abs(x) - abs(y))) > 2:
                assert zone == octant_ahead(x, y, clockwise), f"at {at}"
                seen.add(zone)
            _, steps = ticks(chip, PERIOD)
            at = tuple(a + s for a, s in zip(at, steps[0], strict=True))
        assert seen == set(range(8))


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
    due = [PERIOD * (one + two * math.sqrt(2) + three * math.sqrt(3)) for one, two, three in counts]
    assert when == [math.ceil(t - 1e-6) for t in due]


# Bit pattern


def send_bits(chip, words, axes=X | Y):
    for axis, word in zip(chosen(axes), words, strict=True):
        load(chip, axis, TP=word)
    command(chip, BIT_PATTERN[len(words)], 0)


def random_word(rng):
    """Each bit +, - or none."""
    steps = [rng.choice([0, 0, 1, 1 << 16]) for _ in range(16)]
    return sum(step << bit for bit, step in enumerate(steps))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_bit_patterns_step_lsb_first_and_pauses_take_a_tick(count):
    for rng in examples(0.06):
        axes = random_axes(rng, count)
        chip = prepared(axes)
        sets = [[random_word(rng) for _ in range(count)] for _ in range(rng.randint(1, 20))]
        waiting, when, steps = list(sets), [], []
        for _ in range(16 * len(sets) + 1):
            while waiting and (not driving(chip) or can_queue(chip)):
                send_bits(chip, waiting.pop(0), axes)
            clocks, new = ticks(chip, PERIOD, axes)
            assert len(clocks) <= 1
            when.append(clocks[0] if clocks else None)
            steps.append(new[0] if new else (0,) * count)
        due = list(zip(*(bit_pattern_ticks(words) for words in zip(*sets, strict=True)), strict=True))
        note = f"{sets} PULSESTAGE_SEED={SEED}"
        assert steps[: len(due)] == due, note
        assert when[: len(due)] == [PERIOD if any(step) else None for step in due], note
        assert steps[len(due) :] == [(0,) * count], note
        assert not driving(chip), note


def test_both_bits_of_any_axis_end_the_pattern_unexecuted():
    for ends in ((1 << 5 | 1 << 21, 0xFFFF), (0xFFFF, 1 << 5 | 1 << 21)):
        chip = prepared()
        send_bits(chip, ends)
        when, steps = ticks(chip)
        due = list(zip(*(bit_pattern_ticks([word])[:5] for word in ends), strict=True))
        assert END not in [step for pair in due for step in pair]
        assert steps == due
        assert_even(when)
        assert not driving(chip)


# Continuous interpolation


def can_queue(chip):
    return bool(chip.read(0) & 0x0800)


def stacked(chip):
    return chip.read(0) >> 12


def test_the_pre_buffer_holds_eight_segments_behind_the_running_one():
    chip = prepared()
    line(chip, (10, 4))
    for count in range(8):
        assert (stacked(chip), can_queue(chip)) == (count, True)
        line(chip, (10, 4))
    assert (stacked(chip), can_queue(chip)) == (8, False)
    chip.advance(10 * PERIOD)
    assert (stacked(chip), can_queue(chip)) == (7, True)
    chip.advance(10 * PERIOD)
    assert stacked(chip) == 6
    chip.advance(60 * PERIOD - 1)
    assert (stacked(chip), driving(chip)) == (1, True)
    chip.advance(1)
    assert (stacked(chip), driving(chip)) == (0, True)
    assert chip.advance(10 * PERIOD) == 10 + 4
    assert not driving(chip)


def random_segment(rng):
    """A line, or an arc with its centre, of some 3 to 200 LSB."""
    if rng.random() < 0.5:
        finish = tuple(rng.choice([-1, 1]) * log_uniform(rng, 1, 200) for _ in range(2))
        return ("line", finish)
    radius, begin, end = 5 * 30 ** rng.random(), rng.random() * math.tau, rng.uniform(0.5, 6)
    centre = round(radius * math.cos(begin)), round(radius * math.sin(begin))
    clockwise = rng.random() < 0.5
    true, towards = math.hypot(*centre), math.atan2(-centre[1], -centre[0]) + (-end if clockwise else end)
    finish = centre[0] + round(true * math.cos(towards)), centre[1] + round(true * math.sin(towards))
    return ("arc", centre, finish, clockwise) if max(map(abs, finish)) > 2 else random_segment(rng)


def write_segment(chip, segment):
    kind, *data = segment
    (line if kind == "line" else arc)(chip, *data)


def assert_segment(steps, segment, note):
    kind, *data = segment
    if kind == "line":
        assert points(steps)[-1] == data[0], note
        assert max(line_errors(points(steps), data[0])) <= Fraction(1, 2), note
    else:
        assert_circular(steps, *data, note)


def test_segments_follow_each_other_without_a_missing_tick():
    """Each segment's ticks are known from a chip that makes it alone; the course of all is theirs, evenly spaced."""
    for rng in examples(0.06):
        segments = [random_segment(rng) for _ in range(rng.randint(2, 14))]
        alone = []
        for segment in segments:
            chip = prepared()
            write_segment(chip, segment)
            alone.append(ticks(chip)[1])
            assert_segment(alone[-1], segment, f"{segment} PULSESTAGE_SEED={SEED}")
        chip, waiting = prepared(), list(segments)
        began, when, steps = chip.clock, [], []
        write_segment(chip, waiting.pop(0))
        while driving(chip):
            while waiting and can_queue(chip):
                write_segment(chip, waiting.pop(0))
            since = chip.clock - began
            clocks, new = ticks(chip, PERIOD if waiting else ENOUGH)
            when += [since + clock for clock in clocks]
            steps += new
        note = f"{segments} PULSESTAGE_SEED={SEED}"
        assert steps == [step for one in alone for step in one], note
        assert_even(when)


def test_deceleration_enabled_for_the_last_segment_ends_the_path_at_sv():
    main = Move(SV=1000, DV=8000, AC=50_000)
    chip = prepared(main=main)
    for finish in ((500, 200), (700, -100)):
        line(chip, finish)
    command(chip, DECELERATE, 0)
    line(chip, (1500, 0))
    when, steps = ticks(chip)
    assert points(steps)[-1] == (2700, 100)
    assert_pulses(when, main._replace(P=2700, triangle_prevention=False).reference(), "two lines, then one with 6Dh")


def test_the_speed_of_continuous_interpolation_is_at_most_4_mpps():
    chip = prepared(main=Move(SV=8_000_000, DV=8_000_000))
    for _ in range(3):
        line(chip, (100, 10))
    when, _ = ticks(chip)
    assert set(b - a for a, b in pairwise(when[100:])) == {4}


# Helices


def helix(chip, centre, finish, clockwise, rise, turns=0):
    for axis, c, f in zip((X, Y), centre, finish, strict=True):
        load(chip, axis, CP=c, TP=f)
    load(chip, Z, TP=rise)
    load(chip, HLN=turns)
    command(chip, COUNT_CW if clockwise else COUNT_CCW, 0)
    assert chip.advance(SECOND) == 0, "the calculation makes no pulses"
    command(chip, HELIX_CW if clockwise else HELIX_CCW, 0)


@rotations
def test_a_helix_is_an_arc_that_rises_evenly_and_ends_at_its_height(clockwise):
    axes = X | Y | Z
    for rng in examples(0.04):
        segment = random_segment(rng)
        while segment[0] != "arc":
            segment = random_segment(rng)
        _, centre, finish, _ = segment
        length = arc_angle(centre, finish, clockwise) * math.hypot(*centre)
        rise = rng.choice([-1, 1]) * rng.randint(1, int(0.6 * length) + 1)  # z steps once in a tick at most
        chip = prepared(axes)
        helix(chip, centre, finish, clockwise, rise)
        _, steps = ticks(chip, axes=axes)
        note = f"{centre} {finish} {rise} PULSESTAGE_SEED={SEED}"
        assert_helix(steps, centre, finish, clockwise, rise, note)
        assert not driving(chip), note


def assert_helix(steps, centre, finish, clockwise, rise, note, turns=0):
    course = points(steps)
    assert course[-1][2] == rise, note
    assert max(circle_errors(course, centre)) <= 1 + 1e-9, note
    assert max(abs(a - f) for a, f in zip(course[-1], finish, strict=False)) <= 1, note
    # even in ticks, which are up to 1.1 degrees off the angle
    pitch = abs(rise) * math.tau / (arc_angle(centre, finish, clockwise) + math.tau * turns)
    allowed = 1 + pitch * (0.01 + 1 / math.hypot(*centre))
    assert max(helix_errors(course, centre, finish, clockwise, rise, turns)) <= allowed, note


def test_a_helix_of_several_turns_takes_the_pulses_of_each_turn_on_both_axes():
    axes = X | Y | Z | U
    chip = prepared(axes)
    load(chip, U, TP=-25)
    helix(chip, (-100, 0), (0, 0), False, 60, turns=3)
    _, steps = ticks(chip, axes=axes)
    course = points(steps)
    assert angles(course, (-100, 0), False)[-1] == pytest.approx(3 * math.tau, abs=0.02)
    assert course[-1] == (0, 0, 180, -75)


# Time


def test_advancing_in_pieces_is_advancing_at_once():
    for rng in examples(0.03):
        segments = [random_segment(rng) for _ in range(rng.randint(1, 9))]
        one, many = prepared(), prepared()
        for chip in (one, many):
            for segment in segments:
                write_segment(chip, segment)
        pieces = [rng.randint(1, 100 * PERIOD) for _ in range(20)]
        whole = one.trace(sum(pieces))[["clock", "axis", "direction"]].tolist()
        assert [p for n in pieces for p in many.trace(n)[["clock", "axis", "direction"]].tolist()] == whole, segments
        assert one.snapshot().record == many.snapshot().record, segments


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
