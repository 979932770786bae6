"""`BrowserUpdates`: what changes many times a second goes to a browser as one message a frame, to the elements that show it.

    updates = BrowserUpdates()
    updates.show_text(element, lambda: f"{session.view.time:.4f} s")
    updates.show_lamp(element, lambda: axis.switches.org)
    updates.call_method(chart, "run_chart_method", lambda: ["setOption", message])      None: nothing new

For an update of its own NiceGUI has the browser compare the whole page, some 50 ms where front panels are open: too slow for a
clock. The next message waits until the browser has drawn the last one, so a slow browser gets fewer frames, but none that are late.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

from nicegui import ui

FRAMES = 25  # a second, at most
READ = 0.1  # s between texts: nobody reads faster
PATIENCE = 10.0  # s: a browser that has not answered by then is sent everything again


class BrowserUpdates(ui.element, component="live.js"):
    """Of one browser. What it shows is looked at in the server's thread; an element that is shown here has no text of its own."""

    def __init__(self) -> None:
        super().__init__()
        self._texts: dict[int, tuple[ui.element, Callable[[], str]]] = {}
        self._lamps: dict[int, tuple[ui.element, Callable[[], bool]]] = {}
        self._calls: list[tuple[ui.element, str, Callable[[], list | None], float]] = []
        self._shown: dict[int, str | bool] = {}
        self._called: dict[int, float] = {}
        self._read = 0.0
        ui.timer(1 / FRAMES, self._frame)

    def text(self, element: ui.element, look: Callable[[], str]) -> ui.element:
        """This element's text is what `look()` says."""
        self._texts[element.id] = element, look
        return element

    def lamp(self, element: ui.element, look: Callable[[], bool]) -> ui.element:
        """This element is on, of the class `on`, while `look()` is true."""
        self._lamps[element.id] = element, look
        return element

    def call(self, element: ui.element, method: str, look: Callable[[], list | None], every: float = 0.0) -> None:
        """Call a method of an element in the browser with what `look()` gives, every so many seconds at most; None: not now."""
        self._calls.append((element, method, look, every))

    async def _frame(self) -> None:
        texts, lamps, calls = [], self._new(self._lamps), self._due()
        if perf_counter() - self._read >= READ:
            self._read = perf_counter()
            texts = self._new(self._texts)
        if not (texts or lamps or calls):
            return
        try:
            await self.run_method("show", texts, lamps, calls, timeout=PATIENCE)
        except TimeoutError:
            self._shown.clear()

    def _new(self, all_of: dict[int, Any]) -> list[tuple[int, str | bool]]:
        """What has changed since it was sent. Elements that are gone are forgotten."""
        changed: list[tuple[int, str | bool]] = []
        for key, (element, look) in tuple(all_of.items()):
            if element.is_deleted:
                del all_of[key]
                continue
            now = look()
            if self._shown.get(key) != now:
                self._shown[key] = now
                changed.append((key, now))
        return changed

    def _due(self) -> list[tuple[int, str, list]]:
        calls, now = [], perf_counter()
        for k, (element, method, look, every) in enumerate(self._calls):
            if now - self._called.get(k, 0.0) < every:
                continue
            given = look()
            if given is not None:
                self._called[k] = now
                calls.append((element.id, method, given))
        return calls


class TextLog(ui.element, component="lines.js"):
    """The last `most` lines. Scrolled to the end, it stays there."""

    def __init__(self, live: BrowserUpdates, most: int):
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
