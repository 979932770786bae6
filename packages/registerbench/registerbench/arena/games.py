"""What is played: a broken set-up, or an episode of RegisterBench whose actions are tool calls.

suite("diagnosis")                 the ten set-ups; suite("diagnosis:late"): one of them
suite("few-shot", episodes=8)      test episodes of a task of the bench
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from registerbench.arena.tool_actions import find_actions
from registerbench.cards import CARDS, OPEN_ROUND
from registerbench.diagnosis import SETUPS, Case
from registerbench.entry_files import Entry
from registerbench.episodes import EpisodeSequence
from stage.agents import Tool
from stage.agents.arguments import choose
from stage.agents.tool import ToolSet
from stage.errors import ArgumentError, StageError

DIAGNOSIS = "diagnosis"
TRACK = "tools"
TRAIN = "train"  # the split that is played if none is named


class Game:
    """name; seed: of an episode; task: what a player is told; calls: its tools. over: nothing is left to do."""

    name: str
    seed: int | None = None
    task: str
    calls: ToolSet

    @property
    def over(self) -> bool:
        raise NotImplementedError

    def score(self) -> dict[str, float]:
        """Return what has been reached, by name, "value" among them. Called once, at the end."""
        raise NotImplementedError

    def close(self) -> None:
        """The game is put away."""
        self.calls.close("this game is over.")


class Diagnosis(Game):
    """A broken set-up."""

    def __init__(self, name: str):
        self.case, self.name = Case(name), f"{DIAGNOSIS}:{name}"
        self.task, self.calls = self.case.task, self.case.box

    @property
    def over(self) -> bool:
        return self.case.over

    def score(self) -> dict[str, float]:
        reached = self.case.score()
        return {
            "value": reached.value,
            "found": float(reached.found),
            "mended": float(reached.repaired),
            "work": reached.work,
            "runs": reached.runs,
        }


TASK_TEXT = """RegisterBench, task {name}: {asked}. The machine is drawn anew for each episode, and hidden; you see what a host on
the bus can know. `observe` tells it, `formula` what the engineer's rule would do, `act` does it: {act} The episode ends by
itself."""


class Bench(Game):
    """An episode of a task. The episodes of a suite share `played`."""

    def __init__(self, played: EpisodeSequence):
        self._played, self.number = played, played.finished
        self.name, self.seed = _named(played)[self.number]
        self._actions = find_actions(played)
        played.begin()
        arguments = self._actions.arguments()
        self.calls = ToolSet(
            [
                Tool("task", "What is to be done.", lambda: self.task, free=True),
                Tool("observe", "What a host knows now, by name.", self._actions.observation, free=True),
                Tool(
                    "formula", "What the task's own rule would do now, as arguments of act.", self._formula, free=True
                ),
                Tool("act", self._actions.text, self._act, arguments, moves=True),
            ]
        )
        self.task = TASK_TEXT.format(name=played.card.name, asked=played.card.asked, act=self._actions.text)

    @property
    def over(self) -> bool:
        return self._played.finished > self.number

    def _formula(self) -> dict[str, Any]:
        self._require_running()
        return self._actions.formula()

    def _act(self, **given: Any) -> dict[str, Any]:
        self._require_running()
        self._played.act(self._actions.make_action(**given))
        return {"over": self.over, **self._actions.observation()}

    def _require_running(self) -> None:
        if self.over:
            raise StageError("this episode is over: nothing can be done in it any more.")

    def score(self) -> dict[str, float]:
        left_steps = 0
        while not self.over:  # whoever goes early leaves the rest to the rule of who does nothing
            self._played.act(self._actions.idle())
            left_steps += 1
        return {
            "value": self._played.scores[self.number]["return"],
            **self._played.scores[self.number],
            "given_up": left_steps,
        }


class Suite:
    """Games one after the other: `for game in suite` makes each, and puts it away.

    name; split, round: of the bench; games: name and seed of each; of: so many has the whole suite.
    """

    def __init__(
        self,
        name: str,
        games: Sequence[tuple[str, int | None]],
        of: int,
        make: Callable[[int], Game],
        played: EpisodeSequence | None = None,
    ):
        self.name, self.games, self.of, self._make, self._played = name, tuple(games), of, make, played
        self.split, self.round = ("", "") if played is None else (played.split, played.round_)

    def __iter__(self) -> Iterator[Game]:
        try:
            for k in range(len(self.games)):
                game = self._make(k)
                try:
                    yield game
                finally:
                    game.close()
        finally:
            if self._played is not None:
                self._played.close()

    def entry(self, player: str, cost: dict[str, float], notes: str = "") -> Entry | None:
        """Return the entry of the bench, which `stage bench-verify` replays; None for broken set-ups.

        Args:
            player: Name of the player.
            cost: What the player took.
            notes: Anything to be kept with it.
        """
        return None if self._played is None else self._played.build_entry(player, 0, notes, cost)


def suites() -> list[str]:
    """List the names of all suites."""
    return [DIAGNOSIS, *CARDS]


def suite(name: str, split: str = TRAIN, episodes: int | None = None, round_: str = OPEN_ROUND) -> Suite:
    """Return the suite of this name.

    Args:
        name: Of a task of the bench; "diagnosis", or "diagnosis:NAME" for one set-up.
        split: Of the task.
        episodes: Play only the first ones.
        round_: Of the bench.

    Raises:
        ArgumentError: There is no such suite, set-up or number of episodes.
    """
    first, _, one = name.partition(":")
    kind = choose("suite", first, tuple(suites()))
    if kind == DIAGNOSIS:
        if split != TRAIN:
            raise ArgumentError(f"split {split!r}: {DIAGNOSIS} has no splits; they are of RegisterBench's tasks.")
        names = [choose("set-up", one, tuple(SETUPS))] if one else list(SETUPS)
        if episodes is not None and not 1 <= episodes <= len(names):
            raise ArgumentError(f"episodes={episodes}: 1 to {len(names)} here.")
        names = names[:episodes]
        return Suite(name, [(f"{DIAGNOSIS}:{n}", None) for n in names], len(SETUPS), lambda k: Diagnosis(names[k]))
    if one:
        raise ArgumentError(f"suite {name!r}: {kind} has episodes, and no names in them; give episodes=1 for one.")
    played = EpisodeSequence(kind, split, TRACK, round_, {}, episodes)
    return Suite(kind, _named(played), played.card.episodes, lambda k: Bench(played), played)


def _named(played: EpisodeSequence) -> list[tuple[str, int | None]]:
    """List the name and the seed of each episode."""
    return [(f"{played.card.name}:{played.split}:{k}", seed) for k, seed in enumerate(played.seeds)]
