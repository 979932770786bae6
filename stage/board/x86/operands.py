"""Operands of instructions, compiled: registers, memory, windows, what follows the opcode.

Memory that is no window is touched only where it is known to be there: the firmware's own code and data, and its stack.
"""

from __future__ import annotations

import numpy as np

from stage.board.host import IN8, IN16, IN32, OUT8, OUT16, OUT32
from stage.board.x86.records import (
    ABOVE_STACK,
    BEYOND,
    LEFT,
    PAGE,
    PLACES,
    READ,
    REGISTERS,
    ROW,
    SPAN,
    SPANS,
    STACK,
    WINDOW,
    WRITE,
)
from stage.board.x86.table import CL, EA, IMM, ONE, A, D, E, G, R
from stage.native import array_at, called, hot

_U1, _I1, _I2, _I4, _I8 = (np.dtype(name) for name in ("u1", "i1", "i2", "i4", "i8"))
_request = called("i8", "i8", "i4", "i8", "i8")


@hot
def fit(value, size):
    """The low `size` bytes as a signed number."""
    if size == 8:
        return (((value >> 32 & 0xFFFFFFFF) ^ 0x80000000) - 0x80000000) << 32 | value & 0xFFFFFFFF
    top = 1 << (8 * size - 1)
    return ((value & (2 * top - 1)) ^ top) - top


@hot
def _place(n):
    return PLACES >> 4 * n & 15


@hot
def get(s, n, size):
    regs = array_at(s.regs, REGISTERS, _I8)
    if size == 1 and s.rex == 0 and 4 <= n < 8:  # AH, CH, DH, BH
        return fit(int(regs[_place(n - 4)]) >> 8, 1)
    return fit(int(regs[_place(n)]), size)


@hot
def put_register(s, n, size, value):
    regs = array_at(s.regs, REGISTERS, _I8)
    if size == 8:
        regs[_place(n)] = value
    elif size == 4:
        regs[_place(n)] = value & 0xFFFFFFFF
    elif size == 2:
        regs[_place(n)] = int(regs[_place(n)]) & ~0xFFFF | value & 0xFFFF
    elif s.rex == 0 and 4 <= n < 8:
        regs[_place(n - 4)] = int(regs[_place(n - 4)]) & ~0xFF00 | (value & 0xFF) << 8
    else:
        regs[_place(n)] = int(regs[_place(n)]) & ~0xFF | value & 0xFF


@hot
def _on_stack(s, address, size):
    """Whether this is memory of the stack that is there in any thread."""
    return s.floor <= address and address + size <= s.stack + ABOVE_STACK


@hot
def span_of(space, address):
    """Where the first SPAN with the address lies, or 0."""
    first, k = int(space.spans), 0
    spans = array_at(first, SPANS, SPAN)
    while spans[k].kind:
        if spans[k].begin <= address < spans[k].end:
            return first + k * ROW
        k += 1
    return 0


@hot
def access(s, space, address, size, value, writes):
    """Memory is read or written, by a bus cycle where it is a window."""
    at = 0 if _on_stack(s, address, size) else span_of(space, address)
    if at:
        span = array_at(at, 1, SPAN)[0]
        inside = address + size <= span.end
        if span.kind & WINDOW and inside:
            s.since = 0
            port, half = int(span.port + address - span.begin), 4 if size == 8 else size
            if writes:
                what = OUT8 if half == 1 else OUT16 if half == 2 else OUT32
                _request(space.request, (span.host, what, port, value))
                if size == 8:
                    _request(space.request, (span.host, what, port + 4, value >> 32))
                return 0
            what = IN8 if half == 1 else IN16 if half == 2 else IN32
            value = _request(space.request, (span.host, what, port, 0))
            if size == 8:
                value |= _request(space.request, (span.host, what, port + 4, 0)) << 32
            return fit(value, size)
        if span.kind & (WINDOW | PAGE):
            s.status = BEYOND
            return 0
        if span.kind & STACK and address < s.floor:
            s.status = LEFT
            return 0
        if not inside or not span.kind & (WRITE if writes else READ):
            s.status = LEFT
            return 0
    elif not _on_stack(s, address, size):
        s.status = LEFT
        return 0
    if size == 1:
        if writes:
            array_at(address, 1, _I1)[0] = fit(value, 1)
        return int(array_at(address, 1, _I1)[0])
    if size == 2:
        if writes:
            array_at(address, 1, _I2)[0] = fit(value, 2)
        return int(array_at(address, 1, _I2)[0])
    if size == 4:
        if writes:
            array_at(address, 1, _I4)[0] = fit(value, 4)
        return int(array_at(address, 1, _I4)[0])
    if writes:
        array_at(address, 1, _I8)[0] = value
    return int(array_at(address, 1, _I8)[0])


@hot
def follows(s, size):
    """The next bytes of the instruction, signed."""
    value = 0
    for k in range(size):
        value |= int(array_at(s.at + k, 1, _U1)[0]) << 8 * k
    s.at += size
    return fit(value, size)


@hot
def modrm(s):
    """The byte behind the opcode, and where E lies. Returns whether what follows the instruction is to be added."""
    byte = follows(s, 1) & 0xFF
    mode, rm = byte >> 6, byte & 7
    s.reg = byte >> 3 & 7 | (s.rex & 4) << 1
    if mode == 3:
        s.rm = rm | (s.rex & 1) << 3
        return False
    regs, address, relative = array_at(s.regs, REGISTERS, _I8), 0, False
    if rm == 4:
        sib = follows(s, 1) & 0xFF
        index, rm = sib >> 3 & 7 | (s.rex & 2) << 2, sib & 7
        if index != 4:
            address = int(regs[_place(index)]) << (sib >> 6)
        if rm == 5 and mode == 0:
            address += follows(s, 4)
        else:
            address += int(regs[_place(rm | (s.rex & 1) << 3)])
    elif rm == 5 and mode == 0:
        address, relative = follows(s, 4), True
    else:
        address = int(regs[_place(rm | (s.rex & 1) << 3)])
    if mode == 1:
        address += follows(s, 1)
    elif mode == 2:
        address += follows(s, 4)
    s.memory, s.ea = 1, fit(address, 8)
    return relative


@hot
def take(s, space, kind, size):
    """The value of an operand; 0 with a status if it cannot be had."""
    if kind == E and s.memory:
        return access(s, space, s.ea, size, 0, False)
    if kind in (E, R):
        return get(s, s.rm, size)
    if kind == G:
        return get(s, s.reg, size)
    if kind == IMM:
        return int(s.immediate)
    if kind == A:
        return get(s, 0, size)
    if kind == CL:
        return get(s, 1, 4) & 0xFF
    if kind == EA:
        return int(s.ea)
    return 1 if kind == ONE else 0


@hot
def put(s, space, kind, size, value):
    """An operand gets a value, or there is a status."""
    if kind == E and s.memory:
        access(s, space, s.ea, size, value, True)
    elif kind in (E, R):
        put_register(s, s.rm, size, value)
    elif kind == G:
        put_register(s, s.reg, size, value)
    elif kind == A:
        put_register(s, 0, size, value)
    elif kind == D:
        put_register(s, 2, size, value)
