"""`LinePrograms`: how the drivers of several axes draw straight lines together, as programs.

    line = line_of(drivers, settings)       drivers of axes whose chips are of one kind
    line.names, line.shape                  what can be chosen: registers, and the shape of their array
    line.data_sheet(asked)                  the engineer's registers for given moves
    line.corrected(asked, corrections)      the same with corrections from -1 to 1
    ops = line.programs(registers, asked)   bus cycles up to the last start command, as arrays
    line.pulses(ops[k], distances)          the times of the pulses, by copies of the chips

Arrays have the stage as their first index.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from stage.chips import cores
from stage.errors import ArgumentError
from stage.firmware.driver import Driver
from stage.firmware.parameter_ranges import get_register_range
from stage.sim import program_player
from stage.sim.program import Program

MAX_RAMP_SHARE = 0.8  # of a short move may be ramps


def compute_peak_rate(fl: Any, rate: Any, room: Any, up: Any, down: Any) -> Any:
    """Compute the rate that ramps between two rates reach within some pulses, at most `rate`.

    Args:
        fl: Start rate, pps; a number, or an array as all that follow.
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
        distances: Signed pulses of each axis (stages, axes).
        rate: Peak rate of the longest axis, pps (stages).
        ramp: Time of its ramps, s (stages); None: the `accel` of the line's settings.
    """

    distances: np.ndarray
    rate: np.ndarray
    ramp: np.ndarray | None = None

    @property
    def size(self) -> np.ndarray:
        """Pulses of each axis without their sign (stages, axes)."""
        return np.abs(self.distances)

    @property
    def longest(self) -> np.ndarray:
        """Pulses of the longest axis (stages)."""
        return self.size.max(axis=1)

    @property
    def share(self) -> np.ndarray:
        """Each axis' pulses as a share of the longest one's (stages, axes)."""
        return self.size / self.longest[:, None]

    def of_leader(self, values: np.ndarray) -> np.ndarray:
        """Return the value of the longest axis (stages, 1) of values (stages, axes)."""
        return np.take_along_axis(values, self.size.argmax(axis=1)[:, None], 1)


class LineSettings(NamedTuple):
    """Settings of lines.

    Attributes:
        fl: Start rate of the longest axis, pps.
        accel: Time of its ramps, s.
        s_curve: Whether the ramps are S-curves.
        reach: Pulses along the line that a correction of 1 moves an axis by.
        axes: Names of the axes, for errors.
    """

    fl: float
    accel: float
    s_curve: bool = False
    reach: float = 1.0
    axes: tuple[str, ...] = ()


class LinePrograms(ABC):
    """Several axes with chips of one kind, under settings: fl (pps), accel (s), s_curve, reach (pulses), axes (names).

    Attributes:
        names: registers of a row. shape: (rows, names): a row an axis, or one row for all.
        fastest: highest rate of the longest axis, pps.
    """

    names: tuple[str, ...]
    shape: tuple[int, int]
    fastest: float

    def __init__(self, drivers: Sequence[Driver], settings: Any, rows: int, names: tuple[str, ...]):
        self.drivers: list[Any] = list(drivers)
        self.settings, self.names = settings, names
        self.chip: Any = drivers[0].chip
        self.hz = self.chip.clock_hz
        self.shape = (rows, len(names))
        ranges = [get_register_range(self.chip.MAP, name) for name in names]
        self.low, self.high = (np.array(side, np.int64) for side in zip(*ranges, strict=True))
        self._slots: list[tuple[int, int, int]] = []
        self._fresh = [type(chip)(**chip.options()).snapshot().record for chip, _ in self._group_by_chip()]

    # --- what a family answers ---

    @abstractmethod
    def data_sheet(self, moves: LineMoves) -> np.ndarray:
        """Compute the registers by the formulas of the data sheet (stages, *shape)."""

    @abstractmethod
    def apply_corrections(self, moves: LineMoves, corrections: np.ndarray) -> np.ndarray:
        """Compute the registers of the data sheet with corrections.

        Args:
            moves: Moves along the line.
            corrections: Numbers from -1 to 1 (stages, *shape); 0 changes nothing.

        Returns:
            Registers (stages, *shape).
        """

    @abstractmethod
    def compute_share_errors(self, moves: LineMoves) -> np.ndarray:
        """Compute how far the data sheet's registers take each axis off its share of the line.

        Returns:
            Pulses (stages, axes, 4), see `compute_deviations`.
        """

    @abstractmethod
    def programs(self, registers: np.ndarray, moves: LineMoves) -> np.ndarray:
        """Write the bus cycles from rest to the last start command.

        Args:
            registers: Registers (stages, *shape).
            moves: Moves along the line.

        Returns:
            Operations (stages, operations, 4), which differ between stages in the numbers that they write only.
        """

    @abstractmethod
    def find_start_operations(self, distances: np.ndarray) -> np.ndarray:
        """Return the index of the operation that starts each axis (axes), for one stage's distances."""

    def last_pulse(self, registers: np.ndarray) -> np.ndarray:
        """Return the seconds from the beginning of the last pulse to the end of the drive (stages)."""
        return np.zeros(len(registers))

    # --- the same for all ---

    def clip_to_legal(self, registers: np.ndarray) -> np.ndarray:
        """Return the nearest registers that the data sheet allows."""
        return np.clip(np.rint(registers), self.low, self.high).astype(np.int64)

    def compute_peaks(self, moves: LineMoves) -> tuple[np.ndarray, np.ndarray]:
        """Compute the peak rate and the ramp time that the moves have room for.

        Returns:
            Rate, pps (stages), and time, s (stages).
        """
        c = self.settings
        accel = c.accel if moves.ramp is None else moves.ramp
        top = np.maximum(moves.rate - c.fl, 1e-9)
        peak = compute_peak_rate(c.fl, moves.rate, MAX_RAMP_SHARE * moves.longest, accel, accel)
        return peak, np.maximum(accel * (peak - c.fl) / top, 1e-6)

    def compute_deviations(
        self, moves: LineMoves, rate: np.ndarray, ramp: np.ndarray, lag: np.ndarray, less: np.ndarray, point: np.ndarray
    ) -> np.ndarray:
        """Compute by the closed form how far axes are from their share of the longest one.

        Args:
            moves: Moves along the line.
            rate: Rates, pps (stages, axes), as all that follow.
            ramp: Times of the ramps up, s.
            lag: Pulses by which the two ramps fall short of the full rate.
            less: Pulses by which the ramp down falls short of it.
            point: Pulses left at the ramp-down.

        Returns:
            Pulses (stages, axes, 4): ahead after the ramp-up, more ahead at the ramp-down, ramp-down earlier by, shorter ramp-down
            by.
        """
        lead, share = moves.of_leader, moves.share
        risen = lead(ramp)
        falls = lead((moves.size - point + lag) / rate)
        off = rate - share * lead(rate)
        rise = off * risen - (lag - share * lead(lag))
        return np.stack([rise, off * (falls - risen), point - share * lead(point), less - share * lead(less)], axis=2)

    def pulses(self, ops: np.ndarray, distances: np.ndarray) -> list[np.ndarray]:
        """Run one stage's program on copies of the chips, without a stage.

        Args:
            ops: Operations of the program (operations, 4).
            distances: Signed pulses of each axis (axes).

        Returns:
            Ticks (int64) from each axis' start to each of its pulses.
        """
        out: list[np.ndarray] = [np.empty(0, np.int64)] * len(self.drivers)
        for (chip, mine), fresh in zip(self._group_by_chip(), self._fresh, strict=True):
            rows = np.frombuffer(bytearray(fresh), chip.CORE.STATE)
            replica = np.zeros(1, cores.CHIP)
            cores.fill_chip_record(replica[0], chip.CORE, rows.ctypes.data)
            program_player.write_cycles(replica, ops, sum(1 << self.drivers[a].index for a in mine))
            pulses = np.empty(int(np.abs(distances[mine]).sum()), chip.CORE.PULSE)
            pulses = pulses[: chip.CORE.trace_pulses.c(rows.ctypes.data, MAX_CLOCKS, pulses.ctypes.data, len(pulses))]
            for a in mine:
                out[a] = pulses["clock"][pulses["axis"] == self.drivers[a].axis.chip_axis]
        return out

    def _group_by_chip(self) -> list[tuple[Any, list[int]]]:
        """Each chip, and which axes of the line it has."""
        chips: dict[int, tuple[Any, list[int]]] = {}
        for a, h in enumerate(self.drivers):
            chips.setdefault(id(h.chip), (h.chip, []))[1].append(a)
        return list(chips.values())

    def _add_slot(self, program: Program, back: int, column: int, shift: int = 0) -> None:
        """The operation `back` before the end writes a number, shifted right."""
        self._slots.append((len(program) - back, column, shift))

    def _fill_template(self, template: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Programs with the numbers of columns (stages, columns) in their slots."""
        ops = np.repeat(template[None], len(columns), axis=0)
        for j, column, shift in self._slots:
            ops[:, j, 3] = columns[:, column] >> shift & self.chip.DATA_MASK
        return ops


def create_line_programs(drivers: Sequence[Driver], settings: Any) -> LinePrograms:
    """Return the line that drivers draw together.

    Args:
        drivers: Drivers of the axes.
        settings: Settings, as `LineSettings`.

    Raises:
        ArgumentError: The chips draw no line together.
    """
    kinds = sorted({type(h.chip).__name__ for h in drivers})
    if len(kinds) > 1:
        raise ArgumentError(
            f"axes={settings.axes!r}: {' and '.join(kinds)} cannot be synchronized: give them one kind of chip."
        )
    return drivers[0].lines(drivers, settings)
