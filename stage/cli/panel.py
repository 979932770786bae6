"""The command panel: a live stage in a browser."""

from __future__ import annotations

import argparse
import signal
import threading
import webbrowser

from stage.cli.setup import make_stage


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C or SIGTERM."""
    from stage.panel.server import Panel
    from stage.panel.session import Session

    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.set())
    with Session(make_stage(args), speed=args.speed, paused=args.paused) as session:
        panel = Panel(session, args.port, args.host)
        print(f"{panel.address}\nCtrl-C ends it", flush=True)
        if not args.no_browser:
            webbrowser.open(panel.address)
        over.wait()
        panel.close()
    return 0
