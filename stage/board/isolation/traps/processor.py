"""Do one instruction of x86-64 on the registers that a signal has saved, compiled: what reaches a window becomes bus cycles.

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
"""Addresses, and what is there. port, host: the first port of a window, and on which HOST."""
READABLE, WRITABLE, CODE, WINDOW, PAGE, STACK = 1, 2, 4, 8, 16, 32
"""Kinds: memory that can be read, written, executed; a window; the rest of a window's pages; the stack of the firmware."""
SPANS = 256
"""Rows of a table; a row of kind 0 is behind the last."""
ROW = SPAN.itemsize

SPACE = record([(name, "i8") for name in "request opcodes spans previous signal faults".split()])
"""What the handler of faults knows: the function for requests, the table of instructions, SPANs, the handler of before, the
function `signal` of C, and how many faults were accesses to windows."""
_STEP = "own regs start at rex memory ea rm reg immediate repeated status changes mask stack floor since"
STEP = record([(name, "i8") for name in _STEP.split()])
"""
    own             where this record is
    regs            where the saved registers are
    start, at       where the instruction begins, and how far it has been read
    rex             its prefix REX, 0 for none
    memory, ea, rm  whether E lies in memory, and where; otherwise it is register rm
    reg, immediate  G; the number in the instruction
    repeated        whether a prefix says so
    status          why it is not done
    changes, mask   flags of the result; those that are to be set
    stack, floor    rsp at the fault; below the floor the stack is not to be touched: the handler may be there
    since           instructions since the last cycle
"""

DONE, LEFT, BEYOND = range(3)
"""Status: done; not for us to do; it touches a page of a window, but beyond the window."""

RIP, FLAGS, REGISTERS = 16, 17, 23
RAX, RCX, RDX, RSP, RBP, RSI, RDI = 13, 14, 12, 15, 10, 9, 8
"""Places in the saved registers (gregs of <sys/ucontext.h>)."""
PLACES = 0x7654321089AFBCED
"""The place of each register by its number in instructions, 4 bits each."""
CF, PF, AF, ZF, SF, DF, OF = 1, 4, 16, 64, 128, 1024, 2048
ABOVE_STACK = 2048
"""Bytes above rsp that are there in any thread: what has called it, and the record of the thread."""
_U1, _I1, _I2, _I4, _I8 = (np.dtype(name) for name in ("u1", "i1", "i2", "i4", "i8"))
_request = called("i8", "i8", "i4", "i8", "i8")
_signal = called("i8", "i4", "i8")
FAR = 200
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
                what = host_record.OUT8 if half == 1 else host_record.OUT16 if half == 2 else host_record.OUT32
                _request(space.request, (span.host, what, port, value))
                if size == 8:
                    _request(space.request, (span.host, what, port + 4, value >> 32))
                return 0
            what = host_record.IN8 if half == 1 else host_record.IN16 if half == 2 else host_record.IN32
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
        if not inside or not span.kind & (WRITABLE if writes else READABLE):
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
    """An operand gets a value, or there is a status."""
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
    """`s` gets the flags of a result; those of `mask` are to be set."""
    low = result & 0xFF
    low ^= low >> 4
    new = (CF if carry else 0) | (OF if overflow else 0) | (ZF if result == 0 else 0) | (SF if result < 0 else 0)
    s.changes = new | (PF if 0x9669 >> (low & 15) & 1 else 0)
    s.mask = mask


@hot
def holds(flags, condition):
    """Whether a condition (of a jump, say) holds."""
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
    """A sum, a difference, a bitwise operation."""
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
    """A shift or a rotation."""
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
    """One bit, which goes to the carry, is set, reset or turned."""
    one = 1 << number
    _flags(s, CF, left >> number & 1 == 1, False, 0)
    if what == x86.BT:
        return left
    return fit(left | one if what == x86.BTS else left & ~one if what == x86.BTR else left ^ one, size)


_ROWS = x86.GROUPS + 8 * (x86.GROUP_DONE - x86.GROUP)


@hot
def _string(s, space, what, repeated, size):
    """MOVS, STOS, once or as often as RCX says."""
    regs = array_at(s.regs, REGISTERS, _I8)
    if regs[FLAGS] & DF:
        s.status = LEFT
        return
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
    """Jumps and the stack."""
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
def _move(s, space, op, what, size, source_size, value, condition):
    """Moves and what is like one. Returns what the target gets."""
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
def _perform(s, space, op, what, size, source_size, byte):
    """What the instruction does; flags are in `s`."""
    regs = array_at(s.regs, REGISTERS, _I8)
    target, source = op.target, op.source
    if what >= x86.MOVS:
        _string(s, space, what, s.repeated, size)
        return
    value = take(s, space, source, source_size)
    if s.status:
        return
    if x86.PUSH <= what <= x86.LEAVE:
        if source == x86.IMM and what != x86.PUSH:
            value += int(s.at)
        if what != x86.JCC or holds(int(regs[FLAGS]), byte):
            _go(s, space, what, value)
        return
    if x86.MOV <= what <= x86.NOP:
        if what == x86.XCHG:
            other = take(s, space, target, size)
            if s.status == DONE:
                put(s, space, target, size, value)
            if s.status == DONE:
                put(s, space, source, size, other)
            return
        value = _move(s, space, op, what, size, source_size, value, byte)
    else:
        if x86.BT <= what <= x86.BTC:
            if source == x86.IMM:
                value &= 8 * size - 1
            s.ea += value // (8 * size) * size
            value &= 8 * size - 1
        left = take(s, space, target, size) if what != x86.NEG else 0
        if s.status:
            return
        if what <= x86.DEC:
            value = compute(s, what, left, value, size)
        elif what < x86.MOV:
            value = shift(s, what, left, value, size)
        else:
            value = change_bit(s, what, left, value, size)
    if s.status == DONE and what != x86.CMP and what != x86.TEST and what != x86.BT:
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
    table = array_at(space.opcodes, _ROWS, x86.OPCODE)
    op = table[byte]
    size = int(op.width) or (8 if s.rex & 8 else 2 if narrow else 4)
    if op.modrm:
        relative = modrm(s)
    member = op
    if op.what >= x86.GROUP:
        member = table[x86.GROUPS + 8 * (op.what - x86.GROUP) + (s.reg & 7)]
        if member.target or member.source:
            op = member
            size = int(op.width) or size
    what, n = int(member.what), int(op.immediate)
    if member.known == 0 or (byte == 0x90 and s.rex & 1):
        s.status = LEFT
        return
    if n:
        s.immediate = follows(s, size if n == x86.FULL else (4 if size > 4 else size) if n == x86.UP_TO_4 else n)
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
        step(s, space)
        if s.status != DONE:
            return 1
    return 1
