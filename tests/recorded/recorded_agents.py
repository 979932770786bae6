"""Tools of agents and the games that are played with them: answers, arguments, broken set-ups, transcripts, scores."""

import json
import re
from functools import partial

import numpy as np
from recorded.recorded_texts import tried

from registerbench.arena import Game, Limits, Round, Table, play, player, read, replay, save, suite, suites
from registerbench.arena.replay import again
from registerbench.arena.scores import Head, closing_of, played, value_of
from registerbench.arena.transcript import Writer, suite_of
from registerbench.diagnosis import SETUPS, Case
from registerbench.diagnosis.program import parse
from registerbench.diagnosis.trial import Sample, Trial, rests_of
from stage import Stage
from stage.agents.budget import Budget
from stage.agents.bus import about, overview
from stage.agents.fields import BYTES, FLAG, LENGTH, LENGTHS, NUMBER, NUMBERS, TEXT, WHOLE, Field, shown, whole
from stage.agents.recordings import Recordings, thinned
from stage.agents.tool import Tool
from stage.agents.toolbox import Toolbox
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MS

# --- arguments ---

FIELDS = [
    Field("speed", NUMBER, "of the drive", low=0.0, above=True, unit="m/s"),
    Field("share", NUMBER, "of it", True, low=-1.0, high=1.0),
    Field("most", NUMBER, "of it", high=2.5, unit="kg"),
    Field("between", NUMBER, "ends apart", low=0.0, high=3.0, above=True, unit="s"),
    Field("any", NUMBER, "number", default=0.5, unit="V"),
    Field("count", WHOLE, "how many", default=20, low=1, high=500),
    Field("code", WHOLE, "any"),
    Field("way", TEXT, "which", choices=("minus", "plus", "Both")),
    Field("name", TEXT, "any text"),
    Field("on", FLAG, "or off", default=False),
    Field("far", LENGTH, "how far", True),
    Field("bytes", BYTES, "one after the other", low=0, high=255),
    Field("numbers", NUMBERS, "some", low=-1.0, high=1.0),
    Field("places", LENGTHS, "by axis", choices=("x", "y")),
]
GIVEN = [
    0, 1, -1, 1.0, -1.0, 2.5, 2.6, 3.0, 500, 501, True, None, 0.5, float("nan"), float("inf"), 1 << 63, (1 << 63) - 1, 10**400,
    "", "0", "1Fh", "0x1F", "-0b101", "1_000", "0.05", "-.5e1", "FF", "12q", "٣", "\N{MINUS SIGN}4", "5 mm", "10mm", "-30deg",
    "1001", "1000", "2um", "PLUS", "both", "plsu", "TRUE", " false ", "x" * 4001, "9" * 81, [],
    [1, "2h"], [256], [0.5, -1.0], [0] * 257,
    {}, {"X": "1mm"}, {"x": 1, "X": 2}, {"q": 1}, b"",
]  # fmt: skip


def arguments():
    """Every kind of argument with every kind of value."""
    return {f.name: [json.dumps(f.schema()), *(f"{tried(f.read, g)!r:.150}" for g in GIVEN)] for f in FIELDS}


def calls_by_tool():
    """What a tool makes of its arguments."""
    tool = Tool("try", "Try.", dict, tuple(FIELDS), shows={"count": 3})
    full = {"share": 0.25, "far": "2mm", "count": "1Fh", "places": {"Y": "1mm"}}
    given = (
        None,
        3,
        [],
        {},
        {"share": 1},
        full,
        {**full, "on": "true", "cuont": 3},
        {**full, 5: 1},
        {**full, "on": None},
    )
    bare = Tool("task", "None.", dict)
    return {
        "values": [tried(tool.values, g) for g in given], "example": tool.example(), "schema": json.dumps(tool.schema()),
        "none": [tried(bare.values, {"a": 1}), bare.example(), bare.schema()],
        "whole": [tried(whole, "n", t) for t in ("+7", "-1fH", "0B11", "0x", "h", "ABC", "7" * 80, "1" * 81)],
        "shown": [shown(v) for v in (True, None, "x" * 78, "x" * 79, "x" * 90, 10**5000, 1.5)],
    }  # fmt: skip


# --- the toolbox ---

BOTH = [
    ("describe", {}), ("budget", None), ("report", {}), ("status", {"axis": "x"}), ("status", {"axis": "Y"}),
    ("trace", {"axis": "x"}),
    ("registers", {"axis": "x", "name": "R1"}), ("registers", {"axis": "y", "name": "P"}),
    ("registers", {"axis": "z", "name": "Rx"}),
    ("write_register", {"axis": "x", "name": "R1", "value": "1F4h"}), ("read_register", {"axis": "x", "name": "r1"}),
    ("write_register", {"axis": "x", "name": "R1", "value": 1 << 14}), ("write_register", {"axis": "y", "name": "V", "value": 0}),
    ("write_register", {"axis": "z", "name": "R0CH", "value": -1}), ("read_register", {"axis": "z", "name": "R20H"}),
    ("write_bytes", {"axis": "x", "address": 0, "values": [8, "2Ah"]}), ("write_bytes", {"axis": "x", "address": 4, "values": 1}),
    ("write_bytes", {"axis": "z", "address": 9, "values": [256, 1]}), ("read_bytes", {"axis": "x", "addresses": [0, 1, 2, 3]}),
    ("read_bytes", {"axis": "y", "addresses": ["8h"]}), ("command", {"axis": "y", "name": "NOP"}),
    ("command", {"axis": "x", "name": "nothing"}),
    ("command", {"axis": "x", "name": "operate", "data": "15h"}), ("stop", {"axis": "x", "at_once": True}),
    ("move", {"axis": "x", "distance": "1mm", "speed": 0.05, "accel": 0.01}), ("report", {}),
    ("move", {"axis": "y", "pulses": -200, "accel": 0.02, "decel": 0.01, "start_speed": 0.004, "speed": 0.04}),
    ("move", {"axis": "z", "pulses": 150, "accel": 0.02}), ("move", {"axis": "x"}), ("move", {"axis": "x", "pulses": 0}),
    ("move", {"axis": "x", "pulses": 1, "distance": 1}), ("move", {"axis": "x", "distance": 0.6, "timeout": 0.05}),
    ("report", {}), ("stop", {"axis": "x", "at_once": True}), ("move", {"axis": "x", "pulses": 5, "speed": 1e-9}),
    ("start", {"axis": "x", "pulses": -3000, "speed": 0.05}), ("move", {"axis": "x", "pulses": 5}), ("wait", {"seconds": 0.02}),
    ("status", {"axis": "x"}),
    ("stop", {"axis": "x"}), ("stop", {"axis": "x"}), ("start", {"axis": "y", "pulses": 160, "s_curve": True, "accel": 0.01}),
    ("wait_until_stopped", {"axis": "y"}), ("wait", {"seconds": 121}), ("wait", {"seconds": -1}),
    ("home", {"axis": "x", "direction": "up"}),
    ("home", {"axis": "x", "by": "index of"}), ("line", {"distances": {"x": "1mm", "q": 2}}),
    ("line", {"distances": {"x": "0.5mm", "y": -2e-4}}),
    ("line", {"distances": {}}), ("write_bytes", {"axis": "x", "address": 0, "values": ["40h", "10h"]}),
    ("wait", {"seconds": 0.01}),
    ("write_bytes", {"axis": "x", "address": 0, "values": ["1Dh", "08h"]}), ("wait_until_stopped", {"axis": "x", "timeout": 1}),
    ("diagnostics", {}), ("trace", {"axis": "x", "lines": 5}), ("trace", {"axis": "z", "lines": 3}),
    ("trace", {"axis": "z", "lines": 501}), ("budget", {}),
    ("snapshot", {"name": "a"}), ("snapshot", {"name": "power-up"}), ("snapshot", {"name": " "}), ("snapshot", {"name": "n" * 65}),
    ("restore", {"name": "power-up"}), ("restore", {"name": "b"}), ("branch", {"name": "one"}), ("wait", {"seconds": 0.01}),
    ("branch", {"name": "main"}),
    ("branch", {"name": "main"}), ("branch", {"name": "one"}), ("restore", {"name": "A"}), ("report", {}), ("nothing", {}),
    (3, {}), ("picture", 5),
    ("truth", {}), ("peek", {"axis": "y"}), ("place", {"axis": "x", "position": "12mm"}), ("load", {"mass": 1.5}),
    ("load", {"mass": -1}),
    ("fault_jam", {"axis": "x"}), ("fault_switch_stuck", {"axis": "x", "pin": "org", "closed": True}),
    ("fault_phase_open", {"axis": "x", "phase": "c"}),
    ("fault_bus_voltage", {"axis": "y", "volts": 12}), ("truth", {}), ("mend", {}), ("mend", {"all": True}), ("mend", {}),
    ("record", {"on": False}),
    ("record", {"on": True}), ("wait", {"seconds": 0.003}), ("record", {"on": False}), ("save_recording", {"name": "a.txt"}),
    ("save_recording", {"name": "a.vcd"}), ("save_recording", {"name": "a.vcd"}), ("save_recording", {"name": "../b.vcd"}),
    ("budget", {}),
]  # fmt: skip


SHORTER = ("describe", "report", "move", "line", "stop", "restore", "start", "wait_until_stopped", "diagnostics")
"""Called in the mode "truth", too, before what is its own."""


def box(mode, folder):
    """One agent's calls of all tools, on three kinds of chips."""
    stage = Stage("xyz", chips={"x": PCL240MS, "y": MCX304, "z": HCTL1100}, visuals=False)
    made = Toolbox(stage, mode, Budget(moves=14, seconds=20.0, cycles=40000), patience=None)
    kept = Recordings(made, str(folder))
    kept.join()
    found = {
        "tools": mode == "truth"
        and {t.name: json.dumps([t.text, t.schema(), t.example(), t.moves, t.free]) for t in made.tools.values()}
    }
    for k, (name, given) in enumerate(BOTH):
        if mode == "truth" and k < BOTH.index(("truth", {})) and name not in SHORTER:
            continue
        answer = made.call(name, given)
        found[f"{k} {name}"] = str(answer.data.get("error")) if not answer.ok else without(answer.data)
    found["last"] = tried(kept.last)
    made.close()
    return {**found, "closed": made.call("budget").text, "calls": made.calls, "now": stage.now}


def without(data):
    """A file's size has the version in it."""
    return {k: v for k, v in data.items() if k != "bytes"}


def budgets():
    """What ends: moves, seconds, cycles, and wrong ones."""
    found = {}
    for name, kept in {
        "moves": Budget(moves=1),
        "seconds": Budget(seconds=0.03),
        "cycles": Budget(cycles=20),
        "none": Budget(moves=0),
    }.items():
        made = Toolbox(Stage("xy", chips=PCL240K, visuals=False), "host", kept, snapshots=False)
        said = [made.call("move", {"axis": "x", "pulses": p, "accel": 0.01}) for p in (40, 60, 80)] + [
            made.call("wait", {"seconds": 0.01})
        ]
        found[name] = [a.data for a in said] + [made.meter.used(), made.meter.left()]
    wrong = (
        {"moves": -1},
        {"moves": True},
        {"cycles": 1.5},
        {"seconds": float("inf")},
        {"seconds": -0.1},
        {"seconds": 0},
    )
    found["wrong"] = [tried(Budget, **w) for w in wrong]
    stage = Stage("xy", visuals=False)
    found["boxes"] = [str(tried(Toolbox, *given))[:90] for given in ((3,), (stage, "gods"), (stage, "host", 5))]
    names = Toolbox(stage).call
    found["kept"] = [names("snapshot", {"name": f"s{k}"}).text for k in range(16)][-2:]
    found["thinned"] = [[*thinned(np.arange(n) / 4)[::333], len(thinned(np.arange(n)))] for n in (1000, 1001, 2500)]
    found["thinned not"] = thinned(np.array([1.0, np.nan, np.inf]))
    return found


def maps_told():
    """The register maps as agents read them."""
    return {
        c.__name__: [overview(c), *(tried(about, c, n) for n in (*[r.name for r in c.MAP.registers][:3],
                    *[w.name for w in c.MAP.words][:3], "STOP", "qq"))]
        for c in (PCL240K, PCL240MS, MCX304, MCX514, HCTL1100)
    }  # fmt: skip


# --- broken set-ups ---

PROGRAMS = [
    "wait 0.05", "wait 61", "wait -1", "wait x", "base x 304h", "base q 1", "base x zz", "until x stopped 5", "until x stopped",
    "until x R1.q 1 2",
    "until x RR1.DSND 2 4", "until q stopped 1", "x operate 15h", "x: operate 15h  # on", "q: 15", "x: R1 <- 99999999",
    "x: 84 2: 3A 1: 98", "x:", "# only",
    "x: nothing 5", "#" * 40_000, "#" * 40_001, "\n\nwait 0\nwait q", "\n" * 200, "wait 0\n" * 199,
]  # fmt: skip


def setup_texts():
    """What each set-up tells, and programs that cannot be read."""
    stage = Stage("xy", chips=PCL240K, visuals=False)

    def lines(text):
        made = tried(parse, text, stage)
        return made if isinstance(made, str) else [f"{x.number} {x.text}" for x in made][-2:]

    found = {
        name: [s.cause, s.complaint, s.program, str(s.trial), s.trial, s.chips, s.payload] for name, s in SETUPS.items()
    }
    return {**found, "parsed": [lines(p) for p in PROGRAMS], "no": str(tried(Case, "lately")), "suites": suites()}


def trials():
    """What a watch has seen, judged."""

    def course(places, rate=1000.0, rest=0.12, lost=0.0, aside=0.0):
        t, at, seen = 0.0, 0.0, []
        for goal in (0.0, *places):
            n = max(round(abs(goal - at) / (rate * 1e-5) / 2e-3), 0)
            for k in range(1, n + 1):
                t += 2e-3
                here = at + (goal - at) * k / n
                seen.append(Sample(t, here, here, lost, aside, True))
            at = goal
            for _ in range(round(rest / 2e-3)):
                t += 2e-3
                seen.append(Sample(t, at, at, lost, aside, False))
        return seen

    asked = Trial((0.002, 0.0), 1000.0, 3.0)
    courses = {
        "good": course((0.002, 0.0)), "short": course((0.0019, 0.0)), "near": course((0.00206, 0.0)),
        "far": course((0.002061, 0.0)),
        "one": course((0.002,)), "three": course((0.002, 0.0, 0.001)), "slow": course((0.002, 0.0), 940.0),
        "fast": course((0.002, 0.0), 1060.0),
        "just": course((0.002, 0.0), 955.0), "brief": course((0.002, 0.0), rest=0.09), "lost": course((0.002, 0.0), lost=0.6),
        "hardly lost": course((0.002, 0.0), lost=0.4), "aside": course((0.002, 0.0), aside=-3.1e-5),
        "nearly": course((0.002, 0.0), aside=2.9e-5),
    }  # fmt: skip
    for n in (4, 5, 6, 7):  # samples of a way
        leg = [Sample(2e-3 * k, 4e-4 * k, 4e-4 * k, 0.0, 0.0, True) for k in range(1, n)]
        rest = [Sample(leg[-1].time + 2e-3 * k, 0.002, 0.002, 0.0, 0.0, False) for k in range(1, 53)]
        courses[f"{n} samples"] = [Sample(0.0, 0.0, 0.0, 0.0, 0.0, False), *leg, *rest]
    found = {k: [asked.wrong(c, 0.0, 1e-5), rests_of(c)] for k, c in courses.items()}
    found["one way"] = [Trial((0.002,), 5000.0, 3.0, within=1.0).wrong(c, 0.0, 1e-5) for c in courses.values()]
    some = (
        Trial((0.002, 0.0), 1000.0, 3.0, ramp=0.1),
        Trial((0.012, 0.01), 1000.0, 3.0, from_start=False),
        Trial((-0.008, -0.01), 1000.0, 3.0),
    )
    return {**found, "others": [[str(t), t.wrong(courses["good"], 0.01, 1e-5)] for t in some]}


SHORT_MOVE = (
    "x: R0 <- 200\nx: R1 <- 400\nx: R2 <- 500\nx: R7 <- 204\nx: control 44h\nx: operate 10h\nuntil x stopped 0.02"
)


def case(name):
    """A set-up in hands that do it wrong, and in hands that do not."""
    made = Case(name, runs=2)
    call = made.box.call
    program = made.setup.program
    found = [made.box.call(n, a).data for n, a in (
        ("program", {}), ("write_program", {"text": "x: nothing"}),
        ("write_program", {"text": "wait 0.01\nbase x 308h\nx: operate 08h\nuntil x stopped 1"}), ("run", {}),
        ("measure", {}), ("write_program", {"text": SHORT_MOVE}),
        ("run", {}), ("measure", {}), ("run", {}), ("answer", {"cause": "nobody"}), ("answer", {"cause": "supply too low"}),
        ("answer", {"cause": "slipping coupling"}),
        ("service", {"work": "paint it"}), ("service", {"work": "tighten the coupling between motor and screw of x"}),
        ("budget", {}), ("diagnostics", {}),
    )]  # fmt: skip
    found.append([[t.name, t.text, t.free, t.moves, json.dumps(t.schema())] for t in made._tools()])
    found += [call("write_program", {"text": program + "wait 0\n"}).data, made.task, made.over]
    made.setup = made.setup.__class__(**{**vars(made.setup), "program": "wait 0.01"})
    call("write_program", {"text": "wait 0.01"})
    found += [
        made.score(),
        made.score().value,
        call("finish").data,
        call("finish").data,
        call("run").data,
        call("answer", {"cause": "slipping coupling"}).data,
    ]
    return found


# --- the arena ---


class Toy(Game):
    """A game of numbers: over at the third."""

    def __init__(self, k):
        from stage.agents.calls import Calls

        self.name, self.seed, self.task, self.k, self.sum = f"toy:{k}", 10 + k, "Add.", k, 0.0
        self.calls = Calls([Tool("add", "A number.", self.add, (Field("n", NUMBER, "it", True, low=-1.0, high=5.0),))])
        self.made = 0

    @property
    def over(self):
        return self.made >= 3

    def add(self, n):
        self.made, self.sum = self.made + 1, self.sum + n
        return {"sum": self.sum}

    def score(self):
        return {"value": self.sum / (1 + self.k), "made": self.made}


def table():
    """A game as a player has it: within its limits, after them, tokens, troubles."""
    made = Table(Toy(0), Limits(6, 9.0, 90.0))
    said = [made.tools, made.over]
    for given in ({"n": 1.5}, {"n": 6}, {"m": 1}, {"n": {1, 2}}, {(1, 2): 3}, object()):
        said.append(without_address(made.call("add", given).text))
    said += [made.over, made.call("add", {"n": 1}).text, made.tokens]
    for tokens in (3, -1, True, 1.5, 0, (1 << 40) - 1, 1 << 40):
        made.spent(tokens)
    said += [made.tokens, dict(made.troubles), [without_address(str(row)) for row in made.log], made.late()]
    made.leave("late")
    over = Table(Toy(1))
    for _ in range(3):
        over.call("add", {"n": 1})
    said += [made.ended, over.over, over.call("add", {"n": 1}).text, over.limits]
    left = Table(Toy(1))
    left.leave("late")
    said += [left.ended, left.over]
    wrong = ((0,), (True,), (1.5,), (1, 0), (1, float("inf")), (1, True), (1, 1, -1), (1, 1, "x"))
    return [*said, *(tried(Limits, *w) for w in wrong)]


def without_address(text):
    return re.sub(r"0x[0-9a-f]+", "0x", text)


HEADS = {"diagnosis": ("", ""), "few-shot": ("train", "open")}


def rounds(values, kind="diagnosis"):
    return [
        Round(f"{kind}:{k}", None if kind == "diagnosis" else k,
            [{"call": "a", "arguments": None, "ok": k % 3 != 1, "answer": {}}] * (k % 4), {"value": v}, 10 * k,
              "timed out: late" if v < -1 else "", {"odd": k} if k == 2 else {})
        for k, v in enumerate(values)
    ]  # fmt: skip


def scores():
    """What rounds come to, in numbers and words."""
    found = {}
    for kind, values in (
        ("diagnosis", (1.0, 0.5, -0.5, 0.99, 0.0)),
        ("few-shot", (1.0, 0.5, -2.5, 3.0, 0.7, 0.8, 9.0)),
        ("few-shot", ()),
        ("diagnosis", (0.25,)),
    ):
        for of, most in ((len(values), 400), (12, 30)):
            head = Head(
                kind, *HEADS[kind], tuple((f"{kind}:{k}", k) for k in range(len(values))), of, Limits(most), "me"
            )
            came = played(head, rounds(values, kind))
            found[f"{kind} {len(values)} {of}"] = [
                str(came),
                came.said,
                dict(came.troubles),
                came.sound,
                came.whole,
                came.tokens,
                came.calls,
                closing_of(came),
            ]
    found["values"] = [
        value_of(k, v) for k in HEADS for v in ((2.0,), (1, 2, 3), (0, 0, 5, 1, 2, 9, 4), tuple(range(20)))
    ]
    return found


def game(task, who, split, episodes):
    """A shipped player at a task's episodes: what was asked, what was answered."""
    came = play(suite(task, split, episodes), player(who))
    kept = [[c["call"], c["arguments"], c["ok"], c["answer"]] for c in came.rounds[0].calls[:8]]
    entry = came.entry
    return {
        "said": str(came), "rounds": [[r.game, r.seed, r.score, r.tokens, r.ended, r.troubles,
                len(r.calls)] for r in came.rounds], "calls": kept,
        "last": came.rounds[-1].calls[-1], "again": str(replay(came)),
        "entry": [entry.task, entry.split, entry.track, entry.round, entry.player, entry.cost, entry.seeds, entry.steps,
            entry.rewards, entry.actions[:4]],
    }  # fmt: skip


def lazy(table):
    table.spent(7)
    table.call("observe")
    table.call("act", {"start": -1})
    if table.name.endswith("0"):
        table.call("act", {"start": 1000, "drive": 20000, "up": 0.1, "down": 0.1})


def clean(text):
    """A line of a transcript without what this machine is."""
    line = json.loads(text)
    line.pop("versions", None)
    return line


def transcripts(folder):
    """Files of what was played: lines, replays of changed ones, ends that are missing, what cannot be read."""
    came = play(suite("one-shot", episodes=2), lazy, "lazy", Limits(9, 5.0, 50.0))
    save(came, folder / "a.jsonl")
    text = (folder / "a.jsonl").read_text()
    lines = text.splitlines(keepends=True)
    found = {"lines": [clean(line) for line in lines], "replayed": str(replay(folder / "a.jsonl"))}
    changed = {
        "no end": lines[:-1], "one game": lines[: 1 + next(k for k, x in enumerate(lines) if '"score"' in x)],
        "half a line": [*lines[:-1], lines[-1][:20]],
        "behind": [*lines, lines[-1]], "empty": [], "no json": ["hello\n"], "no format": ["{}\n"],
        "format": ['{"format": ["x", 1]}\n'],
        "order": [lines[0], lines[2], *lines[3:]], "twice": [*lines[:2], *lines[1:]],
        "ok": [x.replace('"ok": true', '"ok": 1') for x in lines],
        "drive": [x.replace('"drive": 20000', '"drive": 21000', 1) for x in lines],
        "tokens": [x.replace('"tokens": 14', '"tokens": 15') for x in lines],
        "text tokens": [x.replace('"tokens": 7', '"tokens": "7"') for x in lines],
        "seed": [x.replace('"seed": 1000001', '"seed": 1000002') for x in lines],
        "most": [x.replace('"most": 9', '"most": 2') for x in lines],
        "split": [x.replace('"split": "train"', '"split": "nova"') for x in lines],
        "suite": [x.replace('"suite": "one-shot"', '"suite": "one"') for x in lines],
        "of": [x.replace('"of": 64', '"of": 63') for x in lines],
        "score": [re.sub(r'"regret": [-0-9.e]+', '"regret": 0.5', x) for x in lines],
    }  # fmt: skip
    for name, some in changed.items():
        path = folder / f"{name}.jsonl"
        path.write_text("".join(some))
        if name != "half a line":
            found[name] = rounded(str(tried(replay, path)).replace(str(folder), ""))
    found["differing"] = [again(Toy(0), r) for r in (
        Round("toy:1", 10, [], {}, 0), Round("toy:0", 11, [], {}, 0), Round("toy:0", 10, [], {"value": 0.0, "made": 0.0}, 0),
        Round("toy:0", 10, [], {"value": 1.0}, 0),
        Round("toy:0", 10, [{"call": "add", "arguments": {"n": 1}, "ok": True, "answer": {"sum": 1.0}}] * 4, {}, 0),
        Round("toy:0", 10, [{"call": "add", "arguments": None, "ok": True, "answer": {}, "made": False}], {}, 0),
    )]  # fmt: skip
    found["cut"] = [again(Toy(0), Round("toy:0", 10, [{}] * 3, {}, 0), most) for most in (2,)]
    path = folder / "half a line.jsonl"
    with Writer(path, came.head, go_on=True) as writer:
        found["before"] = [r.game for r in writer.before]
        writer.end(came)
    found["gone on"] = [
        path.read_text() == text,
        str(tried(Writer, path, came.head, go_on=True)).replace(str(folder), ""),
    ]
    other = Head(**{**vars(came.head), "player": "you", "limits": Limits(8)})
    found["other"] = [
        str(tried(Writer, folder / "no end.jsonl", other, go_on=True)).replace(str(folder), ""),
        str(tried(save, came, path)).replace(str(folder), ""),
    ]
    found["suites"] = [
        str(tried(suite, *a))
        for a in (
            ("few",),
            ("diagnosis:lat",),
            ("diagnosis", "nova"),
            ("diagnosis", "train", 0),
            ("diagnosis", "train", 11),
            ("few-shot:1",),
            ("few-shot", "q"),
            ("line", "train", 65),
        )
    ]
    found["some"] = [
        [s.name, s.games, s.of, s.split, s.round]
        for s in (suite("diagnosis", episodes=3), suite("diagnosis:late"), suite("home", "nova", 2, "may"))
    ]
    found["here"] = [
        str(tried(suite_of, Head(**{**vars(came.head), **c})))
        for c in ({"round": "x"}, {"split": ""}, {"of": 5}, {"suite": "diagnosis"})
    ]
    found["players"] = [str(tried(player, n)) for n in ("formla", "no/module:x", "json:nothing", "json:__name__")]
    return {**found, "read": [len(read(folder / "a.jsonl").rounds), read(folder / "no end.jsonl").closing]}


def rounded(text):
    """Long numbers in a text cut to what all machines agree on."""
    return re.sub(r"-?\d+\.\d{7,}(e-?\d+)?", lambda m: f"{float(m[0]):.6g}", text)


FILES = {
    "agents_tools": {
        "arguments": arguments, "by tool": calls_by_tool, "host": partial(box, "host"), "truth": partial(box, "truth"),
        "budgets": budgets, "maps": maps_told,
    },
    "agents_arena": {
        "set-ups": setup_texts, "trials": trials, "case": partial(case, "slip"), "table": table, "scores": scores,
        "transcripts": transcripts,
        "few-shot": partial(game, "few-shot", "coordinate", "nova", 1),
        "one-shot": partial(game, "one-shot", "formula", "train", 1),
        "home": partial(game, "home", "random", "train", 1), "line": partial(game, "line", "random", "train", 1),
        "line-3": partial(game, "line-3", "formula", "worn", 1),
        "bus-target": partial(game, "bus-target", "formula", "train", 2),
    },
}  # fmt: skip
