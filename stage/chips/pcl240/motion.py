"""PCL-240 family, compiled: the pulses of a run. `run` jumps from event to event, never clock by clock.

Between two events the speed is constant, so phase, pulses and R0 follow in closed form from exact integers:

    phase(n) = phase + n speed        pulses = phase(n) // M        M = 8192 R7        POUT low while phase < M / 2

    phase   0 ... M/2 ... M=0          M/2            M=0
    POUT    |_________|-----------------|_________|-------      low is asserted; the pulse is counted where it begins
    ramp    R1 R1+1 R1+2 ... R2 R2 R2 ... R2-1 ... R1 R1        speed: a step every R4 (up) or R5 (down) clocks
            FUP              FKEEP        FDOWN    FKEEP

An event is a speed step of a ramp, R0 reaching 0, falling below R6 or to the automatic ramp-down point, the end of a pulse
that outlives its run, a changed input, or a bus write. The order inside a tick, and the names of the steps, are those of
the normative model: 1 limit switches, 2 pulse, 3 speed.
"""

from __future__ import annotations

from stage.chips.cores import CHIP, CHIP_AXIS, REAL, SLICE_END, WORD, end_of_slice
from stage.chips.pcl240 import state
from stage.chips.pcl240.bus import blocked
from stage.chips.pcl240.ramp import NEVER, goal_speed, linear_rate, margin, step_speed, took_step, until_step, watching
from stage.native import array_at, exported, greatest, hot, least

FOREVER = 1 << 62


@hot
def _sample(c):
    """What a changed input does at the tick that first sees it: EXTP counts on its rising edge. Returns the pins that
    have become asserted."""
    rising = c.seen & ~c.sampled
    if c.sampled & state.EXTP and not c.seen & state.EXTP and c.output & state.EXTERNAL:
        c.reg[0] = (c.reg[0] - 1) & state.COUNTER_MASK
        if c.running and c.preset and c.reg[0] == 0:
            state.stop(c)
    c.sampled = c.seen
    return rising


@hot
def _obey_switches(c, rising):
    """Step 1 where it has something to do: a limit, or ORG, and with an EZ return what comes after ORG."""
    if c.seen & (state.EL_MINUS if c.minus else state.EL_PLUS):
        state.stop(c)
        return
    if c.origin and c.seen & state.ORG:
        if not (c.extended and c.reg[state.R13] & state.EZ_RETURN):
            state.stop(c)
            return
        c.homing = 1
    if c.homing and not c.counting and (not c.reg[state.R13] & state.EZ_FROM_FL or not c.ramps or c.speed <= c.reg[1]):
        c.counting = 1
    if c.counting and rising & state.EZ:
        if not c.ez_running:
            c.ez_running, c.ez_left = 1, c.reg[state.R13] >> state.EZ_COUNT & state.MAX_EZ_COUNT
        if c.ez_left == 0:
            state.stop(c)
        else:
            c.ez_left -= 1


@hot
def _finish(c, n):
    """Ticks of a chip that is not running: complete the last pulse, or idle."""
    s = n
    if c.finishing and c.speed > 0 and c.multiplier >= 2:
        half = 4096 * c.multiplier
        s = greatest(1, -((c.phase - half) // c.speed))
        if s > n:
            s = n
        c.phase += s * c.speed
        if c.phase >= half:
            c.low = 0
            state.end(c)
    c.clock += s
    return s


@hot
def span(c, n):
    """Run at least one and at most `n` ticks, up to the next event; returns the ticks run."""
    ran, c.quiet = c.running, 0
    rising = _sample(c) if c.seen != c.sampled else 0
    if c.running and (c.homing or blocked(c)):
        _obey_switches(c, rising)
    if not c.running:  # a stop has its own tick, so that `scan` sees the edge of HOLD there and not after the idle ones
        return _finish(c, 1 if ran else n)
    goal = goal_speed(c)
    s = until_step(c, goal)
    counts_output = not c.output & state.EXTERNAL
    if s == NEVER and not c.homing and (not c.ramps or c.speed == goal):
        c.quiet = _next_event(c, counts_output)
    s = least(n, s)
    pulses = 0
    if c.multiplier >= 2 and c.speed > 0:
        m = 8192 * c.multiplier
        ahead = c.phase + s * c.speed
        pulses = ahead // m
        if pulses:
            left = _pulses_to_event(c, counts_output)
            if pulses >= left:
                pulses = left
                s = -((c.phase - left * m) // c.speed)
                ahead = c.phase + s * c.speed
        c.phase = ahead - pulses * m
        if pulses or c.low:
            c.low = 1 if 2 * c.phase < m else 0
    if s > 1 and c.ramps:  # step 3 of the ticks before the last
        if c.speed == goal:
            c.ramp = 0
        else:
            c.timer += s - 1
    c.clock += s
    if c.quiet < c.clock:
        c.quiet = 0  # over: what is left of it must not tell how time was cut
    if pulses:
        _count(c, pulses, counts_output)
        if c.preset and c.reg[0] == 0:
            state.stop(c)
            return s
    step_speed(c)
    return s


@hot
def _pulses_to_event(c, counts_output):
    """Pulses until R0 or the counter of the ramp means something else: 0, below R6, wrapped, the automatic point."""
    r0 = c.reg[0]
    left = NEVER
    if counts_output or (c.preset and r0 == 0):
        left = r0 if r0 else 1
        if 0 < c.reg[6] <= r0:
            left = r0 - c.reg[6] + 1
    if not c.down and watching(c):
        closer = (1 if counts_output else 0) + c.rising
        if closer:
            left = least(left, greatest(1, -(-margin(c) // closer)))
    return left


@hot
def _next_event(c, counts_output):
    """At constant speed: the clock before that of the next pulse that is an event."""
    left = _pulses_to_event(c, counts_output)
    if left == NEVER or c.speed == 0 or c.multiplier < 2:
        return FOREVER
    return c.clock + (left * 8192 * c.multiplier - c.phase - 1) // c.speed


@hot
def _cruise(c, until):
    """Run up to `until`, while all is quiet: what `_span` would do, without its questions."""
    ahead = c.phase + (until - c.clock) * c.speed
    c.clock = until
    if c.multiplier < 2 or c.speed == 0:  # a pulse in progress never ends
        return
    m = 8192 * c.multiplier
    pulses = 0
    if ahead >= m:
        pulses = 1 if ahead < 2 * m else ahead // m
        ahead -= pulses * m
    c.phase = ahead
    if pulses or c.low:
        c.low = 1 if 2 * ahead < m else 0
    if pulses:
        _count(c, pulses, not c.output & state.EXTERNAL)


@hot
def mean_count(before, net, phase, multiplier, speed, ticks):
    """Compute the mean of a count over the last ticks.

    Args:
        before: Count at the start of these ticks.
        net: Count now.
        phase: Phase of the pulse generator now.
        multiplier: R7.
        speed: Speed steps.
        ticks: Reference clocks.

    Returns:
        The mean, a float.
    """
    n = abs(net - before)
    if n == 0:
        return float(net)
    ago = n * phase + 4096.0 * multiplier * n * (n - 1)  # x speed
    missing = n - least(
        ago / (speed * ticks), float(n)
    )  # pulses x the part of the time in which they were still to come
    return net - missing if net > before else net + missing


@hot
def cruise_through(c, row, k):
    """Do what `cores.through` does if the chip is at constant speed and without an event all the time; return whether it is.

    What a slice takes over from the one before stays in registers.
    """
    r = array_at(row, 1, CHIP)[0]
    ends, axis = array_at(r.ends, r.slices, SLICE_END), array_at(r.table, 1, CHIP_AXIS)[0]
    begin, rest, speed, multiplier = r.begin, r.rest, c.speed, c.multiplier
    last = end_of_slice(ends[r.slices - 1], begin, rest)
    if c.quiet < last or c.seen != c.sampled or multiplier < 2 or speed == 0:
        return False
    means, before = array_at(axis.means, r.slices, REAL), array_at(axis.net, 1, WORD)
    m, direction = 8192 * multiplier, -1 if c.minus else 1
    clock, phase, net, count = c.clock, c.phase, c.net, before[0]
    while k < r.slices:
        until = end_of_slice(ends[k], begin, rest)
        ahead = phase + (until - clock) * speed
        pulses = 0
        if ahead >= m:
            pulses = 1 if ahead < 2 * m else ahead // m
        clock, phase = until, ahead - pulses * m
        net += direction * pulses
        means[k] = mean_count(count, net, phase, multiplier, speed, r.ticks)
        count = net
        k += 1
    before[0] = count
    _cruise(c, clock)
    return True


@hot
def _climb(c, until):
    """Take the steps of a ramp, but not its last, that come up to `until` and before anything else happens."""
    goal, direction = goal_speed(c), c.ramp
    rate, last = linear_rate(c, direction), goal - direction
    if c.rising != (1 if direction > 0 else 0) or (last - c.speed) * direction <= 0 or rate < 2 or c.multiplier < 2:
        return
    if blocked(c) or c.homing or (c.decel and c.speed <= c.reg[1]) or (not c.down and watching(c)):
        return
    if c.curved and c.goal != goal:
        return
    counts_output = not c.output & state.EXTERNAL
    m, left, begun = 8192 * c.multiplier, _pulses_to_event(c, counts_output), 0
    clock, phase, speed = c.clock, c.phase, c.speed
    wait = (c.next if c.curved else rate) - c.timer
    while speed != last and 0 < wait <= until - clock:
        ahead = phase + wait * speed
        pulses = 0
        if ahead >= m:
            pulses = 1 if ahead < 2 * m else ahead // m
            if begun + pulses >= left:
                break
            begun += pulses
        phase = ahead - pulses * m
        clock += wait
        speed += direction
        if c.curved:
            c.timer = c.next
            took_step(c)
            wait = c.next - c.timer
        else:
            c.timer = 0
            wait = rate
    if clock == c.clock:
        return
    moved = phase != c.phase  # a step from speed 0 comes before any
    c.clock, c.phase, c.speed = clock, phase, speed
    if begun or (c.low and moved):
        c.low = 1 if 2 * phase < m else 0
    if begun:
        _count(c, begun, counts_output)


@hot
def _count(c, pulses, counts_output):
    """`pulses` have begun."""
    signed_pulses = -pulses if c.minus else pulses
    c.total += pulses
    c.net += signed_pulses
    if c.rising:
        c.risen += pulses
    if counts_output:
        c.reg[0] = (c.reg[0] - pulses) & state.COUNTER_MASK
    if c.position:
        c.reg[state.R10] = (c.reg[state.R10] + signed_pulses) & state.COUNTER_MASK


@exported(None, state.STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        if c.seen != c.sampled:
            span(c, until - c.clock)
        elif c.quiet >= until:
            _cruise(c, until)
        elif not (c.running or c.finishing):
            c.clock = until
        else:
            if c.ramp and c.ramps and c.running:
                _climb(c, until)
            if c.clock < until:
                span(c, until - c.clock)
