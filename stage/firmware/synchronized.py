"""The a:b move: several chips, one straight line. Planned, written to the chips, started one after the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stage.errors import ArgumentError, unknown
from stage.firmware import bus
from stage.firmware.axis import Axis
from stage.firmware.moves import SETTLE, _minus, _reason
from stage.firmware.path import Deviation, path_deviation
from stage.firmware.plan import Plan, plan
from stage.firmware.profile import ACCEL, FH1, FL
from stage.firmware.report import Procedure, Report


@dataclass(frozen=True)
class SynchronizedReport:
    """What the axes did together.

    Attributes:
        axes: a Report each. plan: the registers and what was expected of them.
        deviation: the largest distance from the straight line in pulses, with its time and the counts then.
        skew: seconds between the first start command and the last; finish: between the first axis' last pulse and the last's.
    """

    axes: dict[str, Report]
    plan: Plan
    deviation: Deviation
    skew: float
    finish: float
    paths: dict[str, tuple[np.ndarray, np.ndarray]]

    @property
    def ok(self) -> bool:
        """Every axis made its pulses, and lost none."""
        return all(r.ok for r in self.axes.values())

    def __str__(self) -> str:
        lines = [
            f"synchronized move: {'done' if self.ok else 'NOT as asked'}, "
            f"{self.deviation.pulses:.2f} pulses from the line at most (at {self.deviation.time:.4f} s)",
            f"  started within {self.skew * 1e6:.1f} us, finished within {self.finish * 1e3:.3f} ms",
        ]
        return "\n".join([*lines, *(str(r) for r in self.axes.values())])

    def plot(self, path: str | None = None) -> Any:
        """Draw rates over time, and the distance from the line along the way. Returns the figure."""
        from stage.firmware.plot_path import draw

        return draw(self, path)


def synchronized_move(
    distances: Mapping[Any, int],
    axes: Any = None,
    *,
    rate: float = FH1,
    fl: float = FL,
    accel: float = ACCEL,
    decel: float | None = None,
    timeout: float | None = None,
) -> SynchronizedReport:
    """Move several axes along a straight line.

    distances: axis name (or axis) -> signed pulses; 0 keeps an axis still. axes: where the names are: a stage, a bench,
    or a mapping such as stage.axes; not needed when the keys are axes themselves. rate, fl: of the longest axis, pps.
    Raises ArgumentError when the chips cannot do it, with the reason; RunTimeout.
    """
    if not isinstance(distances, Mapping):
        distances, axes = axes, distances
    chosen = _axes(distances, axes)
    by_name = {a.name: int(d) for a, d in chosen}
    plan_ = plan(by_name, rate=rate, fl=fl, accel=accel, decel=decel, clock_hz={a.name: a.chip.clock_hz for a, _ in chosen})
    moving = [a for a, d in chosen if d]
    watch = {a.name: Procedure(a, "synchronized move") for a in moving}
    for p in watch.values():
        p.__enter__()
    try:
        for name, p in watch.items():
            a = plan_.axes[name]
            p.port.command(bus.RESET)
            p.port.write_registers(**a.registers)
            p.port.command(bus.OUTPUT)
            p.port.command(bus.CONTROL | bus.PRESET | _minus(a.distance))
        began = {}
        for name, p in watch.items():  # nothing between the starts but the bus
            p.port.command(bus.RAMP["FH1"] if plan_.axes[name].ramps else bus.START["FH1"])
            began[name] = p.axis.time
        patience = 1.5 * plan_.seconds + 1 if timeout is None else timeout
        status = {name: p.port.wait_until_stopped(patience) for name, p in watch.items()}
        moving[0].wait(SETTLE)
        reports = {n: p.report(_reason(status[n], by_name[n]), by_name[n]) for n, p in watch.items()}
    finally:
        for p in watch.values():
            p.__exit__()
    first = min(began.values())
    paths = {n: _pulses(p, first) for n, p in watch.items()}
    ends = [t[-1] for t, _ in paths.values() if len(t)]
    far = path_deviation(list(paths.values()), [by_name[n] for n in paths])
    return SynchronizedReport(
        reports, plan_, far, max(began.values()) - first, float(max(ends) - min(ends)) if ends else 0.0, paths
    )


def _axes(distances: Mapping, axes: Any) -> list[tuple[Axis, int]]:
    known = getattr(axes, "axes", axes)
    chosen = []
    for key, d in distances.items():
        if isinstance(key, str):
            if known is None:
                raise ArgumentError(f"axis {key!r}: say where it is: synchronized_move({{...}}, stage.axes).")
            if key not in known:
                raise unknown("axis", key, known)
            key = known[key]
        chosen.append((key, d))
    return chosen


def _pulses(p: Procedure, origin: float) -> tuple[np.ndarray, np.ndarray]:
    """(times in s since the first start command, directions) of an axis' pulses."""
    course = p.journal.course(every_pulse=True)
    e = course.edges
    steps = np.diff(e["net"])
    at = np.flatnonzero(steps)
    seconds = p.began + (e["clock"][at + 1] - e["clock"][0]) / course.clock_hz - origin
    return seconds, np.sign(steps[at])
