"""Where compiled code is kept on disk, and what is loaded from there.

numba looks only at the file of the function itself to tell whether its cache is fresh, but our loops are made of functions of
many files, and of the constants of register maps. So the cache folder carries a hash of them all: a change in any compiles anew.
A function of somebody else's has a folder for the state of the sources that it imports.

What is loaded runs. So it is loaded only from a folder that is this user's alone, and only as it was written: each file ends with
its digest. Where nothing can be kept, or is damaged, the code is compiled again.
"""

from __future__ import annotations

import ast
import atexit
import hashlib
import os
import pickle
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

numba: Any = import_module("numba")  # its settings have no types
_caching: Any = import_module("numba.core.caching")

KEPT_CACHES = 4
KEPT_DAYS = 30  # of somebody else's functions
SYMBOL = re.compile(rb"pulsestage [^\0]+")  # of sealed functions, in machine code
symbols: dict[str, Callable[[], Any]] = {}
"""Symbol of a sealed function -> what makes it known to machine code that refers to it."""

_user = os.getuid() if hasattr(os, "getuid") else None


# --- the folder ---


@cache
def cache_folder() -> Path:
    """Where compiled code is kept, by the state of our sources: in $NUMBA_CACHE_DIR or the user's cache folder; else in one of this
    user's for temporary files; else in a fresh one, which goes when the process ends."""
    name = _digest(sorted(path for folder in _own_folders() for path in folder.rglob("*.py")), _matters)
    for base in (_chosen(), Path(tempfile.gettempdir()).resolve() / f"pulsestage-{_user}"):
        with suppress(OSError):
            if base is not None and _is_ours(base) and _is_ours(base / name):
                os.utime(base / name)
                _keep_last(base, KEPT_CACHES)
                return base / name
    said = "NUMBA_CACHE_DIR=FOLDER, a folder that is yours alone, keeps it."
    try:
        fresh = Path(tempfile.mkdtemp(prefix="pulsestage-"))
    except OSError:
        fresh = Path(os.devnull, name)
    atexit.register(shutil.rmtree, fresh, ignore_errors=True)
    print(f"PulseStage: compiled code is not kept for the next start. {said}", file=sys.stderr, flush=True)
    return fresh


def _chosen() -> Path | None:
    if given := os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME"):
        return Path(given).resolve() / "pulsestage"
    with suppress(RuntimeError):  # without a home
        return (Path.home() / ".cache").resolve() / "pulsestage"
    return None


def _is_ours(folder: Path) -> bool:
    """A folder, made if there is none, that this user alone may write to and that nobody else can replace."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if _user is None:
        return folder.is_dir()
    said = folder.lstat()
    if (
        stat.S_ISDIR(said.st_mode) and said.st_uid == _user and said.st_mode & 0o022
    ):  # others could write: not to be trusted
        shutil.rmtree(folder)
        folder.mkdir(mode=0o700)
        said = folder.lstat()
    trusted = {_user, 0, Path("/").stat().st_uid}
    way = [parent.lstat() for parent in folder.parents]
    return (
        stat.S_ISDIR(said.st_mode)
        and (said.st_uid, said.st_mode & 0o022) == (_user, 0)
        and all(stat.S_ISDIR(p.st_mode) and p.st_uid in trusted for p in way)
        and all(p.st_mode & stat.S_ISVTX or not p.st_mode & 0o002 for p in way)
    )


def _keep_last(base: Path, n: int) -> None:
    """Remove all but the `n` folders that were used last; others may be doing the same."""

    def used(folder: Path) -> float:
        with suppress(OSError):
            return folder.stat().st_mtime
        return 0.0

    for old in sorted(base.iterdir(), key=used)[:-n]:
        shutil.rmtree(old, ignore_errors=True)


# --- the state of sources ---


@cache
def _own_folders() -> tuple[Path, ...]:
    environments = find_spec("stage.envs")  # a folder of its own in a source tree
    found = [Path(__file__).parent, *((environments and environments.submodule_search_locations) or ())]
    return tuple(Path(folder).resolve() for folder in found)


def _matters(source: Path, text: bytes) -> bool:
    return b"@hot" in text or b"@sealed" in text or "chips" in source.parts or "drives" in source.parts


def _digest(sources: list[Path], matters: Callable[[Path, bytes], bool] = lambda *_: True) -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sources:
        text = source.read_bytes()
        if matters(source, text):
            digest.update(source.name.encode() + text)
    return digest.hexdigest()[:16]


@cache
def folder_of(source: str) -> Path | None:
    """Where code of a function of that source file is kept; None if nowhere, since nobody could tell whether it is fresh."""
    file, kept = Path(source).resolve(), cache_folder()
    if not (file.is_file() and kept.is_dir()):
        return None
    if any(file.is_relative_to(folder) for folder in _own_folders()):
        return kept
    others = kept / "others"
    folder = others / _digest(sorted(_imported(file)))
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for old in others.iterdir():
            if time.time() - old.stat().st_mtime > 86400 * KEPT_DAYS:
                shutil.rmtree(old, ignore_errors=True)
    return folder


def _imported(file: Path) -> set[Path]:
    """The source file and those that it imports, and so on: of its package, or, without one, of its folder."""
    top = file
    while (top.parent / "__init__.py").is_file():
        top = top.parent
    root = top.parent
    found, left = set(), [file]
    while left:
        source = left.pop().resolve()
        if source in found or not source.is_file() or any(source.is_relative_to(folder) for folder in _own_folders()):
            continue
        found.add(source)
        left += [folder / "__init__.py" for folder in source.parents if folder.is_relative_to(root) and folder != root]
        with suppress(SyntaxError, ValueError):
            for path in _imports(ast.parse(source.read_bytes()), source.parent, root):
                if path.is_relative_to(top) or (top == file and root.name not in ("site-packages", "dist-packages")):
                    left += [path / "__init__.py", path.with_name(f"{path.name}.py")]
    return found


def _imports(tree: ast.AST, here: Path, root: Path) -> Iterator[Path]:
    """What is imported, as a path without suffix."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (root.joinpath(*name.name.split(".")) for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            begin = here.joinpath(*[".."] * (node.level - 1)).resolve() if node.level else root
            module = begin.joinpath(*(node.module or "").split("."))
            yield module
            yield from (module / name.name for name in node.names if name.name != "*")


# --- files ---


def sealed_with_digest(data: bytes) -> bytes:
    """What `intact` finds as it was."""
    return data + hashlib.sha256(data).digest()


def intact(kept: bytes) -> bytes | None:
    """What was given to `sealed_with_digest`; None if it was cut off or changed."""
    data, digest = kept[:-32], kept[-32:]
    return data if hashlib.sha256(data).digest() == digest else None


def make_known(machine_code: bytes) -> bool:
    """Before this machine code is loaded: the sealed functions that it refers to are there. False if there is no such."""
    names = {name.decode(errors="replace") for name in SYMBOL.findall(machine_code)}
    if not names <= symbols.keys():
        return False
    for name in names:
        symbols[name]()
    return True


class _Checked(_caching.IndexDataCacheFile):
    """numba's files of one function, each with its digest at the end, which numba does not look at."""

    def save(self, key: Any, data: Any) -> None:
        with suppress(OSError):  # a disk that is full
            super().save(key, data)

    def load(self, key: Any) -> Any:
        try:
            return super().load(key)
        except Exception:  # what unpickling a file says that fits nothing any more
            return None

    def _dump(self, obj: Any) -> bytes:
        return sealed_with_digest(super()._dump(obj))

    def _load_index(self) -> dict:
        with suppress(Exception), open(self._index_path, "rb") as file:
            pickle.load(file)  # numba's version
            if intact(file.read()) is not None:
                return super()._load_index()
        return {}

    def _load_data(self, name: str) -> Any:
        with open(self._data_path(name), "rb") as file:
            data = intact(file.read())
        if data is None:
            return None
        made = pickle.loads(data)
        _, _, (machine_code, _) = made[0]
        return made if make_known(machine_code) else None


@contextmanager
def kept(function: Callable) -> Iterator[bool]:
    """numba keeps what is decorated here in our folder. False: in none."""
    before = numba.config.CACHE_DIR, _caching.IndexDataCacheFile
    folder = folder_of(function.__code__.co_filename)
    if folder is not None:
        numba.config.CACHE_DIR, _caching.IndexDataCacheFile = str(folder), _Checked
    try:
        yield folder is not None
    finally:
        numba.config.CACHE_DIR, _caching.IndexDataCacheFile = before
