"""What each frame does to the board, and what it is refused for: the limits themselves, and one beyond."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from support.odd_names import odd_model

from stage import Stage, StageError
from stage.board import Board, HostError
from stage.chips import HCTL1100, PCL240K
from stage.errors import ArgumentError
from stage.serve import client
from stage.serve.frame_execution import MAX_LINE_BYTES, MAX_NAME_BYTES, MAX_SNAPSHOTS, FrameExecutor, describe_error

PORT = 0x300
LAST_PORT = 0xFFFFFFFF


class Frames:
    """A machine, and frames to it by their names."""

    def __init__(self, board, **options):
        self.reports, self.called = [], []
        self.machine = FrameExecutor(
            board, hook=self.called.append, report=lambda seconds, text: self.reports.append((seconds, text)), **options
        )

    def __getattr__(self, name):
        return lambda body=b"": self.machine.handlers[getattr(client, name)](body)

    def batch(self, *entries):
        """entries: (what, a, b) or (what, a, b, times, every, mask)"""
        packed = b"".join(client.ENTRY.pack(e[0], *(*e[3:], 0, 0, 0)[:3], *e[1:3]) for e in entries)
        answers = self.BATCH(packed)
        return [a for (a,) in client.ANSWER.iter_unpack(answers)]

    def delay(self, us):
        self.batch((client.DELAY, us, 0))


@pytest.fixture
def frames(board):
    return Frames(board)


def test_about_has_units_ports_and_the_bus_cycle():
    """a hinge among the axes, chips from a port of their own on, a device, and a cycle that is no whole number of us"""
    stage = Stage("xya", chips=PCL240K, visuals=False, bus_cycle=1.1e-6)
    board = Board(stage, base=0x340, stride=16, devices=["ls7166:0x500:y"])
    about = json.loads(FrameExecutor(board).describe_board())
    assert about["axes"] == {"x": "m", "y": "m", "a": "rad"}
    assert [chip["port"] for chip in about["chips"]] == [p.first for p in board.places] == [0x340, 0x350, 0x360]
    assert [chip["axes"] for chip in about["chips"]] == ["x", "y", "a"]
    assert about["devices"] == [{"device": board.devices[0].name, "ports": [0x500, 0x501]}]
    assert about["bus_cycle_ns"] == 1100


def test_timers_and_the_interrupt_line_are_released_after_a_host(frames):
    """all four timers and the hook of the line; then the host is gone"""
    for n in range(client.TIMERS):
        frames.TIMER(client.TIMING.pack(n, 1, 1_000_000))
    frames.HOOK(client.WORD.pack(1))
    frames.delay(1000)
    assert sorted(frames.called) == [1, 2, 3, 4]
    frames.machine.remove_hooks()
    frames.called.clear()
    frames.delay(10_000)
    frames.machine.reset_to_start()
    frames.delay(10_000)
    assert frames.called == []
    assert not frames.machine.board.link.hooks.functions


def test_each_timer_calls_with_its_number_at_its_period(frames):
    """timer 2 every 700 us and timer 0 every 1.5 ms, at a level of 15; a period of the longest, and one ns beyond"""
    frames.TIMER(client.TIMING.pack(2, 15, 700_000))
    frames.TIMER(client.TIMING.pack(0, 2, 1_500_000))
    frames.delay(1600)
    assert frames.called == [3, 3, 1]
    frames.TIMER(client.TIMING.pack(0, 1, 10**18))
    with pytest.raises(ArgumentError, match=r"a period of 1000000000000000001 ns; there are 1 to 1e18, and 0 for off"):
        frames.TIMER(client.TIMING.pack(0, 1, 10**18 + 1))
    with pytest.raises(ArgumentError, match="a period of -1 ns"):
        frames.TIMER(client.TIMING.pack(0, 1, -1))
    with pytest.raises(ArgumentError, match=r"TIMER: 15 bytes; it has 16\."):
        frames.TIMER(bytes(15))
    with pytest.raises(ArgumentError, match=r"n=4: timers of a board"):
        frames.TIMER(client.TIMING.pack(4, 1, 1000))
    with pytest.raises(ArgumentError, match=r"level=16: levels of hooks are 1 to 15"):
        frames.TIMER(client.TIMING.pack(1, 16, 1000))


def test_timers_start_again_with_a_restore(frames):
    """a timer of 10 ms; a state of 6 ms later, to which it goes back: the next tick is 10 ms from there; another was put off"""
    frames.TIMER(client.TIMING.pack(1, 1, 10_000_000))
    frames.TIMER(client.TIMING.pack(3, 1, 1_000_000))
    frames.TIMER(client.TIMING.pack(3, 1, 0))
    frames.delay(6000)
    frames.SNAPSHOT(b"six")
    frames.delay(1000)
    frames.RESTORE(b"six")
    frames.delay(9000)
    assert frames.called == []
    frames.delay(2000)
    assert frames.called == [2]


def test_a_timer_that_came_while_a_line_was_waited_for_calls_at_the_end_of_the_wait(frames):
    """a timer of 30 us, and 50 us in which the interrupt line is not asserted"""
    frames.TIMER(client.TIMING.pack(1, 1, 30_000))
    assert frames.batch((client.UNTIL_LINE, 50, 0)) == [0]
    assert frames.called == [2]


def test_restore_is_refused_within_a_hook(board):
    """a timer's hook restores the start"""
    message = []

    def hook(source):
        with pytest.raises(StageError, match=r"RESTORE: not from within an interrupt hook\.") as refused:
            machine.handlers[client.RESTORE](b"start")
        message.append(str(refused.value))

    machine = FrameExecutor(board, hook=hook)
    machine.handlers[client.TIMER](client.TIMING.pack(0, 1, 1_000_000))
    machine.handlers[client.BATCH](client.ENTRY.pack(client.DELAY, 0, 0, 0, 1500, 0))
    assert len(message) == 1
    assert client.STATUS_REPLY.unpack(machine.handlers[client.STATUS](b""))[0] == 1_500_000


def test_the_reset_pin_is_that_of_every_chip(frames):
    """both axes move; reset"""
    for port in (PORT, PORT + 4):
        for register, value in ((0, 100), (1, 50), (7, 30)):
            frames.batch(
                (client.OUT8, port, 0x80 | register),
                *((client.OUT8, port + 1 + k, value >> 8 * (2 - k) & 0xFF) for k in range(3)),
            )
        frames.batch((client.OUT8, port, 0x44), (client.OUT8, port, 0x10))
    operating = [frames.batch((client.IN8, port, 0))[0] & 0x40 for port in (PORT, PORT + 4)]
    frames.RESET()
    assert operating == [0x40, 0x40]
    assert [frames.batch((client.IN8, port, 0))[0] & 0x40 for port in (PORT, PORT + 4)] == [0, 0]
    with pytest.raises(ArgumentError, match=r"RESET: 1 bytes; it has no body\."):
        frames.RESET(b"!")


def test_the_number_of_snapshots_is_limited_and_names_can_be_reused(frames):
    for k in range(MAX_SNAPSHOTS):
        frames.SNAPSHOT(b"%d" % k)
    with pytest.raises(ArgumentError, match=f"{MAX_SNAPSHOTS} are kept"):
        frames.SNAPSHOT(b"one more")
    frames.delay(77)
    frames.SNAPSHOT(b"5")
    frames.delay(5)
    frames.RESTORE(b"5")
    assert client.STATUS_REPLY.unpack(frames.STATUS())[0] == 77_000


def test_a_state_is_not_changed_by_what_comes_after_it():
    """an HCTL-1100: the latch has one address in the state, another after it; restored twice"""
    board = Board(Stage("xyz_servo", chips=HCTL1100, visuals=False))
    frames, latch = Frames(board), board.places[0].first
    frames.batch((client.OUT8, latch, 0x22))
    frames.SNAPSHOT(b"here")
    for value in (0x11, 0x12):
        frames.batch((client.OUT8, latch, 0x20))
        frames.RESTORE(b"here")
        frames.batch((client.OUT8, latch + 1, value))
        values = board.stage.chips[0].values()
        assert values["R22"] == value
        assert values["R20"] not in (0x11, 0x12)


def test_names_and_lines_have_a_maximum_size(frames):
    largest = b"n" * MAX_NAME_BYTES
    frames.SNAPSHOT(largest)
    frames.RESTORE(largest)
    for name in (b"", largest + b"n"):
        with pytest.raises(
            ArgumentError, match=rf"SNAPSHOT: a name of {len(name)} bytes; it has 1 to {MAX_NAME_BYTES}\."
        ):
            frames.SNAPSHOT(name)
    with pytest.raises(ArgumentError, match=r"PIN: a name that is no UTF-8\."):
        frames.PIN(b"x.\xff")
    frames.LOG(b"l" * MAX_LINE_BYTES)
    assert len(frames.reports[-1][1]) == MAX_LINE_BYTES
    with pytest.raises(ArgumentError, match=r"LOG: 65,537 bytes; a line has up to 65,536"):
        frames.LOG(b"l" * (MAX_LINE_BYTES + 1))


def test_a_log_line_is_reported_with_its_time(board):
    frames = Frames(board, keep=4)
    for k in range(7):
        frames.delay(10)
        frames.LOG(b"a\tline %d\r\n" % k)
    assert [text for _, text in frames.reports] == [f"a\tline {k}" for k in range(7)]
    assert [seconds for seconds, _ in frames.reports] == pytest.approx([1e-5 * (k + 1) for k in range(7)], abs=1e-12)
    assert [text for _, text in board.log] == ["a\tline 2", "a\tline 3", "a\tline 4", "a\tline 5", "a\tline 6"][
        -len(board.log) :
    ]
    assert 4 <= len(board.log) <= 5


def test_unknown_words_of_a_frame_are_named_with_the_known_ones(frames):
    with pytest.raises(ArgumentError, match=r"HOOK: 2; it takes one of 0, 1\."):
        frames.HOOK(client.WORD.pack(2))
    with pytest.raises(ArgumentError, match=r"HOOK: no u32; it takes one of 0, 1\."):
        frames.HOOK(b"")
    with pytest.raises(ArgumentError, match=r"STICK: 3; it takes one of 0, 1, 2\."):
        frames.STICK(client.WORD.pack(3) + b"x.org")
    with pytest.raises(ArgumentError, match=r"STATUS: 2 bytes; it has no body\."):
        frames.STATUS(b"no")
    with pytest.raises(ArgumentError, match=r"POSITIONS: 2 bytes; it has no body\."):
        frames.POSITIONS(b"no")


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ((client.DELAY, 10**15 + 1, 0), "DELAY 1000000000000001 us; there are 0 to 1e15 us"),
        ((client.UNTIL_LINE, -1, 0), "UNTIL_LINE -1 us; there are 0 to 1e15 us"),
        ((client.SPEND, 10**18 + 1, 0), "SPEND 1000000000000000001 ns; there are 0 to 1e18 ns"),
        ((client.IN16, LAST_PORT + 1, 0), "IN16 at port 4294967296; ports are 0 to FFFFFFFFh"),
        ((client.OUT8, LAST_PORT, 256), "OUT8 FFFFFFFFh <- 256; the value does not fit the cycle"),
        ((client.OUT16, PORT, 65536), "OUT16 300h <- 65536; the value does not fit the cycle"),
        ((client.OUT32, PORT, 1 << 32), "OUT32 300h <- 4294967296; the value does not fit the cycle"),
        ((client.OUT8, PORT, -1), "OUT8 300h <- -1; the value does not fit the cycle"),
        ((client.UNTIL8, PORT, 0, 0, 3, 1), "UNTIL8 0 times, every 3 us; it takes 1 time or more, every 0 us or more"),
        (
            (client.UNTIL16, PORT, 0, 2, -3, 1),
            "UNTIL16 2 times, every -3 us; it takes 1 time or more, every 0 us or more",
        ),
    ],
)
def test_an_invalid_entry_is_reported_with_its_index_and_limits(frames, entry, words):
    """two that are right, then this one: nothing of the batch is done"""
    before = frames.STATUS()
    right = (client.IN8, 0x500, 0)
    with pytest.raises(ArgumentError) as refused:
        frames.batch(right, right, entry, right)
    assert str(refused.value) == f"BATCH, entry 2: {words}. Nothing of this batch was done."
    assert frames.STATUS() == before


def test_an_entry_at_its_limit_is_accepted(frames):
    """the largest values, the last port, no time at all"""
    assert frames.batch(
        (client.OUT8, LAST_PORT, 255), (client.OUT16, 0x500, 65535), (client.OUT32, 0x500, (1 << 32) - 1),
        (client.IN8, LAST_PORT, 0), (client.IN8, 0, 0), (client.DELAY, 0, 0), (client.SPEND, 0, 0), (client.UNTIL_LINE, 0, 0),
        (client.UNTIL8, 0x500, 0, 1, 0, 0), (client.UNTIL16, 0x500, 0xFFFF, 1, 0, 0xFFFF),
    )[3:] == [0xFF, 0xFF, 0, 0, 0, 0xFF, 0xFFFF]  # fmt: skip


def test_a_read_until_has_its_number_of_reads_and_interval(frames):
    """three looks 5 us apart are 3 cycles and 2 waits; one that finds what it waits for is one cycle"""

    def now_and_cycles():
        return client.STATUS_REPLY.unpack(frames.STATUS())[:2]

    cycle = round(frames.machine.board.stage.bus_cycle * 1e9)
    for what in (client.UNTIL8, client.UNTIL16):
        time, cycles = now_and_cycles()
        frames.batch((what, 0x500, 0, 3, 5, 1))
        assert now_and_cycles() == (time + 3 * cycle + 10_000, cycles + 3)
        frames.batch((what, 0x500, 1, 3, 5, 1))
        assert now_and_cycles() == (time + 4 * cycle + 10_000, cycles + 4)


def test_a_pin_of_the_axis_comes_before_one_of_the_chip_and_every_name_is_offered(frames):
    x = frames.machine.board.stage.axes["x"]
    pins = x.pins.as_dict()
    assert pins
    for name, value in pins.items():
        assert frames.PIN(f"x.{name}".encode()) == client.ANSWER.pack(value)
    with pytest.raises(ArgumentError, match="unknown axis ''"):
        frames.PIN(b".org")
    x.switches.stick("org", True)
    assert frames.PIN(b"x.switches.org") == client.ANSWER.pack(1)
    assert frames.PIN(b"y.switches.org") == client.ANSWER.pack(0)
    for name, how in (
        (b"x.switches.org", client.RELEASED),
        (b"x.org", client.ASSERTED),
        (b"x.switches.org", client.CLEARED),
    ):
        frames.STICK(client.WORD.pack(how) + name)
        assert frames.PIN(b"x.switches.org") == client.ANSWER.pack(how == client.ASSERTED)


def test_positions_are_of_every_axis_and_each_number_at_its_place(frames):
    axes = {name: SimpleNamespace(position=k + 0.1, commanded=k + 0.2, lost_steps=4 * k) for k, name in enumerate("xy")}
    frames.machine.board = SimpleNamespace(stage=SimpleNamespace(axes=axes))
    assert list(client.PLACE.iter_unpack(frames.POSITIONS())) == [(0.1, 0.2, 0), (1.1, 1.2, 4)]


def test_other_errors_are_described_with_their_type():
    assert describe_error(StageError("so it is.")) == "so it is."
    assert describe_error(HostError("a host did it.")) == "a host did it."
    assert describe_error(KeyError("k")) == "KeyError: 'k'"


def test_pins_and_switches_belong_to_an_axis_with_dots_in_its_name():
    stage = Stage(odd_model(("a.b", "x")), chips=PCL240K, visuals=False)
    frames = Frames(Board(stage))
    for place, name in ((b"a.b", "a.b"), (b"x", "x")):
        assert frames.PIN(place + b".hold") == client.ANSWER.pack(1)
        with pytest.raises(ArgumentError, match=f"unknown switch of axis {name} 'org'"):
            frames.PIN(place + b".switches.org")
    with pytest.raises(ArgumentError, match=r"unknown axis 'a'.*Write AXIS\.PIN or AXIS\.switches\.SWITCH"):
        frames.PIN(b"a.org")
