"""Resources that clients can read: the axes, the register maps, descriptions of the chips, and the last recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

from stage.agents.bus_tools import describe_map
from stage.agents.toolbox import Toolbox
from stage.chips.chip import Chip
from stage.chips.register_map import EVIDENCE
from stage.errors import add_article

JSON, TEXT = "application/json", "text/plain"


class ResourcePage(NamedTuple):
    """Resource that a client can read.

    Attributes:
        uri: Address.
        name: Title.
        text: Description.
        kind: MIME type, JSON or TEXT.
        read: Function that returns the content, given the toolbox of the session that reads it.
    """

    uri: str
    name: str
    text: str
    kind: str
    read: Callable[[Toolbox], str]


def list_pages(catalog: Any) -> dict[str, ResourcePage]:
    """Return all resources by their addresses; none for a catalog of tools without a stage."""
    if catalog.stage is None:
        return {}
    pages = [
        ResourcePage("stage://axes", "axes", "The model's axes: chips, travel, pulses, ways to home.", JSON, _read_axes),
        ResourcePage("stage://recording/last", "last recording", "The course of the last move, as columns.", JSON, _read_recording),
    ]  # fmt: skip
    for kind in dict.fromkeys(type(a.chip) for a in catalog.stage.axes.values()):
        uri, chip = f"stage://chips/{kind.MAP.chip}", kind.MAP.chip
        registers, facts = describe_map(kind.MAP), describe_chip(kind)
        pages += [
            ResourcePage(
                f"{uri}/registers",
                f"{chip} registers",
                "The register map, bit by bit.",
                TEXT,
                _make_text_reader(registers),
            ),
            ResourcePage(
                f"{uri}/facts",
                f"{chip} facts",
                "What the data sheet says, in our words.",
                TEXT,
                _make_text_reader(facts),
            ),
        ]
    return {p.uri: p for p in pages}


def _make_text_reader(text: str) -> Callable[[Toolbox], str]:
    """Return a `read` function that returns a constant text."""
    return lambda box: text


def _read_axes(box: Toolbox) -> str:
    """Return the description of the stage as JSON."""
    return json.dumps(box.tools["describe"].act(), indent=1)


def _read_recording(box: Toolbox) -> str:
    """Return the last recording as JSON."""
    return json.dumps(box.recordings.tabulate_last_recording())


def describe_chip(kind: type[Chip]) -> str:
    """Describe the properties of a chip except its registers, in sentences."""
    low, high = kind.CLOCK_RANGE
    counter, bits = kind.COUNTER
    lines = [
        f"{kind.MAP.chip}: {kind.MAP.title}.",
        f"Source: {kind.MAP.source}.",
        f"It has {kind.AXES} ax{'is' if kind.AXES == 1 else 'es'} and {kind.ADDRESSES} addresses on a bus of "
        f"{kind.DATA_MASK.bit_length()} bits.",
        f"Its reference clock is usually {kind.DEFAULT_CLOCK_HZ:,} Hz; the data sheet allows {low:,} to {high:,} Hz.",
        f"A host counts pulses by {counter}, of {bits} bits.",
        f"Sensors have {kind.LOGIC} logic after a reset.",
        f"It {'closes the loop over a DC motor and its encoder' if kind.SERVO else 'makes pulses for a stepper drive'}.",
        f"Inputs: {', '.join(kind.INPUTS)}. Outputs: {', '.join(kind.OUTPUTS)}.",
        "While it drives, a status bit shows it; a start in that time changes the speed or is ignored, as the data sheet says.",
        "A chip only knows pulses: steps that the motor loses show only where it meets a switch, an index or an encoder again.",
        "",
        f"Notes of the register map of {add_article(kind.MAP.chip)}:",
    ]
    notes = [f"{r.name}: {r.note}." for r in kind.MAP.registers if r.note]
    notes += [f"{p.name} {f.name}: {f.note}." for p in kind.MAP.places for f in p.fields if f.note]
    used = {r.evidence for r in kind.MAP.registers}
    evidence = "evidence: " + ", ".join(f"{tag} {text}" for tag, text in EVIDENCE.items() if tag in used)
    return "\n".join([*lines, *(notes or ["none beside the titles."]), "", evidence])
