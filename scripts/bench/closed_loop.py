"""Benchmark of the whole closed loop (three chips in motion, three steppers, fifteen switches), compared with mj_step alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.figures import Figure, Run
from bench.machines import BareModel, make_moving_stage
from bench.timing import do_nothing, measure_alternately
from stage import Stage
from stage.chips import PCL240MS
from stage.firmware import ChipPort, Profile
from stage.firmware.pcl240 import chip_port

TITLE = "Closed loop beside bare mj_step (xyz, three axes in motion)"
STEPS = 2000


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    yield from compare_with_mj_step(run, make_moving_stage(), "", "")
    yield from compare_with_mj_step(run, make_moving_stage(visuals=False), "_fast", "visuals=False: ")
    curved, linear = measure_ramp_shapes(run)
    yield Figure.of("closed_loop.s_curve", "S-curve move / linear move (PCL240MS), time", "ratio", curved / linear)
    axis = make_moving_stage().axes["x"]
    cycles = run.choose(20_000, 5_000)
    t = measure_alternately({"read": (do_nothing, lambda: [axis.chip.read(0) for _ in range(cycles)])}, run.rounds, 1)
    yield Figure.of("closed_loop.bus", "bus cycles from Python, on a stage", "1/s", cycles / t["read"])


def compare_with_mj_step(run: Run, stage: Stage, suffix: str, words: str) -> Iterator[Figure]:
    """Yield figures that compare a stage, recorded or not, with mj_step on the same model.

    Args:
        run: Settings of the benchmark.
        stage: Stage in motion.
        suffix: End of the figures' keys.
        words: End of the figures' names.
    """
    bare, start = BareModel(stage, STEPS), stage.snapshot()
    recording = None

    def again() -> None:
        nonlocal recording
        if recording is not None:
            recording.close()
            recording = None
        stage.restore(start)

    def again_recorded() -> None:
        nonlocal recording
        again()
        recording = stage.record()

    works = {
        "bare": (bare.reset, lambda: bare.step(STEPS)),
        "off": (again, lambda: stage.step(STEPS)),
        "on": (again_recorded, lambda: stage.step(STEPS)),
    }
    t = measure_alternately(works, run.rounds, run.choose(25, 5))
    again()
    name = f"{words}closed loop / bare mj_step, throughput"
    yield Figure.of(f"closed_loop.off{suffix}", name, "ratio", t["bare"] / t["off"])
    yield Figure.of(f"closed_loop.on{suffix}", f"{words}the same, recording every ms", "ratio", t["bare"] / t["on"])
    yield Figure.of(f"closed_loop.rate{suffix}", f"{words}closed loop, physics steps", "1/s", STEPS / t["off"])
    yield Figure.of(f"closed_loop.bare_rate{suffix}", f"{words}bare mj_step", "1/s", STEPS / t["bare"])
    bare.reset()
    bare.step(STEPS)
    way = (bare.data.qpos - bare.began) / bare.way
    yield Figure.of(f"closed_loop.way{suffix}", "way of the bare carriages / ours, an axis each", "ratio", way)


def measure_ramp_shapes(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Measure the time for half a second of three axes that ramp up and down.

    Returns:
        Seconds with S-curves, and with linear ramps, a value a round.
    """
    stage = Stage("xyz", chips=PCL240MS)
    ports = [ChipPort(axis) for axis in stage.axes.values()]

    def start(spans: tuple[int, int] | None) -> None:
        stage.reset()
        profile = Profile(500, 4000, 4000, 400, 400, 100, spans=spans, chip=PCL240MS)
        for port in ports:
            port.write_command(chip_port.RESET)
            port.write_registers(**profile.registers())
            port.write_command(chip_port.CONTROL)
            port.write_command(chip_port.RAMP_START_COMMANDS["FH1"])

    def work() -> None:
        stage.run(0.29)
        for port in ports:
            port.write_command(chip_port.RAMP_START_COMMANDS["FL"])
        stage.run(0.29)

    works = {"curved": (lambda: start((0, 0)), work), "linear": (lambda: start(None), work)}
    t = measure_alternately(works, run.rounds, run.choose(5, 2))
    return t["curved"], t["linear"]
