"""Which tools cost nothing and may be called when a budget is spent, and which count as moves."""

import pytest

from stage import Stage
from stage.agents import Budget, Toolbox

FREE = {"budget", "describe", "diagnostics", "picture", "registers", "report", "trace"}
MOVES = {"home", "line", "move", "start"}


@pytest.mark.parametrize(("mode", "more"), [("host", set()), ("truth", {"peek", "truth"})])
def test_looking_is_free_and_what_starts_pulses_is_a_move(mode, more):
    box = Toolbox(Stage("xy", visuals=False), mode=mode)
    assert {t.name for t in box.tools.values() if t.free} == FREE | more
    assert {t.name for t in box.tools.values() if t.moves} == MOVES


def test_what_is_free_answers_when_the_budget_is_spent_and_nothing_else_does():
    box = Toolbox(Stage("xy", visuals=False), mode="truth", budget=Budget(seconds=0.1))
    assert not box.call("wait", {"seconds": 1}).ok
    example = {"peek": {"axis": "x"}, "registers": {"axis": "x"}, "trace": {"axis": "x"}}
    for name in ("budget", "describe", "diagnostics", "peek", "registers", "trace", "truth"):
        assert box.call(name, example.get(name)).ok, name
    refused = box.call("read_register", {"axis": "x", "name": "R0"})
    assert not refused.ok
    assert "All 0.1 s of simulated time are spent" in refused.text
