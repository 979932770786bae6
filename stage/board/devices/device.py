"""`Device`: base class of everything at the ports of a board except its chips.

The state of a device changes only in bus cycles and when a user sets inputs. Everything else, the interrupt line
included, is a function of this state, the time and the positions of the axes with encoders. Therefore a delay can find
the exact time of an interrupt.
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
from stage.native import remove_attribute_access
from stage.sim import engine_records
from stage.sim.encoder import Encoder

if TYPE_CHECKING:
    from stage.board.board import Board
    from stage.sim.stage import Stage

TIME_LIMIT_S = 9e9
"""Upper limit of all times of a stage, s."""
DeviceDescriber = Callable[[int, int, bool, bool], str]
"""Function (port of the device, value, whether it is a write, whether it has 16 bits) that describes a bus cycle in words."""


class Device:
    """Base class of all devices.

    Args:
        name: Name in the trace and in messages; default: kind and first port.
        encoders: Encoders that the device counts.
        width: Width of its bus in bits, 8 or 16.

    Attributes:
        KIND: Kind of the device, in one word.
        PORTS: Number of ports; 0: any number.
        ports: Ports of the board that the device occupies.
        state: Arrays that snapshots include.
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
        self.interrupt_start_ns = np.full(1, engine_records.NEVER, np.int64)
        self.state: list[np.ndarray] = []
        self.access = self.pulls = 0

    # --- for users ---

    def pull(self, on: bool = True, at: float | None = None) -> None:
        """Let this device assert the interrupt line, or release it.

        Args:
            on: True to assert it, False to release it.
            at: Time from which the device asserts the line, s since power-up; default: now.

        Raises:
            ArgumentError: `at` is not a time of the stage.
        """
        if at is not None and not (_is_finite(at) and abs(at) < TIME_LIMIT_S):
            raise ArgumentError(f"{self.name}: pull(at={at!r}): a time of the stage is wanted, s since power-up.")
        self.interrupt_start_ns[0] = (
            engine_records.NEVER if not on else self.stage.now if at is None else round(at * 1e9)
        )

    @property
    def is_pulling(self) -> bool:
        """True while the device asserts the interrupt line."""
        board = self._require_board()
        return bool(board.read_interrupt_mask() >> (len(board.stage.chips) + board.devices.index(self)) & 1)

    @property
    def stage(self) -> Stage:
        """Stage of the device's board."""
        return self._require_board().stage

    @property
    def counts(self) -> list[int]:
        """Current count of each encoder that this device reads."""
        stage = self.stage
        tau = float(stage.now - stage.state.start) / engine_records.NS_PER_SECOND - float(stage.state.clockwork[0].half)
        counts = []
        for axis, scale, zero in self._encoders.tolist():
            t = stage.state.axis_table[axis]
            counts.append(math.floor((stage.data.qpos[t.qpos] + stage.data.qvel[t.dof] * tau - zero) * scale + 0.5))
        return counts

    @property
    def label(self) -> str:
        """Name of the device, with its source file if it has one."""
        return self.name

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"

    # --- for boards ---

    def access_register(self, register: int, kind: int, value: int) -> int:
        """Execute a bus cycle at a register of a device in Python, and return the answer.

        Args:
            register: Number of the register.
            kind: IN8, OUT8, IN16 or OUT16 of stage.board.bus.host_record.
            value: Value that is written.
        """
        raise NotImplementedError

    def make_describer(self) -> DeviceDescriber:
        """Return a function that explains bus cycles of this device. It has to receive all of them in order."""
        return lambda n, value, writes, wide: f"port {n} {'<-' if writes else '='} {value:0{4 if wide else 2}X}h"

    def get_board_port(self, register: int) -> int:
        """Return the port of the board at which register `register` lies; on a 16-bit bus the first of its two ports."""
        return self.ports[2 * register if self.width == 16 else register]

    def name_port(self, register: int) -> str:
        """Return the name of register `register`."""
        return f"port {register}"

    def list_arrays(self) -> list[np.ndarray]:
        """Return the arrays that hold the device's state and that snapshots include."""
        return [self.interrupt_start_ns, *self.state]

    def use_arrays(self, arrays: list[np.ndarray]) -> None:
        """Replace the arrays of this device that `list_arrays` returns by these arrays from now on."""
        interrupt_start_ns, *state = arrays
        self.interrupt_start_ns = interrupt_start_ns.view(np.int64)
        pairs = zip(self.state, state, strict=True)
        self.state = [place.view(before.dtype).reshape(before.shape) for before, place in pairs]

    def make_recipe(self) -> tuple[Any, ...]:
        """Return a function and its arguments with which another process creates the same device, or a placeholder.

        Both can be pickled.
        """
        return (PlaceholderDevice, self.name, self.width, sum(a.nbytes for a in self.state), self.encoders)

    def attach_to(self, board: Board, ports: Sequence[int]) -> None:
        """Attach this device to a board at these ports."""
        rows = [e.make_record(board.stage) for e in self.encoders]
        self.encoders = tuple(replace(e, zero=row[2]) for e, row in zip(self.encoders, rows, strict=True))
        self._encoders = np.array(rows, host_record.ENCODER)
        self._counts = np.zeros(len(self.encoders), np.int64)
        self.board, self.ports = board, tuple(ports)
        if not self._named:
            self.name = f"{self.KIND} at {self.ports[0]:03X}h"

    def make_record(self) -> tuple[int, ...]:
        """Return the fields of the device's DEVICE_TABLE record."""
        state = self.state[0].ctypes.data if self.state else 0
        start, counts, encoders = (a.ctypes.data for a in (self.interrupt_start_ns, self._counts, self._encoders))
        return state, self.access, self.pulls, start, counts, encoders, len(self.encoders)

    def _require_board(self) -> Board:
        """Return the board on whose bus this device is. Raises StageError if it is on no board."""
        if self.board is None:
            raise StageError(
                f"{self.name} is on no board yet: board.attach_device(device, ports) or board.add_device(ports, ...)."
            )
        return self.board


def _is_finite(value: Any) -> bool:
    """Return whether a value is a finite number."""
    try:
        return math.isfinite(value)
    except TypeError:
        return False


class PlaceholderDevice(Device):
    """Stand-in for a device in Python, in the separate process of isolated firmware.

    It calls the real device in the board's process.
    """

    def __init__(self, name: str, width: int, size: int, encoders: Sequence[Encoder]):
        super().__init__(name, encoders, width)
        self.state = [np.zeros(size, np.uint8)]


class CompiledDevice(Device):
    """Device with a compiled module CORE that exports STATE, `access` and `pulls`, see stage.board.bus.host_record.

    Attributes:
        CORE: The module.
        OPTIONS: Names of the constructor's arguments except name and encoder.
        registers: Fields of its state by name.
    """

    CORE: ClassVar[Any]
    OPTIONS: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **base: Any):
        super().__init__(**base)
        core: ModuleType = self.CORE
        self.state = [np.zeros(1, core.STATE)]
        self.registers = self.state[0].view(remove_attribute_access(core.STATE))[0]
        self.access, self.pulls = core.access.address, core.pulls.address if hasattr(core, "pulls") else 0

    def make_recipe(self) -> tuple[Any, ...]:
        """Return a function that creates the device from its class and options in any process."""
        if not self.access:  # Python is called for its cycles
            return super().make_recipe()
        options = {"name": self.name, **{name: getattr(self, name) for name in self.OPTIONS}}
        if self.encoders:
            options["encoder"] = self.encoders[0]
        return (_rebuild, type(self), options)


def _rebuild(cls: type[CompiledDevice], options: dict[str, Any]) -> CompiledDevice:
    """Create a device from its class and its options."""
    return cls(**options)
