"""PCL-240 family, compiled: the effect of bus writes, the values of bus reads, and the output pins. All between two ticks."""

from __future__ import annotations

from stage.chips.pcl240.maps import CONTROL, OPERATE, SELECT
from stage.chips.pcl240.ramp import correct_top, goal_speed, selected_speed
from stage.chips.pcl240.state import (
    AUTOMATIC,
    COLLECTIVE,
    EL_MINUS,
    EL_PLUS,
    EXTENSION,
    EZ,
    EZ_COUNT,
    EZ_SIGNAL,
    FDOWN,
    FKEEP,
    FUP,
    GROUP,
    HOLD,
    INDEPENDENT,
    INS,
    INT_AT_STOP,
    IRQ,
    LT,
    MAX_EZ_COUNT,
    MINUS,
    ORG,
    ORIGIN,
    OTS,
    OTS_LEVEL,
    OUTPUT_BITS,
    PDIR,
    POSITION,
    POUT,
    PRESET,
    R10,
    R12,
    R13,
    R14,
    R15,
    R17,
    RAMP,
    REGISTER,
    S_FKEEP,
    S_INS,
    S_LT,
    S_NO_INT,
    S_OPERATING,
    S_ORG,
    S_SD,
    S_ZERO,
    SD,
    SD_MINUS,
    SD_PLUS,
    SECOND_EIGHT,
    SPEED,
    START,
    STOP,
    ZERO,
    begin,
    read_pins,
    stop,
)
from stage.native import hot


@hot
def blocked(c):
    """A limit switch of the direction, or ORG during origin return."""
    return c.seen & (EL_MINUS if c.minus else EL_PLUS) or (c.origin and c.seen & ORG)


@hot
def _operate(c, value):
    """A command of group 00: start, stop, speed change."""
    c.int_at_stop = 1 if value & INT_AT_STOP else 0
    if not c.int_at_stop:
        c.irq = 0
    starts, stops, ramps = value & START, value & STOP, 1 if value & RAMP else 0
    if stops and not starts:
        if c.running:
            stop(c)
        c.armed = 1
        if c.extended:
            c.reg[6] = 0
    elif stops and c.running:
        if not ramps and not c.ramps:
            stop(c)
        else:
            c.ramps = c.decel = 1
            if c.speed <= c.reg[1]:
                stop(c)
    elif starts and not stops:
        if c.running:
            c.ramps, c.select, c.decel = ramps, value & SPEED, 0
        elif c.armed and not c.finishing and not blocked(c) and not (c.preset and c.reg[0] == 0):
            c.ramps, c.select, c.decel = ramps, value & SPEED, 0
            begin(c)
            correct_top(c)
            c.speed = c.reg[1] if c.ramps else selected_speed(c)
            c.running = 1


@hot
def _store(c, k, value):
    """Register `k` takes a new value, masked."""
    c.reg[k] = c.reg[k] & ~c.mask[k] | value & c.mask[k]
    if k in (7, R12, R13):
        read_pins(c)
    if c.running and (k in (1, 4, 5, R14, R15)):
        c.manual = 1


@hot
def _write_data(c, address, value):
    if c.collective:  # the upper bytes wait for the lowest one
        if address == 3:
            c.high = value
        elif address == 2:
            c.middle = value
        else:
            _store(c, c.selected, c.high << 16 | c.middle << 8 | value)
        return
    shift = 8 * (address - 1)
    _store(c, c.selected, c.reg[c.selected] & ~(0xFF << shift) | value << shift)


@hot
def write_byte(c, address, value):
    """One bus write cycle."""
    address &= 3
    value &= 0xFF
    c.quiet = 0
    if address:
        _write_data(c, address, value)
        return
    group = value & GROUP
    if group == OPERATE:
        _operate(c, value)
    elif group == CONTROL:
        c.origin, c.sd_enable = 1 if value & ORIGIN else 0, 1 if value & SD else 0
        c.preset, c.minus = 1 if value & PRESET else 0, 1 if value & MINUS else 0
        if c.extended:
            c.automatic, c.position = 1 if value & AUTOMATIC else 0, 1 if value & POSITION else 0
    elif group == SELECT:
        c.selected = value & REGISTER
        if c.extended:
            c.selected += R10 if value & SECOND_EIGHT else 0
            c.collective = 1 if value & COLLECTIVE else 0
    else:
        c.output = value & OUTPUT_BITS


@hot
def register(c, k):
    """Return what register `k` reads as. The EZ monitor in R17 came with the MS."""
    if k == R17 and c.s_curves:
        count = c.ez_left if c.ez_running else c.reg[R13] >> EZ_COUNT & MAX_EZ_COUNT
        return c.reg[R17] | count << EZ_COUNT | (EZ_SIGNAL if c.seen & EZ else 0)
    return c.reg[k]


@hot
def outputs(c):
    """The output pins, a bit mask of OUTPUTS; set = asserted (active-low pins: low)."""
    word = 0 if c.running or c.finishing else HOLD
    goal = goal_speed(c)
    if not c.running or not c.ramps:
        word |= FKEEP
    elif c.speed == goal:
        word |= FDOWN if c.clock < c.fall else FKEEP
    elif c.speed < goal:
        word |= FUP
    else:
        word |= FDOWN
    if c.output & INDEPENDENT:
        if c.low:
            word |= PDIR if c.minus else POUT
    else:
        word |= (POUT if c.low else 0) | (PDIR if c.minus else 0)
    if c.reg[0] < c.reg[6]:
        word |= LT
    if c.reg[0] == 0:
        word |= ZERO
    if c.output & OTS_LEVEL:
        word |= OTS
    if c.irq:
        word |= IRQ
    return word


@hot
def _status(c):
    word = outputs(c)
    status = 0 if word & IRQ else S_NO_INT
    if not word & HOLD:
        status |= S_OPERATING
    if word & FKEEP:
        status |= S_FKEEP
    if word & LT:
        status |= S_LT
    if word & ZERO:
        status |= S_ZERO
    if c.seen & (SD_MINUS if c.minus else SD_PLUS):
        status |= S_SD
    if c.seen & ORG:
        status |= S_ORG
    if c.seen & INS:
        status |= S_INS
    return status


@hot
def read_byte(c, address):
    """One bus read cycle. In collective mode the high byte's read latches them all."""
    address &= 3
    if not address:
        return _status(c)
    word = register(c, c.selected) if c.extended and c.output & EXTENSION else c.reg[0]
    if c.collective:
        if address == 3:
            c.latch = word
        word = c.latch
    return word >> 8 * (address - 1) & 0xFF
