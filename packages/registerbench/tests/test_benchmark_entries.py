"""Tests of entries: plain data that replays bit for bit, and in which every change is detected and named."""

import contextlib
import dataclasses
import importlib
import io
import json
import os
import re
import subprocess
import sys
import zipfile
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import registerbench
import stage.envs
from registerbench import entry_files, score_statistics
from registerbench.benchmark_tasks import CARDS, Card, list_test_seeds
from registerbench.entry_files import EntryError, unpack_entry
from registerbench.shipped_policies import TASK_PLAYERS, LastAttemptSearch, LowestCostSearch, RandomPolicy
from stage import ArgumentError
from stage.cli import main
from stage.envs import machine_contexts
from stage.envs.task import make_config
from stage.support.files import FileError

BRIEF = Card(
    "brief",
    "stage/FewShotTuning-v1",
    "two tries of short moves, for tests",
    settings={"model": "xy", "distances": (400, 800), "tries": 2, "proofs": 1, "settle": 0.01},
    choices={"memory": ("all", "last")},
    splits=("train", "heavy"),
    episodes=3,
)


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    monkeypatch.setitem(CARDS, "brief", BRIEF)


@pytest.fixture(scope="module")
def entry():
    CARDS["brief"] = BRIEF
    created = registerbench.play("random", "brief", notes="by hand")
    del CARDS["brief"]
    return created


@pytest.fixture(scope="module")
def packed_entry(entry):
    return entry.pack()


def change_entry(entry, name, at, value):
    name = {"seen": "observation_digests"}.get(name, name)
    array = getattr(entry, name).copy()
    array[at] = value
    return dataclasses.replace(entry, **{name: array})


def repack(content, **members):
    """Replace members of the file, or keys of entry.json by `header`, and compute the checksum again."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        raw = {name: archive.read(name) for name in archive.namelist()}
    header = json.loads(raw.pop("entry.json")) | members.pop("header", {})
    del header["checksum"]
    raw |= members
    header["checksum"] = entry_files._compute_checksum(
        header, {name: raw.get(name, b"") for name in entry_files.ARRAY_MEMBERS}
    )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, member in {"entry.json": json.dumps(header).encode(), **raw}.items():
            archive.writestr(member and name, member)
    return file.getvalue()


def test_an_entry_is_replayed_bit_for_bit_without_the_policy(entry, tmp_path):
    path = tmp_path / "random.bench"
    entry.write(path)
    verdict = registerbench.verify(path)
    assert verdict.exact
    assert verdict.is_complete
    assert verdict.differing_versions == ()
    assert "OK: every reward, observation, end and score is equal, bit for bit" in str(verdict)
    with pytest.raises(FileError, match="exists"):
        entry.write(path)


def test_the_same_player_gives_the_same_bytes_and_another_run_of_it_others(entry, packed_entry):
    assert (
        registerbench.play("random", "brief", notes="by hand").pack()
        == packed_entry
        == unpack_entry(packed_entry).pack()
    )
    assert not np.array_equal(registerbench.play("random", "brief", run=1, episodes=1).actions, entry.actions[:2])


@pytest.mark.parametrize(
    ("name", "at", "value", "says"),
    [
        ("actions", (3, 0), 0.25, r"episode 1, step 1, [a-z ]+: \S+ in the entry, \S+ here"),
        ("rewards", 2, 0.5, r"episode 1, step 0, reward: 0\.5 in the entry"),
        ("seen", 0, 7, "episode 0, reset, digest of the observation: 0000000000000007 in the entry"),
        ("seen", 8, 7, "episode 2, step 1, digest of the observation"),
        ("steps", slice(None), (1, 3, 2), "episode 0, step 0, end of the episode: over in the entry, goes on here"),
        ("steps", slice(None), (3, 1, 2), "episode 0, step 1, end of the episode: goes on in the entry, over here"),
    ],
)
def test_a_changed_action_reward_observation_or_end_is_detected_and_named(entry, name, at, value, says):
    verdict = registerbench.verify(change_entry(entry, name, at, value))
    assert not verdict.is_confirmed
    assert re.search(says, str(verdict)), verdict
    assert "made with these versions on such a processor" in str(verdict)


def test_a_changed_score_is_detected_and_one_that_does_not_exist(entry):
    more = {**entry.scores, "return": entry.scores["return"] + (0, 0, 1e-12)}
    assert "episode 2, score 'return'" in str(registerbench.verify(dataclasses.replace(entry, scores=more)))
    other = {**entry.scores, "glory": entry.scores["return"]}
    assert "glory in the entry, return" in str(registerbench.verify(dataclasses.replace(entry, scores=other)))


def test_a_tolerance_distinguishes_close_from_equal_results(entry):
    near = change_entry(change_entry(entry, "rewards", 2, entry.rewards[2] + 1e-9), "seen", 0, 7)
    assert not registerbench.verify(near).is_confirmed
    verdict = registerbench.verify(near, tolerance=1e-6)
    assert verdict.is_confirmed
    assert not verdict.exact
    assert "equal within 1e-06, not bit for bit" in str(verdict)
    assert "1 of 9 observations are not the same bits" in str(verdict)
    maximum = registerbench.verify(change_entry(near, "rewards", 0, entry.rewards[0] + 1e-3), tolerance=1)
    assert maximum.largest_difference == pytest.approx(1e-3), "and not the last difference"
    distance = registerbench.verify(near, tolerance=1e-12)
    assert not distance.is_confirmed
    assert "episode 1, step 0, reward" in str(distance), "and not the observation, of which there is a digest alone"
    for wrong in (-1, float("inf"), float("nan")):
        with pytest.raises(ArgumentError, match=f"tolerance={wrong}: must be 0 or greater"):
            registerbench.verify(entry, tolerance=wrong)


def test_other_versions_are_reported_as_a_possible_cause_and_only_of_what_differs(entry):
    elsewhere = dataclasses.replace(entry, versions={**entry.versions, "mujoco": "3.0.0", "processor": "Z80"})
    assert registerbench.verify(elsewhere).exact
    assert "mujoco" not in str(registerbench.verify(elsewhere))
    message = str(registerbench.verify(change_entry(elsewhere, "rewards", 0, 9.0)))
    assert re.search(r"may be the cause:\n  mujoco: 3\.0\.0 there, \S+ here\n  processor: Z80 there", message)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"seeds": (1_000_000, 1_000_001, 5)}, "seed of episode 2: 5 in the entry, 1000002 in the round 'open'"),
        ({"split": "heavy"}, None),
        ({"split": "weak"}, "unknown split of brief 'weak'"),
        ({"round": "2027"}, "seed of episode 0: 1000000 in the entry"),
        ({"task": "few"}, "unknown task 'few'. Did you mean"),
        ({"task": "stage/FewShotTuning-v1"}, "must name it 'few-shot'"),
        ({"track": "god"}, "unknown track 'god'"),
        ({"settings": {"model": "/etc/passwd"}}, "unknown setting that a player of brief may choose, 'model'"),
        ({"settings": {"memory": "none"}}, "memory='none': the task brief allows 'all', 'last'"),
    ],
)
def test_an_entry_of_other_episodes_is_refused(entry, changes, says):
    other = dataclasses.replace(entry, **changes)
    if says is None:  # the same seeds are other machines there
        assert "episode 0, step 0, reward" in str(registerbench.verify(other))
        return
    with pytest.raises(EntryError, match=re.escape(says)):
        registerbench.verify(other)


def test_an_entry_with_some_of_the_episodes_is_reported_as_partial(entry):
    verdict = registerbench.verify(
        registerbench.play("random", "brief", "heavy", episodes=1, settings={"memory": "last"})
    )
    assert verdict.exact
    assert not verdict.is_complete
    assert "can stand in no table" in str(verdict)


def test_actions_of_another_type_or_beyond_the_space_are_refused(entry, packed_entry):
    doubles = dataclasses.replace(entry, actions=entry.actions.astype(np.float64))
    with pytest.raises(
        EntryError, match=r"actions of type float64 and shape \(4,\) in the entry, and brief takes float32"
    ):
        registerbench.verify(unpack_entry(doubles.pack()))
    for bad in (2.0, np.nan):
        with pytest.raises(EntryError, match=r"action 1, .* is not in Box"):
            registerbench.verify(change_entry(entry, "actions", (1, 2), bad))
    with pytest.raises(EntryError, match="one of the types <f4"):
        unpack_entry(repack(packed_entry, header={"actions": ["|O", [4]]}))
    with pytest.raises(EntryError, match="one of the types <f4"):
        unpack_entry(repack(packed_entry, header={"actions": ["<f4,(1000000000,)f8", [4]]}))


def test_a_file_that_is_cut_off_anywhere_or_has_a_bit_changed_is_refused_or_the_same(entry, packed_entry):
    draw = np.random.default_rng(20)
    for at in draw.integers(0, len(packed_entry), 40).tolist():
        with pytest.raises(EntryError):
            unpack_entry(packed_entry[:at])
        flipped = bytearray(packed_entry)
        flipped[at] ^= 1 << int(draw.integers(8))
        with contextlib.suppress(EntryError):
            assert unpack_entry(bytes(flipped)).pack() == packed_entry, "a date of the archive, which nobody reads"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (lambda p: b"", "is not an entry of the benchmark"),
        (lambda p: b"\x80\x04\x95 a pickle", "is not an entry of the benchmark"),
        (lambda p: repack(p, extra=b"x"), "it should hold entry.json, steps"),
        (
            lambda p: repack(p, header={"format": [entry_files.FORMAT_NAME, 2]}),
            "has format 2, and this PulseStage reads format 1",
        ),
        (lambda p: repack(p, header={"format": "zip"}), "lacks the format of an entry"),
        (lambda p: repack(p, header={"more": 1}), "entry.json must have the keys actions"),
        (lambda p: repack(p, header={"seeds": [-1]}), "seeds must be one or more integers"),
        (lambda p: repack(p, header={"player": "\x1b[2J"}), "cannot be printed"),
        (lambda p: repack(p, header={"cost": {"moves": float("nan")}}), "NaN is not a number"),
        (lambda p: repack(p, header={"versions": {"mujoco": 3}}), "versions must have texts"),
        (lambda p: repack(p, steps=b"\xff" * 24), "one step or more"),
        (lambda p: repack(p, rewards=b"\0" * 8), "rewards has 8 bytes, and 6 steps in 3 episodes require 48"),
        (lambda p: p.replace(b"entry.json", b"../../x.js"), "it should hold entry.json"),
        (lambda p: pack_archive(**{"entry.json": b"[" * 100_000}), "entry.json cannot be read"),
        (lambda p: pack_archive(actions=b"\0" * (entry_files.MAX_UNPACKED_BYTES + 1)), "when unpacked, and at most"),
        (
            lambda p: pack_archive(**{"entry.json": b" " * (entry_files.MAX_HEADER_BYTES + 1)}),
            "at most 1048576 are read",
        ),
    ],
)
def test_foreign_and_hostile_files_are_refused_with_an_explanation(packed_entry, content, says):
    with pytest.raises(EntryError, match=re.escape(says)):
        unpack_entry(content(packed_entry))


def test_an_entry_has_short_texts_costs_from_nothing_up_a_return_and_a_step_an_episode(
    packed_entry, entry, monkeypatch
):
    names = list(entry.scores)
    fine = unpack_entry(
        repack(packed_entry, header={"notes": "x" * entry_files.MAX_TEXT_LENGTH, "cost": {"moves": 0, "tokens": 1e15}})
    )
    assert (len(fine.notes), fine.cost) == (4000, {"moves": 0, "tokens": 1e15})
    for header, why in (
        ({"notes": "x" * 4001}, "notes is longer than 4000 characters"),
        ({"cost": {"moves": -1}}, "cost must have numbers from 0 to 1e15"),
        ({"cost": {"moves": 1.1e15}}, "cost must have numbers from 0 to 1e15"),
        ({"cost": {"moves": True}}, "cost must have numbers from 0 to 1e15"),
        ({"scores": ["glory" if n == "return" else n for n in names]}, "'return' must be one of them"),
        ({"scores": [names[0]] * len(names)}, "must have different names"),
        ({"seeds": []}, "one or more integers"),
        ({"run": True}, "run must be of type int"),
    ):
        with pytest.raises(EntryError, match=re.escape(why)):
            unpack_entry(repack(packed_entry, header=header))
    with pytest.raises(EntryError, match="one step or more"):
        unpack_entry(repack(packed_entry, steps=np.array([0, 4, 2], "<i8").tobytes()))
    monkeypatch.setattr(entry_files, "MAX_FILE_BYTES", len(packed_entry) - 1)
    with pytest.raises(
        ArgumentError, match=f"the entry has {len(packed_entry)} bytes, and a file at most {len(packed_entry) - 1}"
    ):
        entry.write("never.bench")


def pack_archive(**members):
    """Pack an archive with these members, the others empty."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as created:
        for name in entry_files.MEMBERS:
            created.writestr(name, members.get(name, b""))
    return file.getvalue()


def test_an_archive_with_a_false_size_is_not_unpacked(packed_entry):
    lying = bytearray(pack_archive(actions=b"\0" * (1 << 20)))
    at = lying.index((1 << 20).to_bytes(4, "little"), lying.index(b"PK\1\2"))
    lying[at : at + 4] = (24).to_bytes(4, "little")
    with pytest.raises(EntryError):
        unpack_entry(bytes(lying))


def test_a_huge_file_is_not_read(tmp_path):
    path = tmp_path / "large.bench"
    with path.open("wb") as file:
        file.truncate(entry_files.MAX_FILE_BYTES + 1)
    with pytest.raises(EntryError, match="an entry has at most"):
        registerbench.read_entry(path)
    with pytest.raises(EntryError, match="is a folder"):
        registerbench.read_entry(tmp_path)


class Watching:
    """A policy that records its contexts and observations."""

    def __init__(self):
        self.observation_digests, self.contexts, self.cost = [], [], {"tokens": 12}

    def reset(self, context):
        self.contexts.append(context)

    def __call__(self, observation, info):
        self.observation_digests.append((observation.shape, set(info)))
        return np.zeros(4)


def test_a_policy_observes_only_the_entries_of_its_track():
    host, truth = Watching(), Watching()
    registerbench.play(host, "brief", episodes=2)
    entry = registerbench.play(truth, "brief", track="truth", episodes=1)
    assert len(host.contexts) == 2
    assert host.contexts[0].env is None
    assert host.contexts[0].feature_names[0] == "distance"
    assert all(
        "distance" in names and not {"payload", "lost_steps", "reward_parts"} & names
        for _, names in host.observation_digests
    )
    assert {"payload", "current", "loss", "inductance"} <= truth.observation_digests[0][1]
    assert truth.observation_digests[0][0][0] == host.observation_digests[0][0][0] + len(
        machine_contexts.OBSERVATION_FEATURES
    )
    assert entry.player == "Watching"
    assert registerbench.verify(entry).exact


def test_the_track_of_tools_counts_tokens():
    entry = registerbench.play(Watching(), "brief", track="tools", episodes=1)
    assert entry.cost == {"tokens": 12, "test_moves": 2}
    with pytest.raises(ArgumentError, match="the track tools counts tokens"):
        registerbench.play("random", "brief", track="tools", episodes=1)


def test_a_player_with_tools_sees_what_a_host_sees():
    host, tools = Watching(), Watching()
    registerbench.play(host, "brief", episodes=1)
    registerbench.play(tools, "brief", track="tools", episodes=1)
    assert tools.observation_digests == host.observation_digests
    assert not {"payload", "current", "reward_parts", "score"} & tools.observation_digests[-1][1]


def test_test_moves_are_counted_regardless_of_the_stated_cost():
    entry = registerbench.play("random", "brief", episodes=1, cost={"test_moves": 99, "moves": 5})
    assert entry.cost == {"test_moves": 2, "moves": 5}
    custom = Watching()
    assert registerbench.play(custom, "brief", episodes=1, cost={"tokens": 5}).cost["tokens"] == 12, (
        "its own count comes last"
    )


def test_settings_of_a_player_override_those_of_the_card():
    card = dataclasses.replace(BRIEF, choices={"tries": (1, 2)})
    env = card.make_env("heavy", "host", {"tries": 1})
    assert (env.config.tries, env.config.split, env.config.truth, env.config.proofs) == (1, "heavy", "info", 1)
    assert card.make_env("train", "truth", {}).config.truth is True
    assert card.make_env("train", "tools", {}, 3).num_envs == 3


@pytest.mark.parametrize("episodes", [0, -1, 4])
def test_an_invalid_number_of_episodes_is_refused(episodes):
    with pytest.raises(ArgumentError, match=f"episodes={episodes}: give a number from 1 to 3"):
        registerbench.play("random", "brief", episodes=episodes)


def test_who_waits_is_reported_of_each_episode_that_is_done(entry):
    played, replayed = [], []
    registerbench.play("random", "brief", report_progress=lambda *of: played.append(of))
    registerbench.verify(entry, report_progress=lambda *of: replayed.append(of))
    assert played == [(1, 3), (2, 3), (3, 3)]
    assert [done for done, _ in replayed] == sorted(done for done, _ in replayed)
    assert replayed[-1] == (3, 3)


def test_a_policy_class_is_instantiated_and_recorded_actions_follow_their_episodes(tmp_path, monkeypatch):
    (tmp_path / "mine_class.py").write_text(
        "class Policy:\n    def __call__(self, observation, info):\n        return [0.0, 0.3, 0.0, 0.0]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    entry = registerbench.play("mine_class:Policy", "brief", episodes=1)
    assert entry.actions[:, 1] == pytest.approx(0.3)
    from registerbench.policies import RecordedActionsPlayer

    path = tmp_path / "moves.npz"
    np.savez(path, actions=np.arange(12).reshape(6, 2), steps=(1, 3, 2))
    created = RecordedActionsPlayer(str(path))
    assert [e[:, 0].tolist() for e in created.episodes] == [[0], [2, 4, 6], [8, 10]]
    for _ in range(3):
        created.begin(None)
    with pytest.raises(ArgumentError, match="actions for 3 episodes, but more"):
        created.begin(None)
    np.savez(path, actions=np.arange(6.0))
    with pytest.raises(
        ArgumentError,
        match=r"`actions` has the shape \(6,\); give the shape \(episodes, steps, ...\), or add an array `steps`",
    ):
        RecordedActionsPlayer(str(path))


def test_shipped_players_use_the_boldness_that_their_task_requires_by_default():
    from registerbench.policies import make_player
    from registerbench.shipped_policies import compute_scaled_action
    from stage.envs.few_shot import make_action

    bold = {
        task: make_player(name, task, 0).act(None, {})
        for task, name in (("few-shot", "usual"), ("few-shot-wide", "fixed"))
    }
    assert bold["few-shot"].tolist() == make_action(1000, 16_000, 0.15, 0.15).tolist()
    assert bold["few-shot-wide"].tolist() == make_action(1500, 41_600, 0.15 / 2.6, 0.15 / 2.6).tolist()
    assert compute_scaled_action(1.2).tolist() == make_action(1200, 19_200, 0.125, 0.125).tolist()


def test_a_random_player_keeps_to_the_actions_that_are_allowed():
    player = RandomPolicy(3)
    player.reset(SimpleNamespace(action_space=gymnasium.spaces.Discrete(5)))
    assert {int(player(None, {"action_mask": [0, 0, 1, 0, 1]})) for _ in range(40)} == {2, 4}
    assert {int(player(None, {})) for _ in range(60)} == set(range(5))


def test_the_fixed_moves_of_few_shot_are_the_same_whatever_they_did():
    player, episodes = TASK_PLAYERS["few-shot"]["fixed"](0), []
    for observed in (-1.0, 1.0):
        player.reset(SimpleNamespace(feature_names=("kept",)))
        episodes.append([player(np.array([observed]), {}).tolist() for _ in range(8)])
    assert episodes[0] == episodes[1]
    assert len({tuple(action) for action in episodes[0]}) == 8


def play_search(player, holds, swing=lambda speed_factor: 0.0):
    """Return the speed factors of eight attempts; an attempt takes 1 s / its speed factor, and observations have all attempts."""
    names, speed_factors = ("kept", "swing") * 8, []
    observed, info = np.full(16, -1.0), {}
    player.reset(SimpleNamespace(feature_names=names))
    for k in range(8):
        player(observed, info)
        speed_factors.append(player.latest)
        info = {"duration": 1 / player.latest}
        observed[2 * k], observed[2 * k + 1] = 1.0 if holds(k, player.latest) else -1.0, swing(player.latest)
    return speed_factors


def test_the_search_of_few_shot_closes_in_on_the_fastest_move_that_keeps_step():
    speed_factors = play_search(LowestCostSearch(), lambda k, speed_factor: speed_factor < 4.1)
    assert speed_factors[:4] == pytest.approx([1.5, 1.5**2, 1.5**3, 1.5**4])
    assert 4.1 / 1.1 < max(b for b in speed_factors if b < 4.1) < 4.1
    weak = play_search(LowestCostSearch(), lambda k, speed_factor: speed_factor < 1.2)
    assert weak[1] == pytest.approx(1.0), "it retreats until an attempt keeps step"
    assert 1.2 / 1.1 < max(b for b in weak if b < 1.2) < 1.2


def test_the_search_of_few_shot_slows_down_for_a_machine_that_swings():
    def swing(speed_factor):
        return 0.0 if speed_factor < 2.0 else 0.98

    speed_factors = play_search(LowestCostSearch(), lambda k, speed_factor: True, swing)
    assert speed_factors[3] == pytest.approx(1.5**4), "the encoder shows no lost step, so it climbs the whole ladder"
    assert max(speed_factors[4:]) < 2.0 * 1.25, "then it searches where the swing costs less than the time"
    assert max(b for b in speed_factors if b < 2.0) > 1.5


def test_the_search_of_few_shot_wide_answers_below_its_fastest_success():
    careful = play_search(LastAttemptSearch(), lambda k, speed_factor: speed_factor < 3.0)
    assert careful[-1] == pytest.approx(max(b for b in careful if b < 3.0) / 1.1), "its last try is its answer"
    lucky = play_search(LastAttemptSearch(), lambda k, speed_factor: k < 1)
    assert lucky[1:4] == pytest.approx([2.0 * 1.16, 2.0 * 1.16**0.2, lucky[2] / 1.16**0.16]), "bisects"


def test_recorded_actions_are_replayed_and_their_number_must_match_the_steps(entry, tmp_path):
    path = tmp_path / "moves.npz"
    np.savez(path, actions=entry.actions.reshape(3, 2, 4))
    again = registerbench.play(str(path), "brief", name="random", notes="by hand")
    assert again.pack() == entry.pack()
    for steps, says in (
        ((1, 3, 2), "is not over after its 1 recorded actions"),
        ((3, 1, 2), "over after 2 actions, but more are recorded"),
    ):
        np.savez(path, actions=entry.actions, steps=steps)
        with pytest.raises(ArgumentError, match=says):
            registerbench.play(str(path), "brief")
    np.savez(path, actions=np.array([None]))
    with pytest.raises(ArgumentError, match=r"is not an \.npz file with an array `actions`"):
        registerbench.play(str(path), "brief")


def test_an_action_that_the_task_does_not_take_is_refused():
    with pytest.raises(ArgumentError, match="is not in Box"):
        registerbench.play(lambda observation, info: "up", "brief", episodes=1)


def test_a_round_has_separate_seeds_for_each_split():
    drawn = {(s, r): list_test_seeds(BRIEF, s, r) for s in BRIEF.splits for r in ("2027", "2028")}
    every = [seed for some in drawn.values() for seed in some]
    assert len(set(every)) == 12
    assert min(every) > max(list_test_seeds(BRIEF, "train"))
    assert drawn["train", "2027"] == list_test_seeds(BRIEF, "train", "2027")


@pytest.mark.slow
def test_the_commands_submit_and_verify_in_a_fresh_process(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("def policy(observation, info):\n    return [0.0, 0.3, 0.0, 0.0]\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["bench-submit", "mine:policy", "-o", "mine.bench", "--episodes", "1", "--cost", "moves=3"]) == 0
    printed = capsys.readouterr().out
    assert "mine:policy, few-shot train: 1 episodes, 8 steps" in printed
    assert "mine.bench: written" in printed
    done = subprocess.run(
        [sys.executable, "-m", "stage", "bench-verify", "mine.bench", "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert {"ok": True, "exact": True, "whole": False, "player": "mine:policy"}.items() <= json.loads(
        done.stdout
    ).items()


def test_the_option_cost_states_the_costs_including_zero(tmp_path, monkeypatch):
    """stage bench-submit random --cost moves=3 --cost tokens=0"""
    monkeypatch.chdir(tmp_path)
    cost = ["--cost", "moves=3", "--cost", "tokens=0"]
    assert main(["bench-submit", "random", "--task", "brief", "-o", "a.bench", "--episodes", "1", *cost]) == 0
    saved = registerbench.read_entry("a.bench")
    assert saved.cost == {"moves": 3, "tokens": 0, "test_moves": len(saved.rewards)}


def test_the_commands_explain_invalid_arguments(entry, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    change_entry(entry, "rewards", 0, 9.0).write("changed.bench")
    assert main(["bench-verify", "changed.bench"]) == 1
    assert "DIFFERS first in episode 0, step 0, reward: 9.0 in the entry" in capsys.readouterr().out
    for argv, says in (
        ("bench-verify none.bench", "there is no entry none.bench"),
        (f"bench-verify {__file__}", "is not an entry of the benchmark"),
        ("bench-submit randon -o a.bench", "unknown player of few-shot 'randon'. Did you mean 'random'"),
        ("bench-submit none_such:policy -o a.bench", "No module named 'none_such'"),
        ("bench-submit json:policy -o a.bench", "module json has no 'policy'"),
        ("bench-submit none.npz -o a.bench", "there is no file of actions none.npz"),
        ("bench-submit random -o changed.bench", "changed.bench exists"),
        ("bench-submit random -o a.bench --set memory", "NAME=VALUE"),
        ("bench-submit random -o a.bench --set memory=some", "memory='some': the task few-shot allows 'all', 'last'"),
        ("bench-submit random -o a.bench --cost moves=many", "--cost moves=many: NAME=NUMBER"),
        ("bench-submit random -o a.bench --episodes 65", "episodes=65: give a number from 1 to 64"),
        ("bench few", "unknown task 'few'. Did you mean 'few-shot'"),
    ):
        assert main(argv.split()) == 2
        assert says in capsys.readouterr().err, argv
    assert not (tmp_path / "a.bench").exists()


def test_the_list_of_tasks_names_splits_and_players(capsys):
    assert main(["bench"]) == 0
    assert "few-shot  stage/FewShotTuning-v1" in capsys.readouterr().out
    assert main(["bench", "few-shot", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)["few-shot"]
    assert reported["splits"]["weak"][:2] == [1_000_000, 1_000_001]
    assert "formula" in reported["players"]


def test_the_interval_of_the_middle_half_mean_contains_the_true_value():
    assert score_statistics.compute_iqm(np.array([-1e9, 1, 2, 3, 4, 5, 6, 1e9])) == 3.5
    draw = np.random.default_rng(5)
    holding = 0
    for _ in range(40):  # normal scores, of which the truth is 0
        low, high = score_statistics.compute_interval(draw.normal(size=(4, 32)), draws=100)
        holding += low < 0 < high
    assert 32 <= holding <= 40
    machines = np.tile(draw.normal(size=(1, 32)), (4, 1))
    assert np.ptp(score_statistics.compute_interval(machines)) > 0.3, "four runs that do the same tell no more than one"
    one = draw.normal(size=(1, 32))
    assert score_statistics.compute_interval(one) == score_statistics.compute_interval(one)


def test_complete_runs_are_drawn_so_that_the_luck_of_training_is_in_the_interval():
    """Each run plays all episodes; of a good and a bad run, a quarter of the draws has only the good one."""
    assert score_statistics.compute_interval(np.repeat([[0.0], [1.0]], 64, axis=1), draws=200) == (0.0, 1.0)


def test_runs_and_machines_are_both_in_the_interval():
    draw = np.random.default_rng(2)
    runs, machines = draw.normal(size=(10, 1)), draw.normal(size=(1, 32))
    of_runs, of_machines, both = (
        np.ptp(score_statistics.compute_interval(s))
        for s in (np.tile(runs, 32), np.tile(machines, (10, 1)), runs + machines)
    )
    assert both > max(of_runs, of_machines)


def test_an_interval_may_be_of_the_mean():
    one_bad = np.repeat([[0.0, -64.0]], [63, 1], axis=1)
    assert score_statistics.compute_interval(one_bad) == (0.0, 0.0)
    assert score_statistics.compute_interval(one_bad, statistic=np.mean) == (-3.0, 0.0)


def test_a_table_lists_players_whose_intervals_do_not_overlap(entry, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def like(player, run, returns, **cost):
        scores = {**entry.scores, "return": np.array(returns)}
        path = f"{player}-{run}.bench"
        stated.append(dataclasses.replace(entry, player=player, run=run, scores=scores, cost=cost))
        stated[-1].write(path)
        return path

    stated = []

    files_ = [like("best", k, (3.0, 3.1, 3.2)) for k in range(2)] + [like("worst", 0, (0.0, 0.1, 0.2))]
    files_ += [like("wide", k, (0.0, 1.5, 3.1)) for k in range(2)]
    files_ += [like("few", k, (9.0, 9.1, 9.2), moves=100) for k in range(9)]
    files_ += [like("many", k, (9.0, 9.1, 9.2), moves=100) for k in range(10)]
    printed = score_statistics.format_tables(stated)
    assert re.search(r"\| few \| 9 x 3 .* \| too few runs: 10 are needed \|", printed), "a learner"
    assert re.search(r"\| many \| 10 x 3 .* \| best, wide, worst \|", printed)
    assert "| best | 2 x 3 | 3.100 (" in printed
    assert re.search(r"\| best .* \| wide, worst \|\n\| wide .* \| - \|\n\| worst .* \| - \|", printed), (
        "on the same machines"
    )
    assert "steps lost" not in printed
    assert main(["bench-table", *files_, "--long", "--no-replay"]) == 0
    printed = capsys.readouterr().out
    assert "steps lost" in printed
    assert printed.count("| not replayed |") == 5, "whatever they state"
    assert main(["bench-table", files_[0], files_[0]]) == 2
    assert "two entries hold the same run" in capsys.readouterr().err
    registerbench.play("random", "brief", name="quick", episodes=2).write("quick.bench")
    assert main(["bench-table", files_[0], "quick.bench"]) == 2
    assert "quick on brief train, run 0: the entry has 2 of the 3 test episodes" in capsys.readouterr().err


def test_rows_part_by_rounds_and_who_is_as_good_beats_nobody(entry):
    def like(player, run=0, value=1.0, **changes):
        scores = {**entry.scores, "return": np.full(3, value)}
        return dataclasses.replace(entry, player=player, run=run, scores=scores, **changes)

    one, other = score_statistics.compute_rows([like("a"), like("b")])
    assert one.low == one.high == other.high
    assert not one.beats(other)
    assert not other.beats(one)
    drawn = tuple(list_test_seeds(BRIEF, "train", "second"))
    rounds = score_statistics.compute_rows([like("a"), like("a", round="second", seeds=drawn)])
    assert [(row.player, row.runs) for row in rounds] == [("a", 1), ("a", 1)]
    (half,) = score_statistics.compute_rows([like("a", 0, cost={"moves": 0}), like("a", 1, cost={"moves": 100})])
    assert half.learned, "one run of it has learned"


def test_what_a_player_may_choose_is_reported_from_true_and_false():
    card = dataclasses.replace(BRIEF, choices={"tries": (1, 2)})
    card.check_choice("train", "host", {"tries": 1})
    for wrong in (True, 3):
        with pytest.raises(ArgumentError, match=rf"tries={wrong}: the task brief allows 1, 2"):
            card.check_choice("train", "host", {"tries": wrong})


@pytest.mark.parametrize("card", CARDS.values(), ids=lambda card: card.name)
def test_every_task_of_the_list_has_an_environment_with_each_of_its_splits(card):
    module, name = stage.envs.IDS[card.id].split(":")
    task = getattr(importlib.import_module(f"stage.envs.{module}"), name)
    for split in card.splits:
        make_config(task, {**card.settings, "split": split})
    for setting, values in card.choices.items():
        for value in values:
            make_config(task, {setting: value})


@pytest.mark.slow
@pytest.mark.parametrize("name", CARDS)
def test_an_entry_of_every_task_is_replayed_bit_for_bit(name):
    for split in (CARDS[name].splits[0], CARDS[name].splits[-1]):
        for player in ("random", "scripted"):
            assert registerbench.verify(registerbench.play(player, name, split, episodes=3)).exact


@pytest.mark.slow
def test_a_replay_does_not_depend_on_the_processor_features_that_numpy_uses(tmp_path):
    """With AVX-512, NumPy has other logarithms."""
    path = tmp_path / "scripted.bench"
    registerbench.play("scripted", "bus-target", "train", episodes=8).write(path)
    for disabled in ("", "X86_V4 AVX512_ICL"):
        done = subprocess.run(
            [sys.executable, "-c", f"import registerbench; print(registerbench.verify({str(path)!r}).exact)"],
            env=os.environ | {"NPY_DISABLE_CPU_FEATURES": disabled},
            capture_output=True,
            text=True,
        )
        assert done.stdout.strip() == "True", done.stderr
