"""Compiled StallGuard2 and CoolStep of the TMC5160: the load measured at each full step, and the current that follows it."""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage, cool_step, load_measurement
from pulsestage_trinamic.tmc5160 import microstep_sequencer, power_stage, speed_thresholds, state
from stage.native import hot, least

RESULT_PER_SGT, FULL_EMF, UNLOADED_RESULT = 8, 1024, 1023  # model of StallGuard, tmc5160_sheet.md, section 6


@hot
def is_measuring(c):
    """Return whether StallGuard measures at each full step."""
    return power_stage.is_power_stage_on(c) and not speed_thresholds.is_stealth_chop_active(c)


@hot
def clear_result_if_unmeasured(c):
    """Clear the StallGuard result while StallGuard does not measure."""
    if not is_measuring(c):
        c.sg = c.stall = 0


@hot
def is_cool_step_active(c):
    return (
        c.reg[state.COOLCONF] & 15
        and c.speeds & state.COOL
        and not c.speeds & state.HIGH
        and not speed_thresholds.is_stealth_chop_active(c)
    )


@hot
def update_stallguard_and_coolstep(c):
    """Update thresholds, StallGuard and CoolStep after a change of speed, registers or faults, in which they start or stop."""
    c.speeds = speed_thresholds.find_passed_thresholds(c, c.q)
    clear_result_if_unmeasured(c)
    cool_step.set_active(c, is_cool_step_active(c), common_power_stage.get_irun(c.reg[state.IHOLD_IRUN]))


@hot
def make_measured_step(c):
    """Make one step, measure the load if it completes a full step, and return whether a stall stops the motor."""
    before = c.mscnt >> 8
    microstep_sequencer.make_steps(c, 1, c.clock)
    if c.mscnt >> 8 == before or not is_measuring(c):
        return False
    return _measure_load(c)


@hot
def _measure_load(c):
    c.full += 1
    sgt = c.reg[state.COOLCONF] >> 16 & 127
    raw = (UNLOADED_RESULT * c.emf * (FULL_EMF - c.lam)) >> 20
    value = raw + RESULT_PER_SGT * (sgt - 128 if sgt > 63 else sgt)
    value = 0 if value < 0 else least(value, 1023)
    if c.reg[state.COOLCONF] & state.SFILT:
        c.total += value
        c.summed += 1
        if c.summed < 4:
            return False
        value = c.total >> 2
    c.total = c.summed = 0
    c.sg = value
    c.stall = 1 if value == 0 else 0
    if c.cooling:
        cool_step.adapt_current(c, c.reg[state.COOLCONF], common_power_stage.get_irun(c.reg[state.IHOLD_IRUN]))
    if c.stall and c.reg[state.SW_MODE] & state.SG_STOP and speed_thresholds.is_stall_stop_possible(c):
        c.events |= state.EVENT_SG
        return True
    return False


@hot
def set_fixed_load(c, lam, emf):
    """Set the motor's load for a chip that is not on a stage; LAM and EMF are those of tmc5160_sheet.md, section 6."""
    c.lam, c.emf = lam, emf


@hot
def add_load_sample(c, lam, emf):
    """Take a sample of the motor's load, and return whether StallGuard measures it.

    The measurement uses the means of LAM and EMF over a full step.
    """
    if c.dir == 0 or not is_measuring(c):
        return 0
    load_measurement.add_load_sample(c, lam, emf)
    return 1
