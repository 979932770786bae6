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

from stage.drives.dc_motors import DC_MOTORS
from stage.drives.motors import MOTORS
from stage.errors import ArgumentError, StageError, unknown
from stage.panel.procedure_forms import Field, FieldError, parse_fields
from stage.sim import faults
from stage.sim.faults import Fault

if TYPE_CHECKING:
    from stage.panel.session import Session
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage


MOST = 2.0  # times what the motor can push at its most


def find_max_push(axis: Axis) -> float:
    """N (N m on a hinge) with which a hand may push an axis: enough to tear it from its motor, whatever that does. With much more
    the carriage would go through its end stop."""
    return MOST * axis.drive.peak_torque * abs(axis.gear)


def tied(stage: Stage, name: str) -> list[str]:
    """The other axes whose carriages an equality of the model holds to this one's, as the two that carry a gantry's beam."""
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
    """The axis whose joint is the nearest below this body."""
    while body and body not in by_root:
        body = int(model.body_parentid[body])
    return by_root.get(body)


YES, NO = "yes", "no"
UNITS = {"seconds": "s", "volts": "V", "force": "N"}
UNITS_OF_FORCE = {"m": "N", "rad": "N m"}
SAME = frozenset({"body"})  # parameters that stay what they are without anybody's word


class FaultForm(NamedTuple):
    """Something that can break. title: in words; whole: of the stage and not of an axis; fields: what it asks for."""

    name: str
    title: str
    whole: bool
    fields: list[Field]


@dataclass
class ActiveFault:
    """A fault in force, and what was asked for it. asked: the name, the axis ("": all of
    them) and the texts that `FaultControls.make` takes."""

    fault: Fault
    asked: tuple[str, str, dict[str, str]]
    key: str = ""

    @property
    def text(self) -> str:
        """What it is."""
        return self.fault.text


def functions() -> dict[str, Callable[..., Fault]]:
    """Everything of stage.sim.faults that makes a fault, by name."""
    return {
        name: f
        for name, f in vars(faults).items()
        if inspect.isfunction(f) and not name.startswith("_") and inspect.signature(f).return_annotation == "Fault"
    }


class FaultControls:
    """Of a session. Its methods may be called from any thread; they last until the stage's thread has done it."""

    def __init__(self, session: Session):
        self.session = session
        self._made: list[ActiveFault] = []
        self._pushed: dict[str, float] = {}
        self._over = session.on_slice(self._look)

    # --- faults ---

    @property
    def in_force(self) -> list[ActiveFault]:
        """What has been broken here and is so still, in its order."""
        return [m for m in tuple(self._made) if m.fault.in_force]

    def list_forms(self, axis: str) -> list[FaultForm]:
        """What can break on an axis, and of the stage as a whole."""
        out = []
        for name, function in functions().items():
            first, *rest = inspect.signature(function).parameters.values()
            fields = [self._field(axis, p) for p in rest if p.name not in SAME]
            text = (inspect.getdoc(function) or name).split("\n\n")[0].replace("\n", " ").replace("`", "")
            title = name.replace("_", " ")
            out.append(FaultForm(name, f"{title}: {text}", first.annotation == "Stage", fields))
        return out

    def make(self, name: str, axis: str, given: Mapping[str, str], key: str = "") -> ActiveFault:
        """Break it, now. key: takes the place of what was made by the same key. Raises FieldError, ArgumentError."""
        known = functions()
        if name not in known:
            raise unknown("fault", name, known)
        breaking = next(b for b in self.list_forms(axis) if b.name == name)
        numbers = {f.name for f in breaking.fields if not f.choices}
        parameters = inspect.signature(known[name]).parameters
        values: dict[str, Any] = {}
        texts = {
            n: _decimal(n, str(t)) if n in numbers and "int" in parameters[n].annotation else t
            for n, t in given.items()
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
        asked = (name, axis, {field: str(text) for field, text in given.items()})
        same = next((made for made in self.in_force if made.asked == asked and not key), None)
        if same is not None:
            raise ArgumentError(f"{same.text}: it is so already. Mend it, or break something else.")
        return self.session.do(lambda stage: self._make(lambda: known[name](where, **values), asked, key))

    def make_again(self, asked: tuple[str, str, dict[str, str]]) -> None:
        """What `ActiveFault.asked` says. Raises as `make`."""
        name, axis, given = asked
        if axis:
            self.make(name, axis, given)
        else:
            self.set_supply(float(given["volts"]))

    def mend(self, made: ActiveFault) -> None:
        """Mend it, now. What was broken later is broken still."""
        self.session.do(lambda stage: self._mend(made))

    def _make(self, make: Callable[[], Fault], asked: tuple[str, str, dict[str, str]], key: str) -> ActiveFault:
        before = next((m for m in self.in_force if key and m.key == key), None)
        if before is not None:
            self._mend(before)
        made = ActiveFault(make(), asked, key)
        self._made = [*self.in_force, made]
        return made

    def _mend(self, made: ActiveFault) -> None:
        made.fault.mend()
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
            choices = tuple(DC_MOTORS if has.chip.SERVO else MOTORS)
            default = next(name for name in choices if name != has.drive.motor.name)
        if choices and default not in choices:
            default = choices[0]
        return Field(p.name, p.name, UNITS.get(p.name, ""), default, choices)

    # --- load and push ---

    @property
    def payload(self) -> float | None:
        """kg on the carriage; None where the model has no place for it."""
        try:
            return self.session.stage.payload()
        except StageError:
            return None

    def load(self, mass: float) -> None:
        """So many kg on the carriage. Raises ArgumentError."""
        self.session.do(lambda stage: stage.set_payload(mass))

    @property
    def supply(self) -> float:
        """V that the drives have, of the first axis."""
        return next(iter(self.session.stage.axes.values())).supply

    def set_supply(self, volts: float) -> None:
        """The supply of all drives is so many V; what it was made with mends it. Raises ArgumentError."""
        stage = self.session.stage
        nominal = next(iter(stage.axes.values())).drive.bus_voltage

        def order(stage: Stage) -> None:
            if volts == nominal:
                for made in [m for m in self.in_force if m.key == "supply"]:
                    self._mend(made)
            else:
                asked = ("bus_voltage", "", {"volts": f"{volts!r}"})
                self._make(lambda: faults.bus_voltage(stage, volts), asked, "supply")

        self.session.do(order)

    def find_push_unit(self, axis: str) -> str:
        """N, or N m."""
        return UNITS_OF_FORCE[self.session.stage.axes[axis].unit]

    def find_max_push(self, axis: str) -> float:
        """N (N m on a hinge) that `push` takes, see travel.py."""
        return find_max_push(self.session.stage.axes[axis])

    def push(self, axis: str, force: float) -> None:
        """A force, N (N m on a hinge), on the carriage from now on; 0 takes the hand away. Raises FieldError."""
        most = self.find_max_push(axis)
        if not abs(force) <= most:
            unit = self.find_push_unit(axis)
            raise FieldError(
                "force",
                f"{force:g} {unit}: up to {most:.3g} {unit}, twice what this motor can hold; more would only break the end stops.",
            )
        dof = self.session.stage.axes[axis].plant.dof

        def order(stage: Stage) -> None:
            stage.change()
            self._pushed[axis] = force
            stage.data.qfrc_applied[dof] = force

        self.session.do(order)

    def _look(self, stage: Stage) -> None:
        """After each slice: a snapshot in which somebody pushed pushes on no more."""
        for axis, force in self._pushed.items():
            dof = stage.axes[axis].plant.dof
            if stage.data.qfrc_applied[dof] != force:
                stage.data.qfrc_applied[dof] = force

    def close(self) -> None:
        """Let go. What is broken stays so."""
        self._over()
        for axis in self._pushed:
            self.push(axis, 0.0)


def _decimal(field: str, text: str) -> str:
    """10h and 0x10 as decimal text; others as they are."""
    text = text.strip()
    try:
        if text.lower().startswith("0x"):
            return str(int(text, 16))
        if text.lower().endswith("h"):
            return str(int(text[:-1], 16))
    except ValueError:
        raise FieldError(field, f"{text!r} is not a number: 16, 0x10 or 10h.") from None
    return text
