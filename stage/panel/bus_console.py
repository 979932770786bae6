"""The bus console: lines that become bus cycles, and beside them all that happens on the bus, in words."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from stage.errors import ArgumentError, StageError
from stage.panel.browser_updates import BrowserUpdates, TextLog
from stage.panel.chip_panel import axis_names, send
from stage.panel.register_text import complete_name, parse_line
from stage.panel.stage_observer import LINES, view_axis_of

if TYPE_CHECKING:
    from stage.panel.server import Panel


KEYS = """(e) => {
  const k = e.key;
  if (k === 'Enter' || k === 'Escape') emit(k);
  else if (k === 'ArrowUp' || k === 'ArrowDown') { e.preventDefault(); emit(k); }
  else if (k === 'Tab' && !e.shiftKey && /\\S$/.test(e.target.value)) { e.preventDefault(); emit(k); }
}"""
"""Tab completes a name; after a space, or in an empty line, it goes on to the next control as everywhere."""


def build_console(panel: Panel, updates: BrowserUpdates) -> None:
    """Build the console of all chips."""
    with ui.card().classes("w-full q-pa-sm"):
        Console(panel, updates)


class Console:
    """Console of one browser: its target, its earlier lines, and what it has shown of the trace."""

    def __init__(self, panel: Panel, updates: BrowserUpdates):
        self._panel, self._target = panel, (0, 0)
        self._past: list[str] = []
        self._at, self._shown = 0, 0
        self._said = [0] * len(panel.observer.traces)
        stage = panel.session.stage
        self._names = [axis_names(stage, k) for k in range(len(stage.chips))]
        targets = {
            (k, j): f"{name}: {type(stage.chips[k]).__name__}"
            for k, names in enumerate(self._names)
            for j, name in names.items()
        }
        self._targets = list(targets)
        with ui.row().classes("w-full items-start no-wrap q-gutter-sm"):
            chips = dict(enumerate(targets.values()))
            chosen = ui.select(chips, value=0, label="bus", on_change=lambda e: self._choose(e.value))
            chosen.props("dense options-dense").props('data-test="console-target"').style("min-width: 110px")
            self._line: Any = ui.input(placeholder="10 15   R1 <- 100   read 0   help").classes("col number")
            self._line.props("dense hide-bottom-space autocomplete=off spellcheck=false aria-label='bus console'")
            self._line.props('data-test="console"').on("keydown", self._key, js_handler=KEYS)
        self._log = (
            TextLog(updates, LINES).classes("trace w-full").props('data-test="trace" aria-label="the bus, in words"')
        )
        with (
            ui.expansion("diagnostics").props("dense").classes("w-full").props('data-test="diagnostics"') as self._noted
        ):
            self._diagnostics_log = TextLog(updates, LINES).classes("trace w-full").style("height: 130px")
            self._diagnostics_log.props('data-test="diagnosed" aria-label="diagnostics"')
        ui.timer(0.1, self._look)

    def _choose(self, index: int) -> None:
        before, self._target = self._target, self._targets[index]
        if before[0] != self._target[0]:
            self._shown = 0
            self._log.empty()

    async def _key(self, event: GenericEventArguments) -> None:
        key, text = event.args, self._line.value or ""
        if key == "Enter":
            await self._enter(text)
        elif key == "Escape":
            self._line.value, self._line.error = "", None
        elif key == "Tab":
            self._complete(text)
        elif self._past:
            self._at = max(0, min(len(self._past), self._at + (-1 if key == "ArrowUp" else 1)))
            self._line.value = self._past[self._at] if self._at < len(self._past) else ""

    def _complete(self, text: str) -> None:
        found = complete_name(type(self._panel.session.stage.chips[self._target[0]]), text)
        head, _, last = text.rpartition(" ")
        common = found[0] if found else last
        for name in found:
            while not name.upper().startswith(common.upper()):
                common = common[:-1]
        self._line.value = f"{head} {common}".lstrip() + (" " if len(found) == 1 else "")
        if len(found) > 1 and len(common) <= len(last):
            self._log.append("  ".join(found[:40]), "own")

    async def _enter(self, text: str) -> None:
        k, axis = self._target
        session = self._panel.session
        kind = type(session.stage.chips[k])
        try:
            values = await asyncio.wrap_future(session.post(lambda stage: view_axis_of(stage.chips[k], axis).values))
            order = parse_line(kind, text, axis, values)
            self._log.append(f"> {text}", "own")
            self._line.value, self._line.error = "", None
            self._past = [*self._past[-199:], text] if self._past[-1:] != [text] else self._past
            self._at = len(self._past)
            if order.cycles:
                await send(self._panel, k, order.cycles)
            if order.answer:
                self._log.append(order.answer, "own")
        except (ArgumentError, StageError) as error:
            self._line.error = str(error)
            self._line.run_method("select")
        self._look()

    def _look(self) -> None:
        k = self._target[0]
        trace = self._panel.observer.traces[k]
        for line in trace.since(self._shown):
            self._shown = line.number
            self._log.append(line.text(trace.digits), "bad" if line.way in ("!", "lost") else "", line.first)
        new = 0
        for j, one in enumerate(self._panel.observer.traces):
            for line in [d for d in tuple(one.said) if d.number > self._said[j]]:
                self._said[j], new = line.number, new + 1
                self._diagnostics_log.append(f"{'/'.join(self._names[j].values())} {line.text(one.digits)}", "bad")
        if new:
            total = sum(len(one.said) for one in self._panel.observer.traces)
            self._noted.text = f"diagnostics ({total})"
