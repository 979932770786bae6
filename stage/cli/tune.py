"""The command `stage tune`."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from pathlib import Path
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts, warn
from stage.cli.options import MASS
from stage.cli.output_and_progress import rewrite_line
from stage.cli.stage_setup import find_axis, make_stage, parse_distance
from stage.errors import ArgumentError, StageError
from stage.units import OTHER_FACTORS, POSITION_FACTORS, POSITION_UNITS, parse_quantity

FILES = {"c": "tuned.h", "text": "tuned.txt", "json": "tuned.json", "picture": "tuned.png"}
SHORT_MOVE_RAD = 2 * math.pi / 10
"""Turn of the motor; a shorter distance without a unit was probably meant in millimeters."""


def add_subcommand(commands: Any) -> None:
    """Add `stage tune` to argparse's subparsers."""
    p = add_command(
        commands, "tune", run, "find the registers for a move of an axis, and prove them",
        "Find the registers for one move of an axis: start from the data sheet's formula, then search for a faster move that keeps "
        "a margin. Prove the result on random machines that the search did not use; their motor, supply and friction vary within "
        "the evidence. Print the registers, the bytes on the bus and a C header.",
        ("stage tune xy --payload 2 --distance 100mm", "a PCL-240 on the X axis of xy: prints registers, bytes and C"),
        ("stage tune xy --payload 2 --distance 100mm -o tuned", "the same as files, with a picture"),
        ("stage tune my.xml --axis z --chips mcx514 --payload 0.5 --spare 0.2 --distance 20mm", ""),
        ("stage tune xy --distance 8000 --settle 20um 100ms --by formula", "without Optuna"),
        more="docs/tuning.md says how it works, and what the proof proves.",
    )  # fmt: skip
    options.add_model_argument(p)
    p.add_argument("--axis", help="axis to tune (default: the first one of the model)")
    p.add_argument("--distance", help="distance of the move: 100mm, -30deg, or pulses (counts of a servo)")
    p.add_argument(
        "--payload", type=MASS, default=0.0, metavar="KG", help="largest mass that the axis carries (default: 0)"
    )
    p.add_argument(
        "--payload-on", metavar="NAME",
        help="body or site that carries the payload (default: the site work if the axis moves it, else the body of the axis)",
    )  # fmt: skip
    p.add_argument(
        "--spare", default="30%", metavar="KG|PERCENT",
        help="margin: additional mass with which the axis must not lose a step; percent of the payload, or, without a payload, of "
        "the mass that the axis itself moves (default: 30%%)",
    )  # fmt: skip
    p.add_argument(
        "--settle", nargs=2, metavar=("WITHIN", "FOR"),
        help="the axis has arrived when it stays within WITHIN of the goal for FOR: 50um 50ms (default: a full step, 10 counts of "
        "a servo; 50ms)",
    )  # fmt: skip
    p.add_argument("--overshoot", metavar="LENGTH", help="largest distance beyond the goal (default: twice WITHIN)")
    p.add_argument(
        "--site",
        metavar="NAME",
        help="site or body whose position has to settle, such as a camera on a mast (default: the axis)",
    )
    g = p.add_argument_group("search")
    g.add_argument(
        "--by", choices=("search", "formula"), default="search", help="formula: no search, no Optuna (default: search)"
    )
    g.add_argument("--trials", type=int, default=200, help="number of register sets to try (default: 200)")
    g.add_argument(
        "--moves", type=int, default=96, help="number of machines in a proof; each makes one move (default: 96)"
    )
    g.add_argument(
        "--seed", type=int, default=0, help="random seed; the same seed gives the same registers (default: 0)"
    )
    g.add_argument(
        "--workers", type=int, help="number of threads; it does not change the result (default: one per processor)"
    )
    options.add_stage_options(p.add_argument_group("stage"))
    g = p.add_argument_group("output")
    g.add_argument("-o", "--output", metavar="FOLDER", help="write tuned.h, tuned.txt, tuned.json and tuned.png there")
    options.add_force_option(g)


def run(args: argparse.Namespace) -> int:
    """Search for registers, print them, and write them to files."""
    from stage.tune import Task, tune
    from stage.tune.search import import_optuna

    if args.distance is None:
        raise ArgumentError("--distance: registers are for one distance. Give it, for example --distance 100mm.")
    folder = _prepare_output_folder(args)
    if args.by == "search":
        import_optuna()
    if args.seed < 0:
        raise ArgumentError(f"--seed {args.seed}: must be a whole number, 0 or more.")
    stage = make_stage(args, visuals=False)
    axis = find_axis(stage, args.axis) if args.axis else next(iter(stage.axes.values()))
    within, hold = _parse_settle(axis, args.settle)
    overshoot = None if args.overshoot is None else _parse_length(axis, "--overshoot", args.overshoot)
    pulses = parse_distance(axis, args.distance)
    task = Task(
        stage, axis.name, pulses, args.payload, parse_spare(args.spare, args.payload), within, hold,
        overshoot, args.site, args.payload_on,
    )  # fmt: skip
    unit_hint = propose_distance_unit(axis, args.distance)
    if unit_hint and abs(pulses) * abs(axis.meters_per_pulse * axis.gear) < SHORT_MOVE_RAD:
        warn(args, unit_hint)
    progress = _SearchProgress(args.trials)
    try:
        result = tune(
            task,
            by=args.by,
            trials=args.trials,
            seed=args.seed,
            workers=args.workers,
            moves=args.moves,
            on_progress=progress,
        )
    except StageError as error:
        raise StageError(f"{error} {unit_hint}".rstrip()) from error
    finally:
        rewrite_line("")
    add_facts(args, result)
    print(result)
    if folder is None:
        print(f"\n{result.c_source()}", end="")
    else:
        _write_files(args, result, folder)
    return 130 if result.interrupted else 0


def _write_files(args: argparse.Namespace, result: Any, folder: Path) -> None:
    """Write the files of a result into a folder."""
    from stage.support.files import write_atomically

    texts = {"c": result.c_source(), "text": f"{result}\n", "json": json.dumps(result.json(), indent=1) + "\n"}
    for kind, text in texts.items():
        with write_atomically(folder / FILES[kind], args.force) as part:
            part.write_text(text, encoding="utf-8")
    files = [FILES[kind] for kind in texts]
    try:
        result.plot(folder / FILES["picture"], args.force)
        files.append(FILES["picture"])
    except StageError as error:
        print(f"stage: no picture: {error}", file=sys.stderr)
    print(f"\n{folder}: {', '.join(files)}")


def _prepare_output_folder(args: argparse.Namespace) -> Path | None:
    """Return the folder of --output, and create it if it is missing. Raises FileError for a folder that cannot be written to."""
    from stage.support.files import FileError, check_writable

    if args.output is None:
        return None
    folder = Path(args.output)
    if folder.exists() and not folder.is_dir():
        raise FileError(f"--output {folder}: there is a file of this name. Name a folder.")
    if not folder.exists():
        check_writable(folder, False)
        try:
            folder.mkdir()
        except OSError as error:
            raise FileError(f"--output {folder}: {error.strerror}. Choose another folder.") from error
        return folder
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f"--output {folder}: you have no permission to write there. Choose another folder.")
    for name in FILES.values():
        check_writable(folder / name, args.force, overwrite_hint="give --force")
    return folder


def parse_spare(text: str, payload: float) -> float | None:
    """Return the additional mass for --spare, kg, or None for a share of no payload, where the usual margin holds.

    Args:
        text: Typed mass, for example 0.6, or share of the payload, for example 30%.
        payload: Mass of the payload, kg.

    Raises:
        ArgumentError: The text is neither a mass nor a share.
    """
    text = text.strip()
    number, percent, rest = text.partition("%")
    value = parse_quantity(number, {"": 1.0} if percent else {"": 1.0} | OTHER_FACTORS["mass"])
    if value is None or rest or not 0 <= value < float("inf"):
        raise ArgumentError(f"--spare {text}: give percent of the payload, such as 30%, or kg, such as 0.6.")
    if not percent:
        return value
    return value / 100 * payload if payload else None


def propose_distance_unit(axis: Any, distance: str) -> str:
    """Return a sentence that proposes a unit for a distance without one, which counts as pulses; "" for a distance with a unit."""
    from stage.firmware.driver import get_driver

    distance = distance.strip()
    if parse_quantity(distance, {"": 1.0}) is None:
        return ""
    pulses = "counts" if get_driver(axis).has_position_loop else "pulses"
    return f"--distance {distance} is {distance} {pulses}: did you mean {distance}{POSITION_UNITS[axis.unit].symbol}?"


def _parse_settle(axis: Any, settle: list[str] | None) -> tuple[float | None, float]:
    """Return the window of --settle in m (rad), or None for the usual one, and its time in s. Raises ArgumentError."""
    from stage.tune.task import DEFAULT_HOLD_S

    if settle is None:
        return None, DEFAULT_HOLD_S
    return _parse_length(axis, "--settle", settle[0]), _parse_positive(
        "--settle", settle[1], OTHER_FACTORS["time"], "50ms"
    )


def _parse_length(axis: Any, option: str, text: str) -> float:
    """Return a length in m, or in rad on a hinge. Raises ArgumentError."""
    return _parse_positive(option, text, POSITION_FACTORS[axis.unit], "50um" if axis.unit == "m" else "50mdeg")


def _parse_positive(option: str, text: str, units: dict[str, float], example: str) -> float:
    """Parse a positive number with a unit. Raises ArgumentError.

    Args:
        option: Option with this value, for errors.
        text: The text.
        units: SI value of each allowed unit.
        example: Example of a value, for errors.
    """
    value = parse_quantity(text, units)
    if value is None or not 0 < value < float("inf"):
        raise ArgumentError(
            f"{option} {text.strip()}: must be greater than 0, in one of {', '.join(units)}; for example {example}."
        )
    return value


class _SearchProgress:
    """Line on a terminal that shows how many trials of a search are done."""

    def __init__(self, trials: int):
        self._trials = trials

    def __call__(self, task: str, share: float, best: float | None) -> None:
        trials = f" {round(share * self._trials)} of {self._trials} trials" if task == "searching" else ""
        best_time = f", best {best * 1e3:.1f} ms" if best is not None else ""
        rewrite_line(f"{task}{trials}{best_time} ...")
