"""What stands between a player and a game: clocks, calls that fail in every way, wrong lines of transcripts, what work costs."""

import json
import re
from unittest.mock import patch

from recorded.recorded_agents import Toy
from recorded.recorded_texts import tried

from registerbench.arena import Limits, Table, read, save
from registerbench.arena import table as tables
from registerbench.arena.scores import Head, Round, played
from registerbench.arena.transcript import LARGEST, Writer
from registerbench.diagnosis import SETUPS, Case, Score
from stage import Stage
from stage.agents.budget import Spent
from stage.agents.calls import Calls
from stage.agents.fields import FLAG, LENGTH, NUMBER, NUMBERS, TEXT, WHOLE, Field
from stage.agents.tool import Answer, Picture, Tool
from stage.agents.toolbox import Toolbox
from stage.errors import ArgumentError, RunTimeout, StageError


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


class Slow(Toy):
    """Its calls take time, which is not the player's."""

    def __init__(self, clock):
        super().__init__(0)
        self.clock, self.limits = clock, []

    def add(self, n):
        self.clock.now += 50.0
        self.limits.append((self.table.look_again(), self.table.late()))
        return super().add(n)


def clocks():
    """How long a player may think for a call, and in all; and that the game's own time is not its."""
    clock = Clock()
    found = []
    with patch.object(tables, "monotonic", clock):
        for limits in (Limits(9, 10.0, 25.0), Limits(9, 0.5, 100.0), Limits(9, 100.0, 7.0)):
            game = Slow(clock)
            game.table = made = Table(game, limits)
            rows = []
            for think in (0.0, 4.0, 9.999, 6.0, 5.0):
                clock.now += think
                rows.append([round(made.look_again(), 9), made.late()])
                made.call("add", {"n": 1})
            clock.now += 10.0
            found.append([rows, game.limits, round(made.look_again(), 9), made.late()])
    over, left = Table(Toy(0), Limits(2)), []
    over.call("add", {"n": 1})
    over.call("add", {"n": "1"})
    for _ in range(22):
        try:
            left.append(over.call("add", {"n": 1}).text)
        except tables.Left:
            left.append("left")
    gone = Table(Toy(0))
    gone.leave("late")
    gone.leave("later")
    try:
        gone.call("add", {"n": 1})
    except tables.Left:
        left.append([gone.ended, dict(gone.troubles)])
    done = Table(Toy(0), Limits(1))
    done.call("add")
    done.leave("late")
    return [
        *found,
        left,
        dict(over.troubles),
        over.log,
        over.ended,
        [done.ended, done.log],
        [over.tokens, over.task, over.name],
    ]


class Counting(Calls):
    ended = 0

    def end(self):
        self.ended += 1

    def failed(self, error):
        return Answer(False, {"error": f"{type(error).__name__}: {error}"})


def calls():
    """Results and failures of every kind, as answers; names in any case; the end, twice."""

    def raising(error):
        def act(**given):
            raise error

        return act

    errors = (
        StageError("a"),
        ArgumentError("b"),
        Spent("c"),
        RunTimeout("d"),
        MemoryError(),
        RecursionError("e"),
        ZeroDivisionError("f" * 99),
        KeyError("g"),
    )
    tools = [Tool(f"fails{k}", "", raising(e)) for k, e in enumerate(errors)]
    tools += [Tool("text", "", lambda: "a\nb"), Tool("Mapping", "", lambda: {"x": 1.5, "ü": [None]}),
        Tool("picture", "", lambda: Picture(b"png", "drawn")),
              Tool("pairs", "", lambda: [("a", 1)]), Tool("nan", "", lambda: {"x": float("nan")}), Tool("none", "", lambda: None),
              Tool("both", "", lambda n, on=True: {"n": n, "on": on},
                  (Field("n", WHOLE, "it", True), Field("on", FLAG, "or not")))]  # fmt: skip
    made, usual = Counting(tools), Calls(tools)
    found = []
    for name in (*(t.name for t in tools), "mapping", " TEXT", "txt", "", None, 5, "both"):
        answer = made.call(name, {"n": "3"} if name == "both" else None)
        found.append(
            [
                name,
                answer.ok,
                answer.data,
                answer.png,
                "" if name == "nan" else [answer.text, str(answer) == answer.text],
                usual.call(name).ok,
            ]
        )
    found.append([usual.call("fails0").data, made.calls, usual.calls, made.closed])
    made.close("enough.")
    made.close("again.")
    usual.close()
    return [
        *found,
        made.call("text").data,
        usual.call("text").data,
        made.ended,
        made.calls,
        made.closed,
        made.cancel(),
        usual.interrupt(),
    ]


EXAMPLES = [
    (Field("a", NUMBER, "a", True), Field("b", WHOLE, "b", True), Field("c", TEXT, "c", True), Field("d", FLAG, "d", True),
        Field("e", LENGTH, "e", True)),
    (Field("f", "bytes", "f", True), Field("g", NUMBERS, "g", True), Field("h", "lengths", "h", True, choices=("x", "y", "z")),
        Field("i", TEXT, "i")),
    (Field("j", TEXT, "j", True, choices=("p", "q")), Field("k", "lengths", "k", True, choices=("u",))),
]  # fmt: skip


def examples():
    """Of tools with arguments of every kind: what they show, and what they say of others."""
    made = [Tool("t", "T.", dict, fields, shows={"i": "..."} if k == 1 else {}) for k, fields in enumerate(EXAMPLES)]
    found = [
        [t.example(), json.dumps(t.schema()), tried(t.values, json.loads(t.example())), tried(t.values, {"aa": 1})]
        for t in made
    ]
    stage = Stage("xy", visuals=False)
    mine = Tool("budget", "Mine.", lambda: "mine", free=True)
    box = Toolbox(stage, "host", None, snapshots=False, more=[mine, Tool("own", "Own.", lambda: "own", moves=True)])
    found.append(
        [
            box.call("budget").text,
            box.call("own").text,
            box.meter.moves,
            "snapshot" in box.tools,
            list(box.tools)[-1],
            box.meter.patience,
            box.meter.budget,
        ]
    )
    return found


def lines(folder):
    """A transcript with one thing wrong in a line, told with the number of the line."""
    head = Head(
        "few-shot",
        "train",
        "open",
        (("few-shot:train:0", 3), ("few-shot:train:1", None)),
        64,
        Limits(5, 2.0, 9.5),
        "me",
    )
    calls = [
        {"call": "add", "arguments": {"n": 1}, "ok": True, "answer": {"sum": 1.0}},
        {"call": 5, "arguments": None, "ok": False, "answer": {}, "made": False},
    ]
    rounds = [
        Round("few-shot:train:0", 3, calls, {"value": 0.5}, 7, "", {"odd": 2}),
        Round("few-shot:train:1", None, calls[:1], {"value": 1.5}, 0, "timed out: x"),
    ]
    save(played(head, rounds), folder / "a")
    good = (folder / "a").read_text().splitlines()
    back = read(folder / "a")
    found = {
        "back": [
            back.head == head,
            back.rounds == rounds,
            back.closing,
            back.ends - (folder / "a").read_bytes().rindex(b"{"),
        ]
    }

    def wrong(name, number, change):
        made = list(good)
        line = json.loads(made[number - 1])
        change(line)
        made[number - 1] = json.dumps(line)
        (folder / "b").write_text("\n".join(made) + "\n")
        said = tried(read, folder / "b")
        found[name] = (
            said.replace(str(folder), "")
            if isinstance(said, str)
            else [len(said.rounds), str(said.rounds[0])[:200], said.head.games]
        )

    for name, number, key, value in (
        ("seed true", 2, "seed", True), ("seed text", 2, "seed", "3"), ("seed minus", 2, "seed", -1), ("seed large", 2, "seed",
            1 << 60), ("seed none", 2, "seed", None),
        ("game 5", 2, "game", 5), ("game long", 2, "game", "g" * 2001), ("game longest", 2, "game", "g" * 2000), ("ok none", 3,
            "ok", None), ("tokens", 5, "tokens", 1.5), ("ended", 5, "ended", None), ("troubles", 5, "troubles",
            {"x": -1}), ("troubles list", 5, "troubles", []),
        ("format", 1, "format", ["PulseStage transcript", 1]), ("most", 1, "most", 0), ("patience", 1, "patience", "x"), ("games",
            1, "games", [["a"]]), ("of", 1, "of", -1),
        ("player", 1, "player", None), ("split", 1, "split", 3), ("played", 9, "played", 1),
    ):  # fmt: skip
        if number <= len(good):
            wrong(name, number, lambda line, key=key, value=value: line.__setitem__(key, value))
    for name, number, key in (("no call", 3, "call"), ("no arguments", 3, "arguments"), ("no answer", 4, "answer"),
        ("no ok", 4, "ok"), ("no tokens", 5, "tokens"),
                              ("no ended", 5, "ended"), ("no troubles", 5, "troubles"), ("no seed", 2, "seed"), ("no most", 1,
                                  "most"), ("no player", 1, "player"), ("no of", 1, "of")):  # fmt: skip
        wrong(name, number, lambda line, key=key: line.pop(key))
    for name, text in {
        "array": "[1]",
        "number": "5",
        "text": '"call"',
        "deep": "[" * 100_000,
        "binary": "\x00",
    }.items():
        (folder / "c").write_text("\n".join([good[0], text]) + "\n")
        found[name] = re.sub(r"(RecursionError).*", r"\1", str(tried(read, folder / "c")).replace(str(folder), ""))
        (folder / "c").write_text(text + "\n")
        found[f"{name} first"] = re.sub(
            r"(RecursionError).*", r"\1", str(tried(read, folder / "c")).replace(str(folder), "")
        )
    (folder / "large").touch()
    with (folder / "large").open("r+b") as file:
        file.truncate(LARGEST + 1)
    found["large"] = str(tried(read, folder / "large")).replace(str(folder), "")
    for name, path in (("none", folder / "none"), ("folder", folder)):
        try:
            read(path)
        except (FileNotFoundError, ArgumentError) as error:
            found[name] = str(error).replace(str(folder), "")
    (folder / "kept").write_text("mine\n")
    with Writer(folder / "kept", head, overwrite=True) as writer:
        writer.game(rounds[1])
    with Writer(folder / "kept", head, go_on=True) as writer:
        found["before"] = [writer.before == [rounds[1]], writer._file.name.endswith("kept")]
        writer.game(rounds[0])
    found["kept"] = (folder / "kept").read_text().splitlines()[1:]
    with Writer(folder / "new", head, go_on=True) as writer:
        found["new"] = [writer.before, len((folder / "new").read_text().splitlines())]
    return found


def worth():
    """What finding and mending are worth, and what work takes off."""
    found = [Score(f, m, w, 3, "x").value for f in (-1, 0, 1) for m in (False, True) for w in (0.0, 0.25, 1.5)]
    case = Case("supply", 3)
    rows = []
    for cause, needless, moves, ns in (
        ("", 0, 0, 0),
        ("supply too low", 1, 2, 25_000_000_000),
        ("slipping coupling", 2, 0, 5_000_000),
    ):
        case._answer, case._needless, case.box.meter.moves, case.box.meter.ns, case._runs = (
            cause,
            needless,
            moves,
            ns,
            moves,
        )
        with patch.object(case, "why_not", lambda cause=cause: "" if cause else "no"):
            rows.append([case.score(), case.score().value])
    return [
        *found,
        *rows,
        [s.name for s in SETUPS.values() if s.equip],
        case._work_on_machine,
        Case("late")._work_on_machine,
    ]


FILES = {"agents_tables": {"clocks": clocks, "calls": calls, "examples": examples, "lines": lines, "worth": worth}}
