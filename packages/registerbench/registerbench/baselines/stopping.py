"""Ctrl-C in a command that takes minutes: a line in place of a traceback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stops(kept: str) -> Iterator[None]:
    """kept: what is still there of what was done; exit code 130, as shells have it."""
    try:
        yield
    except KeyboardInterrupt:
        print(f"\nstopped: {kept}", file=sys.stderr, flush=True)
        raise SystemExit(130) from None
