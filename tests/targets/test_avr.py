"""Programs for AVRs run untouched on simavr: their pins are the bus, their time is the board's."""

import ctypes
import re
import socket
import threading
import time
from pathlib import Path

import pytest
from support.target_boards import board_of

from stage import Stage
from stage.board import Board, HostError, HostTimeout, LibraryError, NativeHost, NoCompilerError
from stage.chips import PCL240MK
from stage.cli import main
from stage.errors import ArgumentError
from stage.targets import TargetHost, supported_processors
from stage.targets.elf import AVR, Elf
from stage.targets.simavr import _Library

DATA = Path(__file__).parent / "data"
FIRMWARE = Path(__file__).parents[2] / "scripts" / "firmware"
PINS = "data=A,address=C:0-3,cs=B0,wr=G0,rd=G1"
NEAR_ORG = -0.119  # m
needs_simavr = pytest.mark.skipif(
    not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
)
(NO_INSTRUCTION, WILD_WRITE, SLEEPS, WATCHDOG, FIGHT, INTERRUPT, FOR_EVER, NOTHING_WAKES) = range(1, 9)
NO_ROUTINE = 10
ADDRESS_SPACE = 1 << 24  # bytes that an address of an AVR reaches, with RAMPZ before Z: of its flash and of its RAM


def faults(case: int, pins: str = PINS, isolated: bool = True, **options) -> TargetHost:
    return TargetHost(DATA / "faults.avr.elf", board_of(case), mcu="atmega2560", map=pins, isolated=isolated, **options)


@needs_simavr
@pytest.mark.parametrize("isolated", [False, True])
def test_what_main_returns_is_the_code(isolated):
    h = faults(9, isolated=isolated)
    result = h.run()
    assert (result.code, result.cycles) == (-9, 1)
    assert [(c.port, c.value) for c in h.board.trace][-1] == (0x303, 9)
    assert h.run().code == -9, "from its entry again"


@needs_simavr
@pytest.mark.parametrize(
    ("case", "pattern"),
    [
        (NO_INSTRUCTION, r"an instruction that this AVR does not have .* at [0-9A-F]+h \(no_instruction"),
        (WILD_WRITE, r"a wild write .* at [0-9A-F]+h \(wild_write"),
        (SLEEPS, r"it sleeps for ever, with interrupts off .* \(sleeps_for_ever"),
        (WATCHDOG, r"the watchdog has come"),
        (
            NOTHING_WAKES,
            r"it sleeps for ever: no interrupt is enabled that could wake it, at [0-9A-F]+h \(nothing_wakes",
        ),
        (
            NO_ROUTINE,
            r"interrupt 20 \(__vector_20\) has come and has no routine in the program: .* at [0-9A-F]+h \(no_routine\+",
        ),
    ],
)
def test_a_program_that_cannot_continue_is_reported_with_its_place(case, pattern):
    h = faults(case)
    with pytest.raises(HostError, match=pattern) as error:
        h.run(timeout=1)
    assert "303h R 0" in str(error.value), "after which bus cycle"
    assert not h.running


class Mallinfo(ctypes.Structure):
    """mallinfo2 of glibc."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost".split()
    )

    def bytes_in_use(self) -> int:
        return self.uordblks + self.hblkhd


@needs_simavr
def test_a_wild_write_hits_memory_reserved_for_simavr():
    mallinfo = ctypes.CDLL(None).mallinfo2
    mallinfo.restype = Mallinfo
    simavr = _Library.instance = _Library(isolated=True)  # for ever: simavr calls its functions
    avr = simavr.make_avr(b"atmega328p")
    before = mallinfo().bytes_in_use()
    simavr.init_avr(avr)
    assert 2 * ADDRESS_SPACE < mallinfo().bytes_in_use() - before < 3 * ADDRESS_SPACE
    simavr.library["avr_terminate"](ctypes.c_void_p(avr))


@needs_simavr
def test_an_error_of_an_isolated_program_reaches_the_caller():
    with pytest.raises(HostError, match=r"wild write .* \(wild_write"):
        faults(WILD_WRITE).run()


@needs_simavr
@pytest.mark.parametrize("isolated", [False, True])
def test_a_loop_without_bus_cycles_takes_time_and_is_paused(isolated):
    h = faults(FOR_EVER, isolated=isolated)
    with h:
        with pytest.raises(HostTimeout, match=r"has not returned after 0\.01 s"):
            h.run(timeout=0.01)
        before = h.board.stage.now
        assert h.run_for(0.005) is None
        assert h.board.stage.now == before + 5_000_000
        assert h.running


@needs_simavr
def test_the_same_run_in_pieces_has_the_same_bits():
    states = []
    for pieces in (1, 37):
        h = faults(INTERRUPT, f"{PINS},irq=D0")
        for _ in range(pieces - 1):
            h.run_for(0.0005)
        result = h.run()
        states.append((result, str(h.board.trace), h.board.stage.data.qpos.tolist()))
    assert states[0] == states[1]


@needs_simavr
def test_the_interrupt_line_preempts_between_instructions():
    """30 pulses of 1600 pps, and the AVR's own timer: /INT comes to it within 3 us."""
    h = faults(INTERRUPT, f"{PINS},irq=D0")
    chip = h.board.stage.axes["x"].chip
    result = h.run(timeout=0.1)
    start = next(c for c in h.board.trace if (c.port, c.value) == (0x300, 0x30))
    assert chip.pins.irq
    took = result.code * 1e-6
    assert took == pytest.approx(30 / 1600, abs=1 / 1600)
    assert h.board.stage.time - start.seconds == pytest.approx(took, abs=20e-6)


@needs_simavr
def test_a_data_port_that_drives_in_a_read_cycle_is_logged():
    h = faults(FIGHT)
    h.run()
    assert [text for _, text in h.board.log] == [
        "port A has output pins while /RD is low: AVR and board both drive the data lines"
    ]


@needs_simavr
def test_without_chip_select_the_other_chip_of_the_board_is_untouched():
    h = faults(9, PINS.replace("cs=B0", "cs=B7"))
    h.run()
    assert h.board.trace.buffer is not None
    assert not [c for c in h.board.trace][12:], "B7 is pulled up: no chip is selected"


@needs_simavr
def test_a_driver_that_nobody_changed_ends_at_the_same_pulse():
    """scripts/firmware/pcl240mk: the same sources in this process and on an ATmega2560."""
    at, logs = [], []
    for target in (False, True):
        stage = Stage("xy", chips=PCL240MK, visuals=False)
        stage.place(x=NEAR_ORG)
        board = Board(stage)
        if target:
            h = TargetHost(DATA / "home_x.avr.elf", board, mcu="atmega2560", map=PINS, isolated=False)
        else:
            sources = [
                FIRMWARE / "hal/hal_pulsestage.c",
                FIRMWARE / "pcl240mk/pcl240.c",
                FIRMWARE / "targets/home_x.c",
            ]
            try:
                h = NativeHost(sources, board, flags=(f"-I{FIRMWARE / 'hal'}", f"-I{FIRMWARE / 'pcl240mk'}"))
            except NoCompilerError as error:
                pytest.skip(str(error))
        assert h.run(timeout=20).code == 0
        at.append(round(stage.axes["x"].commanded / 3.125e-6))
        logs.append([text for _, text in board.log])
    assert at[0] == at[1] != 0
    assert logs == [[f"homed (0), int has {n} bytes", "moved (0), at 6000"] for n in (4, 2)]


@pytest.mark.parametrize(
    ("pins", "pattern"),
    [
        ((), r"an AVR's bus is its pins; say once which: --map data=A.* \(given: none\)"),
        ("data=A,wr=G0,rd=G1,x=3", r"unknown part 'x'.*Known: address, base, cs"),
        ("data=A,wr=G0", "it has no rd="),
        ("data=I,wr=G0,rd=G1", "data=I is no port; ports are A, B, "),
        ("data=A,wr=G8,rd=G1", "wr=G8 is no pin, for example wr=B0"),
        ("data=A,wr=G0,rd=G0", "pin G0 is used twice"),
        ("data=A,wr=G0,wr=G1,rd=G2", "wr is given twice"),
        ("data=A,wr=G0,rd=G1,address=C:3-0", "runs backwards"),
        ("data=A,wr=G0,rd=G1,base=x", "base=X is no port"),
    ],
)
@needs_simavr
def test_an_invalid_memory_map_is_refused(pins, pattern):
    with pytest.raises(ArgumentError, match=pattern):
        faults(0, pins)


@needs_simavr
def test_a_port_that_the_avr_does_not_have_is_named(tmp_path):
    content = bytearray((DATA / "faults.avr.elf").read_bytes().replace(b"atmega2560\0", b"atmega328p\0"))
    content[36] = 5  # its architecture
    (tmp_path / "small.elf").write_bytes(content)
    with pytest.raises(Exception, match="this AVR has no port A"):
        TargetHost(tmp_path / "small.elf", board_of(), mcu="atmega328p", map=PINS, isolated=False)


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        (
            {"mcu": "atmega256"},
            r"mcu 'atmega256' is not known. Is it atmega2560\? Known are\n.*atmega328p.*\n.*cortex-m3.*8086",
        ),
        ({"mcu": "atmega2560", "mcu_clock": 0}, "mcu_clock=0: Hz of the processor's clock"),
        ({"mcu": "atmega2560", "mcu_clock": 999}, "mcu_clock=999: Hz of the processor's clock, 1e3 to 1e9"),
        ({"mcu": "atmega2560", "mcu_clock": 1_000_000_001}, "mcu_clock=1000000001"),
        ({"mcu": "atmega2560", "gdb": 1023}, "gdb=1023: a TCP port, 1024 to 65535"),
        ({"mcu": "atmega2560", "gdb": 65536}, "gdb=65536"),
        ({"mcu": "atmega2560", "gdb": 80}, "gdb=80: a TCP port"),
    ],
)
def test_inconsistent_options_are_refused(options, pattern):
    with pytest.raises(ArgumentError, match=pattern):
        TargetHost(DATA / "faults.avr.elf", board_of(), map=PINS, **options)


@needs_simavr
def test_a_file_of_another_machine_names_the_machine(tmp_path):
    (tmp_path / "text.elf").write_text("hello")
    (tmp_path / "other.elf").write_bytes(b"\x7fELF\x01\x01\x01" + bytes(9) + b"\x02\x00\x28\x00" + bytes(40))
    for name, pattern in (
        ("text.elf", "is no ELF file"),
        ("other.elf", r"was built for ARM \(32 bit\), and atmega2560 is an AVR"),
    ):
        with pytest.raises(LibraryError, match=pattern):
            TargetHost(tmp_path / name, board_of(), mcu="atmega2560", map=PINS, isolated=False)
    with pytest.raises(LibraryError, match=r"was built for AVR, and this is .*--mcu atmega2560"):
        NativeHost(DATA / "faults.avr.elf", board_of())


def test_without_simavr_the_error_names_the_package(monkeypatch):
    supported_processors.load_simavr.cache_clear()
    monkeypatch.setattr(supported_processors, "_SIMAVR_FILES", ("libnothing.so",))
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    try:
        with pytest.raises(supported_processors.NoEmulatorError, match="apt install libsimavr2"):
            faults(0)
    finally:
        supported_processors.load_simavr.cache_clear()


@needs_simavr
def test_the_command_runs_it(capsys):
    requested = [
        str(DATA / "faults.avr.elf"),
        "--mcu",
        "atmega2560",
        "--map",
        PINS,
        "--model",
        "xy",
        "--mcu-clock",
        "8e6",
    ]
    assert main(["run", *requested]) == 0
    assert "faults.avr.elf returned 0 after 0.00" in capsys.readouterr().out
    assert main(["run", "driver.c", "--mcu-clock", "8e6"]) == 2
    assert "--mcu-clock: only programs of other processors have it" in capsys.readouterr().err


def command(gdb: socket.socket, text: str) -> bytes:
    """A command of GDB's remote protocol, and the answer's packet."""
    gdb.sendall(f"${text}#{sum(text.encode()) & 0xFF:02x}".encode())
    answer = b""
    while not re.search(rb"\$[^#]*#..$", answer):
        answer += gdb.recv(1024)
    gdb.sendall(b"+")
    return answer


@needs_simavr
@pytest.mark.slow
def test_a_debugger_attaches_before_the_first_instruction():
    """A breakpoint at main: the program halts there, time stands still, and it goes on."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    h = faults(9, gdb=port)
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(h.run(timeout=1).code))
    thread.start()
    for _ in range(200):
        try:
            gdb = socket.create_connection(("127.0.0.1", port), timeout=10)
            break
        except ConnectionRefusedError:
            time.sleep(0.05)
    with gdb:
        assert h.board.cycles == 12, "only those of the test"
        main_at = Elf(DATA / "faults.avr.elf", AVR, "", "").symbols["main"]
        assert b"OK" in command(gdb, f"Z0,{main_at:x},2")
        assert re.search(rb"[TS]05", command(gdb, "c"))
        begin = h.board.stage.now
        assert b"OK" in command(gdb, f"z0,{main_at:x},2")
        assert (h.board.cycles, h.board.stage.now) == (12, begin)
        gdb.sendall(b"$c#63")
        thread.join(20)
    assert codes == [-9]
