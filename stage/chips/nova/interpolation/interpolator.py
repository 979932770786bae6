"""Interpolation of the NOVA chips, compiled: it begins and ends segments, and makes their ticks at the right clocks.

The speed profile of the main axis gives a position over time, its *place*, in pulses. Tick k begins when the profile has reached
place k; with constant vector speed the place of a tick that moves two axes is sqrt2 after the one before, and sqrt3 for three axes.
The next tick is always prepared: its pulses, directions, place and clock. When the last tick of a segment has begun, the next
segment is taken from the pre-buffer, so that its first tick comes one period later.
"""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.functions import synchronous_actions
from stage.chips.nova.interpolation import segment
from stage.chips.nova.motion import counters, rate_registers, single_axis_drive
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.profile_evaluation import compute_speed, find_piece
from stage.chips.nova.motion.profile_planner import begin_plan_at, plan_stop
from stage.chips.nova.motion.pulse_output import compute_pulse_width
from stage.chips.nova.registers.mcx300 import MCX312_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.native import exported, greatest, hot, least

INTA, INTB = MCX514_MAP.masks("IPM", "INTA", "INTB")
CIINT, BPINT = MCX312_MAP.masks("WR5", "CIINT", "BPINT")


@hot
def reset_interpolation(chip):
    """Clear the state of a NOVA chip's interpolation."""
    interpolation = chip.ip
    chip.interpolating = 0
    interpolation.deceleration_enabled = interpolation.interrupt = interpolation.waiting_segments = 0
    interpolation.queue_head = interpolation.finished_rotations = 0
    interpolation.loads_pattern = interpolation.stacked_sets = 0
    interpolation.role = interpolation.awaits_start = chip.signals_failure = chip.multichip_error = 0
    interpolation.next_tick_clock = state.NEVER
    for j in range(state.MAX_CHIP_AXES):
        chip.ax[j].interpolates = chip.ax[j].moves = 0
    for k in range(len(interpolation.pattern_words)):
        interpolation.pattern_words[k] = 0


# --- start, segments, end ---


@hot
def find_free_queue_slot(chip):
    """Return the index at which the queue of interpolation segments takes the next segment."""
    return (
        (chip.ip.queue_head + 1 + chip.ip.waiting_segments) % (state.PRE_BUFFER_STAGES + 1)
        if chip.interpolating
        else chip.ip.queue_head
    )


@hot
def note_refused_segment(chip):
    """Note that a segment was refused: an error of continuous interpolation (CERR), if an interpolation is in progress."""
    if chip.interpolating and chip.variant == state.MCX514_TYPE:
        chip.ax[chip.ip.main_axis].stop_causes |= state.E_CERR


@hot
def can_take_segment(chip, axis_mask, queue_depth):
    """Return whether a host can write a segment now, and note an error if it cannot.

    Args:
        chip: State of the chip.
        axis_mask: Axes of the segment, as bits.
        queue_depth: Number of segments that the queue holds.
    """
    if axis_mask == 0:
        return False
    if chip.interpolating:
        if axis_mask != chip.ip.axis_mask or chip.ip.waiting_segments >= queue_depth:
            note_refused_segment(chip)
            return False
        return True
    for j in range(chip.axes):
        axis = chip.ax[j]
        if axis_mask >> j & 1 and (axis.driving or axis.awaits_inpos or axis.home_state):
            return False
    return True


@hot
def submit_segment(chip, axis_mask, main_axis, queue_depth, single_stepped):
    """Start the segment that was written at `find_free_queue_slot`, or queue it behind earlier segments.

    Args:
        chip: State of the chip.
        axis_mask: Axes of the segment, as bits.
        main_axis: Main axis.
        queue_depth: Number of segments that the queue holds.
        single_stepped: Whether a host command makes each tick.
    """
    interpolation = chip.ip
    chip.stale = 1
    if chip.interpolating:
        interpolation.waiting_segments += 1
        interpolation.continuous = 1
        return
    prepare_axes(chip, axis_mask, main_axis, queue_depth, single_stepped)
    interpolation.role = 0
    start_interpolation(chip)


@hot
def prepare_axes(chip, axis_mask, main_axis, queue_depth, single_stepped):
    """Prepare the axes of an interpolation that begins now, or at the same clock as those of other chips.

    Args:
        chip: State of the chip.
        axis_mask: Axes of the segment, as bits.
        main_axis: Main axis.
        queue_depth: Number of segments that the queue holds.
        single_stepped: Whether a host command makes each tick.
    """
    interpolation = chip.ip
    interpolation.axis_mask = axis_mask
    interpolation.main_axis = main_axis
    interpolation.queue_depth = queue_depth
    interpolation.single_stepped = single_stepped
    interpolation.continuous = interpolation.waiting_segments = interpolation.stopping = 0
    for j in range(chip.axes):
        if interpolation.axis_mask >> j & 1:
            y = chip.ax[j]
            y.stop_causes &= 0xFF
            y.pulses_done = y.stopping = y.fixed = y.output_pulses = 0


@exported(None, state.STATE)
def start_interpolation(chip):
    """Start the prepared interpolation, unless a limit or an error prevents it."""
    interpolation, axis = chip.ip, chip.ax[chip.ip.main_axis]
    interpolation.start_clock = chip.clock
    dd.store_pair(interpolation.tick_place, dd.ZERO)
    dd.store_pair(interpolation.segment_start, dd.ZERO)
    segment.update_segment_end(chip)
    if not segment.begin_segment(chip):
        for j in range(chip.axes):
            if interpolation.axis_mask >> j & 1:
                single_axis_drive.note_event(chip.ax[j], state.D_STA | state.D_END)
        return
    segment.prepare_tick(chip)
    stopped = 0
    for j in range(chip.axes):
        if chip.ax[j].moves:
            stopped |= single_axis_drive.find_start_obstacle(chip, chip.ax[j], chip.ax[j].direction)
    if stopped:
        chip.signals_failure = interpolation.role
        return
    for j in range(chip.axes):
        if interpolation.axis_mask >> j & 1:
            chip.ax[j].interpolates = (
                state.MAIN if j == interpolation.main_axis and interpolation.role != state.SLAVE else 1
            )
            single_axis_drive.note_event(chip.ax[j], state.D_STA)
    chip.interpolating = 1
    axis.phase = state.NO_PHASE
    if interpolation.role == state.SLAVE:
        return
    rate_registers.load_rates(chip, axis)
    segment.replan_segment(chip, axis)


@hot
def end_interpolation(chip):
    """End the interpolation now, and drop the segments that wait in its queue."""
    interpolation = chip.ip
    chip.interpolating = interpolation.waiting_segments = interpolation.stopping = 0
    interpolation.single_stepped = interpolation.zone = interpolation.awaits_start = 0
    interpolation.next_tick_clock = state.NEVER
    for j in range(chip.axes):
        if chip.ax[j].interpolates:
            single_axis_drive.end_drive(chip, chip.ax[j], 0)
    chip.stale = 1


@exported(None, state.STATE)
def _begin_next_segment(chip):
    """Begin the next segment of the queue after the last tick of a segment, or end the interpolation."""
    interpolation, axis = chip.ip, chip.ax[chip.ip.main_axis]
    chip.stale = 1
    ends = interpolation.plan_decelerates
    while True:
        if interpolation.waiting_segments == 0 or (interpolation.stopping and axis.end_time >= state.NEVER):
            end_interpolation(chip)
            return
        interpolation.waiting_segments -= 1
        interpolation.queue_head = (interpolation.queue_head + 1) % (state.PRE_BUFFER_STAGES + 1)
        _assert_interrupts(chip)
        dd.store_pair(interpolation.segment_start, dd.load_pair(interpolation.tick_place))
        segment.update_segment_end(chip)
        if segment.begin_segment(chip):
            break
    segment.prepare_tick(chip)
    if (
        not interpolation.stopping
        and not segment.is_chained_pattern(chip)
        and (ends or chip.queue[interpolation.queue_head].decelerates)
    ):
        segment.replan_segment(chip, axis)
    else:
        segment.update_next_tick_clock(chip, axis)


@hot
def _assert_interrupts(chip):
    """Assert the interrupts of the interpolation that are caused when a segment leaves the pre-buffer."""
    interpolation = chip.ip
    if chip.variant == state.MCX514_TYPE:
        word = chip.ax[0].mode[state.IPM]
        interrupts = (interpolation.waiting_segments == 3 and word & INTA) or (
            interpolation.waiting_segments == 7 and word & INTB
        )
    elif chip.queue[interpolation.queue_head].kind == state.PATTERN:
        interrupts = interpolation.waiting_segments == 0 and chip.outputs5 & BPINT
    else:
        interrupts = chip.outputs5 & CIINT
    if interrupts:
        interpolation.interrupt = 1


# --- time ---


@hot
def _compute_tick_rate(chip):
    """Compute the present rate of the interpolation in ticks per clock."""
    interpolation, axis = chip.ip, chip.ax[chip.ip.main_axis]
    if interpolation.role == state.SLAVE:
        return 1.0 / interpolation.tick_interval if interpolation.tick_interval > 0 else 0.0
    return 0.0 if interpolation.awaits_start else compute_speed(axis, chip.clock - axis.origin)


@hot
def begin_interpolation_tick(chip):
    """Begin the prepared tick of the interpolation at the present clock: its pulses, and the preparation of the next tick."""
    interpolation, queued_segment = chip.ip, chip.queue[chip.ip.queue_head]
    if interpolation.ends_interpolation:
        end_interpolation(chip)
        return
    if interpolation.role == state.MASTER:
        chip.master_ticks += 1
    off = chip.clock + compute_pulse_width(_compute_tick_rate(chip))
    for k in range(queued_segment.axis_count):
        if interpolation.steps[k]:
            axis = chip.ax[queued_segment.axis_numbers[k]]
            counters.add_pulses(chip, axis, 1)
            axis.pulse_off_clock = off
            axis.pulse_clock_sum += axis.direction * chip.clock
            axis.recent_net += axis.direction
            if axis.first_pulse_clock == 0:
                axis.first_pulse_clock = chip.clock
    interpolation.ticks_until_check -= 1
    if interpolation.ticks_until_check <= 0:
        chip.stale = 1
    if interpolation.is_last_tick:
        _begin_next_segment(chip)
    else:
        segment.prepare_tick(chip)
        segment.update_next_tick_clock(chip, chip.ax[interpolation.main_axis])


@exported("i8", state.STATE, "i8")
def make_interpolation_ticks(chip, until):
    """Begin all ticks of the interpolation up to a clock.

    Args:
        chip: State of the chip.
        until: Clock at the end.

    Returns:
        The clock that was reached: less than `until` if a tick has caused an event.
    """
    while chip.ip.next_tick_clock <= until:
        chip.clock = chip.ip.next_tick_clock
        begin_interpolation_tick(chip)
        if chip.stale:
            return chip.clock
    return until


@hot
def trace_interpolation_ticks(chip, until, pulses, pulse_index):
    """Begin ticks as `make_interpolation_ticks` does, and log their pulses by clock, then axis.

    Args:
        chip: State of the chip.
        until: Clock at the end.
        pulses: PULSE records to fill.
        pulse_index: Number of the next free record.

    Returns:
        The clock that was reached, and the number of the next free record.
    """
    interpolation = chip.ip
    while interpolation.next_tick_clock <= until:
        chip.clock = interpolation.next_tick_clock
        segment = chip.queue[interpolation.queue_head]
        for j in range(chip.axes):
            for m in range(segment.axis_count):
                if (
                    segment.axis_numbers[m] == j
                    and interpolation.steps[m]
                    and not interpolation.ends_interpolation
                    and pulse_index < len(pulses)
                ):
                    e = pulses[pulse_index]
                    e.clock, e.axis, e.direction = chip.clock, j, chip.ax[j].direction
                    pulse_index += 1
        begin_interpolation_tick(chip)
        if chip.stale:
            return chip.clock, pulse_index
    return until, pulse_index


@hot
def update_interpolation(chip):
    """Process the events of the interpolation that are due at the present clock. Sets `chip.stale` if that changes the chip."""
    if not chip.interpolating:
        return
    interpolation, axis = chip.ip, chip.ax[chip.ip.main_axis]
    stop = 0
    for j in range(chip.axes):
        if chip.ax[j].interpolates:
            stop = greatest(stop, chip.ax[j].stopping)
    if interpolation.awaits_start or interpolation.role == state.SLAVE:
        if stop:
            chip.signals_failure = 1 if interpolation.role == state.SLAVE else 0
            end_interpolation(chip)
        return
    n = chip.clock - axis.origin
    if stop == single_axis_drive.INSTANT_STOP or n >= axis.end_time or (stop and interpolation.single_stepped):
        if interpolation.role == state.MASTER and collect_axis_errors(chip) & ~interpolation.errors_at_start:
            chip.signals_failure = 1
        end_interpolation(chip)
        return
    s = find_piece(axis, n)
    if stop and not interpolation.stopping:
        interpolation.stopping = 1
        if s < axis.brake_piece or not axis.curved or chip.variant == state.MCX514_TYPE:
            begin_plan_at(axis, n)
            plan_stop(axis)
            segment.reschedule_tick(chip, axis)
        chip.stale = 1
    elif (
        not interpolation.stopping
        and s < axis.brake_piece
        and interpolation.planned_speed != segment.find_limited_drive_speed(chip, axis)
    ):
        segment.replan_segment(chip, axis)
        chip.stale = 1
    single_axis_drive.update_ramp_phase(axis, chip.clock - axis.origin)


@hot
def collect_axis_errors(chip):
    """Return the error bits of the register RR2 of all axes, one byte per axis."""
    found = 0
    for j in range(chip.axes):
        found |= (chip.ax[j].stop_causes & 0xFF) << 8 * j
    return found


@hot
def find_next_event(chip):
    """Return the clock of the interpolation's next event other than a tick; store in `ticks_until_check` when to look again."""
    interpolation, axis = chip.ip, chip.ax[chip.ip.main_axis]
    interpolation.ticks_until_check = state.NEVER
    for j in range(chip.axes):
        y = chip.ax[j]
        if y.interpolates:
            pulses = single_axis_drive.count_pulses_to_event(chip, y)
            pulses = least(pulses, synchronous_actions.count_pulses_to_event(chip, y))
            interpolation.ticks_until_check = least(interpolation.ticks_until_check, pulses)
    if interpolation.awaits_start or interpolation.role == state.SLAVE:
        return state.NEVER
    n = chip.clock - axis.origin
    s = find_piece(axis, n)
    at = axis.end_time
    if s + 1 < axis.pieces:
        at = least(at, axis.from_clock[s + 1])
    return axis.origin + at if at < state.NEVER else state.NEVER


@hot
def make_single_step(chip):
    """Make the next tick of a single-stepped interpolation by a host's command."""
    if chip.interpolating and chip.ip.single_stepped and not chip.ip.awaits_start and chip.ip.role != state.SLAVE:
        begin_interpolation_tick(chip)
        chip.stale = 1


# --- what can be read ---


@hot
def compute_axis_rate(chip, axis_index):
    """Compute the present rate of an axis in an interpolation, in pulses per clock.

    With constant vector speed the ticks count as evenly spaced."""
    interpolation, segment = chip.ip, chip.queue[chip.ip.queue_head]
    share = 0.0
    for k in range(segment.axis_count):
        if segment.axis_numbers[k] == axis_index:
            if segment.kind == state.PATTERN:
                share = float(interpolation.steps[k])
            elif segment.kind == state.LINE or k >= 2:
                share = abs(segment.finish[k]) / greatest(segment.tick_count, 1)
            else:
                u, v = abs(interpolation.arc.x), abs(interpolation.arc.y)
                share = (v if k == 0 else u) / greatest(greatest(u, v), 1)
    return share * _compute_tick_rate(chip)


@hot
def find_next_tick(chip):
    """Return the clock of the next tick of the interpolation."""
    return chip.ip.next_tick_clock
