"""Interpolation commands of the MCX312 and MCX314As, their register WR5, and their stack of three bit pattern sets; compiled.

The MCX314As also has lines and patterns of three axes.
"""

from __future__ import annotations

from stage.chips.nova.interpolation import interpolator as interpolation
from stage.chips.nova.interpolation import segment
from stage.chips.nova.registers.mcx300 import MCX312_MAP as MAP
from stage.chips.nova.registers.mcx300 import MCX314AS_MAP
from stage.chips.nova.state import ARC, CP, LINE, PATTERN, TP
from stage.native import greatest, hot, least

LINE_2, CIRCLE_CW, CIRCLE_CCW, PATTERN_2 = MAP.command_codes("IP_2ST", "IP_CW", "IP_CCW", "IP_2BP")
BP_ON, BP_OFF, BP_STACK, BP_CLEAR = MAP.command_codes("BP_ENABLED", "BP_DISABLED", "BP_STACK", "BP_CLR")
ONE_STEP, DEC_ON, DEC_OFF, CLEAR = MAP.command_codes("IP_1STEP", "IP_DEC_VALID", "IP_DEC_INVALID", "IP_INTRPT_CLR")
LINE_3, PATTERN_3 = MCX314AS_MAP.command_codes("IP_3ST", "IP_3BP")
AX1 = MAP.bit("WR5", "AX1")  # the others lie behind, two bits each
LSPD = MAP.bit("WR5", "LSPD")
EXPLS, CMPLS = MAP.masks("WR5", "EXPLS", "CMPLS")
VECTOR_AXIS_COUNTS = (0, 2, 2, 3)
"""Number of axes that constant vector speed considers, by LSPD."""
SET_WORDS = 6  # of a set: + and - of three axes
I_DRV, CNEXT = MAP.masks("RR0", "I-DRV", "CNEXT")
ZONE, BPSC = MAP.bit("RR0", "ZONE"), MAP.bit("RR0", "BPSC")
MAX_SETS = 3


@hot
def execute_command(chip, code):
    """Execute an interpolation command of the MCX312 or MCX314As, 30h to 3Dh."""
    ip = chip.ip
    if code in (LINE_2, CIRCLE_CW, CIRCLE_CCW, PATTERN_2):
        _load_segment(chip, code, 2)
    elif code in (LINE_3, PATTERN_3):
        if chip.extended:
            _load_segment(chip, code, 3)
    elif code in (BP_ON, BP_OFF):
        ip.loads_pattern = 1 if code == BP_ON else 0
    elif code == BP_STACK:
        _stack_pattern_set(chip)
    elif code == BP_CLEAR:
        ip.stacked_sets = 0
        if _is_pattern_in_progress(chip):
            ip.waiting_segments = 0
            segment.update_pattern_end(chip)
    elif code in (DEC_ON, DEC_OFF):
        ip.deceleration_enabled = 1 if code == DEC_ON else 0
    elif code == CLEAR:
        ip.interrupt = 0
    elif code == ONE_STEP and chip.outputs5 & CMPLS:
        interpolation.make_single_step(chip)
    chip.stale = 1


@hot
def _to_coordinate(value):
    """Convert the value of a register to a signed coordinate of a finish point or center: 31 of its 32 bits."""
    return (value + (1 << 30) & (1 << 31) - 1) - (1 << 30)


@hot
def _initialize_segment(chip, segment, axis_word, axis_count):
    """Select the first axes of the word WR5 for a segment, and set the segment's other fields to their defaults.

    Args:
        chip: State of the chip.
        segment: The segment.
        axis_word: Axis numbers, in a word like WR5.
        axis_count: Number of axes.
    """
    segment.axis_count = axis_count
    for k in range(axis_count):
        segment.axis_numbers[k] = axis_word >> AX1 + 2 * k & 3
    segment.inner_ticks = segment.y_sign = 1
    segment.tick_count = segment.rotations = 0
    segment.vector_axes = least(VECTOR_AXIS_COUNTS[chip.outputs5 >> LSPD & 3], axis_count)
    segment.decelerates = chip.ip.deceleration_enabled


@hot
def _find_axis_mask(chip, axis_word, axis_count):
    """Return the mask of the first axes of the word WR5; 0 if the chip lacks one of them, or one occurs twice."""
    mask = 0
    for k in range(axis_count):
        j = axis_word >> AX1 + 2 * k & 3
        if j >= chip.axes or mask >> j & 1:
            return 0
        mask |= 1 << j
    return mask


@hot
def _load_segment(chip, code, axis_count):
    """Execute a segment command of the MCX312 or MCX314As, 30h to 35h: start the segment, queue it, or ignore it.

    Args:
        chip: State of the chip.
        code: Code of the command.
        axis_count: Number of axes.
    """
    w, ip = chip.outputs5, chip.ip
    mask, pattern = _find_axis_mask(chip, w, axis_count), code in (PATTERN_2, PATTERN_3)
    if not interpolation.can_take_segment(chip, mask, ip.queue_depth if chip.interpolating else 1):
        return
    if chip.interpolating and (pattern or chip.queue[ip.queue_head].kind == PATTERN):
        return
    stepped = 2 if w & EXPLS else w & CMPLS
    if pattern:
        sets, ip.stacked_sets = ip.stacked_sets, 0
        for k in range(sets):
            _submit_pattern_set(chip, k, w, axis_count, stepped)
            if not chip.interpolating:
                return
        return
    segment = chip.queue[interpolation.find_free_queue_slot(chip)]
    _initialize_segment(chip, segment, w, axis_count)
    for k in range(axis_count):
        axis = chip.ax[segment.axis_numbers[k]]
        segment.finish[k] = _to_coordinate(axis.reg[TP])
        if k < 2:
            segment.center[k] = _to_coordinate(axis.reg[CP])
        segment.tick_count = greatest(segment.tick_count, abs(segment.finish[k]))
    segment.kind = LINE if code in (LINE_2, LINE_3) else ARC
    segment.y_sign = -1 if code == CIRCLE_CW else 1
    interpolation.submit_segment(chip, mask, segment.axis_numbers[0], 1, stepped)


@hot
def _submit_pattern_set(chip, set_number, axis_word, axis_count, single_stepped):
    """Start or queue set `set_number` of the bit pattern stack as a segment.

    Args:
        chip: State of the chip.
        set_number: Number of the set.
        axis_word: Axis numbers, in a word like WR5.
        axis_count: Number of axes.
        single_stepped: Whether single steps move it.
    """
    ip, queued_segment = chip.ip, chip.queue[interpolation.find_free_queue_slot(chip)]
    _initialize_segment(chip, queued_segment, axis_word, axis_count)
    queued_segment.kind = PATTERN
    for m in range(axis_count):
        queued_segment.finish[m] = ip.pattern_stack[set_number, 2 * m] | ip.pattern_stack[set_number, 2 * m + 1] << 16
    if chip.interpolating:
        queued_segment.decelerates = chip.queue[ip.queue_head].decelerates
    interpolation.submit_segment(
        chip, _find_axis_mask(chip, axis_word, axis_count), queued_segment.axis_numbers[0], MAX_SETS - 1, single_stepped
    )
    segment.update_pattern_end(chip)


@hot
def _is_pattern_in_progress(chip):
    """Return whether a bit pattern is in progress."""
    return chip.interpolating and chip.queue[chip.ip.queue_head].kind == PATTERN


@hot
def _count_pattern_sets(chip):
    """Return BPSC, the number of bit pattern sets in progress or stacked."""
    return chip.ip.waiting_segments + 1 if _is_pattern_in_progress(chip) else chip.ip.stacked_sets


@hot
def _stack_pattern_set(chip):
    """Stack the bit pattern set that was written (38h), or queue it behind the running set. A fourth set is lost."""
    interpolation = chip.ip
    if _count_pattern_sets(chip) >= MAX_SETS:
        return
    for m in range(SET_WORDS):
        interpolation.pattern_stack[interpolation.stacked_sets, m] = interpolation.pattern_words[m]
    if _is_pattern_in_progress(chip):
        segment, axes = chip.queue[interpolation.queue_head], 0
        for k in range(segment.axis_count):
            axes |= segment.axis_numbers[k] << AX1 + 2 * k
        _submit_pattern_set(chip, 0, axes, segment.axis_count, interpolation.single_stepped)
    else:
        interpolation.stacked_sets += 1


@hot
def store_pattern_word(chip, word_index, value):
    """Store a word in one of the bit pattern registers BP1P, BP1M, BP2P, BP2M, BP3P or BP3M."""
    chip.ip.pattern_words[word_index] = value


@hot
def is_loading_pattern(chip):
    """Return whether writes to WR2 and above go to the bit pattern registers."""
    return chip.ip.loads_pattern


@hot
def compute_status_bits(chip):
    """Compute the interpolation status of the MCX312 or MCX314As: I-DRV, CNEXT, ZONE and BPSC, bits of RR0."""
    interpolation = chip.ip
    word = _count_pattern_sets(chip) << BPSC
    if chip.interpolating:
        word |= (
            I_DRV
            | (CNEXT if interpolation.waiting_segments < interpolation.queue_depth else 0)
            | interpolation.zone << ZONE
        )
    return word
