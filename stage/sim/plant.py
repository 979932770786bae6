"""The MJCF naming contract: which joints, actuators and sensors make an axis; checks a model, says what lacks.

Axis NAME is
    a joint NAME (slide or hinge) with a range,
    an actuator NAME on it: a <motor> for a stepper, whose ctrl is rotor torque in N m, or a <dcmotor> for a servo, whose ctrl is
        terminal voltage; gear is rotor radians per joint unit,
    five contact sensors NAME_el_plus, NAME_el_minus, NAME_sd_plus, NAME_sd_minus, NAME_org between a vane and a switch,
        each with data="found dist" and a force-free <pair margin="-0.03" gap="0.04">,
    or <custom><text name="NAME_unfitted" data="sd_plus sd_minus"/></custom> for the switches that it does without.
<text name="NAME_motor" data="17HS4401"/> names the motor whose rotor inertia is in the joint's armature.
A stage fits the actuator that its chip drives, see `equip`: any model takes any chip.
<numeric name="NAME_index" data="0.5"/> says where in the rotor's turn the encoder's index pulse (EZ) stands, in turns from the
rotor's place at joint position 0; without it, half a turn from where ORG trips, as one mounts it.

    spec = open_spec("xyz")                         a name, a path, an MjSpec or an MjModel
    model, offset = compile_spec(spec, words)       with room for `words` float64 of state in userdata
    for axis in bind(model): ...                    ModelError says everything that lacks, at once

docs/models.md explains the contract and holds a complete small model.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stage.errors import ArgumentError, ModelError, near_names, unknown
from stage.sim import libmujoco, scan
from stage.sim.fingerprint import fingerprint
from stage.sim.pins import PINS

MARGIN, GAP = -0.03, 0.04  # of the pairs that the errors propose
LOOK_AHEAD = 0.5e-3  # m; a switch must be seen this far before the touch, so that the edge is found inside a step
SCAN = 401  # joint positions tried over the range
KEPT_PLANTS = 64
_DATA_DIMS = (("FOUND", 1), ("FORCE", 3), ("TORQUE", 3), ("DIST", 1), ("POS", 3), ("NORMAL", 3), ("TANGENT", 3))


@dataclass(frozen=True)
class Switch:
    """A limit switch and its vane.

    Attributes:
        pin: el_plus, el_minus, sd_plus, sd_minus or org. sensor: id in the model.
        found, dist: addresses in sensordata.
        touch: joint position at which the vane, coming from the middle of travel (to ORG: from plus), trips the switch.
        slope: d dist / d q there; -1 or 1 for flat faces on a slide, m/rad on a hinge.
        lookahead: joint travel before the touch over which `dist` is seen.
    """

    pin: str
    sensor: int
    found: int
    dist: int
    touch: float
    slope: float
    lookahead: float


@dataclass(frozen=True)
class PlantAxis:
    """What the engine needs to know of an axis.

    Attributes:
        joint, actuator: ids in the model; qpos, dof: addresses. gear: rotor radians per joint unit, signed.
        travel: the joint's range, m (rad if `hinge`). motor: name of the motor inside the armature, or None. servo: the actuator is
            a DC motor.
        index: where in the rotor's turn the index pulse stands, in turns from its place at joint position 0.
        switches: those fitted, in the order of PINS.
    """

    name: str
    joint: int
    qpos: int
    dof: int
    actuator: int
    gear: float
    travel: tuple[float, float]
    hinge: bool
    motor: str | None
    servo: bool
    index: float
    switches: tuple[Switch, ...]


def names() -> list[str]:
    """The models that ship with PulseStage."""
    files = (f.name for f in resources.files("stage.models").iterdir())
    return sorted(f[:-4] for f in files if f.endswith(".xml") and not f.startswith("_"))


def open_spec(source: Any) -> Any:
    """An MjSpec from a shipped name, a path or an MjSpec (copied); an MjModel is copied and passes through."""
    if isinstance(source, mujoco.MjSpec):
        _compile(source)  # the copy would leave out in silence what refers to nothing
        return source.copy()
    if isinstance(source, mujoco.MjModel):
        return copy.copy(source)
    if not isinstance(source, str | os.PathLike):
        raise ArgumentError(f"model {source!r}: give a name ({', '.join(names())}), a path, an MjSpec or an MjModel.")
    path = Path(source)
    if not path.suffix and len(path.parts) == 1:
        if str(source) not in names():
            raise unknown("model", str(source), names())
        return _shipped(str(source), _state_of_models()).copy()
    if not path.is_file():
        near = near_names(path.stem, names(), 0.5)
        hint = f" Did you mean the shipped model {near[0]!r}?" if near else ""
        raise ModelError(f"no MJCF file at {path}.{hint} Shipped models, by name: {', '.join(names())}.")
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ModelError(f"{path} is no MJCF that MuJoCo reads: {error}") from error


def _models() -> Path:
    return Path(str(resources.files("stage.models")))


def _state_of_models() -> tuple[int, ...]:
    """Changes when a file of a shipped model does."""
    return tuple(sorted(f.stat().st_mtime_ns for f in _models().iterdir() if f.is_file()))


@lru_cache(16)
def _shipped(name: str, _state: tuple[int, ...]) -> Any:
    """The MjSpec of a shipped model; to be copied. Reading it takes a hundred times longer."""
    return mujoco.MjSpec.from_file(str(_models() / f"{name}.xml"))


def discard_visuals(spec: Any) -> None:
    """Let an MjSpec compile without what is only looked at: the same dynamics, to the bit, faster and in a fifth of the memory.

    An MjModel stays as it is.
    """
    if not isinstance(spec, mujoco.MjSpec):
        return
    spec.compiler.discardvisual = True
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        for body in spec.bodies:  # from "auto" on MuJoCo keeps the inertia of what it discards
            body.explicitinertial = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO


def axis_names(source: Any) -> list[str]:
    """Every joint that has an actuator of its name, in the order of the actuators. Raises ModelError if there is none."""
    if isinstance(source, mujoco.MjModel):
        joints = [source.joint(k).name for k in range(source.njnt)]
        actuators = [source.actuator(k).name for k in range(source.nu)]
    else:
        joints, actuators = [j.name for j in source.joints], [a.name for a in source.actuators]
    joints, actuators = [j for j in joints if j], [a for a in actuators if a]
    found = [a for a in actuators if a in joints]
    if not found:
        slips = "".join(f" Actuator {a!r} and joint {j[0]!r}: a slip?" for a in actuators if (j := _similar(a, joints)))
        raise ModelError(
            f"the model has no axis: a joint and an actuator of the same name.{slips} Joints: "
            f"{', '.join(joints) or 'none'}; actuators: {', '.join(actuators) or 'none'}. "
            f"For a slide joint 'x' with a screw of 10 mm lead add {_actuator_line('x')}",
            [_actuator_line("x")],
        )
    return found


def motors(source: Any) -> dict[str, str]:
    """The motors that a model names, by axis."""
    compiled = isinstance(source, mujoco.MjModel)
    texts = _texts(source) if compiled else {_readable(t, "name"): _readable(t, "data") for t in source.texts}
    return {name[: -len("_motor")]: data for name, data in texts.items() if name.endswith("_motor")}


def _readable(text: Any, field: str) -> str:
    """A field of an MjSpec's text; what is not UTF-8 in it is replaced, as in `_texts`."""
    try:
        return str(getattr(text, field))
    except UnicodeDecodeError as error:
        return error.object.decode(errors="replace")


def equip(source: Any, axis: str, constants: tuple[float, float] | None) -> None:
    """Fit the actuator of an axis: a <dcmotor> of these constants (N m/A, ohm), or without any a <motor>, if it is no such yet.

    An MjModel cannot change; `bind` tells if it does not fit.
    """
    actuator = (
        None if isinstance(source, mujoco.MjModel) else next((a for a in source.actuators if a.name == axis), None)
    )
    if actuator is None:
        return
    if constants:
        actuator.set_to_dcmotor([constants[0]] * 2, constants[1])
    elif actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
        actuator.set_to_motor()


def dc_constants(source: Any, axis: str) -> tuple[float, float] | None:
    """(torque constant N m/A, resistance ohm) of the axis' <dcmotor>, if it has one."""
    compiled = isinstance(source, mujoco.MjModel)
    for a in [source.actuator(k) for k in range(source.nu)] if compiled else list(source.actuators):
        if a.name == axis and int(np.squeeze(a.gaintype)) == mujoco.mjtGain.mjGAIN_DCMOTOR:
            return float(a.gainprm[1]), float(a.gainprm[0])
    return None


def _texts(model: mujoco.MjModel) -> dict[str, str]:
    return {
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, k): bytes(
            model.text_data[model.text_adr[k] : model.text_adr[k] + model.text_size[k]]
        ).rstrip(b"\0").decode(errors="replace")
        for k in range(model.ntext)
    }  # fmt: skip


def compile_spec(source: Any, words: int) -> tuple[mujoco.MjModel, int]:
    """The model with `words` more float64 of userdata than its own; returns (model, where they begin).

    An MjModel cannot grow: the last `words` of its userdata are taken. Raises ModelError if there are too few, or if
    MuJoCo cannot compile the spec.
    """
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
    return _compile(source), offset


def _compile(spec: Any) -> Any:
    try:
        return spec.compile()
    except ValueError as error:
        if spec.compiler.discardvisual:  # the inertia of an attached part may hang on what would go
            spec.compiler.discardvisual = False
            return _compile(spec)
        raise ModelError(f"MuJoCo cannot compile the model {spec.modelname!r}: {error}") from error


def bind(model: mujoco.MjModel, axes: Sequence[str] | None = None) -> tuple[PlantAxis, ...]:
    """Find and check the axes of a model; `axes` chooses some. Raises one ModelError that lists everything that is wrong."""
    try:
        chosen = tuple(axes if axes is not None else axis_names(model))
        key = fingerprint(model), chosen
        if key not in _bound:
            if len(_bound) >= KEPT_PLANTS:
                _bound.clear()
            _bound[key] = _Binder(model, list(chosen)).bind()
        return _bound[key]
    except UnicodeDecodeError as error:
        raise ModelError(f"a name in the model is not UTF-8: {error}. Save the MJCF as UTF-8.") from error


_bound: dict[tuple, tuple[PlantAxis, ...]] = {}  # by model and axes: the same model is measured once


def describe(model: mujoco.MjModel) -> str:
    """The axes of a model as a text table."""
    lines = [f"{'axis':6}{'kind':7}{'travel':>22}{'per turn':>12}  {'motor':16}switches trip at"]
    for a in bind(model):
        unit, k = ("rad", 1.0) if a.hinge else ("mm", 1e3)
        travel = f"{a.travel[0] * k:.1f} .. {a.travel[1] * k:.1f} {unit}"
        trips = ", ".join(f"{s.pin} {s.touch * k:.2f}" for s in a.switches) or "none fitted"
        per_turn = f"{2 * np.pi / abs(a.gear) * k:.3f} {unit}"
        lines.append(
            f"{a.name:6}{'hinge' if a.hinge else 'slide':7}{travel:>22}{per_turn:>12}  {a.motor or '-':16}{trips}"
        )
    return "\n".join(lines)


def _similar(name: str, known: Iterable[str]) -> list[str]:
    """The names nearest to `name`, whatever the case."""
    folded = {k.casefold(): k for k in known if k}
    return [folded[k] for k in near_names(name.casefold(), folded, 0.6)[:1]]


def _actuator_line(name: str) -> str:
    return f'<motor name="{name}" joint="{name}" gear="628.3185307"/>'


def _joint_line(name: str) -> str:
    return f'<joint name="{name}" type="slide" axis="1 0 0" range="-0.15 0.15" limited="false"/>'


def _sensor_line(axis: str, pin: str, vane: str = "", switch: str = "") -> str:
    vane, switch = vane or f"{axis}_{pin}_vane", switch or f"{axis}_{pin}_switch"
    return f'<contact name="{axis}_{pin}" geom1="{vane}" geom2="{switch}" num="1" reduce="mindist" data="found dist"/>'


def _pair_line(geom1: str, geom2: str) -> str:
    return f'<pair geom1="{geom1}" geom2="{geom2}" margin="{MARGIN}" gap="{GAP}"/>'


class _Binder:
    """Checks axes one by one and collects what is wrong."""

    def __init__(self, model: mujoco.MjModel, axes: list[str]):
        self.model, self.data, self.axes = model, mujoco.MjData(model), axes
        self.problems: list[str] = []
        self.lines: list[str] = []
        self.texts = _texts(model)

    def bind(self) -> tuple[PlantAxis, ...]:
        off = mujoco.mjtDisableBit
        if self.model.opt.disableflags & (off.mjDSBL_CONTACT | off.mjDSBL_CONSTRAINT | off.mjDSBL_SENSOR):
            raise ModelError("switches are contact sensors, and the model's <option><flag/> disables contact, constraint "
                             'or sensor. Remove contact="disable", constraint="disable" and sensor="disable".')  # fmt: skip
        bound = [self._axis(name) for name in self.axes]
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
        return int(mujoco.mj_name2id(self.model, kind, name))

    def _near(self, kind: Any, count: int, name: str) -> str:
        known = (mujoco.mj_id2name(self.model, kind, k) or "" for k in range(count))
        near = _similar(name, (k for k in known if k not in self.axes))
        return f" (there is {near[0]!r}: a slip?)" if near else ""

    # --- joint and actuator ---

    def _axis(self, name: str) -> PlantAxis | None:
        m, obj = self.model, mujoco.mjtObj
        joint, actuator = self._id(obj.mjOBJ_JOINT, name), self._id(obj.mjOBJ_ACTUATOR, name)
        if joint < 0:
            self._problem(name, f"no joint {name!r}{self._near(obj.mjOBJ_JOINT, m.njnt, name)}", _joint_line(name))
        if actuator < 0:
            near = self._near(obj.mjOBJ_ACTUATOR, m.nu, name)
            self._problem(name, f"no actuator {name!r}{near}", _actuator_line(name))
        if joint < 0 or actuator < 0:
            return None
        slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
        if int(m.jnt_type[joint]) not in (slide, hinge):
            self._problem(name, f"joint {name!r} is neither slide nor hinge", _joint_line(name))
            return None
        low, high = (float(v) for v in m.jnt_range[joint])
        if not low < high:
            self._problem(name, f"joint {name!r} has no range, so its switches cannot be looked for", _joint_line(name))
        armature = float(m.dof_armature[m.jnt_dofadr[joint]])
        if not 0 <= armature <= 1e9:
            self._problem(
                name,
                f"joint {name!r} has an armature of {armature:g}; inertia is 0 to 1e9, in kg (kg m2 on a hinge): that of the "
                "rotor times the gear squared, or 0",
            )
        gear = float(m.actuator_gear[actuator][0])
        servo = bool(m.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_DCMOTOR)
        fits = self._is_dc_motor(joint, actuator) if servo else self._is_motor(joint, actuator)
        if not fits or not 1e-6 <= abs(gear) <= 1e9:
            self._problem(
                name,
                f"actuator {name!r} is not a <motor> on joint {name!r}, nor a <dcmotor> with voltage input only, with a gear of "
                f"1e-6 to 1e9 (rotor radians per joint unit); if {name!r} is no axis of a chip, name those that are: "
                "chips={axis: chip}",
                _actuator_line(name),
            )
        unfitted = self.texts.get(f"{name}_unfitted", "").split()
        for pin in unfitted:
            if pin not in PINS:
                near = "".join(f" (meant {p!r}?)" for p in _similar(pin, PINS))
                self._problem(name, f"the text {name}_unfitted names {pin!r}{near}; switches are {', '.join(PINS)}")
        if not low < high:
            return None
        scanned = self._scanned(name, joint, low, high)
        found = [self._switch(name, pin, joint, low, high, scanned) for pin in PINS if pin not in unfitted]
        switches = tuple(s for s in found if s is not None)
        self._order(name, switches)
        return PlantAxis(
            name, joint, int(m.jnt_qposadr[joint]), int(m.jnt_dofadr[joint]), actuator, gear, (low, high),
            bool(m.jnt_type[joint] == hinge), self.texts.get(f"{name}_motor"), servo, self._index(name, gear, switches),
            switches,
        )  # fmt: skip

    def _index(self, name: str, gear: float, switches: Iterable[Switch]) -> float:
        m = self.model
        k = self._id(mujoco.mjtObj.mjOBJ_NUMERIC, f"{name}_index")
        if k >= 0:
            index = float(m.numeric_data[m.numeric_adr[k]])
            if not abs(index) <= 1e6:
                self._problem(name, f"the numeric {name}_index is {index}: give turns, mostly 0 to 1")
            return index
        return next(((s.touch * gear / (2 * np.pi) + 0.5) % 1.0 for s in switches if s.pin == "org"), 0.0)

    def _is_on(self, joint: int, actuator: int) -> bool:
        m = self.model
        return bool(
            m.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT and m.actuator_trnid[actuator][0] == joint
        )

    def _is_dc_motor(self, joint: int, actuator: int) -> bool:
        """Without states of its own, one control: the voltage."""
        m = self.model
        resistance, constant = m.actuator_gainprm[actuator][:2]
        plain = m.actuator_actnum[actuator] == 0 and not m.actuator_biasprm[actuator].any()
        return self._is_on(joint, actuator) and bool(plain and resistance > 0 and constant > 0)

    def _is_motor(self, joint: int, actuator: int) -> bool:
        m = self.model
        return self._is_on(joint, actuator) and bool(
            m.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
            and m.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
            and m.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
            and m.actuator_gainprm[actuator][0] == 1
        )

    # --- switches ---

    def _switch(
        self, axis: str, pin: str, joint: int, low: float, high: float, scanned: dict[tuple[int, int], np.ndarray]
    ) -> Switch | None:
        m, obj = self.model, mujoco.mjtObj
        name = f"{axis}_{pin}"
        sensor = self._id(obj.mjOBJ_SENSOR, name)
        if sensor < 0:
            near = self._near(obj.mjOBJ_SENSOR, m.nsensor, name)
            text = f'no contact sensor {name!r}{near}; a switch not fitted is named in <text name="{axis}_unfitted" data="{pin}"/>'
            self._problem(axis, text, _sensor_line(axis, pin))
            return None
        if m.sensor_type[sensor] != mujoco.mjtSensor.mjSENS_CONTACT:
            self._problem(axis, f"sensor {name!r} is not a <contact> sensor", _sensor_line(axis, pin))
            return None
        if m.sensor_objtype[sensor] != obj.mjOBJ_GEOM or m.sensor_reftype[sensor] != obj.mjOBJ_GEOM:
            self._problem(axis, f"sensor {name!r} must name geom1 (vane) and geom2 (switch)", _sensor_line(axis, pin))
            return None
        vane, switch = int(m.sensor_objid[sensor]), int(m.sensor_refid[sensor])
        vane_name, switch_name = m.geom(vane).name, m.geom(switch).name
        pair, line = _pair_line(vane_name, switch_name), _sensor_line(axis, pin, vane_name, switch_name)
        at = self._addresses(sensor)
        if "FOUND" not in at or "DIST" not in at:
            self._problem(axis, f'sensor {name!r} needs data="found dist"', line)
            return None
        edge = self._edge(joint, vane, switch, low, high, pin, scanned[vane, switch])
        if isinstance(edge, str):
            self._problem(axis, f"switch {pin}: the vane {edge}")
            return None
        q, slope = edge
        found, dist = at["FOUND"], at["DIST"]
        here = q + LOOK_AHEAD / slope
        self._forward(joint, here)
        seen, gap = self.data.sensordata[found] > 0, self._distance(joint, here, vane, switch)
        if not seen:
            text = f"sensor {name!r} does not see its vane {LOOK_AHEAD * 1e3} mm before the touch: "
            text += "no pair, or its margin + gap is too small"
            self._problem(axis, text, pair)
            return None
        if abs(self.data.sensordata[dist] - gap) > 0.1 * LOOK_AHEAD:
            read = self.data.sensordata[dist]
            text = f"sensor {name!r} reads {read * 1e3:.3f} mm where vane and switch are {gap * 1e3:.3f} mm apart"
            self._problem(axis, text, line)
            return None
        for end in (q, low, high):
            self._forward(joint, end)
            if {vane, switch} in self._pushing():
                self._problem(axis, f"switch {pin} pushes its vane: the margin must be negative, the gap larger", pair)
                return None
        if pin.startswith("el"):
            self._holds_to_the_stop(axis, pin, joint, found, dist, q, high if pin == "el_plus" else low)
        return Switch(pin, sensor, found, dist, q, slope, self._look_ahead(joint, found, q, slope, low, high))

    def _addresses(self, sensor: int) -> dict[str, int]:
        """Field -> address in sensordata."""
        fields, offset, at = int(self.model.sensor_intprm[sensor][0]), int(self.model.sensor_adr[sensor]), {}
        for field, dim in _DATA_DIMS:
            if fields >> int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{field}")) & 1:
                at[field] = offset
                offset += dim
        return at

    def _at(self, joint: int, q: float) -> None:
        self.data.qpos[:] = self.model.qpos0
        self.data.qpos[self.model.jnt_qposadr[joint]] = q

    def _forward(self, joint: int, q: float) -> None:
        """All that MuJoCo computes with this joint at q and the others at qpos0."""
        self._at(joint, q)
        mujoco.mj_forward(self.model, self.data)

    def _distance(self, joint: int, q: float, vane: int, switch: int) -> float:
        self._at(joint, q)
        mujoco.mj_kinematics(self.model, self.data)
        return mujoco.mj_geomDistance(self.model, self.data, vane, switch, scan.FAR, None)

    def _far(self, joint: int, positions: np.ndarray, pairs: list[tuple[int, int]]) -> np.ndarray:
        """(positions, pairs), m: how far pairs of geoms are apart with this joint at `positions` and the others at qpos0."""
        out = np.empty((len(positions), len(pairs)))
        both = np.array(pairs, np.int32).reshape(-1, 2)
        self.data.qpos[:] = self.model.qpos0
        scan.distances(
            libmujoco.address("mj_kinematics"), libmujoco.address("mj_geomDistance"), self.model._address,
            self.data._address, self.data.qpos, int(self.model.jnt_qposadr[joint]), positions, both, out,
        )  # fmt: skip
        return out

    def _scanned(self, axis: str, joint: int, low: float, high: float) -> dict[tuple[int, int], np.ndarray]:
        """Vane and switch -> their distance at SCAN positions over the range; of all the axis' sensors that name two geoms."""
        m, geom = self.model, mujoco.mjtObj.mjOBJ_GEOM
        sensors = [self._id(mujoco.mjtObj.mjOBJ_SENSOR, f"{axis}_{pin}") for pin in PINS]
        pairs = [
            (int(m.sensor_objid[s]), int(m.sensor_refid[s]))
            for s in sensors
            if s >= 0 and m.sensor_objtype[s] == geom and m.sensor_reftype[s] == geom
        ]
        for vane, switch in pairs:  # MuJoCo's errors are exceptions in Python only
            mujoco.mj_geomDistance(m, self.data, vane, switch, scan.FAR, None)
        return dict(zip(pairs, self._far(joint, np.linspace(low, high, SCAN), pairs).T, strict=True))

    def _pushing(self) -> list[set[int]]:
        contact, count = self.data.contact, self.data.ncon
        if not count:
            return []
        return [set(pair) for pair in contact.geom[contact.efc_address >= 0].tolist()]

    def _edge(
        self, joint: int, vane: int, switch: int, low: float, high: float, pin: str, scanned: np.ndarray
    ) -> tuple[float, float] | str:
        """(joint position where the vane trips the switch, d dist / d q there), or what is wrong."""

        def distance(q: float) -> float:
            return self._distance(joint, q, vane, switch)

        grid, dist = np.linspace(low, high, SCAN).tolist(), scanned.tolist()
        for k in range(SCAN - 2, 0, -1):  # a narrow vane may pass between two positions tried
            if 0 < dist[k] <= min(dist[k - 1], dist[k + 1]) and 2 * dist[k] <= max(dist[k - 1], dist[k + 1]):
                finer = np.linspace(grid[k - 1], grid[k + 1], 65)[1:-1]
                grid[k : k + 1], dist[k : k + 1] = (
                    finer.tolist(),
                    self._far(joint, finer, [(vane, switch)])[:, 0].tolist(),
                )
        on = np.array(dist) <= 0
        if on.all():
            return f"trips it over the whole range {low:g} to {high:g}"
        trips, leaves = np.flatnonzero(~on[:-1] & on[1:]), np.flatnonzero(on[:-1] & ~on[1:])
        if not len(trips) and not len(leaves):
            k = int(np.argmin(dist))
            return f"cannot reach it: nearest at {grid[k]:g}, {dist[k] * 1e3:.3g} mm away (joint range {low:g} to {high:g})"
        k = trips[0] if len(trips) and (pin.endswith("plus") or not len(leaves)) else leaves[-1]
        a, b = grid[k], grid[k + 1]
        while a < (q := 0.5 * (a + b)) < b:
            a, b = (q, b) if (distance(q) <= 0) == on[k] else (a, q)
        e = 1e-6 * (high - low)
        slope = (distance(q + e) - distance(q - e)) / (2 * e)
        return (float(q), slope) if slope else "grazes it: the distance does not change with the joint"

    def _look_ahead(self, joint: int, found: int, q: float, slope: float, low: float, high: float) -> float:
        """Joint travel before the touch over which the sensor finds the vane."""
        sign, near, far = (1.0 if slope > 0 else -1.0), LOOK_AHEAD / abs(slope), 0.0
        room = high - q if slope > 0 else q - low
        for _ in range(24):
            x = 0.5 * (near + far) if far else min(2 * near, room)
            self._forward(joint, q + sign * x)
            if not self.data.sensordata[found] > 0:
                far = x
            elif not far and x >= room:
                return room
            else:
                near = x
        return near

    def _holds_to_the_stop(
        self, axis: str, pin: str, joint: int, found: int, dist: int, touch: float, end: float
    ) -> None:
        """EL comes before the hard stop, and stays asserted up to it (or to the end of the range)."""
        m = self.model
        roots = m.body_jntadr[m.body_rootid[m.geom_bodyid]]  # the first joint of what a geom belongs to; -1: none
        loose = (roots >= 0) & (m.jnt_type[roots] == mujoco.mjtJoint.mjJNT_FREE)  # lies about; no stop of this axis
        self._forward(joint, float(m.qpos0[m.jnt_qposadr[joint]]))
        always = self._pushing()
        for q in np.linspace(touch, end, 25):
            self._forward(joint, q)
            stop = [sorted(p) for p in self._pushing() if p not in always and not any(loose[g] for g in p)]
            if stop and q == touch:
                geoms = " and ".join(repr(m.geom(g).name) for g in stop[0])
                self._problem(axis, f"the hard stop ({geoms} touch) comes before {pin}, which trips at {touch:g}")
            if stop:
                return
            if q != touch and not (self.data.sensordata[found] > 0 and self.data.sensordata[dist] <= 0):
                text = f"switch {pin} trips at {touch:g} but lets go again before {q:g}: lengthen its vane up to the hard stop"
                self._problem(axis, text)
                return

    def _order(self, axis: str, switches: tuple[Switch, ...]) -> None:
        by = {s.pin: s for s in switches}
        wrong = False
        for pin, sign in (("el_plus", -1), ("el_minus", 1), ("sd_plus", -1), ("sd_minus", 1)):
            if pin in by and by[pin].slope * sign < 0:
                side, wrong = "plus" if pin.endswith("plus") else "minus", True
                self._problem(
                    axis, f"switch {pin} trips when the joint moves away from {side}: is it at the wrong end?"
                )
        if wrong:
            return
        for low, high, meaning in (
            ("el_minus", "el_plus", "no travel is left between them"),
            ("sd_plus", "el_plus", "it can slow nothing down"),
            ("el_minus", "sd_minus", "it can slow nothing down"),
            ("el_minus", "org", "the origin is never reached"),
            ("org", "el_plus", "the origin is never reached"),
        ):
            if low in by and high in by and by[low].touch > by[high].touch:
                a, b = f"{low} trips at {by[low].touch:g}", f"{high} at {by[high].touch:g}"
                self._problem(axis, f"{a}, {b}: in this order {meaning}")
