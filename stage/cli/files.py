"""The files that commands write, and the pages that they serve: refused before the work, written after it."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from stage.cli.facts import tell, wrote
from stage.cli.progress import note
from stage.errors import ArgumentError
from stage.support.extras import has, need

FILES = ("record", "vcd", "picture", "plot", "trace")
"""Options that name a file."""


def outputs(args: argparse.Namespace) -> None:
    """Refuse what cannot be written or served, before the work and not after it. Raises FileError, ArgumentError."""
    if getattr(args, "view", False):
        need("rerun", "--view")
        if not getattr(args, "web", False):
            from stage.recording.viewer import check_screen

            check_screen("what --view asks for")
    if getattr(args, "web", False):
        from stage.recording.viewer import check_port

        check_port(args.port)
    elif getattr(args, "port_given", False) and hasattr(args, "web"):
        raise ArgumentError(
            f"--port {args.port}: that is where --web serves the dashboard. Give --web, too, or no port."
        )
    if getattr(args, "json", False):
        for option, given in (
            ("--web", getattr(args, "web", False)),
            ("--trace -", getattr(args, "trace", None) == "-"),
        ):
            if given:
                raise ArgumentError(f"{option}: it prints text, and --json prints JSON. Leave one of them out.")
    _written_apart(args)
    _writable(args)
    if "record" in args:
        for name in ("web", "picture", "record"):  # who gave one of the others gave no --record
            if getattr(args, name, None):
                need("rerun", f"--{name}")


def _named(args: argparse.Namespace) -> dict[str, str]:
    """Option -> file, of those that are given."""
    named = {name: path for name in FILES if (path := getattr(args, name, None))}
    if named.get("trace") == "-":
        del named["trace"]
    return named


def _written_apart(args: argparse.Namespace) -> None:
    """Refuse two outputs in one file. Raises FileError."""
    from stage.support.files import FileError

    taken: dict[str, str] = {}
    for name, path in _named(args).items():
        if os.path.isfile(path) or not os.path.exists(path):  # a device takes all
            other = taken.setdefault(os.path.realpath(path), name)
            if other != name:
                raise FileError(f"--{other} and --{name} both write {path}. Give each a file of its own.")


def _writable(args: argparse.Namespace) -> None:
    """Refuse names that do not end as what is written there, and what cannot be written. Raises FileError, ArgumentError."""
    from stage.support.files import PICTURE, RECORDING, WAVEFORMS, ends_as, figure_format, writable

    endings = {"record": RECORDING, "vcd": WAVEFORMS, "picture": PICTURE}
    for name, path in _named(args).items():
        if path == "-":
            raise ArgumentError(
                f"--{name} -: standard output has what the command prints, and this would be in the middle of it. Name a file."
            )
        if name == "plot":
            figure_format(path)
        elif name in endings:
            ends_as(path, *endings[name])
        writable(path, args.force, ask="give --force")


@contextmanager
def recorded(args: argparse.Namespace, stage: Any, draw: bool = True) -> Iterator[Any]:
    """Record what happens inside if --record, --vcd, --view or --web asks for it, and write it at the end. Yields the recording,
    or None.

    Where Ctrl-C ends the block, what was recorded is written, and the reports so far are printed, and with `draw` drawn for --plot.
    """
    usual = getattr(args, "default_record", "stage.rrd" if args.view or args.web or args.picture else None)
    if usual and not (args.record or args.view or args.web or args.picture or has("rerun")):
        print(f"no {usual}: recordings need rerun: pip install 'pulsestage[rerun]'")
        usual = None
    rrd: str | None = args.record or (usual and _free(usual, args.force))
    outputs(argparse.Namespace(**vars(args) | {"record": rrd}))
    stop = None
    with stage.record() if rrd or args.vcd else nullcontext() as recording:
        try:
            yield recording
        except KeyboardInterrupt as error:
            stop = error
    if stop is not None:
        kept = ": what was recorded until then is written" if recording is not None else ""
        print(f"interrupted after {stage.time:.2f} s of simulated time{kept}")
        _so_far(args, getattr(stop, "reports", []), draw)
    if recording is not None:
        rrd = _write(args, recording, usual)
    if stop is not None:
        raise stop
    if args.web and rrd:
        from stage.recording.viewer import serve_web

        serve_web(rrd, args.port)
    elif args.view and rrd:
        from stage.recording.viewer import open_viewer

        open_viewer(rrd)


def _so_far(args: argparse.Namespace, reports: list[Any], draw: bool) -> None:
    """What procedures that Ctrl-C has ended have done."""
    for report in reports:
        print(report)
    if reports:
        tell(args, reports=reports)
        if draw:
            plot(args, reports[0].plot)


def _write(args: argparse.Namespace, recording: Any, usual: str | None) -> str | None:
    """The files of a recording. Returns the name of the .rrd, None where none was asked for."""
    rrd = None
    if args.record or usual:
        rrd = args.record or _free(str(usual), args.force)  # another command may have taken the name meanwhile
        note(f"writing {rrd} ...")
        recording.save(rrd, overwrite=args.force)
        size = Path(rrd).stat().st_size / 1e6
        wrote(args, rrd, f"{size:.1f} MB, {recording.duration:.2f} s of simulated time; open with: rerun {rrd}")
    if args.vcd:
        note(f"writing {args.vcd} ...")
        recording.to_vcd(args.vcd, overwrite=args.force)
        wrote(args, args.vcd, f"{Path(args.vcd).stat().st_size / 1e6:.1f} MB; open with: gtkwave {args.vcd}")
    if args.picture and rrd:
        from stage.recording.viewer import screenshot

        note(f"rendering {args.picture} ...")
        screenshot(rrd, args.picture, overwrite=args.force)
        wrote(args, args.picture, "the dashboard")
    return rrd


@contextmanager
def kept(args: argparse.Namespace, stage: Any, every: float) -> Iterator[Any]:
    """As `recorded`; and for --plot a recording with `every` s between samples, if the options ask for none."""
    with recorded(args, stage, draw=False) as recording:
        if recording is None and args.plot:
            with stage.record(every) as recording:
                yield recording
        else:
            yield recording


def _free(usual: str, force: bool) -> str:
    """The usual name, or with a number where that one is taken: demo.rrd, demo-2.rrd, ... With --force always the usual one."""
    names = (usual, *(f"{Path(usual).stem}-{n}{Path(usual).suffix}" for n in range(2, 10_000)))
    return usual if force else next((name for name in names if not os.path.lexists(name)), usual)


def plot(args: argparse.Namespace, draw: Callable[..., Any]) -> None:
    if getattr(args, "plot", None):
        draw(args.plot, overwrite=args.force)
        wrote(args, args.plot, "drawn")
