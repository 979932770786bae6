"""Tests of external players: JSON-lines commands, OpenAI-compatible endpoints, Model Context Protocol clients."""

import asyncio
import http.server
import sys
import threading

import pytest
from fake_model import FakeModel, calls, says

from registerbench.arena import make_suite, play_games, replay
from registerbench.arena.players.external_command import CommandPlayer
from registerbench.arena.players.model_endpoint import EndpointPlayer
from stage.errors import ArgumentError, StageError

SOLVES = """
import json, sys
def say(**line):
    print(json.dumps(line), flush=True)
    return json.loads(sys.stdin.readline())
begin = json.loads(sys.stdin.readline())
assert "customer" in begin["task"] and any(t["name"] == "run" for t in begin["tools"])
program = say(call="program", tokens=7)["answer"]["text"]
say(call="write_program", arguments={"text": program.replace("R6 <- 320 ", "R6 <- 3200")})
assert say(call="answer", arguments={"cause": "ramp-down point too late"})["ok"]
print(json.dumps({"done": True, "tokens": 5}), flush=True)
"""


def create_command_player(code, **how):
    return CommandPlayer([sys.executable, "-c", code], **how)


def test_a_command_that_speaks_json_lines_plays():
    played = play_games(make_suite("diagnosis:late"), create_command_player(SOLVES), "mine")
    assert played.value == pytest.approx(1.0 - 0.5 * 3 * 0.001)
    assert played.tokens == 12
    assert replay(played).is_same


@pytest.mark.parametrize(
    "code", ["", "print('hello')", "import sys; sys.exit(3)", "print('[1, 2]', flush=True)", "while True: print('{}', flush=True)",
             "print('x' * 3_000_000, flush=True)", "import os; os.close(1); input(); input()"]
)  # fmt: skip
def test_a_command_with_invalid_output_is_scored_normally(code):
    played = play_games(make_suite("diagnosis:late"), create_command_player(code), "odd")
    assert played.value == 0.0


def test_a_command_that_does_not_exist_is_reported():
    with pytest.raises(StageError, match="Name a program"):
        play_games(make_suite("diagnosis:late"), CommandPlayer("/nowhere/agent"))
    with pytest.raises(ArgumentError, match="is empty"):
        CommandPlayer("  ")


# --- endpoints ---


def reply_with_repair(body):
    """Return the reply of a model that has read the program and repairs it."""
    program = next(m["content"] for m in body["messages"] if m["role"] == "tool")
    return calls(
        ("write_program", {"text": program.replace("R6 <- 320 ", "R6 <- 3200")}),
        ("answer", {"cause": "ramp-down point too late"}),
        ("finish", {}),
    )


def test_a_model_at_an_endpoint_plays():
    with FakeModel(calls(("program", {})), says("let me see"), reply_with_repair) as model:
        played = play_games(make_suite("diagnosis:late"), EndpointPlayer(model.url, "fake", "secret"))
    assert (played.player, round(played.value, 9), played.tokens) == ("fake", 0.998, 21)
    assert model.heads[0]["Authorization"] == "Bearer secret"
    assert model.requests[0]["tools"][0]["type"] == "function"
    assert model.requests[-1]["messages"][0]["content"].startswith("You act by calling tools")
    assert replay(played).is_same


def test_errors_of_a_model_are_explained_to_it():
    wrong = calls(("runn", {}), ("service", '{"work": '), ("answer", '["x"]'), ("answer", {"cause": "late"}))
    with FakeModel(wrong, calls(("finish", {}))) as model:
        play_games(make_suite("diagnosis:late"), EndpointPlayer(model.url, "fake"))
        message = [m["content"] for m in model.requests[1]["messages"] if m["role"] == "tool"]
    assert all(text.startswith("error: ") for text in message)
    assert "Did you mean 'run'" in message[0]
    assert "should be an object" in message[1]


def test_a_model_that_calls_no_tool_ends_its_game():
    with FakeModel() as model:
        played = play_games(make_suite("diagnosis:late"), EndpointPlayer(model.url, "fake"))
    assert played.value == 0.0
    assert len(model.requests) == 3


def test_a_busy_endpoint_is_tried_again():
    with FakeModel(503, 429, calls(("finish", {}))) as model:
        assert play_games(make_suite("diagnosis:late"), EndpointPlayer(model.url, "fake", pause=0.0)).games[0].calls
    assert len(model.requests) == 3


NO_REPLIES = (
    (401, "401"), (b"<html>", "does not answer in JSON"), ({"choices": []}, "does not answer as chat"),
    ({"choices": [{"message": {"tool_calls": [1]}}]}, "does not answer as chat"),
)  # fmt: skip


@pytest.mark.parametrize(("reply", "message"), NO_REPLIES)
def test_an_invalid_endpoint_reply_is_reported(reply, message):
    with FakeModel(reply) as model, pytest.raises(StageError, match=message):
        play_games(make_suite("diagnosis:late"), EndpointPlayer(model.url, "fake", pause=0.0))


def test_an_endpoint_that_cannot_be_reached_is_reported():
    with pytest.raises(StageError, match="cannot be reached"):
        play_games(make_suite("diagnosis:late"), EndpointPlayer("http://127.0.0.1:9/v1", "fake", pause=0.0))


# --- clients ---


@pytest.mark.slow
def test_a_client_of_the_protocol_plays_a_game(tmp_path):
    pytest.importorskip("mcp")
    from mcp import Client
    from mcp.client.stdio import StdioServerParameters

    file = tmp_path / "t.jsonl"

    async def work():
        arguments = ["-m", "stage", "agent", "diagnosis:late", "--mcp", "-o", str(file)]
        async with Client(StdioServerParameters(command=sys.executable, args=arguments)) as client:
            assert "write_program" in [t.name for t in (await client.list_tools()).tools]
            assert not (await client.list_resources()).resources
            program = (await client.call_tool("program", {})).content[0].text
            better = program.replace("R6 <- 320 ", "R6 <- 3200")
            await client.call_tool("write_program", {"text": better})
            await client.call_tool("answer", {"cause": "ramp-down point too late"})
            await client.call_tool("finish", {})
            delayed = await client.call_tool("run", {})
            assert delayed.is_error
            assert "this game is over" in delayed.content[0].text
            await asyncio.sleep(0)

    asyncio.run(work())
    results = replay(file)
    assert results.is_same
    assert results.result.calls == 4


def test_the_api_key_is_sent_only_to_the_configured_address():
    """The endpoint answers 302; the request with its key is not forwarded."""
    came = []

    class Elsewhere(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            came.append(self.headers.get("Authorization"))
            self.send_response(200)
            self.end_headers()

        def do_POST(self):
            self.send_response(302)
            self.send_header("Location", f"http://localhost:{server.server_port}/steal")
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Elsewhere) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            url = f"http://127.0.0.1:{server.server_port}/v1"
            with pytest.raises(StageError, match="302"):
                play_games(make_suite("diagnosis:late"), EndpointPlayer(url, "m", "secret", pause=0.0))
        finally:
            server.shutdown()
    assert came == []
