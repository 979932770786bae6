"""TMC5160, compiled: reference switches with their latches."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160.state import (
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
)
from stage.native import hot


@hot
def levels(c):
    """(left, right) as the pins and SW_MODE make them."""
    mode = c.reg[SW_MODE]
    refl, refr = (1 if c.inputs & REFL else 0), (1 if c.inputs & REFR else 0)
    left, right = (refr, refl) if mode & SWAP else (refl, refr)
    return left ^ (1 if mode & POL_L else 0), right ^ (1 if mode & POL_R else 0)


@hot
def _latch(c, flag):
    c.latched = c.x
    c.events |= flag
    if c.reg[SW_MODE] & LATCH_ENCODER:
        c.enc_latch = c.enc


@hot
def look(c):
    """In step 1 of a clock: the switches as they are now, their edges."""
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
