"""`stage/RegisterBus-v0`: the agent is the host. An action is one bus cycle, or a wait; the chips do the rest.

action        MultiDiscrete [kind, chip, address, value]
              kind 0 writes `value` to `address` of a chip, kind 1 reads that address, kind 2 + k waits for waits[k].
              Numbers that a kind does not use are ignored. Addresses and values are those of the chip's bus: 0..3 and a byte on
              a PCL-240, one chip for each axis; 0..7 and a word of 16 bits on a NOVA chip, one chip for several axes; 0..63 and a
              byte on an HCTL-1100, one chip for each axis.
observation   float32 in [-1, 1]; for every chip in turn
              status bits b0.. as last read (PCL-240 8, NOVA 16: RR0, HCTL-1100 8: R07)
              last values read at the other addresses (3: bytes of a PCL-240's counter; 7: RR1..RR7), / the largest datum
              age of the values of all addresses (4; 8; 64): 0 never read, else 1 / (1 + age / 1 ms)
              then for each axis of the chip
              target / distances[1], pulses from the start; 0 with goal "home"
              and with truth=True, which no host knows: the carriage's
              position in its travel    velocity / 0.5 m/s    lost full steps / 64    error / its scale
              then once
              value of the last read / the largest    1 if the last action was a read    time / time_limit    actions / cycles
              and with truth=True and a split the machine, see machine_contexts.py
              With live=True, the addresses always show the present values (PCL-240: status and R0; NOVA: RR0 to RR7), the
              ages are 1, and no bus cycle is needed to read.
              With truth=False, the info has no truth either, see observation_features.py.
reward        the sum of
              progress   progress_weight x (potential now - potential before). The potential is minus the mean of the axes' errors
                         beyond the tolerance / scale (distances[1], or with "home" the distance from EL to EL), 0 at success
              time       - time_weight x s
              success    success_weight, once
              lost       - lost_weight for every lost full step, the first 64 of an episode
              failed     the rest of both costs, time_weight x s up to the time limit and lost_weight x full steps up to 64: charged
                         at the first action, and given back as time passes and steps are lost, or at success. So every failure
                         costs the same except for its progress: to use up the actions early, to wait, or to leave an episode
                         before its end (TimeLimit), is not better than a try that loses steps.
              A `discount` below 1 should be the learner's own. These parts are then paid in full at the end of the episode, and
              their sum is what the episode is worth. Until then, `progress` pays a loan: discount x loan now - loan before; at the
              end, - loan before. The loan is what the episode is worth if it fails here, at least minus the cost of a failure,
              divided by (1 + (1 - discount) x cycles). So the sum of the discounted rewards is discount^(steps - 1) x worth,
              whatever the loans were (potential-based shaping), and the plain sum differs from the worth by less than the largest
              worth.
episode       terminated at success: every axis has stopped, stands within `tolerance` of its goal, and (with "position") has
              lost no step. Truncated after `time_limit` s or `cycles` actions.
goal          "position": random targets, uniform on a log scale, in either direction from the position at power-up. That is the
              model's, except for the rotor's angle, which is drawn over an electrical turn (of a servo, over a count).
              "home": each carriage begins anywhere between its end limits, and must end where ORG trips.
split         None: the machine is the model's own. With a split, each episode has a machine that the host does not know, and
              perhaps a fault, drawn as in FewShotTuning (machine_contexts.py), and all rotors begin at its `switch`; model and chip
              are the split's unless they are set.
score         time: s, to success. formula: one move straight to the goal at the rates `usual` of BusMacros. limits: end limits hit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.envs import machine_contexts, machine_faults, settings
from stage.envs import register_bus_core as core
from stage.envs.compiled_task import CompiledTask
from stage.envs.hidden_machine_task import HiddenMachineTask, MachineSettings
from stage.envs.macro_programs import RATES
from stage.envs.move_trials import StartPositions, compute_move_time
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.step_results import DIVERGENCE_REWARD
from stage.errors import ArgumentError, unknown_name_error
from stage.firmware.driver import get_driver
from stage.sim import program
from stage.support import portable_math

WRITE, READ, WAIT = core.WRITE, core.READ, core.WAIT  # kinds of action; WAIT + k waits for waits[k]
GOALS = ("position", "home")
DEFAULT_DISTANCES_PULSES = (400, 8000)  # default range of the targets' distances, pulses
SCRIPTED_RATES = 2000, 24_000, 0.06  # start rate and drive rate, pps, and duration of a ramp, s, of the scripted host
SCRIPTED_WAIT_S = 1e-3  # longest wait of the scripted host
RANGES = ("payloads", "frictions", "supplies", "currents", "losses", "inductances", "drifts", "faults")
"""Settings of a split that an explicit value replaces."""
MAX_DISTANCE_SHARE = 0.9  # largest default distance of a target, as a share of the distance to the nearest end limit
START_LIMIT_CLEARANCE_M = 5e-4  # smallest distance between a start with goal "home" and an end limit


@dataclass(frozen=True)
class Config(MachineSettings):
    """Settings of RegisterBus, in addition to those of `MachineSettings`.

    Attributes:
        split: Name of the distribution of hidden machines; None: the model's own machine.
        axes: Names of the axes that have a chip; None: every axis of the model.
        goal: "position": drawn targets; "home": the place where ORG trips.
        waits: Durations that an action can wait, s.
        distances: Smallest and largest distance of a target for the goal "position", pulses; None: 400 to 8000, or as far as there
            is room.
        tolerance: Largest distance from the goal at success, pulses or counts; None: IN_POSITION of the chip's class (4, of a servo
            10).
        standing: Speed below which an axis counts as standing still, m/s.
        time_limit: Simulated time after which an episode is truncated, s.
        cycles: Number of actions after which an episode is truncated.
        live: Whether observations always show the present values of all addresses, without reads.
        discount: Discount of the learner for one action; 1 for none.
        progress_weight: Factor on the part `progress` of the reward.
        time_weight: Cost of a simulated second.
        success_weight: Reward of success.
        lost_weight: Cost of a lost full step.
    """

    FAULTS = (*machine_faults.HAMPERING_FAULTS, "bounce")
    split: Annotated[str, settings.ChoiceSetting(tuple(machine_contexts.SPLITS))] | None = None  # type: ignore[assignment]
    axes: Annotated[tuple[str, ...] | None, settings.NamesSetting(1)] = None
    goal: Annotated[str, settings.ChoiceSetting(GOALS)] = "position"
    waits: Annotated[tuple[float, ...], settings.NumbersSetting(exclude_low=True, high=settings.MAX_SECONDS)] = (
        1e-4,
        1e-3,
        1e-2,
        1e-1,
    )
    distances: settings.CountRange | None = None
    tolerance: settings.PositiveNumber = None  # type: ignore[assignment]  # pulses; None: IN_POSITION of the chip's class, 4, counts of a servo 10
    standing: settings.PositiveNumber = 1e-3
    time_limit: settings.Seconds = 30.0
    cycles: settings.Count = 2000
    live: settings.Boolean = False
    discount: settings.Discount = 1.0
    progress_weight: settings.Weight = 1.0
    time_weight: settings.Weight = 0.1
    success_weight: settings.Weight = 10.0
    lost_weight: settings.Weight = 0.05

    def __post_init__(self) -> None:
        is_default = self.tolerance is None
        if is_default:
            object.__setattr__(self, "tolerance", 1.0)  # replaced as soon as split and chip are checked
        super().__post_init__()
        if is_default:
            object.__setattr__(self, "tolerance", self.chip_class.IN_POSITION)
        if self.split is None and (names := [name for name in RANGES if getattr(self, name) is not None]):
            raise ArgumentError(
                f"{names[0]}={getattr(self, names[0])!r}: machines are drawn only with a split; add split='train'."
            )
        if max(self.waits) > self.time_limit:
            raise ArgumentError(f"waits={self.waits!r}: up to time_limit={self.time_limit!r} s.")
        low, high = self.distances or DEFAULT_DISTANCES_PULSES
        if not self.tolerance < low <= high:
            raise ArgumentError(f"distances={(low, high)!r}: (least, most) pulses, beyond the tolerance.")

    @property
    def chip_class(self) -> type[Chip]:
        """Class of the chips: that of the setting, or the split's."""
        return chip_class(machine_contexts.get_split_setting(self, "chip"))


class RegisterBus(HiddenMachineTask[Config], CompiledTask[Config]):
    """Rules of stage/RegisterBus-v0, whose steps run in compiled code (register_bus_core.py). The module docstring states them."""

    Config = Config
    OPTIONS = ("target", "start", *machine_contexts.RESET_OPTION_NAMES)
    """Options of a reset, which replace drawn values. target: {axis: signed pulses}; start: {axis: start position, m}; and, with
    a split, values of the machine."""
    STATE = ("context", "episodes", "axis_states", "words")
    OBSERVATION = (
        Feature("status", HOST, "bits of the status as last read, from b0", "chip"),
        Feature("words", HOST, "last value read at each other address / the largest datum", "chip"),
        Feature("ages", HOST, "age of the value of each address: 0 never read, otherwise 1 / (1 + age / 1 ms)", "chip"),
        Feature("target", HOST, 'pulses from the start / `distances[1]`; 0 with goal "home"', "axis"),
        Feature("place", TRUTH, "position of the carriage in its travel, from -1 to 1", "axis"),
        Feature("velocity", TRUTH, "velocity of the carriage / 0.5 m/s", "axis"),
        Feature("lost", TRUTH, "lost full steps / 64", "axis"),
        Feature("error", TRUTH, "distance from the goal / its scale", "axis"),
        Feature("value", HOST, "value of the last read / the largest datum"),
        Feature("was_read", HOST, "1 if the last action was a read"),
        Feature("time", HOST, "elapsed time / `time_limit`"),
        Feature("actions", HOST, "actions so far / `cycles`"),
        *machine_contexts.OBSERVATION_FEATURES,
    )
    CORE: ClassVar = core
    INFO = (
        *core.INFO_FEATURES,
        *(
            replace(f, text=f"{f.text}; with a split, in the info of a reset", kind=None)
            for f in machine_contexts.INFO_FEATURES
        ),
    )
    PARTS = core.REWARD_PARTS

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.axes)

    def make_stage(self, visuals: bool) -> Stage:
        c = self.config
        chip = c.chip_class
        chips = chip if c.axes is None else dict.fromkeys(c.axes, chip)
        return Stage(
            machine_contexts.get_split_setting(c, "model"), chips=chips, bus_cycle=c.bus_cycle, visuals=visuals
        )

    def make_spaces_and_arrays(self) -> None:
        c, n = self.config, self.n
        self.axes = list(self.stages[0].axes.values())
        m = len(self.axes)
        self.has_hidden_machine = c.split is not None
        self.context = np.zeros(n, machine_contexts.CONTEXT)
        if self.has_hidden_machine:
            if any(axis.drive.has_encoder or axis.unit != "m" for axis in self.axes):
                raise ArgumentError(f"split={c.split!r}: hidden machines are slides with steppers; leave split out.")
            self.prepare_contexts()
        self._scripts: dict[int, tuple[tuple[int, ...], np.ndarray]] = {}
        self.per_pulse = np.array([a.meters_per_pulse for a in self.axes])
        self.sign = np.array([np.sign(a.gear) for a in self.axes])  # direction of the joint for plus pulses
        self.full_step = np.array([self._compute_full_step_m(a) for a in self.axes])
        self.travel = np.array([a.travel for a in self.axes])
        self.limits = np.array([self._get_limit_positions(a) for a in self.axes])
        self.power_up = self.fleet.truth()["position"][0]
        self.turn = np.array([StartPositions(a).turn for a in self.axes])
        room_m = np.abs(self.limits - self.power_up[:, None]).min(axis=1) - self.turn
        room = (room_m / self.per_pulse).min()
        least, largest = DEFAULT_DISTANCES_PULSES
        self.distances = c.distances or (least, max(least, min(largest, int(MAX_DISTANCE_SHARE * room))))
        if c.goal == "home":
            self.origin = np.array([self._get_switch_position(a, "org") for a in self.axes])
            if np.isnan(self.origin).any():
                raise ArgumentError(f"axes {[a.name for a in self.axes]!r}: goal 'home' needs an ORG switch on each.")
            self.scale = self.limits[:, 1] - self.limits[:, 0]
            if (4 * c.tolerance * self.per_pulse > self.scale).any():
                raise ArgumentError(f"tolerance={c.tolerance!r}: between the end limits is no place to start from.")
        else:
            self.scale = self.distances[1] * self.per_pulse
            if self.distances[1] > room:
                raise ArgumentError(f"distances={self.distances!r}: there is room for {int(room)} pulses.")
        chip = self.axes[0].chip
        chips = list(dict.fromkeys(a.chip for a in self.axes))
        self.on_chip = np.array([chips.index(a.chip) for a in self.axes])
        self.first = np.array([self.on_chip.tolist().index(i) for i in range(len(chips))], np.int64)
        self._bus = {"bits": chip.DATA_MASK.bit_length(), "status": chip.BUSY[0], "most": chip.DATA_MASK}
        choices = [2 + len(c.waits), len(chips), chip.ADDRESSES, chip.DATA_MASK + 1]
        self.action_space = gymnasium.spaces.MultiDiscrete(choices)
        width = len(self.observation_features)
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (width,), np.float32)
        self.waits = np.array([round(w * 1e9) for w in c.waits], np.int64)  # ns
        self._fill_rule_records()
        self.episodes, self.axis_states = np.zeros(n, core.EPISODE), np.zeros((n, m), core.AXIS_STATE)
        self.words = np.zeros((n, len(chips), chip.ADDRESSES), core.WORD_READ)
        self.make_step_arrays(m, operation_count=1)

    def _fill_rule_records(self) -> None:
        """Fill the records from which compiled code reads the settings of the environment."""
        c = self.config
        self.rules, self.axis_rules = np.zeros(1, core.TASK_PARAMETERS), np.zeros(len(self.axes), core.AXIS_PARAMETERS)
        rules = {name: getattr(c, name) for name in core.SETTINGS} | {"truth": c.truth is True}
        rules |= self._bus | {
            "distance": self.distances[1],
            "duration": c.time_limit * 1e9,
            "limit": round(c.time_limit * 1e9),
        }
        for name, value in {**rules, "home": c.goal == "home", "diverged": DIVERGENCE_REWARD}.items():
            self.rules[name] = value
        of_axes = {
            "near": c.tolerance * self.per_pulse, "per_pulse": self.per_pulse, "full_step": self.full_step,
            "scale": self.scale, "low": self.travel[:, 0], "high": self.travel[:, 1], "chip": self.on_chip,
            "limits": [sum({axis.chip.find_switch_input(pin) for pin in ("el_minus", "el_plus")}) for axis in self.axes],
        }  # fmt: skip
        for name, values in of_axes.items():
            self.axis_rules[name] = values

    def list_frame_values(self) -> dict[str, Any]:
        return {
            "rules": self.rules, "axis_rules": self.axis_rules, "waits": self.waits, "episodes": self.episodes,
            "axes": self.axis_states, "words": self.words, "first": self.first, "n_axes": len(self.axes),
            "n_waits": len(self.waits), "n_chips": self.words.shape[1], "n_addresses": self.words.shape[2],
        }  # fmt: skip

    def list_all_features(self) -> list[Feature]:
        machine = machine_contexts.OBSERVATION_FEATURES
        status, words, ages, target, *truth, value, was_read, time, actions = self.OBSERVATION[: -len(machine)]
        addresses = self.axes[0].chip.ADDRESSES
        features: list[Feature] = []
        for a, i in enumerate(self.on_chip):
            if a == 0 or i != self.on_chip[a - 1]:
                features += [status] * self._bus["bits"] + [words] * (addresses - 1) + [ages] * addresses
            features += [target, *truth]
        return [*features, value, was_read, time, actions, *(machine if self.has_hidden_machine else ())]

    @staticmethod
    def _compute_full_step_m(axis: Any) -> float:
        """Compute the travel of the carriage in a full step, m; 0 for a servo."""
        return 0.0 if axis.drive.has_encoder else 0.5 * np.pi / (axis.drive.motor.rotor_teeth * axis.gear)

    @staticmethod
    def _get_switch_position(axis: Any, pin: str) -> float:
        """Return the position at which a switch of an axis trips, m; NaN if the axis does not have it."""
        return next((s.touch for s in axis.plant.switches if s.pin == pin), np.nan)

    def _get_limit_positions(self, axis: Any) -> tuple[float, float]:
        """Return the positions at which the end limits of an axis trip, m; without a limit, the end of the travel."""
        low, high = self._get_switch_position(axis, "el_minus"), self._get_switch_position(axis, "el_plus")
        return axis.travel[0] if np.isnan(low) else low, axis.travel[1] if np.isnan(high) else high

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        start, target = self._draw_start_and_target(stage_index, options)
        for j, q in self._read_options_by_axis("start", options, (int, float)):
            start[j] = q
        for j, pulses in self._read_options_by_axis("target", options, (int, np.integer)):
            target[j] = pulses
        if not ((self.travel[:, 0] <= start) & (start <= self.travel[:, 1])).all():
            raise ArgumentError(f"option start={options.get('start')!r}: m, within the travel {self.travel.tolist()}.")
        goal = self.origin if self.config.goal == "home" else start + self.sign * self.per_pulse * target
        if not ((self.limits[:, 0] < goal) & (goal < self.limits[:, 1])).all():
            raise ArgumentError(f"options {dict(options)!r}: the target lies beyond an end limit.")
        stage = self.stages[stage_index]
        for axis, q, at in zip(self.axes, start, self.power_up, strict=True):
            if q != at:
                stage.place(**{axis.name: float(q)})
        indices = self.axis_states[stage_index]
        indices["target"], indices["goal"], indices["lost"] = target, goal, 0
        self.words[stage_index]["seen"], self.words[stage_index]["when"] = 0, -1
        distances = np.maximum(np.rint(np.abs(goal - start) / self.per_pulse), 1.0)
        self.episodes["usual"][stage_index] = compute_move_time(distances, *RATES["usual"]).max()
        if self.has_hidden_machine and self.config.truth is True:
            count = len(machine_contexts.OBSERVATION_FEATURES)  # compiled code leaves these numbers as they are
            self.observations[stage_index, -count:] = self.machine_features[stage_index]
        self.judge_and_observe(stage_index, stage_index + 1, True)

    def _draw_start_and_target(self, stage_index: int, options: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Draw starts, m, and targets, pulses, of the axes, and with a split the machine of the episode, which it applies."""
        c, rng, m = self.config, self.rngs[stage_index], len(self.axes)
        if c.goal == "home":
            start, target = self._draw_start_positions(rng), np.zeros(m, np.int64)
        else:
            low, high = portable_math.log(self.distances)
            distance = np.rint(portable_math.exp(rng.uniform(low, high, m))).astype(np.int64)
            target = distance * rng.choice((-1, 1), m)
            start = (np.floor(self.power_up / self.turn) + rng.uniform(size=m)) * self.turn
        if self.has_hidden_machine:
            self.draw_machine(stage_index, options)
            self.apply_machine(stage_index)
            if c.goal == "position":
                start = (np.floor(self.power_up / self.turn) + float(self.context[stage_index]["switch"])) * self.turn
        elif names := [name for name in machine_contexts.RESET_OPTION_NAMES if name in options]:
            raise ArgumentError(
                f"option {names[0]}={options[names[0]]!r}: without a split, the machine is the model's own."
            )
        return start, target

    def _draw_start_positions(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a start position for each axis, m: between the end limits, and not within the tolerance of the origin."""
        while True:
            q = rng.uniform(self.limits[:, 0] + START_LIMIT_CLEARANCE_M, self.limits[:, 1] - START_LIMIT_CLEARANCE_M)
            if (np.abs(q - self.origin) > self.config.tolerance * self.per_pulse).all():
                return q

    def _read_options_by_axis(
        self, name: str, options: Mapping[str, Any], kinds: tuple[type, ...]
    ) -> list[tuple[int, Any]]:
        """Read an option of a reset that maps names of axes to values.

        Args:
            name: Name of the option, "start" or "target".
            options: Options of the reset.
            kinds: Allowed types of a value.

        Returns:
            Pairs of the index of an axis and its value.

        Raises:
            ArgumentError: The option is not such a mapping.
        """
        values = options.get(name, {})
        names = [a.name for a in self.axes]
        if not isinstance(values, Mapping) or (name == "target" and values and self.config.goal == "home"):
            raise ArgumentError(f"option {name}={values!r}: a mapping axis -> value; goal 'home' has no target.")
        for axis, value in values.items():
            if axis not in names:
                raise unknown_name_error("axis", axis, names)
            if isinstance(value, bool) or not isinstance(value, kinds):
                raise ArgumentError(f"option {name}={values!r}: pulses are whole numbers, places are metres.")
        return [(names.index(axis), value) for axis, value in values.items()]

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        machine = self.describe_machine(stage_index) if self.has_hidden_machine else {}
        return {"target": self.axis_states["target"][stage_index].copy(), **machine}

    def apply_machine(self, stage_index: int) -> None:
        if self.has_hidden_machine:
            super().apply_machine(stage_index)

    def scripted_action(self) -> np.ndarray:
        """Return the next actions of a host that writes and starts one move of each axis at SCRIPTED_RATES, and then waits."""
        if self.config.goal == "home" or any(axis.drive.has_encoder for axis in self.axes):
            raise ArgumentError("the scripted host of RegisterBus makes moves of steppers with the goal 'position'.")
        return np.stack([self._choose_scripted_action(k) for k in range(self.n)])

    def _choose_scripted_action(self, stage_index: int) -> np.ndarray:
        """Choose the next action of the scripted host on one stage, by the number of its steps."""
        targets = tuple(self.axis_states["target"][stage_index].tolist())
        if self._scripts.get(stage_index, ((), None))[0] != targets:
            self._scripts[stage_index] = targets, self._make_script(targets)
        script, step = self._scripts[stage_index][1], int(self.steps[stage_index])
        return script[min(step, len(script) - 1)]

    def _make_script(self, targets: Sequence[int]) -> np.ndarray:
        """Make the actions that write and start the moves to some targets, (actions, 4); the last one, a wait, is repeated."""
        start, drive, ramp = SCRIPTED_RATES
        host = program.Program()
        for axis, pulses in zip(self.axes, targets, strict=True):
            driver = get_driver(axis)
            values = driver.compute_move_registers(start, drive, ramp, ramp, abs(pulses), s_curve=False)
            driver.write_move(host, values, pulses)
        chip_of = dict(zip((axis.index for axis in self.axes), self.on_chip.tolist(), strict=True))
        waits = self.waits.tolist()
        wait_ns = max((w for w in waits if w <= SCRIPTED_WAIT_S * 1e9), default=min(waits))
        actions = []
        for kind, a, address, value in host.ops:
            if kind == program.WRITE:
                actions.append((WRITE, chip_of[a], address, value))
            elif kind == program.WAIT:
                actions.append((WAIT + waits.index(min((w for w in waits if w >= a), default=max(waits))), 0, 0, 0))
        actions.append((WAIT + waits.index(wait_ns), 0, 0, 0))
        return np.array(actions, np.int64)


class RegisterBusEnv(StageEnv):
    """Gymnasium environment stage/RegisterBus-v0: the agent is the host, and an action is one bus cycle or a wait."""

    task = RegisterBus


class RegisterBusVectorEnv(StageVectorEnv):
    """Vector environment stage/RegisterBus-v0: the agent is the host, and an action is one bus cycle or a wait."""

    task = RegisterBus
