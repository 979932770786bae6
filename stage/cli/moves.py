"""The commands home, move, dual-rate and sync."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from typing import Any

from stage.cli.facts import tell, warn
from stage.cli.files import plot, recorded
from stage.cli.progress import note, ticking
from stage.cli.setup import distance, find_axis, make_stage, place, speeds, split_pair, told_of_its_end
from stage.errors import ArgumentError, a_or_an


def home(args: argparse.Namespace) -> int:
    from stage.firmware.driver import driver_of
    from stage.firmware.tandem import tandems

    stage = make_stage(args)
    groups = tandems([find_axis(stage, name) for name in args.axes] or stage.axes.values())
    axes = [axis for group in groups for axis in group]
    for axis in axes:
        place(stage, axis, "--from", args.start)
    reports = []
    with recorded(args, stage), ticking(stage):
        for group in groups:
            note(f"axis {' and '.join(axis.name for axis in group)}: origin return ...")
            if len(group) > 1:
                names = " and ".join(axis.name for axis in group)
                print(
                    f"axes {names} drive one load: together to where one meets ORG, then each to its own, as reported"
                )
            found = _square(args, group) if len(group) > 1 else [_home(args, group[0])]
            reports += found
            print(*found, sep="\n")
        tell(args, reports=reports)
        plot(args, reports[0].plot)
    found = [r.stopped_by in driver_of(axis).FOUND for r, axis in zip(reports, axes, strict=True)]
    return 0 if all(found) and not any(r.lost_steps for r in reports) else 1


def _home(args: argparse.Namespace, axis: Any) -> Any:
    from stage.firmware.driver import driver_of

    direction, by, driver = +1 if args.plus else -1, args.by, driver_of(axis)
    if by is not None:
        driver.check_homing(by, args.ez is not None)
    if by in (None, "switch", "index"):
        driver.check_origin()
    options = collect_options(args, driver, "constant", "fast_only", "fh2")
    if args.ez is not None and "ez" in driver.OPTIONS:
        options["ez"] = args.ez
    elif args.ez not in (None, 1):
        raise ArgumentError(
            f"--ez {args.ez}: {a_or_an(axis.chip.MAP.chip)} ends at the first index pulse after ORG, --ez 1, or at ORG."
        )
    if by is not None:
        return driver.home_by(by, direction, speeds(args, axis), **options)
    return driver.home(direction, speeds(args, axis), index=args.ez is not None, **options)


def _square(args: argparse.Namespace, axes: list[Any]) -> list[Any]:
    """Origin return of axes that drive one load."""
    from stage.firmware.tandem import square_by

    for option in ("by", "ez", "constant", "fast_only", "fh2"):
        if getattr(args, option, None) not in (None, False):
            names = " and ".join(axis.name for axis in axes)
            raise ArgumentError(
                f"--{option.replace('_', '-')}: axes {names} drive one load; they go to their origin switches together."
            )
    return square_by(axes, +1 if args.plus else -1, speeds(args, axes[0]))


def move(args: argparse.Namespace) -> int:
    from stage.firmware.driver import driver_of

    def run(axis: Any) -> Any:
        driver, pulses = driver_of(axis), told_of_its_end(args, axis, distance(axis, args.distance))
        options = collect_options(args, driver, "constant", "automatic", "fh2")
        wanted = speeds(args, axis, args.s_curve or False)
        print_speeds(driver, wanted)
        return driver.move(pulses, wanted, **options)

    return _single(args, run)


def dual_rate(args: argparse.Namespace) -> int:
    from stage.firmware.driver import driver_of

    def run(axis: Any) -> Any:
        driver, wanted = driver_of(axis), speeds(args, axis)
        print_speeds(driver, wanted)
        pulses, rates = told_of_its_end(args, axis, distance(axis, args.distance)), args.rates.upper().split(",")
        return driver.move_through_rates(pulses, wanted, rates, args.dwell)

    return _single(args, run)


def _single(args: argparse.Namespace, run: Any) -> int:
    stage = make_stage(args)
    axis = find_axis(stage, args.axis)
    for beside in (axis, *(stage.axes[name] for name in axis.tandem)):
        place(stage, beside, "--from", args.start)
    if axis.tandem:
        _warn_of_tandem(args, axis, axis.tandem, [f"{axis.name}={args.distance}"])
    with recorded(args, stage), ticking(stage):
        report = run(axis)
        print(report)
        print(report.listing())
        tell(args, reports=[report])
        plot(args, report.plot)
    return 0 if report.ok else 1


def _warn_of_tandem(args: argparse.Namespace, axis: Any, behind: Sequence[str], asked: list[str]) -> None:
    """asked: what was typed, AXIS=DISTANCE."""
    way = next(value for name, value in map(split_pair, asked) if name == axis.name)
    kept = [item for item in asked if split_pair(item)[0] not in behind]
    warn(
        args,
        f"axis {axis.name} drives one load with {' and '.join(behind)}, which stays behind: the load is twisted. "
        f"All of them: {shlex.join(['stage', 'sync', *kept, *(f'{name}={way}' for name in behind)])}",
    )


def sync(args: argparse.Namespace) -> int:
    from stage.firmware.driver import driver_of
    from stage.firmware.procedures import check_one_kind

    stage = make_stage(args)
    distances: dict[str, int] = {}
    for item in args.distances:
        name, pulses = split_pair(item)
        if not (name and pulses):
            raise ArgumentError(f"{item!r}: write AXIS=PULSES or AXIS=DISTANCE, for example x=20000 or x=10mm.")
        number = told_of_its_end(args, axis := find_axis(stage, name), distance(axis, pulses))
        if name in distances:
            raise ArgumentError(f"{item!r}: axis {name} has got {distances[name]} pulses already. Give an axis once.")
        distances[name] = number
    for name in distances:
        if behind := [other for other in stage.axes[name].tandem if distances.get(other) != distances[name]]:
            _warn_of_tandem(args, stage.axes[name], behind, args.distances)
    drivers = {name: driver_of(stage.axes[name]) for name in distances}
    check_one_kind(drivers)
    first = next(iter(drivers.values()))
    with recorded(args, stage), ticking(stage):
        options = collect_options(args, first, "automatic")
        asked = argparse.Namespace(**vars(args) | {"fh1": args.rate})
        report = first.line(drivers, distances, speeds(asked, first.axis, args.s_curve or False), **options)
        if report.plan is not None:
            print(report.plan)
        print(report)
        tell(args, report)
        plot(args, report.plot)
    return 0 if report.ok else 1


KEYWORDS = {"constant": "constant", "automatic": "automatic", "fast_only": "slow_approach", "fh2": "second"}
"""Options that only some families have, and the names that the drivers' OPTIONS have for them."""


def collect_options(args: argparse.Namespace, driver: Any, *options: str) -> dict[str, Any]:
    """Collect the options that a user has given as keyword arguments of a driver's procedure.

    Raises:
        ArgumentError: An option that the driver's family does not have.
    """
    found: dict[str, Any] = {}
    for option in options:
        value = getattr(args, option, None)
        known = KEYWORDS[option] in driver.OPTIONS
        if value is None or (value is False and not known):
            continue
        if not known:
            chip = a_or_an(driver.chip.MAP.chip)
            raise ArgumentError(f"--{option.replace('_', '-')}: {chip} has no such thing; it is of the PCL-240 family.")
        found[KEYWORDS[option]] = not value if option == "fast_only" else value
    found.pop("second", None)  # a field of the speeds
    return found


def print_speeds(driver: Any, speeds: Any) -> None:
    """Print the rates and ramps that registers give, where they differ from what was asked for."""
    if text := driver.describe_speeds(speeds):
        print(text)
