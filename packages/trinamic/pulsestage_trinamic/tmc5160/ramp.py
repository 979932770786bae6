r"""TMC5160, compiled: the six-point ramp. One clock as the page has it (`speed`), and many at once where nothing changes (`plan`).

v    VMAX  ______
/      \\        AMAX, DMAX
V1    /        \\
           |          |       A1, D1
VSTART |          | VSTOP
"""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import greatest, hot, least

CANNOT, CALM, FALLING, SLOWING = range(4)
"""What `plan` found: a clock at a time; no test; a test that turns true but once; one that may turn true after each step."""


@hot
def halt(c):
    c.q = c.dir = c.ph = c.brk = 0
    c.zw = 512 * c.reg[state.TZEROWAIT]


@hot
def _v1(c):
    return c.reg[state.V1] << state.UNIT


@hot
def _goal(c):
    return c.reg[state.VMAX] << state.UNIT


@hot
def low(c):
    return greatest(c.reg[state.VSTOP], 1) << state.UNIT


@hot
def away(c):
    """Return XTARGET - XACTUAL."""
    return state.signed32(c.target - c.x)


@hot
def wanted(c):
    """Return the direction in which mode and target request a motion."""
    mode = c.reg[state.RAMPMODE]
    if mode == state.POSITION:
        n = away(c)
        return 1 if n > 0 else -1 if n < 0 else 0
    return 1 if mode == state.PLUS else -1 if mode == state.MINUS else 0


@hot
def stopped(c, way):
    """Return whether the stop function of this direction is enabled and active."""
    if way < 0:
        return c.reg[state.SW_MODE] & state.STOP_L and c.left
    return way > 0 and c.reg[state.SW_MODE] & state.STOP_R and c.right


@hot
def stalled(c):
    return c.events & state.EVENT_SG and c.reg[state.SW_MODE] & state.SG_STOP


@hot
def _rate_up(c, q):
    return c.reg[state.A1] if c.reg[state.V1] and q < _v1(c) else c.reg[state.AMAX]


@hot
def _rate_down(c, q):
    """Return the deceleration towards a lower VMAX."""
    return c.reg[state.A1] if c.reg[state.V1] and q <= _v1(c) else c.reg[state.AMAX]


@hot
def _rate_brake(c, q):
    return greatest(c.reg[state.D1] if c.reg[state.V1] and q <= _v1(c) else c.reg[state.DMAX], 1)


@hot
def _toward(c, q):
    g, corner = _goal(c), _v1(c)
    if q < g:
        top = least(g, corner) if c.reg[state.V1] and q < corner else g
        return least(q + _rate_up(c, q), top)
    if q > g:
        floor = greatest(g, corner) if c.reg[state.V1] and q > corner else g
        return greatest(q - _rate_down(c, q), floor)
    return q


@hot
def _brake_floor(c, q):
    corner, z = _v1(c), low(c)
    return greatest(z, corner) if c.reg[state.V1] and q > corner else z


@hot
def _brake(c, q):
    return q if q <= low(c) else greatest(q - _rate_brake(c, q), _brake_floor(c, q))


@hot
def _over(a, b):
    return (a + b - 1) // b


@hot
def need(c, q):
    """Return the braking distance in 1/256 step, rounded up."""
    z = low(c)
    if q <= z:
        return 0
    corner, w, least_w = _v1(c), (q >> 9) + 1, z >> 9
    max_speed = 8 + 2 * (w >> 24)
    fast, slow = greatest(c.reg[state.DMAX], 1), greatest(c.reg[state.D1], 1)
    if corner and q > corner and corner > z:
        w1 = corner >> 9
        return max_speed + _over(w * w - w1 * w1, fast << 16) + _over(w1 * w1 - least_w * least_w, slow << 16)
    return max_speed + _over(w * w - least_w * least_w, (slow if corner and q <= corner else fast) << 16)


@hot
def _short(c, n, q):
    """Return whether a distance of n steps is too short to brake from this speed."""
    return 256 * (n - 1) < need(c, q)


@hot
def starts(c):
    """Return whether the axis stands still and moves at the next clock."""
    s = wanted(c)
    if s == 0 or c.reg[state.VMAX] == 0 or stopped(c, s) or stalled(c):
        return False
    if c.reg[state.RAMPMODE] != state.POSITION:
        return c.reg[state.AMAX] != 0
    if least(c.reg[state.VSTART], c.reg[state.VMAX]) > 0:
        return True
    return _rate_up(c, 0) != 0


@hot
def speed(c):
    """Compute steps 4 and 5 of a clock, and return whether the phase moves on."""
    if stalled(c):
        if c.q > 0:
            halt(c)
        return False
    if c.dir != 0 and stopped(c, c.dir):
        if not c.reg[state.SW_MODE] & state.SOFT_STOP or c.q <= low(c):
            halt(c)
            return False
        c.q = _brake(c, c.q)
        return True
    mode, s = c.reg[state.RAMPMODE], wanted(c)
    began = False
    if c.dir == 0:
        if s == 0 or c.reg[state.VMAX] == 0 or stopped(c, s):
            return False
        began = True
    if mode == state.POSITION:
        return _positioning(c, s, began)
    if mode in (state.PLUS, state.MINUS):
        return _running(c, s, began)
    return True


@hot
def _rest(c, began):
    """Process a speed of 0."""
    if began:
        c.dir = 0
    else:
        halt(c)
    return False


@hot
def _running(c, s, began):
    if began:
        c.dir, c.ph, c.q = s, 0, 0
    a, g = c.reg[state.AMAX], _goal(c)
    if c.dir != s:
        c.q = greatest(c.q - a, 0)
    elif c.q < g:
        c.q = least(c.q + a, g)
    else:
        c.q = greatest(c.q - a, g)
    return True if c.q > 0 else _rest(c, began)


@hot
def _positioning(c, s, began):
    n = abs(away(c))
    if began:
        c.dir = s
        c.q = least(c.reg[state.VSTART], c.reg[state.VMAX]) << state.UNIT
        if _short(c, n, c.q):
            c.q = least(c.q, low(c))
    if c.dir != s:
        if c.q <= low(c):
            if n > 0:
                c.events |= state.SECOND_MOVE
            halt(c)
            return False
        c.brk = 1
        c.q = _brake(c, c.q)
        return True
    q = c.q
    if not c.brk:
        new = _toward(c, q)
        if new > q and _short(c, n, new):
            new = q
        if not (new < q and _rate_down(c, q) >= _rate_brake(c, q)) and _short(c, n, new):
            c.brk = 1
    else:
        new = q
    if c.brk:
        new = _brake(c, q)
    c.q = new
    return True if new > 0 else _rest(c, began)


# --- many clocks ---


@hot
def plan(c):
    """Return (test, delta, clocks) of a stretch in which the speed changes evenly, of an axis that moves; see CANNOT."""
    q, mode = c.q, c.reg[state.RAMPMODE]
    if stalled(c):
        return CANNOT, 0, 0
    if stopped(c, c.dir):
        if not c.reg[state.SW_MODE] & state.SOFT_STOP or q <= low(c):
            return CANNOT, 0, 0
        return _braking(c, q)
    s = wanted(c)
    if mode == state.POSITION:
        if c.dir != s:
            return (CANNOT, 0, 0) if q <= low(c) or not c.brk else _braking(c, q)
        return _braking(c, q) if c.brk else _driving(c, q)
    if mode != state.PLUS and mode != state.MINUS:
        return CALM, 0, state.NEVER
    a, g = c.reg[state.AMAX], _goal(c)
    if a == 0 or (c.dir == s and q == g):
        return CALM, 0, state.NEVER
    if c.dir != s or (q > g and g == 0):
        return CALM, -a, (q - 1) // a
    return (CALM, a, (g - q) // a) if q < g else (CALM, -a, (q - g) // a)


@hot
def _braking(c, q):
    """Plan the braking at the end of a positioning."""
    if q <= low(c):
        return CALM, 0, state.NEVER
    rate = _rate_brake(c, q)
    return CALM, -rate, (q - _brake_floor(c, q)) // rate


@hot
def _driving(c, q):
    """Plan a positioning before its braking."""
    g, corner = _goal(c), _v1(c)
    if q < g:
        rate = _rate_up(c, q)
        if rate == 0 or _short(c, abs(away(c)), _toward(c, q)):
            return FALLING, 0, state.NEVER
        top = least(g, corner) if corner and q < corner else g
        return FALLING, rate, (top - q) // rate
    if q > g:
        rate = _rate_down(c, q)
        if rate == 0:
            return FALLING, 0, state.NEVER
        floor = greatest(g, corner) if corner and q > corner else g
        clocks = (q - greatest(floor, 1)) // rate
        return (CALM if rate >= _rate_brake(c, q) else SLOWING), -rate, clocks
    return FALLING, 0, state.NEVER


@hot
def holds(c, test, delta, m, done):
    """Return whether the test of `plan` holds for all of m clocks; done: the steps of the first m - 1 of them."""
    if test == CALM:
        return True
    n = abs(away(c)) - done
    return not _short(c, n, c.q + delta * m if test == FALLING else c.q + delta)
