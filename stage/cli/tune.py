"""The command `stage tune`: registers for one's own axis."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from stage.cli.facts import tell
from stage.cli.setup import distance, find_axis, make_stage
from stage.errors import ArgumentError, StageError
from stage.units import BESIDES, PLACES, TYPED, quantity

FILES = {"c": "tuned.h", "text": "tuned.txt", "json": "tuned.json", "picture": "tuned.png"}


def run(args: argparse.Namespace) -> int:
    from stage.support.files import written
    from stage.tune import Task, tune
    from stage.tune.search import optuna

    if args.distance is None:
        raise ArgumentError("--distance: registers are for a distance; give one, for example --distance 100mm.")
    folder = _folder(args)
    if args.by == "search":
        optuna()
    if args.seed < 0:
        raise ArgumentError(f"--seed {args.seed}: a whole number, 0 or more.")
    stage = make_stage(args, visuals=False)
    axis = find_axis(stage, args.axis) if args.axis else next(iter(stage.axes.values()))
    within, hold = _settle(axis, args.settle)
    task = Task(
        stage, axis.name, distance(axis, args.distance), args.payload, _spare(args.spare, args.payload), within, hold,
        None if args.overshoot is None else _length(axis, "--overshoot", args.overshoot), args.site, args.payload_on,
    )  # fmt: skip
    told = _Progress(args.trials)
    try:
        result = tune(
            task, by=args.by, trials=args.trials, seed=args.seed, workers=args.workers, moves=args.moves, told=told
        )
    except StageError as error:
        raise StageError(f"{error}{_meant(axis, args.distance)}") from error
    finally:
        told.end()
    tell(args, result)
    print(result)
    if folder is None:
        print(f"\n{result.c_source()}", end="")
    if folder is not None:
        texts = {"c": result.c_source(), "text": f"{result}\n", "json": json.dumps(result.json(), indent=1) + "\n"}
        for kind, text in texts.items():
            with written(folder / FILES[kind], args.force) as part:
                part.write_text(text, encoding="utf-8")
        made = list(texts)
        try:
            result.plot(folder / FILES["picture"], args.force)
            made.append("picture")
        except StageError as error:
            print(f"stage: no picture: {error}", file=sys.stderr)
        print(f"\n{folder}: {', '.join(FILES[kind] for kind in made)}")
    return 130 if result.stopped else 0


def _folder(args: argparse.Namespace) -> Path | None:
    """Where the files go, if they can be written there. Raises FileError."""
    from stage.support.files import FileError, writable

    if args.output is None:
        return None
    folder = Path(args.output)
    if folder.exists() and not folder.is_dir():
        raise FileError(f"--output {folder}: a file is there. Name a folder.")
    if not folder.exists():
        writable(folder, False)
        try:
            folder.mkdir()
        except OSError as error:
            raise FileError(f"--output {folder}: {error.strerror}. Choose another folder.") from error
        return folder
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f"--output {folder}: no permission to write there. Choose another folder.")
    for name in FILES.values():
        writable(folder / name, args.force, ask="give --force")
    return folder


def _spare(text: str, payload: float) -> float | None:
    """kg, of 30 % (of the payload; None where there is none: of what moves) or of 0.6. Raises ArgumentError."""
    text = text.strip()
    number, percent, rest = text.partition("%")
    value = quantity(number, {"": 1.0} if percent else {"": 1.0} | BESIDES["mass"])
    if value is None or rest or not 0 <= value < float("inf"):
        raise ArgumentError(f"--spare {text}: percent of the payload, 30%, or kg, 0.6.")
    if not percent:
        return value
    return value / 100 * payload if payload else None


def _meant(axis: Any, way: str) -> str:
    """A distance without a unit is pulses, and millimetres may have been meant: a sentence with a blank before it."""
    from stage.firmware.driver import driver_of

    way = way.strip()
    if quantity(way, {"": 1.0}) is None:
        return ""
    counts, unit = "counts" if driver_of(axis).has_position_loop else "pulses", PLACES[axis.unit].symbol
    return f" --distance {way} is {way} {counts}: did you mean {way}{unit}?"


def _settle(axis: Any, given: list[str] | None) -> tuple[float | None, float]:
    """How near, m (rad) or None for the usual, and for how long, s. Raises ArgumentError."""
    from stage.tune.task import HOLD

    if given is None:
        return None, HOLD
    return _length(axis, "--settle", given[0]), _number("--settle", given[1], BESIDES["time"], "50ms")


def _length(axis: Any, option: str, text: str) -> float:
    """m, rad on a hinge. Raises ArgumentError."""
    return _number(option, text, TYPED[axis.unit], "50um" if axis.unit == "m" else "50mdeg")


def _number(option: str, text: str, units: dict[str, float], example: str) -> float:
    value = quantity(text, units)
    if value is None or not 0 < value < float("inf"):
        raise ArgumentError(
            f"{option}: {text.strip()!r} is not more than 0 in one of {', '.join(units)}; for example {example}."
        )
    return value


class _Progress:
    """A line on a terminal that says what is done."""

    def __init__(self, trials: int):
        self._on, self._trials = sys.stderr.isatty(), trials

    def __call__(self, what: str, part: float, best: float | None) -> None:
        if self._on:
            how = f" {round(part * self._trials)} of {self._trials} trials" if what == "searching" else ""
            so_far = f", best {best * 1e3:.1f} ms" if best is not None else ""
            print(f"\r\033[K{what}{how}{so_far} ...", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self._on:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
