"""Benchmark of an MCX514 compared with PCL-240K at the same pulse rates: alone, and three axes of a stage in the closed loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from bench.chips import load_registers as load_pcl
from bench.chips import make_running_work
from bench.figures import Figure, Run
from bench.machines import RATE, SETTLED, make_moving_stage
from bench.timing import measure_alternately
from stage import Stage
from stage.chips import MCX514, PCL240K
from stage.firmware.pcl240.chip_port import CONTROL, RAMP_START_COMMANDS, RESET, START

TITLE = "NOVA chips beside PCL-240 at the same pulse rates"
PCL_HZ, NOVA_HZ = PCL240K.DEFAULT_CLOCK_HZ, MCX514.DEFAULT_CLOCK_HZ
STEPS = 2000
LOW, HIGH = 50 * PCL_HZ // 16384, 8000 * PCL_HZ // 16384  # pps of R1 = 50, R2 = 8000
RAMP_CLOCKS = 4 * 7950  # of the PCL-240K with R4 = 4
CONSTANT = 0.08  # s


def load_registers(chip: Any, axes: int, order: str, **registers: int) -> Any:
    """Write parameters of an MCX514 by name, then a command, for several axes; return the chip.

    Args:
        chip: Chip to write.
        axes: Bit mask of the axes.
        order: Symbol of the command.
        **registers: Values by name.
    """
    for name, value in registers.items():
        chip.write(6, value & 0xFFFF)
        chip.write(7, value >> 16 & 0xFFFF)
        chip.write(0, axes << 8 | chip.MAP.command(name).code)
    chip.write(0, axes << 8 | chip.MAP.command(order).code)
    return chip


def start_nova_constant_speed(chip: Any) -> Any:
    return load_registers(chip, 1, "DRVVP", SV=HIGH, DV=HIGH)


def start_nova_ramp(chip: Any) -> Any:
    return load_registers(chip, 1, "DRVVP", SV=LOW, DV=HIGH, AC=(HIGH - LOW) * PCL_HZ // RAMP_CLOCKS)


def start_pcl_constant_speed(chip: Any) -> Any:
    return load_pcl(chip, RESET, CONTROL, START["FH1"], R1=50, R2=8000, R7=2)


def start_pcl_ramp(chip: Any) -> Any:
    return load_pcl(chip, RESET, CONTROL, RAMP_START_COMMANDS["FH1"], R1=50, R2=8000, R4=4, R5=4, R7=2)


def make_nova_stage() -> Stage:
    """Make a stage that makes the moves of `make_moving_stage` with one MCX514."""
    stage = Stage("xyz", chips=MCX514, visuals=False)
    low, high = RATE["R1"] * PCL_HZ // (8192 * RATE["R7"]), RATE["R2"] * PCL_HZ // (8192 * RATE["R7"])
    load_registers(stage.chips[0], 0b111, "DRVVP", SV=low, DV=high, AC=20_000)
    stage.run(SETTLED)
    return stage


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    stages = {"nova": make_nova_stage(), "pcl": make_moving_stage(visuals=False)}
    t = measure_alternately(
        {name: make_stepping_work(stage) for name, stage in stages.items()}, run.rounds, run.choose(25, 5)
    )
    yield Figure.of(
        "nova.closed_loop", "closed loop, xyz at 2000 pps: MCX514 / PCL240K, time", "ratio", t["nova"] / t["pcl"]
    )
    ramp = RAMP_CLOCKS / PCL_HZ
    cases = (
        ("advance", "constant speed, advanced", start_nova_constant_speed, start_pcl_constant_speed, 100.0, False),
        ("constant", "constant speed, traced", start_nova_constant_speed, start_pcl_constant_speed, CONSTANT, True),
        ("ramp", "a ramp, traced", start_nova_ramp, start_pcl_ramp, ramp, True),
    )
    for key, name, nova, pcl, seconds, traced in cases:
        works = {
            "nova": make_running_work(MCX514, nova, round(seconds * NOVA_HZ), traced),
            "pcl": make_running_work(PCL240K, pcl, round(seconds * PCL_HZ), traced),
        }
        t = measure_alternately(works, run.rounds, run.choose(15, 5))
        yield Figure.of(f"nova.{key}", f"{name}: MCX514 / PCL240K, time", "ratio", t["nova"] / t["pcl"])
        if traced:
            n = len(nova(MCX514()).trace(round(seconds * NOVA_HZ)))
            yield Figure.of(f"nova.{key}_rate", "  pulses of the MCX514 traced", "1/s", n / t["nova"])


def make_stepping_work(stage: Stage) -> tuple[Callable[[], None], Callable[[], None]]:
    """Make a work that steps a stage from its present state.

    Args:
        stage: Stage in motion.

    Returns:
        Preparation and work.
    """
    start = stage.snapshot()
    return lambda: stage.restore(start), lambda: stage.step(STEPS)
