"""The oscilloscope on the page: a chart for each unit and a lane for each pin, all drawn by one message a frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import run, ui

from stage.errors import StageError
from stage.panel.browser_updates import BrowserUpdates
from stage.panel.oscilloscope import (
    DIAGNOSTIC,
    FORMATS,
    LOST,
    MODES,
    WINDOW_LENGTHS_S,
    Oscilloscope,
    OscilloscopeFrame,
    format_heading,
)

if TYPE_CHECKING:
    from stage.panel.server import Panel


POINTS = 300  # columns of pixels of a curve
FRAME_INTERVAL_S, FLAT_INTERVAL_S = 0.1, 0.5  # s between pictures, and of flat curves
CHART_HEIGHT, LANE_HEIGHT, GAP, LANE_GAP, TOP, FOOT, UNIT_HEIGHT = 84, 16, 12, 4, 4, 34, 18  # pixels
INK, FAINT = "#8a94a0", "#8a94a040"
COLORS = ("#3b8ee0", "#e0813b", "#3bb273", "#b05bd0", "#3bb6c4", "#9a8b3a", "#a0694a", "#7c8794")  # red is for mistakes
TRIGGER_TITLES = {"free": "no trigger", "auto": "auto", "normal": "normal", "single": "single"}


class OscilloscopeView:
    """Part of the page with the picture of an oscilloscope and its controls."""

    def __init__(self, panel: Panel, updates: BrowserUpdates):
        self.sampler = panel.sampler
        traces = self.sampler.traces
        usual = [n for n in traces if n.endswith(("/position", "/rate"))][:4]
        org = [n for n in traces if n.endswith("/org")][:1]
        self.scope = Oscilloscope(self.sampler, usual + org, window_s=5.0)
        self._drawn: tuple | None = None
        self._requested_trigger: tuple | None = None
        self._flat, self._drawn_at = False, 0.0
        self._frame: OscilloscopeFrame | None = None
        with ui.card().classes("w-full scope").props('data-test=scope role=group aria-label="Oscilloscope"'):
            titles = {name: format_heading(trace) for name, trace in traces.items()}
            modes = {mode: TRIGGER_TITLES[mode] for mode in MODES}
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                ui.label("Oscilloscope").classes("section")
                self.run_button = ui.button("Freeze", icon="ac_unit", on_click=self._toggle_running)
                self.run_button.props("dense outline no-caps data-test=run")
                self.run_button.tooltip("freeze the picture, or let it follow the time; nothing stops")
                spans = {s: f"{s * 1e3:g} ms" if s < 1 else f"{s:g} s" for s in WINDOW_LENGTHS_S}
                self._build_select("window", "span", 100, spans, self.scope.window_s, self._set_window_length)
                self.mode = self._build_select("trigger", "mode", 104, modes, "free", self._set_trigger)
                self.traces = self._build_select(
                    "traces", "traces", 96, titles, self.scope.names, self._select_traces, True
                )
                state = (
                    ui.element("div")
                    .classes("scope-state text-caption number col ellipsis")
                    .props("data-test=scope-state")
                )
                updates.bind_text(state, self._describe_state)
                with (
                    ui.button(icon="save_alt").props("flat dense round aria-label='save the window' data-test=export"),
                    ui.menu(),
                ):
                    for ending in FORMATS:
                        item = ui.menu_item(f"the window as .{ending}, every sample", partial(self._export, ending))
                        item.props(f"data-test=export-{ending}")
            with ui.row().classes("w-full items-center gap-2") as self.trigger_row:
                sources = {DIAGNOSTIC: DIAGNOSTIC, LOST: LOST, **titles}
                edges = {True: "rising", False: "falling"}
                self.source = self._build_select("at", "source", 180, sources, LOST, self._set_trigger)
                self.edge = self._build_select("edge", "edge", 90, edges, True, self._set_trigger)
                self.level = ui.number("level", value=0.5, on_change=self._set_trigger).style("width: 90px")
                self.level.props("dense outlined data-test=level debounce=400")
            self.trigger_row.set_visibility(False)
            self.chart = ui.echart({}).classes("w-full").props("data-test=chart")
            self._build_charts()
        updates.call_method_repeatedly(self.chart, "run_chart_method", self._build_next_message, FRAME_INTERVAL_S)

    def _build_select(
        self,
        label: str,
        mark: str,
        width: int,
        options: dict,
        value: Any,
        handler: Callable[..., None],
        multiple: bool = False,
    ) -> ui.select:
        select = ui.select(
            options, value=value, label=label, on_change=handler, multiple=multiple, with_input=mark == "source"
        )
        return select.props(f"dense options-dense outlined data-test={mark}").style(f"min-width: {width}px")

    # --- controls ---

    def _toggle_running(self) -> None:
        self.scope.running = not self.scope.running

    def _set_window_length(self, event: Any) -> None:
        self.scope.set_window_length(event.value)

    def _select_traces(self, event: Any) -> None:
        self.scope.select_traces(event.value)
        self._build_charts()

    def _set_trigger(self) -> None:
        self.trigger_row.set_visibility(self.mode.value != "free")
        level = 0.5 if self.level.value is None else self.level.value
        trigger = (self.mode.value, self.source.value or LOST, self.edge.value, level)
        # a browser sends a value again when its field is left: the picture stays
        if trigger == self._requested_trigger:
            return
        self._requested_trigger = trigger
        try:
            self.scope.set_trigger(*trigger)
        except StageError as error:
            ui.notify(str(error), type="negative")

    async def _export(self, ending: str) -> None:
        """Send the browser a file of the picture in the format of a file name ending, for example "csv"."""
        frame = self._frame
        if frame is None:
            return
        try:
            data = await run.io_bound(FORMATS[ending], self.sampler, list(self.scope.names), frame.begin, frame.end)
        except StageError as error:
            ui.notify(str(error), type="negative")
            return
        ui.download.content(data or b"", f"pulsestage-{frame.end:.3f}s.{ending}")

    # --- picture ---

    def _build_charts(self) -> None:
        """Build the charts for the selected traces: a chart for each unit, a lane for each pin."""
        traces = [self.sampler.traces[n] for n in self.scope.names]
        units = list(dict.fromkeys(t.unit for t in traces if not t.pin))
        titles = [*units, *(t.title for t in traces if t.pin)]
        options: dict[str, Any] = {
            "animation": False, "grid": [], "xAxis": [], "yAxis": [], "series": [],
            "legend": {"data": [t.title for t in traces if not t.pin], "type": "scroll", "top": 0, "left": 140, "right": 8,
                       "itemHeight": 8, "textStyle": {"color": INK, "fontSize": 11}},
            "axisPointer": {"link": [{"xAxisIndex": "all"}]},
            "tooltip": {"trigger": "axis", "transitionDuration": 0, "confine": True, "textStyle": {"fontSize": 11}},
        }  # fmt: skip
        top = TOP
        for k, title in enumerate(titles):
            is_chart = k < len(units)
            height, head, gap = (CHART_HEIGHT, UNIT_HEIGHT, GAP) if is_chart else (LANE_HEIGHT, 0, LANE_GAP)
            options["grid"].append({"left": 78, "right": 14, "top": top + head, "height": height})
            options["xAxis"].append(_build_x_axis(k, is_chart, k == len(titles) - 1))
            options["yAxis"].append(_build_y_axis(k, is_chart, title))
            top += head + height + gap
        lanes = iter(range(len(units), len(titles)))
        for n, t in enumerate(traces):
            place = next(lanes) if t.pin else units.index(t.unit)
            style = {"step": "end", "areaStyle": {"opacity": 0.35}} if t.pin else {}
            options["series"].append({
                "type": "line", "name": t.title, "xAxisIndex": place, "yAxisIndex": place, "showSymbol": False,
                "animation": False, "lineStyle": {"width": 1.3}, "data": [], "color": COLORS[n % len(COLORS)], **style,
            })  # fmt: skip
        self.traces.props(f'display-value="{len(traces)} shown"')
        self.chart.options.clear()
        self.chart.options.update(options)
        self.chart.style(f"height: {top + FOOT}px")
        self.chart.update()
        self._drawn, self._flat = None, False

    def _build_next_message(self) -> list | None:
        scope = self.scope
        frame = self._frame = scope.capture_frame(POINTS)
        running = "Freeze" if scope.running else "Follow"
        if self.run_button.text != running:
            self.run_button.text = running
        drawn = (
            frame.begin,
            frame.end,
            self.sampler.last_time if frame.end >= self.sampler.last_time else None,
            *scope.names,
        )
        flat = all(len(values) == 0 or values.min() == values.max() for _, values in frame.curves.values())
        if drawn == self._drawn or (flat and self._flat and perf_counter() - self._drawn_at < FLAT_INTERVAL_S):
            return None
        self._drawn, self._flat, self._drawn_at = drawn, flat, perf_counter()
        return ["setOption", self._build_chart_message(frame)]

    def _describe_state(self) -> str:
        frame = self._frame
        if frame is None or frame.trigger is None:
            return frame.state if frame else ""
        return f"{frame.state}, trigger at {frame.trigger:.6f} s"

    def _build_chart_message(self, frame: OscilloscopeFrame) -> dict[str, Any]:
        """Return the options of the chart library for a frame: the curves, and a time axis in s or ms, from the trigger if any."""
        short = frame.end - frame.begin < 1
        k, origin = (1e3 if short else 1.0), frame.trigger or 0.0
        axes = len(self.chart.options["xAxis"])
        low, high = (round((time - origin) * k, 4) for time in (frame.begin, frame.end))
        since = "from the trigger" if frame.trigger is not None else ""
        unit = f"{'ms' if short else 's'} {since}".strip()
        x = [{"min": low, "max": high} for _ in range(axes)]
        if x:
            x[-1].update(name=unit, nameLocation="middle", nameGap=22, nameTextStyle={"color": INK})  # type: ignore[call-overload]
        series = []
        for name, (times, values) in frame.curves.items():
            at = np.round((times - origin) * k, 4 if short else 5)
            points = np.stack([at, _round_to_significant_digits(values, self.sampler.traces[name].places)], axis=1)
            series.append({"data": points[_mark_needed_points(points[:, 1])].tolist()})
        return {"xAxis": x, "series": series}


def _build_x_axis(chart_index: int, is_chart: bool, is_last: bool) -> dict[str, Any]:
    return {
        "type": "value", "gridIndex": chart_index, "min": 0, "max": 1,
        "axisLabel": {"show": is_last, "color": INK, "hideOverlap": True},
        "axisLine": {"lineStyle": {"color": INK}} if is_last else {"show": False}, "axisTick": {"show": is_last},
        "splitLine": {"show": is_chart, "lineStyle": {"color": FAINT}}, "axisPointer": {"label": {"show": is_last}},
    }  # fmt: skip


def _build_y_axis(chart_index: int, is_chart: bool, title: str) -> dict[str, Any]:
    hidden = {"min": 0, "max": 1.15, "axisLine": {"show": False}, "axisTick": {"show": False}}
    return {
        "type": "value", "gridIndex": chart_index, "name": title, "nameTextStyle": {"color": INK, "fontSize": 11},
        "nameLocation": "end" if is_chart else "middle", "nameRotate": 0, "nameGap": 9 if is_chart else 40,
        "scale": is_chart, "splitNumber": 3, "axisLabel": {"show": is_chart, "color": INK},
        "splitLine": {"show": is_chart, "lineStyle": {"color": FAINT}}, **({} if is_chart else hidden),
    }  # fmt: skip


def _round_to_significant_digits(values: np.ndarray, places: int) -> np.ndarray:
    """Round values to six digits of the greatest one and at most `places` decimals, so that an axis at rest shows a level line."""
    top = float(np.max(np.abs(values), initial=0.0))
    digits = min(places, 5 - math.floor(math.log10(top))) if top > 0 else 0
    return np.round(np.asarray(values, float), digits) + 0.0  # no -0


def _mark_needed_points(values: np.ndarray) -> np.ndarray:
    """Return a mask of the points that a curve needs: all but those between two points of the same value."""
    needed = np.ones(len(values), bool)
    needed[1:-1] = (values[1:-1] != values[:-2]) | (values[1:-1] != values[2:])
    return needed
