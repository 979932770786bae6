"""The tour on the page: one card at a time, beside the part of the page that it speaks of. The first visit opens it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from nicegui import context, ui

from stage.panel.browser_updates import on_single_click
from stage.panel.tour import STEPS, Tour

if TYPE_CHECKING:
    from stage.panel.access_control import BrowserEventGate
    from stage.panel.procedure_page import ProcedurePanel
    from stage.panel.server import Panel


COOKIE = "pulsestage_tour"
VISIT_COOKIE_JS = f"document.cookie = '{COOKIE}=seen; path=/; max-age=31536000; samesite=strict'"
NEXT_THINGS = {
    "hands": ("Break something", "jam an axis, load it, cut a wire"),
    "chip-0": ("Drive the chip by hand", "its front panel, a register at a time"),
    "share": ("Keep what you did", "as a program in Python or C"),
}
"""Part of the page -> what to do there after the tour, and a few words about it."""


class TourCard(ui.element, component="tour_card.js"):
    """Card that stays beside a part of the page, and marks this part and a button. Both are named by their `data-test`."""

    def point_to(self, target: str, press: str = "") -> None:
        """Place the card beside `target`, and mark the button `press`."""
        self._props["target"], self._props["press"] = target, press
        self.update()


class TourView:
    """Tour in one browser. It begins at the first visit or with a button of the toolbar, and ends when the user closes it.

    Each card waits until the user has done its step, then confirms it and waits for "Next".
    """

    def __init__(self, panel: Panel, gate: BrowserEventGate, procedures: ProcedurePanel, button: ui.button):
        self._session, self._gate, self._procedures = panel.session, gate, procedures
        self._tour: Tour | None = None
        self._card_number, self._displayed = 0, (-1, False)
        with TourCard() as self._card:
            with ui.row().classes("w-full items-center no-wrap"):
                self._title = ui.label().classes("text-weight-bold col").props("data-test=tour-title aria-live=polite")
                close = ui.button(icon="close", on_click=self._end_tour)
                close.props("flat dense round size=sm aria-label='close the tour' data-test=tour-close")
            self._task = ui.label().props("data-test=tour-task")
            self._next_things = ui.column().classes("gap-1 q-mt-xs")
            with self._next_things:
                for part, (title, words) in NEXT_THINGS.items():
                    thing = ui.button(f"{title}: {words}", on_click=partial(self._show_part, part))
                    thing.props(f"flat dense no-caps align=left data-test=tour-then-{part}")
            with ui.row().classes("w-full items-center justify-between q-mt-sm"):
                self._bar = ui.linear_progress(0.0, show_value=False).classes("col")
                self._next = ui.button("Next", on_click=self._go_on).props(
                    "dense no-caps unelevated data-test=tour-next"
                )
                self._skip = ui.button("Skip", on_click=self._skip_step).props("flat dense no-caps data-test=tour-skip")
        self._card.set_visibility(False)
        on_single_click(button, self._toggle_tour)
        context.client.on_disconnect(self._end_tour)
        request = context.client.request
        self._is_first_visit = COOKIE not in (request.cookies if request else {})
        ui.timer(0.2, self._update)

    def _toggle_tour(self) -> None:
        (self._begin_tour if self._tour is None else self._end_tour)()

    def _begin_tour(self) -> None:
        self._tour, self._card_number, self._displayed = Tour(self._session), 0, (-1, False)
        self._card.set_visibility(True)
        ui.run_javascript(VISIT_COOKIE_JS)

    def _end_tour(self) -> None:
        if self._tour is not None:
            self._tour.close()
            self._tour = None
            self._card.point_to("")
            self._card.set_visibility(False)

    def _skip_step(self) -> None:
        """Skip the step of the card, or begin again if all steps are done."""
        if self._tour is None:
            return
        if self._tour.step is None and self._card_number == len(STEPS):
            self._end_tour()
            self._begin_tour()
        else:
            self._tour.skip()
            self._card_number = self._tour.number

    def _go_on(self) -> None:
        if self._tour is not None:
            self._card_number = self._tour.number

    def _show_part(self, part: str) -> None:
        """End the tour, and show a part of the page: open it, and scroll to it."""
        self._end_tour()
        ui.run_javascript(
            f"const part = document.querySelector('[data-test={part}]');"
            "part.scrollIntoView({block: 'center'});"
            "(part.querySelector('[aria-expanded=false]') ?? (part.matches('.q-btn') ? part : null))?.click()"
        )

    def _update(self) -> None:
        if self._is_first_visit and self._gate.may_drive:
            self._is_first_visit = False
            self._begin_tour()
        if self._tour is None:
            return
        number = self._card_number
        state = number, self._tour.number > number
        if state != self._displayed:
            self._displayed = state
            self._show_card(number, state[1])

    def _show_card(self, number: int, is_done: bool) -> None:
        """Show the card of a step, its confirmation, or the last card."""
        step = STEPS[number] if number < len(STEPS) else None
        self._bar.value = (number + is_done) / len(STEPS)
        self._next.set_visibility(is_done)
        self._skip.set_visibility(not is_done)
        self._skip.text = "Skip" if step else "Begin again"
        self._next_things.set_visibility(step is None)
        if step is None:
            self._title.text, self._task.text = "That was the tour. Three things to do next:", ""
            self._card.point_to("procedures")
        elif is_done:
            self._title.text, self._task.text = f"Done: {step.title}", f"In data sheets: {step.sheet}"
            self._card.point_to(step.shown_by)
        else:
            self._title.text, self._task.text = f"{number + 1} of {len(STEPS)}: {step.title}", step.task
            self._procedures.fill_in(step.form, step.texts)
            self._card.point_to(step.shown_by, f"go-{step.form}")


STYLE = """
.tour-card { position: fixed; z-index: 1500; width: 380px; padding: 10px 12px; border-radius: 10px;
  background: #fff; color: #1d2731; border: 2px solid #2f74b5; box-shadow: 0 6px 24px #0006 }
.body--dark .tour-card { background: #26313d; color: #e8edf2 }
.tour-target { outline: 3px solid #2f74b5; outline-offset: 2px; border-radius: 8px }
.tour-press { animation: tour-press 1.2s infinite }
@keyframes tour-press { 50% { box-shadow: 0 0 0 7px #2f74b588 } }
@media (prefers-reduced-motion: reduce) { .tour-press { animation: none; box-shadow: 0 0 0 5px #2f74b588 } }
@media (max-width: 900px) { .tour-card { left: 8px; right: 8px; bottom: 66px; width: auto } }
"""
