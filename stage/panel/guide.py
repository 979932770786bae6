"""The tour on the page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import context, ui

from stage.panel.tour import STEPS, Tour

if TYPE_CHECKING:
    from stage.panel.server import Panel


def build(panel: Panel) -> None:
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
