"""NOVA chips, compiled: the drive of one axis: its start, its pulses, what stops it, and when something happens next."""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion import planner
from stage.chips.nova.motion.counters import OFF, beyond, count, hardware_limit
from stage.chips.nova.motion.profile import clock_of, phase_at, piece_at, reached
from stage.chips.nova.motion.pulse_output import keep_pulse
from stage.chips.nova.motion.rates import RANGE, take_rates, take_speed
from stage.native import exported, greatest, hot, least

RELATIVE, COUNTER_RELATIVE, ABSOLUTE, FORWARD, BACKWARD = range(5)
FIXED_PLUS, FIXED_MINUS = 5, 6
RELATIVE_BY, ABSOLUTE_TO = 7, 11  # + m: by MRm, to MRm
AT_ONCE = 2  # of `slow`


@hot
def note(x, event):
    """An event has happened: RR1, and what the synchronous actions look at."""
    x.factors |= event
    x.fired |= event


@hot
def note_drive(x, event):
    """A drive begins or ends. Those of a home search are its steps: for the host it is one drive."""
    if not x.home:
        note(x, event)


@hot
def keep_data(c, address, value):
    """Store a write to WR6 or WR7.

    Args:
        c: State of the chip.
        address: 6 or 7.
        value: Datum.
    """
    c.unused = 1
    if address == 6:
        c.low = value
    else:
        c.high = value


# --- start and plan ---


@hot
def goal_of(x, pulses):
    """The speed to which a drive of so many pulses accelerates: DV, or less to prevent a triangle."""
    goal = planner.pair(x.dv)
    if x.prevents and not x.curved and dd.less(planner.pair(x.sv), goal):  # a speed above the cap is kept
        top, now = planner.cap(x, pulses), planner.pair(x.cursor[planner.SPEED])
        goal = dd.least(goal, now if dd.less(top, now) else top)
    return goal


@hot
def plan(c, x):
    """Plan the rest of the drive from the cursor on."""
    take_speed(c, x, x.reg[state.DV])
    if not x.fixed:
        planner.for_ever(x, planner.pair(x.dv))
        return
    goal = goal_of(x, x.output)
    if not x.manual:
        planner.to_the_end(x, dd.from_integer(x.output - x.reg[state.AO]), goal)
    elif x.done < x.reg[state.DP]:
        planner.for_ever(x, goal)
        if x.reg[state.DP] < x.output:
            planner.brake_at(x, x.reg[state.DP])
    else:
        planner.brake(x)


@exported(None, state.STATE, state.AXIS, "i8", "i8")
def launch(c, x, direction, output):
    """Begin a drive at the present clock.

    Args:
        c: State of the chip.
        x: State of the axis.
        direction: +1 or -1.
        output: Pulses; below 0: without an end.
    """
    x.causes &= 0xFF
    x.done = x.slow = 0
    x.way, x.fixed, x.output = direction, 1 if output >= 0 else 0, output
    x.interpolates = 0
    c.stale = 1
    if output == 0:
        note_drive(x, state.D_STA | state.D_END)
        return
    if blocked(c, x, direction):
        return
    note_drive(x, state.D_STA)
    x.driving, x.phase = 1, state.NO_PHASE
    take_rates(c, x)
    take_speed(c, x, x.reg[state.DV])
    planner.begin(x, c.clock, dd.ZERO, dd.ZERO, dd.least(planner.pair(x.sv), planner.pair(x.dv)), dd.ZERO)
    plan(c, x)


@hot
def blocked(c, x, direction):
    """Note in RR2 what keeps a drive from starting: a limit of its direction, ALARM or EMG.

    Args:
        c: State of the chip.
        x: State of the axis.
        direction: +1 or -1.

    Returns:
        Whether there is such a cause.
    """
    cause = 0
    if x.limits and hardware_limit(x, direction):
        cause = (state.E_HLMT_PLUS | state.F_LMT_PLUS) if direction > 0 else (state.E_HLMT_MINUS | state.F_LMT_MINUS)
    elif beyond(c, x, direction):
        cause = state.E_SLMT_PLUS if direction > 0 else state.E_SLMT_MINUS
    elif x.alarm_stops and x.active & state.ALARM:
        cause = state.E_ALARM | state.F_ALARM
    elif c.emergency:
        cause = state.E_EMG | state.F_EMG
    elif (
        x.causes & (state.E_HLMT_PLUS | state.E_SLMT_PLUS if direction > 0 else state.E_HLMT_MINUS | state.E_SLMT_MINUS)
        and c.variant == state.MCX514_TYPE
    ):
        cause = x.causes & 0xFF
    x.causes |= cause
    return cause


@hot
def start(c, x, kind):
    """Execute a drive command. Nothing happens while a drive or a home search is in progress.

    Args:
        c: State of the chip.
        x: State of the axis.
        kind: RELATIVE ... FIXED_MINUS, or a drive by a MR.
    """
    if x.driving or x.waiting or x.home or x.interpolates:
        return
    if x.held & 1:
        x.held = 1 | (kind + 1) << 1
        return
    x.absolute = 1 if kind == ABSOLUTE or kind >= ABSOLUTE_TO else 0
    x.sense = -1 if kind == COUNTER_RELATIVE else 1
    tp = x.reg[state.TP]
    if kind == FORWARD:
        launch(c, x, 1, -1)
    elif kind == BACKWARD:
        launch(c, x, -1, -1)
    elif kind in (FIXED_PLUS, FIXED_MINUS):
        launch(c, x, 1 if kind == FIXED_PLUS else -1, tp & 0xFFFFFFFF)
    else:
        if kind >= RELATIVE_BY:
            tp = x.reg[state.MR0 + kind - (ABSOLUTE_TO if kind >= ABSOLUTE_TO else RELATIVE_BY)]
        if x.absolute:
            tp -= x.reg[state.LP]
        elif kind == COUNTER_RELATIVE:
            tp = -tp
        launch(c, x, 1 if tp >= 0 else -1, abs(tp))


@hot
def hold(c, x, on):
    """Begin or end drive start hold; its end begins what was commanded during it.

    Args:
        c: State of the chip.
        x: State of the axis.
        on: Whether it begins.
    """
    if on:
        x.held |= 1
        return
    kind = (x.held >> 1) - 1
    x.held = 0
    if kind >= 0:
        start(c, x, kind)


@exported(None, state.STATE, state.AXIS)
def replan(c, x):
    """Plan the rest of a drive again: its drive speed or number of pulses has changed."""
    if not x.driving or x.slow:
        return
    keep_pulse(x)
    planner.from_here(x, c.clock - x.origin)
    plan(c, x)


@hot
def change_speed(c, x, value):
    """Change the drive speed. After the automatic deceleration has begun it waits for the next drive.

    Args:
        c: State of the chip.
        x: State of the axis.
        value: DV, or V.
    """
    x.reg[state.DV] = value
    if x.driving and not x.slow and piece_at(x, c.clock - x.origin) < x.brake:
        replan(c, x)
    c.stale = 1


@hot
def step_speed(c, x, direction):
    """Increase or decrease the drive speed by IV.

    Args:
        c: State of the chip.
        x: State of the axis.
        direction: +1 or -1.
    """
    change_speed(c, x, least(greatest(x.reg[state.DV] + direction * x.reg[state.IV], 1), RANGE))


@hot
def change_output(c, x, value):
    """Change the number of pulses while driving.

    Args:
        c: State of the chip.
        x: State of the axis.
        value: TP. The drive stops at once if it asks for the other direction, or for a pulse that has passed.
    """
    x.reg[state.TP] = value
    if not (x.driving and x.fixed) or x.absolute or x.interpolates:
        return
    output = value & 0xFFFFFFFF
    if c.variant == state.MCX514_TYPE:
        output = abs(value) if (value >= 0) == (x.way * x.sense > 0) else 0
    c.stale = 1
    if output <= x.done:
        end(c, x, 0)
        return
    x.output = output
    replan(c, x)


# --- the end ---


@hot
def end(c, x, cause):
    """End the drive now.

    Before the MCX514 a constant speed ends with it (C-END), as the failure notice says.

    Args:
        c: State of the chip.
        x: State of the axis.
        cause: Bits of RR2.
    """
    x.causes |= cause
    if x.phase == state.CONSTANT and c.variant != state.MCX514_TYPE:
        note(x, state.C_END)
    keep_pulse(x)
    x.driving = x.slow = x.interpolates = 0
    x.phase = state.NO_PHASE
    c.stale = 1
    if x.inpos_waits and not x.active & state.INPOS:
        x.waiting = 1
    else:
        note_drive(x, state.D_END)


@exported(None, state.STATE, state.AXIS, "i8")
def request_stop(c, x, cause):
    """Begin a decelerating stop: 56h, 26h, a STOP signal, a limit in that mode.

    The chips of the erratum ignore it while they brake on an S-curve anyway, and in its area d they run away. An axis that
    interpolates stops the interpolation.

    Args:
        c: State of the chip.
        x: State of the axis.
        cause: Bits of RR2.
    """
    x.causes |= cause
    if x.interpolates and not x.slow:
        x.slow = c.stale = 1
    if not x.driving or x.slow:
        return
    n = c.clock - x.origin
    s = piece_at(x, n)
    if s >= x.brake and x.curved and c.variant != state.MCX514_TYPE and x.kind[s] == state.DECELERATING:
        return
    x.slow = 1
    keep_pulse(x)
    planner.from_here(x, n)
    if x.kind[s] == state.AREA_D:
        planner.put(x.cursor[planner.RATE], dd.ZERO)
        planner.run_away(x)
        x.fixed = 0
    else:
        take_speed(c, x, x.reg[state.DV])
        planner.slow_down(x)
    c.stale = 1


@hot
def stop(c, x, cause):
    """Stop at once: 57h, 27h, ALARM, EMG, a limit.

    Args:
        c: State of the chip.
        x: State of the axis.
        cause: Bits of RR2.
    """
    if x.driving:
        end(c, x, cause)
    elif x.interpolates:
        x.causes |= cause
        x.slow, c.stale = AT_ONCE, 1


@hot
def obey_inputs(c, x):
    """Apply the present levels to a drive, or to an interpolation in which the axis takes part; limits only if that moves it."""
    if x.waiting and (x.active & state.INPOS or not x.inpos_waits):
        x.waiting = 0
        note_drive(x, state.D_END)
    if not (x.driving or x.interpolates):
        return
    if c.emergency:
        stop(c, x, state.E_EMG | state.F_EMG)
        return
    if x.alarm_stops and x.active & state.ALARM:
        stop(c, x, state.E_ALARM | state.F_ALARM)
        return
    if (x.driving or x.moves) and _obey_limits(c, x):
        return
    for k in range(3):
        if x.stops >> k & 1 and x.active & state.STOP0 << k and not x.home:
            request_stop(c, x, state.F_STOP0 << k)
    if x.stops >> 3 and x.active & state.STOP3 and not x.home:
        request_stop(c, x, state.F_STOP3)


@hot
def _obey_limits(c, x):
    """Returns whether a limit has stopped the drive at once."""
    if x.limits and not x.seeks and hardware_limit(x, x.way):
        cause = (state.E_HLMT_PLUS | state.F_LMT_PLUS) if x.way > 0 else (state.E_HLMT_MINUS | state.F_LMT_MINUS)
        if x.limit_slow:
            request_stop(c, x, cause)
        else:
            stop(c, x, cause)
            return True
    if beyond(c, x, x.way):
        cause = state.E_SLMT_PLUS if x.way > 0 else state.E_SLMT_MINUS
        if x.soft_instant:
            stop(c, x, cause)
            return True
        request_stop(c, x, cause)
    return False


# --- time ---


@hot
def move(c, x, clock):
    """Let the pulses up to a clock begin.

    Args:
        c: State of the chip.
        x: State of the axis.
        clock: Reference clocks since power-up.
    """
    k = reached(x, clock - x.origin)
    if x.fixed and k > x.output:
        k = x.output
    if k > x.done:
        count(c, x, k - x.done)


@hot
def look(c, x):
    """After time has passed or something has changed: the end of the drive, and the phase that it is in."""
    if not x.driving:
        return
    n = c.clock - x.origin
    if (x.fixed and x.done >= x.output) or n >= x.end:
        end(c, x, 0)
        return
    watch_phase(x, n)


@hot
def watch_phase(x, n):
    """Note where constant speed begins and ends."""
    now = phase_at(x, n)
    if now == state.AREA_D:
        now = state.CONSTANT
    if now != x.phase:
        if now == state.CONSTANT:
            note(x, state.C_STA)
        elif x.phase == state.CONSTANT:
            note(x, state.C_END)
        x.phase = now


@hot
def pulses_ahead(c, x):
    """Pulses until a counter reaches something."""
    pulses = x.output - x.done if x.fixed else state.NEVER
    if not x.soft_rp:
        lp = x.reg[state.LP]
        if x.way > 0 and x.soft_plus:
            limit = x.reg[state.SP] + (1 if c.variant == state.MCX514_TYPE else 0)
            if lp < limit:
                pulses = least(pulses, limit - lp)
        elif x.way < 0 and x.soft_minus and lp >= x.reg[state.SM]:
            pulses = least(pulses, lp - x.reg[state.SM] + 1)
    if c.variant == state.MCX514_TYPE and x.reg[state.LX] != OFF:
        if not 0 <= x.reg[state.LP] <= x.reg[state.LX]:
            return 1  # the ring takes it in with the next pulse
        pulses = least(pulses, x.reg[state.LX] + 1 - x.reg[state.LP] if x.way > 0 else x.reg[state.LP] + 1)
    return pulses


@hot
def next_event(c, x, pulses):
    """Find the next event of a drive.

    Args:
        c: State of the chip.
        x: State of the axis.
        pulses: Pulses until other functions need the chip to stop.

    Returns:
        Its clock.
    """
    n = c.clock - x.origin
    s = piece_at(x, n)
    at = x.end
    if s + 1 < x.pieces:
        at = least(at, x.from_clock[s + 1])
    pulses = least(pulses, pulses_ahead(c, x))
    if pulses < state.NEVER:
        k = x.done + greatest(pulses, 1)
        if at >= state.NEVER or reached(x, at) >= k:
            at = least(at, clock_of(x, k))
    return x.origin + at if at < state.NEVER else state.NEVER
