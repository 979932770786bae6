"""The command mcp: the tools of a stage for clients of the Model Context Protocol."""

from __future__ import annotations

import argparse
import math
import os
import sys

from stage.cli.setup import make_stage
from stage.errors import ArgumentError
from stage.support.extras import need

TOKEN = "PULSESTAGE_TOKEN"
SHORTEST = 16  # characters of a token


def run(args: argparse.Namespace) -> int:
    """Serve until the client goes, or until Ctrl-C or SIGTERM."""
    need("mcp", "stage mcp")
    from stage.agents.budget import Budget
    from stage.agents.server.sessions import Sessions, ToolboxFactory

    for name in ("idle", "sessions"):
        if not getattr(args, name) > 0:
            raise ArgumentError(f"--{name} {getattr(args, name)}: more than 0.")
    if args.folder is not None and not os.path.isdir(args.folder):
        raise ArgumentError(f"--folder {args.folder}: there is no such folder. Make it first.")
    if not 0 < args.patience < math.inf:
        raise ArgumentError(f"--patience {args.patience}: seconds, more than 0.")
    if args.folder is not None and args.mode != "truth":
        raise ArgumentError(
            "--folder: recordings are written in mode truth alone; add --mode truth, or leave the folder out."
        )
    token = os.environ.get(TOKEN) or None
    if args.http and token is not None and (len(token) < SHORTEST or not token.isascii() or not token.isprintable()):
        raise ArgumentError(f"{TOKEN}: {SHORTEST} or more printable ASCII characters; without it one is made.")
    budget = Budget(args.moves, args.seconds, args.cycles)
    factory = ToolboxFactory(
        lambda: make_stage(args, visuals=False), args.mode, budget, not args.no_snapshots, args.patience, args.folder
    )
    _ = factory.original  # an error of the stage comes before anybody connects
    if not args.http:
        from stage.agents.server.stdio import serve

        serve(factory)
        return 0
    from stage.agents.server.http import HttpServer

    server = HttpServer(factory, Sessions(factory, args.sessions, args.idle), args.port, token)
    print(f"{server.address}\nAuthorization: Bearer {server.token}\nCtrl-C ends it", flush=True)
    server.run()
    print("ended", file=sys.stderr)
    return 0
