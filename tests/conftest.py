import ctypes.util
import gc
import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # processes of tests keep bytecode, as users' do
if sys.platform == "linux" and "DISPLAY" not in os.environ and ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # frames without a screen; must be said before MuJoCo is imported

from support.examples import FIXED


def pytest_collection_finish():
    """What the session keeps to its end is no rubbish: a gc.collect() of a test then need not look at all of it."""
    gc.collect()
    gc.freeze()


settings.register_profile("stage", derandomize=FIXED)
settings.load_profile("stage")


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """For what MuJoCo warns of, as a simulation that diverges: it writes MUJOCO_LOG.TXT into the working directory."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def fresh():
    from stage import Stage
    from stage.chips import PCL240K

    return Stage("xy", chips=PCL240K, visuals=False)


@pytest.fixture
def xy(fresh):
    """Two axes at rest."""
    fresh.reset()
    return fresh
