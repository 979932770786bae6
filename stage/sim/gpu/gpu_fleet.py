"""`GpuFleet`: copies of one stage on a GPU, each of which executes its own program.

fleet = Fleet([Stage("xyz", chips=PCL240K, visuals=False)], device="cuda", copies=8192)
played = fleet.play(programs)              one a copy, as of a fleet on processors
fleet.arrays["qpos"]                       stays on the GPU: torch.from_dlpack(...)
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from stage.drives.stepper import DRIVE
from stage.errors import ArgumentError, GpuMissing, StageError
from stage.sim import engine_records, fleet, program_player
from stage.sim.gpu.gpu_compilation import FEATURE_NAME, CompilerTools, DeviceModules, make_cuda_tools
from stage.sim.gpu.lane_memory_layout import PROGRAM_STATE, THREADS_PER_WARP, LaneLayout
from stage.sim.gpu.warp_physics import WarpPhysics, load_warp
from stage.sim.program import Program
from stage.sim.stage import Stage
from stage.support.argument_checks import explain_arguments
from stage.support.extras import import_extra

TESTED_CORES = ("stage.chips.pcl240.core", "stage.chips.hctl1100.core")
"""Cores of the chip families whose code was tested on a GPU."""
STEPS_PER_LAUNCH = 20


class GpuFleet(fleet.Fleet):
    """Fleet of copies of one stage on a GPU; `Fleet(..., device="cuda")` makes one.

    Attributes:
        arrays: GPU arrays by name, with a row per copy, for libraries that take DLPack: qpos, qvel, ctrl (float32) and the results
            of the last play (int64). Their memory stays the same until a program has more operations than all programs before.
        physics: Physics of all copies, computed by mujoco-warp.
    """

    @explain_arguments
    def __init__(
        self, stages: Sequence[Stage], threads: int | None = None, *, device: str = "cuda", copies: int | None = None
    ):
        if threads is not None:
            raise ArgumentError(f"threads={threads!r}: a fleet on a GPU has no threads; leave it out.")
        if len(stages) != 1:
            raise ArgumentError(
                f"{len(stages)} stages: a fleet on a GPU is made of copies of one stage; give one stage and copies=."
            )
        if copies is None or isinstance(copies, bool) or int(copies) != copies or copies < 1:
            raise ArgumentError(
                f"copies={copies!r}: how many copies of the stage the GPU has, a whole number, 1 or more."
            )
        check_stage(stages[0])
        self.stages, self._copies = list(stages), int(copies)
        stage = stages[0]
        tools = make_cuda_tools()
        load_warp()
        cuda: Any = import_extra("numba.cuda", FEATURE_NAME)
        if not cuda.is_available():
            raise GpuMissing(
                'device="cuda": numba-cuda finds no NVIDIA GPU, though warp does: its driver may be too old.'
            )
        self.physics = WarpPhysics(stage.model, stage.data, self._copies)
        self._layout = LaneLayout(stage)
        self._advance, self._inspect = make_kernels(stage, self._layout, tools)
        self._stream = cuda.external_stream(self.physics.stream.cuda_stream)
        self._allocate_arrays(cuda)
        self._operations = self._used = 0
        self._graph: Any = None

    def _allocate_arrays(self, cuda: Any) -> None:
        """Allocate the arrays of the copies on the GPU, and share them with mujoco-warp."""
        stage, layout, data = self.stages[0], self._layout, self.physics.data
        model, state = stage.model, stage.state
        self._begin = layout.pack(self._copies)
        self._words = cuda.to_device(self._begin)
        self._flag_edges = cuda.to_device(state.flag_edges)
        clockwork = state.clockwork.copy()
        clockwork["flag_edges"] = self._flag_edges.__cuda_array_interface__["data"][0]
        names = ("qpos", "qvel", "ctrl", "sensordata", "qacc_warmstart", "site_xpos", "xpos")
        physics = {name: cuda.as_cuda_array(getattr(data, name)) for name in names}
        self._qpos, self._qvel = physics["qpos"], physics["qvel"]
        self._coordinates = [physics[name] for name in ("qpos", "qvel", "qacc_warmstart", "ctrl")]
        self._initial_coordinates = [a.copy_to_host() for a in self._coordinates]
        self._tables = [
            cuda.to_device(a)
            for a in (layout.rows, layout.axis_numbers, layout.places, layout.tables, layout.switch_tables, clockwork)
        ]
        inertia = np.ascontiguousarray(np.broadcast_to(model.dof_M0, (self._copies, model.nv)))
        self._frozen_coordinates = cuda.to_device(np.zeros((self._copies, model.nq + 2 * model.nv), np.float32))
        self._playing = cuda.to_device(np.zeros(1, np.int32))
        self._extremes = cuda.to_device(np.zeros((self._copies, model.nq, 2)))
        self._device_truth = cuda.to_device(np.zeros((self._copies, len(state.axis_table)), program_player.TRUTH))
        losses = cuda.to_device(model.dof_damping), cuda.to_device(model.actuator_damping)
        self._rest = [
            self._extremes, physics["qpos"], physics["qvel"], physics["ctrl"], physics["sensordata"], cuda.to_device(inertia),
            *losses, physics["qacc_warmstart"], physics["site_xpos"], physics["xpos"], self._frozen_coordinates, self._playing,
        ]  # fmt: skip
        self.arrays = {name: getattr(data, name) for name in ("qpos", "qvel", "ctrl")}
        self._cuda = cuda

    def __len__(self) -> int:
        return self._copies

    def __getstate__(self) -> dict[str, Any]:
        return {"stages": self.stages, "copies": self._copies}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["stages"], copies=state["copies"])  # type: ignore[misc]

    @explain_arguments
    def play(self, programs: Sequence[Program] | np.ndarray) -> fleet.PlayedPrograms:
        """Play programs[k] on copy k. An empty program leaves its copy as it is. An array (copies, operations, 4) is possible, too.

        Raises:
            ArgumentError: A program names an axis or a point that does not exist. No program is played then.
            StageError: A copy had more contacts than mujoco-warp has memory for.
        """
        self.load(programs)
        while self.advance():
            pass
        self.physics.run(self._advance_lanes)  # puts back what the last physics step has moved
        if (overflowed := self.physics.find_overflowed_copies()).any():
            raise StageError(
                f"copy {int(np.argmax(overflowed))} of the fleet: more contacts at once than the model has over the travel of its "
                "joints. Run such a stage on a processor."
            )
        status = self.read_records()["host"]["status"]
        return fleet.PlayedPrograms(
            self.arrays["results"].numpy()[:, : self._used].copy(),
            self._extremes.copy_to_host(),
            status == program_player.DIVERGED,
        )

    @explain_arguments
    def load(self, programs: Sequence[Program] | np.ndarray) -> None:
        """Load a program for every copy, which `advance` then plays. Raises ArgumentError as `play` does."""
        ops = fleet.check_programs(programs, len(self), self.stages[0])
        self._allocate_programs(ops.shape[1])
        self._used = ops.shape[1]
        padded = np.zeros((len(self), self._operations, 4), np.int64)  # END
        padded[:, : self._used] = ops
        self._ops.copy_to_device(padded)
        self.physics.run(self.arrays["results"].zero_)
        extremes = np.empty(self._extremes.shape)
        extremes[:, :, 0], extremes[:, :, 1] = np.inf, -np.inf
        self._extremes.copy_to_device(extremes)
        self._start_hosts()

    def advance(self) -> bool:
        """Play the loaded programs for STEPS_PER_LAUNCH physics steps, and return whether any program has not ended."""
        going = np.zeros(1, np.int32)
        self._playing.copy_to_device(going)
        self.physics.launch_graph(self._graph)
        self._playing.copy_to_host(going)
        return bool(going[0])

    def truth(self) -> np.ndarray:
        """Return the true state of every axis of every copy now: a new array (copies, axes) of TRUTH records."""
        rows, numbers, _, tables, _, clockwork = self._tables

        def inspect() -> None:
            self._inspect[self._block_count, THREADS_PER_WARP, self._stream](
                self._words, rows, numbers, tables, clockwork, self._qpos, self._qvel, self._device_truth
            )

        self.physics.run(inspect)
        return self._device_truth.copy_to_host()

    def read_records(self) -> dict[str, np.ndarray]:
        """Return the records of every copy of the stage as arrays on the host, by the names of `LaneLayout.unpack`."""
        return self._layout.unpack(self._words.copy_to_host(), len(self))

    def reset(self) -> None:
        """Return every copy to the state of the stage at the time when the fleet was made."""
        self._words.copy_to_device(self._begin)
        for array, begin in zip(self._coordinates, self._initial_coordinates, strict=True):
            array.copy_to_device(begin)

    def list_stages_played_in_python(self) -> list[int]:
        """Return an empty list, because copies on a GPU cannot be recorded."""
        return []

    def close(self) -> None:
        """Free the CUDA graph of the fleet."""
        self._graph = None
        self._operations = 0

    @property
    def _block_count(self) -> int:
        """Number of CUDA blocks of the fleet's kernels, each of one warp (32 threads)."""
        return self._layout.count_threads(len(self)) // THREADS_PER_WARP

    def _advance_lanes(self) -> None:
        """Enqueue the kernel that advances all lanes by a window."""
        self._advance[self._block_count, THREADS_PER_WARP, self._stream](
            self._words, *self._tables, self._ops, self._results, *self._rest
        )

    def _start_hosts(self) -> None:
        """Begin the program of the host of every copy."""
        first, host = self._layout.find_host_words()
        rows = np.repeat(host[:, None], self._words.shape[1], axis=1)
        self._words[first:].copy_to_device(rows)

    def _allocate_programs(self, operations: int) -> None:
        """Make arrays for programs with a number of operations, and the CUDA graph that uses them."""
        if operations <= self._operations:
            return
        warp, shape = self.physics.warp, (len(self), operations)
        self._ops = self._cuda.to_device(np.zeros((*shape, 4), np.int64))
        self.arrays["results"] = warp.zeros(shape, dtype=warp.int64)
        self._results = self._cuda.as_cuda_array(self.arrays["results"])
        self._operations = operations

        def enqueue_step() -> None:
            self._advance_lanes()
            self.physics.step()

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numba's, of grids that do not fill a GPU
            self.physics.run(self._advance_lanes)  # of no program: nothing moves
            self._graph = None
            self.physics.run(enqueue_step)
            self.physics.run(self._advance_lanes)

        def enqueue_steps() -> None:
            for _ in range(STEPS_PER_LAUNCH):
                enqueue_step()

        self._graph = self.physics.capture_graph(enqueue_steps)


def check_stage(stage: Stage) -> None:
    """Raise ArgumentError for a stage that the kernel cannot advance."""
    state, cores = stage.state, {chip.CORE.__name__ for chip in stage.chips}
    for name, axis in stage.axes.items():
        if axis.chip.CORE.__name__ not in TESTED_CORES:
            raise ArgumentError(
                f"axis {name}: {type(axis.chip).__name__} has no kernel for a GPU. The PCL-240 family and HCTL-1100 have one; "
                "leave out device= to run the fleet on this machine's processors."
            )
    if len(cores) > 1:
        raise ArgumentError("the chips of a stage on a GPU are of one family.")
    if len(stage.chips) > THREADS_PER_WARP:
        raise ArgumentError(f"{len(stage.chips)} chips: a stage on a GPU has {THREADS_PER_WARP} at most.")
    if state.chip_table["wire"].any() or state.chip_table["link"].any():
        raise ArgumentError("syni=, multichip=: chips that are wired together do not run on a GPU.")
    if fleet.is_observed(stage):
        raise ArgumentError("a stage that is being recorded, or whose chips lose bus writes, does not run on a GPU.")


def make_kernels(stage: Stage, layout: LaneLayout, tools: CompilerTools) -> tuple[Any, Any]:
    """Compile the kernels `advance_lanes` and `inspect_lanes` for copies of a stage.

    Args:
        stage: Stage of which the fleet has copies.
        layout: Layout of the lanes in GPU memory.
        tools: Functions that compile for the device.
    """
    sizes = (layout.lanes, layout.axes, layout.switches, stage.state.bus, bool(stage.state.clockwork["encoders"][0]))
    return _compile_lane_kernels(stage.chips[0].CORE, sizes, tools)


@cache
def _compile_lane_kernels(core: ModuleType, sizes: tuple[int, ...], tools: CompilerTools) -> tuple[Any, Any]:
    """Compile the kernels for chips of one family, with arrays of the given sizes on each thread's stack."""
    lanes, axes, switches, bus, encoders = sizes
    state = vars(core)["STATE"]
    modules = DeviceModules(core, tools)
    dtypes = {
        "W_STATE": (state, 1), "W_AXES": (engine_records.AXIS, axes), "W_DRIVES": (DRIVE, axes),
        "W_SWITCHES": (engine_records.SWITCH, switches), "W_WORLD": (engine_records.STAGE_TIME, 1), "W_HOST": (PROGRAM_STATE, 1),
    }  # fmt: skip
    names = {name: dtype.itemsize // 8 * n for name, (dtype, n) in dtypes.items()}
    names |= {"STATE": state, "DRIVE": DRIVE, "LANES": lanes, "AXES": axes, "SWITCHES": switches}
    names |= {"BUS": bus, "HAS_ENCODERS": bool(encoders), **tools.lane_names}
    module = modules.copy_module("stage.sim.gpu.lane_kernel", names)
    return tuple(modules.compile_function(name, module, tools.kernel) for name in ("advance_lanes", "inspect_lanes"))
