"""`stage/SynchronizedLine-v1`: a straight line of two or three axes on a machine that the host does not know, and its proof.

An episode is one hidden machine (machine_contexts.py), one line and one attempt: rate, ramps and the registers of all axes. The
move starts at random angles of the rotors, and is then repeated `proofs` times from other angles, with `margin` kg more payload.
How the axes are kept on the line depends on the chip's family, as in SynchronizedMove (synchronized_move.py).

action        Box [-1, 1]^(2 + 6 axes): peak rate of the longest axis and seconds of its ramps, by their logarithms over `rate` and
              `ramps`; then six corrections for each axis to the data sheet's a:b registers (PCL-240: R1, R2, R4, R5, R6, R7), as
              the "corrections" of SynchronizedMove: 0 is the engineer's answer. A chip with fewer registers uses the first
              corrections of each axis, a chip that interpolates uses those of the first axis; the others have no effect. So one
              policy can act through every chip.
observation   float32, -1 to 1, for each axis: signed distance / longest distance possible; and how far the data sheet's registers
              take the axis off its share of the longest axis at the usual rate, by the closed form, as in SynchronizedMove (4
              numbers). truth=True adds the machine
reward        the sum of
              gain     log(2 x usual time / cost) of an attempt that kept step, 0 for a higher cost. The cost is its seconds, plus
                       path_weight s for each pulse off the line, carriage_weight s for each 0.1 mm of the carriages off the
                       line, and vibration_weight s for each 0.1 mm of vibration after the stop
              damage   - damage_weight if a step was lost, or the move did not make its pulses
              proof    minus the gain if one of the proofs loses a step
              The usual time is that of 1000 to 16,000 pps of the longest axis, in 0.15 s.
episode       one step, then terminated.
score         time: s, the proved cost. formula: the time at the engineer's rate (stage.tune.formula) for the heaviest payload of
              the split, with ramps of its acceleration, in closed form.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np

from stage import Stage
from stage.envs import machine_contexts, synchronized_move
from stage.envs.hidden_machine_task import MachineSettings, MachineTask
from stage.envs.move_trials import DISPLACEMENT_SCALE_M, compute_move_time
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.settings import (
    AxisName,
    CountRange,
    NumberOrRangeSetting,
    NumberSetting,
    Pair,
    RangeSetting,
    Seconds,
    Weight,
)
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.step_results import SCORE_FEATURE, write_scores
from stage.envs.synchronized_move import END_FEATURES, LINE_FEATURES, SynchronizedMove
from stage.errors import ArgumentError
from stage.firmware.driver import Speeds
from stage.firmware.line_programs import LineMoves
from stage.sim.fleet import Fleet, PlayedPrograms
from stage.sim.payload_and_judged_point import find_judged_point
from stage.sim.program import MEASURE
from stage.support import portable_math
from stage.tune.formula import Load, compute_speeds

CORRECTIONS_PER_AXIS = 6  # numbers of an action for each axis


@dataclass(frozen=True)
class Config(MachineSettings, synchronized_move.Config):
    """Settings of SynchronizedLine, in addition to those of `MachineSettings` and SynchronizedMove.

    Attributes:
        distances: Smallest and largest distance of each axis, pulses, drawn evenly by their logarithm, with a random sign.
        rate: Range of the peak rate that an action chooses, pps.
        ramps: Range of the ramp duration that an action chooses, s.
        judge_at: Site or body that the first axis carries, at which vibration is observed; None: see `find_judged_point`.
        proofs: Number of moves that prove the attempt.
        margin: Mass that the moves of a proof have beyond the payload, kg.
        settle: Simulated time after the last pulse until which the carriages are observed, s.
        rest: Simulated time after that in which vibration is observed, s.
        path_weight: Cost of a pulse of path deviation, s.
        carriage_weight: Cost of 0.1 mm between the carriages and the line, s.
        vibration_weight: Cost of 0.1 mm of vibration, s.
        damage_weight: Cost of a move that loses a step or does not make all its pulses.
    """

    distances: CountRange = (1_600, 12_000)
    rate: Annotated[float | Pair, NumberOrRangeSetting(further_condition=", not below fl")] = (2_000.0, 60_000.0)
    ramps: Annotated[Pair, RangeSetting(1e-3, high=1.0)] = (0.01, 0.3)
    judge_at: AxisName | None = None
    proofs: Annotated[int, NumberSetting(low=0, high=64, integer=True)] = 3
    margin: Annotated[float, NumberSetting(high=1e3)] = 0.5
    settle: Seconds = 1e-3
    rest: Seconds = 0.1
    path_weight: Weight = 0.01
    carriage_weight: Weight = 0.01
    vibration_weight: Weight = 0.02
    damage_weight: Weight = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.moves != 1:
            raise ArgumentError(f"moves={self.moves!r}: one here; stage/SynchronizedMove-v0 has several.")
        if self.actions != "corrections":
            raise ArgumentError(f"actions={self.actions!r}: 'corrections' here; stage/SynchronizedMove-v0 has others.")
        if self.ramps[0] <= 0:
            raise ArgumentError(f"ramps={self.ramps!r}: (least, most) s, above 0.")


class SynchronizedLine(MachineTask[Any], SynchronizedMove):
    """Rules of stage/SynchronizedLine-v1. The module docstring states them."""

    Config: ClassVar[type] = Config
    OPTIONS = ("distances", *machine_contexts.RESET_OPTION_NAMES)
    """Options of a reset, which replace drawn values of the line and the machine."""
    PARTS = ("gain", "damage", "proof")
    STATE = ("distances", "rate", "ramp", "context", "angles", "formula")
    OBSERVATION: ClassVar[tuple[Feature, ...]] = (
        *SynchronizedMove.OBSERVATION[1:6],
        *machine_contexts.OBSERVATION_FEATURES,
    )
    INFO: ClassVar[tuple[Feature, ...]] = (
        Feature("distances", HOST, "pulses of each axis", kind=int),
        *machine_contexts.INFO_FEATURES,
        Feature("rate", HOST, "pps of the longest axis, of the action", kind=float),
        Feature("ramp", HOST, "s, of the action", kind=float),
        Feature("registers", HOST, "registers computed from these and the corrections", kind=int),
        *LINE_FEATURES,
        Feature("usual", HOST, "s, time of the usual rate", kind=float),
        Feature("vibration", TRUTH, "m, travel of the judged point after the stop", kind=float),
        *END_FEATURES,
        Feature("proved", TRUTH, "s, the cost of the attempt if it passed the proof; otherwise infinite", kind=float),
        SCORE_FEATURE,
    )

    @property
    def axis_names(self) -> tuple[str, ...]:
        return self.config.axes

    def make_spaces_and_arrays(self) -> None:
        c: Any = self.config
        n, first = self.n, self.stages[0]
        super().make_spaces_and_arrays()
        m = len(self.axes)
        self.judged, self.point = find_judged_point(first, c.axes[0], c.judge_at)
        self.prepare_contexts()
        self.loads = [Load.from_axis(a) for a in self.axes]
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2 + CORRECTIONS_PER_AXIS * m,), np.float32)
        self.observation_space = self.make_observation_space()
        self.angles = np.zeros((n, m))
        self.ramp, self.formula = np.full(n, 0.1), np.ones((n, 3))
        self.proof_fleet = Fleet([copy.deepcopy(first) for _ in range(n)], self.fleet.threads)

    def list_all_features(self) -> list[Feature]:
        return [*self.OBSERVATION[:5] * len(self.axes), *self.OBSERVATION[5:]]

    # --- machines and lines ---

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        rng, m = self.rngs[stage_index], len(self.axes)
        c: Any = self.config
        self.draw_machine(stage_index, options)
        low, high = portable_math.log(c.distances)
        sizes = np.rint(portable_math.exp(rng.uniform(low, high, m))).astype(np.int64)
        self.distances[stage_index] = sizes * rng.choice([-1, 1], m)
        self._apply_options(stage_index, options)
        self.rate[stage_index] = np.clip(Speeds().drive, *c.rates)
        self.ramp[stage_index] = np.clip(Speeds().up, *c.ramps)
        self.angles[stage_index] = rng.uniform(size=m)
        self._place_carriages(self.stages[stage_index], stage_index)
        self._compute_formula_move(stage_index)

    def prepare_next_step(self) -> None:
        """Do nothing, because an episode has only one step."""

    def _place_carriages(self, stage: Stage, stage_index: int, extra_payload_kg: float = 0.0) -> None:
        """Put a stage at power-up, with the machine of an episode and the carriages at the start of its line.

        Args:
            stage: Stage to change.
            stage_index: Index of the stage whose machine and line it gets.
            extra_payload_kg: Mass beyond the payload, kg.
        """
        stage.restore(self.start)
        self.apply_machine_to(stage, stage_index, extra_payload_kg)
        begin = zip(
            self.axes,
            self.start_positions,
            self.distances[stage_index].tolist(),
            self.angles[stage_index].tolist(),
            strict=True,
        )
        stage.place(**{a.name: starts.find_start(d, angle) for a, starts, d, angle in begin})

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {"distances": self.distances[stage_index].copy(), **self.describe_machine(stage_index)}

    def _compute_formula_move(self, stage_index: int) -> None:
        """Compute the rate, ramp and duration of a stage's line by the engineer's formula, within the limits of each axis."""
        c: Any = self.config
        sizes = np.abs(self.distances[stage_index])
        longest = int(sizes.max())
        rates, slopes = [], []
        for load, size in zip(self.loads, sizes.tolist(), strict=True):
            move = compute_speeds(load.add_mass(self.ranges["payload"][1]), int(size))
            rates.append(move.drive * longest / size)
            slopes.append((move.drive - move.start) / max(move.up, move.down) * longest / size)
        rate = float(np.clip(min(rates), *c.rates))
        ramp = float(np.clip((rate - c.fl) / min(slopes), *c.ramps))
        self.formula[stage_index] = rate, ramp, compute_move_time(np.float64(longest), c.fl, rate, ramp)

    # --- the try ---

    @property
    def requested_lines(self) -> LineMoves:
        """Lines of all stages, with the rates and ramps of the last actions."""
        return LineMoves(self.distances, self.rate, self.ramp)

    @property
    def usual_times_s(self) -> np.ndarray:
        """Duration of each stage's line with the default rates and ramps of `Speeds()`, s, (n,)."""
        s = Speeds()
        return compute_move_time(np.abs(self.distances).max(axis=1).astype(float), s.start, s.drive, s.up)

    def to_registers(self, actions: np.ndarray) -> np.ndarray:
        rows, columns = self.line.shape
        wanted = actions[:, 2:].astype(np.float64).reshape(len(actions), len(self.axes), CORRECTIONS_PER_AXIS)
        return self.line.apply_corrections(self.requested_lines, wanted[:, :rows, :columns])

    def make_action(self, rate: Any, ramp: Any) -> np.ndarray:
        """Return the actions that stand for a rate and a ramp, without corrections.

        Args:
            rate: Peak rate of the longest axis, pps, a number or (n,).
            ramp: Duration of the ramps, s, a number or (n,).

        Returns:
            Actions, (n, actions) float32.
        """
        c: Any = self.config
        out = np.zeros((self.n, self.action_space.shape[0]), np.float32)  # type: ignore[index]
        for j, (value, ends) in enumerate(((rate, c.rates), (ramp, c.ramps))):
            low, high = portable_math.log(ends)
            out[:, j] = np.clip(2 * (portable_math.log(value) - low) / max(high - low, 1e-9) - 1, -1, 1)
        return out

    def scripted_action(self) -> np.ndarray:
        """Return actions with the rate and ramp of the engineer's formula, and the data sheet's registers for them."""
        return self.make_action(self.formula[:, 0], self.formula[:, 1])

    def make_programs(self) -> np.ndarray:
        c: Any = self.config
        u = (self.actions[:, :2].astype(np.float64) + 1) / 2
        for values, ends, at in ((self.rate, c.rates, 0), (self.ramp, c.ramps, 1)):
            low, high = portable_math.log(ends)
            values[self.active] = portable_math.exp(low + (high - low) * u[:, at])[self.active]
        moves = super().make_programs()
        measure = np.zeros((self.n, 1, 4), np.int64)
        measure[:, 0, 0], measure[:, 0, 1], measure[:, 0, 2] = MEASURE, round(c.rest * 1e9), self.point
        self._played = np.concatenate([moves, measure], axis=1)
        return self._played.copy()

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c: Any = self.config
        t, usual = truth[:, self.index], self.usual_times_s
        lost, finished = t["lost_steps"], self._find_finished_moves(t)
        deviation, duration = np.where(finished, self.path, np.inf), np.where(finished, self.seconds, c.limit)
        off_line, vibration = self._measure_carriage_deviations(played.results), played.results[:, -1] * 1e-12
        good = self.undiverged_stages
        in_step = finished & (lost == 0).all(axis=1) & good
        cost = duration + c.path_weight * deviation
        cost = cost + (c.carriage_weight * off_line + c.vibration_weight * vibration) / DISPLACEMENT_SCALE_M
        cost = np.where(in_step, cost, np.inf)
        proved = np.where(self._prove_moves(in_step), cost, np.inf)
        gain = self._compute_value(cost)
        parts = {
            "gain": gain,
            "damage": np.where((lost != 0).any(axis=1) | ~finished, -c.damage_weight, 0.0),
            "proof": self._compute_value(proved) - gain,
        }
        info = {
            "distances": self.distances, **self.machine_info, "rate": self.rate,
            "ramp": self.ramp, "registers": self.to_registers(self.actions), "deviation": deviation,
            "carriage_deviation": off_line, "duration": duration, "usual": usual, "vibration": vibration,
            "lost_steps": lost, "finished": finished, "proved": proved,
        }  # fmt: skip
        self.set_results(parts, info, True, False)
        damage = np.abs(lost).sum(axis=1), (~finished) * 1
        write_scores(self.results["score"], proved, self.formula[:, 2], self.steps, *damage)

    def _find_finished_moves(self, truth: np.ndarray) -> np.ndarray:
        """Return the mask of the stages on which all axes made their pulses and stopped, (n,)."""
        return ((truth["pulses"] == self.distances) & (truth["busy"] == 0)).all(axis=1)

    def _compute_value(self, cost: np.ndarray) -> np.ndarray:
        """Compute the value of a move: log(two usual times / cost); 0 for a higher cost."""
        return np.maximum(portable_math.log(2 * self.usual_times_s) - portable_math.log(cost), 0.0)

    def _prove_moves(self, stage_mask: np.ndarray) -> np.ndarray:
        """Repeat moves `proofs` times with the same registers, `margin` kg heavier and from other angles of the rotors.

        Args:
            stage_mask: Mask of the stages to prove, (n,).

        Returns:
            Mask of the stages that keep step in all these moves, (n,).
        """
        c: Any = self.config
        holds = stage_mask.copy()
        for _ in range(c.proofs):
            if not holds.any():
                break
            for k in np.flatnonzero(holds).tolist():
                self.angles[k] = self.rngs[k].uniform(size=len(self.axes))
                self._place_carriages(self.proof_fleet.stages[k], k, c.margin)
            ops = self._played.copy()
            ops[~holds] = 0
            played = self.proof_fleet.play(ops)
            t = self.proof_fleet.truth()[:, self.index]
            holds &= self._find_finished_moves(t) & (t["lost_steps"] == 0).all(axis=1) & ~played.diverged
        return holds

    def compute_observations(self) -> np.ndarray:
        c: Any = self.config
        usual = LineMoves(
            self.distances, np.full(self.n, np.clip(Speeds().drive, *c.rates)), np.full(self.n, Speeds().up)
        )
        of_axes = np.concatenate(
            [(self.distances / c.distances[1])[:, :, None], self.line.compute_line_errors(usual) / (2 * c.reach)],
            axis=2,
        )
        observations = np.concatenate([of_axes.reshape(self.n, -1), self.machine_features], axis=1)
        return np.clip(observations, -1.0, 1.0).astype(np.float32)

    def close(self) -> None:
        super().close()
        self.proof_fleet.close()


class SynchronizedLineEnv(StageEnv):
    """Gymnasium environment stage/SynchronizedLine-v1: one straight line of two or three axes on an unknown machine."""

    task = SynchronizedLine


class SynchronizedLineVectorEnv(StageVectorEnv):
    """Vector environment stage/SynchronizedLine-v1: one straight line of two or three axes on unknown machines."""

    task = SynchronizedLine
