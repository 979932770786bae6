"""TMC5160, compiled: the encoder. A and B come by the pins enca and encb, or, where somebody tells where its shaft is, from that.

    edge       0    1    2    3    4    5      A leads B: X_ENC goes up
    ENCA     __|^^^^^^^^^|_________|^^^^^      rises at 1, 5, ...
    ENCB     _______|^^^^^^^^^|_________|      rises at 2, 6, ...

The shaft is at shaft + shaft_rate * (clock - seen), in edges; edge n is passed half an edge before n. An edge acts at the clock by
which it is passed. Where nothing but X_ENC follows from the edges of a stretch, they are counted at its end, all at once.
"""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import floor, greatest, hot, least

POL_A, POL_B, POL_N, IGNORE_AB, CLR_CONT, CLR_ONCE = (1 << k for k in range(6))
CLR_ENC_X, LATCH_X, DECIMAL = 1 << 8, 1 << 9, 1 << 10
N_EVENT, DEVIATION = 1, 2  # ENC_STATUS
PINS = state.ENCA | state.ENCB
MAX_EDGE = float(1 << 45)
SLOWEST = 1e-9  # edges a clock; what is slower passes no edge before it is seen anew
PERIOD = 4  # edges after which A and B are the same again


@hot
def wake(c):
    """Take the levels at power-up as they are, so that they do not count as edges."""
    c.enc_pins = _levels(c)
    c.enc_met = _met(c)


@hot
def look(c):
    """Process edges of A and B and N events, in step 1 of a clock."""
    if c.fed:
        _follow(c, _edge_at(c, c.clock))
    else:
        _pins_changed(c)
    _index(c)


@hot
def deviates(c):
    """Return whether X_ENC is too far from XACTUAL."""
    max_deviation = c.reg[state.ENC_DEVIATION]
    return max_deviation and abs(c.enc - c.x) > max_deviation


# --- a shaft ---


@hot
def set_shaft(c, count, rate):
    """Put the shaft at `count + rate * (clock - now)` from now on.

    The first place counts nothing; later the shaft passes from one place to the other in the next clock.
    """
    c.seen, c.shaft, c.shaft_rate = c.clock, count, rate
    if not c.fed:
        c.fed = 1
        _show(c, _edge_at(c, c.clock))
        c.enc_met = _met(c)


@hot
def watched(c):
    """Return whether something may follow from each edge, in its clock."""
    if not c.fed:
        return False
    mode = c.reg[state.ENCMODE]
    if mode & (CLR_CONT | CLR_ONCE) and not mode & IGNORE_AB:
        return True
    return c.reg[state.GCONF] & state.STOP_ENABLE or (c.reg[state.ENC_DEVIATION] and not c.enc_flags & DEVIATION)


@hot
def next_edge(c):
    """Return the clock at which the shaft next passes an edge, or an earlier one."""
    if _edge_at(c, c.clock + 1) != c.edge:
        return c.clock + 1
    rate = abs(c.shaft_rate)
    if rate < SLOWEST:
        return state.NEVER
    low, high = c.clock + 1, c.clock + int(1.0 / rate) + 3
    if _edge_at(c, high) == c.edge:
        return high
    while high - low > 1:
        middle = (low + high) // 2
        if _edge_at(c, middle) == c.edge:
            low = middle
        else:
            high = middle
    return high


@hot
def catch_up(c):
    """Count the edges of a past stretch in which none had to be processed in its clock."""
    edge = _edge_at(c, c.clock)
    if edge != c.edge:
        _add(c, edge - c.edge)
        _show(c, edge)
        if not c.reg[state.ENCMODE] & IGNORE_AB:  # then no condition of N has lasted
            c.enc_met = _met(c)


@hot
def _edge_at(c, clock):
    at = c.shaft + c.shaft_rate * (clock - c.seen) + 0.5
    return int(floor(least(greatest(at, -MAX_EDGE), MAX_EDGE)))


@hot
def _follow(c, edge):
    """Pass all edges up to this one, the last period of them one by one, because A and B select the N event."""
    if abs(edge - c.edge) > PERIOD:
        near = edge - PERIOD if edge > c.edge else edge + PERIOD
        _add(c, near - c.edge)
        _show(c, near)
        _index(c)
    while c.edge != edge:
        way = 1 if edge > c.edge else -1
        _add(c, way)
        _show(c, c.edge + way)
        if c.edge != edge:
            _index(c)


@hot
def _show(c, edge):
    """Set the levels at the pins from the position of the shaft."""
    c.edge = edge
    c.inputs = c.inputs & ~PINS | (state.ENCA if edge + 1 & 2 else 0) | (state.ENCB if edge & 2 else 0)
    c.enc_pins = _levels(c)


# --- A and B ---


@hot
def _levels(c):
    return (1 if c.inputs & state.ENCA else 0) | (2 if c.inputs & state.ENCB else 0)


@hot
def _pins_changed(c):
    """Count an edge at pins that are driven by hand."""
    now, was = _levels(c), c.enc_pins
    c.enc_pins = now
    changed = now ^ was
    if changed == 0 or changed == 3:
        return
    # A leads B: 00, 01, 11, 10
    up = ((now & 1) != (was >> 1 & 1)) if changed & 1 else ((now >> 1 & 1) == (was & 1))
    _add(c, 1 if up else -1)


@hot
def _add(c, edges):
    """Add edges to the counter; negative edges count down."""
    factor = c.reg[state.ENC_CONST]
    base = 10_000 if c.reg[state.ENCMODE] & DECIMAL else 65_536
    part = c.part + edges * (factor & 0xFFFF)
    c.enc, c.part = state.signed32(c.enc + edges * (state.signed32(factor) >> 16) + part // base), part % base


# --- N ---


@hot
def _met(c):
    """Return whether the condition of an N event holds."""
    mode = c.reg[state.ENCMODE]
    met = (c.inputs & state.ENCN != 0) == (mode & POL_N != 0)
    if not mode & IGNORE_AB:
        met = (
            met
            and (c.inputs & state.ENCA != 0) == (mode & POL_A != 0)
            and (c.inputs & state.ENCB != 0) == (mode & POL_B != 0)
        )
    return 1 if met else 0


@hot
def _index(c):
    mode, now = c.reg[state.ENCMODE], _met(c)
    was, done = c.enc_met & 1, c.enc_met & 2 if now else 0
    c.enc_met = done | now
    if not mode & (CLR_CONT | CLR_ONCE):
        return
    edge = mode >> 6 & 3
    happens = (now and not done) if edge == 0 else (now != was) and (edge == 3 or (edge == 1) == (now == 1))
    if not happens:
        return
    c.enc_met |= now << 1
    c.enc_latch = c.enc
    c.enc_flags |= N_EVENT
    if mode & CLR_ENC_X:
        c.enc = c.part = 0
    if mode & LATCH_X:
        c.latched = c.x
    if mode & CLR_ONCE:
        c.reg[state.ENCMODE] &= ~CLR_ONCE
