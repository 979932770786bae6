"""The front panel of each chip, made from its register map: registers, words, commands and pins of one axis at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from nicegui import ui

from stage.errors import StageError
from stage.panel.front import Button, Front
from stage.panel.live import Live
from stage.panel.orders import Cycle, writes
from stage.panel.rows import Place, Row, WordRow
from stage.sim.stage import Stage

if TYPE_CHECKING:
    from stage.panel.server import Panel


def build(panel: Panel, live: Live) -> None:
    """A card a chip; what is in it is made when it is opened."""
    for k in range(len(panel.look.traces)):
        Card(panel, live, k)


def axis_names(stage: Stage, k: int) -> dict[int, str]:
    """Axes of a chip, and what the stage calls them."""
    chip = stage.chips[k]
    names = {a.chip_axis: a.name for a in stage.axes.values() if a.chip is chip}
    return {j: names.get(j, f"({j})") for j in range(chip.AXES)}


async def send(panel: Panel, k: int, cycles: Sequence[Cycle]) -> list[int]:
    """Make bus cycles on a chip, in the stage's thread; what was read."""
    trace = panel.look.traces[k]

    def order(stage: Stage) -> list[int]:
        found = []
        for c in cycles:
            if c.read:
                found.append(trace.read(c.address))
            else:
                stage.chips[k].write(c.address, c.datum)
        panel.look.take(stage)
        return found

    return await asyncio.wrap_future(panel.session.post(order))


class Card:
    """The front panel of one chip in one browser."""

    def __init__(self, panel: Panel, live: Live, k: int):
        self.panel, self.live, self.k, self.axis = panel, live, k, 0
        stage = panel.session.stage
        self.front = Front(type(stage.chips[k]))
        self.names = axis_names(stage, k)
        self._rows: list[Row | WordRow] = []
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
        self.panel.look.want(self.k, self.axis)
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
        self.panel.look.want(self.k, self.axis)
        for row in self._rows:
            row.forget()

    def _registers(self) -> None:
        with _part("registers"), ui.element("div").classes("registers"):
            places: list[Place] = [*self.front.registers, *self.front.forms]
            for place in places:
                self._rows.append(Row(place, self.write, f"{self.k}-{place.name}"))

    def _lamps(self) -> None:
        kind = self.front.kind
        if self.front.lamps:
            with _part("status"):
                for word in self.front.lamps:
                    self._rows.append(WordRow(word))
        with _part("pins"):
            for what, pins in (("inputs", kind.INPUTS), ("outputs", kind.OUTPUTS)):
                with ui.element("div").classes("lamps"):
                    ui.label(what).classes("section")
                    for name in pins:
                        lamp = ui.label(name).classes("lamp").props(f'data-test="pin-{self.k}-{name}"')
                        self.live.lamp(lamp, partial(self._pin, what, name))

    def _commands(self) -> None:
        for group, buttons in self.front.buttons.items():
            reading = all(not b.starts for b in buttons) and len(buttons) > 12
            with _part(group, not reading), ui.element("div").classes("commands"):
                for b in buttons:
                    if not b.takes:
                        self._button(b)

    def _button(self, b: Button) -> None:
        async def press() -> None:
            cycles = self.front.kind.command_cycles(b.symbol, self.axis, b.datum)
            await self._send([Cycle(False, *cycle) for cycle in cycles])

        button = ui.button(f"{b.label}  {b.words}", on_click=press)
        button.props(f"dense no-caps outline size=sm {'color=positive' if b.starts else ''}")
        button.props["title"] = f"{b.title} [{b.evidence}]"
        code = f"-{b.datum:X}" if b.datum is not None else ""
        button.props["data-test"] = f"command-{self.k}-{b.symbol}{code}"

    async def write(self, place: Place, value: int) -> None:
        """Write a register, or a word, of the axis that is shown."""
        await self._send(writes(self.front.kind, place, value, self.axis))

    async def _send(self, cycles: Sequence[Cycle]) -> None:
        try:
            await send(self.panel, self.k, cycles)
        except StageError as error:
            ui.notify(str(error), type="negative")
        self._look()

    def _look(self) -> None:
        if not (self._built and self._body.value):
            return
        self.panel.look.want(self.k, self.axis)
        seen = self.panel.look.chips.get((self.k, self.axis))
        if seen is None:
            return
        for row in self._rows:
            row.look(seen.values)

    def _pin(self, what: str, name: str) -> bool:
        seen = self.panel.look.chips.get((self.k, self.axis))
        return bool(seen is not None and getattr(seen, what)[name])


def _part(title: str, opened: bool = True) -> ui.expansion:
    """A part of a front panel that can be folded."""
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
