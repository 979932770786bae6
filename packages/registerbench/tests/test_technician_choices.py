"""Tests of how the shipped technician decides from results, diagnostics and scale readings."""

from types import SimpleNamespace

import pytest

from registerbench.arena.players import diagnosis_technician
from registerbench.diagnosis import CAUSES, SETUPS
from stage.agents.tool import Answer

WELL = "the program came to its end"
GAVE_UP = "line 9: x did not stop, and the host gave up"
FULL_MOVE, SHORT_MOVE = [(0, 0), (-4, 0)], [(0, 0), (-2.9, 0)]
"""Scale readings before and after the slow move of 4 mm."""
PROGRAM = SETUPS["late"].program


class ScriptedTable:
    """A table with scripted answers that records its calls."""

    tools = ({"name": "program"}, {"name": "run"})

    def __init__(self, program, end_of_run=WELL, diagnostics="", places=()):
        self.answers = {"program": program, "diagnostics": diagnostics}
        self.end_of_run, self.places, self.calls = end_of_run, list(places), []

    def call(self, name, arguments=None):
        self.calls.append((name, arguments))
        data = {"ended": self.end_of_run}
        if name == "measure":
            data = dict(zip(("x_mm", "y_mm"), self.places.pop(0), strict=True))
        return (
            Answer(True, {"text": self.answers[name]}) if name in self.answers else SimpleNamespace(data=data, text="")
        )

    def argument(self, name, key):
        """Return an argument of the last call of this name."""
        return [arguments for called, arguments in self.calls if called == name][-1][key]


@pytest.mark.parametrize(
    ("how", "cause"),
    [
        *[({"diagnostics": f"x: {sign}."}, cause) for sign, cause in diagnosis_technician.DIAGNOSTIC_SIGNS],
        ({"end_of_run": GAVE_UP}, "swapped limit switches"),
        ({"end_of_run": GAVE_UP, "program": "x: STOP_DEC\n" + PROGRAM}, "S-curve failure of the MCX304"),
        ({"places": [(0.5, 50)]}, "wrong base address"),
        ({"places": [(49.0, 0), (50.05, 0)]}, "ramp-down point too late"),
        ({"places": [(49.0, 0), (49.4, 0), *FULL_MOVE]}, "supply too low"),
        ({"places": [(20.0, 0), (20.3, 0), *SHORT_MOVE]}, "slipping coupling"),
        ({"places": [(1.5, 50), (0.02, 0), *SHORT_MOVE]}, "slipping coupling"),
    ],
)
def test_each_symptom_leads_to_its_cause_and_its_repair(how, cause):
    table = ScriptedTable(**{"program": PROGRAM, **how})
    diagnosis_technician.play_technician(table)
    assert cause in CAUSES
    assert table.argument("answer", "cause") == cause
    assert table.calls[-1] == ("finish", None)
    assert ("service" in dict(table.calls)) == (cause in diagnosis_technician.SERVICES_BY_CAUSE)
    if cause in diagnosis_technician.SERVICES_BY_CAUSE:
        assert table.argument("service", "work") == diagnosis_technician.SERVICES_BY_CAUSE[cause]
        assert table.argument("write_program", "text") == table.answers["program"], "the customer's program is back"


@pytest.mark.parametrize(
    ("name", "cause", "removed", "added"),
    [
        ("late", "ramp-down point too late", ["R6 <- "], ["R6 <- "]),
        *[(s.name, s.cause, ["304h"], ["300h"]) for s in SETUPS.values() if s.cause == "wrong base address"],
        *[(s.name, s.cause, ["R13 <- 800000h"], ["R13 <- 0"]) for s in SETUPS.values() if s.cause == "wrong polarity bit"],
        *[(s.name, s.cause, ["x: 84 2:"], ["R4 <- 16383"]) for s in SETUPS.values() if s.cause == "R4 wider than its register"],
    ],
)  # fmt: skip
def test_a_repaired_program_differs_in_the_lines_that_were_wrong(name, cause, removed, added):
    before = SETUPS[name].program
    after = diagnosis_technician.PROGRAM_REPAIRS[cause](before)
    gone = "\n".join(set(before.split("\n")) - set(after.split("\n")))
    new = "\n".join(set(after.split("\n")) - set(before.split("\n")))
    assert all(text in gone for text in removed)
    assert all(text in new for text in added)


def test_a_reset_command_is_inserted_before_the_registers_of_each_move():
    parts = "x: R0 <- 16000\nx: R6 <- 3200\nx: operate 15h\n"
    repaired = diagnosis_technician.PROGRAM_REPAIRS["missing reset command"](parts + "x: operate 08h\n" + parts)
    assert repaired == "x: operate 08h\n" + parts + "x: operate 08h\n" + parts
    program = "x: operate 08h\nx: R6 <- 3200\nx: operate 08h  # too late\nx: operate 15h\n"
    assert (
        diagnosis_technician.PROGRAM_REPAIRS["R6 missing after reset"](program)
        == "x: operate 08h\nx: R6 <- 3200\nx: operate 15h\n"
    )
