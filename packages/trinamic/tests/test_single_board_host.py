"""Host programs that drive a stage by pins, a pseudo-terminal and their clock: pyserial's way, and PyTmcStepper, unchanged."""

import os
import re
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from pulsestage_trinamic.single_board_computer_host import SingleBoardHost
from pulsestage_trinamic.tmc2209.uart_port import build_read, build_write
from stage import Stage
from stage.errors import ArgumentError

EXAMPLE = Path(__file__).parents[1] / "examples" / "pytmcstepper_homing.py"


@pytest.fixture
def host():
    stage = Stage("xy", chips="stepdir", drives={"x": "tmc2209", "y": "a4988"}, visuals=False)
    with SingleBoardHost(stage) as host:
        yield host


def read_all(port, size):
    content = b""
    while len(content) < size:
        content += os.read(port, size - len(content))
    return content


def test_a_program_that_waits_at_the_pty_gets_the_echo_and_the_reply(host):
    port = os.open(host.open_uart("x"), os.O_RDWR | os.O_NOCTTY)
    request = build_read(3, 0x06)
    os.write(port, build_write(3, 0x40, 77) + request)
    received = read_all(port, 20)
    os.close(port)
    assert received[:8] == build_write(3, 0x40, 77)
    assert received[8:12] == request
    assert received[12:16] == bytes((5, 255, 6, 0x21))
    chip = host.stage.axes["x"].chip
    assert (chip.read_register("SGTHRS"), chip.read_register("IFCNT")) == (77, 1)
    assert 200 * 8681e-9 < host.stage.time < 5e-3


def test_a_program_reaches_each_chip_of_one_wire_at_its_address():
    stage = Stage("xy", chips="stepdir", drives="tmc2209", visuals=False)
    stage.axes["y"].chip.pins.ms1 = False
    with SingleBoardHost(stage) as host:
        port = os.open(host.open_uart("x", "y", echo=False), os.O_RDWR | os.O_NOCTTY)
        for address, pins in ((3, 0x4C), (2, 0x48)):  # MS1, MS2 and PDN_UART of IOIN
            os.write(port, build_read(address, 0x06))
            assert read_all(port, 8)[:7] == bytes((5, 255, 6, 0x21, 0, 0, pins))
            time.sleep(0.01)
        os.close(port)


def test_pins_step_the_motor_and_a_watched_line_calls_back(host):
    levels = []
    host.watch_line("x", "index", levels.append)
    for _ in range(64):
        host.set_line("x", "step", True)
        host.advance(100e-6)
        host.set_line("x", "step", False)
        host.advance(400e-6)
    assert host.stage.axes["x"].chip.read_register("MSCNT") == 0
    assert levels == [False, True]
    assert not host.read_line("x", "diag")


def test_the_clock_of_the_program_is_that_of_the_stage_until_the_end(host):
    real_sleep = time.sleep
    host.replace_clock()
    begin = time.monotonic()
    time.sleep(0.25)
    passed = time.monotonic() - begin
    host.close()
    assert time.sleep is real_sleep
    assert passed == pytest.approx(0.25, abs=1e-4)
    assert host.stage.time == pytest.approx(0.25, abs=1e-4)


def test_a_chip_without_a_uart_and_a_second_port_are_refused(host):
    with pytest.raises(ArgumentError, match="no UART"):
        host.open_uart("y")
    host.open_uart("x")
    with pytest.raises(ArgumentError, match="one serial port"):
        host.open_uart("x")


@pytest.mark.skipif(
    any(find_spec(name) is None for name in ("tmc_driver", "gpiozero", "serial")),
    reason="PyTmcStepper, gpiozero and pyserial are not installed",
)
def test_pytmcstepper_homes_an_axis_without_a_switch():
    done = subprocess.run([sys.executable, str(EXAMPLE)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "amplitude 1.125 A, 2 microsteps" in done.stdout
    assert re.search(r"moved -(9\.9|10\.0)\d mm, 0 full steps lost", done.stdout), done.stdout
    assert "min StallGuard result during accel" in done.stdout + done.stderr  # test_stallguard_threshold
    assert "homing True at 156" in done.stdout
