"""Table of docs/envs_tasks.md: the tasks of the benchmark, played at random and by their scripted hosts, on every split.

python -m registerbench.baselines.task_table
python -m registerbench.baselines.task_table --tasks BusMacros OneShotTuning --splits train heavy --episodes 64

random     draws from the action space; in BusMacros only unmasked macros
scripted   takes `env.scripted_action()`: the engineer's formula at every attempt, the data sheet's registers, or the usual rates;
           it does not learn

Both play the episodes of the seeds from 1,000,000 on. A row has the mean sum of rewards with its 95 % interval by the bootstrap;
the number of successes with the median of their time and regret; and the means of moves, lost full steps and hit end limits.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import Any, get_type_hints

import gymnasium
import numpy as np

import stage.envs
from registerbench.baselines.few_shot_memory_gain import compute_interval
from stage.envs.step_results import SCORE

TASKS = {id_.split("/")[1].split("-")[0]: id_ for id_ in stage.envs.IDS if id_.endswith("-v1")}
PLAYERS = ("random", "scripted")
SEED, LANES = 1_000_000, 16
HEAD = (
    "| task | split | player | sum of rewards | success | time, s | regret | moves | steps lost | limits |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def list_splits(id_: str) -> tuple[str, ...]:
    """List the splits of a task.

    Args:
        id_: Id of the environment.
    """
    module, name = stage.envs.IDS[id_].split(":")
    task: Any = getattr(import_module(f"stage.envs.{module}"), name)
    (known,) = get_type_hints(task.Config, include_extras=True)["split"].__metadata__
    return tuple(known.choices)


def play_episodes(id_: str, player: str, episodes: int, **settings: Any) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Play episodes of an environment.

    Args:
        id_: Id of the environment.
        player: "random" or "scripted".
        episodes: Number of episodes.
        **settings: Settings of the environment.

    Returns:
        Sums of rewards, and scores by name, (episodes,) each.
    """
    totals, scores = [], []
    envs: Any = gymnasium.make_vec(
        id_, num_envs=LANES, vectorization_mode="vector_entry_point", autoreset_mode="Disabled", **settings
    ).unwrapped
    rng = np.random.default_rng(0)
    envs.action_space.seed(0)
    for begin in range(0, episodes, LANES):
        envs.reset(seed=SEED + begin)
        total, over = np.zeros(LANES), np.zeros(LANES, bool)
        scores_of_lane: list[Any] = [None] * LANES
        while not over.all():
            _, rewards, terminated, truncated, info = envs.step(choose_actions(envs, player, rng))
            total += np.where(over, 0.0, rewards)
            ends = (terminated | truncated) & ~over
            for k in np.flatnonzero(ends):
                scores_of_lane[k] = [info["score"][name][k] for name in SCORE.names or ()]
            over |= ends
            if over.any() and not over.all():
                # finished environments begin an episode that does not count, so that all can step
                again = terminated | truncated
                if again.any():
                    envs.reset(options={"reset_mask": again})
        totals.append(total)
        scores += scores_of_lane
    envs.close()
    columns = zip(SCORE.names or (), zip(*scores[:episodes], strict=True), strict=True)
    return np.concatenate(totals)[:episodes], {name: np.array(values) for name, values in columns}


def choose_actions(envs: Any, player: str, rng: np.random.Generator) -> np.ndarray:
    """Choose the next actions of a player that does not learn.

    Args:
        envs: Vector environment.
        player: "random" or "scripted".
        rng: Generator for masked random actions.
    """
    if player == "scripted":
        return np.asarray(envs.scripted_action())
    if hasattr(envs, "action_masks"):
        return np.array([rng.choice(np.flatnonzero(row)) for row in envs.action_masks()])
    return np.asarray(envs.action_space.sample())


def format_row(task: str, split: str, player: str, totals: np.ndarray, score: dict[str, np.ndarray]) -> str:
    """Format a row of the table of tasks and players.

    Args:
        task: Name of the task.
        split: Name of the split.
        player: Name of the player.
        totals: Sums of rewards, (episodes,).
        score: Scores by name, (episodes,) each.
    """
    low, high = compute_interval(totals)
    won = score["success"].astype(bool)
    medians = [f"{np.median(score[name][won]):.3f}" if won.any() else "-" for name in ("time", "regret")]
    means = [f"{score[name].mean():.1f}" for name in ("moves", "lost_steps", "limits")]
    cells = [
        task,
        split,
        player,
        f"{totals.mean():.2f} ({low:.2f} to {high:.2f})",
        f"{won.sum()} of {len(won)}",
        *medians,
        *means,
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", choices=TASKS, nargs="+", default=list(TASKS), help="which")
    parser.add_argument("--splits", nargs="+", default=None, metavar="SPLIT", help="default: all that a task has")
    parser.add_argument("--players", choices=PLAYERS, nargs="+", default=PLAYERS, help="who plays")
    parser.add_argument("--episodes", type=int, default=32, metavar="N", help="of each row")
    args = parser.parse_args()
    known = {name: list_splits(id_) for name, id_ in TASKS.items()}
    for split in args.splits or ():
        if not any(split in known[name] for name in args.tasks):
            parser.error(
                f"split {split!r}: these tasks have {', '.join(dict.fromkeys(s for n in args.tasks for s in known[n]))}."
            )
    print(HEAD)
    for name in args.tasks:
        for split in [s for s in args.splits or known[name] if s in known[name]]:
            for player in args.players:
                print(
                    format_row(name, split, player, *play_episodes(TASKS[name], player, args.episodes, split=split)),
                    flush=True,
                )


if __name__ == "__main__":
    main()
