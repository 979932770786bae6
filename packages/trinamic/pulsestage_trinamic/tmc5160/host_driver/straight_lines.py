"""Registers of straight lines of several axes with TMC5160.

The chip does not interpolate. The axes move together because their velocities and accelerations have the ratio of their
distances, and because the writes to XTARGET, which start them, come one right after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pulsestage_trinamic.tmc5160.state import STOP_L, STOP_R
from stage.firmware.driver import Driver
from stage.firmware.line_programs import LineMoves, LinePrograms
from stage.sim.program import Program

RAMP_REGISTERS = ("VSTART", "AMAX", "VMAX", "DMAX", "VSTOP")
VELOCITY_UNIT, ACCELERATION_UNIT = 1 << 24, 1 << 41  # one unit: fCLK / 2^24 steps/s, fCLK^2 / 2^41 steps/s2


class ProportionalLine(LinePrograms):
    """Registers of a line: each axis gets the RAMP_REGISTERS of the longest axis, scaled by its share of the distance."""

    def __init__(self, drivers: Sequence[Driver], settings: Any):
        names = drivers[0].list_move_registers(settings.s_curve)
        super().__init__(drivers, settings, len(drivers), names)
        self.max_rate = float(self.high[names.index("VMAX")] * self.clock_hz / VELOCITY_UNIT)
        self._write_template()

    def _write_template(self) -> None:
        p, count = Program(), len(self.drivers)
        for a, driver in enumerate(self.drivers):
            for name, value in {
                **driver.compute_switch_on_registers(),
                "SW_MODE": driver.compute_sw_mode(STOP_L | STOP_R),
                "D1": 1,
            }.items():
                p.register(driver.index, driver.chip, name, value)
            for column, name in enumerate(self.names):
                p.register(driver.index, driver.chip, name, 0)
                self._mark_column_operation(p, 1, a * len(self.names) + column)
        for a, driver in enumerate(self.drivers):
            p.register(driver.index, driver.chip, "XTARGET", 0)
            self._mark_column_operation(p, 1, count * len(self.names) + a)
        self._template = np.array(p.ops, np.int64)

    def compute_registers(self, moves: LineMoves) -> np.ndarray:
        """Compute the registers of the longest axis by the formulas, rounded; other axes get the nearest values to their share."""
        c, (peak, ramp) = self.settings, self.compute_peak_rates_and_ramps(moves)
        low = np.minimum(c.fl, peak)
        lead = np.zeros((len(peak), len(self.names)))
        lead[:, 0] = lead[:, 4] = low * VELOCITY_UNIT / self.clock_hz
        lead[:, 2] = peak * VELOCITY_UNIT / self.clock_hz
        lead[:, 1] = lead[:, 3] = (peak - low) / ramp * ACCELERATION_UNIT / self.clock_hz**2
        rounded = np.maximum(np.rint(lead), 1.0)
        return self.clip_to_legal_range(moves.shares[:, :, None] * rounded[:, None, :])

    def apply_corrections(self, moves: LineMoves, corrections: np.ndarray) -> np.ndarray:
        """Correct the data sheet's registers; a correction of 1 moves the axis by `reach` steps along the line, or by one count.

        Args:
            moves: Lines, one a row.
            corrections: Corrections from -1 to 1, (lines, axes, registers).

        Returns:
            Corrected registers within their legal ranges.
        """
        registers = self.compute_registers(moves)
        counts = np.maximum(np.rint(self.settings.reach / self.compute_pulses_per_register_unit(registers, moves)), 1)
        return self.clip_to_legal_range(registers + np.rint(corrections * counts))

    def compute_pulses_per_register_unit(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        """Return by how many steps one count of each register moves an axis along the line.

        Args:
            registers: Registers, (lines, axes, registers).
            moves: Lines, one a row.
        """
        r = registers.astype(np.float64)
        up, down = (self._compute_ramp_seconds(r, start, rate) for start, rate in ((0, 1), (4, 3)))
        gained, decelerated = (
            0.5 * (r[..., 2] - r[..., start]) * t * self.clock_hz / VELOCITY_UNIT for start, t in ((0, up), (4, down))
        )
        unit = self.clock_hz / VELOCITY_UNIT
        worth = [up * unit, gained / r[..., 1], moves.magnitudes / r[..., 2], decelerated / r[..., 3], down * unit]
        return np.maximum(np.stack(worth, axis=2), 1e-9)

    def _compute_ramp_seconds(self, registers: np.ndarray, start_column: int, acceleration_column: int) -> np.ndarray:
        """Compute the duration of a ramp between the columns `start_column` and VMAX."""
        return (
            np.maximum(registers[..., 2] - registers[..., start_column], 0.0)
            * (ACCELERATION_UNIT / VELOCITY_UNIT)
            / (registers[..., acceleration_column] * self.clock_hz)
        )

    def compute_line_errors(self, moves: LineMoves) -> np.ndarray:
        r, unit = self.compute_registers(moves).astype(np.float64), self.clock_hz / VELOCITY_UNIT
        up, down = self._compute_ramp_seconds(r, 0, 1), self._compute_ramp_seconds(r, 4, 3)
        lag, less = 0.5 * (r[..., 2] - r[..., 0]) * unit * up, 0.5 * (r[..., 2] - r[..., 4]) * unit * down
        return self.compute_deviations(
            moves, r[..., 2] * unit, up, lag, less, 0.5 * (r[..., 2] + r[..., 4]) * unit * down
        )

    def write_programs(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        columns = [registers.reshape(len(registers), -1), moves.distances & 0xFFFFFFFF]
        return self._fill_template(self._template, np.concatenate(columns, axis=1))

    def find_start_operations(self, distances: np.ndarray) -> np.ndarray:
        return np.arange(len(self._template) - len(self.drivers), len(self._template))
