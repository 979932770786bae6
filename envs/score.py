"""`info["score"]`: what a benchmark reads at the end of an episode, by the same names in every task that has one.

    *_, info = env.step(action)
    if "score" in info:                  the episode is over
        print(info["score"])

    success      the task was done, as the task defines it
    time         s: of the best move that was proved, where a task proves; else what the task took; infinite without success
    regret       log(time / the time of the formula), what a host gets that tries nothing and looks nothing up but data sheets;
                 below 0 where the player was faster; infinite without success
    moves        steps of the episode: moves, tries, returns, or macros
    lost_steps   full steps lost in all, by all axes
    limits       moves that ended at an end limit

The judge knows them, no host does: with truth=False they are left out as all truth is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.envs.entries import TRUTH, Entry
from stage.native import record
from stage.support import portable

SCORE = record(
    [("success", "?"), ("time", "f8"), ("regret", "f8"), ("moves", "i8"), ("lost_steps", "i8"), ("limits", "i8")]
)
ENTRY = Entry("score", TRUTH, "at the end of an episode alone: success, time, regret, moves, lost_steps, limits")
NONE = (False, np.inf, np.inf)
"""success, time and regret of an episode that came to nothing."""


def note(rows: np.ndarray, time: Any, formula: Any, moves: Any, lost_steps: Any, limits: Any) -> None:
    """Fill scores, (n,). time: s, infinite without success; formula: s, its time for the same."""
    rows["time"], rows["success"] = time, np.isfinite(time)
    rows["regret"] = portable.log(np.asarray(time, float) / formula)
    rows["moves"], rows["lost_steps"], rows["limits"] = moves, lost_steps, limits
