"""Benchmark of cost as a function of the number of axes and of stages, with the exponent of cost ~ n^p; run length: long_run.py."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.figures import Curve, Figure, Run
from bench.machines import BareModel, make_axes_model, make_moving_stage
from bench.timing import measure_alternately
from bench.vector import DT, make_wait_programs
from stage import Fleet

TITLE = "Cost against number of axes and of stages"
AXES = (1, 2, 3, 6, 12)
STAGES = tuple(4**k for k in range(7))
STEPS = 400  # of a turn, one stage
WAIT = 40  # physics steps, many stages
STAGE_BYTES = 1.5e6  # a stage and what it leaves behind, generously


def measure(run: Run) -> Iterator[Figure | Curve]:
    """Yield the figures and curves of this subject."""
    yield from measure_axes(run)
    yield from measure_stages(run)


def measure_axes(run: Run) -> Iterator[Figure | Curve]:
    """Yield the cost of a stage as a function of its number of axes."""
    works = {}
    for n in AXES:
        stage = make_moving_stage(make_axes_model(n), visuals=False)
        bare, start = BareModel(stage, STEPS), stage.snapshot()
        works[f"ours {n}"] = (lambda s=stage, at=start: s.restore(at)), (lambda s=stage: s.step(STEPS))
        works[f"bare {n}"] = bare.reset, (lambda b=bare: b.step(STEPS))
    t = {
        name: seconds / STEPS * 1e6
        for name, seconds in measure_alternately(works, run.rounds, run.choose(15, 3)).items()
    }
    for n in AXES:
        name = f"{n} {'axis' if n == 1 else 'axes'}: bare mj_step / ours, time"
        yield Figure.of(f"scaling.axes_{n}", name, "ratio", t[f"bare {n}"] / t[f"ours {n}"])
    cost = {kind: np.stack([t[f"{kind} {n}"] for n in AXES], axis=1) for kind in ("ours", "bare")}
    for key, name, what in (
        ("axes", "cost over axes", cost["ours"]),
        ("axes_bare", "  that of bare mj_step alone", cost["bare"]),
    ):
        curve = Curve.of(f"scaling.{key}", name, "axes", "us a physics step", AXES, what, 3)
        yield curve
        yield curve.figure()


def measure_stages(run: Run) -> Iterator[Figure | Curve]:
    """Yield the cost of a fleet as a function of its number of stages."""
    max_stages = min(run.choose(4096, 64), int(read_available_memory() / STAGE_BYTES))
    sizes = [n for n in STAGES if n <= max_stages]
    first = make_moving_stage(visuals=False)
    start = first.snapshot()
    every = [first, *(copy.deepcopy(first) for _ in range(sizes[-1] - 1))]
    note = f"up to {sizes[-1]} stages" + (" (quick)" if run.quick else " fit this memory" if sizes[-1] < 4096 else "")
    works = {}
    for n in sizes:
        fleet, again, programs = Fleet(every[:n]), max(1, 256 // n), make_wait_programs(n, WAIT)

        def prepare(n: int = n) -> None:
            for s in every[:n]:
                s.restore(start)

        def work(fleet: Fleet = fleet, again: int = again, programs: np.ndarray = programs) -> None:
            for _ in range(again):
                fleet.play(programs)

        works[str(n)] = prepare, work
    t = measure_alternately(works, run.rounds, run.choose(1, 2))
    cost = np.stack([t[str(n)] / max(1, 256 // n) * 1e3 for n in sizes], axis=1)
    threads = Fleet(every[: min(64, len(every))]).threads
    name = f"ms to play a wait of {WAIT * DT * 1e3:g} ms on {threads} threads"
    curve = Curve.of("scaling.stages", "cost over stages", "stages", name, sizes, cost, 16 if max_stages > 256 else 4)
    yield curve
    yield curve.figure(note)


def read_available_memory() -> float:
    """Return the available memory in bytes; 4 GB if the operating system does not tell."""
    try:
        with Path("/proc/meminfo").open() as file:
            return next(int(line.split()[1]) * 1024 for line in file if line.startswith("MemAvailable")) * 0.7
    except (OSError, StopIteration):
        return 4e9
