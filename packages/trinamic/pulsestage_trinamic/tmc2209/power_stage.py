"""Compiled power stage of the TMC2209: the field that follows the steps, currents, speed thresholds, StallGuard4 and faults.

Times are in clocks of the axis, whose frequency is `c.hz`; the chip's own clock has `c.f_clk` Hz.
"""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage, cool_step, motor_field
from pulsestage_trinamic.tmc2209 import state
from stage.chips.stepdir.state import ENABLE
from stage.native import greatest, hot, least

FULL_SCALE_V, SENSITIVE_FULL_SCALE_V = 0.325, 0.180
"""Volts at the sense resistor and the chip's own resistance, with CS = 31, by vsense."""
INTERNAL_OHM = 0.02
STANDSTILL_CLOCKS = 1 << 20
DELAY_CLOCKS = 1 << 18
UNLOADED_SG_RESULT = 510
"""SG_RESULT of a motor without load whose back EMF is the whole voltage, see tmc2209_sheet.md."""


@hot
def to_axis_clocks(c, chip_clocks):
    """Convert clocks of the TMC2209 to clocks of the axis."""
    return chip_clocks // c.f_clk * c.hz + chip_clocks % c.f_clk * c.hz // c.f_clk


@hot
def get_step_shift(c):
    """Return MRES of the TMC2209: a step is 2^MRES of 1/256 full step."""
    if c.registers[state.GCONF] & state.MSTEP_REG_SELECT:
        return least(8, c.registers[state.CHOPCONF] >> 24 & 15)
    if c.inputs & state.MS1:
        return 4 if c.inputs & state.MS2 else 3  # 16, 32 microsteps
    return 2 if c.inputs & state.MS2 else 5  # 64, 8 microsteps


@hot
def is_spread_cycle_selected(c):
    """Return whether SpreadCycle is selected at all speeds: the pin SPREAD inverts the bit."""
    return ((c.registers[state.GCONF] & state.EN_SPREADCYCLE) != 0) != ((c.inputs & state.SPREAD) != 0)


@hot
def is_stealth_chop_active(c):
    return not is_spread_cycle_selected(c) and not c.passed & state.FAST


@hot
def is_power_stage_on(c):
    """Return whether the power stage drives the motor."""
    return c.registers[state.CHOPCONF] & 15 and c.inputs & ENABLE and not (c.shorts or c.hot or c.inputs & state.UV_CP)


# --- currents ---


@hot
def is_current_reduced_at_rest(c):
    """Return whether the current falls to IHOLD at standstill: always with pdn_disable, else while PDN_UART is low."""
    return c.registers[state.GCONF] & state.PDN_DISABLE or not c.inputs & state.PDN


@hot
def compute_current_amplitude(c):
    """Return the amplitude of the phase currents, A."""
    if not is_power_stage_on(c):
        return 0.0
    if (
        c.current == common_power_stage.HOLDS
        and c.cs == 0
        and c.registers[state.PWMCONF] >> 20 & 3
        and is_stealth_chop_active(c)
    ):
        return 0.0
    volts = SENSITIVE_FULL_SCALE_V if c.registers[state.CHOPCONF] & state.VSENSE else FULL_SCALE_V
    if c.registers[state.GCONF] & state.I_SCALE_ANALOG:
        volts *= c.vref
    return (c.cs + 1) / 32.0 * volts / (c.rsense + INTERNAL_OHM)


@hot
def compute_standstill_clock(c):
    """Return the clock from which on the TMC2209 counts the motor as standing still (flag stst)."""
    return c.stepped + to_axis_clocks(c, STANDSTILL_CLOCKS)


@hot
def _compute_reduction_clock(c, standstill):
    """Return the clock at which the current leaves IRUN, TPOWERDOWN after the standstill, or NEVER."""
    if not is_current_reduced_at_rest(c):
        return state.NEVER
    return standstill + to_axis_clocks(c, c.registers[state.TPOWERDOWN] * DELAY_CLOCKS)


@hot
def find_next_timer_clock(c):
    """Return the clock at which the TMC2209's next standstill timer ends, or NEVER."""
    at = state.NEVER
    standstill = compute_standstill_clock(c)
    if c.period or c.stall or c.sg:
        at = standstill
    at = least(at, common_power_stage.find_next_reduction(c, _compute_reduction_clock(c, standstill)))
    return at if at > c.clock else c.clock


@hot
def process_standstill_timers(c):
    """Process the TMC2209's standstill timers that end at this clock."""
    standstill = compute_standstill_clock(c)
    if c.clock >= standstill and (c.period or c.stall or c.sg):
        c.period = c.stall = c.sg = 0
        update_thresholds(c)
    currents = c.registers[state.IHOLD_IRUN]
    delay = to_axis_clocks(c, common_power_stage.get_iholddelay(currents) * DELAY_CLOCKS)
    common_power_stage.reduce_current(c, currents, _compute_reduction_clock(c, standstill), delay)


@hot
def apply_current_registers(c):
    """Apply a write of the current register IHOLD_IRUN, and a change of what reduces the current at rest."""
    if not is_current_reduced_at_rest(c):
        common_power_stage.raise_current(c, c.registers[state.IHOLD_IRUN])
    common_power_stage.apply_current_register(c, c.registers[state.IHOLD_IRUN])


# --- speed ---


@hot
def compute_tstep(c):
    """Return TSTEP, clocks of the chip per 1/256 step, from the time between the last two steps."""
    if c.period == 0 or c.clock >= compute_standstill_clock(c):
        return state.MAX_TSTEP
    per_step = greatest(c.period, c.clock - c.stepped) * c.f_clk // c.hz
    return least(state.MAX_TSTEP, per_step >> get_step_shift(c))


@hot
def _get_bit_if_passed(c, bit, threshold, excludes_equal, tstep):
    """Return the bit of a speed threshold if TSTEP has passed the threshold, else 0."""
    upper = threshold * 15 // 16 - 1
    return common_power_stage.get_bit_if_passed(c.passed, bit, threshold, upper, excludes_equal, tstep)


@hot
def update_thresholds(c):
    """Update the speed thresholds of the TMC2209, and what depends on them."""
    tstep = compute_tstep(c)
    c.passed = _get_bit_if_passed(c, state.FAST, c.registers[state.TPWMTHRS], True, tstep) | _get_bit_if_passed(
        c, state.COOL, c.registers[state.TCOOLTHRS], False, tstep
    )
    if not is_measuring(c):
        c.sg = c.stall = 0
    cool_step.set_active(c, is_cool_step_active(c), common_power_stage.get_irun(c.registers[state.IHOLD_IRUN]))


# --- StallGuard4 ---


@hot
def is_measuring(c):
    """Return whether StallGuard4 measures the load: in StealthChop only."""
    return is_power_stage_on(c) and is_stealth_chop_active(c)


@hot
def is_stall_output_enabled(c):
    """Return whether a stall shows at DIAG: in StealthChop, while TCOOLTHRS >= TSTEP > TPWMTHRS."""
    return c.passed & state.COOL and is_measuring(c)


@hot
def is_cool_step_active(c):
    return c.registers[state.COOLCONF] & 15 and is_stall_output_enabled(c)


@hot
def compute_sg_result(c):
    """Return SG_RESULT, the load value of StallGuard4, for the mean load of the present full step.

    The share of the back EMF in the voltage of the winding, e / (e + I R), rises with speed and falls with current; the load
    takes its part of it. With LAM as a share of the greatest torque at the present current, more current gives more result under
    the same load.
    """
    emf = c.emf / 1024.0
    volts = emf + compute_current_amplitude(c) * c.ir_share
    share = emf / volts if volts > 0.0 else 1.0
    return int(UNLOADED_SG_RESULT * share * (1024 - c.lam) / 1024.0) & ~1


@hot
def measure_load(c):
    """Measure the motor's load at the end of a full step, as StallGuard4 does."""
    c.full += 1
    if not is_measuring(c):
        return
    c.sg = compute_sg_result(c)
    c.stall = 1 if c.sg <= 2 * c.registers[state.SGTHRS] and is_stall_output_enabled(c) else 0
    if c.cooling:
        cool_step.adapt_current(
            c, c.registers[state.COOLCONF], common_power_stage.get_irun(c.registers[state.IHOLD_IRUN])
        )


# --- the field ---


@hot
def move_field(c, places):
    """Move the motor's field by one step of `places` 1/256 full steps, and raise the current to IRUN."""
    if places == 0:
        return
    has_stopped = c.clock >= compute_standstill_clock(c)
    c.period = 0 if has_stopped else c.clock - c.stepped
    before = c.mscnt >> 8
    motor_field.move_field(c, places, c.period if c.registers[state.CHOPCONF] & state.INTPOL else 0)
    c.mscnt = c.mscnt + places & 1023
    c.stepped, c.direction = c.clock, 1 if places > 0 else -1
    common_power_stage.raise_current(c, c.registers[state.IHOLD_IRUN])
    update_thresholds(c)
    if c.mscnt >> 8 != before:
        measure_load(c)


@hot
def follow_steps(c):
    """Let the field follow the steps that the lines have counted since the last call."""
    steps = c.net - c.followed
    if steps == 0:
        return
    c.followed = c.net
    if c.registers[state.VACTUAL] == 0:
        places = steps << get_step_shift(c)
        move_field(c, -places if c.registers[state.GCONF] & state.SHAFT else places)


# --- internal steps ---


@hot
def start_internal_steps(c, value):
    """Begin steps of the velocity VACTUAL from now on; 0 returns to STEP and DIR."""
    c.velocity_since, c.velocity_steps, c.next_step = c.clock, 0, state.NEVER
    c.followed = c.net
    if value:
        _schedule_internal_step(c, value)


@hot
def _schedule_internal_step(c, value):
    speed = value if value < 1 << 23 else (1 << 24) - value
    chip_clocks = ((c.velocity_steps + 1) << 24) // speed
    c.next_step = greatest(c.velocity_since + to_axis_clocks(c, chip_clocks), c.clock + 1)
    if c.velocity_steps >= 1 << 16:  # the products stay within 63 bits
        c.velocity_since, c.velocity_steps = c.next_step, -1


@hot
def make_internal_step(c):
    """Make the step that is due at the velocity VACTUAL, which the chip makes without STEP and DIR."""
    value = c.registers[state.VACTUAL]
    places = 1 << get_step_shift(c)
    c.toggle ^= 1
    minus = (value >= 1 << 23) != ((c.registers[state.GCONF] & state.SHAFT) != 0)
    move_field(c, -places if minus else places)
    c.velocity_steps += 1
    _schedule_internal_step(c, value)


# --- faults ---


@hot
def latch_faults(c):
    """Latch the faults of the TMC2209's power stage that are present, and switch the power stage off."""
    chop = c.registers[state.CHOPCONF]
    common_power_stage.latch_faults(
        c, chop & 15 and c.inputs & ENABLE, chop, state.SHORT_G, state.SHORT_VS, state.OT, state.OTPW
    )
    if not is_measuring(c):
        c.sg = c.stall = 0
