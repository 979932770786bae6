"""`stage/ServoTuning-v0`: choose an HCTL-1100's digital filter and sample time for one move of a servo axis after the other.

A step is one whole move of a random distance with a random payload on the table: the host writes registers and commands a
position step or a trapezoid, and physics decides the outcome. Each move starts at rest from power-up at the same position, so
steps are independent of each other.

action        Box [-1, 1]^4: R22 gain, R20 zero, R21 pole, R0F T, see register_scaling.py; with actions="registers" the integers
              themselves, MultiDiscrete. Gain and T are spread by their logarithm.
observation   float32, the task and the result of the last move:
              0 distance, -1 to 1 over its range    1 payload, -1 to 1    2 last settling time / limit
              3 last overshoot / (last + 10 counts)    4 last unrest / (last + 10 counts)    5 last move settled
reward        the sum of
              time       - settling time / 1 s: from the start until the carriage stays within the deadband
              overshoot  - overshoot_weight x largest distance beyond the goal / distance of the move, at most 1
              unrest     - unrest_weight x peak-to-peak travel in the last `rest` seconds / 100 counts, at most 10
              limit      - limit_weight if the carriage did not settle: it left the deadband in the last `rest` s before `limit`
episode       `moves` moves, then truncated.

The host writes the whole command in Init/Idle mode, so no command falls into the unsafe part of a sample. The registers hold the
rates of a trapezoid in counts per sample. The host converts them for the T that the action chose, and rounds them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from stage.chips import Chip
from stage.envs import settings
from stage.envs.observation_features import HOST, Feature
from stage.envs.register_scaling import RegisterBox
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.tuning_task import NEXT_MOVE_FEATURES, TuningTask, make_move_info_features
from stage.errors import ArgumentError
from stage.firmware.driver import get_driver
from stage.sim.fleet import PlayedPrograms
from stage.sim.program import Program

MOTIONS = ("step", "trapezoid")
SAMPLE_INTERVAL_S = 1e-3
"""Time between two samples of the carriage's position."""
SMALL, UNREST_SCALE = 10.0, 100.0
"""Counts that scale to 1/2 in an observation, and counts of unrest that cost unrest_weight."""


@dataclass(frozen=True)
class Config(settings.Settings):
    """Settings of ServoTuning.

    Attributes:
        model: Name of the model.
        chip: Name or class of the chip.
        axis: Name of the axis.
        reduced: Whether the other axes are locked and left out of the physics, see reduced_model.py.
        motion: "step" for position steps, "trapezoid" for trapezoidal profiles.
        actions: "box": numbers from -1 to 1; "registers": the integers themselves.
        distances: Smallest and largest distance, counts, drawn evenly by their logarithm; trapezoids need longer distances.
        payloads: Smallest and largest payload, kg, drawn evenly.
        payload_on: Body that carries the payload, or a site on it; None: see `find_payload_body`.
        moves: Number of moves in an episode.
        velocity: Velocity of a trapezoid, counts/s.
        acceleration: Acceleration of a trapezoid, counts/s2.
        deadband: Distance from the goal within which the carriage counts as settled, counts.
        limit: Simulated time of a move, s.
        rest: Simulated time at the end of `limit` in which unrest is observed, s.
        overshoot_weight: Cost of an overshoot as large as the distance.
        unrest_weight: Cost of an unrest of 100 counts.
        limit_weight: Cost of a move that does not settle.
        bus_cycle: Duration of a bus cycle, s.
        truth: Whether observation and info have values that no host can know: True (both), "info" (info alone), False (neither).
    """

    model: str = "xyz_servo"
    chip: str | type[Chip] = "HCTL1100"
    axis: settings.AxisName = "x"
    reduced: settings.Boolean = False
    motion: Annotated[str, settings.ChoiceSetting(MOTIONS)] = "step"
    actions: settings.ActionKind = "box"
    distances: settings.CountRange = (50, 500)
    payloads: settings.PayloadRange = (0.0, 10.0)
    payload_on: settings.AxisName | None = None
    moves: settings.Count = 8
    velocity: settings.PositiveNumber = 40_000.0
    acceleration: settings.PositiveNumber = 400_000.0
    deadband: settings.PositiveNumber = 3.0
    limit: settings.Seconds = 0.5
    rest: Annotated[float, settings.NumberSetting(SAMPLE_INTERVAL_S, high=settings.MAX_SECONDS)] = 0.1
    overshoot_weight: settings.Weight = 0.2
    unrest_weight: settings.Weight = 0.2
    limit_weight: settings.Weight = 1.0
    bus_cycle: settings.BusCycleSeconds = 1e-6
    truth: settings.TruthOption = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.rest < self.limit:
            raise ArgumentError(f"rest={self.rest!r}: a part of limit={self.limit!r}.")


class ServoTuning(TuningTask[Config]):
    """Rules of stage/ServoTuning-v0. The module docstring states them."""

    Config = Config
    STATE = (*TuningTask.STATE, "goal")
    PARTS = ("time", "overshoot", "unrest", "limit")
    UNIT = "counts"
    OBSERVATION = (
        *NEXT_MOVE_FEATURES,
        Feature("last_settled", HOST, "settling time / `limit`"),
        Feature("last_overshoot", HOST, "overshoot / (overshoot + 10 counts)"),
        Feature("last_unrest", HOST, "unrest / (unrest + 10 counts)"),
        Feature("last_finished", HOST, "1 if it settled"),
    )
    INFO = (
        Feature("settled", HOST, "s, until it stays within the deadband", kind=float),
        Feature("overshoot", HOST, "whole counts, the farthest beyond the goal", kind=float),
        Feature("unrest", HOST, "whole counts, peak to peak in the last `rest` seconds", kind=float),
        Feature("error", HOST, "whole counts, at the end", kind=float),
        Feature("finished", HOST, "it settled", kind=bool),
        *make_move_info_features("counts", "count of the encoder"),
    )

    def make_register_box(self) -> RegisterBox:
        self.driver = get_driver(self.axis)
        ranges = self.driver.get_filter_ranges(self.config.motion == "trapezoid").ranges
        return RegisterBox(list(ranges), ranges.values())

    def make_spaces_and_arrays(self) -> None:
        c = self.config
        self.samples, self.tail = round(c.limit / SAMPLE_INTERVAL_S), round(c.rest / SAMPLE_INTERVAL_S)
        super().make_spaces_and_arrays()
        self.goal = np.zeros(self.n)  # absolute position, counts of the encoder

    def prepare_placed_move(self, stage_index: int) -> None:
        chip: Any = self.stages[stage_index].axes[self.config.axis].chip
        self.goal[stage_index] = chip.encoder + self.distance[stage_index]

    def make_program(self, row: np.ndarray, distance: int) -> Program:
        """Make the host's bus cycles for one move, followed by samples of the carriage's position every SAMPLE_INTERVAL_S."""
        c, p = self.config, Program()
        rates = (c.velocity, c.acceleration) if c.motion == "trapezoid" else None
        self.driver.write_servo_move(p, self.registers.to_dict(row), distance, rates)
        self.first = len(p)  # index of the first pair of a wait and a sample
        for k in range(self.samples):
            (p.measure if k >= self.samples - self.tail else p.wait)(SAMPLE_INTERVAL_S)
            p.sample_position(self.axis.index)
        return p

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c = self.config
        samples = played.results[:, self.first + 1 : self.first + 2 * self.samples : 2] * 1e-12
        sign = np.sign(self.axis.gear)
        error = self.goal[:, None] - sign * samples / self.axis.meters_per_pulse  # counts
        # extremes of the rest, over all physics steps
        ends = played.extremes[:, self.axis.plant.qpos] * (sign / self.axis.meters_per_pulse)
        ends = np.where(np.isfinite(ends), self.goal[:, None] - ends, np.inf)
        outside = np.abs(error) > c.deadband
        # samples up to the last one outside the deadband
        settled_at = self.samples - np.argmax(outside[:, ::-1], axis=1)
        finished = (np.abs(ends) <= c.deadband).all(axis=1) & ~outside[:, -1]
        settled = np.where(finished, np.where(outside.any(axis=1), settled_at, 0), self.samples) * SAMPLE_INTERVAL_S
        overshoot = np.maximum(-error.min(axis=1), 0.0)
        unrest = np.abs(ends[:, 0] - ends[:, 1])
        parts = {
            "time": -settled,
            "overshoot": -c.overshoot_weight * np.minimum(overshoot / self.distance, 1.0),
            "unrest": -c.unrest_weight * np.minimum(unrest / UNREST_SCALE, 10.0),
            "limit": np.where(finished, 0.0, -c.limit_weight),
        }
        # whole counts, as an encoder has them
        overshoot, unrest, last = (np.rint(counts) for counts in (overshoot, unrest, error[:, -1]))
        info = {"settled": settled, "overshoot": overshoot, "unrest": unrest, "error": last, "finished": finished}
        shares = overshoot / (overshoot + SMALL), unrest / (unrest + SMALL)
        self.set_move_results(parts, info, np.stack([settled / c.limit, *shares, finished * 1.0], axis=1))


class ServoTuningEnv(StageEnv):
    """Gymnasium environment stage/ServoTuning-v0: choose the digital filter of a servo axis for one move after the other."""

    task = ServoTuning


class ServoTuningVectorEnv(StageVectorEnv):
    """Vector environment stage/ServoTuning-v0: choose the digital filter of a servo axis for one move after the other."""

    task = ServoTuning
