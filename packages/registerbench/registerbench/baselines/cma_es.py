"""CMA-ES by Optuna: a normal distribution of choices that moves to where the reward is, and takes its shape.

python -m registerbench.baselines.cma_es --budget 1024 --seed 0
python -m registerbench.baselines.cma_es --space registers

It begins in the middle, which of the knobs is the data sheet's answer. Needs optuna and cmaes (extra `rl`).
"""

from __future__ import annotations

import numpy as np
import optuna

from registerbench.baselines.common import Moves, run


def search(moves: Moves, seed: int = 0) -> None:
    """Spend the budget, a generation of `moves.lanes` at a time."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    names = [str(k) for k in range(moves.size)]
    space = {n: optuna.distributions.FloatDistribution(-1.0, 1.0) for n in names}
    study = optuna.create_study(
        sampler=optuna.samplers.CmaEsSampler(popsize=moves.lanes, seed=seed), direction="maximize"
    )
    study.enqueue_trial(dict.fromkeys(names, 0.0))
    while moves.left:
        trials = [study.ask(space) for _ in range(min(moves.lanes if moves.log.reward else 1, moves.left))]
        rewards = moves.make(np.array([[t.params[n] for n in names] for t in trials]))
        for trial, reward in zip(trials, rewards, strict=True):
            study.tell(trial, float(reward))


if __name__ == "__main__":
    run(__doc__, search)
