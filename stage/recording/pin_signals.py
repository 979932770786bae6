"""Signals of chips as an oscilloscope shows them: names and polarity of pins, motion phases, status bits.

The class of each chip family defines the names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from stage.chips.journal import GrowingJournalReplay, Journal
from stage.chips.journal_entries import RESET, WRITE

SWITCHES = {
    "el_minus": ("EL-", "el"), "org": ("ORG", "org"), "sd_minus": ("SD-", "sd"), "sd_plus": ("SD+", "sd"),
    "el_plus": ("EL+", "el"),
}  # fmt: skip
"""Switch pin -> (label, kind), in the order along an axis."""

HOLD, CONTROL = "hold", "control"


def find_wire_name_and_level(chip: Any, pin: str) -> tuple[str, int]:
    """Return the name of a pin's wire, and the level (0 or 1) of the wire while the pin is asserted.

    Args:
        chip: The chip.
        pin: Name of the pin.
    """
    return chip.WIRES.get(pin, (pin.upper(), 1))


def settle_edges(edge_arrays: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield only the last of several edges at the same clock, which has the final levels of the wires.

    Args:
        edge_arrays: Successive arrays of edges of a chip.
    """
    rest: np.ndarray | None = None
    for edges in edge_arrays:
        if rest is not None:
            edges = np.concatenate([rest, edges])
        is_last = edges["clock"][1:] != edges["clock"][:-1]
        rest = edges[-1:]
        if is_last.any():
            yield edges[:-1][is_last]
    if rest is not None:
        yield rest


def list_pin_edges(journal: Journal | GrowingJournalReplay) -> np.ndarray:
    """Return the first edge, and each edge at which a pin that is no pulse output changes.

    Args:
        journal: Journal of the chip, or a GrowingJournalReplay, of which the new edges count.
    """
    parts: list[np.ndarray] = []
    before = None
    for piece in settle_edges(journal.replay_in_pieces()):
        pins = np.stack([piece["inputs"], piece["outputs"]], axis=1)
        same = np.all(pins[1:] == pins[:-1], axis=1)
        parts.append(piece[~np.concatenate([[before is not None and bool(np.all(pins[0] == before))], same])])
        before = pins[-1]
    return np.concatenate(parts)


def find_changes(edges: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the clocks at which a signal changes, and its new values. The first edge counts as a change.

    Args:
        edges: Edges of a chip, (n,).
        values: Value from each edge on, (n,).

    Returns:
        Clocks and values of the changes.
    """
    is_change = np.concatenate([[True], values[1:] != values[:-1]])
    return edges["clock"][is_change], values[is_change]


def is_asserted(chip: Any, edges: np.ndarray, pin: str) -> np.ndarray:
    """Return whether a pin is asserted after each edge.

    Args:
        chip: The chip.
        edges: Edges of its journal, (n,).
        pin: Name of the pin, or of the switch wired to it.

    Returns:
        Booleans, (n,).
    """
    bit = chip.find_switch_input(pin)
    return (edges["inputs"] & bit if bit else edges["outputs"] & chip.OUTPUTS[pin]) != 0


def is_switch_on(axis: Any, edges: np.ndarray, switch: str) -> np.ndarray:
    """Return after each edge whether a switch is on, as far as its pin shows that.

    If several switches share the pin, the result is True while any of them is on.

    Args:
        axis: The axis.
        edges: Edges of its chip, (n,).
        switch: Name of the switch.

    Returns:
        Booleans, (n,).
    """
    is_positive = any(
        axis.chip.find_switch_input(s) == axis.chip.find_switch_input(switch) for s in getattr(axis, "wiring", ())
    )
    return is_asserted(axis.chip, edges, switch) != is_positive


def list_motion_phases(chip: Any) -> list[str]:
    """Return the names of the motion phases of a chip, such as "up" (ramp up).

    The last one applies while no phase pin is asserted.
    """
    rest = CONTROL if chip.SERVO else HOLD
    return [*dict.fromkeys(phase for phase in chip.PHASES.values() if phase != rest), rest]


def find_motion_phases(chip: Any, edges: np.ndarray) -> np.ndarray:
    """Return the motion phase after each edge: up, keep, down, hold; for a servo idle, profile, control.

    Args:
        chip: The chip.
        edges: Edges of its journal, (n,).
    """
    rest = np.full(len(edges), list_motion_phases(chip)[-1])
    levels = [is_asserted(chip, edges, pin) for pin in chip.PHASES]
    return np.select(levels, list(chip.PHASES.values()), rest) if levels else rest


def list_switches(axis: Any) -> Iterator[tuple[str, str, str]]:
    """Yield name, label and kind of each switch that the chip of an axis can distinguish. `is_asserted` takes the name.

    Switches that share a pin are one entry, with the name of the pin.
    """
    chip = axis.chip
    wired = [p for p in SWITCHES if chip.find_switch_input(p) and p in axis.switches.as_dict()]
    for switch in wired:
        label, kind = SWITCHES[switch]
        on_one_pin = [p for p in wired if chip.find_switch_input(p) == chip.find_switch_input(switch)]
        if len(on_one_pin) == 1:
            yield switch, label, kind
        elif switch == on_one_pin[0]:
            yield chip.WIRING[switch], kind.upper(), kind


def decode_status(chip: Any, edges: np.ndarray, is_minus: np.ndarray) -> dict[str, np.ndarray]:
    """Return each bit of the status byte after each edge, as a read at address 0 would show it.

    Args:
        chip: The chip.
        edges: Edges of its journal, (n,).
        is_minus: Whether the direction is minus, (n,), see `list_directions`.

    Returns:
        Booleans by name of the bit, (n,); empty for a chip that has no status byte.
    """
    word = next((w for w in chip.MAP.words if w.name == "status"), None)
    bits = {}
    for field in word.fields if word is not None else ():
        levels = [_read_status_bit(chip, edges, pin) for pin in field.pins]
        if levels:
            bits[field.name] = np.where(is_minus, levels[-1], levels[0])
    return bits


def _read_status_bit(chip: Any, edges: np.ndarray, pin: str) -> np.ndarray:
    """Return a pin as the status byte shows it: with the polarity that the chip is set to, inverted if its name begins with "/"."""
    name = pin.removeprefix("/")
    bit = chip.find_switch_input(name)
    has_reading = bit and "seen" in (edges.dtype.names or ())
    level = edges["seen"] & bit != 0 if has_reading else is_asserted(chip, edges, name)
    return level != pin.startswith("/")


def list_directions(chip: Any, journal: Journal) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions that the bus writes in a journal select, and when.

    Args:
        chip: The chip.
        journal: Its journal.

    Returns:
        Clocks, the first of them that of the journal's start, and from each clock on whether the direction is minus.
    """
    start = journal.start_state
    if "minus" not in (start.dtype.names or ()):
        return np.array([int(start["clock"])]), np.array([False])
    clocks, minus = [int(start["clock"])], [bool(start["minus"])]
    for e in journal.entries:
        is_minus = False if e.kind == RESET else chip.find_selected_direction(e.a, e.b) if e.kind == WRITE else None
        if is_minus is not None:
            clocks.append(e.clock)
            minus.append(is_minus)
    return np.array(clocks, np.int64), np.array(minus)


def to_pulse_rates(edges: np.ndarray, clock_hz: int) -> np.ndarray:
    """Return the pulse rate after each edge, pps.

    Args:
        edges: Edges of a chip, (n,).
        clock_hz: Reference clock of the chip, Hz.
    """
    return edges["rate"] * clock_hz
