"""Pins as an oscilloscope shows them: names and polarity on the wire, chip phases, status bits; each family defines its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from stage.chips.entries import RESET, WRITE
from stage.chips.journal import Journal, Replay

SWITCHES = {
    "el_minus": ("EL-", "el"), "org": ("ORG", "org"), "sd_minus": ("SD-", "sd"), "sd_plus": ("SD+", "sd"),
    "el_plus": ("EL+", "el"),
}  # fmt: skip
"""Switch pin -> (label, kind), in the order along an axis."""

HOLD, CONTROL = "hold", "control"


def find_wire(chip: Any, pin: str) -> tuple[str, int]:
    """(name, level while asserted) of a chip's pin."""
    return chip.WIRES.get(pin, (pin.upper(), 1))


def settle_edges(pieces: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Of several edges at one clock only the last: what the wires settle on."""
    kept: np.ndarray | None = None
    for piece in pieces:
        if kept is not None:
            piece = np.concatenate([kept, piece])
        last = piece["clock"][1:] != piece["clock"][:-1]
        kept = piece[-1:]
        if last.any():
            yield piece[:-1][last]
    if kept is not None:
        yield kept


def list_pin_edges(journal: Journal | Replay) -> np.ndarray:
    """The edges of a chip at which a pin other than the pulses changes, and the first (of a Replay, what is new)."""
    parts: list[np.ndarray] = []
    before = None
    for piece in settle_edges(journal.pieces()):
        pins = np.stack([piece["inputs"], piece["outputs"]], axis=1)
        same = np.all(pins[1:] == pins[:-1], axis=1)
        parts.append(piece[~np.concatenate([[before is not None and bool(np.all(pins[0] == before))], same])])
        before = pins[-1]
    return np.concatenate(parts)


def find_changes(edges: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(clocks, values) where `values`, one an edge, changes; the first is one."""
    keep = np.concatenate([[True], values[1:] != values[:-1]])
    return edges["clock"][keep], values[keep]


def is_asserted(chip: Any, edges: np.ndarray, pin: str) -> np.ndarray:
    """The state of a pin, by its name or that of the switch wired to it, from each edge on (bool); `edges` of a chip's journal."""
    bit = chip.wired(pin)
    return (edges["inputs"] & bit if bit else edges["outputs"] & chip.OUTPUTS[pin]) != 0


def is_switch_on(axis: Any, edges: np.ndarray, switch: str) -> np.ndarray:
    """Whether a switch of an axis, or what shares its pin, is on, as its pin says, from each edge on (bool)."""
    positive = any(axis.chip.wired(s) == axis.chip.wired(switch) for s in getattr(axis, "wiring", ()))
    return is_asserted(axis.chip, edges, switch) != positive


def list_phases(chip: Any) -> list[str]:
    """The phases that a chip can have, the one without a pin last."""
    rest = CONTROL if chip.SERVO else HOLD
    return [*dict.fromkeys(phase for phase in chip.PHASES.values() if phase != rest), rest]


def find_phases(chip: Any, edges: np.ndarray) -> np.ndarray:
    """The chip's phase from each edge on: up, keep, down, hold; of a servo's idle, profile, control."""
    rest = np.full(len(edges), list_phases(chip)[-1])
    found = [is_asserted(chip, edges, pin) for pin in chip.PHASES]
    return np.select(found, list(chip.PHASES.values()), rest) if found else rest


def list_switches(axis: Any) -> Iterator[tuple[str, str, str]]:
    """(name, label, kind) of what an axis' chip sees of its switches; `asserted` takes the name. Those that are wired to one pin
    are one, by the pin's name."""
    chip = axis.chip
    there = [p for p in SWITCHES if chip.wired(p) and p in axis.switches.as_dict()]
    for switch in there:
        label, kind = SWITCHES[switch]
        together = [p for p in there if chip.wired(p) == chip.wired(switch)]
        if len(together) == 1:
            yield switch, label, kind
        elif switch == together[0]:
            yield chip.WIRING[switch], kind.upper(), kind


def decode_status(chip: Any, edges: np.ndarray, minus: np.ndarray) -> dict[str, np.ndarray]:
    """The bits of the status byte from each edge on, as a read at address 0 would give them.

    minus: whether the direction is minus, see `directions`. Empty for a chip that has no status byte.
    """
    word = next((w for w in chip.MAP.words if w.name == "status"), None)
    if word is None:
        return {}
    out = {}
    for field in word.fields:
        shown = [_shown(chip, edges, pin) for pin in field.pins]
        if shown:
            out[field.name] = np.where(minus, shown[-1], shown[0])
    return out


def _shown(chip: Any, edges: np.ndarray, pin: str) -> np.ndarray:
    """What a status bit says of a pin, with / its opposite: as the chip reads it, where polarity bits turn it round."""
    name = pin.removeprefix("/")
    bit = chip.wired(name)
    seen = bit and "seen" in (edges.dtype.names or ())
    return (edges["seen"] & bit != 0 if seen else is_asserted(chip, edges, name)) != pin.startswith("/")


def list_directions(chip: Any, journal: Journal) -> tuple[np.ndarray, np.ndarray]:
    """(clocks, minus): the direction that bus writes say, from each clock on; the first clock is the start's."""
    start = journal.start
    if "minus" not in (start.dtype.names or ()):
        return np.array([int(start["clock"])]), np.array([False])
    clocks, minus = [int(start["clock"])], [bool(start["minus"])]
    for e in journal.entries:
        way = False if e.kind == RESET else chip.turns(e.a, e.b) if e.kind == WRITE else None
        if way is not None:
            clocks.append(e.clock)
            minus.append(way)
    return np.array(clocks, np.int64), np.array(minus)


def to_pulse_rates(edges: np.ndarray, clock_hz: int) -> np.ndarray:
    """Pulse rate from each edge on, pps."""
    return edges["rate"] * clock_hz
