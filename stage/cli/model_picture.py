"""A picture of a model: each axis has an arrow towards plus and its name, in the colours of the dashboard."""

from __future__ import annotations

from typing import Any

from stage.errors import StageError, unknown
from stage.support.extras import need

WIDTH, HEIGHT = 1600, 900
LENGTH = 0.16  # of an arrow, of the model's extent
AMBIENT, DIFFUSE = 0.45, 0.35  # of the lamp at the eye: nothing is black


def draw(model: Any, path: str, camera: str | None, overwrite: bool, key: str | None = None) -> None:
    """Render the model where keyframe `key`, or its first, or else its zero, has it. camera: one of the model's; None: `overview`,
    or a free one that sees all. Raises StageError for a camera that there is not, and where there is no OpenGL; ExtraMissing
    without matplotlib."""
    import mujoco

    from stage.sim import plant
    from stage.support.files import save_figure
    from stage.support.opengl import renderer

    Figure = need("matplotlib.figure", "drawing").Figure
    cameras = [model.camera(k).name for k in range(model.ncam)]
    if camera is not None and camera not in cameras:
        raise unknown("camera", camera, cameras) if cameras else StageError(f"camera {camera!r}: the model has none.")
    buffer, lamp = model.vis.global_, model.vis.headlight
    buffer.offwidth, buffer.offheight = max(buffer.offwidth, WIDTH), max(buffer.offheight, HEIGHT)
    lamp.ambient[:], lamp.diffuse[:] = AMBIENT, DIFFUSE
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0 if key is None else model.key(key).id)
    mujoco.mj_forward(model, data)
    with renderer(model, HEIGHT, WIDTH) as picture:
        picture.update_scene(data, camera or ("overview" if "overview" in cameras else _whole(model)))
        eye = picture.scene.camera[0]
        image = picture.render()
    figure = Figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
    ax = figure.add_axes((0, 0, 1, 1))
    ax.imshow(image)
    ax.set_axis_off()
    for k, axis in enumerate(plant.bind(model)):
        _arrow(ax, model, data, eye, axis, k)
    save_figure(figure, path, 100, overwrite)


def _arrow(ax: Any, model: Any, data: Any, eye: Any, axis: Any, k: int) -> None:
    """Along a slide, around a hinge; from the middle of what the axis moves."""
    import numpy as np
    from matplotlib import patheffects

    from stage.recording.series import COLOURS

    body = int(model.jnt_bodyid[axis.joint])
    geoms = np.flatnonzero(model.geom_bodyid == body)
    middle = data.geom_xpos[geoms].mean(axis=0) if len(geoms) else data.xpos[body]
    way, length = np.array(data.xaxis[axis.joint]), LENGTH * float(model.stat.extent)
    if axis.hinge:
        aside = np.cross(way, [1.0, 0.0, 0.0] if abs(way[0]) < 0.9 else [0.0, 1.0, 0.0])
        aside /= np.linalg.norm(aside)
        turn = np.linspace(0, 1.5 * np.pi, 40)[:, None]
        around = np.cos(turn) * aside + np.sin(turn) * np.cross(way, aside)
        points = data.xanchor[axis.joint] + 0.6 * length * around
    else:
        points = np.array([middle, middle + length * way])
    seen = _seen(eye, points)
    colour = tuple(c / 255 for c in list(COLOURS.values())[k % len(COLOURS)])
    edge = [patheffects.withStroke(linewidth=6, foreground="white")]
    ax.plot(*seen[:-1].T, color=colour, lw=3.5, solid_capstyle="round", path_effects=edge)
    style = {
        "arrowstyle": "-|>,head_length=0.9,head_width=0.45",
        "color": colour,
        "lw": 3.5,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    ax.annotate("", seen[-1], seen[-2], arrowprops=style | {"path_effects": edge})
    away = (seen[-1] - seen[-2]) / (np.linalg.norm(seen[-1] - seen[-2]) or 1.0)
    place = seen[-1] + 34 * away
    place = np.clip(place, 30, [WIDTH - 30, HEIGHT - 30])
    ax.text(*place, axis.name, color=colour, fontsize=24, weight="bold", ha="center", va="center", path_effects=edge)


def _seen(eye: Any, points: Any) -> Any:
    """Where points (n, 3) of the world are in the picture, pixels (n, 2)."""
    import numpy as np

    forward, up = np.array(eye.forward), np.array(eye.up)
    away = np.asarray(points) - np.array(eye.pos)
    depth = away @ forward
    half = (eye.frustum_top - eye.frustum_bottom) / 2 / eye.frustum_near * depth
    x, y = away @ np.cross(forward, up) / half, away @ up / half
    return np.stack([WIDTH / 2 + x * HEIGHT / 2, HEIGHT / 2 - y * HEIGHT / 2], axis=1)


def _whole(model: Any) -> Any:
    """A free camera that sees the whole model."""
    import mujoco

    seen = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, seen)
    seen.azimuth, seen.elevation, seen.distance = -125.0, -25.0, 1.2 * model.stat.extent
    seen.lookat[:] = model.stat.center
    return seen
