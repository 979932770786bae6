"""Register maps as data: dumps, diagnostics, documentation and tests read the same tables.

A map says for every bit what it means and on what evidence: S data sheet, H vendor header, D another page of the
manual, C working drivers agree, M memory of the manual, I inferred.
"""

from __future__ import annotations

from dataclasses import dataclass

EVIDENCE = {
    "S": "data sheet",
    "H": "vendor header",
    "D": "other page of the manual",
    "C": "working drivers",
    "M": "memory of the manual",
    "I": "inferred",
}


@dataclass(frozen=True)
class Field:
    """Bits `high`..`low` of a register, command or status word."""

    name: str
    high: int
    low: int
    meaning: str
    evidence: str = "S"
    access: str = "RW"

    @property
    def mask(self) -> int:
        return ((1 << (self.high - self.low + 1)) - 1) << self.low

    @property
    def bits(self) -> str:
        return f"{self.high}" if self.high == self.low else f"{self.high}..{self.low}"

    def of(self, word: int) -> int:
        """The field's value in `word`."""
        return (word & self.mask) >> self.low


@dataclass(frozen=True)
class Register:
    """One register: `number` is how the chip selects it, `bits` its width, `legal` the data sheet's range."""

    name: str
    number: int
    bits: int
    access: str
    title: str
    legal: tuple[int, int] | None = None
    fields: tuple[Field, ...] = ()
    evidence: str = "S"
    unit: str = ""

    @property
    def mask(self) -> int:
        return (1 << self.bits) - 1

    @property
    def writable(self) -> int:
        """The bits that a write changes."""
        return self.mask & ~sum(f.mask for f in self.fields if f.access == "R")


@dataclass(frozen=True)
class Word:
    """A command or status byte: what selects it, and its bits."""

    name: str
    title: str
    fields: tuple[Field, ...]


@dataclass(frozen=True)
class RegisterMap:
    """Everything a host can address on one chip."""

    chip: str
    title: str
    source: str
    registers: tuple[Register, ...]
    words: tuple[Word, ...]

    def register(self, name: str) -> Register:
        """The register called `name` (any case). Raises ArgumentError with near misses."""
        from stage.errors import unknown

        for r in self.registers:
            if r.name == name.upper():
                return r
        raise unknown(f"{self.chip} register", name, (r.name for r in self.registers))

    def word(self, name: str) -> Word:
        return next(w for w in self.words if w.name == name)

    def checked(self, name: str, value: int) -> int:
        """`value` if the data sheet allows it in register `name`; ArgumentError otherwise."""
        from stage.errors import ArgumentError

        r = self.register(name)
        low, high = r.legal or (0, r.mask)
        if int(value) != value or not low <= value <= high:
            raise ArgumentError(
                f"{self.chip} {r.name} ({r.title}) cannot be {value!r}: it takes a whole number from {low} to {high}"
                f"{' ' + r.unit if r.unit else ''}. To see what the silicon does with it, write it on the bus."
            )
        return int(value)


def dump(map_: RegisterMap, values: dict[str, int] | None = None) -> str:
    """The map as a text table; with `values` (register or word name -> value) also what each field holds now."""
    lines = [f"{map_.chip}: {map_.title}", f"source: {map_.source}", ""]
    head = f"{'register':9}{'bits':>5} {'acc':4}{'legal':>18}  {'ev':3}{'title'}"
    lines += [head, "-" * len(head)]
    for r in map_.registers:
        legal = f"{r.legal[0]}..{r.legal[1]}" if r.legal else "any"
        now = f" = {values[r.name]}" if values and r.name in values else ""
        lines.append(f"{r.name:9}{r.bits:>5} {r.access:4}{legal:>18}  {r.evidence:3}{r.title}{now}")
        for f in r.fields:
            fixed = " (read only)" if f.access == "R" and r.access != "R" else ""
            lines.append(_field(f, values.get(r.name) if values else None) + fixed)
    for w in map_.words:
        now = f" = {values[w.name]:02X}h" if values and w.name in values else ""
        lines += ["", f"{w.name}: {w.title}{now}"]
        lines += [_field(f, values.get(w.name) if values else None) for f in w.fields]
    lines += ["", "evidence: " + ", ".join(f"{k} {v}" for k, v in EVIDENCE.items() if k in _tags(map_))]
    return "\n".join(lines)


def _field(f: Field, word: int | None) -> str:
    now = "" if word is None else f" = {f.of(word)}"
    return f"  b{f.bits:<7}{f.name:14}{f.evidence:3}{f.meaning}{now}"


def _tags(map_: RegisterMap) -> set[str]:
    fields = [f for r in map_.registers for f in r.fields] + [f for w in map_.words for f in w.fields]
    return {r.evidence for r in map_.registers} | {f.evidence for f in fields}
