"""The oscilloscope on the page: a chart for each unit and a lane for each pin, all drawn by one message a frame."""

from __future__ import annotations

import math
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import run, ui

from stage.errors import StageError
from stage.panel.browser_updates import BrowserUpdates
from stage.panel.oscilloscope import DIAGNOSTIC, FORMATS, LOST, MODES, SPANS, Oscilloscope, OscilloscopeFrame

if TYPE_CHECKING:
    from stage.panel.sampler import Trace
    from stage.panel.server import Panel


POINTS = 300  # columns of pixels that a curve is thin_curve to
FRAME_INTERVAL_S, FLAT_INTERVAL_S = 0.1, 0.5  # s between pictures, and of flat curves
HIGH, LANE, GAP, TOP, FOOT, HEAD = (
    120,
    18,
    30,
    8,
    26,
    18,
)  # pixels: of a chart, of a pin, between, above, below, for a unit
INK, FAINT = "#8a94a0", "#8a94a040"
COLOURS = ("#3b8ee0", "#e0813b", "#3bb273", "#b05bd0", "#d0485b", "#9a8b3a", "#3bb6c4", "#7c8794")
FREE_RUNNING = {"free": "no trigger", "auto": "auto", "normal": "normal", "single": "single"}


def build_oscilloscope(panel: Panel, updates: BrowserUpdates) -> None:
    """Build the oscilloscope of one browser."""
    if not panel.sampler.traces:
        return
    OscilloscopeView(panel, updates)


class OscilloscopeView:
    """Controls and picture of an oscilloscope."""

    def __init__(self, panel: Panel, updates: BrowserUpdates):
        self.sampler = panel.sampler
        traces = self.sampler.traces
        usual = [n for n in traces if n.endswith(("/position", "/rate"))][:4]
        org = [n for n in traces if n.endswith("/org")][:1]
        self.scope = Oscilloscope(self.sampler, usual + org, span=5.0)
        self._drawn: tuple | None = None
        self._requested: tuple | None = None
        self._flat, self._at = False, 0.0
        self._frame: OscilloscopeFrame | None = None
        with ui.card().classes("w-full q-pa-sm").props('data-test=scope role=group aria-label="Oscilloscope"'):
            self._controls(traces, updates)
            self.chart = ui.echart({}).classes("w-full").props("data-test=chart")
            self._build_charts()
        updates.call_method(self.chart, "run_chart_method", self._next_message, FRAME_INTERVAL_S)

    def _controls(self, traces: dict[str, Trace], updates: BrowserUpdates) -> None:
        names = {name: t.title + (f" ({t.unit})" if t.unit else "") for name, t in traces.items()}
        with ui.row().classes("w-full items-center q-gutter-xs no-wrap-md"):
            self.run_button = (
                ui.button("stop", on_click=self._toggle)
                .props("dense outline no-caps data-test=run")
                .tooltip("run or stop")
            )
            ui.select(_times(), value=self.scope.span, label="window", on_change=lambda e: self._base(e.value)).props(
                "dense options-dense outlined data-test=span"
            ).style("min-width: 112px")
            ui.select(
                names, value=self.scope.names, label="traces", multiple=True, on_change=lambda e: self._show(e.value)
            ).props("dense options-dense outlined use-chips data-test=traces").style("min-width: 220px; flex: 1")
        with ui.row().classes("w-full items-center q-gutter-xs"):
            self.mode = ui.select(
                {m: FREE_RUNNING[m] for m in MODES}, value="free", label="trigger", on_change=self._trigger
            ).props("dense options-dense outlined data-test=mode").style("min-width: 110px")  # fmt: skip
            self.source = ui.select(
                {DIAGNOSTIC: DIAGNOSTIC, LOST: LOST, **names}, value=LOST, label="at", with_input=True, on_change=self._trigger
            ).props("dense options-dense outlined data-test=source").style("min-width: 180px")  # fmt: skip
            self.edge = (
                ui.select({True: "rising", False: "falling"}, value=True, label="edge", on_change=self._trigger)
                .props("dense options-dense outlined data-test=edge")
                .style("min-width: 90px")
            )
            self.level = (
                ui.number("level", value=0.5, on_change=self._trigger)
                .props("dense outlined data-test=level debounce=400")
                .style("width: 90px")
            )
            state = ui.element("div").classes("text-caption number").props("data-test=scope-state")
            updates.show_text(state, self._state)
            ui.space()
            for ending in FORMATS:
                ui.button(ending.upper(), on_click=lambda e=ending: self._export(e)).props(
                    f"dense flat no-caps data-test=export-{ending}"
                ).tooltip(f"what the window shows, every sample, as .{ending}")

    # --- controls ---

    def _toggle(self) -> None:
        self.scope.running = not self.scope.running

    def _base(self, span: float) -> None:
        self.scope.set_span(span)

    def _show(self, names: list[str]) -> None:
        self.scope.select_traces(names)
        self._build_charts()

    def _trigger(self) -> None:
        level = 0.5 if self.level.value is None else self.level.value
        wanted = (self.mode.value, self.source.value or LOST, self.edge.value, level)
        if wanted == self._requested:  # a browser tells a value again when its field is left: what was caught stays
            return
        self._requested = wanted
        try:
            self.scope.set_trigger(*wanted)
        except StageError as error:
            ui.notify(str(error), type="negative")

    async def _export(self, ending: str) -> None:
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
        """Assign traces to charts again: they have changed."""
        chosen = [self.sampler.traces[n] for n in self.scope.names]
        units = list(dict.fromkeys(t.unit for t in chosen if not t.pin))
        places = [(unit, HIGH) for unit in units] + [(t.title, LANE) for t in chosen if t.pin]
        grids, xs, ys, top = [], [], [], TOP
        hidden = {"axisLine": {"show": False}, "axisTick": {"show": False}}
        for k, (title, height) in enumerate(places):
            tall, last = height == HIGH, k == len(places) - 1
            grids.append({"left": 78, "right": 14, "top": top + (HEAD if tall else 0), "height": height})
            top += height + (GAP if tall else 4)
            line = {"show": False} if not last else {"lineStyle": {"color": INK}}
            xs.append({"type": "value", "gridIndex": k, "min": 0, "max": 1,
                       "axisLabel": {"show": last, "color": INK, "hideOverlap": True},
                       "axisLine": line, "axisTick": {"show": last}, "splitLine": {"show": tall, "lineStyle": {"color": FAINT}},
                       "axisPointer": {"label": {"show": last}}})  # fmt: skip
            names = {"nameLocation": "end" if tall else "middle", "nameRotate": 0, "nameGap": 9 if tall else 40}
            ys.append({"type": "value", "gridIndex": k, "name": title, "nameTextStyle": {"color": INK, "fontSize": 11},
                       **names, "scale": tall, "splitNumber": 3, "axisLabel": {"show": tall, "color": INK},
                       "splitLine": {"show": tall, "lineStyle": {"color": FAINT}},
                       **({} if tall else {"min": 0, "max": 1.15, **hidden})})  # fmt: skip
        series, lane = [], len(units)
        for n, t in enumerate(chosen):
            at = lane if t.pin else units.index(t.unit)
            lane += t.pin
            series.append({"type": "line", "name": t.title, "xAxisIndex": at, "yAxisIndex": at, "showSymbol": False,
                           "animation": False, "lineStyle": {"width": 1.3}, "data": [],
                           "color": COLOURS[n % len(COLOURS)],
                           **({"step": "end", "areaStyle": {"opacity": 0.35}} if t.pin else {})})  # fmt: skip
        legend = [t.title for t in chosen if not t.pin]
        self.chart.options.clear()
        self.chart.options.update(
            {"animation": False, "grid": grids, "xAxis": xs, "yAxis": ys, "series": series,
             "legend": {"data": legend, "type": "scroll", "top": 0, "left": 140, "right": 8,
                        "itemHeight": 8, "textStyle": {"color": INK, "fontSize": 11}},
             "axisPointer": {"link": [{"xAxisIndex": "all"}]},
             "tooltip": {"trigger": "axis", "transitionDuration": 0, "confine": True, "textStyle": {"fontSize": 11}}}
        )  # fmt: skip
        self.chart.style(f"height: {top + FOOT}px")
        self.chart.update()
        self._drawn, self._flat = None, False

    def _next_message(self) -> list | None:
        scope = self.scope
        frame = self._frame = scope.frame(POINTS)
        running = "stop" if scope.running else "run"
        if self.run_button.text != running:
            self.run_button.text = running
        drawn = (frame.begin, frame.end, self.sampler.last if frame.end >= self.sampler.last else None, *scope.names)
        flat = all(len(values) == 0 or values.min() == values.max() for _, values in frame.curves.values())
        if drawn == self._drawn or (flat and self._flat and perf_counter() - self._at < FLAT_INTERVAL_S):
            return None
        self._drawn, self._flat, self._at = drawn, flat, perf_counter()
        return ["setOption", self._message(frame)]

    def _state(self) -> str:
        frame = self._frame
        if frame is None or frame.trigger is None:
            return frame.state if frame else ""
        return f"{frame.state}, trigger at {frame.trigger:.6f} s"

    def _message(self, frame: OscilloscopeFrame) -> dict[str, Any]:
        """Return the curves and the time below them: s, or ms; from the trigger, where there is one."""
        short = frame.end - frame.begin < 1
        k, origin = (1e3 if short else 1.0), frame.trigger or 0.0
        axes = len(self.chart.options["xAxis"])
        low, high = _round((frame.begin - origin) * k), _round((frame.end - origin) * k)
        since = "from the trigger" if frame.trigger is not None else ""
        unit = f"{'ms' if short else 's'} {since}".strip()
        x = [{"min": low, "max": high} for _ in range(axes)]
        if x:
            x[-1].update(name=unit, nameLocation="middle", nameGap=22, nameTextStyle={"color": INK})  # type: ignore[call-overload]
        series = []
        for name, (times, values) in frame.curves.items():
            at = np.round((times - origin) * k, 4 if short else 5)
            points = np.stack([at, _significant(values, self.sampler.traces[name].places)], axis=1)
            series.append({"data": points[_corners(points[:, 1])].tolist()})
        return {"xAxis": x, "series": series}


def _round(value: float) -> float:
    return round(value, 4)


def _significant(values: np.ndarray, places: int) -> np.ndarray:
    """Round to six digits of the greatest value, what a screen can show, and to `places` decimals at most, so that what rests is
    level."""
    top = float(np.max(np.abs(values), initial=0.0))
    digits = min(places, 5 - math.floor(math.log10(top))) if top > 0 else 0
    return np.round(np.asarray(values, float), digits) + 0.0  # no -0


def _corners(values: np.ndarray) -> np.ndarray:
    """Return which points of a curve are needed: not those between two of the same value."""
    needed = np.ones(len(values), bool)
    needed[1:-1] = (values[1:-1] != values[:-2]) | (values[1:-1] != values[2:])
    return needed


def _times() -> dict[float, str]:
    return {s: f"{s * 1e3:g} ms" if s < 1 else f"{s:g} s" for s in SPANS}
