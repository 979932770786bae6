"""Benchmark of chips alone, without a stage, compared with the reference that takes one clock at a time (tests/reference)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bench.figures import Figure, Run
from bench.timing import measure_alternately
from stage.chips import PCL240K, PCL240MS
from stage.firmware import Profile
from stage.firmware.pcl240.chip_port import CONTROL, RAMP_START_COMMANDS, RESET, SELECT, START

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from reference.pcl240 import ReferencePCL240K
from reference.pcl240ms import ReferencePCL240MS

TITLE = "Chips alone"
CONSTANT = 10_000_000_000  # clocks
RAMP_CLOCKS = 2 * 7950  # of the fastest ramp: from 50 to 8000, a step every second clock
S_CLOCKS = 47_700  # of an S-curve of as many steps, R4 = 3
FULL = 60_000  # clocks, beyond the end of both
PULSES = 2_000_000


def load_registers(chip: Any, *commands: int, **registers: int) -> Any:
    """Write registers, then commands, by bus cycles that the chip and the reference both have; return the chip.

    Args:
        chip: Chip or reference.
        *commands: Commands to write.
        **registers: Values by name.
    """
    for name, value in registers.items():
        r = PCL240MS.MAP.register(name)
        chip.write(0, SELECT | r.number)
        for address in (3, 2, 1):
            chip.write(address, value >> 8 * (address - 1) & 0xFF)
    for command in commands:
        chip.write(0, command)
    return chip


def start_constant_speed(chip: Any) -> Any:
    """Start an endless drive with 8000 / 16384 pulses a clock, and return the chip."""
    return load_registers(chip, RESET, CONTROL, START["FH1"], R1=50, R2=8000, R7=2)


def start_fast_ramp(chip: Any) -> Any:
    """Start the fastest possible ramp (R4 = 2: a speed step every second clock), and return the chip."""
    return load_registers(chip, RESET, CONTROL, RAMP_START_COMMANDS["FH1"], R1=50, R2=8000, R4=2, R5=2, R7=2)


def start_s_curve(chip: Any) -> Any:
    """Start an S-curve of 7950 speed steps, and return the chip."""
    profile = Profile(50, 8000, 8000, 3, 3, 2, spans=(0, 0), chip=PCL240MS)
    return load_registers(chip, RESET, CONTROL, RAMP_START_COMMANDS["FH1"], **profile.registers(), R0=0xFFFFFF)


def start_linear_ramp(chip: Any) -> Any:
    """Start a linear ramp with the number of speed steps and the R4 of `start_s_curve`, and return the chip."""
    profile = Profile(50, 8000, 8000, 3, 3, 2, chip=PCL240MS)
    return load_registers(chip, RESET, CONTROL, RAMP_START_COMMANDS["FH1"], **profile.registers(), R0=0xFFFFFF)


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    ticks = run.choose(20_000, 5_000)
    cases = (
        ("constant", "constant speed", PCL240K, ReferencePCL240K, start_constant_speed, CONSTANT),
        ("ramp", "fastest ramp (R4 = 2)", PCL240K, ReferencePCL240K, start_fast_ramp, RAMP_CLOCKS),
        ("s_curve", "S-curve (R4 = 3)", PCL240MS, ReferencePCL240MS, start_s_curve, S_CLOCKS),
    )
    for key, name, chip, reference, begin, clocks in cases:
        t = measure_alternately(
            {"fast": make_running_work(chip, begin, clocks), "slow": make_reference_work(reference, begin, ticks)},
            run.rounds,
            run.choose(9, 3),
        )
        yield Figure.of(f"chips.{key}", f"{name}, simulated clocks", "1/s", clocks / t["fast"])
        times = (clocks / t["fast"]) / (ticks / t["slow"])
        yield Figure.of(f"chips.{key}_reference", "  beside the tick reference", "times", times)
    works = {
        "curved": make_running_work(PCL240MS, start_s_curve, FULL),
        "linear": make_running_work(PCL240MS, start_linear_ramp, FULL),
    }
    t = measure_alternately(works, run.rounds, run.choose(25, 5))
    yield Figure.of(
        "chips.s_curve_linear", "S-curve / linear ramp (PCL240MS), time", "ratio", t["curved"] / t["linear"]
    )
    pulses = run.choose(PULSES, PULSES // 10)
    clocks = pulses * 16384 // 8000
    works = {
        "trace": make_running_work(PCL240K, start_constant_speed, clocks, traced=True),
        "slow": make_reference_work(ReferencePCL240K, start_constant_speed, ticks, traced=True),
    }
    t = measure_alternately(works, run.rounds, 3)
    yield Figure.of("chips.traced", "pulses traced", "1/s", pulses / t["trace"], "each with clock, axis, direction")
    times = (clocks / t["trace"]) / (ticks / t["slow"])
    yield Figure.of("chips.traced_reference", "  beside the tick reference", "times", times)


def make_running_work(make: Any, begin: Callable[[Any], Any], clocks: int, traced: bool = False) -> tuple[Any, Any]:
    """Make a work in which a chip is started again before each call and then advances or is traced.

    Args:
        make: Class of the chip.
        begin: Function that starts it.
        clocks: Clocks of a call.
        traced: Whether pulses are stored.

    Returns:
        Preparation and work.
    """
    chip = make()
    fresh = chip.snapshot()

    def prepare() -> None:
        chip.restore(fresh)
        begin(chip)

    return prepare, lambda: chip.trace(clocks) if traced else chip.advance(clocks)


def make_reference_work(make: Any, begin: Callable[[Any], Any], ticks: int, traced: bool = False) -> tuple[Any, Any]:
    """Make a work of the reference, as `make_running_work` does for a chip.

    Args:
        make: Class of the reference.
        begin: Function that starts it.
        ticks: Clocks of a call.
        traced: Whether pulses are stored.

    Returns:
        Preparation and work.
    """
    chip: Any = None

    def prepare() -> None:
        nonlocal chip
        chip = begin(make())

    def work() -> None:
        if traced:
            chip.trace(ticks)
        else:
            for _ in range(ticks):
                chip.tick()

    return prepare, work
