"""Predict the accelerations from which MuJoCo's solver starts.

MuJoCo starts from `qacc_warmstart`, the accelerations of the last physics step. A drive changes its torque in every step, so the
solver would need two iterations in each. While only the drive, damping and a friction that is overcome act on a joint, the change
of its acceleration is known exactly, and the solver has nothing left to do. In all other cases it iterates from the prediction.
"""

from __future__ import annotations

from stage.drives import drive
from stage.native import hot


@hot
def compute_force_change(axis, t, d, effort_change, speed, damping, core_loss):
    """Return the change of a joint's force since the last physics step, N or N m, and note the joint's speed for the next step.

    Args:
        axis: AXIS of the axis; t, d: its rows of AXIS_TABLE and DRIVE.
        effort_change: Change of what goes to its actuator, N m or V.
        speed: Of the joint, units/s.
        damping: Of the joint, N s/m or N m s/rad.
        core_loss: Damping of the actuator, N m s/rad.
    """
    speed_change = speed - axis.speed
    axis.speed = speed
    rotor_change = speed_change * t.gear
    torque_change = drive.compute_torque_change(d, effort_change, rotor_change) - core_loss * rotor_change
    return torque_change * t.gear - damping * speed_change


@hot
def apply_effort(clock, axis, t, d, q, v, ctrl, accelerations, inertia, damping, core_loss):
    """Set what goes to an axis' actuator in the next physics step, and predict the acceleration of its joint.

    Args:
        clock: CLOCKWORK of the stage.
        axis: AXIS of the axis; t, d: its rows of AXIS_TABLE and DRIVE.
        q, v, ctrl, accelerations: MuJoCo's qpos, qvel, ctrl and qacc_warmstart.
        inertia, damping, core_loss: MuJoCo's dof_M0, dof_damping and actuator_damping.
    """
    speed, before = v[t.dof], ctrl[t.actuator]
    gain = clock.half * t.gear * t.gear / inertia[t.dof]
    effort = drive.compute_effort(d, axis.counts, clock.slices, q[t.qpos] * t.gear, speed * t.gear, clock.h, gain)
    ctrl[t.actuator] = effort
    change = compute_force_change(axis, t, d, effort - before, speed, damping[t.dof], core_loss[t.actuator])
    accelerations[t.dof] += change / inertia[t.dof]
