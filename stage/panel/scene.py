"""The stage in 3D."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
from nicegui import ui

from stage.panel.live import FRAMES, Live

if TYPE_CHECKING:
    from stage.panel.server import Panel

VIEWS = {"corner": (0.75, -1.1, 0.75), "front": (0, -1.5, 0.15), "side": (1.5, 0, 0.15), "top": (0, -0.01, 1.6)}
"""Where the camera stands, from the centre of the model, in its extents."""


class Poses(ui.element, component="poses.js"):
    """Where the bodies of a scene are."""

    def __init__(self, scene: ui.scene):
        super().__init__()
        self._props["scene"] = scene.id


def build(panel: Panel, live: Live) -> None:
    session = panel.session
    model = session.stage.model
    data = mujoco.MjData(model)  # this page's own: the stage's belongs to its thread
    extent, (cx, cy, cz) = float(model.stat.extent), model.stat.center
    camera = ui.scene.perspective_camera(fov=40, near=extent / 100, far=extent * 20)
    with ui.element("div").classes("relative-position"):
        with ui.scene(grid=False, camera=camera, background_color="#20242b", fps=FRAMES).classes("scene") as scene:
            moving = {}
            for body in panel.shapes:
                with scene.group() as group:
                    scene.gltf(f"/shape/{body}.glb")
                moving[body] = group

        def look_from(name: str, duration: float = 0.4) -> None:
            x, y, z = (extent * way for way in VIEWS[name])
            scene.move_camera(cx + x, cy + y, cz + z, cx, cy, cz, 0, 0, 1, duration=duration)

        with ui.button_group().props("flat").classes("view"):
            for name in VIEWS:
                ui.button(name, on_click=lambda name=name: look_from(name)).props(
                    f"dense flat no-caps color=white size=sm data-test=view-{name}"
                )
    look_from("corner", 0)
    seen = np.full(model.nq, np.nan)
    placed: dict[int, list] = {}

    def look() -> list | None:
        view = session.view
        if np.array_equal(view.qpos, seen):
            return None
        seen[:] = view.qpos
        data.qpos[:] = view.qpos
        mujoco.mj_kinematics(model, data)
        poses = []
        for body, group in moving.items():
            where = [data.xpos[body].round(6).tolist(), data.xmat[body].reshape(3, 3).round(6).tolist()]
            if placed.get(body) != where:
                placed[body] = where
                poses.append([group.id, *where])
        return [poses] if poses else None

    live.call(Poses(scene), "move", look)
