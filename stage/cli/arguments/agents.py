"""mcp."""

from __future__ import annotations

from typing import Any

from stage.cli.arguments.options import command, machine, model_help, number, port
from stage.cli.quantities import TIME


def add(commands: Any) -> None:
    """These commands."""
    p = command(
        commands, "mcp", "mcp:run", "tools of a stage for agents, by the Model Context Protocol",
        "Serve tools, resources and prompts to clients of the Model Context Protocol: registers, moves, status, pictures. Each "
        "session has a stage of its own, at power-up.",
        ("stage mcp xy", "over standard input and output, for a desktop client: docs/agents.md"),
        ("stage mcp xyz --chips mcx514 --moves 50", "a session may begin 50 moves"),
        ("stage mcp --http --port 7242", "several clients at 127.0.0.1, each with a stage of its own"),
        ("stage mcp --mode truth --folder runs", "the agent sees all, and may write recordings into runs/"),
        json=False,
    )  # fmt: skip
    p.add_argument("model", nargs="?", default="xyz", help=model_help())
    g = p.add_argument_group("agent")
    g.add_argument(
        "--mode",
        choices=("host", "truth"),
        default="host",
        help="what it sees: what a host on the bus can see, or everything (default: host)",
    )
    g.add_argument("--moves", type=number, metavar="N", help="moves that a session may begin (default: any number)")
    g.add_argument("--seconds", type=TIME, metavar="S", help="simulated seconds of a session (default: any number)")
    g.add_argument("--cycles", type=number, metavar="N", help="bus cycles of a session (default: any number)")
    g.add_argument("--no-snapshots", action="store_true", help="what is done is done: no snapshot, restore, branch")
    g.add_argument("--folder", metavar="DIR", help="where recordings may be written, in mode truth (default: nowhere)")
    g.add_argument(
        "--patience", type=TIME, default=30.0, metavar="S", help="real seconds that a call may take (default: 30)"
    )
    g = p.add_argument_group("HTTP")
    g.add_argument(
        "--http", action="store_true", help="streamable HTTP on 127.0.0.1 in place of standard input and output"
    )
    g.add_argument("--port", type=port, default=7242, help="TCP port; 0: one that is free (default: 7242)")
    g.add_argument("--sessions", type=number, default=64, metavar="N", help="at once, at most (default: 64)")
    g.add_argument(
        "--idle",
        type=TIME,
        default=600.0,
        metavar="S",
        help="a session without a call for so long ends (default: 600)",
    )
    machine(p.add_argument_group("stage"))
    p.set_defaults(encoder=[])
