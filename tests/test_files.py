"""What writes a file never writes over another one unasked, and says what goes wrong in errors of our own."""

import errno
import fcntl
import os
import resource
import stat
import sys
from contextlib import contextmanager

import numpy as np
import pytest

from stage import Stage, StageError, firmware
from stage.cli import main
from stage.drives.motors import Drive
from stage.drives.pull_out_plot import plot_pull_out
from stage.recording import RecordingError
from stage.recording.rerun_viewer import take_screenshot
from stage.support.files import FileError, find_figure_format, is_stream, write_atomically

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def stage():
    return Stage("xyz", visuals=False)


def make_drawing_functions(stage):
    """Name -> a function of a path and `overwrite` that draws to it."""
    from stage.drives.dynamometer import tabulate_pull_out

    report = firmware.preset_move(stage.axes["x"], 40)
    both = firmware.synchronized_move({"x": 40, "y": 20}, stage.axes)
    table = tabulate_pull_out(Drive(), np.array([100.0, 600.0]))
    return {
        "report": report.plot,
        "synchronized": both.plot,
        "pull-out": lambda path, overwrite=False: plot_pull_out(Drive(), table, path, overwrite),
    }


def test_a_drawing_is_overwritten_only_on_request(stage, tmp_path):
    for name, draw in make_drawing_functions(stage).items():
        path = tmp_path / f"{name}.png"
        if name == "report":
            draw(path)
            assert path.read_bytes()[1:4] == b"PNG"
        path.write_text("mine")
        with pytest.raises(FileError, match=r"exists\. Choose another name, or say overwrite=True"):
            draw(path)
        assert path.read_text() == "mine"
        draw(path, overwrite=True)
        assert path.read_bytes()[1:4] == b"PNG"
    assert len(list(tmp_path.iterdir())) == 3, "nothing half-written is left"


def test_a_figure_has_the_format_of_its_name_however_that_is_written():
    assert [find_figure_format(name) for name in ("a.PNG", "a.Svg", "/dev/stdout")] == ["png", "svg", "png"]
    with pytest.raises(FileError, match="a figure is no 'foo'"):
        find_figure_format("a.FOO")
    for name in ("a", "b.c/a"):
        with pytest.raises(FileError, match=r"the name has no ending, .*Name a file that ends in \.png, "):
            find_figure_format(name)


def test_a_drawing_that_cannot_be_written_says_so(stage, tmp_path):
    report = firmware.preset_move(stage.axes["x"], 40)
    with pytest.raises(FileError, match="is no folder"):
        report.plot(tmp_path / "nowhere" / "x.png")
    with pytest.raises(FileError, match="is a folder"):
        report.plot(tmp_path)


def test_a_screenshot_is_overwritten_only_on_request(tmp_path):
    rrd, png = tmp_path / "x.rrd", tmp_path / "x.png"
    rrd.write_bytes(b"")
    png.write_text("mine")
    with pytest.raises(FileError, match="exists"):
        take_screenshot(rrd, png)
    assert png.read_text() == "mine"


@pytest.mark.parametrize(
    ("output", "ending"), [("--record", "rrd"), ("--vcd", "vcd"), ("--plot", "png"), ("--picture", "png")]
)
def test_a_command_refuses_a_file_that_exists_before_it_moves(tmp_path, capsys, output, ending):
    path = tmp_path / f"precious.{ending}"
    path.write_text("mine")
    assert main(["move", "x", "40", output, str(path)]) == 2
    assert f"precious.{ending} exists" in capsys.readouterr().err
    assert path.read_text() == "mine"


def test_a_command_overwrites_with_force(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for force in ([], ["--force"]):
        assert main(["move", "x", "40", "--record", "x.rrd", "--vcd", "x.vcd", "--plot", "x.png", *force]) == 0
    assert sorted(f.name for f in tmp_path.iterdir()) == ["x.png", "x.rrd", "x.vcd"]


def test_a_full_disk_is_reported_and_leaves_the_old_file_unchanged(tmp_path):
    path = tmp_path / "x.bin"
    path.write_text("mine")

    def write():
        with write_atomically(path, True) as part:
            part.write_text("half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(FileError, match="No space left on device"):
        write()
    assert [f.name for f in tmp_path.iterdir()] == ["x.bin"]
    assert path.read_text() == "mine"


def make_null_device(path, number=(1, 3)):
    """/dev/null under another name, so that a failure costs nothing."""
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(*number))
    except OSError:
        pytest.skip("only root makes devices")


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_a_device_takes_the_bytes_and_stays_a_device(tmp_path, capsys, force):
    """stage move x 100 --force --vcd /dev/null"""
    make_null_device(tmp_path / "null")
    assert main(["move", "x", "100", *force, "--vcd", str(tmp_path / "null")]) == 0
    assert stat.S_ISCHR((tmp_path / "null").stat().st_mode)
    assert [f.name for f in tmp_path.iterdir()] == ["null"]


def test_a_device_that_is_full_says_so(tmp_path):
    """stage move x 100 --force --vcd /dev/full"""
    make_null_device(tmp_path / "full", (1, 7))
    with pytest.raises(FileError, match="No space left on device"), write_atomically(tmp_path / "full", True) as part:
        part.write_text("half")
    assert stat.S_ISCHR((tmp_path / "full").stat().st_mode)


@contextmanager
def make_pipe(path):
    """A pipe at `path` with room for a small recording; its end to read from."""
    os.mkfifo(path)
    end = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    fcntl.fcntl(end, fcntl.F_SETPIPE_SZ, 1 << 20)
    try:
        yield end
    finally:
        os.close(end)


@pytest.mark.skipif(not hasattr(fcntl, "F_SETPIPE_SZ"), reason="pipes of another system")
@pytest.mark.parametrize("force", [False, True])
def test_a_pipe_takes_the_bytes_and_stays_a_pipe(tmp_path, force):
    """mkfifo p; cat p & stage move x 100 --vcd p"""
    path = tmp_path / "p"
    with make_pipe(path) as end:
        with write_atomically(path, force) as part:
            part.write_bytes(b"bytes")
        assert os.read(end, 100) == b"bytes"
    assert stat.S_ISFIFO(path.stat().st_mode)


@pytest.mark.skipif(not hasattr(fcntl, "F_SETPIPE_SZ"), reason="pipes of another system")
def test_a_recording_streams_into_a_pipe(stage, tmp_path):
    """mkfifo p; cat p > x.rrd & python -c 'stage.record(path="p")'"""
    path = tmp_path / "p"
    with make_pipe(path) as end:
        with stage.record(path=path):
            stage.run(0.01)
        assert os.read(end, 3) == b"RRF"
    assert stat.S_ISFIFO(path.stat().st_mode)


def test_a_link_is_followed_to_its_file(tmp_path):
    """ln -s far/x.vcd x.vcd; stage move x 100 --force --vcd x.vcd"""
    (tmp_path / "far").mkdir()
    link, file = tmp_path / "x.vcd", tmp_path / "far" / "x.vcd"
    link.symlink_to(file)
    for text in ("new", "newer"):
        with write_atomically(link, True) as part:
            part.write_text(text)
        assert link.is_symlink()
        assert file.read_text() == text
    with pytest.raises(FileError, match="exists"), write_atomically(link, False):
        pass
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    with pytest.raises(FileError, match="cannot be written"), write_atomically(loop, True):
        pass
    assert file.read_text() == "newer"


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_appears_meanwhile_stays(tmp_path, monkeypatch, links):
    """stage demo --record x.rrd & stage demo --record x.rrd"""

    def refuse(*_):
        raise OSError(errno.EOPNOTSUPP, "a file system without hard links")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    path = tmp_path / "x.rrd"
    with write_atomically(path, False) as part:
        part.write_text("first")
    assert path.read_text() == "first"
    path.unlink()

    def second():
        with write_atomically(path, False) as part:
            part.write_text("mine")
            path.write_text("another's")

    with pytest.raises(FileError, match="appeared meanwhile"):
        second()
    assert path.read_text() == "another's"
    assert [f.name for f in tmp_path.iterdir()] == ["x.rrd"]


def test_the_bytes_are_on_the_disk_before_the_name_is(tmp_path, monkeypatch):
    """stage move x 100 --record x.rrd, and the power fails"""
    synced, path = [], tmp_path / "x"
    monkeypatch.setattr(os, "fsync", lambda file: synced.append((os.fstat(file).st_ino, path.exists())))
    for overwrite in (False, True):
        with write_atomically(path, overwrite) as part:
            part.write_text("all")
        assert synced == [(path.stat().st_ino, overwrite), (tmp_path.stat().st_ino, True)]
        synced.clear()


def test_a_replaced_file_keeps_its_mode_and_is_written_in_a_private_folder(tmp_path):
    """ln -s /etc/passwd .x.1234.part.vcd; stage move x 100 --vcd x.vcd"""
    path = tmp_path / "x.vcd"
    path.write_text("old")
    path.chmod(0o640)
    with write_atomically(path, True) as part:
        assert stat.S_IMODE(part.parent.stat().st_mode) == 0o700
        assert part.name == path.name
        part.write_text("new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_disk_is_no_place_for_a_file(tmp_path):
    """stage move x 100 --force --vcd /dev/sda"""
    try:
        os.mknod(tmp_path / "sda", stat.S_IFBLK | 0o600, os.makedev(7, 250))
    except OSError:
        pytest.skip("only root makes devices")
    with pytest.raises(FileError, match="is a disk"), write_atomically(tmp_path / "sda", True):
        pass


@contextmanager
def limit_file_size(size):
    """A disk with room for files of so many bytes."""
    before, wrote = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    sys.dont_write_bytecode = True  # of bytecode that does not fit Python keeps half
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = wrote


def test_a_study_on_a_full_disk_keeps_its_trials_and_continues_later(tmp_path):
    pytest.importorskip("optuna")
    from stage.study import count_finished, read_study, run, suggest_registers

    def objective(trial):
        return suggest_registers(trial, {"R2": "400:3600"})["R2"]

    place = tmp_path / "study"
    run(objective, place, 2)
    for more in (1, 30, 100):  # in the middle of a line
        before = count_finished(read_study(place))
        full = pytest.raises(FileError, match=r"File too large.*What was recorded before is safe")
        with full, limit_file_size(place.stat().st_size + more):
            run(objective, place, before + 1)
        assert count_finished(read_study(place)) == before
        assert count_finished(run(objective, place, before + 1)) == before + 1


def test_file_errors_are_stage_errors():
    assert issubclass(RecordingError, FileError)
    assert issubclass(FileError, StageError)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_an_open_file_descriptor_is_appended_to_under_any_of_its_paths(tmp_path, monkeypatch):
    """stage ... > log, with /dev/stdout as the file to write: what the log has already stays"""
    log = tmp_path / "log"
    with log.open("wb") as open_file:
        open_file.write(b"first\n")
        open_file.flush()
        name = f"proc/self/fd/{open_file.fileno()}"
        monkeypatch.chdir("/")
        for path in (f"/{name}", name):
            assert is_stream(path)
            with write_atomically(path, False) as part:
                part.write_bytes(b"second\n")
    assert log.read_bytes() == b"first\nsecond\nsecond\n"
    assert not is_stream(log)
    assert not is_stream(tmp_path / "none")
