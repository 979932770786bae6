"""MuJoCo's solver in the closed loop: it converges, and it starts from accelerations that are predicted well."""

import mujoco
import numpy as np
import pytest

from stage import Stage, firmware
from stage.chips import HCTL1100, PCL240K, PCL240MS
from stage.firmware.driver import Speeds, get_driver


def compute_imbalance(stage):
    """Return the largest force, N or N m, by which mass times acceleration differs from the sum of all forces on a joint."""
    model, data = stage.model, stage.data
    product = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, product, data.qacc)
    return np.abs(product - data.qfrc_smooth - data.qfrc_constraint).max()


@pytest.mark.parametrize(("model", "chips"), [("xyz", PCL240K), ("xy", PCL240MS), ("xyz_servo", HCTL1100)])
def test_forces_balance_in_every_step_also_where_friction_holds_a_carriage(model, chips):
    stage = Stage(model, chips=chips, visuals=False)
    firmware.move(stage.axes["x"], 1e-3)
    for _ in range(800):
        stage.step(1)
        assert compute_imbalance(stage) < 1e-2


@pytest.mark.parametrize(("model", "chips", "max_iterations"), [("xyz", PCL240K, 0.7), ("xyz_servo", HCTL1100, 1.2)])
def test_the_solver_needs_few_iterations_while_carriages_move(model, chips, max_iterations):
    """Start the solver at zero acceleration; from the last step's it takes more than two iterations."""
    stage = Stage(model, chips=chips, visuals=False)
    for axis in stage.axes.values():
        driver = get_driver(axis)
        driver.prepare()
        driver.start_continuous_move(1, Speeds(start=500, drive=2000))
    stage.run(0.3)
    iterations = []
    for _ in range(800):
        stage.step(1)
        iterations.append(int(stage.data.solver_niter.sum()))
    assert np.mean(iterations) < max_iterations
