"""Stages with what is not usual: wires, encoders, other motors, points of programs, samples of two recordings."""

import copy
import pickle
from functools import partial
from itertools import pairwise

import mujoco
import numpy as np
from recorded.observation import (
    ProgramBus,
    attempt,
    make_stage,
    read_positions,
    read_stage,
    start_endless_move,
    start_move,
    sum_columns,
)
from support.many_axes import rail_model
from support.mirrored import mirrored
from support.programs import start_preset

from stage import Drive, Fleet, Motor, Program, Stage, faults
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.drives.dc_motors import DCMotor, Servo
from stage.errors import StageError
from stage.sim import program_player
from stage.sim.encoder import Encoder
from stage.sim.plant.new_model import NewAxis, build_model_text
from stage.sim.program_player import TRUTH

SMALL = Motor("small", 0.8, 4.0, 5e-3, 0.2, 0.01, 3e-6)
FEW = Motor("few", 0.8, 4.0, 5e-3, 0.2, 0.01, 3e-6, steps_per_turn=48)
ZOO = "x:slide:120mm,b:hinge:90deg,z:slide:8cm,a:hinge:360deg"


def make_stage_of_many_axes(**options):
    """Return a stage of slides and hinges, each on the one before."""
    text = build_model_text([NewAxis.parse(item) for item in ZOO.split(",")])
    return Stage(mujoco.MjSpec.from_string(text), visuals=False, **options)


# --- what a stage is made of ---

SETUPS = {
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


def build_stage(name):
    model, options = SETUPS[name]
    stage = Stage(model, visuals=False, **options)
    stage.run(0.0011)
    replica = pickle.loads(pickle.dumps(stage))
    return {
        "axes": [
            [
                a.name,
                a.index,
                a.chip_axis,
                a.gear,
                a.travel,
                a.unit,
                a.meters_per_pulse,
                a.faults.bus_voltage,
                a.wiring,
                a.drive.title,
            ]
            for a in stage.axes.values()
        ],
        "chips": [[type(c).__name__, c.clock_hz, c.clock, c.options()] for c in stage.chips],
        "armature": stage.model.dof_armature,
        "twin": replica.header == stage.header and read_positions(replica) == read_positions(stage),
        "now": read_positions(stage),
    }


# --- wires and encoders at work ---


def wired(name):
    """Move both ways over the origin switch, the limits and an index pulse, of sensors of the other logic."""
    logic = {
        "el_plus": "positive",
        "org": "positive",
        "ez": "positive",
        "el_minus": "positive",
        "sd_plus": "positive",
        "sd_minus": "positive",
    }
    cls = {"PCL240MS": PCL240MS, "MCX514": MCX514, "MCX304": MCX304}[name]
    wired = {k: v for k, v in logic.items() if cls().find_switch_input(k)}
    stage = make_stage("xy", {"x": cls, "y": partial(cls)}, wiring={"y": wired})
    x, y = stage.axes.values()
    results = {"at rest": [x.pins.as_dict(), y.pins.as_dict(), y.wiring]}
    for pin, minus in (("org", True), ("org", False), ("el_plus", False), ("el_minus", True)):
        stage.reset()
        for axis in (x, y):
            touch = next(s.touch for s in axis.plant.switches if s.pin == pin)
            stage.place(**{axis.name: touch + (3e-4 if minus else -3e-4)})
            start_endless_move(axis, minus)
        stage.run(0.05)
        observed = read_stage(stage)
        results[f"{pin} {'minus' if minus else 'plus'}"] = [
            observed["axes"],
            observed["shafts"],
            [a.pins.as_dict() for a in (x, y)],
        ]
    with faults.switch_stuck(y, "org", True):
        results["stuck"] = [y.pins.as_dict(), y.switches.as_dict()]
        replica = copy.deepcopy(stage)
    results["mended"] = [y.pins.as_dict(), replica.axes["y"].pins.as_dict(), replica.faults]
    return results


def count_encoders():
    """Let chips count encoders: both ways, on the carriage and on the motor, after a snapshot, in a journal."""
    results = {}
    for cls, encoders in (
        (MCX514, {"y": -4e5, "x": 2e5}),
        (MCX304, [Encoder("y", per_turn=2000)]),
        (MCX312, {"x": 1e6}),
    ):
        stage = make_stage("xy", cls, encoders=encoders)
        x, y = stage.axes.values()
        stage.place(x=0.0101, y=-0.0203)
        journal = x.chip.journal(0)
        start_move(x, 1500)
        stage.run(0.06)
        saved = stage.snapshot()
        start_move(y, 700, minus=cls is MCX514)
        stage.run(0.09)
        now = [x.chip.values(), y.position, stage.state.axis_table["counts"]]
        entries = [tuple(e)[:4] for e in journal.entries]
        stage.restore(saved)
        stage.run(0.01)
        results[cls.__name__] = [now, len(entries), entries, read_positions(stage), x.chip.values()]
    return results


def lead_chips():
    """Lead chips at SYNI, and the lines of multichip interpolation: each at its own pulses, with switches on the way."""
    results = {}
    stage = make_stage("xyz", PCL240K, syni={"z": "x", "y": "x"})
    for k, axis in enumerate(stage.axes.values()):
        start_move(axis, 300 + 50 * k, minus=k == 1)
    for seconds in (0.0302, 0.05):
        stage.run(seconds)
        results[f"syni {seconds}"] = [read_stage(stage), [c.values() for c in stage.chips]]
    replica = copy.deepcopy(stage)
    replica.run(0.02)
    stage.run(0.02)
    results["twin"] = [read_positions(replica) == read_positions(stage), replica.header == stage.header]
    stage = make_stage("xyz", {"x": MCX514, "y": partial(MCX514), "z": PCL240K}, multichip=["y", "x"])
    journals = [c.journal() for c in stage.chips]
    x, y, z = stage.axes.values()
    stage.place(x=next(s.touch for s in x.plant.switches if s.pin == "sd_plus") - 2e-4)
    start_move(x, 200)
    start_move(y, 150, minus=True)
    start_move(z, 100)
    stage.run(0.0507)
    results["lines"] = [
        read_stage(stage),
        [[len(j.entries), [tuple(e)[:4] for e in j.entries]] for j in journals],
    ]
    return results


# --- another motor ---


def change_motors():
    """Fit another motor at rest and in motion; what is refused; what reset, copies and mending leave."""
    results = {}
    for model, cls, motors in (
        ("xy", PCL240K, ("17HS19-2004S1", SMALL)),
        ("xyz_servo", HCTL1100, ("14203S010", DCMotor("own", 1.0, 0.03, 1e-5, 0.1))),
    ):
        stage = make_stage(model, cls)
        x, y = list(stage.axes.values())[:2]
        start_move(x, 700)
        stage.run(0.0303)
        before = stage.snapshot()
        fault = faults.motor(x, motors[0])
        second = faults.motor(y, motors[1])
        observed = [
            fault.text,
            second.text,
            stage.faults,
            x.drive.title,
            y.drive.title,
            stage.model.dof_armature,
            x.drive == y.drive,
        ]
        observed += [
            str(attempt(stage.restore, before)),
            str(attempt(faults.motor, x, motors[0])),
            stage.header.parts != before.header.parts,
        ]
        stage.run(0.03)
        observed += [read_stage(stage)]
        replica = copy.deepcopy(stage)
        between = stage.snapshot()
        second.clear()
        fault.clear()
        observed += [
            str(attempt(stage.restore, between)),
            stage.faults,
            stage.model.dof_armature,
            stage.header == before.header,
        ]
        stage.run(0.01)
        replica.run(0.01)
        observed += [read_positions(stage), read_positions(replica), replica.faults]
        replica.reset()
        start_move(replica.axes[y.name], 300, minus=True)
        replica.run(0.02)
        observed += [read_stage(replica)]
        stage.restore(before)
        stage.run(0.01)
        results[model] = [*observed, read_positions(stage), stage.model.actuator_gainprm[:, :2]]
    x, y = list(make_stage("xy", {"x": PCL240K, "y": HCTL1100}).axes.values())
    results["refused"] = [
        str(attempt(faults.motor, a, m))
        for a, m in ((x, "14201S003"), (y, SMALL), (x, FEW), (x, "17HS4402"), (y, 5), (x, "17HS4401"))
    ]
    return results


def repair_drives():
    """Bring faults of drives about one in the other, and mend them the other way round and in the same order."""
    results = {}
    for order in (1, -1):
        stage = make_stage("xy", PCL240MS)
        x, y = stage.axes.values()
        start_move(x, 900)
        start_move(y, 900, minus=True)
        created = []
        for make_one in (
            lambda x=x: faults.phase_open(x, "b"),
            lambda x=x: faults.phase_open(x, "a"),
            lambda y=y: faults.bus_voltage(y, 6.0),
            lambda s=stage: faults.bus_voltage(s, 30.0),
            lambda y=y: faults.jam(y, 12.0),
            lambda x=x: faults.jam(x),
        ):
            created.append(make_one())
            stage.run(0.0021)
        observed = [
            [f.text for f in created],
            stage.faults,
            read_stage(stage),
            stage.model.dof_frictionloss,
            stage.model.dof_solref,
            stage.model.dof_solimp,
        ]
        replica = pickle.loads(pickle.dumps(stage))
        for fault in created[::order]:
            fault.clear()
            fault.clear()
            observed += [
                [[a.faults.bus_voltage, a.faults.open_phases] for a in (x, y)],
                list(stage.faults),
                stage.model.dof_frictionloss.copy(),
            ]
        stage.run(0.01)
        replica.reset()
        results[order] = [
            *observed,
            read_positions(stage),
            [[a.faults.bus_voltage, a.faults.open_phases] for a in replica.axes.values()],
            read_stage(replica)["axes"],
            repr(created[0]),
        ]
    stage = make_stage("xyz")
    lost = faults.lost_write(stage.axes["x"], 0, 0x15)
    replica = copy.deepcopy(stage)
    start_preset(stage.axes["x"].chip, 400)
    start_preset(replica.axes["x"].chip, 400)
    stage.run(0.02)
    replica.run(0.02)
    results["lost"] = [repr(lost), stage.faults, replica.faults, read_positions(stage), read_positions(replica)]
    return results


# --- programs ---


def measure_points():
    """Look at points of sites and bodies, compiled and by hand: at once, in a row, both ways of a wait that ends."""
    results, stage = {}, make_stage("xyz", {"y": MCX514, "x": PCL240K, "z": HCTL1100})
    m = stage.model
    site = 1 + mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SITE, "work")
    bodies = [mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_BODY, name) for name in ("x", "y")]
    points = [site, m.nsite, -bodies[0], -bodies[1], 1 - m.nbody]
    for name, program in {
        "points": lambda p: [p.sample_position(0, point, k) for point in points for k in range(3)],
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
            p.until_stopped([0], 0.02, end_on_lost_step=True),
            p.until_stopped([1], 0.5, 1e-3, True),
            p.sample_position(0),
        ],
        "end": lambda p: [p.wait(1e-3), p.ops.append((0, 9, 9, 9)), p.wait(5.0)],
    }.items():
        p = Program()
        start_preset(ProgramBus(p, 1), 700)
        p.wait(0.002)
        program(p)
        p.sample_position(2).sample_position(1).read(1, 0)
        some = [copy.deepcopy(stage) for _ in range(2)]
        other = [copy.deepcopy(stage) for _ in range(2)]
        for k, s in enumerate((*some, *other)):
            s.place(x=0.01 * (k % 2))
            if k % 2:
                faults.jam(s.axes["x"])
        played = Fleet(some, 2).play([p, p])
        by_hand = []
        for s in other:
            row, extremes = np.zeros(len(p), np.int64), np.full((m.nq, 2), np.inf) * [1, -1]
            status = program_player.play_in_python(s, np.array(p.ops), row, extremes)
            by_hand.append([status, row[-12:], extremes[:3]])
        results[name] = [
            played.results[:, -12:],
            played.extremes[:, :3],
            played.diverged,
            by_hand,
            [read_positions(s)["axes"] for s in (*some, *other)],
            [[t[n] for n in TRUTH.names] for t in Fleet(some, 1).truth()[:, 0]],
        ]
    return results


# --- samples ---


def record_samples():
    """Make two recordings one after the other at other rates; what each has seen; a fault meanwhile."""
    stage = make_stage("xyz", {"x": MCX514, "y": PCL240MS, "z": HCTL1100}, encoders={"x": 3e5})
    x, y, z = stage.axes.values()
    results = {}
    stage.run(0.00061)
    for every, seconds, axis in ((1e-3, 0.0203, x), (3.1e-4, 0.0101, y), (1e-9, 0.00149, z), (2.5e-3, 0.02, y)):
        with stage.record(every) as recording:
            start_move(axis, 400, minus=axis is y)
            stage.run(seconds)
            if axis is y:
                fault = faults.jam(y, 20.0)
            stage.run(seconds / 3)
        times = recording.column("time")
        results[str(every)] = [
            sum_columns(recording),
            len(times),
            times[0],
            times[-1],
            recording.every,
            recording.began,
            recording.duration,
            list(recording.fault_changes),
        ]
        if axis is not y:
            continue
        fault.clear()
    results["refused"] = [str(attempt(stage.record, every)) for every in (0, -1e-3, 1e6 + 1, float("nan"))]
    with stage.record(1e6) as recording:
        results["two"] = str(attempt(stage.record))
        stage.run(0.01)
    results["none"] = [len(recording.column("time")), recording.every, stage.recording]
    return results


def run_to_times():
    """Run to times anywhere: steps, conditions, polls, what they say they took."""
    stage = make_stage("xy", bus_cycle=1e-4)
    x = stage.axes["x"]
    start_endless_move(x)
    results = {"began": stage.now, "bus": stage.bus_cycle}
    for n in (0, 1, 1.0, 3):
        stage.step(n)
        results[f"step {n}"] = [stage.now, stage.time, x.time, x.position, x.commanded, x.load_angle]
    for seconds in (0, 1e-9, 2.5e-4, 1.6e-9, 1.4e-9, 0.00012345):
        stage.run(seconds)
        results[f"run {seconds}"] = [stage.now, x.position, x.commanded]
    x.wait(1e-5)
    stage.run_to(stage.now - 5)
    stage.cycle()
    for limit, poll in ((0.01, 1e-3), (2e-6, 0), (0.0031, 3e-3)):
        goal = x.chip.net(0) + 12
        results[f"until {limit} {poll}"] = attempt(
            stage.run_until, lambda goal=goal: x.chip.net(0) >= goal, limit, poll
        )
        results[f"until {limit} {poll} then"] = [stage.now, x.chip.net(0) - goal]

    def never():
        return False

    results["never"] = [str(attempt(stage.run_until, never, 1e-3)), stage.now]
    results["bounds"] = [str(attempt(stage.run, v)) for v in (-1e-9, 1e9, float("nan"), float("inf"), -0.1)]
    results["steps"] = [str(attempt(stage.step, v)) for v in (-1, 4 * 10**12 + 1, float("nan"), float("inf"), 1.5)]
    results["diverged"] = diverge(stage)
    return results


def diverge(stage):
    stage.data.qfrc_applied[stage.axes["y"].plant.dof] = 1e30
    error = None
    try:
        stage.run(0.01)
    except StageError as raised:
        error = raised
    stage.data.qfrc_applied[:] = 0
    again = pickle.loads(pickle.dumps(error))
    observed = [str(error), error.time, error.axis, str(again) == str(error), again.time, again.axis, stage.now]
    stage.run(0.001)
    return [*observed, read_positions(stage)]


def drive_left_handed_screw(folder):
    """Place a left-handed axis and run it over its switches, recorded."""
    stage = Stage(mirrored(folder), chips={"x": PCL240MS, "y": PCL240MS}, visuals=False)
    x = stage.axes["x"]
    results = {
        "plant": [[s.pin, s.touch, s.slope] for s in x.plant.switches] + [x.plant.index, x.gear, x.meters_per_pulse]
    }
    for pin, minus in (("org", False), ("el_plus", True), ("el_minus", False), ("sd_plus", True)):
        stage.reset()
        touch = next(s.touch for s in x.plant.switches if s.pin == pin)
        stage.place(x=touch + (2e-4 if not minus else -2e-4))
        with stage.record() as recording:
            start_endless_move(x, minus)
            stage.run(0.041)
        results[pin] = [
            read_stage(stage),
            sum_columns(recording)["x/commanded"],
            sum_columns(recording)["x/load_angle"],
        ]
    truth = Fleet([stage], 1).truth()[0, 0]
    return results | {"truth": [truth[n] for n in TRUTH.names]}


def turn_free_rotors():
    """Count index pulses of rotors that turn as they please, over switches that bounce and stick, and come to rest."""
    results = {}
    for speed in (0.31, -0.31, 0.02):
        stage = make_stage("xy", PCL240MS)
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
            states.append([x.switches.org, read_stage(stage)["axes"]["x"][4:6], read_stage(stage)["shafts"]])
        saved = stage.snapshot()
        bounce.clear()
        stage.run(0.003)
        stage.restore(saved)
        with faults.switch_stuck(x, "org", not x.switches.org):
            stage.run(0.0013)
            states.append([x.switches.org, read_positions(stage)])
        stage.run(0.0017)
        entries = [tuple(e)[:4] for e in journal.entries]
        gaps = [b[1] - a[1] for a, b in pairwise(entries)]
        results[str(speed)] = [states, len(entries), entries, gaps[:20], read_positions(stage)]
    return results


def load_bodies():
    """Load bodies: put, doubled, taken off; in copies; what is refused."""
    stage = make_stage("xyz")
    bodies = [stage.model.body(k).name for k in range(1, stage.model.nbody)]
    results = {"bodies": bodies}
    stage.set_payload(1.5)
    stage.set_payload(2, "x")
    stage.set_payload(0.25, "x")
    replica = pickle.loads(pickle.dumps(stage))
    replica.set_payload(0)
    results["put"] = [
        [s.payload(), s.payload("x"), s.payload("y"), s.model.body_mass, s.model.dof_M0, s.model.dof_invweight0]
        for s in (stage, replica)
    ]
    stage.reset()
    results["reset"] = [stage.payload(), stage.payload("x")]
    with faults.payload(stage, 3.0, "x") as fault:
        results["fault"] = [fault.text, stage.payload("x"), stage.model.body_mass]
    results["mended"] = [stage.payload("x"), stage.model.body_mass]
    results["refused"] = [
        str(attempt(stage.set_payload, *args)) for args in ((-1,), (1e6,), (float("nan"),), (1, "nobody"), (1, "X"))
    ]
    results["asked"] = str(attempt(stage.payload, "z1"))
    results["no site"] = str(attempt(Stage(rail_model(1), visuals=False).set_payload, 1.0))
    return results


FILES = {
    "stage_equipment": {**{name: partial(build_stage, name) for name in SETUPS}},
    "stage_equipment_at_work": {
        **{f"wired {name}": partial(wired, name) for name in ("PCL240MS", "MCX514", "MCX304")},
        "counted": count_encoders,
        "led": lead_chips,
        "refitted": change_motors,
        "supplies": repair_drives,
        "pointed": measure_points,
        "sampled": record_samples,
        "in time": run_to_times,
        "turned": drive_left_handed_screw,
        "free": turn_free_rotors,
        "loads": load_bodies,
    },
}
