"""In host mode an agent sees what a host could see, and nothing else; in mode truth, everything."""

import json

import pytest

from stage.agents.host_diagnostics import MAX_DIAGNOSTICS
from stage.agents.picture_tool import hide_truth
from stage.firmware.operation_pattern_figure import draw_operation_pattern
from stage.sim import faults

HIDDEN = ("lost_steps", "load_angle", "position", "el_plus", "peak_rate")


def call_all(box, calls):
    return "\n".join(json.dumps(box.call(*call).data) for call in calls)


CALLS = [
    ("describe", {}),
    ("move", {"axis": "x", "pulses": 30_000, "speed": 0.9, "accel": 0.01}),
    *(
        (name, {"axis": "x"} if name in ("status", "trace") else {})
        for name in ("report", "status", "diagnostics", "trace", "budget")
    ),
]


def test_host_mode_hides_lost_steps(box):
    output = call_all(box, CALLS)
    assert box.stage.axes["x"].lost_steps
    assert not [word for word in HIDDEN if word in output]
    assert box.call("report").data["as_asked"]  # the chip made its pulses


def test_truth_mode_reports_lost_steps(make_box):
    box = make_box(mode="truth")
    output = call_all(box, CALLS)
    assert "lost_steps" in output
    assert not box.call("report").data["as_asked"]
    assert box.call("truth").data["axes"]["x"]["lost_steps"]


def test_host_mode_lacks_the_tools_that_read_or_change_the_true_state(box):
    assert not [
        name
        for name in box.tools
        if name.startswith("fault_") or name in ("truth", "peek", "place", "load", "clear_faults")
    ]
    assert "not known" in box.call("truth").text


def test_a_mistake_that_follows_from_a_hidden_pin_is_not_reported(make_box):
    start = [
        *(
            ("write_register", {"axis": "x", "name": name, "value": v})
            for name, v in (("R0", 100), ("R1", 100), ("R7", 30))
        ),
        ("write_bytes", {"axis": "x", "address": 0, "values": ["08h", "44h", "10h"]}),
    ]
    for mode in ("host", "truth"):
        box = make_box(mode=mode)
        with faults.switch_stuck(box.stage.axes["x"], "el_plus", True):
            for call in start:
                assert box.call(*call).ok
            reported = "limit switch" in box.call("diagnostics").text
        assert reported == (mode == "truth")
        assert any("limit switch" in d.message for d in box.stage.axes["x"].chip.diagnostics)


def test_diagnostics_of_the_host_s_own_writes_are_reported(box):
    box.call("write_bytes", {"axis": "x", "address": 0, "values": ["44h", "15h"]})
    assert "R0 = 0" in box.call("diagnostics").text


@pytest.mark.parametrize("mode", ["host", "truth"])
def test_of_many_mistakes_the_last_are_stored(make_box, mode):
    box = make_box(mode=mode)
    chip = box.stage.axes["x"].chip
    for k in range(MAX_DIAGNOSTICS + 40):
        chip.write(0, 0x50 if k < 40 else 0x51)  # bit 4 of a control mode means nothing
    assert [d.value for d in chip.diagnostics] == [0x50] * 40 + [0x51] * MAX_DIAGNOSTICS
    assert [d.value for d in box.diagnostics[0].list_all()] == [0x51] * MAX_DIAGNOSTICS


def test_a_write_that_was_lost_resembles_any_other(make_box):
    for mode in ("host", "truth"):
        box = make_box(mode=mode)
        with faults.lost_write(box.stage.axes["x"], value=0x44):
            box.call("move", {"axis": "x", "pulses": 400, "timeout": 0.2})
        assert ("lost" in box.call("trace", {"axis": "x", "lines": 500}).text) == (mode == "truth")


def test_a_drawing_for_a_host_has_the_lanes_that_registers_show(box):
    pytest.importorskip("matplotlib")
    box.call("home", {"axis": "x"})
    report = box.report
    full = {t.get_text() for axes in draw_operation_pattern(report).axes for t in axes.get_yticklabels()}
    observed = {
        t.get_text()
        for axes in draw_operation_pattern(hide_truth(report), pins=box.diagnostics[0].readable).axes
        for t in axes.get_yticklabels()
    }
    assert observed < full
    assert hide_truth(report).lost_steps is None


def test_truth_mode_has_a_tool_for_each_fault(make_box):
    box = make_box(mode="truth")
    assert box.call("fault_switch_stuck", {"axis": "x", "pin": "org", "closed": False}).data["faults"] == [
        "axis x: org stuck open"
    ]
    assert box.call("fault_bus_voltage", {"axis": "x", "volts": 5}).ok is False or box.stage.faults
    assert box.call("clear_faults", {"all": True}).data["faults"] == []
    assert "No fault that you made" in box.call("clear_faults").text
    assert "Did you mean 'org'" in box.call("fault_switch_stuck", {"axis": "x", "pin": "orgg", "closed": True}).text


def test_the_last_fault_is_repaired_first(make_box):
    box = make_box(mode="truth")
    box.call("fault_jam", {"axis": "x"})
    box.call("fault_phase_open", {"axis": "y", "phase": "b"})
    assert box.call("clear_faults").data["faults"] == ["axis x: jammed"]
    assert box.call("clear_faults").data["faults"] == []


def test_two_faults_of_one_kind_are_repaired_to_what_was_before_both(make_box):
    box = make_box(mode="truth")
    dof = box.stage.axes["x"].plant.dof
    friction = float(box.stage.model.dof_frictionloss[dof])
    for force in (5.0, 7.0):
        box.call("fault_jam", {"axis": "x", "force": force})
    assert box.stage.model.dof_frictionloss[dof] == friction + 12.0
    box.call("clear_faults", {"all": True})
    assert box.stage.model.dof_frictionloss[dof] == friction


def test_tools_load_and_place(make_box):
    box = make_box(mode="truth")
    assert box.call("load", {"mass": 2}).data["payload_kg"] == 2
    assert box.call("place", {"axis": "x", "position": "20mm"}).data["position"] == pytest.approx(0.02)
    assert "travels" in box.call("place", {"axis": "x", "position": 5}).text
    assert box.call("peek", {"axis": "x"}).data["values"]["R1"] == 0
    box.call("load", {"mass": 0})
