"""State of the HCTL-1100 as a record for compiled code, its pins, and the numbers that all of its modules share."""

from __future__ import annotations

import numpy as np

from stage.chips.hctl1100 import maps
from stage.native import hot, record

NEVER = 1 << 62
IDLE, ALIGN, CONTROL = range(3)
POSITION, PROPORTIONAL, TRAPEZOID, INTEGRAL = range(4)
CONTROL_MODES = ("position", "proportional velocity", "trapezoid", "integral velocity")
MIN_TIMER_VALUES = tuple(maps.MINIMUM_T[name] for name in CONTROL_MODES)

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("inputs", "i8"),  # INPUTS
        ("mode", "i8"),  # IDLE, ALIGN, CONTROL
        ("flag_bits", "i8"),  # R00 without F1
        ("status", "i8"),  # the writable bits of R07
        ("limit_triggered", "i8"),  # LIMIT has triggered
        ("stop_triggered", "i8"),  # STOP has triggered
        # sample timer
        ("period", "i8"),  # T of the period in progress
        ("sample_end", "i8"),  # the clock at which the period ends
        ("timer_stopped", "i8"),  # SYNC holds it at 0
        ("computing_until", "i8"),  # the clock up to which the chip computes the control law of this sample
        ("command_sample_end", "i8"),  # the `sample_end` of the sample in which a command was written last
        ("command_writes", "i8"),  # the addresses written in it, bits as in COMMAND_ADDRESSES
        # command position and how it moves
        ("command", "i8"),  # counts, sign extended
        ("fraction", "i8"),  # 256ths of counts
        ("velocity", "i8"),  # 256ths of counts a sample
        ("command_high", "i8"),  # R0C, waits for R0E
        ("command_middle", "i8"),  # R0D, waits for R0E
        # actual position
        ("position_origin", "i8"),  # the raw count at which it is 0
        ("position_latch", "i8"),  # counts, latched by the last read of R14
        ("preset_high", "i8"),  # R15, waits for R17
        ("preset_middle", "i8"),  # R16, waits for R17
        # what the control law remembers
        ("error", "i8"),  # X(n - 1), counts
        ("output", "i8"),  # MC(n - 1)
        ("last_count", "i8"),  # the raw count at the last sample
        ("actual_velocity", "i8"),  # counts during the sample before
        # motor command
        ("port", "i8"),  # R08 - 80h
        ("pwm", "i8"),  # R09
        ("motor_command", "i8"),  # the last command
        ("pulse_off_until", "i8"),  # the clock up to which PULSE is off after a reversal
        ("drive_integral", "i8"),  # hundredths of full drive times clocks, since the last call of `drive_input`
        # align, commutator
        ("aligning", "i8"),  # samples of Align that remain
        ("ring_origin", "i8"),  # the raw count at which the ring is 0
        ("ring_position", "i8"),  # count at which F4 holds the ring
        # shaft: at shaft_count + shaft_rate * (clock - shaft_clock)
        ("shaft_clock", "i8"),  # clock
        ("shaft_count", "f8"),  # counts of the encoder
        ("shaft_rate", "f8"),  # counts a clock
        ("missed_counts", "f8"),  # net number of counts that came too fast for the filter
        ("reg", "i8", (maps.ADDRESS_COUNT,)),  # what is stored as it was written, by address
    ]
)
"""State of one HCTL-1100."""

LIMIT, STOP, INDEX, SYNC = (1 << k for k in range(4))
INPUTS = {"limit": LIMIT, "stop": STOP, "index": INDEX, "sync": SYNC}
COMMAND_ADDRESSES = (maps.COMMAND_LOW, maps.PROPORTIONAL_LOW, maps.PROPORTIONAL_HIGH, maps.INTEGRAL_VELOCITY)
"""Addresses whose write is a new command; each has a bit in `command_writes`."""
PROF, INIT, SIGN, PULSE_ON, PHA, PHB, PHC, PHD = (1 << k for k in range(8))
OUTPUTS = {
    "prof": PROF, "init": INIT, "sign": SIGN, "pulse": PULSE_ON, "pha": PHA, "phb": PHB, "phc": PHC, "phd": PHD,
}  # fmt: skip

F0, F1, F2, F3, F4, F5 = maps.MAP.masks("R00", "f0", "f1", "f2", "f3", "f4", "f5")
INHIBIT, FOUR, FULL = maps.MAP.masks("R07", "inhibit", "four", "full")
STORED_MASKS = tuple(
    next((r.legal[1] if r.legal else r.mask for r in maps.MAP.registers if r.number == k and r.access != "R"), 0)
    for k in range(maps.ADDRESS_COUNT)
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
"""State of a chip from one of its changes on, for journals and recordings."""


@hot
def to_signed(value, bits):
    """Return the low bits of a number as two's complement.

    Args:
        value: The number.
        bits: Number of bits.
    """
    half = 1 << (bits - 1)
    return ((value + half) & (2 * half - 1)) - half


@hot
def find_control_mode(flags):
    """Return the control mode that the flags select. F0 takes precedence over F3, and F3 over F5."""
    if flags & F0:
        return TRAPEZOID
    if flags & F3:
        return PROPORTIONAL
    return INTEGRAL if flags & F5 else POSITION
