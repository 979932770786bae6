"""Compiled speed thresholds of the TMC5160: TSTEP, and the limits on it that select StealthChop, CoolStep and StallGuard."""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage
from pulsestage_trinamic.tmc5160 import state
from stage.native import hot, least


@hot
def is_emergency_stop_active(c):
    """Return whether the emergency stop suppresses all steps: stop_enable is set, and ENCA was high at the last clock."""
    return c.reg[state.GCONF] & state.STOP_ENABLE and c.enc_pins & 1


@hot
def is_stealth_chop_active(c):
    return c.reg[state.GCONF] & state.EN_PWM and not c.speeds


@hot
def is_stall_stop_possible(c):
    """Return whether the speed allows a stall to stop the motor and to set status_sg."""
    return (
        c.speeds & state.COOL
        and not is_stealth_chop_active(c)
        and not (c.speeds & state.HIGH and c.reg[state.CHOPCONF] & state.VHIGHFS)
    )


@hot
def compute_tstep(c, speed):
    """Return TSTEP, clocks per 1/256 step, at speed q."""
    v = speed >> state.SPEED_SHIFT
    if v == 0 or is_emergency_stop_active(c):
        return state.MAX_TSTEP
    return least(state.MAX_TSTEP, ((1 << 24) // v) >> state.get_step_shift(c))


@hot
def _get_bit_if_passed(c, bit, threshold, excludes_equal, tstep):
    """Return the bit of a speed threshold if TSTEP has passed the threshold, else 0."""
    upper = threshold * 31 // 32 - 1 if c.reg[state.GCONF] & state.SMALL_HYSTERESIS else threshold * 15 // 16 - 1
    return common_power_stage.get_bit_if_passed(c.speeds, bit, threshold, upper, excludes_equal, tstep)


@hot
def find_passed_thresholds(c, speed):
    """Return the thresholds that are passed when the speed becomes q, as bits SLOW, COOL and HIGH."""
    slow, cool, high = c.reg[state.TPWMTHRS], c.reg[state.TCOOLTHRS], c.reg[state.THIGH]
    if not (slow | cool | high):
        return 0
    t = compute_tstep(c, speed)
    return (
        _get_bit_if_passed(c, state.SLOW, slow, True, t)
        | _get_bit_if_passed(c, state.COOL, cool, False, t)
        | _get_bit_if_passed(c, state.HIGH, high, False, t)
    )
