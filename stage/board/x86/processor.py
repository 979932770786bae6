"""One instruction of x86-64 on the registers that a signal has saved, compiled: what reaches a window becomes bus cycles.

Memory that is no window is touched only where it is known to be there: the firmware's own code and data, and its stack. An
instruction that needs other memory, or is not in the table, is left to the processor; nothing was done then.
"""

from __future__ import annotations

import numpy as np

from stage.board.host import IN8, IN16, IN32, OUT8, OUT16, OUT32
from stage.board.x86 import table as x86
from stage.native import array_at, called, hot, record

SPAN = record([(name, "i8") for name in "begin end kind port host".split()])
"""Addresses, and what is there. port, host: the first port of a window, and on which HOST."""
READ, WRITE, CODE, WINDOW, PAGE, STACK = 1, 2, 4, 8, 16, 32
"""Kinds: memory that can be read, written, executed; a window; the rest of a window's pages; the stack of the firmware."""
SPANS = 256
"""Rows of a table; a row of kind 0 is behind the last."""
ROW = SPAN.itemsize

SPACE = record([(name, "i8") for name in "request opcodes spans previous signal faults".split()])
"""What the handler of faults knows: the function for requests, the table of instructions, SPANs, the handler of before, C's
`signal`, and how many faults were accesses to windows."""
STEP = record([(name, "i8") for name in "own regs start at rex size memory ea rm reg status stack floor since".split()])
"""
    own             where this record is
    regs            where the saved registers are
    start, at       where the instruction begins, and how far it has been read
    rex, size       its prefix REX, 0 for none; the bytes of its operands
    memory, ea, rm  whether E lies in memory, and where; otherwise it is register rm
    reg             G
    status          why it is not done
    stack, floor    rsp at the fault; below the floor the stack is not to be touched: the handler may be there
    since           instructions since the last cycle
"""

DONE, LEFT, BEYOND = range(3)
"""Status: done; not for us to do; it touches a page of a window, but beyond the window."""

RIP, FLAGS, REGISTERS = 16, 17, 23
RAX, RCX, RSP, RBP, RSI, RDI = 13, 14, 15, 10, 9, 8
"""Places in the saved registers (gregs of <sys/ucontext.h>)."""
_PLACES = 0x7654321089AFBCED
"""The place of each register by its number in instructions, 4 bits each."""
CF, PF, AF, ZF, SF, DF, OF = 1, 4, 16, 64, 128, 1024, 2048
ABOVE_STACK = 2048
"""Bytes above rsp that are there in any thread: what has called it, and the record of the thread."""

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
    return _PLACES >> 4 * n & 15


@hot
def _get(s, n, size):
    regs = array_at(s.regs, REGISTERS, _I8)
    if size == 1 and s.rex == 0 and 4 <= n < 8:  # AH, CH, DH, BH
        return fit(int(regs[_place(n - 4)]) >> 8, 1)
    return fit(int(regs[_place(n)]), size)


@hot
def _set(s, n, size, value):
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
def _access(s, space, address, size, value, writes):
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
def _get_e(s, space, size):
    return _get(s, s.rm, size) if not s.memory else _access(s, space, s.ea, size, 0, False)


@hot
def _set_e(s, space, size, value):
    if not s.memory:
        _set(s, s.rm, size, value)
    else:
        _access(s, space, s.ea, size, value, True)


@hot
def _next(s, size):
    """The next bytes of the instruction, signed."""
    value = 0
    for k in range(size):
        value |= int(array_at(s.at + k, 1, _U1)[0]) << 8 * k
    s.at += size
    return fit(value, size)


@hot
def _modrm(s):
    """The byte behind the opcode, and where E lies. Returns whether what follows the instruction is to be added."""
    byte = _next(s, 1) & 0xFF
    mode, rm = byte >> 6, byte & 7
    s.reg = byte >> 3 & 7 | (s.rex & 4) << 1
    if mode == 3:
        s.rm = rm | (s.rex & 1) << 3
        return False
    regs, address, relative = array_at(s.regs, REGISTERS, _I8), 0, False
    if rm == 4:
        sib = _next(s, 1) & 0xFF
        index, rm = sib >> 3 & 7 | (s.rex & 2) << 2, sib & 7
        if index != 4:
            address = int(regs[_place(index)]) << (sib >> 6)
        if rm == 5 and mode == 0:
            address += _next(s, 4)
        else:
            address += int(regs[_place(rm | (s.rex & 1) << 3)])
    elif rm == 5 and mode == 0:
        address, relative = _next(s, 4), True
    else:
        address = int(regs[_place(rm | (s.rex & 1) << 3)])
    if mode == 1:
        address += _next(s, 1)
    elif mode == 2:
        address += _next(s, 4)
    s.memory, s.ea = 1, fit(address, 8)
    return relative


@hot
def _flag(s, mask, carry, overflow, result, size):
    """The flags of a result; those of `mask` only."""
    regs = array_at(s.regs, REGISTERS, _I8)
    low = result & 0xFF
    low ^= low >> 4
    new = (CF if carry else 0) | (OF if overflow else 0) | (ZF if result == 0 else 0) | (SF if result < 0 else 0)
    if 0x9669 >> (low & 15) & 1:
        new |= PF
    regs[FLAGS] = int(regs[FLAGS]) & ~mask | new & mask


@hot
def _holds(s, condition):
    """Whether a condition (of a jump, say) holds."""
    f = int(array_at(s.regs, REGISTERS, _I8)[FLAGS])
    k = condition >> 1 & 7
    carry, zero, sign, overflow = f & CF != 0, f & ZF != 0, f & SF != 0, f & OF != 0
    if k == 0:
        yes = overflow
    elif k == 1:
        yes = carry
    elif k == 2:
        yes = zero
    elif k == 3:
        yes = carry or zero
    elif k == 4:
        yes = sign
    elif k == 5:
        yes = f & PF != 0
    elif k == 6:
        yes = sign != overflow
    else:
        yes = zero or sign != overflow
    return yes != (condition & 1 == 1)


@hot
def _shift(s, space, what, count):
    """A shift or rotation of E."""
    size, bits = int(s.size), 8 * int(s.size)
    count &= 63 if size == 8 else 31
    value = _get_e(s, space, size)
    if s.status:
        return
    carry, overflow, mask = False, False, CF | OF | ZF | SF | PF
    if count == 0:
        result, mask = value, 0
    elif what == x86.SHL:
        result = fit(value << count, size)
        carry = count <= bits and value >> (bits - count) & 1 == 1
        overflow = carry != (result < 0)
    elif what == x86.SAR:
        result, carry = value >> count, value >> (count - 1) & 1 == 1
    elif what == x86.SHR:
        if size < 8:
            value &= (1 << bits) - 1
        result = fit(value >> count & ((1 << (64 - count)) - 1), size)
        carry, overflow = value >> (count - 1) & 1 == 1, value >> (bits - 1) & 1 == 1
    elif size == 8:
        s.status = LEFT
        return
    else:
        value &= (1 << bits) - 1
        turn = count % bits if what == x86.ROL else -count % bits
        result, mask = fit(value << turn | value >> (bits - turn), size), CF | OF
        carry = result & 1 == 1 if what == x86.ROL else result < 0
        overflow = (
            (result < 0) != (result & 1 == 1) if what == x86.ROL else (result < 0) != (result >> (bits - 2) & 1 == 1)
        )
    _set_e(s, space, size, result)
    if s.status == DONE and mask:
        _flag(s, mask, carry, overflow, result, size)


@hot
def _compute(s, what, left, right):
    """A sum, a difference, a bitwise operation; its flags if `s.status` is DONE."""
    carry, overflow, adjust = False, False, 0
    old = int(array_at(s.regs, REGISTERS, _I8)[FLAGS]) & CF
    if what == x86.ADD or what == x86.ADC or what == x86.INC:
        result = fit(left + right + (old if what == x86.ADC else 0), int(s.size))
        out = (left & right) | ((left | right) & ~result)
        carry, overflow, adjust = out < 0, (left ^ result) & (right ^ result) < 0, out
    elif what == x86.OR:
        result = left | right
    elif what == x86.AND or what == x86.TEST:
        result = left & right
    elif what == x86.XOR:
        result = left ^ right
    else:
        result = fit(left - right - (old if what == x86.SBB else 0), int(s.size))
        out = (~left & right) | ((~left | right) & result)
        carry, overflow, adjust = out < 0, (left ^ right) & (left ^ result) < 0, out
    return result, carry, overflow, adjust >> 3 & 1


@hot
def _arithmetic(s, space, what, form, right):
    """left = left what right, with flags."""
    size = int(s.size)
    if what == x86.NEG:
        right, left = _get_e(s, space, size), 0
    elif form == x86.G_E:
        left, right = _get(s, s.reg, size), _get_e(s, space, size)
    elif form == x86.A_IMM:
        left = _get(s, 0, size)
    else:
        left = _get_e(s, space, size)
    if s.status:
        return
    result, carry, overflow, adjust = _compute(s, what, left, right)
    if what != x86.CMP and what != x86.TEST:
        if form == x86.G_E:
            _set(s, s.reg, size, result)
        elif form == x86.A_IMM:
            _set(s, 0, size, result)
        else:
            _set_e(s, space, size, result)
    if s.status == DONE:
        mask = OF | SF | ZF | PF | (0 if what == x86.INC or what == x86.DEC else CF)
        _flag(s, mask, carry, overflow, result, size)
        regs = array_at(s.regs, REGISTERS, _I8)
        regs[FLAGS] = int(regs[FLAGS]) & ~AF | adjust << 4


@hot
def _bits(s, space, what, number):
    """BT, BTS, BTR, BTC."""
    size, bits = int(s.size), 8 * int(s.size)
    if s.memory:
        s.ea += number // bits * size
    number &= bits - 1
    value = _get_e(s, space, size)
    if s.status:
        return
    one = 1 << number
    if what != x86.BT:
        _set_e(
            s,
            space,
            size,
            fit(value | one if what == x86.BTS else value & ~one if what == x86.BTR else value ^ one, size),
        )
    if s.status == DONE:
        _flag(s, CF, value >> number & 1 == 1, False, 0, size)


@hot
def _string(s, space, what, repeated):
    """MOVS, STOS, LODS, once or as often as RCX says."""
    regs, size = array_at(s.regs, REGISTERS, _I8), int(s.size)
    if int(regs[FLAGS]) & DF:
        s.status = LEFT
        return
    left = int(regs[RCX]) if repeated else 1
    while left > 0 and s.status == DONE:
        source, target = int(regs[RSI]), int(regs[RDI])
        value = int(regs[RAX]) if what == x86.STOS else _access(s, space, source, size, 0, False)
        if s.status:
            return
        if what == x86.LODS:
            _set(s, 0, size, value)
        else:
            _access(s, space, target, size, value, True)
            if s.status:
                return
            regs[RDI] = target + size
        if what != x86.STOS:
            regs[RSI] = source + size
        left -= 1
        if repeated:
            regs[RCX] = left


@hot
def _go(s, space, what, right, size):
    """Jumps and the stack."""
    regs = array_at(s.regs, REGISTERS, _I8)
    top = int(regs[RSP])
    if what == x86.JCC:
        s.at += right
    elif what == x86.JMP:
        s.at = right
    elif what == x86.CALL or what == x86.PUSH:
        _access(s, space, top - 8, 8, s.at if what == x86.CALL else right, True)
        if s.status == DONE:
            regs[RSP] = top - 8
            if what == x86.CALL:
                s.at = right
    elif what == x86.RET:
        target = _access(s, space, top, 8, 0, False)
        if s.status == DONE:
            s.at, regs[RSP] = target, top + 8
    elif what == x86.POP:
        value = _access(s, space, top, 8, 0, False)
        if s.status == DONE:
            regs[RSP] = top + 8
            _set(s, s.rm, 8, value)
    else:  # LEAVE
        frame = int(regs[RBP])
        value = _access(s, space, frame, 8, 0, False)
        if s.status == DONE:
            regs[RSP], regs[RBP] = frame + 8, value


@hot
def step(s, space):
    """The instruction at RIP, and RIP then is behind it; if `s.status` is not DONE, nothing was done."""
    regs = array_at(s.regs, REGISTERS, _I8)
    s.start = s.at = int(regs[RIP])
    s.status, s.rex, s.memory, s.ea, s.rm = DONE, 0, 0, 0, 0
    narrow, repeated, locked, short = False, False, False, False
    byte = _next(s, 1) & 0xFF
    while True:
        if byte == 0x66:
            narrow = True
        elif byte == 0xF2 or byte == 0xF3:
            repeated = True
        elif byte == 0xF0:
            locked = True
        elif byte == 0x67:
            short = True
        elif byte != 0x2E and byte != 0x3E and byte != 0x26 and byte != 0x36:
            break
        byte = _next(s, 1) & 0xFF
    if byte >> 4 == 4:
        s.rex = byte
        byte = _next(s, 1) & 0xFF
    if byte == 0x0F:
        byte = 0x100 | _next(s, 1) & 0xFF
    op = array_at(space.opcodes, 512, x86.OPCODE)[byte]
    what, form, size = int(op.what), int(op.form), int(op.size)
    if form == x86.NO:
        s.status = LEFT
        return
    if size == 0:
        size = 8 if s.rex & 8 else 2 if narrow else 4
    relative = False
    if x86.WITH_MODRM >> form & 1:
        relative = _modrm(s)
        if what == x86.ARITHMETIC:
            what = s.reg & 7
        elif what == x86.SHIFTS:
            what = x86.ROL + (s.reg & 7)
            if what == 22:
                what = x86.SHL
        elif what == x86.BITS:
            what = 32 + (s.reg & 7)
        elif what == x86.MOVE:
            what = x86.MOV
        elif what == x86.UNARY:
            k = s.reg & 7
            what = x86.TEST if k < 2 else x86.NOT + k - 2
            if k < 2:
                form = x86.E_IMM
            elif k > 3:
                s.status = LEFT
        elif what == x86.COUNT or what == x86.OFF:
            k = s.reg & 7
            if k < 2:
                what = x86.INC + k
            elif what == x86.OFF and (k == 2 or k == 4 or k == 6):
                what = x86.CALL if k == 2 else x86.JMP if k == 4 else x86.PUSH
                size = 8
            else:
                s.status = LEFT
    else:
        s.rm = byte & 7 | (s.rex & 1) << 3
    s.size = size
    right = 0
    if form == x86.E_IMM8 or form == x86.IMM8 or form == x86.G_E_IMM8:
        right = _next(s, 1)
    elif form == x86.E_IMM or form == x86.A_IMM or form == x86.G_E_IMM or form == x86.IMM:
        right = _next(s, 4 if size > 4 else size)
    elif form == x86.R_IMM:
        right = _next(s, size)
    elif form == x86.A_AT or form == x86.AT_A:
        s.memory, s.ea = 1, _next(s, 8)
    elif form == x86.E_CL:
        right = int(regs[RCX]) & 0xFF
    elif form == x86.E_G:
        right = _get(s, s.reg, size)
    elif form == x86.E_ONCE or what == x86.INC or what == x86.DEC:
        right = 1
    if relative:
        s.ea += s.at
    if short:
        s.ea &= 0xFFFFFFFF
    if locked and s.memory:
        at = span_of(space, s.ea)
        if at == 0 or not array_at(at, 1, SPAN)[0].kind & WINDOW:
            s.status = LEFT  # only the processor does it in one step
    if s.status:
        return
    if what <= x86.CMP or what == x86.TEST or what == x86.NEG or what == x86.INC or what == x86.DEC:
        _arithmetic(s, space, what, form, right)
    elif x86.ROL <= what <= x86.SAR:
        if what == 18 or what == 19:  # through carry
            s.status = LEFT
            return
        _shift(s, space, what, right)
    elif what == x86.MOV:
        if form == x86.G_E or form == x86.A_AT:
            value = _get_e(s, space, size)
            if s.status == DONE:
                _set(s, s.reg if form == x86.G_E else 0, size, value)
        elif form == x86.R_IMM:
            _set(s, s.rm, size, right)
        else:
            _set_e(s, space, size, _get(s, 0, size) if form == x86.AT_A else right)
    elif what == x86.MOVZX or what == x86.MOVSX:
        value = _get_e(s, space, int(op.source))
        if s.status == DONE:
            _set(s, s.reg, size, value & ((1 << 8 * int(op.source)) - 1) if what == x86.MOVZX else value)
    elif what == x86.NOT:
        value = _get_e(s, space, size)
        if s.status == DONE:
            _set_e(s, space, size, ~value)
    elif what == x86.LEA:
        _set(s, s.reg, size, s.ea)
    elif what == x86.XCHG:
        if form == x86.R:
            if s.rm:
                value = _get(s, s.rm, size)
                _set(s, s.rm, size, _get(s, 0, size))
                _set(s, 0, size, value)
        else:
            value = _get_e(s, space, size)
            if s.status == DONE:
                _set_e(s, space, size, right)
            if s.status == DONE:
                _set(s, s.reg, size, value)
    elif x86.BT <= what <= x86.BTC:
        _bits(s, space, what, right if form == x86.E_G else right & (8 * size - 1))
    elif what == x86.SETCC:
        _set_e(s, space, 1, 1 if _holds(s, byte) else 0)
    elif what == x86.CMOV:
        value = _get_e(s, space, size)
        if s.status == DONE:
            _set(s, s.reg, size, value if _holds(s, byte) else _get(s, s.reg, size))
    elif what == x86.IMUL:
        value = _get_e(s, space, size) if size < 8 else 0
        if size == 8:
            s.status = LEFT
        if s.status == DONE:
            product = value * (_get(s, s.reg, size) if form == x86.G_E else right)
            _set(s, s.reg, size, product)
            _flag(s, CF | OF, fit(product, size) != product, fit(product, size) != product, 0, size)
    elif what == x86.WIDEN:
        _set(s, 0, size, _get(s, 0, size // 2))
    elif what == x86.SIGN:
        _set(s, 2, size, -1 if _get(s, 0, size) < 0 else 0)
    elif x86.MOVS <= what <= x86.LODS:
        _string(s, space, what, repeated)
    elif x86.PUSH <= what <= x86.LEAVE:
        if form == x86.E_ONE:
            right = _get_e(s, space, 8)
        elif form == x86.R:
            right = _get(s, s.rm, 8)
        elif what == x86.CALL or what == x86.JMP:
            right += s.at
        if what == x86.JCC and not _holds(s, byte):
            right = 0
        if s.status == DONE:
            _go(s, space, what, right, size)
    elif what != x86.NOP:
        s.status = LEFT
    if s.status == DONE:
        regs[RIP] = s.at
