"""Promises of `stage.cache`: what is kept, where, and what is loaded again."""

import errno
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from stage import cache
from stage.compiled import COMPILED, hot

compiled_only = pytest.mark.skipif(not COMPILED, reason="this Python runs hot functions uncompiled")
posix_only = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owners here")


# --- the folder ---


@pytest.fixture
def chosen(tmp_path, monkeypatch):
    """The folder that would be chosen, in which no test has looked yet, and what chooses; both temporary folders are empty."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / "cache" / "pulsestage", cache.cache_folder.__wrapped__


def test_the_folder_is_made_for_this_user_alone_and_found_again(chosen):
    folder, choose = chosen
    assert choose().parent == folder
    assert choose() == choose()
    if hasattr(os, "getuid"):
        assert (folder.stat().st_mode & 0o777, choose().stat().st_mode & 0o777) == (0o700, 0o700)


@posix_only
@pytest.mark.parametrize("planted", ["other's", "link", "writable parent"])
def test_a_folder_that_somebody_else_made_or_could_replace_is_not_loaded_from(chosen, planted, monkeypatch, capsys):
    # mkdir /tmp/pulsestage-0; then, as root without a home: stage demo
    folder, choose = chosen
    name = choose().name
    for place in (
        folder,
        folder.parent.parent / f"pulsestage-{cache._user}",
    ):  # the one chosen, and the one for want of it
        shutil.rmtree(place, ignore_errors=True)
        if planted == "link":
            (elsewhere := place.with_name(f"{place.name} elsewhere")).mkdir(mode=0o700)
            place.symlink_to(elsewhere)
        else:
            (place / name).mkdir(parents=True, mode=0o700)
    if planted == "other's":
        monkeypatch.setattr(cache, "_user", cache._user + 1)
    elif planted == "writable parent":
        folder.parent.parent.chmod(0o777)
    fresh = choose()
    assert fresh.parent == folder.parent.parent
    assert fresh.name not in (folder.name, f"pulsestage-{cache._user}")
    assert (fresh.stat().st_mode & 0o777, list(fresh.iterdir())) == (0o700, [])
    assert "NUMBA_CACHE_DIR" in capsys.readouterr().err
    shutil.rmtree(fresh)


@posix_only
def test_a_folder_of_ours_that_others_could_write_to_is_emptied(chosen):
    _, choose = chosen
    kept = choose()
    (kept / "planted.code").write_text("by whom?")
    kept.chmod(0o777)
    assert choose() == kept
    assert (list(kept.iterdir()), kept.stat().st_mode & 0o777) == ([], 0o700)


@posix_only
def test_without_a_home_it_is_a_folder_of_this_user_alone_among_the_temporary_ones(chosen, monkeypatch, tmp_path):
    # env -u HOME stage demo, of a user without an entry in /etc/passwd
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)

    def nowhere():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", nowhere)
    assert chosen[1]().parent == tmp_path / f"pulsestage-{os.getuid()}"


def test_a_temporary_folder_that_cannot_be_made_either_is_no_error(chosen, monkeypatch, tmp_path):
    chosen[0].parent.write_text("no folder")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "cache" / "temporary"))
    assert not chosen[1]().is_dir()


def test_an_old_folder_that_another_process_removes_meanwhile_is_no_error(chosen, monkeypatch):
    # several versions start at once: one lists the old folders, the other removes them
    folder, choose = chosen
    for n in range(6):
        (folder / f"version {n}").mkdir(parents=True, mode=0o700)
        os.utime(folder / f"version {n}", (n, n))
    folder.chmod(0o700)
    listed = Path.iterdir

    def and_gone(self):
        found = list(listed(self))
        shutil.rmtree(folder / "version 5", ignore_errors=True)
        return iter(found)

    monkeypatch.setattr(Path, "iterdir", and_gone)
    assert choose().is_dir()
    monkeypatch.undo()
    assert len(list(folder.iterdir())) <= cache.KEPT_CACHES
    assert not (folder / "version 0").exists()


# --- files ---

TRIPLE = """
from mine.maps import FACTOR

def triple(n):
    return FACTOR * n
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package from outside. Imports its core anew and compiles `triple`, or loads it; returns (its dispatcher, triple(5))."""
    mine = tmp_path / "mine"
    mine.mkdir()
    for name, text in (
        ("__init__", ""),
        ("core", TRIPLE),
        ("maps", "from .more import FACTOR"),
        ("more", "FACTOR = 3"),
    ):
        (mine / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path / "kept")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "kept").mkdir()

    def again():
        cache.folder_of.cache_clear()
        for name in [name for name in sys.modules if name.partition(".")[0] == "mine"]:
            del sys.modules[name]
        importlib.invalidate_caches()
        compiled = hot(importlib.import_module("mine.core").triple)
        return compiled, compiled(5)

    yield again
    cache.folder_of.cache_clear()


def came_from_cache(compiled) -> bool:
    return sum(compiled.stats.cache_hits.values()) == 1


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.suffix in (".nbi", ".nbc")]


@compiled_only
def test_code_is_kept_and_a_file_cut_off_or_changed_is_written_anew(package, tmp_path):
    # truncate -s -100 ~/.cache/pulsestage/*/*/*.nbi, and one byte of a .nbc is another; stage demo
    assert package()[1] == 15
    assert came_from_cache(package()[0])
    damages = (
        lambda data: data[:-100],
        lambda data: data[:200] + bytes([data[200] ^ 4]) + data[201:],
        lambda data: b"",
    )
    for damaged in damages:
        for suffix in (".nbi", ".nbc"):
            (file,) = (file for file in files(tmp_path / "kept") if file.suffix == suffix)
            file.write_bytes(damaged(file.read_bytes()))
            compiled, value = package()
            assert (value, came_from_cache(compiled)) == (15, False)
            assert came_from_cache(package()[0])


@compiled_only
def test_a_full_disk_is_no_error(package, tmp_path, monkeypatch):
    # stage demo, the cache on a disk that is full
    def full(self, *_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(cache._caching.IndexDataCacheFile, "_save_data", full)
    assert package()[1] == 15
    monkeypatch.undo()
    assert files(tmp_path / "kept")[0].suffix == ".nbi", "and nothing else"


def test_an_edit_in_a_file_that_a_core_from_outside_imports_runs_no_stale_code(package, tmp_path):
    # sed -i s/3/4/ mine/more.py, which mine/maps.py imports, which mine/core.py imports
    assert package()[1] == 15
    (tmp_path / "mine" / "more.py").write_text("FACTOR = 4")
    assert package()[1] == 20
    (tmp_path / "mine" / "more.py").write_text("FACTOR = 3")
    compiled, value = package()
    assert value == 15
    assert not COMPILED or came_from_cache(compiled)


def test_what_a_lone_module_imports_from_its_folder_counts_and_nothing_else(tmp_path):
    for name, text in (("a", "import b, json\nfrom stage import Stage"), ("b", "import c.d"), ("other", "")):
        (tmp_path / f"{name}.py").write_text(text)
    (tmp_path / "c").mkdir()
    for name in ("__init__", "d", "e"):
        (tmp_path / "c" / f"{name}.py").touch()
    found = cache._imported(tmp_path / "a.py")
    assert sorted(str(path.relative_to(tmp_path)) for path in found) == ["a.py", "b.py", "c/__init__.py", "c/d.py"]


def test_a_function_without_a_file_is_compiled_and_not_kept():
    space = {}
    exec("def f(n):\n    return n + 1", space)
    assert hot(space["f"])(1) == 2


# --- before `ready` ---

PROGRAM = """
import sys

import numpy as np

from stage.compiled import announced, hot, record
from stage.sealed import sealed

CELL = record([("a", "i8"), ("b", "f8")])


@sealed("f8", CELL, "i8")
def scaled(c, n):
    c.a += n
    return c.b * n


@sealed("f8", CELL)
def twice(c):
    return scaled(c, 1) + scaled(c, 2)


@hot
def loop(rows):
    return twice(rows[0]) + scaled(rows[0], 3)


rows = np.zeros(1, CELL)
rows["b"] = 0.5
with announced("compiling the loop", after=0.0):
    print(loop(rows) if sys.argv[1:] == ["loop"] else twice(rows[0]), rows["a"][0])
"""


@compiled_only
def test_code_from_the_cache_that_is_called_before_ready_runs_and_compiling_is_said_only_where_it_is_done(tmp_path):
    # python program.py; python program.py
    (tmp_path / "program.py").write_text(PROGRAM)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    said = []
    for function in ("loop", "loop", "twice"):
        command = [sys.executable, str(tmp_path / "program.py"), function]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        said.append((done.stdout.split(), done.stderr))
    assert said == [(["3.0", "6"], "compiling the loop\n"), (["3.0", "6"], ""), (["1.5", "3"], "")]
