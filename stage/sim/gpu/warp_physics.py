"""Physics of all copies of a stage on a GPU, computed by mujoco-warp."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from stage.errors import GpuMissing, ModelError
from stage.sim.gpu.gpu_compilation import FEATURE_NAME
from stage.support.extras import import_extra

POSITIONS_PER_JOINT = 41  # of each joint, where contacts and constraints are counted
SPARE_CONTACTS, SPARE_CONSTRAINTS = 4, 8


def load_warp() -> Any:
    """Load mujoco-warp, and return the module warp.

    Raises:
        ExtraMissing: warp or mujoco-warp is not installed.
        GpuMissing: There is no GPU.
    """
    warp = import_extra("warp", FEATURE_NAME)
    import_extra("mujoco_warp", FEATURE_NAME)
    warp.config.quiet = True
    if not warp.is_cuda_available():
        raise GpuMissing(
            'device="cuda": no NVIDIA GPU can be used here (its driver is missing or it is not visible). Leave out device= to '
            "run the fleet on this machine's processors."
        )
    return warp


class WarpPhysics:
    """Physics of all copies of a stage, computed by mujoco-warp.

    Args:
        model: Model of the stage.
        data: Data of the stage; the copies begin in its state.
        copies: Number of copies.

    Attributes:
        data: mujoco-warp's Data, with a row per copy.
        stream: warp's stream in which all work is done.

    Raises:
        ModelError: mujoco-warp cannot simulate the model.
        ExtraMissing: warp or mujoco-warp is not installed.
        GpuMissing: There is no GPU.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, copies: int):
        self.warp = load_warp()
        self._mujoco_warp: Any = import_extra("mujoco_warp", FEATURE_NAME)
        model = copy.copy(model)
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # mujoco-warp has no such flag
        contacts, constraints = count_contacts_and_constraints(model)
        begin = mujoco.MjData(model)
        for name in ("qpos", "qvel", "act", "ctrl", "qacc_warmstart"):
            getattr(begin, name)[:] = getattr(data, name)
        mujoco.mj_forward(model, begin)
        try:
            self._model = self._mujoco_warp.put_model(model)
            kinds = self._mujoco_warp.OverflowType
            self._tolerated = int(kinds.ITERATIONS | kinds.LS_ITERATIONS)
            self._model.opt.warn_overflow &= ~self._tolerated
            self.data = self._mujoco_warp.put_data(
                model, begin, nworld=copies, nconmax=contacts + SPARE_CONTACTS, njmax=constraints + SPARE_CONSTRAINTS
            )
        except (NotImplementedError, ValueError) as error:
            raise ModelError(f'device="cuda": mujoco-warp does not take this model: {error}', ()) from error
        self.stream = self.warp.Stream(self.warp.get_device())

    def step(self) -> None:
        """Advance all copies of the stage by a physics step on the GPU."""
        self._mujoco_warp.step(self._model, self.data)

    def run(self, work: Callable[[], None]) -> None:
        """Call `work`, which enqueues work in the CUDA stream, and wait for the end of that work."""
        with self.warp.ScopedStream(self.stream):
            work()
        self.warp.synchronize_stream(self.stream)

    def capture_graph(self, work: Callable[[], None]) -> Any:
        """Capture work as a CUDA graph. The work must have been done once before, so that all of its code is compiled."""
        with self.warp.ScopedStream(self.stream), self.warp.ScopedCapture(stream=self.stream) as captured:
            work()
        return captured.graph

    def launch_graph(self, graph: Any) -> None:
        """Launch a captured CUDA graph, and wait for its end."""
        self.warp.capture_launch(graph, stream=self.stream)
        self.warp.synchronize_stream(self.stream)

    def find_overflowed_copies(self) -> np.ndarray:
        """Return which copies had more contacts or constraints than mujoco-warp has memory for, (copies,) bool."""
        return (self.data.overflow.numpy() & ~self._tolerated) != 0


def count_contacts_and_constraints(model: mujoco.MjModel) -> tuple[int, int]:
    """Return the largest numbers of contacts and of constraints while each joint, and then all joints, move over their travel."""
    data = mujoco.MjData(model)
    limited = model.jnt_limited.astype(bool)
    place = model.jnt_qposadr[limited]
    low, high = model.jnt_range[limited].T
    contacts = constraints = 0
    for share in np.linspace(0.0, 1.0, POSITIONS_PER_JOINT):
        for k in range(-1, len(place)):
            data.qpos[:] = model.qpos0
            data.qpos[place] = 0.5 * (low + high)
            which = slice(None) if k < 0 else slice(k, k + 1)
            data.qpos[place[which]] = (low + share * (high - low))[which]
            mujoco.mj_forward(model, data)
            contacts, constraints = max(contacts, data.ncon), max(constraints, data.nefc)
    return contacts, constraints
