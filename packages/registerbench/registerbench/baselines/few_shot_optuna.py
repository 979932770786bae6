"""Optuna's samplers as policies on `stage/FewShotTuning-v1`: each machine is a study of eight trials.

stage bench-submit registerbench.baselines.few_shot_optuna:TpePolicy --name "Optuna TPE" -o tpe.bench
python -m registerbench.baselines.bench_entries -o entries --players tpe cma-es

A study begins at the formula's answer for the nominal machine with the heaviest load. It chooses two factors on this answer: one
for the top rate, and one for the ramps. The cost of an attempt is its duration. An attempt that lost steps by the encoder costs
twice the usual duration, which is the longest permitted one. Needs the extra `rl`.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import optuna

from stage import Stage
from stage.envs.few_shot import make_action
from stage.tune.formula import Load, compute_speeds

RANGES = {"rates": (0.5, 2.0), "ramps": (0.4, 2.5)}
MAX_PAYLOAD_KG = 5.5  # heaviest payload of the split train, with the margin


class OptunaPolicy:
    """Policy on FewShotTuning that runs a study of Optuna in each episode."""

    def __init__(self) -> None:
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        self.load = Load.from_axis(Stage("xyz", visuals=False).axes["x"]).add_mass(MAX_PAYLOAD_KG)
        self.episode = 0

    def make_sampler(self, seed: int) -> optuna.samplers.BaseSampler:
        """Make the sampler of an episode's Optuna study."""
        raise NotImplementedError

    def reset(self, policy_context: Any) -> None:
        """Begin a study for the next episode."""
        where: dict[str, list[int]] = {}
        for k, name in enumerate(policy_context.feature_names):
            where.setdefault(name, []).append(k)
        self.kept_indices, self.duration = where["kept"], where["duration"]
        self.study = optuna.create_study(sampler=self.make_sampler(self.episode))
        self.study.enqueue_trial({"rates": 1.0, "ramps": 1.0})
        self.space = {n: optuna.distributions.FloatDistribution(*r, log=True) for n, r in RANGES.items()}
        self.trial: Any = None
        self.episode, self.attempts = self.episode + 1, 0

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        if self.trial is not None:
            last = min(self.attempts, len(self.kept_indices)) - 1
            in_step = observation[self.kept_indices[last]] > 0
            self.study.tell(self.trial, float(observation[self.duration[last]]) if in_step else 1.0)
        self.trial, self.attempts = self.study.ask(self.space), self.attempts + 1
        s, factors = compute_speeds(self.load, int(info["distance"])), self.trial.params
        ramps = factors["ramps"]
        return make_action(s.start, s.drive * factors["rates"], s.up * ramps, s.down * ramps)


class TpePolicy(OptunaPolicy):
    """Policy on FewShotTuning that samples by Optuna's tree-structured Parzen estimator."""

    def make_sampler(self, seed: int) -> optuna.samplers.BaseSampler:
        return optuna.samplers.TPESampler(seed=seed, n_startup_trials=3)


class CmaEsPolicy(OptunaPolicy):
    """Policy on FewShotTuning that samples by Optuna's CMA-ES."""

    def make_sampler(self, seed: int) -> optuna.samplers.BaseSampler:
        return optuna.samplers.CmaEsSampler(seed=seed, popsize=4, n_startup_trials=1)
