"""Pictures of a stage for `render`: an off-screen renderer, or MuJoCo's viewer."""

from __future__ import annotations

from typing import Any

import numpy as np

from stage import Stage
from stage.errors import StageError, unknown
from stage.opengl import check_window, renderer


class OffScreen:
    """Frames as arrays (height, width, 3) of uint8."""

    def __init__(self, stage: Stage, camera: str, width: int, height: int):
        model = stage.model
        names = [model.camera(k).name for k in range(model.ncam)]
        if camera not in names:
            raise unknown("camera", camera, names)
        self._stage, self._camera = stage, camera
        self._renderer = renderer(model, height, width)

    def frame(self) -> np.ndarray:
        self._renderer.update_scene(self._stage.data, self._camera)
        return self._renderer.render()

    def close(self) -> None:
        self._renderer.close()


class OnScreen:
    """MuJoCo's own viewer, brought up to date after every step."""

    def __init__(self, stage: Stage):
        check_window("Use render_mode='rgb_array', or record.")
        try:
            import mujoco.viewer

            self._viewer: Any = mujoco.viewer.launch_passive(stage.model, stage.data)
        except Exception as error:
            raise StageError(
                f"MuJoCo's viewer does not open ({error}). Use render_mode='rgb_array', or record."
            ) from error

    def frame(self) -> None:
        self._viewer.sync()

    def close(self) -> None:
        self._viewer.close()


def viewer(stage: Stage, mode: str, camera: str, width: int, height: int) -> OffScreen | OnScreen:
    """The viewer for a render mode; StageError where there is no GL or no screen."""
    return OffScreen(stage, camera, width, height) if mode == "rgb_array" else OnScreen(stage)
