"""Find a package's native library, check that it fits, load it."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import platform
import sys
from collections.abc import Container, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stage.errors import NativeError

NAME = "_native.so"
MARK = b"\0PULSESTAGE NATIVE LIBRARY "
"""In a library, before its manifest as JSON, which a zero ends."""
FIELDS = {"digest", "target", "needs", "numba", "sources"}
"""Of a manifest."""
NO_DIGEST = "0" * 64
"""In a manifest, where the digest of the file will be; it stays where a file may not be changed after the link."""


def address(module: str, symbol: str) -> int:
    """Where the function of this name lies, of the library of the package that the module belongs to."""
    function = getattr(_library(module.partition(".")[0]), symbol)
    return int(ctypes.cast(function, ctypes.c_void_p).value or 0)


@cache
def _library(package: str) -> ctypes.CDLL:
    if sys.platform == "win32":
        raise NativeError(
            "PulseStage has no native library for Windows: use WSL. (NUMBA_DISABLE_JIT=1 runs it slowly, as Python.)"
        )
    path = _root(package) / NAME
    if why := unfit(package, path):
        from stage.native import build

        path = build.made(package, why)
    if package != "stage":
        _library("stage")  # what others call in it, they find by name
    try:
        return ctypes.CDLL(str(path), ctypes.RTLD_GLOBAL)
    except OSError as error:
        raise NativeError(f"{path} cannot be loaded: {error}. {advice(package)}") from error


def unfit(package: str, path: Path) -> str:
    """Why this library is not that of the package as it is here, in words; "" if it is."""
    try:
        content = path.read_bytes()
    except OSError:
        return f"package {package!r} has no native library in {path.parent}"
    manifest = _manifest(content)
    if manifest is None or manifest["digest"] not in (NO_DIGEST, digest_within(content, manifest["digest"])):
        return f"{path} is damaged"
    if manifest["target"] != target():
        return f"{path} was built for {manifest['target']}, this is {target()}"
    if lacking := [f for f in manifest["needs"] if f not in features()]:
        return f"{path} needs a processor with {', '.join(lacking)}, which this one has not"
    places = {root: folders(root) for root in {module.partition(".")[0] for module in manifest["sources"]}}
    for module, digest in manifest["sources"].items():
        try:
            same = digest_of(source_of(module, places[module.partition(".")[0]])) == digest
        except OSError:
            same = False
        if not same and package != "stage" and module.startswith("stage."):
            return f"{path} was built with another version of PulseStage: {module} is not as it was there"
        if not same:
            return f"{path} was built from other sources: {module} has changed"
    own = places.get(package) or folders(package)
    if package != "stage" or _project(own[package]).is_file():  # not of the wheel of many files, whose modules stay
        for module in exporting(own, manifest["sources"]):
            return f"{path} was built from other sources: {module} is new"
    return ""


def _project(folder: Path) -> Path:
    """Where the project file of a package in this folder would be: it is there in a checkout."""
    return folder.parent / "pyproject.toml"


def modules(places: dict[str, Path]) -> Iterator[tuple[str, str]]:
    """Every module of the packages in these folders: its full name, its file."""
    for name, folder in places.items():
        skipped = len(str(folder))
        for source in sorted(_sources(str(folder)), key=lambda path: path.split("/")):
            yield name + source[skipped:-3].replace("/", "."), source


def _sources(folder: str) -> Iterator[str]:
    """The files of modules in it and below. Asked at each start of a process in a checkout: pathlib takes ten times as long."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".py") and entry.name != "__init__.py":
                yield f"{folder}/{entry.name}"
            elif entry.is_dir(follow_symlinks=False) and entry.name != "__pycache__":
                yield from _sources(f"{folder}/{entry.name}")


def exporting(places: dict[str, Path], known: Container[str] = ()) -> Iterator[str]:
    """Those of them that export something, but for those that are known."""
    for module, source in modules(places):
        if module not in known and not module.startswith("stage.native."):
            with open(source, "rb") as file:
                if b"\n@exported(" in file.read():
                    yield module


def _manifest(content: bytes) -> dict[str, Any] | None:
    """What a library says about itself; None if it is none."""
    begin = content.find(MARK) + len(MARK)
    end = content.find(b"\0", begin)
    if begin < len(MARK) or end < 0:
        return None
    try:
        said = dict(json.loads(content[begin:end]))
    except ValueError:
        return None
    return said if said.keys() == FIELDS else None


def digest_within(content: bytes, written: str) -> str:
    """The digest of a library that has this one written in it."""
    return hashlib.sha256(content.replace(written.encode(), NO_DIGEST.encode(), 1)).hexdigest()


def manifest_of(path: Path) -> dict[str, Any] | None:
    """What a library says about itself: target, needs, numba, sources; None where there is none."""
    return _manifest(path.read_bytes()) if path.is_file() else None


def digest_of_sources() -> str:
    """Digest of the sources that PulseStage's library was compiled from; "none" without a library, "run as Python" uncompiled."""
    from stage.native.mode import COMPILED

    if not COMPILED:
        return "run as Python"
    manifest = manifest_of(_root("stage") / NAME)
    sources = json.dumps(manifest["sources"], sort_keys=True).encode() if manifest else b""
    return hashlib.blake2b(sources, digest_size=8).hexdigest() if manifest else "none"


def advice(package: str) -> str:
    """How to get a library."""
    if package == "stage":
        return "Install PulseStage again (pip install --force-reinstall --no-deps pulsestage; in a checkout: pip install -e .)."
    return f"Build it: pip install 'pulsestage[build]', then python -m stage.native {package}"


def target() -> str:
    """System and processor, as a library names them."""
    return f"{sys.platform}-{platform.machine()}"


@cache
def features() -> frozenset[str]:
    """What the processor can, in Linux' words, where they are known; a library that needs none fits everywhere."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return frozenset(BASELINES.get(platform.machine(), ("", ()))[1])
    return frozenset(next((line.partition(":")[2].split() for line in lines if line.startswith("flags")), []))


BASELINES = {
    "x86_64": ("x86-64-v2", ("cx16", "popcnt", "sse4_1", "sse4_2", "ssse3")),
    "AMD64": ("x86-64-v2", ()),
}
"""Of a machine: the processor that LLVM makes code for, and what /proc/cpuinfo calls that; elsewhere the generic one."""


def _root(package: str) -> Path:
    """The folder of a package. Raises NativeError where there is none."""
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise NativeError(f"package {package!r} cannot be found: compiled functions live in packages.")
    return Path(next(iter(spec.submodule_search_locations))).resolve()


def folders(package: str) -> dict[str, Path]:
    """A package's name, and those of its subpackages that lie elsewhere in a checkout -> folder."""
    root = _root(package)
    found, project = {package: root}, _project(root)
    if project.is_file():
        import tomllib  # for a checkout only

        settings = tomllib.loads(project.read_text(encoding="utf-8")).get("tool", {}).get("setuptools", {})
        for name, folder in settings.get("package-dir", {}).items():
            if name.startswith(f"{package}."):
                found[name] = root.parent / folder
    return found


def source_of(module: str, places: dict[str, Path]) -> str:
    """Where the file of a module of a package is, if it is there at all; the package's folders are these."""
    name = max((name for name in places if module.startswith(f"{name}.")), key=len)
    return f"{places[name]}/{module[len(name) + 1 :].replace('.', '/')}.py"


def digest_of(source: str | Path) -> str:
    """Of a source file. Raises OSError. Asked for each module at each start of a process: pathlib would take half of the time."""
    with open(source, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()[:16]
