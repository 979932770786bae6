"""What of the bus of a host belongs to a recording. The bus itself is a board's, see stage.board.waveforms."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any


class HostPart:
    """The bus cycles of a stage's board from the making of this to `close`. The board may come later."""

    def __init__(self, stage: Any):
        self._stage = stage
        self._begin = None if stage.host is None else stage.host.mark()
        self._end: Any = None
        self._until: int | None = None

    def close(self) -> None:
        """The recording is over."""
        self._end, self._until = None if self._stage.host is None else self._stage.host.mark(), self._stage.now

    @property
    def until(self) -> int:
        """When the recording was closed, or now, ns."""
        return self._stage.now if self._until is None else self._until

    def changes(self, writer: Any, begin: int, end: int) -> list[Iterator[tuple[int, Any, Any]]]:
        """Register the bus now if there were cycles from `begin` to `end` ns; its changes (ns, variable, value)."""
        if self._stage.host is None or (self._until is not None and self._end is None):
            return []
        return self._stage.host.changes(writer, self._begin, self._end, begin, end)
