"""Players: who makes the calls. `player(name)` gives one that is shipped, or a function of a module of yours, `module:name`."""

from __future__ import annotations

from collections.abc import Callable

from registerbench.arena.loop import Guarded, Player
from registerbench.arena.players import searches, simple, technician, trained
from registerbench.policies import import_attribute
from stage.errors import ArgumentError, unknown_name_error

SHIPPED: dict[str, Callable[[], Player]] = {
    "formula": lambda: simple.formula,
    "random": simple.Random,
    "coordinate": lambda: searches.coordinate,
    "optuna": lambda: searches.optuna,
    "trained": lambda: trained.play,
    "technician": lambda: technician.play,
}
"""By name; made anew for each suite."""


def player(name: str) -> Player:
    """A player by its name. Raises ArgumentError."""
    if name in SHIPPED:
        return SHIPPED[name]()
    if ":" not in name:
        raise ArgumentError(
            f"{unknown_name_error('player', name, SHIPPED)} Or give module:function, which takes a Table."
        )
    found = import_attribute(name, "player")
    if not callable(found):
        raise ArgumentError(f"player {name}: is no function of a Table.")
    return Guarded(found() if isinstance(found, type) else found)
