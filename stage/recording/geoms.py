"""The MJCF geoms of a model as rerun archetypes, grouped by body: static shapes that ride on moving transforms."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

HIDDEN_GROUP = 3  # this group and above are for computing, not for looking
FLOOR_THICKNESS = 0.002


def colour(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """RGBA 0..255 of a geom: its material's, where it has one."""
    material = model.geom_matid[geom]
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    if material >= 0:
        texture = model.mat_texid[material][int(mujoco.mjtTextureRole.mjTEXROLE_RGB)]
        if texture >= 0:
            rgba = rgba * np.append(_mean(model, texture), 1.0)
    return (np.clip(rgba, 0, 1) * 255).round().astype(np.uint8)


def _mean(model: mujoco.MjModel, texture: int) -> np.ndarray:
    channels = model.tex_nchannel[texture]
    begin = model.tex_adr[texture]
    size = model.tex_width[texture] * model.tex_height[texture] * channels
    return model.tex_data[begin : begin + size].reshape(-1, channels)[:, :3].mean(axis=0) / 255


def shapes(model: mujoco.MjModel, body: int) -> Iterator[tuple[str, Any]]:
    """(entity name, archetype) for the geoms of a body, in the body's frame."""
    import rerun as rr

    kinds: dict[int, list[int]] = {}
    for g in range(model.ngeom):
        if model.geom_bodyid[g] == body and model.geom_group[g] < HIDDEN_GROUP and model.geom_rgba[g][3] > 0:
            kinds.setdefault(int(model.geom_type[g]), []).append(g)
    kind = mujoco.mjtGeom
    for t, geoms in kinds.items():
        pos, size = model.geom_pos[geoms], model.geom_size[geoms]
        quat = np.roll(model.geom_quat[geoms], -1, axis=1)  # rerun wants x y z w
        colours = np.array([colour(model, g) for g in geoms])
        placed: dict[str, Any] = {"quaternions": quat, "colors": colours}
        solid = rr.components.FillMode.Solid
        if t == kind.mjGEOM_BOX:
            yield "boxes", rr.Boxes3D(half_sizes=size, centers=pos, fill_mode=solid, **placed)
        elif t in (kind.mjGEOM_SPHERE, kind.mjGEOM_ELLIPSOID):
            half = np.repeat(size[:, :1], 3, axis=1) if t == kind.mjGEOM_SPHERE else size
            yield f"ellipsoids{t}", rr.Ellipsoids3D(half_sizes=half, centers=pos, fill_mode=solid, **placed)
        elif t == kind.mjGEOM_CYLINDER:
            yield (
                "cylinders",
                rr.Cylinders3D(lengths=2 * size[:, 1], radii=size[:, 0], centers=pos, fill_mode=solid, **placed),
            )
        elif t == kind.mjGEOM_CAPSULE:
            ends = np.array([_rotated(q, [0, 0, -s[1]]) for q, s in zip(model.geom_quat[geoms], size, strict=True)])
            yield (
                "capsules",
                rr.Capsules3D(lengths=2 * size[:, 1], radii=size[:, 0], translations=pos + ends, **placed),
            )
        elif t == kind.mjGEOM_MESH:
            for g in geoms:
                yield f"mesh{g}", _mesh(model, g)
    # planes are left out: they would hide a stage that is looked at from below, and rerun has a grid of its own


def _mesh(model: mujoco.MjModel, geom: int) -> Any:
    import rerun as rr

    m = model.geom_dataid[geom]
    vertices = model.mesh_vert[model.mesh_vertadr[m] : model.mesh_vertadr[m] + model.mesh_vertnum[m]]
    faces = model.mesh_face[model.mesh_faceadr[m] : model.mesh_faceadr[m] + model.mesh_facenum[m]]
    placed = np.array([_rotated(model.geom_quat[geom], v) for v in vertices]) + model.geom_pos[geom]
    return rr.Mesh3D(vertex_positions=placed, triangle_indices=faces, albedo_factor=colour(model, geom))


def _rotated(quat: np.ndarray, v: Any) -> np.ndarray:
    out = np.zeros(3)
    mujoco.mju_rotVecQuat(out, np.asarray(v, float), np.asarray(quat, float))
    return out


def poses(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Body positions (n, nbody, 3), quaternions x y z w (n, nbody, 4) and site positions (n, nsite, 3) for n qpos."""
    data = mujoco.MjData(model)
    xpos, xquat = np.zeros((len(qpos), model.nbody, 3)), np.zeros((len(qpos), model.nbody, 4))
    sites = np.zeros((len(qpos), model.nsite, 3))
    for k, q in enumerate(qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        xpos[k], xquat[k], sites[k] = data.xpos, data.xquat, data.site_xpos
    return xpos, np.roll(xquat, -1, axis=2), sites
