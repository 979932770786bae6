"""Forms say at the field what is wrong, and begin what a program would."""

import re

import pytest

from stage import Stage, firmware
from stage.errors import ArgumentError, StageError
from stage.panel import procedure_forms as procedures
from stage.panel.fault_controls import find_coupled_axes
from stage.panel.procedure_forms import FORMS, FieldError, Jog, find_field, to_field_error
from stage.panel.session import FREE, Session


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", visuals=False)


@pytest.fixture
def fresh(stage):
    stage.reset()
    return stage


def test_a_move_from_a_form_is_the_move_of_a_program(fresh):
    report = FORMS["move"].prepare(fresh, "x", {"distance": "2,5", "speed": "20", "start_speed": "", "accel": "0.1"})(
        fresh
    )
    fresh.reset()
    assert str(report) == str(firmware.move(fresh.axes["x"], 2.5e-3, speed=0.02, accel=0.1))


@pytest.mark.slow
def test_a_report_is_drawn(fresh):
    assert procedures.picture(firmware.move(fresh.axes["x"], 1e-3)).startswith("<svg")


def test_a_line_and_two_rates(fresh):
    line = FORMS["line"].prepare(fresh, "", {"x": "2", "y": "-1"})(fresh)
    assert line.distances == {"x": 640, "y": -320}
    two = FORMS["two_rates"].prepare(fresh, "x", {"distance": "20", "dwell": "0.05"})(fresh)
    assert two.ok
    assert two.procedure == "dual-rate move"
    assert FORMS["two_rates"].prepare(fresh, "x", {"distance": "5", "dwell": "0"}), "at once from one to the other"


def test_a_circle_of_the_chips_that_draw_them(fresh):
    stage = Stage("xy", chips="mcx514", visuals=False)
    form = FORMS["circle"]
    assert form.needs(stage, "x")
    assert not form.needs(fresh, "x")
    order = form.prepare(stage, "", {"radius": "1", "speed": "20", "accel": "0.05"})
    with stage.record(1e-3) as recording:
        report = order(stage)
    farthest = [recording.column(f"{name}/commanded") for name in ("x", "y")]
    assert report.ok
    assert report.pulses == {"x": 0, "y": 0}
    assert farthest[1].max() == pytest.approx(2e-3, abs=1e-5)  # about a centre 1 mm along y
    assert farthest[0].max() == -farthest[0].min() == pytest.approx(1e-3, abs=1e-5)
    with pytest.raises(FieldError) as wrong:
        form.prepare(stage, "", {"radius": "0"})
    assert wrong.value.field == "radius"


@pytest.mark.parametrize(
    ("form", "given", "field"),
    [
        ("move", {"distance": "ten"}, "distance"),
        ("move", {"distance": ""}, "distance"),  # empty is the default only where nobody emptied it
        ("move", {"distance": "inf"}, "distance"),
        ("move", {"distance": "5", "speed": "-3"}, "speed"),
        ("move", {"distance": "5", "speed": "0"}, "speed"),
        ("move", {"distance": "5", "s_curve": "round"}, "s_curve"),
        ("home", {"by": "smell"}, "by"),
        ("line", {"x": "5", "y": "far"}, "y"),
        ("two_rates", {"distance": "5", "fast": "0"}, "fast"),
        ("two_rates", {"distance": "5", "dwell": "-1"}, "dwell"),
    ],
)
def test_what_is_wrong_is_said_at_its_field(fresh, form, given, field):
    with pytest.raises(FieldError) as wrong:
        FORMS[form].prepare(fresh, "x", given)
    assert find_field(wrong.value, FORMS[form].fields(fresh, "x")) == field


def test_what_the_procedure_refuses_is_said_at_its_field(fresh):
    """speed=... from the firmware's own mouth."""
    fields = FORMS["move"].fields(fresh, "x")
    assert find_field(ArgumentError("speed=0: more than 0."), fields) == "speed"
    assert find_field(ArgumentError("distance: there is no room"), fields) == "distance"
    assert find_field(ArgumentError("the chip cannot"), fields) == ""


WRONG = {
    "speed": ("1e9", "1e-9"),
    "start_speed": ("500",),
    "accel": ("1e9",),
    "distance": ("0", "0.0001", "1e30"),
    "fast": ("1e9",),
    "radius": ("0.0001", "1e9"),
    "x": ("1e9",),
}
"""What nobody's chip can, by field."""
COUNTS = re.compile(r"pulses|pps|counts|register|R\d")


@pytest.mark.parametrize("chips", ["pcl240k", "mcx514", "mcx304", "hctl1100"])
def test_what_the_chip_cannot_is_said_at_the_field_in_its_unit(chips):
    stage = Stage("xy", chips=chips, visuals=False)
    x = stage.axes["x"]
    for form in [f for f in FORMS.values() if f.needs(stage, "x")]:
        fields = form.fields(stage, "x")
        for field in fields:
            for text in WRONG.get(field.name, ()):
                given = {"speed": "20", field.name: text} if field.name == "start_speed" else {field.name: text}
                stage.reset()
                with pytest.raises(StageError) as wrong:
                    form.prepare(stage, "x", given)(stage)
                told = to_field_error(wrong.value, x, {f.name: given.get(f.name, f.default) for f in fields}, fields)
                assert find_field(told, fields) == field.name, (form.name, given, str(told))
                assert not COUNTS.search(str(told)), str(told)
                assert field.unit in str(told)


def test_a_jog_into_an_end_limit_says_so(fresh):
    x = fresh.axes["x"]
    fresh.place(x=x.travel[1] - 0.012)
    assert Jog(x, 1, {"speed": "20"}).run(fresh).stopped_by == "EL+"


@pytest.mark.parametrize("chips", ["pcl240k", "mcx514", "hctl1100"])
def test_a_jog_from_an_end_limit_further_on_says_so_and_back_it_goes(chips):
    stage = Stage("xy", chips=chips, visuals=False)
    x = stage.axes["x"]
    stage.place(x=x.travel[1] * 0.985)
    with pytest.raises(StageError, match=r"x stands on its end limit, EL\+, and does not go \+: jog the other way"):
        Jog(x, 1, {"speed": "20"}).run(stage)
    jog = Jog(x, -1, {"speed": "20"})
    jog.release()
    assert jog.run(stage).stopped_by == "decelerating stop"


def test_an_axis_runs_while_a_button_is_held():
    with Session(Stage("xy", visuals=False), speed=FREE, paused=True) as session:
        jog = Jog(session.stage.axes["x"], 1, {"speed": "10"})
        future = session.act("jog x", jog.run)
        session.paused = False
        while session.view.time < 0.5:
            pass
        assert not future.done()
        jog.release()
        report = future.result(20)
    assert report.stopped_by == "decelerating stop"
    assert report.position > 3e-3


def test_the_two_axes_that_carry_a_beam_are_known():
    gantry, plain = Stage("gantry", visuals=False), Stage("xyz", visuals=False)
    assert {name: find_coupled_axes(gantry, name) for name in gantry.axes} == {"y": ["w"], "w": ["y"], "x": []}
    assert not any(find_coupled_axes(plain, name) for name in plain.axes)
