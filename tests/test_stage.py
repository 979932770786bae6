"""Promises of `Stage`: determinism, snapshots, time, switches, errors."""

import copy
import pickle

import mujoco
import numpy as np
import pytest
from support.examples import SEED
from support.programs import load_registers, start_preset

from stage import ArgumentError, Fleet, Program, RunTimeout, SimulationError, Stage, StageError, firmware
from stage.board import Board
from stage.chips import PCL240K
from stage.drives import stepper
from stage.sim import engine_records, plant


@pytest.fixture(scope="module")
def fresh():
    return Stage("xyz", chips=PCL240K)


def start_all_axes(stage, pulses=3000):
    for k, axis in enumerate(stage.axes.values()):
        start_preset(axis.chip, pulses + 100 * k, minus=bool(k % 2))
    return stage


def get_state_bits(stage):
    return stage.snapshot().state.tobytes()


def test_a_preset_move_ends_on_its_pulse_and_the_carriage_follows(xyz):
    x = xyz.axes["x"]
    start_preset(x.chip, 3200)
    xyz.run_until(lambda: x.chip.pins.hold, timeout=2)
    xyz.run(0.2)
    assert x.commanded - 3200 * x.meters_per_pulse == pytest.approx(0, abs=x.meters_per_pulse)
    assert x.position == pytest.approx(x.commanded, abs=2 * x.meters_per_pulse)
    assert x.lost_steps == 0


def test_n_steps_then_m_are_n_plus_m(xyz):
    start_all_axes(xyz)
    replica = copy.deepcopy(xyz)
    xyz.step(700)
    replica.step(211)
    replica.step(489)
    assert get_state_bits(xyz) == get_state_bits(replica)


def test_cutting_time_anywhere_changes_nothing(xyz):
    """Nanosecond cuts inside physics steps, as bus cycles make them, leave every bit as it was."""
    start_all_axes(xyz)
    replica = copy.deepcopy(xyz)
    xyz.run(0.05)
    seed = SEED
    print("seed", seed)
    cuts = np.sort(np.random.default_rng(seed).integers(0, 50_000_000, 400))
    for length in np.diff([0, *cuts, 50_000_000]):
        replica.run(length * 1e-9)
    assert replica.time == xyz.time
    assert get_state_bits(xyz) == get_state_bits(replica)


@pytest.mark.parametrize("cut", [0.02, 0.0200001, 0.020137])
def test_snapshot_and_restore_continue_bit_for_bit(xyz, cut):
    start_all_axes(xyz)
    xyz.run(cut)
    before = xyz.snapshot()
    xyz.run(0.1)
    after = get_state_bits(xyz)
    xyz.restore(before)
    assert get_state_bits(xyz) == before.state.tobytes()
    xyz.run(0.1)
    assert get_state_bits(xyz) == after


@pytest.mark.parametrize("copy_stage", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_copies_continue_bit_for_bit_and_independently(xyz, copy_stage):
    start_all_axes(xyz)
    xyz.run(0.020137)
    replica = copy_stage(xyz)
    before = get_state_bits(xyz)
    replica.run(0.1)
    assert get_state_bits(xyz) == before
    xyz.run(0.1)
    assert get_state_bits(xyz) == get_state_bits(replica)


def test_a_restored_stage_has_the_diagnostics_of_then(xyz):
    chip = xyz.axes["x"].chip
    chip.write(0, 0x15)
    then, noted = xyz.snapshot(), list(chip.diagnostics)
    chip.write(0, 0x12)
    assert len(chip.diagnostics) > len(noted) > 0
    xyz.restore(then)
    assert chip.diagnostics == noted
    xyz.reset()
    assert chip.diagnostics == []


def test_reset_is_power_up(xyz):
    first = get_state_bits(xyz)
    start_all_axes(xyz).run(0.1)
    xyz.reset()
    assert get_state_bits(xyz) == first
    assert xyz.time == 0


def test_a_bus_cycle_takes_bus_time(fresh):
    slow = Stage("xyz", chips=PCL240K, bus_cycle=2.5e-6, visuals=False)
    chip = slow.axes["x"].chip
    for _ in range(1000):
        chip.read(0)
    assert slow.time == pytest.approx(2.5e-3, abs=1e-12)
    assert chip.clock == int(2.5e-3 * chip.clock_hz)


def test_a_stage_costs_less_than_64_kib_more_than_its_mjdata(fresh):
    s = fresh.state
    separate = sum(
        a.nbytes for a in (s.axis_table, s.switch_table, s.flag_edges, s.chip_table, s.clockwork, s.edges, s.saved)
    )
    assert separate + fresh.data.userdata.nbytes < 64 * 1024


def test_moving_into_el_plus_stops_within_the_pulse_and_allows_only_the_return(xyz):
    x = xyz.axes["x"]
    touch = next(s.touch for s in x.plant.switches if s.pin == "el_plus")
    xyz.place(x=touch - 0.005)
    load_registers(x.chip, R0=100_000, R1=75, R2=75, R4=300, R5=300, R6=0, R7=30)
    for command in (0x44, 0x10):
        x.chip.write(0, command)
    xyz.run_until(lambda: x.chip.pins.hold, timeout=10)
    assert x.chip.pins.el_plus
    lag = abs(x.commanded - x.position)
    assert x.commanded == pytest.approx(touch, abs=x.meters_per_pulse + lag)
    assert lag < 5 * x.meters_per_pulse
    stopped = x.commanded
    for command in (0x08, 0x10):
        x.chip.write(0, command)
    xyz.run(0.05)
    assert x.chip.pins.hold, "plus stays blocked"
    assert x.commanded == pytest.approx(stopped, abs=1e-9), "not one pulse more"
    for command in (0x4C, 0x08, 0x10):
        x.chip.write(0, command)
    xyz.run(0.2)
    assert not x.chip.pins.hold
    assert not x.chip.pins.el_plus, "the way back is open"


def test_with_the_switch_stuck_open_the_hard_stop_holds_and_the_motor_slips_multiples_of_an_electrical_revolution(xyz):
    x = xyz.axes["x"]
    touch = next(s.touch for s in x.plant.switches if s.pin == "el_plus")
    x.switches.stick("el_plus", False)
    xyz.place(x=touch - 0.005)
    start_preset(x.chip, 16_000)
    xyz.run_until(lambda: x.chip.pins.hold, timeout=5)
    xyz.run(0.3)
    assert x.commanded > x.travel[1]
    assert x.position < x.travel[1] + 1e-3
    assert x.lost_steps > 0
    assert x.lost_steps % 4 == 0
    assert x.position == pytest.approx(x.commanded - x.lost_steps / 200 * 0.01, abs=0.01 / 50 / 2), (
        "behind by whole electrical turns, to within half of one"
    )


def test_switch_edges_reach_the_chip_inside_the_physics_step(xyz):
    """The clock of the edge varies finely with the start: it is not the grid of physics steps."""
    x = xyz.axes["x"]
    touch = next(s.touch for s in x.plant.switches if s.pin == "el_plus")
    clocks = set()
    for k in range(12):
        xyz.reset()
        xyz.place(x=touch - 0.002 - k * 1e-6)
        load_registers(x.chip, R0=100_000, R1=75, R2=75, R4=300, R5=300, R6=0, R7=30)
        journal = x.chip.journal()
        for command in (0x44, 0x10):
            x.chip.write(0, command)
        xyz.run_until(lambda: x.chip.pins.el_plus, timeout=2)
        journal.close()
        edge = next(e for e in journal.entries if e.kind == 1)
        clocks.add(edge.clock % 1228)
    assert len(clocks) >= 8


def test_place_makes_no_jump(xyz):
    xyz.place(x=0.1234567, y=-0.05)
    x = xyz.axes["x"]
    xyz.run(0.1)
    assert x.position == pytest.approx(0.1234567, abs=2 * x.meters_per_pulse)
    assert x.lost_steps == 0


def test_a_placed_carriage_is_at_rest_after_any_motion(xyz):
    """stage.run(0.1); stage.place(x=0.05) in the middle of a move: the carriage is at rest, as put there by hand"""
    x, y = xyz.axes["x"], xyz.axes["y"]
    start_all_axes(xyz, 16_000).run(0.3)
    going = abs(xyz.data.qvel.copy())
    xyz.place(x=0.05)
    assert min(going[x.plant.dof], going[y.plant.dof]) > 0.01
    assert xyz.data.qvel[x.plant.dof] == 0
    assert abs(xyz.data.qvel[y.plant.dof]) == going[y.plant.dof]


@pytest.mark.usefixtures("elsewhere")
def test_a_diverging_simulation_names_time_and_axis_and_keeps_the_state_before(xyz):
    start_all_axes(xyz).run(0.0201)
    replica = copy.deepcopy(xyz)
    xyz.data.qfrc_applied[xyz.model.joint("y").dofadr[0]] = 1e15
    with pytest.raises(SimulationError, match="axis 'y'") as caught:
        xyz.run(0.1)
    assert caught.value.axis == "y"
    assert caught.value.time == pytest.approx(0.02, abs=6e-4)
    assert np.isfinite(xyz.data.qpos).all()
    xyz.data.qfrc_applied[:] = 0
    steps = round((xyz.time - replica.time) * 1e9)
    assert steps >= -engine_records.NS_PER_SECOND
    assert abs(xyz.axes["x"].position - replica.axes["x"].position) < 1e-3


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize("name", "xyz")
def test_an_axis_that_diverges_alone_is_named(xyz, name):
    xyz.data.qfrc_applied[xyz.model.joint(name).dofadr[0]] = 1e12
    with pytest.raises(SimulationError, match=f"diverged at .* on axis '{name}'"):
        xyz.run(0.01)


@pytest.mark.usefixtures("elsewhere")
def test_a_speed_that_is_no_number_has_diverged(xyz):
    # planted: NaN speed taken for no divergence
    xyz.data.qfrc_applied[xyz.model.joint("y").dofadr[0]] = float("nan")
    with pytest.raises(SimulationError, match="diverged"):
        xyz.run(0.01)
    assert np.isfinite(xyz.data.qpos).all()
    assert np.isfinite(xyz.data.qvel).all()


def test_the_torque_of_a_step_is_that_of_the_rotor_in_the_middle_of_each_slice(xyz):
    # planted: the rotor's angle half a slice late
    x = xyz.axes["x"]
    t, w = xyz.state.axis_table[x.index], xyz.state.clockwork[0]
    xyz.data.qvel[t.dof] = v = 0.05
    d, q, count = xyz.state.drives[x.index].copy(), xyz.data.qpos[t.qpos], float(x.chip.net())
    middles = [
        (k + 0.5) * w.h - w.half for k in range(engine_records.SLICES)
    ]  # s, from the moment at which the joint stands at q
    torques = [stepper.compute_slice_torque(d, count, (q + v * tau) * t.gear, v * t.gear, w.h) for tau in middles]
    xyz.step()
    assert xyz.data.ctrl[t.actuator] == pytest.approx(np.mean(torques), rel=1e-9)


@pytest.mark.usefixtures("elsewhere")
def test_a_recording_of_a_diverging_run_holds_all_that_came_before(xyz):
    start_all_axes(xyz)
    with xyz.record() as recording:
        xyz.run(0.02)
        xyz.data.qfrc_applied[xyz.model.joint("y").dofadr[0]] = 1e15
        with pytest.raises(SimulationError):
            xyz.run(0.1)
        xyz.data.qfrc_applied[:] = 0
    assert recording.columns["time"][-1] == pytest.approx(0.02, abs=1e-3)
    assert (np.diff(recording.columns["time"]) > 0).all()


def test_a_snapshot_is_not_restored_into_a_running_recording(xyz):
    before = xyz.snapshot()
    with xyz.record(), pytest.raises(StageError, match="close the recording"):
        xyz.restore(before)
    xyz.restore(before)


def test_run_until_times_out_with_an_error_that_has_the_positions_of_the_axes(xyz):
    with pytest.raises(RunTimeout, match=r"0\.01 s.*Axis x"):
        xyz.run_until(lambda: False, timeout=0.01)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Stage("xyy"), "Did you mean"),
        (lambda: Stage("xyz", chips={"q": PCL240K}), "unknown axis 'q'"),
        (lambda: Stage("xyz", chips=42), "no chip class, nor a name of one: PCL240K, PCL240MK"),
        (lambda: Stage("xyz", chips="pcl240x"), "unknown chip 'PCL240X'. Did you mean 'PCL240K'"),
        (lambda: Stage("xyz", chips={"x": "mcx51"}), "unknown chip 'MCX51'. Did you mean 'MCX514'"),
        (lambda: Stage("xyz", drives="17HS4410"), "Did you mean '17HS4401'"),
        (lambda: Stage("xyz", bus_cycle=-1), "bus_cycle"),
    ],
)
def test_bad_arguments_are_named_with_the_near_misses(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()


def test_arguments_of_a_stage_are_checked_and_leave_it_as_it_was(xyz):
    before = get_state_bits(xyz)
    for wrong in (
        lambda: xyz.step(-1),
        lambda: xyz.step(1.5),
        # stage.step(2**60)
        lambda: xyz.step(2**60),  # did nothing
        lambda: xyz.step(float("nan")),
        lambda: xyz.run_until(lambda: True, timeout=float("nan")),
        lambda: xyz.run_until(lambda: True, timeout=2.0**60),
        lambda: xyz.run_until(lambda: True, timeout=1, poll=-1),
        lambda: xyz.set_payload(1e9),
        # stage.record(every=-1)
        lambda: xyz.record(every=-1),
        # stage.record(every=float("nan"))
        lambda: xyz.record(every=float("nan")),
        lambda: xyz.record(every=1e16),
        lambda: xyz.axes["x"].switches.stick("el_plus", 5),
        lambda: xyz.run(-1),
        lambda: xyz.run(float("nan")),
        lambda: xyz.place(w=0),
        lambda: xyz.place(x=5.0),
        lambda: xyz.axes["x"].switches.stick("el", True),
    ):
        with pytest.raises(ArgumentError):
            wrong()
    with pytest.raises(StageError, match="belongs to a stage"):
        xyz.axes["x"].chip.advance(1)
    with pytest.raises(ArgumentError, match="cannot be restored"):
        xyz.restore(Stage("xy").snapshot())
    assert get_state_bits(xyz) == before


def test_fewer_axes_can_be_driven(fresh):
    only_z = Stage("xyz", chips={"z": PCL240K}, visuals=False)
    assert list(only_z.axes) == ["z"]
    start_preset(only_z.axes["z"].chip, 800)
    only_z.run(0.5)
    assert only_z.axes["z"].lost_steps == 0


def test_all_axes_of_a_stage_are_independent(xyz):
    """Moving one axis leaves the pulses of the others alone."""
    start_preset(xyz.axes["x"].chip, 5000)
    xyz.run(1.0)
    assert xyz.axes["x"].commanded - xyz.axes["x"].meters_per_pulse * 5000 == pytest.approx(0, abs=1e-5)
    for other in "yz":
        assert xyz.axes[other].lost_steps == 0
        assert abs(xyz.axes[other].position) < 1e-5
        assert xyz.axes[other].chip.pins.hold


def test_a_refused_recording_leaves_no_recording_open(xyz, tmp_path):
    """stage.record(every=1e16) recorded for ever"""
    for wrong in ({"every": 1e16}, {"path": 5}, {"path": tmp_path / "none" / "x.rrd"}):
        with pytest.raises((StageError, TypeError)):
            xyz.record(**wrong)
        with xyz.record():
            xyz.step()


def test_the_error_for_a_heavy_payload_has_the_maximum(xyz):
    """stage.set_payload(1e9)"""
    with pytest.raises(ArgumentError, match=r"0 kg or more, and less than 1e\+06 kg"):
        xyz.set_payload(1e9)


def test_an_unknown_axis_is_a_key_error_that_names_the_near_misses(xyz):
    """stage.axes["q"]
    stage.axes["xx"]"""
    with pytest.raises(ArgumentError, match=r"^unknown axis 'xx'\. Did you mean 'x'\? Known: x, y, z\.$"):
        xyz.axes["xx"]
    with pytest.raises(KeyError):
        xyz.axes["q"]
    assert "q" not in xyz.axes
    assert xyz.axes.get("q") is None


def test_a_chip_can_be_selected_by_its_name():
    """Stage(chips="pcl240ms")"""
    assert [type(chip).__name__ for chip in Stage("xy", chips="pcl240ms", visuals=False).chips] == ["PCL240MS"] * 2
    mixed = Stage("xy", chips={"y": "PCL-240K", "x": PCL240K}, visuals=False)
    assert [type(a.chip) for a in mixed.axes.values()] == [PCL240K] * 2


@pytest.mark.parametrize("copy_stage", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_a_copied_axis_is_one_of_a_copied_stage(xyz, copy_stage):
    """x = copy.deepcopy(stage.axes["x"]); x.chip was on no stage, and x.wait moved another"""
    stage, x = copy_stage((xyz, xyz.axes["x"]))
    assert stage is not xyz
    assert x is stage.axes["x"]
    alone = copy_stage(xyz.axes["x"])
    start_preset(alone.chip, 100)
    alone.wait(0.3)
    assert alone.commanded == pytest.approx(100 * alone.meters_per_pulse, abs=alone.meters_per_pulse)
    assert alone.chip.clock > 0 == xyz.axes["x"].chip.clock
    switches = copy_stage(xyz.axes["x"].switches)
    assert switches.as_dict() == xyz.axes["x"].switches.as_dict()
    assert copy.copy(xyz.axes["x"]) is xyz.axes["x"]


def test_a_stuck_switch_stays_where_it_was_stuck_and_a_wrong_word_changes_nothing(xyz):
    """stage.axes["x"].switches.stick("el_plus", 5) toggled"""
    switches = xyz.axes["x"].switches
    for wrong in (5, -1, "on", 0.5):
        with pytest.raises(ArgumentError, match="True holds el_plus asserted, False released, None lets it work"):
            switches.stick("el_plus", wrong)
        xyz.step(3)
        assert not switches.el_plus
    switches.stick("el_plus", np.True_)
    xyz.step()
    assert switches.el_plus


def test_a_refused_stage_gives_the_callers_chip_back():
    """Stage(spec, chips={"x": lambda: chip}) with a timestep of 2 s: the chip then belonged to a stage that never was"""
    chip = PCL240K()
    chip.write(0, 0x81)
    chip.write(1, 77)
    before = chip.snapshot()
    for step in (2.0, 0.002):  # refused at once, and when all is wired
        spec = plant.open_spec("xy")
        spec.option.timestep = step
        with pytest.raises(StageError, match=r"time ?step"):
            Stage(spec, chips={"x": lambda: chip})
        assert chip.snapshot() == before
        chip.advance(1)
        chip.restore(before)
    stage = Stage("xy", chips={"x": lambda: chip}, visuals=False)
    assert stage.axes["x"].chip.values()["R1"] == chip.values()["R1"] == 77


def test_a_recording_interval_is_rounded_to_at_least_one_physics_step(xyz):
    for every, steps in ((1e-9, 1), (0.3e-3, 1), (0.45e-3, 2), (1e-3, 4)):
        with xyz.record(every) as recording:
            xyz.step(3)
            xyz.step(5)
        assert len(recording) == 8 // steps
        assert np.diff(recording.column("time")) == pytest.approx(steps * 2.5e-4)
        assert recording.every == pytest.approx(steps * 2.5e-4)
    xyz.step(5)
    assert len(recording) == 2


def test_removing_a_payload_restores_the_mass(xyz):
    body = xyz.model.site("work").bodyid[0]
    before = xyz.model.body_mass[body], xyz.model.body_subtreemass[0]
    xyz.set_payload(2.0)
    xyz.set_payload(3.5)
    assert xyz.payload() == 3.5
    assert xyz.model.body_mass[body] == before[0] + 3.5
    assert xyz.model.body_subtreemass[0] == pytest.approx(before[1] + 3.5)
    xyz.set_payload(0)
    assert (xyz.model.body_mass[body], xyz.model.body_subtreemass[0]) == before
    assert xyz.payload() == 0


def test_run_until_says_how_long_it_took_also_where_nothing_had_to_be_waited_for(xyz):
    xyz.run(0.01)
    assert xyz.run_until(lambda: True, timeout=1) == 0
    assert xyz.run_until(lambda: xyz.time > 0.0135, timeout=1) == pytest.approx(4e-3, abs=1e-12)


CHANGED = {"timestep": (0.002, "timestep=0.002"), "integrator": (int(mujoco.mjtIntegrator.mjINT_RK4), "mjINT_RK4")}


@pytest.mark.parametrize("option", CHANGED)
def test_a_stage_whose_models_options_were_changed_refuses_to_run(xy, option):
    """stage.model.opt.timestep = 0.002: 3200 pulses lost 1020 steps; stage.model.opt.integrator = 1: 152 of 1600"""
    value, reports = CHANGED[option]
    before, built = xy.snapshot().state.tobytes(), getattr(xy.model.opt, option)
    setattr(xy.model.opt, option, value)
    for act in (
        lambda: xy.run(0.1),
        lambda: xy.step(),
        lambda: xy.run_to(10**6),
        lambda: xy.run_until(lambda: False, timeout=1),
        lambda: Fleet([xy]).play([Program().wait(0.1)]),
    ):
        with pytest.raises(StageError, match=rf"model\.opt has .*{reports}.*this stage was built with"):
            act()
    assert xy.snapshot().state.tobytes() == before
    with pytest.raises(StageError, match=rf"model\.opt has .*{reports}"):
        Board(xy).delay_us(1)
    assert xy.snapshot().state.tobytes() == before
    with pytest.raises(StageError, match=r"model\.opt"):
        firmware.preset_move(xy.axes["x"], 3200)
    setattr(xy.model.opt, option, built)
    xy.run(0.1)
    assert xy.time > 0.1


def test_a_time_to_run_to_is_an_integer_of_ns_within_the_maximum(xy):
    """stage.run_to(2**63) ran on until Ctrl-C"""
    for until in (2**63, 2**70, 10**18 + 1, 1.5, float("inf"), "x", None):
        with pytest.raises(ArgumentError, match="until="):
            xy.run_to(until)
    xy.run_to(-5)
    assert xy.now == 0
    xy.run_to(1000.0)
    assert xy.now == 1000
