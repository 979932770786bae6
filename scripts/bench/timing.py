"""Fair timing: works run in turns, so that other load of the machine affects all of them alike."""

from __future__ import annotations

import gc
import multiprocessing
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096
Work = Callable[[], Any]


def measure_time(work: Work, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the seconds that `work` takes."""
    begin = clock()
    work()
    return clock() - begin


def measure_alternately(
    works: Mapping[str, tuple[Work, Work]], rounds: int, calls: int = 5, summarize: Callable[..., Any] = np.median
) -> dict[str, np.ndarray]:
    """Measure the time of several works that run in turns.

    In each round, every work runs `calls` times, interleaved with the others, and the first work changes from round to round. The
    value of a round is the median, or another summary. One earlier call of each work, which may compile, does not count.

    Args:
        works: (preparation, work) by name; the preparation is not timed.
        rounds: Number of rounds.
        calls: Number of calls of each work in a round.
        summarize: Function of an array and its axis: `np.min` for short works whose difference matters, on a busy machine.

    Returns:
        Seconds of a call of each work by name, (rounds,).
    """
    names = list(works)
    seconds = {name: np.zeros((rounds, calls)) for name in names}
    for prepare, work in works.values():
        prepare()
        work()
    for turn in range(rounds * calls):
        first = turn % len(names)
        for name in names[first:] + names[:first]:
            prepare, work = works[name]
            prepare()
            seconds[name][divmod(turn, calls)] = measure_time(work)
    return {name: summarize(s, axis=1) for name, s in seconds.items()}


def do_nothing() -> None:
    """Do nothing: preparation for works that need none."""


def read_resident_memory() -> int:
    """Return the resident memory of this process in bytes; Linux only."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def can_read_resident_memory() -> bool:
    """Return whether the operating system tells the resident memory of a process."""
    return Path("/proc/self/statm").exists()


def run_in_fresh_process(function: Callable[..., Any], *args: Any) -> Any:
    """Return `function(*args)`, computed in a new process in which nothing has been imported or allocated before."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *args).result()
