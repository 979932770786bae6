"""RegisterBench: fixed test episodes of the environments, entries that are files of actions, and their replay bit for bit.

    import registerbench

    entry = registerbench.play("random", "few-shot", "train")     a player's name, or a policy: see policies.py
    entry.write("random.bench")
    print(registerbench.verify("random.bench"))                   plays the actions again, without the policy

cards.py has the tasks and their test episodes, entry_files.py the format; episodes.py plays, replay.py compares, statistics.py
tells when one method beats another. arena/ measures agents, diagnosis/ has broken set-ups, baselines/ made the published results.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from registerbench.cards import CARDS, Card, seeds
    from registerbench.entry_files import Submission, read, read_all
    from registerbench.episodes import play
    from registerbench.replay import Verdict, verify

_MODULES = {
    "CARDS": "cards", "Card": "cards", "seeds": "cards", "Submission": "entry_files", "read": "entry_files",
    "read_all": "entry_files", "play": "episodes", "Verdict": "replay", "verify": "replay",
}  # fmt: skip
__all__ = ["CARDS", "Card", "Submission", "Verdict", "play", "read", "read_all", "seeds", "verify"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for: the list of commands needs none of them."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    return value
