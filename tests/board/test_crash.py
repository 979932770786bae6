"""A crash of firmware in a process of its own says what it did and where: address, function, file and line."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from stage import Stage
from stage.board import Board, HostError, NativeHost, build, crash_report
from stage.board.firmware_library import format_build_command

pytestmark = [
    pytest.mark.skipif(not crash_report.IS_SUPPORTED, reason="elsewhere a crash says its signal only"),
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"),
]
HEAD = "#include <pulsestage.h>\n#include <signal.h>\n#include <stdlib.h>\n"
NOINLINE = "static void __attribute__((noinline))"
CRASHES = {
    "a register of a microcontroller": (
        f"{NOINLINE} put(uintptr_t a) {{ *(volatile int *)a = 5; }}\n"
        "PULSESTAGE_MAIN { ps_in8(0x304); put(0x40021000u); return 0; }",
        r"SIGSEGV .*: it wrote to address 40021000h \(memory-mapped I/O\?.*in put \(.*it\.c:4\), "
        r"called from pulsestage_main \(.*it\.c:5\)",
    ),
    "a null pointer": (
        "volatile int *p;\nPULSESTAGE_MAIN { ps_in8(0x304); return p[2]; }",
        r"SIGSEGV .*: it read from address 8h, a null pointer\?, in pulsestage_main \(.*it\.c:5\)",
    ),
    "a pointer to a function that is null": (
        "void (*f)(void);\nPULSESTAGE_MAIN { ps_in8(0x304);\nf(); return 0; }",
        r"it called address 0h, where no code is: a pointer to a function that was never set\?, in pulsestage_main \(.*it\.c:6\)",
    ),
    "a pointer to a function that is wild": (
        "void (*f)(void) = (void (*)(void))0x123456789000;\nPULSESTAGE_MAIN { ps_in8(0x304);\nf(); return 0; }",
        r"it called address 123456789000h, where no code is, in pulsestage_main \(.*it\.c:6\)",
    ),
    "an address far off": (
        "volatile int *p = (int *)0x123456789000;\nPULSESTAGE_MAIN { ps_in8(0x304); return *p; }",
        r"it read from address 123456789000h, in pulsestage_main",
    ),
    "a recursion without end": (
        "volatile int n;\nint f(int k) { volatile char b[4096]; b[0] = (char)k; return f(k + 1) + b[0] + n; }\n"
        "PULSESTAGE_MAIN { ps_in8(0x304); return f(1); }",
        r"its stack is full \(endless recursion\?\), in f \(.*it\.c:5\), \d+ times",
    ),
    "a division by 0": (
        "volatile int z;\nPULSESTAGE_MAIN { ps_in8(0x304); return 5 / z; }",
        r"SIGFPE .*an integer was divided by 0 \(or the smallest one by -1\), in pulsestage_main \(.*it\.c:5\)",
    ),
    "abort": (
        f"{NOINLINE} check(int x) {{ if (x) abort(); }}\nPULSESTAGE_MAIN {{ ps_in8(0x304); check(1);\nreturn 0; }}",
        r"SIGABRT .*: in check \(.*it\.c:4\), called from pulsestage_main \(.*it\.c:5\)",
    ),
    "a trap": ("PULSESTAGE_MAIN { ps_in8(0x304);\n__builtin_trap(); }", r"SIGILL .*: in pulsestage_main \(.*it\.c:5\)"),
}


def crashed(library) -> str:
    with pytest.raises(HostError) as error:
        NativeHost(library, Board(Stage("xy", visuals=False)), isolated=True).run()
    return str(error.value)


@pytest.mark.parametrize("what", CRASHES)
def test_a_crash_says_what_was_touched_by_which_line_and_after_which_cycle(what, tmp_path):
    # stage run it.c
    body, text = CRASHES[what]
    source = tmp_path / "it.c"
    source.write_text(f"{HEAD}{body}\n")
    message = crashed(build(source, flags=["-Wno-unused-variable", "-Wno-infinite-recursion"]))
    assert re.search(text, message), message
    assert re.search(r"; at 0\.000001 s, after 1 bus cycles\..*304h R", message, re.S)


def test_an_exception_in_cpp_that_nobody_catches_is_named(tmp_path):
    source = tmp_path / "it.cpp"
    source.write_text(
        "#include <pulsestage.h>\n#include <stdexcept>\n"
        'static void __attribute__((noinline)) go(int k) { if (k) throw std::runtime_error("no"); }\n'
        "PULSESTAGE_MAIN { ps_in8(0x304); go(1); return 5; }\n"
    )
    message = crashed(build(source))
    assert re.search(r"a C\+\+ exception that nobody caught, in .*pulsestage_main \(.*it\.cpp:4\)", message), message


@pytest.mark.skipif(shutil.which("rustc") is None, reason="no Rust compiler")
def test_a_panic_in_rust_is_named(tmp_path):
    source, library = tmp_path / "it.rs", tmp_path / "it.so"
    source.write_text(
        """
        #[repr(C)] pub struct Bus { abi: u32, size: u32, host: *mut u8, request: extern "C" fn(*mut u8, i32, i64, i64) -> i64 }
        #[no_mangle] pub static mut pulsestage_abi: u32 = 1;
        #[no_mangle] pub static mut pulsestage_bus: *mut Bus = std::ptr::null_mut();
        #[no_mangle] pub extern "C" fn pulsestage_main() -> i32 {
            unsafe { ((*pulsestage_bus).request)((*pulsestage_bus).host, 0, 0x304, 0); }
            let none: Option<i32> = std::env::args().nth(1000).map(|_| 1);
            none.unwrap()
        }
        """
    )
    subprocess.run(
        ["rustc", "--edition=2021", "-A", "warnings", "-g", "--crate-type=cdylib", str(source), "-o", str(library)],
        check=True,
    )
    message = crashed(library)
    assert re.search(r"SIGABRT .*a panic in Rust, in .*pulsestage_main \(.*it\.rs:\d+\)", message), message


def test_a_library_without_symbols_says_the_function_and_its_offset(tmp_path, monkeypatch):
    source = tmp_path / "it.c"
    source.write_text(f"{HEAD}volatile int *p;\nPULSESTAGE_MAIN {{ ps_in8(0x304); return *p; }}\n")
    assert "-shared" in format_build_command(source)
    library = build(source)
    subprocess.run(["strip", "--strip-debug", str(library)], check=True)
    assert "a null pointer?, in pulsestage_main;" in crashed(library)
    monkeypatch.setattr(crash_report.shutil, "which", lambda name: None)
    assert "a null pointer?, in pulsestage_main;" in crashed(library)


def test_nothing_noted_says_nothing(tmp_path):
    assert crash_report.describe_crash(b"", tmp_path / "it.so") == ""
    assert crash_report.describe_crash(b"[" * 100_000, tmp_path / "it.so") == "", "firmware has written into it"
