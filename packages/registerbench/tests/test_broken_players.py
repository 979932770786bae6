"""Players that hang, fail or send nonsense: the run continues and explains what went wrong."""

import asyncio
import http.server
import json
import subprocess
import sys
import threading
import time

import pytest
from fake_model import FakeModel, calls

from registerbench.arena import Limits, make_suite, play_games, replay
from registerbench.arena.players.external_command import CommandPlayer
from registerbench.arena.players.model_endpoint import EndpointPlayer
from stage.cli import main

SHORT = Limits(patience=0.15)
AGENT_COMMAND = ["agent", "diagnosis:late"]


def get_end_reason(player, limits=SHORT):
    """Play one game and return the reason for its end; fail if it takes too long."""
    started = time.monotonic()
    came = play_games(make_suite("diagnosis:late"), player, "slow", limits)
    assert time.monotonic() - started < 60  # the players hang for 1000 s
    assert not came.is_valid
    assert replay(came).is_same
    return came.games[0].end_reason


# --- who hangs ---


@pytest.mark.parametrize(
    "words", [["sleep", "1000"], ["sh", "-c", "sleep 1000; true"],
              ["sh", "-c", 'while true; do echo \'{"call": "program"}\'; done']]
)  # fmt: skip
def test_a_command_that_hangs_or_never_reads_is_abandoned(words):
    assert "timed out" in get_end_reason(CommandPlayer(words), Limits(patience=0.15, max_calls=10**6))


def test_a_function_that_hangs_is_abandoned_and_the_next_game_is_played():
    def hangs(table):
        table.call("program")
        if table.name.endswith(":0"):
            while True:
                pass

    came = play_games(make_suite("diagnosis", episodes=2), hangs, "hangs", SHORT)
    assert [r.end_reason for r in came.games] == ["timed out: no call for 0.15 s", ""]
    assert [r.valid_calls for r in came.games] == [1, 1]
    assert not came.is_valid


def test_a_game_has_a_time_limit():
    def dawdles(table):
        while not table.over:
            table.call("task")
            time.sleep(0.05)

    assert get_end_reason(dawdles, Limits(time=0.2)) == "timed out: its calls took 0.2 s in all"


def test_a_function_that_ignores_the_end_of_a_game_is_terminated():
    def ignores(table):
        while True:
            table.call("budget")

    came = play_games(make_suite("diagnosis:late"), ignores, "i", Limits(max_calls=5))
    assert len(came.games[0].calls) == 5
    assert came.trouble_counts["calls after the end"]


def test_simulation_time_does_not_count_against_the_player():
    def waits(table):
        table.call("wait", {"seconds": 6})
        table.call("wait", {"seconds": 6})

    assert play_games(make_suite("diagnosis:late"), waits, "w", Limits(patience=0.2, time=0.2)).is_valid


class Drips(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        self.send_response(200)
        self.end_headers()
        while not self.server.done.wait(0.02):
            try:
                self.wfile.write(b" ")
                self.wfile.flush()
            except OSError:
                return

    def log_message(self, *_):
        pass


def test_an_endpoint_that_sends_single_bytes_is_abandoned():
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Drips) as server:
        server.done = threading.Event()
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        try:
            assert "timed out" in get_end_reason(EndpointPlayer(f"http://127.0.0.1:{server.server_port}/v1", "m"))
        finally:
            server.done.set()
            server.shutdown()


@pytest.mark.slow
def test_a_client_that_hangs_is_abandoned():
    command = [sys.executable, "-m", "stage", *AGENT_COMMAND, "--mcp", "--patience", "0.3"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as p:
        assert p.wait(60) == 1
        assert "timed out: no call for 0.3 s" in p.stderr.read()


@pytest.mark.parametrize("values", ["nan", "0", "-1", "inf"])
def test_invalid_limits_are_refused(values, capsys):
    for name in ("--patience", "--time"):
        assert main([*AGENT_COMMAND, name, values]) == 2
        assert "seconds, more than 0" in capsys.readouterr().err
    assert main([*AGENT_COMMAND, "--most", "0"]) == 2


# --- who is broken ---

BROKEN = (
    (["--command", "false"], 1, "the command ended with exit code 1"),
    (["--command", "true"], 1, "the command ended without a call"),
    (["--command", "cat"], 1, "a line that is no call (20 times)"), (["--command", "yes"], 1, "a line that is no call (20 times)"),
    (["--command", "echo '{\"call\": \"fly\"}'"], 1, "not one valid call in 1 games; the first answer was: tool: 'fly'"),
    (["--command", "head -c 100000 /dev/urandom"], 1, "a line that is no call"), (["--command", ""], 2, "is empty"),
    (["--command", "'unclosed"], 2, "Close its quotes"), (["--command", "/nowhere/agent"], 2, "Name a program"),
    (["--command", "a\0b"], 2, "Name a program"), (["--by", "../x:y"], 2, "Name a module"), (["--by", ".x:y"], 2, "Name a module"),
    (["--by", ""], 2, "unknown player"), (["--endpoint", "", "--model", "m"], 2, "begins with http"),
    (["--by", "formula"], 1, "not one valid"),
    (["--split", "test"], 2, "has no splits"), (["--by", ":"], 2, "Name a module"),
)  # fmt: skip


@pytest.mark.parametrize(("arguments", "code", "message"), BROKEN)
def test_a_broken_player_is_explained_along_with_its_score(arguments, code, message, capsys):
    assert main([*AGENT_COMMAND, *arguments]) == code
    err = capsys.readouterr().err
    assert message in err
    assert "Traceback" not in err


def test_a_failing_user_function_ends_its_game(tmp_path, monkeypatch, capsys):
    (tmp_path / "fails_now.py").write_text(
        "def play(table):\n    table.call('program')\n    if table.name == 'diagnosis:1':\n        raise KeyError('x')\n"
        "async def later(table):\n    table.call('program')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["agent", "diagnosis", "--episodes", "3", "--by", "fails_now:play"]) == 1
    out, err = capsys.readouterr()
    assert "3 of 64 games" in out
    assert "stage: diagnosis:1: failed: KeyError: 'x'" in err
    assert main([*AGENT_COMMAND, "--by", "fails_now:later"]) == 0
    assert "1 calls" in capsys.readouterr().out


def test_a_function_without_await_may_be_async():
    async def later(table):
        await asyncio.sleep(0)
        table.call("program")

    assert play_games(make_suite("diagnosis:late"), later).games[0].valid_calls == 1


@pytest.mark.parametrize("tokens", ["12", -1, 1.5, True, [1], 1 << 60])
def test_invalid_token_counts_are_ignored_and_reported(tokens):
    with FakeModel(calls(("finish", {}), tokens=tokens)) as model:
        came = play_games(make_suite("diagnosis:late"), EndpointPlayer(model.url, "fake"))
    assert came.tokens == 0
    assert came.trouble_counts["tokens that are no whole number, and are not counted"] == 1


@pytest.mark.parametrize("tokens", [0, 1, (1 << 40) - 1])
def test_an_integer_token_count_is_added_including_zero(tokens):
    with FakeModel(calls(("finish", {}), tokens=tokens)) as model:
        came = play_games(make_suite("diagnosis:late"), EndpointPlayer(model.url, "fake"))
    assert (came.tokens, came.trouble_counts["tokens that are no whole number, and are not counted"]) == (tokens, 0)


def nest_lists(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


@pytest.mark.parametrize("values", [{b"x": 1}, {"text": nest_lists(100_000)}, {(1, 2): 3}])
def test_arguments_that_json_cannot_hold_are_refused(values):
    def odd(table):
        assert "cannot be written as JSON" in table.call("write_program", values).text
        table.call("task")

    came = play_games(make_suite("diagnosis:late"), odd)
    assert replay(came).is_same
    json.dumps(came.games[0].calls)


def test_deeply_nested_json_does_not_end_the_game():
    code = "import sys; input(); print('{\"call\": \"task\", \"arguments\": ' + '[' * 900 + ']' * 900 + '}', flush=True); input()"
    came = play_games(make_suite("diagnosis:late"), CommandPlayer([sys.executable, "-c", code]))
    assert came.games[0].valid_calls == 0
    assert replay(came).is_same


def test_an_answer_after_the_end_does_not_count():
    def delayed(table):
        table.call("finish")
        assert "this game is over" in table.call("answer", {"cause": "ramp-down point too late"}).text

    assert play_games(make_suite("diagnosis:late"), delayed).value == 0
