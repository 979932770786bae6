"""The bus console: an input whose lines become bus cycles, and a list that describes all that happens on the bus."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from stage.errors import StageError
from stage.panel.browser_updates import BrowserUpdates, TextLog
from stage.panel.chip_panel import list_axis_names, make_bus_cycles
from stage.panel.front_panel_content import list_completions, parse_line
from stage.panel.stage_observer import DIAGNOSTIC, MAX_LINES, build_chip_view

if TYPE_CHECKING:
    from stage.panel.server import Panel


KEYS = """(e) => {
  const k = e.key;
  if (k === 'Enter' || k === 'Escape') emit(k);
  else if (k === 'ArrowUp' || k === 'ArrowDown') { e.preventDefault(); emit(k); }
  else if (k === 'Tab' && !e.shiftKey && /\\S$/.test(e.target.value)) { e.preventDefault(); emit(k); }
}"""
"""Tab completes a name; after a space, or in an empty line, it goes on to the next control as everywhere."""


class BusConsole:
    """Bus console of one browser: the selected chip and axis, the earlier input lines, and the bus trace."""

    def __init__(self, panel: Panel, updates: BrowserUpdates):
        self._panel, self._target = panel, (0, 0)
        self._history: list[str] = []
        self._history_index, self._last_line = 0, 0
        self._last_diagnostics = [0] * len(panel.observer.traces)
        stage = panel.session.stage
        self._names = [list_axis_names(stage, k) for k in range(len(stage.chips))]
        self._targets = [(k, axis) for k, names in enumerate(self._names) for axis in names]
        titles = [f"{self._names[k][axis]}: {type(stage.chips[k]).__name__}" for k, axis in self._targets]
        with ui.card().classes("w-full console").props("data-test=console-card") as self._card:
            with ui.row().classes("w-full items-start no-wrap gap-3"):
                ui.label("Bus console").classes("section self-center gt-xs")
                chips = dict(enumerate(titles))
                select = ui.select(chips, value=0, label="bus", on_change=lambda e: self._select_target(e.value))
                select.props('dense options-dense data-test="console-target"').style("min-width: 110px")
                self._line: Any = ui.input(placeholder="10 15   R1 <- 100   read 0   help").classes("col number")
                self._line.props("dense hide-bottom-space autocomplete=off spellcheck=false aria-label='bus console'")
                self._line.props('data-test="console"').on("keydown", self._handle_key, js_handler=KEYS)
            self._log = TextLog(updates, MAX_LINES).classes("trace w-full")
            self._log.props('data-test="trace" aria-label="the bus, in words"')
            self._fold = ui.expansion("diagnostics").props("dense").classes("w-full").props('data-test="diagnostics"')
            self._fold.set_visibility(False)
            with self._fold:
                self._diagnostics_log = TextLog(updates, MAX_LINES).classes("trace w-full").style("height: 130px")
                self._diagnostics_log.props('data-test="diagnosed" aria-label="diagnostics"')
        ui.timer(0.1, self._show_new_lines)

    def _select_target(self, index: int) -> None:
        before, self._target = self._target, self._targets[index]
        if before[0] != self._target[0]:
            self._last_line = 0
            self._log.remove_all_lines()

    async def _handle_key(self, event: GenericEventArguments) -> None:
        key, text = event.args, self._line.value or ""
        if key == "Enter":
            await self._execute_line(text)
        elif key == "Escape":
            self._line.value, self._line.error = "", None
        elif key == "Tab":
            self._complete_name(text)
        elif self._history:
            step = -1 if key == "ArrowUp" else 1
            self._history_index = max(0, min(len(self._history), self._history_index + step))
            self._line.value = [*self._history, ""][self._history_index]

    def _complete_name(self, text: str) -> None:
        """Complete the last word of the input line as far as it is unique, and list the matches if there are several."""
        matches = list_completions(type(self._panel.session.stage.chips[self._target[0]]), text)
        head, _, last = text.rpartition(" ")
        common = matches[0] if matches else last
        while not all(name.upper().startswith(common.upper()) for name in matches):
            common = common[:-1]
        self._line.value = f"{head} {common}".lstrip() + (" " if len(matches) == 1 else "")
        if len(matches) > 1 and len(common) <= len(last):
            self._log.append("  ".join(matches[:40]), "own")

    async def _execute_line(self, text: str) -> None:
        """Make the bus cycles of an input line, or show its answer or its error."""
        k, axis = self._target
        session = self._panel.session
        try:
            values = await asyncio.wrap_future(session.post(lambda stage: build_chip_view(stage.chips[k], axis).values))
            command = parse_line(type(session.stage.chips[k]), text, axis, values)
            self._card.classes("used")
            self._log.append(f"> {text}", "own")
            self._line.value, self._line.error = "", None
            if self._history[-1:] != [text]:
                self._history = [*self._history[-199:], text]
            self._history_index = len(self._history)
            if command.cycles:
                await make_bus_cycles(self._panel, k, command.cycles)
            if command.answer:
                self._log.append(command.answer, "own")
        except StageError as error:
            self._line.error = str(error)
            self._line.run_method("select")
        self._show_new_lines()

    def _show_new_lines(self) -> None:
        """Show the new lines of the bus trace, and the new diagnostics of all chips."""
        traces = self._panel.observer.traces
        trace = traces[self._target[0]]
        for line in trace.get_lines_after(self._last_line):
            self._last_line = line.number
            self._log.append(line.format(trace.digits), "bad" if line.kind in (DIAGNOSTIC, "lost") else "", line.first)
        diagnostics = [tuple(trace.diagnostics) for trace in traces]
        numbers = [[0, *(line.number for line in lines)] for lines in diagnostics]
        if [n[-1] for n in numbers] == self._last_diagnostics:
            return
        if any(last not in n for last, n in zip(self._last_diagnostics, numbers, strict=True)):
            self._diagnostics_log.remove_all_lines()  # somebody went back in time
            self._last_diagnostics = [0] * len(traces)
        for k, lines in enumerate(diagnostics):
            names = "/".join(self._names[k].values())
            for line in lines:
                if line.number > self._last_diagnostics[k]:
                    self._diagnostics_log.append(f"{names} {line.format(traces[k].digits)}", "bad")
        self._last_diagnostics = [n[-1] for n in numbers]
        self._fold.set_visibility(any(diagnostics))
        self._fold.text = f"diagnostics ({sum(map(len, diagnostics))})"
