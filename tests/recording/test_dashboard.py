"""The dashboard of a recording: what each view shows, where the eye is, the grid on the floor, and the titles with their units."""

from __future__ import annotations

import math
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from stage import Drive
from stage.chips import HCTL1100, MCX501, PCL240K
from stage.drives.dc_motors import Servo
from stage.recording.axis_series import SERIES, make_plot_title, select_series
from stage.recording.recording import find_column_unit
from stage.recording.rerun_blueprint import BACKGROUND, MARGIN, build_dashboard, find_eye

pytest.importorskip("rerun")
FLOOR = '<geom type="plane" size="0 0 1" pos="0.3 0.2 -0.4"/>'
MODEL = """<mujoco><visual><global azimuth="30" elevation="-20" fovy="40"/></visual><statistic center="1 2 3" extent="{extent}"/>
<worldbody>{world}<body><joint type="slide"/><geom size=".1"/></body></worldbody></mujoco>"""


def model_of(world="", extent=2.0):
    return mujoco.MjModel.from_xml_string(MODEL.format(world=world, extent=extent))


def axis(chip, unit="m"):
    return SimpleNamespace(chip=chip, unit=unit, drive=Servo() if chip is HCTL1100 else Drive())


def recording_of(model=None, **axes):
    return SimpleNamespace(model=model or model_of(), axes=axes)


def views(part):
    """List the views of a blueprint by name, in order."""
    result = {}
    for inner in part.contents:
        if isinstance(getattr(inner, "contents", None), tuple | list) and type(inner).__name__ in (
            "Horizontal",
            "Vertical",
            "Tabs",
        ):
            result |= views(inner)
        else:
            result[inner.name] = inner
    return result


def test_every_axis_has_its_plots_and_lanes_and_no_plot_is_of_nobody():
    """a stepper and a servo on a hinge; then two steppers, which have no voltage and no current"""
    mixed = views(build_dashboard(recording_of(x=axis(PCL240K), a=axis(HCTL1100, "rad"))).root_container)
    assert {name: list(view.contents) for name, view in mixed.items() if name not in ("Stage", "About")} == {
        "Phases and switches": [
            "+ /axes/x/phase", "+ /axes/x/switches", "+ /axes/a/phase", "+ /axes/a/switches", "+ /faults",
        ],
        "Axis x": ["+ /axes/x/phase", "+ /axes/x/switches/**", "- /axes/x/switches"],
        "Axis a": ["+ /axes/a/phase", "+ /axes/a/switches/**", "- /axes/a/switches"],
        "Pulse rate (pps | counts/s): x red, a green": ["+ /axes/x/rate", "+ /axes/a/rate"],
        "Position (mm | deg), commanded darker": [
            "+ /axes/x/position", "+ /axes/a/position", "+ /axes/x/commanded", "+ /axes/a/commanded",
        ],
        "Following error (um | mdeg)": ["+ /axes/x/following_error", "+ /axes/a/following_error"],
        "Motor voltage (V)": ["+ /axes/a/voltage"],
        "Motor current (A)": ["+ /axes/a/current"],
        "Load angle (electrical deg)": ["+ /axes/x/load_angle"],
        "Lost steps (full steps)": ["+ /axes/x/lost_steps"],
        "Counter R0 (pulses | counts)": ["+ /axes/x/counter", "+ /axes/a/counter"],
        "Bus": ["+ /axes/x/bus", "+ /axes/a/bus", "+ /faults/log"],
    }  # fmt: skip
    steppers = views(build_dashboard(recording_of(x=axis(PCL240K), y=axis(PCL240K))).root_container)
    assert not {name for name in steppers if name.startswith("Motor")}


@pytest.mark.parametrize(("axes", "low"), [(1, 0.16), (4, 0.4), (5, 0.45), (6, 0.45)])
def test_the_lanes_have_room_for_each_axis_and_leave_the_stage_the_larger_part(axes, low):
    root = build_dashboard(recording_of(**{f"x{k}": axis(PCL240K) for k in range(axes)})).root_container
    assert root.contents[0].row_shares == pytest.approx([1 - low, low])


def test_the_eye_begins_where_the_viewer_of_the_model_does():
    """azimuth 30, elevation -20: it looks along (cos 20 cos 30, cos 20 sin 30, -sin 20), from 1.5 extents away times the lenses"""
    at, target = find_eye(model_of())
    forward = np.array([math.cos(math.radians(30)), math.sin(math.radians(30)), 0]) * math.cos(math.radians(20))
    forward[2] = -math.sin(math.radians(20))
    nearer = math.tan(math.radians(20)) / math.tan(math.radians(27.5))
    assert target == pytest.approx([1, 2, 3])
    assert at == pytest.approx(target - 3 * forward * nearer * MARGIN)


def test_a_camera_named_overview_is_where_the_eye_begins():
    """a camera 5 m above (1, 2), which looks down, of 55 degrees: rerun's own lens; and one behind the model's middle"""
    camera = '<camera name="{}" pos="1 2 {}" fovy="55"/>'
    at, target = find_eye(model_of(camera.format("overview", 8)))
    assert target == pytest.approx([1, 2, 3])
    assert at == pytest.approx([1, 2, 3 + 5 * MARGIN])
    at, target = find_eye(model_of(camera.format("overview", 1)))
    assert target == pytest.approx([1, 2, 0.8]), "it looks away from the middle: a tenth of the extent before it"
    assert at == pytest.approx([1, 2, 0.8 + 0.2 * MARGIN])
    assert np.array(find_eye(model_of(camera.format("other", 8)))) == pytest.approx(np.array(find_eye(model_of())))


@pytest.mark.parametrize(("extent", "spacing"), [(0.9, 0.1), (1.0, 1.0), (2.0, 1.0), (99.0, 10.0)])
def test_the_grid_lies_on_the_floor_a_line_each_power_of_ten_of_metres_that_fits(extent, spacing):
    view = views(build_dashboard(recording_of(model_of(FLOOR, extent), x=axis(PCL240K))).root_container)["Stage"]
    grid = view.properties["LineGrid3D"]
    assert grid.spacing.as_arrow_array().to_pylist() == pytest.approx([spacing])
    assert grid.plane.as_arrow_array().to_pylist() == [pytest.approx([0, 0, 1, -0.4])]
    bare = views(build_dashboard(recording_of(x=axis(PCL240K))).root_container)["Stage"]
    assert bare.properties["LineGrid3D"].visible.as_arrow_array().to_pylist() == [False], "there is no floor"
    red, green, blue = BACKGROUND
    colour = (red << 24) | (green << 16) | (blue << 8) | 255
    assert bare.properties["Background"].color.as_arrow_array().to_pylist() == [colour]


@pytest.mark.parametrize(
    ("axes", "series", "title"),
    [
        ([PCL240K, MCX501], "counter", "Counter R0 LP (pulses)"),
        ([PCL240K, PCL240K], "counter", "Counter R0 (pulses)"),
        ([HCTL1100], "counter", "Actual position (counts)"),
        ([HCTL1100, HCTL1100], "rate", "Commanded velocity (counts/s)"),
        ([HCTL1100, PCL240K], "rate", "Pulse rate (pps | counts/s)"),
        ([HCTL1100, PCL240K], "counter", "Counter R0 (pulses | counts)"),
        ([HCTL1100, PCL240K], "voltage", "Motor voltage (V)"),
        ([HCTL1100, PCL240K], "lost_steps", "Lost steps (full steps)"),
    ],
)
def test_a_title_names_the_counters_and_units_of_the_axes_that_have_the_series(axes, series, title):
    assert make_plot_title(recording_of(**{f"x{k}": axis(chip) for k, chip in enumerate(axes)}), series) == title


def test_a_servo_has_voltage_and_current_and_a_stepper_has_load_angle_and_lost_steps():
    both = {"rate", "position", "commanded", "following_error", "counter"}
    assert set(select_series(axis(PCL240K))) == both | {"load_angle", "lost_steps"}
    assert set(select_series(axis(HCTL1100))) == both | {"voltage", "current"}


def test_each_series_is_of_its_axis_and_scaled_to_its_units():
    """every field of a sample has a number of its own"""
    fields = ("rate", "position", "commanded", "voltage", "current_a", "load_angle", "lost_steps", "counter")
    samples = {name: np.array([10.0 ** (k + 1)]) for k, name in enumerate(fields)}
    displayed = {name: float(spec.value(samples)[0]) for name, spec in SERIES.items()}
    assert displayed == {
        "rate": 1e1, "position": 1e2, "commanded": 1e3, "following_error": 1e3 - 1e2, "voltage": 1e4, "current": 1e5,
        "load_angle": 1e6, "lost_steps": 1e7, "counter": 1e8,
    }  # fmt: skip
    degrees = math.degrees(1)
    assert {name: spec.scales for name, spec in SERIES.items()} == {
        "rate": (1, 1), "position": (1e3, degrees), "commanded": (1e3, degrees), "following_error": (1e6, 1e3 * degrees),
        "voltage": (1, 1), "current": (1, 1), "load_angle": (degrees, degrees), "lost_steps": (1, 1), "counter": (1, 1),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("column", "unit", "servo", "message"),
    [
        ("position", "m", False, "m"), ("position", "rad", False, "rad"), ("following_error", "rad", True, "rad"),
        ("velocity", "m", False, "m/s"), ("velocity", "rad", False, "rad/s"), ("torque", "rad", False, "N m"),
        ("rate", "m", False, "pps"), ("rate", "rad", True, "counts/s"), ("pulses", "m", False, "pulses"),
        ("pulses", "m", True, "counts"), ("counter", "m", True, "counts"), ("load_angle", "m", False, "rad"),
        ("voltage", "rad", True, "V"), ("lost_steps", "rad", False, "full steps"), ("el_plus", "m", False, ""),
    ],
)  # fmt: skip
def test_a_column_has_the_unit_of_its_axis(column, unit, servo, message):
    assert find_column_unit(column, unit, servo) == message
