"""Options of a serial line's other end and of the pace of a run: --serial, --serial-script, --realtime."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from stage.cli.command_interface import report_written_file, warn
from stage.errors import ArgumentError, unknown_name_error
from stage.support.files import check_writable, write_atomically

ENDLESS_S = 999_999_999.0


def add_serial_options(p: argparse.ArgumentParser) -> None:
    """Add the options of a serial line and of the pace."""
    g = p.add_argument_group("serial line (docs/serial.md)")
    g.add_argument(
        "--serial", metavar="END",
        help="other end of the firmware's serial line, for a terminal program or a G-code sender: pty prints the path of a "
        "pseudo-terminal, pty:LINK makes a link to it, tcp:5331 listens on 127.0.0.1; the run then lasts until Ctrl-C, --for or "
        "--timeout. A person wants --realtime with it",
    )  # fmt: skip
    g.add_argument(
        "--serial-script", metavar="FILE",
        help="commands that play the other end in simulated time: send, expect, wait, at, timeout; the run ends with the script, "
        "unless --for says how long it lasts",
    )  # fmt: skip
    g.add_argument(
        "--serial-line", metavar="NAME", default="Serial",
        help="serial line that --serial or --serial-script is the other end of: Serial1, SoftwareSerial ... (default: Serial)",
    )  # fmt: skip
    g.add_argument(
        "--serial-log", metavar="FILE",
        help="write what came in over the line as a script; --serial-script FILE then repeats the run, bit for bit",
    )  # fmt: skip
    g.add_argument(
        "--realtime", action="store_true",
        help="hold the run back to wall-clock time, and say how far it lagged behind (default: as fast as it can)",
    )  # fmt: skip


@contextmanager
def open_serial_peer(args: argparse.Namespace) -> Iterator[Any]:
    """Open the other end of the serial line that the options name, for this block; yield it, or None.

    Raises:
        ArgumentError: There are two of them, or one that does not exist.
        FileError: The script cannot be read.
    """
    if args.serial is not None and args.serial_script is not None:
        raise ArgumentError("--serial and --serial-script: a serial line has one other end. Leave one of them out.")
    if args.serial_log is not None:
        if args.serial is None:
            raise ArgumentError(
                "--serial-log: it needs an end whose bytes it writes. Add --serial pty or --serial tcp:5331."
            )
        check_writable(args.serial_log, overwrite=args.force, overwrite_hint="give --force")
    end: Any = None
    if args.serial_script is not None:
        from stage.board.serial_script import read_script

        end = read_script(args.serial_script)
    elif args.serial is not None:
        from stage.board.serial_pty_and_tcp import open_end

        end = open_end(args.serial)
        print(f"serial line: {end.describe()}", file=sys.stderr if args.json else sys.stdout, flush=True)
    try:
        yield end
    finally:
        if end is not None:
            end.close()


def is_endless(args: argparse.Namespace) -> bool:
    """Tell whether the run lasts until somebody ends it."""
    return args.serial is not None and args.seconds is None and not getattr(args, "timeout_given", False)


def choose_timeout(args: argparse.Namespace) -> float:
    """Return the simulated seconds within which the firmware must return."""
    return ENDLESS_S if is_endless(args) else args.timeout


def _get_port(args: argparse.Namespace, host: Any) -> Any:
    """Return the other end of the serial line that --serial-line names. Raises ArgumentError."""
    from stage.board.pin_assignment import SERIAL_LINES

    if args.serial_line not in SERIAL_LINES:
        raise unknown_name_error("serial line", args.serial_line, SERIAL_LINES)
    number = SERIAL_LINES[args.serial_line]
    return host.get_serial_port(number) if number else host.serial


def prepare_host(args: argparse.Namespace, host: Any, end: Any) -> None:
    """Connect the other end of the serial line to a host, and give the host its pace."""
    if end is not None:
        _get_port(args, host).connect(end)
    if args.realtime and not args.panel:  # the panel keeps its own
        from stage.board.pacing import RealTimePace

        host.pacing = RealTimePace()


def run_host(args: argparse.Namespace, host: Any, end: Any, run: Callable[[float | None], Any]) -> Any:
    """Run firmware until it returns, for the time of --for, or until the script at its serial line is over.

    Args:
        args: Options of the command.
        host: Host that runs the firmware.
        end: Other end of its serial line, or None.
        run: Function that runs it for a simulated time, s, or for None until it returns, at the pace of the command.

    Returns:
        The result of firmware that has returned, otherwise None.

    Raises:
        HostTimeout: The firmware has not returned within the timeout, or the script is not over when the run ends.
    """
    from stage.board import HostTimeout

    if args.serial_script is None:
        return run(args.seconds)
    limit = choose_timeout(args) if args.seconds is None else args.seconds
    begin = host.board.stage.now
    result = run(limit)
    if result is not None:
        return result
    if not end.is_over:
        option = "--timeout" if args.seconds is None else "--for"
        raise HostTimeout(
            f"{args.serial_script} is not over after {limit:g} s of simulated time: {end.describe_awaited_event()}. "
            f"{option} allows more."
        )
    if end.ends_with_send and args.seconds is None:
        warn(
            args,
            f"{args.serial_script} ends with send, so the run has ended when the firmware had received it. Add expect or wait "
            "to see what the firmware then does.",
        )
    _get_port(args, host).disconnect()
    rest = 0.0 if args.seconds is None else limit - (host.board.stage.now - begin) * 1e-9
    return run(rest) if rest > 0 else None


def write_serial_log(args: argparse.Namespace, host: Any) -> None:
    """Write the script of --serial-log."""
    if args.serial_log is None:
        return
    from stage.board.serial_script import format_script

    port = _get_port(args, host)
    text = format_script(port.arrivals, host.board.stage.now - port.connected_at)
    with write_atomically(args.serial_log, args.force) as part:
        part.write_text(text, encoding="utf-8")
    report_written_file(args, args.serial_log, f"{port.written:,} bytes that came in over the serial line")


def collect_serial_facts(args: argparse.Namespace, host: Any) -> dict[str, Any]:
    """Return the facts of the serial line and the pace for --json."""
    facts: dict[str, Any] = {}
    if args.serial is not None or args.serial_script is not None:
        port = _get_port(args, host)
        facts["serial"] = {"received": port.received, "sent": port.written}
    if args.realtime and host.pacing is not None:
        facts["realtime"] = {"largest_lag_s": host.pacing.largest_lag_s, "final_lag_s": host.pacing.lag_s}
    return facts


def print_serial_report(args: argparse.Namespace, host: Any) -> None:
    """Print how far a run has lagged behind wall-clock time."""
    if args.realtime and host.pacing is not None:
        print(
            f"real time: the run was behind by {host.pacing.largest_lag_s * 1e3:.1f} ms at most, and by "
            f"{host.pacing.lag_s * 1e3:.1f} ms at its end"
        )
