"""Players: who makes the calls. `player(name)` gives one that is shipped, or a function of a module of yours, `module:name`."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable

from stage.agents.arena.loop import Player
from stage.agents.arena.players import searches, simple, technician, trained
from stage.errors import ArgumentError, unknown

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
        raise ArgumentError(f"{unknown('player', name, SHIPPED)} Or give module:function, which takes a Table.")
    module, _, attribute = name.partition(":")
    if "" not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        found = getattr(importlib.import_module(module), attribute)
    except ImportError as why:
        raise ArgumentError(f"player {name}: {why}. Name a module that Python finds from this folder.") from why
    except AttributeError:
        raise ArgumentError(f"player {name}: module {module} has no {attribute!r}.") from None
    if not callable(found):
        raise ArgumentError(f"player {name}: is no function of a Table.")
    return found
