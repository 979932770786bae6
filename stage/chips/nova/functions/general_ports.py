"""General inputs and outputs of the NOVA chips (PIO of the MCX514), pulses on them, and the output DCC; compiled.

A PIO pin is a general input, a general output, a drive status, or a sync pulse (PIO0 to PIO3) or comparison (PIO4 to PIO7).
Drive status of PIO0 to PIO7 [M]: DRIVE, ERROR, ASND, CNST, DSND, AASND, ACNST, ADSND. P2M says how long a sync pulse is, and
its level. OUT0 to OUT3 of the older chips are those of WR4, or with OUTSL CMP+, CMP-, ASND, DSND [I].
"""

from __future__ import annotations

from stage.chips.nova.motion import counters
from stage.chips.nova.motion.drive_phases import compute_ramp_phase_bits, is_axis_busy
from stage.chips.nova.registers.field_builders import DCC_WIDTHS_US
from stage.chips.nova.registers.mcx300 import MCX304_MAP, MCX314AS_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.registers.mcx514_words import SYNC_PULSE_CLOCKS
from stage.chips.nova.state import (
    COMP_MINUS,
    COMP_PLUS,
    H2M,
    HM,
    MCX514_TYPE,
    NEVER,
    P1M,
    P2M,
    P3M,
    PIO0_SHIFT,
    SYNC_SETS,
)
from stage.native import hot, least

INPUT, OUTPUT, STATUS, OTHER = range(4)
PIO0_SHIFT = PIO0_SHIFT
LOWER_PORTS, UPPER_PORTS = 8, 63 << 8
CLOCKS_PER_US = 16
DCP, DCCW = MCX514_MAP.bit("H2M", "DCP"), MCX304_MAP.bit("HM", "DCCW")
OUT4 = MCX314AS_MAP.bit("WR3", "OUT")
PW, OUTSL = MCX514_MAP.bit("P2M", "PW"), MCX304_MAP.mask("WR3", "OUTSL")


@hot
def find_pin_kind(axis, pin_index):
    """Return the function of the general pin PIO `pin_index` of the MCX514's kind: INPUT, OUTPUT, STATUS or OTHER."""
    return axis.mode[P1M] >> 2 * pin_index & 3


@hot
def find_general_input_pins(axis):
    """Return which of PIO0 to PIO7 are general inputs, as bits."""
    word = 0
    for i in range(LOWER_PORTS):
        if find_pin_kind(axis, i) == INPUT:
            word |= 1 << i
    return word


@hot
def compute_port_levels(chip, axis_index):
    """Compute the levels of the PIO pins of an axis, bit i for PIO i."""
    axis = chip.ax[axis_index]
    output_word = chip.outputs5 if (axis_index and chip.axes == 2) or axis_index > 1 else chip.outputs4
    output_word >>= 8 if axis_index & 1 and chip.axes == 4 else 0
    status = (
        (1 if is_axis_busy(axis) else 0)
        | (2 if axis.stop_causes & 0xFF else 0)
        | compute_ramp_phase_bits(chip, axis) << 2
    )
    other = (axis.true_comparisons & 15) << 4
    for m in range(SYNC_SETS):
        if chip.clock < axis.pulse_until[m]:
            other |= 1 << m
    other ^= axis.mode[P2M] & 15
    word = 0
    for i in range(LOWER_PORTS):
        what = find_pin_kind(axis, i)
        source = (
            axis.inputs >> PIO0_SHIFT
            if what == INPUT
            else output_word
            if what == OUTPUT
            else status
            if what == STATUS
            else other
        )
        word |= source & 1 << i
    return word | _compute_upper_ports(axis, output_word) if chip.axes == 2 else word


@hot
def _compute_upper_ports(axis, output_word):
    """Compute the levels of PIO8 to PIO13 of the MCX512."""
    out = axis.mode[P3M] << LOWER_PORTS & UPPER_PORTS
    return output_word & out | axis.inputs >> PIO0_SHIFT & UPPER_PORTS & ~out


@hot
def compute_port_word(chip, first_axis):
    """Compute RR4 or RR5: the PIO levels of axes `first_axis` and `first_axis` + 1, on the MCX512 those of one axis."""
    if chip.axes == 2:
        return compute_port_levels(chip, first_axis // 2)
    return compute_port_levels(chip, first_axis) | compute_port_levels(chip, first_axis + 1) << 8


@hot
def compute_driven_levels(chip, axis_index):
    """Return the levels that the chip drives onto general pins of an axis: PIO pins that are outputs, or OUT0 to OUT3."""
    if chip.variant == MCX514_TYPE:
        axis = chip.ax[axis_index]
        output_word = find_general_input_pins(axis) | ~(axis.mode[P3M] << LOWER_PORTS) & UPPER_PORTS
        return compute_port_levels(chip, axis_index) & ~output_word if axis.mode[P1M] or axis.mode[P3M] else 0
    axis, output_word = chip.ax[axis_index], chip.outputs4 >> 4 * axis_index & 15
    if chip.extended:
        return (
            output_word | (_compute_status_outputs(chip, axis) if axis.wr[3] & OUTSL else axis.wr[3] >> OUT4 & 15) << 4
        )
    return _compute_status_outputs(chip, axis) if axis.wr[3] & OUTSL else output_word


@hot
def _compute_status_outputs(chip, axis):
    """Compute the status outputs CMP+, CMP-, ASND and DSND of an axis as bits 0 to 3."""
    bits, counter = compute_ramp_phase_bits(chip, axis), counters.read_soft_limit_counter(axis)
    word = (1 if counter >= axis.reg[COMP_PLUS] else 0) | (2 if counter < axis.reg[COMP_MINUS] else 0)
    return word | (4 if bits & 1 else 0) | (8 if bits & 4 else 0)


@hot
def start_sync_pulse(chip, axis, set_index):
    """Begin a pulse on the PIO pin of SYNC set `set_index`."""
    axis.pulse_until[set_index] = chip.clock + SYNC_PULSE_CLOCKS[axis.mode[P2M] >> PW & 7]
    chip.stale = 1


@hot
def start_dcc_pulse(chip, axis):
    """Begin a pulse on the output DCC, and return its duration in clocks."""
    code = axis.mode[H2M] >> DCP if chip.variant == MCX514_TYPE else axis.mode[HM] >> DCCW
    clocks = CLOCKS_PER_US * DCC_WIDTHS_US[code & 7]
    axis.dcc_end = chip.clock + clocks
    chip.stale = 1
    return clocks


@hot
def find_next_pulse_end(chip, axis):
    """Return the clock at which the next pulse on PIO or DCC ends, NEVER if there is none."""
    at = axis.dcc_end if axis.dcc_end > chip.clock else NEVER
    for m in range(SYNC_SETS):
        if axis.pulse_until[m] > chip.clock:
            at = least(at, axis.pulse_until[m])
    return at


@hot
def reset_pulses(axis):
    """End all pulses on the PIO pins and on the output DCC of an axis."""
    axis.dcc_end = 0
    for m in range(SYNC_SETS):
        axis.pulse_until[m] = 0
