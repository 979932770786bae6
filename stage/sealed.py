"""Functions and records behind addresses: what one compiled function has of another, when it knows only where that is.

    @sealed("i8", STATE, "i8")
    def read(c, address): ...

`hot` functions are compiled anew into each that calls them; a sealed one is compiled once, by itself. Others call it by its name,
or by its address, which a table can hold: `called`. So a loop is compiled once for all chips, whatever their families.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import llvmlite.binding
import numpy as np
from llvmlite import ir
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.extending import intrinsic, typeof_impl

from stage import cache, code
from stage.compiled import COMPILED, announced, compiling, hot, kept, numba
from stage.errors import ArgumentError

_C: dict[str | None, Any] = {None: None, "i4": ctypes.c_int32, "i8": ctypes.c_int64, "f8": ctypes.c_double}


def sealed(result: str | None, *arguments: Any) -> Callable[[Callable], Sealed]:
    """Compile the function once and by itself. It keeps to what hot functions do.

    result, arguments: "i4", "i8", "f8", or None for no result, or an argument that is a record: its dtype. Hot functions call it
    after `ready`; Python calls it at any time, with records or arrays of them, which are looked at first, or by address with `.c`.
    """
    return lambda function: Sealed(function, result, arguments)


class Sealed:
    """A function behind an address."""

    every: ClassVar[list[Sealed]] = []
    numbered: ClassVar[dict[int, Sealed]] = {}
    """By what stands for the address where nothing is compiled."""

    def __init__(self, function: Callable, result: str | None, arguments: tuple):
        self.function, self.result, self.arguments = function, result, arguments
        self.symbol = f"pulsestage {function.__module__}.{function.__qualname__}"
        self.module, self.__doc__ = function.__module__, function.__doc__
        self._address, self._records = 0, [a if isinstance(a, np.dtype) else None for a in arguments]
        self.every.append(self)
        if COMPILED:
            cache.symbols[self.symbol] = lambda: self.address
            self.inside = intrinsic(_with_parameters(self._typed, len(arguments)))

    def __call__(self, *given: Any) -> Any:
        """From Python. Raises ArgumentError for what is no record of its kind, or a number too many or too few."""
        if not COMPILED:
            return self.function(*map(_as_record, given, self._records))
        if len(given) != len(self.arguments):
            raise ArgumentError(f"{self.symbol} takes {len(self.arguments)} arguments; given are {len(given)}.")
        for g, dtype in zip(given, self._records, strict=True):
            if dtype is not None:
                _check_record(self.symbol, g, dtype)
        return self.c(*(g if dtype is None else address_of(g) for g, dtype in zip(given, self._records, strict=True)))

    @cached_property
    def c(self) -> Any:
        """As a call from Python, which takes addresses of records, unseen: faster."""
        return self.pointer if COMPILED else self

    @cached_property
    def held(self) -> Any:
        """As `c`, with the GIL held: for what takes a microsecond. Two threads are never in such functions at once."""
        if not COMPILED:
            return self.c
        return _c_kind(self.result, self.arguments, ctypes.PYFUNCTYPE)(self.address)

    @property
    def kind(self) -> Any:
        """The type of `pointer`."""
        return _c_kind(self.result, self.arguments)

    @cached_property
    def pointer(self) -> Any:
        """A function of ctypes, for C."""
        return self.kind(self.address if COMPILED else lambda *given: self(*given))

    @property
    def address(self) -> int:
        """Where it lies. Compiles it, or loads what was compiled."""
        if not self._address:
            if COMPILED:
                self._compile()
            else:
                self._address = len(self.numbered) + 1
                self.numbered[self._address] = self
        return self._address

    def _compile(self) -> None:
        self._address, self._kept = code.load(self.function) or self._compiled()
        llvmlite.binding.add_symbol(self.symbol, self._address)

    def _compiled(self) -> tuple[int, Any]:
        compiling()
        with kept(self.function) as there:
            made: Any = numba.cfunc(self._signature, cache=there and not code.HERE, error_model="numpy")(self.function)
        code.keep(self.function, made)
        return made.address, made

    @property
    def _signature(self) -> Any:
        return _signature(self.result, self.arguments)

    def _typed(self, _context: Any, *_given: Any) -> Any:
        """numba compiles a call by the symbol."""
        return (self.address and self._signature), self._lower

    def _lower(self, context: Any, builder: Any, signature: Any, given: Any) -> Any:
        kind = _ir_kind(context, signature.return_type, signature.args)
        function = cgutils.get_or_insert_function(builder.module, kind, self.symbol)
        return _result_of(context, signature, builder.call(function, given))


@typeof_impl.register(Sealed)
def _typeof_sealed(function: Sealed, _context: Any) -> Any:
    return cpu_target.typing_context.resolve_value_type(function.inside)


def called(result: str | None, *arguments: Any) -> Any:
    """(address, *arguments) -> result: hot functions call the function at an address. Records are given by their addresses."""
    words = tuple("i8" if isinstance(a, np.dtype) else a for a in arguments)
    if not COMPILED:
        kind = _c_kind(result, words)

        def call(address: int, *given: Any) -> Any:
            function = Sealed.numbered.get(int(address)) or kind(int(address))
            return function(*(float(g) if w == "f8" else int(g) for g, w in zip(given, words, strict=True)))

        return call

    def typed(_context: Any, *_given: Any) -> Any:
        def lower(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            kind = _ir_kind(context, signature.return_type, signature.args[1:])
            function = builder.inttoptr(given[0], kind.as_pointer())
            return _result_of(context, signature, builder.call(function, given[1:]))

        return _signature(result, ("i8", *words)), lower

    return intrinsic(_with_parameters(typed, 1 + len(words)))


def ready(package: str, what: str) -> None:
    """Before compiled functions of `package` run, fresh or from the cache: what they call by name is there. what: in words."""
    waiting = [s for s in Sealed.every if not s._address and f"{s.module}.".startswith(f"{package}.")]
    if waiting:
        with announced(f"PulseStage: compiling {what}, once on this machine (up to a minute) ..."):
            for function in waiting:
                _ = function.address


# --- records ---


def _pointer(_context: Any, address: Any) -> Any:
    def lower(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.inttoptr(given[0], context.get_value_type(signature.return_type))

    return numba.types.voidptr(address), lower


pointer: Any = intrinsic(_pointer) if COMPILED else lambda address: ctypes.c_void_p(int(address))
"""An address as numba wants it."""


@hot
def at(address: Any, n: Any, dtype: Any) -> Any:
    """The array of `n` records or numbers at an address."""
    return numba.carray(pointer(address), (n,), dtype)


def address_of(record: np.ndarray | np.void) -> int:
    """Where an array or a record lies; of a record it takes a while."""
    if isinstance(record, np.ndarray):
        return int(record.ctypes.data)
    return int(record.__array_interface__["data"][0])


def _check_record(name: str, given: Any, dtype: np.dtype) -> None:
    """Compiled code believes what it is given: what is no writable record of this kind, or array of such, is refused."""
    kind = getattr(given, "dtype", None)
    if not isinstance(given, np.ndarray | np.void) or kind is None or kind.fields != dtype.fields:
        shown = (
            type(given).__name__
            if kind is None
            else f"{given.size} of {kind.name}"
            if not kind.names
            else "another record"
        )
        raise ArgumentError(
            f"{name} takes a record of {dtype.itemsize} bytes ({', '.join((dtype.names or ())[:4])} ...) or an array of such; "
            f"given is {shown}. (An address is for .c, which believes it.)"
        )
    if not given.size or not given.flags.c_contiguous or not given.flags.writeable or not given.flags.aligned:
        raise ArgumentError(
            f"{name}: the record is the first of a writable, contiguous array of one or more; given is {given!r}."
        )


@lru_cache(1024)
def _record_at(address: int, dtype: np.dtype) -> Any:
    return at(address, 1, dtype)[0]


def _as_record(given: Any, dtype: np.dtype | None) -> Any:
    if dtype is None or not isinstance(given, int | np.ndarray):
        return given
    return given[0] if isinstance(given, np.ndarray) else _record_at(given, dtype)


# --- kinds of functions ---


def _c_kind(result: str | None, arguments: tuple, function: Any = ctypes.CFUNCTYPE) -> Any:
    return function(_C[result], *(ctypes.c_int64 if isinstance(a, np.dtype) else _C[a] for a in arguments))


def _signature(result: str | None, arguments: tuple) -> Any:
    types = [numba.from_dtype(np.dtype(a)) for a in arguments]
    return (numba.from_dtype(np.dtype(result)) if result else numba.types.void)(*types)


def _ir_kind(context: Any, result: Any, arguments: Any) -> Any:
    returned = ir.VoidType() if result == numba.types.void else context.get_value_type(result)
    return ir.FunctionType(returned, [context.get_value_type(a) for a in arguments])


def _result_of(context: Any, signature: Any, done: Any) -> Any:
    return context.get_dummy_value() if signature.return_type == numba.types.void else done


def _with_parameters(call: Callable, n: int) -> Any:
    """numba wants parameters by name."""
    names = "".join(f", a{k}" for k in range(n))
    space: dict[str, Any] = {"call": call}
    exec(f"def sealed(context{names}):\n    return call(context{names})", space)
    return space["sealed"]
