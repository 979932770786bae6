"""Compiled measurement of the distance between a switch and its vane at thousands of positions of an axis."""

from __future__ import annotations

from stage.native import array_of, declare_address_call, exported

MAX_DISTANCE_M = 1e3
"""Distance that is given for all that is farther apart."""

_kinematics = declare_address_call(None, "i8", "i8")
_distance = declare_address_call("f8", "i8", "i8", "i4", "i4", "f8", "i8")


@exported(None, "i8", "i8", "i8", "i8", array_of("f8"), "i8", array_of("f8"), array_of("i4", 2), array_of("f8", 2))
def measure_distances(kinematics, distance, model, data, qpos, coordinate, positions, pairs, out):
    """Measure out[i, j], the distance of the geoms pairs[j] where coordinate k of `qpos`, the data's own, is positions[i], m.

    kinematics, distance, model, data: Addresses of MuJoCo's functions mj_kinematics and mj_geomDistance, and of their arguments.
    """
    for i in range(len(positions)):
        qpos[coordinate] = positions[i]
        _kinematics(kinematics, (model, data))
        for j in range(len(pairs)):
            out[i, j] = _distance(distance, (model, data, pairs[j, 0], pairs[j, 1], MAX_DISTANCE_M, 0))
