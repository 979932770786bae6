"""Executes one instruction of x86-64 on the registers that a signal has saved, compiled: accesses to windows become bus cycles.

`on_fault` handles the fault of an access to a window. A signal takes as long as ten bus cycles, so it goes on with the instructions
behind the access as long as it can: a loop that polls a register, or one that writes a table, then takes a single signal. An
instruction that is not in the table, or needs memory that nobody knows here, is left to the processor, and nothing was done then.
Memory that is no window is touched only where it is known to be there: the firmware's own code and data, and its stack.
"""

from __future__ import annotations

import numpy as np

from stage.board.bus import host_record
from stage.board.isolation.traps import instructions as x86
from stage.native import array_at, called, exported, hot, record

SPAN = record([(name, "i8") for name in "begin end kind port host".split()])
"""A range of addresses, the kind of what is there, and of a window its first port and its HOST."""
READABLE, WRITABLE, CODE, WINDOW, PAGE, STACK = 1, 2, 4, 8, 16, 32
"""Kinds: memory that can be read, written, executed; a window; the rest of a window's pages; the stack of the firmware."""
SPANS = 256
"""Rows of a table; a row of kind 0 is behind the last."""
ROW = SPAN.itemsize

SPACE = record([(name, "i8") for name in "request opcodes spans previous signal faults".split()])
"""Data of the handler of faults: the function for requests, the table of instructions, SPANs, the handler before it, the function
`signal` of C, and how many faults were accesses to windows."""
_STEP = "own regs start at prefixes rex memory ea rm reg immediate status changes mask stack floor since"
STEP = record([(name, "i8") for name in _STEP.split()])
"""
    own             where this record is
    regs            where the saved registers are
    start, at       where the instruction begins, and how far it has been read
    prefixes, rex   NARROW, ... and its prefix REX, 0 for none
    memory, ea, rm  whether E lies in memory, and where; otherwise it is register rm
    reg, immediate  G; the number in the instruction
    status          why it is not done
    changes, mask   flags of the result; those that are to be set
    stack, floor    rsp at the fault; below the floor the stack is not to be touched: the handler may be there
    since           instructions since the last cycle
"""

DONE, LEFT, BEYOND = range(3)
"""Status: done; left to the processor; it touches a page of a window, but beyond the window."""
NARROW, REPEATED, LOCKED, SHORT = 1, 2, 4, 8
"""Prefixes: operands of 16 bits; a repeated string instruction; a bus lock; addresses of 32 bits."""

RIP, FLAGS, REGISTERS = 16, 17, 23
RAX, RCX, RDX, RSP, RBP, RSI, RDI = 13, 14, 12, 15, 10, 9, 8
"""Places in the saved registers (gregs of <sys/ucontext.h>)."""
PLACES = 0x7654321089AFBCED
"""The place of each register by its number in instructions, 4 bits each."""
CF, PF, AF, ZF, SF, DF, OF = 1, 4, 16, 64, 128, 1024, 2048
ABOVE_STACK = 2048
"""Bytes above rsp that are there in any thread: what has called it, and the record of the thread."""
_U1, _I8 = np.dtype("u1"), np.dtype("i8")
_request = called("i8", "i8", "i4", "i8", "i8")
_signal = called("i8", "i4", "i8")
MAX_INSTRUCTIONS = 200
"""Instructions behind a bus cycle after which the processor takes over again."""
SAME_STACK, RED_ZONE = 1 << 16, 128
"""Bytes from the handler up to the firmware, if it has no stack of its own; bytes below rsp that are the firmware's."""
ADDRESS, REGS = 16, 40
"""In siginfo_t, ucontext_t."""


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
    """The value of register `n`, `size` bytes of it."""
    regs = array_at(s.regs, REGISTERS, _I8)
    if size == 1 and s.rex == 0 and 4 <= n < 8:  # AH, CH, DH, BH
        return fit(int(regs[_place(n - 4)]) >> 8, 1)
    return fit(int(regs[_place(n)]), size)


@hot
def put_register(s, n, size, value):
    """Write register `n`. As on the processor, 4 bytes clear the upper half and fewer leave the rest."""
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
    """Tell whether this is memory of the stack that is there in any thread."""
    return s.floor <= address and address + size <= s.stack + ABOVE_STACK


@hot
def span_of(space, address):
    """Return where the first SPAN with the address lies, or 0."""
    first, k = int(space.spans), 0
    spans = array_at(first, SPANS, SPAN)
    while spans[k].kind:
        if spans[k].begin <= address < spans[k].end:
            return first + k * ROW
        k += 1
    return 0


@hot
def _is_window(space, address):
    """Tell whether an address lies in a window."""
    at = span_of(space, address)
    return at != 0 and array_at(at, 1, SPAN)[0].kind & WINDOW != 0


@hot
def _load(address, size):
    """Read memory, signed."""
    content, value = array_at(address, size, _U1), 0
    for k in range(size):
        value |= int(content[k]) << 8 * k
    return fit(value, size)


@hot
def _make_cycle(space, span, address, size, value, writes):
    """Make the bus cycle of an access to a window; two of 32 bits for 64."""
    port, half = int(span.port + address - span.begin), 4 if size == 8 else size
    if writes:
        what = host_record.OUT8 if half == 1 else host_record.OUT16 if half == 2 else host_record.OUT32
    else:
        what = host_record.IN8 if half == 1 else host_record.IN16 if half == 2 else host_record.IN32
    answer = _request(space.request, (span.host, what, port, value))
    if size == 8:
        answer |= _request(space.request, (span.host, what, port + 4, value >> 32)) << 32
    return fit(answer, size)


@hot
def access(s, space, address, size, value, writes):
    """Read or write memory, by a bus cycle where it is a window; return what was read. Sets a status if it cannot be done."""
    if not _on_stack(s, address, size):
        at = span_of(space, address)
        if at == 0:
            s.status = LEFT
            return 0
        span = array_at(at, 1, SPAN)[0]
        inside = address + size <= span.end
        if span.kind & WINDOW and inside:
            s.since = 0
            return _make_cycle(space, span, address, size, value, writes)
        if span.kind & (WINDOW | PAGE):
            s.status = BEYOND
            return 0
        below = span.kind & STACK and address < s.floor
        if below or not inside or not span.kind & (WRITABLE if writes else READABLE):
            s.status = LEFT
            return 0
    if writes:
        content = array_at(address, size, _U1)
        for k in range(size):
            content[k] = value >> 8 * k & 0xFF
        return 0
    return _load(address, size)


@hot
def follows(s, size):
    """Read the next bytes of the instruction, signed."""
    s.at += size
    return _load(s.at - size, size)


@hot
def modrm(s):
    """Read the byte behind the opcode, and find where E lies. Return whether it is relative to the end of the instruction."""
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
    """Return the value of an operand; 0 with a status if it cannot be had."""
    if kind == x86.E and s.memory:
        return access(s, space, s.ea, size, 0, False)
    if kind in (x86.E, x86.R):
        return get(s, s.rm, size)
    if kind == x86.G:
        return get(s, s.reg, size)
    if kind == x86.IMM:
        return int(s.immediate)
    if kind == x86.A:
        return get(s, 0, size)
    if kind == x86.CL:
        return get(s, 1, 4) & 0xFF
    if kind == x86.EA:
        return int(s.ea)
    return 1 if kind == x86.ONE else 0


@hot
def put(s, space, kind, size, value):
    """Give an operand a value, or set a status."""
    if kind == x86.E and s.memory:
        access(s, space, s.ea, size, value, True)
    elif kind in (x86.E, x86.R):
        put_register(s, s.rm, size, value)
    elif kind == x86.G:
        put_register(s, s.reg, size, value)
    elif kind == x86.A:
        put_register(s, 0, size, value)
    elif kind == x86.D:
        put_register(s, 2, size, value)


@hot
def _flags(s, mask, carry, overflow, result):
    """Compute the flags of a result; those of `mask` are to be set."""
    low = result & 0xFF
    low ^= low >> 4
    new = (CF if carry else 0) | (OF if overflow else 0) | (ZF if result == 0 else 0) | (SF if result < 0 else 0)
    s.changes = new | (PF if 0x9669 >> (low & 15) & 1 else 0)
    s.mask = mask


@hot
def holds(flags, condition):
    """Tell whether a condition (of a jump, say) holds."""
    k = condition >> 1 & 7
    differ = (flags & SF != 0) != (flags & OF != 0)
    if k >= 6:
        yes = differ or (k == 7 and flags & ZF != 0)
    else:
        mask = OF if k == 0 else CF if k == 1 else ZF if k == 2 else CF | ZF if k == 3 else SF if k == 4 else PF
        yes = flags & mask != 0
    return yes != (condition & 1 == 1)


@hot
def compute(s, what, left, right, size):
    """Compute a sum, a difference or a bitwise operation."""
    carry = overflow = False
    adjust, mask = 0, CF | PF | AF | ZF | SF | OF
    old = int(array_at(s.regs, REGISTERS, _I8)[FLAGS]) & CF
    if what in (x86.ADD, x86.ADC, x86.INC):
        result = fit(left + right + (old if what == x86.ADC else 0), size)
        out = (left & right) | ((left | right) & ~result)
        carry, overflow, adjust = out < 0, (left ^ result) & (right ^ result) < 0, out
    elif what == x86.OR:
        result = left | right
    elif what in (x86.AND, x86.TEST):
        result = left & right
    elif what == x86.XOR:
        result = left ^ right
    else:
        result = fit(left - right - (old if what == x86.SBB else 0), size)
        out = (~left & right) | ((~left | right) & result)
        carry, overflow, adjust = out < 0, (left ^ right) & (left ^ result) < 0, out
    _flags(s, mask & ~CF if what in (x86.INC, x86.DEC) else mask, carry, overflow, result)
    s.changes |= (adjust >> 3 & 1) << 4
    return result


@hot
def shift(s, what, left, count, size):
    """Shift or rotate."""
    bits = 8 * size
    count &= 63 if size == 8 else 31
    s.mask = 0
    if count == 0:
        return left
    unsigned = left if size == 8 else left & ((1 << bits) - 1)
    carry, overflow, mask = left >> (count - 1) & 1 == 1, False, CF | OF | ZF | SF | PF
    if what == x86.SHL:
        result = fit(left << count, size)
        carry = count <= bits and left >> (bits - count) & 1 == 1
        overflow = carry != (result < 0)
    elif what == x86.SAR:
        result = left >> count
    elif what == x86.SHR:
        result, overflow = fit(unsigned >> count & ((1 << (64 - count)) - 1), size), left < 0
        carry = unsigned >> (count - 1) & 1 == 1
    elif size == 8:
        s.status = LEFT
        return left
    else:
        turn, mask = count % bits if what == x86.ROL else -count % bits, CF | OF
        result = fit(unsigned << turn | unsigned >> (bits - turn), size)
        low, high, second = result & 1 == 1, result < 0, result >> (bits - 2) & 1 == 1
        carry, overflow = low if what == x86.ROL else high, high != (low if what == x86.ROL else second)
    _flags(s, mask, carry, overflow, result)
    return result


@hot
def change_bit(s, what, left, number, size):
    """Copy one bit to the carry, and set, reset or invert it."""
    one = 1 << number
    _flags(s, CF, left >> number & 1 == 1, False, 0)
    if what == x86.BT:
        return left
    return fit(left | one if what == x86.BTS else left & ~one if what == x86.BTR else left ^ one, size)


_ROWS = x86.GROUPS + 8 * (x86.GROUP_DONE - x86.GROUP)


@hot
def _string(s, space, what, size):
    """Execute MOVS or STOS, once or as often as RCX says."""
    regs = array_at(s.regs, REGISTERS, _I8)
    if regs[FLAGS] & DF:
        s.status = LEFT
        return
    repeated = s.prefixes & REPEATED
    left = int(regs[RCX]) if repeated else 1
    while left > 0:
        value = int(regs[RAX]) if what == x86.STOS else access(s, space, int(regs[RSI]), size, 0, False)
        if s.status == DONE:
            access(s, space, int(regs[RDI]), size, value, True)
        if s.status:
            return
        regs[RDI] += size
        if what == x86.MOVS:
            regs[RSI] += size
        left -= 1
        if repeated:
            regs[RCX] = left


@hot
def _go(s, space, what, value):
    """Execute a jump, or an instruction of the stack."""
    regs = array_at(s.regs, REGISTERS, _I8)
    top = int(regs[RSP])
    if what in (x86.JMP, x86.JCC):
        s.at = value
    elif what in (x86.CALL, x86.PUSH):
        access(s, space, top - 8, 8, int(s.at) if what == x86.CALL else value, True)
        if s.status == DONE:
            regs[RSP] = top - 8
            if what == x86.CALL:
                s.at = value
    else:
        if what == x86.LEAVE:
            top = int(regs[RBP])
        value = access(s, space, top, 8, 0, False)
        if s.status == DONE:
            regs[RSP] = top + 8
            if what == x86.RET:
                s.at = value
            elif what == x86.POP:
                put_register(s, s.rm, 8, value)
            else:
                regs[RBP] = value


@hot
def _move(s, what, size, source_size, value, condition):
    """Execute a move, or what is like one. Return what the target gets."""
    if what == x86.MOVZX:
        return value & ((1 << 8 * source_size) - 1)
    if what == x86.NOT:
        return ~value
    if what == x86.SIGN:
        return -1 if value < 0 else 0
    if what in (x86.SETCC, x86.CMOV):
        yes = holds(int(array_at(s.regs, REGISTERS, _I8)[FLAGS]), condition)
        if what == x86.SETCC:
            return 1 if yes else 0
        return value if yes else get(s, s.reg, size)
    if what in (x86.IMUL, x86.IMUL3):
        if size == 8:
            s.status = LEFT
            return 0
        product = value * (get(s, s.reg, size) if what == x86.IMUL else int(s.immediate))
        s.mask, s.changes = CF | OF, 0 if fit(product, size) == product else CF | OF
        return product
    return value


@hot
def _exchange(s, space, op, size, value):
    other = take(s, space, op.target, size)
    if s.status == DONE:
        put(s, space, op.target, size, value)
    if s.status == DONE:
        put(s, space, op.source, size, other)


@hot
def _calculate(s, space, op, what, size, value):
    """Execute an instruction that calculates, on its target and a value."""
    if x86.BT <= what <= x86.BTC:
        if op.source == x86.IMM:
            value &= 8 * size - 1
        s.ea += value // (8 * size) * size
        value &= 8 * size - 1
    left = take(s, space, op.target, size) if what != x86.NEG else 0
    if s.status:
        return
    if what <= x86.DEC:
        value = compute(s, what, left, value, size)
    elif what < x86.MOV:
        value = shift(s, what, left, value, size)
    else:
        value = change_bit(s, what, left, value, size)
    if s.status == DONE and what != x86.CMP and what != x86.TEST and what != x86.BT:
        put(s, space, op.target, size, value)


@hot
def _perform(s, space, op, what, size, source_size, byte):
    """Execute a decoded instruction; its flags are in `s`."""
    if what >= x86.MOVS:
        _string(s, space, what, size)
        return
    value = take(s, space, op.source, source_size)
    if s.status:
        return
    if x86.PUSH <= what <= x86.LEAVE:
        if op.source == x86.IMM and what != x86.PUSH:
            value += int(s.at)
        if what != x86.JCC or holds(int(array_at(s.regs, REGISTERS, _I8)[FLAGS]), byte):
            _go(s, space, what, value)
    elif what == x86.XCHG:
        _exchange(s, space, op, size, value)
    elif x86.MOV <= what <= x86.NOP:
        value = _move(s, what, size, source_size, value, byte)
        if s.status == DONE:
            put(s, space, op.target, size, value)
    else:
        _calculate(s, space, op, what, size, value)


@hot
def _read_opcode(s):
    """Read prefixes and opcode of an instruction; 100h | opcode of one behind 0Fh."""
    byte = follows(s, 1) & 0xFF
    while True:
        if byte == 0x66:
            s.prefixes |= NARROW
        elif byte == 0xF2 or byte == 0xF3:
            s.prefixes |= REPEATED
        elif byte == 0xF0:
            s.prefixes |= LOCKED
        elif byte == 0x67:
            s.prefixes |= SHORT
        elif byte & ~0x18 != 0x26:  # prefixes for segments that begin at 0
            break
        byte = follows(s, 1) & 0xFF
    if byte >> 4 == 4:
        s.rex = byte
        byte = follows(s, 1) & 0xFF
    if byte == 0x0F:
        byte = 0x100 | follows(s, 1) & 0xFF
    return byte


@hot
def _read_immediate(s, n, size):
    """Read the number in an instruction. n: see OPCODE."""
    if n:
        s.immediate = follows(s, size if n == x86.FULL else (4 if size > 4 else size) if n == x86.UP_TO_4 else n)
    if n == 8:  # it is an address
        s.memory, s.ea = 1, s.immediate


@hot
def step(s, space):
    """Execute the instruction at RIP, and move RIP behind it; if `s.status` is not DONE, nothing was done."""
    regs = array_at(s.regs, REGISTERS, _I8)
    s.start = s.at = regs[RIP]
    s.status, s.rex, s.memory, s.ea, s.mask, s.prefixes = DONE, 0, 0, 0, 0, 0
    byte = _read_opcode(s)
    s.rm = byte & 7 | (s.rex & 1) << 3
    table = array_at(space.opcodes, _ROWS, x86.OPCODE)
    op = table[byte]
    size = int(op.width) or (8 if s.rex & 8 else 2 if s.prefixes & NARROW else 4)
    relative = modrm(s) if op.modrm else False
    member = op
    if op.what >= x86.GROUP:
        member = table[x86.GROUPS + 8 * (op.what - x86.GROUP) + (s.reg & 7)]
        if member.target or member.source:
            op = member
            size = int(op.width) or size
    if member.known == 0 or (byte == 0x90 and s.rex & 1):
        s.status = LEFT
        return
    _read_immediate(s, int(op.immediate), size)
    s.ea += s.at if relative else 0
    if s.prefixes & SHORT:
        s.ea &= 0xFFFFFFFF
    if s.prefixes & LOCKED and s.memory and not _is_window(space, s.ea):
        s.status = LEFT  # only the processor does it in one step
        return
    source_size = size // 2 if byte == 0x98 else int(op.source_width) or size
    _perform(s, space, op, int(member.what), size, source_size, byte)
    if s.status == DONE:
        if s.mask:
            regs[FLAGS] = regs[FLAGS] & ~s.mask | s.changes & s.mask
        regs[RIP] = s.at


@exported("i4", "i4", "i8", "i8", SPACE, STEP)
def on_fault(number, info, context, space, s):
    """Handle a fault; return 0 for one that is no access to a window.

    int32_t on_fault(int32_t signal, siginfo_t *, ucontext_t *, SPACE *, STEP *): the thunk of memory.py calls it, with a STEP on
    the handler's stack.
    """
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
    step(s, space)
    if s.status:
        what = host_record.BEYOND_WINDOW if s.status == BEYOND else host_record.NO_CYCLE
        _request(space.request, (array_at(at, 1, SPAN)[0].host, what, s.own, address))
        return 1
    while s.since < MAX_INSTRUCTIONS:
        if regs[RIP] == space.request:  # as ps_delay_us does: no reason to return to the processor
            back = access(s, space, int(regs[RSP]), 8, 0, False)
            if s.status:
                return 1
            arguments = int(regs[RDI]), int(regs[RSI]), int(regs[RDX]), int(regs[RCX])
            regs[RAX] = _request(space.request, arguments)
            regs[RIP], regs[RSP], s.since = back, int(regs[RSP]) + 8, 0
        at = span_of(space, int(regs[RIP]))
        if at == 0 or not array_at(at, 1, SPAN)[0].kind & CODE:
            return 1
        s.since += 1
        step(s, space)
        if s.status != DONE:
            return 1
    return 1
