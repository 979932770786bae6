"""Procedures on the page: a form for each, jog and stop buttons, and the last report with its operation pattern."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui import background_tasks, run, ui

from stage.errors import RunTimeout, StageError
from stage.firmware.stop_reasons import UNWANTED_REASONS
from stage.panel.browser_updates import on_hold
from stage.panel.fault_controls import find_coupled_axes
from stage.panel.procedure_forms import (
    FORMS,
    FormField,
    Jog,
    ProcedureForm,
    find_field,
    list_jog_fields,
    render_operation_pattern_svg,
    to_field_error,
)
from stage.panel.session import ActionStopped

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.panel.session import Session
    from stage.sim.stage import Stage


class FormView:
    """Fields of a form in one browser.

    Args:
        name: Name of the form.
        fields: Fields of the form.

    Attributes:
        controls: Element of each field by the name of the field.
    """

    def __init__(self, name: str, fields: list[FormField]):
        self.name, self.fields = name, fields
        self.controls: dict[str, Any] = {field.name: self._build_control(field) for field in fields}

    def _build_control(self, field: FormField) -> Any:
        props = f"dense outlined hide-bottom-space data-test={self.name}-{field.name}"
        if field.choices:
            control: Any = ui.select(list(field.choices), value=field.default, label=field.title)
            return control.props(f"{props} options-dense")
        return ui.input(field.title, value=field.default).props(f'{props} suffix="{field.unit}" inputmode=decimal')

    @property
    def texts(self) -> dict[str, Any]:
        """Text of each field by its name."""
        return {name: control.value for name, control in self.controls.items()}

    def clear_errors(self) -> None:
        """Remove the errors at fields."""
        for control in self.controls.values():
            control.props(remove="error error-message")

    def show_error(self, error: BaseException) -> bool:
        """Show an error at the field that it concerns, and return whether this form has such a field."""
        name = find_field(error, self.fields)
        if name:
            text = str(error).replace("\\", "\\\\").replace('"', "'")
            self.controls[name].props(f'error error-message="{text}"')
        return bool(name)


class ProcedureOutcome(NamedTuple):
    """Outcome of a procedure: the text, the error and the picture that the page shows.

    Attributes:
        text: The report, or the name of the procedure while it is under way.
        has_failed: Whether the procedure did not do what was requested.
        picture: The operation pattern as SVG, or "".
        time: Simulated time of the outcome, s.
        undone: Reason for which the stage no longer has this outcome in its past, for people; "" if it has.
        was_stopped: Whether a user has stopped the procedure.
    """

    text: str = ""
    has_failed: bool = False
    picture: str = ""
    time: float = 0.0
    undone: str = ""
    was_stopped: bool = False


NO_OUTCOME = ProcedureOutcome()


class ProcedureOutcomes:
    """Last outcome of each form of a panel. All browsers show them, also after a reload of the page.

    After a power-up, or when somebody goes back in time, the outcomes of what has not happened any more are marked, and
    those of stopped procedures are removed.
    """

    def __init__(self, session: Session):
        self._session, self._time, self._rewinds = session, 0.0, 0
        self._outcomes: dict[str, ProcedureOutcome] = {}
        self._end_observing = session.call_after_pacing_intervals(self._mark_undone_outcomes)

    def close(self) -> None:
        """Stop observing the stage."""
        self._end_observing()

    def _mark_undone_outcomes(self, stage: Stage) -> None:
        before, self._time = self._time, stage.time
        if stage.time >= before:
            return
        undone = f"from before time went back to {stage.time:.3f} s" if stage.time else "from before the power-up"
        self._rewinds += 1
        for form, outcome in list(self._outcomes.items()):
            if outcome.was_stopped:
                self._outcomes[form] = NO_OUTCOME
            elif outcome.time > stage.time and outcome.text:
                self._outcomes[form] = outcome._replace(undone=undone)

    def find_outcome(self, form: str) -> ProcedureOutcome:
        """Return the last outcome of a form, or the outcome so far of the procedure that is under way."""
        return self._outcomes.get(form, NO_OUTCOME)

    def set_outcome(
        self, form: str, text: str, has_failed: bool = False, was_stopped: bool = False
    ) -> ProcedureOutcome:
        """Store the last outcome of a form, and return it."""
        time = self._session.view.time if text else 0.0
        outcome = self._outcomes[form] = ProcedureOutcome(text, has_failed, time=time, was_stopped=was_stopped)
        return outcome

    async def perform(self, form: str, title: str, action: Callable[[Any], Any]) -> Any:
        """Have the session perform an action, and store its outcome.

        Args:
            form: Name of the form.
            title: Name of the action, for people.
            action: Function that the stage's thread calls with the stage.

        Returns:
            The report, or None if the action was stopped or took too long.

        Raises:
            StageError: The action could not begin; the form then has no outcome.
        """
        self.set_outcome(form, f"{title} ...")
        rewinds = self._rewinds
        try:
            report = await asyncio.wrap_future(self._session.act(title, action))
        except ActionStopped:
            is_undone = self._rewinds != rewinds
            self.set_outcome(form, "" if is_undone else f"{title}: stopped.", was_stopped=not is_undone)
        except RunTimeout as error:
            self.set_outcome(form, f"{error}\n{getattr(error, 'report', '')}", has_failed=True)
        except BaseException:
            self.set_outcome(form, "")
            raise
        else:
            outcome = self.set_outcome(form, str(report), has_failed=not report.ok)
            background_tasks.create(self._add_picture(form, outcome, report))
            return report
        return None

    async def _add_picture(self, form: str, outcome: ProcedureOutcome, report: Any) -> None:
        """Add the operation pattern of a report to an outcome, if it is still the last one of its form."""
        if not hasattr(report, "plot"):
            return
        try:
            drawn = outcome._replace(picture=await run.io_bound(render_operation_pattern_svg, report) or "")
        except StageError as error:
            drawn = outcome._replace(text=f"{outcome.text}\n{error}")
        if self._outcomes[form] is outcome:
            self._outcomes[form] = drawn


class OutcomeView:
    """Part of the page that shows the last outcome of a form in one browser."""

    def __init__(self, reports: ProcedureOutcomes):
        self._reports, self._displayed = reports, NO_OUTCOME
        self._undone = ui.label().classes("report text-caption text-italic").props("data-test=undone")
        self._text = ui.label().classes("report number").style("white-space: pre-wrap; font-size: 12px")
        self._text.props("data-test=report aria-live=polite role=status")
        self._picture = ui.html("", sanitize=False).classes("w-full report pattern").props("data-test=pattern")

    def update(self, form: str) -> None:
        """Show the last outcome of a form."""
        outcome = self._reports.find_outcome(form)
        if outcome is self._displayed:
            return
        self._displayed = outcome
        self._undone.text = outcome.undone
        self._text.text, self._picture.content = outcome.text, outcome.picture
        self._text.classes(**{"add" if outcome.has_failed else "remove": "text-negative"})
        for element in (self._text, self._picture):
            element.classes(**{"add" if outcome.undone else "remove": "former"})


STOP_BUTTONS = {
    "stop": ("Stop motion", "all axes come to rest with a ramp, and the procedure ends", "deep-orange-9", False),
    "stop-at-once": ("Stop at once", "all axes come to rest without a ramp, and the procedure ends", "red-10", True),
}
"""Name for tests -> label, explanation and color of a button, and whether the axes stop without a ramp."""


class StopButtons(ui.element):
    """Buttons that stop all axes and end the procedure under way."""

    def __init__(self, session: Session):
        super().__init__("div")
        self._session = session
        with self.classes("stops"):
            for name, (label, explanation, color, at_once) in STOP_BUTTONS.items():
                button = ui.button(label, on_click=partial(self._stop, at_once)).tooltip(explanation)
                button.props(f"dense unelevated color={color} no-caps data-test={name}")

    async def _stop(self, at_once: bool) -> None:
        try:
            await asyncio.wrap_future(self._session.stop(at_once))
        except StageError as error:
            ui.notify(str(error), type="negative", multi_line=True)


class ProcedurePanel:
    """Part of the page with the forms of the selected axis, the jog buttons, and the outcome of the open form."""

    def __init__(self, panel: Panel, axes: list[str]):
        self.session, self.reports, self.observer = panel.session, panel.reports, panel.observer
        self.axis = axes[0]
        self._open, self._views = "move", dict[str, FormView]()
        self._go_buttons, self._reasons = list[ui.button](), list[ui.label]()
        self._jog: Jog | None = None
        with ui.card().classes("w-full q-pa-sm").props('data-test=procedures role=group aria-label="Procedures"'):
            with ui.row().classes("w-full items-center justify-between"):
                ui.label("Move the machine").classes("section")
                toggle = ui.toggle(axes, value=self.axis, on_change=lambda e: self._select_axis(e.value))
                toggle.props("dense no-caps data-test=procedure-axis")
            self._box = ui.column().classes("w-full gap-1")
            self._outcome_view = OutcomeView(panel.reports)
        panel.controls.call_when_controls_lost(ui.context.client.id, self._end_jog)
        self._select_axis(self.axis)
        ui.timer(0.1, self._update)

    def _update(self) -> None:
        """Show the last outcome, and disable the buttons that begin a procedure while any procedure is under way."""
        self._outcome_view.update(self._open)
        reason = self._explain_busy()
        for button in self._go_buttons:
            button.set_enabled(not reason)
        for label in self._reasons:
            label.text = reason

    def _explain_busy(self) -> str:
        """Return the reason for which no procedure can begin now, or "" if one can."""
        if not self.session.busy:
            return ""
        how = "resume time, or stop it" if self.session.paused else "stop it, or wait for its end"
        return f"{self.session.view.action or 'A procedure'} is under way: {how}."

    def fill_in(self, form: str, texts: Mapping[str, str]) -> None:
        """Open a form, if the selected axis has it, and put texts into its fields by name."""
        if form not in self._views:
            return
        self._tabs.value = form
        for field, control in self._views[form].controls.items():
            control.value = texts.get(field, control.value)

    def _select_axis(self, axis: str) -> None:
        self.axis = axis
        for items in (self._go_buttons, self._reasons, self._views):
            items.clear()
        stage = self.session.stage
        self._box.clear()
        with self._box:
            try:
                forms = {
                    form: form.list_fields(stage, axis) for form in FORMS.values() if form.is_available(stage, axis)
                }
            except StageError as error:
                ui.label(str(error)).classes("text-negative")
                return
            if others := find_coupled_axes(stage, axis):
                names = " and ".join(others)
                text = f"{axis} carries one beam with {names}: alone it racks the beam. A line moves them together."
                ui.label(text).classes("text-caption").props("data-test=tied")
            titles = {**{form.name: form.title for form in forms}, "jog": "Jog"}
            if self._open not in titles:
                self._open = "move"
            with ui.tabs().classes("w-full").props("dense no-caps inline-label align=left") as self._tabs:
                for name, title in titles.items():
                    ui.tab(name, title).props(f"data-test=tab-{name}")
            self._tabs.on_value_change(lambda e: setattr(self, "_open", e.value))
            with ui.tab_panels(self._tabs, value=self._open).classes("w-full").props("animated=false"):
                for form, fields in forms.items():
                    with ui.tab_panel(form.name).style("padding: 8px 0 0"):
                        self._build_form(form, fields)
                with ui.tab_panel("jog").style("padding: 8px 0 0"):
                    self._build_jog()

    def _build_form(self, form: ProcedureForm, fields: list[FormField]) -> None:
        with ui.element("div").classes("form"):
            view = self._views[form.name] = FormView(form.name, fields)
        with ui.row().classes("w-full items-center no-wrap gap-3 q-mt-sm"):
            begin = partial(self._begin_procedure, form, view)
            self._go_buttons.append(
                ui.button("go", on_click=begin).props(f"no-caps unelevated data-test=go-{form.name}")
            )
            self._reasons.append(ui.label().classes("text-caption").props(f"data-test=busy-{form.name} role=status"))
        for control in view.controls.values():
            if isinstance(control, ui.input):
                control.on("keydown.enter", begin)

    async def _begin_procedure(self, form: ProcedureForm, view: FormView) -> None:
        """Begin the procedure of a form, and show its outcome or its error."""
        if self.session.busy:
            return
        view.clear_errors()
        texts, axis = view.texts, self.axis
        title = form.title if form.is_for_several_axes else f"{form.title} {axis}"
        try:
            order = form.prepare(self.session.stage, axis, texts)
            report = await self.reports.perform(form.name, title, order)
            if form.finds_origin and report is not None and report.stopped_by not in UNWANTED_REASONS:
                self.session.post(partial(self.observer.reset_lost_steps, axis))
        except StageError as error:
            self._show_error(error, view)

    def _build_jog(self) -> None:
        with ui.element("div").classes("form"):
            view = FormView("jog", list_jog_fields(self.session.stage.axes[self.axis]))
            for direction, sign, name in ((-1, "-", "minus"), (1, "+", "plus")):
                button = ui.button(f"{self.axis} {sign}").style("min-width: 72px")
                button.props(f'no-caps data-test=jog-{name} aria-label="jog {self.axis} {sign}, while held"')
                on_hold(button, partial(self._begin_jog, direction, view), self._end_jog)
        ui.label("runs while a button, Enter or the space bar is held").classes("text-caption")

    async def _begin_jog(self, direction: int, view: FormView) -> None:
        """Jog the selected axis until `_end_jog`; `direction` is +1 or -1."""
        if self._jog is not None:
            return  # a key that repeats
        if reason := self._explain_busy():
            ui.notify(reason, type="warning")
            return
        view.clear_errors()
        try:
            jog = self._jog = Jog(self.session.stage.axes[self.axis], direction, view.texts)
            try:
                await self.reports.perform("jog", f"jog {self.axis}", jog.run)
            finally:
                jog.release()
                self._jog = None
        except StageError as error:
            self._show_error(error, view)

    def _end_jog(self) -> None:
        if self._jog is not None:
            self._jog.release()

    def _show_error(self, error: StageError, view: FormView) -> None:
        """Show an error at the field that it concerns, or below the forms if it concerns no field."""
        error = to_field_error(error, self.session.stage.axes[self.axis], view.texts, view.fields)
        if not view.show_error(error):
            self.reports.set_outcome(view.name, str(error), has_failed=True)
