"""Compiled register file of the TMC2209: reset, reads, writes and the output pins."""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage
from pulsestage_trinamic.tmc2209 import maps, power_stage, state
from pulsestage_trinamic.tmc5160.microstep_sequencer import compute_current_word
from stage.chips.stepdir.state import DIR, ENABLE, STEP
from stage.native import hot, least

VERSION = 0x21 << 24
MAX_PWM_SCALE = 255


@hot
def reset_registers(c):
    """Set the registers of the TMC2209 to the power-up values of the data sheet.

    Pins, the field's position and board parts stay.
    """
    for k in range(maps.REGISTERS):
        c.registers[k] = maps.RESET_VALUES[k]
    c.followed = c.net
    c.mscnt = c.period = c.full = c.toggle = c.velocity_steps = 0
    c.direction, c.stepped, c.velocity_since, c.next_step = 1, c.clock, c.clock, state.NEVER
    c.current, c.falls = common_power_stage.RUNS, state.NEVER
    common_power_stage.apply_current_register(c, c.registers[state.IHOLD_IRUN])
    c.passed = c.sg = c.stall = c.count = c.cooling = 0
    c.lam, c.emf, c.load_of, c.load_n, c.load_sum, c.emf_sum = 0, 1024, -1, 0, 0, 0
    c.gstat, c.shorts, c.hot, c.ifcnt = 1, 0, 0, 0
    power_stage.latch_faults(c)


@hot
def compute_diag_pin(c):
    """Return whether the TMC2209's output DIAG is high: a stall, or a driver error."""
    return c.stall or c.shorts or c.hot or c.inputs & state.UV_CP


@hot
def compute_index_pin(c):
    """Return whether the output INDEX is high: at the first microstep of each 4 full steps, or what GCONF selects."""
    if c.registers[state.GCONF] & state.INDEX_STEP:
        return c.toggle
    if c.registers[state.GCONF] & state.INDEX_OTPW:
        return c.inputs & state.OTPW
    return c.mscnt < 1 << power_stage.get_step_shift(c)


@hot
def compute_input_word(c):
    """Compute the word that a host reads: the input pins, with the outputs DIAG and INDEX."""
    word = c.inputs | (state.DIAG if compute_diag_pin(c) else 0)
    return word | (state.INDEX if compute_index_pin(c) else 0)


@hot
def _compute_ioin(c):
    word = VERSION | (0 if c.inputs & ENABLE else 1) | (1 << 2 if c.inputs & state.MS1 else 0)
    word |= (1 << 3 if c.inputs & state.MS2 else 0) | (1 << 4 if compute_diag_pin(c) else 0)
    word |= (1 << 6 if c.inputs & state.PDN else 0) | (1 << 7 if c.inputs & STEP else 0)
    return word | (1 << 8 if c.inputs & state.SPREAD else 0) | (1 << 9 if c.inputs & DIR else 0)


@hot
def _compute_drv_status(c):
    word = (1 if c.inputs & state.OTPW else 0) | (2 if c.hot else 0)
    word |= (1 << 2 if c.shorts & state.S2GA else 0) | (1 << 3 if c.shorts & state.S2GB else 0)
    word |= (1 << 4 if c.shorts & state.S2VSA else 0) | (1 << 5 if c.shorts & state.S2VSB else 0)
    word |= (1 << 6 if c.inputs & state.OLA else 0) | (1 << 7 if c.inputs & state.OLB else 0)
    word |= (1 << 8 if c.inputs & state.OTPW else 0) | (1 << 10 if c.inputs & state.OT else 0)
    word |= c.cs << 16 | (1 << 30 if power_stage.is_stealth_chop_active(c) else 0)
    return word | (1 << 31 if c.clock >= power_stage.compute_standstill_clock(c) else 0)


@hot
def _compute_pwm_scale(c):
    """Return PWM_SCALE: the duty cycle by the voltage that current and back EMF need."""
    if not power_stage.is_measuring(c):
        return 0
    share = power_stage.compute_current_amplitude(c) * c.ir_share + (c.emf / 1024.0 if c.period else 0.0)
    return int(MAX_PWM_SCALE * least(1.0, share))


@hot
def get_register_value(c, register):
    """Return the value of a TMC2209 register, including registers that a host cannot read."""
    if register == state.GSTAT:
        return c.gstat | (4 if c.inputs & state.UV_CP else 0)
    if register == state.IFCNT:
        return c.ifcnt
    if register == state.IOIN:
        return _compute_ioin(c)
    if register == state.TSTEP:
        return power_stage.compute_tstep(c)
    if register == state.SG_RESULT:
        return c.sg
    if register == state.MSCNT:
        return c.mscnt
    if register == state.MSCURACT:
        return compute_current_word(c.mscnt)
    if register == state.DRV_STATUS:
        return _compute_drv_status(c)
    if register == state.PWM_SCALE:
        return _compute_pwm_scale(c)
    if register == state.PWM_AUTO:
        return c.registers[state.PWMCONF] & 0xFF | (c.registers[state.PWMCONF] >> 8 & 0xFF) << 16
    return c.registers[register]


@hot
def read_register(c, register):
    return get_register_value(c, register) if maps.IS_READABLE[register] else 0


@hot
def write_register(c, register, value):
    """Write a register of the TMC2209. The new value takes effect at once."""
    if maps.STORED_BITS[register] == 0:
        return
    value &= maps.STORED_BITS[register]
    if register == state.GSTAT:
        c.gstat &= ~value
        power_stage.latch_faults(c)
        return
    c.registers[register] = value
    if register == state.VACTUAL:
        power_stage.start_internal_steps(c, value)
    elif register in (state.IHOLD_IRUN, state.GCONF):
        power_stage.apply_current_registers(c)
    power_stage.latch_faults(c)
    power_stage.update_thresholds(c)
