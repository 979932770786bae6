"""A lock: a word in memory that at most one thread has, also where compiled code runs without the GIL.

    if claim(address, token):        0 becomes `token`, in one step that no other thread gets into
        ...
        release(address, token)      and 0 again

Compiled code claims as ENGINE; who claims from Python takes a number of his own, `token()`, so that what an exception left undone
can be released wherever it was raised. Uncompiled, the GIL keeps threads out of each other's way, and every claim is granted.
"""

from __future__ import annotations

from itertools import count
from typing import Any

from stage.native import exchange

ENGINE = 1
_tokens = count(ENGINE + 1)


def token() -> int:
    """A number that is used for one claim only."""
    return next(_tokens)


claim: Any = exchange(0, None)
release: Any = exchange(None, 0)
