"""Mistakes in bus writes by the PCL-240 data sheets: (message, section of the data sheet), or None.

`map_` is the chip's register map, `c` its record before the write, with access by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from stage.chips.chip import Limit
from stage.chips.pcl240.maps import WRITTEN
from stage.chips.pcl240.state import (
    EL_MINUS,
    EL_PLUS,
    EZ_COUNT,
    EZ_FROM_FL,
    EZ_MOST,
    EZ_RETURN,
    FH1,
    FH2,
    GROUP,
    INT_AT_STOP,
    LINEAR,
    MAP,
    MINUS,
    ORG,
    ORG_POSITIVE,
    R13,
    R14,
    R15,
    RAMP,
    SPAN,
    SPEED,
    START,
    STOP,
    SYNI,
    UNCORRECTED,
)
from stage.chips.register_map import RegisterMap

Note = tuple[str, str]
MOST_PPS = 245_730
"""Of the output: 8191 steps of 30 pps, the greatest multiplier (sheet, sections 1 and 4)."""
LAST_PULSES = 16
"""A run is noted that stops at a speed at which so many pulses are left in a ramp that ends at FL, or at a tenth of the ramp: some
pulses are always missing, see ramp_down.md."""
_SECTIONS = {"control": "section 3 b", "select": "section 3 c", "output": "section 3 d"}
_SPEEDS = MAP.field("operate", "speed").values
_FH = {FH1: 2, FH2: 3}
"""The register of a speed select; R1 of any other."""
_WORD = (1 << 24) - 1
"""The bits of the three data bytes."""
_RAMPING = ("R1", "R4", "R5", "R14", "R15")


class Foresight(NamedTuple):
    """What a command leads to, if nobody interferes."""

    moves: Callable[[int], bool]
    """Do pulses come of it?"""
    last_speed: Callable[[int], int | None]
    """The speed steps of the run at its end; None if it does not end."""
    hz: int
    """The reference clock."""


def data(map_: RegisterMap, c: Any, address: int, value: int) -> Note | None:
    """A byte to address 1, 2 or 3."""
    k = int(c["selected"])
    r = map_.registers[k]
    shift = 8 * (address - 1)
    given, whole = value << shift, int(c["reg"][k]) & ~(0xFF << shift) | value << shift
    if c["collective"]:
        if address != 1:
            return None
        given = whole = int(c["high"]) << 16 | int(c["middle"]) << 8 | value
    if lost := given & ~r.mask & ~_sign_extension(r.name, c, given):
        return (
            f"{r.name} is {r.bits} bits wide: {value:02X}h at address {address} loses bits {lost:06X}h",
            "section 3 c",
        )
    if fixed := given & r.mask & ~r.writable:
        return f"{r.name} bits {fixed:06X}h are read only", "MS section 2-4"
    if r.name in ("R14", "R15") and not c["s_curves"] and given & SPAN:
        return f"{r.name}: this chip has no S-curves; the value is stored and means nothing", "MS section 1"
    if c["running"] and c["preset"] and c["ramps"]:
        if r.name in ("R0", "R6"):
            return f"{r.name} written during a high-speed preset run: its bytes do not change together", "Q & A"
        if r.name in _RAMPING and c["automatic"] and not c["manual"]:
            return (
                f"{r.name} written in motion switches the automatic ramp-down point off for this run",
                "MS section 3-5",
            )
    # a register is complete with its low byte, which a host writes last, or whose high bytes are still 0
    if r.legal and address == 1 and whole < r.legal[0] and whole not in r.also:  # a start tells of R0 = 0 and R6 = 0
        return f"{r.name} = {whole}: {r.title} takes {r.legal[0]} to {r.legal[1]}", "section 4"
    return None


def _sign_extension(name: str, c: Any, written: int) -> int:
    """Find the bits of a byte, or of a collective write, that only repeat the sign of R6 as an offset: none of them is lost."""
    sign = _WORD & ~(int(c["top_bit"]) - 1)
    return sign if name == "R6" and c["extended"] and written & sign == sign else 0


def command(map_: RegisterMap, c: Any, foresight: Foresight, value: int) -> Note | None:
    """A byte to address 0."""
    name = WRITTEN[value & GROUP]
    if where := _SECTIONS.get(name):
        empty = value & ~map_.word(name).used
        bits = " and ".join(str(k) for k in range(7, -1, -1) if empty >> k & 1)
        if empty:
            return f"{name} mode {value:02X}h: bit {bits} means nothing on this chip", where
        return _turn(c, value) if name == "control" else None
    if value & SPEED not in _SPEEDS and value & START and not value & STOP:
        return f"speed select {value & SPEED:02b} in {value:02X}h is in no table; it acts as FL", "section 3 a"
    if value not in (sent := map_.word(name).sends) and (
        value & ~INT_AT_STOP not in sent or value & ~INT_AT_STOP == STOP
    ):
        return f"operating mode {value:02X}h is in no table; {_effect(c, value)}", "section 3 a"
    if not value & START or value & STOP:
        return None
    said = None if c["running"] else _start(c, foresight, value)
    return said or _too_fast(c, foresight.hz, value)


def _turn(c: Any, value: int) -> Note | None:
    """Note a control mode that changes the direction before status bit 6 is 0."""
    if bool(value & MINUS) == bool(c["minus"]) or not (c["running"] or c["finishing"]):
        return None
    what = "the next pulse goes the other way, without a ramp" if c["running"] else "PDIR changes within the last pulse"
    return (
        f"control mode {value:02X}h changes the direction in motion: {what}; wait until status bit 6 is 0",
        "section 3 b",
    )


def _effect(c: Any, value: int) -> str:
    """Tell what a command of group 00 that is in no table does."""
    if value & STOP and value & START:
        if not c["running"]:
            return "nothing runs that it could stop"
        ramps = value & RAMP or c["ramps"]
        return f"it acts as a {'decelerating stop (1Dh, 1Fh)' if ramps else 'stop at once'}"
    if value & STOP:
        return "it acts as the reset command" + (", with /INT" if value & INT_AT_STOP else "")
    return "it does nothing but " + ("ask for /INT at the stop" if value & INT_AT_STOP else "take /INT back")


def _too_fast(c: Any, hz: int, value: int) -> Note | None:
    """The speed that a start or a speed change asks for, against what the silicon is sold for."""
    multiplier = int(c["multiplier"])
    k = max([1, _FH.get(value & SPEED, 1)] if value & RAMP else [_FH.get(value & SPEED, 1)], key=lambda k: c["reg"][k])
    steps = int(c["reg"][k])
    if multiplier < 2 or steps * hz <= MOST_PPS * 8192 * multiplier:
        return None
    pps, unit = steps * hz / (8192 * multiplier), hz / (8192 * multiplier)
    return Limit(
        f"output above {MOST_PPS:,} pps, the most of this chip: R{k} = {steps} asks for {pps:,.0f} pps with R7 = {multiplier}, "
        f"a multiplier of {unit:g} (30 at most reaches every speed)",
        "section 1",
    )


def _start(c: Any, foresight: Foresight, value: int) -> Note | None:
    if c["finishing"]:
        return "start while the last pulse is still being completed is ignored: poll status bit 6", "Q & A"
    if not c["armed"]:
        return "start after a stop without the reset command 08h is ignored", "section 3 a"
    r = [int(v) for v in c["reg"]]
    if c["preset"] and r[0] == 0:
        return "start in preset mode with R0 = 0: no pulse, no /INT", "section 4 R0"
    if c["seen"] & (EL_MINUS if c["minus"] else EL_PLUS):
        return "start towards an asserted limit switch: no pulse comes; drive the other way", "pins 23 and 24"
    if c["origin"] and c["seen"] & ORG:
        turned = ", or clear R13 bit 23, which reads a high pin as ORG" if r[R13] & ORG_POSITIVE else ""
        return f"origin return that starts on ORG: no pulse comes; leave ORG first{turned}", "section 5 f"
    if c["multiplier"] < 2:
        whose = " of the chip at SYNI" if c["inputs"] >> SYNI else ""
        return (
            f"start with R7{whose} = {c['multiplier']}: no pulse comes; the multiplier does not operate unless it is set",
            "Q & A",
        )
    if standing := _standing(r, value, foresight.moves):
        return standing
    if value & RAMP and min(r[4], r[5]) < 2:
        return f"high-speed start with R4 = {r[4]}, R5 = {r[5]}: rates below 2 hold the speed", "section 4 R4"
    if c["extended"] and c["origin"] and not r[R13] & EZ_RETURN and r[R13] & (EZ_MOST << EZ_COUNT | EZ_FROM_FL):
        return "R13 counts EZ, but its bit 21 is 0: the origin return ends at ORG", "MS section 2-4"
    if not value & RAMP:
        return None
    if not c["extended"]:
        return _without_point(c, r, value & SPEED)
    return _ramps(c, r, value & SPEED) or _triangle(c, r, value, foresight)


def _triangle(c: Any, r: list[int], value: int, foresight: Foresight) -> Note | None:
    """An S-curve move that is too short for its FH, which nobody corrects, and stops above FL."""
    fh, corrected = _FH.get(value & SPEED), c["automatic"] and not r[R14] & UNCORRECTED
    if not fh or not c["s_curves"] or r[R14] & LINEAR or not c["preset"] or corrected or r[fh] <= r[1]:
        return None
    height = r[fh] - r[1]
    up, down = (s if 0 < 2 * s < height else height / 2 for s in (r[R14] & SPAN, r[R15] & SPAN))
    ramps = (height + 2 * up) * r[4] + (height + 2 * down) * r[4 if c["automatic"] else 5]
    if r[0] * 32768 * int(c["multiplier"]) > (r[1] + r[fh]) * ramps:
        return None
    last = foresight.last_speed(value)
    rate = r[4 if c["automatic"] else 5]
    if last is None or last - r[1] <= min(
        _steps_of(LAST_PULSES * 8192 * int(c["multiplier"]), r[1], rate, down), height / 10
    ):
        return None
    last_pps, fl_pps = (k * foresight.hz / (8192 * int(c["multiplier"])) for k in (last, r[1]))
    why = (
        "FH correction is off (R14 bit 15)"
        if c["automatic"]
        else "there is no FH correction without the automatic point"
    )
    return (
        f"R0 = {r[0]} is too short for R{fh} = {r[fh]}, and {why}: it stops at {last_pps:,.0f} pps, FL is {fl_pps:,.0f} pps",
        "MS section 3-4",
    )


def _steps_of(phase: float, fl: int, rate: int, span: float) -> float:
    """The speed steps above FL at which an S-curve that ends at FL has so much phase left: rate sqrt(k span) clocks before its end,
    at FL + k / 3 on average."""
    low, high = 0.0, 8191.0
    for _ in range(20):
        k = (low + high) / 2
        low, high = (k, high) if rate * math.sqrt(k * span) * (fl + k / 3) < phase else (low, k)
    return high


def _standing(r: list[int], value: int, moves: Callable[[int], bool]) -> Note | None:
    """Speed registers of the run that are 0. Ramps start from FL, and a decelerating stop ends there, whatever is selected."""
    zero = [k for k in sorted({1, _FH.get(value & SPEED, 1)}) if r[k] == 0]
    if not zero:
        return None
    what = f"start with {' and '.join(f'R{k} = 0' for k in zero)}: "
    what += "the pulses end where a ramp leads to speed 0" if moves(value) else "no pulse comes"
    return (f"{what}; any data must be set on R1", "Q & A") if 1 in zero else (what, "section 4 R1 to R3")


def _without_point(c: Any, r: list[int], select: int) -> Note | None:
    """Note a high-speed preset move to a rate above FL whose ramping-down point was not set."""
    fh = _FH.get(select)
    if not fh or r[1] >= r[fh] or r[6] or not c["preset"] or c["automatic"]:
        return None
    message = "R6 = 0 in a high-speed preset move: it stops without ramping down"
    return (f"{message}. 08h clears R6 on this chip", "MS section 3-4") if c["extended"] else (message, "section 4 R6")


def _ramps(c: Any, r: list[int], select: int) -> Note | None:
    """Contradictions of a high-speed start on a chip with the extension."""
    fh = _FH.get(select)
    if fh and r[1] > r[fh]:
        return f"R1 = {r[1]} is above R{fh} = {r[fh]}: the ramp leads down to FH", "section 4 R1"
    if c["automatic"] and not c["preset"]:
        return "automatic ramp-down without preset mode: there is no point to ramp down at", "section 3 b"
    if not fh or r[1] == r[fh]:
        return None
    height = r[fh] - r[1]
    linear = not c["s_curves"] or r[R14] & LINEAR
    up, down = (0 if linear or not 0 < 2 * s < height else s for s in (r[R14] & SPAN, r[R15] & SPAN))
    if c["s_curves"] and linear and r[R14] & SPAN | r[R15] & SPAN:
        return "R14 bit 12 selects linear ramps: the spans of R14 and R15 mean nothing", "MS section 2-2"
    if not c["preset"] or not c["automatic"]:
        return _without_point(c, r, select)
    offset = r[6] - 2 * int(c["top_bit"]) if r[6] & int(c["top_bit"]) else r[6]
    rising = (r[1] + r[fh]) * (height + 2 * up if up else 2 * height) * r[4] // (32768 * int(c["multiplier"]))
    if offset < 0 and -offset >= min(r[0], rising):
        return f"R6 = {offset} as offset: the move ends before the automatic ramp-down begins", "MS section 3-4"
    if not linear and (up or height / 2) < (down or height / 2):
        return "R14 is below R15: the automatic point comes too late for this deceleration", "MS section 3-4"
    return None
