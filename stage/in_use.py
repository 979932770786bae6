"""Whose turn it is: a word in memory that at most one thread has, also where compiled code runs without the GIL.

    if claim(address, token):        0 becomes `token`, in one step that no other thread gets into
        ...
        release(address, token)      and 0 again

Compiled code claims as ENGINE; who claims from Python takes a number of his own, `token()`, so that what an exception left undone
can be released wherever it was raised. Uncompiled, the GIL keeps threads out of each other's way, and every claim is granted.
"""

from __future__ import annotations

from itertools import count
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from stage.compiled import COMPILED

ENGINE = 1
_tokens = count(ENGINE + 1)
_WORD = ir.IntType(64)


def token() -> int:
    """A number that nobody else claims with."""
    return next(_tokens)


def _exchanges(old: int | None, new: int | None) -> Any:
    """(address, token) -> True if the word held `old` (None: the token) and now is `new`."""

    def typed(_context: Any, address: Any, token: Any) -> Any:
        def lower(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
            before, after = (given[1] if v is None else ir.Constant(_WORD, v) for v in (old, new))
            place = builder.inttoptr(given[0], _WORD.as_pointer())
            return builder.extract_value(builder.cmpxchg(place, before, after, "acq_rel", "monotonic"), 1)

        return types.boolean(types.int64, types.int64), lower

    return intrinsic(typed) if COMPILED else lambda address, token: True


claim: Any = _exchanges(0, None)
release: Any = _exchanges(None, 0)
