"""One bus cycle in words, given those before it: the last column of a bus trace. Each family brings its listener.

    listener = chip.listener()     knows what the chip holds now
    listener.write(0, 0x85)        'select R5: deceleration rate'
    listener.read(0, 0xE8)         'status: operating, neither ramping up nor down, R0 = 0'

A listener hears bus cycles, nothing else: after a reset pin, or a write that got lost, ask the chip for a new one. What a value
says comes from the register map: the meanings of its fields are read as they are printed there.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Protocol

from stage.chips.register_map import Field, Register, Word

LONGEST = 120
"""Characters of a sentence."""
Sayings = dict[int, str]
"""What is said of a field, by its value; of other values nothing."""
_MANY = 4096
_EVIDENCE = re.compile(r" \[[A-Z?]\]")
_CHOICE = re.compile(r"(?:^|(?<=\s))[01] (?!to )(?=\S)")
_NEXT_CHOICE = re.compile(r"[,;] (?=\d+ (?!to ))")


class Listener(Protocol):
    """What bus cycles say, as one line of ASCII of at most LONGEST characters each. Never raises."""

    def write(self, address: int, value: int) -> str:
        """What this write cycle says, given those before."""

    def read(self, address: int, value: int) -> str:
        """What this read cycle, which returned `value`, told."""


class Fields:
    """Tells what a register or word holds, field by field.

    special: the sayings of fields that the map's words do not tell; both: zeros are told, too, where the map says what they choose.
    """

    def __init__(
        self, place: Register | Word, special: Callable[[Field], Sayings | None] = lambda _: None, both: bool = False
    ):
        self._fields = [
            (f, f.low, f.mask >> f.low, special(f) or _sayings(f, both)) for f in place.fields if f.name != "group"
        ]
        self._told: dict[tuple[str, int, str], str] = {}

    def tell(self, head: str, value: int, tail: str = "") -> str:
        """`head`, the fields that say something, and `tail`; the longest fields by name where there is not room for all words."""
        told = self._told.get((head, value, tail))
        if told is None:
            if len(self._told) >= _MANY:
                self._told.clear()
            words = self._words(value, LONGEST - len(head) - len(tail) - 2)
            told = self._told[head, value, tail] = line(f"{head}: {words}{tail}")
        return told

    def _words(self, value: int, room: int) -> str:
        words, names = [], []
        for f, low, mask, sayings in self._fields:
            v = value >> low & mask
            said = sayings.get(v) or (_number(f, v) if v and f.high > f.low else "")
            if said:
                words.append(said)
                names.append(said if not v else f.name if f.high == f.low else f"{f.name} {v:X}h")
        if not words:
            return "nothing to report" if value else "all bits 0"
        length = sum(map(len, words)) + 2 * len(words) - 2
        for k in sorted(range(len(words)), key=lambda k: len(names[k]) - len(words[k])):
            if length > room:
                length += len(names[k]) - len(words[k])
                words[k] = names[k]
        return (", " if length <= room else " ").join(words)


def line(text: str) -> str:
    """`text`, cut where it is too long."""
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def short(title: str) -> str:
    """What a title begins with, before it goes into detail."""
    return re.split("[:;,]", title, maxsplit=1)[0]


def bits(name: str, byte: int, value: int) -> str:
    """One byte of a register, the lowest is byte 0."""
    return f"{name} bits {8 * byte + 7}..{8 * byte} = {value:02X}h"


def _sayings(f: Field, both: bool) -> Sayings:
    """What the map's meaning of a field says of each value; if not `both`, of zero only where the map has nothing else."""
    meaning = _EVIDENCE.sub("", f.meaning)
    if meaning.startswith("1 until"):
        return {1: f.name, 0: f"not {f.name}"}
    if found := _choices(meaning) or _list(f, meaning):
        if found.get(1, "").startswith("no "):
            return {0: found[1].removeprefix("no ")}
        return {v: text for v, text in found.items() if v or both or len(found) == 1}
    if f.high > f.low:
        return {}
    level = re.match("(active )?level of", meaning)
    return {1: _clause(meaning) + (" high" if level else "")}


def _choices(meaning: str) -> Sayings:
    """'speed: 0 low, 1 high' or '1 = high' as sayings."""
    at = _CHOICE.search(meaning)
    if not at:
        return {}
    subject, parts = meaning[: at.start()].rstrip(" ;"), _NEXT_CHOICE.split(meaning[at.start() :])
    if len(parts) == 1 and not re.match(r"\d = ", parts[0]):
        return {}
    found = {}
    for part in parts:
        number, text = part.split(" ", 1)
        found[int(number)] = f"{subject} {_clause(text.removeprefix('= '))}".strip()
    return found


def _list(f: Field, meaning: str) -> Sayings:
    """'timer: 1, 2 us, 5, 10 ms' as sayings: a number for every value, with the unit that comes next."""
    subject, colon, rest = meaning.partition(": ")
    items = rest.split(", ")
    if len(items) != 1 << f.high - f.low + 1 or not all(re.fullmatch(r"\d+( \w+)?", item) for item in items):
        return {}
    found, unit = {}, ""
    for v, item in reversed(list(enumerate(items))):
        number, _, own = item.partition(" ")
        unit = own or unit
        found[v] = f"{subject}{colon}{number} {unit}"
    return found


def _clause(text: str) -> str:
    return re.split("[:;]", text, maxsplit=1)[0].strip()


def _number(f: Field, v: int) -> str:
    return f"{short(f.meaning)} = {v}" if f.high - f.low < 4 else f"{short(f.meaning)} = {v:X}h ({v})"
