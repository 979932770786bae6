"""HCTL-1100, compiled: the record that holds a chip, its pins, and the numbers that all of its parts share."""

from __future__ import annotations

import numpy as np

from stage.chips.hctl1100.maps import ADDRESSES, MAP, MINIMUM_T
from stage.native import hot, record

NEVER = 1 << 62
IDLE, ALIGN, CONTROL = range(3)
POSITION, PROPORTIONAL, TRAPEZOID, INTEGRAL = range(4)
CONTROL_MODES = ("position", "proportional velocity", "trapezoid", "integral velocity")
LEAST_T = tuple(MINIMUM_T[name] for name in CONTROL_MODES)

STATE = record(
    [
        (name, "i8")
        for name in (
            "clock inputs "
            "mode flag status limited stopped "  # flag: R00 without F1; status: what can be written of R07
            "period next held computing "  # sample timer
            "command fraction velocity high middle "  # commanded position and how it moves
            "zero latch preset_high preset_middle "  # actual position
            "error output last speed "  # what the control law remembers
            "port pwm drive dead moment "  # motor command
            "aligning home ring "  # align, commutator
            "seen "  # shaft
        ).split()
    ]
    + [("count", "f8"), ("rate", "f8"), ("lost", "f8"), ("reg", "i8", (ADDRESSES,))]
)
"""One chip. reg: what is stored as it was written, by address.

period, next: T of the count in progress, the clock at which it ends; held: SYNC holds the timer. computing: the clock up to which
the law of the present sample computes. command: counts, sign extended, and 256ths in `fraction`; velocity: 256ths of counts a
sample. high, middle: bytes of the command position that wait for the low one. zero: the raw count where the actual position is 0.
error, output: X(n - 1), MC(n - 1); last, speed: the raw count at the last sample, counts of the one before it.
port: R08 - 80h; pwm: R09; drive: the one given last; dead: the clock up to which PULSE is off after a reversal; moment: hundredths
of full drive times clocks, since a stage asked. aligning: samples of Align to come. home: the raw count at which the commutator's
ring is 0; ring: where it is held. The shaft is at `count + rate * (clock - seen)`; lost: counts of it that came too fast
for the filter, plus minus minus."""

LIMIT, STOP, INDEX, SYNC = (1 << k for k in range(4))
INPUTS = {"limit": LIMIT, "stop": STOP, "index": INDEX, "sync": SYNC}
PROF, INIT, SIGN, PULSE_ON, PHA, PHB, PHC, PHD = (1 << k for k in range(8))
OUTPUTS = {
    "prof": PROF, "init": INIT, "sign": SIGN, "pulse": PULSE_ON, "pha": PHA, "phb": PHB, "phc": PHC, "phd": PHD,
}  # fmt: skip

F0, F1, F2, F3, F4, F5 = (MAP.mask("R00", f"f{k}") for k in range(6))
INHIBIT, FOUR, FULL = (MAP.mask("R07", name) for name in ("inhibit", "four", "full"))
STORED = tuple(
    next((r.legal[1] if r.legal else r.mask for r in MAP.registers if r.number == k and r.access != "R"), 0)
    for k in range(ADDRESSES)
)
"""The bits that a write stores, by address."""

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs counter net command motor".split()] + [("rate", "f8")])


@hot
def signed(value, bits):
    """The low bits of a number as two's complement."""
    half = 1 << (bits - 1)
    return ((value + half) & (2 * half - 1)) - half


@hot
def control_mode(flags):
    """The control mode that the flags choose. Of several flags F0 goes before F3, F3 before F5."""
    if flags & F0:
        return TRAPEZOID
    if flags & F3:
        return PROPORTIONAL
    return INTEGRAL if flags & F5 else POSITION
