"""The shapes that a page shows of a body have the sizes, places and colors of its geoms."""

import mujoco
import numpy as np
import pytest

pytest.importorskip("nicegui")
from stage.panel.stage_scene import list_shapes, list_visible_geoms, mesh_to_stl
from stage.sim import plant

BODY = """<mujoco><asset><mesh name="m" vertex="0 0 0 3 0 0 0 3 0 0 0 3"/></asset><statistic extent="2"/>
<worldbody><geom type="plane" size="1 1 1"/><body>{}</body></worldbody></mujoco>"""


def compile_body(*geoms):
    return mujoco.MjModel.from_xml_string(BODY.format("".join(f"<geom {geom}/>" for geom in geoms)))


def corners_of(shape):
    """Sample the surface of one of three.js' shapes, as its manual defines them, in the frame of the body."""
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    if shape.kind == "box":
        points = np.stack(np.meshgrid(*([-s / 2, s / 2] for s in shape.sizes)), axis=-1).reshape(-1, 3)
    elif shape.kind == "cylinder":  # its axis is y
        top, bottom, height, _ = shape.sizes
        points = np.concatenate([np.stack([r * np.cos(angle), np.full(64, y), r * np.sin(angle)], axis=1)
                                 for r, y in ((top, height / 2), (bottom, -height / 2))])  # fmt: skip
    else:
        points = shape.sizes[0] * np.concatenate([np.eye(3), -np.eye(3)])
    return points * shape.scale @ shape.rotation.T + shape.position


@pytest.mark.parametrize(
    ("geom", "low", "high"),
    [
        ('type="box" size=".1 .2 .3" pos="1 2 3"', (0.9, 1.8, 2.7), (1.1, 2.2, 3.3)),
        ('type="sphere" size=".4"', (-0.4, -0.4, -0.4), (0.4, 0.4, 0.4)),
        ('type="ellipsoid" size=".1 .2 .3" euler="0 90 0"', (-0.3, -0.2, -0.1), (0.3, 0.2, 0.1)),
        ('type="cylinder" size=".1 .5" euler="0 90 0"', (-0.5, -0.1, -0.1), (0.5, 0.1, 0.1)),
        ('type="capsule" size=".1 .5" pos="0 0 -1"', (-0.1, -0.1, -1.6), (0.1, 0.1, -0.4)),
        ('type="capsule" size=".1 .5" euler="0 90 0"', (-0.6, -0.1, -0.1), (0.6, 0.1, 0.1)),
        ('type="plane" size="1 3 1" euler="90 0 0"', (-1, 0, -3), (1, 0.002, 3)),
        ('type="plane" size="0 9e9 1"', (-4, -4, -0.002), (4, 4, 0)),  # without an end: to twice the extent
    ],
)
def test_a_geom_is_drawn_with_its_size_and_place(geom, low, high):
    model = compile_body(geom)
    (number,) = list_visible_geoms(model, 1)
    points = np.concatenate([corners_of(shape) for shape in list_shapes(model, number)])
    assert points.min(axis=0) == pytest.approx(low, abs=1e-6)
    assert points.max(axis=0) == pytest.approx(high, abs=1e-6)


def test_what_is_hidden_or_transparent_is_not_drawn_and_the_floor_neither():
    model = compile_body('type="box" size="9 9 9" group="3"', 'type="box" size="1 1 1" rgba="1 1 1 0"', 'size=".1"')
    assert [len(list_visible_geoms(model, body)) for body in (0, 1)] == [0, 1]


def test_a_mesh_is_served_as_stl_whose_triangles_face_outwards():
    model = compile_body('type="mesh" mesh="m"')
    (shape,) = list_shapes(model, list_visible_geoms(model, 1)[0])
    assert (shape.kind, shape.sizes) == ("stl", ("/mesh/0.stl",))
    blob = mesh_to_stl(model, 0)
    assert int.from_bytes(blob[80:84], "little") == 4, "a tetrahedron has 4 triangles"
    assert len(blob) == 84 + 4 * 50
    for k in range(4):
        values = np.frombuffer(blob, "<f4", 12, 84 + 50 * k)
        normal, (a, b, c) = values[:3], values[3:].reshape(3, 3)
        assert normal == pytest.approx(np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a)), abs=1e-6)
        assert normal @ a > 0, "MuJoCo centers a mesh at its center of mass, which lies within"
    placed = np.frombuffer(blob, np.dtype([("_", "f4", 3), ("corners", "f4", (3, 3)), ("__", "u2")]), 4, 84)["corners"]
    points = placed.reshape(-1, 3) @ shape.rotation.T + shape.position
    assert points.min(axis=0) == pytest.approx([0, 0, 0], abs=1e-6)
    assert points.max(axis=0) == pytest.approx([3, 3, 3], abs=1e-6)


def test_the_page_draws_each_body_in_its_colors(served):
    from nicegui import ui

    from stage.panel.stage_scene import add_body

    visitor = served.visit()
    model = compile_body('type="box" size="1 1 1" rgba="1 0 .2 .5"')

    def draw():
        with visitor.client, ui.scene() as scene:
            add_body(scene, model, 1)
        return scene

    group, box = visitor.within(draw).objects.values()
    assert (box.color, box.opacity, box.parent) == ("#ff0033", pytest.approx(128 / 255), group)
    served.leave()


def test_the_shipped_models_have_bodies_to_show():
    model = plant.open_spec("xyz").compile()
    assert all(list_visible_geoms(model, model.body(axis).id) for axis in "xyz")
