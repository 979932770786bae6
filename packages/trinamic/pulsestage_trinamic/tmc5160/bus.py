"""TMC5160, compiled: reading and writing registers, SPI datagrams, and the flags.

Addresses 0 to 7Fh are the registers, for hosts that do not simulate SPI. A host with SPI uses three more:

    80h   chip select: 0 begins a datagram, 1 ends it
    81h   a byte written goes out on SDI; a read then returns the byte that came in on SDO meanwhile
    82h   40 bits written are a whole datagram; a read then returns its answer

A read of 83h returns SPI_STATUS, a read of 84h whether a drive is in progress, both without a datagram.
"""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import encoder, maps, power, ramp, sequencer, speeds, stallguard, state
from stage.native import hot

VERSION = 0x30 << 24
DATUM = 0x7F  # address bits of a datagram
FIRST = -1  # the answer to nothing: the status of its own time


@hot
def power_up(c):
    """Set the power-up values of the data sheet; clock, pins and the position of the field stay."""
    clock, hz, rsense, inputs, net = c.clock, c.hz, c.rsense, c.inputs, c.net
    c.fresh = 1
    c.x = c.target = c.q = c.dir = c.ph = c.brk = c.zw = 0
    c.events, c.reached = state.EVENT_POS, 1
    c.left = c.right = c.latched = 0
    c.enc = c.part = c.enc_pins = c.enc_met = c.enc_latch = c.enc_flags = 0
    c.mscnt = c.toggle = c.way = c.current = c.cs = c.speeds = c.cooling = 0
    c.last, c.falls = clock, state.NEVER
    c.sg = c.stall = c.total = c.summed = c.count = c.full = 0
    c.lam, c.emf = 0, 1024
    c.load_of, c.load_n, c.load_sum, c.emf_sum = -1, 0, 0, 0
    c.gstat, c.shorts, c.hot, c.powered = 1, 0, 0, 0
    c.csn, c.shift, c.bits, c.out, c.heard = 1, 0, 0, 0, 0
    c.risen = c.shifted = -state.NEVER
    for k in range(maps.REGISTERS):
        c.reg[k] = maps.RESET[k]
    c.clock, c.hz, c.rsense, c.inputs, c.net = clock, hz, rsense, inputs, net
    encoder.wake(c)
    c.answer = FIRST


# --- flags ---


@hot
def _event(c, side, way):
    s = c.dir if c.dir else ramp.wanted(c)
    return s == way and c.reg[state.SW_MODE] & (state.STOP_L if way < 0 else state.STOP_R) and side


@hot
def ramp_stat(c):
    word = c.events | (state.STATUS_L if c.left else 0) | (state.STATUS_R if c.right else 0)
    word |= (state.EVENT_L if _event(c, c.left, -1) else 0) | (state.EVENT_R if _event(c, c.right, 1) else 0)
    word |= state.VELOCITY_REACHED if c.q >> state.UNIT == c.reg[state.VMAX] else 0
    word |= (state.POSITION_REACHED if c.reached else 0) | (0 if c.q else state.VZERO) | (state.ZEROWAIT if c.zw else 0)
    return word | (state.STATUS_SG if c.stall and speeds.window(c) else 0)


@hot
def drv_status(c):
    """Return DRV_STATUS."""
    word = c.sg | c.cs << 16 | c.stall << 24
    word |= 1 << 14 if speeds.stealth(c) else 0
    word |= 1 << 15 if c.speeds & state.HIGH and c.reg[state.CHOPCONF] & state.VHIGHFS else 0
    word |= (c.shorts >> 8 & 3) << 27 | (c.shorts >> 10 & 3) << 12
    word |= (1 << 25 if c.hot else 0) | (1 << 26 if c.inputs & state.OTPW else 0)
    word |= (c.inputs >> 14 & 3) << 29
    return word | (1 << 31 if power.stands(c) else 0)


@hot
def spi_status(c):
    word = ramp_stat(c)
    driver = drv_status(c)
    return (
        (word & 1) << 6 | (word >> 1 & 1) << 7 | (word >> 9 & 1) << 5 | (word >> 8 & 1) << 4
        | (driver >> 31) << 3 | (driver >> 24 & 1) << 2 | (c.gstat >> 1 & 1) << 1 | c.gstat & 1
    )  # fmt: skip


@hot
def drives(c):
    """Return whether a drive is in progress or begins at the next clock."""
    return 1 if c.dir or (not speeds.gated(c) and ramp.starts(c)) else 0


@hot
def outputs(c):
    """Return the levels of DIAG0 and DIAG1 as bits of OUTPUTS, where 1 is active."""
    if c.reg[state.GCONF] & state.DIAG0_STEP:
        word = state.DIAG0 if c.toggle else 0
    else:
        events = ramp_stat(c) & (state.EVENT_POS | state.EVENT_L | state.EVENT_R | state.EVENT_SG)
        word = state.DIAG0 if events or c.enc_flags else 0
    if c.reg[state.GCONF] & state.DIAG1_DIR:
        return word | (state.DIAG1 if c.way < 0 else 0)
    return word | (state.DIAG1 if c.x == state.signed32(c.reg[state.X_COMPARE]) else 0)


@hot
def arrived(c):
    """Update position_reached and its event."""
    now = 1 if c.x == c.target else 0
    if now and not c.reached:
        c.events |= state.EVENT_POS
    c.reached = now


# --- registers ---


@hot
def register(c, a):
    """Return the value that a register holds, also of one that cannot be read."""
    if a == state.GSTAT:
        return c.gstat
    if a == state.IOIN:
        return VERSION | c.inputs & 0x3F
    if a == state.TSTEP:
        return speeds.tstep(c, c.q)
    if a == state.XACTUAL:
        return c.x & maps.M32
    if a == state.XTARGET:
        return c.target & maps.M32
    if a == state.VACTUAL:
        return c.dir * (c.q >> state.UNIT) & 0xFFFFFF
    if a == state.RAMP_STAT:
        return ramp_stat(c)
    if a == state.XLATCH:
        return c.latched & maps.M32
    if a == state.X_ENC:
        return c.enc & maps.M32
    if a == state.ENC_STATUS:
        return c.enc_flags
    if a == state.ENC_LATCH:
        return c.enc_latch & maps.M32
    if a == state.MSCNT:
        return c.mscnt
    if a == state.MSCURACT:
        return sequencer.sine(c.mscnt) & 0x1FF | (sequencer.sine(c.mscnt + 256) & 0x1FF) << 16
    if a == state.DRV_STATUS:
        return drv_status(c)
    if a == state.PWM_AUTO:
        return c.reg[state.PWMCONF] & 0xFF | (c.reg[state.PWMCONF] >> 8 & 0xFF) << 16
    return c.reg[a]


@hot
def read_register(c, a):
    return register(c, a) if maps.READABLE[a] else 0


@hot
def write_register(c, a, value):
    """Write a register. The write acts from the next clock on, but flags of the position follow at once."""
    value &= maps.STORED[a]
    if maps.STORED[a] == 0:
        return
    c.fresh = 1
    if a == state.XACTUAL:
        c.x = state.signed32(value)
        c.brk = 0
    elif a == state.XTARGET:
        c.target = state.signed32(value)
        c.brk = 0
    elif a == state.GSTAT:
        c.gstat &= ~value
    elif a == state.RAMP_STAT:
        c.events &= ~(value & state.CLEARED)
    elif a == state.ENC_STATUS:
        c.enc_flags &= ~value
    elif a == state.X_ENC:
        c.enc, c.part = state.signed32(value), 0
    else:
        if a == state.COOLCONF and (value ^ c.reg[a]) & state.SFILT:
            c.total = c.summed = 0
        c.reg[a] = value
        if a == state.RAMPMODE:
            c.brk = 0
        elif a == state.IHOLD_IRUN:
            power.currents_written(c)
    if a == state.CHOPCONF and value & 15 == 0:
        c.shorts = 0
    stallguard.settle(c)
    arrived(c)


# --- SPI ---


@hot
def answer(c):
    """Return the answer that the next datagram gets."""
    return spi_status(c) << 32 if c.answer == FIRST else c.answer


@hot
def _act(c, word):
    """Execute a whole datagram when CSN goes high."""
    a = word >> 32 & DATUM
    datum = word & maps.M32
    if word >> 39 & 1:
        write_register(c, a, datum)
    else:
        datum = read_register(c, a)
    c.answer = spi_status(c) << 32 | datum


@hot
def write(c, address, value):
    """Make one write cycle on the bus."""
    if address < maps.REGISTERS:
        write_register(c, address, value & maps.M32)
    elif address == maps.SPI_CS:
        select(c, value & 1)
    elif address == maps.SPI_BYTE and not c.csn:
        c.out = c.shift >> 32
        c.shift = (c.shift << 8 | value & 0xFF) & maps.M40
        c.bits += 8
        c.shifted = c.clock
    elif address == maps.SPI_DATAGRAM:
        c.heard = answer(c)
        _act(c, value & maps.M40)


@hot
def select(c, level):
    """Set the level of CSN."""
    if c.csn and not level:
        c.shift, c.bits = answer(c), 0
    elif level and not c.csn:
        c.risen = c.clock
        if c.bits >= 40:
            _act(c, c.shift)
    c.csn = level


@hot
def peek(c, address):
    """Return the value that a read cycle would find, without its side effects."""
    if address < maps.REGISTERS:
        return read_register(c, address)
    if address == maps.SPI_CS:
        return c.csn
    if address == maps.SPI_BYTE:
        return c.out
    if address == maps.SPI_DATAGRAM:
        return c.heard
    if address == maps.SPI_STATE:
        return spi_status(c)
    return drives(c) if address == maps.MOTION else 0
