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
from stage.cli import COMMANDS, GROUPS, build_parser, demo, main
from stage.cli.package_commands import PACKAGE_BY_COMMAND


def run_command(capsys, *argv, code=0):
    assert main(list(argv)) == code
    return capsys.readouterr()


def measure_seconds(*command):
    """Return the processor time of a command, which other load does not change, or else its wall time."""
    before, begin = os.times(), time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    after, took = os.times(), time.perf_counter() - begin
    spent = sum(after[2:4]) - sum(before[2:4])  # children's, user and system
    return min(spent, took) if spent else took


def test_help_comes_at_once_and_importing_is_cheap():
    python = sys.executable
    assert min(measure_seconds(python, "-m", "stage", "--help") for _ in range(3)) < 0.5
    assert min(measure_seconds(python, "-c", "import stage") for _ in range(3)) < 1.0


def test_a_second_start_takes_less_than_two_seconds(work_folder):
    command = (sys.executable, "-c", "from stage import Stage; Stage('xyz').run(0.1)")
    measure_seconds(*command)
    assert min(measure_seconds(*command) for _ in range(3)) < 2.0


@needs_rerun
def test_the_demo_homes_moves_and_writes_a_recording(work_folder, capsys):
    """stage demo"""
    output = run_command(capsys, "demo").out
    assert re.search(r"\d s of simulated time in [\d.]+ s of wall time", output)
    assert output.count("ORG") >= 3
    assert "NO" not in output.split()
    assert (work_folder / "demo.rrd").stat().st_size > 100_000
    assert rerun_cli("rrd", "verify", "demo.rrd").returncode == 0


def test_a_move_lists_its_bytes_and_draws_itself(work_folder, capsys):
    output = run_command(capsys, "move", "x", "1600", "--fh1", "8000", "--plot", "move.png").out
    assert "1600 of 1600" in output
    assert "start, ramp to FH1" in output
    assert (work_folder / "move.png").read_bytes().startswith(b"\x89PNG")


def test_a_distance_towards_minus_is_typed_as_it_is(work_folder, capsys):
    """stage move y -0.5mm"""
    assert "-160 of -160" in run_command(capsys, "move", "y", "-0.5mm").out
    assert "'-2furlongs'" in run_command(capsys, "move", "y", "-2furlongs", code=2).err


def test_home_starts_at_the_position_of_its_option(work_folder, capsys):
    output = run_command(capsys, "home", "y", "--from", "-60").out
    assert "stopped by ORG" in output
    assert "from -60.0000 mm" in output


def test_an_origin_return_that_loses_steps_ends_with_code_1(work_folder, capsys):
    fast = ["--fh1", "60000", "--fh2", "60000", "--accel", "0.15", "--fast-only"]
    output = run_command(capsys, "home", "x", "--from", "-60", *fast, code=1).out
    assert "stopped by ORG" in output
    assert int(re.search(r"(\d+) full steps", output)[1]) != 0


@needs_rerun
def test_dual_rate_and_sync_make_the_requested_pulses(work_folder, capsys):
    assert "12000 of 12000" in run_command(capsys, "dual-rate", "x", "12000").out
    output = run_command(capsys, "sync", "x=4000", "y=-1500", "--record", "s.rrd", "--vcd", "s.vcd").out
    assert "pulses from the line" in output
    assert (work_folder / "s.rrd").exists()
    assert (work_folder / "s.vcd").read_text().startswith("$")


def test_a_move_that_loses_steps_ends_with_code_1_and_says_so(work_folder, capsys):
    output = run_command(
        capsys, "move", "x", "16000", "--fh1", "150000", "--fh2", "150000", "--accel", "0.02", code=1
    ).out
    assert "NOT as asked" in output


def test_registers_prints_the_map_with_evidence(capsys):
    output = run_command(capsys, "registers", "pcl240k").out
    for word in ("R0", "R7", "2..1023", "inferred", "no_int"):
        assert word in output


def test_pullout_prints_a_table_and_draws(work_folder, capsys):
    """stage pullout --motor 17HS4401 --bus-voltage 24 --plot pullout.png"""
    output = run_command(capsys, "pullout", "--motor", "17HS4401", "--bus-voltage", "24", "--plot", "pullout.png").out
    assert "N m" in output
    assert (work_folder / "pullout.png").exists()


def test_view_without_a_screen_says_what_to_do(work_folder, capsys):
    out, err = run_command(capsys, "view", code=2)
    assert "no screen" in err
    assert out == "", "an error comes before other output"
    assert "el_plus" in run_command(capsys, "view", "--text").out


@needs_rerun
def test_nothing_is_overwritten_unasked(work_folder, capsys):
    (work_folder / "mine.rrd").write_text("precious")
    output = run_command(capsys, "move", "x", "100", "--record", "mine.rrd", code=2).err
    assert output == "stage: mine.rrd exists. Choose another name, or give --force.\n"
    assert (work_folder / "mine.rrd").read_text() == "precious"
    run_command(capsys, "move", "x", "100", "--record", "mine.rrd", "--force")
    assert (work_folder / "mine.rrd").read_bytes()[:3] == b"RRF"


def test_the_demo_overwrites_no_file_and_takes_the_next_name(work_folder, capsys):
    """stage demo --no-view"""
    (work_folder / "demo.rrd").write_text("precious")
    assert "demo-2.rrd: " in run_command(capsys, "demo", "--no-view", "--model", "xy").out
    assert (work_folder / "demo.rrd").read_text() == "precious"
    (work_folder / "mine.rrd").write_text("precious")
    assert "exists" in run_command(capsys, "demo", "--no-view", "--record", "mine.rrd", code=2).err
    assert (work_folder / "mine.rrd").read_text() == "precious"
    assert "demo.rrd: " in run_command(capsys, "demo", "--no-view", "--force", "--model", "xy").out
    assert (work_folder / "demo.rrd").read_bytes()[:3] == b"RRF"


@needs_rerun
def test_a_picture_overwrites_no_recording(work_folder, capsys, monkeypatch):
    """stage move x 100 --picture q.png"""
    from stage.recording import rerun_viewer

    drawn = []
    monkeypatch.setattr(
        rerun_viewer, "take_screenshot", lambda rrd, png, overwrite: drawn.append((rrd, png, overwrite))
    )
    (work_folder / "stage.rrd").write_text("precious")
    run_command(capsys, "move", "x", "100", "--picture", "q.png")
    assert drawn == [("stage-2.rrd", "q.png", False)]
    assert (work_folder / "stage.rrd").read_text() == "precious"
    assert (work_folder / "stage-2.rrd").read_bytes()[:3] == b"RRF"


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


def test_positions_of_a_hinge_are_printed_in_degrees(work_folder, capsys):
    """stage move x 1544 --model hinge.xml"""
    (work_folder / "hinge.xml").write_text(HINGE)
    output = run_command(capsys, "move", "x", "1544", "--model", "hinge.xml", "--from", "0.1rad").out
    assert re.search(r"from 5\.7296 deg to 179\.\d{4} deg, \d+ full steps", output)
    assert "from 5.0000 deg to" in run_command(capsys, "move", "x", "10", "--model", "hinge.xml", "--from", "5").out
    output = run_command(capsys, "move", "x", "1544", "--model", "hinge.xml", "--from", "500", code=2).err
    assert "--from 500: axis x travels from -229.183 to 229.183 deg" in output
    output = run_command(capsys, "move", "x", "1544", "--model", "hinge.xml", "--from", "5mm", code=2).err
    assert "--from 5mm: give a position on axis x in deg, or with a unit: urad, mrad, rad, mdeg, deg." in output


def test_a_fault_on_a_hinge_is_reported_in_degrees(work_folder, capsys):
    """stage fault lost-write --model hinge.xml"""
    (work_folder / "hinge.xml").write_text(HINGE)
    output = run_command(capsys, "fault", "lost-write", "--model", "hinge.xml", "--plot", "f.png").out
    assert re.search(r"^carriage moved, deg +206\.\d{4} +4\.\d{4}$", output, re.M)
    assert re.search(r"^diagnostics +(\d+) +\1$", output, re.M), (
        "a PCL-240 does not complain of a distance that it has from before"
    )
    assert ", mm" not in output


@pytest.mark.parametrize("unit", ["m", "rad"])
def test_the_table_of_the_erratum_has_the_unit_of_its_axis(unit):
    """stage erratum --model hinge.xml"""
    from stage.cli.erratum import ErratumResult

    figures = {"position, mm": 1.5, "speed, pps": 0, "n-DRV 2 s later": 0}
    rows = ErratumResult("MCX304", True, (figures, figures), (None, None), unit).format_table().splitlines()[1:]
    symbol, value = {"m": ("mm", "1.5000"), "rad": ("deg", "0.0859")}[unit]
    assert [row.split("  ")[0] for row in rows] == [f"position, {symbol}", "speed, pps", "n-DRV 2 s later"]
    assert rows[0].split()[2:] == [value, value]


@pytest.mark.parametrize("command", [("move", "x", "100"), ("fault", "jam"), ("erratum",)])
@pytest.mark.parametrize("other", ["a.rrd", "./a.rrd", "link.rrd"])
def test_one_file_for_two_outputs_is_refused_before_the_work(work_folder, capsys, monkeypatch, command, other):
    """stage move x 100 --record a.rrd --vcd a.rrd"""
    (work_folder / "link.rrd").symlink_to("a.rrd")
    monkeypatch.setattr("stage.sim.stage.Stage.record", None)
    output = run_command(capsys, *command, "--record", "a.rrd", "--vcd", other, "--force", code=2).err
    assert output == f"stage: --record and --vcd both write {other}. Give each a file of its own.\n"
    assert not (work_folder / "a.rrd").exists()


@pytest.fixture
def shell(work_folder):
    """Return a function that runs a line of bash with this package's `stage` and returns exit code and stderr."""

    def run(line):
        line = line.replace("stage ", f"{sys.executable} -m stage ")
        completed = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False, timeout=120)
        return completed.returncode, completed.stderr

    return run


def test_a_closed_pipe_does_not_lose_the_recording(work_folder, shell):
    """PYTHONUNBUFFERED=1 stage demo --no-view --record x.rrd | true"""
    assert shell("set -o pipefail; PYTHONUNBUFFERED=1 stage move x 40 --record x.rrd | true") == (0, "")
    assert (work_folder / "x.rrd").read_bytes()[:3] == b"RRF"


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
    output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    if output:  # or OSMesa is here
        assert "LoadError" in output
        assert "glGetError" in output
        assert "MUJOCO_GL=osmesa" in output


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_full_standard_output_is_reported_and_files_are_written(work_folder, shell):
    """stage move x 100 --vcd x.vcd > /dev/full; stage --help > /dev/full"""
    full = (2, "stage: nothing can be printed: No space left on device.\n")
    assert shell("stage move x 100 --vcd x.vcd > /dev/full") == full
    assert (work_folder / "x.vcd").read_text().startswith("$")
    assert shell("stage --help > /dev/full") == full


def test_without_a_command_ten_lines_say_what_to_type(capsys):
    lines = run_command(capsys, code=2).out.splitlines()
    assert len(lines) == 10
    assert sum(line.startswith("  stage ") for line in lines) == 6
    for line in lines:
        if line.startswith("  stage "):
            assert line.split()[1] in GROUPED


GROUPED = [name for names in GROUPS.values() for name in names]


def test_the_help_lists_each_command_once_by_the_goal_of_a_user(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    listed = re.findall(r"^  ([a-z-]+)  +\w", text, re.M)
    (action,) = (a for a in build_parser()._actions if a.metavar == "COMMAND")
    commands = [name for name in listed if name != "stage"]
    assert set(action.choices) <= set(commands)
    assert len(set(commands)) == len(commands)
    assert re.findall(r"^(\w[\w ]*):$", text, re.M)[1:-1] == list(GROUPS)
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.parametrize("name", COMMANDS)
def test_the_parser_of_one_command_has_the_help_of_all(name):
    """The parser of `stage home` imports and builds nothing of the other modules."""
    full, alone = (
        next(a for a in build_parser(words)._actions if a.metavar == "COMMAND").choices for words in ((), (name,))
    )
    assert name in alone
    assert set(alone) == {other for other, module in COMMANDS.items() if module == COMMANDS[name]}
    assert alone[name].format_help() == full[name].format_help()


def test_every_command_of_the_parser_has_its_module():
    choices = next(a for a in build_parser()._actions if a.metavar == "COMMAND").choices
    assert set(choices) - set(COMMANDS) <= set(PACKAGE_BY_COMMAND)


@needs_rerun
def test_the_demo_without_a_screen_leaves_a_recording_and_a_picture(work_folder, capsys):
    """stage demo | cat, in a folder that has those of the first demo"""
    for name in ("demo.rrd", "demo.png"):
        (work_folder / name).write_text("the first")
    output = run_command(capsys, "demo", "--model", "xy").out
    assert re.search(r"^demo-2\.rrd: .*\ndemo-2\.png: ", output, re.M)
    assert (work_folder / "demo-2.png").read_bytes()[1:4] == b"PNG"
    assert (work_folder / "demo.png").read_text() == (work_folder / "demo.rrd").read_text() == "the first"


def test_a_command_in_a_pipe_ends_even_if_its_screen_does_not_answer(work_folder, monkeypatch):
    """DISPLAY=:99 stage demo | cat, through ssh -X without an X server"""
    environment = os.environ | {"DISPLAY": ":99"}
    command = [sys.executable, "-m", "stage", "demo", "--model", "xy"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0
    assert re.search(r"^demo\.png: ", done.stdout, re.M)


def test_no_window_has_one_name_in_all_commands_and_the_former_ones_work():
    parser = build_parser()
    for words in (["demo"], ["panel"], ["run", "a.c"], ["serve"]):
        former = "--no-view" if words == ["demo"] else "--no-browser"
        assert parser.parse_args([*words, "--no-window"]).no_window
        assert parser.parse_args([*words, former]).no_window
        assert not parser.parse_args(words).no_window
    (action,) = (a for a in parser._actions if a.metavar == "COMMAND")
    assert all(
        "--no-view" not in p.format_help() and "--no-browser" not in p.format_help() for p in action.choices.values()
    )


@pytest.mark.parametrize(
    "chip", ["pcl240k", "pcl240mk", "pcl240ms", "mcx514", "mcx304", "mcx302", "mcx312", "hctl1100"]
)
def test_the_command_line_does_the_same_with_every_chip(work_folder, capsys, chip):
    """stage move x 10mm --chips hctl1100; stage home; stage sync"""
    options = ["--chips", chip, "--model", "xy"]
    text = run_command(capsys, "move", "x", "2mm", *options).out
    assert "x: done, stopped by" in text
    assert float(re.search(r"to (\S+) mm", text)[1]) == pytest.approx(2, abs=0.02)
    assert "x: done, stopped by ORG" in run_command(capsys, "home", "x", "--from", "-117", *options).out
    text = run_command(capsys, "sync", "x=2mm", "y=-1mm", *options).out
    assert "synchronized move: done" in text
    assert re.search(r"on y: done", text)


@pytest.mark.parametrize("chip", ["mcx304", "hctl1100"])
def test_faults_are_demonstrated_with_other_chips(work_folder, capsys, chip):
    """stage fault bounce --chips mcx304 --plot f.png"""
    text = run_command(capsys, "fault", "bounce", "--chips", chip, "--model", "xy", "--plot", "f.png").out
    assert "happened as claimed" in text
    assert (work_folder / "f.png").stat().st_size > 10_000


@pytest.mark.parametrize("chip", ["mcx304", pytest.param("hctl1100", marks=pytest.mark.slow)])
def test_the_demo_runs_with_other_chips(work_folder, capsys, chip):
    """stage demo --chips mcx514"""
    text = run_command(capsys, "demo", "--no-view", "--model", "xy", "--chips", chip).out
    rows = [line for line in text.splitlines() if line[:1] in "xy" and line[1:2] == " "]
    assert len(rows) == 6
    assert all(row.endswith("yes") for row in rows)
    assert sum("origin return" in row for row in rows) == 2
    assert sum("line" in row for row in rows) == 2
    assert (work_folder / "demo.rrd").stat().st_size > 100_000


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
                    end = one.position + demo.convert_share_to_pulses(one, share) * one.meters_per_pulse * np.sign(
                        one.gear
                    )
                    assert low < end < high
