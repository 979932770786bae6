"""RegisterBench: fixed test episodes of the environments, entries that are files of actions, and their replay bit for bit.

    import registerbench

    entry = registerbench.play("random", "few-shot", "train")     the first argument is a player's name or a policy
    entry.write("random.bench")
    print(registerbench.verify("random.bench"))                   plays the actions again, without the policy

benchmark_tasks.py holds the tasks and their test episodes, policies.py the kinds of policies, entry_files.py the file format.
entry_creation.py plays episodes, entry_replay.py repeats and compares them, and score_statistics.py decides whether one
method beats another. arena/ measures agents, diagnosis/ has broken set-ups, and baselines/ made the published results.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from registerbench.benchmark_tasks import CARDS, Card, list_test_seeds
    from registerbench.entry_creation import play
    from registerbench.entry_files import Entry, read_entries, read_entry
    from registerbench.entry_replay import Verdict, verify

_MODULES = {
    "CARDS": "benchmark_tasks", "Card": "benchmark_tasks", "list_test_seeds": "benchmark_tasks",
    "Entry": "entry_files", "read_entry": "entry_files", "read_entries": "entry_files",
    "play": "entry_creation", "Verdict": "entry_replay", "verify": "entry_replay",
}  # fmt: skip
__all__ = ["CARDS", "Card", "Entry", "Verdict", "list_test_seeds", "play", "read_entries", "read_entry", "verify"]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, because the list of commands needs none of them."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    return value
