"""A player for broken set-ups that works through a list of checks as a technician would.

It knows what the diagnostics of the chips mean, how a PCL-240 computes its ramps, and which services exist. Of the task it reads
the places that are wanted, and never the complaint.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from registerbench.arena.game_session import GameSession
from registerbench.arena.players.formula_and_random import play_formula
from registerbench.diagnosis.broken_setups import NO_FAULT
from registerbench.diagnosis.machine_faults import SERVICES

NEAR_MM, AT_REST_MM, SLOW_MOVE_MM, LIMIT_MM = 0.35, 0.04, 4.0, 150.0
MAX_REPAIRS = 3
DIAGNOSTIC_SIGNS = (
    ("bits wide", "R4 wider than its register"),
    ("R6 = 0 in a high-speed preset move", "R6 missing after reset"),
    ("without the reset command", "missing reset command"),
)
"""Part of the text of a diagnostic, and the bug behind it."""


def play_technician(session: GameSession) -> None:
    """Diagnose and repair a broken set-up; in an episode of a task, do what the formula does."""
    if "program" in {t["name"] for t in session.tools}:
        Technician(session).repair_setup()
    else:
        play_formula(session)


class Technician:
    """Technician at one set-up: finds the bug of the program first, then the faults of the machine."""

    def __init__(self, session: GameSession):
        self.session = session
        self.program = session.call("program").text
        self.start_mm = session.call("measure").data["x_mm"]
        places, frame = re.search(r"x comes to ([-\d., ]+) mm (from where it begins)?", session.task).groups()  # type: ignore[union-attr]
        self.stops_mm = [float(place) + (self.start_mm if frame else 0.0) for place in places.split(",")]
        self.causes: list[str] = []

    def repair_setup(self) -> None:
        """Find and repair what is wrong, answer, and finish."""
        places, end = self.run(self.program)
        diagnostics = self.session.call("diagnostics").text
        bug = find_bug(self.program, end, diagnostics, places)
        if bug:
            self.repair_program(bug)
        for _ in range(MAX_REPAIRS):
            places, _ = self.run(cut_after_first_move(self.program))
            if abs(places["x_mm"] - self.stops_mm[0]) < NEAR_MM:
                break
            cause = "wrong base address" if has_moved_another_axis(places) else self.find_cause(places["x_mm"])
            if cause in PROGRAM_REPAIRS:
                self.repair_program(cause)
            else:
                self.session.call("service", {"work": SERVICES_BY_CAUSE[cause]})
                self.causes.append(cause)
        self.session.call("write_program", {"text": self.program})
        causes = [*dict.fromkeys(self.causes), None]
        cause = causes[0] or NO_FAULT
        self.session.call("answer", {"cause": cause, "second": causes[1]} if len(causes) > 2 else {"cause": cause})
        self.session.call("finish")

    def run(self, program: str) -> tuple[Any, str]:
        """Run a program, and return the measured places and how it ended."""
        self.session.call("write_program", {"text": program})
        end = self.session.call("run").data.get("ended", "")
        return self.session.call("measure").data, end

    def repair_program(self, cause: str) -> None:
        """Repair the program, and note the cause."""
        self.program = PROGRAM_REPAIRS[cause](self.program)
        self.causes.append(cause)

    def find_cause(self, place_mm: float) -> str:
        """Find why the first move missed its place, from where x stands then and from a slow, short move.

        Args:
            place_mm: Place of x after the first move.
        """
        self.session.call("stop", {"axis": "x"})
        before = self.session.call("measure").data["x_mm"]
        distance = f"{-SLOW_MOVE_MM if before > 0 else SLOW_MOVE_MM}mm"
        self.session.call("move", {"axis": "x", "distance": distance, "speed": 0.005})
        traveled = abs(self.session.call("measure").data["x_mm"] - before)
        if self._is_beyond_limit(place_mm):
            return "swapped limit switches"
        if traveled < SLOW_MOVE_MM / 4:
            return "jammed guides" if max(abs(place_mm - self.start_mm), traveled) < AT_REST_MM else "broken motor wire"
        if traveled < SLOW_MOVE_MM - AT_REST_MM:
            return "slipping coupling"
        if "control 69h" in self.program:
            return "stuck ORG sensor"
        if "R6" in self.program and read_register(self.program, "R6") < compute_ramp_down(self.program):
            return "ramp-down point too late"
        return "supply too low"

    def _is_beyond_limit(self, place_mm: float) -> bool:
        """Return whether x stands against the rubber behind the limit switch that it ought to reach."""
        return abs(place_mm) > LIMIT_MM + 2 and abs(self.stops_mm[0]) > LIMIT_MM - 1 and place_mm * self.stops_mm[0] > 0


def find_bug(program: str, end: str, diagnostics: str, places: dict[str, float]) -> str:
    """Return the bug of the program that a run, the diagnostics and the places of the other axes show; "" if they show none."""
    for sign, cause in DIAGNOSTIC_SIGNS:
        if sign in diagnostics:
            return cause
    if "starts on ORG" in diagnostics and "R13 <- 800000h" in program:
        return "wrong polarity bit"
    if "STOP_DEC" in program and "gave up" in end:
        return "S-curve failure of the MCX304"
    return "wrong base address" if "answers FFh" in end or has_moved_another_axis(places) else ""


def has_moved_another_axis(places: dict[str, float]) -> bool:
    """Return whether an axis other than x stands elsewhere than at power-up."""
    return any(abs(place) > NEAR_MM for name, place in places.items() if name != "x_mm")


def cut_after_first_move(program: str) -> str:
    """Return the program up to the first wait after x has stopped."""
    match = re.search(r"until x stopped[^\n]*\nwait[^\n]*\n", program)
    return program[: match.end()] if match else program


def read_register(program: str, name: str) -> int:
    """Read the value that a program first writes to a register, by name or by bytes."""
    match = re.search(rf"x: {name} <- (\d+)", program)
    if match:
        return int(match[1])
    match = re.search(rf"x: 8{name[1]} 2: (\w+) 1: (\w+)", program)
    return int(match[1] + match[2], 16) if match else 0


def compute_ramp_down(program: str) -> int:
    """Compute the ramp-down point of a PCL-240's program from its rates and its deceleration, in pulses."""
    low, high, slope, multiplier = (read_register(program, name) for name in ("R1", "R2", "R5", "R7"))
    seconds = (high - low) * slope / 4_915_200
    return round((low + high) / 2 * 600 / multiplier * seconds)


def add_ramp_down(program: str) -> str:
    """Return the program with the ramp-down point written before each start."""
    return program.replace("x: operate 15h", f"x: R6 <- {compute_ramp_down(program) + 50}\nx: operate 15h")


def correct_ramp_down(program: str) -> str:
    """Return the program with the right ramp-down point in all moves."""
    return re.sub(r"R6 <- \d+ *", f"R6 <- {compute_ramp_down(program) + 50}", program)


def copy_deceleration(program: str) -> str:
    """Return the program with the rate of the deceleration for the acceleration, too."""
    return re.sub(r"x: 84 2: \w+ 1: \w+[^\n]*", f"x: R4 <- {read_register(program, 'R5')}", program)


def add_resets(program: str) -> str:
    """Return the program with a reset command after each wait that a bus cycle follows."""
    return re.sub(r"(wait [\d.]+\n)(?=x: )(?!x: operate 08h)", r"\1x: operate 08h\n", program)


SERVICES_BY_CAUSE = {cause: work for work, cause in SERVICES.items()}
PROGRAM_REPAIRS: dict[str, Callable[[str], str]] = {
    "R4 wider than its register": copy_deceleration,
    "R6 missing after reset": add_ramp_down,
    "missing reset command": add_resets,
    "wrong polarity bit": lambda p: p.replace("x: R13 <- 800000h", "x: R13 <- 0"),
    "wrong base address": lambda p: re.sub(r"base x \w+", "base x 300h", p),
    "ramp-down point too late": correct_ramp_down,
    "S-curve failure of the MCX304": lambda p: p.replace("x: STOP_DEC\n", ""),
}
