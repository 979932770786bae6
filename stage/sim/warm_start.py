"""Predict the accelerations from which MuJoCo's solver starts.

MuJoCo starts from `qacc_warmstart`, the accelerations of the last physics step. A drive changes its torque in every step, so the
solver would need two iterations in each. While only the drive, damping and a friction that is overcome act on a joint, the change
of its acceleration is known exactly, and the solver has nothing left to do. In all other cases it iterates from the prediction.
"""

from __future__ import annotations

from stage.drives import drive
from stage.native import hot


@hot
def force_change(axis, t, d, effort_change, speed, damping, core_loss):
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
    torque_change = drive.torque_change(d, effort_change, rotor_change) - core_loss * rotor_change
    return torque_change * t.gear - damping * speed_change
