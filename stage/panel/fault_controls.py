"""`FaultControls`: what users do to the machine itself: make faults, load it, push it. No page.

    controls = FaultControls(session)
    controls.list_forms("x")                            the faults that axis x can have, with the fields of each
    controls.make("switch_stuck", "x", {"pin": "org", "closed": "yes"})
    controls.in_force                                   the faults in force; controls.clear(controls.in_force[0])
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

    It tears the axis from its motor, whatever that does. With much more the carriage would go through its end stop.
    """
    return MAX_USER_PUSH_RATIO * axis.drive.peak_torque * abs(axis.gear)


def find_coupled_axes(stage: Stage, name: str) -> list[str]:
    """Return the other axes whose carriages an equality of the model ties to this one's, as the two that carry a gantry's beam."""
    model = stage.model
    axis_of_body = {int(model.jnt_bodyid[axis.joint]): n for n, axis in stage.axes.items()}
    coupled: dict[str, None] = {}
    for k in np.flatnonzero(model.eq_objtype == int(mujoco.mjtObj.mjOBJ_SITE)):
        bodies = model.site_bodyid[[model.eq_obj1id[k], model.eq_obj2id[k]]].tolist()
        axes = [_find_carrier(model, body, axis_of_body) for body in bodies]
        if name in axes:
            coupled |= dict.fromkeys(axis for axis in axes if axis not in (None, name))
    return list(coupled)


def _find_carrier(model: mujoco.MjModel, body: int, axis_of_body: dict[int, str]) -> str | None:
    """Return the axis whose joint is the nearest below this body."""
    while body and body not in axis_of_body:
        body = int(model.body_parentid[body])
    return axis_of_body.get(body)


BOOLEANS = {"yes": True, "no": False}
UNITS = {"seconds": "s", "volts": "V", "force": "N"}
UNITS_OF_FORCE = {"m": "N", "rad": "N m"}
IMPLICIT_PARAMETERS = frozenset({"body"})  # parameters that keep their defaults


class FaultForm(NamedTuple):
    """Form of a fault that can be made.

    Attributes:
        name: Name of the function in stage.sim.faults.
        title: The fault in words.
        is_of_stage: It is a fault of the stage and not of an axis.
        fields: What it needs.
    """

    name: str
    title: str
    is_of_stage: bool
    fields: list[FormField]


class FaultRequest(NamedTuple):
    """Fault that somebody has made: its name, the axis ("" for a supply voltage of all axes), and texts of its fields."""

    name: str
    axis: str
    texts: dict[str, str]


@dataclass
class ActiveFault:
    """Fault in force.

    Attributes:
        fault: The fault.
        request: Arguments with which it was made.
    """

    fault: Fault
    request: FaultRequest

    @property
    def text(self) -> str:
        """The fault in words."""
        return self.fault.text


def fault_functions() -> dict[str, Callable[..., Fault]]:
    """Return the functions of stage.sim.faults that make a fault, by name."""
    return {
        name: f
        for name, f in vars(faults).items()
        if inspect.isfunction(f) and not name.startswith("_") and inspect.signature(f).return_annotation == "Fault"
    }


class FaultControls:
    """Controls of a session. The methods may be called from any thread, and return when the stage's thread has done it."""

    def __init__(self, session: Session):
        self.session = session
        self._made: list[ActiveFault] = []
        self._pushes: dict[str, float] = {}
        self._end_observing = session.on_slice(self._keep_pushing)

    # --- faults ---

    @property
    def in_force(self) -> list[ActiveFault]:
        """Faults that were made here and are in force, in their order."""
        return [active for active in tuple(self._made) if active.fault.in_force]

    def list_forms(self, axis: str) -> list[FaultForm]:
        """Return the forms of the faults that an axis, or the stage as a whole, can have."""
        forms = []
        for name, function in fault_functions().items():
            where, *parameters = inspect.signature(function).parameters.values()
            fields = [self._describe_field(axis, p) for p in parameters if p.name not in IMPLICIT_PARAMETERS]
            text = (inspect.getdoc(function) or name).split("\n\n")[0].replace("\n", " ").replace("`", "")
            forms.append(FaultForm(name, f"{name.replace('_', ' ')}: {text}", where.annotation == "Stage", fields))
        return forms

    def make(self, name: str, axis: str, texts: Mapping[str, str]) -> ActiveFault:
        """Make a fault, now.

        Args:
            name: Name of a function of stage.sim.faults.
            axis: Name of an axis.
            texts: Texts of its fields.

        Raises:
            FieldError: A text does not fit its field.
            ArgumentError: No such fault, or it is in force already.
        """
        functions = fault_functions()
        if name not in functions:
            raise unknown_name_error("fault", name, functions)
        form = next(form for form in self.list_forms(axis) if form.name == name)
        values = {field: BOOLEANS.get(value, value) for field, value in parse_fields(form.fields, texts).items()}
        request = FaultRequest(name, axis, {field: str(text) for field, text in texts.items()})
        for active in self.in_force:
            if active.request == request:
                raise ArgumentError(f"{active.text}: this fault is in force already. Clear it, or make another one.")
        stage = self.session.stage
        where: Any = stage if form.is_of_stage else stage.axes[axis]
        return self.session.do(lambda stage: self._add(functions[name](where, **values), request))

    def make_again(self, request: FaultRequest) -> None:
        """Make the fault of `ActiveFault.request`. Raises as `make`."""
        if request.axis:
            self.make(*request)
        else:
            self.set_supply(float(request.texts["volts"]))

    def clear(self, active: ActiveFault) -> None:
        """Clear a fault, now. Faults that were made later stay."""
        self.session.do(lambda stage: active.fault.clear())

    def _add(self, fault: Fault, request: FaultRequest) -> ActiveFault:
        active = ActiveFault(fault, request)
        self._made = [*self.in_force, active]
        return active

    def _describe_field(self, axis_name: str, p: inspect.Parameter) -> FormField:
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
        """Mass on the carriage, kg; None where the model has no place for it."""
        try:
            return self.session.stage.payload()
        except StageError:
            return None

    def set_payload(self, mass: float) -> None:
        """Put a mass, kg, on the carriage. Raises ArgumentError."""
        self.session.do(lambda stage: stage.set_payload(mass))

    @property
    def supply(self) -> float:
        """Supply voltage of the first axis' drive, V."""
        return next(iter(self.session.stage.axes.values())).faults.bus_voltage

    def set_supply(self, volts: float) -> None:
        """Set the supply voltage of all drives, V; their nominal voltage clears the fault. Raises ArgumentError."""
        nominal = next(iter(self.session.stage.axes.values())).drive.bus_voltage

        def order(stage: Stage) -> None:
            before = [active for active in self.in_force if not active.request.axis]
            if volts != nominal:
                request = FaultRequest("bus_voltage", "", {"volts": f"{volts!r}"})
                self._add(faults.bus_voltage(stage, volts), request)
            for active in before:
                active.fault.clear()

        self.session.do(order)

    def find_push_unit(self, axis: str) -> str:
        """Return the unit of a push, N or N m."""
        return UNITS_OF_FORCE[self.session.stage.axes[axis].unit]

    def compute_user_push_limit(self, axis: str) -> float:
        """Return the force, N (N m on a hinge), that `push` takes at most; see compute_user_push_limit."""
        return compute_user_push_limit(self.session.stage.axes[axis])

    def push(self, axis: str, force: float) -> None:
        """Push the carriage from now on, or end the push.

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
            self._keep_pushing(stage)

        self.session.do(order)

    def _keep_pushing(self, stage: Stage) -> None:
        """Push on after each slice: a snapshot may hold another force."""
        for axis, force in self._pushes.items():
            stage.data.qfrc_applied[stage.axes[axis].plant.dof] = force

    def close(self) -> None:
        """End all pushes. Faults stay."""
        self._end_observing()
        for axis in self._pushes:
            self.push(axis, 0.0)
