"""numba implementations of the functions that stage.native offers; imported only while a library is built."""

from __future__ import annotations

import platform
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic, typeof_impl
from numba.np.arrayobj import make_array, populate_array


def hot(function: Callable) -> Any:
    """Compile a hot function by numba, without fastmath, so that the same input gives the same bits."""
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return numba.njit(nogil=True, error_model="numpy", **options)(function)


def lower_array(context: Any, builder: Any, kind: Any, address: Any, shape: list[Any]) -> Any:
    """Build LLVM's value of a numba array, without an owner, whose memory begins at an address."""
    array = make_array(kind)(context, builder)
    item = context.get_data_type(kind.dtype)
    size = context.get_constant(types.intp, context.get_abi_sizeof(item))
    strides = [size]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    data = builder.inttoptr(address, item.as_pointer())
    populate_array(array, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
    return array._getvalue()


def _view_array(_context: Any, address: Any, shape: Any, dtype: Any) -> Any:
    """Implement `array_at`: an array over the memory at an address."""
    several = isinstance(shape, types.BaseTuple)
    kind = types.Array(dtype.dtype, len(shape) if several else 1, "C")

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lengths = cgutils.unpack_tuple(builder, args[1]) if several else [args[1]]
        lengths = [
            context.cast(builder, n, t, types.intp) for n, t in zip(lengths, shape if several else [shape], strict=True)
        ]
        return lower_array(context, builder, kind, context.cast(builder, args[0], address, types.intp), lengths)

    return kind(address, shape, dtype), lower


array_at: Any = intrinsic(_view_array)
"""See stage.native.record_dtypes."""


def _implement_allocate_on_stack(_context: Any, rows: Any, columns: Any) -> Any:
    """Implement `allocate_on_stack`: an array on the stack."""
    kind = types.Array(types.float64, 2, "C")

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        words = rows.literal_value * columns.literal_value
        place = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), words))
        address = builder.ptrtoint(place, context.get_value_type(types.intp))
        shape = [context.get_constant(types.intp, n.literal_value) for n in (rows, columns)]
        return lower_array(context, builder, kind, address, shape)

    if not all(isinstance(n, types.IntegerLiteral) for n in (rows, columns)):
        raise TypingError("allocate_on_stack() takes numbers that are known when it is compiled.")
    return kind(rows, columns), lower


allocate_on_stack: Any = intrinsic(prefer_literal=True)(_implement_allocate_on_stack)
"""See stage.native.record_dtypes."""


_FLOAT_MODES = {"x86_64": 0x1F80, "AMD64": 0x1F80, "aarch64": 0, "arm64": 0}
"""The usual mode of arithmetic, in the processor's own bits: rounding to nearest, no traps, small numbers kept."""


def _implement_enter_usual_float_mode(_context: Any) -> Any:
    """Implement `enter_usual_float_mode`.

    The call sets the processor's floating-point control word (MXCSR, FPCR) to its value in _FLOAT_MODES, and returns the old word.
    """

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        usual, before = _FLOAT_MODES.get(platform.machine()), ir.Constant(ir.IntType(64), 0)
        if usual is not None:
            before = _get_float_mode(builder)
            _set_float_mode(builder, ir.Constant(ir.IntType(64), usual))
        return before

    return types.int64(), lower


def _implement_restore_previous_float_mode(_context: Any, mode: Any) -> Any:
    """Implement `restore_previous_float_mode`: set the processor's floating-point control word (MXCSR, FPCR) to `mode`.

    Args:
        mode: Control word that `enter_usual_float_mode` returned.
    """

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if platform.machine() in _FLOAT_MODES:
            _set_float_mode(builder, context.cast(builder, args[0], mode, types.int64))
        return context.get_dummy_value()

    return types.void(mode), lower


def _get_float_mode(builder: Any) -> Any:
    """Emit code that reads the processor's floating-point control word."""
    word, half = ir.IntType(64), ir.IntType(32)
    if platform.machine() in ("aarch64", "arm64"):
        return builder.call(
            cgutils.get_or_insert_function(builder.module, ir.FunctionType(word, []), "llvm.aarch64.get.fpcr"), []
        )
    place = cgutils.alloca_once(builder, half)
    kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t])
    store = cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.sse.stmxcsr")
    builder.call(store, [builder.bitcast(place, cgutils.voidptr_t)])
    return builder.zext(builder.load(place), word)


def _set_float_mode(builder: Any, mode: Any) -> None:
    """Emit code that sets the processor's floating-point control word to `mode`."""
    word, half = ir.IntType(64), ir.IntType(32)
    if platform.machine() in ("aarch64", "arm64"):
        kind = ir.FunctionType(ir.VoidType(), [word])
        builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.aarch64.set.fpcr"), [mode])
        return
    place = cgutils.alloca_once(builder, half)
    builder.store(builder.trunc(mode, half), place)
    kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t])
    load = cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.sse.ldmxcsr")
    builder.call(load, [builder.bitcast(place, cgutils.voidptr_t)])


enter_usual_float_mode: Any = intrinsic(_implement_enter_usual_float_mode)
restore_previous_float_mode: Any = intrinsic(_implement_restore_previous_float_mode)
"""See stage.native.hot_functions."""


def _read_frame_address(_context: Any) -> Any:
    """Implement `get_frame_address`: the address of the caller's stack frame."""

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(cgutils.voidptr_t, [ir.IntType(32)])
        place = cgutils.get_or_insert_function(builder.module, kind, "llvm.frameaddress.p0")
        return builder.ptrtoint(builder.call(place, [ir.Constant(ir.IntType(32), 0)]), ir.IntType(64))

    return types.int64(), lower


def _implement_stack_mark(_context: Any, words: Any, value: Any) -> Any:
    """Implement `stack_mark`: fill words on the stack with `value`, `value` + 1 ..., and return their address."""
    if not isinstance(words, types.IntegerLiteral):
        raise TypingError("stack_mark() takes a number of words that is known when it is compiled.")

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word, count = ir.IntType(64), words.literal_value
        block = cgutils.alloca_once(builder, word, size=ir.Constant(word, count))
        content = context.cast(builder, args[1], value, types.int64)
        for k in range(count):
            builder.store(builder.add(content, ir.Constant(word, k)), builder.gep(block, [ir.Constant(word, k)]))
        return builder.ptrtoint(block, word)

    return types.int64(words, value), lower


get_frame_address: Any = intrinsic(_read_frame_address)
stack_mark: Any = intrinsic(prefer_literal=True)(_implement_stack_mark)
"""See stage.native.hot_functions."""


def get_numba_type(kind: Any) -> Any:
    """Return numba's type of a result or an argument."""
    if kind is None:
        return types.void
    dtype = getattr(kind, "dtype", kind)
    if hasattr(kind, "dimensions"):
        return types.Array(numba.from_dtype(dtype), kind.dimensions, "C")
    return numba.from_dtype(np.dtype(dtype))


def register_exported_function_type(exported: type) -> None:
    """Register the type of exported functions with numba, so that hot functions can call them.

    Functions are called by their symbols; those that take arrays are compiled into their callers.
    """

    @typeof_impl.register(exported)
    def typeof_exported(function: Any, _context: Any) -> Any:
        if any(hasattr(a, "dimensions") for a in function.arguments):
            return types.Dispatcher(function.hot)
        signature = get_numba_type(function.result)(*map(get_numba_type, function.arguments))
        return types.ExternalFunction(function.symbol, signature)


def declare_address_call(result: str | None, arguments: tuple) -> Any:
    """Make the intrinsic for `stage.native.hot_functions.declare_address_call`."""
    returned, wanted = get_numba_type(result), [get_numba_type(a) for a in arguments]

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        of_address, of_values = signature.args
        kind = ir.FunctionType(
            ir.VoidType() if returned == types.void else context.get_value_type(returned),
            [context.get_value_type(w) for w in wanted],
        )
        address = context.cast(builder, args[0], of_address, types.intp)
        values = [
            context.cast(builder, value, has, want)
            for value, has, want in zip(cgutils.unpack_tuple(builder, args[1]), of_values, wanted, strict=True)
        ]
        done = builder.call(builder.inttoptr(address, kind.as_pointer()), values)
        return context.get_dummy_value() if returned == types.void else done

    @intrinsic
    def call(_context: Any, address: Any, values: Any) -> Any:
        return returned(address, values), lower

    return call


def make_compare_and_exchange(old: int | None, new: int | None) -> Any:
    """Make the intrinsic for `stage.native.hot_functions.make_compare_and_exchange`."""
    word = ir.IntType(64)

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address, named = (context.cast(builder, g, t, types.int64) for g, t in zip(args, signature.args, strict=True))
        before, after = (named if v is None else ir.Constant(word, v) for v in (old, new))
        place = builder.inttoptr(address, word.as_pointer())
        return builder.extract_value(builder.cmpxchg(place, before, after, "acq_rel", "monotonic"), 1)

    @intrinsic
    def call(_context: Any, address: Any, named: Any) -> Any:
        return types.boolean(address, named), lower

    return call
