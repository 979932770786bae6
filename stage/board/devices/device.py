"""`Device`: what lies at ports of a board beside its chips, and all that a board asks of it.

A device's state changes in bus cycles, and when somebody feeds it, only; all else about it, the interrupt line too, is a function
of that state, of the time, and of where the axes with its encoders are. So a delay can look for the moment of an interrupt.
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

LATEST = 9e9
"""s; all times of a stage are before."""
Listener = Callable[[int, int, bool, bool], str]
"""(port of the device, value, whether it is written, whether with 16 bits) -> what the cycle means."""


class Device:
    """Base of all devices.

    Args:
        name: what the trace and messages call it; default: its kind and its first port.
        encoders: Encoders whose counts it sees.
        width: 8, or 16: bits of its bus.
    Attributes:
        ports: those of the board that it takes, once it is there; state: the arrays that snapshots carry.
        PORTS: how many ports it has, where it says; access, pulls: addresses of its compiled functions, see
            stage.board.bus.host_record, or 0.
    """

    KIND: ClassVar[str] = "device"
    PORTS: ClassVar[int] = 0

    def __init__(self, name: str | None = None, encoders: Sequence[Encoder] = (), width: int = 8):
        if width not in (8, 16):
            raise ArgumentError(f"width={width!r}: a device has a bus of 8 or of 16 bits.")
        self.name = name or self.KIND
        self._named = name is not None
        self.encoders, self.width = tuple(encoders), width
        for given in self.encoders:
            if not isinstance(given, Encoder):
                raise ArgumentError(f'{self.name}: encoder {given!r}: write for example Encoder("x", per_turn=2000).')
        self.ports: tuple[int, ...] = ()
        self.board: Board | None = None
        self.line = np.full(1, records.NEVER, np.int64)
        self.state: list[np.ndarray] = []
        self.access = self.pulls = 0

    # --- for users ---

    def pull(self, on: bool = True, at: float | None = None) -> None:
        """Pull the interrupt line, or let go of it; at: from this time on (s since power-up; default: now).

        Raises ArgumentError for what is no time.
        """
        if at is not None and not (_finite(at) and abs(at) < LATEST):
            raise ArgumentError(f"{self.name}: pull(at={at!r}): a time of the stage is wanted, s since power-up.")
        self.line[0] = records.NEVER if not on else self.stage.now if at is None else round(at * 1e9)

    @property
    def pulling(self) -> bool:
        """It pulls the interrupt line."""
        board = self._on_a_board()
        return bool(board.pulling() >> (len(board.stage.chips) + board.devices.index(self)) & 1)

    @property
    def stage(self) -> Stage:
        return self._on_a_board().stage

    @property
    def counts(self) -> list[int]:
        """Of each of its encoders, where it stands now."""
        stage = self.stage
        tau = float(stage.now - stage.state.start) / records.SECOND - float(stage.state.clockwork[0].half)
        found = []
        for axis, counts, zero in self._encoders.tolist():
            t = stage.state.axis_table[axis]
            found.append(math.floor((stage.data.qpos[t.qpos] + stage.data.qvel[t.dof] * tau - zero) * counts + 0.5))
        return found

    @property
    def label(self) -> str:
        """Its name, and the file that it is made of if there is one."""
        return self.name

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"

    # --- for boards ---

    def call(self, n: int, way: int, value: int) -> int:
        """A cycle at its port `n`, of a device in Python; way: IN8, OUT8, IN16, OUT16 of stage.board.bus.host_record."""
        raise NotImplementedError

    def listener(self) -> Listener:
        """Tells what its cycles mean, those before given."""
        return lambda n, value, writes, wide: f"port {n} {'<-' if writes else '='} {value:0{4 if wide else 2}X}h"

    def port(self, n: int) -> int:
        """Which port of the board its port `n` is; of a bus of 16 bits the first of two."""
        return self.ports[2 * n if self.width == 16 else n]

    def port_name(self, n: int) -> str:
        """Of one of its ports."""
        return f"port {n}"

    def kept(self) -> list[np.ndarray]:
        """What snapshots carry of it."""
        return [self.line, *self.state]

    def move_to(self, places: list[np.ndarray]) -> None:
        """What `kept` has told lies here from now on."""
        line, *state = places
        self.line = line.view(np.int64)
        pairs = zip(self.state, state, strict=True)
        self.state = [place.view(before.dtype).reshape(before.shape) for before, place in pairs]

    def twin(self) -> tuple[Any, ...]:
        """A function and its arguments, which can be pickled: they make the same device, or what stands for it, elsewhere."""
        return (Absent, self.name, self.width, sum(a.nbytes for a in self.state), self.encoders)

    def join(self, board: Board, ports: Sequence[int]) -> None:
        """It is on this board from now on."""
        rows = [e.row(board.stage) for e in self.encoders]
        self.encoders = tuple(replace(e, zero=row[2]) for e, row in zip(self.encoders, rows, strict=True))
        self._encoders = np.array(rows, host_record.ENCODER)
        self._counts = np.zeros(len(self.encoders), np.int64)
        self.board, self.ports = board, tuple(ports)
        if not self._named:
            self.name = f"{self.KIND} at {self.ports[0]:03X}h"

    def row(self) -> tuple[int, ...]:
        """DEVICE_TABLE, see stage.board.bus.host_record."""
        state = self.state[0].ctypes.data if self.state else 0
        line, counts, encoders = (a.ctypes.data for a in (self.line, self._counts, self._encoders))
        return state, self.access, self.pulls, line, counts, encoders, len(self.encoders)

    def _on_a_board(self) -> Board:
        if self.board is None:
            raise StageError(f"{self.name} is on no board yet: board.put(device, ports) or board.device(ports, ...).")
        return self.board


def _finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except TypeError:
        return False


class Absent(Device):
    """In the process of isolated firmware: a device in Python, which is called in the process of its board."""

    def __init__(self, name: str, width: int, size: int, encoders: Sequence[Encoder]):
        super().__init__(name, encoders, width)
        self.state = [np.zeros(size, np.uint8)]


class Compiled(Device):
    """A device whose module exports STATE, `access` and `pulls`, see stage.board.bus.host_record.

    Attributes: options: its arguments; registers: its state by name.
    """

    CORE: ClassVar[Any]
    OPTIONS: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **base: Any):
        super().__init__(**base)
        core: ModuleType = self.CORE
        self.state = [np.zeros(1, core.STATE)]
        self.registers = self.state[0].view(plain(core.STATE))[0]
        self.access, self.pulls = core.access.address, core.pulls.address if hasattr(core, "pulls") else 0

    def twin(self) -> tuple[Any, ...]:
        options = {"name": self.name, **{name: getattr(self, name) for name in self.OPTIONS}}
        if self.encoders:
            options["encoder"] = self.encoders[0]
        return (_twin, type(self), options)


def _twin(cls: type[Compiled], options: dict[str, Any]) -> Compiled:
    return cls(**options)
