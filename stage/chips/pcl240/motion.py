"""The pulses of a run of the PCL-240 family, compiled. `run` jumps from event to event, never clock by clock.

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
from stage.chips.pcl240.bus import is_blocked
from stage.chips.pcl240.ramp import (
    NEVER,
    compute_ramp_down_margin,
    count_ticks_to_step,
    find_goal_speed,
    finish_step,
    is_ramp_down_automatic,
    read_linear_rate,
    update_speed,
)
from stage.native import array_at, exported, greatest, hot, least

FOREVER = 1 << 62


@hot
def _sample_inputs(c):
    """Sample the inputs at the first tick that sees a change, and return the pins that have become asserted.

    With external counting R0 counts on the rising edge of EXTP.
    """
    rising = c.active_inputs & ~c.last_inputs
    if c.last_inputs & state.EXTP and not c.active_inputs & state.EXTP and c.output_mode & state.EXTERNAL:
        c.reg[0] = (c.reg[0] - 1) & state.COUNTER_MASK
        if c.running and c.preset and c.reg[0] == 0:
            state.stop_run(c)
    c.last_inputs = c.active_inputs
    return rising


@hot
def _apply_switches(c, rising):
    """Apply the limit switches and ORG, and count EZ in an origin return with EZ: step 1 of a tick.

    Args:
        c: State of the chip.
        rising: Inputs that have become asserted.
    """
    if c.active_inputs & (state.EL_MINUS if c.minus else state.EL_PLUS):
        state.stop_run(c)
        return
    if c.origin_return and c.active_inputs & state.ORG:
        if not (c.extended and c.reg[state.R13] & state.EZ_RETURN):
            state.stop_run(c)
            return
        c.passed_org = 1
    if (
        c.passed_org
        and not c.counts_ez
        and (not c.reg[state.R13] & state.EZ_FROM_FL or not c.uses_ramps or c.speed <= c.reg[1])
    ):
        c.counts_ez = 1
    if c.counts_ez and rising & state.EZ:
        if not c.ez_started:
            c.ez_started, c.ez_left = 1, c.reg[state.R13] >> state.EZ_COUNT & state.MAX_EZ_COUNT
        if c.ez_left == 0:
            state.stop_run(c)
        else:
            c.ez_left -= 1


@hot
def _finish_pulse(c, n):
    """Run up to `n` ticks of a chip without a run: complete the last pulse, or idle. Returns the number of ticks."""
    s = n
    if c.finishing and c.speed > 0 and c.multiplier >= 2:
        half = 4096 * c.multiplier
        s = greatest(1, -((c.phase - half) // c.speed))
        if s > n:
            s = n
        c.phase += s * c.speed
        if c.phase >= half:
            c.pout_low = 0
            state.end_run(c)
    c.clock += s
    return s


@hot
def run_to_event(c, n):
    """Run at least one and at most `n` ticks, up to the next event, and return the number of ticks."""
    ran, c.quiet_until = c.running, 0
    rising = _sample_inputs(c) if c.active_inputs != c.last_inputs else 0
    if c.running and (c.passed_org or is_blocked(c)):
        _apply_switches(c, rising)
    if not c.running:  # a stop has its own tick, so that `scan` sees the edge of HOLD there and not after the idle ones
        return _finish_pulse(c, 1 if ran else n)
    goal = find_goal_speed(c)
    s = count_ticks_to_step(c, goal)
    counts_output = not c.output_mode & state.EXTERNAL
    if s == NEVER and not c.passed_org and (not c.uses_ramps or c.speed == goal):
        c.quiet_until = _find_next_event(c, counts_output)
    s = least(n, s)
    pulses = 0
    if c.multiplier >= 2 and c.speed > 0:
        m = 8192 * c.multiplier
        ahead = c.phase + s * c.speed
        pulses = ahead // m
        if pulses:
            left = _count_pulses_to_event(c, counts_output)
            if pulses >= left:
                pulses = left
                s = -((c.phase - left * m) // c.speed)
                ahead = c.phase + s * c.speed
        c.phase = ahead - pulses * m
        if pulses or c.pout_low:
            c.pout_low = 1 if 2 * c.phase < m else 0
    if s > 1 and c.uses_ramps:  # step 3 of the ticks before the last
        if c.speed == goal:
            c.ramp_direction = 0
        else:
            c.ramp_clocks += s - 1
    c.clock += s
    if c.quiet_until < c.clock:
        c.quiet_until = 0  # over: what is left of it must not tell how time was cut
    if pulses:
        _count_pulses(c, pulses, counts_output)
        if c.preset and c.reg[0] == 0:
            state.stop_run(c)
            return s
    update_speed(c)
    return s


@hot
def _count_pulses_to_event(c, counts_output):
    """Return the number of pulses until a counter matters: R0 at 0, below R6, or wrapped; the automatic ramp-down point.

    Args:
        c: State of the chip.
        counts_output: Whether R0 counts output pulses.
    """
    r0 = c.reg[0]
    left = NEVER
    if counts_output or (c.preset and r0 == 0):
        left = r0 if r0 else 1
        if 0 < c.reg[6] <= r0:
            left = r0 - c.reg[6] + 1
    if not c.ramp_down_due and is_ramp_down_automatic(c):
        closer = (1 if counts_output else 0) + c.speed_rising
        if closer:
            left = least(left, greatest(1, -(-compute_ramp_down_margin(c) // closer)))
    return left


@hot
def _find_next_event(c, counts_output):
    """Find the clock before that of the next pulse that is an event, at constant speed.

    Args:
        c: State of the chip.
        counts_output: Whether R0 counts output pulses.
    """
    left = _count_pulses_to_event(c, counts_output)
    if left == NEVER or c.speed == 0 or c.multiplier < 2:
        return FOREVER
    return c.clock + (left * 8192 * c.multiplier - c.phase - 1) // c.speed


@hot
def _run_at_constant_speed(c, until):
    """Run up to `until` at constant speed without an event. Has the effect of `run_to_event`, at less cost."""
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
    if pulses or c.pout_low:
        c.pout_low = 1 if 2 * ahead < m else 0
    if pulses:
        _count_pulses(c, pulses, not c.output_mode & state.EXTERNAL)


@hot
def compute_mean_count(before, net, phase, multiplier, speed, ticks):
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
def run_window_at_constant_speed(c, row, k):
    """Run a window as `cores.run_window` does, if the chip runs at constant speed without an event all the time.

    It is faster because values that a slice takes over from the one before stay in processor registers.

    Args:
        c: State of the chip.
        row: Address of its CHIP record.
        k: Number of the first slice.

    Returns:
        Whether it has run the window.
    """
    r = array_at(row, 1, CHIP)[0]
    ends, axis = array_at(r.ends, r.slices, SLICE_END), array_at(r.table, 1, CHIP_AXIS)[0]
    begin, rest, speed, multiplier = r.begin, r.rest, c.speed, c.multiplier
    last = end_of_slice(ends[r.slices - 1], begin, rest)
    if c.quiet_until < last or c.active_inputs != c.last_inputs or multiplier < 2 or speed == 0:
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
        means[k] = compute_mean_count(count, net, phase, multiplier, speed, r.ticks)
        count = net
        k += 1
    before[0] = count
    _run_at_constant_speed(c, clock)
    return True


@hot
def _run_ramp_steps(c, until):
    """Run the steps of a ramp up to `until`, except its last, as long as no other event comes."""
    goal, direction = find_goal_speed(c), c.ramp_direction
    rate, last = read_linear_rate(c, direction), goal - direction
    if (
        c.speed_rising != (1 if direction > 0 else 0)
        or (last - c.speed) * direction <= 0
        or rate < 2
        or c.multiplier < 2
    ):
        return
    if (
        is_blocked(c)
        or c.passed_org
        or (c.stopping and c.speed <= c.reg[1])
        or (not c.ramp_down_due and is_ramp_down_automatic(c))
    ):
        return
    if c.curved_ramp and c.ramp_goal != goal:
        return
    counts_output = not c.output_mode & state.EXTERNAL
    m, left, begun = 8192 * c.multiplier, _count_pulses_to_event(c, counts_output), 0
    clock, phase, speed = c.clock, c.phase, c.speed
    wait = (c.next_step_time if c.curved_ramp else rate) - c.ramp_clocks
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
        if c.curved_ramp:
            c.ramp_clocks = c.next_step_time
            finish_step(c)
            wait = c.next_step_time - c.ramp_clocks
        else:
            c.ramp_clocks = 0
            wait = rate
    if clock == c.clock:
        return
    moved = phase != c.phase  # a step from speed 0 comes before any
    c.clock, c.phase, c.speed = clock, phase, speed
    if begun or (c.pout_low and moved):
        c.pout_low = 1 if 2 * phase < m else 0
    if begun:
        _count_pulses(c, begun, counts_output)


@hot
def _count_pulses(c, pulses, counts_output):
    """Count pulses that have begun.

    Args:
        c: State of the chip.
        pulses: Number of pulses.
        counts_output: Whether R0 counts output pulses.
    """
    signed_pulses = -pulses if c.minus else pulses
    c.total += pulses
    c.net += signed_pulses
    if c.speed_rising:
        c.rise_pulses += pulses
    if counts_output:
        c.reg[0] = (c.reg[0] - pulses) & state.COUNTER_MASK
    if c.counts_position:
        c.reg[state.R10] = (c.reg[state.R10] + signed_pulses) & state.COUNTER_MASK


@exported(None, state.STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        if c.active_inputs != c.last_inputs:
            run_to_event(c, until - c.clock)
        elif c.quiet_until >= until:
            _run_at_constant_speed(c, until)
        elif not (c.running or c.finishing):
            c.clock = until
        else:
            if c.ramp_direction and c.uses_ramps and c.running:
                _run_ramp_steps(c, until)
            if c.clock < until:
                run_to_event(c, until - c.clock)
