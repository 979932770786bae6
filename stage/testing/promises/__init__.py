"""Promises that every chip keeps, one function each: it raises `BrokenPromise` where a chip breaks it. See conformance.py.

A promise is tried with random acts (chip_acts.py) and with moves as the chip's host driver writes them. Its docstring is what a
report shows.
"""

from __future__ import annotations

from collections.abc import Callable

from stage.testing.promise_trial import Trial
from stage.testing.promises.bus import (
    bus_lines,
    command_cycles,
    diagnostics,
    has_what_every_chip_has,
    pins_by_name,
    reads,
    register_cycles,
    words,
)
from stage.testing.promises.journal import journals
from stage.testing.promises.moves import axes_alone, courses, limit_switches
from stage.testing.promises.state import determinism, resets, snapshots
from stage.testing.promises.timing import cut_time, drive_inputs, time_that_passes, traced, windows

PROMISES: dict[str, Callable[[Trial], None]] = {
    p.__name__: p
    for p in (
        has_what_every_chip_has, pins_by_name, register_cycles, command_cycles,
        bus_lines, time_that_passes, reads, diagnostics, words,
        determinism, traced, cut_time, windows, drive_inputs, courses, limit_switches, axes_alone,
        snapshots, journals, resets,
    )
}  # fmt: skip
"""Every promise by name; their docstrings say what is promised."""
