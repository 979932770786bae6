"""Forms say at the field what is wrong, and begin what a program would."""

import pytest

from stage import Stage, firmware
from stage.errors import ArgumentError
from stage.panel import procedures
from stage.panel.procedures import FORMS, Jog, WrongField
from stage.panel.session import FREE, Session


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", visuals=False)


@pytest.fixture
def fresh(stage):
    stage.reset()
    return stage


def test_a_move_from_a_form_is_the_move_of_a_program(fresh):
    report = FORMS["move"].order(fresh, "x", {"distance": "2,5", "speed": "20", "start_speed": "", "accel": "0.1"})(
        fresh
    )
    fresh.reset()
    assert str(report) == str(firmware.move(fresh.axes["x"], 2.5e-3, speed=0.02, accel=0.1))


@pytest.mark.slow
def test_a_report_is_drawn(fresh):
    assert procedures.picture(firmware.move(fresh.axes["x"], 1e-3)).startswith("<svg")


def test_a_line_and_two_rates(fresh):
    line = FORMS["line"].order(fresh, "", {"x": "2", "y": "-1"})(fresh)
    assert line.distances == {"x": 640, "y": -320}
    two = FORMS["two_rates"].order(fresh, "x", {"distance": "20", "dwell": "0.05"})(fresh)
    assert two.ok
    assert two.procedure == "dual-rate move"
    assert FORMS["two_rates"].order(fresh, "x", {"distance": "5", "dwell": "0"}), "at once from one to the other"


def test_a_circle_of_the_chips_that_draw_them(fresh):
    stage = Stage("xy", chips="mcx514", visuals=False)
    form = FORMS["circle"]
    assert form.needs(stage, "x")
    assert not form.needs(fresh, "x")
    order = form.order(stage, "", {"radius": "1", "speed": "20", "accel": "0.05"})
    with stage.record(1e-3) as recording:
        report = order(stage)
    farthest = [recording.column(f"{name}/commanded") for name in ("x", "y")]
    assert report.ok
    assert report.pulses == {"x": 0, "y": 0}
    assert farthest[1].max() == pytest.approx(2e-3, abs=1e-5)  # about a centre 1 mm along y
    assert farthest[0].max() == -farthest[0].min() == pytest.approx(1e-3, abs=1e-5)
    with pytest.raises(WrongField) as wrong:
        form.order(stage, "", {"radius": "0"})
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
        ("line", {"x": "5", "y": ""}, "y"),
        ("two_rates", {"distance": "5", "fast": "0"}, "fast"),
        ("two_rates", {"distance": "5", "dwell": "-1"}, "dwell"),
    ],
)
def test_what_is_wrong_is_said_at_its_field(fresh, form, given, field):
    with pytest.raises(WrongField) as wrong:
        FORMS[form].order(fresh, "x", given)
    assert procedures.where(wrong.value, FORMS[form].fields(fresh, "x")) == field


def test_what_the_procedure_refuses_is_said_at_its_field(fresh):
    """speed=... from the firmware's own mouth."""
    fields = FORMS["move"].fields(fresh, "x")
    assert procedures.where(ArgumentError("speed=0: more than 0."), fields) == "speed"
    assert procedures.where(ArgumentError("distance: there is no room"), fields) == "distance"
    assert procedures.where(ArgumentError("the chip cannot"), fields) == ""


def test_a_jog_into_an_end_limit_says_so(fresh):
    x = fresh.axes["x"]
    fresh.place(x=x.travel[1] - 0.012)
    assert Jog(x, 1, {"speed": "20"}).order(fresh).stopped_by == "EL+"


def test_an_axis_runs_while_a_button_is_held():
    with Session(Stage("xy", visuals=False), speed=FREE, paused=True) as session:
        jog = Jog(session.stage.axes["x"], 1, {"speed": "10"})
        future = session.act("jog x", jog.order)
        session.paused = False
        while session.view.time < 0.5:
            pass
        assert not future.done()
        jog.release()
        report = future.result(20)
    assert report.stopped_by == "decelerating stop"
    assert report.position > 3e-3
