"""Short scenes on stages: every model and chip, drives, switches, faults, payloads, snapshots, fleets, recordings, boards."""

import copy
import itertools
import pickle
from functools import partial

from recorded import chip_programs
from recorded.observation import (
    make_stage,
    read_positions,
    read_stage,
    start_endless_move,
    start_move,
    sum_columns,
    write_move,
)

from stage import Drive, Fleet, Program, faults
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.chips.journal_entries import SHAFT
from stage.drives.dc_motors import DC_MOTORS, Servo
from stage.drives.motors import MOTORS
from stage.errors import StageError
from stage.sim.program_player import TRUTH

CHIPS = (PCL240K, PCL240MK, PCL240MS, MCX514, MCX304, MCX302, MCX312, HCTL1100)


def run_moves(model, chips):
    stage = make_stage(model, chips)
    results = []
    for k, axis in enumerate(stage.axes.values()):
        start_move(axis, 500 + 100 * k, minus=bool(k & 1))
    for seconds in (0.0101, 0.07, 0.15):
        stage.run(seconds)
        results.append(read_stage(stage))
    return results


def cross_switches(chips):
    """Move towards each switch and past it, from close by."""
    stage = make_stage("xy", chips)
    x = stage.axes["x"]
    results = {}
    for s in x.plant.switches:
        for minus in (False, True):
            stage.reset()
            low, high = x.travel
            stage.place(x=min(max(s.touch + (4e-4 if minus else -4e-4), low), high))
            start_endless_move(x, minus)
            stage.run(0.0703)
            observed = read_stage(stage)
            results[f"{s.pin} {'minus' if minus else 'plus'}"] = [
                observed["axes"]["x"],
                observed["places"],
                observed["chips"],
            ]
    return results


def try_drives():
    """Try motors, microsteps, supplies; servo motors."""
    results = {}
    for motor, microsteps, volts in itertools.product(sorted(MOTORS), (1, 16, 50), (12.0, 36.0)):
        stage = make_stage("xy", {"x": PCL240K}, drives=Drive(MOTORS[motor], microsteps=microsteps, bus_voltage=volts))
        start_move(stage.axes["x"], 300)
        stage.run(0.0407)
        d = stage.axes["x"].drive
        results[f"{motor} {microsteps} {volts:g}"] = [
            *read_stage(stage)["axes"]["x"],
            d.peak_torque,
            d.pulses_per_turn,
            d.title,
        ]
    for motor, volts in itertools.product(sorted(DC_MOTORS), (12.0, 48.0)):
        stage = make_stage("xy", {"x": HCTL1100}, drives=Servo(DC_MOTORS[motor], bus_voltage=volts))
        start_move(stage.axes["x"], 300)
        stage.run(0.0407)
        d = stage.axes["x"].drive
        results[f"{motor} {volts:g}"] = [*read_stage(stage)["axes"]["x"], d.peak_torque, d.pulses_per_turn, d.title]
    return results


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


def break_and_repair(chips, pin, name):
    """Bring a fault about, and see the time after its mending: over a switch, with a payload on two bodies."""
    stage = make_stage("xy", chips)
    x = stage.axes["x"]
    stage.set_payload(2.0)
    stage.set_payload(0.5, "x")
    touch = next(s.touch for s in x.plant.switches if s.pin == pin)
    stage.place(x=touch - 1e-3)
    try:
        fault = FAULTS[name](stage, x)
    except StageError as error:
        return str(error)
    replica = copy.deepcopy(stage)
    saved = stage.snapshot()
    start_endless_move(x)
    results = [fault.text, list(stage.faults)]
    stage.run(0.0911)
    results.append(read_stage(stage))
    fault.clear()
    results += [list(stage.faults), repr(fault), stage.payload(), stage.payload("x"), stage.model.body_mass]
    stage.run(0.02)
    results.append(read_positions(stage))
    start_endless_move(replica.axes["x"])
    replica.run(0.0911)
    results += [read_positions(replica), list(replica.faults)]
    stage.restore(saved)
    stage.run(0.004)
    return [*results, read_positions(stage)]


def break_each(some):
    results = {}
    for name in some:
        results[name] = break_and_repair(PCL240K, "sd_plus" if "sd" in name or name == "bounce" else "el_plus", name)
    return results


def break_servos():
    return {
        name: break_and_repair(HCTL1100, "el_plus", name)
        for name in ("jam", "volts", "phase a", "skew", "vane of el", "payload", "lost")
    }


def keep_states():
    """Try snapshots, copies, pickles, reset, place, wiped records, refusals."""
    stage = make_stage("xyz", {"x": PCL240MS, "y": MCX304, "z": HCTL1100})
    x, y, z = stage.axes.values()
    results = {"made": read_stage(stage)}
    for axis in (x, y, z):
        start_move(axis, 400)
    stage.run(0.021)
    saved, replica, other = stage.snapshot(), copy.deepcopy(stage), pickle.loads(pickle.dumps(stage))
    stage.run(0.05)
    results["on"] = read_stage(stage)
    for name, one in (("twin", replica), ("pickle", other)):
        one.run(0.05)
        results[name] = read_positions(one)
    stage.restore(saved)
    stage.step(3)
    results["restored"] = read_positions(stage)
    stage.place(x=0.0123, z=-0.0049)
    results["placed"] = read_stage(stage)
    stage.run(0.01)
    results["after"] = read_positions(stage)
    x.switches.stick("org", True)
    results["stuck"] = [str(x.switches), read_positions(stage)]
    x.switches.stick("org", None)
    stage.reset()
    results["reset"] = [read_positions(stage), repr(stage), [len(c.diagnostics) for c in stage.chips]]
    import mujoco

    mujoco.mj_resetData(stage.model, stage.data)
    results["wiped"] = read_positions(stage)
    mujoco.mj_resetDataKeyframe(stage.model, stage.data, 0)
    results["keyframe"] = read_positions(stage)
    results["until"] = stage.run_until(lambda: stage.time > 0.0123, timeout=1.0, poll=2e-3)
    refused = {
        "step": lambda: stage.step(-1), "run": lambda: stage.run(float("nan")), "place": lambda: stage.place(x=9.0),
        "place q": lambda: stage.place(q=0), "until": lambda: stage.run_until(lambda: False, 0.003, poll=1.0),
        "record": lambda: stage.record(every=0), "payload": lambda: stage.set_payload(-1),
        "body": lambda: stage.set_payload(1, "nobody"),
        "switch": lambda: x.switches.stick("sd", True), "stick": lambda: x.switches.stick("org", 3),
        "see": lambda: x.switches.nothing,
        "set": lambda: setattr(x.switches, "org", True), "axis": lambda: stage.axes["q"],
        "restore": lambda: stage.restore(make_stage().snapshot()),
        "poll": lambda: stage.run_until(lambda: True, 1.0, poll=-1),
        "model": lambda: make_stage("xyy"),
        "drives": lambda: make_stage(chips=HCTL1100, drives="17HS4401"), "cycle": lambda: make_stage(bus_cycle=2),
        "none": lambda: make_stage(chips={"q": PCL240K}),
    }  # fmt: skip
    for name, call in refused.items():
        try:
            call()
        except (StageError, KeyError, AttributeError) as error:
            results[f"refuses {name}"] = str(error)
    results["ns"] = stage.now
    return results


def count_index_pulses():
    """Count EZ of a shaft at different speeds, slices and bus cycles."""
    results = {}
    for r2, bus, place in ((300, 1e-6, 0.0), (2400, 1e-6, 0.0049), (8000, 1e-5, 0.0), (8000, 0.0, -0.0051)):
        stage = make_stage("xy", PCL240MS, bus_cycle=bus)
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
        results[f"{r2} {bus} {place}"] = [len(entries), entries, read_positions(stage), sum_columns(recording)]
    return results


def throw_rotors():
    """Count index pulses of a free rotor so fast that they come and go within a physics step, both ways."""
    results = {}
    for speed, cls in itertools.product((1.1, 0.6, -0.9), (PCL240MS, MCX514, HCTL1100)):
        stage = make_stage("xy", {"x": cls})
        x = stage.axes["x"]
        if cls is not HCTL1100:
            faults.phase_open(x, "a")
            faults.phase_open(x, "b")
        journal = x.chip.journal()
        stage.data.qvel[x.plant.dof] = speed
        stage.run(0.03)
        entries = [tuple(e)[:4] for e in journal.entries if e.kind != SHAFT]
        results[f"{cls.__name__} {speed}"] = [len(entries), entries, read_positions(stage)]
    return results


def record_columns(chips, folder):
    """Record columns and waveforms."""
    stage = make_stage("xy", chips)
    x = stage.axes["x"]
    stage.place(x=next(s.touch for s in x.plant.switches if s.pin == "sd_plus") - 3e-4)
    with stage.record(every=2e-3) as recording:
        start_move(x, 300)
        stage.run(0.04)
        with faults.switch_stuck(stage.axes["y"], "org", True):
            start_move(stage.axes["y"], 200, minus=True)
            stage.run(0.05)
        start_move(x, 20, minus=True)
        stage.run(0.004)
        x.chip.reset()
        stage.run(0.003)
        start_move(x, 100, minus=True)
        stage.run(0.05)
    recording.to_vcd(folder / "a.vcd")
    text = (folder / "a.vcd").read_text().splitlines()
    body = [line for line in text if not line.startswith("$date") and "PulseStage" not in line]
    starts = [k for k, line in enumerate(body) if line.startswith("$enddefinitions")]
    head, rest = body[: starts[0]], body[starts[0] :]
    return {
        "columns": sum_columns(recording), "head": head, "vcd": rest,
        "duration": recording.duration,
    }  # fmt: skip


def play_fleets():
    """Play programs on fleets: compiled, and by hand where somebody watches."""
    results = {}
    for chips in (PCL240K, MCX514, HCTL1100):
        stages = [make_stage("xy", chips) for _ in range(3)]
        fleet = Fleet(stages, threads=2)
        programs = []
        for k in range(3):
            p = Program()
            write_move(p, 0, chips, 300 + 100 * k)
            p.until_stopped([0], 0.05 if k == 1 else 0.4).wait(0.003)
            p.sample_position(0).read(0, 0).measure(0.011).sample_position(1)
            programs.append(p)
        stages[2].chips[0].journal()
        played = fleet.play(programs)
        truth = fleet.truth()
        results[chips.__name__] = {
            "results": played.results[:, -8:], "extremes": played.extremes, "diverged": played.diverged,
            "truth": [[[truth[k, j][name] for name in TRUTH.names] for j in range(2)] for k in range(3)],
        }  # fmt: skip
        try:
            fleet.play([Program().wait(1), Program(), Program().sample_position(7)])
        except StageError as error:
            results[f"{chips.__name__} bad"] = str(error)
    return results


def play_programs(cls):
    """Play random bus programs as chips alone play them, here with a carriage, its switches and its load."""
    results = {}
    for name in [f"{story}-{k}" for story, weight in chip_programs.weigh_stories(cls).items() for k in range(weight)]:
        _, ops = chip_programs.draw_program(cls, name)
        stage = make_stage("xy", cls)
        chip, observed = stage.chips[0], []
        for kind, *rest in ops:
            if kind in ("advance", "trace"):
                stage.run_to(stage.now + min(rest[0], 400_000) * 1_000_000_000 // chip.clock_hz)
            elif kind == "check":
                observed.append([chip.net(j) for j in range(min(chip.AXES, 2))])
            elif kind == "pin":
                pins = chip.pins if rest[0] == chip.AXES else chip.axes[rest[0]].pins
                setattr(pins, *rest[1:])
            elif kind != "shaft":
                observed += [value] if (value := getattr(chip, kind)(*rest)) is not None else []
        results[name] = [observed, read_positions(stage)["axes"]["x"], chip.values()]
    return results


MODELS = ("xy", "xyz", "xyz_servo", "xy_mast")
NAMES = list(FAULTS)
FILES = {
    "stage_moves": {
        **{f"{cls.__name__}": partial(run_moves, "xy", cls) for cls in CHIPS},
        **{f"{model}": partial(run_moves, model, PCL240MK) for model in MODELS if model != "xyz_servo"},
        "xyz_servo": partial(run_moves, "xyz_servo", HCTL1100),
        "mixed": partial(run_moves, "xyz", {"x": MCX312, "y": PCL240MS, "z": MCX514}),
        "drives": try_drives, "index": count_index_pulses, "thrown": throw_rotors,
    },
    "stage_switches": {cls.__name__: partial(cross_switches, cls) for cls in (PCL240K, PCL240MS, MCX514, MCX302, HCTL1100)},
    "stage_programs": {cls.__name__: partial(play_programs, cls) for cls in CHIPS},
    "stage_faults": {
        **{f"{k // 7}": partial(break_each, NAMES[k : k + 7]) for k in range(0, len(NAMES), 7)}, "servo": break_servos,
    },
    "stage_state": {"keeping": keep_states, "fleets": play_fleets},
    "stage_recordings": {cls.__name__: partial(record_columns, cls) for cls in (PCL240MS, MCX514, MCX302, HCTL1100)},
}  # fmt: skip
