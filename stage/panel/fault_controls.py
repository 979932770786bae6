"""`FaultControls`: make faults of a session's machine, load its carriages and push them. This module builds no page.

    controls = FaultControls(session)
    controls.list_forms("x")                            the faults that axis x can have, with the fields of each
    controls.make_fault("switch_stuck", "x", {"pin": "org", "closed": "yes"})
    controls.in_force                                   the faults in force; controls.clear_fault(controls.in_force[0])
    controls.push("x", 5.0), controls.push("x", 0.0)    N on the carriage, until it is taken away

The faults and what they need are read from the functions of stage.sim.faults and their signatures: a new one appears by itself.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

from stage.errors import ArgumentError, StageError, unknown_name_error
from stage.panel.procedure_forms import FieldError, FormField, parse_fields
from stage.sim import faults
from stage.sim.faults import Fault

if TYPE_CHECKING:
    from stage.panel.session import Session
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage


MAX_USER_PUSH_RATIO = 2.0  # times the peak force of the motor


def compute_user_push_limit(axis: Axis) -> float:
    """Compute the largest force, N (N m on a hinge), with which users may push an axis.

    This force overcomes the motor in any case. With a much larger one, the carriage would go through its end stop.
    """
    return MAX_USER_PUSH_RATIO * axis.drive.peak_torque * abs(axis.gear)


def find_coupled_axes(stage: Stage, name: str) -> list[str]:
    """Return the other axes whose carriages an equality constraint of the model ties to the carriage of axis `name`."""
    model = stage.model
    axis_of_body = {int(model.jnt_bodyid[axis.joint]): n for n, axis in stage.axes.items()}
    coupled: dict[str, None] = {}
    for k in np.flatnonzero(model.eq_objtype == int(mujoco.mjtObj.mjOBJ_SITE)):
        bodies = model.site_bodyid[[model.eq_obj1id[k], model.eq_obj2id[k]]].tolist()
        axes = [_find_carrying_axis(model, body, axis_of_body) for body in bodies]
        if name in axes:
            coupled |= dict.fromkeys(axis for axis in axes if axis not in (None, name))
    return list(coupled)


def _find_carrying_axis(model: mujoco.MjModel, body: int, axis_of_body: dict[int, str]) -> str | None:
    """Return the name of the axis that carries a body: the nearest of its ancestors in `axis_of_body`, or None."""
    while body and body not in axis_of_body:
        body = int(model.body_parentid[body])
    return axis_of_body.get(body)


BOOLEANS = {"yes": True, "no": False}
UNITS = {"seconds": "s", "volts": "V", "force": "N"}
UNITS_OF_FORCE = {"m": "N", "rad": "N m"}
IMPLICIT_PARAMETERS = frozenset({"body"})  # parameters that keep their defaults


class FaultForm(NamedTuple):
    """Form of a fault that users can make.

    Attributes:
        name: Name of the function in stage.sim.faults.
        title: Description of the fault.
        is_stage_fault: Whether the fault concerns the whole stage and not one axis.
        fields: Fields for the arguments of the function.
    """

    name: str
    title: str
    is_stage_fault: bool
    fields: list[FormField]


class FaultRequest(NamedTuple):
    """Request to make a fault: its name, the axis ("" for the supply voltage of all axes), and the texts of its fields by name."""

    name: str
    axis: str
    texts: dict[str, str]


@dataclass
class ActiveFault:
    """Fault in force.

    Attributes:
        fault: The fault.
        request: Request that made the fault.
    """

    fault: Fault
    request: FaultRequest

    @property
    def text(self) -> str:
        """Description of the fault."""
        return self.fault.text


def list_fault_functions() -> dict[str, Callable[..., Fault]]:
    """Return each function of stage.sim.faults that makes a fault, by its name."""
    return {
        name: f
        for name, f in vars(faults).items()
        if inspect.isfunction(f) and not name.startswith("_") and inspect.signature(f).return_annotation == "Fault"
    }


class FaultControls:
    """Controls for faults, payload, supply and pushes of a session's stage.

    Any thread may call the methods. They return after the stage's thread has made the change.
    """

    def __init__(self, session: Session):
        self.session = session
        self._active_faults: list[ActiveFault] = []
        self._pushes: dict[str, float] = {}
        self._end_observing = session.call_after_pacing_intervals(self._reapply_pushes)

    # --- faults ---

    @property
    def faults_in_force(self) -> list[ActiveFault]:
        """Faults that these controls have made and that are in force, in the order in which they were made."""
        return [active for active in tuple(self._active_faults) if active.fault.in_force]

    def list_forms(self, axis: str) -> list[FaultForm]:
        """Return the forms of the faults that an axis, or the stage as a whole, can have."""
        forms = []
        for name, function in list_fault_functions().items():
            where, *parameters = inspect.signature(function).parameters.values()
            fields = [self._build_field(axis, p) for p in parameters if p.name not in IMPLICIT_PARAMETERS]
            text = (inspect.getdoc(function) or name).split("\n\n")[0].replace("\n", " ").replace("`", "")
            forms.append(FaultForm(name, f"{name.replace('_', ' ')}: {text}", where.annotation == "Stage", fields))
        return forms

    def make_fault(self, name: str, axis: str, texts: Mapping[str, str]) -> ActiveFault:
        """Make a fault now.

        Args:
            name: Name of a function of stage.sim.faults.
            axis: Name of an axis.
            texts: Text of each field of the fault's form, by the name of the field.

        Returns:
            The fault, now in force.

        Raises:
            FieldError: A text does not fit its field.
            ArgumentError: No fault has this name, or the same fault is in force already.
        """
        functions = list_fault_functions()
        if name not in functions:
            raise unknown_name_error("fault", name, functions)
        form = next(form for form in self.list_forms(axis) if form.name == name)
        values = {field: BOOLEANS.get(value, value) for field, value in parse_fields(form.fields, texts).items()}
        request = FaultRequest(name, axis, {field: str(text) for field, text in texts.items()})
        for active in self.faults_in_force:
            if active.request == request:
                raise ArgumentError(f"{active.text}: this fault is in force already. Clear it, or make another one.")
        stage = self.session.stage
        where: Any = stage if form.is_stage_fault else stage.axes[axis]
        return self.session.do(lambda stage: self._add_active_fault(functions[name](where, **values), request))

    def make_fault_again(self, request: FaultRequest) -> None:
        """Make the fault of an earlier `ActiveFault.request`. Raises the errors of `make_fault`."""
        if request.axis:
            self.make_fault(*request)
        else:
            self.set_supply(float(request.texts["volts"]))

    def clear_fault(self, active: ActiveFault) -> None:
        """Clear a fault now. Faults that were made after it stay in force."""
        self.session.do(lambda stage: active.fault.clear())

    def _add_active_fault(self, fault: Fault, request: FaultRequest) -> ActiveFault:
        active = ActiveFault(fault, request)
        self._active_faults = [*self.faults_in_force, active]
        return active

    def _build_field(self, axis_name: str, p: inspect.Parameter) -> FormField:
        axis = self.session.stage.axes[axis_name]
        default = "" if p.default in (p.empty, None) else str(p.default)
        choices: tuple[str, ...] = ()
        if p.annotation == "bool":
            choices = tuple(BOOLEANS)
        elif p.name == "pin":
            choices = tuple(switch.pin for switch in axis.plant.switches)
        elif p.name == "phase":
            choices = tuple(faults.PHASES)
        elif p.name == "motor":
            choices = tuple(axis.drive.PRESETS)
            default = next(name for name in choices if name != axis.drive.motor.name)
        if choices and default not in choices:
            default = choices[0]
        missing = "say what." if p.default is p.empty else ""
        return FormField(
            p.name, p.name, UNITS.get(p.name, ""), default, choices, is_whole="int" in p.annotation, missing=missing
        )

    # --- load and push ---

    @property
    def payload(self) -> float | None:
        """Mass of the payload, kg; None if the model has no payload body."""
        try:
            return self.session.stage.payload()
        except StageError:
            return None

    def set_payload(self, mass: float) -> None:
        """Set the mass of the payload, kg. Raises ArgumentError if the stage refuses the mass."""
        self.session.do(lambda stage: stage.set_payload(mass))

    @property
    def supply(self) -> float:
        """Supply voltage of the drives, V, read from the first axis."""
        return next(iter(self.session.stage.axes.values())).faults.bus_voltage

    def set_supply(self, volts: float) -> None:
        """Set the supply voltage of all drives, V; the nominal voltage of the drives clears this fault.

        Raises:
            ArgumentError: The voltage is out of range.
        """
        nominal = next(iter(self.session.stage.axes.values())).drive.bus_voltage

        def order(stage: Stage) -> None:
            before = [active for active in self.faults_in_force if not active.request.axis]
            if volts != nominal:
                request = FaultRequest("bus_voltage", "", {"volts": f"{volts!r}"})
                self._add_active_fault(faults.bus_voltage(stage, volts), request)
            for active in before:
                active.fault.clear()

        self.session.do(order)

    def find_push_unit(self, axis: str) -> str:
        """Return the unit in which users push an axis: N, or N m on a hinge."""
        return UNITS_OF_FORCE[self.session.stage.axes[axis].unit]

    def compute_user_push_limit(self, axis: str) -> float:
        """Return the largest force, N (N m on a hinge), that `push` accepts for an axis."""
        return compute_user_push_limit(self.session.stage.axes[axis])

    def push(self, axis: str, force: float) -> None:
        """Push the carriage of an axis with a constant force from now on, or end the push.

        Args:
            axis: Name of an axis.
            force: N (N m on a hinge); 0 ends the push.

        Raises:
            FieldError: The force is larger than `compute_user_push_limit`.
        """
        limit = self.compute_user_push_limit(axis)
        if not abs(force) <= limit:
            unit = self.find_push_unit(axis)
            raise FieldError(
                "force",
                f"{force:g} {unit}: up to {limit:.3g} {unit}, twice what this motor can hold; more would only break the end stops.",
            )

        def order(stage: Stage) -> None:
            stage.prepare_change()
            self._pushes[axis] = force
            self._reapply_pushes(stage)

        self.session.do(order)

    def _reapply_pushes(self, stage: Stage) -> None:
        """Set the forces of all pushes again after each slice: a restored snapshot may hold other forces."""
        for axis, force in self._pushes.items():
            stage.data.qfrc_applied[stage.axes[axis].plant.dof] = force

    def close(self) -> None:
        """End all pushes. Faults stay in force."""
        self._end_observing()
        for axis in self._pushes:
            self.push(axis, 0.0)
