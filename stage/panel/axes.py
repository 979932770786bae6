"""A card an axis: where it is, and its switches as lamps."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from nicegui import ui

from stage.identifiers import escape_name
from stage.panel.live import Live
from stage.panel.words import place

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.sim.axis import Axis


def build(panel: Panel, live: Live) -> None:
    stage = panel.session.stage
    with ui.row().classes("w-full"):
        for axis in stage.axes.values():
            with ui.card().classes("col q-pa-sm").style("min-width: 205px").mark(f"axis-{escape_name(axis.name)}"):
                ui.label(f"{axis.name}  {type(axis.chip).__name__}").classes("text-weight-bold")
                motor = ui.element("div").classes("text-caption").props(f'data-test="motor-{escape_name(axis.name)}"')
                live.text(motor, partial(_motor, axis))
                text = ui.element("div").classes("number").style("white-space: pre; font-size: 12px")
                live.text(text.props(f'data-test="place-{escape_name(axis.name)}"'), partial(_where, panel, axis))
                with ui.row().classes("q-gutter-none"):
                    for name in axis.switches.as_dict():
                        lamp = ui.label(name.replace("_plus", "+").replace("_minus", "-")).classes("lamp")
                        live.lamp(
                            lamp.props(f'data-test="switch-{escape_name(axis.name)}-{name}"'),
                            partial(_on, panel, axis.name, name),
                        )


def _motor(axis: Axis) -> str:
    return axis.drive.motor.name


def _where(panel: Panel, axis: Axis) -> str:
    seen = panel.look.axes[axis.name]
    return place(axis.unit, seen.position, seen.commanded, seen.lost or 0)


def _on(panel: Panel, axis: str, switch: str) -> bool:
    return panel.look.axes[axis].switches[switch]
