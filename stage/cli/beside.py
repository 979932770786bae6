"""--panel: a live page beside a command that drives a stage by itself."""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stage.panel.session import Session


@contextmanager
def beside(args: argparse.Namespace, stage: Any, program: str) -> Iterator[Session | None]:
    """If --panel asks for it, a page that sees what the block does, which begins when somebody looks at it. Yields its session, or
    None."""
    if not args.panel:
        yield None
        return
    from stage import panel as panels

    with panels.open(stage, args.panel_port, speed=args.speed, program=program, browser=not args.no_browser) as panel:
        print(f"{panel.address}\n{program} begins when a browser shows this page", flush=True)
        panel.until_watched()
        yield panel.session


def live_on(session: Session) -> None:
    """The program has ended: the stage is the page's, until Ctrl-C or SIGTERM."""
    session.dismiss_program()
    print("the page lives on; Ctrl-C ends it", flush=True)
    over = threading.Event()
    before = {n: signal.signal(n, lambda *_: over.set()) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        over.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_beside(session: Session, host: Any, seconds: float | None, timeout: float) -> Any:
    """Firmware in real time, a piece at a time: what `host.run(timeout)` returns or raises, or `host.run_for(seconds)`."""
    stage = host.board.stage
    left = timeout if seconds is None else seconds
    end = stage.now + round(left * 1e9)
    while (left := (end - stage.now) * 1e-9) > session.slice_s:
        result = host.run_for(session.slice_s)
        if result is not None:
            return result
        session.catch_up()
    return host.run(timeout=left) if seconds is None else host.run_for(left)
