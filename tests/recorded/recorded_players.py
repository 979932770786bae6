"""Players of the arena and those who serve them: what they do with answers that are written here, without a machine; sessions by a
clock of their own; hands, prompts and what a client can read."""

import contextlib
import copy
import difflib
import io
import json
import queue
import threading
import time
import urllib.error
from http.client import BadStatusLine
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
from recorded.recorded_agents import Toy
from recorded.recorded_texts import tried
from recorded.store import digits

from registerbench.arena import Limits, Table, play, player, suite
from registerbench.arena.games import Suite
from registerbench.arena.loop import Guarded, Interrupted, head_of, name_of
from registerbench.arena.players import client, command, endpoint, searches, simple, technician, trained
from registerbench.arena.scores import Round
from registerbench.arena.transcript import Writer, read
from registerbench.diagnosis import SETUPS, Case
from registerbench.diagnosis.machine import MENDED, SERVICES
from registerbench.diagnosis.program import Host, parse
from registerbench.diagnosis.trial import Watch
from stage import Stage
from stage.agents.budget import Budget
from stage.agents.fields import FLAG, NUMBER, TEXT, WHOLE, Field
from stage.agents.server import prompts, resources
from stage.agents.server.sessions import Maker, Sessions
from stage.agents.tool import Answer, Tool
from stage.chips import CHIPS

# --- players at a desk: a game whose answers are written here ---


class Desk:
    """tools; name; answers: of (name, arguments), a mapping, a text, or None for a refusal. Over after `most` calls of act."""

    def __init__(self, tools, name, answers, most=99):
        self.tools = [{"name": t.name, "description": t.text, "parameters": t.schema()} for t in tools]
        self.name, self.task, self._answers, self._most = name, "Do it.", answers, most
        self.log, self.acts, self.ended, self.troubles, self.tokens = [], 0, "", [], 0

    @property
    def over(self):
        return self.acts >= self._most or bool(self.ended)

    def call(self, name, arguments=None):
        self.log.append([name, copy.deepcopy(arguments)])
        self.acts += name == "act"
        made = self._answers(name, arguments)
        if made is None:
            return Answer(False, {"error": "no."})
        return Answer(True, {"text": made} if isinstance(made, str) else made)

    def leave(self, why):
        self.ended = why

    def trouble(self, what):
        self.troubles.append(what)

    def spent(self, tokens):
        self.tokens += tokens


def named(*names):
    return [Tool(name, name, dict) for name in names]


SEEN = {
    "nothing": ("the program came to its end", "", [(50, 0), (50, 0), (0, 0), (-4, 0)]),
    "y": ("the program came to its end", "", [(0.5, 50), (0, 0)]),
    "both": ("the program came to its end", "", [(1.5, 50), (50.0, 0)]),
    "earlier": ("the program came to its end", "", [(49.0, 0), (50.05, 0), (0, 0), (-1, 0)]),
    "not earlier": ("the program came to its end", "", [(49.0, 0), (49.4, 0), (0, 0), (-3.95, 0)]),
    "short": ("the program came to its end", "", [(20.0, 0), (20.3, 0), (1, 0), (-2.9, 0)]),
    "still": ("the program came to its end", "", [(0.2, 0), (0.02, 0), (0, 0), (0, 0)]),
    "gave up": ("line 3: it did not come, and the host gave up.", "", [(0, 0)] * 4),
    **{sign: ("the program came to its end", f"x {sign} y", [(0, 0)] * 4) for sign, _ in technician.SIGNS},
}


def shortly(program, given):
    """Arguments of a call; of another program the lines that are not those of the set-up's."""
    texts = [str(v) for v in (given or {}).values()]
    if "\n" not in "".join(texts):
        return " ".join(texts)
    changed = [line for line in difflib.ndiff(program.split("\n"), texts[0].split("\n")) if line[0] in "+-"]
    return " / ".join(changed) if len(changed) < 7 else f"{len(changed)} lines, {digits(texts[0])}"


def technicians():
    """What the technician does at each set-up, whatever runs and scales say."""
    found = {}
    for name, setup in SETUPS.items():
        for seen, (ended, noted, scales) in SEEN.items():
            left = list(scales)

            def answers(asked, given, setup=setup, ended=ended, noted=noted, left=left):
                if asked == "measure":
                    x, y = left.pop(0)
                    return {"x_mm": x, "y_mm": y}
                return {"program": setup.program, "run": {"ended": ended}, "diagnostics": noted}.get(
                    asked, {"text": "done"}
                )

            desk = Desk(named("program", "run"), f"diagnosis:{name}", answers)
            said = tried(technician.play, desk)
            found[f"{name} {seen}"] = [*(f"{n} {shortly(setup.program, g)}" for n, g in desk.log), str(said)]
    formula = Desk(named("act"), "home:train:0", lambda n, g: {"a": 1}, 3)
    technician.play(formula)
    return {**found, "bench": formula.log}


NUMBERS = tuple(Field(n, NUMBER, n, True, low=low, high=high) for n, low, high in (
    ("start", 200.0, 6000.0), ("drive", 2000.0, 120000.0), ("up", 0.005, 0.4), ("down", 0.005, 0.4)))  # fmt: skip
FIRST = {"start": 1000.0, "drive": 100000.0, "up": 0.1, "down": 0.006}


def tries(lost):
    """Answers of an episode of tries: a move that is too fast loses step."""
    made = []

    def answers(name, given):
        if name == "formula":
            return dict(FIRST)
        made.append(given)
        took = 1e4 / given["drive"] + given["up"] / 2 + given["down"] / 2 + 100 / given["start"]
        kept = [float(not lost(k, g)) for k, g in enumerate(made)]
        return {
            "info": {"duration": took, "usual": 0.4},
            "observation": {"kept": [*kept, 0.0], "tried": [*[1.0] * len(made), 0.0]},
        }

    return answers


def searching():
    """One rate at a time: what is tried after what came of it; where there is nothing to search."""
    act = Tool("act", "Do.", dict, NUMBERS)
    found = {}
    for name, lost in {"never": lambda k, g: False, "fast": lambda k, g: g["drive"] > 104000, "always": lambda k, g: True,
                       "first": lambda k, g: k < 2, "ramp": lambda k, g: g["up"] < 0.09}.items():  # fmt: skip
        desk = Desk([act], "few-shot:train:3", tries(lost), 9)
        searches.coordinate(desk)
        found[name] = [list((g or {}).values()) for _, g in desk.log]
    for name, tools in {
        "one-shot:train:1": [act],
        "few-shot:train:1": named("act"),
        "few-shot:nova:1": named("program"),
    }.items():
        desk = Desk(tools, name, tries(lambda k, g: False), 2)
        tried(searches.coordinate, desk)
        tried(searches.optuna, desk)
        found[name] = desk.log
    refused = Desk(
        [act],
        "few-shot:ms:0",
        lambda n, g: FIRST if n == "formula" else None if g != FIRST else tries(lambda k, g: False)(n, g),
        9,
    )
    searches.coordinate(refused)
    return {**found, "refused": refused.log}


class Optuna(SimpleNamespace):
    """In the place of the library: what is asked of it, and answers from the middle of each span."""

    def __init__(self):
        super().__init__(WARNING=30, asked=[])
        self.logging = self.samplers = self

    def __getattr__(self, name):
        def call(*given, **named):
            self.asked.append(
                [
                    name,
                    *(g for g in given if g is not self),
                    named and {k: v for k, v in named.items() if v is not self},
                ]
            )
            if name == "suggest_float":
                return 0.25 * given[1] + 0.75 * given[2]
            return self

        return call


def drawing():
    """The player that draws: from which spans, by which seed, and what it tells of each try."""
    found = {}
    for name in ("few-shot:train:3", "few-shot:nova:12"):
        library = Optuna()
        desk = Desk([Tool("act", "Do.", dict, NUMBERS)], name, tries(lambda k, g: k == 1), 3)
        with patch.object(searches, "need", lambda *given, library=library: library.asked.append(given) or library):
            searches.optuna(desk)
        found[name] = [desk.log, library.asked]
    return found


COUNT = [iter(())]


def simply():
    """The formula, and chance, at an episode and at a set-up, as long as it is not refused."""
    schemas = (Field("macro", TEXT, "m", True, choices=("a", "b", "c")), Field("n", WHOLE, "n", True, low=0, high=9), *NUMBERS[:3],
               Field("far", NUMBER, "f", True, low=-3.0, high=1.0), Field("on", FLAG, "f"))  # fmt: skip
    found = []
    for most, yes in ((3, 9), (9, 2)):
        desks = [
            Desk(
                [Tool("act", "Do.", dict, schemas)],
                "x",
                lambda n, g, yes=yes: {"k": 1} if next(COUNT[0]) < yes else None,
                most,
            )
            for _ in "ab"
        ]
        for desk, who in zip(desks, (simple.formula, simple.Random(3)), strict=True):
            COUNT[0] = iter(range(99))
            who(desk)
            found.append(desk.log)
    chance = simple.Random()
    for _ in range(3):
        desk = Desk([
            Tool("answer", "a", dict, (Field("cause", TEXT, "c", True, choices=("one", "two", "three")),)),
            Tool("service", "s", dict, (Field("work", TEXT, "w", True, choices=("saw", "oil", "weld")),)),
        ], "diagnosis:x", lambda n, g: {})  # fmt: skip
        chance(desk)
        found.append(desk.log)
    return [*found, simple.Random.name, name_of(player("random")), name_of(player("technician"))]


EPISODE = {
    "distance": 0.3, "declared": -0.5, "left": 0.625, "best": 0.38, "tried": [1.0, 1.0, 1.0, 0.0], "kept": [1.0, 1.0, 0.0, 0.0],
    "duration": [0.5, 0.4, 0.3, 0.0], "tried_drive": [-0.2, 0.4, 0.9, 0.0],
}  # fmt: skip


def policy():
    """What the trained policy looks at and does: nothing tried yet, some kept, none kept."""
    none = {**EPISODE, "tried": [0.0] * 4, "kept": [0.0] * 4}
    lost = {**EPISODE, "kept": [0.0] * 4}
    seen = {"some": EPISODE, "none": none, "lost": lost, "kept last": {**EPISODE, "kept": [0.0, 0.0, 1.0, 0.0]}}
    found = {k: [trained.features(kind, s) for kind in trained.FEATURES] for k, s in seen.items()}
    found["act"] = [
        trained.rates_of(np.array(a, float))
        for a in ([-1, -1, -1, -1], [1, 1, 1, 1], [0, 0.5, -0.5, 0.25], [9, -9, 0, 0])
    ]
    for name in ("few-shot:train:0", "one-shot:nova:1", "few-shot-wide:train:1", "home:train:2"):
        desk = Desk(named("act"), name, lambda n, g: {"observation": lost if n == "act" else EPISODE, "start": 1.0}, 2)
        trained.play(desk)
        found[name] = desk.log
    refused = Desk(named("act"), "one-shot:train:0", lambda n, g: None if n == "act" else {"observation": EPISODE})
    trained.play(refused)
    return {**found, "refused": refused.log}


# --- players from outside ---


class Process:
    """As a command: what it is told is kept."""

    def __init__(self, code=0, broken=99):
        self.told, self.returncode, self.stdin, self.waits = [], code, self, []
        self._broken = broken

    def write(self, text):
        if len(self.told) >= self._broken:
            raise BrokenPipeError
        self.told.append(text)

    def flush(self):
        pass

    def wait(self, timeout):
        self.waits.append(timeout)


LINES = {
    "calls": ['{"call": "act", "arguments": {"n": 2}, "tokens": 7}\n', '{"call": "nothing"}\n', '{"done": true, "tokens": 3}\n',
        '{"call": "act"}\n'],
    "over": ['{"call": "act"}\n'] * 4, "gone": ['{"call": "look"}\n', ""],
    "odd": ["hello\n", "[1]\n", '{"done": false}\n', '{"calls": 1}\n', '{"done": 1, "call": "act", "tokens": 2}\n'],
    "wrong": ["{}\n"] * 19 + ['{"call": "look"}\n'] + ["{}\n"] * 5,
}  # fmt: skip


def commands():
    """A command's lines and what it is told of them; how it ended; what it is."""
    found = {}
    for name, lines in LINES.items():
        for broken in (99, 1):
            desk = Desk(named("act", "look"), "x:0", lambda n, g: {"n": g} if n != "nothing" else None, 2)
            process, waiting = Process(broken=broken), queue.Queue()
            for line in lines:
                waiting.put(line)
            ended = command.Command("agent")._play(desk, process, waiting)
            found[f"{name} {broken}"] = [
                ended,
                desk.log,
                desk.ended,
                desk.troubles,
                desk.tokens,
                process.told[1:],
                waiting.qsize(),
            ]
    ends = []
    for code, log, over in (
        (0, [], False),
        (0, ["x"], False),
        (3, [], False),
        (-9, ["x"], False),
        (3, [], True),
        (None, [], False),
    ):
        desk, process = Desk([], "x:0", None, 0 if over else 9), Process(code)
        desk.log = log
        command._note_end(desk, process)
        ends.append([desk.ended, desk.troubles, process.waits])
    read = queue.Queue()
    command._read(io.StringIO("a\n\nb" + "c" * (1 << 20) + "\nlast"), read, threading.Event())
    gone = threading.Event()
    gone.set()
    command._read(io.StringIO("a\n"), read, gone)
    made = [tried(command.Command, w) for w in ("python 'my agent.py' -x", "agent", ["a b", "c"], "", [], "a 'b")]
    return {
        **found, "ends": ends, "read": [len(read.get()) for _ in range(read.qsize())],
        "made": [m if isinstance(m, str) else [m.words, m.name] for m in made],
        "parsed": [command._parsed(t) for t in ("1", "null", '{"done": true}', '{"call": null}', "{")],
        "none": str(tried(command.Command("/nowhere/agent --now"), Desk([], "x", None))),
    }  # fmt: skip


def reply(message, **more):
    return json.dumps({"choices": [{"message": message}], **more}).encode()


def calling(*pairs):
    return {
        "content": None,
        "role": "assistant",
        "tool_calls": [{"id": f"c{k}", "function": {"name": n, "arguments": a}} for k, (n, a) in enumerate(pairs)],
    }


class Opener:
    """In the place of a network: replies are bytes, or errors that are raised; what was asked is kept."""

    def __init__(self, replies):
        self.replies, self.asked = list(replies), []

    @contextlib.contextmanager
    def open(self, request, timeout):
        body = json.loads(request.data)
        heads = {k: v for k, v in request.header_items() if k in ("Content-type", "Authorization")}
        self.asked.append(
            [
                request.full_url,
                heads,
                timeout,
                [m.get("content") for m in body["messages"]],
                len(body["tools"]),
                body["model"],
            ]
        )
        made = self.replies.pop(0) if self.replies else reply({"content": "nothing more"})
        if isinstance(made, Exception):
            raise made
        yield SimpleNamespace(read1=io.BytesIO(made).read)


def http_error(code):
    return urllib.error.HTTPError("u", code, "why", {}, io.BytesIO(b"because " * 90))


REPLIES = {
    "calls": [reply(calling(("act", '{"n": 1}'), ("act", {"n": 2})), usage={"total_tokens": 9}),
        reply({"content": "so"}, usage={"total_tokens": None}),
              reply(calling(("look", ""), ("nothing", "{"), (None, "[1]")), usage={})],
    "silent": [reply({"content": "a"}), reply({"content": None}), reply(calling(("look", "{}"))), reply({}), reply({}), reply({}),
        reply({})],
    "busy": [http_error(429), http_error(503), TimeoutError("slow"), reply(calling(("act", "{}"), ("act", "{}")))],
    "too busy": [http_error(500), http_error(502), http_error(504), http_error(503), reply({})], "refused": [http_error(404)],
    "away": [urllib.error.URLError("no way"), ConnectionError("cut"), ConnectionError("cut"), ConnectionError("cut")],
    "text": [b"hello"],
    "odd": [b"[]"], "no choices": [reply({})[:-15] + b"x"], "calls that are none": [reply({"tool_calls": [1]})],
    "text message": [reply("hi")],
    "tokens": [reply(calling(("act", "{}")), usage=[3]), reply(calling(("act", "{}")), usage={"total_tokens": 5})],
    "http": [BadStatusLine("x")],
}  # fmt: skip


def endpoints():
    """A model's replies, what is sent for them, how long one waits, and where it ends."""
    found = {}
    for name, replies in REPLIES.items():
        opener, pauses = Opener(replies), []
        desk = Desk(named("act", "look"), "x:0", lambda n, g: {"n": g} if n in ("act", "look") else None, 2)
        who = endpoint.Endpoint(
            "https://host/v1/", "fake", "key" if name != "silent" else "", 0.5 if name == "away" else 2.0
        )
        with patch.object(endpoint, "_OPENER", opener), patch.object(time, "sleep", pauses.append):
            said = tried(who, desk)
        found[name] = [str(said), desk.log, desk.troubles, desk.tokens, pauses, opener.asked[-1], len(opener.asked)]
    found["made"] = [
        str(tried(endpoint.Endpoint, *a))[:90] for a in (("host/v1", "m"), ("http://h", ""), ("ftp://h", "m"))
    ]
    parts = SimpleNamespace(read1=io.BytesIO(b"x" * 200_000).read1)
    endless = SimpleNamespace(read1=lambda most, part=bytes(1 << 16): part[:most])
    found["endless"] = len(endpoint._all(Desk([], "x", None), endless))
    found["all"] = [len(endpoint._all(Desk([], "x", None), parts)), endpoint._all(Desk([], "x", None, 0), parts)]
    return found


def clients():
    """A game in the place of a maker of stages: calls until it is over."""
    game = client._Game(Table(Toy(0), Limits(9)))
    box = game()
    said = [
        box.call("add", {"n": 1}).text,
        box.call("add", {"m": 1}).text,
        box.call("add", {"n": 1}).text,
        box.call("add", {"n": 1}).text,
        box.call("add", {}).text,
    ]
    return [
        *said,
        sorted(box.tools),
        box.stage,
        box.recordings,
        box.axes,
        game.axes,
        game.stage,
        game.catalogue is game,
        sorted(game.tools),
        box.close(),
        box.cancel(),
        box.interrupt(),
    ]


# --- the loop ---


def toys(n, of=None):
    return Suite("toy", [(f"toy:{k}", 10 + k) for k in range(n)], of or n, Toy)


def adding(table):
    table.spent(2 * len(table.name))
    while not table.over:
        table.call("add", {"n": 1 + len(table.log)})


def stopping(table):
    table.call("add", {"n": 1})
    if table.name == "toy:1":
        raise ZeroDivisionError("one by none " + "x" * 400)


async def later(table):
    table.call("add", {"n": 2})


def told(came):
    return [
        str(came),
        [[r.game, r.seed, r.score, r.tokens, r.ended, r.troubles, len(r.calls)] for r in came.rounds],
        came.value,
        came.low,
        came.high,
        came.entry,
    ]


def loops(folder):
    """Games one after the other: what is told of each, what was played before, who fails, and where a run stops."""
    seen = []
    came = play(toys(3, 5), adding, "mine", Limits(2), lambda r: seen.append(r.game))
    found = {
        "adding": told(came),
        "told": seen,
        "later": told(play(toys(1), later)),
        "guarded": told(play(toys(3), Guarded(stopping))),
    }
    found["guarded later"] = told(play(toys(1), Guarded(later)))
    wrong = [Round("toy:0", 10, came.rounds[1].calls, came.rounds[0].score, 0)]
    seen.clear()
    on = play(toys(3, 5), adding, "mine", Limits(2), lambda r: seen.append(r.game), came.rounds[:2])
    found["before"] = [told(on) == told(came), seen, str(tried(play, toys(2), adding, before=wrong))]
    try:
        play(
            toys(3),
            lambda t: tried(lambda: None) if t.name == "toy:0" else (_ for _ in ()).throw(Interrupted("gone", None)),
            "x",
        )
    except Interrupted as error:
        found["interrupted"] = [str(error), told(error.played)]
    for name in ("raises", "exits"):
        with contextlib.suppress(ZeroDivisionError):
            found[name] = "no" if play(toys(2), stopping) else ""
    found["names"] = [
        name_of(w) for w in (adding, Guarded(adding), command.Command("a b"), SimpleNamespace(name=3), object())
    ]
    found["head"] = head_of(toys(2, 7), "me", Limits(3))
    with Writer(folder / "t", found["head"]) as writer:
        for r in came.rounds[:2]:
            writer.game(r)
    there = read(folder / "t")
    found["file"] = [
        (folder / "t").read_text().splitlines()[1:],
        [r == c for r, c in zip(there.rounds, came.rounds, strict=False)],
        there.closing,
        there.head == found["head"],
    ]
    found["put away"] = [[g.calls.call("add", {"n": 1}).text for g in list(toys(2))], [g.calls.closed for g in toys(2)]]
    return found


# --- hands ---

CORNERS = {
    "one-shot": [{"start": 200, "drive": 2000, "up": 0.01, "down": 0.02},
        {"start": 999.5, "drive": 30000, "up": 0.2, "down": 0.05}],
    "home": [{}, {"search": 9000, "ramp": 0.05, "approach": 700, "leave": 30, "back_off": 90}, {"report": True}],
    "line": [{"rate": 9000, "ramp": 0.07}, {"rate": 20000, "ramp": 0.2,
            "corrections": [0.5, -1, 1, 0, 0.25, -0.5, 0, 0, 0, 0, 0, 1]}, {"rate": 9000, "ramp": 0.1, "corrections": [1]}],
    "bus-axes": [{"macro": "read"}, {"macro": "Rates usual"}, {"macro": "q"}],
}  # fmt: skip


def hands():
    """Arguments of `act` as the environment's actions; what the rule would do, and who has gone; words for what is observed."""
    found = {}
    for task, given in CORNERS.items():
        episodes = iter(suite(task, episodes=1))
        game = next(episodes)
        act = game.calls.tools["act"]
        hand = game._hands
        found[task] = [
            game.task,
            game.name,
            game.seed,
            act.schema() if task != "bus-axes" else "",
            act.example(),
            hand.formula(),
            hand.idle(),
            str(hand.observed())[:900],
        ]
        found[f"{task} actions"] = [tried(lambda g=g, hand=hand, act=act: hand.action(**act.values(g))) for g in given]
        if task == "one-shot":
            game._played.act(hand.idle())
            found["over"] = [
                game.calls.call(n, act.values(given[0]) if n == "act" else None).text
                for n in ("formula", "act", "observe")
            ]
        episodes.close()
    return found


# --- set-ups at work ---


def machines():
    """What breaks and mends machines, in the numbers of the stage; services, and what each mends."""
    found = {}

    def look(stage):
        x = stage.axes["x"]
        return [
            [stage.state.switch_table[x.switches.row(pin)].bit for pin in ("el_plus", "el_minus", "org")],
            [[a.supply, float(stage.state.drives[a.index].voltage)] for a in stage.axes.values()],
            stage.state.drives[x.index].torque_constant, stage.state.drives[stage.axes["y"].index].torque_constant, x.position,
            stage.payload(),
        ]  # fmt: skip

    for name in ("swapped", "supply", "slip", "erratum", "polarity"):
        case = Case(name)
        rows = [look(case.stage)]
        for work in SERVICES:
            said = case.box.call("service", {"work": work})
            rows.append([said.text, case._mended, case._needless, look(case.stage)])
        if case.setup.cause in MENDED:
            case.setup.equip(case.stage)
            rows.append(look(case.stage))
        case._begin(0.0123456)
        found[name] = [*rows, look(case.stage), case.box.call("measure").text]
        case.box.close()
    return found


WAYS = [
    "base x 304h\nx: operate 08h\nbase x 2FFh\nx: 15\nuntil x stopped 1",
    "base y 300h\ny: R1 <- 3\nuntil y stopped 0\nwait 0.0031",
    "x: 84 3: 1 2: 3A 1: 98\nx: R1 <- 500\nx: R7 <- 204\nx: R0 <- 30\nx: control 44h\n"
    "x: operate 10h\nuntil x stopped 0.5\nwait 0.005",
    "base x 307h\nx: 15\nbase x 308h\nx: 15\nwait 0.001", "x: status?\nuntil x stopped 0.01",
]  # fmt: skip


def programs():
    """Programs at the ports: who was written to, what waits and polls take, what a watch sees."""
    found = []
    for text in WAYS:
        stage = Stage("xy", chips="PCL240K", visuals=False)
        journals = [chip.journal() for chip in stage.chips]
        lines = tried(parse, text, stage)
        if isinstance(lines, str):
            found.append(lines)
            continue
        watch = Watch(stage, 0.04)
        looks = []

        def look(watch=watch, looks=looks, stage=stage):
            looks.append(round(stage.time, 9))
            watch.look()

        ran = tried(Host(stage, lambda name: None, look).run, lines)
        sent = [[[int(e.kind), int(e.a), int(e.b)] for e in j.entries] for j in journals]
        found.append(
            [ran, sent, len(looks), looks[:2], looks[-2:], [list(s) for s in watch.seen[-2:]], len(watch.seen)]
        )
    stage = Stage("xy", chips="MCX304", visuals=False)
    case = Case("erratum")
    polls = "x: R <- 400000\nx: V <- 300\nx: SV <- 100\nx: P <- 40\nx: F_DRV_P\nuntil x RR0.n-DRV 1 0.01\n"
    polls += "until x RR0.n-DRV 0 2\nuntil y RR0.n-DRV 1 0.004"
    for text in (
        "until x RR9.q 1 1",
        "until x V.q 1 1",
        "until x WR1.SP0-L 0 1",
        "until x RR0.n-DRV 0 61",
        "until x RR0.n-DRV 0",
        polls,
    ):
        found.append(case.box.call("write_program", {"text": text}).text)
    found.append(case.box.call("run").text)
    late = Watch(stage, 0.001)
    stage.run(0.0011)
    late.look()
    stage.run(0.0008)
    return [*found, len(late.seen), str(tried(late.look))]


# --- sessions ---


class Clock:
    now = 5.0

    def __call__(self):
        return self.now


class Box:
    """In the place of a toolbox."""

    def __init__(self, log):
        self._log, self.number = log, sum(x == "made" for x in log)
        log.append("made")

    def close(self):
        self._log.append(f"close {self.number}")

    def interrupt(self):
        self._log.append(f"interrupt {self.number}")

    def cancel(self):
        self._log.append(f"cancel {self.number}")


def sessions():
    """Who is there, and since when: silent ones, old ones, those that have gone and come again."""
    clock, log = Clock(), []
    held = Sessions(lambda: Box(log), 2, 10.0, 3.0, 40.0, clock)
    found = []

    def step(seconds, *work):
        clock.now += seconds
        for name, *given in work:
            said = tried(getattr(held, name), *given)
            found.append(
                [
                    round(clock.now, 3),
                    name,
                    *given,
                    said.number if isinstance(said, Box) else said,
                    len(held),
                    [k for k in "abcdef" if k in held],
                ]
            )

    step(0, ("box", "a"), ("box", "b"), ("box", "c"), ("cancel", "b"), ("cancel", "z"))
    step(10, ("reap",), ("box", "a"))
    step(0.5, ("reap",), ("box", "b"), ("box", "c"), ("gone", "c"), ("gone", "z"))
    step(3, ("reap",), ("box", "c"), ("gone", "c"))
    step(2, ("gone", "c"), ("reap",))
    step(3.5, ("box", "d"), ("box", "c"), ("gone", "a"))
    for _ in range(3):
        step(7, ("box", "a"), ("reap",))
    step(5, ("reap",), ("box", "a"), ("box", "e"), ("close", "e"), ("close", "e"), ("close", "q"), ("box", "q"))
    step(1, ("box", "f"), ("close_all",), ("reap",), ("box", "f"))
    return [*found, log, [Sessions(dict).most, Sessions(dict).idle, Sessions(dict).grace, Sessions(dict).life]]


def makers():
    """Stages that are copies of one: settings of the toolboxes, and what stays at power-up."""
    made = []

    def stage():
        made.append(1)
        return Stage("xy", chips="PCL240MS", visuals=False)

    maker = Maker(stage, "truth", Budget(3), False, None)
    rows = [len(made)]
    one, other = maker(), maker()
    one.call("move", {"axis": "x", "pulses": 30, "accel": 0.01})
    for box in (one, other, maker.catalogue, maker()):
        rows.append(
            [
                box.mode,
                box.meter.budget,
                box.meter.patience,
                sorted(box.tools),
                box.stage.axes["x"].chip.net(),
                box.call("budget").data,
            ]
        )
    usual = Maker(stage)
    box = usual.catalogue
    return [
        *rows,
        len(made),
        maker.catalogue is maker.catalogue,
        box.mode,
        "snapshot" in box.tools,
        box.meter.patience,
        box.meter.budget,
        box.recordings is not None,
    ]


def pages():
    """What a client can read and ask for: pages, facts, prompts, and what there is not."""
    box = Maker(lambda: Stage("xyz", chips={"x": "PCL240MS", "y": "MCX304", "z": "HCTL1100"}, visuals=False)).catalogue
    listed = resources.pages(box)
    found = {
        "pages": [[p.uri, p.name, p.text, p.kind] for p in listed.values()],
        "none": resources.pages(SimpleNamespace(stage=None)),
    }
    found["read"] = {
        uri: tried(lambda uri=uri: resources.read(listed, uri, box).read(box))
        for uri in (*listed, "stage://axis", "stage://recording/lst")
    }
    bare = SimpleNamespace(recordings=None)
    found["bare"] = str(tried(listed["stage://recording/last"].read, bare))
    found["facts"] = {name: resources.facts(kind) for name, kind in CHIPS.items()}
    asked = (
        ("bring_up_axis", None), ("bring_up_axis", {"axis": "Y"}), ("Find_lost_steps", {}), ("tune_move", {"distance": "3mm"}),
        ("tune_move", {"axis": "z", "distance": ""}),
        ("tune_move", {"axis": "q"}), ("tune_move", {"far": "1"}), ("find_lost_steps", {"axis": "a" * 101}),
        ("tune_move", {"distance": "d" * 100}), ("tune_move", {"distance": "a\tb"}), ("tune", {}),
    )  # fmt: skip
    found["prompts"] = [tried(prompts.prompt, name, given, ("x", "y", "z")) for name, given in asked]
    found["no axes"] = str(tried(prompts.prompt, "tune_move", {}, ()))
    found["listed"] = {k: [p.text, p.arguments] for k, p in prompts.PROMPTS.items()}
    return found


FILES = {
    "agents_players": {
        "technician": technicians, "searches": searching, "draws": drawing, "simple": simply,
        "policy": policy, "commands": commands,
        "endpoints": endpoints,
        "clients": clients, "loop": loops, "hands": hands, "machines": machines, "programs": programs,
        "sessions": sessions, "makers": makers, "pages": pages,
    },
}  # fmt: skip
