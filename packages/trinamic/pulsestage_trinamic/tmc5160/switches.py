"""TMC5160, compiled: reference switches with their latches."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import hot


@hot
def levels(c):
    """Return the levels (left, right) that follow from the pins and the polarity bits of SW_MODE."""
    mode = c.reg[state.SW_MODE]
    refl, refr = (1 if c.inputs & state.REFL else 0), (1 if c.inputs & state.REFR else 0)
    left, right = (refr, refl) if mode & state.SWAP else (refl, refr)
    return left ^ (1 if mode & state.POL_L else 0), right ^ (1 if mode & state.POL_R else 0)


@hot
def _latch(c, flag):
    c.latched = c.x
    c.events |= flag
    if c.reg[state.SW_MODE] & state.LATCH_ENCODER:
        c.enc_latch = c.enc


@hot
def look(c):
    """Sample the switches and process their edges, in step 1 of a clock."""
    mode = c.reg[state.SW_MODE]
    left, right = levels(c)
    if left != c.left:
        c.left = left
        if mode & (state.LATCH_L_ON if left else state.LATCH_L_OFF):
            _latch(c, state.LATCHED_L)
    if right != c.right:
        c.right = right
        if mode & (state.LATCH_R_ON if right else state.LATCH_R_OFF):
            _latch(c, state.LATCHED_R)
