"""The MJCF naming contract, which says which joints, actuators and sensors make an axis; the package checks models against it.

Axis NAME is
    a joint NAME (slide or hinge) with a range,
    an actuator NAME on it: a <motor> for a stepper, whose ctrl is rotor torque in N m, or a <dcmotor> for a servo, whose ctrl is
        terminal voltage; gear is rotor radians per joint unit,
    five contact sensors NAME_el_plus, NAME_el_minus, NAME_sd_plus, NAME_sd_minus, NAME_org between a vane and a switch,
        each with data="found dist" and a force-free <pair margin="-0.03" gap="0.04">,
    or <custom><text name="NAME_unfitted" data="sd_plus sd_minus"/></custom> for the switches that it does not have.
<text name="NAME_motor" data="17HS4401"/> names the motor whose rotor inertia is in the joint's armature.
<text name="NAME_tandem" data="OTHER"/> names the other axes that drive the same load.
A stage exchanges the actuator for the kind that the axis' chip drives, see `fit_actuator`: any model takes any chip.
<numeric name="NAME_index" data="0.5"/> is the rotor angle of the encoder's index pulse (EZ), in turns from the rotor
angle at joint position 0; by default half a turn from where ORG trips, as an encoder is usually mounted.

    spec = open_spec("xyz")                         a name, a path, an MjSpec or an MjModel
    model, offset = compile_spec(spec, words)       with room for `words` float64 of state in userdata
    for axis in bind(model): ...                    ModelError lists everything that is missing

docs/models.md explains the contract and holds a complete small model.
"""

from stage.sim.engine_records import SWITCH_PINS
from stage.sim.plant.model_preparation import (
    compile_spec,
    discard_visuals,
    find_axis_names,
    find_motor_names,
    fit_actuator,
    list_model_names,
    open_shared_spec,
    open_spec,
    read_dc_constants,
    reserve_fitted_values,
    view_fitted_values,
)  # fmt: skip
from stage.sim.plant.naming_contract import PlantAxis, bind_axes, format_axes
from stage.sim.plant.switch_finder import Switch

__all__ = [
    "SWITCH_PINS", "PlantAxis", "Switch", "bind_axes", "compile_spec", "discard_visuals", "find_axis_names",
    "find_motor_names", "fit_actuator", "format_axes", "list_model_names", "open_shared_spec", "open_spec",
    "read_dc_constants", "reserve_fitted_values", "view_fitted_values",
]  # fmt: skip
