"""Calls to the renderer and the viewer window, tested without OpenGL and without a screen."""

import sys
from types import ModuleType, SimpleNamespace

import gymnasium
import mujoco
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError, Stage, StageError
from stage.envs import rendering


@pytest.fixture(scope="module")
def machine():
    return Stage("xy", visuals=False)


class Renderer:
    """A renderer that records its calls."""

    def __init__(self, model, height, width):
        self.events = [(model, height, width)]

    def update_scene(self, data, camera):
        self.events.append((data.qpos.tolist(), data.geom_xpos.sum(), camera))

    def render(self):
        return "a picture"

    def close(self):
        self.events.append("closed")


def test_a_picture_has_the_requested_size_camera_and_joint_positions(machine, monkeypatch):
    monkeypatch.setattr(rendering, "make_renderer", Renderer)
    camera = machine.model.camera(0).name
    created = rendering.make_viewer(machine, "rgb_array", camera, 64, 48)
    assert isinstance(created, rendering.OffScreenRenderer)
    before = machine.data.qpos.copy()
    assert created.render_stage() == created.render_stage(np.array([0.01, -0.02])) == "a picture"
    created.close()
    size, current, elsewhere, closed = created._renderer.events
    assert size == (machine.model, 48, 64)
    assert (current[0], current[2]) == (before.tolist(), camera)
    assert (elsewhere[0], elsewhere[2]) == ([0.01, -0.02], camera)
    assert current[1] != elsewhere[1], "what is drawn follows the joints"
    assert closed == "closed"
    assert (machine.data.qpos == before).all(), "the stage itself stays where it is"
    with pytest.raises(ArgumentError, match=f"unknown camera 'nowhere'.*{camera}"):
        rendering.make_viewer(machine, "rgb_array_list", "nowhere", 64, 48)


@pytest.fixture
def window(monkeypatch):
    """A stand-in of MuJoCo's viewer that records its calls."""
    events, checked = [], []
    present = ModuleType("mujoco.viewer")
    handle = SimpleNamespace(sync=lambda: events.append("synced"), close=lambda: events.append("closed"))
    present.launch_passive = lambda model, data: (events.append((model, data)), handle)[1]
    monkeypatch.setitem(sys.modules, "mujoco.viewer", present)
    monkeypatch.setattr(mujoco, "viewer", present, raising=False)
    monkeypatch.setattr(rendering, "check_window", checked.append)
    return SimpleNamespace(events=events, checked=checked, module=present)


def test_a_window_shows_the_joint_positions_of_each_frame(machine, window):
    created = rendering.make_viewer(machine, "human", "overview", 64, 48)
    assert isinstance(created, rendering.ViewerWindow)
    assert window.checked == ["Use render_mode='rgb_array', or record."]
    ((model, data),) = window.events
    assert (model, data) == (machine.model, created._pose.data)
    assert data.qpos.tolist() == machine.data.qpos.tolist()
    assert created.render_stage(np.array([0.01, 0.02])) is None
    assert data.qpos.tolist() == [0.01, 0.02]
    created.render_stage()
    assert data.qpos.tolist() == machine.data.qpos.tolist()
    created.close()
    assert window.events[1:] == ["synced", "synced", "closed"]


def test_a_window_that_cannot_open_explains_the_cause_and_the_remedy(machine, window):
    def refuse(model, data):
        raise RuntimeError("no display")

    window.module.launch_passive = refuse
    with pytest.raises(
        StageError, match=r"viewer does not open \(no display\)\. Use render_mode='rgb_array', or record\."
    ):
        rendering.ViewerWindow(machine)


@pytest.mark.parametrize(
    ("every", "frames"), [(2e-3, [1, 1, 1, 1, 1, 1]), (4e-3, [0, 1, 0, 1, 0, 1]), (4.1e-3, [0, 0, 1, 0, 0, 1])]
)
def test_a_frame_is_due_when_so_much_time_has_passed_to_the_nanosecond(every, frames, monkeypatch):
    monkeypatch.setattr(
        rendering, "make_viewer", lambda *_: SimpleNamespace(render_stage=lambda qpos=None: 0, close=lambda: None)
    )
    env = gymnasium.make(
        "stage/RegisterBus-v0",
        model="xy",
        waits=(2e-3,),
        render_mode="rgb_array_list",
        render_every=every,
        disable_env_checker=True,
    ).unwrapped
    for _ in range(2):
        env.reset(seed=1)
        assert len(env.render()) == 1, "where the episode begins"
        observed = []
        for _ in frames:
            env.step(np.array([2, 0, 0, 0]))
            observed.append(len(env.render()))
        assert observed == frames
