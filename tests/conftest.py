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

SLOW = tuple(
    line
    for line in (Path(__file__).parent / "slow_tests.txt").read_text().splitlines()
    if line and not line.startswith("#")
)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Those of slow_tests.txt are slow. A line of which a whole file has no test is an error: it has another name now."""
    for item in items:
        if item.nodeid.startswith(SLOW):
            item.add_marker("slow")
    if not any("::" in arg for arg in config.args):
        names, files = [item.nodeid for item in items], {item.nodeid.partition("::")[0] for item in items}
        for line in SLOW:
            if line.partition("::")[0] in files and not any(name.startswith(line) for name in names):
                raise pytest.UsageError(f"tests/slow_tests.txt: there is no test {line}")


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
