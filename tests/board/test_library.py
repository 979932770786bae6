"""A library that is none says what was looked for, and how to build it."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, CompileError, LibraryError, NativeHost, NoCompilerError, build, include
from stage.board.library import check, how_to_build
from stage.errors import ArgumentError
from stage.files import FileError

STRICT = ("-std=c99", "-pedantic", "-Werror")
BUILD = r'cc -shared -fPIC -I"\$\(stage include\)"'


@pytest.fixture(scope="module")
def board():
    return Board(Stage("xyz", visuals=False))


def plain(tmp_path, text: str, *flags: str, name: str = "plain.so"):
    """A library built without the header."""
    firmware("PULSESTAGE_MAIN { return 0; }")  # skips without a compiler
    source, made = tmp_path / "plain.c", tmp_path / name
    source.write_text(text)
    subprocess.run(["cc", *(flags or ("-shared", "-fPIC")), str(source), "-o", str(made)], check=True)
    return made


@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
def test_a_library_without_the_entry_point_says_what_was_looked_for(board, isolated):
    without = firmware("int something_else(void) { return ps_in8(1); }")
    with pytest.raises(LibraryError, match=f"pulsestage_main.*PULSESTAGE_MAIN.*{BUILD}"):
        NativeHost(without, board, isolated=isolated)


def test_a_library_built_without_the_header_is_refused(board, tmp_path):
    with pytest.raises(LibraryError, match=f"pulsestage_abi.*include <pulsestage.h>.*{BUILD}"):
        NativeHost(plain(tmp_path, "double pulsestage_main(double x) { return x; }"), board)


def test_a_wrong_signature_does_not_compile():
    with pytest.raises(CompileError, match="pulsestage_main"):
        firmware("void pulsestage_main(char *text) { ps_log(text); }")


def test_a_library_of_another_version_is_refused(board, tmp_path):
    text = "unsigned pulsestage_abi = 9; void *pulsestage_bus; int pulsestage_main(void) { return 0; }"
    with pytest.raises(LibraryError, match=r"version 9.*build it again"):
        NativeHost(plain(tmp_path, text), board)


def test_a_library_for_another_machine_is_named(board, tmp_path):
    made = bytearray(firmware("PULSESTAGE_MAIN { return 0; }").read_bytes())
    made[18:20] = (243).to_bytes(2, "little")
    foreign = tmp_path / "foreign.so"
    foreign.write_bytes(made)
    with pytest.raises(LibraryError, match=f"built for RISC-V.*{BUILD}"):
        NativeHost(foreign, board)


def test_what_is_no_library_is_named(board, tmp_path):
    text = tmp_path / "text.so"
    text.write_text("hello")
    with pytest.raises(LibraryError, match="no shared library"):
        NativeHost(text, board)
    with pytest.raises(LibraryError, match="object file"):
        NativeHost(plain(tmp_path, "int f(void) { return 0; }", "-c", name="plain.o"), board)
    with pytest.raises(FileError, match=f"no such library.*{BUILD}"):
        NativeHost(tmp_path / "missing.so", board)
    with pytest.raises(FileError, match="no such source"):
        NativeHost(tmp_path / "missing.c", board)
    with pytest.raises(ArgumentError, match="no Board"):
        NativeHost(text, Stage("xyz", visuals=False))


def test_a_library_that_needs_another_says_which(board, tmp_path):
    with pytest.raises(
        LibraryError, match=r"cannot be loaded: .*nowhere_to_be_found.* add a source that has it .*porting\.md"
    ):
        NativeHost(
            plain(
                tmp_path,
                "#include <pulsestage.h>\nint nowhere_to_be_found(void); PULSESTAGE_MAIN { return nowhere_to_be_found(); }",
                *("-shared", "-fPIC", f"-I{include()}"),
            ),
            board,
        )


def test_without_a_compiler_it_is_said(monkeypatch, tmp_path):
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
        made = firmware(
            'struct S { ~S() { ps_log("bye"); } }; PULSESTAGE_MAIN { S s; return ps_in8(0x300); }', suffix=".cpp"
        )
        assert NativeHost(made, board).run().code == 0xA8
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


def test_the_header_is_where_include_says_and_the_hint_names_it():
    assert (include() / "pulsestage.h").is_file()
    assert how_to_build("x/driver.so").endswith("driver.c -o driver.so")


def test_what_is_no_board_is_refused_before_anything_is_built():
    """NativeHost("driver.c", stage)"""
    with pytest.raises(ArgumentError, match=r"is no Board: NativeHost\('driver.c', Board\(stage\)\)"):
        NativeHost("missing.c", object())


WAYS = pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])


@WAYS
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
    subprocess.run(["cc", "-shared", "-fPIC", f"-I{include()}", str(source), "-o", str(by_hand)], check=True)
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


def test_a_source_of_rust_or_zig_and_a_folder_are_told_what_to_build(tmp_path):
    assert how_to_build("x/it.rs").startswith("rustc --edition 2024 --crate-type cdylib x/it.rs -o it.")
    assert how_to_build("it.zig") == "zig build-lib -dynamic -O ReleaseSafe it.zig"
    with pytest.raises(FileError, match=r"is a folder\. Name a library, or the sources of one: cc "):
        check(tmp_path)


@pytest.mark.parametrize("output", ["b.c", "b.cpp", "b.ino", "b.h"])
def test_a_source_as_the_output_stays_and_is_told(tmp_path, output):
    """build(a, b): the second is the output"""
    for name in ("a.c", output):
        (tmp_path / name).write_text("int one;\n")
    with pytest.raises(ArgumentError, match=rf"{output}: .* the name of a source\. Several .* build\(\[a, b\]\)"):
        build(tmp_path / "a.c", tmp_path / output)
    assert (tmp_path / output).read_text() == "int one;\n"
