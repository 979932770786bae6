"""Make objects: numba types and lowers the exported functions of modules, LLVM optimizes them as one and emits machine code.

    PULSESTAGE_EMIT=1 python -m stage.native.emit JOB     JOB: JSON on standard input, see `main`

numba by itself optimizes each function, and again in each that calls it; here what it lowers is only gathered, so that LLVM sees a
part of the library once, and whole.
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

from stage.native.refusals import told
from stage.native.seal import keep

OUTSIDE = frozenset("exp log pow sin cos tan sqrt floor ceil rint round trunc fmod memset memcpy memmove".split())
"""What a library may ask of the system: C's mathematics and memory."""

TOGETHER = 16
"""Modules that are linked before they go into the whole: LLVM looks through all that is there each time that something is added."""

BORROWED = """
define void @NRT_incref(i8* %p) alwaysinline { ret void }
define void @NRT_decref(i8* %p) alwaysinline { ret void }
"""
"""Every array here is borrowed: nobody counts who holds it."""


class _Gathered(codegen.AOTCodeLibrary):
    """What numba made of a function, as it was lowered: as text, since LLVM reads it once, into the whole."""

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
    _library_class = _Gathered

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing runs here."""


class BarePackages:
    """Imports modules of a package's tree without what its packages' __init__ do: a library needs no chip class, no Gymnasium."""

    def __init__(self, places: dict[str, str]):
        self._places = {name: Path(folder) for name, folder in places.items()}

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if name == "stage.native":
            return None
        for prefix, folder in self._places.items():
            if name == prefix or name.startswith(f"{prefix}."):
                inside = folder.joinpath(*name[len(prefix) + 1 :].split("."))
                if inside.is_dir():
                    spec = ModuleSpec(name, None, is_package=True)
                    spec.submodule_search_locations = [str(inside)]
                    return spec
        return None


def context_for(processor: str) -> Any:
    """numba's, that it makes everything in from now on, for that processor."""
    context: Any = cpu_target.target_context
    context.refresh()  # numba compiles some of its own, to be run
    context._internal_codegen = _Codegen("pulsestage", cpu_name=processor)
    context.aot_mode = True
    return context


def _gather(library: Any, into: dict[int, Any]) -> None:
    if id(library) not in into and isinstance(library, _Gathered):  # the others are numba's own, to be run
        into[id(library)] = library
        for other in library._linking_libraries:
            _gather(other, into)


def _entry(function: Any, context: Any) -> Iterator[Any]:
    """The libraries of an exported function: its C entry, and what numba made of the function."""
    from stage.native.typed import lowered_array, type_of

    returned, arguments = type_of(function.result), tuple(type_of(a) for a in function.arguments)
    try:
        function.hot.compile(arguments)
    except Exception as error:  # numba raises of many kinds, an AssertionError, too
        raise SystemExit(told(function.hot.py_func, error)) from None
    made = function.hot.overloads[arguments]
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
            values.append(lowered_array(context, builder, a, next(left), [next(left) for _ in range(a.ndim)]))
        else:
            values.append(next(left))
    inner = context.declare_function(module, made.fndesc)
    _, done = context.call_conv.call_function(builder, inner, made.signature.return_type, arguments, values)
    if returned == types.void:
        builder.ret_void()
    else:
        builder.ret(context.cast(builder, done, made.signature.return_type, returned))
    library.add_ir_module(module)
    yield from (library, made.library)


@global_compiler_lock
def emit(modules: list[str], context: Any) -> bytes:
    """The object of the functions that these modules export; context: of `context_for`."""
    for name in modules:
        import_module(name)
    from stage.native.functions import Exported

    own = [f for f in Exported.every if f.module in modules]
    gathered: dict[int, Any] = {}
    for function in own:
        for library in _entry(function, context):
            _gather(library, gathered)
    generator = context.codegen()
    whole = llvm.parse_assembly(str(generator._create_empty_module(modules[0])))
    whole.link_in(llvm.parse_assembly(BORROWED))
    texts = [text for library in gathered.values() for text in library.texts]
    for k in range(0, len(texts), TOGETHER):
        group, *others = map(llvm.parse_assembly, texts[k : k + TOGETHER])
        for module in others:
            group.link_in(module)
        whole.link_in(group)
    whole.data_layout = generator._data_layout
    symbols = {f.symbol for f in own}
    for made in (*whole.functions, *whole.global_variables):
        if not made.is_declaration and made.name not in symbols and made.linkage != llvm.Linkage.private:
            made.linkage = "internal"
    whole.verify()
    passes, builder = generator._module_pass_manager()
    passes.run(whole, builder)
    _refuse(whole, {f.symbol for f in Exported.every}, modules)
    return bytes(generator._tm.emit_object(whole))


def _refuse(whole: Any, exported: set[str], modules: list[str]) -> None:
    """Raise for what asks for more than a library may: then a function may raise, or allocate."""
    for made in (*whole.functions, *whole.global_variables):
        if made.is_declaration and made.name not in exported | OUTSIDE and not made.name.startswith("llvm."):
            users = [f.name for f in whole.functions if not f.is_declaration and f"@{made.name}(" in str(f)]
            raise SystemExit(
                f"{', '.join(modules)}: {made.name!r} is needed, by {users}: a hot function may raise, or allocate."
            )


def _emit_next(taken: Any, parts: list[list[str]], context: Any) -> None:
    """Make one part after another, of those that no other process has taken."""
    while True:
        with taken:
            number, taken.value = taken.value, taken.value + 1
        if number >= len(parts):
            return
        path, *modules = parts[number]
        made = emit(modules, context)
        try:
            keep(Path(path), made)
        except OSError as error:
            raise SystemExit(f"{path} could not be written: {error.strerror or error}. Make room there.") from None
        print(path, flush=True)


def main() -> int:
    """Read {"places": package -> folder, "processor": ..., "workers": ..., "parts": [[object, module, ...], ...]} and do it.

    Each worker is a copy of this process, with all that is imported; whichever is free takes the next part."""
    gc.disable()  # nearly all that is made is kept to the end: looking for the rest takes a sixth of the time
    sys.modules["scipy"] = None  # type: ignore[assignment]  # numba would look for a BLAS in it, and import most of it
    job = json.load(sys.stdin)
    sys.meta_path.insert(0, BarePackages(job["places"]))
    context = context_for(job["processor"])
    fork = get_context("fork")
    taken = fork.Value("q")
    workers = [fork.Process(target=_emit_next, args=(taken, job["parts"], context)) for _ in range(job["workers"])]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return int(any(worker.exitcode for worker in workers))


if __name__ == "__main__":
    sys.exit(main())
