"""A library that is none says what was looked for, and how to build it."""

from __future__ import annotations

import platform
import shutil
import struct
import subprocess

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import (
    Board,
    CompileError,
    LibraryError,
    NativeHost,
    NoCompilerError,
    build,
    firmware_library,
    get_include_folder,
)
from stage.board.firmware_library import check_library, format_build_command
from stage.errors import ArgumentError
from stage.support.files import FileError

STRICT = ("-std=c99", "-pedantic", "-Werror")
BUILD = r'cc -shared -fPIC -I"\$\(stage include\)"'


@pytest.fixture(scope="module")
def board():
    return Board(Stage("xyz", visuals=False))


def reference(tmp_path, text: str, *flags: str, name: str = "plain.so"):
    """A library built without the header."""
    firmware("PULSESTAGE_MAIN { return 0; }")  # skips without a compiler
    source, built = tmp_path / "plain.c", tmp_path / name
    source.write_text(text)
    subprocess.run(["cc", *(flags or ("-shared", "-fPIC")), str(source), "-o", str(built)], check=True)
    return built


@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
def test_a_library_without_the_entry_point_says_what_was_looked_for(board, isolated):
    without = firmware("int something_else(void) { return ps_in8(1); }")
    with pytest.raises(LibraryError, match=f"pulsestage_main.*PULSESTAGE_MAIN.*{BUILD}"):
        NativeHost(without, board, isolated=isolated)


def test_a_library_built_without_the_header_is_refused(board, tmp_path):
    with pytest.raises(LibraryError, match=f"pulsestage_abi.*include <pulsestage.h>.*{BUILD}"):
        NativeHost(reference(tmp_path, "double pulsestage_main(double x) { return x; }"), board)


def test_a_wrong_signature_does_not_compile():
    with pytest.raises(CompileError, match="pulsestage_main"):
        firmware("void pulsestage_main(char *text) { ps_log(text); }")


def test_a_library_of_another_version_is_refused(board, tmp_path):
    text = "unsigned pulsestage_abi = 9; void *pulsestage_bus; int pulsestage_main(void) { return 0; }"
    with pytest.raises(LibraryError, match=r"version 9.*build it again"):
        NativeHost(reference(tmp_path, text), board)


def test_what_is_no_library_is_named(board, tmp_path):
    text = tmp_path / "text.so"
    text.write_text("hello")
    with pytest.raises(LibraryError, match="no shared library"):
        NativeHost(text, board)
    with pytest.raises(FileError, match=f"no such library.*{BUILD}"):
        NativeHost(tmp_path / "missing.so", board)
    with pytest.raises(FileError, match="no such source"):
        NativeHost(tmp_path / "missing.c", board)


def test_a_library_that_needs_another_says_which(board, tmp_path):
    with pytest.raises(
        LibraryError, match=r"cannot be loaded: .*nowhere_to_be_found.* add a source that has it .*porting\.md"
    ):
        NativeHost(
            reference(
                tmp_path,
                "#include <pulsestage.h>\nint nowhere_to_be_found(void); PULSESTAGE_MAIN { return nowhere_to_be_found(); }",
                *("-shared", "-fPIC", f"-I{get_include_folder()}"),
            ),
            board,
        )


def test_without_a_compiler_the_build_raises_no_compiler_error(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    (tmp_path / "a.c").write_text("")
    with pytest.raises(NoCompilerError, match=r"cc.*\$CC"):
        build(tmp_path / "a.c")


def test_several_sources_share_one_bus_and_cpp_works(board, tmp_path):
    firmware("PULSESTAGE_MAIN { return 0; }")
    (tmp_path / "a.c").write_text("#include <pulsestage.h>\nint other(void);\nPULSESTAGE_MAIN { return other(); }\n")
    (tmp_path / "b.c").write_text("#include <pulsestage.h>\nint other(void) { return ps_in8(0x300); }\n")
    assert NativeHost(build([tmp_path / "a.c", tmp_path / "b.c"], flags=STRICT), board).run().code == 0xA8
    if shutil.which("c++"):
        built = firmware(
            'struct S { ~S() { ps_log("bye"); } }; PULSESTAGE_MAIN { S s; return ps_in8(0x300); }', suffix=".cpp"
        )
        assert NativeHost(built, board).run().code == 0xA8
        assert board.log[-1][1] == "bye"


@pytest.mark.parametrize(
    ("macro", "body"),
    [
        ("DOS", "outp(0x300, 8); return inp(0x300) + inportb(0x300);"),
        ("LINUX", "outb(8, 0x300); udelay(5); usleep(1); return inb(0x300) * 2;"),
    ],
)
def test_drivers_find_the_port_macros_that_they_use(board, macro, body):
    assert (
        NativeHost(firmware(f"PULSESTAGE_MAIN {{ {body} }}", f"-DPULSESTAGE_{macro}_IO"), board).run().code == 2 * 0xA8
    )
    assert board.trace.text().count("reset command") >= 1


def test_what_is_no_board_is_refused_before_anything_is_built():
    """NativeHost("driver.c", stage)"""
    with pytest.raises(ArgumentError, match=r"is no Board: NativeHost\('driver.c', Board\(stage\)\)"):
        NativeHost("missing.c", object())


RUNNERS = pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])


@RUNNERS
def test_functions_of_the_firmware_win_over_the_systems_of_the_same_name(isolated, tmp_path):
    # stage run driver.c, with `int wait(int ms)` and `pause()` in it
    source = tmp_path / "driver.c"
    source.write_text(
        """
        #include <pulsestage.h>
        int wait(int ms) { ps_delay_us((uint32_t)ms * 1000u); return ms; }
        int pause(void) { return 5; }
        int getpid(void) { return -3; }
        PULSESTAGE_MAIN { return wait(10) + pause() + getpid(); }
        """
    )
    host = NativeHost(source, Board(Stage("xy", visuals=False)), isolated=isolated)
    assert (host.run().code, host.board.stage.time) == (12, pytest.approx(0.01))
    by_hand = tmp_path / "by_hand.so"
    subprocess.run(["cc", "-shared", "-fPIC", f"-I{get_include_folder()}", str(source), "-o", str(by_hand)], check=True)
    assert NativeHost(by_hand, Board(Stage("xy", visuals=False)), isolated=isolated).run().code == 12


def test_libraries_among_the_flags_come_after_the_sources(tmp_path):
    # stage run driver.c --cflags=-lm
    (tmp_path / "part.c").write_text("int part(void) { return 42; }\n")
    subprocess.run(["cc", "-c", "-fPIC", "part.c", "-o", "part.o"], cwd=tmp_path, check=True)
    subprocess.run(["ar", "rcs", "libpart.a", "part.o"], cwd=tmp_path, check=True)
    source = tmp_path / "driver.c"
    source.write_text("#include <pulsestage.h>\nint part(void);\nPULSESTAGE_MAIN { return part(); }\n")
    library = build(source, flags=[f"-L{tmp_path}", "-lpart"])
    assert NativeHost(library, Board(Stage("xy", visuals=False))).run().code == 42


def test_the_build_command_of_rust_and_zig_and_for_a_folder(tmp_path):
    assert format_build_command("x/it.rs").startswith("rustc --edition 2024 --crate-type cdylib x/it.rs -o it.")
    assert format_build_command("it.zig") == "zig build-lib -dynamic -O ReleaseSafe it.zig"
    with pytest.raises(FileError, match=r"is a folder\. Name a library, or the sources of one: cc "):
        check_library(tmp_path)


@pytest.mark.parametrize("output", ["b.c", "b.cpp", "b.ino", "b.h"])
def test_a_source_as_output_is_refused_and_not_overwritten(tmp_path, output):
    """build(a, b): the second is the output"""
    for name in ("a.c", output):
        (tmp_path / name).write_text("int one;\n")
    with pytest.raises(ArgumentError, match=rf"{output}: .* the name of a source\. Several .* build\(\[a, b\]\)"):
        build(tmp_path / "a.c", tmp_path / output)
    assert (tmp_path / output).read_text() == "int one;\n"


pytestmark = pytest.mark.skipif(platform.system() != "Linux", reason="of ELF")
OURS = {"x86-64": 62, "aarch64": 183}.get(firmware_library.MACHINE_NAMES.get(platform.machine(), platform.machine()), 0)
SHARED = 3


def elf(kind, machine, order="<"):
    return b"\x7fELF" + bytes([1, 1 if order == "<" else 2]) + bytes(10) + struct.pack(f"{order}HH", kind, machine)


@pytest.mark.parametrize(
    ("head", "message", "instead"),
    [
        (elf(SHARED, 20, ">"), "built for PowerPC, and", ""), (elf(SHARED, 8, ">"), "built for MIPS, and", ""),
        (elf(SHARED, 40), "built for ARM (32 bit), and", "--mcu cortex-m3 (docs/targets.md)."),
        (elf(SHARED, 83), "built for AVR, and", "--mcu atmega2560 (docs/targets.md)."),
        (elf(SHARED, 3), "built for x86 (32 bit), and", ""), (elf(SHARED, 243), "built for RISC-V, and", ""),
        (elf(SHARED, 999), "built for machine 999, and", ""),
    ],
)  # fmt: skip
def test_a_library_of_another_machine_says_of_which_and_where_it_can_run(tmp_path, head, message, instead):
    file = tmp_path / "x.so"
    file.write_bytes(head)
    with pytest.raises(LibraryError) as refused:
        firmware_library.check_library(file)
    assert message in str(refused.value)
    assert ("Or run it as it is, on an emulated processor" in str(refused.value)) == bool(instead)
    assert str(refused.value).endswith(instead)


@pytest.mark.parametrize(
    ("kind", "message"),
    [(1, "is an object file, not"), (2, "is a program, not"), (4, "is a core dump, not"), (9, "is no library, not")],
)
@pytest.mark.skipif(not OURS, reason="of the usual machines")
def test_what_is_no_library_says_what_it_is(tmp_path, kind, message):
    file = tmp_path / "x.so"
    file.write_bytes(elf(kind, OURS))
    with pytest.raises(LibraryError, match=message):
        firmware_library.check_library(file)
    file.write_bytes(elf(SHARED, OURS))
    assert firmware_library.check_library(str(file)) == file
    file.write_bytes(elf(SHARED, OURS)[:19])
    with pytest.raises(LibraryError, match="is no shared library of this machine"):
        firmware_library.check_library(file)
    with pytest.raises(FileError, match=r"is a folder\. Name a library"):
        firmware_library.check_library(tmp_path)


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
def test_the_build_command_suits_language_and_system(monkeypatch, name, system, command):
    monkeypatch.setattr(platform, "system", lambda: system)
    assert firmware_library.format_build_command(name) == command


def test_the_compiler_is_that_of_the_environment_or_the_first_installed(monkeypatch):
    """CC="own -O1", which is there; one that is not; c++ of several; none"""
    available = {"own", "gcc", "clang++"}
    monkeypatch.setattr(firmware_library.shutil, "which", lambda name: name if name in available else None)
    monkeypatch.setenv("CC", "own -O1"), monkeypatch.setenv("CXX", "lost")
    assert firmware_library.find_compiler("x.c") == "own -O1"
    assert firmware_library.find_compiler("x.cpp") == "clang++"
    monkeypatch.setenv("CC", "lost")
    assert firmware_library.find_compiler() == "gcc"
    available.clear()
    with pytest.raises(
        firmware_library.NoCompilerError,
        match=r"for x\.cc: none of c\+\+, g\+\+, clang\+\+ is on the PATH, and \$CXX is not",
    ):
        firmware_library.find_compiler("x.cc")


def test_sanitizers_of_a_library_are_named_each_once(tmp_path):
    file = tmp_path / "x.so"
    file.write_bytes(b"\0libubsan.so.1\0libasan.so.8\0libasan.so.8\0libtsan.so\0libmsan.so.1\0")
    assert firmware_library.list_sanitizers(file) == ["libasan.so.8", "libtsan.so", "libubsan.so.1"]
    assert firmware_library.list_sanitizers(tmp_path / "none") == []


def test_sources_are_known_by_their_ends_and_one_library_is_enough(tmp_path):
    assert firmware_library.are_sources(["a.c", "b.cpp", "s.ino"])
    assert not firmware_library.are_sources(["a.c", "b.so"])
    with pytest.raises(firmware_library.ArgumentError, match=r"a\.so, b\.so: give one library, or sources only"):
        firmware_library.find_or_build_library(["a.so", "b.so"])
    with pytest.raises(
        firmware_library.ArgumentError, match=r"platform='dos': it says how sources are built, and a\.so is built"
    ):
        firmware_library.find_or_build_library("a.so", platform="dos")
    with pytest.raises(firmware_library.ArgumentError, match="nothing to build"):
        firmware_library.build([])
