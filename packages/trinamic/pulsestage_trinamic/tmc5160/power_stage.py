"""Compiled power stage of the TMC5160: currents in motion and at standstill, and faults."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import hot, least

FULL_SCALE_V = 0.325  # V at RSENSE, with CS = 31 and GLOBALSCALER = 256
DELAY_SHIFT = 18  # times are in 2^18 clocks


@hot
def is_power_stage_on(c):
    """Return whether the power stage drives the motor."""
    enabled = c.reg[state.CHOPCONF] & 15 and not c.inputs & state.DRV_ENN
    return enabled and not (c.shorts or c.hot or c.inputs & state.UV_CP)


@hot
def read_irun(c):
    return c.reg[state.IHOLD_IRUN] >> 8 & 31


@hot
def read_ihold(c):
    return c.reg[state.IHOLD_IRUN] & 31


@hot
def compute_current_amplitude(c):
    """Return the amplitude of the phase currents, A."""
    if not is_power_stage_on(c):
        return 0.0
    if c.current == state.HOLDS and c.cs == 0 and c.reg[state.GCONF] & state.EN_PWM and c.reg[state.PWMCONF] >> 20 & 3:
        return 0.0
    scale = c.reg[state.GLOBALSCALER]
    return (256 if scale == 0 else scale) / 256.0 * (c.cs + 1) / 32.0 * FULL_SCALE_V / c.rsense


# --- time at standstill ---


@hot
def _get_standstill_clocks(c):
    return 1 << (18 if c.reg[state.GCONF] & state.FAST_STANDSTILL else 20)


@hot
def is_at_standstill(c):
    """Return whether the motor stands still (DRV_STATUS bit 31, stst)."""
    return c.clock - c.last >= _get_standstill_clocks(c)


@hot
def find_next_timer_clock(c):
    """Return the clock at which the next standstill timer ends, at least the next clock."""
    stops = c.last + _get_standstill_clocks(c)
    at = state.NEVER
    if c.sg or c.stall or c.summed:
        at = stops
    if c.current == state.RUNS:
        at = least(at, stops + (c.reg[state.TPOWERDOWN] << DELAY_SHIFT))
    elif c.current == state.FALLS:
        at = least(at, c.falls)
    return at if at > c.clock else c.clock + 1


@hot
def process_standstill_timers(c):
    """Process the standstill timers: clear the StallGuard result, and lower the current step by step after TPOWERDOWN."""
    stops = c.last + _get_standstill_clocks(c)
    if c.clock >= stops and (c.sg or c.stall or c.summed):
        c.sg = c.stall = c.total = c.summed = 0
    delay = (c.reg[state.IHOLD_IRUN] >> 16 & 15) << DELAY_SHIFT
    if c.current == state.RUNS and c.clock >= stops + (c.reg[state.TPOWERDOWN] << DELAY_SHIFT):
        c.current, c.falls = state.FALLS, c.clock + delay
    if c.current == state.FALLS and c.clock >= c.falls:
        if delay == 0:
            c.cs = read_ihold(c)
        elif c.cs != read_ihold(c):
            c.cs += 1 if read_ihold(c) > c.cs else -1
        c.falls += delay
        if c.cs == read_ihold(c):
            c.current, c.falls = state.HOLDS, state.NEVER


@hot
def apply_current_registers(c):
    """Apply a write of IHOLD_IRUN."""
    if c.current == state.RUNS:
        c.cs = read_irun(c)
    elif c.current == state.HOLDS:
        c.cs = read_ihold(c)


# --- faults ---


@hot
def latch_faults(c):
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
    if is_power_stage_on(c):
        c.powered = 1
