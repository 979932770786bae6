"""`reduce_model`: the model of a stage with one axis, in which all other axes are locked.

Tasks that move one axis use it if their setting `reduced` is true. MuJoCo then computes one degree of freedom instead of all, and
no contacts of switches and stops that cannot move. The axis itself, its switches and stops, the masses that it carries and joints
without a motor, such as a mast, stay as they are.
"""

from __future__ import annotations

from typing import Any

import mujoco

from stage.errors import ArgumentError, ModelError, unknown_name_error
from stage.sim import plant


def reduce_model(model: Any, axis: str) -> mujoco.MjSpec:
    """Return a model with one axis; the others are locked in their reference position.

    Args:
        model: Model as `Stage` takes it, except for an MjModel.
        axis: Name of the axis that remains.

    Raises:
        ArgumentError: The model is an MjModel, does not have the axis, or has another axis that drives the same load.
        ModelError: Another part of the model needs a locked axis.
    """
    spec = plant.open_spec(model)
    if not isinstance(spec, mujoco.MjSpec):
        raise ArgumentError(
            "reduced=True: give the model by its name, as a file or as an MjSpec; an MjModel stays as it is."
        )
    names = plant.find_axis_names(spec)
    if axis not in names:
        raise unknown_name_error("axis", axis, names)
    if any(
        t.name.endswith("_tandem") and axis in (t.name.removesuffix("_tandem"), *t.data.split()) for t in spec.texts
    ):
        raise ArgumentError(f"reduced=True: axis {axis} drives its load together with another one. Use reduced=False.")
    for name in names:
        if name != axis:
            spec.delete(spec.actuator(name))
            spec.delete(spec.joint(name))
    for key in list(spec.keys):  # their positions are those of all joints
        spec.delete(key)
    try:
        compiled = spec.compile()
    except ValueError as error:
        raise ModelError(
            f"reduced=True: the model needs an axis other than {axis}: {error} Use reduced=False."
        ) from error
    _discard_fixed_contacts(spec, compiled)
    return spec


def _discard_fixed_contacts(spec: mujoco.MjSpec, compiled: mujoco.MjModel) -> None:
    """Discard pairs, and contact sensors, of geoms that cannot move relative to each other."""
    welded = {geom.name: compiled.body_weldid[compiled.geom(geom.name).bodyid[0]] for geom in spec.geoms if geom.name}
    for pair in list(spec.pairs):
        if welded[pair.geomname1] == welded[pair.geomname2]:
            spec.delete(pair)
    for sensor in list(spec.sensors):
        if sensor.type == mujoco.mjtSensor.mjSENS_CONTACT and welded.get(sensor.objname) == welded.get(
            sensor.refname, -1
        ):
            spec.delete(sensor)
