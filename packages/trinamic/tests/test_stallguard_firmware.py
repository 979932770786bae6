"""Homing without a switch end to end: firmware in C that stops at its DIAG pin, and the threshold sweep."""

import subprocess
import sys
from pathlib import Path

import pytest

from stage import Drive, Stage, firmware
from stage.board import Board, NativeHost

SWEEP = Path(__file__).parents[1] / "examples" / "stallguard_sweep.py"
FIRMWARE = """
#include <pulsestage.h>

static volatile int stalled;

static void on_diag(void *argument)
{
    stalled = 1;
}

PULSESTAGE_MAIN
{
    long half_us = 250, steps = 0;
    ps_pin_write(5, 0);
    ps_on_pin(9, PS_RISING, on_diag, 0);
    while (!stalled && steps < 8000) {
        ps_pin_write(2, 1);
        ps_delay_us(5);
        ps_pin_write(2, 0);
        ps_delay_us(half_us);
        if (half_us > 99)
            half_us--;
        steps++;
    }
    ps_logf("%s after %ld steps", stalled ? "stall" : "no stall", steps);
    return 0;
}
"""


def run_firmware(tmp_path, sgthrs):
    """Let firmware step towards the end of travel until its DIAG pin rises, and return its axis and its log."""
    source = tmp_path / "homing.c"
    source.write_text(FIRMWARE)
    stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc2209", current=1.2), visuals=False)
    x = stage.axes["x"]
    firmware.move(x, 0.15)
    x.chip.write_register("TCOOLTHRS", 100)
    x.chip.write_register("SGTHRS", sgthrs)
    host = NativeHost(str(source), Board(stage), pins="x.step=2,x.dir=5,x.diag=9")
    host.run()
    return x, host


def test_firmware_stops_at_the_end_of_travel_by_an_interrupt_of_its_diag_pin(tmp_path):
    x, _ = run_firmware(tmp_path, 30)
    assert x.chip.diag
    assert x.position == pytest.approx(0.156, abs=1e-3)
    assert abs(x.lost_steps) <= 8


def test_a_threshold_that_is_too_high_stops_on_the_free_travel(tmp_path):
    x, _ = run_firmware(tmp_path, 200)
    assert x.chip.diag
    assert x.position < 0.1558


@pytest.mark.slow
def test_the_sweep_finds_a_window_of_good_thresholds_for_each_case():
    done = subprocess.run([sys.executable, str(SWEEP), "--quick"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()[1:]
    assert len(lines) == 4
    assert all(" to " in line for line in lines)
