"""The row on top: time, who has the controls, and how the page looks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from nicegui import context, run, ui

from stage.errors import StageError
from stage.panel import share
from stage.panel.live import Live
from stage.panel.session import FREE, Session

if TYPE_CHECKING:
    from stage.panel.gate import Gate
    from stage.panel.server import Panel

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


def build(panel: Panel, live: Live, gate: Gate) -> None:
    """Of one browser, which may use what its gate lets it."""
    session = panel.session
    ui.label("PulseStage").classes("text-weight-bold q-mr-sm gt-xs")
    with ui.row().classes("items-center q-gutter-none") as row:

        def toggle() -> None:
            session.paused = not session.paused

        play = _button("pause", "pause", toggle, "play")
        ui.select(SPEEDS, value=_nearest(session.speed), on_change=lambda e: setattr(session, "speed", e.value)).props(
            "dense dark borderless options-dense aria-label='simulated seconds a second' data-test=speed"
        )
    gate.machine(row)

    async def back(seconds: float) -> None:
        try:
            await run.io_bound(session.go_back, seconds)
        except StageError as error:
            ui.notify(str(error), type="warning", multi_line=True)

    with ui.row().classes("items-center q-gutter-none") as row:
        _button("skip_next", "one physics step", session.single_step, "step")
        with _button("replay", "go back", None, "back"), ui.menu():
            for seconds in BACK:
                ui.menu_item(f"{seconds:g} s back", partial(back, seconds)).props(f"data-test=back-{seconds:g}")
        _button("restart_alt", "power-up", lambda: run.io_bound(session.reset), "reset")
    gate.driving(row)
    clock = ui.element("div").classes("number q-ml-sm").props("data-test=time role=timer aria-label='simulated time'")
    pace = ui.element("div").classes("number q-ml-sm text-caption").props("data-test=pace")
    live.text(clock, lambda: f"{session.view.time:.4f} s")
    live.text(pace, lambda: _pace(session))
    ui.space()
    doing = ui.label().classes("text-caption ellipsis").props("data-test=doing role=status")
    stop = _button("stop", "stop this action; the chips go on", session.stop_actions, "abandon")
    gate.driving(stop)
    good = ui.button("back to a good state", on_click=lambda: run.io_bound(session.recover))
    gate.driving(good.props("dense no-caps color=negative data-test=recover"))
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
    button = ui.button(icon=icon, on_click=does if callable(does) else None)
    return button.props(f"flat dense color=white aria-label='{says}' data-test={name}").tooltip(says)


def _nearest(speed: float) -> float:
    return min(SPEEDS, key=lambda known: 0.0 if known == speed else abs(known - speed) if known != FREE else 1e9)


def _turn(dark: ui.dark_mode) -> None:
    """From what the browser prefers, to dark, to light."""
    dark.value = {None: True, True: False, False: None}[dark.value]


def _share(panel: Panel) -> None:
    """The menu that saves what was done."""
    programs = {
        "program.py": "the program as Python",
        "program.c": "the program as C",
        "test_program.py": "the program as a test",
    }

    async def keep(name: str) -> None:
        try:
            if name in programs:
                data = ((await run.io_bound(share.program, panel, name)) or "").encode()
            else:
                data = await run.io_bound(share.save, panel) or b""
        except StageError as error:
            ui.notify(str(error), type="negative", multi_line=True)
        else:
            ui.download.content(data, name)

    with _button("save_alt", "save and share", None, "share"), ui.menu():
        for name, title in {"panel.zip": "everything, to go on from here", **programs}.items():
            item = ui.menu_item(title, lambda name=name: keep(name)).tooltip(name)
            item.props(f"data-test=save-{name.partition('.')[0] if name != 'program.c' else 'c'}")


def _program(panel: Panel, gate: Gate) -> Callable[[], None]:
    """Which program has the stage, and the button by which one takes it over and gives it back; returns what looks again."""
    session = panel.session
    says = ui.label().classes("text-caption ellipsis").props("data-test=program role=status")

    def press() -> None:
        if session.taken_over:
            session.give_back()
        else:
            session.take_over()

    button = ui.button(on_click=press).props("dense no-caps color=orange-9 data-test=take-over")
    gate.machine(button)

    def look() -> None:
        name, taken, waits = session.program, session.taken_over, session.program_waits
        says.text = f"{name} waits" if waits else f"{name} has the stage" if name and not taken else name
        button.text = "Give back" if taken else "Take over"
        button.set_visibility(bool(name))

    return look


def _controls(panel: Panel, gate: Gate) -> Callable[[], None]:
    """The button of who has the controls; returns what looks again."""
    controls, me = panel.controls, context.client.id
    button = ui.button(on_click=lambda: controls.take(me)).props("flat dense no-caps color=white data-test=controls")
    context.client.on_connect(lambda: controls.come(me))
    context.client.on_disconnect(lambda: controls.go(me))
    context.client.on_delete(lambda: controls.forget(me))
    shown: list[object] = []

    def look() -> None:
        gate.refresh()
        mine = gate.mine
        state = [mine, controls.watching]
        if shown == state:
            return
        shown[:] = state
        button.text = (
            "Take the controls" if not mine else f"{controls.watching} watching" if controls.watching > 1 else ""
        )
        button.set_visibility(not mine or controls.watching > 1)

    return look
