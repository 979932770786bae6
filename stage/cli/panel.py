"""The command panel: a live stage in a browser."""

from __future__ import annotations

import argparse
import gc
import signal
import threading

from stage.cli.setup import make_stage


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C or SIGTERM."""
    from stage.panel import saved_panel
    from stage.panel.server import Panel
    from stage.panel.session import Session

    shared = saved_panel.read(args.open) if args.open is not None else None
    if shared is not None and shared.made is not None:
        args = argparse.Namespace(**vars(args) | shared.made)

    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.set())
    with Session(make_stage(args), speed=args.speed, paused=True) as session:
        made = (
            {name: getattr(args, name) for name in saved_panel.STAGE_OPTIONS} if shared is None or shared.made else None
        )
        panel = Panel(session, args.port, args.host, made)
        if shared is not None:
            saved_panel.restore(panel, shared)
        session.paused = args.paused
        print(f"{panel.address}\nCtrl-C ends it", flush=True)
        if not args.no_browser and not panel.show():
            print("there is no browser here: open the link in one", flush=True)
        over.wait()
        panel.close()
    gc.freeze()  # Python would look through all pages that were ever shown, and take seconds to end
    return 0
