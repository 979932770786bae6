"""Optuna's samplers as hosts of `stage/FewShotTuning-v1`: each machine is a study of eight trials.

stage bench-submit registerbench.baselines.few_shot_optuna:Tpe --name "Optuna TPE" -o tpe.bench
python -m registerbench.baselines.bench_entries -o entries --players tpe cma-es

A study begins at the formula's answer for the nominal machine with the heaviest load. Two factors on it are chosen: of the top
rate, and of the ramps. A try costs its seconds; one that did not keep step by the encoder twice the usual ones, which is the
most that a try may take. Needs the extra `rl`.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import optuna

from stage import Stage
from stage.envs.few_shot import action_of
from stage.tune.formula import Load, compute_speeds

RANGES = {"rates": (0.5, 2.0), "ramps": (0.4, 2.5)}
HEAVIEST = 5.5  # kg, of the split train with the margin


class OptunaPolicy:
    """A study an episode."""

    def __init__(self) -> None:
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        self.load = Load.from_axis(Stage("xyz", visuals=False).axes["x"]).add_mass(HEAVIEST)
        self.episode = 0

    def sampler(self, seed: int) -> optuna.samplers.BaseSampler:
        raise NotImplementedError

    def reset(self, context: Any) -> None:
        where: dict[str, list[int]] = {}
        for k, name in enumerate(context.feature_names):
            where.setdefault(name, []).append(k)
        self.kept_indices, self.duration = where["kept"], where["duration"]
        self.study = optuna.create_study(sampler=self.sampler(self.episode))
        self.study.enqueue_trial({"rates": 1.0, "ramps": 1.0})
        self.space = {n: optuna.distributions.FloatDistribution(*r, log=True) for n, r in RANGES.items()}
        self.trial: Any = None
        self.episode, self.attempts = self.episode + 1, 0

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        if self.trial is not None:
            last = min(self.attempts, len(self.kept_indices)) - 1
            kept_step = observation[self.kept_indices[last]] > 0
            self.study.tell(self.trial, float(observation[self.duration[last]]) if kept_step else 1.0)
        self.trial, self.attempts = self.study.ask(self.space), self.attempts + 1
        s, factors = compute_speeds(self.load, int(info["distance"])), self.trial.params
        ramps = factors["ramps"]
        return action_of(s.start, s.drive * factors["rates"], s.up * ramps, s.down * ramps)


class Tpe(OptunaPolicy):
    def sampler(self, seed: int) -> optuna.samplers.BaseSampler:
        return optuna.samplers.TPESampler(seed=seed, n_startup_trials=3)


class CmaEs(OptunaPolicy):
    def sampler(self, seed: int) -> optuna.samplers.BaseSampler:
        return optuna.samplers.CmaEsSampler(seed=seed, popsize=4, n_startup_trials=1)
