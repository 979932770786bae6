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

from stage.chips.core_interface import CHIP, CHIP_AXIS, REAL, SLICE_END, WORD, compute_slice_end
from stage.chips.pcl240 import state
from stage.chips.pcl240.bus import is_blocked
from stage.chips.pcl240.ramp import (
    NEVER,
    compute_ramp_down_margin,
    count_clocks_to_speed_step,
    find_goal_speed,
    finish_step,
    is_ramp_down_automatic,
    read_linear_rate,
    update_speed,
)
from stage.native import array_at, exported, greatest, hot, least

NEVER_CLOCK = 1 << 62


@hot
def _sample_inputs(chip):
    """Sample the inputs of the PCL-240 in the first tick after a change; return the pins that have become asserted.

    With external counting R0 counts on the rising edge of EXTP.
    """
    rising = chip.active_inputs & ~chip.last_inputs
    if chip.last_inputs & state.EXTP and not chip.active_inputs & state.EXTP and chip.output_mode & state.EXTERNAL:
        chip.reg[0] = (chip.reg[0] - 1) & state.COUNTER_MASK
        if chip.running and chip.preset and chip.reg[0] == 0:
            state.stop_run(chip)
    chip.last_inputs = chip.active_inputs
    return rising


@hot
def _apply_switches(chip, rising):
    """Apply the limit switches and ORG, and count EZ in an origin return with EZ. This is the first part of each clock.

    Args:
        chip: State of the chip.
        rising: Inputs that have become asserted.
    """
    if chip.active_inputs & (state.EL_MINUS if chip.minus else state.EL_PLUS):
        state.stop_run(chip)
        return
    if chip.origin_return and chip.active_inputs & state.ORG:
        if not (chip.extended and chip.reg[state.R13] & state.EZ_RETURN):
            state.stop_run(chip)
            return
        chip.passed_org = 1
    if (
        chip.passed_org
        and not chip.counts_ez
        and (not chip.reg[state.R13] & state.EZ_FROM_FL or not chip.uses_ramps or chip.speed <= chip.reg[1])
    ):
        chip.counts_ez = 1
    if chip.counts_ez and rising & state.EZ:
        if not chip.ez_started:
            chip.ez_started, chip.ez_left = 1, chip.reg[state.R13] >> state.EZ_COUNT & state.MAX_EZ_COUNT
        if chip.ez_left == 0:
            state.stop_run(chip)
        else:
            chip.ez_left -= 1


@hot
def _finish_pulse(chip, ticks):
    """Advance a chip without a run by at most `ticks` clocks: complete the last pulse, or idle. Returns the number of clocks."""
    s = ticks
    if chip.finishing and chip.speed > 0 and chip.multiplier >= 2:
        half = 4096 * chip.multiplier
        s = greatest(1, -((chip.phase - half) // chip.speed))
        if s > ticks:
            s = ticks
        chip.phase += s * chip.speed
        if chip.phase >= half:
            chip.pout_low = 0
            state.end_run(chip)
    chip.clock += s
    return s


@hot
def run_to_event(chip, ticks):
    """Advance the PCL-240 by 1 to `ticks` clocks, up to the next event, and return the number of clocks."""
    ran, chip.quiet_until = chip.running, 0
    rising = _sample_inputs(chip) if chip.active_inputs != chip.last_inputs else 0
    if chip.running and (chip.passed_org or is_blocked(chip)):
        _apply_switches(chip, rising)
    if (
        not chip.running
    ):  # a stop has its own tick, so that `scan` sees the edge of HOLD there and not after the idle ones
        return _finish_pulse(chip, 1 if ran else ticks)
    goal = find_goal_speed(chip)
    s = count_clocks_to_speed_step(chip, goal)
    counts_output = not chip.output_mode & state.EXTERNAL
    if s == NEVER and not chip.passed_org and (not chip.uses_ramps or chip.speed == goal):
        chip.quiet_until = _find_next_event(chip, counts_output)
    s = least(ticks, s)
    pulses = 0
    if chip.multiplier >= 2 and chip.speed > 0:
        m = 8192 * chip.multiplier
        ahead = chip.phase + s * chip.speed
        pulses = ahead // m
        if pulses:
            left = _count_pulses_to_event(chip, counts_output)
            if pulses >= left:
                pulses = left
                s = -((chip.phase - left * m) // chip.speed)
                ahead = chip.phase + s * chip.speed
        chip.phase = ahead - pulses * m
        if pulses or chip.pout_low:
            chip.pout_low = 1 if 2 * chip.phase < m else 0
    if s > 1 and chip.uses_ramps:  # step 3 of the ticks before the last
        if chip.speed == goal:
            chip.ramp_direction = 0
        else:
            chip.ramp_clocks += s - 1
    chip.clock += s
    if chip.quiet_until < chip.clock:
        chip.quiet_until = 0  # over: what is left of it must not tell how time was cut
    if pulses:
        _add_pulses(chip, pulses, counts_output)
        if chip.preset and chip.reg[0] == 0:
            state.stop_run(chip)
            return s
    update_speed(chip)
    return s


@hot
def _count_pulses_to_event(chip, counts_output):
    """Return the number of pulses until R0 reaches 0, falls below R6, wraps, or reaches the automatic ramp-down point.

    Args:
        chip: State of the chip.
        counts_output: Whether R0 counts output pulses.
    """
    r0 = chip.reg[0]
    left = NEVER
    if counts_output or (chip.preset and r0 == 0):
        left = r0 if r0 else 1
        if 0 < chip.reg[6] <= r0:
            left = r0 - chip.reg[6] + 1
    if not chip.ramp_down_due and is_ramp_down_automatic(chip):
        closer = (1 if counts_output else 0) + chip.speed_rising
        if closer:
            left = least(left, greatest(1, -(-compute_ramp_down_margin(chip) // closer)))
    return left


@hot
def _find_next_event(chip, counts_output):
    """Find the last clock before the next pulse that is an event, at constant speed.

    Args:
        chip: State of the chip.
        counts_output: Whether R0 counts output pulses.
    """
    left = _count_pulses_to_event(chip, counts_output)
    if left == NEVER or chip.speed == 0 or chip.multiplier < 2:
        return NEVER_CLOCK
    return chip.clock + (left * 8192 * chip.multiplier - chip.phase - 1) // chip.speed


@hot
def _run_at_constant_speed(chip, until):
    """Advance to the clock `until` at constant speed without an event. It has the effect of `run_to_event`, but is faster."""
    ahead = chip.phase + (until - chip.clock) * chip.speed
    chip.clock = until
    if chip.multiplier < 2 or chip.speed == 0:  # a pulse in progress never ends
        return
    m = 8192 * chip.multiplier
    pulses = 0
    if ahead >= m:
        pulses = 1 if ahead < 2 * m else ahead // m
        ahead -= pulses * m
    chip.phase = ahead
    if pulses or chip.pout_low:
        chip.pout_low = 1 if 2 * ahead < m else 0
    if pulses:
        _add_pulses(chip, pulses, not chip.output_mode & state.EXTERNAL)


@hot
def compute_mean_count(net_before, net, phase, multiplier, speed, clocks):
    """Compute the mean of a pulse count over the last `clocks` reference clocks, at constant speed.

    Args:
        net_before: Count at the start of these clocks.
        net: Count now.
        phase: Phase of the pulse generator now.
        multiplier: R7.
        speed: Speed steps.
        clocks: Reference clocks.

    Returns:
        The mean, a float.
    """
    n = abs(net - net_before)
    if n == 0:
        return float(net)
    ago = n * phase + 4096.0 * multiplier * n * (n - 1)  # x speed
    # pulses x the part of the time in which they were still to come
    missing = n - least(ago / (speed * clocks), float(n))
    return net - missing if net > net_before else net + missing


@hot
def run_window_at_constant_speed(chip, row_address, first_slice):
    """Run a window as `core_interface.run_window` does, if the chip's speed is constant and no event comes in the window.

    This is faster because values that one slice passes to the next stay in processor registers.

    Args:
        chip: State of the chip.
        row_address: Address of its CHIP record.
        first_slice: Number of the first slice.

    Returns:
        Whether it has run the window.
    """
    r = array_at(row_address, 1, CHIP)[0]
    ends, axis = array_at(r.ends, r.slices, SLICE_END), array_at(r.table, 1, CHIP_AXIS)[0]
    begin, rest, speed, multiplier = r.begin, r.rest, chip.speed, chip.multiplier
    last = compute_slice_end(ends[r.slices - 1], begin, rest)
    if chip.quiet_until < last or chip.active_inputs != chip.last_inputs or multiplier < 2 or speed == 0:
        return False
    means, before = array_at(axis.means, r.slices, REAL), array_at(axis.net, 1, WORD)
    m, direction = 8192 * multiplier, -1 if chip.minus else 1
    clock, phase, net, count = chip.clock, chip.phase, chip.net, before[0]
    while first_slice < r.slices:
        until = compute_slice_end(ends[first_slice], begin, rest)
        ahead = phase + (until - clock) * speed
        pulses = 0
        if ahead >= m:
            pulses = 1 if ahead < 2 * m else ahead // m
        clock, phase = until, ahead - pulses * m
        net += direction * pulses
        means[first_slice] = compute_mean_count(count, net, phase, multiplier, speed, r.ticks)
        count = net
        first_slice += 1
    before[0] = count
    _run_at_constant_speed(chip, clock)
    return True


@hot
def _run_ramp_steps(chip, until):
    """Run the speed steps of a ramp up to `until`, except the last step, as long as no other event comes."""
    goal, direction = find_goal_speed(chip), chip.ramp_direction
    rate, last = read_linear_rate(chip, direction), goal - direction
    if (
        chip.speed_rising != (1 if direction > 0 else 0)
        or (last - chip.speed) * direction <= 0
        or rate < 2
        or chip.multiplier < 2
    ):
        return
    if (
        is_blocked(chip)
        or chip.passed_org
        or (chip.stopping and chip.speed <= chip.reg[1])
        or (not chip.ramp_down_due and is_ramp_down_automatic(chip))
    ):
        return
    if chip.curved_ramp and chip.ramp_goal != goal:
        return
    counts_output = not chip.output_mode & state.EXTERNAL
    m, left, begun = 8192 * chip.multiplier, _count_pulses_to_event(chip, counts_output), 0
    clock, phase, speed = chip.clock, chip.phase, chip.speed
    wait = (chip.next_step_time if chip.curved_ramp else rate) - chip.ramp_clocks
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
        if chip.curved_ramp:
            chip.ramp_clocks = chip.next_step_time
            finish_step(chip)
            wait = chip.next_step_time - chip.ramp_clocks
        else:
            chip.ramp_clocks = 0
            wait = rate
    if clock == chip.clock:
        return
    moved = phase != chip.phase  # a step from speed 0 comes before any
    chip.clock, chip.phase, chip.speed = clock, phase, speed
    if begun or (chip.pout_low and moved):
        chip.pout_low = 1 if 2 * phase < m else 0
    if begun:
        _add_pulses(chip, begun, counts_output)


@hot
def _add_pulses(chip, pulses, counts_output):
    """Add pulses that have begun to the counters of the PCL-240.

    Args:
        chip: State of the chip.
        pulses: Number of pulses.
        counts_output: Whether R0 counts output pulses.
    """
    signed_pulses = -pulses if chip.minus else pulses
    chip.total += pulses
    chip.net += signed_pulses
    if chip.speed_rising:
        chip.rise_pulses += pulses
    if counts_output:
        chip.reg[0] = (chip.reg[0] - pulses) & state.COUNTER_MASK
    if chip.counts_position:
        chip.reg[state.R10] = (chip.reg[state.R10] + signed_pulses) & state.COUNTER_MASK


@exported(None, state.STATE, "i8")
def run(chip, until):
    """Let the chip's clock run up to `until`."""
    while chip.clock < until:
        if chip.active_inputs != chip.last_inputs:
            run_to_event(chip, until - chip.clock)
        elif chip.quiet_until >= until:
            _run_at_constant_speed(chip, until)
        elif not (chip.running or chip.finishing):
            chip.clock = until
        else:
            if chip.ramp_direction and chip.uses_ramps and chip.running:
                _run_ramp_steps(chip, until)
            if chip.clock < until:
                run_to_event(chip, until - chip.clock)
