"""Compile hot functions for a GPU: one source for CPU and GPU.

A hot function finds the functions that it calls in its module's globals. `DeviceModules` copies a module: same code, but each
function is a device function of numba-cuda, and its globals are those of the copy. Calls by address, which a GPU does not have,
become direct calls: the copy of stage.chips.core_interface calls the core of one family.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

from stage import native
from stage.chips import core_interface
from stage.support.extras import import_extra

FEATURE_NAME = "a fleet on a GPU"
"""Name of the feature that needs the libraries, for error messages."""
FULL_WARP_MASK = 0xFFFFFFFF
INLINED_FUNCTIONS = ("_get_flag_edges",)
"""Functions that return an array made from an address, which numba-cuda only takes where it is inlined."""


class LaneChip(NamedTuple):
    """Chip of a lane, a tuple that device code uses in place of a CHIP record.

    Attributes:
        state: STATE record of the chip.
        axes: Number of axes.
        hz: Reference clock, Hz.
        ticks: Reference clocks in a slice.
    """

    state: Any
    axes: int
    hz: int
    ticks: float


@dataclass(frozen=True, eq=False)
class CompilerTools:
    """Functions that compile Python functions for a GPU.

    Attributes:
        device: Compiles a function to a device function, which kernels call.
        kernel: Compiles a function to a kernel.
        replaced: Function of stage.native -> the device function that replaces it.
        lane_names: Name -> object of the additional names in the copy of lane_kernel.py.
    """

    device: Callable[[FunctionType], Any]
    kernel: Callable[[FunctionType], Any]
    replaced: Mapping[Any, Any]
    lane_names: Mapping[str, Any]


@cache
def make_cuda_tools() -> CompilerTools:
    """Make the compiler tools for numba-cuda.

    Raises:
        ExtraMissing: numba-cuda is not installed.
    """
    import_extra("numba_cuda", FEATURE_NAME)
    cuda = import_extra("numba.cuda", FEATURE_NAME)
    extending, types = import_module("numba.cuda.extending"), import_module("numba.cuda.types")
    cgutils = import_module("numba.cuda.cgutils")
    ir: Any = import_module("llvmlite.ir")

    def build_array_value(context: Any, builder: Any, kind: Any, data: Any, shape: list[Any]) -> Any:
        """Build numba's value of a contiguous array whose memory begins at the pointer `data`."""
        size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
        strides, items = [size], context.get_constant(types.intp, 1)
        for length in reversed(shape[1:]):
            strides.insert(0, builder.mul(strides[0], length))
        for length in shape:
            items = builder.mul(items, length)
        array = cgutils.create_struct_proxy(kind)(context, builder)
        array.data, array.itemsize, array.nitems = data, size, items
        array.shape, array.strides = cgutils.pack_array(builder, shape), cgutils.pack_array(builder, strides)
        return array._getvalue()

    @extending.intrinsic
    def array_at(_context: Any, address: Any, shape: Any, dtype: Any) -> Any:
        several = isinstance(shape, types.BaseTuple)
        kind = types.Array(dtype.dtype, len(shape) if several else 1, "C")

        def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            lengths = cgutils.unpack_tuple(builder, values[1]) if several else [values[1]]
            lengths_as_words = [
                context.cast(builder, n, t, types.intp)
                for n, t in zip(lengths, shape if several else [shape], strict=True)
            ]
            word = context.cast(builder, values[0], address, types.intp)
            data = builder.inttoptr(word, context.get_data_type(kind.dtype).as_pointer())
            return build_array_value(context, builder, kind, data, lengths_as_words)

        return kind(address, shape, dtype), lower

    literal: Any = vars(extending)["_intrinsic"](prefer_literal=True)

    @literal
    def allocate_on_stack(_context: Any, rows: Any, columns: Any) -> Any:
        kind = types.Array(types.float64, 2, "C")

        def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            words = rows.literal_value * columns.literal_value
            place = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), words))
            data = builder.bitcast(place, ir.DoubleType().as_pointer())
            shape = [context.get_constant(types.intp, n.literal_value) for n in (rows, columns)]
            return build_array_value(context, builder, kind, data, shape)

        return kind(rows, columns), lower

    @literal
    def view_as_words(_context: Any, records: Any, count: Any) -> Any:
        kind = types.Array(types.int64, 1, "C")

        def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            array = cgutils.create_struct_proxy(signature.args[0])(context, builder, value=values[0])
            data = builder.bitcast(array.data, ir.IntType(64).as_pointer())
            return build_array_value(
                context, builder, kind, data, [context.get_constant(types.intp, count.literal_value)]
            )

        return kind(records, count), lower

    @cuda.jit(device=True)
    def floor(x: Any) -> Any:
        return cuda.libdevice.floor(float(x))

    @cuda.jit(device=True)
    def is_any_true_in_warp(condition: Any) -> Any:
        return cuda.any_sync(FULL_WARP_MASK, condition)

    @cuda.jit(device=True)
    def read_value_in_warp(value: Any, thread: Any) -> Any:
        return cuda.shfl_sync(FULL_WARP_MASK, value, thread)

    @cuda.jit(device=True)
    def get_thread_number() -> Any:
        return cuda.grid(1)

    return CompilerTools(
        device=lambda f: cuda.jit(device=True, inline="always" if f.__name__ in INLINED_FUNCTIONS else "never")(f),
        kernel=cuda.jit,
        replaced={native.array_at: array_at, native.allocate_on_stack: allocate_on_stack, native.floor: floor},
        lane_names={
            "is_any_true_in_warp": is_any_true_in_warp, "read_value_in_warp": read_value_in_warp,
            "get_thread_number": get_thread_number, "view_as_words": view_as_words, "cuda": cuda,
        },
    )  # fmt: skip


class DeviceModules:
    """Copies of hot modules for chips of one family, as device functions.

    Args:
        core: The family's core.
        tools: Functions that compile for the device.
    """

    def __init__(self, core: ModuleType, tools: CompilerTools):
        self._tools = tools
        self._modules: dict[str, ModuleType] = {}
        self._functions: dict[FunctionType, Any] = {}
        family = self.copy_module(core.__name__)
        self._modules[core_interface.__name__] = self._make_static_core_interface(family)

    def copy_module(self, name: str, replacements: Mapping[str, Any] | None = None) -> ModuleType:
        """Copy a hot module for the GPU: its functions become device functions. A second call returns the same copy.

        Args:
            name: Full name of the module.
            replacements: Names of the copy that differ from the module's, with their objects.
        """
        if name in self._modules:
            return self._modules[name]
        module_copy = self._modules[name] = ModuleType(name)
        source = vars(import_module(name))
        vars(module_copy).update(source)
        for key, value in source.items():
            if not key.startswith("__"):
                vars(module_copy)[key] = self._copy_value(value, module_copy)
        vars(module_copy).update(replacements or {})
        return module_copy

    def compile_function(self, name: str, module: ModuleType, compiler: Any) -> Any:
        """Compile a function of a module in a copy of this module.

        Args:
            name: Name of the function.
            module: Copy of the module, see `copy_module`.
            compiler: `device` or `kernel` of the compiler tools.
        """
        function = vars(import_module(module.__name__))[name]
        return compiler(FunctionType(function.__code__, vars(module), name))

    def _copy_value(self, value: Any, module: ModuleType) -> Any:
        """Return the object that replaces a global of a module in the module's copy: a device function for a hot function."""
        if isinstance(value, native.ExportedFunction):
            value = value.function
        for function, replacement in self._tools.replaced.items():
            if value is function:
                return replacement
        if isinstance(value, ModuleType) and value.__name__.startswith("stage."):
            return self.copy_module(value.__name__)
        if not isinstance(value, FunctionType) or not value.__module__.startswith("stage."):
            return value
        home = module if value.__module__ == module.__name__ else self.copy_module(value.__module__)
        if value not in self._functions:
            copy = FunctionType(value.__code__, vars(home), value.__name__, value.__defaults__, value.__closure__)
            self._functions[value] = self._tools.device(copy)
        return self._functions[value]

    def _make_static_core_interface(self, core: ModuleType) -> ModuleType:
        """Make a copy of stage.chips.core_interface for `LaneChip` tuples, which calls the core of one family directly."""
        module_copy = ModuleType(core_interface.__name__)
        vars(module_copy).update(
            {name: value for name, value in vars(core_interface).items() if isinstance(value, int)}
        )
        sources = {
            "find_stage_axis": "def find_stage_axis(chip, axis_index): return axis_index",
            "read_clock": "def read_clock(chip): return chip.state.clock",
        }
        for name, (_, *arguments) in core_interface.ANSWERS.items():
            values = ", ".join("xyz"[: len(arguments)])
            sources[name] = f"def {name}(chip, {values}): return core.{name}(chip.state, {values})"
        for name, source in sources.items():
            space: dict[str, Any] = {"core": core}
            exec(source, space)
            vars(module_copy)[name] = self._tools.device(space[name])
        return module_copy
