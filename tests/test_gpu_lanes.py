"""The kernel of a fleet on a GPU, run as Python: threads stand for the lanes of a warp, mj_step for mujoco-warp.

What it shows is that a lane does what the engine does, at the same times and in the same order; tests/test_gpu_fleet.py shows what
a GPU makes of it.
"""

import copy
import threading
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from stage import Fleet, Program, Stage
from stage.chips import HCTL1100, PCL240K, PCL240MS
from stage.firmware.driver import get_driver
from stage.sim.gpu.gpu_compilation import CompilerTools
from stage.sim.gpu.gpu_fleet import make_kernels
from stage.sim.gpu.lane_memory_layout import LaneLayout
from stage.sim.program_player import TRUTH

STEP_LIMIT = 2000


class Lanes:
    """Threads in place of a GPU's: each waits for all others wherever the lanes of a warp vote."""

    def __init__(self):
        self.tools = CompilerTools(
            lambda function: function,
            lambda function: function,
            {},
            {
                "is_any_true_in_warp": lambda condition: any(self.exchange(bool(condition))),
                "read_value_in_warp": lambda value, thread: self.exchange(value)[thread],
                "get_thread_number": lambda: self.local.number,
                "view_as_words": lambda records, count: np.asarray(records).view(np.int64),
                "cuda": SimpleNamespace(local=SimpleNamespace(array=np.zeros)),
            },
        )
        self.local = threading.local()

    def exchange(self, value):
        """Return the values of all lanes."""
        self.barrier.wait()
        self.values[self.local.number] = value
        self.barrier.wait()
        values = list(self.values)
        self.barrier.wait()
        return values

    def run(self, kernel, lanes, *args):
        """Run a kernel for the lanes of one copy."""
        self.barrier, self.values, failed = threading.Barrier(lanes), [None] * lanes, []

        def lane(number):
            self.local.number = number
            try:
                kernel(*args)
            except BaseException as error:
                failed.append(error)
                self.barrier.abort()

        threads = [threading.Thread(target=lane, args=(number,)) for number in range(lanes)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        real = [error for error in failed if not isinstance(error, threading.BrokenBarrierError)]
        if failed:
            raise (real or failed)[0]


def play_by_lanes(stage, ops):
    """Play a program (operations, 4) on a stage by the kernel; returns results, extremes, and the truth as the kernel tells it."""
    state, model, data = stage.state, stage.model, stage.data
    lanes, layout = Lanes(), LaneLayout(stage)
    advance, inspect = make_kernels(stage, layout, lanes.tools)
    words = layout.pack(1)
    first, host = layout.find_host_words()
    words[first:] = host[:, None]
    results, extremes = np.zeros((1, len(ops)), np.int64), np.empty((1, model.nq, 2))
    extremes[..., 0], extremes[..., 1] = np.inf, -np.inf
    frozen, playing = np.zeros((1, model.nq + 2 * model.nv)), np.zeros(1, np.int32)
    names = ("qpos", "qvel", "ctrl", "sensordata")
    physics = [getattr(data, name)[None] for name in names]
    tables = (layout.rows, layout.axis_numbers, layout.places, layout.tables, layout.switch_tables, state.clockwork)
    rest = (
        model.dof_M0[None].copy(),
        model.dof_damping,
        model.actuator_damping,
        data.qacc_warmstart[None],
        data.site_xpos[None],
        data.xpos[None],
        frozen,
        playing,
    )
    for _ in range(STEP_LIMIT):
        playing[0] = 0
        lanes.run(advance, layout.lanes, words, *tables, ops[None], results, extremes, *physics, *rest)
        if not playing[0]:
            break
        mujoco.mj_step(model, data)
    truth = np.zeros((1, len(state.axis_table)), TRUTH)
    rows, numbers, _, axis_tables, _, clockwork = tables
    lanes.run(inspect, layout.lanes, words, rows, numbers, axis_tables, clockwork, physics[0], physics[1], truth)
    records = layout.unpack(words, 1)
    return results[0], extremes[0], truth[0], records


def make_stepper_program(rng):
    stage = Stage("xyz", chips={"x": PCL240K, "y": PCL240MS, "z": PCL240K}, visuals=False)
    place = {"x": 0.1497, "y": 0.0, "z": -0.0139}
    stage.place(**place)  # beside EL+ of x and ORG of z
    p = Program()
    for axis, (maximum, least) in zip(stage.axes.values(), ((150, 90), (60, 20), (60, 20)), strict=True):
        driver = get_driver(axis)
        pulses = int(rng.integers(least, maximum))
        driver.write_move(p, driver.compute_move_registers(800, 5000, 0.004, 0.003, pulses), pulses)
    p.until_stopped([0, 1, 2], 0.03, poll=float(rng.uniform(5e-5, 4e-4)))
    p.wait(float(rng.uniform(0, 1e-3))).sample_position(1).sample_position(0, 1, 2)
    p.measure(float(rng.uniform(5e-4, 2e-3)), 1)
    for axis in range(3):
        p.read(axis, 0).read(axis, 1)
    return stage, p.until_stopped([0, 2], 0.01, end_on_lost_step=True).measure(0.0).write(0, 0, 8)


def make_servo_program(rng):
    stage = Stage("xyz", chips=HCTL1100, visuals=False)
    p = Program()
    for axis in stage.axes.values():
        driver = get_driver(axis)
        driver.write_servo_move(p, driver.compute_filter(), int(rng.integers(40, 90)), (2e4, 4e6))
    p.until_stopped([0, 1, 2], 0.01).measure(0.001, -1)
    return stage, p.read(0, 0x14).read(1, 0x13).sample_position(2)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("make", [make_stepper_program, make_servo_program])
def test_a_lane_does_what_the_engine_does_to_the_bit(make, seed):
    print("seed", seed)
    stage, program = make(np.random.default_rng(seed))
    ops = np.array(program.ops, np.int64)
    other = copy.deepcopy(stage)
    results, extremes, truth, records = play_by_lanes(stage, ops)
    fleet = Fleet([other])
    played = fleet.play(ops[None])
    assert results.tolist() == played.results[0].tolist()
    assert extremes.tolist() == played.extremes[0].tolist()
    assert (stage.data.qpos == other.data.qpos).all()
    assert (stage.data.qvel == other.data.qvel).all()
    assert truth.tobytes() == fleet.truth()[0].tobytes()
    state = other.state
    for k, chip in enumerate(state.chips):
        assert records["chip"][0, k].tobytes() == chip.tobytes(), f"chip {k}"
    for name, target in (("axes", state.axes), ("drives", state.drives), ("switches", state.switches)):
        assert records[name][0].tobytes() == target.tobytes(), name
    now, start, in_slice = (records["world"][0][name] for name in ("now", "start", "slice"))
    assert (now, start, in_slice) == (state.world[0].now, state.world[0].start, state.world[0].slice)


def test_words_of_a_lane_come_back_as_the_records_of_the_stage():
    stage = Stage("xyz", chips=PCL240K, visuals=False)
    stage.run(0.001)
    layout = LaneLayout(stage)
    records = layout.unpack(layout.pack(23), 23)
    for k in (0, 9, 10, 22):
        assert records["axes"][k].tobytes() == stage.state.axes.tobytes()
        assert records["switches"][k].tobytes() == stage.state.switches.tobytes()
        assert records["world"][k].tobytes() == stage.state.world[0].tobytes()
        assert [row.tobytes() for row in records["chip"][k]] == [chip.tobytes() for chip in stage.state.chips]
