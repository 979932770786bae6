"""TMC5160, compiled: reference switches with their latches, and the encoder's pins."""

from __future__ import annotations

from pulsestage_tmc5160.state import (
    ENC_CONST,
    ENCA,
    ENCB,
    ENCMODE,
    ENCN,
    LATCH_ENCODER,
    LATCH_L_OFF,
    LATCH_L_ON,
    LATCH_R_OFF,
    LATCH_R_ON,
    LATCHED_L,
    LATCHED_R,
    POL_L,
    POL_R,
    REFL,
    REFR,
    SW_MODE,
    SWAP,
    signed32,
)
from stage.native import hot

POL_A, POL_B, POL_N, IGNORE_AB, CLR_CONT, CLR_ONCE = (1 << k for k in range(6))
CLR_ENC_X, LATCH_X, DECIMAL = 1 << 8, 1 << 9, 1 << 10


@hot
def levels(c):
    """(left, right) as the pins and SW_MODE make them."""
    mode = c.reg[SW_MODE]
    refl, refr = (1 if c.inputs & REFL else 0), (1 if c.inputs & REFR else 0)
    left, right = (refr, refl) if mode & SWAP else (refl, refr)
    return left ^ (1 if mode & POL_L else 0), right ^ (1 if mode & POL_R else 0)


@hot
def wake(c):
    """At power-up: what the encoder shows is no edge."""
    c.enc_pins = (1 if c.inputs & ENCA else 0) | (2 if c.inputs & ENCB else 0)
    c.enc_met = met(c)


@hot
def _latch(c, flag):
    c.latched = c.x
    c.events |= flag
    if c.reg[SW_MODE] & LATCH_ENCODER:
        c.enc_latch = c.enc


@hot
def look(c):
    """Step 1 of a clock: the inputs as they are now, their edges."""
    mode = c.reg[SW_MODE]
    left, right = levels(c)
    if left != c.left:
        c.left = left
        if mode & (LATCH_L_ON if left else LATCH_L_OFF):
            _latch(c, LATCHED_L)
    if right != c.right:
        c.right = right
        if mode & (LATCH_R_ON if right else LATCH_R_OFF):
            _latch(c, LATCHED_R)
    _count(c)
    _index(c)


@hot
def _count(c):
    """Edges of A and B."""
    now = (1 if c.inputs & ENCA else 0) | (2 if c.inputs & ENCB else 0)
    was, c.enc_pins = c.enc_pins, now
    changed = now ^ was
    if changed == 0 or changed == 3:
        return
    # A leads B: 00, 01, 11, 10
    up = ((now & 1) != (was >> 1 & 1)) if changed & 1 else ((now >> 1 & 1) == (was & 1))
    base = 10_000 if c.reg[ENCMODE] & DECIMAL else 65_536
    factor = c.reg[ENC_CONST]
    whole = signed32(factor) >> 16
    more = whole * base + (factor & 0xFFFF)
    total = c.enc * base + c.part + (more if up else -more)
    c.enc, c.part = signed32(total // base), total % base


@hot
def met(c):
    """The condition of an N event."""
    mode = c.reg[ENCMODE]
    met = (c.inputs & ENCN != 0) == (mode & POL_N != 0)
    if not mode & IGNORE_AB:
        met = met and (c.inputs & ENCA != 0) == (mode & POL_A != 0) and (c.inputs & ENCB != 0) == (mode & POL_B != 0)
    return 1 if met else 0


@hot
def _index(c):
    mode, now = c.reg[ENCMODE], met(c)
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
    c.enc_flags |= 1
    if mode & CLR_ENC_X:
        c.enc = c.part = 0
    if mode & LATCH_X:
        c.latched = c.x
    if mode & CLR_ONCE:
        c.reg[ENCMODE] &= ~CLR_ONCE
