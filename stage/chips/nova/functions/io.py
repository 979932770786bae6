"""NOVA chips, compiled: general inputs and outputs (PIO of the MCX514), pulses on them, and the deviation counter clear output.

A pin is general input, general output, drive status, or sync pulse (PIO0 to PIO3) and comparison (PIO4 to PIO7). Drive status
of PIO0 to PIO7 [M]: DRIVE, ERROR, ASND, CNST, DSND, AASND, ACNST, ADSND. P2M says how long a sync pulse is, and its level.
OUT0 to OUT3 of the older chips are those of WR4, or with OUTSL CMP+, CMP-, ASND, DSND [I].
"""

from __future__ import annotations

from stage.chips.nova.bus.common import busy, phase_bits
from stage.chips.nova.motion import counters
from stage.chips.nova.registers.common import DCC_WIDTHS
from stage.chips.nova.registers.mcx300 import MCX304_MAP, MCX314AS_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.registers.words514 import SYNC_CLOCKS
from stage.chips.nova.state import COMP_MINUS, COMP_PLUS, H2M, HM, MCX514_TYPE, NEVER, P1M, P2M, P3M, PIO, SYNC_SETS
from stage.native import hot, least

INPUT, OUTPUT, STATUS, OTHER = range(4)
FIRST = PIO
PINS, MORE = 8, 63 << 8
US = 16  # clocks
DCP, DCCW = MCX514_MAP.bit("H2M", "DCP"), MCX304_MAP.bit("HM", "DCCW")
OUT4 = MCX314AS_MAP.bit("WR3", "OUT")
PW, OUTSL = MCX514_MAP.bit("P2M", "PW"), MCX304_MAP.mask("WR3", "OUTSL")


@hot
def kind(x, i):
    """Return the kind of PIO `i`."""
    return x.mode[P1M] >> 2 * i & 3


@hot
def inputs(x):
    """PIO0 to PIO7 that are general inputs."""
    word = 0
    for i in range(PINS):
        if kind(x, i) == INPUT:
            word |= 1 << i
    return word


@hot
def levels(c, j):
    """The pins of an axis, bit i for PIO i."""
    x = c.ax[j]
    output_word = c.outputs5 if (j and c.axes == 2) or j > 1 else c.outputs4
    output_word >>= 8 if j & 1 and c.axes == 4 else 0
    status = (1 if busy(x) else 0) | (2 if x.causes & 0xFF else 0) | phase_bits(c, x) << 2
    other = (x.holds & 15) << 4
    for m in range(SYNC_SETS):
        if c.clock < x.pulse_until[m]:
            other |= 1 << m
    other ^= x.mode[P2M] & 15
    word = 0
    for i in range(PINS):
        what = kind(x, i)
        source = (
            x.inputs >> PIO if what == INPUT else output_word if what == OUTPUT else status if what == STATUS else other
        )
        word |= source & 1 << i
    return word | _more(x, output_word) if c.axes == 2 else word


@hot
def _more(x, output_word):
    """PIO8 to PIO13 of the MCX512: inputs or outputs."""
    out = x.mode[P3M] << PINS & MORE
    return output_word & out | x.inputs >> PIO & MORE & ~out


@hot
def word(c, first):
    """RR4, RR5: the pins of axes `first` and `first` + 1; of the MCX512 those of one."""
    if c.axes == 2:
        return levels(c, first // 2)
    return levels(c, first) | levels(c, first + 1) << 8


@hot
def driven(c, j):
    """Return what the chip itself drives onto the pins of an axis: PIO that are outputs; OUT3 to OUT0 of the older chips."""
    if c.variant == MCX514_TYPE:
        x = c.ax[j]
        output_word = inputs(x) | ~(x.mode[P3M] << PINS) & MORE
        return levels(c, j) & ~output_word if x.mode[P1M] or x.mode[P3M] else 0
    x, output_word = c.ax[j], c.outputs4 >> 4 * j & 15
    if c.extended:
        return output_word | (_shown(c, x) if x.wr[3] & OUTSL else x.wr[3] >> OUT4 & 15) << 4
    return _shown(c, x) if x.wr[3] & OUTSL else output_word


@hot
def _shown(c, x):
    """CMP+, CMP-, ASND, DSND."""
    bits, counter = phase_bits(c, x), counters.limited(x)
    word = (1 if counter >= x.reg[COMP_PLUS] else 0) | (2 if counter < x.reg[COMP_MINUS] else 0)
    return word | (4 if bits & 1 else 0) | (8 if bits & 4 else 0)


@hot
def sync_pulse(c, x, m):
    x.pulse_until[m] = c.clock + SYNC_CLOCKS[x.mode[P2M] >> PW & 7]
    c.stale = 1


@hot
def clear_deviation(c, x):
    """A pulse on DCC. Returns how many clocks it lasts."""
    code = x.mode[H2M] >> DCP if c.variant == MCX514_TYPE else x.mode[HM] >> DCCW
    clocks = US * DCC_WIDTHS[code & 7]
    x.dcc = c.clock + clocks
    c.stale = 1
    return clocks


@hot
def next_event(c, x):
    """The end of a pulse."""
    at = x.dcc if x.dcc > c.clock else NEVER
    for m in range(SYNC_SETS):
        if x.pulse_until[m] > c.clock:
            at = least(at, x.pulse_until[m])
    return at


@hot
def reset(x):
    x.dcc = 0
    for m in range(SYNC_SETS):
        x.pulse_until[m] = 0
