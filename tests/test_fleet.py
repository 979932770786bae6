"""Many stages under one program each: the same bits as one stage under a Python driver, on any number of threads."""

import copy
import os
import pickle
import signal
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np
import pytest

from stage import ArgumentError, Fleet, Program, Stage, StageError
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MS
from stage.sim import program_player
from stage.sim.program import AWAIT_STOP, END, MEASURE, READ, SAMPLE_POSITION, WAIT, WRITE

N = 5


@pytest.fixture(scope="module")
def first():
    return Stage("xyz", chips={"x": PCL240MS, "z": PCL240K}, visuals=False)


def copy_stages(first, n=N):
    first.reset()
    return [copy.deepcopy(first) for _ in range(n)]


def make_program(first, k):
    """Both axes move, each in its own way and until it stops, while the host reads."""
    p = Program()
    registers = {
        "R1": 200 + k,
        "R2": 3000 + 100 * k,
        "R4": 90,
        "R5": 90,
        "R7": 120,
        "R0": 300 + 50 * k,
        "R6": 200 + 25 * k,
    }
    for axis in first.axes.values():
        p.command(axis.index, 0x08)
        for name, value in registers.items():
            p.register(axis.index, axis.chip, name, value)
        p.command(axis.index, 0x44 if k % 2 else 0x4C)
    p.command(0, 0x15).wait(3.3e-4 * k).command(1, 0x15)
    for _ in range(20):
        p.wait(7.77e-4).read(0, 1).read(1, 0)
    p.until_stopped([k % 2], 2.0)  # one of two that move
    return p.until_stopped([0, 1], 2.0).measure(0.003).read(0, 0)


def get_all_results(fleet, played):
    states = [s.snapshot().state.tobytes() for s in fleet.stages]
    return states, played.results.tobytes(), played.extremes.tobytes(), fleet.truth().tobytes()


def test_any_number_of_threads_gives_the_same_bits(first):
    programs = [make_program(first, k) for k in range(N)]
    observed = set()
    for threads in (1, 2, 3):
        fleet = Fleet(copy_stages(first), threads)
        observed.add(str(get_all_results(fleet, fleet.play(programs))))
        fleet.close()
    assert len(observed) == 1


def test_a_program_does_what_a_python_driver_does_to_the_bit(first):
    fleet = Fleet(copy_stages(first), 1)
    played = fleet.play([make_program(first, k) for k in range(N)])
    for k, stage in enumerate(copy_stages(first)):
        ops = np.array(make_program(first, k).ops)
        results, extremes = np.zeros(len(ops), np.int64), np.full((3, 2), np.inf) * [1, -1]
        assert program_player.play_in_python(stage, ops, results, extremes) == program_player.PLAYED
        assert (results == played.results[k][: len(ops)]).all()
        assert (extremes == played.extremes[k]).all()
        assert stage.snapshot().state.tobytes() == fleet.stages[k].snapshot().state.tobytes()
        assert all(axis.chip.diagnostics == [] for axis in stage.axes.values())


def test_a_timeout_at_the_instant_of_a_poll_ends_both_players_at_that_poll(first):
    """a bus cycle of 1 us and polls of 250 us: the fourth poll is 754 us after the begin"""
    p = Program().command(0, 0x08)
    for name, value in {"R1": 1000, "R2": 1000, "R7": 12}.items():
        p.register(0, first.axes["x"].chip, name, value)
    p.command(0, 0x40).command(0, 0x10).until_stopped([0], 754e-6, 250e-6)
    fleet, (driven,) = Fleet(copy_stages(first, 1), 1), copy_stages(first, 1)
    results = np.zeros(len(p), np.int64)
    assert program_player.play_in_python(driven, np.array(p.ops), results, np.zeros((3, 2))) == program_player.PLAYED
    assert fleet.play([p]).results[0][len(p) - 1] == results[-1] == -754_000


def test_the_truth_is_what_the_stages_say(first):
    fleet = Fleet(copy_stages(first), 1)
    fleet.play([make_program(first, k) for k in range(N)])
    for row, stage in zip(fleet.truth(), fleet.stages, strict=True):
        for t, axis in zip(row, stage.axes.values(), strict=True):
            assert (t["position"], t["commanded"], t["lost_steps"]) == (axis.position, axis.commanded, axis.lost_steps)
            assert t["now"] == round(stage.time * 1e9)
            assert t["counter"] == axis.chip.values()["R0"] == 0
            assert t["status"] == axis.chip.values()["status"]


def test_a_stage_that_is_recorded_makes_the_same_bits(first):
    reference, watched = Fleet(copy_stages(first), 1), Fleet(copy_stages(first), 1)
    programs = [make_program(first, k) for k in range(N)]
    with watched.stages[2].record() as recording:
        assert (
            get_all_results(watched, watched.play(programs))[1:]
            == get_all_results(reference, reference.play(programs))[1:]
        )
    assert (watched.stages[2].data.qpos == reference.stages[2].data.qpos).all()
    assert recording.duration > 0.02


def test_a_wait_that_takes_too_long_ends_and_says_so(first):
    fleet = Fleet(copy_stages(first, 2), 1)
    p = Program().register(0, first.axes["x"].chip, "R1", 500).register(0, first.axes["x"].chip, "R7", 100)
    p.command(0, 0x40).command(0, 0x10).until_stopped([0], 0.01)
    played = fleet.play([p, Program()])
    assert -0.0103e9 < played.results[0, len(p) - 1] <= -0.01e9
    assert fleet.stages[1].time == 0.0, "an empty program leaves its stage alone"


@pytest.mark.usefixtures("elsewhere")
def test_a_stage_that_diverges_does_not_stop_the_others(first):
    fleet = Fleet(copy_stages(first), 2)
    fleet.stages[1].data.qfrc_applied[:] = 1e30
    played = fleet.play([make_program(first, k) for k in range(N)])
    assert played.diverged.tolist() == [k == 1 for k in range(N)]
    assert (fleet.truth()["counter"][[0, 2, 3, 4]] == 0).all()


@pytest.mark.parametrize(("bus_cycle", "poll"), [(1e-6, 2e-3), (1e-3, 1e-6)], ids=["in the rest", "in a poll"])
def test_a_stage_that_diverges_while_a_program_waits_for_a_stop_ends_it(bus_cycle, poll):
    """Program().until_stopped([0], 5, poll) on a stage that diverges in the first ms, between two polls or in one"""
    stage = Stage("xy", bus_cycle=bus_cycle, visuals=False)
    chip = stage.axes["x"].chip
    p = Program().register(0, chip, "R1", 500).register(0, chip, "R7", 100).command(0, 0x40).command(0, 0x10)
    fleet = Fleet([stage], 1)
    assert not fleet.play([p]).diverged.any()
    stage.data.qfrc_applied[:] = 1e30
    now = stage.now
    assert fleet.play([Program().until_stopped([0], 5, poll)]).diverged.all()
    assert stage.now - now < 1e8


def test_a_fleet_is_pickled_with_its_stages(first):
    fleet = Fleet(copy_stages(first, 2), 1)
    replica = pickle.loads(pickle.dumps(fleet))
    programs = [make_program(first, k) for k in range(2)]
    assert get_all_results(fleet, fleet.play(programs)) == get_all_results(replica, replica.play(programs))


def test_what_a_fleet_cannot_be_is_refused(first):
    with pytest.raises(ArgumentError, match="at least one"):
        Fleet([])
    with pytest.raises(ArgumentError, match="same axes"):
        Fleet([first, Stage("xy", visuals=False)])
    with pytest.raises(ArgumentError, match="threads=0"):
        Fleet([first], threads=0)
    with pytest.raises(ArgumentError, match="one a stage"):
        Fleet([first]).play([Program(), Program()])
    for shape in ((4,), (1, 4), (1, 2, 3), (2, 1, 4)):
        with pytest.raises(ArgumentError, match="one a stage"):
            Fleet([first]).play(np.zeros(shape, np.int64))
    time = first.time
    wait = np.array([[(WAIT, 1_000_000, 0, 0)]], np.float64)
    Fleet([first]).play(np.repeat(wait, 2, axis=1)[:, ::2])  # of any kind of number, as it lies
    assert first.time == pytest.approx(time + 1e-3)


@pytest.mark.parametrize(
    "op",
    [
        (WRITE, 3, 0, 0x11), (READ, 2, 0, 0), (READ, -1, 0, 0), (SAMPLE_POSITION, 2, 0, 0), (AWAIT_STOP, 4, 1, 1),
        (AWAIT_STOP, -1, 1, 1), (AWAIT_STOP, 1, 0, 1), (WAIT, -1, 0, 0), (WAIT, 1 << 62, 0, 0), (MEASURE, -5, 0, 0),
        (MEASURE, 5, 99, 0), (MEASURE, 5, -99, 0),
        (7, 0, 0, 0), (-1, 0, 0, 0),
    ],
)  # fmt: skip
def test_a_program_that_names_a_missing_axis_or_point_is_refused(first, op):
    """Fleet([Stage("xyz")], 1).play([Program().write(3, 0, 0x11).read(3, 0)]) ended the process"""
    fleet = Fleet([first], 1)
    program = Program().wait(1e-3)
    program.ops.append(op)
    before = first.snapshot().state.tobytes()
    with pytest.raises(ArgumentError, match="program 0, operation 1"):
        fleet.play([program])
    assert first.snapshot().state.tobytes() == before
    finished = np.array([[(END, 0, 0, 0), op]])
    fleet.play(finished)  # what comes after the end is not played


def test_a_point_is_one_that_each_stage_of_the_fleet_has(first):
    bare = Stage("xyz", visuals=False)
    more = mujoco.MjSpec.from_file(str(Path(__file__).parents[1] / "models" / "xyz.xml"))
    more.worldbody.add_body(name="beside").add_site(name="more")
    fleet = Fleet([bare, Stage(more, visuals=False)], 1)
    for point in (bare.model.nsite, 1 - bare.model.nbody):
        fleet.play([Program().sample_position(0, point)] * 2)
    for point in (bare.model.nsite + 1, -bare.model.nbody):
        with pytest.raises(ArgumentError, match="program 0, operation 0: SAMPLE_POSITION"):
            fleet.play([Program().sample_position(0, point)] * 2)


def test_axes_of_a_wait_are_a_set(first):
    assert Program().until_stopped([0, 0], 1.0).ops == Program().until_stopped([0], 1.0).ops
    with pytest.raises(ArgumentError, match="index"):
        Program().until_stopped([-1], 1.0)


def test_a_stage_is_in_a_fleet_once(first):
    """s = Stage("xyz"); Fleet([s, s, s], 3)"""
    with pytest.raises(ArgumentError, match="twice"):
        Fleet([first, first, first], 3)


def test_a_stage_that_another_thread_runs_is_not_played(first):
    fleet = Fleet(copy_stages(first, 2), 1)
    with fleet.stages[1].loop.claim(), pytest.raises(StageError, match=r"stage 1 of the fleet.*in use"):
        fleet.play([make_program(first, 0)] * 2)
    fleet.play([make_program(first, 0)] * 2)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_fleet_plays_in_a_child_of_fork():
    """fleet.play(programs); os.fork(); and in the child fleet.play(programs)"""
    fleet = Fleet([Stage("xy", visuals=False) for _ in range(2)], 2)
    programs = [Program().wait(1e-3)] * 2
    fleet.play(programs)
    child = os.fork()
    if not child:
        signal.alarm(20)
        fleet.play(programs)
        os._exit(7)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    fleet.play(programs)
    fleet.close()


def test_a_payload_makes_the_axis_heavier_and_stays_over_a_reset(first):
    stage = copy_stages(first, 1)[0]
    masses = {}
    for payload in (0.0, 6.0, 0.0):
        stage.set_payload(payload)
        stage.reset()
        inertia = np.zeros((stage.model.nv, stage.model.nv))
        import mujoco

        mujoco.mj_fullM(stage.model, stage.data, inertia)
        masses.setdefault(payload, []).append(inertia[0, 0])
    assert masses[0.0][0] == masses[0.0][1]
    assert masses[6.0][0] - masses[0.0][0] == pytest.approx(6.0)
    for bad in (-1.0, float("nan")):
        with pytest.raises(ArgumentError, match="kg"):
            stage.set_payload(bad)
    with pytest.raises(ArgumentError, match="body 'tabel'"):
        stage.set_payload(1.0, "tabel")


def test_without_visuals_the_physics_is_the_same(first):
    bare, full = copy_stages(first, 1)[0], Stage("xyz", chips={"x": PCL240MS, "z": PCL240K})
    ops = np.array(make_program(first, 1).ops)
    for stage in (bare, full):
        program_player.play_in_python(stage, ops, np.zeros(len(ops), np.int64), np.zeros((3, 2)))
    assert bare.snapshot().state.tobytes() == full.snapshot().state.tobytes()


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.filterwarnings("ignore:Attach conflict")
def test_visual_geoms_that_define_an_inertia_are_not_removed():
    """A part attached to another model keeps its own compiler settings, out of our reach."""
    part = mujoco.MjSpec.from_file(str(resources.files("stage.models") / "xy.xml"))
    part.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    for key in list(part.keys):
        part.delete(key)
    assembly = mujoco.MjSpec()
    assembly.option.timestep = part.option.timestep  # that of the whole counts; left alone, it is 2 ms
    assembly.visual.map.znear, assembly.visual.map.zfar = part.visual.map.znear, part.visual.map.zfar
    assembly.attach(part, prefix="left_", frame=assembly.worldbody.add_frame())
    assert Stage(assembly, visuals=False).model.ngeom == Stage(assembly).model.ngeom > 100
    part = mujoco.MjSpec.from_file(str(resources.files("stage.models") / "xy.xml"))
    part.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    carriage = part.body("x")  # what it says of its inertia counts for nothing here
    carriage.explicitinertial, carriage.mass, carriage.inertia = True, 50.0, [1.0, 1.0, 1.0]
    bare, full = Stage(part, visuals=False).model, Stage(part).model
    assert bare.body_mass[bare.body("x").id] < 50.0
    assert np.array_equal(bare.body_mass, full.body_mass)
    assert bare.ngeom < full.ngeom / 4
    assert np.array_equal(bare.body_inertia, full.body_inertia)


def test_a_position_reading_is_in_pm_and_extremes_are_of_measured_time_alone(first):
    fleet = Fleet(copy_stages(first, 2), 1)
    x, z = fleet.stages[0].axes.values()
    fleet.stages[0].place(x=0.0123, z=-0.01)
    played = fleet.play([Program().wait(1.3e-4).sample_position(0).sample_position(1), Program()])
    assert played.results[0].tolist() == [0, *(int(np.floor(axis.position * 1e12)) for axis in (x, z))]
    assert played.results[1].tolist() == [0, 0, 0]
    assert (played.extremes == [np.inf, -np.inf]).all()
    assert not played.diverged.any()
    at = fleet.stages[0].time
    extremes = fleet.play([Program().measure(1.1e-3), Program().measure(0)]).extremes
    assert fleet.stages[0].time == pytest.approx(at + 1.1e-3, abs=1e-12)
    assert (extremes[0, :, 0] <= extremes[0, :, 1]).all()
    assert extremes[0, x.plant.qpos] == pytest.approx([0.0123] * 2, abs=1e-5)
    assert (extremes[1] == [np.inf, -np.inf]).all()


def test_what_a_point_travels_is_the_diagonal_of_its_box_by_python_as_by_compiled_code(first):
    """Program().measure(seconds, 1 + site), or - body"""
    one, other = Fleet(copy_stages(first, 1), 1), Fleet(copy_stages(first, 1), 1)
    model = one.stages[0].model
    site, x = 1 + model.site("work").id, one.stages[0].axes["x"]
    body = int(model.jnt_bodyid[x.joint])
    p = Program().command(0, 0x08)
    for name, value in {"R1": 500, "R2": 500, "R7": 30}.items():
        p.register(0, PCL240K, name, value)
    p.command(0, 0x40).command(0, 0x10).wait(0.03)
    p.sample_position(0, site, 0).sample_position(0, -body, 2)
    p.measure(0.02, site).measure(0.02, -body).measure(0.02).measure(0, site)
    p.sample_position(0, site, 0).sample_position(0, -body, 2)
    played = one.play([p])
    other.stages[0].record()
    assert other.list_stages_played_in_python() == [0], "Python plays it"
    assert (other.play([p]).results == played.results).all()
    from_, height, by_site, by_body, nothing, still, to, as_high = played.results[0, -8:].tolist()
    assert (nothing, still) == (0, 0)
    direction = 10_000 * abs(x.meters_per_pulse) * 0.02 * 1e12
    assert [by_site, by_body] == pytest.approx([direction, direction], rel=0.05)
    at = one.stages[0].data
    assert (to, as_high) == tuple(int(np.floor(1e12 * v)) for v in (at.site_xpos[site - 1][0], at.xpos[body][2]))
    assert to - from_ == pytest.approx(3 * direction, rel=0.05)
    assert as_high == height
    for wrong in ((0, model.nsite + 1), (0, -model.nbody), (0, 1, 3), (0, 1, -1)):
        with pytest.raises(ArgumentError, match="A point is 1"):
            one.play([Program().sample_position(*wrong)])


def test_a_register_is_written_by_a_program_as_its_family_takes_it():
    writes = {
        (PCL240K, "R1"): [(0, 0x81), (2, 0x12), (1, 0x34)],
        (PCL240MS, "R0"): [(0, 0x80), (3, 0), (2, 0x12), (1, 0x34)],
        (MCX514, "DV"): [(6, 0x1234), (7, 0), (0, 0x0205)],
        (MCX304, "V"): [(6, 0x1234), (0, 0x0205)],
        (MCX514, "IPM"): [(6, 0x1234), (0, 0x002A)],
        (HCTL1100, "R22"): [(0x22, 0x1234)],
    }
    for (chip, name), expected in writes.items():
        ops = Program().register(3, chip, name, 0x1234, min(1, chip.AXES - 1)).ops
        assert ops == [(WRITE, 3, address, value) for address, value in expected], (chip, name)


def test_a_closed_fleet_plays_again_and_stops_are_waited_for_axis_by_axis(first):
    fleet = Fleet(copy_stages(first, 2), 2)
    p = Program().until_stopped([0, 1], 1).until_stopped([], 1)
    for _ in range(2):
        took = fleet.play([p, p]).results
        assert took[:, 0].tolist() == [2000, 2000], "a cycle an axis"
        assert took[:, 1].tolist() == [0, 0]
        fleet.close()
        fleet.close()


def test_a_program_that_keeps_step_ends_at_the_first_one_lost_compiled_or_not(first):
    """Program().until_stopped([0], 2.0, end_on_lost_step=True)"""

    def played(fl, end_on_lost_step, recorded=False, poll=2.5e-4):
        fleet = Fleet(copy_stages(first, 1), threads=1)
        axis, p = fleet.stages[0].axes["x"], Program().command(0, 0x08)
        for name, value in {"R0": 4000, "R1": fl, "R2": fl, "R7": 120}.items():
            p.register(0, axis.chip, name, value)
        p.command(0, 0x44).command(0, 0x11).until_stopped([0], 2.0, poll, end_on_lost_step).measure(0.01)
        recording = fleet.stages[0].record() if recorded else None
        result = fleet.play([p])
        if recording:
            recording.close()
        truth = fleet.truth()[0, 0]
        return int(result.results[0, -2]), int(result.results[0, -1]), truth.tobytes(), int(truth["lost_steps"])

    assert played(300, True) == played(300, False)
    short, long, by_hand = played(8000, True), played(8000, False), played(8000, True, recorded=True)
    assert short == by_hand
    assert short[0] < 0 < long[0]
    assert -short[0] < long[0] / 2
    assert short[3] != 0
    delayed = played(8000, True, poll=1.5)
    assert (delayed[0] < 0, delayed[3] != 0) == (True, True), (
        "steps that an axis lost before the poll that finds it at rest"
    )


WRONG = {
    "write": (lambda n: Program().write(0, 0, n), "value"),
    "address": (lambda n: Program().write(0, n, 0), "address"),
    "read": (lambda n: Program().read(n, 0), "axis"),
    "sample_position": (lambda n: Program().sample_position(n), "axis"),
    "point": (lambda n: Program().measure(1, n), "point"),
    "stop": (lambda n: Program().until_stopped([n], 1), "ax[ei]s"),
}
WRONG_TIMES = {
    "wait": lambda s: Program().wait(s),
    "measure": lambda s: Program().measure(s),
    "limit": lambda s: Program().until_stopped([0], s),
    "poll": lambda s: Program().until_stopped([0], 1, s),
}


@pytest.mark.parametrize("where", WRONG)
def test_what_is_no_number_of_64_bits_is_refused_at_once(where):
    """Fleet([Stage("xyz")], 1).play([Program().write(0, 0, 2**70)])
    OverflowError; and Program().read("x", 0): ValueError"""
    make, name = WRONG[where]
    for n in (2**70, -(2**63) - 1, "x", "5", None, 1.5, float("nan"), float("inf"), [0]):
        with pytest.raises(ArgumentError, match=f"^{name}="):
            make(n)
    assert make(1.0).ops == make(1).ops == make(np.int64(1)).ops
    assert all(type(n) is int for op in make(np.uint8(1)).ops for n in op)


@pytest.mark.parametrize("where", WRONG_TIMES)
def test_what_is_no_time_is_refused_at_once(where):
    """Program().measure("x")"""
    for seconds in ("x", None, float("nan"), float("inf"), 1e300, [0]):
        with pytest.raises(ArgumentError, match="="):
            WRONG_TIMES[where](seconds)


def test_a_register_of_a_program_is_one_of_a_chip_and_takes_an_integer():
    """Program().register(0, PCL240K, "R0", "x")
    TypeError: unsupported operand type(s) for >>: 'str' and 'int'"""
    for wrong, text in (
        ((0, PCL240K, "R0", "x"), "value='x': a whole number"),
        ((0, PCL240K, "R0", 1.5), "value=1.5: a whole number"),
        ((0, 5, "R0", 1), "chip=5"),
        ((0, PCL240K, 5, 1), "called by their names"),
    ):
        with pytest.raises(ArgumentError, match=text):
            Program().register(*wrong)
