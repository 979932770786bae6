"""Interpolation commands of the MCX514 and MCX512, which fill a pre-buffer of eight segments; compiled."""

from __future__ import annotations

from stage.chips.nova.interpolation import helix as helical
from stage.chips.nova.interpolation import interpolator as interpolation
from stage.chips.nova.interpolation import multichip, segment
from stage.chips.nova.registers.mcx514 import MCX514_MAP as MAP
from stage.chips.nova.state import (
    ARC,
    CP,
    HELIX,
    HLN,
    HLV,
    IPM,
    LINE,
    MAX_CHIP_AXES,
    PATTERN,
    PRE_BUFFER_STAGES,
    TP,
    TX,
)
from stage.native import greatest, hot, least

LINES, CIRCLE_CW, CIRCLE_CCW, PATTERNS = MAP.command_codes("LHK1", "CHKCW", "CHKCCW", "BHK2")
HELIX_CW, HELIX_CCW, COUNT_CW, COUNT_CCW = MAP.command_codes("HLCW", "HLCCW", "HLPCW", "HLPCCW")
DECEN, DECDIS, CLRSTEP, MFPC = MAP.command_codes("DECEN", "DECDIS", "CLRSTEP", "MFPC")
CXIV, LMDF, STEP, MAXM = MAP.masks("IPM", "CXIV", "LMDF", "STEP", "MAXM")
SPD = MAP.bit("IPM", "SPD")
CNEXT = MAP.mask("RR0", "CNEXT")
ZONE, SC = MAP.bit("RR0", "ZONE"), MAP.bit("RR0", "SC")
AXIS_ENABLE_MASK = (1 << MAX_CHIP_AXES) - 1
VECTOR_AXIS_COUNTS = (0, 2, 3, 2)
"""Number of axes that constant vector speed considers, by SPD."""


@hot
def execute_command(chip, code):
    """Execute an interpolation command of the MCX514 or MCX512, 60h to 6Fh or 7Ch."""
    ip = chip.ip
    if code in (DECEN, DECDIS):
        ip.deceleration_enabled = 1 if code == DECEN else 0
    elif code == CLRSTEP:
        ip.interrupt = 0
        interpolation.make_single_step(chip)
    elif code == MFPC:
        chip.ax[0].reg[TX] = 0
    elif code in (COUNT_CW, COUNT_CCW):
        _calculate_hlv(chip, code)
    else:
        _load_segment(chip, code)
    chip.stale = 1


@hot
def _count_axes(mask):
    """Count the axes in a mask with a bit for each axis."""
    return (mask & 1) + (mask >> 1 & 1) + (mask >> 2 & 1) + (mask >> 3 & 1)


@hot
def to_coordinate(value, inner_ticks):
    """Convert the value of a register to a signed coordinate of a finish point or center, divided by the inner ticks per tick.

    Args:
        value: Value of the register.
        inner_ticks: Inner ticks per tick.
    """
    half = (1 << 30) // inner_ticks
    return (value + half) % (2 * half) - half


@hot
def _initialize_segment(chip, segment, ipm, axis_count):
    """Select the lowest axes of the word IPM for a segment, and set the segment's other fields to their defaults.

    Args:
        chip: State of the chip.
        segment: The segment.
        ipm: IPM.
        axis_count: Number of axes.
    """
    segment.axis_count = 0
    for j in range(MAX_CHIP_AXES):
        if ipm >> j & 1 and segment.axis_count < axis_count:
            segment.axis_numbers[segment.axis_count] = j
            segment.axis_count += 1
    for k in range(MAX_CHIP_AXES):
        segment.finish[k] = 0
    segment.center[0] = segment.center[1] = segment.rotations = segment.tick_count = 0
    segment.y_sign = segment.inner_ticks = 1
    segment.vector_axes = VECTOR_AXIS_COUNTS[ipm >> SPD & 3]
    segment.decelerates = chip.ip.deceleration_enabled


@hot
def _load_circle(chip, queued_segment, ipm, clockwise):
    """Load the finish point and the center of the first two axes into a segment.

    Args:
        chip: State of the chip.
        queued_segment: The segment.
        ipm: IPM.
        clockwise: Whether the circle is clockwise.
    """
    if ipm & LMDF:
        queued_segment.inner_ticks = segment.INNER_TICKS
    if ipm & CXIV:
        queued_segment.axis_numbers[0], queued_segment.axis_numbers[1] = (
            queued_segment.axis_numbers[1],
            queued_segment.axis_numbers[0],
        )
    queued_segment.y_sign = -1 if clockwise else 1
    queued_segment.vector_axes = least(queued_segment.vector_axes, 2)
    for k in range(2):
        axis = chip.ax[queued_segment.axis_numbers[k]]
        queued_segment.finish[k] = to_coordinate(axis.reg[TP], queued_segment.inner_ticks)
        queued_segment.center[k] = to_coordinate(axis.reg[CP], queued_segment.inner_ticks)


@hot
def _load_segment(chip, code):
    """Execute a segment command of the MCX514 or MCX512, 60h to 6Ah: start the segment, queue it, or refuse it."""
    word = chip.ax[0].mode[IPM]
    mask = word & AXIS_ENABLE_MASK
    count = _count_axes(mask)
    if code < CIRCLE_CW:
        need = code - LINES + 1
    elif PATTERNS <= code < HELIX_CW:
        need = code - PATTERNS + 2
    else:
        need = 2 if code in (CIRCLE_CW, CIRCLE_CCW) else 3
    if count < need:
        interpolation.note_refused_segment(chip)
        return
    role = multichip.find_multichip_role(chip, word)
    if role and (code >= CIRCLE_CW or not multichip.can_take_line(chip, role)):
        return
    if not interpolation.can_take_segment(chip, mask, PRE_BUFFER_STAGES):
        return
    queued_segment = chip.queue[interpolation.find_free_queue_slot(chip)]
    helix = code in (HELIX_CW, HELIX_CCW)
    _initialize_segment(chip, queued_segment, word, count if helix else need)
    main = queued_segment.axis_numbers[0]
    if code < CIRCLE_CW:
        queued_segment.kind = LINE
        if word & LMDF and not role:
            queued_segment.inner_ticks = segment.INNER_TICKS
        for k in range(queued_segment.axis_count):
            queued_segment.finish[k] = to_coordinate(
                chip.ax[queued_segment.axis_numbers[k]].reg[TP], queued_segment.inner_ticks
            )
            queued_segment.tick_count = greatest(queued_segment.tick_count, abs(queued_segment.finish[k]))
        if word & MAXM:
            queued_segment.tick_count = greatest(queued_segment.tick_count, chip.ax[0].reg[TX])
    elif PATTERNS <= code < HELIX_CW:
        queued_segment.kind = PATTERN
        for k in range(queued_segment.axis_count):
            queued_segment.finish[k] = chip.ax[queued_segment.axis_numbers[k]].reg[TP]
    else:
        _load_circle(chip, queued_segment, word, code in (CIRCLE_CW, HELIX_CW))
        queued_segment.kind = HELIX if helix else ARC
        if helix:
            queued_segment.rotations = chip.ax[0].reg[HLN]
            queued_segment.tick_count = helical.convert_hlv_to_inner_ticks(
                chip.ip.scratch_arc, queued_segment, greatest(chip.ax[0].reg[HLV], 1)
            )
            for k in range(2, queued_segment.axis_count):
                queued_segment.finish[k] = to_coordinate(
                    chip.ax[queued_segment.axis_numbers[k]].reg[TP], queued_segment.inner_ticks
                )
    if role:
        multichip.await_linked_start(chip, mask, main, word & STEP, role, word & MAXM)
    else:
        interpolation.submit_segment(chip, mask, main, PRE_BUFFER_STAGES, word & STEP)


@hot
def _calculate_hlv(chip, code):
    """Execute a helical calculation of the MCX514, 6Bh or 6Ch, which writes HLV at once."""
    word = chip.ax[0].mode[IPM]
    if chip.interpolating or _count_axes(word & AXIS_ENABLE_MASK) < 2:
        return
    segment = chip.queue[interpolation.find_free_queue_slot(chip)]
    _initialize_segment(chip, segment, word, 2)
    _load_circle(chip, segment, word & ~LMDF, code == COUNT_CW)
    segment.rotations = chip.ax[0].reg[HLN]
    chip.ax[0].reg[HLV] = helical.calculate_hlv(chip.ip.scratch_arc, segment)


@hot
def read_maximum_finish_point(chip):
    """Return the value of the register TX: the maximum finish point of the running segment, or of the one being written."""
    word = chip.ax[0].mode[IPM]
    if word & MAXM:
        return chip.ax[0].reg[TX]
    if chip.interpolating:
        segment = chip.queue[chip.ip.queue_head]
        return segment.tick_count if segment.kind == LINE else 0
    maximum = 0
    for j in range(MAX_CHIP_AXES):
        if word >> j & 1:
            maximum = greatest(maximum, abs(to_coordinate(chip.ax[j].reg[TP], 1)))
    return maximum


@hot
def compute_status_bits(chip):
    """Compute the status of the interpolation: ZONE, CNEXT and SC, bits of RR0 of the MCX514 and MCX512."""
    interpolation = chip.ip
    if not chip.interpolating:
        return 0
    return (
        interpolation.zone << ZONE
        | (CNEXT if interpolation.waiting_segments < interpolation.queue_depth else 0)
        | interpolation.waiting_segments << SC
    )


@hot
def read_helix_rotations(chip):
    """Return the value of the register CHLN: the number of rotations that the helix has completed."""
    return chip.ip.finished_rotations
