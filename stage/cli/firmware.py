"""The commands run and include: firmware in C on an emulated board."""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from stage.cli.beside import beside, live_on, run_beside
from stage.cli.facts import tell, warn, wrote
from stage.cli.files import outputs, recorded
from stage.cli.progress import note, ticking
from stage.cli.setup import make_board
from stage.errors import ArgumentError, StageError
from stage.units import PLACES

SHOWN = 10


def run(args: argparse.Namespace) -> int:
    """Run firmware; print what it noted and where the axes are."""
    outputs(args)
    try:
        flags = tuple(shlex.split(args.cflags))
    except ValueError as failed:
        raise ArgumentError(f"--cflags {args.cflags!r}: {failed}.") from None
    with _compiler_warnings(args):
        board = make_board(args)
        host = _host(args, board, flags)
    stage = board.stage
    ended = threading.Event()
    with beside(args, stage, os.path.basename(args.firmware[0])) as session:
        code = _run(args, board, host, session, ended)
        if session is not None and not ended.is_set():
            live_on(session)
    return code


def _run(args: argparse.Namespace, board: Any, host: Any, session: Any, ended: threading.Event) -> int:
    """session: of the page beside it, or None; ended: is set where somebody outside ends it."""
    from stage.board import HostError, HostTimeout, StormError
    from stage.errors import SimulationError

    stage = board.stage
    error: StageError | None = None
    result = None
    begin = time.perf_counter()
    with recorded(args, stage):
        note(f"{host.path.name} runs ...")
        try:
            with _told_of_the_end(board, ended), ticking(stage):
                if session is not None:
                    result = run_beside(session, host, args.seconds, args.timeout)
                else:
                    result = host.run(timeout=args.timeout) if args.seconds is None else host.run_for(args.seconds)
        except (
            HostTimeout,
            HostError,
            StormError,
            SimulationError,
        ) as failed:  # recording and trace are wanted all the more
            error = failed
        wall = time.perf_counter() - begin
        for seconds, text in board.log:
            print(f"{seconds:12.6f}  {text}")
        if result is not None:
            print(
                f"{host.path.name} returned {result.code} after {result.seconds:.6f} s of simulated time and {result.cycles:,} bus "
                f"cycles, in {wall:.2f} s of wall time"
            )
        elif error is None:
            print(
                f"{host.path.name} has run for {args.seconds:g} s, and {board.cycles:,} bus cycles, in {wall:.2f} s of wall time"
            )
        report(board)
        if args.json:
            tell(args, _facts(board, result, error))
    if result is None:
        host.close()
    write_trace(args, board)
    if error is not None:
        print(f"stage: {error}", file=sys.stderr)
        if isinstance(error, HostTimeout) and any(str(file).endswith(".ino") for file in args.firmware):
            print("A sketch never returns: --for 2 runs it for 2 s.", file=sys.stderr)
        return 1
    done = result.code == 0 if result is not None else args.seconds is not None
    return 0 if done and not any(a.lost_steps for a in stage.axes.values()) else 1


@contextmanager
def _compiler_warnings(args: argparse.Namespace) -> Iterator[None]:
    """Say what compilers warn of in this block, as the command says its own warnings."""
    from stage.board import CompilerWarning

    with warnings.catch_warnings():
        show_others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **kwargs: Any) -> None:
            if issubclass(category, CompilerWarning):
                warn(args, str(message))
            else:
                show_others(message, category, *place, **kwargs)

        warnings.showwarning = show
        warnings.simplefilter("always", CompilerWarning)
        yield


@contextmanager
def _told_of_the_end(board: Any, ended: threading.Event) -> Iterator[None]:
    """SIGTERM, with which a CI ends what takes too long, is an error of the run in this block: all that is asked for is written."""
    from stage.board import HostError

    def end(*_: Any) -> None:
        ended.set()
        raise HostError(
            f"ended from outside by SIGTERM. What is known of it ends at {board.stage.time:.6f} s, after {board.cycles:,} bus "
            f"cycles:\n{board.trace.text(12)}"
        )

    main = threading.current_thread() is threading.main_thread()  # others are told of no signal
    before = signal.signal(signal.SIGTERM, end) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGTERM, before)


def _host(args: argparse.Namespace, board: Any, flags: tuple[str, ...]) -> Any:
    """The firmware as a library of this machine, or with --mcu as a program of another."""
    isolated = os.name == "posix" and not args.in_process
    if args.mcu is None:
        from stage.board import NativeHost

        for name, given in (("--mcu-clock", args.mcu_clock), ("--gdb", args.gdb)):
            if given:
                raise ArgumentError(f"{name}: it is for programs of other processors; --mcu says of which.")
        return NativeHost(
            args.firmware,
            board,
            isolated=isolated,
            flags=flags,
            platform=args.platform,
            patience=args.patience,
            map=args.map,
            cost=args.cost,
        )
    from stage.targets import TargetHost

    if len(args.firmware) > 1 or flags or args.platform or args.cost:
        raise ArgumentError("--mcu: give one program that is built, and no --cflags, --platform or --cost.")
    return TargetHost(
        args.firmware[0], board, mcu=args.mcu, map=args.map, mcu_clock=args.mcu_clock, gdb=args.gdb, isolated=isolated,
        patience=args.patience,
    )  # fmt: skip


def include(args: argparse.Namespace) -> int:
    """Print the folder of pulsestage.h."""
    from stage.board.library import include

    tell(args, include=include())
    print(include())
    return 0


def write_trace(args: argparse.Namespace, board: Any) -> None:
    """The file of --trace."""
    from stage.support.files import written

    if args.trace == "-":
        print(board.trace.text())
    elif args.trace:
        with written(args.trace, args.force) as part:
            part.write_text(board.trace.text() + "\n", encoding="utf-8", errors="backslashreplace")
        wrote(args, args.trace, f"{len(board.trace):,} lines of bus cycles")


def _facts(board: Any, result: Any, error: StageError | None) -> dict[str, Any]:
    """What `report` prints, and how the firmware ended, for --json."""
    axes = [
        {
            "axis": a.name, "unit": a.unit, "position": a.position, "commanded": a.commanded, "lost_steps": a.lost_steps,
            "switches": [name for name, on in a.switches.as_dict().items() if on],
        }
        for a in board.stage.axes.values()
    ]  # fmt: skip
    said = {board.name_of(k): [d._asdict() for d in chip.diagnostics] for k, chip in enumerate(board.stage.chips)}
    return {
        "returned": None if result is None else result.code, "error": None if error is None else str(error),
        "seconds": board.stage.time, "cycles": board.cycles, "axes": axes, "log": board.log, "diagnostics": said,
        "strays": sum(c.times for c in board.strays),
    }  # fmt: skip


def report(board: Any) -> None:
    """Print where the axes are, mistakes of the host, and cycles that reached nothing."""
    stage = board.stage
    units = [PLACES[unit].symbol for unit in dict.fromkeys(axis.unit for axis in stage.axes.values())]
    unit, mixed = "|".join(units), len(units) > 1
    print(f"{'axis':6}{f'position {unit}':>18}{f'commanded {unit}':>19}{'lost':>6}  switches")
    for axis in stage.axes.values():
        on = ", ".join(name for name, state in axis.switches.as_dict().items() if state)
        own = PLACES[axis.unit]
        position, commanded = (own.text(q) if mixed else f"{q * own.per:.4f}" for q in (axis.position, axis.commanded))
        print(f"{axis.name:6}{position:>18}{commanded:>19}{axis.lost_steps:6}  {on}".rstrip())
    for axis in stage.axes.values():
        if axis.lost_steps and (why := axis.chip.explain_missing_current(axis.chip_axis)):
            print(f"{axis.name} has lost steps without current: {why}.")
    for k, chip in enumerate(stage.chips):
        said = chip.diagnostics
        if said:
            print(
                f"chip of {board.name_of(k)}: {len(said)} writes that a reader of the data sheet would call mistakes, the first of "
                "each kind:"
            )
            firsts = {d.message: d for d in reversed(said)}
            times = Counter(d.message for d in said)
            for d in sorted(firsts.values())[:SHOWN]:
                again = f" ({times[d.message]} times)" if times[d.message] > 1 else ""
                what = f"address {d.address} <- {d.value:02X}h: {d.message} [{d.source}]{again}"
                print(f"  {d.clock / chip.clock_hz:.6f} s, {what}")
    if strays := board.strays:
        print(
            f"{sum(c.times for c in strays):,} bus cycles reached no chip or half a register, the first:\n{strays[0]}"
        )
