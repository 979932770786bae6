"""Pictures of a stage for `render`: an off-screen renderer, or MuJoCo's viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from stage import Stage
from stage.errors import StageError, unknown_name_error
from stage.support.opengl import check_window, make_renderer

if TYPE_CHECKING:
    from stage.recording import Recording


class Pose:
    """The stage, or a copy of it for drawing with its joints elsewhere: the stage itself does not move."""

    def __init__(self, stage: Stage):
        self._stage, self.data = stage, mujoco.MjData(stage.model)

    def __call__(self, qpos: np.ndarray | None = None) -> mujoco.MjData:
        """MjData with all that is drawn; always the same."""
        self.data.qpos[:] = self._stage.data.qpos if qpos is None else qpos
        mujoco.mj_fwdPosition(self._stage.model, self.data)
        return self.data


class OffScreen:
    """Frames as arrays (height, width, 3) of uint8."""

    def __init__(self, stage: Stage, camera: str, width: int, height: int):
        model = stage.model
        names = [model.camera(k).name for k in range(model.ncam)]
        if camera not in names:
            raise unknown_name_error("camera", camera, names)
        self._pose, self._camera = Pose(stage), camera
        self._renderer = make_renderer(model, height, width)

    def frame(self, qpos: np.ndarray | None = None) -> np.ndarray:
        """The stage as it is, or with its joints at `qpos`."""
        self._renderer.update_scene(self._pose(qpos), self._camera)
        return self._renderer.render()

    def close(self) -> None:
        self._renderer.close()


class OnScreen:
    """MuJoCo's own viewer."""

    def __init__(self, stage: Stage):
        check_window("Use render_mode='rgb_array', or record.")
        self._pose = Pose(stage)
        try:
            import mujoco.viewer

            self._viewer: Any = mujoco.viewer.launch_passive(stage.model, self._pose())
        except Exception as error:
            raise StageError(
                f"MuJoCo's viewer does not open ({error}). Use render_mode='rgb_array', or record."
            ) from error

    def frame(self, qpos: np.ndarray | None = None) -> None:
        """The stage as it is, or with its joints at `qpos`."""
        self._pose(qpos)
        self._viewer.sync()

    def close(self) -> None:
        self._viewer.close()


class Film:
    """Joint positions during a step, every `every` s of its time and at its end. The stage moves exactly as without it."""

    def __init__(self, stage: Stage, every: float):
        self._stage, recording = stage, stage.recording
        self._own_recording: Recording | None = None
        if recording is None:
            recording = self._own_recording = stage.record(every)
        self._recording: Recording = recording
        self._begin, self._stride = len(self._recording), max(1, round(every / self._recording.every))

    def end(self) -> np.ndarray:
        """The step is over: (frames, nq), at least one."""
        rows = [piece["qpos"] for piece in self._recording.pieces(begin=self._begin)]
        if self._own_recording is not None:
            self._own_recording.close()
        recorded = np.concatenate([np.zeros((0, self._stage.model.nq)), *rows])[self._stride - 1 :: self._stride]
        return np.concatenate([recorded, self._stage.data.qpos[None]])


def make_viewer(stage: Stage, mode: str, camera: str, width: int, height: int) -> OffScreen | OnScreen:
    """Return the viewer for a render mode.

    Args:
        stage: To show.
        mode: "human", or another for off-screen frames.
        camera: Name of the camera.
        width: Of a frame, pixels.
        height: Of a frame, pixels.

    Raises:
        StageError: There is no GL, or no screen.
    """
    return OnScreen(stage) if mode == "human" else OffScreen(stage, camera, width, height)
