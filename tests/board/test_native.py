"""Firmware in C: paused, resumed, bounded, interrupted, and the same to the bit in a process of its own."""

from __future__ import annotations

import ctypes
import time

import pytest
from support.compiled_firmware import firmware

from stage import Stage, faults
from stage.board import Board, HostError, HostTimeout, NativeHost
from stage.chips import PCL240K, PCL240MS
from stage.errors import ArgumentError, RunTimeout, SimulationError, StageError

MOVE = r"""
int runs;
static void put(uint32_t port, int r, uint32_t value)
{
    ps_out8(port, (uint8_t)(0x80 | r));
    for (int byte = 3; byte; byte--)
        ps_out8(port + (uint32_t)byte, (uint8_t)(value >> 8 * (byte - 1)));
}
static void start(uint32_t port, uint32_t pulses, int command)
{
    put(port, 0, pulses), put(port, 1, 100), put(port, 2, 1500), put(port, 4, 300), put(port, 5, 300), put(port, 7, 300);
    put(port, 6, 400), ps_out8(port, 0x44), ps_out8(port, (uint8_t)command);
}
"""
THREE = (
    MOVE
    + r"""
PULSESTAGE_MAIN
{
    ps_logf("run %d", ++runs);
    for (uint32_t port = 0x300; port < 0x30C; port += 4)
        start(port, 3000, 0x15);
    for (uint32_t port = 0x300; port < 0x30C; port += 4)
        while (ps_in8(port) & 0x40)
            ;
    ps_logf("done at %llu", (unsigned long long)ps_micros());
    return 7;
}
"""
)
FOR_EVER = "PULSESTAGE_MAIN { for (;;) { ps_in8(0x300); ps_delay_us(10); } }"


def host(body: str, chips=PCL240K, isolated: bool = False, **options) -> NativeHost:
    """Run firmware on a new board."""
    return NativeHost(firmware(body), Board(Stage("xyz", chips=chips, visuals=False)), isolated=isolated, **options)


def collect_results(h: NativeHost) -> tuple:
    """Return all results of a run: state, trace, log, diagnostics."""
    stage = h.board.stage
    message = [chip.diagnostics for chip in stage.chips]
    return stage.snapshot().state.tobytes(), h.board.trace.lines().tobytes(), h.board.log, h.board.cycles, message


def in_pieces(h: NativeHost) -> NativeHost:
    """Run in two pieces, between which a payload is added."""
    assert h.run_for(0.31) is None
    h.board.stage.set_payload(0.3)
    assert h.run_for(0.0701234) is None
    assert h.run().code == 7
    return h


def test_firmware_gives_the_same_bits_in_every_run_in_pieces_and_isolated():
    complete, again, in_child_process = host(THREE), host(THREE), host(THREE, isolated=True)
    for h in (complete, again, in_child_process):
        assert h.run().code == 7
    assert collect_results(complete) == collect_results(again) == collect_results(in_child_process)
    pieces = host(THREE)
    while pieces.run_for(0.0123457) is None:
        pass
    assert collect_results(pieces) == collect_results(complete)
    assert complete.board.log[0] == (0.0, "run 1")
    complete.run()
    assert complete.board.log[2][1] == "run 1", "a run from the entry has fresh variables"


def test_changes_between_two_runs_reach_isolated_firmware():
    ours, theirs = in_pieces(host(THREE, PCL240MS)), in_pieces(host(THREE, PCL240MS, isolated=True))
    assert collect_results(ours) == collect_results(theirs)
    unloaded = host(THREE, PCL240MS)
    unloaded.run()
    assert collect_results(unloaded)[0] != collect_results(ours)[0]


def test_firmware_pauses_at_the_exact_nanosecond_and_continues():
    h = host("PULSESTAGE_MAIN { ps_delay_us(1000); return 3; }")
    assert h.run_for(0.000123456) is None
    assert (h.board.stage.now, h.running) == (123_456, True)
    h.board.stage.run(0.5)
    result = h.run()
    assert h.board.stage.now == 501_000_000, (
        "what was left of the delay is left after a time in which the firmware stood still"
    )
    assert (result.code, h.running) == (3, False)


@pytest.mark.parametrize("isolated", [False, True], ids=["thread", "process"])
def test_firmware_that_never_returns_is_stopped_by_time_or_by_cycles_and_shows_the_last(isolated):
    h = host(FOR_EVER, isolated=isolated)
    with pytest.raises(HostTimeout, match=r"0.25 s of simulated time.*\n(.*\n)*.*300h R"):
        h.run(timeout=0.25)
    assert h.board.stage.now == 250_000_000
    with pytest.raises(HostTimeout, match="100 bus cycles"):
        h.run(max_cycles=100)
    with pytest.raises(HostTimeout, match=r"100 bus cycles in less than 0\.5 s"):
        h.run_for(0.5, max_cycles=100)
    assert h.running
    requested = []
    begin = h.board.stage.time
    assert (
        h.run_until(lambda: requested.append(h.board.stage.time) or h.board.stage.time > 0.3, timeout=1, poll=0.01)
        > 0.04
    )
    assert len(requested) > (requested[-1] - begin) / 0.01 - 3, "asked at each poll"
    with pytest.raises(RunTimeout, match="did not come true"):
        h.run_until(lambda: False, timeout=0.002)
    with pytest.raises(StageError, match="one host"):
        NativeHost(firmware(FOR_EVER), h.board).run()


def test_firmware_that_waits_for_a_timer_gets_on():
    h = host("PULSESTAGE_MAIN { uint64_t end = ps_micros() + 500; while (ps_micros() < end) ; return 0; }")
    assert h.run(timeout=1).seconds == pytest.approx(500e-6, abs=3e-6)


def test_isolated_firmware_that_computes_for_ever_is_killed():
    h = host("PULSESTAGE_MAIN { ps_out8(0x300, 8); for (volatile int k = 0;; k++) ; }", isolated=True, patience=0.4)
    with pytest.raises(HostError, match="without a bus cycle"):
        h.run()
    assert h._runner._child is None
    assert h.board.stage.now == 1000


@pytest.mark.parametrize(
    ("crash", "signal"), [("raise(SIGSEGV);", "SIGSEGV"), ("abort();", "SIGABRT"), ("exit(5);", "exit code 5")]
)
def test_a_crash_is_an_error_that_shows_the_last_cycles_and_the_recording_arrives(crash, signal):
    body = (
        "#include <signal.h>\n#include <stdlib.h>\n"
        + MOVE
        + "PULSESTAGE_MAIN { start(0x300, 3000, 0x15); ps_delay_us(100000);"
    )
    reads = "ps_in8(0x304); " * 5  # the host is ahead of its stage then
    h = host(body + f' ps_log("falling"); {reads} runs = 1; {crash} return 0; }}', isolated=True)
    with h.board.stage.record() as recording, pytest.raises(HostError, match=rf"(?s){signal}.*304h R") as failure:
        h.run()
    assert str(failure.value).partition("Its last bus cycles:\n")[2] == h.board.trace.text(12)
    assert h.board.log[0][1] == "falling"
    assert h.board.stage.now == 100_000_000 + h.board.cycles * 1000
    assert h.board.stage.axes["x"].position > 1e-4
    assert len(recording) == 100
    assert not h.running
    again = host(body + f" {reads} return 0; }}")
    with again.board.stage.record():
        again.run()
    assert again.board.stage.snapshot().state.tobytes() == h.board.stage.snapshot().state.tobytes()


def test_a_stage_that_diverges_ends_the_firmware_with_the_state_before_it():
    h = host(FOR_EVER)
    h.run_for(0.01)
    stage = h.board.stage
    stage.data.qfrc_applied[0] = 1e12
    with pytest.raises(SimulationError, match="diverged"):
        h.run()
    assert stage.time == pytest.approx(0.01, abs=1e-3)
    stage.data.qfrc_applied[0] = 0
    assert h.run_for(0.01) is None, "a new run"


def test_lost_writes_of_firmware_appear_in_the_trace():
    reference = Stage("xyz")
    faults.lost_write(reference.axes["x"], address=0, value=0x15)
    board = Board(reference)
    NativeHost(firmware(THREE), board).run()
    assert reference.axes["x"].position == pytest.approx(0, abs=1e-5)
    assert reference.axes["y"].position > 1e-3
    assert "lost on the way" in str(board.trace)


def test_diagnostics_of_a_long_run_are_those_of_single_writes():
    h = host("PULSESTAGE_MAIN { for (int k = 0; k < 5000; k++) ps_out8(0x300, 0x80); ps_out8(0x300, 0x15); return 0; }")
    h.run()
    message = h.board.stage.axes["x"].chip.diagnostics
    chip = Stage("xyz").axes["x"].chip
    for _ in range(5000):
        chip.write(0, 0x80)
    chip.write(0, 0x15)
    assert message == chip.diagnostics != []


@pytest.mark.parametrize(
    "requested", [{"timeout": -1}, {"timeout": float("nan")}, {"timeout": "long"}, {"max_cycles": 0}]
)
def test_bounds_that_make_no_sense_are_refused(requested):
    with pytest.raises(ArgumentError):
        host(FOR_EVER).run(**requested)


def test_the_header_and_python_agree_on_the_requests():
    from stage.board import firmware_library
    from stage.board.bus import host_record

    text = (firmware_library.get_include_folder() / "pulsestage.h").read_text()
    names = "".join(text[text.index("enum {") + 6 : text.index("};", text.index("enum {"))].split()).split(",")
    number = -1
    for name in names:
        name, _, value = name.partition("=")
        number = int(value) if value else number + 1
        assert getattr(host_record, name.removeprefix("PS_")) == number, name
    assert len(names) > 10
    assert ctypes.sizeof(firmware_library.BusStruct) == 24


def test_firmware_that_returns_while_another_of_its_threads_computes_does_not_end_this_process():
    # PULSESTAGE_MAIN { pthread_create(&t, 0, computes, 0); return 0; }: its code was unloaded beneath the thread, SIGSEGV
    board = Board(Stage("xy", visuals=False))
    source = """#include <pthread.h>
    #include <unistd.h>
    static volatile int on = 1;
    static void *computes(void *p) { for (int k = 0; k < 200; k++) { on = on * 1; usleep(1000); } return p; }
    PULSESTAGE_MAIN { pthread_t t; ps_in8(0x300); return pthread_create(&t, 0, computes, 0); }"""
    assert NativeHost(firmware(source, "-pthread"), board, isolated=False).run().code == 0
    time.sleep(0.3)
    assert board.cycles == 1
