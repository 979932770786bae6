"""Features: the numbers of an observation and the values of an info, and for each whether a host could know it.

A host reads the bus, has a clock, and can compute what follows from its own writes. Everything else is TRUTH: the position of
the carriage, lost steps, swing, payload, friction, the angle of the rotor, and the parts of the reward. Each environment has one
table of features, from which its spaces, the setting `truth` and docs/envs_features.md follow.

    python -m stage.envs.observation_features > docs/envs_features.md
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from stage.errors import ArgumentError

HOST, TRUTH = "host", "truth"


@dataclass(frozen=True)
class Feature:
    """Description of a number of an observation, or of a value of an info.

    Attributes:
        name: Key in the info; several numbers of an observation may share a name.
        who: HOST if a host can know the value, TRUTH if only the simulation knows it.
        text: Meaning and unit.
        each: Thing of which each has such a number, such as "axis" or "chip"; "" for a single number.
        kind: Type of the value in the info of a step. None for numbers of an observation, and for values that only the info of a
            reset has.
    """

    name: str
    who: str
    text: str
    each: str = ""
    kind: Any = None


EVERY_STEP_FEATURES = (
    Feature("cause", HOST, 'why the simulation itself ended the episode: "diverged", otherwise ""'),
    Feature("reward_parts", TRUTH, "the named parts of the reward"),
)
"""Features of the info of every step."""


class TruthSetting:
    """Check of the setting `truth`, which accepts True, False and "info"."""

    def check(self, name: str, value: Any) -> None:
        """Raise ArgumentError unless the setting `name` accepts the value."""
        if not isinstance(value, bool) and not (isinstance(value, str) and value == "info"):
            raise ArgumentError(
                f"{name}={value!r}: True (observation and info have what no host can see), 'info' (info alone) or False (neither)."
            )


def list_visibility(features: Iterable[Feature], truth: Any) -> list[bool]:
    """List for each feature whether an observation contains it.

    Args:
        features: Features of the observation.
        truth: The setting `truth`.
    """
    return [f.who == HOST or truth is True for f in features]


def list_hidden_names(features: Iterable[Feature], truth: Any) -> frozenset[str]:
    """List the names that an info lacks because of the setting `truth`.

    Args:
        features: Features of the info.
        truth: The setting `truth`.
    """
    return frozenset(f.name for f in (*features, *EVERY_STEP_FEATURES) if f.who == TRUTH and truth is False)


PAGE = """# Host or truth

`python -m stage.envs.observation_features` writes this page. Do not edit it.

A **host** reads the bus, has a clock, and can compute what follows from its own writes. Everything else is **truth**, which
only a simulation knows: the position of the carriage, lost steps, oscillation, payload, friction, the angle of the rotor, and
the parts of the reward. The setting `truth` selects where truth appears:

| `truth=` | observation | info |
|---|---|---|
| `True` | everything | everything |
| `"info"` | what a host can know | everything |
| `False` | what a host can know | what a host can know |

The observation space is smaller without the hidden numbers. The reward and the end of an episode do not depend on the
setting: a policy that learns from them uses truth during training, but not when it acts.
`env.unwrapped.observation_features` lists the numbers of the observation in order.
"""


def format_features_page() -> str:
    """Return the text of docs/envs_features.md."""
    from importlib import import_module

    from stage.envs import IDS

    lines = [PAGE]
    for id_, where in IDS.items():
        module, name = where.split(":")
        task = getattr(import_module(f"stage.envs.{module}"), name)
        lines += [f"## {id_}", "", f"`truth={task.Config.truth!r}` by default."]
        for title, features in (("observation", task.OBSERVATION), ("info", (*task.INFO, *EVERY_STEP_FEATURES))):
            lines += ["", f"| {title} | who | what |", "|---|---|---|"]
            lines += [f"| {f.name} | {f.who} | {f.text}{f'; for each {f.each}' if f.each else ''} |" for f in features]
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    print(format_features_page(), end="")
