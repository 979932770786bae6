"""HCTL-1100, compiled: the record that holds a chip, its pins, and the numbers that all of its parts share."""

from __future__ import annotations

import numpy as np

from stage.chips.hctl1100 import maps
from stage.native import hot, record

NEVER = 1 << 62
IDLE, ALIGN, CONTROL = range(3)
POSITION, PROPORTIONAL, TRAPEZOID, INTEGRAL = range(4)
CONTROL_MODES = ("position", "proportional velocity", "trapezoid", "integral velocity")
MIN_T = tuple(maps.MINIMUM_T[name] for name in CONTROL_MODES)

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("inputs", "i8"),  # INPUTS
        ("mode", "i8"),  # IDLE, ALIGN, CONTROL
        ("flag", "i8"),  # R00 without F1
        ("status", "i8"),  # what can be written of R07
        ("limited", "i8"),  # LIMIT has triggered
        ("stopped", "i8"),  # STOP has triggered
        # sample timer
        ("period", "i8"),  # T of the count in progress
        ("next", "i8"),  # the clock at which it ends
        ("held", "i8"),  # SYNC holds it
        ("computing", "i8"),  # the clock up to which the law of this sample computes
        ("given", "i8"),  # the clock at which the sample ends whose command was written last
        ("gave", "i8"),  # and where, see GIVERS: bits
        # command position and how it moves
        ("command", "i8"),  # counts, sign extended
        ("fraction", "i8"),  # 256ths of counts
        ("velocity", "i8"),  # 256ths of counts a sample
        ("high", "i8"),  # R0C, waits for R0E
        ("middle", "i8"),  # R0D, waits for R0E
        # actual position
        ("zero", "i8"),  # the raw count where it is 0
        ("latch", "i8"),  # counts, as the read of R14 found them
        ("preset_high", "i8"),  # R15, waits for R17
        ("preset_middle", "i8"),  # R16, waits for R17
        # what the control law remembers
        ("error", "i8"),  # X(n - 1), counts
        ("output", "i8"),  # MC(n - 1)
        ("last", "i8"),  # the raw count at the last sample
        ("speed", "i8"),  # counts of the sample before it
        # motor command
        ("port", "i8"),  # R08 - 80h
        ("pwm", "i8"),  # R09
        ("drive", "i8"),  # the one given last
        ("dead", "i8"),  # the clock up to which PULSE is off after a reversal
        ("moment", "i8"),  # hundredths of full drive times clocks, since the last drive_input
        # align, commutator
        ("aligning", "i8"),  # samples of Align to come
        ("home", "i8"),  # the raw count at which the ring is 0
        ("ring", "i8"),  # where the ring is held
        # shaft: at count + rate * (clock - seen)
        ("seen", "i8"),  # clock
        ("count", "f8"),  # counts of the encoder
        ("rate", "f8"),  # counts a clock
        ("lost", "f8"),  # counts that came too fast for the filter, plus minus minus
        ("reg", "i8", (maps.ADDRESSES,)),  # what is stored as it was written, by address
    ]
)
"""One chip."""

LIMIT, STOP, INDEX, SYNC = (1 << k for k in range(4))
INPUTS = {"limit": LIMIT, "stop": STOP, "index": INDEX, "sync": SYNC}
GIVERS = (maps.COMMAND_LOW, maps.PROPORTIONAL_LOW, maps.PROPORTIONAL_HIGH, maps.INTEGRAL_VELOCITY)
"""Addresses whose write is a new command; a bit of `gave` each."""
PROF, INIT, SIGN, PULSE_ON, PHA, PHB, PHC, PHD = (1 << k for k in range(8))
OUTPUTS = {
    "prof": PROF, "init": INIT, "sign": SIGN, "pulse": PULSE_ON, "pha": PHA, "phb": PHB, "phc": PHC, "phd": PHD,
}  # fmt: skip

F0, F1, F2, F3, F4, F5 = (maps.MAP.mask("R00", f"f{k}") for k in range(6))
INHIBIT, FOUR, FULL = (maps.MAP.mask("R07", name) for name in ("inhibit", "four", "full"))
STORED = tuple(
    next((r.legal[1] if r.legal else r.mask for r in maps.MAP.registers if r.number == k and r.access != "R"), 0)
    for k in range(maps.ADDRESSES)
)
"""The bits that a write stores, by address."""

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record(
    [
        ("clock", "i8"),  # from here on
        ("inputs", "i8"),  # INPUTS
        ("outputs", "i8"),  # OUTPUTS
        ("counter", "i8"),  # actual position, counts
        ("net", "i8"),  # the raw count that the command position stands for
        ("command", "i8"),  # command position, counts
        ("motor", "i8"),  # motor command, -128 to 127
        ("rate", "f8"),  # commanded velocity, counts a clock
    ]
)
"""A chip from one of its changes on, for recordings."""


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
