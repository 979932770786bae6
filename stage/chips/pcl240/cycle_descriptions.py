"""Descriptions of bus cycles of the PCL-240 family, for example `select R0: down counter`, and of its journals."""

from __future__ import annotations

from typing import Any

from stage.chips import cycle_descriptions
from stage.chips.cycle_descriptions import FieldDescriber, Statement, describe_byte, shorten_line
from stage.chips.pcl240.maps import COMMAND_WORD_NAMES, CONTROL, COUNTERS, OPERATE, OPERATING_MODE, OUTPUT, SELECT
from stage.chips.pcl240.state import GROUP, INT_AT_STOP, RAMP, REGISTER, START, STOP
from stage.chips.register_map import Register, RegisterMap

SPEED_FIELD = next(f for f in OPERATING_MODE.fields if f.name == "speed")
_DEFAULT_MODE_TEXTS = {CONTROL: "manual, plus", OUTPUT: "common pulses"}
"""Descriptions of mode commands in which no bit is set."""


def describe_command(map_: RegisterMap, value: int) -> str:
    """Describe a command byte (address 0) of the PCL-240 family."""
    group = value & GROUP
    if group == OPERATE:
        return _describe_operating_command(value)
    if group == SELECT:
        return (
            f"select {find_selected_register(map_, value).name}{', collective' if is_collective(map_, value) else ''}"
        )
    word = map_.word(COMMAND_WORD_NAMES[group])
    on = [f.name for f in word.fields if f.name != "group" and f.extract(value)]
    return f"{word.name} mode: {', '.join(on) or _DEFAULT_MODE_TEXTS[group]}"


def find_selected_register(map_: RegisterMap, value: int) -> Register:
    """Return the register that a select byte names. Bits that the chip does not have are ignored."""
    number = value & (_find_field_mask(map_, "select", "extension") | REGISTER)
    return next(register for register in map_.registers if register.number == number)


def is_collective(map_: RegisterMap, value: int) -> bool:
    """Return whether a select byte selects collective transfers."""
    return bool(value & _find_field_mask(map_, "select", "collective"))


def name_speed(value: int) -> str:
    """Return the name of the speed that a start command selects: FL, FH1 or FH2."""
    return SPEED_FIELD.values.get(SPEED_FIELD.extract(value), SPEED_FIELD.values[0])


def _describe_operating_command(value: int) -> str:
    """Describe a command of group 00: start, stop, or change of speed."""
    start, stop, ramp = value & START, value & STOP, value & RAMP
    irq = ", /INT at stop" if value & INT_AT_STOP else ""
    if stop and not start:
        return "reset command" + irq
    if stop:
        return ("decelerating stop" if ramp else "stop") + irq
    if start:
        return f"start, {'ramp to' if ramp else 'constant'} {name_speed(value)}{irq}"
    return "no operation" + (irq or ", clear /INT")


def _find_field_mask(map_: RegisterMap, word: str, name: str) -> int:
    """Return the mask of a field; 0 if the chip has no such field."""
    return sum(f.mask for f in map_.word(word).fields if f.name == name)


class Decoder(cycle_descriptions.Decoder):
    """Decoder of the journals of a PCL-240. A select command and the bytes of its register together are one statement."""

    def __init__(self, map_: RegisterMap):
        self._map = map_
        self._select, self._clock = SELECT, 0
        self._bytes: dict[int, int] = {}
        self._stored: dict[int, int] = {}

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        statements: list[Statement] = []
        if address:
            if address in self._bytes:
                statements = self.flush()
            self._bytes[address] = value
            self._clock = clock
            return statements
        statements = self.flush()
        if value & GROUP == SELECT:
            self._select = value
        else:
            statements.append(Statement(clock, "command", f"{value:02X}", describe_command(self._map, value)))
        return statements

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        return f"{value:02X}", f"data to address {address}" if address else describe_command(self._map, value)

    def reset(self) -> None:
        self._stored.clear()
        self._select = SELECT

    def flush(self) -> list[Statement]:
        """Return the statement of the register whose bytes have been written since its select command, if there is one."""
        if not self._bytes:
            return []
        register, known, parts = find_selected_register(self._map, self._select), self._bytes, self._bytes
        self._bytes = {}
        if is_collective(self._map, self._select):  # the upper bytes wait for the lowest, and stay for the next
            self._stored.update(parts)
            known = self._stored
            if 1 not in parts:
                return []
        value = sum(b << 8 * (a - 1) for a, b in known.items()) & register.mask
        raw = " ".join(f"{b:02X}" for _, b in sorted(parts.items(), reverse=True))
        code = f"{self._select:02X} {raw}"
        meaning = f"{register.name} <- {value} ({register.description})"
        return [Statement(self._clock, "register", code, meaning, register.name, value)]


class CycleDescriber:
    """Describer of the bus cycles of a PCL-240 chip.

    The whole value of a register is described with its lowest byte, or with its highest if the bytes come in that order.

    Args:
        map_: Register map of the chip.
        record: State of the chip.
    """

    def __init__(self, map_: RegisterMap, record: Any):
        self._map = map_
        self._stored = {register.name: int(record["reg"][k]) for k, register in enumerate(map_.registers)}
        self._register = map_.registers[int(record["selected_register"])]
        self._collective = bool(record["collective"])
        self._waiting = {3: int(record["high_byte"]), 2: int(record["middle_byte"])}
        self._latched = {a: int(record["read_latch"]) >> 8 * (a - 1) & 0xFF for a in (2, 3)}
        self._returned = map_.register("R0")
        self._last = 0  # address of the data write just before
        self._aged: dict[str, set[int]] = {name: set() for name in COUNTERS}
        self._extension, self._external = (_find_field_mask(map_, "output", name) for name in ("extension", "external"))
        self._output = int(record["output_mode"])
        self._status = FieldDescriber(map_.word("status"))
        self._fields = {register.name: FieldDescriber(register) for register in map_.registers if register.fields}

    def write(self, address: int, value: int) -> str:
        """Describe a write cycle to address 0 to 3."""
        address, value = address & 3, value & 0xFF
        if address:
            text = self._describe_data(address, value)
            self._last = address
            return text
        self._last = 0
        group = value & GROUP
        if group == OUTPUT:
            self._output = value
        starts = group == OPERATE and value & START
        if starts or self._output & self._external:  # the counters count on by themselves
            for old in self._aged.values():
                old.update((1, 2, 3))
        if self._extension and group == OPERATE and value & STOP and not starts:
            self._stored["R6"] = 0
        meaning = describe_command(self._map, value)
        if group == SELECT:
            self._register, self._collective = find_selected_register(self._map, value), is_collective(self._map, value)
            meaning += f": {self._register.title}"
        return shorten_line(meaning)

    def _describe_data(self, address: int, value: int) -> str:
        """Describe a write of a byte of the selected register."""
        register = self._register
        text = describe_byte(register.name, address - 1, value)
        if 8 * (address - 1) >= register.bits and not self._collective:
            return f"{text}: {register.name} has {register.bits} bits"
        if self._collective and address > 1:
            self._waiting[address] = value
            return f"{text}: waits for bits 7..0"
        return self._describe_register(register, text) if self._store_byte(register, address, value) else text

    def _store_byte(self, register: Register, address: int, value: int) -> bool:
        """Store a byte of a register, and return whether to describe the whole value now."""
        aged = self._aged.get(register.name, set())
        before = self._stored[register.name]
        if self._collective:
            word = self._waiting[3] << 16 | self._waiting[2] << 8 | value
            aged.clear()
        else:
            shift = 8 * (address - 1)
            word = before & ~(0xFF << shift) | value << shift
            aged.discard(address)
        self._stored[register.name] = before & ~register.writable | word & register.writable
        climbs = address == (register.bits + 7) // 8 and self._last == address - 1
        return (address == 1 or climbs) and not aged and register.writable == register.mask

    def _describe_register(self, register: Register, text: str) -> str:
        """Describe the whole value of a register, field by field if it has fields."""
        value = self._stored[register.name]
        text = f"{text}: {register.name} = {value:X}h ({register.value(value)})"
        return self._fields[register.name].describe(text, value) if register.fields else text

    def read(self, address: int, value: int) -> str:
        """Describe a read cycle of address 0 to 3."""
        address, value = address & 3, value & 0xFF
        if not address:
            return self._status.describe("status", value)
        register = self._register if self._output & self._extension else self._returned
        text = describe_byte(register.name, address - 1, value)
        if not self._collective:
            return text
        if address > 1:
            if address == 3:
                self._latched.clear()
            self._latched[address] = value
            return f"{text}, latched" if address == 3 else text
        if len(self._latched) < 2:
            return text
        word = self._latched[3] << 16 | self._latched[2] << 8 | value
        return f"{text}: {register.name} = {word:X}h ({register.value(word)}), as latched"
