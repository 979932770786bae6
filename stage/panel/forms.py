"""Procedures on the page: a form each, jog buttons, stop; the report beside, and its operation pattern."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from nicegui import run, ui

from stage.errors import RunTimeout, StageError
from stage.panel import procedures
from stage.panel.procedures import FORMS, Field, Form, Jog
from stage.panel.session import Abandoned

if TYPE_CHECKING:
    from stage.panel.server import Panel


def build(panel: Panel) -> None:
    """One browser's forms."""
    axes = list(panel.session.stage.axes)
    if axes:
        Procedures(panel, axes)


class Procedures:
    """Which axis, which form, and what came of it."""

    def __init__(self, panel: Panel, axes: list[str]):
        self.session = panel.session
        self.axis = axes[0]
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
            self.said = ui.label().classes("number").style("white-space: pre-wrap; font-size: 12px")
            self.said.props("data-test=report aria-live=polite role=status")
            self.picture = ui.html("", sanitize=False).classes("w-full pattern").props("data-test=pattern")
        panel.controls.when_lost(ui.context.client.id, self._release)
        self._choose(self.axis)

    def _choose(self, axis: str) -> None:
        self.axis = axis
        stage = self.session.stage
        self.box.clear()
        with self.box:
            try:
                forms = [f for f in FORMS.values() if f.needs(stage, axis)]
                given = {f.name: f.fields(stage, axis) for f in forms}
            except StageError as error:
                ui.label(str(error)).classes("text-negative")
                return
            with ui.tabs().classes("w-full").props("dense no-caps inline-label align=left") as tabs:
                for form in forms:
                    ui.tab(form.name, form.title).props(f"data-test=tab-{form.name}")
                ui.tab("jog", "Jog").props("data-test=tab-jog")
            with ui.tab_panels(tabs, value="move").classes("w-full").props("animated=false"):
                for form in forms:
                    with ui.tab_panel(form.name).classes("q-pa-xs"):
                        self._form(form, given[form.name])
                with ui.tab_panel("jog").classes("q-pa-xs"):
                    self._jogging()

    def _form(self, form: Form, fields: list[Field]) -> None:
        controls: dict[str, Any] = {}
        with ui.row().classes("w-full items-start q-gutter-xs"):
            for field in fields:
                controls[field.name] = entry(form.name, field)

            async def go() -> None:
                clear(controls)
                values = {name: c.value for name, c in controls.items()}
                try:
                    order = form.order(self.session.stage, self.axis, values)
                except StageError as error:
                    self._wrong(error, fields, controls)
                    return
                what = form.title if form.several else f"{form.title} {self.axis}"
                await self._draw(await self._perform(what, order, fields, controls))

            ui.button("go", on_click=go).props(f"dense no-caps data-test=go-{form.name}").classes("q-mt-sm")
            for control in controls.values():
                if isinstance(control, ui.input):
                    control.on("keydown.enter", go)

    async def _perform(
        self, what: str, order: Callable[[Any], Any], fields: list[Field], controls: dict[str, Any]
    ) -> Any:
        """Have it done; its report, or None. What came of it stands on the page."""
        self._say(f"{what} ...")
        self.picture.content = ""
        try:
            report = await asyncio.wrap_future(self.session.act(what, order))
        except Abandoned:
            self._say(f"{what}: stopped.")
            return None
        except RunTimeout as error:
            self._say(f"{error}\n{getattr(error, 'report', '')}", wrong=True)
            return None
        except StageError as error:
            self._wrong(error, fields, controls)
            return None
        self._say(str(report), wrong=not report.ok)
        return report

    async def _draw(self, report: Any) -> None:
        """The operation pattern, where there is one; it takes a while."""
        if not hasattr(report, "plot"):
            return
        try:
            drawn = await run.io_bound(procedures.picture, report)
        except StageError as error:
            self._say(f"{report}\n{error}")
        else:
            if self.said.text == str(report):  # the next may have begun meanwhile
                self.picture.content = drawn

    def _jogging(self) -> None:
        controls: dict[str, Any] = {}
        fields = [f for f in FORMS["move"].fields(self.session.stage, self.axis) if f.name in ("speed", "accel")]
        with ui.row().classes("w-full items-start q-gutter-xs"):
            for field in fields:
                controls[field.name] = entry("jog", field)
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
        clear(controls)
        try:
            jog = self._jog = Jog(
                self.session.stage.axes[self.axis], direction, {n: c.value for n, c in controls.items()}
            )
        except StageError as error:
            self._wrong(error, fields, controls)
            return
        try:
            report = await self._perform(f"jog {self.axis}", jog.order, fields, controls)
        finally:
            self._release(jog)
        await self._draw(report)

    def _release(self, jog: Jog | None = None) -> None:
        if self._jog is not None and jog in (None, self._jog):
            self._jog.release()
            if jog is not None:
                self._jog = None

    async def _stop(self, at_once: bool) -> None:
        """All axes; what is under way is abandoned."""
        self.session.abandon()
        axes = list(self.session.stage.axes)
        try:
            await asyncio.wrap_future(self.session.act("stop", procedures.stopping(axes, at_once)))
        except StageError as error:
            self._say(str(error), wrong=True)

    def _wrong(self, error: BaseException, fields: list[Field], controls: dict[str, Any]) -> None:
        """At the field that it is about; else below."""
        field = procedures.where(error, fields)
        if field:
            said_at(controls[field], error)
            self._say("")
        else:
            self._say(str(error), wrong=True)

    def _say(self, text: str, wrong: bool = False) -> None:
        self.said.text = text
        self.said.classes(add="text-negative") if wrong else self.said.classes(remove="text-negative")


def entry(form: str, field: Field) -> Any:
    """An input or a choice for a field."""
    props = f"dense outlined hide-bottom-space data-test={form}-{field.name}"
    if field.choices:
        control: Any = ui.select(list(field.choices), value=field.default, label=field.title)
        return control.props(f"{props} options-dense").style("min-width: 100px")
    control = ui.input(field.title, value=field.default).props(f'{props} suffix="{field.unit}" inputmode=decimal')
    return control.style("width: 118px")


def clear(controls: dict[str, Any]) -> None:
    """No errors at the fields."""
    for control in controls.values():
        control.props(remove="error error-message")


def said_at(control: Any, error: BaseException) -> None:
    """The error stands at its field."""
    control.props(f"error error-message={_quoted(str(error))}")


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', "'") + '"'
