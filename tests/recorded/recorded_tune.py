"""Tuning: tasks, loads, plans, moves that are tried, proofs, searches and answers, of many axes and chips, good and bad.

The search asks a study of ours in place of Optuna's, so what is recorded depends on no other package.
"""

from contextlib import contextmanager
from functools import partial
from unittest.mock import patch

import numpy as np
from recorded.player import Draw
from support.mirrored import mirrored

from stage import Stage
from stage.chips import HCTL1100, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.errors import StageError
from stage.firmware.driver import Speeds
from stage.sim.program import Program
from stage.tune import Case, Task, picture, run, search
from stage.tune.c_source import c_source
from stage.tune.formula import Load, speeds
from stage.tune.looks import Looks
from stage.tune.plans import plans_of
from stage.tune.proof import gain, prove, spare
from stage.tune.task import room
from stage.tune.tries import Tries
from stage.tune.written import Cycle, Row

CASES = [Case(0.0, 0.0, 1), Case(2.0, -3.5, -1), Case(2.5, 20.25, 1)]
QUICK = {"pulses": 400, "payload": 2.0, "hold": 0.02}
NUMBERS = {"start": 0.5, "drive": -0.25, "up": 0.3, "down": -1.0}

TASKS = {
    "usual": ("xy", PCL240K, {"axis": "x", "pulses": 400}),
    "all said": ("xy", PCL240K, {"axis": "y", "pulses": -1000, "payload": 3.0, "spare": 0.5, "within": 2e-4, "hold": 0.1,
                                 "overshoot": 3e-4, "payload_on": "work"}),
    "upright": ("xyz", MCX514, {"axis": "z", "pulses": 800, "payload": 1.0}),
    "no spare": ("xyz", PCL240MS, {"axis": "x", "pulses": 800, "payload": 1.0, "spare": 0.0}),
    "servo": ("xyz_servo", HCTL1100, {"axis": "y", "pulses": 300, "payload": 4.0}),
    "camera": ("xy_mast", PCL240MS, {"axis": "x", "pulses": 500, "judge_at": "camera", "payload": 2.0}),
    "body": ("xy_mast", PCL240K, {"axis": "y", "pulses": 500, "judge_at": "work", "overshoot": 1e-3}),
    "table": ("xya", PCL240K, {"axis": "a", "pulses": 900, "payload": 0.5}),
    "beside": ("xyz", PCL240K, {"axis": "z", "pulses": 500, "payload": 2.0, "payload_on": "work"}),
    "gantry": ("gantry", PCL240K, {"axis": "x", "pulses": 500, "payload": 2.0}),
}  # fmt: skip
NO_TASKS = [
    {"axis": "q"}, {"pulses": 0}, {"pulses": 10**7}, {"payload": -1.0}, {"payload": float("nan")}, {"payload": 1e6},
    {"spare": -0.1}, {"spare": float("inf")}, {"within": 0.0}, {"hold": 0.0}, {"hold": float("inf")}, {"overshoot": 0.0},
    {"overshoot": -1e-3}, {"judge_at": "nowhere"}, {"judge_at": "camera"}, {"payload_on": "nobody"},
]  # fmt: skip


def task_of(chip=PCL240K, model="xy", axis="x", **how):
    return Task(Stage(model, chips=chip, visuals=False), axis, **{**QUICK, **how})


def task(model, chip, how):
    made = Task(Stage(model, chips=chip, visuals=False), **how)
    axis = made.stage.axes[made.axis]
    stage = made.copy()
    begun = []
    for case in (*CASES, Case(0.0, 1.0, -1)):
        goal = made.begin(stage, case)
        begun.append([goal, [a.position for a in stage.axes.values()], float(stage.model.body_mass.sum())])
    return {
        **{name: getattr(made, name) for name in made.__dataclass_fields__ if name != "stage"},
        "turn": made.turn, "carries": made.carries, "most": made.most, "length": made.length(2.5e-5), "room": room(axis),
        "begun": begun, "corners": made.corners(np.random.default_rng(1), 3, 1.25),
        "drawn": made.drawn(np.random.default_rng(2), 9, 1.5),
        "asked": made.asked([Case(made.payload + kg, 0.0, 1) for kg in (-0.1, 0.0, 5e-10, 0.1)]),
        "stands": [a.position for a in made.stage.axes.values()],
    }  # fmt: skip


def no_tasks():
    found = {}
    for how in NO_TASKS:
        try:
            found[str(how)] = task_of(**how).pulses
        except StageError as error:
            found[str(how)] = str(error)
    try:
        task_of(model="gantry", axis="w")
    except StageError as error:
        found["tandem"] = str(error)
    most = task_of().stage.axes["x"]
    low, high = room(most)
    for more in (-65, -64, -63):
        try:
            found[f"room {more}"] = task_of(pulses=int((high - low) / most.meters_per_pulse) + more).pulses
        except StageError as error:
            found[f"room {more}"] = str(error)
    return found


def loads(model, chip):
    found = {}
    for name, axis in Stage(model, chips=chip, visuals=False).axes.items():
        load = Load.of(axis)
        heavy = load.heavier(2.5)
        found[name] = {
            **{key: getattr(load, key) for key in load.__dataclass_fields__ if key != "drive"},
            "heavier": [heavy.mass, heavy.weight, heavy.inertia], "stepper": load.stepper,
            "thrust": load.thrust(np.array([0.0, 0.02, 0.1, 0.3, 0.9]) * (100 / load.gear)),
            "pull in": load.pull_in if load.stepper else None,
        }  # fmt: skip
        for pulses, kg, safety in (
            (60, 0.0, 1.5),
            (400, 2.5, 1.5),
            (9000, 2.5, 1.5),
            (9000, 0.0, 3.0),
            (5000, 400.0, 2.0),
        ):
            try:
                found[name][f"{pulses} {kg:g} {safety}"] = speeds(load.heavier(kg), pulses, safety)
            except StageError as error:
                found[name][f"{pulses} {kg:g} {safety}"] = str(error)
    return found


def plans(chip, model="xy", axis="x", **how):
    made = plans_of(task_of(chip, model, axis, **how))
    middle = made.speeds(1.5)
    found = {
        "knobs": made.knobs, "shapes": made.shapes, "trims": getattr(made, "trims", None), "both": getattr(made, "both", None),
        "formula": made.formula(), "careful": made.formula(3.0), "empty": made.speeds(1.5, 0.0), "load": made.load(2.0).mass,
        "towards": made.towards(middle, made.speeds(1.2)), "far": made.towards(middle, Speeds(1.0, 1e6, 1e-6, 9.0)),
        "nowhere": made.towards(middle, Speeds(0.0, 0.0, 0.0, 0.0)),
    }  # fmt: skip
    every = {
        "some": NUMBERS, "more": {**dict.fromkeys(made.knobs, 0.4), "down": 0.1}, "least": dict.fromkeys(made.knobs, -1.0),
        "most": dict.fromkeys(made.knobs, 1.0), "slow": {"start": 1.0, "drive": -1.0},
    }  # fmt: skip
    for shape in made.shapes:
        for name, values in every.items():
            try:
                found[f"{name} {shape}"] = made.plan(middle, values, shape)
            except StageError as error:
                found[f"{name} {shape}"] = str(error)
    try:
        crawling = Speeds(0.0 if made.axis.chip.SERVO else 1000.0, 1000.0, 1e-5, 1e-5)
        found["no ramp"] = made.plan(crawling, {}, "linear")
    except StageError as error:
        found["no ramp"] = str(error)
    for pulses in (400, -300):
        program = Program()
        made.write(program, found["formula"], pulses)
        found[f"cycles {pulses}"] = program.ops
    for kg, safety in ((900.0, 1.5), (3.0, 40.0), (0.0, 1e9)):
        try:
            found[f"{kg:g} kg, {safety:g}"] = made.speeds(safety, kg)
        except StageError as error:
            found[f"{kg:g} kg, {safety:g}"] = str(error)
    return found


def tried(chip, model="xy", axis="x", **how):
    """Moves with the formula's plan and a rash one, more of them than there are stages; a proof; what it carries."""
    made = task_of(chip, model, axis, **how)
    own = plans_of(made)
    rash = own.plan(own.speeds(0.8), {"start": 1.0, "drive": 1.0, "up": -1.0, "down": -1.0}, "linear")
    some = [own.formula(), rash]
    cases = [*CASES, Case(2.6, 0.0, -1), Case(40.0, 8.0, 1)]
    with Tries(made, own, 1, lanes=4) as tries:
        outcome = tries.make(some, cases, 0.09)
        found = {
            "outcome": outcome, "good": outcome.good(made, made.asked(cases)), "made": tries.made,
            "short": tries.make(some[:1], cases[:2], 0.03),
        }  # fmt: skip
        proofs = prove(tries, some, cases[:4], 0.09)
        found["proofs"] = [[p, p.holds, p.said(), p.mean, p.worst] for p in proofs]
        found["gain"], found["back"] = gain(*proofs), gain(*proofs[::-1])
        found["made then"] = tries.made
    with Tries(made, own, 1, lanes=12) as tries:
        found["spare"] = spare(tries, own.formula(1.4), 0.09, np.random.default_rng(4))
    looks = Looks(made)
    stage = made.copy()
    goals = np.stack([looks.begin(stage, case) for case in CASES[:2]])
    found["looks"] = [looks.each, looks.ops(2), goals]
    shape = (2, 2, looks.each, goals.shape[2]) if made.point else (2, 2, looks.each)
    seen = np.zeros((2, 2, looks.each), np.int64)
    seen[:, :, 1:] = np.round(goals[:, None, 0] * 1e12) + np.arange(4).reshape(2, 2, 1) * 10**7
    found["errors"] = [shape, looks.errors(seen.reshape(2, -1), goals)]
    return found


class Study:
    """Draws what a search asks for, and notes what it is told."""

    def __init__(self, seed):
        self.draw, self.queue, self.said, self.number = Draw(f"study {seed}"), [], [], -1

    def enqueue_trial(self, values):
        self.said.append(["first", values])
        self.queue.append(values)

    def ask(self):
        self.number += 1
        return Trial(self.number, self.queue.pop(0) if self.queue else {}, self)

    def tell(self, trial, value):
        self.said.append([trial.number, trial.params, trial.constraints, value])


class Trial:
    def __init__(self, number, fixed, study):
        self.number, self.fixed, self.draw, self.params, self.constraints = number, fixed, study.draw, {}, {}

    def suggest_float(self, name, low, high):
        self.params[name] = self.fixed.get(name, low + (high - low) * self.draw.between(300, 800) / 1000)
        return self.params[name]

    def suggest_categorical(self, name, choices):
        self.params[name] = self.fixed.get(name, self.draw.of(*choices))
        return self.params[name]

    def set_constraint(self, name, value):
        self.constraints[name] = value


@contextmanager
def without_optuna(made):
    """made: what the studies have noted."""

    def study(seed):
        made.append(Study(seed))
        return made[-1]

    few = partial(Tries, lanes=8)
    with (
        patch.object(search, "_study", study),
        patch.object(run, "optuna", lambda: None),
        patch.object(run, "Tries", few),
    ):
        yield


def found_of(how, **settings):
    """All that `tune` says of a task, and what it was heard to say on its way."""
    studies, heard = [], []
    with without_optuna(studies):
        try:
            result = run.tune(task_of(**how), workers=1, told=lambda *what: heard.append(what), **settings)
        except StageError as error:
            return [str(error), heard]
    kept = {k: v for k, v in result.json().items() if k not in ("registers", "bytes")}
    return [
        str(result),
        kept,
        heard,
        [s.said for s in studies],
        result.c_source(),
        result.c_source("my-own move").splitlines()[9:14],
    ]


TUNED = {
    "servo": ({"chip": HCTL1100, "model": "xyz_servo", "pulses": 300}, {"by": "formula", "moves": 4}),
    "search": ({"chip": PCL240MS, "pulses": 150, "hold": 0.005}, {"trials": 10, "moves": 3, "seed": 2}),
    "by guess": ({}, {"by": "guess"}), "no trials": ({}, {"trials": 0}), "no moves": ({}, {"moves": True}),
}  # fmt: skip


class Panel:
    """An axes of a picture, that notes what is drawn on it."""

    def __init__(self):
        self.said = []

    def __getattr__(self, name):
        def note(*drawn, **how):
            said = [
                [len(v), float(np.sum(v)), float(np.max(v)), float(np.min(v))] if isinstance(v, np.ndarray) else v
                for v in drawn
            ]
            self.said.append([name, said, how])

        return note

    def get_ylim(self):
        return 0.0, 10.0


class Figure:
    def subplots(self, *shape, **how):
        self.shape, self.panels = [shape, how], [Panel() for _ in range(shape[0])]
        return self.panels


def drawn(how, *overwrite):
    result, figure = None, Figure()
    with without_optuna([]):
        result = run.tune(task_of(**how), by="formula", moves=2, workers=1)
    titles, saved = [], []
    with (
        patch.object(picture, "figure", lambda *size: (saved.append(size), figure)[1]),
        patch.object(picture, "heading", lambda fig, *words: titles.append(words)),
        patch.object(picture, "bare", lambda panel: panel.said.append("bare")),
        patch.object(picture, "save_figure", lambda fig, *how: saved.append(how)),
    ):
        result.plot("a.png", *overwrite)
    return [titles, saved, figure.shape, [p.said for p in figure.panels]]


def written():
    """C of cycles and registers that are rare."""
    some = [
        Cycle(0, 0x81, "select */ R1"), Cycle(None, 5_000_000, "wait 5 ms"), Cycle(None, 1_500, "wait"), Cycle(2, -2, "/* low"),
        Cycle(None, 3_999_999, "wait"), Cycle(1, 0x1FFFF, "high"),
    ]  # fmt: skip
    made = [
        Row("R1", 7, 4, "speed", "pps"), Row("P-2 x", -40000, 8, "place, pulses", "pulses"), Row("B", 0x7FFF, 4, "b", ""),
        Row("C", 0x8000, 4, "c", ""),
    ]  # fmt: skip
    found = {"words": [r.words for r in made]}
    for chip in (PCL240K, PCL240MK, MCX514, MCX312, HCTL1100):
        found[chip.__name__] = c_source("a move/1", "title */", ["", "a note /* of two", "b"], made, some, chip())
        found[f"{chip.__name__}, no registers"] = c_source("b", "t", [], [], [Cycle(9, 1, "far")], chip()).splitlines()[
            1:16
        ]
    return found


def turned(folder):
    """With a screw of x that turns the other way."""
    model = mirrored(folder)
    made = plans(MCX514, model)
    return {
        "task": task(model, PCL240K, {"axis": "x", "pulses": 600, "payload": 1.0}), "loads": loads(model, PCL240K)["x"],
        "plans": {k: made[k] for k in ("formula", "some linear", "cycles 400", "cycles -300")},
        "looks": [looked_at(task_of(model=model)), looked_at(task_of(model=model, judge_at="work"))],
    }  # fmt: skip


def looked_at(made):
    """Where moves begin and lead, and a look beyond and before the goal."""
    looks, stage = Looks(made), made.copy()
    goals = np.stack([looks.begin(stage, case) for case in CASES[:2]])
    seen = np.zeros((2, 2, looks.each), np.int64)
    seen[:, :, 1:] = np.round((goals[:, None, 0] + np.array([[[0.01], [-0.02]]]) * goals[:, None, 1]) * 1e12)
    return [goals, looks.errors(seen.reshape(2, -1), goals)]


def of(scene, *given, **named):
    """A scene without parameters."""
    return lambda: scene(*given, **named)


FILES = {
    "tune": {
        **{f"task {name}": of(task, *how) for name, how in TASKS.items()}, "no tasks": no_tasks,
        **{f"loads {model} {chip.__name__}": of(loads, model, chip) for model, chip in (
            ("xyz", PCL240K), ("xyz_servo", HCTL1100), ("xy_mast", MCX514), ("xya", PCL240K), ("gantry", PCL240K))},
        **{f"plans {chip.__name__}": of(plans, chip) for chip in (PCL240K, PCL240MS, MCX514, MCX304, MCX312)},
        "plans HCTL1100": of(plans, HCTL1100, "xyz_servo"), "plans upright": of(plans, PCL240K, "xyz", "z", payload_on="work"),
        "tried PCL240K": of(tried, PCL240K),
        "tried HCTL1100": of(tried, HCTL1100, "xyz_servo", pulses=200),
        "tried camera": of(tried, PCL240MS, "xy_mast", judge_at="camera"),
        "turned": turned, **{f"tuned {name}": of(found_of, how, **more) for name, (how, more) in TUNED.items()},
        "drawn": of(drawn, {}), "drawn servo": of(drawn, {"chip": HCTL1100, "model": "xyz_servo", "pulses": 300}, True),
        "written": written,
    },
}  # fmt: skip
