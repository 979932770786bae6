"""`SynchronizedReport` of several axes on one straight line, and `LineObserver`, which observes them and makes it.

with LineObserver({name: ProcedureObserver(axis, "line") ...}, distances) as line:
    ...                                      write, start; line.note_start(name) after each start
    line.measure_carriages()                 while they move
    report = line.make_report(stopped_by)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.errors import ArgumentError, RunTimeout, unknown_name_error
from stage.firmware.axis import AxesByName, Axis
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.path_deviation import PathDeviation, compute_path_deviation, replay_pulses
from stage.support import html

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.figure import Figure

    from stage.firmware.pcl240.line_plan import Plan


@dataclass(frozen=True, repr=False)
class SynchronizedReport:
    """Report of axes that moved together.

    Attributes:
        axes: Report of each axis that moved.
        plan: Registers and the deviation expected with them; None if the chip itself keeps the axes on the line.
        deviation: Largest distance of the pulse counts from the straight line, with its time in s from the first start command.
        skew: Seconds from the first start command to the last one.
        finish: Seconds from the last pulse of the first axis to stop to the last pulse of the last axis to stop.
        carriage_deviation: Largest distance of the carriages from the line while they moved, polled every millisecond, m; None
            without a stage. It is larger than `deviation` because motors lag behind their pulses by different amounts.
        paths: For each axis the times of its pulses, s from the first start command, and their directions.
    """

    axes: dict[str, Report]
    plan: Plan | None
    deviation: PathDeviation
    skew: float
    finish: float
    carriage_deviation: float | None
    paths: dict[str, tuple[np.ndarray, np.ndarray]] = field(repr=False)

    @property
    def ok(self) -> bool:
        """True if every axis made all its pulses and lost no step."""
        return all(r.ok for r in self.axes.values())

    @property
    def distances(self) -> dict[str, int]:
        """Signed pulses commanded to each axis."""
        return self.plan.distances if self.plan else {n: r.asked or 0 for n, r in self.axes.items()}

    @property
    def seconds(self) -> float:
        """Duration of the motion according to the plan, or measured by the clock if there is no plan, s."""
        return self.plan.seconds if self.plan else max(r.duration for r in self.axes.values())

    def describe_rate(self, axis: str) -> str:
        """Describe the rate of an axis."""
        if self.plan is None:
            return f"up to {self.axes[axis].peak_rate:,.1f} pps"
        planned = self.plan.axes[axis]
        return f"R7 = {planned.registers['R7']}, FH {planned.fh:,.1f} pps"

    @property
    def ratio_error(self) -> float:
        """Largest relative error of a planned rate against that of the longest axis; 0 if the chip itself keeps the ratio."""
        return self.plan.ratio_error if self.plan else 0.0

    def __str__(self) -> str:
        d, counts = self.deviation, dict(zip(self.paths, self.deviation.counts, strict=True))
        where = ", ".join(f"{n} {c:+d}" for n, c in counts.items())
        lines = [
            f"synchronized move: {'done' if self.ok else 'NOT as asked'}, {d.pulses:.2f} pulses from the line at most "
            f"(at {d.time:.4f} s, {where})",
            f"  first starts {self.skew * 1e6:.1f} us apart, last pulses {self.finish * 1e3:.3f} ms apart, "
            f"ratio error {self.ratio_error:.1e}",
        ]
        if self.carriage_deviation is not None:
            lines.append(f"  carriages {self.carriage_deviation * 1e6:.1f} um from the line at most")
        return "\n".join([*lines, *(str(r) for r in self.axes.values())])

    def __repr__(self) -> str:
        return f"<SynchronizedReport {str(self).splitlines()[0]}>"

    def _repr_html_(self) -> str:
        return html.format_preformatted(str(self)) + html.embed_figure(self.plot)

    def json(self) -> dict[str, Any]:
        """Return all values as `--json` prints them, in s, m and pulses, with the values of each axis' report."""
        names = ("ok", "distances", "seconds", "skew", "finish", "ratio_error", "carriage_deviation")
        numbers = {name: getattr(self, name) for name in names}
        d = self.deviation
        deviation = {"pulses": d.pulses, "time": d.time, "counts": dict(zip(self.paths, d.counts, strict=True))}
        return numbers | {"deviation": deviation, "reports": [r.json() for r in self.axes.values()]}

    def plot(self, path: str | PathLike | None = None, title: str | None = None, *, overwrite: bool = False) -> Figure:
        """Draw the path with its distance from the line magnified, and the rates over time. Needs matplotlib (extra `plot`).

        Args:
            path: File to save the figure in, if any.
            title: Title; default: the distances.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The figure.

        Raises:
            FileError: The file exists, and `overwrite` is False.
        """
        from stage.firmware.synchronized_move_figure import draw_synchronized_move

        return draw_synchronized_move(self, path, title, overwrite)


class LineObserver:
    """Observer of axes that move together.

    Args:
        watch: Observer of each axis by name. `LineObserver` enters and leaves their contexts.
        distances: Signed pulses of each axis.
    """

    def __init__(self, watch: Mapping[str, ProcedureObserver], distances: Mapping[str, int]):
        self.watch, self.distances = dict(watch), {n: d for n, d in distances.items() if n in watch}
        self._began: dict[str, float] = {}
        self._books = ExitStack()

    def __enter__(self) -> LineObserver:
        for p in self.watch.values():
            self._books.enter_context(p)
        self.carriages = CarriageDeviationMeter({n: p.axis for n, p in self.watch.items()}, self.distances)
        return self

    def __exit__(self, *error: Any) -> None:
        self._books.__exit__(*error)

    def note_start(self, *names: str) -> None:
        """Store the present time as that of the start commands of the named axes; without names, of all axes."""
        for n in names or self.watch:
            self._began[n] = self.watch[n].axis.time

    def measure_carriages(self) -> None:
        """Measure the present distance of the carriages from the line; the observer keeps the largest one."""
        self.carriages.measure()

    def has_arrived(self, name: str) -> bool:
        """Return whether an axis has made all pulses of its distance."""
        return self.watch[name].pulses_made == self.distances[name]

    def make_axis_reports(self, stopped_by: Mapping[str, str]) -> dict[str, Report]:
        """End the observation of each axis, and return the reports.

        Args:
            stopped_by: Reason of the end of each axis.
        """
        return {n: self.watch[n].make_report(stopped_by[n], d) for n, d in self.distances.items()}

    @contextmanager
    def attach_reports_to_timeout(self) -> Iterator[None]:
        """Add the attribute `reports`, with the reports of all axes, to a RunTimeout that is raised in the `with` block."""
        try:
            yield
        except RunTimeout as error:
            error.reports = self.make_axis_reports(dict.fromkeys(self.distances, "timeout"))  # type: ignore[attr-defined]
            raise

    def make_report(self, stopped_by: Mapping[str, str], plan: Plan | None = None) -> SynchronizedReport:
        """End the observation and make the report.

        Args:
            stopped_by: Stop reason of each axis.
            plan: Plan of the move, if there is one.

        Returns:
            The report of all axes.
        """
        reports = self.make_axis_reports(stopped_by)
        first = min(self._began.values())
        paths = {}
        for n in self.distances:
            p = self.watch[n]
            pulses, origin = replay_pulses(p.journal), first - p.began
            pulses = pulses[pulses["axis"] == p.axis.chip_axis]
            paths[n] = pulses["clock"] / p.axis.chip.clock_hz - origin, pulses["direction"].copy()
        ends = [t[-1] for t, _ in paths.values() if len(t)]
        return SynchronizedReport(
            reports, plan, compute_path_deviation(list(paths.values()), list(self.distances.values())),
            max(self._began.values()) - first, float(max(ends) - min(ends)) if ends else 0.0, self.carriages.worst, paths,
        )  # fmt: skip


class EarlyStopHandler:
    """Callback for the polls of a line that slows all axes down as soon as one of them has stopped early.

    Pass it as `on_poll` to `wait_until_stopped`.

    Args:
        together: Observer of the line.
        drivers: Driver of each axis by name; each has a method `slow_down`.

    Attributes:
        stopped: Names of the axes that it has slowed down.
    """

    def __init__(self, together: LineObserver, drivers: Mapping[str, Any]):
        """Args:
        together: Observer of the line.
        drivers: Driver of each axis by name; each has a method `slow_down`.
        """
        self._together, self._drivers = together, drivers
        self.stopped: set[str] = set()

    def __call__(self) -> None:
        self._together.measure_carriages()
        running = {n for n, d in self._drivers.items() if d.chip.busy(d.axis.chip_axis)}
        early = (n for n in self._drivers if n not in running and not self._together.has_arrived(n))
        if running and not self.stopped and any(early):
            for n in running:
                self._drivers[n].slow_down()
            self.stopped = running


class CarriageDeviationMeter:
    """Meter that keeps the largest distance of carriages from their straight line.

    Attributes:
        worst: Largest distance measured so far, m; None if the axes have no carriages.
    """

    def __init__(self, axes: dict[str, Axis], distances: dict[str, int]):
        self._axes = list(axes.values())
        self.worst: float | None = None
        if any(a.position is None or getattr(a, "unit", "m") != "m" for a in self._axes):
            self._axes = []
            return
        self.worst = 0.0
        self._start = self._read_positions()
        self._line = np.array(
            [distances[n] * (a.meters_per_pulse or 0.0) * np.sign(getattr(a, "gear", 1.0)) for n, a in axes.items()]
        )

    def _read_positions(self) -> np.ndarray:
        """Return the positions of the carriages relative to the start, m."""
        return np.array([a.position for a in self._axes])

    def measure(self) -> None:
        """Measure the present distance from the line, and keep it if it is the largest one."""
        if self._axes:
            off = self._read_positions() - self._start
            along = min(max(off @ self._line / (self._line @ self._line), 0.0), 1.0)
            self.worst = max(self.worst or 0.0, float(np.linalg.norm(off - along * self._line)))


def select_axes(distances: Mapping, axes: AxesByName, procedure: str) -> dict[str, tuple[Axis, Any]]:
    """Find the axes of a procedure by their names.

    Args:
        distances: Distance of each axis by its name, or by the axis itself.
        axes: Stage, bench or mapping that contains the names.
        procedure: Name of the procedure, for errors.

    Returns:
        Label -> (axis, distance). The label is the name that the caller used, or the name of the axis.

    Raises:
        ArgumentError: A name does not exist, or an axis occurs twice.
    """
    known: Any = getattr(axes, "axes", axes)
    selected: dict[str, tuple[Axis, Any]] = {}
    for key, d in distances.items():
        label, axis = key, key
        if isinstance(key, str):
            if known is None:
                raise ArgumentError(f"axis {key!r}: say where it is: {procedure}({{{key!r}: ...}}, stage.axes).")
            if key not in known:
                raise unknown_name_error("axis", key, known)
            axis = known[key]
        else:
            label = getattr(key, "name", repr(key))
        if label in selected or any(axis is other for other, _ in selected.values()):
            raise ArgumentError(f"axis {label!r} is given twice: one distance an axis.")
        selected[label] = (axis, d)
    return selected
