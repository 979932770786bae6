"""HCTL-1100, compiled: bus cycles, flags, modes, resets."""

from __future__ import annotations

from stage.chips.hctl1100 import commutator, encoder, motor
from stage.chips.hctl1100 import filter as law
from stage.chips.hctl1100.maps import FLAG_WRITE, MAP
from stage.chips.hctl1100.profile import COMMAND_VELOCITY
from stage.chips.hctl1100.state import (
    ADDRESSES,
    CONTROL,
    F0,
    F1,
    F4,
    IDLE,
    INDEX,
    INTEGRAL,
    LIMIT,
    PROPORTIONAL,
    STOP,
    STORED,
    control_mode,
    signed,
)
from stage.chips.hctl1100.timer import T, obey_sync, running_count, start
from stage.native import hot

ALL_FLAGS = sum(f.mask for f in MAP.register("R00").fields)
SET = next(f.mask for f in FLAG_WRITE.fields if f.name == "set")
NOT_LIMIT, NOT_STOP, INIT_BIT, PROFILE_BIT = (MAP.mask("R07", name) for name in ("limit", "stop", "init", "profile"))
KEPT_STATUS = MAP.register("R07").writable
RESET_AT = (0x0F, 0x20, 0x21, 0x22)
RESET_TO = tuple(MAP.register(f"R{k:02X}").reset or 0 for k in RESET_AT)
UNREADABLE = tuple(1 if any(r.number == k and r.access == "W" for r in MAP.registers) else 0 for k in range(ADDRESSES))


@hot
def idle(c):
    """Enter Init/Idle: no motor command, nothing remembered. The flags stay."""
    c.mode, c.aligning = IDLE, 0
    law.enter(c)
    motor.command(c, 0)
    obey_sync(c)


@hot
def soft_reset(c):
    """R05 = 00h."""
    for k in range(len(RESET_AT)):
        c.reg[RESET_AT[k]] = RESET_TO[k]
    c.status = c.limited = c.stopped = 0
    c.zero, c.held = encoder.raw(c), 0
    start(c)
    idle(c)
    obey_pins(c)


@hot
def hard_reset(c):
    """The RESET pin. The clock, the pins and the shaft stay."""
    for k in range(ADDRESSES):
        c.reg[k] = 0
    c.flag = c.command = c.high = c.middle = c.latch = c.preset_high = c.preset_middle = 0
    c.speed = c.ring = c.dead = c.drive = 0
    soft_reset(c)
    c.home = encoder.raw(c)


@hot
def obey_pins(c):
    """LIMIT and STOP trigger as long as they are asserted; LIMIT ends Align and every control mode."""
    if c.inputs & STOP:
        c.stopped = 1
    if c.inputs & LIMIT:
        c.limited = 1
        if c.mode != IDLE:
            idle(c)
    obey_sync(c)


@hot
def set_pins(c, word):
    """New levels of the input pins."""
    if word & ~c.inputs & INDEX:
        commutator.zero(c)
    c.inputs = word
    obey_pins(c)


@hot
def _flag(c, value):
    """A write to R00."""
    bit = 1 << (value & 7) & ALL_FLAGS & ~F1
    before = control_mode(c.flag)
    if bit == F4 and bool(value & SET) != bool(c.flag & F4):
        if value & SET:
            commutator.hold(c)
        else:
            commutator.release(c)
    c.flag = c.flag | bit if value & SET else c.flag & ~bit
    now = control_mode(c.flag)
    if c.mode == CONTROL and now != before:
        c.velocity = c.fraction = 0
        if now == PROPORTIONAL or before == PROPORTIONAL:
            law.enter(c)


@hot
def _go(c, value):
    """A write to R05."""
    if value == 0:
        soft_reset(c)
    elif value == 1:
        idle(c)
    elif c.mode == IDLE and not c.limited and value <= 3:
        if value == 2:
            commutator.align(c)
        else:
            c.mode = CONTROL
            law.enter(c)
        obey_sync(c)


@hot
def _clear_status(c, value):
    """A write to R07: the low bits, and what has triggered and is released."""
    c.status = value & KEPT_STATUS
    if not c.inputs & LIMIT:
        c.limited = 0
    if not c.inputs & STOP:
        c.stopped = 0


@hot
def _latch_command(c, low):
    """A write to R0E."""
    command = signed(c.high << 16 | c.middle << 8 | low, 24)
    law.tear(c, command)
    c.command, c.fraction = command, 0


@hot
def write_byte(c, address, value):
    """One bus write cycle."""
    if address == 0x00:
        _flag(c, value)
    elif address == 0x05:
        _go(c, value)
    elif address == 0x07:
        _clear_status(c, value)
    elif address == 0x0C:
        c.high = value
    elif address == 0x0D:
        c.middle = value
    elif address == 0x0E:
        _latch_command(c, value)
    elif address == 0x13:
        c.zero = encoder.raw(c)
    elif address == 0x08 or address == 0x09 or 0x15 <= address <= 0x17:
        if c.mode == IDLE:
            _write_idle(c, address, value)
    else:
        c.reg[address] = value & STORED[address]
        if address == 0x23 or address == 0x24:
            law.tear_velocity(c, PROPORTIONAL)
        elif address == COMMAND_VELOCITY:
            law.tear_velocity(c, INTEGRAL)


@hot
def _write_idle(c, address, value):
    """What can be written in Init/Idle only."""
    if address == 0x08:
        motor.to_port(c, value - 0x80)
    elif address == 0x09:
        motor.to_pwm(c, signed(value, 8))
    elif address == 0x15:
        c.preset_high = value
    elif address == 0x16:
        c.preset_middle = value
    else:
        c.zero = encoder.raw(c) - (c.preset_high << 16 | c.preset_middle << 8 | value)


@hot
def status_byte(c):
    """R07."""
    word = c.status | (0 if c.limited else NOT_LIMIT) | (0 if c.stopped else NOT_STOP)
    return word | (INIT_BIT if c.mode == IDLE else 0) | (PROFILE_BIT if c.flag & F0 else 0)


@hot
def peek_byte(c, address):
    """What a read returns, without what it does."""
    if address == 0x00:
        return c.flag | (F1 if c.mode == IDLE else 0)
    if address == 0x07:
        return status_byte(c)
    if address == 0x08:
        return c.port + 0x80
    if address == 0x09:
        return c.pwm & 0xFF
    if 0x0C <= address <= 0x0E:
        return c.command >> 8 * (0x0E - address) & 0xFF
    if address == T:
        return running_count(c)
    if address == 0x12:
        return c.latch >> 16 & 0xFF
    if address == 0x13:
        return c.latch >> 8 & 0xFF
    if address == 0x14:
        return encoder.actual(c) & 0xFF
    if address == 0x34:
        return c.speed & 0xFF
    if address == 0x35:
        return c.speed >> 8 & 0xFF
    return 0 if UNREADABLE[address] else c.reg[address]


@hot
def read_byte(c, address):
    """One bus read cycle."""
    if address == 0x14:
        c.latch = encoder.actual(c) & 0xFFFFFF
    return peek_byte(c, address)
