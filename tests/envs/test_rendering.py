"""Tests of `render`: frames with OpenGL, and clear errors without it."""

import ctypes.util
import os
import re
import subprocess
import sys
import warnings
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError, StageError
from stage.envs import rendering
from stage.support import opengl

MOVES = {
    "stage/RegisterTuning-v0": {"distances": (3200, 3200), "payloads": (0.0, 0.0), "moves": 2, "limit": 0.5},
    "stage/ServoTuning-v0": {"distances": (2000, 2000), "payloads": (0.0, 0.0), "moves": 2, "limit": 0.3},
    "stage/OriginReturn-v0": {"returns": 2, "limit": 0.2, "settle": 0.01},
    "stage/SynchronizedMove-v0": {"distances": (2000, 2000), "moves": 2},
}
"""Environments whose step is one complete move, with settings that keep it short."""


class Watcher:
    """Stand-in of a screen or GL that keeps the joint positions of all frames."""

    def __init__(self, stage):
        self.stage, self.frames = stage, []

    def render_stage(self, qpos=None):
        self.frames.append(np.array(self.stage.data.qpos if qpos is None else qpos))
        return self.frames[-1]

    def close(self):
        pass


@pytest.fixture
def frames(monkeypatch):
    """A function that returns all frames of environments created later, in any render mode."""
    created = []
    monkeypatch.setattr(rendering, "make_viewer", lambda stage, *_: created.append(Watcher(stage)) or created[-1])
    monkeypatch.setattr("time.sleep", lambda _: None)
    return lambda: [frame for watcher in created for frame in watcher.frames]


def make_env(id_, mode=None, **settings):
    return gymnasium.make(id_, disable_env_checker=True, render_mode=mode, **MOVES.get(id_, {}) | settings).unwrapped


def play_episode(env):
    """Play an episode with the middle action and return its results."""
    message = [env.reset(seed=3)]
    while len(message) == 1 or not (message[-1][2] or message[-1][3]):
        message.append(env.step(np.zeros(env.action_space.shape, np.float32)))
    return message


@pytest.mark.skipif(not {"MUJOCO_GL", "DISPLAY"} & set(os.environ), reason="no GL on this machine")
def test_frames_show_the_stage_and_its_motion():
    env = gymnasium.make("stage/RegisterTuning-v0", render_mode="rgb_array", moves=2, limit=0.3, settle=0.01).unwrapped
    env.reset(seed=1, options={"distance": 32000})
    before = env.render()
    assert before.shape == (480, 640, 3)
    assert before.dtype == np.uint8
    assert before.std() > 20, "there is something to see"
    env.reset(seed=1, options={"distance": 1600})
    assert (env.render() != before).any(), "the carriage stands elsewhere"
    env.close()


def test_an_unknown_camera_is_named_in_the_error():
    env = gymnasium.make("stage/RegisterTuning-v0", render_mode="rgb_array", camera="overveiw").unwrapped
    env.reset(seed=1)
    with pytest.raises(StageError, match=r"camera 'overveiw'.*overview"):
        env.render()


def test_visual_parts_are_loaded_only_for_rendering_or_recording(tmp_path):
    """gymnasium.make("stage/RegisterBus-v0", render_mode="rgb_array"), or record="run/{}.rrd": parts that only look, materials"""
    observed = {None: make_env("stage/RegisterBus-v0"), "pictures": make_env("stage/RegisterBus-v0", "rgb_array"),
            "recording": make_env("stage/RegisterBus-v0", record=str(tmp_path / "{}.rrd"))}  # fmt: skip
    materials = {name: env.stage.model.nmat > 0 for name, env in observed.items()}
    assert materials == {None: False, "pictures": True, "recording": True}


def test_render_without_a_render_mode_returns_none():
    env = gymnasium.make("stage/RegisterTuning-v0").unwrapped
    env.reset(seed=1)
    assert env.render() is None


PROGRAM = """
import sys
from types import SimpleNamespace

import mujoco
from stage import StageError
from stage.envs.rendering import make_viewer

if "no EGL" in sys.argv:
    sys.modules["mujoco.egl"] = None
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><camera name='c'/><light/></worldbody></mujoco>")
for _ in range(2):
    for mode in ("human", "rgb_array"):
        try:
            print(make_viewer(SimpleNamespace(model=model, data=mujoco.MjData(model)), mode, "c", 64, 48).render_stage().shape)
        except StageError as error:
            print(mode, error)
"""


def run_rendering_program(*argv, **environment):
    """Run a program that opens a window and a picture twice, and return its output."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")}
    command = [sys.executable, "-c", PROGRAM, *argv]
    finished = subprocess.run(command, env=inherited | environment, capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout.splitlines(), finished.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="screens and EGL are Linux's")
@pytest.mark.parametrize(
    ("argv", "environment", "human", "picture"),
    [
        ([], {"DISPLAY": ":99"}, "human MuJoCo's viewer cannot open a window here: .*:99", "rgb_array no OpenGL .*:99"),
        (["no EGL"], {}, "human there is no screen here", "rgb_array no OpenGL to render with .*mujoco.egl"),
        ([], {"MUJOCO_GL": "glfw"}, "human there is no screen here", "rgb_array no OpenGL to render with .*DISPLAY"),
    ],
    ids=["a screen that is off", "no screen, no EGL", "no screen, GLFW asked for"],
)
def test_rendering_without_opengl_is_refused_and_the_process_continues(argv, environment, human, picture):
    """env = gymnasium.make("stage/RegisterTuning-v0", render_mode="human"); env.reset(); env.reset()"""
    message, _ = run_rendering_program(*argv, **environment)
    for line, expected in zip(message, (human, picture) * 2, strict=True):
        assert re.match(expected, line)


@pytest.mark.skipif(sys.platform != "linux" or not ctypes.util.find_library("EGL"), reason="no EGL on this machine")
def test_without_a_screen_pictures_are_rendered_by_egl():
    """env = gymnasium.make("stage/RegisterTuning-v0", render_mode="rgb_array"); env.reset(); env.render(); env.render()"""
    message, errors = run_rendering_program()
    if any("no OpenGL" in line for line in message):
        pytest.skip("an EGL without a device")
    assert message[1::2] == ["(48, 64, 3)"] * 2
    assert errors == ""


def test_a_picture_larger_than_the_offscreen_buffer_is_refused_with_an_explanation():
    """gymnasium.make(..., model="small_buffer.xml", render_mode="rgb_array").render()"""
    import mujoco

    from stage.support.opengl import make_renderer

    model = mujoco.MjModel.from_xml_string('<mujoco><visual><global offwidth="64" offheight="48"/></visual></mujoco>')
    with pytest.raises(StageError, match=r'larger than .* 64 x 48: <visual><global offwidth="640" offheight="480"/>'):
        make_renderer(model, 480, 640)
    for height, width in ((48, 65), (49, 64)):
        with pytest.raises(StageError, match=f"a picture of {width} x {height} pixels is larger"):
            make_renderer(model, height, width)


@pytest.mark.skipif(not {"MUJOCO_GL", "DISPLAY"} & set(os.environ), reason="no GL on this machine")
def test_a_video_of_moves_shows_the_carriage_moving():
    """RecordVideo(gymnasium.make("stage/RegisterTuning-v0", render_mode="rgb_array"), "videos"): nothing moves in the video."""
    env = make_env("stage/RegisterTuning-v0", "rgb_array")
    env.reset(seed=1)
    begin = env.render()
    env.step(np.zeros(env.action_space.shape, np.float32))
    assert (env.render() != begin).any()
    env.close()


@pytest.mark.parametrize("id_", MOVES)
def test_a_frame_after_a_step_shows_the_end_of_that_step(id_, frames, monkeypatch):
    """env.reset(); env.render(); env.step(action); env.render(): two equal pictures."""
    env = make_env(id_, "rgb_array")
    env.reset(seed=1)
    assert (env.render() == env.stage.data.qpos).all()
    ends, act = [], type(env._task).play_actions
    monkeypatch.setattr(
        type(env._task), "play_actions", lambda task: (act(task), ends.append(task.stages[0].data.qpos.copy()))
    )
    env.step(np.zeros(env.action_space.shape, np.float32))
    assert (env.render() == ends[-1]).all()
    assert (frames()[0] != frames()[1]).any(), "it has moved"
    env.reset()
    assert (env.render() == env.stage.data.qpos).all(), "a new episode"


@pytest.mark.parametrize(
    ("id_", "mode"),
    [
        *((id_, "rgb_array_list") for id_ in MOVES),
        *(pytest.param(id_, "human", marks=[pytest.mark.slow] if k else []) for k, id_ in enumerate(MOVES)),
    ],
)
def test_frames_of_a_complete_move_show_its_motion_and_change_nothing(id_, mode, frames):
    """gymnasium.make("stage/OriginReturn-v0", render_mode="rgb_array_list"): a frame a step, the origin in each."""
    env = make_env(id_, mode)
    message, basic = play_episode(env), play_episode(make_env(id_))
    for (observed, *_, info), (expected, *_, wanted) in zip(message, basic, strict=True):
        assert np.array_equal(observed, expected)
        assert info.get("duration") == wanted.get("duration")
    if mode == "rgb_array_list":
        assert len(env.render()) == len(frames())
        assert env.render() == [], "each frame once"
    seconds = [s[4].get("duration", 0.3) for s in message[1:]]
    assert len(frames()) >= sum(int(s * 30) + 1 for s in seconds)
    moved = [np.abs(b - a).max() for a, b in zip(frames(), frames()[1:], strict=False)]
    assert np.count_nonzero(np.array(moved) > 1e-5) > len(seconds), "more than the ends"


def test_a_window_pauses_between_the_frames_of_a_move(frames, monkeypatch):
    """gymnasium.make("stage/OriginReturn-v0", render_mode="human"): a pause between two frames, none before the first."""
    env, order = make_env("stage/OriginReturn-v0", "human"), []
    monkeypatch.setattr("time.sleep", order.append)
    monkeypatch.setattr(Watcher, "render_stage", lambda self, qpos=None: order.append("frame"))
    env._add_frames(np.zeros((3, env.stage.model.nq)), None)
    assert order == ["frame", 1 / 30, "frame", 1 / 30, "frame"]


def test_each_bus_cycle_renders_a_frame_and_recording_works_at_the_same_time(frames, tmp_path):
    env = make_env("stage/RegisterBus-v0", "rgb_array_list")
    env.reset(seed=1)
    env.step(np.array([5, 0, 0, 0]))
    assert len(env.render()) == 2
    files = str(tmp_path / "{}.rrd")
    both, alone = (
        make_env("stage/ServoTuning-v0", "rgb_array_list", record=r, render_every=0.02) for r in (files, None)
    )
    play_episode(both), play_episode(alone)
    both.close()
    assert np.array_equal(both.render(), alone.render())
    assert (tmp_path / "1.rrd").exists(), "the second step's"


def test_frames_are_render_every_seconds_apart(frames):
    """gymnasium.make(..., render_mode="rgb_array_list", render_every=0.01)"""
    counts = {}
    for every in (0.01, 0.02, None):
        env = make_env("stage/RegisterTuning-v0", "rgb_array_list", render_every=every, moves=1)
        assert env.metadata["render_fps"] == round(1 / (every or 1 / 30))
        play_episode(env)
        counts[every] = len(env.render())
    assert counts[0.01] == pytest.approx(2 * counts[0.02], abs=2)
    assert counts[0.02] == pytest.approx(counts[None] * 5 / 3, abs=2)
    host = make_env("stage/RegisterBus-v0", "rgb_array_list", render_every=0.05)
    for _ in range(2):  # episodes
        host.reset(seed=1)
        for _ in range(10):
            host.step(np.array([4, 0, 0, 0]))  # 10 ms
        assert len(host.render()) == 3, "the begin, 50 ms, 100 ms"
    for wrong in (0, -1, float("nan"), "often"):
        with pytest.raises(ArgumentError, match="render_every="):
            make_env("stage/RegisterBus-v0", render_every=wrong)


def test_unread_frames_are_discarded_at_the_next_reset(frames):
    env = gymnasium.make(
        "stage/RegisterBus-v0", model="xy", render_mode="rgb_array_list", render_every=0.05, waits=(0.03,),
        disable_env_checker=True,
    ).unwrapped  # fmt: skip
    wait = np.array([2, 0, 0, 0])
    env.reset(seed=1)
    for _ in range(5):
        env.step(wait)
    env.reset(seed=2)
    assert len(env.render()) == 1, "where the new one begins"
    counts = []
    for _ in range(4):
        env.step(wait)
        counts.append(len(env.render()))
    assert counts == [0, 1, 0, 1], "0.05 s from the begin of the new one, not of the old"


def test_a_window_that_cannot_open_is_explained_regardless_of_the_warning_filter(monkeypatch):
    """python -W ignore"""
    glfw = SimpleNamespace(init=lambda: warnings.warn("DISPLAY is missing", stacklevel=1))
    monkeypatch.setitem(sys.modules, "glfw", glfw)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert [opengl._find_glfw_failure() for _ in range(2)] == ["DISPLAY is missing"] * 2


@pytest.mark.parametrize(
    ("system", "variables", "present"),
    [
        ("darwin", {}, True),
        ("linux", {}, False),
        ("linux", {"DISPLAY": ":0"}, True),
        ("linux", {"WAYLAND_DISPLAY": "w"}, True),
    ],
)
def test_a_screen_is_detected_from_system_and_environment_variables(system, variables, present, monkeypatch):
    monkeypatch.setattr(sys, "platform", system)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert opengl.has_screen() is present
