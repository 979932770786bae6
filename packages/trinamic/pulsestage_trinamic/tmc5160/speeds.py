"""TMC5160, compiled: speed as TSTEP, and the thresholds on it that choose what the driver does."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import hot, least


@hot
def gated(c):
    """Return whether the emergency stop suppresses all steps; ENCA as of the last clock."""
    return c.reg[state.GCONF] & state.STOP_ENABLE and c.enc_pins & 1


@hot
def stealth(c):
    return c.reg[state.GCONF] & state.EN_PWM and not c.speeds


@hot
def window(c):
    """Return whether a stall stops the motor and is shown by status_sg."""
    return (
        c.speeds & state.COOL
        and not stealth(c)
        and not (c.speeds & state.HIGH and c.reg[state.CHOPCONF] & state.VHIGHFS)
    )


@hot
def tstep(c, q):
    """Return TSTEP at a speed."""
    v = q >> state.UNIT
    if v == 0 or gated(c):
        return state.TSTEP_MOST
    return least(state.TSTEP_MOST, ((1 << 24) // v) >> state.mres(c))


@hot
def _passed(c, was, bit, threshold, strictly, t):
    if threshold == 0:
        return 0
    low = threshold * 31 // 32 - 1 if c.reg[state.GCONF] & state.SMALL_HYSTERESIS else threshold * 15 // 16 - 1
    if t <= low:
        return bit
    if t > threshold or (strictly and t == threshold):
        return 0
    return was & bit


@hot
def speeds_at(c, q):
    """Return the thresholds that are passed when the speed becomes q."""
    slow, cool, high = c.reg[state.TPWMTHRS], c.reg[state.TCOOLTHRS], c.reg[state.THIGH]
    if not (slow | cool | high):
        return 0
    t, was = tstep(c, q), c.speeds
    return (
        _passed(c, was, state.SLOW, slow, True, t)
        | _passed(c, was, state.COOL, cool, False, t)
        | _passed(c, was, state.HIGH, high, False, t)
    )
