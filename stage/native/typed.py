"""How numba takes what stage.native offers: imported only where a library is made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic, typeof_impl

_OPTIONS = {
    "nopython": True, "nogil": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True,
}  # fmt: skip


class _Hot(CPUDispatcher):
    """Callers that say f(1) and f(2) share the code for a whole number: numba would make one for each."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(
            tuple(map(types.unliteral, args)), {k: types.unliteral(v) for k, v in kws.items()}
        )


def hot(function: Callable) -> Any:
    """numba's form of a hot function. No fastmath: the same input gives the same bits."""
    return _Hot(function, targetoptions=dict(_OPTIONS))


def _as_pointer(_context: Any, address: Any) -> Any:
    def lower(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.inttoptr(given[0], context.get_value_type(signature.return_type))

    return types.voidptr(types.intp), lower


_pointer: Any = intrinsic(_as_pointer)


@hot
def at(address: Any, shape: Any, dtype: Any) -> Any:
    """See stage.native.records."""
    return numba.carray(_pointer(address), shape, dtype)


def type_of(kind: Any) -> Any:
    """numba's type of a result or an argument."""
    if kind is None:
        return types.void
    dtype = getattr(kind, "dtype", kind)
    if hasattr(kind, "dimensions"):
        return types.Array(numba.from_dtype(dtype), kind.dimensions, "C")
    return numba.from_dtype(np.dtype(dtype))


def register(exported: type) -> None:
    """Hot functions call exported ones by their symbols; those that take arrays are compiled into their callers."""

    @typeof_impl.register(exported)
    def typeof_exported(function: Any, _context: Any) -> Any:
        if any(hasattr(a, "dimensions") for a in function.arguments):
            return types.Dispatcher(function.hot)
        signature = type_of(function.result)(*map(type_of, function.arguments))
        return types.ExternalFunction(function.symbol, signature)


def called(result: str | None, arguments: tuple) -> Any:
    """See stage.native.functions."""
    returned, wanted = type_of(result), [type_of(a) for a in arguments]

    def lower(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        of_address, of_values = signature.args
        kind = ir.FunctionType(
            ir.VoidType() if returned == types.void else context.get_value_type(returned),
            [context.get_value_type(w) for w in wanted],
        )
        address = context.cast(builder, given[0], of_address, types.intp)
        values = [
            context.cast(builder, value, has, want)
            for value, has, want in zip(cgutils.unpack_tuple(builder, given[1]), of_values, wanted, strict=True)
        ]
        done = builder.call(builder.inttoptr(address, kind.as_pointer()), values)
        return context.get_dummy_value() if returned == types.void else done

    @intrinsic
    def call(_context: Any, address: Any, values: Any) -> Any:
        return returned(address, values), lower

    return call


def exchange(old: int | None, new: int | None) -> Any:
    """See stage.native.functions."""
    word = ir.IntType(64)

    def lower(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        address, named = (context.cast(builder, g, t, types.int64) for g, t in zip(given, signature.args, strict=True))
        before, after = (named if v is None else ir.Constant(word, v) for v in (old, new))
        place = builder.inttoptr(address, word.as_pointer())
        return builder.extract_value(builder.cmpxchg(place, before, after, "acq_rel", "monotonic"), 1)

    @intrinsic
    def call(_context: Any, address: Any, named: Any) -> Any:
        return types.boolean(address, named), lower

    return call
