"""The bodies of a model as binary glTF, one a body: what a browser shows, in the body's frame. Written from the glTF 2.0
specification."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator

import mujoco
import numpy as np

from stage.recording.geoms import colour, floor, visible

FACETS = 32  # of a full circle
_KIND = mujoco.mjtGeom
Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Corners (n, 3) and normals (n, 3), float32; triangles (m, 3), uint32."""


def bodies(model: mujoco.MjModel) -> Iterator[tuple[int, bytes]]:
    """Yield (body, glTF) for each body that is visible."""
    ground = floor(model)
    for body in range(model.nbody):
        geoms = [
            g
            for g in np.flatnonzero(model.geom_bodyid == body).tolist()
            if g != ground and visible(model, g) and int(model.geom_type[g]) in _SHAPES
        ]
        if geoms:
            coloured: dict[tuple, list[Mesh]] = {}
            for g in geoms:
                coloured.setdefault(tuple((colour(model, g) / 255.0).tolist()), []).append(_placed(model, g))
            yield body, glb([(_joined(meshes), np.array(rgba)) for rgba, meshes in coloured.items()])


def _joined(meshes: list[Mesh]) -> Mesh:
    """Join meshes into one: browsers draw a mesh at a time, and each takes its time."""
    corners, normals, triangles = zip(*meshes, strict=True)
    first = np.cumsum([0, *(len(c) for c in corners[:-1])])
    shifted = [t + np.uint32(n) for t, n in zip(triangles, first, strict=True)]
    return np.concatenate(corners), np.concatenate(normals), np.concatenate(shifted).astype(np.uint32)


def glb(parts: list[tuple[Mesh, np.ndarray]]) -> bytes:
    """Return a binary glTF of meshes and their colors (RGBA, 0 to 1)."""
    blob, views, accessors, meshes, materials = bytearray(), [], [], [], []

    def add(values: np.ndarray, target: int, kind: str, component: int, bounds: bool = False) -> int:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes, "target": target})
        blob.extend(values.tobytes())
        said: dict = {"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind}
        if bounds:
            said |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(said)
        return len(accessors) - 1

    for (corners, normals, triangles), rgba in parts:
        place = add(corners, 34962, "VEC3", 5126, bounds=True)
        normal = add(normals, 34962, "VEC3", 5126)
        index = add(triangles.reshape(-1), 34963, "SCALAR", 5125)
        linear = [*(np.asarray(rgba[:3], float) ** 2.2).tolist(), float(rgba[3])]
        look = {"baseColorFactor": linear, "metallicFactor": 0.2, "roughnessFactor": 0.65}
        materials.append({"pbrMetallicRoughness": look, "doubleSided": True})
        if rgba[3] < 0.999:
            materials[-1]["alphaMode"] = "BLEND"
        attributes = {"POSITION": place, "NORMAL": normal}
        meshes.append({"primitives": [{"attributes": attributes, "indices": index, "material": len(materials) - 1}]})
    nodes = [{"mesh": k} for k in range(len(meshes))]
    scene = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes,
        "meshes": meshes, "materials": materials, "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }  # fmt: skip
    head = json.dumps(scene, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    blob.extend(bytes(-len(blob) % 4))
    chunks = struct.pack("<I4s", len(head), b"JSON") + head + struct.pack("<I4s", len(blob), b"BIN\0") + bytes(blob)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _placed(model: mujoco.MjModel, geom: int) -> Mesh:
    """Return the mesh of a geom, in its body's frame."""
    corners, normals, triangles = _SHAPES[int(model.geom_type[geom])](model, geom)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    turn = matrix.reshape(3, 3).T
    return (
        (corners @ turn + model.geom_pos[geom]).astype(np.float32),
        (normals @ turn).astype(np.float32),
        triangles.astype(np.uint32),
    )


def _flat(corners: np.ndarray, faces: np.ndarray) -> Mesh:
    """Return a mesh whose triangles share no corner: edges of machines are sharp."""
    triangles = corners[faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    n = 3 * len(triangles)
    return triangles.reshape(-1, 3), np.repeat(normals, 3, axis=0), np.arange(n).reshape(-1, 3)


def _box(half: np.ndarray) -> Mesh:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = np.array([triangle for a, b, c, d in sides for triangle in ((a, b, c), (a, c, d))])
    return _flat(corners, faces)


def _turned(profile: np.ndarray, lean: np.ndarray) -> Mesh:
    """Return a body of revolution about z: `profile` (n, 2) of radius and height, `lean` (n, 2) the normals along it."""
    angle = np.linspace(0, 2 * np.pi, FACETS + 1)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def swept(rows: np.ndarray) -> np.ndarray:
        flat = rows[:, None, :1] * around[None]
        return np.concatenate([flat, np.broadcast_to(rows[:, None, 1:], (*flat.shape[:2], 1))], axis=2).reshape(-1, 3)

    n, k = len(profile), FACETS + 1
    i = (np.arange(n - 1)[:, None] * k + np.arange(FACETS)).reshape(-1)
    faces = np.concatenate([np.stack([i, i + 1, i + k], 1), np.stack([i + 1, i + k + 1, i + k], 1)])
    return swept(profile), swept(lean), faces


def _cylinder(radius: float, half: float) -> Mesh:
    profile = np.array([[0, -half], [radius, -half], [radius, -half], [radius, half], [radius, half], [0, half]])
    lean = np.array([[0, -1], [0, -1], [1, 0], [1, 0], [0, 1], [0, 1]])
    return _turned(profile, lean)


def _capsule(radius: float, half: float) -> Mesh:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 18)
    lean = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    profile = radius * lean + np.array([[0, half]]) * np.sign(np.linspace(-1, 1, 18))[:, None]
    return _turned(profile, lean)


def _ellipsoid(half: np.ndarray) -> Mesh:
    corners, normals, faces = _capsule(1.0, 0.0)
    normals = normals / half
    return corners * half, normals / np.linalg.norm(normals, axis=1, keepdims=True), faces


def _plane(model: mujoco.MjModel, geom: int) -> Mesh:
    far = 2 * float(model.stat.extent)
    half = model.geom_size[geom].copy()
    half[(half <= 0) | (half > far)] = far
    half[2] = 0.001
    corners, normals, faces = _box(half)
    return corners - [0, 0, 0.001], normals, faces


def _mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    m = model.geom_dataid[geom]
    first = model.mesh_vertadr[m]
    corners = model.mesh_vert[first : first + model.mesh_vertnum[m]]
    faces = model.mesh_face[model.mesh_faceadr[m] : model.mesh_faceadr[m] + model.mesh_facenum[m]]
    return _flat(corners, faces)


_SHAPES = {
    int(_KIND.mjGEOM_BOX): lambda m, g: _box(m.geom_size[g]),
    int(_KIND.mjGEOM_PLANE): _plane,
    int(_KIND.mjGEOM_SPHERE): lambda m, g: _ellipsoid(np.repeat(m.geom_size[g][:1], 3)),
    int(_KIND.mjGEOM_ELLIPSOID): lambda m, g: _ellipsoid(m.geom_size[g]),
    int(_KIND.mjGEOM_CYLINDER): lambda m, g: _cylinder(m.geom_size[g][0], m.geom_size[g][1]),
    int(_KIND.mjGEOM_CAPSULE): lambda m, g: _capsule(m.geom_size[g][0], m.geom_size[g][1]),
    int(_KIND.mjGEOM_MESH): _mesh,
}
