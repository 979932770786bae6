"""`Beside`: arrays that belong to a stage's state and lie outside MuJoCo's: the state of devices on its bus.

MuJoCo's userdata gets its size when the model is compiled, and devices come later. Snapshots, and the process of isolated
firmware, carry these arrays behind MuJoCo's state.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stage.errors import ArgumentError
from stage.support.snapshots import layout

PART = "devices on its bus"


class Beside:
    """Of one stage. words: how many words of 8 bytes all of them take."""

    def __init__(self) -> None:
        self._bytes: list[np.ndarray] = []
        self._names: list[str] = []
        self.words = 0

    def add(self, name: str, arrays: Sequence[np.ndarray]) -> None:
        """Contiguous arrays, which stay where they are."""
        if not all(isinstance(array, np.ndarray) and array.flags.c_contiguous for array in arrays):
            raise ArgumentError(f"arrays={arrays!r}: give a list of contiguous NumPy arrays.")
        self._bytes += [array.reshape(-1).view(np.uint8) for array in arrays]
        size, kinds = sum(array.nbytes for array in arrays), " ".join(layout(array.dtype) for array in arrays)
        self._names.append(f"{name} ({size} bytes of layout {kinds})")
        self.words = sum(-(-len(own) // 8) for own in self._bytes)

    @property
    def part(self) -> tuple[tuple[str, str], ...]:
        """What the header of a snapshot says of them."""
        return ((PART, "; ".join(self._names)),) if self._names else ()

    def get(self, words: np.ndarray) -> None:
        """Copy all of them into `words`."""
        for array, place in zip(self._bytes, self._places(words), strict=True):
            place[:] = array

    def put(self, words: np.ndarray) -> None:
        """All of them are as `get` has found them."""
        for array, place in zip(self._bytes, self._places(words), strict=True):
            array[:] = place

    def move_to(self, words: np.ndarray) -> list[np.ndarray]:
        """From now on they lie in `words`; returns where, as bytes."""
        self.get(words)
        self._bytes = self._places(words)
        return self._bytes

    def _places(self, words: np.ndarray) -> list[np.ndarray]:
        """Each begins at a word of its own."""
        found, at, all_bytes = [], 0, words.view(np.uint8)
        for array in self._bytes:
            found.append(all_bytes[at : at + len(array)])
            at += -(-len(array) // 8) * 8
        return found
