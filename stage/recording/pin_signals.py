"""Pins as an oscilloscope shows them: names and polarity on the wire, chip phases, status bits; each family defines its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from stage.chips.journal import Journal, Replay
from stage.chips.journal_entries import RESET, WRITE

SWITCHES = {
    "el_minus": ("EL-", "el"), "org": ("ORG", "org"), "sd_minus": ("SD-", "sd"), "sd_plus": ("SD+", "sd"),
    "el_plus": ("EL+", "el"),
}  # fmt: skip
"""Switch pin -> (label, kind), in the order along an axis."""

HOLD, CONTROL = "hold", "control"


def find_wire(chip: Any, pin: str) -> tuple[str, int]:
    """Return the name of a pin on the wire, and its level while asserted.

    Args:
        chip: The chip.
        pin: Name of the pin.
    """
    return chip.WIRES.get(pin, (pin.upper(), 1))


def settle_edges(pieces: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield the edges without those that another edge at the same clock follows: the levels on which the wires settle."""
    rest: np.ndarray | None = None
    for piece in pieces:
        if rest is not None:
            piece = np.concatenate([rest, piece])
        is_last = piece["clock"][1:] != piece["clock"][:-1]
        rest = piece[-1:]
        if is_last.any():
            yield piece[:-1][is_last]
    if rest is not None:
        yield rest


def list_pin_edges(journal: Journal | Replay) -> np.ndarray:
    """Return the edges of a chip at which a pin other than the pulses changes, and the first (of a Replay, what is new)."""
    parts: list[np.ndarray] = []
    before = None
    for piece in settle_edges(journal.pieces()):
        pins = np.stack([piece["inputs"], piece["outputs"]], axis=1)
        same = np.all(pins[1:] == pins[:-1], axis=1)
        parts.append(piece[~np.concatenate([[before is not None and bool(np.all(pins[0] == before))], same])])
        before = pins[-1]
    return np.concatenate(parts)


def find_changes(edges: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where a signal changes; the first edge is a change.

    Args:
        edges: Edges of a chip, (n,).
        values: Value from each edge on, (n,).

    Returns:
        Clocks and values of the changes.
    """
    is_change = np.concatenate([[True], values[1:] != values[:-1]])
    return edges["clock"][is_change], values[is_change]


def is_asserted(chip: Any, edges: np.ndarray, pin: str) -> np.ndarray:
    """Return the state of a pin from each edge on.

    Args:
        chip: The chip.
        edges: Edges of its journal, (n,).
        pin: Name of the pin, or of the switch wired to it.

    Returns:
        Booleans, (n,).
    """
    bit = chip.wired(pin)
    return (edges["inputs"] & bit if bit else edges["outputs"] & chip.OUTPUTS[pin]) != 0


def is_switch_on(axis: Any, edges: np.ndarray, switch: str) -> np.ndarray:
    """Return from each edge on whether a switch, or one that shares its pin, is on, as the pin says.

    Args:
        axis: The axis.
        edges: Edges of its chip, (n,).
        switch: Name of the switch.

    Returns:
        Booleans, (n,).
    """
    is_positive = any(axis.chip.wired(s) == axis.chip.wired(switch) for s in getattr(axis, "wiring", ()))
    return is_asserted(axis.chip, edges, switch) != is_positive


def list_phases(chip: Any) -> list[str]:
    """Return the phases that a chip can have, the one without a pin last."""
    rest = CONTROL if chip.SERVO else HOLD
    return [*dict.fromkeys(phase for phase in chip.PHASES.values() if phase != rest), rest]


def find_phases(chip: Any, edges: np.ndarray) -> np.ndarray:
    """Return the chip's phase from each edge on: up, keep, down, hold; of a servo idle, profile, control.

    Args:
        chip: The chip.
        edges: Edges of its journal, (n,).
    """
    rest = np.full(len(edges), list_phases(chip)[-1])
    levels = [is_asserted(chip, edges, pin) for pin in chip.PHASES]
    return np.select(levels, list(chip.PHASES.values()), rest) if levels else rest


def list_switches(axis: Any) -> Iterator[tuple[str, str, str]]:
    """Yield name, label and kind of the switches that an axis' chip can tell apart; `is_asserted` takes the name.

    Switches that are wired to one pin are one, by the pin's name.
    """
    chip = axis.chip
    wired = [p for p in SWITCHES if chip.wired(p) and p in axis.switches.as_dict()]
    for switch in wired:
        label, kind = SWITCHES[switch]
        on_one_pin = [p for p in wired if chip.wired(p) == chip.wired(switch)]
        if len(on_one_pin) == 1:
            yield switch, label, kind
        elif switch == on_one_pin[0]:
            yield chip.WIRING[switch], kind.upper(), kind


def decode_status(chip: Any, edges: np.ndarray, minus: np.ndarray) -> dict[str, np.ndarray]:
    """Return the bits of the status byte from each edge on, as a read at address 0 would give them.

    Args:
        chip: The chip.
        edges: Edges of its journal, (n,).
        minus: Whether the direction is minus, (n,), see `list_directions`.

    Returns:
        Booleans by name of the bit, (n,); empty for a chip that has no status byte.
    """
    word = next((w for w in chip.MAP.words if w.name == "status"), None)
    bits = {}
    for field in word.fields if word is not None else ():
        levels = [_read_status_bit(chip, edges, pin) for pin in field.pins]
        if levels:
            bits[field.name] = np.where(minus, levels[-1], levels[0])
    return bits


def _read_status_bit(chip: Any, edges: np.ndarray, pin: str) -> np.ndarray:
    """Return a pin as the chip reads it, where polarity bits invert it; with / before its name the opposite."""
    name = pin.removeprefix("/")
    bit = chip.wired(name)
    has_reading = bit and "seen" in (edges.dtype.names or ())
    level = edges["seen"] & bit != 0 if has_reading else is_asserted(chip, edges, name)
    return level != pin.startswith("/")


def list_directions(chip: Any, journal: Journal) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions that bus writes select.

    Args:
        chip: The chip.
        journal: Its journal.

    Returns:
        Clocks, of which the first is the start's, and whether the direction is minus from each on.
    """
    start = journal.start
    if "minus" not in (start.dtype.names or ()):
        return np.array([int(start["clock"])]), np.array([False])
    clocks, minus = [int(start["clock"])], [bool(start["minus"])]
    for e in journal.entries:
        is_minus = False if e.kind == RESET else chip.read_direction(e.a, e.b) if e.kind == WRITE else None
        if is_minus is not None:
            clocks.append(e.clock)
            minus.append(is_minus)
    return np.array(clocks, np.int64), np.array(minus)


def to_pulse_rates(edges: np.ndarray, clock_hz: int) -> np.ndarray:
    """Return the pulse rate from each edge on, pps.

    Args:
        edges: Edges of a chip, (n,).
        clock_hz: Its clock, Hz.
    """
    return edges["rate"] * clock_hz
