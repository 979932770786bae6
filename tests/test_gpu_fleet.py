"""Fleets on a GPU: what is refused before anything runs; and, where a GPU is, that they do what fleets on processors do."""

import copy
import pickle
import sys
from itertools import chain

import numpy as np
import pytest

from stage import ArgumentError, Fleet, Program, Stage
from stage.chips import HCTL1100, MCX514, PCL240K
from stage.errors import GpuMissing, ModelError
from stage.firmware.driver import get_driver
from stage.sim import fleet as fleets
from stage.sim.gpu import gpu_fleet as gpu_fleet
from stage.sim.gpu import warp_physics
from stage.support import extras


def find_reason_to_skip():
    """Return why no GPU can be used here, or ""."""
    if not (extras.is_installed("numba_cuda") and extras.is_installed("mujoco_warp")):
        return "the extra gpu is not installed"
    try:
        warp_physics.load_warp()
    except GpuMissing:
        return "there is no NVIDIA GPU"
    return ""


LEAST_SHARE = 0.97
"""Share of axes that are the same; float32 lets others meet a switch a pulse earlier or later."""
WHY_NOT = find_reason_to_skip()
on_a_gpu = pytest.mark.skipif(WHY_NOT != "", reason=f"needs a GPU: {WHY_NOT}")


@pytest.fixture(scope="module")
def stage():
    return Stage("xyz", chips=PCL240K, visuals=False)


def draw_programs(stage, copies, rng, steepest):
    """Return a program for each copy: a random move of each axis at once, ramps up to `steepest` pulses/s^2; and a look at it."""
    drivers = [get_driver(axis) for axis in stage.axes.values()]
    programs = []
    for _ in range(copies):
        p = Program()
        for driver, reach in zip(drivers, (30_000, 20_000, 10_000), strict=True):
            pulses = int(np.exp(rng.uniform(np.log(50), np.log(reach)))) * int(rng.choice((-1, 1)))
            start, highest = rng.uniform(150, 900), np.exp(rng.uniform(np.log(1500), np.log(32_000)))
            seconds = (highest - start) / np.exp(rng.uniform(np.log(2e4), np.log(steepest)))
            driver.write_move(p, driver.compute_move_registers(start, highest, seconds, seconds, abs(pulses)), pulses)
        p.until_stopped([0, 1, 2], 1.0).measure(0.02, 1)
        programs.append(p.read(0, 0).read(1, 0).read(2, 0))
    return programs


def get_chip_states(fleet):
    return [[rows.tobytes() for rows in stage.state.chips] for stage in fleet.stages]


# --- refused before anything runs ---


def test_a_device_that_is_none_is_refused(stage):
    with pytest.raises(ArgumentError, match="cpu"):
        Fleet([stage], device="gpu")


def test_copies_are_of_a_gpu_alone(stage):
    with pytest.raises(ArgumentError, match="copies=4"):
        Fleet([stage], copies=4)


@pytest.mark.parametrize("copies", [None, 0, 2.5, True])
def test_a_fleet_on_a_gpu_says_how_many_copies_it_takes(stage, copies):
    with pytest.raises(ArgumentError, match="copies="):
        Fleet([stage], device="cuda", copies=copies)


def test_a_fleet_on_a_gpu_is_of_one_stage_and_has_no_threads(stage):
    with pytest.raises(ArgumentError, match="2 stages"):
        Fleet([stage, copy.deepcopy(stage)], device="cuda", copies=2)
    with pytest.raises(ArgumentError, match="threads=2"):
        Fleet([stage], 2, device="cuda", copies=2)


def test_a_chip_without_a_kernel_is_refused_by_its_name():
    with pytest.raises(ArgumentError, match="axis x: MCX514 has no kernel"):
        Fleet([Stage("xyz", chips=MCX514, visuals=False)], device="cuda", copies=2)


def test_chips_of_two_families_are_refused():
    mixed = Stage("xyz", chips={"x": PCL240K, "y": HCTL1100}, visuals=False)
    with pytest.raises(ArgumentError, match="of one family"):
        Fleet([mixed], device="cuda", copies=2)


def test_chips_that_are_wired_together_are_refused():
    with pytest.raises(ArgumentError, match="syni="):
        Fleet([Stage("xyz", chips=PCL240K, syni={"y": "x"}, visuals=False)], device="cuda", copies=2)


def test_a_stage_that_is_being_recorded_is_refused(stage):
    recorded = copy.deepcopy(stage)
    with recorded.record(), pytest.raises(ArgumentError, match="recorded"):
        Fleet([recorded], device="cuda", copies=2)


@pytest.mark.parametrize("library", ["numba_cuda", "warp", "mujoco_warp"])
def test_without_the_extra_the_error_says_what_to_install(stage, library, monkeypatch):
    monkeypatch.setattr(gpu_fleet, "make_cuda_tools", gpu_fleet.make_cuda_tools.__wrapped__)
    if library != "numba_cuda":
        monkeypatch.setattr(gpu_fleet, "make_cuda_tools", lambda: None)
        if library == "mujoco_warp":
            monkeypatch.setitem(sys.modules, "warp", type(sys)("warp"))
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(extras.ExtraMissing, match=r"pip install -e '\.\[gpu\]'"):
        Fleet([stage], device="cuda", copies=2)


def test_without_a_gpu_the_error_says_so(stage, monkeypatch):
    class Warp:
        config = type("config", (), {})

        @staticmethod
        def is_cuda_available():
            return False

    monkeypatch.setattr(gpu_fleet, "make_cuda_tools", lambda: None)
    monkeypatch.setattr(warp_physics, "import_extra", lambda module, purpose: Warp)
    with pytest.raises(GpuMissing, match="no NVIDIA GPU"):
        Fleet([stage], device="cuda", copies=2)


# --- where a GPU is ---


@on_a_gpu
def test_copies_on_a_gpu_do_what_stages_on_processors_do(stage):
    seed, n = 5, 70
    print("seed", seed)
    programs = draw_programs(stage, n, np.random.default_rng(seed), 4e5)
    on_gpu, on_cpu = Fleet([stage], device="cuda", copies=n), Fleet([copy.deepcopy(stage) for _ in range(n)])
    for _ in range(2):  # the second play goes on from where the first ended, within a physics step
        played, wanted = on_gpu.play(programs), on_cpu.play(programs)
        assert np.mean(played.results[:, :-4] == wanted.results[:, :-4]) > LEAST_SHARE
        truth, true = on_gpu.truth(), on_cpu.truth()
        for name in ("now", "pulses", "counter", "inputs", "outputs", "status", "busy", "lost_steps"):
            assert np.mean(truth[name] == true[name]) > LEAST_SHARE, name
        assert np.quantile(np.abs(truth["position"] - true["position"]), LEAST_SHARE) < 10e-6
        assert np.quantile(np.abs(played.extremes - wanted.extremes), LEAST_SHARE) < 20e-6
        assert not played.diverged.any()
        chips = [[row.tobytes() for row in rows] for rows in on_gpu.read_records()["chip"]]
        same = np.mean([a == b for a, b in zip(chain(*chips), chain(*get_chip_states(on_cpu)), strict=True)])
        print("chips the same to the bit", same)  # others were stopped by a switch, a clock earlier or later
        assert same > LEAST_SHARE


@on_a_gpu
def test_servos_on_a_gpu_come_to_where_they_come_on_processors():
    stage, n = Stage("xyz", chips=HCTL1100, visuals=False), 40
    seed = 3
    print("seed", seed)
    rng, programs = np.random.default_rng(seed), []
    for _ in range(n):
        p = Program()
        for axis in stage.axes.values():
            driver = get_driver(axis)
            driver.write_servo_move(p, driver.compute_filter(), int(rng.integers(-4000, 4000)), (2e4, 3e5))
        programs.append(p.until_stopped([0, 1, 2], 1.0).wait(0.2))
    on_gpu, on_cpu = Fleet([stage], device="cuda", copies=n), Fleet([copy.deepcopy(stage) for _ in range(n)])
    played, wanted = on_gpu.play(programs), on_cpu.play(programs)
    assert (played.results == wanted.results).all()  # when each trapezoid ended
    truth, true = on_gpu.truth(), on_cpu.truth()
    assert (truth["pulses"] == true["pulses"]).all()
    assert np.abs(truth["counter"] - true["counter"]).max() <= 3


@on_a_gpu
def test_reset_puts_every_copy_back(stage):
    fleet = Fleet([stage], device="cuda", copies=11)
    programs = draw_programs(stage, 11, np.random.default_rng(2), 4e5)
    fleet.play(programs)
    truth = fleet.truth()
    fleet.reset()
    fleet.play(programs)
    again = fleet.truth()
    assert (again["pulses"] == truth["pulses"]).all()
    assert (again["lost_steps"] == truth["lost_steps"]).all()
    assert np.abs(again["position"] - truth["position"]).max() < 1e-7, "m; see docs/gpu.md: not to the bit"


@on_a_gpu
def test_an_empty_program_leaves_a_copy_alone(stage):
    fleet = Fleet([stage], device="cuda", copies=12)
    before = fleet.truth()
    fleet.play([Program().wait(0.0123) if k % 2 else Program() for k in range(12)])
    after = fleet.truth()
    assert (after[::2] == before[::2]).all()
    assert (after["now"][1::2] == before["now"][1::2] + 12_300_000).all()


@on_a_gpu
def test_a_fleet_on_a_gpu_checks_programs_and_plays_longer_ones_later(stage):
    fleet = Fleet([stage], device="cuda", copies=2)
    with pytest.raises(ArgumentError, match="operation 0"):
        fleet.play([Program().write(7, 0, 0), Program()])
    with pytest.raises(ArgumentError, match="shape"):
        fleet.play(np.zeros((3, 1, 4), np.int64))
    with pytest.raises(ArgumentError, match="WAIT"):
        fleet.play(np.full((2, 1, 4), [3, fleets.MAX_TIME_NS + 1, 0, 0]))
    fleet.play([Program().wait(1e-3)] * 2)
    assert fleet.play([Program().wait(1e-3).sample_position(0).wait(1e-3)] * 2).results.shape == (2, 3)
    assert fleet.truth()["now"].max() == 3_000_000


@on_a_gpu
def test_arrays_on_a_gpu_reach_other_libraries(stage):
    torch = pytest.importorskip("torch")
    fleet = Fleet([stage], device="cuda", copies=5)
    played = fleet.play([Program().wait(1e-3).sample_position(0)] * 5)
    qpos, results = (torch.from_dlpack(fleet.arrays[name]) for name in ("qpos", "results"))
    assert qpos.is_cuda
    assert qpos.shape == (5, 3)
    assert results.dtype == torch.int64
    assert results.cpu().numpy().tolist() == played.results.tolist()


@on_a_gpu
def test_a_pickled_fleet_is_one_of_fresh_copies(stage):
    fleet = Fleet([stage], device="cuda", copies=3)
    again = pickle.loads(pickle.dumps(fleet))
    assert len(again) == 3
    assert again.truth()["position"].shape == (3, 3)


@on_a_gpu
def test_a_model_that_mujoco_warp_refuses_is_refused(stage, monkeypatch):
    import mujoco_warp

    def put_model(model):
        raise NotImplementedError("mjDSBL_SOMETHING is unsupported.")

    monkeypatch.setattr(mujoco_warp, "put_model", put_model)
    with pytest.raises(ModelError, match="does not take this model: mjDSBL_SOMETHING"):
        Fleet([stage], device="cuda", copies=3)


@on_a_gpu
@pytest.mark.slow
def test_ten_thousand_random_moves_lose_the_same_steps(stage):
    seed, n = 7, 3334
    print("seed", seed)
    programs = draw_programs(stage, n, np.random.default_rng(seed), 3e6)
    on_gpu, on_cpu = Fleet([stage], device="cuda", copies=n), Fleet([copy.deepcopy(stage) for _ in range(n)])
    played, wanted = on_gpu.play(programs), on_cpu.play(programs)
    truth, true = on_gpu.truth(), on_cpu.truth()
    same = truth["lost_steps"] == true["lost_steps"]
    print("lost in", (true["lost_steps"] != 0).mean(), "same", same.mean())
    assert same.mean() >= 0.999
    assert np.mean(played.results[:, :-4] == wanted.results[:, :-4]) >= 0.999
    assert np.quantile(np.abs(truth["position"] - true["position"])[same], 0.99) < 5e-6
