"""grbl 1.1h, unmodified, on an emulated ATmega328P. PULSESTAGE_GRBL_ELF names the ELF that its Makefile builds.

References: grbl's own report of its position, of which 0.001 mm is less than a step; its manual for alarms, feed hold, jog and
reset. Z keeps its current, as a brake would hold it: grbl switches its motors off at power-up.
"""

import os
import random
import shlex
from pathlib import Path

import pytest
from support.gcode_machine import STEPS_PER_MM, GcodeMachine
from support.pages import is_printed, steps

from stage import faults
from stage.cli import main
from stage.targets import supported_processors

PAGE = Path(__file__).parents[2] / "docs" / "tutorials" / "grbl.md"
GRBL = os.environ.get("PULSESTAGE_GRBL_ELF", "")
pytestmark = [
    pytest.mark.skipif(not GRBL, reason="PULSESTAGE_GRBL_ELF names no ELF of grbl 1.1h"),
    pytest.mark.skipif(
        not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
    ),
]
PINS = "grbl,z.enable=none"
SETTINGS = (
    "$1=255", "$22=1", "$23=3", "$24=60", "$25=1500", "$26=10", "$27=2", "$100=320", "$101=320", "$102=320", "$110=4500",
    "$111=4500", "$112=3000", "$120=500", "$121=500", "$122=300", "$130=300", "$131=200", "$132=80",
)  # fmt: skip
RESET, JOG_CANCEL = b"\x18", b"\x85"


def make_grbl(*settings: str, **positions: float) -> GcodeMachine:
    """Return a machine whose grbl has the settings of the stage xyz, and others."""
    machine = GcodeMachine(Path(GRBL), "help]\r\n", pins=PINS, **positions)
    machine.host.run_for(0.1)  # it finds an empty EEPROM, says error:7 and fills it
    machine.host.serial.read()
    assert set(machine.send(*SETTINGS, *settings)) == {"ok"}
    return machine


def count_reported_steps(machine: GcodeMachine) -> list[int]:
    return [round(mm * STEPS_PER_MM) for mm in machine.read_positions()]


def list_random_moves(rng: random.Random, count: int) -> list[str]:
    """Return lines of G-code within 5 mm of the start: rapids and lines on three axes, arcs in the plane."""
    lines, at = ["G90", "G1 F3000"], [0.0, 0.0]
    for _ in range(count):
        target = [round(rng.uniform(-5, 5), 3) for _ in range(3)]
        kind = rng.randrange(3)
        if kind < 2:
            lines.append("G{} X{} Y{} Z{}".format(kind, *target) + (f" F{rng.randrange(200, 4500)}" if kind else ""))
        else:  # half a circle
            half = [round((end - start) / 2, 3) for start, end in zip(at, target[:2], strict=True)]
            target[:2] = [round(start + 2 * offset, 3) for start, offset in zip(at, half, strict=True)]
            lines.append("G{} X{} Y{} I{} J{}".format(rng.choice([2, 3]), *target[:2], *half))
        at = target[:2]
    return lines


@pytest.mark.slow
def test_the_command_of_the_page_prints_what_the_page_says(tmp_path, monkeypatch, capsys):
    page_steps = steps(PAGE)
    (console,) = (step.text for step in page_steps if step.kind == "console")
    (script,) = (step for step in page_steps if step.file == "grbl.txt")
    command, _, on_page = console.partition("\n")
    monkeypatch.chdir(tmp_path)
    Path("grbl.elf").write_bytes(Path(GRBL).read_bytes())
    Path(script.file).write_text(script.text)
    assert main(shlex.split(command.removeprefix("$ stage "))) == 0
    printed = capsys.readouterr().out
    assert is_printed(on_page, printed, tolerance=0.002), printed  # the compiler decides on some cycles
    assert [line.split()[-1] for line in printed.splitlines() if "error:" in line] == [
        "error:7",
        ">:error:7",
        ">:error:7",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_hundred_random_moves_take_the_steps_that_grbl_reports(seed):
    print("seed", seed)
    machine = make_grbl()
    lines = list_random_moves(random.Random(seed), 200)
    for begin in range(0, len(lines), 20):
        machine.move(*lines[begin : begin + 20])
        assert machine.count_steps_since_start() == count_reported_steps(machine)
    assert machine.count_lost_steps() == [0, 0, 0]
    assert machine.list_diagnostics() == []


def test_a_move_takes_the_steps_that_grbl_reports():
    machine = make_grbl()
    machine.move("G0 X30 Y10 Z-12.5")
    assert machine.count_steps_since_start() == [9600, 3200, -4000] == count_reported_steps(machine)
    assert machine.count_lost_steps() == [0, 0, 0]
    assert machine.list_diagnostics() == []


@pytest.mark.slow
def test_homing_repeats_within_two_microsteps():
    machine = make_grbl(x=-0.14, y=-0.09, z=0.03)
    rng = random.Random(1)
    homes = []
    for _ in range(20):
        assert machine.send("$H", timeout=120) == ["ok"]
        homes.append(machine.count_steps())
        machine.move("G91", "G0 X{:.3f} Y{:.3f} Z-{:.3f}".format(*(rng.uniform(0.1, 3) for _ in range(3))))
    for of_axis in zip(*homes, strict=True):
        assert max(of_axis) - min(of_axis) <= 2
    assert machine.count_lost_steps() == [0, 0, 0]


def test_homing_at_a_seek_rate_too_high_overruns_into_the_end_stop():
    machine = make_grbl("$110=12000", "$25=12000", "$120=2000", z=0.03, y=-0.09)
    assert machine.send("$H", timeout=120) == ["ALARM:8"]
    assert machine.axes["x"].lost_steps != 0


def test_an_acceleration_ten_times_too_high_loses_steps_that_grbl_does_not_see():
    losses = []
    for acceleration in (2000, 20000):
        machine = make_grbl(f"$120={acceleration}", "$110=4500")
        machine.move("G0 X50")
        assert machine.count_steps_since_start() == [50 * STEPS_PER_MM, 0, 0] == count_reported_steps(machine)
        losses.append(abs(machine.axes["x"].lost_steps))
    assert losses[0] == 0
    assert losses[1] > 0


def test_a_hard_limit_ends_a_move_in_alarm_1():
    machine = make_grbl("$21=1", x=0.145)
    machine.host.serial.write("G0 X20\n")
    assert machine.wait_for_alarm() == "ALARM:1"
    machine.host.serial.read_until("[MSG:Reset to continue]")
    machine.host.serial.write(RESET)
    machine.host.serial.read_until("unlock]")
    assert machine.send("G0 X0", "$X") == ["error:9", "ok"]


def test_homing_with_a_switch_stuck_open_ends_in_alarm_9():
    machine = make_grbl("$132=10", z=0.03)
    faults.switch_stuck(machine.axes["z"], "el_plus", False)
    assert machine.send("$H") == ["ALARM:9"]


def test_homing_with_a_switch_stuck_closed_ends_in_alarm_8():
    machine = make_grbl(z=0.03)
    faults.switch_stuck(machine.axes["z"], "el_plus", True)
    assert machine.send("$H") == ["ALARM:8"]


def test_a_jog_moves_its_distance_and_a_canceled_jog_stops_with_a_ramp():
    machine = make_grbl()
    assert machine.send("$J=G91 X5 F3000") == ["ok"]
    machine.host.run_for(0.3)
    assert machine.count_steps_since_start() == [5 * STEPS_PER_MM, 0, 0]
    assert machine.send("$J=G91 X50 F3000") == ["ok"]
    machine.host.run_for(0.3)
    assert machine.report().startswith("<Jog|")
    machine.host.serial.write(JOG_CANCEL)
    machine.host.run_for(0.3)
    assert machine.report().startswith("<Idle|")
    assert 6 * STEPS_PER_MM < machine.count_steps_since_start()[0] < 30 * STEPS_PER_MM
    assert machine.count_steps_since_start() == count_reported_steps(machine)
    assert machine.count_lost_steps() == [0, 0, 0]


def test_a_feed_hold_waits_at_rest_and_a_cycle_start_completes_the_move():
    machine = make_grbl()
    assert machine.send("G1 X20 F3000") == ["ok"]
    machine.host.run_for(0.15)
    machine.host.serial.write("!")
    machine.host.run_for(0.3)
    assert machine.report().startswith("<Hold:0|")
    rest = machine.count_steps()
    machine.host.run_for(0.1)
    assert machine.count_steps() == rest
    machine.host.serial.write("~")
    machine.move()
    assert machine.count_steps_since_start() == [20 * STEPS_PER_MM, 0, 0] == count_reported_steps(machine)


def test_a_reset_in_motion_is_alarm_3_and_the_position_is_lost():
    machine = make_grbl("$120=3000")
    assert machine.send("G0 X50") == ["ok"]
    machine.host.run_for(0.3)
    machine.host.serial.write(RESET)
    assert machine.wait_for_alarm() == "ALARM:3"
    machine.host.serial.read_until("unlock]")
    machine.host.run_for(0.3)
    assert machine.send("G0 X0") == ["error:9"]
    assert abs(machine.count_steps_since_start()[0] - count_reported_steps(machine)[0]) <= 1, (
        "it counts one that it did not make"
    )
    assert machine.axes["x"].lost_steps != 0, "a motor does not stop at once"
