"""What of an environment a host could know, and what is truth: one table an id, for spaces, `truth=` and docs/envs_entries.md.

A host reads the bus, has a clock, and can work out what follows from its own writes. All else is TRUTH: where the carriage is,
steps lost, swing, payload, friction, the angle of the rotor, and what the reward is made of.

    python -m stage.envs.entries > docs/envs_entries.md
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from stage.errors import ArgumentError

HOST, TRUTH = "host", "truth"


@dataclass(frozen=True)
class Entry:
    """An entry of an observation or of an info. text: what it is, with its unit; each: of what there is one (an axis, a chip)."""

    name: str
    who: str
    text: str
    each: str = ""


EVERYWHERE = (
    Entry(
        "cause",
        HOST,
        'why an episode ended that the task did not end: "diverged", or ""; of the simulation itself',
    ),
    Entry("reward_parts", TRUTH, "the named parts of the reward"),
)
"""Entries that each step's info has."""


class Shown:
    """The kind of the setting `truth`: True, False, or "info"."""

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError, unless it takes the value of this setting."""
        if not isinstance(value, bool) and not (isinstance(value, str) and value == "info"):
            raise ArgumentError(
                f"{name}={value!r}: True (observation and info have what no host can see), 'info' (info alone) or False (neither)."
            )


def observed(entries: Iterable[Entry], truth: Any) -> list[bool]:
    """Which of these an observation has with this setting of `truth`."""
    return [e.who == HOST or truth is True for e in entries]


def hidden(entries: Iterable[Entry], truth: Any) -> frozenset[str]:
    """Names of an info that are left out with this setting of `truth`."""
    return frozenset(e.name for e in (*entries, *EVERYWHERE) if e.who == TRUTH and truth is False)


PAGE = """# Host or truth

Made by `python -m stage.envs.entries`. Do not edit.

A **host** reads the bus, has a clock, and can work out what follows from its own writes. All else is **truth**, which only a
simulation knows: where the carriage is, steps lost, swing, payload, friction, the angle of the rotor, and what the reward is
made of. The setting `truth` says where truth is shown:

| `truth=` | observation | info |
|---|---|---|
| `True` | everything | everything |
| `"info"` | what a host can know | everything |
| `False` | what a host can know | what a host can know |

Entries that are not shown are left out, so the observation space is smaller. The reward and the end of an episode are the judge's,
and are given in any case: a policy that learns from them uses truth while it learns, and none when it acts. `env.unwrapped.entries`
lists the entries of the observation in their order.
"""


def page() -> str:
    """docs/envs_entries.md"""
    from importlib import import_module

    from stage.envs import IDS

    said = [PAGE]
    for id_, where in IDS.items():
        module, name = where.split(":")
        task = getattr(import_module(f"stage.envs.{module}"), name)
        default = task.Config.truth
        said += [
            f"## {id_}",
            "",
            f"`truth={default!r}` by default.",
            "",
            "| observation | who | what |",
            "|---|---|---|",
        ]
        said += _rows(task.SEEN)
        said += ["", "| info | who | what |", "|---|---|---|", *_rows((*task.TOLD, *EVERYWHERE)), ""]
    return "\n".join(said).rstrip() + "\n"


def _rows(entries: Iterable[Entry]) -> list[str]:
    return [f"| {e.name} | {e.who} | {e.text}{f'; for each {e.each}' if e.each else ''} |" for e in entries]


if __name__ == "__main__":
    print(page(), end="")
