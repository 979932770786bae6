"""Players of games: `make_player(name)` makes a shipped player, or one that plays as `module:name` in a process of its own."""

from __future__ import annotations

from collections.abc import Callable

from registerbench.arena.players import diagnosis_technician, formula_and_random, rate_searches, trained_policy
from registerbench.arena.suite_runner import GamePlayer
from stage.errors import ArgumentError, unknown_name_error

SHIPPED_PLAYERS: dict[str, Callable[[], GamePlayer]] = {
    "formula": lambda: formula_and_random.play_formula,
    "random": formula_and_random.RandomPlayer,
    "coordinate": lambda: rate_searches.search_by_coordinate,
    "optuna": lambda: rate_searches.search_by_optuna,
    "trained": lambda: trained_policy.play_trained_policy,
    "technician": lambda: diagnosis_technician.play_technician,
}
"""Functions that make each shipped player, by name."""


def make_game_player(name: str) -> GamePlayer:
    """Make the player with this name. Raises ArgumentError."""
    if name in SHIPPED_PLAYERS:
        return SHIPPED_PLAYERS[name]()
    if ":" not in name:
        raise ArgumentError(
            f"{unknown_name_error('player', name, SHIPPED_PLAYERS)} Or give module:function, which takes a GameSession."
        )
    from registerbench.arena.players.external_command import FunctionPlayer

    return FunctionPlayer(name)
