"""`MacroTable`: the programs of all macros of a host, for every axis, in one table, for any family of chips.

    table = MacroTable(axes, (16, 64, 256, 1024), patience=2.0, settle=0.02)
    table.names                                             "rates gentle", "distance 16", "plus", ..., "select x"
    table.programs[table.pages[0, 3]]                       bus cycles of the fourth macro on the first axis, (operations, 4)

The macros `plus` and `minus` write the selected registers once more before they start, because some chips forget one at a reset.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from stage.envs.bus_macros_core import MACRO_KINDS
from stage.firmware.driver import get_driver
from stage.sim.program import Program

RATES = {"gentle": (500.0, 2000.0, 0.05), "usual": (1000.0, 8000.0, 0.05), "bold": (4000.0, 30_000.0, 0.02)}
"""Rates of moves by name: (start rate, pps; drive rate, pps; duration of each ramp, s)."""
HOMING = SimpleNamespace(multiplier=30, leave=0, back_off=400, limit=3.0, settle=0.02, ez=0)
"""Settings of the macro `home`, with the names of OriginReturn's settings."""
SPEEDS_HOME = (1000.0, 6000.0, 0.05, 1000.0)  # start rate and drive rate, pps; ramp, s; rate of the approach, pps
MACROS_WITHOUT_VALUES = ("plus", "minus", "home", "wait", "read")


class MacroTable:
    """Table of the programs of all macros, for each of several axes.

    Args:
        axes: Axes of a stage, m of them.
        grid: Distances that a macro can write, pulses.
        patience: Longest simulated time of the macro `wait`, s.
        settle: Simulated time after each stop, s.

    Attributes:
        names: Names of the macros. Those that select an axis are the last m.
        macros_per_axis: Number of macros before those that select an axis.
        kinds: Kind of each macro, an index in MACRO_KINDS.
        targets: Index of the rates, of the distance or of the axis that each macro selects.
        programs: Operations of all programs, (programs, operations, 4); program 0 is empty.
        pages: Index of the first program of each macro on each axis, (m, macros). `plus` and `minus` have a program for each rates
            and each distance, one after the other.
        home_searches: Origin return of each axis, by its host driver.
    """

    def __init__(self, axes: Sequence[Any], grid: Sequence[int], patience: float, settle: float):
        self.grid, self._programs = tuple(grid), [Program()]
        self._first: list[int] = []
        self.home_searches: list[Any] = []
        self._choices: list[np.ndarray] = []
        for axis in axes:
            self._add_axis_programs(axis, patience, settle)
        one = [*(f"rates {r}" for r in RATES), *(f"distance {d}" for d in self.grid), *MACROS_WITHOUT_VALUES]
        self.macros_per_axis, m = len(one), len(axes)
        self.names = (*one, *(f"select {axis.name}" for axis in axes))
        self.kinds = np.array([MACRO_KINDS.index(name.split()[0]) for name in self.names])
        self.targets = np.array(
            [*range(len(RATES)), *range(len(self.grid)), *[0] * len(MACROS_WITHOUT_VALUES), *range(m)]
        )
        self.pages = np.zeros((m, len(self.names)), np.int64)
        self.pages[:, : self.macros_per_axis] = np.array(self._first).reshape(m, self.macros_per_axis)
        self.programs = np.zeros((len(self._programs), max(map(len, self._programs)), 4), np.int64)
        for row, p in zip(self.programs, self._programs, strict=True):
            if len(p):
                row[: len(p)] = p.ops

    def _add_axis_programs(self, axis: Any, patience: float, settle: float) -> None:
        """Add the programs of an axis in the order of its macros; `plus` and `minus` have one for each rates and distance."""
        driver, a, chip = get_driver(axis), axis.index, axis.chip
        rates = [(fl, fh, up, up) for fl, fh, up in RATES.values()]
        for speeds in rates:
            values = driver.compute_move_registers(*speeds, self.grid[-1], s_curve=False)
            self._append_programs(self._write_registers(Program(), axis, values))
        for d in self.grid:
            self._append_programs(self._write_registers(Program(), axis, {driver.DISTANCE_REGISTER: d}))
        for sign in (1, -1):
            pages = []
            for speeds in rates:
                for d in self.grid:
                    pages.append(p := Program())
                    driver.write_move(p, driver.compute_move_registers(*speeds, d, s_curve=False), sign * d)
            self._append_programs(*pages)
        search = driver.build_home_program(HOMING)
        row = search.find_nearest_row(*SPEEDS_HOME, 0, HOMING.back_off)
        self.home_searches.append(search)
        self._choices.append(np.array([row]))
        self._append_programs(search.write_program(row))
        self._append_programs(Program().until_stopped([a], patience).wait(settle))
        self._append_programs(Program().read(a, chip.BUSY[0]))

    def _append_programs(self, *programs: Program) -> None:
        """Append the programs of one macro on one axis to the list of all programs."""
        self._first.append(len(self._programs))
        self._programs += programs

    @staticmethod
    def _write_registers(program: Program, axis: Any, values: dict[str, int]) -> Program:
        """Append the bus cycles that write registers, given by name, to a program, and return the program."""
        for name, value in values.items():
            program.register(axis.index, axis.chip, name, value, axis.chip_axis)
        return program

    def find_returns_at_origin(self, axis: int, results: np.ndarray) -> np.ndarray:
        """Return which of the origin returns of an axis have ended at the origin, as a mask.

        Args:
            axis: Index of the axis.
            results: Results of their programs, (n, operations).
        """
        outcome = self.home_searches[axis].decode_results(results, np.repeat(self._choices[axis], len(results), axis=0))
        return outcome.home & ~outcome.timed_out
