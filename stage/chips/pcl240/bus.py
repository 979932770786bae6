"""PCL-240 family, compiled: the effect of bus writes, the values of bus reads, and the output pins. All between two ticks."""

from __future__ import annotations

from stage.chips.pcl240 import state
from stage.chips.pcl240.maps import CONTROL, OPERATE, SELECT
from stage.chips.pcl240.ramp import correct_top, goal_speed, selected_speed
from stage.native import hot


@hot
def blocked(c):
    """A limit switch of the direction, or ORG during origin return."""
    return c.seen & (state.EL_MINUS if c.minus else state.EL_PLUS) or (c.origin and c.seen & state.ORG)


@hot
def _operate(c, value):
    """A command of group 00: start, stop, speed change."""
    c.int_at_stop = 1 if value & state.INT_AT_STOP else 0
    if not c.int_at_stop:
        c.irq = 0
    starts, stops, ramps = value & state.START, value & state.STOP, 1 if value & state.RAMP else 0
    if stops and not starts:
        if c.running:
            state.stop(c)
        c.armed = 1
        if c.extended:
            c.reg[6] = 0
    elif stops and c.running:
        if not ramps and not c.ramps:
            state.stop(c)
        else:
            c.ramps = c.decel = 1
            if c.speed <= c.reg[1]:
                state.stop(c)
    elif starts and not stops:
        if c.running:
            c.ramps, c.select, c.decel = ramps, value & state.SPEED, 0
        elif c.armed and not c.finishing and not blocked(c) and not (c.preset and c.reg[0] == 0):
            c.ramps, c.select, c.decel = ramps, value & state.SPEED, 0
            state.begin(c)
            correct_top(c)
            c.speed = c.reg[1] if c.ramps else selected_speed(c)
            c.running = 1


@hot
def _store(c, k, value):
    """Register `k` takes a new value, masked."""
    c.reg[k] = c.reg[k] & ~c.mask[k] | value & c.mask[k]
    if k in (7, state.R12, state.R13):
        state.read_pins(c)
    if c.running and (k in (1, 4, 5, state.R14, state.R15)):
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
    group = value & state.GROUP
    if group == OPERATE:
        _operate(c, value)
    elif group == CONTROL:
        c.origin, c.sd_enable = 1 if value & state.ORIGIN else 0, 1 if value & state.SD else 0
        c.preset, c.minus = 1 if value & state.PRESET else 0, 1 if value & state.MINUS else 0
        if c.extended:
            c.automatic, c.position = 1 if value & state.AUTOMATIC else 0, 1 if value & state.POSITION else 0
    elif group == SELECT:
        c.selected = value & state.REGISTER
        if c.extended:
            c.selected += state.R10 if value & state.SECOND_EIGHT else 0
            c.collective = 1 if value & state.COLLECTIVE else 0
    else:
        c.output = value & state.OUTPUT_BITS


@hot
def register(c, k):
    """Return what register `k` reads as. The EZ monitor in R17 came with the MS."""
    if k == state.R17 and c.s_curves:
        count = c.ez_left if c.ez_running else c.reg[state.R13] >> state.EZ_COUNT & state.MAX_EZ_COUNT
        return c.reg[state.R17] | count << state.EZ_COUNT | (state.EZ_SIGNAL if c.seen & state.EZ else 0)
    return c.reg[k]


@hot
def outputs(c):
    """The output pins, a bit mask of OUTPUTS; set = asserted (active-low pins: low)."""
    word = 0 if c.running or c.finishing else state.HOLD
    goal = goal_speed(c)
    if not c.running or not c.ramps:
        word |= state.FKEEP
    elif c.speed == goal:
        word |= state.FDOWN if c.clock < c.fall else state.FKEEP
    elif c.speed < goal:
        word |= state.FUP
    else:
        word |= state.FDOWN
    if c.output & state.INDEPENDENT:
        if c.low:
            word |= state.PDIR if c.minus else state.POUT
    else:
        word |= (state.POUT if c.low else 0) | (state.PDIR if c.minus else 0)
    if c.reg[0] < c.reg[6]:
        word |= state.LT
    if c.reg[0] == 0:
        word |= state.ZERO
    if c.output & state.OTS_LEVEL:
        word |= state.OTS
    if c.irq:
        word |= state.IRQ
    return word


@hot
def _status(c):
    word = outputs(c)
    status = 0 if word & state.IRQ else state.S_NO_INT
    if not word & state.HOLD:
        status |= state.S_OPERATING
    if word & state.FKEEP:
        status |= state.S_FKEEP
    if word & state.LT:
        status |= state.S_LT
    if word & state.ZERO:
        status |= state.S_ZERO
    if c.seen & (state.SD_MINUS if c.minus else state.SD_PLUS):
        status |= state.S_SD
    if c.seen & state.ORG:
        status |= state.S_ORG
    if c.seen & state.INS:
        status |= state.S_INS
    return status


@hot
def read_byte(c, address):
    """One bus read cycle. In collective mode the high byte's read latches them all."""
    address &= 3
    if not address:
        return _status(c)
    word = register(c, c.selected) if c.extended and c.output & state.EXTENSION else c.reg[0]
    if c.collective:
        if address == 3:
            c.latch = word
        word = c.latch
    return word >> 8 * (address - 1) & 0xFF
