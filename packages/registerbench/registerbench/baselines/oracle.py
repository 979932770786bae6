"""The oracle: a search on the true machine of each test episode, the upper end of the normalized score.

python -m registerbench.baselines.oracle -o entries --tasks one-shot home --splits train weak --tries 256

It begins with the actions of the task's scripted host, and with a report if the machine has a fault that is to be reported. Then it
changes them by normal numbers, keeps the best, and narrows the search when nothing better comes. In a task of several attempts,
each try is an episode of one attempt, on the reduced model; the best PARALLEL_ENVS of them are then played as whole episodes on
the machine itself, with attempts that are all the same, and the best of these counts. The oracle plays every try on the machine
of the test episode, which no player may do; the entry states the number of steps as its cost, and is on the track truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from registerbench.baselines import exit_on_interrupt
from registerbench.baselines.bench_entries import write_entry
from registerbench.baselines.training_envs import make_training_envs
from registerbench.benchmark_tasks import CARDS, OPEN_ROUND, Card, list_test_seeds
from registerbench.score_statistics import ORACLE, ORACLE_TRACK
from stage.errors import ArgumentError

PARALLEL_ENVS = 16  # tries that are played at once
FIRST_SIGMA, SHRINK_FACTOR = 0.3, 0.85


class EpisodeSearch:
    """Search for the best actions of single episodes of a task.

    Args:
        card: Card of the task.
        split: Split of the machines.

    Attributes:
        steps: Number of steps that the tries have made so far.
    """

    def __init__(self, card: Card, split: str):
        self._env = card.make_env(split, ORACLE_TRACK, {})
        self._envs = card.make_env(split, ORACLE_TRACK, {}, PARALLEL_ENVS)
        if not isinstance(self._env.action_space, gymnasium.spaces.Box):
            raise ArgumentError(f"task {card.name}: the oracle searches continuous actions; take another task.")
        self._attempts = getattr(self._env.task_instance.config, "tries", 1)
        self._single_attempts = self._envs
        if self._attempts > 1:
            single = {"split": split, "truth": True, "tries": 1, "reduced": True}
            self._single_attempts = make_training_envs(card.name, PARALLEL_ENVS, **single)
        self.steps = 0

    def play_scripted_host(self, seed: int) -> tuple[list[np.ndarray], bool]:
        """Return the actions of the scripted host, and whether the machine has a fault."""
        _, info = self._env.reset(seed=seed)
        actions, is_over = [], False
        while not is_over:
            actions.append(np.array(self._env.scripted_action()))
            *_, terminated, truncated, _ = self._env.step(actions[-1])
            is_over = terminated or truncated
        self.steps += len(actions)
        return actions, bool(info.get("fault", 0))

    def play_candidates(self, envs: Any, seed: int, candidates: np.ndarray) -> np.ndarray:
        """Play the tries of an episode's actions, and return the sum of rewards of each try.

        Args:
            envs: Vector environment with PARALLEL_ENVS environments.
            seed: Seed of the episode.
            candidates: Actions, (PARALLEL_ENVS, steps, ...); the last one is repeated if an episode goes on.
        """
        envs.reset(seed=[seed] * PARALLEL_ENVS)
        total, is_over, step = np.zeros(PARALLEL_ENVS), np.zeros(PARALLEL_ENVS, bool), 0
        while not is_over.all():
            actions = candidates[:, min(step, candidates.shape[1] - 1)]
            _, rewards, terminated, truncated, _ = envs.step(actions)
            total += np.where(is_over, 0.0, rewards)
            self.steps += int((~is_over).sum())
            is_over |= terminated | truncated
            step += 1
        return total

    def find_best_actions(self, seed: int, budget: int) -> np.ndarray:
        """Return the best actions of an episode that a number of tries finds, (steps, ...)."""
        scripted, is_faulty = self.play_scripted_host(seed)
        if self._attempts > 1:
            return self._find_best_attempt(seed, scripted[0], budget)
        length = getattr(self._env.task_instance.config, "returns", len(scripted))
        begin = np.stack([*scripted, *[scripted[-1]] * (length - len(scripted))])
        searched = np.ones(begin.shape[1])
        has_report = any(e.name == "reported" for e in self._env.info_features)
        if has_report:  # the last number reports a fault; the oracle knows whether there is one
            searched[-1], begin[:, -1] = 0.0, 1.0 if is_faulty else -1.0
            budget = PARALLEL_ENVS if is_faulty else budget
        return self._search(self._envs, seed, begin, searched, budget)[0]

    def _find_best_attempt(self, seed: int, begin: np.ndarray, budget: int) -> np.ndarray:
        """Search the best single attempt of an episode, and return its action for all attempts, (attempts, ...)."""
        single = self._search(self._single_attempts, seed, begin[None], np.ones(len(begin)), budget)
        candidates = np.repeat(
            np.stack([single[k % len(single)] for k in range(PARALLEL_ENVS)]), self._attempts, axis=1
        )
        return candidates[int(np.argmax(self.play_candidates(self._envs, seed, candidates)))]

    def _search(self, envs: Any, seed: int, begin: np.ndarray, searched: np.ndarray, budget: int) -> list[np.ndarray]:
        """Search the best actions of an episode.

        Args:
            envs: Vector environment with PARALLEL_ENVS environments.
            seed: Seed of the episode.
            begin: ActionKind with which the search begins, (steps, ...).
            searched: 1 for each number of an action that changes, else 0.
            budget: Number of tries.

        Returns:
            Up to PARALLEL_ENVS of the actions that were tried, the best first.
        """
        rng, best, best_return, sigma = np.random.default_rng(seed), begin, -np.inf, FIRST_SIGMA
        tried: list[tuple[float, np.ndarray]] = []
        for generation in range(max(budget // PARALLEL_ENVS, 1)):
            common, single = (
                rng.normal(size=(PARALLEL_ENVS, 1, best.shape[1])),
                rng.normal(size=(PARALLEL_ENVS, *best.shape)),
            )
            changes = sigma * searched * (common + 0.3 * single)
            changes[0] = 0.0 if generation == 0 else changes[0]
            candidates = np.clip(best + changes, -1, 1).astype(np.float32)
            returns = self.play_candidates(envs, seed, candidates)
            tried += zip(returns.tolist(), candidates, strict=True)
            winner = int(np.argmax(returns))
            if returns[winner] > best_return:
                best, best_return = candidates[winner], float(returns[winner])
            else:
                sigma *= SHRINK_FACTOR
        return [actions for _, actions in sorted(tried, key=lambda x: -x[0])[:PARALLEL_ENVS]]

    def close(self) -> None:
        """Close the environments in which the search plays."""
        for envs in (self._env, self._envs, self._single_attempts):
            envs.close()


class BestActions:
    """Policy that plays the best actions found for each episode, in their order."""

    def __init__(self, episodes: list[np.ndarray], steps: int):
        self._episodes, self._episode, self._step = episodes, -1, 0
        self.cost = {"moves": float(steps)}

    def reset(self, policy_context: Any) -> None:
        self._episode, self._step = self._episode + 1, 0

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        actions = self._episodes[self._episode]
        self._step += 1
        return actions[min(self._step, len(actions)) - 1]


def search_split(task: str, split: str, round_: str, budget: int, episodes: int | None = None) -> BestActions:
    """Search the best actions of all test episodes of a split, and return the policy that plays them."""
    search = EpisodeSearch(CARDS[task], split)
    try:
        seeds = list_test_seeds(CARDS[task], split, round_)[:episodes]
        return BestActions([search.find_best_actions(seed, budget) for seed in seeds], search.steps)
    finally:
        search.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    continuous = [name for name in CARDS if not name.startswith("bus")]
    parser.add_argument("--tasks", nargs="+", choices=continuous, default=continuous)
    parser.add_argument("--splits", nargs="+", default=["train"])
    parser.add_argument("--tries", type=int, default=256, help="tries of an episode (default: 256)")
    parser.add_argument("--round", default=OPEN_ROUND, metavar="WORD")
    args = parser.parse_args()
    for task in args.tasks:
        for split in (s for s in args.splits if s in CARDS[task].splits):
            policy = search_split(task, split, args.round, args.tries)
            write_entry(policy, task, split, args.out, ORACLE, 0, name=ORACLE, track=ORACLE_TRACK, round_=args.round)


if __name__ == "__main__":
    with exit_on_interrupt("the entries written so far are saved."):
        main()
