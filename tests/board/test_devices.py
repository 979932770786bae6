"""A device of one's own on the bus, in Python or in C, is part of the machine: at its ports, on the interrupt line, in the trace,
in snapshots, and with isolated firmware, to the bit."""

from __future__ import annotations

import copy
import gc
import math
import pickle
import re
from functools import partial

import numpy as np
import pytest
from board.test_native import collect_results
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, CompileError, HostError, LibraryError, NativeHost, build, crash_report, temporary_folders
from stage.board.devices import CDevice, Device, Encoder, OutputLatch
from stage.chips import HCTL1100, PCL240K
from stage.errors import ArgumentError, StageError
from stage.support.files import FileError

ADC = r"""
#include <pulsestage_device.h>
struct adc { int64_t done; int64_t cycles; uint8_t channel; };
static uint32_t adc_read(struct adc *s, const struct ps_moment *at, uint32_t port, int bits)
{
    s->cycles++;
    if (port == 0)
        return at->now >= s->done ? 0x80 : 0;
    s->done = 0;
    return bits == 16 ? 0x1234 : 16u * s->channel + (uint32_t)(at->counts[0] & 15);
}
static void adc_write(struct adc *s, const struct ps_moment *at, uint32_t port, int bits, uint32_t value)
{
    (void)port, (void)bits;
    s->channel = (uint8_t)value;
    s->done = at->now + 123456; /* ns that a conversion takes */
}
static int adc_interrupt(const struct adc *s, const struct ps_moment *at) { return s->done && at->now >= s->done; }
PS_DEVICE(struct adc, adc_read, adc_write, adc_interrupt)
"""
CONVERTS = r"""
static void hook(void *argument)
{
    ps_logf("hook at %lu us", (unsigned long)ps_micros());
    ps_logf("adc %02x", ps_in8(0x341));
    (void)argument;
}
PULSESTAGE_MAIN
{
    ps_out8(0x300, 0x80), ps_out8(0x303, 1), ps_out8(0x302, 0), ps_out8(0x301, 0); /* R0 */
    ps_out8(0x300, 0x81), ps_out8(0x302, 4), ps_out8(0x301, 0);
    ps_out8(0x300, 0x87), ps_out8(0x302, 0), ps_out8(0x301, 30);
    ps_out8(0x300, 0x10);
    ps_on_interrupt(hook, 0);
    for (int k = 0; k < 20; k++) {
        ps_out8(0x340, (uint8_t)k);
        ps_out8(0x500, ps_in8(0x500));
        ps_delay_us(3000);
        while (!(ps_in8(0x340) & 0x80))
            ;
        ps_logf("%04x %02x%02x", ps_in16(0x500), ps_in8(0x320), ps_in8(0x321));
    }
    return ps_in8(0x508);
}
"""


@pytest.fixture(scope="module")
def adc(tmp_path_factory):
    """A library of ADC."""
    firmware("PULSESTAGE_MAIN { return 0; }")  # skips without a compiler
    source = tmp_path_factory.mktemp("adc") / "adc.c"
    source.write_text(ADC)
    return build(source, source.with_suffix(".so"), ("-Wall", "-Wextra", "-Werror"))


def with_devices(adc) -> tuple[Board, np.ndarray, list]:
    """Make a board with devices in C and in Python, and return it with the list of what the latter has received."""
    stage = Stage("xy", visuals=False)
    board, observed, state = Board(stage, devices=["hctl2016:0x320:x"]), [], np.zeros(2, np.int64)
    board.add_device(range(0x340, 0x342), source=adc, encoders=[Encoder("x", per_metre=1e6)])

    def read(port):
        observed.append((stage.now, port, stage.axes["x"].position))
        return int(state[0]) & 0xFF

    def write(port, value):
        state[0] += value + 1
        state[1] = stage.now
        stage.axes["y"].switches.stick("el_plus", bool(value & 1))

    board.add_device([0x500, 0x501, 0x508], read, write, state=state, name="mine")
    return board, state, observed


def test_isolated_firmware_uses_the_same_devices_to_the_bit(adc):
    """CONVERTS in process and isolated: state, trace, log, and what a device in Python saw"""
    library, left, saw = firmware(CONVERTS), [], []
    for isolated in (False, True):
        board, state, observed = with_devices(adc)
        with NativeHost(library, board, isolated=isolated) as h:
            assert h.run(timeout=1).code == int(state[0]) & 0xFF
        left.append((*collect_results(h), state.tobytes(), board.devices[1].state[0].tobytes()))
        saw.append(observed)
    assert left[0] == left[1]
    assert saw[0] == saw[1]
    assert len({x for _, _, x in saw[0]}) > 10, "the carriage moves meanwhile"
    log = [text for _, text in board.log]
    assert len({text[-4:] for text in log if text[4] == " " and text[0] in "0123456789abcdef"}) > 10, (
        "the encoder counts"
    )
    assert int(board.devices[1].state[0][1]) == sum(
        c.times for c in board.trace if c.port in (0x340, 0x341) and c.direction == "R"
    )


def test_an_interrupt_of_a_device_comes_at_its_nanosecond_within_a_delay(adc):
    board, _, _ = with_devices(adc)
    when = []

    def hook():
        when.append((board.stage.now, board.read_interrupt_mask(), board.devices[1].is_pulling))
        board.in8(0x341)

    board.on_interrupt(hook)
    board.out8(0x340, 3)
    begin = board.stage.now
    board.delay_us(1000)
    assert when == [(begin + 123456, 1 << len(board.stage.chips) + 1, True)]
    assert board.stage.now == begin + 1_000_000 + 0
    assert not board.interrupt


def test_a_python_device_asserts_its_line_at_once_or_at_a_time_until_it_releases_it():
    board = Board(Stage("xy", visuals=False))
    device = board.add_device(
        0x500, read=lambda port: device.pull(False) or 7, write=lambda port, value: device.pull(at=0.002)
    )
    board.out8(0x500, 1)
    assert not board.interrupt
    when = []
    board.on_interrupt(lambda: when.append((board.stage.now, board.in8(0x500))))
    board.delay_us(5000)
    assert when == [(2_000_000, 7)]
    device.pull()
    assert (board.interrupt, device.is_pulling) == (True, True)
    board.in8(0x200)
    assert (len(when), board.interrupt) == (2, False)


def test_snapshots_carry_the_state_of_devices_and_say_whose_they_are(adc):
    board, state, _ = with_devices(adc)
    stage, empty = board.stage, copy.deepcopy(board.stage).snapshot()
    board.devices[0].registers["latch"] = 77
    board.out8(0x500, 5), board.out8(0x340, 9)
    complete = stage.snapshot()
    before = state.copy(), board.devices[1].state[0].copy()
    stage.run(0.01)
    board.out8(0x500, 6), board.out8(0x340, 1), board.devices[1].pull()
    stage.restore(pickle.loads(pickle.dumps(complete)))
    assert (state.tolist(), board.devices[1].state[0].tolist()) == (before[0].tolist(), before[1].tolist())
    assert not board.interrupt
    assert board.devices[0].registers["latch"] == 77
    with pytest.raises(ArgumentError, match=r"devices on its bus: none there, hctl2016 at 320h \(\d+ bytes.*mine"):
        stage.restore(empty)
    other = Board(Stage("xy", visuals=False))
    other.add_device(0x500, state=np.zeros(2, np.int32), name="mine")
    with pytest.raises(ArgumentError, match=r"devices on its bus: hctl2016 .* there, mine"):
        other.stage.restore(complete)
    stage.reset()
    assert state.tolist() == [0, 0]
    assert not board.devices[1].state[0].any()
    counterpart = copy.deepcopy(stage)  # its bus is empty: devices stay with their board
    assert counterpart.time == stage.time
    assert counterpart.device_state.words == 0
    begin = Board(Stage("xy", visuals=False))
    reference = begin.stage.snapshot()
    begin.stage.restore(reference)


def test_an_exception_of_a_device_comes_out_as_it_is(adc):
    class DeviceError(Exception):
        pass

    library = firmware("PULSESTAGE_MAIN { for (;;) ps_in8(0x500); }")
    for isolated in (False, True):
        board, calls = Board(Stage("xy", visuals=False)), []

        def read(port, calls=calls):
            calls.append(port)
            if len(calls) == 5:
                raise DeviceError("broken")
            return 1

        board.add_device(0x500, read=read)
        with NativeHost(library, board, isolated=isolated) as h, pytest.raises(DeviceError, match="broken"):
            h.run(timeout=1)
        assert (len(calls), board.cycles) == (5, 5)
        assert board.in8(0x500) == 1, "the board goes on"


def test_after_a_crash_devices_stand_where_the_firmware_left_them(adc):
    cycles = "for (uint8_t k = 0; k < 7; k++) ps_in8(0x340), ps_out8(0x378, k);"
    library = firmware(
        "PULSESTAGE_MAIN { " + cycles + " volatile uintptr_t no = 8; *(volatile int *)no = 1; return 0; }"
    )
    board = Board(Stage("xy", visuals=False), devices=["latch:0x378"])
    board.add_device([0x340, 0x341], source=adc, encoders=[Encoder("x", per_turn=4)])
    ours = np.zeros(3, np.uint8)
    board.add_device(0x500, state=ours)
    ours[1] = 5
    with NativeHost(library, board, isolated=True) as h, pytest.raises(HostError, match="SIGSEGV"):
        h.run()
    assert (board.devices[0].value, int(board.devices[1].state[0][1]), ours.tolist()) == (6, 7, [0, 5, 0])


@pytest.mark.parametrize("answer", [256, -1, None, "x", 1.5])
def test_a_device_read_that_returns_no_byte_is_refused(answer):
    board = Board(Stage("xy", visuals=False))
    board.add_device(0x500, read=lambda port: answer, name="odd")
    with pytest.raises(ArgumentError, match=rf"odd: its read\(500h\) returned {answer!r}; .* 0 to FFh"):
        board.in8(0x500)


def test_cycles_of_8_and_16_bits_reach_a_device_and_are_traced(adc):
    board, written = Board(Stage("xy", visuals=False)), []
    describe = lambda port, value, writes: f"{'set' if writes else 'is'} {value}"  # noqa: E731
    board.add_device(
        range(0x340, 0x344), lambda port: port & 0xFF, lambda *both: written.append(both), name="io", describe=describe
    )
    board.add_device(range(0x360, 0x364), source=adc, width=16, encoders=[Encoder("y", per_turn=4)], name="wide")
    board.out16(0x342, 0xABCD)
    assert written == [(0x342, 0xCD), (0x343, 0xAB)]
    assert [board.in16(0x340), board.in16(0x362), board.in8(0x362), board.in8(0x363)] == [0x4140, 0x1234, 0x34, 0x12]
    board.out8(0x363, 0x56)
    text = board.trace.text()
    assert "342h W CDh    io: set 205" in text
    assert "341h R 41h    io: is 65" in text
    assert "362h R 1234h  wide: port 1 = 1234h" in text
    assert "363h R 12h    wide: port 1 = 1200h" in text
    assert "363h W 56h    wide: port 1 <- 56FFh" in text
    assert board.ports[0x362] == "wide, port 1"
    assert [c.port for c in board.strays] == [0x363], "half a register"


def test_devices_and_chips_share_no_port_and_say_who_has_it(adc):
    board = Board(Stage("xy", visuals=False))
    board.add_device(0x500, name="first")
    table = board.port_table
    for ports, message in (
        (0x301, "port 301h is taken: x address 1"), ([0x4FF, 0x500], "port 500h is taken: first, port 0"), ([], "one at least"),
        (-1, "whole numbers from 0 to FFFFFFFFh"), (1 << 32, "FFFFFFFFh"), ([5, 5], "each port once"), (1.5, "ports="),
        ("x", "ports="),
    ):  # fmt: skip
        with pytest.raises(ArgumentError, match=message):
            board.add_device(ports, name="second")
    with pytest.raises(ArgumentError, match="each register takes two ports"):
        board.add_device([0x600, 0x602], width=16)
    with pytest.raises(ArgumentError, match="width=32"):
        board.add_device(0x600, width=32)
    with pytest.raises(ArgumentError, match="it has 1 ports, and 2"):
        board.attach_device(OutputLatch(), [0x600, 0x601])
    with pytest.raises(ArgumentError, match="is on a board already"):
        board.attach_device(board.devices[0], 0x600)
    with pytest.raises(ArgumentError, match="unknown axis 'q'"):
        board.add_device(0x600, encoders=[Encoder("q", per_turn=4)])
    with pytest.raises(ArgumentError, match="either per_metre= or per_turn="):
        Encoder("x", per_turn=4, per_metre=5)
    with pytest.raises(ArgumentError, match="state="):
        board.add_device(0x600, state=[1, 2])
    with pytest.raises(ArgumentError, match="read=5"):
        board.add_device(0x600, read=5)
    assert board.port_table is table
    assert len(board.devices) == 1
    assert board.stage.device_state.words == 1
    board.add_device([0xF0000000, 0x4FF], read=lambda port: 3, name="far")
    assert (board.in8(0xF0000000), board.in8(0x4FF), board.in8(0x500), board.in8(0x4FE)) == (3, 3, 0xFF, 0xFF)
    assert board.port_table.nbytes < 2000


def test_a_device_answers_bus_cycles_but_cannot_start_any():
    board = Board(Stage("xy", visuals=False))
    board.add_device(0x500, read=lambda port: board.in8(0x300), name="loop")
    with pytest.raises(StageError, match="loop answers a bus cycle"):
        board.in8(0x500)
    board.add_device(0x501, read=lambda port: board.add_device(0x502) and 1, name="builder")
    with pytest.raises(StageError, match="Put devices on it before"):
        board.in8(0x501)
    assert board.in8(0x502) == 0xFF


@pytest.mark.parametrize("isolated", [False, True])
def test_within_its_cycle_a_device_neither_lets_time_pass_nor_puts_another_state_in_its_place(isolated):
    """board.add_device(0x500, read=lambda port: stage.restore(snapshot) or 1)"""
    stage = Stage("xy", visuals=False)
    board, requested, refused = Board(stage), [], []
    acts = (
        lambda: stage.restore(snapshot), stage.reset, lambda: stage.run(1e-3), stage.step, lambda: stage.run_to(10**9), stage.cycle,
        lambda: stage.run_until(lambda: False, 1.0), lambda: stage.place(x=0.01), lambda: board.out8(0x300, 0x11),
        lambda: board.delay_us(5), lambda: host.run(), lambda: host.run_for(1.0), lambda: host.close(),
        lambda: stage.chips[0].write(0, 0x11),
    )  # fmt: skip

    def read(port):
        requested.append(stage.now)
        try:
            acts[len(requested) - 1]()
        except StageError as error:
            refused.append(str(error))
        return stage.now != requested[-1]

    board.add_device(0x500, read=read, name="mine")
    snapshot = stage.snapshot()
    library = firmware(
        f"PULSESTAGE_MAIN {{ int n = 0; for (int k = 0; k < {len(acts)}; k++) n += ps_in8(0x500); return n; }}"
    )
    with NativeHost(library, board, isolated=isolated) as host:
        assert host.run().code == 0
    assert (len(requested), board.cycles, stage.now) == (len(acts), len(acts), 1000 * len(acts))
    assert len(refused) == len(acts)
    assert {text.split(":")[0] for text in refused} == {"mine answers a bus cycle"}
    stage.restore(snapshot)
    assert stage.now == 0


@pytest.mark.parametrize("isolated", [None, False, True])
def test_the_cycle_that_a_device_in_python_fails_in_is_the_last_line_of_the_trace(isolated):
    """board.add_device(range(0x500, 0x504), read=lambda port: 1 // 0, width=16)"""
    board = Board(Stage("xy", visuals=False))
    board.add_device(range(0x500, 0x504), read=lambda port: 1 // 0, write=lambda port, value: 1 // 0, width=16)
    for cycle, direction, value, width in (("in16(0x500)", "R", 0xFFFF, 16), ("out16(0x502, 0x1234)", "W", 0x1234, 16)):
        run = partial(eval, f"board.{cycle}", {"board": board})
        if isolated is not None:
            run = NativeHost(firmware(f"PULSESTAGE_MAIN {{ ps_{cycle}; return 0; }}"), board, isolated=isolated).run
        with pytest.raises(ZeroDivisionError):
            run()
        last = list(board.trace)[-1]
        assert (last.direction, last.value, last.width, last.times) == (direction, value, width, 1)
        assert last.port == (0x500 if direction == "R" else 0x502)
        assert last.meaning == "the device here, in Python, has raised an error"
        assert round(last.seconds * 1e9) == board.stage.now == 1000 * board.cycles
    assert len(board.trace) == board.cycles == 2


def test_devices_are_added_before_firmware_runs(adc):
    library = firmware("PULSESTAGE_MAIN { ps_delay_us(1000); return ps_in8(0x500) + ps_in8(0x600); }")
    board = Board(Stage("xy", visuals=False))
    with NativeHost(library, board, isolated=True) as h:
        board.add_device(0x500, read=lambda port: 3)
        assert h.run_for(0.0005) is None
        with pytest.raises(StageError, match="firmware drives this board"):
            board.add_device(0x600)
        assert h.run().code == 3 + 0xFF
        board.add_device(0x600, read=lambda port: 4)
        assert h.run().code == 7


def test_address_latches_keep_what_they_have_when_a_device_comes():
    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    board = Board(stage)
    board.out8(0x300, 0x22)
    board.add_device(0x200)
    board.out8(0x301, 0xA5)
    assert board.in8(0x301) == stage.axes["x"].chip.read(0x22) == 0xA5


def test_what_is_no_device_in_c_is_refused_with_what_to_write(adc, tmp_path):
    board = Board(Stage("xy", chips=PCL240K, visuals=False))
    with pytest.raises(LibraryError, match=r"no pulsestage_device_abi.*PS_DEVICE"):
        board.add_device(0x500, source=firmware("PULSESTAGE_MAIN { return 0; }"))
    (tmp_path / "bad.c").write_text("#include <pulsestage_device.h>\nthis is no C\n")
    with pytest.raises(CompileError, match=r"bad\.c"):
        board.add_device(0x500, source=tmp_path / "bad.c")
    (tmp_path / "text.so").write_text("no library")
    with pytest.raises(LibraryError, match=r"text\.so cannot be loaded"):
        board.add_device(0x500, source=tmp_path / "text.so")
    with pytest.raises(FileError, match=r"gone\.so"):
        board.add_device(0x500, source=tmp_path / "gone.so")
    assert not board.devices


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: Encoder("x", per_turn="2000"), "give either per_metre= or per_turn="),
        (lambda: Encoder("x", per_turn=2000, zero=math.nan), "zero= is the position"),
        (lambda: Device(encoders=["x"]), "encoder 'x': write for example Encoder"),
        (
            lambda: Board(Stage("xy", visuals=False)).attach_device(Device(), list(range(99_999))),
            r"ports=\[0, 1, 2, 3, 4, 5, \.\.\.\]: each",
        ),
        (lambda: Board(Stage("xy", visuals=False), devices=5), "devices=5: a list of texts"),
        (lambda: Board(Stage("xy", visuals=False), devices=[Device()]), r"board\.attach_device\(device, ports\)"),
    ],
)
def test_invalid_devices_are_refused_with_an_explanation(wrong, message):
    """Encoder("x", per_turn="2000"), adc.pull(at=math.nan), Board(stage, devices=[UART()])"""
    with pytest.raises(ArgumentError, match=message):
        wrong()


def test_a_device_in_c_lies_where_the_next_run_removes_what_a_kill_has_left(adc):
    """board.add_device(0x340, source="adc.c")"""
    device = CDevice(adc.with_suffix(".c"))
    folder = device.path.parent
    assert folder.name.startswith(temporary_folders.PREFIX)
    assert (folder / temporary_folders.LOCK).exists()
    del device
    gc.collect()
    assert not folder.exists()


BREAKS = r"""
#include <pulsestage_device.h>
struct it { int64_t n; };
static int follow(volatile int *at) { return *at; }
static uint32_t it_read(struct it *s, const struct ps_moment *at, uint32_t port, int bits)
{
    (void)s, (void)at, (void)bits;
    if (port == 0)
        return (uint32_t)follow((int *)8);
    for (volatile int k = 0;; k++)
        ;
}
PS_DEVICE(struct it, it_read, 0, 0)
"""


def test_crashes_and_loops_of_a_device_in_c_name_the_device(tmp_path):
    """stage run driver.c --device breaks.c:0x340+2"""
    (tmp_path / "breaks.c").write_text(BREAKS)
    board = Board(Stage("xy", visuals=False))
    board.add_device([0x340, 0x341], source=tmp_path / "breaks.c", name="mine")
    body = "PULSESTAGE_MAIN { ps_in8(0x300); return ps_in8(0x340 + PORT); }"
    crashes, loops = (firmware(body, f"-DPORT={n}") for n in (0, 1))
    with NativeHost(crashes, board, isolated=True) as h, pytest.raises(HostError) as failed:
        h.run()
    assert re.search(
        r"in the code of mine \(breaks\.so\), firmware\.so was ended by SIGSEGV .* address 8h.* in follow \(\S*breaks\.c:4\)",
        str(failed.value),
    )
    with NativeHost(loops, board, isolated=True, patience=0.3) as h, pytest.raises(HostError) as failed:
        h.run()
    assert "mine (breaks.so) has computed for 0.3 s of real time in one bus cycle of firmware.so" in str(failed.value)
    assert not crash_report.IS_SUPPORTED or re.search(r"It is in it_read \(\S*breaks\.c:1[01]\)", str(failed.value))


def test_an_error_of_a_description_function_hides_no_cycle():
    """board.add_device(0x500, describe=lambda port, value, writes: 1 // 0)"""
    board = Board(Stage("xy", visuals=False))
    board.add_device(0x500, read=lambda port: 1, describe=lambda port, value, writes: 1 // 0, name="fails")
    board.add_device(
        0x501, read=lambda port: 1, describe=lambda port, value, writes: str(board.in8(0x300)), name="asks"
    )
    board.in8(0x500), board.in8(0x501)
    message = str(board.trace)
    assert "fails: its function describe raised ZeroDivisionError: integer division" in message
    assert (
        "asks: its function describe raised StageError: a describe= function only explains cycles: it makes none"
        in message
    )
    assert board.cycles == 2
    assert board.in8(0x500) == 1


@pytest.mark.parametrize("isolated", [None, False, True])
def test_a_hook_in_python_lets_time_pass_and_neither_restores_a_state_nor_runs_firmware(isolated):
    """board.on_timer(50, lambda: stage.restore(snapshot))"""
    board, refused = Board(Stage("xy", visuals=False)), []
    snapshot = board.stage.snapshot()

    def hook():
        with pytest.raises(StageError, match="timer 0 of Python runs, and what it interrupts goes on") as failed:
            board.stage.restore(snapshot)
        refused.append(str(failed.value))
        if isolated is not None:
            for act in (host.run, host.close):
                with pytest.raises(StageError, match="timer 0 of Python runs"):
                    act()
        board.delay_us(1)

    board.on_timer(50, hook)
    if isolated is None:
        board.delay_us(120)
    else:
        host = NativeHost(firmware("PULSESTAGE_MAIN { ps_delay_us(120); return 0; }"), board, isolated=isolated)
        result = host.run()
        assert result.seconds == 120e-6
    assert (len(refused), board.stage.now) == (2, 120_000)
    board.stage.restore(snapshot)
    assert board.stage.now == 0
