"""Machine code of sealed functions, kept on disk.

numba keeps code as well, but sets up its whole type system before it loads any, which takes as long as all else that a stage needs.
These functions are called by their addresses, so nothing but the code is wanted.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys

from stage.compiled import cache_folder

HERE = sys.platform == "linux"  # elsewhere nobody has tried: numba keeps the code


def load(function: Callable) -> tuple[int, Any] | None:
    """(address, what keeps it there) of a function whose code was kept on a machine like this; None if it was not."""
    if not HERE:
        return None
    try:
        kept = _file(function).read_bytes()
    except OSError:
        return None
    digest, kept = kept[:32], kept[32:]
    if hashlib.sha256(kept).digest() != digest:
        return None
    name, _, machine_code = kept.partition(b"\0")
    engine = _engine()
    engine.add_object_file(llvmlite.binding.ObjectFileRef.from_data(machine_code))
    engine.finalize_object()
    return engine.get_function_address(name.decode()), engine


def keep(function: Callable, made: Any) -> None:
    """Keep the code of a compiled `numba.cfunc`; where that cannot be, it is compiled again next time."""
    if not HERE:
        return
    _, _, (machine_code, _) = made._library.serialize_using_object_code()
    file = _file(function)
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}")
        kept = made.native_name.encode() + b"\0" + machine_code
        part.write_bytes(hashlib.sha256(kept).digest() + kept)
        part.replace(file)


def _file(function: Callable) -> Path:
    """By all that the code depends on: our sources and numba (the folder), the function's own file, Python, LLVM, the processor."""
    source = Path(function.__code__.co_filename)
    parts = (function.__module__, function.__qualname__, _machine(), hashlib.sha256(source.read_bytes()).hexdigest())
    return cache_folder() / f"{function.__name__}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:24]}.code"


@cache
def _codegen() -> Any:
    context: Any = cpu_target.target_context
    rtsys.initialize(context)  # what machine code may refer to
    return context.codegen()


@cache
def _machine() -> tuple:
    return sys.implementation.cache_tag, llvmlite.__version__, *_codegen().magic_tuple()


@cache
def _engine() -> Any:
    _codegen()
    machine = llvmlite.binding.Target.from_default_triple().create_target_machine()
    return llvmlite.binding.create_mcjit_compiler(llvmlite.binding.parse_assembly(""), machine)
