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

FRAMES = 25  # a second, at max_lines
TEXT_INTERVAL_S = 0.1  # s between texts: nobody reads faster
ANSWER_TIMEOUT_S = 10.0  # s: a browser that has not answered by then is sent everything again


class BrowserUpdates(ui.element, component="live.js"):
    """Updates of one browser, read in the server's thread. An element that is shown here has no text of its own."""

    def __init__(self) -> None:
        super().__init__()
        self._texts: dict[int, tuple[ui.element, Callable[[], str]]] = {}
        self._lamps: dict[int, tuple[ui.element, Callable[[], bool]]] = {}
        self._calls: list[tuple[ui.element, str, Callable[[], list | None], float]] = []
        self._shown: dict[int, str | bool] = {}
        self._called: dict[int, float] = {}
        self._read = 0.0
        ui.timer(1 / FRAMES, self._frame)

    def show_text(self, element: ui.element, read: Callable[[], str]) -> ui.element:
        """Keep the text of an element at what `read()` returns."""
        self._texts[element.id] = element, read
        return element

    def show_lamp(self, element: ui.element, read: Callable[[], bool]) -> ui.element:
        """Give an element the class `on` while `read()` is true."""
        self._lamps[element.id] = element, read
        return element

    def call_method(
        self, element: ui.element, method: str, read: Callable[[], list | None], every: float = 0.0
    ) -> None:
        """Call a method of an element in the browser with what `read()` returns, every so many seconds at most; None: not now."""
        self._calls.append((element, method, read, every))

    async def _frame(self) -> None:
        texts, lamps, calls = [], self._collect_changes(self._lamps), self._due()
        if perf_counter() - self._read >= TEXT_INTERVAL_S:
            self._read = perf_counter()
            texts = self._collect_changes(self._texts)
        if not (texts or lamps or calls):
            return
        try:
            await self.run_method("show", texts, lamps, calls, timeout=ANSWER_TIMEOUT_S)
        except TimeoutError:
            self._shown.clear()

    def _collect_changes(self, all_of: dict[int, Any]) -> list[tuple[int, str | bool]]:
        """Return what has changed since it was sent, and forget elements that are gone."""
        changed: list[tuple[int, str | bool]] = []
        for key, (element, read) in tuple(all_of.items()):
            if element.is_deleted:
                del all_of[key]
                continue
            now = read()
            if self._shown.get(key) != now:
                self._shown[key] = now
                changed.append((key, now))
        return changed

    def _due(self) -> list[tuple[int, str, list]]:
        calls, now = [], perf_counter()
        for k, (element, method, read, every) in enumerate(self._calls):
            if now - self._called.get(k, 0.0) < every:
                continue
            values = read()
            if values is not None:
                self._called[k] = now
                calls.append((element.id, method, values))
        return calls


def on_single_click(button: ui.button, handler: Callable[[], Any]) -> ui.button:
    """Call `handler` for a click, and once for a double click, which many users make by habit; return the button."""
    return button.on("click", handler, js_handler="(e) => { if (e.detail < 2) emit() }")


def on_hold(button: ui.button, press: Callable[[], Any], release: Callable[[], Any]) -> None:
    """Call `press` when the button, or Enter or the space bar on it, goes down, and `release` when it goes up or is left."""
    button.style("touch-action: none; user-select: none")
    for event in ("pointerdown", "keydown.space.prevent", "keydown.enter.prevent"):
        button.on(event, press, args=[])
    for event in ("pointerup", "pointerleave", "pointercancel", "blur", "keyup"):
        button.on(event, release, args=[])


class TextLog(ui.element, component="lines.js"):
    """Last `max_lines` lines of a list that grows at its end. Scrolled to the end, it stays there.

    The lines are no elements of NiceGUI, which would compare all of them whenever something else on the page changes.
    """

    def __init__(self, updates: BrowserUpdates, max_lines: int):
        super().__init__()
        self._props["most"] = max_lines
        self._new: list[tuple[str, str, int]] = []
        self._max_lines = max_lines
        updates.call_method(self, "push", self._take_new)

    def append(self, text: str, kind: str = "", key: int = 0) -> None:
        """Add a line.

        Args:
            text: The line.
            kind: CSS class.
            key: Where it is not 0, the line takes the place of the last one if that had the same key.
        """
        if key and self._new and self._new[-1][2] == key:
            self._new.pop()
        self._new.append((text, kind, key))
        del self._new[: -self._max_lines]

    def empty(self) -> None:
        """Remove all lines."""
        self._new.clear()
        self.run_method("clear")

    def _take_new(self) -> list | None:
        new, self._new = self._new, []
        return [new] if new else None
