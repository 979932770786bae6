"""The a:b move: several chips, one straight line.

    stage = Stage("xyz")
    report = synchronized_move({"x": 20_000, "y": -7_500}, stage)

It is planned, written to the chips, and started by one start command after the other, the longest axis last.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.errors import ArgumentError, RunTimeout, unknown
from stage.firmware.axis import Axis, check
from stage.firmware.path import Deviation, path_deviation, pulses_of
from stage.firmware.pcl240 import bus
from stage.firmware.pcl240.moves import SETTLE
from stage.firmware.pcl240.plan import Plan, plan
from stage.firmware.pcl240.profile import ACCEL, FH1, FL
from stage.firmware.report import Procedure, Report

if TYPE_CHECKING:
    from os import PathLike

WORTH_IT = 0.02  # pulses that a plan for the bus delay may be better than one for a common start
LOOKS = 200  # at the status bytes of a long move


@dataclass(frozen=True)
class SynchronizedReport:
    """What the axes did together.

    Attributes:
        axes: a Report for each axis that moved. plan: the registers and what was expected of them.
        deviation: the largest distance from the straight line in pulses, with its time (s from the first start command) and
            the counts then.
        skew: seconds between the first start command and the last.
        finish: seconds between the first axis' last pulse and the last axis'.
        carriage_deviation: m, the largest distance of the carriages from the line while they moved, looked at every
            millisecond; None without a stage. Motors lag behind their pulses, and not all alike.
        paths: for each axis (times in s since the first start command, directions) of its pulses.
    """

    axes: dict[str, Report]
    plan: Plan
    deviation: Deviation
    skew: float
    finish: float
    carriage_deviation: float | None
    paths: dict[str, tuple[np.ndarray, np.ndarray]] = field(repr=False)

    @property
    def ok(self) -> bool:
        """Every axis made its pulses, and lost none."""
        return all(r.ok for r in self.axes.values())

    @property
    def ratio_error(self) -> float:
        """The largest relative error of a planned rate against the longest axis'."""
        return self.plan.ratio_error

    def __str__(self) -> str:
        d, counts = self.deviation, dict(zip(self.paths, self.deviation.counts, strict=True))
        where = ", ".join(f"{n} {c:+d}" for n, c in counts.items())
        lines = [
            f"synchronized move: {'done' if self.ok else 'NOT as asked'}, {d.pulses:.2f} pulses from the line at most "
            f"(at {d.time:.4f} s, {where})",
            f"  started within {self.skew * 1e6:.1f} us, finished within {self.finish * 1e3:.3f} ms, "
            f"ratio error {self.ratio_error:.1e}",
        ]
        if self.carriage_deviation is not None:
            lines.append(f"  carriages {self.carriage_deviation * 1e6:.1f} um from the line at most")
        return "\n".join([*lines, *(str(r) for r in self.axes.values())])

    def plot(self, path: str | PathLike | None = None, title: str | None = None, *, overwrite: bool = False) -> Any:
        """Draw the path with its distance from the line magnified, and the rates over time; saves to `path` if given.

        A file that exists stays, unless `overwrite`: FileError. Returns the figure. Needs matplotlib (extra `plot`).
        """
        from stage.firmware.plot_path import draw

        return draw(self, path, title, overwrite)


def synchronized_move(
    distances: Mapping[Any, int] | Plan,
    axes: Any = None,
    *,
    rate: float = FH1,
    fl: float = FL,
    accel: float = ACCEL,
    decel: float | None = None,
    s_curve: bool | float = False,
    automatic: bool | None = None,
    timeout: float | None = None,
) -> SynchronizedReport:
    """Move several axes along a straight line, by bus cycles only.

    Args:
        distances: axis name (or axis) -> signed pulses; 0 keeps an axis still. Or a Plan made before.
        axes: where the names are: a stage, a bench, or a mapping such as stage.axes. Not needed when the keys are axes.
        rate, fl: FH and FL of the longest axis, pps. accel, decel: ramp times, s; decel defaults to accel.
        s_curve: True for S-curves throughout, a share (0 to 0.5) of FH - FL for curved ends with a linear part between, False
            for linear ramps. Every axis that moves needs a PCL240MS for it.
        automatic: the chips find the ramp-down point themselves, and decelerate as they accelerated (PCL240MK and PCL240MS).
            Default, as False: the plan computes it.
        timeout: s for the motion, default half as much again as the plan takes, and one.

    A status read tells what a bus cycle costs, and the plan reckons with it. When an end limit stops an axis, the others are
    slowed down and stopped: the line is lost. Raises ArgumentError when the chips cannot do it, with the reason; RunTimeout,
    whose `reports` tell how far each axis came.
    """
    if not isinstance(distances, Mapping | Plan):
        distances, axes = axes, distances
    if isinstance(distances, Plan):
        chosen = _find(distances.distances, axes)
        _same_chips(distances, chosen)
        made = distances.with_bus_delay(_bus_delay(chosen, distances.order))
    else:
        chosen = _find(distances, axes)
        asked = {n: d for n, (_, d) in chosen.items()}
        chips: dict[str, Any] = {n: type(a.chip) for n, (a, _) in chosen.items()}
        clocks = {n: a.chip.clock_hz for n, (a, _) in chosen.items()}
        wanted = partial(
            plan, asked, rate=rate, fl=fl, accel=accel, decel=decel, s_curve=s_curve, automatic=automatic,
            chips=chips, clock_hz=clocks,
        )  # fmt: skip
        at_once = wanted()  # refuses before the first bus cycle
        delay = _bus_delay(chosen, at_once.order)
        made = at_once.with_bus_delay(delay)
        if made.deviation > at_once.deviation + WORTH_IT:
            made = wanted(bus_delay=delay)
    return _run({n: chosen[n][0] for n in made.order}, made, timeout)


def _run(axes: dict[str, Axis], made: Plan, timeout: float | None) -> SynchronizedReport:
    """Write, start in the order given, wait, report."""
    watch = {n: Procedure(a, "synchronized move") for n, a in axes.items()}
    with ExitStack() as books:
        for p in watch.values():
            books.enter_context(p)
        line = _Line(axes, made.distances)
        for n, p in watch.items():
            p.port.command(bus.RESET)
            p.port.write_registers(**made.axes[n].registers)
            p.port.command(bus.OUTPUT)
            minus = bus.MINUS if made.axes[n].distance < 0 else 0
            p.port.control(bus.PRESET | minus | (bus.AUTOMATIC if made.axes[n].automatic else 0))
        began = {}
        for n, p in watch.items():  # nothing between the starts but the bus
            p.port.command(bus.RAMP["FH1"] if made.axes[n].ramps else bus.START["FH1"])
            began[n] = p.axis.time
        try:
            stopped_by = _wait(watch, made, 1.5 * made.seconds + 1 if timeout is None else timeout, line)
        except RunTimeout as error:
            error.reports = {n: watch[n].report("timeout", a.distance) for n, a in made.axes.items()}  # type: ignore[attr-defined]
            raise
        next(iter(axes.values())).wait(SETTLE)
        reports = {n: watch[n].report(stopped_by[n], a.distance) for n, a in made.axes.items()}
    first = min(began.values())
    paths = {}
    for n in made.axes:
        pulses, origin = pulses_of(watch[n].journal), first - watch[n].began
        paths[n] = pulses["clock"] / axes[n].chip.clock_hz - origin, pulses["direction"].copy()
    ends = [t[-1] for t, _ in paths.values() if len(t)]
    return SynchronizedReport(
        reports, made, path_deviation(list(paths.values()), list(made.distances.values())),
        max(began.values()) - first, float(max(ends) - min(ends)) if ends else 0.0, line.worst, paths,
    )  # fmt: skip


def _wait(watch: dict[str, Procedure], made: Plan, patience: float, line: _Line) -> dict[str, str]:
    """Poll all axes until none operates. Returns why each stopped."""
    stopped_by: dict[str, str] = {}
    broken = False
    clock = next(iter(watch.values())).axis
    begin = clock.time
    while True:
        for n, p in watch.items():
            if n in stopped_by:
                continue
            status = p.port.status()
            if not status.operating:
                slowed = broken and not status.zero
                stopped_by[n] = "decelerating stop" if slowed else bus.stop_reason(status, made.axes[n].distance)
        line.look()
        if len(stopped_by) == len(watch):
            return stopped_by
        if not broken and any(s.startswith("EL") for s in stopped_by.values()):
            broken = True
            for n, p in watch.items():
                if n not in stopped_by:
                    p.port.command(bus.SLOW_DOWN_FH1)
        passed = clock.time - begin
        if passed >= patience:
            left = {n: watch[n].port.counter() for n in watch if n not in stopped_by}
            raise RunTimeout(
                f"after {patience:.3f} s axes still operate; pulses left: {left}. Give more time, or stop them with 08h."
            )
        poll = bus.POLL if line.worst is not None else max(bus.POLL, made.seconds / LOOKS)
        clock.wait(min(poll, patience - passed + 1e-6))


class _Line:
    """The carriages' largest distance from their line, m; `worst` is None without a stage."""

    def __init__(self, axes: dict[str, Axis], distances: dict[str, int]):
        self._axes = list(axes.values())
        self.worst: float | None = None
        if any(a.position is None or getattr(a, "unit", "m") != "m" for a in self._axes):
            self._axes = []
            return
        self.worst = 0.0
        self._start = self._positions()
        self._way = np.array(
            [distances[n] * (a.meters_per_pulse or 0.0) * np.sign(getattr(a, "gear", 1.0)) for n, a in axes.items()]
        )

    def _positions(self) -> np.ndarray:
        return np.array([a.position for a in self._axes])

    def look(self) -> None:
        if self._axes:
            off = self._positions() - self._start
            along = min(max(off @ self._way / (self._way @ self._way), 0.0), 1.0)
            self.worst = max(self.worst or 0.0, float(np.linalg.norm(off - along * self._way)))


def _find(distances: Mapping, axes: Any) -> dict[str, tuple[Axis, int]]:
    """Label -> (axis, pulses); the label is the name used, or the axis' own."""
    known = getattr(axes, "axes", axes)
    chosen: dict[str, tuple[Axis, int]] = {}
    for key, d in distances.items():
        label, axis = key, key
        if isinstance(key, str):
            if known is None:
                raise ArgumentError(f"axis {key!r}: say where it is: synchronized_move({{{key!r}: ...}}, stage.axes).")
            if key not in known:
                raise unknown("axis", key, known)
            axis = known[key]
        else:
            label = getattr(key, "name", repr(key))
        if label in chosen or any(axis is other for other, _ in chosen.values()):
            raise ArgumentError(f"axis {label!r} is given twice: one distance an axis.")
        check(axis)
        chosen[label] = (axis, d)
    return chosen


def _same_chips(made: Plan, chosen: dict[str, tuple[Axis, int]]) -> None:
    for n, a in made.axes.items():
        if type(chosen[n][0].chip) is not a.chip:
            raise ArgumentError(
                f"the plan is for a {a.chip.MAP.chip}, and axis {n} has a {chosen[n][0].chip.MAP.chip}: plan with "
                f"chips={{{n!r}: {type(chosen[n][0].chip).__name__}}}."
            )
        if chosen[n][0].chip.clock_hz != a.clock_hz:
            raise ArgumentError(
                f"the plan is for a chip at {a.clock_hz} Hz, and axis {n}'s runs at {chosen[n][0].chip.clock_hz} Hz: "
                f"plan with clock_hz={{{n!r}: {chosen[n][0].chip.clock_hz}}}."
            )


def _bus_delay(chosen: dict[str, tuple[Axis, int]], names: Any) -> float:
    """Read each axis' status, to see that it stands still and what a bus cycle takes."""
    delay = 0.0
    for n in names:
        axis = chosen[n][0]
        before = axis.time
        if bus.Port(axis).status().operating:
            raise ArgumentError(f"axis {n} is moving: wait until it stops, or stop it with 08h.")
        delay = axis.time - before
    return delay
