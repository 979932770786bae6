"""NOVA chips, compiled: position and speed of a drive's profile at a clock, and when its k-th pulse begins.

The k-th pulse begins at the first whole clock at which the ideal position p has reached k. Floats find out as long as p is not
next to a whole number; there, double-doubles decide. A profile that comes to k within SNAP below it has reached it.
"""

from __future__ import annotations

import math

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.state import NEVER
from stage.native import greatest, hot, least

HZ = 16_000_000  # clocks in what the formulas call a second
SNAP = 2.0**-50
GUARD = 1e-6


@hot
def piece_at(x, n):
    """The piece in force `n` clocks after the origin."""
    s = 0
    while s + 1 < x.pieces and x.from_clock[s + 1] <= n:
        s += 1
    return s


@hot
def exactly(x, s, n):
    """Compute the place at a clock.

    Args:
        x: State of the axis.
        s: Number of the piece.
        n: Clock after the origin.

    Returns:
        Pulses since the begin of the piece, and the fraction it began with, as a double-double.
    """
    t = dd.sub(dd.from_integer(n), (x.t[s, 0], x.t[s, 1]))
    r = dd.add((x.a2[s, 0], x.a2[s, 1]), dd.mul(t, (x.j6[s, 0], x.j6[s, 1])))
    r = dd.add((x.v[s, 0], x.v[s, 1]), dd.mul(t, r))
    return dd.add((x.p[s, 0], x.p[s, 1]), dd.mul(t, r))


@hot
def reached_in(x, s, n):
    """Count the pulses of the drive that have begun.

    Args:
        x: State of the axis.
        s: Number of the piece.
        n: Clock after the origin, in this piece.

    Returns:
        Number of pulses.
    """
    t = (float(n) - x.t[s, 0]) - x.t[s, 1]
    r = x.p[s, 0] + t * (x.v[s, 0] + t * (x.a2[s, 0] + t * x.j6[s, 0]))
    k = math.floor(r)
    over = r - k
    guard = GUARD + 1e-14 * abs(r)
    if guard < over < 1.0 - guard:
        return x.from_pulse[s] + int(k)
    return x.from_pulse[s] + dd.floor(dd.add(exactly(x, s, n), (SNAP, 0.0)))


@hot
def reached(x, n):
    """Pulses of the drive that have begun `n` clocks after the origin."""
    return reached_in(x, piece_at(x, n), n)


@hot
def speed_at(x, n):
    """Pulses per clock."""
    s = piece_at(x, n)
    t = (float(n) - x.t[s, 0]) - x.t[s, 1]
    return greatest(x.v[s, 0] + t * (2.0 * x.a2[s, 0] + 3.0 * t * x.j6[s, 0]), 0.0)


@hot
def acceleration_at(x, n):
    """Pulses per clock^2, with its sign."""
    s = piece_at(x, n)
    t = (float(n) - x.t[s, 0]) - x.t[s, 1]
    return 2.0 * x.a2[s, 0] + 6.0 * t * x.j6[s, 0]


@hot
def phase_at(x, n):
    """ACCELERATING, CONSTANT, DECELERATING, ..."""
    return x.kind[piece_at(x, n)]


@hot
def time_in(x, s, distance, max_time):
    """Compute the time in a piece until further pulses are done.

    Args:
        x: State of the axis.
        s: Number of the piece.
        distance: Pulses from its begin.
        max_time: Clocks, the largest result.

    Returns:
        Clocks, a float.
    """
    v, a2, j6 = x.v[s, 0], x.a2[s, 0], x.j6[s, 0]
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
def _surely(x, s, distance):
    """The clock after the origin at which `far` pulses of piece `s` are done, if floats can tell it; else -1.

    Their error is below 1e-15 of the time, 1e-14 in a ramp; S-curves, and linear ramps close to standstill, are not looked at.
    """
    v, a2 = x.v[s, 0], x.a2[s, 0]
    if x.j6[s, 0] != 0.0 or v <= 0.0:
        return -1
    t = distance / v
    if a2 != 0.0:
        root = v * v + 4.0 * a2 * distance
        if root < 1e-4 * v * v:
            return -1
        t = 2.0 * distance / (v + math.sqrt(root))
    t += x.t[s, 0]
    if not 0.0 <= t < (1e9 if a2 == 0.0 else 1e8):
        return -1
    n = int(math.ceil(t))
    delay = n - t
    if delay < 1e-5 or delay > 1.0 - 1e-5 or n < x.from_clock[s]:
        return -1
    if s + 1 < x.pieces and n > x.from_clock[s + 1]:
        return -1
    return n


@hot
def piece_of(x, s, k):
    """Find the piece in which a pulse of the drive begins.

    Args:
        x: State of the axis.
        s: Number of the first piece to search.
        k: Number of the pulse.

    Returns:
        Number of the piece.
    """
    while s + 1 < x.pieces and reached_in(x, s, x.from_clock[s + 1]) < k:
        s += 1
    return s


@hot
def clock_of(x, k):
    """Clocks after the origin at which the k-th pulse of the drive begins, NEVER if that is centuries ahead."""
    return clock_in(x, piece_of(x, 0, k), k)


@hot
def clock_in(x, s, k):
    """Compute the clock at which a pulse begins, where its piece is known.

    Args:
        x: State of the axis.
        s: Number of the piece.
        k: Number of the pulse.

    Returns:
        The clock after the origin.
    """
    distance = float(k - x.from_pulse[s]) - x.p[s, 0]
    n = _surely(x, s, distance)
    if n >= 0:
        return n
    last = s + 1 == x.pieces
    max_time = 1e17 if last else (x.t[s + 1, 0] - x.t[s, 0]) + (x.t[s + 1, 1] - x.t[s, 1])
    t = x.t[s, 0] + time_in(x, s, greatest(distance, 0.0), max_time)
    if not t < 1e17:
        return NEVER
    n = int(math.ceil(t))
    low = x.from_clock[s]
    n = greatest(n, low)
    if not last:
        n = least(n, x.from_clock[s + 1])
    while n > low and reached_in(x, s, n - 1) >= k:
        n -= 1
    while reached_in(x, s, n) < k:
        n += 1
    return n


@hot
def _fast(x, n, pps):
    """The current speed as the chip shows it, cut to whole pps, is at least `pps`."""
    return speed_at(x, n) * HZ + 1e-6 >= pps


@hot
def speed_passes(x, n, pps):
    """The first clock after `n` at which the speed is no longer below `pps`, or no longer at or above it. NEVER if none.

    Both count from the origin. Within a piece the speed only rises or only falls.
    """
    side = _fast(x, n, pps)
    for s in range(piece_at(x, n) + 1, x.pieces):
        end = x.from_clock[s]
        if _fast(x, end - 1, pps) != side:
            low, high = n, end - 1
            while high - low > 1:
                middle = (low + high) // 2
                if _fast(x, middle, pps) == side:
                    low = middle
                else:
                    high = middle
            return high
        if _fast(x, end, pps) != side:
            return end
        n = end
    return NEVER
