"""`Beside`: arrays that belong to a stage's state and lie outside MuJoCo's: the state of devices on its bus.

MuJoCo's userdata gets its size when the model is compiled, and devices come later. Snapshots, and the process of isolated
firmware, carry these arrays behind MuJoCo's state.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stage.snapshots import layout

PART = "devices on its bus"


class Beside:
    """Of one stage. words: how many words of 8 bytes all of them take."""

    def __init__(self) -> None:
        self._bytes: list[np.ndarray] = []
        self._names: list[str] = []
        self.words = 0

    def add(self, name: str, arrays: Sequence[np.ndarray]) -> None:
        """Contiguous arrays, which stay where they are."""
        self._bytes += [array.reshape(-1).view(np.uint8) for array in arrays]
        size, kinds = sum(array.nbytes for array in arrays), " ".join(layout(array.dtype) for array in arrays)
        self._names.append(f"{name} ({size} bytes of layout {kinds})")
        self.words = -(-sum(map(len, self._bytes)) // 8)

    @property
    def part(self) -> tuple[tuple[str, str], ...]:
        """What the header of a snapshot says of them."""
        return ((PART, "; ".join(self._names)),) if self._names else ()

    def get(self, words: np.ndarray) -> None:
        """Copy all of them into `words`."""
        into, at = words.view(np.uint8), 0
        for array in self._bytes:
            into[at : at + len(array)] = array
            at += len(array)

    def put(self, words: np.ndarray) -> None:
        """All of them are as `get` has found them."""
        source, at = words.view(np.uint8), 0
        for array in self._bytes:
            array[:] = source[at : at + len(array)]
            at += len(array)
