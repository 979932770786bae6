"""The shipped models: loadable anywhere, true to their sizes, switches seen and never felt."""

import mujoco
import numpy as np
import pytest

from stage import Stage, plant

TRAVEL = {"x": 0.300, "y": 0.200, "z": 0.080}


@pytest.fixture(scope="module", params=plant.names())
def model(request):
    return mujoco.MjModel.from_xml_path(str(plant.resources.files("stage.models") / f"{request.param}.xml"))


@pytest.fixture(scope="module")
def axes(model):
    return plant.bind(model)


def put(model, data, **positions):
    mujoco.mj_resetData(model, data)
    for name, q in positions.items():
        data.qpos[model.joint(name).qposadr[0]] = q
    mujoco.mj_forward(model, data)


def test_there_are_an_xy_and_an_xyz_stage():
    assert {"xy", "xyz"} <= set(plant.names())


def test_it_runs_without_a_warning_or_an_unwanted_contact(model):
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 4000)
    assert not data.warning.number.any()
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
    assert model.nq == model.nv == len(axes)


def test_travel_and_order_of_switches(axes):
    for a in axes:
        at = {s.pin: s.touch for s in a.switches}
        assert at["el_plus"] - at["el_minus"] == pytest.approx(TRAVEL[a.name], abs=1e-6)
        order = [a.travel[0], at["el_minus"], at["org"], at["sd_minus"], at["sd_plus"], at["el_plus"], a.travel[1]]
        assert order == sorted(order)
        assert all(abs(abs(s.slope) - 1) < 1e-6 for s in a.switches)


def test_screws_have_10_mm_lead_and_the_motors_rotor_is_in_the_armature(model, axes):
    from stage.drives.motors import motor

    for a in axes:
        assert 2 * np.pi / a.gear == pytest.approx(0.010)
        rotor = motor(a.motor).rotor_inertia * a.gear**2
        assert rotor < model.dof_armature[a.dof] < 3 * rotor, "rotor and screw"


def test_switches_are_never_felt_over_the_whole_travel(model, axes):
    data = mujoco.MjData(model)
    for a in axes:
        stops = {g for w in ("plus", "minus") for g in (model.geom(f"{a.name}_bumper_{w}").id,)}
        for q in np.linspace(*a.travel, 200):
            put(model, data, **{a.name: q})
            pushing = [c for c in data.contact[: data.ncon] if c.efc_address >= 0]
            assert all(stops & {int(c.geom1), int(c.geom2)} for c in pushing)


def test_a_sensor_tells_the_distance_before_the_touch(model, axes):
    data = mujoco.MjData(model)
    for a in axes:
        for s in a.switches:
            for away in (5e-3, 1e-3, 1e-5, -1e-5, -1e-3):
                put(model, data, **{a.name: s.touch + away / s.slope})
                assert data.sensordata[s.found] > 0
                assert data.sensordata[s.dist] == pytest.approx(away, abs=1e-9)


def test_hard_stops_hold_the_motors_full_thrust_within_a_millimetre(model, axes):
    for a in axes:
        for direction in (1, -1):
            data = mujoco.MjData(model)
            end = max(s.touch * direction for s in a.switches if s.pin in ("el_plus", "el_minus")) * direction
            put(model, data, **{a.name: end})
            data.qfrc_applied[a.dof] = 250 * direction
            mujoco.mj_step(model, data, 4000)
            q = data.qpos[a.qpos] * direction
            assert end * direction < q, "beyond the limit switch"
            assert q < a.travel[1] * 1.0 + 1e-3
            assert abs(data.qvel[a.dof]) < 1e-3


def test_every_axis_of_every_model_homes():
    from stage import firmware

    for name in plant.names():
        stage = Stage(name)
        for axis in stage.axes.values():
            report = firmware.origin_return(axis)
            assert report.stopped_by == "ORG"
            assert report.lost_steps == 0
