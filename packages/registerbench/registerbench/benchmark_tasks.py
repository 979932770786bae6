"""The tasks of the benchmark and the seeds of their test episodes."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium

from stage.envs import machine_contexts
from stage.errors import ArgumentError, unknown_name_error
from stage.support.argument_checks import explain_arguments

TRACKS = {
    "host": "the policy sees what a host on the bus can know",
    "truth": "the policy also sees the hidden context, which gives an upper bound",
    "tools": "a language model sees the same as on track host, acts by tools, and its tokens are counted",
}
DRAWN_ROUND = "drawn"  # stands for a round whose word is drawn when the policy is frozen
OPEN_ROUND = "open"  # the round whose seeds are public: docs/benchmark.md lists them
FIRST_TEST_SEED, SEED_LIMIT = 1_000_000, 1 << 62  # learners may use all seeds below the first of them


def list_splits_except(*splits: str) -> tuple[str, ...]:
    """Return the names of all splits but those that a task lacks or that do not change it.

    A split does not change a task if fewer than a third of its test episodes end with a return that differs from the return
    on the split train by 0.001 (the last digit of the tables), for the scripted player and for the random one.

    Args:
        *splits: Names of the splits to leave out.
    """
    return tuple(split for split in machine_contexts.SPLITS if split not in splits)


@dataclass(frozen=True)
class Card:
    """Task of the benchmark.

    Attributes:
        name: Name by which commands select the task.
        id: Id of its Gymnasium environment.
        asked: Goal of the task, in words.
        settings: Settings of the environment that are the same for all players.
        choices: Settings that a player may choose, each with its allowed values.
        splits: Splits that change the task; see `list_splits_except`.
        episodes: Number of test episodes of a split.
    """

    name: str
    id: str
    asked: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    choices: Mapping[str, tuple] = field(default_factory=dict)
    splits: tuple[str, ...] = tuple(machine_contexts.SPLITS)
    episodes: int = 64

    def check_choice(self, split: str, track: str, settings: Mapping[str, Any]) -> None:
        """Check that the task has a split, a track and the settings that a player chose.

        Args:
            split: Split from which the machines are drawn.
            track: Name of the track, which says what the player sees.
            settings: Settings that the player chose.

        Raises:
            ArgumentError: The task does not have one of them.
        """
        if split not in self.splits:
            raise unknown_name_error(f"split of {self.name}", split, self.splits)
        if track not in TRACKS:
            raise unknown_name_error("track", track, TRACKS)
        for name, value in settings.items():
            if name not in self.choices:
                raise unknown_name_error(f"setting that a player of {self.name} may choose,", name, self.choices)
            if value not in self.choices[name] or isinstance(value, bool) not in map(_is_boolean, self.choices[name]):
                allowed = ", ".join(map(repr, self.choices[name]))
                raise ArgumentError(f"{name}={value!r}: the task {self.name} allows {allowed}.")

    def make_env(self, split: str, track: str, selected: Mapping[str, Any], vector: int = 0) -> Any:
        """Make the environment of the task.

        Args:
            split: Split from which the machines are drawn.
            track: Name of the track, which says what the player sees.
            selected: Settings that the player chose.
            vector: Number of environments of a vector environment; 0 for a single environment.
        """
        self.check_choice(split, track, selected)
        settings = {**self.settings, **selected, "split": split, "truth": True if track == "truth" else "info"}
        if vector:
            kind: Any = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "Disabled"}
            return gymnasium.make_vec(self.id, vector, **kind, **settings).unwrapped
        return gymnasium.make(self.id, disable_env_checker=True, **settings).unwrapped

    def describe_machines(self, split: str) -> str:
        """Describe the machines of a split in words; for any other split than "train", describe what differs from "train"."""
        env_class: Any = gymnasium.envs.registration.load_env_creator(str(gymnasium.spec(self.id).entry_point))
        values = {**machine_contexts.SPLITS[split]}
        values |= {name: value for name, value in self.settings.items() if name in values}
        faults = [name for name in values.pop("faults", ()) if name in env_class.task.Config.FAULTS]
        words = [
            f"{name} {values[ranges][0]:g} to {values[ranges][1]:g} {text}"
            for name, (ranges, text) in machine_contexts.CONTEXT_NUMBERS.items()
            if ranges in values
        ]
        if faults:
            words.append(f"a fault: {', '.join(faults)}")
        return "; ".join([*(f"{name} {values[name]}" for name in ("model", "chip") if name in values), *words])


def _is_boolean(value: Any) -> bool:
    return isinstance(value, bool)


BUS_TIME = {"time_weight": 0.5, "time_limit": 10.0}
"""Settings of the tasks on the bus, by which time counts: a second costs as much as fifty macros. A failure costs 6.2 with them, as
much as with the limits and costs of RegisterBus, and less than a divergence."""

CARDS = {
    card.name: card
    for card in (
        Card(
            "one-shot",
            "stage/OneShotTuning-v1",
            "a fast move at the first try, that holds with 0.5 kg more, on a machine of which the payload alone is declared",
            splits=list_splits_except("ms"),
        ),
        Card(
            "few-shot",
            "stage/FewShotTuning-v1",
            "in eight tries, the fastest move that holds with 0.5 kg more, on a machine that nobody has measured",
            choices={"memory": ("all", "last")},
            splits=list_splits_except("ms"),
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
            splits=list_splits_except("heavy", "worn", "weak", "ms"),
        ),
        Card(
            "home",
            "stage/DriftingHome-v1",
            "origin returns to the same place, by a switch that walks, on a machine that may be broken, which is to be reported",
            splits=list_splits_except("loose"),
        ),
        Card(
            "line",
            "stage/SynchronizedLine-v1",
            "a fast straight line of two axes, by the registers of both",
            splits=list_splits_except("loose", "ms"),
        ),
        Card(
            "line-3",
            "stage/SynchronizedLine-v1",
            "the same of three axes",
            settings={"axes": ("x", "y", "z")},
            splits=list_splits_except("loose", "ms", "mast"),
        ),
        Card(
            "bus-target",
            "stage/BusMacros-v1",
            "one axis to a target either way, soon, by phrases of bus cycles",
            settings={"level": "target", **BUS_TIME},
            splits=list_splits_except("loose", "ms", "mast"),
        ),
        Card(
            "bus-axes",
            "stage/BusMacros-v1",
            "both axes to their targets either way, soon, by phrases of bus cycles",
            settings={"level": "axes", **BUS_TIME},
            splits=list_splits_except("loose", "ms", "mast"),
        ),
        Card(
            "bus",
            "stage/BusMacros-v1",
            "both axes from an unknown place by their origins to their targets, soon, by phrases of bus cycles",
            settings=BUS_TIME,
            splits=list_splits_except("worn", "loose", "ms", "mast"),
        ),
        Card(
            "bus-cycles",
            "stage/RegisterBus-v0",
            "both axes to their targets either way, soon, by single bus cycles and waits",
            settings={"axes": ("x", "y"), "time_weight": 2.0, "time_limit": 3.0},
            splits=list_splits_except("loose", "ms", "mast"),
        ),
    )
}
"""Cards of all tasks, by the name of the task."""


def find_card(task: str) -> Card:
    """Return the card with this name or with this environment id. Raises ArgumentError."""
    for card in CARDS.values():
        if task in (card.name, card.id):
            return card
    raise unknown_name_error("task", task, CARDS)


@explain_arguments
def list_test_seeds(card: Card, split: str, round_: str = OPEN_ROUND) -> list[int]:
    """Return the seeds of the test episodes, in the order in which they are played.

    Args:
        card: Card of the task.
        split: Split from which the machines are drawn.
        round_: Name of the round: "open", or the name of a round whose seeds are secret until it ends.

    Raises:
        ArgumentError: There is no such split or round.
    """
    return draw_test_seeds(f"{card.name} {split}", round_, card.episodes)


def draw_test_seeds(games: str, round_: str, count: int) -> list[int]:
    """Return the test seeds of a round: known ones in the open round, otherwise such that follow from the name of the round.

    Args:
        games: Name of what is played, such as "few-shot train".
        round_: Name of the round.
        count: Number of seeds.
    """
    if round_ == OPEN_ROUND:
        return [FIRST_TEST_SEED + k for k in range(count)]
    texts = [f"{games} {round_} {k}".encode() for k in range(count)]
    hashes = [int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little") for text in texts]
    return [FIRST_TEST_SEED + count + number % (SEED_LIMIT - FIRST_TEST_SEED - count) for number in hashes]


def draw_round(policy: str) -> str:
    """Draw the word of a new round after a policy was frozen: a digest of its file, and a random number that nobody can choose.

    Args:
        policy: "module:name", whose module lies in the current folder or is installed, or the path of a file.
    """
    module = policy.partition(":")[0]
    place = Path(*module.split("."))
    paths = [Path(policy), place.with_suffix(".py"), place / "__init__.py"]
    content = next((path.read_bytes() for path in paths if path.is_file()), policy.encode())
    return f"{hashlib.blake2b(content, digest_size=16).hexdigest()}-{secrets.token_hex(4)}"
