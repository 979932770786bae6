"""Promises of a process that writes many recordings: its threads and its memory stay as they are."""

import subprocess
import sys
from pathlib import Path

import pytest

from stage import Stage

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="the threads are counted in /proc")

MANY = """
import sys
from pathlib import Path
from stage import Stage
def state():
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines["Threads"]), int(lines["VmRSS"].split()[0])
stage = Stage("xyz", visuals=False)
for number in range(220):
    with stage.record() as recording:
        stage.run(0.01)
    recording.save(sys.argv[1], overwrite=True)
    if number in (19, 219):
        print(*state())
"""


def count_rerun_threads():
    """Count the threads of this process that rerun has started for recording streams."""
    names = [path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")]
    return sum(name.startswith(("ChunkBatcher", "RecordingStream")) for name in names)


@pytest.mark.parametrize("write", ["save", "stream"])
def test_a_recording_that_is_written_leaves_no_thread(tmp_path, write):
    stage = Stage("xy", visuals=False)
    for number in range(3):
        path = tmp_path / f"{number}.rrd"
        with stage.record(path=path if write == "stream" else None) as recording:
            stage.run(0.01)
        if write == "save":
            recording.save(path)
        assert path.stat().st_size
        assert count_rerun_threads() == 0


def test_series_of_the_oscilloscope_leave_no_thread(tmp_path):
    pytest.importorskip("nicegui")
    from stage.panel.oscilloscope import to_rrd
    from stage.panel.sampler import Sampler
    from stage.panel.session import UNPACED_SPEED, Session

    session = Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True)
    sampler = Sampler(session)
    try:
        session.do(lambda stage: session.run_unpaced(lambda stage: stage.run(0.01), stage))
        for _ in range(2):
            assert to_rrd(sampler, ["x/position"], 0, 1).startswith(b"RRF")
            assert count_rerun_threads() == 0
    finally:
        sampler.close()
        session.close()


@pytest.mark.slow
def test_two_hundred_recordings_leave_threads_constant_and_memory_bounded(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", MANY, tmp_path / "a.rrd"], capture_output=True, text=True, timeout=600, check=True
    )
    (threads, kilobytes), (threads_after, kilobytes_after) = (
        map(int, line.split()) for line in done.stdout.splitlines()
    )
    assert threads_after == threads
    assert kilobytes_after - kilobytes < 40_000  # 4 MB each were 800,000
