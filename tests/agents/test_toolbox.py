"""A toolbox: its tools by their schemas, every refusal in words, budgets, states."""

import pytest

from stage import Stage
from stage.agents import Budget, Toolbox
from stage.errors import ArgumentError, StageError

FAMILIES = ("PCL240K", "PCL240MS", "MCX514", "MCX304")


def test_every_tool_has_a_schema_that_is_one(box):
    validator = pytest.importorskip("jsonschema").Draft202012Validator
    for tool in box.tools.values():
        validator.check_schema(tool.schema())
        assert tool.text
        assert all(f["description"] for f in tool.schema()["properties"].values())


@pytest.mark.parametrize("chips", FAMILIES)
def test_an_agent_homes_moves_and_reads_its_report(make_box, chips):
    box = make_box(chips)
    assert box.call("home", {"axis": "x"}).data["stopped_by"] == "ORG"
    moved = box.call("move", {"axis": "X", "distance": "3.2mm"})
    assert moved.ok
    assert moved.data["counted_pulses"] == moved.data["asked_pulses"] == 1024
    assert box.call("report").data == moved.data
    assert box.call("status", {"axis": "x"}).data["words"]


def test_a_servo_moves_by_the_same_tools(make_box):
    box = make_box("HCTL1100", model="xyz_servo")
    assert box.call("move", {"axis": "x", "distance": "1mm"}).data["as_asked"]
    assert "R07" in box.call("status", {"axis": "x"}).data["words"]


def test_a_line_is_the_end_of_what_was_started_before(box):
    box.call("start", {"axis": "x", "pulses": 400})
    box.call("wait", {"seconds": 1})
    assert box.call("line", {"distances": {"x": "1mm", "y": "1mm"}}).ok
    assert box.call("wait_until_stopped", {"axis": "x"}).data["at_rest"], "the start has no report any more"
    assert box.call("report").data["procedure"] == "line"


def test_a_trace_has_as_many_cycles_as_are_requested_whatever_was_a_mistake(box):
    box.call("write_bytes", {"axis": "x", "address": 0, "values": ["44h", "50h", "50h", "50h"]})
    assert len(box.call("diagnostics").data["diagnostics"]) == 3
    reported = box.call("trace", {"axis": "x", "lines": 4}).text.splitlines()
    assert [line.split()[3] for line in reported] == ["44", "50", "50", "50"]


def test_bytes_and_commands_make_the_same_move_as_a_driver(make_box):
    box = make_box()
    for name, value in (("R0", 2000), ("R1", 50), ("R2", 500), ("R4", 500), ("R5", 1500), ("R6", 800), ("R7", "1Eh")):
        assert box.call("write_register", {"axis": "x", "name": name, "value": value}).ok
    assert box.call("command", {"axis": "x", "name": "OPERATE", "data": "08h"}).ok
    assert box.call("write_bytes", {"axis": "x", "address": 0, "values": ["44h", "15h"]}).ok
    finished = box.call("wait_until_stopped", {"axis": "x"})
    assert (finished.data["counted_pulses"], finished.data["as_asked"]) == (2000, None)
    assert "not operating" in finished.data["stopped_by"]
    assert "start, ramp to FH1" in box.call("trace", {"axis": "x"}).text
    assert box.call("read_register", {"axis": "x", "name": "r0"}).data["value"] == 0
    assert box.meter.moves == 1


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("mvoe", {}, "Did you mean 'move'"),
        ("", {}, "Known: describe"),
        (7, {}, "called by its name"),
        ("move", {"axis": "x"}, "give distance"),
        ("move", {"pulses": 10}, "axis is missing"),
        ("move", {"axis": "q", "pulses": 10}, "Known: x, y."),
        ("move", {"axis": "x", "pulses": 10, "sped": 1}, "takes no argument 'sped'. Did you mean 'speed' or"),
        ("move", {"axis": "x", "pulses": "ten"}, "is not a whole number"),
        ("move", {"axis": "x", "distance": "0.1um"}, "no pulse"),
        ("move", {"axis": "x", "pulses": 100, "s_curve": True}, "linear ramps only"),
        ("move", [1], "should be an object"),
        ("write_register", {"axis": "x", "name": "R4", "value": 20000}, "from 2 to 16383"),
        ("write_register", {"axis": "x", "name": "R9", "value": 1}, "Known: R0"),
        ("read_register", {"axis": "x", "name": "R1"}, "cannot be read back"),
        ("write_bytes", {"axis": "x", "address": 4, "values": [1]}, "less than or equal to 3"),
        ("command", {"axis": "x", "name": "operate"}, "none was given"),
        ("restore", {"name": "yesterday"}, "Known: power-up"),
        ("report", {}, "There is no report yet"),
        ("picture", {}, "no move to draw yet"),
        ("wait", {"seconds": float("nan")}, "finite number"),
        ("home", {"axis": "x", "direction": "up"}, "Known: minus, plus"),
        ("line", {"distances": {"x": "1mm", "q": 1}}, "Known: x, y."),
    ],
)
def test_every_refusal_says_what_is_allowed(box, name, arguments, message):
    before = box.stage.time
    answer = box.call(name, arguments)
    assert not answer.ok
    assert message in answer.text
    assert "Traceback" not in answer.text
    assert (box.stage.time, box.meter.moves) == (before, 0)


def test_moves_that_are_spent_stay_spent(make_box):
    box = make_box(budget=Budget(moves=2))
    box.call("snapshot", {"name": "begin"})
    for _ in range(2):
        assert box.call("move", {"axis": "x", "pulses": 100}).ok
        box.call("restore", {"name": "begin"})
    refused = box.call("move", {"axis": "x", "pulses": 100})
    assert "All 2 moves are spent" in refused.text
    assert refused.data["left"]["moves"] == 0
    assert box.call("status", {"axis": "x"}).ok


def test_a_start_by_bytes_is_a_move_too(make_box):
    box = make_box(budget=Budget(moves=1))
    box.call("move", {"axis": "x", "pulses": 100})
    box.call("write_register", {"axis": "x", "name": "R0", "value": 100})
    box.call("write_bytes", {"axis": "x", "address": 0, "values": [8, "44h"]})
    assert "All 1 moves are spent" in box.call("write_bytes", {"axis": "x", "address": 0, "values": ["10h"]}).text
    assert not box.stage.axes["x"].chip.busy()


def test_time_ends_to_the_nanosecond_when_it_is_spent(make_box):
    box = make_box(budget=Budget(seconds=0.5))
    assert box.call("wait", {"seconds": 0.2}).ok
    assert "All 0.5 s of simulated time are spent" in box.call("wait", {"seconds": 1}).text
    assert box.stage.time == pytest.approx(0.5, abs=1e-12)
    assert box.call("budget").data["left"]["seconds"] == 0


def test_bus_cycles_are_counted_and_end(make_box):
    box = make_box(budget=Budget(cycles=5))
    assert box.call("write_bytes", {"axis": "x", "address": 0, "values": [8, 8, 8]}).ok
    assert box.call("budget").data["used"]["cycles"] == 3
    assert "All 5 bus cycles are spent" in box.call("read_bytes", {"axis": "x", "addresses": [0, 0, 0]}).text


def test_a_budget_of_nothing_is_spent_from_the_beginning(make_box):
    box = make_box(budget=Budget(moves=0, cycles=0, seconds=0))
    assert box.call("budget").data["left"] == {"moves": 0, "seconds": 0.0, "cycles": 0}
    for name, arguments, message in (
        ("move", {"axis": "x", "pulses": 10}, "All 0 moves are spent"),
        ("write_bytes", {"axis": "x", "address": 0, "values": [0]}, "All 0 bus cycles are spent"),
        ("wait", {"seconds": 0.1}, "All 0 s of simulated time are spent"),
    ):
        answer = box.call(name, arguments)
        assert not answer.ok
        assert message in answer.text
    assert box.call("budget").data["used"] == {"moves": 0, "seconds": 0.0, "cycles": 0}


def test_a_budget_limits_moves_and_bus_cycles_of_tools(make_box):
    box = make_box(budget=Budget(moves=1, cycles=3))
    assert box.call("write_bytes", {"axis": "x", "address": 0, "values": [0x44, 0x50, 0x44]}).ok
    assert box.call("budget").data["left"] == {"moves": 1, "seconds": None, "cycles": 0}
    box.stage.axes["x"].chip.write(0, 0x44)  # from outside the tools: not counted
    assert box.call("budget").data["used"]["cycles"] == 3
    box = make_box(budget=Budget(moves=1))
    assert box.call("move", {"axis": "x", "pulses": 100}).ok
    assert "All 1 moves are spent" in box.call("move", {"axis": "x", "pulses": 100}).text


def test_restored_time_stays_spent_and_each_call_has_a_limit(make_box):
    box = make_box(budget=Budget(seconds=1.0))
    box.meter.call_limit_s = 0.7
    assert box.call("wait", {"seconds": 0.6}).ok
    assert box.call("restore", {"name": "power-up"}).ok
    assert box.call("budget").data["left"]["seconds"] == pytest.approx(0.4)
    answer = box.call("wait", {"seconds": 0.6})
    assert "All 1 s of simulated time are spent" in answer.text
    assert box.stage.time == pytest.approx(0.4)
    free = make_box()
    free.meter.call_limit_s = 0.5
    for _ in range(3):
        assert free.call("wait", {"seconds": 0.4}).ok
    assert "One call may take 0.5 s of simulated time" in free.call("wait", {"seconds": 0.6}).text
    assert free.stage.time == pytest.approx(1.7)


def test_a_call_that_was_cancelled_is_the_last_that_is(box):
    box.cancel_call()
    assert box.call("wait", {"seconds": 0.1}).ok, "a new call begins anew"
    box.meter.begin_call()
    box.cancel_call()
    with pytest.raises(StageError, match="cancelled the call"):
        box.stage.run(0.1)
    box.meter.end_call()


def test_each_branch_has_its_report_drivers_and_trace(box):
    """Switch between two branches and compare their reports and lists of other branches."""
    box.call("move", {"axis": "x", "pulses": 200})
    first = box.call("report").data
    assert box.call("branch", {"name": "b"}).data["others"] == ["main"]
    box.call("move", {"axis": "x", "pulses": -300})
    second = box.call("report").data
    assert box.call("branch", {"name": "main"}).data == {
        "branch": "main",
        "others": ["b"],
        "time_s": pytest.approx(first["duration_s"], abs=0.2),
    }
    assert box.call("report").data == first
    assert box.call("branch", {"name": "b"}).data["others"] == ["main"]
    assert box.call("report").data == second
    assert box.call("restore", {"name": "power-up"}).ok
    assert "There is no report yet" in box.call("report").text


def test_the_last_cycles_and_the_last_mistakes_are_reported(make_box):
    box = make_box()
    for k in range(30):
        box.call("write_bytes", {"axis": "x", "address": 0, "values": [0x44, 0x50 + k % 2, 0x50]})
    reported = box.call("trace", {"axis": "x", "lines": 3}).text.splitlines()
    assert [line.split()[3] for line in reported] == ["44", "51", "50"]
    message = box.call("diagnostics").data
    assert len(message["diagnostics"]) == 40 < message["all"] == 60
    assert message["diagnostics"][-1]["time_s"] == pytest.approx(box.stage.time, abs=3e-6)


def test_a_datum_is_no_wider_than_the_bus_of_the_chip_that_it_is_for():
    box = Toolbox(Stage("xy", chips={"x": "PCL240K", "y": "MCX514"}, visuals=False))
    assert box.call("write_bytes", {"axis": "y", "address": 6, "values": ["1FFh"]}).ok
    refused = box.call("write_bytes", {"axis": "x", "address": 2, "values": [1, "1FFh"]})
    assert "has data of 0 to FFh" in refused.text
    assert box.call("budget").data["used"]["cycles"] == 1


def test_an_axis_is_distinguished_from_those_on_its_chip():
    box = Toolbox(Stage("xyz", chips="MCX514", visuals=False))
    message = box.call("describe").data["axes"]
    assert [message[name]["same_chip_as"] for name in "xyz"] == [["y", "z"], ["x", "z"], ["x", "y"]]
    assert box.call("write_register", {"axis": "z", "name": "DV", "value": 777}).ok
    values = [box.stage.axes[name].chip.axis_values(box.stage.axes[name].chip_axis)["DV"] for name in "xyz"]
    assert values[2] == 777
    assert 777 not in values[:2]
    assert box.call("read_register", {"axis": "z", "name": "LP"}).data["value"] == 0
    assert box.call("move", {"axis": "z", "pulses": -50}).ok
    reported = box.call("read_register", {"axis": "z", "name": "LP"}).data
    assert (reported["value"], reported["hex"]) == (-50, "FFFFFFCEh")


def test_a_call_takes_no_more_than_so_much_time(box):
    box.meter.call_limit_s = 0.01
    assert "One call may take 0.01 s" in box.call("move", {"axis": "x", "pulses": 10_000}).text


def test_an_error_in_a_move_includes_the_report_until_then(box):
    answer = box.call("move", {"axis": "x", "pulses": 10_000, "timeout": 0.05})
    assert answer.data["report"]["stopped_by"] == "timeout"
    assert answer.data["report"]["counted_pulses"] > 0


def test_branches_go_on_where_they_were_left(box):
    box.call("move", {"axis": "x", "pulses": 100})
    first = box.call("report").data
    box.call("branch", {"name": "bold"})
    box.call("move", {"axis": "x", "pulses": 700})
    bold = box.stage.axes["x"].chip.net()
    assert box.call("branch", {"name": "main"}).data["others"] == ["bold"]
    assert box.stage.axes["x"].chip.net() == 100
    assert box.call("report").data == first
    box.call("branch", {"name": "bold"})
    assert box.stage.axes["x"].chip.net() == bold


def test_snapshots_are_bounded_and_named(box):
    for k in range(15):
        assert box.call("snapshot", {"name": f"s{k}"}).ok
    assert "There are 16 already" in box.call("snapshot", {"name": "one more"}).text
    assert "printable" in box.call("snapshot", {"name": "\n"}).text
    assert "with which the session began" in box.call("snapshot", {"name": "power-up"}).text


def test_a_call_on_a_closed_toolbox_is_refused(box):
    box.close()
    box.close()
    assert "This session has ended" in box.call("budget").text


def test_equal_calls_give_equal_answers(make_box):
    calls = [
        ("home", {"axis": "x"}),
        ("move", {"axis": "x", "pulses": 900}),
        ("status", {"axis": "x"}),
        ("trace", {"axis": "x"}),
    ]
    first = [make_box().call(*call).data for call in calls[:1]]
    answers = []
    for _ in range(2):
        box = make_box()
        answers.append([box.call(*call).data for call in calls])
    assert answers[0] == answers[1]
    assert answers[0][:1] == first


def test_a_picture_is_a_png(box):
    pytest.importorskip("matplotlib")
    box.call("move", {"axis": "x", "pulses": 200})
    drawn = box.call("picture")
    assert drawn.png[:8] == b"\x89PNG\r\n\x1a\n"


WRONG_CONSTRUCTIONS = [
    (("stage",), "give a Stage"),
    ((None, "god"), "should be host or truth"),
    ((None, "host", 3), "give Budget"),
]


@pytest.mark.parametrize(("args", "message"), WRONG_CONSTRUCTIONS)
def test_a_toolbox_with_wrong_arguments_is_refused(args, message, box):
    with pytest.raises(ArgumentError, match=message):
        Toolbox(*(box.stage if a is None else a for a in args))


@pytest.mark.parametrize(
    "how", [{"moves": -1}, {"moves": True}, {"cycles": 1.5}, {"seconds": float("nan")}, {"seconds": "x"}]
)
def test_a_budget_is_of_numbers(how):
    with pytest.raises(ArgumentError, match=next(iter(how))):
        Budget(**how)


def test_a_failure_of_ours_is_an_answer_too(box, monkeypatch):
    monkeypatch.setattr(Stage, "run", lambda self, seconds: 1 / 0)
    assert "PulseStage itself has failed (ZeroDivisionError" in box.call("wait", {"seconds": 1}).text


def test_axes_that_drive_one_load_go_home_together():
    """home y on a gantry, whose other motor is w"""
    box = Toolbox(Stage("gantry", visuals=False))
    homed = box.call("home", {"axis": "y"}).data
    assert {name: r["stopped_by"] for name, r in homed["axes"].items()} == {"y": "ORG", "w": "ORG"}
    refused = box.call("home", {"axis": "w", "by": "switch"})
    assert not refused.ok
    assert "axis w drives one load with y" in refused.text


def test_names_are_listed_in_the_order_of_the_axes_whatever_chips_they_have():
    for chips in (("HCTL1100", "PCL240MS"), ("PCL240MS", "HCTL1100")):
        box = Toolbox(Stage("xy", chips=dict(zip("xy", chips, strict=True)), visuals=False))
        for tool in ("read_register", "write_register", "command"):
            listed = box.tools[tool].schema()["properties"]["name"]["enum"]
            first = box.get_axis("x").chip.MAP
            assert listed[0] in {*(r.name for r in first.registers), *(w.name for w in first.words)}, (chips, tool)


@pytest.mark.parametrize("chips", [("PCL240K", "MCX514"), ("MCX514", "PCL240K")])
def test_the_schema_of_home_has_the_methods_of_all_axes(chips):
    """Offer the index method of y although the PCL240K of x supports the switch only."""
    box = Toolbox(Stage("xy", chips=dict(zip("xy", chips, strict=True)), visuals=False))
    assert box.tools["home"].schema()["properties"]["by"]["enum"] == ["switch", "index"]


def test_of_time_that_is_spent_nothing_is_left_and_no_minus_nothing(make_box):
    box = make_box(budget=Budget(seconds=0.03))
    box.call("wait", {"seconds": 0.03})
    assert str(box.meter.list_remaining()["seconds"]) == "0.0"


def test_the_trace_keeps_the_bus_cycles_before_a_restore(box):
    box.call("snapshot", {"name": "start"})
    box.call("write_bytes", {"axis": "x", "address": 0, "values": ["15h"]})
    box.call("restore", {"name": "start"})
    lines = box.call("trace", {"axis": "x"}).text.splitlines()
    written = [k for k, line in enumerate(lines) if "start, ramp to FH1" in line]
    restored = [k for k, line in enumerate(lines) if "the time went back" in line]
    assert len(written) == len(restored) == 1
    assert written < restored


def test_a_restore_is_one_line_of_the_trace(box):
    box.call("move", {"axis": "x", "pulses": 20})
    box.call("restore", {"name": "power-up"})
    assert box.call("trace", {"axis": "x"}).text.count("the time went back") == 1


def test_a_toolbox_that_is_closed_reads_no_further_writes():
    for mode in ("host", "truth"):
        box = Toolbox(Stage("xy", visuals=False), mode, Budget())
        chips = box.stage.chips
        box.close()
        assert [chip.glitches for chip in chips] == [()] * len(chips)
        assert [chip.open_journal for chip in chips] == [None] * len(chips)
