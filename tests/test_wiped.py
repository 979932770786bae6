"""MuJoCo's own reset clears userdata, where chips and drives live: whoever comes next finds a machine under power."""

import copy
import pickle

import gymnasium
import mujoco
import numpy as np
import pytest
from support.programs import start_preset

from stage import Fleet, Program, Stage, StageError, faults, firmware
from stage.board import Board
from stage.chips import PCL240K
from stage.envs import register_bus as rb
from stage.sim import plant


def get_state_bits(stage):
    return stage.snapshot().state.tobytes()


def wipe(stage):
    start_preset(stage.axes["x"].chip, 1000)
    stage.run(0.02)
    mujoco.mj_resetData(stage.model, stage.data)


def record_pulses(stage):
    with stage.record() as recording:
        stage.run(0.01)
    return recording.columns["x/pulses"].tolist()


OPERATIONS = {
    "step": lambda s: s.step(3),
    "run": lambda s: s.run(0.0123),
    "run_until": lambda s: s.run_until(lambda: s.time > 0.01, timeout=1),
    "write": lambda s: s.axes["x"].chip.write(0, 0x44),
    "read": lambda s: s.axes["x"].chip.read(0),
    "busy": lambda s: s.axes["x"].chip.busy(),
    "pins": lambda s: s.axes["x"].pins.as_dict(),
    "set a pin": lambda s: setattr(s.axes["x"].pins, "ins", True),
    "values": lambda s: s.axes["x"].chip.values(),
    "clock": lambda s: s.axes["x"].chip.clock,
    "repr": repr,
    "chip snapshot": lambda s: s.axes["x"].chip.snapshot(),
    "twin": lambda s: s.axes["x"].chip.make_replica().values(),
    "journal": lambda s: (
        j := s.axes["x"].chip.journal(),
        s.run(0.01),
        j.close(),
        j.replay_waveforms().edges.tobytes(),
    )[3],
    "reset pin": lambda s: s.axes["x"].chip.reset(),
    "position": lambda s: s.axes["x"].position,
    "commanded": lambda s: s.axes["x"].commanded,
    "lost steps": lambda s: s.axes["x"].lost_steps,
    "load angle": lambda s: s.axes["x"].load_angle,
    "switches": lambda s: s.axes["x"].switches.as_dict(),
    "stick": lambda s: (s.axes["x"].switches.stick("org", True), s.axes["x"].switches.stick("org", None)),
    "fault": lambda s: faults.phase_open(s.axes["x"]).clear(),
    "place": lambda s: s.place(y=0.01),
    "time": lambda s: s.time,
    "snapshot": lambda s: s.snapshot().state.tobytes(),
    "copy": lambda s: get_state_bits(copy.deepcopy(s)),
    "pickle": lambda s: get_state_bits(pickle.loads(pickle.dumps(s))),
    "record": record_pulses,
    "move": lambda s: str(firmware.preset_move(s.axes["x"], 200)),
    "fleet": lambda s: Fleet([s], 1).play([Program().write(0, 0, 0x44).read(0, 0).wait(1e-3)]).results.tolist(),
    "truth": lambda s: Fleet([s], 1).truth().tobytes(),
}


@pytest.mark.parametrize("direction", OPERATIONS)
def test_after_mj_reset_data_it_is_as_after_a_reset(xy, direction):
    """mujoco.mj_resetData(stage.model, stage.data); firmware.preset_move: "pulses 0 of 1000, stopped by R0 = 0\""""
    start_preset(xy.axes["x"].chip, 1000)
    xy.run(0.02)
    xy.reset()
    expected = OPERATIONS[direction](xy), get_state_bits(xy)
    xy.reset()
    wipe(xy)
    assert (OPERATIONS[direction](xy), get_state_bits(xy)) == expected


def test_without_bus_time_as_well():
    stage = Stage("xy", chips=PCL240K, bus_cycle=0, visuals=False)
    power_up = get_state_bits(stage)
    wipe(stage)
    stage.axes["x"].chip.read(0)
    assert get_state_bits(stage) == power_up


@pytest.mark.parametrize("bus_cycle", [1e-6, 0])
def test_a_board_works_as_well(bus_cycle):
    boards = [Board(Stage("xy", chips=PCL240K, bus_cycle=bus_cycle, visuals=False)) for _ in range(2)]
    wipe(boards[0].stage)
    for board in boards:
        for value in (0x81, 0x44):
            board.out8(0x300, value)
        assert board.in8(0x300) & 0x10 == boards[0].in8(0x300) & 0x10
    boards[1].in8(0x300)
    for board in boards:
        board.delay_us(500)
    assert get_state_bits(boards[0].stage)[:64] == get_state_bits(boards[1].stage)[:64]
    assert boards[0].stage.axes["x"].chip.values() == boards[1].stage.axes["x"].chip.values()


def test_in_an_environment_as_well():
    env = gymnasium.make("stage/RegisterBus-v0", disable_env_checker=True).unwrapped
    observed = []
    for wiped in (False, True):
        env.reset(seed=4)
        stage = env.stage
        if wiped:
            mujoco.mj_resetData(stage.model, stage.data)
        action = np.array([rb.WRITE, 0, 0, 0x81])
        observed.append((env.step(action)[0].tobytes(), stage.axes["x"].chip.values()))
    assert observed[0] == observed[1]


@pytest.mark.parametrize("key", ["middle", "home"])
def test_after_mj_reset_data_keyframe_the_carriages_stand_where_the_key_says(xy, key):
    """mujoco.mj_resetDataKeyframe(stage.model, stage.data, 1)"""
    k = xy.model.key(key).id
    x, y = xy.model.key_qpos[k]
    xy.place(x=x, y=y)
    for axis in xy.axes.values():
        start_preset(axis.chip, 500)
    xy.run(0.3)
    expected = [(a.position, a.commanded, a.lost_steps, a.chip.values()) for a in xy.axes.values()]
    wipe(xy)
    mujoco.mj_resetDataKeyframe(xy.model, xy.data, k)
    assert [a.position for a in xy.axes.values()] == pytest.approx([x, y], abs=1e-9)
    for axis in xy.axes.values():
        start_preset(axis.chip, 500)
    xy.run(0.3)
    assert [(a.position, a.commanded, a.lost_steps, a.chip.values()) for a in xy.axes.values()] == expected


def test_qvel_set_after_mj_reset_data_is_the_speed_of_the_carriage(xy):
    wipe(xy)
    xy.data.qvel[:] = 0.02
    assert xy.axes["x"].position != 0
    assert xy.data.qvel.tolist() == [0.02, 0.02]


def test_qpos_set_after_mj_reset_data_is_the_position_of_the_carriage(xy):
    wipe(xy)
    xy.data.qpos[:] = 0.02
    xy.run(0.1)
    x = xy.axes["x"]
    assert x.position == pytest.approx(0.02, abs=2 * x.meters_per_pulse)
    assert x.lost_steps == 0


def test_a_recording_is_not_run_backwards(xy):
    with xy.record() as recording:
        xy.run(0.01)
        mujoco.mj_resetData(xy.model, xy.data)
        with pytest.raises(StageError, match="close the recording"):
            xy.run(0.01)
        _ = xy.axes["x"].position
    assert recording.columns["time"][-1] == pytest.approx(0.01)
    xy.run(0.01)
    assert xy.time == pytest.approx(0.01)


def test_a_carriage_put_elsewhere_by_hand_leaves_its_switch(xy):
    """stage.place(x=-0.13); stage.data.qpos[x.plant.qpos] = 0.0; stage.run(2e-3)"""
    x = xy.axes["x"]
    xy.place(x=-0.13)
    assert x.switches.org
    xy.data.qpos[x.plant.qpos] = 0.0
    xy.run(2e-3)
    assert x.position == pytest.approx(0.0, abs=1e-3)
    assert not x.switches.org
    assert not x.chip.pins.org


def test_what_is_put_into_mocap_bodies_after_mj_reset_data_is_where_they_are():
    spec = plant.open_spec("xy")
    spec.worldbody.add_body(name="hand", mocap=True, pos=[0.5, 0.5, 0.5]).add_geom(size=[0.01, 0.01, 0.01])
    stage = Stage(spec, visuals=False)
    wipe(stage)
    stage.data.mocap_pos[0], stage.data.mocap_quat[0] = [1.0, 2.0, 3.0], [0.0, 1.0, 0.0, 0.0]
    stage.run(0.01)
    assert stage.data.body("hand").xpos.tolist() == [1.0, 2.0, 3.0]
    assert stage.data.body("hand").xquat.tolist() == [0.0, 1.0, 0.0, 0.0]
    stage.reset()
    assert stage.data.mocap_pos[0].tolist() == [0.5, 0.5, 0.5]
