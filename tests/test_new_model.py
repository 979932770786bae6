"""`stage new-model` writes models that keep the naming contract, home, and stop at their limits and hard stops."""

import math
import re
import shlex
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import scaled

from stage import ModelError, Stage, firmware
from stage.cli import main
from stage.drives.motors import MOTORS
from stage.sim import plant
from stage.sim.plant.new_model import NewAxis, build_model_text


def make_spec(*axes):
    return mujoco.MjSpec.from_string(build_model_text([NewAxis.parse(a) for a in axes]))


KINDS = st.one_of(
    st.integers(10, 2000).map(lambda n: f"slide:{n}mm"),
    st.integers(20, 330).map(lambda n: f"hinge:{n}deg"),
    st.just("hinge:360deg"),
)


@settings(max_examples=scaled(40), deadline=None)
@given(st.lists(KINDS, min_size=1, max_size=4))
def test_every_chain_of_axes_keeps_the_contract_and_its_switches_trip_where_documented(kinds):
    axes = [NewAxis.parse(f"q{k}:{kind}") for k, kind in enumerate(kinds)]
    result = plant.bind_axes(mujoco.MjSpec.from_string(build_model_text(axes)).compile())
    assert [a.name for a in result] == [a.name for a in axes]
    for requested, axis in zip(axes, result, strict=True):
        trips = {s.pin: s.touch for s in axis.switches}
        if requested.endless:
            assert set(trips) == {"org"}
            assert trips["org"] == pytest.approx(0, abs=1e-3)
            continue
        half = requested.travel / 2 if requested.kind == "slide" else math.radians(requested.travel / 2)
        near = 2e-6 if requested.kind == "slide" else 2e-3
        wanted = {"el_plus": 1, "el_minus": -1, "sd_plus": 0.87, "sd_minus": -0.73, "org": -0.8}
        assert trips == pytest.approx({name: share * half for name, share in wanted.items()}, abs=near)


@pytest.mark.parametrize("axis", ["x:slide:60mm", "a:hinge:90deg", "a:hinge:360deg"])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_new_axis_homes_from_either_side_without_losing_a_step(axis, side):
    stage = Stage(make_spec(axis), visuals=False)
    a = next(iter(stage.axes.values()))
    stage.place(**{a.name: side * (0.02 if "slide" in axis else 0.5)})
    report = firmware.home(a)
    assert report.lost_steps == 0
    (org,) = (s for s in plant.bind_axes(stage.model)[0].switches if s.pin == "org")
    missed = a.position - org.touch if "360" not in axis else math.remainder(a.position - org.touch, 2 * math.pi)
    assert abs(missed) < 2 * (10e-3 if "slide" in axis else 2 * math.pi / 10) / 3200  # two pulses


@pytest.mark.parametrize("axis", ["x:slide:60mm", "a:hinge:330deg"])
def test_whatever_pushes_the_axis_its_hard_stops_hold_it_beyond_the_end_limits(axis):
    model = make_spec(axis).compile()
    data = mujoco.MjData(model)
    (a,) = plant.bind_axes(model)
    for sign in (1, -1):
        mujoco.mj_resetData(model, data)
        data.qfrc_applied[0] = sign * (100 if "slide" in axis else 0.4)
        for _ in range(12_000):
            mujoco.mj_step(model, data)
        assert abs(data.qpos[0]) == pytest.approx(a.travel[1], rel=0.02)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ("x:slide:3", "NAME:slide:300mm"),
        ("x:slide:300deg", "NAME:slide:300mm"),
        ("x:slide:5mm", "10 mm to 2 m"),
        ("a:hinge:345deg", "20 to 330 degrees between the end limits; or 360deg"),
        ("x:slide:1..2m", "NAME:slide:300mm"),
        ("x:slide:30mm,x:slide:30mm", "each of a name of its own"),
        ("", "NAME:slide:300mm"),
    ],
)
def test_wrong_axes_are_explained_and_nothing_is_written(axes, message, tmp_path, capsys):
    # stage new-model --axes x:slide:3 -o my.xml
    assert main(["new-model", "--axes", axes, "-o", str(tmp_path / "my.xml")]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_command_writes_a_model_that_the_other_commands_take(tmp_path, capsys):
    # stage new-model --axes x:slide:50mm,a:hinge:360deg -o 'my own.xml'; stage move x 2mm --model 'my own.xml'
    file = str(tmp_path / "my own.xml")
    assert main(["new-model", "--axes", "x:slide:50mm,a:hinge:360deg", "-o", file]) == 0
    output = re.findall(r"`([^`]+)`", capsys.readouterr().out)
    assert [shlex.split(command) for command in output] == [
        ["stage", "home", "--model", file],
        ["stage", "view", file],
    ], "can be pasted into a shell"
    assert main(["new-model", "--axes", "x:slide:50mm", "-o", file]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["move", "x", "2mm", "--model", file]) == 0
    assert main(["move", "a", "30deg", "--model", file]) == 0
    assert "0 full steps lost" in capsys.readouterr().out


def test_axes_of_radians_and_centimetres_are_the_same_lengths():
    assert NewAxis.parse("a:hinge:6.283185rad").endless
    assert NewAxis.parse("x:slide:30cm") == NewAxis.parse("x:slide:0.3m") == NewAxis.parse("x:slide:300mm")
    with pytest.raises(ModelError):
        NewAxis.parse("1x:slide:30cm")


@pytest.mark.parametrize(
    ("axes", "directions"),
    [
        ("x y z", "x y z"),
        ("z y x", "z y x"),
        ("Y u v", "y x z"),
        ("u v w", "x y z"),
        ("u v w q", "x y z x"),
        ("z u", "z x"),
    ],
)
def test_slides_move_in_the_direction_of_their_names_and_the_others_in_different_ones(axes, directions):
    """Whatever they ride on: a slide upwards carries the next as it lay, on an arm beside it."""
    model = make_spec(*(f"{name}:slide:100mm" for name in axes.split())).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    unit = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}
    for name, direction in zip(axes.split(), directions.split(), strict=True):
        assert data.xaxis[model.joint(name).id] == pytest.approx(unit[direction], abs=1e-9), name
    model_directions = dict(zip(axes.split(), directions.split(), strict=True))
    for (below, direction), (above, _) in pairwise(zip(axes.split(), directions.split(), strict=True)):
        arm = data.body(above).xpos - data.body(below).xpos
        if model_directions[above] == "z":
            assert arm[2] > 0.1, "its column stands on what carries it"
            continue
        assert np.linalg.norm(arm) == pytest.approx(0.1 if direction == "z" else 0.04), "an arm in front"
    assert data.ncon == 0 or not (data.contact.efc_address[: data.ncon] >= 0).any(), "nothing touches"
    site = data.site_xmat[model.site("work").id].reshape(3, 3)
    assert site == pytest.approx(np.eye(3), abs=1e-9), "what rides on all of them lies as the first"


def test_a_new_slide_has_rotor_and_screw_in_its_armature_and_a_new_hinge_the_rotor_alone():
    short, long, hinge = (get_gear_and_armature(axis) for axis in ("x:slide:100mm", "x:slide:1m", "a:hinge:90deg"))
    rotor = MOTORS["17HS4401"].rotor_inertia
    assert hinge == (10.0, pytest.approx(rotor * 10.0**2))
    screw = 0.5 * 7850 * math.pi * 0.005**4  # of steel, 10 mm thick, kg m2 a metre
    for (gear, armature), length in ((short, 0.2), (long, 1.1)):
        assert gear == pytest.approx(2 * math.pi / 0.01)
        assert armature == pytest.approx((rotor + screw * length) * gear**2, rel=1e-3)


def get_gear_and_armature(axis):
    """Gear and armature of the one axis of a model."""
    model = make_spec(axis).compile()
    return float(model.actuator_gear[0][0]), float(model.dof_armature[0])


def test_hard_stops_of_a_hinge_stand_three_degrees_beyond_its_end_limits():
    model = make_spec("a:hinge:90deg").compile()
    assert np.degrees(model.joint("a").range) == pytest.approx([-48, 48])
    data = mujoco.MjData(model)

    def touches(degrees):
        data.qpos[0] = math.radians(degrees)
        mujoco.mj_forward(model, data)
        return bool((data.contact.efc_address[: data.ncon] >= 0).any())

    assert [touches(d) for d in (-48.3, -47.7, 0, 47.7, 48.3)] == [True, False, False, False, True]


MACHINES = ("x:slide:300mm,y:slide:200mm", "x:slide:300mm,y:slide:200mm,z:slide:100mm", "x:slide:200mm,a:hinge:360deg",
            "a:hinge:90deg", "z:slide:60mm,a:hinge:120deg", "u:slide:50mm,v:slide:2m")  # fmt: skip


@pytest.mark.parametrize("axes", MACHINES)
def test_no_part_of_a_new_machine_floats(axes):
    """Begin at the bench: every part touches one that is held, but for the light beams of the switches."""
    model = make_spec(*axes.split(",")).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    loose = {k for k in range(model.ngeom) if not model.geom(k).name.endswith("_beam")}
    queue = [model.geom("bench").id]
    while queue:
        geom = queue.pop()
        loose.discard(geom)
        touched = [g for g in loose if mujoco.mj_geomDistance(model, data, geom, g, 1.0, None) < 1e-3]
        loose.difference_update(touched)
        queue += touched
    assert not [(model.body(model.geom_bodyid[k]).name, model.geom(k).name, data.geom_xpos[k]) for k in loose]


@pytest.mark.parametrize("axes", MACHINES)
def test_the_camera_frames_a_new_machine(axes):
    """stage view new.xml --picture new.png"""
    model = make_spec(*axes.split(",")).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = data.camera("overview")
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    points = np.concatenate(
        [
            data.geom_xpos[k]
            + (model.geom_aabb[k, :3] + corners * model.geom_aabb[k, 3:]) @ data.geom_xmat[k].reshape(3, 3).T
            for k in range(model.ngeom)
        ]
    )
    in_camera = (points - camera.xpos) @ camera.xmat.reshape(3, 3)
    picture = (
        in_camera[:, :2]
        / -in_camera[:, 2:]
        / math.tan(math.radians(model.camera("overview").fovy[0]) / 2)
        / [16 / 9, 1]
    )
    assert (np.abs(picture) <= 1).all()
    assert (picture.max(axis=0) - picture.min(axis=0)).max() > 1.8, "of 2: it fills the picture"
