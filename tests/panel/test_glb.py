"""The bodies that a browser is shown are those of the model."""

import json
import struct

import mujoco
import numpy as np
import pytest

from stage.panel.glb import bodies

SHAPES = """<mujoco><worldbody><body name="b"><freejoint/>
<geom type="box" size=".1 .2 .3" pos="1 2 3" rgba="1 0 0 .5"/><geom type="sphere" size=".4"/>
<geom type="cylinder" size=".1 .5" euler="0 90 0" rgba="0 1 0 1"/><geom type="capsule" size=".1 .5" pos="0 0 -1" rgba="0 0 1 1"/>
<geom type="ellipsoid" size=".1 .2 .3" rgba="1 1 0 1"/><geom type="box" size="9 9 9" group="3"/></body></worldbody></mujoco>"""


def read(blob):
    """Header and binary part of a binary glTF."""
    magic, version, length = struct.unpack_from("<4sII", blob)
    assert (magic, version, length) == (b"glTF", 2, len(blob))
    n, kind = struct.unpack_from("<I4s", blob, 12)
    assert kind == b"JSON"
    assert n % 4 == 0
    return json.loads(blob[20 : 20 + n]), blob[28 + n :]


def corners(scene, binary, accessor):
    a = scene["accessors"][accessor]
    view = scene["bufferViews"][a["bufferView"]]
    kind, size = (np.float32, 3) if a["type"] == "VEC3" else (np.uint32, 1)
    return np.frombuffer(binary, kind, a["count"] * size, view["byteOffset"]).reshape(-1, size)


def test_each_visible_geom_is_there_with_its_size_place_and_colour():
    model = mujoco.MjModel.from_xml_string(SHAPES)
    ((body, blob),) = bodies(model)
    assert body == 1
    scene, binary = read(blob)
    assert len(scene["meshes"]) == 5, "what is of a hidden group is left out"
    sizes = [([0.9, 1.8, 2.7], [1.1, 2.2, 3.3]), ([-0.4] * 3, [0.4] * 3), ([-0.5, -0.1, -0.1], [0.5, 0.1, 0.1]),
             ([-0.1, -0.1, -1.6], [0.1, 0.1, -0.4]), ([-0.1, -0.2, -0.3], [0.1, 0.2, 0.3])]  # fmt: skip
    for mesh, (low, high) in zip(scene["meshes"], sizes, strict=True):
        primitive = mesh["primitives"][0]
        place = corners(scene, binary, primitive["attributes"]["POSITION"])
        assert place.min(axis=0) == pytest.approx(low, abs=5e-3)
        assert place.max(axis=0) == pytest.approx(high, abs=5e-3)
        normal = corners(scene, binary, primitive["attributes"]["NORMAL"])
        assert np.linalg.norm(normal, axis=1) == pytest.approx(1, abs=1e-5)
        index = corners(scene, binary, primitive["indices"])[:, 0]
        triangles = place[index.reshape(-1, 3)]
        outward = np.einsum("ij,ij->i", np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]),
                            normal[index.reshape(-1, 3)].sum(axis=1))  # fmt: skip
        assert (outward > -1e-9).all(), "triangles face outwards"
        volume = np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6
        assert volume > 0
    look = scene["materials"][0]
    assert look["pbrMetallicRoughness"]["baseColorFactor"] == [1, 0, 0, pytest.approx(0.5, abs=0.01)]
    assert look["alphaMode"] == "BLEND"
    assert "alphaMode" not in scene["materials"][1]


def test_geoms_of_one_colour_are_one_mesh():
    model = mujoco.MjModel.from_xml_string(SHAPES.replace("0 0 1 1", "0 1 0 1"))
    ((_, blob),) = bodies(model)
    scene, binary = read(blob)
    assert len(scene["meshes"]) == 4
    primitive = scene["meshes"][2]["primitives"][0]
    place = corners(scene, binary, primitive["attributes"]["POSITION"])
    assert place.min(axis=0) == pytest.approx([-0.5, -0.1, -1.6], abs=5e-3)
    assert place.max(axis=0) == pytest.approx([0.5, 0.1, 0.1], abs=5e-3)
    index = corners(scene, binary, primitive["indices"])[:, 0]
    assert set(index.tolist()) == set(range(len(place))), "every corner is one of a triangle"


def test_the_shipped_models_have_bodies_to_show():
    from stage.sim import plant

    model = plant.open_spec("xyz").compile()
    assert {model.body(body).name for body, _ in bodies(model)} >= {"x", "y", "z"}


@pytest.mark.parametrize("size", ["0 0 .1", "9e9 9e9 .1"])
def test_a_plane_without_an_end_is_drawn_to_twice_the_extent(size):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><statistic extent="2"/><worldbody><geom type="plane" size="1 1 1"/>'
        f'<body name="wall" euler="90 0 0"><geom type="plane" size="{size}"/></body></worldbody></mujoco>'
    )
    ((_, blob),) = [found for found in bodies(model) if found[0] == 1]
    scene, binary = read(blob)
    positions = corners(scene, binary, scene["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
    assert np.ptp(positions, axis=0) == pytest.approx([8.0, 8.0, 0.002], abs=1e-6)
