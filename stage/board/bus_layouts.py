"""Layouts: data that say which port of a host's bus reaches which address of which chip, built in or from a file.

Chips follow one another from a base port on, each with as many ports as its layout has; after them, a card may have
ports of its own. A TOML or JSON file describes the chips of a card on a bus, without any Python:

    # card.toml: two chips whose registers alternate, and one port of the card itself
    chip = "PCL240K"
    base = 0x240
    stride = 1
    ports = ["byte 0", "none", "byte 1", "none", "byte 2", "none", "byte 3", "none"]
    chips = 8
    own = ["interrupts"]

Keys: `chip` is the class; `like` names a built-in layout that provides the remaining values; the other keys are the
attributes of `Layout`. Numbers may also be text ("0x240"), for JSON. `PORT_WORDS` lists what a port can reach.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stage.board.bus.host_record import BYTE, HALF, LAST_PORT, LATCH, LATCHED, NOTHING, PORT, PULLS, REGION, WORD
from stage.chips import CHIPS, Chip, chip_class, contract_check
from stage.chips.hctl1100 import HCTL1100
from stage.chips.nova import FIRST_BYTE_ADDRESS, MCX514, Nova
from stage.chips.pcl240 import PCL240
from stage.errors import ArgumentError, add_article, find_similar_names, unknown_name_error
from stage.support.foreign_files import DocumentError, parse_json, parse_toml, read_text

MAX_PORTS = LAST_PORT + 1
MIN_GAP = 64
"""Minimum number of consecutive unused ports that divides the table into two regions."""
PORT_WORDS = {
    "byte": (BYTE, True), "word": (WORD, True), "upper": (HALF, True), "latch": (LATCH, False), "data": (LATCHED, False),
    "interrupts": (PULLS, False), "none": (NOTHING, False),
}  # fmt: skip
"""What a port reaches, in the words of a file -> (kind, whether an address follows): an 8-bit register; a 16-bit
register; the upper byte of the preceding word; the address latch; the data port that follows the latch; the mask of
chips that pull the interrupt line; nothing."""
KEYS = ("chip", "like", "title", "base", "stride", "ports", "own", "chips")
ENDINGS = (".toml", ".json")
MAX_VALUE_CHARACTERS = 60
"""Maximum number of characters of a value in an error."""
EXAMPLE = 'ports = ["byte 0", "byte 1", "byte 2", "byte 3"]'


@dataclass(frozen=True)
class Layout:
    """Arrangement of one kind of chip on a bus.

    Attributes:
        name: Name of the layout.
        title: Description in one line.
        kind: Class of the chips.
        ports: What each port of a chip reaches: (kind, address), see stage.board.bus.host_record.
        stride: Number of ports from one chip to the next.
        base: First port of the first chip.
        own: Ports of the card itself, after the ports of `chips` chips.
        chips: Maximum number of chips on the card; 0: unlimited.
        evidence: S data sheet, I inferred (a choice of the card).
    """

    name: str
    title: str
    kind: type[Chip]
    ports: tuple[tuple[int, int], ...]
    stride: int
    base: int = 0x300
    own: tuple[tuple[int, int], ...] = ()
    chips: int = 0
    evidence: str = "S"


_FOUR_BYTE_PORTS = tuple((BYTE, a) for a in range(4))
_WORD_PORTS = tuple((WORD if n % 2 == 0 else HALF, n // 2) for n in range(16))
LAYOUTS: dict[str, Layout] = {
    x.name: x
    for x in (
        Layout("pcl240", "one chip per 4 ports: command or status, then the data bytes", PCL240, _FOUR_BYTE_PORTS, 4),
        Layout(
            "pcl240-card", "three chips, and at +12 which of them pull the interrupt line (bits 0 to 2)", PCL240,
            _FOUR_BYTE_PORTS, 4, 0x340,
            ((PULLS, 0),), 3, "I",
        ),
        Layout("nova", "16-bit bus: WRn, RRn at +2n", Nova, _WORD_PORTS, 16),
        Layout("nova-8bit", "8-bit bus of the MCX514: low byte of WRn, RRn at +2n, high byte at +2n+1", MCX514,
               tuple((BYTE, FIRST_BYTE_ADDRESS | n) for n in range(16)), 16),
        Layout("hctl1100", "address latch at +0, data at +1", HCTL1100, ((LATCH, 0), (LATCHED, 0)), 2, evidence="I"),
    )
}  # fmt: skip


def make_default_layout(chip: Chip) -> Layout:
    """Return the default layout of a chip: a built-in one, or the one that its class names in LAYOUT.

    For a class that names none, each bus address has its own port.
    """
    for layout in LAYOUTS.values():
        if isinstance(chip, layout.kind):
            return layout
    if chip.LAYOUT:
        layout = contract_check.load_attribute(type(chip), "LAYOUT", "its layout")
        if not isinstance(layout, Layout):
            raise ArgumentError(
                f"{type(chip).__name__}: LAYOUT = {chip.LAYOUT!r} is no stage.board.bus_layouts.Layout."
            )
        return layout
    ports = [(BYTE, a) for a in range(chip.ADDRESSES)]
    if chip.DATA_MASK > 0xFF:
        ports = [(kind, a) for a in range(chip.ADDRESSES) for kind in (WORD, HALF)]
    return Layout(
        type(chip).__name__.lower(), "one address after the other", type(chip), tuple(ports), len(ports), evidence="I"
    )


@dataclass(frozen=True)
class ChipPlace:
    """Position of a chip on a bus.

    Attributes:
        chip: The chip.
        index: Index of the chip in the stage's chips.
        layout: Layout of the chip.
        first: First port of the chip.
    """

    chip: Chip
    index: int
    layout: Layout
    first: int


def assign_ports(
    chips: Mapping[int, Chip], layout: Layout | None, base: int | Mapping[Chip, int] | None, stride: int | None
) -> list[ChipPlace]:
    """Assign ports to the chips of a stage.

    Args:
        chips: Chips by index, in their order on the bus.
        layout: Layout of all chips; default: the default layout of each chip.
        base: First port of the first chip, or of each chip; default: the base of the layout.
        stride: Number of ports from one chip to the next; default: the stride of the layout.

    Returns:
        The position of each chip.

    Raises:
        ArgumentError: The layout does not fit a chip, or a port does not exist.
    """
    places: list[ChipPlace] = []
    next_base = None if isinstance(base, Mapping) else base
    for k, chip in chips.items():
        chip_layout = layout or make_default_layout(chip)
        if not isinstance(chip, chip_layout.kind):
            fitting = ", ".join(x.name for x in LAYOUTS.values() if isinstance(chip, x.kind))
            raise ArgumentError(
                f"layout {chip_layout.name}: it is for {add_article(chip_layout.kind.__name__)}, and this stage has "
                f"{add_article(type(chip).__name__)}. Layouts for "
                f"that: {fitting or 'the one that it has without layout=, or a Layout of yours'}."
            )
        if chip_layout.chips and len(chips) > chip_layout.chips:
            raise ArgumentError(
                f"layout {chip_layout.name}: it has room for {chip_layout.chips} chips, and this stage has {len(chips)}."
            )
        first = base[chip] if isinstance(base, Mapping) else chip_layout.base if next_base is None else next_base
        if not isinstance(first, int | np.integer) or not 0 <= first <= MAX_PORTS - len(chip_layout.ports):
            text = f"{first:#x}" if isinstance(first, int | np.integer) else repr(first)
            raise ArgumentError(
                f"base={text}: ports are whole numbers from 0 to {LAST_PORT:X}h, and the chip takes {len(chip_layout.ports)}."
            )
        places.append(ChipPlace(chip, k, chip_layout, int(first)))
        next_base = int(first) + (chip_layout.stride if stride is None else stride)
    return places


def make_port_table(
    places: list[ChipPlace], others: Mapping[int, tuple[int, int, int, int]] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Build the table of ports of a bus.

    Args:
        places: Positions of the chips.
        others: Ports of devices: (kind, device, address, mask) by port.

    Returns:
        REGION records and PORT records.

    Raises:
        ArgumentError: Two chips or devices share a port, or a port does not exist.
    """
    rows: dict[int, tuple[int, int, int, int]] = dict(others or {})

    def put(port: int, kind: int, chip: int, address: int, mask: int) -> None:
        """Store what a port of the bus reaches. Raises ArgumentError if the port is taken or does not exist."""
        if kind == NOTHING:
            return
        if port > LAST_PORT:
            raise ArgumentError(f"port {port:X}h: ports are 0 to {LAST_PORT:X}h, choose a lower base.")
        if port in rows:
            raise ArgumentError(
                f"port {port:03X}h would reach two things: choose another base or a stride of more ports."
            )
        rows[port] = (kind, chip, address, mask)

    for place in places:
        for n, (kind, address) in enumerate(place.layout.ports):
            put(place.first + n, kind, place.index, address, place.chip.ADDRESS_MASK)
    if places and (card := places[0].layout).own:
        for n, (kind, address) in enumerate(card.own):
            put(places[0].first + card.stride * card.chips + n, kind, 0, address, 0)
    if not rows:
        return np.zeros(0, REGION), np.zeros(1, PORT)
    numbers = np.array(sorted(rows), np.int64)
    ends = np.flatnonzero(np.diff(numbers, append=1 << 62) > MIN_GAP)
    firsts = numbers[np.concatenate([[0], ends[:-1] + 1])]
    regions = np.zeros(len(firsts), REGION)
    regions["first"], regions["n"] = firsts, numbers[ends] - firsts + 1
    regions["at"] = 1 + np.cumsum(regions["n"]) - regions["n"]
    ports = np.zeros(1 + int(regions["n"].sum()), PORT)
    shifts = np.repeat(regions["first"] - regions["at"] + 1, np.diff(ends, prepend=-1))
    ports[1:][numbers - shifts] = [(*rows[port], 0) for port in numbers.tolist()]
    return regions, ports


def list_port_numbers(regions: np.ndarray) -> np.ndarray:
    """Return the port of each PORT record in a table; -1 for the first record."""
    return np.concatenate([[-1], *(np.arange(first, first + n) for first, n, _ in regions.tolist())])


# --- files ---


def is_layout_file(layout: Any) -> bool:
    """Return whether `layout` is the path of a file, as opposed to the name of a layout."""
    return isinstance(layout, os.PathLike) or (isinstance(layout, str) and bool(Path(layout).suffix))


def load_layout(layout: str | os.PathLike | Layout | None) -> Layout | None:
    """Return a layout by its name or from a file. Raises ArgumentError and the errors of `read_layout`."""
    if is_layout_file(layout):
        return read_layout(layout)  # type: ignore[arg-type]
    if isinstance(layout, str):
        return _find_shipped_layout(layout)
    return layout  # type: ignore[return-value]


def _find_shipped_layout(name: str) -> Layout:
    """Return the built-in layout of this name. Raises ArgumentError."""
    if name not in LAYOUTS:
        raise unknown_name_error("layout", name[:MAX_VALUE_CHARACTERS], LAYOUTS)
    return LAYOUTS[name]


def read_layout(path: str | os.PathLike) -> Layout:
    """Read a layout from a TOML or JSON file.

    Raises:
        FileError: The file cannot be read.
        ArgumentError: The file contains no valid layout; the message names the line to write.
    """
    file = Path(path)
    if file.suffix not in ENDINGS:
        raise ArgumentError(f"layout {path}: a layout is a file that ends in {' or '.join(ENDINGS)}.")
    text = read_text(path, "layout")
    try:
        content = parse_toml(text) if file.suffix == ".toml" else parse_json(text)
    except DocumentError as error:
        raise ArgumentError(f"layout {path} is no {file.suffix[1:].upper()}: {error}.") from None
    try:
        if not isinstance(content, dict):
            raise ArgumentError(f"keys with values are wanted: {', '.join(KEYS)}.")
        return _parse_layout(file.stem, content)
    except ArgumentError as error:
        raise ArgumentError(f"layout {path}: {error}") from None


def _parse_layout(name: str, content: Mapping[str, Any]) -> Layout:
    """Return the bus layout that the keys of a file describe."""
    for key in content:
        if key not in KEYS:
            raise unknown_name_error("key", key[:MAX_VALUE_CHARACTERS], KEYS)
    start = _parse_base_layout(name, content)
    ports = _parse_ports("ports", content["ports"], start.kind) if "ports" in content else start.ports
    if not ports:
        raise ArgumentError(f"there is no line that says what the ports of a chip reach, or that takes them from a shipped layout. "
                            f'Add for example: {EXAMPLE}, or: like = "pcl240"')  # fmt: skip
    own = _parse_ports("own", content["own"], start.kind) if "own" in content else start.own
    chips = _parse_number(content, "chips", start.chips, 0, 64)
    if own and not chips:
        raise ArgumentError(
            "own ports lie behind room for so many chips, and nothing says how many. Add for example: chips = 4"
        )
    return replace(
        start,
        name=name, title=str(content.get("title", start.title)), ports=ports, own=own, chips=chips,
        base=_parse_number(content, "base", start.base, 0, LAST_PORT),
        stride=_parse_number(content, "stride", start.stride if "ports" not in content else len(ports), 1, LAST_PORT),
    )  # fmt: skip


def _parse_base_layout(name: str, content: Mapping[str, Any]) -> Layout:
    """Return the layout on which a file builds: a built-in one, or an empty one for its class of chips."""
    kind = chip_class(str(content["chip"])[:MAX_VALUE_CHARACTERS]) if "chip" in content else None
    if "like" in content:
        start = _find_shipped_layout(str(content["like"]))
        return replace(start, kind=kind or start.kind)
    if kind is None:
        raise ArgumentError(
            f'there is no line that names the class of the chips. Add for example: chip = "PCL240K" (known: {", ".join(CHIPS)})'
        )
    return Layout(name, "a layout of a file", kind, (), 1, evidence="I")


def _parse_ports(key: str, texts: Any, chip: type[Chip]) -> tuple[tuple[int, int], ...]:
    """Return what each port of a layout's list reaches, (kind, address), from its words."""
    if not isinstance(texts, list):
        raise ArgumentError(
            f"{key} = {texts!r:.{MAX_VALUE_CHARACTERS}}: a list of what each port reaches. Write for example: {EXAMPLE}"
        )
    ports = tuple(
        _parse_port(f"{key}, entry {n + 1}, {text!r:.{MAX_VALUE_CHARACTERS}}", text, chip)
        for n, text in enumerate(texts)
    )
    for n, (kind, address) in enumerate(ports):
        before = ports[n - 1] if n else (NOTHING, 0)
        if kind == HALF and before != (WORD, address):
            raise ArgumentError(
                f'{key}, entry {n + 1}, "upper {address}": the entry before it has to be "word {address}".'
            )
        if kind == LATCHED and before[0] != LATCH:
            raise ArgumentError(f'{key}, entry {n + 1}, "data": the entry before it has to be "latch".')
    return ports


def _parse_port(where: str, text: Any, chip: type[Chip]) -> tuple[int, int]:
    """Return what one port reaches, (kind, address), from its words."""
    word, _, number = str(text).partition(" ")
    if word not in PORT_WORDS:
        near = find_similar_names(word, PORT_WORDS)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        forms = ", ".join(f'"{name} N"' if addressed else f'"{name}"' for name, (_, addressed) in PORT_WORDS.items())
        raise ArgumentError(f"{where}: a port reaches one of {forms}.{hint}")
    kind, addressed = PORT_WORDS[word]
    if kind in (WORD, HALF) and chip.DATA_MASK <= 0xFF:
        raise ArgumentError(
            f'{where}: the bus of {add_article(chip.__name__)} has 8 bits. Write "byte" and the address.'
        )
    if not addressed:
        if number:
            raise ArgumentError(f'{where}: no address follows. Write "{word}".')
        return kind, 0
    highest = chip.ADDRESS_MASK if kind == BYTE else chip.ADDRESSES - 1
    try:
        address = int(number, 0)
    except ValueError:
        address = -1
    if not 0 <= address <= highest:
        raise ArgumentError(
            f'{where}: an address of {add_article(chip.__name__)} follows, 0 to {highest}. Write for example "{word} 0".'
        )
    return kind, address


def _parse_number(content: Mapping[str, Any], key: str, default: int, low: int, high: int) -> int:
    """Return the number under a key of a layout file, which must lie within `low` to `high`."""
    value = content.get(key, default)
    try:
        number = int(value, 0) if isinstance(value, str) else value
    except ValueError:
        number = None
    if isinstance(number, bool) or not isinstance(number, int) or not low <= number <= high:
        raise ArgumentError(
            f"{key} = {value!r:.{MAX_VALUE_CHARACTERS}}: a whole number from {low} to {high}, for example {key} = "
            f"{max(low, default)}"
        )
    return number
