"""Forms begin the procedures of stage.firmware with what was typed, in SI units, and say at the field what is wrong."""

import re
from math import radians
from types import SimpleNamespace

import pytest

from stage import Stage, firmware
from stage.chips import MCX514, PCL240K
from stage.errors import ArgumentError, StageError
from stage.panel import procedure_forms as forms
from stage.panel.fault_controls import find_coupled_axes
from stage.panel.procedure_forms import (
    FORMS,
    FieldError,
    FormField,
    Jog,
    find_display_unit,
    find_field,
    parse_fields,
    to_field_error,
)
from stage.panel.session import UNPACED_SPEED, Session


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", chips=MCX514, visuals=False)


@pytest.fixture(scope="module")
def pcl_stage():
    return Stage("xy", visuals=False)


@pytest.fixture
def fresh(pcl_stage):
    pcl_stage.reset()
    return pcl_stage


@pytest.fixture
def begin(stage, monkeypatch):
    """begin(form, axis, texts) -> (name, arguments, options) of the procedure that the stage's thread calls."""
    calls = []

    def noting(name):
        return lambda *args, **kwargs: calls.append((name, args, kwargs))

    for name in ("move", "move_at_two_rates", "home", "line"):
        monkeypatch.setattr(forms.procedures, name, noting(name))
    real = forms.get_driver

    def get_driver(axis):
        return SimpleNamespace(axis=axis.name, draw_circle=noting("circle"), homings=real(axis).list_homing_methods)

    def begin(name, axis="x", **texts):
        calls.clear()
        order = FORMS[name].prepare(stage, axis, texts)
        assert not calls, "nothing is done before its turn"
        monkeypatch.setattr(forms, "get_driver", get_driver)
        order(stage)
        monkeypatch.setattr(forms, "get_driver", real)
        return calls[0]

    return begin


def test_a_move_is_as_it_was_typed_and_else_the_usual(begin):
    name, (axis,), options = begin("move")
    assert (name, axis.name) == ("move", "x")
    assert options == {"distance": pytest.approx(0.01), "s_curve": False, "accel": 0.15}
    typed = {"distance": "-2,5", "speed": "10", "start_speed": "1", "accel": "0.2", "s_curve": "S-curve"}
    _, (axis,), options = begin("move", "y", **typed)
    assert axis.name == "y"
    assert options == pytest.approx(
        {"distance": -0.0025, "s_curve": True, "speed": 0.01, "start_speed": 0.001, "accel": 0.2}
    )


def test_two_rates_are_the_drive_speeds_each_for_its_time(begin, stage):
    per_pulse = stage.axes["x"].meters_per_pulse
    name, (axis, distance), options = begin("two_rates")
    assert (name, axis.name, distance, options["dwell"]) == ("move_at_two_rates", "x", pytest.approx(0.04), 0.2)
    assert (options["speed"].drive, options["speed"].second) == pytest.approx((0.02 / per_pulse, 0.04 / per_pulse))
    typed = {"distance": "-8", "speed": "5", "fast": "15", "dwell": "0", "accel": "0.3"}
    _, (axis, distance), options = begin("two_rates", **typed)
    assert (distance, options["dwell"]) == (pytest.approx(-0.008), 0.0)
    first, second = 0.005 / per_pulse, 0.015 / per_pulse
    assert (options["speed"].drive, options["speed"].second) == pytest.approx((first, second))
    assert options["speed"].up == pytest.approx(0.3 * second / first), "both ramps are as steep"


def test_an_origin_return_has_the_selected_direction_and_method(begin, stage):
    name, (axis,), options = begin("home")
    homings = FORMS["home"].list_fields(stage, "x")[1].choices
    assert (name, axis.name) == ("home", "x")
    assert options == {"direction": -1, "by": homings[0], "accel": 0.15}
    for by in homings:
        _, (axis,), options = begin("home", "y", direction="plus", by=by, speed="20")
        assert axis.name == "y"
        assert options == {"direction": 1, "by": by, "speed": pytest.approx(0.02), "accel": 0.15}


def test_a_line_is_of_the_axes_that_have_a_distance(begin):
    name, (distances, axes), options = begin("line", x="1", y="-2,5", speed="8", accel="0.4")
    assert (name, list(axes)) == ("line", ["x", "y"])
    assert distances == pytest.approx({"x": 0.001, "y": -0.0025})
    assert options == {"speed": pytest.approx(0.008), "accel": 0.4}
    for texts, moving in (({"x": "", "y": "2"}, "y"), ({"x": "2", "y": "0"}, "x")):
        _, (distances, axes), _ = begin("line", **texts)
        assert distances == pytest.approx({moving: 0.002})
        assert list(axes) == ["x", "y"]
    for texts in ({"x": "", "y": ""}, {"x": "0", "y": ""}):
        with pytest.raises(FieldError, match="nothing moves: give at least one axis a distance") as error:
            begin("line", **texts)
        assert error.value.field == "x"


def test_a_circle_has_its_radius_whatever_the_sign(begin, stage):
    per_pulse = stage.axes["x"].meters_per_pulse
    for typed, radius in (("5", 0.005), ("-2", -0.002)):
        name, (second, pulses, speeds), _ = begin("circle", radius=typed, speed="4")
        assert (name, second.axis, pulses) == ("circle", "y", round(radius / per_pulse))
        assert speeds.drive == pytest.approx(0.004 / per_pulse)


def test_a_move_from_a_form_is_the_move_of_a_program(fresh):
    texts = {"distance": "2,5", "speed": "20", "start_speed": "", "accel": "0.1"}
    report = FORMS["move"].prepare(fresh, "x", texts)(fresh)
    fresh.reset()
    assert str(report) == str(firmware.move(fresh.axes["x"], 2.5e-3, speed=0.02, accel=0.1))


def test_a_line_and_two_rates_do_what_they_say(fresh):
    line = FORMS["line"].prepare(fresh, "", {"x": "2", "y": "-1"})(fresh)
    assert line.distances == {"x": 640, "y": -320}
    two = FORMS["two_rates"].prepare(fresh, "x", {"distance": "20", "dwell": "0.05"})(fresh)
    assert (two.ok, two.procedure) == (True, "dual-rate move")


def test_a_circle_is_drawn_by_the_chips_that_can(fresh):
    stage, form = Stage("xy", chips="mcx514", visuals=False), FORMS["circle"]
    assert form.is_available(stage, "x")
    assert not form.is_available(fresh, "x")
    order = form.prepare(stage, "", {"radius": "1", "speed": "20", "accel": "0.05"})
    with stage.record(1e-3) as recording:
        report = order(stage)
    x, y = (recording.column(f"{name}/commanded") for name in ("x", "y"))
    assert (report.ok, report.pulses) == (True, {"x": 0, "y": 0})
    assert y.max() == pytest.approx(2e-3, abs=1e-5)  # about a center 1 mm along y
    assert (x.min(), x.max()) == pytest.approx((-1e-3, 1e-3), abs=1e-5)


@pytest.mark.slow
def test_a_report_is_drawn(fresh):
    assert forms.render_operation_pattern_svg(firmware.move(fresh.axes["x"], 1e-3)).startswith("<svg")


# --- fields ---


def test_texts_of_a_form_are_numbers_with_a_point_or_a_comma():
    fields = [FormField("a", "A", "mm", "3"), FormField("b", "B"), FormField("c", "C", choices=("x", "y"), default="y")]
    assert parse_fields(fields, {"a": " 2,5 ", "b": "", "c": ""}) == {"a": 2.5, "c": "y"}
    assert parse_fields(fields, {"b": "-1e3", "c": "x", "more": "1"}) == {"a": 3.0, "b": -1000.0, "c": "x"}
    assert parse_fields([FormField("n", "N", is_whole=True)], {"n": "10h"}) == {"n": 16}


@pytest.mark.parametrize(
    ("field", "text", "message"),
    [
        (FormField("a", "A", "mm"), "two", "'two' is not a number of mm."),
        (FormField("a", "A"), "two", "'two' is not a number."),
        (FormField("a", "A"), "inf", "'inf' is not a finite number."),
        (FormField("a", "A", choices=("x", "y")), "z", "'z': x, y."),
        (FormField("a", "A", is_whole=True), "2.5", "'2.5' is not a whole number: 16, 0x10 or 10h."),
        (FormField("a", "A", missing="say how far."), " ", "say how far."),
        (FormField("a", "A", "s", least=0, most=3, allowed="0 to 3 s"), "-1", "-1 s: 0 to 3 s."),
        (FormField("a", "A", "s", least=1, most=3, allowed="1 to 3 s", is_signed=True), "-4", "-4 s: 1 to 3 s."),
    ],
)
def test_a_text_that_does_not_fit_is_refused_at_its_field(field, text, message):
    with pytest.raises(FieldError) as error:
        parse_fields([field], {"a": text})
    assert (error.value.field, str(error.value), find_field(error.value, [])) == ("a", message, "a")


def test_an_error_that_begins_with_the_name_of_a_field_is_about_it():
    fields = [FormField("speed", "speed"), FormField("b", "b")]
    texts = ("speed=0: more than 0.", "b: there is no room", "bb: no.", "the chip cannot")
    assert [find_field(ArgumentError(t), fields) for t in texts] == ["speed", "b", "", ""]


@pytest.mark.parametrize(("name", "unit", "scale", "travels"), [("x", "mm", 1e-3, 10), ("a", "deg", radians(1), 100)])
def test_distances_and_speeds_are_typed_in_mm_or_degrees_within_their_bounds(name, unit, scale, travels):
    axis = Stage("xya", visuals=False).axes[name]
    pulse, limit = axis.meters_per_pulse / scale, travels * (axis.travel[1] - axis.travel[0]) / scale
    assert find_display_unit(axis) == (unit, pytest.approx(scale))
    fields = [forms.build_distance_field(axis, "distance", "distance", ""), *forms.list_speed_fields(axis)]
    good = {"distance": f"{-0.999 * limit}", "speed": "3", "start_speed": f"{1.01 * pulse}", "accel": "60"}
    assert parse_fields(fields, good) == pytest.approx(
        {"distance": -0.999 * limit * scale, "speed": 3 * scale, "start_speed": 1.01 * pulse * scale, "accel": 60}
    )
    assert parse_fields(fields, {"distance": f"{0.6 * pulse}"})["distance"] == pytest.approx(0.6 * pulse * scale)
    for field, value, message in (
        ("distance", 0.4 * pulse, "at least one pulse"),
        ("distance", -1.01 * limit, f"up to {limit:g} {unit}, {travels} times the travel of {name}"),
        ("speed", 0, "more than 0"),
        ("start_speed", 0.9 * pulse, f"one pulse a second, {pulse:.3g} {unit}/s, or more"),
        ("accel", 60.1, "up to 60 s"),
        ("accel", -1, "more than 0"),
    ):
        with pytest.raises(FieldError, match=re.escape(message)) as error:
            parse_fields(fields, {field: f"{value}"})
        assert error.value.field == field


@pytest.mark.parametrize(
    ("form", "texts", "field"),
    [
        ("move", {"distance": "ten"}, "distance"),
        ("move", {"distance": ""}, "distance"),
        ("move", {"distance": "5", "speed": "0"}, "speed"),
        ("move", {"distance": "5", "s_curve": "round"}, "s_curve"),
        ("home", {"by": "smell"}, "by"),
        ("line", {"x": "5", "y": "far"}, "y"),
        ("two_rates", {"distance": "5", "fast": "0"}, "fast"),
        ("two_rates", {"distance": "5", "fast": ""}, "fast"),
        ("two_rates", {"distance": "5", "dwell": "-1"}, "dwell"),
        ("circle", {"radius": "0"}, "radius"),
    ],
)
def test_a_form_says_at_the_field_what_is_wrong(stage, form, texts, field):
    with pytest.raises(FieldError) as error:
        FORMS[form].prepare(stage, "x", texts)
    assert find_field(error.value, FORMS[form].list_fields(stage, "x")) == field


IMPOSSIBLE = {
    "speed": ("1e9", "1e-9"), "start_speed": ("500",), "accel": ("1e9",), "distance": ("0", "0.0001", "1e30"),
    "fast": ("1e9",), "radius": ("0.0001", "1e9"), "x": ("1e9",),
}  # fmt: skip
"""Texts that no chip can do, by field."""
COUNTS = re.compile(r"pulses|pps|counts|register|R\d")


@pytest.mark.parametrize("chips", ["pcl240k", "mcx514", "mcx304", "hctl1100"])
def test_a_limit_of_the_chip_is_an_error_at_the_field_in_its_unit(chips):
    stage = Stage("xy", chips=chips, visuals=False)
    x = stage.axes["x"]
    for form in [f for f in FORMS.values() if f.is_available(stage, "x")]:
        fields = form.list_fields(stage, "x")
        for field in fields:
            for text in IMPOSSIBLE.get(field.name, ()):
                texts = {"speed": "20", field.name: text} if field.name == "start_speed" else {field.name: text}
                stage.reset()
                with pytest.raises(StageError) as error:
                    form.prepare(stage, "x", texts)(stage)
                all_texts = {f.name: texts.get(f.name, f.default) for f in fields}
                converted = to_field_error(error.value, x, all_texts, fields)
                assert find_field(converted, fields) == field.name, (form.name, texts, str(converted))
                assert not COUNTS.search(str(converted)), str(converted)
                assert field.unit in str(converted)


# --- jog ---


@pytest.mark.parametrize("direction", [1, -1])
def test_a_jog_runs_in_the_direction_of_its_button_until_it_is_released(direction):
    stage = Stage("xy", chips=PCL240K, visuals=False)
    jog = Jog(stage.axes["x"], direction, {"speed": "5", "accel": "0.05"})
    jog._released = SimpleNamespace(is_set=lambda: stage.time > 0.2)
    report = jog.run(stage)
    assert 0.2 < stage.time < 0.4
    assert report.pulses * direction > 0
    assert (report.stopped_by, stage.axes["x"].chip.busy(0)) == ("decelerating stop", False)
    with pytest.raises(FieldError, match="more than 0"):
        Jog(stage.axes["x"], direction, {"speed": "0"})


def test_a_jog_into_an_end_limit_reports_it(fresh):
    x = fresh.axes["x"]
    fresh.place(x=x.travel[1] - 0.012)
    assert Jog(x, 1, {"speed": "20"}).run(fresh).stopped_by == "EL+"


@pytest.mark.parametrize("chips", ["pcl240k", "mcx514", "hctl1100"])
def test_a_jog_from_an_end_limit_runs_in_the_other_direction_only(chips):
    stage = Stage("xy", chips=chips, visuals=False)
    x = stage.axes["x"]
    stage.place(x=x.travel[1] * 0.985)
    with pytest.raises(StageError, match=r"x stands on its end limit, EL\+, and does not go \+: jog the other way"):
        Jog(x, 1, {"speed": "20"}).run(stage)
    jog = Jog(x, -1, {"speed": "20"})
    jog.release()
    assert jog.run(stage).stopped_by == "decelerating stop"


def test_an_axis_runs_in_a_session_until_release():
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
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
    gantry, unmodified = Stage("gantry", visuals=False), Stage("xyz", visuals=False)
    assert {name: find_coupled_axes(gantry, name) for name in gantry.axes} == {"y": ["w"], "w": ["y"], "x": []}
    assert not any(find_coupled_axes(unmodified, name) for name in unmodified.axes)
