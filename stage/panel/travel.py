"""Whether the carriages are where their machine lets them be. No page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco

if TYPE_CHECKING:
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

MOST = 2.0  # times what the motor can push at its most


def strongest_push(axis: Axis) -> float:
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
