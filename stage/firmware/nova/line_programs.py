"""Straight lines of NOVA chips as programs: by linear interpolation, or by ranges in the ratio a:b on chips without it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.chips.nova.registers.mcx300 import UNIT_MULTIPLE_RANGE
from stage.errors import ArgumentError, add_article
from stage.firmware.line_programs import LineMoves, LinePrograms
from stage.firmware.parameter_ranges import get_register_range
from stage.sim.program import Program

if TYPE_CHECKING:
    from stage.firmware.nova.driver import NovaDriver

MAX_CORRECTION_FACTOR = 2.0  # a correction of 1 doubles a register of the main axis, of -1 halves it
MAX_FINISH_POINT = (1 << 31) - 1  # pulses in interpolation
MAX_SPEED = 8000  # of SV, V


class Ramps(NamedTuple):
    """Ramps of the axes of straight lines; all arrays have the shape (stages, axes).

    Attributes:
        multiple: Multiple 8,000,000 / R.
        low: Initial speed SV, pps.
        high: Drive speed V, pps.
        ramp: Duration of a ramp, s.
        lag: Pulses that a ramp makes less than V would in its time.
    """

    multiple: np.ndarray
    low: np.ndarray
    high: np.ndarray
    ramp: np.ndarray
    lag: np.ndarray


class NovaLinePrograms(LinePrograms):
    """Base class of both kinds of line programs for NOVA chips: by interpolation, and by ranges."""

    def check_pulses(self, driver: NovaDriver, pulses: int) -> None:
        """Check that the pulses fit the register of the finish point.

        Args:
            driver: Driver of the axis.
            pulses: Signed pulses.

        Raises:
            ArgumentError: The pulses do not fit the register.
        """
        driver.map.check_value(driver.DISTANCE_REGISTER, pulses if driver.SIGNED else abs(pulses))

    def _add_register_column(self, program: Program, driver: NovaDriver, name: str, column: int) -> None:
        """Add the write of a register whose value is a column of the numbers given to `_fill_template`.

        Args:
            program: Template of the programs.
            driver: Driver of the axis.
            name: Name of the register.
            column: Index of the column.
        """
        driver.add_register_write(program, name, 0)
        wide = self.chip.MAP.register(name).bits > 16
        self._mark_column_operation(program, 3 if wide else 2, column)
        if wide:
            self._mark_column_operation(program, 2, column, 16)


class InterpolatedLinePrograms(NovaLinePrograms):
    """Lines by interpolation. The only row has the speeds of the main axis, the lowest axis of the chip.

    The chip keeps all axes on the line, so the user chooses only speeds at which the carriages can follow. The finish points are
    the distances.
    """

    def __init__(self, drivers: Sequence[NovaDriver], settings: Any):
        self.main = min(drivers, key=lambda h: h.bit)
        super().__init__(drivers, settings, 1, self.main.list_move_registers(settings.s_curve))
        self.max_rate = float(get_register_range(self.chip.MAP, self.names[1])[1] * self.main.UNIT)
        self._first = self._write_template()

    def _write_template(self) -> int:
        """Write the program that is equal for all moves except for its columns, and return the index of the start command."""
        p, h = Program(), self.main
        for other in self.drivers:
            other.add_drive_modes(p, self.settings.s_curve)
        for column, name in enumerate(self.names):
            self._add_register_column(p, h, name, column)
        for a, other in enumerate(self.drivers):
            self._add_register_column(p, other, other.DISTANCE_REGISTER, len(self.names) + a)
        h.add_interpolation(p, sorted(self.drivers, key=lambda h: h.bit))
        self._template = np.array(p.ops, np.int64)
        return len(p) - 1

    def check_pulses(self, driver: NovaDriver, pulses: int) -> None:
        super().check_pulses(driver, pulses)
        if abs(pulses) > MAX_FINISH_POINT:
            raise ArgumentError(
                f"a line of {pulses} pulses on axis {driver.axis.name}: in interpolation the finish point of "
                f"{add_article(self.chip.MAP.chip)} is signed, and holds {MAX_FINISH_POINT} to each side. Split a longer line."
            )

    def compute_registers(self, moves: LineMoves) -> np.ndarray:
        """Compute the registers of the longest axis by the data sheet's formulas."""
        c, rows = self.settings, []
        for peak, ramp, longest in zip(*self.compute_peak_rates_and_ramps(moves), moves.longest, strict=True):
            registers = self.main.compute_move_registers(min(c.fl, peak), peak, ramp, ramp, int(longest), c.s_curve)
            rows.append([[registers[name] for name in self.names]])
        return np.array(rows, np.int64)

    def apply_corrections(self, moves: LineMoves, corrections: np.ndarray) -> np.ndarray:
        """Multiply the registers of the main axis by factors from 1/2 to 2.

        The chip keeps the axes on the line with any registers, so a correction moves no axis along the line.
        """
        rows = self.clip_to_legal_range(self.compute_registers(moves) * MAX_CORRECTION_FACTOR**corrections)
        rows[:, :, 0] = np.minimum(rows[:, :, 0], rows[:, :, 1])
        return rows

    def compute_line_errors(self, moves: LineMoves) -> np.ndarray:
        """Return zeros: a chip that interpolates keeps its axes on the straight line."""
        return np.zeros((*moves.distances.shape, 4))

    def write_programs(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        return self._fill_template(self._template, np.concatenate([registers[:, 0], moves.distances], axis=1))

    def find_start_operations(self, distances: np.ndarray) -> np.ndarray:
        return np.full(len(self.drivers), self._first)


class RangeRatioLinePrograms(NovaLinePrograms):
    """Lines by ranges in the ratio of the distances. Each axis has a row R, SV, V, A, and K with S-curves.

    The multiple 8,000,000 / R scales speeds, acceleration and jerk. If the R are in inverse ratio to the distances and all other
    registers are equal, the rates of the axes differ only by a factor. The axes of a chip start together, at the same clock.
    """

    def __init__(self, drivers: Sequence[NovaDriver], settings: Any):
        tuned = drivers[0].list_move_registers(settings.s_curve)
        super().__init__(drivers, settings, len(drivers), ("R", *tuned))
        self.ranges = get_register_range(self.chip.MAP, "R")
        self.max_rate = float(MAX_SPEED * UNIT_MULTIPLE_RANGE / self.ranges[0])
        self._write_template()

    def _write_template(self) -> None:
        """Write the program that is equal for all moves except for its columns."""
        p, m = Program(), len(self.names)
        self._drives, self._released = [], np.zeros(len(self.drivers), np.int64)
        chips = [[self.drivers[a] for a in mine] for _, mine in self._group_by_chip()]
        for a, h in enumerate(self.drivers):
            h.add_drive_modes(p, self.settings.s_curve)
            for column, name in enumerate(self.names):
                self._add_register_column(p, h, name, a * m + column)
            self._add_register_column(p, h, h.DISTANCE_REGISTER, len(self.drivers) * m + a)
        for h in self.drivers:
            h.add_command(h.add_command(p, "START_HOLD"), "F_DRV_P")
            self._drives.append(len(p) - 1)
        for mine in chips:
            free = self.chip.MAP.command("START_FREE").code
            p.write(mine[0].index, 0, sum(h.bit for h in mine) << 8 | free)
            for h in mine:
                self._released[self.drivers.index(h)] = len(p) - 1
        self._template = np.array(p.ops, np.int64)

    def compute_registers(self, moves: LineMoves) -> np.ndarray:
        """Compute the registers by the data sheet's formulas.

        V is as large as possible with a multiple of at least 1 on the shortest axis. The other registers are the nearest to each
        axis' share of the longest axis' values.
        """
        c, rho, (peak, ramp) = self.settings, moves.shares, self.compute_peak_rates_and_ramps(moves)
        fl = np.minimum(c.fl, peak)
        least, max_range = self.ranges
        multiple = np.clip(
            np.maximum(1.0 / rho.min(axis=1), peak / MAX_SPEED), 1.0, np.minimum(UNIT_MULTIPLE_RANGE / least, peak)
        )
        speed = np.maximum(np.floor(peak / multiple), 1.0)
        multiple = np.clip(peak / speed, 1.0, UNIT_MULTIPLE_RANGE / least)
        gain = np.maximum(peak - fl, 1e-9)
        ranges = np.clip(np.rint(UNIT_MULTIPLE_RANGE / (rho * multiple[:, None])), least, max_range)
        m = UNIT_MULTIPLE_RANGE / ranges
        share = rho * multiple[:, None] / m  # 1 where the multiple could be the share
        low, high = np.rint(fl / multiple), speed
        columns = [ranges, share * low[:, None], share * high[:, None]]
        if c.s_curve:
            columns += [np.full_like(m, get_register_range(self.chip.MAP, "A")[1])]
            jerk = 4.0 * gain / ramp**2
            columns += [np.rint(62_500_000 * multiple / jerk)[:, None] / share]
        else:
            columns += [share * np.maximum(np.rint(gain / ramp / (125 * multiple)), 1.0)[:, None]]
        return self._limit_initial_speed(self.clip_to_legal_range(np.stack(columns, axis=2)))

    def apply_corrections(self, moves: LineMoves, corrections: np.ndarray) -> np.ndarray:
        """Correct each register by a fraction of the counts (at least one) that move its axis by `reach` pulses along the line."""
        rows = self.compute_registers(moves)
        counts = np.maximum(np.rint(self.settings.reach / self.compute_pulses_per_register_unit(rows, moves)), 1)
        return self._limit_initial_speed(self.clip_to_legal_range(rows + np.rint(corrections * counts)))

    def compute_pulses_per_register_unit(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        """Compute the pulses by which one unit of each register moves an axis along the line, by the data sheet's formulas.

        Args:
            registers: Registers, shape (stages, axes, names).
            moves: Moves along the line.

        Returns:
            Pulses, shape (stages, axes, names).
        """
        at, r = self._compute_ramps(registers), registers.astype(np.float64)
        worth = [moves.magnitudes / r[..., 0], at.ramp * at.multiple, moves.magnitudes / r[..., 2], at.lag / r[..., 3]]
        if self.settings.s_curve:  # the acceleration is at its limit, and the jerk makes the ramps
            worth[3:] = [np.full_like(at.ramp, np.inf), at.lag / (2.0 * r[..., 4])]
        return np.maximum(np.stack(worth, axis=2), 1e-9)

    def compute_line_errors(self, moves: LineMoves) -> np.ndarray:
        at = self._compute_ramps(self.compute_registers(moves))
        return self.compute_deviations(moves, at.high, at.ramp, at.lag, at.lag, 0.5 * (at.low + at.high) * at.ramp)

    def _compute_ramps(self, registers: np.ndarray) -> Ramps:
        """Compute the ramps that result from registers of shape (stages, axes, names)."""
        r = registers.astype(np.float64)
        m = UNIT_MULTIPLE_RANGE / r[..., 0]
        low, high, rate = m * r[..., 1], m * r[..., 2], 125.0 * m * r[..., 3]
        ramp = (high - low) / rate
        if self.settings.s_curve:
            jerk = 62_500_000 * m / r[..., 4]
            ramp = np.where(rate**2 < (high - low) * jerk, ramp + rate / jerk, 2.0 * np.sqrt((high - low) / jerk))
        return Ramps(m, low, high, ramp, 0.5 * (high - low) * ramp)

    def _limit_initial_speed(self, registers: np.ndarray) -> np.ndarray:
        """Return the registers with an initial speed SV no higher than the drive speed V."""
        registers[..., 1] = np.minimum(registers[..., 1], registers[..., 2])
        return registers

    def write_programs(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        ops = self._fill_template(
            self._template, np.concatenate([registers.reshape(len(registers), -1), moves.magnitudes], axis=1)
        )
        minus = self.chip.MAP.command("F_DRV_M").code ^ self.chip.MAP.command("F_DRV_P").code
        for a, j in enumerate(self._drives):
            ops[:, j, 3] ^= np.where(moves.distances[:, a] < 0, minus, 0)
        return ops

    def find_start_operations(self, distances: np.ndarray) -> np.ndarray:
        return self._released
