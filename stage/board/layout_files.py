"""A layout as data in a file, TOML or JSON: how the chips of a card lie on a host's bus, without a line of Python.

    # card.toml: two chips whose registers lie in turn, and a port of the card itself
    chip = "PCL240K"
    base = 0x240
    stride = 1
    ports = ["byte 0", "none", "byte 1", "none", "byte 2", "none", "byte 3", "none"]
    chips = 8
    own = ["interrupts"]

Keys: chip, the class; like, a shipped layout that the rest is taken from; the others are those of `Layout`. Numbers may
be text as well ("0x240"), for JSON. Of what a port reaches, see `WORDS`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from stage.board.bus.host_record import BYTE, HALF, LAST_PORT, LATCH, LATCHED, NOTHING, PULLS, WORD
from stage.board.layouts import LAYOUTS, Layout
from stage.chips import CHIPS, Chip, chip_class
from stage.errors import ArgumentError, a_or_an, near_names, unknown
from stage.support.foreign_files import DocumentError, parse_json, parse_toml, read_text

WORDS = {
    "byte": (BYTE, True), "word": (WORD, True), "upper": (HALF, True), "latch": (LATCH, False), "data": (LATCHED, False),
    "interrupts": (PULLS, False), "none": (NOTHING, False),
}  # fmt: skip
"""What a port reaches, as it is written -> (kind, whether an address of the chip follows): 8 bits; 16 bits; their upper byte, at
the port behind the word; the address latch; the data, at the port behind it; the chips that pull the interrupt line; nothing."""
KEYS = ("chip", "like", "title", "base", "stride", "ports", "own", "chips")
ENDINGS = (".toml", ".json")
SHOWN = 60
"""Characters of a value that an error shows."""
EXAMPLE = 'ports = ["byte 0", "byte 1", "byte 2", "byte 3"]'


def is_file(layout: Any) -> bool:
    """Whether this names a file, and no layout by its name."""
    return isinstance(layout, os.PathLike) or (isinstance(layout, str) and bool(Path(layout).suffix))


def chosen(layout: str | os.PathLike | Layout | None) -> str | Layout | None:
    """The layout itself where a file is named. Raises as `read`."""
    return read(layout) if is_file(layout) else layout  # type: ignore[arg-type,return-value]


def read(path: str | os.PathLike) -> Layout:
    """The layout in a file. Raises FileError for one that cannot be read, ArgumentError for one that is no layout: what is wrong,
    and the line to write."""
    file = Path(path)
    if file.suffix not in ENDINGS:
        raise ArgumentError(f"layout {path}: a layout is a file that ends in {' or '.join(ENDINGS)}.")
    text = read_text(path, "layout")
    try:
        given = parse_toml(text) if file.suffix == ".toml" else parse_json(text)
    except DocumentError as error:
        raise ArgumentError(f"layout {path} is no {file.suffix[1:].upper()}: {error}.") from None
    try:
        if not isinstance(given, dict):
            raise ArgumentError(f"keys with values are wanted: {', '.join(KEYS)}.")
        return _layout(file.stem, given)
    except ArgumentError as error:
        raise ArgumentError(f"layout {path}: {error}") from None


def _layout(name: str, given: Mapping[str, Any]) -> Layout:
    for key in given:
        if key not in KEYS:
            raise unknown("key", key[:SHOWN], KEYS)
    start = _start(name, given)
    ports = _ports("ports", given["ports"], start.kind) if "ports" in given else start.ports
    if not ports:
        raise ArgumentError(f"there is no line that says what the ports of a chip reach, or that takes them from a shipped layout. "
                            f'Add for example: {EXAMPLE}, or: like = "pcl240"')  # fmt: skip
    own = _ports("own", given["own"], start.kind) if "own" in given else start.own
    chips = _whole(given, "chips", start.chips, 0, 64)
    if own and not chips:
        raise ArgumentError(
            "own ports lie behind room for so many chips, and nothing says how many. Add for example: chips = 4"
        )
    return replace(
        start,
        name=name, title=str(given.get("title", start.title)), ports=ports, own=own, chips=chips,
        base=_whole(given, "base", start.base, 0, LAST_PORT),
        stride=_whole(given, "stride", start.stride if "ports" not in given else len(ports), 1, LAST_PORT),
    )  # fmt: skip


def _start(name: str, given: Mapping[str, Any]) -> Layout:
    """What the file begins with: a shipped layout, or nothing but the class of the chip."""
    if "like" in given:
        like = str(given["like"])
        if like not in LAYOUTS:
            raise unknown("layout", like[:SHOWN], LAYOUTS)
        start = LAYOUTS[like]
        return replace(start, kind=chip_class(str(given["chip"])[:SHOWN])) if "chip" in given else start
    if "chip" not in given:
        near = f" (known: {', '.join(CHIPS)})"
        raise ArgumentError(
            f'there is no line that names the class of the chips. Add for example: chip = "PCL240K"{near}'
        )
    return Layout(name, "a layout of a file", chip_class(str(given["chip"])[:SHOWN]), (), 1, evidence="I")


def _ports(key: str, given: Any, chip: type[Chip]) -> tuple[tuple[int, int], ...]:
    if not isinstance(given, list):
        raise ArgumentError(
            f"{key} = {given!r:.{SHOWN}}: a list of what each port reaches. Write for example: {EXAMPLE}"
        )
    ports = tuple(_port(f"{key}, entry {n + 1}, {text!r:.{SHOWN}}", text, chip) for n, text in enumerate(given))
    for n, (kind, address) in enumerate(ports):
        before = ports[n - 1] if n else (NOTHING, 0)
        if kind == HALF and before != (WORD, address):
            raise ArgumentError(
                f'{key}, entry {n + 1}, "upper {address}": the entry before it has to be "word {address}".'
            )
        if kind == LATCHED and before[0] != LATCH:
            raise ArgumentError(f'{key}, entry {n + 1}, "data": the entry before it has to be "latch".')
    return ports


def _port(where: str, text: Any, chip: type[Chip]) -> tuple[int, int]:
    word, _, number = str(text).partition(" ")
    if word not in WORDS:
        near = near_names(word, WORDS)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ArgumentError(f"{where}: a port reaches one of {_forms()}.{hint}")
    kind, addressed = WORDS[word]
    if kind in (WORD, HALF) and chip.DATA_MASK <= 0xFF:
        raise ArgumentError(f'{where}: the bus of {a_or_an(chip.__name__)} has 8 bits. Write "byte" and the address.')
    if not addressed:
        if number:
            raise ArgumentError(f'{where}: no address follows. Write "{word}".')
        return kind, 0
    most = chip.ADDRESS_MASK if kind == BYTE else chip.ADDRESSES - 1
    try:
        address = int(number, 0)
    except ValueError:
        address = -1
    if not 0 <= address <= most:
        raise ArgumentError(
            f'{where}: an address of {a_or_an(chip.__name__)} follows, 0 to {most}. Write for example "{word} 0".'
        )
    return kind, address


def _forms() -> str:
    return ", ".join(f'"{word} N"' if addressed else f'"{word}"' for word, (_, addressed) in WORDS.items())


def _whole(given: Mapping[str, Any], key: str, default: int, least: int, most: int) -> int:
    value = given.get(key, default)
    try:
        number = int(value, 0) if isinstance(value, str) else value
    except ValueError:
        number = None
    if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
        raise ArgumentError(
            f"{key} = {value!r:.{SHOWN}}: a whole number from {least} to {most}, for example {key} = {max(least, default)}"
        )
    return number
