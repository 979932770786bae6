"""Compiled connection of the lines with the driver of the TMC5160: each step of the lines is a step of its sequencer.

The chip's part of the state runs in its own clock. It is brought to the present time before it acts, so nothing runs while
neither steps nor timers are due.
"""

from __future__ import annotations

from pulsestage_trinamic import motor_field
from pulsestage_trinamic.tmc5160 import bus, power_stage, speed_thresholds, stallguard
from pulsestage_trinamic.tmc5160 import state as chip
from pulsestage_trinamic.tmc5160_step_dir import state
from stage.chips.stepdir.state import DIR, ENABLE, STEP
from stage.native import hot, least

FAULTS = chip.S2GA | chip.S2GB | chip.S2VSA | chip.S2VSB | chip.OT | chip.OTPW | chip.OLA | chip.OLB | chip.UV_CP
FAULT_SHIFT = chip.S2GA.bit_length() - 1 - state.FIRST_FAULT
SPEED_AT_STEP_PER_CLOCK = 1 << 41
"""Speed of the ramp generator at which a step comes each clock."""


@hot
def update_clock(c):
    """Advance the clock of the TMC5160 to the present time of the axis."""
    d = c.driver[0]
    d.clock = c.clock // c.hz * d.hz + c.clock % c.hz * d.hz // c.hz


@hot
def find_next_timer_clock(c):
    """Return the clock of the axis at which the TMC5160's next standstill timer ends, or NEVER."""
    d = c.driver[0]
    at = power_stage.find_next_timer_clock(d)
    if d.q:
        at = least(at, d.last + _get_standstill_clocks(d))
    if at >= chip.NEVER:
        return state.NEVER
    return (at // d.hz) * c.hz + (at % d.hz * c.hz + d.hz - 1) // d.hz


@hot
def _get_standstill_clocks(d):
    return 1 << (18 if d.reg[chip.GCONF] & chip.FAST_STANDSTILL else 20)


@hot
def process_standstill_timers(c):
    """Process the standstill timers of the TMC5160 that end now."""
    update_clock(c)
    d = c.driver[0]
    if d.q and power_stage.is_at_standstill(d):
        d.q = d.dir = 0
        stallguard.update_stallguard_and_coolstep(d)
    power_stage.process_standstill_timers(d)


@hot
def copy_pins_to_chip(c):
    """Pass the pins of the STEP/DIR axis to its TMC5160."""
    update_clock(c)
    d = c.driver[0]
    word = c.inputs << FAULT_SHIFT & FAULTS if FAULT_SHIFT >= 0 else c.inputs >> -FAULT_SHIFT & FAULTS
    word |= (chip.REFL if c.inputs & STEP else 0) | (chip.REFR if c.inputs & DIR else 0)
    d.inputs = word | chip.SD_MODE | (0 if c.inputs & ENABLE else chip.DRV_ENN)
    power_stage.latch_faults(d)
    stallguard.clear_result_if_unmeasured(d)


@hot
def follow_steps(c):
    """Let the TMC5160 make the steps that were counted at the STEP line since the last call."""
    steps = c.net - c.followed
    c.followed = c.net
    for _ in range(abs(steps)):
        _make_step(c, 1 if steps > 0 else -1)


@hot
def _make_step(c, direction):
    update_clock(c)
    d = c.driver[0]
    was_at_rest = power_stage.is_at_standstill(d)
    period = d.clock - d.last
    d.q = 0 if was_at_rest or period <= 0 else SPEED_AT_STEP_PER_CLOCK // period
    d.dir = direction
    stallguard.update_stallguard_and_coolstep(d)
    before, since = d.net, c.moved_at[(c.moves - 1) % len(c.moved_at)] if c.moves else c.clock
    stallguard.make_measured_step(d)
    interpolates = d.reg[chip.CHOPCONF] & state.INTPOL and not was_at_rest
    motor_field.move_field(c, d.net - before, c.clock - since if interpolates else 0)


@hot
def compute_input_word(c):
    """Return the input pins of the axis, with DIAG0 and DIAG1 as GCONF assigns them with SD_MODE high."""
    d = c.driver[0]
    gconf = d.reg[chip.GCONF]
    stall = d.stall and speed_thresholds.is_stall_stop_possible(d)
    error = d.shorts or d.hot or d.inputs & chip.UV_CP
    diag0 = (
        (gconf & state.DIAG0_ERROR and error)
        or (gconf & state.DIAG0_OTPW and d.inputs & chip.OTPW)
        or (gconf & state.DIAG0_STALL and stall)
    )
    diag1 = (gconf & state.DIAG1_STALL and stall) or (
        gconf & state.DIAG1_INDEX and d.mscnt < 1 << chip.get_step_shift(d)
    )
    return c.inputs | (state.DIAG0 if diag0 else 0) | (state.DIAG1 if diag1 else 0)


@hot
def get_register_value(c, register):
    """Return the value of a TMC5160 register, including registers that a host cannot read."""
    if register == chip.IOIN:
        copy_pins_to_chip(c)  # the level of STEP
    update_clock(c)
    return bus.get_register_value(c.driver[0], register)
