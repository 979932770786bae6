r"""Compiled ramp generator of the TMC5160: six points, see "Ramp Generator" of the data sheet.

`update_speed` computes one clock as the data sheet describes it. `plan_even_speed_change` finds how many clocks the same change of
speed applies to. Speeds q are in 2^-17 of the velocity unit.

v    VMAX  ______
/      \\        AMAX, DMAX
V1    /        \\
           |          |       A1, D1
VSTART |          | VSTOP
"""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import greatest, hot, least

SINGLE_CLOCK, UNINTERRUPTED, BRAKES_AT_END, BRAKES_AT_ANY_STEP = range(4)
"""Kinds of plans for a stretch of clocks with the same change of speed.

SINGLE_CLOCK: there is no stretch, the next clock must be processed by itself. UNINTERRUPTED: nothing ends the stretch early.
BRAKES_AT_END: the braking distance, which only grows, may end the stretch. BRAKES_AT_ANY_STEP: the braking distance may end the
stretch after each step.
"""


@hot
def halt_ramp(c):
    c.q = c.dir = c.ph = c.brk = 0
    c.zw = 512 * c.reg[state.TZEROWAIT]


@hot
def _get_v1_speed(c):
    return c.reg[state.V1] << state.SPEED_SHIFT


@hot
def _get_vmax_speed(c):
    return c.reg[state.VMAX] << state.SPEED_SHIFT


@hot
def get_vstop_speed(c):
    return greatest(c.reg[state.VSTOP], 1) << state.SPEED_SHIFT


@hot
def compute_distance_to_target(c):
    """Return XTARGET - XACTUAL, the TMC5160's distance to its target in steps of 2^MRES of 1/256 full step."""
    return state.to_signed32(c.target - c.x)


@hot
def find_requested_direction(c):
    """Return the direction in which ramp mode and target of the TMC5160 request a motion."""
    mode = c.reg[state.RAMPMODE]
    if mode == state.POSITION:
        n = compute_distance_to_target(c)
        return 1 if n > 0 else -1 if n < 0 else 0
    return 1 if mode == state.PLUS else -1 if mode == state.MINUS else 0


@hot
def is_stop_switch_active(c, direction):
    """Return whether the stop function of this direction is enabled and active."""
    if direction < 0:
        return c.reg[state.SW_MODE] & state.STOP_L and c.left
    return direction > 0 and c.reg[state.SW_MODE] & state.STOP_R and c.right


@hot
def is_stopped_by_stall(c):
    return c.events & state.EVENT_SG and c.reg[state.SW_MODE] & state.SG_STOP


@hot
def _get_acceleration(c, speed):
    return c.reg[state.A1] if c.reg[state.V1] and speed < _get_v1_speed(c) else c.reg[state.AMAX]


@hot
def _get_deceleration_to_vmax(c, speed):
    """Return the deceleration of the TMC5160's ramp towards a lower VMAX."""
    return c.reg[state.A1] if c.reg[state.V1] and speed <= _get_v1_speed(c) else c.reg[state.AMAX]


@hot
def _get_braking_deceleration(c, speed):
    return greatest(c.reg[state.D1] if c.reg[state.V1] and speed <= _get_v1_speed(c) else c.reg[state.DMAX], 1)


@hot
def _compute_next_speed_to_vmax(c, speed):
    g, corner = _get_vmax_speed(c), _get_v1_speed(c)
    if speed < g:
        top = least(g, corner) if c.reg[state.V1] and speed < corner else g
        return least(speed + _get_acceleration(c, speed), top)
    if speed > g:
        floor = greatest(g, corner) if c.reg[state.V1] and speed > corner else g
        return greatest(speed - _get_deceleration_to_vmax(c, speed), floor)
    return speed


@hot
def _get_braking_end_speed(c, speed):
    corner, z = _get_v1_speed(c), get_vstop_speed(c)
    return greatest(z, corner) if c.reg[state.V1] and speed > corner else z


@hot
def _compute_next_braking_speed(c, speed):
    return (
        speed
        if speed <= get_vstop_speed(c)
        else greatest(speed - _get_braking_deceleration(c, speed), _get_braking_end_speed(c, speed))
    )


@hot
def _divide_rounding_up(dividend, divisor):
    return (dividend + divisor - 1) // divisor


@hot
def compute_braking_distance(c, speed):
    """Return the distance in which the axis brakes from speed q to VSTOP, in 1/256 steps, rounded up."""
    z = get_vstop_speed(c)
    if speed <= z:
        return 0
    corner, w, least_w = _get_v1_speed(c), (speed >> 9) + 1, z >> 9
    max_speed = 8 + 2 * (w >> 24)
    fast, slow = greatest(c.reg[state.DMAX], 1), greatest(c.reg[state.D1], 1)
    if corner and speed > corner and corner > z:
        w1 = corner >> 9
        return (
            max_speed
            + _divide_rounding_up(w * w - w1 * w1, fast << 16)
            + _divide_rounding_up(w1 * w1 - least_w * least_w, slow << 16)
        )
    return max_speed + _divide_rounding_up(
        w * w - least_w * least_w, (slow if corner and speed <= corner else fast) << 16
    )


@hot
def _is_too_short_to_brake(c, steps, speed):
    """Return whether this distance is too short for the axis to brake from speed q to VSTOP."""
    return 256 * (steps - 1) < compute_braking_distance(c, speed)


@hot
def starts_at_next_clock(c):
    """Return whether an axis at rest begins to move at the next clock."""
    s = find_requested_direction(c)
    if s == 0 or c.reg[state.VMAX] == 0 or is_stop_switch_active(c, s) or is_stopped_by_stall(c):
        return False
    if c.reg[state.RAMPMODE] != state.POSITION:
        return c.reg[state.AMAX] != 0
    if least(c.reg[state.VSTART], c.reg[state.VMAX]) > 0:
        return True
    return _get_acceleration(c, 0) != 0


@hot
def update_speed(c):
    """Update the speed at a clock, and return whether the phase of the steps advances (tmc5160_sheet.md, steps 4 and 5)."""
    if is_stopped_by_stall(c):
        if c.q > 0:
            halt_ramp(c)
        return False
    if c.dir != 0 and is_stop_switch_active(c, c.dir):
        if not c.reg[state.SW_MODE] & state.SOFT_STOP or c.q <= get_vstop_speed(c):
            halt_ramp(c)
            return False
        c.q = _compute_next_braking_speed(c, c.q)
        return True
    mode, s = c.reg[state.RAMPMODE], find_requested_direction(c)
    began = False
    if c.dir == 0:
        if s == 0 or c.reg[state.VMAX] == 0 or is_stop_switch_active(c, s):
            return False
        began = True
    if mode == state.POSITION:
        return _update_positioning(c, s, began)
    if mode in (state.PLUS, state.MINUS):
        return _update_velocity_mode(c, s, began)
    return True


@hot
def _end_at_zero_speed(c, is_first_clock):
    """End a motion whose speed has become 0, or one that could not begin; return False: the phase does not advance."""
    if is_first_clock:
        c.dir = 0
    else:
        halt_ramp(c)
    return False


@hot
def _update_velocity_mode(c, direction, is_first_clock):
    if is_first_clock:
        c.dir, c.ph, c.q = direction, 0, 0
    a, g = c.reg[state.AMAX], _get_vmax_speed(c)
    if c.dir != direction:
        c.q = greatest(c.q - a, 0)
    elif c.q < g:
        c.q = least(c.q + a, g)
    else:
        c.q = greatest(c.q - a, g)
    return True if c.q > 0 else _end_at_zero_speed(c, is_first_clock)


@hot
def _update_positioning(c, direction, is_first_clock):
    n = abs(compute_distance_to_target(c))
    if is_first_clock:
        c.dir = direction
        c.q = least(c.reg[state.VSTART], c.reg[state.VMAX]) << state.SPEED_SHIFT
        if _is_too_short_to_brake(c, n, c.q):
            c.q = least(c.q, get_vstop_speed(c))
    if c.dir != direction:
        if c.q <= get_vstop_speed(c):
            if n > 0:
                c.events |= state.SECOND_MOVE
            halt_ramp(c)
            return False
        c.brk = 1
        c.q = _compute_next_braking_speed(c, c.q)
        return True
    q = c.q
    if not c.brk:
        new = _compute_next_speed_to_vmax(c, q)
        if new > q and _is_too_short_to_brake(c, n, new):
            new = q
        if not (
            new < q and _get_deceleration_to_vmax(c, q) >= _get_braking_deceleration(c, q)
        ) and _is_too_short_to_brake(c, n, new):
            c.brk = 1
    else:
        new = q
    if c.brk:
        new = _compute_next_braking_speed(c, q)
    c.q = new
    return True if new > 0 else _end_at_zero_speed(c, is_first_clock)


# --- many clocks ---


@hot
def plan_even_speed_change(c):
    """Plan the next clocks of a moving axis in which its speed changes evenly.

    Returns (kind of plan, see SINGLE_CLOCK; change of speed at each clock; number of clocks).
    """
    q, mode = c.q, c.reg[state.RAMPMODE]
    if is_stopped_by_stall(c):
        return SINGLE_CLOCK, 0, 0
    if is_stop_switch_active(c, c.dir):
        if not c.reg[state.SW_MODE] & state.SOFT_STOP or q <= get_vstop_speed(c):
            return SINGLE_CLOCK, 0, 0
        return _plan_braking(c, q)
    s = find_requested_direction(c)
    if mode == state.POSITION:
        if c.dir != s:
            return (SINGLE_CLOCK, 0, 0) if q <= get_vstop_speed(c) or not c.brk else _plan_braking(c, q)
        return _plan_braking(c, q) if c.brk else _plan_before_braking(c, q)
    if mode != state.PLUS and mode != state.MINUS:
        return UNINTERRUPTED, 0, state.NEVER
    a, g = c.reg[state.AMAX], _get_vmax_speed(c)
    if a == 0 or (c.dir == s and q == g):
        return UNINTERRUPTED, 0, state.NEVER
    if c.dir != s or (q > g and g == 0):
        return UNINTERRUPTED, -a, (q - 1) // a
    return (UNINTERRUPTED, a, (g - q) // a) if q < g else (UNINTERRUPTED, -a, (q - g) // a)


@hot
def _plan_braking(c, speed):
    """Plan the clocks in which the axis brakes, at the end of a positioning or at a switch."""
    if speed <= get_vstop_speed(c):
        return UNINTERRUPTED, 0, state.NEVER
    rate = _get_braking_deceleration(c, speed)
    return UNINTERRUPTED, -rate, (speed - _get_braking_end_speed(c, speed)) // rate


@hot
def _plan_before_braking(c, speed):
    """Plan the clocks of a positioning move before its braking begins."""
    g, corner = _get_vmax_speed(c), _get_v1_speed(c)
    if speed < g:
        rate = _get_acceleration(c, speed)
        if rate == 0 or _is_too_short_to_brake(
            c, abs(compute_distance_to_target(c)), _compute_next_speed_to_vmax(c, speed)
        ):
            return BRAKES_AT_END, 0, state.NEVER
        top = least(g, corner) if corner and speed < corner else g
        return BRAKES_AT_END, rate, (top - speed) // rate
    if speed > g:
        rate = _get_deceleration_to_vmax(c, speed)
        if rate == 0:
            return BRAKES_AT_END, 0, state.NEVER
        floor = greatest(g, corner) if corner and speed > corner else g
        clocks = (speed - greatest(floor, 1)) // rate
        return (UNINTERRUPTED if rate >= _get_braking_deceleration(c, speed) else BRAKES_AT_ANY_STEP), -rate, clocks
    return BRAKES_AT_END, 0, state.NEVER


@hot
def is_plan_valid(c, plan_kind, speed_change, clocks, steps_before_last_clock):
    """Return whether a plan of evenly changing speed applies to all of its clocks.

    Args:
        c: State of the chip.
        plan_kind: UNINTERRUPTED, BRAKES_AT_END or BRAKES_AT_ANY_STEP.
        speed_change: Change of the speed q in each clock.
        clocks: Number of clocks.
        steps_before_last_clock: Steps in all clocks but the last.
    """
    if plan_kind == UNINTERRUPTED:
        return True
    n = abs(compute_distance_to_target(c)) - steps_before_last_clock
    return not _is_too_short_to_brake(c, n, c.q + speed_change * (clocks if plan_kind == BRAKES_AT_END else 1))
