"""The bench without physics: entries as files, whole and spoilt, their replay beside an environment that is a formula, verdicts,
tables, seeds, players and what they choose."""

import dataclasses
import io
import json
import re
import sys
import zipfile
from contextlib import chdir, contextmanager
from functools import partial
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from recorded.player import Draw
from recorded.store import digits

from registerbench import entry_files as files
from registerbench import policies as players
from registerbench import replay as replaying
from registerbench import shipped_policies as shipped
from registerbench import statistics
from registerbench.cards import CARDS, Card, card_of, seeds
from registerbench.entry_files import Submission, unpack
from registerbench.episodes import NAMES, digest, scored, some, table
from registerbench.policies import Around
from registerbench.replay import Difference, Verdict
from stage.errors import StageError

OWN = Card(
    "own",
    "stage/FewShotTuning-v1",
    "for scenes",
    choices={"memory": ("all", "last"), "encoder": (True, False)},
    episodes=6,
)


def raised(function, *given, **named):
    """What it returns, or its error in words: ours, without those of Python or NumPy, which other versions say otherwise."""
    try:
        return function(*given, **named)
    except (StageError, FileNotFoundError) as error:
        own = re.sub(r" ?\(.*\)", "", str(error)) if error.__context__ else str(error)
        return f"{type(error).__name__}: {own}"


class World:
    """A vector of environments in which an observation, a reward and an end follow from seed, step and action."""

    def __init__(self, n, off=0.0):
        self.num_envs, self.off, self.asked = n, off, []
        self.seeds, self.at = np.zeros(n, int), np.zeros(n, int)

    def reset(self, seed, options):
        mask = options["reset_mask"].copy()
        self.asked.append(["reset", [s if on else None for s, on in zip(seed, mask, strict=True)]])
        self.seeds[mask], self.at[mask] = np.array(seed)[mask], 0
        return self.look(np.zeros(self.num_envs)), {}

    def look(self, actions):
        return np.stack([self.seeds % 97, self.at, actions], axis=1).astype(np.float32)

    def step(self, actions):
        first = actions.reshape(self.num_envs, -1)[:, 0].astype(float)
        self.at += 1
        self.asked.append(["step", first])
        rewards = self.seeds % 7 + 0.5 * first + self.off * (self.at == 2)
        ends = self.at >= 1 + self.seeds % 3
        success = self.seeds % 2 == 0
        score = {"success": success, "time": np.where(success, rewards, np.inf), "moves": self.at.copy()}
        score |= {f"_{name}": np.ones(self.num_envs, bool) for name in score}
        return (
            self.look(first),
            rewards,
            ends & (self.seeds % 4 != 0),
            ends & (self.seeds % 4 == 0),
            {"score": score, "_score": ends},
        )


def entry(episodes=6, **changes):
    """As such an environment would have been played."""
    asked, d, world = seeds(OWN, "train")[:episodes], Draw("entry"), World(1)
    steps, actions, rewards, seen, scores = [], [], [], [], []
    for seed in asked:
        seen.append(digest(world.reset([seed], {"reset_mask": np.ones(1, bool)})[0][0]))
        over = False
        first = len(rewards)
        while not over:
            actions.append([d.between(-100, 100) / 100 for _ in range(4)])
            observation, made, terminated, truncated, infos = world.step(np.array(actions[-1:], "<f4"))
            rewards.append(float(made[0]))
            seen.append(digest(observation[0]))
            over = terminated[0] or truncated[0]
        steps.append(len(rewards) - first)
        told = {k: v[0] for k, v in infos["score"].items() if not k.startswith("_")}
        scores.append(scored(np.array(rewards[first:]), {"score": told}))
    whole = Submission(
        "own",
        "train",
        "host",
        "open",
        {"memory": "last"},
        "someone",
        3,
        "a note",
        {"moves": 12.0, "test_moves": len(rewards)},
        tuple(asked),
        np.array(steps, np.int64),
        np.array(actions, "<f4"),
        np.array(rewards),
        np.array(seen, np.uint64),
        table(scores),
        {"numpy": "2.0", "processor": "a"},
        {"model": "xy"},
    )
    return dataclasses.replace(whole, **changes)


def at(array, place, value):
    made = array.copy()
    made[place] = value
    return made


@contextmanager
def on(world=None, lanes=2):
    """The card, with this in place of its environments."""
    with patch.dict(CARDS, {"own": OWN}), patch.object(replaying, "LANES", lanes):
        if world is None:
            yield
            return
        world.single_action_space, world.close = Box(-1.0, 1.0, (4,), np.float32), lambda: world.asked.append("closed")
        with (
            patch.object(Card, "make", lambda card, *given: (world.asked.append(given), world)[1]),
            patch.object(replaying, "versions", lambda: {"numpy": "2.0", "processor": "b"}),
            patch.object(replaying, "made_of", lambda envs: {"model": "xy", "rules": "r"}),
        ):
            yield


def verdict(tolerance=None, off=0.0, lanes=2, **changes):
    e, told = entry(**{k: v for k, v in changes.items() if k == "episodes"}), []
    made = {name: change(e) for name, change in changes.items() if callable(change)}
    world = World(min(lanes, len(e.seeds)), off)
    with on(world, lanes):
        found = raised(replaying.verify, dataclasses.replace(e, **made), tolerance, lambda *n: told.append(n))
    if isinstance(found, str):
        return [found, world.asked]
    return [str(found), found.json(), found.ok, told, world.asked if not off else len(world.asked)]


VERDICTS = {
    "as played": {},
    "one lane": {"lanes": 1},
    "more lanes than episodes": {"lanes": 9, "episodes": 4},
    "another reward": {"rewards": lambda e: at(e.rewards, 4, 9.0)},
    "two rewards, within": {
        "rewards": lambda e: at(at(e.rewards, 4, e.rewards[4] + 2**-12), 1, e.rewards[1] - 2**-10),
        "tolerance": 1e-3,
    },
    "a reward beyond": {
        "rewards": lambda e: at(at(e.rewards, 4, e.rewards[4] + 2**-12), 7, e.rewards[7] - 2**-3),
        "tolerance": 1e-3,
    },
    "exactly the tolerance": {"rewards": lambda e: at(e.rewards, 0, e.rewards[0] + 0.125), "tolerance": 0.125},
    "no tolerance at all": {"tolerance": 0.0},
    "below nothing": {"tolerance": -1e-9},
    "infinite": {"tolerance": float("inf")},
    "another observation": {"seen": lambda e: at(e.seen, 0, 5)},
    "the last observation": {"seen": lambda e: at(e.seen, -1, 5)},
    "observations within": {"seen": lambda e: at(e.seen, [2, 5], 5), "tolerance": 0.5},
    "another score": {"scores": lambda e: e.scores | {"time": at(e.scores["time"], 2, 1.0)}},
    "infinite scores": {"scores": lambda e: e.scores | {"time": at(e.scores["time"], 2, 1.0)}, "tolerance": 10.0},
    "another name": {"scores": lambda e: {**e.scores, "glory": e.scores["return"]}},
    "an action": {"actions": lambda e: at(e.actions, 3, 0.125)},
    "beyond": {"actions": lambda e: at(e.actions, 3, 1.5)},
    "other actions": {"actions": lambda e: e.actions[:, :3]},
    "other type": {"actions": lambda e: e.actions.astype(float)},
    "longer": {"steps": lambda e: e.steps + np.array([1, -1, 0, 0, 0, 0])},
    "other seeds": {"seeds": lambda e: (*e.seeds[:-1], 7)},
    "too many seeds": {"seeds": lambda e: (*e.seeds, 7)},
    "another split": {"split": lambda e: "nowhere"},
    "another track": {"track": lambda e: "rail"},
    "by id": {"task": lambda e: "stage/FewShotTuning-v1"},
    "unknown": {"task": lambda e: "chess"},
    "another round": {"round": lambda e: "2030"},
    "settings": {"settings": lambda e: {"memory": "none"}},
    "no setting": {"settings": lambda e: {"tries": 2}},
    "a number": {"settings": lambda e: {"encoder": 1}},
    "all off": {"off": 2**-5, "tolerance": 2**-6},
    "all off, within": {"off": 2**-7, "tolerance": 2**-6},
}


def unlike():
    """Verdicts of an entry that was made with the same, and differs."""
    e = entry()
    first = Difference(1, -1, "digest of the observation", "a", "b")
    made = {
        "none": Verdict(e, True, None, True, None, 0.0),
        "differs": Verdict(e, False, None, False, Difference(None, None, "x", "1", "2"), np.inf),
        "within": Verdict(e, False, True, True, first, 0.25, (("numpy", "1", "2"),), 0.5, 3),
        "alike": Verdict(e, False, True, True, first, 0.25, (), 0.5, 3),
        "far": Verdict(
            e, False, False, True, Difference(0, 4, "reward", "1", "2"), 0.25, (("numpy", "1", "none"),), 0.1, 3
        ),
        "exact": Verdict(e, True, True, True, None, 0.0, (("numpy", "1", "2"),), 0.0),
    }
    return {
        name: [str(v), v.ok, v.json()["largest_difference"], v.json()["first_difference"]] for name, v in made.items()
    }


def packed():
    e = entry()
    content = e.pack()
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [
            [m.filename, m.date_time, m.compress_type, m.external_attr, m.create_system, m.file_size]
            for m in archive.infolist()
        ]
        text = archive.read("entry.json").decode()
    again = unpack(content)
    arrays = {f.name: getattr(again, f.name) for f in dataclasses.fields(again)}
    kinds = [getattr(again, name).dtype.str for name in files.ARRAYS[:-1]]
    small = entry(
        1,
        actions=np.array([[1, 2]], np.uint8),
        rewards=np.zeros(1),
        seen=np.zeros(2, np.uint64),
        steps=np.ones(1, np.int64),
    )
    one = unpack(small.pack())
    return {
        "members": members,
        "text": text,
        "arrays": arrays,
        "kinds": kinds,
        "again": again.pack() == content,
        "bytes": [one.actions, one.actions.dtype.str],
        "types": {
            k: raised(entry(actions=np.zeros((3, 1), k)).pack)[:60] if k in ("<f2", "|b1") else k
            for k in ("<f2", "|b1")
        },
    }


def spoilt(said=None, **members):
    """The file with other members and words, its checksum made anew."""
    with zipfile.ZipFile(io.BytesIO(entry().pack())) as archive:
        raw = {name: archive.read(name) for name in archive.namelist()}
    words = json.loads(raw.pop("entry.json"))
    del words["checksum"]
    for name, value in (said or {}).items():
        if value is None:
            del words[name]
        else:
            words[name] = value
    raw |= members
    words["checksum"] = files._checksum(words, raw)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as made:
        for name, member in {"entry.json": json.dumps(words).encode(), **raw}.items():
            made.writestr(name, member)
    return file.getvalue()


LONG = files.LONG
SAID = [
    {"task": 3},
    {"notes": None},
    {"notes": "x" * LONG},
    {"notes": "x" * (LONG + 1)},
    {"player": "a\tb"},
    {"run": 1.0},
    {"run": -1},
    {"settings": []},
    {"cost": {"a": "1"}},
    {"cost": {"a": 1e15}},
    {"cost": {"a": 1.1e15}},
    {"cost": {"a": 0}},
    {"cost": {"a": False}},
    {"seeds": []},
    {"seeds": [1.0] * 6},
    {"seeds": [True] * 6},
    {"seeds": [2**63] * 6},
    {"seeds": [2**63 - 1] * 6},
    {"seeds": [0] * 6},
    {"seeds": [-1] * 6},
    {"seeds": [1] * 5},
    {"scores": ["return"]},
    {"scores": ["return", "time", "time", "moves"]},
    {"scores": ["a", "b", "c", "d"]},
    {"scores": ["return", "b", "c", 3]},
    {"versions": {"a": "x" * LONG}},
    {"versions": {"a": "x" * (LONG + 1)}},
    {"made_of": {"a": "\n"}},
    {"made_of": {"x" * 200: "a"}},
    {"made_of": {"x" * 201: "a"}},
    {"settings": {"\t": 1}},
    {"actions": ["<f4"]},
    {"actions": ["<f2", [4]]},
    {"actions": ["<f4", 4]},
    {"actions": ["<f4", [2, 2]]},
    {"actions": ["<f4", [1, 1, 4, 1]]},
    {"actions": ["<f4", [1, 1, 1, 4, 1]]},
    {"actions": ["<f4", [0]]},
    {"actions": ["<f4", [4.0]]},
    {"actions": ["<f4", [65536]]},
    {"actions": ["<f4", [65537]]},
    {"actions": ["<f8", [2]]},
    {"actions": ["<i4", [4]]},
    {"format": ["x", 1]},
    {"format": [files.MARK, True]},
    {"format": [files.MARK, 0]},
    {"format": [files.MARK, 1, 1]},
]
STEPS = [[1, 2, 3, 1, 2, 2], [0, 3, 3, 1, 2, 2], [-1, 3, 4, 1, 2, 2], [2, 1, 3, 1, 2, 3], [files.UNPACKED + 1] * 6]


def refused(folder):
    def seen(content):
        found = raised(unpack, content, "it")
        return found if isinstance(found, str) else "taken"

    whole = entry().pack()
    found = {f"{k} {str(said)[:70]}": seen(spoilt(said)) for k, said in enumerate(SAID)}
    found |= {f"steps {steps}": seen(spoilt(steps=np.array(steps, "<i8").tobytes())) for steps in STEPS}
    found |= {f"{name} of {n}": seen(spoilt(**{name: b"\1" * n})) for name in files.ARRAYS for n in (0, 8, 47, 88)}
    found |= {
        "nothing": seen(b""),
        "cut": seen(whole[:-30]),
        "cut in half": seen(whole[: len(whole) // 2]),
        "more": seen(spoilt(more=b"x")),
    }
    at = whole.index(b"PK\1\2")
    for name, place, value in (("locked", at + 8, 1), ("packed otherwise", at + 10, 12)):
        other = bytearray(whole)
        other[place] = value
        found[name] = seen(bytes(other))
    path = folder / "an.bench"
    entry().write(path)
    found["again"] = raised(entry().write, path).replace(str(folder), "")
    found["over"] = raised(entry(run=4).write, path, True)
    found["then"] = files.read(path).run
    found["no file"] = raised(files.read, folder / "none").replace(str(folder), "")
    found["folder"] = raised(files.read, folder).replace(str(folder), "")
    size, unpacked, words = path.stat().st_size, sum(map(len, _members(whole))), len(_members(whole)[0])
    for name, limits in (("LARGEST", size), ("UNPACKED", unpacked), ("WORDS", words)):
        for more in (0, -1):
            with patch.object(files, name, limits + more):
                said = raised(files.read, path)
                found[f"{name} {more}"] = said if isinstance(said, str) else "taken"
                found[f"{name} {more}, written"] = str(raised(entry(run=4).write, folder / f"{name}{more}"))
            for key in (f"{name} {more}", f"{name} {more}, written"):  # how well a library packs is its own affair
                said = (
                    found[key]
                    .replace(str(folder), "")
                    .replace(f" {limits} ", " SIZE ")
                    .replace(f" {limits}.", " SIZE.")
                )
                found[key] = said.replace(str(limits + more), "LIMIT")
    found["written"] = sorted(p.name for p in folder.iterdir())
    return found


def _members(content):
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return [archive.read(name) for name in files.MEMBERS]


def cards():
    made = {name: [c.id, c.asked, dict(c.settings), dict(c.choices), c.splits, c.episodes] for name, c in CARDS.items()}
    said = {f"{name} {split}": c.machines(split) for name, c in CARDS.items() for split in c.splits}
    drawn = {
        f"{n} {s} {r}": [min(f), max(f), f[:2]]
        for n, s, r in (("bus", "train", "a"), ("bus", "heavy", "a"), ("home", "train", "b"))
        for f in [seeds(CARDS[n], s, r)]
    }
    refused = {
        str(given): raised(CARDS["few-shot"].check, *given)
        for given in (
            ("train", "host", {"memory": "all"}),
            ("east", "host", {}),
            ("train", "rails", {}),
            ("train", "host", {"tries": 3}),
            ("train", "tools", {"memory": True}),
            ("train", "truth", {"memory": "some"}),
        )
    }
    refused |= {
        str(given): raised(OWN.check, "train", "host", given)
        for given in ({"encoder": 1}, {"encoder": False}, {"encoder": "yes"})
    }
    named = [
        raised(lambda n: card_of(n).name, n) for n in ("bus", "stage/BusMacros-v1", "stage/DriftingHome-v1", "nothing")
    ]
    few = [raised(some, [1, 2, 3], n) for n in (None, 1, 3, 0, 4, -1)]
    return [made, said, drawn, refused, named, few, NAMES]


def numbers():
    d = Draw("scores")
    scores = np.array([[d.between(0, 1000) / 100 for _ in range(9)] for _ in range(3)])
    return {
        "iqm": [statistics.iqm(scores.ravel()[:n]) for n in range(1, 14)],
        "interval": [
            statistics.interval(scores),
            statistics.interval(scores[0], 50, 0.5, 3),
            statistics.interval(scores[:, :1], 200),
            statistics.interval(scores, 50, of=np.mean),
        ],
        "scored": [
            scored(np.array([1.0, 2.5]), info)
            for info in ({}, {"proved": 2.0}, {"proved": np.inf}, {"score": {"success": True, "time": 3}})
        ],
        "table": table([{"a": 1.0, "b": 2}, {"a": 3.0, "b": 4}]),
        "digests": [
            digest(v)
            for v in (
                np.zeros(3),
                np.zeros(3, np.float32),
                np.zeros((3, 1)),
                np.zeros((1, 3)),
                np.asfortranarray(np.eye(2)),
                np.int64(3),
            )
        ],
        "earlier": [
            replaying._earlier(Difference(*a, "", "", ""), Difference(*b, "", "", ""))
            for a in ((0, 1), (0, None), (1, -1), (None, None))
            for b in ((0, 1), (0, 2), (0, None), (1, -1), (None, None))
        ],
    }


def tables():
    d = Draw("rows")

    def made(player, run=0, worth=0.0, task="home", split="train", round="open", part=64, success=True, **more):
        drawn = tuple(seeds(card_of(task), split, round))[:part]
        scores = {"return": np.array([worth + d.between(0, 100) / 100 for _ in drawn])}
        if success:
            scores["success"] = np.arange(len(drawn)) % 3 != 1
            scores["regret"] = np.where(scores["success"], scores["return"], np.inf)
            scores["lost_steps"] = scores["limits"] = scores["moves"] = np.arange(len(drawn))
        return SimpleNamespace(
            **{
                "task": task,
                "split": split,
                "track": "host",
                "round": round,
                "player": player,
                "run": run,
                "seeds": drawn,
                "cost": {},
                "scores": scores,
                **more,
            }
        )

    learned = [made("learner", k, 9.0, cost={"moves": 5}) for k in range(statistics.RUNS)]
    entries = [
        made("a"),
        made("b", 0, 5.0),
        made("b", 1, 5.5),
        *learned,
        made("few", 0, 8.0, cost={"moves": 1}),
        made("free", 0, 2.0, cost={"moves": 0}),
        made("a", task="bus", success=False),
        made("a", split="heavy"),
        made("c", track="truth", worth=1.0),
        made("a", round="2027"),
    ]
    with patch.object(statistics, "interval", partial(statistics.interval, draws=40)):
        return [
            statistics.table(entries),
            statistics.table(entries, True),
            statistics.rows(entries),
            raised(statistics.rows, [made("a"), made("a")]),
            raised(statistics.rows, [made("a"), made("a", 1, part=5)]),
        ]


def around(task, space, entries=("distance", "kept", "kept", "kept")):
    return Around(task, space, None, tuple(entries), SimpleNamespace(scripted=lambda: "what the host does"))


def playing(folder):
    found = {"action": [shipped.action_at(b) for b in (0.5, 1.0, 1.5, 2.0, 3.4)]}
    for task in CARDS:
        for name, make in {**shipped.PLAYERS, **shipped.OWN.get(task, {})}.items():
            acting = players.player(name, task, 5)
            acting.begin(around(task, Box(-1.0, 1.0, (2,), np.float32)))
            seen = np.array([0.0, 1.0, 1.0, 0.0], np.float32)
            found[f"{task} {name}"] = [
                acting.name,
                acting.shipped,
                acting.cost,
                [acting.act(seen, {}) for _ in range(2)],
                type(make(1)).__name__,
            ]
    for kind in (shipped.Search, shipped.Answer):
        for kept in ("1111111", "0000000", "1101001", "0110111", "1000101"):
            acting, chosen = kind(), []
            acting.reset(around("few-shot", None, ["distance", *["kept"] * 8]))
            for k in range(8):
                seen = np.zeros(9, np.float32)
                seen[1 : k + 1] = [float(c) for c in kept[:k]]
                action = acting(seen, {})
                chosen.append([acting.last, acting.good, acting.bad, digits(np.asarray(action).tobytes())])
            found[f"{kind.__name__} {kept}"] = chosen
    masked = shipped.Random(3)
    masked.reset(around("bus", Discrete(6)))
    found["masked"] = [int(masked(None, {"action_mask": np.array([0, 1, 0, 1, 0, 0])})) for _ in range(6)]
    again = shipped.Random(3)
    for _ in range(2):
        again.reset(around("bus", MultiDiscrete([5, 5])))
        found["drawn on"] = [*found.get("drawn on", []), again(None, {})]
    np.savez(folder / "some.npz", actions=np.arange(12.0).reshape(6, 2), steps=[1, 3, 2])
    np.savez(folder / "all.npz", actions=np.arange(12.0).reshape(2, 3, 2))
    np.savez(folder / "flat.npz", actions=np.arange(12.0))
    np.savez(folder / "none.npz", other=np.arange(12.0))
    (folder / "no.npz").write_text("words")
    (folder / "policies_here.py").write_text(
        "class Made:\n    cost = {'a': 1}\n    def __call__(self, o, i): return 7\nclass Not:\n    pass\nnumber = 3\n"
    )
    for name in ("some", "all", "flat", "none", "no", "missing"):
        recorded = raised(players.player, str(folder / f"{name}.npz"), "home", 0)
        if isinstance(recorded, str):
            found[name] = recorded.replace(str(folder), "")
            continue
        course = []
        for steps in (1, 3, 2, 1):
            course.append(raised(recorded.begin, None))
            if course[-1]:
                break
            course += [raised(recorded.act, None, {}) for _ in range(steps)]
            course.append(raised(recorded.end))
        found[name] = json.loads(json.dumps(course, default=lambda v: v.tolist()).replace(str(folder), ""))
    names = [f"policies_here:{name}" for name in ("Made", "Not", "number", "none")]
    for name in (*names, "no_such_module:x", "a b:x", "nobody"):
        with chdir(folder), patch.object(sys, "path", [*sys.path]), patch.dict(sys.modules):
            acting = raised(players.player, name, "home", 0)
        made = isinstance(acting, players.Given)
        found[name] = [acting.name, acting.shipped, acting.cost, acting.act(None, {})] if made else acting
    found["number"] = raised(players.player, 3, "home", 0)
    told = []

    class Told:
        def reset(self, given):
            told.append([given.task, given.entries, given.env])

        def __call__(self, observation, info):
            return [observation, info]

    for policy in (Told(), max):
        acting = players.player(policy, "home", 0)
        acting.begin(around("home", None))
        found[acting.name] = [acting.act(1, 2), acting.cost, acting.shipped, acting.end()]
    return [found, told]


def of(scene, *given, **named):
    """A scene without parameters."""
    return lambda: scene(*given, **named)


FILES = {
    "bench": {
        **{f"verdict {name}": of(verdict, **how) for name, how in VERDICTS.items()},
        "unlike": unlike,
        "packed": packed,
        "refused": refused,
        "cards": cards,
        "numbers": numbers,
        "tables": tables,
        "playing": playing,
    },
}
