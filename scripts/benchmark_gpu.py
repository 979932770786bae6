"""Measure fleets on a GPU: closed loop beside bare mujoco-warp, memory of a copy, setup time. Prints a table for docs/gpu.md.

python scripts/benchmark_gpu.py --copies 256 1024 8192 65536
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from stage import Fleet, Program, Stage
from stage.chips import HCTL1100, PCL240K
from stage.firmware.driver import get_driver
from stage.sim.gpu.gpu_fleet import STEPS_PER_LAUNCH, GpuFleet

DIFFERENT = 256
"""Random programs; the copies play them in turn."""
STEPS = 800
"""Physics steps of each measurement, 0.2 s of simulated time, in which highest axes move."""


def make_stepper_programs(stage: Stage, rng: np.random.Generator) -> list[Program]:
    """Return random moves of all axes at once."""
    programs = []
    for _ in range(DIFFERENT):
        p = Program()
        for axis, reach in zip(stage.axes.values(), (30_000, 20_000, 10_000), strict=True):
            driver = get_driver(axis)
            pulses = int(np.exp(rng.uniform(np.log(2000), np.log(reach)))) * int(rng.choice((-1, 1)))
            start, highest = rng.uniform(150, 900), np.exp(rng.uniform(np.log(1500), np.log(32_000)))
            seconds = (highest - start) / np.exp(rng.uniform(np.log(2e4), np.log(4e5)))
            driver.write_move(p, driver.compute_move_registers(start, highest, seconds, seconds, abs(pulses)), pulses)
        programs.append(p.until_stopped([0, 1, 2], 1.0))
    return programs


def make_servo_programs(stage: Stage, rng: np.random.Generator) -> list[Program]:
    """Return random trapezoids of all axes at once."""
    programs = []
    for _ in range(DIFFERENT):
        p = Program()
        for axis in stage.axes.values():
            driver = get_driver(axis)
            driver.write_servo_move(p, driver.compute_filter(), int(rng.integers(-8000, 8000)), (1e4, 1e5))
        programs.append(p.until_stopped([0, 1, 2], 1.0))
    return programs


def pack_programs(programs: list[Program]) -> np.ndarray:
    """Return programs as one array, (programs, operations, 4)."""
    ops = np.zeros((len(programs), max(map(len, programs)), 4), np.int64)
    for row, program in zip(ops, programs, strict=True):
        row[: len(program)] = program.ops
    return ops


def measure_row(stage: Stage, programs: np.ndarray, copies: int) -> str:
    """Return a row of the table."""
    begin, free = time.perf_counter(), read_free_memory()
    fleet = Fleet([stage], device="cuda", copies=copies)
    assert isinstance(fleet, GpuFleet)
    each = programs[np.arange(copies) % len(programs)]
    fleet.load(each)
    setup, used_memory = time.perf_counter() - begin, free - read_free_memory()
    physics = fleet.physics

    def steps() -> None:
        for _ in range(STEPS_PER_LAUNCH):
            physics.step()

    graph = physics.capture_graph(steps)
    closed, bare = [], []
    for _ in range(3):
        fleet.reset()
        fleet.load(each)
        closed.append(measure_step_time(fleet.advance))
        bare.append(measure_step_time(lambda: physics.launch_graph(graph)))
    best, alone = min(closed), min(bare)
    begin = time.perf_counter()
    fleet.reset()
    fleet.play(each)
    play_seconds = time.perf_counter() - begin
    return (
        f"| {copies:,} | {copies / best / 1e6:.2f} | {copies / alone / 1e6:.2f} | {alone / best:.2f} | {best * 1e6:.0f} | "
        f"{copies / play_seconds:,.0f} | {used_memory / copies / 1e3:.0f} | {setup:.1f} |"
    )


def measure_step_time(launch: Callable[[], object]) -> float:
    """Return the seconds that a physics step takes."""
    launch()
    begin = time.perf_counter()
    for _ in range(STEPS // STEPS_PER_LAUNCH):
        launch()
    return (time.perf_counter() - begin) / STEPS


def read_free_memory() -> int:
    """Return the free memory of the GPU, bytes."""
    import warp

    return int(warp.get_device("cuda").free_memory)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--copies", type=int, nargs="+", default=[256, 1024, 8192, 65_536])
    parser.add_argument("--chips", choices=("PCL240K", "HCTL1100"), default="PCL240K")
    args = parser.parse_args()
    stepper = args.chips == "PCL240K"
    stage = Stage("xyz", chips=PCL240K if stepper else HCTL1100, visuals=False)
    programs = pack_programs(
        (make_stepper_programs if stepper else make_servo_programs)(stage, np.random.default_rng(1))
    )
    print(
        "| copies | closed loop, 10^6 steps/s | bare, 10^6 steps/s | ratio | step, us | programs/s | kB a copy | setup, s |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for copies in args.copies:
        print(measure_row(stage, programs, copies), flush=True)


if __name__ == "__main__":
    main()
