"""Searches without a learner: random choices, and CMA-ES by Optuna. A search spends the budget of its MoveTuning.

python -m registerbench.baselines.searches random --budget 1024 --seed 0
python -m registerbench.baselines.searches cma-es --space registers

Every other method should beat random choices. CMA-ES draws choices from a normal distribution, and adapts its mean and shape to the
choices with high rewards. It begins in the middle, which is the formula's answer in the space of knobs. It needs optuna and cmaes
(extra `rl`).
"""

from __future__ import annotations

import numpy as np

from registerbench.baselines.move_tuning import MoveTuning, run_command_line


def search_randomly(moves: MoveTuning, seed: int = 0) -> None:
    """Spend the budget of moves on random choices of knobs or registers.

    Args:
        moves: Move that is tuned.
        seed: Seed of the choices.
    """
    rng = np.random.default_rng(seed)
    while moves.moves_left:
        moves.measure_rewards(rng.uniform(-1, 1, (moves.lanes, moves.size)))


def search_by_cma_es(moves: MoveTuning, seed: int = 0) -> None:
    """Spend the budget of moves on the choices of CMA-ES, a generation of `moves.lanes` at a time.

    Args:
        moves: Move that is tuned.
        seed: Seed of the sampler.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    names = [str(k) for k in range(moves.size)]
    space = {n: optuna.distributions.FloatDistribution(-1.0, 1.0) for n in names}
    study = optuna.create_study(
        sampler=optuna.samplers.CmaEsSampler(popsize=moves.lanes, seed=seed), direction="maximize"
    )
    study.enqueue_trial(dict.fromkeys(names, 0.0))
    while moves.moves_left:
        trials = [study.ask(space) for _ in range(min(moves.lanes if moves.log.reward else 1, moves.moves_left))]
        rewards = moves.measure_rewards(np.array([[t.params[n] for n in names] for t in trials]))
        for trial, reward in zip(trials, rewards, strict=True):
            study.tell(trial, float(reward))


if __name__ == "__main__":
    run_command_line(__doc__, {"random": search_randomly, "cma-es": search_by_cma_es})
