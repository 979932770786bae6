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

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from stage.envs.observation_features import TRUTH, Feature
from stage.native import record
from stage.support import portable_math

DIVERGENCE_REWARD = -10.0  # reward of a step in which the simulation diverged
CAUSES = ("", "diverged")  # causes of an end that the task does not define, by their index in a record
SCORE = record(
    [("success", "?"), ("time", "f8"), ("regret", "f8"), ("moves", "i8"), ("lost_steps", "i8"), ("limits", "i8")]
)
SCORE_FEATURE = Feature(
    "score", TRUTH, "only at the end of an episode: success, time, regret, moves, lost_steps, limits"
)
_STRUCT_FORMATS = {"|b1": "?", "|i1": "b", "<i8": "q", "<f8": "d"}
FAILED_EPISODE_SCORE = (False, np.inf, np.inf)
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


class StepResults:
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
        self.scored = "score" in (dtype.names or ())
        self._unpack_row, self._build_row = _make_row_reader(dtype, hidden)
        self._bytes = self.rows.view(np.uint8)

    def __reduce__(self) -> tuple:
        return StepResults, (len(self.rows), self.rows.dtype, self._hidden), self.rows

    def __setstate__(self, rows: np.ndarray) -> None:
        self.rows[...] = rows

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a column of the records by name; "parts", "info" and "score" are records with columns of their own."""
        return self.rows[name]

    def __setitem__(self, name: str, values: Any) -> None:
        self.rows[name] = values

    def compute_rewards(self, bad: np.ndarray) -> None:
        """Sum up the parts of the rewards, and end the episodes of stages whose simulation diverged.

        Args:
            bad: Mask of the stages that diverged, (n,).
        """
        rows, parts = self.rows, self.rows["parts"]
        rows["cause"], rows["reward"] = bad, 0.0
        for name in self._parts:
            parts[name][bad] = 0.0
            rows["reward"] += parts[name]
        rows["reward"][bad] = DIVERGENCE_REWARD
        rows["terminated"] &= ~bad
        rows["truncated"] |= bad
        if self.scored:
            for name, value in zip(("success", "time", "regret"), FAILED_EPISODE_SCORE, strict=True):
                rows["score"][name][bad] = value

    def read_row(self, stage_index: int) -> tuple[float, bool, bool, dict[str, Any]]:
        """Return reward, terminated, truncated and info of one stage."""
        row = self._build_row(*self._unpack_row(self._bytes, stage_index * self.rows.itemsize))
        reward, terminated, truncated, info = row
        if info["cause"] and "reward_parts" in info:
            info["reward_parts"]["diverged"] = reward
        if self.scored and (terminated or truncated) and "score" not in self._hidden:
            info["score"] = dict(zip(SCORE.names or (), self.rows["score"].item(stage_index), strict=True))
        return row

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


def _make_row_reader(dtype: np.dtype, hidden: frozenset[str]) -> tuple[Callable, Callable]:
    """Make the functions that read a record of results: from its bytes to its numbers, and from these to a row.

    The second is compiled from its source, as `namedtuple` does it, because most of a short step's time is spent here.

    Args:
        dtype: Result of `make_step_result_dtype`.
        hidden: Names that an info leaves out.
    """
    form, names, sources = "=", [], {"parts": [], "info": []}  # type: ignore[var-annotated]
    for group, name, kind in _list_numbers(dtype):
        form += _STRUCT_FORMATS.get(kind.str) or f"{kind.itemsize}s"
        names.append(f"v{len(names)}")
        value = names[-1]
        if kind.subdtype is not None:
            value = f"ndarray({kind.shape}, {kind.base.str!r}, bytearray({value}))"
        if group in sources and name not in hidden:
            sources[group].append(f"{name!r}: {value}")
    info = [*sources["info"], "'cause': CAUSES[v3]"]
    if "reward_parts" not in hidden:
        info.append(f"'reward_parts': {{{', '.join(sources['parts'])}}}")
    source = f"lambda {', '.join(names)}: (v0, v1, v2, {{{', '.join(info)}}})"
    return struct.Struct(form).unpack_from, eval(source, {"CAUSES": CAUSES, "ndarray": np.ndarray})


def _list_numbers(dtype: np.dtype, group: str = "") -> Iterator[tuple[str, str, np.dtype]]:
    """Yield record, name and type of each field of a packed record and of the records in it, in their order in memory."""
    for name in dtype.names or ():
        if dtype[name].names:
            yield from _list_numbers(dtype[name], name)
        else:
            yield group, name, dtype[name]


def _mask_values(values: dict[str, Any], active: np.ndarray) -> dict[str, Any]:
    """Return values with a mask for each name, under the name with a leading underscore."""
    return {key: v for name, value in values.items() for key, v in ((name, value), (f"_{name}", active.copy()))}
