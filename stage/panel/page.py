"""The page of the panel: what stands where. Each part is a file of its own with a `build`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from stage.panel import axes, chart, chips, console, forms, guide, scene, touch, transport
from stage.panel.gate import Gate
from stage.panel.live import Live

if TYPE_CHECKING:
    from stage.panel.server import Panel


def build(panel: Panel) -> None:
    """One browser's page."""
    ui.add_css(STYLE + chips.STYLE)
    ui.colors(primary=PRIMARY)
    live = Live()
    gate = Gate(panel, ui.context.client)
    with ui.header().classes("items-center q-py-xs q-px-md"):
        transport.build(panel, live, gate)
    with ui.element("div").classes("panel"):
        with ui.element("div").classes("machine"):
            scene.build(panel, live)
            axes.build(panel, live)
            chart.build(panel, live)
        with ui.element("div").classes("desk"):
            guide.build(panel)
            with ui.element("div").classes("desk") as drives:
                forms.build(panel)
            gate.driving(drives)
            with ui.element("div").classes("desk") as machine:
                touch.build(panel)
            gate.machine(machine)
            with ui.element("div").classes("desk") as drives:
                console.build(panel, live)
                chips.build(panel, live)
            gate.driving(drives)


PRIMARY = "#2f74b5"  # white on it, and it on white, has a contrast of 4.9
STYLE = """
html { scroll-padding-top: 72px }
.body--dark .text-primary { color: #7db6ea !important }
.panel .q-btn--dense:not(.q-btn--round) { padding: 3px 10px }
.panel .q-btn-toggle .q-btn { min-width: 34px }
[inert] { opacity: 0.55 }
.trouble { color: #ffd0c8; font-weight: 600 }
.view { position: absolute; top: 6px; right: 6px; opacity: 0.8 }
.nicegui-content { padding: 0 }
.panel { display: grid; grid-template-columns: minmax(0, 1.2fr) minmax(0, 1fr); gap: 12px; padding: 12px; width: 100% }
@media (max-width: 600px) {
  html { scroll-padding-top: 0 }
  .q-header { position: absolute }
  .panel .q-tab { padding: 0 8px }
}
@media (max-width: 900px) { .panel { grid-template-columns: minmax(0, 1fr) } }
.machine, .desk { display: flex; flex-direction: column; gap: 12px; min-width: 0 }
.scene { width: 100%; height: 46vh; border-radius: 8px; overflow: hidden }
.lamp { display: inline-flex; align-items: center; gap: 4px; margin-right: 10px; font-size: 12px; white-space: nowrap }
.lamp::before { content: ""; width: 10px; height: 10px; border-radius: 50%; background: #8884; box-shadow: inset 0 0 2px #000a }
.lamp.on::before { background: #ffb020; box-shadow: 0 0 6px #ffb020 }
.pattern svg { max-width: 100%; height: auto; background: #fff; border-radius: 6px }
.number { font-variant-numeric: tabular-nums; font-family: ui-monospace, monospace }
"""
