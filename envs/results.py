"""The results of a step: one record a stage. The scalar environment reads a row of them, the vector environment columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stage.envs.score import NONE, SCORE
from stage.native import record

DIVERGED = -10.0  # reward of a step in which the simulation diverged
CAUSES = ("", "diverged")  # of an end that is no part of the task, by the number in a record


def result(parts: Sequence[str], scored: bool = False, **info: Any) -> np.dtype:
    """The record of a step. parts: names of the reward's parts, whose sum it is; info: float, int, bool or (type, shape); scored:
    with a score at an episode's end, see score.py."""
    ends = [("reward", float), ("terminated", bool), ("truncated", bool), ("cause", int)]
    fields = [(name, *kind) if isinstance(kind, tuple) else (name, kind) for name, kind in info.items()]
    more = [("score", SCORE)] if scored else []
    return record([*ends, ("parts", record([(name, float) for name in parts])), ("info", record(fields)), *more])


class Results:
    """The records of n stages.

    rows: (n,) of `result`'s dtype. hidden: names that an info leaves out.
    """

    def __init__(self, n: int, dtype: np.dtype, hidden: frozenset[str] = frozenset()):
        self.rows, self._hidden = np.zeros(n, dtype), hidden
        self._parts, self._info = dtype["parts"].names or (), dtype["info"].names or ()
        self._arrays = [name for name in self._info if dtype["info"][name].shape]
        self.scored = "score" in (dtype.names or ())

    def __getitem__(self, name: str) -> np.ndarray:
        """A column; "parts", "info" and "score" have columns of their own."""
        return self.rows[name]

    def __setitem__(self, name: str, values: Any) -> None:
        self.rows[name] = values

    def end(self, bad: np.ndarray) -> None:
        """Sum the parts up, and put the stages right that diverged, a mask (n,)."""
        rows, parts = self.rows, self.rows["parts"]
        rows["cause"], rows["reward"] = bad, 0.0
        for name in self._parts:
            parts[name][bad] = 0.0
            rows["reward"] += parts[name]
        rows["reward"][bad] = DIVERGED
        rows["terminated"] &= ~bad
        rows["truncated"] |= bad
        if self.scored:
            for name, value in zip(("success", "time", "regret"), NONE, strict=True):
                rows["score"][name][bad] = value

    def row(self, k: int) -> tuple[float, bool, bool, dict[str, Any]]:
        """(reward, terminated, truncated, info) of stage k."""
        reward, terminated, truncated, cause, parts, said, *score = self.rows.item(k)
        info = dict(zip(self._info, said))  # noqa: B905 (the check would cost as much as all else)
        for name in self._arrays:
            info[name] = info[name].copy()
        info["cause"] = CAUSES[cause]
        info["reward_parts"] = named = dict(zip(self._parts, parts))  # noqa: B905
        if cause:
            named["diverged"] = reward
        if score and (terminated or truncated):
            info["score"] = dict(zip(SCORE.names or (), score[0], strict=True))
        for name in self._hidden:
            info.pop(name, None)
        return reward, terminated, truncated, info

    def columns(self, active: np.ndarray) -> dict[str, Any]:
        """`info` of all stages in Gymnasium's form: arrays, each with a mask of the stages that have it; 0 or None elsewhere."""
        rows = self.rows.copy()
        rows[~active] = np.zeros((), rows.dtype)
        bad = rows["cause"] != 0
        info: dict[str, Any] = {name: rows["info"][name].copy() for name in self._info}
        info["cause"] = np.where(active, np.array(CAUSES, object)[rows["cause"]], None)
        parts = {name: rows["parts"][name].copy() for name in self._parts}
        if bad.any():
            parts["diverged"] = np.where(bad, rows["reward"], 0.0)
        info["reward_parts"] = _masked(parts, active)
        told = _masked({name: value for name, value in info.items() if name not in self._hidden}, active)
        over = rows["terminated"] | rows["truncated"]
        if self.scored and over.any() and "score" not in self._hidden:
            scores = {name: np.where(over, rows["score"][name], 0).astype(SCORE[name]) for name in SCORE.names or ()}
            told |= {"score": _masked(scores, over), "_score": over}
        return told


def _masked(values: dict[str, Any], active: np.ndarray) -> dict[str, Any]:
    return {key: v for name, value in values.items() for key, v in ((name, value), (f"_{name}", active.copy()))}
