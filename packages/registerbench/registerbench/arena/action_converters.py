"""Actions of the environments as arguments of the tool `act`, in pps, seconds and names, and observations by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from registerbench.entry_creation import EpisodeSequence
from stage.agents.tool_arguments import Flag, argument, choice, integer, list_of, number
from stage.envs import drifting_home, few_shot
from stage.errors import ArgumentError


def convert_action_to_rates(action: np.ndarray) -> dict[str, float]:
    """Convert an action of few-shot or one-shot to the rates (pps) and ramps (s) of a move, by name."""
    return {
        name: from_log_scale(value, ends)
        for name, value, ends in zip(few_shot.ACTION_RANGES, action, few_shot.ACTION_RANGES.values(), strict=True)
    }


def from_log_scale(value: float, ends: Sequence[float]) -> float:
    """Convert a number from -1 to 1 to the value at this place of a logarithmic scale.

    Args:
        value: Number from -1 to 1.
        ends: Values at both ends of the scale.
    """
    low, high = np.log(ends)
    return float(np.clip(np.exp(low + (high - low) * (value + 1) / 2), ends[0], ends[1]))


def to_log_scale(value: float, ends: Sequence[float]) -> float:
    """Convert a value to its place on a logarithmic scale, from -1 to 1.

    Args:
        value: The value.
        ends: Values at both ends of the scale.
    """
    low, high = np.log(ends)
    return float(np.clip(2 * (np.log(value) - low) / max(high - low, 1e-9) - 1, -1, 1))


class ActionConverter:
    """Base class of converters between the actions of a task and the arguments of the tool `act`.

    Attributes:
        description: Description of the tool `act`, as a phrase.
    """

    description: str

    def __init__(self, sequence: EpisodeSequence):
        self._sequence, self._env = sequence, sequence.env
        self._names = [e.name for e in sequence.env.observation_features]

    def describe_arguments(self) -> dict[str, Any]:
        """Return the schema of the arguments of `act`, by name."""
        raise NotImplementedError

    def make_action(self, **values: Any) -> Any:
        """Convert arguments of `act` to an action of the environment."""
        raise NotImplementedError

    def choose_formula_arguments(self) -> dict[str, Any]:
        """Return the action of the task's scripted host as arguments of `act`."""
        raise NotImplementedError

    def choose_idle_action(self) -> Any:
        """Return the action with which an episode is played to its end after its player has left."""
        return np.zeros(self._env.action_space.shape, self._env.action_space.dtype)

    def describe_observation(self) -> dict[str, Any]:
        """Return observation and info by name; several numbers of one name become a list."""
        numbers: dict[str, Any] = {}
        for name, value in zip(self._names, self._sequence.observation.tolist(), strict=True):
            numbers.setdefault(name, []).append(round(value, 6))
        return {
            "observation": {name: v[0] if len(v) == 1 else v for name, v in numbers.items()},
            "info": {name: to_json(v) for name, v in self._sequence.info.items()},
        }


class MoveActionConverter(ActionConverter):
    """Converter of the rates and ramps of a move, for the tasks few-shot and one-shot."""

    description = "a whole move with these rates (pps) and ramps (s)."

    def describe_arguments(self) -> dict[str, Any]:
        titles = {"start": "start rate, pps", "drive": "drive rate, pps", "up": "ramp up, s", "down": "ramp down, s"}
        return {n: argument(number(ge=low, le=high), titles[n]) for n, (low, high) in few_shot.ACTION_RANGES.items()}

    def make_action(self, **values: Any) -> Any:
        return few_shot.make_action(**values)

    def choose_formula_arguments(self) -> dict[str, Any]:
        return convert_action_to_rates(self._env.scripted_action().astype(float))


class HomeActionConverter(ActionConverter):
    """Converter of the arguments of the tool `act` to actions of the task home: an origin return, or the report of a fault."""

    description = (
        "an origin return with these rates, or, with report=true, the report that the machine is broken, "
        "which ends the episode."
    )

    def describe_arguments(self) -> dict[str, Any]:
        usual, (least, most) = drifting_home.USUAL_RETURN, drifting_home.BACK_OFF
        titles = {"search": "rate, pps", "ramp": "ramps, s", "approach": "rate of the approach, pps"}
        ends = {name: number(ge=low, le=high) for name, (low, high) in drifting_home.ACTION_RANGES.items()}
        rates = {name: argument(ends[name], text, float(usual[name])) for name, text in titles.items()}
        return {
            **rates,
            "leave": argument(integer(0, drifting_home.LEAVE), "pulses by which ORG is left first", 0),
            "back_off": argument(integer(least, most), "pulses before the approach", int(usual["back_off"])),
            "report": argument(Flag, "say that the machine is broken", False),
        }

    def make_action(self, **values: Any) -> Any:
        return drifting_home.make_action(**values)

    def choose_formula_arguments(self) -> dict[str, Any]:
        action = self._env.scripted_action().astype(float)
        rates = {
            n: from_log_scale(a, ends)
            for a, (n, ends) in zip(action, drifting_home.ACTION_RANGES.items(), strict=False)
        }
        leave, back_off = (
            drifting_home.LEAVE * ((action[3] + 1) / 2) ** 3,
            from_log_scale(action[4], drifting_home.BACK_OFF),
        )
        return {**rates, "leave": round(leave), "back_off": round(back_off), "report": bool(action[5] > 0)}


class LineActionConverter(ActionConverter):
    """Converter of the rate, ramp and corrections of the registers, for the tasks line and line-3."""

    description = (
        "a straight line with this rate and ramp; corrections from -1 to 1 change the data sheet's registers, "
        "0 leaves them."
    )

    def describe_arguments(self) -> dict[str, Any]:
        rates, ramps = ([float(end) for end in ends] for ends in (self._env.config.rates, self._env.config.ramps))
        size = self._env.action_space.shape[0] - 2
        return {
            "rate": argument(number(ge=rates[0], le=rates[1]), "peak rate of the longest axis, pps"),
            "ramp": argument(number(ge=ramps[0], le=ramps[1]), "of each ramp, s"),
            "corrections": argument(list_of(number(ge=-1.0, le=1.0)), f"{size} of them, six an axis", None),
        }

    def make_action(self, **values: Any) -> Any:
        rate, ramp, corrections = values["rate"], values["ramp"], values.get("corrections")
        action = np.zeros(self._env.action_space.shape, np.float32)
        action[:2] = to_log_scale(rate, self._env.config.rates), to_log_scale(ramp, self._env.config.ramps)
        if corrections is not None:
            if len(corrections) != len(action) - 2:
                raise ArgumentError(
                    f"corrections: {len(action) - 2} numbers are needed, six for each axis, not {len(corrections)}."
                )
            action[2:] = corrections
        return action

    def choose_formula_arguments(self) -> dict[str, Any]:
        rate, ramp, *_ = self._env.scripted_action().astype(float)
        c = self._env.config
        return {"rate": from_log_scale(rate, c.rates), "ramp": from_log_scale(ramp, c.ramps)}


class MacroActionConverter(ActionConverter):
    """Converter of the choice of a macro, for the tasks whose name begins with bus."""

    description = "a phrase of bus cycles on the axis that is selected; what has no effect now is told as masked."

    def describe_arguments(self) -> dict[str, Any]:
        return {"macro": argument(choice(tuple(self._env.macros)), "the phrase")}

    def make_action(self, **values: Any) -> Any:
        return np.int64(self._env.macros.index(values["macro"]))

    def choose_formula_arguments(self) -> dict[str, Any]:
        return {"macro": self._env.macros[int(self._env.scripted_action())]}

    def choose_idle_action(self) -> Any:
        return np.int64(int(np.argmax(np.asarray(self._sequence.info["action_mask"]) == 0)))

    def describe_observation(self) -> dict[str, Any]:
        answer = super().describe_observation()
        mask = answer["info"].pop("action_mask")
        answer["has_an_effect"] = [name for name, on in zip(self._env.macros, mask, strict=True) if on]
        return answer


class BusCycleActionConverter(ActionConverter):
    """Converter of a bus cycle or a wait, for the task bus-cycles."""

    description = "one bus cycle on a chip, or a wait; a read shows its value in the next observation."

    def __init__(self, sequence: EpisodeSequence):
        super().__init__(sequence)
        self._kinds = ("write", "read", *(f"wait {1e3 * wait:g} ms" for wait in self._env.task_instance.config.waits))

    def describe_arguments(self) -> dict[str, Any]:
        _, chips, addresses, values = self._env.action_space.nvec.tolist()
        return {
            "kind": argument(choice(self._kinds), "write, read or the time to wait"),
            "chip": argument(integer(0, chips - 1), "index of the chip", 0),
            "address": argument(integer(0, addresses - 1), "address of the chip's bus", 0),
            "value": argument(integer(0, values - 1), "datum to write", 0),
        }

    def make_action(self, **values: Any) -> Any:
        return np.array(
            [self._kinds.index(values["kind"]), values["chip"], values["address"], values["value"]], np.int64
        )

    def choose_formula_arguments(self) -> dict[str, Any]:
        kind, chip, address, value = self._env.scripted_action().tolist()
        return {"kind": self._kinds[kind], "chip": chip, "address": address, "value": value}

    def choose_idle_action(self) -> Any:
        return np.array([len(self._kinds) - 1, 0, 0, 0], np.int64)


CONVERTERS: dict[str, type[ActionConverter]] = {
    **dict.fromkeys(("few-shot", "few-shot-wide", "one-shot"), MoveActionConverter),
    "home": HomeActionConverter,
    "bus-cycles": BusCycleActionConverter,
    **dict.fromkeys(("line", "line-3"), LineActionConverter),
}
"""Class of converter by the name of the card."""


def make_action_converter(sequence: EpisodeSequence) -> ActionConverter:
    """Make the converter for the task of a sequence of episodes. Raises ArgumentError for a task without one."""
    if sequence.card.name in CONVERTERS:
        return CONVERTERS[sequence.card.name](sequence)
    if isinstance(sequence.env.action_space, gymnasium.spaces.Discrete) and hasattr(sequence.env, "macros"):
        return MacroActionConverter(sequence)
    raise ArgumentError(
        f"Task {sequence.card.name}: its actions have no form as a tool yet; give it one in {__name__}.CONVERTERS."
    )


def to_json(value: Any) -> Any:
    """Convert a value of an info to a JSON value; infinite numbers and NaN become None."""
    if isinstance(value, np.ndarray):
        return [to_json(v) for v in value.tolist()]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
