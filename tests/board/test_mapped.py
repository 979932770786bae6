"""Firmware whose chips are memory-mapped: each access through a `volatile` pointer is the bus cycle that it stands for."""

from __future__ import annotations

import random
import re
import sys

import pytest
from support.compiled_firmware import firmware

from stage import Stage, faults
from stage.board import Board, HostError, NativeHost, memory_mapped_ports
from stage.chips import MCX304, PCL240K
from stage.errors import ArgumentError, StageError

pytestmark = pytest.mark.skipif(not memory_mapped_ports.is_supported(), reason="windows need Linux on x86-64")

AT = 0x40021000
WINDOW = f"{AT:#x}=0x300+0x20"
HEAD = f"""
#include <string.h>
#define AT(type, n) (*(volatile type *)(uintptr_t)({AT:#x}u + (n)))
"""
RUNNERS = """
#ifdef PORTS
#define READ(bits, n) ps_in##bits(0x300 + (n))
#define WRITE(bits, n, v) ps_out##bits(0x300 + (n), (uint##bits##_t)(v))
#define DO(bits, n, op, v) WRITE(bits, n, READ(bits, n) op (v))
#elif defined(PROXIES)
#include <pulsestage_mmio.hpp>
#define READ(bits, n) ps::reg##bits(0x300 + (n))
#define WRITE(bits, n, v) (READ(bits, n) = (uint##bits##_t)(v))
#define DO(bits, n, op, v) (READ(bits, n) op##= (v))
#else
#define READ(bits, n) AT(uint##bits##_t, n)
#define WRITE(bits, n, v) (AT(uint##bits##_t, n) = (uint##bits##_t)(v))
#define DO(bits, n, op, v) (AT(uint##bits##_t, n) = (uint##bits##_t)(AT(uint##bits##_t, n) op (v)))
#endif
"""
"""The same accesses in three ways."""


def accesses(rng: random.Random, n: int) -> str:
    """Return C functions that make random accesses of every width, with computations in between."""
    parts, calls = [], []
    for k in range(n // 12):
        lines = []
        for _ in range(12):
            bits = rng.choice((8, 16, 32))
            at, value = rng.randrange(0, 0x20 - bits // 8 + 1), rng.randrange(1 << bits)
            if rng.random() < 0.8:
                at &= -(bits // 8)
            lines.append(
                rng.choice(
                    (
                        f"WRITE({bits}, {at}, {value:#x}u);",
                        f"WRITE({bits}, {at}, x + y);",
                        f"x += READ({bits}, {at});",
                        f"y ^= (uint32_t)(int{bits}_t)READ({bits}, {at}) << (x & 3);",
                        f"if (READ({bits}, {at}) & {1 << rng.randrange(bits):#x}u) x++; else y--;",
                        f"while (x & 0xf && READ({bits}, {at}) != {value:#x}u) x--;",
                        f"DO({bits}, {at}, |, {value:#x}u);",
                        f"DO({bits}, {at}, &, ~1u);",
                        f"DO({bits}, {at}, +, y);",
                        f"DO({bits}, {at}, ^, x >> 2);",
                        f"for (unsigned i = 0; i < {rng.randrange(1, 5)}; i++) buffer[i & 7] = READ({bits}, {at});",
                        f"WRITE({bits}, {at}, buffer[x & 7]);",
                        f"ps_delay_us({rng.randrange(3)});",
                        f"y = other(y, READ({bits}, {at}));",
                    )
                )
            )
        parts.append(f"static void part{k}(void)\n{{\n    " + "\n    ".join(lines) + "\n}")
        calls.append(f"    part{k}();")
    return "\n".join(
        (
            "static uint32_t x = 1, y = 2, buffer[8];",
            "static __attribute__((noinline)) uint32_t other(uint32_t a, uint32_t b) { return a * 31 + b / 3; }",
            *parts,
            "PULSESTAGE_MAIN\n{\n    for (int k = 0; k < 3; k++) {",
            *calls,
            '    }\n    ps_logf("%x %x", x, y);\n    return 0;\n}',
        )
    )


def ran(library, chips=MCX304, pieces: float = 0, **options) -> tuple:
    """Run a library, and return all state that the run changes."""
    board = Board(Stage("xy", chips=chips, visuals=False))
    with NativeHost(library, board, **options) as host:
        while pieces and host.run_for(pieces) is None:
            pass
        code = None if pieces else host.run().code
    return board.stage.snapshot().state.tobytes(), board.trace.lines().tobytes(), board.log, board.cycles, code


def same_as_ports(body: str, *flags: str, chips=MCX304) -> None:
    """Assert that accesses to a window have the effects of port cycles."""
    by_ports = ran(firmware(HEAD + RUNNERS + body, "-DPORTS", *flags), chips)
    library = firmware(HEAD + RUNNERS + body, *flags)
    assert ran(library, chips, map=WINDOW) == by_ports


@pytest.mark.parametrize(
    ("level", "chips"),
    [
        ("-O2", MCX304), pytest.param("-O0", PCL240K, marks=pytest.mark.slow), pytest.param("-O1", PCL240K, marks=pytest.mark.slow),
        pytest.param("-Os", MCX304, marks=pytest.mark.slow), pytest.param("-O3", PCL240K, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_random_accesses_of_every_width_are_the_port_cycles_that_they_say(level, chips):
    seed = 4711
    same_as_ports(accesses(random.Random(seed), 84), level, chips=chips)


def test_a_loop_with_delays_and_calls_takes_one_signal():
    body = """
    static __attribute__((noinline)) void wait_a_little(int k) { ps_delay_us(k & 3); WRITE(16, 4, ps_micros()); }
    PULSESTAGE_MAIN { for (int k = 0; k < 50; k++) { DO(16, 6, |, k); wait_a_little(k); } return 0; }
    """
    same_as_ports(body)
    board = Board(Stage("xy", chips=MCX304, visuals=False))
    NativeHost(firmware(HEAD + RUNNERS + body), board, map=WINDOW).run()
    assert board.link.record["faults"] == 1


def test_registers_of_cpp_are_the_same_cycles_and_need_no_window():
    body = HEAD + RUNNERS + accesses(random.Random(77), 36)
    assert ran(firmware(body, "-DPROXIES", suffix=".cpp")) == ran(firmware(body, "-DPORTS"))
    struct = """
    #define PULSESTAGE_MMIO_ADDRESS 0x40021000
    #define PULSESTAGE_MMIO_PORT 0x300
    #include <pulsestage_mmio.hpp>
    typedef ps::cell16 vu16;
    struct chip { vu16 wr[8]; };
    #define CHIP ((chip *)0x40021000)
    PULSESTAGE_MAIN
    {
        chip *two = CHIP + 1;
        CHIP->wr[1] = 5, CHIP->wr[2] = CHIP->wr[1], two->wr[0]++, --two->wr[1];
        uint16_t before = two->wr[3]++, written = two->wr[4] = 9;
        CHIP->wr[7] <<= 3;
        return before + written + (CHIP->wr[3] == 7 ? 100 : 0);
    }"""
    ports = """
    PULSESTAGE_MAIN
    {
        ps_out16(0x302, 5), ps_out16(0x304, ps_in16(0x302)), ps_out16(0x310, (uint16_t)(ps_in16(0x310) + 1));
        ps_out16(0x312, (uint16_t)(ps_in16(0x312) - 1));
        uint16_t before = ps_in16(0x316);
        ps_out16(0x316, (uint16_t)(before + 1)), ps_out16(0x318, 9), ps_out16(0x30e, (uint16_t)(ps_in16(0x30e) << 3));
        return before + 9 + (ps_in16(0x306) == 7 ? 100 : 0);
    }"""
    assert ran(firmware(struct, suffix=".cpp")) == ran(firmware(ports))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("level", ["-O0", "-O1", "-O2", "-O3", "-Os"])
def test_random_accesses_in_depth(level, seed, monkeypatch):
    pytest.importorskip("ziglang")
    body = accesses(random.Random(seed), 360)
    same_as_ports(body, level)
    monkeypatch.setenv(
        "CC", f"{sys.executable} -m ziglang cc -mcpu=baseline"
    )  # clang, which makes one instruction of more of them
    same_as_ports(body, level, "-DCLANG", "-fno-sanitize=all")


def test_a_run_in_pieces_that_end_within_accesses_is_the_same():
    body = (
        HEAD
        + "PULSESTAGE_MAIN { for (int k = 0; k < 300; k++) AT(uint16_t, 4) = (uint16_t)k; return AT(uint16_t, 4); }"
    )
    complete = ran(firmware(body), map=WINDOW)
    assert ran(firmware(body), pieces=7.3e-6, map=WINDOW)[:4] == complete[:4]
    assert ran(firmware(body), pieces=41e-6, map=WINDOW)[:4] == complete[:4]


HOOKED = """
static int calls;
static void hook(void *none) { (void)none; calls++; DO(8, 0, &, 0); WRITE(8, 0, 0x04); ps_on_interrupt(calls < 2 ? hook : 0, 0); }
PULSESTAGE_MAIN
{
    static const uint32_t set[][2] = {{0, 60}, {1, 60}, {2, 100}, {4, 200}, {5, 200}, {7, 300}, {6, 1}};
    for (unsigned k = 0; k < sizeof set / sizeof *set; k++) {
        WRITE(8, 0, 0x80 | set[k][0]);
        for (int byte = 3; byte; byte--)
            WRITE(8, byte, set[k][1] >> 8 * (byte - 1));
    }
    ps_on_interrupt(hook, 0);
    WRITE(8, 0, 0xE4), WRITE(8, 0, 0x44), WRITE(8, 0, 0x30);
    while (READ(8, 0) & 0x40 && ps_micros() < 90000)
        ;
    ps_logf("%d", calls);
    return 0;
}
"""


def test_hooks_and_threads_of_the_firmware_have_windows_too():
    same_as_ports(HOOKED, chips=PCL240K)  # nested: a hook's access comes within an access
    threads = """
    #include <pthread.h>
    static void *work(void *n) { for (int k = 0; k < 100; k++) DO(16, 4, +, (int)(intptr_t)n); return 0; }
    PULSESTAGE_MAIN
    {
        for (intptr_t n = 1; n < 4; n++) {
            pthread_t one;
            pthread_create(&one, 0, work, (void *)n);
            pthread_join(one, 0);
        }
        return READ(16, 4);
    }
    """
    same_as_ports(threads, "-pthread")


def test_python_is_called_within_an_access():
    body = """
    PULSESTAGE_MAIN { for (int k = 0; k < 60; k++) WRITE(8, 1, k); return READ(8, 1); }
    """
    left = []
    for flags, options in ((("-DPORTS",), {}), ((), {"map": WINDOW})):
        board = Board(Stage("xy", chips=PCL240K, visuals=False))
        faults.lost_write(board.stage.axes["x"], skip=7)
        host = NativeHost(firmware(HEAD + RUNNERS + body, *flags), board, **options)
        left.append((host.run().code, board.trace.lines().tobytes()))
        assert "lost on the way" in str(board.trace)
    assert left[0] == left[1]


def test_a_window_may_be_anywhere_and_the_host_may_choose():
    body = """
    PULSESTAGE_MAIN
    {
        volatile uint16_t *one = ps_window(0x304, 4), *other = ps_window(0x308, 8);
        one[0] = 7, other[1] = 8;
        *(volatile uint16_t *)0x7ffe8 = 9, *(volatile uint16_t *)(0x600000000000 + 2) = 10;
        ps_logf("%d", one != other);
        return 0;
    }"""
    board = Board(Stage("xy", chips=MCX304, visuals=False))
    NativeHost(firmware(body), board, map=["0x7ffe8=0x30c+2", (0x600000000000, 0x300, 4)]).run()
    assert [(c.port, c.value) for c in board.trace] == [(0x304, 7), (0x30A, 8), (0x30C, 9), (0x302, 10)]
    assert board.log[0][1] == "1"


WRONG = {
    "beyond the window": (
        "static void __attribute__((noinline)) put(void) { AT(int, 0x20) = 5; }\n"
        "PULSESTAGE_MAIN { AT(char, 4) = 1; put(); return 0; }",
        rf"an access to address 40021020h in put \(.*\.c:5\) is beyond the window {re.escape(WINDOW)}, which ends at 4002101Fh",
    ),
    "half beyond": (
        "PULSESTAGE_MAIN { AT(char, 4) = 1; return AT(int, 0x1e); }",
        "40021020h.*is beyond the window|4002101Eh.*goes on beyond the window",
    ),
    "a float": (
        "volatile float f;\nPULSESTAGE_MAIN { AT(char, 4) = 1; f = AT(float, 4); return 0; }",
        r"40021004h in pulsestage_main \(.*c:6\), in the window .* no bus cycle \(its code begins .*0f .*one at a time",
    ),
    "memcpy": (
        f"char b[64];\nvolatile int n = 32;\nPULSESTAGE_MAIN {{ AT(char, 4) = 1; memcpy(b, (void *){AT}, n); return 0; }}",
        r"40021\w*h in .* of libc.*, called from pulsestage_main \(.*c:7\).*not by memcpy",
    ),
    "ps_window": (
        "PULSESTAGE_MAIN { AT(char, 4) = 1; ps_window(0x300, 0); return 0; }",
        r"ps_window\(0x300, 0x0\): .*length is 1 port",
    ),
}  # fmt: skip


def test_an_access_that_is_no_bus_cycle_is_an_error_in_words():
    for what, (body, message) in WRONG.items():
        board = Board(Stage("xy", chips=MCX304, visuals=False))
        library = firmware(HEAD + body, "-Wno-array-bounds")
        with pytest.raises(HostError, match=message) as error:
            NativeHost(library, board, map=WINDOW).run()
        assert board.cycles == 1, what
        assert "304h W 01h" in str(error.value) or what == "ps_window"


WILD = {
    "null": ("int *volatile p;\nPULSESTAGE_MAIN { AT(char, 4) = 1; return *p; }", "read from address 0h, a null pointer"),
    "wild": (
        "PULSESTAGE_MAIN { AT(char, 4) = 1; return *(volatile int *)0x50021000; }",
        r"it read from address 50021000h \(memory-mapped I/O\?.*docs/memory_mapped.md\), in pulsestage_main \(.*c:5\)",
    ),
    "recursion": (
        "volatile int n;\nint f(int k) { volatile char b[4096]; AT(char, 4) = b[0] = (char)k; return f(k + 1) + b[0] + n; }\n"
        "PULSESTAGE_MAIN { return f(1); }",
        r"its stack is full \(endless recursion\?\), in f",
    ),
    "a jump into the window": (
        "PULSESTAGE_MAIN { AT(char, 4) = 1; ((void (*)(void))(uintptr_t)0x40021000u)(); return 0; }",
        r"after 1 bus cycles",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", WILD)
def test_a_wild_pointer_is_reported_as_without_windows(what):
    body, message = WILD[what]
    board = Board(Stage("xy", chips=MCX304, visuals=False))
    with pytest.raises(HostError, match=f"SIGSEGV.*{message}"):
        NativeHost(firmware(HEAD + body, "-Wno-infinite-recursion"), board, map=WINDOW).run()


def test_a_window_where_something_else_is_is_refused():
    """Ask for a window where a library of the process is: processes of firmware have it at the same place."""
    library = firmware('PULSESTAGE_MAIN { ps_logf("%llu", (unsigned long long)(uintptr_t)&sprintf); return 0; }')
    board = Board(Stage("xy", chips=MCX304, visuals=False))
    with pytest.raises(ArgumentError, match=r"lets nobody use addresses below 10000h.*pulsestage_mmio"):
        NativeHost(library, board, map="0x100=0x300+4")
    NativeHost(library, board).run()
    address = int(board.log[0][1]) & -16
    with pytest.raises(ArgumentError, match=r"its pages are in use in this process, by .*libc.*Choose another address"):
        NativeHost(library, board, map=(address, 0x300, 4))


def test_two_firmwares_have_a_window_at_the_same_address_at_the_same_time():
    endless = firmware(HEAD + "PULSESTAGE_MAIN { for (;;) AT(char, 4); }")
    hosts = [NativeHost(endless, Board(Stage("xy", chips=MCX304, visuals=False)), map=WINDOW) for _ in range(2)]
    for host in hosts * 2:
        host.run_for(1e-4)
    assert [host.board.cycles for host in hosts] == [201, 201]
    for host in hosts:
        host.close()


def test_windows_need_a_process_of_the_firmware_and_say_so():
    library = firmware("PULSESTAGE_MAIN { ps_window(0x300, 4); return 0; }")
    board = Board(Stage("xy", chips=MCX304, visuals=False))
    with pytest.raises(StageError, match=r"need a process of the firmware's own: isolated=True.*pulsestage_mmio.hpp"):
        NativeHost(library, board, map=WINDOW, isolated=False)
    with pytest.raises(HostError, match=r"ps_window\(0x300, 0x4\): windows .*need a process.*isolated=True"):
        NativeHost(library, board, isolated=False).run()


def test_elsewhere_windows_are_refused_and_proxies_named(monkeypatch):
    monkeypatch.setattr(memory_mapped_ports, "is_supported", lambda: False)
    library = firmware("PULSESTAGE_MAIN { ps_window(0x300, 4); return 0; }")
    board = Board(Stage("xy", chips=MCX304, visuals=False))
    with pytest.raises(StageError, match=r"need Linux on x86-64, and this is .*pulsestage_mmio.hpp"):
        NativeHost(library, board, map=WINDOW, isolated=False)
