"""TMC5160, compiled: the power stage. Currents at work and at standstill, and faults."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import hot, least

FULL_SCALE = 0.325  # V at RSENSE, with CS = 31 and GLOBALSCALER = 256
DELAY = 18  # times are in 2^18 clocks


@hot
def on(c):
    """Return whether the power stage drives the motor."""
    enabled = c.reg[state.CHOPCONF] & 15 and not c.inputs & state.DRV_ENN
    return enabled and not (c.shorts or c.hot or c.inputs & state.UV_CP)


@hot
def irun(c):
    return c.reg[state.IHOLD_IRUN] >> 8 & 31


@hot
def ihold(c):
    return c.reg[state.IHOLD_IRUN] & 31


@hot
def amplitude(c):
    """Return the amplitude of the phase currents, A."""
    if not on(c):
        return 0.0
    if c.current == state.HOLDS and c.cs == 0 and c.reg[state.GCONF] & state.EN_PWM and c.reg[state.PWMCONF] >> 20 & 3:
        return 0.0
    scale = c.reg[state.GLOBALSCALER]
    return (256 if scale == 0 else scale) / 256.0 * (c.cs + 1) / 32.0 * FULL_SCALE / c.rsense


# --- time at standstill ---


@hot
def _limit(c):
    return 1 << (18 if c.reg[state.GCONF] & state.FAST_STANDSTILL else 20)


@hot
def stands(c):
    """Return whether the motor stands still (DRV_STATUS bit 31, stst)."""
    return c.clock - c.last >= _limit(c)


@hot
def next_timer(c):
    """Return the clock at which the standstill next changes something."""
    stops = c.last + _limit(c)
    at = state.NEVER
    if c.sg or c.stall or c.summed:
        at = stops
    if c.current == state.RUNS:
        at = least(at, stops + (c.reg[state.TPOWERDOWN] << DELAY))
    elif c.current == state.FALLS:
        at = least(at, c.falls)
    return at if at > c.clock else c.clock + 1


@hot
def timers(c):
    """Process the standstill timers: power-down, hold current and freewheeling follow from the time since the last step."""
    stops = c.last + _limit(c)
    if c.clock >= stops and (c.sg or c.stall or c.summed):
        c.sg = c.stall = c.total = c.summed = 0
    delay = (c.reg[state.IHOLD_IRUN] >> 16 & 15) << DELAY
    if c.current == state.RUNS and c.clock >= stops + (c.reg[state.TPOWERDOWN] << DELAY):
        c.current, c.falls = state.FALLS, c.clock + delay
    if c.current == state.FALLS and c.clock >= c.falls:
        if delay == 0:
            c.cs = ihold(c)
        elif c.cs != ihold(c):
            c.cs += 1 if ihold(c) > c.cs else -1
        c.falls += delay
        if c.cs == ihold(c):
            c.current, c.falls = state.HOLDS, state.NEVER


@hot
def currents_written(c):
    """Apply a write of IHOLD_IRUN."""
    if c.current == state.RUNS:
        c.cs = irun(c)
    elif c.current == state.HOLDS:
        c.cs = ihold(c)


# --- faults ---


@hot
def faults(c):
    """Latch the faults that are present, and switch the power stage off."""
    chop = c.reg[state.CHOPCONF]
    if chop & 15 == 0 or c.inputs & state.DRV_ENN:
        c.shorts = 0
    else:
        c.shorts |= c.inputs & (
            (0 if chop & state.DISS2G else state.SHORT_G) | (0 if chop & state.DISS2VS else state.SHORT_VS)
        )
    if c.inputs & state.OT:
        c.hot = 1
    elif not c.inputs & state.OTPW:
        c.hot = 0
    if c.shorts or c.hot:
        c.gstat |= 2
    if c.inputs & state.UV_CP:
        c.gstat |= 4
    if on(c):
        c.powered = 1
