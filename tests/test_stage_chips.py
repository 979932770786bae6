"""Promises of `Stage` with chips of several axes, and of several families at once."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from support import servo_programs as servo
from support.examples import SEED
from support.nova_programs import command, load, move, run_on
from support.programs import start_preset
from support.recording_bench import read_rrd
from support.vcd_parser import parse

from stage import ArgumentError, Fleet, Program, Stage, StageError, faults
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK
from stage.chips.journal_entries import INPUT
from stage.drives.motors import MOTORS
from stage.sim import program_player
from stage.sim.engine_records import INDEX, INDEX_HYSTERESIS

MIXED = {"x": MCX514, "y": MCX514, "z": PCL240K}
ALL = {"z": PCL240K, "x": HCTL1100, "y": MCX304}


@pytest.fixture(scope="module")
def make_stage_of():
    """Stages by their chips, each made once."""
    known = {}

    def make(chips):
        key = str(chips)
        if key not in known:
            known[key] = Stage("xyz", chips=chips, visuals=False)
        stage = known[key]
        stage.reset()
        return stage

    return make


def get_state_bits(stage):
    return stage.snapshot().state.tobytes()


def touch(axis, switch):
    return next(s.touch for s in axis.plant.switches if s.pin == switch)


def make_stop_condition(stage, *names):
    """A condition; it costs no bus cycles."""
    return lambda: not any(getattr(stage.axes[n].pins, "drive", False) for n in names)


def get_net_pulses(stage):
    """Pulses, and the counts that servos are told."""
    return [a.chip.net(a.chip_axis) for a in stage.axes.values()]


def start_all_axes(stage):
    """Every axis moves, each by its own number of pulses."""
    for k, axis in enumerate(stage.axes.values()):
        pulses = (1500 + 100 * k) * (-1) ** k
        if isinstance(axis.chip, PCL240K):
            start_preset(axis.chip, abs(pulses), minus=pulses < 0)
        elif axis.chip.SERVO:
            servo.move(axis.chip, pulses)
        else:
            move(axis.chip, pulses, 1 << axis.chip_axis)
    return stage


def replay_on_bench(journal, cls):
    """The pulses that a chip on the bench makes under what reached the chip of a stage."""
    lone, traces = cls(), []
    lone._rows[0] = journal.start_state
    for e in journal.entries:
        traces.append(lone.trace(e.clock - lone.clock))
        e.apply(lone.CORE, lone._rows)
    return np.concatenate([*traces, lone.trace(journal.end_clock - lone.clock)])


ARRANGEMENTS = [MCX514, MCX304, MCX302, MIXED, {"z": MCX312, "x": MCX312, "y": PCL240K}, HCTL1100, ALL]
ids = [
    "MCX514", "MCX304", "two MCX302", "MCX514 and PCL240K", "MCX312 for z, x, and PCL240K", "HCTL1100",
    "PCL240K, HCTL1100 and MCX304",
]  # fmt: skip
EVERY = pytest.mark.parametrize("chips", ARRANGEMENTS, ids=ids)


# --- which chips, which axes ---


@pytest.mark.parametrize("cls", [MCX514, MCX304])
def test_a_chip_of_four_axes_moves_all_three(make_stage_of, cls):
    stage = make_stage_of(cls)
    assert len(stage.chips) == 1
    assert [(a.chip, a.chip_axis) for a in stage.axes.values()] == [(stage.chips[0], k) for k in range(3)]


def test_two_chips_of_two_axes_move_three(make_stage_of):
    stage = make_stage_of(MCX302)
    first, second = stage.chips
    assert [(a.chip, a.chip_axis) for a in stage.axes.values()] == [(first, 0), (first, 1), (second, 0)]


def test_a_mapping_says_which_axes_share_a_chip(make_stage_of):
    stage = make_stage_of(MIXED)
    x, y, z = stage.axes.values()
    assert (type(x.chip), x.chip_axis, y.chip_axis, type(z.chip)) == (MCX514, 0, 1, PCL240K)
    assert x.chip is y.chip
    assert set(stage.chips) == {x.chip, z.chip}


def test_axes_are_assigned_to_a_chip_in_the_order_of_the_mapping(make_stage_of):
    stage = make_stage_of({"z": MCX312, "x": MCX312, "y": PCL240K})
    assert (stage.axes["z"].chip_axis, stage.axes["x"].chip_axis) == (0, 1)


@EVERY
def test_every_axis_makes_the_pulses_commanded_and_its_carriage_follows(make_stage_of, chips):
    stage = start_all_axes(make_stage_of(chips))
    stage.run(0.6)
    for k, (net, axis) in enumerate(zip(get_net_pulses(stage), stage.axes.values(), strict=True)):
        assert net == (1500 + 100 * k) * (-1) ** k, axis.name
        assert axis.commanded == pytest.approx(net * axis.meters_per_pulse, abs=1.001 * axis.meters_per_pulse)
        near = 40 if axis.chip.SERVO else 2  # the filter of a servo has no integral, and screws have friction
        assert axis.position == pytest.approx(axis.commanded, abs=near * axis.meters_per_pulse)
        assert axis.lost_steps == 0


@pytest.mark.parametrize("name", "xyz")
def test_an_axis_of_a_chip_moves_alone(make_stage_of, name):
    stage = make_stage_of(MCX514)
    axis = stage.axes[name]
    move(axis.chip, 800, 1 << axis.chip_axis)
    stage.run(0.4)
    assert {n: p for n, p in zip(stage.axes, get_net_pulses(stage), strict=True) if p} == {name: 800}
    assert all(abs(a.position) < 1e-5 for n, a in stage.axes.items() if n != name)


def test_axes_of_one_chip_that_start_at_one_command_step_at_the_same_clocks(make_stage_of):
    """And so do those of a chip alone."""
    stage = make_stage_of(MCX514)
    chip = stage.chips[0]
    journal = chip.journal()
    move(chip, 300, 0b111)
    stage.run(0.3)
    journal.close()
    pulses = replay_on_bench(journal, MCX514)
    clocks = [pulses["clock"][pulses["axis"] == j].tolist() for j in range(3)]
    assert len(clocks[0]) == 300
    assert clocks[0] == clocks[1] == clocks[2]
    assert get_net_pulses(stage) == [300] * 3


# --- switches ---


@EVERY
@pytest.mark.parametrize("switch", ["el_plus", "el_minus", "org"])
def test_a_switch_is_wired_to_the_pin_of_its_name_on_the_chip(make_stage_of, chips, switch):
    stage = make_stage_of(chips)
    names = {"el_plus": "lmt_plus", "el_minus": "lmt_minus", "org": "stop1"}
    for axis in stage.axes.values():
        if axis.chip.SERVO:
            continue  # see test_servo_stage.py
        pins = {n: n if isinstance(axis.chip, PCL240K) else pin for n, pin in names.items()}
        assert all(pin in axis.chip.INPUTS for pin in pins.values())
        direction = 1 if switch == "el_plus" else -1
        for on in (False, True):
            q = touch(axis, switch) + direction * (1e-3 if on else -1e-3)
            stage.place(**{axis.name: min(max(q, axis.travel[0]), axis.travel[1])})
            assert getattr(axis.switches, switch) == on
            for name, pin in pins.items():
                assert getattr(axis.pins, pin) == getattr(axis.switches, name), f"{axis.name} {pin}"
        stage.place(**{axis.name: 0.0})


def test_the_index_pulse_of_the_encoder_is_stop2(make_stage_of):
    stage = make_stage_of(MIXED)
    y, z = stage.axes["y"], stage.axes["z"]
    for axis, pin in ((y, "stop2"), (z, "ez")):
        wired = axis.chip.find_switch_input("ez")
        assert wired == axis.chip.INPUTS.get(pin, 0)
    t = stage.state.axis_table[y.index]
    turn = 2 * np.pi / t.gear
    for revolutions, on in ((0.0, True), (0.3, False), (1.0, True)):
        stage.place(y=(t.index_at + revolutions) * turn)
        assert y.pins.stop2 == on


def test_an_index_pulse_within_one_step_has_its_full_width():
    """Expect the width of INDEX and its hysteresis at the speed of the rotor, which runs free."""
    motor = replace(MOTORS["17HS4401"], core_loss_resistance=None)
    stage = Stage("xy", chips=PCL240MK, drives=motor, visuals=False)
    y = stage.axes["y"]
    row = stage.state.axis_table[y.index]
    turn = 2 * np.pi / row.gear
    with faults.phase_open(y, "a"), faults.phase_open(y, "b"):
        stage.place(y=(row.index_at - 0.2) * turn)
        stage.data.qvel[row.dof] = 90 * turn
        journal = y.chip.journal()
        stage.run(4e-3)
        speed = stage.data.qvel[row.dof] / turn
    profile = journal.replay_waveforms()
    edges = np.flatnonzero(np.diff(profile.pin("ez").astype(int))) + 1
    begin, end = profile.seconds[edges]
    assert speed > 80
    assert end - begin < stage.model.opt.timestep
    assert (end - begin) * speed == pytest.approx(INDEX + INDEX_HYSTERESIS, rel=0.02)


@pytest.mark.parametrize("cls", [MCX514, MCX304, MCX302])
@pytest.mark.parametrize("name", "xz")
def test_a_limit_switch_stops_an_axis_at_the_pulse_of_its_edge(make_stage_of, cls, name):
    """Count as many pulses as a chip on the bench makes up to the clock of the edge; that one, not told of the edge, goes on."""
    stage = make_stage_of(cls)
    axis = stage.axes[name]
    stage.place(**{name: touch(axis, "el_plus") - 2e-3 * np.sign(axis.gear)})
    journal = axis.chip.journal()
    run_on(axis.chip, 1 << axis.chip_axis)
    stage.run_until(make_stop_condition(stage, name), timeout=2)
    stage.run(0.01)
    journal.close()
    edge = next(e for e in journal.entries if e.kind == INPUT and e.b & axis.chip.INPUTS["lmt_plus"])
    lone = cls()
    for e in journal.entries:
        if e.kind != INPUT:
            lone.advance(e.clock - lone.clock)
            e.apply(lone.CORE, lone._rows)
    started = lone.net(axis.chip_axis)
    lone_pulses = lone.trace(edge.clock - lone.clock + 160_000)
    lone_pulses = lone_pulses[lone_pulses["axis"] == axis.chip_axis]
    pulses = axis.chip.net(axis.chip_axis)
    assert pulses > 100
    assert pulses - started == (lone_pulses["clock"] <= edge.clock).sum() < len(lone_pulses)
    command(axis.chip, "NOP", 1 << axis.chip_axis)
    cause = axis.chip.read(2) if cls is MCX514 else axis.chip.read(1)
    assert cause & 0x1000, "ended by LMT+"
    if cls is MCX514 or axis.pins.lmt_plus:  # there the error stays; Z swings back over its switch
        run_on(axis.chip, 1 << axis.chip_axis)
        stage.run(0.01)
        assert axis.chip.net(axis.chip_axis) == pulses, "plus stays blocked"
    if cls is MCX514:
        command(axis.chip, "R2CLR", 1 << axis.chip_axis)
    run_on(axis.chip, 1 << axis.chip_axis, minus=True)
    stage.run(0.05)
    assert axis.chip.net(axis.chip_axis) < pulses, "the way back is open"


# --- determinism ---


@EVERY
def test_n_steps_then_m_are_n_plus_m(make_stage_of, chips):
    stage = start_all_axes(make_stage_of(chips))
    replica = copy.deepcopy(stage)
    stage.step(700)
    replica.step(211)
    replica.step(489)
    assert get_state_bits(stage) == get_state_bits(replica)


@EVERY
def test_cutting_time_anywhere_changes_nothing(make_stage_of, chips):
    stage = start_all_axes(make_stage_of(chips))
    replica = copy.deepcopy(stage)
    stage.run(0.05)
    seed = SEED
    print("seed", seed)
    cuts = np.sort(np.random.default_rng(seed).integers(0, 50_000_000, 400))
    for length in np.diff([0, *cuts, 50_000_000]):
        replica.run(length * 1e-9)
    assert get_state_bits(stage) == get_state_bits(replica)


@EVERY
@pytest.mark.parametrize("cut", [0.02, 0.020137])
def test_snapshot_and_restore_continue_bit_for_bit(make_stage_of, chips, cut):
    stage = start_all_axes(make_stage_of(chips))
    stage.run(cut)
    before = stage.snapshot()
    stage.run(0.1)
    after = get_state_bits(stage)
    stage.restore(before)
    stage.run(0.1)
    assert get_state_bits(stage) == after


@EVERY
@pytest.mark.parametrize("copy_stage", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_copies_continue_bit_for_bit_and_independently(make_stage_of, chips, copy_stage):
    stage = start_all_axes(make_stage_of(chips))
    stage.run(0.020137)
    replica = copy_stage(stage)
    before = get_state_bits(stage)
    replica.run(0.1)
    assert get_state_bits(stage) == before
    stage.run(0.1)
    assert get_state_bits(stage) == get_state_bits(replica)
    assert [(type(a.chip), a.chip_axis) for a in replica.axes.values()] == [
        (type(a.chip), a.chip_axis) for a in stage.axes.values()
    ]
    assert len(replica.chips) == len(stage.chips)


# --- fleets ---


def make_program(stage, k):
    """Every axis moves until it stops, in its own way, while the host reads."""
    p, chips = Program(), {}
    for axis in stage.axes.values():
        write = lambda *w, a=axis.index: p.write(a, *w)  # noqa: E731
        chips[axis.name] = type("Bus", (), {"MAP": axis.chip.MAP, "write": staticmethod(write)})
        if isinstance(axis.chip, PCL240K):
            start_preset(chips[axis.name], 300 + 50 * k)
        elif axis.chip.SERVO:
            servo.move(chips[axis.name], 300 + 50 * k)
        else:
            load(chips[axis.name], 1 << axis.chip_axis, **choose_speeds(axis.chip), **{"LP": k})
            target, start = ("TP", "DRVRL") if isinstance(axis.chip, MCX514) else ("P", "F_DRV_P")
            load(chips[axis.name], 1 << axis.chip_axis, **{target: 300 + 50 * k})
            command(chips[axis.name], start, 1 << axis.chip_axis)
    for _ in range(10):
        p.wait(7.77e-4).read(0, 0).read(2, 1)
    return p.until_stopped([0, 1, 2], 2.0).measure(0.003).read(0, 0)


def choose_speeds(chip):
    return {"SV": 500, "DV": 9000, "AC": 60_000} if isinstance(chip, MCX514) else {"SV": 500, "V": 8000, "A": 400}


def get_all_results(fleet, played):
    states = [s.snapshot().state.tobytes() for s in fleet.stages]
    return states, played.results.tobytes(), played.extremes.tobytes(), fleet.truth().tobytes()


@EVERY
def test_any_number_of_threads_gives_the_same_bits_as_a_python_driver(make_stage_of, chips):
    first = make_stage_of(chips)
    programs = [make_program(first, k) for k in range(3)]
    observed = set()
    for threads in (1, 3):
        fleet = Fleet([copy.deepcopy(first) for _ in programs], threads)
        played = fleet.play(programs)
        observed.add(str(get_all_results(fleet, played)))
        fleet.close()
    assert len(observed) == 1
    for k, p in enumerate(programs):
        stage, ops = copy.deepcopy(first), np.array(p.ops)
        results = np.zeros(len(ops), np.int64)
        assert (
            program_player.play_in_python(stage, ops, results, np.full((stage.model.nq, 2), np.inf) * [1, -1])
            == program_player.PLAYED
        )
        assert (results == played.results[k][: len(ops)]).all()
        assert get_state_bits(stage) == get_state_bits(fleet.stages[k])
        assert get_net_pulses(stage) == [300 + 50 * k] * 3


def test_the_truth_of_an_axis_is_what_its_chip_says(make_stage_of):
    fleet = Fleet([copy.deepcopy(make_stage_of(MIXED))], 1)
    fleet.play([make_program(fleet.stages[0], 3)])
    for t, axis in zip(fleet.truth()[0], fleet.stages[0].axes.values(), strict=True):
        assert (t["position"], t["commanded"], t["pulses"]) == (axis.position, axis.commanded, 450)
        assert t["counter"] == (0 if axis.name == "z" else 453), "PCL-240: what is left; LP: where it is"
        assert not t["busy"]


def test_the_stages_of_a_fleet_may_have_different_chips(make_stage_of):
    stages = [make_stage_of(chips) for chips in (MCX514, MIXED, {n: ALL[n] for n in "xyz"}, PCL240K)]
    fleet = Fleet([copy.deepcopy(stage) for stage in stages], 2)
    programs = [make_program(stage, 2) for stage in fleet.stages]
    played = fleet.play(programs)
    for stage, ours, p, results in zip(stages, fleet.stages, programs, played.results, strict=True):
        by_hand = np.zeros(len(p), np.int64)
        ops = np.array(p.ops, np.int64)
        assert (
            program_player.play_in_python(stage, ops, by_hand, np.full((stage.model.nq, 2), np.inf) * [1, -1])
            == program_player.PLAYED
        )
        assert (results[: len(p)] == by_hand).all()
        assert get_state_bits(stage) == get_state_bits(ours)
        assert get_net_pulses(stage) == [400] * 3


# --- recordings ---


@pytest.fixture(scope="module")
def recorded(make_stage_of, tmp_path_factory):
    """A stage of an MCX514 and a PCL240K that moves under a recording, and the files of it."""
    stage = make_stage_of(MIXED)
    with stage.record() as recording:
        start_all_axes(stage)
        stage.run(0.5)
    folder = tmp_path_factory.mktemp("recorded")
    return stage, recording, recording.save(folder / "a.rrd"), recording.to_vcd(folder / "a.vcd")


PULSE_OUTPUTS = {"x": "PLS", "y": "DIR"}
"""After a reset an MCX514 gives pulses to plus at nPP and those to minus at nPM, which is DIR (data sheet, WR3 DPMD)."""


def test_the_waveforms_show_every_pulse(recorded):
    stage, _, _, path = recorded
    vcd = parse(path)
    nets = dict(zip(stage.axes, get_net_pulses(stage), strict=True))
    assert nets == {"x": 1500, "y": -1600, "z": 1700}
    for name in "xy":
        assert len(vcd.edges(f"{name}.{PULSE_OUTPUTS[name]}", 1)) == abs(nets[name])
        assert [v for _, v in vcd.changes[f"{name}.LP"]][-1] == nets[name] & 0xFFFFFFFF
    assert len(vcd.edges("z.POUT_n", 0)) == 1700


def test_the_pulses_of_the_waveforms_are_those_of_the_bench_to_the_clock(recorded):
    _, recording, _, path = recorded
    vcd = parse(path)
    pulses = replay_on_bench(recording.journals["x"], MCX514)
    for axis, name in enumerate("xy"):
        clocks = pulses["clock"][pulses["axis"] == axis]
        assert len(clocks) > 1000
        assert vcd.edges(f"{name}.{PULSE_OUTPUTS[name]}", 1) == [(int(c) * 1000 + 8) // 16 for c in clocks]


def test_the_bus_and_the_lanes_of_an_axis_are_separate(recorded):
    read = read_rrd(recorded[2])
    text = {name: " ".join(str(t) for t in read[f"/axes/{name}/bus"]["TextLog:text"][1]) for name in "xyz"}
    assert "X DV <- 10000" in text["x"]
    assert "X TP <- 1500" in text["x"]
    assert "X relative position drive" in text["x"]
    assert "Y TP <- -1600" in text["y"]
    assert "1500" not in text["y"]
    assert "DV <-" not in text["z"]
    for name in "xyz":
        _, states = read[f"/axes/{name}/phase"]["StateChange:state"]
        assert [s[0] for s in states] == ["hold", "up", "keep", "down", "hold"] or name == "z"


# --- what is refused ---


def test_a_chip_that_is_used_twice_is_refused():
    chip = MCX302()
    with pytest.raises(ArgumentError, match="no axis left"):
        Stage("xyz", chips=chip)
    used = MCX514()
    Stage("xyz", chips=used, visuals=False)
    with pytest.raises(ArgumentError, match="axis x"):
        Stage("xyz", chips=used)


def test_the_pins_of_a_chip_of_several_axes_are_those_of_its_axes(make_stage_of):
    chip = make_stage_of(MCX514).chips[0]
    with pytest.raises(StageError, match="emg"):
        _ = chip.pins.lmt_plus
    assert not chip.pins.emg


def test_each_axis_may_have_its_chip_by_name():
    """Stage("xy", chips={"x": "pcl240k", "y": "mcx304"})"""
    stage = Stage("xy", chips={"x": "pcl240k", "y": "mcx304"}, visuals=False)
    assert [type(axis.chip).__name__ for axis in stage.axes.values()] == ["PCL240K", "MCX304"]
