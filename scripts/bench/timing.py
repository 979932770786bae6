"""Fair timing: works take turns, so that what else the machine does meets them all alike."""

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
    """Seconds that `work` takes."""
    begin = clock()
    work()
    return clock() - begin


def measure_alternately(works: Mapping[str, tuple[Work, Work]], rounds: int, calls: int = 5) -> dict[str, np.ndarray]:
    """Seconds of a turn of each work, a value a round: name -> (rounds,).

    works: name -> (prepare, work), prepare is not timed. In a round every work has `turns` turns, interleaved; the round's
    value is their median. Who comes first goes round. A first turn of each, which may have to compile, does not count.
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
    return {name: np.median(s, axis=1) for name, s in seconds.items()}


def do_nothing() -> None:
    """Do nothing, where a comparison needs no preparation."""


def read_resident_memory() -> int:
    """Bytes of this process in memory; Linux only."""
    gc.collect()
    with Path("/proc/self/statm").open() as file:
        return int(file.read().split()[1]) * PAGE


def can_read_resident_memory() -> bool:
    return Path("/proc/self/statm").exists()


def run_in_fresh_process(function: Callable[..., Any], *args: Any) -> Any:
    """`function(*args)` where nothing was imported, made or freed before."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *args).result()
