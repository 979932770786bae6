"""The commands of the benchmark: every option arrives at what plays, replays and compares; codes and files as their help says."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import registerbench
from registerbench import CARDS, list_test_seeds
from registerbench.bench_commands import _compute_mean_scores
from stage.cli import main
from stage.envs import machine_contexts


@pytest.fixture
def played(monkeypatch, tmp_path):
    """A function from arguments to the exit code and the arguments of `play` and of the entry's `write`."""
    monkeypatch.chdir(tmp_path)

    def run(*typed, episodes=64):
        arguments = []

        def play(*of, report_progress=None, **how):
            arguments.append((of, how))
            scores = {"return": np.array([1.0, 2.0]), "time": np.array([1.0, np.inf])}
            about = {"player": "p", "task": of[1], "split": of[2]}
            written = lambda *of: arguments.append(of)  # noqa: E731
            return SimpleNamespace(**about, seeds=range(episodes), rewards=np.zeros(9), scores=scores, write=written)

        monkeypatch.setattr(registerbench, "play", play)
        return main(["bench-submit", *typed]), *arguments

    return run


def test_options_that_are_not_set_have_their_defaults(played, capsys):
    code, (of, how), (path, force) = played("random", "-o", "a.bench")
    assert (code, of, path, force) == (0, ("random", "few-shot", "train"), "a.bench", False)
    assert how == {
        "track": "host", "round_": "open", "settings": {}, "name": None, "run": 0, "notes": "", "cost": {}, "training": "",
        "sandbox": [], "episodes": None,
    }  # fmt: skip
    text = capsys.readouterr().out
    assert "return 1.5 (means)" in text, "what is infinite has no mean"
    assert "can stand in no table" not in text


def test_every_option_reaches_the_setting_that_its_help_describes(played, capsys):
    code, (of, how), (path, force) = played(
        "mine:policy", "-o", "b.bench", "--task", "few-shot-wide", "--split", "loose", "--track", "truth", "--round", "2027",
        "--set", "memory=last", "--name", "me", "--run", "4", "--notes", "by hand", "--cost", "moves=3", "--cost", "tokens=1e6",
        "--training", "python train.py {run} {out}", "--sandbox", "box -x", "--episodes", "5", "--force", episodes=5,
    )  # fmt: skip
    assert (code, of, path, force) == (0, ("mine:policy", "few-shot-wide", "loose"), "b.bench", True)
    assert how == {
        "track": "truth", "round_": "2027", "settings": {"memory": "last"}, "name": "me", "run": 4, "notes": "by hand",
        "cost": {"moves": 3.0, "tokens": 1e6}, "training": "python train.py {run} {out}", "sandbox": ["box", "-x"],
        "episodes": 5,
    }  # fmt: skip
    assert "part of the 64 test episodes alone: this entry can stand in no table" in capsys.readouterr().out


@pytest.mark.parametrize("cost", ["moves=-1", "=3", "moves=", "moves=nan", "moves=1e16"])
def test_an_invalid_cost_is_refused(played, capsys, cost):
    assert played("random", "-o", "a.bench", "--cost", cost) == (2,)
    assert f"--cost {cost}: NAME=NUMBER, from 0 up" in capsys.readouterr().err


def test_a_mean_is_of_finite_numbers_alone():
    entry = SimpleNamespace(scores={"a": np.array([1.0, 4.0]), "b": np.array([1.0, np.inf])})
    assert _compute_mean_scores(entry) == {"a": 2.5, "b": None}


def test_a_replay_uses_the_requested_tolerance_and_returns_its_exit_code(monkeypatch, capsys):
    requested = []

    class Verdict(SimpleNamespace):
        def json(self):
            return {"ok": self.is_confirmed}

    def verify(file, tolerance, reported):
        requested.append((file, tolerance))
        return Verdict(is_confirmed=tolerance is not None, exact=False)

    monkeypatch.setattr(registerbench, "verify", verify)
    assert main(["bench-verify", "a.bench", "--tolerance", "1e-9", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"ok": True}
    assert main(["bench-verify", "a.bench"]) == 1
    assert requested == [("a.bench", 1e-9), ("a.bench", None)]


def test_a_table_in_json_has_its_rows(monkeypatch, capsys):
    entry = SimpleNamespace(
        task="home", split="worn", track="host", round="open", player="a", run=0, cost={},
        seeds=list_test_seeds(CARDS["home"], "worn"), actions=np.zeros(64), steps=np.ones(64, int),
        scores={"return": np.tile([1.0, 3.0], 32), "success": np.tile([1.0, 0.0], 32)},
    )  # fmt: skip
    monkeypatch.setattr(registerbench, "read_entries", lambda path: {"a.bench": entry})
    assert main(["bench-table", "a.bench", "--json", "--no-replay"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["value"] == 2.0
    assert (row["task"], row["split"], row["player"], row["runs"], row["success"]) == ("home", "worn", "a", 1, 0.5)
    assert (row["round"], row["mean"], row["regret"], row["replayed"]) == ("open", 2.0, None, False)


@pytest.mark.parametrize("name", CARDS)
def test_a_card_describes_the_machines_of_each_split(name, capsys):
    card = CARDS[name]
    config = card.make_env("train", "host", {})._task.config
    for split in card.splits:
        text = card.describe_machines(split)
        requested = machine_contexts.SPLITS[split]
        assert all(f"{of} {requested[of]}" in text for of in ("model", "chip") if of in requested)
        for of, (ranges, unit) in machine_contexts.CONTEXT_NUMBERS.items():
            ends = dict(card.settings).get(ranges, requested.get(ranges)) if ranges in requested else None
            assert (f"{of} {ends[0]:g} to {ends[1]:g} {unit}" in text) if ends else f"{of} " not in text
        faults = [fault for fault in requested.get("faults", ()) if fault in config.FAULTS]
        assert text.endswith(f"a fault: {', '.join(faults)}") if faults else "fault" not in text
    assert main(["bench", name]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert all(f"{split} {card.describe_machines(split)}" in printed for split in card.splits)
    assert main(["bench", name, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[name]["machines"]["train"] == card.describe_machines("train")
