"""What a client can read without a tool: the axes, register maps, facts of the chips, the last recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

from stage.agents.bus import overview
from stage.agents.toolbox import Toolbox
from stage.chips.chip import Chip
from stage.chips.register_map import dump
from stage.errors import StageError, a_or_an, unknown

JSON, TEXT = "application/json", "text/plain"


class Page(NamedTuple):
    """A resource. read: its text, for the session that asks."""

    uri: str
    name: str
    text: str
    kind: str
    read: Callable[[Toolbox], str]


def pages(catalogue: Toolbox) -> dict[str, Page]:
    """Every resource by its address; of tools without a stage none."""
    if catalogue.stage is None:
        return {}
    chips = dict.fromkeys(type(a.chip) for a in catalogue.stage.axes.values())
    made = [
        Page("stage://axes", "axes", "The model's axes: chips, travel, pulses, ways to home.", JSON, _axes),
        Page("stage://recording/last", "last recording", "The course of the last move, as columns.", JSON, _recording),
    ]
    for c in chips:
        name = c.MAP.chip
        made += [
            Page(
                f"stage://chips/{name}/registers", f"{name} registers", "The register map, bit by bit.", TEXT, _map(c)
            ),
            Page(
                f"stage://chips/{name}/facts",
                f"{name} facts",
                "What the data sheet says, in our words.",
                TEXT,
                _facts(c),
            ),
        ]
    return {p.uri: p for p in made}


def read(pages_: dict[str, Page], uri: str, box: Toolbox) -> Page:
    """The page of an address. Raises ArgumentError with near misses."""
    if uri not in pages_:
        raise unknown("resource", uri, pages_)
    return pages_[uri]


def _axes(box: Toolbox) -> str:
    return json.dumps(box.tools["describe"].act(), indent=1)


def _recording(box: Toolbox) -> str:
    if box.recordings is None:
        raise StageError("this session keeps no recordings.")
    return json.dumps(box.recordings.last())


def _map(kind: type[Chip]) -> Callable[[Toolbox], str]:
    return lambda box: dump(kind.MAP)


def _facts(kind: type[Chip]) -> Callable[[Toolbox], str]:
    return lambda box: facts(kind)


def facts(kind: type[Chip]) -> str:
    """What there is to know of a chip beside its registers, in sentences."""
    low, high = kind.CLOCK_RANGE
    counter, bits = kind.COUNTER
    lines: list[Any] = [
        f"{kind.MAP.chip}: {kind.MAP.title}.",
        f"Source: {kind.MAP.source}.",
        f"It has {kind.AXES} ax{'is' if kind.AXES == 1 else 'es'} and {kind.ADDRESSES} addresses on a bus of "
        f"{kind.DATA_MASK.bit_length()} bits.",
        f"Its reference clock is {kind.DEFAULT_CLOCK_HZ:,} Hz as a rule, and {low:,} to {high:,} Hz by the sheet.",
        f"A host counts pulses by {counter}, of {bits} bits.",
        f"Sensors are of {kind.LOGIC} logic after a reset.",
        f"It {'closes the loop over a DC motor and its encoder' if kind.SERVO else 'makes pulses for a stepper drive'}.",
        f"Inputs: {', '.join(kind.INPUTS)}. Outputs: {', '.join(kind.OUTPUTS)}.",
        "While it drives, the status has a bit for it; a start in that time changes the speed or is ignored, as the sheet says.",
        "A chip knows pulses alone: steps that the motor loses show only where a switch, an index or an encoder is met again.",
        "",
        f"What the map notes of the registers of {a_or_an(kind.MAP.chip)}:",
    ]
    noted = [f"{r.name}: {r.note}." for r in kind.MAP.registers if r.note]
    noted += [f"{p.name} {f.name}: {f.note}." for p in kind.MAP.places for f in p.fields if f.note]
    return "\n".join([*lines, *(noted or ["nothing beside their titles."]), "", overview(kind).rsplit("\n", 1)[-1]])
