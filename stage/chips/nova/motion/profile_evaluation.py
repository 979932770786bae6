"""Position and speed of a NOVA drive at a clock, and the clock at which its k-th pulse begins; compiled.

The k-th pulse begins at the first whole clock at which the ideal position p has reached k. Floats are exact enough unless p is
next to a whole number; there double-doubles decide. A position within PLACE_TOLERANCE below k counts as k.
"""

from __future__ import annotations

import math

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.state import NEVER
from stage.native import greatest, hot, least

CLOCKS_PER_SECOND = 16_000_000  # clocks in what the formulas call a second
PLACE_TOLERANCE = 2.0**-50
ROUNDING_GUARD = 1e-6


@hot
def find_piece(axis, clocks):
    """Return the number of the speed profile's piece that is in force `clocks` clocks after the profile's origin."""
    s = 0
    while s + 1 < axis.pieces and axis.from_clock[s + 1] <= clocks:
        s += 1
    return s


@hot
def compute_exact_place(axis, piece, clocks):
    """Compute exactly the pulses, with their fraction, that a drive has made at a clock since a piece of its profile began.

    Args:
        axis: State of the axis.
        piece: Number of the piece.
        clocks: Clocks after the origin, which is the clock at which the drive began.

    Returns:
        Pulses after `axis.from_pulse[piece]`, the whole pulses at which the piece began; a double-double.
    """
    t = dd.subtract(dd.to_double_double(clocks), (axis.t[piece, 0], axis.t[piece, 1]))
    r = dd.add((axis.a2[piece, 0], axis.a2[piece, 1]), dd.multiply(t, (axis.j6[piece, 0], axis.j6[piece, 1])))
    r = dd.add((axis.v[piece, 0], axis.v[piece, 1]), dd.multiply(t, r))
    return dd.add((axis.p[piece, 0], axis.p[piece, 1]), dd.multiply(t, r))


@hot
def count_begun_pulses_in_piece(axis, piece, clocks):
    """Count the pulses of the drive that have begun, if the piece of the speed profile is known.

    Args:
        axis: State of the axis.
        piece: Number of the piece.
        clocks: Clocks after the origin, in this piece.

    Returns:
        Number of pulses.
    """
    t = (float(clocks) - axis.t[piece, 0]) - axis.t[piece, 1]
    r = axis.p[piece, 0] + t * (axis.v[piece, 0] + t * (axis.a2[piece, 0] + t * axis.j6[piece, 0]))
    k = math.floor(r)
    over = r - k
    guard = ROUNDING_GUARD + 1e-14 * abs(r)
    if guard < over < 1.0 - guard:
        return axis.from_pulse[piece] + int(k)
    return axis.from_pulse[piece] + dd.floor(dd.add(compute_exact_place(axis, piece, clocks), (PLACE_TOLERANCE, 0.0)))


@hot
def count_begun_pulses(axis, clocks):
    """Count the pulses of the drive that have begun `clocks` clocks after the origin of its speed profile."""
    return count_begun_pulses_in_piece(axis, find_piece(axis, clocks), clocks)


@hot
def compute_speed(axis, clocks):
    """Compute the speed `clocks` clocks after the origin of the speed profile, in pulses per clock."""
    s = find_piece(axis, clocks)
    t = (float(clocks) - axis.t[s, 0]) - axis.t[s, 1]
    return greatest(axis.v[s, 0] + t * (2.0 * axis.a2[s, 0] + 3.0 * t * axis.j6[s, 0]), 0.0)


@hot
def compute_acceleration(axis, clocks):
    """Compute the signed acceleration `clocks` clocks after the speed profile's origin, in pulses per clock squared."""
    s = find_piece(axis, clocks)
    t = (float(clocks) - axis.t[s, 0]) - axis.t[s, 1]
    return 2.0 * axis.a2[s, 0] + 6.0 * t * axis.j6[s, 0]


@hot
def find_phase(axis, clocks):
    """Return the phase of the speed profile `clocks` clocks after its origin: ACCELERATING, CONSTANT, DECELERATING ..."""
    return axis.piece_phase[find_piece(axis, clocks)]


@hot
def compute_time_in_piece(axis, piece, distance, max_time):
    """Compute the time in a piece after which the drive has covered a distance.

    Args:
        axis: State of the axis.
        piece: Number of the piece.
        distance: Pulses from the begin of the piece.
        max_time: Clocks, the largest result.

    Returns:
        Clocks, a float.
    """
    v, a2, j6 = axis.v[piece, 0], axis.a2[piece, 0], axis.j6[piece, 0]
    root = v * v + 4.0 * a2 * distance
    t = 2.0 * distance / (v + math.sqrt(root)) if root > 0.0 else max_time
    if j6 == 0.0:
        return least(t, max_time)
    t = least(t, max_time)
    low, high = 0.0, max_time
    for _ in range(100):
        off = t * (v + t * (a2 + t * j6)) - distance
        if off > 0.0:
            high = t
        else:
            low = t
        slope = v + t * (2.0 * a2 + 3.0 * t * j6)
        new = t - off / slope if slope > 0.0 else 0.5 * (low + high)
        if not low <= new <= high:
            new = 0.5 * (low + high)
        if abs(new - t) <= 1e-15 * t:
            break
        t = new
    return t


@hot
def _compute_clock_by_floats(axis, piece, distance):
    """Compute the clock after the origin at which the drive has covered a distance, if floats are exact enough; else return -1.

    The relative error of floats is below 1e-15, in a ramp 1e-14. The function returns -1 for S-curves, and for linear ramps near
    standstill.

    Args:
        axis: State of the axis.
        piece: Number of the piece.
        distance: Pulses from the begin of the piece.
    """
    v, a2 = axis.v[piece, 0], axis.a2[piece, 0]
    if axis.j6[piece, 0] != 0.0 or v <= 0.0:
        return -1
    t = distance / v
    if a2 != 0.0:
        root = v * v + 4.0 * a2 * distance
        if root < 1e-4 * v * v:
            return -1
        t = 2.0 * distance / (v + math.sqrt(root))
    t += axis.t[piece, 0]
    if not 0.0 <= t < (1e9 if a2 == 0.0 else 1e8):
        return -1
    n = int(math.ceil(t))
    delay = n - t
    if delay < 1e-5 or delay > 1.0 - 1e-5 or n < axis.from_clock[piece]:
        return -1
    if piece + 1 < axis.pieces and n > axis.from_clock[piece + 1]:
        return -1
    return n


@hot
def find_piece_of_pulse(axis, piece, pulse):
    """Find the piece of the speed profile in which a pulse of the drive begins.

    Args:
        axis: State of the axis.
        piece: Number of the first piece to search.
        pulse: Number of the pulse.

    Returns:
        Number of the piece.
    """
    while piece + 1 < axis.pieces and count_begun_pulses_in_piece(axis, piece, axis.from_clock[piece + 1]) < pulse:
        piece += 1
    return piece


@hot
def find_clock_of_pulse(axis, pulse):
    """Find the clock after the origin at which pulse number `pulse` of the drive begins, NEVER if that is centuries ahead."""
    return find_clock_in_piece(axis, find_piece_of_pulse(axis, 0, pulse), pulse)


@hot
def find_clock_in_piece(axis, piece, pulse):
    """Find the clock at which a pulse of the drive begins, if its piece of the speed profile is known.

    Args:
        axis: State of the axis.
        piece: Number of the piece.
        pulse: Number of the pulse.

    Returns:
        The clock after the origin.
    """
    distance = float(pulse - axis.from_pulse[piece]) - axis.p[piece, 0]
    n = _compute_clock_by_floats(axis, piece, distance)
    if n >= 0:
        return n
    last = piece + 1 == axis.pieces
    max_time = 1e17 if last else (axis.t[piece + 1, 0] - axis.t[piece, 0]) + (axis.t[piece + 1, 1] - axis.t[piece, 1])
    t = axis.t[piece, 0] + compute_time_in_piece(axis, piece, greatest(distance, 0.0), max_time)
    if not t < 1e17:
        return NEVER
    n = int(math.ceil(t))
    low = axis.from_clock[piece]
    n = greatest(n, low)
    if not last:
        n = least(n, axis.from_clock[piece + 1])
    while n > low and count_begun_pulses_in_piece(axis, piece, n - 1) >= pulse:
        n -= 1
    while count_begun_pulses_in_piece(axis, piece, n) < pulse:
        n += 1
    return n


@hot
def _is_speed_at_least(axis, clocks, pps):
    """Return whether the speed that the chip reads, cut to whole pps, is at least `pps` at clock `clocks` after the origin."""
    return compute_speed(axis, clocks) * CLOCKS_PER_SECOND + 1e-6 >= pps


@hot
def find_speed_crossing(axis, clocks, pps):
    """Find the first clock at which the drive's speed rises to a value or falls below it.

    Within a piece the speed only rises or only falls.

    Args:
        axis: State of the axis.
        clocks: Clocks after the origin at which the search begins.
        pps: Speed to find, pulses per second.

    Returns:
        Clocks after the origin, NEVER if there is no such clock.
    """
    side = _is_speed_at_least(axis, clocks, pps)
    for s in range(find_piece(axis, clocks) + 1, axis.pieces):
        end = axis.from_clock[s]
        if _is_speed_at_least(axis, end - 1, pps) != side:
            low, high = clocks, end - 1
            while high - low > 1:
                middle = (low + high) // 2
                if _is_speed_at_least(axis, middle, pps) == side:
                    low = middle
                else:
                    high = middle
            return high
        if _is_speed_at_least(axis, end, pps) != side:
            return end
        clocks = end
    return NEVER
