"""Conversion of speeds, accelerations and jerks between registers of the NOVA chips and plans; compiled."""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.planner import write_pair
from stage.chips.nova.motion.profile import CLOCKS_PER_SECOND, compute_acceleration, compute_speed
from stage.native import greatest, hot, least

RANGE = 8_000_000


@hot
def has_profile(x):
    """Return whether the profile of the axis is in force: it drives, or is the main axis of an interpolation."""
    return x.driving or x.interpolates == state.MAIN


@hot
def _divide_integers(a, b):
    """Return the quotient of two integers as a double-double."""
    return dd.div(dd.from_integer(a), dd.from_integer(b))


@hot
def convert_speed(c, x, value):
    """Convert a speed parameter to pulses per clock.

    A value beyond its range counts as the end of the range, so that two pulses never begin at once.

    Args:
        c: State of the chip.
        x: State of the axis.
        value: Value of the parameter.
    """
    if c.variant == state.MCX514_TYPE:
        return _divide_integers(least(greatest(value, 1), RANGE), CLOCKS_PER_SECOND)
    fastest = RANGE // 1000
    return dd.div(
        dd.from_integer(least(greatest(value, 1), fastest) * RANGE), dd.from_integer(CLOCKS_PER_SECOND * _clip_range(x))
    )


@hot
def _clip_range(x):
    """Return the register R, limited to its range: multiples 1 to 500."""
    return least(greatest(x.reg[state.R], RANGE // 500), RANGE)


@hot
def _convert_acceleration(c, x, value):
    """Convert an acceleration parameter to pulses per clock squared."""
    if c.variant == state.MCX514_TYPE:
        return dd.div(_divide_integers(greatest(value, 1), CLOCKS_PER_SECOND), dd.from_integer(CLOCKS_PER_SECOND))
    return dd.div(
        dd.div(dd.from_integer(125 * greatest(value, 1) * RANGE), dd.from_integer(CLOCKS_PER_SECOND * _clip_range(x))),
        dd.from_integer(CLOCKS_PER_SECOND),
    )


@hot
def _convert_jerk(c, x, value):
    """Convert a jerk parameter to pulses per clock cubed."""
    if c.variant == state.MCX514_TYPE:
        return dd.div(
            dd.div(_divide_integers(greatest(value, 1), CLOCKS_PER_SECOND), dd.from_integer(CLOCKS_PER_SECOND)),
            dd.from_integer(CLOCKS_PER_SECOND),
        )
    up = dd.div(dd.from_integer(62_500_000 * RANGE), dd.from_integer(greatest(value, 1) * _clip_range(x)))
    return dd.div(
        dd.div(dd.div(up, dd.from_integer(CLOCKS_PER_SECOND)), dd.from_integer(CLOCKS_PER_SECOND)),
        dd.from_integer(CLOCKS_PER_SECOND),
    )


@hot
def read_speed(c, x):
    """Return what CV reads: the present speed in the unit of the speed parameters."""
    if not has_profile(x):
        return 0
    v = compute_speed(x, c.clock - x.origin) * CLOCKS_PER_SECOND
    if c.variant != state.MCX514_TYPE:
        v *= _clip_range(x) / RANGE
    return int(v + 1e-6)


@hot
def read_acceleration(c, x):
    """Return what CA reads: the magnitude of the present acceleration in the unit of its parameter."""
    if not has_profile(x):
        return 0
    a = abs(compute_acceleration(x, c.clock - x.origin)) * CLOCKS_PER_SECOND * CLOCKS_PER_SECOND
    if c.variant != state.MCX514_TYPE:
        a *= _clip_range(x) / RANGE / 125.0
    return int(a + 1e-6)


@hot
def load_drive_speed(c, x, value):
    """Set the drive speed of the plan; HV replaces the value during the slow steps of a home search.

    Args:
        c: State of the chip.
        x: State of the axis.
        value: Value of DV or V.
    """
    write_pair(x.dv, convert_speed(c, x, x.reg[state.HV] if x.drives_at_hv else value))


@hot
def load_rates(c, x):
    """Set the initial speed, accelerations and jerks of the plan from the registers, at the start of a drive."""
    write_pair(x.sv, convert_speed(c, x, x.reg[state.SV]))
    write_pair(x.acceleration, _convert_acceleration(c, x, x.reg[state.AC]))
    write_pair(x.deceleration, _convert_acceleration(c, x, x.reg[state.DC] if x.asymmetric else x.reg[state.AC]))
    jerk = x.reg[state.JK] if c.variant == state.MCX514_TYPE else x.reg[state.K]
    other = x.reg[state.DJ] if c.variant == state.MCX514_TYPE else x.reg[state.L] if c.has_l else jerk
    write_pair(x.acceleration_jerk, _convert_jerk(c, x, jerk))
    write_pair(x.deceleration_jerk, _convert_jerk(c, x, other if x.asymmetric else jerk))
    x.curved = x.s_curve
    write_pair(x.min_visible_acceleration, _convert_acceleration(c, x, 1) if c.errata and x.fixed else dd.ZERO)
