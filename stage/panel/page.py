"""The page of the panel: what stands where, its toolbar, the stage in 3D, a card for each axis, and the tour."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import degrees
from typing import TYPE_CHECKING

from nicegui import context, run, ui

from stage.errors import StageError
from stage.panel import saved_panel
from stage.panel.access_control import EventGate
from stage.panel.browser_updates import BrowserUpdates, on_single_click
from stage.panel.bus_console import build_console
from stage.panel.chip_panel import STYLE as CHIP_STYLE
from stage.panel.chip_panel import build_chip_panels
from stage.panel.fault_page import build_fault_controls
from stage.panel.oscilloscope_page import build_oscilloscope
from stage.panel.procedure_page import build_procedures
from stage.panel.session import FREE, Session
from stage.panel.stage_scene import build_scene
from stage.panel.tour import STEPS, Tour
from stage.support.identifiers import escape_name

if TYPE_CHECKING:
    from stage.panel.access_control import EventGate
    from stage.panel.server import Panel
    from stage.sim.axis import Axis


def format_position(unit: str, position: float, commanded: float, lost: int) -> str:
    """Return where an axis is, in mm (degrees), and its lost steps."""
    scale, name = (1e3, "mm") if unit == "m" else (degrees(1), "deg")
    return (
        f"position   {position * scale:z10.4f} {name}\n"
        f"commanded  {commanded * scale:z10.4f} {name}\n"
        f"error      {(commanded - position) * scale:z10.4f} {name}\n"
        f"lost steps {lost:10d}"
    )


def build_axis_cards(panel: Panel, updates: BrowserUpdates) -> None:
    """Build a card for each axis: where it is, and its switches as lamps."""
    stage = panel.session.stage
    with ui.row().classes("w-full"):
        for axis in stage.axes.values():
            with ui.card().classes("col q-pa-sm").style("min-width: 205px").mark(f"axis-{escape_name(axis.name)}"):
                ui.label(f"{axis.name}  {type(axis.chip).__name__}").classes("text-weight-bold")
                motor = ui.element("div").classes("text-caption").props(f'data-test="motor-{escape_name(axis.name)}"')
                updates.show_text(motor, partial(_motor, axis))
                text = ui.element("div").classes("number").style("white-space: pre; font-size: 12px")
                updates.show_text(
                    text.props(f'data-test="place-{escape_name(axis.name)}"'), partial(_where, panel, axis)
                )
                with ui.row().classes("q-gutter-none"):
                    for name in axis.switches.as_dict():
                        lamp = ui.label(name.replace("_plus", "+").replace("_minus", "-")).classes("lamp")
                        updates.show_lamp(
                            lamp.props(f'data-test="switch-{escape_name(axis.name)}-{name}"'),
                            partial(_on, panel, axis.name, name),
                        )


def _motor(axis: Axis) -> str:
    return axis.drive.motor.name


def _where(panel: Panel, axis: Axis) -> str:
    seen = panel.observer.axes[axis.name]
    return format_position(axis.unit, seen.position, seen.commanded, seen.lost or 0)


def _on(panel: Panel, axis: str, switch: str) -> bool:
    return panel.observer.axes[axis].switches[switch]


def build_tour(panel: Panel) -> None:
    """Build the tour."""
    tour: list[Tour] = []
    with ui.expansion("A tour in six steps", icon="explore").classes("w-full").props("data-test=tour") as fold:
        bar = ui.linear_progress(0.0, show_value=False)
        title = ui.label().classes("text-weight-bold q-mt-sm").props("data-test=tour-title aria-live=polite")
        task = ui.label().props("data-test=tour-task")
        sheet = ui.label().classes("text-caption q-mt-xs")
        on = ui.button("Skip", on_click=lambda: skip())
        on.props("flat dense no-caps data-test=tour-skip")

    def skip() -> None:
        if tour and tour[0].step is None:
            end()
            open_or_close()
        for t in tour[:1] if on.text == "Skip" else ():
            t.skip()

    def open_or_close() -> None:
        if fold.value and not tour:
            tour.append(Tour(panel.session))
        elif not fold.value:
            end()

    def end() -> None:
        while tour:
            tour.pop().close()

    def look() -> None:
        if not tour:
            return
        number, step = tour[0].number, tour[0].step
        on.text = "Skip" if step else "Begin again"
        bar.value = number / len(STEPS)
        title.text = (
            f"{number + 1} of {len(STEPS)}: {step.title}" if step else "That was all. The rest is in the data sheets."
        )
        task.text = step.task if step else ""
        sheet.text = f"In data sheets: {step.sheet}" if step else ""

    fold.on_value_change(open_or_close)
    context.client.on_disconnect(end)
    ui.timer(0.2, look)


SPEEDS = {
    0.01: "0.01 x",
    0.1: "0.1 x",
    0.25: "0.25 x",
    0.5: "0.5 x",
    1.0: "1 x",
    2.0: "2 x",
    5.0: "5 x",
    FREE: "full speed",
}
BACK = (0.1, 1.0, 5.0, 30.0)  # s
LAGS = 0.95  # of the speed that was asked for: less is told


def build_toolbar(panel: Panel, updates: BrowserUpdates, gate: EventGate) -> None:
    """Build the row on top: time, who has the controls, and how the page looks."""
    session = panel.session
    ui.label("PulseStage").classes("text-weight-bold q-mr-sm gt-xs")
    with ui.row().classes("items-center q-gutter-none") as row:

        def toggle() -> None:
            session.paused = not session.paused

        play = _button("pause", "pause", toggle, "play")
        ui.select(SPEEDS, value=_nearest(session.speed), on_change=lambda e: setattr(session, "speed", e.value)).props(
            "dense dark borderless options-dense aria-label='simulated seconds a second' data-test=speed"
        )
    gate.guard_machine(row)

    async def back(seconds: float) -> None:
        try:
            await run.io_bound(session.go_back, seconds)
        except StageError as error:
            ui.notify(str(error), type="warning", multi_line=True)

    with ui.row().classes("items-center q-gutter-none") as row:
        _button("skip_next", "one physics step", None, "step").on_click(lambda: session.single_step())
        with _button("replay", "go back", None, "back"), ui.menu():
            for seconds in BACK:
                ui.menu_item(f"{seconds:g} s back", partial(back, seconds)).props(f"data-test=back-{seconds:g}")
        _button("restart_alt", "power-up", lambda: run.io_bound(session.reset), "reset")
    gate.guard_driving(row)
    clock = ui.element("div").classes("number q-ml-sm").props("data-test=time role=timer aria-label='simulated time'")
    pace = ui.element("div").classes("number q-ml-sm text-caption").props("data-test=pace")
    updates.show_text(clock, lambda: f"{session.view.time:.4f} s")
    updates.show_text(pace, lambda: _pace(session))
    ui.space()
    doing = ui.label().classes("text-caption ellipsis").props("data-test=doing role=status")
    stop = _button("stop", "stop this action; the chips go on", session.stop_actions, "abandon")
    gate.guard_driving(stop)
    good = on_single_click(ui.button("back to a good state"), lambda: run.io_bound(session.recover))
    gate.guard_driving(good.props("dense no-caps color=negative data-test=recover"))
    program = _program(panel, gate)
    mine = _controls(panel, gate)
    _share(panel)
    dark = ui.dark_mode(None)
    _button("contrast", "light or dark", lambda: _turn(dark), "dark")

    def look() -> None:
        view = session.view
        play.props(f"icon={'play_arrow' if session.paused else 'pause'}")
        doing.text = view.trouble or view.action
        program()
        doing.classes(**({"add": "trouble"} if view.trouble else {"remove": "trouble"}))
        stop.set_visibility(bool(view.action))
        good.set_visibility(bool(view.trouble))
        mine()

    ui.timer(0.1, look)


def _pace(session: Session) -> str:
    if session.paused:
        return "stands still"
    pace = session.view.achieved_speed
    late = session.speed != FREE and pace < LAGS * session.speed
    return f"{pace:.2f} x" + (", cannot keep up" if late else "")


def _button(icon: str, says: str, does: object, name: str) -> ui.button:
    button = ui.button(icon=icon)
    if callable(does):  # a menu opens by itself
        on_single_click(button, does)
    return button.props(f"flat dense color=white aria-label='{says}' data-test={name}").tooltip(says)


def _nearest(speed: float) -> float:
    return min(SPEEDS, key=lambda known: 0.0 if known == speed else abs(known - speed) if known != FREE else 1e9)


def _turn(dark: ui.dark_mode) -> None:
    """Switch from what the browser prefers to dark, to light."""
    dark.value = {None: True, True: False, False: None}[dark.value]


def _share(panel: Panel) -> None:
    """Build the menu that saves what was done."""
    programs = {
        "program.py": "the program as Python",
        "program.c": "the program as C",
        "test_program.py": "the program as a test",
    }

    async def keep(name: str) -> None:
        try:
            if name in programs:
                data = ((await run.io_bound(saved_panel.program, panel, name)) or "").encode()
            else:
                data = await run.io_bound(saved_panel.save, panel) or b""
        except StageError as error:
            ui.notify(str(error), type="negative", multi_line=True)
        else:
            ui.download.content(data, name)

    with _button("save_alt", "save and share", None, "share"), ui.menu():
        for name, title in {"panel.zip": "everything, to go on from here", **programs}.items():
            item = ui.menu_item(title, lambda name=name: keep(name)).tooltip(name)
            item.props(f"data-test=save-{name.partition('.')[0] if name != 'program.c' else 'c'}")


def _program(panel: Panel, gate: EventGate) -> Callable[[], None]:
    """Build what tells which program drives, and the button that takes over and gives back; return what updates both."""
    session = panel.session
    says = ui.label().classes("text-caption ellipsis").props("data-test=program role=status")

    def press() -> None:
        if session.taken_over:
            session.give_back()
        else:
            session.take_over()

    button = on_single_click(ui.button(), press).props("dense no-caps color=orange-9 data-test=take-over")
    gate.guard_machine(button)

    def look() -> None:
        name, taken, waits = session.program, session.taken_over, session.program_waits
        says.text = f"{name} waits" if waits else f"{name} has the stage" if name and not taken else name
        button.text = "Give back" if taken else "Take over"
        button.set_visibility(bool(name))

    return look


def _controls(panel: Panel, gate: EventGate) -> Callable[[], None]:
    """Build the button of the controls; return what updates it."""
    controls, me = panel.controls, context.client.id
    button = on_single_click(ui.button(), lambda: controls.take(me)).props(
        "flat dense no-caps color=white data-test=controls"
    )
    context.client.on_connect(lambda: controls.come(me))
    context.client.on_disconnect(lambda: controls.go(me))
    context.client.on_delete(lambda: controls.forget(me))
    shown: list[object] = []

    def look() -> None:
        gate.refresh()
        mine = gate.has_controls
        state = [mine, controls.watching]
        if shown == state:
            return
        shown[:] = state
        button.text = (
            "Take the controls" if not mine else f"{controls.watching} watching" if controls.watching > 1 else ""
        )
        button.set_visibility(not mine or controls.watching > 1)

    return look


def build_page(panel: Panel) -> None:
    """Build the page of one browser."""
    ui.add_css(STYLE + CHIP_STYLE)
    ui.colors(primary=PRIMARY)
    updates = BrowserUpdates()
    gate = EventGate(panel, ui.context.client)
    with ui.header().classes("items-center q-py-xs q-px-md"):
        build_toolbar(panel, updates, gate)
    with ui.element("div").classes("panel"):
        with ui.element("div").classes("machine"):
            build_scene(panel, updates)
            build_axis_cards(panel, updates)
            build_oscilloscope(panel, updates)
        with ui.element("div").classes("desk"):
            build_tour(panel)
            with ui.element("div").classes("desk") as drives:
                build_procedures(panel)
            gate.guard_driving(drives)
            with ui.element("div").classes("desk") as machine:
                build_fault_controls(panel)
            gate.guard_machine(machine)
            with ui.element("div").classes("desk") as drives:
                build_console(panel, updates)
                build_chip_panels(panel, updates)
            gate.guard_driving(drives)


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
