"""Records of the results of a step, one record for each stage.

`StageEnv` reads a row of the array, `StageVectorEnv` its columns.

Tasks with a benchmark also have a score at the end of an episode, with the same names in all tasks:

    *_, info = env.step(action)
    if "score" in info:                  the episode is over
        print(info["score"])

    success      the task was done, as the task defines it
    time         s: of the best proved move if the task has proofs; else of the whole task; infinite without success
    regret       log(time / time of the formula). The formula is what a host can do that only reads data sheets and makes no
                 attempt. Below 0 if the player was faster; infinite without success
    moves        steps of the episode: moves, attempts, returns, or macros
    lost_steps   full steps lost in all, by all axes
    limits       moves that ended at an end limit

No host can know the score, so truth=False hides it like all truth.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from stage.envs.observation_features import TRUTH, Feature
from stage.native import record
from stage.support import portable_math

DIVERGED = -10.0  # reward of a step in which the simulation diverged
CAUSES = ("", "diverged")  # causes of an end that the task does not define, by their index in a record
SCORE = record(
    [("success", "?"), ("time", "f8"), ("regret", "f8"), ("moves", "i8"), ("lost_steps", "i8"), ("limits", "i8")]
)
SCORE_FEATURE = Feature(
    "score", TRUTH, "only at the end of an episode: success, time, regret, moves, lost_steps, limits"
)
FAILED = (False, np.inf, np.inf)
"""Success, time and regret of an episode without success."""


def make_step_result_dtype(
    parts: Sequence[str], info: Iterable[Feature], shapes: Mapping[str, tuple[int, ...]] | None = None
) -> np.dtype:
    """Make the dtype of the record that holds the results of one step of one stage.

    Args:
        parts: Names of the parts whose sum is the reward.
        info: Features of the info. With `SCORE_FEATURE` among them, there is a score at the end of an episode.
        shapes: Shapes of the features that are arrays, by name.

    Returns:
        A dtype with reward, terminated, truncated, cause, parts, info, and the score.
    """
    features = tuple(info)
    values = [(f.name, f.kind, (shapes or {}).get(f.name, ())) for f in features if f.kind is not None]
    score = [("score", SCORE)] if SCORE_FEATURE in features else []
    ends = [("reward", float), ("terminated", bool), ("truncated", bool), ("cause", int)]
    return record([*ends, ("parts", record([(name, float) for name in parts])), ("info", record(values)), *score])


def write_scores(rows: np.ndarray, time: Any, formula: Any, moves: Any, lost_steps: Any, limits: Any) -> None:
    """Fill the scores of stages.

    Args:
        rows: Records of `SCORE`, (n,).
        time: Time of the player, s; infinite without success.
        formula: Time of the formula for the same task, s.
        moves: Numbers of steps of the episodes.
        lost_steps: Full steps lost by all axes.
        limits: Numbers of moves that ended at an end limit.
    """
    rows["time"], rows["success"] = time, np.isfinite(time)
    rows["regret"] = portable_math.log(np.asarray(time, float) / formula)
    rows["moves"], rows["lost_steps"], rows["limits"] = moves, lost_steps, limits


class Results:
    """Results of the last step of n stages, one record for each.

    Args:
        n: Number of stages.
        dtype: Result of `make_step_result_dtype`.
        hidden: Names that an info leaves out.

    Attributes:
        rows: Records, (n,).
        scored: Whether the records have a score.
    """

    def __init__(self, n: int, dtype: np.dtype, hidden: frozenset[str] = frozenset()):
        self.rows, self._hidden = np.zeros(n, dtype), hidden
        self._parts, self._info = dtype["parts"].names or (), dtype["info"].names or ()
        self._arrays = [name for name in self._info if dtype["info"][name].shape]
        self.scored = "score" in (dtype.names or ())

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a column of the records by name; "parts", "info" and "score" are records with columns of their own."""
        return self.rows[name]

    def __setitem__(self, name: str, values: Any) -> None:
        self.rows[name] = values

    def finish(self, bad: np.ndarray) -> None:
        """Sum up the parts of the rewards, and end the episodes of stages whose simulation diverged.

        Args:
            bad: Mask of the stages that diverged, (n,).
        """
        rows, parts = self.rows, self.rows["parts"]
        rows["cause"], rows["reward"] = bad, 0.0
        for name in self._parts:
            parts[name][bad] = 0.0
            rows["reward"] += parts[name]
        rows["reward"][bad] = DIVERGED
        rows["terminated"] &= ~bad
        rows["truncated"] |= bad
        if self.scored:
            for name, value in zip(("success", "time", "regret"), FAILED, strict=True):
                rows["score"][name][bad] = value

    def read_row(self, stage_index: int) -> tuple[float, bool, bool, dict[str, Any]]:
        """Return reward, terminated, truncated and info of one stage."""
        reward, terminated, truncated, cause, parts, values, *score = self.rows.item(stage_index)
        info = dict(zip(self._info, values))  # noqa: B905 (the check would cost as much as all else)
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

    def read_columns(self, active: np.ndarray) -> dict[str, Any]:
        """Return the infos of all stages in Gymnasium's form: arrays by name, each with a mask of the stages that have the value.

        Args:
            active: Mask of the stages that took part in the step, (n,).
        """
        rows = self.rows.copy()
        rows[~active] = np.zeros((), rows.dtype)
        bad = rows["cause"] != 0
        info: dict[str, Any] = {name: rows["info"][name].copy() for name in self._info}
        info["cause"] = np.where(active, np.array(CAUSES, object)[rows["cause"]], None)
        parts = {name: rows["parts"][name].copy() for name in self._parts}
        if bad.any():
            parts["diverged"] = np.where(bad, rows["reward"], 0.0)
        info["reward_parts"] = _mask_values(parts, active)
        masked = _mask_values({name: value for name, value in info.items() if name not in self._hidden}, active)
        over = rows["terminated"] | rows["truncated"]
        if self.scored and over.any() and "score" not in self._hidden:
            scores = {name: np.where(over, rows["score"][name], 0).astype(SCORE[name]) for name in SCORE.names or ()}
            masked |= {"score": _mask_values(scores, over), "_score": over}
        return masked


def _mask_values(values: dict[str, Any], active: np.ndarray) -> dict[str, Any]:
    """Return values with a mask for each name, under the name with a leading underscore."""
    return {key: v for name, value in values.items() for key, v in ((name, value), (f"_{name}", active.copy()))}
