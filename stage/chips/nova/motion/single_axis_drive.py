"""The drive of one axis of a NOVA chip, compiled: how it starts, makes its pulses and ends, and when its next event is due."""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion import profile_planner
from stage.chips.nova.motion.counters import NO_MAXIMUM, add_pulses, has_passed_soft_limit, is_limit_asserted
from stage.chips.nova.motion.profile_evaluation import count_begun_pulses, find_clock_of_pulse, find_phase, find_piece
from stage.chips.nova.motion.pulse_output import store_pulse_end
from stage.chips.nova.motion.rate_registers import UNIT_MULTIPLE_RANGE, load_drive_speed, load_rates
from stage.native import exported, greatest, hot, least

RELATIVE, COUNTER_RELATIVE, ABSOLUTE, FORWARD, BACKWARD = range(5)
FIXED_PLUS, FIXED_MINUS = 5, 6
RELATIVE_BY, ABSOLUTE_TO = 7, 11  # + m: by MRm, to MRm
INSTANT_STOP = 2  # of `slow`


@hot
def note_event(axis, event):
    """Note an event of an axis, for RR1 and for the synchronous actions."""
    axis.events |= event
    axis.new_events |= event


@hot
def note_drive_event(axis, event):
    """Note the begin or end of a drive. During a home search this does nothing: for the host the search is one drive."""
    if not axis.home_state:
        note_event(axis, event)


@hot
def store_data_register(chip, address, value):
    """Store a write to WR6 or WR7.

    Args:
        chip: State of the chip.
        address: 6 or 7.
        value: Datum.
    """
    chip.has_unused_data = 1
    if address == 6:
        chip.data_low = value
    else:
        chip.data_high = value


# --- start and plan ---


@hot
def find_goal_speed(axis, pulses):
    """Find the speed to which a drive accelerates: DV, or less if that prevents a triangle.

    Args:
        axis: State of the axis.
        pulses: Number of pulses of the drive.
    """
    goal = dd.load_pair(axis.dv)
    if (
        axis.prevents_triangle and not axis.curved and dd.is_less(dd.load_pair(axis.sv), goal)
    ):  # a speed above the cap is kept
        top = profile_planner.compute_triangle_speed(axis, pulses)
        now = dd.load_pair(axis.cursor[profile_planner.CURSOR_SPEED])
        goal = dd.minimum(goal, now if dd.is_less(top, now) else top)
    return goal


@hot
def plan_drive(chip, axis):
    """Plan the rest of the drive, from the cursor of the plan on."""
    load_drive_speed(chip, axis, axis.reg[state.DV])
    if not axis.fixed:
        profile_planner.plan_endless_drive(axis, dd.load_pair(axis.dv))
        return
    goal = find_goal_speed(axis, axis.output_pulses)
    if not axis.manual_deceleration:
        profile_planner.plan_fixed_drive(axis, dd.to_double_double(axis.output_pulses - axis.reg[state.AO]), goal)
    elif axis.pulses_done < axis.reg[state.DP]:
        profile_planner.plan_endless_drive(axis, goal)
        if axis.reg[state.DP] < axis.output_pulses:
            profile_planner.plan_braking_at(axis, axis.reg[state.DP])
    else:
        profile_planner.append_braking(axis)


@exported(None, state.STATE, state.AXIS, "i8", "i8")
def begin_drive(chip, axis, direction, pulse_count):
    """Begin a drive at the present clock.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        direction: +1 or -1.
        pulse_count: Number of pulses; negative for a drive without an end.
    """
    axis.stop_causes &= 0xFF
    axis.pulses_done = axis.stopping = 0
    axis.direction, axis.fixed, axis.output_pulses = direction, 1 if pulse_count >= 0 else 0, pulse_count
    axis.interpolates = 0
    chip.stale = 1
    if pulse_count == 0:
        note_drive_event(axis, state.D_STA | state.D_END)
        return
    if find_start_obstacle(chip, axis, direction):
        return
    note_drive_event(axis, state.D_STA)
    axis.driving, axis.phase = 1, state.NO_PHASE
    load_rates(chip, axis)
    load_drive_speed(chip, axis, axis.reg[state.DV])
    profile_planner.begin_plan(
        axis, chip.clock, dd.ZERO, dd.ZERO, dd.minimum(dd.load_pair(axis.sv), dd.load_pair(axis.dv)), dd.ZERO
    )
    plan_drive(chip, axis)


@hot
def find_start_obstacle(chip, axis, direction):
    """Find the inputs that keep a drive from starting (a limit of its direction, ALARM or EMG), and note them in RR2.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        direction: +1 or -1.

    Returns:
        Bits of RR2; 0 if the drive can start.
    """
    cause = 0
    if axis.limits_stop and is_limit_asserted(axis, direction):
        cause = (state.E_HLMT_PLUS | state.F_LMT_PLUS) if direction > 0 else (state.E_HLMT_MINUS | state.F_LMT_MINUS)
    elif has_passed_soft_limit(chip, axis, direction):
        cause = state.E_SLMT_PLUS if direction > 0 else state.E_SLMT_MINUS
    elif axis.alarm_stops and axis.active_inputs & state.ALARM:
        cause = state.E_ALARM | state.F_ALARM
    elif chip.emergency:
        cause = state.E_EMG | state.F_EMG
    elif (
        axis.stop_causes
        & (state.E_HLMT_PLUS | state.E_SLMT_PLUS if direction > 0 else state.E_HLMT_MINUS | state.E_SLMT_MINUS)
        and chip.variant == state.MCX514_TYPE
    ):
        cause = axis.stop_causes & 0xFF
    axis.stop_causes |= cause
    return cause


@hot
def execute_drive_command(chip, axis, kind):
    """Execute a drive command. It does nothing while a drive or a home search is in progress.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        kind: RELATIVE to FIXED_MINUS, or RELATIVE_BY or ABSOLUTE_TO plus the number of an MR.
    """
    if axis.driving or axis.awaits_inpos or axis.home_state or axis.interpolates:
        return
    if axis.start_hold & 1:
        axis.start_hold = 1 | (kind + 1) << 1
        return
    axis.absolute = 1 if kind == ABSOLUTE or kind >= ABSOLUTE_TO else 0
    axis.pulse_sign = -1 if kind == COUNTER_RELATIVE else 1
    tp = axis.reg[state.TP]
    if kind == FORWARD:
        begin_drive(chip, axis, 1, -1)
    elif kind == BACKWARD:
        begin_drive(chip, axis, -1, -1)
    elif kind in (FIXED_PLUS, FIXED_MINUS):
        begin_drive(chip, axis, 1 if kind == FIXED_PLUS else -1, tp & 0xFFFFFFFF)
    else:
        if kind >= RELATIVE_BY:
            tp = axis.reg[state.MR0 + kind - (ABSOLUTE_TO if kind >= ABSOLUTE_TO else RELATIVE_BY)]
        if axis.absolute:
            tp -= axis.reg[state.LP]
        elif kind == COUNTER_RELATIVE:
            tp = -tp
        begin_drive(chip, axis, 1 if tp >= 0 else -1, abs(tp))


@hot
def set_start_hold(chip, axis, hold):
    """Begin or end the drive start hold, which delays drives. Its end starts the drive that was commanded during the hold.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        hold: Whether the hold begins.
    """
    if hold:
        axis.start_hold |= 1
        return
    kind = (axis.start_hold >> 1) - 1
    axis.start_hold = 0
    if kind >= 0:
        execute_drive_command(chip, axis, kind)


@exported(None, state.STATE, state.AXIS)
def replan_drive(chip, axis):
    """Plan the rest of a drive again, after its drive speed or number of pulses has changed."""
    if not axis.driving or axis.stopping:
        return
    store_pulse_end(axis)
    profile_planner.begin_plan_at(axis, chip.clock - axis.origin)
    plan_drive(chip, axis)


@hot
def change_drive_speed(chip, axis, value):
    """Change the drive speed. Once the automatic deceleration has begun the new speed waits for the next drive.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        value: Value of DV or V.
    """
    axis.reg[state.DV] = value
    if axis.driving and not axis.stopping and find_piece(axis, chip.clock - axis.origin) < axis.brake_piece:
        replan_drive(chip, axis)
    chip.stale = 1


@hot
def step_drive_speed(chip, axis, direction):
    """Increase or decrease the drive speed DV by the speed increment, the register IV, within 1 to RANGE.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        direction: +1 or -1.
    """
    change_drive_speed(
        chip, axis, least(greatest(axis.reg[state.DV] + direction * axis.reg[state.IV], 1), UNIT_MULTIPLE_RANGE)
    )


@hot
def change_pulse_count(chip, axis, value):
    """Change the number of pulses of the drive in progress.

    The drive stops at once if the new number is in the other direction, or if the drive has already made more pulses.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        value: Value of TP or P.
    """
    axis.reg[state.TP] = value
    if not (axis.driving and axis.fixed) or axis.absolute or axis.interpolates:
        return
    output = value & 0xFFFFFFFF
    if chip.variant == state.MCX514_TYPE:
        output = abs(value) if (value >= 0) == (axis.direction * axis.pulse_sign > 0) else 0
    chip.stale = 1
    if output <= axis.pulses_done:
        end_drive(chip, axis, 0)
        return
    axis.output_pulses = output
    replan_drive(chip, axis)


# --- the end ---


@hot
def end_drive(chip, axis, cause):
    """End the drive of the axis now.

    On the chips before the MCX514 the end of a drive at constant speed is also the event C-END, as the failure notice says.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        cause: Bits of RR2.
    """
    axis.stop_causes |= cause
    if axis.phase == state.CONSTANT and chip.variant != state.MCX514_TYPE:
        note_event(axis, state.C_END)
    store_pulse_end(axis)
    axis.driving = axis.stopping = axis.interpolates = 0
    axis.phase = state.NO_PHASE
    chip.stale = 1
    if axis.inpos_enabled and not axis.active_inputs & state.INPOS:
        axis.awaits_inpos = 1
    else:
        note_drive_event(axis, state.D_END)


@exported(None, state.STATE, state.AXIS, "i8")
def begin_decelerating_stop(chip, axis, cause):
    """Begin a decelerating stop (56h, 26h, a STOP input, or a limit in that mode).

    A chip with the S-curve failure ignores it while it brakes on an S-curve, and runs away if it comes in area d. During
    interpolation the stop of one axis stops all.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        cause: Bits of RR2.
    """
    axis.stop_causes |= cause
    if axis.interpolates and not axis.stopping:
        axis.stopping = chip.stale = 1
    if not axis.driving or axis.stopping:
        return
    n = chip.clock - axis.origin
    s = find_piece(axis, n)
    if (
        s >= axis.brake_piece
        and axis.curved
        and chip.variant != state.MCX514_TYPE
        and axis.piece_phase[s] == state.DECELERATING
    ):
        return
    axis.stopping = 1
    store_pulse_end(axis)
    profile_planner.begin_plan_at(axis, n)
    if axis.piece_phase[s] == state.AREA_D:
        dd.store_pair(axis.cursor[profile_planner.CURSOR_ACCELERATION], dd.ZERO)
        profile_planner.plan_runaway(axis)
        axis.fixed = 0
    else:
        load_drive_speed(chip, axis, axis.reg[state.DV])
        profile_planner.plan_stop(axis)
    chip.stale = 1


@hot
def stop_at_once(chip, axis, cause):
    """Stop a drive at once (commands 57h, 27h, the inputs ALARM and EMG, or a limit).

    Args:
        chip: State of the chip.
        axis: State of the axis.
        cause: Bits of RR2.
    """
    if axis.driving:
        end_drive(chip, axis, cause)
    elif axis.interpolates:
        axis.stop_causes |= cause
        axis.stopping, chip.stale = INSTANT_STOP, 1


@hot
def apply_inputs(chip, axis):
    """Apply the present input levels to a drive, or to an interpolation in which the axis takes part.

    During interpolation limits count only while the running segment moves the axis.
    """
    if axis.awaits_inpos and (axis.active_inputs & state.INPOS or not axis.inpos_enabled):
        axis.awaits_inpos = 0
        note_drive_event(axis, state.D_END)
    if not (axis.driving or axis.interpolates):
        return
    if chip.emergency:
        stop_at_once(chip, axis, state.E_EMG | state.F_EMG)
        return
    if axis.alarm_stops and axis.active_inputs & state.ALARM:
        stop_at_once(chip, axis, state.E_ALARM | state.F_ALARM)
        return
    if (axis.driving or axis.moves) and _apply_limits(chip, axis):
        return
    for k in range(3):
        if axis.stop_inputs >> k & 1 and axis.active_inputs & state.STOP0 << k and not axis.home_state:
            begin_decelerating_stop(chip, axis, state.F_STOP0 << k)
    if axis.stop_inputs >> 3 and axis.active_inputs & state.STOP3 and not axis.home_state:
        begin_decelerating_stop(chip, axis, state.F_STOP3)


@hot
def _apply_limits(chip, axis):
    """Apply the hardware and software limits to a drive, and return whether one has stopped it at once."""
    if axis.limits_stop and not axis.home_handles_limits and is_limit_asserted(axis, axis.direction):
        cause = (
            (state.E_HLMT_PLUS | state.F_LMT_PLUS) if axis.direction > 0 else (state.E_HLMT_MINUS | state.F_LMT_MINUS)
        )
        if axis.limits_decelerate:
            begin_decelerating_stop(chip, axis, cause)
        else:
            stop_at_once(chip, axis, cause)
            return True
    if has_passed_soft_limit(chip, axis, axis.direction):
        cause = state.E_SLMT_PLUS if axis.direction > 0 else state.E_SLMT_MINUS
        if axis.soft_instant:
            stop_at_once(chip, axis, cause)
            return True
        begin_decelerating_stop(chip, axis, cause)
    return False


# --- time ---


@hot
def begin_pulses_until(chip, axis, clock):
    """Begin the pulses of a drive up to a clock.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        clock: Reference clocks since power-up.
    """
    k = count_begun_pulses(axis, clock - axis.origin)
    if axis.fixed and k > axis.output_pulses:
        k = axis.output_pulses
    if k > axis.pulses_done:
        add_pulses(chip, axis, k - axis.pulses_done)


@hot
def update_drive(chip, axis):
    """End the drive if it is complete, else update its ramp phase. Call this after each advance of time and each change."""
    if not axis.driving:
        return
    n = chip.clock - axis.origin
    if (axis.fixed and axis.pulses_done >= axis.output_pulses) or n >= axis.end_time:
        end_drive(chip, axis, 0)
        return
    update_ramp_phase(axis, n)


@hot
def update_ramp_phase(axis, clocks):
    """Note the events at which constant speed begins and ends.

    Args:
        axis: State of the axis.
        clocks: Clocks since the origin of the plan.
    """
    now = find_phase(axis, clocks)
    if now == state.AREA_D:
        now = state.CONSTANT
    if now != axis.phase:
        if now == state.CONSTANT:
            note_event(axis, state.C_STA)
        elif axis.phase == state.CONSTANT:
            note_event(axis, state.C_END)
        axis.phase = now


@hot
def count_pulses_to_event(chip, axis):
    """Return the number of pulses until a counter reaches a value that affects the drive, such as a software limit."""
    pulses = axis.output_pulses - axis.pulses_done if axis.fixed else state.NEVER
    if not axis.soft_rp:
        lp = axis.reg[state.LP]
        if axis.direction > 0 and axis.soft_plus:
            limit = axis.reg[state.SP] + (1 if chip.variant == state.MCX514_TYPE else 0)
            if lp < limit:
                pulses = least(pulses, limit - lp)
        elif axis.direction < 0 and axis.soft_minus and lp >= axis.reg[state.SM]:
            pulses = least(pulses, lp - axis.reg[state.SM] + 1)
    if chip.variant == state.MCX514_TYPE and axis.reg[state.LX] != NO_MAXIMUM:
        if not 0 <= axis.reg[state.LP] <= axis.reg[state.LX]:
            return 1  # the ring takes it in with the next pulse
        pulses = least(
            pulses, axis.reg[state.LX] + 1 - axis.reg[state.LP] if axis.direction > 0 else axis.reg[state.LP] + 1
        )
    return pulses


@hot
def find_next_event(chip, axis, pulses):
    """Find the next event of a drive.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        pulses: Number of pulses after which other functions of the chip need an event.

    Returns:
        The clock of the event.
    """
    n = chip.clock - axis.origin
    s = find_piece(axis, n)
    at = axis.end_time
    if s + 1 < axis.pieces:
        at = least(at, axis.from_clock[s + 1])
    pulses = least(pulses, count_pulses_to_event(chip, axis))
    if pulses < state.NEVER:
        k = axis.pulses_done + greatest(pulses, 1)
        if at >= state.NEVER or count_begun_pulses(axis, at) >= k:
            at = least(at, find_clock_of_pulse(axis, k))
    return axis.origin + at if at < state.NEVER else state.NEVER
