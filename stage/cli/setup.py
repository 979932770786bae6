"""What the moving commands share: the stage from the options, and what to write when it has run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stage.errors import StageError, unknown


def make_stage(args: argparse.Namespace, servos: bool = False) -> Any:
    """The stage that the options describe. Raises StageError for a chip of servos unless the command drives `servos`, too."""
    from stage import Drive, Stage
    from stage.chips import chip_class

    chips = chip_class(args.chips)
    if chips.SERVO and servos:
        return Stage(args.model, chips=chips, drives=args.motor, bus_cycle=args.bus_cycle)
    if chips.SERVO:
        raise StageError(
            f"--chips {args.chips}: an {chips.MAP.chip} closes a loop and makes no pulses; this command's moves are those of "
            "the PCL-240 family. Programs move it by stage.firmware.servo, see docs/servo.md."
        )
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


@contextmanager
def recorded(args: argparse.Namespace, stage: Any) -> Iterator[Any]:
    """Record what happens inside if --record, --vcd, --view or --web asks for it, and write it at the end. Yields the recording,
    or None."""
    from stage.files import writable

    usual = getattr(args, "default_record", "stage.rrd" if args.view or args.web or args.picture else None)
    rrd: str | None = args.record or usual
    replace = args.force or args.record is None  # the usual name is ours to write again, one that was given is not
    for path, overwrite in (
        (rrd, replace),
        (args.vcd, args.force),
        (args.picture, args.force),
        (getattr(args, "plot", None), args.force),
    ):
        if path:
            writable(path, overwrite)  # say so before the work, not after it
    if not (rrd or args.vcd):
        yield None
        return
    with stage.record() as recording:
        yield recording
    if rrd is not None:
        note(f"writing {rrd} ...")
        recording.save(rrd, overwrite=replace)
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
