"""Interpolation of the MCX514 on the bench: segments by hand, the ticks that they make, and what an arc must hold to."""

import math
from itertools import groupby

import pytest
from reference.nova_paths import OCTANTS, angles, arc_angle, circle_errors, octant_ahead, octant_behind, points
from reference.nova_profile import SECOND

from stage.chips import MCX514
from support.nova_bench import Move, U, X, Y, Z, command, load, prepare

AXES = (X, Y, Z, U)
LINEAR, BIT_PATTERN = {1: 0x60, 2: 0x61, 3: 0x62, 4: 0x63}, {2: 0x66, 3: 0x67, 4: 0x68}
CW, CCW, HELIX_CW, HELIX_CCW = 0x64, 0x65, 0x69, 0x6A
COUNT_CW, COUNT_CCW = 0x6B, 0x6C  # helical calculation
DECELERATE, ENOUGH = 0x6D, 1 << 32  # clocks
STEADY = Move(SV=10_000, DV=10_000)
PERIOD = SECOND // 10_000
rotations = pytest.mark.parametrize("clockwise", [True, False], ids=["cw", "ccw"])


def prepared(axes=X | Y, main=STEADY, ipm=0):
    """An MCX514 whose lowest axis has the speed of the path."""
    chip = MCX514()
    prepare(chip, main, axes & -axes)
    load(chip, IPM=axes | ipm)
    return chip


def list_axes(axes):
    """List the bits of the selected axes, the lowest first."""
    return [axis for axis in AXES if axes & axis]


def line(chip, finish, axes=X | Y):
    """Write a straight segment and its command."""
    for axis, value in zip(list_axes(axes), finish, strict=True):
        load(chip, axis, TP=value)
    command(chip, LINEAR[len(finish)], 0)


def arc(chip, centre, finish, clockwise, axes=X | Y):
    for axis, c, f in zip(list_axes(axes), centre, finish, strict=True):
        load(chip, axis, CP=c, TP=f)
    command(chip, CW if clockwise else CCW, 0)


def ticks(chip, clocks=ENOUGH, axes=X | Y):
    """Let it run: the clock since now of each tick, and the steps of the axes in it."""
    began, numbers = chip.clock, [AXES.index(axis) for axis in list_axes(axes)]
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


def random_axes(rng, count):
    return sum(rng.sample(AXES, count))


def assert_circular(steps, centre, finish, clockwise, note):
    assert steps, note
    path, radius = points(steps), math.hypot(*centre)
    assert max(circle_errors(path, centre)) <= 1 + 1e-9, note
    if finish == (0, 0):
        assert path[-1] == (0, 0), f"a closed circle ends where it began\n{note}"
    assert_ends(path[-1], centre, finish, clockwise, note)
    # the finish point is rounded, the end is beside it: some 3 LSB of arc
    missed = angles(path, centre, clockwise)[-1] - arc_angle(centre, finish, clockwise)
    assert abs(missed) * radius < 3, f"{missed} rad, {len(steps)} ticks\n{note}"
    assert_the_faster_axis_steps(steps, path, centre, clockwise, note)


def assert_ends(at, centre, finish, clockwise, note):
    """Assert that the faster axis is at the finish point in the last octant; beside a border the octant may end first."""
    x, y = (f - c for f, c in zip(finish, centre, strict=True))
    fast = OCTANTS[octant_behind(x, y, clockwise)][0]
    assert abs(at[fast] - finish[fast]) <= (abs(abs(x) - abs(y)) <= 1), f"ends at {at}\n{note}"
    assert max(abs(a - f) for a, f in zip(at, finish, strict=True)) <= 1, f"ends at {at}\n{note}"


def assert_the_faster_axis_steps(steps, path, centre, clockwise, note):
    at = (0, 0)
    for k, (step, after) in enumerate(zip(steps, path, strict=True), 1):
        x, y = (a - c for a, c in zip(at, centre, strict=True))
        if abs(abs(x) - abs(y)) > 2:  # at a border between octants either axis may
            fast, ahead, _ = OCTANTS[octant_ahead(x, y, clockwise)]
            assert step[fast] == (-ahead if clockwise else ahead), f"tick {k} from {at}: {step}\n{note}"
        at = after
