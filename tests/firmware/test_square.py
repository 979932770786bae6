"""Promises of `firmware.square_gantry`.

Tandem axes move home to ORG at either end, at the requested speeds, and no common move is longer than the load bears.
"""

import numpy as np
import pytest

from stage import Stage, faults, firmware
from stage.errors import RunTimeout
from stage.firmware import gantry_homing
from stage.firmware.driver import Speeds
from stage.sim import plant

BEAM = ("y", "w")
SWAPPED = {"plus": "minus", "minus": "plus"}
PIECES = 60
"""The ways of all pieces together are the travel of the axis that has the least."""


def make_mirrored_gantry():
    """Make a gantry whose y and w count in the other direction, so that ORG is at the plus end; w has less travel than y."""
    spec = plant.open_spec("gantry")
    for joint in (j for j in spec.joints if j.name in BEAM):
        joint.axis = -joint.axis
    next(j for j in spec.joints if j.name == "w").range = (-0.106, 0.106)
    ends = [s for s in spec.sensors if s.name[0] in BEAM and s.name.endswith(("_plus", "_minus"))]
    names = [s.name.rpartition("_") for s in ends]
    for sensor in ends:
        sensor.name += "_old"
    for sensor, (begin, _, side) in zip(ends, names, strict=True):
        sensor.name = f"{begin}_{SWAPPED[side]}"
    return spec


@pytest.fixture(scope="module", params=[-1, 1])
def gantry(request):
    """Direction of ORG, and a stage."""
    return request.param, Stage("gantry" if request.param < 0 else make_mirrored_gantry(), visuals=False)


@pytest.fixture
def recorded_lines(monkeypatch):
    """Calls of `line` by `square_gantry`: (distances, options) each; half of PIECES suffice for half of the travel."""
    observed, line = [], gantry_homing.line

    def record_line(distances, *axes, **options):
        observed.append((dict(distances), options))
        assert len(observed) <= PIECES, "it never ends"
        return line(distances, *axes, **options)

    monkeypatch.setattr(gantry_homing, "line", record_line)
    return observed


def place_beam(gantry, millimetres):
    """Place both axes at this distance from the middle towards ORG, which is on from 70 mm."""
    direction, stage = gantry
    stage.reset()
    stage.place(**dict.fromkeys(BEAM, direction * millimetres * 1e-3))
    return direction, [stage.axes[name] for name in BEAM]


@pytest.mark.parametrize(("millimetres", "on"), [(62, False), (78, True)])
def test_a_beam_is_squared_at_org_on_either_side_from_both_sides_of_the_switch(gantry, recorded_lines, millimetres, on):
    """firmware.square_gantry(y, w, direction=1)"""
    direction, axes = place_beam(gantry, millimetres)
    assert {axis.switches.org for axis in axes} == {on}
    reports = firmware.square_gantry(*axes, direction=direction)
    assert [(r.axis, r.stopped_by, r.lost_steps) for r in reports] == [("y", "ORG", 0), ("w", "ORG", 0)]
    org = [next(s.touch for s in axis.plant.switches if s.pin == "org") for axis in axes]
    assert [axis.position for axis in axes] == pytest.approx(org, abs=0.1e-3)
    assert abs(np.degrees(gantry[1].data.joint("racking").qpos[0])) < 2e-3
    piece = min(high - low for low, high in (axis.travel for axis in axes)) / PIECES
    driven = [abs(distance) for distances, _ in recorded_lines for distance in distances.values()]
    assert driven == pytest.approx([piece] * 2 * len(recorded_lines))
    assert [set(distances) for distances, _ in recorded_lines] == [set(BEAM)] * len(recorded_lines)
    assert np.sign(recorded_lines[0][0]["y"]) == (-direction if on else direction)


def test_a_tandem_axis_moves_alone_at_a_quarter_of_the_common_speed(gantry, recorded_lines, monkeypatch):
    """firmware.square_gantry(y, w, speed=0.06, start_speed=0.02, accel=0.05)"""
    direction, axes = place_beam(gantry, 67)
    homes, driver = [], type(gantry_homing.get_driver(axes[0]))
    monkeypatch.setattr(driver, "home", lambda self, *arguments, **options: homes.append((arguments, options)))
    options_of_speed = {"speed": 0.06, "start_speed": 0.02, "accel": 0.05}
    gantry_homing.square_gantry(*axes, direction=direction, **options_of_speed, timeout=7.0)
    assert [options for _, options in recorded_lines] == [options_of_speed] * len(recorded_lines)
    slow = 0.06 / 4 / axes[0].meters_per_pulse
    assert homes == [((direction, pytest.approx(Speeds(slow, slow, 0.05, 0.05))), {"timeout": 7.0})] * 2
    homes.clear()
    gantry_homing.square_gantry(*axes, direction=direction, speed=0.06, start_speed=0.002)
    assert [arguments[1].start for arguments, _ in homes] == pytest.approx([0.002 / axes[0].meters_per_pulse] * 2)


def test_speeds_in_pulses_are_converted_by_the_first_axis(gantry, monkeypatch):
    direction, axes = place_beam(gantry, 67)
    observed = []
    monkeypatch.setattr(
        gantry_homing, "square_gantry", lambda *axes, **options: observed.append((axes, options)) or ["squared"]
    )
    unit = axes[0].meters_per_pulse
    assert gantry_homing.square_gantry_at_speeds(axes, direction, Speeds(500, 6000, 0.1, 0.3), 9.0) == ["squared"]
    wanted = {"direction": direction, "speed": 6000 * unit, "start_speed": 500 * unit, "accel": 0.1, "timeout": 9.0}
    assert observed == [(tuple(axes), pytest.approx(wanted))]


@pytest.mark.parametrize("millimetres", [62, 78])
def test_jammed_axes_end_the_squaring_at_the_timeout(gantry, recorded_lines, millimetres):
    direction, axes = place_beam(gantry, millimetres)
    with faults.jam(axes[0]), faults.jam(axes[1]), pytest.raises(RunTimeout, match=r"after 0\.300 s"):
        firmware.square_gantry(*axes, direction=direction, timeout=0.3)
    assert len(recorded_lines) == 1
