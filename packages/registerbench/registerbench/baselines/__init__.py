"""Methods that the benchmark measures: the formula, searches, learners, and what made docs/results.md and docs/benchmark.md."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def explain_interrupt(saved: str) -> Iterator[None]:
    """Turn Ctrl-C into a message that says what was saved, and exit with code 130 as shells do.

    Args:
        saved: What remains of the work so far, as a sentence.
    """
    try:
        yield
    except KeyboardInterrupt:
        print(f"\nstopped: {saved}", file=sys.stderr, flush=True)
        raise SystemExit(130) from None
