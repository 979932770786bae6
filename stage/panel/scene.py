"""The stage in 3D."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
from nicegui import ui

if TYPE_CHECKING:
    from stage.panel.server import Panel

FRAMES = 25  # a second


def build(panel: Panel) -> None:
    session = panel.session
    model = session.stage.model
    data = mujoco.MjData(model)  # this page's own: the stage's belongs to its thread
    extent, (cx, cy, cz) = float(model.stat.extent), model.stat.center
    camera = ui.scene.perspective_camera(fov=40, near=extent / 100, far=extent * 20)
    with ui.scene(grid=False, camera=camera, background_color="#20242b", fps=FRAMES).classes("scene") as scene:
        moving = {}
        for body in panel.shapes:
            with scene.group() as group:
                scene.gltf(f"/shape/{body}.glb")
            moving[body] = group
    scene.move_camera(cx + 0.9 * extent, cy - 1.3 * extent, cz + 0.9 * extent, cx, cy, cz, 0, 0, 1, duration=0)
    seen = np.full(model.nq, np.nan)
    placed: dict[int, tuple] = {}

    def look() -> None:
        view = session.view
        if np.array_equal(view.qpos, seen):
            return
        seen[:] = view.qpos
        data.qpos[:] = view.qpos
        mujoco.mj_kinematics(model, data)
        with scene._batch_calls():
            for body, group in moving.items():
                where = (*data.xpos[body].round(6), *data.xmat[body].round(6))
                if placed.get(body) != where:
                    placed[body] = where
                    group.move(*data.xpos[body].tolist())
                    group.rotate_R(data.xmat[body].reshape(3, 3).tolist())

    ui.timer(1 / FRAMES, look)
