"""Emitter of object files: numba types and lowers exported functions, LLVM optimizes them together and emits machine code.

    PULSESTAGE_EMIT=1 python -m stage.native.object_emitter < JOB     JOB: JSON, see `main`

numba alone would optimize each function, and again each function that calls it. This module only collects the code that numba has
lowered, so that LLVM optimizes each part of the library once, as a whole.
"""

from __future__ import annotations

import gc
import json
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.machinery import ModuleSpec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba.core import codegen, types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target

from stage.native.compile_error_explanation import explain_compile_error
from stage.native.object_file_cache import write_object

SYSTEM_FUNCTIONS = frozenset(
    "exp log log1p pow sin cos tan sqrt floor ceil rint round trunc fmod memset memcpy memmove".split()
)
"""System functions that a library may use: mathematics and memory functions of C."""

MODULES_AT_ONCE = 16
"""Modules that are linked before they go into the whole: LLVM looks through all that is there each time that something is added."""

REFERENCE_COUNTING = """
define void @NRT_incref(i8* %p) alwaysinline { ret void }
define void @NRT_decref(i8* %p) alwaysinline { ret void }
"""
"""numba's reference counting functions, which are removed: compiled code owns no array."""


class _GatheredLibrary(codegen.AOTCodeLibrary):
    """LLVM code that numba has made of a function, as text before optimization. LLVM later parses it into the whole part."""

    def __init__(self, generator: Any, name: str):
        codegen.CodeLibrary.__init__(self, generator, name)
        self._linking_libraries: list[Any] = []
        self.texts: list[str] = []

    def add_ir_module(self, ir_module: Any) -> None:
        self.texts.append(codegen.cgutils.normalize_ir_text(str(ir_module)))

    def finalize(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0  # nothing runs here


class _Codegen(codegen.AOTCPUCodegen):
    """Code generator of numba that does not bind environments to addresses."""

    _library_class = _GatheredLibrary

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: the compiled code does not run in this process."""


class PackageWithoutInitFinder:
    """Import finder that finds packages without their __init__, because a build needs neither chip classes nor Gymnasium."""

    def __init__(self, package_folders: dict[str, str]):
        self._package_folders = {name: Path(folder) for name, folder in package_folders.items()}

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Return the specification of a package without its __init__; None for other modules."""
        if name == "stage.native":
            return None
        for prefix, folder in self._package_folders.items():
            if name == prefix or name.startswith(f"{prefix}."):
                inside = folder.joinpath(*name[len(prefix) + 1 :].split("."))
                if inside.is_dir():
                    spec = ModuleSpec(name, None, is_package=True)
                    spec.submodule_search_locations = [str(inside)]
                    return spec
        return None


def make_context(processor: str) -> Any:
    """Make the context with which numba compiles for a processor from now on."""
    context: Any = cpu_target.target_context
    context.refresh()  # numba compiles some of its own, to be run
    context._internal_codegen = _Codegen("pulsestage", cpu_name=processor)
    context.aot_mode = True
    return context


def _gather_libraries(library: Any, libraries: dict[int, Any]) -> None:
    """Collect a library of numba and all libraries that it links, by their ids."""
    if id(library) not in libraries and isinstance(library, _GatheredLibrary):  # the others are numba's own, to be run
        libraries[id(library)] = library
        for other in library._linking_libraries:
            _gather_libraries(other, libraries)


def _compile_exported_function(function: Any, context: Any) -> Iterator[Any]:
    """Yield the code of an exported function: its entry for C, and the code that numba has made of the function."""
    from stage.native.numba_implementations import get_numba_type, lower_array

    returned, arguments = get_numba_type(function.result), tuple(get_numba_type(a) for a in function.arguments)
    try:
        function.hot.compile(arguments)
    except Exception as error:  # numba raises of many kinds, an AssertionError, too
        raise SystemExit(explain_compile_error(function.hot.py_func, error)) from None
    overload = function.hot.overloads[arguments]
    library = context.codegen().create_library(function.symbol)
    module = library.create_ir_module(function.symbol)
    words: list[Any] = []
    for a in arguments:
        words += [ir.IntType(64)] * (1 + a.ndim) if isinstance(a, types.Array) else [context.get_value_type(a)]
    result = ir.VoidType() if returned == types.void else context.get_value_type(returned)
    entry = ir.Function(module, ir.FunctionType(result, words), function.symbol)
    builder = ir.IRBuilder(entry.append_basic_block("entry"))
    left, values = iter(entry.args), []
    for a in arguments:
        if isinstance(a, types.Array):
            values.append(lower_array(context, builder, a, next(left), [next(left) for _ in range(a.ndim)]))
        else:
            values.append(next(left))
    inner = context.declare_function(module, overload.fndesc)
    _, value = context.call_conv.call_function(builder, inner, overload.signature.return_type, arguments, values)
    if returned == types.void:
        builder.ret_void()
    else:
        builder.ret(context.cast(builder, value, overload.signature.return_type, returned))
    library.add_ir_module(module)
    yield from (library, overload.library)


@global_compiler_lock
def emit_object(modules: list[str], context: Any) -> bytes:
    """Compile all functions that the given modules export, and return one object file.

    numba lowers the functions to LLVM modules. These are linked into one module and optimized together.

    Args:
        modules: Names of the modules.
        context: Context of `make_context`.
    """
    for name in modules:
        import_module(name)
    from stage.native.hot_functions import ExportedFunction

    functions = [f for f in ExportedFunction.every if f.module in modules]
    gathered: dict[int, Any] = {}
    for function in functions:
        for library in _compile_exported_function(function, context):
            _gather_libraries(library, gathered)
    generator = context.codegen()
    linked = llvm.parse_assembly(str(generator._create_empty_module(modules[0])))
    linked.link_in(llvm.parse_assembly(REFERENCE_COUNTING))
    texts = [text for library in gathered.values() for text in library.texts]
    for k in range(0, len(texts), MODULES_AT_ONCE):
        group, *others = map(llvm.parse_assembly, texts[k : k + MODULES_AT_ONCE])
        for module in others:
            group.link_in(module)
        linked.link_in(group)
    linked.data_layout = generator._data_layout
    symbols = {f.symbol for f in functions}
    for symbol in (*linked.functions, *linked.global_variables):
        if not symbol.is_declaration and symbol.name not in symbols and symbol.linkage != llvm.Linkage.private:
            symbol.linkage = "internal"
    linked.verify()
    passes, builder = generator._module_pass_manager()
    passes.run(linked, builder)
    _refuse_missing_symbols(linked, {f.symbol for f in ExportedFunction.every}, modules)
    return bytes(generator._tm.emit_object(linked))


def _refuse_missing_symbols(linked: Any, exported: set[str], modules: list[str]) -> None:
    """Raise SystemExit if the code needs a symbol that a library must not use, of a function that can raise or allocate."""
    for symbol in (*linked.functions, *linked.global_variables):
        if (
            symbol.is_declaration
            and symbol.name not in exported | SYSTEM_FUNCTIONS
            and not symbol.name.startswith("llvm.")
        ):
            users = [f.name for f in linked.functions if not f.is_declaration and f"@{symbol.name}(" in str(f)]
            raise SystemExit(
                f"{', '.join(modules)}: {symbol.name!r} is needed, by {users}: a hot function may raise, or allocate."
            )


def _emit_remaining_parts(next_part: Any, parts: list[list[str]], context: Any) -> None:
    """Compile one part after another, always the next one that no other process has begun."""
    while True:
        with next_part:
            number, next_part.value = next_part.value, next_part.value + 1
        if number >= len(parts):
            return
        path, *modules = parts[number]
        content = emit_object(modules, context)
        try:
            write_object(Path(path), content)
        except OSError as error:
            raise SystemExit(f"{path} could not be written: {error.strerror or error}. Make room there.") from None
        print(path, flush=True)


def main() -> int:
    """Compile the parts of a job, which is JSON on standard input.

    A job is {"package_folders": package -> folder, "processor": ..., "workers": ..., "parts": [[object, module, ...], ...]}.
    Each worker is a copy of this process, with all imports done. A worker that is free compiles the next part.
    """
    gc.disable()  # nearly all that is made is kept to the end: looking for the rest takes a sixth of the time
    sys.modules["scipy"] = None  # type: ignore[assignment]  # numba would look for a BLAS in it, and import most of it
    job = json.load(sys.stdin)
    sys.meta_path.insert(0, PackageWithoutInitFinder(job["package_folders"]))
    context = make_context(job["processor"])
    fork = get_context("fork")
    next_part = fork.Value("q")
    workers = [
        fork.Process(target=_emit_remaining_parts, args=(next_part, job["parts"], context))
        for _ in range(job["workers"])
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return int(any(worker.exitcode for worker in workers))


if __name__ == "__main__":
    sys.exit(main())
