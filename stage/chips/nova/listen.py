"""Bus cycles of the NOVA chips in words: `X: set drive speed V = 4000`, `X: logical position counter LP = -20 pulses`."""

from __future__ import annotations

import re
from collections.abc import Callable
from types import ModuleType
from typing import Any

from stage.chips.listener import Fields, Sayings, bits, line, short
from stage.chips.nova.decode import BYTES, axis_names, resets
from stage.chips.nova.registers import words300 as words304
from stage.chips.nova.registers import words514
from stage.chips.nova.registers.common import AXES
from stage.chips.register_map import Command, Field, Register, RegisterMap, Word

_NAMES = re.compile(rf"{AXES[0]}(, [{AXES[1:]}])*")
_TABLE = re.compile(r"(.*): see ([A-Z_]+)")
_PATTERN = {"BP_ENABLED": True, "BP_DISABLED": False}
_PAGE = {"RR3P0": False, "RR3P1": True}


class Listener:
    """See `stage.chips.listener.Listener`; addresses 16 to 31 are bytes of WR0 to WR7 and RR0 to RR7, as on the 8-bit bus. What
    filled RR6 and RR7 is told if the command was heard; a chip does not hold it.

    record: the chip's state."""

    def __init__(self, map_: RegisterMap, record: Any):
        self._map, self._there = map_, (1 << map_.axes) - 1
        self._selected, self._pages = int(record["selected"]), int(record["pages"])
        self._pattern = bool(record["ip"]["writing"])
        self._first = int(record["first"])
        self._by_axis = [[int(w) for w in x["wr"]] for x in record["ax"]]
        self._common = [0, 0, 0, 0, *(int(record[name]) for name in ("outputs4", "outputs5", "low", "high"))]
        self._reading: tuple[str, Register | Word, int] | None = None  # axis, what, its bytes
        self._bytes: dict[int, int] = {}  # of RR6 and RR7, as read
        special = _special(words514 if map_.by_code.get(0xFF) else words304)
        self._topics = {n: short(map_.word(f"WR{n}").title) for n in (1, 2, 3)}
        self._fields = {p.name: Fields(p, special) for p in map_.places if p.fields}

    def write(self, address: int, value: int) -> str:
        """One write cycle to WRn, n = `address`."""
        if address >= BYTES:
            return self._write_byte(address - BYTES, value & 0xFF)
        n, value = address & 7, value & 0xFFFF
        if n == 0:
            return line(self._command(value))
        if self._pattern and 2 <= n <= 5:
            word = words304.BIT_PATTERN[n - 2]
            return f"{word.name} = {value:04X}h: {short(word.title)}"
        if n <= 3:
            for k, words in enumerate(self._by_axis):
                if self._selected >> k & 1:
                    words[n] = value
            return self._fields[f"WR{n}"].tell(f"{axis_names(self._selected)}: WR{n} ({self._topics[n]})", value)
        self._common[n] = value
        if n >= 6:
            return f"data {'31..16' if n == 7 else '15..0'} = {value:04X}h"
        fields = self._fields.get(f"WR{n}")
        return fields.tell(f"WR{n}", value) if fields else f"WR{n} is not used on the {self._map.chip}"

    def _write_byte(self, at: int, value: int) -> str:
        """A byte of WRn: what the word says as it is then."""
        n, high = at >> 1 & 7, at & 1
        old = self._first if n == 0 else self._by_axis[self._lowest][n] if n <= 3 else self._common[n]
        word = old & 0xFF | value << 8 if high else old & 0xFF00 | value
        if n == 0 and high:
            self._first = word
            return f"{bits('WR0', high, value)}: waits for bits 7..0"
        return self.write(n, word)

    def _command(self, value: int) -> str:
        """A word to WR0."""
        c, given = self._map.by_code.get(value & 0xFF), value >> 8 & 15
        axes = given & self._there
        if resets(self._map, value) or (c is not None and c.symbol == "RST" and not given):
            self._reset()
            return "reset" if c is None or c.symbol != "RST" else c.title
        self._selected = axes or self._selected
        names = axis_names(axes)
        if given != axes:
            names += f" (no {axis_names(given & ~axes)} on the {self._map.chip})"
        head = f"{names}: " if names else ""
        if c is None:
            return f"{head}{value & 0xFF:02X}h is no command of the {self._map.chip}"
        if c.kind == "data read":
            return self._answer(c)
        if c.axes and not axes:
            return f"to no axis, nothing happens: {c.title}"
        if c.symbol == "RST":
            return f"{head}nothing happens, it takes no axis bits: {c.title}"
        return self._obeyed(c, value, axes, head)

    def _obeyed(self, c: Command, value: int, axes: int, head: str) -> str:
        if c.kind in ("data write", "mode write"):
            r = self._map.register(c.symbol)
            return self._told(f"{head}set {short(r.title)} {r.name}", r, self._common[7] << 16 | self._common[6])
        if c.choice:
            sets = " ".join(f"SYNC{m}" for m in range(4) if value & c.choice & 1 << m)
            return f"{head}{c.title.split(' ', 1)[0]} {sets}"
        if c.symbol in _PATTERN:
            self._pattern = _PATTERN[c.symbol]
        elif c.symbol in _PAGE:
            self._pages = self._pages | axes if _PAGE[c.symbol] else self._pages & ~axes
        return f"{head}{c.title}"

    def _answer(self, c: Command) -> str:
        """A reading command: RR6 and RR7 hold its answer."""
        name = c.symbol.removeprefix("R-")
        place = self._map.word(name) if name.startswith("WR") else self._map.register(name)
        axis = f"{AXES[self._lowest]}: " if c.axes else ""
        self._reading, self._bytes = (axis, place, c.bytes), {}
        return f"{axis}read {short(place.title)} {name}"

    def _reset(self) -> None:
        self._selected, self._pages, self._pattern, self._reading = 1, 0, False, None
        self._by_axis, self._common = [[0] * 4 for _ in self._by_axis], [0] * 8

    def read(self, address: int, value: int) -> str:
        """One read cycle of RRn, n = `address`."""
        if address >= BYTES:
            n, high, width, value = address >> 1 & 7, address & 1, 1, value & 0xFF
        else:
            n, high, width, value = address & 7, 0, 2, value & 0xFFFF
        if n >= 6:
            return self._data(2 * (n - 6) + high, width, value)
        name = f"RR{n}"
        if n == 3 and "RR3-1" in self._fields:
            name += "-1" if self._pages >> self._lowest & 1 else "-0"
        head = f"{AXES[self._lowest]}: " if 1 <= n <= 3 else ""
        head += name.replace("-", " page ")
        if width == 1:
            head += f" bits {8 * high + 7}..{8 * high}"
        return self._fields[name].tell(head, value << 8 * high)

    def _data(self, at: int, width: int, value: int) -> str:
        """Bytes of RR6 and RR7, from byte `at`: the whole as soon as all were read."""
        for k in range(width):
            self._bytes[at + k] = value >> 8 * k & 0xFF
        part = f"{8 * (at + width) - 1}..{8 * at} = {value:0{2 * width}X}h"
        if self._reading is None:
            return f"data read, bits {part}"
        axis, place, size = self._reading
        if at >= size or any(k not in self._bytes for k in range(size)):
            return f"{axis}{place.name} bits {part}"
        return self._told(
            f"{axis}{short(place.title)} {place.name}", place, sum(self._bytes[k] << 8 * k for k in range(size))
        )

    @property
    def _lowest(self) -> int:
        """The lowest selected axis: it answers."""
        return (self._selected & -self._selected).bit_length() - 1

    def _told(self, head: str, place: Register | Word, word: int) -> str:
        """What a register or word holds, field by field or as a number."""
        word &= (1 << place.bits) - 1
        if place.fields or isinstance(place, Word):
            return self._fields[place.name].tell(f"{head} = {word:0{place.bits // 4}X}h", word)
        return line(f"{head} = {place.value(word)} {place.unit}".rstrip())


def _special(tables: ModuleType) -> Callable[[Field], Sayings | None]:
    """Sayings of fields that have a bit for every axis, or a table of their values in `tables`."""

    def sayings(f: Field) -> Sayings | None:
        if f.name.startswith("n-"):
            return {
                v: _NAMES.sub(axis_names(v), f.meaning.split(" [")[0], count=1) for v in range(1, (f.mask >> f.low) + 1)
            }
        if found := _TABLE.match(f.meaning):
            table = getattr(tables, found[2])
            items = table.items() if isinstance(table, dict) else enumerate(table)
            return {v: f"{found[1]}: {text}" for v, text in items if v}
        return None

    return sayings
