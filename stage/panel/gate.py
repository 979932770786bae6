"""Whoever has not the controls gives no orders: the server refuses them, whatever a page does. A page that shows its parts as dead
is a courtesy; what comes from a browser can be forged."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nicegui import Client, ui

    from stage.panel.controls import Controls


def guard(client: Client, controls: Controls, controlled: Collection[ui.element]) -> None:
    """From now on no event of a controlled element, or of what stands in one, is heard from this browser unless it has the
    controls. `controlled` may grow."""
    hear = client.handle_event

    def hear_if_allowed(msg: dict) -> None:
        element = client.elements.get(msg.get("id", -1))
        if element is None:
            return
        if controls.holder == client.id or not any(e in controlled for e in element.ancestors(include_self=True)):
            hear(msg)

    client.handle_event = hear_if_allowed  # type: ignore[method-assign]
