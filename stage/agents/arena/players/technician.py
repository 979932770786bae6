"""A player for broken set-ups that goes through a list, as a technician would: it looks, runs, tries one thing after the other.

It knows what a diagnostic of the data sheet's reader means, and what work can be asked for. It reads no text of the customer.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from stage.agents.arena.players.simple import formula
from stage.agents.arena.table import Table

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
    ran = table.call("run").data
    places = table.call("measure").data
    noted = table.call("diagnostics").text
    cause, better = _by_the_book(program, ran, places, noted)
    if cause is None:
        cause, better = _by_trial(table, program, places)
    if better is not None:
        table.call("write_program", {"text": better})
    table.call("answer", {"cause": cause})
    table.call("finish")


def _by_the_book(program: str, ran: Any, places: Any, noted: str) -> tuple[str | None, str | None]:
    """What diagnostics and the scales say by themselves: the cause, and a better program."""
    for sign, cause in SIGNS:
        if sign in noted:
            return cause, MENDINGS[cause](program)
    if places["y_mm"] and not places["x_mm"]:
        return "wrong base address", MENDINGS["wrong base address"](program)
    if "STOP_DEC" in program and "gave up" in ran["ended"]:
        return "S-curve failure of the MCX304", program.replace("x: STOP_DEC\n", "")
    return None, None


def _by_trial(table: Table, program: str, places: Any) -> tuple[str, str | None]:
    """One thing after the other is mended, until the machine ends elsewhere."""
    if point := re.search(r"R6 <- (\d+)", program):
        earlier = program.replace(point[0], f"R6 <- {10 * int(point[1])}", 1)
        table.call("write_program", {"text": earlier})
        if _ends(table) != places and _round(table):
            return "ramp-down point too late", earlier
        table.call("write_program", {"text": program})
    for work, cause in (
        ("exchange the wires of the end limits of x", "swapped limit switches"),
        ("set the supply of the drives to what is on the nameplate", "supply too low"),
        ("tighten the coupling between motor and screw of x", "slipping coupling"),
    ):
        table.call("service", {"work": work})
        if _ends(table) != places:
            return cause, None
    return "slipping coupling", None


def _ends(table: Table) -> Any:
    table.call("run")
    return table.call("measure").data


def _round(table: Table) -> bool:
    """Whether x stands at a whole millimetre now, as customers want it."""
    x = table.call("measure").data["x_mm"]
    return abs(x - round(x)) < 0.1 and abs(x) > 1


def _without_second_reset(program: str) -> str:
    first, _, rest = program.partition("x: operate 08h")
    return first + "x: operate 08h" + re.sub(r"x: operate 08h[^\n]*\n", "", rest)


def _reset_before_the_second(program: str) -> str:
    head, _, tail = program.rpartition("x: operate 15h")
    at = head.rindex("x: R0 <-")
    return head[:at] + "x: operate 08h\n" + head[at:] + "x: operate 15h" + tail


MENDINGS: dict[str, Callable[[str], str]] = {
    "R4 wider than its register": lambda p: re.sub(r"x: 84 2: \w+ 1: \w+", "x: R4 <- 16383", p),
    "R6 missing after reset": _without_second_reset,
    "missing reset command": _reset_before_the_second,
    "wrong polarity bit": lambda p: p.replace("x: R13 <- 800000h", "x: R13 <- 0"),
    "wrong base address": lambda p: p.replace("304h", "300h"),
}
