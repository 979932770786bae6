"""Learners and the oracle of the benchmark, the program that writes its headline table, and the engineer of a servo."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def exit_on_interrupt(saved: str) -> Iterator[None]:
    """Turn Ctrl-C into a message that states what is saved, and exit with code 130 as shells do.

    Args:
        saved: Sentence that states which results are saved.
    """
    try:
        yield
    except KeyboardInterrupt:
        print(f"\nstopped: {saved}", file=sys.stderr, flush=True)
        raise SystemExit(130) from None
