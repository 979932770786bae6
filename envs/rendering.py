"""Rendering of a stage for Gymnasium's `render`: off-screen images, or the window of MuJoCo's viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from stage import Stage
from stage.errors import StageError, unknown_name_error
from stage.support.opengl import check_window, make_renderer

if TYPE_CHECKING:
    from stage.recording import Recording


class StagePoser:
    """Copy of a stage's MjData for drawing, whose joints can be set without moving the stage itself."""

    def __init__(self, stage: Stage):
        self._stage, self.data = stage, mujoco.MjData(stage.model)

    def __call__(self, qpos: np.ndarray | None = None) -> mujoco.MjData:
        """Return the same MjData at each call, with its geoms at the joint positions `qpos`; None: as the stage is now."""
        self.data.qpos[:] = self._stage.data.qpos if qpos is None else qpos
        mujoco.mj_fwdPosition(self._stage.model, self.data)
        return self.data


class OffScreenRenderer:
    """Renderer of images, (height, width, 3) uint8, without a window."""

    def __init__(self, stage: Stage, camera: str, width: int, height: int):
        model = stage.model
        names = [model.camera(k).name for k in range(model.ncam)]
        if camera not in names:
            raise unknown_name_error("camera", camera, names)
        self._pose, self._camera = StagePoser(stage), camera
        self._renderer = make_renderer(model, height, width)

    def render_stage(self, qpos: np.ndarray | None = None) -> np.ndarray:
        """Return an image of the stage with its joints at `qpos`; None: as the stage is now."""
        self._renderer.update_scene(self._pose(qpos), self._camera)
        return self._renderer.render()

    def close(self) -> None:
        self._renderer.close()


class ViewerWindow:
    """Window of MuJoCo's own viewer."""

    def __init__(self, stage: Stage):
        check_window("Use render_mode='rgb_array', or record.")
        self._pose = StagePoser(stage)
        try:
            import mujoco.viewer

            self._viewer: Any = mujoco.viewer.launch_passive(stage.model, self._pose())
        except Exception as error:
            raise StageError(
                f"MuJoCo's viewer does not open ({error}). Use render_mode='rgb_array', or record."
            ) from error

    def render_stage(self, qpos: np.ndarray | None = None) -> None:
        """Show the stage with its joints at `qpos`; None: as the stage is now."""
        self._pose(qpos)
        self._viewer.sync()

    def close(self) -> None:
        self._viewer.close()


class PoseSampler:
    """Sampler of the joint positions during a step, for the frames of a film. It does not influence the stage.

    Args:
        stage: Stage to sample.
        every: Simulated time between two samples, s.
    """

    def __init__(self, stage: Stage, every: float):
        self._stage, recording = stage, stage.recording
        self._own_recording: Recording | None = None
        if recording is None:
            recording = self._own_recording = stage.record(every)
        self._recording: Recording = recording
        self._begin, self._stride = len(self._recording), max(1, round(every / self._recording.every))

    def read_sampled_poses(self) -> np.ndarray:
        """Return the joint positions sampled during a step, (frames, nq), when it is over; the last row is the end of the step."""
        rows = [piece["qpos"] for piece in self._recording.pieces(begin=self._begin)]
        if self._own_recording is not None:
            self._own_recording.close()
        recorded = np.concatenate([np.zeros((0, self._stage.model.nq)), *rows])[self._stride - 1 :: self._stride]
        return np.concatenate([recorded, self._stage.data.qpos[None]])


def make_viewer(stage: Stage, mode: str, camera: str, width: int, height: int) -> OffScreenRenderer | ViewerWindow:
    """Make the viewer for a render mode.

    Args:
        stage: Stage to show.
        mode: "human" for a window; any other mode for off-screen images.
        camera: Name of the camera of off-screen images.
        width: Width of an image, pixels.
        height: Height of an image, pixels.

    Raises:
        StageError: OpenGL or a screen is not available.
    """
    return ViewerWindow(stage) if mode == "human" else OffScreenRenderer(stage, camera, width, height)
