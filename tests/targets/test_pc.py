"""Programs of DOS run untouched: IN and OUT are the board's, time is that of an 8088."""

import struct
from pathlib import Path

import pytest
from support.target_boards import board_of

from stage import Stage
from stage.board import Board, HostError, HostTimeout, LibraryError
from stage.chips import MCX304, PCL240K, PCL240MK
from stage.errors import ArgumentError
from stage.support.files import FileError
from stage.targets import NoEmulatorError, TargetHost, supported_processors
from stage.targets.pc_timer import PcTimer

DATA = Path(__file__).parent / "data"
needs_unicorn = pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)
(NO_INSTRUCTION, DIVIDES, HALTS, KEY, FUNCTION, INTERRUPT, TICKS, FOR_EVER) = range(1, 9)
EXIT = "B44C CD21"


def faults(case: int, isolated: bool = False, irq: str = "irq=5") -> TargetHost:
    return TargetHost(DATA / "faults.com", board_of(case), mcu="8086", map=irq, isolated=isolated)


def com(tmp_path: Path, code: str, board: Board | None = None, name: str = "it.com", **options) -> TargetHost:
    """A .COM of these bytes."""
    (tmp_path / name).write_bytes(bytes.fromhex(code))
    return TargetHost(tmp_path / name, board or board_of(), mcu="8086", isolated=False, **options)


@needs_unicorn
@pytest.mark.parametrize("isolated", [False, True])
def test_a_program_prints_and_returns(isolated):
    h = faults(9, isolated)
    assert (h.run().code, [text for _, text in h.board.log]) == (9, ["it runs"])
    assert h.run().code == 9, "from its entry again"


@needs_unicorn
@pytest.mark.parametrize(
    ("case", "pattern"),
    [
        (NO_INSTRUCTION, r"an instruction that this processor does not have, at 1000:0135 \(offset 135h"),
        (DIVIDES, "a division by 0"),
        (HALTS, "it halts for ever, with interrupts off"),
        (KEY, "it waits for a key"),
        (FUNCTION, r"it asks DOS for function 5Fh \(INT 21h\)"),
    ],
)
def test_a_program_that_cannot_continue_is_reported_with_its_place(case, pattern):
    h = faults(case)
    with pytest.raises(HostError, match=pattern) as error:
        h.run(timeout=1)
    assert f"303h R 0{case}h" in str(error.value), "after which bus cycle"


@needs_unicorn
def test_the_interrupt_line_comes_between_instructions():
    """30 pulses of 1600 pps; the routine of IRQ5 lets go of the line within 30 us."""
    h = faults(INTERRUPT)
    assert h.run(timeout=1).code == 1
    start, release = list(h.board.trace)[-2:]
    assert (start.value, release.value) == (0x30, 0)
    counterpart = board_of(INTERRUPT)
    for cycle in list(h.board.trace)[13:-1]:
        counterpart.stage.run_to(round(cycle.seconds * 1e9) - 1000)
        counterpart.out8(cycle.port, cycle.value)
    took = counterpart.stage.run_until(lambda: counterpart.interrupt, timeout=0.1, poll=1e-6)
    assert 0 < release.seconds - start.seconds - took < 40e-6


@needs_unicorn
def test_without_a_wire_no_interrupt_comes():
    with pytest.raises(HostTimeout):
        faults(INTERRUPT, irq=()).run(timeout=0.05)


@needs_unicorn
def test_the_timer_s_routine_comes_18_2_times_a_second():
    h = faults(TICKS)
    result = h.run(timeout=1)
    assert result.code == 5, "int 1Ah counts them, too"
    assert result.seconds == pytest.approx(5 * 65536 / 1_193_182, abs=1e-4)


@needs_unicorn
@pytest.mark.parametrize("isolated", [False, True])
def test_a_loop_for_ever_is_paused(isolated):
    with faults(FOR_EVER, isolated) as h:
        with pytest.raises(HostTimeout, match=r"has not returned after 0\.01 s"):
            h.run(timeout=0.01)
        begin = h.board.stage.now
        assert h.run_for(0.003) is None
        assert h.board.stage.now == begin + 3_000_000


@needs_unicorn
@pytest.mark.slow
def test_a_driver_that_nobody_changed_ends_at_the_same_pulse():
    """scripts/firmware/targets/home_x.c, see test_avr.py."""
    stage = Stage("xy", chips=PCL240MK, visuals=False)
    stage.place(x=-0.119)
    h = TargetHost(DATA / "home_x.com", Board(stage), mcu="8086", isolated=False)
    assert h.run(timeout=20).code == 0
    assert [text for _, text in h.board.log] == ["homed (0), int has 4 bytes", "moved (0), at 6000"]


@needs_unicorn
def test_words_are_cycles_of_16_bits(tmp_path):
    board = Board(Stage("xy", chips={"x": MCX304, "y": PCL240K}, visuals=False), base={"x": 0x300, "y": 0x340})
    h = com(tmp_path, f"BA0803 B83412 EF ED {EXIT}", board)  # mov dx,308h; mov ax,1234h; out dx,ax; in ax,dx
    h.run()
    assert [(c.direction, c.width) for c in board.trace] == [("W", 16), ("R", 16)]


@needs_unicorn
def test_a_delay_of_the_bios_takes_its_time(tmp_path):
    h = com(tmp_path, f"B486 B90100 BA0000 CD15 {EXIT}")  # 65,536 us
    assert h.run().seconds == pytest.approx(0.065536, abs=1e-4)


@needs_unicorn
def test_the_clock_says_how_long_an_instruction_takes(tmp_path):
    code = f"B9E803 49 75FD {EXIT}"  # 1000 times dec cx, jnz: 8 + 4 and 8 + 8 cycles
    for clock in (4_772_727, 1_000_000):
        assert com(tmp_path, code, mcu_clock=clock).run().seconds == pytest.approx(28_000 / clock, rel=0.01)


@needs_unicorn
def test_the_last_output_of_a_program_needs_no_line_end(tmp_path):
    h = com(tmp_path, f"B402 B24F CD21 B24B CD21 {EXIT}")
    h.run()
    assert [text for _, text in h.board.log] == ["OK"]


@needs_unicorn
def test_a_com_has_as_many_bytes_as_its_segment_has_room_for(tmp_path):
    code = bytes.fromhex(EXIT.replace(" ", ""))
    (tmp_path / "full.com").write_bytes(code.ljust(0xFE00, b"\0"))
    TargetHost(tmp_path / "full.com", board_of(), mcu="8086", isolated=False).run()
    (tmp_path / "more.com").write_bytes(code.ljust(0xFE01, b"\0"))
    with pytest.raises(LibraryError, match=r"has 65,025 bytes: a \.COM has 1 to 65,024"):
        TargetHost(tmp_path / "more.com", board_of(), mcu="8086", isolated=False)


@needs_unicorn
def test_an_exe_is_relocated(tmp_path):
    """mov ax, seg data; mov ds, ax; mov al, [0]; mov ah, 4Ch; int 21h"""
    code = bytes.fromhex("B80100 8ED8 A00000 B44C CD21".replace(" ", "")).ljust(16, b"\0") + bytes([77]) + bytes(15)
    size = 32 + len(code)
    head = struct.pack("<2s13H", b"MZ", size % 512, 1, 1, 2, 0, 0xFFFF, 0, 0x400, 0, 0, 0, 0x1C, 0)
    head = (head[:0x1C] + struct.pack("<HH", 1, 0)).ljust(32, b"\0")
    (tmp_path / "it.exe").write_bytes(head + code)
    assert TargetHost(tmp_path / "it.exe", board_of(), mcu="8086", isolated=False).run().code == 77
    after = head[:0x1C] + struct.pack("<HH", len(code) - 1, 0) + head[0x20:]
    (tmp_path / "behind.exe").write_bytes(after + code)
    with pytest.raises(LibraryError, match=r"behind.exe is damaged: relocation 0 points behind its end"):
        TargetHost(tmp_path / "behind.exe", board_of(), mcu="8086", isolated=False)
    (tmp_path / "cut.exe").write_bytes((head + code)[:40])
    with pytest.raises(LibraryError, match=r"cut.exe is no .EXE of DOS, or is cut off"):
        TargetHost(tmp_path / "cut.exe", board_of(), mcu="8086", isolated=False)


@needs_unicorn
def test_files_that_are_no_programs_are_refused(tmp_path):
    (tmp_path / "empty.com").write_bytes(b"")
    (tmp_path / "it.elf").write_bytes(b"\x7fELF\x01\x01\x01" + bytes(9) + b"\x02\x00\x53\x00" + bytes(40))
    (tmp_path / "it.c").write_text("int main(void) { return 0; }")
    for name, error, pattern in (
        ("it.c", LibraryError, r"it\.c is a source by its name.*nasm -f bin it\.asm"),
        ("empty.com", FileError, "is empty, and no program"),
        ("it.elf", LibraryError, r"was built for AVR \(ELF\), and an 8086 runs a .COM or an .EXE"),
        ("none.com", FileError, "there is no program"),
    ):
        with pytest.raises(error, match=pattern):
            TargetHost(tmp_path / name, board_of(), mcu="8086", isolated=False)
    with pytest.raises(FileError, match=r"there is no program .*none\.com"):  # from the process of the program as well
        TargetHost(tmp_path / "none.com", board_of(), mcu="8086").run()


@needs_unicorn
def test_a_map_that_a_pc_does_not_have_is_refused():
    with pytest.raises(ArgumentError, match="reaches the board by IN and OUT; of it only irq=2 to irq=7"):
        faults(0, irq="irq=9")


def test_without_unicorn_the_error_names_the_package(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(NoEmulatorError, match=r"pip install -e '\.\[targets\]'"):
        faults(0)


def test_a_counter_is_read_as_it_was_latched():
    now = [0]
    timers = PcTimer(lambda: now[0])
    for port, value in ((0x43, 0x34), (0x40, 0xE8), (0x40, 0x03)):  # channel 0, mode 2, 1000
        timers.write(port, value)
    now[0] = 300
    timers.write(0x43, 0x00)
    now[0] = 555
    assert timers.read(0x40) | timers.read(0x40) << 8 == 700
    assert timers.read(0x40) | timers.read(0x40) << 8 == 445
    assert timers.find_next_zero() == 1000
    for port, value in ((0x43, 0xB0), (0x42, 100), (0x42, 0), (0x61, 1)):  # channel 2, mode 0
        timers.write(port, value)
    assert not timers.read(0x61) & 0x20
    now[0] += 100
    assert timers.read(0x61) & 0x20


@needs_unicorn
def test_what_a_program_has_printed_before_it_fails_is_in_the_log_also_without_a_line_end(tmp_path):
    """mov dl, 'a'; mov ah, 2; int 21h; hlt with interrupts off"""
    h = com(tmp_path, "B261B402CD21 FA F4".replace(" ", ""))
    with pytest.raises(HostError, match="it halts for ever"):
        h.run(timeout=1)
    assert [text for _, text in h.board.log] == ["a"]
