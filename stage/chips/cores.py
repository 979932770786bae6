"""What a stage asks of a chip, whatever its family: the type of its record says which core answers.

A family is a module of compiled functions, its *core*, over records of its `STATE`, in an array `rows` of one family's chips.
Add it to FAMILIES, and every loop of the package takes it. Of chip `c` and its axis `j` (0 up to AXES - 1):

    run(c, until)                     let its clock run up to `until`
    net(c, j)                         pulses ever, plus minus minus
    mean_count(c, j, before, ticks)   mean of `net` over the last `ticks`; it was `before` at their start
    pulse_rate(c, j, hz)              output frequency now, pps
    counter(c, j)                     what counts the pulses for the host: R0, LP
    inputs(c, j), set_input(c, j, word), outputs(c, j)     pins as words
    status(c, j), busy(c, j)          the status word; a drive is in progress
    peek(c, address)                  what a host would like to read there now: no bus cycle, nothing changes
    write(rows, i, address, value), read(rows, i, address)     bus cycles

and, for `Chip` alone, power_up, set_inputs, pins, advance, trace, scan and mark, see stage/chips/pcl240/core.py.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.core import types
from numba.extending import overload

from stage.chips.nova import core as nova
from stage.chips.pcl240 import core as pcl240
from stage.compiled import COMPILED

FAMILIES: tuple[Any, ...] = (pcl240, nova)
_BY_TYPE = {numba.from_dtype(core.STATE): core for core in FAMILIES} if COMPILED else {}
_BY_DTYPE = {core.STATE: core for core in FAMILIES}


def _answering(name: str) -> Any:
    """The function `name` of the core whose records, or rows of records, the first argument holds."""

    def answer(c, *arguments):  # type: ignore[no-untyped-def]
        return getattr(_BY_DTYPE[c.dtype], name)(c, *arguments)

    if COMPILED:

        @overload(answer)
        def choose(c, *arguments):  # type: ignore[no-untyped-def]
            function = getattr(_BY_TYPE[c.dtype if isinstance(c, types.Array) else c], name)

            def call(c, *arguments):  # type: ignore[no-untyped-def]
                return function(c, *arguments)

            return call

    return answer


run, net, mean_count, pulse_rate = (
    _answering("run"),
    _answering("net"),
    _answering("mean_count"),
    _answering("pulse_rate"),
)
counter, inputs, set_input, outputs = map(_answering, ("counter", "inputs", "set_input", "outputs"))
status, busy, peek, write, read = map(_answering, ("status", "busy", "peek", "write", "read"))
