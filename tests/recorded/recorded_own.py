"""Models with one thing wrong, drives and motors on their bench, words of wrong arguments, files, names, units, small helpers."""

import dataclasses
import itertools
import math
import pickle
from functools import partial

import mujoco
import numpy as np
from recorded.recorded_texts import tried
from recorded.store import digits
from support.many_axes import rail_model

from stage import (
    Drive,
    Fleet,
    Motor,
    Program,
    Stage,
    arguments,
    errors,
    examples,
    extras,
    faults,
    html,
    portable,
    units,
)
from stage.chips import HCTL1100, PCL240K, PCL240MS
from stage.drives import drive as any_drive
from stage.drives import dynamometer, stepper, trig
from stage.drives.dc_motors import DCMotor, Servo, dc_motor
from stage.drives.motors import motor, within
from stage.files import ends_as, path_of, readable, writable, written
from stage.sim import plant
from stage.sim.plant import problems, spec
from stage.sim.plant.new import NewAxis, new_model
from stage.snapshot_files import SnapshotError

# --- models ---

CHAIN = "x:slide:120mm,a:hinge:90deg"


def text_of(axes=CHAIN):
    return new_model([NewAxis.of(item) for item in axes.split(",")])


SLIPS = [
    ('joint name="x"', 'joint name="xx"'),
    ('motor name="x"', 'motor name="X1"'),
    ('motor name="a" joint="a"', 'motor name="b" joint="a"'),
    ('name="x_org"', 'name="x_orgg"'),
    ('name="x_el_plus" geom1', 'name="x_limit" geom1'),
    ('name="a_sd_minus" geom1', 'name="a_sd" geom1'),
    ('data="found dist"', 'data="found"'),
    ('data="found dist"', 'data="dist found"'),
    ('data="found dist"', 'data="found force dist"'),
    ('geom1="x_sd_plus_vane"', 'geom1="x_org_vane"'),
    ('geom2="x_el_minus_beam"', 'geom2="x_el_plus_beam"'),
    ('geom1="x_el_plus_vane" geom2="x_el_plus_beam" num', 'body1="x" geom2="x_el_plus_beam" num'),
    ('margin="-0.03" gap="0.04"', 'margin="0.001" gap="0"'),
    ('margin="-0.03" gap="0.04"', 'margin="-0.03" gap="0.0302"'),
    ('range="-0.066 0.066"', 'range="0 0"'),
    ('range="-0.066 0.066"', 'range="-0.05 0.066"'),
    ('range="-0.066 0.066"', 'range="-0.066 0.05"'),
    ('range="-0.066 0.066"', 'range="-0.2 0.2"'),
    ('type="slide" axis="1 0 0"', 'type="slide" axis="-1 0 0"'),
    ('type="hinge" axis="0 0 1"', 'type="hinge" axis="0 0 -1"'),
    ('type="hinge" axis="0 0 1" range', 'type="ball" range'),
    ('joint="x" gear="628.3185"', 'joint="x" gear="-628.3185"'),
    ('joint="x" gear="628.3185"', 'joint="x" gear="1e-7"'),
    ('joint="x" gear="628.3185"', 'joint="a" gear="10"'),
    ('<motor name="x"', '<position name="x"'),
    ('name="a_motor" data="17HS4401"', 'name="a_motor" data="17HS440"'),
    ('name="a_motor"', 'name="aa_motor"'),
    ('<text name="x_motor"', '<text name="x_unfitted" data="org sdplus"/><text name="x_motor"'),
    ('<text name="x_motor"', '<text name="x_unfitted" data="org"/><text name="x_motor"'),
    ('<text name="x_motor"', '<text name="x_tandem" data="a"/><text name="x_motor"'),
    ('<text name="x_motor"', '<text name="a_tandem" data="x aa"/><text name="x_motor"'),
    ('<text name="x_motor"', '<numeric name="x_index" data="0.25"/><text name="x_motor"'),
    ('<text name="x_motor"', '<numeric name="a_index" data="2e6"/><text name="x_motor"'),
    ('frictionloss="4"', 'frictionloss="260"'),
    ('damping="60"', 'damping="30000"'),
    ('damping="0.02"', 'damping="3"'),
    ('frictionloss="0.05"', 'frictionloss="4"'),
    ('class="stop" geom1="x_carriage" geom2="x_bumper_plus"', 'class="stop" geom1="x_carriage" geom2="x_org_beam"'),
    ("<option ", '<option ><flag contact="disable"/></option><option '),
    ("<option ", '<option ><flag sensor="disable"/></option><option '),
    ('<motor name="a" joint="a" gear="10"/>', ""),
    ('armature="2.801"', 'armature="2.0"'),
    ('<site name="work"', '<site name="works"'),
    ('geom class="frame" size', 'geom name="x_org_switch2" class="frame" size'),
    ("<actuator>", '<actuator><general name="x2" joint="x"/>'),
]


def slips(some):
    """What a stage says of a model with one thing changed, or what it makes of it."""
    text, found = text_of(), {}
    for old, new in some:
        where = f"{old} -> {new}"
        found[where] = ["(not there)"] if old not in text else None
        if old not in text:
            continue
        changed = text.replace(old, new, 1)
        try:
            stage = Stage(mujoco.MjSpec.from_string(changed), visuals=False)
        except (errors.StageError, ValueError) as error:
            found[where] = [type(error).__name__, *str(error).splitlines(), list(getattr(error, "missing", ()))]
            continue
        found[where] = [
            [a.name, a.gear, a.plant.index, a.tandem, *([s.pin, s.touch, s.slope] for s in a.plant.switches)]
            for a in stage.axes.values()
        ]
    return found


def bound():
    """What is known of axes: of all that ship, in another order, alone; of rails, and of what is told of them."""
    found = {}
    for name in plant.names():
        model = plant.open_spec(name).compile()
        found[name] = [
            plant.describe(model),
            [
                [
                    a.name,
                    a.joint,
                    a.qpos,
                    a.dof,
                    a.actuator,
                    a.gear,
                    a.travel,
                    a.hinge,
                    a.motor,
                    a.servo,
                    a.index,
                    a.tandem,
                    [[s.pin, s.touch, s.slope, s.lookahead] for s in a.switches],
                ]
                for a in plant.bind(model)
            ],
            plant.motors(model),
            plant.motors(plant.open_spec(name)),
            [plant.dc_constants(model, a.name) for a in plant.bind(model)],
        ]
    model = plant.open_spec("xyz").compile()
    found["two"] = [[a.name for a in plant.bind(model, names)] for names in (["z", "x"], ("y",), [])]
    found["near"] = [str(tried(plant.bind, model, names)) for names in (["xx"], ["x", "q"])]
    found["rails"] = plant.describe(rail_model(2).compile())
    hinges = mujoco.MjSpec.from_string(text_of("a:hinge:90deg,b:hinge:360deg,z:slide:80mm,w:slide:1.2m")).compile()
    found["hinges"] = [
        plant.describe(hinges),
        [[s.pin, s.touch, s.slope, s.lookahead] for a in plant.bind(hinges) for s in a.switches],
    ]
    found["lines"] = [
        problems.similar("x_ogr", ["x_org", None, "y_org"]),
        problems.joint_line("u"),
        problems.sensor_line("u", "org"),
        problems.sensor_line("u", "org", "v", "w"),
        problems.pair_line("a", "b"),
        problems.actuator_line("v"),
    ]
    return found


def opened(folder):
    """Paths, specs, models: what opens, and the words for what does not."""
    found = {}
    (folder / "bad.xml").write_text("<mujoco><worldbody></mujoco>")
    (folder / "empty.xml").write_text("")
    (folder / "none.xml").write_text("<mujoco><worldbody/></mujoco>")
    (folder / "x.xml").write_text(text_of("x:slide:120mm"))
    (folder / "latin.xml").write_bytes(text_of("x:slide:120mm").replace("17HS4401", "17HS4401\u00e9").encode("latin-1"))
    for given in (
        "bad.xml",
        "empty.xml",
        "none.xml",
        "x.xml",
        "gone.xml",
        "xyz.xml",
        ".",
        "xyzz",
        5,
        None,
        "latin.xml",
    ):
        said = str(
            tried(
                lambda given=given: repr(
                    Stage(folder / given if isinstance(given, str) and "." in given else given, visuals=False)
                )
            )
        )
        found[str(given)] = said.replace(str(folder), "FOLDER")[:400]
    text = text_of("x:slide:120mm")
    model = mujoco.MjModel.from_xml_string(text)
    found["no room"] = str(tried(Stage, model))
    for words in (81, 400):
        roomy = mujoco.MjModel.from_xml_string(text.replace("<asset>", f'<size nuserdata="{words}"/><asset>', 1))
        stage = tried(Stage, roomy)
        found[f"room {words}"] = (
            str(stage) if isinstance(stage, str) else [stage.state.offset, stage.model.nuserdata, stage.model is roomy]
        )
    roomy = mujoco.MjModel.from_xml_string(text.replace("<asset>", '<size nuserdata="400"/><asset>', 1))
    found["servo"] = str(tried(Stage, roomy, chips=HCTL1100))
    own = mujoco.MjSpec.from_string(text.replace("<asset>", '<size nuserdata="7"/><asset>', 1))
    stage = Stage(own, visuals=False)
    found["own"] = [stage.state.offset, stage.data.userdata[:7], own.nuserdata]
    dc = text.replace(
        '<motor name="x" joint="x" gear="628.3185"/>',
        '<dcmotor name="x" joint="x" gear="628.3185" motorconst="0.04 0.04" resistance="1.5"/>',
    )
    found["dc"] = [
        str(
            tried(
                lambda c=c, t=t: [
                    (s := Stage(mujoco.MjSpec.from_string(t), chips=c, visuals=False)).axes["x"].drive,
                    s.model.actuator_gainprm[0, :2].tolist(),
                    s.model.dof_armature.tolist(),
                ]
            )
        )
        for c in (PCL240K, HCTL1100)
        for t in (dc, dc.replace('name="x_motor"', 'name="q_motor"'), dc.replace("17HS4401", "9233S013"))
    ]
    two = mujoco.MjSpec.from_string(text)
    spec.discard_visuals(two)
    spec.discard_visuals(model)
    found["visuals"] = [two.compiler.discardvisual, two.compile().ngeom < model.ngeom]
    found["names"] = [
        plant.names(),
        tried(spec.axis_names, mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")),
        spec.texts(model),
    ]
    return found


AXES = (
    "x:slide:300mm",
    "y:slide:10mm",
    "z:slide:2m,x:slide:20cm",
    "a:hinge:20deg",
    "a:hinge:330deg",
    "a:hinge:360deg,b:hinge:6.2832rad",
    "u:slide:.5m,v:slide:50.cm,w:slide:100mm,q:slide:100mm",
    "Z:slide:80mm,a:hinge:1rad,Y:slide:80mm",
    "x1:slide:0.1m",
)
NO_AXES = (
    "x:slide:9mm",
    "x:slide:2.1m",
    "x:slide:300deg",
    "a:hinge:19deg",
    "a:hinge:331deg",
    "a:hinge:361deg",
    "a:hinge:90mm",
    "1x:slide:90mm",
    "x:slide:9.0.1mm",
    "x:slide:mm",
    "x:slides:90mm",
    "x:slide:-90mm",
    "x",
    "",
    "x:slide:90",
    " x:slide:90mm ",
    "a:hinge:359.9deg",
)


def new():
    found = {a: new_model([NewAxis.of(item) for item in a.split(",")]) for a in AXES}
    found |= {f"{a} no": str(tried(NewAxis.of, a)) for a in NO_AXES}
    return found | {"twice": tried(text_of, "x:slide:90mm,x:hinge:90deg"), "none": tried(new_model, [])}


# --- drives ---


def record_of(drive, **state):
    row = np.zeros(1, stepper.DRIVE)
    drive.fill(row[0])
    for name, value in state.items():
        row[0][name] = value
    return row


def held():
    """A drive's record under every kind of phase and mode, from currents that are far off, a few slices on: torque, currents."""
    found = {}
    for mode, opened, (m, volts) in itertools.product(
        ("chopper", "sine"), (0, 1, 2, 3), (("17HS4401", 24.0), ("SS2422-5041", 9.0))
    ):
        d = Drive(m, microsteps=4, bus_voltage=volts, mode=mode)
        said = []
        for omega, gain, n in (
            (0.0, 0.0, 8),
            (12.0, 0.0, 8),
            (-35.0, 400.0, 8),
            (160.0, 900.0, 8),
            (-160.0, 0.0, 3),
            (0.5, 50.0, 1),
        ):
            row = record_of(d, open=opened, current_a=0.4, current_b=-0.3, offset=0.2)
            counts = 7.25 + np.arange(8) * omega / 90
            torque = any_drive.effort(row.view(np.recarray)[0], counts, n, 0.0031, omega, 3.125e-5, gain)
            said.append([torque, float(row["current_a"][0]), float(row["current_b"][0])])
        found[f"{mode} {opened} {m}"] = said
    return found


def angles():
    """Angles, steps and alignment of steppers and servos, where a step is just lost and just not."""
    found = {}
    for d in (
        Drive(microsteps=1),
        Drive("17HS15-1504S", microsteps=7),
        Drive(Motor("n", 1.0, 1.0, 1e-3, 0.3, 0.01, 1e-6, 48)),
        Servo(),
        Servo("9233S013", 12.0, 400),
    ):
        said = []
        for count, theta in itertools.product((-900, -3, 0, 2, 250), (-6.5, -0.0314, 0.0, 0.0628, 0.12566, 31.4)):
            row = record_of(d, offset=0.5)
            one = row.view(np.recarray)[0]
            here = [
                any_drive.load_angle(one, count, theta),
                any_drive.behind(one, count, theta),
                any_drive.lost_steps(one, count, theta),
            ]
            any_drive.align(one, float(count), theta)
            said.append(
                [
                    *here,
                    *(float(row[n][0]) for n in ("offset", "current_a", "current_b")),
                    any_drive.at_rest(one, count),
                    any_drive.lost_steps(one, count, theta),
                ]
            )
        found[d.title + f" {d.pulses_per_turn}"] = (
            digits(repr(np.round(said, 9).tolist()), 4),
            said[7],
            said[-1],
            said[12],
        )
    row = record_of(Servo()).view(np.recarray)[0]
    said = []
    for omega, shares in ((0.0, (1.0,) * 8), (50.0, (0.5, -0.25, 0, 0, 0, 0, 0, 1.0)), (-80.0, (-1.0,) * 8)):
        volts = any_drive.effort(row, np.array(shares), 8, 0.1, omega, 3e-5, 9.0)
        said.append([volts, float(row.current_a), any_drive.torque(row, volts), any_drive.voltage(row, volts)])
    stepping = record_of(Drive()).view(np.recarray)[0]
    said.append([any_drive.torque(stepping, 0.3), any_drive.voltage(stepping, 0.3)])
    found["servo"] = said
    found["sincos"] = [trig.sincos(x) for x in (0.0, 0.7, -0.9, 1.6, -2.4, 3.2, 4.8, -5.5, 6.4, 1e4, -1e6)]
    return found


def benched():
    """The bench: courses, friction, dampers, a ramp, pull-out over speeds, resonance, what it refuses."""
    d = Drive("17HS4401", microsteps=4)
    found = {
        "pulses": [
            dynamometer.pulses(r) for r in ([0, 64_000, 64_000, 1000], [-64_000.0] * 3, [30_000.0] * 5, [0.0, 0.0])
        ],
        "slices": dynamometer.slices(0.1),
    }
    course = dynamometer.pulses(np.full(900, 2200.0))
    for name, options in {
        "free": {},
        "load": {"load": 0.05},
        "loads": {"load": np.linspace(0, 0.5, 900)},
        "viscous": {"viscous": 1e-3},
        "damper": {"damper": 2e-3, "omega": 10.0},
        "from": {"theta": 0.02, "omega": -5.0, "viscous": 0.0},
    }.items():
        trace = dynamometer.follow(d, course, 2e-5, **options)
        found[name] = [[float(trace[k][n]) for n in trace.dtype.names] for k in (0, 450, 899)] + [
            dynamometer.lost_steps(d, trace),
            dynamometer.load_angle(d, trace)[[0, -1]],
        ]
    found["start"] = [
        dynamometer.lost_in_start(d, rate, 2e-5, accel, load)
        for rate, accel, load in ((600, 0, 0), (9000, 0, 0), (4000, 40_000, 0.02))
    ]
    found["ring"] = [dynamometer.ring_down(d, 2e-5, k, v) for k, v in ((0, 0.0), (2, 0.0), (1, 1e-4))]
    found["natural"] = [
        dynamometer.natural_frequency(Drive(detent=0.03, current=0.9), 1e-5, half) for half in (False, True)
    ]
    found["out"] = dynamometer.pull_out(d, [120.0, 900.0], None, 0.3)
    sweep = dynamometer.resonance_sweep(Drive(microsteps=1), [180.0, 400.0])
    found["sweep"] = [sweep.rate, sweep.torque, sweep.ripple]
    m = d.motor
    rpm = [0.0, 60.0, 333.0, 2000.0, 30_000.0]
    found["forms"] = [
        dynamometer.closed_form(m, 12.0, 1.0, rpm),
        dynamometer.closed_form(m, 12.0, 1.0, 60.0),
        dynamometer.bound_by_both(m, 12.0, 1.0, rpm),
        dynamometer.bound_by_both(m, 12.0, 9.0, rpm),
    ]
    done = []
    table = dynamometer.pull_out_table(Drive(motor("SS2422-5041"), microsteps=2), [300.0, 1500.0], done.append)
    found["table"] = [str(table), *table, done]
    found["refused"] = [
        str(tried(f, *given, **named))
        for f, given, named in (
            (dynamometer.follow, (d, course, 0), {}),
            (dynamometer.follow, (d, [], 1e-5), {}),
            (dynamometer.follow, (d, [[1.0]], 1e-5), {}),
            (dynamometer.follow, (d, [1.0, 2.0], 1e-5, [0.1]), {}),
            (dynamometer.follow, (d, [1.0], 1e-5), {"load": -1}),
            (dynamometer.follow, (d, [1.0], 1e-5), {"damper": -1}),
            (dynamometer.lost_in_start, (d, 0, 1e-5), {}),
            (dynamometer.lost_in_start, (d, 100, 1e-5), {"accel": -1}),
            (dynamometer.ring_down, (d, 1e-5, 0, 1.0), {}),
            (dynamometer.pull_out, (d, [0.0]), {}),
            (dynamometer.pull_out, (d, []), {}),
            (dynamometer.pull_out, (d, 100.0), {"inertia": -1.0}),
            (dynamometer.natural_frequency, (d, 0), {}),
            (dynamometer.resonance_sweep, (d, [100.0], math.nan), {}),
        )
    ]
    return found


def chosen():
    """Motors and drives with every field away from its usual value, and the words for those that cannot be."""
    m = Motor("m", 1.25, 2.5, 2e-3, 0.5, 0.02, 5e-6, 400, {"resistance": "measured"})
    found = {}
    for name, d in {
        "m": Drive(m, 10, 30.0, 1.0, "sine", 0.01),
        "usual": Drive(m),
        "name": Drive("17hs4401".upper()),
        "servo": Servo(DCMotor("d", 1.0, 0.05, 0, 0.1, 12.0), 6.0, 4000),
    }.items():
        row = np.zeros(1, stepper.DRIVE)
        row["open"], row["slice"], row["offset"], row["current_a"] = 3, 1.0, 4.0, 5.0
        d.fill(row[0])
        found[name] = [
            repr(d),
            d.title,
            d.peak_torque,
            d.pulses_per_turn,
            dict(zip(row.dtype.names, row[0].tolist(), strict=True)),
            getattr(d, "per_pulse", 0),
            hash(d) == hash(dataclasses.replace(d)),
            pickle.loads(pickle.dumps(d)) == d,
        ]
    found["of motors"] = [m.rotor_teeth, m.torque_constant, DCMotor("d", 2.0, 0.05, 0, 0.1, 12.0).stall_torque]
    usual = {"motor": m, "microsteps": 16, "bus_voltage": 24.0, "current": None, "mode": "chopper", "detent": None}
    for field, values in {
        "microsteps": (0, 1, 256, 257, True, 2.5),
        "bus_voltage": (0, 400, 401, "24"),
        "current": (0, 2.5, 2.51),
        "mode": ("chop", 0),
        "detent": (-1, 0, 0.5, 0.51),
        "motor": ("17HS", 5),
    }.items():
        found[field] = [str(tried(lambda field=field, v=v: str(Drive(**usual | {field: v}).title))) for v in values]
    for field, values in {
        "counts": (3, 4, 1 << 20, (1 << 20) + 1, 4.5, True),
        "bus_voltage": (0, 400, 401),
        "motor": ("9233", m),
    }.items():
        found[f"servo {field}"] = [str(tried(lambda field=field, v=v: Servo(**{field: v}).title)) for v in values]
    for field, values in {
        "rated_current": (0, 100, 101),
        "resistance": (0, 1000, 1001),
        "inductance": (0, 1, 2),
        "holding_torque": (0, 1000, 1001),
        "detent_torque": (-1, 0, 0.5, 0.6),
        "rotor_inertia": (0, 1, 2),
        "steps_per_turn": (0, 4, 4000, 4004, 202),
    }.items():
        found[f"motor {field}"] = [
            str(tried(lambda field=field, v=v: dataclasses.replace(m, **{field: v}).name)) for v in values
        ]
    dc = DCMotor("d", 2.0, 0.05, 0, 0.1, 12.0)
    for field, values in {
        "resistance": (0, 1000, 1001),
        "torque_constant": (0, 1000, 1001),
        "rotor_inertia": (-1, 0, 1, 2),
        "continuous_torque": (0, 1000, 1001),
        "nominal_voltage": (0, 400, 401),
    }.items():
        found[f"dc {field}"] = [
            str(tried(lambda field=field, v=v: dataclasses.replace(dc, **{field: v}).name)) for v in values
        ]
    found["names"] = [
        tried(motor, "17HS44"),
        tried(dc_motor, "14201S"),
        motor(m) is m,
        dc_motor(dc) is dc,
        tried(within, "w", math.nan, 0, 1, "u"),
        tried(within, "w", 0, 0, 1, "u", True),
    ]
    return found


# --- words ---


def typed():
    """Arguments of a wrong type, each with what it may be."""
    stage = Stage("xy", visuals=False)
    x = stage.axes["x"]
    found = {}
    calls = {
        "Stage model": lambda: Stage(visual=False),
        "Stage bus": lambda: Stage("xy", bus_cycle="1us"),
        "Stage chips": lambda: Stage("xy", chip=PCL240K),
        "Stage far": lambda: Stage("xy", zzz=1),
        "Stage visuals": lambda: Stage("xy", clock="5"),
        "run": lambda: stage.run("1"),
        "run none": lambda: stage.run(None),
        "run two": lambda: stage.run(1, 2),
        "run name": lambda: stage.run(second=1),
        "step": lambda: stage.step("1"),
        "step list": lambda: stage.step([1]),
        "until": lambda: stage.run_until(True, 1.0),
        "until time": lambda: stage.run_until(lambda: False, "1"),
        "until poll": lambda: stage.run_until(lambda: False, 1.0, poll=None),
        "payload": lambda: stage.set_payload("1"),
        "payload body": lambda: stage.set_payload(1, 5),
        "place": lambda: stage.place(x="0.1"),
        "place none": lambda: stage.place(x=None),
        "record": lambda: stage.record("1"),
        "record far": lambda: stage.record(evry=1),
        "wait": lambda: x.wait("1"),
        "stuck": lambda: faults.switch_stuck("x", "org", True),
        "stuck pin": lambda: faults.switch_stuck(x, 5, True),
        "bounce": lambda: faults.bounce(x, "org", "2ms"),
        "bounce toggles": lambda: faults.bounce(x, "org", 2e-3, "4"),
        "fault payload": lambda: faults.payload(x),
        "jam": lambda: faults.jam(x, "10"),
        "volts": lambda: faults.bus_voltage(x, "9"),
        "volts of": lambda: faults.bus_voltage("x", 9),
        "phase": lambda: faults.phase_open(x, 1),
        "motor": lambda: faults.motor(x, 3),
        "skew": lambda: faults.start_skew(x, "1"),
        "lost": lambda: faults.lost_write("x"),
        "lost skip": lambda: faults.lost_write(x, skip="1"),
        "write": lambda: Program().write(0, 1),
        "wait p": lambda: Program().wait("1"),
        "Fleet": lambda: Fleet(stage),
        "Fleet threads": lambda: Fleet([stage], threads="2"),
        "play": lambda: Fleet([stage]).play(5),
        "Drive": lambda: Drive(microstep=5),
        "Drive volts": lambda: Drive(bus_voltage=[24]),
        "chip write": lambda: x.chip.write("a", 1),
        "chip read": lambda: x.chip.read(None),
        "vane": lambda: faults.vane_missing(x, "orgs"),
    }
    for name, call in calls.items():
        try:
            found[name] = str(call())[:60]
        except Exception as error:  # whatever it is
            found[name] = f"{type(error).__name__}: {error}"
    stage.run(0.001)
    found["kinds"] = {
        name: [
            words,
            [
                bool(fits(v))
                for v in (
                    5,
                    5.0,
                    5.5,
                    math.nan,
                    True,
                    None,
                    "a",
                    b"a",
                    [1],
                    {},
                    (),
                    x,
                    stage,
                    len,
                    PCL240K,
                    np.zeros(2),
                    Motor,
                )
            ],
        ]
        for name, (fits, words) in arguments.KINDS.items()
    }
    found["parts"] = [
        arguments._parts(a) for a in ("int | None", "dict[str, int | None] | str", "Callable[[], bool]", "")
    ]
    found["unlike"] = [
        [v if isinstance(v, int | str | float | list | None) else 0, a, arguments._unlike(v, a)]
        for v, a in (
            ("a", "float"),
            (1, "float"),
            ([1, "a"], "Sequence[int]"),
            ([1, 2], "Sequence[int]"),
            ("ab", "Sequence[str]"),
            (["a"], "list[str] | None"),
            (5, "str | PathLike[str] | None"),
            (5, "Unknown"),
            (5, "str | Unknown"),
            ([5], "Iterable[str]"),
            (None, "int | None"),
            (1.5, "int"),
            (5, "np.ndarray"),
        )
    ]
    return found


def errors_of():
    """Near names, articles, limits, errors that travel."""
    names = ["position", "Velocity", "el_plus", "el_minus", "sd_plus", "MCX304", "MCX314AS", "PCL240K"]
    found = {
        "near": [
            [g, errors.near_names(g, names), errors.near_names(g, names, 0.8)]
            for g in ("postion", "VELOCITY", "el", "el_pluss", "mcx3", 5, "", "zzz")
        ]
    }
    found["unknown"] = [
        str(errors.unknown("pin", g, n))
        for g, n in (("el_pls", names), ("q", ["b", "a"]), ("q", []), ("mcx30", names), (None, names))
    ]
    found["articles"] = [
        errors.a_or_an(n)
        for n in (
            "MCX304",
            "PCL240K",
            "HCTL1100",
            "ACME1000",
            "8255",
            "TMC5160",
            "Unit",
            "eight",
            "X1",
            "B52",
            "",
            "R2D2",
            "Sensor",
        )
    ]
    error = errors.ArgumentError("a").of(errors.Limit("speed", 5.0, 1.0))
    found["limit"] = [
        error.limit,
        error.limit.most,
        errors.ArgumentError("b").limit,
        str(errors.UnknownKey("no such")),
        repr(errors.UnknownKey("c")),
    ]
    for made in (
        errors.SimulationError("s", 0.5, "x"),
        errors.ModelError("m", ["a", "b"]),
        errors.ModelError("n"),
        extras.ExtraMissing("e", "plot"),
        errors.RunTimeout("r"),
    ):
        again = pickle.loads(pickle.dumps(made))
        found[type(made).__name__ + str(made)] = [
            str(again),
            {k: v for k, v in vars(again).items() if not k.startswith("__")},
            [c.__name__ for c in type(made).__mro__],
        ]
    found["extras"] = (
        [tried(extras.need, "nicegui_none", "it")]
        if "nicegui_none" in extras.LIBRARIES
        else {k: list(v) for k, v in extras.LIBRARIES.items()}
    )
    found["has"] = [extras.has("json"), extras.has("no_such_library"), extras.has("no.such.library")]
    return found


def quantities():
    """Units as typed and as told."""
    texts = (
        "10",
        "10mm",
        "-0.5deg",
        "1e3",
        " 5um ",
        "5 mm",
        "mm",
        "1,5mm",
        "1,5",
        "1,000,000",
        "2kg",
        "5mdeg",
        "3rad",
        "10m",
        "7nm",
        "1cm",
        "0x10",
        "inf",
        "nan",
        "1ms",
        "3min",
        "2kpps",
        "12V",
        "5MHz",
        "",
        "-",
        "1.5.2",
        "4g",
    )
    found = {
        t: [
            units.kind_of(t),
            units.slip(t),
            units.typed(t, "m"),
            units.typed(t, "rad"),
            units.quantity(t, units.BESIDES["time"] | {"": 1.0}),
        ]
        for t in texts
    }
    found["told"] = [
        u.text(v, *form)
        for u in (*units.PLACES.values(), *units.SMALL.values())
        for v, *form in ((0.0125,), (-1e-9,), (0.5, "g"), (1.0, ".1f"))
    ]
    return found


def drawn():
    """HTML, portable logarithms."""
    found = {
        "table": html.table([("a<b", 5), (None, '"q"')], ("x & y", 2)),
        "bare": html.table([(1,)]),
        "none": html.table([]),
        "heading": html.heading("a<b"),
        "folded": html.folded("t>u", "<i>c</i>"),
        "lines": html.lines("a\n<b>"),
    }
    values = np.array([[-1.5, -1.0, -0.5, 0.0], [1e-9, 1.0, 2.5, 800.0]])
    found |= {name: getattr(portable, name)(values) for name in ("log", "log1p", "exp", "cbrt")}
    found["power"] = [
        portable.power(np.abs(values), 1.5),
        portable.power(2.0, [0.0, -1.0, 3.0]),
        portable.geomspace(1e-3, 5.0, 4),
        portable.log(math.e),
        portable.log([]),
    ]

    def missing():
        raise extras.ExtraMissing("needs <b>", "plot")

    found["picture"] = html.picture(missing)
    return found


def filed(folder):
    """Names of files: what is written, refused, replaced, left behind; snapshots in files, whole and damaged."""
    from stage import Snapshot

    def said(call, *given, **named):
        return str(tried(call, *given, **named)).replace(str(folder), "FOLDER")

    (folder / "there.txt").write_text("old")
    (folder / "empty.txt").write_text("")
    (folder / "sub").mkdir()
    found = {}
    for name in ("there.txt", "new.txt", "sub", "gone/new.txt", "empty.txt", "there.txt/x"):
        path = folder / name
        found[name] = [
            said(readable, path, "thing"),
            *(said(writable, path, over) for over in (False, True)),
            said(writable, path, False, ask="do X"),
        ]
    found["ends"] = [
        said(ends_as, folder / n, (".rrd", ".csv"), "a recording")
        for n in ("a.rrd", "a.RRD", "a.txt", "a", "sub", "a.csv.gz")
    ]
    found["none"] = [said(path_of, 5), said(path_of, "a")]
    for name, over in (("a.txt", False), ("there.txt", False), ("there.txt", True)):
        try:
            with written(folder / name, over) as part:
                part.write_text("new")
                inside = [part.name, part.parent.parent == folder]
            found[f"write {name} {over}"] = inside
        except errors.StageError as error:
            found[f"write {name} {over}"] = str(error).replace(str(folder), "FOLDER")
    try:
        with written(folder / "b.txt", False) as part:
            part.write_text("half")
            raise OSError(28, "No space left")
    except errors.StageError as error:
        found["half"] = str(error).replace(str(folder), "FOLDER")
    stage = Stage("xy", visuals=False)
    stage.axes["x"].chip.write(0, 0x84)
    stage.axes["y"].chip.write(1, 1)
    path = stage.snapshot().save(folder / "s.snapshot")
    found["again"] = said(stage.snapshot().save, path)
    kept = Snapshot.load(path)
    found["kept"] = [repr(kept) == repr(stage.snapshot()), kept.diagnostics, kept.checksum == stage.snapshot().checksum]
    data = path.read_bytes()
    for name, changed in {
        "cut": data[:-1],
        "long": data + b"\0",
        "flip": data[:400] + bytes([data[400] ^ 1]) + data[401:],
        "magic": b"x" + data[1:],
        "format": data[:20] + b"\2" + data[21:],
        "short": data[:30],
        "none": b"PulseStage",
    }.items():
        (folder / "t.snapshot").write_bytes(changed)
        found[f"file {name}"] = said(Snapshot.load, folder / "t.snapshot")
    chip = PCL240MS()
    chip.snapshot().save(folder / "c.snapshot")
    found["another"] = [
        said(Snapshot.load, folder / "c.snapshot"),
        said(type(chip.snapshot()).load, path),
        said(Snapshot.load, folder / "gone"),
        issubclass(SnapshotError, errors.ArgumentError),
    ]
    stage.run(0.01)
    stage.restore(kept)
    found["restored"] = [stage.now, [len(c.diagnostics) for c in stage.chips]]
    found["left"] = sorted(p.name for p in folder.rglob("*"))
    found["texts"] = [(folder / n).read_text() for n in ("a.txt", "there.txt")]
    found["examples"] = [
        {n: [examples.title(n), str(examples.EXTRAS.get(n, ""))] for n in examples.PLACES},
        said(examples.place, "stal"),
        said(examples.copy, "stall", folder / "gone"),
    ]
    found["copied"] = [examples.copy(n, folder / "sub").name for n in ("stall", "tour.ipynb", "acme_chip")] + [
        said(examples.copy, "stall", folder / "sub")
    ]
    found["there"] = sorted(
        str(p.relative_to(folder / "sub"))
        for p in (folder / "sub").rglob("*")
        if p.is_file() and "/." not in str(p.relative_to(folder))
    )
    return found


FILES = {
    "own_models": {
        **{f"slips {k // 8}": partial(slips, SLIPS[k : k + 8]) for k in range(0, len(SLIPS), 8)},
        "bound": bound,
        "opened": opened,
        "new": new,
    },
    "own_drives": {"held": held, "angles": angles, "benched": benched, "chosen": chosen},
    "own_words": {"typed": typed, "errors": errors_of, "quantities": quantities, "drawn": drawn, "filed": filed},
}
