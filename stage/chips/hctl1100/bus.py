"""HCTL-1100, compiled: bus cycles, flags, modes, resets."""

from __future__ import annotations

from stage.chips.hctl1100 import commutator, encoder, maps, motor, state
from stage.chips.hctl1100 import filter as law
from stage.chips.hctl1100.timer import obey_sync, running_count, start
from stage.native import hot

ALL_FLAGS = sum(f.mask for f in maps.MAP.register("R00").fields)
SET, NUMBER = (f.mask for f in maps.FLAG_WRITE.fields)
TO_RESET, TO_IDLE, TO_ALIGN, TO_CONTROL = (
    maps.MODE_WRITE.fields[0].code(name) for name in ("reset", "Init/Idle", "Align", "control")
)
NOT_LIMIT, NOT_STOP, INIT_BIT, PROFILE_BIT = (
    maps.MAP.mask("R07", name) for name in ("limit", "stop", "init", "profile")
)
KEPT_STATUS = maps.MAP.register("R07").writable
PORT_ZERO = maps.MAP.register("R08").reset or 0
RESET_AT = (maps.TIMER, maps.ZERO, maps.POLE, maps.GAIN)
RESET_TO = tuple(maps.after_reset(name) for name in ("timer", "zero", "pole", "gain"))
UNREADABLE = tuple(
    1 if any(r.number == k and r.access == "W" for r in maps.MAP.registers) else 0 for k in range(maps.ADDRESSES)
)


@hot
def idle(c):
    """Enter Init/Idle: no motor command, nothing remembered. The flags stay."""
    c.mode, c.aligning = state.IDLE, 0
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
    for k in range(maps.ADDRESSES):
        c.reg[k] = 0
    c.flag = c.command = c.high = c.middle = c.latch = c.preset_high = c.preset_middle = 0
    c.speed = c.ring = c.dead = c.drive = c.given = c.gave = 0
    soft_reset(c)
    c.home = encoder.raw(c)


@hot
def obey_pins(c):
    """LIMIT and STOP trigger as long as they are asserted; LIMIT ends Align and every control mode."""
    if c.inputs & state.STOP:
        c.stopped = 1
    if c.inputs & state.LIMIT:
        c.limited = 1
        if c.mode != state.IDLE:
            idle(c)
    obey_sync(c)


@hot
def set_pins(c, word):
    """New levels of the input pins."""
    if word & ~c.inputs & state.INDEX:
        commutator.zero(c)
    c.inputs = word
    obey_pins(c)


@hot
def _flag(c, value):
    """A write to R00."""
    bit = 1 << (value & NUMBER) & ALL_FLAGS & ~state.F1
    before = state.control_mode(c.flag)
    if bit == state.F4 and bool(value & SET) != bool(c.flag & state.F4):
        if value & SET:
            commutator.hold(c)
        else:
            commutator.release(c)
    c.flag = c.flag | bit if value & SET else c.flag & ~bit
    now = state.control_mode(c.flag)
    if c.mode == state.CONTROL and now != before:
        c.velocity = c.fraction = 0
        if now == state.PROPORTIONAL or before == state.PROPORTIONAL:
            law.enter(c)


@hot
def _go(c, value):
    """A write to R05."""
    if value == TO_RESET:
        soft_reset(c)
    elif value == TO_IDLE:
        idle(c)
    elif c.mode == state.IDLE and not c.limited and value in (TO_ALIGN, TO_CONTROL):
        if value == TO_ALIGN:
            commutator.align(c)
        else:
            c.mode = state.CONTROL
            law.enter(c)
        obey_sync(c)


@hot
def _clear_status(c, value):
    """A write to R07: the low bits, and what has triggered and is released."""
    c.status = value & KEPT_STATUS
    if not c.inputs & state.LIMIT:
        c.limited = 0
    if not c.inputs & state.STOP:
        c.stopped = 0


@hot
def _latch_command(c, low):
    """A write to R0E."""
    command = state.signed(c.high << 16 | c.middle << 8 | low, 24)
    law.tear(c, command)
    c.command, c.fraction = command, 0


@hot
def write_byte(c, address, value):
    """One bus write cycle."""
    if c.mode == state.CONTROL:
        for k in range(len(state.GIVERS)):
            if address == state.GIVERS[k]:
                c.gave = (c.gave if c.given == c.next else 0) | 1 << k
                c.given = c.next
    if address == maps.FLAG:
        _flag(c, value)
    elif address == maps.MODE:
        _go(c, value)
    elif address == maps.STATUS:
        _clear_status(c, value)
    elif address == maps.COMMAND_HIGH:
        c.high = value
    elif address == maps.COMMAND_MIDDLE:
        c.middle = value
    elif address == maps.COMMAND_LOW:
        _latch_command(c, value)
    elif address == maps.CLEAR:
        c.zero = encoder.raw(c)
    elif address in (maps.PORT, maps.PWM) or maps.PRESET_HIGH <= address <= maps.PRESET_LOW:
        if c.mode == state.IDLE:
            _write_idle(c, address, value)
    else:
        c.reg[address] = value & state.STORED[address]
        if address in (maps.PROPORTIONAL_LOW, maps.PROPORTIONAL_HIGH):
            law.tear_velocity(c, state.PROPORTIONAL)
        elif address == maps.INTEGRAL_VELOCITY:
            law.tear_velocity(c, state.INTEGRAL)


@hot
def _write_idle(c, address, value):
    """Write a register that can be written in Init/Idle only."""
    if address == maps.PORT:
        motor.to_port(c, value - PORT_ZERO)
    elif address == maps.PWM:
        motor.to_pwm(c, state.signed(value, 8))
    elif address == maps.PRESET_HIGH:
        c.preset_high = value
    elif address == maps.PRESET_MIDDLE:
        c.preset_middle = value
    else:
        c.zero = encoder.raw(c) - (c.preset_high << 16 | c.preset_middle << 8 | value)


@hot
def status_byte(c):
    """R07."""
    word = c.status | (0 if c.limited else NOT_LIMIT) | (0 if c.stopped else NOT_STOP)
    return word | (INIT_BIT if c.mode == state.IDLE else 0) | (PROFILE_BIT if c.flag & state.F0 else 0)


@hot
def peek_byte(c, address):
    """Return what a read returns, without what it changes."""
    if address == maps.FLAG:
        return c.flag | (state.F1 if c.mode == state.IDLE else 0)
    if address == maps.STATUS:
        return status_byte(c)
    if address == maps.PORT:
        return c.port + PORT_ZERO
    if address == maps.PWM:
        return c.pwm & 0xFF
    if maps.COMMAND_HIGH <= address <= maps.COMMAND_LOW:
        return c.command >> 8 * (maps.COMMAND_LOW - address) & 0xFF
    if address == maps.TIMER:
        return running_count(c)
    if address == maps.ACTUAL_HIGH:
        return c.latch >> 16 & 0xFF
    if address == maps.ACTUAL_MIDDLE:
        return c.latch >> 8 & 0xFF
    if address == maps.ACTUAL_LOW:
        return encoder.actual(c) & 0xFF
    if address == maps.VELOCITY_LOW:
        return c.speed & 0xFF
    if address == maps.VELOCITY_HIGH:
        return c.speed >> 8 & 0xFF
    return 0 if UNREADABLE[address] else c.reg[address]


@hot
def read_byte(c, address):
    """One bus read cycle."""
    if address == maps.ACTUAL_LOW:
        c.latch = encoder.actual(c) & 0xFFFFFF
    return peek_byte(c, address)
