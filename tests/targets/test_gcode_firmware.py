"""The committed G-code firmware on an emulated ATmega328P moves the stage: serial line, pins, timers, motors and switches together.

References: a position in mm is round(mm * 320) steps; switches trip where docs/models.md says; alarms are those of the README
beside the firmware.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from support.gcode_machine import STEP_M, STEPS_PER_MM, GcodeMachine

from stage import faults
from stage.targets import supported_processors

pytestmark = pytest.mark.skipif(
    not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
)
FIRMWARE = Path(__file__).parents[2] / "scripts" / "firmware" / "gcode" / "gcode.elf"


def make_machine(drives: str = "drv8825", **positions: float) -> GcodeMachine:
    return GcodeMachine(FIRMWARE, "help]\r\n", drives=drives, **positions)


@pytest.mark.parametrize("drives", ["a4988", "drv8825", "tb6600"])
def test_moves_of_three_axes_take_exactly_their_steps_within_the_times_of_the_power_stage(drives):
    machine = make_machine(drives)
    machine.move("G0 X10 Y-3.7 Z2.003", "G1 X7.111 F3000", "G91", "G1 X-1 Y-1 Z-1 F900")
    end = [6.111, -4.7, 1.003]
    steps = [round(mm * STEPS_PER_MM) for mm in end]
    assert machine.count_steps_since_start() == steps
    assert machine.read_positions() == pytest.approx([count / STEPS_PER_MM for count in steps], abs=0.0006)
    assert [axis.position for axis in machine.axes.values()] == pytest.approx([mm * 1e-3 for mm in end], abs=10e-6)
    assert machine.count_lost_steps() == [0, 0, 0]
    assert machine.list_diagnostics() == []


def test_homing_finds_the_contact_switches():
    machine = make_machine(x=-0.14, y=-0.09, z=0.03)
    assert machine.send("$H") == ["ok"]
    assert machine.report() == "<Idle|MPos:1.000,1.000,-1.000|Rate:0>"
    switches = [-0.150, -0.100, 0.040]
    places = [axis.commanded - offset for axis, offset in zip(machine.axes.values(), (1e-3, 1e-3, -1e-3), strict=True)]
    assert places == pytest.approx(switches, abs=2 * STEP_M)
    assert machine.count_lost_steps() == [0, 0, 0]


def test_the_carriage_follows_a_circle():
    machine = make_machine()
    machine.host.serial.write("G2 X0 I10 F2400\n")
    machine.host.run_for(0.02)
    distances = []
    while not machine.report().startswith("<Idle"):
        machine.host.run_for(0.02)
        distances.append(math.hypot(machine.axes["x"].position - 10e-3, machine.axes["y"].position))
    assert len(distances) > 50
    assert np.ptp(distances) < 60e-6
    assert machine.count_steps_since_start() == [0, 0, 0]


def test_an_acceleration_too_high_loses_steps_that_the_firmware_does_not_see():
    machine = make_machine()
    machine.move("$120=50000", "G0 X50")
    assert machine.read_positions()[0] == 50
    assert machine.count_steps_since_start() == [50 * STEPS_PER_MM, 0, 0]
    assert abs(machine.axes["x"].lost_steps) > 100
    assert machine.axes["x"].position < 0.045


def test_a_limit_switch_ends_a_move_in_an_alarm():
    machine = make_machine(x=0.145)
    assert machine.send("G1 X20 F1200") == ["ok"]
    assert machine.wait_for_alarm() == "ALARM:1"
    assert machine.axes["x"].position == pytest.approx(0.150, abs=50e-6)
    assert machine.report().startswith("<Alarm|")
    assert machine.report().endswith("|Pn:X>")
    assert machine.send("G0 X0", "$X", "G91 G0 X-5") == ["error:9", "ok", "ok"]


def test_a_switch_stuck_open_ends_homing_at_the_hard_stop_in_alarm_9():
    machine = make_machine(z=0.03)
    faults.switch_stuck(machine.axes["z"], "el_plus", False)
    assert machine.send("$132=20", "$H") == ["ok", "ALARM:9"]
    assert machine.axes["z"].commanded == pytest.approx(0.060, abs=1e-6)
    assert machine.axes["z"].position < 0.048
    assert machine.axes["z"].lost_steps != 0


def test_a_switch_stuck_closed_is_an_alarm_and_homing_ends_in_alarm_8():
    machine = make_machine(x=-0.14, y=-0.09, z=0.03)
    faults.switch_stuck(machine.axes["z"], "el_plus", True)
    assert machine.wait_for_alarm() == "ALARM:1"
    assert machine.send("$H") == ["ALARM:8"]


def test_a_feed_hold_waits_at_rest_and_a_resume_completes_the_move():
    machine = make_machine()
    assert machine.send("G1 X20 F3000") == ["ok"]
    machine.host.run_for(0.15)
    machine.host.serial.write("!")
    machine.host.run_for(0.2)
    assert machine.report().startswith("<Hold|")
    rest = machine.count_steps()
    machine.host.run_for(0.1)
    assert machine.count_steps() == rest
    assert 0 < rest[0] < 20 * STEPS_PER_MM
    machine.host.serial.write("~")
    machine.move()
    assert machine.count_steps_since_start() == [20 * STEPS_PER_MM, 0, 0]
    assert machine.count_lost_steps() == [0, 0, 0]
