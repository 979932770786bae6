"""Bit patterns, continuous interpolation through the pre-buffer, and helices of the MCX514."""

import math
from fractions import Fraction
from itertools import pairwise, product

import pytest
from reference.nova_paths import (
    END,
    angles,
    arc_angle,
    bit_pattern_ticks,
    circle_errors,
    helix_errors,
    line_errors,
    points,
)
from reference.nova_profile import SECOND
from support.covers import covers
from support.nova_bench import (
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
    get,
    load,
    log_uniform,
    put,
)
from support.nova_interpolation_bench import (
    BIT_PATTERN,
    COUNT_CCW,
    COUNT_CW,
    DECELERATE,
    ENOUGH,
    HELIX_CCW,
    HELIX_CW,
    PERIOD,
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

# Bit pattern


def send_bits(chip, words, axes=X | Y):
    for axis, word in zip(list_axes(axes), words, strict=True):
        load(chip, axis, TP=word)
    command(chip, BIT_PATTERN[len(words)], 0)


def random_word(rng):
    """Draw a word whose bits are plus, minus or none."""
    steps = [rng.choice([0, 0, 1, 1 << 16]) for _ in range(16)]
    return sum(step << bit for bit, step in enumerate(steps))


@covers("MCX514", "BHK2", "BHK3", "BHK4")
def test_bit_patterns_step_lsb_first_and_pauses_take_a_tick():
    for count, rng in product((2, 3, 4), examples(0.06)):
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


def test_the_pre_buffer_holds_eight_segments_after_the_running_one():
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
    """Draw a line, or an arc with its center, of about 3 to 200 LSB."""
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


def helix(chip, centre, finish, clockwise, rise, revolutions=0):
    for axis, c, f in zip((X, Y), centre, finish, strict=True):
        load(chip, axis, CP=c, TP=f)
    load(chip, Z, TP=rise)
    load(chip, HLN=revolutions)
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


def assert_helix(steps, centre, finish, clockwise, rise, note, revolutions=0):
    waveforms = points(steps)
    assert waveforms[-1][2] == rise, note
    assert max(circle_errors(waveforms, centre)) <= 1 + 1e-9, note
    assert max(abs(a - f) for a, f in zip(waveforms[-1], finish, strict=False)) <= 1, note
    # even in ticks, which are up to 1.1 degrees off the angle
    pitch = abs(rise) * math.tau / (arc_angle(centre, finish, clockwise) + math.tau * revolutions)
    allowed = 1 + pitch * (0.01 + 1 / math.hypot(*centre))
    assert max(helix_errors(waveforms, centre, finish, clockwise, rise, revolutions)) <= allowed, note


def test_a_helix_of_several_rotations_makes_the_pulses_of_each_on_both_axes():
    axes = X | Y | Z | U
    chip = prepared(axes)
    load(chip, U, TP=-25)
    helix(chip, (-100, 0), (0, 0), False, 60, revolutions=3)
    _, steps = ticks(chip, axes=axes)
    waveforms = points(steps)
    assert angles(waveforms, (-100, 0), False)[-1] == pytest.approx(3 * math.tau, abs=0.02)
    assert waveforms[-1] == (0, 0, 180, -75)


@covers("MCX514", "CHLN", "HLN", "HLCCW", "HLPCCW")
def test_chln_counts_the_rotations_of_a_helix():
    chip = prepared(X | Y | Z)
    helix(chip, (-100, 0), (0, 0), False, 60, revolutions=3)
    began = chip.clock
    turn = len(ticks(chip.make_replica(), axes=X | Y | Z)[0]) / 3
    for revolutions in (0, 1, 2):
        for part in (0.1, 0.9):
            chip.advance(began + int((revolutions + part) * turn * PERIOD) - chip.clock)
            assert get(chip, 0x3A, 0) == revolutions


@covers("MCX514", "R-TX")
def test_tx_reads_0_while_something_other_than_a_line_runs():
    chip = prepared(X | Y | Z)
    put(chip, 0x19, 12_345, 0)
    helix(chip, (-100, 0), (0, 0), False, 60, revolutions=3)
    chip.advance(10 * PERIOD)
    assert driving(chip)
    assert get(chip, 0x39, 0) == 0


# Time


def test_advancing_in_pieces_is_advancing_at_once():
    for rng in examples(0.03):
        segments = [random_segment(rng) for _ in range(rng.randint(1, 9))]
        one, many = prepared(), prepared()
        for chip in (one, many):
            for segment in segments:
                write_segment(chip, segment)
        pieces = [rng.randint(1, 100 * PERIOD) for _ in range(20)]
        uncut = one.trace(sum(pieces))[["clock", "axis", "direction"]].tolist()
        assert [p for n in pieces for p in many.trace(n)[["clock", "axis", "direction"]].tolist()] == uncut, segments
        assert one.snapshot().record == many.snapshot().record, segments


@pytest.mark.parametrize(
    ("rise", "revolutions", "equalized"),
    [(100, 1, 0), (-283, 1, 0), (284, 3, 0), (333, 1, 0), (-325, 4, 0), (100, 1, 0x100), (-280, 3, 0x100)],
)
def test_lost_pulses_of_a_helix_axis_have_a_diagnostic(rise, revolutions, equalized):
    """333 pulses along a circle of 284 ticks made 284 and nobody said so; with equalized short axes (D8 of IPM) 100 made 13"""
    chip = prepared(X | Y | Z, ipm=equalized)
    load(chip, X, CP=0, TP=0)
    load(chip, Y, CP=50, TP=0)
    load(chip, Z, TP=rise)
    load(chip, HLN=revolutions)
    command(chip, COUNT_CCW, 0)
    calculated = get(chip, 0x3B)
    command(chip, HELIX_CCW, 0)
    chip.advance(ENOUGH)
    maximum = min(abs(rise), calculated)
    assert calculated == 284
    assert chip.net(2) == (revolutions * maximum if rise > 0 else -revolutions * maximum)
    message = [d.message for d in chip.diagnostics]
    lost = abs(rise) - maximum
    assert message == ([] if not lost else [
        f"6Ah (CCW helical interpolation) with TP = {rise} of Z: the 284 ticks of HLV make one pulse each at most; "
        f"the other {lost} are lost"
    ])  # fmt: skip
