"""The register map of the HCTL-1100 as data. Registers are called by their address, as the data sheet does: R0F is address 0Fh.

Sources: the data sheet's page on the sample timer (S), other pages of the manual (D), working drivers (C), memory of the manual
(M). What these leave open is inferred (I); docs/hctl1100.md says why.
"""

from __future__ import annotations

from typing import NamedTuple

from stage.chips.register_map import Field, Register, RegisterMap, Word

SEVEN_BITS = (0, 0x7F)


def _bit(name: str, number: int, meaning: str, evidence: str = "D", access: str = "R") -> Field:
    return Field(name, number, number, meaning, evidence, access)


FLAGS = (
    _bit("f5", 5, "integral velocity mode", "M"),
    _bit("f4", 4, "hold commutator", "M"),
    _bit("f3", 3, "proportional velocity mode", "M"),
    _bit("f2", 2, "unipolar motor command", "M"),
    _bit("f1", 1, "init/idle mode; the INIT pin", "M"),
    _bit("f0", 0, "trapezoid mode; cleared when the commanded profile ends; the PROF pin", "M"),
)
STATUS = (
    _bit("limit", 7, "0 = LIMIT has triggered; a write here clears it once the pin is released"),
    _bit("stop", 6, "0 = STOP has triggered; a write here clears it once the pin is released"),
    _bit("init", 5, "init/idle mode"),
    _bit("profile", 4, "the profile flag F0"),
    _bit("zero", 3, "always 0"),
    _bit("full", 2, "the commutator counts 0 quadrature counts, 1 full counts", access="RW"),
    _bit("four", 1, "0 three phases, 1 four phases", access="RW"),
    _bit("inhibit", 0, "PULSE stays off for one PWM period after a reversal of SIGN", "M", "RW"),
)
FLAG_WRITE = Word(
    "flag",
    "what is written to R00: one flag set or cleared",
    (_bit("set", 3, "1 = set, 0 = clear", "M", "W"), Field("number", 2, 0, "flag number 0, 2, 3, 4, 5", "M", "W")),
)
MODE_WRITE = Word(
    "mode",
    "what is written to R05",
    (Field("mode", 7, 0, "00h reset, 01h init/idle, 02h align, 03h control; 02h, 03h only from init/idle", "D", "W", (0, 3)),),
)  # fmt: skip


def _register(number: int, access: str, title: str, **more: object) -> Register:
    return Register(f"R{number:02X}", number, 8, access, title, **{"evidence": "D", **more})  # type: ignore[arg-type]


MAP = RegisterMap(
    "HCTL1100",
    "Agilent HCTL-1100 motion controller with digital filter and profile generator, one axis, 8-bit bus",
    "data sheet HCTL-1100, page 24; other pages of the manual; working drivers",
    (
        _register(0x00, "RW", "flags", fields=FLAGS, evidence="M"),
        _register(0x05, "W", "program counter: mode"),
        _register(0x07, "RW", "status", fields=STATUS),
        _register(0x08, "RW", "motor command port, 80h is 0; written in init/idle only", reset=0x80),
        _register(0x09, "RW", "PWM motor command; written in init/idle only", signed=True, legal=(-100, 100), unit="%",
                  evidence="M"),
        _register(0x0C, "RW", "command position, high byte; waits for R0E", unit="counts"),
        _register(0x0D, "RW", "command position, middle byte; waits for R0E", unit="counts"),
        _register(0x0E, "RW", "command position, low byte; its write latches all three", unit="counts"),
        _register(0x0F, "RW", "sample timer: written T, read the running count; a sample is 16 (T + 1) clocks", evidence="S",
                  reset=0x40),
        _register(0x12, "R", "actual position, high byte, as latched", unit="counts"),
        _register(0x13, "RW", "actual position, middle byte, as latched; any write clears the position", unit="counts"),
        _register(0x14, "R", "actual position, low byte; its read latches the other two", unit="counts"),
        _register(0x15, "W", "preset of the actual position, high byte; init/idle only", unit="counts"),
        _register(0x16, "W", "preset of the actual position, middle byte; init/idle only", unit="counts"),
        _register(0x17, "W", "preset of the actual position, low byte; its write loads all three", unit="counts"),
        _register(0x18, "RW", "commutator: ring", legal=SEVEN_BITS, unit="counts"),
        _register(0x19, "W", "commutator: velocity timer of the phase advance, 16 (R19 + 1) clocks"),
        _register(0x1A, "RW", "commutator: X, one phase alone", legal=SEVEN_BITS, unit="counts"),
        _register(0x1B, "RW", "commutator: Y, two phases together", legal=SEVEN_BITS, unit="counts"),
        _register(0x1C, "RW", "commutator: offset", signed=True, unit="counts"),
        _register(0x1F, "RW", "commutator: maximum phase advance", legal=SEVEN_BITS, unit="counts"),
        _register(0x20, "RW", "filter: zero A, in 1/256", reset=0xE5),
        _register(0x21, "RW", "filter: pole B, in 1/256", reset=0x40),
        _register(0x22, "RW", "filter: gain K, in 1/4", reset=0x40),
        _register(0x23, "RW", "proportional command velocity, low byte: 12.4, fraction in b3..0; acts at once",
                  unit="counts/sample"),
        _register(0x24, "RW", "proportional command velocity, high byte; acts at once", signed=True, unit="counts/sample"),
        _register(0x26, "RW", "acceleration, fraction /256", unit="counts/sample2"),
        _register(0x27, "RW", "acceleration, whole", legal=SEVEN_BITS, unit="counts/sample2"),
        _register(0x28, "RW", "maximum velocity", legal=SEVEN_BITS, unit="counts/sample"),
        _register(0x29, "RW", "final position, low byte", unit="counts"),
        _register(0x2A, "RW", "final position, middle byte", unit="counts"),
        _register(0x2B, "RW", "final position, high byte", unit="counts"),
        _register(0x34, "R", "actual velocity, low byte; in proportional velocity mode only", unit="counts/sample"),
        _register(0x35, "R", "actual velocity, high byte", unit="counts/sample"),
        _register(0x3C, "RW", "integral command velocity", signed=True, unit="counts/sample"),
    ),
    (FLAG_WRITE, MODE_WRITE),
)  # fmt: skip

MINIMUM_T = {"position": 0x07, "proportional velocity": 0x07, "trapezoid": 0x0F, "integral velocity": 0x0F}
"""Table 4 of the data sheet: the smallest T of each control mode, and how far the timer counts before commands may be written."""

TOP = 1 << 23  # counts; positions are -TOP to TOP - 1


class Number(NamedTuple):
    """Bus addresses of a number's bytes in the order in which they are written, the high one first; least and most."""

    addresses: tuple[int, ...]
    least: int
    most: int


NUMBERS = {
    "timer": Number((0x0F,), 0, 0xFF),
    "zero": Number((0x20,), 0, 0xFF),
    "pole": Number((0x21,), 0, 0xFF),
    "gain": Number((0x22,), 0, 0xFF),
    "command_position": Number((0x0C, 0x0D, 0x0E), -TOP, TOP - 1),
    "preset_position": Number((0x15, 0x16, 0x17), -TOP, TOP - 1),
    "final_position": Number((0x2B, 0x2A, 0x29), -TOP, TOP - 1),
    "acceleration": Number((0x27, 0x26), 0, 0x7FFF),
    "maximum_velocity": Number((0x28,), 0, 0x7F),
    "proportional_velocity": Number((0x24, 0x23), -0x8000, 0x7FFF),
    "integral_velocity": Number((0x3C,), -0x80, 0x7F),
    "motor_command": Number((0x09,), -100, 100),
}
"""What a host writes as one: acceleration in 256ths of counts per sample2, proportional velocity in 16ths of counts per sample, the
other velocities in counts per sample; motor_command in hundredths of full drive, in Init/Idle only."""
