"""Texts of forms become numbers in SI units."""

from math import radians

import numpy as np
import pytest

from stage import Stage
from stage.errors import ArgumentError
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
from stage.panel.stage_thread import describe_escape


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
