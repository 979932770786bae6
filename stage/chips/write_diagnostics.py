"""Diagnostics: messages about bus writes that break a rule of the data sheet.

The lint of a family is a generator. For one bus write, and the state before it, it yields a pair of a `Rule` and a message for
every rule that the write breaks; the chip adds clock, address and value, and keeps the result in `chip.diagnostics`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

from stage.chips.journal_entries import WRITE

if TYPE_CHECKING:
    from types import ModuleType

    from stage.chips.chip import Chip

BUS_WRITE = "bus write"
MAX_DIAGNOSTICS = 1000
MAX_JOURNAL_ENTRIES = 1 << 21  # 64 MB


class Rule(NamedTuple):
    """A rule of a data sheet whose breach a lint recognizes.

    Attributes:
        key: Short, stable identifier, unique in its chip family, such as "no-reset-command".
        source: Section of the data sheet that states the rule.
        once: Whether a chip keeps only the first diagnostic of this rule: for limits of the silicon that a running program would
            exceed again and again.
    """

    key: str
    source: str
    once: bool = False

    def with_source(self, section: str) -> Rule:
        """Return this rule with another section of the data sheet; "" leaves the section as it is."""
        return self._replace(source=section) if section else self


Finding = tuple[Rule, str]
"""A broken rule and the message about it, as a lint yields them."""

BUS_WIDTH = Rule("bus-width", "bus")
CLOCK_RANGE = Rule("clock-range", "clock")


class Diagnostic(NamedTuple):
    """A message about a bus write that breaks a rule of the data sheet.

    Attributes:
        clock: Reference clocks since power-up at the write.
        address: Address of the write.
        value: Value of the write.
        message: What is wrong with the write, and its effect.
        source: Section of the data sheet.
        key: Identifier of the broken rule, see `Rule`.
    """

    clock: int
    address: int
    value: int
    message: str
    source: str
    key: str = ""


class Cause(NamedTuple):
    """Cause of a diagnostic: the kind of input that broke the rule, and how often.

    Attributes:
        kind: "bus write", "edge" (of a line), "datagram" (of a UART) or "setting" (registers whose values do not fit together).
        times: How often.
    """

    kind: str
    times: int


def parse_diagnostics(data: Iterable[Any]) -> tuple[Diagnostic, ...]:
    """Convert the diagnostics in a snapshot's file.

    Raises:
        TypeError: The data are not the diagnostics of a snapshot.
        ValueError: The data are not the diagnostics of a snapshot.
    """
    diagnostics = tuple(Diagnostic(*fields) for fields in data)
    if any(list(map(type, d)) != [int, int, int, str, str, str] for d in diagnostics):
        raise TypeError("three whole numbers and three texts")
    return diagnostics


def summarize_diagnostics(chips: Iterable[Chip]) -> str:
    """Return how many bus writes, edges of lines and so on break rules, as "2 bus writes and 3,200 edges"; "" if none does."""
    counts = Counter[str]()
    for chip in chips:
        diagnostics = chip.diagnostics
        causes = [(d, chip.find_cause_of(d)) for d in diagnostics]
        counts[BUS_WRITE] += len({(d.clock, d.address, d.value) for d, cause in causes if cause.kind == BUS_WRITE})
        for _, cause in causes:
            counts[cause.kind] += cause.times * (cause.kind != BUS_WRITE)
    return " and ".join(f"{n:,} {what}{'s' * (n > 1)}" for what, n in counts.items() if n)


def list_rules(lint: ModuleType) -> list[Rule]:
    """Return the rules that a family's lint module defines, in their order there."""
    return [rule for rule in vars(lint).values() if isinstance(rule, Rule)]


class JournalLint:
    """Lint of a chip whose bus cycles compiled code makes. It reads the writes from a journal when a user requests diagnostics."""

    def __init__(self, chip: Chip):
        self._chip = chip
        self._journal = chip.journal()

    def process_long_journal(self) -> None:
        """Process the journal if it has become long, so that its memory stays bounded."""
        if len(self._journal.entries) > MAX_JOURNAL_ENTRIES:
            self.process()

    def process(self) -> None:
        """Add the diagnostics of all writes in the journal to the chip's, and begin a new journal."""
        chip, journal = self._chip, self._journal
        entries = journal.entries
        if not len(entries) and journal.end_clock == chip.clock == int(journal.start_state["clock"]):
            return
        if (entries.to_packed()["kind"] == WRITE).any():
            replica = chip.make_replica(journal.start_state.tobytes())
            for entry in entries:
                chip.CORE.advance.c(replica.pointer, entry.clock)
                if entry.kind == WRITE:
                    chip.diagnose(entry.clock, entry.a, entry.b, replica.lint(entry.a, entry.b))
                entry.apply(chip.CORE, replica.pointer)
        journal.restart()
