"""Single moves of one axis: where they begin, their bus cycles, and their outcomes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from stage.chips import core_interface
from stage.errors import ArgumentError
from stage.firmware.driver import get_driver
from stage.sim import program_player
from stage.sim.fleet import PlayedPrograms
from stage.sim.program import Program
from stage.sim.stage import Axis

DISPLACEMENT_SCALE_M = 1e-4  # m
MAX_OFFSET_M = 50e-6  # between the carriage and the position that the pulses imply, at rest


def compute_move_time(distance: Any, start: float, drive: float, ramp: float) -> Any:
    """Compute the duration of moves with two equal ramps in closed form, s.

    Args:
        distance: Distances, pulses.
        start: Start rate, pps.
        drive: Drive rate, pps.
        ramp: Duration of each ramp, s.
    """
    steep = (drive - start) / ramp
    top = np.minimum(np.sqrt(distance * steep + start**2), drive)
    return 2 * (top - start) / steep + (distance - (top**2 - start**2) / steep) / top


class StartPositions:
    """Start positions for which the middle of a move is the middle of the travel, up to a chosen angle of the rotor.

    Attributes:
        turn: Travel after which the rotor has the same angle in its field, m (rad): an electrical turn; for a servo, a count.
    """

    def __init__(self, axis: Axis):
        self.axis = axis
        self.middle = 0.5 * (axis.travel[0] + axis.travel[1])
        self.turn = axis.meters_per_pulse
        if not axis.drive.has_encoder:
            motor: Any = axis.drive.motor
            self.turn = 2 * np.pi / (motor.rotor_teeth * abs(axis.gear))

    def require_room(self, distances: tuple[float, float], unit: str) -> None:
        """Raise ArgumentError if the longest distance does not fit into the travel.

        Args:
            distances: Smallest and largest distance, pulses or counts.
            unit: Name of the unit, for the error.
        """
        travel = self.axis.travel[1] - self.axis.travel[0]
        room = min(0.95 * travel, travel - 2 * self.turn) / self.axis.meters_per_pulse
        if distances[1] > room:
            raise ArgumentError(f"distances={distances!r}: axis {self.axis.name} has room for {int(room)} {unit}.")

    def find_start(self, distance: float, angle: float) -> float:
        """Return the position at which a move begins, m (rad).

        Args:
            distance: Signed distance of the move, pulses.
            angle: Angle of the rotor in its field, electrical turns from 0 to 1.
        """
        signed_pulse_m = np.sign(self.axis.gear) * self.axis.meters_per_pulse
        return float((np.floor((self.middle - 0.5 * signed_pulse_m * distance) / self.turn) + angle) * self.turn)


class MoveOutcomes(NamedTuple):
    """Outcomes of one move on each of n stages, (n,) each.

    Attributes:
        duration: Duration, s.
        finished: Mask of the moves that made all their pulses.
        stopped: Mask of the moves that stopped before they had made all their pulses.
        lost: Mask of the moves that lost a step, or whose carriage is not where the pulse count says.
        vibration: Travel of the judged point after the stop, m.
        error: Encoder count minus the count that the pulses imply; 0 without an encoder.
        swing: Travel after the stop by the encoder, m; 0 without an encoder.
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
        """Mask of the moves that made all their commanded pulses and lost no step."""
        return self.finished & ~self.lost


class MoveTrial(StartPositions):
    """Writer of programs for moves of an axis from power-up, and reader of their outcomes.

    Args:
        axis: Axis that moves, by its host driver.
        point: Point at which vibration is observed, as for `Program.measure`; 0 for the axis itself.
        settle: Simulated time after the stop in which vibration is observed, s.
        encoder: Whether the host reads an encoder on the carriage before the move, after it, and while the carriage settles.
    """

    def __init__(self, axis: Axis, point: int, settle: float, encoder: bool = False):
        super().__init__(axis)
        self.driver, self.point, self.settle, self.encoder = get_driver(axis), point, settle, encoder
        chip: Any = axis.chip
        self._chip_at_power_up = type(chip)(**chip.options()).snapshot().record
        self.stop = self.rest = 0

    def make_program(
        self, values: Mapping[str, int], distance: int, timeout_s: float, end_on_lost_step: bool = False
    ) -> Program:
        """Make the program of bus cycles for one move. All programs of a trial have the same length.

        Args:
            values: Register values by name.
            distance: Signed distance of the move, pulses.
            timeout_s: Longest simulated time of the move, s.
            end_on_lost_step: Whether the move ends at the first lost step.
        """
        p = Program()
        if self.encoder:
            p.sample_position(self.axis.index)
        self.driver.write_move(p, values, distance)
        self.stop = len(p)  # index of the operation that waits for the stop
        self.driver.write_stop(p.until_stopped([self.axis.index], timeout_s, end_on_lost_step=end_on_lost_step))
        self.rest = len(p)
        p.measure(self.settle, self.point)
        return p.sample_position(self.axis.index) if self.encoder else p

    def exceeds_timeout(self, program: Program, distance: int, timeout_s: float) -> bool:
        """Return whether the chip cannot make the pulses within `timeout_s`, so that physics need not run.

        A copy of the chip without the stage plays the program.

        Args:
            program: Program of `make_program`.
            distance: Signed distance of the move, pulses.
            timeout_s: Longest simulated time of the move, s.
        """
        chip, axis = self.axis.chip, self.axis
        rows = np.frombuffer(bytearray(self._chip_at_power_up), chip.CORE.STATE)
        replica = np.zeros(1, core_interface.CHIP)
        core_interface.fill_chip_record(replica[0], chip.CORE, rows.ctypes.data)
        ops, until = np.array(program.ops[: self.stop], np.int64), round(timeout_s * chip.clock_hz)
        return program_player.predict_pulses(replica, ops, 1 << axis.index, axis.chip_axis, until) != distance

    def read_outcomes(
        self, played: PlayedPrograms, truth: np.ndarray, distance: np.ndarray, count: float = 1.0
    ) -> MoveOutcomes:
        """Read the outcomes of moves from programs that were played.

        Args:
            played: Results of the programs of `make_program`.
            truth: True state of this axis after its program, (n,).
            distance: Signed distances of the moves, pulses, (n,).
            count: Travel of one encoder count, m.
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
