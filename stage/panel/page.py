"""The page of the panel: its arrangement, its toolbar, a card for each axis, and the tour."""

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
from stage.panel.procedure_page import ProcedurePanel
from stage.panel.session import FREE
from stage.panel.stage_scene import build_scene
from stage.panel.tour import STEPS, Tour
from stage.support.identifier_escapes import escape_name

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.sim.axis import Axis


def format_position(unit: str, position: float, commanded: float, lost_steps: int) -> str:
    """Return lines with the position of an axis in mm or degrees, the commanded position, their difference, and the lost steps.

    Args:
        unit: Unit of the axis, m or rad.
        position: Position, in `unit`.
        commanded: Position that the pulses command, in `unit`.
        lost_steps: Lost full steps.
    """
    scale, symbol = (1e3, "mm") if unit == "m" else (degrees(1), "deg")
    return (
        f"position   {position * scale:z10.4f} {symbol}\n"
        f"commanded  {commanded * scale:z10.4f} {symbol}\n"
        f"error      {(commanded - position) * scale:z10.4f} {symbol}\n"
        f"lost steps {lost_steps:10d}"
    )


class AxisCard:
    """Card of one axis: its motor, its position, and a lamp for each switch."""

    def __init__(self, panel: Panel, updates: BrowserUpdates, axis: Axis):
        self._observer, self._axis = panel.observer, axis
        name = escape_name(axis.name)
        with ui.card().classes("col q-pa-sm").style("min-width: 205px").mark(f"axis-{name}"):
            ui.label(f"{axis.name}  {type(axis.chip).__name__}").classes("text-weight-bold")
            motor = ui.element("div").classes("text-caption").props(f'data-test="motor-{name}"')
            updates.show_text(motor, lambda: axis.drive.motor.name)
            place = ui.element("div").classes("number").style("white-space: pre; font-size: 12px")
            updates.show_text(place.props(f'data-test="place-{name}"'), self._describe_position)
            with ui.row().classes("q-gutter-none"):
                for switch in axis.switches.as_dict():
                    lamp = ui.label(switch.replace("_plus", "+").replace("_minus", "-")).classes("lamp")
                    updates.show_lamp(lamp.props(f'data-test="switch-{name}-{switch}"'), partial(self._is_on, switch))

    def _describe_position(self) -> str:
        view = self._observer.axes[self._axis.name]
        return format_position(self._axis.unit, view.position, view.commanded, view.lost or 0)

    def _is_on(self, switch: str) -> bool:
        return self._observer.axes[self._axis.name].switches[switch]


class TourView:
    """Tour in one browser. It begins when the user unfolds it, and ends when the user folds it again."""

    def __init__(self, panel: Panel):
        self._session = panel.session
        self._tour: Tour | None = None
        fold = ui.expansion("A tour in six steps", icon="explore").classes("w-full").props("data-test=tour")
        with fold:
            self._bar = ui.linear_progress(0.0, show_value=False)
            self._title = ui.label().classes("text-weight-bold q-mt-sm")
            self._title.props("data-test=tour-title aria-live=polite")
            self._task = ui.label().props("data-test=tour-task")
            self._sheet = ui.label().classes("text-caption q-mt-xs")
            self._button = ui.button("Skip", on_click=self._skip_step).props("flat dense no-caps data-test=tour-skip")
        fold.on_value_change(lambda event: self._begin_tour() if event.value else self._end_tour())
        context.client.on_disconnect(self._end_tour)
        ui.timer(0.2, self._update)

    def _begin_tour(self) -> None:
        if self._tour is None:
            self._tour = Tour(self._session)

    def _end_tour(self) -> None:
        if self._tour is not None:
            self._tour.close()
            self._tour = None

    def _skip_step(self) -> None:
        """Skip the current step, or begin again if all steps are done."""
        if self._tour is not None and self._tour.step is not None:
            self._tour.skip()
        elif self._tour is not None:
            self._end_tour()
            self._begin_tour()

    def _update(self) -> None:
        if self._tour is None:
            return
        number, step = self._tour.number, self._tour.step
        self._button.text = "Skip" if step else "Begin again"
        self._bar.value = number / len(STEPS)
        self._title.text = (
            f"{number + 1} of {len(STEPS)}: {step.title}" if step else "That was all. The rest is in the data sheets."
        )
        self._task.text = step.task if step else ""
        self._sheet.text = f"In data sheets: {step.sheet}" if step else ""


SPEEDS = {speed: f"{speed:g} x" for speed in (0.01, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0)} | {FREE: "full speed"}
BACK_S = (0.1, 1.0, 5.0, 30.0)
MIN_ACHIEVED = 0.95  # of the speed that was requested: the page reports less
FILES = {
    "panel.zip": ("everything, to go on from here", "panel"),
    "program.py": ("the program as Python", "program"),
    "program.c": ("the program as C", "c"),
    "test_program.py": ("the program as a test", "test_program"),
}
"""File -> title and mark of its item in the menu that saves."""


class Toolbar:
    """Row at the top of the page: time, speed, the program, the controls, files, and how the page looks."""

    def __init__(self, panel: Panel, updates: BrowserUpdates, gate: BrowserEventGate):
        session = self._session = panel.session
        self._panel, self._gate = panel, gate
        ui.label("PulseStage").classes("text-weight-bold q-mr-sm gt-xs")
        with ui.row().classes("items-center q-gutter-none") as row:
            self._play = _build_icon_button("pause", "pause", "play", self._toggle_pause)
            select = ui.select(SPEEDS, value=find_nearest_speed(session.speed), on_change=self._set_speed)
            select.props("dense dark borderless options-dense aria-label='simulated seconds a second' data-test=speed")
        gate.require_controls(row)
        with ui.row().classes("items-center q-gutter-none") as row:
            _build_icon_button("skip_next", "one physics step", "step").on_click(lambda: session.single_step())
            with _build_icon_button("replay", "go back", "back"), ui.menu():
                for seconds in BACK_S:
                    item = ui.menu_item(f"{seconds:g} s back", partial(self._go_back, seconds))
                    item.props(f"data-test=back-{seconds:g}")
            _build_icon_button("restart_alt", "power-up", "reset", lambda: run.io_bound(session.reset))
        gate.require_driving_rights(row)
        clock = ui.element("div").classes("number q-ml-sm")
        clock.props("data-test=time role=timer aria-label='simulated time'")
        updates.show_text(clock, lambda: f"{session.view.time:.4f} s")
        pace = ui.element("div").classes("number q-ml-sm text-caption").props("data-test=pace")
        updates.show_text(pace, self._describe_pace)
        ui.space()
        self._action = ui.label().classes("text-caption ellipsis").props("data-test=doing role=status")
        self._stop = _build_icon_button("stop", "stop this action; the chips go on", "abandon", session.stop_actions)
        gate.require_driving_rights(self._stop)
        self._recover = on_single_click(ui.button("back to a good state"), lambda: run.io_bound(session.recover))
        gate.require_driving_rights(self._recover.props("dense no-caps color=negative data-test=recover"))
        self._program = ui.label().classes("text-caption ellipsis").props("data-test=program role=status")
        self._take_over = on_single_click(ui.button(), self._toggle_program)
        gate.require_controls(self._take_over.props("dense no-caps color=orange-9 data-test=take-over"))
        self._build_controls_button(context.client.id)
        with _build_icon_button("save_alt", "save and share", "share"), ui.menu():
            for file, (title, mark) in FILES.items():
                ui.menu_item(title, partial(self._save_file, file)).tooltip(file).props(f"data-test=save-{mark}")
        dark = ui.dark_mode(None)
        _build_icon_button("contrast", "light or dark", "dark", lambda: _cycle_brightness(dark))
        ui.timer(0.1, self._update)

    def _build_controls_button(self, client_id: str) -> None:
        controls = self._panel.controls
        self._controls = on_single_click(ui.button(), lambda: controls.give_controls_to(client_id))
        self._controls.props("flat dense no-caps color=white data-test=controls")
        context.client.on_connect(lambda: controls.add_browser(client_id))
        context.client.on_disconnect(lambda: controls.remove_browser(client_id))
        context.client.on_delete(lambda: controls.forget_browser(client_id))

    def _toggle_pause(self) -> None:
        self._session.paused = not self._session.paused

    def _set_speed(self, event: Any) -> None:
        self._session.speed = event.value

    def _toggle_program(self) -> None:
        if self._session.program_suspended:
            self._session.give_back()
        else:
            self._session.take_over()

    async def _go_back(self, seconds: float) -> None:
        try:
            await run.io_bound(self._session.go_back, seconds)
        except StageError as error:
            ui.notify(str(error), type="warning", multi_line=True)

    async def _save_file(self, file: str) -> None:
        try:
            if file == "panel.zip":
                data = await run.io_bound(saved_panel.save_panel, self._panel) or b""
            else:
                data = ((await run.io_bound(saved_panel.write_program, self._panel, file)) or "").encode()
        except StageError as error:
            ui.notify(str(error), type="negative", multi_line=True)
        else:
            ui.download.content(data, file)

    def _describe_pace(self) -> str:
        speed, achieved = self._session.speed, self._session.view.achieved_speed
        if self._session.paused:
            return "stands still"
        return f"{achieved:.2f} x" + (", cannot keep up" if speed != FREE and achieved < MIN_ACHIEVED * speed else "")

    def _update(self) -> None:
        session, view = self._session, self._session.view
        self._play.props(f"icon={'play_arrow' if session.paused else 'pause'}")
        self._action.text = view.trouble or view.action
        self._action.classes(**{"add" if view.trouble else "remove": "trouble"})
        self._stop.set_visibility(bool(view.action))
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
    ui.add_css(STYLE + CHIP_STYLE)
    ui.colors(primary=PRIMARY)
    updates, gate = BrowserUpdates(), BrowserEventGate(panel, ui.context.client)
    axes = panel.session.stage.axes
    with ui.header().classes("items-center q-py-xs q-px-md"):
        Toolbar(panel, updates, gate)
    with ui.element("div").classes("panel"):
        with ui.element("div").classes("machine"):
            build_scene(panel, updates)
            with ui.row().classes("w-full"):
                for axis in axes.values():
                    AxisCard(panel, updates, axis)
            if axes:
                OscilloscopeView(panel, updates)
        with ui.element("div").classes("desk"):
            TourView(panel)
            with ui.element("div").classes("desk") as procedures:
                if axes:
                    ProcedurePanel(panel, list(axes))
            gate.require_driving_rights(procedures)
            with ui.element("div").classes("desk") as faults:
                if axes:
                    FaultPanel(panel, list(axes))
            gate.require_controls(faults)
            with ui.element("div").classes("desk") as chips:
                BusConsole(panel, updates)
                for k in range(len(panel.observer.traces)):
                    ChipCard(panel, updates, k)
            gate.require_driving_rights(chips)


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
