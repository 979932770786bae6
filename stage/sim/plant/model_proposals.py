"""Proposals for a model that breaks the naming contract: MJCF elements, each with the place in the file where it belongs.

Pasted into the model, the proposals of an error compile: they name only geoms and joints that the model has, or that a proposal of
the same error adds, and an element that replaces another keeps the attributes of that one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

MARGIN_M, LOOKAHEAD_M = -0.03, 0.01  # m: of a pair; the vane is detected from LOOKAHEAD_M before the touch on
SCREW_GEAR, TABLE_GEAR = 628.3185307, 10.0  # rotor radians per m of a screw of 10 mm lead; per rad of a table
# of a joint whose hard stops are not found: m, rad
DEFAULT_JOINT_RANGES = {"slide": (-0.15, 0.15), "hinge": (-3.1416, 3.1416)}
VANE_HALF_THICKNESS_M, BEAM_RADIUS_M, VANE_SPACING_M = 0.0005, 0.0005, 0.004
MAX_GEAR, MIN_GEAR = 1e9, 1e-6
SWITCH_RGBA = {"el": "0.86 0.16 0.15 1", "sd": "0.98 0.68 0.08 1", "org": "0.12 0.66 0.32 1"}


class Proposal(NamedTuple):
    """An MJCF element that repairs a model.

    Attributes:
        place: Where it belongs, as "in <sensor>" or "in place of joint 'x'".
        line: Element, on one line.
    """

    place: str
    line: str


class FlagInterval(NamedTuple):
    """Joint positions, m or rad, from which and up to which a new switch is asserted."""

    low: float
    high: float


def format_proposals(proposals: Iterable[Proposal]) -> str:
    """Format proposals as the end of an error message: each place once, and below it what belongs there."""
    by_place: dict[str, list[str]] = {}
    for place, line in proposals:
        by_place.setdefault(place, []).append(line)
    return "".join(
        f"\n    {place}:" + "".join(f"\n      {line}" for line in lines) for place, lines in by_place.items()
    )


def _format_element(tag: str, **attributes: Any) -> str:
    """Format an MJCF element; numbers and vectors with seven digits, without attributes whose value is None."""
    texts = {
        name.rstrip("_"): value if isinstance(value, str) else " ".join(f"{v:.7g}" for v in np.ravel(value))
        for name, value in attributes.items()
        if value is not None
    }
    return f"<{tag}{''.join(f' {name}={quoteattr(text)}' for name, text in texts.items())}/>"


def propose_motor(model: Any, axis: str, old: str = "") -> Proposal:
    """Propose the motor of an axis; it keeps the gear of the actuator that it replaces, unless that is 1, MuJoCo's own.

    Args:
        model: MjModel or MjSpec.
        axis: Name of the motor and of its joint, whose kind decides on the gear of a new motor.
        old: Name of the actuator that the motor replaces; "": none.
    """
    gear = float(model.actuator(old).gear[0]) if old else 0.0
    if gear == 1 or not MIN_GEAR <= abs(gear) <= MAX_GEAR:
        gear = TABLE_GEAR if _is_hinge(model, axis) else SCREW_GEAR
    line = f'<motor name={quoteattr(axis)} joint={quoteattr(axis)} gear="{gear:.10g}"/>'
    return Proposal(f"in place of actuator {old!r}" if old else "in <actuator>", line)


def _is_hinge(model: Any, joint: str) -> bool:
    """Return whether a model has a joint of this name that is a hinge."""
    names = [j.name for j in model.joints] if isinstance(model, mujoco.MjSpec) else _list_joint_names(model)
    return joint in names and int(np.squeeze(model.joint(joint).type)) == mujoco.mjtJoint.mjJNT_HINGE


def _list_joint_names(model: mujoco.MjModel) -> list[str]:
    """List the names of the joints of a model."""
    return [model.joint(k).name for k in range(model.njnt)]


def propose_carriage(axis: str) -> Proposal:
    """Propose a body with the joint of an axis, for a model that has no such joint."""
    low, high = DEFAULT_JOINT_RANGES["slide"]
    joint = _format_element(
        "joint", name=axis, type="slide", axis=[1, 0, 0], range=[low, high], limited="false", damping=60, frictionloss=4
    )
    geom = _format_element(
        "geom", type="box", size=[0.04, 0.04, 0.01], pos=[0, 0, 0.02], mass=1, contype="0", conaffinity="0"
    )
    return Proposal("in <worldbody>", f"<body>{joint}{geom}</body>")


def propose_joint(
    model: mujoco.MjModel, joint: int, axis: str, travel: tuple[float, float] | None, degrees: bool
) -> Proposal:
    """Propose a joint that keeps every attribute of the one that it replaces, except a kind that no axis can have.

    Args:
        model: Model.
        joint: Id of the joint that it replaces.
        axis: Name of the axis.
        travel: Range, m or rad; None: that of the joint.
        degrees: Whether the angles of the model's file are in degrees.
    """
    dof, m = int(model.jnt_dofadr[joint]), model
    kind = "hinge" if m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE else "slide"
    is_axis = int(m.jnt_type[joint]) in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
    angle = 180 / np.pi if degrees and kind == "hinge" else 1.0
    reference = float(m.qpos0[m.jnt_qposadr[joint]]) if is_axis else 0.0
    spring_reference = float(m.qpos_spring[m.jnt_qposadr[joint]]) if is_axis else 0.0
    polynomial = np.any(m.dof_dampingpoly[dof]), np.any(m.jnt_stiffnesspoly[joint])
    damping = np.append(m.dof_damping[dof], m.dof_dampingpoly[dof] if polynomial[0] else [])
    stiffness = np.append(m.jnt_stiffness[joint], m.jnt_stiffnesspoly[joint] if polynomial[1] else [])
    # MuJoCo takes the range of a joint without limits in radians
    limited = bool(m.jnt_limited[joint]) and travel is None

    def list_unless_default(value: Any, default: Any) -> Any:
        return None if np.allclose(value, default) else value

    line = _format_element(
        "joint",
        name=axis,
        type=kind,
        axis=m.jnt_axis[joint] if is_axis else [1, 0, 0],
        pos=list_unless_default(m.jnt_pos[joint], 0),
        range=np.array(travel or m.jnt_range[joint]) * (angle if limited else 1),
        limited="true" if limited else "false",
        ref=list_unless_default(reference * angle, 0),
        springref=list_unless_default(spring_reference * angle, 0),
        stiffness=list_unless_default(stiffness, 0),
        damping=damping,
        frictionloss=m.dof_frictionloss[dof],
        armature=m.dof_armature[dof],
        margin=list_unless_default(m.jnt_margin[joint], 0),
        group=list_unless_default(m.jnt_group[joint], 0),
        actuatorgravcomp="true" if m.jnt_actgravcomp[joint] else None,
        actuatorfrcrange=m.jnt_actfrcrange[joint] if m.jnt_actfrclimited[joint] else None,
        solreflimit=list_unless_default(m.jnt_solref[joint], [0.02, 1]),
        solimplimit=list_unless_default(m.jnt_solimp[joint], [0.9, 0.95, 0.001, 0.5, 2]),
        solreffriction=list_unless_default(m.dof_solref[dof], [0.02, 1]),
        solimpfriction=list_unless_default(m.dof_solimp[dof], [0.9, 0.95, 0.001, 0.5, 2]),
    )
    return Proposal(f"in place of joint {m.joint(joint).name!r}", line)


def propose_sensor(model: mujoco.MjModel, axis: str, pin: str, vane: str, switch: str) -> Proposal:
    """Propose the contact sensor of a switch.

    Args:
        model: Model.
        axis: Name of the axis.
        pin: Pin of the switch.
        vane: Name of the vane's geom.
        switch: Name of the switch's geom.
    """
    name = f"{axis}_{pin}"
    line = _format_element("contact", name=name, geom1=vane, geom2=switch, num="1", reduce="mindist", data="found dist")
    exists = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name) >= 0
    return Proposal(f"in place of sensor {name!r}" if exists else "in <sensor>", line)


def propose_pair(model: mujoco.MjModel, vane: str, switch: str, overlap: float = 0.0) -> Proposal:
    """Propose a pair of vane and switch that is detected and exerts no force.

    Args:
        model: Model.
        vane: Name of the vane's geom.
        switch: Name of the switch's geom.
        overlap: Depth to which the two overlap, m.
    """
    margin = min(MARGIN_M, -round(1.5 * overlap, 3))
    line = _format_element("pair", geom1=vane, geom2=switch, margin=margin, gap=LOOKAHEAD_M - margin)
    exists = has_pair(model, vane, switch)
    return Proposal(f"in place of the pair of {vane!r} and {switch!r}" if exists else "in <contact>", line)


def has_pair(model: mujoco.MjModel, vane: str, switch: str) -> bool:
    """Return whether a model has an explicit pair of two geoms."""
    pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    return any({model.geom(a).name, model.geom(b).name} == {vane, switch} for a, b in pairs)


def propose_unfitted_switches_text(axis: str, pins: Iterable[str], exists: bool) -> Proposal:
    """Propose the text that names the switches that an axis does not have.

    Args:
        axis: Name of the axis.
        pins: Pins of these switches.
        exists: Whether the model has such a text already.
    """
    name = f"{axis}_unfitted"
    line = _format_element("text", name=name, data=" ".join(pins))
    return Proposal(f"in place of text {name!r}" if exists else "in <custom>", line)


def propose_flag_geoms(
    model: mujoco.MjModel, joint: int, names: tuple[str, str], pin: str, number: int, interval: FlagInterval
) -> list[Proposal]:
    """Propose the geoms of a new switch: a thin vane on the moving body, and a beam of light on the body that carries it.

    Args:
        model: Model.
        joint: Id of the joint of the axis.
        names: Names of vane and beam.
        pin: Pin of the switch, which decides on the color.
        number: Number of the switch, 0 to 4: each has a place of its own beside the others.
        interval: Joint positions at which the switch is asserted.
    """
    body = int(model.jnt_bodyid[joint])
    parent = int(model.body_parentid[body])
    rotation = _find_joint_rotation(model, joint)
    reach = _measure_reach(model, joint, rotation)
    middle = (interval.low + interval.high) / 2 - float(model.qpos0[model.jnt_qposadr[joint]])
    half = (interval.high - interval.low) / 2
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        lateral = reach + VANE_SPACING_M * (number + 1)
        vane_place, beam_place = np.array([0, lateral, 0]), np.array([middle, lateral, 0])
        size = [half - BEAM_RADIUS_M, VANE_HALF_THICKNESS_M, 0.005]
    else:
        radius, height = max(reach, 0.02) + 0.008, VANE_SPACING_M * (number + 1)
        sag = radius * (1 - np.cos(half))
        vane_place = np.array([radius - sag / 2, 0, height])
        beam_place = np.array([radius * np.cos(middle), radius * np.sin(middle), height])
        size = [0.004 + sag / 2, radius * np.sin(half) - BEAM_RADIUS_M, VANE_HALF_THICKNESS_M]
    anchor, common = model.jnt_pos[joint], {"contype": "0", "conaffinity": "0", "mass": "0"}
    vane = _format_element(
        "geom", name=names[0], type="box", size=size, pos=_round_coordinates(anchor + rotation @ vane_place),
        quat=_round_coordinates(_to_quaternion(rotation)), rgba=SWITCH_RGBA[pin.split("_")[0]], **common,
    )  # fmt: skip
    turn = _to_matrix(model.body_quat[body])
    beam = _format_element(
        "geom", name=names[1], type="sphere", size=BEAM_RADIUS_M,
        pos=_round_coordinates(model.body_pos[body] + turn @ (anchor + rotation @ beam_place)), rgba="1 0.3 0.2 1", **common,
    )  # fmt: skip
    joint_name = model.joint(joint).name
    parent_name = model.body(parent).name
    parent_place = (
        f"in <body name={quoteattr(parent_name)}>" if parent_name else f"around the <body> of joint {joint_name!r}"
    )
    return [
        Proposal(f"in the <body> of joint {joint_name!r}", vane),
        Proposal(parent_place if parent else "in <worldbody>", beam),
    ]


def _round_coordinates(values: np.ndarray) -> np.ndarray:
    """Round coordinates to a nanometer, and -0 to 0."""
    return np.round(values, 9) + 0.0


def _find_joint_rotation(model: mujoco.MjModel, joint: int) -> np.ndarray:
    """Return the rotation matrix, in the body's frame, of a frame whose x is along a slide, or whose z is along a hinge."""
    axis = model.jnt_axis[joint]
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
        x = _cross_unit([0, 1, 0] if abs(axis[1]) < 0.9 else [0, 0, 1], axis)
        return np.column_stack([x, np.cross(axis, x), axis])
    y = _cross_unit([0, 0, 1] if abs(axis[2]) < 0.9 else [1, 0, 0], axis)
    return np.column_stack([axis, y, np.cross(axis, y)])


def _cross_unit(a: Sequence[float], b: np.ndarray) -> np.ndarray:
    """Return the unit vector that is perpendicular to two vectors."""
    c: np.ndarray = np.cross(a, b)
    return c / np.linalg.norm(c)


def _to_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Convert a quaternion to a rotation matrix."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _to_quaternion(matrix: np.ndarray) -> np.ndarray:
    """Convert a rotation matrix to a quaternion."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(matrix).ravel())
    return quaternion


def _measure_reach(model: mujoco.MjModel, joint: int, rotation: np.ndarray) -> float:
    """Measure how far the geoms of a joint's body reach beside the joint: along y for a slide, along x and y for a hinge, m."""
    body, reach = int(model.jnt_bodyid[joint]), 0.0
    hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    for geom in np.flatnonzero(model.geom_bodyid == body):
        turn, center, half = _to_matrix(model.geom_quat[geom]), model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        middle = rotation.T @ (model.geom_pos[geom] + turn @ center - model.jnt_pos[joint])
        extent = np.abs(rotation.T @ turn) @ half
        outermost = np.abs(middle) + extent if hinge else middle + extent
        reach = max(reach, float(outermost[:2].max() if hinge else outermost[1]))
    return reach
