"""A player for broken set-ups that goes through a list, as a technician would: it looks, runs, tries one thing after the other.

It knows what a diagnostic of the data sheet's reader means, and what work can be asked for. It reads no text of the customer.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from registerbench.arena.players.simple import formula
from registerbench.arena.table import Table

SIGNS = (
    ("bits wide", "R4 wider than its register"),
    ("R6 = 0 in a high-speed preset move", "R6 missing after reset"),
    ("without the reset command", "missing reset command"),
    ("starts on ORG", "wrong polarity bit"),
)
"""What a diagnostic says, and what it comes from."""


def play(table: Table) -> None:
    """Diagnose; at an episode of the bench, the formula."""
    if "program" not in {t["name"] for t in table.tools}:
        formula(table)
        return
    program = table.call("program").text
    ran = table.call("run").data["ended"]
    noted = table.call("diagnostics").text
    cause = _by_the_book(program, ran, noted) or _by_trial(table, program)
    if cause in MENDINGS:
        table.call("write_program", {"text": MENDINGS[cause](program)})
    else:
        table.call("write_program", {"text": program})
        table.call("service", {"work": WORK[cause]})
    table.call("answer", {"cause": cause})
    table.call("finish")


def _by_the_book(program: str, ran: str, noted: str) -> str:
    """Return the cause that diagnostics and the program's end name, or ""."""
    for sign, cause in SIGNS:
        if sign in noted:
            return cause
    if "gave up" in ran:
        return "S-curve failure of the MCX304" if "STOP_DEC" in program else "swapped limit switches"
    return ""


def _by_trial(table: Table, program: str) -> str:
    """The first way of the program alone; if it ends elsewhere, with an earlier ramp down; then one slow and short move."""
    places = _ends(table, _first_way(program))
    if abs(places["y_mm"]) > 1 > abs(places["x_mm"]):
        return "wrong base address"
    earlier = _ends(table, _first_way(_earlier(program)))["x_mm"]
    if abs(earlier - round(earlier)) < NEAR and abs(earlier) > 1:
        return "ramp-down point too late"
    table.call("stop", {"axis": "x"})
    before = table.call("measure").data["x_mm"]
    table.call("move", {"axis": "x", "distance": "-4mm", "speed": 0.005})
    came = abs(table.call("measure").data["x_mm"] - before)
    return "supply too low" if abs(came - 4) < NEAR else "slipping coupling"


def _ends(table: Table, program: str) -> Any:
    table.call("write_program", {"text": program})
    table.call("run")
    return table.call("measure").data


def _first_way(program: str) -> str:
    """Up to the first wait behind a start."""
    return program[: program.index("\n", program.index("wait", program.index("operate 15h"))) + 1]


def _earlier(program: str) -> str:
    return re.sub(r"R6 <- (\d+)", lambda found: f"R6 <- {10 * int(found[1])}", program, count=1)


def _by_starts(program: str, change: Callable[[str], str]) -> str:
    """Each part of a program up to a start, changed."""
    *parts, rest = re.split(r"(?<=operate 15h)", program)
    return "".join([*map(change, parts), rest])


def _without_late_reset(part: str) -> str:
    """No reset command behind the registers."""
    head, found, tail = part.partition("R6 <-")
    return head + found + re.sub(r"x: operate 08h[^\n]*\n", "", tail)


def _with_reset(part: str) -> str:
    """A reset command before the registers."""
    return part if "operate 08h" in part else part.replace("x: R0 <-", "x: operate 08h\nx: R0 <-", 1)


NEAR = 0.1  # mm
WORK = {
    "swapped limit switches": "exchange the wires of the end limits of x",
    "supply too low": "set the supply of the drives to what is on the nameplate",
    "slipping coupling": "tighten the coupling between motor and screw of x",
}
MENDINGS: dict[str, Callable[[str], str]] = {
    "R4 wider than its register": lambda p: re.sub(r"x: 84 2: \w+ 1: \w+", "x: R4 <- 16383", p),
    "R6 missing after reset": lambda p: _by_starts(p, _without_late_reset),
    "missing reset command": lambda p: _by_starts(p, _with_reset),
    "wrong polarity bit": lambda p: p.replace("x: R13 <- 800000h", "x: R13 <- 0"),
    "wrong base address": lambda p: p.replace("304h", "300h"),
    "ramp-down point too late": lambda p: _earlier(p),
    "S-curve failure of the MCX304": lambda p: p.replace("x: STOP_DEC\n", ""),
}
