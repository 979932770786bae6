"""Descriptions of bus cycles of the NOVA chips, `X: set drive speed V = 4000`, and of their journals, `X Y DV <- 8000`."""

from __future__ import annotations

from typing import Any

from stage.chips import cycle_descriptions
from stage.chips.cycle_descriptions import FieldDescriber, Statement, describe_byte, shorten_line
from stage.chips.nova.registers.field_builders import AXIS_LETTERS, name_axes
from stage.chips.nova.registers.mcx300 import RESET
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.register_map import ChipCommand, Register, RegisterMap, Word

FIRST_BYTE_ADDRESS = 16  # byte addresses of the 8-bit bus begin here
_LOADS_PATTERN_BY_COMMAND = {"BP_ENABLED": True, "BP_DISABLED": False}
_SHOWS_PAGE_1_BY_COMMAND = {"RR3P0": False, "RR3P1": True}
CODE, AXIS = MCX514_MAP.field("WR0", "CODE"), MCX514_MAP.field("WR0", "AXIS")
WRITING_KINDS = ("data write", "mode write")


def is_reset_word(map_: RegisterMap, value: int) -> bool:
    """Return whether a word written to WR0 resets the chip by its reset bit, on chips without a reset command."""
    return value == RESET and not any(command.symbol == "RST" for command in map_.commands)


class Decoder(cycle_descriptions.Decoder):
    """Decoder of the journals of a NOVA chip, to the commands for one axis with their data."""

    def __init__(self, map_: RegisterMap, axis: int = 0):
        self._map, self._bit = map_, 1 << axis
        self.reset()

    def reset(self) -> None:
        self._selected, self._words = 1, [0] * 8

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        return f"{value:04X}", f"data to WR{address & 7}"

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        n = address
        if address >= FIRST_BYTE_ADDRESS:
            n, high = (address - FIRST_BYTE_ADDRESS) >> 1, address & 1
            old = self._words[n]
            value = old & 0xFF | value << 8 if high else old & 0xFF00 | value
            if n == 0 and high:
                self._words[0] = value
                return []
        self._words[n] = value
        if n == 0:
            return self._decode_command(clock, value)
        if n >= 6 or (n <= 3 and not self._selected & self._bit):
            return []
        return [Statement(clock, "register", f"{value:04X}", f"WR{n} <- {value:04X}h", f"WR{n}", value)]

    def _decode_command(self, clock: int, value: int) -> list[Statement]:
        """Decode a word to WR0: a command to the axis of the decoder, or nothing."""
        axes, command = AXIS.extract(value), self._map.by_code.get(CODE.extract(value))
        self._selected = axes or self._selected
        if axes and not axes & self._bit:
            return []
        words = f"{name_axes(axes)} {self._describe_meaning(command, value)}".strip()
        if command is None or command.kind not in WRITING_KINDS:
            return [Statement(clock, "command", f"{value:04X}", words)]
        register = self._map.register(command.symbol)
        return [Statement(clock, "register", f"{value:04X}", words, register.name, self._read_data_value(register))]

    def _read_data_value(self, register: Register) -> int:
        """Return the value that a command writes into a register."""
        return register.value(self._words[7] << 16 | self._words[6])

    def _describe_meaning(self, command: ChipCommand | None, value: int) -> str:
        """Describe the meaning of a command word."""
        if is_reset_word(self._map, value):
            return "reset"
        if command is None:
            return "no command"
        if command.kind in WRITING_KINDS:
            register = self._map.register(command.symbol)
            return f"{register.name} <- {self._read_data_value(register)} ({register.description})"
        return _describe_command(command, value)


class CycleDescriber:
    """Describer of the bus cycles of a NOVA chip.

    Addresses 16 to 31 are the bytes of WR0 to WR7 and RR0 to RR7 on the 8-bit bus. The contents of RR6 and RR7 are described if the
    describer has seen the command that filled them.

    Args:
        map_: Register map of the chip.
        record: State of the chip.
    """

    def __init__(self, map_: RegisterMap, record: Any):
        self._map, self._there = map_, (1 << map_.axes) - 1
        self._selected, self._pages = int(record["selected"]), int(record["status_pages"])
        self._pattern = bool(record["ip"]["loads_pattern"])
        self._first = int(record["command_high_byte"])
        self._by_axis = [[int(w) for w in x["wr"]] for x in record["ax"]]
        self._common = [0, 0, 0, 0, *(int(record[name]) for name in ("outputs4", "outputs5", "data_low", "data_high"))]
        self._reading: tuple[str, Register | Word, int] | None = None  # axis, what, its bytes
        self._bytes: dict[int, int] = {}  # of RR6 and RR7, as read
        self._sets = [w for w in map_.words if w.name.startswith("BP")]
        self._titles = {n: map_.word(f"WR{n}").title for n in (1, 2, 3)}
        self._fields = {p.name: FieldDescriber(p) for p in map_.places if p.fields}

    def write(self, address: int, value: int) -> str:
        """Describe a write cycle to WRn.

        Args:
            address: n, or 16 and above for bytes.
            value: The word or byte.
        """
        if address >= FIRST_BYTE_ADDRESS:
            return self._describe_byte_write(address - FIRST_BYTE_ADDRESS, value & 0xFF)
        n, value = address & 7, value & 0xFFFF
        if n == 0:
            return shorten_line(self._describe_command_word(value))
        if self._pattern and 2 <= n < 2 + len(self._sets):
            word = self._sets[n - 2]
            return f"{word.name} = {value:04X}h: {word.title}"
        if n <= 3:
            for k, words in enumerate(self._by_axis):
                if self._selected >> k & 1:
                    words[n] = value
            return self._fields[f"WR{n}"].describe(f"{name_axes(self._selected)}: WR{n} ({self._titles[n]})", value)
        self._common[n] = value
        if n >= 6:
            return f"data {'31..16' if n == 7 else '15..0'} = {value:04X}h"
        fields = self._fields.get(f"WR{n}")
        return fields.describe(f"WR{n}", value) if fields else f"WR{n} is not used on the {self._map.chip}"

    def _describe_byte_write(self, byte_index: int, value: int) -> str:
        """Describe a write of a byte by the word that the register then contains."""
        n, high = byte_index >> 1 & 7, byte_index & 1
        old = self._first if n == 0 else self._by_axis[self._lowest_axis][n] if n <= 3 else self._common[n]
        word = old & 0xFF | value << 8 if high else old & 0xFF00 | value
        if n == 0 and high:
            self._first = word
            return f"{describe_byte('WR0', high, value)}: waits for bits 7..0"
        return self.write(n, word)

    def _describe_command_word(self, value: int) -> str:
        """Describe a word to WR0."""
        command, axis_bits = self._map.by_code.get(CODE.extract(value)), AXIS.extract(value)
        axes = axis_bits & self._there if self._map.axes > 1 else 1
        if is_reset_word(self._map, value) or (command is not None and command.symbol == "RST" and not axis_bits):
            self._reset()
            return "reset" if command is None or command.symbol != "RST" else command.title
        self._selected = axes or self._selected
        names = name_axes(axes)
        if axis_bits & ~axes:
            names += f" (no {name_axes(axis_bits & ~axes)} on the {self._map.chip})"
        head = f"{names}: " if names else ""
        if command is None:
            return f"{head}{CODE.extract(value):02X}h is no command of the {self._map.chip}"
        if command.kind == "data read":
            return self._describe_read_command(command)
        if command.axes and not axes:
            return f"to no axis, nothing happens: {command.title}"
        if command.symbol == "RST":
            return f"{head}nothing happens, it takes no axis bits: {command.title}"
        return self._describe_executed_command(command, value, axes, head)

    def _describe_executed_command(self, command: ChipCommand, value: int, axes: int, head: str) -> str:
        """Describe a command that the chip executes, with its data and its axes."""
        if command.kind in WRITING_KINDS:
            register = self._map.register(command.symbol)
            return self._describe_contents(
                f"{head}set {register.title} {register.name}", register, self._common[7] << 16 | self._common[6]
            )
        if command.symbol in _LOADS_PATTERN_BY_COMMAND:
            self._pattern = _LOADS_PATTERN_BY_COMMAND[command.symbol]
        elif command.symbol in _SHOWS_PAGE_1_BY_COMMAND:
            self._pages = self._pages | axes if _SHOWS_PAGE_1_BY_COMMAND[command.symbol] else self._pages & ~axes
        return head + _describe_command(command, value)

    def _describe_read_command(self, command: ChipCommand) -> str:
        """Note the register that a reading command has copied to RR6 and RR7, and describe the command."""
        name = command.symbol.removeprefix("R-")
        place = self._map.word(name) if name.startswith("WR") else self._map.register(name)
        axis = f"{AXIS_LETTERS[self._lowest_axis]}: " if command.axes else ""
        self._reading, self._bytes = (axis, place, command.bytes), {}
        return f"{axis}read {place.title} {name}"

    def _reset(self) -> None:
        """Reset the selected axes, pages and data registers, as a reset of the chip does."""
        self._selected, self._pages, self._pattern, self._reading = 1, 0, False, None
        self._by_axis, self._common = [[0] * 4 for _ in self._by_axis], [0] * 8

    def read(self, address: int, value: int) -> str:
        """Describe a read cycle of RRn.

        Args:
            address: n, or 16 and above for bytes.
            value: The word or byte.
        """
        if address >= FIRST_BYTE_ADDRESS:
            n, high, width, value = address >> 1 & 7, address & 1, 1, value & 0xFF
        else:
            n, high, width, value = address & 7, 0, 2, value & 0xFFFF
        if n >= 6:
            return self._describe_data_read(2 * (n - 6) + high, width, value)
        name = f"RR{n}"
        if n == 3 and "RR3-1" in self._fields:
            name += "-1" if self._pages >> self._lowest_axis & 1 else "-0"
        head = f"{AXIS_LETTERS[self._lowest_axis]}: " if 1 <= n <= 3 else ""
        head += name.replace("-", " page ")
        if width == 1:
            head += f" bits {8 * high + 7}..{8 * high}"
        fields = self._fields.get(name)
        return fields.describe(head, value << 8 * high) if fields else f"{head} is not used on the {self._map.chip}"

    def _describe_data_read(self, first_byte: int, byte_count: int, value: int) -> str:
        """Describe a read of RR6 or RR7. The description includes the whole value as soon as all of its bytes have been read.

        Args:
            first_byte: Number of the first byte.
            byte_count: Number of bytes.
            value: The bytes.
        """
        for k in range(byte_count):
            self._bytes[first_byte + k] = value >> 8 * k & 0xFF
        part = f"{8 * (first_byte + byte_count) - 1}..{8 * first_byte} = {value:0{2 * byte_count}X}h"
        if self._reading is None:
            return f"data read, bits {part}"
        axis, place, size = self._reading
        if first_byte >= size or any(k not in self._bytes for k in range(size)):
            return f"{axis}{place.name} bits {part}"
        return self._describe_contents(
            f"{axis}{place.title} {place.name}", place, sum(self._bytes[k] << 8 * k for k in range(size))
        )

    @property
    def _lowest_axis(self) -> int:
        """Lowest selected axis, from which a host reads."""
        return (self._selected & -self._selected).bit_length() - 1

    def _describe_contents(self, head: str, place: Register | Word, word: int) -> str:
        """Describe the contents of a register or word, field by field or as a number.

        Args:
            head: Words before the contents.
            place: The register or word.
            word: Its contents.
        """
        word &= (1 << place.bits) - 1
        if place.fields or isinstance(place, Word):
            return self._fields[place.name].describe(f"{head} = {word:0{place.bits // 4}X}h", word)
        return shorten_line(f"{head} = {place.value(word)} {place.unit}".rstrip())


def _describe_command(command: ChipCommand, value: int) -> str:
    """Describe the effect of a command and the objects on which it acts."""
    names = [name for k, name in enumerate(command.chooses) if value & command.choice & 1 << k]
    return " ".join([command.title, *names])
