"""The copy of a library is on disk while it runs, where a debugger finds its symbols, and is gone afterwards however it ends."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, HostError, NativeHost, temporary_folders

pytestmark = pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="no /proc here")
DELAY_SOURCE = "PULSESTAGE_MAIN { ps_in8(0x300); ps_delay_us(1000000); return 0; }"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder for temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def of_runs(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"{temporary_folders.PREFIX}*"))


def mapped(pid: int | str, name: str) -> set[Path]:
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {Path(line.split(maxsplit=5)[5]) for line in lines if line.endswith(name)}


@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
def test_the_loaded_copy_exists_until_the_host_is_closed(isolated, folder):
    library = firmware(DELAY_SOURCE)
    with NativeHost(library, Board(Stage("xy", visuals=False)), isolated=isolated) as host:
        assert host.run_for(0.1) is None
        pid = host._runner._child.pid if isolated else "self"
        copies = {path for path in mapped(pid, library.name) if folder in path.parents}
        assert len(copies) == 1
        assert copies.pop().read_bytes() == library.read_bytes()
        assert host.run().code == 0
    assert of_runs(folder) == []


def test_a_crash_leaves_no_file(folder):
    library = firmware("PULSESTAGE_MAIN { return *(volatile int *)(uintptr_t)ps_in8(0x300); }")
    host = NativeHost(library, Board(Stage("xy", visuals=False)), isolated=True)
    with pytest.raises(HostError):
        host.run()
    assert of_runs(folder) == []


def test_a_library_built_from_sources_is_removed_with_its_host(folder, tmp_path_factory):
    source = tmp_path_factory.mktemp("source") / "it.c"
    source.write_text("#include <pulsestage.h>\nPULSESTAGE_MAIN { return 3; }\n")
    host = NativeHost(source, Board(Stage("xy", visuals=False)))
    assert host.run().code == 3
    assert [path.name for run in of_runs(folder) for path in run.glob("*.so")] == ["it.so"]
    del host
    gc.collect()
    assert of_runs(folder) == []


PROGRAM = """
import sys
from stage import Stage
from stage.board import Board, NativeHost
host = NativeHost(sys.argv[1], Board(Stage("xy", visuals=False)), isolated=sys.argv[2] == "isolated", patience=1e6)
host.run_for(0.1)
print("stands", flush=True)
if sys.argv[3] == "ends":
    sys.exit()
sys.stdin.read()
"""


@pytest.mark.slow
@pytest.mark.parametrize("isolated", ["isolated", "here"])
@pytest.mark.parametrize("end", ["ends", signal.SIGKILL, signal.SIGTERM], ids=str)
def test_no_file_stays_when_the_program_ends_or_is_killed(isolated, end, tmp_path):
    program, temporary = tmp_path / "program.py", tmp_path / "tmp"
    program.write_text(textwrap.dedent(PROGRAM))
    temporary.mkdir()
    arguments = [sys.executable, str(program), str(firmware(DELAY_SOURCE)), isolated, str(end)]
    environment = os.environ | {"TMPDIR": str(temporary)}
    with subprocess.Popen(
        arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, text=True
    ) as running:
        assert running.stdout.readline() == "stands\n"
        assert end == "ends" or of_runs(temporary)
        if end != "ends":
            running.send_signal(end)
        running.wait()
    until = time.monotonic() + 10
    while of_runs(temporary) and time.monotonic() < until and isolated == "isolated":
        time.sleep(0.05)
    if of_runs(temporary):  # nobody was left to remove it: the next run does
        assert (isolated, end == "ends") == ("here", False)
        subprocess.run([*arguments[:-1], "ends"], env=environment, check=True, stdout=subprocess.DEVNULL)
    assert of_runs(temporary) == []


def test_a_folder_in_use_is_not_swept(folder, monkeypatch):
    used, left = temporary_folders.TemporaryFolder(), temporary_folders.TemporaryFolder()
    copy = folder / f"{temporary_folders.PREFIX}left"
    shutil.copytree(left.path, copy)  # the lock is that of the other file
    left.close()
    temporary_folders.remove_stale_folders.cache_clear()
    temporary_folders.TemporaryFolder().close()
    assert of_runs(folder) == [used.path]
    used.close()
