"""`Device`: what lies at ports of a board beside its chips, and all that a board needs of it.

A device's state changes in bus cycles, and when somebody feeds it, only; all else about it, the interrupt line too, is a function
of that state, of the time, and of where the axes with its encoders are. So a delay can find the moment of an interrupt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from stage.board.bus import host_record
from stage.errors import ArgumentError, StageError
from stage.native import plain
from stage.sim import records
from stage.sim.encoder import Encoder

if TYPE_CHECKING:
    from stage.board.board import Board
    from stage.sim.stage import Stage

TIME_LIMIT_S = 9e9
"""All times of a stage are before."""
Listener = Callable[[int, int, bool, bool], str]
"""(port of the device, value, whether it is written, whether with 16 bits) -> what the cycle means."""


class Device:
    """Base of all devices.

    Args:
        name: What the trace and messages call it; default: its kind and its first port.
        encoders: Encoders whose counts it sees.
        width: Bits of its bus, 8 or 16.

    Attributes:
        KIND: What it is, in a word.
        PORTS: How many ports it has; 0: as many as it is given.
        ports: Ports of the board that it takes, once it is there.
        state: Arrays that snapshots carry.
        access, pulls: Addresses of its compiled functions, see stage.board.bus.host_record, or 0.
    """

    KIND: ClassVar[str] = "device"
    PORTS: ClassVar[int] = 0

    def __init__(self, name: str | None = None, encoders: Sequence[Encoder] = (), width: int = 8):
        if width not in (8, 16):
            raise ArgumentError(f"width={width!r}: a device has a bus of 8 or of 16 bits.")
        self.name = name or self.KIND
        self._named = name is not None
        self.encoders, self.width = tuple(encoders), width
        for encoder in self.encoders:
            if not isinstance(encoder, Encoder):
                raise ArgumentError(f'{self.name}: encoder {encoder!r}: write for example Encoder("x", per_turn=2000).')
        self.ports: tuple[int, ...] = ()
        self.board: Board | None = None
        self.line = np.full(1, records.NEVER, np.int64)
        self.state: list[np.ndarray] = []
        self.access = self.pulls = 0

    # --- for users ---

    def pull(self, on: bool = True, at: float | None = None) -> None:
        """Pull the interrupt line, or let go of it.

        Args:
            on: Whether it pulls.
            at: Time from which it pulls, s since power-up; default: now.

        Raises:
            ArgumentError: `at` is no time.
        """
        if at is not None and not (_is_finite(at) and abs(at) < TIME_LIMIT_S):
            raise ArgumentError(f"{self.name}: pull(at={at!r}): a time of the stage is wanted, s since power-up.")
        self.line[0] = records.NEVER if not on else self.stage.now if at is None else round(at * 1e9)

    @property
    def is_pulling(self) -> bool:
        """True while it pulls the interrupt line."""
        board = self._require_board()
        return bool(board.read_interrupt_mask() >> (len(board.stage.chips) + board.devices.index(self)) & 1)

    @property
    def stage(self) -> Stage:
        """The stage of its board."""
        return self._require_board().stage

    @property
    def counts(self) -> list[int]:
        """Current count of each of its encoders."""
        stage = self.stage
        tau = float(stage.now - stage.state.start) / records.SECOND - float(stage.state.clockwork[0].half)
        counts = []
        for axis, scale, zero in self._encoders.tolist():
            t = stage.state.axis_table[axis]
            counts.append(math.floor((stage.data.qpos[t.qpos] + stage.data.qvel[t.dof] * tau - zero) * scale + 0.5))
        return counts

    @property
    def label(self) -> str:
        """Name of the device, with the file that it is made of if there is one."""
        return self.name

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"

    # --- for boards ---

    def access_register(self, n: int, kind: int, value: int) -> int:
        """Make a cycle at port `n` of a device in Python. kind: IN8, OUT8, IN16, OUT16 of stage.board.bus.host_record."""
        raise NotImplementedError

    def make_describer(self) -> Listener:
        """Return a function that says what its cycles mean, if it gets all of them."""
        return lambda n, value, writes, wide: f"port {n} {'<-' if writes else '='} {value:0{4 if wide else 2}X}h"

    def get_board_port(self, n: int) -> int:
        """Return the port of the board that its port `n` is; the first of two on a bus of 16 bits."""
        return self.ports[2 * n if self.width == 16 else n]

    def name_port(self, n: int) -> str:
        """Return a port in words."""
        return f"port {n}"

    def list_arrays(self) -> list[np.ndarray]:
        """Return what snapshots carry of it."""
        return [self.line, *self.state]

    def use_arrays(self, places: list[np.ndarray]) -> None:
        """Use these places for its `arrays` from now on."""
        line, *state = places
        self.line = line.view(np.int64)
        pairs = zip(self.state, state, strict=True)
        self.state = [place.view(before.dtype).reshape(before.shape) for before, place in pairs]

    def make_recipe(self) -> tuple[Any, ...]:
        """Return a function and its arguments, which can be pickled: they make the same device in another process, or one that
        takes its place there."""
        return (Placeholder, self.name, self.width, sum(a.nbytes for a in self.state), self.encoders)

    def attach_to(self, board: Board, ports: Sequence[int]) -> None:
        """Become a device of this board, at these ports."""
        rows = [e.row(board.stage) for e in self.encoders]
        self.encoders = tuple(replace(e, zero=row[2]) for e, row in zip(self.encoders, rows, strict=True))
        self._encoders = np.array(rows, host_record.ENCODER)
        self._counts = np.zeros(len(self.encoders), np.int64)
        self.board, self.ports = board, tuple(ports)
        if not self._named:
            self.name = f"{self.KIND} at {self.ports[0]:03X}h"

    def make_record(self) -> tuple[int, ...]:
        """Return its DEVICE_TABLE record."""
        state = self.state[0].ctypes.data if self.state else 0
        line, counts, encoders = (a.ctypes.data for a in (self.line, self._counts, self._encoders))
        return state, self.access, self.pulls, line, counts, encoders, len(self.encoders)

    def _require_board(self) -> Board:
        if self.board is None:
            raise StageError(
                f"{self.name} is on no board yet: board.attach_device(device, ports) or board.add_device(ports, ...)."
            )
        return self.board


def _is_finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except TypeError:
        return False


class Placeholder(Device):
    """A device in Python as the process of isolated firmware has it; it is called in the process of its board."""

    def __init__(self, name: str, width: int, size: int, encoders: Sequence[Encoder]):
        super().__init__(name, encoders, width)
        self.state = [np.zeros(size, np.uint8)]


class Compiled(Device):
    """A device whose module CORE exports STATE, `access` and `pulls`, see stage.board.bus.host_record.

    Attributes:
        CORE: The module.
        OPTIONS: Names of its arguments beside name and encoder.
        registers: Its state by name.
    """

    CORE: ClassVar[Any]
    OPTIONS: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **base: Any):
        super().__init__(**base)
        core: ModuleType = self.CORE
        self.state = [np.zeros(1, core.STATE)]
        self.registers = self.state[0].view(plain(core.STATE))[0]
        self.access, self.pulls = core.access.address, core.pulls.address if hasattr(core, "pulls") else 0

    def make_recipe(self) -> tuple[Any, ...]:
        """Build the device by its class and options, in any process."""
        if not self.access:  # Python is called for its cycles
            return super().make_recipe()
        options = {"name": self.name, **{name: getattr(self, name) for name in self.OPTIONS}}
        if self.encoders:
            options["encoder"] = self.encoders[0]
        return (_rebuild, type(self), options)


def _rebuild(cls: type[Compiled], options: dict[str, Any]) -> Compiled:
    return cls(**options)
