"""NOVA chips, compiled: speeds, accelerations and jerks, from registers and back."""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.planner import put
from stage.chips.nova.motion.profile import HZ, acceleration_at, speed_at
from stage.native import greatest, hot, least

RANGE = 8_000_000


@hot
def runs(x):
    """The profile of the axis is in force: it drives, or is the main axis of an interpolation."""
    return x.driving or x.interpolates == state.MAIN


@hot
def _ratio(a, b):
    return dd.div(dd.from_integer(a), dd.from_integer(b))


@hot
def speed(c, x, value):
    """A speed parameter in pulses per clock. What is out of range counts as the range's end: two pulses never begin at once."""
    if c.variant == state.MCX514_TYPE:
        return _ratio(least(greatest(value, 1), RANGE), HZ)
    fastest = RANGE // 1000
    return dd.div(dd.from_integer(least(greatest(value, 1), fastest) * RANGE), dd.from_integer(HZ * _range(x)))


@hot
def _range(x):
    """R in its range: multiples 1 to 500."""
    return least(greatest(x.reg[state.R], RANGE // 500), RANGE)


@hot
def _rate(c, x, value):
    """An acceleration parameter in pulses per clock^2."""
    if c.variant == state.MCX514_TYPE:
        return dd.div(_ratio(greatest(value, 1), HZ), dd.from_integer(HZ))
    return dd.div(
        dd.div(dd.from_integer(125 * greatest(value, 1) * RANGE), dd.from_integer(HZ * _range(x))), dd.from_integer(HZ)
    )


@hot
def _jerk(c, x, value):
    """A jerk parameter in pulses per clock^3."""
    if c.variant == state.MCX514_TYPE:
        return dd.div(dd.div(_ratio(greatest(value, 1), HZ), dd.from_integer(HZ)), dd.from_integer(HZ))
    up = dd.div(dd.from_integer(62_500_000 * RANGE), dd.from_integer(greatest(value, 1) * _range(x)))
    return dd.div(dd.div(dd.div(up, dd.from_integer(HZ)), dd.from_integer(HZ)), dd.from_integer(HZ))


@hot
def speed_reading(c, x):
    """CV: the current speed in the unit of the speed parameters."""
    if not runs(x):
        return 0
    v = speed_at(x, c.clock - x.origin) * HZ
    if c.variant != state.MCX514_TYPE:
        v *= _range(x) / RANGE
    return int(v + 1e-6)


@hot
def rate_reading(c, x):
    """CA: the current acceleration or deceleration in the unit of its parameter; without a sign."""
    if not runs(x):
        return 0
    a = abs(acceleration_at(x, c.clock - x.origin)) * HZ * HZ
    if c.variant != state.MCX514_TYPE:
        a *= _range(x) / RANGE / 125.0
    return int(a + 1e-6)


@hot
def take_speed(c, x, value):
    """The drive speed as it is now; HV in the slow steps of a home search."""
    put(x.dv, speed(c, x, x.reg[state.HV] if x.creeps else value))


@hot
def take_rates(c, x):
    """Initial speed, accelerations and jerks, at the start of a drive."""
    put(x.sv, speed(c, x, x.reg[state.SV]))
    put(x.up, _rate(c, x, x.reg[state.AC]))
    put(x.down, _rate(c, x, x.reg[state.DC] if x.asymmetric else x.reg[state.AC]))
    jerk = x.reg[state.JK] if c.variant == state.MCX514_TYPE else x.reg[state.K]
    other = x.reg[state.DJ] if c.variant == state.MCX514_TYPE else x.reg[state.L] if c.has_l else jerk
    put(x.up_jerk, _jerk(c, x, jerk))
    put(x.down_jerk, _jerk(c, x, other if x.asymmetric else jerk))
    x.curved = x.s_curve
    put(x.finest, _rate(c, x, 1) if c.errata and x.fixed else dd.ZERO)
