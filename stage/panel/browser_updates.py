"""`BrowserUpdates`: send all values of a page that change many times a second to a browser, in one message for each frame.

    updates = BrowserUpdates()
    updates.bind_text(element, lambda: f"{session.view.time:.4f} s")
    updates.bind_lamp(element, lambda: axis.switches.org)
    updates.call_method_repeatedly(chart, "run_chart_method",
    lambda: ["setOption", message])      a function that returns None sends nothing

An update by NiceGUI makes the browser compare the whole page, which takes about 50 ms if front panels are open: too slow for a
clock. The next message waits until the browser has drawn the last one, so a slow browser gets fewer frames, but no late ones.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

from nicegui import ui

FRAMES_PER_S = 25  # a second, at max_lines
TEXT_INTERVAL_S = 0.1  # s between texts: nobody reads faster
ANSWER_TIMEOUT_S = 10.0  # s: a browser that has not answered by then is sent everything again


class BrowserUpdates(ui.element, component="live.js"):
    """Sender of the changing texts, lamps and method calls of one browser. It reads the values in the server's thread.

    NiceGUI must not set the text of an element that is registered here.
    """

    def __init__(self) -> None:
        super().__init__()
        self._texts: dict[int, tuple[ui.element, Callable[[], str]]] = {}
        self._lamps: dict[int, tuple[ui.element, Callable[[], bool]]] = {}
        self._calls: list[tuple[ui.element, str, Callable[[], list | None], float]] = []
        self._sent_values: dict[int, str | bool] = {}
        self._called: dict[int, float] = {}
        self._read = 0.0
        ui.timer(1 / FRAMES_PER_S, self._send_frame)

    def bind_text(self, element: ui.element, read: Callable[[], str]) -> ui.element:
        """Update the text of an element to what `read()` returns, from now on; return the element."""
        self._texts[element.id] = element, read
        return element

    def bind_lamp(self, element: ui.element, read: Callable[[], bool]) -> ui.element:
        """Give an element the CSS class `on` while `read()` returns True, from now on; return the element."""
        self._lamps[element.id] = element, read
        return element

    def call_method_repeatedly(
        self, element: ui.element, method: str, read: Callable[[], list | None], interval_s: float = 0.0
    ) -> None:
        """Call a method of an element in the browser again and again, from now on.

        Args:
            element: The element.
            method: Name of its JavaScript method.
            read: Function that returns the arguments of the next call, or None for no call now.
            interval_s: Least time between two calls, real seconds.
        """
        self._calls.append((element, method, read, interval_s))

    async def _send_frame(self) -> None:
        texts, lamps, calls = [], self._collect_changes(self._lamps), self._list_due_calls()
        if perf_counter() - self._read >= TEXT_INTERVAL_S:
            self._read = perf_counter()
            texts = self._collect_changes(self._texts)
        if not (texts or lamps or calls):
            return
        try:
            await self.run_method("show", texts, lamps, calls, timeout=ANSWER_TIMEOUT_S)
        except TimeoutError:
            self._sent_values.clear()

    def _collect_changes(self, all_of: dict[int, Any]) -> list[tuple[int, str | bool]]:
        """Return the id and value of each element whose value has changed since it was sent; remove deleted elements."""
        changed: list[tuple[int, str | bool]] = []
        for key, (element, read) in tuple(all_of.items()):
            if element.is_deleted:
                del all_of[key]
                continue
            now = read()
            if self._sent_values.get(key) != now:
                self._sent_values[key] = now
                changed.append((key, now))
        return changed

    def _list_due_calls(self) -> list[tuple[int, str, list]]:
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
    """Call `handler` once for a click or a double click on a button; return the button. Many users double-click by habit."""
    return button.on("click", handler, js_handler="(e) => { if (e.detail < 2) emit() }")


def on_hold(button: ui.button, press: Callable[[], Any], release: Callable[[], Any]) -> None:
    """Call `press` when a user presses a button by mouse, Enter or space, and `release` when the user lets it go or leaves it."""
    button.style("touch-action: none; user-select: none")
    for event in ("pointerdown", "keydown.space.prevent", "keydown.enter.prevent"):
        button.on(event, press, args=[])
    for event in ("pointerup", "pointerleave", "pointercancel", "blur", "keyup"):
        button.on(event, release, args=[])


class TextLog(ui.element, component="lines.js"):
    """Scrolling list of the last `max_lines` lines. While a user has scrolled it to the end, it follows new lines.

    The lines are not elements of NiceGUI, which would compare all of them whenever something else on the page changes.
    """

    def __init__(self, updates: BrowserUpdates, max_lines: int):
        super().__init__()
        self._props["most"] = max_lines
        self._new: list[tuple[str, str, int]] = []
        self._max_lines = max_lines
        updates.call_method_repeatedly(self, "push", self._take_unsent_lines)

    def append(self, text: str, kind: str = "", key: int = 0) -> None:
        """Add a line.

        Args:
            text: The line.
            kind: CSS class of the line.
            key: If not 0, the line replaces the last line if both have the same key.
        """
        if key and self._new and self._new[-1][2] == key:
            self._new.pop()
        self._new.append((text, kind, key))
        del self._new[: -self._max_lines]

    def remove_all_lines(self) -> None:
        """Remove all lines."""
        self._new.clear()
        self.run_method("clear")

    def _take_unsent_lines(self) -> list | None:
        new, self._new = self._new, []
        return [new] if new else None
