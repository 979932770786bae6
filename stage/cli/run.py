"""The commands `stage run` and `stage include`: firmware on an emulated board."""

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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stage.chips.write_diagnostics import BUS_WRITE, summarize_diagnostics
from stage.cli import options, serial_options
from stage.cli.command_interface import add_command, add_facts, report_written_file, warn
from stage.cli.options import DURATION, FREQUENCY, TIME, parse_integer
from stage.cli.output_and_progress import show_simulated_time, show_status
from stage.cli.output_files import check_outputs, record_to_files
from stage.cli.panel import keep_panel, run_in_real_time, show_panel
from stage.cli.stage_setup import find_axis, make_board
from stage.errors import ArgumentError, StageError
from stage.support.axis_value_parsing import split_pair
from stage.units import POSITION_UNITS, format_step_count

MAX_PRINTED_DIAGNOSTICS = 10
"""Diagnostics of a chip that a report prints."""


def add_subcommand(commands: Any) -> None:
    """Add `stage run` and `stage include` to argparse's subparsers."""
    p = add_command(
        commands, "run", run, "run firmware in C on an emulated board",
        "Run firmware (a shared library, or a C or C++ source, which is built first) against the chips. Print its log, the final "
        "positions of the axes, and bus writes that are mistakes according to the data sheet. Exit code 0 if it returns 0, "
        "loses no step that --allow-lost-steps does not allow, and drives the STEP/DIR axes at the pins that --pins names.",
        ("stage run driver.c --chips pcl240mk", "build a driver and run it against the chips"),
        ("stage run driver.c --trace - --vcd bus.vcd", "print the bus cycles, and write them as waveforms"),
        ("stage run mill.ino --for 2 --chips hctl1100", "run an Arduino sketch for 2 simulated seconds"),
        ("stage run x.ino --library AccelStepper --for 2 --chips stepdir --pins cnc-shield-v3", "run a sketch with a library"),
    )  # fmt: skip
    p.add_argument(
        "firmware", nargs="+", metavar="FIRMWARE",
        help="driver.so, or C or C++ sources, or a sketch (.ino, .pde); docs/firmware_in_the_loop.md",
    )  # fmt: skip
    _add_target_options(p)
    g = p.add_argument_group("firmware")
    g.add_argument(
        "--cflags", action="append", default=[], metavar="OPTIONS",
        help='options of the compiler, for example --cflags="-Ihal -DSLOW"; several add up',
    )  # fmt: skip
    g.add_argument(
        "--platform",
        help="platform of the sources: arduino (a .ino always is), avr, vxworks, dos, freertos; docs/porting.md",
    )
    g.add_argument(
        "--library", action="append", default=[], metavar="DIR",
        help="folder of an Arduino library that the sketch uses, once for each; docs/step_dir.md",
    )  # fmt: skip
    g.add_argument(
        "--timeout",
        type=TIME,
        default=60.0,
        action=options.ExplicitValueAction,
        help="simulated seconds within which the firmware must return (default: 60)",
    )
    g.add_argument(
        "--patience", type=TIME, default=20.0, metavar="S",
        help="seconds of real time that the firmware may compute without a bus cycle (default: 20)",
    )  # fmt: skip
    g.add_argument(
        "--for", dest="seconds", type=DURATION, metavar="SECONDS",
        help="stop the firmware after this many simulated seconds; needed if it never returns, like a sketch",
    )  # fmt: skip
    g.add_argument(
        "--allow-lost-steps", action="append", default=[], metavar="AXIS=STEPS",
        help="full steps that an axis may lose without exit code 1, for firmware that homes against a stop: x=8",
    )  # fmt: skip
    g.add_argument(
        "--cost", type=TIME, default=0.0, metavar="S",
        help="simulated seconds that each basic block of the firmware takes, for example 50e-9 (default: computing takes no time); "
        "docs/interrupts.md",
    )  # fmt: skip
    g.add_argument(
        "--in-process", action="store_true",
        help="run the firmware in this process, for debuggers (default: in a separate one, so that a crash ends only that one)",
    )  # fmt: skip
    g.add_argument("--isolated", action="store_true", help=argparse.SUPPRESS)  # what is the default now
    serial_options.add_serial_options(p)
    options.add_board_options(p)
    options.add_panel_options(p)
    options.add_stage_and_output_options(p)
    add_command(
        commands, "include", print_include_folder, "print the folder of pulsestage.h",
        'Print the folder of the one header that firmware needs: cc -shared -fPIC -I"$(stage include)" driver.c -o driver.so',
        ("stage include", "print the folder"),
    )  # fmt: skip


def _add_target_options(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("programs of another processor (docs/targets.md)")
    g.add_argument("--mcu", help="processor of the program: atmega2560 or another AVR, cortex-m3, 8086")
    g.add_argument(
        "--map", action="append", default=[],
        help="memory-mapped registers, with or without --mcu: 0x40021000=0x300+0x40 puts the 40h ports from 300h on at 40021000h "
        "(docs/memory_mapped.md); for an AVR its pins: data=A,address=C:0-1,cs=B0,wr=G0,rd=G1,irq=D0",
    )  # fmt: skip
    g.add_argument(
        "--pins",
        action="append",
        default=[],
        help="pins of firmware, or of an AVR, that drive STEP/DIR axes and read their switches: x.step=D2,x.dir=D5,x.limit=!B1, "
        "or a board: grbl, cnc-shield-v3, ramps (docs/step_dir.md); x.uart=Serial connects the UART of a power stage to the "
        "firmware's serial line",
    )  # fmt: skip
    g.add_argument(
        "--mcu-clock",
        type=FREQUENCY,
        metavar="HZ",
        help="clock of the processor, for example 16e6 (default: the usual one)",
    )
    g.add_argument("--gdb", type=parse_integer, metavar="PORT", help="wait for GDB on this port of 127.0.0.1")


def run(args: argparse.Namespace) -> int:
    """Run firmware; print what it noted and where the axes are."""
    check_outputs(args)
    flags = tuple(flag for text in args.cflags for flag in _split_flags(text))
    with serial_options.open_serial_peer(args) as end:
        return _run_with_serial_peer(args, flags, end)


def _split_flags(text: str) -> list[str]:
    """Split the value of --cflags as a shell does. Raises ArgumentError."""
    try:
        return shlex.split(text)
    except ValueError as failed:
        raise ArgumentError(f"--cflags {text!r}: {failed}.") from None


def _run_with_serial_peer(args: argparse.Namespace, flags: tuple[str, ...], end: Any) -> int:
    """Make board and host, and run the firmware; return the exit code.

    Args:
        args: Options of the command.
        flags: Options of the compiler.
        end: Other end of the serial line, or None.
    """
    with _show_compiler_warnings(args):
        board = make_board(args)
        allowed = _parse_allowed_losses(args.allow_lost_steps, board.stage)
        host = _make_host(args, board, flags)
    serial_options.prepare_host(args, host, end)
    terminated = threading.Event()
    with show_panel(args, board.stage, Path(args.firmware[0]).name) as session:
        code = _run_firmware(args, board, host, session, end, terminated)
        losing = {name: axis for name, axis in board.stage.axes.items() if abs(axis.lost_steps) > allowed.get(name, 0)}
        for name, axis in losing.items():
            print(_describe_loss(name, axis, allowed.get(name)))
        code = code or int(bool(losing))
        if session is not None and not terminated.is_set():
            keep_panel(session)
    return code


def _run_firmware(
    args: argparse.Namespace, board: Any, host: Any, session: Any, end: Any, terminated: threading.Event
) -> int:
    """Run firmware, and print what came of it; return the exit code.

    Args:
        args: Options of the command.
        board: Board that the firmware drives.
        host: Host that runs the firmware.
        session: Session of the page beside it, or None.
        end: Other end of its serial line, or None.
        terminated: Event that SIGTERM sets.
    """
    from stage.board import HostTimeout

    stage = board.stage
    begin = time.perf_counter()
    with record_to_files(args, stage):
        show_status(f"{host.path.name} runs ...")
        result, error = _run_to_end(args, board, host, session, end, terminated)
        wall = time.perf_counter() - begin
        for seconds, text in board.log:
            print(f"{seconds:12.6f}  {text}")
        if result is not None:
            print(
                f"{host.path.name} returned {result.code} after {result.seconds:.6f} s of simulated time and {result.cycles:,} bus "
                f"cycles, in {wall:.2f} s of wall time"
            )
        elif error is None:
            seconds = stage.time if args.seconds is None else args.seconds
            print(
                f"{host.path.name} ran for {seconds:g} s, and {board.cycles:,} bus cycles, in {wall:.2f} s of wall time"
            )
        print_report(board, [finding.text for finding in host.wiring_findings])
        serial_options.print_serial_report(args, host)
        if args.json:
            remarks = [finding.text for finding in host.wiring_findings if not finding.is_problem]
            wiring = {"wiring_problems": host.wiring_problems, "wiring_remarks": remarks}
            facts = _collect_facts(board, result, error) | wiring
            add_facts(args, facts | serial_options.collect_serial_facts(args, host))
    if result is None:
        host.close()
    write_trace(args, board)
    serial_options.write_serial_log(args, host)
    if error is not None:
        print(f"stage: {error}", file=sys.stderr)
        if isinstance(error, HostTimeout) and any(str(file).endswith((".ino", ".pde")) for file in args.firmware):
            print("A sketch never returns: --for 2 runs it for 2 s.", file=sys.stderr)
        return 1
    done = result is None or result.code == 0
    return 0 if done and not host.wiring_problems else 1


def _parse_allowed_losses(items: Sequence[str], stage: Any) -> dict[str, int]:
    """Parse the values of --allow-lost-steps; return the full steps that each axis may lose. Raises ArgumentError."""
    allowed = {}
    for item in items:
        name, count = split_pair(item)
        if not (name and count.isascii() and count.isdigit()):
            raise ArgumentError(
                f"--allow-lost-steps {item!r}: write AXIS=STEPS, full steps of the motor, for example x=8."
            )
        allowed[find_axis(stage, name).name] = int(count)
    return allowed


def _describe_loss(name: str, axis: Any, limit: int | None) -> str:
    """Return a sentence about the full steps that an axis has lost, more than the limit of --allow-lost-steps."""
    count = abs(axis.lost_steps)
    text = f"{name} has lost {count:,} full step{'s' * (count > 1)}"
    if limit is not None:
        return f"{text}, and --allow-lost-steps allows {limit:,}: exit code 1."
    if axis.chip.explain_missing_current(axis.chip_axis):
        return f"{text}: exit code 1."
    return (
        f"{text}: exit code 1. If it runs against a stop on purpose, as in homing without a switch, --allow-lost-steps "
        f"{name}={count} allows them."
    )


def _run_to_end(
    args: argparse.Namespace, board: Any, host: Any, session: Any, end: Any, terminated: threading.Event
) -> tuple[Any, StageError | None]:
    """Run firmware; return its result, or None, and the error that has ended it, or None.

    Recording and trace are written after an error, too. Arguments are those of `_run_firmware`.
    """
    from stage.board import HostError, HostTimeout, StormError
    from stage.errors import SimulationError

    timeout = serial_options.choose_timeout(args)

    def run(seconds: float | None) -> Any:
        if session is not None:
            return run_in_real_time(session, host, seconds, timeout)
        return host.run(timeout=timeout) if seconds is None else host.run_for(seconds)

    try:
        with _raise_at_sigterm(board, terminated), show_simulated_time(board.stage):
            return serial_options.run_host(args, host, end, run), None
    except (HostTimeout, HostError, StormError, SimulationError) as failed:
        return None, failed
    except KeyboardInterrupt:
        if not serial_options.is_endless(args):
            raise
        return None, None


@contextmanager
def _show_compiler_warnings(args: argparse.Namespace) -> Iterator[None]:
    """Show the warnings of compilers in this block as the command shows its own."""
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
def _raise_at_sigterm(board: Any, terminated: threading.Event) -> Iterator[None]:
    """Make SIGTERM an error of the firmware in this block, so that files are written when a CI ends what takes too long."""
    from stage.board import HostError

    def end(*_: Any) -> None:
        terminated.set()
        raise HostError(
            f"ended from outside by SIGTERM. What is known of it ends at {board.stage.time:.6f} s, after {board.cycles:,} bus "
            f"cycles. {board.trace.format_ending(12)}"
        )

    main = threading.current_thread() is threading.main_thread()  # other threads get no signals
    before = signal.signal(signal.SIGTERM, end) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGTERM, before)


def _make_host(args: argparse.Namespace, board: Any, flags: tuple[str, ...]) -> Any:
    """Return the host of a library for this machine, or with --mcu of a program for another processor."""
    isolated = os.name == "posix" and not args.in_process
    if args.mcu is None:
        from stage.board import NativeHost

        for name, given in (("--mcu-clock", args.mcu_clock), ("--gdb", args.gdb)):
            if given:
                raise ArgumentError(
                    f"{name}: only programs of other processors have it. Name the processor with --mcu."
                )
        return NativeHost(
            args.firmware, board, isolated=isolated, flags=flags, platform=args.platform, libraries=args.library,
            patience=args.patience, map=args.map, cost=args.cost, pins=args.pins,
        )  # fmt: skip
    from stage.targets import TargetHost

    if len(args.firmware) > 1 or flags or args.platform or args.library or args.cost:
        raise ArgumentError(
            "--mcu: give one program that is already built, without --cflags, --platform, --library and --cost."
        )
    return TargetHost(
        args.firmware[0], board, mcu=args.mcu, map=args.map, pins=args.pins, mcu_clock=args.mcu_clock, gdb=args.gdb,
        isolated=isolated, patience=args.patience,
    )  # fmt: skip


def print_include_folder(args: argparse.Namespace) -> int:
    """Print the folder of pulsestage.h."""
    from stage.board.firmware_library import get_include_folder

    add_facts(args, include=get_include_folder())
    print(get_include_folder())
    return 0


def write_trace(args: argparse.Namespace, board: Any) -> None:
    """Write, or print, the bus cycles for --trace."""
    from stage.support.files import write_atomically

    if args.trace == "-":
        print(board.trace.text())
    elif args.trace:
        with write_atomically(args.trace, args.force) as part:
            part.write_text(board.trace.text() + "\n", encoding="utf-8", errors="backslashreplace")
        report_written_file(args, args.trace, f"{len(board.trace):,} lines of bus cycles")


def _collect_facts(board: Any, result: Any, error: StageError | None) -> dict[str, Any]:
    """Return what `print_report` prints, and how the firmware ended, for --json."""
    axes = [
        {
            "axis": a.name, "unit": a.unit, "position": a.position, "commanded": a.commanded, "lost_steps": a.lost_steps,
            "switches": [name for name, on in a.switches.as_dict().items() if on],
        }
        for a in board.stage.axes.values()
    ]  # fmt: skip
    diagnostics = {
        board.join_axis_names(k): [_collect_diagnostic(chip, d) for d in chip.diagnostics]
        for k, chip in enumerate(board.stage.chips)
    }
    return {
        "returned": None if result is None else result.code, "error": None if error is None else str(error),
        "seconds": board.stage.time, "cycles": board.cycles, "axes": axes, "log": board.log, "diagnostics": diagnostics,
        "strays": sum(c.times for c in board.strays),
    }  # fmt: skip


def _collect_diagnostic(chip: Any, diagnostic: Any) -> dict[str, Any]:
    """Return a diagnostic for --json. One that is about no bus write has no address and no value, but a number as `times`."""
    cause, facts = chip.find_cause_of(diagnostic), diagnostic._asdict()
    return facts if cause.kind == BUS_WRITE else facts | {"address": None, "value": None, "times": cause.times}


def print_report(board: Any, wiring_findings: Sequence[str] = ()) -> None:
    """Print where the axes are, lines at the wrong pins, diagnostics of the chips, and bus cycles that reached nothing."""
    _print_axes(board.stage)
    for finding in wiring_findings:
        print(finding)
    for axis in board.stage.axes.values():
        if axis.lost_steps and (reason := axis.chip.explain_missing_current(axis.chip_axis)):
            print(f"{axis.name} has lost steps without current: {reason}.")
    for k, chip in enumerate(board.stage.chips):
        if chip.diagnostics:
            _print_diagnostics(board.join_axis_names(k), chip)
    if strays := board.strays:
        times = sum(c.times for c in strays)
        print(f"{times:,} bus cycles reached no chip or half a register, the first:\n{strays[0]}")


def _print_axes(stage: Any) -> None:
    symbols = [POSITION_UNITS[unit].symbol for unit in dict.fromkeys(axis.unit for axis in stage.axes.values())]
    unit, mixed = "|".join(symbols), len(symbols) > 1
    print(f"{'axis':6}{f'position {unit}':>18}{f'commanded {unit}':>19}{'lost':>6}  switches")
    for axis in stage.axes.values():
        on = ", ".join(name for name, state in axis.switches.as_dict().items() if state)
        unit_of_axis = POSITION_UNITS[axis.unit]
        places, lost = (axis.position, axis.commanded), format_step_count(axis.lost_steps, axis.lost_pulses)
        position, commanded = (unit_of_axis.format(q) if mixed else f"{q * unit_of_axis.factor:.4f}" for q in places)
        print(f"{axis.name:6}{position:>18}{commanded:>19} {lost:>5}  {on}".rstrip())


def _print_diagnostics(name: str, chip: Any) -> None:
    """Print the first diagnostic of each kind, and how often it came."""
    diagnostics, counts = chip.diagnostics, Counter[str]()
    for d in diagnostics:
        counts[d.message] += chip.find_cause_of(d).times
    print(
        f"chip of {name}: {summarize_diagnostics([chip])} that a reader of the data sheet would call mistakes, the "
        f"first of each kind:"
    )
    firsts = {d.message: d for d in reversed(diagnostics)}
    for d in sorted(firsts.values())[:MAX_PRINTED_DIAGNOSTICS]:
        cycle = f", address {d.address} <- {d.value:02X}h" if chip.find_cause_of(d).kind == BUS_WRITE else ""
        again = f" ({counts[d.message]:,} times)" if counts[d.message] > 1 else ""
        print(f"  {d.clock / chip.clock_hz:.6f} s{cycle}: {d.message} [{d.source}]{again}")
