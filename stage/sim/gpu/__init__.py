"""A fleet on a GPU: physics by mujoco-warp, chips and drives by a kernel of numba-cuda, in one CUDA graph. See docs/gpu.md.

`Fleet(..., device="cuda")` makes a `GpuFleet` (gpu_fleet.py) of copies of one stage. A *lane* is one chip of one copy and the
axes that it drives: one thread of the kernel. lane_memory_layout.py says which words of memory hold a lane's records,
lane_kernel.py what a lane does in a physics step; gpu_compilation.py compiles it together with the hot functions that the CPU runs;
warp_physics.py has the part of mujoco-warp. numba-cuda and mujoco-warp are loaded when the first such fleet is made.
"""
