"""Straight lines of PCL-240 chips as programs. Each axis has its own chip; only the registers keep the axes on the line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.firmware.line_programs import LineMoves, LinePrograms
from stage.firmware.pcl240 import chip_port
from stage.sim.program import Program

if TYPE_CHECKING:
    from stage.firmware.pcl240.driver import Pcl240Driver

MAX_SPEED_STEPS = 8191  # most steps of R1, R2
FH_SPEED_STEPS = 8000  # the longest axis' FH in the data sheet's answer: fine, with room to correct
TAIL_PULSES = 5  # pulses of the longest axis at FL after its ramp-down


class RatioLinePrograms(LinePrograms):
    """Lines by registers in the ratio of the distances. Each axis has a row R1 R2 R4 R5 R6 R7; R3 equals R2.

    The host starts the axes one after the other, the longest axis last.
    """

    def __init__(self, drivers: Sequence[Pcl240Driver], settings: Any):
        super().__init__(drivers, settings, len(drivers), drivers[0].list_move_registers(settings.s_curve)[:6])
        self.max_rate = self.clock_hz * FH_SPEED_STEPS / (8192 * 2)
        self._write_template()

    def compute_registers(self, moves: LineMoves) -> np.ndarray:
        """Compute FL and FH in the ratio of the distances, equal ramp times, and R6 = Psd + 5 pulses in that ratio.

        Each register is rounded to the nearest value. Ramp times are those that the longest axis has after rounding.

        Args:
            moves: Moves along the line.

        Returns:
            Registers, shape (stages, axes, 6).
        """
        peak = self.compute_peak_rates_and_ramps(moves)[0]
        return self._compute_with_multipliers(
            moves, self._find_finest_multiplier(peak[:, None] * np.ones_like(moves.shares), FH_SPEED_STEPS)
        )

    def _compute_with_multipliers(self, moves: LineMoves, r7: np.ndarray) -> np.ndarray:
        """Compute the registers as `compute_registers` does, with given multipliers R7 of shape (stages, axes)."""
        fl, max_rate = self.settings.fl, self.chip.MAP.register("R4").mask
        rho, (peak, ramp) = moves.shares, self.compute_peak_rates_and_ramps(moves)
        step = self.clock_hz / (8192.0 * r7)
        high = np.clip(np.rint(rho * peak[:, None] / step), 1, MAX_SPEED_STEPS)
        low = np.clip(np.rint(rho * np.minimum(fl, peak)[:, None] / step), 1, high)
        gain = np.maximum(high - low, 1)
        lead = moves.select_leader_values(gain)
        clocks = lead * np.clip(np.rint(ramp[:, None] * self.clock_hz / lead), 2, max_rate)
        rate = np.clip(np.rint(clocks / gain), 2, max_rate)
        fall = (high + low) * gain * rate / (16384.0 * r7)
        point = np.minimum(np.floor(fall) + np.maximum(np.rint(TAIL_PULSES * rho), 1), moves.magnitudes)
        return self.clip_to_legal_range(np.stack([low, high, rate, rate, point, r7], axis=2))

    def apply_corrections(self, moves: LineMoves, corrections: np.ndarray) -> np.ndarray:
        """Correct the registers of the data sheet.

        R1, R2, R4, R5 and R6 change by a fraction of the counts (at least one) that move the axis by `reach` pulses along the
        line. R7 changes by a fraction of `multiplier_reach` counts, and the other registers are computed for the new R7.

        Args:
            moves: Moves along the line.
            corrections: Numbers from -1 to 1, shape (stages, axes, 6).

        Returns:
            Registers, shape (stages, axes, 6).
        """
        c, a = self.settings, corrections
        peak = self.compute_peak_rates_and_ramps(moves)[0]
        r7 = self.compute_registers(moves)[:, :, 5] + np.rint(a[:, :, 5] * c.multiplier_reach)
        corrected = self._compute_with_multipliers(
            moves, np.clip(r7, 2, self._find_finest_multiplier(moves.shares * peak[:, None], MAX_SPEED_STEPS))
        )
        counts = np.maximum(np.rint(c.reach / self.compute_pulses_per_register_unit(corrected, moves)), 1)
        corrected[:, :, :5] += np.rint(a[:, :, :5] * counts).astype(np.int64)
        corrected = self.clip_to_legal_range(corrected)
        corrected[:, :, 0] = np.minimum(corrected[:, :, 0], corrected[:, :, 1])
        return corrected

    def compute_pulses_per_register_unit(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        """Compute the pulses by which one unit of R1, R2, R4, R5 or R6 moves an axis along the line, by the data sheet's formulas.

        Args:
            registers: Registers, shape (stages, axes, 6).
            moves: Moves along the line.

        Returns:
            Pulses, shape (stages, axes, 5).
        """
        low, high, up, _, _, r7 = np.moveaxis(registers.astype(np.float64), 2, 0)
        gain = np.maximum(high - low, 1)
        per_clock = gain * (gain + 1) / (16384.0 * r7)
        worth = [(2 * gain + 1) * up / (16384.0 * r7), moves.magnitudes / high, per_clock, per_clock]
        return np.stack([*worth, np.ones_like(gain)], axis=2)

    def compute_line_errors(self, moves: LineMoves) -> np.ndarray:
        low, high, up, down, point, r7 = np.moveaxis(self.compute_registers(moves).astype(np.float64), 2, 0)
        gain, pps = high - low, high * self.clock_hz / (8192.0 * r7)
        lag, less = (gain * (gain + 1) * rate / (16384.0 * r7) for rate in (up, down))
        return self.compute_deviations(moves, pps, gain * up / self.clock_hz, lag, less, point)

    def _find_finest_multiplier(self, fh: np.ndarray, speed: int) -> np.ndarray:
        """Return the largest R7 at which FH is at most `speed` steps."""
        return np.clip(np.floor(self.clock_hz * speed / (8192.0 * fh)), 2, 1023)

    # --- the program ---

    def _write_template(self) -> None:
        """Write the program that is equal for all moves except for bytes of registers, the direction and the order of starts."""
        p, self._controls = Program(), []
        self._written = [f"R{k}" for k in range(8)] + (["R14", "R15"] if self.chip.S_CURVES else [])
        for a, h in enumerate(self.drivers):
            p.command(h.index, chip_port.RESET).command(h.index, chip_port.OUTPUT)
            for column, name in enumerate(self._written):
                p.register(h.index, self.chip, name, 0)
                for k in range((self.chip.MAP.register(name).bits + 7) // 8):
                    self._mark_column_operation(p, 1 + k, a * len(self._written) + column, 8 * k)
            p.command(h.index, chip_port.CONTROL | chip_port.PRESET)
            self._controls.append(len(p) - 1)
        self._first = len(p)
        for h in self.drivers:
            p.command(h.index, chip_port.START["FH1"])
        self._template = np.array(p.ops, np.int64)

    def build_register_rows(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        """Return the values that the program writes to each chip, shape (stages, axes, registers): R0 to R7, with S-curves R14 and
        R15."""
        r = registers
        columns = [moves.magnitudes, r[..., 0], r[..., 1], r[..., 1], *(r[..., k] for k in range(2, 6))]
        if len(self._written) > 8:
            r14 = chip_port.UNCORRECTED | (0 if self.settings.s_curve else self.chip.LINEAR_RAMPS)
            columns += [np.full_like(r[..., 0], r14), np.zeros_like(r[..., 0])]
        return np.stack(columns, axis=2)

    def write_programs(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        rows = self.build_register_rows(registers, moves)
        ops = self._fill_template(self._template, rows.reshape(len(rows), -1))
        for a, j in enumerate(self._controls):
            ops[:, j, 3] |= np.where(moves.distances[:, a] < 0, chip_port.MINUS, 0)
        order = np.argsort(moves.magnitudes, axis=1, kind="stable")
        ramps = np.where(rows[:, :, 2] > rows[:, :, 1], chip_port.RAMP_START_COMMANDS["FH1"], chip_port.START["FH1"])
        ops[:, self._first :, 1] = np.array([h.index for h in self.drivers])[order]
        ops[:, self._first :, 3] = np.take_along_axis(ramps, order, 1)
        return ops

    def find_start_operations(self, distances: np.ndarray) -> np.ndarray:
        return self._first + np.argsort(np.argsort(np.abs(distances), kind="stable"))

    def compute_last_pulse_seconds(self, registers: np.ndarray) -> np.ndarray:
        slowest = np.minimum(registers[:, :, 0], registers[:, :, 1])
        return np.max(4096 * registers[:, :, 5] / slowest, axis=1) / self.clock_hz
