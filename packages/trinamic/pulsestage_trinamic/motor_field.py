"""Compiled place of a motor's field on a STEP/DIR axis, in 1/256 full steps, and its interpolation between steps.

A chip whose microsteps change at run time counts the places of its field in the finest microsteps. With interpolation, a step moves
the field evenly in the time between the step before and itself, so that the field is a step behind.
"""

from __future__ import annotations

import math

from stage.chips.stepdir.state import HISTORY
from stage.native import floor, hot, least

STATE_FIELDS = [
    ("field", "i8"),  # place of the field since power-up, after all steps
    ("unit", "i8"),  # places in a microstep of the axis' Drive
    ("moves", "i8"),  # number of steps of the field
    ("moved_at", "i8", (HISTORY,)),  # clock of each of the last steps
    ("moved_by", "i8", (HISTORY,)),  # places that the field moves
    ("moved_in", "i8", (HISTORY,)),  # clocks in which interpolation moves it there; 0: at once
]
"""Fields of the state of a chip."""
PLACES_PER_FULL_STEP = 256
PLACE_ANGLE = math.pi / 2 / PLACES_PER_FULL_STEP
"""Electrical radians of one place, which is 1/256 full step."""


@hot
def move_field(c, places, clocks):
    """Move the field by `places`, 1/256 full steps each, evenly over the next `clocks` clocks, or at once if `clocks` is 0."""
    k = c.moves % HISTORY
    c.moved_at[k], c.moved_by[k], c.moved_in[k] = c.clock, places, clocks
    c.moves += 1
    c.field += places


@hot
def count_moves(c):
    """Return the number of steps that the motor's field has made."""
    return c.moves


@hot
def compute_lag(c, at):
    """Return by how many places (1/256 full steps) the interpolated field is behind the field at clock `at`."""
    lag = 0.0
    for j in range(least(c.moves, HISTORY)):
        k = (c.moves - 1 - j) % HISTORY
        rest = c.moved_at[k] + c.moved_in[k] - at
        if rest <= 0:
            break
        if c.moved_in[k]:
            lag += c.moved_by[k] * least(1.0, float(rest) / c.moved_in[k])
    return lag


@hot
def compute_mean_position(c, clocks):
    """Return the mean place of the interpolated field over the last `clocks` clocks.

    A step moves the field evenly in the time between the step before and itself, or at once. The function integrates what each
    step has still left to move.
    """
    missing = 0.0
    begin = c.clock - clocks
    for j in range(least(c.moves, HISTORY)):
        k = (c.moves - 1 - j) % HISTORY
        since, lasts = float(c.moved_at[k]) - begin, float(c.moved_in[k])
        if since + lasts <= 0.0:
            break
        missing += c.moved_by[k] * (
            _integrate_remaining_motion(since, lasts, 0.0) - _integrate_remaining_motion(since, lasts, clocks)
        )
    return c.field - missing / clocks


@hot
def _integrate_remaining_motion(since, lasts, x):
    """Integrate, from clock `x` on, the share of a step that is left: 1 until clock `since`, then falling to 0 within `lasts`."""
    if x <= since:
        return since - x + 0.5 * lasts
    rest = since + lasts - x
    return 0.5 * rest * rest / lasts if rest > 0.0 else 0.0


@hot
def compute_net_count(c):
    """Return the place of the interpolated field now, in microsteps of the axis' Drive."""
    return int(floor((c.field - compute_lag(c, c.clock)) / c.unit + 0.5))


@hot
def correct_load_angle(c, angle):
    """Convert a load angle measured from the count `compute_net_count` to one measured from the interpolated field, radians."""
    return angle + (c.field - compute_lag(c, c.clock) - compute_net_count(c) * c.unit) * PLACE_ANGLE
