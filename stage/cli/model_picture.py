"""A picture of a model, with the names of its axes."""

from __future__ import annotations

from typing import Any

from stage.errors import StageError, unknown

WIDTH, HEIGHT = 1600, 900


def draw(model: Any, path: str, camera: str | None, overwrite: bool) -> None:
    """Render the model where its first keyframe, or else its zero, has it. camera: one of the model's; None: `overview`, or a free
    one that sees all. Raises StageError for a camera that there is not, and where there is no OpenGL."""
    import mujoco
    import numpy as np

    from stage.files import written
    from stage.opengl import renderer
    from stage.sim import plant

    cameras = [model.camera(k).name for k in range(model.ncam)]
    if camera is not None and camera not in cameras:
        raise unknown("camera", camera, cameras) if cameras else StageError(f"camera {camera!r}: the model has none.")
    buffer = model.vis.global_
    buffer.offwidth, buffer.offheight = max(buffer.offwidth, WIDTH), max(buffer.offheight, HEIGHT)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    with renderer(model, HEIGHT, WIDTH) as picture:
        picture.update_scene(data, camera or ("overview" if "overview" in cameras else _whole(model)))
        for axis in plant.bind(model):
            joint = model.joint(axis.name)
            _label(picture.scene, data.xanchor[joint.id] + np.array([0, 0, 0.06]), axis.name)
        image = picture.render()
    with written(path, overwrite) as part:
        import matplotlib.image

        matplotlib.image.imsave(part, image, format="png")


def _whole(model: Any) -> Any:
    """A free camera that sees the whole model."""
    import mujoco

    seen = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, seen)
    seen.azimuth, seen.elevation, seen.distance = -125.0, -25.0, 1.2 * model.stat.extent
    seen.lookat[:] = model.stat.center
    return seen


def _label(scene: Any, place: Any, text: str) -> None:
    import mujoco
    import numpy as np

    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom,
        mujoco.mjtGeom.mjGEOM_LABEL,
        np.full(3, 0.01),
        np.asarray(place, float),
        np.eye(3).ravel(),
        np.ones(4, np.float32),
    )
    geom.label = text
    scene.ngeom += 1
