"""Benchmark of firmware in C on a board: bus cycles a second, and the cost of a host that polls compared with one that waits."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from bench.figures import Figure, Run
from bench.machines import SETTLED, make_moving_stage, run_continuously
from bench.timing import Work, do_nothing, measure_alternately
from stage import Stage
from stage.board import Board, NativeHost, NoCompilerError, build

TITLE = "Firmware in C (xyz, three axes in motion, bus cycles of 1 us)"
LOOPS = {"tight": ("TIGHT", 0.2), "round": ("ROUND", 0.2), "write": ("WRITE", 0.02), "delay": ("DELAY", 0.2)}
"""What firmware.c does, and for how many simulated seconds a turn; every write is looked at afterwards, so they are fewer."""
SECONDS = 0.2


def make_shuttle_work(stage: Stage) -> Work:
    """Make a function that reverses the directions of the axes, so that they never reach an end."""
    minus = False

    def turn() -> None:
        nonlocal minus
        minus = not minus
        run_continuously(stage, minus)
        stage.run(SETTLED)

    return turn


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    works = {}
    try:
        for name, (loop, seconds) in LOOPS.items():
            library = build(Path(__file__).with_suffix(".c"), flags=[f"-DLOOP={loop}"])
            stage = make_moving_stage()
            host = NativeHost(library, Board(stage))
            works[name] = (make_shuttle_work(stage), partial(host.run_for, seconds))
    except NoCompilerError as error:
        print(f"  not measured: {error}")
        return
    bare = make_moving_stage()
    works["bare"] = (make_shuttle_work(bare), lambda: bare.run(SECONDS))
    t = measure_alternately(works, run.rounds, run.choose(9, 3))
    cycles = {name: seconds / bare.bus_cycle for name, (_, seconds) in LOOPS.items()}
    yield Figure.of(
        "firmware.tight", "bus cycles, status of one axis in a tight loop", "1/s", cycles["tight"] / t["tight"]
    )
    yield Figure.of("firmware.round", "bus cycles, status of three axes in turn", "1/s", cycles["round"] / t["round"])
    yield Figure.of("firmware.write", "bus cycles, writes", "1/s", cycles["write"] / t["write"])
    words = "a simulated second: "
    yield Figure.of("firmware.bare", f"{words}the closed loop alone", "s", t["bare"] / SECONDS)
    yield Figure.of("firmware.delay", f"{words}firmware that waits, 1 ms a time", "s", t["delay"] / SECONDS)
    yield Figure.of("firmware.polling", f"{words}firmware that polls b6 in a tight loop", "s", t["tight"] / SECONDS)
    yield Figure.of("firmware.delay_ratio", "  waiting / the closed loop alone", "ratio", t["delay"] / t["bare"])
    yield Figure.of("firmware.polling_ratio", "  polling / the closed loop alone", "ratio", t["tight"] / t["bare"])
    board, reads = Board(bare), run.choose(20_000, 5_000)
    t = measure_alternately({"read": (do_nothing, lambda: [board.in8(0x300) for _ in range(reads)])}, run.rounds, 1)
    yield Figure.of("firmware.python", "bus cycles from Python, Board.in8", "1/s", reads / t["read"])
