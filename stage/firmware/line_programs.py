"""`LinePrograms`: straight lines of several axes, written as programs by the drivers of their chips.

    lines = create_line_programs(drivers, settings)    drivers of axes whose chips are of one kind
    lines.names, lines.shape                           registers that can be chosen, and the shape of their array
    lines.compute_registers(moves)                     registers by the data sheet's formulas
    lines.apply_corrections(moves, corrections)        the same with corrections from -1 to 1
    operations = lines.write_programs(registers, moves)   bus cycles up to the last start command, as arrays
    lines.trace_pulses(operations[k], distances)       times of the pulses, from copies of the chips

The first index of every array is the stage.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from stage.chips import core_interface
from stage.errors import ArgumentError
from stage.firmware.driver import Driver
from stage.firmware.parameter_ranges import get_register_range
from stage.sim import program_player
from stage.sim.program import Program

MAX_RAMP_SHARE = 0.8  # of a short move may be ramps


def compute_peak_rate(fl: Any, rate: Any, room: Any, up: Any, down: Any) -> Any:
    """Compute the highest rate, pps, that a move reaches if its ramps may take `room` pulses.

    All arguments are numbers or arrays of one shape.

    Args:
        fl: Start rate, pps.
        rate: Drive rate, pps.
        room: Pulses that the ramps may take.
        up: Time of the ramp up to the drive rate, s.
        down: Time of the ramp down, s.
    """
    return np.minimum(rate, np.sqrt(fl**2 + 2.0 * room * np.maximum(rate - fl, 1e-9) / (up + down)))


MAX_CLOCKS = 1 << 44  # clocks: weeks


class LineMoves(NamedTuple):
    """Moves along lines, one for each stage.

    Attributes:
        distances: Signed pulses of each axis, shape (stages, axes).
        rate: Peak rate of the longest axis, pps, shape (stages,).
        ramp: Time of its ramps, s, shape (stages,); None: the `accel` of the line's settings.
    """

    distances: np.ndarray
    rate: np.ndarray
    ramp: np.ndarray | None = None

    @property
    def magnitudes(self) -> np.ndarray:
        """Pulses of each axis without their sign, shape (stages, axes)."""
        return np.abs(self.distances)

    @property
    def longest(self) -> np.ndarray:
        """Pulses of the longest axis, shape (stages,)."""
        return self.magnitudes.max(axis=1)

    @property
    def shares(self) -> np.ndarray:
        """Pulses of each axis divided by those of the longest axis, shape (stages, axes)."""
        return self.magnitudes / self.longest[:, None]

    def select_leader_values(self, values: np.ndarray) -> np.ndarray:
        """Select the values of the longest axis, shape (stages, 1), from values of all axes, shape (stages, axes)."""
        return np.take_along_axis(values, self.magnitudes.argmax(axis=1)[:, None], 1)


class LineSettings(NamedTuple):
    """Settings of straight lines of several axes.

    Attributes:
        fl: Start rate of the longest axis, pps.
        accel: Time of its ramps, s.
        s_curve: Whether the ramps are S-curves.
        reach: Largest correction: pulses along the line by which a correction of 1, through changed registers, shifts an axis.
        axes: Names of the axes, for error messages.
    """

    fl: float
    accel: float
    s_curve: bool = False
    reach: float = 1.0
    axes: tuple[str, ...] = ()


class LinePrograms(ABC):
    """Straight lines of several axes with chips of one kind, written as programs.

    Attributes:
        names: Names of the registers in a row.
        shape: Shape (rows, names) of the registers of one stage, with one row for each axis, or one row for all axes.
        max_rate: Highest rate of the longest axis, pps.
    """

    names: tuple[str, ...]
    shape: tuple[int, int]
    max_rate: float

    def __init__(self, drivers: Sequence[Driver], settings: Any, rows: int, names: tuple[str, ...]):
        self.drivers: list[Any] = list(drivers)
        self.settings, self.names = settings, names
        self.chip: Any = drivers[0].chip
        self.clock_hz = self.chip.clock_hz
        self.shape = (rows, len(names))
        ranges = [get_register_range(self.chip.MAP, name) for name in names]
        self.low, self.high = (np.array(side, np.int64) for side in zip(*ranges, strict=True))
        self._slots: list[tuple[int, int, int]] = []
        self._fresh = [type(chip)(**chip.options()).snapshot().record for chip, _ in self._group_by_chip()]

    # --- what a family answers ---

    @abstractmethod
    def compute_registers(self, moves: LineMoves) -> np.ndarray:
        """Compute the registers of lines by the formulas of the data sheet.

        Args:
            moves: Moves along the line.

        Returns:
            Registers, shape (stages, *shape).
        """

    @abstractmethod
    def apply_corrections(self, moves: LineMoves, corrections: np.ndarray) -> np.ndarray:
        """Compute the registers of lines by the data sheet's formulas, and correct them.

        Args:
            moves: Moves along the line.
            corrections: Numbers from -1 to 1, shape (stages, *shape); 0 changes nothing.

        Returns:
            Registers, shape (stages, *shape).
        """

    @abstractmethod
    def compute_line_errors(self, moves: LineMoves) -> np.ndarray:
        """Compute how far each axis leaves the straight line with the registers that the data sheet's formulas give.

        Args:
            moves: Moves along the line.

        Returns:
            Pulses, shape (stages, axes, 4), see `compute_deviations`.
        """

    @abstractmethod
    def write_programs(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        """Write the bus cycles of the lines, from rest to the last start command.

        Args:
            registers: Registers, shape (stages, *shape).
            moves: Moves along the line.

        Returns:
            Operations, shape (stages, operations, 4). The stages differ only in the numbers that the operations write.
        """

    @abstractmethod
    def find_start_operations(self, distances: np.ndarray) -> np.ndarray:
        """Return for each axis of one stage the index of the operation that starts the axis."""

    def compute_last_pulse_seconds(self, registers: np.ndarray) -> np.ndarray:
        """Return the seconds from the beginning of the last pulse to the end of the drive, shape (stages,)."""
        return np.zeros(len(registers))

    # --- the same for all ---

    def clip_to_legal_range(self, registers: np.ndarray) -> np.ndarray:
        """Clip the registers of lines to the ranges of the data sheet."""
        return np.clip(np.rint(registers), self.low, self.high).astype(np.int64)

    def compute_peak_rates_and_ramps(self, moves: LineMoves) -> tuple[np.ndarray, np.ndarray]:
        """Compute the peak rates and ramp times for which the moves are long enough.

        Args:
            moves: Moves along the line.

        Returns:
            Rates, pps, and times of the ramps, s, each of shape (stages,).
        """
        c = self.settings
        accel = c.accel if moves.ramp is None else moves.ramp
        top = np.maximum(moves.rate - c.fl, 1e-9)
        peak = compute_peak_rate(c.fl, moves.rate, MAX_RAMP_SHARE * moves.longest, accel, accel)
        return peak, np.maximum(accel * (peak - c.fl) / top, 1e-6)

    def compute_deviations(
        self,
        moves: LineMoves,
        rate: np.ndarray,
        ramp: np.ndarray,
        lag: np.ndarray,
        ramp_down_lag: np.ndarray,
        down_point: np.ndarray,
    ) -> np.ndarray:
        """Compute in closed form how far axes are from the straight line, given by the longest axis. All arrays are (stages, axes).

        Args:
            moves: Moves along the line.
            rate: Rates, pps.
            ramp: Times of the ramps up, s.
            lag: Pulses that the two ramps make less than the full rate would in their time.
            ramp_down_lag: Pulses that the ramp down makes less than the full rate would in its time.
            down_point: Pulses left when the ramp down begins.

        Returns:
            Pulses (stages, axes, 4): lead of the axis after the ramp-up, increase of the lead until the ramp-down, pulses by which
            the ramp-down begins earlier, and pulses by which it is shorter.
        """
        lead, share = moves.select_leader_values, moves.shares
        risen = lead(ramp)
        falls = lead((moves.magnitudes - down_point + lag) / rate)
        off = rate - share * lead(rate)
        rise = off * risen - (lag - share * lead(lag))
        return np.stack(
            [
                rise,
                off * (falls - risen),
                down_point - share * lead(down_point),
                ramp_down_lag - share * lead(ramp_down_lag),
            ],
            axis=2,
        )

    def trace_pulses(self, ops: np.ndarray, distances: np.ndarray) -> list[np.ndarray]:
        """Run the program of one stage's line on copies of the chips, and record their pulses.

        Args:
            ops: Operations of the program, shape (operations, 4).
            distances: Signed pulses of each axis, shape (axes,).

        Returns:
            For each axis the ticks (int64) from its start to each of its pulses.
        """
        out: list[np.ndarray] = [np.empty(0, np.int64)] * len(self.drivers)
        for (chip, mine), fresh in zip(self._group_by_chip(), self._fresh, strict=True):
            rows = np.frombuffer(bytearray(fresh), chip.CORE.STATE)
            replica = np.zeros(1, core_interface.CHIP)
            core_interface.fill_chip_record(replica[0], chip.CORE, rows.ctypes.data)
            program_player.write_cycles(replica, ops, sum(1 << self.drivers[a].index for a in mine))
            pulses = np.empty(int(np.abs(distances[mine]).sum()), chip.CORE.PULSE)
            pulses = pulses[: chip.CORE.trace_pulses.c(rows.ctypes.data, MAX_CLOCKS, pulses.ctypes.data, len(pulses))]
            for a in mine:
                out[a] = pulses["clock"][pulses["axis"] == self.drivers[a].axis.chip_axis]
        return out

    def _group_by_chip(self) -> list[tuple[Any, list[int]]]:
        """Return each chip with the indices of its axes on the line."""
        chips: dict[int, tuple[Any, list[int]]] = {}
        for a, h in enumerate(self.drivers):
            chips.setdefault(id(h.chip), (h.chip, []))[1].append(a)
        return list(chips.values())

    def _mark_column_operation(self, program: Program, index_from_end: int, column: int, shift: int = 0) -> None:
        """Mark an operation of the template program as one that writes a column of the numbers given to `_fill_template`.

        Args:
            program: Template.
            index_from_end: Position of the operation, counted from the end of the template.
            column: Index of the column that `_fill_template` writes there.
            shift: Number of bits by which the value is shifted to the right.
        """
        self._slots.append((len(program) - index_from_end, column, shift))

    def _fill_template(self, template: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return a copy of the template program for each line, in which the marked operations write their columns.

        Args:
            template: Operations, shape (operations, 4).
            columns: Numbers to write, shape (stages, columns).
        """
        ops = np.repeat(template[None], len(columns), axis=0)
        for j, column, shift in self._slots:
            ops[:, j, 3] = columns[:, column] >> shift & self.chip.DATA_MASK
        return ops


def create_line_programs(drivers: Sequence[Driver], settings: Any) -> LinePrograms:
    """Create the line programs of the axes whose drivers can make straight lines together.

    Args:
        drivers: Drivers of the axes.
        settings: Settings, as `LineSettings`.

    Raises:
        ArgumentError: The chips support no line together.
    """
    kinds = sorted({type(h.chip).__name__ for h in drivers})
    if len(kinds) > 1:
        raise ArgumentError(
            f"axes={settings.axes!r}: {' and '.join(kinds)} cannot be synchronized: give them one kind of chip."
        )
    return drivers[0].build_line_programs(drivers, settings)
