"""PCL-240 family, compiled: what bus cycles do and say, and the output pins. All between two ticks."""

from __future__ import annotations

from stage.chips.pcl240.ramp import correct_top, goal_speed, selected_speed
from stage.chips.pcl240.state import (
    EL_MINUS,
    EL_PLUS,
    EXTENSION,
    EZ,
    EZ_COUNT,
    EZ_SIGNAL,
    FDOWN,
    FKEEP,
    FUP,
    HOLD,
    INDEPENDENT,
    INS,
    IRQ,
    LT,
    ORG,
    OTS,
    OTS_LEVEL,
    PDIR,
    POUT,
    R13,
    R14,
    R15,
    R17,
    SD_MINUS,
    SD_PLUS,
    ZERO,
    begin,
    stop,
)
from stage.native import greatest, hot, least


@hot
def blocked(c):
    """A limit switch of the direction, or ORG during origin return."""
    return c.inputs & (EL_MINUS if c.minus else EL_PLUS) or (c.origin and c.inputs & ORG)


@hot
def _operate(c, value):
    """A command of group 00: start, stop, speed change."""
    c.int_at_stop = value >> 5 & 1
    if not c.int_at_stop:
        c.irq = 0
    starts, stops = value & 0x10, value & 0x08
    if stops and not starts:
        if c.running:
            stop(c)
        c.armed = 1
        if c.extended:
            c.reg[6] = 0
    elif stops and c.running:
        if not value & 0x04 and not c.ramps:
            stop(c)
        else:
            c.ramps = c.decel = 1
            if c.speed <= c.reg[1]:
                stop(c)
    elif starts and not stops:
        if c.running:
            c.ramps, c.select, c.decel = value >> 2 & 1, value & 3, 0
        elif c.armed and not c.finishing and not blocked(c) and not (c.preset and c.reg[0] == 0):
            c.ramps, c.select, c.decel = value >> 2 & 1, value & 3, 0
            begin(c)
            correct_top(c)
            c.speed = c.reg[1] if c.ramps else selected_speed(c)
            c.running = 1


@hot
def _store(c, k, value):
    """Register `k` takes a new value, masked."""
    c.reg[k] = c.reg[k] & ~c.mask[k] | value & c.mask[k]
    if k == 7:
        c.phase = least(c.phase, greatest(8192 * c.reg[7] - 1, 0))
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
    group = value >> 6
    if group == 0:
        _operate(c, value)
    elif group == 1:
        c.origin, c.sd_enable, c.preset, c.minus = value & 1, value >> 1 & 1, value >> 2 & 1, value >> 3 & 1
        if c.extended:
            c.automatic, c.position = value >> 4 & 1, value >> 5 & 1
    elif group == 2:
        c.selected = value & 7
        if c.extended:
            c.selected |= value >> 1 & 8
            c.collective = value >> 5 & 1
    else:
        c.output = value & 0x3F


@hot
def register(c, k):
    """What register `k` reads as."""
    if k == R17 and c.extended:
        count = c.ez_left if c.ez_running else c.reg[R13] >> EZ_COUNT & 15
        return c.reg[R17] | count << EZ_COUNT | (EZ_SIGNAL if c.inputs & EZ else 0)
    return c.reg[k]


@hot
def outputs(c):
    """The output pins, a bit mask of OUTPUTS; set = asserted (active-low pins: low)."""
    word = 0 if c.running or c.finishing else HOLD
    goal = goal_speed(c)
    if not c.running or not c.ramps or c.speed == goal:
        word |= FKEEP
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
    status = 0 if word & IRQ else 0x80
    if not word & HOLD:
        status |= 0x40
    if word & FKEEP:
        status |= 0x20
    if word & LT:
        status |= 0x10
    if word & ZERO:
        status |= 0x08
    if c.inputs & (SD_MINUS if c.minus else SD_PLUS):
        status |= 0x04
    if c.inputs & ORG:
        status |= 0x02
    if c.inputs & INS:
        status |= 0x01
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
