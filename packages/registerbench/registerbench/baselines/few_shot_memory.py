"""Worth of memory on an unknown machine with few attempts, measured with hosts that do not learn.

python -m registerbench.baselines.few_shot_memory
python -m registerbench.baselines.few_shot_memory --splits train heavy weak --machines 64

A boldness b stands for a move with the usual rates times b and the usual ramps divided by b. Three hosts choose it:
usual    always chooses 1
fixed    chooses the same number for every attempt on every machine: the best of BOLDNESS on machines of the split train
search   begins STEP below that number. After an attempt that kept step by the encoder it is bolder by STEP. After an attempt that
         lost steps it goes half way (by ratio) back to the boldest success, until that is CLOSE. It retreats by RETREAT if no
         attempt has succeeded, or if a boldness that succeeded has failed since. It needs to remember two numbers
The table has the mean sum of rewards of an episode, log(2 x usual time / proved cost) - damage, with its 95 % interval by the
bootstrap; the number of machines with a proved answer; and the median proved cost on these.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import gymnasium
import numpy as np

from registerbench.score_statistics import compute_interval
from registerbench.shipped_policies import compute_bold_action
from stage.envs.machine_contexts import SPLITS

BOLDNESS = (1.0, 2.0, 2.5, 3.0, 3.2, 3.4, 3.6, 4.0, 5.0)
STEP, CLOSE, RETREAT = 1.12, 1.1, 1.4
TRAIN, TEST = 0, 1_000_000  # first seeds of the machines on which `fixed` is chosen, and of those that test all hosts
LANES = 16

BoldnessHost = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function (boldness of the last attempt, whether it kept step) of all machines -> boldness of the next attempt, (machines,)."""


def make_fixed_host(boldness: float) -> Callable[[int], BoldnessHost]:
    """Make a host that chooses the same boldness for every attempt."""
    return lambda machines: lambda last_boldness, in_step: np.full(machines, boldness)


def make_searching_host(first: float) -> Callable[[int], BoldnessHost]:
    """Make a host that remembers the boldest success and the tamest failure of each machine.

    Args:
        first: Boldness of the first attempt.

    Returns:
        Function that makes the host for a number of machines.
    """

    def make_host(machines: int) -> BoldnessHost:
        boldest_success, tamest_failure = np.full(machines, np.nan), np.full(machines, np.inf)

        def choose(last_boldness: np.ndarray, in_step: np.ndarray) -> np.ndarray:
            if np.isnan(last_boldness).all():
                return np.full(machines, first)
            boldest_success[in_step] = np.fmax(boldest_success, last_boldness)[in_step]
            tamest_failure[~in_step] = np.fmin(tamest_failure, last_boldness)[~in_step]
            boldest_success[boldest_success >= tamest_failure] = np.nan  # the success was luck
            half = np.sqrt(boldest_success * tamest_failure)
            known = np.where(
                np.isinf(tamest_failure),
                boldest_success * STEP,
                np.where(half > boldest_success * CLOSE, half, boldest_success),
            )
            return np.where(np.isnan(boldest_success), tamest_failure / RETREAT, known)

        return choose

    return make_host


def play_host(
    host: Callable[[int], BoldnessHost], split: str, machines: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Play an episode on each machine.

    Args:
        host: Function that makes the host for a number of machines.
        split: Split of the machines.
        machines: Number of machines.
        seed: Seed of the first machine.

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
    scores = [play_host(make_fixed_host(b), "train", args.machines, TRAIN)[0].mean() for b in BOLDNESS]
    best = BOLDNESS[int(np.argmax(scores))]
    print(f"on the split train, boldness {best:g} is the best of {', '.join(f'{b:g}' for b in BOLDNESS)}")
    print("| split | host | sum of rewards | proved | cost, usual times |\n|---|---|---|---|---|")
    for split in args.splits:
        for name, host in {
            "usual": make_fixed_host(1.0),
            "fixed": make_fixed_host(best),
            "search": make_searching_host(best / STEP),
        }.items():
            totals, costs = play_host(host, split, args.machines, TEST)
            low, high = compute_interval(totals, statistic=np.mean)
            proved = np.isfinite(costs)
            median = f"{np.median(costs[proved]):.3f}" if proved.any() else "-"
            print(
                f"| {split} | {name} | {totals.mean():.3f} ({low:.3f} to {high:.3f}) | {proved.sum()} of {len(proved)} | {median} |"
            )


if __name__ == "__main__":
    main()
