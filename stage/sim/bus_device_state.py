"""`DeviceState`: arrays of the devices on a stage's bus, part of the stage's state outside MuJoCo's.

MuJoCo's userdata gets its size when the model is compiled, and devices are added later. Snapshots, and the process of isolated
firmware, store these arrays behind MuJoCo's state.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stage.errors import ArgumentError
from stage.support.snapshots import hash_layout

HEADER_PART_NAME = "devices on its bus"


class DeviceState:
    """State of the devices on the bus of one stage: the arrays of all devices.

    Attributes:
        words: Number of words of 8 bytes that all arrays take; each array begins at a new word.
    """

    def __init__(self) -> None:
        self._bytes: list[np.ndarray] = []
        self._names: list[str] = []
        self.words = 0

    def add_device(self, name: str, arrays: Sequence[np.ndarray]) -> None:
        """Add the state arrays of a device on the bus.

        Args:
            name: Name of the device.
            arrays: Contiguous arrays, which stay where they are.

        Raises:
            ArgumentError: An array is not contiguous.
        """
        if not all(isinstance(array, np.ndarray) and array.flags.c_contiguous for array in arrays):
            raise ArgumentError(f"arrays={arrays!r}: give a list of contiguous NumPy arrays.")
        self._bytes += [array.reshape(-1).view(np.uint8) for array in arrays]
        size, kinds = sum(array.nbytes for array in arrays), " ".join(hash_layout(array.dtype) for array in arrays)
        self._names.append(f"{name} ({size} bytes of layout {kinds})")
        self.words = sum(-(-len(own) // 8) for own in self._bytes)

    @property
    def header_part(self) -> tuple[tuple[str, str], ...]:
        """Part of a snapshot's header that describes the arrays; () if there are none."""
        return ((HEADER_PART_NAME, "; ".join(self._names)),) if self._names else ()

    def copy_to(self, words: np.ndarray) -> None:
        """Copy the state arrays of all devices into one array of words.

        Args:
            words: Array of `words` float64 or int64 values.
        """
        for array, place in zip(self._bytes, self._split_words(words), strict=True):
            place[:] = array

    def copy_from(self, words: np.ndarray) -> None:
        """Copy the state arrays of all devices back from one array of words.

        Args:
            words: Array that `copy_to` has filled.
        """
        for array, place in zip(self._bytes, self._split_words(words), strict=True):
            array[:] = place

    def move_to(self, words: np.ndarray) -> list[np.ndarray]:
        """Move the memory of all devices' state arrays into one array of words.

        Args:
            words: Array of `words` float64 or int64 values, which the devices use from now on.

        Returns:
            The bytes of each array in `words`.
        """
        self.copy_to(words)
        self._bytes = self._split_words(words)
        return self._bytes

    def _split_words(self, words: np.ndarray) -> list[np.ndarray]:
        """Split an array of words into a view of bytes for each device array."""
        places, at, all_bytes = [], 0, words.view(np.uint8)
        for array in self._bytes:
            places.append(all_bytes[at : at + len(array)])
            at += -(-len(array) // 8) * 8
        return places
