"""`build_model_text`: writes a commented MJCF model that keeps the naming contract. Each axis moves the next one.

    axes = [NewAxis.parse("x:slide:300mm"), NewAxis.parse("a:hinge:360deg")]
    text = build_model_text(axes)

A slide is a carriage on a screw of 10 mm lead, a hinge a table on a 10:1 gear. The travel of an axis is that between its end
limits. From minus to plus an axis has: hard stop, EL-, ORG (asserted at and below the origin), SD-, SD+, EL+, hard stop. A hinge of
360 degrees turns endlessly, and has the switch ORG only.

Guides, screws, motors, posts and the bench are there for the eye: they have no mass and touch nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np

from stage.errors import ModelError

SCREW_LEAD_M = 0.010  # m a turn
GEAR_RATIO = 10  # turns of the motor for one of a table
ROTOR_INERTIA_KG_M2 = 5.4e-6  # kg m2, of a 17HS4401
MOTOR_NAME = "17HS4401"
STEEL, SCREW = 7850, 0.005  # kg/m3; m: the screw's radius
SLIDE_TRAVEL_RANGE_M = 0.01, 2.0  # m between the end limits
# degrees; what lies between WIDEST and TURN leaves no room for the hard stops
TURN, WIDEST, NARROWEST = 360.0, 330.0, 20.0
TABLE_RADIUS_M = 0.060  # m: a table's radius
BASE_TOP_M, BASE_BOTTOM_M = -0.002, -0.018  # m: height of the base plate of an axis in its frame
# m: half the length of a carriage; thickness of the plates at the ends of a slide
HALF_CARRIAGE_M, END_PLATE_M = 0.04, 0.01
HALF_MOTOR_WIDTH_M = 0.021  # m: half the width of a motor
BENCH_MARGIN_M, BENCH_THICKNESS_M = 0.04, 0.02  # m: the bench is larger than the machine by this, on each side
CAMERA_FOVY_DEG, CAMERA_AZIMUTH_DEG, CAMERA_ELEVATION_DEG = 30.0, -120.0, 24.0  # seen from in front, on the left
CAMERA_ASPECT, CAMERA_FILL = 16 / 9, 0.94  # of the picture; the share of it that the machine and its bench take
# quaternions: how the x of a slide's own frame lies
SLIDE_QUATERNIONS = {"x": "1 0 0 0", "y": "1 0 0 1", "z": "1 0 -1 0"}
INVERSE_SLIDE_QUATERNIONS = {"x": "1 0 0 0", "y": "1 0 0 -1", "z": "1 0 1 0"}
BUMPER_RADIUS_M = 0.005  # m
BEAM_RADIUS_M = 0.0005  # m: radius of a light beam, at whose surface a switch trips
UNITS_BY_KIND = {"slide": {"m": 1.0, "cm": 1e-2, "mm": 1e-3}, "hinge": {"deg": 1.0, "rad": 180 / math.pi}}


@dataclass(frozen=True)
class NewAxis:
    """Axis of a new model.

    Attributes:
        name: Name of joint and actuator.
        kind: slide or hinge.
        travel: Travel between the end limits, m, degrees on a hinge.
    """

    name: str
    kind: str
    travel: float

    @classmethod
    def parse(cls, text: str) -> NewAxis:
        """Parse `x:slide:300mm` or `a:hinge:90deg`.

        Raises:
            ModelError: The text has another form, or the travel is out of range.
        """
        m = re.fullmatch(r"([A-Za-z]\w*):(slide|hinge):([\d.]+)(mm|cm|m|deg|rad)", text.strip())
        if m is None or m[4] not in UNITS_BY_KIND[m[2]] or not re.fullmatch(r"\d+\.?\d*|\.\d+", m[3]):
            raise ModelError(f"{text!r}: an axis is NAME:slide:300mm (m, cm, mm), or NAME:hinge:90deg (deg, rad).")
        travel = float(m[3]) * UNITS_BY_KIND[m[2]][m[4]]
        low, high = SLIDE_TRAVEL_RANGE_M
        if m[2] == "slide" and not low <= travel <= high:
            raise ModelError(f"{text!r}: {low * 1e3:g} mm to {high:g} m between the end limits.")
        if m[2] == "hinge" and not (NARROWEST <= travel <= WIDEST or math.isclose(travel, TURN, rel_tol=1e-3)):
            raise ModelError(
                f"{text!r}: {NARROWEST:g} to {WIDEST:g} degrees between the end limits; or 360deg: it turns without end."
            )
        return cls(m[1], m[2], travel)

    @property
    def endless(self) -> bool:
        """True for an axis that turns endlessly, without end limits."""
        return self.kind == "hinge" and self.travel > WIDEST


class _SwitchGeom(NamedTuple):
    """Switch that is asserted from `low` to `high`, joint units (degrees)."""

    name: str
    low: float
    high: float
    colour: str


class _AxisParts(NamedTuple):
    """MJCF lines that an axis adds to the model: fixed to its frame, on its moving part, and pairs for contacts."""

    frame: list[str]
    moving: list[str]
    pairs: list[str]


def build_model_text(axes: Sequence[NewAxis]) -> str:
    """Return the MJCF of a new model.

    Args:
        axes: Axes of the model; each moves the next one.

    Raises:
        ModelError: Two axes have one name, or there is none.
    """
    names = [a.name for a in axes]
    if not axes or len(set(names)) < len(names):
        raise ModelError(f"axes {', '.join(names) or 'none'}: one or more, each of a name of its own.")
    bodies, pairs = _build_bodies(list(axes), _choose_directions(axes))
    text = _format_model_text(axes, bodies, pairs, [])
    return _format_model_text(axes, bodies, pairs, _build_workbench_and_camera(text))


def _format_model_text(axes: Sequence[NewAxis], bodies: list[str], pairs: list[str], surroundings: list[str]) -> str:
    """Write the MJCF of a model.

    Args:
        axes: Axes of the model.
        bodies: Lines of the bodies.
        pairs: Lines of the contact pairs.
        surroundings: Lines of bench and camera.
    """
    names = [a.name for a in axes]
    lines = [
        "<!-- A stage for PulseStage. Units: m, kg, s. An axis is a joint and an actuator of one name; its switches are the",
        "     contact sensors NAME_el_plus ... `stage view` prints the axes as text, or what is missing.",
        f"     Axes: {', '.join(names)}. -->",
        '<mujoco model="new">',
        '  <compiler angle="radian" autolimits="false"/>',
        "  <!-- steppers are stiff: a longer step would lose steps that a real motor does not -->",
        '  <option timestep="0.00025" integrator="implicitfast"/>',
        "  <asset>",
        '    <texture type="skybox" builtin="gradient" rgb1="0.6 0.65 0.71" rgb2="0.3 0.34 0.4" width="64" height="64"/>',
        "  </asset>",
        '  <visual><global offwidth="1920" offheight="1080"/><headlight ambient="0.4 0.4 0.4"/></visual>',
        "  <default>",
        "    <!-- what has no pair below touches nothing; mass is given where it counts -->",
        '    <geom type="box" contype="0" conaffinity="0" mass="0" rgba="0.66 0.69 0.73 1"/>',
        '    <default class="frame"><geom rgba="0.20 0.22 0.26 1"/></default>',
        "    <!-- for the eye: guides and screw, motor, posts of switches -->",
        '    <default class="steel"><geom rgba="0.80 0.82 0.85 1"/></default>',
        '    <default class="motor"><geom rgba="0.10 0.10 0.12 1"/></default>',
        '    <default class="post"><geom type="capsule" size="0.0012" rgba="0.35 0.38 0.42 1"/></default>',
        "    <!-- a switch: a light beam on the frame, a thin vane on what moves; seen from 10 mm before the touch, never felt -->",
        '    <default class="beam"><geom type="sphere" size="0.0005" rgba="1 0.3 0.2 1"/></default>',
        '    <default class="switch"><pair margin="-0.03" gap="0.04" condim="1"/></default>',
        "    <!-- a hard stop: rubber; a real contact -->",
        '    <default class="bumper"><geom type="sphere" size="0.005" rgba="0.1 0.1 0.1 1"/></default>',
        '    <default class="stop"><pair condim="1" solref="0.005 1" solimp="0.95 0.99 0.0005"/></default>',
        "  </default>",
        "  <worldbody>",
        '    <light pos="-0.5 -0.8 1.5" dir="0.3 0.5 -1" diffuse="0.6 0.6 0.6"/>',
        '    <light directional="true" pos="1 -1 1" dir="-0.6 0.5 -0.6" diffuse="0.25 0.25 0.25" castshadow="false"/>',
        *(f"    {line}" for line in surroundings + bodies),
        "  </worldbody>",
        "  <contact>",
        *(f"    {line}" for line in pairs),
        "  </contact>",
        "  <!-- gear: rotor radians for a metre (a radian on a hinge); ctrl is the rotor's torque, N m -->",
        "  <actuator>",
        *(f'    <motor name="{a.name}" joint="{a.name}" gear="{_compute_gear(a):.7g}"/>' for a in axes),
        "  </actuator>",
        "  <sensor>",
        *(
            f'    <contact name="{a.name}_{s.name}" geom1="{a.name}_{s.name}_vane" geom2="{a.name}_{s.name}_beam" num="1" '
            'data="found dist"/>'
            for a in axes
            for s in _list_switches(a)
        ),
        "  </sensor>",
        "  <!-- the motor whose rotor is inside the joint's armature; switches that an axis does not have -->",
        "  <custom>",
        *(f'    <text name="{a.name}_motor" data="{MOTOR_NAME}"/>' for a in axes),
        *(f'    <text name="{a.name}_unfitted" data="el_plus el_minus sd_plus sd_minus"/>' for a in axes if a.endless),
        "  </custom>",
        "</mujoco>",
    ]
    return "\n".join(lines) + "\n"


def _choose_directions(axes: Sequence[NewAxis]) -> dict[str, str]:
    """Choose the direction x, y or z of each slide: the one in its name, or the next that no other slide has."""
    directions = {a.name: a.name.lower() for a in axes if a.kind == "slide" and a.name.lower() in SLIDE_QUATERNIONS}
    free = [d for d in SLIDE_QUATERNIONS if d not in directions.values()]
    for a in axes:
        if a.kind == "slide" and a.name not in directions:
            directions[a.name] = free.pop(0) if free else "x"
    return directions


def _build_bodies(axes: list[NewAxis], directions: dict[str, str]) -> tuple[list[str], list[str]]:
    """Return the MJCF lines of the bodies, each axis inside the body of the axis before, and the lines of all contact pairs."""
    a, rest = axes[0], axes[1:]
    direction = directions.get(a.name, "x")
    parts = _build_slide(a, direction == "z") if a.kind == "slide" else _build_hinge(a)
    inner, pairs = _build_bodies(rest, directions) if rest else (
        ['<site name="work" pos="0 0 0.01" size="0.003" rgba="0.2 0.9 0.4 0.6"/>'], []
    )  # fmt: skip
    above = "0 0 0.04" if direction != "z" else "0 0 0.1"  # a slide upwards carries the next in front of it, on an arm
    arm = '<geom size="0.02 0.02 0.035" pos="0 0 0.065" mass="0.1"/>'
    if direction != "x":
        inner = [f'<frame quat="{INVERSE_SLIDE_QUATERNIONS[direction]}">', *_indent(inner), "</frame>"]
    inner = [*([arm] if direction == "z" else []), f'<frame pos="{above}">', *_indent(inner), "</frame>"]
    reach = _compute_stop_distance(a) if a.kind == "slide" else math.radians(_compute_stop_distance(a))
    inertia = _compute_armature(a)
    friction = 'damping="60" frictionloss="4"' if a.kind == "slide" else 'damping="0.02" frictionloss="0.05"'
    axis = 'type="slide" axis="1 0 0"' if a.kind == "slide" else 'type="hinge" axis="0 0 1"'
    kind = "screw of 10 mm lead" if a.kind == "slide" else f"gear {GEAR_RATIO}:1"
    lines = [
        f"<!-- {a.name}: {a.kind}, {_describe_travel(a)}; {kind}; the frame -->",
        f'<frame pos="0 0 {_measure_column_lift(a, direction):.6g}" quat="{SLIDE_QUATERNIONS[direction]}">',
        *_indent(parts.frame),
        f'  <body name="{a.name}">',
        "    <!-- armature: (rotor + screw) x gear^2 -->"
        if a.kind == "slide"
        else "    <!-- armature: rotor x gear^2 -->",
        f'    <joint name="{a.name}" {axis} range="{-reach:.7g} {reach:.7g}" limited="false" {friction} armature="{inertia:.4g}"/>',
        *_indent(_indent(parts.moving + inner)),
        "  </body>",
        "</frame>",
    ]
    return lines, parts.pairs + pairs


def _compute_rail_half_length(axis: NewAxis) -> float:
    """Return half the length of the base plate of a slide, m."""
    return _compute_stop_distance(axis) + HALF_CARRIAGE_M + 2 * BUMPER_RADIUS_M + END_PLATE_M


def _measure_column_lift(axis: NewAxis, direction: str) -> float:
    """Return the height by which a slide upwards is raised, so that its column stands on what carries it, m."""
    return _compute_rail_half_length(axis) + BASE_BOTTOM_M if direction == "z" else 0.0


def _build_workbench_and_camera(text: str) -> list[str]:
    """Return the lines of a bench below a model, and of a camera that frames the model.

    Args:
        text: MJCF of the model.
    """
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    signs = np.array(list(product((-1, 1), repeat=3)))
    corners = model.geom_aabb[:, None, :3] + signs * model.geom_aabb[:, None, 3:]
    points = np.einsum("gij,gcj->gci", data.geom_xmat.reshape(-1, 3, 3), corners) + data.geom_xpos[:, None]
    points = points.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, bench = (low + high) / 2, (high - low)[:2] / 2 + BENCH_MARGIN_M
    bench_corners = [[*(middle[:2] + bench * s[:2]), low[2] - BENCH_THICKNESS_M] for s in signs[::2]]
    azimuth, elevation = math.radians(CAMERA_AZIMUTH_DEG), math.radians(CAMERA_ELEVATION_DEG)
    away = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    up = np.cross(away, right)
    eye = _find_camera_place(np.concatenate([points, bench_corners]), away, right, up)
    return [
        f'<geom name="bench" size="{bench[0]:.4g} {bench[1]:.4g} {BENCH_THICKNESS_M / 2}" pos="{middle[0]:.4g} {middle[1]:.4g} '
        f'{low[2] - BENCH_THICKNESS_M / 2:.4g}" rgba="0.50 0.47 0.43 1"/>',
        f'<camera name="overview" pos="{_format_coordinates(eye)}" '
        f'xyaxes="{_format_coordinates(right)} {_format_coordinates(up)}" fovy="{CAMERA_FOVY_DEG:g}"/>',
    ]


def _find_camera_place(points: np.ndarray, away: np.ndarray, right: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Find the place from which a camera sees points in the middle of its picture, which they fill except for a rim.

    Args:
        points: Points to see, (n, 3).
        away: Direction from the points to the camera.
        right: Direction to the right in the picture.
        up: Direction upwards in the picture.
    """
    tangents = math.tan(math.radians(CAMERA_FOVY_DEG) / 2) * np.array([CAMERA_ASPECT, 1.0])
    target, distance = points.mean(axis=0), 4 * float(np.ptp(points, axis=0).max()) / tangents[1]
    for _ in range(100):
        offsets = points - (target + distance * away)
        picture = np.column_stack([offsets @ right, offsets @ up]) / (-(offsets @ away))[:, None] / tangents
        low, high = picture.min(axis=0), picture.max(axis=0)
        shift = 0.25 * (low + high) * tangents * distance
        target = target + shift[0] * right + shift[1] * up
        distance *= math.sqrt(float((high - low).max()) / 2 / CAMERA_FILL)
    return target + distance * away


def _format_coordinates(values: Sequence[float] | np.ndarray) -> str:
    """Format coordinates for an attribute, with five digits."""
    return " ".join(f"{v:.5g}" for v in values)


def _describe_travel(axis: NewAxis) -> str:
    """Describe the travel of an axis, for a comment in the model."""
    if axis.endless:
        return "turns without end"
    return f"{axis.travel * 1e3:g} mm" if axis.kind == "slide" else f"{axis.travel:g} degrees"


def _indent(lines: Sequence[str]) -> list[str]:
    return [f"  {line}" for line in lines]


def _compute_gear(axis: NewAxis) -> float:
    """Compute the rotor radians per joint unit of an axis."""
    return 2 * math.pi / SCREW_LEAD_M if axis.kind == "slide" else float(GEAR_RATIO)


def _compute_armature(axis: NewAxis) -> float:
    """Return the inertia of rotor and screw as seen at the joint, MuJoCo's armature, kg (kg m^2 on a hinge)."""
    screw = 0.5 * STEEL * math.pi * SCREW**4 * (axis.travel + 0.1) if axis.kind == "slide" else 0.0
    return (ROTOR_INERTIA_KG_M2 + screw) * _compute_gear(axis) ** 2


def _compute_stop_distance(axis: NewAxis) -> float:
    """Return the distance of the hard stops from the middle, m (degrees)."""
    if axis.endless:
        return TURN / 2
    return axis.travel / 2 + (0.006 if axis.kind == "slide" else 3.0)


def _list_switches(axis: NewAxis) -> list[_SwitchGeom]:
    """Return the switches with their ranges."""
    green, red, amber = "0.12 0.66 0.32 1", "0.86 0.16 0.15 1", "0.98 0.68 0.08 1"
    if axis.endless:
        return [_SwitchGeom("org", -20.0, 0.0, green)]
    end, beyond = axis.travel / 2, _compute_stop_distance(axis) + (0.005 if axis.kind == "slide" else 2.0)
    return [
        _SwitchGeom("el_plus", end, beyond, red),
        _SwitchGeom("el_minus", -beyond, -end, red),
        _SwitchGeom("sd_plus", 0.87 * end, beyond, amber),
        _SwitchGeom("sd_minus", -beyond, -0.73 * end, amber),
        _SwitchGeom("org", -beyond, -0.8 * end, green),
    ]


def _build_slide(axis: NewAxis, upright: bool) -> _AxisParts:
    """Return the parts of a rail and its carriage, along x.

    Args:
        axis: Axis to build.
        upright: Whether the slide stands: its motor is then at the plus end, above.
    """
    wide = 0.045  # m: beams lie beside the carriage
    rail, inner = _compute_rail_half_length(axis), _compute_rail_half_length(axis) - END_PLATE_M
    side = 1 if upright else -1
    frame = [
        f'<geom class="frame" size="{rail:.6g} 0.03 0.008" pos="0 0 -0.01"/>',
        f'<geom class="frame" size="{rail:.6g} 0.018 0.002" pos="0 0.048 -0.004"/>',
        *(f'<geom class="steel" size="{inner:.6g} 0.004 0.004" pos="0 {y} 0.002"/>' for y in (-0.022, 0.022)),
        f'<geom class="steel" type="cylinder" size="{SCREW} {inner:.6g}" pos="0 0 0.004" quat="1 0 1 0"/>',
        *(
            f'<geom class="frame" size="{END_PLATE_M / 2} 0.03 0.017" pos="{sign * (rail - END_PLATE_M / 2):.6g} 0 0.011"/>'
            for sign in (-1, 1)
        ),
        f'<geom class="motor" size="{HALF_MOTOR_WIDTH_M} {HALF_MOTOR_WIDTH_M} {HALF_MOTOR_WIDTH_M}" '
        f'pos="{side * (rail + HALF_MOTOR_WIDTH_M):.6g} 0 {BASE_BOTTOM_M + HALF_MOTOR_WIDTH_M:.4g}"/>',
    ]
    moving = [
        f'<geom name="{axis.name}_carriage" size="{HALF_CARRIAGE_M} 0.04 0.01" pos="0 0 0.02" mass="0.8"/>',
        '<geom class="frame" size="0.03 0.027 0.002" pos="0 0 0.008"/>',
        '<geom size="0.006 0.0125 0.001" pos="0 0.0515 0.026"/>',
    ]
    pairs = []
    for k, s in enumerate(_list_switches(axis)):
        at, long = (s.low + s.high) / 2, (s.high - s.low) / 2
        y = wide + 0.004 * k
        frame.append(f'<geom name="{axis.name}_{s.name}_beam" class="beam" pos="{at:.6g} {y:.4g} 0.02"/>')
        frame.append(f'<geom class="post" fromto="{at:.6g} {y:.4g} {BASE_TOP_M} {at:.6g} {y:.4g} 0.012"/>')
        moving.append(
            f'<geom name="{axis.name}_{s.name}_vane" size="{long - BEAM_RADIUS_M:.6g} 0.0005 0.005" '
            f'pos="0 {y:.4g} 0.02" rgba="{s.colour}"/>'
        )
        pairs.append(_make_pair(axis, s))
    for name, sign in (("plus", 1), ("minus", -1)):
        at = sign * (_compute_stop_distance(axis) + HALF_CARRIAGE_M + BUMPER_RADIUS_M)
        frame.append(f'<geom name="{axis.name}_bumper_{name}" class="bumper" pos="{at:.6g} 0 0.02"/>')
        pairs.append(f'<pair class="stop" geom1="{axis.name}_carriage" geom2="{axis.name}_bumper_{name}"/>')
    return _AxisParts(frame, moving, pairs)


def _build_hinge(axis: NewAxis) -> _AxisParts:
    """Return the parts of a table that turns about z on a drum. Each switch and its flat vane have a height of their own."""
    name, at_radius, post_radius = axis.name, TABLE_RADIUS_M - 0.008, TABLE_RADIUS_M + 0.004
    frame = [f'<geom class="frame" type="cylinder" size="{TABLE_RADIUS_M + 0.01:.4g} 0.008" pos="0 0 -0.01"/>']
    moving = [
        f'<geom name="{name}_table" type="cylinder" size="{TABLE_RADIUS_M} 0.004" pos="0 0 0.035" mass="0.5"/>',
        f'<geom class="steel" type="cylinder" size="{at_radius - 0.004:.4g} 0.0165" pos="0 0 0.0145"/>',
        '<geom class="motor" size="0.01 0.0015 0.0003" pos="0.045 0 0.039"/>',
    ]
    pairs = []
    for k, s in enumerate(_list_switches(axis)):
        middle, half, z = math.radians((s.low + s.high) / 2), math.radians((s.high - s.low) / 2), 0.002 + 0.004 * k
        sag = at_radius * (1 - math.cos(half))
        deep, where, wide = 0.004 + sag / 2, at_radius - sag / 2, at_radius * math.sin(half) - BEAM_RADIUS_M
        frame.append(f'<geom name="{name}_{s.name}_beam" class="beam" pos="{_place_on_circle(at_radius, middle, z)}"/>')
        frame += _build_post(post_radius, at_radius + 0.005, middle, z)
        moving.append(
            f'<geom name="{name}_{s.name}_vane" size="{deep:.6g} {wide:.6g} 0.0005" pos="{where:.6g} 0 {z:.4g}" '
            f'rgba="{s.colour}"/>'
        )
        pairs.append(_make_pair(axis, s))
    if not axis.endless:
        touch = 2 * math.asin(BUMPER_RADIUS_M / at_radius)  # rad between two balls that touch
        moving.append(f'<geom name="{name}_pin" class="bumper" pos="{at_radius:.6g} 0 0.026"/>')
        for side, sign in (("plus", 1), ("minus", -1)):
            angle = sign * (math.radians(_compute_stop_distance(axis)) + touch)
            place = _place_on_circle(at_radius, angle, 0.026)
            frame.append(f'<geom name="{name}_bumper_{side}" class="bumper" pos="{place}"/>')
            frame += _build_post(post_radius, at_radius, angle, 0.026)
            pairs.append(f'<pair class="stop" geom1="{name}_pin" geom2="{name}_bumper_{side}"/>')
    return _AxisParts(frame, moving, pairs)


def _build_post(radius: float, inner_radius: float, angle: float, height: float) -> list[str]:
    """Return the lines of a post on the base of a table, with an arm inwards that holds a switch or a bumper.

    Args:
        radius: Distance of the post from the axis of the table, m.
        inner_radius: Distance of the end of the arm, m.
        angle: Angle at which the post stands, rad.
        height: Height of the arm, m.
    """
    foot, top = _place_on_circle(radius, angle, BASE_TOP_M), _place_on_circle(radius, angle, height)
    return [
        f'<geom class="post" fromto="{foot} {top}"/>',
        f'<geom class="post" fromto="{top} {_place_on_circle(inner_radius, angle, height)}"/>',
    ]


def _place_on_circle(radius: float, angle: float, height: float) -> str:
    """Return the coordinates of a point, m, as text: at a radius and an angle, rad, about z."""
    return f"{radius * math.cos(angle):.6g} {radius * math.sin(angle):.6g} {height:.4g}"


def _make_pair(axis: NewAxis, switch: _SwitchGeom) -> str:
    """Return the MJCF line of the contact pair of a switch."""
    return f'<pair class="switch" geom1="{axis.name}_{switch.name}_vane" geom2="{axis.name}_{switch.name}_beam"/>'
