"""Tests of docs/results.md: its verdicts, its command, and its numbers from data/results.parquet."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from registerbench.baselines import method_runs as published
from registerbench.baselines.method_runs import MethodRun, MethodRuns
from registerbench.baselines.move_tuning import MAX_HOLDING_MOVES, REPEATS, MoveLog

DOCS = Path(__file__).parents[1] / "docs"
DATA, PAGE = DOCS / "data" / "results.parquet", DOCS / "results.md"


@pytest.fixture
def results(monkeypatch):
    module = importlib.import_module("registerbench.baselines.baseline_comparison")
    monkeypatch.delitem(sys.modules, "registerbench.baselines.baseline_comparison")
    return module


def moves(*rewards, saved=True, duration=0.4, more=0.0):
    log = MoveLog()
    for k, reward in enumerate(rewards):
        log.append_move(
            reward, duration, 0 if saved else 4, 1e-5, saved, [1, 2, 3, 4, 5, 6], (32_000, 0.5 + more, k / len(rewards))
        )
    return log


def run(method="CMA-ES", seed=1, reward=-0.4, duration=0.4, matches=True):
    created = MethodRun(method, "heavy", seed, moves(-0.3, -0.35))
    if matches:
        created.proof_logs = {0: moves(-5.3, saved=False), 1: moves(*[-0.36] * 48)}
        created.test_logs = {context: moves(reward, duration=duration) for context in published.TEST_CONDITIONS}
    return created


@pytest.fixture(scope="module")
def all_():
    return MethodRuns.read(DATA)


def test_a_method_beats_the_formula_with_ten_seeds_and_a_positive_reward_interval(results):
    """Verdicts must compare rewards in new moves, not times or the rewards of the selection."""
    created = [run("formula", reward=-0.44, duration=0.43)]
    for method, rewards, durations in (
        ("CMA-ES", np.linspace(-0.41, -0.40, 10), [0.45] * 10),  # better by reward, slower
        ("PPO", np.linspace(-0.50, -0.40, 10), [0.40] * 10),  # faster
        ("random", [-0.40] * 10, [0.40] * 10),
        ("SAC", [-0.40] * 9, [0.40] * 9),
    ):
        for k, (reward, duration) in enumerate(zip(rewards, durations, strict=True)):
            created.append(run(method, k + 1, reward, duration, matches=(method, k) != ("random", 9)))
    created.append(run("agent loop", reward=-0.47, duration=0.47))
    message = results.describe_verdict(created, "heavy", results.FORMULA)
    assert (
        "(-440.0 ms, time 430.0 ms): by reward it is beaten by CMA-ES; better than none; open: random, PPO." in message
    )
    assert "In time it is beaten by PPO; better than CMA-ES; open: random." in message, "one of its ten found none"
    assert message.endswith("Fewer than 10 runs, hence no verdict: agent loop, SAC.")
    reported = {m.name: g for m, g in results.compute_gains(created, "heavy", results.FORMULA).items()}
    assert re.fullmatch(r"\+35\.0 \(\+3\d\.\d to \+3\d\.\d\)", reported["CMA-ES"][0].text)
    assert reported["agent loop"][0].text == "-30.0"


def test_an_answer_is_reported_by_its_test_and_not_by_its_proof():
    created = run(reward=-0.41)
    assert (created.answer_number, created.lucky_move_count) == (1, 1)
    assert created.compute_mean("reward") == pytest.approx(-410)
    assert created.reward_excess == pytest.approx(50)
    created.test_logs[published.NEW_MOVES] = moves(-0.4, -5.4)
    created.test_logs[published.NEW_MOVES].in_step[1] = False
    assert created.count_failed_moves(published.NEW_MOVES) == 1
    assert created.compute_mean("reward") == pytest.approx(-2900), "a lost step is paid for"
    assert created.compute_mean("reward", in_step_only=True) == pytest.approx(-400)


def test_spare_ends_at_the_first_payload_with_which_a_step_was_lost():
    created = run()
    assert created.spare_payload == 3.0
    created.test_logs["+2 kg"] = moves(-5.4, saved=False)
    assert created.spare_payload == 1.5
    created.test_logs["+0.5 kg"] = moves(-5.4, saved=False)
    assert created.spare_payload == 0.0


def test_runs_come_back_from_their_file_and_equal_ones_give_equal_bytes(tmp_path):
    some = MethodRuns(
        2, 2, {"heavy": 10.0}, versions={"mujoco": "3.17.0"}, runs=[run(seed=1), run(seed=2, matches=False)]
    )
    some.write(tmp_path / "a.parquet")
    back = MethodRuns.read(tmp_path / "a.parquet")
    back.write(tmp_path / "b.parquet")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert (back.budget, back.payloads, back.versions) == (2, {"heavy": 10.0}, {"mujoco": "3.17.0"})
    for old, new in zip(some.runs, back.runs, strict=True):
        assert (new.method, new.payload, new.seed, new.answer_number, new.lucky_move_count) == (
            old.method, old.payload, old.seed, old.answer_number, old.lucky_move_count,
        )  # fmt: skip
        assert new.search_log.registers == old.search_log.registers
        assert list(new.proof_logs) == list(old.proof_logs)
        assert list(new.test_logs) == list(old.test_logs)
        assert new.compute_mean("reward") == pytest.approx(old.compute_mean("reward"), rel=1e-6, nan_ok=True)


@pytest.mark.parametrize(
    ("created", "options"),
    [
        ({"payloads": {"light": 0.5, "heavy": 10.0}}, ""),
        ({"payloads": {"2 kg": 2.0, "5 kg": 5.0}, "model": "xy"}, "--model xy --payload 2 5 "),
        ({"payloads": {"light": 0.5}, "quick": True}, "--quick "),
        (
            {"payloads": {"2 kg": 2.0}, "quick": True, "model": "my stage.xml"},
            "--quick --model 'my stage.xml' --payload 2 ",
        ),
    ],
)
def test_the_page_states_the_command_that_generates_it(created, options, results):
    """The command includes non-default options such as `--model xy --payload 2`."""
    message = results.format_command(MethodRuns(16, 2, **created))
    assert message == f"python -m registerbench.baselines.baseline_comparison {options}--budget 16 --seeds 2"


def test_the_page_follows_from_the_published_moves(all_, results):
    assert PAGE.read_text() == results.format_page(all_)


def test_each_published_answer_follows_from_its_proofs(all_):
    """The test selects independently: of the first HELD that pass, the highest mean reward."""
    answers = 0
    for r in all_.runs:
        ranked = [k for k in np.argsort(-np.array(r.search_log.reward), kind="stable") if r.search_log.in_step[k]]
        assert list(r.proof_logs) == ranked[: len(r.proof_logs)]
        holding = {
            k: np.mean(log.reward) for k, log in r.proof_logs.items() if len(log) == REPEATS and all(log.in_step)
        }
        assert len(holding) <= MAX_HOLDING_MOVES
        assert r.answer_number == (max(holding, key=holding.get) if holding else None)
        assert {c: len(log) for c, log in r.test_logs.items()} == (
            {c: k.moves for c, k in published.TEST_CONDITIONS.items()} if holding else {}
        )
        registers = [log.registers for log in r.test_logs.values()]
        assert all(row == r.search_log.registers[r.answer_number] for rows in registers for row in rows)
        answers += bool(holding)
    assert answers > 80


def test_the_table_is_recomputed_from_the_rows_by_pandas(all_):
    """The table lists for each method the mean reward and time in new moves, for the middle half of the seeds."""
    pandas = pytest.importorskip("pandas")
    table = pandas.read_parquet(DATA)
    new = table[(table.part == "test") & (table.context == "new")]
    by_seed = new.groupby(["payload", "method", "seed"], observed=True)[["reward", "duration_s"]].mean() * 1e3
    lost = (~new.kept).groupby([new.payload, new.method], observed=True).sum()
    for payload, section in zip(("light", "heavy"), PAGE.read_text().split("### ")[1:3], strict=True):
        for line in section.splitlines():
            cells = [c.strip() for c in line.split("|")[1:-1]]
            if len(cells) == 11 and (payload, cells[0]) in lost.index:
                seeds = by_seed.loc[payload, cells[0]]
                for name, cell in (("reward", cells[3]), ("duration_s", cells[4])):
                    values = np.sort(seeds[name])
                    cut = len(values) // 4
                    assert float(cell.split()[0].rstrip(",")) == pytest.approx(
                        values[cut : len(values) - cut].mean(), abs=0.06
                    )
                assert int(cells[6].split()[0]) == lost[payload, cells[0]]
    assert len(lost) == 14


def test_no_search_and_no_proof_has_used_a_move_of_a_test_and_seed_0_is_not_among_the_seeds(all_):
    def drawn(logs):
        return {tuple(row[1:]) for log in logs for row in log.drawn}

    assert {r.seed for r in all_.runs} == set(range(1, 11))
    tests = drawn(log for r in all_.runs for log in r.test_logs.values())
    observations = drawn(log for r in all_.runs for log in (r.search_log, *r.proof_logs.values()))
    assert not tests & observations
    new = next(r.test_logs["new"] for r in all_.runs if r.test_logs)
    assert all(
        r.test_logs["new"].drawn == new.drawn for r in all_.runs if r.test_logs and r.payload == all_.runs[0].payload
    )
    assert sum(d < 0 for d, *_ in new.drawn) == len(new) // 2
