"""PCL-240 family, compiled: step 3 of a tick. The speed to be reached, and the tick of the next speed step.

A linear ramp takes a step every R4 or R5 clocks; one down is over, and FDOWN falls, R5 - 1 clocks after its last step. An S-curve
ramp of K steps with curved ends of S steps each takes its k-th step at t(k) clocks after its start, and is over at T:

    rate sqrt(k S)                    k <= S            from rest: the acceleration grows with time
    rate (S + k) / 2                  S < k <= K - S    linear
    T - rate sqrt((K - k) S)          K - S < k         the first part, mirrored;  T = (K + 2 S) rate / 2

in exact integers, for 2 S and 2 T are whole. All this is the normative model's section 7.
"""

from __future__ import annotations

import math

from stage.chips.pcl240 import state
from stage.native import greatest, hot

NEVER = 1 << 40


@hot
def selected_speed(c):
    """The speed register that the operating mode selects, or the corrected FH in its place."""
    if c.select == c.top_select and c.select:
        return c.top
    if c.select == state.FH1:
        return c.reg[2]
    if c.select == state.FH2:
        return c.reg[3]
    return c.reg[1]


@hot
def slowed(c):
    """SD enabled and the SD switch of the direction asserted."""
    return c.sd_enable and c.seen & (state.SD_MINUS if c.minus else state.SD_PLUS)


@hot
def watching(c):
    """The automatic ramp-down point is in force, in place of R0 < R6."""
    return c.automatic and c.preset and c.ramps and not c.manual


@hot
def margin(c):
    """Pulses by which R0 is above the automatic ramp-down point; its time has come at 0."""
    offset = c.reg[6]
    if offset & c.top_bit:
        offset -= 2 * c.top_bit
    return c.reg[0] - c.risen - offset


@hot
def goal_speed(c):
    """Return the speed to which a ramp leads: FL or the selected register."""
    if c.decel or c.down or c.homing or slowed(c):
        return c.reg[1]
    if c.preset and c.reg[0] < c.reg[6] and not watching(c):
        return c.reg[1]
    return selected_speed(c)


@hot
def _root(x):
    """Floor of the square root, x < 2^62."""
    r = int(math.sqrt(float(x)))
    while r * r > x:
        r -= 1
    while (r + 1) * (r + 1) <= x:
        r += 1
    return r


@hot
def correct_top(c):
    """FH correction at the start of a preset run (data sheet MS, 3-4): a distance too short to reach FH takes a lower one.

    The automatic ramp-down decelerates on R4, so R4 stands for R5, and cancels: with s = R14 + R15, m = max(R14, R15)
        pulses for a trapezoid       (R2^2 - R1^2) R4 / (8192 R7)    or  (R1 + R2) (R2 - R1 + s) R4 / (16384 R7)
        pulses for a linear part     (R1 + m) (s + 2 m) R4 / (8192 R7)
        revised R2                   sqrt(8192 R0 R7 / R4 + R1^2)    or  (-s + sqrt((s - 2 R1)^2 + 65536 R0 R7 / R4)) / 2
    """
    low, high, rate = c.reg[1], selected_speed(c), c.reg[4]
    if (
        not (c.s_curves and watching(c) and (c.select == state.FH1 or c.select == state.FH2) and rate)
        or c.reg[state.R14] & state.UNCORRECTED
    ):
        return
    product = c.reg[0] * c.multiplier
    a, b = c.reg[state.R14] & state.SPAN, c.reg[state.R15] & state.SPAN
    s, m = a + b, greatest(a, b)
    linear = c.reg[state.R14] & state.LINEAR or a == 0 or b == 0 or 2 * m >= high - low
    if product * 16384 > ((high + low) * (high - low) * 2 if linear else (low + high) * (high - low + s)) * rate:
        return
    if linear or product * 8192 <= (low + m) * (s + 2 * m) * rate:
        c.top = _root(8192 * product // rate + low * low)
    else:
        c.top = (_root((s - 2 * low) ** 2 + 65536 * product // rate) - s) // 2
    c.top_select = c.select


@hot
def _curve_time(c, k):
    """First whole clock at or after t(k); rate^2 K S stays below 2^60."""
    double = c.twice_span
    if 2 * k <= double:
        square = c.rate * c.rate * k * double  # of t(k), twice
        return _root((square + 1) // 2 - 1) + 1
    if 2 * k <= 2 * c.steps - double:
        return (c.rate * (double + 2 * k) + 3) // 4
    total = (c.steps + double) * c.rate  # twice T
    return (total - _root(2 * c.rate * c.rate * (c.steps - k) * double) + 1) // 2


@hot
def _start_ramp(c, goal, direction):
    c.ramp, c.timer, c.goal = direction, 0, goal
    c.curved = 1 if c.s_curves and not c.reg[state.R14] & state.LINEAR else 0
    if c.curved:
        c.steps = abs(goal - c.speed)
        c.step = 0
        c.rate_place = 4 if direction > 0 or c.down else 5
        c.rate, c.twice_span = c.reg[c.rate_place], _twice_span(c)
        next_step(c)


@hot
def _twice_span(c):
    """2 S by R14, R15 as they are now."""
    span = c.reg[state.R14 if c.ramp > 0 else state.R15] & state.SPAN
    return c.steps if span == 0 or 2 * span > c.steps else 2 * span


@hot
def linear_rate(c, direction):
    """R4, or R5; after the automatic ramp-down point R4 both ways."""
    return c.reg[4] if direction > 0 or c.down else c.reg[5]


@hot
def next_step(c):
    """When the S-curve takes its next step: upwards the k-th at t(k), downwards a clock after t(k - 1)."""
    c.next = NEVER if c.rate < 2 else _step_time(c, c.step + 1)


@hot
def _step_time(c, k):
    if c.ramp > 0:
        return _curve_time(c, k)
    return 1 + (_curve_time(c, k - 1) if k > 1 else 0)


@hot
def took_step(c):
    """The S-curve has made a step. Registers that were revised since the last act from here on: the count of the ramp's clocks
    becomes the one at which the ramp, had it run with the new values all the time, makes this very step."""
    c.step += 1
    double = _twice_span(c)
    if c.reg[c.rate_place] != c.rate or double != c.twice_span:
        c.rate, c.twice_span = c.reg[c.rate_place], double
        if c.rate:
            c.timer = _step_time(c, c.step)
    if c.step < c.steps:
        next_step(c)


@hot
def _tail(c):
    """Clocks for which FDOWN stays up after the last step of a ramp down, which ends as it would take another step: Tsd."""
    if not c.curved:
        return linear_rate(c, -1) - 1
    return ((c.steps + c.twice_span) * c.rate + 1) // 2 - c.timer if c.rate else 0


@hot
def until_step(c, goal):
    """Ticks for which step 3 surely changes nothing, plus one."""
    speed = c.speed
    if not c.ramps:
        return 1 if speed != selected_speed(c) or c.rising else NEVER
    if c.rising != (1 if goal > speed else 0) or (c.decel and speed <= c.reg[1]):
        return 1
    if not c.down and watching(c) and margin(c) <= 0:
        return 1
    if speed == goal:
        return c.fall - c.clock if c.clock < c.fall else NEVER
    if c.ramp != (1 if speed < goal else -1):
        return 1
    if c.curved:
        return greatest(1, c.next - c.timer) if c.goal == goal else 1
    rate = linear_rate(c, c.ramp)
    return greatest(1, rate - c.timer) if rate >= 2 else NEVER


@hot
def step_speed(c):
    """Step 3 of one tick."""
    c.rising = 0
    if not c.ramps:
        c.speed = selected_speed(c)
        c.ramp = c.fall = 0
        return
    if not c.down and watching(c) and margin(c) <= 0:
        c.down = 1
    goal = goal_speed(c)
    if c.speed == goal:
        c.ramp = 0
    else:
        direction = 1 if c.speed < goal else -1
        c.rising = 1 if direction > 0 else 0
        c.fall = 0
        first = c.ramp != direction or (c.curved and c.goal != goal)
        if first:
            _start_ramp(c, goal, direction)
        c.timer += 1
        if c.curved:
            if c.timer >= c.next:
                c.speed += direction
                took_step(c)
        else:
            rate = linear_rate(c, direction)
            if rate >= 2 and (c.timer >= rate or (first and direction < 0)):
                c.speed += direction
                c.timer = 0
        if direction < 0 and c.speed == goal:
            c.fall = c.clock + _tail(c)
    if c.decel and c.speed <= c.reg[1]:
        state.stop(c)
