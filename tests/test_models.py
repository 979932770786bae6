"""The XY(Z) stages that ship: loadable anywhere, true to their sizes, switches seen and never felt."""

import copy
from importlib import resources

import mujoco
import numpy as np
import pytest

from stage import Stage
from stage.drives.dc_motors import DC_MOTORS
from stage.drives.motors import find_motor
from stage.sim import plant

BENCH = ("xy", "xyz", "xyz_servo", "xy_mast")
TRAVEL = {"x": 0.300, "y": 0.200, "z": 0.080}


@pytest.fixture(scope="module", params=BENCH)
def model(request):
    return mujoco.MjModel.from_xml_path(str(resources.files("stage.models") / f"{request.param}.xml"))


@pytest.fixture(scope="module")
def axes(model):
    return plant.bind_axes(model)


def find_rotor_inertia(axis):
    return (DC_MOTORS[axis.motor] if axis.servo else find_motor(axis.motor)).rotor_inertia


def set_positions(model, data, **positions):
    mujoco.mj_resetData(model, data)
    for name, q in positions.items():
        data.qpos[model.joint(name).qposadr[0]] = q
    mujoco.mj_forward(model, data)


def test_an_xy_and_an_xyz_stage_exist():
    assert set(BENCH) <= set(plant.list_model_names())


MODEL_FIELDS = [name for name in dir(mujoco.MjModel) if not name.startswith("_")]


def test_xyz_servo_is_xyz_with_other_motors():
    """Field by field: actuators, the rotors in the armatures and what follows from them differ, and nothing else."""
    one, other = (plant.open_spec(name).compile() for name in ("xyz", "xyz_servo"))
    differ = {
        name
        for name in MODEL_FIELDS
        if isinstance(value := getattr(one, name), np.ndarray | int | float)
        and not np.array_equal(value, getattr(other, name))
    }
    differ = {name for name in differ if not name.startswith(("name", "nname", "text", "ntext", "signature"))}
    motors = {
        name for name in differ if name.startswith("actuator_") and name not in ("actuator_gear", "actuator_trnid")
    }
    inertia = {"dof_armature", "dof_M0", "dof_invweight0", "body_invweight0", "jnt_invweight0", "stat"}
    assert motors >= {"actuator_gaintype", "actuator_gainprm"}
    assert differ - motors - inertia == set()


@pytest.mark.parametrize("name", ["x", "y", "z"])
def test_steppers_and_servos_have_the_same_screw(name):
    models = [plant.open_spec(name).compile() for name in ("xyz", "xyz_servo")]
    both = [next(a for a in plant.bind_axes(m) if a.name == name) for m in models]
    screws = [m.dof_armature[a.dof] / a.gear**2 - find_rotor_inertia(a) for m, a in zip(models, both, strict=True)]
    assert screws[0] == pytest.approx(screws[1], rel=1e-3)


def test_it_runs_under_gravity_without_a_warning_or_an_unwanted_contact(model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 10_000)
    assert not data.warning.number.any()
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert np.isfinite(data.qpos).all()
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    assert not any(c.efc_address >= 0 for c in data.contact[: data.ncon]), "nothing touches at rest"


def test_it_has_lights_cameras_and_materials(model):
    assert model.nlight >= 2
    assert model.ncam >= 3
    assert model.nmat >= 8
    assert model.light_castshadow.any()


def test_joints_are_the_axes_and_nothing_else(model, axes):
    sprung = [k for k in range(model.njnt) if model.joint(k).name.startswith("camera_")]
    assert model.nq == model.nv == len(axes) + len(sprung)


def test_travel_and_order_of_switches(axes):
    for a in axes:
        at = {s.pin: s.touch for s in a.switches}
        assert at["el_plus"] - at["el_minus"] == pytest.approx(TRAVEL[a.name], abs=1e-6)
        order = [a.travel[0], at["el_minus"], at["org"], at["sd_minus"], at["sd_plus"], at["el_plus"], a.travel[1]]
        assert order == sorted(order)
        assert all(abs(abs(s.slope) - 1) < 1e-6 for s in a.switches)


def test_screws_have_10_mm_lead_and_the_motors_rotor_is_in_the_armature(model, axes):
    for a in axes:
        assert 2 * np.pi / a.gear == pytest.approx(0.010)
        rotor = find_rotor_inertia(a) * a.gear**2
        assert rotor < model.dof_armature[a.dof] < 3 * rotor, "rotor and screw"


def test_switches_exert_no_force_over_the_full_travel(model, axes):
    data = mujoco.MjData(model)
    for a in axes:
        stops = {g for w in ("plus", "minus") for g in (model.geom(f"{a.name}_bumper_{w}").id,)}
        for q in np.linspace(*a.travel, 200):
            set_positions(model, data, **{a.name: q})
            pushing = [c for c in data.contact[: data.ncon] if c.efc_address >= 0]
            assert all(stops & {int(c.geom1), int(c.geom2)} for c in pushing)


def test_a_sensor_reads_the_distance_before_the_touch(model, axes):
    data = mujoco.MjData(model)
    for a in axes:
        for s in a.switches:
            for away in (5e-3, 1e-3, 1e-5, -1e-5, -1e-3):
                set_positions(model, data, **{a.name: s.touch + away / s.slope})
                assert data.sensordata[s.found] > 0
                assert data.sensordata[s.dist] == pytest.approx(away, abs=1e-9)


def test_hard_stops_hold_the_motors_full_thrust_within_a_millimetre(model, axes):
    for a in axes:
        for direction in (1, -1):
            data = mujoco.MjData(model)
            end = max(s.touch * direction for s in a.switches if s.pin in ("el_plus", "el_minus")) * direction
            set_positions(model, data, **{a.name: end})
            data.qfrc_applied[a.dof] = 250 * direction
            mujoco.mj_step(model, data, 4000)
            q = data.qpos[a.qpos] * direction
            assert end * direction < q, "beyond the limit switch"
            assert q < a.travel[1] * 1.0 + 1e-3
            assert abs(data.qvel[a.dof]) < 1e-3


def test_every_axis_of_every_model_homes():
    from stage import firmware

    for name in BENCH:
        stage = Stage(name, visuals=False)
        for axis in stage.axes.values():
            org = next(s.touch for s in axis.plant.switches if s.pin == "org")
            stage.place(**{axis.name: org + 0.004})
            report = firmware.origin_return(axis)
            assert report.stopped_by == "ORG"
            assert report.lost_steps == 0


def test_every_switch_is_detected_from_5_mm_before_the_touch(axes):
    for a in axes:
        assert [s.pin for s in a.switches] == list(plant.SWITCH_PINS)
        assert all(s.lookahead >= 0.005 for s in a.switches)


def test_limits_and_origin_stay_asserted_up_to_the_hard_stop(model, axes):
    data = mujoco.MjData(model)
    for a in axes:
        for side, end in (("minus", a.travel[0]), ("plus", a.travel[1])):
            for s in a.switches:
                if s.pin.endswith(side) or (s.pin == "org" and side == "minus"):
                    for q in np.linspace(s.touch, end, 50)[1:]:
                        set_positions(model, data, **{a.name: q})
                        assert data.sensordata[s.found] > 0
                        assert data.sensordata[s.dist] < 0


def test_a_carriage_that_runs_into_its_stop_at_300_mm_per_s_is_caught_within_two_millimetres(model, axes):
    model = copy.copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION  # a DC motor would brake
    for a in axes:
        for direction in (1, -1):
            data = mujoco.MjData(model)
            limit = max(s.touch * direction for s in a.switches if s.pin in ("el_plus", "el_minus"))
            set_positions(model, data, **{a.name: limit * direction})
            data.qvel[a.dof] = 0.3 * direction
            deepest = 0.0
            for _ in range(400):
                mujoco.mj_step(model, data)
                contacts = [c.dist for c in data.contact[: data.ncon] if c.efc_address >= 0]
                deepest = min([deepest, *contacts])
            assert -2e-3 < deepest < 0
            assert abs(data.qvel[a.dof]) < 0.3


def test_the_screws_in_the_armature_are_screws(model, axes):
    for a in axes:
        screw = model.dof_armature[a.dof] / a.gear**2 - find_rotor_inertia(a)
        assert 1e-6 < screw < 6e-6, "kg m2, of a screw of 10 mm diameter and its coupling"


def test_moving_masses_are_those_of_a_bench_top_stage(model, axes):
    masses = {a.name: model.body_subtreemass[model.jnt_bodyid[a.joint]] for a in axes}
    assert 2 < masses["x"] < 5
    assert 1.5 < masses["y"] < 3
    assert masses.get("z", 1) < 1.6


def test_current_holds_z_and_friction_alone_does_not():
    model = plant.open_spec("xyz").compile()
    z = plant.bind_axes(model)[2]
    weight = model.body_subtreemass[model.jnt_bodyid[z.joint]] * 9.81
    assert model.dof_frictionloss[z.dof] < weight < 0.4 * z.gear, "0.4 N m is the motor's holding torque"


@pytest.mark.parametrize("name", [*BENCH, "xya", "gantry"])
def test_it_has_the_parts_that_pictures_and_recordings_use(name):
    model = plant.open_spec(name).compile()
    assert {model.camera(k).name for k in range(model.ncam)} >= {"overview", "front", "top", "switches"}
    assert {model.site(k).name for k in range(model.nsite)} >= {"tool", "work"}
    assert model.ngeom < 260, "every geom costs time in every step"
    assert (model.vis.global_.offwidth, model.vis.global_.offheight) == (1920, 1080)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    for a in plant.bind_axes(model):
        assert data.qpos[a.qpos] == pytest.approx({s.pin: s.touch for s in a.switches}["org"], abs=1e-5)


def test_the_tool_reaches_down_to_the_work_without_touching_it():
    model = plant.open_spec("xyz").compile()
    data = mujoco.MjData(model)
    set_positions(model, data, z=-0.045)
    clearance = data.site("tool").xpos - data.site("work").xpos
    assert clearance[:2] == pytest.approx([0, 0], abs=1e-9)
    assert 0 < clearance[2] < 0.005


def test_the_documentation_shows_the_axes_and_masses_as_they_are():
    from pathlib import Path

    page = (Path(__file__).parent.parent / "docs" / "models.md").read_text()
    model = plant.open_spec("xyz").compile()
    for line in plant.format_axes(model).splitlines():
        assert f"    {line}\n" in page
    for a in plant.bind_axes(model):
        assert f"{model.body_subtreemass[model.jnt_bodyid[a.joint]]:.2f} kg" in page
        assert f"{model.dof_armature[a.dof]:.3f} kg" in page
        assert f"{model.dof_frictionloss[a.dof]:g} N + {model.dof_damping[a.dof]:g} N s/m" in page
