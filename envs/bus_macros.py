"""`stage/BusMacros-v1`: the agent is the host, and one action is a macro of several bus cycles.

stage/RegisterBus-v0 has single bus cycles as actions.

An episode has one machine, hidden as in FewShotTuning (machine_contexts.py), and a target for each axis that takes part. The
host writes registers from a grid, starts, waits, and reads; what does nothing now is masked.

action        Discrete, `env.macros` has the names; on the axis that is selected
              rates r        write the registers of RATES[r]: gentle, usual, bold
              distance d     write the finish register: grid[d] pulses
              plus, minus    start a move of these; the registers are written once more, as some chips forget them at a reset
              home           an origin return from where the axis is: minus to ORG, back off, approach. What was in the registers is
                             gone. PCL-240 chips refuse it on ORG
              wait           poll the status until the axis has stopped
              read           read status and counters, which the observation then has
              and for each axis
              select a       the macros act on it from now on; a move of another axis goes on
mask          info["action_mask"], int8: 1 for what has an effect, from what the host knows by itself. An action that is masked is
              legal, does nothing, and counts. env.action_masks() for sb3-contrib.
observation   float32, -1 to 1, only what a host knows (truth=True adds the machine at the end); of the axis that is selected
              its origin is known; it was started and not waited for; what was read is still true; rates that are written, one of 3;
              distance that is written, one of len(grid); way left to the target as last read, / the longest, and by its logarithm
              with its sign; ORG, EL-, EL+ as last read;
              then for each axis: it takes part; is selected; was started and not waited for; has no way left, as last read;
              then level / 3, macros left / `macros`, time left / `time_limit`
levels        0 "move"     x alone, origin known, the target one distance of the grid away, either way
              1 "target"   x alone, any multiple of grid[0] up to twice the sum of the grid, either way
              2 "axes"     all axes so
              3 "origin"   all axes, each powered up somewhere near ORG, on either side of it; targets are counted from ORG, plus
              Spaces are the same for all, so that one policy can learn them one after the other. mixed=True draws each
              episode's level evenly from 0 to `level`; reset(options={"level": 1}) sets one.
reward        the sum of
              progress   progress_weight x (potential now - potential before). The potential is - the mean of log(1 +
                         error beyond `lag` / `tolerance`), / its largest, and - 1/2 of the axes whose origin is not known; 0 at
                         success
              cost       - macro_weight for each action, - time_weight x s
              success    success_weight, once
              damage     - damage_weight when the first step is lost, and for each end limit hit
              failed     at an end without success what is left of the cost up to `macros` and `time_limit`, so that no failure is
                         cheaper than another
              With a `discount` below 1 all is paid at the end, and a loan on it before, as in RegisterBus: register_bus.py.
episode       terminated when all axes have stopped, their motors pull within `tolerance` of their targets, friction leaves the
              carriages within `lag`, no step is lost, and the origins are known; or when a step is lost while the origin cannot
              be found again (below level 3). Truncated after `macros` actions or `time_limit`.
score         time: s, to success. formula: one move straight to the target (of level 3 by ORG) at the usual rates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import numpy as np

from stage.envs import machine_contexts, machine_faults
from stage.envs.bus_host import AXIS, EPISODE, SWITCHES, BusHost
from stage.envs.hidden_machines import MachineSettings
from stage.envs.macro_programs import RATES, MacroTable
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.origin_switch import OriginSwitch
from stage.envs.settings import Count, Discount, Each, Flag, Names, Number, Positive, Seconds, Weight, Word
from stage.envs.single_moves import compute_move_time
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.step_results import SCORE_FEATURE, write_scores
from stage.errors import ArgumentError, unknown_name_error
from stage.sim.fleet import PlayedPrograms
from stage.support import portable_math

LEVELS = ("move", "target", "axes", "origin")
MAX_BEFORE_ORIGIN = 1_000  # pulses on the far side of ORG at which "origin" may begin, at most


@dataclass(frozen=True)
class Config(MachineSettings):
    """Settings of BusMacros, beside those of hidden machines."""

    FAULTS = (*machine_faults.HAMPERING, "bounce")
    level: Annotated[str, Word(LEVELS)] = "origin"
    mixed: Flag = False  # levels up to that one, drawn for each episode
    axes: Annotated[tuple[str, ...], Names(1)] = ("x", "y")
    grid: Annotated[tuple[int, ...], Each(1, whole=True)] = (16, 64, 256, 1024)  # pulses
    macros: Count = 120  # an episode
    time_limit: Seconds = 30.0  # s
    tolerance: Positive = 8.0  # pulses, of where the motor pulls the carriage to
    lag: Positive = 16.0  # pulses, that friction may hold the carriage off there: a full step of the default drives
    patience: Seconds = 2.0  # s, that a wait may take
    settle: Annotated[float, Number(high=1.0)] = 0.02  # s, after each stop
    discount: Discount = 1.0
    progress_weight: Weight = 2.0
    macro_weight: Weight = 0.01
    time_weight: Weight = 0.05
    success_weight: Weight = 5.0
    damage_weight: Weight = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axes", tuple(self.axes))
        object.__setattr__(self, "grid", tuple(int(d) for d in self.grid))
        if list(self.grid) != sorted(set(self.grid)) or self.grid[0] <= self.tolerance:
            raise ArgumentError(
                f"grid={self.grid!r}: pulses, each more than the one before, the first beyond the tolerance."
            )

    @property
    def longest(self) -> int:
        """Pulses of the farthest target."""
        return int(2 * sum(self.grid))


class BusMacros(BusHost):
    Config = Config
    OPTIONS = ("level", "targets", *machine_contexts.OPTIONS)
    """level: 0 to 3 or its name; targets: {axis: pulses, signed}; and parts of the machine."""
    PARTS = ("progress", "cost", "success", "damage", "failed")
    STATE = ("context", "axis_states", "episodes")
    INFO = (
        Feature("level", HOST, "level of the episode, 0 to 3", kind=int),
        Feature("action_mask", HOST, "int8, 1 for an action that has an effect", kind=np.int8),
        *machine_contexts.INFO,
        Feature("elapsed", HOST, "s since the episode began", kind=float),
        Feature("masked", HOST, "the action had no effect", kind=bool),
        Feature("success", TRUTH, "every axis stands at its target", kind=bool),
        Feature("error", TRUTH, "pulses, the largest of the axes' errors", kind=float),
        Feature("lost_steps", TRUTH, "full steps, of all axes", kind=int),
        SCORE_FEATURE,
    )

    @property
    def axis_names(self) -> tuple[str, ...]:
        return self.config.axes

    def prepare(self) -> None:
        c, n, first = self.config, self.n, self.stages[0]
        self.axes = [first.axes[name] for name in c.axes]
        self.index = [a.index for a in self.axes]
        m = len(self.axes)
        self.signed_pulse_m = np.array([a.meters_per_pulse * np.sign(a.gear) for a in self.axes])
        self.per_pulse = np.abs(self.signed_pulse_m)
        self.full_step = np.array([0.5 * np.pi / (_get_motor(a).rotor_teeth * a.gear) for a in self.axes])
        self.origin = np.array([OriginSwitch(first, a).position for a in self.axes])
        self.turn = np.array([2 * np.pi / (_get_motor(a).rotor_teeth * abs(a.gear)) for a in self.axes])
        self.wired = [[a.chip.wired(pin) for pin in SWITCHES] for a in self.axes]
        self.prepare_machines()
        self.top = LEVELS.index(c.level)
        self.book = MacroTable(self.axes, c.grid, c.patience, c.settle)
        self.names = self.book.names
        self.action_space = gymnasium.spaces.Discrete(len(self.names))
        self.observation_space = self.make_observation_space()
        self.shapes = {"action_mask": (len(self.names),)}
        self.episodes, self.axis_states = np.zeros(n, EPISODE), np.zeros((n, m), AXIS)

    # --- episodes ---

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        c, rng, m = self.config, self.rngs[stage_index], len(self.axes)
        drawn = int(rng.integers(0, self.top + 1)) if c.mixed else self.top
        level = self._parse_level(options.get("level", drawn))
        used = m if level >= 2 else 1
        self.draw_machine(stage_index, options, used)
        e, axes = self.episodes[stage_index], self.axis_states[stage_index]
        axes[...] = np.zeros((), AXIS)
        sign = rng.choice((-1, 1), m) if level < 3 else np.ones(m, np.int64)
        units = rng.integers(1, c.longest // c.grid[0] + 1, m)
        distance = units * c.grid[0] if level else rng.choice(c.grid, m)
        start = rng.integers(-MAX_BEFORE_ORIGIN, c.longest, m)
        axes["target"] = sign * distance
        axes["rates"] = axes["distance"] = -1
        self._apply_options(axes, options, level)
        at = self._find_starts(stage_index, level, start)
        from_origin = np.rint((at - self.origin) / self.signed_pulse_m)
        axes["goal"] = (self.origin if level == 3 else at) + self.signed_pulse_m * axes["target"]
        axes["known"], axes["fresh"] = level < 3, 1
        e["level"], e["limits"], e["selected"] = level, 0, 0
        self._place_carriages(stage_index, at)
        truth = self.fleet.truth()[stage_index, self.index]
        e["began"] = e["before"] = int(truth["now"][0])
        for a, pins in enumerate(self.wired):
            for name, mask in zip(SWITCHES, pins, strict=True):
                axes[name][a] = int(truth["inputs"][a]) & mask != 0
        straight = np.abs(axes["target"]) + (np.abs(from_origin) if level == 3 else 0)
        e["usual"] = compute_move_time(straight[:used].astype(float), *RATES["usual"]).max()
        e["potential"] = e["start"] = self._compute_potential(truth[None], slice(stage_index, stage_index + 1))[0]
        e["loan"] = 0.0

    def _apply_options(self, axes: Any, options: Mapping[str, Any], level: int) -> None:
        targets, c = options.get("targets", {}), self.config
        low = -c.longest if level < 3 else 1
        if not isinstance(targets, Mapping) or not all(
            isinstance(d, int | np.integer) and not isinstance(d, bool) and low <= d <= c.longest
            for d in targets.values()
        ):
            raise ArgumentError(f"option targets={targets!r}: {{axis: whole pulses, {low} to {c.longest}}}.")
        for name, pulses in targets.items():
            if name not in c.axes:
                raise unknown_name_error("axis", name, c.axes)
            axes["target"][c.axes.index(name)] = pulses

    def _find_starts(self, stage_index: int, level: int, start: np.ndarray) -> np.ndarray:
        """Return the positions of the carriages at power-up, m, at the rotor's angle of the context."""
        pulses = start if level == 3 else np.full(len(self.axes), self.config.longest + 2 * MAX_BEFORE_ORIGIN)
        at = self.origin + self.signed_pulse_m * pulses
        return (np.floor(at / self.turn) + float(self.context[stage_index]["switch"])) * self.turn

    def _place_carriages(self, stage_index: int, at: np.ndarray) -> None:
        stage = self.stages[stage_index]
        self.apply_machine(stage_index)
        stage.place(**{name: float(q) for name, q in zip(self.config.axes, at, strict=True)})

    @staticmethod
    def _parse_level(targets: Any) -> int:
        if isinstance(targets, str) and targets in LEVELS:
            return LEVELS.index(targets)
        if isinstance(targets, bool) or not isinstance(targets, int | np.integer) or not 0 <= targets < len(LEVELS):
            raise ArgumentError(f"option level={targets!r}: 0 to 3, or {', '.join(LEVELS)}.")
        return int(targets)

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {
            "level": int(self.episodes[stage_index]["level"]),
            "action_mask": self.action_masks()[stage_index],
            **self.describe_machine(stage_index),
        }

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c, e, t = self.config, self.episodes, truth[:, self.index]
        self._update_memory(played, t)
        good, used, now = self.converged, self.uses_axis, t["now"][:, 0]
        lost = np.abs(t["lost_steps"]) * used
        inputs = t["inputs"]
        at_limit = np.stack([inputs[:, a] & (w[1] | w[2]) != 0 for a, w in enumerate(self.wired)], axis=1) & used
        s = self.axis_states
        hits = (at_limit & (s["limit"] == 0)).sum(axis=1)
        first = (lost.max(axis=1) > 0) & (s["lost"].max(axis=1) == 0)
        error = np.abs(t["position"] - s["goal"]) / self.per_pulse
        rest = t["commanded"] - t["lost_steps"] * self.full_step
        arrived = (error <= c.lag) & (np.abs(rest - s["goal"]) <= c.tolerance * self.per_pulse)
        arrived &= (t["busy"] == 0) & (s["known"] != 0)
        is_recoverable = (lost == 0).all(axis=1) | (e["level"] == 3)
        success = (arrived | ~used).all(axis=1) & is_recoverable & good
        over = self.steps >= c.macros
        timed_out = now - e["began"] >= c.time_limit * 1e9
        hopeless = ~is_recoverable & ~success & good
        potential = np.where(success, 0.0, self._compute_potential(t, slice(None)))
        seconds = (now - e["before"]) * 1e-9
        failed = (hopeless | over | timed_out) & ~success
        left = np.maximum(c.macros - self.steps, 0) * c.macro_weight
        left = left + np.maximum(c.time_limit - (now - e["began"]) * 1e-9, 0.0) * c.time_weight
        parts = {
            "progress": c.progress_weight * (potential - e["potential"]),
            "cost": -c.macro_weight - c.time_weight * seconds,
            "success": np.where(success, c.success_weight, 0.0),
            "damage": -c.damage_weight * (first * 1.0 + hits),
            "failed": np.where(failed, -left, 0.0),
        }
        e["potential"][good], e["before"][good] = potential[good], now[good]
        e["limits"][good] += hits[good]
        s["lost"][good], s["limit"][good] = np.maximum(s["lost"], lost)[good], at_limit[good]
        if c.discount < 1.0:
            parts |= self._apply_loan(success | failed)
        elapsed = (now - e["began"]) * 1e-9
        info = {
            "level": e["level"], "action_mask": self.action_masks(), **self.machine_info,
            "elapsed": elapsed, "masked": ~self._valid, "success": success,
            "error": np.max(error * used, axis=1), "lost_steps": lost.sum(axis=1),
        }  # fmt: skip
        self.set_results(parts, info, success | hopeless, (over | timed_out) & ~success & ~hopeless)
        time = np.where(success, elapsed, np.inf)
        write_scores(self.results["score"], time, e["usual"], self.steps, s["lost"].sum(axis=1), e["limits"])

    def _apply_loan(self, over: np.ndarray) -> dict[str, np.ndarray]:
        """Return the parts of a step with a discount: whole at the end of an episode, before that a loan on them."""
        c, e, good = self.config, self.episodes, self.converged
        progress = c.progress_weight * (e["potential"] - e["start"])
        cost = -c.macro_weight * self.steps - c.time_weight * 1e-9 * (e["before"] - e["began"])
        damage = -c.damage_weight * ((self.axis_states["lost"].max(axis=1) > 0) + e["limits"])
        dearest = c.macro_weight * c.macros + c.time_weight * c.time_limit
        loan = np.maximum(progress + cost + damage, -dearest) / (1.0 + (1.0 - c.discount) * c.macros)
        loan = np.where(over, 0.0, loan)
        paid = np.where(over, progress, c.discount * loan) - e["loan"]
        e["loan"][good] = loan[good]
        return {"progress": paid, "cost": np.where(over, cost, 0.0), "damage": np.where(over, damage, 0.0)}

    def _compute_potential(self, t: np.ndarray, which: slice) -> np.ndarray:
        """Compute the potential of stages, (stages,), from about -1.5 to 0."""
        c, s, used = self.config, self.axis_states[which], self.uses_axis[which]
        beyond = np.maximum(np.abs(t["position"] - s["goal"]) / self.per_pulse - c.lag, 0.0) / c.tolerance
        distance = portable_math.log1p(beyond) / portable_math.log1p(
            (c.longest + MAX_BEFORE_ORIGIN) / c.tolerance
        ) + 0.5 * (s["known"] == 0)
        total = np.zeros(len(s))
        for a in range(len(self.axes)):
            total -= distance[:, a] * used[:, a]
        return total / used.sum(axis=1)


def _get_motor(axis: Any) -> Any:
    return axis.drive.motor


class BusMacrosEnv(StageEnv):
    task = BusMacros

    @property
    def macros(self) -> tuple[str, ...]:
        """Name of the macro of each action."""
        return self._task.names  # type: ignore[attr-defined]

    def action_masks(self) -> np.ndarray:
        """Return which actions have an effect now, bool, as sb3-contrib expects."""
        return self._task.action_masks()[0] != 0  # type: ignore[attr-defined]


class BusMacrosVectorEnv(StageVectorEnv):
    task = BusMacros

    @property
    def macros(self) -> tuple[str, ...]:
        """Name of the macro of each action."""
        return self._task.names  # type: ignore[attr-defined]

    def action_masks(self) -> np.ndarray:
        """Return which actions have an effect now, (num_envs, actions) bool."""
        return self._task.action_masks() != 0  # type: ignore[attr-defined]
