"""Files that commands write, and pages that they serve: checked before the command works, written after it."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from stage.cli.command_interface import add_facts, report_written_file
from stage.cli.output_and_progress import show_status
from stage.errors import ArgumentError
from stage.support.extras import format_install_command, import_extra, is_installed

OUTPUT_FILE_OPTIONS = ("record", "vcd", "picture", "plot", "trace")
"""Options that name a file."""


def check_outputs(args: argparse.Namespace) -> None:
    """Refuse outputs that cannot be written or served, before the command begins its work.

    Raises:
        FileError: A file cannot be written, or has the wrong ending.
        ArgumentError: Options contradict each other.
    """
    _check_viewers(args)
    if getattr(args, "json", False):
        printing = {"--web": getattr(args, "web", False), "--trace -": getattr(args, "trace", None) == "-"}
        for option, given in printing.items():
            if given:
                raise ArgumentError(f"{option}: it prints text, and --json prints JSON. Leave one of them out.")
    named = _list_files(args)
    _check_separate(named)
    _check_writable(named, args.force)
    if "record" in args:
        for name in ("web", "picture", "record"):  # who gave one of the others gave no --record
            if getattr(args, name, None):
                import_extra("rerun", f"--{name}")


def _check_viewers(args: argparse.Namespace) -> None:
    """Refuse --view on a machine without a screen, and a port on which --web cannot serve."""
    web, view = getattr(args, "web", False), getattr(args, "view", False)
    if view:
        import_extra("rerun", "--view")
    if view and not web:
        from stage.recording.rerun_viewer import check_screen

        check_screen("what --view asks for")
    if web:
        from stage.recording.rerun_viewer import check_port

        check_port(args.port)
    elif getattr(args, "port_given", False) and hasattr(args, "web"):
        raise ArgumentError(
            f"--port {args.port}: --web serves the dashboard there. Give --web as well, or leave out --port."
        )


def _list_files(args: argparse.Namespace) -> dict[str, str]:
    """Return the file that each output option names, by the option."""
    named = {name: path for name in OUTPUT_FILE_OPTIONS if (path := getattr(args, name, None))}
    if named.get("trace") == "-":
        del named["trace"]
    return named


def _check_separate(named: dict[str, str]) -> None:
    """Raise FileError if two output options name the same file."""
    from stage.support.files import FileError

    options_by_file: dict[str, str] = {}
    for name, path in named.items():
        if Path(path).is_file() or not Path(path).exists():  # a device takes all
            other = options_by_file.setdefault(os.path.realpath(path), name)
            if other != name:
                raise FileError(f"--{other} and --{name} both write {path}. Give each a file of its own.")


def _check_writable(named: dict[str, str], force: bool) -> None:
    """Raise FileError or ArgumentError for a file with a wrong ending, or one that cannot be written."""
    from stage.support.files import PICTURE, RECORDING, WAVEFORMS, check_ending, check_writable, find_figure_format

    endings = {"record": RECORDING, "vcd": WAVEFORMS, "picture": PICTURE}
    for name, path in named.items():
        if path == "-":
            raise ArgumentError(f"--{name} -: the command prints its text to standard output. Give the name of a file.")
        if name == "plot":
            find_figure_format(path)
        elif name in endings:
            check_ending(path, *endings[name])
        check_writable(path, force, overwrite_hint="give --force")


@contextmanager
def record_to_files(args: argparse.Namespace, stage: Any, plot_reports: bool = True) -> Iterator[Any]:
    """Record this block if --record, --vcd, --view or --web asks for it, and write the files at its end.

    If Ctrl-C ends the block, the recording so far is written, and the reports so far are printed.

    Args:
        args: Options of the command.
        stage: Stage that the block drives.
        plot_reports: Whether to draw the reports so far for --plot after Ctrl-C, too.

    Yields:
        The recording, or None.
    """
    usual = getattr(args, "default_record", "stage.rrd" if args.view or args.web or args.picture else None)
    diagram = getattr(args, "default_picture", None) if is_installed("matplotlib") else None
    rerun_missing = usual and not (args.record or args.view or args.web or args.picture or is_installed("rerun"))
    missing_name, usual = usual, None if rerun_missing else usual
    rrd: str | None = args.record or (usual and find_free_name(usual, args.force, diagram))
    check_outputs(argparse.Namespace(**vars(args) | {"record": rrd}))
    if rerun_missing:
        print(
            f"no {missing_name} is written: recordings need rerun. Install it with: {format_install_command('rerun')}."
        )
    stop = None
    with stage.record() if rrd or args.vcd or diagram else nullcontext() as recording:
        try:
            yield recording
        except KeyboardInterrupt as error:
            stop = error
    if stop is not None:
        written = "; the recording up to then is written" if recording is not None else ""
        print(f"interrupted after {stage.time:.2f} s of simulated time{written}")
        _show_reports(args, getattr(stop, "reports", []), plot_reports)
    if recording is not None:
        rrd = _write_recording(args, recording, usual, diagram)
    if stop is not None:
        raise stop
    if args.web and rrd:
        from stage.recording.rerun_viewer import serve_web

        serve_web(rrd, args.port)
    elif args.view and rrd:
        from stage.recording.rerun_viewer import open_viewer

        open_viewer(rrd)


@contextmanager
def record_for_plot(args: argparse.Namespace, stage: Any, interval: float) -> Iterator[Any]:
    """Record this block as `record_to_files` does; if no option asks for a recording, record samples for --plot only.

    Args:
        args: Options of the command.
        stage: Stage that the block drives.
        interval: Time between two samples for --plot, s.
    """
    with record_to_files(args, stage, plot_reports=False) as recording:
        if recording is None and args.plot:
            with stage.record(interval) as recording:
                yield recording
        else:
            yield recording


def _show_reports(args: argparse.Namespace, reports: list[Any], plot: bool) -> None:
    """Print the reports of the procedures that ended before Ctrl-C, and draw them if `plot`."""
    for report in reports:
        print(report)
    if reports:
        add_facts(args, reports=reports)
        if plot:
            draw_plot(args, reports[0].plot)


def _write_recording(args: argparse.Namespace, recording: Any, usual: str | None, diagram: str | None) -> str | None:
    """Write the files of a recording; return the name of the .rrd file, or None if there is none."""
    rrd = None
    if args.record or usual:
        # another command may have taken the name meanwhile
        rrd = args.record or find_free_name(str(usual), args.force, diagram)
        show_status(f"writing {rrd} ...")
        recording.save(rrd, overwrite=args.force)
        size = Path(rrd).stat().st_size / 1e6
        report_written_file(
            args, rrd, f"{size:.1f} MB, {recording.duration:.2f} s of simulated time; open with: rerun {rrd}"
        )
    if diagram:
        diagram = str(Path(rrd).with_suffix(Path(diagram).suffix)) if rrd else find_free_name(diagram, args.force)
        show_status(f"drawing {diagram} ...")
        recording.plot(diagram, overwrite=args.force)
        report_written_file(args, diagram, "the moves as a diagram: rates, positions, errors, switches")
    if args.vcd:
        show_status(f"writing {args.vcd} ...")
        recording.to_vcd(args.vcd, overwrite=args.force)
        report_written_file(
            args, args.vcd, f"{Path(args.vcd).stat().st_size / 1e6:.1f} MB; open with: gtkwave {args.vcd}"
        )
    if args.picture and rrd:
        from stage.recording.rerun_viewer import take_screenshot

        show_status(f"rendering {args.picture} ...")
        take_screenshot(rrd, args.picture, overwrite=args.force)
        report_written_file(args, args.picture, "the dashboard")
    return rrd


def find_free_name(usual: str, force: bool, sibling: str | None = None) -> str:
    """Return `usual`, or if such a file exists the same name with a number: demo.rrd, demo-2.rrd, ...

    Args:
        usual: Name of the file.
        force: Whether to return `usual` even if the file exists.
        sibling: File that gets the same number, so that both names must be free; or None.
    """
    endings = {Path(name).suffix for name in (usual, sibling) if name}
    stems = (Path(usual).stem, *(f"{Path(usual).stem}-{n}" for n in range(2, 10_000)))
    free = (stem for stem in stems if not any(os.path.lexists(stem + ending) for ending in endings))
    return usual if force else next(free, Path(usual).stem) + Path(usual).suffix


def draw_plot(args: argparse.Namespace, draw: Callable[..., Any]) -> None:
    """Draw the diagram for --plot by `draw`, if the option is given."""
    if getattr(args, "plot", None):
        draw(args.plot, overwrite=args.force)
        report_written_file(args, args.plot, "drawn")
