"""Small policies for the tasks of the bench, with numbers for a learner to choose: what rule_learners.py learns.

rule = RULES["few-shot-wide", "memory"](w, names, n)     w: its numbers; names: of the entries of an observation; n machines
rule(seen)                                           actions, (n, ...), for observations (n, ...): once a step, from an episode's
                                                     first on

All of them see what a host sees, and begin in the middle of what can be chosen, or at twice the usual speeds. None is shown a
formula's answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from registerbench.shipped_policies import compute_bold_action

TRIES = 8
TAMEST, BOLDEST = 0.5, 12.0


class Rule:
    """BEGINS: its numbers before it has learned; SCALES: how far they are moved in the first generation, each."""

    BEGINS: ClassVar[tuple[float, ...]]
    SCALES: ClassVar[tuple[float, ...]]

    def __init__(self, w: Sequence[float] | np.ndarray, names: Sequence[str], n: int = 1):
        self.w, self.names, self.made = np.asarray(w, float), list(names), 0

    @classmethod
    def numbers(cls, z: np.ndarray) -> np.ndarray:
        """Convert the numbers of CMA-ES to those of the rule: 0 stands for the initial ones, with a spread of 1."""
        return np.array(cls.BEGINS) + np.array(cls.SCALES) * z

    def of(self, name: str, observation: np.ndarray) -> np.ndarray:
        return observation[:, self.names.index(name)].astype(float)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        chosen = self.choose(observation)
        self.made += 1
        return np.clip(chosen, -1.0, 1.0).astype(np.float32)

    def choose(self, observation: np.ndarray) -> np.ndarray:
        raise NotImplementedError


class Linear(Rule):
    """Some actions, each a number and a share of each feature; the others are 0."""

    FEATURES: ClassVar[int]
    ACTIONS: ClassVar[tuple[int, int]]
    """Of those that are chosen, and of all."""

    def features(self, observation: np.ndarray) -> list[np.ndarray]:
        raise NotImplementedError

    def choose(self, observation: np.ndarray) -> np.ndarray:
        used, every = self.ACTIONS
        out = np.zeros((len(observation), every))
        out[:, :used] = np.stack([np.ones(len(observation)), *self.features(observation)], axis=1) @ self.w.reshape(
            -1, used
        )
        return out


class OneShot(Linear):
    """Both rates and both ramps, by distance and declared payload."""

    ACTIONS = 4, 4
    BEGINS, SCALES = (0.0,) * 12, (0.5,) * 4 + (0.25,) * 8

    def features(self, observation: np.ndarray) -> list[np.ndarray]:
        return [self.of("distance", observation), self.of("declared", observation)]


class Line(Linear):
    """Rate and ramp, by the longest axis and by the share of the shortest; the registers are the data sheet's for these."""

    ACTIONS = 2, 14
    BEGINS, SCALES = (0.0,) * 6, (0.5,) * 2 + (0.25,) * 4

    def features(self, observation: np.ndarray) -> list[np.ndarray]:
        ways = np.abs(observation[:, [k for k, name in enumerate(self.names) if name == "distance"]])
        longest = ways.max(axis=1)
        return [np.log(longest) + 1.0, np.log(ways.min(axis=1) / longest) + 1.0]


class Home(Rule):
    """Rule of home: rates, ramps and backing off are constant.

    How far to leave ORG follows from whether it is asserted; the approach and the report follow from the returns in a row that
    failed, and from how the last one did.
    """

    BEGINS, SCALES = (0.0,) * 7 + (-0.5, 0.0, 0.0, 0.0), (0.5,) * 7 + (0.3, 1.0, 0.5, 0.5)

    def choose(self, observation: np.ndarray) -> np.ndarray:
        search, ramp, approach, back_off, leave, asserted, slower, report, *signs = self.w
        failed, ones = self.of("failed", observation), np.ones(len(observation))
        said = failed, self.of("last_end_limit", observation), self.of("last_late", observation)
        return np.stack(
            [
                search * ones, ramp * ones, approach + slower * failed, leave + asserted * self.of("org", observation),
                back_off * ones, report + sum(w * x for w, x in zip(signs, said, strict=True)),
            ], axis=1,
        )  # fmt: skip


def bold(boldness: np.ndarray) -> np.ndarray:
    """The usual rates times a boldness each, the usual ramps divided by it: actions, (n, 4)."""
    return np.stack([compute_bold_action(b) for b in boldness.tolist()])


class Bold(Rule):
    """FewShotTuning by one boldness a try."""

    def choose(self, observation: np.ndarray) -> np.ndarray:
        return bold(np.exp(self.boldness(self.of("distance", observation), self.of("kept", observation) > 0)))

    def boldness(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        """Compute the logarithm of the next boldness, (n,); `in_step`: the last try kept step by the encoder."""
        return np.clip(self.next(distance, in_step), np.log(TAMEST), np.log(BOLDEST))

    def next(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        raise NotImplementedError


class Blind(Bold):
    """Rule w0 + w1 distance + w2 share of the tries: what a policy can do that sees no try.

    It may go from tame to bold, or the other way, and be where it wants to at the last.
    """

    BEGINS, SCALES = (0.7, 0.0, 0.0), (0.4, 0.2, 0.4)

    def next(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        w = self.w
        return w[0] + w[1] * distance + w[2] * self.made / TRIES


class Remembering(Bold):
    """Rule that remembers past tries: it looks between the boldest try that kept step and the least bold one that did not."""

    BEGINS, SCALES = (0.7, 0.0, 0.2, 0.5, 0.1), (0.4, 0.2, 0.1, 0.2, 0.1)

    def __init__(self, w: Sequence[float] | np.ndarray, names: Sequence[str], n: int = 1):
        super().__init__(w, names, n)
        self.held, self.lost, self.last = np.full(n, -np.inf), np.full(n, np.inf), np.zeros(n)  # logarithms

    def boldness(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        self.last = super().boldness(distance, in_step)
        return self.last

    def see(self, in_step: np.ndarray) -> None:
        self.held = np.where(in_step, np.maximum(self.held, self.last), self.held)
        self.lost = np.where(in_step, self.lost, np.minimum(self.lost, self.last))
        self.held = np.where(self.held >= self.lost, -np.inf, self.held)

    def next(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        (first, slope), (up, share, back) = self.w[:2], np.abs(self.w[2:])
        down = 2 * up
        if not self.made:
            return first + slope * distance
        self.see(in_step)
        held, lost = np.isfinite(self.held), np.isfinite(self.lost)
        with np.errstate(invalid="ignore"):
            between = self.held + min(share, 1.0) * (self.lost - self.held)
        if self.made == TRIES - 1:
            return np.where(held, self.held - back, self.lost - down)
        return np.where(held & lost, between, np.where(held, self.held + up, self.lost - down))


RULES: dict[tuple[str, str], type[Rule]] = {
    ("one-shot", "es"): OneShot,
    ("few-shot", "es without memory"): Blind,
    ("few-shot", "es with memory"): Remembering,
    ("few-shot-wide", "es without memory"): Blind,
    ("few-shot-wide", "es with memory"): Remembering,
    ("home", "es"): Home,
    ("line", "es"): Line,
}
"""By the name of the card, and of the player."""
