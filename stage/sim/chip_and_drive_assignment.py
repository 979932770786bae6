"""Choice of a chip's axis and a drive for each axis of the stage, from the arguments `chips=` and `drives=` of `Stage`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from stage.chips import CHIPS, PCL240K, Chip, ChipAxis, chip_class
from stage.drives.dc_motors import DC_MOTORS, DCMotor, Servo, find_dc_motor
from stage.drives.motors import MOTORS, Drive, Motor, find_motor
from stage.drives.power_stages import PowerStage, find_power_stage, is_power_stage, list_power_stages
from stage.errors import ArgumentError, ModelError, unknown_name_error
from stage.sim import plant

ChipChoice = type[Chip] | str | Callable[[], Chip] | Mapping[str, Any]
DriveChoice = Drive | Servo | Motor | DCMotor | PowerStage | str | Mapping[str, Any] | None


def choose_chips_and_drives(
    spec: Any, chips: ChipChoice | None, drives: DriveChoice, clock: int | None = None
) -> tuple[list[str], list[ChipAxis], list[Drive | Servo]]:
    """Choose a chip's axis and a drive for each axis of a stage, from the arguments of `Stage`.

    Args:
        spec: Model, as `plant.open_spec` returns it. It gets the actuators that the drives need.
        chips: Argument `chips` of `Stage`.
        drives: Argument `drives` of `Stage`.
        clock: Argument `clock` of `Stage`, Hz.

    Returns:
        Names of the axes; for each axis, the axis of a chip and the drive.

    Raises:
        ArgumentError: An axis, a chip or a motor does not exist or does not fit.
    """
    chips = _resolve_chip_names(PCL240K if chips is None else chips)
    known = plant.find_axis_names(spec)
    names = list(chips) if isinstance(chips, Mapping) else known
    if not names:
        raise ArgumentError(f"chips={chips!r}: a chip for one axis or more. Axes: {', '.join(known)}.")
    for argument in (chips, drives):
        for name in argument if isinstance(argument, Mapping) else ():
            if name not in known:
                raise unknown_name_error("axis", name, known)
    plant.reserve_fitted_values(spec, names)
    axes = _make_chip_axes(chips, names, clock)
    axis_drives = [_choose_drive(drives, name, axis.chip, spec) for name, axis in zip(names, axes, strict=True)]
    return (
        names,
        [_use_power_stage_chip(axis, drive) for axis, drive in zip(axes, axis_drives, strict=True)],
        axis_drives,
    )


def _use_power_stage_chip(axis: ChipAxis, drive: Drive | Servo) -> ChipAxis:
    """Replace a plain STEP/DIR axis by that of its power stage if the power stage has registers."""
    if not isinstance(drive, Drive) or not drive.power_stage.chip or type(axis.chip).__name__ != "STEPDIR":
        return axis
    from stage.chips.stepdir.power_stage_chips import make_power_stage_chip  # a family is loaded when it is needed

    return make_power_stage_chip(drive.power_stage.chip, drive.power_stage.name, axis.chip.clock_hz).axes[0]


def fit_rotors(
    model: Any, axes: Sequence[plant.PlantAxis], chip_axes: Sequence[ChipAxis], drives: Sequence[Drive | Servo]
) -> None:
    """Fit the rotor of each drive's motor: its inertia into the joint's armature, its core loss as damping of the actuator.

    The inertia replaces the inertia of the motor that the model names, or that an earlier stage has fitted to this MjModel. An
    actuator that has a damping of its own in the model keeps it.

    Raises:
        ModelError: A chip cannot drive the actuator of an MjModel, or an armature is smaller than the rotor that it includes.
    """
    before = model.dof_armature.copy(), model.actuator_damping.copy()
    for p, axis, d in zip(axes, chip_axes, drives, strict=True):
        if p.servo != d.has_encoder:
            have, want = ("<dcmotor>", "<motor>") if p.servo else ("<motor>", "<dcmotor>")
            raise ModelError(
                f"axis {p.name}: {type(axis.chip).__name__} drives a {want}, and this MjModel, which cannot change, has a "
                f"{have}: pass its path or MjSpec."
            )
        fitted = plant.view_fitted_values(model, p.name)
        built_in = d.motor.rotor_inertia
        if p.motor:
            built_in, fitted[0] = fitted[0] or _find_any_motor(p.motor).rotor_inertia, d.motor.rotor_inertia
        armature, inside = float(model.dof_armature[p.dof]), built_in * p.gear**2
        model.dof_armature[p.dof] += (d.motor.rotor_inertia - built_in) * p.gear**2
        if model.dof_armature[p.dof] < 0:
            raise ModelError(
                f"axis {p.name}: the model names motor {p.motor} inside an armature of {armature:g}, but the rotor of that alone "
                f'makes {inside:g}: write armature="{inside:g}" or more, or leave the text {p.name}_motor out.'
            )
        if isinstance(d, Drive) and model.actuator_damping[p.actuator] in (0.0, fitted[1]):
            model.actuator_damping[p.actuator] = fitted[1] = d.motor.core_loss_damping
        _check_friction_and_damping(model, p, d)
    after = model.dof_armature, model.actuator_damping
    if not all(map(np.array_equal, before, after)):
        mujoco.mj_setConst(model, mujoco.MjData(model))  # what MuJoCo has worked out of armature and damping


def _check_friction_and_damping(model: Any, plant_axis: plant.PlantAxis, drive: Drive | Servo) -> None:
    """Check that a motor can overcome the friction and the damping of its joint; a value that is too large is often in other units.

    Raises:
        ModelError: The motor cannot overcome the friction or the damping.
    """
    torque = drive.motor.holding_torque if isinstance(drive, Drive) else drive.peak_torque
    force, unit = torque * abs(plant_axis.gear), "N m" if plant_axis.hinge else "N"
    friction, damping = float(model.dof_frictionloss[plant_axis.dof]), float(model.dof_damping[plant_axis.dof])
    pushes = f"{drive.title} pushes with {force:.4g} {unit} at most"
    if friction >= force:
        raise ModelError(
            f"axis {plant_axis.name}: its joint has a friction of {friction:g} {unit}, and {pushes}: it never moves. "
            f'Write frictionloss="{_format_one_digit(0.05 * force)}", or what is measured; or another gear or motor.'
        )
    loss = float(model.actuator_damping[plant_axis.actuator])
    if not 0 <= 2 * math.pi * loss < torque:
        raise ModelError(
            f"axis {plant_axis.name}: its actuator has a damping of {loss:g} N m s/rad, and the core loss of {drive.title} "
            f"is from 0 up to {torque / (2 * math.pi):.3g}: at one turn a second the motor overcomes no more. "
            "Write what is measured, or leave the damping out for the core loss of the motor."
        )
    turn = 2 * math.pi / abs(plant_axis.gear)  # in a second
    if friction + damping * turn >= force:
        per = f"{unit} s/{'rad' if plant_axis.hinge else 'm'}"
        raise ModelError(
            f"axis {plant_axis.name}: its joint has a damping of {damping:g} {per}: at one turn a second of the motor that is "
            f"{damping * turn:.4g} {unit}, and {pushes}. "
            f'Write damping="{_format_one_digit(0.01 * force / turn)}", or what is measured; or another gear or motor.'
        )


def _format_one_digit(value: float) -> str:
    """Format a value with one significant digit, as a suggestion for a model."""
    return f"{float(f'{value:.0e}'):g}"


def _resolve_chip_names(chips: Any) -> Any:
    """Return chips with their names replaced by classes."""
    if isinstance(chips, Mapping):
        return {axis: _resolve_chip_names(chip) for axis, chip in chips.items()}
    return find_chip_class(chips) if isinstance(chips, str) else chips


def find_chip_class(name: str) -> type[Chip]:
    """Return the chip class of a name, in any case.

    Raises:
        ArgumentError: There is no such chip. If the name is that of a power stage, the message names the argument for it.
        LoadError: The package of the chip cannot be imported.
    """
    if name not in CHIPS and is_power_stage(name):
        raise ArgumentError(
            f"{name.upper()} is a power stage, no chip: chips='stepdir', drives={name.lower()!r} "
            f"(--chips stepdir --drive {name.lower()})."
        )
    return chip_class(name)


def _make_chip_axes(chips: Any, names: list[str], clock_hz: int | None) -> list[ChipAxis]:
    """Make a chip's axis for each named axis of the stage. Axes with the same chip class or function share chips."""
    free: dict[int, list[ChipAxis]] = {}
    chip_axes: list[ChipAxis] = []
    for name in names:
        choice = chips[name] if isinstance(chips, Mapping) else chips
        left = free.setdefault(id(choice), [])
        if not left:
            chip = _make_chip(choice, clock_hz) if callable(choice) else choice
            if not isinstance(chip, Chip):
                raise ArgumentError(
                    f"chips for axis {name}: {choice!r} is no chip class, nor a name of one: {', '.join(CHIPS)}."
                )
            if chip.attached or any(chip is axis.chip for axis in chip_axes):
                raise ArgumentError(f"chips for axis {name}: {choice!r} has no axis left that is free.")
            left += chip.axes
        chip_axes.append(left.pop(0))
    return chip_axes


def _make_chip(choice: Any, clock_hz: int | None) -> Any:
    """Make a chip from a class or a function, with the stage's clock if one is given."""
    return choice() if clock_hz is None or not isinstance(choice, type) else choice(clock_hz=clock_hz)


def _find_any_motor(name: str) -> Motor | DCMotor:
    """Return the stepper or the DC motor with a name."""
    return DC_MOTORS[name] if name in DC_MOTORS else find_motor(name)


def _make_drive(choice: Any, motor: str) -> Drive:
    """Make the drive of a stepper's axis from a motor or a power stage, or their names; `motor` names the model's motor."""
    if choice is None:
        return Drive(find_motor(motor))
    if isinstance(choice, PowerStage) or (choice not in MOTORS and is_power_stage(choice)):
        return Drive(find_motor(motor), power_stage=find_power_stage(choice))
    if isinstance(choice, str) and choice not in MOTORS:
        raise unknown_name_error("motor or power stage", choice, (*MOTORS, *list_power_stages()))
    return Drive(find_motor(choice))


def _choose_drive(drives: Any, axis: str, chip: Chip, spec: Any) -> Drive | Servo:
    """Choose the drive of an axis as requested, or with the motor that the model names. The spec gets the actuator for it."""
    choice, named = drives.get(axis) if isinstance(drives, Mapping) else drives, plant.find_motor_names(spec).get(axis)
    servo = chip.SERVO
    wrong, presets = ((Drive, Motor), MOTORS) if servo else ((Servo, DCMotor), DC_MOTORS)
    if isinstance(choice, wrong) or (isinstance(choice, str) and choice in presets):
        what, want = ("a DC servo", "a Servo or a DC motor") if servo else ("a stepper", "a Drive or a stepper motor")
        label = choice.title if isinstance(choice, Drive | Servo) else getattr(choice, "name", repr(choice))
        raise ArgumentError(
            f"drives for axis {axis}: {type(chip).__name__} drives {what}; {label} is none: give {want}."
        )
    if not servo:
        plant.fit_actuator(spec, axis, None)
        if not isinstance(choice, Drive):
            own = named if named and named not in DC_MOTORS else "17HS4401"
            choice = _make_drive(choice, own)
        return replace(choice, microsteps=chip.MICROSTEPS) if chip.MICROSTEPS else choice
    constants = plant.read_dc_constants(spec, axis)
    if isinstance(choice, Servo):
        amplifier = choice
    elif choice is not None:
        amplifier = Servo(find_dc_motor(choice))
    elif named in DC_MOTORS:
        amplifier = Servo(DC_MOTORS[named])
    elif constants is not None:
        amplifier = Servo(DCMotor(f"that of axis {axis}", constants[1], constants[0], 0.0, constants[0]))
    else:
        amplifier = Servo()
    plant.fit_actuator(spec, axis, (amplifier.motor.torque_constant, amplifier.motor.resistance))
    return amplifier
