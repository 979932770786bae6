"""What whoever looks at a page may do: only he who has the controls gives orders, and while a program has the stage nobody drives
it from a page unless he takes it over. The server refuses the rest, whatever a page does. A page that shows its parts as dead is a
courtesy; what comes from a browser can be forged."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nicegui import Client, ui

    from stage.panel.server import Panel


class Gate:
    """Of one browser. From now on no event of a guarded element, or of what stands in one, is heard from it unless it may."""

    def __init__(self, panel: Panel, client: Client):
        self._panel, self._client = panel, client
        self._machine: list[ui.element] = []
        self._driving: list[ui.element] = []
        self._shown: tuple[bool, bool] | None = None
        self._hear = client.handle_event
        client.handle_event = self._hear_if_allowed  # type: ignore[method-assign]

    def machine(self, element: ui.element) -> None:
        """This is for who has the controls, also beside a program."""
        self._machine.append(element)

    def driving(self, element: ui.element) -> None:
        """This drives the stage, or changes its time."""
        self._driving.append(element)

    @property
    def mine(self) -> bool:
        """This browser has the controls."""
        return self._panel.controls.holder == self._client.id

    @property
    def drives(self) -> bool:
        """It may drive now."""
        session = self._panel.session
        return self.mine and (session.taken_over or not session.program)

    def refresh(self) -> None:
        """Parts that it may not use look so."""
        now = self.mine, self.drives
        if now == self._shown:
            return
        self._shown = now
        for elements, may in ((self._machine, now[0]), (self._driving, now[1])):
            for element in elements:
                element.props(**({"remove": "inert"} if may else {"add": "inert"}))

    def _hear_if_allowed(self, msg: dict) -> None:
        element = self._client.elements.get(msg.get("id", -1))
        if element is None:
            return
        above = list(element.ancestors(include_self=True))
        if any(e in self._driving for e in above) and not self.drives:
            return
        if any(e in self._machine for e in above) and not self.mine:
            return
        self._hear(msg)
