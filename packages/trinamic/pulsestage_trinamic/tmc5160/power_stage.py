"""Compiled power stage of the TMC5160: currents in motion and at standstill, and faults."""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage
from pulsestage_trinamic.tmc5160 import state
from stage.native import hot, least

FULL_SCALE_V = 0.325  # V at RSENSE, with CS = 31 and GLOBALSCALER = 256
DELAY_SHIFT = 18  # times are in 2^18 clocks


@hot
def is_power_stage_on(c):
    """Return whether the TMC5160's power stage drives the motor."""
    enabled = c.reg[state.CHOPCONF] & 15 and not c.inputs & state.DRV_ENN
    return enabled and not (c.shorts or c.hot or c.inputs & state.UV_CP)


@hot
def compute_current_amplitude(c):
    """Return the amplitude of the phase currents that the TMC5160 makes, A."""
    if not is_power_stage_on(c):
        return 0.0
    if (
        c.current == common_power_stage.HOLDS
        and c.cs == 0
        and c.reg[state.GCONF] & state.EN_PWM
        and c.reg[state.PWMCONF] >> 20 & 3
    ):
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
    """Return the clock at which the TMC5160's next standstill timer ends, at least the next clock."""
    stops = c.last + _get_standstill_clocks(c)
    at = state.NEVER
    if c.sg or c.stall or c.summed:
        at = stops
    at = least(at, common_power_stage.find_next_reduction(c, stops + (c.reg[state.TPOWERDOWN] << DELAY_SHIFT)))
    return at if at > c.clock else c.clock + 1


@hot
def process_standstill_timers(c):
    """Process the standstill timers: clear the StallGuard result, and lower the current step by step after TPOWERDOWN."""
    stops = c.last + _get_standstill_clocks(c)
    if c.clock >= stops and (c.sg or c.stall or c.summed):
        c.sg = c.stall = c.total = c.summed = 0
    currents = c.reg[state.IHOLD_IRUN]
    begin = stops + (c.reg[state.TPOWERDOWN] << DELAY_SHIFT)
    common_power_stage.reduce_current(c, currents, begin, common_power_stage.get_iholddelay(currents) << DELAY_SHIFT)


# --- faults ---


@hot
def latch_faults(c):
    """Latch the faults of the TMC5160's power stage that are present, and switch the power stage off."""
    chop = c.reg[state.CHOPCONF]
    is_driving = chop & 15 and not c.inputs & state.DRV_ENN
    common_power_stage.latch_faults(c, is_driving, chop, state.SHORT_G, state.SHORT_VS, state.OT, state.OTPW)
    if c.inputs & state.UV_CP:
        c.gstat |= common_power_stage.UV_CP
    if is_power_stage_on(c):
        c.powered = 1
