"""The tasks of the bench, and their test episodes: a table that everybody plays."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium

from stage.envs import contexts
from stage.errors import ArgumentError, unknown_name_error
from stage.support.arguments import explain_arguments

TRACKS = {
    "host": "the policy sees what a host on the bus can know",
    "truth": "it sees the hidden context, too: an upper bound",
    "tools": "as host, by a language model with tools: tokens are counted",
}
OPEN = "open"  # the round whose seeds stand in the page
FIRST, LAST = 1_000_000, 1 << 31  # seeds of test episodes; those below FIRST are for learning


def without(*splits: str) -> tuple[str, ...]:
    """Return all splits but those that a task cannot have, or that do not change it.

    A split does not change a task if fewer than a third of its test episodes end with a return that differs from that on train by
    0.001, the last figure of the tables, for the scripted and for the random player.
    """
    return tuple(split for split in contexts.SPLITS if split not in splits)


@dataclass(frozen=True)
class Card:
    """Task of the bench.

    Attributes:
        settings: Of the environment, the same for all.
        choices: Settings that a player may choose, and among what.
        splits: Those that change it; see `without`.
    """

    name: str
    id: str
    asked: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    choices: Mapping[str, tuple] = field(default_factory=dict)
    splits: tuple[str, ...] = tuple(contexts.SPLITS)
    episodes: int = 64

    def check(self, split: str, track: str, selected: Mapping[str, Any]) -> None:
        """Check a choice of the task.

        Args:
            split: Of its machines.
            track: What the player sees.
            selected: Settings.

        Raises:
            ArgumentError: The task does not have one of them.
        """
        if split not in self.splits:
            raise unknown_name_error(f"split of {self.name}", split, self.splits)
        if track not in TRACKS:
            raise unknown_name_error("track", track, TRACKS)
        for name, value in selected.items():
            if name not in self.choices:
                raise unknown_name_error(f"setting that a player of {self.name} may choose,", name, self.choices)
            if value not in self.choices[name] or isinstance(value, bool) not in map(_is_bool, self.choices[name]):
                allowed = ", ".join(map(repr, self.choices[name]))
                raise ArgumentError(f"{name}={value!r}: {self.name} has {allowed}.")

    def make(self, split: str, track: str, selected: Mapping[str, Any], vector: int = 0) -> Any:
        """Make the environment of the task.

        Args:
            split: Of its machines.
            track: What the player sees.
            selected: Settings.
            vector: Number of environments; None for a scalar one.
        """
        self.check(split, track, selected)
        settings = {**self.settings, **selected, "split": split, "truth": True if track == "truth" else "info"}
        if vector:
            kind: Any = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "Disabled"}
            return gymnasium.make_vec(self.id, vector, **kind, **settings).unwrapped
        return gymnasium.make(self.id, disable_env_checker=True, **settings).unwrapped

    def machines(self, split: str) -> str:
        """Describe the machines of a split; for another than "train", what differs."""
        made: Any = gymnasium.envs.registration.load_env_creator(str(gymnasium.spec(self.id).entry_point))
        values = {**contexts.SPLITS[split]}
        values |= {name: value for name, value in self.settings.items() if name in values}
        faults = [name for name in values.pop("faults", ()) if name in made.task.Config.FAULTS]
        words = [
            f"{name} {values[ranges][0]:g} to {values[ranges][1]:g} {text}"
            for name, (ranges, text) in contexts.KINDS.items()
            if ranges in values
        ]
        if faults:
            words.append(f"a fault: {', '.join(faults)}")
        return "; ".join([*(f"{name} {values[name]}" for name in ("model", "chip") if name in values), *words])


def _is_bool(value: Any) -> bool:
    return isinstance(value, bool)


CARDS = {
    card.name: card
    for card in (
        Card(
            "one-shot",
            "stage/OneShotTuning-v1",
            "a fast move at the first try, that holds with 0.5 kg more, on a machine of which the payload alone is declared",
            splits=without("ms"),
        ),
        Card(
            "few-shot",
            "stage/FewShotTuning-v1",
            "in eight tries, the fastest move that holds with 0.5 kg more, on a machine that nobody has measured",
            choices={"memory": ("all", "last")},
            splits=without("ms"),
        ),
        Card(
            "few-shot-wide",
            "stage/FewShotTuning-v1",
            "in eight tries, of which the last is the answer, a fast move that holds, on machines that differ more",
            settings={
                "answer": "last",
                "damage_weight": 0.02,
                "payloads": (0.0, 10.0),
                "frictions": (0.5, 4.0),
                "supplies": (0.5, 1.1),
                "currents": (0.4, 1.0),
                "losses": (0.56, 2.5),
                "inductances": (0.8, 1.4),
            },
            choices={"memory": ("all", "last")},
            splits=without("heavy", "worn", "weak", "ms"),
        ),
        Card(
            "home",
            "stage/DriftingHome-v1",
            "origin returns to the same place, by a switch that walks, on a machine that may be broken, which is to be reported",
            splits=without("loose"),
        ),
        Card(
            "line",
            "stage/SynchronizedLine-v1",
            "a fast straight line of two axes, by the registers of both",
            splits=without("loose", "ms"),
        ),
        Card(
            "line-3",
            "stage/SynchronizedLine-v1",
            "the same of three axes",
            settings={"axes": ("x", "y", "z")},
            splits=without("loose", "ms", "mast"),
        ),
        Card(
            "bus-target",
            "stage/BusMacros-v1",
            "one axis to a target either way, by phrases of bus cycles",
            settings={"level": "target"},
            splits=without("loose", "ms", "mast"),
        ),
        Card(
            "bus-axes",
            "stage/BusMacros-v1",
            "both axes to their targets either way, by phrases of bus cycles",
            settings={"level": "axes"},
            splits=without("loose", "ms", "mast"),
        ),
        Card(
            "bus",
            "stage/BusMacros-v1",
            "both axes from an unknown place by their origins to their targets, by phrases of bus cycles",
            splits=without("worn", "loose", "ms", "mast"),
        ),
    )
}
"""By name."""


def card_of(task: str) -> Card:
    """Return the card of this name, or of this id of an environment. Raises ArgumentError."""
    for card in CARDS.values():
        if task in (card.name, card.id):
            return card
    raise unknown_name_error("task", task, CARDS)


@explain_arguments
def seeds(card: Card, split: str, round_: str = OPEN) -> list[int]:
    """Return the seeds of the test episodes, in their order.

    Args:
        card: Of the task.
        split: Of its machines.
        round_: Open, or the name of a round whose seeds are secret until it ends.

    Raises:
        ArgumentError: There is no such split or round.
    """
    if round_ == OPEN:
        return [FIRST + k for k in range(card.episodes)]
    said = [f"{card.name} {split} {round_} {k}".encode() for k in range(card.episodes)]
    drawn = [int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little") for text in said]
    return [FIRST + card.episodes + number % (LAST - FIRST - card.episodes) for number in drawn]
