"""The stage in 3D on the page: the geoms of a model as shapes of the browser's scene, in groups that move with their bodies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
from nicegui import ui

from stage.panel.browser_updates import BrowserUpdates
from stage.recording.rerun_geoms import find_color, find_floor, find_triangles, is_visible

if TYPE_CHECKING:
    from stage.panel.server import Panel

FACETS = 32  # of a full circle
PLANE_THICKNESS_M = 0.002
POLLS_PER_S = 60  # a second, at most, of the browser's scene: whether there is something to draw, see poses.js
_KIND = mujoco.mjtGeom
Y_TO_Z_ROTATION = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Rotation from a cylinder of the browser's, which stands on y, to one of MuJoCo's, which stands on z."""


class Shape(NamedTuple):
    """Shape of a browser's 3D scene, in the frame of its body.

    Attributes:
        kind: Method of `ui.scene` that creates the shape: box, cylinder, sphere, stl.
        sizes: Arguments of that method.
        position: Position of the shape's center, m, shape (3,).
        rotation: Rotation matrix, shape (3, 3).
        scale: Scale factors along the shape's own axes.
    """

    kind: str
    sizes: tuple
    position: np.ndarray
    rotation: np.ndarray
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


def list_visible_geoms(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the indices of the geoms of a body that the page shows.

    Args:
        model: The model.
        body: Index of the body.
    """
    ground = find_floor(model)
    geoms = np.flatnonzero(model.geom_bodyid == body).tolist()
    return [g for g in geoms if g != ground and is_visible(model, g)]


def list_shapes(model: mujoco.MjModel, geom: int) -> Iterator[Shape]:
    """Yield the shapes that together show a geom; none for a geom type that the page does not show.

    Args:
        model: The model.
        geom: Index of the geom.
    """
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    rotation, place = matrix.reshape(3, 3), model.geom_pos[geom]
    kind, size = _KIND(int(model.geom_type[geom])), model.geom_size[geom].tolist()
    if kind == _KIND.mjGEOM_BOX:
        yield Shape("box", tuple(2 * s for s in size), place, rotation)
    elif kind == _KIND.mjGEOM_PLANE:
        limit = 2 * float(model.stat.extent)
        sides = [2 * (s if 0 < s <= limit else limit) for s in size[:2]]
        below = rotation @ [0, 0, -PLANE_THICKNESS_M / 2]
        yield Shape("box", (*sides, PLANE_THICKNESS_M), place + below, rotation)
    elif kind in (_KIND.mjGEOM_SPHERE, _KIND.mjGEOM_ELLIPSOID):
        scale = tuple(size) if kind == _KIND.mjGEOM_ELLIPSOID else (size[0],) * 3
        yield Shape("sphere", (1.0, FACETS, FACETS // 2), place, rotation, scale)
    elif kind in (_KIND.mjGEOM_CYLINDER, _KIND.mjGEOM_CAPSULE):
        yield Shape("cylinder", (size[0], size[0], 2 * size[1], FACETS), place, rotation @ Y_TO_Z_ROTATION)
        for end in (-1, 1) if kind == _KIND.mjGEOM_CAPSULE else ():
            yield Shape("sphere", (size[0], FACETS, FACETS // 2), place + rotation @ [0, 0, end * size[1]], rotation)
    elif kind == _KIND.mjGEOM_MESH:
        yield Shape("stl", (f"/mesh/{int(model.geom_dataid[geom])}.stl",), place, rotation)


def mesh_to_stl(model: mujoco.MjModel, mesh: int) -> bytes:
    """Convert a mesh to a binary STL file, whose triangles browsers shade flat.

    Args:
        model: The model.
        mesh: Index of the mesh.
    """
    triangles, normals = find_triangles(model, mesh)
    rows = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
    rows["normal"], rows["corners"] = normals, triangles
    return bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()


def add_body(scene: ui.scene, model: mujoco.MjModel, body: int) -> ui.scene.group:
    """Add the shapes of a body to a scene, and return their group."""
    geoms = list_visible_geoms(model, body)
    with scene.group() as group:
        for geom in geoms:
            red, green, blue, alpha = find_color(model, geom)
            for shape in list_shapes(model, geom):
                item = getattr(scene, shape.kind)(*shape.sizes)
                item.material(f"#{red:02x}{green:02x}{blue:02x}", alpha / 255)
                item.move(*shape.position.tolist()).rotate_R(shape.rotation.tolist()).scale(*shape.scale)
    return group


VIEWS = {"corner": (0.58, -0.86, 0.58), "front": (0, -1.2, 0.12), "side": (1.2, 0, 0.12), "top": (0, -0.01, 1.3)}
"""Places of the camera, from the center of the model, in its extents."""


class BodyPoses(ui.element, component="poses.js"):
    """Page element that moves the bodies of a scene to new poses."""

    def __init__(self, scene: ui.scene):
        super().__init__()
        self._props["scene"] = scene.id


def build_scene(panel: Panel, updates: BrowserUpdates) -> None:
    """Build the 3D view of the panel's stage."""
    session = panel.session
    model = session.stage.model
    data = mujoco.MjData(model)  # this page's own: the stage's belongs to its thread
    extent, (cx, cy, cz) = float(model.stat.extent), model.stat.center
    camera = ui.scene.perspective_camera(fov=40, near=extent / 100, far=extent * 20)
    with ui.element("div").classes("scene-box"):
        with (
            ui.scene(grid=False, camera=camera, background_color="#20242b", fps=POLLS_PER_S)
            .classes("scene")
            .props("data-test=scene") as scene
        ):
            groups = {body: add_body(scene, model, body) for body in range(model.nbody)}

        def move_camera(name: str, duration: float = 0.4) -> None:
            x, y, z = (extent * factor for factor in VIEWS[name])
            scene.move_camera(cx + x, cy + y, cz + z, cx, cy, cz, 0, 0, 1, duration=duration)

        with ui.button_group().props("flat").classes("view"):
            for name in VIEWS:
                ui.button(name, on_click=lambda name=name: move_camera(name)).props(
                    f"dense flat no-caps color=white size=sm data-test=view-{name}"
                )
    move_camera("corner", 0)
    drawn_qpos = np.full(model.nq, np.nan)
    poses_sent: dict[int, list] = {}

    def collect_poses() -> list | None:
        view = session.view
        if np.array_equal(view.qpos, drawn_qpos):
            return None
        drawn_qpos[:] = view.qpos
        data.qpos[:] = view.qpos
        mujoco.mj_kinematics(model, data)
        poses = []
        for body, group in groups.items():
            pose = [data.xpos[body].round(6).tolist(), data.xmat[body].reshape(3, 3).round(6).tolist()]
            if poses_sent.get(body) != pose:
                poses_sent[body] = pose
                poses.append([group.id, *pose])
        return [poses] if poses else None

    updates.call_method_repeatedly(BodyPoses(scene), "move", collect_poses)
