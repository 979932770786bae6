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

from stage.cache import folder_of, intact, make_known, sealed_with_digest

HERE = sys.platform == "linux"  # elsewhere nobody has tried: numba keeps the code


def load(function: Callable) -> tuple[int, Any] | None:
    """(address, what keeps it there) of a function whose code was kept on a machine like this; None if it was not."""
    file = _file(function)
    if file is None:
        return None
    try:
        kept = intact(file.read_bytes())
    except OSError:
        return None
    if kept is None:
        return None
    name, _, machine_code = kept.partition(b"\0")
    if not make_known(machine_code):
        return None
    engine = _engine()
    engine.add_object_file(llvmlite.binding.ObjectFileRef.from_data(machine_code))
    engine.finalize_object()
    return engine.get_function_address(name.decode()), engine


def keep(function: Callable, made: Any) -> None:
    """Keep the code of a compiled `numba.cfunc`; where that cannot be, it is compiled again next time."""
    file = _file(function)
    if file is None:
        return
    _, _, (machine_code, _) = made._library.serialize_using_object_code()
    part = file.with_suffix(f".{os.getpid()}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(sealed_with_digest(made.native_name.encode() + b"\0" + machine_code))
        part.replace(file)
    except OSError:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _file(function: Callable) -> Path | None:
    """By all that the code depends on: sources and numba (the folder), Python, LLVM, the processor."""
    folder = folder_of(function.__code__.co_filename) if HERE else None
    if folder is None:
        return None
    parts = (function.__module__, function.__qualname__, _machine())
    return folder / f"{function.__name__}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:24]}.code"


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
