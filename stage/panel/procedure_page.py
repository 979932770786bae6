"""Procedures on the page: a form each, jog buttons and stop; the report beside, and its operation pattern."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui import background_tasks, run, ui

from stage.errors import RunTimeout, StageError
from stage.firmware.stop_reasons import UNWANTED_REASONS
from stage.panel.fault_controls import find_coupled_axes
from stage.panel.procedure_forms import FORMS, Field, Jog, ProcedureForm, draw_pattern, find_field, to_field_error
from stage.panel.session import ActionStopped

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.panel.session import Session


class Outcome(NamedTuple):
    """What came of a procedure.

    Attributes:
        text: The report, or what is under way.
        wrong: It did not do what was requested.
        picture: The operation pattern as SVG, or "".
    """

    text: str = ""
    wrong: bool = False
    picture: str = ""


NO_OUTCOME = Outcome()


class ProcedureReports:
    """Last outcome of each form. The panel has them, so they are in every browser, and after a reload."""

    def __init__(self, session: Session):
        self._session = session
        self._outcomes: dict[str, Outcome] = {}

    def last(self, form: str) -> Outcome:
        """Return the last outcome of a form, or what is under way."""
        return self._outcomes.get(form, NO_OUTCOME)

    def note(self, form: str, text: str, wrong: bool = False) -> Outcome:
        """Note an outcome of a form, and return it."""
        outcome = self._outcomes[form] = Outcome(text, wrong)
        return outcome

    async def perform(self, form: str, what: str, order: Callable[[Any], Any]) -> Any:
        """Have the session perform an action, and note what comes of it.

        Args:
            form: Name of the form.
            what: Name of the action, for people.
            run: What the stage's thread calls.

        Returns:
            The report, or None.

        Raises:
            StageError: It was not begun; nothing is noted then.
        """
        self.note(form, f"{what} ...")
        try:
            report = await asyncio.wrap_future(self._session.act(what, order))
        except ActionStopped:
            self.note(form, f"{what}: stopped.")
        except RunTimeout as error:
            self.note(form, f"{error}\n{getattr(error, 'report', '')}", wrong=True)
        except BaseException:
            self.note(form, "")
            raise
        else:
            outcome = self.note(form, str(report), wrong=not report.ok)
            background_tasks.create(self._draw(form, outcome, report))
            return report
        return None

    async def _draw(self, form: str, outcome: Outcome, report: Any) -> None:
        """Add the operation pattern, where there is one; the next procedure may have begun meanwhile."""
        if not hasattr(report, "plot"):
            return
        try:
            drawn = outcome._replace(picture=await run.io_bound(draw_pattern, report) or "")
        except StageError as error:
            drawn = outcome._replace(text=f"{outcome.text}\n{error}")
        if self._outcomes[form] is outcome:
            self._outcomes[form] = drawn


class OutcomeView:
    """Outcome of one form in one browser."""

    def __init__(self, reports: ProcedureReports):
        self._reports, self._outcomes = reports, NO_OUTCOME
        self._text = ui.label().classes("number").style("white-space: pre-wrap; font-size: 12px")
        self._text.props("data-test=report aria-live=polite role=status")
        self._picture = ui.html("", sanitize=False).classes("w-full pattern").props("data-test=pattern")

    def update(self, form: str) -> None:
        """Show the last outcome of this form."""
        outcome = self._reports.last(form)
        if outcome is self._outcomes:
            return
        self._outcomes = outcome
        self._text.text, self._picture.content = outcome.text, outcome.picture
        self._text.classes(**{"add" if outcome.wrong else "remove": "text-negative"})


def build_procedures(panel: Panel) -> None:
    """Build the forms of one browser."""
    axes = list(panel.session.stage.axes)
    if axes:
        Procedures(panel, axes)


class Procedures:
    """Forms of the axis that is selected, and the outcome of the one that is open."""

    def __init__(self, panel: Panel, axes: list[str]):
        self.session, self.reports, self.observer = panel.session, panel.reports, panel.observer
        self.axis = axes[0]
        self._open, self._go_buttons = "move", list[ui.button]()
        self._jog: Jog | None = None
        with ui.card().classes("w-full q-pa-sm").props('data-test=procedures role=group aria-label="Procedures"'):
            with ui.row().classes("w-full items-center q-gutter-xs"):
                ui.toggle(axes, value=self.axis, on_change=lambda e: self._choose(e.value)).props(
                    "dense no-caps data-test=procedure-axis"
                )
                ui.space()
                ui.button("stop", on_click=lambda: self._stop(False)).props(
                    "dense color=orange-9 no-caps data-test=stop"
                )
                ui.button("stop at once", on_click=lambda: self._stop(True)).props(
                    "dense color=negative no-caps data-test=stop-at-once"
                )
            self.box = ui.column().classes("w-full q-gutter-xs")
            self._outcome_view = OutcomeView(panel.reports)
        panel.controls.when_lost(ui.context.client.id, self._release)
        self._choose(self.axis)
        ui.timer(0.1, self._update)

    def _update(self) -> None:
        """Disable the buttons that begin a procedure while one is under way, whoever has begun it."""
        self._outcome_view.update(self._open)
        for button in self._go_buttons:
            button.set_enabled(not self.session.busy)

    def _choose(self, axis: str) -> None:
        self.axis = axis
        self._go_buttons.clear()
        stage = self.session.stage
        self.box.clear()
        with self.box:
            try:
                forms = [f for f in FORMS.values() if f.needs(stage, axis)]
                texts = {f.name: f.fields(stage, axis) for f in forms}
            except StageError as error:
                ui.label(str(error)).classes("text-negative")
                return
            if others := find_coupled_axes(stage, axis):
                names = " and ".join(others)
                text = f"{axis} carries one beam with {names}: alone it racks the beam. A line moves them together."
                ui.label(text).classes("text-caption").props("data-test=tied")
            if self._open not in (*texts, "jog"):
                self._open = "move"
            with ui.tabs().classes("w-full").props("dense no-caps inline-label align=left") as tabs:
                for form in forms:
                    ui.tab(form.name, form.title).props(f"data-test=tab-{form.name}")
                ui.tab("jog", "Jog").props("data-test=tab-jog")
            tabs.on_value_change(lambda e: setattr(self, "_open", e.value))
            with ui.tab_panels(tabs, value=self._open).classes("w-full").props("animated=false"):
                for form in forms:
                    with ui.tab_panel(form.name).classes("q-pa-xs"):
                        self._form(form, texts[form.name])
                with ui.tab_panel("jog").classes("q-pa-xs"):
                    self._jogging()

    def _form(self, form: ProcedureForm, fields: list[Field]) -> None:
        controls: dict[str, Any] = {}
        with ui.row().classes("w-full items-start q-gutter-xs"):
            for field in fields:
                controls[field.name] = build_entry(form.name, field)

            async def go() -> None:
                if self.session.busy:
                    return
                clear_errors(controls)
                values, axis = {name: c.value for name, c in controls.items()}, self.axis
                what = form.title if form.several else f"{form.title} {self.axis}"
                try:
                    order = form.prepare(self.session.stage, self.axis, values)
                    report = await self.reports.perform(form.name, what, order)
                    if form.finds_origin and report is not None and report.stopped_by not in UNWANTED_REASONS:
                        self.session.post(partial(self.observer.note_origin, axis))
                except StageError as error:
                    self._show_error(form.name, self._outcomes(error, controls, fields), fields, controls)

            button = ui.button("go", on_click=go).props(f"dense no-caps data-test=go-{form.name}").classes("q-mt-sm")
            self._go_buttons.append(button)
            for control in controls.values():
                if isinstance(control, ui.input):
                    control.on("keydown.enter", go)

    def _jogging(self) -> None:
        controls: dict[str, Any] = {}
        fields = [f for f in FORMS["move"].fields(self.session.stage, self.axis) if f.name in ("speed", "accel")]
        with ui.row().classes("w-full items-start q-gutter-xs"):
            for field in fields:
                controls[field.name] = build_entry("jog", field)
            for direction, sign in ((-1, "-"), (1, "+")):
                button = ui.button(f"{self.axis} {sign}").props(
                    f'no-caps data-test=jog-{"plus" if direction > 0 else "minus"} aria-label="jog {self.axis} {sign}, while held"'
                )
                button.style("touch-action: none; user-select: none; min-width: 72px")
                for event in ("pointerdown", "keydown.space.prevent", "keydown.enter.prevent"):
                    button.on(event, lambda e, d=direction: self._press(d, fields, controls))
                for event in ("pointerup", "pointerleave", "pointercancel", "blur", "keyup"):
                    button.on(event, lambda e: self._release())
        ui.label("runs while a button, Enter or the space bar is held").classes("text-caption")

    async def _press(self, direction: int, fields: list[Field], controls: dict[str, Any]) -> None:
        if self._jog is not None:
            return  # a key that repeats
        if self.session.busy:
            ui.notify(
                f"{self.session.view.action or 'a procedure'} is under way: wait, or stop it first.", type="warning"
            )
            return
        clear_errors(controls)
        texts = {n: c.value for n, c in controls.items()}
        try:
            jog = self._jog = Jog(self.session.stage.axes[self.axis], direction, texts)
            try:
                await self.reports.perform("jog", f"jog {self.axis}", jog.run)
            finally:
                self._release(jog)
        except StageError as error:
            self._show_error("jog", self._outcomes(error, controls, fields), fields, controls)

    def _release(self, jog: Jog | None = None) -> None:
        if self._jog is not None and jog in (None, self._jog):
            self._jog.release()
            if jog is not None:
                self._jog = None

    async def _stop(self, at_once: bool) -> None:
        """Bring all axes to rest, and end what is under way."""
        try:
            await asyncio.wrap_future(self.session.stop(at_once))
        except StageError as error:
            self.reports.note(self._open, str(error), wrong=True)

    def _outcomes(self, error: StageError, controls: dict[str, Any], fields: list[Field]) -> StageError:
        texts = {name: c.value for name, c in controls.items()}
        return to_field_error(error, self.session.stage.axes[self.axis], texts, fields)

    def _show_error(self, form: str, error: BaseException, fields: list[Field], controls: dict[str, Any]) -> None:
        """Show an error at the field that it is about, else below."""
        field = find_field(error, fields)
        if field:
            show_error_at(controls[field], error)
        else:
            self.reports.note(form, str(error), wrong=True)


def build_entry(form: str, field: Field) -> Any:
    """Return an input or a choice for a field."""
    props = f"dense outlined hide-bottom-space data-test={form}-{field.name}"
    if field.choices:
        control: Any = ui.select(list(field.choices), value=field.default, label=field.title)
        return control.props(f"{props} options-dense").style("min-width: 100px")
    control = ui.input(field.title, value=field.default).props(f'{props} suffix="{field.unit}" inputmode=decimal')
    return control.style("width: 118px")


def clear_errors(controls: dict[str, Any]) -> None:
    """Remove the errors at fields."""
    for control in controls.values():
        control.props(remove="error error-message")


def show_error_at(control: Any, error: BaseException) -> None:
    """Show an error at its field."""
    control.props(f"error error-message={_quoted(str(error))}")


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', "'") + '"'
