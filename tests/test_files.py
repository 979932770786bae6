"""What writes a file never writes over another one unasked, and says what goes wrong in errors of our own."""

import errno
import resource
from contextlib import contextmanager

import numpy as np
import pytest

from stage import Stage, StageError, firmware
from stage.cli import main
from stage.drives.motors import Drive
from stage.drives.picture import plot_pull_out
from stage.files import FileError, written
from stage.recording import RecordingError
from stage.recording.viewer import screenshot

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def stage():
    return Stage("xyz", visuals=False)


def drawings(stage):
    """Name -> a function of a path and `overwrite` that draws to it."""
    from stage.drives.dynamometer import pull_out_table

    report = firmware.preset_move(stage.axes["x"], 40)
    both = firmware.synchronized_move({"x": 40, "y": 20}, stage.axes)
    table = pull_out_table(Drive(), np.array([100.0, 600.0]))
    return {
        "report": report.plot,
        "synchronized": both.plot,
        "pull-out": lambda path, overwrite=False: plot_pull_out(Drive(), table, path, overwrite),
    }


def test_a_drawing_stays_unless_overwriting_is_asked_for(stage, tmp_path):
    for name, draw in drawings(stage).items():
        path = tmp_path / f"{name}.png"
        draw(path)
        assert path.read_bytes()[1:4] == b"PNG"
        path.write_text("mine")
        with pytest.raises(FileError, match=r"exists\. Choose another name, or say overwrite=True"):
            draw(path)
        assert path.read_text() == "mine"
        draw(path, overwrite=True)
        assert path.read_bytes()[1:4] == b"PNG"
    assert len(list(tmp_path.iterdir())) == 3, "nothing half-written is left"


def test_a_drawing_that_cannot_be_written_says_so(stage, tmp_path):
    report = firmware.preset_move(stage.axes["x"], 40)
    with pytest.raises(FileError, match="is no folder"):
        report.plot(tmp_path / "nowhere" / "x.png")
    with pytest.raises(FileError, match="is a folder"):
        report.plot(tmp_path)


def test_a_screenshot_stays_unless_overwriting_is_asked_for(tmp_path):
    rrd, png = tmp_path / "x.rrd", tmp_path / "x.png"
    rrd.write_bytes(b"")
    png.write_text("mine")
    with pytest.raises(FileError, match="exists"):
        screenshot(rrd, png)
    assert png.read_text() == "mine"


@pytest.mark.parametrize("output", ["--record", "--vcd", "--plot", "--picture"])
def test_a_command_refuses_a_file_that_exists_before_it_moves(tmp_path, capsys, output):
    path = tmp_path / "precious"
    path.write_text("mine")
    assert main(["move", "x", "40", output, str(path)]) == 2
    assert "precious exists" in capsys.readouterr().err
    assert path.read_text() == "mine"


def test_a_command_overwrites_with_force(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for force in ([], ["--force"]):
        assert main(["move", "x", "40", "--record", "x.rrd", "--vcd", "x.vcd", "--plot", "x.png", *force]) == 0
    assert sorted(f.name for f in tmp_path.iterdir()) == ["x.png", "x.rrd", "x.vcd"]


def test_a_full_disk_is_named_and_leaves_what_was_there(tmp_path):
    path = tmp_path / "x.bin"
    path.write_text("mine")

    def write():
        with written(path, True) as part:
            part.write_text("half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(FileError, match="No space left on device"):
        write()
    assert [f.name for f in tmp_path.iterdir()] == ["x.bin"]
    assert path.read_text() == "mine"


@contextmanager
def room(size):
    """A disk with room for files of so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_study_on_a_full_disk_keeps_what_was_recorded_and_goes_on_later(tmp_path):
    pytest.importorskip("pyarrow")
    from stage.study import Definition, Record, Study, Trial, read

    wanted = Definition("stage.study.objectives:preset_moves", space={"R2": "400:3600"}, trials=3, seed=1)
    one, two = (Record(Trial(id, {"R2": 500}, 1, {}), {"score": 1.0}) for id in (0, 1))
    with Study.open(tmp_path / "study", wanted) as study:
        study.append([one])
        with pytest.raises(FileError, match=r"File too large.*What was recorded before is safe"), room(500):
            study.append([two])
        assert read(tmp_path / "study")["id"].to_pylist() == [0]
        study.append([two])
    with Study.open(tmp_path / "study", wanted) as study:
        assert study.pending() == [2]
    assert not list((tmp_path / "study").rglob("*.tmp"))


def test_file_errors_are_stage_errors():
    assert issubclass(RecordingError, FileError)
    assert issubclass(FileError, StageError)
