"""What a file is by its first bytes, in words: for which machine it was built, what kind it is, and what to do with it."""

from __future__ import annotations

import platform
import struct

import pytest

from stage.board import LibraryError, library
from stage.files import FileError

pytestmark = pytest.mark.skipif(platform.system() != "Linux", reason="of ELF")
OURS = {"x86-64": 62, "aarch64": 183}.get(library._OURS.get(platform.machine(), platform.machine()), 0)
SHARED = 3


def elf(kind, machine, order="<"):
    return b"\x7fELF" + bytes([1, 1 if order == "<" else 2]) + bytes(10) + struct.pack(f"{order}HH", kind, machine)


@pytest.mark.parametrize(
    ("head", "said", "instead"),
    [
        (elf(SHARED, 20, ">"), "built for PowerPC, and", ""), (elf(SHARED, 8, ">"), "built for MIPS, and", ""),
        (elf(SHARED, 40), "built for ARM (32 bit), and", "--mcu cortex-m3 (docs/targets.md)."),
        (elf(SHARED, 83), "built for AVR, and", "--mcu atmega2560 (docs/targets.md)."),
        (elf(SHARED, 3), "built for x86 (32 bit), and", ""), (elf(SHARED, 243), "built for RISC-V, and", ""),
        (elf(SHARED, 999), "built for machine 999, and", ""),
    ],
)  # fmt: skip
def test_a_library_of_another_machine_says_of_which_and_where_it_can_run(tmp_path, head, said, instead):
    file = tmp_path / "x.so"
    file.write_bytes(head)
    with pytest.raises(LibraryError) as refused:
        library.check(file)
    assert said in str(refused.value)
    assert ("Or run it as it is, on an emulated processor" in str(refused.value)) == bool(instead)
    assert str(refused.value).endswith(instead)


@pytest.mark.parametrize(
    ("kind", "said"),
    [(1, "is an object file, not"), (2, "is a program, not"), (4, "is a core dump, not"), (9, "is no library, not")],
)
@pytest.mark.skipif(not OURS, reason="of the usual machines")
def test_what_is_no_library_says_what_it_is(tmp_path, kind, said):
    file = tmp_path / "x.so"
    file.write_bytes(elf(kind, OURS))
    with pytest.raises(LibraryError, match=said):
        library.check(file)
    file.write_bytes(elf(SHARED, OURS))
    assert library.check(str(file)) == file
    file.write_bytes(elf(SHARED, OURS)[:19])
    with pytest.raises(LibraryError, match="is no shared library of this machine"):
        library.check(file)
    with pytest.raises(FileError, match=r"is a folder\. Name a library"):
        library.check(tmp_path)


@pytest.mark.parametrize(
    ("name", "system", "command"),
    [
        ("a/driver.so", "Linux", 'cc -shared -fPIC -I"$(stage include)" driver.c -o driver.so'),
        ("driver.c", "Darwin", 'cc -shared -fPIC -I"$(stage include)" driver.c -o driver.dylib'),
        ("driver.c", "Windows", 'cc -shared -fPIC -I"$(stage include)" driver.c -o driver.dll'),
        ("a/driver.rs", "Linux", "rustc --edition 2024 --crate-type cdylib a/driver.rs -o driver.so"),
        ("a/driver.zig", "Linux", "zig build-lib -dynamic -O ReleaseSafe a/driver.zig"),
    ],
)
def test_how_to_build_is_said_for_each_language_and_system(monkeypatch, name, system, command):
    monkeypatch.setattr(platform, "system", lambda: system)
    assert library.how_to_build(name) == command


def test_the_compiler_is_that_of_the_environment_and_else_the_first_that_is_there(monkeypatch):
    """CC="own -O1", which is there; one that is not; c++ of several; none"""
    there = {"own", "gcc", "clang++"}
    monkeypatch.setattr(library.shutil, "which", lambda name: name if name in there else None)
    monkeypatch.setenv("CC", "own -O1"), monkeypatch.setenv("CXX", "lost")
    assert library.compiler("x.c") == "own -O1"
    assert library.compiler("x.cpp") == "clang++"
    monkeypatch.setenv("CC", "lost")
    assert library.compiler() == "gcc"
    there.clear()
    with pytest.raises(
        library.NoCompilerError, match=r"for x\.cc: none of c\+\+, g\+\+, clang\+\+ is on the PATH, and \$CXX is not"
    ):
        library.compiler("x.cc")


def test_sanitizers_of_a_library_are_named_each_once(tmp_path):
    file = tmp_path / "x.so"
    file.write_bytes(b"\0libubsan.so.1\0libasan.so.8\0libasan.so.8\0libtsan.so\0libmsan.so.1\0")
    assert library.sanitizers(file) == ["libasan.so.8", "libtsan.so", "libubsan.so.1"]
    assert library.sanitizers(tmp_path / "none") == []


def test_sources_are_known_by_their_ends_and_one_library_is_enough(tmp_path):
    assert library.are_sources(["a.c", "b.cpp", "s.ino"])
    assert not library.are_sources(["a.c", "b.so"])
    with pytest.raises(library.ArgumentError, match=r"a\.so, b\.so: give one library, or sources only"):
        library.ready(["a.so", "b.so"])
    with pytest.raises(
        library.ArgumentError, match=r"platform='dos': it says how sources are built, and a\.so is built"
    ):
        library.ready("a.so", platform="dos")
    with pytest.raises(library.ArgumentError, match="nothing to build"):
        library.build([])
