"""Knowledge of the bus target about a family of chips. `Family` serves any chip: raw bus cycles, edges, clocks, and common checks.

A subclass defines more for its family: how bytes become whole registers, which chips must be silent, what an advance may change,
and where the work of its core is counted. FAMILIES of bus.py lists the subclasses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzing.promises import Finding, require
from fuzzing.rows import Row, to_lists
from stage.chips import Chip
from stage.chips.chip import Pins
from stage.chips.journal import Journal

Values = dict[str, int]


class Enough(Exception):
    """Exception that ends an input that has done all the work that it may do."""


class Work:
    """Counter of an uncompiled core's work: `calls` of the functions between two events, and the speed `steps` in them."""

    def __init__(self) -> None:
        self.calls = self.steps = self.done = 0
        self.budget: int | None = None

    def spend(self) -> None:
        """Count an event of this input, and raise Enough beyond its budget."""
        self.done += 1
        if self.budget is not None and self.done > self.budget:
            raise Enough


class Family:
    """Chips of one class on the fuzzer's bench.

    Args:
        chip: Class of the chips.

    Attributes:
        work: Counter of an uncompiled core, or None.
        FREE: Fields of the state that may differ between two equal runs.
    """

    work: Work | None = None
    FREE: tuple[str, ...] = ()  # words of the state that an advance in pieces may leave otherwise
    FEW = 5000  # pulses: the edges of more are not looked for one by one
    FEW_CLOCKS = 1 << 62  # likewise, where edges come without pulses
    PULSED = 0  # outputs whose pulses a course has as entries of their own

    def __init__(self, chip: type[Chip]):
        self.chip = chip
        self.limits = [(r.name, r.mask) for r in chip.MAP.registers]
        dtype = chip.CORE.STATE
        fields = [dtype.fields[name] for name in self.FREE]
        self.free = [slice(offset, offset + kind.itemsize) for kind, offset in fields]
        self.floats = [name for name in dtype.names if dtype[name].base.kind == "f"]

    def warm_up(self) -> None:
        """Compile the functions whose time will be measured."""
        chip = self.chip()
        chip.write(0, 0)
        chip.read(0)
        chip.advance(1)
        chip.trace(1)

    def make(self, uncompiled: bool) -> Chip:
        """Make a chip at power-up; an uncompiled one has its state in a Row."""
        chip = self.chip()
        if uncompiled:
            row: Any = Row(chip._rows[0])
            chip._rows, chip._record, chip._address = [row], row, row  # type: ignore[assignment]
        return chip

    def state(self, chip: Chip) -> list:
        """Return all values of a chip's state except those in FREE, for a compiled or an uncompiled chip."""
        row, names = chip.state, self.chip.CORE.STATE.names
        return [to_lists(row[name]) for name in names if name not in self.FREE]

    def bits(self, chip: Chip) -> bytes:
        """Return the bytes of a compiled chip's state without the fields in FREE."""
        row = bytearray(chip.state.tobytes())
        for place in self.free:
            row[place] = bytes(place.stop - place.start)
        return bytes(row)

    def pins(self, chip: Chip) -> list[tuple[Pins, str]]:
        """List the input pins of all axes."""
        return [(axis.pins, name) for axis in chip.axes for name in chip.INPUTS]

    def toggle_pin(self, chip: Chip, low: int) -> None:
        """Change an input of the chip from outside; here one of its input pins changes its level.

        Args:
            chip: Chip to change.
            low: Choice of the pin, 0 to 31.
        """
        pins = self.pins(chip)
        on, name = pins[low % len(pins)]
        setattr(on, name, not getattr(on, name))

    def make_writes(self, kind: int, low: int, take: Callable[[int], int]) -> list[tuple[int, int]]:
        """Return the bus writes (address, value) of an operation; here a raw write.

        Args:
            kind: 0 to 3, of the first byte of the operation.
            low: 0 to 31, of the same byte.
            take: take(n) is the number in the next n bytes.
        """
        return [(kind << 5 | low, take(1 if self.chip.DATA_MASK <= 0xFF else 2))]

    def write(self, chip: Chip, address: int, value: int) -> None:
        """Make one bus write cycle."""
        chip.write(address, value)

    def read(self, chip: Chip, address: int) -> int:
        """Make one bus read cycle."""
        return chip.read(address)

    def predict_read(self, chip: Chip, values: Values, address: int) -> int | None:
        """Return the value that a bus read must return now, or None if `values`, the debugger's view, does not determine it."""
        return None

    def is_silent(self, chip: Chip) -> bool:
        """Return whether no pulse may begin before the next write or edge."""
        return False

    def check(self, chip: Chip, values: Values) -> None:
        """Check what must hold between any two operations."""
        wide = [name for name, mask in self.limits if values.get(name, 0) & ~mask]
        if wide:
            raise Finding(f"{wide[0]} = {values[wide[0]]} is wider than the register")
        row: Any = chip.state
        if isinstance(row, Row) and not row.fits():
            raise Finding(f"a word of the state has more than 64 bits: {vars(row)}")
        for name in self.floats:
            if not np.isfinite(chip.state[name]).all():
                raise Finding(f"{name} is {chip.state[name]}")

    def limit_clocks(self, chip: Chip, clocks: int) -> int:
        """Return the clocks of the next advance, at most the requested ones."""
        return clocks

    def read_end_values(self, chip: Chip) -> dict[str, int]:
        """Read from the chip the values that the last edge of its waveform must have."""
        words = {"outputs": chip.output_word(0), "inputs": chip.input_word(0)}
        return {"clock": chip.clock, "net": chip.net(0), **words}

    def check_waveform(self, chip: Chip, journal: Journal, pulses: int) -> None:
        """Replay the journal of a whole compiled input, and compare its end with the chip."""
        edges = np.concatenate(
            list(journal.replay_in_pieces(every_pulse=pulses <= self.FEW and chip.clock < self.FEW_CLOCKS, size=1024))
        )
        require(bool((edges["clock"][1:] >= edges["clock"][:-1]).all()), "a course that runs back")
        is_at = self.read_end_values(chip)
        ends_at = {name: int(edges[-1][name]) for name in is_at}
        for end in (is_at, ends_at):
            end["outputs"] &= ~self.PULSED
        require(ends_at == is_at, f"a course that ends with {ends_at}, a chip with {is_at}")

    def compute_max_work(self, chip: Chip, pulses: int) -> int:
        """Return the maximum number of calls that `work` may count in one advance."""
        raise NotImplementedError
