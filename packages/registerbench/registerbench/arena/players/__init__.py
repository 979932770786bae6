"""Players of games: `make_player(name)` makes a shipped player, or imports one as `module:name`."""

from __future__ import annotations

from collections.abc import Callable

from registerbench.arena.players import formula_and_random, searches, technician, trained
from registerbench.arena.suite_runner import GuardedPlayer, Player
from registerbench.policies import import_attribute
from stage.errors import ArgumentError, unknown_name_error

SHIPPED_PLAYERS: dict[str, Callable[[], Player]] = {
    "formula": lambda: formula_and_random.formula,
    "random": formula_and_random.RandomPlayer,
    "coordinate": lambda: searches.coordinate,
    "optuna": lambda: searches.optuna,
    "trained": lambda: trained.play,
    "technician": lambda: technician.play,
}
"""Functions that make each shipped player, by name."""


def make_player(name: str) -> Player:
    """Make the player with this name. Raises ArgumentError."""
    if name in SHIPPED_PLAYERS:
        return SHIPPED_PLAYERS[name]()
    if ":" not in name:
        raise ArgumentError(
            f"{unknown_name_error('player', name, SHIPPED_PLAYERS)} Or give module:function, which takes a GameSession."
        )
    player_ = import_attribute(name, "player")
    if not callable(player_):
        raise ArgumentError(f"player {name}: it is not a function of a GameSession.")
    return GuardedPlayer(player_() if isinstance(player_, type) else player_)
