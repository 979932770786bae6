"""Checks that MuJoCo's integrator and time step suit a stage: a leapfrog integrator, and steps short enough for the motors.

docs/models.md, "The time step", has the simulated moves from which the bounds follow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import mujoco
import numpy as np

from stage.drives.dc_motors import Servo
from stage.drives.motors import Drive
from stage.errors import ArgumentError, ModelError
from stage.sim.engine_records import NS_PER_SECOND, SLICES
from stage.sim.plant import PlantAxis

LEAPFROG_INTEGRATORS = {
    mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
}  # fmt: skip
MIN_STEP_NS = 100 * SLICES  # ns
MAX_OSCILLATION_PER_STEP_RAD = 1.0
"""rad: what the oscillation of a rotor on its microstep may turn by in a step. Moves lost their first steps from 1.09 on."""
MIN_STEPS_PER_TIME_CONSTANT = 10
"""Minimum number of physics steps in a time constant of a DC motor.

With 11 steps, position control settles as with a hundred; with 8 steps it takes twice as long.
"""
SHIPPED_STEP_S = 0.00025
PROPOSED_STEPS_S = [m * 10.0**e for e in range(-3, -7, -1) for m in (5, 2.5, 1)]


def check_integration_options(model: mujoco.MjModel) -> None:
    """Check the integrator and the time step of a model.

    Raises:
        ModelError: The integrator is not a leapfrog integrator.
        ArgumentError: The time step is out of range.
    """
    integrator, step = int(model.opt.integrator), model.opt.timestep
    if integrator not in {int(i) for i in LEAPFROG_INTEGRATORS}:
        name = mujoco.mjtIntegrator(integrator).name.removeprefix("mjINT_")
        line = '<option integrator="implicitfast"/>'
        raise ModelError(
            f"the model's integrator is {name}. A stage gives MuJoCo one force of its motors a step, as Euler, implicit "
            f"and implicitfast take it; {name} wants several, and loses steps that no machine loses. Write {line}",
            [line],
        )
    if not MIN_STEP_NS - 0.5 <= step * 1e9 <= NS_PER_SECOND:  # not a number is out of range, too
        raise ArgumentError(
            f"timestep {step} s: the stage needs {MIN_STEP_NS} ns to 1 s; the shipped models take {SHIPPED_STEP_S} s."
        )


def check_dampers(model: mujoco.MjModel, axes: Iterable[PlantAxis], drives: Iterable[Drive | Servo]) -> None:
    """Check that MuJoCo's dampers are enabled in a model if a motor has a core loss, which is a damping of its actuator.

    Args:
        model: Model.
        axes: Axes of the model.
        drives: Their drives.

    Raises:
        ModelError: The model disables dampers.
    """
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER:
        return
    lossy = [p.name for p, d in zip(axes, drives, strict=True) if isinstance(d, Drive) and d.motor.core_loss_damping]
    if lossy:
        raise ModelError(
            f'the model has <flag damper="disable"/>, which would drop the core loss of the motor on axis {", ".join(lossy)}: '
            'remove it and write damping="0" at joints that have none, or give a motor with core_loss_resistance=None.'
        )


def check_step_length(
    model: mujoco.MjModel, data: mujoco.MjData, axes: Iterable[PlantAxis], drives: Iterable[Drive | Servo]
) -> None:
    """Check that the time step is short enough for the motors.

    Args:
        model: Model.
        data: Its state after mj_forward.
        axes: Axes of the model.
        drives: Their drives.

    Raises:
        ModelError: The time step is too long for a motor.
    """
    mobility = np.zeros((model.nv, model.nv))
    mujoco.mj_solveM(model, data, mobility, np.eye(model.nv))
    step = model.opt.timestep
    max_step, reason = min(
        _find_max_step(p, d, float(mobility[p.dof, p.dof])) for p, d in zip(axes, drives, strict=True)
    )
    if step <= max_step:
        return
    proposed = min(SHIPPED_STEP_S, next((p for p in PROPOSED_STEPS_S if p <= 0.7 * max_step), 0.7 * max_step))
    line = f'<option timestep="{proposed:g}"/>'
    hint = " (MuJoCo's own, where a model says nothing)" if step == 0.002 else ""
    raise ModelError(
        f"a time step of {step:g} s{hint} is too long: {reason}, which takes steps of {max_step:.2g} s at most; with longer ones "
        f"the motors lose steps, or oscillate, as no machine does. Write {line}",
        [line],
    )


def _find_max_step(axis: PlantAxis, drive: Drive | Servo, mobility: float) -> tuple[float, str]:
    """Return the longest time step for an axis, s, and the reason for this limit.

    Args:
        axis: Axis of the model.
        drive: Drive of the axis.
        mobility: Acceleration of the joint per force, 1/kg (1/(kg m^2) on a hinge).
    """
    m = drive.motor
    if not 0 < mobility < math.inf:
        return math.inf, ""
    if isinstance(drive, Servo):
        constant = drive.motor.resistance / (drive.motor.torque_constant * axis.gear) ** 2 / mobility
        what = f"axis {axis.name} on its {m.name} has a time constant of {constant:.2g} s"
        return constant / MIN_STEPS_PER_TIME_CONSTANT, what
    stiffness = drive.motor.rotor_teeth * (drive.motor.torque_constant * drive.amplitude + 4 * drive.detent_torque)
    omega = math.sqrt(stiffness * mobility) * abs(axis.gear)
    what = f"axis {axis.name} on its {m.name} oscillates at up to {omega / (2 * math.pi):.3g} Hz"
    return (MAX_OSCILLATION_PER_STEP_RAD / omega if omega else math.inf), what
