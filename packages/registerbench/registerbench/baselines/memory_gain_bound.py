"""Upper limit of the worth of memory on FewShotTuning: every machine is tried at every speed factor, and hosts play on that table.

python -m registerbench.baselines.memory_gain_bound
python -m registerbench.baselines.memory_gain_bound --tasks few-shot-wide --machines 128

The hosts play on a table of outcomes_by_speed_factor.py, with machines of the split train:
knows     knows the best speed factor of each machine: no host can be better
blind     uses the same eight numbers for all machines, the best that a search from STARTS sequences finds; it observes nothing
looks     uses the policy with memory of parametric_policies.py, whose numbers CMA-ES has found
The printed figure is the mean sum of rewards of each. The numbers are chosen on the same machines, so each figure is
optimistic. Needs the package cmaes (extra `rl`).
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from registerbench.baselines import exit_on_interrupt
from registerbench.baselines.outcomes_by_speed_factor import (
    SPEED_FACTORS,
    OutcomesBySpeedFactor,
    learn_policy_numbers,
    measure_outcomes_by_speed_factor,
)
from registerbench.baselines.parametric_policies import ATTEMPTS, RememberingPolicy

FIRST_SEED, STARTS = 2000, 6


def search_fixed_sequence(table: OutcomesBySpeedFactor) -> float:
    """Search for the best fixed sequence of attempts by coordinate search from STARTS random sequences.

    Returns:
        Highest mean reward.
    """

    def compute_mean_reward(attempts: list[int]) -> float:
        """Return the mean reward of a sequence of attempts that is the same for all machines."""
        return float(table.sum_rewards(np.array(attempts)[:, None]).mean())

    rng, best = np.random.default_rng(0), -np.inf
    for _ in range(STARTS):
        attempts, value, better = rng.integers(0, len(SPEED_FACTORS), ATTEMPTS).tolist(), -np.inf, True
        while better:
            others = [
                [*attempts[:j], b, *attempts[j + 1 :]] for j in range(ATTEMPTS) for b in range(len(SPEED_FACTORS))
            ]
            attempts = max(others, key=compute_mean_reward)
            value, better = compute_mean_reward(attempts), compute_mean_reward(attempts) > value
        best = max(best, value)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--tasks", nargs="+", choices=("few-shot", "few-shot-wide"), default=["few-shot", "few-shot-wide"]
    )
    parser.add_argument("--machines", type=int, default=64, metavar="N", help="a multiple of 8")
    args = parser.parse_args()
    print("| machines of | answer | knows | blind | looks |\n|---|---|---|---|---|")
    for task in args.tasks:
        measured = measure_outcomes_by_speed_factor(task, FIRST_SEED, args.machines)
        for last in (False, True):
            table = replace(measured, last_attempt_counts=last)
            remembering = table.play_policy(
                RememberingPolicy, RememberingPolicy.scale_numbers(learn_policy_numbers(RememberingPolicy, table, 0))
            ).mean()
            print(
                f"| {task} | {'the last try' if last else 'the best try'} | {table.worth.max(axis=0).mean():.3f} "
                f"| {search_fixed_sequence(table):.3f} | {remembering:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    with exit_on_interrupt("the rows above are complete; nothing else is saved."):
        main()
