"""Compiled encoder interface of the TMC5160.

The levels of A and B are those of the pins enca and encb, or follow from the position of a shaft that the stage sets.

    edge       0    1    2    3    4    5      A leads B: X_ENC goes up
    ENCA     __|^^^^^^^^^|_________|^^^^^      rises at 1, 5, ...
    ENCB     _______|^^^^^^^^^|_________|      rises at 2, 6, ...

The position of the shaft is shaft + shaft_rate * (clock - seen), in edges; it passes edge n half an edge before n. An edge acts
at the first clock at which it is passed. If nothing but X_ENC depends on the edges of several clocks, they are counted all at
once at the last of these clocks.
"""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import floor, greatest, hot, least

POL_A, POL_B, POL_N, IGNORE_AB, CLR_CONT, CLR_ONCE = (1 << k for k in range(6))
CLR_ENC_X, LATCH_X, DECIMAL = 1 << 8, 1 << 9, 1 << 10
N_EVENT, DEVIATION = 1, 2  # ENC_STATUS
PINS = state.ENCA | state.ENCB
MAX_EDGE = float(1 << 45)
MIN_EDGE_RATE = 1e-9  # edges a clock; a slower shaft passes no edge before its position is set again
EDGES_PER_PERIOD = 4  # edges after which A and B are the same again


@hot
def initialize_levels(c):
    """Store the levels of the encoder inputs at power-up, so that they do not count as edges."""
    c.enc_pins = _read_pin_levels(c)
    c.enc_met = _is_index_condition_met(c)


@hot
def process_clock(c):
    """Count the edges of the encoder inputs A and B and process N events at the beginning of a clock."""
    if c.fed:
        _pass_edges_up_to(c, _find_edge_at(c, c.clock))
    else:
        _count_pin_change(c)
    _process_index(c)


@hot
def is_deviation_exceeded(c):
    """Return whether X_ENC differs from XACTUAL by more than ENC_DEVIATION."""
    max_deviation = c.reg[state.ENC_DEVIATION]
    return max_deviation and abs(c.enc - c.x) > max_deviation


# --- a shaft ---


@hot
def set_shaft(c, count, rate):
    """Set the position of the shaft to `count + rate * (clock - now)` edges from now on.

    The first call counts no edges. After a later call, the shaft passes all edges up to its new position in the next clock.
    """
    c.seen, c.shaft, c.shaft_rate = c.clock, count, rate
    if not c.fed:
        c.fed = 1
        _set_pins_at_edge(c, _find_edge_at(c, c.clock))
        c.enc_met = _is_index_condition_met(c)


@hot
def needs_each_encoder_edge(c):
    """Return whether each edge must be processed in its own clock, because more than X_ENC depends on it."""
    if not c.fed:
        return False
    mode = c.reg[state.ENCMODE]
    if mode & (CLR_CONT | CLR_ONCE) and not mode & IGNORE_AB:
        return True
    return c.reg[state.GCONF] & state.STOP_ENABLE or (c.reg[state.ENC_DEVIATION] and not c.enc_flags & DEVIATION)


@hot
def find_next_edge(c):
    """Return the clock at which the shaft next passes an encoder edge, or an earlier clock."""
    if _find_edge_at(c, c.clock + 1) != c.edge:
        return c.clock + 1
    rate = abs(c.shaft_rate)
    if rate < MIN_EDGE_RATE:
        return state.NEVER
    low, high = c.clock + 1, c.clock + int(1.0 / rate) + 3
    if _find_edge_at(c, high) == c.edge:
        return high
    while high - low > 1:
        middle = (low + high) // 2
        if _find_edge_at(c, middle) == c.edge:
            low = middle
        else:
            high = middle
    return high


@hot
def count_passed_edges(c):
    """Count the encoder edges of past clocks, none of which had to be processed in its own clock."""
    edge = _find_edge_at(c, c.clock)
    if edge != c.edge:
        _count_edges(c, edge - c.edge)
        _set_pins_at_edge(c, edge)
        if not c.reg[state.ENCMODE] & IGNORE_AB:  # then no condition of N has lasted
            c.enc_met = _is_index_condition_met(c)


@hot
def _find_edge_at(c, clock):
    at = c.shaft + c.shaft_rate * (clock - c.seen) + 0.5
    return int(floor(least(greatest(at, -MAX_EDGE), MAX_EDGE)))


@hot
def _pass_edges_up_to(c, edge):
    """Pass all edges up to this one: the last period one by one, because the levels of A and B select the N event."""
    if abs(edge - c.edge) > EDGES_PER_PERIOD:
        near = edge - EDGES_PER_PERIOD if edge > c.edge else edge + EDGES_PER_PERIOD
        _count_edges(c, near - c.edge)
        _set_pins_at_edge(c, near)
        _process_index(c)
    while c.edge != edge:
        direction = 1 if edge > c.edge else -1
        _count_edges(c, direction)
        _set_pins_at_edge(c, c.edge + direction)
        if c.edge != edge:
            _process_index(c)


@hot
def _set_pins_at_edge(c, edge):
    """Set the levels of A and B to those between this edge and the next."""
    c.edge = edge
    c.inputs = c.inputs & ~PINS | (state.ENCA if edge + 1 & 2 else 0) | (state.ENCB if edge & 2 else 0)
    c.enc_pins = _read_pin_levels(c)


# --- A and B ---


@hot
def _read_pin_levels(c):
    return (1 if c.inputs & state.ENCA else 0) | (2 if c.inputs & state.ENCB else 0)


@hot
def _count_pin_change(c):
    """Count an edge of the encoder inputs when pins are set directly, without a shaft."""
    now, was = _read_pin_levels(c), c.enc_pins
    c.enc_pins = now
    changed = now ^ was
    if changed == 0 or changed == 3:
        return
    # A leads B: 00, 01, 11, 10
    up = ((now & 1) != (was >> 1 & 1)) if changed & 1 else ((now >> 1 & 1) == (was & 1))
    _count_edges(c, 1 if up else -1)


@hot
def _count_edges(c, edges):
    """Add edges of the encoder to its counter X_ENC; negative edges count down."""
    factor = c.reg[state.ENC_CONST]
    base = 10_000 if c.reg[state.ENCMODE] & DECIMAL else 65_536
    part = c.part + edges * (factor & 0xFFFF)
    c.enc, c.part = state.to_signed32(c.enc + edges * (state.to_signed32(factor) >> 16) + part // base), part % base


# --- N ---


@hot
def _is_index_condition_met(c):
    """Return whether the levels of N, A and B fulfill the condition of ENCMODE for an N event."""
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
def _process_index(c):
    """Latch or clear positions as ENCMODE demands if an N event (index pulse) happens now."""
    mode, now = c.reg[state.ENCMODE], _is_index_condition_met(c)
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
