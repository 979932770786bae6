"""Promises of a recording: columns, life, files that are never lost, memory that does not grow."""

import os
import subprocess
import sys

import numpy as np
import pytest
from support.recording_bench import Full, drive, feed, make_bench, read_rrd

from stage import ArgumentError, Stage, StageError
from stage.chips import PCL240K
from stage.recording.axis_series import SERIES
from stage.recording.recording import BUFFER_ROWS, COLUMNS, RecordingError


def test_the_last_sample_is_the_state_of_the_stage(run):
    """Recorded until a step's end, so that nothing moves in between."""
    stage = Stage("xyz", chips=PCL240K)
    with stage.record() as recording:
        drive(stage)
        stage.step(3)
        stage.step(4 - round(stage.time / 250e-6) % 4)
    c = recording.columns
    assert c["time"][-1] == pytest.approx(stage.time, abs=1e-12)
    for name, axis in stage.axes.items():
        assert c[f"{name}/position"][-1] == pytest.approx(axis.position, abs=1e-12)
        assert c[f"{name}/commanded"][-1] == pytest.approx(axis.commanded, abs=1e-12)
        assert c[f"{name}/following_error"][-1] == pytest.approx(axis.commanded - axis.position, abs=1e-12)
        assert c[f"{name}/load_angle"][-1] == pytest.approx(axis.load_angle, abs=1e-9)
        assert c[f"{name}/lost_steps"][-1] == axis.lost_steps
        assert c[f"{name}/counter"][-1] == axis.chip.values()["R0"]
        for pin, level in axis.chip.pins.as_dict().items():
            assert c[f"{name}/{pin}"][-1] == level, pin


def test_a_series_is_drawn_in_the_units_that_it_names():
    """times the SI value: metres and radians, volts, full steps ..."""
    degrees = 180 / np.pi
    of = {"mm": 1e3, "um": 1e6, "deg": degrees, "mdeg": 1e3 * degrees, "electrical deg": degrees}
    for name, s in SERIES.items():
        assert s.scales == pytest.approx([of.get(unit, 1) for unit in s.units], rel=1e-12), name


FORKED = """
import os, sys, warnings
import numpy as np
from stage import Stage, firmware

def tell(who, recording):
    c = recording.columns
    increasing = bool((np.diff(c["time"]) > 0).all())
    print(who, len(recording), f"{np.abs(c['x/position']).max():.4f}", increasing, flush=True)

stage = Stage("xy", visuals=False)
recording = stage.record(every=0.25e-3, path=sys.argv[1])
stage.run(1.3)  # so that some of it is in the file
child = os.fork()
if child == 0:
    with warnings.catch_warnings(record=True) as said:
        firmware.preset_move(stage.axes["x"], 3200)
        stage.run(2.0)
    print(said[0].message, flush=True)
    tell("child", recording)
    os._exit(0)
stage.run(1.5)
os.waitpid(child, 0)
recording.close()
tell("parent", recording)
"""


def test_a_fork_and_its_parent_record_separately(tmp_path):
    """os.fork() while recording: a parent that never moved recorded 10 mm"""
    path = tmp_path / "parent.rrd"
    reported = subprocess.run(
        [sys.executable, "-c", FORKED, path], stdout=subprocess.PIPE, text=True, check=True, timeout=100
    ).stdout.splitlines()
    assert reported[0].startswith(f"{path} stays that of the process that began it")
    assert reported[1].split()[0::2] == ["child", "0.0100"]
    assert reported[1].endswith("True")
    assert reported[2:] == ["parent 11200 0.0000 True"]
    assert path.stat().st_size > 10_000


def test_every_quantity_and_every_pin_of_every_axis_has_a_column(run):
    c = run.recording.columns
    assert {len(v) for v in c.values()} == {len(run.recording)}
    for name, axis in run.stage.axes.items():
        for column in COLUMNS:
            assert c[f"{name}/{column}"].dtype.kind in "fi"
        for pin in (*axis.chip.INPUTS, *axis.chip.OUTPUTS):
            assert c[f"{name}/{pin}"].dtype == bool
    assert len(c) == 1 + 3 * (len(COLUMNS) + len(PCL240K.INPUTS) + len(PCL240K.OUTPUTS))


def test_the_columns_describe_the_run(run):
    c = run.recording.columns
    assert np.allclose(np.diff(c["time"]), 1e-3)
    assert c["x/el_minus"].any()
    assert not c["z/el_minus"].any()
    assert c["x/rate"].max() == pytest.approx(10_000, rel=0.01)
    assert c["y/pulses"][-1] == -1500
    assert np.abs(c["x/following_error"]).max() < 50e-6
    assert np.allclose(c["y/position"][-20:].mean(), c["y/commanded"][-1], atol=5e-6)


def test_one_column_is_read_by_name_and_a_slip_is_named(run):
    assert np.array_equal(run.recording.column("x/rate"), run.recording.columns["x/rate"])
    with pytest.raises(ArgumentError, match=r"unknown column 'x/positon'.*Did you mean 'x/position'"):
        run.recording.column("x/positon")


def test_it_says_how_long_it_is(run):
    r = run.recording
    assert r.duration == pytest.approx(len(r) * 1e-3)
    assert r.duration == pytest.approx(run.stage.time - r.began, abs=1.1e-3)
    assert repr(r) == f"<Recording closed, {len(r)} samples of x, y, z, {r.duration:.3f} s>"


def test_samples_have_the_requested_interval():
    stage = Stage("xy", chips=PCL240K)
    with stage.record(every=5e-3) as recording:
        stage.run(0.1)
    assert np.allclose(np.diff(recording.column("time")), 5e-3)
    assert recording.every == pytest.approx(5e-3)


def test_close_twice_is_close_once_and_the_stage_can_be_recorded_again():
    stage = Stage("xy", chips=PCL240K)
    recording = stage.record()
    stage.run(0.01)
    with pytest.raises(StageError, match="already being recorded"):
        stage.record()
    recording.close()
    recording.close()
    stage.run(0.01)
    assert len(recording) == 10
    with stage.record() as second:
        stage.run(0.01)
    assert len(second) == 10
    assert second.column("time")[0] == pytest.approx(0.021)
    assert stage.axes["x"].chip.open_journal is None


def test_an_error_inside_the_block_closes_the_recording():
    stage = Stage("xy", chips=PCL240K)
    recording = stage.record()
    stage.run(0.01)
    with pytest.raises(ZeroDivisionError), recording:
        1 / 0  # noqa: B018
    assert "closed" in repr(recording)
    assert len(recording.column("time")) == 10


def last_time(path):
    """Return the last time of any entity in a rerun file, s."""
    series = (times for entity in read_rrd(path).values() for times, _ in entity.values())
    return max(times.max() for times in series if times is not None) * 1e-9


def test_a_running_recording_can_be_saved(tmp_path):
    stage = Stage("xy", chips=PCL240K)
    with stage.record() as recording:
        stage.run(0.05)
        recording.save(tmp_path / "half.rrd")
        recording.to_vcd(tmp_path / "half.vcd")
        assert len(recording.column("time")) == 50
        stage.run(0.05)
    assert len(recording) == 100
    recording.save(tmp_path / "whole.rrd")
    assert [last_time(tmp_path / f"{name}.rrd") for name in ("half", "whole")] == pytest.approx([0.05, 0.1], abs=2e-3)
    assert (tmp_path / "half.vcd").stat().st_size > 0


def test_a_recording_of_nothing_can_be_saved(bench, tmp_path):
    recording = bench.recording
    recording.close()
    assert recording.save(tmp_path / "empty.rrd").stat().st_size > 0
    assert recording.to_vcd(tmp_path / "empty.vcd").stat().st_size > 0
    assert {len(v) for v in recording.columns.values()} == {0}


@pytest.mark.parametrize(("write", "name"), [("save", "x.mp4"), ("save", "x"), ("to_vcd", "x.rrd")])
def test_a_file_of_another_kind_is_not_named_so(run, tmp_path, write, name):
    """recording.save("x.mp4") wrote a recording"""
    with pytest.raises(
        RecordingError, match=rf"{name}: .*Name a file that ends in \.{'rrd' if write == 'save' else 'vcd'}"
    ):
        getattr(run.recording, write)(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("write", "name"), [("save", "precious.rrd"), ("to_vcd", "precious.vcd")])
def test_an_existing_file_is_overwritten_only_on_request(run, tmp_path, write, name):
    path = tmp_path / name
    path.write_text("mine")
    with pytest.raises(RecordingError, match=rf"{name} exists\. Choose another name, or say overwrite=True"):
        getattr(run.recording, write)(path)
    assert path.read_text() == "mine"
    getattr(run.recording, write)(path, overwrite=True)
    assert path.read_bytes() != b"mine"
    assert [f.name for f in tmp_path.iterdir()] == [name], "no half-written file is left"


@pytest.mark.parametrize(
    ("where", "message"), [("nowhere/x.rrd", "is no folder. Make it first"), (".", "is a folder. Name a file in it")]
)
def test_where_it_cannot_write_it_says_why(run, tmp_path, where, message):
    with pytest.raises(RecordingError, match=message):
        run.recording.save(tmp_path / where)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_named(run, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(RecordingError, match="no permission"):
        run.recording.save(tmp_path / "x.rrd")


def test_a_failed_save_leaves_the_old_file(run, tmp_path, monkeypatch):
    path = run.recording.to_vcd(tmp_path / "x.vcd")
    before = path.read_bytes()
    monkeypatch.setattr("stage.recording.vcd_writer._compute_levels", lambda *a: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.recording.to_vcd(path, overwrite=True)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_ends_the_recording_with_advice_and_preserves_the_samples(bench, monkeypatch):
    recording = bench.recording
    feed(recording, BUFFER_ROWS + 10)

    file = recording._file
    monkeypatch.setattr(recording, "_file", Full())
    with pytest.raises(RecordingError, match=f"closed after {BUFFER_ROWS} samples.*No space left.*TMPDIR"):
        feed(recording, BUFFER_ROWS)
    recording._file = file
    assert recording.filled == 0
    assert "closed" in repr(recording)
    assert len(recording.column("time")) == BUFFER_ROWS


def test_a_stage_that_went_back_in_time_is_detected(tmp_path):
    bench = make_bench()
    feed(bench.recording, 2 * BUFFER_ROWS)
    bench.recording.samples["time"][:] = 0.5
    bench.recording.samples["time"][5:] = 0.1
    bench.recording.take_rows(BUFFER_ROWS)
    with pytest.raises(RecordingError, match="went back in time"):
        bench.recording.save(tmp_path / "x.rrd")
    assert len(bench.recording.column("time")) == 3 * BUFFER_ROWS


def test_a_single_chip_that_went_back_in_time_is_detected(bench, tmp_path):
    """before = chip.snapshot(); stage.run(1); chip.write(0, 8); chip.restore(before); recording.save("x.rrd")"""
    before = bench.chip.snapshot()
    bench.chip.advance(1000)
    bench.chip.write(0, 0x08)
    bench.recording.require_forward_time()
    bench.chip.restore(before)
    with pytest.raises(RecordingError, match="went back in time"):
        bench.recording.save(tmp_path / "x.rrd")


def test_rows_come_back_as_they_were_across_buffers(bench):
    feed(bench.recording, 2 * BUFFER_ROWS + 123)
    time = bench.recording.column("time")
    assert np.allclose(time, np.arange(1, len(time) + 1) * 1e-3)
    assert np.allclose(bench.recording.column("x/position"), 0.1 * np.sin(time))
    assert [len(p) for p in bench.recording.pieces(rows=5000)] == [5000, 2 * BUFFER_ROWS - 5000, 123]


@pytest.mark.parametrize(
    "begin", [0, 2 * BUFFER_ROWS - 100, 2 * BUFFER_ROWS, 2 * BUFFER_ROWS + 23, 2 * BUFFER_ROWS + 123]
)
def test_pieces_from_a_sample_on_leave_none_out_whether_it_is_on_disk_or_in_memory(bench, begin):
    """recording.pieces(begin=n), n shortly before the last sample that has gone to the temporary file"""
    feed(bench.recording, 2 * BUFFER_ROWS + 123)
    rows = [row for piece in bench.recording.pieces(begin=begin) for row in piece["axes"]["time"][:, 0]]
    assert np.array_equal(rows, bench.recording.column("time")[begin:])


MEMORY = """
import resource, sys
sys.path[:0] = {path!r}
from support.recording_bench import feed, make_bench
def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
short = make_bench(3).recording
feed(short, 5000)
short.save({folder!r} + "/short.rrd"); short.to_vcd({folder!r} + "/short.vcd"); short.column("x/rate")
before = peak()
long = make_bench(3).recording
feed(long, {rows})
kept = peak()
long.column("x/rate"); long.save({folder!r} + "/long.rrd"); long.to_vcd({folder!r} + "/long.vcd")
print(kept - before, peak() - before)
"""


@pytest.mark.slow
def test_a_quarter_of_an_hour_of_three_axes_costs_little_memory_to_keep_and_to_save(tmp_path):
    here = os.path.dirname(__file__)
    code = MEMORY.format(path=[here, os.path.dirname(here)], folder=str(tmp_path), rows=900_000)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    expected, saved = map(float, done.stdout.split())
    assert expected < 20, "MiB while it runs"
    assert saved < 150, "MiB more at its peak, while it saves"


def test_the_sample_interval_is_the_nearest_number_of_physics_steps(xy):
    """stage.record(every=0.4e-3): every 0.5 ms, of steps of 0.25 ms"""
    for every, steps in ((0.4e-3, 2), (0.3e-3, 1), (1e-6, 1), (0.9e-3, 4)):
        with xy.record(every=every) as recording:
            xy.run(4e-3)
        assert recording.every == pytest.approx(steps * 0.25e-3)
        assert np.diff(recording.column("time")) == pytest.approx(recording.every)


def test_a_recording_begins_with_the_first_of_its_chips():
    """A chip whose clock has a tick a millisecond began a part of one before the others"""
    stage = Stage("xy", chips={"x": PCL240K, "y": lambda: PCL240K(1000)}, visuals=False)
    stage.run(1.6e-3)
    with stage.record() as recording:
        stage.run(1e-3)
    assert recording.began == 1e-3
