"""Programs for a Cortex-M run untouched: the chips lie in windows of its memory."""

from pathlib import Path

import pytest
from support.target_boards import board_of

from stage import Stage
from stage.board import Board, HostError, HostTimeout, LibraryError
from stage.board.memory_mapped_ports import parse_windows
from stage.chips import PCL240K, PCL240MK
from stage.errors import ArgumentError
from stage.targets import TargetHost, processor_clock_and_bus_cycles, supported_processors
from stage.targets.cortex_m import CortexProgram
from stage.targets.nvic import FIRST, PENDSV, SYSTICK, Nvic

DATA = Path(__file__).parent / "data"
WINDOW = "0x40021000=0x300+0x40"
pytestmark = pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)
(NO_INSTRUCTION, WILD_WRITE, NO_WINDOW, SLEEPS, SVC, INTERRUPT, WAITS, FOR_EVER) = range(1, 9)
WIDE, WRITES_FLASH, INTO_WINDOW, EVEN = range(10, 14)


def faults(case: int, *more: str, isolated: bool = False, **options) -> TargetHost:
    maps = [WINDOW, *more]
    return TargetHost(DATA / "faults.m3.elf", board_of(case), mcu="cortex-m3", map=maps, isolated=isolated, **options)


@pytest.mark.parametrize("isolated", [False, True])
def test_the_exit_value_of_the_program_is_the_exit_code(isolated):
    h = faults(9, isolated=isolated)
    assert [h.run().code, h.run().code] == [9, 9], "the second from its entry again"


@pytest.mark.parametrize(
    ("case", "pattern"),
    [
        (NO_INSTRUCTION, r"an instruction that this processor does not have, at 80[0-9A-F]+h \(no_instruction"),
        (WILD_WRITE, r"it writes memory that is not there, address [0-9A-F]+h, at 80[0-9A-F]+h \(wild_write"),
        (NO_WINDOW, r"it touches address 40021080h, which no window has, at 80[0-9A-F]+h \(no_window"),
        (SLEEPS, r"it sleeps for ever: no interrupt is on .* \(sleeps_for_ever"),
        (SVC, r"exception 11 comes, and its vector is 0h"),
        (WRITES_FLASH, r"it writes to the flash, address 8000100h, at 80[0-9A-F]+h \(writes_flash"),
        (
            INTO_WINDOW,
            r"it jumps into the window 0x40021000=0x300\+0x40, where the chips are and no code "
            r"\(lr is 80[0-9A-F]+h \(jumps_into_window\+[0-9A-F]+h\)\), at 40021000h",
        ),
        (EVEN, r"it jumps to an even address: .* \(lr is 80[0-9A-F]+h \(even_address\+[0-9A-F]+h\)\), at 8000100h"),
    ],
)
def test_a_program_that_cannot_continue_is_reported_with_its_place(case, pattern):
    h = faults(case)
    with pytest.raises(HostError, match=pattern) as error:
        h.run(timeout=1)
    assert f"303h R {case:02X}h" in str(error.value), "after which bus cycle"


def test_the_interrupt_line_comes_between_instructions():
    h = faults(INTERRUPT, "irq=6")
    assert h.run(timeout=1).code == 1
    start, release = list(h.board.trace)[-2:]
    assert (start.value, release.value) == (0x30, 0)
    assert release.seconds - start.seconds == pytest.approx(30 / 1600, abs=1 / 1600)
    counterpart = faults(INTERRUPT)  # without the wire
    with pytest.raises(HostTimeout):
        counterpart.run(timeout=0.03)
    at = next(c for c in counterpart.board.trace if c.value == 0x30).seconds
    assert at == start.seconds


@pytest.mark.parametrize(("length", "reaches"), [(4, True), (3, False)])
def test_a_window_ends_with_its_last_byte(length, reaches):
    """The program reads 303h, whose last byte it is."""
    window = f"0x40021000=0x300+{length}"
    h = TargetHost(DATA / "faults.m3.elf", board_of(9), mcu="cortex-m3", map=window, isolated=False)
    if reaches:
        assert h.run().code == 9
        return
    with pytest.raises(HostError, match="it touches address 40021003h, which no window has"):
        h.run()


def test_systick_counts_the_processor_s_cycles():
    """10 ms are 50 ticks of 200 us, and one that has begun."""
    h = faults(WAITS)
    seconds = h.run(timeout=1).seconds
    assert 0.010 < seconds < 0.0104
    assert [text for _, text in h.board.log] == ["waited"]
    assert faults(WAITS, mcu_clock=36e6).run(timeout=1).seconds == pytest.approx(2 * seconds, rel=0.05)


def test_an_access_that_reaches_beyond_a_window_is_outside():
    """--map 0x40021000=0x300+0x21: a halfword at its last port"""
    maps = ["0x40021000=0x300+0x21"]
    h = TargetHost(DATA / "faults.m3.elf", board_of(WIDE), mcu="cortex-m3", map=maps, isolated=False)
    with pytest.raises(HostError, match="it touches address 40021020h, which no window has"):
        h.run(timeout=1)


@pytest.fixture(scope="module")
def cortex():
    """A processor whose vectors are in its RAM; its program has not begun."""
    built = CortexProgram(DATA / "faults.m3.elf", "cortex-m3", None, parse_windows(WINDOW), None).load(
        board_of(1), False
    )
    built.nvic.vectors = 0x20000000
    built.uc.mem_write(0x20000000 + 4 * SYSTICK, (0x08000101).to_bytes(4, "little"))
    return built


@pytest.mark.parametrize("odd", [0, 4])
def test_the_frame_of_an_exception_is_aligned_and_removed(cortex, odd):
    """The data sheet's xPSR bit 9 says that the stack was 4 bytes lower before"""
    sp = 0x20001000 + odd
    cortex.set_registers(msp=sp, sp=sp, lr=0x08000201, r0=7, xpsr=0x01000000)
    cortex._pc = 0x08000040
    cortex._enter_exception(SYSTICK)
    begin = 0x20001000 - 32
    assert (cortex.get_register("sp"), cortex.get_register("ipsr"), cortex._pc) == (begin, SYSTICK, 0x08000100)
    assert [cortex.read_word(begin + 4 * k) for k in (0, 5, 6)] == [7, 0x08000201, 0x08000040]
    assert cortex.read_word(begin + 28) >> 9 & 1 == (odd != 0)
    cortex.set_registers(r0=0)
    cortex._leave_exception(cortex.get_register("lr"))
    assert (cortex.get_register("sp"), cortex.get_register("ipsr"), cortex.get_register("r0"), cortex._pc) == (
        sp,
        0,
        7,
        0x08000040,
    )


def test_private_registers_can_be_read_by_bytes_and_halfwords(cortex):
    for number, priority in ((4, 0x10), (5, 0x50), (6, 0xA0), (7, 0xF0)):
        cortex._write_private_peripherals(None, 0xE400 + number, 1, priority, None)
    read = lambda at, size: cortex._read_private_peripherals(None, at, size, None)  # noqa: E731
    assert [read(0xE404 + k, 1) for k in range(4)] == [0x10, 0x50, 0xA0, 0xF0]
    assert [read(0xE404, 2), read(0xE406, 2), read(0xE404, 4)] == [0x5010, 0xF0A0, 0xF0A05010]


def test_an_alarm_is_not_delayed_by_the_quantum():
    built = CortexProgram(DATA / "faults.m3.elf", "cortex-m3", None, parse_windows(WINDOW), None).load(
        board_of(1), False
    )
    t = built.record
    assert t.quantum > 10
    for ahead in (1, 10, 10 * t.quantum):
        t.alarm = t.cycles + ahead
        processor_clock_and_bus_cycles.poll_from_python.c(t.own)
        assert t.due - t.cycles == min(ahead, t.quantum)


def test_wider_accesses_are_wider_cycles():
    h = faults(WIDE)
    assert h.run().code == -3
    assert [(c.port, c.direction, c.width) for c in list(h.board.trace)[-4:]] == [
        (0x320, "R", 16), (0x320, "W", 16), (0x320, "R", 16), (0x322, "R", 16),
    ]  # fmt: skip


@pytest.mark.parametrize("isolated", [False, True])
def test_a_loop_for_ever_is_paused(isolated):
    with faults(FOR_EVER, isolated=isolated) as h:
        with pytest.raises(HostTimeout, match=r"has not returned after 0\.01 s"):
            h.run(timeout=0.01)
        begin = h.board.stage.now
        assert h.run_for(0.003) is None
        assert h.board.stage.now == begin + 3_000_000


@pytest.mark.slow
def test_a_driver_that_nobody_changed_ends_at_the_same_pulse():
    """scripts/firmware/targets/home_x.c, see test_avr.py."""
    stage = Stage("xy", chips=PCL240MK, visuals=False)
    stage.place(x=-0.119)
    h = TargetHost(DATA / "home_x.m3.elf", Board(stage), mcu="cortex-m3", map=WINDOW, isolated=False)
    assert h.run(timeout=20).code == 0
    assert [text for _, text in h.board.log] == ["homed (0), int has 4 bytes", "moved (0), at 6000"]


@pytest.mark.parametrize(
    ("maps", "pattern"),
    [
        ((), r"where in the memory of the processor are the chips\?"),
        (
            ("0x20000000=0x300+0x40",),
            r"window 0x20000000=0x300\+0x40: real memory is there \(of 20000000h to 200FFFFFh\)",
        ),
        (("0xE0001000=0x300+0x40",), "has no memory for it there"),
        (("0xFFFFFFE0=0x300+0x40",), "has no memory for it there"),
        ((WINDOW, "irq=240"), "say once irq=0 to irq=239"),
        (("irq",), "say once irq=0"),
    ],
)
def test_an_invalid_memory_map_is_refused(maps, pattern):
    board = Board(Stage("xy", chips=PCL240K, visuals=False))
    with pytest.raises(ArgumentError, match=pattern):
        TargetHost(DATA / "faults.m3.elf", board, mcu="cortex-m3", map=maps, isolated=False)


def test_a_program_of_another_machine_is_named():
    board = Board(Stage("xy", chips=PCL240K, visuals=False))
    with pytest.raises(LibraryError, match=r"was built for AVR, and cortex-m3 is an ARM \(32 bit\)"):
        TargetHost(DATA / "faults.avr.elf", board, mcu="cortex-m3", map=WINDOW, isolated=False)


def nvic(*enabled: int) -> Nvic:
    built = Nvic(lambda: 0, 6)
    built.write(0xE100, sum(1 << n for n in enabled), 4, 0)
    return built


def test_the_lowest_number_of_the_lowest_priority_comes_first():
    n = nvic(3, 4, 5)
    n.write(0xE400 + 4, 0x00004020, 2, 0)  # of 4 and 5
    n.write(0xE400, 0x80 << 24, 1, 3)  # of 3
    n.write(0xE200, 0b111000, 4, 0)
    assert n.read(0xE200) == 0b111000
    order = []
    while (number := n.find_next_exception(0, 0)) is not None:
        n.enter_exception(number)
        n.leave_exception(number)
        order.append(number - FIRST)
    assert order == [4, 5, 3]


def test_a_higher_priority_preempts_and_others_wait():
    n = nvic(3, 4)
    n.write(0xED20, 0xC0 << 16, 1, 2)  # PendSV
    n.write(0xED04, 1 << 28, 4, 0)
    assert n.find_next_exception(1, 0) is None, "PRIMASK"
    assert n.find_next_exception(0, 0x40) is None, "BASEPRI"
    assert n.find_next_exception(0, 0) == PENDSV
    n.enter_exception(PENDSV)
    assert n.read(0xED04) & 0x1FF == PENDSV
    n.write(0xE200, 1 << 3, 4, 0)
    assert n.find_next_exception(0, 0) == FIRST + 3
    n.enter_exception(FIRST + 3)
    n.write(0xE200, 1 << 4, 4, 0)
    assert n.find_next_exception(0, 0) is None, "of the same priority"
    n.leave_exception(FIRST + 3)
    assert n.get_active_exception() == PENDSV


def test_systick_in_closed_form():
    now = [0]
    n = Nvic(lambda: now[0], None)
    n.write(0xE014, 99, 4, 0)
    n.write(0xE010, 7, 4, 0)
    assert n.find_next_systick_cycle() == 100
    now[0] = 130
    assert (n.read(0xE018), n.find_next_systick_cycle()) == (69, 200)
    assert [n.read(0xE010) >> 16, n.read(0xE010) >> 16] == [1, 0], "COUNTFLAG is cleared by the read"
    n.pend_systick()
    assert n.find_next_exception(0, 0) == SYSTICK
