"""Objectives of studies without Optuna: what registers take, what trials are asked and told, and what moves measure."""

from types import SimpleNamespace
from unittest.mock import patch

from support.mirrored import mirrored

from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.errors import StageError
from stage.study import PresetMoves, objectives, runner, seed_of
from stage.study.objectives import SPACE, check_registers, profile_of, suggest, values_of

FINE = {"R1": 20, "R2": 640, "R4": 400, "R5": 300, "R7": 12}
TEXTS = [
    12,
    "12",
    "0",
    "10,20,40",
    "10,",
    "4:100",
    "4:4",
    "0:4",
    "5:4",
    "4:100:log",
    "0:9:log",
    "1:1:log",
    "1:9:lin",
    "1:2:3:log",
    "-1",
    "-1:4",
    "1,-1",
    "",
    "a",
    "1.5",
    " 3 , 4 ",
    "1:2:",
    -5,
    True,
    "9:log",
]


def raised(function, *given, **named):
    try:
        return function(*given, **named)
    except StageError as error:
        return f"{type(error).__name__}: {error}"


class Trial:
    """Takes the highest that it may, notes what it is asked and told; to be pruned after so many reports."""

    def __init__(self, number=3, pruned=99):
        self.number, self.pruned, self.said = number, pruned, []

    def suggest_int(self, name, low, high, log=False):
        self.said.append(["int", name, low, high, log])
        return high

    def suggest_categorical(self, name, values):
        self.said.append(["one", name, values])
        return values[-1]

    def set_user_attr(self, name, value):
        self.said.append(["attribute", name, value])

    def report(self, value, step):
        self.said.append(["report", value, step])

    def should_prune(self):
        self.pruned -= 1
        return self.pruned < 0


def texts():
    found = {str(text): raised(values_of, "R9", text) for text in TEXTS}
    trial = Trial()
    found["suggested"] = [suggest(trial, {**SPACE, "R3": "5,6", "R14": "7"}), trial.said]
    found["seeds"] = [[seed_of(SimpleNamespace(number=n), seed) for n in (0, 1, 7)] for seed in (0, 1)]
    every = {
        "fine": FINE,
        "R3 too": FINE | {"R3": 7},
        "spans": FINE | {"R14": 5},
        "both spans": FINE | {"R15": 6, "R14": 0},
        "lacks": {"R1": 1, "R7": 2},
        "unknown": FINE | {"R6": 4},
        "none": {},
        "illegal": FINE | {"R2": 9000},
        "slower": FINE | {"R1": 700},
    }
    for chip in (PCL240K, PCL240MK, PCL240MS):
        for name, registers in every.items():
            found[f"{chip.__name__} {name}"] = [
                raised(check_registers, registers, chip),
                str(raised(profile_of, registers, chip)),
            ]
    return found


OPTIONS = [
    {},
    {"goals": ("speed",)},
    {"goals": ()},
    {"goals": ("duration", "vibration", "lost_steps", "reached")},
    {"chips": "mcx514"},
    {"chips": "no"},
    {"axis": "q"},
    {"model": "none"},
    {"space": {**SPACE, "R6": 4}},
    {"space": {"R1": 4}},
    {"space": {**SPACE, "R7": "a"}},
    {"chips": "pcl240ms", "space": {**SPACE, "R14": "0:50"}},
    {"space": {**SPACE, "R14": "0:50"}},
]


def options():
    made = {str(how): raised(PresetMoves, **{"model": "xy", **how}) for how in OPTIONS}
    found = {
        how: m if isinstance(m, str) else [repr(m), m._chip.__name__, runner.goals_of(m)] for how, m in made.items()
    }
    with patch.object(runner.metadata, "version", lambda name: f"{name} 1"):
        found["definition"] = [
            runner.definition(PresetMoves(model="xy", goals=("duration",))),
            runner.definition(texts),
            runner.definition(Trial()),
        ]
    found["usual"] = repr(PresetMoves())
    return found


MOVES = {
    "usual": ({"pulses": 300}, FINE),
    "several": ({"pulses": (300, -200, 80), "axis": "y", "start": 0.02}, FINE),
    "narrow band": ({"pulses": 300, "band": 5e-6, "start": 0.01}, FINE),
    "short rest": ({"pulses": 300, "band": 5e-6, "rest": 0.004}, FINE),
    "too fast": ({"pulses": (900, -900)}, FINE | {"R1": 2000, "R2": 8000, "R4": 2, "R5": 2}),
    "S-curves": ({"pulses": 300, "chips": "pcl240ms"}, FINE | {"R14": 100, "R15": 50}),
    "mast": ({"model": "xy_mast", "pulses": 300, "chips": "pcl240mk", "start": -0.05}, FINE),
    "into the end": ({"pulses": -800, "start": -0.149}, FINE),
    "illegal": ({"pulses": 300}, FINE | {"R2": 9000}),
}


def measured(how, registers):
    objective, heard = PresetMoves(**{"model": "xy", "start": -0.01, "rest": 0.05, **how}), []
    said = [raised(objective.measure, registers, seed, lambda k, so_far: heard.append([k, so_far])) for seed in (1, 2)]
    return [said, heard, objective._chip.__name__]


def trials(folder):
    """What a study's trials are asked and told, of one goal and of several, and with a screw that turns the other way."""
    space, found = {**FINE, "R4": "400,500"}, {}
    for name, how in {
        "one goal": {},
        "duration": {"goals": ("duration",), "seed": 4},
        "several": {"goals": ("vibration", "score")},
        "turned": {"model": mirrored(folder)},
    }.items():
        trial = Trial()
        value = PresetMoves(
            **{"space": space, "model": "xy", "start": -0.01, "rest": 0.03, "pulses": (200, -300, 50), **how}
        )(trial)
        found[name] = [value, trial.said]
    return found


def one_stage():
    """Of a thread: the same for the same model and chip, and its power-up."""
    made = [
        objectives._stage(*which)
        for which in (("xy", PCL240K), ("xy", PCL240MS), ("xy", PCL240K), ("xy_mast", PCL240K))
    ]
    return [
        made[0][0] is made[2][0],
        made[0][1] is made[2][1],
        made[0][0] is made[1][0],
        made[0][0] is made[3][0],
        type(made[1][0].axes["x"].chip).__name__,
    ]


def of(scene, *given, **named):
    """A scene without parameters."""
    return lambda: scene(*given, **named)


FILES = {
    "study": {
        "texts": texts,
        "options": options,
        **{f"measured {name}": of(measured, *how) for name, how in MOVES.items()},
        "trials": trials,
        "one stage": one_stage,
    },
}
