"""Promises of `stage.faults`: what breaks does what it would do in physics and chip, from its moment on, and is mended."""

import copy
import pickle
from itertools import chain, permutations

import numpy as np
import pytest
from support.examples import SEED
from support.extras import needs_rerun
from support.programs import load_registers, start_preset
from support.recording_bench import read_rrd

from stage import ArgumentError, Drive, Fleet, Program, RunTimeout, Stage, StageError, firmware
from stage.chips import HCTL1100, MCX302, MCX304, MCX514, PCL240K, PCL240MS, chip_class
from stage.chips.journal_entries import LOST, WRITE
from stage.cli import main
from stage.cli.fault import demonstrations as demos
from stage.drives import stepper
from stage.firmware.driver import get_driver
from stage.sim import faults

EVERY = {
    "stuck open": lambda s: faults.switch_stuck(s.axes["x"], "el_plus", False),
    "stuck closed": lambda s: faults.switch_stuck(s.axes["x"], "el_plus", True),
    "bounce": lambda s: faults.bounce(s.axes["x"], "org"),
    "vane missing": lambda s: faults.vane_missing(s.axes["x"], "org"),
    "payload": lambda s: faults.payload(s, 2.0),
    "bus voltage": lambda s: faults.bus_voltage(s, 10.0),
    "jam": lambda s: faults.jam(s.axes["x"]),
    "phase open": lambda s: faults.phase_open(s.axes["x"], "b"),
    "motor": lambda s: faults.motor(s.axes["x"], "17HS19-2004S1"),
    "start skew": lambda s: faults.start_skew(s.axes["x"], 1e-3),
    "lost write": lambda s: faults.lost_write(s.axes["x"], 0, 0x15),
}
MACHINES = [name for name in EVERY if name not in ("start skew", "lost write")]  # the others are the host's board's
WITHOUT_EFFECT_ON_THE_MOVE = ("stuck open", "bounce", "vane missing")
"""Faults of EVERY that do not change a move of 3,000 pulses from the center, which reaches no switch."""


@pytest.fixture(scope="module")
def fresh():
    stage = Stage("xyz", chips=PCL240K, visuals=False)
    stage.set_payload(1.0)
    return stage


@pytest.fixture
def xyz(fresh):
    fresh.reset()
    yield fresh
    assert fresh.faults == (), "a test left a fault behind"


def get_state_bits(stage):
    return stage.snapshot().state.tobytes()


def find_switch_position(axis, pin):
    return next(s.touch for s in axis.plant.switches if s.pin == pin)


def run_into(axis, pin, ahead=5e-5):
    """At 400 pps, which rings no carriage, towards a switch in plus that is `ahead` m away."""
    axis.stage.place(**{axis.name: find_switch_position(axis, pin) - ahead})
    load_registers(axis.chip, R0=100_000, R1=20, R2=20, R4=300, R5=300, R6=0, R7=30)
    for command in (0x44, 0x10):
        axis.chip.write(0, command)


def find_edges(journal, pin):
    """(clock, level) of each change of an input in a journal."""
    profile = journal.replay_waveforms()
    level = profile.pin(pin)
    k = np.flatnonzero(level[1:] != level[:-1]) + 1
    return profile.edges["clock"][k], level[k]


# --- what was claimed ---


def test_a_claim_is_judged_in_motor_revolutions_for_any_screw():
    """Claimed of a screw of 10 mm: 5 mm. With one of 4 mm that is 2 mm."""
    demo = demos.Demo("", "", lambda *_: {}, lambda healthy, faulty: faulty["moved, mm"] == pytest.approx(5.0))
    for turn, moved in ((10e-3, 5.0), (4e-3, 2.0)):
        figures = {"moved, mm": moved}
        assert demos.DemoResult("", demo, (figures, figures), (None, None), turn=turn).as_claimed


EVERY_DAY = ["pcl240k", "mcx514", "mcx304", "hctl1100"]
SELDOM = ["pcl240mk", "pcl240ms", "mcx302", "mcx312"]
FIRST_GENERATION = ("mcx304", "mcx302", "mcx312")
"""They look for ORG anew as soon as it has let go, and take a contact that bounces then for ORG."""
REFUSED = {
    ("phase-open", "hctl1100"): "a DC motor, 14201S003, without phases",
    ("start-skew", "hctl1100"): "no command starts the axes of a line with HCTL1100s: the host leads each",
    **{
        ("start-skew", chip): f"one command starts all axes of a line, which are one {chip.upper()}'s"
        for chip in ("mcx514", "mcx304", "mcx302", "mcx312")
    },
}


@pytest.mark.parametrize("chip", [*EVERY_DAY, *(pytest.param(chip, marks=pytest.mark.slow) for chip in SELDOM)])
@pytest.mark.parametrize("name", demos.DEMOS)
def test_what_was_claimed_happens_with_every_chip_or_is_refused_with_its_reason(name, chip):
    """stage fault lost-write --chips mcx302; stage fault jam --chips hctl1100"""

    def make():
        stage = Stage("xyz" if chip == "pcl240k" else "xy", chips=chip_class(chip), visuals=False)
        if chip != "pcl240k" and name == "vane-missing":
            stage.place(x=-0.1)  # near ORG: it need not look for long
        return stage

    def show():
        return demos.run_demonstration(name, make)

    if why := REFUSED.get((name, chip)):
        with pytest.raises(StageError, match=why):
            show()
        return
    displayed = show()
    assert displayed.as_claimed, displayed.format_table()
    (healthy, faulty), happened = displayed.figures, displayed.demo.happened
    assert not happened(healthy, healthy), "a fault that did nothing"
    assert not happened(faulty, faulty), "the healthy run fails as the faulty one"
    if name == "bounce":
        off = abs(faulty["origin, um"] - healthy["origin, um"])
        assert off < (1.2 * 3.125 if chip in FIRST_GENERATION else 3.2), off  # a pulse is 3.125 um


@pytest.mark.parametrize(
    ("name", "message"),
    [("start-skew", "a line is of two axes, and the model has one"), ("stuck-open", "axis x has no switch el_plus")],
)
def test_a_demonstration_says_what_the_model_lacks(tmp_path, name, message):
    """stage fault stuck-open --model hinge.xml"""
    (tmp_path / "hinge.xml").write_text(ONE_AXIS)
    with pytest.raises(StageError, match=message):
        demos.run_demonstration(name, lambda: Stage(str(tmp_path / "hinge.xml"), visuals=False))


ONE_AXIS = """
<mujoco>
  <custom><text name="x_unfitted" data="el_plus el_minus sd_plus sd_minus org"/></custom>
  <option timestep="0.0001"/>
  <worldbody><body><joint name="x" type="hinge" axis="0 0 1" range="-200 200" armature="1e-5"/>
    <geom type="cylinder" size="0.02 0.005" mass="0.05"/></body></worldbody>
  <actuator><motor name="x" joint="x" gear="1"/></actuator>
</mujoco>
"""


def test_axes_on_two_chips_are_started_by_two_commands():
    """stage fault start-skew --chips mcx302"""
    displayed = demos.run_demonstration("start-skew", lambda: Stage("xyz", chips=MCX302, visuals=False))
    assert displayed.as_claimed, displayed.format_table()


# --- all of them ---


@pytest.mark.parametrize("name", EVERY)
def test_after_a_fault_is_cleared_a_move_gives_the_same_bits_as_before(xyz, name):
    def run_move():
        xyz.reset()
        start_preset(xyz.axes["x"].chip, 3000)
        xyz.run(0.4)
        return get_state_bits(xyz)

    before = run_move()
    fault = EVERY[name](xyz)
    assert xyz.faults == (fault.text,)
    assert run_move() != before or name in WITHOUT_EFFECT_ON_THE_MOVE, "it did something in this course"
    fault.clear()
    fault.clear()
    assert not fault.in_force
    assert run_move() == before


@pytest.mark.parametrize("name", EVERY)
def test_a_fault_without_duration_changes_no_bit(xyz, name):
    x = xyz.axes["x"]
    xyz.place(x=find_switch_position(x, "el_plus") - 0.0011)  # the faults come while EL+ does not swing about its edge
    start_preset(x.chip, 3000)
    replica = copy.deepcopy(xyz)
    for seconds in (0.02, 0.1000713, 0.1400001):
        xyz.run(seconds)
        replica.run(seconds)
        with EVERY[name](xyz):
            pass
    for stage in (xyz, replica):
        stage.run(0.3)
    assert get_state_bits(xyz) == get_state_bits(replica)


@pytest.mark.parametrize("name", [name for name in MACHINES if name != "motor"])  # over that one there is no restore
def test_snapshots_leave_the_machines_faults_alone(xyz, name):
    healthy = xyz.snapshot()
    with EVERY[name](xyz):
        start_preset(xyz.axes["x"].chip, 3000)
        xyz.run(0.0501)
        before = xyz.snapshot()
        xyz.run(0.2)
        first = get_state_bits(xyz)
        xyz.restore(before)
        xyz.run(0.2)
        assert get_state_bits(xyz) == first
        xyz.restore(healthy)
        assert len(xyz.faults) == 1
        start_preset(xyz.axes["x"].chip, 3000)
        xyz.run(0.0501)
        xyz.run(0.2)
        assert get_state_bits(xyz) == first, "from a snapshot of the healthy stage, the fault is there again"


@pytest.mark.parametrize("copy_stage", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
@pytest.mark.parametrize("name", MACHINES)
def test_copies_have_the_machines_faults_and_keep_them(xyz, name, copy_stage):
    start_preset(xyz.axes["x"].chip, 3000)
    xyz.run(0.0201)
    with EVERY[name](xyz) as fault:
        replica = copy_stage(xyz)
        xyz.run(0.2)
        after, switch_table = get_state_bits(xyz), xyz.state.switch_table.tobytes()
    replica.run(0.2)
    assert get_state_bits(replica) == after
    assert replica.state.switch_table.tobytes() == switch_table, "SWITCH_FAULT_FIELDS lacks a field of SWITCH_TABLE"
    assert replica.faults == (fault.text,)


@pytest.mark.parametrize("copy_stage", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_the_contact_of_a_copy_bounces_at_each_edge_as_the_first_one_does(xyz, copy_stage):
    """copy.deepcopy(stage), of which ORG bounces, and then a move over ORG"""

    def passes(stage):
        x = stage.axes["x"]
        journal = x.chip.journal()
        start_preset(x.chip, 3000)
        stage.run(0.5)
        journal.close()
        return [(e.clock, e.b & x.chip.INPUTS["org"]) for e in journal.entries]

    xyz.place(x=find_switch_position(xyz.axes["x"], "org") - 2e-3)
    with faults.bounce(xyz.axes["x"], "org", 2e-3, 6):
        replica = copy_stage(xyz)
        edges = passes(xyz)
    assert len(edges) >= 7
    assert passes(replica) == edges


def test_switches_stick_from_the_moment_at_which_a_snapshot_is_restored(xyz):
    """stage.restore(snapshot) of an asserted switch, after faults.switch_stuck(axis, "el_plus", False)"""
    x = xyz.axes["x"]
    for pin, asserted in (("el_plus", True), ("el_minus", False)):
        xyz.reset()
        xyz.place(x=find_switch_position(x, "el_plus") + 5e-5)
        xyz.run(0.01)
        assert getattr(x.switches, pin) is asserted
        snapshot = xyz.snapshot()
        with faults.switch_stuck(x, pin, not asserted):
            xyz.restore(snapshot)
            assert getattr(x.switches, pin) is not asserted
            assert getattr(x.pins, pin) is not asserted


def test_faults_add_up_and_are_cleared_in_any_order_that_nests(xyz):
    x = xyz.axes["x"]
    with faults.bus_voltage(xyz, 20.0), faults.bus_voltage(x, 12.0), faults.phase_open(x, "a"):
        assert [a.faults.bus_voltage for a in xyz.axes.values()] == [12.0, 20.0, 20.0]
        with faults.phase_open(x, "b"):
            assert x.faults.open_phases == stepper.A + stepper.B
        assert x.faults.open_phases == stepper.A
        assert len(xyz.faults) == 3
    assert [a.faults.bus_voltage for a in xyz.axes.values()] == [24.0] * 3


OF_ONE_THING = {
    "phases": [lambda s: faults.phase_open(s.axes["x"], "a"), lambda s: faults.phase_open(s.axes["x"], "b")],
    "supply": [
        lambda s: faults.bus_voltage(s.axes["x"], 12.0), lambda s: faults.bus_voltage(s, 6.0),
        lambda s: faults.bus_voltage(s.axes["y"], 8.0),
    ],
    "switch": [
        lambda s: faults.switch_stuck(s.axes["x"], "org", True), lambda s: faults.switch_stuck(s.axes["x"], "org", False),
        lambda s: faults.vane_missing(s.axes["x"], "org"), lambda s: faults.bounce(s.axes["x"], "org"),
        lambda s: faults.bounce(s.axes["x"], "org", 1e-3, 4),
    ],
    "friction": [lambda s: faults.jam(s.axes["x"], 5.0), lambda s: faults.jam(s.axes["x"], 7.0)],
    "payload": [lambda s: faults.payload(s, 2.0), lambda s: faults.payload(s, 3.0)],
    "motor": [lambda s: faults.motor(s.axes["x"], "17HS19-2004S1"), lambda s: faults.motor(s.axes["x"], "17HS15-1504S")],
}  # fmt: skip
"""Faults that change the same value. A list has at most 5, since the test clears them in all orders, 120 of 5."""


def get_fault_state(stage):
    """All of the machine that faults change."""
    return (
        [(a.faults.bus_voltage, a.faults.open_phases, a.drive) for a in stage.axes.values()], stage.payload(), stage.faults,
        stage.state.switch_table.tobytes(), stage.model.dof_frictionloss.tobytes(), stage.model.dof_solimp.tobytes(),
    )  # fmt: skip


@pytest.mark.parametrize("thing", OF_ONE_THING)
def test_faults_of_one_thing_are_cleared_in_any_order_as_if_they_had_not_been(thing):
    """a = faults.phase_open(x, "a"); b = faults.phase_open(x, "b"); a.clear(); b.clear(): phase a stayed open"""
    makes = OF_ONE_THING[thing]
    stage, other = Stage("xy", visuals=False), Stage("xy", visuals=False)
    for s in (stage, other):
        s.set_payload(1.0)
    healthy = get_fault_state(stage)
    for order in permutations(range(len(makes))):
        created, left = [make(stage) for make in makes], list(range(len(makes)))
        for k in order:
            created[k].clear()
            left.remove(k)
            rest = [makes[j](other) for j in left]
            assert get_fault_state(stage)[:2] == get_fault_state(other)[:2], (order, k)
            assert get_fault_state(stage)[3:] == get_fault_state(other)[3:], (order, k)
            assert stage.faults == tuple(created[j].text for j in left)
            for fault in reversed(rest):
                fault.clear()
        assert get_fault_state(stage) == healthy, order


def test_a_cleared_fault_is_the_only_one_that_a_recording_says_was_cleared(xyz):
    with xyz.record() as recording:
        first, second = faults.phase_open(xyz.axes["x"], "a"), faults.phase_open(xyz.axes["x"], "b")
        first.clear()
        second.clear()
    texts = [note.text for note in recording.fault_changes]
    assert texts == [
        "axis x: phase a open: begins", "axis x: phase b open: begins",
        "axis x: phase a open: cleared", "axis x: phase b open: cleared",
    ]  # fmt: skip


# --- switches ---


def test_a_switch_sticks_at_the_nanosecond_inside_a_physics_step(xyz):
    x = xyz.axes["x"]
    xyz.run(0.0201234567)
    journal = x.chip.journal()
    with faults.switch_stuck(x, "el_minus", True):
        assert x.chip.pins.el_minus
        xyz.run(0.0000123)
    assert not x.chip.pins.el_minus
    journal.close()
    clocks, levels = find_edges(journal, "el_minus")
    assert levels.tolist() == [True, False]
    assert clocks.tolist() == [int(t * x.chip.clock_hz) for t in (0.0201234567, 0.0201357567)]


def test_a_switch_that_sticks_in_a_move_stops_the_chip_within_the_pulse(xyz):
    x = xyz.axes["x"]
    start_preset(x.chip, 20_000)
    xyz.run(0.3001234)
    before = x.chip.clock
    pulses = x.read_drive()[1]
    with faults.switch_stuck(x, "el_plus", True):
        assert x.chip.clock == before
        xyz.run(0.1)
        assert x.chip.pins.hold
        assert x.read_drive()[1] - pulses <= 1


def test_clearing_a_stuck_switch_inside_a_step_keeps_a_later_edge_of_that_step(xyz):
    """Stuck open across its edge, a switch that is mended afterwards trips at once; mended before, at its own moment."""
    x = xyz.axes["x"]
    run_into(x, "el_plus")
    replica = copy.deepcopy(xyz)
    journal = replica.axes["x"].chip.journal()
    replica.run(0.1)
    journal.close()
    (clock,), _ = find_edges(journal, "el_plus")
    moment = clock / x.chip.clock_hz
    early = copy.deepcopy(xyz)
    for stage, when, expected in ((early, moment - 20e-6, clock), (xyz, moment + 20e-6, None)):
        axis = stage.axes["x"]
        journal = axis.chip.journal()
        fault = faults.switch_stuck(axis, "el_plus", False)
        stage.run(when - stage.time)
        fault.clear()
        clear_clock = axis.chip.clock
        stage.run(0.1)
        journal.close()
        clocks, _ = find_edges(journal, "el_plus")
        assert clocks[0] == (clear_clock if expected is None else expected)


@pytest.mark.parametrize(("seconds", "toggles"), [(2e-3, 6), (1e-4, 8), (1e-2, 2), (5e-7, 4)])
def test_a_contact_bounces_as_its_docstring_says_and_rests_on_its_new_level(xyz, seconds, toggles):
    x = xyz.axes["x"]
    run_into(x, "el_plus")
    with faults.bounce(x, "el_plus", seconds, toggles):
        journal = x.chip.journal()
        replica = copy.deepcopy(xyz)
        xyz.run(0.1)
        journal.close()
        clocks, levels = [e.clock for e in journal.entries], [e.b & x.chip.INPUTS["el_plus"] for e in journal.entries]
        n, k = toggles, np.arange(toggles + 1)
        expected = seconds * (1 - (n - k) * (n - k + 1) / (n * (n + 1)))
        assert len(clocks) == toggles + 1
        assert (np.array(clocks) - clocks[0]) / x.chip.clock_hz == pytest.approx(expected, abs=1.1 / x.chip.clock_hz)
        assert [bool(v) for v in levels] == [k % 2 == 0 for k in range(toggles + 1)]
        assert x.switches.el_plus
        seed = SEED
        print("seed", seed)
        cuts = np.sort(np.random.default_rng(seed).integers(0, 100_000_000, 300))
        for length in np.diff([0, *cuts, 100_000_000]):
            replica.run(length * 1e-9)
        assert get_state_bits(replica) == get_state_bits(xyz), "however time is cut"


def test_a_snapshot_within_a_bounce_continues_to_bounce(xyz):
    x = xyz.axes["x"]
    run_into(x, "el_plus")
    with faults.bounce(x, "el_plus", 5e-3):
        xyz.run_until(lambda: x.switches.el_plus, timeout=0.2, poll=1e-4)
        xyz.run(1e-3)
        middle = xyz.snapshot()
        levels = []
        for _ in range(2):
            xyz.restore(middle)
            levels.append([x.switches.el_plus for _ in range(100) if xyz.run(5e-5) is None])
        assert levels[0] == levels[1]
        assert False in levels[0]
        assert levels[0][-1]


def test_a_bounce_in_progress_is_completed_when_the_fault_is_cleared(xyz):
    x = xyz.axes["x"]
    run_into(x, "el_plus")
    journal = x.chip.journal()
    with faults.bounce(x, "el_plus", 5e-3):
        xyz.run_until(lambda: x.switches.el_plus, timeout=0.2, poll=1e-4)
    xyz.run(0.02)
    journal.close()
    assert len(find_edges(journal, "el_plus")[0]) == 7
    assert x.switches.el_plus


def test_a_switch_works_again_when_its_carriage_was_put_elsewhere_in_the_middle_of_a_bounce(xyz):
    x = xyz.axes["x"]
    for _ in range(2):
        with faults.bounce(x, "el_plus", 5e-3):
            x.chip.write(0, 0x08)
            run_into(x, "el_plus")
            xyz.run_until(lambda: x.switches.el_plus, timeout=0.1, poll=1e-4)
            xyz.run(2e-3)  # its last pulse is complete, and the contact still bounces
    xyz.place(x=find_switch_position(x, "el_plus") - 1e-3)
    xyz.run(0.01)
    assert not x.switches.el_plus, "what was left of the bounce is gone"


def test_every_contact_of_the_machine_may_bounce_as_fast_as_it_can(xyz):
    """More edges than a window has ever had: none is lost, none is written where it does not belong."""
    xyz.place(**{name: find_switch_position(axis, "org") + 0.005 for name, axis in xyz.axes.items()})
    each = [faults.bounce(a, pin, 1e-6, 8) for a in xyz.axes.values() for pin in a.switches.as_dict()]
    with xyz.record() as recording:
        for axis in xyz.axes.values():
            axis.switches.stick("sd_plus", True)
            assert firmware.origin_return(axis).stopped_by == "ORG"
            axis.switches.stick("sd_plus", None)
    for fault in each:
        fault.clear()
    recording.require_forward_time()
    for name, journal in recording.journals.items():
        assert journal.replay_waveforms().edges["inputs"][-1] == xyz.axes[name].chip.input_word(0)
        assert len(find_edges(journal, "org")[0]) <= 9 * 4


def test_a_vane_serves_the_switches_of_its_kind(xyz):
    y = xyz.axes["y"]
    with faults.vane_missing(y, "el_plus") as fault:
        assert "el_plus and el_minus" in fault.text
        for pin, observed in (("el_plus", False), ("el_minus", False), ("org", True), ("sd_plus", True)):
            xyz.place(y=find_switch_position(y, pin) + (1e-3 if pin.endswith("plus") else -1e-3))
            assert y.switches.as_dict()[pin] is observed
    xyz.place(y=find_switch_position(y, "el_plus") + 1e-3)
    assert y.switches.el_plus


# --- drives ---


@pytest.mark.parametrize("mode", ["chopper", "sine"])
@pytest.mark.parametrize("open_", [stepper.A, stepper.B, stepper.A + stepper.B])
def test_an_open_phase_carries_no_current_and_the_other_is_as_it_was(mode, open_):
    seed = SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    full, broken = np.zeros(1, stepper.DRIVE), np.zeros(1, stepper.DRIVE)
    for rows in (full, broken):
        Drive(mode=mode).fill_record(rows[0])
    broken[0].open, broken[0].slice = open_, 0.0
    km, nr, td = full[0].torque_constant, full[0].teeth, full[0].detent
    r, inductance, volt, current = full[0].resistance, full[0].inductance, full[0].voltage, full[0].current
    h, n = 31.25e-6, stepper.SLICES
    closed = 0.0 if open_ & stepper.A else 1.0, 0.0 if open_ & stepper.B else 1.0
    for _ in range(100):
        count, begin, omega = rng.uniform(-1e4, 1e4), rng.uniform(-10, 10), rng.uniform(-150, 150)
        counts = count + rng.choice((0.05, 3.0)) * rng.uniform(-1, 1) * np.arange(n)
        broken[0].current_a = full[0].current_a = rng.uniform(-1.7, 1.7) * closed[0]
        broken[0].current_b = full[0].current_b = rng.uniform(-1.7, 1.7) * closed[1]
        currents = [(full[0].current_a, full[0].current_b)]
        for k in range(n):
            stepper.compute_slice_torque(full[0], counts[k], begin + (k + 0.5) * omega * h, omega, h)
            currents.append((full[0].current_a, full[0].current_b))
        a, b = (np.array(currents) * closed).T
        torque = stepper.compute_mean_torque(broken[0], counts, n, begin + 0.5 * n * omega * h, omega, h)
        assert (broken[0].current_a, broken[0].current_b) == pytest.approx((a[-1], b[-1]), abs=1e-9)
        ends, middles = (nr * (begin + omega * h * k) for k in (np.arange(n + 1), np.arange(n) + 0.5))
        at_ends = km * (b * np.cos(ends) - a * np.sin(ends))
        expected = (at_ends.sum() - 0.5 * (at_ends[0] + at_ends[-1])) / n - td * np.sin(4 * middles).mean()
        ohm2 = r**2 + (nr * omega * inductance) ** 2  # drives.md, 1: what the bus voltage can hold at this speed
        if mode == "sine" and volt / ohm2**0.5 - km * abs(omega) * r / ohm2 >= current:
            # held currents belong to the middles of the slices
            at_middles = km * (b[1:] * np.cos(middles) - a[1:] * np.sin(middles))
            expected = at_middles.mean() - td * np.sin(4 * middles).mean()
        assert torque == pytest.approx(expected, abs=1e-9)


def test_the_current_of_an_open_phase_is_zero_in_the_recording_from_the_fault_on(xyz):
    x = xyz.axes["x"]
    start_preset(x.chip, 20_000)
    with xyz.record(every=2.5e-4) as recording:
        xyz.run(0.1)
        with faults.phase_open(x, "b"):
            xyz.run(0.1)
    time, a, b = (recording.column(c) for c in ("time", "x/current_a", "x/current_b"))
    assert np.abs(b[time < 0.0999]).max() > 1
    assert (b[time > 0.1001] == 0).all()
    assert np.abs(a[time > 0.1001]).max() > 1


def test_a_supply_that_falls_at_power_up_is_a_stage_with_that_supply(xyz):
    lower = Stage("xyz", chips=PCL240K, drives=Drive(bus_voltage=9.0))
    lower.set_payload(1.0)
    with faults.bus_voltage(xyz, 9.0):
        for stage in (xyz, lower):
            stage.reset()
            start_preset(stage.axes["x"].chip, 20_000)
            stage.run(0.5)
        assert get_state_bits(xyz) == get_state_bits(lower)


# --- mechanics ---


@pytest.mark.parametrize("name", ["jam", "phase open"])
def test_an_origin_return_that_gets_nowhere_ends_in_a_timeout(xyz, name):
    with EVERY[name](xyz), pytest.raises(RunTimeout, match="axis x still operates"):
        firmware.origin_return(xyz.axes["x"], timeout=6)
    xyz.reset()
    assert firmware.origin_return(xyz.axes["x"], timeout=6).stopped_by == "ORG"


def test_a_doubled_payload_is_a_stage_with_twice_the_payload(xyz):
    replica = copy.deepcopy(xyz)
    replica.set_payload(2.0)
    with faults.payload(xyz, 2.0):
        assert xyz.payload() == 2.0
        for stage in (xyz, replica):
            start_preset(stage.axes["x"].chip, 8000)
            stage.run(0.5)
        assert get_state_bits(xyz) == get_state_bits(replica)
    assert xyz.payload() == 1.0


def test_clearing_a_payload_fault_restores_the_mass_of_the_named_body(xyz):
    stage = copy.deepcopy(xyz)
    body = next(
        stage.model.body(k).name for k in range(1, stage.model.nbody) if stage.payload(stage.model.body(k).name) == 0
    )
    at_work = stage.payload()
    stage.set_payload(3.0, body)
    for factor in (0, -1, 1e6, float("nan")):
        with pytest.raises(ArgumentError, match=f"factor={factor}.*3 kg"):
            faults.payload(stage, factor, body)
    with faults.payload(stage, 2.0, body):
        assert (stage.payload(body), stage.payload()) == (6.0, at_work)
    assert (stage.payload(body), stage.payload()) == (3.0, at_work)


def test_a_jammed_axis_holds_against_its_motor_in_both_directions(xyz):
    x = xyz.axes["x"]
    with faults.jam(x):
        for minus in (False, True):
            start_preset(x.chip, 20_000, minus)
            xyz.run(0.5)
            assert abs(x.position) < 20e-6
            xyz.run_until(lambda: x.chip.pins.hold, timeout=5)
            assert x.read_drive()[1] == (0 if minus else 20_000), "the chip makes all its pulses"
    assert firmware.preset_move(xyz.axes["y"], 1000).ok


# --- the host's board ---


def test_only_the_next_start_command_is_delayed_and_by_the_time_requested(xyz):
    x, y = xyz.axes["x"], xyz.axes["y"]
    with faults.start_skew(x, 3e-3) as fault:
        report = firmware.synchronized_move({"x": 4000, "y": -1500}, xyz.axes)
        assert not fault.in_force
        assert report.skew == pytest.approx(3e-3 + xyz.bus_cycle, abs=1e-9)
    again = firmware.synchronized_move({"x": 4000, "y": -1500}, xyz.axes)
    assert again.skew == pytest.approx(xyz.bus_cycle, abs=1e-9)
    assert x.lost_steps == y.lost_steps == 0


@pytest.mark.parametrize("chip", [PCL240K, MCX514, MCX304, HCTL1100])
def test_the_write_that_makes_an_axis_drive_is_delayed_on_any_chip(chip):
    """faults.start_skew(stage.axes["x"], 5e-3) on a stage with chips=MCX304"""
    stage = Stage("xy", chips=chip, visuals=False)
    x = stage.axes["x"]
    took = []
    for delayed in (False, True):
        fault = faults.start_skew(x, 5e-3)
        if not delayed:
            fault.clear()
        report = firmware.move(x, pulses=800)
        assert report.ok
        assert not fault.in_force
        took.append((report.began, report.duration))
    assert took[1][0] - took[0][0] == pytest.approx(5e-3, abs=1e-3)
    assert took[1][1] == pytest.approx(took[0][1], rel=0.05)


@pytest.mark.parametrize("chip", [MCX304, MCX514])
def test_on_a_chip_of_several_axes_only_the_start_of_the_axis_named_is_delayed(chip):
    """faults.start_skew(stage.axes["y"], 5e-3), and X starts first"""
    stage = Stage("xy", chips=chip, visuals=False)
    fault = faults.start_skew(stage.axes["y"], 5e-3)
    firmware.move(stage.axes["x"], pulses=80)
    assert fault.in_force
    firmware.move(stage.axes["y"], pulses=80)
    assert not fault.in_force


def test_a_start_that_waits_for_its_release_is_not_delayed_and_the_release_is():
    """24h, 20h, 25h: START_HOLD, F_DRV_P, START_FREE"""
    chip = MCX304()
    for name, value in (("R", 400_000), ("SV", 50), ("V", 100), ("P", 100)):
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)
    starts = []
    for symbol in ("START_HOLD", "F_DRV_P", "START_FREE"):
        word = 1 << 8 | chip.MAP.command(symbol).code
        starts.append((chip.would_start_drive(0, word), chip.would_start_drive(0, word, 1)))
        chip.write(0, word)
    assert starts == [(False, False), (False, False), (True, False)]
    assert not chip.would_start_drive(0, 1 << 8 | chip.MAP.command("F_DRV_P").code), "it drives already"


def test_a_lost_write_takes_its_cycle_and_nothing_else_happens(xyz):
    chip = xyz.axes["x"].chip
    before, time = chip.values(), xyz.time
    with faults.lost_write(xyz.axes["x"]) as fault:
        chip.write(0, 0x15)
        assert not fault.in_force
    assert xyz.time == pytest.approx(time + xyz.bus_cycle, abs=1e-12)
    assert chip.values() == before
    assert chip.diagnostics == []
    assert chip.pins.hold
    chip.write(0, 0x08)
    chip.write(0, 0x10)
    assert not chip.pins.hold


def test_a_lost_write_is_selected_by_address_value_and_count(xyz):
    chip = xyz.axes["x"].chip
    with faults.lost_write(xyz.axes["x"], 1, 7, skip=1):
        load_registers(chip, R1=7, R2=7, R3=7)
    assert [chip.values()[r] for r in ("R1", "R2", "R3")] == [7, 0, 7]


def test_a_write_to_address_0_can_be_selected(xyz):
    chip = xyz.axes["x"].chip
    with faults.lost_write(xyz.axes["x"], address=0) as fault:
        chip.write(1, 7)
        assert fault.in_force
        chip.write(0, 0x81)
        assert not fault.in_force


def test_faults_of_one_bus_act_independently_and_each_receives_every_write():
    chip = PCL240K()
    chip.write(0, 0x81)
    first, second, third = (faults.lost_write(chip, **which) for which in ({"value": 5}, {"value": 6}, {"skip": 2}))
    chip.write(1, 5)
    assert (first.in_force, second.in_force, third.in_force) == (False, True, True)
    chip.write(2, 6)
    assert (second.in_force, third.in_force) == (False, True)
    chip.write(3, 1)
    assert not third.in_force
    chip.write(1, 5)
    assert chip.values()["R1"] == 5
    third.clear()
    with faults.lost_write(chip), faults.lost_write(chip, value=9) as delayed:
        chip.write(1, 7)
        assert delayed.in_force
        chip.write(1, 9)
        chip.write(1, 8)
    assert chip.values()["R1"] == 8


def test_a_chip_without_a_stage_loses_writes_too():
    chip = PCL240K()
    with faults.lost_write(chip, address=2):
        load_registers(chip, R0=0x123456)
    assert chip.values()["R0"] == 0x120056


def test_the_journal_the_report_and_the_waveforms_show_what_got_lost(xyz, tmp_path):
    x = xyz.axes["x"]
    with xyz.record() as recording, faults.lost_write(x, 0, 0x15):
        report = firmware.preset_move(x, 1000)
    entries = recording.journals["x"].entries
    assert [(e.a, e.b) for e in entries if e.kind == LOST] == [(0, 0x15)]
    assert not any(e.kind == WRITE and e.a == 0 and e.b == 0x15 for e in entries)
    assert "LOST: start, ramp to FH1" in report.listing()
    with faults.lost_write(x, 1, skip=3):
        assert "LOST: data to address 1" in firmware.preset_move(x, 10).listing()
    assert report.pulses == 0
    assert not report.ok
    assert report.stopped_by == "unknown", "it never started, and no limit is on"
    profile = recording.journals["x"].replay_waveforms()
    assert profile.pin("hold").all(), "its replay does not see the write either"
    assert profile.edges["counter"][-1] == 1000
    assert " LOST " in recording.to_vcd(tmp_path / "x.vcd").read_text()
    notes = get_driver(x).PATTERN_CLASS(report).make_annotations(report.waveforms.seconds - report.began)
    assert [n.words for n in notes if n.words == "lost on the bus"] == ["lost on the bus"]
    report.plot(tmp_path / "x.png")


def test_a_fleet_loses_the_write_as_the_stage_alone_would():
    stages = [Stage("xy", chips=PCL240K) for _ in range(2)]
    program = Program()
    for name, value in {"R0": 900, "R1": 25, "R2": 500, "R4": 1500, "R5": 1500, "R6": 100, "R7": 30}.items():
        program.register(0, stages[0].axes["x"].chip, name, value)
    program.command(0, 0x08).command(0, 0x44).command(0, 0x15).wait(0.3)
    with faults.lost_write(stages[1].axes["x"], 0, 0x15):
        fleet = Fleet(stages)
        fleet.play([program, program])
    assert [s.axes["x"].read_drive()[1] for s in stages] == [900, 0]


# --- recordings, command line, errors ---


def test_a_recording_names_the_faults_at_their_moments(xyz, tmp_path):
    pytest.importorskip("rerun")
    from stage.recording.rerun_log import STATE_COLORS

    x = xyz.axes["x"]
    stuck = faults.switch_stuck(x, "org", True)
    with xyz.record() as recording:
        recording.stream(tmp_path / "s.rrd", 0.005)
        xyz.run(0.01)
        with faults.jam(x):
            xyz.run(0.0100001)
        stuck.clear()
    texts = [(round(n.time, 7), n.text, n.in_force) for n in recording.fault_changes]
    both = ("axis x: org stuck closed", "axis x: jammed")
    assert texts == [
        (0.0, "in force from the start", both[:1]),
        (0.01, "axis x: jammed: begins", both),
        (0.0200001, "axis x: jammed: cleared", both[:1]),
        (0.0200001, "axis x: org stuck closed: cleared", ()),
    ]
    read = read_rrd(recording.save(tmp_path / "f.rrd"))
    assert list(chain.from_iterable(read["/faults"]["StateChange:state"][1])) == [
        "; ".join(force) or "none" for _, _, force in texts
    ]
    style = [read["/faults"][f"StateConfiguration:{what}"][1][0] for what in ("values", "colors")]
    assert dict(zip(*style, strict=True)) == {
        state: int("{:02X}{:02X}{:02X}FF".format(*STATE_COLORS["off" if state == "none" else "fault"]), 16)
        for state in ("axis x: org stuck closed", "; ".join(both), "none")
    }
    assert list(chain.from_iterable(read["/faults/log"]["TextLog:text"][1])) == [
        f"{t:11.6f}  FAULT  {text}" for t, text, _ in texts
    ]
    assert list(chain.from_iterable(read["/faults/log"]["TextLog:level"][1])) == ["ERROR", "ERROR", "INFO", "INFO"]
    streamed = read_rrd(tmp_path / "s.rrd")
    for entity, what in (("/faults", "StateChange:state"), ("/faults/log", "TextLog:text")):
        assert streamed[entity][what][1] == read[entity][what][1], "each once"


@needs_rerun
def test_the_command_lists_every_fault_and_shows_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["fault"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == list(demos.DEMOS)
    assert main(["fault", "jam", "--record", "jam.rrd", "--plot", "jam.png"]) == 0
    output = capsys.readouterr().out
    assert "happened as claimed" in output
    assert "healthy" in output
    assert (tmp_path / "jam.rrd").exists()
    assert (tmp_path / "jam.png").read_bytes().startswith(b"\x89PNG")
    assert main(["fault", "jamm"]) == 2
    assert "Did you mean 'jam'" in capsys.readouterr().err


def test_every_fault_has_a_section_with_its_command_in_the_docs():
    from pathlib import Path

    page = (Path(__file__).parent.parent / "docs" / "faults.md").read_text()
    for name, demo in demos.DEMOS.items():
        assert f"stage fault {name}" in page
        assert demo.claim in " ".join(page.split())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda s: faults.switch_stuck(s.axes["x"], "el", True), "unknown switch"),
        (lambda s: faults.switch_stuck("x", "el_plus", True), "give stage.axes"),
        (lambda s: faults.bounce(s.axes["x"], "org", 0), "bounces for more than 0"),
        (lambda s: faults.bounce(s.axes["x"], "org", 1e-3, 3), "even number from 2 to 8"),
        (lambda s: faults.vane_missing(s.axes["x"], "orgg"), "Did you mean 'org'"),
        (lambda s: faults.payload(s, -1.0), "a factor is above 0"),
        (lambda s: faults.payload(s, 2.0, "nowhere"), "unknown body"),
        (lambda s: faults.payload(s.axes["x"], 2.0), "give a Stage"),
        (lambda s: faults.jam(s.axes["x"], -5), "above 0 N"),
        (lambda s: faults.bounce(s.axes["x"], "org", 1.0001), "up to 1 s"),
        (lambda s: faults.bus_voltage(s, 0), "up to 400 V"),
        (lambda s: faults.bus_voltage(s, 400.1), "up to 400 V"),
        (lambda s: faults.bus_voltage(24, 12), "give stage.axes"),
        (lambda s: faults.phase_open(s.axes["x"], "c"), "unknown phase"),
        (lambda s: faults.start_skew(s.axes["x"], -1e-3), "0 s or more"),
        (lambda s: faults.lost_write(s.axes["x"], skip=-1), "whole number of writes"),
    ],
)
def test_errors_say_what_is_allowed_and_break_nothing(xyz, make, message):
    before = get_state_bits(xyz)
    with pytest.raises(ArgumentError, match=message):
        make(xyz)
    assert xyz.faults == ()
    assert get_state_bits(xyz) == before


def test_limits_of_a_faults_arguments_are_accepted_and_a_supply_names_that_of_all_axes(xyz):
    with faults.bounce(xyz.axes["x"], "org", 1.0), faults.bus_voltage(xyz.axes["z"], 400):
        assert "axis x: org bounces for 1000 ms" in xyz.faults
        assert "axis z: bus voltage 400 V in place of 24 V" in xyz.faults
        with faults.bus_voltage(xyz, 12):
            assert xyz.faults[-1] == "all axes: bus voltage 12 V in place of 24 V, 400 V"


def test_without_room_for_edges_none_is_written(xyz):
    """with faults.bounce(stage.axes["x"], "org", 1e-6, 8): stage.run(0.1)
    `MAX_EDGES_PER_WINDOW = 49` guarded an unchecked write."""
    x, room = xyz.axes["x"], len(xyz.state.edges)
    journal = x.chip.journal()
    run_into(x, "org")
    xyz.state.edges["clock"] = -1
    xyz.state.handle["edge_room"] = 3
    try:
        with faults.bounce(x, "org", 1e-6, 8):
            xyz.run(0.1)
        assert (xyz.state.edges["clock"][:3] > 0).all()
        assert (xyz.state.edges["clock"][3:] == -1).all()
    finally:
        xyz.state.handle["edge_room"] = room
        journal.close()


def test_a_switch_that_sticks_while_it_bounces_bounces_no_more(xyz):
    # planted: a stuck switch that goes on bouncing
    x = xyz.axes["x"]
    run_into(x, "el_plus")
    with faults.bounce(x, "el_plus", 5e-3):
        xyz.run_until(lambda: x.switches.el_plus, timeout=0.2, poll=1e-4)
        xyz.run(1e-3)
        with faults.switch_stuck(x, "el_plus", True):
            assert all(x.switches.el_plus for _ in range(100) if xyz.run(1e-4) is None)


def test_a_switch_releases_25_um_after_the_place_where_it_trips(xyz):
    # planted: no switch hysteresis
    x, at = xyz.axes["x"], {}
    xyz.place(x=find_switch_position(x, "el_plus") - 3e-5)
    load_registers(x.chip, R1=1, R2=1, R4=300, R5=300, R6=0, R7=12)
    for on, direction in ((True, 0x44), (False, 0x4C)):  # plus, minus: 50 pps, 0.16 mm/s
        load_registers(x.chip, R0=40)
        for command in (direction, 0x08, 0x10):
            x.chip.write(0, command)
        xyz.run_until(lambda on=on: x.switches.el_plus is on, timeout=1, poll=2.5e-4)
        at[on] = x.position
        xyz.run_until(lambda: x.chip.pins.hold, timeout=1, poll=1e-2)
    assert at[True] == pytest.approx(find_switch_position(x, "el_plus"), abs=4e-6)
    assert at[True] - at[False] == pytest.approx(25e-6, abs=4e-6)


@pytest.mark.parametrize("pin", ["org", "el_plus", "el_minus"])
def test_a_stuck_switch_that_is_cleared_at_rest_reads_right_at_once(pin):
    """faults.switch_stuck(axis, "el_plus", True).clear(), at rest"""
    stage = Stage("xy", visuals=False)
    x = stage.axes["x"]
    stage.run(0.001)
    with faults.switch_stuck(x, pin, True):
        stage.run_to(stage.now + 1000)
        assert getattr(x.pins, pin)
    stage.run_to(stage.now + 1000)
    assert not getattr(x.pins, pin)


def test_switches_that_stick_and_are_cleared_move_no_edge_of_the_index():
    """faults.switch_stuck(axis, "sd_plus", False) and its mend, every 70 us of a move"""
    stage = Stage("xyz", chips=PCL240MS, visuals=False)
    index = PCL240MS.INPUTS["ez"]

    def edges(meddle):
        stage.reset()
        start_preset(stage.axes["x"].chip, 10_000)
        stage.run(0.2)
        observed, was = [], False
        for k in range(3600):
            if meddle and k % 7 == 0:
                stage.axes["x"].switches.stick("sd_plus", None if k % 14 else False)
            stage.run(1e-5)
            now = bool(stage.axes["x"].chip.input_word(0) & index)
            observed += [k] if now != was else []
            was = now
        return observed

    reference = edges(False)
    assert len(reference) == 2
    assert edges(True) == reference
