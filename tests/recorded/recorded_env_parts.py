"""What environments are made of, piece by piece: settings and their kinds, registers as actions, hidden machines and faults, books
of macros, layouts, frames, recordings, results, snapshots; and episodes in which no setting is the usual one."""

import dataclasses
import itertools
import re
import time
from importlib import import_module
from types import SimpleNamespace
from unittest.mock import patch

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from recorded import recorded_envs, recorded_machines
from recorded.player import Draw
from recorded.recorded_envs import action, bus_actions, sums, told
from recorded.store import digits
from support.mirrored import mirrored

import stage.envs
from stage import Stage, chips
from stage.envs import contexts, faulty, macros, rendering, results, score, settings, trial
from stage.envs.base import info_of
from stage.envs.registers import RegisterBox
from stage.envs.task import carrier, checked, judged
from stage.envs.tuning import given
from stage.errors import StageError
from stage.firmware.driver import driver_of
from stage.sim.program import Program

SHORT = {f"stage/{name}-v0": how for name, how in recorded_envs.SHORT.items()}
SHORT |= {f"stage/{name}-v1": how for name, how in recorded_machines.SHORT.items()}


def of(scene, *given, **named):
    """A scene without parameters."""
    return lambda: scene(*given, **named)


def raised(function, *given, **named):
    try:
        return function(*given, **named)
    except (StageError, TypeError) as error:
        return f"{type(error).__name__}: {error}"


def task_of(id_):
    module, name = stage.envs.IDS[id_].split(":")
    return getattr(import_module(f"stage.envs.{module}"), name)


def make(id_, **more):
    return gymnasium.make(id_, disable_env_checker=True, **SHORT[id_] | more).unwrapped


def vector_of(id_, n, **more):
    return gymnasium.make_vec(id_, n, vectorization_mode="vector_entry_point", threads=1, **SHORT[id_] | more).unwrapped


def defaults():
    found = {}
    for id_ in stage.envs.IDS:
        task = task_of(id_)
        made = task.Config()
        found[id_] = {
            **{f.name: getattr(made, f.name) for f in dataclasses.fields(made)},
            "options": task.OPTIONS,
            "state": task.STATE,
            "restarts": task.RESTARTS,
            "faults": getattr(task.Config, "FAULTS", None),
        }
    return found


KINDS = {
    "number": settings.Number(),
    "above": settings.Number(2.0, True, 5.0),
    "from": settings.Number(-1.0, False, 5.0, True),
    "range": settings.Range(1.0, high=9.0),
    "whole range": settings.Range(0.0, True, 9.0, True, ", and so on"),
    "number or range": settings.NumberOrRange(0.5, more=", not too fast"),
    "each": settings.Each(1, whole=True, high=4),
    "word": settings.Word(("a", "bc")),
    "words": settings.Words(("a", "bc")),
    "truth": settings.Truth(),
    "name": settings.Name(),
    "one name": settings.Names(1),
    "two names": settings.Names(2),
}
VALUES = (
    0,
    -1,
    -1.5,
    1,
    2,
    2.0000001,
    4,
    4.5,
    5,
    5.0000001,
    9,
    9.5,
    1e9,
    2e9,
    True,
    np.True_,
    float("nan"),
    float("inf"),
    np.int64(3),
    1j,
    None,
    "",
    "a",
    "bc",
    "ab",
    "aa",
    b"a",
    (),
    [],
    (1, 2),
    [2, 1],
    (2, 2),
    (1, 2, 3),
    (0, 9),
    (1, 9.5),
    (0.5, 9),
    ("a",),
    ["a", "bc"],
    ("a", "a"),
    ("a", 1),
    ("z",),
    {"a"},
    {"a": 1, "b": 2},
    np.array([1, 2]),
    np.array([]),
)


def kinds():
    def said(kind, value):
        return (raised(kind.check, "it", value) or "taken").replace(repr(value), "VALUE")

    found = {name: [said(kind, value) for value in VALUES] for name, kind in KINDS.items()}
    found["allowed"] = [kind.allowed for kind in KINDS.values() if hasattr(kind, "allowed")]
    wrong = {
        "stage/RegisterTuning-v0": [
            {"s_curve": 1},
            {"truth": "all"},
            {"truth": 1},
            {"payload_on": 3},
            {"limit": None},
            {"bus_cycle": 1.0},
        ],
        "stage/RegisterBus-v0": [
            {"waits": (0.6,)},
            {"tolerance": 400},
            {"distances": (4, 9)},
            {"distances": (5, 9)},
            {"axes": "x"},
        ],
        "stage/ServoTuning-v0": [{"rest": 0.2}, {"rest": 9e-4, "limit": 1.0}, {"rest": 1e-3}],
        "stage/SynchronizedMove-v0": [
            {"rate": (900.0, 2000.0)},
            {"rate": 1000.0, "fl": 1000.0},
            {"rate": (4e3, 2e3)},
            {"fl": 0},
        ],
        "stage/FewShotTuning-v1": [
            {"faults": ()},
            {"faults": ("jam",)},
            {"faults": ("rust",)},
            {"split": "west"},
            {"proofs": 65},
        ],
        "stage/OneShotTuning-v1": [{"tries": 2}, {"error": 0.91}, {"memory": "none"}],
        "stage/SynchronizedLine-v1": [{"moves": 2}, {"actions": "box"}, {"ramps": (0.0, 0.1)}, {"ramps": (1e-3, 1.1)}],
        "stage/DriftingHome-v1": [
            {"walk": 2e-3},
            {"bounces": (0.0, 0.2)},
            {"faults": ("sag",)},
            {"healthy": 1.1},
            {"reach": 1e-4},
        ],
        "stage/BusMacros-v1": [
            {"grid": (64, 16)},
            {"grid": (8, 16)},
            {"grid": (9, 9)},
            {"grid": 9},
            {"axes": ()},
            {"level": "up"},
        ],
    }
    for id_, some in wrong.items():
        found[id_] = {str(how): re.sub(r" object at 0x\w+", "", str(raised(make, id_, **how))) for how in some}
    return found


def boxes():
    found = {}
    for chip in ("PCL240K", "PCL240MS", "MCX514", "MCX304", "MCX312"):
        axis = Stage("xy", chips=chips.chip_class(chip), visuals=False).axes["x"]
        driver = driver_of(axis)
        for curved in (False, True):
            names = raised(driver.tuned_by, curved)
            if isinstance(names, str):
                found[f"{chip} {curved}"] = names
                continue
            box = RegisterBox(axis.chip.MAP, names)
            at = np.array([-2.0, -1.0, -0.6, -0.01, 0.0, 0.3, 0.999, 1.0, 3.0])
            rows = box.from_action(np.repeat(at[:, None], len(box), axis=1))
            found[f"{chip} {curved}"] = [
                box.names,
                box.low,
                box.high,
                rows,
                box.to_action(rows),
                box.named(rows[4]),
                str(box.discrete),
                str(box.box),
            ]
            found[f"{chip} {curved} wrong"] = [
                raised(box.to_action, box.low - 1),
                raised(box.to_action, dict(zip(names, box.high + 1, strict=True))),
            ]
    own = RegisterBox.of(
        {"a": (0, 4), "b": (0, 4), "c": (1, 4), "d": (0, 1 << 17), "e": (0, 1 << 16), "f": (-3, 3)}, ("b",)
    )
    rows = own.from_action(np.linspace(-1, 1, 9)[:, None] * np.ones(6))
    return found | {
        "own": [
            rows,
            own.to_action(rows),
            own.to_action({k: 2 for k in own.names}),
            len(own),
            own.from_action(np.zeros(6)),
        ]
    }


def drawn():
    """Contexts by seeds, of every split, and the faults of them."""
    found = {
        "splits": contexts.SPLITS,
        "kinds": contexts.KINDS,
        "faults": faulty.FAULTS,
        "entries": [*contexts.ENTRIES, *contexts.SHOWN],
    }
    few, home, bus = "stage/FewShotTuning-v1", "stage/DriftingHome-v1", "stage/BusMacros-v1"
    every = [(split, few) for split in contexts.SPLITS] + [
        (split, id_) for split in ("train", "faults") for id_ in (home, bus)
    ]
    for split, id_ in every:
        envs = vector_of(id_, 3, split=split, model="xy", truth=True, **({"level": "axes"} if "Bus" in id_ else {}))
        envs.reset(seed=5)
        task = envs._task
        found[f"{split} {id_}"] = [
            task.context.tolist(),
            task.faults,
            sums(task.placed),
            type(task.axis.chip).__name__ if hasattr(task, "axis") else "",
            [s.payload(task.machines[0].carrier) for s in task.stages],
        ]
        envs.close()
    for healthy, axes in ((0.0, 1), (0.5, 2), (1.0, 3), (0.2, 1)):
        context, rng, seen = np.zeros((), contexts.CONTEXT), np.random.default_rng(3), []
        for _ in range(8):
            faulty.draw(rng, faulty.HAMPERING, healthy, axes, context)
            seen.append([int(context["fault"]), int(context["faulty"])])
        faulty.draw(rng, (), healthy, axes, context)
        found[f"faults {healthy} {axes}"] = [*seen, int(context["fault"])]
    found["overload"] = [faulty.overload(k) for k in range(len(faulty.NAMES))]
    ends = {"payload": (1.0, 3.0), "friction": (0.5, 2.0), "switch": (0.0, 1.0), "drift": (0.1, 0.1)}
    context = np.zeros(3, contexts.CONTEXT)
    rng = np.random.default_rng(1)
    for row, asked in zip(context, ({}, {"payload": 3, "switch": 0}, {"friction": np.float32(0.5)}), strict=True):
        contexts.draw(rng, ends, row, asked)
    found["given"] = [context.tolist(), contexts.placed(ends, context)]
    found["wrong"] = [
        raised(contexts.draw, rng, ends, context[0], {name: value})
        for name, value in (("payload", 0.99), ("payload", 3.01), ("friction", "1"), ("switch", True), ("drift", None))
    ]
    return found


def mechanics(stage_):
    model, state = stage_.model, stage_.state
    return [
        model.body_mass,
        model.dof_frictionloss,
        model.dof_damping,
        model.dof_solref,
        model.dof_solimp,
        model.geom_pos.sum(axis=1),
        [
            [
                a.supply,
                a.open_phases,
                float(state.drives[a.index].torque_constant),
                float(state.drives[a.index].voltage),
            ]
            for a in stage_.axes.values()
        ],
        state.switch_table["forced"],
        state.switch_table["bounce"],
        state.switch_table["toggles"],
    ]


def broken(folder):
    """A machine with each fault after the other, as its axis is then; and on a screw that turns the other way."""
    found = {}
    for model in ("xy", mirrored(folder)):
        made = Stage(model, visuals=False)
        y = made.axes["y"]
        y.open_phases, y.supply = 2, 30.0
        context = np.zeros((), contexts.CONTEXT)
        for name, value in (("payload", 2.0), ("friction", 1.5), ("supply", 0.8), ("torque", 0.9)):
            context[name] = value
        machine, parts = contexts.Machine.of(made, "y", "y"), faulty.Faulty.of(made, "y")
        for k, name in enumerate((*faulty.NAMES, "sag", "jam", "none")):
            machine.equip(made, context, 0.25 * k)
            parts.put(made, name, 3e-3 if k % 2 else 0.0)
            found[f"{len(model)} {k} {name}" if model == "xy" else f"turned {k} {name}"] = mechanics(made)
    return found


def books():
    found = {}
    for chip, axes in (("PCL240K", "xy"), ("MCX514", "y"), ("MCX304", "yx"), ("PCL240MS", "x")):
        made = Stage("xy", chips=chips.chip_class(chip), visuals=False)
        book = macros.Book([made.axes[name] for name in axes], (16, 64, 300), 0.5, 0.03)
        written = np.zeros(1, [("rates", int), ("distance", int)])
        pages = {}
        for axis in range(len(axes)):
            for macro, name in enumerate(book.names):
                for rates, distance in ((0, 0), (2, 1), (1, 2)):
                    written["rates"], written["distance"] = rates, distance
                    ops = book.programs(np.array([macro]), np.array([axis]), written, np.array([True]))[0]
                    pages.setdefault(f"{axes[axis]} {name}", []).append(digits(repr(ops.tolist())) + f" {len(ops)}")
        both = np.array([0, len(book.names) - 1])
        rows = book.programs(both, np.zeros(2, int), np.repeat(written, 2), np.array([False, True]))
        found[f"{chip} {axes}"] = [
            book.names,
            book.per,
            book.value,
            {k: v.astype(int) for k, v in book.of_kind.items()},
            pages,
            rows.shape,
            rows.sum(),
        ]
    return found


def layouts():
    found = {}
    for id_, truth in itertools.product(stage.envs.IDS, (True, False)):
        env = make(id_, truth=truth)
        _, info = env.reset(seed=1)
        names = [e.name for e in env.entries]
        runs = [[name, len(list(some))] for name, some in itertools.groupby(names)]
        found[f"{id_} {truth}"] = [runs, env.observation_space.shape, sorted(info), [[e.name, e.who] for e in env.told]]
        if truth is False:
            step = env.step(env.action_space.sample() * 0)
            found[f"{id_} {truth}"].append(sorted(step[4]))
        if truth is True:
            parts = [part for part in env.header.parts if part[0].startswith(("setting", "environment", "stages"))]
            found[f"{id_} header"] = str(parts)
        env.close()
    return found


def points():
    """Where payloads ride and moves are judged, asked for by all names of models and some that are none."""
    found = {}
    for model, axes in (("xyz", "xyz"), ("xy_mast", "xy"), ("xya", "a"), ("gantry", "xw")):
        made = Stage(model, visuals=False)
        names = [made.model.body(k).name for k in range(1, made.model.nbody)] + [
            made.model.site(k).name for k in range(made.model.nsite)
        ]
        for axis in axes:
            for what in (carrier, judged):
                found[f"{model} {axis} {what.__name__}"] = {
                    str(name): raised(what, made, axis, name) for name in (None, *names, "nobody")
                }
    return found


def places(folder):
    """Where moves begin, what fits, and what a chip makes of programs by itself."""
    found = {
        "closed form": [
            trial.closed_form(np.array([10.0, 400.0, 9000.0]), s, d, r)
            for s, d, r in ((0.0, 1e3, 0.1), (1e3, 16e3, 0.15))
        ]
    }
    for model, chip in (("xy", "PCL240K"), (mirrored(folder), "MCX514"), ("xyz_servo", "HCTL1100")):
        axis = Stage(model, chips=chips.chip_class(chip), visuals=False).axes["x"]
        starts = trial.Starts(axis)
        room = int(0.95 * (axis.travel[1] - axis.travel[0]) / axis.meters_per_pulse)
        found[chip] = [
            starts.middle,
            starts.turn,
            [starts.begin(d, a) for d, a in ((400, 0.0), (400, 0.5), (-900, 0.25), (401, 1.0))],
            [raised(starts.check, (1, room + more), "counts") for more in (-1, 0, 1)],
        ]
        if axis.chip.SERVO:
            continue
        move = trial.Trial(axis, 2, 0.03, encoder=True)
        plain = trial.Trial(axis, 0, 0.03)
        values = move.driver.formula(1000.0, 8000.0, 0.05, 0.05, 500, s_curve=False)
        made = [t.program(values, 500, 0.2, keep_step=keep) for t, keep in ((move, False), (plain, True))]
        found[f"{chip} programs"] = [[p.ops for p in made], move.stop, move.rest, plain.stop, plain.rest]
        found[f"{chip} hopeless"] = [
            plain.is_hopeless(made[1], d, limit) for d, limit in ((500, 0.2), (499, 0.2), (500, 0.05), (-500, 0.2))
        ]
        found[f"{chip} foreseen"] = [
            plain.foresight.pulses(np.array(Program().ops or np.zeros((1, 4), int), np.int64), 0.1)
        ]
    return found


def outcomes():
    """What `Trial.seen` makes of results, of all signs and at the ends of what it allows."""
    made = Stage("xy", visuals=False)
    found = {}
    for point, encoder in ((0, False), (2, False), (0, True), (3, True)):
        move = trial.Trial(made.axes["y"], point, 0.03, encoder=encoder)
        p = move.program(move.driver.formula(1000.0, 8000.0, 0.05, 0.05, 500, s_curve=False), 500, 0.2)
        n = 8
        results_ = np.zeros((n, len(p)), np.int64)
        results_[:, move.stop] = np.array([9, 9, -9, 0, 9, 9, 9, 9]) * 10**6
        results_[:, move.rest] = np.arange(n) * 10**7
        results_[:, 0], results_[:, -1] = (5, 5, 5, 5, 5, 5, -7, -7), np.array([5, 5, 5, 5, 0, 7, -9, -2]) * 10**8
        extremes = np.zeros((n, made.model.nq, 2))
        extremes[:, :, 0], extremes[:, :, 1] = -1e-5 * np.arange(n)[:, None], 2e-5
        extremes[3] = np.inf, -np.inf
        truth = np.zeros(n, [("pulses", int), ("lost_steps", int), ("commanded", float), ("position", float)])
        truth["pulses"] = (500, 499, 500, 500, 500, 500, 500, -500)
        truth["lost_steps"] = (0, 0, 0, 0, 1, -1, 0, 0)
        truth["position"] = (0, 0, 0, 0, 0, 0, 49e-6, -51e-6)
        seen = move.seen(SimpleNamespace(results=results_, extremes=extremes), truth, np.full(n, 500), 5e-6)
        found[f"{point} {encoder}"] = [*seen, seen.kept]
    return found


class Watcher:
    """In place of a screen or GL: says what it is shown."""

    def __init__(self, said, stage_, *how):
        self.said, self.stage = said, stage_
        said.append(["opened", *how])

    def frame(self, qpos=None):
        shown = self.stage.data.qpos if qpos is None else qpos
        self.said.append([qpos is None, sums(shown)])
        return float(np.sum(shown))

    def close(self):
        self.said.append("closed")


def frames(id_, mode, **more):
    said = []
    with (
        patch.object(rendering, "viewer", lambda stage_, *how: Watcher(said, stage_, *how)),
        patch.object(time, "sleep", lambda seconds: said.append(["slept", seconds])),
    ):
        env = make(id_, render_mode=mode, **more)
        d = Draw("frames")
        said.append([env.metadata, raised(env.render)])
        for _ in range(2):
            env.reset(seed=4)
            said.append(["reset", env.render()])
            steps = (action(env.action_space, d) for _ in range(2)) if env.action_space.shape else (4, 7)
            steps = bus_actions(env, d) if "RegisterBus" in id_ else steps
            for a in itertools.islice(steps, 17 if "RegisterBus" in id_ else 2):
                over = env.step(np.asarray(a, env.action_space.dtype))[2:4]
                said.append(env.render() if len(said) % 3 else "not fetched")
                if any(over):
                    break
        env.close()
        env.close()
        said.append(env.stage.recording is None)
    return said


class Recorded:
    """In place of a recording: notes when it ends, and where it is to be."""

    def __init__(self, said, *how):
        self.said, self.pieces = said, lambda begin: []
        said.append(["begins", *how])

    def close(self):
        self.said.append("ends")

    def save(self, path):
        self.said.append(path.name)
        path.write_text("")


def recordings(folder, id_):
    said = []
    restore = Stage.restore
    with (
        patch.object(Stage, "record", lambda stage_, *how, **more: Recorded(said, *how)),
        patch.object(Stage, "restore", lambda stage_, kept: (said.append("restored"), restore(stage_, kept))[1]),
    ):
        env = make(id_, record=str(folder / "in" / "of {} {}.rrd"))
        for _ in range(2):
            env.reset(seed=4)
            for _ in range(2):
                said.append("step")
                if any(env.step(np.zeros(env.action_space.shape, env.action_space.dtype))[2:4]):
                    break
        env.close()
        env.close()
    return [said, sorted(str(p.relative_to(folder)) for p in folder.rglob("*.rrd"))]


def columns():
    """Rows and columns of results, of stages that go on, end, diverge and are not there."""
    kind = results.result(("gain", "cost"), scored=True, here=bool, many=(int, (2,)), far=float)
    made = results.Results(5, kind, frozenset({"here", "score"}))
    whole = results.Results(5, kind)
    for r in (made, whole):
        r["info"]["here"], r["info"]["many"], r["info"]["far"] = True, np.arange(10).reshape(5, 2), np.arange(5) / 4
        r["parts"]["gain"], r["parts"]["cost"] = (1.0, 2.0, np.nan, 4.0, 5.0), (-0.5, 0.0, 1.0, -1.0, 0.25)
        r["terminated"], r["truncated"] = (True, False, True, False, False), (False, True, False, False, False)
        score.note(
            r["score"], np.array([1.0, np.inf, 2.0, 0.5, 3.0]), np.array([2.0, 1.0, 2.0, 2.0, 2.0]), 7, np.arange(5), 1
        )
        r.end(np.array([False, False, True, False, True]))
    active = np.array([True, True, True, True, False])
    return {
        "rows": [whole.row(k) for k in range(5)],
        "hidden": [made.row(k)[3] for k in (0, 2)],
        "columns": whole.columns(active),
        "some": whole.columns(np.array([False, False, False, True, False])),
        "hidden columns": sorted(made.columns(active)),
        "one": [info_of(whole.columns(active), k) for k in (0, 2)],
        "reward": whole["reward"],
        "scored": [made.scored, whole.scored],
    }


def faces():
    """What the scalar and the vector face refuse, and what they say of themselves."""
    id_ = "stage/RegisterTuning-v0"
    alone = [
        {"render_mode": "none"},
        {"render_every": 0},
        {"render_every": 9e-5},
        {"render_every": 1e-4},
        {"render_every": 1001},
        {"render_every": "1"},
        {"render_every": 3.0},
        {"render_every": 0.04},
        {"camera": 3},
        {"render": 1},
        {"threads": 2},
        {"num_envs": 2},
    ]
    many = [
        {"num_envs": 0},
        {"num_envs": 1.5},
        {"num_envs": 2.0},
        {"render_mode": "human"},
        {"camera": "overview"},
        {"record": "a"},
        {"threads": 0},
        {"threads": 1.5},
        {"autoreset_mode": "SameStep"},
        {"autoreset_mode": AutoresetMode.DISABLED},
        {"move": 3},
    ]
    found = {}
    module = import_module("stage.envs.register_tuning")
    for how in alone:
        env = raised(module.RegisterTuningEnv, **SHORT[id_] | how)
        found[f"alone {how}"] = (
            env if isinstance(env, str) else [env.metadata, env.render_mode, env.config.moves, env.unwrapped is env]
        )
    for how in many:
        envs = raised(module.RegisterTuningVectorEnv, **SHORT[id_] | how)
        found[f"many {how}"] = (
            envs
            if isinstance(envs, str)
            else [
                envs.num_envs,
                envs.metadata,
                envs.render_mode,
                str(envs.action_space),
                envs.observation_space.shape,
                len(envs.stages),
            ]
        )
    env, envs = make(id_), vector_of(id_, 2)
    found["before"] = [
        raised(env.step, env.action_space.low),
        raised(env.snapshot),
        raised(env.scripted),
        raised(envs.snapshot),
        raised(envs.scripted),
    ]
    found["reset"] = [
        raised(env.reset, options=given) for given in ({"distances": 1}, [1], "a", {"reset_mask": np.ones(1, bool)})
    ]
    env.reset(seed=2)
    state = env.__getstate__()
    found["kept"] = [state["_viewer"], state["_recording"], env.np_random_seed]
    few = make("stage/FewShotTuning-v1", tries=1)
    few.reset(seed=1)
    few.step(few.scripted())
    found["over"] = raised(few.step, few.scripted())
    for kind in (faulty.Faulty, contexts.Machine):
        found[kind.__name__] = [f.name for f in dataclasses.fields(kind)]
    return found


TRIED = [
    0,
    1,
    5,
    6,
    -1,
    2.0,
    0.5,
    True,
    None,
    "a",
    [0, 0],
    [1, 2],
    [4, 6],
    [4, 7],
    [5, 6],
    [1, 1],
    [-1, 2],
    [0.5, 0.5],
    [1, float("nan")],
    [1.5, 0],
    [2**40, 0],
    np.array([0.25, -1.0]),
    np.array([0.25, -1.0], np.float64),
    np.array([1, 0], np.uint8),
    np.array([1, 0], bool),
    np.zeros((1, 2)),
    np.array([1j, 0]),
    np.array(3),
    np.array([3]),
    np.int8(2),
    np.float32(2),
    [[1, 2]],
    {"a": 1},
    [10**400, 0],
]


def asked():
    """Which actions a space takes, and as what."""
    found = {}
    spaces = (
        gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32),
        gymnasium.spaces.MultiDiscrete([4, 5], start=[1, 2]),
        gymnasium.spaces.Discrete(6),
    )
    for space in spaces:
        said = []
        for value in TRIED:
            made = raised(checked, space, value)
            said.append([made, made.dtype.str] if isinstance(made, np.ndarray) else "refused")
        said.append(raised(checked, space, "up"))
        found[str(space)] = said
    return found


GIVEN = [
    ("a", 1.5),
    ("a", 0),
    ("a", True),
    ("a", "1"),
    ("a", 3.0),
    ("a", 3.01),
    ("b", 9.0),
    ("a", np.float32(2.5)),
    ("a", None),
]


def options():
    return [raised(given, {name: value}, "a", 1.25, (0.5, 3.0)) for name, value in GIVEN]


def modes(id_, mode):
    """Vectors over the ends of episodes, with masks, options and seeds of their own."""
    envs = vector_of(
        id_,
        3,
        autoreset_mode=mode,
        **({"macros": 2} if "Bus" in id_ else {"returns": 2, "limit": 0.1} if "Home" in id_ else {}),
    )
    d, said = Draw(id_), []
    first = envs.reset(seed=[7, 3, 9], options={"payload": 1.25})
    said.append([sums(first[0]), {k: v for k, v in first[1].items() if k in ("payload", "_payload", "context")}])
    for _ in range(3):
        actions = np.stack(
            [np.asarray(action(envs.single_action_space, d)) if envs.single_action_space.shape else 0 for _ in range(3)]
        )
        if not envs.single_action_space.shape:
            actions = np.array([d.of(*np.flatnonzero(mask).tolist()) for mask in envs.action_masks()])
        seen, reward, ended, cut, info = envs.step(actions)
        ends = ended | cut
        final = (
            [[sums(info["final_obs"][k]), sorted(info_of(info, k)["final_info"])] for k in np.flatnonzero(ends)]
            if "final_obs" in info
            else []
        )
        said.append([sums(seen), reward, ended, cut, final, [sorted(info_of(info, k)) for k in range(3)]])
        if mode is AutoresetMode.DISABLED and ends.any():
            said.append(raised(envs.step, actions))
            said.append(sums(envs.reset(seed=50, options={"reset_mask": ends, "payload": 0.5})[0]))
    for mask in (np.zeros(3, bool), np.ones(2, bool), [True] * 3, np.ones(3, int)):
        said.append(raised(envs.reset, options={"reset_mask": mask}))
    for seed in ([1, 2], [1, 2, "a"], 1.5, "7", [1, None, np.int64(4)]):
        said.append(
            str(raised(envs.reset, seed=seed))[:80]
            if not isinstance(seed, list) or len(seed) < 3 or "a" in seed
            else "taken"
        )
    said += [raised(envs.reset, options={"nothing": 1}), raised(envs.reset, options=[1]), raised(envs.restore, 3)]
    kept, at = envs.snapshot(), envs._over.copy()
    if not at.any():
        one = str(told(envs.step(actions)))
        envs.restore(kept)
        again = told(envs.step(actions))
        said.append([one == str(again), again[1]])
    envs.close()
    return said


OTHER = {
    "stage/RegisterTuning-v0": [
        (
            {
                "chip": "MCX302",
                "axis": "y",
                "early_ends": True,
                "bus_cycle": 2e-5,
                "truth": "info",
                "settle": 0.004,
                "judge_at": "work",
                "vibration_weight": 2.0,
                "limit_weight": 3.0,
                "lost_weight": 4.0,
                "payloads": (5.0, 30.0),
                "distances": (700, 3000),
            },
            {"angle": 0.75},
        ),
        (
            {"model": "xy_mast", "chip": "PCL240MK", "settle": 0.05, "moves": 2, "truth": False, "limit": 0.15},
            {"payload": 1.0},
        ),
        ({"early_ends": True, "limit": 0.06, "payloads": (20.0, 40.0), "moves": 2}, {}),
    ],
    "stage/RegisterBus-v0": [
        (
            {
                "axes": ("y",),
                "tolerance": 25.0,
                "standing": 0.05,
                "progress_weight": 2.0,
                "time_weight": 3.0,
                "success_weight": 1.5,
                "waits": (0.05,),
                "discount": 0.5,
                "cycles": 22,
                "truth": True,
            },
            {"target": {"y": 90}, "start": {"y": 0.01}},
        ),
        (
            {
                "goal": "home",
                "chip": "MCX304",
                "progress_weight": 4.0,
                "time_weight": 0.3,
                "lost_weight": 0.5,
                "time_limit": 0.2,
            },
            {"start": {"x": -0.1, "y": 0.02}},
        ),
    ],
    "stage/OriginReturn-v0": [
        (
            {
                "time_weight": 2.0,
                "error_weight": 0.5,
                "spread_weight": 3.0,
                "missed_weight": 4.0,
                "limit_weight": 5.0,
                "lost_weight": 6.0,
                "multiplier": 20,
                "back_off": 500,
                "settle": 0.02,
                "payloads": (1.0, 2.0),
                "payload_on": "y",
                "bus_cycle": 3e-5,
                "drift": 4e-4,
                "truth": "info",
                "limit": 1.0,
            },
            {"start": 2e-3},
        ),
        (
            {"chip": "MCX312", "ez": 1, "axis": "y", "limit": 0.8, "returns": 3, "actions": "registers"},
            {"start": -0.0695, "friction": 1.25},
        ),
    ],
    "stage/SynchronizedMove-v0": [
        (
            {
                "axes": ("y", "x"),
                "reach": 9.0,
                "multiplier_reach": 6,
                "fl": 1500.0,
                "accel": 0.02,
                "settle": 0.01,
                "looks": 7,
                "far": 3.0,
                "moves": 2,
                "path_weight": 2.0,
                "carriage_weight": 3.0,
                "time_weight": 4.0,
                "lost_weight": 5.0,
                "limit_weight": 6.0,
                "bus_cycle": 2e-5,
                "truth": "info",
            },
            {"rate": 7000, "distances": {"x": -500, "y": 800}},
        ),
        (
            {
                "chip": "MCX312",
                "actions": "registers",
                "limit": 0.05,
                "limit_weight": 2.5,
                "lost_weight": 1.5,
                "moves": 2,
            },
            {},
        ),
        ({"chip": "MCX304", "actions": "box", "looks": 5, "rate": 4500.0}, {}),
    ],
    "stage/ServoTuning-v0": [
        (
            {
                "motion": "trapezoid",
                "velocity": 30_000.0,
                "acceleration": 200_000.0,
                "deadband": 8.0,
                "overshoot_weight": 2.0,
                "unrest_weight": 3.0,
                "limit_weight": 4.0,
                "distances": (300, 900),
                "payloads": (2.0, 4.0),
                "bus_cycle": 2e-5,
                "truth": "info",
                "moves": 2,
            },
            {"angle": 0.5},
        ),
        ({"axis": "y", "deadband": 60.0, "rest": 0.02, "limit": 0.1, "truth": False}, {"distance": 60, "payload": 3.0}),
    ],
    "stage/FewShotTuning-v1": [
        (
            {
                "axis": "y",
                "tries": 2,
                "margin": 2.0,
                "settle": 0.01,
                "damage_weight": 0.3,
                "vibration_weight": 0.4,
                "payloads": (2.0, 9.0),
                "model": "xy_mast",
                "frictions": (1.0, 3.0),
                "supplies": (0.5, 0.6),
                "torques": (0.5, 0.7),
                "drifts": (0.3, 0.4),
                "healthy": 0.5,
                "faults": ("sag", "binding"),
                "bus_cycle": 2e-5,
                "judge_at": "camera",
                "proofs": 1,
            },
            {},
        ),
        ({"encoder": False, "memory": "last", "truth": True, "split": "worn"}, {"fault": "overload", "distance": 300}),
    ],
    "stage/OneShotTuning-v1": [
        (
            {"error": 0.9, "truth": True, "memory": "all", "margin": 5.0, "answer": "last"},
            {"payload": 5.0, "distance": 900},
        )
    ],
    "stage/SynchronizedLine-v1": [
        (
            {
                "model": "xyz",
                "axes": ("z", "x", "y"),
                "looks": 9,
                "settle": 0.01,
                "rest": 0.03,
                "fl": 700.0,
                "reach": 2.0,
                "multiplier_reach": 3,
                "margin": 1.5,
                "healthy": 0.0,
                "faults": ("binding",),
                "judge_at": "tool",
                "ramps": (0.02, 0.05),
                "proofs": 1,
            },
            {"payload": 2.0},
        ),
        ({"split": "ms", "s_curve": True, "proofs": 1, "truth": False}, {}),
    ],
    "stage/DriftingHome-v1": [
        (
            {
                "axis": "y",
                "healthy": 0.3,
                "walk": 1e-4,
                "noise": 1e-4,
                "bounces": (1e-3, 2e-3),
                "reach": 0.001,
                "settle": 0.02,
                "tolerance": 1.0,
                "time_weight": 2.0,
                "error_weight": 1.0,
                "missed_weight": 2.0,
                "damage_weight": 3.0,
                "returns": 2,
                "bus_cycle": 2e-5,
                "split": "weak",
            },
            {},
        ),
        (
            {
                "chip": "MCX304",
                "faults": ("jam", "phase open", "brownout"),
                "healthy": 0.0,
                "limit": 0.4,
                "truth": True,
                "returns": 2,
            },
            {"supply": 0.8},
        ),
    ],
    "stage/BusMacros-v1": [
        (
            {
                "level": "origin",
                "mixed": True,
                "axes": ("y",),
                "grid": (20, 200),
                "tolerance": 3.0,
                "lag": 5.0,
                "patience": 0.05,
                "settle": 0.001,
                "discount": 0.8,
                "progress_weight": 1.0,
                "macro_weight": 0.2,
                "time_weight": 0.3,
                "success_weight": 2.0,
                "damage_weight": 4.0,
                "truth": True,
                "macros": 9,
                "faults": ("bounce", "sag"),
                "split": "faults",
            },
            {"level": "target"},
        ),
        (
            {"chip": "PCL240MS", "level": "axes", "time_limit": 0.3, "bus_cycle": 2e-5, "frictions": (2.0, 3.0)},
            {"targets": {"y": -32}},
        ),
    ],
}


def other(id_, how, begin):
    """An episode and the next one's beginning."""
    env = make(id_, **how)
    d = Draw(f"other {id_}")
    said = [told(env.reset(seed=31, options=begin))]
    if "RegisterBus" in id_:
        steps = bus_actions(env, d)
    elif env.action_space.shape:
        steps = (action(env.action_space, d) for _ in range(3))
    else:
        steps = (int(d.of(*np.flatnonzero(env.action_masks()).tolist())) for _ in range(12))
    for k, a in enumerate(steps):
        out = env.step(np.asarray(a, env.action_space.dtype))
        short = env.action_space.shape in ((), (4,)) and k > 3 and not (out[2] or out[3])
        said.append([sums(out[0]), out[1]] if short else told(out))
        if out[2] or out[3]:
            break
    said += [told(env.reset()), mechanics(env.stage), [a.position for a in env.stage.axes.values()]]
    env.close()
    return said


DRAWN = {
    "payloads": (1.0, 2.0),
    "frictions": (1.5, 2.0),
    "supplies": (0.9, 1.0),
    "torques": (0.7, 0.8),
    "drifts": (0.1, 0.2),
    "payload_on": "x",
    "bus_cycle": 2e-5,
    "truth": True,
}
"""Ranges of machines that no split has."""
OTHER["stage/OneShotTuning-v1"].append(
    (
        {**DRAWN, "axis": "y", "judge_at": "work", "damage_weight": 0.7, "vibration_weight": 0.9, "encoder": False},
        {"fault": "sag", "switch": 0.5},
    )
)
OTHER["stage/SynchronizedLine-v1"].append(
    ({**DRAWN, "damage_weight": 0.7, "healthy": 0.0, "split": "faults"}, {"supply": 0.95})
)
OTHER["stage/DriftingHome-v1"].append(
    ({**DRAWN, "returns": 2, "limit": 0.5, "reach": 0.001, "healthy": 1.0}, {"start": 1e-3})
)
OTHER["stage/BusMacros-v1"].append(({**DRAWN, "healthy": 1.0, "level": "target", "macros": 8}, {"torque": 0.75}))
FILMED = [
    ("stage/RegisterTuning-v0", "rgb_array", {}),
    ("stage/RegisterTuning-v0", "rgb_array_list", {"render_every": 0.01, "moves": 2}),
    ("stage/OriginReturn-v0", "human", {"returns": 2}),
    ("stage/SynchronizedMove-v0", "rgb_array_list", {"moves": 2, "camera": "nobody's"}),
    ("stage/RegisterBus-v0", "rgb_array_list", {}),
    ("stage/RegisterBus-v0", "human", {"render_every": 0.004}),
    ("stage/DriftingHome-v1", "rgb_array_list", {"render_every": 0.2, "limit": 0.3}),
    ("stage/FewShotTuning-v1", None, {}),
    ("stage/BusMacros-v1", "rgb_array", {}),
]
FILES = {
    "envs_parts": {
        "defaults": defaults,
        "kinds": kinds,
        "boxes": boxes,
        "drawn": drawn,
        "broken": broken,
        "books": books,
        "layouts": layouts,
        "points": points,
        "places": places,
        "outcomes": outcomes,
        "columns": columns,
        "faces": faces,
        "asked": asked,
        "options": options,
        **{f"frames {id_} {mode} {how}": of(frames, id_, mode, **how) for id_, mode, how in FILMED},
        **{
            f"recordings {id_}": (lambda folder, id_=id_: recordings(folder, id_))
            for id_ in ("stage/RegisterTuning-v0", "stage/RegisterBus-v0")
        },
        **{
            f"modes {id_} {mode.name}": of(modes, id_, mode)
            for id_, mode in (
                ("stage/DriftingHome-v1", AutoresetMode.DISABLED),
                ("stage/FewShotTuning-v1", AutoresetMode.SAME_STEP),
                ("stage/BusMacros-v1", AutoresetMode.NEXT_STEP),
                ("stage/BusMacros-v1", AutoresetMode.SAME_STEP),
            )
        },
        **{f"other {id_} {k}": of(other, id_, *how) for id_, some in OTHER.items() for k, how in enumerate(some)},
    },
}
