"""Whatever bytes come, the board stands as it stood and the server serves on."""

from __future__ import annotations

import random
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest
from support.served import serving

from stage.serve import client, server
from stage.serve.client import HEAD, ServerError

SEEDS = [*range(6), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(6, 200))]
GREETING = HEAD.pack(16, client.HELLO, 0) + client.GREETING.pack(client.MAGIC, client.VERSION, client.DRIVE)


@contextmanager
def wire(served, greet: bool = True) -> Iterator[socket.socket]:
    with socket.create_connection(served.server.address, timeout=10) as opened:
        if greet:
            opened.sendall(GREETING)
            kind, body = reply(opened)
            if (
                kind == client.ERROR and b"drives this stage" in body
            ):  # the server has not seen yet that the one before is gone
                time.sleep(0.005)
                with wire(served) as other:
                    yield other
                return
            assert kind == client.HELLO
        yield opened


def reply(opened: socket.socket) -> tuple[int, bytes]:
    """Kind and body; ERROR without a body where the server has closed."""

    def read(size: int) -> bytes:
        content = b""
        while len(content) < size:
            try:
                more = opened.recv(size - len(content))
            except ConnectionError:
                more = b""
            if not more:
                raise EOFError
            content += more
        return content

    try:
        length, kind, _ = HEAD.unpack(read(HEAD.size))
        return kind, read(length)
    except EOFError:
        return client.ERROR, b""


def serves(served) -> None:
    """Check that the server serves another host, and holds nothing of this one."""
    for _ in range(200):
        try:
            with served.host() as host:
                assert host.in8(0x500) == 0xFF
            return
        except ServerError:
            time.sleep(0.005)
    raise AssertionError("a host that is gone drives still")


def good(rng: random.Random) -> bytes:
    """A frame as it should be."""
    name = rng.choice((b"start", b"a", b"x.org", b"y.el_plus", b"x.switches.sd_plus"))
    entries = b"".join(
        client.ENTRY.pack(
            rng.choice((0, 1, 2, 3, 4, 5, 8, 13, 14, 100, 101, 102)), rng.randrange(1, 9), rng.randrange(9), rng.randrange(256),
            rng.choice((0x300, 0x304, 9)), rng.randrange(256),
        )
        for _ in range(rng.randrange(5))
    )  # fmt: skip
    kind = rng.randrange(1, 13)
    body = {
        client.BATCH: entries, client.LOG: b"line", client.HOOK: client.WORD.pack(0), client.SNAPSHOT: name, client.RESTORE: name,
        client.PIN: name, client.STICK: client.WORD.pack(rng.randrange(3)) + name,
    }.get(kind, b"")  # fmt: skip
    return HEAD.pack(len(body), kind, rng.randrange(1 << 32)) + body


def bad(rng: random.Random) -> bytes:
    """A frame with something changed, whole by its length."""
    frame = bytearray(good(rng))
    for _ in range(rng.randrange(1, 4)):
        frame[rng.randrange(4, len(frame))] ^= 1 << rng.randrange(8)
    if rng.random() < 0.3:
        frame += rng.randbytes(rng.randrange(1, 40))
    if rng.random() < 0.2:
        del frame[rng.randrange(HEAD.size, len(frame) + 1) :]
    frame[:4] = struct.pack("<I", len(frame) - HEAD.size)
    return bytes(frame)


def takes_too_long(frame: bytes) -> bool:
    """Return whether a valid frame requests more time than a test has."""
    _, kind, _ = HEAD.unpack_from(frame)
    if kind != client.BATCH or (len(frame) - HEAD.size) % client.ENTRY.size:
        return False
    return any(
        (a if what in (client.DELAY, client.UNTIL_LINE) else times * (every + 1)) > 1_000_000
        for what, times, every, _, a, _ in client.ENTRY.iter_unpack(frame[HEAD.size :])
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_a_frame_that_is_answered_by_an_error_has_changed_nothing(served, seed):
    print("seed", seed)
    rng, errors = random.Random(seed), 0
    with wire(served) as opened:
        for _ in range(60):
            opened.settimeout(10)
            frame, before = bad(rng), served.state()
            if takes_too_long(frame):
                continue
            if HEAD.unpack_from(frame)[1] == client.RETURN:  # which is answered only if it is wrong, as it is here
                frame = frame[:4] + struct.pack("<I", client.RETURN) + frame[8:]
            opened.sendall(frame)
            kind, body = reply(opened)
            if kind == client.ERROR:
                errors += 1
                assert body[4:].decode().strip(), frame
                if body[:4] == bytes(4):
                    assert served.state() == before, frame
    assert errors > 10
    serves(served)


@pytest.mark.parametrize("seed", SEEDS)
def test_random_bytes_and_partial_frames_end_only_their_connection(served, seed):
    print("seed", seed)
    rng, before = random.Random(seed), served.state()
    for n in range(20):
        with wire(served, greet=rng.random() < 0.5) as opened:
            frame = rng.randbytes(rng.randrange(1, 200)) if rng.random() < 0.5 else good(rng)[: -rng.randrange(1, 12)]
            length = HEAD.unpack(frame[: HEAD.size])[0] if len(frame) >= HEAD.size else 0
            opened.sendall(frame)
            if length > client.MAX_BODY:
                kind, body = reply(opened)
                assert (kind, body[4:][:11]) == (client.ERROR, b"a frame of "), n
                assert reply(opened) == (client.ERROR, b"")
    assert served.state() == before
    serves(served)


@pytest.mark.parametrize(
    "text", [b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", bytes(40), b"\xff" * 40], ids=["http", "0", "ff"]
)
def test_another_protocol_is_refused_and_disconnected(served, text):
    with wire(served, greet=False) as opened:
        opened.sendall(text)
        kind, body = reply(opened)
        assert kind == client.ERROR
        assert b"protocol" in body or b"HELLO" in body
        assert reply(opened) == (client.ERROR, b"")
    serves(served)


def test_a_client_that_sends_single_bytes_is_disconnected(board, monkeypatch):
    monkeypatch.setattr(server, "FRAME_TIMEOUT_S", 0.1)
    with serving(board) as served:
        for greet, text in ((False, b""), (False, GREETING[:20]), (True, b"\x10")):
            with wire(served, greet) as opened:
                opened.sendall(text)
                kind, body = reply(opened)
                assert (kind, body[4:]) == (client.ERROR, b"no whole frame in 0.1 s.")
                assert reply(opened) == (client.ERROR, b"")
        with wire(served, False) as opened:  # each byte in time, and the frame is not
            began = time.monotonic()
            with suppress(OSError):  # it is closed by then
                for k in range(8):
                    opened.sendall(GREETING[k : k + 1])
                    time.sleep(0.03)
            assert reply(opened)[1][4:] == b"no whole frame in 0.1 s."
            assert time.monotonic() - began < 0.25
        with served.host() as host:
            time.sleep(0.2)
            assert host.in8(0x500) == 0xFF, "a host that was greeted and sends nothing may wait as long as it likes"


def test_a_hook_error_may_contain_any_bytes(board):
    with serving(board) as served, wire(served) as opened:
        opened.sendall(HEAD.pack(16, client.TIMER, 1) + client.TIMING.pack(0, 1, 1000))
        assert reply(opened)[0] == client.TIMER
        entry = client.ENTRY.pack(client.DELAY, 0, 0, 0, 100, 0)
        opened.sendall(HEAD.pack(len(entry), client.BATCH, 2) + entry)
        assert reply(opened)[0] == client.INTERRUPT
        opened.sendall(HEAD.pack(3, client.RETURN, 0) + b"no\xff")
        kind, body = reply(opened)
        assert (kind, "failed: no\N{REPLACEMENT CHARACTER}" in body.decode()) == (client.ERROR, True)


def test_a_host_that_takes_no_answers_fills_no_memory(served):
    body = client.ENTRY.pack(client.IN8, 0, 0, 0, 0x500, 0) * 32_000
    frame = HEAD.pack(len(body), client.BATCH, 0) + body
    with wire(served) as opened:
        opened.settimeout(0.3)
        with pytest.raises(TimeoutError):
            opened.sendall(frame * 100)
        connection = served.server._driver
        assert len(connection.outgoing) < 2 * server.MAX_WAITING
        assert len(connection.received) < 2 * server.MAX_WAITING
    serves(served)
