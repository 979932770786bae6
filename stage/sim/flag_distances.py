"""Compiled measurements at thousands of positions of an axis: distances of switches and vanes, and what contact sensors read."""

from __future__ import annotations

from stage.native import array_of, declare_address_call, exported

MAX_DISTANCE_M = 1e3
"""Largest distance that is measured; geoms that are farther apart get this distance."""

_call_mj_function = declare_address_call(None, "i8", "i8")  # one that takes a model and its data
_call_mj_geom_distance = declare_address_call("f8", "i8", "i8", "i4", "i4", "f8", "i8")


@exported(None, "i8", "i8", "i8", "i8", array_of("f8"), "i8", array_of("f8"), array_of("i4", 2), array_of("f8", 2))
def measure_distances(kinematics, distance, model, data, qpos, coordinate, positions, pairs, out):
    """Measure the distances of pairs of geoms at positions of one joint, m.

    Args:
        kinematics: Address of MuJoCo's function mj_kinematics.
        distance: Address of MuJoCo's function mj_geomDistance.
        model: Address of the mjModel.
        data: Address of the mjData.
        qpos: qpos of the mjData, whose element `coordinate` the function changes.
        coordinate: Index of the joint's coordinate in `qpos`.
        positions: Positions of the joint, (positions,).
        pairs: Ids of the geoms of each pair, (pairs, 2).
        out: Distances to fill, (positions, pairs), m.
    """
    for i in range(len(positions)):
        qpos[coordinate] = positions[i]
        _call_mj_function(kinematics, (model, data))
        for j in range(len(pairs)):
            out[i, j] = _call_mj_geom_distance(distance, (model, data, pairs[j, 0], pairs[j, 1], MAX_DISTANCE_M, 0))


@exported(
    "i8", array_of("i8"), "i8", "i8", array_of("f8"), "i8", array_of("f8"), array_of("f8"), "i8", "i8", array_of("f8")
)
def read_distances_while_found(functions, model, data, qpos, coordinate, positions, sensordata, found, distance, out):
    """Read the distance of a contact sensor at positions of one joint, up to the first at which it finds no contact.

    Args:
        functions: Addresses of MuJoCo's functions of (model, data) that compute the sensor, in their order.
        model: Address of the mjModel.
        data: Address of the mjData.
        qpos: qpos of the mjData, whose element `coordinate` the function changes.
        coordinate: Index of the joint's coordinate in `qpos`.
        positions: Positions of the joint, (positions,).
        sensordata: sensordata of the mjData.
        found: Index of the sensor's field `found` in `sensordata`.
        distance: Index of its field `dist`.
        out: Distances to fill, (positions,), m.

    Returns:
        Number of distances read.
    """
    for i in range(len(positions)):
        qpos[coordinate] = positions[i]
        for j in range(len(functions)):
            _call_mj_function(functions[j], (model, data))
        if not sensordata[found] > 0.0:
            return i
        out[i] = sensordata[distance]
    return len(positions)
