"""`MotionController` without EPICS: its end, and the top speed of an axis."""

import gc
import threading
import weakref

import pytest

from stage import Stage, firmware
from stage.ioc.motion_controller import MotionController, MotionProfile
from stage.tune import compute_top_speed


def test_a_closed_controller_leaves_neither_threads_nor_its_stage():
    threads = set(threading.enumerate())
    stage = Stage("xyz", chips="pcl240mk", visuals=False)
    controller = MotionController(stage, pace=1.0, publish=lambda readings: None)
    for name in "xy":
        controller.begin_axis_action(name, lambda axis: axis.begin_move(10.0, MotionProfile(1.0, 0.0, 0.1)))
    controller.post_to_worker(lambda stage: None).result(20)
    assert len(set(threading.enumerate()) - threads) == 3, "a worker, and a procedure of each axis"
    controller.close()
    assert set(threading.enumerate()) <= threads
    dropped = weakref.ref(stage)
    del stage, controller
    gc.collect()
    assert dropped() is None


@pytest.mark.parametrize(("model", "chips"), [("xyz", "pcl240mk"), ("xyz_servo", "hctl1100")])
def test_an_axis_moves_at_half_its_top_speed_without_lost_steps(model, chips):
    stage = Stage(model, chips=chips, visuals=False)
    x = stage.axes["x"]
    top = compute_top_speed(x)
    assert 0.05 < top < 2.0
    report = firmware.move(x, 0.1, speed=0.5 * top)
    assert report.lost_steps in (0, None)
    assert abs(x.position - 0.1) < 1e-3
