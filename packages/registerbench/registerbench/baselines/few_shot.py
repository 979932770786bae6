"""Few tries on a machine that nobody knows: what memory is worth, without learning.

python -m registerbench.baselines.few_shot
python -m registerbench.baselines.few_shot --splits train heavy weak --machines 64

A boldness b makes a move of it: the usual rates times b, the usual ramps divided by b. Three hosts choose it:
usual    1, always
fixed    the same number for every try of every machine: the one of BOLDNESS that did best on machines of the split train
search   begins STEP below that number; bolder by STEP after a try that kept step by the encoder; after one that did not, half way
         (by ratio) back to the boldest that did, until that is CLOSE, and by RETREAT where none did, or where what once did has
         failed since: it needs to remember two numbers
The table has the mean sum of rewards of an episode, log(2 x usual time / proved cost) - damage, with its 95 % interval by the
bootstrap; on how many machines something was proved; and the median proved cost there.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import gymnasium
import numpy as np

from registerbench.shipped_policies import compute_bold_action
from registerbench.statistics import compute_interval
from stage.envs.contexts import SPLITS

BOLDNESS = (1.0, 2.0, 2.5, 3.0, 3.2, 3.4, 3.6, 4.0, 5.0)
STEP, CLOSE, RETREAT = 1.12, 1.1, 1.4
TRAIN, TEST = 0, 1_000_000  # seeds of the machines that `fixed` was chosen on, and of those that it is judged on
LANES = 16

Host = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(boldness of the try before, whether it kept step) of each machine -> boldness of the next."""


def fixed(boldness: float) -> Callable[[int], Host]:
    return lambda n: lambda before, in_step: np.full(n, boldness)


def search(first: float) -> Callable[[int], Host]:
    """A host that remembers, of each machine, the boldest try that kept step and the tamest that did not."""

    def make_host(n: int) -> Host:
        good, bad = np.full(n, np.nan), np.full(n, np.inf)

        def choose(before: np.ndarray, in_step: np.ndarray) -> np.ndarray:
            if np.isnan(before).all():
                return np.full(n, first)
            good[in_step] = np.fmax(good, before)[in_step]
            bad[~in_step] = np.fmin(bad, before)[~in_step]
            good[good >= bad] = np.nan  # it was luck
            half = np.sqrt(good * bad)
            known = np.where(np.isinf(bad), good * STEP, np.where(half > good * CLOSE, half, good))
            return np.where(np.isnan(good), bad / RETREAT, known)

        return choose

    return make_host


def play(host: Callable[[int], Host], split: str, machines: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Play an episode on each machine.

    Args:
        host: Player.
        split: Of the machines.
        machines: Their number.
        seed: Of the first.

    Returns:
        Sums of rewards, and proved cost / usual time, (machines,) each.
    """
    totals, costs = [], []
    envs = gymnasium.make_vec(
        "stage/FewShotTuning-v1", num_envs=LANES, vectorization_mode="vector_entry_point", split=split, memory="last"
    )
    names = [e.name for e in envs.unwrapped.observation_features]
    attempts = envs.unwrapped.task_instance.config.tries
    for begin in range(0, machines, LANES):
        observation, _ = envs.reset(seed=seed + begin)
        choose, total, before = host(LANES), np.zeros(LANES), np.full(LANES, np.nan)
        for _ in range(attempts):
            before = choose(before, observation[:, names.index("kept")] > 0)
            observation, rewards, *_, info = envs.step(np.stack([compute_bold_action(b) for b in before]))
            total += rewards
        totals.append(total)
        costs.append(info["proved"] / info["usual"])
    envs.close()
    return np.concatenate(totals)[:machines], np.concatenate(costs)[:machines]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--splits", choices=SPLITS, nargs="+", default=["train"], help="where the machines come from that are judged"
    )
    parser.add_argument("--machines", type=int, default=32, metavar="N", help="how many")
    args = parser.parse_args()
    scores = [play(fixed(b), "train", args.machines, TRAIN)[0].mean() for b in BOLDNESS]
    best = BOLDNESS[int(np.argmax(scores))]
    print(f"on the split train, boldness {best:g} is the best of {', '.join(f'{b:g}' for b in BOLDNESS)}")
    print("| split | host | sum of rewards | proved | cost, usual times |\n|---|---|---|---|---|")
    for split in args.splits:
        for name, host in {"usual": fixed(1.0), "fixed": fixed(best), "search": search(best / STEP)}.items():
            totals, costs = play(host, split, args.machines, TEST)
            low, high = compute_interval(totals, statistic=np.mean)
            proved = np.isfinite(costs)
            median = f"{np.median(costs[proved]):.3f}" if proved.any() else "-"
            print(
                f"| {split} | {name} | {totals.mean():.3f} ({low:.3f} to {high:.3f}) | {proved.sum()} of {len(proved)} | {median} |"
            )


if __name__ == "__main__":
    main()
