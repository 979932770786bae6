"""A card an axis: where it is, and its switches as lamps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from stage.panel.words import place

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.sim.axis import Axis


def build(panel: Panel) -> None:
    stage = panel.session.stage
    with ui.row().classes("w-full"):
        for axis in stage.axes.values():
            with ui.card().classes("col q-pa-sm").mark(f"axis-{axis.name}"):
                ui.label(f"{axis.name}  {type(axis.chip).__name__}").classes("text-weight-bold")
                text = (
                    ui.label().classes("number").style("white-space: pre; font-size: 12px").mark(f"place-{axis.name}")
                )
                with ui.row().classes("q-gutter-none"):
                    lamps = {name: ui.label(name.replace("_plus", "+").replace("_minus", "-")).classes("lamp")
                             for name in axis.switches.as_dict()}  # fmt: skip
            ui.timer(0.1, lambda axis=axis, text=text, lamps=lamps: _look(panel, axis, text, lamps))


def _look(panel: Panel, axis: Axis, text: ui.label, lamps: dict[str, ui.label]) -> None:
    seen = panel.look.axes[axis.name]
    text.text = place(axis.unit, seen.position, seen.commanded, seen.lost or 0)
    for name, lamp in lamps.items():
        lamp.classes(add="on") if seen.switches[name] else lamp.classes(remove="on")
