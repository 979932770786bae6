"""HCTL-1100, compiled: the commutator and the Align mode.

The ring counts the encoder, modulo R18; with the offset and the phase advance it gives the place in the cycle:

    PHA ####==            #    X alone, Y (=) with the next phase
    PHB     ==####==
    PHC           ==####==     ring = phases (X + Y)
"""

from __future__ import annotations

from stage.chips.hctl1100 import filter as law
from stage.chips.hctl1100 import motor
from stage.chips.hctl1100.encoder import heard, raw
from stage.chips.hctl1100.maps import MAX_ADVANCE, OFFSET, PHASE_TIMER, RING, X, Y
from stage.chips.hctl1100.state import ALIGN, CONTROL, F4, FOUR, FULL, PHA, signed
from stage.native import greatest, hot, least

ALIGN_SAMPLES = 2048  # of each of two phases
ALIGN_COMMAND = 127


@hot
def phases_of(c):
    """Three or four."""
    return 4 if c.status & FOUR else 3


@hot
def _counts(c):
    """Encoder counts of one count of the ring."""
    return 4 if c.status & FULL else 1


@hot
def position(c):
    """The ring's counter, not yet modulo the ring."""
    return c.ring if c.flag & F4 else (raw(c) - c.home) // _counts(c)


@hot
def zero(c):
    """The ring starts anew."""
    c.home, c.ring = raw(c), 0


@hot
def hold(c):
    """F4 is about to be set: the ring stays where it is."""
    c.ring = position(c)


@hot
def release(c):
    """F4 is about to be cleared: the ring goes on from where it was held."""
    c.home = raw(c) - c.ring * _counts(c)


@hot
def advance(c):
    """Counts of the ring that the shaft turns in the time of R19, at most R1F."""
    turned = heard(c) * (16.0 * (c.reg[PHASE_TIMER] + 1)) / _counts(c)
    max_advance = float(c.reg[MAX_ADVANCE])
    return int(least(greatest(turned, -max_advance), max_advance))


@hot
def phases(c):
    """The pins PHA to PHD."""
    last = phases_of(c) - 1
    if c.mode == ALIGN:
        return PHA if c.aligning > ALIGN_SAMPLES else PHA << last
    ring, slot = c.reg[RING], c.reg[X] + c.reg[Y]
    if ring == 0 or slot == 0:
        return 0
    at = (position(c) + signed(c.reg[OFFSET], 8) + advance(c)) % ring
    k = at // slot % (last + 1)
    word = PHA << k
    return word | PHA << (k + 1) % (last + 1) if at % slot >= c.reg[X] else word


@hot
def align(c):
    """R05 = 02h: the first phase, then the last, turn the rotor to where the index mark is."""
    c.mode, c.aligning = ALIGN, 2 * ALIGN_SAMPLES
    motor.command(c, ALIGN_COMMAND)


@hot
def align_sample(c):
    """One sample of Align; after the last the ring is at 0, and control begins."""
    c.aligning -= 1
    if c.aligning == 0:
        zero(c)
        c.mode = CONTROL
        law.enter(c)
        motor.command(c, 0)
