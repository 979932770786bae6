"""The command `stage mcp`."""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command
from stage.cli.options import TIME, parse_integer, parse_port
from stage.cli.stage_setup import make_stage
from stage.errors import ArgumentError
from stage.support.extras import import_extra

TOKEN_VARIABLE = "PULSESTAGE_TOKEN"
MIN_TOKEN_LENGTH = 16


def add_subcommand(commands: Any) -> None:
    """Add `stage mcp` to argparse's subparsers."""
    p = add_command(
        commands, "mcp", run, "tools of a stage for agents, by the Model Context Protocol",
        "Serve tools, resources and prompts to clients of the Model Context Protocol: registers, moves, status, pictures. Each "
        "session has a stage of its own, at power-up.",
        ("stage mcp xy", "over standard input and output, for a desktop client: docs/agents.md"),
        ("stage mcp xyz --chips mcx514 --moves 50", "a session may begin 50 moves"),
        ("stage mcp --http --port 7242", "several clients at 127.0.0.1, each with a stage of its own"),
        ("stage mcp --mode truth --folder runs", "the agent sees everything, and may write recordings into runs/"),
        json=False,
    )  # fmt: skip
    options.add_model_argument(p)
    g = p.add_argument_group("agent")
    g.add_argument(
        "--mode", choices=("host", "truth"), default="host",
        help="what the agent sees: what a host on the bus can see, or everything (default: host)",
    )  # fmt: skip
    g.add_argument(
        "--moves", type=parse_integer, metavar="N", help="number of moves that a session may begin (default: no limit)"
    )
    g.add_argument(
        "--seconds", type=TIME, metavar="S", help="simulated seconds that a session may use (default: no limit)"
    )
    g.add_argument(
        "--cycles",
        type=parse_integer,
        metavar="N",
        help="number of bus cycles that a session may make (default: no limit)",
    )
    g.add_argument(
        "--no-snapshots",
        action="store_true",
        help="leave out the tools snapshot, restore and branch, so that the agent cannot undo anything",
    )
    g.add_argument("--folder", metavar="DIR", help="folder for recordings, in mode truth (default: none)")
    g.add_argument(
        "--patience", type=TIME, default=30.0, metavar="S", help="real seconds that a call may take (default: 30)"
    )
    g = p.add_argument_group("HTTP")
    g.add_argument(
        "--http", action="store_true", help="streamable HTTP on 127.0.0.1 instead of standard input and output"
    )
    g.add_argument("--port", type=parse_port, default=7242, help="TCP port; 0 chooses a free one (default: 7242)")
    g.add_argument(
        "--sessions",
        type=parse_integer,
        default=64,
        metavar="N",
        help="maximum number of sessions at a time (default: 64)",
    )
    g.add_argument(
        "--idle", type=TIME, default=600.0, metavar="S",
        help="end a session after this many seconds without a call (default: 600)",
    )  # fmt: skip
    options.add_stage_options(p.add_argument_group("stage"))


def run(args: argparse.Namespace) -> int:
    """Serve until the client disconnects, or until Ctrl-C or SIGTERM."""
    import_extra("mcp", "stage mcp")
    from stage.agents.budget import Budget
    from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory

    for name in ("idle", "sessions"):
        if not getattr(args, name) > 0:
            raise ArgumentError(f"--{name} {getattr(args, name)}: must be greater than 0.")
    if not 0 < args.patience < math.inf:
        raise ArgumentError(f"--patience {args.patience}: must be greater than 0 s, and finite.")
    if args.folder is not None and not Path(args.folder).is_dir():
        raise ArgumentError(f"--folder {args.folder}: there is no such folder. Create it first.")
    if args.folder is not None and args.mode != "truth":
        raise ArgumentError("--folder: only mode truth writes recordings. Add --mode truth, or leave the folder out.")
    token = os.environ.get(TOKEN_VARIABLE) or None
    if (
        args.http
        and token is not None
        and (len(token) < MIN_TOKEN_LENGTH or not token.isascii() or not token.isprintable())
    ):
        raise ArgumentError(
            f"{TOKEN_VARIABLE}: must have {MIN_TOKEN_LENGTH} or more printable ASCII characters. Without it a token is made."
        )
    budget = Budget(args.moves, args.seconds, args.cycles)
    factory = ToolboxFactory(
        lambda: make_stage(args, visuals=False), args.mode, budget, not args.no_snapshots, args.patience, args.folder
    )
    _ = factory.original_stage  # an error of the stage comes before anybody connects
    if not args.http:
        from stage.agents.server.stdio import serve

        serve(factory)
        return 0
    from stage.agents.server.http import HttpServer

    server = HttpServer(factory, ClientSessions(factory, args.sessions, args.idle), args.port, token)
    print(f"{server.address}\nAuthorization: Bearer {server.token}\nCtrl-C ends it", flush=True)
    server.run()
    print("ended", file=sys.stderr)
    return 0
