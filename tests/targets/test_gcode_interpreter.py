"""The G-code firmware of scripts/firmware/gcode, built for this computer: each line does what its README says.

References: a move to a position in mm makes round(position * 320) steps from power-up on, and ends there.
"""

import functools
import math
import random
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from stage.board import NoCompilerError
from stage.board.firmware_library import find_compiler
from stage.targets.elf import AVR, Elf

FIRMWARE = Path(__file__).parents[2] / "scripts" / "firmware" / "gcode"
STEPS_PER_MM = 320
TICKS_PER_SECOND = 2e6
ACCELERATION = 500.0  # mm/s2, of X and Y at power-up
MAX_SPEED = 75.0  # mm/s, of X and Y at power-up
SWITCHES = "@limits X -50 50\n@limits Y -50 50\n@limits Z -30 30\n"
_FOLDER = TemporaryDirectory(prefix="pulsestage-test-")


@functools.cache
def build_interpreter() -> Path:
    """Return the program, or skip the test where there is no compiler."""
    try:
        compiler = find_compiler("x.c")
    except NoCompilerError as error:
        pytest.skip(str(error))
    program = Path(_FOLDER.name) / "gcode"
    sources = [path for path in FIRMWARE.glob("*.c") if path.name != "hal_atmega328p.c"]
    command = [
        compiler,
        "-std=gnu11",
        "-O1",
        "-Wall",
        "-Wextra",
        "-Werror",
        *map(str, sources),
        "-lm",
        "-o",
        str(program),
    ]
    subprocess.run(command, check=True)
    return program


def run(script: str, edges: Path | None = None) -> list[str]:
    """Return the lines that the firmware sends to a script of hal_native.c, without its greeting, and the steps made."""
    command = [str(build_interpreter()), *([str(edges)] if edges else [])]
    done = subprocess.run(command, input=script, capture_output=True, text=True, check=True, timeout=60)
    return [line for line in done.stdout.splitlines() if line and not line.startswith("PulseStage")]


def run_to_steps(script: str) -> list[int]:
    """Return the steps that each axis made; every line of the script is answered by ok."""
    *answers, steps = run(script)
    assert set(answers) == {"ok"}, answers
    return [int(number) for number in steps.split()[1:]]


def convert_to_steps(*position: float) -> list[int]:
    return [round(mm * STEPS_PER_MM) for mm in position]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_hundred_random_moves_end_at_the_step_of_their_position(seed):
    print("seed", seed)
    rng = random.Random(seed)
    lines, at = ["F3000"], [0.0, 0.0, 0.0]
    for _ in range(200):
        target = [round(rng.uniform(-20, 20), 3) for _ in range(3)]
        match rng.randrange(3):
            case 0:
                lines.append("G0 X{} Y{} Z{}".format(*target))
            case 1:
                lines.append("G1 X{} Y{} F{}".format(*target[:2], rng.randrange(100, 5000)))
                target[2] = at[2]
            case _:  # a half circle to the target, or a full one
                half = [round((end - start) / 2, 3) for start, end in zip(at[:2], target[:2], strict=True)]
                target = [round(start + 2 * offset, 3) for start, offset in zip(at[:2], half, strict=True)] + [at[2]]
                lines.append("G{} X{} Y{} I{} J{}".format(rng.choice([2, 3]), *target[:2], *half))
        at = target
    assert run_to_steps("\n".join(lines) + "\n") == convert_to_steps(*at)


def test_relative_moves_inches_and_comments_are_understood():
    script = "G21 G91 (relative) G0 X1.5 ; to 1.5\ng0 x-0.25 y2\nG20 G1 Z0.1 F20\nG90 X0.1\nN7 G21 M30\n"
    assert run_to_steps(script) == convert_to_steps(2.54, 2, 2.54)


def test_a_full_circle_returns_to_its_start_and_stays_within_the_arc_tolerance(tmp_path):
    edges = tmp_path / "edges.txt"
    run("G2 X0 I10 F1800\n", edges)
    steps = np.loadtxt(edges, dtype=np.int64)[:, 1:3]
    points = np.cumsum(steps, axis=0) / STEPS_PER_MM
    distances = np.hypot(points[:, 0] - 10, points[:, 1])
    assert tuple(points[-1]) == (0, 0)
    assert points[:, 0].max() == pytest.approx(20, abs=0.005)
    assert abs(distances - 10).max() < 0.002 + math.sqrt(2) / STEPS_PER_MM


def read_speeds(edges: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of the steps of X, s, and the speed in the interval before each, mm/s."""
    table = np.loadtxt(edges, dtype=np.int64)
    times = table[table[:, 1] != 0, 0] / TICKS_PER_SECOND
    return times[1:], 1 / np.diff(times) / STEPS_PER_MM


@pytest.mark.parametrize(("distance", "feed"), [(40, 3000), (40, 1500), (3, 4500)])
def test_a_move_is_a_trapezoid_with_the_acceleration_of_the_setting(tmp_path, distance, feed):
    edges = tmp_path / "edges.txt"
    run(f"G1 X{distance} F{feed}\n", edges)
    times, speeds = read_speeds(edges)
    top = min(feed / 60, math.sqrt(distance * ACCELERATION))
    assert speeds.max() == pytest.approx(top, rel=0.03)
    ramp = top / ACCELERATION
    assert times[-1] - times[0] == pytest.approx(distance / top + ramp, abs=0.012)
    slopes = [np.polyfit(times[part], speeds[part], 1)[0] for part in (
        (speeds > 0.2 * top) & (speeds < 0.9 * top) & (times < times.mean()),
        (speeds > 0.2 * top) & (speeds < 0.9 * top) & (times > times.mean()),
    )]  # fmt: skip
    assert slopes == [pytest.approx(ACCELERATION, rel=0.08), pytest.approx(-ACCELERATION, rel=0.08)]


def test_moves_in_line_are_passed_at_full_speed_and_a_reversal_at_rest(tmp_path):
    edges = tmp_path / "edges.txt"
    run("F1800\n" + "".join(f"G1 X{mm}\n" for mm in range(2, 41, 2)) + "X0\n", edges)
    times, speeds = read_speeds(edges)
    middle = (np.arange(len(times)) < 40 * STEPS_PER_MM - 400) & (np.arange(len(times)) > 400)
    assert speeds[middle].min() > 29
    assert speeds[40 * STEPS_PER_MM - 2 : 40 * STEPS_PER_MM + 1].max() < 2.3


def test_a_feed_hold_ramps_down_and_a_resume_loses_no_step(tmp_path):
    edges = tmp_path / "edges.txt"
    script = "G1 X30 F3000\nG1 Y1\n@run 0.3\n@send !\n@run 0.5\n@send ?\n@run 0.5\n@send ~\n"
    *answers, steps = run(script, edges)
    assert [answer[:5] for answer in answers] == ["ok", "ok", "<Hold"]
    assert answers[2].endswith("|Rate:0>")
    assert steps == "steps 9600 320 0"
    times, speeds = read_speeds(edges)
    gap = int(np.argmin(speeds))
    assert 1.0 - 50 / ACCELERATION < times[gap] - times[gap - 1] < 1.01, (
        "at rest from the end of the ramp to the resume"
    )
    slowing = (times < times[gap]) & (times > times[gap - 1] - 0.08)
    assert np.polyfit(times[slowing][:-1], speeds[slowing][:-1], 1)[0] == pytest.approx(-ACCELERATION, rel=0.08)


def test_homing_puts_zero_at_the_switches_and_pulls_off():
    *answers, steps = run(SWITCHES + "$H\n@send ?\n")
    assert answers == ["ok", "<Idle|MPos:1.000,1.000,-1.000|Rate:0>"]
    assert steps == f"steps {-49 * STEPS_PER_MM} {-49 * STEPS_PER_MM} {29 * STEPS_PER_MM}"


def test_homing_with_a_switch_that_stays_off_ends_in_alarm_9():
    *answers, _ = run(SWITCHES + "@stuck Y 0\n$H\n@send ?\n@run 0.1\nG0 X1\n$X\nG0 X1\n")
    assert [answer[:7] for answer in answers] == ["ALARM:9", "<Alarm|", "error:9", "ok", "ok"]


def test_a_switch_that_comes_on_at_rest_is_an_alarm_and_homing_with_it_ends_in_alarm_8():
    *answers, steps = run("@stuck Z 1\n$H\n@send ?\n")
    assert [answer[:7] for answer in answers] == ["ALARM:1", "ALARM:8", "<Alarm|"]
    assert abs(int(steps.split()[3])) < 1.2 * STEPS_PER_MM, "it has gone no further than the way off the switch"


def test_a_limit_switch_stops_a_move_at_once_and_locks_the_machine():
    *answers, steps = run("@limits X -50 10\nG1 X20 F1200\nG1 Y5\n@rest\nG0 X0\n$X\n@send ?\n@run 0.1\nG91 G0 X-1\n")
    assert answers == ["ok", "ok", "ALARM:1", "error:9", "ok", "<Idle|MPos:10.000,0.000,0.000|Rate:0|Pn:X>", "ok"]
    assert steps == f"steps {9 * STEPS_PER_MM} 0 0"


def test_a_reset_in_motion_stops_at_once_and_the_position_is_lost():
    *answers, _ = run("G1 X20 F1200\n@run 0.3\n@send \x18\n@rest\nG0 X0\n$H\n")
    assert answers[:3] == ["ok", "ALARM:3", "error:9"]


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("", "ok"),
        ("(only a comment)", "ok"),
        ("-5", "error:1"),
        ("G1X", "error:2"),
        ("$Q", "error:3"),
        ("$7=1", "error:4"),
        ("$120=-3", "error:4"),
        ("F0", "error:4"),
        ("G4", "error:4"),
        ("G0" + "X1" * 50, "error:11"),
        ("G5", "error:20"),
        ("G1.5", "error:20"),
        ("M3", "error:20"),
        ("A5", "error:20"),
        ("G0G1X1", "error:21"),
        ("G1X1", "error:22"),
        ("G0X1X2", "error:25"),
        ("G2F100", "error:26"),
        ("G2X10F100", "error:26"),
        ("G2X10I2F100", "error:33"),
    ],
)
def test_a_bad_line_is_answered_by_its_number_and_moves_nothing(line, answer):
    assert run(f"{line}\n") == [answer, "steps 0 0 0"]


def test_commands_that_need_rest_are_refused_during_a_move():
    assert run("G1 X5 F600\n$$\n$X\n$H\n$120=9\n")[:5] == ["ok", *["error:8"] * 4]


def test_a_setting_changes_what_follows():
    assert run("$100=80\nG0 X10\n@rest\n$$\n")[-2:] == ["ok", "steps 800 0 0"]
    assert "$120=500.000" in run("$$\n")


def test_a_dwell_waits_for_the_move_before_it(tmp_path):
    edges = tmp_path / "edges.txt"
    run("G1 X5 F600\nG4 P0.5\nX6\n", edges)
    times, _ = read_speeds(edges)
    assert np.diff(times).max() == pytest.approx(0.5, abs=0.01)


@pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc")
def test_the_committed_elf_is_what_its_sources_build(tmp_path):
    committed = FIRMWARE / "gcode.elf"
    version = subprocess.run(["avr-gcc", "-dumpversion"], capture_output=True, text=True, check=True).stdout.strip()
    if f"GNU) {version}".encode() not in committed.read_bytes():
        pytest.skip(f"gcode.elf was built by another avr-gcc than {version}, whose code differs")
    shutil.copytree(FIRMWARE, tmp_path / "gcode", ignore=shutil.ignore_patterns("*.elf"))
    subprocess.run(["make", "-s", "-C", str(tmp_path / "gcode")], check=True)
    segments = [Elf(folder / "gcode.elf", AVR, "atmega328p", "").segments for folder in (FIRMWARE, tmp_path / "gcode")]
    assert segments[0] == segments[1]
