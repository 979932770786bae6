"""`new_model`: writes a commented MJCF model that keeps the naming contract. Each axis moves the next one.

    axes = [NewAxis.parse("x:slide:300mm"), NewAxis.parse("a:hinge:360deg")]
    text = new_model(axes)

A slide is a carriage on a screw of 10 mm lead, a hinge a table on a 10:1 gear. The travel of an axis is that between its end
limits. From minus to plus an axis has: hard stop, EL-, ORG (asserted at and below the origin), SD-, SD+, EL+, hard stop. A hinge of
360 degrees turns endlessly, and has the switch ORG only.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from stage.errors import ModelError

SCREW_LEAD_M = 0.010  # m a turn
GEAR_RATIO = 10  # turns of the motor for one of a table
ROTOR_INERTIA_KG_M2 = 5.4e-6  # kg m2, of a 17HS4401
MOTOR_NAME = "17HS4401"
STEEL, SCREW = 7850, 0.005  # kg/m3; m: the screw's radius
SLIDE_TRAVEL_RANGE_M = 0.01, 2.0  # m between the end limits
TURN, WIDEST, NARROWEST = (
    360.0,
    330.0,
    20.0,
)  # degrees; what lies between WIDEST and TURN leaves no room for the hard stops
TABLE_RADIUS_M = 0.060  # m: a table's radius
DIRECTIONS = {"x": "1 0 0 0", "y": "1 0 0 1", "z": "1 0 -1 0"}  # quaternions: how the x of a slide's own frame lies
INVERSE_DIRECTIONS = {"x": "1 0 0 0", "y": "1 0 0 -1", "z": "1 0 1 0"}
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


def new_model(axes: Sequence[NewAxis]) -> str:
    """Return the MJCF of a new model.

    Args:
        axes: Axes of the model; each moves the next one.

    Raises:
        ModelError: Two axes have one name, or there is none.
    """
    names = [a.name for a in axes]
    if not axes or len(set(names)) < len(names):
        raise ModelError(f"axes {', '.join(names) or 'none'}: one or more, each of a name of its own.")
    body, pairs = _build_bodies(list(axes), _choose_directions(axes))
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
        "    <!-- a switch: a light beam on the frame, a thin vane on what moves; seen from 10 mm before the touch, never felt -->",
        '    <default class="beam"><geom type="sphere" size="0.0005" rgba="1 0.3 0.2 1"/></default>',
        '    <default class="switch"><pair margin="-0.03" gap="0.04" condim="1"/></default>',
        "    <!-- a hard stop: rubber; a real contact -->",
        '    <default class="bumper"><geom type="sphere" size="0.005" rgba="0.1 0.1 0.1 1"/></default>',
        '    <default class="stop"><pair condim="1" solref="0.005 1" solimp="0.95 0.99 0.0005"/></default>',
        "  </default>",
        "  <worldbody>",
        '    <light pos="-0.5 -0.8 1.5" dir="0.3 0.5 -1"/>',
        '    <geom type="plane" size="2 2 0.1" pos="0 0 -0.02" rgba="0.5 0.52 0.55 1"/>',
        *(f"    {line}" for line in body),
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
    directions = {a.name: a.name.lower() for a in axes if a.kind == "slide" and a.name.lower() in DIRECTIONS}
    free = [d for d in DIRECTIONS if d not in directions.values()]
    for a in axes:
        if a.kind == "slide" and a.name not in directions:
            directions[a.name] = free.pop(0) if free else "x"
    return directions


def _build_bodies(axes: list[NewAxis], directions: dict[str, str]) -> tuple[list[str], list[str]]:
    """Return the MJCF lines of the bodies, each axis inside the body of the axis before, and the lines of all contact pairs."""
    a, rest = axes[0], axes[1:]
    parts = _build_slide(a) if a.kind == "slide" else _build_hinge(a)
    inner, pairs = _build_bodies(rest, directions) if rest else (
        ['<site name="work" pos="0 0 0.01" size="0.003" rgba="0.2 0.9 0.4 0.6"/>'], []
    )  # fmt: skip
    direction = directions.get(a.name, "x")
    above = "0 0 0.04" if direction != "z" else "0 0 0.1"  # a slide upwards carries the next in front of it, on an arm
    arm = '<geom size="0.02 0.02 0.035" pos="0 0 0.065" mass="0.1"/>'
    if direction != "x":
        inner = [f'<frame quat="{INVERSE_DIRECTIONS[direction]}">', *_indent(inner), "</frame>"]
    inner = [*([arm] if direction == "z" else []), f'<frame pos="{above}">', *_indent(inner), "</frame>"]
    reach = _find_stop(a) if a.kind == "slide" else math.radians(_find_stop(a))
    inertia = _compute_armature(a)
    friction = 'damping="60" frictionloss="4"' if a.kind == "slide" else 'damping="0.02" frictionloss="0.05"'
    axis = 'type="slide" axis="1 0 0"' if a.kind == "slide" else 'type="hinge" axis="0 0 1"'
    kind = "screw of 10 mm lead" if a.kind == "slide" else f"gear {GEAR_RATIO}:1"
    lines = [
        f"<!-- {a.name}: {a.kind}, {_describe_travel(a)}; {kind}; the frame -->",
        f'<frame quat="{DIRECTIONS[direction]}">',
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


def _find_stop(axis: NewAxis) -> float:
    """Return the distance of the hard stops from the middle, m (degrees)."""
    if axis.endless:
        return TURN / 2
    return axis.travel / 2 + (0.006 if axis.kind == "slide" else 3.0)


def _list_switches(axis: NewAxis) -> list[_SwitchGeom]:
    """Return the switches with their ranges."""
    green, red, amber = "0.12 0.66 0.32 1", "0.86 0.16 0.15 1", "0.98 0.68 0.08 1"
    if axis.endless:
        return [_SwitchGeom("org", -20.0, 0.0, green)]
    end, beyond = axis.travel / 2, _find_stop(axis) + (0.005 if axis.kind == "slide" else 2.0)
    return [
        _SwitchGeom("el_plus", end, beyond, red),
        _SwitchGeom("el_minus", -beyond, -end, red),
        _SwitchGeom("sd_plus", 0.87 * end, beyond, amber),
        _SwitchGeom("sd_minus", -beyond, -0.73 * end, amber),
        _SwitchGeom("org", -beyond, -0.8 * end, green),
    ]


def _build_slide(axis: NewAxis) -> _AxisParts:
    """Return the parts of a rail and its carriage, along x."""
    half, wide = 0.04, 0.045  # m: of the carriage; beams lie beside it
    rail = _find_stop(axis) + half + 0.02
    frame = [f'<geom class="frame" size="{rail:.6g} 0.03 0.008" pos="0 0 -0.01"/>']
    moving = [f'<geom name="{axis.name}_carriage" size="{half} 0.04 0.01" pos="0 0 0.02" mass="0.8"/>']
    pairs = []
    for k, s in enumerate(_list_switches(axis)):
        at, long = (s.low + s.high) / 2, (s.high - s.low) / 2
        y = wide + 0.004 * k
        frame.append(f'<geom name="{axis.name}_{s.name}_beam" class="beam" pos="{at:.6g} {y:.4g} 0.02"/>')
        moving.append(
            f'<geom name="{axis.name}_{s.name}_vane" size="{long - BEAM_RADIUS_M:.6g} 0.0005 0.005" '
            f'pos="0 {y:.4g} 0.02" rgba="{s.colour}"/>'
        )
        pairs.append(_make_pair(axis, s))
    for side, sign in (("plus", 1), ("minus", -1)):
        at = sign * (_find_stop(axis) + half + 0.005)
        frame.append(f'<geom name="{axis.name}_bumper_{side}" class="bumper" pos="{at:.6g} 0 0.02"/>')
        pairs.append(f'<pair class="stop" geom1="{axis.name}_carriage" geom2="{axis.name}_bumper_{side}"/>')
    return _AxisParts(frame, moving, pairs)


def _build_hinge(axis: NewAxis) -> _AxisParts:
    """Return the parts of a table that turns about z. Each switch and its flat vane have a height of their own."""
    name, at_radius = axis.name, TABLE_RADIUS_M - 0.008
    frame = [f'<geom class="frame" type="cylinder" size="{TABLE_RADIUS_M} 0.008" pos="0 0 -0.01"/>']
    moving = [f'<geom name="{name}_table" type="cylinder" size="{TABLE_RADIUS_M} 0.004" pos="0 0 0.035" mass="0.5"/>']
    pairs = []
    for k, s in enumerate(_list_switches(axis)):
        middle, half, z = math.radians((s.low + s.high) / 2), math.radians((s.high - s.low) / 2), 0.002 + 0.004 * k
        sag = at_radius * (1 - math.cos(half))
        deep, where, wide = 0.004 + sag / 2, at_radius - sag / 2, at_radius * math.sin(half) - BEAM_RADIUS_M
        frame.append(
            f'<geom name="{name}_{s.name}_beam" class="beam" pos="{at_radius * math.cos(middle):.6g} '
            f'{at_radius * math.sin(middle):.6g} {z:.4g}"/>'
        )
        moving.append(
            f'<geom name="{name}_{s.name}_vane" size="{deep:.6g} {wide:.6g} 0.0005" pos="{where:.6g} 0 {z:.4g}" '
            f'rgba="{s.colour}"/>'
        )
        pairs.append(_make_pair(axis, s))
    if not axis.endless:
        touch = 2 * math.asin(0.005 / at_radius)  # rad between two balls that touch
        moving.append(f'<geom name="{name}_pin" class="bumper" pos="{at_radius:.6g} 0 0.026"/>')
        for side, sign in (("plus", 1), ("minus", -1)):
            angle = sign * (math.radians(_find_stop(axis)) + touch)
            frame.append(
                f'<geom name="{name}_bumper_{side}" class="bumper" pos="{at_radius * math.cos(angle):.6g} '
                f'{at_radius * math.sin(angle):.6g} 0.026"/>'
            )
            pairs.append(f'<pair class="stop" geom1="{name}_pin" geom2="{name}_bumper_{side}"/>')
    return _AxisParts(frame, moving, pairs)


def _make_pair(axis: NewAxis, switch: _SwitchGeom) -> str:
    """Return the MJCF line of the contact pair of a switch."""
    return f'<pair class="switch" geom1="{axis.name}_{switch.name}_vane" geom2="{axis.name}_{switch.name}_beam"/>'
