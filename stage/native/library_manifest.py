"""Manifests of native libraries: what a library was built from, and whether it fits the sources and this machine."""

from __future__ import annotations

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
from stage.support.extras import format_install_command

NAME = "_native.so"
MARK = b"\0PULSESTAGE NATIVE LIBRARY "
"""Bytes in a library that precede its manifest, which is JSON and ends with a zero byte."""
FIELDS = {"digest", "target", "needs", "numba", "sources"}
"""Names of the entries of a manifest."""
NO_DIGEST = "0" * 64
"""Placeholder in a manifest for the digest of the file; it stays if the file may not be changed after the link."""


def explain_library_misfit(package: str, path: Path) -> str:
    """Explain why a library does not match the sources of a package or this machine; "" if it matches.

    Args:
        package: Name of the package.
        path: Path of the library.
    """
    try:
        content = path.read_bytes()
    except OSError:
        return f"package {package!r} has no native library in {path.parent}"
    manifest = _parse_manifest(content)
    if manifest is None or manifest["digest"] not in (NO_DIGEST, digest_content(content, manifest["digest"])):
        return f"{path} is damaged"
    if manifest["target"] != describe_target():
        return f"{path} was built for {manifest['target']}, this is {describe_target()}"
    if lacking := [f for f in manifest["needs"] if f not in read_features()]:
        return f"{path} needs a processor with {', '.join(lacking)}, which this one has not"
    return _find_changed_source(package, path, manifest["sources"])


def _find_changed_source(package: str, path: Path, sources: dict[str, str]) -> str:
    """Return the name of a module that is new, or has changed since the library was built; "" if there is none.

    Args:
        package: Name of the package.
        path: Path of the library.
        sources: Module -> digest of its file when the library was built.
    """
    package_folders = {root: find_package_folders(root) for root in {module.partition(".")[0] for module in sources}}
    for module, digest in sources.items():
        try:
            same = digest_file(find_source(module, package_folders[module.partition(".")[0]])) == digest
        except OSError:
            same = False
        if not same and package != "stage" and module.startswith("stage."):
            return f"{path} was built with another version of PulseStage: {module} is not as it was there"
        if not same:
            return f"{path} was built from other sources: {module} has changed"
    own_folders = package_folders.get(package) or find_package_folders(package)
    # a wheel has its modules for good
    if package != "stage" or _find_project_file(own_folders[package]).is_file():
        for module in find_exporting_modules(own_folders, sources):
            return f"{path} was built from other sources: {module} is new"
    return ""


def _find_project_file(folder: Path) -> Path:
    """Return the path of a package's project file, which exists in a checkout."""
    return folder.parent / "pyproject.toml"


def list_modules(package_folders: dict[str, Path]) -> Iterator[tuple[str, str]]:
    """Yield the full name and the file of every module.

    Args:
        package_folders: Package -> folder.
    """
    for name, folder in package_folders.items():
        skipped = len(str(folder))
        for source in sorted(_list_sources(str(folder)), key=lambda path: path.split("/")):
            yield name + source[skipped:-3].replace("/", "."), source


def _list_sources(folder: str) -> Iterator[str]:
    """Yield the files of modules in a folder and below it. Each start in a checkout does this; pathlib is ten times slower."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".py") and entry.name != "__init__.py":
                yield f"{folder}/{entry.name}"
            elif entry.is_dir(follow_symlinks=False) and entry.name != "__pycache__":
                yield from _list_sources(f"{folder}/{entry.name}")


def find_exporting_modules(package_folders: dict[str, Path], known: Container[str] = ()) -> Iterator[str]:
    """Yield the modules that export functions.

    Args:
        package_folders: Package -> folder.
        known: Modules to leave out.
    """
    for module, source in list_modules(package_folders):
        if module not in known and not module.startswith("stage.native."):
            with open(source, "rb") as file:
                if b"\n@exported(" in file.read():
                    yield module


def _parse_manifest(content: bytes) -> dict[str, Any] | None:
    """Return the manifest of a library; None if it has none."""
    begin = content.find(MARK) + len(MARK)
    end = content.find(b"\0", begin)
    if begin < len(MARK) or end < 0:
        return None
    try:
        manifest = dict(json.loads(content[begin:end]))
    except ValueError:
        return None
    return manifest if manifest.keys() == FIELDS else None


def digest_content(content: bytes, stored_digest: str) -> str:
    """Compute the digest of a library that contains the digest `stored_digest`, which does not count."""
    return hashlib.sha256(content.replace(stored_digest.encode(), NO_DIGEST.encode(), 1)).hexdigest()


def read_manifest(path: Path) -> dict[str, Any] | None:
    """Read the manifest of a library, with the entries target, needs, numba and sources; None if there is no library."""
    return _parse_manifest(path.read_bytes()) if path.is_file() else None


def compute_source_digest() -> str:
    """Return the digest of the sources of PulseStage's library; "none" without a library, "run as Python" in that mode."""
    from stage.native.compile_mode import COMPILED

    if not COMPILED:
        return "run as Python"
    manifest = read_manifest(find_library("stage"))
    sources = json.dumps(manifest["sources"], sort_keys=True).encode() if manifest else b""
    return hashlib.blake2b(sources, digest_size=8).hexdigest() if manifest else "none"


def advise_install(package: str) -> str:
    """Return the advice how to install the library of a package, for an error."""
    if package == "stage":
        return "Install PulseStage again: pip install -e . in a checkout, or pip install --force-reinstall --no-deps and its wheel."
    return f"Build it: {format_install_command('build')}, then python -m stage.native {package}"


def describe_target() -> str:
    """Return the names of operating system and processor, as in the manifest of a library."""
    return f"{sys.platform}-{platform.machine()}"


@cache
def read_features() -> frozenset[str]:
    """Return the features of the processor by the names of Linux; if they are unknown, the features that a library needs."""
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


def find_library(package: str) -> Path:
    """Return the path at which the library of a package is expected. Raises NativeError if there is no such package."""
    return _find_root(package) / NAME


def _find_root(package: str) -> Path:
    """Return the folder of a package.

    Raises:
        NativeError: There is no such package.
    """
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise NativeError(f"package {package!r} cannot be found: compiled functions live in packages.")
    return Path(next(iter(spec.submodule_search_locations))).resolve()


def find_package_folders(package: str) -> dict[str, Path]:
    """Return the folder of a package by its name, and the folders of subpackages that are elsewhere in a checkout."""
    root = _find_root(package)
    folders, project = {package: root}, _find_project_file(root)
    if project.is_file():
        import tomllib  # for a checkout only

        settings = tomllib.loads(project.read_text(encoding="utf-8")).get("tool", {}).get("setuptools", {})
        for name, folder in settings.get("package-dir", {}).items():
            if name.startswith(f"{package}."):
                folders[name] = root.parent / folder
    return folders


def find_source(module: str, package_folders: dict[str, Path]) -> str:
    """Return the path at which the file of a module is expected.

    Args:
        module: Full name of the module.
        package_folders: Folders of its package, as `find_package_folders` returns them.
    """
    name = max((name for name in package_folders if module.startswith(f"{name}.")), key=len)
    return f"{package_folders[name]}/{module[len(name) + 1 :].replace('.', '/')}.py"


def digest_file(source: str | Path) -> str:
    """Compute the digest of a source file. Each start of a process does this for every module, so it does not use pathlib.

    Raises:
        OSError: The file cannot be read.
    """
    with open(source, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()[:16]
