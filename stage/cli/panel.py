"""The command `stage panel`, and the live page of another command that drives a stage (--panel)."""

from __future__ import annotations

import argparse
import gc
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from stage.cli.command_interface import add_command
from stage.cli.options import add_live_page_options, add_model_argument, add_stage_options, parse_port
from stage.cli.stage_setup import make_stage

if TYPE_CHECKING:
    from stage.panel.session import Session


def add_subcommand(commands: Any) -> None:
    """Add `stage panel` to argparse's subparsers."""
    p = add_command(
        commands, "panel", run, "a live stage in a browser",
        "Serve a page on which the stage moves in real time and each chip has a front panel: registers, commands, pins, the bus. "
        "Only this machine can reach it, unless --host says otherwise. Ctrl-C ends it.",
        ("stage panel xy", "a live stage in a browser"),
        ("stage panel my.xml --chips mcx514 --no-window", "your own axes; the link is printed"),
        json=False,
    )  # fmt: skip
    add_model_argument(p)
    g = p.add_argument_group("page")
    g.add_argument("--port", type=parse_port, default=7241, help="TCP port; 0 chooses a free one (default: 7241)")
    g.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS",
        help="address to listen on; other than at 127.0.0.1, whoever has the link with its token can reach the page "
        "(default: 127.0.0.1)",
    )  # fmt: skip
    add_live_page_options(g)
    g.add_argument("--paused", action="store_true", help="begin paused")
    g.add_argument(
        "--open", metavar="FILE",
        help="continue from a file that was saved from the menu of the page; it replaces MODEL and the options of the stage",
    )  # fmt: skip
    add_stage_options(p.add_argument_group("stage"))


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C or SIGTERM."""
    from stage.panel import saved_panel
    from stage.panel.server import Panel
    from stage.panel.session import Session

    shared = saved_panel.read_saved_panel(args.open) if args.open is not None else None
    if shared is not None and shared.stage_options is not None:
        args = argparse.Namespace(**vars(args) | shared.stage_options)

    over = threading.Event()
    with call_at_end_signals(over.set), Session(make_stage(args), speed=args.pace, paused=True) as session:
        stage_options = (
            {name: getattr(args, name) for name in saved_panel.STAGE_OPTIONS}
            if shared is None or shared.stage_options
            else None
        )
        panel = Panel(session, args.port, args.host, stage_options)
        if shared is not None:
            saved_panel.restore_panel(panel, shared)
        session.paused = args.paused
        print(f"{panel.address}\nCtrl-C ends it", flush=True)
        if not args.no_window and not panel.show():
            print("there is no browser here: open the link in one", flush=True)
        over.wait()
        panel.close()
    gc.freeze()  # Python would look through all pages that a browser has ever had, and take seconds to end
    return 0


@contextmanager
def call_at_end_signals(end: Callable[[], None]) -> Iterator[None]:
    """Within this block, call `end()` at Ctrl-C and SIGTERM."""
    before = {number: signal.signal(number, lambda *_: end()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def show_panel(args: argparse.Namespace, stage: Any, program: str) -> Iterator[Session | None]:
    """Show this block on a live page if --panel asks for it; the block begins when a browser shows the page.

    Args:
        args: Options of the command.
        stage: Stage that the block drives.
        program: Name of the program that drives the stage, for the page.

    Yields:
        The session of the page, or None.
    """
    if not args.panel:
        yield None
        return
    from stage import panel as panels

    with panels.open(stage, args.panel_port, speed=args.pace, program=program, browser=not args.no_window) as panel:
        print(f"{panel.address}\n{program} begins when a browser shows this page", flush=True)
        panel.wait_until_watched()
        yield panel.session


def keep_panel(session: Session) -> None:
    """After the program has ended, keep the page and its stage until Ctrl-C or SIGTERM."""
    session.detach_program()
    print("the page stays; Ctrl-C ends it", flush=True)
    over = threading.Event()
    with call_at_end_signals(over.set):
        over.wait()


def run_in_real_time(session: Session, host: Any, seconds: float | None, timeout: float) -> Any:
    """Run firmware in real time, in short pieces.

    Args:
        session: Session of the page.
        host: Host that runs the firmware.
        seconds: Simulated time to run for, s; None: until the firmware returns.
        timeout: Simulated time within which the firmware must return, s.

    Returns:
        The result of `host.run(timeout)`, or of `host.run_for(seconds)`.
    """
    stage = host.board.stage
    left = timeout if seconds is None else seconds
    end = stage.now + round(left * 1e9)
    while (left := (end - stage.now) * 1e-9) > session.catch_up_interval_s:
        result = host.run_for(session.catch_up_interval_s)
        if result is not None or host.serial.is_satisfied:
            return result
        session.catch_up()
    return host.run(timeout=left) if seconds is None else host.run_for(left)
