"""Register maps as data: dumps, diagnostics, documentation and tests read the same tables.

A map has the meaning of every bit and the evidence for it: S data sheet, H vendor header, D another page of the
manual, C working drivers agree, M memory of the manual, I inferred, ? in doubt. A core takes its masks, bit numbers and
command codes from a map when the core is imported: `MAP.mask("WR3", "SACC")`, `MAP.command("DV").code`. The meanings of a
field's values are data, too (`Field.values`): dumps, traces, diagnostics and selection lists show them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

from stage.support import html

EVIDENCE = {
    "S": "data sheet",
    "H": "vendor header",
    "D": "other page of the manual",
    "C": "working drivers",
    "M": "memory of the manual",
    "I": "inferred",
    "?": "in doubt",
}
T = TypeVar("T")
COMMAND_KINDS = ("data write", "mode write", "data read", "drive", "interpolation", "sync", "other")


@dataclass(frozen=True)
class Field:
    """A field of a register, command or status word: bits `high` to `low`.

    Attributes:
        name: Name in the data sheet, or a name of our own if the data sheet has none.
        high: Highest bit.
        low: Lowest bit.
        meaning: Subject of the bits; for a field without `values` its meaning if it is not 0. Empty if the values are enough.
        evidence: Letter of EVIDENCE.
        access: "R", "W" or "RW".
        legal: Smallest and largest value with a meaning, for a field of which not every value has one.
        values: Value -> meaning, for a field that selects one of several options. A value that the sources do not explain is
            left out.
        note: Further text for a dump.
        silent: Value without information, which a trace leaves out; None: a trace shows each.
        pins: Pin that a status bit shows, with `/` before it if the bit is 0 while the pin is asserted; two pins if the direction
            decides, that of plus first.
        between: Text between meaning and value in a sentence.
        listed: Whether a dump lists the values.
        only: The one axis on which the field of a register that each axis has acts; None: all axes.
    """

    name: str
    high: int
    low: int
    meaning: str
    evidence: str = "S"
    access: str = "RW"
    legal: tuple[int, int] | None = None
    values: Mapping[int, str] = field(default_factory=dict, hash=False)
    note: str = ""
    silent: int | None = 0
    pins: tuple[str, ...] = ()
    between: str = ": "
    listed: bool = True
    only: int | None = None

    @property
    def mask(self) -> int:
        """Mask of the field's bits in its word."""
        return ((1 << (self.high - self.low + 1)) - 1) << self.low

    @property
    def bits(self) -> str:
        """Numbers of the field's bits, as text."""
        return f"{self.high}" if self.high == self.low else f"{self.high}..{self.low}"

    def extract(self, word: int) -> int:
        """Extract the field's value from a word.

        Args:
            word: Contents of the register or word.
        """
        return (word & self.mask) >> self.low

    def find_code(self, meaning: str) -> int:
        """Return the code that selects a meaning: the field's bits in its word.

        Args:
            meaning: Meaning of the value in `values`.

        Raises:
            ArgumentError: No value has this meaning; the message has near misses.
        """
        return (
            _find_in_table({text: v for v, text in self.values.items()}, meaning, f"value of {self.name}") << self.low
        )

    def describe_value(self, value: int) -> str:
        """Return the meaning of a value in words.

        Args:
            value: Value of the field.

        Returns:
            The meaning in words; "" if the map has none for this value.
        """
        if self.values:
            text = self.values.get(value, "")
            return f"{self.meaning}{self.between}{text}" if text and self.meaning else text
        return self.meaning if value and self.high == self.low else ""

    @property
    def description(self) -> str:
        """Description of the field in a dump: its meaning, its values, its note."""
        listed = [f"{v} {text}" for v, text in self.values.items()] if self.listed else []
        values = ("; " if any("," in text for text in listed) else ", ").join(listed)
        text = ": ".join(part for part in (self.meaning, values) if part)
        return "; ".join(part for part in (text, self.note) if part)


@dataclass(frozen=True)
class Register:
    """Register of a chip.

    Attributes:
        name: Name of the data sheet.
        number: Number by which the chip selects the register.
        bits: Width in bits.
        access: "R", "W" or "RW".
        title: Name in words.
        legal: Smallest and largest value that the data sheet allows.
        fields: Fields of the register; empty for a plain number.
        evidence: Letter of EVIDENCE.
        unit: Unit of the value.
        signed: Whether the value is in two's complement.
        also: Legal values outside the range.
        reset: Value after reset, if known.
        note: Further text.
        tuned: Range from which a search for good values chooses, if it is not `legal`.
        section: Section of the data sheet that describes it, for diagnostics.
    """

    name: str
    number: int
    bits: int
    access: str
    title: str
    legal: tuple[int, int] | None = None
    fields: tuple[Field, ...] = ()
    evidence: str = "S"
    unit: str = ""
    signed: bool = False
    also: tuple[int, ...] = ()
    reset: int | None = None
    note: str = ""
    tuned: tuple[int, int] | None = None
    section: str = ""

    @property
    def description(self) -> str:
        """Title and note."""
        return _join_note(self.title, self.note)

    @property
    def mask(self) -> int:
        """Mask of all bits of the register."""
        return (1 << self.bits) - 1

    @property
    def range(self) -> tuple[int, int]:
        """Smallest and largest legal value; the range of the bits if the data sheet has none."""
        half = (self.mask + 1) // 2
        return self.legal or ((-half, half - 1) if self.signed else (0, self.mask))

    def value(self, word: int) -> int:
        """Return the number that the bits of a word represent.

        Args:
            word: Contents of the register.
        """
        word &= self.mask
        return word - self.mask - 1 if self.signed and word > self.mask // 2 else word

    def allows(self, value: int) -> bool:
        """Return whether the data sheet allows a value.

        Args:
            value: Number, as `value` returns it.
        """
        return self.range[0] <= value <= self.range[1] or value in self.also

    @cached_property
    def writable(self) -> int:
        """Mask of the bits that a write to this register changes."""
        return self.mask & ~sum(f.mask for f in self.fields if f.access == "R")

    @cached_property
    def used(self) -> int:
        """Mask of the bits of this register that have a meaning."""
        return sum(f.mask for f in self.fields) or self.mask


@dataclass(frozen=True)
class Word:
    """A command or status word.

    Attributes:
        name: Name of the data sheet.
        title: Name in words.
        fields: Its fields.
        bits: Width.
        note: Further text.
        address: Bus address at which the word is written or read; None if the map does not state it.
        sends: Values that a host usually writes -> their effect. Bits that distinguish the word from others at its address may be
            left out.
        section: Section of the data sheet that describes it, for diagnostics.
    """

    name: str
    title: str
    fields: tuple[Field, ...]
    bits: int = 8
    note: str = ""
    address: int | None = None
    sends: Mapping[int, str] = field(default_factory=dict, hash=False)
    section: str = ""

    @property
    def description(self) -> str:
        """Title and note."""
        return ", ".join(part for part in (self.title, self.note) if part)

    @cached_property
    def used(self) -> int:
        """Mask of the bits of this word that have a meaning."""
        return sum(f.mask for f in self.fields)

    @property
    def is_written(self) -> bool:
        """Whether a host writes the word, and the map has its address."""
        return self.address is not None and any("W" in f.access for f in self.fields)

    @cached_property
    def fixed(self) -> int:
        """Values, in place, of the fields with one legal value: they distinguish the words that share an address."""
        return sum(f.legal[0] << f.low for f in self.fields if f.legal and f.legal[0] == f.legal[1])


@dataclass(frozen=True)
class ChipCommand:
    """Command of a chip.

    Attributes:
        code: Command code.
        symbol: Name in the data sheet.
        title: Name in words.
        kind: One of COMMAND_KINDS.
        bytes: Number of bytes of data that the command takes or returns.
        legal: Smallest and largest value of the data.
        evidence: Letter of EVIDENCE.
        unit: Unit of the data.
        choice: Bits of the code that select the objects on which the command acts; at least one of them is set.
        axes: Whether the command is sent to axes.
        starts: Whether the command begins a drive.
        note: Further text.
        chooses: Names of the `choice` bits, the lowest first.
        together: Numbers of axes that can take part in a command that moves several axes.
        points: Whether the command moves the axes to finish points.
        lacking: Effects that the emulator lacks, in the words of a diagnostic.
    """

    code: int
    symbol: str
    title: str
    kind: str
    bytes: int = 0
    legal: tuple[int, int] | None = None
    evidence: str = "S"
    unit: str = ""
    choice: int = 0
    axes: bool = True
    starts: bool = False
    note: str = ""
    chooses: tuple[str, ...] = ()
    together: tuple[int, ...] = ()
    points: bool = False
    lacking: str = ""

    @property
    def codes(self) -> tuple[int, ...]:
        """All codes of this command."""
        return tuple(self.code | k for k in range(1, self.choice + 1) if not k & ~self.choice) or (self.code,)

    @property
    def description(self) -> str:
        """Description of the command: title, note and unit."""
        choices = f" {self.chooses[0]} to {self.chooses[-1]}" if self.chooses else ""
        return _join_note(self.title + choices, self.note) + (f" ({self.unit})" if self.unit else "")

    @property
    def hex(self) -> str:
        """Command code in hexadecimal, as data sheets print it."""
        return f"{self.code:02X}h" if not self.choice else f"{self.codes[0]:02X}h..{self.codes[-1]:02X}h"


def make_write_command(register: Register, kind: str = "data write", axes: bool = True) -> ChipCommand:
    """Make the command that writes a register. The number of the register is the command's code.

    Args:
        register: The register.
        kind: "data write" or "mode write".
        axes: Whether the command is sent to axes.
    """
    return ChipCommand(
        register.number,
        register.name,
        register.title,
        kind,
        register.bits // 8,
        register.legal,
        register.evidence,
        register.unit,
        axes=axes,
        note=register.note,
    )


def make_read_command(
    register: Register, code: int | None = None, evidence: str = "", axes: bool = True
) -> ChipCommand:
    """Make the command that reads a register.

    Args:
        register: The register.
        code: Code of the command, whose symbol is then R- and the register's name; None: the register's number, as it can
            only be read.
        evidence: Letter of EVIDENCE; "": that of the register.
        axes: Whether the command is sent to axes.
    """
    command = replace(make_write_command(register, "data read", axes), legal=None)
    if code is None:
        return command
    symbol, title, letter = f"R-{register.name}", f"read {register.name}", evidence or register.evidence
    return replace(command, code=code, symbol=symbol, title=title, evidence=letter, note="")


@dataclass(frozen=True, repr=False)
class RegisterMap:
    """Everything that a host can address on one chip, and the number of its axes. `print(dump(map_))` prints it."""

    chip: str
    title: str
    source: str
    registers: tuple[Register, ...]
    words: tuple[Word, ...]
    commands: tuple[ChipCommand, ...] = ()
    axes: int = 1

    def __repr__(self) -> str:
        return f"<RegisterMap {self.chip}: {len(self.registers)} registers, {len(self.words)} words, {len(self.commands)} commands>"

    def _repr_html_(self) -> str:
        return as_html(self)

    @property
    def places(self) -> tuple[Register | Word, ...]:
        """All registers and words."""
        return (*self.registers, *self.words)

    def register(self, name: str) -> Register:
        """Return the register with a name, in any case.

        Raises:
            ArgumentError: The map has no such register; the message proposes similar names.
        """
        return _find_in_table(self._registers, _to_upper(name), f"{self.chip} register")

    def word(self, name: str) -> Word:
        """Return the word with a name.

        Raises:
            ArgumentError: The map has no such word; the message proposes similar names.
        """
        return _find_in_table(self._words, name, f"{self.chip} word")

    def command(self, symbol: str) -> ChipCommand:
        """Return the command with a symbol, in any case.

        Raises:
            ArgumentError: The map has no such command; the message proposes similar symbols.
        """
        return _find_in_table(self._commands, _to_upper(symbol), f"{self.chip} command")

    def command_codes(self, *symbols: str) -> tuple[int, ...]:
        """Return the codes of several commands by their symbols."""
        return tuple(self.command(symbol).code for symbol in symbols)

    @cached_property
    def by_code(self) -> dict[int, ChipCommand]:
        """Commands of the chip by their command code."""
        return {code: c for c in self.commands for code in c.codes}

    def find_command_or_word(self, symbol: str, datum: int | None = None) -> tuple[ChipCommand | Word, int]:
        """Find the command or word with a name, and check the datum that a host sends with it; see `Chip.command_cycles`.

        Args:
            symbol: Symbol of a command, or name of a word that a host writes, in any case.
            datum: Its data; None if it takes none.

        Returns:
            The command or word, and the datum as bits.

        Raises:
            ArgumentError: There is no such name, or the datum is missing, not expected, or does not fit.
        """
        from stage.errors import ArgumentError

        words = {w.name.upper(): w for w in self.words if w.is_written}
        known: dict[str, ChipCommand | Word] = {**words, **{name.upper(): c for name, c in self._commands.items()}}
        what = _find_in_table(known, _to_upper(symbol), f"{self.chip} command")
        if isinstance(what, Word):
            takes, mask = f"{what.bits} bits: {what.title}", (1 << what.bits) - 1
        elif what.choice:
            takes, mask = f"bits that choose among {', '.join(what.chooses)}", what.choice
        else:
            takes, mask = f"{8 * what.bytes} bits of data: {what.title}", (1 << 8 * what.bytes) - 1
            if not what.bytes or "read" in what.kind:
                if datum is not None:
                    raise ArgumentError(f"{self.chip} {symbol}: this command takes no data, and {datum!r} was given.")
                return what, 0
        is_whole = isinstance(datum, int) and not isinstance(datum, bool)
        if not is_whole or not -(mask + 1) // 2 <= int(datum or 0) <= mask:
            datum_text = "none was given" if datum is None else f"{datum!r} was given"
            raise ArgumentError(f"{self.chip} {symbol} takes {takes}; {datum_text}.")
        if isinstance(what, ChipCommand) and what.choice and not int(datum or 0) & mask == datum != 0:
            raise ArgumentError(f"{self.chip} {symbol} takes {takes}, one of them at least; {datum!r} was given.")
        return what, int(datum or 0) & mask

    def field(self, register_or_word: str, name: str) -> Field:
        """Return a field of a register or word.

        Args:
            register_or_word: Name of the register or word.
            name: Name of the field.

        Raises:
            ArgumentError: There is no such field; the message proposes similar names.
        """
        fields = _find_in_table(self._fields, register_or_word, f"{self.chip} register or word")
        return _find_in_table(fields, name, f"field of {self.chip} {register_or_word}")

    def mask(self, register_or_word: str, name: str) -> int:
        """Return the bits of a field, in place.

        Args:
            register_or_word: Name of the register or word.
            name: Name of the field.
        """
        return self.field(register_or_word, name).mask

    def bit(self, register_or_word: str, name: str) -> int:
        """Return the number of a field's lowest bit.

        Args:
            register_or_word: Name of the register or word.
            name: Name of the field.
        """
        return self.field(register_or_word, name).low

    def masks(self, register_or_word: str, *names: str) -> tuple[int, ...]:
        """Return the bits of several fields of one register or word, each in place.

        Args:
            register_or_word: Name of the register or word.
            *names: Names of the fields.
        """
        return tuple(self.mask(register_or_word, name) for name in names)

    @cached_property
    def _registers(self) -> dict[str, Register]:
        return {r.name: r for r in self.registers}

    @cached_property
    def _words(self) -> dict[str, Word]:
        return {w.name: w for w in self.words}

    @cached_property
    def _commands(self) -> dict[str, ChipCommand]:
        return {c.symbol: c for c in self.commands}

    @cached_property
    def _fields(self) -> dict[str, dict[str, Field]]:
        return {place.name: {f.name: f for f in place.fields} for place in self.places}

    def check_value(self, name: str, value: int) -> int:
        """Check that the data sheet allows a value of a register, and return it.

        Args:
            name: Name of the register.
            value: The value.

        Raises:
            ArgumentError: The data sheet does not allow it.
        """
        from stage.errors import ArgumentError

        r = self.register(name)
        try:
            is_whole = int(value) == value
        except (TypeError, ValueError, OverflowError):
            is_whole = False
        if not is_whole or not r.allows(int(value)):
            low, high = r.range
            other = "".join(f" or {v}" for v in r.also)
            raise ArgumentError(
                f"{self.chip} {r.name} ({r.title}) cannot be {value!r}: it takes a whole number from {low} to {high}"
                f"{other}{' ' + r.unit if r.unit else ''}. To see what the silicon does with it, write it on the bus."
            )
        return int(value)


def _to_upper(name: str) -> str:
    """Convert a name to capitals, as in the tables. Raises ArgumentError if it is not a string."""
    if isinstance(name, str):
        return name.upper()
    from stage.errors import ArgumentError

    raise ArgumentError(f"{name!r}: registers, words and commands are called by their names, as the map has them.")


def _find_in_table(table: dict[str, T], name: str, kind: str) -> T:
    """Return the entry with a name from a table, or raise ArgumentError with similar names."""
    if name not in table:
        from stage.errors import unknown_name_error

        raise unknown_name_error(kind, name, table)
    return table[name]


def as_html(map_: RegisterMap) -> str:
    """Return the map for a notebook: registers, words and commands as tables, each field behind its register."""

    def fields(place: Register | Word) -> str:
        rows = [(f"b{f.bits}", f.name, f.evidence, f.description) for f in place.fields]
        return (
            html.format_collapsible(
                f"{place.name}: its bits", html.format_table(rows, ("bits", "field", "ev", "meaning"))
            )
            if rows
            else ""
        )

    registers = [
        (r.name, r.bits, r.access, _format_range(r), r.unit, r.evidence, _format_title(r)) for r in map_.registers
    ]
    commands = [(c.hex, c.symbol, c.kind, c.bytes or "", c.evidence, c.description) for c in map_.commands]
    head = ("register", "bits", "access", "legal", "unit", "ev", "title")
    parts = [
        html.format_heading(f"{map_.chip}: {map_.title}"),
        html.format_table(registers, head),
        *map(fields, map_.registers),
    ]
    parts += [html.format_heading(f"{w.name}: {w.description}") + fields(w) for w in map_.words]
    if commands:
        table = html.format_table(commands, ("code", "symbol", "kind", "bytes", "ev", "title"))
        parts.append(html.format_collapsible(f"{len(commands)} commands", table))
    return "".join(parts)


def dump(map_: RegisterMap, values: dict[str, int] | None = None) -> str:
    """Return the map as a text table.

    Args:
        map_: The map.
        values: Name of a register or word -> present value; the table then shows the present value of each field.
    """
    lines = [f"{map_.chip}: {map_.title}", f"source: {map_.source}", *_summarize(map_), ""]
    wide = max([18, *(len(_format_range(r)) + 1 for r in map_.registers)])
    head = f"{'register':9}{'bits':>5} {'acc':4}{'legal':>{wide}}  {'ev':3}{'title'}"
    lines += [head, "-" * len(head)]
    for r in map_.registers:
        now = f" = {r.value(values[r.name]) if r.signed else values[r.name]}" if values and r.name in values else ""
        lines.append(
            f"{r.name:9}{r.bits:>5} {r.access:4}{_format_range(r):>{wide}}  {r.evidence:3}{_format_title(r)}{now}"
        )
        for f in r.fields:
            fixed = " (read only)" if f.access == "R" and r.access != "R" else ""
            lines.append(_format_field(f, values.get(r.name) if values else None) + fixed)
    for w in map_.words:
        now = f" = {values[w.name]:0{w.bits // 4}X}h" if values and w.name in values else ""
        lines += ["", f"{w.name}: {w.description}{now}"]
        lines += [_format_field(f, values.get(w.name) if values else None) for f in w.fields]
    if map_.commands:
        wide = max(len(c.symbol) for c in map_.commands) + 2
        head = f"{'command':10}{'symbol':{wide}}{'kind':14}{'bytes':>5}  {'ev':3}{'title'}"
        lines += ["", head, "-" * len(head)]
    for c in map_.commands:
        alone = "" if c.axes else "; no axis bits"
        lines.append(f"{c.hex:10}{c.symbol:{wide}}{c.kind:14}{c.bytes or '':>5}  {c.evidence:3}{c.description}{alone}")
    lines += ["", "evidence: " + ", ".join(f"{k} {v}" for k, v in EVIDENCE.items() if k in _list_evidence(map_))]
    return "\n".join(lines)


def _summarize(map_: RegisterMap) -> list[str]:
    """Summarize the map in lines: numbers of registers, words and commands, and their evidence."""
    written = sum("W" in r.access for r in map_.registers)
    counted = (
        (len(map_.registers), "register", f" ({written} writable)"),
        (len(map_.words), "status word", ""),
        (len(map_.commands), "command", ""),
    )
    parts = ", ".join(f"{n} {what}{'s' * (n != 1)}{more}" for n, what, more in counted if n)
    tags = [f.evidence for place in map_.places for f in place.fields]
    tags += [*(r.evidence for r in map_.registers), *(c.evidence for c in map_.commands)]
    sure = ", ".join(f"{tags.count(tag)} {tag}" for tag in EVIDENCE if tag in tags)
    return [f"{parts}; by evidence, which the end explains: {sure}"]


def _join_note(title: str, note: str) -> str:
    """Join a title and a note to one text."""
    return f"{title}: {note}" if note else title


def _format_range(register: Register) -> str:
    """Format the range of values that the data sheet allows for a register, for a dump."""
    return (
        " or ".join([f"{register.legal[0]}..{register.legal[1]}", *map(str, register.also)])
        if register.legal
        else "any"
    )


def _format_title(register: Register) -> str:
    """Format the title of a register for a dump."""
    return register.description + (f"; {register.reset} after reset" if register.reset else "")


def _format_field(field: Field, word: int | None) -> str:
    """Format a field as a line of a dump, with its value in `word` if that is given."""
    now = "" if word is None else f" = {field.extract(word)}"
    return f"  b{field.bits:<7}{field.name:14}{field.evidence:3}{field.description}{now}"


def _list_evidence(map_: RegisterMap) -> set[str]:
    """Return the letters of evidence (where a value comes from) that occur in a register map."""
    fields = {f.evidence for place in map_.places for f in place.fields}
    return fields | {r.evidence for r in map_.registers} | {c.evidence for c in map_.commands}
