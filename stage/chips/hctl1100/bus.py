"""Bus cycles, flags, modes and resets of the HCTL-1100, compiled."""

from __future__ import annotations

from stage.chips.hctl1100 import commutator, encoder, maps, motor_port, state
from stage.chips.hctl1100 import digital_filter as law
from stage.chips.hctl1100.sample_timer import apply_sync, read_timer, start_period
from stage.native import hot

ALL_FLAGS = sum(f.mask for f in maps.MAP.register("R00").fields)
FLAG_SET, FLAG_NUMBER = (f.mask for f in maps.FLAG_WRITE.fields)
MODE_RESET, MODE_IDLE, MODE_ALIGN, MODE_CONTROL = (
    maps.MODE_WRITE.fields[0].find_code(name) for name in ("reset", "Init/Idle", "Align", "control")
)
NOT_LIMIT, NOT_STOP, INIT_BIT, PROFILE_BIT = maps.MAP.masks("R07", "limit", "stop", "init", "profile")
WRITABLE_STATUS = maps.MAP.register("R07").writable
PORT_ZERO = maps.MAP.register("R08").reset or 0
RESET_ADDRESSES = (maps.TIMER, maps.ZERO, maps.POLE, maps.GAIN)
RESET_VALUES = tuple(maps.find_reset_value(name) for name in ("timer", "zero", "pole", "gain"))
WRITE_ONLY_TABLE = tuple(
    1 if any(r.number == k and r.access == "W" for r in maps.MAP.registers) else 0 for k in range(maps.ADDRESS_COUNT)
)


@hot
def enter_init_idle_mode(chip):
    """Enter the mode Init/Idle: set the motor command to 0 and clear the history of the control law. The flags stay."""
    chip.mode, chip.aligning = state.IDLE, 0
    law.clear_history(chip)
    motor_port.set_command(chip, 0)
    apply_sync(chip)


@hot
def soft_reset(chip):
    """Reset the HCTL-1100 as a write of 00h to R05 does."""
    for k in range(len(RESET_ADDRESSES)):
        chip.reg[RESET_ADDRESSES[k]] = RESET_VALUES[k]
    chip.status = chip.limit_triggered = chip.stop_triggered = 0
    chip.position_origin, chip.timer_stopped = encoder.read_count(chip), 0
    start_period(chip)
    enter_init_idle_mode(chip)
    apply_pins(chip)


@hot
def hard_reset(chip):
    """Reset the HCTL-1100 as the RESET pin does. The clock, the input pins and the shaft stay."""
    for k in range(maps.ADDRESS_COUNT):
        chip.reg[k] = 0
    chip.flag_bits = chip.command = chip.command_high = chip.command_middle = 0
    chip.position_latch = chip.preset_high = chip.preset_middle = 0
    chip.actual_velocity = chip.ring_position = chip.pulse_off_until = 0
    chip.motor_command = chip.command_sample_end = chip.command_writes = 0
    soft_reset(chip)
    chip.ring_origin = encoder.read_count(chip)


@hot
def apply_pins(chip):
    """Trigger LIMIT and STOP if their pins are asserted, and apply SYNC. LIMIT ends Align and every control mode."""
    if chip.inputs & state.STOP:
        chip.stop_triggered = 1
    if chip.inputs & state.LIMIT:
        chip.limit_triggered = 1
        if chip.mode != state.IDLE:
            enter_init_idle_mode(chip)
    apply_sync(chip)


@hot
def set_pins(chip, word):
    """Set the levels of the HCTL-1100's input pins, and apply them."""
    if word & ~chip.inputs & state.INDEX:
        commutator.restart_ring(chip)
    chip.inputs = word
    apply_pins(chip)


@hot
def _write_flag(chip, value):
    """Execute a write to R00, the flag register of the HCTL-1100, which sets or clears one flag."""
    bit = 1 << (value & FLAG_NUMBER) & ALL_FLAGS & ~state.F1
    before = state.find_control_mode(chip.flag_bits)
    if bit == state.F4 and bool(value & FLAG_SET) != bool(chip.flag_bits & state.F4):
        if value & FLAG_SET:
            commutator.hold_ring(chip)
        else:
            commutator.release_ring(chip)
    chip.flag_bits = chip.flag_bits | bit if value & FLAG_SET else chip.flag_bits & ~bit
    now = state.find_control_mode(chip.flag_bits)
    if chip.mode == state.CONTROL and now != before:
        chip.velocity = chip.fraction = 0
        if now == state.PROPORTIONAL or before == state.PROPORTIONAL:
            law.clear_history(chip)


@hot
def _write_mode(chip, value):
    """Execute a write to R05: reset, Init/Idle, Align or control."""
    if value == MODE_RESET:
        soft_reset(chip)
    elif value == MODE_IDLE:
        enter_init_idle_mode(chip)
    elif chip.mode == state.IDLE and not chip.limit_triggered and value in (MODE_ALIGN, MODE_CONTROL):
        if value == MODE_ALIGN:
            commutator.start_align(chip)
        else:
            chip.mode = state.CONTROL
            law.clear_history(chip)
        apply_sync(chip)


@hot
def _write_status(chip, value):
    """Execute a write to R07: store its writable bits, and clear LIMIT and STOP if their pins are released."""
    chip.status = value & WRITABLE_STATUS
    if not chip.inputs & state.LIMIT:
        chip.limit_triggered = 0
    if not chip.inputs & state.STOP:
        chip.stop_triggered = 0


@hot
def _write_command_low(chip, low):
    """Execute a write to R0E, which moves the command position to R0C, R0D and this byte."""
    command = state.to_signed(chip.command_high << 16 | chip.command_middle << 8 | low, 24)
    law.apply_position_written_during_computation(chip, command)
    chip.command, chip.fraction = command, 0


@hot
def write_byte(chip, address, value):
    """Make a bus write cycle.

    Args:
        chip: State of the chip.
        address: Number of the register.
        value: The byte.
    """
    if chip.mode == state.CONTROL:
        for k in range(len(state.COMMAND_ADDRESSES)):
            if address == state.COMMAND_ADDRESSES[k]:
                chip.command_writes = (
                    chip.command_writes if chip.command_sample_end == chip.sample_end else 0
                ) | 1 << k
                chip.command_sample_end = chip.sample_end
    if address == maps.FLAG:
        _write_flag(chip, value)
    elif address == maps.MODE:
        _write_mode(chip, value)
    elif address == maps.STATUS:
        _write_status(chip, value)
    elif address == maps.COMMAND_HIGH:
        chip.command_high = value
    elif address == maps.COMMAND_MIDDLE:
        chip.command_middle = value
    elif address == maps.COMMAND_LOW:
        _write_command_low(chip, value)
    elif address == maps.CLEAR_POSITION_ADDRESS:
        chip.position_origin = encoder.read_count(chip)
    elif address in (maps.PORT, maps.PWM) or maps.PRESET_HIGH <= address <= maps.PRESET_LOW:
        if chip.mode == state.IDLE:
            _write_register_in_init_idle(chip, address, value)
    else:
        chip.reg[address] = value & state.STORED_MASKS[address]
        if address in (maps.PROPORTIONAL_LOW, maps.PROPORTIONAL_HIGH):
            law.apply_velocity_written_during_computation(chip, state.PROPORTIONAL)
        elif address == maps.INTEGRAL_VELOCITY:
            law.apply_velocity_written_during_computation(chip, state.INTEGRAL)


@hot
def _write_register_in_init_idle(chip, address, value):
    """Write a register that the chip accepts only in the mode Init/Idle."""
    if address == maps.PORT:
        motor_port.write_port(chip, value - PORT_ZERO)
    elif address == maps.PWM:
        motor_port.write_pwm(chip, state.to_signed(value, 8))
    elif address == maps.PRESET_HIGH:
        chip.preset_high = value
    elif address == maps.PRESET_MIDDLE:
        chip.preset_middle = value
    else:
        chip.position_origin = encoder.read_count(chip) - (chip.preset_high << 16 | chip.preset_middle << 8 | value)


@hot
def compute_status(chip):
    """Compute R07, the status byte of the HCTL-1100."""
    word = chip.status | (0 if chip.limit_triggered else NOT_LIMIT) | (0 if chip.stop_triggered else NOT_STOP)
    return word | (INIT_BIT if chip.mode == state.IDLE else 0) | (PROFILE_BIT if chip.flag_bits & state.F0 else 0)


@hot
def peek_byte(chip, address):
    """Return what a host would read at an address, without the side effects of a bus cycle."""
    if address == maps.FLAG:
        return chip.flag_bits | (state.F1 if chip.mode == state.IDLE else 0)
    if address == maps.STATUS:
        return compute_status(chip)
    if address == maps.PORT:
        return chip.port + PORT_ZERO
    if address == maps.PWM:
        return chip.pwm & 0xFF
    if maps.COMMAND_HIGH <= address <= maps.COMMAND_LOW:
        return chip.command >> 8 * (maps.COMMAND_LOW - address) & 0xFF
    if address == maps.TIMER:
        return read_timer(chip)
    if address == maps.ACTUAL_HIGH:
        return chip.position_latch >> 16 & 0xFF
    if address == maps.ACTUAL_MIDDLE:
        return chip.position_latch >> 8 & 0xFF
    if address == maps.ACTUAL_LOW:
        return encoder.compute_actual_position(chip) & 0xFF
    if address == maps.VELOCITY_LOW:
        return chip.actual_velocity & 0xFF
    if address == maps.VELOCITY_HIGH:
        return chip.actual_velocity >> 8 & 0xFF
    return 0 if WRITE_ONLY_TABLE[address] else chip.reg[address]


@hot
def read_byte(chip, address):
    """Make a bus read cycle. A read of R14 latches the upper bytes of the actual position."""
    if address == maps.ACTUAL_LOW:
        chip.position_latch = encoder.compute_actual_position(chip) & 0xFFFFFF
    return peek_byte(chip, address)
