"""Builder of a package's native library: it compiles the parts that are out of date to object files, and links all parts.

A part consists of the functions that the modules of one folder export, such as those of a chip family. Its object file depends on
the code of these modules and of the modules that they import, transitively; of functions that are called by their symbols only the
signature matters. Object files are stored in the package's __pycache__ under a digest of this code, so that only parts whose code
has changed are compiled again, or parts whose file is damaged. Comments and docstrings do not count as code.
"""

from __future__ import annotations

import ast
import atexit
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stage.errors import NativeError
from stage.native import library_manifest, object_file_cache
from stage.support.subprocesses import ENCODING, ERRORS

NUMBA = "0.68.1"
"""The only version of numba that builds libraries, because results depend on the code that numba generates."""


PART_NAME_DEPTH = 3
"""Number of names in the name of a part, for example `stage.chips.nova`, whose subfolders belong to the same part."""

COMPILERS = tuple(filter(None, (os.environ.get("CC"), "cc", "clang", "gcc")))


def build_missing(package: str, why: str) -> Path:
    """Build the library of a package that is missing, or that does not match the sources or the machine.

    Args:
        package: Name of the package.
        why: Result of `library_manifest.explain_library_misfit`, for the error.

    Returns:
        Path of the library.

    Raises:
        NativeError: The library cannot be built.
    """
    lacking = [name for name in ("numba", "llvmlite") if find_spec(name) is None]
    if lacking:
        raise NativeError(
            f"{why}; and {' and '.join(lacking)}, to build it, are not installed. {library_manifest.advise_install(package)}"
        )
    return build_library(package)


def build_library(package: str) -> Path:
    """Bring the library of a package up to date. Progress goes to standard error.

    Args:
        package: Name of the package.

    Returns:
        Path of the library; if the package is read-only, in a temporary folder of this process.

    Raises:
        NativeError: The library cannot be built or written.
    """
    package_folders = library_manifest.find_package_folders(package)
    folder = package_folders[package]
    try:
        try:
            with _build_lock(folder):
                return _build_library(package, package_folders, folder)
        except PermissionError:
            folder = Path(tempfile.mkdtemp(prefix="pulsestage-"))  # 0700; for this process
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
            return _build_library(package, package_folders, folder)
    except OSError as error:
        raise NativeError(
            f"the native library of {package} could not be written to {error.filename or folder}: "
            f"{error.strerror or error}. Make room there, and start again."
        ) from error


def _build_library(package: str, package_folders: dict[str, Path], folder: Path) -> Path:
    """Build the library of a package in a folder, and return its path."""
    path = folder / library_manifest.NAME
    if not library_manifest.explain_library_misfit(package, path):
        return path  # somebody else has built it meanwhile
    if (installed := version("numba")) != NUMBA:
        raise NativeError(
            f"libraries are built with numba {NUMBA}, and {installed} is installed: pip install numba=={NUMBA}."
        )
    roots = package_folders | library_manifest.find_package_folders("stage")
    known = {module: Path(source) for module, source in library_manifest.list_modules(roots)}
    parts = _list_parts(package, package_folders)
    object_cache = folder / "__pycache__"
    object_cache.mkdir(exist_ok=True)
    processor, needs = library_manifest.BASELINES.get(platform.machine(), ("", ()))
    sources: dict[str, str] = {}
    objects, missing = [], []
    for name, modules in parts.items():
        closure = _digest_dependencies(modules, known)
        sources |= {m.partition(" ")[0]: library_manifest.digest_file(known[m.partition(" ")[0]]) for m in closure}
        digest = hashlib.sha256(
            json.dumps([modules, closure, NUMBA, library_manifest.describe_target(), processor]).encode()
        ).hexdigest()[:16]
        target = object_cache / f"{name}-{digest}.o"
        objects.append(target)
        if not object_file_cache.is_intact(target):
            for old in object_cache.glob(f"{name}-*.o*"):
                old.unlink(missing_ok=True)
            missing.append((sum(known[m].stat().st_size for m in closure if m in known), [str(target), *modules]))
    say = _ProgressLine(f"PulseStage: building the native library of {package}", len(missing), len(parts))
    _emit_objects([part for _, part in sorted(missing, reverse=True)], roots, processor, say)
    manifest = {
        "digest": library_manifest.NO_DIGEST,
        "target": library_manifest.describe_target(),
        "needs": list(needs),
        "numba": NUMBA,
        "sources": sources,
    }
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        _link_library(
            objects, _write_manifest_object(manifest, object_cache), temporary, all_symbols_needed=package == "stage"
        )
        if sys.platform == "linux":  # elsewhere the linker signs
            content = temporary.read_bytes()
            digest = library_manifest.digest_content(content, library_manifest.NO_DIGEST)
            temporary.write_bytes(content.replace(library_manifest.NO_DIGEST.encode(), digest.encode(), 1))
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    say.finish()
    return path


def _list_parts(package: str, package_folders: dict[str, Path]) -> dict[str, list[str]]:
    """Return for each part the modules that export functions, in the folder of the part and below it."""
    parts: dict[str, list[str]] = {}
    for module in library_manifest.find_exporting_modules(package_folders):
        folder = module.rpartition(".")[0]
        parts.setdefault(".".join(folder.split(".")[:PART_NAME_DEPTH]), []).append(module)
    if not parts:
        raise NativeError(f"package {package!r} exports no compiled function.")
    return parts


def _digest_dependencies(modules: list[str], known: dict[str, Path]) -> dict[str, str]:
    """Return the digests of all code on which the object file of some modules depends, sorted by name.

    Args:
        modules: Modules of a part.
        known: Module -> file of all modules that may be imported.

    Returns:
        Module -> digest of its code, for the modules and their imports; "module function" -> digest of the signature, for functions
        that are called by their symbols.
    """
    digests: dict[str, str] = {}
    left = [f"stage.native.{name}" for name in ("arithmetic", "object_emitter", "numba_implementations")] + list(
        modules
    )
    while left:
        module = left.pop()
        if module not in digests:
            tree = _read_code(known[module])
            digests[module] = _digest_code(tree)
            for origin, name in _list_imports(module, tree, known):
                signature = _find_exported_signature(_read_code(known[origin]), name)
                if signature:
                    digests[f"{origin} {name}"] = _digest_code(signature)
                else:
                    left.append(origin)
    return dict(sorted(digests.items()))


def _read_code(source: Path) -> ast.Module:
    """Parse a source file to its code, which does not depend on comments, docstrings and the positions of lines."""
    return _parse_code(source.read_text(encoding="utf-8"))


@cache
def _parse_code(text: str) -> ast.Module:
    """Parse the text of a source file, without docstrings."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [b for b in body if not (isinstance(b, ast.Expr) and isinstance(b.value, ast.Constant))]  # type: ignore[attr-defined]
    return tree


def _digest_code(code: ast.AST) -> str:
    """Return a digest of code."""
    return hashlib.sha256(ast.dump(code).encode()).hexdigest()[:16]


def _find_exported_signature(tree: ast.Module, name: str) -> ast.expr | None:
    """Return the signature of an exported function that is called by its symbol; None if it is compiled into its callers.

    Functions that take arrays are compiled into their callers.
    """
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            for decorator in node.decorator_list:
                if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "exported":
                    return None if "array_of" in ast.unparse(decorator) else decorator
    return None


def _list_imports(module: str, tree: ast.Module, known: dict[str, Path]) -> Iterator[tuple[str, str]]:
    """Yield pairs of a module of `known` that a module imports, and the name that is imported from it, or ""."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(module.split(".")[: -node.level]) if node.level else ""
            origin = ".".join(filter(None, (base, node.module)))
            for alias in node.names:
                if f"{origin}.{alias.name}" in known:
                    yield f"{origin}.{alias.name}", ""
                elif origin in known:
                    yield origin, alias.name


def _emit_objects(parts: list[list[str]], roots: dict[str, Path], processor: str, say: _ProgressLine) -> None:
    """Compile parts to object files, with one process for each processor."""
    if not parts:
        return
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")} | {"PULSESTAGE_EMIT": "1"}
    own_folders = [str(folder.parent) for name, folder in roots.items() if "." not in name]
    inherited = filter(None, sys.path)  # pip builds in a place of its own
    environment["PYTHONPATH"] = os.pathsep.join(dict.fromkeys([*own_folders, *inherited]))
    job = {
        "package_folders": {name: str(folder) for name, folder in roots.items()},
        "processor": processor,
        "parts": parts,
        "workers": min(len(parts), os.cpu_count() or 1),
    }
    process: Any = subprocess.Popen(
        [sys.executable, "-m", "stage.native.object_emitter"], env=environment, encoding=ENCODING, errors=ERRORS,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    with process:
        json.dump(job, process.stdin)
        process.stdin.close()
        errors: list[str] = []
        reader = threading.Thread(target=lambda: errors.append(process.stderr.read()))
        reader.start()
        for _ in process.stdout:
            say.show_part_done()
        reader.join()
    if process.returncode:
        raise NativeError(f"the native library could not be built:\n{errors[0].strip()}")


def _write_manifest_object(manifest: dict[str, Any], object_cache: Path) -> Path:
    """Write an object file with the manifest of the library, and return its path."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    content = library_manifest.MARK + json.dumps(manifest).encode() + b"\0"
    text = "".join(f"\\{byte:02x}" for byte in content)
    module = llvm.parse_assembly(f'@pulsestage_manifest = constant [{len(content)} x i8] c"{text}"')
    machine = llvm.Target.from_default_triple().create_target_machine(reloc="pic", codemodel="default")
    path = object_cache / "manifest.o"
    path.write_bytes(machine.emit_object(module))
    return path


def _link_library(objects: list[Path], manifest: Path, path: Path, all_symbols_needed: bool) -> None:
    """Link object files to a shared library.

    Args:
        objects: Object files of all parts.
        manifest: Object file of the manifest.
        path: Library to write.
        all_symbols_needed: Whether a missing symbol is an error. The library of another package may lack symbols, which
            PulseStage's library has.
    """
    names = [str(o) for o in (*objects, manifest)]
    symbols = ["-Wl,-Bsymbolic"] if sys.platform == "linux" else ["-undefined", "dynamic_lookup"]
    if all_symbols_needed and sys.platform == "linux":
        symbols.append("-Wl,-z,defs")
    try:
        subprocess.run(
            [*find_linker(), "-shared", "-o", str(path), *names, *symbols, "-lm"], check=True, capture_output=True
        )
    except subprocess.CalledProcessError as error:
        raise NativeError(
            f"the native library could not be linked:\n{error.stderr.decode(errors='replace')}"
        ) from error


def find_linker() -> list[str]:
    """Return the command of a linker: a C compiler of this machine, or the one of the package ziglang."""
    for name in COMPILERS:
        if shutil.which(name):
            return [name]
    if find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    raise NativeError("nothing here links a library: install a C compiler, or pip install ziglang.")


@contextmanager
def _build_lock(folder: Path) -> Iterator[None]:
    """Let one process at a time build in a folder, within this context.

    If the folder cannot be locked, several processes build at once, and the library of the last one stays.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        if not os.access(folder, os.W_OK):
            raise PermissionError(f"{folder} is read-only")
        with suppress(ImportError, OSError):
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


class _ProgressLine:
    """Line on standard error that shows the progress of a build."""

    def __init__(self, what: str, stale: int, parts: int) -> None:
        self._what, self._done, self._all, self._lock = what, 0, stale, threading.Lock()
        self._print(f"{what}: {stale} of {parts} parts ...", "")

    def show_part_done(self) -> None:
        """Count one more part, and show the number of parts that are done."""
        with self._lock:
            self._done += 1
            if sys.stderr.isatty():
                self._print(f"\r{self._what}: {self._done} of {self._all} parts ...", "")

    def finish(self) -> None:
        """End the line."""
        self._print(" done", "\n")

    @staticmethod
    def _print(text: str, end: str) -> None:
        with suppress(OSError, ValueError):
            print(text, end=end, file=sys.stderr, flush=True)
