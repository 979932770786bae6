"""The command serve: the chips behind a TCP port."""

from __future__ import annotations

import argparse
import ipaddress
import signal
import sys
from typing import Any

from stage.cli.beside import beside
from stage.cli.files import outputs, recorded
from stage.cli.firmware import report, write_trace
from stage.cli.setup import make_board
from stage.errors import ArgumentError


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C or SIGTERM; then write what is asked for, and print where the axes are."""
    if args.fresh and (args.record or args.vcd or args.view or args.web or args.picture):
        raise ArgumentError(
            "--fresh goes back to the start for each host, and time in a recording runs forward only: give one."
        )
    outputs(args)
    board = make_board(args)
    with beside(args, board.stage, "a host of stage serve") as session:
        return _serve(args, board, session)


def _serve(args: argparse.Namespace, board: Any, session: Any) -> int:
    """session: of the page beside it, or None."""
    from stage.serve.server import Server

    before_each = session.catch_up if session is not None else lambda: None
    server = Server(board, args.bind, args.listen, fresh=args.fresh, keep=args.keep, told=_say, before_each=before_each)
    if not _stays_here(args.bind):
        print(
            f"stage: warning: others than this machine may reach {args.bind}, and nobody is asked for a password: whoever connects "
            "drives the stage.",
            file=sys.stderr,
        )
    with recorded(args, board.stage):
        host, port = server.address
        _say(f"{board!r}")
        _say(f"listening on {f'[{host}]' if ':' in host else host}:{port}; Ctrl-C ends it")

        def end(*_: Any) -> None:
            server.stop()
            if session is not None:
                session.end_program()  # a request that waits, or takes its time, ends where it is

        before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            server.run()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        _say(f"ended after {board.stage.time:.6f} s of simulated time and {board.cycles:,} bus cycles")
        report(board)
    write_trace(args, board)
    return 0


def _say(line: Any) -> None:
    """To whoever reads our output as it comes."""
    print(line, flush=True)


def _stays_here(bind: str) -> bool:
    try:
        return ipaddress.ip_address(bind).is_loopback
    except ValueError:
        return bind == "localhost"
