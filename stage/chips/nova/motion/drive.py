"""The drive of one axis of a NOVA chip: its start, its pulses, its end, and its next event; compiled."""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion import planner
from stage.chips.nova.motion.counters import NO_MAXIMUM, add_pulses, has_passed_soft_limit, is_limit_asserted
from stage.chips.nova.motion.profile import count_begun_pulses, find_clock_of_pulse, find_phase, find_piece
from stage.chips.nova.motion.pulse_output import store_pulse_end
from stage.chips.nova.motion.rates import RANGE, load_drive_speed, load_rates
from stage.native import exported, greatest, hot, least

RELATIVE, COUNTER_RELATIVE, ABSOLUTE, FORWARD, BACKWARD = range(5)
FIXED_PLUS, FIXED_MINUS = 5, 6
RELATIVE_BY, ABSOLUTE_TO = 7, 11  # + m: by MRm, to MRm
INSTANT_STOP = 2  # of `slow`


@hot
def note_event(x, event):
    """Note an event of an axis, for RR1 and for the synchronous actions."""
    x.events |= event
    x.new_events |= event


@hot
def note_drive_event(x, event):
    """Note the begin or end of a drive. During a home search this does nothing: for the host the search is one drive."""
    if not x.home_state:
        note_event(x, event)


@hot
def store_data(c, address, value):
    """Store a write to WR6 or WR7.

    Args:
        c: State of the chip.
        address: 6 or 7.
        value: Datum.
    """
    c.has_unused_data = 1
    if address == 6:
        c.data_low = value
    else:
        c.data_high = value


# --- start and plan ---


@hot
def find_goal_speed(x, pulses):
    """Find the speed to which a drive accelerates: DV, or less if that prevents a triangle.

    Args:
        x: State of the axis.
        pulses: Number of pulses of the drive.
    """
    goal = planner.read_pair(x.dv)
    if (
        x.prevents_triangle and not x.curved and dd.is_less(planner.read_pair(x.sv), goal)
    ):  # a speed above the cap is kept
        top, now = planner.compute_triangle_speed(x, pulses), planner.read_pair(x.cursor[planner.CURSOR_SPEED])
        goal = dd.minimum(goal, now if dd.is_less(top, now) else top)
    return goal


@hot
def plan_drive(c, x):
    """Plan the rest of the drive, from the cursor of the plan on."""
    load_drive_speed(c, x, x.reg[state.DV])
    if not x.fixed:
        planner.plan_endless_drive(x, planner.read_pair(x.dv))
        return
    goal = find_goal_speed(x, x.output_pulses)
    if not x.manual_deceleration:
        planner.plan_fixed_drive(x, dd.from_integer(x.output_pulses - x.reg[state.AO]), goal)
    elif x.pulses_done < x.reg[state.DP]:
        planner.plan_endless_drive(x, goal)
        if x.reg[state.DP] < x.output_pulses:
            planner.plan_braking_at(x, x.reg[state.DP])
    else:
        planner.append_braking(x)


@exported(None, state.STATE, state.AXIS, "i8", "i8")
def begin_drive(c, x, direction, output):
    """Begin a drive at the present clock.

    Args:
        c: State of the chip.
        x: State of the axis.
        direction: +1 or -1.
        output: Number of pulses; below 0 for a drive without an end.
    """
    x.stop_causes &= 0xFF
    x.pulses_done = x.stopping = 0
    x.direction, x.fixed, x.output_pulses = direction, 1 if output >= 0 else 0, output
    x.interpolates = 0
    c.stale = 1
    if output == 0:
        note_drive_event(x, state.D_STA | state.D_END)
        return
    if find_start_obstacle(c, x, direction):
        return
    note_drive_event(x, state.D_STA)
    x.driving, x.phase = 1, state.NO_PHASE
    load_rates(c, x)
    load_drive_speed(c, x, x.reg[state.DV])
    planner.begin_plan(
        x, c.clock, dd.ZERO, dd.ZERO, dd.minimum(planner.read_pair(x.sv), planner.read_pair(x.dv)), dd.ZERO
    )
    plan_drive(c, x)


@hot
def find_start_obstacle(c, x, direction):
    """Find what keeps a drive from starting, and note it in RR2: a limit of its direction, ALARM or EMG.

    Args:
        c: State of the chip.
        x: State of the axis.
        direction: +1 or -1.

    Returns:
        Bits of RR2; 0 if the drive can start.
    """
    cause = 0
    if x.limits_stop and is_limit_asserted(x, direction):
        cause = (state.E_HLMT_PLUS | state.F_LMT_PLUS) if direction > 0 else (state.E_HLMT_MINUS | state.F_LMT_MINUS)
    elif has_passed_soft_limit(c, x, direction):
        cause = state.E_SLMT_PLUS if direction > 0 else state.E_SLMT_MINUS
    elif x.alarm_stops and x.active_inputs & state.ALARM:
        cause = state.E_ALARM | state.F_ALARM
    elif c.emergency:
        cause = state.E_EMG | state.F_EMG
    elif (
        x.stop_causes
        & (state.E_HLMT_PLUS | state.E_SLMT_PLUS if direction > 0 else state.E_HLMT_MINUS | state.E_SLMT_MINUS)
        and c.variant == state.MCX514_TYPE
    ):
        cause = x.stop_causes & 0xFF
    x.stop_causes |= cause
    return cause


@hot
def execute_drive_command(c, x, kind):
    """Execute a drive command. It does nothing while a drive or a home search is in progress.

    Args:
        c: State of the chip.
        x: State of the axis.
        kind: RELATIVE to FIXED_MINUS, or RELATIVE_BY or ABSOLUTE_TO plus the number of an MR.
    """
    if x.driving or x.awaits_inpos or x.home_state or x.interpolates:
        return
    if x.start_hold & 1:
        x.start_hold = 1 | (kind + 1) << 1
        return
    x.absolute = 1 if kind == ABSOLUTE or kind >= ABSOLUTE_TO else 0
    x.pulse_sign = -1 if kind == COUNTER_RELATIVE else 1
    tp = x.reg[state.TP]
    if kind == FORWARD:
        begin_drive(c, x, 1, -1)
    elif kind == BACKWARD:
        begin_drive(c, x, -1, -1)
    elif kind in (FIXED_PLUS, FIXED_MINUS):
        begin_drive(c, x, 1 if kind == FIXED_PLUS else -1, tp & 0xFFFFFFFF)
    else:
        if kind >= RELATIVE_BY:
            tp = x.reg[state.MR0 + kind - (ABSOLUTE_TO if kind >= ABSOLUTE_TO else RELATIVE_BY)]
        if x.absolute:
            tp -= x.reg[state.LP]
        elif kind == COUNTER_RELATIVE:
            tp = -tp
        begin_drive(c, x, 1 if tp >= 0 else -1, abs(tp))


@hot
def set_start_hold(c, x, on):
    """Begin or end drive start hold. The end starts the drive that was commanded during the hold.

    Args:
        c: State of the chip.
        x: State of the axis.
        on: Whether the hold begins.
    """
    if on:
        x.start_hold |= 1
        return
    kind = (x.start_hold >> 1) - 1
    x.start_hold = 0
    if kind >= 0:
        execute_drive_command(c, x, kind)


@exported(None, state.STATE, state.AXIS)
def replan_drive(c, x):
    """Plan the rest of a drive again, after its drive speed or number of pulses has changed."""
    if not x.driving or x.stopping:
        return
    store_pulse_end(x)
    planner.begin_plan_at(x, c.clock - x.origin)
    plan_drive(c, x)


@hot
def change_drive_speed(c, x, value):
    """Change the drive speed. Once the automatic deceleration has begun the new speed waits for the next drive.

    Args:
        c: State of the chip.
        x: State of the axis.
        value: Value of DV or V.
    """
    x.reg[state.DV] = value
    if x.driving and not x.stopping and find_piece(x, c.clock - x.origin) < x.brake_piece:
        replan_drive(c, x)
    c.stale = 1


@hot
def step_drive_speed(c, x, direction):
    """Increase or decrease the drive speed by IV.

    Args:
        c: State of the chip.
        x: State of the axis.
        direction: +1 or -1.
    """
    change_drive_speed(c, x, least(greatest(x.reg[state.DV] + direction * x.reg[state.IV], 1), RANGE))


@hot
def change_pulse_count(c, x, value):
    """Change the number of pulses of the drive in progress.

    The drive stops at once if the new number is in the other direction, or if the drive has already made more pulses.

    Args:
        c: State of the chip.
        x: State of the axis.
        value: Value of TP or P.
    """
    x.reg[state.TP] = value
    if not (x.driving and x.fixed) or x.absolute or x.interpolates:
        return
    output = value & 0xFFFFFFFF
    if c.variant == state.MCX514_TYPE:
        output = abs(value) if (value >= 0) == (x.direction * x.pulse_sign > 0) else 0
    c.stale = 1
    if output <= x.pulses_done:
        end_drive(c, x, 0)
        return
    x.output_pulses = output
    replan_drive(c, x)


# --- the end ---


@hot
def end_drive(c, x, cause):
    """End the drive now.

    On the chips before the MCX514 the end of a drive at constant speed is also the event C-END, as the failure notice says.

    Args:
        c: State of the chip.
        x: State of the axis.
        cause: Bits of RR2.
    """
    x.stop_causes |= cause
    if x.phase == state.CONSTANT and c.variant != state.MCX514_TYPE:
        note_event(x, state.C_END)
    store_pulse_end(x)
    x.driving = x.stopping = x.interpolates = 0
    x.phase = state.NO_PHASE
    c.stale = 1
    if x.inpos_enabled and not x.active_inputs & state.INPOS:
        x.awaits_inpos = 1
    else:
        note_drive_event(x, state.D_END)


@exported(None, state.STATE, state.AXIS, "i8")
def begin_decelerating_stop(c, x, cause):
    """Begin a decelerating stop (56h, 26h, a STOP input, or a limit in that mode).

    A chip with the S-curve failure ignores it while it brakes on an S-curve, and runs away if it comes in area d. During
    interpolation the stop of one axis stops all.

    Args:
        c: State of the chip.
        x: State of the axis.
        cause: Bits of RR2.
    """
    x.stop_causes |= cause
    if x.interpolates and not x.stopping:
        x.stopping = c.stale = 1
    if not x.driving or x.stopping:
        return
    n = c.clock - x.origin
    s = find_piece(x, n)
    if s >= x.brake_piece and x.curved and c.variant != state.MCX514_TYPE and x.piece_phase[s] == state.DECELERATING:
        return
    x.stopping = 1
    store_pulse_end(x)
    planner.begin_plan_at(x, n)
    if x.piece_phase[s] == state.AREA_D:
        planner.write_pair(x.cursor[planner.CURSOR_ACCELERATION], dd.ZERO)
        planner.plan_runaway(x)
        x.fixed = 0
    else:
        load_drive_speed(c, x, x.reg[state.DV])
        planner.plan_stop(x)
    c.stale = 1


@hot
def stop_at_once(c, x, cause):
    """Stop at once (57h, 27h, ALARM, EMG, or a limit).

    Args:
        c: State of the chip.
        x: State of the axis.
        cause: Bits of RR2.
    """
    if x.driving:
        end_drive(c, x, cause)
    elif x.interpolates:
        x.stop_causes |= cause
        x.stopping, c.stale = INSTANT_STOP, 1


@hot
def apply_inputs(c, x):
    """Apply the present input levels to a drive, or to an interpolation in which the axis takes part.

    During interpolation limits count only while the running segment moves the axis.
    """
    if x.awaits_inpos and (x.active_inputs & state.INPOS or not x.inpos_enabled):
        x.awaits_inpos = 0
        note_drive_event(x, state.D_END)
    if not (x.driving or x.interpolates):
        return
    if c.emergency:
        stop_at_once(c, x, state.E_EMG | state.F_EMG)
        return
    if x.alarm_stops and x.active_inputs & state.ALARM:
        stop_at_once(c, x, state.E_ALARM | state.F_ALARM)
        return
    if (x.driving or x.moves) and _apply_limits(c, x):
        return
    for k in range(3):
        if x.stop_inputs >> k & 1 and x.active_inputs & state.STOP0 << k and not x.home_state:
            begin_decelerating_stop(c, x, state.F_STOP0 << k)
    if x.stop_inputs >> 3 and x.active_inputs & state.STOP3 and not x.home_state:
        begin_decelerating_stop(c, x, state.F_STOP3)


@hot
def _apply_limits(c, x):
    """Apply the hardware and software limits, and return whether one has stopped the drive at once."""
    if x.limits_stop and not x.home_handles_limits and is_limit_asserted(x, x.direction):
        cause = (state.E_HLMT_PLUS | state.F_LMT_PLUS) if x.direction > 0 else (state.E_HLMT_MINUS | state.F_LMT_MINUS)
        if x.limits_decelerate:
            begin_decelerating_stop(c, x, cause)
        else:
            stop_at_once(c, x, cause)
            return True
    if has_passed_soft_limit(c, x, x.direction):
        cause = state.E_SLMT_PLUS if x.direction > 0 else state.E_SLMT_MINUS
        if x.soft_instant:
            stop_at_once(c, x, cause)
            return True
        begin_decelerating_stop(c, x, cause)
    return False


# --- time ---


@hot
def begin_pulses_until(c, x, clock):
    """Begin the pulses up to a clock.

    Args:
        c: State of the chip.
        x: State of the axis.
        clock: Reference clocks since power-up.
    """
    k = count_begun_pulses(x, clock - x.origin)
    if x.fixed and k > x.output_pulses:
        k = x.output_pulses
    if k > x.pulses_done:
        add_pulses(c, x, k - x.pulses_done)


@hot
def check_drive(c, x):
    """End the drive if it is complete, else update its phase. Call it after time has passed or something has changed."""
    if not x.driving:
        return
    n = c.clock - x.origin
    if (x.fixed and x.pulses_done >= x.output_pulses) or n >= x.end_time:
        end_drive(c, x, 0)
        return
    update_phase(x, n)


@hot
def update_phase(x, n):
    """Note the events at which constant speed begins and ends.

    Args:
        x: State of the axis.
        n: Clocks since the origin of the plan.
    """
    now = find_phase(x, n)
    if now == state.AREA_D:
        now = state.CONSTANT
    if now != x.phase:
        if now == state.CONSTANT:
            note_event(x, state.C_STA)
        elif x.phase == state.CONSTANT:
            note_event(x, state.C_END)
        x.phase = now


@hot
def count_pulses_to_event(c, x):
    """Return the number of pulses until a counter reaches a value that matters to the drive."""
    pulses = x.output_pulses - x.pulses_done if x.fixed else state.NEVER
    if not x.soft_rp:
        lp = x.reg[state.LP]
        if x.direction > 0 and x.soft_plus:
            limit = x.reg[state.SP] + (1 if c.variant == state.MCX514_TYPE else 0)
            if lp < limit:
                pulses = least(pulses, limit - lp)
        elif x.direction < 0 and x.soft_minus and lp >= x.reg[state.SM]:
            pulses = least(pulses, lp - x.reg[state.SM] + 1)
    if c.variant == state.MCX514_TYPE and x.reg[state.LX] != NO_MAXIMUM:
        if not 0 <= x.reg[state.LP] <= x.reg[state.LX]:
            return 1  # the ring takes it in with the next pulse
        pulses = least(pulses, x.reg[state.LX] + 1 - x.reg[state.LP] if x.direction > 0 else x.reg[state.LP] + 1)
    return pulses


@hot
def find_next_event(c, x, pulses):
    """Find the next event of a drive.

    Args:
        c: State of the chip.
        x: State of the axis.
        pulses: Number of pulses after which other functions of the chip need an event.

    Returns:
        The clock of the event.
    """
    n = c.clock - x.origin
    s = find_piece(x, n)
    at = x.end_time
    if s + 1 < x.pieces:
        at = least(at, x.from_clock[s + 1])
    pulses = least(pulses, count_pulses_to_event(c, x))
    if pulses < state.NEVER:
        k = x.pulses_done + greatest(pulses, 1)
        if at >= state.NEVER or count_begun_pulses(x, at) >= k:
            at = least(at, find_clock_of_pulse(x, k))
    return x.origin + at if at < state.NEVER else state.NEVER
