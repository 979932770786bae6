"""`Program`: the actions of a host, listed before they are done: bus cycles and waiting, without branches.

A program is an array of operations, (kind, a, b, c) of int64 each:

    WRITE    axis, address, value     one bus write cycle; its time passes first
    READ     axis, address, -         one bus read cycle; its value is the operation's result
    WAIT     ns, -, -
    STOP     mask, poll ns, limit ns  poll the status of the axes in `mask` until none is in motion;
                                      the result is the ns it took, negative where `limit` came first
    KEEP     mask, poll ns, limit ns  as STOP, and the program ends where a rotor of one of the axes is in another turn of its field
                                      than its pulses: the result is then the ns up to there, negative
    MEASURE  ns, point, -             pass the time a physics step at a time and keep each coordinate's extremes; with a point, 1 +
                                      a site's index or - a body's, the result is how far it travelled: the diagonal of the box
                                      that it kept to, in pm
    LOOK     axis, point, coordinate  the axis' position is the operation's result, in pm (prad on a hinge); with a point, as of
                                      MEASURE, its coordinate of the world, 0 to 2
    END      -, -, -

play.py plays programs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

from stage.errors import ArgumentError
from stage.support.arguments import WrongType, told

if TYPE_CHECKING:
    from stage.chips import Chip

NAMES = ("END", "WRITE", "READ", "WAIT", "STOP", "MEASURE", "LOOK", "KEEP")
END, WRITE, READ, WAIT, STOP, MEASURE, LOOK, KEEP = range(8)
MAX_AXES = 62  # bits of a mask


class Operations(ABC):
    """What a host does, one operation after the other; each method returns the same object."""

    @abstractmethod
    def __len__(self) -> int:
        """How many there are so far."""

    @abstractmethod
    def write(self, axis: int, address: int, value: int) -> Self:
        """One bus write cycle to the chip of the axis with this index."""

    @abstractmethod
    def wait(self, seconds: float) -> Self:
        """Let time pass."""

    @abstractmethod
    def until_stopped(self, axes: Sequence[int], limit: float) -> Self:
        """Poll until none of the axes operates, for `limit` seconds at most."""

    def command(self, axis: int, value: int) -> Self:
        """A command to address 0; more than a byte where the chip's bus is wider."""
        return self.write(axis, 0, value)

    @told
    def register(self, axis: int, chip: Chip | type[Chip], name: str, value: int, chip_axis: int = 0) -> Self:
        """Write a register of a chip as its family does, see `Chip.register_cycles`; chip_axis: the axis of the chip."""
        for address, datum in chip.register_cycles(name, value, chip_axis):
            self.write(axis, address, datum)
        return self


def _to_int(name: str, value: int) -> int:
    """A number of an operation. Raises ArgumentError."""
    try:
        if (number := int(value)) == value and -(1 << 63) <= number < 1 << 63:
            return number
    except (TypeError, ValueError, OverflowError):
        pass
    raise WrongType(f"{name}={value!r}: a whole number of 64 bits.")


def _to_ns(name: str, seconds: float) -> int:
    """Seconds of an operation in ns. Raises ArgumentError."""
    try:
        return _to_int(name, round(seconds * 1e9))
    except (TypeError, ValueError, OverflowError):
        raise WrongType(f"{name}={seconds!r}: a number of seconds.") from None


class Program(Operations):
    """A list of operations; each method appends and returns the program. Raises ArgumentError for what is no number."""

    def __init__(self) -> None:
        self.ops: list[tuple[int, int, int, int]] = []

    def __len__(self) -> int:
        return len(self.ops)

    def write(self, axis: int, address: int, value: int) -> Self:
        """One bus write cycle to the chip of the axis with this index."""
        self.ops.append((WRITE, _to_int("axis", axis), _to_int("address", address), _to_int("value", value)))
        return self

    def read(self, axis: int, address: int) -> Self:
        """One bus read cycle; the value is the operation's result."""
        self.ops.append((READ, _to_int("axis", axis), _to_int("address", address), 0))
        return self

    def wait(self, seconds: float) -> Self:
        self.ops.append((WAIT, _to_ns("seconds", seconds), 0, 0))
        return self

    @told
    def until_stopped(self, axes: Sequence[int], limit: float, poll: float = 2.5e-4, keep_step: bool = False) -> Self:
        """Poll until none of the axes operates; the result is the ns it took, negative when `limit` seconds came first.
        keep_step: the program ends at the first step that one of the axes loses, and the result is negative, too.

        Raises ArgumentError for an axis that no stage has.
        """
        indices = {_to_int("axis", a) for a in axes}
        if not all(0 <= a < MAX_AXES for a in indices):
            raise ArgumentError(f"axes={axes!r}: axes are given by their index, from 0 on.")
        mask = sum(1 << a for a in indices)
        self.ops.append((KEEP if keep_step else STOP, mask, _to_ns("poll", poll), _to_ns("limit", limit)))
        return self

    def look(self, axis: int, point: int = 0, coordinate: int = 0) -> Self:
        """Note where the axis is; the result is its position in pm (prad on a hinge). With a point, see `measure`, where that is: a
        coordinate of the world, 0 to 2, as at the physics step's begin."""
        self.ops.append((LOOK, _to_int("axis", axis), _to_int("point", point), _to_int("coordinate", coordinate)))
        return self

    def measure(self, seconds: float, point: int = 0) -> Self:
        """Let time pass and keep every coordinate's extremes; point: 1 + the index of a site, or - that of a body, whose travel
        is then the result, see above. It is seen at each physics step's begin, as MuJoCo has it."""
        self.ops.append((MEASURE, _to_ns("seconds", seconds), _to_int("point", point), 0))
        return self
