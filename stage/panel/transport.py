"""The row of buttons on top: time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from stage.panel.session import FREE

if TYPE_CHECKING:
    from stage.panel.server import Panel

SPEEDS = {0.1: "0.1 x", 0.25: "0.25 x", 0.5: "0.5 x", 1.0: "1 x", 2.0: "2 x", 5.0: "5 x", FREE: "as fast as it goes"}


def build(panel: Panel) -> None:
    session = panel.session
    ui.label("PulseStage").classes("text-weight-bold q-mr-md")

    def toggle() -> None:
        session.paused = not session.paused

    play = ui.button(on_click=toggle).props("flat dense color=white").mark("play")
    ui.button(icon="skip_next", on_click=lambda: session.single_step()).props("flat dense color=white").tooltip(
        "one physics step"
    ).mark("step")
    ui.button(icon="replay_5", on_click=lambda: session.back(1.0)).props("flat dense color=white").tooltip(
        "back one second"
    )
    ui.button(icon="restart_alt", on_click=lambda: session.reset()).props("flat dense color=white").tooltip("power-up")
    ui.select(SPEEDS, value=1.0, on_change=lambda e: setattr(session, "speed", e.value)).props(
        "dense dark borderless options-dense"
    )
    clock = ui.label().classes("number q-ml-md").mark("time")
    pace = ui.label().classes("number q-ml-md text-caption")
    ui.space()
    doing = ui.label().classes("text-caption")

    def look() -> None:
        view = session.view
        play.props(f"icon={'play_arrow' if session.paused else 'pause'}")
        clock.text = f"{view.time:.3f} s"
        late = not session.paused and session.speed != FREE and view.pace < 0.95 * session.speed
        pace.text = "paused" if session.paused else f"{view.pace:.2f} x" + (" (behind)" if late else "")
        doing.text = view.trouble or view.doing

    ui.timer(0.1, look)
