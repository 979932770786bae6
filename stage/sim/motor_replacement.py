"""Replacement of the motor of an axis in a finished stage: changes of the model, and of the state after power-up."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from stage.drives import drive_dispatch as any_drive
from stage.drives.dc_motors import Servo
from stage.drives.motors import Drive
from stage.errors import ArgumentError
from stage.sim import mujoco_callback_guards
from stage.sim.integration_checks import check_dampers, check_step_length
from stage.sim.plant import view_fitted_values
from stage.sim.stage_state import SAVED_STATE_SPEC, State

if TYPE_CHECKING:
    from stage.sim.axis import Axis


def replace_motor_in_model(
    model: Any, present_state: mujoco.MjData, axes: Sequence[Axis], axis: Axis, drive: Drive | Servo
) -> None:
    """Fit the rotor and the core loss of a drive's motor to the joint of an axis, in place of those of the present motor.

    An actuator <dcmotor> gets the constants of the motor.

    Args:
        model: Model of the stage.
        present_state: Present state, for the positions of all axes.
        axes: All axes of the stage.
        axis: Axis to change.
        drive: Its new drive.

    Raises:
        ArgumentError: The armature is smaller than the rotor of the present motor; the model is then as it was.
        ModelError: The motor cannot be simulated; the model is then as it was.
    """
    p, rotor = axis.plant, drive.motor.rotor_inertia
    now = axis.armature + (axis.drive.motor.rotor_inertia - axis.rotor) * p.gear**2
    # to the bit what it was, when the motor of before comes back
    armature = axis.armature + (rotor - axis.rotor) * p.gear**2
    if model.dof_armature[p.dof] != now:  # somebody has changed it
        armature = model.dof_armature[p.dof] + (rotor - axis.drive.motor.rotor_inertia) * p.gear**2
    if armature < 0:
        raise ArgumentError(
            f"motor={drive.motor.name!r}: axis {axis.name} has an armature of {model.dof_armature[p.dof]:g}, less than the rotor "
            f"of its {axis.drive.motor.name} makes alone: build a stage with the other motor."
        )
    trial = copy.copy(model)
    _set_model_values(trial, axis, drive, armature)
    data = mujoco.MjData(trial)
    data.time, data.qpos[:] = present_state.time, present_state.qpos
    mujoco_callback_guards.forward_guarded(trial, data)
    plants, drives = [a.plant for a in axes], [drive if a is axis else a.drive for a in axes]
    check_dampers(trial, plants, drives)
    check_step_length(trial, data, plants, drives)
    _set_model_values(model, axis, drive, armature)


def vary_drive(axis: Axis, drive: Drive | Servo) -> None:
    """Change losses, windings and supply voltage of an axis, as of another specimen of the same motor and supply.

    The rotor inertia stays, so snapshots that were taken before remain valid. MuJoCo computes its constants again only if a damping
    becomes zero or nonzero.

    Args:
        axis: Axis of a stage.
        drive: Its drive from now on.
    """
    stage, model, actuator = axis.stage, axis.stage.model, axis.plant.actuator
    stage.prepare_change()
    damped = bool(model.actuator_damping[actuator])
    _set_motor_constants(model, axis, drive)
    if bool(model.actuator_damping[actuator]) != damped:
        mujoco.mj_setConst(model, mujoco.MjData(model))
    set_drive_record(stage.state, axis, drive, stage.state.drives[axis.index])
    axis.drive, axis.faults.bus_voltage = drive, drive.bus_voltage
    stage.apply_faults()


def _set_model_values(model: Any, axis: Axis, drive: Drive | Servo, armature: float) -> None:
    """Write armature, rotor and windings of a drive into the model, and update MuJoCo's derived constants."""
    model.dof_armature[axis.plant.dof] = armature
    fitted = view_fitted_values(model, axis.name)
    fitted[0] = drive.motor.rotor_inertia if axis.plant.motor else 0.0
    _set_motor_constants(model, axis, drive)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _set_motor_constants(model: Any, axis: Axis, drive: Drive | Servo) -> None:
    """Write the core loss of a stepper motor, or resistance and torque constant of a DC motor, into the model."""
    if isinstance(drive, Drive) and isinstance(axis.drive, Drive):
        damping = model.actuator_damping[axis.plant.actuator : axis.plant.actuator + 1]
        if damping[0] == axis.drive.motor.core_loss_damping:  # else it is the model's own
            damping[0] = view_fitted_values(model, axis.name)[1] = drive.motor.core_loss_damping
    elif isinstance(drive, Servo):
        model.actuator_gainprm[axis.plant.actuator, :2] = drive.motor.resistance, drive.motor.torque_constant


def set_drive_record(state: State, axis: Axis, drive: Drive | Servo, drive_record: Any) -> None:
    """Write the constants of a drive into a DRIVE record. The angle stays and the currents follow: no jump, no lost step.

    Args:
        state: State of the stage.
        axis: Axis of the drive.
        drive: The drive.
        drive_record: DRIVE record.
    """
    current = drive_record.current
    drive.fill_record(drive_record)
    if state.chip_table[state.axis_table[axis.index].chip].read_motor_current:
        drive_record.current = current  # is the chip's to say


def compute_power_up_state(state: State, axis: Axis, drive: Drive | Servo, former_state: np.ndarray) -> np.ndarray:
    """Compute the state of power-up with another drive, whose currents have settled.

    Args:
        state: State of the stage.
        axis: Axis of the drive.
        drive: The drive.
        former_state: State of power-up with the former drive, float64 (words,).
    """
    n = len(state.saved)
    data = mujoco.MjData(state.model)
    mujoco.mj_setState(state.model, data, former_state[:n], SAVED_STATE_SPEC)
    begin = (state.drives.ctypes.data - state.data.userdata.ctypes.data) // data.userdata.itemsize
    words = state.drives.nbytes // data.userdata.itemsize
    record = data.userdata[begin : begin + words].view(state.drives.dtype)[axis.index]
    set_drive_record(state, axis, drive, record)
    any_drive.power_up(record, 0.0, float(data.qpos[axis.plant.qpos]) * axis.gear)
    after = former_state.copy()
    mujoco.mj_getState(state.model, data, after[:n], SAVED_STATE_SPEC)
    return after
