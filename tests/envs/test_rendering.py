"""`render`: frames where there is GL, and a clear word where there is none."""

import os

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
