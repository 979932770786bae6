"""Files that commands write and read: impossible ones are refused before the work begins."""

import json
import os
import shlex
import subprocess
import sys

import pytest

from stage import firmware
from stage.cli import main


@pytest.fixture(autouse=True)
def work_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--record x.mp4", "stage: x.mp4: a recording is no 'mp4'. Name a file that ends in .rrd.\n"),
        ("--record x", "stage: x: the name has no ending, and that says the format. Name a file that ends in .rrd.\n"),
        ("--vcd x.rrd", "stage: x.rrd: a file of waveforms is no 'rrd'. Name a file that ends in .vcd.\n"),
        (
            "--plot move",
            "stage: move: the name has no ending, and that says the format. Name a file that ends in .png, ",
        ),
        ("--picture q.jpg", "stage: q.jpg: a rendered picture is no 'jpg'. Name a file that ends in .png.\n"),
        ("--plot a.foo", "stage: a.foo: a figure is no 'foo'. Name a file that ends in .png, "),
        ("--plot nowhere/a.png", "stage: nowhere is no folder. Make it first, or choose another.\n"),
    ],
)
def test_a_file_of_another_kind_is_refused_before_the_run(options, message, work_folder, capsys, monkeypatch):
    """stage move x 100 --record x.mp4 wrote an .rrd named so"""
    monkeypatch.setattr(firmware, "move", None)
    assert main(["move", "x", "100", *options.split()]) == 2
    assert capsys.readouterr().err.startswith(message)
    assert not list(work_folder.iterdir())


def test_a_new_model_is_printed_where_its_file_is_a_dash(work_folder, capsys):
    """stage new-model -o - wrote a file named -"""
    assert main(["new-model", "-o", "-"]) == 0
    assert capsys.readouterr().out.startswith("<!-- A stage for PulseStage")
    assert main(["new-model", "-o", "my"]) == 2
    assert "Name a file that ends in .xml" in capsys.readouterr().err
    assert not list(work_folder.iterdir())


def test_a_picture_of_a_model_is_checked_before_it_is_drawn(work_folder, capsys):
    assert main(["view", "xy", "--picture", "a.gif"]) == 2
    assert "a rendered picture is no 'gif'" in capsys.readouterr().err


@pytest.fixture
def interrupted(monkeypatch):
    """Ctrl-C, 0.05 s after the start of a move."""

    def wait(port, *_):
        port.axis.stage.run(0.05)
        raise KeyboardInterrupt

    monkeypatch.setattr("stage.firmware.pcl240.chip_port.ChipPort.wait_until_stopped", wait)


def test_ctrl_c_draws_the_move_until_then_and_reports_the_interrupt(interrupted, work_folder, capsys):
    """stage move x 100mm --plot m.png, and Ctrl-C: nothing was said, and nothing drawn"""
    assert main(["move", "x", "100mm", "--plot", "m.png"]) == 130
    out, err = capsys.readouterr()
    assert "interrupted after 0.05 s of simulated time\n" in out
    assert "preset move on x: NOT as asked, stopped by Ctrl-C" in out
    assert "m.png: drawn" in out
    assert err == "stage: interrupted.\n"
    assert (work_folder / "m.png").read_bytes().startswith(b"\x89PNG")


def test_ctrl_c_prints_the_json_of_the_move_until_then(interrupted, capsys):
    """stage move x 100mm --json, and Ctrl-C"""
    assert main(["move", "x", "100mm", "--json"]) == 130
    out, err = capsys.readouterr()
    facts = json.loads(out)
    assert (facts["interrupted"], facts["reports"][0]["stopped_by"]) == (True, "Ctrl-C")
    assert json.loads(err) == {"error": "interrupted.", "type": "KeyboardInterrupt"}


def test_ctrl_c_names_the_file_that_was_not_written(work_folder, capsys, monkeypatch):
    """stage pullout --plot p.png, and Ctrl-C"""

    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("stage.drives.dynamometer.tabulate_pull_out", stop)
    assert main(["pullout", "--plot", "p.png"]) == 130
    assert capsys.readouterr().err == "stage: interrupted: nothing to write yet for --plot p.png.\n"


def test_a_home_that_cannot_be_written_to_makes_matplotlib_say_nothing(tmp_path):
    """HOME=/read-only stage move x 100 --plot m.png"""
    program = (
        "from stage.support.extras import import_extra; "
        "import_extra('matplotlib.figure', 'drawing'); import os; print(os.environ['MPLCONFIGDIR'])"
    )
    env = {k: v for k, v in os.environ.items() if not k.startswith(("MPL", "XDG_"))} | {"HOME": os.devnull}
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert "pulsestage-matplotlib-" in done.stdout
    assert not os.path.exists(done.stdout.strip()), "and the folder goes at the end"


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_command_whose_standard_streams_are_closed_does_its_work(closed, tmp_path):
    command = f"exec {shlex.quote(sys.executable)} -m stage move x 10 --vcd move.vcd {closed}"
    assert subprocess.run(["sh", "-c", command], cwd=tmp_path, timeout=60).returncode == 0
    assert (tmp_path / "move.vcd").read_text().startswith("$")


def test_files_do_not_get_the_numbers_of_closed_streams(tmp_path):
    code = "from stage.cli.output_and_progress import open_missing_streams; open_missing_streams(); "
    code += "print(open('a', 'w').fileno(), file=open('b', 'w'))"
    command = f"exec {shlex.quote(sys.executable)} -c {shlex.quote(code)} <&- >&- 2>&-"
    subprocess.run(["sh", "-c", command], cwd=tmp_path, check=True, timeout=60)
    assert int((tmp_path / "b").read_text()) > 2
