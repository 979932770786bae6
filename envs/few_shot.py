"""`stage/FewShotTuning-v1`: several tries at one move on a machine that the host does not know, then a proof of the best try.

An episode is one machine and one distance. What the machine is (payload, friction, supply, current of the drive, core loss and
inductance of the motor, place and drift of ORG) is hidden, and stays the same for all tries: what a try has shown counts for
the next, so memory pays. Each try is a whole move from power-up, from where ORG trips. After the last, the best try that kept
step is made `proofs` times more with `margin` kg beyond the payload. If one of these moves fails, the next best is proved, and
so on; what counts is the best that holds. So the task remembers for the host, which may try one thing after another without a
look. With answer="last" the last try is the answer, and is proved alone: a host has to remember what its tries have shown.

action        Box [-1, 1]^4, the same for every chip: start rate, drive rate, seconds of ramp-up and ramp-down, each by its
              logarithm over RATES; of ramps that do not fit into the move as much as does, as steep. The chip's formulas make
              registers of them.
observation   float32, -1 to 1, only what a host can know (truth=True adds the context at the end):
              distance, by its logarithm; tries left / tries; time of the best try that kept step by the encoder / twice the usual
              time, 1 before there is one; and then for each try (memory="all"), or for the last one (memory="last"), 0 before it
              the four actions; 1; duration / twice the usual time; 1 if it made its pulses; 1 if it kept step by the encoder;
              swing / (swing + 0.1 mm). Without encoder=True the last two are 0: the pulses are all that a host then knows.
reward        the sum of
              gain     log(best cost before / best cost now), where a try that kept step costs its seconds, and vibration_weight s
                       for each 0.1 mm of vibration; before the first it is two usual times. With answer="last" the costs of the
                       last try and of the one before it; one that lost steps, or is slower, costs two usual times
              damage   - damage_weight if a step was lost, or an end limit hit
              proof    after the last try: what was gained by tries that do not hold in the proof is taken back
              So without damage the sum is log(2 x usual time / cost of the best that holds), or 0.
              The usual time is that of the driver's usual speeds (1000 to 16,000 pps in 0.15 s), which every machine here can do.
episode       `tries` tries, then terminated.
score         time: s, the proved cost. formula: the engineer's (stage.tune.formula) for the split's heaviest payload, closed form.
split         where machines come from, see machine_contexts.py; a setting that is given comes before the split's.
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
from stage.envs.hidden_machines import MachineSettings, MachineTask
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.scaling import scale_log
from stage.envs.settings import AxisName, Count, Counts, Flag, Number, Seconds, Weight, Word, read_option
from stage.envs.single_moves import MAX_OFFSET_M, TENTH_MM, Trial, compute_move_time
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.step_results import SCORE_FEATURE, write_scores
from stage.firmware.driver import Speeds, get_driver
from stage.sim.fleet import Fleet, PlayedPrograms
from stage.sim.named_points import find_judged_point
from stage.sim.program import Program
from stage.support import portable_math
from stage.tune.formula import Load, compute_speeds

RATES = {"start": (200.0, 6000.0), "drive": (2000.0, 60_000.0), "up": (0.01, 0.3), "down": (0.01, 0.3)}  # pps, s
ENCODER_COUNT_M = 5e-6  # m, of the encoder
MIN_RAMP_S = 2e-3  # s, of a ramp
MEMORIES = ("all", "last")
ANSWERS = ("best", "last")
NUMBERS_PER_TRY = 9  # numbers of an observation


@dataclass(frozen=True)
class Config(MachineSettings):
    """Settings of FewShotTuning, beside those of hidden machines."""

    axis: AxisName = "x"
    distances: Counts = (1600, 16_000)  # pulses, drawn evenly by their logarithm
    judge_at: AxisName | None = None  # site or body at which vibration is observed, as in RegisterTuning
    tries: Count = 8  # an episode
    proofs: Annotated[int, Number(low=0, high=64, whole=True)] = 4  # moves
    margin: Annotated[float, Number(high=1e3)] = 0.5  # kg that the proof has beyond the payload
    encoder: Flag = True  # on the carriage, read by the host after each try
    memory: Annotated[str, Word(MEMORIES)] = "all"  # or "last"
    answer: Annotated[str, Word(ANSWERS)] = "best"  # what is proved: the best try, or the last one
    settle: Seconds = 0.1  # s, in which vibration and swing are observed
    damage_weight: Weight = 0.05
    vibration_weight: Weight = 0.02  # s for each 0.1 mm


def action_of(start: float, drive: float, up: float, down: float) -> np.ndarray:
    """Return the action that means these values; a value beyond RATES counts as the end of its range.

    Args:
        start: Start rate, pps.
        drive: Drive rate, pps.
        up: Duration of the ramp up, s.
        down: Duration of the ramp down, s.

    Returns:
        An action, (4,) float32.
    """
    low, high = portable_math.log(np.array(list(RATES.values()))).T
    return np.clip(2 * (portable_math.log((start, drive, up, down)) - low) / (high - low) - 1, -1, 1).astype(np.float32)


class FewShotTuning(MachineTask[Config]):
    Config: ClassVar[type] = Config
    OPTIONS: ClassVar[tuple[str, ...]] = ("distance", *machine_contexts.OPTIONS)
    """The move and the machine, in place of drawn ones."""
    PARTS = ("gain", "damage", "proof")
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
        *(Feature(f"tried_{name}", HOST, "rate or ramp of this attempt, from -1 to 1", "try") for name in RATES),
        Feature("tried", HOST, "1 if this attempt was made", "try"),
        Feature("duration", HOST, "duration / twice the usual time", "try"),
        Feature("finished", HOST, "1 if it made its pulses", "try"),
        Feature("kept", HOST, "1 if it kept step by the encoder; 0 without an encoder", "try"),
        Feature(
            "swing", HOST, "swing after the stop by the encoder: swing / (swing + 0.1 mm); 0 without an encoder", "try"
        ),
        *machine_contexts.OBSERVATION,
    )
    INFO: ClassVar[tuple[Feature, ...]] = (
        Feature("distance", HOST, "pulses", kind=int),
        *machine_contexts.INFO,
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

    def prepare(self) -> None:
        c, n, first = self.config, self.n, self.stages[0]
        self.axis = first.axes[c.axis]
        self.driver = get_driver(self.axis)
        self.judged, point = find_judged_point(first, c.axis, c.judge_at)
        self.trial = Trial(self.axis, point, c.settle, encoder=True)
        self.prepare_machines()
        self.trial.check(c.distances, "pulses")
        self.names = self.driver.list_move_registers(s_curve=False)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(RATES),), np.float32)
        self.observation_space = self.make_observation_space()
        self.shapes = {"registers": (len(self.names),)}
        self.distance, self.angle = np.ones(n, np.int64), np.zeros(n)
        self.table = np.zeros((n, c.tries, NUMBERS_PER_TRY))
        self.best_time, self.cost = np.full(n, np.inf), np.full((n, c.tries), np.inf)
        self.rows = np.zeros((n, c.tries, len(self.names)), np.int64)
        self.load = Load.from_axis(self.axis)
        self.formula, self.damage = np.ones((n, 5)), np.zeros((n, 2), np.int64)
        self.proof_fleet = Fleet([copy.deepcopy(first) for _ in range(n)], self.fleet.threads)

    def layout(self) -> list[Feature]:
        tries = self.config.tries if self.config.memory == "all" else 1
        return [
            *self.OBSERVATION[:3],
            *self.OBSERVATION[3 : 3 + NUMBERS_PER_TRY] * tries,
            *self.OBSERVATION[3 + NUMBERS_PER_TRY :],
        ]

    # --- machines ---

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        c, rng = self.config, self.rngs[stage_index]
        distance = int(np.rint(portable_math.exp(rng.uniform(*portable_math.log(c.distances)))))
        self.distance[stage_index] = read_option(options, "distance", distance, c.distances)
        self.draw_machine(stage_index, options)
        self.table[stage_index], self.best_time[stage_index], self.cost[stage_index], self.damage[stage_index] = (
            0.0,
            np.inf,
            np.inf,
            0,
        )
        self._compute_formula(stage_index, rng, options)
        self._place_next(stage_index)

    def _compute_formula(self, stage_index: int, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Compute the formula's move for a machine of which the host only knows the heaviest payload."""
        self._set_formula(stage_index, self.ranges["payload"][1])

    def _set_formula(self, stage_index: int, payload: float) -> None:
        """Store the formula's rates and ramps for a payload, kg, and the time that they take."""
        move, distance = (
            compute_speeds(self.load.add_mass(payload), int(self.distance[stage_index])),
            int(self.distance[stage_index]),
        )
        rate = self.decode_action(action_of(*move[:4]), distance)
        start, top, up, down = rate
        took = up + down + (distance - (up + down) * (start + top) / 2) / top
        self.formula[stage_index] = *rate, took

    def scripted_action(self) -> np.ndarray:
        """Return the engineer's formula (stage.tune.formula) as action of every try."""
        return np.stack([action_of(*row[:4]) for row in self.formula])

    def prepare_next(self) -> None:
        for k in np.flatnonzero(self.converged & ~self.results["terminated"]):
            self._place_next(int(k))

    def _place_next(self, stage_index: int) -> None:
        """Place stage k for its next try, at the angle where ORG trips this time."""
        self.angle[stage_index] = self._draw_origin_angle(stage_index)
        self._place_carriages(self.stages[stage_index], stage_index, float(self.angle[stage_index]))

    def _draw_origin_angle(self, stage_index: int) -> float:
        return float(
            (
                self.context[stage_index]["switch"]
                + self.context[stage_index]["drift"] * self.rngs[stage_index].uniform(-1, 1)
            )
            % 1.0
        )

    def _place_carriages(self, stage: Stage, stage_index: int, angle: float, extra_payload_kg: float = 0.0) -> None:
        stage.restore(self.start)
        self.configure_stage(stage, stage_index, extra_payload_kg)
        stage.place(**{self.config.axis: self.trial.find_start(float(self.distance[stage_index]), angle)})

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {"distance": int(self.distance[stage_index]), **self.describe_machine(stage_index)}

    # --- tries ---

    @property
    def usual(self) -> np.ndarray:
        """Time that each stage's move takes at the usual speeds, s, by the closed form."""
        return compute_move_time(self.distance, Speeds().start, Speeds().drive, Speeds().up)

    def decode_action(self, action: np.ndarray, distance: int) -> tuple[float, float, float, float]:
        """Compute the rates and ramp times that an action stands for.

        If the ramps do not fit into the move, the top rate and the ramp times are reduced until they do.

        Args:
            action: (4,), from -1 to 1.
            distance: Pulses of the move.

        Returns:
            Start rate and top rate, pps; times of the ramp up and the ramp down, s.
        """
        low, high = portable_math.log(np.array(list(RATES.values()))).T
        start, drive, up, down = portable_math.exp(
            low + (high - low) * (np.asarray(action, np.float64) + 1) / 2
        ).tolist()
        drive = max(drive, 1.05 * start)
        flat = (up + down) / (drive - start)  # s2 a pulse: both ramps are as steep as that, wherever they end
        top = min(drive, float(np.sqrt(start**2 + 2 * distance / flat)))
        shorter = (top - start) / (drive - start)
        return start, top, max(up * shorter, MIN_RAMP_S), max(down * shorter, MIN_RAMP_S)

    def to_registers(self, actions: np.ndarray) -> np.ndarray:
        """Return the registers of actions, (n, registers)."""
        rows = []
        for action, distance in zip(actions, self.distance.tolist(), strict=True):
            values = self.driver.compute_move_registers(*self.decode_action(action, distance), distance, s_curve=False)
            rows.append([values[name] for name in self.names])
        return np.array(rows, np.int64)

    def _compute_gain(self, tries: np.ndarray) -> np.ndarray:
        """Compute the value of the answer after so many tries, (n,)."""
        return self._compute_value(self._answer_costs(tries).min(axis=1))

    def _answer_costs(self, tries: np.ndarray) -> np.ndarray:
        """Return the costs of the tries that may be the answer, (n, tries); infinite elsewhere."""
        at = np.arange(self.config.tries)
        is_answer = at < tries[:, None] if self.config.answer == "best" else at == tries[:, None] - 1
        return np.where(is_answer, self.cost, np.inf)

    def _compute_value(self, cost: np.ndarray) -> np.ndarray:
        """Return log(two usual times / cost); 0 for what costs more."""
        return np.maximum(portable_math.log(2 * self.usual) - portable_math.log(cost), 0.0)

    def make_programs(self) -> list[Program]:
        return self._make_programs_of_rows(self.to_registers(self.actions))

    def _make_programs_of_rows(self, rows: np.ndarray) -> list[Program]:
        limits = (2 * self.usual).tolist()
        columns = zip(rows.tolist(), self.distance.tolist(), limits, strict=True)
        return [self.trial.program(dict(zip(self.names, row, strict=True)), d, limit) for row, d, limit in columns]

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c, t, usual = self.config, truth[:, self.axis.index], self.usual
        outcome = self.trial.read_outcomes(played, t, self.distance, ENCODER_COUNT_M)
        good = self.converged
        cost = outcome.duration + c.vibration_weight * outcome.vibration / TENTH_MM
        rows, indices = self.to_registers(self.actions), np.flatnonzero(good)
        before = self._compute_gain(self.steps - 1)
        self.cost[indices, self.steps[indices] - 1] = np.where(outcome.in_step, cost, np.inf)[indices]
        self.rows[indices, self.steps[indices] - 1] = rows[indices]
        gain, last = self._compute_gain(self.steps) - before, self.steps >= c.tries
        proved = self._prove_best(good & last)
        parts = {
            "gain": gain,
            "damage": np.where(outcome.lost | outcome.stopped, -c.damage_weight, 0.0),
            "proof": np.where(good & last, self._compute_value(proved) - self._compute_gain(self.steps), 0.0),
        }
        error = outcome.error * c.encoder
        by_encoder = outcome.finished & (np.abs(error) * ENCODER_COUNT_M <= MAX_OFFSET_M + ENCODER_COUNT_M) & c.encoder
        row = [
            outcome.duration / (2 * usual),
            outcome.finished,
            by_encoder,
            c.encoder * outcome.swing / (outcome.swing + TENTH_MM),
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

    def _prove_best(self, which: np.ndarray) -> np.ndarray:
        """Return the best cost that holds in a proof, (n,); infinite where none does, and for stages not in `which`."""
        proved, left, every = np.full(self.n, np.inf), which.copy(), np.arange(self.n)
        costs = self._answer_costs(self.steps)
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

    def _prove_moves(self, which: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return which stages keep step with these registers in `proofs` moves, `margin` kg heavier."""
        c, holds = self.config, which.copy()
        programs = self._make_programs_of_rows(np.where(which[:, None], rows, self.to_registers(self.actions)))
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
        best = np.minimum(self.best_time / (2 * self.usual), 1.0)
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
    task = FewShotTuning


class FewShotTuningVectorEnv(StageVectorEnv):
    task = FewShotTuning
