"""Points of a model that users name: the body that carries a payload, and the site or body at which a move is judged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stage.errors import unknown_name_error

if TYPE_CHECKING:
    from stage.sim.stage import Stage


def find_payload_body(stage: Stage, axis: str, name: str | None) -> str:
    """Find the body that carries the payload.

    Args:
        stage: Stage of the model.
        axis: Name of the axis that moves.
        name: Name of a body, or of a site on it. None: the body of the site "work", or in a model without it the body that the
            axis moves.

    Returns:
        Name of the body.

    Raises:
        ArgumentError: The model has no body or site with this name.
    """
    model = stage.model
    sites = {model.site(k).name: model.site(k).bodyid[0] for k in range(model.nsite)}
    bodies = {model.body(k).name: k for k in range(1, model.nbody)}
    if name is None:
        body = sites.get("work", model.jnt_bodyid[stage.axes[axis].joint])
    elif name not in bodies and name not in sites:
        raise unknown_name_error("body or site of payload_on", name, filter(None, {**bodies, **sites}))
    else:
        body = bodies.get(name, sites.get(name))
    return str(model.body(int(body)).name)


JUDGED_SITES = ("tool", "camera", "work")
"""Names of the sites whose vibration is observed by default, in order of preference."""


def find_judged_point(stage: Stage, axis: str, name: str | None) -> tuple[str, int]:
    """Find the point of a model whose vibration is observed after a move.

    Args:
        stage: Stage of the model.
        axis: Name of the axis that moves.
        name: Name of a site or body that the axis carries. None: of the sites JUDGED_SITES that the axis carries, the first
            that can swing (because a joint without a motor is between the site and the axis), or else the first of them. In a
            model with none of them, the axis itself.

    Returns:
        Name of the point, and its number for `Program.measure`; ("", 0) for the axis itself.

    Raises:
        ArgumentError: The axis carries no site or body with this name.
    """
    model, home = stage.model, int(stage.model.jnt_bodyid[stage.axes[axis].joint])
    moved = {a.joint for a in stage.axes.values()}

    def list_bodies_up_to_axis(body: int) -> list[int] | None:
        """Return the bodies from `body` up to the one that the axis moves, or None if the axis does not carry `body`."""
        bodies = [body]
        while bodies[-1] and bodies[-1] != home:
            bodies.append(int(model.body_parentid[bodies[-1]]))
        return bodies if bodies[-1] == home else None

    candidates = {
        f"site {model.site(k).name}": (1 + k, list_bodies_up_to_axis(int(model.site_bodyid[k])))
        for k in range(model.nsite)
    }
    candidates |= {f"body {model.body(k).name}": (-k, list_bodies_up_to_axis(k)) for k in range(1, model.nbody)}
    carried = {
        name: (point, bodies) for name, (point, bodies) in candidates.items() if bodies is not None and name.split()[1:]
    }
    if name is not None:
        for kind in ("site", "body"):
            if f"{kind} {name}" in carried:
                return name, carried[f"{kind} {name}"][0]
        raise unknown_name_error(
            f"site or body of judge_at that axis {axis} carries,", name, {name.split(" ", 1)[1] for name in carried}
        )
    judged_sites = {name: carried[f"site {name}"] for name in JUDGED_SITES if f"site {name}" in carried}
    for name, (point, bodies) in judged_sites.items():
        joints = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in (bodies or [])]
        if not moved.issuperset(joints):
            return name, point
    return next(((name, point) for name, (point, _) in judged_sites.items()), ("", 0))
