"""What memory can be worth on FewShotTuning at most: every machine is tried at every boldness, and hosts are played on that table.

python -m registerbench.baselines.memory_worth
python -m registerbench.baselines.memory_worth --tasks few-shot-wide --machines 128

With a table of boldness.py, of machines of train
knows     has the best boldness of each machine: nobody is better
blind     eight numbers, the same for all machines, the best that a search from STARTS places finds: it looks at nothing
looks     the rule with memory of rules.py, its numbers by CMA-ES
Of each the mean sum of rewards. What is chosen is chosen on the same machines, so each figure flatters. Needs the package cmaes
(extra `rl`).
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from registerbench.baselines import explain_interrupt
from registerbench.baselines.boldness_table import BOLDNESS, BoldnessTable, learn_rule, measure_boldness_table
from registerbench.baselines.rule_policies import ATTEMPTS, RememberingRule

FROM, STARTS = 2000, 6


def search_blindly(table: BoldnessTable) -> float:
    def mean(attempts: list[int]) -> float:
        return float(table.sum_rewards(np.array(attempts)[:, None]).mean())

    rng, best = np.random.default_rng(0), -np.inf
    for _ in range(STARTS):
        attempts, value, better = rng.integers(0, len(BOLDNESS), ATTEMPTS).tolist(), -np.inf, True
        while better:
            others = [[*attempts[:j], b, *attempts[j + 1 :]] for j in range(ATTEMPTS) for b in range(len(BOLDNESS))]
            attempts = max(others, key=mean)
            value, better = mean(attempts), mean(attempts) > value
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
        measured = measure_boldness_table(task, FROM, args.machines)
        for last in (False, True):
            table = replace(measured, last=last)
            remembering = table.play(
                RememberingRule, RememberingRule.numbers(learn_rule(RememberingRule, table, 0))
            ).mean()
            print(
                f"| {task} | {'the last try' if last else 'the best try'} | {table.worth.max(axis=0).mean():.3f} "
                f"| {search_blindly(table):.3f} | {remembering:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    with explain_interrupt("rows above are whole, nothing else is kept."):
        main()
