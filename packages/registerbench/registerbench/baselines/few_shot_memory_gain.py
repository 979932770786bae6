"""Worth of memory on an unknown machine with few attempts, measured with hosts that do not learn.

python -m registerbench.baselines.few_shot_memory_gain
python -m registerbench.baselines.few_shot_memory_gain --splits train heavy weak --machines 64

A speed factor b stands for a move with the usual rates times b and the usual ramps divided by b. Three hosts choose it:
usual    always chooses 1
fixed    chooses the same number for every attempt on every machine: the best of SPEED_FACTORS on machines of the split train
search   begins STEP below that number. After an attempt that kept step by the encoder it is faster by STEP. After an attempt that
         lost steps it goes half way (by ratio) back to the fastest success, until that is CLOSE. It retreats by RETREAT if no
         attempt has succeeded, or if a speed factor that succeeded has failed since. It needs to remember two numbers
The table has the mean sum of rewards of an episode, log(2 x usual time / proved cost) - damage, with its 95 % interval by the
bootstrap; the number of machines with a proved answer; and the median proved cost on these.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import gymnasium
import numpy as np

from registerbench.score_statistics import compute_interval
from registerbench.shipped_policies import compute_scaled_action
from stage.envs.machine_contexts import SPLITS

SPEED_FACTORS = (1.0, 2.0, 2.5, 3.0, 3.2, 3.4, 3.6, 4.0, 5.0)
STEP, CLOSE, RETREAT = 1.12, 1.1, 1.4
TRAIN, TEST = 0, 1_000_000  # first seeds of the machines on which `fixed` is chosen, and of those that test all hosts
PARALLEL_ENVS = 16

SpeedFactorHost = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function of the last attempt (speed factor, whether it kept step) that returns the next speed factor; arrays, (machines,)."""


def make_fixed_host(speed_factor: float) -> Callable[[int], SpeedFactorHost]:
    """Make a host that chooses the same speed factor for every attempt."""
    return lambda machines: lambda last_speed_factor, in_step: np.full(machines, speed_factor)


def make_searching_host(first: float) -> Callable[[int], SpeedFactorHost]:
    """Make a host that remembers the fastest success and the slowest failure of each machine.

    Args:
        first: Speed factor of the first attempt.

    Returns:
        Function that makes the host for a number of machines.
    """

    def make_host(machines: int) -> SpeedFactorHost:
        fastest_success, slowest_failure = np.full(machines, np.nan), np.full(machines, np.inf)

        def choose(last_speed_factor: np.ndarray, in_step: np.ndarray) -> np.ndarray:
            if np.isnan(last_speed_factor).all():
                return np.full(machines, first)
            fastest_success[in_step] = np.fmax(fastest_success, last_speed_factor)[in_step]
            slowest_failure[~in_step] = np.fmin(slowest_failure, last_speed_factor)[~in_step]
            fastest_success[fastest_success >= slowest_failure] = np.nan  # the success was luck
            half = np.sqrt(fastest_success * slowest_failure)
            known = np.where(
                np.isinf(slowest_failure),
                fastest_success * STEP,
                np.where(half > fastest_success * CLOSE, half, fastest_success),
            )
            return np.where(np.isnan(fastest_success), slowest_failure / RETREAT, known)

        return choose

    return make_host


def play_host(
    host: Callable[[int], SpeedFactorHost], split: str, machines: int, seed: int
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
        "stage/FewShotTuning-v1",
        num_envs=PARALLEL_ENVS,
        vectorization_mode="vector_entry_point",
        split=split,
        memory="last",
    )
    names = [e.name for e in envs.unwrapped.observation_features]
    attempts = envs.unwrapped.task_instance.config.tries
    for begin in range(0, machines, PARALLEL_ENVS):
        observation, _ = envs.reset(seed=seed + begin)
        choose, total, before = host(PARALLEL_ENVS), np.zeros(PARALLEL_ENVS), np.full(PARALLEL_ENVS, np.nan)
        for _ in range(attempts):
            before = choose(before, observation[:, names.index("kept")] > 0)
            observation, rewards, *_, info = envs.step(np.stack([compute_scaled_action(b) for b in before]))
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
    scores = [play_host(make_fixed_host(b), "train", args.machines, TRAIN)[0].mean() for b in SPEED_FACTORS]
    best = SPEED_FACTORS[int(np.argmax(scores))]
    print(f"on the split train, speed factor {best:g} is the best of {', '.join(f'{b:g}' for b in SPEED_FACTORS)}")
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
