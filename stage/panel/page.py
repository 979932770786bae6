"""The page of the panel: what stands where. Each part is a file of its own with a `build`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from stage.panel import axes, chart, chips, console, forms, gate, guide, scene, touch, transport
from stage.panel.live import Live

if TYPE_CHECKING:
    from stage.panel.server import Panel


def build(panel: Panel) -> None:
    """One browser's page."""
    ui.add_css(STYLE + chips.STYLE)
    live = Live()
    controlled: list[ui.element] = []  # what is dead where somebody else has the controls
    with ui.header().classes("items-center q-py-xs q-px-md"):
        transport.build(panel, live, controlled)
    with ui.element("div").classes("panel"):
        with ui.element("div").classes("machine"):
            scene.build(panel, live)
            axes.build(panel, live)
            chart.build(panel, live)
        with ui.element("div").classes("desk") as desk:
            controlled.append(desk)
            guide.build(panel)
            forms.build(panel)
            touch.build(panel)
            console.build(panel, live)
            chips.build(panel, live)
    gate.guard(ui.context.client, panel.controls, controlled)


STYLE = """
[inert] { opacity: 0.55 }
.trouble { color: #ffd0c8; font-weight: 600 }
.view { position: absolute; top: 6px; right: 6px; opacity: 0.8 }
.nicegui-content { padding: 0 }
.panel { display: grid; grid-template-columns: minmax(0, 1.2fr) minmax(0, 1fr); gap: 12px; padding: 12px; width: 100% }
@media (max-width: 600px) { .panel .q-tab { padding: 0 8px } }
@media (max-width: 900px) { .panel { grid-template-columns: minmax(0, 1fr) } }
.machine, .desk { display: flex; flex-direction: column; gap: 12px; min-width: 0 }
.scene { width: 100%; height: 46vh; border-radius: 8px; overflow: hidden }
.lamp { display: inline-flex; align-items: center; gap: 4px; margin-right: 10px; font-size: 12px; white-space: nowrap }
.lamp::before { content: ""; width: 10px; height: 10px; border-radius: 50%; background: #8884; box-shadow: inset 0 0 2px #000a }
.lamp.on::before { background: #ffb020; box-shadow: 0 0 6px #ffb020 }
.pattern svg { max-width: 100%; height: auto; background: #fff; border-radius: 6px }
.number { font-variant-numeric: tabular-nums; font-family: ui-monospace, monospace }
"""
