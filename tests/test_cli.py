"""The command `stage`, as a stranger would run it."""

import os
import re
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from support.extras import needs_rerun
from support.recording_bench import rerun_cli

from stage import Stage
from stage.cli import demo, main


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


@needs_rerun
def test_the_demo_homes_moves_and_writes_a_recording(here, capsys):
    """stage demo"""
    said = out(capsys, "demo").out
    assert re.search(r"\d s of simulated time in [\d.]+ s of wall time", said)
    assert said.count("ORG") >= 3
    assert "NO" not in said.split()
    assert (here / "demo.rrd").stat().st_size > 100_000
    assert rerun_cli("rrd", "verify", "demo.rrd").returncode == 0


def test_a_move_lists_its_bytes_and_draws_itself(here, capsys):
    said = out(capsys, "move", "x", "1600", "--fh1", "8000", "--plot", "move.png").out
    assert "1600 of 1600" in said
    assert "start, ramp to FH1" in said
    assert (here / "move.png").read_bytes().startswith(b"\x89PNG")


def test_a_distance_towards_minus_is_typed_as_it_is(here, capsys):
    """stage move y -0.5mm"""
    assert "-160 of -160" in out(capsys, "move", "y", "-0.5mm").out
    assert "'-2furlongs'" in out(capsys, "move", "y", "-2furlongs", code=2).err


def test_home_starts_where_it_is_told(here, capsys):
    said = out(capsys, "home", "y", "--from", "-60").out
    assert "stopped by ORG" in said
    assert "from -60.0000 mm" in said


def test_a_home_that_loses_steps_on_its_way_ends_with_code_1(here, capsys):
    fast = ["--fh1", "60000", "--fh2", "60000", "--accel", "0.15", "--fast-only"]
    said = out(capsys, "home", "x", "--from", "-60", *fast, code=1).out
    assert "stopped by ORG" in said
    assert int(re.search(r"lost steps (-?\d+)", said)[1]) != 0


@needs_rerun
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
    """stage pullout --motor 17HS4401 --bus-voltage 24 --plot pullout.png"""
    said = out(capsys, "pullout", "--motor", "17HS4401", "--bus-voltage", "24", "--plot", "pullout.png").out
    assert "N m" in said
    assert (here / "pullout.png").exists()


def test_view_without_a_screen_says_what_to_do(here, capsys):
    assert "no screen" in out(capsys, "view", code=2).err
    assert "el_plus" in out(capsys, "view", "--text").out


@needs_rerun
def test_nothing_is_overwritten_unasked(here, capsys):
    (here / "mine.rrd").write_text("precious")
    said = out(capsys, "move", "x", "100", "--record", "mine.rrd", code=2).err
    assert said == "stage: mine.rrd exists. Choose another name, or give --force.\n"
    assert (here / "mine.rrd").read_text() == "precious"
    out(capsys, "move", "x", "100", "--record", "mine.rrd", "--force")
    assert (here / "mine.rrd").read_bytes()[:3] == b"RRF"


def test_the_demo_overwrites_no_file_and_takes_the_next_name(here, capsys):
    """stage demo --no-view"""
    (here / "demo.rrd").write_text("precious")
    assert "demo-2.rrd: " in out(capsys, "demo", "--no-view", "--model", "xy").out
    assert (here / "demo.rrd").read_text() == "precious"
    (here / "mine.rrd").write_text("precious")
    assert "exists" in out(capsys, "demo", "--no-view", "--record", "mine.rrd", code=2).err
    assert (here / "mine.rrd").read_text() == "precious"
    assert "demo.rrd: " in out(capsys, "demo", "--no-view", "--force", "--model", "xy").out
    assert (here / "demo.rrd").read_bytes()[:3] == b"RRF"


@needs_rerun
def test_a_picture_overwrites_no_recording(here, capsys, monkeypatch):
    """stage move x 100 --picture q.png"""
    from stage.recording import viewer

    drawn = []
    monkeypatch.setattr(viewer, "take_screenshot", lambda rrd, png, overwrite: drawn.append((rrd, png, overwrite)))
    (here / "stage.rrd").write_text("precious")
    out(capsys, "move", "x", "100", "--picture", "q.png")
    assert drawn == [("stage-2.rrd", "q.png", False)]
    assert (here / "stage.rrd").read_text() == "precious"
    assert (here / "stage-2.rrd").read_bytes()[:3] == b"RRF"


HINGE = """
<mujoco>
  <compiler angle="radian"/>
  <custom><text name="x_unfitted" data="el_plus el_minus sd_plus sd_minus org"/></custom>
  <option timestep="0.0001"/>
  <worldbody><body><joint name="x" type="hinge" axis="0 0 1" range="-4 4" armature="1e-5"/>
    <geom type="cylinder" size="0.02 0.005" mass="0.05"/></body></worldbody>
  <actuator><motor name="x" joint="x" gear="1"/></actuator>
</mujoco>
"""


def test_a_hinge_is_told_in_its_own_unit(here, capsys):
    """stage move x 1544 --model hinge.xml"""
    (here / "hinge.xml").write_text(HINGE)
    said = out(capsys, "move", "x", "1544", "--model", "hinge.xml", "--from", "0.1rad").out
    assert re.search(r"from 5\.7296 deg to 179\.\d{4} deg, lost", said)
    assert "from 5.0000 deg to" in out(capsys, "move", "x", "10", "--model", "hinge.xml", "--from", "5").out
    said = out(capsys, "move", "x", "1544", "--model", "hinge.xml", "--from", "500", code=2).err
    assert "--from 500: axis x travels from -229.183 to 229.183 deg" in said
    said = out(capsys, "move", "x", "1544", "--model", "hinge.xml", "--from", "5mm", code=2).err
    assert "--from 5mm: give a position on axis x in deg, or with a unit: urad, mrad, rad, mdeg, deg." in said


def test_a_fault_on_a_hinge_is_told_in_its_unit(here, capsys):
    """stage fault lost-write --model hinge.xml"""
    (here / "hinge.xml").write_text(HINGE)
    said = out(capsys, "fault", "lost-write", "--model", "hinge.xml", "--plot", "f.png").out
    assert re.search(r"^carriage moved, deg +206\.\d{4} +4\.\d{4}$", said, re.M)
    assert re.search(r"^diagnostics +(\d+) +\1$", said, re.M), (
        "a PCL-240 does not complain of a distance that it has from before"
    )
    assert ", mm" not in said


@pytest.mark.parametrize("unit", ["m", "rad"])
def test_the_table_of_the_erratum_has_the_unit_of_its_axis(unit):
    """stage erratum --model hinge.xml"""
    from stage.cli.erratum import ErratumResult

    figures = {"position, mm": 1.5, "speed, pps": 0, "n-DRV 2 s later": 0}
    rows = ErratumResult("MCX304", True, (figures, figures), (None, None), unit).table().splitlines()[1:]
    symbol, value = {"m": ("mm", "1.5000"), "rad": ("deg", "0.0859")}[unit]
    assert [row.split("  ")[0] for row in rows] == [f"position, {symbol}", "speed, pps", "n-DRV 2 s later"]
    assert rows[0].split()[2:] == [value, value]


@pytest.mark.parametrize("command", [("move", "x", "100"), ("fault", "jam"), ("erratum",)])
@pytest.mark.parametrize("other", ["a.rrd", "./a.rrd", "link.rrd"])
def test_one_file_for_two_outputs_is_refused_before_the_work(here, capsys, monkeypatch, command, other):
    """stage move x 100 --record a.rrd --vcd a.rrd"""
    (here / "link.rrd").symlink_to("a.rrd")
    monkeypatch.setattr("stage.sim.stage.Stage.record", None)
    said = out(capsys, *command, "--record", "a.rrd", "--vcd", other, "--force", code=2).err
    assert said == f"stage: --record and --vcd both write {other}. Give each a file of its own.\n"
    assert not (here / "a.rrd").exists()


@pytest.fixture
def shell(here):
    """Run a line of bash in which `stage` is this package's; its exit code and what it says to stderr."""

    def run(line):
        line = line.replace("stage ", f"{sys.executable} -m stage ")
        ended = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False, timeout=120)
        return ended.returncode, ended.stderr

    return run


def test_a_reader_that_goes_away_takes_no_recording_with_it(here, shell):
    """PYTHONUNBUFFERED=1 stage demo --no-view --record x.rrd | true"""
    assert shell("set -o pipefail; PYTHONUNBUFFERED=1 stage move x 40 --record x.rrd | true") == (0, "")
    assert (here / "x.rrd").read_bytes()[:3] == b"RRF"


@pytest.mark.skipif(sys.platform != "linux", reason="OSMesa is Linux's")
@pytest.mark.parametrize("program", ["from stage import Stage", "from stage import faults"])
def test_a_library_that_is_missing_is_named(program):
    """MUJOCO_GL=osmesa python -c 'from stage import Stage'"""
    command = [
        sys.executable,
        "-c",
        f"try:\n    {program}\nexcept ImportError as error:\n    print(type(error), error)",
    ]
    environment = os.environ | {"MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "osmesa"}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    if said:  # or OSMesa is here
        assert "LoadError" in said
        assert "glGetError" in said
        assert "MUJOCO_GL=osmesa" in said


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_what_cannot_be_printed_is_said_and_the_files_are_written(here, shell):
    """stage move x 100 --vcd x.vcd > /dev/full; stage --help > /dev/full"""
    full = (2, "stage: nothing can be printed: No space left on device.\n")
    assert shell("stage move x 100 --vcd x.vcd > /dev/full") == full
    assert (here / "x.vcd").read_text().startswith("$")
    assert shell("stage --help > /dev/full") == full


def test_without_a_command_the_help_is_shown(capsys):
    assert "usage: stage" in out(capsys, code=2).out


@pytest.mark.parametrize(
    "chip", ["pcl240k", "pcl240mk", "pcl240ms", "mcx514", "mcx304", "mcx302", "mcx312", "hctl1100"]
)
def test_the_command_line_does_the_same_with_every_chip(here, capsys, chip):
    """stage move x 10mm --chips hctl1100; stage home; stage sync"""
    given = ["--chips", chip, "--model", "xy"]
    text = out(capsys, "move", "x", "2mm", *given).out
    assert "x: done, stopped by" in text
    assert float(re.search(r"to (\S+) mm", text)[1]) == pytest.approx(2, abs=0.02)
    assert "x: done, stopped by ORG" in out(capsys, "home", "x", "--from", "-117", *given).out
    text = out(capsys, "sync", "x=2mm", "y=-1mm", *given).out
    assert "synchronized move: done" in text
    assert re.search(r"on y: done", text)


@pytest.mark.parametrize("chip", ["mcx304", "hctl1100"])
def test_faults_are_shown_with_other_chips_too(here, capsys, chip):
    """stage fault bounce --chips mcx304 --plot f.png"""
    text = out(capsys, "fault", "bounce", "--chips", chip, "--model", "xy", "--plot", "f.png").out
    assert "happened as claimed" in text
    assert (here / "f.png").stat().st_size > 10_000


@pytest.mark.parametrize("chip", ["mcx304", pytest.param("hctl1100", marks=pytest.mark.slow)])
def test_the_demo_is_any_chips(here, capsys, chip):
    """stage demo --chips mcx514"""
    text = out(capsys, "demo", "--no-view", "--model", "xy", "--chips", chip).out
    rows = [line for line in text.splitlines() if line[:1] in "xy" and line[1:2] == " "]
    assert len(rows) == 6
    assert all(row.endswith("yes") for row in rows)
    assert sum("origin return" in row for row in rows) == 2
    assert sum("line" in row for row in rows) == 2
    assert (here / "demo.rrd").stat().st_size > 100_000


def test_a_demo_keeps_to_the_travel_of_each_axis():
    stage = Stage("xyz", visuals=False)
    for axis in stage.axes.values():
        low, high = axis.travel
        for at in (low, high):
            stage.place(**{axis.name: at})
            other = SimpleNamespace(
                travel=axis.travel, position=axis.position, meters_per_pulse=axis.meters_per_pulse, gear=-axis.gear
            )
            for share in (demo.LONG, demo.SHORT, demo.LINE_FIRST, demo.LINE_SECOND):
                for one in (axis, other):  # whichever way the screw turns
                    end = one.position + demo.find_pulses(one, share) * one.meters_per_pulse * np.sign(one.gear)
                    assert low < end < high
