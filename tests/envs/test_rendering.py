"""`render`: frames where there is GL, and a clear word where there is none."""

import ctypes.util
import os
import re
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import StageError


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


def test_an_unknown_camera_is_named():
    env = gymnasium.make("stage/RegisterTuning-v0", render_mode="rgb_array", camera="overveiw").unwrapped
    env.reset(seed=1)
    with pytest.raises(StageError, match=r"camera 'overveiw'.*overview"):
        env.render()


def test_without_a_render_mode_there_is_nothing_to_render():
    env = gymnasium.make("stage/RegisterTuning-v0").unwrapped
    env.reset(seed=1)
    assert env.render() is None


PROGRAM = """
import sys
from types import SimpleNamespace

import mujoco
from stage import StageError
from stage.envs.rendering import viewer

if "no EGL" in sys.argv:
    sys.modules["mujoco.egl"] = None
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><camera name='c'/><light/></worldbody></mujoco>")
for _ in range(2):
    for mode in ("human", "rgb_array"):
        try:
            print(viewer(SimpleNamespace(model=model, data=mujoco.MjData(model)), mode, "c", 64, 48).frame().shape)
        except StageError as error:
            print(mode, error)
"""


def rendered(*argv, **environment):
    """What a program says that asks twice for a window and for a picture."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")}
    command = [sys.executable, "-c", PROGRAM, *argv]
    ended = subprocess.run(command, env=inherited | environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.splitlines(), ended.stderr


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
def test_without_opengl_each_rendering_is_refused_and_the_process_lives(argv, environment, human, picture):
    """env = gymnasium.make("stage/RegisterTuning-v0", render_mode="human"); env.reset(); env.reset()"""
    said, _ = rendered(*argv, **environment)
    for line, expected in zip(said, (human, picture) * 2, strict=True):
        assert re.match(expected, line)


@pytest.mark.skipif(sys.platform != "linux" or not ctypes.util.find_library("EGL"), reason="no EGL on this machine")
def test_without_a_screen_pictures_are_rendered_by_egl():
    """env = gymnasium.make("stage/RegisterTuning-v0", render_mode="rgb_array"); env.reset(); env.render(); env.render()"""
    said, errors = rendered()
    if any("no OpenGL" in line for line in said):
        pytest.skip("an EGL without a device")
    assert said[1::2] == ["(48, 64, 3)"] * 2
    assert errors == ""


def test_a_picture_larger_than_the_models_buffer_is_refused_in_words():
    """gymnasium.make(..., model="small_buffer.xml", render_mode="rgb_array").render()"""
    import mujoco

    from stage.opengl import renderer

    model = mujoco.MjModel.from_xml_string('<mujoco><visual><global offwidth="64" offheight="48"/></visual></mujoco>')
    with pytest.raises(StageError, match=r'larger than .* 64 x 48: <visual><global offwidth="640" offheight="480"/>'):
        renderer(model, 480, 640)
