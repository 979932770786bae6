"""One instruction of x86-64 on the registers that a signal has saved, compiled: what reaches a window becomes bus cycles.

An instruction that is not in the table, or needs memory that nobody knows here, is left to the processor; nothing was done then.
"""

from __future__ import annotations

import numpy as np

from stage.board.x86.arithmetic import change_bit, compute, holds, shift
from stage.board.x86.operands import access, fit, follows, get, modrm, put, put_register, span_of, take
from stage.board.x86.records import (
    CF,
    DF,
    DONE,
    FLAGS,
    LEFT,
    OF,
    RAX,
    RBP,
    RCX,
    RDI,
    REGISTERS,
    RIP,
    RSI,
    RSP,
    SPAN,
    WINDOW,
)
from stage.board.x86.table import (
    BT,
    BTC,
    CALL,
    CMOV,
    CMP,
    DEC,
    FULL,
    GROUP,
    GROUP_DONE,
    GROUPS,
    IMM,
    IMUL,
    IMUL3,
    JCC,
    JMP,
    LEAVE,
    MOV,
    MOVS,
    MOVZX,
    NEG,
    NOP,
    NOT,
    OPCODE,
    POP,
    PUSH,
    RET,
    SETCC,
    SIGN,
    STOS,
    TEST,
    UP_TO_4,
    XCHG,
)
from stage.native import array_at, hot

_I8 = np.dtype("i8")
_ROWS = GROUPS + 8 * (GROUP_DONE - GROUP)


@hot
def _string(s, space, what, repeated, size):
    """MOVS, STOS, once or as often as RCX says."""
    regs = array_at(s.regs, REGISTERS, _I8)
    if regs[FLAGS] & DF:
        s.status = LEFT
        return
    left = int(regs[RCX]) if repeated else 1
    while left > 0:
        value = int(regs[RAX]) if what == STOS else access(s, space, int(regs[RSI]), size, 0, False)
        if s.status == DONE:
            access(s, space, int(regs[RDI]), size, value, True)
        if s.status:
            return
        regs[RDI] += size
        if what == MOVS:
            regs[RSI] += size
        left -= 1
        if repeated:
            regs[RCX] = left


@hot
def _go(s, space, what, value):
    """Jumps and the stack."""
    regs = array_at(s.regs, REGISTERS, _I8)
    top = int(regs[RSP])
    if what in (JMP, JCC):
        s.at = value
    elif what in (CALL, PUSH):
        access(s, space, top - 8, 8, int(s.at) if what == CALL else value, True)
        if s.status == DONE:
            regs[RSP] = top - 8
            if what == CALL:
                s.at = value
    else:
        if what == LEAVE:
            top = int(regs[RBP])
        value = access(s, space, top, 8, 0, False)
        if s.status == DONE:
            regs[RSP] = top + 8
            if what == RET:
                s.at = value
            elif what == POP:
                put_register(s, s.rm, 8, value)
            else:
                regs[RBP] = value


@hot
def _move(s, space, op, what, size, source_size, value, condition):
    """Moves and what is like one. Returns what the target gets."""
    if what == MOVZX:
        return value & ((1 << 8 * source_size) - 1)
    if what == NOT:
        return ~value
    if what == SIGN:
        return -1 if value < 0 else 0
    if what in (SETCC, CMOV):
        yes = holds(int(array_at(s.regs, REGISTERS, _I8)[FLAGS]), condition)
        if what == SETCC:
            return 1 if yes else 0
        return value if yes else get(s, s.reg, size)
    if what in (IMUL, IMUL3):
        if size == 8:
            s.status = LEFT
            return 0
        product = value * (get(s, s.reg, size) if what == IMUL else int(s.immediate))
        s.mask, s.changes = CF | OF, 0 if fit(product, size) == product else CF | OF
        return product
    return value


@hot
def _perform(s, space, op, what, size, source_size, byte):
    """What the instruction does; flags are in `s`."""
    regs = array_at(s.regs, REGISTERS, _I8)
    target, source = op.target, op.source
    if what >= MOVS:
        _string(s, space, what, s.repeated, size)
        return
    value = take(s, space, source, source_size)
    if s.status:
        return
    if PUSH <= what <= LEAVE:
        if source == IMM and what != PUSH:
            value += int(s.at)
        if what != JCC or holds(int(regs[FLAGS]), byte):
            _go(s, space, what, value)
        return
    if MOV <= what <= NOP:
        if what == XCHG:
            other = take(s, space, target, size)
            if s.status == DONE:
                put(s, space, target, size, value)
            if s.status == DONE:
                put(s, space, source, size, other)
            return
        value = _move(s, space, op, what, size, source_size, value, byte)
    else:
        if BT <= what <= BTC:
            if source == IMM:
                value &= 8 * size - 1
            s.ea += value // (8 * size) * size
            value &= 8 * size - 1
        left = take(s, space, target, size) if what != NEG else 0
        if s.status:
            return
        if what <= DEC:
            value = compute(s, what, left, value, size)
        elif what < MOV:
            value = shift(s, what, left, value, size)
        else:
            value = change_bit(s, what, left, value, size)
    if s.status == DONE and what != CMP and what != TEST and what != BT:
        put(s, space, target, size, value)


@hot
def step(s, space):
    """The instruction at RIP, and RIP then is behind it; if `s.status` is not DONE, nothing was done."""
    regs = array_at(s.regs, REGISTERS, _I8)
    s.start = s.at = regs[RIP]
    s.status, s.rex, s.memory, s.ea, s.mask, s.repeated = DONE, 0, 0, 0, 0, 0
    narrow = locked = short = relative = False
    byte = follows(s, 1) & 0xFF
    while True:
        if byte == 0x66:
            narrow = True
        elif byte == 0xF2 or byte == 0xF3:
            s.repeated = 1
        elif byte == 0xF0:
            locked = True
        elif byte == 0x67:
            short = True
        elif byte & ~0x18 != 0x26:  # prefixes for segments that begin at 0
            break
        byte = follows(s, 1) & 0xFF
    if byte >> 4 == 4:
        s.rex = byte
        byte = follows(s, 1) & 0xFF
    if byte == 0x0F:
        byte = 0x100 | follows(s, 1) & 0xFF
    s.rm = byte & 7 | (s.rex & 1) << 3
    table = array_at(space.opcodes, _ROWS, OPCODE)
    op = table[byte]
    size = int(op.width) or (8 if s.rex & 8 else 2 if narrow else 4)
    if op.modrm:
        relative = modrm(s)
    member = op
    if op.what >= GROUP:
        member = table[GROUPS + 8 * (op.what - GROUP) + (s.reg & 7)]
        if member.target or member.source:
            op = member
            size = int(op.width) or size
    what, n = int(member.what), int(op.immediate)
    if member.known == 0 or (byte == 0x90 and s.rex & 1):
        s.status = LEFT
        return
    if n:
        s.immediate = follows(s, size if n == FULL else (4 if size > 4 else size) if n == UP_TO_4 else n)
        if n == 8:
            s.memory, s.ea = 1, s.immediate
    if relative:
        s.ea += s.at
    if short:
        s.ea &= 0xFFFFFFFF
    if locked and s.memory:
        at = span_of(space, s.ea)
        if at == 0 or not array_at(at, 1, SPAN)[0].kind & WINDOW:
            s.status = LEFT  # only the processor does it in one step
            return
    source_size = int(op.source_width) or size
    if byte == 0x98:
        source_size = size // 2
    _perform(s, space, op, what, size, source_size, byte)
    if s.status == DONE:
        if s.mask:
            regs[FLAGS] = regs[FLAGS] & ~s.mask | s.changes & s.mask
        regs[RIP] = s.at
