"""Straight lines of STEP/DIR axes as programs: every step timer runs the profile of the longest axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stage.chips.stepdir.maps import MAP
from stage.firmware.driver import Driver
from stage.firmware.line_programs import LineMoves, LinePrograms
from stage.firmware.parameter_ranges import get_register_range
from stage.sim.program import Program

MAX_CORRECTION_FACTOR = 2.0
"""A correction of 1 doubles a register of the longest axis, of -1 halves it."""


class BresenhamLinePrograms(LinePrograms):
    """Lines whose axes all run the profile of the longest axis and distribute their own steps among its steps.

    The user chooses only rates and ramps at which the carriages can follow, in one row for all axes.
    """

    def __init__(self, drivers: Sequence[Driver], settings: Any):
        super().__init__(drivers, settings, 1, drivers[0].list_move_registers(settings.s_curve))
        self.max_rate = float(get_register_range(MAP, "RATE")[1])
        program = Program()
        for axis, driver in enumerate(self.drivers):
            for column, name in enumerate(self.names):
                self._add_register_column(program, driver, name, column)
            self._add_register_column(program, driver, "STEPS", len(self.names) + 1 + axis)
            self._add_register_column(program, driver, "EVENTS", len(self.names))
        self._first_start = len(program)
        for driver in self.drivers:
            program.command(driver.index, MAP.command("MOVE+").code)
        self._template = np.array(program.ops, np.int64)

    def _add_register_column(self, program: Program, driver: Driver, name: str, column: int) -> None:
        """Add the write of a register whose value is a column of `write_programs`."""
        program.register(driver.index, driver.chip, name, 0)
        self._mark_column_operation(program, 1, column)

    def compute_registers(self, moves: LineMoves) -> np.ndarray:
        """Compute the registers of the longest axis for the rates and ramps of the settings."""
        settings, rows = self.settings, []
        for peak, ramp, events in zip(*self.compute_peak_rates_and_ramps(moves), moves.longest, strict=True):
            registers = self.drivers[0].compute_move_registers(
                min(settings.fl, peak), peak, ramp, ramp, int(events), settings.s_curve
            )
            rows.append([[registers[name] for name in self.names]])
        return np.array(rows, np.int64)

    def apply_corrections(self, moves: LineMoves, corrections: np.ndarray) -> np.ndarray:
        rows = self.clip_to_legal_range(self.compute_registers(moves) * MAX_CORRECTION_FACTOR**corrections)
        rows[:, :, 0] = np.minimum(rows[:, :, 0], rows[:, :, 1])
        return rows

    def compute_line_errors(self, moves: LineMoves) -> np.ndarray:
        """Return zeros, because no axis leaves the line by more than half a step."""
        return np.zeros((*moves.distances.shape, 4))

    def write_programs(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        ops = self._fill_template(
            self._template, np.concatenate([registers[:, 0], moves.longest[:, None], moves.magnitudes], axis=1)
        )
        minus = MAP.command("MOVE-").code ^ MAP.command("MOVE+").code
        for axis in range(len(self.drivers)):
            ops[:, self._first_start + axis, 3] ^= np.where(moves.distances[:, axis] < 0, minus, 0)
        return ops

    def find_start_operations(self, distances: np.ndarray) -> np.ndarray:
        return self._first_start + np.arange(len(self.drivers))
