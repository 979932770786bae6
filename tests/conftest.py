import ctypes.util
import gc
import os
import re
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # processes of tests keep bytecode, as users' do
if sys.platform == "linux" and "DISPLAY" not in os.environ and ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # frames without a screen; must be said before MuJoCo is imported

from support.examples import FIXED

import stage.testing.failed_test_files  # noqa: F401 (pytester forgets the modules that an inner test imports first)

sys.dont_write_bytecode = (
    False  # nor do tests without it: pytest would rewrite the asserts of all of them in each worker, each time
)
collect_ignore = [  # by plain `pytest` and `make test`
    *("board", "firmware_c", "targets", "native/test_native_library.py", "test_tutorials.py"),  # `make test-firmware`
    *("testing/test_host_serial.py", "testing/test_many.py", "testing/test_plugin.py"),
    *("panel", "agents", "serve"),  # `make test-servers`
    "ioc",  # `make test-ioc`
]
BACKWARDS = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]) % 2 == 1
LINES = [
    line
    for line in (Path(__file__).parent / "slow_tests.txt").read_text().splitlines()
    if line and not line.startswith("#")
]
SLOW: dict[str, list[str]] = {}  # file -> its lines
for line in LINES:
    SLOW.setdefault(line.partition("::")[0], []).append(line)


def pytest_sessionstart():
    """Load the native library, which a fresh checkout builds first: its progress is no output of the first test that needs it."""
    from stage.chips import PCL240K

    PCL240K()


class Backwards(pytest.Dir):
    """A folder that is collected from its end."""

    def collect(self):
        return reversed(list(super().collect()))


def pytest_collect_directory(path, parent):
    """Every second worker begins at the end. pytest rewrites the asserts of a file once, and keeps that: two that go the same
    way would do it at the same time, each for all files."""
    return Backwards.from_parent(parent, path=path) if BACKWARDS and not (path / "__init__.py").exists() else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark the tests of slow_tests.txt as slow, and refuse a line without a test: it has another name now."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: item.path.parts)  # the same in every worker
    matched_lines, files = set(), set()
    for item in items:
        file = item.nodeid.partition("::")[0]
        files.add(file)
        for line in SLOW.get(file, ()):
            begin, _, end = line.partition("*")
            if item.nodeid.startswith(begin) and item.nodeid.endswith(end):
                item.add_marker("slow")
                matched_lines.add(line)
    if not any("::" in arg for arg in config.args):
        for file in files:
            for line in SLOW.get(file, ()):
                if line not in matched_lines:
                    raise pytest.UsageError(f"tests/slow_tests.txt: there is no test {line}")


def pytest_collection_finish():
    """Exclude the collected tests from later garbage collections, which makes gc.collect() in a test faster."""
    gc.collect()
    gc.freeze()


settings.register_profile("stage", derandomize=FIXED, deadline=None)
settings.load_profile("stage")


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """Change to a temporary folder: MuJoCo writes MUJOCO_LOG.TXT into the working directory when it warns."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def work_folder(tmp_path, monkeypatch):
    """Change to a temporary folder, without a display."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return tmp_path


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


@pytest.fixture
def xyz(fresh):
    """The module's stage at rest; its switches stick no longer than the test."""
    fresh.reset()
    yield fresh
    for axis in fresh.axes.values():
        for name in axis.switches.as_dict():
            axis.switches.stick(name, None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup():
    return (yield from skip_without_library())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call():
    return (yield from skip_without_library())


REQUIRED = tuple(filter(None, os.environ.get("PULSESTAGE_REQUIRE", "").split(",")))
"""Words, as "simavr,avr-gcc": a test whose reason to be skipped has one of them fails instead, for machines that must have it."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """Fail a test that is skipped for the lack of what PULSESTAGE_REQUIRE names."""
    report = yield
    reason = report.longrepr[2] if report.skipped and isinstance(report.longrepr, tuple) else ""
    if any(re.search(rf"\b{re.escape(word)}\b", reason) for word in REQUIRED):
        report.outcome, report.longrepr = "failed", f"PULSESTAGE_REQUIRE={','.join(REQUIRED)} forbids: {reason}"
    return report


def skip_without_library():
    """Skip a test whose optional library is not installed, with its name, so that a small installation passes."""
    from stage.support.extras import LIBRARIES, ExtraMissing, is_installed

    try:
        return (yield)
    except ExtraMissing as missing:
        if all(is_installed(library) for library, (_, extra) in LIBRARIES.items() if extra == missing.extra):
            raise
        pytest.skip(str(missing))
