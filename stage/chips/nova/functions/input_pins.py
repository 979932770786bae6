"""Input pins of the NOVA chips, compiled: a pin passes its filter, and its level bit says which level is active.

The module also counts the edges of the encoder pins ECA and ECB.

A pin that is set (True) is low. Low is active while the level bit of the pin in WR1 or WR2 is 0, high while it is 1.
"""

from __future__ import annotations

from stage.chips.nova.motion.counters import add_encoder_counts
from stage.chips.nova.state import ECA, ECB, EMG_FILTER, INPUT_PINS, NEVER, RP, STOP2
from stage.native import greatest, hot, least

UP_DOWN = 3  # PIMD


@hot
def set_active_high(axis, word):
    """Set which inputs of an axis are active high.

    Args:
        axis: State of the axis.
        word: Bits of INPUTS.
    """
    axis.active_high_inputs = word
    axis.active_inputs = axis.filtered_inputs ^ word


@hot
def _find_quadrature_phase(levels):
    """Return the quarter, 0 to 3, of an encoder's period in which ECA and ECB have these levels. A leads B forward."""
    a, b = 1 if levels & ECA else 0, 1 if levels & ECB else 0
    return 2 * b + (a ^ b)


@hot
def _count_encoder_edge(chip, axis, old_levels, new_levels):
    """Count an edge of ECA or ECB that was made by setting the pins, in the mode that the registers select.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        old_levels: Levels before the edge.
        new_levels: Levels after it.
    """
    direction = -1 if axis.encoder_reversed else 1
    if axis.encoder_mode == UP_DOWN:
        rises = new_levels & ~old_levels
        add_encoder_counts(chip, axis, direction * ((1 if rises & ECA else 0) - (1 if rises & ECB else 0)))
        return
    begin, end = _find_quadrature_phase(old_levels), _find_quadrature_phase(new_levels)
    step = (end - begin) & 3
    if step == 2:
        return  # both at once: no direction can be told
    step = 1 if step == 1 else -1
    # between which quarters: 1, 2, 3, or 0 at the period's end
    seam = greatest(begin, end) if abs(begin - end) == 1 else 0
    if axis.encoder_mode == 0 or (axis.encoder_mode == 1 and seam % 2 == 0) or (axis.encoder_mode == 2 and seam == 0):
        add_encoder_counts(chip, axis, direction * step)


@hot
def update_inputs(chip, axis):
    """Update the filtered levels of an axis' input pins; return the clock at which a filter passes the next change."""
    at = NEVER
    if axis.inputs == axis.filtered_inputs:
        for k in range(INPUT_PINS):
            axis.filter_ends[k] = 0
        return at
    old = axis.filtered_inputs
    for k in range(INPUT_PINS):
        bit = 1 << k
        if not (axis.inputs ^ axis.filtered_inputs) & bit:
            axis.filter_ends[k] = 0
            continue
        if axis.inputs_with_filter & bit:
            if axis.filter_ends[k] == 0:
                axis.filter_ends[k] = chip.clock + (
                    axis.second_filter_delay if bit & (STOP2 | ECA | ECB) else axis.filter_delay
                )
            if chip.clock < axis.filter_ends[k]:
                at = least(at, axis.filter_ends[k])
                continue
            axis.filter_ends[k] = 0
        axis.filtered_inputs ^= bit
    if (old ^ axis.filtered_inputs) & (ECA | ECB):
        _count_encoder_edge(chip, axis, old, axis.filtered_inputs)
    if (
        axis.stop2_clears_ep
        and axis.driving
        and (axis.filtered_inputs ^ axis.active_high_inputs) & ~axis.active_inputs & STOP2
        and (axis.stop_inputs & 4 or axis.home_state)
    ):
        axis.reg[RP] = 0
    if old != axis.filtered_inputs:
        axis.active_inputs = axis.filtered_inputs ^ axis.active_high_inputs
        chip.stale = 1
    return at


@hot
def update_emergency_input(chip):
    """Update the filtered level of the emergency pin EMG, and return the clock of its next change.

    Its filter is that of axis X.
    """
    axis = chip.ax[0]
    if chip.emg_pin == chip.emergency:
        chip.emg_filter_end = 0
        return NEVER
    if axis.inputs_with_filter & EMG_FILTER:
        if chip.emg_filter_end == 0:
            chip.emg_filter_end = chip.clock + axis.filter_delay
        if chip.clock < chip.emg_filter_end:
            return chip.emg_filter_end
    chip.emg_filter_end = 0
    chip.emergency = chip.emg_pin
    chip.stale = 1
    return NEVER
