"""The handler of faults, compiled: an access to a window has raised SIGSEGV, and becomes a bus cycle.

A signal takes as long as ten bus cycles. So the handler goes on with the instructions behind the access as long as it can, for up
to FAR of them after each access: a loop that polls a register, or one that writes a table, then takes a single signal.
"""

from __future__ import annotations

import numpy as np

from stage.board.host import BEYOND_WINDOW, NO_CYCLE
from stage.board.x86 import processor
from stage.board.x86.operands import access, span_of
from stage.board.x86.records import (
    BEYOND,
    CODE,
    DONE,
    PAGE,
    RAX,
    RCX,
    RDI,
    RDX,
    REGISTERS,
    RIP,
    RSI,
    RSP,
    SPACE,
    SPAN,
    STEP,
    WINDOW,
)  # fmt: skip
from stage.native import array_at, called, exported

FAR = 200
SAME_STACK, RED_ZONE = 1 << 16, 128
"""Bytes from the handler up to the firmware, if it has no stack of its own; bytes below rsp that are the firmware's."""
ADDRESS, REGS = 16, 40
"""In siginfo_t, ucontext_t."""

_I8 = np.dtype("i8")
_request = called("i8", "i8", "i4", "i8", "i8")
_signal = called("i8", "i4", "i8")


@exported("i4", "i4", "i8", "i8", SPACE, STEP)
def on_fault(number, info, context, space, s):
    """int32_t on_fault(int32_t signal, siginfo_t *, ucontext_t *, SPACE *, STEP *): what the thunk of mapping.py calls, with a STEP
    on the handler's stack. 0: none of our business."""
    address = int(array_at(info + ADDRESS, 1, _I8)[0])
    at, regs = span_of(space, address), array_at(context + REGS, REGISTERS, _I8)
    jumped = regs[RIP] == address  # registers are no instructions
    if at == 0 or jumped or not array_at(at, 1, SPAN)[0].kind & (WINDOW | PAGE):
        if space.previous > 1:
            return 0
        _signal(space.signal, (number, 0))  # it happens again, and then ends the process
        return 1
    space.faults += 1
    s.regs, s.since = context + REGS, 0
    s.stack = regs[RSP]
    same = 0 < s.stack - s.own < SAME_STACK
    s.floor = s.stack - RED_ZONE if same else s.stack & ~0xFFF
    processor.step(s, space)
    if s.status:
        what = BEYOND_WINDOW if s.status == BEYOND else NO_CYCLE
        _request(space.request, (array_at(at, 1, SPAN)[0].host, what, s.own, address))
        return 1
    while s.since < FAR:
        if regs[RIP] == space.request:  # as ps_delay_us does: no reason to return to the processor
            back = access(s, space, int(regs[RSP]), 8, 0, False)
            if s.status:
                return 1
            given = int(regs[RDI]), int(regs[RSI]), int(regs[RDX]), int(regs[RCX])
            regs[RAX] = _request(space.request, given)
            regs[RIP], regs[RSP], s.since = back, int(regs[RSP]) + 8, 0
        at = span_of(space, int(regs[RIP]))
        if at == 0 or not array_at(at, 1, SPAN)[0].kind & CODE:
            return 1
        s.since += 1
        processor.step(s, space)
        if s.status != DONE:
            return 1
    return 1
