"""Predict the accelerations from which MuJoCo's solver starts.

MuJoCo starts from `qacc_warmstart`, the accelerations of the last physics step. A drive changes its torque in every step, so the
solver would need two iterations in each. While only the drive, damping and sliding friction act on a joint, the change of its
acceleration is known exactly, and the solver needs no iteration. In all other cases it iterates from the prediction.
"""

from __future__ import annotations

from stage.drives import drive_dispatch
from stage.native import hot


@hot
def compute_force_change(axis, axis_row, drive, effort_change, speed, damping, core_loss):
    """Return the change of a joint's force since the last physics step, N or N m, and note the joint's speed for the next step.

    Args:
        axis: AXIS record of the axis.
        axis_row: The axis' AXIS_ROW record.
        drive: DRIVE record of the axis.
        effort_change: Change of the input of the axis' actuator, N m or V.
        speed: Speed of the joint, m/s (rad/s on a hinge).
        damping: Damping of the joint, N s/m (N m s/rad on a hinge).
        core_loss: Damping of the actuator, N m s/rad.
    """
    speed_change = speed - axis.speed
    axis.speed = speed
    rotor_change = speed_change * axis_row.gear
    torque_change = drive_dispatch.compute_torque_change(drive, effort_change, rotor_change) - core_loss * rotor_change
    return torque_change * axis_row.gear - damping * speed_change


@hot
def apply_effort(
    clockwork, axis, axis_row, drive, position, velocity, ctrl, accelerations, inertia, damping, core_loss
):
    """Set the input of an axis' actuator for the next physics step, and predict the acceleration of its joint.

    Args:
        clockwork: CLOCKWORK of the stage.
        axis: AXIS record of the axis.
        axis_row: The axis' AXIS_ROW record.
        drive: DRIVE record of the axis.
        position: MuJoCo's qpos.
        velocity: MuJoCo's qvel.
        ctrl: MuJoCo's ctrl.
        accelerations: MuJoCo's qacc_warmstart.
        inertia: MuJoCo's dof_M0.
        damping: MuJoCo's dof_damping.
        core_loss: MuJoCo's actuator_damping.
    """
    speed, before = velocity[axis_row.dof], ctrl[axis_row.actuator]
    gain = clockwork.half * axis_row.gear * axis_row.gear / inertia[axis_row.dof]
    theta, omega = position[axis_row.qpos] * axis_row.gear, speed * axis_row.gear
    effort = drive_dispatch.compute_effort(drive, axis.counts, clockwork.slices, theta, omega, clockwork.h, gain)
    ctrl[axis_row.actuator] = effort
    change = compute_force_change(
        axis, axis_row, drive, effort - before, speed, damping[axis_row.dof], core_loss[axis_row.actuator]
    )
    accelerations[axis_row.dof] += change / inertia[axis_row.dof]
