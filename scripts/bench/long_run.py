"""Benchmark of an hour of simulated time: cost as a function of run length, and growth of the process, with and without recordings.

Axes move back and forth. After each piece of the run, mj_step alone is timed, and the cost of the piece is divided by it, so a
machine that is slower for a while does not bend the curve.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bench.figures import Curve, Figure, Run
from bench.machines import BareModel, make_moving_stage, run_shuttle
from bench.timing import can_read_resident_memory, measure_time, read_resident_memory, run_in_fresh_process

TITLE = "A long run: cost against length, growth"
MARKS = (1, 2, 5, 10, 20, 60)  # s, ends of the first pieces; then every minute
BARE = 4000  # physics steps after a piece
WARM = 0.1  # of the run, before growth counts


class RunPiece(NamedTuple):
    """Piece of a long run.

    Attributes:
        end: Simulated time at its end, s.
        cost: Its time divided by that of mj_step alone.
        resident: Resident memory of the process at its end, bytes.
    """

    end: float
    """Simulated seconds since the beginning."""
    cost: float
    """In physics steps of bare mj_step."""
    resident: int


def measure(run: Run) -> Iterator[Figure | Curve]:
    """Yield the figures and the curve of this subject."""
    seconds = run.choose(3600, 20)
    length = f"{seconds / 3600:g} h" if seconds >= 3600 else f"{seconds} s"
    note = f"{length} simulated{' (quick)' if run.quick else ''}, one run"
    for recorded in (False, True):
        pieces = run_in_fresh_process(measure_pieces, seconds, recorded)
        suffix, words = ("_recorded", ", recorded") if recorded else ("", "")
        ends, costs = [p.end for p in pieces], np.cumsum([p.cost for p in pieces])
        curve = Curve.of(f"long_run.length{suffix}", f"cost over run length{words}", "s", "steps of bare mj_step",
                         ends, costs, 2 if run.quick else 10)  # fmt: skip
        yield curve
        yield curve.figure(note)
        if can_read_resident_memory():
            warm = next(p for p in pieces if p.end >= WARM * seconds)
            grown = (pieces[-1].resident - warm.resident) / 2**20
            text = f"from {warm.end:g} s on" + (", a recording a minute, closed" if recorded else "")
            yield Figure.of(f"long_run.growth{suffix}", f"growth over {length} simulated{words}", "MiB", grown, text)


def measure_pieces(seconds: float, recorded: bool) -> list[RunPiece]:
    """Run a stage for a long time in pieces, and measure each.

    Args:
        seconds: Simulated time, s.
        recorded: Whether each minute is recorded.
    """
    stage = make_moving_stage(visuals=False)
    bare = BareModel(stage, 400)
    ends = [m for m in MARKS if m < seconds] + [m for m in range(120, int(seconds), 60)] + [seconds]

    def run_piece(length: float) -> None:
        if recorded:
            with stage.record():
                run_shuttle(stage, length)
        else:
            run_shuttle(stage, length)

    def measure_bare_step() -> float:
        bare.reset()
        return measure_time(lambda: bare.step(BARE)) / BARE

    run_piece(2.0)
    measure_bare_step()
    done, out = 0.0, []
    for end in ends:
        before = measure_bare_step()
        took = measure_time(lambda length=end - done: run_piece(length))
        out.append(
            RunPiece(
                end,
                took * 2 / (before + measure_bare_step()),
                read_resident_memory() if can_read_resident_memory() else 0,
            )
        )
        done = end
    return out
