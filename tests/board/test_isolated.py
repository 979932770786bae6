"""Firmware in a process of its own leaves what it leaves in this one, to the bit: whatever calls Python on the way, however much it
writes, and where it crashes."""

from __future__ import annotations

import errno
import gc
import os
import platform
import re
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import mujoco
import numpy as np
import pytest
from board.test_native import MOVE, THREE, collect_results, host
from support.compiled_firmware import firmware

from stage import Stage, faults
from stage.board import Board, HostError, NativeHost, crash_report
from stage.board.isolation import process_starter
from stage.chips import HCTL1100
from stage.cli import main
from stage.errors import StageError
from stage.native import COMPILED

RUNNERS = pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
STOP_INTERRUPT = (
    MOVE
    + """
PULSESTAGE_MAIN
{
    for (int k = 0; k < 3; k++) {
        ps_out8(0x300, 0x08); /* reset command: or the next start is none */
        start(0x300, 50, 0x35);
        ps_delay_us(300000);
        ps_logf("%d", k);
    }
    return ps_interrupt_line();
}
"""
)


def both(run):
    """Return the hosts of `run(isolated)` in this process and in another, which leave the same."""
    ours, theirs = run(False), run(True)
    assert collect_results(ours) == collect_results(theirs)
    return ours, theirs


def test_a_hook_in_python_is_called_at_the_same_nanosecond_and_drives_the_same_board():
    calls: dict[bool, list] = {}

    def run(isolated):
        h = host(STOP_INTERRUPT, isolated=isolated)
        observed = calls[isolated] = []

        def hook():
            b = h.board
            observed.append((b.stage.now, b.stage.axes["x"].position, b.cycles, b.in8(0x300), len(b.log)))
            b.out8(0x300, 0x08)  # clears the interrupt
            b.delay_us(250)

        h.board.on_interrupt(hook)
        assert h.run().code == 0
        return h

    both(run)
    assert calls[False] == calls[True]
    assert len(calls[True]) == 3


def test_what_a_hook_in_python_changes_of_the_machine_acts_from_that_nanosecond_on():
    def run(isolated):
        h = host(STOP_INTERRUPT, isolated=isolated)
        stage = h.board.stage
        axis = stage.axes["x"]

        def hook():
            stage.set_payload(0.1 + stage.payload())
            faults.switch_stuck(axis, "sd_plus", True)
            faults.bus_voltage(axis, 20.0)
            h.board.out8(0x300, 0x08)

        h.board.on_interrupt(hook)
        h.run()
        assert stage.payload() == pytest.approx(0.3)
        assert axis.switches.sd_plus
        return h

    both(run)


def test_an_error_of_a_hook_in_python_comes_out_as_it_was_raised_and_ends_the_run():
    h = host(STOP_INTERRUPT, isolated=True)

    def hook():
        raise KeyError("my own")

    h.board.on_interrupt(hook)
    with pytest.raises(KeyError, match="my own"):
        h.run()
    assert not h.running
    h.board.on_interrupt(None)
    assert host("PULSESTAGE_MAIN { return 3; }", isolated=True).run().code == 3


def test_a_hook_removed_between_two_runs_is_not_called():
    h = host(STOP_INTERRUPT, isolated=True)
    calls = []
    h.board.on_interrupt(lambda: (calls.append(h.board.stage.now), h.board.out8(0x300, 8)))
    assert h.run_for(0.4) is None
    h.board.on_interrupt(None)
    assert h.run().code == 1, "the line stays asserted"
    assert len(calls) == 1


def test_faults_of_bus_and_cpu_act_on_isolated_firmware():
    def run(isolated):
        h = host(THREE, isolated=isolated)
        faults.lost_write(h.board.stage.axes["x"], address=0, value=0x15)
        faults.start_skew(h.board.stage.axes["y"], 5e-3)
        h.run()
        assert "lost on the way" in str(h.board.trace)
        assert not any("lost_write" in str(fault) for fault in h.board.stage.faults)
        return h

    ours, _ = both(run)
    assert ours.board.stage.axes["y"].position > 1e-3 > abs(ours.board.stage.axes["x"].position)


def test_a_hundred_thousand_writes_and_lines_arrive_all_of_them_in_order():
    body = """
    PULSESTAGE_MAIN
    {
        for (int k = 0; k < 100000; k++)
            ps_out8(0x303, (uint8_t)(k * 7));
        for (int k = 0; k < 5000; k++)
            ps_logf("%d: a line of some length, so that the room for lines is full before the end", k);
        return 0;
    }
    """

    def run(isolated):
        h = host(body, isolated=isolated)
        journal = h.board.stage.axes["x"].chip.journal()
        h.run()
        assert len(journal.entries) == 100_000
        assert [e.b for e in journal.entries] == [k * 7 & 0xFF for k in range(100_000)]
        return h

    ours, _ = both(run)
    assert [text.split(":")[0] for _, text in ours.board.log] == [str(k) for k in range(5000)]


def test_a_log_line_longer_than_its_buffer_is_cut():
    body = """
    static char text[100000];
    PULSESTAGE_MAIN { for (int k = 0; k < 99999; k++) text[k] = 'x'; ps_log("before"); ps_log(text); ps_log("after"); return 0; }
    """
    h = host(body, isolated=True)
    h.run()
    lines = [text for _, text in h.board.log]
    assert (lines[0], lines[2]) == ("before", "after")
    assert set(lines[1]) == {"x"}
    assert len(lines[1]) > 30_000


def test_a_recording_longer_than_the_sample_buffer_is_complete():
    columns = []
    for isolated in (False, True):
        h = host(THREE.replace("return 7;", "ps_delay_us(1000000); return 7;"), isolated=isolated)
        with h.board.stage.record(1e-3) as recording:
            h.run()
        columns.append({name: column.tobytes() for name, column in recording.columns.items()})
    assert columns[0] == columns[1]
    assert recording.columns["time"] == pytest.approx(1e-3 * np.arange(1, len(recording) + 1), abs=1e-9)
    assert len(recording) > 1000


def test_what_a_servos_chip_sees_of_its_shaft_is_recorded_the_same(tmp_path):
    body = """
    static void put(int r, int v) { ps_out8(0x300 + 0, (uint8_t)r); ps_out8(0x300 + 1, (uint8_t)v); }
    PULSESTAGE_MAIN { for (int k = 0; k < 400; k++) { put(k % 40, k); ps_delay_us(500); } return 0; }
    """
    texts = []
    for isolated in (False, True):
        board = Board(Stage("xyz_servo", chips=HCTL1100, visuals=False))
        h = NativeHost(firmware(body), board, isolated=isolated)
        board.stage.axes["x"].chip.write(5, 3)  # control mode, so that the loop is closed
        with board.stage.record() as recording:
            h.run()
        recording.to_vcd(tmp_path / f"{isolated}.vcd")
        texts.append((collect_results(h), (tmp_path / f"{isolated}.vcd").read_text().split("$timescale")[1]))
    assert texts[0] == texts[1]


def test_a_crash_after_many_writes_leaves_the_stage_as_a_return_does():
    writes = "PULSESTAGE_MAIN { start(0x300, 3000, 0x15); for (int k = 0; k < 40000; k++) ps_out8(0x305, k);"
    crashed = host(f"#include <signal.h>\n{MOVE}{writes} raise(SIGSEGV); return 0; }}", isolated=True)
    stopped = host(f"{MOVE}{writes} return 0; }}")
    with pytest.raises(HostError, match="SIGSEGV"):
        crashed.run()
    stopped.run()
    assert collect_results(crashed) == collect_results(stopped)


def test_a_callback_of_mujoco_in_python_is_not_forgotten_in_silence():
    h = host("PULSESTAGE_MAIN { return 3; }", isolated=True)
    mujoco.set_mjcb_control(lambda model, data: None)
    try:
        with pytest.raises(StageError, match=r"calls a function in Python back.*isolated=False"):
            h.run()
    finally:
        mujoco.set_mjcb_control(None)
    assert h.run().code == 3


MODES = {
    "rounding up": ("#include <fenv.h>", "fesetround(FE_UPWARD);", ["-lm"]),
    "small numbers dropped": ("", "", ["-ffast-math"]),
    "a small number, a mode of its own": ("#include <xmmintrin.h>", "_mm_setcsr(_mm_getcsr() | 0x8040);", []),
}


@RUNNERS
@pytest.mark.parametrize("what", MODES)
def test_whatever_firmware_makes_of_the_floating_point_mode_the_stage_has_the_same_bits(what, isolated):
    head, call, flags = MODES[what]
    if "xmmintrin" in head and platform.machine() != "x86_64":
        pytest.skip("a header of x86")
    usual = host(THREE)
    usual.run()
    body = THREE.replace("PULSESTAGE_MAIN\n{", f"PULSESTAGE_MAIN\n{{ {call}")
    board = Board(Stage("xyz", visuals=False))
    other = NativeHost(firmware(f"{head}\n{body}", *flags), board, isolated=isolated)
    other.run()
    assert collect_results(other) == collect_results(usual)
    after = host(THREE)
    after.run()
    assert collect_results(after) == collect_results(usual), "the mode stays with the firmware"


def test_cycles_of_a_destructor_are_not_part_of_the_next_run():
    """A library is loaded and unloaded once before it runs, to see what is wrong with it."""
    delayed = "__attribute__((destructor)) static void late(void) { ps_out8(0x300, 0x08); }\n"

    def run(isolated):
        h = host(
            f"#include <pulsestage.h>\n{delayed}PULSESTAGE_MAIN {{ return ps_in8(0x304) == 0; }}\n", isolated=isolated
        )
        assert h.run().code == 0
        return h

    for h in both(run):
        assert next(iter(h.board.trace)).port == 0x304


def test_firmware_that_raises_sigint_is_reported_and_prints_nothing(capfd):
    h = host(
        "#include <pulsestage.h>\n#include <signal.h>\nPULSESTAGE_MAIN { raise(SIGINT); return 0; }\n", isolated=True
    )
    with pytest.raises(HostError, match="was ended by SIGINT"):
        h.run()
    assert "Traceback" not in capfd.readouterr().err


def test_a_note_of_a_crash_that_firmware_has_overwritten_says_nothing(tmp_path):
    assert crash_report.describe_crash(b"\xff" * 9, tmp_path) == crash_report.describe_crash(b"[1]", tmp_path) == ""


def test_a_host_collected_while_another_starts_is_killed_after_it(monkeypatch):
    # NativeHost("driver.c", board, isolated=True), a hundred of them: one stood still for ever
    body = "#include <pulsestage.h>\n#include <unistd.h>\nPULSESTAGE_MAIN { return ps_in8(0x300) ? getpid() : 0; }\n"
    stored = [host(body, isolated=True)]
    (old,) = [child.run(1).code for child in stored]
    send, hosts = process_starter.ProcessStarter.send, []

    def collect_first(self, message, files):
        if message[0] == "start":
            stored.clear()
            gc.collect()
        send(self, message, files)

    monkeypatch.setattr(process_starter.ProcessStarter, "send", collect_first)
    begins = threading.Thread(target=lambda: hosts.append(host(body, isolated=True)), daemon=True)
    begins.start()
    begins.join(20)
    assert hosts[0].run().code not in (0, old)
    until = time.monotonic() + 10
    while Path(f"/proc/{old}").exists() and time.monotonic() < until:
        time.sleep(0.01)
    assert not Path(f"/proc/{old}").exists()


def list_sockets():
    """List the sockets that this process has open."""
    names = set()
    for file in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # the folder itself was open while it was listed
            names.add(str(file.readlink()))
    return {name for name in names if name.startswith("socket")}


def test_a_host_that_nobody_closes_leaves_no_connection_open(recwarn):
    # host = NativeHost("driver.c", board, isolated=True); host.run_for(0.1); del host
    body = "#include <pulsestage.h>\nPULSESTAGE_MAIN { for (;;) ps_delay_us(1000); }\n"
    assert host("#include <pulsestage.h>\nPULSESTAGE_MAIN { return 3; }\n", isolated=True).run().code == 3
    gc.collect()
    before = list_sockets()
    dropped = host(body, isolated=True)
    dropped.run_for(0.01)
    assert list_sockets() - before
    del dropped
    gc.collect()
    assert list_sockets() <= before
    assert not [w for w in recwarn if w.category is ResourceWarning]


def test_a_start_that_fails_leaves_no_connection_open(monkeypatch):
    def fail(*_):
        raise BrokenPipeError

    starter = process_starter._find_starter("")
    before = list_sockets()
    for name in ("send", "read"):
        with monkeypatch.context() as patch:
            patch.setattr(process_starter.ProcessStarter, name, fail)
            with pytest.raises(BrokenPipeError) as raised:
                starter.start(1)
        assert list_sockets() <= before, raised  # which holds the frames, and so the sockets


def test_a_starter_ends_no_process_but_its_children():
    """A child that has ended is forgotten late, and its number may be another's by then."""
    starter = process_starter.ProcessStarter()
    with subprocess.Popen(["sleep", "60"], start_new_session=True) as other:
        starter.children.add(other.pid)
        starter.end()
        with pytest.raises(subprocess.TimeoutExpired):
            other.wait(0.2)
        other.kill()


def test_a_fork_does_not_control_the_firmware_of_its_parent():
    # host.run_for(1e-5); if not os.fork(): host.run()
    h = host("PULSESTAGE_MAIN { for (int k = 0; k < 100; k++) ps_in8(0x300); return 7; }", isolated=True)
    assert h.run_for(1e-5) is None
    reader, pattern = os.pipe()
    if not (child := os.fork()):
        try:
            try:
                text = repr(h.run())
            except StageError as error:
                text = str(error)
            code = h.run().code  # of its own
            h.close()
            os.write(pattern, f"{code} {text}".encode())
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    assert os.read(reader, 1000).startswith(
        b"7 firmware.so stands in the middle of its run, and this process is a fork"
    )
    if not (child := os.fork()):
        try:
            h.close()
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    result = h.run()
    assert (result.code, result.cycles, h.board.stage.now) == (7, 100, 100_000)
    os.close(reader), os.close(pattern)


def test_a_full_disk_is_reported_before_firmware_runs(monkeypatch, tmp_path, capfd):
    # stage run driver.so, and the folder for temporary files is nearly full
    library = firmware("PULSESTAGE_MAIN { return 0; }")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with monkeypatch.context() as patched:
        patched.setattr(os, "posix_fallocate", full)
        assert main(["run", str(library), "--model", "xy"]) == 2
    message = capfd.readouterr().err
    assert re.search(
        r"needs \d+\.\d MB in \S*, mostly for the trace, .*: No space left on device\. .* TMPDIR .*--keep", message
    )
    assert not list(tmp_path.glob("pulsestage-run-*/*"))
    with monkeypatch.context() as patched:
        patched.setattr(
            process_starter, "start", lambda *_: (_ for _ in ()).throw(OSError(errno.EMFILE, os.strerror(errno.EMFILE)))
        )
        assert main(["run", str(library), "--model", "xy"]) == 2
    assert capfd.readouterr().err.startswith("stage: the system refuses it: Too many open files. `ulimit -a` shows")


def test_a_stage_that_nobody_has_changed_is_not_sent_to_the_process_again(monkeypatch):
    board = Board(Stage("xy", visuals=False))
    with NativeHost(firmware("PULSESTAGE_MAIN { for (;;) ps_in8(0x300); }"), board) as host:
        host.run_for(1e-4)
        sent = []
        monkeypatch.setattr(Stage, "__getstate__", lambda self: sent.append(self) or {})
        for _ in range(5):
            host.run_for(1e-4)
    assert sent == []


@pytest.mark.skipif(not COMPILED or not Path("/proc/self/maps").exists(), reason="run as Python, or no Linux")
def test_the_native_library_is_loaded_once_for_all_processes_of_firmware():
    child = NativeHost(firmware("PULSESTAGE_MAIN { return 0; }"), Board(Stage("xy", visuals=False)))
    child.run()
    starter = process_starter._starters[os.getpid(), ""]
    assert "/_native.so" in Path(f"/proc/{starter._process.pid}/maps").read_text()
