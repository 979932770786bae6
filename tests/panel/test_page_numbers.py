"""Numbers and words of the page: texts of forms become SI units, and what a page writes and draws."""

from math import radians
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("nicegui")
from stage import Stage
from stage.errors import ArgumentError
from stage.panel import oscilloscope_page as chart
from stage.panel import page as transport
from stage.panel.fault_controls import find_max_push
from stage.panel.page import format_position
from stage.panel.procedure_forms import (
    Field,
    FieldError,
    find_field,
    find_scale,
    parse_distance,
    parse_fields,
    parse_speeds,
)
from stage.panel.session import FREE
from stage.panel.stage_thread import describe_escape


@pytest.mark.parametrize(
    ("paused", "speed", "pace", "says"),
    [
        (True, 1.0, 0.0, "stands still"), (False, 1.0, 0.96, "0.96 x"), (False, 1.0, 0.94, "0.94 x, cannot keep up"),
        (False, 2.0, 1.0, "1.00 x, cannot keep up"), (False, FREE, 0.5, "0.50 x"),
    ],
)  # fmt: skip
def test_a_stage_cannot_keep_up_where_it_lags_by_more_than_a_twentieth(paused, speed, pace, says):
    session = SimpleNamespace(paused=paused, speed=speed, view=SimpleNamespace(achieved_speed=pace))
    assert transport._pace(session) == says


def test_a_curve_is_sent_with_both_ends_of_what_is_level_and_six_digits():
    needed = chart._corners(np.array([0, 0, 0, 5, 5, 5, 2, 2.0]))
    assert np.flatnonzero(needed).tolist() == [0, 2, 3, 5, 6, 7]
    assert chart._significant(np.array([123_456.789, -0.04]), 9).tolist() == [123_457.0, 0.0]
    assert chart._significant(np.array([0.00123456789, 0.0]), 9).tolist() == [0.00123457, 0.0]
    assert chart._significant(np.zeros(2), 9).tolist() == [0.0, 0.0]


def test_a_carriage_that_rests_is_a_level_line_whatever_the_arithmetic_leaves(sampler):
    rests = {name: t for name, t in sampler.traces.items() if not t.pin}
    drawn = {name: chart._significant(np.array([-3e-10, 2e-10]), t.places).tolist() for name, t in rests.items()}
    assert set(map(str, drawn.values())) == {"[0.0, 0.0]"}
    micron = chart._significant(np.array([40.0, 40.001]), rests["x/position"].places)
    assert np.diff(micron) == pytest.approx(0.001)


@pytest.fixture(scope="module")
def axes():
    return Stage("xya", visuals=False).axes


def test_a_place_is_told_in_the_unit_of_its_axis():
    said = format_position("m", 0.0123456, 0.0125, -4).splitlines()
    assert [line.split()[-2:] for line in said[:3]] == [["12.3456", "mm"], ["12.5000", "mm"], ["0.1544", "mm"]]
    assert said[3].split() == ["lost", "steps", "-4"]
    turned = format_position("rad", radians(-30), radians(-30.5), 0).splitlines()
    assert [line.split()[-2:] for line in turned[:3]] == [["-30.0000", "deg"], ["-30.5000", "deg"], ["-0.5000", "deg"]]


def test_texts_of_a_form_are_numbers_with_a_point_or_a_comma():
    fields = [Field("a", "A", "mm", "3"), Field("b", "B"), Field("c", "C", choices=("x", "y"), default="y")]
    assert parse_fields(fields, {"a": " 2,5 ", "b": ""}) == {"a": 2.5, "c": "y"}
    assert parse_fields(fields, {"b": "-1e3", "c": "x", "more": "1"}) == {"a": 3.0, "b": -1000.0, "c": "x"}
    for given, name, said in (
        ({"a": "two"}, "a", "'two' is not a number of mm."),
        ({"b": "two"}, "b", "'two' is not a number."),
        ({"b": "inf"}, "b", "'inf': a finite number."),
        ({"c": "z"}, "c", "'z': x, y."),
    ):
        with pytest.raises(FieldError) as wrong:
            parse_fields(fields, given)
        assert (wrong.value.field, str(wrong.value), find_field(wrong.value, fields)) == (name, said, name)
    assert [find_field(ArgumentError(t), fields) for t in ("b=3: no.", "b: no.", "bb: no.", "no b")] == [
        "b",
        "b",
        "",
        "",
    ]


@pytest.mark.parametrize(("name", "unit", "k"), [("x", "mm", 1e-3), ("a", "deg", radians(1))])
def test_distances_and_speeds_of_people_are_metres_and_radians(axes, name, unit, k):
    axis = axes[name]
    pulse = axis.meters_per_pulse / k
    assert find_scale(axis) == (unit, pytest.approx(k))
    assert parse_distance(axis, "distance", -2.0) == pytest.approx(-2 * k)
    assert parse_distance(axis, "distance", 0.6 * pulse) == pytest.approx(0.6 * axis.meters_per_pulse)
    most = (10 if name == "x" else 100) * (axis.travel[1] - axis.travel[0]) / k
    assert parse_distance(axis, "distance", -most) == pytest.approx(-most * k)
    for wrong, said in ((0.4 * pulse, "less than a pulse"), (-1.01 * most, f"up to {most:g} {unit}")):
        with pytest.raises(FieldError, match=said.replace(".", r"\.").replace("+", r"\+")):
            parse_distance(axis, "distance", wrong)
    made = parse_speeds(axis, {"speed": 3.0, "start_speed": 0.5, "accel": 0.2, "other": 9})
    assert made == pytest.approx({"speed": 3 * k, "start_speed": 0.5 * k, "accel": 0.2})
    assert parse_speeds(axis, {"accel": 60.0, "speed": 1.01 * pulse})["accel"] == 60
    for given, field, said in (
        ({"speed": 0.0}, "speed", "more than 0"),
        ({"accel": 60.1}, "accel", "up to 60 s"),
        ({"accel": -1.0}, "accel", "more than 0"),
        ({"start_speed": 0.9 * pulse}, "start_speed", f"{unit}/s, a pulse a second, or more"),
    ):
        with pytest.raises(FieldError, match=said) as wrong:
            parse_speeds(axis, given)
        assert wrong.value.field == field


def test_a_carriage_is_out_of_its_travel_beyond_a_tenth_of_it_on_either_side():
    stage = Stage("xya", visuals=False)
    for name in ("x", "y"):
        axis = stage.axes[name]
        low, high = axis.travel
        for at, out in (
            (low - 0.099 * (high - low), False), (low - 0.101 * (high - low), True),
            (high + 0.099 * (high - low), False), (high + 0.101 * (high - low), True), (0.0, False),
        ):  # fmt: skip
            stage.data.qpos[axis.plant.qpos] = at
            assert bool(describe_escape(stage)) == out
            assert describe_escape(stage).startswith(f"{name} is out of its travel") == out
    stage.data.qpos[stage.axes["a"].plant.qpos] = 1e3
    assert describe_escape(stage) == "", "a table turns without end"
    x = stage.axes["x"]
    assert find_max_push(x) == pytest.approx(2 * x.drive.peak_torque * abs(x.gear))
    assert np.isfinite(find_max_push(x))
