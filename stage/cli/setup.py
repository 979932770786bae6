"""What the moving commands share: the stage from the options, and what to write when it has run."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stage.errors import ArgumentError, StageError, unknown


def make_stage(args: argparse.Namespace, any_chip: bool = False) -> Any:
    """The stage that the options describe. Raises StageError for a chip that is not of the PCL-240 family, the only one that the
    moves of the command line speak to, unless `any_chip`."""
    from stage import Drive, Stage
    from stage.chips import FAMILIES, chip_class
    from stage.chips.pcl240 import PCL240

    chips = chip_class(args.chips)
    if not any_chip and not issubclass(chips, PCL240):
        what = "closes a loop and makes no pulses" if chips.SERVO else "has other registers"
        how = (
            "stage.firmware.hctl1100.moves, see docs/servo.md"
            if chips.SERVO
            else "stage.firmware.nova.mcx300, see docs/nova.md"
        )
        raise StageError(
            f"--chips {args.chips}: an {chips.MAP.chip} {what}; this command's moves are those of the PCL-240 family: "
            f"{', '.join(FAMILIES['pcl240'])}. Programs move it by {how}."
        )
    if chips.SERVO:
        return Stage(args.model, chips=chips, drives=args.motor, bus_cycle=args.bus_cycle)
    motor = {} if args.motor is None else {"motor": args.motor}
    drive = Drive(microsteps=args.microsteps, bus_voltage=args.bus_voltage, **motor)
    return Stage(args.model, chips=chips, drives=drive, bus_cycle=args.bus_cycle)


def profile(args: argparse.Namespace, axis: Any) -> Any:
    """The speeds that the options give."""
    from stage.firmware import Profile

    given = {k: getattr(args, k) for k in ("fl", "fh1", "fh2", "accel", "decel") if getattr(args, k, None) is not None}
    return Profile.of(clock_hz=axis.chip.clock_hz, chip=type(axis.chip), **given)


def find_axis(stage: Any, name: str) -> Any:
    if name not in stage.axes:
        raise unknown("axis", name, stage.axes)
    return stage.axes[name]


def place(stage: Any, axis: Any, option: str, where: float | None) -> None:
    """Put the carriage of `axis` where `option` says, mm (mrad on a hinge). Raises ArgumentError outside its travel."""
    if where is None:
        return
    low, high = (end * 1e3 for end in axis.travel)
    if not low <= where <= high:
        raise ArgumentError(f"{option} {where:g}: axis {axis.name} travels from {low:g} to {high:g} m{axis.unit}.")
    stage.place(**{axis.name: min(max(where * 1e-3, axis.travel[0]), axis.travel[1])})


def outputs(args: argparse.Namespace) -> None:
    """Refuse what cannot be written, before the work and not after it. Raises FileError."""
    from stage.files import FileError, figure_format, writable

    taken: dict[str, str] = {}
    for name in ("record", "vcd", "picture", "plot", "trace"):
        if path := getattr(args, name, None):
            writable(path, args.force, ask="give --force")
            if os.path.isfile(path) or not os.path.exists(path):  # a device takes all
                other = taken.setdefault(os.path.realpath(path), name)
                if other != name:
                    raise FileError(f"--{other} and --{name} both write {path}. Give each a file of its own.")
            if name == "plot":
                figure_format(path)
            if name == "picture" and Path(path).suffix.lower() != ".png":
                raise FileError(f"--picture {path}: the dashboard is drawn as PNG. Name a file that ends in .png.")


@contextmanager
def recorded(args: argparse.Namespace, stage: Any) -> Iterator[Any]:
    """Record what happens inside if --record, --vcd, --view or --web asks for it, and write it at the end. Yields the recording,
    or None."""
    usual = getattr(args, "default_record", "stage.rrd" if args.view or args.web or args.picture else None)
    rrd: str | None = args.record or (usual and _free(usual, args.force))
    outputs(argparse.Namespace(**vars(args) | {"record": rrd}))
    if not (rrd or args.vcd):
        yield None
        return
    with stage.record() as recording:
        yield recording
    if rrd is not None:
        rrd = args.record or _free(str(usual), args.force)  # another command may have taken the name meanwhile
        note(f"writing {rrd} ...")
        recording.save(rrd, overwrite=args.force)
        print(
            f"{rrd}: {Path(rrd).stat().st_size / 1e6:.1f} MB, {recording.duration:.2f} s of simulated time; open with: rerun {rrd}"
        )
    if args.vcd:
        note(f"writing {args.vcd} ...")
        recording.to_vcd(args.vcd, overwrite=args.force)
        print(f"{args.vcd}: {Path(args.vcd).stat().st_size / 1e6:.1f} MB; open with: gtkwave {args.vcd}")
    if args.picture and rrd:
        from stage.recording.viewer import screenshot

        note(f"rendering {args.picture} ...")
        screenshot(rrd, args.picture, overwrite=args.force)
        print(f"{args.picture}: the dashboard")
    if args.web and rrd:
        from stage.recording.viewer import serve_web

        serve_web(rrd, args.port)
    elif args.view and rrd:
        from stage.recording.viewer import open_viewer

        open_viewer(rrd)


def _free(usual: str, force: bool) -> str:
    """The usual name, or with a number where that one is taken: demo.rrd, demo-2.rrd, ... With --force always the usual one."""
    names = (usual, *(f"{Path(usual).stem}-{n}{Path(usual).suffix}" for n in range(2, 10_000)))
    return usual if force else next((name for name in names if not os.path.lexists(name)), usual)


def note(text: str) -> None:
    """Progress, where somebody watches."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)


def progress(what: str, done: float) -> None:
    """A line that counts up to 100 %, where somebody watches."""
    if sys.stderr.isatty():
        print(f"\r{what} {done:4.0%}", end="\n" if done >= 1 else "", file=sys.stderr, flush=True)


def plot(args: argparse.Namespace, draw: Callable[..., Any]) -> None:
    if args.plot:
        draw(args.plot, overwrite=args.force)
        print(f"{args.plot}: drawn")
