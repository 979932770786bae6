"""`stage/BusMacros-v1`: the agent is the host, and one action is a macro of several bus cycles.

stage/RegisterBus-v0 has single bus cycles as actions.

An episode has one machine, hidden as in FewShotTuning (machine_contexts.py), and a target for each axis that takes part. The
host writes registers from a grid, starts moves, waits, and reads. Macros that have no effect at present are masked.

action        Discrete, `env.macros` has the names. These act on the selected axis:
              rates r        write the registers of RATES[r]: gentle, usual, bold
              distance d     write the finish register: grid[d] pulses
              plus, minus    start a move with these; the registers are written once more, as some chips forget them at a reset
              home           origin return from the present position: minus to ORG, back off, approach. It overwrites the
                             registers. PCL-240 chips refuse it on ORG
              wait           poll the status until the axis has stopped
              read           read status and counters, which the observation then contains
              and this exists for each axis:
              select a       select the axis for the next macros; a move of another axis continues
mask          info["action_mask"], int8: 1 for a macro that has an effect, by what the host itself knows. A masked action is legal,
              has no effect, and counts as a macro. env.action_masks() for sb3-contrib.
observation   float32, -1 to 1, only what a host knows (truth=True adds the machine at the end). Of the selected axis:
              its origin is known; a move was started and not waited for; the last values read are still valid; rates that are
              written, one of 3; distance that is written, one of len(grid); distance left to the target as last read / the
              longest possible, and its logarithm with its sign; ORG, EL-, EL+ as last read.
              Of each axis: it takes part; it is selected; a move was started and not waited for; no distance is left, as last
              read. Then level / 3, macros left / `macros`, time left / `time_limit`
levels        0 "move"     x alone, origin known, the target one distance of the grid away, in either direction
              1 "target"   x alone, any multiple of grid[0] up to twice the sum of the grid, in either direction
              2 "axes"     the same for all axes
              3 "origin"   all axes, each powered up near ORG, on either side of it; targets are counted from ORG, plus
              All levels have the same spaces, so one policy can learn them one after the other. mixed=True draws each
              episode's level evenly from 0 to `level`; reset(options={"level": 1}) sets one.
reward        the sum of
              progress   progress_weight x (potential now - potential before). The potential is minus the mean over the axes of
                         log(1 + error beyond `lag` / `tolerance`), divided by its largest value, minus 1/2 for each axis whose
                         origin is not known; 0 at success
              cost       - macro_weight for each action, - time_weight x s
              success    success_weight, once
              damage     - damage_weight when the first step is lost, and for each end limit hit
              failed     the cost that is left up to `macros` and `time_limit`: charged at the first macro, and given back as it is
                         spent or at success, so that no failure is cheaper than another, nor to leave an episode (TimeLimit)
              With a `discount` below 1, everything is paid at the end, and a loan before, as in RegisterBus: register_bus.py.
episode       terminated at success, which means that every axis has stopped, its motor pulls it to within `tolerance` of its
              target, friction keeps its carriage within `lag` of that position, no step is lost, and its origin is known. Also
              terminated when a step is lost and the level does not allow to find the origin again (below level 3). Truncated
              after `macros` actions or `time_limit`.
score         time: s, to success. formula: one move straight to the target (in level 3 by way of ORG) at the usual rates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np

from stage.envs import bus_macros_core as core
from stage.envs import machine_contexts, machine_faults
from stage.envs.bus_macros_host import MacroHostTask
from stage.envs.hidden_machine_task import MachineSettings
from stage.envs.macro_programs import RATES, MacroTable
from stage.envs.move_trials import StartPositions, compute_move_time
from stage.envs.observation_features import HOST, Feature
from stage.envs.origin_switch import OriginSwitch
from stage.envs.settings import (
    Boolean,
    ChoiceSetting,
    Count,
    Discount,
    NamesSetting,
    NumberSetting,
    NumbersSetting,
    PositiveNumber,
    Seconds,
    Weight,
)
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.step_results import DIVERGENCE_REWARD, SCORE_FEATURE
from stage.errors import ArgumentError, unknown_name_error
from stage.support import portable_math

LEVELS = ("move", "target", "axes", "origin")
MAX_PULSES_BEFORE_ORIGIN = (
    1_000  # pulses: largest distance beyond ORG, on the minus side, at which level "origin" starts
)


@dataclass(frozen=True)
class Config(MachineSettings):
    """Settings of BusMacros, in addition to those of `MachineSettings`.

    Attributes:
        level: Level of the episodes, one of LEVELS.
        mixed: Whether each episode draws its level, evenly, up to `level`.
        axes: Names of the axes.
        grid: Distances that a macro can write, pulses, in rising order.
        macros: Number of macros after which an episode is truncated.
        time_limit: Simulated time after which an episode is truncated, s.
        tolerance: Largest distance between the target and the position to which the motor pulls the carriage, pulses.
        lag: Largest distance by which friction may keep the carriage from that position, pulses; by default a full step.
        patience: Longest simulated time of the macro `wait`, s.
        settle: Simulated time after each stop, s.
        discount: Discount of the learner for one action; 1 for none.
        progress_weight: Factor on the part `progress` of the reward.
        macro_weight: Cost of an action.
        time_weight: Cost of a simulated second.
        success_weight: Reward of success.
        damage_weight: Cost of the first lost step, and of each end limit that an axis hits.
    """

    FAULTS = (*machine_faults.HAMPERING_FAULTS, "bounce")
    level: Annotated[str, ChoiceSetting(LEVELS)] = "origin"
    mixed: Boolean = False
    axes: Annotated[tuple[str, ...], NamesSetting(1)] = ("x", "y")
    grid: Annotated[tuple[int, ...], NumbersSetting(1, integer=True)] = (16, 64, 256, 1024)
    macros: Count = 120
    time_limit: Seconds = 30.0
    tolerance: PositiveNumber = 8.0
    lag: PositiveNumber = 16.0
    patience: Seconds = 2.0
    settle: Annotated[float, NumberSetting(high=1.0)] = 0.02
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
    def max_target_pulses(self) -> int:
        """Largest distance of a target from the start position, or from ORG in level 3, pulses."""
        return int(2 * sum(self.grid))


class BusMacros(MacroHostTask):
    """Rules of stage/BusMacros-v1, whose steps run in compiled code (bus_macros_core.py). The module docstring states them."""

    Config = Config
    OPTIONS = ("level", "targets", *machine_contexts.RESET_OPTION_NAMES)
    """Options of a reset. level: 0 to 3, or a name; targets: {axis: signed pulses}; and values of the machine."""
    PARTS = core.REWARD_PARTS
    STATE = ("context", "axis_states", "episodes")
    CORE: ClassVar = core
    STEPS_ARE_MOVES = True
    INFO = (
        *core.INFO_FEATURES,
        Feature("action_mask", HOST, "int8, 1 for an action that has an effect", kind=np.int8),
        *machine_contexts.INFO_FEATURES,
        SCORE_FEATURE,
    )

    @property
    def axis_names(self) -> tuple[str, ...]:
        return self.config.axes

    def make_spaces_and_arrays(self) -> None:
        c, n, first = self.config, self.n, self.stages[0]
        self.axes = [first.axes[name] for name in c.axes]
        self.index = [a.index for a in self.axes]
        m = len(self.axes)
        self.signed_pulse_m = np.array([a.meters_per_pulse * np.sign(a.gear) for a in self.axes])
        self.per_pulse = np.abs(self.signed_pulse_m)
        self.full_step = np.array([0.5 * np.pi / (a.drive.motor.rotor_teeth * a.gear) for a in self.axes])
        self.origin = np.array([OriginSwitch(first, a).position for a in self.axes])
        self.turn = np.array([StartPositions(a).turn for a in self.axes])
        self.prepare_contexts()
        self.top = LEVELS.index(c.level)
        self.macro_table = MacroTable(self.axes, c.grid, c.patience, c.settle)
        self.names = self.macro_table.names
        self.action_space = gymnasium.spaces.Discrete(len(self.names))
        width = len(self.observation_features)
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (width,), np.float32)
        self.shapes = {"action_mask": (len(self.names),)}
        self.episodes, self.axis_states = np.zeros(n, core.EPISODE), np.zeros((n, m), core.AXIS_STATE)
        self.make_step_arrays(len(first.axes), self.macro_table.programs.shape[1])
        self._homed, self._valid = np.zeros(n, bool), np.zeros(n, bool)
        self._lasts = np.isin(self.macro_table.kinds, (core.HOME, core.WAIT))
        self._machine_numbers = np.zeros((n, len(machine_contexts.OBSERVATION_FEATURES)))
        self._fill_rule_records()

    def _fill_rule_records(self) -> None:
        """Fill the records from which compiled code reads the settings of the environment."""
        c = self.config
        self.rules, self.axis_rules = np.zeros(1, core.TASK_PARAMETERS), np.zeros(len(self.axes), core.AXIS_PARAMETERS)
        rules = {name: getattr(c, name) for name in core.SETTINGS}
        rules |= {
            "farthest": c.max_target_pulses, "nearest": c.grid[0], "diverged": DIVERGENCE_REWARD, "truth": c.truth is True,
            "log_farthest": portable_math.log1p(2 * c.max_target_pulses / c.grid[0]),
            "log_longest": portable_math.log1p((c.max_target_pulses + MAX_PULSES_BEFORE_ORIGIN) / c.tolerance),
        }  # fmt: skip
        for name, value in rules.items():
            self.rules[name] = value
        of_axes = {
            "near": c.tolerance * self.per_pulse, "per_pulse": self.per_pulse, "full_step": self.full_step,
            "index": self.index,
            **{pin: [a.chip.find_switch_input(pin) for a in self.axes] for pin in core.SWITCHES},
        }  # fmt: skip
        for name, values in of_axes.items():
            self.axis_rules[name] = values

    def list_frame_values(self) -> dict[str, Any]:
        macros, row = self.macro_table, self.results.rows.dtype
        offset: int = row.fields["score"][1]
        return {
            "rules": self.rules, "axis_rules": self.axis_rules, "episodes": self.episodes, "axes": self.axis_states,
            "machines": self._machine_numbers, "homed": self._homed, "valid": self._valid, "kinds": macros.kinds,
            "targets": macros.targets, "pages": macros.pages, "table": macros.programs, "n_axes": len(self.axes),
            "stage_axes": self._truth.shape[1], "n_actions": len(self.names), "n_distances": len(macros.grid),
            "n_pages": len(macros.programs), "n_ops": macros.programs.shape[1],
            "n_machine": self._machine_numbers.shape[1], "result_size": row.itemsize, "score": offset,
        }  # fmt: skip

    def apply_machine(self, stage_index: int) -> None:
        super().apply_machine(stage_index)
        for f in machine_contexts.INFO_FEATURES:
            self.results["info"][f.name][stage_index] = self.context[f.name][stage_index]
        self._machine_numbers[stage_index] = self.machine_features[stage_index]

    # --- episodes ---

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        c, rng, m = self.config, self.rngs[stage_index], len(self.axes)
        drawn = int(rng.integers(0, self.top + 1)) if c.mixed else self.top
        level = self._parse_level(options.get("level", drawn))
        used = m if level >= 2 else 1
        self.draw_machine(stage_index, options, used)
        e, axes = self.episodes[stage_index], self.axis_states[stage_index]
        axes[...] = np.zeros((), core.AXIS_STATE)
        sign = rng.choice((-1, 1), m) if level < 3 else np.ones(m, np.int64)
        units = rng.integers(1, c.max_target_pulses // c.grid[0] + 1, m)
        distance = units * c.grid[0] if level else rng.choice(c.grid, m)
        start = rng.integers(-MAX_PULSES_BEFORE_ORIGIN, c.max_target_pulses, m)
        axes["target"] = sign * distance
        axes["rates"] = axes["distance"] = -1
        self._set_target_options(axes, options, level)
        at = self._compute_start_positions(stage_index, level, start)
        from_origin = np.rint((at - self.origin) / self.signed_pulse_m)
        axes["goal"] = (self.origin if level == 3 else at) + self.signed_pulse_m * axes["target"]
        axes["known"], axes["fresh"] = level < 3, 1
        e["level"], e["limits"], e["selected"] = level, 0, 0
        self._place_carriages(stage_index, at)
        straight = np.abs(axes["target"]) + (np.abs(from_origin) if level == 3 else 0)
        e["usual"] = compute_move_time(straight[:used].astype(float), *RATES["usual"]).max()
        self.judge_and_observe(stage_index, stage_index + 1, True)

    def _set_target_options(self, axes: Any, options: Mapping[str, Any], level: int) -> None:
        """Set the targets of the option "targets", pulses by axis. Raises ArgumentError for one that the level does not allow."""
        targets, c = options.get("targets", {}), self.config
        low = -c.max_target_pulses if level < 3 else 1
        if not isinstance(targets, Mapping) or not all(
            isinstance(d, int | np.integer) and not isinstance(d, bool) and low <= d <= c.max_target_pulses
            for d in targets.values()
        ):
            raise ArgumentError(f"option targets={targets!r}: {{axis: whole pulses, {low} to {c.max_target_pulses}}}.")
        for name, pulses in targets.items():
            if name not in c.axes:
                raise unknown_name_error("axis", name, c.axes)
            axes["target"][c.axes.index(name)] = pulses

    def _compute_start_positions(self, stage_index: int, level: int, pulses_from_origin: np.ndarray) -> np.ndarray:
        """Compute the positions of the carriages at power-up, m, shape (axes,).

        Args:
            stage_index: Index of the stage, whose context has the angle of the rotors.
            level: Level of the episode, 0 to 3.
            pulses_from_origin: Distances from ORG in level 3, pulses, (m,). The other levels start at a fixed distance.
        """
        pulses = (
            pulses_from_origin
            if level == 3
            else np.full(len(self.axes), self.config.max_target_pulses + 2 * MAX_PULSES_BEFORE_ORIGIN)
        )
        at = self.origin + self.signed_pulse_m * pulses
        return (np.floor(at / self.turn) + float(self.context[stage_index]["switch"])) * self.turn

    def _place_carriages(self, stage_index: int, positions: np.ndarray) -> None:
        """Place the carriages of one stage at positions, m, shape (axes,), after its machine was drawn."""
        stage = self.stages[stage_index]
        self.apply_machine(stage_index)
        stage.place(**{name: float(q) for name, q in zip(self.config.axes, positions, strict=True)})

    @staticmethod
    def _parse_level(level: Any) -> int:
        """Return the index of a level that is given by its index or its name. Raises ArgumentError."""
        if isinstance(level, str) and level in LEVELS:
            return LEVELS.index(level)
        if isinstance(level, bool) or not isinstance(level, int | np.integer) or not 0 <= level < len(LEVELS):
            raise ArgumentError(f"option level={level!r}: 0 to 3, or {', '.join(LEVELS)}.")
        return int(level)

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {
            "level": int(self.episodes[stage_index]["level"]),
            "action_mask": self.action_masks()[stage_index],
            **self.describe_machine(stage_index),
        }


class BusMacrosEnv(StageEnv):
    """Gymnasium environment stage/BusMacros-v1: move axes to targets by macros, short programs of bus cycles."""

    task = BusMacros

    @property
    def macros(self) -> tuple[str, ...]:
        """Names of the macros, in the order of the actions."""
        return self._task.names  # type: ignore[attr-defined]

    def action_masks(self) -> np.ndarray:
        """Return which actions have an effect now, bool, as sb3-contrib expects."""
        return self._task.action_masks()[0] != 0  # type: ignore[attr-defined]


class BusMacrosVectorEnv(StageVectorEnv):
    """Vector environment stage/BusMacros-v1: move axes to targets by macros, short programs of bus cycles."""

    task = BusMacros

    @property
    def macros(self) -> tuple[str, ...]:
        """Names of the macros, in the order of the actions."""
        return self._task.names  # type: ignore[attr-defined]

    def action_masks(self) -> np.ndarray:
        """Return which actions have an effect now, (num_envs, actions) bool."""
        return self._task.action_masks() != 0  # type: ignore[attr-defined]
