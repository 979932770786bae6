"""One move of one axis: where it begins, the bus cycles, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from stage.chips import cores
from stage.errors import ArgumentError
from stage.firmware.driver import driver_of
from stage.sim import play
from stage.sim.fleet import Played
from stage.sim.program import Program
from stage.sim.stage import Axis

TENTH_MM = 1e-4  # m
MAX_OFFSET_M = 50e-6  # m, between carriage and pulses at rest


def compute_move_time(distance: Any, start: float, drive: float, ramp: float) -> Any:
    """s, that moves of so many pulses take at these rates, pps, both ramps of `ramp` s."""
    steep = (drive - start) / ramp
    top = np.minimum(np.sqrt(distance * steep + start**2), drive)
    return 2 * (top - start) / steep + (distance - (top**2 - start**2) / steep) / top


class StartPositions:
    """Where moves of an axis begin: so that their middle is the middle of the travel, the rotor at an angle that is asked for.

    turn: m (rad), after which the rotor stands in its field as before, an electrical turn of the motor; of a servo a count.
    """

    def __init__(self, axis: Axis):
        self.axis = axis
        self.middle = 0.5 * (axis.travel[0] + axis.travel[1])
        self.turn = axis.meters_per_pulse
        if not axis.drive.has_encoder:
            motor: Any = axis.drive.motor
            self.turn = 2 * np.pi / (motor.rotor_teeth * abs(axis.gear))

    def check(self, distances: tuple[float, float], unit: str) -> None:
        """Raise ArgumentError where the longest does not fit into the travel."""
        travel = self.axis.travel[1] - self.axis.travel[0]
        room = min(0.95 * travel, travel - 2 * self.turn) / self.axis.meters_per_pulse
        if distances[1] > room:
            raise ArgumentError(f"distances={distances!r}: axis {self.axis.name} has room for {int(room)} {unit}.")

    def find_start(self, distance: float, angle: float) -> float:
        """Where a move plus of `distance` pulses begins, m (rad). angle: of the rotor in its field, 0 to 1."""
        way = np.sign(self.axis.gear) * self.axis.meters_per_pulse
        return float((np.floor((self.middle - 0.5 * way * distance) / self.turn) + angle) * self.turn)


class MoveOutcomes(NamedTuple):
    """What came of a move on each stage, (n,). duration s; finished: it made its pulses; stopped: it ended without them; lost: a
    step was lost, or the carriage is not where the pulses say; vibration m. Of an encoder: error, counts; swing, m."""

    duration: np.ndarray
    finished: np.ndarray
    stopped: np.ndarray
    lost: np.ndarray
    vibration: np.ndarray
    error: np.ndarray
    swing: np.ndarray

    @property
    def in_step(self) -> np.ndarray:
        """The move is as it should be."""
        return self.finished & ~self.lost


class PulsePredictor:
    """What the chip of an axis would make of a program with no stage around it, long before physics has."""

    def __init__(self, axis: Axis):
        self.axis = axis
        chip: Any = axis.chip
        self._fresh = type(chip)(**chip.options()).snapshot().record

    def predict_pulses(self, ops: np.ndarray, seconds: float) -> int | None:
        """The net pulses of the drive that these operations start, or None if it is not over by then."""
        core = self.axis.chip.CORE
        rows = np.frombuffer(bytearray(self._fresh), core.STATE)
        twin = np.zeros(1, cores.CHIP)
        cores.fill(twin[0], core, rows.ctypes.data)
        until = round(seconds * self.axis.chip.clock_hz)
        made = play.predict_pulses(twin, ops, 1 << self.axis.index, self.axis.chip_axis, until)
        return None if made == play.STILL_BUSY else int(made)


class Trial(StartPositions):
    """Moves of an axis from power-up, by its driver.

    Args:
        point: at which vibration is observed, see `Program.measure`; 0: the axis itself. settle: s after the stop in which it is.
        encoder: the host reads one on the carriage before and after the move, and in the settling time.
    """

    def __init__(self, axis: Axis, point: int, settle: float, encoder: bool = False):
        super().__init__(axis)
        self.driver, self.point, self.settle, self.encoder = driver_of(axis), point, settle, encoder
        self.predictor = PulsePredictor(axis)
        self.stop = self.rest = 0

    def program(self, values: Mapping[str, int], distance: int, limit: float, keep_step: bool = False) -> Program:
        """The bus cycles of a move with these registers, `limit` s at most; keep_step: it ends at the first step that is lost. All
        programs are alike in length."""
        p = Program()
        if self.encoder:
            p.look(self.axis.index)
        self.driver.write_move(p, values, distance)
        self.stop = len(p)  # the wait for the stop
        self.driver.write_stop(p.until_stopped([self.axis.index], limit, keep_step=keep_step))
        self.rest = len(p)
        p.measure(self.settle, self.point)
        return p.look(self.axis.index) if self.encoder else p

    def is_hopeless(self, program: Program, distance: int, limit: float) -> bool:
        """The chip alone does not make the pulses within the limit: there is no need to look at the physics."""
        return self.predictor.predict_pulses(np.array(program.ops[: self.stop], np.int64), limit) != distance

    def read_outcomes(
        self, played: Played, truth: np.ndarray, distance: np.ndarray, count: float = 1.0
    ) -> MoveOutcomes:
        """What came of the programs. truth: of this axis, (n,); count: m, of the encoder."""
        took = played.results[:, self.stop] * 1e-9
        finished = (took > 0) & (truth["pulses"] == distance)
        lost = (truth["lost_steps"] != 0) | (np.abs(truth["commanded"] - truth["position"]) > MAX_OFFSET_M)
        low, high = (played.extremes[:, self.axis.plant.qpos, side] for side in (0, 1))
        vibration = played.results[:, self.rest] * 1e-12
        if not self.point:
            vibration = np.where(high >= low, high - low, 0.0)
        error = swing = np.zeros(len(took))
        if self.encoder:
            counts = [np.floor(played.results[:, at] * 1e-12 / count) for at in (0, self.rest + 1)]
            way = np.sign(self.axis.gear) * self.axis.meters_per_pulse
            error = counts[1] - counts[0] - np.rint(way * distance / count)
            swing = np.where(high >= low, np.floor(high / count) - np.floor(low / count), 0.0) * count
        return MoveOutcomes(np.abs(took), finished, (took > 0) & ~finished, lost, vibration, error, swing)
