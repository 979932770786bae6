"""The server by the official client, over both transports: tools, resources, prompts, sessions; who may come in, who has gone."""

import asyncio
import base64
import contextlib
import http.client
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("mcp")

from support.examples import scaled
from support.from_schema import calls
from support.mcp_served import Served, over_stdio

from stage import Stage
from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory
from stage.agents.server.http import HttpServer, TokenGate
from stage.agents.server.stdio import LineReader


@pytest.fixture(scope="module")
def served():
    served = Served()
    yield served
    served.close()
    assert len(served.sessions) == 0


def assert_all_sessions_end(served):
    """Assert that the last session of a server ends."""
    end = time.monotonic() + 60
    while len(served.sessions) and time.monotonic() < end:
        time.sleep(0.02)
    assert len(served.sessions) == 0


async def tour(client):
    """Do what a client does first, the same over each transport."""
    tools = (await client.list_tools()).tools
    homed = await client.call_tool("home", {"axis": "x"})
    assert not homed.is_error
    assert homed.structured_content["stopped_by"] == "ORG"
    assert json.loads(homed.content[0].text) == homed.structured_content
    wrong = await client.call_tool("write_register", {"axis": "x", "name": "R4", "value": 20000})
    assert wrong.is_error
    assert "from 2 to 16383" in wrong.content[0].text
    unknown = await client.call_tool("mvoe", {})
    assert unknown.is_error
    assert "Did you mean 'move'" in unknown.content[0].text
    moved = json.loads((await client.read_resource("stage://recording/last")).contents[0].text)
    assert moved["move"] == "origin return"
    requested = (await client.get_prompt("find_lost_steps", {"axis": "Y"})).messages[0].content.text
    assert "axis y" in requested
    return [t.name for t in tools]


def test_http_has_what_a_client_needs(served):
    assert "move" in served.talk(tour)


def test_who_comes_before_the_server_runs_is_not_refused():
    maker = ToolboxFactory(lambda: Stage("xy", visuals=False))
    server = HttpServer(maker, ClientSessions(maker))
    socket.create_connection(("127.0.0.1", server.port), 5).close()


def test_stdio_has_the_same(served):
    assert over_stdio(tour) == served.talk(lambda client: tour(client))


def test_every_tool_is_called_by_its_schema(served):
    jsonschema = pytest.importorskip("jsonschema")

    async def work(client):
        for tool in (await client.list_tools()).tools:
            jsonschema.Draft202012Validator.check_schema(tool.input_schema)
            assert tool.description
            answer = await client.call_tool(tool.name, {})
            assert "Traceback" not in answer.content[0].text
            assert answer.is_error == bool(tool.input_schema["required"] or tool.name in ("report", "picture"))

    served.talk(work)


def test_each_session_has_a_separate_stage_and_ends_with_its_client(served):
    async def work():
        async with served.client() as one, served.client() as other:
            await one.call_tool("move", {"axis": "x", "pulses": 400})
            await other.call_tool("budget", {})
            used = [(await c.call_tool("budget", {})).structured_content["used"]["moves"] for c in (one, other)]
            assert used == [1, 0]

    asyncio.run(work())
    assert_all_sessions_end(served)


def test_a_picture_comes_as_an_image(served):
    pytest.importorskip("matplotlib")

    async def work(client):
        await client.call_tool("move", {"axis": "x", "pulses": 100})
        return (await client.call_tool("picture", {})).content[1]

    image = served.talk(work)
    assert image.mime_type == "image/png"
    assert base64.b64decode(image.data).startswith(b"\x89PNG")


def test_resources_describe_the_chip(served):
    async def work(client):
        texts = {}
        for r in (await client.list_resources()).resources:
            if "recording" not in str(r.uri):
                texts[str(r.uri)] = (await client.read_resource(r.uri)).contents[0].text
        return texts

    texts = served.talk(work)
    assert json.loads(texts["stage://axes"])["axes"]["x"]["chip"] == "PCL240K"
    assert "ramping-down point" in texts["stage://chips/PCL240K/registers"]
    assert "4,915,200 Hz" in texts["stage://chips/PCL240K/facts"]


@pytest.mark.parametrize(
    "uri", ["file:///etc/passwd", "stage://chips/../axes", "stage://chips/PCL240/facts", "http://127.0.0.1/"]
)
def test_no_other_resource_can_be_read(served, uri):
    from mcp.shared.exceptions import MCPError

    async def work(client):
        with pytest.raises(MCPError, match="Known: stage://axes"):
            await client.read_resource(uri)
        with pytest.raises(MCPError, match="Nothing has been recorded"):
            await client.read_resource("stage://recording/last")

    served.talk(work)


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("tune_mvoe", {}, "Did you mean 'tune_move'"),
        ("tune_move", {"axis": "q"}, "Known: x, y"),
        ("tune_move", {"speed": "1"}, "takes no argument"),
        ("tune_move", {"distance": "\n"}, "printable"),
    ],
)
def test_prompts_refuse_in_words(served, name, arguments, message):
    from mcp.shared.exceptions import MCPError

    async def work(client):
        with pytest.raises(MCPError, match=message):
            await client.get_prompt(name, arguments)

    served.talk(work)


# --- who comes in ---


def test_a_client_with_two_streams_is_connected_until_both_have_closed():
    gone, scope = [], {"type": "http", "method": "GET"}
    scope["headers"] = [(b"authorization", b"Bearer t"), (b"mcp-session-id", b"a")]

    async def app(scope, receive, send):
        await receive()

    async def work():
        door, ends = (
            TokenGate(app, "t", SimpleNamespace(note_disconnect=gone.append)),
            (asyncio.Event(), asyncio.Event()),
        )
        lines = [asyncio.create_task(door(scope, end.wait, None)) for end in ends]
        for end, line, reported in zip(ends, lines, ([], ["a"]), strict=True):
            await asyncio.sleep(0)
            end.set()
            await line
            assert gone == reported

    asyncio.run(work())


def send_request(served, method="POST", **headers):
    import httpx2

    head = {"Accept": "application/json, text/event-stream", "Authorization": f"Bearer {served.server.token}"}
    head = {k: v for k, v in {**head, **headers}.items() if v}
    body = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "budget", "arguments": {}}}
    return httpx2.request(method, served.server.address, json=body, headers=head)


@pytest.mark.parametrize(
    "authorization", ["", "Bearer nonsense", "Bearer", "Basic x", "Bearer \u00e9".encode("latin1")]
)
def test_a_request_without_the_token_is_unauthorized(served, authorization):
    assert_all_sessions_end(served)
    refused = send_request(served, Authorization=authorization)
    assert refused.status_code == 401
    assert "Authorization: Bearer" in refused.text
    assert len(served.sessions) == 0


def test_pages_of_other_sites_are_refused(served):
    assert send_request(served, Host="evil.example").status_code >= 400
    assert send_request(served, Origin="http://evil.example").status_code >= 400


def test_a_request_without_a_session_has_to_open_one(served):
    message = send_request(served, **{"MCP-Protocol-Version": "2025-11-25"})
    assert message.status_code == 400
    assert send_request(served, **{"mcp-session-id": "f" * 32}).status_code == 404
    assert_all_sessions_end(served)


def test_a_request_is_of_bounded_size(served):
    import httpx2

    head = {"Authorization": f"Bearer {served.server.token}", "Content-Type": "application/json"}
    assert httpx2.post(served.server.address, content=b"[" * 1_000_000, headers=head).status_code == 413


def test_a_call_in_a_closed_session_is_refused(served):
    async def work(client):
        await client.call_tool("budget", {})
        served.sessions.close_all()
        return await client.call_tool("budget", {})

    answer = served.talk(work)
    assert answer.is_error
    assert "This session has ended" in answer.content[0].text


@pytest.mark.slow
def test_a_client_whose_line_breaks_leaves_no_stage(served, monkeypatch):
    """The client is killed: it closes nothing, and its sockets break."""
    monkeypatch.setattr(served.sessions, "grace_s", 0.0)
    code = f"""
import asyncio, os, sys, time
sys.path.insert(0, {os.path.dirname(os.path.dirname(__file__))!r})
import httpx2
from mcp import Client
from mcp.client.streamable_http import streamable_http_client
async def work():
    http = httpx2.AsyncClient(headers={{"Authorization": "Bearer {served.server.token}"}}, timeout=60)
    async with Client(streamable_http_client("{served.server.address}", http_client=http)) as client:
        await client.call_tool("move", {{"axis": "x", "pulses": 100}})
        print("moved", flush=True)
        await asyncio.sleep(60)
asyncio.run(work())
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "moved\n"
        assert len(served.sessions) == 1
        process.send_signal(signal.SIGKILL)
    assert_all_sessions_end(served)


@pytest.mark.slow
def test_a_server_whose_client_was_killed_ends():
    """The client dies in the middle of a call that would take a while."""
    command = [sys.executable, "-m", "stage", "mcp", "xy"]
    begin = {
        "protocolVersion": "2025-11-25", "capabilities": {}, "clientInfo": {"name": "test", "version": "0"},
    }  # fmt: skip
    lines = [
        {"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": begin},
        {"jsonrpc": "2.0", "method": "notifications/initialized"},
        {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "wait", "arguments": {"seconds": 1e-3}}},
        {"jsonrpc": "2.0", "id": 2, "method": "tools/call", "params": {"name": "wait", "arguments": {"seconds": 120}}},
    ]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        process.stdin.write("this is no JSON\n")
        for line in lines:
            process.stdin.write(json.dumps(line) + "\n")
        process.stdin.flush()
        while '"id":1' not in process.stdout.readline():
            pass
        process.stdin.close()
        assert process.wait(60) == 0
        assert "waited_s" not in process.stdout.read()  # it did not wait for the end of the call
        assert "Traceback" not in process.stderr.read()


def test_the_command_says_what_is_wrong(capsys):
    from stage.cli import main

    for arguments, message in (
        (["mcp", "xq", "--http"], "Did you mean"),
        (["mcp", "xq"], "Did you mean"),
        (["mcp", "--chips", "bogus"], "unknown chip"),
        (["mcp", "--folder", "."], "Add --mode truth"),
        (["mcp", "--patience", "nan"], "greater than 0"),
        (["mcp", "--folder", "/nowhere"], "no such folder"),
        (["mcp", "--moves", "-1"], "0 or more"),
        (["mcp", "--http", "--idle", "0"], "greater than 0"),
    ):
        assert main(arguments) == 2
        assert message in capsys.readouterr().err
    with socket.create_server(("127.0.0.1", 0)) as acquired:
        assert main(["mcp", "xy", "--http", "--port", str(acquired.getsockname()[1])]) == 2
    assert "Choose another port" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["mcp", "xy", "--http", "--port", "70000"])
    assert "70000: a TCP port is 0 (one that is free) to 65535" in capsys.readouterr().err


@given(data=st.data())
@settings(max_examples=scaled(4), deadline=None, suppress_health_check=list(HealthCheck))
def test_random_calls_never_crash_the_server(served, data):
    drawn = data.draw(st.lists(calls(served.maker.catalog.tools), min_size=20, max_size=20))

    async def work(client):
        for name, arguments in drawn:
            fields = arguments if isinstance(arguments, dict) else {"axis": repr(arguments)}
            answer = await client.call_tool(
                name, {k: v for k, v in fields.items() if v == v and v not in (math.inf, -math.inf)}
            )
            assert "Traceback" not in answer.content[0].text
            assert "PulseStage itself has failed" not in answer.content[0].text
        return await client.call_tool("budget", {})

    assert not served.talk(work).is_error


@pytest.mark.slow
def test_fifty_sessions_at_once_are_served_and_leave_nothing_over():
    script = Path(__file__).parents[2] / "scripts" / "agents_speed.py"
    done = subprocess.run([sys.executable, script, "--sessions", "50", "--calls", "10"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "50 sessions at once" in done.stdout


def open_session(served):
    """Open a session by HTTP requests, and return its headers."""
    import httpx2

    begin = {"protocolVersion": "2025-11-25", "capabilities": {}, "clientInfo": {"name": "test", "version": "0"}}
    head = {"Accept": "application/json, text/event-stream", "Authorization": f"Bearer {served.server.token}"}
    body = {"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": begin}
    reply = httpx2.post(served.server.address, json=body, headers=head, timeout=60)
    head |= {"mcp-session-id": reply.headers["mcp-session-id"], "mcp-protocol-version": "2025-11-25"}
    httpx2.post(
        served.server.address, json={"jsonrpc": "2.0", "method": "notifications/initialized"}, headers=head, timeout=60
    )
    return head


FORMS = ({}, {"name": None}, {"name": 5}, {"name": "move", "arguments": []}, {"name": "move", "arguments": "x"})


@pytest.mark.parametrize("params", FORMS)
def test_a_call_of_the_wrong_form_is_a_tool_error_too(served, params):
    import httpx2

    body = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params}
    message = httpx2.post(served.server.address, json=body, headers=open_session(served), timeout=60).json()
    assert message["result"]["isError"]
    text = message["result"]["content"][0]["text"]
    assert "called by its name" in text or "should be an object" in text


def test_a_cancelled_call_ends_and_the_next_call_works(served):
    import httpx2

    head = open_session(served)

    def post(number, method, params):
        body = {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
        body = body if number else {"jsonrpc": "2.0", "method": method, "params": params}
        return httpx2.post(served.server.address, json=body, headers=head, timeout=60)

    post(1, "tools/call", {"name": "budget", "arguments": {}})
    message = []
    wait = threading.Thread(
        target=lambda: message.append(post(7, "tools/call", {"name": "wait", "arguments": {"seconds": 120}}))
    )
    wait.start()
    box = served.sessions.get_toolbox(head["mcp-session-id"])
    while not box.stage.loop.pace:
        time.sleep(0.001)
    post(0, "notifications/cancelled", {"requestId": 7})
    wait.join(30)
    assert "error" in message[0].json()
    used = post(8, "tools/call", {"name": "budget", "arguments": {}}).json()["result"]["structuredContent"]["used"]
    assert used["seconds"] < 120


def test_a_flood_of_sessions_without_a_call_keeps_no_one_out():
    """Each `initialize` opens one; of those that never call as many are kept as may have a stage, the oldest goes first."""
    import httpx2

    flooded = Served()
    flooded.sessions.limit = 3
    try:
        busy = open_session(flooded)
        body = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "budget", "arguments": {}}}

        def call(head):
            return httpx2.post(flooded.server.address, json=body, headers=head, timeout=60)

        assert call(busy).status_code == 200
        flood = [open_session(flooded) for _ in range(12)]
        assert [call(head).status_code for head in (flood[0], flood[5])] == [404, 404]
        assert call(flood[-1]).json()["result"]["isError"] is False
        assert call(busy).json()["result"]["isError"] is False
        assert len(flooded.sessions) == 2
    finally:
        flooded.close()


@pytest.mark.parametrize(
    ("name", "arguments"), [("find_lost_steps", {}), ("tune_move", {"distance": "5mm"}), ("bring_up_axis", {})]
)
def test_prompts_name_tools_and_prompts_that_exist(served, name, arguments):
    async def work(client):
        tools = [t.name for t in (await client.list_tools()).tools]
        requested = (await client.get_prompt(name, {"axis": "Y", **arguments})).messages[0].content.text
        known = {*tools, *[p.name for p in (await client.list_prompts()).prompts]}
        assert "axis y" in requested
        assert set(re.findall(r"`(\w+)`", requested)) <= known
        assert "5mm" in requested or not arguments
        assert not (await client.list_resource_templates()).resource_templates

    served.talk(work)


@pytest.mark.slow
def test_a_client_that_closes_its_pipes_leaves_no_traceback():
    with subprocess.Popen(
        [sys.executable, "-m", "stage", "mcp", "xy"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        begin = {"protocolVersion": "2025-11-25", "capabilities": {}, "clientInfo": {"name": "test", "version": "0"}}
        first = {"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": begin}
        process.stdin.write(json.dumps(first).encode() + b"\n")
        process.stdin.flush()
        assert process.stdout.readline()
        process.stdout.close()
        with contextlib.suppress(BrokenPipeError):
            for k in range(3):
                process.stdin.write(json.dumps({**first, "id": k + 1, "method": "ping"}).encode() + b"\n")
                process.stdin.flush()
                time.sleep(0.2)
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        assert process.wait(60) == 0
        assert process.stderr.read() == b""


@pytest.mark.parametrize("token", ["ab", "x" * 15, "\u00e9" * 20])
def test_a_token_that_is_guessed_is_refused(token, monkeypatch, capsys):
    from stage.cli import main

    monkeypatch.setenv("PULSESTAGE_TOKEN", token)
    assert main(["mcp", "xy", "--http", "--port", "0"]) == 2
    assert "16 or more" in capsys.readouterr().err


BEGIN = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "test", "version": "0"}}
FIRST = {"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": BEGIN}
LONG_CALL = {
    "jsonrpc": "2.0",
    "id": 1,
    "method": "tools/call",
    "params": {"name": "wait", "arguments": {"seconds": 120}},
}


def test_ctrl_c_during_a_call_over_stdio_ends_the_server_without_a_traceback():
    """The client lives on and keeps its pipe open: the server waited for it, and a second Ctrl-C printed a traceback."""
    with subprocess.Popen(
        [sys.executable, "-m", "stage", "mcp", "xy"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored in a background job of a shell
    ) as process:  # fmt: skip
        for line in (FIRST, {"jsonrpc": "2.0", "method": "notifications/initialized"}, LONG_CALL):
            process.stdin.write(json.dumps(line) + "\n")
            process.stdin.flush()
            if line is FIRST:
                process.stdout.readline()
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        try:
            assert process.wait(30) == 130
        finally:
            process.kill()
        assert process.stderr.read() == "stage: interrupted.\n"


@pytest.mark.slow
def test_ctrl_c_during_a_call_over_http_ends_the_call_and_the_server_without_a_traceback():
    with subprocess.Popen(
        [sys.executable, "-m", "stage", "mcp", "xy", "--http"],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        port, token = urlsplit(process.stdout.readline()).port, process.stdout.readline().split()[-1]

        def request(method, line=None, **more):
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            headers = {"Authorization": f"Bearer {token}", "Accept": "application/json, text/event-stream"}
            headers |= {"Content-Type": "application/json", **more}
            connection.request(method, "/mcp", None if line is None else json.dumps(line), headers)
            return connection.getresponse()

        session = {"mcp-session-id": request("POST", FIRST).getheader("mcp-session-id")}
        request("POST", {"jsonrpc": "2.0", "method": "notifications/initialized"}, **session)
        answers = []
        calling = threading.Thread(target=lambda: answers.append(request("POST", LONG_CALL, **session).read()))
        calling.start()
        assert request("GET", **session).status == 200  # a line that stays open
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        calling.join(30)
        assert b"The session ended during this call" in answers[0]
        assert process.stderr.read() == "stage: interrupted.\n"


def test_lines_of_a_pipe_come_in_order_and_the_last_without_its_end():
    """Cut anywhere, longer than a pipe, with bytes that are no UTF-8"""
    sent = [b"{}\n", b"\n", b"x" * 200_000 + b"\n", b"\xff\n", b"last"]

    content = b"".join(sent)

    def write(descriptor):
        for k in range(0, len(content), 7001):
            os.write(descriptor, content[k : k + 7001])
        os.close(descriptor)

    async def read():
        reading, writing = os.pipe()
        threading.Thread(target=write, args=(writing,)).start()
        lines = [line async for line in LineReader(reading)]
        os.close(reading)
        return lines

    assert asyncio.run(read()) == [line.decode(errors="replace") for line in sent]
