"""Interpolation of the NOVA chips, compiled. The profile of the main axis makes ticks; in each, an axis makes one pulse at most.

The k-th tick begins when the profile has come to place k; with constant vector speed a tick that moves two axes is sqrt2 places
from the one before, one that moves three sqrt3. The next tick is always prepared: its steps, directions, place and clock. When the
last tick of a segment has begun the next segment is taken from the pre-buffer, so that its first tick comes one period later.
"""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.functions import sync
from stage.chips.nova.interpolation import segment
from stage.chips.nova.motion import counters, drive, rates
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.planner import begin_plan_at, plan_stop, read_pair, write_pair
from stage.chips.nova.motion.profile import compute_speed, find_piece
from stage.chips.nova.motion.pulse_output import compute_pulse_width
from stage.chips.nova.registers.mcx300 import MCX312_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.native import exported, greatest, hot, least

INTA, INTB = MCX514_MAP.mask("IPM", "INTA"), MCX514_MAP.mask("IPM", "INTB")
CIINT, BPINT = MCX312_MAP.mask("WR5", "CIINT"), MCX312_MAP.mask("WR5", "BPINT")


@hot
def reset_interpolation(c):
    """Clear the state of the interpolation."""
    ip = c.ip
    c.interpolating = 0
    ip.deceleration_enabled = ip.interrupt = ip.waiting_segments = ip.queue_head = ip.finished_rotations = 0
    ip.loads_pattern = ip.stacked_sets = 0
    ip.role = ip.awaits_start = c.signals_failure = c.multichip_error = 0
    ip.next_tick_clock = state.NEVER
    for j in range(state.AXES):
        c.ax[j].interpolates = c.ax[j].moves = 0
    for k in range(len(ip.pattern_words)):
        ip.pattern_words[k] = 0


# --- start, segments, end ---


@hot
def find_free_place(c):
    """Return the place in the queue that takes the next segment."""
    return (c.ip.queue_head + 1 + c.ip.waiting_segments) % (state.STAGES + 1) if c.interpolating else c.ip.queue_head


@hot
def note_refused_segment(c):
    """Note that a segment cannot be taken: an error of continuous interpolation (CERR), if one is in progress."""
    if c.interpolating and c.variant == state.MCX514_TYPE:
        c.ax[c.ip.main_axis].stop_causes |= state.E_CERR


@hot
def can_take_segment(c, mask, depth):
    """Return whether a segment can be written now, and note an error if not.

    Args:
        c: State of the chip.
        mask: Axes of the segment, as bits.
        depth: Number of segments that the queue holds.
    """
    if mask == 0:
        return False
    if c.interpolating:
        if mask != c.ip.axis_mask or c.ip.waiting_segments >= depth:
            note_refused_segment(c)
            return False
        return True
    for j in range(c.axes):
        x = c.ax[j]
        if mask >> j & 1 and (x.driving or x.awaits_inpos or x.home_state):
            return False
    return True


@hot
def submit_segment(c, mask, main, depth, stepped):
    """Start the segment at `find_free_place`, or queue it behind those before it.

    Args:
        c: State of the chip.
        mask: Axes of the segment, as bits.
        main: Main axis.
        depth: Number of segments that the queue holds.
        stepped: Whether single steps move it.
    """
    ip = c.ip
    c.stale = 1
    if c.interpolating:
        ip.waiting_segments += 1
        ip.continuous = 1
        return
    prepare_axes(c, mask, main, depth, stepped)
    ip.role = 0
    start_interpolation(c)


@hot
def prepare_axes(c, mask, main, depth, stepped):
    """Prepare the axes of an interpolation that begins now, or at the same clock as those of other chips.

    Args:
        c: State of the chip.
        mask: Axes of the segment, as bits.
        main: Main axis.
        depth: Number of segments that the queue holds.
        stepped: Whether single steps move it.
    """
    ip = c.ip
    ip.axis_mask, ip.main_axis, ip.queue_depth, ip.single_stepped = mask, main, depth, stepped
    ip.continuous = ip.waiting_segments = ip.stopping = 0
    for j in range(c.axes):
        if ip.axis_mask >> j & 1:
            y = c.ax[j]
            y.stop_causes &= 0xFF
            y.pulses_done = y.stopping = y.fixed = y.output_pulses = 0


@exported(None, state.STATE)
def start_interpolation(c):
    """Start the prepared interpolation, unless a limit or an error prevents it."""
    ip, x = c.ip, c.ax[c.ip.main_axis]
    ip.start_clock = c.clock
    write_pair(ip.tick_place, dd.ZERO)
    write_pair(ip.segment_start, dd.ZERO)
    segment.find_segment_end(c)
    if not segment.begin_segment(c):
        for j in range(c.axes):
            if ip.axis_mask >> j & 1:
                drive.note_event(c.ax[j], state.D_STA | state.D_END)
        return
    segment.prepare_tick(c)
    stopped = 0
    for j in range(c.axes):
        if c.ax[j].moves:
            stopped |= drive.find_start_obstacle(c, c.ax[j], c.ax[j].direction)
    if stopped:
        c.signals_failure = ip.role
        return
    for j in range(c.axes):
        if ip.axis_mask >> j & 1:
            c.ax[j].interpolates = state.MAIN if j == ip.main_axis and ip.role != state.SLAVE else 1
            drive.note_event(c.ax[j], state.D_STA)
    c.interpolating = 1
    x.phase = state.NO_PHASE
    if ip.role == state.SLAVE:
        return
    rates.load_rates(c, x)
    segment.replan_segment(c, x)


@hot
def end_interpolation(c):
    """End the interpolation now, and drop the segments that wait."""
    ip = c.ip
    c.interpolating = ip.waiting_segments = ip.stopping = ip.single_stepped = ip.zone = ip.awaits_start = 0
    ip.next_tick_clock = state.NEVER
    for j in range(c.axes):
        if c.ax[j].interpolates:
            drive.end_drive(c, c.ax[j], 0)
    c.stale = 1


@exported(None, state.STATE)
def _begin_next_segment(c):
    """Begin the next segment after the last tick of one, or end the interpolation."""
    ip, x = c.ip, c.ax[c.ip.main_axis]
    c.stale = 1
    ends = ip.plan_decelerates
    while True:
        if ip.waiting_segments == 0 or (ip.stopping and x.end_time >= state.NEVER):
            end_interpolation(c)
            return
        ip.waiting_segments -= 1
        ip.queue_head = (ip.queue_head + 1) % (state.STAGES + 1)
        _assert_interrupts(c)
        write_pair(ip.segment_start, read_pair(ip.tick_place))
        segment.find_segment_end(c)
        if segment.begin_segment(c):
            break
    segment.prepare_tick(c)
    if not ip.stopping and not segment.is_chained_pattern(c) and (ends or c.queue[ip.queue_head].decelerates):
        segment.replan_segment(c, x)
    else:
        segment.find_tick_clock(c, x)


@hot
def _assert_interrupts(c):
    """Assert the interrupt that a segment causes when it leaves the pre-buffer."""
    ip = c.ip
    if c.variant == state.MCX514_TYPE:
        word = c.ax[0].mode[state.IPM]
        interrupts = (ip.waiting_segments == 3 and word & INTA) or (ip.waiting_segments == 7 and word & INTB)
    elif c.queue[ip.queue_head].kind == state.PATTERN:
        interrupts = ip.waiting_segments == 0 and c.outputs5 & BPINT
    else:
        interrupts = c.outputs5 & CIINT
    if interrupts:
        ip.interrupt = 1


# --- time ---


@hot
def _compute_tick_rate(c):
    """Compute the present rate in ticks per clock."""
    ip, x = c.ip, c.ax[c.ip.main_axis]
    if ip.role == state.SLAVE:
        return 1.0 / ip.tick_interval if ip.tick_interval > 0 else 0.0
    return 0.0 if ip.awaits_start else compute_speed(x, c.clock - x.origin)


@hot
def make_tick(c):
    """Begin the prepared tick at the present clock."""
    ip, g = c.ip, c.queue[c.ip.queue_head]
    if ip.ends_interpolation:
        end_interpolation(c)
        return
    if ip.role == state.MASTER:
        c.master_ticks += 1
    off = c.clock + compute_pulse_width(_compute_tick_rate(c))
    for k in range(g.axis_count):
        if ip.steps[k]:
            x = c.ax[g.axis_numbers[k]]
            counters.add_pulses(c, x, 1)
            x.pulse_off_clock = off
            x.pulse_clock_sum += x.direction * c.clock
            x.recent_net += x.direction
            if x.first_pulse_clock == 0:
                x.first_pulse_clock = c.clock
    ip.ticks_until_check -= 1
    if ip.ticks_until_check <= 0:
        c.stale = 1
    if ip.is_last_tick:
        _begin_next_segment(c)
    else:
        segment.prepare_tick(c)
        segment.find_tick_clock(c, c.ax[ip.main_axis])


@exported("i8", state.STATE, "i8")
def make_ticks(c, until):
    """Begin the ticks up to a clock.

    Args:
        c: State of the chip.
        until: Clock at the end.

    Returns:
        The clock that was reached: less than `until` if a tick has caused an event.
    """
    while c.ip.next_tick_clock <= until:
        c.clock = c.ip.next_tick_clock
        make_tick(c)
        if c.stale:
            return c.clock
    return until


@hot
def trace_ticks(c, until, out, k):
    """Begin ticks as `make_ticks` does, and log their pulses by clock, then axis.

    Args:
        c: State of the chip.
        until: Clock at the end.
        out: PULSE records to fill.
        k: Number of the next free record.

    Returns:
        The clock that was reached, and the number of the next free record.
    """
    ip = c.ip
    while ip.next_tick_clock <= until:
        c.clock = ip.next_tick_clock
        g = c.queue[ip.queue_head]
        for j in range(c.axes):
            for m in range(g.axis_count):
                if g.axis_numbers[m] == j and ip.steps[m] and not ip.ends_interpolation and k < len(out):
                    e = out[k]
                    e.clock, e.axis, e.direction = c.clock, j, c.ax[j].direction
                    k += 1
        make_tick(c)
        if c.stale:
            return c.clock, k
    return until, k


@hot
def update_interpolation(c):
    """Do what is due at the present clock. Sets `stale` if that changes something."""
    if not c.interpolating:
        return
    ip, x = c.ip, c.ax[c.ip.main_axis]
    stop = 0
    for j in range(c.axes):
        if c.ax[j].interpolates:
            stop = greatest(stop, c.ax[j].stopping)
    if ip.awaits_start or ip.role == state.SLAVE:
        if stop:
            c.signals_failure = 1 if ip.role == state.SLAVE else 0
            end_interpolation(c)
        return
    n = c.clock - x.origin
    if stop == drive.INSTANT_STOP or n >= x.end_time or (stop and ip.single_stepped):
        if ip.role == state.MASTER and collect_errors(c) & ~ip.errors_at_start:
            c.signals_failure = 1
        end_interpolation(c)
        return
    s = find_piece(x, n)
    if stop and not ip.stopping:
        ip.stopping = 1
        if s < x.brake_piece or not x.curved or c.variant == state.MCX514_TYPE:
            begin_plan_at(x, n)
            plan_stop(x)
            segment.schedule_tick(c, x)
        c.stale = 1
    elif not ip.stopping and s < x.brake_piece and ip.planned_speed != segment.limit_drive_speed(c, x):
        segment.replan_segment(c, x)
        c.stale = 1
    drive.update_phase(x, c.clock - x.origin)


@hot
def collect_errors(c):
    """Return the error bits of RR2 of all axes, a byte per axis."""
    found = 0
    for j in range(c.axes):
        found |= (c.ax[j].stop_causes & 0xFF) << 8 * j
    return found


@hot
def find_next_event(c):
    """Return the clock of the next event except ticks, and set `ticks_until_check`."""
    ip, x = c.ip, c.ax[c.ip.main_axis]
    ip.ticks_until_check = state.NEVER
    for j in range(c.axes):
        y = c.ax[j]
        if y.interpolates:
            ip.ticks_until_check = least(
                ip.ticks_until_check, least(drive.count_pulses_to_event(c, y), sync.count_pulses_to_event(c, y))
            )
    if ip.awaits_start or ip.role == state.SLAVE:
        return state.NEVER
    n = c.clock - x.origin
    s = find_piece(x, n)
    at = x.end_time
    if s + 1 < x.pieces:
        at = least(at, x.from_clock[s + 1])
    return x.origin + at if at < state.NEVER else state.NEVER


@hot
def make_single_step(c):
    """Make the next tick by command, if the interpolation is single-stepped."""
    if c.interpolating and c.ip.single_stepped and not c.ip.awaits_start and c.ip.role != state.SLAVE:
        make_tick(c)
        c.stale = 1


# --- what can be read ---


@hot
def compute_axis_rate(c, j):
    """Compute the rate of an axis that takes part, in pulses per clock. Ticks of constant vector speed count as evenly spaced."""
    ip, g = c.ip, c.queue[c.ip.queue_head]
    share = 0.0
    for k in range(g.axis_count):
        if g.axis_numbers[k] == j:
            if g.kind == state.PATTERN:
                share = float(ip.steps[k])
            elif g.kind == state.LINE or k >= 2:
                share = abs(g.finish[k]) / greatest(g.tick_count, 1)
            else:
                u, v = abs(ip.arc.x), abs(ip.arc.y)
                share = (v if k == 0 else u) / greatest(greatest(u, v), 1)
    return share * _compute_tick_rate(c)


@hot
def find_next_tick(c):
    """Return the clock of the next tick."""
    return c.ip.next_tick_clock
