"""The front panel of each chip, made from its register map."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

if TYPE_CHECKING:
    from stage.panel.server import Panel


def build(panel: Panel) -> None:
    stage = panel.session.stage
    for axis in stage.axes.values():
        with ui.expansion(f"{axis.name}: {axis.chip.MAP.title}", value=axis.index == 0).classes("w-full"):
            for register in axis.chip.MAP.registers:
                ui.label(f"{register.name}  {register.text}")
