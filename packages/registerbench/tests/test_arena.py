"""Tests of games, transcripts, entries and the shipped players."""

import json
import re
from importlib.util import find_spec
from pathlib import Path

import pytest

import registerbench
from registerbench.arena import GameSession, Limits, list_suites, make_game_player, make_suite, play_games
from registerbench.arena.players import SHIPPED_PLAYERS
from registerbench.benchmark_tasks import CARDS
from registerbench.diagnosis import SETUPS
from stage.cli import main
from stage.errors import ArgumentError


@pytest.fixture(scope="module")
def delayed():
    return play_games(make_suite("diagnosis:late"), make_game_player("technician"), "technician")


@pytest.mark.parametrize("task", CARDS)
def test_every_task_of_the_bench_is_played_by_tools(task):
    observed = []

    def formula(table):
        assert "RegisterBench" in table.task
        observed.append({t["name"] for t in table.tools})
        message = table.call("formula")
        assert message.ok
        while not table.over:
            assert table.call("act", table.call("formula").data).ok
        assert "over" in table.call("act", message.data).text

    played = play_games(make_suite(task, episodes=1), formula)
    assert observed == [{"task", "observe", "formula", "act"}]
    assert played.games[0].score["given_up"] == 0
    verdict = registerbench.verify(played.entry)
    assert verdict.exact, verdict
    assert played.entry.track == "tools"


def test_the_formula_scores_the_same_with_and_without_tools():
    by_tools = play_games(make_suite("one-shot", episodes=3), make_game_player("formula"))
    alone = registerbench.play("formula", "one-shot", episodes=3)
    assert [r.score["return"] for r in by_tools.games] == pytest.approx(alone.scores["return"].tolist(), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("player", "column"), [("formula", 0), ("trained", 4)])
def test_the_table_of_the_page_has_the_scores_of_the_shipped_players(player, column):
    page = (Path(__file__).parents[1] / "docs" / "measuring_agents.md").read_text()
    cells = re.search(r"^\| `one-shot` \| (.*) \|$", page, re.M)[1].split(" | ")
    played = play_games(make_suite("one-shot", episodes=16), make_game_player(player))
    assert cells[column] == f"{played.value:.2f} ({played.low:.2f} to {played.high:.2f})"


def test_a_player_that_leaves_early_is_scored_and_its_entry_is_valid():
    played = play_games(make_suite("bus-target", episodes=1), lambda table: table.call("act", {"macro": "rates usual"}))
    assert played.games[0].score["given_up"] > 10
    assert registerbench.verify(played.entry).exact


@pytest.mark.parametrize(
    "arguments", [{}, {"start": 1, "drive": 2, "up": 1, "down": 1}, {"start": "NaN"}, {"macro": "x"}]
)
def test_an_invalid_action_does_nothing(arguments):
    def act(table):
        answer = table.call("act", arguments)
        assert not answer.ok
        assert "act" in answer.text or "start" in answer.text

    assert play_games(make_suite("one-shot", episodes=1), act).games[0].score["given_up"] == 1


@pytest.mark.parametrize("name", sorted(SHIPPED_PLAYERS))
def test_every_shipped_player_plays_a_task_and_a_set_up(name):
    if name == "optuna":
        pytest.importorskip("optuna")
    attempts = play_games(make_suite("few-shot", episodes=1), make_game_player(name), name)
    assert attempts.games[0].score["moves"] == 8
    assert play_games(make_suite("diagnosis:late"), make_game_player(name), name).value >= -0.5


def test_the_technician_diagnoses_and_repairs_a_ramp_down_point_error(delayed):
    assert delayed.value > 0.95
    assert delayed.games[0].score["runs"] == 3


@pytest.mark.slow
def test_the_technician_diagnoses_and_repairs_all_ten_setups():
    assert all(
        play_games(make_suite(f"diagnosis:{name}"), make_game_player("technician")).value > 0.95 for name in SETUPS
    )


def test_a_game_ends_at_its_maximum_number_of_calls():
    def query_budget(table: GameSession):
        while not table.over:
            table.call("budget")
        assert "a game has no more" in table.call("finish").text

    assert len(play_games(make_suite("diagnosis:late"), query_budget, limits=Limits(max_calls=5)).games[0].calls) == 5


# --- words ---


NO_SUITES = (
    ("diagnose", "Did you mean 'diagnosis'"), ("diagnosis:supplly", "Did you mean 'supply'"), ("few-shot:3", "no names in them"),
)  # fmt: skip


@pytest.mark.parametrize(("name", "message"), NO_SUITES)
def test_an_unknown_suite_is_refused(name, message):
    with pytest.raises(ArgumentError, match=message):
        make_suite(name)
    assert "diagnosis" in list_suites()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("techician", "Did you mean 'technician'"),
        ("nowhere:play", "Name a module"),
        ("json:nothing", "has no 'nothing'"),
    ],
)
def test_an_invalid_player_is_refused(name, message):
    with pytest.raises(ArgumentError, match=message):
        make_game_player(name)


def test_the_command_plays_and_replays(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["agent", "diagnosis:late", "--by", "technician", "-o", "t.jsonl"]) == 0
    reported = capsys.readouterr().out
    assert "diagnosis:late         found  mended" in reported
    assert (
        "technician on 1 of 10 games of diagnosis, for practice: 0.968 (0.968 to 0.968), mean of found and mended; a part"
        in reported
    )
    assert main(["agent-replay", "t.jsonl"]) == 0
    assert "bit for bit" in capsys.readouterr().out
    assert main(["agent", "one-shot", "--episodes", "2", "--entry", "f.bench", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert len(reported["games"]) == 2
    assert main(["bench-verify", "f.bench"]) == 0
    for arguments, message in (
        *([(["agent", "diagnosis", "--mcp"], "one game for one client")] if find_spec("mcp") else []),
        (["agent", "diagnosis", "--mcp", "--by", "x"], "one player at a time"),
        (["agent", "diagnosis:late", "--entry", "x.bench"], "entries are of RegisterBench"),
        (["agent", "diagnosis:late", "--endpoint", "ftp://x", "--model", "m"], "begins with http"),
        (["agent", "diagnosis:late", "--endpoint", "http://x/v1"], "--model NAME"),
        (
            ["agent", "diagnosis:late", "--endpoint", "http://x", "--model", "m", "--key-env", "NO_SUCH"],
            "no such variable",
        ),
        (["agent", "diagnosis:late", "-o", "t.jsonl"], "exists"),
        (["agent-replay", "nothing.jsonl"], "there is no transcript nothing.jsonl"),
    ):
        capsys.readouterr()
        assert main(arguments) == 2
        assert message in capsys.readouterr().err


FREE = {"budget", "describe", "diagnostics", "picture", "registers", "report", "trace"}
MOVES = {"home", "line", "move", "start"}
"""Tools of every toolbox: FREE cost nothing, MOVES count as moves."""


@pytest.mark.parametrize("task", ["one-shot", "few-shot", "bus-target", "home", "line"])
def test_only_the_tool_act_counts_as_a_move_in_a_task(task):
    game = next(iter(make_suite(task, episodes=1)))
    tools = game.calls.tools.values()
    assert {t.name for t in tools if t.free} == {"task", "observe", "formula"}
    assert {t.name for t in tools if t.moves} == {"act"}


def test_only_runs_count_in_a_broken_setup_and_reading_or_measuring_is_free():
    tools = next(iter(make_suite("diagnosis:late"))).calls.tools.values()
    more = {"task", "program", "write_program", "measure", "service", "answer", "finish"}
    assert {t.name for t in tools if t.free} == FREE | more
    assert {t.name for t in tools if t.moves} == MOVES


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ("agent diagnosis:late -o a.txt", "a.txt: a transcript is no 'txt'. Name a file that ends in .jsonl."),
        ("agent one-shot --entry a.zip", "a.zip: an entry is no 'zip'. Name a file that ends in .bench."),
        ("bench-submit random -o a", "Name a file that ends in .bench."),
    ],
)
def test_a_bad_output_name_is_refused_before_a_game_is_played(argv, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(argv.split()) == 2
    assert message in capsys.readouterr().err
