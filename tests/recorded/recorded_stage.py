"""Short scenes on stages: every model and chip, drives, switches, faults, payloads, snapshots, fleets, recordings, boards."""

import copy
import itertools
import pickle
from functools import partial

import numpy as np
from recorded import recorded_chips
from recorded.store import digits
from support import nova_programs as nova
from support import servo_programs as servo
from support.programs import start_preset

from stage import Drive, Fleet, Program, Stage, faults
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.chips.entries import SHAFT
from stage.chips.nova import Nova
from stage.drives.dc_motors import DC_MOTORS, Servo
from stage.drives.motors import MOTORS
from stage.errors import StageError
from stage.sim.play import TRUTH

CHIPS = (PCL240K, PCL240MK, PCL240MS, MCX514, MCX304, MCX302, MCX312, HCTL1100)


def make(model="xy", chips=PCL240K, **options):
    return Stage(model, chips=chips, visuals=False, **options)


def seen(stage):
    """All that can be seen of a stage now, and the records behind it."""
    axes = {}
    for name, a in stage.axes.items():
        d, net = a.electrics()
        switches = " ".join(pin for pin, on in a.switches.as_dict().items() if on)
        axes[name] = [
            a.position, a.commanded, a.lost_steps, a.load_angle, switches, int(net), digits(repr(a.pins.as_dict())),
            [float(d[field]) for field in ("offset", "current_a", "current_b", "voltage", "current")], int(d["mode"]),
            int(d["open"]),
        ]  # fmt: skip
    data, state = stage.data, stage.state
    edges = [[int(s["edge"]), int(s["on"]), int(s["toggles"]), int(s["until"])] for s in state.switches]
    return {
        "ns": stage.now, "axes": axes, "chips": [digits(repr(c.values())) for c in stage.chips],
        "speeds": data.qvel, "places": data.qpos, "force": data.qfrc_actuator, "switches": digits(repr(edges)),
        "index": [[int(a[n]) for n in ("index_on", "index_edge", "index_end", "count")] for a in state.axes],
        "power": digits(repr([c.state.tobytes() for c in stage.chips if not isinstance(c, HCTL1100)])),
    }  # fmt: skip


def go(axis, pulses=900, minus=False):
    """Begin a move as a driver of the family does."""
    chip = axis.chip
    if isinstance(chip, Nova):
        nova.move(chip, -pulses if minus and isinstance(chip, MCX514) else pulses, 1 << axis.chip_axis)
    elif isinstance(chip, HCTL1100):
        servo.move(chip, -pulses if minus else pulses)
    else:
        start_preset(chip, pulses, minus)


def run_on(axis, minus=False):
    chip = axis.chip
    if isinstance(chip, Nova):
        nova.run_on(chip, 1 << axis.chip_axis, minus)
    elif isinstance(chip, HCTL1100):
        servo.control(chip)
        servo.run_on(chip, -12 if minus else 12)
    else:
        start_preset(chip, 60_000, minus)


def moves(model, chips):
    stage = make(model, chips)
    found = []
    for k, axis in enumerate(stage.axes.values()):
        go(axis, 500 + 100 * k, minus=bool(k & 1))
    for seconds in (0.0101, 0.07, 0.15):
        stage.run(seconds)
        found.append(seen(stage))
    return found


def over_switches(chips):
    """Towards each switch and past it, from close by."""
    stage = make("xy", chips)
    x = stage.axes["x"]
    found = {}
    for s in x.plant.switches:
        for minus in (False, True):
            stage.reset()
            low, high = x.travel
            stage.place(x=min(max(s.touch + (4e-4 if minus else -4e-4), low), high))
            run_on(x, minus)
            stage.run(0.0703)
            said = seen(stage)
            found[f"{s.pin} {'minus' if minus else 'plus'}"] = [
                said["axes"]["x"],
                said["switches"],
                said["places"],
                said["chips"],
            ]
    return found


def drives():
    """Motors, microsteps, supplies; servo motors."""
    found = {}
    for motor, microsteps, volts in itertools.product(sorted(MOTORS), (1, 16, 50), (12.0, 36.0)):
        stage = make("xy", {"x": PCL240K}, drives=Drive(MOTORS[motor], microsteps=microsteps, bus_voltage=volts))
        go(stage.axes["x"], 300)
        stage.run(0.0407)
        d = stage.axes["x"].drive
        found[f"{motor} {microsteps} {volts:g}"] = [
            *seen(stage)["axes"]["x"],
            d.peak_torque,
            d.pulses_per_turn,
            d.title,
        ]
    for motor, volts in itertools.product(sorted(DC_MOTORS), (12.0, 48.0)):
        stage = make("xy", {"x": HCTL1100}, drives=Servo(DC_MOTORS[motor], bus_voltage=volts))
        go(stage.axes["x"], 300)
        stage.run(0.0407)
        d = stage.axes["x"].drive
        found[f"{motor} {volts:g}"] = [*seen(stage)["axes"]["x"], d.peak_torque, d.pulses_per_turn, d.title]
    return found


FAULTS = {
    "el stuck open": lambda s, a: faults.switch_stuck(a, "el_plus", False),
    "sd stuck closed": lambda s, a: faults.switch_stuck(a, "sd_plus", True),
    "vane of el": lambda s, a: faults.vane_missing(a, "el_plus"),
    "vane of org": lambda s, a: faults.vane_missing(a, "org"),
    "bounce": lambda s, a: faults.bounce(a, "sd_plus", 3e-3, 8),
    "bounce of el": lambda s, a: faults.bounce(a, "el_plus", 2e-3, 2),
    "payload": lambda s, a: faults.payload(s, 3.0),
    "payload of x": lambda s, a: faults.payload(s, 2.0, "x"),
    "jam": lambda s, a: faults.jam(a),
    "jam lightly": lambda s, a: faults.jam(a, 15.0),
    "volts": lambda s, a: faults.bus_voltage(a, 9.0),
    "volts of all": lambda s, a: faults.bus_voltage(s, 12.0),
    "phase a": lambda s, a: faults.phase_open(a, "a"),
    "phase b": lambda s, a: faults.phase_open(a, "b"),
    "skew": lambda s, a: faults.start_skew(a, 0.01),
    "lost": lambda s, a: faults.lost_write(a, 0, skip=1),
    "lost R2": lambda s, a: faults.lost_write(a.chip, 2, 0x01),
    "bad": lambda s, a: faults.bounce(a, "el_plus", 2e-3, 3),
    "bad phase": lambda s, a: faults.phase_open(a, "c"),
    "bad axis": lambda s, a: faults.jam(s),
    "bad volts": lambda s, a: faults.bus_voltage(a, 0),
    "bad factor": lambda s, a: faults.payload(s, 0.0),
    "bad switch": lambda s, a: faults.vane_missing(a, "sd"),
    "bad skip": lambda s, a: faults.lost_write(a, skip=-1),
    "bad force": lambda s, a: faults.jam(a, 0.0),
}


def broken(chips, pin, name):
    """A fault, and the time after its mending: over a switch, with a payload on two bodies."""
    stage = make("xy", chips)
    x = stage.axes["x"]
    stage.set_payload(2.0)
    stage.set_payload(0.5, "x")
    touch = next(s.touch for s in x.plant.switches if s.pin == pin)
    stage.place(x=touch - 1e-3)
    try:
        fault = FAULTS[name](stage, x)
    except StageError as error:
        return str(error)
    twin = copy.deepcopy(stage)
    kept = stage.snapshot()
    run_on(x)
    found = [fault.text, list(stage.faults)]
    stage.run(0.0911)
    found.append(seen(stage))
    fault.mend()
    found += [list(stage.faults), repr(fault), stage.payload(), stage.payload("x"), stage.model.body_mass]
    stage.run(0.02)
    found.append(brief(stage))
    run_on(twin.axes["x"])
    twin.run(0.0911)
    found += [brief(twin), list(twin.faults)]
    stage.restore(kept)
    stage.run(0.004)
    return [*found, brief(stage)]


def brief(stage):
    said = seen(stage)
    return [said["ns"], {name: a[:5] for name, a in said["axes"].items()}, said["chips"], said["switches"]]


def fault_scene(some):
    found = {}
    for name in some:
        found[name] = broken(PCL240K, "sd_plus" if "sd" in name or name == "bounce" else "el_plus", name)
    return found


def servo_faults():
    return {
        name: broken(HCTL1100, "el_plus", name)
        for name in ("jam", "volts", "phase a", "skew", "vane of el", "payload", "lost")
    }


def keeping():
    """Snapshots, copies, pickles, reset, place, wiped records, refusals."""
    stage = make("xyz", {"x": PCL240MS, "y": MCX304, "z": HCTL1100})
    x, y, z = stage.axes.values()
    found = {"made": seen(stage)}
    for axis in (x, y, z):
        go(axis, 400)
    stage.run(0.021)
    kept, twin, other = stage.snapshot(), copy.deepcopy(stage), pickle.loads(pickle.dumps(stage))
    stage.run(0.05)
    found["on"] = seen(stage)
    for name, one in (("twin", twin), ("pickle", other)):
        one.run(0.05)
        found[name] = brief(one)
    stage.restore(kept)
    stage.step(3)
    found["restored"] = brief(stage)
    stage.place(x=0.0123, z=-0.0049)
    found["placed"] = seen(stage)
    stage.run(0.01)
    found["after"] = brief(stage)
    x.switches.stick("org", True)
    found["stuck"] = [str(x.switches), brief(stage)]
    x.switches.stick("org", None)
    stage.reset()
    found["reset"] = [brief(stage), repr(stage), [len(c.diagnostics) for c in stage.chips]]
    import mujoco

    mujoco.mj_resetData(stage.model, stage.data)
    found["wiped"] = brief(stage)
    mujoco.mj_resetDataKeyframe(stage.model, stage.data, 0)
    found["keyframe"] = brief(stage)
    found["until"] = stage.run_until(lambda: stage.time > 0.0123, timeout=1.0, poll=2e-3)
    refused = {
        "step": lambda: stage.step(-1), "run": lambda: stage.run(float("nan")), "place": lambda: stage.place(x=9.0),
        "place q": lambda: stage.place(q=0), "until": lambda: stage.run_until(lambda: False, 0.003, poll=1.0),
        "record": lambda: stage.record(every=0), "payload": lambda: stage.set_payload(-1),
        "body": lambda: stage.set_payload(1, "nobody"),
        "switch": lambda: x.switches.stick("sd", True), "stick": lambda: x.switches.stick("org", 3),
        "see": lambda: x.switches.nothing,
        "set": lambda: setattr(x.switches, "org", True), "axis": lambda: stage.axes["q"],
        "restore": lambda: stage.restore(make().snapshot()),
        "poll": lambda: stage.run_until(lambda: True, 1.0, poll=-1), "chips": lambda: make(chips={"x": 5}),
        "model": lambda: make("xyy"),
        "drives": lambda: make(chips=HCTL1100, drives="17HS4401"), "cycle": lambda: make(bus_cycle=2),
        "none": lambda: make(chips={"q": PCL240K}),
    }  # fmt: skip
    for name, call in refused.items():
        try:
            call()
        except (StageError, KeyError, AttributeError) as error:
            found[f"refuses {name}"] = str(error)
    found["ns"] = stage.now
    return found


def index_pulses():
    """EZ of a shaft at different speeds, slices and bus cycles."""
    found = {}
    for r2, bus, place in ((300, 1e-6, 0.0), (2400, 1e-6, 0.0049), (8000, 1e-5, 0.0), (8000, 0.0, -0.0051)):
        stage = make("xy", PCL240MS, bus_cycle=bus)
        x = stage.axes["x"]
        stage.place(x=place)
        chip = x.chip
        p = Program()
        for name, value in {"R2": r2, "R1": 200, "R4": 300, "R5": 300, "R7": 60, "R13": 15 << 16}.items():
            p.register(0, chip, name, value)
        for _, _, address, value in p.command(0, 0x08).command(0, 0x40).command(0, 0x15).ops:
            chip.write(address, value)
        with stage.record(every=1e-3) as recording:
            stage.run(0.31)
            entries = [tuple(e) for e in chip.open_journal.entries if e.kind == 1 or e.kind == 2]
        found[f"{r2} {bus} {place}"] = [len(entries), digits(repr(entries), 3), brief(stage), columns(recording)]
    return found


def thrown():
    """Index pulses of a free rotor so fast that they come and go within a physics step, both ways."""
    found = {}
    for speed, cls in itertools.product((1.1, 0.6, -0.9), (PCL240MS, MCX514, HCTL1100)):
        stage = make("xy", {"x": cls})
        x = stage.axes["x"]
        if cls is not HCTL1100:
            faults.phase_open(x, "a")
            faults.phase_open(x, "b")
        journal = x.chip.journal()
        stage.data.qvel[x.plant.dof] = speed
        stage.run(0.03)
        entries = [tuple(e)[:4] for e in journal.entries if e.kind != SHAFT]
        found[f"{cls.__name__} {speed}"] = [len(entries), digits(repr(entries), 3), brief(stage)[1:]]
    return found


def columns(recording):
    """Sums of a recording's columns, whole numbers as digits."""
    found = {}
    for name, values in sorted(recording.columns.items()):
        values = np.asarray(values)
        if values.dtype.kind == "f":
            found[name] = [len(values), float(np.nansum(values)), float(np.nanmin(values)), float(np.nanmax(values))]
        else:
            found[name] = [len(values), digits(np.ascontiguousarray(values).astype("i8").tobytes())]
    return found


def recordings(chips, folder):
    """Columns, waveforms in text, states."""
    stage = make("xy", chips)
    x = stage.axes["x"]
    stage.place(x=next(s.touch for s in x.plant.switches if s.pin == "sd_plus") - 3e-4)
    with stage.record(every=2e-3) as recording:
        go(x, 300)
        stage.run(0.04)
        with faults.switch_stuck(stage.axes["y"], "org", True):
            go(stage.axes["y"], 200, minus=True)
            stage.run(0.05)
        go(x, 20, minus=True)
        stage.run(0.004)
        x.chip.reset()
        stage.run(0.003)
        go(x, 100, minus=True)
        stage.run(0.05)
    recording.to_vcd(folder / "a.vcd")
    text = (folder / "a.vcd").read_text().splitlines()
    body = [line for line in text if not line.startswith("$date") and "PulseStage" not in line]
    starts = [k for k, line in enumerate(body) if line.startswith("$enddefinitions")]
    head, rest = body[: starts[0]], body[starts[0] :]
    return {
        "columns": columns(recording), "head": head, "vcd": [len(rest),
        *(digits("\n".join(rest[k : k + 200])) for k in range(0, len(rest), 200))],
        "duration": recording.duration,
    }  # fmt: skip


def fleets():
    """Programs on fleets: compiled, and by hand where somebody watches."""
    found = {}
    for chips in (PCL240K, MCX514, HCTL1100):
        stages = [make("xy", chips) for _ in range(3)]
        fleet = Fleet(stages, threads=2)
        programs = []
        for k in range(3):
            p = Program()
            recorder = Writer(p, 0)
            go_written(recorder, chips, 300 + 100 * k)
            p.until_stopped([0], 0.05 if k == 1 else 0.4).wait(0.003).look(0).read(0, 0).measure(0.011).look(1)
            programs.append(p)
        stages[2].chips[0].journal()
        played = fleet.play(programs)
        truth = fleet.truth()
        found[chips.__name__] = {
            "results": played.results[:, -8:], "extremes": played.extremes, "diverged": played.diverged,
            "truth": [[[truth[k, j][name] for name in TRUTH.names] for j in range(2)] for k in range(3)],
        }  # fmt: skip
        try:
            fleet.play([Program().wait(1), Program(), Program().look(7)])
        except StageError as error:
            found[f"{chips.__name__} bad"] = str(error)
    return found


def programs(cls):
    """Random bus programs as chips alone play them, here with a carriage, its switches and its load."""
    found = {}
    for name in recorded_chips.programs(cls)[:: recorded_chips.ROUNDS[cls]]:
        _, ops = recorded_chips.made(cls, name)
        stage = make("xy", cls)
        chip, said = stage.chips[0], []
        for kind, *rest in ops:
            if kind in ("advance", "trace"):
                stage.run_to(stage.now + min(rest[0], 400_000) * 1_000_000_000 // chip.clock_hz)
            elif kind == "check":
                said.append([chip.net(j) for j in range(min(chip.AXES, 2))])
            elif kind == "pin":
                pins = chip.pins if rest[0] == chip.AXES else chip.axes[rest[0]].pins
                setattr(pins, *rest[1:])
            elif kind != "shaft":
                said += [value] if (value := getattr(chip, kind)(*rest)) is not None else []
        found[name] = [digits(repr(said)), brief(stage)[1]["x"], seen(stage)["switches"], digits(repr(chip.values()))]
    return found


class Writer:
    """A chip in name only: what is written to it goes into a program."""

    def __init__(self, program, axis):
        self.program, self.axis = program, axis

    def write(self, address, value):
        self.program.write(self.axis, address, value)


def go_written(writer, chips, pulses):
    if issubclass(chips, Nova):
        made = type("Told", (Writer, chips), {})
        nova.move(made(writer.program, writer.axis), pulses)
    elif chips is HCTL1100:
        servo.move(writer, pulses)
    else:
        start_preset(writer, pulses)


MODELS = ("xy", "xyz", "xyz_servo", "xy_mast")
NAMES = list(FAULTS)
FILES = {
    "stage_moves": {
        **{f"{cls.__name__}": partial(moves, "xy", cls) for cls in CHIPS},
        **{f"{model}": partial(moves, model, PCL240MK) for model in MODELS if model != "xyz_servo"},
        "xyz_servo": partial(moves, "xyz_servo", HCTL1100),
        "mixed": partial(moves, "xyz", {"x": MCX312, "y": PCL240MS, "z": MCX514}),
        "drives": drives, "index": index_pulses, "thrown": thrown,
    },
    "stage_switches": {cls.__name__: partial(over_switches, cls) for cls in (PCL240K, PCL240MS, MCX514, MCX302, HCTL1100)},
    "stage_programs": {cls.__name__: partial(programs, cls) for cls in CHIPS},
    "stage_faults": {
        **{f"{k // 7}": partial(fault_scene, NAMES[k : k + 7]) for k in range(0, len(NAMES), 7)}, "servo": servo_faults,
    },
    "stage_state": {"keeping": keeping, "fleets": fleets},
    "recordings": {cls.__name__: partial(recordings, cls) for cls in (PCL240MS, MCX514, MCX302, HCTL1100)},
}  # fmt: skip
