"""Promises of `Stage` with HCTL-1100: the chip sees the shaft and its switches, drives the motor, and closes the loop."""

import copy
import math
import pickle

import mujoco
import numpy as np
import pytest
from support import servo_programs as servo
from support.programs import start_preset
from support.recording_bench import read_rrd, rerun_cli
from support.vcd_parser import parse

from stage import ArgumentError, ModelError, Stage, StageError, faults
from stage.chips import HCTL1100, PCL240K
from stage.chips.journal_entries import SHAFT, bits_to_float
from stage.drives.dc_motors import DC_MOTORS, DCMotor, Servo
from stage.drives.motors import MOTORS, Drive
from stage.recording.axis_series import make_plot_title, select_series
from stage.sim.plant import open_spec

MIXED = {"x": HCTL1100, "z": PCL240K}


@pytest.fixture(scope="module")
def fresh():
    return Stage("xyz_servo", chips=HCTL1100, visuals=False)


def get_state_bits(stage):
    return stage.snapshot().state.tobytes()


def find_switch_position(axis, switch):
    return next(s.touch for s in axis.plant.switches if s.pin == switch)


def start_all_axes(stage):
    for k, axis in enumerate(stage.axes.values()):
        servo.move(axis.chip, (3000 + 500 * k) * (-1) ** k)
    return stage


def compute_following_error(axis):
    """Counts between the carriage and where it is told to be."""
    return abs(axis.position - axis.commanded) / axis.meters_per_pulse


# --- the loop ---


def test_a_trapezoid_and_its_carriage_end_at_the_final_position(xyz):
    for axis in xyz.axes.values():
        servo.move(axis.chip, 4000)
    xyz.run_until(lambda: not any(a.pins.prof for a in xyz.axes.values()), timeout=2)
    assert xyz.time > 0.02
    xyz.run(0.3)
    for axis in xyz.axes.values():
        assert axis.chip.command_position == 4000
        assert axis.commanded == pytest.approx(4000 * axis.meters_per_pulse, abs=1e-12)
        assert compute_following_error(axis) < 10, (
            "what friction and, on Z, weight hold against a filter without an integral"
        )
        assert axis.lost_steps == 0
        assert axis.chip.diagnostics == []


def test_the_loop_resists_a_push_and_returns(xyz):
    x = xyz.axes["x"]
    servo.control(x.chip)
    xyz.run(0.05)
    xyz.data.qfrc_applied[x.plant.dof] = 50.0
    xyz.run(0.2)
    pushed = compute_following_error(x)
    xyz.data.qfrc_applied[x.plant.dof] = 0.0
    xyz.run(0.2)
    assert 5 < pushed < 200
    assert compute_following_error(x) < pushed
    assert xyz.axes["y"].chip.motor_command == 0, "an axis in Init/Idle is left alone"


def test_without_control_z_sinks_and_with_control_it_does_not(xyz):
    z = xyz.axes["z"]
    replica = copy.deepcopy(xyz)
    servo.control(z.chip)
    xyz.run(0.5)
    replica.run(0.5)
    assert abs(z.position) < 1e-3
    assert replica.axes["z"].position < -5e-3


def test_the_chip_sees_the_shaft_where_it_is_at_any_moment(xyz):
    start_all_axes(xyz)
    for seconds in (0.01, 0.0123457, 0.05, 0.000001, 0.1):
        xyz.run(seconds)
        for axis in xyz.axes.values():
            assert -1e-3 < axis.position / axis.meters_per_pulse - axis.chip.encoder < 1 + 1e-3, "the count below"
    assert all(abs(a.chip.encoder) > 500 for a in xyz.axes.values())


def test_the_voltage_at_the_motor_is_the_motor_command_of_full_drive(xyz):
    x = xyz.axes["x"]
    for command in (0, 25, -50, 100, 127):
        xyz.reset()
        x.chip.write(0x09, command & 0xFF)
        with xyz.record(every=2.5e-4) as recorded:
            xyz.step(8)
        volts = recorded.column("x/voltage")
        assert volts[1:] == pytest.approx(24.0 * max(min(command, 100), -100) / 100, abs=1e-9)
        currents = recorded.column("x/current_a")
        assert recorded.column("x/torque") == pytest.approx(x.drive.motor.torque_constant * currents)
        assert np.sign(x.position) == np.sign(command)


def test_full_drive_reaches_the_speed_that_the_back_emf_allows(xyz):
    """The screw's friction takes some of it."""
    x = xyz.axes["x"]
    x.chip.write(0x09, 100)
    xyz.run(0.25)
    omega = xyz.data.qvel[x.plant.dof] * x.gear
    no_load = 24.0 / x.drive.motor.torque_constant
    assert 0.5 * no_load < omega < no_load


def test_integral_velocity_moves_so_many_counts_a_second(xyz):
    x = xyz.axes["x"]
    servo.control(x.chip)
    servo.run_on(x.chip, 4)
    xyz.run(0.3)
    before, at = x.position, xyz.time
    xyz.run(0.2)
    rate = (x.position - before) / x.meters_per_pulse / (xyz.time - at)
    assert rate == pytest.approx(4 * x.chip.clock_hz / 256, rel=0.01)


# --- switches ---


@pytest.mark.parametrize(("switch", "pin"), [("el_plus", "limit"), ("el_minus", "limit"), ("org", "stop")])
def test_switches_are_wired_to_limit_and_stop(xyz, switch, pin):
    direction = 1 if switch == "el_plus" else -1
    for axis in xyz.axes.values():
        for on in (False, True):
            xyz.place(**{axis.name: find_switch_position(axis, switch) + direction * (1e-3 if on else -1e-3)})
            assert getattr(axis.switches, switch) == on
            assert getattr(axis.pins, pin) == on
        xyz.place(**{axis.name: 0.0})
        assert not axis.pins.limit
        assert not axis.pins.stop


def test_either_of_two_switches_on_a_pin_asserts_it_and_it_lets_go_with_the_last(xyz):
    x = xyz.axes["x"]
    x.switches.stick("el_plus", True)
    assert x.pins.limit
    xyz.place(x=find_switch_position(x, "el_minus") - 1e-3)
    assert x.pins.limit
    x.switches.stick("el_plus", None)
    assert x.pins.limit, "EL- is still on"
    xyz.place(x=0.0)
    assert not x.pins.limit


@pytest.mark.parametrize(("name", "plus"), [("x", True), ("y", False)])
def test_limit_ends_every_mode_on_the_clock_of_the_edge(xyz, name, plus):
    axis = xyz.axes[name]
    direction = 1 if plus else -1
    xyz.place(**{name: find_switch_position(axis, "el_plus" if plus else "el_minus") - direction * 2e-3})
    axis.chip.write(0x13, 0)
    servo.move(axis.chip, 800 * direction)
    with xyz.record() as recorded:
        xyz.run_until(lambda: axis.pins.limit, timeout=1)
    edges = np.concatenate(list(recorded.journals[name].replay_in_pieces()))
    at = np.flatnonzero(edges["inputs"] & axis.chip.INPUTS["limit"])[0]
    assert edges["outputs"][at] & axis.chip.OUTPUTS["init"]
    assert not edges["outputs"][at - 1] & axis.chip.OUTPUTS["init"]
    xyz.run(0.3)
    assert axis.pins.init
    assert not axis.chip.read(0x07) & 0x80, "LIMIT has triggered"


def test_stop_at_org_ends_integral_velocity(xyz):
    x = xyz.axes["x"]
    xyz.place(x=find_switch_position(x, "org") + 3e-3)
    x.chip.write(0x13, 0)
    servo.control(x.chip)
    servo.run_on(x.chip, -4)
    xyz.run_until(lambda: x.pins.stop, timeout=1)
    xyz.run(0.3)
    assert abs(xyz.data.qvel[x.plant.dof]) < 1e-3
    assert find_switch_position(x, "org") - 3e-3 < x.position < find_switch_position(x, "org")


def test_the_index_pulse_of_the_encoder_is_index(xyz):
    t = xyz.state.axis_table[xyz.axes["y"].index]
    turn = 2 * math.pi / t.gear
    for revolutions, on in ((0.0, True), (0.3, False), (1.0, True)):
        xyz.place(y=(t.index_at + revolutions) * turn)
        assert xyz.axes["y"].pins.index == on


def test_an_index_mark_elsewhere_is_met_where_the_model_has_it():
    """<numeric name="y_index" data="0.3"/>: at 0.3 turns, and neither at -0.3 nor at 0.5"""
    spec = open_spec("xyz_servo")
    spec.add_numeric(name="y_index", data=[0.3], size=1)
    stage = Stage(spec, chips=HCTL1100, visuals=False)
    y = stage.axes["y"]
    turn = 2 * math.pi / stage.state.axis_table[y.index].gear
    for revolutions in (0.3, -0.3, 0.5, 2.3, -1.7):
        stage.place(y=revolutions * turn)
        assert y.pins.index == (revolutions not in (-0.3, 0.5)), revolutions


# --- determinism: what test_stage_chips.py does not show for every chip ---


def test_the_order_of_axes_means_nothing():
    names = ("x", "y", "z")
    one = Stage("xyz_servo", chips=dict.fromkeys(names, HCTL1100), visuals=False)
    other = Stage("xyz_servo", chips=dict.fromkeys(reversed(names), HCTL1100), visuals=False)
    for stage in (one, other):
        for k, name in enumerate(names):
            servo.move(stage.axes[name].chip, 1000 + 300 * k)
        stage.run(0.2)
    assert one.data.qpos.tobytes() == other.data.qpos.tobytes()
    for name in names:
        a, b = one.axes[name].chip, other.axes[name].chip
        assert a.state.tobytes() == b.state.tobytes()


def test_a_stage_placed_on_an_index_mark_shows_its_chip_the_shaft_first(xyz):
    """So does the journal: the commutator's ring is 0 where the mark is."""
    y = xyz.axes["y"]
    t = xyz.state.axis_table[y.index]
    journal = y.chip.journal()
    xyz.place(y=0.01)
    xyz.place(y=(t.index_at + 1) * 2 * math.pi / t.gear)
    assert y.pins.index
    journal.close()
    lone = HCTL1100()
    lone._rows[0] = journal.start_state
    for e in journal.entries:
        e.apply(lone.CORE, lone._rows)
    assert int(lone.state["ring_origin"]) == int(y.chip.state["ring_origin"]) == y.chip.encoder


def test_what_reached_a_chip_of_a_stage_brings_one_on_the_bench_to_the_same_state(xyz):
    """The shaft is in the journal, too."""
    x = xyz.axes["x"]
    journal = x.chip.journal()
    xyz.place(x=find_switch_position(x, "sd_plus"))
    servo.move(x.chip, 2500)
    xyz.run(0.1234567)
    assert x.chip.read(0x14) == x.chip.values()["R14"]
    journal.close()
    lone = HCTL1100()
    lone._rows[0] = journal.start_state
    for e in journal.entries:
        lone.advance(e.clock - lone.clock)
        e.apply(lone.CORE, lone._rows)
    lone.advance(journal.end_clock - lone.clock)
    distance = {"drive_integral"}
    for field in lone.state.dtype.names:
        assert field in distance or np.array_equal(lone.state[field], x.chip.state[field]), field
    shafts = [bits_to_float(e.a) for e in journal.entries if e.kind == SHAFT]
    assert len(shafts) > 400, "one a physics step"
    assert abs(shafts[-1] - shafts[0]) > 1000


@pytest.mark.parametrize("every_pulse", [False, True])
def test_a_replay_equals_a_chip_that_receives_the_shaft_step_by_step(xyz, every_pulse):
    """Replay shows it many steps at a time, in compiled code, and hands out pieces of any size."""
    x = xyz.axes["x"]
    journal = x.chip.journal()
    servo.move(x.chip, 1500)
    xyz.run(0.05)
    xyz.place(x=find_switch_position(x, "el_plus") - 1e-4)
    xyz.run(0.0300001)
    journal.close()
    core, rows = HCTL1100.CORE, np.frombuffer(bytearray(journal.start_state.tobytes()), HCTL1100.CORE.STATE)
    out, k = np.zeros(20_000, core.EDGE), 1
    core.write_present_edge(rows, 0, out, 0)
    for e in (*journal.entries, None):
        k += core.scan_edges(rows, journal.end_clock if e is None else e.clock, every_pulse, 0, out[k:])
        if e is not None:
            e.apply(core, rows)
        if e is None or e.kind != SHAFT:
            core.write_present_edge(rows, 0, out, k)
            k += 1
    assert k > (400 if every_pulse else 30)
    for size in (100, 5000):
        pieces = list(journal.replay_in_pieces(every_pulse, size))
        assert (np.concatenate(pieces) == out[:k]).all()
        assert max(len(p) for p in pieces) <= size


def test_a_payload_slows_a_carriage_under_the_same_voltage_and_a_snapshot_leaves_it(xyz):
    x, direction = xyz.axes["x"], []
    start = xyz.snapshot()
    for mass in (0.0, 5.0):
        xyz.restore(start)
        xyz.set_payload(mass)
        x.chip.write(0x09, 30)
        xyz.run(0.03)
        direction.append(x.position)
    xyz.restore(start)
    assert xyz.payload() == 5.0
    xyz.set_payload(0.0)
    assert 0 < direction[1] < 0.95 * direction[0]


def test_a_stage_placed_by_hand_inside_a_physics_step_continues(xyz):
    x = xyz.axes["x"]
    xyz.run(0.0101234)
    xyz.place(x=0.02)
    assert x.chip.encoder == pytest.approx(0.02 / x.meters_per_pulse, abs=1)
    replica = pickle.loads(pickle.dumps(xyz))
    for stage in (xyz, replica):
        servo.control(stage.axes["x"].chip)
        stage.run(0.02)
    assert get_state_bits(xyz) == get_state_bits(replica)


# --- which motor, which model ---


@pytest.mark.parametrize("model", ["xyz", "xy", "xy_mast", "xyz_servo"])
def test_any_model_takes_it_and_closes_the_loop(model):
    stage = Stage(model, chips=HCTL1100, visuals=False)
    for axis in stage.axes.values():
        servo.move(axis.chip, 1000)
    stage.run(0.5)
    for axis in stage.axes.values():
        assert compute_following_error(axis) < 40
        assert axis.drive.motor.name == "14201S003", "the default, where the model names a stepper"


def test_the_armature_holds_the_rotor_of_the_motor_that_is_fitted():
    separate = open_spec("xyz").compile()
    for drives in (None, "9233S013", Servo(DC_MOTORS["14204S004"])):
        stage = Stage("xyz", chips=HCTL1100, drives=drives, visuals=False)
        for axis in stage.axes.values():
            dof = axis.plant.dof
            rotor = stage.model.dof_armature[dof] - separate.dof_armature[dof] + 54e-7 * axis.gear**2
            assert rotor == pytest.approx(axis.drive.motor.rotor_inertia * axis.gear**2)


def test_the_dc_motor_of_a_model_is_used_where_it_names_none():
    spec = open_spec("xyz_servo")
    for text in list(spec.texts):
        if text.name.endswith("_motor"):
            spec.delete(text)
    x = Stage(spec, chips=HCTL1100, visuals=False).axes["x"]
    assert (x.drive.motor.torque_constant, x.drive.motor.resistance) == (0.0525, 2.7955)


def test_steppers_and_servos_share_a_stage():
    stage = Stage("xyz_servo", chips=MIXED, visuals=False)
    x, z = stage.axes["x"], stage.axes["z"]
    assert (type(x.drive), type(z.drive)) == (Servo, Drive)
    servo.move(x.chip, 2000)
    start_preset(z.chip, 1600)
    stage.run(0.8)
    assert compute_following_error(x) < 30
    assert z.position == pytest.approx(1600 * z.meters_per_pulse, abs=2 * z.meters_per_pulse)
    gain = stage.model.actuator_gaintype[[a.plant.actuator for a in (x, z)]]
    assert gain.tolist() == [mujoco.mjtGain.mjGAIN_DCMOTOR, mujoco.mjtGain.mjGAIN_FIXED]


def compile_model(name):
    spec = open_spec(name)
    spec.nuserdata = 4000
    return spec.compile()


@pytest.mark.parametrize(("model", "chips", "has"), [("xyz", HCTL1100, "<motor>"), ("xyz_servo", PCL240K, "<dcmotor>")])
def test_an_mjmodel_with_the_other_actuator_is_refused_and_left_alone(model, chips, has):
    created = compile_model(model)
    before = created.dof_armature.copy()
    with pytest.raises(ModelError, match=f"axis x: .* has a {has}: pass its path or MjSpec"):
        Stage(created, chips=chips)
    assert (created.dof_armature == before).all()


def test_an_mjmodel_with_the_right_actuator_works():
    x = Stage(compile_model("xyz_servo"), chips=HCTL1100).axes["x"]
    servo.move(x.chip, 500)
    x.wait(0.3)
    assert compute_following_error(x) < 30


@pytest.mark.parametrize(
    ("chips", "drives", "message"),
    [
        (HCTL1100, "17HS4401", "HCTL1100 drives a DC servo; '17HS4401' is none: give a Servo or a DC motor"),
        (HCTL1100, MOTORS["17HS4401"], "HCTL1100 drives a DC servo"),
        (HCTL1100, Drive(), "HCTL1100 drives a DC servo; 17HS4401, 1/16 steps is none"),
        (PCL240K, Servo(), "PCL240K drives a stepper; 14201S003, encoder of 2000 counts is none"),
        (PCL240K, "14201S003", "PCL240K drives a stepper; '14201S003' is none: give a Drive or a stepper motor"),
        (MIXED, {"x": "14201S003", "z": Servo()}, "axis z: PCL240K drives a stepper"),
        (HCTL1100, {"q": Servo()}, "unknown axis 'q'"),
        (HCTL1100, "9233S031", "unknown DC motor '9233S031'. Did you mean '9233S013'"),
        (PCL240K, "17HS4410", "unknown motor or power stage '17HS4410'. Did you mean '17HS4401'"),
        (HCTL1100, 3, "unknown DC motor 3"),
    ],
)
def test_a_drive_that_the_chip_cannot_drive_is_refused(chips, drives, message):
    with pytest.raises(ArgumentError) as error:
        Stage("xyz", chips=chips, drives=drives)
    assert message in str(error.value)


@pytest.mark.parametrize("argument", [Servo("9233S013"), DC_MOTORS["9233S013"], "9233S013"])
def test_drives_takes_a_servo_a_dc_motor_or_its_name(argument):
    stage = Stage("xyz", chips=MIXED, drives={"x": argument}, visuals=False)
    assert stage.axes["x"].drive.motor.name == "9233S013"
    assert stage.axes["z"].drive.motor.name == "17HS4401"


def test_a_user_defined_motor_drives_the_axis(fresh):
    first_result = DCMotor("mine", 1.5, 0.04, 8e-6, 0.1)
    stage = Stage("xyz", chips=HCTL1100, drives=Servo(first_result, bus_voltage=12, counts=4096), visuals=False)
    x = stage.axes["x"]
    assert x.meters_per_pulse == pytest.approx(0.01 / 4096)
    k = x.plant.actuator
    assert stage.model.actuator_gainprm[k][:2].tolist() == [1.5, 0.04]
    x.chip.write(0x09, 100)
    with stage.record(every=2.5e-4) as recorded:
        stage.step(3)
    assert recorded.column("x/voltage")[-1] == pytest.approx(12.0)


# --- faults ---


def test_half_the_supply_is_half_the_voltage(xyz):
    x = xyz.axes["x"]
    x.chip.write(0x09, 50)
    with xyz.record(every=2.5e-4) as recorded:
        xyz.step(4)
        with faults.bus_voltage(x, 12.0):
            xyz.step(4)
        xyz.step(4)
    assert recorded.column("x/voltage")[[3, 7, 11]] == pytest.approx([12.0, 6.0, 12.0])


def test_a_jam_holds_what_the_motor_can_push(xyz):
    x = xyz.axes["x"]
    replica = copy.deepcopy(xyz)
    for stage in (xyz, replica):
        stage.axes["x"].chip.write(0x09, 100)
    with faults.jam(x):
        xyz.run(0.2)
    replica.run(0.2)
    assert 0 < x.position < 0.005 * replica.axes["x"].position
    xyz.run(0.05)
    assert x.position > 1e-3


def test_a_dc_motor_has_no_phase_to_open(xyz):
    x, before = xyz.axes["x"], get_state_bits(xyz)
    with pytest.raises(ArgumentError, match="axis x has a DC motor, 14201S003, without phases: bus_voltage"):
        faults.phase_open(x, "a")
    assert not xyz.faults
    assert get_state_bits(xyz) == before


def test_switches_on_one_pin_fail_one_by_one(xyz):
    x = xyz.axes["x"]
    with faults.switch_stuck(x, "el_plus", closed=False):
        xyz.place(x=find_switch_position(x, "el_plus") + 1e-3)
        assert not x.pins.limit
        xyz.place(x=find_switch_position(x, "el_minus") - 1e-3)
        assert x.pins.limit
    with faults.vane_missing(x, "el_minus"):
        assert not x.pins.limit


def test_a_lost_write_of_the_mode_leaves_the_axis_idle(xyz):
    x = xyz.axes["x"]
    with faults.lost_write(x, address=0x05):
        servo.control(x.chip)
    assert x.pins.init
    x.chip.write(0x05, 0x03)
    assert not x.pins.init


# --- recordings ---


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """X, a servo, moves and then runs into EL+; Z, a stepper, moves; the files of it."""
    stage = Stage("xyz_servo", chips=MIXED, visuals=False)
    x = stage.axes["x"]
    stage.place(x=find_switch_position(x, "el_plus") - 0.02)
    with stage.record() as recording:
        start_preset(stage.axes["z"].chip, 1500)
        x.chip.write(0x13, 0)
        servo.move(x.chip, 2000)
        stage.run(0.3)
        servo.run_on(x.chip, 6)
        stage.run_until(lambda: x.pins.limit, timeout=2)
        stage.run(0.1)
    folder = tmp_path_factory.mktemp("servo")
    return stage, recording, recording.save(folder / "a.rrd"), recording.to_vcd(folder / "a.vcd")


def test_rerun_finds_no_fault_with_it_and_each_axis_has_the_series_of_its_kind(recorded):
    stage, _, path, _ = recorded
    assert rerun_cli("rrd", "verify", path).returncode == 0
    read = read_rrd(path)
    have = {name: {e.split("/")[3] for e in read if e.startswith(f"/axes/{name}/")} for name in "xz"}
    for name in "xz":
        assert have[name] - {"phase", "switches", "bus"} == set(select_series(stage.axes[name]))
    assert have["x"] - have["z"] == {"voltage", "current"}
    assert have["z"] - have["x"] == {"load_angle", "lost_steps"}
    about = read["/about"]["TextDocument:text"][1][0][0]
    assert "14201S003, encoder of 2000 counts | 5 um a count" in about
    assert "17HS4401, 1/16 steps | 3.125 um a pulse" in about


def test_titles_of_plots_name_the_units_of_both_kinds(recorded):
    _, mixed, _, _ = recorded
    titles = [make_plot_title(mixed, key) for key in ("rate", "counter", "voltage", "lost_steps")]
    assert titles == [
        "Pulse rate (pps | counts/s)",
        "Counter R0 (pulses | counts)",
        "Motor voltage (V)",
        "Lost steps (full steps)",
    ]
    with Stage("xy", chips=HCTL1100).record() as servos:
        assert make_plot_title(servos, "rate") == "Commanded velocity (counts/s)"
        assert make_plot_title(servos, "counter") == "Actual position (counts)"


def test_lanes_say_what_the_chip_does_and_which_pins_its_switches_assert(recorded):
    read = read_rrd(recorded[2])
    _, states = read["/axes/x/phase"]["StateChange:state"]
    assert [s[0] for s in states] == ["idle", "control", "profile", "control", "idle"]
    assert not any("el_plus" in e or "el_minus" in e for e in read if e.startswith("/axes/x"))
    times, states = read["/axes/x/switches/limit"]["StateChange:state"]
    assert [s[0] for s in states][:2] == ["off", "EL"]
    assert read["/axes/x/phase"]["StateChange:state"][0][-1] == times[1], "LIMIT acts at once"


def test_only_the_lamp_of_the_switch_that_tripped_lights(recorded):
    read = read_rrd(recorded[2])
    lit = {}
    for switch in ("el_plus", "el_minus"):
        (path,) = [e for e in read if e.endswith(f"/lamp_x_{switch}")]
        lit[switch] = [bool(r[0] < -5) for r in read[path]["Points3D:radii"][1]]
    assert lit["el_plus"][:2] == [False, True]
    assert not any(lit["el_minus"])


def test_bus_cycles_of_a_servo_are_described_in_words(recorded):
    text = " ".join(str(t) for t in read_rrd(recorded[2])["/axes/x/bus"]["TextLog:text"][1])
    for words in ("control", "set F0", "set F5", "R22 <- 32 (filter: gain K"):
        assert words in text


def test_waveforms_show_pins_positions_and_the_motor_command(recorded):
    stage, _, _, path = recorded
    vcd = parse(path)
    chip = stage.axes["x"].chip
    for pin in ("LIMIT_n", "STOP_n", "INDEX_n", "SYNC_n", "PROF", "INIT", "SIGN", "PULSE"):
        assert f"x.{pin}" in vcd.changes
    assert [v for _, v in vcd.changes["x.PROF"]] == [0, 1, 0]
    ends = [v for _, v in vcd.changes["x.R0E"]]
    assert 2000 in ends
    assert ends[-1] == chip.command_position & 0xFFFFFF
    motor = [v for _, v in vcd.changes["x.MC"]]
    assert len(set(motor)) > 20
    assert motor[-1] == chip.motor_command & 0xFF
    first = vcd.edges("x.PROF", 1)[0]
    last = vcd.edges("x.PROF", 0)[-1]
    followed = [v for t, v in vcd.changes["x.R14"] if first < t < last]
    assert len(followed) > 50
    assert max(v - (v >> 23 << 24) for v in followed) > 1900
    assert "z.POUT_n" in vcd.changes


def test_columns_are_those_of_the_truth(recorded):
    stage, recording, _, _ = recorded
    c = recording.columns
    x = stage.axes["x"]
    assert c["x/following_error"] == pytest.approx(c["x/commanded"] - c["x/position"])
    assert c["x/pulses"].max() > 2000 + round(0.13 / x.meters_per_pulse)
    assert c["x/counter"][-1] == pytest.approx((x.position - 0.13) / x.meters_per_pulse, abs=2)
    assert not c["z/voltage"].any()
    assert not c["x/lost_steps"].any()
    assert c["x/rate"].max() == pytest.approx(6 * 2_000_000 / 256)
    assert c["x/limit"].any()
    assert "x/el_plus" not in c


def test_a_streamed_file_is_that_of_save(tmp_path):
    """But for what is written in one piece at the end."""
    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    stage.place(x=find_switch_position(stage.axes["x"], "el_plus") - 5e-3)
    with stage.record(path=tmp_path / "streamed.rrd") as recording:
        servo.control(stage.axes["x"].chip)
        servo.run_on(stage.axes["x"].chip, 4)
        stage.run(2.2)
    one, other = read_rrd(recording.save(tmp_path / "saved.rrd")), read_rrd(tmp_path / "streamed.rrd")
    for entity in (e for e in one if "/lamp_" in e or "/switches" in e or "/phase" in e):
        for name, (times, values) in one[entity].items():
            assert np.array_equal(times, other[entity][name][0]), entity
            assert [str(v) for v in values] == [str(v) for v in other[entity][name][1]], entity


def test_a_stage_of_servos_is_not_driven_by_stepper_firmware(xyz):
    from stage import firmware

    with pytest.raises(StageError, match="HCTL1100"):
        firmware.preset_move(xyz.axes["x"], 100)
