"""`hot` and `exported`: the decorators of compiled functions.

A result or an argument of an exported function is a plain C type ("i4", "i8", "f8"; None is no result), the dtype of a record,
which C passes by its address, or `array_of` a dtype: an address and a length for each dimension.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from operator import index
from typing import Any, ClassVar

import numpy as np

from stage.errors import ArgumentError
from stage.native import library_loader, record_dtypes
from stage.native.compile_mode import COMPILED, IS_EMITTER_PROCESS

if IS_EMITTER_PROCESS:
    from stage.native import numba_implementations

_C_TYPES: dict[str | None, Any] = {None: None, "i4": ctypes.c_int32, "i8": ctypes.c_int64, "f8": ctypes.c_double}


@dataclass(frozen=True)
class ArrayArgument:
    """Array argument of an exported function.

    Attributes:
        dtype: Type of its elements, which are contiguous.
        dimensions: Number of dimensions.
    """

    dtype: np.dtype
    dimensions: int


def array_of(dtype: Any, dimensions: int = 1) -> ArrayArgument:
    """Declare an array argument of an exported function. C passes its address and the length of each dimension.

    Args:
        dtype: Type of the elements.
        dimensions: Number of dimensions.
    """
    return ArrayArgument(np.dtype(dtype), dimensions)


def hot(function: Callable) -> Any:
    """Compile `function` into the compiled functions that call it. Called from Python it runs as Python; see `exported`."""
    return numba_implementations.hot(function) if IS_EMITTER_PROCESS else function


def exported(result: str | None, *arguments: Any) -> Callable[[Callable], ExportedFunction]:
    """Compile the function as a function of the native library, which Python and C can call.

    Args:
        result: Type of the result, see this module; None for no result.
        arguments: Types of the arguments.
    """
    return lambda function: ExportedFunction(function, result, arguments)


class ExportedFunction:
    """Function of the native library.

    A call checks its arguments. `c` takes C arguments (addresses and lengths in place of records and arrays) without checks, and
    the caller must keep the memory alive.
    """

    every: ClassVar[list[ExportedFunction]] = []
    numbered: ClassVar[dict[int, ExportedFunction]] = {}
    """Functions by the numbers that stand for their addresses while nothing is compiled."""

    def __init__(self, function: Callable, result: str | None, arguments: tuple):
        self.function, self.result, self.arguments = function, result, arguments
        self.module, self.name, self.__doc__ = function.__module__, function.__qualname__, function.__doc__
        self.symbol = f"{self.module}.{self.name}".replace("_", "_0").replace(".", "_1")
        self.every.append(self)
        if IS_EMITTER_PROCESS:
            self.hot = numba_implementations.hot(function)

    def __call__(self, *args: Any) -> Any:
        """Call the function from Python.

        Args:
            args: Records, numbers and arrays. A record may be the first element of an array.

        Raises:
            ArgumentError: An argument has another dtype, strides, or no memory of its own, so that compiled code cannot use it.
        """
        if not COMPILED:  # Python looks by itself
            return self.function(*map(_unwrap_record, args, self.arguments))
        if len(args) != len(self.arguments):
            raise ArgumentError(f"{self.name}: {len(args)} arguments given, it takes {len(self.arguments)}.")
        c_arguments: list[Any] = []
        for k, (value, kind) in enumerate(zip(args, self.arguments, strict=True)):
            if isinstance(kind, ArrayArgument):
                self._check_memory(k, value, kind.dtype, kind.dimensions)
                c_arguments += (value.ctypes.data, *value.shape)
            elif isinstance(kind, np.dtype):
                self._check_memory(k, value, kind, 0)
                c_arguments.append(record_dtypes.address_of(value))
            else:
                c_arguments.append(self._check_number(k, value, kind))
        return self.c(*c_arguments)

    def _check_number(self, argument_index: int, value: Any, kind: str) -> Any:
        """Convert a number to the type of an argument, or raise ArgumentError."""
        if kind == "f8":
            try:
                return float(value)
            except (TypeError, ValueError):
                raise ArgumentError(
                    f"{self.name}, argument {argument_index + 1}: {value!r}; it takes a number."
                ) from None
        try:
            number = index(value)
        except TypeError:
            number = None
        bits = 8 * int(kind[1:]) - 1
        if number is None or not -(1 << bits) <= number < 1 << bits:
            raise ArgumentError(
                f"{self.name}, argument {argument_index + 1}: {value!r}; it takes a whole number of {bits + 1} bits."
            )
        return number

    def _check_memory(self, argument_index: int, value: Any, dtype: np.dtype, dimensions: int) -> None:
        """Raise ArgumentError unless a value is a record or an array that compiled code can use in place."""
        if isinstance(value, np.void) and not dimensions:
            value = np.asarray(value)  # of no dimensions, the same memory
        elif not isinstance(value, np.ndarray):
            raise self._make_type_error(argument_index, f"an {type(value).__name__}", dtype, dimensions)
        elif not dimensions and not value.size:
            raise self._make_type_error(argument_index, "an empty array", dtype, dimensions)
        elif dimensions and value.ndim != dimensions:
            raise self._make_type_error(argument_index, f"an array of {value.ndim} dimensions", dtype, dimensions)
        if value.dtype is not dtype and value.dtype != dtype:
            raise self._make_type_error(argument_index, f"elements {_format_dtype(value.dtype)}", dtype, dimensions)
        if not value.flags.c_contiguous or not value.flags.aligned or not value.flags.writeable:
            raise self._make_type_error(
                argument_index, "an array with strides, unaligned or read-only", dtype, dimensions
            )

    def _make_type_error(self, argument_index: int, given_kind: str, dtype: np.dtype, dimensions: int) -> ArgumentError:
        """Make the error for an argument of another type."""
        wanted = f"a contiguous, writeable array of {dimensions} dimensions" if dimensions else "a record, or an array"
        return ArgumentError(
            f"{self.name}, argument {argument_index + 1}: {given_kind}; it takes {wanted} of {_format_dtype(dtype)}."
        )

    @cached_property
    def c(self) -> Any:
        """Function that takes C arguments without checks: addresses for records, addresses and lengths for arrays."""
        return self.prototype(self.address) if COMPILED else self._call_uncompiled

    @cached_property
    def with_gil(self) -> Any:
        """Function like `c` that holds the GIL, for calls of a microsecond. Two threads never run such functions at once."""
        return (
            _make_prototype(self.result, self.arguments, ctypes.PYFUNCTYPE)(self.address)
            if COMPILED
            else self._call_uncompiled
        )

    @cached_property
    def prototype(self) -> Any:
        """Function type of ctypes, the type of `pointer`."""
        return _make_prototype(self.result, self.arguments)

    @cached_property
    def pointer(self) -> Any:
        """Function pointer of ctypes, which C can call."""
        return self.c if COMPILED else self.prototype(self._call_uncompiled)

    @cached_property
    def address(self) -> int:
        """Address of the function, for tables of functions."""
        if COMPILED:
            return library_loader.find_function_address(self.module, self.symbol)
        self.numbered[len(self.numbered) + 1] = self
        return len(self.numbered)

    def _call_uncompiled(self, *words: Any) -> Any:
        """Call the Python function with C arguments."""
        left, values = iter(words), []
        for kind in self.arguments:
            if isinstance(kind, ArrayArgument):
                address = next(left)
                values.append(
                    record_dtypes.array_at(address, tuple(next(left) for _ in range(kind.dimensions)), kind.dtype)
                )
            else:
                value = next(left)
                record = isinstance(kind, np.dtype) and isinstance(value, int | np.integer)
                values.append(record_dtypes.array_at(value, 1, kind)[0] if record else value)
        return self.function(*values)


def declare_address_call(result: str | None, *arguments: Any) -> Any:
    """Make a hot function (address, (argument, ...)) -> result that calls the function at an address. Records pass by address.

    Args:
        result: Type of the result, None for no result.
        arguments: Types of the arguments.
    """
    if IS_EMITTER_PROCESS:
        return numba_implementations.declare_address_call(result, arguments)
    prototype = _make_prototype(result, arguments)

    def call(address: int, args: tuple) -> Any:
        function = ExportedFunction.numbered.get(int(address)) if not COMPILED else None
        words = (float(g) if w == "f8" else int(g) for g, w in zip(args, arguments, strict=True))
        return function._call_uncompiled(*words) if function else prototype(int(address))(*words)

    return call


def make_compare_and_exchange(old: int | None, new: int | None) -> Any:
    """Make a hot function (address, word) -> bool: an atomic compare-and-exchange of 64 bits.

    It returns True if the word at the address was `old` and now is `new`. As plain Python it relies on the GIL, and always returns
    True.

    Args:
        old: Word before; None stands for the argument `word`.
        new: Word after; None stands for the argument `word`.
    """
    return (
        numba_implementations.make_compare_and_exchange(old, new) if IS_EMITTER_PROCESS else lambda address, word: True
    )


enter_usual_float_mode: Callable[[], int] = (
    numba_implementations.enter_usual_float_mode if IS_EMITTER_PROCESS else lambda: 0
)
"""From now on this thread computes as usual: rounding to nearest, no traps, small numbers kept. Returns the mode of before."""
restore_previous_float_mode: Callable[[int], None] = (
    numba_implementations.restore_previous_float_mode if IS_EMITTER_PROCESS else lambda mode: None
)
"""Restore a floating-point mode that `enter_usual_float_mode` has returned, for this thread."""
get_frame_address: Callable[[], int] = numba_implementations.get_frame_address if IS_EMITTER_PROCESS else lambda: 0
"""Return the approximate stack address of the calling function; 0 if it runs uncompiled."""
stack_mark: Callable[[int, int], int] = (
    numba_implementations.stack_mark if IS_EMITTER_PROCESS else lambda words, value: 0
)
"""(words, value) -> the address of so many words, `value` and up, on the stack of the function that says this, for as long as it
has not returned; uncompiled 0. `words` is written out."""


def _make_prototype(result: str | None, arguments: tuple, function: Any = ctypes.CFUNCTYPE) -> Any:
    """Return the function type of ctypes for the types of a result and of arguments."""
    words: list[Any] = []
    for a in arguments:
        words += (
            [ctypes.c_int64] * (1 + (a.dimensions if isinstance(a, ArrayArgument) else 0))
            if not isinstance(a, str)
            else [_C_TYPES[a]]
        )
    return function(_C_TYPES[result], *words)


def _unwrap_record(value: Any, kind: Any) -> Any:
    """Return the first record of an array, for an argument that is a record; other values unchanged."""
    return value[0] if isinstance(kind, np.dtype) and isinstance(value, np.ndarray | list) else value


def _format_dtype(dtype: np.dtype) -> str:
    """Format a dtype for an error."""
    return f"a record of {', '.join(dtype.names[:3])} ..." if dtype.names else str(dtype)


if IS_EMITTER_PROCESS:
    numba_implementations.register_exported_function_type(ExportedFunction)
