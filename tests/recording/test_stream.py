"""Promises of a recording that is written as it goes: kills, full disks, and the same contents as a saved one."""

import gc
import json
import signal
import subprocess
import sys
import threading
import warnings
import weakref
from pathlib import Path

import numpy as np
import pytest
from support.recording_bench import Full, drive, read_rrd, rerun_cli

from stage import ArgumentError, Stage
from stage.chips import PCL240K
from stage.recording import RecordingError, RecordingWarning
from stage.recording.recording import BUFFER_ROWS
from stage.recording.rerun_file_writer import RrdSink

KILLED = """
import json, os, signal, sys
from stage import Stage, firmware
stage = Stage("xy", visuals=False)
recording = stage.record(path=sys.argv[1])
firmware.preset_move(stage.axes["x"], 3200)
stage.run(1.5)
recording.flush()
print(json.dumps([stage.time, len(recording), stage.axes["x"].commanded]), flush=True)
stage.axes["x"].chip.write(0, 0x10)
stage.run(0.3)
os.kill(os.getpid(), signal.SIGKILL)
"""

LIMITED = """
import os, resource, sys
from stage import Stage
from stage.recording import RecordingError
stage = Stage("xy", visuals=False)
def limit(size):  # as a disk with room for so many bytes
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    sys.dont_write_bytecode = True  # of bytecode that does not fit Python keeps half
"""


def child(code, *args, **kwargs):
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, args)], capture_output=True, text=True, timeout=120, **kwargs
    )


def shake(stage, seconds):
    """Keep the x axis busy at FL, to and fro."""
    chip = stage.axes["x"].chip
    for number, value in ((1, 1000), (2, 1000), (4, 100), (5, 100), (7, 600)):
        chip.write(0, 0x80 | number)
        for address in (3, 2, 1):
            chip.write(address, value >> 8 * (address - 1) & 0xFF)
    end, sign = stage.time + seconds, 0
    while stage.time < end:
        for command in (0x08, 0x40 | sign, 0x10):
            chip.write(0, command)
        stage.run(0.25)
        sign ^= 0x08


def test_what_was_flushed_survives_a_kill(tmp_path):
    path = tmp_path / "killed.rrd"
    done = child(KILLED, path)
    assert done.returncode == -signal.SIGKILL, done.stderr
    time, samples, commanded = json.loads(done.stdout)
    read = read_rrd(path)
    times, values = read["/axes/x/position"]["Scalars:scalars"]
    assert times[-1] * 1e-9 == pytest.approx(time, abs=1e-3)
    assert values[-1][0] == pytest.approx(commanded * 1e3, abs=0.02), "mm"
    times, states = read["/axes/x/phase"]["StateChange:state"]
    assert [s[0] for s in states] == ["hold", "up", "keep", "down", "keep", "hold"]
    assert any("start, ramp to FH1" in s[0] for s in read["/axes/x/bus"]["TextLog:text"][1])
    stats = rerun_cli("rrd", "stats", path)
    assert stats.returncode == 0, stats.stderr
    assert samples > 1500


@pytest.mark.parametrize("cut", [1, 1000, 5000])
def test_of_a_kill_in_the_middle_of_a_write_rerun_mends_the_file(tmp_path, cut):
    path, stage = tmp_path / "cut.rrd", Stage("xy", visuals=False)
    with stage.record(path=path) as recording:
        shake(stage, 0.5)
        recording.flush()
        complete = path.stat().st_size
        shake(stage, 0.5)
        recording.flush()
        torn = path.read_bytes()[: complete + cut]
    path.write_bytes(torn)
    repaired = tmp_path / "mended.rrd"
    assert rerun_cli("rrd", "merge", path, "-o", repaired).returncode == 0
    assert rerun_cli("rrd", "verify", repaired).returncode == 0
    times = read_rrd(repaired)["/axes/x/position"]["Scalars:scalars"][0]
    assert times.max() * 1e-9 >= 0.49


def test_a_streamed_file_says_what_a_saved_one_says(tmp_path):
    stage = Stage("xyz", chips=PCL240K)
    with stage.record().stream(tmp_path / "streamed.rrd", seconds=0.05) as recording:
        drive(stage)
    recording.save(tmp_path / "saved.rrd")
    assert rerun_cli("rrd", "verify", tmp_path / "streamed.rrd").returncode == 0
    streamed, saved = (read_rrd(tmp_path / f"{name}.rrd") for name in ("streamed", "saved"))
    assert set(streamed) == set(saved)
    time = recording.column("time")
    for entity, components in saved.items():
        assert set(components) == set(streamed[entity]), entity
        for name, (times, values) in components.items():
            also, as_well = streamed[entity][name]
            if name == "Scalars:scalars":
                a, b = (np.interp(time, t * 1e-9, np.concatenate(v)) for t, v in ((times, values), (also, as_well)))
                assert np.abs(a - b).max() <= 1 + 1e-6, entity
            elif name in ("StateChange:state", "TextLog:text"):
                assert (also.tolist(), as_well) == (times.tolist(), values), entity
            elif times is None and entity != "/about" and not name.startswith("RecordingInfo:"):
                assert as_well[-1] == values[-1], (entity, name)


def test_a_stream_is_written_at_the_interval_and_when_the_buffer_is_full(tmp_path):
    stage, path = Stage("xy", visuals=False), tmp_path / "x.rrd"
    with stage.record().stream(path, seconds=0.1):
        size = path.stat().st_size
        stage.run(0.05)
        assert path.stat().st_size == size
        stage.run(0.06)
        assert path.stat().st_size > size
    stage, path = Stage("xy", visuals=False), tmp_path / "y.rrd"
    with stage.record().stream(path, seconds=1e6):
        size = path.stat().st_size
        stage.run(BUFFER_ROWS * 1e-3 + 0.5)
        assert path.stat().st_size == size


def test_a_full_disk_ends_the_run_or_warns_as_requested(tmp_path):
    code = (
        LIMITED
        + """
path, on_error = sys.argv[1:]
recording = stage.record().stream(path, seconds=0.1, on_error=on_error)
stage.run(0.15)
limit(os.stat(path).st_size + 4000)
try:
    stage.run(3)
    print("went on", stage.time)
except RecordingError as error:
    print("raised", error)
before, samples = stage.time, len(recording)
stage.run(0.1)
assert stage.time > before, "the stage is as good as before"
assert len(recording) > samples, "and is still recorded"
"""
    )
    for on_error, said in (("raise", "raised"), ("warn", "went on")):
        path = tmp_path / f"{on_error}.rrd"
        done = child(code, path, on_error)
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith(said)
        message = done.stdout if on_error == "raise" else done.stderr
        assert "cannot be written: File too large. It ends with the last flush" in message
        assert ("RecordingWarning" in done.stderr) == (on_error == "warn")
        assert read_rrd(path)["/axes/x/position"]["Scalars:scalars"][0].max() >= 0.1e9


@pytest.mark.parametrize(("write", "name"), [("save", "x.rrd"), ("to_vcd", "x.vcd")])
def test_a_full_disk_is_an_error_of_ours_and_leaves_nothing(tmp_path, write, name):
    """rerun's own file sink would wait for ever."""
    code = (
        LIMITED
        + """
with stage.record() as recording:
    for k in range(600):
        stage.axes["x"].chip.write(0, 0x10 if k % 2 else 0x08)
        stage.run(2e-3)
limit(1000)
try:
    getattr(recording, sys.argv[2])(sys.argv[1])
except RecordingError as error:
    print(error)
"""
    )
    done = child(code, tmp_path / name, write)
    assert f"{name} cannot be written: File too large" in done.stdout, done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_device_that_is_full_is_an_error_at_once():
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    stage = Stage("xy", visuals=False)
    with pytest.raises(RecordingError, match="/dev/full cannot be written: No space left"):
        stage.record(path="/dev/full", overwrite=True)
    with stage.record():
        pass


def test_an_existing_file_is_overwritten_only_on_request(tmp_path):
    stage, path = Stage("xy", visuals=False), tmp_path / "precious.rrd"
    path.write_text("mine")
    with pytest.raises(RecordingError, match=r"precious\.rrd exists"):
        stage.record(path=path)
    assert path.read_text() == "mine"
    with stage.record(path=path, overwrite=True):
        stage.run(0.01)
    assert path.read_bytes() != b"mine"


def test_wrong_arguments_are_named(tmp_path):
    stage = Stage("xy", visuals=False)
    with pytest.raises(ArgumentError, match="on_error='ignore': 'raise' or 'warn'"):
        stage.record(path=tmp_path / "x.rrd", on_error="ignore")
    with pytest.raises(RecordingError, match="is no folder"):
        stage.record(path=tmp_path / "nowhere" / "x.rrd")
    recording = stage.record(path=tmp_path / "x.rrd")
    with pytest.raises(RecordingError, match="goes to a file already"):
        recording.stream(tmp_path / "y.rrd")
    recording.close()
    with pytest.raises(RecordingError, match="is over"):
        recording.stream(tmp_path / "y.rrd")
    with pytest.raises(ArgumentError, match="more than 0 s"):
        stage.record().stream(tmp_path / "y.rrd", seconds=0)


def test_a_full_temporary_file_warns_and_the_run_continues_on_request(tmp_path, monkeypatch):
    stage = Stage("xy", visuals=False)
    recording = stage.record(path=tmp_path / "x.rrd", on_error="warn")

    file = recording._file
    monkeypatch.setattr(recording, "_file", Full())
    with pytest.warns(RecordingWarning, match="No space left.*TMPDIR"):
        stage.run(BUFFER_ROWS * 1e-3 + 0.5)
    recording._file = file
    assert len(recording) == len(recording.columns["time"]) == 0, "what was lost is not counted"
    assert stage.time == pytest.approx(BUFFER_ROWS * 1e-3 + 0.5)


def test_a_program_that_ends_without_closing_leaves_a_complete_file(tmp_path):
    code = """
import sys
from stage import Stage
stage = Stage("xy", visuals=False)
recording = stage.record(path=sys.argv[1])
stage.run(0.5)
sys.exit(int(sys.argv[2]))
"""
    for status in (0, 3):
        done = child(code, path := tmp_path / f"{status}.rrd", status)
        assert (done.returncode, done.stderr) == (status, "")
        assert rerun_cli("rrd", "verify", path).returncode == 0
        assert read_rrd(path)["/axes/x/position"]["Scalars:scalars"][0].max() == pytest.approx(0.5e9, rel=1e-3)


def test_a_good_stream_leaves_no_warning_and_no_thread(tmp_path):
    stage = Stage("xy", visuals=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with stage.record(path=tmp_path / "x.rrd") as recording:
            stage.run(0.1)
            assert "rerun file" in {t.name for t in threading.enumerate()}
    assert "rerun file" not in {t.name for t in threading.enumerate()}
    gone = weakref.ref(recording)
    del recording
    gc.collect()
    assert gone() is None, "nobody keeps it any more"


class Pipe:
    """rerun's stream, as far as a Sink knows it."""

    def save(self, path, default_blueprint):
        self.end = open(path, "wb", buffering=0)  # noqa: SIM115

    def flush(self, timeout_sec):
        pass

    def disconnect(self):
        pass  # its end of the pipe stays open: nobody may wait for rerun


@pytest.mark.parametrize(("let_go", "expected"), [(RrdSink.close, b"early, late"), (RrdSink.abandon, b"early")])
def test_a_file_that_is_let_go_is_closed_and_nobody_collects_for_it_any_more(tmp_path, let_go, expected):
    """recording.close(), and a recording whose disk is full: neither keeps a file or a thread"""
    out = Pipe()
    sink = RrdSink(out, tmp_path / "a.rrd", None, False)
    out.end.write(b"early")
    sink.flush()
    out.end.write(b", late")
    for _ in range(2):
        let_go(sink)
        assert not sink._thread.is_alive()
        assert sink._file.closed
    assert (tmp_path / "a.rrd").read_bytes() == expected
    out.end.close()


def test_a_stream_is_written_once_in_so_many_seconds_and_not_at_each_step(tmp_path, monkeypatch):
    """stage.record(path="a.rrd", seconds=0.5): what is written counts, as each time costs a pass through rerun"""
    stage = Stage("xy", visuals=False)
    recording = stage.record(every=0.01).stream(tmp_path / "a.rrd", seconds=0.5)
    written, flush = [], recording.flush
    monkeypatch.setattr(recording, "flush", lambda: written.append(len(recording)) or flush())
    for _ in range(30):
        stage.run(0.05)
    assert len(written) == 3
    recording.close()
