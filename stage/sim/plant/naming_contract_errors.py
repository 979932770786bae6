"""Errors of a model that breaks the naming contract, collected, with the MJCF lines that repair them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import mujoco

from stage.errors import ModelError, find_similar_names

MARGIN, GAP = -0.03, 0.04  # of the pairs that the errors propose


class ModelProblems:
    """Collection of everything in one model that breaks the naming contract: descriptions, and MJCF lines to add or change."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.lines: list[str] = []

    def add_problem(self, axis: str, text: str, line: str | None = None) -> None:
        """Add a problem.

        Args:
            axis: Name of the axis.
            text: What is wrong.
            line: Line that would repair it.
        """
        self.texts.append(f"axis {axis}: {text}")
        if line and line not in self.lines:
            self.lines.append(line)

    def raise_if_any(self) -> None:
        """Raise one ModelError that lists all problems, if there are any."""
        if not self.texts:
            return
        lines = "".join(f"\n    {line}" for line in self.lines)
        raise ModelError(
            "the model does not keep the naming contract (docs/models.md):\n  - "
            + "\n  - ".join(self.texts)
            + (f"\n  lines to add or change:{lines}" if lines else ""),
            self.lines,
        )


def find_nearest_name(name: str, known: Iterable[str]) -> list[str]:
    """Return the known name that is most similar to `name` in a list, empty if none is similar."""
    return find_similar_names(name, filter(None, known), 0.6)[:1]


def suggest_name(model: Any, kind: Any, count: int, name: str, axes: Sequence[str]) -> str:
    """Suggest a similar name of the model for a missing name, as a clause for an error; "" if no name is similar."""
    known = (mujoco.mj_id2name(model, kind, k) or "" for k in range(count))
    near = find_nearest_name(name, (k for k in known if k not in axes))
    return f" (there is {near[0]!r}: a slip?)" if near else ""


def format_actuator_line(name: str) -> str:
    """Return the MJCF line of an axis' motor."""
    return f'<motor name="{name}" joint="{name}" gear="628.3185307"/>'


def format_joint_line(name: str, hinge: bool = False) -> str:
    """Return the MJCF line of an axis' joint.

    Args:
        name: Name of the axis.
        hinge: True for a hinge, else a slide.
    """
    kind = 'hinge" axis="0 0 1" range="-3.1416 3.1416' if hinge else 'slide" axis="1 0 0" range="-0.15 0.15'
    return f'<joint name="{name}" type="{kind}" limited="false"/>'


def format_sensor_line(axis: str, pin: str, vane: str = "", switch: str = "") -> str:
    """Return the MJCF line of a switch's sensor.

    Args:
        axis: Name of the axis.
        pin: Pin of the switch.
        vane: Geom of the vane; default: a name by the axis and the pin.
        switch: Geom of the switch; default: a name by the axis and the pin.
    """
    vane, switch = vane or f"{axis}_{pin}_vane", switch or f"{axis}_{pin}_switch"
    return f'<contact name="{axis}_{pin}" geom1="{vane}" geom2="{switch}" num="1" reduce="mindist" data="found dist"/>'


def format_pair_line(geom1: str, geom2: str) -> str:
    """Return the MJCF line of a pair of geoms that is detected and exerts no force.

    Args:
        geom1: Geom of the vane.
        geom2: Geom of the switch.
    """
    return f'<pair geom1="{geom1}" geom2="{geom2}" margin="{MARGIN}" gap="{GAP}"/>'
