"""`stage demo`: the whole story in half a minute."""

from __future__ import annotations

import argparse
import time
from typing import Any

from stage.cli.setup import make_stage, note, recorded

WHERE = {"x": 0.062, "y": -0.031, "z": 0.017}  # where the carriages happen to stand


def run(args: argparse.Namespace) -> int:
    """Origin return of all axes, a dual-rate move, an a:b move; a table; demo.rrd."""
    from stage.opengl import has_screen

    begin = time.perf_counter()
    note("building the stage ...")
    stage = make_stage(args)
    stage.place(**{n: q for n, q in WHERE.items() if n in stage.axes})
    if has_screen() and not args.no_view and not args.web:
        args.view = True
    rows: list[tuple] = []
    with recorded(args, stage):
        story(stage, rows)
        print(_table(rows))
        wall = time.perf_counter() - begin
        print(f"{stage.time:.2f} s of simulated time in {wall:.2f} s of wall time")
    return 0 if all(r[-1] == "yes" for r in rows) else 1


def story(stage: Any, rows: list[tuple]) -> None:
    """The moves; fills `rows` for the table."""
    from stage import firmware

    def add(report: Any) -> None:
        homed = report.stopped_by == "ORG"
        asked = "to ORG" if report.asked is None else f"{report.asked:+d}"
        good = report.ok and (homed or report.asked is not None)
        rows.append(
            (
                report.axis, report.procedure, asked, f"{report.pulses:+d}", f"{report.duration:.3f}",
                f"{report.peak_rate:,.0f}", f"{report.position * 1e3:.4f} m{report.unit}", str(report.lost_steps),
                report.stopped_by, "yes" if good else "NO",
            )
        )  # fmt: skip

    fast = firmware.Profile.of(fl=1500, fh1=20_000, fh2=40_000, accel=0.2)
    for axis in reversed(stage.axes.values()):  # Z first: it clears the way
        note(f"axis {axis.name}: origin return ...")
        add(firmware.origin_return(axis, profile=fast))
    names = list(stage.axes)
    first, second = stage.axes[names[0]], stage.axes[names[min(1, len(names) - 1)]]
    note("dual-rate move ...")
    add(firmware.dual_rate_move(first, 40_000, fast, dwell=0.25))
    if second is not first:
        add(firmware.preset_move(second, 20_000, fast))
        note("a:b move ...")
        report = firmware.synchronized_move({first.name: 20_000, second.name: -7_500}, stage.axes, rate=20_000)
        for r in report.axes.values():
            add(r)
        print(
            f"a:b move {first.name}=+20000 {second.name}=-7500: {report.deviation.pulses:.2f} pulses from the straight "
            f"line at most, started within {report.skew * 1e6:.1f} us of each other"
        )


def _table(rows: list[tuple]) -> str:
    head = ("axis", "procedure", "asked", "pulses", "s", "peak pps", "position", "lost", "stopped by", "ok")
    widths = [max(len(str(r[k])) for r in (head, *rows)) for k in range(len(head))]
    lines = ["  ".join(str(v).ljust(w) for v, w in zip(r, widths, strict=True)).rstrip() for r in (head, *rows)]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])
