"""The front panel of each chip, built from its register map: registers, words, commands and pins of one axis at a time."""

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
from stage.panel.front_panel_content import (
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


MapItem = Register | Word
MAX_OPEN_COMMANDS = 12  # a longer group of commands that begin no drive is folded at first


def _describe_bits(field: Field) -> str:
    return f"b{field.bits} {field.name}: {field.description} [{field.evidence}]"


class FieldControl:
    """Control of one field of a register: a list, a checkbox or a text input; a lamp for a field that a host cannot write.

    Args:
        field: The field.
        value: Value to show at first.
        mark: Name of the element for tests.
        write: Function that is called with the field and the value that the user has chosen or typed.
    """

    def __init__(self, field: Field, value: int, mark: str, write: Callable[[Field, int], Awaitable[None]]):
        self.field, self._write = field, write
        title = field.meaning or field.name
        if "W" not in field.access:
            self.element: Any = ui.label().classes("lamp")
        elif choices := list_choices(field):
            self.element = ui.select(choices | self._list_unmapped_choice(value), value=value, label=title)
            self.element.props("dense options-dense").on_value_change(lambda event: write(field, event.value))
        elif field.high == field.low:
            self.element = ui.checkbox(title, value=bool(value)).props("dense size=sm")
            self.element.on_value_change(lambda event: write(field, int(event.value)))
        else:
            self.element = ui.input(title, value=str(value)).props("dense hide-bottom-space")
            self.element.on("keydown.enter", self._write_entered_value, args=[])
        self.element.props["title"] = _describe_bits(field)
        self.element.props(f'data-test="{mark}"')
        self.show(value)

    def _list_unmapped_choice(self, value: int) -> dict[int, str]:
        """Return the extra choice for a value that the register map does not explain, or no choice."""
        return {} if value in self.field.values else {value: f"{value}  (not in the map)"}

    def show(self, value: int) -> None:
        """Show a value in the control."""
        element = self.element
        if isinstance(element, ui.select):
            if value not in element.options:
                element.set_options(list_choices(self.field) | self._list_unmapped_choice(value))
            element.value = value
        elif isinstance(element, ui.checkbox):
            element.value = bool(value)
        elif isinstance(element, ui.input):
            element.value = str(value)
        else:
            _show_lamp(element, self.field, value)

    def read(self) -> int:
        """Return the value of the control; 0 for a lamp.

        Raises:
            ArgumentError: The text of the control is not a number; the control shows the error, too.
        """
        if isinstance(self.element, ui.select | ui.checkbox):
            return int(self.element.value)
        if not isinstance(self.element, ui.input):
            return 0
        try:
            value = parse_number(self.element.value or "", self.field.high - self.field.low + 1)
        except ArgumentError as error:
            self.element.error = str(error)
            raise
        self.element.error = None
        return value

    async def _write_entered_value(self) -> None:
        try:
            value = self.read()
        except ArgumentError:
            return
        await self._write(self.field, value)


class RegisterRow:
    """Row of a front panel for a register, or for a word that a host writes, with its fields.

    Enter writes the typed value, Esc discards it; a value flashes when it changes. A word that cannot be read back is composed from
    the controls of its fields, and a button sends it.
    """

    def __init__(self, item: MapItem, write: Callable[[MapItem, int], Awaitable[None]], mark: str):
        self.item, self._write, self._mark = item, write, mark
        self._chip_value: int | None = None
        self._flash, self._editing = "", False
        self._fields: list[FieldControl] = []
        self._area: ui.element | None = None
        if isinstance(item, Register):
            limits, letter = f"{describe_range(item)} {item.unit}", item.evidence
        else:
            limits, letter = f"{item.bits} bits", find_weakest_evidence(item.fields)
        with ui.element("div").classes("name"):
            name = ui.button(item.name, on_click=self._toggle_fields) if item.fields else ui.label(item.name)
        if item.fields:
            name.props(f'flat dense no-caps size=sm icon-right=expand_more data-test="fields-{mark}"')
        name.props["title"] = limits
        self._build_value()
        if isinstance(item, Register):
            ui.label(item.unit).classes("unit")
        else:
            make_bus_cycles = ui.button("send", on_click=lambda: self._write_entered_value(self._value.value or ""))
            make_bus_cycles.props(f'flat dense no-caps size=sm data-test="send-{mark}"')
        ui.label(letter).classes("evidence").props["title"] = describe_evidence(letter)
        with ui.element("div").classes("meaning") as self._meaning:
            ui.label(item.title if isinstance(item, Register) or not item.note else item.description)
            with ui.element("small").classes("words" if item.fields else ""):
                self._words = ui.label()

    def _build_value(self) -> None:
        item = self.item
        if isinstance(item, Register) and "W" not in item.access:
            self._value: Any = ui.label().classes("number")
        else:
            self._value = ui.input().props("dense hide-bottom-space no-error-icon autocomplete=off spellcheck=false")
            self._value.props["aria-label"] = f"{item.name}, {item.title}"
            self._value.on("keydown", self._handle_key, args=["key"])
            self._value.on("blur", self._cancel_editing, args=[])
        self._value.props(f'data-test="value-{self._mark}"')

    def forget_value(self) -> None:
        """Forget the value of the chip, so that the row does not flash when it shows another axis."""
        self._chip_value, self._editing = None, False

    def show_chip_values(self, values: Mapping[str, int]) -> None:
        """Show the value that the chip holds now, from the values of all its registers and words by name."""
        value = values.get(self.item.name)
        if value is None or value == self._chip_value:
            return
        before, self._chip_value = self._chip_value, value
        if not self._editing:
            self._show_chip_value()
        if before is not None:
            old, self._flash = self._flash, "flash-b" if self._flash == "flash-a" else "flash-a"
            self._value.classes(remove=old, add=self._flash)
        for control in self._fields:
            control.show(control.field.extract(value))

    def _show_chip_value(self) -> None:
        """Show the value that the chip holds, or nothing if it cannot be read."""
        self._show_value(self._chip_value)
        if isinstance(self._value, ui.input):
            self._value.error = None

    def _show_value(self, value: int | None) -> None:
        text = "" if value is None else format_value(self.item, value)
        if isinstance(self._value, ui.input):
            self._value.value = text
        else:
            self._value.text = text
        self._words.text = "" if value is None else describe_value(self.item, value)

    async def _handle_key(self, event: GenericEventArguments) -> None:
        key = event.args.get("key")
        if key == "Enter":
            await self._write_entered_value(self._value.value or "")
        elif key == "Escape":
            self._cancel_editing()
        elif key != "Tab":
            self._editing = True

    def _cancel_editing(self) -> None:
        self._editing = False
        self._show_chip_value()

    async def _write_entered_value(self, text: str) -> None:
        try:
            value = parse_number(text, self.item.bits)
        except ArgumentError as error:
            self._value.error = str(error)
            return
        self._editing, self._value.error = False, None
        await self._send(value)
        if self._chip_value is not None:
            self._show_chip_value()

    async def _send(self, value: int) -> None:
        await self._write(self.item, value)
        if self._chip_value is None:  # what was sent stays, to be sent again
            self._show_value(value)

    def _toggle_fields(self) -> None:
        if self._area is not None:
            self._area.set_visibility(not self._area.visible)
            return
        parent = self._meaning.parent_slot.parent  # type: ignore[union-attr]
        with parent:
            self._area = ui.element("div").classes("fields")
        with self._area:
            self._fields = [
                FieldControl(f, f.extract(self._chip_value or 0), f"field-{self._mark}-{f.name}", self._write_field)
                for f in self.item.fields
                if not is_fixed(f)
            ]
        self._area.move(parent, parent.default_slot.children.index(self._meaning) + 1)

    async def _write_field(self, field: Field, value: int) -> None:
        word = self._chip_value
        if word is not None:
            if field.extract(word) != value:
                await self._send(replace_field(word, field, value))
            return
        try:  # composed here: the other fields are what their controls say
            bits = [control.read() << control.field.low & control.field.mask for control in self._fields]
        except ArgumentError:
            return
        self._show_value(replace_field(sum(bits, getattr(self.item, "fixed", 0)), field, value))


class LampRow:
    """Row of a front panel for a word that a host reads: a lamp for each bit, and longer fields in words."""

    def __init__(self, word: Word):
        self._word, self._chip_value = word, -1
        with ui.element("div").classes("word") as self._line:
            self._head = ui.label().classes("number").style("display: inline; margin-right: 10px")
            self._head.props["title"] = word.description
            self._lamps = [(field, ui.label().classes("lamp")) for field in word.fields]
        for field, lamp in self._lamps:
            lamp.props["title"] = _describe_bits(field)

    def forget_value(self) -> None:
        """Forget the value that the lamps show, before the row shows another axis."""
        self._chip_value = -1

    def show_chip_values(self, values: Mapping[str, int]) -> None:
        """Show the value that the chip holds now, from the values of all its registers and words by name."""
        value = values.get(self._word.name)
        self._line.set_visibility(value is not None)
        if value is None or value == self._chip_value:
            return
        self._chip_value = value
        self._head.text = f"{self._word.name} {format_value(self._word, value)}"
        for field, lamp in self._lamps:
            _show_lamp(lamp, field, field.extract(value))


def _show_lamp(lamp: ui.label, field: Field, value: int) -> None:
    lamp.text, is_on = describe_lamp(field, value)
    lamp.classes(**{"add" if is_on else "remove": "on"})


def list_axis_names(stage: Stage, chip_index: int) -> dict[int, str]:
    """Return the name of each axis of a chip by its number on the chip; "(3)" for axis 3 if it has no joint."""
    chip = stage.chips[chip_index]
    names = {a.chip_axis: a.name for a in stage.axes.values() if a.chip is chip}
    return {j: names.get(j, f"({j})") for j in range(chip.AXES)}


async def make_bus_cycles(panel: Panel, chip_index: int, cycles: Sequence[BusCycle]) -> list[int]:
    """Make bus cycles on a chip, in the stage's thread.

    Args:
        panel: Panel of the stage.
        chip_index: Index of the chip in `Stage.chips`.
        cycles: Bus cycles, in their order.

    Returns:
        The data of the read cycles, in their order.
    """
    trace = panel.observer.traces[chip_index]

    def make_cycles(stage: Stage) -> list[int]:
        data = []
        for cycle in cycles:
            if cycle.read:
                data.append(trace.read(cycle.address))
            else:
                stage.chips[chip_index].write(cycle.address, cycle.datum)
        panel.observer.update_views(stage)
        return data

    return await asyncio.wrap_future(panel.session.post(make_cycles))


class ChipCard:
    """Front panel of one chip in one browser. Its content is built when a user opens it for the first time."""

    def __init__(self, panel: Panel, updates: BrowserUpdates, k: int):
        self.panel, self.updates, self.k, self.axis = panel, updates, k, 0
        stage = panel.session.stage
        self.front = FrontPanel(type(stage.chips[k]))
        self.names = list_axis_names(stage, k)
        self._rows: list[RegisterRow | LampRow] = []
        names = " ".join(name for name in self.names.values() if "(" not in name) or "no axis"
        with ui.card().classes("w-full front-card"):
            self._body = ui.expansion(f"Front panel of {names}: {self.front.map.title}").classes("w-full front")
        self._body.props(f'data-test="chip-{k}"').on_value_change(self._build_content)
        if k == 0:
            self._body.value = True
        ui.timer(0.1, self._show_values)

    def _build_content(self) -> None:
        if self._rows or not self._body.value:
            return
        self.panel.observer.request_registers(self.k, self.axis)
        with self._body:
            if len(self.names) > 1:
                toggle = ui.toggle(self.names, value=0, on_change=self._select_axis)
                toggle.props(f'dense no-caps data-test="axis-of-{self.k}"')
            if self.front.lamps:
                with _build_foldable_part("status"):
                    self._rows += [LampRow(word) for word in self.front.lamps]
            with _build_foldable_part("pins"):
                self._build_pins("inputs", self.front.kind.INPUTS)
                self._build_pins("outputs", self.front.kind.OUTPUTS)
            for group, buttons in self.front.buttons.items():
                is_open = len(buttons) <= MAX_OPEN_COMMANDS or any(b.starts_drive for b in buttons)
                with _build_foldable_part(group, is_open), ui.element("div").classes("commands"):
                    for button in buttons:
                        if not button.data_bits:
                            self._build_command(button)
            with _build_foldable_part("registers"), ui.element("div").classes("registers"):
                places: list[MapItem] = [*self.front.registers, *self.front.forms]
                self._rows += [RegisterRow(item, self.write, f"{self.k}-{item.name}") for item in places]

    def _select_axis(self, event: Any) -> None:
        self.axis = event.value
        self.panel.observer.request_registers(self.k, self.axis)
        for row in self._rows:
            row.forget_value()

    def _build_pins(self, title: str, pins: Mapping[str, int]) -> None:
        with ui.element("div").classes("lamps"):
            ui.label(title).classes("section")
            for name in pins:
                lamp = ui.label(name).classes("lamp").props(f'data-test="pin-{self.k}-{name}"')
                self.updates.bind_lamp(lamp, partial(self._is_asserted, title, name))

    def _is_asserted(self, direction: str, name: str) -> bool:
        view = self.panel.observer.chips.get((self.k, self.axis))
        return view is not None and getattr(view, direction)[name]

    def _build_command(self, command: CommandButton) -> None:
        async def send_command() -> None:
            cycles = self.front.kind.command_cycles(command.symbol, self.axis, command.datum)
            await self._send([BusCycle(False, *cycle) for cycle in cycles])

        button = on_single_click(ui.button(f"{command.label}  {command.words}"), send_command)
        button.props(f"dense no-caps outline size=sm {'color=positive' if command.starts_drive else ''}")
        button.props["title"] = f"{command.title} [{command.evidence}]"
        code = f"-{command.datum:X}" if command.datum is not None else ""
        button.props["data-test"] = f"command-{self.k}-{command.symbol}{code}"

    async def write(self, item: MapItem, value: int) -> None:
        """Write a register or a word of the axis that the card shows."""
        await self._send(list_write_cycles(self.front.kind, item, value, self.axis))

    async def _send(self, cycles: Sequence[BusCycle]) -> None:
        try:
            await make_bus_cycles(self.panel, self.k, cycles)
        except StageError as error:
            ui.notify(str(error), type="negative")
        self._show_values()

    def _show_values(self) -> None:
        if not (self._rows and self._body.value):
            return
        self.panel.observer.request_registers(self.k, self.axis)
        view = self.panel.observer.chips.get((self.k, self.axis))
        if view is not None:
            for row in self._rows:
                row.show_chip_values(view.values)


def _build_foldable_part(title: str, is_open: bool = True) -> ui.expansion:
    """Build a part of a front panel that users can fold."""
    return ui.expansion(title, value=is_open).props("dense dense-toggle").classes("w-full part")


STYLE = """
.panel .front-card { padding: 0; container-type: inline-size }
.front .nicegui-expansion-content { gap: 2px; padding: 0 12px 12px 12px }
.front > .q-expansion-item__container > .q-item { padding: 8px 12px; font-weight: 600 }
.part .q-item { min-height: 24px; padding: 2px 0; font-size: 12px }
.part .nicegui-expansion-content { padding: 0 0 4px 0 }
.lamps .section { margin-right: 10px }
.registers { display: grid; column-gap: 10px; row-gap: 2px; align-items: center; font-size: 12px;
  grid-template-columns: max-content minmax(92px, 130px) fit-content(110px) 22px minmax(0, 1fr) }
@container (max-width: 560px) { .registers { grid-template-columns: max-content minmax(84px, 1fr) fit-content(90px) 22px }
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
.trace { height: 52px; overflow: auto; font-family: ui-monospace, monospace; font-size: 11.5px; white-space: pre }
.used .trace { height: 210px }
.trace .bad { color: #e5484d } .trace .own { opacity: .75 }
"""
