"""A host over TCP is the same host on the board itself: the same bits, the same trace, the same time."""

from __future__ import annotations

import random
import subprocess
from pathlib import Path

import pytest
from support.served import serving

from stage import Stage
from stage.board import Board, NativeHost, NoCompilerError, build, get_include_folder
from stage.board.firmware_library import find_compiler
from stage.chips import MCX304, PCL240MK
from stage.serve import client

EXAMPLES = Path(__file__).resolve().parents[2] / "scripts" / "firmware"
STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror")
PORT = 0x300


def traffic(rng: random.Random, n: int) -> list[tuple]:
    """(method, arguments): what a board and a client both have."""
    built: list[tuple] = []
    for base in (PORT, PORT + 4):
        for register, value in ((0, 900), (1, 60), (2, 700), (4, 200), (5, 200), (7, 300), (6, 300)):
            built.append(("out8", base, 0x80 | register))
            built += [("out8", base + 1 + byte, value >> 8 * byte & 0xFF) for byte in (2, 1, 0)]
        built += [("out8", base, 0x44 | rng.choice((0, 8))), ("out8", base, 0x35)]
    for _ in range(n):
        port, kind = PORT + rng.randrange(10), rng.randrange(8)
        if kind < 3:
            built.append((rng.choice(("in8", "in16", "in32")), port))
        elif kind < 5:
            built.append((rng.choice(("out8", "out16", "out32")), port, rng.randrange(256)))
        else:
            built.append(("delay_us", rng.choice((0, 1, 40, 251, 4000))))
    return built


@pytest.mark.parametrize("seed", range(2))
def test_requests_one_by_one_and_in_batches_do_what_they_do_on_the_board(served, seed):
    print("seed", seed)
    program = traffic(random.Random(seed), 120)
    custom = Board(Stage("xy", chips=PCL240MK, visuals=False))
    expected = [getattr(custom, what)(*argument) for what, *argument in program]
    rng = random.Random(seed)
    with served.host() as host:
        answers, left = [], list(program)
        while left:
            n = rng.choice((1, 1, 5, 60))
            some, left = left[:n], left[n:]
            if n == 1:
                answers += [getattr(host, what)(*argument) for what, *argument in some]
            else:
                batch = host.batch()
                for what, *argument in some:
                    getattr(batch, what)(*argument)
                reads = iter(batch.run())
                answers += [next(reads) if what.startswith("in") else None for what, *_ in some]
    assert answers == expected
    stage = custom.stage
    assert served.state() == (
        stage.snapshot().state.tobytes(),
        str(custom.trace),
        [],
        [c.diagnostics for c in stage.chips],
    )


FILES = {"mcx304": ("mcx304", "s_curve_stop", "safe_stop"), "pcl240mk": ("pcl240", "line", "home_and_line")}


def sources(example: str) -> list[str]:
    return [
        *(str(EXAMPLES / example / f"{name}.c") for name in FILES[example]),
        str(EXAMPLES / "hal" / "hal_pulsestage.c"),
    ]


def program(folder: Path, *arguments: str) -> Path:
    """A C program that runs against a server."""
    try:
        name = find_compiler()
    except NoCompilerError as error:
        pytest.skip(str(error))
    built = folder / "program"
    subprocess.run(
        [*name.split(), *STRICT, "-DPULSESTAGE_REMOTE", f"-I{get_include_folder()}", *arguments, "-o", str(built)],
        check=True,
    )
    return built


SHIPPED = {
    "by interrupt": ("mcx304", MCX304, ("-DWORK_AROUND=1",)),
    "by speed": ("mcx304", MCX304, ("-DWORK_AROUND=2",)),
    "polls": ("pcl240mk", PCL240MK, ()),
}


@pytest.mark.parametrize(
    ("name", "bus_cycle"),
    [
        ("by interrupt", 1e-3),  # so slow a bus makes few polls
        *(pytest.param(name, 1e-5, marks=pytest.mark.slow) for name in SHIPPED),
    ],
)
def test_a_shipped_driver_gives_the_same_bits_as_in_process(name, bus_cycle, tmp_path):
    example, chip, flags = SHIPPED[name]
    custom, distance = (Board(Stage("xyz", chips=chip, visuals=False, bus_cycle=bus_cycle)) for _ in range(2))
    remote = program(tmp_path, *sources(example), f"-I{EXAMPLES / 'hal'}", *flags)
    library = build(sources(example), tmp_path / "driver.so", (*STRICT, f"-I{EXAMPLES / 'hal'}", *flags))
    result = NativeHost(library, custom).run()
    with serving(distance) as served:
        done = subprocess.run([str(remote), served.address], capture_output=True, text=True, timeout=300, check=False)
        assert (done.returncode, done.stderr) == (result.code, "")
    assert distance.log == custom.log
    assert distance.cycles == custom.cycles
    assert str(distance.trace) == str(custom.trace)
    assert distance.stage.snapshot().state.tobytes() == custom.stage.snapshot().state.tobytes()


POLLS = """
#include <pulsestage.h>
PULSESTAGE_MAIN
{
    unsigned k;
    for (k = 0; k < 3000; k++) /* more than go together */
        ps_out8(0x301, (uint8_t)k);
    ps_out16(0x302, 0x1234);
    ps_logf("%u %u", (unsigned)ps_until8(0x300, 0xFF, 0xEE, 7, 0), (unsigned)ps_until16(0x300, 0xFF, 0xEE, 3, 20));
    ps_logf("%lu %d %u", (unsigned long)ps_micros(), ps_interrupt_line(), ps_in16(0x300));
    ps_delay_us(12345);
    return 7;
}
"""


def test_polls_and_what_is_left_at_the_end_are_the_same_too(served, tmp_path):
    (tmp_path / "polls.c").write_text(POLLS)
    custom = Board(Stage("xy", chips=PCL240MK, visuals=False))
    remote = program(tmp_path, str(tmp_path / "polls.c"))
    result = NativeHost(tmp_path / "polls.c", custom).run()
    done = subprocess.run([str(remote), served.address], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (result.code, "") == (7, "")
    assert custom.log == served.board.log
    assert str(custom.trace) == str(served.board.trace)
    assert custom.stage.now == served.board.stage.now > 12_345_000


FOR_EVER = """
#include <pulsestage.h>
PULSESTAGE_MAIN
{
    for (;;) {
        for (int k = 0; k < 990; k++)
            ps_out8(0x301, (uint8_t)k);
        ps_delay_us(1000);
        ps_in8(0x300);
    }
    return 0;
}
"""


@pytest.mark.parametrize("change", ["the server ends", "a request is refused"])
def test_a_program_whose_server_ends_or_refuses_says_so(board, change, tmp_path):
    (tmp_path / "forever.c").write_text(
        FOR_EVER.replace("ps_in8(0x300)", "ps_until8(0x300, 0, 0, 0, 0)" if "refused" in change else "ps_in8(0)")
    )
    remote = program(tmp_path, str(tmp_path / "forever.c"))
    with serving(board) as served:
        running = subprocess.Popen([str(remote), served.address], stderr=subprocess.PIPE, text=True)
        if change == "the server ends":
            while board.cycles < 2000:
                pass
        else:
            running.wait()
    message = running.communicate(timeout=60)[1]
    assert running.returncode == 2
    expected = "entry 991: UNTIL8 0 times" if "refused" in change else "server"
    assert message.startswith("pulsestage: ")
    assert expected in message


CPLUSPLUS = """
#include <pulsestage.h>
#include <string>
int other();
PULSESTAGE_MAIN
{
    ps_log(std::string("from C++").c_str());
    return other();
}
"""


@pytest.mark.slow
def test_c_plus_plus_and_several_files_are_fine(served, tmp_path):
    (tmp_path / "a.cpp").write_text(CPLUSPLUS)
    (tmp_path / "b.cpp").write_text(
        "#include <pulsestage.h>\nint other() { ps_out8(0x301, 3); return ps_in8(0x500) - 250; }\n"
    )
    built = tmp_path / "program"
    flags = [
        "-std=c++17",
        "-Wall",
        "-Wextra",
        "-pedantic",
        "-Werror",
        "-DPULSESTAGE_REMOTE",
        f"-I{get_include_folder()}",
    ]
    names = [str(tmp_path / name) for name in ("a.cpp", "b.cpp")]
    subprocess.run([*find_compiler("a.cpp").split(), *flags, *names, "-o", str(built)], check=True)
    assert subprocess.run([str(built), served.address], check=False).returncode == 5
    assert served.board.log == [(0.0, "from C++")]
    assert served.board.cycles == 2


def test_functions_that_need_a_process_of_their_board_are_refused(served, tmp_path):
    (tmp_path / "window.c").write_text(
        "#include <pulsestage.h>\nPULSESTAGE_MAIN { return ps_window(0x300, 4) == 0; }\n"
    )
    remote = program(tmp_path, str(tmp_path / "window.c"))
    done = subprocess.run([str(remote), served.address], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr[:20]) == (2, "pulsestage: windows,")


def test_a_program_without_a_server_reports_the_connection(tmp_path):
    (tmp_path / "polls.c").write_text(POLLS)
    remote = program(tmp_path, str(tmp_path / "polls.c"))
    for address in ("127.0.0.1:1", "nowhere:7240"):
        done = subprocess.run([str(remote), address], capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 2
        assert f"no server at {address}. Start one: stage serve" in done.stderr


TICKS = r"""
#include <pulsestage.h>
static void tick(void *argument) { ps_logf("%s %lu %02x", (const char *)argument, (unsigned long)ps_micros(), ps_in8(0x300)); }
PULSESTAGE_MAIN
{
    ps_on_timer(1000, tick, (void *)"slow");
    ps_timer(3, 2, 400500, tick, (void *)"fast");
    for (int k = 0; k < 20; k++)
        ps_out8(0x300, 0x08), ps_spend_ns(123456), ps_in8(0x300);
    ps_timer(3, 2, 0, 0, 0);
    ps_delay_us(2500);
    return 0;
}
"""


def test_timers_tick_over_tcp_at_the_nanosecond_they_tick_at_in_process(served, tmp_path):
    """cc -DPULSESTAGE_REMOTE driver.c, with ps_on_timer and ps_spend_ns in it"""
    try:
        command = find_compiler()
    except NoCompilerError as error:
        pytest.skip(str(error))
    source, program = tmp_path / "ticks.c", tmp_path / "ticks"
    source.write_text(TICKS)
    custom = Board(Stage("xy", chips=PCL240MK, visuals=False))
    with NativeHost(build(source, tmp_path / "ticks.so"), custom) as h:
        assert h.run().code == 0
    subprocess.run(
        [command, *STRICT, "-DPULSESTAGE_REMOTE", f"-I{get_include_folder()}", str(source), "-o", str(program)],
        check=True,
    )
    assert subprocess.run([str(program), served.address], check=False).returncode == 0
    assert len(custom.log) > 10
    assert [text for _, text in served.board.log] == [text for _, text in custom.log]
    assert served.board.stage.now == custom.stage.now
    with served.host() as host:
        observed = []
        host.on_timer(1000, lambda: observed.append(host.status().seconds), n=2)
        begin = host.status().seconds
        host.batch().delay_us(2500).spend_ns(1_000_001).run()
        assert [round((t - begin) * 1e9) for t in observed] == [1_000_000, 2_000_000, 3_000_000]
        host.restore()
        host.delay_us(1500)
        assert round(observed[-1] * 1e9) == 1_000_000
        host.on_timer(0, None, n=2)
        host.delay_us(5000)
        assert len(observed) == 4
        for wrong, message in (
            ((5, 1, 1000), "timers of a board"),
            ((0, 16, 1000), "levels of hooks are"),
            ((0, 1, -1), "a period of -1 ns"),
        ):
            with pytest.raises(client.ServerError, match=message):
                host.request(client.TIMER, client.TIMING.pack(*wrong))
        with pytest.raises(client.ServerError, match="SPEND -1 ns; there are 0 to 1e18 ns"):
            host.spend_ns(-1)
        host.on_timer(1000, lambda: observed.append(0), n=1)
    with served.host() as host:
        host.delay_us(5000)
    assert len(observed) == 4, "they go with their host"
