"""The command `stage`, as a stranger would run it."""

import os
import subprocess
import sys
import time

import pytest

from stage.cli import main


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return tmp_path


def out(capsys, *argv, code=0):
    assert main(list(argv)) == code
    return capsys.readouterr()


def seconds(*command):
    """Of the processor, which do not count how busy the machine is; by the clock where the system does not tell."""
    before, begin = os.times(), time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    after, took = os.times(), time.perf_counter() - begin
    spent = sum(after[2:4]) - sum(before[2:4])  # children's, user and system
    return min(spent, took) if spent else took


def test_help_comes_at_once_and_importing_is_cheap():
    python = sys.executable
    assert min(seconds(python, "-m", "stage", "--help") for _ in range(3)) < 0.5
    assert min(seconds(python, "-c", "import stage") for _ in range(3)) < 1.0


def test_a_second_start_takes_less_than_two_seconds(here):
    command = (sys.executable, "-c", "from stage import Stage; Stage('xyz').run(0.1)")
    seconds(*command)
    assert min(seconds(*command) for _ in range(3)) < 2.0


def test_the_demo_homes_moves_and_writes_a_recording(here, capsys):
    said = out(capsys, "demo", "--no-view").out
    assert said.count("ORG") >= 3
    assert "NO" not in said.split()
    assert (here / "demo.rrd").stat().st_size > 100_000
    rerun = os.path.join(os.path.dirname(sys.executable), "rerun")
    assert subprocess.run([rerun, "rrd", "verify", "demo.rrd"], capture_output=True, check=False).returncode == 0


def test_a_move_lists_its_bytes_and_draws_itself(here, capsys):
    said = out(capsys, "move", "x", "1600", "--fh1", "8000", "--plot", "move.png").out
    assert "1600 of 1600" in said
    assert "start, ramp to FH1" in said
    assert (here / "move.png").read_bytes().startswith(b"\x89PNG")


def test_home_starts_where_it_is_told(here, capsys):
    said = out(capsys, "home", "y", "--from", "-60").out
    assert "stopped by ORG" in said
    assert "from -60.0000 mm" in said


def test_dual_rate_and_sync_do_as_asked(here, capsys):
    assert "12000 of 12000" in out(capsys, "dual-rate", "x", "12000").out
    said = out(capsys, "sync", "x=4000", "y=-1500", "--record", "s.rrd", "--vcd", "s.vcd").out
    assert "pulses from the line" in said
    assert (here / "s.rrd").exists()
    assert (here / "s.vcd").read_text().startswith("$")


def test_a_move_that_loses_steps_ends_with_code_1_and_says_so(here, capsys):
    said = out(capsys, "move", "x", "16000", "--fh1", "150000", "--fh2", "150000", "--accel", "0.02", code=1).out
    assert "NOT as asked" in said


def test_registers_prints_the_map_with_evidence(capsys):
    said = out(capsys, "registers", "pcl240k").out
    for word in ("R0", "R7", "2..1023", "inferred", "no_int"):
        assert word in said


def test_pullout_prints_a_table_and_draws(here, capsys):
    said = out(capsys, "pullout", "--plot", "p.png").out
    assert "N m" in said
    assert (here / "p.png").exists()


def test_view_without_a_screen_says_what_to_do(here, capsys):
    assert "no screen" in out(capsys, "view", code=2).err
    assert "el_plus" in out(capsys, "view", "--text").out


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["home", "q"], "unknown axis 'q'"),
        (["move", "x", "0"], "R0 counts 1 to 16777215"),
        (["move", "x", "100", "--model", "xyzz"], "Did you mean"),
        (["move", "x", "100", "--model", "nowhere.xml"], "no MJCF file"),
        (["move", "x", "100", "--chips", "PCL241"], "Did you mean"),
        (["move", "x", "100", "--chips", "hctl1100"], "HCTL1100 closes a loop and makes no pulses"),
        (["demo", "--no-view", "--chips", "HCTL-1100"], "HCTL1100 closes a loop"),
        (["move", "x", "100", "--motor", "17HS4410"], "Did you mean '17HS4401'"),
        (["move", "x", "100", "--fh1", "1e9"], "at most|makes up to"),
        (["sync", "x:3"], "unknown axis|AXIS=PULSES"),
        (["sync", "x=abc"], "AXIS=PULSES"),
        (["registers", "pcl"], "Known: .*PCL240K"),
        (["move", "x", "100", "--record", "no/such/folder.rrd"], "no folder"),
    ],
)
def test_errors_say_what_was_given_and_what_is_allowed(here, capsys, argv, message):
    import re

    assert re.search(message, out(capsys, *argv, code=2).err)


def test_nothing_is_overwritten_unasked(here, capsys):
    (here / "mine.rrd").write_text("precious")
    assert "exists" in out(capsys, "move", "x", "100", "--record", "mine.rrd", code=2).err
    assert (here / "mine.rrd").read_text() == "precious"
    out(capsys, "move", "x", "100", "--record", "mine.rrd", "--force")
    assert (here / "mine.rrd").read_bytes()[:3] == b"RRF"


def test_the_demo_writes_its_own_file_again_and_no_other(here, capsys):
    out(capsys, "demo", "--no-view")
    out(capsys, "demo", "--no-view")
    (here / "mine.rrd").write_text("precious")
    assert "exists" in out(capsys, "demo", "--no-view", "--record", "mine.rrd", code=2).err
    assert (here / "mine.rrd").read_text() == "precious"


def test_without_a_command_the_help_is_shown(capsys):
    assert "usage: stage" in out(capsys, code=2).out
