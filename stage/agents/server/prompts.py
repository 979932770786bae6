"""Prompts: what an engineer would ask of an agent at this machine, ready to be sent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from stage.agents.fields import chosen
from stage.errors import ArgumentError

LONG = 100  # characters of an argument


class Asked(NamedTuple):
    """A prompt. arguments: name -> (what it is, the value if none is given)."""

    text: str
    arguments: dict[str, tuple[str, str]]
    says: str


PROMPTS: dict[str, Asked] = {
    "bring_up_axis": Asked(
        "Bring up an axis for the first time: from power-up to a homed axis that moves both ways.",
        {"axis": ("which one", "")},
        """Bring up axis {axis} of this machine. Nobody has moved it since power-up.

1. `describe` and `registers` tell what it is. `status` tells how it stands now.
2. Make a small and slow move first, 1 mm at 5 mm/s, and look at `report` and `status`. Then the same back.
3. `home` it. Say what ended the return, and which way ORG lies.
4. Move 10 mm away and home again. The pulses back to ORG should be those that you went, to a few: say whether they are.
5. Look at `diagnostics`. Explain every mistake that stands there.

Read what a tool answers before you call the next one. At the end say in five lines what works, what does not, and how you know.""",
    ),
    "find_lost_steps": Asked(
        "Find out at which speed an axis loses steps, with what a host can know.",
        {"axis": ("which one", "")},
        """Find the highest speed at which axis {axis} loses no step. The chip does not know lost steps: it counts pulses.

A host finds them by ORG: home, go some way at the speed in question, come back slowly, and home again. If the pulses of the second
return differ from what the way should need by a full electrical period or more, steps were lost on the way.

1. Home the axis and keep a snapshot.
2. Try speeds from low to high, with the same ramps; put the stage back before each.
3. When one loses steps, close in on the limit to 5 %.
4. Then find out whether the ramp or the speed is the cause: the same top speed with a ramp of twice the time.

Say the limit in mm/s and in pulses a second, what was found for it, and what speed you would allow in production, and why.""",
    ),
    "tune_move": Asked(
        "Make one move as fast as it goes without losing steps.",
        {"axis": ("which one", ""), "distance": ("of the move", "20mm")},
        """Tune one move of axis {axis}: {distance}, as fast as it goes, with no step lost and some margin.

1. Home, and keep a snapshot in front of the move.
2. Begin with the usual speeds. `report` says how long it took.
3. Change one thing at a time: drive speed, ramps, start speed. After each try check by ORG that no step was lost, see the prompt
   find_lost_steps; put the stage back before the next.
4. Mind the budget: `budget` says what is left.
5. Repeat the best ten times from snapshots that differ by some pulses, so that no rotor angle was the lucky one.

At the end give the registers or speeds, the time, the time of the usual ones, and how sure you are.""",
    ),
}


def prompt(name: str, given: Mapping[str, str] | None, axes: tuple[str, ...]) -> str:
    """The text of a prompt. Raises ArgumentError."""
    asked = PROMPTS[chosen("prompt", name, tuple(PROMPTS) if axes else ())]
    values = {key: default for key, (_, default) in asked.arguments.items()}
    for key, value in (given or {}).items():
        if key not in values:
            raise ArgumentError(f"prompt {name} takes no argument {key!r}. Known: {', '.join(values)}.")
        if len(str(value)) > LONG or not str(value).isprintable():
            raise ArgumentError(f"{key}: up to {LONG} printable characters.")
        values[key] = str(value)
    values["axis"] = chosen("axis", values["axis"], axes) if values["axis"] else axes[0]
    return asked.says.format(**values)
