"""A player for broken set-ups that works through a list of checks as a technician would.

It knows what the diagnostics of the chips mean and which services exist. It does not read the customer's complaint.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from registerbench.arena.game_session import GameSession
from registerbench.arena.players.formula_and_random import play_formula

DIAGNOSTIC_SIGNS = (
    ("bits wide", "R4 wider than its register"),
    ("R6 = 0 in a high-speed preset move", "R6 missing after reset"),
    ("without the reset command", "missing reset command"),
    ("starts on ORG", "wrong polarity bit"),
)
"""Part of the text of a diagnostic, and the cause behind it."""


def play_technician(session: GameSession) -> None:
    """Diagnose and repair a broken set-up; in an episode of a task, do what the formula does."""
    if "program" not in {t["name"] for t in session.tools}:
        play_formula(session)
        return
    program = session.call("program").text
    end = session.call("run").data["ended"]
    diagnostics = session.call("diagnostics").text
    cause = _find_cause_by_diagnostics(program, end, diagnostics) or _find_cause_by_trial(session, program)
    if cause in PROGRAM_REPAIRS:
        session.call("write_program", {"text": PROGRAM_REPAIRS[cause](program)})
    else:
        session.call("write_program", {"text": program})
        session.call("service", {"work": SERVICES_BY_CAUSE[cause]})
    session.call("answer", {"cause": cause})
    session.call("finish")


def _find_cause_by_diagnostics(program: str, end: str, diagnostics: str) -> str:
    """Return the cause that the diagnostics and the end of the program name; "" if they name none."""
    for sign, cause in DIAGNOSTIC_SIGNS:
        if sign in diagnostics:
            return cause
    if "gave up" in end:
        return "S-curve failure of the MCX304" if "STOP_DEC" in program else "swapped limit switches"
    return ""


def _find_cause_by_trial(session: GameSession, program: str) -> str:
    """Find the cause by moving: the first move of the program alone, then with an earlier ramp-down, then a slow, short move."""
    places = _run_and_measure(session, _cut_after_first_move(program))
    if abs(places["y_mm"]) > 1 > abs(places["x_mm"]):
        return "wrong base address"
    place_mm = _run_and_measure(session, _cut_after_first_move(_lengthen_ramp_down(program)))["x_mm"]
    if abs(place_mm - round(place_mm)) < NEAR_MM and abs(place_mm) > 1:
        return "ramp-down point too late"
    session.call("stop", {"axis": "x"})
    before = session.call("measure").data["x_mm"]
    session.call("move", {"axis": "x", "distance": "-4mm", "speed": 0.005})
    traveled = abs(session.call("measure").data["x_mm"] - before)
    return "supply too low" if abs(traveled - 4) < NEAR_MM else "slipping coupling"


def _run_and_measure(session: GameSession, program: str) -> Any:
    """Replace the program, run it, and return the measured positions."""
    session.call("write_program", {"text": program})
    session.call("run")
    return session.call("measure").data


def _cut_after_first_move(program: str) -> str:
    """Return the program up to the first wait after a start."""
    return program[: program.index("\n", program.index("wait", program.index("operate 15h"))) + 1]


def _lengthen_ramp_down(program: str) -> str:
    """Return the program with an earlier ramp-down of its moves."""
    return re.sub(r"R6 <- (\d+)", lambda match: f"R6 <- {10 * int(match[1])}", program, count=1)


def _change_each_start(program: str, change: Callable[[str], str]) -> str:
    """Change each part of a program that ends with a start command."""
    *parts, rest = re.split(r"(?<=operate 15h)", program)
    return "".join([*map(change, parts), rest])


def _remove_reset_after_registers(part: str) -> str:
    """Remove reset commands that come after the registers are written."""
    head, separator, tail = part.partition("R6 <-")
    return head + separator + re.sub(r"x: operate 08h[^\n]*\n", "", tail)


def _add_reset_before_registers(part: str) -> str:
    """Add a reset command before the registers are written, unless there is one."""
    return part if "operate 08h" in part else part.replace("x: R0 <-", "x: operate 08h\nx: R0 <-", 1)


NEAR_MM = 0.1  # mm
SERVICES_BY_CAUSE = {
    "swapped limit switches": "exchange the wires of the end limits of x",
    "supply too low": "set the supply of the drives to what is on the nameplate",
    "slipping coupling": "tighten the coupling between motor and screw of x",
}
PROGRAM_REPAIRS: dict[str, Callable[[str], str]] = {
    "R4 wider than its register": lambda p: re.sub(r"x: 84 2: \w+ 1: \w+", "x: R4 <- 16383", p),
    "R6 missing after reset": lambda p: _change_each_start(p, _remove_reset_after_registers),
    "missing reset command": lambda p: _change_each_start(p, _add_reset_before_registers),
    "wrong polarity bit": lambda p: p.replace("x: R13 <- 800000h", "x: R13 <- 0"),
    "wrong base address": lambda p: p.replace("304h", "300h"),
    "ramp-down point too late": lambda p: _lengthen_ramp_down(p),
    "S-curve failure of the MCX304": lambda p: p.replace("x: STOP_DEC\n", ""),
}
