"""A family of chips from outside, two registers, in a folder of its own (tests/toy): what PulseStage makes of it unasked."""

import gymnasium
import numpy as np
import pytest
from toy import TOY

import stage.envs  # noqa: F401
from stage import ArgumentError, Fleet, Program, Stage, faults, firmware
from stage.board import Board
from stage.chips import PCL240K


@pytest.fixture
def stage_():
    return Stage("xy", chips=TOY, visuals=False)


def test_it_moves_a_stage_by_metres_with_the_same_report(stage_, tmp_path):
    x = stage_.axes["x"]
    report = firmware.move(x, 1e-3)
    assert report.ok
    assert (report.pulses, report.stopped_by, report.residual) == (320, "all pulses", None)
    assert x.position == pytest.approx(1e-3, abs=20e-6)
    assert report.duration == pytest.approx(0.32, rel=0.02)
    assert report.peak_rate == pytest.approx(1000)
    assert [meaning for _, _, meaning in report.writes()] == ["RATE <- 1000", "COUNT <- 320", "go plus"]
    report.plot(tmp_path / "toy.png")
    assert firmware.jog(x, 0.1).stopped_by == "decelerating stop"
    with pytest.raises(ArgumentError, match="a TOY has no origin return"):
        firmware.home(x)
    with pytest.raises(ArgumentError, match="a TOY draws no lines"):
        firmware.line({"x": 1e-3, "y": 1e-3}, stage_)


def test_limit_switches_stop_it(stage_):
    x = stage_.axes["x"]
    with faults.switch_stuck(x, "el_plus", True):
        assert firmware.move(x, 1e-3).stopped_by == "EL+"
        assert firmware.move(x, -1e-3).ok


def test_snapshots_recordings_and_fleets_take_it(stage_, tmp_path):
    x = stage_.axes["x"]
    x.chip.write(1, 2000)
    x.chip.write(2, 400)
    before = stage_.snapshot()
    with stage_.record() as recording:
        x.chip.write(0, 1)
        stage_.run(0.25)
    assert recording.columns["x/pulses"][-1] == 400
    recording.to_vcd(tmp_path / "toy.vcd")
    recording.save(tmp_path / "toy.rrd")
    end_position = x.position
    stage_.restore(before)
    x.chip.write(0, 1)
    stage_.run(0.25)
    assert x.position == end_position
    stage_.restore(before)
    Fleet([stage_], 1).play([Program().command(0, 1).wait(0.25)])
    assert x.position == pytest.approx(end_position, abs=1e-9)
    mixed = Stage("xy", chips={"x": TOY, "y": PCL240K}, visuals=False)
    assert firmware.move(mixed.axes["x"], pulses=100).ok
    assert firmware.move(mixed.axes["y"], pulses=100).ok


def test_a_board_decodes_the_registers_of_a_new_family_in_its_trace(stage_):
    board = Board(stage_)
    board.out16(min(board.ports) + 2, 500)
    board.out8(min(board.ports), 2)
    assert "x: RATE <- 500" in board.trace.text()


def test_it_can_be_tuned_by_an_environment():
    env = gymnasium.make("stage/RegisterTuning-v0", chip=TOY, model="xy", distances=(200, 300), moves=2)
    env.reset(seed=1)
    _, reward, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
    assert np.isfinite(reward)
    env.close()
