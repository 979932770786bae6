"""The commands home, move, dual-rate and sync."""

from __future__ import annotations

import argparse
from typing import Any

from stage.cli.setup import find_axis, make_stage, note, place, plot, profile, recorded
from stage.errors import ArgumentError


def home(args: argparse.Namespace) -> int:
    from stage import firmware

    stage = make_stage(args)
    axes = [find_axis(stage, name) for name in args.axes] or list(stage.axes.values())
    for axis in axes:
        place(stage, axis, "--from", args.start)
    reports = []
    with recorded(args, stage):
        for axis in axes:
            note(f"axis {axis.name}: origin return ...")
            reports.append(
                firmware.origin_return(
                    axis,
                    +1 if args.plus else -1,
                    profile(args, axis),
                    high_speed=not args.constant,
                    slow_approach=not args.fast_only,
                    ez=args.ez,
                )
            )
            print(reports[-1])
        plot(args, reports[0].plot)
    return 0 if all(r.stopped_by in ("ORG", "EZ") and not r.lost_steps for r in reports) else 1


def move(args: argparse.Namespace) -> int:
    from stage import firmware

    how = {"high_speed": not args.constant, "s_curve": args.s_curve, "automatic": args.automatic}
    return _single(args, lambda axis, p: firmware.preset_move(axis, args.pulses, p, **how))


def dual_rate(args: argparse.Namespace) -> int:
    from stage import firmware

    return _single(args, lambda axis, p: firmware.dual_rate_move(axis, args.pulses, p))


def _single(args: argparse.Namespace, run: Any) -> int:
    stage = make_stage(args)
    axis = find_axis(stage, args.axis)
    place(stage, axis, "--from", args.start)
    speeds = profile(args, axis)
    print(speeds)
    with recorded(args, stage):
        report = run(axis, speeds)
        print(report)
        print(report.listing())
        plot(args, report.plot)
    return 0 if report.ok else 1


def sync(args: argparse.Namespace) -> int:
    from stage import firmware

    stage = make_stage(args)
    distances: dict[str, int] = {}
    for item in args.distances:
        name, _, pulses = item.partition("=")
        try:
            number = int(pulses)
        except ValueError:
            raise ArgumentError(f"{item!r}: write AXIS=PULSES, for example x=20000.") from None
        if find_axis(stage, name).name in distances:
            raise ArgumentError(f"{item!r}: axis {name} has got {distances[name]} pulses already. Give an axis once.")
        distances[name] = number
    keys = ("rate", "fl", "accel", "s_curve", "automatic")
    given = {k: getattr(args, k) for k in keys if getattr(args, k) is not None}
    with recorded(args, stage):
        report = firmware.synchronized_move(distances, stage.axes, **given)
        print(report.plan)
        print(report)
        plot(args, report.plot)
    return 0 if report.ok else 1
