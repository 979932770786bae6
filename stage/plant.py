"""The MJCF naming contract: which joints, actuators and sensors make an axis; checks a model, says what lacks.

Axis NAME is
    a joint NAME (slide or hinge) with a range,
    an actuator NAME, a <motor> on it: ctrl is rotor torque in N m, gear is rotor radians per joint unit,
    five contact sensors NAME_el_plus, NAME_el_minus, NAME_sd_plus, NAME_sd_minus, NAME_org between a vane and a switch,
        each with data="found dist" and a force-free <pair margin="-0.03" gap="0.04">,
    or <custom><text name="NAME_unfitted" data="sd_plus sd_minus"/></custom> for the switches that it does without.
<text name="NAME_motor" data="17HS4401"/> names the motor whose rotor inertia is in the joint's armature.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stage.errors import ArgumentError, ModelError, unknown

PINS = ("el_plus", "el_minus", "sd_plus", "sd_minus", "org")
MARGIN, GAP = -0.03, 0.04
LOOK_AHEAD = 0.5e-3
SCAN = 401
_DATA_DIMS = (("FOUND", 1), ("FORCE", 3), ("TORQUE", 3), ("DIST", 1), ("POS", 3), ("NORMAL", 3), ("TANGENT", 3))


@dataclass(frozen=True)
class Switch:
    """A limit switch: `found` and `dist` are addresses in sensordata, `touch` the joint position where the vane trips it,
    `slope` d dist / d q there."""

    pin: str
    sensor: int
    found: int
    dist: int
    touch: float
    slope: float


@dataclass(frozen=True)
class PlantAxis:
    """What the engine needs to know of an axis: ids and addresses in the model, gear (rotor rad per joint unit)."""

    name: str
    joint: int
    qpos: int
    dof: int
    actuator: int
    gear: float
    travel: tuple[float, float]
    hinge: bool
    motor: str | None
    switches: tuple[Switch, ...]


def names() -> list[str]:
    """The models that ship with PulseStage."""
    files = (f.name for f in resources.files("stage.models").iterdir())
    return sorted(f[:-4] for f in files if f.endswith(".xml") and not f.startswith("_"))


def open_spec(source: Any) -> Any:
    """An MjSpec from a shipped name, a path or an MjSpec (copied); an MjModel is copied and passes through."""
    if isinstance(source, mujoco.MjSpec):
        return source.copy()
    if isinstance(source, mujoco.MjModel):
        import copy

        return copy.copy(source)
    if not isinstance(source, str | os.PathLike):
        raise ArgumentError(f"model {source!r}: give a name ({', '.join(names())}), a path, an MjSpec or an MjModel.")
    path = Path(source)
    if not path.suffix and len(path.parts) == 1:
        if str(source) not in names():
            raise unknown("model", str(source), names())
        path = Path(str(resources.files("stage.models") / f"{source}.xml"))
    if not path.is_file():
        raise ModelError(f"no MJCF file at {path}. Shipped models, by name: {', '.join(names())}.")
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ModelError(f"{path} is no MJCF that MuJoCo reads: {error}") from error


def axis_names(source: Any) -> list[str]:
    """Every joint that has an actuator of its name, in the order of the actuators. Raises ModelError if there is none."""
    if isinstance(source, mujoco.MjModel):
        joints = {source.joint(k).name for k in range(source.njnt)}
        actuators = [source.actuator(k).name for k in range(source.nu)]
    else:
        joints, actuators = {j.name for j in source.joints}, [a.name for a in source.actuators]
    found = [a for a in actuators if a and a in joints]
    if not found:
        raise ModelError(
            f"the model has no axis: a joint and an actuator of the same name. Joints: {sorted(joints - {''})}; "
            f"actuators: {actuators}. For a slide joint 'x' with a 10 mm screw add {_actuator_line('x')}",
            [_actuator_line("x")],
        )
    return found


def compile_spec(source: Any, words: int) -> tuple[mujoco.MjModel, int]:
    """The model with `words` more float64 of userdata than its own; returns (model, where they begin)."""
    if isinstance(source, mujoco.MjModel):
        if source.nuserdata < words:
            line = f'<size nuserdata="{words}"/>'
            raise ModelError(
                f"this MjModel has {source.nuserdata} words of userdata and the stage needs {words}. Pass its path or MjSpec "
                f"instead, or add {line} to the MJCF.",
                [line],
            )
        return source, source.nuserdata - words
    offset = max(source.nuserdata, 0)
    source.nuserdata = offset + words
    try:
        return source.compile(), offset
    except ValueError as error:
        raise ModelError(f"MuJoCo cannot compile the model: {error}") from error


def bind(model: mujoco.MjModel, axes: Sequence[str] | None = None) -> tuple[PlantAxis, ...]:
    """Find and check the axes of a model. Raises one ModelError that lists everything that is wrong."""
    return _Binder(model).bind(list(axes) if axes is not None else axis_names(model))


def describe(model: mujoco.MjModel) -> str:
    """The axes of a model as a text table."""
    lines = [f"{'axis':6}{'kind':7}{'travel':>22}{'per turn':>12}  {'motor':16}switches trip at"]
    for a in bind(model):
        unit, k = ("rad", 1.0) if a.hinge else ("mm", 1e3)
        travel = f"{a.travel[0] * k:.1f} .. {a.travel[1] * k:.1f} {unit}"
        trips = ", ".join(f"{s.pin} {s.touch * k:.2f}" for s in a.switches)
        per_turn = f"{2 * np.pi / abs(a.gear) * k:.3f} {unit}"
        lines.append(
            f"{a.name:6}{'hinge' if a.hinge else 'slide':7}{travel:>22}{per_turn:>12}  {a.motor or '-':16}{trips}"
        )
    return "\n".join(lines)


def _actuator_line(name: str) -> str:
    return f'<motor name="{name}" joint="{name}" gear="628.3185307"/>'


def _sensor_line(axis: str, pin: str) -> str:
    vane, switch = f"{axis}_{pin}_vane", f"{axis}_{pin}_switch"
    return f'<contact name="{axis}_{pin}" geom1="{vane}" geom2="{switch}" num="1" data="found dist"/>'


def _pair_line(geom1: str, geom2: str) -> str:
    return f'<pair geom1="{geom1}" geom2="{geom2}" margin="{MARGIN}" gap="{GAP}"/>'


class _Binder:
    def __init__(self, model: mujoco.MjModel):
        self.model, self.data = model, mujoco.MjData(model)
        self.problems: list[str] = []
        self.lines: list[str] = []
        self.texts = {
            mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, k): bytes(
                model.text_data[model.text_adr[k] : model.text_adr[k] + model.text_size[k]]
            ).rstrip(b"\0").decode()
            for k in range(model.ntext)
        }  # fmt: skip

    def bind(self, axes: list[str]) -> tuple[PlantAxis, ...]:
        bound = [self._axis(name) for name in axes]
        if self.problems:
            lines = "".join(f"\n    {line}" for line in self.lines)
            raise ModelError(
                "the model does not keep the naming contract (docs/models.md):\n  - "
                + "\n  - ".join(self.problems)
                + (f"\n  lines to add or change:{lines}" if lines else ""),
                self.lines,
            )
        return tuple(a for a in bound if a is not None)

    def _problem(self, axis: str, text: str, line: str | None = None) -> None:
        self.problems.append(f"axis {axis}: {text}")
        if line and line not in self.lines:
            self.lines.append(line)

    def _id(self, kind: Any, name: str) -> int:
        return mujoco.mj_name2id(self.model, kind, name)

    def _near(self, kind: Any, count: int, name: str) -> str:
        known = [mujoco.mj_id2name(self.model, kind, k) or "" for k in range(count)]
        near = get_close_matches(name, known, n=1, cutoff=0.6)
        return f" (there is {near[0]!r}: a slip?)" if near else ""

    def _axis(self, name: str) -> PlantAxis | None:
        m, obj = self.model, mujoco.mjtObj
        joint, actuator = self._id(obj.mjOBJ_JOINT, name), self._id(obj.mjOBJ_ACTUATOR, name)
        if joint < 0:
            near = self._near(obj.mjOBJ_JOINT, m.njnt, name)
            line = f'<joint name="{name}" type="slide" axis="1 0 0" range="-0.15 0.15" limited="false"/>'
            self._problem(name, f"no joint {name!r}{near}", line)
        if actuator < 0:
            near = self._near(obj.mjOBJ_ACTUATOR, m.nu, name)
            self._problem(name, f"no actuator {name!r}{near}", _actuator_line(name))
        if joint < 0 or actuator < 0:
            return None
        slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
        if int(m.jnt_type[joint]) not in (slide, hinge):
            self._problem(name, f"joint {name!r} is neither slide nor hinge")
            return None
        low, high = (float(v) for v in m.jnt_range[joint])
        if not low < high:
            line = f'<joint name="{name}" ... range="-0.15 0.15" limited="false"/>'
            self._problem(name, f"joint {name!r} has no range, so its switches cannot be found", line)
            return None
        gear = float(m.actuator_gear[actuator][0])
        plain = (
            m.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
            and m.actuator_trnid[actuator][0] == joint
            and m.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
            and m.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
            and m.actuator_gainprm[actuator][0] == 1
        )
        if not plain or gear == 0:
            text = f"actuator {name!r} is not a <motor> on joint {name!r} with a gear (rotor radians per joint unit)"
            self._problem(name, text, _actuator_line(name))
            return None
        unfitted = self.texts.get(f"{name}_unfitted", "").split()
        for pin in unfitted:
            if pin not in PINS:
                self._problem(name, f"{name}_unfitted names {pin!r}; switches are {', '.join(PINS)}")
        found = [self._switch(name, pin, joint, low, high) for pin in PINS if pin not in unfitted]
        switches = tuple(s for s in found if s is not None)
        self._order(name, switches)
        return PlantAxis(
            name, joint, int(m.jnt_qposadr[joint]), int(m.jnt_dofadr[joint]), actuator, gear, (low, high),
            bool(m.jnt_type[joint] == hinge), self.texts.get(f"{name}_motor"), switches,
        )  # fmt: skip

    def _switch(self, axis: str, pin: str, joint: int, low: float, high: float) -> Switch | None:
        m, obj = self.model, mujoco.mjtObj
        name = f"{axis}_{pin}"
        sensor = self._id(obj.mjOBJ_SENSOR, name)
        if sensor < 0:
            near = self._near(obj.mjOBJ_SENSOR, m.nsensor, name)
            self._problem(axis, f"no contact sensor {name!r}{near}", _sensor_line(axis, pin))
            return None
        if m.sensor_type[sensor] != mujoco.mjtSensor.mjSENS_CONTACT:
            self._problem(axis, f"sensor {name!r} is not a <contact> sensor", _sensor_line(axis, pin))
            return None
        spec, offset, at = int(m.sensor_intprm[sensor][0]), 0, {}
        for field, dim in _DATA_DIMS:
            if spec >> int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{field}")) & 1:
                at[field] = int(m.sensor_adr[sensor]) + offset
                offset += dim
        if "FOUND" not in at or "DIST" not in at:
            self._problem(axis, f'sensor {name!r} needs data="found dist"', _sensor_line(axis, pin))
            return None
        if m.sensor_objtype[sensor] != obj.mjOBJ_GEOM or m.sensor_reftype[sensor] != obj.mjOBJ_GEOM:
            self._problem(axis, f"sensor {name!r} must name geom1 (vane) and geom2 (switch)", _sensor_line(axis, pin))
            return None
        vane, switch = int(m.sensor_objid[sensor]), int(m.sensor_refid[sensor])
        touch = self._touch(joint, vane, switch, low, high, pin)
        if touch is None:
            self._problem(axis, f"switch {pin}: the vane cannot reach it within the joint's range {low} to {high}")
            return None
        q, slope = touch
        geoms = [m.geom(vane).name or "VANE", m.geom(switch).name or "SWITCH"]
        self._at(joint, q + LOOK_AHEAD / slope, full=True)
        if not self.data.sensordata[at["FOUND"]] > 0:
            text = (
                f"sensor {name!r} does not see its vane {LOOK_AHEAD * 1e3} mm before the touch (margin + gap too small)"
            )
            self._problem(axis, text, _pair_line(*geoms))
            return None
        for end in (q, low, high):
            self._at(joint, end, full=True)
            for c in self.data.contact[: self.data.ncon]:
                if {int(c.geom1), int(c.geom2)} == {vane, switch} and c.efc_address >= 0:
                    self._problem(axis, f"switch {pin} pushes its vane (margin too large)", _pair_line(*geoms))
                    return None
        return Switch(pin, sensor, at["FOUND"], at["DIST"], q, slope)

    def _at(self, joint: int, q: float, full: bool = False) -> None:
        d = self.data
        d.qpos[:] = self.model.qpos0
        d.qpos[self.model.jnt_qposadr[joint]] = q
        (mujoco.mj_forward if full else mujoco.mj_kinematics)(self.model, d)

    def _distance(self, joint: int, q: float, vane: int, switch: int) -> float:
        self._at(joint, q)
        return mujoco.mj_geomDistance(self.model, self.data, vane, switch, 1e3, None)

    def _touch(
        self, joint: int, vane: int, switch: int, low: float, high: float, pin: str
    ) -> tuple[float, float] | None:
        """(joint position where the vane trips the switch, d dist / d q there); None if it never does."""
        grid = np.linspace(low, high, SCAN)
        on = np.array([self._distance(joint, q, vane, switch) <= 0 for q in grid])
        changes = np.flatnonzero(on[1:] != on[:-1])
        if not len(changes):
            return None
        k = changes[-1] if pin.endswith("minus") else changes[0]
        a, b = grid[k], grid[k + 1]
        for _ in range(60):
            q = 0.5 * (a + b)
            a, b = (q, b) if (self._distance(joint, q, vane, switch) <= 0) == on[k] else (a, q)
        q, e = float(0.5 * (a + b)), 1e-6 * (high - low)
        near = [self._distance(joint, q + x, vane, switch) for x in (-e, e)]
        slope = (near[1] - near[0]) / (2 * e)
        return (q, slope) if slope else None

    def _order(self, axis: str, switches: tuple[Switch, ...]) -> None:
        by = {s.pin: s for s in switches}
        for pin, sign in (("el_plus", -1), ("el_minus", 1), ("sd_plus", -1), ("sd_minus", 1)):
            if pin in by and by[pin].slope * sign < 0:
                side = "plus" if pin.endswith("plus") else "minus"
                self._problem(
                    axis, f"switch {pin} trips when the joint moves away from {side}: is it at the wrong end?"
                )
        if "el_plus" in by and "el_minus" in by and by["el_plus"].touch <= by["el_minus"].touch:
            self._problem(axis, "EL+ trips before EL-: no travel is left between them")
