"""`MacroTable`: the programs of all macros of a host, for every axis, in one table, for any family of chips.

    book = Book(axes, (16, 64, 256, 1024), patience=2.0, settle=0.02)
    book.names                                    "rates gentle", "distance 16", "plus", ..., "select x": what each macro is
    book.programs(macros, axis, written, which)    their bus cycles on an axis, (n, operations, 4)

A start writes the registers that are chosen once more: some chips forget one at a reset.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from stage.firmware.driver import get_driver
from stage.sim.program import Program

RATES = {"gentle": (500.0, 2000.0, 0.05), "usual": (1000.0, 8000.0, 0.05), "bold": (4000.0, 30_000.0, 0.02)}
"""pps at the start, pps, s of both ramps."""
HOMING = SimpleNamespace(multiplier=30, leave=0, back_off=400, limit=3.0, settle=0.02, ez=0)
"""Of the origin return, as OriginReturn has them."""
SPEEDS_HOME = (1000.0, 6000.0, 0.05, 1000.0)  # pps, pps, s; pps of the approach
OTHERS = ("plus", "minus", "home", "wait", "read")
KINDS = ("rates", "distance", *OTHERS, "select")


class MacroTable:
    """The macros of some axes.

    grid: pulses that a distance may be. patience: s that a wait may take; settle: s after each stop.

    Attributes: names; per, macros of an axis, after which those come that select one; value, which of the rates, distances or
    axes a macro is about.
    """

    def __init__(self, axes: Sequence[Any], grid: Sequence[int], patience: float, settle: float):
        self.grid, self._pages = tuple(grid), [Program()]
        self._first: list[int] = []
        self.home_searches: list[Any] = []
        self._choices: list[np.ndarray] = []
        for axis in axes:
            self._write_pages(axis, patience, settle)
        one = [*(f"rates {r}" for r in RATES), *(f"distance {d}" for d in self.grid), *OTHERS]
        self.macros_per_axis, m = len(one), len(axes)
        self.names = (*one, *(f"select {axis.name}" for axis in axes))
        kinds = np.array([name.split()[0] for name in self.names])
        self.is_kind = {kind: kinds == kind for kind in KINDS}
        self.value = np.array([*range(len(RATES)), *range(len(self.grid)), *[0] * len(OTHERS), *range(m)])
        self._find_starts = self.is_kind["plus"] | self.is_kind["minus"]
        self._at = np.zeros((m, len(self.names)), np.int64)  # where the pages of a macro begin; page 0 does nothing
        self._at[:, : self.macros_per_axis] = np.array(self._first).reshape(m, self.macros_per_axis)
        self._lengths = np.array([len(p) for p in self._pages])
        self._table = np.zeros((len(self._pages), self._lengths.max(), 4), np.int64)
        for row, p in zip(self._table, self._pages, strict=True):
            if len(p):
                row[: len(p)] = p.ops

    def _write_pages(self, axis: Any, patience: float, settle: float) -> None:
        """Write the pages of an axis in the order of its macros. Starts of moves have one for each rate and distance."""
        driver, a, chip = get_driver(axis), axis.index, axis.chip
        rates = [(fl, fh, up, up) for fl, fh, up in RATES.values()]
        for speeds in rates:
            values = driver.compute_move_registers(*speeds, self.grid[-1], s_curve=False)
            self._add_pages(self._write_registers(Program(), axis, values))
        for d in self.grid:
            self._add_pages(self._write_registers(Program(), axis, {driver.DISTANCE_REGISTER: d}))
        for sign in (1, -1):
            pages = []
            for speeds in rates:
                for d in self.grid:
                    pages.append(p := Program())
                    driver.write_move(p, driver.compute_move_registers(*speeds, d, s_curve=False), sign * d)
            self._add_pages(*pages)
        search = driver.build_home_program(HOMING)
        row = search.find_nearest_row(*SPEEDS_HOME, 0, HOMING.back_off)
        self.home_searches.append(search)
        self._choices.append(np.array([row]))
        self._add_pages(search.write_program(row))
        self._add_pages(Program().until_stopped([a], patience).wait(settle))
        self._add_pages(Program().read(a, chip.BUSY[0]))

    def _add_pages(self, *pages: Program) -> None:
        self._first.append(len(self._pages))
        self._pages += pages

    @staticmethod
    def _write_registers(p: Program, axis: Any, values: dict[str, int]) -> Program:
        for name, value in values.items():
            p.register(axis.index, axis.chip, name, value, axis.chip_axis)
        return p

    def programs(self, macros: np.ndarray, axis: np.ndarray, s: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Return the bus cycles of macros.

        Args:
            macros: Number of the macro of each stage, (n,).
            axis: Number of its axis, (n,).
            s: What is written there, with `rates` and `distance`, (n,).
            which: Mask of the stages that act, (n,).

        Returns:
            Operations, (n, operations, 4).
        """
        of_starts = np.where(self._find_starts[macros], s["rates"] * len(self.grid) + s["distance"], 0)
        pages = np.where(which, self._at[axis, macros] + of_starts, 0)
        return self._table[pages, : max(1, int(self._lengths[pages].max()))]

    def ends_at_origin(self, axis: int, results: np.ndarray) -> np.ndarray:
        """Return which origin returns of an axis ended at the origin.

        Args:
            axis: Number of the axis.
            results: Of their programs, (n, operations).
        """
        outcome = self.home_searches[axis].read_results(results, np.repeat(self._choices[axis], len(results), axis=0))
        return outcome.home & ~outcome.timed_out
