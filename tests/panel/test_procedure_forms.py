"""What a form begins: the procedure with what was typed, in metres and seconds; and what a trace and a look say in between."""

from types import SimpleNamespace

import pytest
from support.mirrored import mirrored

from stage import Stage
from stage.chips import MCX514, PCL240K
from stage.panel import procedure_forms as forms
from stage.panel.procedure_forms import FORMS, FieldError, Jog
from stage.panel.session import FREE, Session
from stage.panel.stage_observer import Line, StageObserver


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", chips=MCX514, visuals=False)


@pytest.fixture
def begun(stage, monkeypatch):
    """begun(form, texts) -> (name, arguments, options) of what the stage's thread does."""
    told = []

    def noting(name):
        return lambda *given, **how: told.append((name, given, how))

    for name in ("move", "home", "line", "stop"):
        monkeypatch.setattr(forms.procedures, name, noting(name))
    real = forms.driver_of

    def driver_of(axis):
        made = SimpleNamespace(axis=axis.name, two_rates=noting("two_rates"), circle=noting("circle"))
        made.homings = real(axis).homings
        return made

    def begin(name, axis="x", **given):
        told.clear()
        order = FORMS[name].prepare(stage, axis, given)
        assert not told, "nothing is done before its turn"
        monkeypatch.setattr(forms, "driver_of", driver_of)
        order(stage)
        monkeypatch.setattr(forms, "driver_of", real)
        return told[0]

    begin.told = told
    return begin


def test_a_move_is_as_it_was_typed_and_else_the_usual(begun, stage):
    name, (axis, distance), how = begun("move")
    assert (name, axis.name, distance, how) == ("move", "x", pytest.approx(0.01), {"s_curve": False, "accel": 0.15})
    typed = {"distance": "-2,5", "speed": "10", "start_speed": "1", "accel": "0.2", "s_curve": "S-curve"}
    _, (axis, distance), how = begun("move", "y", **typed)
    assert (axis.name, distance) == ("y", pytest.approx(-0.0025))
    assert how == {"s_curve": True, "speed": pytest.approx(0.01), "start_speed": pytest.approx(0.001), "accel": 0.2}
    with pytest.raises(FieldError, match="say how far") as wrong:
        begun("move", distance=" ")
    assert wrong.value.field == "distance"


def test_two_rates_are_pulses_a_second_each_for_its_time(begun, stage):
    per_pulse = stage.axes["x"].meters_per_pulse
    name, (pulses, speeds, fast, dwell), _ = begun("two_rates")
    assert (name, pulses, dwell) == ("two_rates", round(0.04 / per_pulse), 0.2)
    assert (speeds.drive, fast) == pytest.approx((0.02 / per_pulse, 0.04 / per_pulse))
    typed = {"distance": "-8", "speed": "5", "fast": "15", "dwell": "0", "accel": "0.3"}
    _, (pulses, speeds, fast, dwell), _ = begun("two_rates", **typed)
    assert (pulses, dwell) == (-round(0.008 / per_pulse), 0.0)
    assert (speeds.drive, speeds.up, fast) == pytest.approx((0.005 / per_pulse, 0.3, 0.015 / per_pulse))
    for given, field in (({"fast": "0"}, "fast"), ({"dwell": "-0.1"}, "dwell")):
        with pytest.raises(FieldError) as wrong:
            begun("two_rates", **given)
        assert wrong.value.field == field


def test_an_origin_lies_where_it_was_said_to(begun, stage):
    name, (axis, direction), how = begun("home")
    assert (name, axis.name, direction, how["accel"]) == ("home", "x", -1, 0.15)
    ways = FORMS["home"].fields(stage, "x")[1].choices
    assert how["by"] == ways[0]
    for by in ways:
        _, (axis, direction), how = begun("home", "y", direction="plus", by=by, speed="20")
        assert (axis.name, direction, how["by"], how["speed"]) == ("y", 1, by, pytest.approx(0.02))


def test_a_line_is_of_the_axes_that_have_a_distance(begun):
    name, (distances, axes), how = begun("line", x="1", y="-2,5", speed="8", accel="0.4")
    assert (name, list(axes)) == ("line", ["x", "y"])
    assert distances == pytest.approx({"x": 0.001, "y": -0.0025})
    assert how == {"speed": pytest.approx(0.008), "accel": 0.4}
    for given, moving in (({"x": "", "y": "2"}, "y"), ({"x": "2", "y": "0"}, "x")):
        _, (distances, axes), _ = begun("line", **given)
        assert distances == pytest.approx({moving: 0.002})
        assert list(axes) == ["x", "y"]
    for given in ({"x": "", "y": ""}, {"x": "0", "y": ""}):
        with pytest.raises(FieldError, match="nothing moves: give at least one axis a distance") as wrong:
            begun("line", **given)
        assert wrong.value.field == "x"


def test_a_circle_goes_round_by_its_radius_whatever_its_sign(begun, stage):
    per_pulse = stage.axes["x"].meters_per_pulse
    for typed, radius in (("5", 0.005), ("-2", -0.002)):
        name, (second, pulses, speeds), _ = begun("circle", radius=typed, speed="4")
        assert (name, second.axis, pulses) == ("circle", "y", round(radius / per_pulse))
        assert speeds.drive == pytest.approx(0.004 / per_pulse)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_jog_runs_the_way_of_its_button_until_it_is_released(direction):
    stage = Stage("xy", chips=PCL240K, visuals=False)
    jog = Jog(stage.axes["x"], direction, {"speed": "5", "accel": "0.05"})
    jog._released = SimpleNamespace(is_set=lambda: stage.time > 0.2)
    report = jog.run(stage)
    assert 0.2 < stage.time < 0.4
    assert report.pulses * direction > 0
    assert (report.stopped_by, stage.axes["x"].chip.busy(0)) == ("decelerating stop", False)
    with pytest.raises(FieldError, match="more than 0"):
        Jog(stage.axes["x"], direction, {"speed": "0"})


def test_a_line_of_a_trace_says_when_where_and_what():
    read = Line(3, 1.5, "R", 0, 0x40, "status", times=12, first=1)
    assert read.text(2) == "   1.500000  R  0: 40  status  x 12"
    assert read._replace(times=1).text(4) == "   1.500000  R  0: 0040  status"
    assert Line(1, 0.25, "!", 2, 1, "wrong", "sheet, p. 3").text(2) == "   0.250000  !  wrong [sheet, p. 3]"
    assert Line(1, 0.25, "reset", 0, 0, "the reset pin").text(2) == "   0.250000  reset  the reset pin"
    assert Line(1, 2.0, "W", 0x1F, 0xA, "x").text(2) == "   2.000000  W 1F: 0A  x"


@pytest.mark.parametrize("turned", [False, True])
def test_steps_lost_before_the_origin_was_found_are_none_and_the_field_is_where_the_carriage_is(tmp_path, turned):
    stage = Stage(mirrored(tmp_path) if turned else "xy", chips=PCL240K, visuals=False)
    with Session(stage, speed=FREE, paused=True) as session:
        look = StageObserver(session)
        x, tooth = stage.axes["x"], 64 * stage.axes["x"].meters_per_pulse

        def drag(stage):
            stage.data.qpos[x.plant.qpos] += 3 * tooth
            session.run_unpaced(stage.run, 0.3)
            look.observe(stage)

        session.do(drag)
        lost = look.axes["x"].lost
        assert abs(lost) == 12
        assert look.axes["x"].commanded - look.axes["x"].position == pytest.approx(-3 * tooth, abs=0.1 * tooth)
        session.do(lambda stage: look.note_origin("x", stage))
        session.do(look.observe)
        assert look.axes["x"].lost == 0
        assert look.axes["x"].commanded == pytest.approx(look.axes["x"].position, abs=0.1 * tooth)
        session.do(drag)
        assert look.axes["x"].lost == lost, "since then"
        session.reset()
        session.do(look.observe)
        assert look.axes["x"].lost == 0
        assert look._origins == {}
        look.close()
