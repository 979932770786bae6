"""The command `stage ioc`."""

from __future__ import annotations

import argparse
import math
import os
from typing import Any

from stage.cli.command_interface import add_command, warn
from stage.cli.options import add_model_argument, add_place_option, add_stage_options, parse_port
from stage.cli.stage_setup import make_stage, place_carriages
from stage.errors import ArgumentError
from stage.support.extras import import_extra

FREE_WORD = "free"
DEFAULT_PORT = 5064


def add_subcommand(commands: Any) -> None:
    """Add `stage ioc` to argparse's subparsers."""
    p = add_command(
        commands, "ioc", run, "an EPICS motor record for each axis, for ophyd, bluesky and other clients",
        "Serve a motor record for each axis over Channel Access: clients of EPICS drive the stage unchanged, with real limits, "
        "homing, lost steps and faults. Only this machine can reach it, unless --bind says otherwise. Ctrl-C or SIGTERM ends it.",
        ("stage ioc xyz --prefix STAGE:", "STAGE:x, STAGE:y and STAGE:z in real time"),
        ("stage ioc xyz --chips mcx514 --pace free", "as fast as possible, for tests; time stands still while nothing moves"),
        json=False,
    )  # fmt: skip
    add_model_argument(p)
    g = p.add_argument_group("IOC")
    g.add_argument("--prefix", default="STAGE:", help="text before the names of the axes (default: STAGE:)")
    g.add_argument(
        "--pace", type=parse_pace, default=1.0, metavar="N",
        help="simulated seconds per second, 0.001 to 1000, or `free`: as fast as possible (default: 1)",
    )  # fmt: skip
    g.add_argument(
        "--rate",
        type=parse_rate,
        default=10.0,
        metavar="HZ",
        help="updates of positions per second, 0.1 to 50 (default: 10)",
    )
    g.add_argument(
        "--port", type=parse_port, default=None,
        help="UDP and TCP port (default: EPICS_CA_SERVER_PORT of the environment, else 5064)",
    )  # fmt: skip
    g.add_argument(
        "--bind",
        action="append",
        metavar="ADDRESS",
        help="address to listen on (default: 127.0.0.1, this machine only)",
    )
    g = p.add_argument_group("stage")
    add_stage_options(g)
    add_place_option(g)


def parse_pace(text: str) -> float:
    """Parse the value of --pace: a number, or `free` for infinity."""
    if text == FREE_WORD:
        return math.inf
    return _parse_in_range(text, 0.001, 1000.0, f"simulated seconds per second, 0.001 to 1000, or `{FREE_WORD}`.")


def parse_rate(text: str) -> float:
    """Parse the value of --rate."""
    return _parse_in_range(text, 0.1, 50.0, "0.1 to 50 updates per second.")


def _parse_in_range(text: str, low: float, high: float, expected: str) -> float:
    """Parse a number of `low` to `high`; `expected` says in the error what the option takes."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text!r}: {expected}")
    return value


def run(args: argparse.Namespace) -> int:
    """Serve the records until Ctrl-C or SIGTERM."""
    if not args.prefix.isprintable() or any(c.isspace() or c == "." for c in args.prefix):
        raise ArgumentError(f"--prefix {args.prefix!r}: a prefix has no spaces and no dots, for example STAGE:.")
    import_extra("caproto", "stage ioc")
    from stage.ioc.server import LOOPBACK_ADDRESS, Ioc, serve, set_server_port

    interfaces = args.bind or [LOOPBACK_ADDRESS]
    if args.port is not None:
        set_server_port(args.port, interfaces)
    port = args.port or int(os.environ.get("EPICS_CA_SERVER_PORT", DEFAULT_PORT))
    stage = make_stage(args, visuals=False)
    place_carriages(args, stage)
    ioc = Ioc(stage, args.prefix, args.pace, 1 / args.rate)
    if any(address != LOOPBACK_ADDRESS for address in interfaces):
        warn(args, "other machines may reach this IOC, and there is no password: whoever connects drives the stage.")

    def report() -> None:
        names = ", ".join(f"{args.prefix}{name}" for name in stage.axes)
        print(f"{names}: {len(ioc.pvs)} PVs at {', '.join(interfaces)}, port {port}; Ctrl-C ends it", flush=True)

    serve(ioc, interfaces, report)
    return 0
