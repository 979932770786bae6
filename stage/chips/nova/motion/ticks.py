"""NOVA chips, compiled: when the profile of a drive comes to a place, which here need not be a whole number of pulses."""

from __future__ import annotations

import math

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.planner import pair
from stage.chips.nova.motion.profile import SNAP, exactly, time_in
from stage.chips.nova.state import NEVER
from stage.native import greatest, hot

FAR = 1e17  # clocks: centuries


@hot
def _reached(x, s, n, place):
    """The profile, in its piece `s`, has come to `place` n clocks after its origin."""
    if x.a2[s, 0] == 0.0 and x.j6[s, 0] == 0.0:  # the same, sooner
        reached = dd.add(pair(x.p[s]), dd.mul(dd.sub(dd.from_integer(n), pair(x.t[s])), pair(x.v[s])))
    else:
        reached = exactly(x, s, n)
    return not dd.less(dd.add(dd.add(dd.from_integer(x.from_pulse[s]), reached), (SNAP, 0.0)), place)


@hot
def clock_at(x, s, place):
    """The first clock after the origin at which the profile has come to `place`, and in which piece that is, `s` or a later
    one; NEVER if that is centuries ahead. Double-doubles decide where the time is next to a whole clock."""
    while True:
        low = x.from_clock[s]
        last = s + 1 == x.pieces
        edge = NEVER if last else x.from_clock[s + 1]
        max_time = FAR if last else (x.t[s + 1, 0] - x.t[s, 0]) + (x.t[s + 1, 1] - x.t[s, 1])
        distance = greatest(dd.sub(dd.sub(place, dd.from_integer(x.from_pulse[s])), pair(x.p[s]))[0], 0.0)
        t = time_in(x, s, distance, max_time)
        at = x.t[s, 0] + t
        if not at < FAR:
            return NEVER, s
        n = greatest(int(math.ceil(at)), low)
        slope = x.v[s, 0] + t * (2.0 * x.a2[s, 0] + 3.0 * t * x.j6[s, 0])
        guard = 1e-6 + 1e-14 * at + 1e-14 * (distance + 1.0) / greatest(slope, 1e-12)
        if n - at > 1.0 - guard:
            while n > low and _reached(x, s, n - 1, place):
                n -= 1
        if n - at < guard:
            while n < edge and not _reached(x, s, n, place):
                n += 1
        if n < edge:
            return n, s
        s += 1
