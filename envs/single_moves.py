"""One move of one axis: its start position, its bus cycles, and its outcome."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from stage.chips import cores
from stage.errors import ArgumentError
from stage.firmware.driver import get_driver
from stage.sim import program_player
from stage.sim.fleet import PlayedPrograms
from stage.sim.program import Program
from stage.sim.stage import Axis

TENTH_MM = 1e-4  # m
MAX_OFFSET_M = 50e-6  # m, between carriage and pulses at rest


def compute_move_time(distance: Any, start: float, drive: float, ramp: float) -> Any:
    """Compute the duration of moves in closed form.

    Args:
        distance: Pulses.
        start: Start rate, pps.
        drive: Drive rate, pps.
        ramp: Duration of each ramp, s.

    Returns:
        Seconds.
    """
    steep = (drive - start) / ramp
    top = np.minimum(np.sqrt(distance * steep + start**2), drive)
    return 2 * (top - start) / steep + (distance - (top**2 - start**2) / steep) / top


class StartPositions:
    """Positions at which moves begin, so that the middle of the move is the middle of the travel, at a chosen angle of the rotor.

    Attributes:
        turn: Travel, m (rad), after which the rotor stands in its field as before: an electrical turn; of a servo, a count.
    """

    def __init__(self, axis: Axis):
        self.axis = axis
        self.middle = 0.5 * (axis.travel[0] + axis.travel[1])
        self.turn = axis.meters_per_pulse
        if not axis.drive.has_encoder:
            motor: Any = axis.drive.motor
            self.turn = 2 * np.pi / (motor.rotor_teeth * abs(axis.gear))

    def check(self, distances: tuple[float, float], unit: str) -> None:
        """Raise ArgumentError if the longest distance does not fit into the travel.

        Args:
            distances: Least and largest, in pulses or counts.
            unit: Word for the error.
        """
        travel = self.axis.travel[1] - self.axis.travel[0]
        room = min(0.95 * travel, travel - 2 * self.turn) / self.axis.meters_per_pulse
        if distances[1] > room:
            raise ArgumentError(f"distances={distances!r}: axis {self.axis.name} has room for {int(room)} {unit}.")

    def find_start(self, distance: float, angle: float) -> float:
        """Return the position, m (rad), at which a move begins.

        Args:
            distance: Pulses, plus or minus.
            angle: Of the rotor in its field, 0 to 1.
        """
        signed_pulse_m = np.sign(self.axis.gear) * self.axis.meters_per_pulse
        return float((np.floor((self.middle - 0.5 * signed_pulse_m * distance) / self.turn) + angle) * self.turn)


class MoveOutcomes(NamedTuple):
    """Outcomes of a move on each stage, (n,).

    Attributes:
        duration: Seconds.
        finished: The move made its pulses.
        stopped: It ended without them.
        lost: A step was lost, or the carriage is not where the pulses say.
        vibration: Travel after the stop, m.
        error: Of the encoder, counts.
        swing: Of the encoder after the stop, m.
    """

    duration: np.ndarray
    finished: np.ndarray
    stopped: np.ndarray
    lost: np.ndarray
    vibration: np.ndarray
    error: np.ndarray
    swing: np.ndarray

    @property
    def in_step(self) -> np.ndarray:
        """Mask of the moves that made their pulses and lost no step."""
        return self.finished & ~self.lost


class PulsePredictor:
    """Predictor of the pulses that the chip of an axis makes of a program, without a stage."""

    def __init__(self, axis: Axis):
        self.axis = axis
        chip: Any = axis.chip
        self._fresh = type(chip)(**chip.options()).snapshot().record

    def predict_pulses(self, ops: np.ndarray, seconds: float) -> int | None:
        """Return the net pulses of the drive that operations start, or None if it is not over in time.

        Args:
            ops: Operations of a program, (operations, 4).
            seconds: Chip time.
        """
        core = self.axis.chip.CORE
        rows = np.frombuffer(bytearray(self._fresh), core.STATE)
        replica = np.zeros(1, cores.CHIP)
        cores.fill_chip_record(replica[0], core, rows.ctypes.data)
        until = round(seconds * self.axis.chip.clock_hz)
        net_pulses = program_player.predict_pulses(replica, ops, 1 << self.axis.index, self.axis.chip_axis, until)
        return None if net_pulses == program_player.STILL_BUSY else int(net_pulses)


class Trial(StartPositions):
    """Moves of an axis from power-up, by its driver.

    Args:
        point: at which vibration is observed, see `Program.measure`; 0: the axis itself. settle: s after the stop in which it is.
        encoder: the host reads one on the carriage before and after the move, and in the settling time.
    """

    def __init__(self, axis: Axis, point: int, settle: float, encoder: bool = False):
        super().__init__(axis)
        self.driver, self.point, self.settle, self.encoder = get_driver(axis), point, settle, encoder
        self.predictor = PulsePredictor(axis)
        self.stop = self.rest = 0

    def program(self, values: Mapping[str, int], distance: int, limit: float, keep_step: bool = False) -> Program:
        """Make the bus cycles of a move. All programs have the same length.

        Args:
            values: Registers by name.
            distance: Pulses.
            limit: Simulated seconds that the move may take.
            keep_step: End at the first step that is lost.
        """
        p = Program()
        if self.encoder:
            p.sample_position(self.axis.index)
        self.driver.write_move(p, values, distance)
        self.stop = len(p)  # the wait for the stop
        self.driver.write_stop(p.until_stopped([self.axis.index], limit, keep_step=keep_step))
        self.rest = len(p)
        p.measure(self.settle, self.point)
        return p.sample_position(self.axis.index) if self.encoder else p

    def is_hopeless(self, program: Program, distance: int, limit: float) -> bool:
        """Return whether the chip alone cannot make the pulses within the limit, so that physics need not run.

        Args:
            program: What `program` returned.
            distance: Pulses.
            limit: Seconds.
        """
        return self.predictor.predict_pulses(np.array(program.ops[: self.stop], np.int64), limit) != distance

    def read_outcomes(
        self, played: PlayedPrograms, truth: np.ndarray, distance: np.ndarray, count: float = 1.0
    ) -> MoveOutcomes:
        """Read the outcomes of programs that were played.

        Args:
            played: What the fleet returned.
            truth: True state of this axis after it, (n,).
            distance: Pulses, (n,).
            count: Count of the encoder, m.
        """
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
            signed_pulse_m = np.sign(self.axis.gear) * self.axis.meters_per_pulse
            error = counts[1] - counts[0] - np.rint(signed_pulse_m * distance / count)
            swing = np.where(high >= low, np.floor(high / count) - np.floor(low / count), 0.0) * count
        return MoveOutcomes(np.abs(took), finished, (took > 0) & ~finished, lost, vibration, error, swing)
