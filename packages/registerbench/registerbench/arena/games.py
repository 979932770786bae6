"""Games that an agent plays by tools: broken set-ups to diagnose, and episodes of the tasks of the benchmark.

make_suite("diagnosis")                 the set-ups of the open round; make_suite("diagnosis:late") is a named one, for practice
make_suite("few-shot", episodes=8)      the first test episodes of a task
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from registerbench.arena.action_converters import make_action_converter
from registerbench.benchmark_tasks import CARDS, OPEN_ROUND, draw_test_seeds
from registerbench.diagnosis import SETUPS, Case, Setup, generate_setup
from registerbench.entry_creation import EpisodeSequence, limit_episodes
from registerbench.entry_files import Entry
from stage.agents import Tool
from stage.agents.tool import ToolSet
from stage.agents.tool_arguments import choose
from stage.errors import ArgumentError, StageError

DIAGNOSIS = "diagnosis"
TRACK = "tools"
TRAIN = "train"  # default split
DIAGNOSIS_GAMES = 64  # set-ups of a round


class Game:
    """Game that a player plays by calling tools.

    Attributes:
        name: Name of the game.
        seed: Seed of the episode or of the set-up; None for named set-ups.
        task: Goal of the game, in words.
        calls: Tools of the player.
    """

    name: str
    seed: int | None = None
    task: str
    calls: ToolSet

    @property
    def over(self) -> bool:
        """True if the game has ended."""
        raise NotImplementedError

    def compute_scores(self) -> dict[str, float]:
        """Compute the scores by name, among them "value". This is called once, at the end of the game."""
        raise NotImplementedError

    def close(self) -> None:
        """Close the tools of the game."""
        self.calls.close("this game is over.")


class DiagnosisGame(Game):
    """Game in which the player diagnoses and repairs a broken set-up."""

    def __init__(self, name: str, setup: Setup | str, seed: int | None = None):
        self.case, self.name, self.seed = Case(setup), name, seed
        self.task, self.calls = self.case.task, self.case.box

    @property
    def over(self) -> bool:
        return self.case.over

    def compute_scores(self) -> dict[str, float]:
        reached = self.case.compute_score()
        return {
            "value": reached.value,
            "found": reached.found,
            "mended": float(reached.repaired),
            "work": reached.work,
            "runs": reached.runs,
            "moves": reached.moves,
            "calls": reached.calls,
        }


TASK_TEXT = """RegisterBench, task {name}: {asked}. The machine is drawn anew for each episode, and hidden; you see what a host on
the bus can know. `observe` tells it, `formula` what the engineer's rule would do, `act` does it: {act} The episode ends by
itself."""


class BenchmarkGame(Game):
    """Game that consists of one test episode of a task. The games of a suite share one `EpisodeSequence`."""

    def __init__(self, sequence: EpisodeSequence):
        self._sequence, self.number = sequence, sequence.finished
        self.name, self.seed = _list_episodes(sequence)[self.number]
        self._converter = make_action_converter(sequence)
        sequence.begin()
        arguments = self._converter.describe_arguments()
        self.calls = ToolSet(
            [
                Tool("task", "What is to be done.", lambda: self.task, free=True),
                Tool("observe", "What a host knows now, by name.", self._converter.describe_observation, free=True),
                Tool(
                    "formula",
                    "What the task's own rule would do now, as arguments of act.",
                    self._answer_formula_tool,
                    free=True,
                ),
                Tool("act", self._converter.description, self._answer_act_tool, arguments, moves=True),
            ]
        )
        self.task = TASK_TEXT.format(
            name=sequence.card.name, asked=sequence.card.asked, act=self._converter.description
        )

    @property
    def over(self) -> bool:
        return self._sequence.finished > self.number

    def _answer_formula_tool(self) -> dict[str, Any]:
        """Answer the tool `formula`: the arguments of `act` that the task's formula proposes."""
        self._require_running()
        return self._converter.choose_formula_arguments()

    def _answer_act_tool(self, **arguments: Any) -> dict[str, Any]:
        """Answer the tool `act`: make a step of the environment, and return the observation and the info."""
        self._require_running()
        self._sequence.act(self._converter.make_action(**arguments))
        return {"over": self.over, **self._converter.describe_observation()}

    def _require_running(self) -> None:
        """Raise an error if the episode is over."""
        if self.over:
            raise StageError("this episode is over: nothing can be done in it any more.")

    def compute_scores(self) -> dict[str, float]:
        left_steps = 0
        while not self.over:  # the rest of an episode that its player left is played with actions that do nothing
            self._sequence.act(self._converter.choose_idle_action())
            left_steps += 1
        return {
            "value": self._sequence.scores[self.number]["return"],
            **self._sequence.scores[self.number],
            "given_up": left_steps,
        }


class Suite:
    """Suite of games; a loop over the suite makes and closes them one after the other.

    Attributes:
        name: Name of the suite.
        split, round: Split and round; "" for what a suite does not have.
        games: Name and seed of each game.
        total_games: Number of games of the complete suite.
    """

    def __init__(
        self,
        name: str,
        games: Sequence[tuple[str, int | None]],
        total_games: int,
        make_game: Callable[[int], Game],
        sequence: EpisodeSequence | None = None,
        round_: str = "",
    ):
        self.name, self.games, self.total_games, self._make_game, self._sequence = (
            name,
            tuple(games),
            total_games,
            make_game,
            sequence,
        )
        self.split, self.round = ("", round_) if sequence is None else (sequence.split, sequence.round_)

    def __iter__(self) -> Iterator[Game]:
        try:
            for k in range(len(self.games)):
                game = self._make_game(k)
                try:
                    yield game
                finally:
                    game.close()
        finally:
            if self._sequence is not None:
                self._sequence.close()

    def build_entry(self, player: str, cost: dict[str, float], notes: str = "") -> Entry | None:
        """Build the entry of the benchmark, which `stage bench-verify` replays; return None for broken set-ups.

        Args:
            player: Name of the player.
            cost: What the player spent, by name.
            notes: Text to store in the entry.
        """
        return None if self._sequence is None else self._sequence.build_entry(player, 0, notes, cost)


def list_suites() -> list[str]:
    """List the names of all suites."""
    return [DIAGNOSIS, *CARDS]


def make_suite(name: str, split: str = TRAIN, episodes: int | None = None, round_: str = OPEN_ROUND) -> Suite:
    """Make the suite with this name.

    Args:
        name: Name of a task, "diagnosis", or "diagnosis:NAME" for one broken set-up.
        split: Split of the task.
        episodes: Number of games to play; None: all.
        round_: Round of the benchmark.

    Raises:
        ArgumentError: There is no such suite or set-up, or not so many episodes.
    """
    first, _, set_up = name.partition(":")
    kind = choose("suite", first, tuple(list_suites()))
    if kind == DIAGNOSIS:
        return _make_diagnosis_suite(set_up, split, episodes, round_)
    if set_up:
        raise ArgumentError(f"suite {name!r}: {kind} has episodes, and no names in them; give episodes=1 for one.")
    sequence = EpisodeSequence(kind, split, TRACK, round_, {}, episodes)
    return Suite(kind, _list_episodes(sequence), sequence.card.episodes, lambda k: BenchmarkGame(sequence), sequence)


def _make_diagnosis_suite(set_up: str, split: str, episodes: int | None, round_: str) -> Suite:
    """Make the suite of a round's set-ups, or of one named set-up. The arguments are those of `make_suite`."""
    if split != TRAIN:
        raise ArgumentError(f"split {split!r}: {DIAGNOSIS} has no splits; they are of RegisterBench's tasks.")
    if set_up:
        limit_episodes([0], episodes)
        name = f"{DIAGNOSIS}:{choose('set-up', set_up, tuple(SETUPS))}"
        return Suite(name, [(name, None)], len(SETUPS), lambda k: DiagnosisGame(name, set_up))
    seeds = limit_episodes(draw_test_seeds(DIAGNOSIS, round_, DIAGNOSIS_GAMES), episodes)
    games = [(f"{DIAGNOSIS}:{k}", seed) for k, seed in enumerate(seeds)]
    make_game = lambda k: DiagnosisGame(games[k][0], generate_setup(seeds[k]), seeds[k])  # noqa: E731
    return Suite(DIAGNOSIS, games, DIAGNOSIS_GAMES, make_game, round_=round_)


def _list_episodes(sequence: EpisodeSequence) -> list[tuple[str, int | None]]:
    """List the name and the seed of each episode."""
    return [(f"{sequence.card.name}:{sequence.split}:{k}", seed) for k, seed in enumerate(sequence.seeds)]
