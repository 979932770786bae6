"""One drive of a NOVA chip as an ideal profile with 60 digits, in the words of shared/spec/nova_mcx514.md.

    drive = Drive(SV=100, DV=20_000, AC=50_000, P=5000)
    drive.pulse_clocks()     clocks since the start at which pulses 1 .. 5000 begin
    drive.speed(80_000)      pps at that clock

The k-th pulse begins at clock ceil(t_k x 16e6), where p(t_k) = k. The course is a list of pieces with constant jerk;
where the profile ends in a ramp-down, its place is found by bisection. Nothing here comes from stage.chips.
Where the specification leaves a choice, the comment beside the line says which was taken.
"""

from fractions import Fraction
from itertools import takewhile
from typing import Any, NamedTuple

from mpmath import MPContext

mp = MPContext()
mp.dps = 60
SECOND = 16_000_000  # clocks, whatever the chip's clock is
SAME_CLOCK = mp.mpf("1e-30")  # clocks; a time as near to a whole clock as this is that clock
DUST = mp.mpf("1e-45")  # what rounding may leave of a speed or a position
BISECTIONS = 240
BITS, NEWTON_ENDS = 230, 1 << 70  # fixed point behind the binary point; 2^-160 s


class Piece(NamedTuple):
    """From time `t` (s) on, at position `p` and speed `v`, acceleration `a` changes by `jerk` for `length` seconds."""

    t: Any
    p: Any
    v: Any
    a: Any
    jerk: Any
    length: Any

    def position(self, tau):
        return self.p + tau * (self.v + tau * (self.a / 2 + tau * self.jerk / 6))

    def speed(self, tau):
        return self.v + tau * (self.a + tau * self.jerk / 2)

    def acceleration(self, tau):
        return self.a + tau * self.jerk

    @property
    def phase(self):
        slope = self.a or self.jerk
        return "accelerating" if slope > 0 else "decelerating" if slope < 0 else "constant"

    def times_of(self, positions):
        """Compute the times in the piece, s, at which it reaches some rising positions, in fixed point by Newton's method."""
        v, a, jerk = fixed(self.v), fixed(self.a / 2), fixed(self.jerk / 6)
        tau = 0.0
        for position in positions:
            distance = mp.mpf(position) - self.p
            tau = self._near_time_of(float(distance), tau)
            t, distance, step = fixed(mp.mpf(tau)), fixed(distance), NEWTON_ENDS
            while abs(step) >= NEWTON_ENDS:
                come = (((jerk * t >> BITS) + a) * t >> BITS) + v
                speed = ((3 * jerk * t >> BITS) + 2 * a) * t >> BITS
                step = (distance - (come * t >> BITS) << BITS) // (speed + v)
                t += step
            yield mp.ldexp(t, -BITS)

    def _near_time_of(self, distance, tau):
        """The same in floats, from an earlier position's `tau` on. Speeds are positive and `a` keeps its sign, so
        Newton's steps never pass the answer from the side they start on: upwards from behind it, downwards from before it.
        """
        v, a, jerk = float(self.v), float(self.a), float(self.jerk)
        for count in range(100):
            step = (distance - tau * (v + tau * (a / 2 + tau * jerk / 6))) / (v + tau * (a + tau * jerk / 2))
            tau = min(tau + step, float(self.length))
            if count and abs(step) < 1e-13 * tau:
                break
        return tau


def fixed(value):
    return int(mp.ldexp(value, BITS))


def number(value):
    """Convert ints and fractions exactly, not by way of a float."""
    return mp.mpf(value.numerator) / value.denominator if isinstance(value, Fraction) else mp.mpf(value)


class Drive:
    """A drive from its start on.

    SV, DV: pps. AC, DC: pps/s. JK, DJ: pps/s^2. Ints or fractions. P: output pulses, None for a continuous drive.
    DP: manual deceleration point, None for the automatic one. AO: acceleration counter offset, pulses.
    interventions: (clock since the start, what, value ...) in the order of their clocks, `what` one of
        "DV", pps; "P", output pulses counted from the start; "slow", a decelerating stop; "stop", an instant stop.
    """

    def __init__(
        self,
        SV,
        DV,
        AC,
        DC=None,
        JK=None,
        DJ=None,
        *,
        P=None,
        DP=None,
        AO=0,
        s_curve=False,
        asymmetric=False,
        triangle_prevention=True,
        interventions=(),
    ):
        self.SV, self.DV, self.P, self.DP, self.AO = number(SV), number(DV), P, DP, AO
        self.s_curve, self.prevention = s_curve, triangle_prevention
        down = (DC, DJ) if asymmetric else (AC, JK)
        self.limit = {+1: number(AC), -1: number(down[0])}
        self.jerk = {+1: number(JK), -1: number(down[1])} if s_curve else None
        self.pieces = []
        self.end = None  # seconds; None while it runs for ever
        self._times = {}  # what pulse_times has said, by `until`
        self._run(sorted(interventions, key=lambda what: what[0]))

    # The course

    def _run(self, interventions):
        # DV below SV: constant DV, no ramps [11]
        now = (mp.mpf(0), mp.mpf(0), min(self.SV, self.DV), mp.mpf(0))
        stopping = False
        for clock, what, *value in [*interventions, (None, None)]:
            course, end = self._stop_course(now) if stopping else (self._course(now), None)
            if self.P is not None:
                last = self._time_of_last(course)
                end = last if end is None else min(end, last)
            until = None if clock is None else mp.mpf(clock) / SECOND
            if until is None or (end is not None and end <= until + SAME_CLOCK / SECOND):
                self.pieces += course
                self.end = end
                return
            now = self._cut(course, until)
            if what == "DV":
                self.DV = number(value[0])
            elif what == "P":
                self.P = value[0]
            stopping |= what == "slow"
            passed = self.P is not None and mp.floor(now[1] + self._slack(now)) >= self.P
            # A target that was passed, or has just been reached, ends the drive at this clock [2]
            if what == "stop" or passed:
                self.end = until
                return

    def _slack(self, now):
        """What the position grows by in the time that still counts as the same clock."""
        return now[2] * SAME_CLOCK / SECOND

    def _cut(self, course, until):
        """Keep the course until then; the state there."""
        for piece in course:
            tau = until - piece.t
            if tau <= piece.length:
                self.pieces.append(piece._replace(length=tau))
                # A linear ramp's acceleration jumps, so none is taken along
                a = piece.acceleration(tau) if self.s_curve else mp.mpf(0)
                return until, piece.position(tau), piece.speed(tau), a
            self.pieces.append(piece)
        raise AssertionError("a course has no end")

    def _course(self, now):
        """To DV, at DV for ever; from the deceleration point on down to SV, at SV for ever."""
        course = self._pieces(now, self._change(now[2], now[3], self._goal(now)))
        if self.P is None:
            return course
        target = self.P - self.AO if self.DP is None else self.DP
        for i, piece in enumerate(course):
            if not self._reaches(piece, piece.length, target):
                continue
            tau = self._deceleration_point(piece, target)
            v, a = piece.speed(tau), piece.acceleration(tau) if self.s_curve else mp.mpf(0)
            braking = self._pieces((piece.t + tau, piece.position(tau), v, a), self._brake(v, a))
            return [*course[:i], piece._replace(length=tau), *braking]
        raise AssertionError("the last piece is endless and reaches every target")

    def _reaches(self, piece, tau, target):
        """From `tau` of this piece on the ramp-down ends at the target or behind it."""
        if tau == mp.inf:
            return True
        return piece.position(tau) + self._ahead(piece, tau) >= target - DUST

    def _ahead(self, piece, tau):
        if self.DP is not None:
            return 0  # the manual point is where the ramp-down begins
        v, a = piece.speed(tau), piece.acceleration(tau) if self.s_curve else mp.mpf(0)
        return self._pieces((0, mp.mpf(0), v, a), self._brake(v, a))[-1].p

    def _deceleration_point(self, piece, target):
        """The first time of the piece from which the ramp-down reaches the target. The later it begins the farther it
        gets, so bisection finds it."""
        if self._reaches(piece, mp.mpf(0), target):
            return mp.mpf(0)  # too late to reach SV: now
        if piece.length == mp.inf:
            return (target - piece.p - self._ahead(piece, mp.mpf(0))) / piece.v
        low, high = mp.mpf(0), piece.length
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            low, high = (low, middle) if self._reaches(piece, middle, target) else (middle, high)
        return high

    def _goal(self, now):
        if self.P is None or self.s_curve or not self.prevention or self.DV <= self.SV:
            return self.DV
        # Linear ramps accelerate until Pa + Pd = P / 2, whatever AO is. Choice: a cap of the speed that P alone sets,
        # whatever happened before, and with the manual point too; a speed above it is kept
        half = mp.mpf(self.P) / 2
        cap = mp.sqrt(self.SV**2 + 2 * half / (1 / self.limit[+1] + 1 / self.limit[-1]))
        return min(self.DV, max(cap, now[2]))

    def _stop_course(self, now):
        """A decelerating stop ends when the speed reaches SV."""
        _, _, v, a = now
        at_rest = v <= self.SV + DUST and a <= 0
        course = self._pieces(now, [] if at_rest else self._change(v, a, self.SV))
        return course, course[-1].t

    def _time_of_last(self, course):
        for piece in course:
            if piece.length == mp.inf or piece.position(piece.length) >= self.P - DUST:
                return piece.t + next(piece.times_of([self.P]))
        raise AssertionError("the last piece is endless")

    # Jerk-limited changes of speed, as lists of (acceleration at the start, jerk, length)

    def _brake(self, v, a):
        side = 1 if a > 0 else -1
        rest = self._rest(v, a, side)
        if rest <= self.SV + DUST:  # at or below SV nothing is left but to end the change
            return self._to_zero(a, side)
        return self._change(v, a, self.SV)

    def _rest(self, v, a, side):
        """Return the speed that remains when the acceleration has gone to 0."""
        return v + a * abs(a) / (2 * self.jerk[side]) if a else v

    def _to_zero(self, a, side):
        return [(a, -side * self.jerk[side], abs(a) / self.jerk[side])] if a else []

    def _change(self, v, a, goal):
        side = (1 if a > 0 else -1) if a else (1 if goal > v else -1)
        rest = self._rest(v, a, side)
        if side * (goal - rest) < -DUST:
            return [*self._to_zero(a, side), *self._change(rest, mp.mpf(0), goal)]
        gain, limit = abs(goal - v), self.limit[side]
        if gain <= DUST:
            return self._to_zero(a, side)
        if not self.s_curve:
            return [(side * limit, mp.mpf(0), gain / limit)]
        a, jerk = abs(a), self.jerk[side]
        peak = max(mp.sqrt(jerk * gain + a * a / 2), a)
        hold = mp.mpf(0)
        if peak > limit:
            peak = max(limit, a)
            hold = max((gain - (2 * peak * peak - a * a) / (2 * jerk)) / peak, mp.mpf(0))
        parts = ((a, jerk, (peak - a) / jerk), (peak, mp.mpf(0), hold), (peak, -jerk, peak / jerk))
        return [(side * start, side * rate, length) for start, rate, length in parts if length > 0]

    def _pieces(self, now, changes):
        """The changes one behind the other from (t, p, v, a) on, and constant speed for ever."""
        t, p, v, _ = now
        pieces = []
        for a, jerk, length in changes:
            piece = Piece(t, p, v, a, jerk, length)
            pieces.append(piece)
            t, p, v = t + length, piece.position(length), piece.speed(length)
        return [*pieces, Piece(t, p, v, mp.mpf(0), mp.mpf(0), mp.inf)]

    # What it shows

    def times_of(self, positions):
        """Compute the exact, fractional clocks at which rising positions are reached."""
        times, left = [], list(positions)
        for piece in self.pieces:
            reach = mp.inf if piece.length == mp.inf else piece.position(piece.length) + DUST
            current = list(takewhile(lambda position, reach=reach: position <= reach, left))
            times += [(piece.t + tau) * SECOND for tau in piece.times_of(current)]
            left = left[len(current) :]
        assert not left, "some positions are never reached"
        return times

    def pulse_times(self, until=None):
        """Compute the exact, fractional clocks at which the pulses are due.

        Args:
            until: Last clock, necessary for a drive without an end.
        """
        if until not in self._times:
            self._times[until] = self._pulse_times(until)
        return self._times[until]

    def _pulse_times(self, until):
        end = mp.inf if self.end is None else self.end * SECOND
        horizon = min(end, mp.inf if until is None else mp.mpf(until))
        assert horizon < mp.inf, "a continuous drive: say until which clock"
        at = self._at(horizon / SECOND)
        count = int(mp.floor(at[0].position(at[1]) + self._slack((0, 0, at[0].speed(at[1])))))
        return self.times_of(range(1, count + 1))

    def pulse_clocks(self, until=None):
        """Compute the clocks at which the pulses begin."""
        return [ceil_clock(t) for t in self.pulse_times(until)]

    @property
    def end_clock(self):
        """The clock at which the drive ends, None if it never does."""
        return None if self.end is None else ceil_clock(self.end * SECOND)

    def _at(self, t):
        """Return the piece at a time, and the time since its beginning."""
        for piece in self.pieces:
            if t <= piece.t + piece.length:
                return piece, max(t - piece.t, mp.mpf(0))
        return self.pieces[-1], self.pieces[-1].length

    def _of(self, clock):
        return self._at(mp.mpf(clock) / SECOND)

    def _over(self, clock):
        return self.end is not None and clock >= self.end_clock

    def speed(self, clock):
        """Return the speed at a clock, pps; 0 after the end."""
        piece, tau = self._of(clock)
        return mp.mpf(0) if self._over(clock) else piece.speed(tau)

    def acceleration(self, clock):
        """pps/s, negative downwards."""
        piece, tau = self._of(clock)
        return mp.mpf(0) if self._over(clock) else piece.acceleration(tau)

    def phase(self, clock):
        """Which way the speed goes: accelerating, constant or decelerating."""
        return self._of(clock)[0].phase

    def boundaries(self):
        """Clocks (not whole) at which a piece gives way to the next."""
        return [piece.t * SECOND for piece in self.pieces[1:]]


def ceil_clock(t):
    return int(mp.ceil(t - SAME_CLOCK))
