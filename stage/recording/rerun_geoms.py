"""The MJCF geoms of a model as rerun archetypes, grouped by body: static shapes under moving transforms."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from stage.recording.lazy_rerun import rr

HIDDEN_GROUP = 3  # geoms of this group and above are for computing only
PLANE_THICKNESS_M = 0.002  # thickness, m

_KIND = mujoco.mjtGeom


def is_visible(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether a geom is meant to be seen (its group is below HIDDEN_GROUP, and it is not transparent).

    Args:
        model: The model.
        geom: Index of the geom.
    """
    material = model.geom_matid[geom]
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return bool(model.geom_group[geom] < HIDDEN_GROUP and round(float(rgba[3]) * 255) > 0)


def find_color(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return the color of a geom. A material counts instead of the geom's own color, with the mean color of its texture.

    Args:
        model: The model.
        geom: Index of the geom.

    Returns:
        RGBA, 0 to 255, (4,) uint8.
    """
    material = model.geom_matid[geom]
    rgba = model.geom_rgba[geom]
    if material >= 0:
        rgba = model.mat_rgba[material]
        texture = model.mat_texid[material][int(mujoco.mjtTextureRole.mjTEXROLE_RGB)]
        if texture >= 0:
            rgba = rgba * np.append(_compute_mean_texture(model, texture), 1.0)
    return (np.clip(rgba, 0, 1) * 255).round().astype(np.uint8)


def _compute_mean_texture(model: mujoco.MjModel, texture: int) -> np.ndarray:
    channels = model.tex_nchannel[texture]
    begin = model.tex_adr[texture]
    size = model.tex_width[texture] * model.tex_height[texture] * channels
    data = model.tex_data[begin : begin + size]
    return np.array([data[k::channels].mean() for k in range(3)]) / 255


def find_floor(model: mujoco.MjModel) -> int | None:
    """Return the first horizontal plane of the world, or None.

    A grid of lines stands for this plane, so that it hides nothing from a camera below it.
    """
    planes = model.geom_type == int(_KIND.mjGEOM_PLANE)  # with the name itself numpy compares objects, one by one
    for g in np.flatnonzero(planes & (model.geom_bodyid == 0)).tolist():
        if abs(model.geom_quat[g][0]) > 1 - 1e-9:
            return g
    return None


def list_shapes(model: mujoco.MjModel, body: int) -> Iterator[tuple[str, Any]]:
    """Yield the names and rerun archetypes of the geoms of a body, in the frame of the body.

    Args:
        model: The model.
        body: Index of the body.
    """
    kinds: dict[int, list[int]] = {}
    grid = find_floor(model)
    for g in np.flatnonzero(model.geom_bodyid == body).tolist():
        if g != grid and is_visible(model, g):
            kinds.setdefault(int(model.geom_type[g]), []).append(g)
    for kind, geoms in kinds.items():
        if kind in _ARCHETYPE_MAKERS:
            name, make = _ARCHETYPE_MAKERS[kind]
            yield name, make(model, geoms)
        elif kind == _KIND.mjGEOM_MESH:
            for g in geoms:
                yield f"mesh_{model.geom(g).name or g}", _make_mesh(model, g)


def _get_common_arguments(model: mujoco.MjModel, geoms: list[int]) -> dict[str, Any]:
    """Return rotations, colors and fill mode of geoms as arguments of an archetype."""
    quats = np.roll(model.geom_quat[geoms], -1, axis=1)  # rerun's order is x y z w
    return {"quaternions": quats, "colors": np.array([find_color(model, g) for g in geoms]), "fill_mode": "solid"}


def _make_boxes(model: mujoco.MjModel, geoms: list[int]) -> Any:
    common = _get_common_arguments(model, geoms)
    return rr.Boxes3D(half_sizes=model.geom_size[geoms], centers=model.geom_pos[geoms], **common)


def _make_planes(model: mujoco.MjModel, geoms: list[int]) -> Any:
    """Return flat boxes whose tops are the planes. An infinite plane ends at twice the extent of the model."""
    limit = 2 * float(model.stat.extent)
    half = model.geom_size[geoms].copy()
    half[(half <= 0) | (half > limit)] = limit
    half[:, 2] = PLANE_THICKNESS_M
    down = np.array([rotate_vector(model.geom_quat[g], [0, 0, -PLANE_THICKNESS_M]) for g in geoms])
    common = _get_common_arguments(model, geoms)
    return rr.Boxes3D(half_sizes=half, centers=model.geom_pos[geoms] + down, **common)


def _make_ellipsoids(model: mujoco.MjModel, geoms: list[int]) -> Any:
    half = np.array([s if model.geom_type[g] == _KIND.mjGEOM_ELLIPSOID else [s[0]] * 3
                     for g, s in zip(geoms, model.geom_size[geoms], strict=True)])  # fmt: skip
    common = _get_common_arguments(model, geoms)
    return rr.Ellipsoids3D(half_sizes=half, centers=model.geom_pos[geoms], **common)


def _make_cylinders(model: mujoco.MjModel, geoms: list[int]) -> Any:
    size = model.geom_size[geoms]
    common = _get_common_arguments(model, geoms)
    return rr.Cylinders3D(lengths=2 * size[:, 1], radii=size[:, 0], centers=model.geom_pos[geoms], **common)


def _make_capsules(model: mujoco.MjModel, geoms: list[int]) -> Any:
    """Return capsules. The origin of rerun's capsule is at one end; MuJoCo's is in the middle."""
    size = model.geom_size[geoms]
    ends = np.array([rotate_vector(model.geom_quat[g], [0, 0, -s[1]]) for g, s in zip(geoms, size, strict=True)])
    places, common = model.geom_pos[geoms] + ends, _get_common_arguments(model, geoms)
    return rr.Capsules3D(lengths=2 * size[:, 1], radii=size[:, 0], translations=places, **common)


_ARCHETYPE_MAKERS: dict[int, tuple[str, Any]] = {
    int(_KIND.mjGEOM_BOX): ("boxes", _make_boxes),
    int(_KIND.mjGEOM_PLANE): ("planes", _make_planes),
    int(_KIND.mjGEOM_SPHERE): ("spheres", _make_ellipsoids),
    int(_KIND.mjGEOM_ELLIPSOID): ("ellipsoids", _make_ellipsoids),
    int(_KIND.mjGEOM_CYLINDER): ("cylinders", _make_cylinders),
    int(_KIND.mjGEOM_CAPSULE): ("capsules", _make_capsules),
}


def find_triangles(model: mujoco.MjModel, mesh: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of a mesh with one normal each, so that a viewer shows sharp edges.

    Args:
        model: The model.
        mesh: Index of the mesh.

    Returns:
        Corners (n, 3, 3), m, and normals (n, 3).
    """
    first, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    triangles = vertices[model.mesh_face[face : face + model.mesh_facenum[mesh]]]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return triangles, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _make_mesh(model: mujoco.MjModel, geom: int) -> Any:
    triangles, normals = find_triangles(model, model.geom_dataid[geom])
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    turn = matrix.reshape(3, 3).T
    corners = (triangles @ turn + model.geom_pos[geom]).reshape(-1, 3)
    return rr.Mesh3D(
        vertex_positions=corners.astype(np.float32),
        vertex_normals=np.repeat(normals @ turn, 3, axis=0).astype(np.float32),
        triangle_indices=np.arange(len(corners)).reshape(-1, 3),
        albedo_factor=find_color(model, geom),
    )


def rotate_vector(quaternion: Any, vector: Any) -> np.ndarray:
    """Return a vector rotated by a quaternion.

    Args:
        quaternion: Quaternion w x y z, as in MuJoCo.
        vector: Vector, (3,).
    """
    out = np.zeros(3)
    mujoco.mju_rotVecQuat(out, np.asarray(vector, float), np.asarray(quaternion, float))
    return out


def compute_poses(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the poses of all bodies and the positions of all sites for a series of joint positions.

    Args:
        model: The model.
        qpos: Joint positions, (n, nq).

    Returns:
        Body positions (n, nbody, 3), quaternions x y z w (n, nbody, 4) and site positions (n, nsite, 3).
    """
    data = mujoco.MjData(model)
    xpos, xquat = np.zeros((len(qpos), model.nbody, 3)), np.zeros((len(qpos), model.nbody, 4))
    sites = np.zeros((len(qpos), model.nsite, 3))
    for k, q in enumerate(qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        xpos[k], xquat[k], sites[k] = data.xpos, data.xquat, data.site_xpos
    return xpos, np.roll(xquat, -1, axis=2), sites
