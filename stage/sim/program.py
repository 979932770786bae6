"""`Program`: a list of bus cycles and waits of a host, without branches, which compiled code plays.

A program is an array of operations, each of four int64 (kind, a, b, c):

    WRITE    axis, address, value     one bus write cycle; its time passes first
    READ     axis, address, -         one bus read cycle; its value is the operation's result
    WAIT     ns, -, -
    AWAIT_STOP
             mask, poll ns, limit ns  poll the status of the axes in `mask` until none is in motion; the result is the duration
                                      in ns, negative if `limit` passed first
    AWAIT_STOP_OR_LOST_STEP
             mask, poll ns, limit ns  as AWAIT_STOP, and the program ends if an axis in `mask` loses a step; the result is then
                                      the negative duration up to that time
    MEASURE  ns, point, -             wait, and store the least and the greatest value of each coordinate; with a point (1 + the
                                      index of a site, or minus the index of a body) the result is the point's travel in pm: the
                                      diagonal of the smallest box around its path
    SAMPLE_POSITION
             axis, point, coordinate  the result is the position of the axis in pm (prad on a hinge); with a point, as of MEASURE,
                                      the result is the point's world coordinate 0 to 2
    END      -, -, -                  end of the program

program_player.py plays programs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

from stage.errors import ArgumentError
from stage.support.argument_checks import WrongType, explain_arguments

if TYPE_CHECKING:
    from stage.chips import Chip

OPERATION_NAMES = (
    "END", "WRITE", "READ", "WAIT", "AWAIT_STOP", "MEASURE", "SAMPLE_POSITION", "AWAIT_STOP_OR_LOST_STEP",
)  # fmt: skip
END, WRITE, READ, WAIT, AWAIT_STOP, MEASURE, SAMPLE_POSITION, AWAIT_STOP_OR_LOST_STEP = range(len(OPERATION_NAMES))
MAX_AXES = 62  # bits of a mask


class Operations(ABC):
    """Base class of lists of a host's operations. Each method appends an operation and returns the list."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of operations so far."""

    @abstractmethod
    def write(self, axis: int, address: int, value: int) -> Self:
        """Add one bus write cycle.

        Args:
            axis: Index of the axis whose chip it goes to.
            address: Address.
            value: Value.
        """

    @abstractmethod
    def wait(self, seconds: float) -> Self:
        """Add a wait of simulated time, s."""

    @abstractmethod
    def until_stopped(self, axes: Sequence[int], limit: float) -> Self:
        """Add a poll until none of the axes is in motion.

        Args:
            axes: Indices of the axes.
            limit: Simulated time to wait, s.
        """

    def command(self, axis: int, value: int) -> Self:
        """Add a command, a write to address 0.

        Args:
            axis: Index of the axis.
            value: Command; more than a byte where the chip's bus is wider.
        """
        return self.write(axis, 0, value)

    @explain_arguments
    def register(self, axis: int, chip: Chip | type[Chip], name: str, value: int, chip_axis: int = 0) -> Self:
        """Add the writes of a register as the chip's family makes them, see `Chip.register_cycles`.

        Args:
            axis: Index of the axis.
            chip: Chip, or its class.
            name: Name of the register.
            value: Its value.
            chip_axis: Axis of the chip.
        """
        for address, datum in chip.register_cycles(name, value, chip_axis):
            self.write(axis, address, datum)
        return self


def _to_int(name: str, value: int) -> int:
    """Convert an argument of an operation to an integer.

    Raises:
        WrongType: The argument is not a whole number of 64 bits.
    """
    try:
        if (number := int(value)) == value and -(1 << 63) <= number < 1 << 63:
            return number
    except (TypeError, ValueError, OverflowError):
        pass
    raise WrongType(f"{name}={value!r}: a whole number of 64 bits.")


def _to_ns(name: str, seconds: float) -> int:
    """Convert the seconds of an operation to nanoseconds.

    Raises:
        WrongType: The argument is not a number.
    """
    try:
        return _to_int(name, round(seconds * 1e9))
    except (TypeError, ValueError, OverflowError):
        raise WrongType(f"{name}={seconds!r}: a number of seconds.") from None


class Program(Operations):
    """Program of a host: each method appends an operation and returns the program.

    Raises:
        ArgumentError: An argument is not a number.
    """

    def __init__(self) -> None:
        self.ops: list[tuple[int, int, int, int]] = []

    def __len__(self) -> int:
        return len(self.ops)

    def write(self, axis: int, address: int, value: int) -> Self:
        """Add one bus write cycle to the program.

        Args:
            axis: Index of the axis whose chip it goes to.
            address: Address.
            value: Value.
        """
        self.ops.append((WRITE, _to_int("axis", axis), _to_int("address", address), _to_int("value", value)))
        return self

    def read(self, axis: int, address: int) -> Self:
        """Add one bus read cycle to the program; the value that is read is the operation's result.

        Args:
            axis: Index of the axis whose chip it goes to.
            address: Address.
        """
        self.ops.append((READ, _to_int("axis", axis), _to_int("address", address), 0))
        return self

    def wait(self, seconds: float) -> Self:
        """Add a wait of simulated time, s, to the program."""
        self.ops.append((WAIT, _to_ns("seconds", seconds), 0, 0))
        return self

    @explain_arguments
    def until_stopped(
        self, axes: Sequence[int], limit: float, poll: float = 2.5e-4, end_on_lost_step: bool = False
    ) -> Self:
        """Add a poll until none of the axes is in motion; its result is the duration in ns, negative if the limit passed first.

        Args:
            axes: Indices of the axes.
            limit: Simulated time to wait, s.
            poll: Simulated time between two polls, s.
            end_on_lost_step: Whether to end the program at the first step that one of the axes loses; the result is then negative.

        Raises:
            ArgumentError: An axis is out of range.
        """
        indices = {_to_int("axis", a) for a in axes}
        if not all(0 <= a < MAX_AXES for a in indices):
            raise ArgumentError(f"axes={axes!r}: axes are given by their index, from 0 on.")
        mask = sum(1 << a for a in indices)
        kind = AWAIT_STOP_OR_LOST_STEP if end_on_lost_step else AWAIT_STOP
        self.ops.append((kind, mask, _to_ns("poll", poll), _to_ns("limit", limit)))
        return self

    def sample_position(self, axis: int, point: int = 0, coordinate: int = 0) -> Self:
        """Add a sample of a true position, which a host cannot read; its result is in pm (prad on a hinge).

        Args:
            axis: Index of the axis.
            point: 0 for the position of the axis; else a point as in `measure`, sampled at the beginning of the physics step.
            coordinate: Coordinate of the point in the world, 0 to 2.
        """
        self.ops.append(
            (SAMPLE_POSITION, _to_int("axis", axis), _to_int("point", point), _to_int("coordinate", coordinate))
        )
        return self

    def measure(self, seconds: float, point: int = 0) -> Self:
        """Add a wait that stores the least and the greatest value of every coordinate, sampled at the beginning of physics steps.

        Args:
            seconds: Simulated time, s.
            point: 1 + the index of a site, or minus the index of a body: the result is then the travel of this point; 0: none.
        """
        self.ops.append((MEASURE, _to_ns("seconds", seconds), _to_int("point", point), 0))
        return self
