"""Inputs of the NOVA chips: from the pins through the filters to active levels, and the counts of encoder pins; compiled.

A pin that is set (True) is low. Low is active while the level bit of the pin in WR1 or WR2 is 0, high while it is 1.
"""

from __future__ import annotations

from stage.chips.nova.motion.counters import add_encoder_counts
from stage.chips.nova.state import ECA, ECB, EMG_FILTER, INPUT_PINS, NEVER, RP, STOP2
from stage.native import greatest, hot, least

UP_DOWN = 3  # PIMD


@hot
def set_active_high(x, word):
    """Set which inputs are active high.

    Args:
        x: State of the axis.
        word: Bits of INPUTS.
    """
    x.active_high_inputs = word
    x.active_inputs = x.filtered_inputs ^ word


@hot
def _find_quadrature_phase(word):
    """Return the quarter of its period, 0 to 3, in which an encoder with these levels is. A leads B forward."""
    a, b = 1 if word & ECA else 0, 1 if word & ECB else 0
    return 2 * b + (a ^ b)


@hot
def _count_encoder_pins(c, x, old, new):
    """Count an edge of ECA or ECB that a user of the pins has made, as the input mode says.

    Args:
        c: State of the chip.
        x: State of the axis.
        old: Levels before the edge.
        new: Levels after it.
    """
    direction = -1 if x.encoder_reversed else 1
    if x.encoder_mode == UP_DOWN:
        rises = new & ~old
        add_encoder_counts(c, x, direction * ((1 if rises & ECA else 0) - (1 if rises & ECB else 0)))
        return
    begin, end = _find_quadrature_phase(old), _find_quadrature_phase(new)
    step = (end - begin) & 3
    if step == 2:
        return  # both at once: no direction can be told
    step = 1 if step == 1 else -1
    seam = (
        greatest(begin, end) if abs(begin - end) == 1 else 0
    )  # between which quarters: 1, 2, 3, or 0 at the period's end
    if x.encoder_mode == 0 or (x.encoder_mode == 1 and seam % 2 == 0) or (x.encoder_mode == 2 and seam == 0):
        add_encoder_counts(c, x, direction * step)


@hot
def update_inputs(c, x):
    """Let the filtered levels follow the pins, and return the clock at which a filter passes the next change."""
    at = NEVER
    if x.inputs == x.filtered_inputs:
        for k in range(INPUT_PINS):
            x.filter_ends[k] = 0
        return at
    old = x.filtered_inputs
    for k in range(INPUT_PINS):
        bit = 1 << k
        if not (x.inputs ^ x.filtered_inputs) & bit:
            x.filter_ends[k] = 0
            continue
        if x.inputs_with_filter & bit:
            if x.filter_ends[k] == 0:
                x.filter_ends[k] = c.clock + (x.second_filter_delay if bit & (STOP2 | ECA | ECB) else x.filter_delay)
            if c.clock < x.filter_ends[k]:
                at = least(at, x.filter_ends[k])
                continue
            x.filter_ends[k] = 0
        x.filtered_inputs ^= bit
    if (old ^ x.filtered_inputs) & (ECA | ECB):
        _count_encoder_pins(c, x, old, x.filtered_inputs)
    if (
        x.stop2_clears_ep
        and x.driving
        and (x.filtered_inputs ^ x.active_high_inputs) & ~x.active_inputs & STOP2
        and (x.stop_inputs & 4 or x.home_state)
    ):
        x.reg[RP] = 0
    if old != x.filtered_inputs:
        x.active_inputs = x.filtered_inputs ^ x.active_high_inputs
        c.stale = 1
    return at


@hot
def update_emergency(c):
    """Let the filtered level of EMG follow its pin, as `update_inputs` does. Its filter is that of axis X."""
    x = c.ax[0]
    if c.emg_pin == c.emergency:
        c.emg_filter_end = 0
        return NEVER
    if x.inputs_with_filter & EMG_FILTER:
        if c.emg_filter_end == 0:
            c.emg_filter_end = c.clock + x.filter_delay
        if c.clock < c.emg_filter_end:
            return c.emg_filter_end
    c.emg_filter_end = 0
    c.emergency = c.emg_pin
    c.stale = 1
    return NEVER
