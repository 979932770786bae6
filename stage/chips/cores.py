"""What a stage asks of a chip, whatever its family: the type of its record says which core answers.

A family is a module of compiled functions, its *core*, over records of its `STATE`, in an array `rows` of one family's chips.
Add its package to FAMILIES of stage/chips, and every loop takes it. Of chip `c` and its axis `j` (0 up to AXES - 1):

    run(c, until)                     let its clock run up to `until`
    see(c, j, count, rate)            from now on the shaft is at `count + rate * clocks`, in counts of its encoder; only where
                                      the axis has one
    net(c, j)                         where it wants the axis: pulses ever, plus minus minus; the encoder's count of a servo
    mean_count(c, j, before, ticks)   what the drive gets, its mean over the last `ticks`: `net`, which was `before` at their
                                      start; the motor command of a servo, -1 to 1
    pulse_rate(c, j, hz)              how fast `net` moves now, a second
    counter(c, j)                     what counts the pulses for the host: R0, LP
    inputs(c, j), set_input(c, j, word), outputs(c, j)     pins as words
    status(c, j), busy(c, j)          the status word; a drive is in progress
    peek(c, address)                  what a host would like to read there now: no bus cycle, nothing changes
    write(rows, i, address, value), read(rows, i, address)     bus cycles

and, for `Chip` alone, power_up, set_inputs, pins, advance, trace, scan and mark, see stage/chips/pcl240/core.py; of a servo
scan_seen as well, see stage/chips/hctl1100/core.py.
"""

from __future__ import annotations

import sys
from functools import cache
from inspect import signature
from types import ModuleType
from typing import Any

import numba
from numba.core import types
from numba.core.imputils import lower_constant
from numba.extending import models, overload, register_model, typeof_impl

from stage.chips import FAMILIES
from stage.compiled import COMPILED


def loaded() -> list[ModuleType]:
    """The cores of the families that are loaded, in the order of FAMILIES."""
    return [sys.modules[name] for family in FAMILIES if (name := f"stage.chips.{family}.core") in sys.modules]


@cache
def _of_dtype(dtype: Any) -> ModuleType:
    return next(core for core in loaded() if dtype == core.STATE)


@cache
def _of_type(record: Any) -> ModuleType:
    return next(core for core in loaded() if numba.from_dtype(core.STATE) == record)


class Answer:
    """The function `name` of the core whose record, or rows of records, the first argument is: in compiled code as if that
    function had been called by its own name."""

    def __init__(self, name: str):
        self.name = name

    def __call__(self, c: Any, *arguments: Any) -> Any:
        return getattr(_of_dtype(c.dtype), self.name)(c, *arguments)


class AnswerType(types.Callable, types.Opaque):
    """What numba knows of an `Answer`: that of the core's function."""

    def __init__(self, name: str):
        self.answer = name
        super().__init__(f"Answer({name})")

    def _function(self, c: Any) -> Any:
        core = _of_type(c.dtype if isinstance(c, types.Array) else c)
        return numba.typeof(getattr(core, self.answer))

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        return self._function(args[0]).get_call_type(context, args, kws)

    def get_call_signatures(self) -> Any:
        return (), True

    def get_impl_key(self, sig: Any) -> Any:
        return self._function(sig.args[0]).get_impl_key(sig)


@typeof_impl.register(Answer)
def _typeof_answer(value: Answer, _context: Any) -> AnswerType:
    return AnswerType(value.name)


register_model(AnswerType)(models.OpaqueModel)


@lower_constant(AnswerType)
def _constant_answer(context: Any, _builder: Any, _type: Any, _value: Any) -> Any:
    return context.get_dummy_value()


def over_families(function: Any) -> Any:
    """function(rows, first, *arguments) as a function of (chips, *arguments): called for the rows of each family in the tuple
    `chips`, of which `first` come before them; the greatest of the results."""
    given = ", ".join(list(signature(getattr(function, "py_func", function)).parameters)[2:])

    def write(families: int) -> Any:
        lines = [f"def call(chips, {given}):", f"    result = function(chips[0], 0, {given})"]
        before = "len(chips[0])"
        for k in range(1, families):
            lines.append(f"    result = max(result, function(chips[{k}], {before}, {given}))")
            before += f" + len(chips[{k}])"
        return _written("\n".join([*lines, "    return result"]), function=function)

    stub = _written(f"def call(chips, {given}):\n    return write(len(chips))(chips, {given})", write=write)
    if COMPILED:
        choose = _written(f"def call(chips, {given}):\n    return write(len(chips))", write=write)
        overload(stub, inline="always")(choose)
    return stub


def _written(source: str, **names: Any) -> Any:
    """The function `call` of `source`: numba wants parameters by name, where we would say *arguments."""
    space: dict[str, Any] = {**names, "__name__": __name__}
    exec(source, space)
    return space["call"]


run, see, net, mean_count, pulse_rate = map(Answer, ("run", "see", "net", "mean_count", "pulse_rate"))
counter, inputs, set_input, outputs = map(Answer, ("counter", "inputs", "set_input", "outputs"))
status, busy, peek, write, read = map(Answer, ("status", "busy", "peek", "write", "read"))
