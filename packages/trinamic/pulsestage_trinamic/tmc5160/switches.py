"""Compiled reference switches of the TMC5160 with their latches."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import state
from stage.native import hot


@hot
def compute_closed_switches(c):
    """Return whether the left and the right switch are closed, from the pins and SW_MODE (polarity, swap_lr)."""
    mode = c.reg[state.SW_MODE]
    refl, refr = (1 if c.inputs & state.REFL else 0), (1 if c.inputs & state.REFR else 0)
    left, right = (refr, refl) if mode & state.SWAP else (refl, refr)
    return left ^ (1 if mode & state.POL_L else 0), right ^ (1 if mode & state.POL_R else 0)


@hot
def _latch_position(c, flag):
    c.latched = c.x
    c.events |= flag
    if c.reg[state.SW_MODE] & state.LATCH_ENCODER:
        c.enc_latch = c.enc


@hot
def process_clock(c):
    """Sample the switches at the beginning of a clock, and latch the position at their enabled edges."""
    mode = c.reg[state.SW_MODE]
    left, right = compute_closed_switches(c)
    if left != c.left:
        c.left = left
        if mode & (state.LATCH_L_ON if left else state.LATCH_L_OFF):
            _latch_position(c, state.LATCHED_L)
    if right != c.right:
        c.right = right
        if mode & (state.LATCH_R_ON if right else state.LATCH_R_OFF):
            _latch_position(c, state.LATCHED_R)
