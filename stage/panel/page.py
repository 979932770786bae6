"""The page of the panel: its arrangement for wide and narrow screens, its toolbar, and the readout of the axes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import degrees
from typing import TYPE_CHECKING, Any

from nicegui import context, run, ui

from stage.errors import StageError
from stage.panel import saved_panel
from stage.panel.access_control import BrowserEventGate
from stage.panel.browser_updates import BrowserUpdates, on_single_click
from stage.panel.bus_console import BusConsole
from stage.panel.chip_panel import STYLE as CHIP_STYLE
from stage.panel.chip_panel import ChipCard
from stage.panel.fault_page import FaultPanel
from stage.panel.oscilloscope_page import OscilloscopeView
from stage.panel.procedure_page import ProcedurePanel, StopButtons
from stage.panel.session import UNPACED_SPEED
from stage.panel.stage_scene import build_scene
from stage.panel.tour_page import STYLE as TOUR_STYLE
from stage.panel.tour_page import TourView
from stage.support.identifier_escapes import escape_name

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.sim.axis import Axis


READOUT = ("position", "commanded", "error", "lost (full steps)")


def format_readout(unit: str, position: float, commanded: float, lost_steps: int) -> tuple[str, ...]:
    """Return the texts of READOUT for an axis: its position, the commanded position and their difference, and its lost steps.

    Args:
        unit: Unit of the axis, m or rad; the texts have mm or degrees.
        position: Position, in `unit`.
        commanded: Position that the pulses command, in `unit`.
        lost_steps: Lost full steps.
    """
    scale, symbol = (1e3, "mm") if unit == "m" else (degrees(1), "deg")
    lengths = (position, commanded, commanded - position)
    return (*(f"{length * scale:z.4f} {symbol}" for length in lengths), str(lost_steps))


def build_readout(panel: Panel, updates: BrowserUpdates) -> None:
    """Build the readout: for each axis a row with its motor, the texts of READOUT, and a lamp for each switch."""
    observer = panel.observer

    def read_cell(axis: Axis, column: int) -> str:
        view = observer.axes[axis.name]
        return format_readout(axis.unit, view.position, view.commanded, view.lost or 0)[column]

    def read_motor(axis: Axis) -> str:
        return axis.drive.motor.name

    def is_on(axis: Axis, switch: str) -> bool:
        return observer.axes[axis.name].switches[switch]

    with ui.element("div").classes("readout").props("data-test=readout"):
        for title in ("axis", *READOUT, "switches"):
            ui.label(title).classes(f"section {title}")
        for axis in panel.session.stage.axes.values():
            name = escape_name(axis.name)
            with ui.element("div").classes("axis").mark(f"axis-{name}"):
                ui.label(axis.name).classes("text-weight-bold").tooltip(type(axis.chip).__name__)
                motor = ui.element("div").classes("text-caption").props(f'data-test="motor-{name}"')
                updates.bind_text(motor, partial(read_motor, axis))
            for column, title in enumerate(READOUT):
                cell = ui.element("div").classes(f"number {title}").props(f'data-test="{title.split()[0]}-{name}"')
                updates.bind_text(cell, partial(read_cell, axis, column))
            with ui.element("div").classes("switches"):
                for switch in axis.switches.as_dict():
                    lamp = ui.label(switch.replace("_plus", "+").replace("_minus", "-")).classes("lamp")
                    updates.bind_lamp(lamp.props(f'data-test="switch-{name}-{switch}"'), partial(is_on, axis, switch))


SPEEDS = {speed: f"{speed:g} x" for speed in (0.01, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0)} | {UNPACED_SPEED: "full speed"}
REWIND_CHOICES_S = (0.1, 1.0, 5.0, 30.0)
MIN_ACHIEVED_SPEED_SHARE = 0.95  # of the speed that was requested: the page reports less
FILES = {
    "panel.zip": ("everything, to go on from here", "panel"),
    "program.py": ("the program as Python", "program"),
    "program.c": ("the program as C", "c"),
    "test_program.py": ("the program as a test", "test_program"),
}
"""File -> title and mark of its item in the menu that saves."""


class Toolbar:
    """Row at the top of the page: time, the action under way, stop, the program, the controls, files, and how the page looks."""

    def __init__(self, panel: Panel, updates: BrowserUpdates, gate: BrowserEventGate):
        session = self._session = panel.session
        self._panel, self._gate = panel, gate
        ui.label("PulseStage").classes("text-weight-bold q-mr-sm gt-xs")
        with _build_icon_button("fast_rewind", "rewind simulated time", "back") as rewind, ui.menu():
            for seconds in REWIND_CHOICES_S:
                item = ui.menu_item(f"rewind by {seconds:g} s", partial(self._go_back, seconds))
                item.props(f"data-test=back-{seconds:g}")
        gate.require_driving_rights(rewind)
        self._play = _build_icon_button("pause", "pause or resume simulated time", "play", self._toggle_pause)
        gate.require_controls(self._play)
        step = _build_icon_button("skip_next", "one physics step", "step").on_click(lambda: session.run_physics_steps())
        gate.require_driving_rights(step)
        select = ui.select(SPEEDS, value=find_nearest_speed(session.speed), on_change=self._set_speed)
        select.props("dense dark borderless options-dense aria-label='simulated seconds a second' data-test=speed")
        gate.require_controls(select)
        clock = ui.element("div").classes("number")
        clock.props("data-test=time role=timer aria-label='simulated time'")
        updates.bind_text(clock, lambda: f"{session.view.time:.4f} s")
        pace = ui.element("div").classes("number text-caption ellipsis").props("data-test=pace")
        updates.bind_text(pace, self._describe_pace)
        ui.space()
        self._action = ui.label().classes("text-caption ellipsis").props("data-test=doing role=status")
        self._abandon = _build_icon_button(
            "close", "give up this action; the chips go on", "abandon", session.stop_actions
        )
        gate.require_driving_rights(self._abandon)
        self._recover = on_single_click(ui.button("back to a good state"), lambda: run.io_bound(session.recover))
        gate.require_driving_rights(self._recover.props("dense no-caps color=negative data-test=recover"))
        self._program = ui.label().classes("text-caption ellipsis").props("data-test=program role=status")
        self._take_over = on_single_click(ui.button(), self._toggle_program)
        gate.require_controls(self._take_over.props("dense no-caps color=orange-9 data-test=take-over"))
        self._build_controls_button(context.client.id)
        if session.stage.axes:
            gate.require_driving_rights(StopButtons(session))
        self.tour_button = _build_icon_button("explore", "the tour", "tour")
        with _build_icon_button("save_alt", "save and share", "share"), ui.menu():
            for file, (title, mark) in FILES.items():
                ui.menu_item(title, partial(self._save_file, file)).tooltip(file).props(f"data-test=save-{mark}")
        dark = ui.dark_mode(None)
        _build_icon_button("contrast", "light or dark", "dark", lambda: _cycle_brightness(dark))
        dialog = self._build_power_up_dialog()
        power = _build_icon_button("power_settings_new", "power-up", "reset", dialog.open)
        for element in (power, dialog):
            gate.require_driving_rights(element)
        ui.timer(0.1, self._update)

    def _build_controls_button(self, client_id: str) -> None:
        controls = self._panel.controls
        self._controls = on_single_click(ui.button(), lambda: controls.give_controls_to(client_id))
        self._controls.props("flat dense no-caps color=white data-test=controls")
        context.client.on_connect(lambda: controls.add_browser(client_id))
        context.client.on_disconnect(lambda: controls.disconnect_browser(client_id))
        context.client.on_delete(lambda: controls.delete_browser(client_id))

    def _build_power_up_dialog(self) -> ui.dialog:
        """Build the question that the button for power-up asks."""

        async def power_up() -> None:
            dialog.close()
            await run.io_bound(self._session.reset)

        with ui.dialog() as dialog, ui.card():
            ui.label("Power up again?").classes("text-weight-bold")
            ui.label(
                "Time begins at 0 s, and chips and carriages are as at first. Loads and faults of the machine stay."
            )
            with ui.row().classes("w-full justify-end"):
                ui.button("Cancel", on_click=dialog.close).props("flat no-caps data-test=reset-cancel")
                ui.button("Power up", on_click=power_up).props("no-caps color=deep-orange-9 data-test=reset-confirm")
        return dialog

    def _toggle_pause(self) -> None:
        self._session.paused = not self._session.paused

    def _set_speed(self, event: Any) -> None:
        self._session.speed = event.value

    def _toggle_program(self) -> None:
        if self._session.program_suspended:
            self._session.resume_program()
        else:
            self._session.suspend_program()

    async def _go_back(self, seconds: float) -> None:
        try:
            await run.io_bound(self._session.go_back, seconds)
        except StageError as error:
            ui.notify(str(error), type="warning", multi_line=True)

    async def _save_file(self, file: str) -> None:
        try:
            if file == "panel.zip":
                data = await run.io_bound(saved_panel.pack_panel, self._panel) or b""
            else:
                data = ((await run.io_bound(saved_panel.format_program, self._panel, file)) or "").encode()
        except StageError as error:
            ui.notify(str(error), type="negative", multi_line=True)
        else:
            ui.download.content(data, file)

    def _describe_pace(self) -> str:
        speed, achieved = self._session.speed, self._session.view.achieved_speed
        if self._session.paused:
            return "stands still"
        return f"{achieved:.2f} x" + (
            ", cannot keep up" if speed != UNPACED_SPEED and achieved < MIN_ACHIEVED_SPEED_SHARE * speed else ""
        )

    def _update(self) -> None:
        session, view = self._session, self._session.view
        self._play.props(f"icon={'play_arrow' if session.paused else 'pause'}")
        self._action.text = view.trouble or view.action
        self._action.classes(**{"add" if view.trouble else "remove": "trouble"})
        self._abandon.set_visibility(bool(view.action))
        self._recover.set_visibility(bool(view.trouble))
        program, is_taken = session.program, session.program_suspended
        driving = f"{program} has the stage" if program and not is_taken else program
        self._program.text = f"{program} waits" if session.program_waits else driving
        self._take_over.text = "Give back" if is_taken else "Take over"
        self._take_over.set_visibility(bool(program))
        self._gate.update_inert_elements()
        watching = self._panel.controls.browser_count
        others = f"{watching} watching" if watching > 1 else ""
        self._controls.text = others if self._gate.has_controls else "Take the controls"
        self._controls.set_visibility(bool(self._controls.text))


def _build_icon_button(icon: str, label: str, mark: str, handler: Callable[[], Any] | None = None) -> ui.button:
    """Build a button of the toolbar. A button that has a menu needs no handler."""
    button = ui.button(icon=icon)
    if handler is not None:
        on_single_click(button, handler)
    return button.props(f"flat dense color=white aria-label='{label}' data-test={mark}").tooltip(label)


def find_nearest_speed(speed: float) -> float:
    """Return the speed of the page's list (SPEEDS) that is nearest to `speed`."""
    return speed if speed in SPEEDS else min(SPEEDS, key=lambda listed: abs(min(listed, 1e9) - speed))


def _cycle_brightness(dark: ui.dark_mode) -> None:
    """Switch the page from the browser's preference to dark, from dark to light, or from light to the preference."""
    dark.value = {None: True, True: False, False: None}[dark.value]


def build_page(panel: Panel) -> None:
    """Build the page of a panel for one browser."""
    ui.add_css(STYLE + CHIP_STYLE + TOUR_STYLE)
    ui.colors(primary=PRIMARY)
    updates, gate = BrowserUpdates(), BrowserEventGate(panel, ui.context.client)
    axes = list(panel.session.stage.axes)
    with ui.header().classes("items-center"):
        toolbar = Toolbar(panel, updates, gate)
    procedures = None
    with ui.element("div").classes("panel"):
        with ui.element("div").classes("bench"):
            with ui.element("div").classes("machine").props("data-test=machine"):
                build_scene(panel, updates)
                build_readout(panel, updates)
            if axes:
                OscilloscopeView(panel, updates)
        with ui.element("div").classes("desk"):
            with ui.element("div").classes("controls") as controls:
                if axes:
                    procedures = ProcedurePanel(panel, axes)
            gate.require_driving_rights(controls)
            with ui.element("div") as faults:
                if axes:
                    FaultPanel(panel, axes)
            gate.require_controls(faults)
            with ui.element("div").classes("chips") as chips:
                BusConsole(panel, updates)
                for k in range(len(panel.observer.traces)):
                    ChipCard(panel, updates, k)
            gate.require_driving_rights(chips)
    if procedures is not None:
        TourView(panel, gate, procedures, toolbar.tour_button)


PRIMARY = "#2f74b5"  # white on it, and it on white, has a contrast of 4.9
STYLE = """
html { scroll-padding-top: 60px }
.body--light { background: #f2f4f7 }
.body--dark .text-primary { --q-primary: #7db6ea }
.panel .q-btn--dense:not(.q-btn--round), .stops .q-btn { padding: 3px 10px }
.panel .q-btn-toggle .q-btn { min-width: 34px }
.panel .nicegui-card { gap: 8px; padding: 10px 12px; box-shadow: none; border: 1px solid #8884; border-radius: 8px }
.report:empty, .trace:empty { display: none }
[inert] { opacity: 0.55 }
.trouble { color: #ffd0c8; font-weight: 600 }
.section { font-size: 11px; text-transform: uppercase; letter-spacing: .06em; opacity: .7 }
.q-header { gap: 6px; padding: 4px 12px; min-height: 52px; flex-wrap: nowrap }
.q-header > .ellipsis { min-width: 0; flex-shrink: 9 }
.stops { display: flex; gap: 6px; flex-shrink: 0 }
.view { position: absolute; top: 6px; right: 6px; opacity: 0.8 }
.nicegui-content { padding: 0 }
.panel { display: grid; grid-template-columns: minmax(0, 1.2fr) minmax(0, 1fr); gap: 10px; padding: 10px; width: 100% }
.bench, .desk, .chips, .machine { display: flex; flex-direction: column; gap: 10px; min-width: 0 }
.bench { position: sticky; top: 62px; align-self: start; height: calc(100vh - 72px); overflow-y: auto }
.machine { flex: 1 0 auto }
.scene-box { flex: 1 0 200px; position: relative; min-height: 200px }
.scene { position: absolute !important; inset: 0; border-radius: 8px; overflow: hidden }
.readout { display: grid; grid-template-columns: max-content repeat(4, auto) minmax(0, max-content); gap: 4px 14px;
  align-items: center; justify-content: space-between; padding: 0 4px; font-size: 13px }
.readout .axis { line-height: 1.2 } .readout .axis .text-caption { font-size: 10px; line-height: 1.2 }
.readout .number, .readout .section:not(.axis):not(.switches) { text-align: right } .readout .number { white-space: nowrap }
.readout .number { font-weight: 400 } .readout .number.position { font-weight: 700 }
.lamp { display: inline-flex; align-items: center; gap: 4px; margin-right: 10px; font-size: 12px; white-space: nowrap }
.lamp::before { content: ""; width: 10px; height: 10px; border-radius: 50%; background: #8884; box-shadow: inset 0 0 2px #000a }
.body--dark .lamp:not(.on)::before { background: #999a }
.lamp.on::before { background: #ffb020; box-shadow: 0 0 6px #ffb020 }
.form { display: grid; grid-template-columns: repeat(auto-fill, minmax(104px, 1fr)); gap: 8px; width: 100% }
.former { opacity: .6 }
.pattern svg { max-width: 100%; height: auto; background: #fff; border-radius: 6px }
.number { font-variant-numeric: tabular-nums; font-family: ui-monospace, monospace }
@media (max-width: 1200px) { .readout { column-gap: 8px; font-size: 12px }
  .readout { grid-template-columns: max-content repeat(3, auto) minmax(0, max-content) }
  .readout .commanded, .scope .section { display: none } .scope .no-wrap { gap: 6px; flex-wrap: wrap }
  .scope .scope-state { order: 1; flex: 0 0 100% } .lamp { margin-right: 6px } }
@media (max-width: 900px) {
  html { scroll-padding-top: 0; scroll-padding-bottom: 60px }
  .q-header { position: absolute; flex-wrap: wrap }
  .panel { display: flex; flex-direction: column; padding-bottom: 64px }
  .bench, .desk { display: contents }
  .machine { order: -3; flex: none } .controls { order: -2 } .scope { order: -1 }
  .scene-box { flex: none; height: 250px }
  .stops { position: fixed; left: 0; right: 0; bottom: 0; padding: 8px 12px; background: #0006; backdrop-filter: blur(6px) }
  .stops .q-btn { flex: 1; min-height: 40px }
  .panel .q-tab { padding: 0 8px }
}
@media (max-width: 600px) { .readout { grid-template-columns: repeat(4, auto) } .readout .section.switches { display: none }
  .readout .switches { grid-column: 1 / -1 } .q-header > :nth-child(1) { display: none }
  .q-header { gap: 0 3px } .q-header > .q-space { flex-basis: 100% } }
"""
