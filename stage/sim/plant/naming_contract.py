"""Search for the axes of a model by the naming contract, with checks of everything that makes an axis."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from stage.errors import ModelError
from stage.sim.engine_records import SWITCH_PINS
from stage.sim.model_fingerprint import compute_model_digest
from stage.sim.plant.model_preparation import AXIS_JOINT_TYPES, SharedSpec, find_axis_names, read_texts
from stage.sim.plant.model_proposals import (
    DEFAULT_JOINT_RANGES,
    MAX_GEAR,
    MIN_GEAR,
    propose_carriage,
    propose_joint,
    propose_motor,
)
from stage.sim.plant.naming_contract_errors import ModelProblems, find_nearest_name, suggest_name
from stage.sim.plant.switch_finder import Switch, SwitchFinder
from stage.units import POSITION_UNITS

MAX_CACHED_PLANTS = 64
MIN_PARALLEL_COSINE = 0.99  # the least cosine between the joints of tandem axes


@dataclass(frozen=True)
class PlantAxis:
    """Parts of a model that make an axis, as the engine needs them.

    Attributes:
        name: Name of the axis.
        joint: Id of the joint in the model.
        actuator: Id of the actuator in the model.
        qpos: Address of the joint in MuJoCo's qpos.
        dof: Address of the joint in MuJoCo's qvel.
        gear: Rotor radians per joint unit, signed.
        travel: Range of the joint, m (rad if `hinge`).
        motor: Name of the motor whose rotor the armature includes, or None.
        servo: Whether the actuator is a DC motor.
        index: Rotor angle of the index pulse, in turns from the rotor angle at joint position 0.
        switches: Switches fitted, in the order of PINS.
        tandem: Names of the axes that drive the same load.
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
    tandem: tuple[str, ...] = ()


def bind_axes(model: mujoco.MjModel, axes: Sequence[str] | None = None, source: Any = None) -> tuple[PlantAxis, ...]:
    """Find and check the axes of a model.

    Args:
        model: Model.
        axes: Names of the axes; default: all.
        source: MjSpec or SharedSpec of which the model was compiled, for the proposals of an error: its unit of angles, and the
            names of geoms that were discarded. Default: degrees, as MuJoCo's, and no such names.

    Raises:
        ModelError: The model breaks the naming contract; the error lists everything that is wrong.
    """
    try:
        names = tuple(axes if axes is not None else find_axis_names(model))
        key = compute_model_digest(model), names
        if key not in _bound:
            if len(_bound) >= MAX_CACHED_PLANTS:
                _bound.clear()
            _bound[key] = _AxisBinder(model, list(names), source).bind()
        return _bound[key]
    except UnicodeDecodeError as error:
        raise ModelError(f"a name in the model is not UTF-8: {error}. Save the MJCF as UTF-8.") from error


_bound: dict[tuple, tuple[PlantAxis, ...]] = {}  # by model and axes: the same model is measured once


def format_axes(model: mujoco.MjModel, source: Any = None) -> str:
    """Format the axes of a model as a text table.

    Args:
        model: Model.
        source: MjSpec of which the model was compiled, see `bind_axes`.
    """
    lines = [f"{'axis':6}{'kind':7}{'travel':>22}{'per turn':>12}  {'motor':16}switches trip at"]
    for a in bind_axes(model, source=source):
        unit, k = POSITION_UNITS["rad" if a.hinge else "m"]
        travel = f"{a.travel[0] * k:.1f} .. {a.travel[1] * k:.1f} {unit}"
        trips = ", ".join(f"{s.pin} {s.touch * k:z.2f}" for s in a.switches) or "none fitted"
        per_turn = f"{2 * np.pi / abs(a.gear) * k:.3f} {unit}"
        lines.append(
            f"{a.name:6}{'hinge' if a.hinge else 'slide':7}{travel:>22}{per_turn:>12}  {a.motor or '-':16}{trips}"
        )
        if a.tandem:
            lines.append(f"{'':6}drives one load with {' and '.join(a.tandem)}")
    return "\n".join([*lines, *_list_undriven_joints(model)])


def _list_undriven_joints(model: mujoco.MjModel) -> list[str]:
    """List joints with switches that no actuator of the same name drives, in words."""
    joints = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, k) for k in range(model.njnt)} - {None}
    sensors = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SENSOR, k) for k in range(model.nsensor)}
    lost = sorted(
        j for j in joints - set(find_axis_names(model)) if any(f"{j}_{pin}" in sensors for pin in SWITCH_PINS)
    )
    return [f"joint {j!r} has switches, but no actuator is named {j!r}: it is no axis" for j in lost]


class _AxisBinder:
    """Checker of the naming contract: binds the axes of a model one by one, and collects all problems."""

    def __init__(self, model: mujoco.MjModel, axes: list[str], source: Any):
        self.model, self.axes = model, axes
        self.problems = ModelProblems()
        self.texts = read_texts(model)
        spec = source.spec if isinstance(source, SharedSpec) else source if isinstance(source, mujoco.MjSpec) else None
        self.degrees = spec is None or bool(spec.compiler.degree)
        self.switches = SwitchFinder(model, self.problems, axes, [g.name for g in spec.geoms] if spec else [])

    def bind(self) -> tuple[PlantAxis, ...]:
        """Bind all axes, or raise ModelError with everything that is wrong."""
        off = mujoco.mjtDisableBit
        if self.model.opt.disableflags & (off.mjDSBL_CONTACT | off.mjDSBL_CONSTRAINT | off.mjDSBL_SENSOR):
            raise ModelError("switches are contact sensors, and the model's <option><flag/> disables contact, constraint "
                             'or sensor. Remove contact="disable", constraint="disable" and sensor="disable".')  # fmt: skip
        bound = [self._bind_axis(name) for name in self.axes]
        tandems = self._find_tandem_axes()
        self.problems.raise_if_any()
        return tuple(replace(a, tandem=tandems.get(a.name, ())) for a in bound if a is not None)

    def _find_id(self, kind: Any, name: str) -> int:
        """Return the id of a named object of the model, -1 if there is none."""
        return int(mujoco.mj_name2id(self.model, kind, name))

    def _find_tandem_axes(self) -> dict[str, tuple[str, ...]]:
        """Return for each axis the names of the other axes that drive the same load, from the texts NAME_tandem."""
        tandems: dict[str, tuple[str, ...]] = {}
        if not any(name.endswith("_tandem") for name in self.texts):
            return tandems
        known = find_axis_names(self.model)
        for name in known:
            for other in self.texts.get(f"{name}_tandem", "").split():
                if other not in known or other == name:
                    near = "".join(f" (meant {a!r}?)" for a in find_nearest_name(other, known))
                    self.problems.add_problem(
                        name, f"the text {name}_tandem names {other!r}{near}; it names other axes of one load"
                    )
                elif not self._are_parallel(name, other):
                    self.problems.add_problem(
                        name,
                        f"the text {name}_tandem names {other!r}, whose joint has another direction or another distance for a "
                        "turn of the motor: tandem axes are side by side",
                    )
                together = sorted(
                    {name, other, *tandems.get(name, ()), *tandems.get(other, ())}, key=lambda a: (a not in known, a)
                )
                tandems |= {a: tuple(b for b in together if b != a) for a in together}
        return {a: tuple(b for b in others if b in self.axes) for a, others in tandems.items()}

    def _are_parallel(self, name: str, other: str) -> bool:
        """Return whether two joints have the same direction, and a turn of their motors moves them equally far."""
        m, data = self.model, mujoco.MjData(self.model)
        mujoco.mj_kinematics(m, data)
        one, two = (self._find_id(mujoco.mjtObj.mjOBJ_JOINT, a) for a in (name, other))
        gears = [abs(float(m.actuator_gear[self._find_id(mujoco.mjtObj.mjOBJ_ACTUATOR, a)][0])) for a in (name, other)]
        parallel = float(np.dot(data.xaxis[one], data.xaxis[two])) > MIN_PARALLEL_COSINE
        return bool(m.jnt_type[one] == m.jnt_type[two] and parallel and math.isclose(*gears, rel_tol=1e-3))

    # --- joint and actuator ---

    def _bind_axis(self, name: str) -> PlantAxis | None:
        """Bind one axis; None if it breaks the contract, with the reasons in `problems`."""
        m, obj = self.model, mujoco.mjtObj
        joint, actuator = self._find_id(obj.mjOBJ_JOINT, name), self._find_id(obj.mjOBJ_ACTUATOR, name)
        if joint < 0:
            near = self._find_similarly_named_joint(name)
            self.problems.add_problem(
                name,
                f"no joint {name!r}{suggest_name(m, obj.mjOBJ_JOINT, m.njnt, name, self.axes)}",
                propose_carriage(name) if near < 0 else propose_joint(m, near, name, None, self.degrees),
                *([propose_motor(m, name, name)] if actuator >= 0 and near >= 0 else []),
            )
        if actuator < 0:
            near_text = suggest_name(m, obj.mjOBJ_ACTUATOR, m.nu, name, self.axes)
            drivers = [m.actuator(k).name for k in range(m.nu) if joint >= 0 and self._acts_on_joint(joint, k)]
            old = next(filter(None, drivers), "")
            self.problems.add_problem(name, f"no actuator {name!r}{near_text}", propose_motor(m, name, old))
        if joint < 0 or actuator < 0:
            return None
        low, high = (float(v) for v in m.jnt_range[joint])
        if int(m.jnt_type[joint]) not in AXIS_JOINT_TYPES:
            line = propose_joint(m, joint, name, None if low < high else DEFAULT_JOINT_RANGES["slide"], self.degrees)
            self.problems.add_problem(name, f"joint {name!r} is neither slide nor hinge", line)
            return None
        if not low < high:
            line = propose_joint(m, joint, name, self.switches.find_free_travel(joint), self.degrees)
            self.problems.add_problem(name, f"joint {name!r} has no range, so its switches cannot be looked for", line)
        gear = float(m.actuator_gear[actuator][0])
        servo = bool(m.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_DCMOTOR)
        self._check_armature_and_actuator(name, joint, actuator, servo)
        unfitted = self._read_missing_switches(name)
        if not low < high:
            return None
        flag_distances = self.switches.measure_flag_distances(name, joint, low, high)
        switches_found = [
            self.switches.find_switch(name, pin, joint, low, high, flag_distances, unfitted)
            for pin in SWITCH_PINS
            if pin not in unfitted
        ]
        switches = tuple(s for s in switches_found if s is not None)
        self.switches.check_switch_order(name, switches)
        return PlantAxis(
            name, joint, int(m.jnt_qposadr[joint]), int(m.jnt_dofadr[joint]), actuator, gear, (low, high),
            bool(m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE), self.texts.get(f"{name}_motor"), servo,
            self._find_index_angle(name, gear, switches), switches,
        )  # fmt: skip

    def _find_similarly_named_joint(self, name: str) -> int:
        """Return the id of a slide or hinge that is no axis itself and whose name is similar, -1 if there is none."""
        kinds = self.model.jnt_type.tolist()
        others = {self.model.joint(k).name: k for k, kind in enumerate(kinds) if kind in AXIS_JOINT_TYPES}
        near = find_nearest_name(name, (other for other in others if other not in self.axes))
        return others[near[0]] if near else -1

    def _check_armature_and_actuator(self, name: str, joint: int, actuator: int, servo: bool) -> None:
        """Check the armature of the joint, and its actuator."""
        m = self.model
        armature = float(m.dof_armature[m.jnt_dofadr[joint]])
        if not 0 <= armature <= 1e9:
            self.problems.add_problem(
                name,
                f"joint {name!r} has an armature of {armature:g}; inertia is 0 to 1e9, in kg (kg m2 on a hinge): that of the "
                "rotor times the gear squared, or 0",
            )
        gear = float(m.actuator_gear[actuator][0])
        fits = self._is_dc_motor(joint, actuator) if servo else self._is_motor(joint, actuator)
        if not fits or not MIN_GEAR <= abs(gear) <= MAX_GEAR:
            self.problems.add_problem(
                name,
                f"actuator {name!r} is not a <motor> on joint {name!r}, nor a <dcmotor> with voltage input only, with a gear of "
                f"1e-6 to 1e9 (rotor radians per joint unit); if {name!r} is no axis of a chip, name those that are: "
                "chips={axis: chip}",
                propose_motor(self.model, name, name),
            )

    def _read_missing_switches(self, name: str) -> list[str]:
        """Return the switches that an axis does not have."""
        unfitted = self.texts.get(f"{name}_unfitted", "").split()
        for pin in unfitted:
            if pin not in SWITCH_PINS:
                near = "".join(f" (meant {p!r}?)" for p in find_nearest_name(pin, SWITCH_PINS))
                self.problems.add_problem(
                    name, f"the text {name}_unfitted names {pin!r}{near}; switches are {', '.join(SWITCH_PINS)}"
                )
        return unfitted

    def _find_index_angle(self, name: str, gear: float, switches: Iterable[Switch]) -> float:
        """Return the rotor angle of the index pulse, in turns, from the model or by default from ORG."""
        m = self.model
        k = self._find_id(mujoco.mjtObj.mjOBJ_NUMERIC, f"{name}_index")
        if k >= 0:
            index = float(m.numeric_data[m.numeric_adr[k]])
            if not abs(index) <= 1e6:
                self.problems.add_problem(name, f"the numeric {name}_index is {index}: give turns, mostly 0 to 1")
            return index
        return next(((s.touch * gear / (2 * np.pi) + 0.5) % 1.0 for s in switches if s.pin == "org"), 0.0)

    def _acts_on_joint(self, joint: int, actuator: int) -> bool:
        """Return whether an actuator acts on a joint."""
        m = self.model
        return bool(
            m.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT and m.actuator_trnid[actuator][0] == joint
        )

    def _is_dc_motor(self, joint: int, actuator: int) -> bool:
        """Return whether an actuator is a DC motor without states of its own, with one control: the voltage."""
        m = self.model
        resistance, constant = m.actuator_gainprm[actuator][:2]
        stateless = m.actuator_actnum[actuator] == 0 and not m.actuator_biasprm[actuator].any()
        return self._acts_on_joint(joint, actuator) and bool(stateless and resistance > 0 and constant > 0)

    def _is_motor(self, joint: int, actuator: int) -> bool:
        """Return whether an actuator is a plain <motor> on a joint."""
        m = self.model
        return self._acts_on_joint(joint, actuator) and bool(
            m.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
            and m.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
            and m.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
            and m.actuator_gainprm[actuator][0] == 1
        )
