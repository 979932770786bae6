"""Stages with what is not usual: wires, encoders, other motors, points of programs, samples of two recordings, refusals."""

import copy
import pickle
from functools import partial
from itertools import pairwise

import mujoco
import numpy as np
from recorded.recorded_stage import brief, columns, go, make, run_on, seen
from recorded.recorded_texts import tried
from recorded.store import digits
from support import nova_programs as nova
from support import servo_programs as servo
from support.many_axes import rail_model
from support.mirrored import mirrored
from support.programs import start_preset

from stage import Drive, Fleet, Motor, Program, Stage, faults
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS, cores
from stage.chips.nova import Nova
from stage.drives.dc_motors import DCMotor, Servo
from stage.errors import StageError
from stage.sim import encoder, integration, plant, play
from stage.sim.encoder import Encoder
from stage.sim.fingerprint import mechanics
from stage.sim.plant.new import NewAxis, new_model
from stage.sim.play import TRUTH

SMALL = Motor("small", 0.8, 4.0, 5e-3, 0.2, 0.01, 3e-6)
FEW = Motor("few", 0.8, 4.0, 5e-3, 0.2, 0.01, 3e-6, steps_per_turn=48)
ZOO = "x:slide:120mm,b:hinge:90deg,z:slide:8cm,a:hinge:360deg"


def zoo(**options):
    """Slides and hinges, each on the one before."""
    text = new_model([NewAxis.of(item) for item in ZOO.split(",")])
    return Stage(mujoco.MjSpec.from_string(text), visuals=False, **options)


# --- what a stage is made of ---

MADE = {
    "usual": ("xy", {}),
    "order": ("xyz", {"chips": {"z": PCL240K, "x": PCL240K}}),
    "shared": ("xyz", {"chips": MCX304}),
    "two of one": ("xyz", {"chips": {"x": MCX302, "y": MCX302, "z": MCX302}}),
    "apart": ("xyz", {"chips": {"x": MCX302, "y": PCL240MK, "z": MCX302}}),
    "clock": ("xy", {"chips": {"x": PCL240K, "y": MCX304}, "clock": 8_000_000}),
    "motors": ("xy", {"drives": {"y": "17HS15-1504S"}}),
    "a motor": ("xy", {"drives": SMALL}),
    "drives": (
        "xy",
        {"drives": {"x": Drive(FEW, microsteps=5, current=0.5, mode="sine", detent=0.0), "y": "SS2422-5041"}},
    ),
    "servos": ("xyz_servo", {"chips": HCTL1100, "drives": {"y": Servo("9233S013", 12.0, 400), "z": "14203S010"}}),
    "own servo": ("xy", {"chips": HCTL1100, "drives": DCMotor("own", 2.0, 0.04, 1e-5, 0.05, 30.0)}),
    "bus": ("xy", {"bus_cycle": 2.5e-6}),
    "no bus": ("xy", {"bus_cycle": 0}),
    "encoders": ("xy", {"chips": MCX514, "encoders": {"y": -3e5, "x": 2e5}}),
    "encoders of motors": (
        "xy",
        {"chips": MCX304, "encoders": [Encoder("y", per_turn=2000), Encoder("x", per_metre=1e6)]},
    ),
    "an encoder": ("xy", {"chips": MCX312, "encoders": Encoder("y", per_turn=-400)}),
    "wiring": (
        "xy",
        {
            "chips": PCL240MS,
            "wiring": {"y": {"org": "positive", "ez": "positive"}, "x": {"el_plus": "positive", "org": "negative"}},
        },
    ),
    "syni": ("xyz", {"syni": {"z": "x", "y": "x"}}),
    "multichip": ("xyz", {"chips": {"x": MCX514, "y": PCL240K, "z": partial(MCX514)}, "multichip": ["z", "x"]}),
}


def made(name):
    model, options = MADE[name]
    stage = Stage(model, visuals=False, **options)
    stage.run(0.0011)
    twin = pickle.loads(pickle.dumps(stage))
    return {
        "header": [p for p in stage.header.parts if p[0] != "layout of the state"],
        "repr": [repr(stage), repr(stage.axes)],
        "axes": [
            [
                a.name,
                a.index,
                a.chip_axis,
                a.gear,
                a.travel,
                a.unit,
                a.meters_per_pulse,
                a.supply,
                a.wiring,
                a.drive.title,
            ]
            for a in stage.axes.values()
        ],
        "chips": [[type(c).__name__, c.clock_hz, c.clock, c.options()] for c in stage.chips],
        "table": {
            n: stage.state.axis_table[n]
            for n in ("chip", "chip_axis", "positive", "counts", "gear", "index_at", "index_bit")
        },
        "switch table": digits(repr(stage.state.switch_table[["bit", "forced", "bounce"]].tolist())),
        "clockwork": [
            int(stage.state.clockwork[0][n]) for n in ("dt", "encoders", "currents", "loads", "linked", "most_edges")
        ],
        "armature": stage.model.dof_armature,
        "twin": twin.header == stage.header and brief(twin) == brief(stage),
        "now": brief(stage),
    }


REFUSED = {
    "bus cycle": {"bus_cycle": -1e-9},
    "chips of none": {"chips": {}},
    "chip of an axis": {"chips": {"x": "PCL240"}},
    "chip that is none": {"chips": {"y": 7}},
    "axis of chips": {"chips": {"xx": PCL240K}},
    "axis of drives": {"drives": {"z": "17HS4401"}},
    "servo": {"drives": Servo()},
    "dc motor": {"drives": "14201S003"},
    "no motor": {"drives": {"y": "17HS"}},
    "stepper": {"chips": HCTL1100, "drives": Drive()},
    "stepper's motor": {"chips": HCTL1100, "drives": SMALL},
    "stepper's name": {"chips": {"y": HCTL1100}, "drives": {"y": "17HS4401"}},
    "clock": {"clock": 0},
    "encoder of none": {"chips": MCX514, "encoders": {"u": 1e5}},
    "encoder of 0": {"chips": MCX514, "encoders": {"x": 0}},
    "encoder true": {"chips": MCX514, "encoders": {"y": True}},
    "encoder twice": {"chips": MCX514, "encoders": [Encoder("x", 1e5), Encoder("x", 2e5)]},
    "encoder of a servo": {"chips": HCTL1100, "encoders": {"y": 1e5}},
    "encoder of pulses": {"encoders": {"x": 1e5}},
    "encoder's zero": {"chips": MCX304, "encoders": [Encoder("y", 1e5, zero=0.1)]},
    "encoders": {"chips": MCX514, "encoders": "x"},
    "no encoders": {"chips": MCX514, "encoders": [5]},
    "wiring": {"wiring": "x"},
    "wiring of an axis": {"wiring": {"z": {"org": "positive"}}},
    "wiring of x": {"wiring": {"x": "org"}},
    "sensor": {"wiring": {"y": {"orgs": "positive"}}},
    "logic": {"wiring": {"y": {"org": "high"}}},
    "not wired": {"chips": HCTL1100, "wiring": {"x": {"sd_plus": "positive"}}},
    "one pin": {"chips": PCL240K, "wiring": {"y": {"sd_plus": "positive"}}},
    "syni": {"syni": "y"},
    "syni axis": {"syni": {"y": "z"}},
    "syni itself": {"syni": {"y": "y"}},
    "syni round": {"syni": {"y": "x", "x": "y"}},
    "syni chip": {"chips": MCX304, "syni": {"y": "x"}},
    "syni other": {"chips": {"x": PCL240K, "y": MCX302}, "syni": {"y": "x"}},
    "syni clocks": {"chips": {"x": PCL240K, "y": partial(PCL240K, 5_000_000)}, "syni": {"y": "x"}},
    "multichip": {"multichip": "xy"},
    "multichip axis": {"multichip": ["x", "q"]},
    "multichip chip": {"multichip": ["x", "y"]},
    "multichip one": {"chips": MCX514, "multichip": ["x", "y"]},
    "multichip clocks": {"chips": {"x": MCX514, "y": partial(MCX514, clock_hz=8_000_000)}, "multichip": ["x", "y"]},
    "model": {"model": 5},
    "file": {"model": "nowhere/xy.xml"},
    "near": {"model": "xyy"},
}


def refused():
    found = {name: str(tried(lambda given=given: Stage(**{"model": "xy"} | given))) for name, given in REFUSED.items()}
    chip = PCL240K()
    Stage("xy", chips={"x": chip}, visuals=False)
    found["used"] = str(tried(Stage, "xy", chips={"x": chip})).replace(repr(chip), "CHIP")
    found["twice"] = str(tried(Stage, "xy", chips=(both := PCL240MS()))).replace(repr(both), "CHIP")
    for given in (
        {},
        {"per_metre": 1.0, "per_turn": 1.0},
        {"per_turn": 0},
        {"per_metre": float("nan")},
        {"per_turn": "2"},
    ):
        found[f"Encoder {given}"] = tried(Encoder, "x", **given)
    found["Encoder zero"] = tried(Encoder, "x", 1.0, zero=float("inf"))
    stage = make()
    found["rows"] = [
        Encoder("y", per_turn=400).row(stage),
        Encoder("x", 1e5, zero=0.25).row(stage),
        str(Encoder("x", 1234567.0)),
        str(Encoder("x", per_turn=-500)),
        tried(Encoder("q", 1.0).row, stage),
    ]
    found["per unit"] = encoder.per_unit([Encoder("y", per_turn=100)], plant.bind(stage.model))
    return found


def restores():
    """What is another's snapshot, in words: of each thing by which stages differ."""
    stage = make("xyz", {"x": PCL240K, "y": MCX514})
    kept, found = stage.snapshot(), {"repr": repr(stage.snapshot())[:90]}
    others = {
        "axes": make("xyz"),
        "a chip": make("xyz", {"x": PCL240K, "y": MCX312}),
        "a clock": make("xyz", {"x": partial(PCL240K, 9_830_400), "y": MCX514}),
        "a drive": make("xyz", {"x": PCL240K, "y": MCX514}, drives={"y": Drive(microsteps=8)}),
        "volts": make("xyz", {"x": PCL240K, "y": MCX514}, drives=Drive(bus_voltage=25.0)),
        "an encoder": make("xyz", {"x": PCL240K, "y": MCX514}, encoders={"y": 1e5}),
        "a wire": make("xyz", {"x": PCL240K, "y": MCX514}, wiring={"x": {"org": "positive"}}),
        "bus": make("xyz", {"x": PCL240K, "y": MCX514}, bus_cycle=2e-6),
        "a model": make("xy", {"x": PCL240K, "y": MCX514}),
    }
    for name, other in others.items():
        before = other.snapshot().state.tobytes()
        found[name] = [str(tried(other.restore, kept)), other.snapshot().state.tobytes() == before]
    found["no snapshot"] = [str(tried(stage.restore, what)) for what in (None, "kept", [1] * 200, PCL240K().snapshot())]
    with stage.record():
        found["recorded"] = str(tried(stage.restore, kept))
    found["mechanics"] = [mechanics(make(m).model) for m in ("xy", "xyz")] + [mechanics(zoo().model)]
    return found


# --- wires and encoders at work ---


def wired(name):
    """Both ways over the origin switch, the limits and an index pulse, of sensors of the other logic."""
    logic = {
        "el_plus": "positive",
        "org": "positive",
        "ez": "positive",
        "el_minus": "positive",
        "sd_plus": "positive",
        "sd_minus": "positive",
    }
    cls = {"PCL240MS": PCL240MS, "MCX514": MCX514, "MCX304": MCX304}[name]
    here = {k: v for k, v in logic.items() if cls().wired(k)}
    stage = make("xy", {"x": cls, "y": partial(cls)}, wiring={"y": here})
    x, y = stage.axes.values()
    found = {"at rest": [x.pins.as_dict(), y.pins.as_dict(), y.wiring]}
    for pin, minus in (("org", True), ("org", False), ("el_plus", False), ("el_minus", True)):
        stage.reset()
        for axis in (x, y):
            touch = next(s.touch for s in axis.plant.switches if s.pin == pin)
            stage.place(**{axis.name: touch + (3e-4 if minus else -3e-4)})
            run_on(axis, minus)
        stage.run(0.05)
        said = seen(stage)
        found[f"{pin} {'minus' if minus else 'plus'}"] = [
            said["axes"],
            said["index"],
            [digits(repr(a.pins.as_dict())) for a in (x, y)],
        ]
    with faults.switch_stuck(y, "org", True):
        found["stuck"] = [y.pins.as_dict(), y.switches.as_dict()]
        twin = copy.deepcopy(stage)
    found["mended"] = [y.pins.as_dict(), twin.axes["y"].pins.as_dict(), twin.faults]
    return found


def counted():
    """Chips that count encoders: both ways, on the carriage and on the motor, after a snapshot, in a journal."""
    found = {}
    for cls, encoders in (
        (MCX514, {"y": -4e5, "x": 2e5}),
        (MCX304, [Encoder("y", per_turn=2000)]),
        (MCX312, {"x": 1e6}),
    ):
        stage = make("xy", cls, encoders=encoders)
        x, y = stage.axes.values()
        stage.place(x=0.0101, y=-0.0203)
        journal = x.chip.journal(0)
        go(x, 1500)
        stage.run(0.06)
        kept = stage.snapshot()
        go(y, 700, minus=cls is MCX514)
        stage.run(0.09)
        now = [x.chip.values(), y.position, stage.state.axis_table["counts"]]
        entries = [tuple(e)[:4] for e in journal.entries]
        stage.restore(kept)
        stage.run(0.01)
        found[cls.__name__] = [now, len(entries), digits(repr(entries)), brief(stage), x.chip.values()]
    return found


def led():
    """Chips at SYNI, and the lines of multichip interpolation: each at its own pulses, with switches on the way."""
    found = {}
    stage = make("xyz", PCL240K, syni={"z": "x", "y": "x"})
    for k, axis in enumerate(stage.axes.values()):
        go(axis, 300 + 50 * k, minus=k == 1)
    for seconds in (0.0302, 0.05):
        stage.run(seconds)
        found[f"syni {seconds}"] = [seen(stage), [digits(repr(c.values()), 3) for c in stage.chips]]
    twin = copy.deepcopy(stage)
    twin.run(0.02)
    stage.run(0.02)
    found["twin"] = [brief(twin) == brief(stage), twin.header == stage.header]
    stage = make("xyz", {"x": MCX514, "y": partial(MCX514), "z": PCL240K}, multichip=["y", "x"])
    journals = [c.journal() for c in stage.chips]
    x, y, z = stage.axes.values()
    stage.place(x=next(s.touch for s in x.plant.switches if s.pin == "sd_plus") - 2e-4)
    go(x, 200)
    go(y, 150, minus=True)
    go(z, 100)
    stage.run(0.0507)
    found["lines"] = [
        seen(stage),
        [[len(j.entries), digits(repr([tuple(e)[:4] for e in j.entries]), 3)] for j in journals],
    ]
    return found


# --- another motor ---


def refitted():
    """Another motor at rest and in motion; what is refused; what reset, copies and mending leave."""
    found = {}
    for model, cls, motors in (
        ("xy", PCL240K, ("17HS19-2004S1", SMALL)),
        ("xyz_servo", HCTL1100, ("14203S010", DCMotor("own", 1.0, 0.03, 1e-5, 0.1))),
    ):
        stage = make(model, cls)
        x, y = list(stage.axes.values())[:2]
        go(x, 700)
        stage.run(0.0303)
        before = stage.snapshot()
        fault = faults.motor(x, motors[0])
        second = faults.motor(y, motors[1])
        said = [
            fault.text,
            second.text,
            stage.faults,
            x.drive.title,
            y.drive.title,
            stage.model.dof_armature,
            x.drive == y.drive,
        ]
        said += [
            str(tried(stage.restore, before)),
            str(tried(faults.motor, x, motors[0])),
            stage.header.parts != before.header.parts,
        ]
        stage.run(0.03)
        said += [seen(stage)]
        twin = copy.deepcopy(stage)
        between = stage.snapshot()
        second.mend()
        fault.mend()
        said += [
            str(tried(stage.restore, between)),
            stage.faults,
            stage.model.dof_armature,
            stage.header == before.header,
        ]
        stage.run(0.01)
        twin.run(0.01)
        said += [brief(stage), brief(twin), twin.faults]
        twin.reset()
        go(twin.axes[y.name], 300, minus=True)
        twin.run(0.02)
        said += [seen(twin)]
        stage.restore(before)
        stage.run(0.01)
        found[model] = [*said, brief(stage), stage.model.actuator_gainprm[:, :2]]
    x, y = list(make("xy", {"x": PCL240K, "y": HCTL1100}).axes.values())
    found["refused"] = [
        str(tried(faults.motor, a, m))
        for a, m in ((x, "14201S003"), (y, SMALL), (x, FEW), (x, "17HS4402"), (y, 5), (x, "17HS4401"))
    ]
    return found


def supplies():
    """Faults of drives one in the other, mended the other way round and in the same order."""
    found = {}
    for order in (1, -1):
        stage = make("xy", PCL240MS)
        x, y = stage.axes.values()
        go(x, 900)
        go(y, 900, minus=True)
        made = []
        for make_one in (
            lambda x=x: faults.phase_open(x, "b"),
            lambda x=x: faults.phase_open(x, "a"),
            lambda y=y: faults.bus_voltage(y, 6.0),
            lambda s=stage: faults.bus_voltage(s, 30.0),
            lambda y=y: faults.jam(y, 12.0),
            lambda x=x: faults.jam(x),
        ):
            made.append(make_one())
            stage.run(0.0021)
        said = [
            [f.text for f in made],
            stage.faults,
            seen(stage),
            stage.model.dof_frictionloss,
            stage.model.dof_solref,
            stage.model.dof_solimp,
        ]
        twin = pickle.loads(pickle.dumps(stage))
        for fault in made[::order]:
            fault.mend()
            fault.mend()
            said += [
                [[a.supply, a.open_phases] for a in (x, y)],
                list(stage.faults),
                stage.model.dof_frictionloss.copy(),
            ]
        stage.run(0.01)
        twin.reset()
        found[order] = [
            *said,
            brief(stage),
            [[a.supply, a.open_phases] for a in twin.axes.values()],
            seen(twin)["axes"],
            repr(made[0]),
        ]
    stage = make("xyz")
    lost = faults.lost_write(stage.axes["x"], 0, 0x15)
    twin = copy.deepcopy(stage)
    start_preset(stage.axes["x"].chip, 400)
    start_preset(twin.axes["x"].chip, 400)
    stage.run(0.02)
    twin.run(0.02)
    found["lost"] = [repr(lost), stage.faults, twin.faults, brief(stage), brief(twin)]
    return found


# --- programs ---


def pointed():
    """Points of sites and bodies, compiled and by hand: at once, in a row, both ways of a wait that ends."""
    found, stage = {}, make("xyz", {"y": MCX514, "x": PCL240K, "z": HCTL1100})
    m = stage.model
    site = 1 + mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SITE, "work")
    bodies = [mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_BODY, name) for name in ("x", "y")]
    points = [site, m.nsite, -bodies[0], -bodies[1], 1 - m.nbody]
    for name, program in {
        "points": lambda p: [p.look(0, point, k) for point in points for k in range(3)],
        "measure": lambda p: [
            p.measure(s, point)
            for s, point in ((0.003, 0), (0.0101, site), (0.004, -bodies[1]), (0, site), (1e-9, 1 - m.nbody))
        ],
        "stop": lambda p: [
            p.until_stopped(axes, limit, poll)
            for axes, limit, poll in (
                ([0, 1], 0.001, 3e-4),
                ([1], 0.004, 1e-3),
                ([0], 0, 1e-4),
                ([1, 0, 1], 1.0, 2.5e-4),
                ([], 1, 1),
            )
        ],
        "keep": lambda p: [
            p.until_stopped([0], 0.02, keep_step=True),
            p.until_stopped([1], 0.5, 1e-3, True),
            p.look(0),
        ],
        "end": lambda p: [p.wait(1e-3), p.ops.append((0, 9, 9, 9)), p.wait(5.0)],
    }.items():
        p = Program()
        writer = _Into(p, 1)
        start_preset(writer, 700)
        p.wait(0.002)
        program(p)
        p.look(2).look(1).read(1, 0)
        some = [copy.deepcopy(stage) for _ in range(2)]
        other = [copy.deepcopy(stage) for _ in range(2)]
        for k, s in enumerate((*some, *other)):
            s.place(x=0.01 * (k % 2))
            if k % 2:
                faults.jam(s.axes["x"])
        played = Fleet(some, 2).play([p, p])
        by_hand = []
        for s in other:
            results, extremes = np.zeros(len(p), np.int64), np.full((m.nq, 2), np.inf) * [1, -1]
            status = play.by_hand(s, np.array(p.ops), results, extremes)
            by_hand.append([status, results[-12:], extremes[:3]])
        found[name] = [
            played.results[:, -12:],
            played.extremes[:, :3],
            played.diverged,
            by_hand,
            [brief(s)[1] for s in (*some, *other)],
            [[t[n] for n in TRUTH.names] for t in Fleet(some, 1).truth()[:, 0]],
        ]
    return found


class _Into:
    def __init__(self, program, axis):
        self.program, self.axis = program, axis

    def write(self, address, value):
        self.program.write(self.axis, address, value)


BAD_OPS = [
    (1, 2, 0, 0),
    (1, -1, 0, 0),
    (2, 2, 0, 0),
    (3, -1, 0, 0),
    (3, 10**18 + 1, 0, 0),
    (4, 4, 1, 0),
    (4, -1, 1, 0),
    (4, 1, 0, 0),
    (4, 1, 1, -1),
    (4, 1, 10**18 + 1, 0),
    (7, 8, 1, 0),
    (7, 1, 1, 10**18 + 1),
    (5, -1, 0, 0),
    (5, 1, 99, 0),
    (5, 1, -99, 0),
    (6, 2, 0, 0),
    (6, 0, 99, 0),
    (6, 0, 1, 3),
    (6, 0, 1, -1),
    (6, 0, -99, 0),
    (8, 0, 0, 0),
    (-1, 0, 0, 0),
]


def foreseen():
    """What a program would make of a chip with no stage around it: of its own axes alone, over by then or not."""
    found = {}
    for cls, j in ((PCL240K, 0), (PCL240MS, 0), (MCX514, 2), (MCX304, 1), (HCTL1100, 0)):
        for until, mask in ((1.0, 2), (1e-3, 2), (1.0, 1), (0.0, 2)):
            p = Program().write(0, 0, 0x42)
            if issubclass(cls, Nova):
                chip = type("Told", (_Into, cls), {})(p, 1)
                nova.move(chip, 321, 1 << j)
            elif cls is HCTL1100:
                servo.move(_Into(p, 1), 321)
            else:
                start_preset(_Into(p, 1), 321, True)
            p.wait(1.0).read(1, 0)
            fresh = cls()
            rows = np.frombuffer(bytearray(fresh.snapshot().record), cls.CORE.STATE)
            twin = np.zeros(1, cores.CHIP)
            cores.fill(twin[0], cls.CORE, rows.ctypes.data)
            made = play.would_make(twin, np.array(p.ops), mask, j, round(until * fresh.clock_hz))
            found[f"{cls.__name__} {until} {mask}"] = [
                int(made),
                made == play.STILL_BUSY,
                0 if cls is HCTL1100 else digits(rows.tobytes()),
            ]
    return found


def bad_programs():
    stage = make("xy")
    fleet = Fleet([stage, copy.deepcopy(stage)], 1)
    found = {}
    for op in BAD_OPS:
        ops = np.zeros((2, 2, 4), np.int64)
        ops[:, 0] = 3, 5, 0, 0
        ops[1, 1] = op
        found[str(op)] = tried(fleet.play, ops)
        ops[1] = ops[1, ::-1]
        ops[1, 0], ops[1, 1] = 0, op
        found[f"{op} after the end"] = tried(lambda ops=ops: fleet.play(ops).diverged.tolist())
    found["times"] = [s.now for s in fleet.stages]
    found["fleets"] = [
        tried(Fleet, given, threads)
        for given, threads in (([], None), ([stage] * 2, 1), ([stage, make("xyz")], 1), ([stage], 0), ([stage], 1.5))
    ]
    found["shapes"] = [
        str(tried(fleet.play, given))
        for given in ([Program()], np.zeros((2, 3, 3), np.int64), np.zeros((2, 4), np.int64), [])
    ]
    found["threads"] = [Fleet([stage, copy.deepcopy(stage)], n).threads for n in (1, 2, 5)]
    found["axes"] = [tried(Program().until_stopped, axes, 1.0) for axes in ([-1], [62], [0, 99])]
    found["ops"] = (
        Program()
        .until_stopped([61, 0, 0], 1e-9, 1e-9)
        .wait(1.4e-9)
        .wait(1.6e-9)
        .measure(2e-3, -1)
        .look(1, 2, 1)
        .read(1, 3)
        .command(1, 9)
        .ops
    )
    found["registers"] = [
        Program().register(1, cls, name, value, j).ops
        for cls, name, value, j in ((PCL240K, "R0", 70_000, 0), (MCX514, "DV", 1234, 3), (MCX304, "P", -5, 2))
    ]
    return found


# --- samples ---


def sampled():
    """Two recordings one after the other at other rates; what each has seen; times of their samples; a fault that was there."""
    stage = make("xyz", {"x": MCX514, "y": PCL240MS, "z": HCTL1100}, encoders={"x": 3e5})
    x, y, z = stage.axes.values()
    found = {}
    stage.run(0.00061)
    for every, seconds, axis in ((1e-3, 0.0203, x), (3.1e-4, 0.0101, y), (1e-9, 0.00149, z), (2.5e-3, 0.02, y)):
        with stage.record(every) as recording:
            go(axis, 400, minus=axis is y)
            stage.run(seconds)
            if axis is y:
                fault = faults.jam(y, 20.0)
            stage.run(seconds / 3)
        times = recording.column("time")
        found[str(every)] = [
            columns(recording),
            len(times),
            times[0],
            times[-1],
            recording.every,
            recording.began,
            recording.duration,
            list(recording.notes),
        ]
        if axis is not y:
            continue
        fault.mend()
    found["refused"] = [str(tried(stage.record, every)) for every in (0, -1e-3, 1e6 + 1, float("nan"))]
    with stage.record(1e6) as recording:
        found["two"] = str(tried(stage.record))
        stage.run(0.01)
    found["none"] = [len(recording.column("time")), recording.every, stage.recording]
    return found


def in_time():
    """Runs that end anywhere: steps, conditions, polls, what they say they took."""
    stage = make("xy", bus_cycle=1e-4)
    x = stage.axes["x"]
    run_on(x)
    found = {"began": stage.now, "bus": stage.bus_cycle}
    for n in (0, 1, 1.0, 3):
        stage.step(n)
        found[f"step {n}"] = [stage.now, stage.time, x.time, x.position, x.commanded, x.load_angle]
    for seconds in (0, 1e-9, 2.5e-4, 1.6e-9, 1.4e-9, 0.00012345):
        stage.run(seconds)
        found[f"run {seconds}"] = [stage.now, x.position, x.commanded]
    x.wait(1e-5)
    stage.run_to(stage.now - 5)
    stage.cycle()
    for limit, poll in ((0.01, 1e-3), (2e-6, 0), (0.0031, 3e-3)):
        goal = x.chip.net(0) + 12
        found[f"until {limit} {poll}"] = tried(stage.run_until, lambda goal=goal: x.chip.net(0) >= goal, limit, poll)
        found[f"until {limit} {poll} then"] = [stage.now, x.chip.net(0) - goal]

    def never():
        return False

    found["never"] = [str(tried(stage.run_until, never, 1e-3)), stage.now]
    found["bounds"] = [str(tried(stage.run, v)) for v in (-1e-9, 1e9, float("nan"), float("inf"), -0.1)]
    found["steps"] = [str(tried(stage.step, v)) for v in (-1, 4 * 10**12 + 1, float("nan"), float("inf"), 1.5)]
    found["diverged"] = diverged(stage)
    return found


def diverged(stage):
    stage.data.qfrc_applied[stage.axes["y"].plant.dof] = 1e30
    error = None
    try:
        stage.run(0.01)
    except StageError as raised:
        error = raised
    stage.data.qfrc_applied[:] = 0
    again = pickle.loads(pickle.dumps(error))
    said = [str(error), error.time, error.axis, str(again) == str(error), again.time, again.axis, stage.now]
    stage.run(0.001)
    return [*said, brief(stage)]


def looked():
    """What people see of stages and axes: texts, tables of HTML, names after Tab."""
    found = {}
    for name, stage in (
        ("xy", make("xy", {"y": MCX304})),
        ("zoo", zoo(chips={"a": PCL240MS, "z": PCL240K, "b": HCTL1100})),
    ):
        axes = stage.axes
        stage.place(**{axis.name: axis.travel[0] * 0.9 for axis in axes.values()})
        with faults.switch_stuck(next(iter(axes.values())), "org", True):
            found[name] = [
                repr(stage),
                repr(axes),
                [repr(a) for a in axes.values()],
                stage._repr_html_(),
                axes._repr_html_(),
            ]
        found[f"{name} axes"] = [digits(a._repr_html_(), 4) for a in axes.values()] + [
            axes._ipython_key_completions_(),
            list(reversed(axes)),
            list(axes.keys()),
            len(axes),
            "x" in axes,
            5 in axes,
            [dir(a.switches) for a in axes.values()],
            [str(a.switches) for a in axes.values()],
            [[a.load_angle, a.commanded, a.lost_steps, a.unit, a.meters_per_pulse, a.travel] for a in axes.values()],
        ]
    return found


def turned(folder):
    """A left-hand thread: seen, placed, pushed over its switches, sampled, played."""
    stage = Stage(mirrored(folder), chips={"x": PCL240MS, "y": PCL240MS}, visuals=False)
    x = stage.axes["x"]
    found = {
        "plant": [[s.pin, s.touch, s.slope] for s in x.plant.switches] + [x.plant.index, x.gear, x.meters_per_pulse]
    }
    for pin, minus in (("org", False), ("el_plus", True), ("el_minus", False), ("sd_plus", True)):
        stage.reset()
        touch = next(s.touch for s in x.plant.switches if s.pin == pin)
        stage.place(x=touch + (2e-4 if not minus else -2e-4))
        with stage.record() as recording:
            run_on(x, minus)
            stage.run(0.041)
        found[pin] = [seen(stage), columns(recording)["x/commanded"], columns(recording)["x/load_angle"]]
    truth = Fleet([stage], 1).truth()[0, 0]
    return found | {"truth": [truth[n] for n in TRUTH.names]}


def free():
    """Index pulses of rotors that turn as they please, over switches that bounce and stick, and come to rest."""
    found = {}
    for speed in (0.31, -0.31, 0.02):
        stage = make("xy", PCL240MS)
        x = stage.axes["x"]
        for phase in "ab":
            faults.phase_open(x, phase)
        org = next(s.touch for s in x.plant.switches if s.pin == "org")
        stage.place(x=org - np.sign(speed) * 3e-4)
        bounce = faults.bounce(x, "org", 1.7e-3, 6)
        journal = x.chip.journal()
        stage.data.qvel[x.plant.dof] = speed
        states = []
        for ns in (700_000, 812_345, 1_000_001, 1_900_000, 4_000_000):
            stage.run_to(stage.now + ns)
            states.append([x.switches.org, seen(stage)["switches"], seen(stage)["index"][0]])
        kept = stage.snapshot()
        bounce.mend()
        stage.run(0.003)
        stage.restore(kept)
        with faults.switch_stuck(x, "org", not x.switches.org):
            stage.run(0.0013)
            states.append([x.switches.org, brief(stage)])
        stage.run(0.0017)
        entries = [tuple(e)[:4] for e in journal.entries]
        gaps = [b[1] - a[1] for a, b in pairwise(entries)]
        found[str(speed)] = [states, len(entries), digits(repr(entries), 3), gaps[:20], brief(stage)]
    return found


def loads():
    """Masses on bodies: put, doubled, taken off; in copies; what is refused."""
    stage = make("xyz")
    bodies = [stage.model.body(k).name for k in range(1, stage.model.nbody)]
    found = {"bodies": bodies}
    stage.set_payload(1.5)
    stage.set_payload(2, "x")
    stage.set_payload(0.25, "x")
    twin = pickle.loads(pickle.dumps(stage))
    twin.set_payload(0)
    found["put"] = [
        [s.payload(), s.payload("x"), s.payload("y"), s.model.body_mass, s.model.dof_M0, s.model.dof_invweight0]
        for s in (stage, twin)
    ]
    stage.reset()
    found["reset"] = [stage.payload(), stage.payload("x")]
    with faults.payload(stage, 3.0, "x") as fault:
        found["fault"] = [fault.text, stage.payload("x"), stage.model.body_mass]
    found["mended"] = [stage.payload("x"), stage.model.body_mass]
    found["refused"] = [
        str(tried(stage.set_payload, *given)) for given in ((-1,), (1e6,), (float("nan"),), (1, "nobody"), (1, "X"))
    ]
    found["asked"] = str(tried(stage.payload, "z1"))
    found["no site"] = str(tried(Stage(rail_model(1), visuals=False).set_payload, 1.0))
    return found


def too_long():
    """Time steps and integrators that cannot be, with the reason and the line to write."""
    text = new_model([NewAxis.of("x:slide:300mm"), NewAxis.of("a:hinge:90deg")])
    found = {}
    for old, new in (
        ('timestep="0.00025"', 'timestep="0.002"'),
        ('timestep="0.00025"', 'timestep="0.001"'),
        ('timestep="0.00025"', 'timestep="0.0005"'),
        ('timestep="0.00025"', 'timestep="1e-9"'),
        ('timestep="0.00025"', 'timestep="2"'),
        ("implicitfast", "RK4"),
        ("implicitfast", "Euler"),
        ("implicitfast", "implicit"),
        ('timestep="0.00025"', 'timestep="0.0001"'),
    ):
        for chips in (PCL240K, HCTL1100):
            spec = mujoco.MjSpec.from_string(text.replace(old, new))
            found[f"{new} {chips.__name__}"] = tried(
                lambda spec=spec, chips=chips: repr(Stage(spec, chips=chips, visuals=False))
            )
    stage = zoo()
    mobility = np.linspace(0.05, 0.4, len(stage.axes))
    found["longest"] = [
        integration._longest(a.plant, d, m)
        for a, m in zip(stage.axes.values(), mobility, strict=True)
        for d in (Drive(), Drive(SMALL, current=0.3, detent=0.0), Servo(), Servo("9233S013"))
    ]
    found["none"] = [integration._longest(stage.axes["x"].plant, Drive(), m) for m in (0.0, float("inf"), float("nan"))]
    return found


FILES = {
    "sim_made": {**{name: partial(made, name) for name in MADE}, "refused": refused, "restores": restores},
    "sim_more": {
        **{f"wired {name}": partial(wired, name) for name in ("PCL240MS", "MCX514", "MCX304")},
        "counted": counted,
        "led": led,
        "refitted": refitted,
        "supplies": supplies,
        "pointed": pointed,
        "foreseen": foreseen,
        "bad programs": bad_programs,
        "sampled": sampled,
        "in time": in_time,
        "looked": looked,
        "turned": turned,
        "free": free,
        "loads": loads,
        "too long": too_long,
    },
}
