"""`Scope`: what an oscilloscope shows of a `Sampler`: a window of time, traces, a trigger. No page.

scope = Scope(sampler, ["x/rate", "x/org"], span=0.5)
scope.trigger("normal", "x/org", rising=True)
frame = scope.frame(600)            frame.curves["x/rate"]: (times, values) for 600 columns of pixels
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stage.errors import ArgumentError
from stage.panel.sampler import LONGEST, Sampler

SHORTEST = 1e-3  # s
SPANS = (1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
MODES = ("free", "auto", "normal", "single")
DIAGNOSTIC, LOST = "a diagnostic", "a lost step"
BEFORE = 0.25  # of the window lies before the trigger
PATIENCE = 1.0  # s of simulated time after which "auto" shows what there is


@dataclass(frozen=True)
class Frame:
    """One picture. begin, end: s; curves: by trace, times (s) and values; trigger: its time, s, or None; state: in a word."""

    begin: float
    end: float
    curves: dict[str, tuple[np.ndarray, np.ndarray]]
    trigger: float | None
    state: str


class Scope:
    """Args: names of traces; span: s of the window. Raises ArgumentError."""

    def __init__(self, sampler: Sampler, names: Sequence[str] = (), span: float = 2.0):
        self.sampler = sampler
        self.names: list[str] = []
        self.show(names)
        self.mode, self.source, self.rising, self.level = "free", "", True, 0.5
        self._armed, self._at, self._window = -1.0, None, (0.0, span)  # type: float, float | None, tuple[float, float]
        self._running, self._seen = True, -1.0
        self.base(span)
        self.arm()

    def show(self, names: Sequence[str]) -> None:
        """These traces. Raises ArgumentError with the near misses."""
        self.names = [self.sampler.trace(name).name for name in names]

    def base(self, span: float) -> None:
        """The window is `span` s long."""
        if not SHORTEST <= span <= LONGEST:
            raise ArgumentError(f"span={span!r}: a window of {SHORTEST:g} to {LONGEST:g} s.")
        centre = self._at
        self.span = float(span)
        if centre is not None and not self._running:
            self._window = self._around(centre)
        elif not self._running:
            self._window = (self._window[1] - span, self._window[1])

    def trigger(self, mode: str, source: str = "", rising: bool = True, level: float = 0.5) -> None:
        """mode: "free", no trigger; "auto", by itself where none comes; "normal", only by the trigger; "single", once. source: a
        trace, which crosses `level` (a pin: its edge), or DIAGNOSTIC, or LOST. Raises ArgumentError."""
        if mode not in MODES:
            raise ArgumentError(f"mode={mode!r}: {', '.join(MODES)}.")
        if mode != "free" and source not in (DIAGNOSTIC, LOST):
            level = 0.5 if self.sampler.trace(source).pin else level
        if not np.isfinite(level):
            raise ArgumentError(f"level={level!r}: a number, in the unit of the trace.")
        self.mode, self.source, self.rising, self.level = mode, source, rising, float(level)
        self.arm()

    def arm(self) -> None:
        """Wait for the next trigger, from now on."""
        self._armed, self._at, self._running = self.sampler.last, None, True
        self._seen = self._armed

    @property
    def running(self) -> bool:
        """Follows the time; False: the picture stands."""
        return self._running

    @running.setter
    def running(self, value: bool) -> None:
        if value and not self._running:
            self.arm()
        self._running = bool(value)

    def frame(self, points: int) -> Frame:
        """The picture now, for so many columns of pixels."""
        now = self.sampler.last
        if self._running:
            self._follow(now)
        begin, end = self._window
        curves = self.sampler.drawn(self.names, begin, end, points)
        return Frame(begin, end, curves, self._at, self._state(now))

    def _follow(self, now: float) -> None:
        if now < self._seen:  # time has gone back: what was shown is not any more
            self._armed, self._at, self._window = now, None, (now - self.span, now)
        self._seen = now
        if self.mode == "free":
            self._window = (now - self.span, now)
            return
        if self._at is None or now >= self._window[1]:
            if self.mode == "single" and self._at is not None:
                self._running = False
                return
            if (found := self._found(now)) is not None:
                self._at, self._window = found, self._around(found)
                self._armed = self._window[1]
                if self.mode == "single" and now >= self._window[1]:
                    self._running = False
            elif self.mode == "auto" and now - self._armed > max(PATIENCE, self.span):
                self._at, self._window = None, (now - self.span, now)

    def _around(self, at: float) -> tuple[float, float]:
        return at - BEFORE * self.span, at + (1 - BEFORE) * self.span

    def _found(self, now: float) -> float | None:
        """When the trigger came after `armed`: the latest whose window is full; the first of all, for "single" and before that."""
        at = self._moments(now)
        if not len(at):
            return None
        full = at[at + (1 - BEFORE) * self.span <= now]
        return float(full[-1] if len(full) and self.mode != "single" else at[0])

    def _moments(self, now: float) -> np.ndarray:
        since = self._armed
        if self.source == DIAGNOSTIC:
            return np.array([e.time for e in tuple(self.sampler.events) if since < e.time <= now])
        lost = [n for n in self.sampler.traces if n.endswith("/lost_steps")]
        names = lost if self.source == LOST else [self.source]
        times, values = self.sampler.columns(names, since, now)
        moments = []
        for v in values.values():
            if self.source == LOST:
                k = np.flatnonzero(np.diff(v) != 0)
            else:
                above = (v >= self.level) == self.rising
                k = np.flatnonzero(above[1:] & ~above[:-1])
            moments.append(times[k + 1])
        return np.sort(np.concatenate(moments)) if moments else np.empty(0)

    def _state(self, now: float) -> str:
        if not self._running:
            return "stopped"
        if self.mode == "free":
            return "running"
        return "triggered" if self._at is not None and now < self._window[1] else "waits for the trigger"


__all__ = ["BEFORE", "DIAGNOSTIC", "LOST", "MODES", "SPANS", "Frame", "Scope"]
