"""Columns as data frames and files, and read back from an .rrd: each says what was recorded."""

import csv
import json
import re
from functools import partial

import numpy as np
import pytest
from support.extras import needs_rerun
from support.recording_bench import feed

from stage import ArgumentError
from stage.cli import main
from stage.recording import RecordingError, read
from stage.recording.axis_series import SERIES
from stage.recording.recording import BUFFER_ROWS
from stage.support.files import FileError

FEW = ["x/position", "x/lost_steps", "x/el_minus"]


@pytest.fixture(scope="module")
def saved(rrd):
    return read(rrd)


def test_a_data_frame_has_every_column_over_time_and_the_units(run):
    frame, columns = run.recording.to_pandas(), run.recording.columns
    assert frame.index.name == "time"
    assert np.array_equal(frame.index, columns.pop("time"))
    assert {name: frame[name].dtype for name in frame} == {name: v.dtype for name, v in columns.items()}
    assert all(np.array_equal(frame[name], v) for name, v in columns.items())
    assert [frame.attrs["units"][f"x/{c}"] for c in ("position", "rate", "el_plus")] == ["m", "pps", ""]


def test_a_column_requested_twice_is_written_once(run, tmp_path):
    path = run.recording.to_csv(tmp_path / "run.csv", [*FEW, "time", *FEW])
    assert path.read_text().splitlines()[0].split(",") == ["time", *FEW]


@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
def test_a_file_has_the_requested_columns_bit_for_bit(run, tmp_path, ending):
    path = run.recording.to_file(tmp_path / f"run.{ending}", FEW)
    if ending == "npz":
        with np.load(path) as archive:
            target = dict(archive)
    elif ending == "csv":
        with path.open(newline="") as file:
            rows = [*csv.reader(file)]
        target = {name: np.array(values, float) for name, *values in zip(*rows, strict=True)}
    else:
        table = pytest.importorskip("pyarrow.parquet").read_table(path)
        target = {name: table[name].to_numpy() for name in table.column_names}
        assert table.schema.field("x/position").metadata == {b"unit": b"m"}
        assert json.loads(table.schema.metadata[b"pulsestage"])["units"]["x/lost_steps"] == "full steps"
    assert list(target) == ["time", *FEW]
    assert all(np.array_equal(target[name], run.recording.column(name)) for name in target)


def test_files_are_written_in_pieces_and_hold_them_all(bench, tmp_path):
    """more samples than the buffer has"""
    feed(bench.recording, 17 * BUFFER_ROWS + 5)
    pandas = pytest.importorskip("pandas")
    exact = partial(pandas.read_csv, float_precision="round_trip")
    for ending, load in (("parquet", pandas.read_parquet), ("csv", exact)):
        target = load(bench.recording.to_file(tmp_path / f"long.{ending}", ["x/position"]))
        assert np.array_equal(target["x/position"], bench.recording.column("x/position"))


def test_a_recording_of_nothing_is_a_table_of_nothing(bench, tmp_path):
    bench.recording.close()
    assert len(bench.recording.to_pandas()) == 0
    text = bench.recording.to_csv(tmp_path / "empty.csv", ["x/rate"]).read_text()
    assert text == "time,x/rate\n"
    assert bench.recording.to_parquet(tmp_path / "empty.parquet").stat().st_size > 0


def test_what_cannot_be_written_is_refused_and_nothing_is_left(run, tmp_path):
    with pytest.raises(ArgumentError, match=r"unknown column 'x/postion'.*Did you mean 'x/position'"):
        run.recording.to_pandas(["x/postion"])
    with pytest.raises(FileError, match=r"a table is no 'xlsx'.*\.csv, \.parquet, \.npz"):
        run.recording.to_file(tmp_path / "run.xlsx")
    (tmp_path / "mine.csv").write_text("mine")
    with pytest.raises(RecordingError, match=r"mine\.csv exists"):
        run.recording.to_csv(tmp_path / "mine.csv")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("mine.csv", "mine")]


# --- read back ---


def test_what_is_read_back_is_what_was_recorded_within_the_tolerance_of_its_plot(run, saved):
    target, columns = saved.columns, run.recording.columns
    assert np.array_equal(np.rint(target["time"] * 1e9), np.rint(columns["time"] * 1e9))
    both = target.keys() & columns.keys()
    assert len(both) == 1 + 3 * (7 + 5), "seven series of a stepper, and five switches"
    for name in both - {"time"}:
        column = name.partition("/")[2]
        series = SERIES.get(column)
        limit = 0.5 if column == "counter" else series.tolerance / series.scales[0] if series else 0
        tolerance = limit + (0.5 if column == "counter" else 1e-9)  # a counter is rounded to pulses
        assert np.abs(target[name].astype(float) - columns[name]).max() <= tolerance, name
        assert saved.units[name] == run.recording.units[name]
    assert target["x/phase"][0] == "up"
    assert set(target["x/phase"]) == {"up", "keep", "down", "hold"}


def test_a_read_file_has_the_axes_and_the_model(run, saved):
    assert (saved.model, list(saved.axes), saved.every) == ("PulseStage xyz", ["x", "y", "z"], pytest.approx(1e-3))
    assert saved.axes["x"].startswith("PCL240K at 4915200 Hz, 17HS4401")
    assert len(saved) == len(run.recording)
    times, states = saved.states["x/el_minus"]
    assert list(states) == ["off", "EL-", "off"]
    assert np.all(np.diff(times) > 0)
    assert (len(saved.bus), saved.bus[0][1].split()[0], saved.bus == sorted(saved.bus)) == (31, "x", True)


@needs_rerun
def test_the_writes_of_all_axes_are_in_order(xy, tmp_path):
    x, y = xy.axes.values()
    with xy.record() as recording:
        for axis in (y, x, y):
            axis.chip.write(0, 0x40)
            xy.run(1e-3)
    saved = read(recording.save(tmp_path / "a.rrd"))
    assert [text.split()[0] for _, text in saved.bus] == ["y", "x", "y"]


def test_a_run_that_was_killed_is_read_up_to_its_last_flush(tmp_path, xy):
    """stage.record(path="x.rrd"); a copy of the file as it is after a flush"""
    with xy.record(path=tmp_path / "x.rrd") as recording:
        xy.run(0.05)
        recording.flush()
        (tmp_path / "killed.rrd").write_bytes((tmp_path / "x.rrd").read_bytes())
        xy.run(0.05)
    assert [len(read(tmp_path / f"{name}.rrd")) for name in ("killed", "x")] == [50, 100]


@needs_rerun
def test_what_is_no_recording_is_refused_in_words(rrd, tmp_path):
    complete = rrd.read_bytes()
    foreign = tmp_path / "foreign.rrd"
    rr = pytest.importorskip("rerun")
    stream = rr.RecordingStream("other")
    stream.save(str(foreign))
    stream.log("a", rr.Scalars(1.0))
    stream.disconnect()
    for name, content, message in (
        ("missing", None, "there is no recording"),
        ("empty", b"", "is empty, and no recording"),
        ("text", b"time,x\n" * 1000, "is no recording: an .rrd file begins with RRF, and this does not"),
        ("cut", complete[: len(complete) // 3], "is damaged: .*rerun rrd merge .* keeps what is whole"),
        ("foreign", foreign.read_bytes(), "is a rerun file, but no recording of this PulseStage"),
    ):
        path = tmp_path / f"{name}.rrd"
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(RecordingError, match=message):
            read(path)
    with pytest.raises(RecordingError, match="is a folder"):
        read(tmp_path)


# --- stage export ---


def test_the_command_lists_columns_and_writes_them(rrd, tmp_path, capsys, monkeypatch):
    """stage export run.rrd; stage export run.rrd -o few.csv --columns x/position,x/rate"""
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(rrd)]) == 0
    message = capsys.readouterr().out
    assert "640 samples, 1 ms apart" in message
    assert "  x/position               m\n" in message
    assert main(["export", str(rrd), "-o", "few.csv", "--columns", "x/position, x/rate"]) == 0
    assert capsys.readouterr().out == "few.csv: 640 samples of 3 columns, 0.0 MB\n"
    assert (tmp_path / "few.csv").read_text().startswith("time,x/position,x/rate\n0.001,")


def test_a_recording_is_not_written_over_itself(tmp_path, capsys):
    """stage export a.csv -o a.csv --force"""
    path = tmp_path / "a.csv"
    path.write_text("mine")
    assert main(["export", str(path), "-o", str(tmp_path / "." / "a.csv"), "--force"]) == 2
    assert "this is the recording itself. Name another file." in capsys.readouterr().err
    assert path.read_text() == "mine"


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["-o", "a.xlsx"], r"a\.xlsx: a table is no 'xlsx'\. Name a file that ends in \.csv, \.parquet, \.npz\."),
        (["-o", "there.csv"], r"there\.csv exists\. Choose another name, or give --force\."),
        (["-o", "a.csv", "--columns", "x/positon"], "unknown column 'x/positon'. Did you mean 'x/position'"),
    ],
)
def test_the_command_says_what_it_cannot_do(rrd, tmp_path, capsys, monkeypatch, argv, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.csv").write_text("")
    assert main(["export", str(rrd), *argv]) == 2
    assert re.match(f"stage: {message}", capsys.readouterr().err)
    assert [p.name for p in tmp_path.iterdir()] == ["there.csv"]
