"""Whatever is called, with whatever arguments: an answer in words, and a toolbox that lives on."""

import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.from_schema import calls, fits

from stage import Stage
from stage.agents import Budget, Toolbox
from stage.errors import ArgumentError

AT_ONCE = 10
DAILY, ALL = 5, 250  # times AT_ONCE calls, on each of four machines
QUICK = {"deadline": None, "suppress_health_check": list(HealthCheck)}
MACHINES = {"PCL240K": "host", "PCL240MS": "truth", "MCX514": "host", "HCTL1100": "truth"}


@pytest.fixture(scope="module", params=MACHINES, ids=lambda chip: f"{chip}-{MACHINES[chip]}")
def machine(request):
    chips = request.param
    return Stage("xyz_servo" if chips == "HCTL1100" else "xy", chips=chips, visuals=False), MACHINES[chips]


@pytest.fixture(scope="module")
def tools(machine):
    """Tools of a machine."""
    box = make_toolbox(machine)
    box.close()
    return box.tools


def make_toolbox(machine):
    stage, mode = machine
    stage.reset()
    box = Toolbox(stage, mode, Budget(moves=6, seconds=2.0, cycles=20_000))
    box.meter.call_limit_s = 0.05
    return box


def assert_calls_survive(machine, drawn):
    box = make_toolbox(machine)
    try:
        for name, arguments in drawn:
            answer = box.call(name, arguments)
            text = json.dumps(answer.data, allow_nan=False)
            assert "Traceback" not in text
            assert "PulseStage itself has failed" not in text, (name, arguments, text)
            assert answer.text
            if not answer.ok:
                assert len(answer.data["error"]) < 3000
        assert box.call("budget").ok
    finally:
        if "clear_faults" in box.tools:
            box.call("clear_faults", {"all": True})
            box.call("load", {"mass": 0})
        box.close()


def make_fuzz_test(examples):
    @given(data=st.data())
    @settings(max_examples=examples, **QUICK)
    def test(machine, tools, data):
        assert_calls_survive(machine, data.draw(st.lists(calls(tools), min_size=AT_ONCE, max_size=AT_ONCE)))

    return test


test_hundreds_of_calls_are_answered = make_fuzz_test(DAILY)
test_ten_thousand_calls_are_answered = pytest.mark.slow(make_fuzz_test(ALL))


@given(data=st.data())
@settings(max_examples=30, **QUICK)
def test_what_a_schema_allows_is_understood(tools, data):
    """An argument that fits is never refused for what it is, but for how much: a text of a number too large for its register."""
    tool = data.draw(st.sampled_from(list(tools.values())))
    arguments = data.draw(fits(tool.schema()))
    refused = ""
    try:
        tool.parse(arguments)
    except ArgumentError as error:
        refused = str(error)
    assert not refused or "should be less than" in refused or "should be greater than" in refused
