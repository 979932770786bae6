"""Tests of how the shipped technician decides from results, diagnostics and scale readings."""

from types import SimpleNamespace

import pytest

from registerbench.arena.players import diagnosis_technician as technician
from registerbench.diagnosis import CAUSES, SETUPS
from stage.agents.tool import Answer

WELL = "the program came to its end"
GAVE_UP = "line 9: x did not stop, and the host gave up"
PROGRAM, ORIGIN = SETUPS["supply"].program, SETUPS["polarity"].program.replace("800000h", "0")
TO_50_MM, TO_LIMIT, TO_ORIGIN = (
    "x comes to 50, 0 mm from where it begins",
    "x comes to 150, -150 mm f",
    "x comes to -120 mm f",
)
STILL = {"y_mm": 0.0}


class ScriptedSession:
    """A session with scripted answers that records its calls."""

    tools = ({"name": "program"}, {"name": "run"})

    def __init__(self, program, task=TO_50_MM, end=WELL, diagnostics="", places=()):
        self.answers, self.task = {"program": program, "diagnostics": diagnostics}, task
        self.end, self.places, self.calls = end, list(places), []

    def call(self, name, arguments=None):
        self.calls.append((name, arguments))
        data = {"ended": self.end}
        if name == "measure":
            x = self.places.pop(0)
            data = x if isinstance(x, dict) else {"x_mm": x, **STILL}
        text = self.answers.get(name)
        return Answer(True, {"text": text}) if text is not None else SimpleNamespace(data=data, text="")

    def read_argument(self, name, key):
        """Return an argument of the last call of this name."""
        return [arguments for called, arguments in self.calls if called == name][-1][key]


RIGHT = 50.0
"""Reading after the first move, once it is repaired."""


@pytest.mark.parametrize(
    ("how", "cause"),
    [
        *[
            ({"diagnostics": f"x: {sign}.", "places": [0, 0, RIGHT]}, cause)
            for sign, cause in technician.DIAGNOSTIC_SIGNS
        ],
        (
            {"end": GAVE_UP, "program": "x: STOP_DEC\n" + PROGRAM, "places": [0, 70, RIGHT]},
            "S-curve failure of the MCX304",
        ),
        ({"places": [0, {"x_mm": 0.0, "y_mm": 50.0}, RIGHT]}, "wrong base address"),
        ({"places": [0, 0, {"x_mm": 0.0, "z_mm": 50.0}, RIGHT]}, "wrong base address"),
        ({"program": SETUPS["late"].program, "places": [0, 1.4, 49.0, 49.0, 45.0, RIGHT]}, "ramp-down point too late"),
        ({"places": [0, 1, 20.3, 20.3, 16.3, RIGHT]}, "supply too low"),
        ({"places": [0, 0, 20.3, 20.3, 17.4, RIGHT]}, "slipping coupling"),
        ({"places": [0, 0, 0, 0, 0, RIGHT]}, "jammed guides"),
        ({"places": [0, 0, 51.15, 51.15, 50.7, RIGHT]}, "broken motor wire"),
        (
            {"task": TO_LIMIT, "end": GAVE_UP, "places": [100, 155.8, 155.8, 155.8, 155.75, 150.0]},
            "swapped limit switches",
        ),
        ({"program": ORIGIN, "task": TO_ORIGIN, "places": [-100, -150, -150, -150, -146, -120]}, "stuck ORG sensor"),
        ({"places": [0, 0, RIGHT]}, "no fault"),
    ],
)
def test_each_symptom_leads_to_its_cause_and_its_repair(how, cause):
    session = ScriptedSession(**{"program": PROGRAM, **how})
    technician.play_technician(session)
    assert cause in CAUSES
    assert session.read_argument("answer", "cause") == cause
    assert "second" not in dict(session.calls)["answer"]
    assert session.calls[-1] == ("finish", None)
    assert ("service" in dict(session.calls)) == (cause in technician.SERVICES_BY_CAUSE)
    if cause not in technician.PROGRAM_REPAIRS:
        assert session.read_argument("write_program", "text") == session.answers["program"], (
            "the customer's program is back"
        )


def test_a_fault_with_a_bug_is_answered_as_the_second():
    session = ScriptedSession(PROGRAM, diagnostics="R4 is 14 bits wide", places=[0, 0, 0, 0, 0, RIGHT])
    technician.play_technician(session)
    assert dict(session.calls)["answer"] == {"cause": "R4 wider than its register", "second": "jammed guides"}


@pytest.mark.parametrize(
    ("name", "removed", "added"),
    [
        ("late", ["R6 <- "], ["R6 <- "]), ("address", ["304h"], ["300h"]), ("polarity", ["R13 <- 800000h"], ["R13 <- 0"]),
        ("wide", ["x: 84 2:"], ["R4 <- 16000"]), ("erratum", ["STOP_DEC"], []),
    ],
)  # fmt: skip
def test_a_repaired_program_differs_in_the_lines_that_were_wrong(name, removed, added):
    before = SETUPS[name].program
    after = technician.PROGRAM_REPAIRS[SETUPS[name].causes[0]](before)
    gone = "\n".join(set(before.split("\n")) - set(after.split("\n")))
    new = "\n".join(set(after.split("\n")) - set(before.split("\n")))
    assert all(text in gone for text in removed)
    assert all(text in new for text in added)


def test_the_ramp_down_point_follows_from_rates_and_deceleration():
    # from 8160 to 340 steps of 600 / 204 pps with R5 = 157: 0.2498 s at 12.5 kpps in the mean
    assert technician.compute_ramp_down(PROGRAM) == pytest.approx(0.2498 * 12_500, rel=1e-3)
    by_bytes = PROGRAM.replace("x: R5 <- 157", "x: 85 2: 00 1: 9D")
    assert technician.compute_ramp_down(by_bytes) == technician.compute_ramp_down(PROGRAM)


def test_a_reset_command_is_inserted_before_the_registers_of_each_move():
    parts = "x: R0 <- 16000\nx: operate 15h\nuntil x stopped 5\nwait 0.2\n"
    with_reset = "x: operate 08h\n" + parts
    assert technician.add_resets(with_reset + parts) == with_reset + with_reset
    assert technician.add_resets(with_reset + with_reset) == with_reset + with_reset
