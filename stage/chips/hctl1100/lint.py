"""Mistakes in bus writes by the HCTL-1100's manual: (message, section of the manual), or None.

`c` is the chip's record before the write, with access by name; `encoder` gives the raw count.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stage.chips.hctl1100.maps import (
    ACCELERATION,
    COMMAND_LOW,
    COMMAND_POSITION,
    FINAL_POSITION,
    FLAG,
    FLAG_WRITE,
    FRACTION,
    INTEGRAL_VELOCITY,
    MAP,
    MODE,
    MODE_WRITE,
    MOST_ADVANCE,
    MOST_VELOCITY,
    OFFSET,
    PORT,
    PRESET_POSITION,
    PROPORTIONAL_VELOCITY,
    PWM,
    RING,
    TIMER,
    WHOLE,
    X,
    Y,
)
from stage.chips.hctl1100.state import (
    CONTROL,
    CONTROL_MODES,
    F0,
    F1,
    F3,
    F5,
    FOUR,
    GIVERS,
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
COMMANDS = {
    POSITION: (COMMAND_LOW,), TRAPEZOID: (COMMAND_LOW,), INTEGRAL: (COMMAND_LOW, INTEGRAL_VELOCITY),
    PROPORTIONAL: PROPORTIONAL_VELOCITY.addresses,
}  # fmt: skip
PROFILE_DATA = (*COMMAND_POSITION.addresses, *ACCELERATION.addresses, MOST_VELOCITY, *FINAL_POSITION.addresses)
IDLE_ONLY = (PORT, PWM, *PRESET_POSITION.addresses)
MODES = MODE_WRITE.fields[0]
RESET, INIT, ALIGN = (MODES.code(name) for name in ("reset", "Init/Idle", "Align"))
SET, NUMBER = FLAG_WRITE.fields
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
    if address == FLAG:
        return _flag(c, value)
    if address == MODE:
        return _mode(c, encoder, value)
    if address == TIMER:
        return _period(c, value)
    if r.legal and not r.allows(r.value(value)):
        return f"{r.name} = {r.value(value)}: {r.title} takes {r.legal[0]} to {r.legal[1]}", r.name
    return _moment(c, address, value)


def _flag(c: Any, value: int) -> Note | None:
    number = NUMBER.of(value)
    bit, on = 1 << number, SET.of(value)
    if bit == F1:
        return "F1 is set and cleared by the chip alone: write R05", "flags"
    if bit > F5:
        return f"{value:02X}h: there is no flag {number}", "flags"
    others = int(c["flag"]) & MODE_FLAGS & ~bit
    if on and bit & MODE_FLAGS and others:
        names = " and ".join(f"F{k}" for k in range(6) if (others | bit) >> k & 1)
        return f"{names} are set: only one of F0, F3 and F5 may be", "flags"
    if on and c["mode"] == CONTROL:
        return _begin(c, int(c["flag"]) | bit)
    return None


def _mode(c: Any, encoder: Callable[[], int], value: int) -> Note | None:
    if value not in MODES.values:
        known = ", ".join(f"{v:02X}h {mode}" for v, mode in MODES.values.items())
        return f"R05 = {value:02X}h is no mode: {known}", "R05"
    if value in (RESET, INIT):
        return None
    if c["mode"] != IDLE:
        return f"R05 = {value:02X}h outside of Init/Idle: ignored", "R05"
    if c["limited"]:
        return f"R05 = {value:02X}h while LIMIT has triggered: release the pin and write R07 first", "status"
    if value == ALIGN:
        if not c["reg"][RING]:
            return "Align turns the motor by the commutator, whose ring R18 is 0", "Align"
        if c["flag"] & MODE_FLAGS or c["command"] or signed(encoder() - int(c["zero"]), 24):
            return "Align begins with F0, F3, F5 clear and both positions 0", "Align"
        return _commutator(c)
    return _begin(c, int(c["flag"])) or _commutator(c)


def _begin(c: Any, flags: int) -> Note | None:
    """A control mode begins."""
    reg = c["reg"]
    if flags & F0 and not (reg[FRACTION] or reg[WHOLE]):
        return "a trapezoid with acceleration 0 (R27, R26) does not move and never ends", "trapezoid"
    if flags & F0 and not reg[MOST_VELOCITY]:
        return "a trapezoid with maximum velocity 0 (R28) does not move and never ends", "trapezoid"
    return _short(int(reg[TIMER]), control_mode(flags))


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
    ring, offset, most = int(reg[RING]), signed(int(reg[OFFSET]), 8), int(reg[MOST_ADVANCE])
    phases = 4 if c["status"] & FOUR else 3
    if ring and phases * (int(reg[X]) + int(reg[Y])) != ring:
        return f"the ring R18 = {ring} is not {phases} (X + Y) = {phases} ({reg[X]} + {reg[Y]})", "commutator"
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
    if address == INTEGRAL_VELOCITY and mode == INTEGRAL:
        if c["stopped"]:
            return "R3C is written while STOP has triggered: it stays 0. Release the pin and write R07 first", "status"
        step = signed(value, 8) - signed(int(c["reg"][address]), 8)
        if abs(step) > 127:
            return f"R3C changes by {step}: successive command velocities may differ by 127", "R3C"
    if address in COMMANDS[mode] and c["given"] == c["next"] and int(c["gave"]) >> GIVERS.index(address) & 1:
        return (
            f"R{address:02X} is written twice in one sample: the later command counts, and the sheet allows one",
            _TIMER,
        )
    return None
