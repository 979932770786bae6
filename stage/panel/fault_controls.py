"""`FaultControls`: what users do to the machine itself: break it, load it, push it. No page.

    controls = FaultControls(session)
    controls.list_forms("x")                            what can break on axis x, with the fields of each
    controls.inject("switch_stuck", "x", {"pin": "org", "closed": "yes"})
    controls.in_force                                   what is broken now; controls.mend(controls.in_force[0])
    controls.push("x", 5.0), controls.push("x", 0.0)    N on the carriage, until it is taken away

What can break, and what it needs, is read from the functions of stage.sim.faults and their signatures: a new fault is there by
itself.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco

from stage.errors import ArgumentError, StageError, unknown
from stage.panel.procedure_forms import Field, FieldError, parse_fields
from stage.sim import faults
from stage.sim.faults import Fault

if TYPE_CHECKING:
    from stage.panel.session import Session
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage


MAX_PUSH = 2.0  # times what the motor can push at its most


def find_max_push(axis: Axis) -> float:
    """Return the force, N (N m on a hinge), with which users may push an axis.

    It tears the axis from its motor, whatever that does. With much more the carriage would go through its end stop.
    """
    return MAX_PUSH * axis.drive.peak_torque * abs(axis.gear)


def find_coupled_axes(stage: Stage, name: str) -> list[str]:
    """Return the other axes whose carriages an equality of the model ties to this one's, as the two that carry a gantry's beam."""
    model = stage.model
    by_root = {int(model.jnt_bodyid[a.joint]): n for n, a in stage.axes.items()}
    found = []
    for k in range(model.neq):
        if int(model.eq_objtype[k]) != int(mujoco.mjtObj.mjOBJ_SITE):
            continue
        sites = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        ends = [_carried_by(model, int(model.site_bodyid[site]), by_root) for site in sites]
        if name in ends:
            found += [end for end in ends if end is not None and end != name]
    return list(dict.fromkeys(found))


def _carried_by(model: mujoco.MjModel, body: int, by_root: dict[int, str]) -> str | None:
    """Return the axis whose joint is the nearest below this body."""
    while body and body not in by_root:
        body = int(model.body_parentid[body])
    return by_root.get(body)


YES, NO = "yes", "no"
UNITS = {"seconds": "s", "volts": "V", "force": "N"}
UNITS_OF_FORCE = {"m": "N", "rad": "N m"}
IMPLICIT_PARAMETERS = frozenset({"body"})  # parameters that stay what they are without anybody's word


class FaultForm(NamedTuple):
    """Form of a fault that can be made.

    Attributes:
        name: Of the function in stage.sim.faults.
        title: The fault in words.
        whole: It is of the stage and not of an axis.
        fields: What it needs.
    """

    name: str
    title: str
    whole: bool
    fields: list[Field]


@dataclass
class ActiveFault:
    """Fault in force.

    Attributes:
        fault: The fault.
        request: What `FaultControls.inject` was called with: name, axis ("": all of them) and texts of the fields.
        key: Only one fault with the same key is in force; "": any number.
    """

    fault: Fault
    request: tuple[str, str, dict[str, str]]
    key: str = ""

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
        self._pushed: dict[str, float] = {}
        self._end_observing = session.on_slice(self._keep_pushing)

    # --- faults ---

    @property
    def in_force(self) -> list[ActiveFault]:
        """Faults that were made here and are in force, in their order."""
        return [m for m in tuple(self._made) if m.fault.in_force]

    def list_forms(self, axis: str) -> list[FaultForm]:
        """Return the forms of what can break on an axis, and of the stage as a whole."""
        out = []
        for name, function in fault_functions().items():
            first, *rest = inspect.signature(function).parameters.values()
            fields = [self._field(axis, p) for p in rest if p.name not in IMPLICIT_PARAMETERS]
            text = (inspect.getdoc(function) or name).split("\n\n")[0].replace("\n", " ").replace("`", "")
            title = name.replace("_", " ")
            out.append(FaultForm(name, f"{title}: {text}", first.annotation == "Stage", fields))
        return out

    def inject(self, name: str, axis: str, texts: Mapping[str, str], key: str = "") -> ActiveFault:
        """Break something, now.

        Args:
            name: Name of a function of stage.sim.faults.
            axis: Name of an axis.
            texts: Texts of its fields.
            key: The fault takes the place of the one that was made with the same key.

        Raises:
            FieldError: A text does not fit its field.
            ArgumentError: No such fault, or it is in force already.
        """
        known = fault_functions()
        if name not in known:
            raise unknown("fault", name, known)
        breaking = next(b for b in self.list_forms(axis) if b.name == name)
        numbers = {f.name for f in breaking.fields if not f.choices}
        parameters = inspect.signature(known[name]).parameters
        values: dict[str, Any] = {}
        texts = {
            n: _decimal(n, str(t)) if n in numbers and "int" in parameters[n].annotation else t
            for n, t in texts.items()
        }
        for field, value in parse_fields(breaking.fields, texts).items():
            whole = "int" in parameters[field].annotation
            if whole and value != int(value):
                raise FieldError(field, f"{value:g}: a whole number.")
            values[field] = {YES: True, NO: False}.get(value, int(value) if whole else value)
        for parameter in parameters.values():
            if (
                parameter.name in {f.name for f in breaking.fields} - set(values)
                and parameter.default is parameter.empty
            ):
                raise FieldError(parameter.name, "say what.")
        stage = self.session.stage
        where: Any = stage if breaking.whole else stage.axes[axis]
        request = (name, axis, {field: str(text) for field, text in texts.items()})
        same = next((made for made in self.in_force if made.request == request and not key), None)
        if same is not None:
            raise ArgumentError(f"{same.text}: it is so already. Mend it, or break something else.")
        return self.session.do(lambda stage: self._make(lambda: known[name](where, **values), request, key))

    def inject_again(self, request: tuple[str, str, dict[str, str]]) -> None:
        """Break what `ActiveFault.request` says. Raises as `inject`."""
        name, axis, texts = request
        if axis:
            self.inject(name, axis, texts)
        else:
            self.set_supply(float(texts["volts"]))

    def mend(self, made: ActiveFault) -> None:
        """Mend a fault, now. What was broken later stays broken."""
        self.session.do(lambda stage: self._mend(made))

    def _make(self, make: Callable[[], Fault], request: tuple[str, str, dict[str, str]], key: str) -> ActiveFault:
        before = next((m for m in self.in_force if key and m.key == key), None)
        if before is not None:
            self._mend(before)
        made = ActiveFault(make(), request, key)
        self._made = [*self.in_force, made]
        return made

    def _mend(self, made: ActiveFault) -> None:
        made.fault.clear()
        self._made = self.in_force

    def _field(self, axis: str, p: inspect.Parameter) -> Field:
        default = "" if p.default in (p.empty, None) else str(p.default)
        choices: tuple[str, ...] = ()
        if p.annotation == "bool":
            choices, default = (YES, NO), YES
        elif p.name == "pin":
            choices = tuple(s.pin for s in self.session.stage.axes[axis].plant.switches)
        elif p.name == "phase":
            choices = tuple(faults.PHASES)
        elif p.name == "motor":
            has = self.session.stage.axes[axis]
            choices = tuple(has.drive.PRESETS)
            default = next(name for name in choices if name != has.drive.motor.name)
        if choices and default not in choices:
            default = choices[0]
        return Field(p.name, p.name, UNITS.get(p.name, ""), default, choices)

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
        """Set the supply voltage of all drives, V; the voltage that they were made for mends it. Raises ArgumentError."""
        stage = self.session.stage
        nominal = next(iter(stage.axes.values())).drive.bus_voltage

        def order(stage: Stage) -> None:
            if volts == nominal:
                for made in [m for m in self.in_force if m.key == "supply"]:
                    self._mend(made)
            else:
                request = ("bus_voltage", "", {"volts": f"{volts!r}"})
                self._make(lambda: faults.bus_voltage(stage, volts), request, "supply")

        self.session.do(order)

    def find_push_unit(self, axis: str) -> str:
        """Return the unit of a push, N or N m."""
        return UNITS_OF_FORCE[self.session.stage.axes[axis].unit]

    def find_max_push(self, axis: str) -> float:
        """Return the force, N (N m on a hinge), that `push` takes, see find_max_push."""
        return find_max_push(self.session.stage.axes[axis])

    def push(self, axis: str, force: float) -> None:
        """Push the carriage with a force, N (N m on a hinge), from now on; 0 takes the push away. Raises FieldError."""
        most = self.find_max_push(axis)
        if not abs(force) <= most:
            unit = self.find_push_unit(axis)
            raise FieldError(
                "force",
                f"{force:g} {unit}: up to {most:.3g} {unit}, twice what this motor can hold; more would only break the end stops.",
            )
        dof = self.session.stage.axes[axis].plant.dof

        def order(stage: Stage) -> None:
            stage.prepare_change()
            self._pushed[axis] = force
            stage.data.qfrc_applied[dof] = force

        self.session.do(order)

    def _keep_pushing(self, stage: Stage) -> None:
        """Push on after each slice: a snapshot may hold another force."""
        for axis, force in self._pushed.items():
            dof = stage.axes[axis].plant.dof
            if stage.data.qfrc_applied[dof] != force:
                stage.data.qfrc_applied[dof] = force

    def close(self) -> None:
        """End all pushes. What is broken stays so."""
        self._end_observing()
        for axis in self._pushed:
            self.push(axis, 0.0)


def _decimal(field: str, text: str) -> str:
    """Return 10h and 0x10 as decimal text, other texts as they are."""
    text = text.strip()
    try:
        if text.lower().startswith("0x"):
            return str(int(text, 16))
        if text.lower().endswith("h"):
            return str(int(text[:-1], 16))
    except ValueError:
        raise FieldError(field, f"{text!r} is not a number: 16, 0x10 or 10h.") from None
    return text
