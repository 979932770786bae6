"""`Lines`: lines of text that come at the end of a list, hundreds of them. They are no elements of NiceGUI, which would compare all
of them whenever something else on the page changes."""

from __future__ import annotations

from nicegui import ui

from stage.panel.live import Live


class Lines(ui.element, component="lines.js"):
    """The last `most` lines. Scrolled to the end, it stays there."""

    def __init__(self, live: Live, most: int):
        super().__init__()
        self._props["most"] = most
        self._new: list[tuple[str, str, int]] = []
        self._most = most
        live.call(self, "push", self._take)

    def push(self, text: str, kind: str = "", key: int = 0) -> None:
        """One more, of a class `kind`. key: not 0, it takes the place of the last line that had the same."""
        if key and self._new and self._new[-1][2] == key:
            self._new.pop()
        self._new.append((text, kind, key))
        del self._new[: -self._most]

    def empty(self) -> None:
        """No lines any more."""
        self._new.clear()
        self.run_method("clear")

    def _take(self) -> list | None:
        new, self._new = self._new, []
        return [new] if new else None
