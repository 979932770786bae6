"""A page of a panel that somebody has opened, without a browser: its elements by their `data-test`, and the events of a browser."""

from __future__ import annotations

import asyncio
import json
import time
import urllib.request
from collections.abc import Callable
from itertools import count
from typing import Any

_number = count()


class Visitor:
    """Comes to a panel in the process of the tests. What it does goes through the server's own door for events, gate and all; it
    draws nothing. `said`: what `ui.notify` has shown; `sent`: downloads, (name, bytes); both oldest first."""

    def __init__(self, panel: Any, is_first_visit: bool = False):
        from nicegui import Client

        self.panel, self._loop = panel, panel._site.loop
        before = set(Client.instances)
        cookies = {} if is_first_visit else {"Cookie": "pulsestage_tour=seen"}
        urllib.request.urlopen(urllib.request.Request(panel.address, headers=cookies), timeout=10).read()
        (new,) = set(Client.instances) - before
        self.client = Client.instances[new]
        self.said: list[str] = []
        self.sent: list[tuple[str, Any]] = []
        self._socket = f"visitor-{next(_number)}"
        self.within(self._come)

    async def _come(self) -> None:
        enqueue = self.client.outbox.enqueue_message

        def handle_message(kind: str, data: Any, target: str) -> None:
            if kind == "notify":
                self.said.append(data["message"])
            if kind == "download":
                self.sent.append((data["filename"], data["src"]))
            if kind == "run_javascript" and "request_id" in data:  # a browser that has drawn says so
                answer = {"request_id": data["request_id"], "result": None}
                self._loop.call_later(0.005, self.client.handle_javascript_response, answer)
            enqueue(kind, data, target)

        self.client.outbox.enqueue_message = handle_message  # type: ignore[method-assign]
        await self.client.handle_handshake(self._socket, self._socket, None, self._socket, None)

    def within(self, what: Callable[[], Any]) -> Any:
        """`what()` in the server's loop; what it gives, or what its coroutine gives."""

        async def call() -> Any:
            result = what()
            return await result if asyncio.iscoroutine(result) else result

        return asyncio.run_coroutine_threadsafe(call(), self._loop).result(20)

    def all(self, name: Any) -> list[Any]:
        """The elements of that name, in the order in which they were made; an element itself is its own name."""
        if not isinstance(name, str):
            return [name]
        return [e for e in self._all() if e.props.get("data-test") == name]

    def _all(self) -> tuple[Any, ...]:
        return tuple(self.client.elements.values())

    def find(self, name: Any) -> Any:
        """The element of that name."""
        (element,) = self.all(name)
        return element

    def fire(self, name: Any, event: str, args: Any = None, of: int = 0) -> None:
        """An event of an element, as a browser sends it."""
        element = self.all(name)[of]
        for listener in tuple(element._event_listeners.values()):
            if listener.type == event:
                message = {"id": element.id, "listener_id": listener.id, "args": [json.dumps(args)]}
                self.within(lambda m=message: self.client.handle_event(m))

    def click(self, name: Any, of: int = 0) -> None:
        """The mouse, on a button."""
        self.fire(name, "click", {}, of)

    def put(self, name: Any, value: Any) -> None:
        """A control holds this from now on, as if somebody had typed or chosen it."""
        element = self.find(name)

        def put() -> None:
            with self.client:
                element.value = value

        self.within(put)

    def enter(self, name: Any, text: str) -> None:
        """Type into a field, and press Enter. A key comes first, as from a keyboard: what is typed is not shown over any more."""
        self.fire(name, "keydown", {"key": text[:1] or "Backspace"})
        self.put(name, text)
        self.fire(name, "keydown", {"key": "Enter"})

    def text(self, name: Any) -> str:
        """The words of an element."""
        return self.find(name).text

    def error(self, name: Any) -> str:
        """Return the error text at a field, or ""."""
        field = self.find(name)
        return (
            getattr(field, "error", None) or (field.props.get("error-message") if "error" in field.props else "") or ""
        )

    def until(self, condition: Callable[[], Any], seconds: float = 10.0) -> Any:
        """Wait until `condition()` is true, and return it."""
        end = time.monotonic() + seconds
        while not (last := condition()):
            assert time.monotonic() < end, f"not within {seconds:g} s; last: {last!r}; {self._shown()}"
            time.sleep(0.005)
        return last

    def _shown(self) -> str:
        fields = {e.props["data-test"]: e.props["error-message"] for e in self._all() if "error-message" in e.props}
        return f"report: {[e.text for e in self.all('report')]}, said: {self.said}, at fields: {fields}"

    def settled(self) -> None:
        """Wait until the loop has processed what an event started."""
        for _ in range(3):
            self.within(lambda: asyncio.sleep(0))

    def leave(self) -> None:
        """Close the page: gone, and not to come back."""

        def leave() -> None:
            self.client.handle_disconnect(self._socket)
            self.client._cancel_delete_task(self._socket)  # nobody waits whether he comes back
            self.client.delete()

        self.within(leave)
