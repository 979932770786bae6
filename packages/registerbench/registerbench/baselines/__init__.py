"""Methods that the benchmark measures: the formula, searches, learners, and what made docs/results.md and docs/benchmark.md."""

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
