"""What a terminal sees while something takes long; nothing where standard error is no terminal."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

FIRST, EVERY = 1.5, 0.5  # s of real time


def note(text: str) -> None:
    """What is done now, in a line."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)


def progress(what: str, done: float) -> None:
    """A line that counts up to 100 %."""
    if sys.stderr.isatty():
        print(f"\r{what} {done:4.0%}", end="\n" if done >= 1 else "", file=sys.stderr, flush=True)


@contextmanager
def ticking(stage: Any) -> Iterator[None]:
    """In this block a line says how far the simulated time is, from the second second on."""
    if not sys.stderr.isatty():
        yield
        return
    over, shown = threading.Event(), False

    def tick() -> None:
        nonlocal shown
        wait = FIRST
        while not over.wait(wait):
            print(f"\r\033[K{stage.data.time:.2f} s simulated; Ctrl-C ends it", end="", file=sys.stderr, flush=True)
            shown, wait = True, EVERY

    thread = threading.Thread(target=tick, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        if shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
