"""Each signal and each abnormal end that firmware can raise: what is said of it, and that the runs after it are not affected."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from typing import ClassVar

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, HostError, NativeHost, crash_report
from stage.board.isolation import process_starter

pytestmark = pytest.mark.skipif(not crash_report.IS_SUPPORTED, reason="signals are numbered as on 64-bit Linux")
HEAD = """
#include <fenv.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <unistd.h>
"""
SENDS = """
PULSESTAGE_MAIN
{
    int number = atoi(getenv("SIGNAL_NUMBER"));
    ps_in8(0x304);
    if (getenv("SIGNAL_TO_PARENT"))
        kill(getppid(), number), usleep(20000);
    else
        raise(number);
    return 0;
}
"""
IGNORED = {"SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH"} | {"SIGPIPE", "SIGXFSZ"}
"""By default (signal(7)), and by Python."""
STOPS = {"SIGSTOP", "SIGTSTP", "SIGTTIN", "SIGTTOU"}
NUMBERS = sorted(int(number) for number in signal.valid_signals())
EVERY_DAY = {
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGTSTP,
    signal.SIGPIPE,
    signal.SIGSEGV,
    signal.SIGALRM,
    signal.SIGRTMAX,
}
TO_PARENT_EVERY_DAY = {signal.SIGINT, signal.SIGSTOP, signal.SIGTERM}


def build_firmware(body: str):
    return firmware(f"{HEAD}{body}", "-D_GNU_SOURCE", "-lm")


def spread(every_day: set[int]) -> list:
    """All signals; those that are not for every day are slow."""
    return [pytest.param(n, id=name_of(n), marks=() if n in every_day else pytest.mark.slow) for n in NUMBERS]


def name_of(number: int) -> str:
    return signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"


@pytest.fixture(scope="module")
def board():
    return Board(Stage("xy", visuals=False))


@pytest.fixture
def after(board, capfd):
    """The run after the test is as ever, and nobody has printed a traceback."""
    yield
    began = time.monotonic()
    host = NativeHost(firmware("PULSESTAGE_MAIN { return ps_in8(0x300); }"), board, isolated=True)
    assert host.run().code == 0xA8
    host.close()
    assert time.monotonic() - began < process_starter.ANSWER_LIMIT_S, "a starter that is stopped is replaced at once"
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.usefixtures("after")
@pytest.mark.parametrize("number", spread(EVERY_DAY))
def test_a_signal_that_firmware_raises_is_named(number, board, monkeypatch):
    monkeypatch.setenv("SIGNAL_NUMBER", str(number))
    host = NativeHost(build_firmware(SENDS), board, isolated=True)
    name = name_of(number)
    if name in IGNORED:
        assert host.run().code == 0
        return
    with pytest.raises(HostError, match=rf"was {'stopped' if name in STOPS else 'ended'} by {name}\b"):
        host.run()


@pytest.mark.usefixtures("after")
@pytest.mark.parametrize("number", spread(TO_PARENT_EVERY_DAY))
def test_a_signal_that_firmware_sends_to_its_parent_does_not_reach_later_runs(number, board, monkeypatch):
    # kill(getppid(), SIGSTOP);
    monkeypatch.setenv("SIGNAL_NUMBER", str(number))
    monkeypatch.setenv("SIGNAL_TO_PARENT", "1")
    with NativeHost(build_firmware(SENDS), board, isolated=True, patience=5) as host, suppress(HostError):
        assert host.run().code == 0  # unless the starter has ended, and its children with it


TRAPS = "feenableexcept(FE_ALL_EXCEPT);"
ENDS = {
    "traced": ("ptrace(PTRACE_TRACEME, 0, 0, 0); raise(SIGUSR1);", "was stopped by SIGUSR1"),
    "traced in silence": ("ptrace(PTRACE_TRACEME, 0, 0, 0);", None),
    "attaches": ("ptrace(PTRACE_ATTACH, getppid(), 0, 0); usleep(20000);", None),
    "seizes": (
        "ptrace(PTRACE_SEIZE, getppid(), 0, 0); ptrace(PTRACE_INTERRUPT, getppid(), 0, 0); usleep(20000);",
        None,
    ),
    "leaves traps on": (TRAPS, None),
    "divides by 0.0": (
        f"{TRAPS} volatile double z = 0; z = 1 / z;",
        "SIGFPE .*: a floating-point number was divided by 0,",
    ),
    "the root of -1": (
        f"{TRAPS} volatile double z = 0; z = z / z;",
        "SIGFPE .*: a floating-point operation was invalid",
    ),
    "a large product": (
        "feenableexcept(FE_OVERFLOW); volatile double z = 1e300; z = z * z;",
        "SIGFPE .*: a floating-point result was too large",
    ),
    "divides by 0": ("volatile int z = 0; z = 5 / z;", r"SIGFPE .*: an integer was divided by 0 \(or the smallest"),
    "sends SIGFPE": ("raise(SIGFPE);", r"SIGFPE \(Floating point exception\): in pulsestage_main"),
}


@pytest.mark.usefixtures("after")
@pytest.mark.parametrize("what", ENDS)
def test_an_abnormal_end_is_reported_with_its_cause(what, board):
    body, message = ENDS[what]
    host = NativeHost(build_firmware(f"PULSESTAGE_MAIN {{ ps_in8(0x304); {body} return 0; }}"), board, isolated=True)
    if message is None:
        assert host.run().code == 0
        host.close()
        return
    with pytest.raises(HostError, match=message):
        host.run()


@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
def test_a_hook_that_enables_traps_does_not_change_the_stage(isolated):
    hook = f"""
    static void hook(void *a) {{ (void)a; {TRAPS} ps_on_timer(0, 0, 0); }}
    PULSESTAGE_MAIN {{ ps_on_timer(1000, hook, 0); ps_delay_us(20000); return 3; }}"""
    states = []
    for text in (hook, hook.replace(TRAPS, "")):
        board = Board(Stage("xy", visuals=False))
        assert NativeHost(build_firmware(text), board, isolated=isolated).run().code == 3
        states.append(board.stage.snapshot().state.tobytes())
    assert states[0] == states[1]


PARENT = """
import sys
from stage import Stage
from stage.board import Board, NativeHost
from stage.board.isolation import process_starter
with NativeHost(sys.argv[1], Board(Stage("xy", visuals=False)), isolated=True) as host:
    host.run()
    print(next(iter(process_starter._starters.values()))._process.pid, flush=True)
"""


def test_a_starter_that_was_stopped_ends_with_its_process(monkeypatch):
    monkeypatch.setenv("SIGNAL_NUMBER", str(int(signal.SIGSTOP)))
    monkeypatch.setenv("SIGNAL_TO_PARENT", "1")
    command = [sys.executable, "-c", PARENT, str(build_firmware(SENDS))]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)


def test_a_starter_ends_with_its_process_which_closes_the_connection():
    """python -W always program.py once ended with: ResourceWarning: subprocess 4711 is still running"""
    command = [sys.executable, "-W", "always::ResourceWarning", "-c", PARENT]
    library = build_firmware("PULSESTAGE_MAIN { return 0; }")
    done = subprocess.run([*command, str(library)], capture_output=True, text=True, check=True, timeout=60)
    assert "ResourceWarning" not in done.stderr
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)


def test_a_process_stopped_twice_reports_its_exit_code():
    class Recorded:
        """A starter whose answers are given."""

        children: ClassVar[set[int]] = set()

        def __init__(self, *statuses):
            self.answers = [process_starter._HEAD.pack(4711), *map(process_starter._STATUS.pack, statuses)]

        def read(self, source, size, limit_s=0.0):
            return self.answers.pop(0)

    stopped_by = [number << 8 | 0x7F for number in (signal.SIGUSR2, signal.SIGSTOP)]  # as waitpid encodes them
    with socket.socket() as status:
        process = process_starter.ChildProcess(Recorded(*stopped_by, signal.SIGKILL), status)
        assert process.wait() == -signal.SIGKILL
    assert process.stopped == signal.SIGSTOP


def test_a_coroutine_of_the_firmware_is_none_of_several_threads():
    library = firmware("""
        #include <ucontext.h>
        #include <pulsestage.h>
        static ucontext_t home, other;
        static char stack[1 << 18];
        static void work(void) { for (int k = 0; k < 100; k++) ps_in8(0x300); }
        PULSESTAGE_MAIN
        {
            getcontext(&other);
            other.uc_stack.ss_sp = stack;
            other.uc_stack.ss_size = sizeof stack;
            other.uc_link = &home;
            makecontext(&other, work, 0);
            swapcontext(&home, &other);
            return 0;
        }
    """)
    host = NativeHost(library, Board(Stage("xy", visuals=False)), isolated=True)
    assert host.run().code == 0
    assert not [line for _, line in host.log if "threads" in line]
