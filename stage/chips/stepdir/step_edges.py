"""Edges of STEP, DIR and ENABLE, compiled: their times are checked, and each accepted rising edge of STEP counts one step.

A rising edge of STEP moves the count by one, in the direction of DIR, if the power stage accepts it. The times between edges are
compared with the shortest times in the power stage's data sheet. Times are in reference clocks.
"""

from __future__ import annotations

import math

from stage.chips.stepdir.state import DIR, DIR_HOLD, DIR_SETUP, ENABLE, ENABLE_SETUP, HISTORY, STEP, STEP_HIGH, STEP_LOW
from stage.native import hot


@hot
def to_clocks(chip, seconds):
    """Convert a time to the nearest number of reference clocks."""
    return int(math.floor(seconds * chip.hz + 0.5))


@hot
def check_edge_time(chip, time_index, clocks):
    """Return whether the time between two edges is long enough for the power stage; count a violation if it is not."""
    if clocks >= chip.required[time_index]:
        return True
    if chip.violations[time_index] == 0:
        chip.first_violation[time_index] = chip.clock
        chip.shortest[time_index] = clocks
    elif clocks < chip.shortest[time_index]:
        chip.shortest[time_index] = clocks
    chip.violations[time_index] += 1
    return False


@hot
def process_rising_step(chip):
    """Process a rising edge of STEP: count a step in the direction of DIR if the power stage accepts the edge."""
    in_time = check_edge_time(chip, STEP_LOW, chip.clock - chip.fell)
    in_time &= check_edge_time(chip, DIR_SETUP, chip.clock - chip.turned)
    in_time &= check_edge_time(chip, ENABLE_SETUP, chip.clock - chip.enabled)
    chip.rose = chip.clock
    count_step(chip, in_time)


@hot
def count_step(chip, in_time):
    """Count a step in the direction of DIR, or one more that a disabled power stage ignores.

    An edge that came too early for a power stage that drops such edges counts as neither.
    """
    chip.last_step = 0
    if not (chip.inputs & ENABLE or chip.counts_disabled):
        chip.ignored += 1
    elif in_time or not chip.drops_edges:
        minus = 1 if chip.inputs & DIR else 0
        chip.last_step = 1 - 2 * minus
        chip.net += chip.last_step
        chip.history[chip.accepted % HISTORY] = 2 * chip.clock + minus
        chip.accepted += 1


@hot
def _undo_step(chip):
    """Remove the last step from the count, because its pulse was too short for the power stage."""
    if chip.last_step:
        chip.net -= chip.last_step
        chip.accepted -= 1
        chip.last_step = 0


@hot
def process_falling_step(chip):
    """Process a falling edge of STEP: remove the last step if its pulse was too short for the power stage."""
    if not check_edge_time(chip, STEP_HIGH, chip.clock - chip.rose) and chip.drops_edges:
        _undo_step(chip)
    chip.fell = chip.clock


@hot
def apply_line_levels(chip, word):
    """Apply new levels of STEP, DIR and ENABLE.

    If DIR or ENABLE changes at the clock of an edge of STEP, the change of DIR or ENABLE is processed first.
    """
    changed = word ^ chip.inputs
    if changed & word & ENABLE:
        chip.enabled = chip.clock
    if changed & DIR:
        if not check_edge_time(chip, DIR_HOLD, chip.clock - chip.rose) and chip.drops_edges:
            _undo_step(chip)
        chip.turned = chip.clock
    chip.inputs = word
    if changed & word & STEP:
        process_rising_step(chip)
    elif changed & STEP:
        process_falling_step(chip)


@hot
def compute_mean_count(chip, net_before, clocks):
    """Compute the mean of the step count over the last `clocks` clocks; `net_before` is the count at their start.

    If more than HISTORY edges came in that time, the function returns the mean of the first and the last count.
    """
    weighted, rest, k = 0.0, chip.net - net_before, chip.accepted
    while k > 0 and k > chip.accepted - HISTORY:
        entry = chip.history[(k - 1) % HISTORY]
        since, direction = chip.clock - (entry >> 1), 1 - 2 * (entry & 1)
        if since >= clocks:
            return net_before + rest + weighted / clocks
        weighted += direction * since
        rest -= direction
        k -= 1
    return net_before + rest + weighted / clocks if k == 0 else 0.5 * (net_before + chip.net)


@hot
def measure_step_rate(chip, clock_hz):
    """Compute the signed step rate, per second, from the last two accepted edges of a host; 0 when the edges have stopped."""
    if chip.accepted < 2:
        return 0.0
    last, previous = chip.history[(chip.accepted - 1) % HISTORY], chip.history[(chip.accepted - 2) % HISTORY]
    period = (last >> 1) - (previous >> 1)
    if period <= 0 or chip.clock - (last >> 1) > 2 * period:
        return 0.0
    return (1.0 if last & 1 == 0 else -1.0) * clock_hz / period
