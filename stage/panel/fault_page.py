"""Fault controls on the page: load, supply, push, everything that can break, and what is broken now."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from nicegui import background_tasks, run, ui

from stage.errors import StageError
from stage.panel.browser_updates import on_single_click
from stage.panel.fault_controls import ActiveFault, FaultForm
from stage.panel.procedure_forms import Field, FieldError, find_field, parse_fields
from stage.panel.procedure_page import build_entry, clear_errors, show_error_at

if TYPE_CHECKING:
    from stage.panel.server import Panel


MAX_PAYLOAD_KG = 10.0  # kg on the slider


def build_fault_controls(panel: Panel) -> None:
    """Build the fault controls of one browser."""
    axes = list(panel.session.stage.axes)
    if axes:
        FaultPanel(panel, axes)


class FaultPanel:
    """Sliders, a form for each fault that can be made, and the list of faults with "mend"."""

    def __init__(self, panel: Panel, axes: list[str]):
        self.fault_controls, self.axis = panel.fault_controls, axes[0]
        self._listed: list[tuple[ActiveFault, str]] | None = None
        self._follow: list[Callable[[], None]] = []
        with (
            ui.expansion("Faults, load and push", icon="back_hand")
            .classes("w-full")
            .props("data-test=hands dense header-class=text-weight-medium")
        ):
            with ui.row().classes("w-full items-center q-gutter-md"):
                self._sliders()
            with ui.row().classes("w-full items-center q-gutter-xs"):
                ui.toggle(axes, value=self.axis, on_change=lambda e: self._choose(e.value)).props(
                    "dense no-caps data-test=hands-axis"
                )
                self.force = build_entry("push", *self._force_fields())
                for sign, label in ((-1, "push -"), (1, "push +")):
                    self._push_button(sign, label)
            self.box = ui.row().classes("w-full items-start q-gutter-xs")
            self.list = ui.column().classes("w-full q-gutter-none").props("data-test=in-force aria-live=polite")
        panel.controls.when_lost(ui.context.client.id, self._let_go_soon)
        self._pushes = ""
        self._choose(self.axis)
        ui.timer(0.25, self._update)

    def _sliders(self) -> None:
        nominal, mass = self.fault_controls.supply, self.fault_controls.payload
        if mass is not None:
            self._slider(
                "payload",
                "kg",
                (0.0, max(MAX_PAYLOAD_KG, mass), 0.1),
                lambda: self.fault_controls.payload,
                self.fault_controls.set_payload,
            )
        self._slider(
            "supply",
            "V",
            (1.0, round(2 * nominal), 0.5),
            lambda: self.fault_controls.supply,
            self.fault_controls.set_supply,
        )

    def _slider(
        self,
        name: str,
        unit: str,
        span: tuple[float, float, float],
        look: Callable[[], float | None],
        does: Callable[[float], None],
    ) -> None:
        """Build a slider over `span`: least, greatest, step. It follows the value that holds, whoever changed it."""
        low, high, step = span
        with ui.column().classes("q-gutter-none").style("width: 200px"):
            text = ui.label().classes("text-caption number").props(f"data-test={name}-value")
            slider = ui.slider(min=low, max=high, step=step)
            slider.props(f"data-test={name} aria-label='{name}, {unit}'")

        async def change(event: Any) -> None:
            try:
                await run.io_bound(does, float(event.args))
            except StageError as error:
                ui.notify(str(error), type="negative")
            follow()

        def follow() -> None:
            now = look()
            if now is not None and shown != [now]:
                shown[:] = [now]
                slider.value, text.text = now, f"{name} {now:g} {unit}"

        shown: list[float] = []
        slider.on("change", change)
        self._follow.append(follow)
        follow()

    def _push_button(self, sign: int, label: str) -> None:
        button = ui.button(label).props(
            f"dense no-caps data-test=push-{'plus' if sign > 0 else 'minus'} aria-label='{label}, while held'"
        )
        button.style("touch-action: none; user-select: none")
        for event in ("pointerdown", "keydown.space.prevent", "keydown.enter.prevent"):
            button.on(event, lambda e: self._push(sign))
        for event in ("pointerup", "pointerleave", "pointercancel", "blur", "keyup"):
            button.on(event, lambda e: run.io_bound(self._let_go))

    def _force_fields(self) -> list[Field]:
        return [Field("force", "push with", self.fault_controls.find_push_unit(self.axis), "10")]

    async def _push(self, sign: int) -> None:
        if self._pushes:
            return
        self._pushes = self.axis
        clear_errors({"force": self.force})
        try:
            force = parse_fields(self._force_fields(), {"force": self.force.value}).get("force", 0.0)
            await run.io_bound(self.fault_controls.push, self.axis, sign * force)
        except FieldError as error:
            self._pushes = ""
            show_error_at(self.force, error)

    def _let_go_soon(self) -> None:
        background_tasks.create(run.io_bound(self._let_go))

    def _let_go(self) -> None:
        axis, self._pushes = self._pushes, ""
        if axis:
            self.fault_controls.push(axis, 0.0)

    def _choose(self, axis: str) -> None:
        self.axis = axis
        self.force.props(f'suffix="{self.fault_controls.find_push_unit(axis)}"')
        self.box.clear()
        with self.box:
            breakings = {b.name: b for b in self.fault_controls.list_forms(axis)}
            titles = {name: name.replace("_", " ") for name in breakings}
            chosen = ui.select(titles, value=next(iter(titles)), label="what breaks").props(
                "dense options-dense outlined data-test=breaking"
            )
            chosen.style("min-width: 150px")
            form = ui.row().classes("items-start q-gutter-xs")
            text = ui.label().classes("text-caption w-full")

            def show() -> None:
                form.clear()
                text.text = breakings[chosen.value].title
                with form:
                    self._form(breakings[chosen.value])

            chosen.on_value_change(show)
            show()

    def _form(self, breaking: FaultForm) -> None:
        controls = {f.name: build_entry("break", f) for f in breaking.fields}

        async def go() -> None:
            clear_errors(controls)
            given = {name: c.value for name, c in controls.items()}
            try:
                await run.io_bound(self.fault_controls.inject, breaking.name, self.axis, given)
            except StageError as error:
                field = find_field(error, breaking.fields)
                if field:
                    show_error_at(controls[field], error)
                else:
                    ui.notify(str(error), type="negative", multi_line=True)

        on_single_click(ui.button("break it"), go).props("dense no-caps color=deep-orange-9 data-test=break").classes(
            "q-mt-xs"
        )

    def _update(self) -> None:
        """Show the values that hold now, and the list of faults where it has changed."""
        for follow in self._follow:
            follow()
        now = [(made, made.text) for made in self.fault_controls.in_force]
        if now == self._listed:
            return
        self._listed = now
        self.list.clear()
        with self.list:
            for made, text in now:
                with ui.row().classes("items-center q-gutter-xs"):
                    ui.icon("warning", color="deep-orange")
                    ui.label(text)
                    ui.button("mend", on_click=lambda m=made: run.io_bound(self.fault_controls.mend, m)).props(
                        f"dense flat no-caps data-test=mend aria-label={quote_label(text)}"
                    )


def quote_label(text: str) -> str:
    """Return the label of a button that mends a fault, as the value of a prop."""
    return '"mend ' + text.replace('"', "'") + '"'
