"""mcp, agent, agent-replay."""

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
    _add_agent(commands)


def _add_agent(commands: Any) -> None:
    p = command(
        commands, "agent", "agent:run", "measure an agent: broken set-ups, or a task of the benchmark by tools",
        "Let a player play the games of a suite by calling tools, and print its score with an interval. A player is one that is "
        "shipped, a command that speaks JSON lines, a language model behind an OpenAI-compatible endpoint, or a client of the "
        "Model Context Protocol. Nothing is called that is not given.",
        ("stage agent diagnosis --by technician -o technician.jsonl", "the ten broken set-ups, with a transcript"),
        ("stage agent few-shot --by coordinate --episodes 8", "test episodes of RegisterBench"),
        ("stage agent diagnosis:late --command 'python agent.py'", "a player of your own, in any language"),
        ("stage agent diagnosis --endpoint http://127.0.0.1:8000/v1 --model m", "a language model"),
        more="docs/agents.md says how a player is written, and what the scores are. Exit code 0 if all games were played, "
        "1 if one took too long, if its player failed, or if no call of all was valid, 2 if the player cannot play.",
    )  # fmt: skip
    p.add_argument(
        "suite", metavar="SUITE", help="diagnosis, one set-up of it (diagnosis:late), or a task of `stage bench`"
    )
    g = p.add_argument_group("player")
    g.add_argument(
        "--by",
        metavar="PLAYER",
        help="formula, random, coordinate, optuna, trained, technician; or module:function of yours (default: formula)",
    )
    g.add_argument("--command", metavar="COMMAND", help="a program that reads and writes lines of JSON")
    g.add_argument("--endpoint", metavar="URL", help="OpenAI-compatible, up to its version: https://host/v1")
    g.add_argument("--model", metavar="NAME", help="of the endpoint")
    g.add_argument("--key-env", metavar="VARIABLE", help="the variable of the environment that has the endpoint's key")
    g.add_argument("--mcp", action="store_true", help="the client at standard input and output; one game")
    g.add_argument("--name", help="of the player, in transcripts and entries")
    g = p.add_argument_group("games")
    g.add_argument("--split", default="train", help="of a task, see `stage bench` (default: train)")
    g.add_argument("--episodes", type=number, metavar="N", help="only the first N games")
    g = p.add_argument_group("limits")
    g.add_argument("--most", type=number, default=400, metavar="N", help="calls of a game, at most (default: 400)")
    g.add_argument(
        "--patience", type=TIME, default=600.0, metavar="S", help="seconds in which the next call comes (default: 600)"
    )
    g.add_argument(
        "--time", type=TIME, default=3600.0, metavar="S",
        help="seconds that the player may take in a game, without those of the simulation (default: 3600)",
    )  # fmt: skip
    g = p.add_argument_group("output")
    g.add_argument("-o", "--output", metavar="FILE.jsonl", help="write a transcript, each game when it ends")
    g.add_argument(
        "--resume", action="store_true", help="go on with the transcript that -o names, where a run broke off"
    )
    g.add_argument("--entry", metavar="FILE.bench", help="write an entry of RegisterBench, track tools")
    g.add_argument("--force", action="store_true", help="overwrite files that exist")
    p = command(
        commands, "agent-replay", "agent:replay", "make the calls of a transcript again, without the agent",
        "Make every call of a transcript again, compare answers and scores bit for bit, and print the score that comes of them. "
        "Exit code 0 if all are equal, 1 if not or if the transcript is cut, 2 if the file is refused.",
        ("stage agent-replay technician.jsonl", "what was played is what is said"),
    )  # fmt: skip
    p.add_argument("file", metavar="FILE.jsonl")
