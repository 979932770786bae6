"""The actions of RegisterBench's environments as arguments of a tool, in pps, seconds and names; and observations by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from registerbench.episodes import Episodes
from stage.agents.fields import FLAG, NUMBER, NUMBERS, TEXT, WHOLE, Field
from stage.envs import drifting_home, few_shot
from stage.errors import ArgumentError


def rates_of(action: np.ndarray) -> dict[str, float]:
    """Return the rates and ramps of an action of few-shot or one-shot, as arguments of a tool."""
    return {
        name: from_log_scale(value, ends)
        for name, value, ends in zip(few_shot.RATES, action, few_shot.RATES.values(), strict=True)
    }


def from_log_scale(value: float, ends: Sequence[float]) -> float:
    """Return the number that -1 to 1 stands for on a logarithmic scale between two ends."""
    low, high = np.log(ends)
    return float(np.clip(np.exp(low + (high - low) * (value + 1) / 2), ends[0], ends[1]))


class Hands:
    """Of a task: what `act` takes. says: it, in a sentence."""

    says: str

    def __init__(self, played: Episodes):
        self._played, self._env = played, played.env
        self._names = [e.name for e in played.env.entries]

    def fields(self) -> tuple[Field, ...]:
        """Arguments of `act`."""
        raise NotImplementedError

    def action(self, **given: Any) -> Any:
        """The environment's action of these."""
        raise NotImplementedError

    def formula(self) -> dict[str, Any]:
        """What the task's scripted host does now, as arguments."""
        raise NotImplementedError

    def idle(self) -> Any:
        """The action of somebody who has gone."""
        return np.zeros(self._env.action_space.shape, self._env.action_space.dtype)

    def observed(self) -> dict[str, Any]:
        """Observation and info, what a host may know of them. Numbers of one name are a list."""
        numbers: dict[str, Any] = {}
        for name, value in zip(self._names, self._played.observation.tolist(), strict=True):
            numbers.setdefault(name, []).append(round(value, 6))
        return {
            "observation": {name: v[0] if len(v) == 1 else v for name, v in numbers.items()},
            "info": {name: plain(v) for name, v in self._played.info.items()},
        }


class Move(Hands):
    """few-shot, one-shot: rates and ramps."""

    says = "a whole move with these rates (pps) and ramps (s)."

    def fields(self) -> tuple[Field, ...]:
        units = {"start": "pps", "drive": "pps", "up": "s", "down": "s"}
        titles = {"start": "start rate", "drive": "drive rate", "up": "ramp up", "down": "ramp down"}
        return tuple(
            Field(name, NUMBER, titles[name], True, low=low, high=high, unit=units[name])
            for name, (low, high) in few_shot.RATES.items()
        )

    def action(self, **given: Any) -> Any:
        return few_shot.action_of(**given)

    def formula(self) -> dict[str, Any]:
        return rates_of(self._env.scripted().astype(float))


class Home(Hands):
    """home: an origin return, or the report of a fault."""

    says = "an origin return with these rates, or, with report=true, the report that the machine is broken, which ends the episode."

    def fields(self) -> tuple[Field, ...]:
        low = {name: ends[0] for name, ends in drifting_home.RATES.items()}
        high = {name: ends[1] for name, ends in drifting_home.RATES.items()}
        usual = drifting_home.USUAL
        least, most = drifting_home.BACK_OFF
        made = [
            Field(name, NUMBER, text, default=float(usual[name]), low=low[name], high=high[name], unit=unit)
            for name, text, unit in (
                ("search", "rate", "pps"),
                ("ramp", "ramps", "s"),
                ("approach", "rate of the approach", "pps"),
            )
        ]
        return (
            *made,
            Field("leave", WHOLE, "pulses by which ORG is left first", default=0, low=0, high=drifting_home.LEAVE),
            Field("back_off", WHOLE, "pulses before the approach", default=int(usual["back_off"]), low=least, high=most),
            Field("report", FLAG, "say that the machine is broken", default=False),
        )  # fmt: skip

    def action(self, **given: Any) -> Any:
        return drifting_home.action_of(**given)

    def formula(self) -> dict[str, Any]:
        return {**drifting_home.USUAL, "report": bool(self._env.scripted()[-1] > 0)}


class Line(Hands):
    """line, line-3: rate, ramps, and corrections to the registers."""

    says = "a straight line with this rate and ramp; corrections from -1 to 1 change the data sheet's registers, 0 leaves them."

    def fields(self) -> tuple[Field, ...]:
        c = self._env.config
        size = self._env.action_space.shape[0] - 2
        return (
            Field("rate", NUMBER, "peak rate of the longest axis", True, low=float(c.rates[0]), high=float(c.rates[1]), unit="pps"),
            Field("ramp", NUMBER, "of each ramp", True, low=float(c.ramps[0]), high=float(c.ramps[1]), unit="s"),
            Field("corrections", NUMBERS, f"{size} of them, six an axis", low=-1.0, high=1.0),
        )  # fmt: skip

    def action(self, **given: Any) -> Any:
        rate, ramp, corrections = given["rate"], given["ramp"], given.get("corrections")
        made = np.zeros(self._env.action_space.shape, np.float32)
        for j, (value, ends) in enumerate(((rate, self._env.config.rates), (ramp, self._env.config.ramps))):
            low, high = np.log(ends)
            made[j] = np.clip(2 * (np.log(value) - low) / max(high - low, 1e-9) - 1, -1, 1)
        if corrections is not None:
            if len(corrections) != len(made) - 2:
                raise ArgumentError(
                    f"corrections: {len(corrections)} numbers; {len(made) - 2} are wanted, six for each axis."
                )
            made[2:] = corrections
        return made

    def formula(self) -> dict[str, Any]:
        rate, ramp, *_ = self._env.scripted().astype(float)
        c = self._env.config
        return {"rate": from_log_scale(rate, c.rates), "ramp": from_log_scale(ramp, c.ramps)}


class Macro(Hands):
    """bus, bus-target: a phrase of bus cycles."""

    says = "a phrase of bus cycles on the axis that is selected; what has no effect now is told as masked."

    def fields(self) -> tuple[Field, ...]:
        return (Field("macro", TEXT, "the phrase", True, choices=tuple(self._env.macros)),)

    def action(self, **given: Any) -> Any:
        return np.int64(self._env.macros.index(given["macro"]))

    def formula(self) -> dict[str, Any]:
        return {"macro": self._env.macros[int(self._env.scripted())]}

    def idle(self) -> Any:
        return np.int64(int(np.argmax(np.asarray(self._played.info["action_mask"]) == 0)))

    def observed(self) -> dict[str, Any]:
        said = super().observed()
        mask = said["info"].pop("action_mask")
        said["has_an_effect"] = [name for name, on in zip(self._env.macros, mask, strict=True) if on]
        return said


KINDS: dict[str, type[Hands]] = {
    "few-shot": Move,
    "few-shot-wide": Move,
    "one-shot": Move,
    "home": Home,
    "line": Line,
    "line-3": Line,
}
"""By the name of the card."""


def hands_of(played: Episodes) -> Hands:
    """Of the task that is played. Raises ArgumentError for one without."""
    if played.card.name in KINDS:
        return KINDS[played.card.name](played)
    if isinstance(played.env.action_space, gymnasium.spaces.Discrete) and hasattr(played.env, "macros"):
        return Macro(played)
    raise ArgumentError(f"task {played.card.name}: nobody has said yet how its actions are called.")


def plain(value: Any) -> Any:
    """As JSON has it."""
    if isinstance(value, np.ndarray):
        return [plain(v) for v in value.tolist()]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
