"""Build a package's native library: which parts are stale, who emits them, the link.

A part is what one family exports: a folder of the third level, with all below it. Its object depends on the modules that define it
and on what they import, transitively, and is kept in the package's __pycache__ under a digest of them all: only parts whose sources
have changed are made again, and those that are not as they were written.
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
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stage.errors import NativeError
from stage.native import load, seal
from stage.processes import ENCODING, ERRORS

NUMBA = "0.68.1"
"""The one version that libraries are made with: what it lowers to is part of what they do."""


DEPTH = 3
"""Names in that of a part: `stage.chips.nova` is one, whatever folders it has. What is compiled in two parts is compiled twice."""

COMPILERS = tuple(filter(None, (os.environ.get("CC"), "cc", "clang", "gcc")))


def made(package: str, why: str) -> Path:
    """Make the library of `package`, for the reason `why`, and return where it is. Raises NativeError where that cannot be."""
    lacking = [name for name in ("numba", "llvmlite") if find_spec(name) is None]
    if lacking:
        raise NativeError(f"{why}; and {' and '.join(lacking)}, to build it, are not installed. {load.advice(package)}")
    return build(package)


def build(package: str) -> Path:
    """Bring the library of `package` up to date. Progress goes to standard error."""
    places = load.folders(package)
    folder = places[package]
    try:
        try:
            with _alone(folder):
                return _build(package, places, folder)
        except PermissionError:
            folder = Path(tempfile.mkdtemp(prefix="pulsestage-"))  # 0700; for this process
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
            return _build(package, places, folder)
    except OSError as error:
        raise NativeError(
            f"the native library of {package} could not be written to {error.filename or folder}: "
            f"{error.strerror or error}. Make room there, and start again."
        ) from error


def _build(package: str, places: dict[str, Path], folder: Path) -> Path:
    path = folder / load.NAME
    if not load.unfit(package, path):
        return path  # somebody else has built it meanwhile
    if (found := version("numba")) != NUMBA:
        raise NativeError(
            f"libraries are built with numba {NUMBA}, and {found} is installed: pip install numba=={NUMBA}."
        )
    roots = places | load.folders("stage")
    known = {module: Path(source) for module, source in load.modules(roots)}
    parts = _parts(package, places)
    kept = folder / "__pycache__"
    kept.mkdir(exist_ok=True)
    processor, needs = load.BASELINES.get(platform.machine(), ("", ()))
    sources: dict[str, str] = {}
    objects, missing = [], []
    for name, modules in parts.items():
        closure = {m: load.digest_of(known[m]) for m in sorted(_closure(modules, known))}
        sources |= closure
        digest = hashlib.sha256(json.dumps([modules, closure, NUMBA, load.target(), processor]).encode()).hexdigest()[
            :16
        ]
        target = kept / f"{name}-{digest}.o"
        objects.append(target)
        if not seal.kept(target):
            for old in kept.glob(f"{name}-*.o*"):
                old.unlink(missing_ok=True)
            missing.append((sum(known[m].stat().st_size for m in closure), [str(target), *modules]))
    say = _Progress(f"PulseStage: building the native library of {package}", len(missing), len(parts))
    _emit([part for _, part in sorted(missing, reverse=True)], roots, processor, say)
    manifest = {
        "digest": load.NO_DIGEST,
        "target": load.target(),
        "needs": list(needs),
        "numba": NUMBA,
        "sources": sources,
    }
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        _link(objects, _manifest_object(manifest, kept), temporary, complete=package == "stage")
        if sys.platform == "linux":  # elsewhere the linker signs
            content = temporary.read_bytes()
            digest = load.digest_within(content, load.NO_DIGEST)
            temporary.write_bytes(content.replace(load.NO_DIGEST.encode(), digest.encode(), 1))
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    say.done()
    return path


def _parts(package: str, places: dict[str, Path]) -> dict[str, list[str]]:
    """Folder -> the modules in it and below that export something."""
    parts: dict[str, list[str]] = {}
    for module in load.exporting(places):
        folder = module.rpartition(".")[0]
        parts.setdefault(".".join(folder.split(".")[:DEPTH]), []).append(module)
    if not parts:
        raise NativeError(f"package {package!r} exports no compiled function.")
    return parts


def _closure(modules: list[str], known: dict[str, Path]) -> set[str]:
    """These modules and all that they import, of `known`."""
    found = {f"stage.native.{name}" for name in ("arithmetic", "emit", "passes", "typed")}
    left = list(modules)
    while left:
        module = left.pop()
        if module not in found:
            found.add(module)
            left += _imports(module, known)
    return found


def _imports(module: str, known: dict[str, Path]) -> Iterator[str]:
    for node in ast.walk(ast.parse(known[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(module.split(".")[: -node.level]) if node.level else ""
            origin = ".".join(filter(None, (base, node.module)))
            if origin in known:
                yield origin
            yield from (name for alias in node.names if (name := f"{origin}.{alias.name}") in known)


def _emit(parts: list[list[str]], roots: dict[str, Path], processor: str, say: _Progress) -> None:
    """Have objects made, by a process for each processor."""
    if not parts:
        return
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")} | {"PULSESTAGE_EMIT": "1"}
    here = [str(folder.parent) for name, folder in roots.items() if "." not in name]
    inherited = filter(None, sys.path)  # pip builds in a place of its own
    environment["PYTHONPATH"] = os.pathsep.join(dict.fromkeys([*here, *inherited]))
    job = {
        "places": {name: str(folder) for name, folder in roots.items()},
        "processor": processor,
        "parts": parts,
        "workers": min(len(parts), os.cpu_count() or 1),
    }
    process: Any = subprocess.Popen(
        [sys.executable, "-m", "stage.native.emit"], env=environment, encoding=ENCODING, errors=ERRORS,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    with process:
        json.dump(job, process.stdin)
        process.stdin.close()
        said: list[str] = []
        reader = threading.Thread(target=lambda: said.append(process.stderr.read()))
        reader.start()
        for _ in process.stdout:
            say.one()
        reader.join()
    if process.returncode:
        raise NativeError(f"the native library could not be built:\n{said[0].strip()}")


def _manifest_object(manifest: dict[str, Any], kept: Path) -> Path:
    """An object that holds what the library says about itself."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    content = load.MARK + json.dumps(manifest).encode() + b"\0"
    text = "".join(f"\\{byte:02x}" for byte in content)
    module = llvm.parse_assembly(f'@pulsestage_manifest = constant [{len(content)} x i8] c"{text}"')
    machine = llvm.Target.from_default_triple().create_target_machine(reloc="pic", codemodel="default")
    path = kept / "manifest.o"
    path.write_bytes(machine.emit_object(module))
    return path


def _link(objects: list[Path], manifest: Path, path: Path, complete: bool) -> None:
    """One shared library of these objects. complete: no other library of ours has what it lacks, which
    is an error where the linker can tell."""
    names = [str(o) for o in (*objects, manifest)]
    symbols = ["-Wl,-Bsymbolic"] if sys.platform == "linux" else ["-undefined", "dynamic_lookup"]
    if complete and sys.platform == "linux":
        symbols.append("-Wl,-z,defs")
    try:
        subprocess.run(
            [*linker(), "-shared", "-o", str(path), *names, *symbols, "-lm"], check=True, capture_output=True
        )
    except subprocess.CalledProcessError as error:
        raise NativeError(
            f"the native library could not be linked:\n{error.stderr.decode(errors='replace')}"
        ) from error


def linker() -> list[str]:
    """The command that links: a C compiler of this machine, or the one that the package ziglang brings."""
    for name in COMPILERS:
        if shutil.which(name):
            return [name]
    if find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    raise NativeError("nothing here links a library: install a C compiler, or pip install ziglang.")


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """One process at a time builds in a folder; where a folder cannot be locked, each builds for itself and the last one stays."""
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


class _Progress:
    """One line on standard error that says how far a build is."""

    def __init__(self, what: str, stale: int, parts: int) -> None:
        self._what, self._done, self._all, self._lock = what, 0, stale, threading.Lock()
        self._print(f"{what}: {stale} of {parts} parts ...", "")

    def one(self) -> None:
        with self._lock:
            self._done += 1
            if sys.stderr.isatty():
                self._print(f"\r{self._what}: {self._done} of {self._all} parts ...", "")

    def done(self) -> None:
        self._print(" done", "\n")

    @staticmethod
    def _print(text: str, end: str) -> None:
        with suppress(OSError, ValueError):
            print(text, end=end, file=sys.stderr, flush=True)
