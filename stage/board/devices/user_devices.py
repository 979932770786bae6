"""User-defined devices: `PythonDevice` consists of two functions, `CDevice` of a library with pulsestage_device.h."""

from __future__ import annotations

import ctypes
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stage.board import firmware_library
from stage.board.bus.host_record import IN8, OUT8, OUT16
from stage.board.devices.device import Device, DeviceDescriber, Encoder
from stage.board.errors import LibraryError
from stage.board.temporary_folders import TemporaryFolder
from stage.errors import ArgumentError
from stage.native import get_function_address
from stage.support.argument_checks import explain_arguments
from stage.support.files import check_readable

ABI = 1
UserDescriber = Callable[[int, int, bool], str]
"""Function (port, value, whether the cycle is a write) that returns the meaning of a bus cycle in words."""
MAX_STATE_BYTES = 1 << 20


class UserDevice(Device):
    """Device whose bus cycles a function of the user explains."""

    describe: UserDescriber | None

    def make_describer(self) -> DeviceDescriber:
        """Return the user's function that explains bus cycles, or the default one."""
        if self.describe is None:
            return super().make_describer()
        return lambda n, value, writes, wide: str(self.describe(self.get_board_port(n), value, writes))  # type: ignore[misc]


class PythonDevice(UserDevice):
    """Device that consists of two functions, see `Board.add_device`."""

    def __init__(
        self,
        read: Callable[[int], int] | None = None,
        write: Callable[[int, int], Any] | None = None,
        *,
        state: np.ndarray | bytearray | None = None,
        describe: UserDescriber | None = None,
        name: str | None = None,
        encoders: Sequence[Encoder] = (),
        width: int = 8,
    ):
        super().__init__(name, encoders, width)
        for what, function in (("read", read), ("write", write), ("describe", describe)):
            if function is not None and not callable(function):
                raise ArgumentError(f"{what}={function!r}: a function is wanted, or None.")
        self.read, self.write, self.describe = read, write, describe
        if state is not None:
            self.state = [_check_state(state)]

    def access_register(self, register: int, kind: int, value: int) -> int:
        """Call the user's function for a read or a write."""
        port = self.get_board_port(register)
        if kind in (OUT8, OUT16):
            if self.write is not None:
                self.write(port, value)
            return 0
        highest = 0xFF if kind == IN8 else 0xFFFF
        if self.read is None:
            return highest
        answer = self.read(port)
        try:
            if 0 <= answer <= highest and int(answer) == answer:
                return int(answer)
        except (TypeError, ValueError):
            pass
        raise ArgumentError(
            f"{self.name}: its read({port:03X}h) returned {answer!r}; a whole number from 0 to {highest:X}h is wanted."
        )


class CDevice(UserDevice):
    """Device in C: a library, or C or C++ sources that are built first, with pulsestage_device.h.

    Raises:
        LibraryError: The library contains no device.
        CompileError, NoCompilerError: See `build`.
        FileError: The file does not exist.
    """

    @explain_arguments
    def __init__(
        self,
        source: str | os.PathLike | Sequence[str | os.PathLike],
        *,
        flags: Sequence[str] = (),
        describe: UserDescriber | None = None,
        name: str | None = None,
        encoders: Sequence[Encoder] = (),
        width: int = 8,
    ):
        super().__init__(name, encoders, width)
        self.describe = describe
        if firmware_library.are_sources(source):  # built into a folder of its own, which goes with the device
            self._scratch = TemporaryFolder()
            first = source if isinstance(source, str | os.PathLike) else source[0]
            self.path = firmware_library.build(source, self._scratch.path / f"{Path(first).stem}.so", flags)
        elif isinstance(source, str | os.PathLike):
            self.path = Path(source)
        else:
            raise ArgumentError(f"source={source!r}: give one library, or a list of C or C++ sources.")
        self._loaded_from = TemporaryFolder()  # for a copy of its own, which debuggers and messages about crashes find
        self.loaded = self._loaded_from.path / f"device-{self.path.name}"
        self._library = _load_copy(self.path, self.loaded, source)
        size = ctypes.c_uint32.in_dll(self._library, "pulsestage_device_size").value
        if not size <= MAX_STATE_BYTES:
            raise LibraryError(f"{self.path}: a state of {size:,} bytes; a device has at most {MAX_STATE_BYTES:,}.")
        self.state = [np.zeros(-(-size // 8), np.int64)]
        self.access, self.pulls = (
            get_function_address(self._library[f"pulsestage_device_{name}"]) for name in ("access", "pulls")
        )

    @property
    def label(self) -> str:
        """Name and source file of the device."""
        return f"{self.name} ({self.path.name})"

    def make_recipe(self) -> tuple[Any, ...]:
        """Return a function and its arguments that load the library again in any process."""
        return (_rebuild, str(self.path), self.name, self.encoders, self.width)


def _rebuild(path: str, name: str, encoders: Sequence[Encoder], width: int) -> CDevice:
    """Create the device from its library again."""
    return CDevice(path, name=name, encoders=encoders, width=width)


def _check_state(state: Any) -> np.ndarray:
    """Return the user's array unchanged. Raises ArgumentError if it cannot be the state of a device."""
    if isinstance(state, bytearray):
        return np.frombuffer(state, np.uint8)
    if not isinstance(state, np.ndarray) or state.dtype.hasobject:
        raise ArgumentError(
            f"state={state!r}: an array of numbers that the device changes in place, np.zeros(4, np.int64), or a bytearray."
        )
    if not state.flags.c_contiguous or not state.flags.writeable or not 0 < state.nbytes <= MAX_STATE_BYTES:
        raise ArgumentError(f"state=...: a contiguous, writeable array of 1 to {MAX_STATE_BYTES:,} bytes is wanted.")
    return state


def _load_copy(path: Path, copy: Path, source: Any) -> ctypes.CDLL:
    """Load a copy of a library, so that it has its own static variables.

    Args:
        path: The library.
        copy: Path of the copy.
        source: Source of the library, for messages.
    """
    check_readable(path, "library")
    shutil.copy(path, copy)
    try:
        loaded = ctypes.CDLL(str(copy))
    except OSError as error:
        raise LibraryError(f"{source} cannot be loaded: {str(error).replace(str(copy), str(path))}.") from None
    try:
        abi = ctypes.c_uint32.in_dll(loaded, "pulsestage_device_abi").value
    except ValueError:
        raise LibraryError(
            f"{source} is no device: it has no pulsestage_device_abi. Write `#include <pulsestage_device.h>` and, behind its "
            "functions, `PS_DEVICE(struct state, read, write, interrupt)`."
        ) from None
    if abi != ABI:
        raise LibraryError(
            f"{source} was built with pulsestage_device.h of version {abi}, and this is version {ABI}: build it again."
        )
    return loaded
