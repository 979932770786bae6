"""Lists of the pulses of NOVA drives by their clocks, and of the changes of an axis for waveforms; compiled.

At a constant speed of a whole number of pulses per second the pulses are evenly spaced, CLOCKS_PER_SECOND / pps clocks apart,
which integers count exactly as Bresenham's algorithm does: `even_rest` is the distance by which the position at the clock of a
pulse exceeds its number, in pulses / CLOCKS_PER_SECOND, rounded down. If it falls below 0 the pulse comes one clock later. So
each pulse has the clock that profile_evaluation.py would compute.
"""

from __future__ import annotations

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.profile_evaluation import (
    CLOCKS_PER_SECOND,
    PLACE_TOLERANCE,
    compute_exact_place,
    find_clock_in_piece,
    find_clock_of_pulse,
    find_piece,
    find_piece_of_pulse,
)
from stage.chips.nova.state import CONSTANT, LP, NEVER
from stage.native import greatest, hot, least

NO_EVEN_PPS = -1  # in place of pps: not a whole number, or a ramp
RATE_STEPS_PER_PIECE = 128  # of its rate, in a piece
SPARE_EDGE_RECORDS = 8
MAX_TRAIN_CLOCKS = 1 << 38  # clocks; times pps it fits 63 bits


@hot
def log_pulses(chip, until, pulses, first, pulse_index):
    """Log the pulses of all drives in progress, ordered by clock, then by axis.

    Args:
        chip: State of the chip.
        until: Clock at the end.
        pulses: PULSE records to fill.
        first: Number of the first record of this call; earlier records belong to earlier times.
        pulse_index: Number of the next free record.

    Returns:
        The number of the next free record.
    """
    begin = pulse_index
    for j in range(chip.axes):
        axis = chip.ax[j]
        _clear_predicted_pulse(axis)
        if axis.driving and not axis.interpolates:
            _predict_pulse(axis, 1)
    while pulse_index < len(pulses):
        a = 0
        for j in range(1, chip.axes):
            if chip.ax[j].next_pulse_clock < chip.ax[a].next_pulse_clock:
                a = j
        axis = chip.ax[a]
        if axis.next_pulse_clock > until:
            break
        if axis.even_pps > 0:
            stop = until
            for j in range(chip.axes):
                if j != a:
                    stop = least(stop, chip.ax[j].next_pulse_clock - (1 if j < a else 0))
            pulse_index = _log_even_pulses(axis, a, stop, pulses, pulse_index)
        else:
            pulses[pulse_index].clock = axis.next_pulse_clock
            pulses[pulse_index].axis = a
            pulses[pulse_index].direction = axis.direction
            pulse_index += 1
            _predict_pulse(axis, 1)
    for j in range(chip.axes):
        _clear_predicted_pulse(chip.ax[j])
        chip.ax[j].next_pulse_clock = 0
    _merge_by_clock(pulses, first, begin, pulse_index)
    return pulse_index


@hot
def _clear_predicted_pulse(axis):
    """Clear the predicted next pulse of an axis."""
    axis.logged_pulses = axis.next_pulse_piece = axis.even_pps = axis.even_rest = 0
    axis.next_pulse_clock = NEVER


@hot
def _log_even_pulses(axis, axis_index, until, pulses, pulse_index):
    """Log the evenly spaced pulses of one axis.

    Args:
        axis: State of the axis.
        axis_index: Number of the axis.
        until: Clock at the end.
        pulses: PULSE records to fill.
        pulse_index: Number of the next free record.

    Returns:
        The number of the next free record.
    """
    due, rest, pps, direction = axis.next_pulse_clock, axis.even_rest, axis.even_pps, axis.direction
    last = (
        axis.origin + axis.from_clock[axis.next_pulse_piece + 1] if axis.next_pulse_piece + 1 < axis.pieces else NEVER
    )
    n = 1 + (pps * least(least(until, last) - due, MAX_TRAIN_CLOCKS) + rest) // CLOCKS_PER_SECOND
    n = least(n, len(pulses) - pulse_index)
    if axis.fixed:
        n = least(n, axis.output_pulses - axis.pulses_done - axis.logged_pulses + 1)
    period = CLOCKS_PER_SECOND // pps
    part = CLOCKS_PER_SECOND - period * pps
    for i in range(pulse_index, pulse_index + n):
        e = pulses[i]
        e.clock, e.axis, e.direction = due, axis_index, direction
        due += period
        rest -= part
        if rest < 0:
            rest += pps
            due += 1
    if due > last or (axis.fixed and axis.pulses_done + axis.logged_pulses + n > axis.output_pulses):
        _predict_pulse(axis, n)
    else:
        axis.logged_pulses, axis.next_pulse_clock, axis.even_rest = axis.logged_pulses + n, due, rest
    return pulse_index + n


@hot
def _predict_pulse(axis, pulses_ahead):
    """Predict the clock of the pulse that is `pulses_ahead` pulses ahead; NEVER if the drive ends before it."""
    axis.logged_pulses += pulses_ahead
    axis.next_pulse_clock = NEVER
    k = axis.pulses_done + axis.logged_pulses
    if axis.fixed and k > axis.output_pulses:
        return
    s = axis.next_pulse_piece
    if s + 1 < axis.pieces:
        axis.next_pulse_piece = find_piece_of_pulse(axis, s, k)
    clock = find_clock_in_piece(axis, axis.next_pulse_piece, k)
    axis.next_pulse_clock = axis.origin + clock
    if axis.next_pulse_piece != s or axis.even_pps != NO_EVEN_PPS:
        _find_even_spacing(axis, axis.next_pulse_piece, k, clock)


@hot
def _find_even_spacing(axis, piece, pulse_number, clocks):
    """Set `even_pps` and `even_rest` if the pulses of a piece are evenly spaced from a pulse on.

    Args:
        axis: State of the axis.
        piece: Number of the piece.
        pulse_number: Number of the pulse in its drive.
        clocks: Clocks after the origin at which the pulse begins.
    """
    axis.even_pps = NO_EVEN_PPS
    if axis.a2[piece, 0] != 0.0 or axis.j6[piece, 0] != 0.0 or clocks >= NEVER:
        return
    hz = dd.to_double_double(CLOCKS_PER_SECOND)
    speed = dd.multiply((axis.v[piece, 0], axis.v[piece, 1]), hz)
    pps = dd.floor(dd.add(speed, (0.5, 0.0)))
    if pps < 1 or abs(dd.subtract(speed, dd.to_double_double(pps))[0]) > 1e-29 * pps:
        return
    goal = dd.to_double_double(pulse_number - axis.from_pulse[piece])
    over = dd.add(dd.subtract(compute_exact_place(axis, piece, clocks), goal), (PLACE_TOLERANCE, 0.0))
    rest = dd.floor(dd.multiply(over, hz))
    axis.even_pps = 0
    if 0 <= rest < pps:
        axis.even_pps, axis.even_rest = pps, rest


@hot
def _merge_by_clock(pulses, first, middle, end):
    """Merge the records from `middle` to `end` into those from `first` to `middle`. Both parts are ordered by clock, then axis."""
    if first == middle or middle == end:
        return
    for k in range(middle, end):
        clock, axis, direction = pulses[k].clock, pulses[k].axis, pulses[k].direction
        at = k
        while at > first and (
            pulses[at - 1].clock > clock or (pulses[at - 1].clock == clock and pulses[at - 1].axis > axis)
        ):
            pulses[at].clock = pulses[at - 1].clock
            pulses[at].axis = pulses[at - 1].axis
            pulses[at].direction = pulses[at - 1].direction
            at -= 1
        pulses[at].clock, pulses[at].axis, pulses[at].direction = clock, axis, direction


@hot
def write_edge(chip, axis_index, edges, edge_index, outputs, rate):
    """Write the present state of an axis into an EDGE record.

    Args:
        chip: State of the chip.
        axis_index: Number of the axis.
        edges: EDGE records.
        edge_index: Number of the record.
        outputs: Output pins, bits of OUTPUTS.
        rate: Pulses per clock.

    Returns:
        The number of the next record, `edge_index` + 1.
    """
    e, axis = edges[edge_index], chip.ax[axis_index]
    e.clock, e.inputs, e.outputs, e.counter, e.net = chip.clock, axis.inputs, outputs, axis.reg[LP], axis.net
    e.rate = rate
    return edge_index + 1


@hot
def _find_next_rate_step(axis, clocks):
    """Find the clock after the origin at which the rate of a ramp, shown as steps, takes its next step."""
    s = find_piece(axis, clocks)
    if axis.piece_phase[s] == CONSTANT or s + 1 >= axis.pieces:
        return 1 << 60
    begin = axis.from_clock[s]
    step = greatest(1, (axis.from_clock[s + 1] - begin) // RATE_STEPS_PER_PIECE)
    return begin + ((clocks - begin) // step + 1) * step


@hot
def find_scan_stop(chip, axis_index, every_pulse, pulse_end, until):
    """Find the clock up to which a scan can run without missing a change of an axis. A ramp counts as steps of its rate.

    Args:
        chip: State of the chip.
        axis_index: Number of the axis.
        every_pulse: Include the edges of the pulse output.
        pulse_end: Clock at which the present pulse goes off.
        until: Clock at the end.

    Returns:
        The clock.
    """
    axis = chip.ax[axis_index]
    if every_pulse and pulse_end > chip.clock:
        until = least(until, pulse_end)
    if axis.driving:
        until = least(until, axis.origin + _find_next_rate_step(axis, chip.clock - axis.origin))
        if every_pulse and not (axis.fixed and axis.pulses_done >= axis.output_pulses):
            until = least(until, axis.origin + find_clock_of_pulse(axis, axis.pulses_done + 1))
    return until
