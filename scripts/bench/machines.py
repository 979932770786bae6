"""Stages in motion, and the same models without chips, drives and switches."""

from __future__ import annotations

from importlib import resources
from typing import Any

import mujoco
import mujoco.batch
import numpy as np

from stage import Stage
from stage.chips import PCL240K
from stage.firmware import ChipPort
from stage.firmware.pcl240.chip_port import CONTROL, MINUS, RAMP_START_COMMANDS, RESET

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
SETTLED = 0.3  # s, ramps are over
RATE = dict(R0=0, R1=25, R2=100, R3=100, R4=1500, R5=1500, R6=0, R7=30)  # 500 to 2000 pps: 6.25 mm/s
MATCHING = 12  # times that the bare model's torque is corrected
LEG = 1.0  # s of a run to and fro


def run_continuously(stage: Stage, minus: bool = False) -> None:
    """Let every axis ramp up to its speed and keep it.

    Args:
        stage: Stage to move.
        minus: Whether the axes move in the minus direction.
    """
    for axis in stage.axes.values():
        for command in (RESET, CONTROL | (MINUS if minus else 0), RAMP_START_COMMANDS["FH1"]):
            axis.chip.write(0, command)


def make_moving_stage(model: Any = "xyz", **settings: Any) -> Stage:
    """Make a stage whose motors run for as long as a comparison takes, some seconds.

    Args:
        model: Model of the stage.
        **settings: Other arguments of `Stage`.
    """
    stage = Stage(model, chips=PCL240K, **settings)
    for axis in stage.axes.values():
        ChipPort(axis).write_registers(**RATE)
    run_continuously(stage)
    stage.run(SETTLED)
    return stage


def run_shuttle(stage: Stage, seconds: float) -> None:
    """Move the axes of a stage of `make_moving_stage` back and forth for some simulated seconds."""
    minus = False
    while seconds > 0:
        run_continuously(stage, minus)
        stage.run(min(LEG, seconds))
        seconds -= LEG
        minus = not minus


def measure_mean_torque(stage: Stage, steps: int) -> np.ndarray:
    """Measure the torques that would move carriages without chips and motors in the same way.

    Args:
        stage: Stage in motion, which runs on for `steps` physics steps.
        steps: Number of physics steps.

    Returns:
        Mean torque of each actuator.
    """
    torque = np.zeros(stage.model.nu)
    with stage.record() as recording:
        stage.step(steps)
    for name in stage.axes:
        torque[stage.model.actuator(name).id] = recording.column(f"{name}/torque").mean()
    return torque


class BareModel:
    """Model of a stage with mj_step alone: from the stage's present state, constant torques move it as far as the stage moves.

    Args:
        stage: Stage in motion.
        steps: Physics steps over which the torques are measured.
    """

    def __init__(self, stage: Stage, steps: int = 4000):
        self.model, self.data = stage.model, mujoco.MjData(stage.model)
        start = stage.snapshot()
        self.start, self.torque = start.state, measure_mean_torque(stage, steps)
        way = stage.data.qpos.copy()
        stage.restore(start)
        self.began, self.velocity = stage.data.qpos.copy(), stage.data.qvel.copy()
        self.way = way - self.began
        self._match(stage, steps)

    def _match(self, stage: Stage, steps: int) -> None:
        """Correct the torques by the damping: friction hardly depends on speed, so the mean torque leaves the speed open."""
        axes = [(p.joint, stage.model.actuator(name).id, p.gear) for name, p in stage.axes.items()]
        seconds = steps * self.model.opt.timestep
        for _ in range(MATCHING):
            self.reset()
            self.step(steps)
            for joint, actuator, gear in axes:
                dof, q = self.model.jnt_dofadr[joint], self.model.jnt_qposadr[joint]
                missing = self.began[q] + self.way[q] - self.data.qpos[q]
                damping = self.model.dof_damping[dof] + self.model.actuator_damping[actuator] * gear**2
                self.torque[actuator] += damping * missing / seconds / gear

    def reset(self) -> None:
        mujoco.mj_setState(self.model, self.data, self.start, STATE)
        self.data.ctrl[:] = self.torque

    def step(self, n: int) -> None:
        mujoco.mj_step(self.model, self.data, n)


class MujocoBatch:
    """Batch of n copies of the bare model, in the middle of a move of three axes.

    Args:
        n: Number of copies.
        threads: Number of threads; None: one for each processor.
    """

    def __init__(self, n: int, threads: int | None):
        moving = make_moving_stage(visuals=False)
        bare = BareModel(moving)
        self.batch = mujoco.batch.Batch(moving.model, nsim=n, nthread=threads)
        self.qpos, self.qvel, self.ctrl = (self.batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.move = bare.began, bare.velocity, bare.torque
        self.nstep = 1

    def reset(self, seed: int | None = None) -> None:
        self.batch.reset()
        self.qpos[:], self.qvel[:], self.ctrl[:] = self.move

    def step(self, actions: Any = None) -> None:
        self.batch.step(nstep=self.nstep)


def find_model_path(name: str = "xyz") -> str:
    """Return the path of a shipped model."""
    return str(resources.files("stage.models") / f"{name}.xml")


def make_axes_model(n: int) -> mujoco.MjSpec:
    """Make a model of `n` axes side by side, each like X of the shipped `xy`: rail, motor, carriage, switches, hard stops."""
    row = mujoco.MjSpec()
    for k in range(n):
        one = mujoco.MjSpec.from_file(find_model_path("xy"))
        one.delete(one.body("y"))
        for key in list(one.keys):
            one.delete(key)
        for field in ("timestep", "integrator", "cone", "iterations", "ls_iterations"):
            setattr(row.option, field, getattr(one.option, field))
        row.visual.map.znear, row.visual.map.zfar = one.visual.map.znear, one.visual.map.zfar
        row.attach(one, prefix=f"a{k}_", frame=row.worldbody.add_frame(pos=[0, 0.7 * k, 0]))
    return row
