"""Firmware that would end the process which it runs in, and a process of its own whose parent has ended."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, HostError, NativeHost, crash_report, get_include_folder
from stage.chips import PCL240K

needs_traps = pytest.mark.skipif(not crash_report.IS_SUPPORTED, reason="calls are observed on 64-bit Linux")
HEADERS = "#include <stdlib.h>\n#include <unistd.h>\n#include <assert.h>\n#include <err.h>\n#include <pthread.h>\n"


@pytest.fixture(scope="module")
def board():
    return Board(Stage("xy", chips=PCL240K, visuals=False))


def test_firmware_in_process_is_a_library_that_ctypes_loads_and_changes_nothing(tmp_path):
    """Compare the handlers of signals, and look for what only a process of the firmware's own loads."""
    program = tmp_path / "in_process.py"
    program.write_text(textwrap.dedent(IN_PROCESS))
    library = firmware(f"{HEADERS}PULSESTAGE_MAIN {{ usleep(1); return ps_in8(0x300); }}")
    done = subprocess.run([sys.executable, program, library], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("168 [] [] True\n", "")


IN_PROCESS = """
    import sys
    from pathlib import Path
    from stage import Stage
    from stage.board import Board, NativeHost

    def handled():
        return [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("Sig")]

    board = Board(Stage("xy", visuals=False))
    before = handled() if sys.platform == "linux" else []
    code = NativeHost(sys.argv[1], board, isolated=False).run().code
    unwanted = [name for name in sys.modules if name.startswith(("stage.board.isolation.traps", "stage.board.isolation"))]
    print(code, unwanted, board.log, before == (handled() if sys.platform == "linux" else []))
"""


@needs_traps
@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
@pytest.mark.parametrize("call", ["pthread_exit(0)", "syscall(SYS_exit, 0)"])
def test_firmware_that_exits_its_thread_is_an_error_and_the_board_works(board, call, isolated):
    begin, before = board.stage.now, board.cycles
    code = (
        f"#include <sys/syscall.h>\n{HEADERS}PULSESTAGE_MAIN {{ ps_delay_us(1500); ps_in8(0x304); {call}; return 0; }}"
    )
    with (
        NativeHost(firmware(code), board, isolated=isolated) as host,
        pytest.raises(
            HostError, match=r"(?s)has ended the thread that runs PULSESTAGE_MAIN \(pthread_exit, SYS_exit\).*304h R"
        ),
    ):
        host.run()
    assert board.stage.now == begin + 1_500_000 + 1000 * (board.cycles - before)
    assert not host.running
    assert (
        NativeHost(firmware("PULSESTAGE_MAIN { return ps_in8(0x300); }"), board, isolated=isolated).run().code == 0xA8
    )


SLEEPS = {
    "sleep(1);": "sleep(1)",
    "usleep(1000);": "usleep(1000)",
    "struct timespec t = {0, 1000}; nanosleep(&t, 0);": "nanosleep()",
    "struct timespec t = {0, 1000}; clock_nanosleep(CLOCK_MONOTONIC, 0, &t, 0);": "clock_nanosleep()",
    "struct timeval t = {0, 1000}; select(0, 0, 0, 0, &t);": "select(0)",
    "poll(0, 0, 1);": "poll(0, 0)",
}


@needs_traps
@pytest.mark.parametrize("call", SLEEPS)
def test_firmware_that_sleeps_in_real_time_is_reported_once_in_the_log(call):
    # sleep(3); in the place of ps_delay_us(3000000);
    head = "#include <poll.h>\n#include <sys/select.h>\n#include <time.h>\n#include <unistd.h>\n"
    times = 1 if call == "sleep(1);" else 2
    body = f"PULSESTAGE_MAIN {{ ps_in8(0x304); for (int k = 0; k < {times}; k++) {{ {call} }} return 0; }}"
    board = Board(Stage("xy", visuals=False))
    with NativeHost(firmware(head + body), board) as h:
        result = h.run()
    assert result.seconds == pytest.approx(1e-6), "no simulated time but that of the bus cycle"
    assert board.log == [
        (pytest.approx(1e-6), f"{SLEEPS[call]} passes real time only, and no simulated time: ps_delay_us passes that")
    ]


@needs_traps
@pytest.mark.parametrize("flags", [("-fno-plt", "-nostartfiles"), ("-Wl,-z,lazy",), ("-Wl,-z,now",)], ids=" ".join)
def test_a_sleep_is_reported_in_whichever_table_the_linker_has_put_the_call(flags):
    """The option -fno-plt leaves no table of calls, so usleep is among the other addresses."""
    board = Board(Stage("xy", visuals=False))
    NativeHost(firmware(f"{HEADERS}PULSESTAGE_MAIN {{ usleep(1); return 0; }}", *flags), board).run()
    assert [text.partition(" ")[0] for _, text in board.log] == ["usleep(1)"]


@needs_traps
def test_a_sleep_in_a_library_that_firmware_needs_is_reported(tmp_path):
    """driver.so needs libmotion.so, which calls usleep."""
    (tmp_path / "motion.c").write_text("#include <unistd.h>\nvoid motion(void) { usleep(2); }\n")
    subprocess.run(["cc", "-shared", "-fPIC", tmp_path / "motion.c", "-o", tmp_path / "libmotion.so"], check=True)
    needs = (f"-L{tmp_path}", "-Wl,--no-as-needed", "-lmotion", f"-Wl,-rpath,{tmp_path}")
    built = firmware("void motion(void); PULSESTAGE_MAIN { motion(); return 0; }", *needs)
    board = Board(Stage("xy", visuals=False))
    NativeHost(built, board).run()
    assert [text.partition(" ")[0] for _, text in board.log] == ["usleep(2)"]


@needs_traps
def test_a_function_named_usleep_of_the_firmware_is_not_replaced(board, tmp_path):
    """Link without -Bsymbolic: the firmware calls it through the table in which calls of the system's are taken."""
    source, built = tmp_path / "own.c", tmp_path / "own.so"
    source.write_text(
        "#include <pulsestage.h>\nint usleep(unsigned us) { ps_delay_us(us); return 5; }\n"
        "PULSESTAGE_MAIN { return usleep(10); }\n"
    )
    subprocess.run(["cc", "-shared", "-fPIC", "-w", f"-I{get_include_folder()}", source, "-o", built], check=True)
    before, begin = len(board.log), board.stage.now
    assert NativeHost(built, board).run().code == 5
    assert (len(board.log), board.stage.now - begin) == (before, 10_000)


@needs_traps
def test_a_sleep_with_floating_point_traps_on_is_reported():
    head = "#include <fenv.h>\n#include <unistd.h>\n"
    built = firmware(
        f"{head}PULSESTAGE_MAIN {{ feenableexcept(FE_ALL_EXCEPT); usleep(10); return 0; }}", "-D_GNU_SOURCE", "-lm"
    )
    board = Board(Stage("xy", visuals=False))
    assert NativeHost(built, board, isolated=True).run().code == 0
    assert len(board.log) == 1


@needs_traps
@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler: cc is not on the PATH")
def test_stage_run_of_firmware_that_exits_fails_in_words(tmp_path):
    # stage run driver.c
    (tmp_path / "driver.c").write_text(
        f"#include <pulsestage.h>\n{HEADERS}PULSESTAGE_MAIN {{ ps_in8(0x300); exit(0); }}\n"
    )
    command = [sys.executable, "-m", "stage", "run", "driver.c", "--model", "xy", "--record", "run.rrd"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "driver.so ended its process with exit code 0; at 0.000001 s, after 1 bus cycles" in done.stderr
    assert (tmp_path / "run.rrd").stat().st_size > 1000


PARENT = """
import sys
from stage import Stage
from stage.board import Board, NativeHost
host = NativeHost(sys.argv[1], Board(Stage("xy", visuals=False)), isolated=True, patience=1e6)
print(host._runner._child.pid, flush=True)
host.run(timeout=1e8, max_cycles=1 << 60)
"""


def is_terminated(pid: int) -> bool:
    """Return whether a process does not exist any more, or is dead and nobody has waited for it."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    message = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False).stdout
    return message.strip()[:1] in ("", "Z")


@pytest.mark.skipif(os.name != "posix", reason="isolated=True needs a POSIX system")
def test_isolated_firmware_ends_when_its_parent_is_killed(tmp_path):
    # python parent.py & kill -9 $!
    program = tmp_path / "parent.py"
    program.write_text(textwrap.dedent(PARENT))
    body = "PULSESTAGE_MAIN { ps_in8(0x300); for (volatile int k = 0;; k++) ; return 0; }"
    parent = subprocess.Popen([sys.executable, str(program), str(firmware(body))], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    try:
        time.sleep(0.5)
        assert not is_terminated(child)
        parent.kill()
        parent.wait()
        until = time.monotonic() + 10
        while not is_terminated(child) and time.monotonic() < until:
            time.sleep(0.05)
        assert is_terminated(child)
    finally:
        if not is_terminated(child):
            os.kill(child, signal.SIGKILL)


@needs_traps
@pytest.mark.parametrize("call", ["exit(7)", "usleep(1000); _exit(7)"])
def test_a_process_that_firmware_forks_ends_as_any_other_and_makes_no_note(board, call):
    code = f"int status = 0; if (!fork()) {{ {call}; }} wait(&status); return WEXITSTATUS(status);"
    library = firmware(f"#include <sys/wait.h>\n{HEADERS}PULSESTAGE_MAIN {{ {code} }}")
    h = NativeHost(library, board, patience=3)
    assert h.run().code == 7
    assert not any("sleep" in line for _, line in h.log)
