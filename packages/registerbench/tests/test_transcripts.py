"""Tests of transcripts: claims are recomputed, partial suites are marked, and interrupted runs continue."""

import dataclasses
import json

import pytest

from registerbench.arena import (
    RunInterrupted,
    TranscriptWriter,
    make_game_player,
    make_suite,
    play_games,
    read_transcript,
    replay,
    transcript,
    write_transcript,
)
from registerbench.arena.game_session import Limits
from registerbench.arena.suite_runner import make_header
from registerbench.arena.transcript_replay import replay_game
from stage.cli import main
from stage.errors import ArgumentError, StageError


def samples(table):
    """Sample the tools that cost nothing."""
    table.call("program")
    table.count_tokens(7)


@pytest.fixture(scope="module")
def delayed():
    return play_games(make_suite("diagnosis:late"), make_game_player("technician"), "technician")


@pytest.fixture(scope="module")
def three():
    return play_games(make_suite("diagnosis", episodes=3), samples, "looks")


def lines(path):
    return [json.loads(text) for text in path.read_text().splitlines()]


def write(path, rows):
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_a_transcript_is_replayed_bit_for_bit_without_the_player(delayed, tmp_path):
    file = tmp_path / "late.jsonl"
    write_transcript(delayed, file)
    back = read_transcript(file)
    assert (back.head, back.games) == (delayed.head, delayed.games)
    results = replay(file)
    assert results.is_same
    assert (results.result.value, results.result.calls) == (delayed.value, delayed.calls)


CHANGES = (
    ('"x_mm": 50.0', '"x_mm": 51.0'), ('"mended": 1.0', '"mended": 0.5'), ("R6 <- 3200", "R6 <- 3300"),
    ('"of": 10, "value": 0.9', '"of": 10, "value": 1.9'), ('"low": 0.9', '"low": 0.8'), ('"high": 0.9', '"high": 1.9'),
    ('"played": 1', '"played": 10'), ('"calls": ', '"calls": 1'),
)  # fmt: skip


@pytest.mark.parametrize(("was", "becomes"), CHANGES)
def test_a_transcript_that_was_changed_differs(delayed, tmp_path, was, becomes, capsys):
    file = tmp_path / "late.jsonl"
    write_transcript(delayed, file)
    text = file.read_text()
    assert was in text
    file.write_text(text.replace(was, becomes, 1))
    assert main(["agent-replay", str(file)]) == 1
    reported = capsys.readouterr().out
    assert "DIFFERS" in reported
    assert " to 0.9" not in reported


def test_unverifiable_fields_are_reported_as_claimed(three, tmp_path, capsys):
    file = tmp_path / "t.jsonl"
    write_transcript(three, file)
    rows = lines(file)
    rows[0]["player"] = "the best model\x1b[2J of all"
    write(file, rows)
    assert main(["agent-replay", str(file)]) == 0
    reported = capsys.readouterr().out
    assert "Claimed, and not to be verified: the player's name 'the best model\\x1b[2J of all', 21 tokens." in reported
    assert "\x1b" not in reported


def test_a_part_is_never_reported_as_the_suite(three, delayed, tmp_path, capsys):
    """A partial transcript counts its games and has no score of the suite."""
    for came, message in (
        (three, "3 of 64 games of diagnosis: "),
        (delayed, "1 of 10 games of diagnosis, for practice: "),
    ):
        assert message in str(came)
        assert "a part, and no score of the suite" in str(came)
        write_transcript(came, tmp_path / "t.jsonl", overwrite=True)
        assert main(["agent-replay", str(tmp_path / "t.jsonl")]) == 0
        reported = capsys.readouterr().out
        assert message in reported
        assert "no score of the suite" in reported
    assert main(["agent", "one-shot", "--episodes", "2"]) == 0
    assert "formula on 2 of 64 games of one-shot train: " in capsys.readouterr().out


@pytest.mark.parametrize("change", ["of", "fewer", "other", "seed", "round", "split"])
def test_a_part_cannot_be_written_as_complete(tmp_path, change, request):
    came = (
        play_games(make_suite("one-shot", episodes=2), make_game_player("random"), "r")
        if change in ("seed", "round", "split")
        else None
    )
    came = came or request.getfixturevalue("three")
    file = tmp_path / "t.jsonl"
    write_transcript(came, file)
    rows = lines(file)
    head = rows[0]
    if change == "of":
        head["of"] = 3
    elif change == "fewer":  # two games of three, the head told so
        head["games"] = head["games"][1:]
        first = [k for k, row in enumerate(rows) if "game" in row]
        rows[first[0] : first[1]] = []
    elif change == "other":
        head["games"] = [head["games"][0]] * 3
    elif change == "seed":
        head["games"][0][1] += 1
    elif change == "round":
        head["round"] = "mine"
    else:
        head["split"] = "weak"
    write(file, rows)
    with pytest.raises(ArgumentError, match="in the transcript"):
        replay(file)


def test_calls_after_the_end_or_beyond_the_limit_are_detected(tmp_path):
    came = play_games(make_suite("diagnosis:late"), lambda t: t.call("finish"), "f", Limits(max_calls=1))
    write_transcript(came, tmp_path / "t.jsonl")
    rows = lines(tmp_path / "t.jsonl")
    more = {
        "call": "answer",
        "arguments": {"cause": "ramp-down point too late"},
        "ok": True,
        "answer": {"text": "noted."},
    }
    write(tmp_path / "more.jsonl", [*rows[:3], more, *rows[3:]])
    assert "2 calls, and 1 are allowed" in replay(tmp_path / "more.jsonl").first_difference
    rows[0]["most"] = 400
    write(tmp_path / "more.jsonl", [*rows[:3], more, *rows[3:]])
    assert "the game was over before it" in replay(tmp_path / "more.jsonl").first_difference


HEAD = '{"format": ["PulseStage transcript", 2], "suite": "diagnosis"'
HEAD_LINE = (
    HEAD + ', "split": "", "round": "", "player": "", "games": [], "of": 10, "most": 1, "patience": 1, "time": 1}\n'
)
OTHERS = (
    "", "{}", "[]\n", HEAD.replace("2]", "1]") + "}", HEAD + "}", "\0" * 50, "[" * 5000, "null\n", '"format"\n',
    HEAD_LINE + '{"call": "x"}\n', HEAD_LINE + "[1]\n", HEAD_LINE + '{"score": {}}\n', HEAD_LINE.replace('"most": 1', '"most": -1'),
    HEAD_LINE + "[" * 5000 + "\n",
)  # fmt: skip


@pytest.mark.parametrize("text", OTHERS)
def test_a_file_that_is_no_transcript_is_refused_with_an_explanation(tmp_path, text):
    file = tmp_path / "other.jsonl"
    file.write_text(text)
    with pytest.raises(ArgumentError, match="no transcript"):
        read_transcript(file)
    assert main(["agent-replay", str(file)]) == 2


@pytest.mark.parametrize(("k", "key", "value"), [(0, "round", "mine"), (0, "split", "train"), (2, "ok", 1)])
def test_games_that_a_suite_does_not_contain_are_refused(three, tmp_path, k, key, value):
    write_transcript(three, tmp_path / "t.jsonl")
    rows = lines(tmp_path / "t.jsonl")
    rows[k][key] = value
    write(tmp_path / "t.jsonl", rows)
    assert main(["agent-replay", str(tmp_path / "t.jsonl")]) == 2


def test_limits_other_than_the_defaults_are_reported():
    assert "up to 9 calls a game, and 400 are usual" in str(
        play_games(make_suite("diagnosis:late"), samples, "l", Limits(max_calls=9))
    )


def test_a_transcript_of_the_bench_is_replayed_too(tmp_path):
    came = play_games(make_suite("few-shot", "weak", 2), make_game_player("random"), "random")
    write_transcript(came, tmp_path / "r.jsonl")
    assert replay(tmp_path / "r.jsonl").is_same


def test_a_transcript_of_a_round_with_a_word_is_replayed_too(tmp_path):
    came = play_games(make_suite("one-shot", episodes=1, round_="2027"), make_game_player("random"), "random")
    write_transcript(came, tmp_path / "r.jsonl")
    assert replay(tmp_path / "r.jsonl").is_same


# --- runs that break off ---


def create_breaking_player(at):
    """Return a player that raises an error in game `at`."""
    games = []

    def one(table):
        games.append(table.name)
        table.call("program")
        if len(games) == at:
            raise StageError("the endpoint is out of money")

    one.games = games
    return one


def test_a_run_that_breaks_off_leaves_its_games_and_continues(tmp_path):
    games, file = make_suite("diagnosis", episodes=4), tmp_path / "t.jsonl"
    with TranscriptWriter(file, make_header(games, "p", Limits())) as writer:
        with pytest.raises(RunInterrupted, match=r"^game 3 of 4, diagnosis:2: the endpoint is out of money$") as error:
            play_games(games, create_breaking_player(3), "p", report_progress=writer.write_game)
        assert len(error.value.result.games) == 2
    results = replay(file)
    assert not results.is_same
    assert "cut: 2 of its 4 games are there" in str(results)
    file.write_text(
        file.read_text() + '{"game": "diagnosis:2", "seed": 1000002}\n{"call": "pro'
    )  # killed while it wrote
    assert "2 of its 4 games" in replay(file).missing_part
    later = create_breaking_player(0)
    with TranscriptWriter(file, make_header(games, "p", Limits()), resume=True) as writer:
        came = play_games(games, later, "p", report_progress=writer.write_game, earlier_games=writer.earlier_games)
        writer.write_summary(came)
    assert later.games == ["diagnosis:2", "diagnosis:3"]
    assert replay(file).is_same
    assert len(read_transcript(file).games) == 4
    with pytest.raises(ArgumentError, match="nothing is left"):
        TranscriptWriter(file, make_header(games, "p", Limits()), resume=True)


def test_the_command_continues_where_it_broke_off(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broke.py").write_text(
        "import os\nfrom stage import StageError\ndef play(table):\n    table.call('observe')\n"
        "    if table.name.endswith(':1') and not os.path.exists('money'):\n        raise StageError('no money')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    run = ["agent", "one-shot", "--episodes", "3", "--by", "broke:play", "-o", "t.jsonl", "--entry", "e.bench"]
    assert main(run) == 2
    out, err = capsys.readouterr()
    assert "1 of 64 games of one-shot train" in out
    assert "game 2 of 3, one-shot:train:1: no money" in err
    assert "--resume goes on" in err
    assert main(["agent-replay", "t.jsonl"]) == 1
    (tmp_path / "money").touch()
    assert main([*run[:-4], "-o", "t.jsonl"]) == 2
    assert "or --resume to go on with it" in capsys.readouterr().err
    assert main([*run, "--resume", "--most", "9"]) == 2
    assert "of another run, by its limits" in capsys.readouterr().err
    assert main([*run, "--resume"]) == 0
    assert "3 of 64 games" in capsys.readouterr().out
    assert main(["agent-replay", "t.jsonl"]) == 0
    assert main(["bench-verify", "e.bench"]) == 0


def test_continuing_requires_the_earlier_games_to_replay_identically(tmp_path, three):
    file = tmp_path / "t.jsonl"
    write_transcript(three, file)
    rows = lines(file)[:-1]
    rows[2]["answer"] = {"text": "nothing"}
    write(file, rows)
    with (
        TranscriptWriter(file, three.head, resume=True) as writer,
        pytest.raises(ArgumentError, match="comes out otherwise here"),
    ):
        play_games(make_suite("diagnosis", episodes=3), samples, "looks", earlier_games=writer.earlier_games)


def test_a_transcript_that_ends_within_a_game_is_refused(tmp_path):
    """The last game of the transcript lacks the line of its score."""
    games, file = make_suite("diagnosis", episodes=2), tmp_path / "t.jsonl"
    write_transcript(play_games(games, create_breaking_player(0), "p"), file)
    lines = file.read_text().splitlines(keepends=True)
    scores = [k for k, line in enumerate(lines) if "score" in json.loads(line)]
    file.write_text("".join(lines[: scores[-1]] + lines[scores[-1] + 1 :]))
    with pytest.raises(
        ArgumentError, match=rf"t\.jsonl, line {scores[-1] + 1}: no transcript of `stage agent`: a line out of"
    ):
        read_transcript(file)


def test_a_game_is_flushed_to_disk_before_the_next_begins(tmp_path, monkeypatch, three):
    synced = []
    monkeypatch.setattr(transcript.os, "fsync", lambda number: synced.append((tmp_path / "t.jsonl").stat().st_size))
    with TranscriptWriter(tmp_path / "t.jsonl", three.head) as writer:
        for r in three.games:
            writer.write_game(r)
        writer.write_summary(three)
    assert writer._file.closed
    assert len(synced) == len(three.games) + 2
    assert synced == sorted(set(synced))
    assert synced[-1] == (tmp_path / "t.jsonl").stat().st_size


SPOILED = (
    (1, "seed", True, "no whole number"), (1, "seed", -1, "no whole number"), (1, "game", 5, "no text"),
    (1, "game", "g" * 2001, "no text"), (2, "ok", None, "neither true nor false"), (-2, "tokens", 1.5, "no whole number"),
    (-2, "ended", None, "no text"), (-2, "troubles", {"x": -1}, "no whole number"), (0, "most", 0, "most=0"),
    (0, "patience", "x", "patience"), (0, "player", None, "no text"), (0, "games", [["a"]], "values"),
)  # fmt: skip


@pytest.mark.parametrize(("row", "key", "value", "says"), SPOILED)
def test_a_transcript_with_a_wrong_value_is_refused_with_the_value(delayed, tmp_path, row, key, value, says):
    file = tmp_path / "late.jsonl"
    write_transcript(delayed, file)
    rows = lines(file)
    assert key in rows[row]
    rows[row][key] = value
    write(file, rows)
    with pytest.raises(ArgumentError, match=rf"no transcript of `stage agent`: .*{says}"):
        read_transcript(file)


def test_a_line_after_the_end_of_a_transcript_is_refused(delayed, tmp_path):
    file = tmp_path / "late.jsonl"
    write_transcript(delayed, file)
    rows = lines(file)
    write(file, [*rows, rows[1]])
    with pytest.raises(ArgumentError, match=rf"line {len(rows) + 1}\b.*behind its end"):
        read_transcript(file)


def test_a_game_that_is_played_again_says_where_it_first_differs(delayed):
    (claimed,) = delayed.games
    game = next(iter(make_suite("diagnosis:late")))
    assert "with seed" in replay_game(game, dataclasses.replace(claimed, seed=5))
    assert "2 are allowed" in replay_game(game, claimed, max_calls=2)
    unmade = [{**row, "made": False, "ok": True} for row in claimed.calls]
    assert "call 1, 'program'" in (message := replay_game(game, dataclasses.replace(claimed, calls=unmade)))
    assert "it was not made, and has an answer" in message
