"""`stage/RegisterTuning-v0`: choose a chip's registers for one move after the other.

A step is one whole move of a random distance with a random payload on the table: the host writes registers and a start command,
and physics decides the outcome. Each move starts at rest from the same position, so steps are independent of each other. The
host uses the driver of the chip, see stage/firmware/driver.py.

action        Box [-1, 1]^n, see register_scaling.py; with actions="registers" the integers themselves, MultiDiscrete.
              PCL-240: R1 FL, R2 FH1, R4, R5 rates, R6 ramp-down point, R7 multiplier; with S-curves R14 and R15, their spans
              MCX514: SV, DV, AC; with S-curves JK        MCX304, MCX302, MCX312: SV, V, A; with S-curves K; R is 400,000
observation   float32, the task and the result of the last move:
              0 distance, -1 to 1 over its range    1 payload, -1 to 1    2 last duration / limit
              3 last move: steps lost (0 or 1)      4 last vibration / (last + 0.1 mm)    5 last move made all its pulses
reward        the sum of
              time       - duration / 1 s, from the start command to the stop (at most the limit)
              lost       - lost_weight if a full step was lost, or if the carriage is not where the pulse count says
              vibration  - vibration_weight x travel of the judged point within `settle` after the stop / 0.1 mm
              limit      - limit_weight if the move did not make its pulses: an end limit, or the time limit
episode       `moves` moves, then truncated.
early_ends    With early_ends=True, a move that fails costs the time of the limit and ends at once. A move whose pulses the chip
              cannot make within the limit is not made at all; a move that loses a step ends there, and its vibration is 0.
judge_at      Name of a site or body that the axis carries, whose travel after the stop is the vibration. None: of the sites tool,
              camera and work, the first that can swing (a camera on a mast), else the first that exists; in a model without
              these sites, the axis itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stage.chips import Chip
from stage.envs import settings
from stage.envs.move_trials import DISPLACEMENT_SCALE_M, MoveTrial
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.register_scaling import RegisterBox
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.tuning_task import NEXT_MOVE_FEATURES, TuningTask, make_move_info_features
from stage.sim.fleet import PlayedPrograms
from stage.sim.payload_and_judged_point import find_judged_point
from stage.sim.program import END, Program


@dataclass(frozen=True)
class Config(settings.Settings):
    """Settings of RegisterTuning.

    Attributes:
        model: Name of the model.
        chip: Name or class of the chip.
        s_curve: Whether moves have S-curves; None: only on a PCL240MS.
        axis: Name of the axis.
        reduced: Whether the other axes are locked and left out of the physics, see reduced_model.py.
        actions: "box": numbers from -1 to 1; "registers": the integers themselves.
        distances: Smallest and largest distance, pulses, drawn evenly by their logarithm.
        payloads: Smallest and largest payload, kg, drawn evenly.
        payload_on: Body that carries the payload, or a site on it; None: see `find_payload_body`.
        judge_at: Site or body at which vibration is observed; None: see `find_judged_point`.
        moves: Number of moves in an episode.
        limit: Longest simulated time of a move, s.
        settle: Simulated time after the stop in which vibration is observed, s.
        lost_weight: Cost of a move that loses a full step.
        vibration_weight: Cost of 0.1 mm of vibration.
        limit_weight: Cost of a move that does not make all its pulses.
        bus_cycle: Duration of a bus cycle, s.
        early_ends: Whether moves end as soon as they have failed, which allows many more moves a second.
        truth: Whether observation and info have values that no host can know: True (both), "info" (info alone), False (neither).
    """

    model: str = "xyz"
    chip: str | type[Chip] = "PCL240K"
    s_curve: settings.Boolean | None = None
    axis: settings.AxisName = "x"
    reduced: settings.Boolean = False
    actions: settings.ActionKind = "box"
    distances: settings.CountRange = (1600, 32000)
    payloads: settings.PayloadRange = (0.0, 10.0)
    payload_on: settings.AxisName | None = None
    judge_at: settings.AxisName | None = None
    moves: settings.Count = 8
    limit: settings.Seconds = 4.0
    settle: settings.Seconds = 0.1
    lost_weight: settings.Weight = 5.0
    vibration_weight: settings.Weight = 0.1
    limit_weight: settings.Weight = 5.0
    bus_cycle: settings.BusCycleSeconds = 1e-6
    early_ends: settings.Boolean = False
    truth: settings.TruthOption = True


class RegisterTuning(TuningTask[Config]):
    """Rules of stage/RegisterTuning-v0. The module docstring states them."""

    Config = Config
    PARTS = ("time", "lost", "vibration", "limit")
    UNIT = "pulses"
    OBSERVATION = (
        *NEXT_MOVE_FEATURES,
        Feature("last_duration", HOST, "duration / `limit`"),
        Feature("last_lost", TRUTH, "1 if steps were lost"),
        Feature("last_vibration", TRUTH, "vibration / (vibration + 0.1 mm)"),
        Feature("last_finished", HOST, "1 if it made all its pulses, by the chip's counter"),
    )
    INFO = (
        Feature("duration", HOST, "s, from the start command to the stop", kind=float),
        Feature("lost_steps", TRUTH, "full steps", kind=int),
        Feature("vibration", TRUTH, "m, travel of the judged point after the stop", kind=float),
        Feature("finished", HOST, "the move made all its pulses", kind=bool),
        *make_move_info_features("pulses", "electrical turn of the motor"),
    )

    def make_register_box(self) -> RegisterBox:
        return RegisterBox.of_registers(self.axis.chip.MAP, self.trial.driver.list_move_registers(self.config.s_curve))

    def make_spaces_and_arrays(self) -> None:
        c, first = self.config, self.stages[0]
        self.judged, self.point = find_judged_point(first, c.axis, c.judge_at)
        self.trial = MoveTrial(first.axes[c.axis], self.point, c.settle)
        super().make_spaces_and_arrays()

    def make_program(self, row: np.ndarray, distance: int) -> Program:
        c = self.config
        program = self.trial.make_program(self.registers.to_dict(row), distance, c.limit, end_on_lost_step=c.early_ends)
        if c.early_ends and self.trial.exceeds_timeout(program, distance, c.limit):
            program.ops[0] = (END, 0, 0, 0)
        return program

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c, t = self.config, truth[:, self.axis.index]
        duration, finished, _, lost, vibration, *_ = self.trial.read_outcomes(played, t, self.distance)
        if c.early_ends:
            duration = np.where(finished & ~lost, duration, c.limit)
        parts = {
            "time": -duration,
            "lost": np.where(lost, -c.lost_weight, 0.0),
            "vibration": -c.vibration_weight * np.minimum(vibration / DISPLACEMENT_SCALE_M, 100.0),
            "limit": np.where(finished, 0.0, -c.limit_weight),
        }
        info = {"duration": duration, "lost_steps": t["lost_steps"], "vibration": vibration, "finished": finished}
        now = np.stack(
            [duration / c.limit, lost * 1.0, vibration / (vibration + DISPLACEMENT_SCALE_M), finished * 1.0], axis=1
        )
        self.set_move_results(parts, info, now)


class RegisterTuningEnv(StageEnv):
    """Gymnasium environment stage/RegisterTuning-v0: choose a chip's registers for one move after the other."""

    task = RegisterTuning


class RegisterTuningVectorEnv(StageVectorEnv):
    """Vector environment stage/RegisterTuning-v0: choose a chip's registers for one move after the other."""

    task = RegisterTuning
