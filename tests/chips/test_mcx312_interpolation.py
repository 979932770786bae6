"""Interpolation of the MCX312: WR5 chooses the axes; lines, arcs, and bit patterns from the BP registers."""

import math

import pytest
from reference.nova_paths import bit_pattern_ticks, circle_errors, line_errors, points
from support.covers import covers
from support.nova_bench import X, Y, command, get_signed, load_304

from stage.chips import MCX312

LINE, CW, CCW, PATTERN, BP_ON, BP_OFF, STACK, CLEAR, STEP, SLOWS, FAST, NO_INTERRUPT = (
    0x30, 0x32, 0x33, 0x34, 0x36, 0x37, 0x38, 0x39, 0x3A, 0x3B, 0x3C, 0x3D)  # fmt: skip
X_Y, Y_X = 0x0004, 0x0001  # main axis, second axis
CONSTANT_VECTOR, BY_COMMAND, CIINT, BPINT = 0x0100, 0x1000, 0x4000, 0x8000
I_DRV, CNEXT = 0x0100, 0x0200
PERIOD = 16_000  # clocks, of 1000 pps
ENOUGH = 1 << 32


def prepared(wr5=X_Y, **values):
    chip = MCX312()
    load_304(chip, X | Y, R=8_000_000, SV=1000, V=1000, **values)
    chip.write(5, wr5)
    return chip


def put(chip, finish, code, centre=None):
    for k, axis in enumerate((X, Y)):
        load_304(chip, axis, P=finish[k])
        if centre:
            chip.write(6, centre[k] & 0xFFFF)
            chip.write(7, centre[k] >> 16 & 0xFFFF)
            command(chip, 0x08, axis)
    command(chip, code, 0)


def bits(chip, plus_x, minus_x, plus_y, minus_y):
    """One set, while writing is enabled."""
    for k, word in enumerate((plus_x, minus_x, plus_y, minus_y)):
        chip.write(2 + k, word)
    command(chip, STACK, 0)


def sets(chip):
    return chip.read(0) >> 13 & 3


def steps_of(chip, clocks=ENOUGH):
    """The steps of each tick that has pulses, and its clock since now."""
    began, result = chip.clock, {}
    for clock, axis, direction in chip.trace(clocks).tolist():
        step = result.setdefault(clock - began, [0, 0])
        step[axis] = direction
    return list(result), [tuple(step) for step in result.values()]


@covers("MCX312", "P", "IP_2ST")
@pytest.mark.parametrize("finish", [(60, 25), (-7, 40), (12, -12)])
def test_a_line_is_within_half_an_lsb(finish):
    chip = prepared()
    put(chip, finish, LINE)
    assert chip.read(0) & 0x103 == I_DRV | 3
    when, steps = steps_of(chip)
    assert points(steps)[-1] == finish
    assert max(line_errors(points(steps), finish)) <= 0.5
    assert when == [PERIOD * k for k in range(1, max(map(abs, finish)) + 1)]
    assert chip.read(0) & 0x103 == 0


@covers("MCX312", "C", "P", "IP_CW", "IP_CCW")
@pytest.mark.parametrize("wr5", [X_Y, Y_X], ids=["x-y", "y-x"])
def test_circles_close_and_turn_as_the_order_of_the_axes_says(wr5):
    for code in (CW, CCW):
        chip = prepared(wr5)
        put(chip, (0, 0), code, centre=(-40, 9))
        _, steps = steps_of(chip)
        waveforms = points(steps)
        assert waveforms[-1] == (0, 0)
        assert max(circle_errors(waveforms, (-40, 9))) <= 1
        x, y = waveforms[10]
        left = 40 * (y - 9) + 9 * (x + 40) > 0  # of the radius to the start
        assert left == ((code == CCW) == (wr5 == X_Y))


@covers("MCX312", "IP_2ST")
def test_the_main_axis_gives_the_speed():
    chip = prepared(Y_X)
    load_304(chip, Y, SV=500, V=500)
    put(chip, (20, 5), LINE)
    assert steps_of(chip)[0] == [2 * PERIOD * k for k in range(1, 21)]


@covers("MCX312", "IP_2ST")
@pytest.mark.parametrize("wr5", [0x0000, 0x0005, 0x0008, 0x0002])
def test_axes_that_are_not_two_of_the_chip_do_not_start(wr5):
    chip = prepared(wr5)
    put(chip, (20, 5), LINE)
    assert chip.advance(ENOUGH) == 0
    assert chip.read(0) == 0


@covers("MCX312", "IP_2ST")
def test_one_segment_can_be_written_ahead_and_follows_without_a_gap():
    chip = prepared()
    put(chip, (20, 5), LINE)
    assert chip.read(0) & CNEXT
    put(chip, (0, 10), LINE)
    assert not chip.read(0) & CNEXT
    put(chip, (500, 500), LINE)  # lost
    assert steps_of(chip)[0] == [PERIOD * k for k in range(1, 31)]
    assert [get_signed(chip, 0x10, axis) for axis in (X, Y)] == [20, 15]


@covers("MCX312", "IP_2ST", "IP_INTRPT_CLR")
def test_the_interrupt_is_asserted_when_the_next_segment_can_be_written():
    chip = prepared(X_Y | CIINT)
    put(chip, (20, 5), LINE)
    put(chip, (20, 5), LINE)
    chip.advance(20 * PERIOD - 1)
    assert chip.output_word(chip.AXES) == 0
    chip.advance(1)
    assert chip.output_word(chip.AXES) == 1
    command(chip, NO_INTERRUPT, 0)
    assert chip.output_word(chip.AXES) == 0


@covers("MCX312", "IP_2ST")
def test_constant_vector_speed_stretches_diagonal_ticks():
    chip = prepared(X_Y | CONSTANT_VECTOR)
    put(chip, (10, 10), LINE)
    assert steps_of(chip)[0] == [math.ceil(PERIOD * k * math.sqrt(2)) for k in range(1, 11)]


@covers("MCX312", "IP_DEC_VALID", "IP_DEC_INVALID", "IP_2ST")
def test_deceleration_is_for_segments_written_while_it_is_valid():
    ends = {}
    for code in (SLOWS, FAST):
        chip = prepared()
        load_304(chip, X, SV=100, V=2000, A=80, AO=0)
        command(chip, code, 0)
        put(chip, (2000, 700), LINE)
        when, _ = steps_of(chip)
        ends[code] = when[-1] - when[-2]
    assert ends[FAST] == 8000
    assert ends[SLOWS] > 60_000


@covers("MCX312", "IP_1STEP", "IP_2ST")
def test_single_steps_come_by_command():
    chip = prepared(X_Y | BY_COMMAND)
    put(chip, (3, 3), LINE)
    for n in range(1, 4):
        assert chip.advance(PERIOD) == 0
        command(chip, STEP, 0)
        assert (chip.net(0), chip.net(1)) == (n, n)
    assert chip.read(0) == 0


# Bit patterns

WORDS = [
    (0xF00F, 0x0100, 0x3333, 0x4444),
    (0x0001, 0x8000, 0, 0xFFFF),
    (0, 0, 0x1248, 0),
    (0xAAAA, 0x5555, 0x5555, 0xAAAA),
]


def expected(words):
    axes = [[w[2 * k] | w[2 * k + 1] << 16 for w in words] for k in range(2)]
    return list(zip(*(bit_pattern_ticks(axis) for axis in axes), strict=True))


@covers("MCX312", "BP_ENABLED", "BP_DISABLED", "BP_STACK", "IP_2BP")
def test_three_sets_run_lsb_first_and_a_fourth_is_lost():
    chip = prepared()
    command(chip, BP_ON, 0)
    for n, words in enumerate(WORDS):
        assert sets(chip) == n
        bits(chip, *words)
    assert sets(chip) == 3
    command(chip, BP_OFF, 0)
    command(chip, PATTERN, 0)
    due = expected(WORDS[:3])
    when, steps = steps_of(chip)
    assert steps == [step for step in due if any(step)]
    assert when == [PERIOD * k for k, step in enumerate(due, 1) if any(step)]
    assert chip.read(0) == 0


@covers("MCX312", "BP_STACK", "IP_2BP", "IP_INTRPT_CLR")
def test_the_interrupt_is_asserted_when_pattern_sets_can_be_refilled():
    chip = prepared(X_Y | BPINT)
    command(chip, BP_ON, 0)
    for words in WORDS[:2]:
        bits(chip, *words)
    command(chip, PATTERN, 0)
    assert sets(chip) == 2
    first = steps_of(chip, 16 * PERIOD - 1)[1]
    assert (sets(chip), chip.output_word(chip.AXES)) == (2, 0)
    first += steps_of(chip, 1)[1]
    assert (sets(chip), chip.output_word(chip.AXES)) == (1, 1)
    command(chip, NO_INTERRUPT, 0)
    for words in WORDS[2:]:
        bits(chip, *words)
    assert sets(chip) == 3
    assert first + steps_of(chip)[1] == [step for step in expected(WORDS) if any(step)]
    assert chip.read(0) == 0


@covers("MCX312", "BP_CLR", "BP_STACK", "IP_2BP")
def test_cleared_sets_do_not_run():
    chip = prepared()
    command(chip, BP_ON, 0)
    bits(chip, *WORDS[0])
    command(chip, CLEAR, 0)
    command(chip, PATTERN, 0)
    assert chip.read(0) == 0
    assert chip.advance(ENOUGH) == 0


@covers("MCX312", "BP_STACK", "IP_2BP")
def test_both_bits_end_the_pattern_without_a_pulse():
    chip = prepared()
    command(chip, BP_ON, 0)
    bits(chip, 0x00FF, 0x0010, 0, 0)
    bits(chip, *WORDS[3])
    command(chip, PATTERN, 0)
    assert steps_of(chip)[1] == [(1, 0)] * 4
    assert chip.read(0) == 0


@covers("MCX312", "IP_DEC_VALID", "BP_STACK", "IP_2BP")
def test_a_pattern_that_slows_brakes_at_the_end_of_all_its_sets():
    chip = prepared()
    load_304(chip, X, SV=100, V=400, A=40, AO=0)
    command(chip, SLOWS, 0)
    command(chip, BP_ON, 0)
    for _ in range(3):
        bits(chip, 0xFFFF, 0, 0, 0)
    command(chip, PATTERN, 0)
    when, steps = steps_of(chip)
    assert len(steps) == 48
    gaps = [b - a for a, b in zip([0, *when], when, strict=False)]
    assert min(gaps) == gaps[24] == 40_000
    assert gaps[0] == pytest.approx(gaps[-1], abs=2)
    assert gaps[-1] > 120_000
