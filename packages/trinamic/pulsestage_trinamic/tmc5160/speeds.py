"""TMC5160, compiled: speed as TSTEP, and the thresholds on it that choose what the driver does."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160.state import (
    CHOPCONF,
    COOL,
    EN_PWM,
    GCONF,
    HIGH,
    SLOW,
    SMALL_HYSTERESIS,
    STOP_ENABLE,
    TCOOLTHRS,
    THIGH,
    TPWMTHRS,
    TSTEP_MOST,
    UNIT,
    VHIGHFS,
    mres,
)
from stage.native import hot, least


@hot
def gated(c):
    """The emergency stop holds all steps: ENCA as the last clock saw it."""
    return c.reg[GCONF] & STOP_ENABLE and c.enc_pins & 1


@hot
def stealth(c):
    return c.reg[GCONF] & EN_PWM and not c.speeds


@hot
def window(c):
    """A stall stops, and status_sg shows it."""
    return c.speeds & COOL and not stealth(c) and not (c.speeds & HIGH and c.reg[CHOPCONF] & VHIGHFS)


@hot
def tstep(c, q):
    """TSTEP at a speed."""
    v = q >> UNIT
    if v == 0 or gated(c):
        return TSTEP_MOST
    return least(TSTEP_MOST, ((1 << 24) // v) >> mres(c))


@hot
def _passed(c, was, bit, threshold, strictly, t):
    if threshold == 0:
        return 0
    low = threshold * 31 // 32 - 1 if c.reg[GCONF] & SMALL_HYSTERESIS else threshold * 15 // 16 - 1
    if t <= low:
        return bit
    if t > threshold or (strictly and t == threshold):
        return 0
    return was & bit


@hot
def speeds_at(c, q):
    """The thresholds that are passed when the speed becomes q."""
    slow, cool, high = c.reg[TPWMTHRS], c.reg[TCOOLTHRS], c.reg[THIGH]
    if not (slow | cool | high):
        return 0
    t, was = tstep(c, q), c.speeds
    return (
        _passed(c, was, SLOW, slow, True, t)
        | _passed(c, was, COOL, cool, False, t)
        | _passed(c, was, HIGH, high, False, t)
    )
