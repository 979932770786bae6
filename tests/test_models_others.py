"""xya, with a rotary table, and gantry, with two motors on its long axis."""

import re

import mujoco
import numpy as np
import pytest

from stage import Stage, firmware
from stage.sim import plant

OTHERS = ("xya", "gantry")


@pytest.fixture(scope="module", params=OTHERS)
def model(request):
    return plant.open_spec(request.param).compile()


def test_it_runs_under_gravity_without_a_warning_or_an_unwanted_contact(model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 4000)
    assert not data.warning.number.any()
    assert not any(c.efc_address >= 0 for c in data.contact[: data.ncon]), "nothing touches"
    assert np.abs(data.qpos).max() < 1e-5, "it stands"
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_switches_are_seen_before_the_touch_and_never_felt(model):
    data = mujoco.MjData(model)
    for a in plant.bind(model):
        stops = {model.geom(k).id for k in range(model.ngeom) if "bumper" in model.geom(k).name}
        for q in np.linspace(*a.travel, 60):
            mujoco.mj_resetData(model, data)
            data.qpos[a.qpos] = q
            mujoco.mj_forward(model, data)
            pushing = [c for c in data.contact[: data.ncon] if c.efc_address >= 0]
            assert all(stops & {int(c.geom1), int(c.geom2)} for c in pushing)
        assert all(s.lookahead >= 0.005 * (10 if a.hinge else 1) for s in a.switches)


def test_it_has_what_pictures_and_recordings_look_for(model):
    assert {model.camera(k).name for k in range(model.ncam)} >= {"overview", "front", "top", "switches"}
    assert {model.site(k).name for k in range(model.nsite)} >= {"tool", "work"}
    assert model.ngeom < 260, "every geom costs time in every step"
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    for a in plant.bind(model):
        org = next(s.touch for s in a.switches if s.pin == "org")
        assert data.qpos[a.qpos] == pytest.approx(org, abs=1e-5)


@pytest.mark.parametrize("degrees", [40, -7, -40, 170])
def test_a_table_without_end_limits_goes_home_from_anywhere(degrees):
    """stage home a --model xya --from -40deg"""
    stage = Stage("xya", visuals=False)
    a = stage.axes["a"]
    stage.place(a=np.radians(degrees))
    report = firmware.home(a)
    assert (report.stopped_by, report.lost_steps) == ("ORG", 0)
    turns = 0 if degrees >= -19 else -1
    assert np.degrees(a.position) == pytest.approx(360 * turns, abs=0.01)


def test_a_turn_is_57600_pulses_and_is_told_in_degrees():
    stage = Stage("xya", visuals=False)
    report = firmware.move(stage.axes["a"], pulses=57_600)
    assert report.lost_steps == 0
    assert re.search(r"from 0\.0000 deg to (359\.99|360\.00)\d\d deg,", str(report))


def racking(stage):
    return np.degrees(stage.data.joint("racking").qpos[0])


def test_a_gantry_is_squared_by_homing_each_side():
    """docs/models.md: together until one is near, then each to its own switch"""
    stage = Stage("gantry", visuals=False)
    y, w = stage.axes["y"], stage.axes["w"]
    stage.place(y=-0.040, w=-0.0388)
    stage.run(0.1)
    assert abs(racking(stage)) > 0.1, "it stands askew"
    while not (y.switches.org or w.switches.org):
        assert firmware.line({"y": -5e-3, "w": -5e-3}, stage).ok
    assert [firmware.home(axis).stopped_by for axis in (y, w)] == ["ORG", "ORG"]
    assert abs(y.position - w.position) < 2e-5
    assert abs(racking(stage)) < 2e-3
    assert firmware.line({"y": 80e-3, "w": 80e-3}, stage).ok
    assert abs(racking(stage)) < 2e-3


def test_one_motor_of_a_gantry_alone_racks_the_beam_and_slips():
    stage = Stage("gantry", visuals=False)
    assert firmware.move(stage.axes["y"], 3e-3).ok
    assert abs(racking(stage)) > 0.2
    assert firmware.move(stage.axes["y"], 37e-3).lost_steps
