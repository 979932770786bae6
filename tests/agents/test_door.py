"""The door of the HTTP server, apart from it: who comes in, who is told to go, and what the server is made with."""

import asyncio
import os
import socket
import sys
from types import SimpleNamespace

import pytest

pytest.importorskip("mcp")

import uvicorn

from stage import Stage
from stage.agents.server import http, stdio
from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory
from stage.agents.server.http import HttpServer, TokenGate
from stage.errors import StageError

ID = b"mcp-session-id"


class ProtocolStub:
    """Stand-in for the MCP protocol that records requests and opens a session for each request without one."""

    def __init__(self):
        self.came, self.session_count = [], 0

    async def __call__(self, scope, receive, send):
        self.came.append((scope.get("method", scope["type"]), dict(scope.get("headers", ()))))
        if scope.get("method") == "DELETE":
            self.body = await receive()
            await send({"type": "http.response.start", "headers": [(ID, b"nobody hears it")]})
            return
        headers = []
        if ID not in dict(scope.get("headers", ())):
            self.session_count += 1
            headers = [(b"content-type", b"x"), (b"Mcp-Session-Id", b"s%d" % self.session_count)]
        await send({"type": "http.response.start", "status": 200, "headers": headers})


class SessionsStub:
    """Stand-in for the sessions."""

    def __init__(self, limit=3):
        self.limit, self.closed, self.with_stage = limit, [], set()

    def __contains__(self, key):
        return key in self.with_stage

    def close(self, key):
        self.closed.append(key)


@pytest.fixture
def door():
    """Return `door(method, session)`, which sends a request to a Gate and returns the messages; door.app, door.sessions."""
    app, sessions = ProtocolStub(), SessionsStub()
    created = TokenGate(app, "t", sessions)

    def send_request(method="POST", session=None, kind="http", token="Bearer t", **more):
        sent = []

        async def send(message):
            sent.append(message)

        async def receive():
            return {"type": "http.request", "body": b"of the client", "more_body": False}

        headers = [(b"Authorization", token.encode()), (b"host", b"here"), (b"Accept", b"all"), (b"x-more", b"1")]
        headers += [(ID, session.encode())] if session else []
        scope = {"type": kind, "method": method, "path": "/mcp", "headers": headers, **more}
        asyncio.run(created(scope, receive, send))
        return sent

    send_request.app, send_request.sessions = app, sessions
    return send_request


def list_closed_sessions(door):
    return [headers[ID].decode() for method, headers in door.app.came if method == "DELETE"]


def test_beyond_the_limit_the_longest_idle_session_ends(door):
    for _ in range(3):
        door()
    assert list_closed_sessions(door) == []
    door(session="s1")
    door(session="unknown")
    door()
    assert list_closed_sessions(door) == ["s2"]
    door()
    door()
    assert list_closed_sessions(door) == ["s2", "s3", "s1"]


def test_a_session_that_has_a_stage_is_none_of_the_silent_ones(door):
    for _ in range(3):
        door()
    door.sessions.with_stage = {"s1", "s3"}
    for _ in range(2):
        door()
    assert list_closed_sessions(door) == []
    door()
    assert list_closed_sessions(door) == ["s2"]


def test_a_session_that_is_evicted_gets_the_delete_request_of_its_client(door):
    for _ in range(4):
        door()
    (headers,) = [headers for method, headers in door.app.came if method == "DELETE"]
    saved = {b"authorization": b"Bearer t", b"host": b"here", b"accept": b"all"}
    assert {k.lower(): v for k, v in headers.items()} == {**saved, ID: b"s1"}
    assert door.app.body == {"type": "http.request", "body": b"", "more_body": False}
    assert door.sessions.closed == []


def test_who_hears_of_a_new_session_is_its_client_alone(door):
    for _ in range(3):
        door()
    (start,) = door()
    assert start["status"] == 200
    assert dict(start["headers"])[b"Mcp-Session-Id"] == b"s4"


def test_a_session_that_its_client_ends_is_closed_and_leaves_room(door):
    for _ in range(3):
        door()
    door("DELETE", "s1")
    assert door.sessions.closed == ["s1"]
    door()
    assert list_closed_sessions(door) == ["s1"]
    door("DELETE", "nobody's")
    assert door.sessions.closed == ["s1", "nobody's"]


@pytest.mark.parametrize("token", ["Bearer t", "bearer t", "BEARER  t ", "Bearer t\t"])
def test_the_token_is_known_however_it_is_spaced(door, token):
    assert door(token=token)[0]["status"] == 200


@pytest.mark.parametrize("token", ["", "t", "Bearer", "Bearer x", "Bearer tt", "Basic t", "Bearer T", "Bearer t t"])
def test_a_client_with_another_token_learns_which_header_to_send_and_gets_no_further(door, token):
    start, body = door(token=token)
    assert (start["type"], start["status"]) == ("http.response.start", 401)
    assert dict(start["headers"]) == {b"content-type": b"text/plain; charset=utf-8", b"www-authenticate": b"Bearer"}
    assert b"Authorization: Bearer TOKEN" in body["body"]
    assert door.app.came == []


def test_what_is_no_request_continues_without_a_token(door):
    door(kind="lifespan", token="")
    assert [kind for kind, _ in door.app.came] == ["POST"]


# --- what the server is made with ---


@pytest.fixture
def created(monkeypatch):
    """`made(sessions, ...)`: a server, and how its app and its listener were made."""
    observed = SimpleNamespace()

    class Protocol:
        def __init__(self, factory, sessions, find_key, sessionless, threads):
            observed.sessionless, observed.threads, observed.key = sessionless, threads, find_key
            self.server = SimpleNamespace(streamable_http_app=self._app)

        def _app(self, **how):
            observed.app = how
            return SimpleNamespace(router=SimpleNamespace(lifespan_context=None))

    class Server:
        def __init__(self, config, sessions):
            observed.config, self.should_exit = config, False

        def run(self, sockets):
            observed.sockets = sockets

    monkeypatch.setattr(http, "ProtocolServer", Protocol)
    monkeypatch.setattr(http, "InterruptibleServer", Server)
    monkeypatch.setattr(uvicorn, "Config", lambda app, **how: SimpleNamespace(app=app, **how))
    opened = []

    def make(*args, **how):
        server = HttpServer(None, *args, **how)
        opened.append(server)
        return server, observed

    yield make
    for server in opened:
        server._socket.close()


def test_a_server_is_bounded_as_its_sessions_are(created):
    server, observed = created(ClientSessions(dict, limit=7, idle_s=33.0), token="mine")
    assert observed.app == {
        "streamable_http_path": "/mcp", "json_response": True, "max_request_body_size": 256 * 1024, "session_idle_timeout": 33.0,
        "max_sessions": 14, "host": "127.0.0.1",
    }  # fmt: skip
    assert (observed.sessionless, observed.threads) == (False, max(2, os.cpu_count() or 2))
    assert (observed.config.log_level, observed.config.timeout_graceful_shutdown) == ("error", 1)
    assert server.token == "mine"
    assert isinstance(observed.config.app, TokenGate)
    server.run()
    assert observed.sockets == [server._socket]
    server.stop()
    assert server._server.should_exit


def test_a_token_that_the_server_makes_is_long_and_no_other_server_s(created):
    tokens = {created(ClientSessions(dict))[0].token for _ in range(3)}
    assert len(tokens) == 3
    assert min(map(len, tokens)) >= 32


def test_a_client_connects_to_the_port_that_is_listened_at(created):
    server, _ = created(ClientSessions(dict))
    assert server.address == f"http://127.0.0.1:{server.port}/mcp"
    assert server.port == server._socket.getsockname()[1] > 0
    socket.create_connection(("127.0.0.1", server.port), 5).close()


@pytest.mark.parametrize("port", [None, 70_000])
def test_a_port_that_cannot_be_had_is_named_with_what_to_do(created, port):
    acquired = created(ClientSessions(dict))[0].port
    with pytest.raises(
        StageError, match=f"127.0.0.1:{port or acquired}: .*Choose another port, or 0 for any that is free"
    ):
        created(ClientSessions(dict), port or acquired)


def test_a_request_without_a_session_has_no_key(created):
    key = created(ClientSessions(dict))[1].key
    assert key(SimpleNamespace(request=None)) is None
    assert key(SimpleNamespace(request=SimpleNamespace(headers={"mcp-session-id": "a"}))) == "a"
    assert key(SimpleNamespace(request=SimpleNamespace(headers={}))) is None


def test_due_sessions_are_looked_for_every_two_seconds_while_the_app_lives_and_all_end_with_it(monkeypatch):
    reported, slept = [], []

    async def sleep(seconds):
        slept.append(seconds)
        if len(slept) > 3:
            await asyncio.Event().wait()

    monkeypatch.setattr(http.anyio, "sleep", sleep)
    sessions = SimpleNamespace(
        close_expired=lambda: reported.append("reap"), close_all=lambda: reported.append("close all")
    )

    class LifespanRecorder:
        async def __aenter__(self):
            reported.append("begin")
            return "state"

        async def __aexit__(self, *_):
            reported.append("end")

    app = SimpleNamespace(router=SimpleNamespace(lifespan_context=lambda app: LifespanRecorder()))
    http._add_cleanup(app, sessions)

    async def live():
        async with app.router.lifespan_context(app):
            while reported.count("reap") < 3:
                await asyncio.sleep(0.001)

    asyncio.run(asyncio.wait_for(live(), 20))
    assert reported == ["begin", "reap", "reap", "reap", "close all", "end"]
    assert slept == [2.0] * 4


# --- standard input and output ---


def test_when_the_client_is_silent_for_good_its_session_ends(monkeypatch):
    import anyio

    reported = []

    async def work():
        give, reading = anyio.create_memory_object_stream(2)
        passed_on, acquired = anyio.create_memory_object_stream(2)
        await give.send("a")
        await give.send("b")
        give.close()
        await stdio._relay_messages(reading, passed_on, SimpleNamespace(close_all=lambda: reported.append("all")))
        return [m async for m in acquired]

    assert asyncio.run(work()) == ["a", "b"]
    assert reported == ["all"]


@pytest.mark.parametrize("gone", [BrokenPipeError, ConnectionResetError])
def test_a_client_that_breaks_its_pipe_is_no_failure(monkeypatch, gone):
    created = []

    def run(work, maker):
        raise BaseExceptionGroup("ended", [gone("x")])

    monkeypatch.setattr(stdio.anyio, "run", run)
    monkeypatch.setattr(stdio.os, "dup2", lambda *to: created.append(to))
    monkeypatch.setattr(stdio.os, "open", lambda *of: of)
    monkeypatch.setattr(stdio.sys, "stdout", SimpleNamespace(fileno=lambda: 77))
    stdio.serve(None)
    assert created == [((os.devnull, os.O_WRONLY), 77)]


def test_another_failure_of_the_transport_is_one_still(monkeypatch):
    def run(work, maker):
        raise BaseExceptionGroup("ended", [BrokenPipeError("x"), ZeroDivisionError("y")])

    monkeypatch.setattr(stdio.anyio, "run", run)
    with pytest.raises(BaseExceptionGroup):
        stdio.serve(None)


def test_ctrl_c_over_stdio_opens_no_session_for_a_call_that_comes_in(monkeypatch):
    created = []

    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr(
        stdio, "ClientSessions", lambda *a, **options: created.append(ClientSessions(*a, **options)) or created[0]
    )
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=interrupt))
    with pytest.raises(KeyboardInterrupt):
        asyncio.run(stdio._serve_client(ToolboxFactory(lambda: Stage("xy", visuals=False))))
    with pytest.raises(StageError, match="The server ends"):
        created[0].get_toolbox(stdio.SESSION_KEY)
