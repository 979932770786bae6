"""Who is let in, who waits, who is asked first, and what is left when somebody goes or the server ends."""

from __future__ import annotations

import errno
import socket
import threading
import time
from types import SimpleNamespace

import pytest
from serve.test_bad_bytes import GREETING, reply, wire
from serve.test_server import again
from support.served import serving

from stage.errors import ArgumentError, StageError
from stage.serve import client, server
from stage.serve.client import HEAD, ServerError


def frame(kind, body=b"", number=0):
    return HEAD.pack(len(body), kind, number) + body


def entries(*value):
    return b"".join(client.ENTRY.pack(what, 0, 0, 0, a, b) for what, a, b in value)


def head_and_body(opened):
    head = b""
    while len(head) < HEAD.size:
        head += opened.recv(HEAD.size - len(head))
    length, kind, number = HEAD.unpack(head)
    body = b""
    while len(body) < length:
        body += opened.recv(length - len(body))
    return kind, number, body


def test_replies_and_errors_carry_the_number_of_their_request(served):
    """STATUS as number 7, an unknown frame as 8, a batch that is refused as 9, two frames in one piece as 10 and 11"""
    with wire(served) as opened:
        opened.sendall(frame(client.STATUS, number=7) + frame(77, number=8) + frame(client.BATCH, b"!", number=9))
        opened.sendall(frame(client.STATUS, number=10) + frame(client.RESET, number=11))
        reported = [head_and_body(opened)[:2] for _ in range(5)]
    assert reported == [
        (client.STATUS, 7),
        (client.ERROR, 8),
        (client.ERROR, 9),
        (client.STATUS, 10),
        (client.RESET, 11),
    ]


def test_an_observer_may_send_only_the_documented_frames(served):
    with served.host(observe=True) as host:
        for kind, body in ((client.STATUS, b""), (client.POSITIONS, b""), (client.PIN, b"x.org")):
            assert host.request(kind, body)
        for kind in (
            client.BATCH,
            client.LOG,
            client.HOOK,
            client.RESET,
            client.SNAPSHOT,
            client.RESTORE,
            client.STICK,
            client.TIMER,
        ):
            with pytest.raises(ServerError, match=r": this connection only observes; connect with role 0 to drive\."):
                host.request(kind)
        opened = host._wire
        opened.sendall(frame(client.RETURN))
        assert head_and_body(opened)[2][4:] == b"RETURN: no hook was called."


def test_a_return_of_an_observer_does_not_end_the_hook(served):
    """while a hook of the driver is being called, another connection says RETURN"""
    with served.host(observe=True) as observer, wire(served) as drives:
        drives.sendall(frame(client.TIMER, client.TIMING.pack(0, 1, 1000)))
        assert head_and_body(drives)[0] == client.TIMER
        drives.sendall(frame(client.BATCH, entries((client.DELAY, 1, 0))))
        assert head_and_body(drives)[0] == client.INTERRUPT
        observer._wire.sendall(frame(client.RETURN, b"mine"))
        assert head_and_body(observer._wire)[2][4:] == b"RETURN: no hook was called."
        drives.sendall(frame(client.TIMER, client.TIMING.pack(0, 1, 0)))
        assert head_and_body(drives)[0] == client.TIMER, "the hook goes on, and may ask"
        drives.sendall(frame(client.RETURN))
        assert head_and_body(drives)[0] == client.BATCH
        drives.sendall(frame(client.RETURN))
        assert head_and_body(drives)[2][4:] == b"RETURN: no hook was called."


def test_when_a_hook_has_returned_the_next_frame_waits_for_the_end_of_the_batch_again(served):
    """a batch with one tick of a timer, then 300,000 cycles; STATUS comes right behind the RETURN"""
    poll = client.ENTRY.pack(client.UNTIL8, 300_000, 0, 1, 0x500, 0)
    with wire(served) as opened:
        opened.sendall(frame(client.TIMER, client.TIMING.pack(0, 1, 1000)))
        assert head_and_body(opened)[0] == client.TIMER
        opened.sendall(frame(client.BATCH, entries((client.DELAY, 1, 0)) + poll))
        assert head_and_body(opened)[0] == client.INTERRUPT
        opened.sendall(frame(client.TIMER, client.TIMING.pack(0, 1, 0)) + frame(client.RETURN) + frame(client.STATUS))
        assert [head_and_body(opened)[0] for _ in range(3)] == [client.TIMER, client.BATCH, client.STATUS]


def test_a_host_that_cannot_begin_at_the_start_does_not_drive(board):
    """a server with fresh=True while the stage is recorded"""
    board.out8(0x300, 0x08)
    with serving(board, fresh=True) as served, board.stage.record():
        board.stage.run(0.001)
        for _ in range(2):
            with pytest.raises(ServerError, match="runs forward only"):
                served.host()
        assert served.said == []


def test_the_message_of_a_failed_hook_is_cut_at_a_thousand_bytes(served):
    with wire(served) as opened:
        opened.sendall(frame(client.TIMER, client.TIMING.pack(0, 1, 1000)))
        assert head_and_body(opened)[0] == client.TIMER
        opened.sendall(frame(client.BATCH, entries((client.DELAY, 1, 0))))
        assert head_and_body(opened)[0] == client.INTERRUPT
        opened.sendall(frame(client.RETURN, b"w" * 1001))
        message = head_and_body(opened)[2][4:]
    assert message == b"the interrupt hook of the host failed: " + b"w" * 1000


def test_the_driving_host_is_named_on_the_terminal_and_in_refusals(served):
    with served.host() as host:
        ours = "{}:{}".format(*host._wire.getsockname())
        with pytest.raises(ServerError) as delayed:
            served.host()
        assert str(delayed.value) == f"{ours} drives this stage, one host at a time. Wait until it is gone, or observe."
        host.delay_us(250_000)
        host.log("here")
    again(served).close()
    assert served.said[:3] == [
        f"{ours} drives, at 0.000000 s",
        "    0.250000  here",
        f"{ours} drives no more, at 0.250000 s",
    ]


def test_before_each_is_called_before_each_request_and_within_a_batch(board):
    """before_each: of the driver's frames, and of a batch of 200,000 cycles now and then; not of who looks"""
    requested = []
    with serving(board, before_each=lambda: requested.append(board.cycles)) as served:
        with served.host(observe=True) as observer:
            observer.status()
        assert requested == []
        with served.host() as host:
            host.in8(0x500), host.status()
            assert requested == [0, 1]
            host.until8(0x500, 1, 0, 200_000)
    assert requested[2] == 1
    assert len(requested) >= 4
    assert 1 < requested[3] <= 150_000


def test_the_number_of_greeted_hosts_is_limited(board, monkeypatch):
    """two hosts may be connected; a third connection waits without a hello"""
    monkeypatch.setattr(server, "MAX_HOSTS", 2)
    with serving(board) as served, wire(served, greet=False), served.host(), served.host(observe=True) as last:
        with pytest.raises(ServerError, match="2 hosts are connected, and no more can be"):
            served.host(observe=True)
        last.close()
        for _ in range(200):
            try:
                served.host(observe=True).close()
                return
            except ServerError:
                time.sleep(0.005)
        raise AssertionError("one is gone, and nobody may come")


def test_the_number_of_open_connections_is_limited(board, monkeypatch):
    monkeypatch.setattr(server, "MAX_CONNECTIONS", 2)
    with serving(board) as served, wire(served), wire(served, greet=False) as second:
        second.sendall(GREETING[:5])
        with wire(served, greet=False) as third:
            assert reply(third) == (client.ERROR, b"")
        second.sendall(GREETING[5:])
        assert head_and_body(second)[0] == client.ERROR, "the second was let in, and is told who drives"


def test_a_frame_beyond_the_maximum_size_ends_the_connection(served):
    largest = client.MAX_BODY
    with wire(served) as opened:
        opened.sendall(frame(client.LOG, b"l" * largest))
        assert b"LOG: 1,048,576 bytes" in head_and_body(opened)[2]
        opened.sendall(HEAD.pack(largest + 1, client.LOG, 5))
        kind, _, body = head_and_body(opened)
        assert (kind, body[4:]) == (
            client.ERROR,
            b"a frame of 1,048,577 bytes; there are up to 1,048,576. Is this host's protocol another?",
        )
        assert opened.recv(1) == b""


def test_time_is_counted_from_the_first_byte_of_the_frame_that_waits(monkeypatch):
    """two frames and a part at 5 s: a frame begins to wait when the one before it is taken; where nothing is left nobody waits"""
    now = [5.0]
    monkeypatch.setattr(server, "time", SimpleNamespace(monotonic=lambda: now[0]))
    connection = server._Connection(None, "who")
    assert (connection.since, connection.is_frame_awaited()) == (5.0, True), "for a hello"
    connection.role = client.OBSERVE
    assert not connection.is_frame_awaited()
    connection.received += frame(client.STATUS, number=1) + frame(client.PIN, b"x.org", 2)[:-1]
    now[0] = 6.0
    assert connection.take_frame() == (client.STATUS, 1, b"")
    assert (connection.since, connection.is_frame_awaited()) == (6.0, True)
    now[0] = 7.0
    assert connection.take_frame() is None
    assert connection.since == 6.0
    connection.received += b"g"
    assert connection.take_frame() == (client.PIN, 2, b"x.org")
    assert (connection.since, connection.is_frame_awaited()) == (None, False)


def test_a_version_error_names_the_versions_of_both_sides(served):
    with wire(served, greet=False) as opened:
        opened.sendall(frame(client.HELLO, client.GREETING.pack(client.MAGIC, 9, client.DRIVE), number=3))
        kind, number, body = head_and_body(opened)
        assert (kind, number, body[4:]) == (
            client.ERROR, 3, b"the host speaks version 9 of the frames, and this server version 1.",
        )  # fmt: skip
        assert opened.recv(1) == b"", "and is sent away"


def test_a_greeting_of_any_other_length_is_refused(served):
    for body in (
        b"",
        client.MAGIC,
        client.GREETING.pack(client.MAGIC, 1, 0)[:-1],
        client.GREETING.pack(client.MAGIC, 1, 0) + b"!",
    ):
        with wire(served, greet=False) as opened:
            opened.sendall(frame(client.HELLO, body))
            assert head_and_body(opened)[2][4:] == b"the first frame has to be HELLO, see docs/serve.md."
            assert opened.recv(1) == b""


def test_when_the_server_ends_connections_are_closed_and_the_port_is_free(board):
    with serving(board) as served:
        host, port = served.host(observe=True), served.server.address[1]
    with pytest.raises(ConnectionError):
        host.status()
    host.close()
    other = server.Server(board, port=port)
    assert other.address == ("127.0.0.1", port)
    other.stop()
    other.run()
    other.stop()  # once more does nothing


@pytest.mark.parametrize(
    ("number", "hint"),
    [
        (errno.EADDRINUSE, "Is another server running?"), (errno.EACCES, "Is another server running?"),
        (errno.EADDRNOTAVAIL, "--bind takes an address of this machine"),
    ],
)  # fmt: skip
def test_where_nothing_can_listen_it_says_what_to_choose(board, monkeypatch, number, hint):
    def refused(self, address):
        raise OSError(number, "refused so")

    monkeypatch.setattr(socket, "socket", type("Socket", (socket.socket,), {"bind": refused}))
    with pytest.raises(StageError) as failed:
        server.Server(board, "127.0.0.2", 8123)
    assert str(failed.value).startswith(f"nothing can listen on 127.0.0.2, port 8123: refused so. {hint}")


def test_ports_to_listen_on_are_those_of_tcp(board, monkeypatch):
    """-1 and 65536 are refused, 65535 is asked for"""
    for port in (-1, 1 << 16):
        with pytest.raises(ArgumentError, match=rf"port={port}: a TCP port is 0 \(one that is free\) to 65535"):
            server.Server(board, port=port)
    requested = []
    listens = type("Socket", (socket.socket,), {"bind": lambda self, address: requested.append(address)})
    monkeypatch.setattr(socket, "socket", listens)
    built = server.Server(board, port=65535)
    built.stop()
    built.run()
    assert requested == [("127.0.0.1", 65535)]


def test_a_host_that_disconnects_within_a_batch_frees_the_stage(board):
    """a batch of years; the host hangs up: the batch ends, the timers are off, and the next drives"""
    began = threading.Event()
    with serving(board, before_each=began.set) as served:
        with wire(served) as opened:
            opened.sendall(frame(client.TIMER, client.TIMING.pack(2, 1, 10**15)))
            assert head_and_body(opened)[0] == client.TIMER
            began.clear()
            opened.sendall(frame(client.BATCH, entries((client.DELAY, 10**15, 0))))
            assert began.wait(5)
        with again(served) as host:
            assert host.status().seconds > 0
            assert not board.link.hooks.functions
