"""Compiled functions: Python functions that are compiled ahead of time to one native library.

    @hot
    def period(c): ...                         part of what calls it

    @exported("i8", STATE, "i8")
    def read(c, address): ...                  a function of the library: Python, C and other hot functions call it

The sources are plain Python over records, scalars and arrays: no allocation, no strings, no exceptions. When a package is built
(library_builder.py), numba types them, LLVM makes one object of each part (object_emitter.py) and a linker one shared library,
`_native.so` in the package's folder. At run time library_loader.py loads it with ctypes, if its manifest
(library_manifest.py) says that it was built from these sources for this machine. With NUMBA_DISABLE_JIT=1 the same functions run
as plain Python, to the same bits: for debugging, coverage and fuzzing.

A package outside this one is built in the same way: `python -m stage.native PACKAGE`.
"""

from stage.native.arithmetic import floor, greatest, least
from stage.native.compile_mode import COMPILED
from stage.native.hot_functions import (
    ExportedFunction,
    array_of,
    declare_address_call,
    enter_usual_float_mode,
    exported,
    get_frame_address,
    hot,
    make_compare_and_exchange,
    restore_previous_float_mode,
    stack_mark,
)
from stage.native.record_dtypes import (
    address_of,
    allocate_on_stack,
    array_at,
    get_function_address,
    record,
    remove_attribute_access,
)

__all__ = [
    "COMPILED", "ExportedFunction", "address_of", "array_at", "array_of", "declare_address_call", "enter_usual_float_mode",
    "make_compare_and_exchange", "exported", "floor", "get_frame_address", "get_function_address", "greatest", "hot", "least",
    "record", "restore_previous_float_mode", "allocate_on_stack", "stack_mark", "remove_attribute_access",
]  # fmt: skip
