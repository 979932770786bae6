"""The front panel of each chip, made from its register map: registers, words, commands and pins of one axis at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from stage.chips.register_map import Field, Register, Word
from stage.errors import ArgumentError, StageError
from stage.panel.browser_updates import BrowserUpdates, on_single_click
from stage.panel.register_text import (
    BusCycle,
    CommandButton,
    FrontPanel,
    describe_evidence,
    describe_lamp,
    describe_range,
    describe_value,
    find_weakest_evidence,
    format_value,
    is_fixed,
    list_choices,
    list_write_cycles,
    parse_number,
    replace_field,
)
from stage.sim.stage import Stage

if TYPE_CHECKING:
    from stage.panel.server import Panel


Place = Register | Word
Write = Callable[[Place, int], Awaitable[None]]


class RegisterRow:
    """Row of a register, or of a word that a host writes, with its fields.

    Enter writes what was typed, Esc takes it back; a value that changes flashes. A word that cannot be read back is composed of its
    fields here, and sent by a button.
    """

    def __init__(self, place: Place, write: Write, mark: str):
        self.place, self._write, self._mark = place, write, mark
        self._value_now: int | None = None
        self._flash, self._editing = "", False
        self._fields: list[tuple[Field, Any]] = []
        self._area: ui.element | None = None
        register = isinstance(place, Register)
        can_write = "W" in place.access if isinstance(place, Register) else True
        with ui.element("div").classes("name"):
            name = ui.button(place.name, on_click=self._toggle) if place.fields else ui.label(place.name)
        if place.fields:
            name.props("flat dense no-caps size=sm icon-right=expand_more").props(f'data-test="fields-{mark}"')
        name.props["title"] = (
            f"{describe_range(place)} {place.unit}" if isinstance(place, Register) else f"{place.bits} bits"
        )
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
        letter = place.evidence if isinstance(place, Register) else find_weakest_evidence(place.fields)
        ui.label(letter).classes("evidence").props["title"] = describe_evidence(letter)
        with ui.element("div").classes("meaning"):
            ui.label(place.title if register or not place.note else place.text)
            self._says = ui.element("small").classes("words" if place.fields else "")
            with self._says:
                self._words = ui.label()

    def forget(self) -> None:
        """Forget the value, so that nothing flashes: another axis is shown."""
        self._value_now, self._editing = None, False

    def update(self, values: Mapping[str, int]) -> None:
        """Show the value that the chip holds now."""
        value = values.get(self.place.name)
        if value is None or value == self._value_now:
            return
        before, self._value_now = self._value_now, value
        if not self._editing:
            self._show()
        if before is not None:
            old, self._flash = self._flash, "flash-b" if self._flash == "flash-a" else "flash-a"
            self._value.classes(remove=old, add=self._flash)
        for field, widget in self._fields:
            _set_field(field, widget, field.of(value))

    def _show(self) -> None:
        text = format_value(self.place, self._value_now) if self._value_now is not None else ""
        if isinstance(self._value, ui.input):
            self._value.value, self._value.error = text, None
        else:
            self._value.text = text
        self._words.text = describe_value(self.place, self._value_now) if self._value_now is not None else ""

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
            value = parse_number(text, self.place.bits)
        except ArgumentError as error:
            self._value.error = str(error)
            return
        self._editing, self._value.error = False, None
        await self._put(value)
        if self._value_now is not None:
            self._show()

    async def _put(self, value: int) -> None:
        await self._write(self.place, value)
        if self._value_now is None:  # what was sent stays, to be sent again
            self._value.value, self._words.text = format_value(self.place, value), describe_value(self.place, value)

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
                    if not is_fixed(field):
                        self._fields.append((field, self._field(field)))
            own = next(k for k, child in enumerate(here) if child is self._says.parent_slot.parent)  # type: ignore[union-attr]
            self._area.move(parent, own + 1)

    def _field(self, field: Field) -> Any:
        now = field.of(self._value_now or 0)
        title = f"b{field.bits} {field.name}: {field.text} [{field.evidence}]"
        if "W" not in field.access:
            made: Any = ui.label().classes("lamp")
            _set_field(field, made, now)
        elif options := list_choices(field):
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
            value = parse_number(widget.value or "", field.high - field.low + 1)
        except ArgumentError as error:
            widget.error = str(error)
            return
        widget.error = None
        await self._chosen(field, value)

    async def _chosen(self, field: Field, value: int) -> None:
        word = self._value_now
        if word is None:  # composed here: the other fields are what their widgets say
            try:
                word = sum(
                    (_value_of(f, w) << f.low & f.mask for f, w in self._fields), getattr(self.place, "fixed", 0)
                )
            except ArgumentError:
                return  # it is said at its widget
            self._value.value = format_value(self.place, replace_field(word, field, value))
            self._words.text = describe_value(self.place, replace_field(word, field, value))
        elif field.of(word) != value:
            await self._put(replace_field(word, field, value))


class LampRow:
    """Row of a word that a host reads: its bits as lamps, longer fields in words."""

    def __init__(self, word: Word):
        self._word, self._value_now = word, -1
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
        """Forget the value: another axis is shown."""
        self._value_now = -1

    def update(self, values: Mapping[str, int]) -> None:
        """Show the value that the chip holds now."""
        value = values.get(self._word.name)
        self._line.set_visibility(value is not None)
        if value is None or value == self._value_now:
            return
        self._value_now = value
        self._head.text = f"{self._word.name} {format_value(self._word, value)}"
        for field, lamp in self._lamps:
            _set_field(field, lamp, field.of(value))


def _set_field(field: Field, widget: Any, value: int) -> None:
    if isinstance(widget, ui.select):
        if value not in widget.options:
            widget.set_options(_with(list_choices(field), value))
        widget.value = value
    elif isinstance(widget, ui.checkbox):
        widget.value = bool(value)
    elif isinstance(widget, ui.input):
        widget.value = str(value)
    else:
        text, on = describe_lamp(field, value)
        widget.text = text
        widget.classes(add="on") if on else widget.classes(remove="on")


def _value_of(field: Field, widget: Any) -> int:
    if isinstance(widget, ui.select | ui.checkbox):
        return int(widget.value)
    if not isinstance(widget, ui.input):
        return 0
    try:
        return parse_number(widget.value or "", field.high - field.low + 1)
    except ArgumentError as error:
        widget.error = str(error)
        raise


def _with(options: dict[int, str], value: int) -> dict[int, str]:
    return options if value in options else {**options, value: f"{value}  (not in the map)"}


def build_chip_panels(panel: Panel, updates: BrowserUpdates) -> None:
    """Build a card for each chip; its content is built when it is opened."""
    for k in range(len(panel.observer.traces)):
        ChipCard(panel, updates, k)


def axis_names(stage: Stage, k: int) -> dict[int, str]:
    """Return the axes of a chip, and what the stage calls them."""
    chip = stage.chips[k]
    names = {a.chip_axis: a.name for a in stage.axes.values() if a.chip is chip}
    return {j: names.get(j, f"({j})") for j in range(chip.AXES)}


async def send(panel: Panel, k: int, cycles: Sequence[BusCycle]) -> list[int]:
    """Make bus cycles on a chip, in the stage's thread, and return what was read."""
    trace = panel.observer.traces[k]

    def order(stage: Stage) -> list[int]:
        found = []
        for c in cycles:
            if c.read:
                found.append(trace.read(c.address))
            else:
                stage.chips[k].write(c.address, c.datum)
        panel.observer.observe(stage)
        return found

    return await asyncio.wrap_future(panel.session.post(order))


class ChipCard:
    """Front panel of one chip in one browser."""

    def __init__(self, panel: Panel, updates: BrowserUpdates, k: int):
        self.panel, self.updates, self.k, self.axis = panel, updates, k, 0
        stage = panel.session.stage
        self.front = FrontPanel(type(stage.chips[k]))
        self.names = axis_names(stage, k)
        self._rows: list[RegisterRow | LampRow] = []
        self._built = False
        names = " ".join(name for name in self.names.values() if "(" not in name) or "no axis"
        with ui.card().classes("w-full q-pa-none"), ui.expansion(f"{names}: {self.front.map.title}").classes(
            "w-full front"
        ).props(f'data-test="chip-{k}"') as self._body:  # fmt: skip
            pass
        self._body.on_value_change(self._opened)
        if k == 0:
            self._body.value = True
        ui.timer(0.1, self._look)

    def _opened(self) -> None:
        if self._built or not self._body.value:
            return
        self._built = True
        self.panel.observer.request_registers(self.k, self.axis)
        with self._body:
            if len(self.names) > 1:
                ui.toggle(self.names, value=0, on_change=self._choose).props("dense no-caps").props(
                    f'data-test="axis-of-{self.k}"'
                )
            self._lamps()
            self._commands()
            self._registers()

    def _choose(self, event: object) -> None:
        self.axis = getattr(event, "value", 0)
        self.panel.observer.request_registers(self.k, self.axis)
        for row in self._rows:
            row.forget()

    def _registers(self) -> None:
        with _part("registers"), ui.element("div").classes("registers"):
            places: list[Place] = [*self.front.registers, *self.front.forms]
            for place in places:
                self._rows.append(RegisterRow(place, self.write, f"{self.k}-{place.name}"))

    def _lamps(self) -> None:
        kind = self.front.kind
        if self.front.lamps:
            with _part("status"):
                for word in self.front.lamps:
                    self._rows.append(LampRow(word))
        with _part("pins"):
            for what, pins in (("inputs", kind.INPUTS), ("outputs", kind.OUTPUTS)):
                with ui.element("div").classes("lamps"):
                    ui.label(what).classes("section")
                    for name in pins:
                        lamp = ui.label(name).classes("lamp").props(f'data-test="pin-{self.k}-{name}"')
                        self.updates.show_lamp(lamp, partial(self._pin, what, name))

    def _commands(self) -> None:
        for group, buttons in self.front.buttons.items():
            reading = all(not b.starts for b in buttons) and len(buttons) > 12
            with _part(group, not reading), ui.element("div").classes("commands"):
                for b in buttons:
                    if not b.takes:
                        self._button(b)

    def _button(self, b: CommandButton) -> None:
        async def press() -> None:
            cycles = self.front.kind.command_cycles(b.symbol, self.axis, b.datum)
            await self._send([BusCycle(False, *cycle) for cycle in cycles])

        button = on_single_click(ui.button(f"{b.label}  {b.words}"), press)
        button.props(f"dense no-caps outline size=sm {'color=positive' if b.starts else ''}")
        button.props["title"] = f"{b.title} [{b.evidence}]"
        code = f"-{b.datum:X}" if b.datum is not None else ""
        button.props["data-test"] = f"command-{self.k}-{b.symbol}{code}"

    async def write(self, place: Place, value: int) -> None:
        """Write a register, or a word, of the axis that is shown."""
        await self._send(list_write_cycles(self.front.kind, place, value, self.axis))

    async def _send(self, cycles: Sequence[BusCycle]) -> None:
        try:
            await send(self.panel, self.k, cycles)
        except StageError as error:
            ui.notify(str(error), type="negative")
        self._look()

    def _look(self) -> None:
        if not (self._built and self._body.value):
            return
        self.panel.observer.request_registers(self.k, self.axis)
        seen = self.panel.observer.chips.get((self.k, self.axis))
        if seen is None:
            return
        for row in self._rows:
            row.update(seen.values)

    def _pin(self, what: str, name: str) -> bool:
        seen = self.panel.observer.chips.get((self.k, self.axis))
        return bool(seen is not None and getattr(seen, what)[name])


def _part(title: str, opened: bool = True) -> ui.expansion:
    """Return a part of a front panel that can be folded."""
    return ui.expansion(title, value=opened).props("dense dense-toggle").classes("w-full part")


STYLE = """
.front .nicegui-expansion-content { gap: 2px; padding: 0 12px 12px 12px }
.front > .q-expansion-item__container > .q-item { padding: 8px 12px; font-weight: 600 }
.part .q-item { min-height: 24px; padding: 2px 0; font-size: 12px }
.part .nicegui-expansion-content { padding: 0 0 4px 0 }
.section { font-size: 11px; text-transform: uppercase; letter-spacing: .06em; opacity: .7; margin-right: 10px }
.registers { display: grid; column-gap: 10px; row-gap: 2px; align-items: center; font-size: 12px;
  grid-template-columns: max-content minmax(92px, 130px) fit-content(110px) 22px minmax(0, 1fr) }
@media (max-width: 600px) { .registers { grid-template-columns: max-content minmax(84px, 1fr) fit-content(90px) 22px }
  .registers .meaning { grid-column: 1 / -1; margin-bottom: 6px } }
.registers .name { font-family: ui-monospace, monospace; font-weight: 600 }
.registers .unit { opacity: .7 }
.registers .meaning { overflow-wrap: anywhere; line-height: 1.25 }
.registers .meaning > * { display: inline } .registers .meaning small { opacity: .75; margin-left: 6px }
.registers .meaning small.words { display: block; margin-left: 0 } .registers .meaning small > * { display: inline }
.registers .fields { grid-column: 1 / -1; display: grid; grid-template-columns: repeat(auto-fill, minmax(220px, 1fr));
  gap: 4px 12px; padding: 4px 8px 8px 16px; border-left: 2px solid #8886 }
.registers > .q-field--dense .q-field__control { height: 26px; min-height: 26px }
.registers > .q-field .q-field__native { font-family: ui-monospace, monospace; font-variant-numeric: tabular-nums; padding: 0 4px }
.registers .q-field__bottom { padding: 2px 0; font-size: 11px; line-height: 1.2 }
.evidence { border: 1px solid #8888; border-radius: 4px; text-align: center; font-size: 10px; cursor: help }
.lamps { display: flex; flex-wrap: wrap; row-gap: 2px }
.commands { display: flex; flex-wrap: wrap; gap: 4px }
.commands .q-btn { text-align: left }
.word { font-size: 12px; margin: 2px 0 }
@keyframes flash-a { from { background: #ffb02088 } } @keyframes flash-b { from { background: #ffb02088 } }
.flash-a { animation: flash-a .9s } .flash-b { animation: flash-b .9s }
@media (prefers-reduced-motion: reduce) { .flash-a, .flash-b { animation-duration: .01s } }
.trace { height: 210px; overflow: auto; font-family: ui-monospace, monospace; font-size: 11.5px; white-space: pre }
.trace .bad { color: #e5484d } .trace .own { opacity: .75 }
"""
