"""`stage/FewShotTuning-v1`: several attempts at one move on a machine that the host does not know, then a proof of the best one.

An episode is one machine and one distance. The machine (payload, friction, supply, current of the drive, core loss and
inductance of the motor, place and drift of ORG) is hidden and stays the same for all attempts, so a host that remembers its
attempts has an advantage. Each attempt is a whole move from power-up, from the place where ORG trips. After the last attempt,
the best one that kept step is repeated `proofs` times with `margin` kg more payload. If one of these moves fails, the next best
attempt is proved, and so on; the best attempt that passes counts. The task thus remembers for the host, which may try several
moves without reading any result. With answer="last", only the last attempt is proved: a host has to remember what its attempts
have shown.

action        Box [-1, 1]^4, the same for every chip: start rate, drive rate, seconds of ramp-up and ramp-down, each by its
              logarithm over ACTION_RANGES. Ramps that do not fit into the move are shortened with the same slope. The chip's
              formulas compute its registers.
observation   float32, -1 to 1, only what a host can know (truth=True adds the context at the end):
              distance, by its logarithm; attempts left / tries; time of the best attempt that kept step by the encoder / twice
              the usual time, 1 before there is one; then for each attempt (memory="all") or for the last one (memory="last"), 0
              before it:
              the four actions; 1; duration / twice the usual time; 1 if it made its pulses; 1 if it kept step by the encoder;
              swing / (swing + 0.1 mm). With encoder=False the last two are 0: the host then only knows the pulses.
reward        the sum of
              gain     log(best cost before / best cost now). The cost of an attempt that kept step is its seconds, plus
                       vibration_weight s for each 0.1 mm of vibration; before the first attempt it is two usual times. With
                       answer="last", the costs of the last attempt and of the one before it count, each at most two usual times
              damage   - damage_weight if a step was lost, or an end limit hit
              proof    after the last attempt: minus what was gained by attempts that fail in the proof
              deposit  minus the value of a move at the highest drive rate from start to stop, which no attempt reaches: charged
                       with the first attempt, and given back with the proof. A player that leaves an episode before its proof
                       (TimeLimit) therefore keeps nothing of gains that no proof has confirmed
              Without damage, the sum of an episode is log(2 x usual time / cost of the best proved attempt), or 0.
              The usual time is that of the driver's usual speeds (1000 to 16,000 pps in 0.15 s), which every machine here can do.
episode       `tries` attempts, then terminated.
score         time: s, the proved cost. formula: the engineer's (stage.tune.formula) for the split's heaviest payload, closed form.
split         where machines come from, see machine_contexts.py; a setting that is not None overrides the split's.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np

from stage import Stage
from stage.envs import machine_contexts
from stage.envs.hidden_machine_task import MachineSettings, MachineTask
from stage.envs.move_trials import DISPLACEMENT_SCALE_M, MAX_OFFSET_M, MoveTrial, compute_move_time
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.scaling import scale_log
from stage.envs.settings import (
    AxisName,
    Boolean,
    ChoiceSetting,
    Count,
    CountRange,
    NumberSetting,
    Seconds,
    Weight,
    read_number_option,
)
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.step_results import SCORE_FEATURE, write_scores
from stage.firmware.driver import Speeds, get_driver
from stage.sim.fleet import Fleet, PlayedPrograms
from stage.sim.payload_and_judged_point import find_judged_point
from stage.sim.program import Program
from stage.support import portable_math
from stage.tune.formula import Load, compute_speeds

ACTION_RANGES = {"start": (200.0, 6000.0), "drive": (2000.0, 60_000.0), "up": (0.01, 0.3), "down": (0.01, 0.3)}
"""Ranges of the actions: rates in pps, ramps in s."""
ENCODER_COUNT_M = 5e-6
MIN_RAMP_S = 2e-3
MEMORIES = ("all", "last")
ANSWERS = ("best", "last")
FEATURES_PER_ATTEMPT = 9  # numbers of an observation that describe one attempt


@dataclass(frozen=True)
class Config(MachineSettings):
    """Settings of FewShotTuning, in addition to those of `MachineSettings`.

    Attributes:
        axis: Name of the axis.
        reduced: Whether the other axes are locked and left out of the physics, see reduced_model.py.
        distances: Smallest and largest distance, pulses, drawn evenly by their logarithm.
        judge_at: Site or body at which vibration is observed; None: see `find_judged_point`.
        tries: Number of attempts in an episode.
        proofs: Number of moves that prove an attempt.
        margin: Mass that the moves of a proof have beyond the payload, kg.
        encoder: Whether the host reads an encoder on the carriage after each attempt.
        memory: "all": an observation has every attempt; "last": only the last one.
        answer: "best": the best attempt is proved; "last": the last one.
        settle: Simulated time after the stop in which vibration and swing are observed, s.
        damage_weight: Cost of an attempt that loses a step or hits an end limit.
        vibration_weight: Cost of 0.1 mm of vibration, s.
    """

    axis: AxisName = "x"
    reduced: Boolean = False
    distances: CountRange = (1600, 16_000)
    judge_at: AxisName | None = None
    tries: Count = 8
    proofs: Annotated[int, NumberSetting(low=0, high=64, integer=True)] = 4
    margin: Annotated[float, NumberSetting(high=1e3)] = 0.5
    encoder: Boolean = True
    memory: Annotated[str, ChoiceSetting(MEMORIES)] = "all"
    answer: Annotated[str, ChoiceSetting(ANSWERS)] = "best"
    settle: Seconds = 0.1
    damage_weight: Weight = 0.05
    vibration_weight: Weight = 0.02


def make_action(start: float, drive: float, up: float, down: float) -> np.ndarray:
    """Return the action that stands for these rates and ramps of a move. A value out of ACTION_RANGES counts as its end.

    Args:
        start: Start rate, pps.
        drive: Drive rate, pps.
        up: Duration of the ramp up, s.
        down: Duration of the ramp down, s.

    Returns:
        Action, (4,) float32.
    """
    low, high = portable_math.log(np.array(list(ACTION_RANGES.values()))).T
    return np.clip(2 * (portable_math.log((start, drive, up, down)) - low) / (high - low) - 1, -1, 1).astype(np.float32)


class FewShotTuning(MachineTask[Config]):
    """Rules of stage/FewShotTuning-v1. The module docstring states them."""

    Config: ClassVar[type] = Config
    OPTIONS: ClassVar[tuple[str, ...]] = ("distance", *machine_contexts.RESET_OPTION_NAMES)
    """Options of a reset, which replace drawn values of the move and the machine."""
    PARTS = ("gain", "damage", "proof", "deposit")
    STATE: ClassVar[tuple[str, ...]] = (
        "distance",
        "context",
        "angle",
        "table",
        "best_time",
        "cost",
        "rows",
        "formula",
        "damage",
    )
    RESTARTS = True
    OBSERVATION: ClassVar[tuple[Feature, ...]] = (
        Feature("distance", HOST, "distance of the move, by its logarithm from -1 to 1 over `distances`"),
        Feature("left", HOST, "attempts left / `tries`"),
        Feature(
            "best",
            HOST,
            "time of the best attempt that kept step by the encoder / twice the usual time; 1 before there is one",
        ),
        *(
            Feature(f"tried_{name}", HOST, "rate or ramp of this attempt, from -1 to 1", "try")
            for name in ACTION_RANGES
        ),
        Feature("tried", HOST, "1 if this attempt was made", "try"),
        Feature("duration", HOST, "duration / twice the usual time", "try"),
        Feature("finished", HOST, "1 if it made its pulses", "try"),
        Feature("kept", HOST, "1 if it kept step by the encoder; 0 without an encoder", "try"),
        Feature(
            "swing", HOST, "swing after the stop by the encoder: swing / (swing + 0.1 mm); 0 without an encoder", "try"
        ),
        *machine_contexts.OBSERVATION_FEATURES,
    )
    INFO: ClassVar[tuple[Feature, ...]] = (
        Feature("distance", HOST, "pulses", kind=int),
        *machine_contexts.INFO_FEATURES,
        Feature("registers", HOST, "registers that the chip's formulas compute from the action", kind=int),
        Feature("duration", HOST, "s", kind=float),
        Feature("usual", HOST, "s, time of the usual speeds", kind=float),
        Feature("finished", HOST, "the move made its pulses", kind=bool),
        Feature(
            "error",
            HOST,
            "counts by which the encoder differs from the pulses after the stop; 0 without an encoder",
            kind=float,
        ),
        Feature("lost_steps", TRUTH, "full steps", kind=int),
        Feature("vibration", TRUTH, "m, travel of the judged point after the stop", kind=float),
        Feature("kept", TRUTH, "made its pulses and lost no step", kind=bool),
        Feature(
            "best",
            TRUTH,
            "s, time of the best attempt so far that kept step, with its vibration; infinite before there is one",
            kind=float,
        ),
        Feature(
            "proved",
            TRUTH,
            "s, the same of the best attempt that passed the proof after the last one; infinite if none did, and before",
            kind=float,
        ),
        SCORE_FEATURE,
    )

    def make_spaces_and_arrays(self) -> None:
        c, n, first = self.config, self.n, self.stages[0]
        self.axis = first.axes[c.axis]
        self.driver = get_driver(self.axis)
        self.judged, point = find_judged_point(first, c.axis, c.judge_at)
        self.trial = MoveTrial(self.axis, point, c.settle, encoder=True)
        self.prepare_contexts()
        self.trial.require_room(c.distances, "pulses")
        self.names = self.driver.list_move_registers(s_curve=False)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(ACTION_RANGES),), np.float32)
        self.observation_space = self.make_observation_space()
        self.shapes = {"registers": (len(self.names),)}
        self.distance, self.angle = np.ones(n, np.int64), np.zeros(n)
        self.table = np.zeros((n, c.tries, FEATURES_PER_ATTEMPT))
        self.best_time, self.cost = np.full(n, np.inf), np.full((n, c.tries), np.inf)
        self.rows = np.zeros((n, c.tries, len(self.names)), np.int64)
        self.load = Load.from_axis(self.axis)
        self.formula, self.damage = np.ones((n, 5)), np.zeros((n, 2), np.int64)
        self.proof_fleet = Fleet([copy.deepcopy(first) for _ in range(n)], self.fleet.threads)

    def list_all_features(self) -> list[Feature]:
        tries = self.config.tries if self.config.memory == "all" else 1
        return [
            *self.OBSERVATION[:3],
            *self.OBSERVATION[3 : 3 + FEATURES_PER_ATTEMPT] * tries,
            *self.OBSERVATION[3 + FEATURES_PER_ATTEMPT :],
        ]

    # --- machines ---

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        c, rng = self.config, self.rngs[stage_index]
        distance = int(np.rint(portable_math.exp(rng.uniform(*portable_math.log(c.distances)))))
        self.distance[stage_index] = read_number_option(options, "distance", distance, c.distances)
        self.draw_machine(stage_index, options)
        self.table[stage_index], self.best_time[stage_index], self.cost[stage_index], self.damage[stage_index] = (
            0.0,
            np.inf,
            np.inf,
            0,
        )
        self._compute_formula_move(stage_index, rng, options)
        self._place_for_next_attempt(stage_index)

    def _compute_formula_move(self, stage_index: int, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Compute the move of the engineer's formula for one stage, for a host that only knows the split's heaviest payload.

        Args:
            stage_index: Index of the stage.
            rng: Random generator of the stage; not used here, but by subclasses.
            options: Options of the reset.
        """
        self._store_formula_move(stage_index, self.ranges["payload"][1])

    def _store_formula_move(self, stage_index: int, payload: float) -> None:
        """Compute and store the rates and ramps of the engineer's formula for a payload, kg, and the duration of that move."""
        move, distance = (
            compute_speeds(self.load.add_mass(payload), int(self.distance[stage_index])),
            int(self.distance[stage_index]),
        )
        rate = self.decode_action(make_action(*move[:4]), distance)
        start, top, up, down = rate
        took = up + down + (distance - (up + down) * (start + top) / 2) / top
        self.formula[stage_index] = *rate, took

    def scripted_action(self) -> np.ndarray:
        """Return the actions of the engineer's formula (stage.tune.formula), the same for every attempt."""
        return np.stack([make_action(*row[:4]) for row in self.formula])

    def prepare_next_step(self) -> None:
        for k in np.flatnonzero(self.undiverged_stages & ~self.results["terminated"]):
            self._place_for_next_attempt(int(k))

    def _place_for_next_attempt(self, stage_index: int) -> None:
        """Place the carriage of a stage for its next attempt, where ORG trips this time."""
        self.angle[stage_index] = self._draw_origin_angle(stage_index)
        self._place_carriages(self.stages[stage_index], stage_index, float(self.angle[stage_index]))

    def _draw_origin_angle(self, stage_index: int) -> float:
        """Draw the angle of the rotor at which ORG trips in the next attempt, in electrical turns from 0 to 1."""
        return float(
            (
                self.context[stage_index]["switch"]
                + self.context[stage_index]["drift"] * self.rngs[stage_index].uniform(-1, 1)
            )
            % 1.0
        )

    def _place_carriages(self, stage: Stage, stage_index: int, angle: float, extra_payload_kg: float = 0.0) -> None:
        """Put a stage at power-up, with the machine of a stage's episode and the carriage at the start of its move.

        Args:
            stage: Stage to change.
            stage_index: Index of the stage whose machine and move it gets.
            angle: Angle of the rotor at the start, electrical turns from 0 to 1.
            extra_payload_kg: Mass beyond the payload, kg.
        """
        stage.restore(self.start)
        self.apply_machine_to(stage, stage_index, extra_payload_kg)
        stage.place(**{self.config.axis: self.trial.find_start(float(self.distance[stage_index]), angle)})

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {"distance": int(self.distance[stage_index]), **self.describe_machine(stage_index)}

    # --- tries ---

    @property
    def usual_times_s(self) -> np.ndarray:
        """Duration of each stage's move with the default rates and ramps of `Speeds()`, s, (n,), in closed form."""
        return compute_move_time(self.distance, Speeds().start, Speeds().drive, Speeds().up)

    def decode_action(self, action: np.ndarray, distance: int) -> tuple[float, float, float, float]:
        """Compute the rates and ramp times that an action stands for.

        If the ramps do not fit into the move, the top rate and the ramp times are reduced until they do.

        Args:
            action: Action, (4,), from -1 to 1.
            distance: Distance of the move, pulses.

        Returns:
            Start rate and top rate, pps; durations of the ramp up and the ramp down, s.
        """
        low, high = portable_math.log(np.array(list(ACTION_RANGES.values()))).T
        start, drive, up, down = portable_math.exp(
            low + (high - low) * (np.asarray(action, np.float64) + 1) / 2
        ).tolist()
        drive = max(drive, 1.05 * start)
        flat = (up + down) / (drive - start)  # duration of both ramps for each pps of rate change, s2 a pulse
        top = min(drive, float(np.sqrt(start**2 + 2 * distance / flat)))
        shorter = (top - start) / (drive - start)
        return start, top, max(up * shorter, MIN_RAMP_S), max(down * shorter, MIN_RAMP_S)

    def to_registers(self, actions: np.ndarray) -> np.ndarray:
        """Compute the registers of the moves that actions stand for, by the formulas of the chip; shape (stages, registers)."""
        rows = []
        for action, distance in zip(actions, self.distance.tolist(), strict=True):
            values = self.driver.compute_move_registers(*self.decode_action(action, distance), distance, s_curve=False)
            rows.append([values[name] for name in self.names])
        return np.array(rows, np.int64)

    def _compute_answer_value(self, attempts: np.ndarray) -> np.ndarray:
        """Compute the value of the answer of each stage, (n,), after `attempts` attempts on it, (n,)."""
        return self._compute_value(self._get_answer_costs(attempts).min(axis=1))

    def _get_answer_costs(self, attempts: np.ndarray) -> np.ndarray:
        """Return the costs of the attempts that can be the answer, (n, tries); infinite for all other attempts."""
        at = np.arange(self.config.tries)
        is_answer = at < attempts[:, None] if self.config.answer == "best" else at == attempts[:, None] - 1
        return np.where(is_answer, self.cost, np.inf)

    def _compute_value(self, cost: np.ndarray) -> np.ndarray:
        """Compute the value of a move from its cost: log(two usual times / cost); 0 for a cost above two usual times."""
        return np.maximum(portable_math.log(2 * self.usual_times_s) - portable_math.log(cost), 0.0)

    @property
    def _deposit(self) -> np.ndarray:
        """Largest value that a move of each stage can have, (n,): it makes all its pulses at the highest drive rate."""
        return self._compute_value(self.distance / ACTION_RANGES["drive"][1])

    def make_programs(self) -> list[Program]:
        return self._make_programs_from_registers(self.to_registers(self.actions))

    def _make_programs_from_registers(self, rows: np.ndarray) -> list[Program]:
        """Make the program of a move for each stage's row of registers, (stages, registers)."""
        limits = (2 * self.usual_times_s).tolist()
        columns = zip(rows.tolist(), self.distance.tolist(), limits, strict=True)
        return [self.trial.make_program(dict(zip(self.names, row, strict=True)), d, limit) for row, d, limit in columns]

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c, t, usual = self.config, truth[:, self.axis.index], self.usual_times_s
        outcome = self.trial.read_outcomes(played, t, self.distance, ENCODER_COUNT_M)
        good = self.undiverged_stages
        cost = outcome.duration + c.vibration_weight * outcome.vibration / DISPLACEMENT_SCALE_M
        rows, indices = self.to_registers(self.actions), np.flatnonzero(good)
        before = self._compute_answer_value(self.steps - 1)
        self.cost[indices, self.steps[indices] - 1] = np.where(outcome.in_step, cost, np.inf)[indices]
        self.rows[indices, self.steps[indices] - 1] = rows[indices]
        gain, last = self._compute_answer_value(self.steps) - before, self.steps >= c.tries
        proved = self._find_best_proved_cost(good & last)
        parts = {
            "gain": gain,
            "damage": np.where(outcome.lost | outcome.stopped, -c.damage_weight, 0.0),
            "proof": np.where(good & last, self._compute_value(proved) - self._compute_answer_value(self.steps), 0.0),
            "deposit": np.where(last, self._deposit, 0.0) - np.where(self.steps == 1, self._deposit, 0.0),
        }
        error = outcome.error * c.encoder
        by_encoder = outcome.finished & (np.abs(error) * ENCODER_COUNT_M <= MAX_OFFSET_M + ENCODER_COUNT_M) & c.encoder
        row = [
            outcome.duration / (2 * usual),
            outcome.finished,
            by_encoder,
            c.encoder * outcome.swing / (outcome.swing + DISPLACEMENT_SCALE_M),
        ]
        tried = np.concatenate([self.actions, np.ones((self.n, 1)), np.stack(row, axis=1)], axis=1)
        self.table[indices, self.steps[indices] - 1] = np.clip(np.nan_to_num(tried[indices]), -1.0, 1.0)
        faster = good & by_encoder & (outcome.duration < self.best_time)
        self.best_time[faster] = outcome.duration[faster]
        info = {
            "distance": self.distance, **self.machine_info, "registers": rows,
            "duration": outcome.duration, "usual": usual, "finished": outcome.finished, "error": error,
            "lost_steps": t["lost_steps"], "vibration": outcome.vibration, "kept": outcome.in_step,
            "best": self.cost.min(axis=1), "proved": proved,
        }  # fmt: skip
        self.damage[good] += np.stack([np.abs(t["lost_steps"]), outcome.stopped], axis=1)[good]
        self.set_results(parts, info, last, False)
        write_scores(self.results["score"], proved, self.formula[:, 4], self.steps, *self.damage.T)

    def _find_best_proved_cost(self, stage_mask: np.ndarray) -> np.ndarray:
        """Prove the attempts of each stage, the best first, until one passes.

        Args:
            stage_mask: Mask of the stages whose attempts are proved, (n,).

        Returns:
            Lowest cost that passed its proof, (n,); infinite for stages without one.
        """
        proved, left, every = np.full(self.n, np.inf), stage_mask.copy(), np.arange(self.n)
        costs = self._get_answer_costs(self.steps)
        order = np.argsort(costs, axis=1, kind="stable")
        for at in order.T:
            cost = costs[every, at]
            left &= np.isfinite(cost)
            if not left.any():
                break
            proved_now = self._prove_moves(left, self.rows[every, at])
            proved[proved_now] = cost[proved_now]
            left &= ~proved_now
        return proved

    def _prove_moves(self, stage_mask: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Repeat a move `proofs` times on each stage, with `margin` kg more payload and from other angles of the rotor.

        Args:
            stage_mask: Mask of the stages that move, (n,).
            rows: Registers of the moves, (n, registers).

        Returns:
            Mask of the stages that kept step in all these moves, (n,).
        """
        c, holds = self.config, stage_mask.copy()
        programs = self._make_programs_from_registers(
            np.where(stage_mask[:, None], rows, self.to_registers(self.actions))
        )
        for _ in range(c.proofs):
            if not holds.any():
                break
            for k in np.flatnonzero(holds).tolist():
                self._place_carriages(self.proof_fleet.stages[k], k, self._draw_origin_angle(k), c.margin)
            played = self.proof_fleet.play([p if on else Program() for p, on in zip(programs, holds, strict=True)])
            t = self.proof_fleet.truth()[:, self.axis.index]
            holds &= self.trial.read_outcomes(played, t, self.distance, ENCODER_COUNT_M).in_step & ~played.diverged
        return holds

    def compute_observations(self) -> np.ndarray:
        c, n = self.config, self.n
        scaled_distance = scale_log(self.distance, c.distances)
        table = self.table
        if c.memory == "last":
            table = table[np.arange(n), np.maximum(self.steps - 1, 0)]
        best = np.minimum(self.best_time / (2 * self.usual_times_s), 1.0)
        columns = [
            np.stack([scaled_distance, 1.0 - self.steps / c.tries, best], axis=1),
            table.reshape(n, -1),
            self.machine_features,
        ]
        return np.clip(np.concatenate(columns, axis=1), -1.0, 1.0).astype(np.float32)

    def close(self) -> None:
        super().close()
        self.proof_fleet.close()


class FewShotTuningEnv(StageEnv):
    """Gymnasium environment stage/FewShotTuning-v1: tune one move in several attempts on a machine that is not known."""

    task = FewShotTuning


class FewShotTuningVectorEnv(StageVectorEnv):
    """Vector environment stage/FewShotTuning-v1: tune one move in several attempts on machines that are not known."""

    task = FewShotTuning
