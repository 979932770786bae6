"""What a host's client puts on the wire: each request with all that was given, and each answer to whoever asked."""

from __future__ import annotations

import socket
import time

import pytest

from stage.serve import client
from stage.serve.client import Batch, Client, ServerError

PORT = 0x300
REQUESTS = [
    # method, arguments -> what, times, every, mask, a, b; whether it gives an answer
    ("out8", (0x301, 0x21), (client.OUT8, 0, 0, 0, 0x301, 0x21), False),
    ("in8", (0x302,), (client.IN8, 0, 0, 0, 0x302, 0), True),
    ("out16", (0x303, 0x2143), (client.OUT16, 0, 0, 0, 0x303, 0x2143), False),
    ("in16", (0x304,), (client.IN16, 0, 0, 0, 0x304, 0), True),
    ("out32", (0x305, 0x21436587), (client.OUT32, 0, 0, 0, 0x305, 0x21436587), False),
    ("in32", (0x306,), (client.IN32, 0, 0, 0, 0x306, 0), True),
    ("delay_us", (17,), (client.DELAY, 0, 0, 0, 17, 0), False),
    ("spend_ns", (18,), (client.SPEND, 0, 0, 0, 18, 0), False),
    ("micros", (), (client.MICROS, 0, 0, 0, 0, 0), True),
    ("line", (), (client.LINE, 0, 0, 0, 0, 0), True),
    ("until8", (0x307, 0x40, 0x20, 9, 5), (client.UNTIL8, 9, 5, 0x40, 0x307, 0x20), True),
    ("until16", (0x308, 0x4000, 0x2000, 8, 6), (client.UNTIL16, 8, 6, 0x4000, 0x308, 0x2000), True),
    ("until_line", (19,), (client.UNTIL_LINE, 0, 0, 0, 19, 0), True),
]


class Reports(Client):
    """A client of nobody: keeps what it would send, and gets 1 for each entry."""

    def __init__(self):
        self.frames, self._hooks = [], {}

    def request(self, kind, body=b""):
        self.frames.append((kind, body))
        return client.ANSWER.pack(1) * (len(body) // client.ENTRY.size) if kind == client.BATCH else b""


@pytest.mark.parametrize(("name", "value", "entry", "answers"), REQUESTS, ids=[name for name, *_ in REQUESTS])
def test_a_request_is_one_entry_with_all_arguments(name, value, entry, answers):
    """host.until8(0x307, 0x40, 0x20, 9, 5), alone and in a batch"""
    alone, together = Reports(), Reports()
    assert getattr(alone, name)(*value) == (1 if answers else None)
    batch = together.batch().micros()
    assert getattr(batch, name)(*value) is batch
    assert len(batch) == 2
    assert batch.run() == ([1, 1] if answers else [1])
    assert alone.frames == [(client.BATCH, client.ENTRY.pack(*entry))]
    assert together.frames == [
        (client.BATCH, client.ENTRY.pack(client.MICROS, 0, 0, 0, 0, 0) + client.ENTRY.pack(*entry))
    ]


def test_a_batch_that_has_run_is_empty_and_takes_the_next_requests():
    """batch.in8(0x300).run(), then batch.in8(0x301).run()"""
    host = Reports()
    batch = host.batch().in8(PORT).out8(PORT, 1)
    assert batch.run() == [1]
    assert len(batch) == 0
    assert batch.out8(PORT, 2).in8(PORT + 1).run() == [1]
    assert batch.run() == []
    assert len(host.frames) == 2, "of no request there is no frame"


def test_a_timer_request_has_number_level_and_period_in_nanoseconds():
    """host.on_timer(1.001, hook, n=2, level=7): the product of a period that is no binary fraction is rounded"""
    host = Reports()

    def hook(): ...

    host.on_timer(1.001, hook, n=2, level=7)
    host.on_timer(250, hook)
    host.on_timer(250, None, n=3, level=15)
    host.on_timer(0, hook, n=1)
    assert [(kind, client.TIMING.unpack(body)) for kind, body in host.frames] == [
        (client.TIMER, (2, 7, 1001)), (client.TIMER, (0, 1, 250_000)), (client.TIMER, (3, 15, 0)), (client.TIMER, (1, 1, 0)),
    ]  # fmt: skip
    with pytest.raises(ValueError, match=r"n=-1 level=2 period_us=5: no such timer"):
        host.on_timer(5, hook, n=-1, level=2)


def test_what_a_host_says_of_switches_names_and_hooks_is_in_its_frames():
    host = Reports()
    host.stick("x.org", True), host.stick("x.org", False), host.stick("x.org", None)
    host.snapshot("a"), host.restore("b"), host.restore(), host.log("µ"), host.reset()
    host.on_interrupt(print), host.on_interrupt(None)
    assert host.frames == [
        (client.STICK, b"\1\0\0\0x.org"), (client.STICK, b"\0\0\0\0x.org"), (client.STICK, b"\2\0\0\0x.org"),
        (client.SNAPSHOT, b"a"), (client.RESTORE, b"b"), (client.RESTORE, b"start"), (client.LOG, "µ".encode()),
        (client.RESET, b""), (client.HOOK, b"\1\0\0\0"), (client.HOOK, b"\0\0\0\0"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("address", "where"),
    [("", ("127.0.0.1", 7240)), (":8001", ("127.0.0.1", 8001)), ("stage.example", ("stage.example", 7240)),
     ("stage.example:8002", ("stage.example", 8002)), ("[::1]:8003", ("::1", 8003)), ("stage.example:", ("stage.example", 7240))],
)  # fmt: skip
def test_an_address_is_a_host_and_a_port_and_each_may_be_left_out(monkeypatch, address, where):
    """connect("[::1]:8003", timeout=3)"""
    requested = []

    def nowhere(to, timeout):
        requested.append((to, timeout))
        raise OSError("this test goes nowhere")

    monkeypatch.setattr(socket, "create_connection", nowhere)
    with pytest.raises(OSError, match="nowhere"):
        client.connect(address, timeout=3)
    assert requested == [(where, 3)]


def test_time_is_limited_until_it_is_greeted_and_not_after(served):
    """connect(timeout=0.05) to who says nothing; then a server that answers"""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        began = time.monotonic()
        with pytest.raises(TimeoutError):
            client.connect(f"127.0.0.1:{silent.getsockname()[1]}", timeout=0.05)
        assert time.monotonic() - began < 5
    with served.host(timeout=9) as host:
        assert host._wire.gettimeout() is None, "a delay of minutes is waited for"


def test_a_refused_client_closes_its_socket(served, monkeypatch):
    wires, make = [], socket.create_connection
    monkeypatch.setattr(socket, "create_connection", lambda *value: wires.append(make(*value)) or wires[-1])
    with served.host():
        with pytest.raises(ServerError, match="one host at a time"):
            served.host()
        assert [wire.fileno() < 0 for wire in wires] == [False, True]


def test_the_words_of_an_error_are_the_servers_and_no_bytes_of_the_answers_before_it(served):
    """two answers, then a delay in which a timer's hook fails"""
    with served.host() as host:
        host.on_timer(10, lambda: None)
        host._call_hook = lambda source: host._send_bytes(client.HEAD.pack(4, client.RETURN, 0) + b"no!!")
        with pytest.raises(ServerError) as failed:
            host.batch().in8(0x500).in8(0x502).delay_us(100).run()
        assert failed.value.answers == (0xFF, 0xFF)
        assert str(failed.value) == "the interrupt hook of the host failed: no!!"


def test_a_batch_without_a_connection_is_refused():
    batch = Batch().in8(PORT)
    with pytest.raises(ValueError, match=r"this batch belongs to no connection: client\.batch\(\) makes one"):
        batch.run()
