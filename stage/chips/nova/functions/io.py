"""General inputs and outputs of the NOVA chips (PIO of the MCX514), pulses on them, and the output DCC; compiled.

A PIO pin is a general input, a general output, a drive status, or a sync pulse (PIO0 to PIO3) or comparison (PIO4 to PIO7).
Drive status of PIO0 to PIO7 [M]: DRIVE, ERROR, ASND, CNST, DSND, AASND, ACNST, ADSND. P2M says how long a sync pulse is, and
its level. OUT0 to OUT3 of the older chips are those of WR4, or with OUTSL CMP+, CMP-, ASND, DSND [I].
"""

from __future__ import annotations

from stage.chips.nova.bus.common import compute_phase_bits, is_busy
from stage.chips.nova.motion import counters
from stage.chips.nova.registers.common import DCC_WIDTHS
from stage.chips.nova.registers.mcx300 import MCX304_MAP, MCX314AS_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.registers.words514 import SYNC_CLOCKS
from stage.chips.nova.state import COMP_MINUS, COMP_PLUS, H2M, HM, MCX514_TYPE, NEVER, P1M, P2M, P3M, PIO, SYNC_SETS
from stage.native import hot, least

INPUT, OUTPUT, STATUS, OTHER = range(4)
FIRST_PIO = PIO
LOWER_PORTS, UPPER_PORTS = 8, 63 << 8
CLOCKS_PER_US = 16
DCP, DCCW = MCX514_MAP.bit("H2M", "DCP"), MCX304_MAP.bit("HM", "DCCW")
OUT4 = MCX314AS_MAP.bit("WR3", "OUT")
PW, OUTSL = MCX514_MAP.bit("P2M", "PW"), MCX304_MAP.mask("WR3", "OUTSL")


@hot
def find_pin_kind(x, i):
    """Return the function of PIO `i`: INPUT, OUTPUT, STATUS or OTHER."""
    return x.mode[P1M] >> 2 * i & 3


@hot
def find_general_inputs(x):
    """Return which of PIO0 to PIO7 are general inputs, as bits."""
    word = 0
    for i in range(LOWER_PORTS):
        if find_pin_kind(x, i) == INPUT:
            word |= 1 << i
    return word


@hot
def compute_port_levels(c, j):
    """Compute the levels of the PIO pins of an axis, bit i for PIO i."""
    x = c.ax[j]
    output_word = c.outputs5 if (j and c.axes == 2) or j > 1 else c.outputs4
    output_word >>= 8 if j & 1 and c.axes == 4 else 0
    status = (1 if is_busy(x) else 0) | (2 if x.stop_causes & 0xFF else 0) | compute_phase_bits(c, x) << 2
    other = (x.true_comparisons & 15) << 4
    for m in range(SYNC_SETS):
        if c.clock < x.pulse_until[m]:
            other |= 1 << m
    other ^= x.mode[P2M] & 15
    word = 0
    for i in range(LOWER_PORTS):
        what = find_pin_kind(x, i)
        source = (
            x.inputs >> PIO if what == INPUT else output_word if what == OUTPUT else status if what == STATUS else other
        )
        word |= source & 1 << i
    return word | _compute_upper_ports(x, output_word) if c.axes == 2 else word


@hot
def _compute_upper_ports(x, output_word):
    """Compute the levels of PIO8 to PIO13 of the MCX512."""
    out = x.mode[P3M] << LOWER_PORTS & UPPER_PORTS
    return output_word & out | x.inputs >> PIO & UPPER_PORTS & ~out


@hot
def compute_port_word(c, first):
    """Compute RR4 or RR5: the PIO levels of axes `first` and `first` + 1, on the MCX512 those of one axis."""
    if c.axes == 2:
        return compute_port_levels(c, first // 2)
    return compute_port_levels(c, first) | compute_port_levels(c, first + 1) << 8


@hot
def find_driven_outputs(c, j):
    """Return the levels that the chip itself drives onto pins of an axis: PIO that are outputs; OUT0 to OUT3 of the older chips."""
    if c.variant == MCX514_TYPE:
        x = c.ax[j]
        output_word = find_general_inputs(x) | ~(x.mode[P3M] << LOWER_PORTS) & UPPER_PORTS
        return compute_port_levels(c, j) & ~output_word if x.mode[P1M] or x.mode[P3M] else 0
    x, output_word = c.ax[j], c.outputs4 >> 4 * j & 15
    if c.extended:
        return output_word | (_compute_status_outputs(c, x) if x.wr[3] & OUTSL else x.wr[3] >> OUT4 & 15) << 4
    return _compute_status_outputs(c, x) if x.wr[3] & OUTSL else output_word


@hot
def _compute_status_outputs(c, x):
    """Compute CMP+, CMP-, ASND and DSND as bits 0 to 3."""
    bits, counter = compute_phase_bits(c, x), counters.read_limited_counter(x)
    word = (1 if counter >= x.reg[COMP_PLUS] else 0) | (2 if counter < x.reg[COMP_MINUS] else 0)
    return word | (4 if bits & 1 else 0) | (8 if bits & 4 else 0)


@hot
def start_sync_pulse(c, x, m):
    """Begin a pulse on the PIO pin of SYNC set `m`."""
    x.pulse_until[m] = c.clock + SYNC_CLOCKS[x.mode[P2M] >> PW & 7]
    c.stale = 1


@hot
def start_dcc_pulse(c, x):
    """Begin a pulse on DCC, and return how many clocks it lasts."""
    code = x.mode[H2M] >> DCP if c.variant == MCX514_TYPE else x.mode[HM] >> DCCW
    clocks = CLOCKS_PER_US * DCC_WIDTHS[code & 7]
    x.dcc_end = c.clock + clocks
    c.stale = 1
    return clocks


@hot
def find_next_pulse_end(c, x):
    """Return the clock at which the next pulse on PIO or DCC ends, NEVER if there is none."""
    at = x.dcc_end if x.dcc_end > c.clock else NEVER
    for m in range(SYNC_SETS):
        if x.pulse_until[m] > c.clock:
            at = least(at, x.pulse_until[m])
    return at


@hot
def reset_pulses(x):
    """End all pulses on PIO and DCC."""
    x.dcc_end = 0
    for m in range(SYNC_SETS):
        x.pulse_until[m] = 0
