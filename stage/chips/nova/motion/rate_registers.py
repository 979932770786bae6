"""Conversion of the registers for speed, acceleration and jerk of the NOVA chips to the units of a speed profile; compiled."""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.profile_evaluation import CLOCKS_PER_SECOND, compute_acceleration, compute_speed
from stage.native import greatest, hot, least

UNIT_MULTIPLE_RANGE = 8_000_000


@hot
def has_profile(axis):
    """Return whether a speed profile moves the axis: the axis drives, or is the main axis of an interpolation."""
    return axis.driving or axis.interpolates == state.MAIN


@hot
def _divide_by_clocks_per_second(value):
    """Return a double-double divided by the number of clocks per second."""
    return dd.divide(value, dd.to_double_double(CLOCKS_PER_SECOND))


@hot
def convert_speed_to_pulses_per_clock(chip, axis, value):
    """Convert a speed parameter to pulses per clock.

    A value beyond its range counts as the end of the range, so that two pulses never begin at once.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        value: Value of the parameter.
    """
    if chip.variant == state.MCX514_TYPE:
        return _divide_by_clocks_per_second(dd.to_double_double(least(greatest(value, 1), UNIT_MULTIPLE_RANGE)))
    fastest = UNIT_MULTIPLE_RANGE // 1000
    return dd.divide(
        dd.to_double_double(least(greatest(value, 1), fastest) * UNIT_MULTIPLE_RANGE),
        dd.to_double_double(CLOCKS_PER_SECOND * _clip_range_register(axis)),
    )


@hot
def _clip_range_register(axis):
    """Return the register R, limited to its range: multiples 1 to 500."""
    return least(greatest(axis.reg[state.R], UNIT_MULTIPLE_RANGE // 500), UNIT_MULTIPLE_RANGE)


@hot
def _convert_acceleration_to_pulses_per_clock2(chip, axis, value):
    """Convert an acceleration parameter to pulses per clock squared."""
    if chip.variant == state.MCX514_TYPE:
        per_clock = _divide_by_clocks_per_second(dd.to_double_double(greatest(value, 1)))
    else:
        per_clock = dd.divide(
            dd.to_double_double(125 * greatest(value, 1) * UNIT_MULTIPLE_RANGE),
            dd.to_double_double(CLOCKS_PER_SECOND * _clip_range_register(axis)),
        )
    return _divide_by_clocks_per_second(per_clock)


@hot
def _convert_jerk_to_pulses_per_clock3(chip, axis, value):
    """Convert a jerk parameter to pulses per clock cubed."""
    if chip.variant == state.MCX514_TYPE:
        jerk = dd.to_double_double(greatest(value, 1))
    else:
        jerk = dd.divide(
            dd.to_double_double(62_500_000 * UNIT_MULTIPLE_RANGE),
            dd.to_double_double(greatest(value, 1) * _clip_range_register(axis)),
        )
    return _divide_by_clocks_per_second(_divide_by_clocks_per_second(_divide_by_clocks_per_second(jerk)))


@hot
def read_speed(chip, axis):
    """Return the value of the register CV: the present speed in the unit of the speed parameters."""
    if not has_profile(axis):
        return 0
    v = compute_speed(axis, chip.clock - axis.origin) * CLOCKS_PER_SECOND
    if chip.variant != state.MCX514_TYPE:
        v *= _clip_range_register(axis) / UNIT_MULTIPLE_RANGE
    return int(v + 1e-6)


@hot
def read_acceleration(chip, axis):
    """Return the value of the register CA: the magnitude of the present acceleration in the unit of the parameter A."""
    if not has_profile(axis):
        return 0
    a = abs(compute_acceleration(axis, chip.clock - axis.origin)) * CLOCKS_PER_SECOND * CLOCKS_PER_SECOND
    if chip.variant != state.MCX514_TYPE:
        a *= _clip_range_register(axis) / UNIT_MULTIPLE_RANGE / 125.0
    return int(a + 1e-6)


@hot
def load_drive_speed(chip, axis, value):
    """Set the drive speed of the plan from DV or V; during the slow steps of a home search HV takes its place.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        value: Value of DV or V.
    """
    value = axis.reg[state.HV] if axis.drives_at_hv else value
    dd.store_pair(axis.dv, convert_speed_to_pulses_per_clock(chip, axis, value))


@hot
def load_rates(chip, axis):
    """Set the initial speed, accelerations and jerks of the plan from the registers, at the start of a drive."""
    dd.store_pair(axis.sv, convert_speed_to_pulses_per_clock(chip, axis, axis.reg[state.SV]))
    dd.store_pair(axis.acceleration, _convert_acceleration_to_pulses_per_clock2(chip, axis, axis.reg[state.AC]))
    deceleration = axis.reg[state.DC] if axis.asymmetric else axis.reg[state.AC]
    dd.store_pair(axis.deceleration, _convert_acceleration_to_pulses_per_clock2(chip, axis, deceleration))
    jerk = axis.reg[state.JK] if chip.variant == state.MCX514_TYPE else axis.reg[state.K]
    other = axis.reg[state.DJ] if chip.variant == state.MCX514_TYPE else axis.reg[state.L] if chip.has_l else jerk
    other = other if axis.asymmetric else jerk
    dd.store_pair(axis.acceleration_jerk, _convert_jerk_to_pulses_per_clock3(chip, axis, jerk))
    dd.store_pair(axis.deceleration_jerk, _convert_jerk_to_pulses_per_clock3(chip, axis, other))
    axis.curved = axis.s_curve
    dd.store_pair(
        axis.min_visible_acceleration,
        _convert_acceleration_to_pulses_per_clock2(chip, axis, 1) if chip.errata and axis.fixed else dd.ZERO,
    )
