"""Fault controls on the page: load, supply, push, a form for each fault, and the faults in force."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import background_tasks, run, ui

from stage.errors import StageError
from stage.panel.browser_updates import on_hold, on_single_click
from stage.panel.fault_controls import ActiveFault, FaultForm
from stage.panel.procedure_forms import FieldError, FormField, parse_fields
from stage.panel.procedure_page import FormView

if TYPE_CHECKING:
    from stage.panel.server import Panel


MAX_PAYLOAD_KG = 10.0  # on the slider


class FaultPanel:
    """Part of the page with sliders, push buttons, a form for each fault, and the list of faults with a button to clear each."""

    def __init__(self, panel: Panel, axes: list[str]):
        self.fault_controls, self.axis = panel.fault_controls, axes[0]
        self._displayed: list[tuple[ActiveFault, str]] | None = None
        self._slider_updates: list[Callable[[], None]] = []
        self._pushed_axis = ""
        with (
            ui.card().classes("w-full").style("padding: 0"),
            ui.expansion("Faults, load and push", icon="warning_amber")
            .classes("w-full")
            .props("data-test=hands dense header-class=text-weight-medium"),
        ):
            with ui.row().classes("w-full items-center q-gutter-md"):
                self._build_sliders()
            with ui.row().classes("w-full items-center q-gutter-xs"):
                toggle = ui.toggle(axes, value=self.axis, on_change=lambda e: self._select_axis(e.value))
                toggle.props("dense no-caps data-test=hands-axis")
                self._push_view = FormView("push", self._list_push_fields())
                for sign, label, name in ((-1, "push -", "minus"), (1, "push +", "plus")):
                    button = ui.button(label)
                    button.props(f"dense no-caps data-test=push-{name} aria-label='{label}, while held'")
                    on_hold(button, partial(self._begin_push, sign), lambda: run.io_bound(self._end_push))
            self._box = ui.row().classes("w-full items-start q-gutter-xs")
            self._list = ui.column().classes("w-full q-gutter-none").props("data-test=in-force aria-live=polite")
        panel.controls.call_when_controls_lost(ui.context.client.id, self._schedule_end_of_push)
        self._select_axis(self.axis)
        ui.timer(0.25, self._update_sliders_and_list)

    def _build_sliders(self) -> None:
        controls = self.fault_controls
        if (mass := controls.payload) is not None:
            span = (0.0, max(MAX_PAYLOAD_KG, mass), 0.1)
            self._build_slider("payload", "kg", span, lambda: controls.payload, controls.set_payload)
        span = (1.0, round(2 * controls.supply), 0.5)
        self._build_slider("supply", "V", span, lambda: controls.supply, controls.set_supply)

    def _build_slider(
        self,
        name: str,
        unit: str,
        limits: tuple[float, float, float],
        read: Callable[[], float | None],
        write: Callable[[float], None],
    ) -> None:
        """Build a slider that also follows changes of its value by others.

        Args:
            name: Label of the slider.
            unit: Unit of the value.
            limits: Least value, greatest value, and step.
            read: Function that returns the value now, or None if there is none.
            write: Function that is called with the value that the user has set.
        """
        low, high, step = limits
        with ui.column().classes("q-gutter-none").style("width: 200px"):
            text = ui.label().classes("text-caption number").props(f"data-test={name}-value")
            slider = ui.slider(min=low, max=high, step=step)
            slider.props(f"data-test={name} aria-label='{name}, {unit}'")

        async def write_value(event: Any) -> None:
            try:
                await run.io_bound(write, float(event.args))
            except StageError as error:
                ui.notify(str(error), type="negative")
            show_value()

        def show_value() -> None:
            value = read()
            if value is not None and displayed != [value]:
                displayed[:] = [value]
                slider.value, text.text = value, f"{name} {value:g} {unit}"

        displayed: list[float] = []
        slider.on("change", write_value)
        self._slider_updates.append(show_value)
        show_value()

    def _list_push_fields(self) -> list[FormField]:
        return [FormField("force", "push with", self.fault_controls.find_push_unit(self.axis), "10")]

    async def _begin_push(self, sign: int) -> None:
        """Push the selected axis with the typed force until `_end_push`; `sign` is +1 or -1."""
        if self._pushed_axis:
            return  # a key that repeats
        self._pushed_axis = self.axis
        self._push_view.clear_errors()
        try:
            force = parse_fields(self._list_push_fields(), self._push_view.texts).get("force", 0.0)
            await run.io_bound(self.fault_controls.push, self.axis, sign * force)
        except FieldError as error:
            self._pushed_axis = ""
            self._push_view.show_error(error)

    def _schedule_end_of_push(self) -> None:
        background_tasks.create(run.io_bound(self._end_push))

    def _end_push(self) -> None:
        axis, self._pushed_axis = self._pushed_axis, ""
        if axis:
            self.fault_controls.push(axis, 0.0)

    def _select_axis(self, axis: str) -> None:
        self.axis = axis
        self._push_view.controls["force"].props(f'suffix="{self.fault_controls.find_push_unit(axis)}"')
        forms = {form.name: form for form in self.fault_controls.list_forms(axis)}
        self._box.clear()
        with self._box:
            titles = {name: name.replace("_", " ") for name in forms}
            select = ui.select(titles, value=next(iter(titles)), label="what breaks").style("min-width: 150px")
            select.props("dense options-dense outlined data-test=breaking")
            fields = ui.row().classes("items-start q-gutter-xs")
            text = ui.label().classes("text-caption w-full")

            def build_form() -> None:
                fields.clear()
                text.text = forms[select.value].title
                with fields:
                    self._build_form(forms[select.value])

            select.on_value_change(build_form)
            build_form()

    def _build_form(self, form: FaultForm) -> None:
        view = FormView("break", form.fields)

        async def make_fault() -> None:
            view.clear_errors()
            try:
                await run.io_bound(self.fault_controls.make_fault, form.name, self.axis, view.texts)
            except StageError as error:
                if not view.show_error(error):
                    ui.notify(str(error), type="negative", multi_line=True)

        button = on_single_click(ui.button("break it"), make_fault).classes("q-mt-xs")
        button.props("dense no-caps color=deep-orange-9 data-test=break")

    def _update_sliders_and_list(self) -> None:
        """Update the sliders, and the list of faults if it has changed."""
        for update in self._slider_updates:
            update()
        faults = [(active, active.text) for active in self.fault_controls.faults_in_force]
        if faults == self._displayed:
            return
        self._displayed = faults
        self._list.clear()
        with self._list:
            for active, text in faults:
                with ui.row().classes("items-center q-gutter-xs"):
                    ui.icon("warning", color="deep-orange")
                    ui.label(text)
                    button = ui.button("clear", on_click=partial(run.io_bound, self.fault_controls.clear_fault, active))
                    button.props(f"dense flat no-caps data-test=clear-fault aria-label={quote_clear_label(text)}")


def quote_clear_label(text: str) -> str:
    """Return the quoted label, for example "clear jam of x", of the button that clears the fault described by `text`."""
    return '"clear ' + text.replace('"', "'") + '"'
