"""NOVA chips, compiled: the drive of one axis: its start, its pulses, what stops it, and when something happens next."""

from __future__ import annotations

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.planner import (
    RATE,
    SPEED,
    begin,
    brake,
    brake_at,
    cap,
    for_ever,
    from_here,
    pair,
    put,
    run_away,
    slow_down,
    to_the_end,
)  # fmt: skip
from stage.chips.nova.motion.profile import HZ, acceleration_at, clock_of, phase_at, piece_at, reached, speed_at
from stage.chips.nova.state import (
    AC,
    ALARM,
    AO,
    AREA_D,
    AXIS,
    C_END,
    C_STA,
    CONSTANT,
    D_END,
    D_STA,
    DC,
    DECELERATING,
    DJ,
    DP,
    DV,
    E_ALARM,
    E_EMG,
    E_HLMT_MINUS,
    E_HLMT_PLUS,
    E_SLMT_MINUS,
    E_SLMT_PLUS,
    F_ALARM,
    F_EMG,
    F_LMT_MINUS,
    F_LMT_PLUS,
    F_STOP0,
    HV,
    INPOS,
    IV,
    JK,
    LMT_MINUS,
    LMT_PLUS,
    LP,
    LX,
    MCX514_TYPE,
    MR0,
    NEVER,
    NO_PHASE,
    RP,
    RX,
    SM,
    SP,
    STATE,
    STOP0,
    SV,
    TP,
    K,
    L,
    R,
)
from stage.native import exported, greatest, hot, least

RANGE = 8_000_000
OFF = 0xFFFFFFFF
RELATIVE, COUNTER_RELATIVE, ABSOLUTE, FORWARD, BACKWARD = range(5)
FIXED_PLUS, FIXED_MINUS = 5, 6
RELATIVE_BY, ABSOLUTE_TO = 7, 11  # + m: by MRm, to MRm
PULSE = 1  # RR3 of the older chips
MAIN, AT_ONCE = 2, 2  # of `interpolates`; of `slow`


@hot
def runs(x):
    """The profile of the axis is in force: it drives, or is the main axis of an interpolation."""
    return x.driving or x.interpolates == MAIN


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
    """A write to WR6 or WR7."""
    c.unused = 1
    if address == 6:
        c.low = value
    else:
        c.high = value


# --- parameters ---


@hot
def _ratio(a, b):
    return dd.div(dd.whole(a), dd.whole(b))


@hot
def speed(c, x, value):
    """A speed parameter in pulses per clock. What is out of range counts as the range's end: two pulses never begin at once."""
    if c.variant == MCX514_TYPE:
        return _ratio(least(greatest(value, 1), RANGE), HZ)
    fastest = RANGE // 1000
    return dd.div(dd.whole(least(greatest(value, 1), fastest) * RANGE), dd.whole(HZ * _range(x)))


@hot
def _range(x):
    """R in its range: multiples 1 to 500."""
    return least(greatest(x.reg[R], RANGE // 500), RANGE)


@hot
def _rate(c, x, value):
    """An acceleration parameter in pulses per clock^2."""
    if c.variant == MCX514_TYPE:
        return dd.div(_ratio(greatest(value, 1), HZ), dd.whole(HZ))
    return dd.div(dd.div(dd.whole(125 * greatest(value, 1) * RANGE), dd.whole(HZ * _range(x))), dd.whole(HZ))


@hot
def _jerk(c, x, value):
    """A jerk parameter in pulses per clock^3."""
    if c.variant == MCX514_TYPE:
        return dd.div(dd.div(_ratio(greatest(value, 1), HZ), dd.whole(HZ)), dd.whole(HZ))
    up = dd.div(dd.whole(62_500_000 * RANGE), dd.whole(greatest(value, 1) * _range(x)))
    return dd.div(dd.div(dd.div(up, dd.whole(HZ)), dd.whole(HZ)), dd.whole(HZ))


@hot
def speed_reading(c, x):
    """CV: the current speed in the unit of the speed parameters."""
    if not runs(x):
        return 0
    v = speed_at(x, c.clock - x.origin) * HZ
    if c.variant != MCX514_TYPE:
        v *= _range(x) / RANGE
    return int(v + 1e-6)


@hot
def rate_reading(c, x):
    """CA: the current acceleration or deceleration in the unit of its parameter; without a sign."""
    if not runs(x):
        return 0
    a = abs(acceleration_at(x, c.clock - x.origin)) * HZ * HZ
    if c.variant != MCX514_TYPE:
        a *= _range(x) / RANGE / 125.0
    return int(a + 1e-6)


@hot
def take_speed(c, x, value):
    """The drive speed as it is now; HV in the slow steps of a home search."""
    put(x.dv, speed(c, x, x.reg[HV] if x.creeps else value))


@hot
def take_rates(c, x):
    """Initial speed, accelerations and jerks, at the start of a drive."""
    put(x.sv, speed(c, x, x.reg[SV]))
    put(x.up, _rate(c, x, x.reg[AC]))
    put(x.down, _rate(c, x, x.reg[DC] if x.asymmetric else x.reg[AC]))
    own = x.reg[JK] if c.variant == MCX514_TYPE else x.reg[K]
    other = x.reg[DJ] if c.variant == MCX514_TYPE else x.reg[L] if c.has_l else own
    put(x.up_jerk, _jerk(c, x, own))
    put(x.down_jerk, _jerk(c, x, other if x.asymmetric else own))
    x.curved = x.s_curve
    put(x.finest, _rate(c, x, 1) if c.errata and x.fixed else dd.ZERO)


# --- counters ---


@hot
def _ring(value, most):
    """A counter that counts up to `most` and then from 0 on; 32 bits with a sign where there is no ring."""
    if most != OFF:
        return value % (most + 1)
    return (value + (1 << 31) & 0xFFFFFFFF) - (1 << 31)


@hot
def count(c, x, n):
    """`n` pulses have begun."""
    x.done += n
    x.total += n
    c.total += n
    x.net += x.way * n
    x.compared |= PULSE
    x.reg[LP] = _ring(x.reg[LP] + x.way * n, x.reg[LX] if c.variant == MCX514_TYPE else OFF)


@hot
def count_encoder(c, x, n):
    """The encoder has moved by `n` counts."""
    x.reg[RP] = _ring(x.reg[RP] + n, x.reg[RX] if c.variant == MCX514_TYPE else OFF)


@hot
def limited(x):
    """The counter that the software limits look at."""
    return x.reg[RP] if x.soft_rp else x.reg[LP]


@hot
def beyond(c, x, way):
    """The software limit of a direction is enabled and passed: MCX514 LP > SP, LP < SM; before it LP >= C+, LP < C-."""
    if way > 0:
        return x.soft_plus and (limited(x) > x.reg[SP] if c.variant == MCX514_TYPE else limited(x) >= x.reg[SP])
    return x.soft_minus and limited(x) < x.reg[SM]


@hot
def hardware_limit(x, way):
    """The limit switch of a direction is asserted."""
    plus = LMT_MINUS if x.swaps else LMT_PLUS
    minus = LMT_PLUS if x.swaps else LMT_MINUS
    return x.level & (plus if way > 0 else minus)


# --- start and plan ---


@hot
def goal_of(x, pulses):
    """The speed to which a drive of so many pulses accelerates: DV, or less to prevent a triangle."""
    goal = pair(x.dv)
    if x.prevents and not x.curved and dd.less(pair(x.sv), goal):  # a speed above the cap is kept
        top, now = cap(x, pulses), pair(x.cursor[SPEED])
        goal = dd.least(goal, now if dd.less(top, now) else top)
    return goal


@hot
def plan(c, x):
    """Plan the rest of the drive from the cursor on."""
    take_speed(c, x, x.reg[DV])
    if not x.fixed:
        for_ever(x, pair(x.dv))
        return
    goal = goal_of(x, x.output)
    if not x.manual:
        to_the_end(x, dd.whole(x.output - x.reg[AO]), goal)
    elif x.done < x.reg[DP]:
        for_ever(x, goal)
        if x.reg[DP] < x.output:
            brake_at(x, x.reg[DP])
    else:
        brake(x)


@exported(None, STATE, AXIS, "i8", "i8")
def launch(c, x, way, output):
    """Begin a drive of `output` pulses, or without an end where it is negative, at the present clock."""
    x.causes &= 0xFF
    x.done = x.slow = 0
    x.way, x.fixed, x.output = way, 1 if output >= 0 else 0, output
    x.interpolates = 0
    c.stale = 1
    if output == 0:
        note_drive(x, D_STA | D_END)
        return
    if blocked(c, x, way):
        return
    note_drive(x, D_STA)
    x.driving, x.phase = 1, NO_PHASE
    take_rates(c, x)
    take_speed(c, x, x.reg[DV])
    begin(x, c.clock, dd.ZERO, dd.ZERO, dd.least(pair(x.sv), pair(x.dv)), dd.ZERO)
    plan(c, x)


@hot
def blocked(c, x, way):
    """A limit of the direction, ALARM or EMG keeps a drive from starting; RR2 says which."""
    cause = 0
    if x.limits and hardware_limit(x, way):
        cause = (E_HLMT_PLUS | F_LMT_PLUS) if way > 0 else (E_HLMT_MINUS | F_LMT_MINUS)
    elif beyond(c, x, way):
        cause = E_SLMT_PLUS if way > 0 else E_SLMT_MINUS
    elif x.alarm_stops and x.level & ALARM:
        cause = E_ALARM | F_ALARM
    elif c.emg:
        cause = E_EMG | F_EMG
    elif (
        x.causes & (E_HLMT_PLUS | E_SLMT_PLUS if way > 0 else E_HLMT_MINUS | E_SLMT_MINUS) and c.variant == MCX514_TYPE
    ):
        cause = x.causes & 0xFF
    x.causes |= cause
    return cause


@hot
def start(c, x, kind):
    """A drive command: RELATIVE ... FIXED_MINUS, or by a MR. Nothing happens while a drive or a home search is in progress."""
    if x.driving or x.waiting or x.home or x.interpolates:
        return
    if x.held & 1:
        x.held = 1 | (kind + 1) << 1
        return
    x.absolute = 1 if kind == ABSOLUTE or kind >= ABSOLUTE_TO else 0
    x.sense = -1 if kind == COUNTER_RELATIVE else 1
    tp = x.reg[TP]
    if kind == FORWARD:
        launch(c, x, 1, -1)
    elif kind == BACKWARD:
        launch(c, x, -1, -1)
    elif kind in (FIXED_PLUS, FIXED_MINUS):
        launch(c, x, 1 if kind == FIXED_PLUS else -1, tp & 0xFFFFFFFF)
    else:
        if kind >= RELATIVE_BY:
            tp = x.reg[MR0 + kind - (ABSOLUTE_TO if kind >= ABSOLUTE_TO else RELATIVE_BY)]
        if x.absolute:
            tp -= x.reg[LP]
        elif kind == COUNTER_RELATIVE:
            tp = -tp
        launch(c, x, 1 if tp >= 0 else -1, abs(tp))


@hot
def hold(c, x, on):
    """Drive start hold, and its release: what has been commanded since begins now."""
    if on:
        x.held |= 1
        return
    kind = (x.held >> 1) - 1
    x.held = 0
    if kind >= 0:
        start(c, x, kind)


@exported(None, STATE, AXIS)
def replan(c, x):
    """The drive speed or the number of pulses has changed while driving."""
    if not x.driving or x.slow:
        return
    from_here(x, c.clock - x.origin)
    plan(c, x)


@hot
def change_speed(c, x, value):
    """A new drive speed; after the automatic deceleration has begun it waits for the next drive."""
    x.reg[DV] = value
    if x.driving and not x.slow and piece_at(x, c.clock - x.origin) < x.brake:
        replan(c, x)
    c.stale = 1


@hot
def step_speed(c, x, way):
    """Speed increase, decrease: the drive speed by IV."""
    change_speed(c, x, least(greatest(x.reg[DV] + way * x.reg[IV], 1), RANGE))


@hot
def change_output(c, x, value):
    """A new number of pulses while driving: not the other way, and not one that has been passed, which stops at once."""
    x.reg[TP] = value
    if not (x.driving and x.fixed) or x.absolute or x.interpolates:
        return
    output = value & 0xFFFFFFFF
    if c.variant == MCX514_TYPE:
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
    """The drive ends now. Cause: bits of RR2. Before the MCX514 constant speed ends with it (C-END): the failure notice says so."""
    x.causes |= cause
    if x.phase == CONSTANT and c.variant != MCX514_TYPE:
        note(x, C_END)
    x.driving = x.slow = x.interpolates = 0
    x.phase = NO_PHASE
    c.stale = 1
    if x.inpos_waits and not x.level & INPOS:
        x.waiting = 1
    else:
        note_drive(x, D_END)


@exported(None, STATE, AXIS, "i8")
def request_stop(c, x, cause):
    """A decelerating stop: 56h, 26h, a STOP signal, a limit in that mode. The chips of the erratum take no notice while they
    brake on an S-curve anyway, and in its area d they run away. An axis that interpolates asks the interpolation to stop."""
    x.causes |= cause
    if x.interpolates and not x.slow:
        x.slow = c.stale = 1
    if not x.driving or x.slow:
        return
    n = c.clock - x.origin
    s = piece_at(x, n)
    if s >= x.brake and x.curved and c.variant != MCX514_TYPE and x.kind[s] == DECELERATING:
        return
    x.slow = 1
    from_here(x, n)
    if x.kind[s] == AREA_D:
        put(x.cursor[RATE], dd.ZERO)
        run_away(x)
        x.fixed = 0
    else:
        take_speed(c, x, x.reg[DV])
        slow_down(x)
    c.stale = 1


@hot
def stop(c, x, cause):
    """An instant stop: 57h, 27h, ALARM, EMG, a limit. Cause: bits of RR2."""
    if x.driving:
        end(c, x, cause)
    elif x.interpolates:
        x.causes |= cause
        x.slow, c.stale = AT_ONCE, 1


@hot
def obey_inputs(c, x):
    """What the present levels do to a drive, or to an interpolation in which the axis takes part; limits if that moves it."""
    if x.waiting and (x.level & INPOS or not x.inpos_waits):
        x.waiting = 0
        note_drive(x, D_END)
    if not (x.driving or x.interpolates):
        return
    if c.emg:
        stop(c, x, E_EMG | F_EMG)
        return
    if x.alarm_stops and x.level & ALARM:
        stop(c, x, E_ALARM | F_ALARM)
        return
    if (x.driving or x.moves) and _obey_limits(c, x):
        return
    for k in range(3):
        if x.stops >> k & 1 and x.level & STOP0 << k and not x.home:
            request_stop(c, x, F_STOP0 << k)


@hot
def _obey_limits(c, x):
    """Returns whether a limit has stopped the drive at once."""
    if x.limits and not x.seeks and hardware_limit(x, x.way):
        cause = (E_HLMT_PLUS | F_LMT_PLUS) if x.way > 0 else (E_HLMT_MINUS | F_LMT_MINUS)
        if x.limit_slow:
            request_stop(c, x, cause)
        else:
            stop(c, x, cause)
            return True
    if beyond(c, x, x.way):
        cause = E_SLMT_PLUS if x.way > 0 else E_SLMT_MINUS
        if x.soft_instant:
            stop(c, x, cause)
            return True
        request_stop(c, x, cause)
    return False


# --- time ---


@hot
def move(c, x, clock):
    """Let the pulses up to `clock` begin."""
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
    if now == AREA_D:
        now = CONSTANT
    if now != x.phase:
        if now == CONSTANT:
            note(x, C_STA)
        elif x.phase == CONSTANT:
            note(x, C_END)
        x.phase = now


@hot
def pulses_ahead(c, x):
    """Pulses until a counter reaches something."""
    far = x.output - x.done if x.fixed else NEVER
    if not x.soft_rp:
        lp = x.reg[LP]
        if x.way > 0 and x.soft_plus:
            limit = x.reg[SP] + (1 if c.variant == MCX514_TYPE else 0)
            if lp < limit:
                far = least(far, limit - lp)
        elif x.way < 0 and x.soft_minus and lp >= x.reg[SM]:
            far = least(far, lp - x.reg[SM] + 1)
    if c.variant == MCX514_TYPE and x.reg[LX] != OFF:
        if not 0 <= x.reg[LP] <= x.reg[LX]:
            return 1  # the ring takes it in with the next pulse
        far = least(far, x.reg[LX] + 1 - x.reg[LP] if x.way > 0 else x.reg[LP] + 1)
    return far


@hot
def next_event(c, x, far):
    """The clock of the next event of a drive; `far`: pulses until others care."""
    n = c.clock - x.origin
    s = piece_at(x, n)
    at = x.end
    if s + 1 < x.pieces:
        at = least(at, x.from_clock[s + 1])
    far = least(far, pulses_ahead(c, x))
    if far < NEVER:
        k = x.done + greatest(far, 1)
        if at >= NEVER or reached(x, at) >= k:
            at = least(at, clock_of(x, k))
    return x.origin + at if at < NEVER else NEVER
