"""One short run of the xyz stage, recorded, for all tests here."""

from types import SimpleNamespace

import pytest
from support.recording_bench import drive, make_bench

from stage import Stage
from stage.chips import PCL240K


@pytest.fixture(scope="session")
def run():
    """The stage after its run, and the recording of it, closed."""
    stage = Stage("xyz", chips=PCL240K)
    with stage.record() as recording:
        drive(stage)
    return SimpleNamespace(stage=stage, recording=recording)


@pytest.fixture(scope="session")
def rrd(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("rrd") / "run.rrd"
    assert run.recording.save(path) == path
    return path


@pytest.fixture
def bench():
    """A chip alone in a Recording, as Stage makes one, and a way to feed it rows."""
    return make_bench()
