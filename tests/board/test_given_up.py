"""Firmware that is given up, interrupted or has crashed: what it leaves, and what it cannot reach any more."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, HostError, NativeHost, memory_mapped_ports
from stage.board.thread_runner import is_debugged
from stage.chips import HCTL1100, PCL240K
from stage.cli import main
from stage.errors import StageError
from stage.sim import engine_records

SLEEPS = "#include <unistd.h>\n#include <stdlib.h>\n"
CLOCK = "#include <time.h>\n#include <unistd.h>\n"
COMPUTES = "for (time_t end = time(0) + 3; time(0) < end;) usleep(1000);"
"""Away from the bus, which is all that the host knows of it; in truth asleep: the machine has other tests. Not for ever: nobody
could end it."""


def board(model: str = "xyz", chips=PCL240K) -> Board:
    return Board(Stage(model, chips=chips, visuals=False))


def run_on(b: Board, body: str, isolated: bool = False, **options) -> NativeHost:
    return NativeHost(firmware(body), b, isolated=isolated, **options)


def test_an_abandoned_thread_that_has_returned_affects_no_later_run():
    b, others = board(), set(threading.enumerate())
    slow = run_on(b, SLEEPS + "PULSESTAGE_MAIN { ps_in8(0x300); usleep(900000); return 1; }", patience=0.2)
    with pytest.raises(HostError, match="without a bus cycle"):
        slow.run()
    until = time.monotonic() + 10
    while set(threading.enumerate()) - others and time.monotonic() < until:
        time.sleep(0.05)
    for _ in range(3):  # their threads' numbers are those of threads that ended
        assert run_on(b, 'PULSESTAGE_MAIN { ps_log("here"); return 3; }', patience=3).run().code == 3


def test_abandoned_firmware_does_not_reach_a_later_run(monkeypatch):
    h = run_on(
        board(),
        SLEEPS
        + """PULSESTAGE_MAIN
        {
            ps_in8(0x300);
            if (getenv("PULSESTAGE_TEST_SLOW"))
                usleep(1200000);
            for (int k = 0; k < 5; k++)
                ps_in8(0x777);
            return 1;
        }""",
        patience=0.2,
    )
    monkeypatch.setenv("PULSESTAGE_TEST_SLOW", "1")
    with pytest.raises(HostError):
        h.run()
    monkeypatch.delenv("PULSESTAGE_TEST_SLOW")
    assert h.run().cycles == 6
    time.sleep(1.5)  # it wakes up
    assert h.board.cycles == 7


@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
def test_what_firmware_did_before_it_computed_for_long_is_on_the_stage_and_in_the_recording(isolated):
    h = run_on(
        board(),
        CLOCK + f"PULSESTAGE_MAIN {{ ps_delay_us(4000); ps_out8(0x300, 0x15); ps_in8(0x300); {COMPUTES} return 0; }}",
        isolated,
        patience=0.5,
    )
    with h.board.stage.record() as recording, pytest.raises(HostError, match="without a bus cycle"):
        h.run()
    assert h.board.stage.now == 4_002_000
    assert len(recording) == 4
    assert {d.value for d in h.board.stage.axes["x"].chip.diagnostics} == {0x15}
    assert h.board.cycles == 2
    assert h.board.in8(0x300) != 0xFF


@pytest.fixture
def ctrl_c():
    """Python's own handler, also where the tests run in the background of a shell, which ignores Ctrl-C there."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize("body", ["ps_delay_us(4000000000u);", "for (;;) ps_in8(0x300);"], ids=["delay", "polling"])
def test_ctrl_c_makes_firmware_stand_still_at_once_even_in_a_delay_of_an_hour(body):
    h = run_on(board(), f"PULSESTAGE_MAIN {{ {body} return 0; }}")
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        h.run(timeout=1e6)
    assert h.running, "it was not given up"
    now = h.board.stage.now
    assert h.run_for(0.001) is None
    assert h.board.stage.now == now + 1_000_000
    h.close()


def test_a_crash_after_a_delay_leaves_the_stage_at_the_end_of_the_delay():
    h = run_on(board(), "PULSESTAGE_MAIN { ps_in8(0x300); ps_delay_us(2500); *(volatile int *)0 = 1; return 0; }", True)
    with pytest.raises(HostError, match="SIGSEGV"):
        h.run()
    assert h.board.stage.now == 2_501_000
    with pytest.raises(HostError, match="after 2 bus cycles"):
        h.run()
    assert h.board.stage.now == 5_002_000


def test_a_library_that_crashes_while_it_is_loaded_says_so():
    with pytest.raises(HostError, match=r"SIGABRT.*while it was loaded"):
        run_on(
            board(),
            "#include <stdlib.h>\n__attribute__((constructor)) static void at_load(void) { abort(); }\n"
            "PULSESTAGE_MAIN { return 0; }",
            True,
        )


def test_isolated_firmware_continues_cycles_and_trace():
    left = []
    for isolated in (False, True):
        b = board()
        for _ in range(30):
            b.out8(0x300, 0x08)
        b.in8(0x304)
        h = run_on(
            b, "PULSESTAGE_MAIN { ps_in8(0x304); for (int k = 0; k < 10; k++) ps_out8(0x304, 8); return 0; }", isolated
        )
        assert h.run().cycles == 11
        b.out8(0x308, 0x08)
        assert h.run().cycles == 11
        assert b.cycles == 30 + 1 + 11 + 1 + 11
        left.append((b.trace.lines().tobytes(), b.stage.snapshot().state.tobytes()))
    assert left[0] == left[1]


def test_a_stage_that_the_process_cannot_take_over_says_why():
    class Local(PCL240K):
        pass

    with pytest.raises(StageError, match=r"pickled.*Local.*isolated=False"):
        run_on(board(chips=Local), "PULSESTAGE_MAIN { return 0; }", True)
    elsewhere = type("Elsewhere", (PCL240K,), {"__module__": "__main__"})
    import __main__

    __main__.Elsewhere = elsewhere  # a class of the script that was started, which the child does not run
    try:
        with pytest.raises(StageError, match=r"Elsewhere.*isolated=False"):
            run_on(board(chips=elsewhere), "PULSESTAGE_MAIN { return 0; }", True)
    finally:
        del __main__.Elsewhere


def test_writes_leave_the_engine_room_for_what_it_notes_within_a_step():
    """for (int k = 0; k < 5000; k++) ps_out8(0x300 + k % 6, 5);
    The room that MAX_EDGES_PER_WINDOW keeps was written over."""
    b = board("xyz_servo", HCTL1100)
    room = 3 * engine_records.MAX_EDGES_PER_WINDOW + 20
    b.link.record["edge_room"] = room  # of an array that is longer: what lies behind would be overwritten
    run_on(b, "PULSESTAGE_MAIN { for (int k = 0; k < 5000; k++) ps_out8(0x300 + k % 6, 5); return 0; }").run()
    used = np.flatnonzero(b.stage.state.edges["clock"])[-1]
    assert used < room - engine_records.MAX_EDGES_PER_WINDOW, f"{room} records, {used + 1} used"


def test_hooks_work_after_firmware_was_abandoned_within_a_hook():
    b, calls = board(), []
    for register, value in ((0, 5), (1, 100), (7, 300)):
        b.out8(0x300, 0x80 | register)
        for byte in (3, 2, 1):
            b.out8(0x300 + byte, value >> 8 * (byte - 1) & 0xFF)
    h = run_on(
        b,
        """static void waits(void *a) { (void)a; ps_delay_us(1000000); }
        PULSESTAGE_MAIN
        {
            ps_on_interrupt(waits, 0);
            ps_out8(0x300, 0x08), ps_out8(0x300, 0x44), ps_out8(0x300, 0x30);
            ps_delay_us(500000);
            return 0;
        }""",
    )
    assert h.run_for(0.5) is None
    assert b.interrupt, "it stands in its hook"
    h.close()
    b.on_interrupt(lambda: (calls.append("called"), b.out8(0x300, 0x00)))
    assert (calls, b.interrupt) == (["called"], False)


def test_a_python_hook_that_removes_itself_runs_once_and_others_outlive_the_firmware():
    b = board()
    calls = []

    def once() -> None:
        calls.append("once")
        b.on_interrupt(None)

    for port in (0x300, 0x304):
        b.out8(port, 0x08)
        for register, value in ((0, 5), (1, 100), (7, 300)):
            b.out8(port, 0x80 | register)
            for byte in (3, 2, 1):
                b.out8(port + byte, value >> 8 * (byte - 1) & 0xFF)
        b.out8(port, 0x44)
    b.on_interrupt(once)
    b.out8(0x300, 0x30)
    b.delay_us(200_000)
    assert calls == ["once"]
    assert b.interrupt
    b.out8(0x300, 0x00)
    b.on_interrupt(lambda: (calls.append("stays"), b.out8(0x304, 0x00)))
    assert (
        run_on(b, "static void own(void *a) { (void)a; } PULSESTAGE_MAIN { ps_on_interrupt(own, 0); return 0; }")
        .run()
        .code
        == 0
    )
    b.out8(0x304, 0x30)
    b.delay_us(200_000)
    assert calls == ["once", "stays"]


def test_the_patience_of_a_host_is_the_documented_one():
    from stage.board.thread_runner import PATIENCE_S

    page = (Path(__file__).resolve().parents[2] / "docs" / "firmware_in_the_loop.md").read_text()
    assert f"after {PATIENCE_S:g} s of real time without a cycle" in " ".join(page.split())


@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
def test_a_log_call_without_text_is_explained(isolated):
    h = run_on(board(), "PULSESTAGE_MAIN { ps_in8(0x300); ps_log(0); return 0; }", isolated)
    with pytest.raises(HostError, match=r"ps_log\(0\), at 0\.000001 s: a null pointer is no text"):
        h.run()


def test_two_threads_of_a_firmware_at_once_on_the_bus_are_an_error_in_words():
    body = """
    #include <pthread.h>
    static void *other(void *stop) { while (!*(volatile int *)stop) ps_in8(0x304); return 0; }
    PULSESTAGE_MAIN
    {
        volatile int stop = 0;
        pthread_t thread;
        pthread_create(&thread, 0, other, (void *)&stop);
        for (int k = 0; k < 20000000; k++)
            ps_in8(0x300);
        stop = 1;
        pthread_join(thread, 0);
        return 0;
    }
    """
    h = run_on(board(), body, True)  # in this process the second thread could not be ended
    with pytest.raises(HostError, match=r"two threads of the firmware made bus cycles at the same time.*mutex"):
        h.run()


THREADS = """
#include <pthread.h>
#include <unistd.h>
static pthread_mutex_t guard = PTHREAD_MUTEX_INITIALIZER;
static void cycles(int count, unsigned port)
{
    for (int k = 0; k < count; k++) {
        if (GUARDED) pthread_mutex_lock(&guard);
        ps_in8(port);
        if (GUARDED) pthread_mutex_unlock(&guard);
    }
}
static volatile int begun;
static void *other(void *argument) { begun = 1; cycles(200, 0x304); return argument; }
PULSESTAGE_MAIN
{
    pthread_t thread;
    begun = 0;
    pthread_create(&thread, 0, other, 0);
    while (!begun)  /* on a machine with much load a thread can begin after the other's last cycle */
        ;
    cycles(OWN, 0x300);
    pthread_join(thread, 0);
    return 0;
}
"""


def test_two_threads_that_make_a_few_cycles_without_a_mutex_are_an_error_each_time():
    built = firmware(THREADS, "-DGUARDED=0", "-DOWN=200", "-pthread")
    for _ in range(4):
        with pytest.raises(HostError, match=r"two threads of the firmware made bus cycles at the same time"):
            NativeHost(built, board("xy")).run()


@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
@pytest.mark.parametrize("flags", [("-DGUARDED=1", "-DOWN=200"), ("-DGUARDED=0", "-DOWN=0")], ids=["mutex", "join"])
def test_threads_that_are_synchronized_run_and_the_log_names_them(flags, isolated):
    b = board("xy")
    for _ in range(2):
        with NativeHost(firmware(THREADS, *flags, "-pthread"), b, isolated=isolated) as h:
            assert h.run().code == 0
    assert b.cycles == 2 * (400 if "-DOWN=200" in flags else 200)
    assert len(b.log) == 2
    assert "bus cycles come from several threads of the firmware" in b.log[0][1]


def test_a_thread_that_drives_the_bus_and_still_runs_at_the_end_is_an_error():
    forever = THREADS.replace("return argument;", "for (;;) pause(); return argument;").replace(
        "pthread_join(thread, 0)", "usleep(9000)"
    )
    with pytest.raises(HostError, match="1 of its threads still ran"):
        NativeHost(firmware(forever, "-DGUARDED=1", "-DOWN=200", "-pthread"), board("xy"), isolated=True).run()


def test_a_system_timer_calls_no_handler_of_unloaded_firmware():
    # signal(SIGALRM, tick); setitimer(ITIMER_REAL, ...); return 0;
    ticks = """
    #include <signal.h>
    #include <sys/time.h>
    static volatile int n;
    static void tick(int number) { (void)number, n++; }
    PULSESTAGE_MAIN
    {
        struct itimerval often = {{0, 1000}, {0, 1000}}, none = {{0, 0}, {0, 0}};
        if (ps_micros() > 1) {
            setitimer(ITIMER_REAL, &none, 0);
            return 2;
        }
        signal(SIGALRM, tick), setitimer(ITIMER_REAL, &often, 0);
        while (!n)
            ps_in8(0x300);
        return 1;
    }
    """
    with run_on(board("xy"), ticks, isolated=True) as h:
        assert h.run().code == 1
        time.sleep(0.01)
        assert h.run().code == 2


@pytest.mark.parametrize("often", [50, 500])
def test_a_bus_cycle_in_a_handler_of_signals_is_an_error_in_words_wherever_the_signal_comes(often):
    # signal(SIGALRM, tick); where tick calls ps_out8: in the middle of another cycle, and of Python, which ps_log calls
    cycles = """
    #include <signal.h>
    #include <sys/time.h>
    static void tick(int number) { (void)number, ps_out8(0x304, 0x11); }
    PULSESTAGE_MAIN
    {
        struct itimerval often = {{0, OFTEN}, {0, OFTEN}};
        signal(SIGALRM, tick), setitimer(ITIMER_REAL, &often, 0);
        for (int k = 0;; k++) {
            ps_in8(0x300);
            if (k % 50 == 0)
                ps_log("on the way");
        }
    }
    """.replace("OFTEN", str(often))
    message = r"a handler of signals \(setitimer, alarm\) .* ps_timer and ps_on_timer"
    with run_on(board("xy"), cycles, isolated=True) as h, pytest.raises(HostError, match=message):
        h.run()


def test_too_many_windows_end_the_run_with_exit_code_1(capfd):
    # for (k = 0; k < 257; k++) ps_window(0x300, 4);
    source = "PULSESTAGE_MAIN { for (int k = 0; k < 257; k++) ps_window(0x300, 4); return 0; }"
    if not memory_mapped_ports.is_supported():
        pytest.skip("windows are for Linux on x86-64")
    assert main(["run", str(firmware(source)), "--model", "xy"]) == 1
    message = capfd.readouterr()
    assert re.search(
        r"stage: ps_window\(0x300, 0x4\): \d+ windows and pieces of memory: .* keep the pointer; at 0\.0", message.err
    )
    assert "position mm" in message.out
    assert main(["run", str(firmware(source.replace("257", "3"))), "--model", "xy"]) == 0


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells who debugs whom")
def test_a_process_that_a_debugger_holds_is_known_by_its_number():
    """gdb -p NUMBER, of firmware in a process of its own: the run waits"""
    traced = "import ctypes, sys; ctypes.CDLL(None).ptrace(0, 0, 0, 0); print('held', flush=True); sys.stdin.read()"
    reference = "import sys; print('free', flush=True); sys.stdin.read()"
    for program, held in ((traced, True), (reference, False)):
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        with subprocess.Popen([sys.executable, "-c", program], **pipes) as child:
            try:
                child.stdout.readline()
                assert is_debugged(child.pid) is held
                assert not is_debugged()
            finally:
                child.kill()
    assert not is_debugged(2**22 + 1), "there is none"
