"""What a reader of the HCTL-1100's manual would say to a bus write: (message, where it is written), or None.

`c` is the chip's record before the write, with access by name; `encoder` tells the raw count.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stage.chips.hctl1100.maps import MAP
from stage.chips.hctl1100.state import (
    CONTROL,
    CONTROL_MODES,
    F0,
    F1,
    F3,
    F5,
    FOUR,
    IDLE,
    INTEGRAL,
    LEAST_T,
    POSITION,
    PROPORTIONAL,
    TRAPEZOID,
    control_mode,
    signed,
)

Note = tuple[str, str]
REGISTERS = {r.number: r for r in MAP.registers}
MODE_FLAGS = F0 | F3 | F5
COMMANDS = {POSITION: (0x0E,), TRAPEZOID: (0x0E,), INTEGRAL: (0x0E, 0x3C), PROPORTIONAL: (0x23, 0x24)}
PROFILE_DATA = (0x0C, 0x0D, 0x0E, 0x26, 0x27, 0x28, 0x29, 0x2A, 0x2B)
IDLE_ONLY = (0x08, 0x09, 0x15, 0x16, 0x17)
_TIMER = "page 24"


def write(c: Any, encoder: Callable[[], int], address: int, value: int) -> Note | None:
    """A byte to an address."""
    r = REGISTERS.get(address)
    if r is None:
        return f"there is no register at address {address:02X}h", "register table"
    if r.access == "R":
        return f"{r.name} can only be read: the write does nothing", "register table"
    if address in IDLE_ONLY and c["mode"] != IDLE:
        return f"{r.name} is written outside of Init/Idle: ignored", r.name
    if address == 0x00:
        return _flag(c, value)
    if address == 0x05:
        return _mode(c, encoder, value)
    if address == 0x0F:
        return _period(c, value)
    if r.legal and not r.allows(r.value(value)):
        return f"{r.name} = {r.value(value)}: {r.title} takes {r.legal[0]} to {r.legal[1]}", r.name
    return _moment(c, address, value)


def _flag(c: Any, value: int) -> Note | None:
    bit, on = 1 << (value & 7), value & 8
    if bit == F1:
        return "F1 is set and cleared by the chip alone: write R05", "flags"
    if bit > F5:
        return f"{value:02X}h: there is no flag {value & 7}", "flags"
    others = int(c["flag"]) & MODE_FLAGS & ~bit
    if on and bit & MODE_FLAGS and others:
        names = " and ".join(f"F{k}" for k in range(6) if (others | bit) >> k & 1)
        return f"{names} are set: only one of F0, F3 and F5 may be", "flags"
    if on and c["mode"] == CONTROL:
        return _begin(c, int(c["flag"]) | bit)
    return None


def _mode(c: Any, encoder: Callable[[], int], value: int) -> Note | None:
    if value > 3:
        return f"R05 = {value:02X}h is no mode: 00h reset, 01h Init/Idle, 02h Align, 03h control", "R05"
    if value < 2:
        return None
    if c["mode"] != IDLE:
        return f"R05 = {value:02X}h outside of Init/Idle: ignored", "R05"
    if c["limited"]:
        return f"R05 = {value:02X}h while LIMIT has triggered: release the pin and write R07 first", "status"
    if value == 2:
        if not c["reg"][0x18]:
            return "Align turns the motor by the commutator, whose ring R18 is 0", "Align"
        if c["flag"] & MODE_FLAGS or c["command"] or signed(encoder() - int(c["zero"]), 24):
            return "Align begins with F0, F3, F5 clear and both positions 0", "Align"
        return _commutator(c)
    return _begin(c, int(c["flag"])) or _commutator(c)


def _begin(c: Any, flags: int) -> Note | None:
    """A control mode begins."""
    reg = c["reg"]
    if flags & F0 and not (reg[0x26] or reg[0x27]):
        return "a trapezoid with acceleration 0 (R27, R26) does not move and never ends", "trapezoid"
    if flags & F0 and not reg[0x28]:
        return "a trapezoid with maximum velocity 0 (R28) does not move and never ends", "trapezoid"
    return _short(int(reg[0x0F]), control_mode(flags))


def _short(t: int, mode: int) -> Note | None:
    if t < LEAST_T[mode]:
        return (
            f"T = {t:02X}h is below {LEAST_T[mode]:02X}h, the least for {CONTROL_MODES[mode]} control",
            f"Table 4, {_TIMER}",
        )
    return None


def _period(c: Any, value: int) -> Note | None:
    return _short(value, control_mode(int(c["flag"])))


def _commutator(c: Any) -> Note | None:
    reg = c["reg"]
    ring, offset, most = int(reg[0x18]), signed(int(reg[0x1C]), 8), int(reg[0x1F])
    phases = 4 if c["status"] & FOUR else 3
    if ring and phases * (int(reg[0x1A]) + int(reg[0x1B])) != ring:
        return f"the ring R18 = {ring} is not {phases} (X + Y) = {phases} ({reg[0x1A]} + {reg[0x1B]})", "commutator"
    if ring and not -128 <= 1.5 * ring + offset - most <= 1.5 * ring + offset + most <= 127:
        return (
            f"1.5 ring + offset +- maximum advance = {1.5 * ring + offset:g} +- {most} leaves -128 to 127",
            "commutator",
        )
    return None


def _moment(c: Any, address: int, value: int) -> Note | None:
    """Data in a control mode: not in this part of the sample, not during a profile, not by so much."""
    if c["mode"] != CONTROL:
        return None
    mode = control_mode(int(c["flag"]))
    if mode == TRAPEZOID and address in PROFILE_DATA:
        return f"R{address:02X} is written while PROF is high: the profile in progress takes it", "trapezoid"
    if address in COMMANDS[mode] and c["clock"] < c["computing"]:
        return (
            f"R{address:02X} is written while the sample is computed: wait until R0F has counted down by {LEAST_T[mode]}",
            _TIMER,
        )
    if address == 0x3C and mode == INTEGRAL:
        if c["stopped"]:
            return "R3C is written while STOP has triggered: it stays 0. Release the pin and write R07 first", "status"
        step = signed(value, 8) - signed(int(c["reg"][address]), 8)
        if abs(step) > 127:
            return f"R3C changes by {step}: successive command velocities may differ by 127", "R3C"
    return None
