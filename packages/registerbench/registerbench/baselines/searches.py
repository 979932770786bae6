"""Searches that need no learner: random choices, and CMA-ES by Optuna. A search spends the budget of `moves`.

python -m registerbench.baselines.searches random --budget 1024 --seed 0
python -m registerbench.baselines.searches cma-es --space registers

Random choices are what everything else should beat. CMA-ES is a normal distribution of choices that moves to where the reward is
and takes its shape; it begins in the middle, which of the knobs is the data sheet's answer. It needs optuna and cmaes (extra `rl`).
"""

from __future__ import annotations

import numpy as np

from registerbench.baselines.move_tuning import MoveTuning, run


def search_randomly(moves: MoveTuning, seed: int = 0) -> None:
    """Make random choices."""
    rng = np.random.default_rng(seed)
    while moves.left:
        moves.make(rng.uniform(-1, 1, (moves.lanes, moves.size)))


def search_by_cma_es(moves: MoveTuning, seed: int = 0) -> None:
    """Make the choices of CMA-ES, a generation of `moves.lanes` at a time."""
    import optuna

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
    run(__doc__, {"random": search_randomly, "cma-es": search_by_cma_es})
