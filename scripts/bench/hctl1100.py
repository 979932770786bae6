"""Benchmark of HCTL-1100 compared with PCL-240K: three axes of a stage in the closed loop, and a chip's control loop alone."""

from __future__ import annotations

from collections.abc import Iterator

from bench.figures import Figure, Run
from bench.machines import SETTLED, make_moving_stage
from bench.nova import STEPS, make_stepping_work
from bench.timing import measure_alternately
from stage import Stage
from stage.chips import HCTL1100

TITLE = "HCTL-1100 beside PCL-240"
SAMPLE = 256  # clocks, 128 us: R0F = 0Fh
LOOP = ((0x0F, 0x0F), (0x20, 0xE5), (0x21, 0x40), (0x22, 0x20), (0x0E, 0), (0x05, 0x03))
CRUISE = ((0x26, 0x30), (0x27, 0), (0x00, 0x0D), (0x3C, 1))  # integral velocity, a count a sample
SECONDS = 20.0


def write_all(chip: HCTL1100, *writes: tuple[int, int]) -> None:
    """Make bus writes, each given as (register, value)."""
    for address, value in writes:
        chip.write(address, value)


def make_servo_stage() -> Stage:
    """Make a stage of three servo axes that move at 39 mm/s."""
    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    for axis in stage.axes.values():
        stage.place(**{axis.name: 0.8 * axis.travel[0]})
        write_all(axis.chip, (0x13, 0), *LOOP, *CRUISE)
    stage.run(SETTLED)
    return stage


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    stages = {"servo": make_servo_stage(), "pcl": make_moving_stage(visuals=False)}
    t = measure_alternately(
        {name: make_stepping_work(stage) for name, stage in stages.items()}, run.rounds, run.choose(25, 5)
    )
    yield Figure.of(
        "hctl1100.closed_loop", "closed loop, xyz in motion: HCTL1100 / PCL240K, time", "ratio", t["servo"] / t["pcl"]
    )
    yield Figure.of("hctl1100.rate", "  of HCTL1100, physics steps", "1/s", STEPS / t["servo"])
    chip = HCTL1100()
    write_all(chip, *LOOP)
    chip.set_shaft(0, 1 / SAMPLE)  # a shaft that runs away: the command changes at each sample
    start, clocks = chip.snapshot(), round(SECONDS * chip.clock_hz)
    t = measure_alternately(
        {"loop": (lambda: chip.restore(start), lambda: chip.advance(clocks))}, run.rounds, run.choose(15, 5)
    )
    yield Figure.of("hctl1100.samples", "samples of the chip alone", "1/s", clocks / SAMPLE / t["loop"])
