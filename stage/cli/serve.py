"""The command `stage serve`."""

from __future__ import annotations

import argparse
import ipaddress
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, warn
from stage.cli.options import parse_port
from stage.cli.output_files import check_outputs, record_to_files
from stage.cli.panel import call_at_end_signals, show_panel
from stage.cli.run import print_report, write_trace
from stage.cli.stage_setup import make_board
from stage.errors import ArgumentError


def add_subcommand(commands: Any) -> None:
    """Add `stage serve` to argparse's subparsers."""
    p = add_command(
        commands, "serve", run, "the chips behind a TCP port, for a host elsewhere",
        "Serve the bus, time and pins of a stage over TCP: a driver in another language, in a virtual machine or an emulator makes "
        "its bus cycles here. Clients in Python and C are included, see docs/serve.md. One host drives, others may watch. Ctrl-C "
        "or SIGTERM ends it, and the files of --record, --vcd and --trace are written.",
        ("stage serve --chips mcx304", "the chips behind 127.0.0.1:7240"),
        ("stage serve --listen 0 --fresh --trace bus.txt", "a free port, a stage from the start for each host"),
        json=False,
    )  # fmt: skip
    g = p.add_argument_group("server")
    g.add_argument(
        "--bind", default="127.0.0.1", metavar="ADDRESS",
        help="address to listen on (default: 127.0.0.1, this machine only)",
    )  # fmt: skip
    g.add_argument(
        "--listen", type=parse_port, default=7240, metavar="PORT", help="TCP port; 0 chooses a free one (default: 7240)"
    )
    g.add_argument(
        "--fresh", action="store_true",
        help="reset the stage for each host (default: a host continues where the previous one stopped)",
    )  # fmt: skip
    options.add_board_options(p)
    options.add_panel_options(p)
    options.add_stage_and_output_options(p)


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C or SIGTERM; then write the requested files, and print the positions of the axes."""
    if args.fresh and (args.record or args.vcd or args.view or args.web or args.picture):
        raise ArgumentError(
            "--fresh puts the stage back to its start for each host, and time in a recording only runs forward: give one of them."
        )
    check_outputs(args)
    board = make_board(args)
    with show_panel(args, board.stage, "a host of stage serve") as session:
        return _serve(args, board, session)


def _serve(args: argparse.Namespace, board: Any, session: Any) -> int:
    """Serve a board; return the exit code. `session` is that of the board's live page, or None."""
    from stage.serve.server import Server

    before_each = session.catch_up if session is not None else lambda: None
    server = Server(
        board, args.bind, args.listen, fresh=args.fresh, keep=args.keep, report=_print_now, before_each=before_each
    )
    if not _is_local(args.bind):
        warn(
            args, f"other machines may reach {args.bind}, and there is no password: whoever connects drives the stage."
        )
    with record_to_files(args, board.stage):
        host, port = server.address
        _print_now(f"{board!r}")
        _print_now(f"listening on {f'[{host}]' if ':' in host else host}:{port}; Ctrl-C ends it")

        def end() -> None:
            server.stop()
            if session is not None:
                session.end_program()  # a request that waits, or takes its time, ends where it is

        with call_at_end_signals(end):
            server.run()
        _print_now(f"ended after {board.stage.time:.6f} s of simulated time and {board.cycles:,} bus cycles")
        print_report(board)
    write_trace(args, board)
    return 0


def _print_now(line: Any) -> None:
    """Print a line at once, for a reader that waits for it."""
    print(line, flush=True)


def _is_local(bind: str) -> bool:
    """Return whether an address to listen on is reachable only from this machine."""
    try:
        return ipaddress.ip_address(bind).is_loopback
    except ValueError:
        return bind == "localhost"
