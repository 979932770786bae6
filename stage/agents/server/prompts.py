"""Prompts that an engineer would give to an agent at this machine, with arguments to fill in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from stage.agents.tool_arguments import choose
from stage.errors import ArgumentError

MAX_ARGUMENT_CHARACTERS = 100


class PromptTemplate(NamedTuple):
    """Prompt with placeholders for arguments.

    Attributes:
        text: Description of its purpose.
        arguments: Description and default value of each argument by its name.
        template: Text of the prompt with the placeholders.
    """

    text: str
    arguments: dict[str, tuple[str, str]]
    template: str


PROMPTS: dict[str, PromptTemplate] = {
    "bring_up_axis": PromptTemplate(
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
    "find_lost_steps": PromptTemplate(
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
    "tune_move": PromptTemplate(
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


def fill_prompt(name: str, values: Mapping[str, str] | None, axes: tuple[str, ...]) -> str:
    """Fill in the arguments of a prompt.

    Args:
        name: Name of the prompt.
        values: Arguments by name; arguments that are missing have their defaults.
        axes: Names of the axes; the first is the default axis.

    Returns:
        The text to send.

    Raises:
        ArgumentError: No prompt, argument or axis has this name, or a value is too long.
    """
    prompt = PROMPTS[choose("prompt", name, tuple(PROMPTS) if axes else ())]
    filled = {key: default for key, (_, default) in prompt.arguments.items()}
    for key, value in (values or {}).items():
        if key not in filled:
            raise ArgumentError(f"prompt {name} takes no argument {key!r}. Known: {', '.join(filled)}.")
        if len(str(value)) > MAX_ARGUMENT_CHARACTERS or not str(value).isprintable():
            raise ArgumentError(f"{key}: up to {MAX_ARGUMENT_CHARACTERS} printable characters.")
        filled[key] = str(value)
    filled["axis"] = choose("axis", filled["axis"], axes) if filled["axis"] else axes[0]
    return prompt.template.format(**filled)
