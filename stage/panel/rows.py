"""Rows of a front panel: a register or a word with its value, edited in place, and its fields."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from stage.chips.register_map import Field, Register, Word
from stage.errors import ArgumentError
from stage.panel.front import choices, evidence, fixed, lit, meant, number, shown, span, with_field, worst

Place = Register | Word
Write = Callable[[Place, int], Awaitable[None]]


class Row:
    """A register, or a word that a host writes. Enter writes what was typed, Esc takes it back; a value that changes flashes. A
    word of which nobody can see what it holds is put together here, and sent by a button."""

    def __init__(self, place: Place, write: Write, mark: str):
        self.place, self._write, self._mark = place, write, mark
        self._held: int | None = None
        self._flash, self._editing = "", False
        self._fields: list[tuple[Field, Any]] = []
        self._area: ui.element | None = None
        register = isinstance(place, Register)
        can_write = "W" in place.access if isinstance(place, Register) else True
        with ui.element("div").classes("name"):
            name = ui.button(place.name, on_click=self._toggle) if place.fields else ui.label(place.name)
        if place.fields:
            name.props("flat dense no-caps size=sm icon-right=expand_more").props(f'data-test="fields-{mark}"')
        name.props["title"] = f"{span(place)} {place.unit}" if isinstance(place, Register) else f"{place.bits} bits"
        if can_write:
            self._value: Any = ui.input().props(
                "dense hide-bottom-space no-error-icon autocomplete=off spellcheck=false"
            )
            self._value.props["aria-label"] = f"{place.name}, {place.title}"
            self._value.on("keydown", self._key, args=["key"])
            self._value.on("blur", self._take_back, args=[])
        else:
            self._value = ui.label().classes("number")
        self._value.props(f'data-test="value-{mark}"')
        if isinstance(place, Register):
            ui.label(place.unit).classes("unit")
        else:
            send = ui.button("send", on_click=lambda: self._enter(self._value.value or ""))
            send.props(f'flat dense no-caps size=sm data-test="send-{mark}"')
        letter = place.evidence if isinstance(place, Register) else worst(place.fields)
        ui.label(letter).classes("evidence").props["title"] = evidence(letter)
        with ui.element("div").classes("meaning"):
            ui.label(place.title if register or not place.note else place.text)
            self._says = ui.element("small").classes("words" if place.fields else "")
            with self._says:
                self._words = ui.label()

    def forget(self) -> None:
        """Another axis is shown: nothing flashes for that."""
        self._held, self._editing = None, False

    def look(self, values: Mapping[str, int]) -> None:
        """Show what is held now."""
        value = values.get(self.place.name)
        if value is None or value == self._held:
            return
        before, self._held = self._held, value
        if not self._editing:
            self._show()
        if before is not None:
            old, self._flash = self._flash, "flash-b" if self._flash == "flash-a" else "flash-a"
            self._value.classes(remove=old, add=self._flash)
        for field, widget in self._fields:
            _set_field(field, widget, field.of(value))

    def _show(self) -> None:
        text = shown(self.place, self._held) if self._held is not None else ""
        if isinstance(self._value, ui.input):
            self._value.value, self._value.error = text, None
        else:
            self._value.text = text
        self._words.text = meant(self.place, self._held) if self._held is not None else ""

    async def _key(self, event: GenericEventArguments) -> None:
        key = event.args.get("key")
        if key == "Enter":
            await self._enter(self._value.value or "")
        elif key == "Escape":
            self._take_back()
        elif key != "Tab":
            self._editing = True

    def _take_back(self) -> None:
        self._editing = False
        self._show()

    async def _enter(self, text: str) -> None:
        try:
            value = number(text, self.place.bits)
        except ArgumentError as error:
            self._value.error = str(error)
            return
        self._editing, self._value.error = False, None
        await self._put(value)
        if self._held is not None:
            self._show()

    async def _put(self, value: int) -> None:
        await self._write(self.place, value)
        if self._held is None:  # what was sent stays, to be sent again
            self._value.value, self._words.text = shown(self.place, value), meant(self.place, value)

    def _toggle(self) -> None:
        if self._area is not None:
            self._area.set_visibility(not self._area.visible)
            return
        parent = self._says.parent_slot.parent.parent_slot.parent  # type: ignore[union-attr]
        with parent:
            self._area = ui.element("div").classes("fields")
            here = parent.default_slot.children
            with self._area:
                for field in self.place.fields:
                    if not fixed(field):
                        self._fields.append((field, self._field(field)))
            own = next(k for k, child in enumerate(here) if child is self._says.parent_slot.parent)  # type: ignore[union-attr]
            self._area.move(parent, own + 1)

    def _field(self, field: Field) -> Any:
        now = field.of(self._held or 0)
        title = f"b{field.bits} {field.name}: {field.text} [{field.evidence}]"
        if "W" not in field.access:
            made: Any = ui.label().classes("lamp")
            _set_field(field, made, now)
        elif options := choices(field):
            made = ui.select(_with(options, now), value=now, label=field.meaning or field.name).props(
                "dense options-dense"
            )
            made.on_value_change(lambda event: self._chosen(field, event.value))
        elif field.high == field.low:
            made = ui.checkbox(field.meaning or field.name, value=bool(now)).props("dense size=sm")
            made.on_value_change(lambda event: self._chosen(field, int(event.value)))
        else:
            made = ui.input(field.meaning or field.name, value=str(now)).props("dense hide-bottom-space")
            made.on("keydown.enter", lambda: self._typed(field, made), args=[])
        made.props["title"] = title
        return made.props(f'data-test="field-{self._mark}-{field.name}"')

    async def _typed(self, field: Field, widget: ui.input) -> None:
        try:
            value = number(widget.value or "", field.high - field.low + 1)
        except ArgumentError as error:
            widget.error = str(error)
            return
        widget.error = None
        await self._chosen(field, value)

    async def _chosen(self, field: Field, value: int) -> None:
        word = self._held
        if word is None:  # composed here: the other fields are what their widgets say
            try:
                word = sum(
                    (_value_of(f, w) << f.low & f.mask for f, w in self._fields), getattr(self.place, "fixed", 0)
                )
            except ArgumentError:
                return  # it is said at its widget
            self._value.value = shown(self.place, with_field(word, field, value))
            self._words.text = meant(self.place, with_field(word, field, value))
        elif field.of(word) != value:
            await self._put(with_field(word, field, value))


class WordRow:
    """A word that a host reads: its bits as lamps, what is longer in words."""

    def __init__(self, word: Word):
        self._word, self._held = word, -1
        with ui.element("div").classes("word") as self._line:
            head = ui.label().classes("number").style("display: inline; margin-right: 10px")
            head.props["title"] = word.text
            self._head = head
            self._lamps: list[tuple[Field, ui.label]] = []
            for field in word.fields:
                lamp = ui.label().classes("lamp")
                lamp.props["title"] = f"b{field.bits} {field.name}: {field.text} [{field.evidence}]"
                self._lamps.append((field, lamp))

    def forget(self) -> None:
        """Another axis is shown."""
        self._held = -1

    def look(self, values: Mapping[str, int]) -> None:
        """Show what is held now."""
        value = values.get(self._word.name)
        self._line.set_visibility(value is not None)
        if value is None or value == self._held:
            return
        self._held = value
        self._head.text = f"{self._word.name} {shown(self._word, value)}"
        for field, lamp in self._lamps:
            _set_field(field, lamp, field.of(value))


def _set_field(field: Field, widget: Any, value: int) -> None:
    if isinstance(widget, ui.select):
        if value not in widget.options:
            widget.set_options(_with(choices(field), value))
        widget.value = value
    elif isinstance(widget, ui.checkbox):
        widget.value = bool(value)
    elif isinstance(widget, ui.input):
        widget.value = str(value)
    else:
        text, on = lit(field, value)
        widget.text = text
        widget.classes(add="on") if on else widget.classes(remove="on")


def _value_of(field: Field, widget: Any) -> int:
    if isinstance(widget, ui.select | ui.checkbox):
        return int(widget.value)
    if not isinstance(widget, ui.input):
        return 0
    try:
        return number(widget.value or "", field.high - field.low + 1)
    except ArgumentError as error:
        widget.error = str(error)
        raise


def _with(options: dict[int, str], value: int) -> dict[int, str]:
    return options if value in options else {**options, value: f"{value}  (not in the map)"}
