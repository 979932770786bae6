"""Cheats in tables of entries that no longer pay, and the comparisons that a table makes."""

import dataclasses
import re
import sys

import numpy as np
import pytest

import registerbench
from registerbench import benchmark_tasks, score_statistics
from registerbench.baselines.oracle import search_split
from registerbench.benchmark_tasks import Card
from registerbench.entry_checks import check_entries, digest_actions, is_copy
from registerbench.entry_files import unpack_entry
from stage.cli import main
from stage.envs.few_shot import make_action

BRIEF = Card(
    "brief", "stage/OneShotTuning-v1", "a trial", episodes=4,
    settings={"model": "xy", "distances": (1600, 2000), "proofs": 1, "settle": 0.01},
)  # fmt: skip


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    monkeypatch.setitem(benchmark_tasks.CARDS, "brief", BRIEF)


def careful(observation, info):
    return make_action(1000, 30_000, 0.08, 0.08)


@pytest.fixture
def honest():
    return registerbench.play(careful, "brief", name="honest")


def compute_rows(*entries, **options):
    return {row.player: row for row in score_statistics.compute_rows(entries, check_entries(entries, **options))}


def claim(entry, player, run=0, rewards=None, **changes):
    """Return a copy of an entry under another name, with rewards that somebody typed."""
    scores = {**entry.scores, "return": entry.scores["return"] if rewards is None else np.full(4, rewards)}
    rewards = entry.rewards if rewards is None else np.full(len(entry.rewards), rewards)
    return dataclasses.replace(entry, player=player, run=run, rewards=rewards, scores=scores, **changes)


def test_rewards_typed_by_hand_rank_below_all_that_is_replayed(honest):
    """Check a table that once replayed nothing, and that they topped."""
    rows = compute_rows(claim(honest, "typed", rewards=9.0), honest)
    assert list(rows) == ["honest", "typed"]
    assert "differs here: episode 0" in rows["typed"].doubt
    assert not rows["typed"].beats(rows["honest"])
    rows = compute_rows(honest, replay=False)
    assert rows["honest"].doubt == "not replayed"


def test_one_run_under_ten_numbers_counts_once(honest):
    copies = [claim(honest, "copied", run=k) for k in range(10)]
    row = compute_rows(*copies)["copied"]
    assert (row.runs, row.copies) == (1, 9)
    assert row.doubt == "too few runs: 10 are needed"


def test_runs_that_differ_by_a_last_bit_are_copies(honest):
    """Lower the drive rate by 1 to 9 last bits: ten "different" runs of one policy beat others without doubt."""
    runs = []
    for k in range(10):
        actions = honest.actions.copy()
        for _ in range(k):
            actions[:, 1] = np.nextafter(actions[:, 1], np.float32(-1))
        runs.append(registerbench.play(RecordedPolicy(actions), "brief", name="copied", run=k))
    assert len({digest_actions(e) for e in runs}) == 10
    row = compute_rows(*runs)["copied"]
    assert (row.runs, row.copies) == (1, 9)


@pytest.mark.parametrize(
    ("returns", "others", "success", "copied"),
    [
        ([1.0, 2.0, 3.0, -0.05], [1.0, 2.0, 3.0, -0.06], [1, 1, 1, 0], True),
        ([1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 3.1, 4.1], [1, 1, 1, 1], False),
        ([1.0, 2.0, -0.05, -0.05], [1.1, 2.0, -0.05, -0.05], [1, 1, 0, 0], False),
        ([1.0, 0.0, 0.0, 0.0], [1.1, 0.0, 0.0, 0.0], [1, 1, 1, 1], False),
    ],
)
def test_equal_returns_of_failures_make_no_copies(honest, returns, others, success, copied):
    scores = [{"return": np.array(values), "success": np.array(success, float)} for values in (returns, others)]
    e = dataclasses.replace(honest, scores=scores[0])
    assert is_copy(e, dataclasses.replace(honest, actions=honest.actions * np.float32(0.9), scores=scores[1])) == copied


def test_the_name_of_a_player_makes_no_cells_of_a_table(honest):
    """Name a player "mine | 10 x 64 | 9.999 | ... |<!--": the reader saw these cells, and not those of the row."""
    table = score_statistics.format_rows(list(compute_rows(claim(honest, "mine | 9 |<!--")).values()))
    head, _, row = table.splitlines()[2:5]
    assert "mine \\| 9 \\|\\<!--" in row
    assert len(re.findall(r"(?<!\\)\|", row)) == len(re.findall(r"(?<!\\)\|", head))


def test_the_best_ten_runs_of_many_beat_nobody(honest):
    """Train 24 runs and enter the best ten: all figures of the row were those of luck."""
    runs = [
        registerbench.play(
            lambda o, i, k=k: make_action(1000, 20_000 + 100 * k, 0.08, 0.08), "brief", name="lucky", run=k
        )
        for k in range(11)
    ]
    row = compute_rows(*runs[:4], *runs[5:])["lucky"]
    assert row.skipped_runs == 1
    assert row.doubt == "runs are missing: 1 below the highest number"
    assert compute_rows(*runs)["lucky"].doubt == "not trained again: see --spot-check"
    assert compute_rows(claim(honest, "random", run=7, cost={}))["random (not confirmed)"].doubt.startswith(
        "too few runs"
    )


def test_what_is_no_shipped_player_has_learned_whatever_it_states(honest):
    """A learner that stated no moves beat others with a single run."""
    formula = registerbench.play("formula", "one-shot", episodes=4)
    assert check_entries([formula])[0].shipped
    assert not check_entries([dataclasses.replace(formula, player="scripted of my own")])[0].shipped
    row = compute_rows(claim(honest, "scripted", cost={}))["scripted (not confirmed)"]
    assert row.learned, "the shipped host acts otherwise"
    assert row.doubt.startswith("too few runs")


def test_a_player_that_begins_as_a_shipped_one_is_not_that_player(honest):
    """Play four episodes as the shipped player, and the rest as one likes: it had not learned, and beat others with one run."""
    scripted = registerbench.play("scripted", "brief")
    actions = scripted.actions.copy()
    actions[3] = honest.actions[3]
    mixed = registerbench.play(RecordedPolicy(actions), "brief", name="scripted")
    check, other = check_entries([scripted, mixed])
    assert (check.shipped, check.misnamed) == (True, False)
    assert (other.shipped, other.misnamed, other.replayed) == (False, True, True)


class RecordedPolicy:
    def __init__(self, actions):
        self.actions = iter(actions)

    def __call__(self, observation, info):
        return next(self.actions)


def test_nobody_makes_the_reference_worse_by_an_entry_of_its_name(honest):
    """Enter a second run of the reference that loses steps, or whose rewards were typed: others beat the mean of both."""
    reference = registerbench.play("scripted", "brief")
    bad = registerbench.play(lambda o, i: make_action(6000, 60_000, 0.01, 0.01), "brief", name="scripted", run=1)
    for sabotage in (bad, claim(reference, "scripted", run=1, rewards=-9.0)):
        rows = compute_rows(reference, sabotage, honest)
        assert rows["scripted"].value == pytest.approx(score_statistics.compute_iqm(reference.scores["return"]))
        assert rows["scripted"].replayed
        assert rows["scripted (not confirmed)"].doubt
        expected = score_statistics.compute_difference(honest.scores["return"][None], reference.scores["return"][None])
        assert rows["honest"].difference == pytest.approx(expected[0])
    typed = rows["scripted (not confirmed)"]
    assert rows["scripted"].value > typed.value, "but its rewards are not confirmed"
    assert not rows["scripted"].beats(typed)


TRAINING = """
import sys
import registerbench
from registerbench import benchmark_tasks
from registerbench.benchmark_tasks import Card
benchmark_tasks.CARDS["brief"] = Card({card})
from stage.envs.few_shot import make_action
run, out = int(sys.argv[1]), sys.argv[2]
policy = lambda observation, info: make_action(1000, {rate}, 0.08, 0.08)
registerbench.play(policy, "brief", name="learner", run=run).write(out)
"""


def test_a_run_counts_when_its_training_command_gives_its_actions_again(honest, tmp_path):
    card = f"'brief', {BRIEF.id!r}, 'a trial', episodes=4, settings={dict(BRIEF.settings)!r}"
    runs = [
        registerbench.play(
            lambda o, i, k=k: make_action(1000, 20_000 + 100 * k, 0.08, 0.08), "brief", name="learner", run=k
        )
        for k in range(10)
    ]
    for rate, retrained in (("20_000 + 100 * run", True), ("25_000", False)):
        (tmp_path / "train.py").write_text(TRAINING.format(card=card, rate=rate))
        trained = [dataclasses.replace(e, training=f"python {tmp_path}/train.py {{run}} {{out}}") for e in runs]
        row = compute_rows(*trained, spot_checks=1)["learner"]
        assert (row.runs, row.learned, row.retrained) == (10, True, retrained), row.note
        assert ("gives other actions" in row.doubt) != retrained
    row = compute_rows(*runs, spot_checks=1)["learner"]
    assert "states no training command" in row.doubt
    assert compute_rows(*runs)["learner"].doubt == "not trained again: see --spot-check"


LEARNER = """
import sys
import registerbench
from registerbench import benchmark_tasks
from registerbench.benchmark_tasks import Card
benchmark_tasks.CARDS["brief"] = Card({card})
from stage.envs.few_shot import make_action
run, round_, out = sys.argv[1:]
rate = 20_000 if round_ == "open" else {rate}
registerbench.play(lambda o, i: make_action(1000, rate, 0.08, 0.08), "brief", name="learner", round_=round_).write(out)
"""


@pytest.mark.parametrize(
    ("command", "note"),
    [
        ("cp {folder}/a.bench {{out}}", "does not play a new round"),
        ("python {folder}/learns.py {{run}} {{round}} {{out}}", ""),
        ("python {folder}/fits.py {{run}} {{round}} {{out}}", "is worse in a new round"),
    ],
)
def test_a_new_round_separates_learners_from_stored_actions(command, note, tmp_path):
    """State cp as the training command: it gave all actions again, and ten such runs beat others without doubt."""
    card = f"'brief', {BRIEF.id!r}, 'a trial', episodes=4, settings={dict(BRIEF.settings)!r}"
    for name, rate in (("learns", 20_000), ("fits", 3000)):
        (tmp_path / f"{name}.py").write_text(LEARNER.format(card=card, rate=rate))
    entry = registerbench.play(
        lambda o, i: make_action(1000, 20_000, 0.08, 0.08), "brief", name="learner",
        training=command.format(folder=tmp_path),
    )  # fmt: skip
    entry.write(tmp_path / "a.bench")
    (check,) = check_entries([entry], spot_checks=1)
    assert check.retrained
    (check,) = check_entries([entry], spot_checks=1, new_round=True)
    assert check.retrained == (not note)
    assert note in check.note


def test_a_training_command_travels_in_the_file_and_is_never_run_unasked(honest, tmp_path, capsys):
    mark = tmp_path / "ran"
    entry = dataclasses.replace(honest, training=f"{sys.executable} -c open({str(mark)!r},'w') {{out}}")
    assert unpack_entry(entry.pack()).training == entry.training
    assert b"training" not in honest.pack()[:4000], "older readers take it"
    entry.write(tmp_path / "a.bench")
    assert main(["bench-table", str(tmp_path / "a.bench")]) == 0
    assert main(["bench-verify", str(tmp_path / "a.bench")]) == 0
    assert main(["bench-table", str(tmp_path / "a.bench"), "--new-round"]) == 2
    assert "give --spot-check N, too" in capsys.readouterr().err
    assert not mark.exists()


def test_comparisons_are_paired_on_the_same_machines():
    """Machines differ by far more than the players, whose intervals overlap."""
    draw = np.random.default_rng(3)
    machines = draw.normal(size=(1, 64))
    better = machines + 0.1 + draw.normal(scale=0.02, size=(1, 64))
    assert score_statistics.compute_interval(better)[0] < score_statistics.compute_interval(machines)[1]
    difference, low, high = score_statistics.compute_difference(better, machines)
    assert 0.05 < low < difference < high < 0.2
    assert score_statistics.compute_difference(machines, machines) == (0.0, 0.0, 0.0)


def test_the_reference_is_0_and_the_oracle_is_1(honest):
    oracle = registerbench.play(search_split("brief", "train", "open", 48), "brief", name="oracle", track="truth")
    assert oracle.cost["moves"] >= 4 * 48, "the cost of its search"
    reference = claim(registerbench.play("scripted", "brief"), "scripted")
    rows = compute_rows(oracle, reference, honest)
    assert rows["scripted"].normalized == 0.0
    assert rows["oracle"].normalized == 1.0
    assert rows["oracle"].value > rows["scripted"].value
    expected = (rows["honest"].value - rows["scripted"].value) / (rows["oracle"].value - rows["scripted"].value)
    assert rows["honest"].normalized == pytest.approx(expected)
    table = score_statistics.format_rows(list(rows.values())).split("\n\n**")[0]
    assert "| oracle | 1 x 4 |" in table
    assert "IQM minus scripted, paired" in table


def test_equal_actions_have_equal_digests(honest):
    assert digest_actions(honest) == digest_actions(claim(honest, "other", rewards=3.0))
