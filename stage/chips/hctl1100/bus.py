"""Bus cycles, flags, modes and resets of the HCTL-1100, compiled."""

from __future__ import annotations

from stage.chips.hctl1100 import commutator, encoder, maps, motor, state
from stage.chips.hctl1100 import filter as law
from stage.chips.hctl1100.timer import apply_sync, read_timer, start_period
from stage.native import hot

ALL_FLAGS = sum(f.mask for f in maps.MAP.register("R00").fields)
FLAG_SET, FLAG_NUMBER = (f.mask for f in maps.FLAG_WRITE.fields)
MODE_RESET, MODE_IDLE, MODE_ALIGN, MODE_CONTROL = (
    maps.MODE_WRITE.fields[0].code(name) for name in ("reset", "Init/Idle", "Align", "control")
)
NOT_LIMIT, NOT_STOP, INIT_BIT, PROFILE_BIT = (
    maps.MAP.mask("R07", name) for name in ("limit", "stop", "init", "profile")
)
WRITABLE_STATUS = maps.MAP.register("R07").writable
PORT_ZERO = maps.MAP.register("R08").reset or 0
RESET_ADDRESSES = (maps.TIMER, maps.ZERO, maps.POLE, maps.GAIN)
RESET_VALUES = tuple(maps.find_reset_value(name) for name in ("timer", "zero", "pole", "gain"))
IS_WRITE_ONLY = tuple(
    1 if any(r.number == k and r.access == "W" for r in maps.MAP.registers) else 0 for k in range(maps.ADDRESSES)
)


@hot
def enter_idle(c):
    """Enter Init/Idle: set the motor command to 0 and clear the history of the control law. The flags stay."""
    c.mode, c.aligning = state.IDLE, 0
    law.clear_history(c)
    motor.set_command(c, 0)
    apply_sync(c)


@hot
def soft_reset(c):
    """Reset the chip as a write of 00h to R05 does."""
    for k in range(len(RESET_ADDRESSES)):
        c.reg[RESET_ADDRESSES[k]] = RESET_VALUES[k]
    c.status = c.limit_triggered = c.stop_triggered = 0
    c.position_origin, c.timer_stopped = encoder.read_count(c), 0
    start_period(c)
    enter_idle(c)
    apply_pins(c)


@hot
def hard_reset(c):
    """Reset the chip as the RESET pin does. The clock, the input pins and the shaft stay."""
    for k in range(maps.ADDRESSES):
        c.reg[k] = 0
    c.flag_bits = c.command = c.command_high = c.command_middle = c.position_latch = c.preset_high = c.preset_middle = 0
    c.actual_velocity = c.ring_position = c.pulse_off_until = c.motor_command = c.command_sample_end = (
        c.command_writes
    ) = 0
    soft_reset(c)
    c.ring_origin = encoder.read_count(c)


@hot
def apply_pins(c):
    """Trigger LIMIT and STOP if their pins are asserted, and apply SYNC. LIMIT ends Align and every control mode."""
    if c.inputs & state.STOP:
        c.stop_triggered = 1
    if c.inputs & state.LIMIT:
        c.limit_triggered = 1
        if c.mode != state.IDLE:
            enter_idle(c)
    apply_sync(c)


@hot
def set_pins(c, word):
    """Set the levels of the input pins, and apply them."""
    if word & ~c.inputs & state.INDEX:
        commutator.restart_ring(c)
    c.inputs = word
    apply_pins(c)


@hot
def _write_flag(c, value):
    """Execute a write to R00, which sets or clears one flag."""
    bit = 1 << (value & FLAG_NUMBER) & ALL_FLAGS & ~state.F1
    before = state.find_control_mode(c.flag_bits)
    if bit == state.F4 and bool(value & FLAG_SET) != bool(c.flag_bits & state.F4):
        if value & FLAG_SET:
            commutator.hold_ring(c)
        else:
            commutator.release_ring(c)
    c.flag_bits = c.flag_bits | bit if value & FLAG_SET else c.flag_bits & ~bit
    now = state.find_control_mode(c.flag_bits)
    if c.mode == state.CONTROL and now != before:
        c.velocity = c.fraction = 0
        if now == state.PROPORTIONAL or before == state.PROPORTIONAL:
            law.clear_history(c)


@hot
def _write_mode(c, value):
    """Execute a write to R05: reset, Init/Idle, Align or control."""
    if value == MODE_RESET:
        soft_reset(c)
    elif value == MODE_IDLE:
        enter_idle(c)
    elif c.mode == state.IDLE and not c.limit_triggered and value in (MODE_ALIGN, MODE_CONTROL):
        if value == MODE_ALIGN:
            commutator.start_align(c)
        else:
            c.mode = state.CONTROL
            law.clear_history(c)
        apply_sync(c)


@hot
def _write_status(c, value):
    """Execute a write to R07: store its writable bits, and clear LIMIT and STOP if their pins are released."""
    c.status = value & WRITABLE_STATUS
    if not c.inputs & state.LIMIT:
        c.limit_triggered = 0
    if not c.inputs & state.STOP:
        c.stop_triggered = 0


@hot
def _write_command_low(c, low):
    """Execute a write to R0E, which moves the command position to R0C, R0D and this byte."""
    command = state.to_signed(c.command_high << 16 | c.command_middle << 8 | low, 24)
    law.apply_early_position(c, command)
    c.command, c.fraction = command, 0


@hot
def write_byte(c, address, value):
    """Make a bus write cycle.

    Args:
        c: State of the chip.
        address: Number of the register.
        value: The byte.
    """
    if c.mode == state.CONTROL:
        for k in range(len(state.COMMAND_ADDRESSES)):
            if address == state.COMMAND_ADDRESSES[k]:
                c.command_writes = (c.command_writes if c.command_sample_end == c.sample_end else 0) | 1 << k
                c.command_sample_end = c.sample_end
    if address == maps.FLAG:
        _write_flag(c, value)
    elif address == maps.MODE:
        _write_mode(c, value)
    elif address == maps.STATUS:
        _write_status(c, value)
    elif address == maps.COMMAND_HIGH:
        c.command_high = value
    elif address == maps.COMMAND_MIDDLE:
        c.command_middle = value
    elif address == maps.COMMAND_LOW:
        _write_command_low(c, value)
    elif address == maps.CLEAR:
        c.position_origin = encoder.read_count(c)
    elif address in (maps.PORT, maps.PWM) or maps.PRESET_HIGH <= address <= maps.PRESET_LOW:
        if c.mode == state.IDLE:
            _write_idle(c, address, value)
    else:
        c.reg[address] = value & state.STORED[address]
        if address in (maps.PROPORTIONAL_LOW, maps.PROPORTIONAL_HIGH):
            law.apply_early_velocity(c, state.PROPORTIONAL)
        elif address == maps.INTEGRAL_VELOCITY:
            law.apply_early_velocity(c, state.INTEGRAL)


@hot
def _write_idle(c, address, value):
    """Write a register that the chip accepts only in Init/Idle."""
    if address == maps.PORT:
        motor.write_port(c, value - PORT_ZERO)
    elif address == maps.PWM:
        motor.write_pwm(c, state.to_signed(value, 8))
    elif address == maps.PRESET_HIGH:
        c.preset_high = value
    elif address == maps.PRESET_MIDDLE:
        c.preset_middle = value
    else:
        c.position_origin = encoder.read_count(c) - (c.preset_high << 16 | c.preset_middle << 8 | value)


@hot
def compute_status(c):
    """Compute the status byte R07."""
    word = c.status | (0 if c.limit_triggered else NOT_LIMIT) | (0 if c.stop_triggered else NOT_STOP)
    return word | (INIT_BIT if c.mode == state.IDLE else 0) | (PROFILE_BIT if c.flag_bits & state.F0 else 0)


@hot
def peek_byte(c, address):
    """Return what a host would read at an address, without the side effects of a bus cycle."""
    if address == maps.FLAG:
        return c.flag_bits | (state.F1 if c.mode == state.IDLE else 0)
    if address == maps.STATUS:
        return compute_status(c)
    if address == maps.PORT:
        return c.port + PORT_ZERO
    if address == maps.PWM:
        return c.pwm & 0xFF
    if maps.COMMAND_HIGH <= address <= maps.COMMAND_LOW:
        return c.command >> 8 * (maps.COMMAND_LOW - address) & 0xFF
    if address == maps.TIMER:
        return read_timer(c)
    if address == maps.ACTUAL_HIGH:
        return c.position_latch >> 16 & 0xFF
    if address == maps.ACTUAL_MIDDLE:
        return c.position_latch >> 8 & 0xFF
    if address == maps.ACTUAL_LOW:
        return encoder.compute_actual_position(c) & 0xFF
    if address == maps.VELOCITY_LOW:
        return c.actual_velocity & 0xFF
    if address == maps.VELOCITY_HIGH:
        return c.actual_velocity >> 8 & 0xFF
    return 0 if IS_WRITE_ONLY[address] else c.reg[address]


@hot
def read_byte(c, address):
    """Make a bus read cycle. A read of R14 latches the upper bytes of the actual position."""
    if address == maps.ACTUAL_LOW:
        c.position_latch = encoder.compute_actual_position(c) & 0xFFFFFF
    return peek_byte(c, address)
