"""Details of a served board: every width of cycle, switches that are mended, greetings, and who is let in."""

from __future__ import annotations

import socket
from contextlib import suppress

import pytest
from serve.test_bad_bytes import reply, wire
from support.served import serving

from stage import Stage, StageError
from stage.board import Board
from stage.chips import HCTL1100
from stage.cli import main
from stage.serve import client, server
from stage.serve.client import HEAD, ServerError


def test_cycles_of_every_width_reach_the_board(served):
    """host.out8, out16 and out32 of a port that has nothing, and their reads"""
    with served.host() as host:
        host.out8(0x500, 0x12), host.out16(0x500, 0x1234), host.out32(0x500, 0x12345678)
        assert [host.in8(0x500), host.in16(0x510), host.in32(0x520)] == [0xFF, 0xFFFF, 0xFFFFFFFF]
        lines = [(c.port, c.direction, c.value, c.width) for c in served.board.trace]
    assert lines == [
        (0x500, "W", 0x12, 8), (0x500, "W", 0x1234, 16), (0x500, "W", 0x5678, 16), (0x502, "W", 0x1234, 16),
        (0x500, "R", 0xFF, 8), (0x510, "R", 0xFFFF, 16), (0x520, "R", 0xFFFF, 16), (0x522, "R", 0xFFFF, 16),
    ]  # fmt: skip


def test_a_switch_sticks_released_or_asserted_until_cleared(served):
    """host.stick of a switch that the carriage presses"""
    stage = served.board.stage
    x = stage.axes["x"]
    x.switches.stick("org", None)
    begin = stage.snapshot()
    with served.host() as host:
        true = host.pin("x.switches.org")
        for held in (not true, true, not true):
            host.stick("x.switches.org", held)
            assert host.pin("x.switches.org") == held
            host.stick("x.org", None)
            assert host.pin("x.switches.org") == true
        stage.place(x=0.156)
        assert host.pin("x.switches.el_plus"), "on the switch"
        host.stick("x.el_plus", False)
        assert not host.pin("x.switches.el_plus")
        host.stick("x.el_plus", None)
        assert host.pin("x.switches.el_plus"), "mended: it is as the carriage presses it"
        for wrong, message in (
            ("x.switches.orgg", "Did you mean 'org'"),
            ("x.switches.as_dict", "unknown switch"),
            ("x", "unknown"),
        ):
            with pytest.raises(ServerError, match=message):
                host.pin(wrong)
    stage.restore(begin)


def test_reads_after_a_restore_are_new_lines_of_the_trace(served):
    with served.host() as host:
        host.in8(0x302)
        host.snapshot("here")
        host.in8(0x302)
        host.restore("here")
        host.in8(0x302)
        assert [c.times for c in served.board.trace] == [2, 1]


def test_a_restore_puts_the_address_latches_back():
    """an HCTL-1100: an address, then its data, each at a port"""
    board = Board(Stage("xyz_servo", chips=HCTL1100, visuals=False))
    latch = board.places[0].first
    with serving(board) as served, served.host() as host:
        host.out8(latch, 0x22)
        host.snapshot("here")
        host.out8(latch, 0x20)
        host.restore("here")
        host.out8(latch + 1, 0x11)
        values = board.stage.chips[0].values()
    assert values["R22"] == 0x11
    assert values["R20"] != 0x11


def greeting(magic=client.MAGIC, version=client.VERSION, role=client.DRIVE, kind=client.HELLO, more=b""):
    body = client.GREETING.pack(magic, version, role) + more
    return HEAD.pack(len(body), kind, 7) + body


def test_only_a_complete_greeting_is_accepted(served):
    """another magic word, a byte more, another kind of frame; then what is right"""
    for text in (greeting(magic=b"PULSEST2"[: len(client.MAGIC)]), greeting(more=b"!"), greeting(kind=client.STATUS)):
        with wire(served, greet=False) as opened:
            opened.sendall(text)
            kind, body = reply(opened)
            assert (kind, body[4:]) == (client.ERROR, b"the first frame has to be HELLO, see docs/serve.md.")
            assert reply(opened) == (client.ERROR, b"")
    with wire(served) as opened:
        for _ in range(2):
            opened.sendall(HEAD.pack(3, client.RETURN, 0) + b"no!")
            kind, body = reply(opened)
            assert (kind, body[4:]) == (client.ERROR, b"RETURN: no hook was called.")
        with served.host(observe=True) as other:
            with pytest.raises(ServerError, match="drives this stage, one host at a time"):
                served.host()
            assert other.status().cycles == 0
        opened.sendall(HEAD.pack(0, 250, 0))
        kind, body = reply(opened)
        assert (kind, body[4:].startswith(b"there is no frame 250: a host that was greeted sends ")) == (
            client.ERROR,
            True,
        )


def test_a_connection_beyond_the_limit_is_closed_at_once(board, monkeypatch):
    monkeypatch.setattr(server, "MAX_CONNECTIONS", 2)
    with (
        serving(board) as served,
        wire(served) as _,
        wire(served, greet=False) as __,
        wire(served, greet=False) as third,
    ):
        assert reply(third) == (client.ERROR, b"")


def test_a_recording_with_fresh_refuses_driving_hosts(board):
    """Server(board, fresh=True) while the stage is recorded: the host is told, and another may look"""
    board.out8(0x300, 0x08)
    with serving(board, fresh=True) as served:
        with board.stage.record():
            board.stage.run(0.001)
            with pytest.raises(ServerError, match="runs forward only"):
                served.host()
            with served.host(observe=True) as observer:
                assert observer.status().seconds > 0
        with served.host() as host:
            assert host.status().seconds < 1e-3


def test_a_hook_that_failed_once_does_not_fail_again(served):
    """a hook that raises, then one that clears the interrupt"""
    port, calls = 0x300, []

    def hook():
        calls.append(1)
        host.out8(port, 0x08)
        if len(calls) == 1:
            raise KeyError("once")

    with served.host() as host:
        host.on_interrupt(hook)
        for _ in range(2):
            batch = host.batch().out8(port, 0x08)
            for register, value in ((0, 5), (1, 50), (7, 30)):
                batch.out8(port, 0x80 | register)
                for byte in (2, 1, 0):
                    batch.out8(port + 1 + byte, value >> 8 * byte & 0xFF)
            batch.out8(port, 0x44).out8(port, 0x30).run()
            if len(calls) == 0:
                with pytest.raises(KeyError, match="once"):
                    host.delay_us(100_000)
            else:
                host.delay_us(100_000)
    assert len(calls) == 2


def test_a_client_counts_its_frames_in_32_bits_and_says_which_end_is_gone(served):
    host = served.host()
    host._number = (1 << 32) - 2
    assert host.in8(0x500) == host.in8(0x500) == 0xFF
    assert host._number == 0
    wire = host._wire.detach()
    socket.close(wire)
    with pytest.raises(ConnectionError, match="this connection is closed"):
        host.in8(0x500)
    with pytest.raises(ValueError, match="an address is HOST:PORT"):
        client.connect("127.0.0.1:7 240")
    assert client.Batch().in8(1) is not None


def test_a_server_refuses_ports_that_do_not_exist(board):
    for port in (-1, 1 << 16):
        with pytest.raises(Exception, match="a TCP port is 0"):
            server.Server(board, port=port)
    if socket.has_ipv6:
        built = None
        with suppress(StageError):  # this machine has it, and no address
            built = server.Server(board, "::1", 0)
        if built is not None:
            assert built.address[0] == "::1"
            built._listener.close()


@pytest.mark.parametrize(
    "option", [("--record", "x.rrd"), ("--vcd", "x.vcd"), ("--view",), ("--web",), ("--picture", "x.png")]
)
def test_fresh_and_recording_options_exclude_each_other(option, capsys):
    """stage serve --fresh --record x.rrd"""
    nowhere = ["--bind", "192.0.2.1"]  # of no machine: whoever is not refused does not serve either
    assert main(["serve", "--fresh", *nowhere, *option]) == 2
    assert "--fresh puts the stage back to its start for each host" in capsys.readouterr().err


def test_a_batch_outside_a_run_is_refused():
    with pytest.raises(ValueError, match=r"."):
        client.Batch().in8(0x300).run()
