"""A board is the chips' own bus cycles behind port numbers: nothing is lost and nothing added, from Python and from C."""

from __future__ import annotations

import copy
import dataclasses
import random

import pytest
from support.compiled_firmware import PLAYER, firmware
from support.many_axes import rail_model
from support.vcd_parser import parse

from stage import Stage, faults
from stage.board import LAYOUTS, Board, NativeHost, StormError
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MK, PCL240MS, Chip
from stage.errors import ArgumentError, StageError

IN8, OUT8, IN16, OUT16, DELAY = range(5)


def pcl240_traffic(rng: random.Random, n: int) -> list[tuple[int, int, int]]:
    """Draw bus cycles of moves of three PCL-240 chips, and random ones: (what, a, b) of ports from 300h."""
    program: list[tuple[int, int, int]] = []
    for k in range(3):
        port = 0x300 + 4 * k
        for register, value in ((0, 900), (1, 60), (2, 700), (4, 200), (5, 200), (7, 300), (6, 300)):
            program += [(OUT8, port, 0x80 | register)]
            program += [(OUT8, port + 1 + byte, value >> 8 * byte & 0xFF) for byte in (2, 1, 0)]
        program += [(OUT8, port, 0x44 | rng.choice((0, 8))), (OUT8, port, 0x35)]
    for _ in range(n):
        kind = rng.random()
        port = 0x300 + rng.randrange(12)
        if kind < 0.5:
            program += [(IN8, port, 0)] * rng.choice((1, 1, 7, 60))
        elif kind < 0.6:
            program.append((OUT8, port & ~3, rng.choice((0x15, 0x10, 0x1D, 0x18, 0x08, 0x80, 0x86, 0xC0, 0x44))))
        elif kind < 0.7:
            program.append((OUT8, port | 1, rng.randrange(256)))
        elif kind < 0.75:
            program.append((rng.choice((IN8, IN16)), rng.choice((0x2FF, 0x30C, 0x1000)), 0))
        elif kind < 0.8:
            program.append((IN16, port, 0))
        elif kind < 0.82:
            program.append((OUT16, port & ~3 | 1, rng.randrange(1 << 16)))
        else:
            program.append((DELAY, rng.choice((0, 1, 3, 40, 250, 251, 4000)), 0))
    return program


def by_hand(stage: Stage, program: list[tuple[int, int, int]]) -> list[int]:
    """Make the bus cycles of a program on the chips themselves."""
    chips, answers = [axis.chip for axis in stage.axes.values()], []

    def reach(port: int, value: int | None = None) -> int:
        k, address = divmod(port - 0x300, 4)
        if not 0 <= k < 3:
            stage.cycle()
            return 0xFF
        return chips[k].read(address) if value is None else chips[k].write(address, value) or 0

    for what, a, b in program:
        if what == DELAY:
            stage.run(a * 1e-6)
        elif what == IN8:
            answers.append(reach(a))
        elif what == OUT8:
            reach(a, b)
        elif what == OUT16:
            reach(a, b & 0xFF), reach(a + 1, b >> 8)
        elif 0x300 <= a < 0x30C:
            answers.append(reach(a) | reach(a + 1) << 8)
        else:
            stage.cycle()  # the bus makes one of it: nobody says that he has 8 bits only
            answers.append(0xFFFF)
    return answers


def everything(stage: Stage) -> tuple:
    """Return all state that a run may change."""
    return stage.snapshot().state.tobytes(), [chip.diagnostics for chip in stage.chips]


@pytest.mark.parametrize("chips", [PCL240K, PCL240MS], ids=lambda c: c.__name__)
def test_hosts_in_c_and_python_and_direct_access_give_the_same_bits(chips, monkeypatch, tmp_path):
    library = firmware(PLAYER)
    for seed in range(3):
        print("seed", seed)
        program = pcl240_traffic(random.Random(seed), 400)
        reference, python, native = (Stage("xyz", chips=chips, visuals=False) for _ in range(3))
        with reference.record() as expected:
            answers = by_hand(reference, program)
        with python.record() as recording:
            board = Board(python)
            requested = [board.link.make_request(*request) for request in program]
        assert [v for v, (what, _, _) in zip(requested, program, strict=True) if what in (IN8, IN16)] == answers
        assert everything(python) == everything(reference)
        (tmp_path / "program").write_text("".join(f"{what} {a} {b}\n" for what, a, b in program))
        monkeypatch.setenv("PLAYER_PROGRAM", str(tmp_path / "program"))
        with native.record() as from_c:
            board = Board(native)
            result = NativeHost(library, board).run()
        assert result.code == len(program)
        assert [int(text) for _, text in board.log] == answers
        assert everything(native) == everything(reference)
        for name, column in expected.columns.items():
            assert column.tobytes() == recording.columns[name].tobytes() == from_c.columns[name].tobytes(), name
        for name, journal in expected.journals.items():
            edges = journal.replay_waveforms().edges.tobytes()
            assert recording.journals[name].replay_waveforms().edges.tobytes() == edges
            assert from_c.journals[name].replay_waveforms().edges.tobytes() == edges
        assert any(chip.diagnostics for chip in reference.chips), "the program is meant to have mistakes in it"


def test_chips_may_have_any_port_up_to_the_last():
    """Board(base={x: 300h, y: F0000000h, z: FFFFFFFCh}): ports far beyond 16 bits, with memory for a dozen of them"""
    stage = Stage("xyz", visuals=False)
    board = Board(stage, base={"x": 0x300, "y": 0xF0000000, "z": 0xFFFFFFFC})
    assert board.port_table.nbytes < 1000
    for port, axis in ((0x300, "x"), (0xF0000000, "y"), (0xFFFFFFFC, "z")):
        board.out8(port, 0x80)  # register 0
        board.out8(port + 1, ord(axis))
        assert board.in8(port + 1) == ord(axis)
        assert stage.axes[axis].chip.values()["R0"] == ord(axis)
        assert board.ports[port] == f"{axis} address 0"
        assert [board.in8(p) for p in (port - 1, port + 4 & 0xFFFFFFFF)] == [0xFF, 0xFF]
    assert "FFFFFFFDh R 7Ah    z: R0 bits 7..0 = 7Ah" in str(board.trace)
    assert len(board.strays) == 6
    spaced = Board(Stage("xyz", visuals=False), base=0x40000000, stride=0x10000)
    spaced.out8(0x40020000, 0x80)
    spaced.out8(0x40020001, 0x55)
    assert spaced.in8(0x40020001) == 0x55
    assert [f"{port:X}" for port in spaced.ports][::4] == ["40000000", "40010000", "40020000"]
    near = Board(Stage("xyz", visuals=False), stride=8)  # with holes between chips
    near.out8(0x310, 0x80)
    near.out8(0x311, 0x55)
    assert (near.in8(0x311), near.in8(0x314), near.in8(0x308)) == (0x55, 0xFF, near.in8(0x300))
    assert [c.port for c in near.strays] == [0x314]


def test_a_port_that_reaches_nothing_reads_as_ffh_takes_a_cycle_and_has_a_diagnostic():
    stage = Stage("xyz", visuals=False)
    board = Board(stage)
    assert board.in8(0x200) == 0xFF
    assert board.in16(0x30C) == 0xFFFF
    board.out8(0x2FF, 1)
    assert stage.time == pytest.approx(3e-6)
    assert [(c.port, c.direction, c.value) for c in board.strays] == [
        (0x200, "R", 0xFF),
        (0x30C, "R", 0xFFFF),
        (0x2FF, "W", 1),
    ]


def test_the_oldest_line_of_a_full_trace_still_counts_a_repeated_read():
    """Board(stage, keep_cycles=3): in8 of 304h, 300h, 308h, 304h"""
    board = Board(Stage("xyz", visuals=False), keep_cycles=3)
    for port in (0x304, 0x300, 0x308, 0x304):
        board.in8(port)
    assert [(c.port, c.times) for c in board.trace] == [(0x304, 2), (0x300, 1), (0x308, 1)]
    assert board.trace.dropped == 0
    for port in (0x200, 0x304):  # and one that has gone from the ring does not
        board.in8(port)
    assert [(c.port, c.times) for c in board.trace] == [(0x308, 1), (0x200, 1), (0x304, 1)]
    assert board.trace.dropped == 2


def test_polling_a_port_that_reaches_nothing_is_one_line_with_a_count():
    board = Board(Stage("xyz", visuals=False))
    for port in (0x304, *[0x200] * 5, 0x304):
        board.in8(port)
    for _ in range(3):
        board.in16(0x30C)
    assert [(c.port, c.times, c.stray) for c in board.trace] == [(0x304, 2, False), (0x200, 5, True), (0x30C, 3, True)]


def test_each_layout_reaches_its_chip():
    stage = Stage("xyz", chips=PCL240MK, visuals=False)
    board = Board(stage, base={"x": 0x200, "y": 0x300, "z": 0x210})
    board.out8(0x300, 0x82)
    board.out8(0x301, 0x34)
    board.out8(0x302, 0x12)
    assert stage.axes["y"].chip.values()["R2"] == 0x1234
    assert board.in16(0x301) == stage.axes["y"].chip.read(1) | stage.axes["y"].chip.read(2) << 8, (
        "two cycles, the low byte first"
    )

    stage = Stage("xyz", chips=MCX304, visuals=False)
    board = Board(stage, base=0x400)
    board.out16(0x40C, 4321)
    board.out16(0x400, 0x0105)
    assert stage.chips[0].read(0) == board.in16(0x400)
    counterpart = MCX304()
    counterpart.write(6, 4321)
    counterpart.write(0, 0x0105)
    assert counterpart.state["ax"][0]["reg"].tolist() == stage.chips[0].state["ax"][0]["reg"].tolist()
    assert board.in8(0x400) | board.in8(0x401) << 8 == board.in16(0x400)

    stage, counterpart = Stage("xyz", chips=MCX514, visuals=False), MCX514()
    board = Board(stage, layout="nova-8bit")
    for byte, value in ((12, 0x34), (13, 0x12), (1, 1), (0, 5)):  # WR6 = 1234h; WR0: the low byte acts
        board.out8(0x300 + byte, value)
        counterpart.write_byte(byte, value)
    assert stage.chips[0].state["ax"][0]["reg"].tolist() == counterpart.state["ax"][0]["reg"].tolist()
    assert 0x1234 in counterpart.state["ax"][0]["reg"]

    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    board = Board(stage)
    board.out8(0x302, 0x22)
    board.out8(0x303, 99)
    assert stage.axes["y"].chip.values()["R22"] == 99
    board.out8(0x300, 0x22)
    assert (board.in8(0x301), board.in8(0x303)) == (0x40, 99), "each chip has a latch of its own"

    before = stage.snapshot()
    board.out8(0x302, 0x07)
    assert board.in8(0x303) != 99
    stage.restore(before)
    assert board.in8(0x303) == 99, "a latch is part of the stage's state"
    counterpart = Board(copy.deepcopy(stage))
    assert counterpart.in8(0x303) == 99
    stage.reset()
    assert board.in8(0x303) == stage.axes["y"].chip.values()["R00"]


def test_half_a_register_of_a_16_bit_chip_has_a_diagnostic():
    stage = Stage("xyz", chips=MCX304, visuals=False)
    board = Board(stage)
    board.out8(0x30C, 0x21)
    assert [c.port for c in board.strays] == [0x30C]
    assert int(stage.chips[0].state["data_low"]) == 0xFF21, "the other half of the bus floats"
    board.out8(0x30D, 0x43)
    assert int(stage.chips[0].state["data_low"]) == 0x43FF
    assert (board.in8(0x308), board.in8(0x309)) == (0xFF, 0xF7)
    board.out16(0x30C, 0x4321)
    low, high, *levels, complete = [c.meaning for c in board.trace]
    assert [low, high, complete] == [f"xyz: data 15..0 = {word}h" for word in ("FF21", "43FF", "4321")], (
        "as the chip has it"
    )
    assert "Y-" not in levels[0]
    assert "X-" not in levels[1], "what was not read is not said"


def test_chips_of_two_families_have_consecutive_ports():
    stage = Stage("xyz_servo", chips={"x": HCTL1100, "z": PCL240K}, visuals=False)
    board = Board(stage)
    assert [(stage.chips[p.index], p.first) for p in board.places] == [
        (stage.axes["x"].chip, 0x300),
        (stage.axes["z"].chip, 0x302),
    ]
    board.out8(0x302, 0x81)
    board.out8(0x303, 77)
    assert stage.axes["z"].chip.values()["R1"] == 77


def test_a_card_has_a_port_with_the_interrupts_of_its_chips():
    stage = Stage("xyz", chips=PCL240K, visuals=False)
    board = Board(stage, layout="pcl240-card")
    assert board.in8(0x34C) == 0
    assert "interrupts: none" in str(board.trace)
    start(board, 0x344, 3)
    start(board, 0x348, 1)
    board.delay_us(100_000)
    assert (board.in8(0x34C), board.interrupt) == (0b110, True)
    fewer = Board(Stage("xy", chips=PCL240K, visuals=False), layout="pcl240-card")
    start(fewer, 0x344, 3)
    fewer.delay_us(100_000)
    assert fewer.in8(0x34C) == 0b10, "the card has room for three, whatever is on it"
    with pytest.raises(ArgumentError, match="room for 3 chips, and this stage has 4"):
        Board(Stage(rail_model(4), chips=PCL240K, visuals=False), layout="pcl240-card")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"layout": "nova"}, "PCL240K"),
        ({"layout": "pcl420"}, "pcl240"),
        ({"base": -4}, "ports are"),
        ({"base": 0xFFFFFFFD}, "FFFFFFFFh, and the chip takes 4"),
        ({"base": 768.0}, "whole numbers"),
        ({"base": 0xFFFFFFF8}, "base=0x100000000"),
        ({"stride": 2}, "two things"),
        ({"base": {"x": 0x300}}, "axis y"),
        ({"base": {"q": 0x300}}, "q"),
    ],
)
def test_a_board_that_cannot_be_says_why(settings, message):
    with pytest.raises(ArgumentError, match=message):
        Board(Stage("xyz", visuals=False), **settings)


def test_a_board_in_whose_place_another_came_is_refused():
    stage = Stage("xy", visuals=False)
    first = Board(stage)
    first.in8(0x300)
    second = Board(stage)
    for act in (lambda: first.in8(0x300), lambda: first.delay_us(1), lambda: NativeHost(firmware(PLAYER), first).run()):
        with pytest.raises(
            StageError, match=r"has got another board since, and a stage has one: .* Board\(copy\.copy\(stage\)\)"
        ):
            act()
    assert second.in8(0x300) != 0xFF
    assert Board(copy.copy(stage)).in8(0x300) == second.in8(0x300), "a copy is another stage"


class Foreign(Chip):
    """A chip that is none of the families."""

    MAP, CORE, INPUTS, OUTPUTS = PCL240K.MAP, PCL240K.CORE, PCL240K.INPUTS, PCL240K.OUTPUTS
    DEFAULT_CLOCK_HZ, BUSY, COUNTER = 4_915_200, PCL240K.BUSY, PCL240K.COUNTER
    _configure, make_describer, EXTENDED, S_CURVES = PCL240K._configure, PCL240K.make_describer, False, False


def test_a_chip_from_outside_has_a_port_for_each_of_its_addresses():
    # Board(Stage("xy", chips=Foreign))
    stage = Stage("xy", chips=Foreign, visuals=False)
    board = Board(stage)
    board.out8(0x304, 0x08)
    assert (board.in8(0x300), board.in8(0x304), len(board.ports)) == (0xA8, 0xA8, 8)
    assert "y: reset command" in board.trace.text()
    with pytest.raises(ArgumentError, match=r"layout nova: .*Foreign.*without layout=, or a Layout of yours"):
        Board(stage, layout="nova")

    class Wide(Foreign):
        DATA_MASK = 0xFFFF

    assert len(Board(Stage("xy", chips=Wide, visuals=False)).ports) == 16


def test_every_layout_can_be_looked_up_and_lies_where_it_says():
    for layout in LAYOUTS.values():
        assert layout.stride >= len(layout.ports)
        assert layout.evidence in "SI"


# --- interrupts ---


def moving(stage: Stage, pulses: int = 400) -> Board:
    """Make a board whose x chip makes `pulses` at a constant rate and then asserts the interrupt line."""
    board = Board(stage)
    start(board, 0x300, pulses)
    return board


def start(board: Board, port: int, pulses: int) -> None:
    for register, value in ((0, pulses), (1, 800), (7, 300)):
        board.out8(port, 0x80 | register)
        for byte in (2, 1, 0):
            board.out8(port + 1 + byte, value >> 8 * byte & 0xFF)
    board.out8(port, 0x44)
    board.out8(port, 0x30)


def test_an_interrupt_comes_within_a_delay_at_the_very_nanosecond():
    stage = Stage("xyz", visuals=False)
    board = moving(stage)
    chip, observed = stage.axes["x"].chip, []

    def hook():
        observed.append((stage.now, chip.pins.irq))
        board.out8(0x300, 0x00)

    board.on_interrupt(hook)
    begin = stage.now
    board.delay_us(2_000_000)
    assert stage.now == begin + 2_000_000_000, "the hook's time is part of the delay"
    assert [on for _, on in observed] == [True]
    counterpart = Stage("xyz", visuals=False)
    moving(counterpart)
    counterpart.run_to(observed[0][0] - 1)
    assert not counterpart.axes["x"].chip.pins.irq
    counterpart.run_to(observed[0][0])
    assert counterpart.axes["x"].chip.pins.irq
    calls = [(c.direction, c.meaning) for c in board.trace if c.port is None]
    assert calls == [("I", "interrupt: the hook is called"), ("i", "interrupt: the hook returns")]
    lines = list(board.trace)
    for n in range(len(lines) + 1):
        assert list(board.trace.last(n)) == lines[len(lines) - n :]


def test_interrupts_change_nothing_but_what_their_hook_does():
    reference, watched = Stage("xyz", visuals=False), Stage("xyz", visuals=False)
    for stage in (reference, watched):
        board = moving(stage)
        if stage is watched:
            board.on_interrupt(lambda board=board: board.on_interrupt(None))
        board.delay_us(1_500_000)
    assert watched.snapshot().state.tobytes() == reference.snapshot().state.tobytes()


def test_an_interrupt_that_nobody_clears_is_an_error_with_the_cycles_before_it():
    """board.on_interrupt(lambda: None): "called 1,000 times in a row", and it was 1,001 times"""
    stage = Stage("xyz", visuals=False)
    board = moving(stage)
    calls = []
    board.on_interrupt(lambda: calls.append(1))
    with pytest.raises(StormError, match="clear the interrupt") as failure:
        board.delay_us(2_000_000)
    assert f"was called {len(calls):,} times in a row" in str(failure.value)
    board.on_interrupt(None)
    board.out8(0x300, 0x00)
    assert not board.interrupt


def test_a_hook_may_write_to_a_chip_itself_and_the_recording_can_be_saved(tmp_path):
    """board.on_interrupt(lambda: stage.axes["x"].chip.write(0, 0)) while it was recorded: "the stage went back in time" """
    columns = []
    for hand in (False, True):
        stage = Stage("xyz", visuals=False)
        with stage.record(every=0.25e-3) as recording:
            board = moving(stage)
            chip = stage.axes["x"].chip
            write = (lambda chip=chip: chip.write(0, 0)) if hand else (lambda board=board: board.out8(0x300, 0))
            board.on_interrupt(write)
            board.delay_us(2_000_000)
        recording.to_vcd(tmp_path / f"{hand}.vcd")
        columns.append({name: c.tobytes() for name, c in recording.columns.items()})
    assert columns[0] == columns[1]
    by_hand, by_bus = (parse(tmp_path / f"{hand}.vcd").changes for hand in (True, False))
    chips = {
        name for name in by_bus if not name.startswith("host.")
    }  # the host's bus does not see what is written by hand
    assert chips
    assert {name: by_hand[name] for name in chips} == {name: by_bus[name] for name in chips}


@pytest.mark.parametrize("us", [2**63 // 1000 + 1, -1, 10**16])
def test_a_delay_that_no_clock_holds_is_refused(us):
    """board.delay_us(2**63//1000+1) did nothing"""
    board = Board(Stage("xyz", visuals=False))
    with pytest.raises(ArgumentError, match="a delay takes 0 to 1e15 us"):
        board.delay_us(us)
    assert board.micros == 0


def test_an_error_in_a_hook_reaches_the_host():
    board = moving(Stage("xyz", visuals=False))

    def hook():
        raise KeyError("mine")

    board.on_interrupt(hook)
    with pytest.raises(KeyError, match="mine"):
        board.delay_us(2_000_000)
    board.on_interrupt(None)
    before = board.micros
    board.delay_us(5)
    board.out8(0x300, 0x82)
    board.out8(0x301, 9)
    assert (board.micros - before, board.stage.axes["x"].chip.values()["R2"] & 0xFF) == (7, 9), "and the bus goes on"


def test_base_and_stride_say_where_each_chip_lies_and_16_bits_are_two_cycles_the_low_byte_first():
    stage = Stage("xy", chips=PCL240K, visuals=False)
    board = Board(stage, base=0x240, stride=8)
    assert sorted(board.ports) == [*range(0x240, 0x244), *range(0x248, 0x24C)]
    assert (board.ports[0x24A], board.in8(0x244)) == ("y address 2", 0xFF)
    assert str(board) == "<Board x at 240h (pcl240), y at 248h (pcl240); 1 cycles>"
    board.out8(0x248, 0x81)
    board.out16(0x249, 0x0203)
    assert stage.axes["y"].chip.values()["R1"] == 0x0203
    assert [(c.direction, c.port, c.value, c.width) for c in board.trace][-2:] == [
        ("W", 0x249, 0x03, 8),
        ("W", 0x24A, 0x02, 8),
    ]
    assert (board.cycles, board.micros) == (4, 4)


def test_words_at_the_last_port_go_on_at_port_0():
    """inpw(0xFFFFFFFF), outpw, and words of 32 bits at 0xFFFFFFFE: the address lines of a bus end there"""
    board = Board(Stage("xy", visuals=False), base={"x": 0xFFFFFFFC, "y": 0})
    board.in16(0xFFFFFFFF)
    board.out16(0xFFFFFFFF, 0x8001)
    board.in32(0xFFFFFFFE)
    board.out32(0xFFFFFFFE, 0)
    ends = [0xFFFFFFFF, 0, 0xFFFFFFFE, 0xFFFFFFFF, 0, 1]
    assert [c.port for c in board.trace] == [*ends[:2], *ends[:2], *ends[2:], *ends[2:]]


def test_a_lost_word_is_marked_in_the_trace():
    stage = Stage("xyz", chips=MCX304, visuals=False)
    board = Board(stage)
    with faults.lost_write(stage.axes["x"]):
        for _ in range(2):
            board.out16(0x30C, 0x4321)
    assert ["lost on the way" in c.meaning for c in board.trace] == [True, False]


def test_each_chip_loses_one_write_of_its_fault():
    stage = Stage("xyz", visuals=False)
    board = Board(stage)
    with faults.lost_write(stage.axes["x"]), faults.lost_write(stage.axes["z"]):
        for port in (0x300, 0x304, 0x308) * 2:
            board.out8(port, 0x81)
            board.out8(port + 1, 7)
    assert [c.port for c in board.trace if "lost on the way" in c.meaning] == [0x300, 0x308]
    assert [axis.chip.values()["R1"] for axis in stage.axes.values()] == [7, 7, 7]


def test_a_full_trace_keeps_the_newest_lines_in_order():
    board = Board(Stage("xy", visuals=False), keep_cycles=4)
    for k in range(11):
        board.out8(0x301, k)
        output = [cycle.value for cycle in board.trace]
        assert output == list(range(k + 1))[-4:]
        assert (len(board.trace), board.trace.dropped) == (len(output), k + 1 - len(output))
        assert ("lines before" in str(board.trace)) == (k >= 4)
    assert [cycle.value for cycle in board.trace.last(2)] == [9, 10]
    lines = board.trace.text(3).splitlines()
    assert lines[1].strip() == "... 8 lines before"
    assert len(lines) == 5
    assert len(board.trace.text().splitlines()) == 6


def test_a_card_of_eight_chips_shows_who_of_them_pulls_the_line():
    """A layout like pcl240-card with eight chips: bits 0 to 7 at its own port"""
    stage = Stage(rail_model(8), chips=PCL240K, visuals=False)
    board = Board(stage, dataclasses.replace(LAYOUTS["pcl240-card"], chips=8))
    card_port = 0x340 + 8 * 4
    for k in (7, 0, 6):
        for name, value in {"R0": 1, "R1": 8000, "R7": 2}.items():
            for address, datum in PCL240K.register_cycles(name, value):
                board.out8(0x340 + 4 * k + address, datum)
        board.out8(0x340 + 4 * k, 0x44)
        board.out8(0x340 + 4 * k, 0x30)
    board.delay_us(100)
    assert board.in8(card_port) == 0b1100_0001


def test_the_repr_of_a_board_has_its_devices():
    board = Board(Stage("xy", chips=PCL240K, visuals=False), base=0x240, stride=8, devices=["latch:0x378"])
    (latch,) = board.devices
    assert str(board) == f"<Board x at 240h (pcl240), y at 248h (pcl240), {latch.name}; 0 cycles>"
