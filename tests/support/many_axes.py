"""A model of many axes: slides beside each other, no switches."""

import mujoco


def rail_model(axes: int) -> mujoco.MjSpec:
    """Axes a0, a1 ..., screws of 10 mm lead."""
    bodies = "".join(
        f'<body name="a{k}" pos="0 {k} 0"><joint name="a{k}" type="slide" axis="1 0 0" range="-.2 .2" limited="false" damping="60" '
        'armature="3.7"/><geom type="box" size=".02 .02 .02" mass=".5"/></body>'
        for k in range(axes)
    )
    motors = "".join(f'<motor name="a{k}" joint="a{k}" gear="628.3185307"/>' for k in range(axes))
    none = "".join(f'<text name="a{k}_unfitted" data="el_plus el_minus sd_plus sd_minus org"/>' for k in range(axes))
    return mujoco.MjSpec.from_string(
        '<mujoco><option timestep="0.00025" integrator="implicitfast"/>'
        f"<worldbody>{bodies}</worldbody><actuator>{motors}</actuator><custom>{none}</custom></mujoco>"
    )
