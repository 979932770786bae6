"""Execution of single x86-64 instructions on the registers that a signal has saved, compiled: window accesses become bus cycles.

`handle_fault` handles the fault of an access to a window. A signal takes as long as ten bus cycles, so the function also executes
the following instructions as long as it can. A loop that polls a register, or one that writes a table, then takes a single signal.
An instruction that is not in the table, or that needs memory of unknown use, is left to the processor, with no effect so far.
Memory
outside of windows is accessed only if it is known to exist: the firmware's own code and data, and its stack.
"""

from __future__ import annotations

import numpy as np

from stage.board.bus import host_record
from stage.board.isolation.traps import x86_instructions as x86
from stage.native import array_at, declare_address_call, exported, hot, record

SPAN = record([(name, "i8") for name in "begin end kind port host".split()])
"""A range of addresses, the kind of what is there, and of a window its first port and its HOST."""
READABLE, WRITABLE, CODE, WINDOW, PAGE, STACK = 1, 2, 4, 8, 16, 32
"""Kinds: memory that can be read, written, executed; a window; the rest of a window's pages; the stack of the firmware."""
SPANS = 256
"""Rows of a table; a row of kind 0 is behind the last."""
SPAN_BYTES = SPAN.itemsize

HANDLER_DATA = record([(name, "i8") for name in "request opcodes spans previous signal faults".split()])
"""Data of the handler of faults: the function for requests, the table of instructions, SPANs, the handler before it, the function
`signal` of C, and how many faults were accesses to windows."""
_INSTRUCTION_FIELDS = "own regs start at prefixes rex memory ea rm reg immediate status changes mask stack floor since"
INSTRUCTION = record([(name, "i8") for name in _INSTRUCTION_FIELDS.split()])
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
REGISTER_PLACES = 0x7654321089AFBCED
"""The place of each register by its number in instructions, 4 bits each."""
CF, PF, AF, ZF, SF, DF, OF = 1, 4, 16, 64, 128, 1024, 2048
STACK_TOP_BYTES = 2048
"""Bytes above rsp that are there in any thread: what has called it, and the record of the thread."""
_U1, _I8 = np.dtype("u1"), np.dtype("i8")
_call_request = declare_address_call("i8", "i8", "i4", "i8", "i8")
_call_signal = declare_address_call("i8", "i4", "i8")
MAX_INSTRUCTIONS = 200
"""Instructions behind a bus cycle after which the processor takes over again."""
SAME_STACK, RED_ZONE = 1 << 16, 128
"""Bytes from the handler up to the firmware, if it has no stack of its own; bytes below rsp that are the firmware's."""
ADDRESS, REGS = 16, 40
"""Offsets of the faulting address in siginfo_t, and of the saved registers in ucontext_t."""


@hot
def sign_extend(value, size):
    """Return the low `size` bytes of a value as a signed number."""
    if size == 8:
        return (((value >> 32 & 0xFFFFFFFF) ^ 0x80000000) - 0x80000000) << 32 | value & 0xFFFFFFFF
    top = 1 << (8 * size - 1)
    return ((value & (2 * top - 1)) ^ top) - top


@hot
def _find_place(number):
    """Return the place of an x86 register among the saved registers, from its number in instructions."""
    return REGISTER_PLACES >> 4 * number & 15


@hot
def read_register(state, number, size):
    """Return the lowest `size` bytes of the x86 register with this number."""
    regs = array_at(state.regs, REGISTERS, _I8)
    if size == 1 and state.rex == 0 and 4 <= number < 8:  # AH, CH, DH, BH
        return sign_extend(int(regs[_find_place(number - 4)]) >> 8, 1)
    return sign_extend(int(regs[_find_place(number)]), size)


@hot
def write_register(state, number, size, value):
    """Write the lowest `size` bytes of the x86 register with this number.

    As on the processor, a write of 4 bytes clears the upper half, and a smaller one leaves the other bytes.
    """
    regs = array_at(state.regs, REGISTERS, _I8)
    if size == 8:
        regs[_find_place(number)] = value
    elif size == 4:
        regs[_find_place(number)] = value & 0xFFFFFFFF
    elif size == 2:
        regs[_find_place(number)] = int(regs[_find_place(number)]) & ~0xFFFF | value & 0xFFFF
    elif state.rex == 0 and 4 <= number < 8:
        regs[_find_place(number - 4)] = int(regs[_find_place(number - 4)]) & ~0xFF00 | (value & 0xFF) << 8
    else:
        regs[_find_place(number)] = int(regs[_find_place(number)]) & ~0xFF | value & 0xFF


@hot
def _is_on_stack(state, address, size):
    """Return whether `size` bytes at an address are on the part of the stack that exists in any thread of the firmware."""
    return state.floor <= address and address + size <= state.stack + STACK_TOP_BYTES


@hot
def find_span(space, address):
    """Return the address of the first SPAN (range of memory of one kind) that contains an address, or 0."""
    first, k = int(space.spans), 0
    spans = array_at(first, SPANS, SPAN)
    while spans[k].kind:
        if spans[k].begin <= address < spans[k].end:
            return first + k * SPAN_BYTES
        k += 1
    return 0


@hot
def _is_window(space, address):
    """Return whether an address lies in a memory window, where accesses become bus cycles of the board."""
    at = find_span(space, address)
    return at != 0 and array_at(at, 1, SPAN)[0].kind & WINDOW != 0


@hot
def _load_signed(address, size):
    """Read a signed number of `size` bytes from ordinary memory."""
    content, value = array_at(address, size, _U1), 0
    for k in range(size):
        value |= int(content[k]) << 8 * k
    return sign_extend(value, size)


@hot
def _make_cycle(space, span, address, size, value, writes):
    """Execute the bus cycle of an access to a memory window; an access of 64 bits makes two cycles of 32."""
    port, half = int(span.port + address - span.begin), 4 if size == 8 else size
    if writes:
        operation = host_record.OUT8 if half == 1 else host_record.OUT16 if half == 2 else host_record.OUT32
    else:
        operation = host_record.IN8 if half == 1 else host_record.IN16 if half == 2 else host_record.IN32
    answer = _call_request(space.request, (span.host, operation, port, value))
    if size == 8:
        answer |= _call_request(space.request, (span.host, operation, port + 4, value >> 32)) << 32
    return sign_extend(answer, size)


@hot
def access_memory(state, space, address, size, value, writes):
    """Read or write memory, by a bus cycle in a memory window; return the value read.

    An impossible access sets `state.status`.
    """
    if not _is_on_stack(state, address, size):
        at = find_span(space, address)
        if at == 0:
            state.status = LEFT
            return 0
        span = array_at(at, 1, SPAN)[0]
        inside = address + size <= span.end
        if span.kind & WINDOW and inside:
            state.since = 0
            return _make_cycle(space, span, address, size, value, writes)
        if span.kind & (WINDOW | PAGE):
            state.status = BEYOND
            return 0
        below = span.kind & STACK and address < state.floor
        if below or not inside or not span.kind & (WRITABLE if writes else READABLE):
            state.status = LEFT
            return 0
    if writes:
        content = array_at(address, size, _U1)
        for k in range(size):
            content[k] = value >> 8 * k & 0xFF
        return 0
    return _load_signed(address, size)


@hot
def read_code(state, size):
    """Read the next `size` bytes of the present x86 instruction as a signed number."""
    state.at += size
    return _load_signed(state.at - size, size)


@hot
def decode_modrm(state):
    """Decode the ModRM byte after an x86 opcode, and find the address of operand E.

    Return whether it is relative to the end of the instruction.
    """
    code = read_code(state, 1) & 0xFF
    mode, rm = code >> 6, code & 7
    state.reg = code >> 3 & 7 | (state.rex & 4) << 1
    if mode == 3:
        state.rm = rm | (state.rex & 1) << 3
        return False
    regs, address, relative = array_at(state.regs, REGISTERS, _I8), 0, False
    if rm == 4:
        sib = read_code(state, 1) & 0xFF
        index, rm = sib >> 3 & 7 | (state.rex & 2) << 2, sib & 7
        if index != 4:
            address = int(regs[_find_place(index)]) << (sib >> 6)
        if rm == 5 and mode == 0:
            address += read_code(state, 4)
        else:
            address += int(regs[_find_place(rm | (state.rex & 1) << 3)])
    elif rm == 5 and mode == 0:
        address, relative = read_code(state, 4), True
    else:
        address = int(regs[_find_place(rm | (state.rex & 1) << 3)])
    if mode == 1:
        address += read_code(state, 1)
    elif mode == 2:
        address += read_code(state, 4)
    state.memory, state.ea = 1, sign_extend(address, 8)
    return relative


@hot
def read_operand(state, space, kind, size):
    """Return the value of an operand of an x86 instruction; 0, with a status in `state`, if it cannot be read."""
    if kind == x86.E and state.memory:
        return access_memory(state, space, state.ea, size, 0, False)
    if kind in (x86.E, x86.R):
        return read_register(state, state.rm, size)
    if kind == x86.G:
        return read_register(state, state.reg, size)
    if kind == x86.IMM:
        return int(state.immediate)
    if kind == x86.A:
        return read_register(state, 0, size)
    if kind == x86.CL:
        return read_register(state, 1, 4) & 0xFF
    if kind == x86.EA:
        return int(state.ea)
    return 1 if kind == x86.ONE else 0


@hot
def write_operand(state, space, kind, size, value):
    """Write an operand of an x86 instruction, or set a status in `state` if it cannot be written."""
    if kind == x86.E and state.memory:
        access_memory(state, space, state.ea, size, value, True)
    elif kind in (x86.E, x86.R):
        write_register(state, state.rm, size, value)
    elif kind == x86.G:
        write_register(state, state.reg, size, value)
    elif kind == x86.A:
        write_register(state, 0, size, value)
    elif kind == x86.D:
        write_register(state, 2, size, value)


@hot
def _set_flags(state, mask, carry, overflow, result):
    """Store the flags of an x86 instruction's result. Only the flags in `mask` will be written to the processor."""
    low = result & 0xFF
    low ^= low >> 4
    new = (CF if carry else 0) | (OF if overflow else 0) | (ZF if result == 0 else 0) | (SF if result < 0 else 0)
    state.changes = new | (PF if 0x9669 >> (low & 15) & 1 else 0)
    state.mask = mask


@hot
def is_condition_met(flags, condition):
    """Return whether the processor flags meet the condition of an x86 instruction, for example of a conditional jump."""
    k = condition >> 1 & 7
    differ = (flags & SF != 0) != (flags & OF != 0)
    if k >= 6:
        yes = differ or (k == 7 and flags & ZF != 0)
    else:
        mask = OF if k == 0 else CF if k == 1 else ZF if k == 2 else CF | ZF if k == 3 else SF if k == 4 else PF
        yes = flags & mask != 0
    return yes != (condition & 1 == 1)


@hot
def compute_sum(state, operation, left, right, size):
    """Compute a sum, a difference or a bitwise operation of an x86 instruction, and set the flags in `state`."""
    carry = overflow = False
    adjust, mask = 0, CF | PF | AF | ZF | SF | OF
    old = int(array_at(state.regs, REGISTERS, _I8)[FLAGS]) & CF
    if operation in (x86.ADD, x86.ADC, x86.INC):
        result = sign_extend(left + right + (old if operation == x86.ADC else 0), size)
        out = (left & right) | ((left | right) & ~result)
        carry, overflow, adjust = out < 0, (left ^ result) & (right ^ result) < 0, out
    elif operation == x86.OR:
        result = left | right
    elif operation in (x86.AND, x86.TEST):
        result = left & right
    elif operation == x86.XOR:
        result = left ^ right
    else:
        result = sign_extend(left - right - (old if operation == x86.SBB else 0), size)
        out = (~left & right) | ((~left | right) & result)
        carry, overflow, adjust = out < 0, (left ^ right) & (left ^ result) < 0, out
    _set_flags(state, mask & ~CF if operation in (x86.INC, x86.DEC) else mask, carry, overflow, result)
    state.changes |= (adjust >> 3 & 1) << 4
    return result


@hot
def compute_shift(state, operation, left, count, size):
    """Compute a shift or a rotation of an x86 instruction, and set the flags in `state`."""
    bits = 8 * size
    count &= 63 if size == 8 else 31
    state.mask = 0
    if count == 0:
        return left
    unsigned = left if size == 8 else left & ((1 << bits) - 1)
    carry, overflow, mask = left >> (count - 1) & 1 == 1, False, CF | OF | ZF | SF | PF
    if operation == x86.SHL:
        result = sign_extend(left << count, size)
        carry = count <= bits and left >> (bits - count) & 1 == 1
        overflow = carry != (result < 0)
    elif operation == x86.SAR:
        result = left >> count
    elif operation == x86.SHR:
        result, overflow = sign_extend(unsigned >> count & ((1 << (64 - count)) - 1), size), left < 0
        carry = unsigned >> (count - 1) & 1 == 1
    elif size == 8:
        state.status = LEFT
        return left
    else:
        turn, mask = count % bits if operation == x86.ROL else -count % bits, CF | OF
        result = sign_extend(unsigned << turn | unsigned >> (bits - turn), size)
        low, high, second = result & 1 == 1, result < 0, result >> (bits - 2) & 1 == 1
        carry, overflow = low if operation == x86.ROL else high, high != (low if operation == x86.ROL else second)
    _set_flags(state, mask, carry, overflow, result)
    return result


@hot
def change_bit(state, operation, left, number, size):
    """Copy one bit to the carry flag, and set, reset or invert that bit, or leave it: the x86 instructions BTS, BTR, BTC and BT."""
    one = 1 << number
    _set_flags(state, CF, left >> number & 1 == 1, False, 0)
    if operation == x86.BT:
        return left
    return sign_extend(
        left | one if operation == x86.BTS else left & ~one if operation == x86.BTR else left ^ one, size
    )


_ROWS = x86.FIRST_GROUP_ROW + 8 * (x86.GROUP_DONE - x86.GROUP)


@hot
def _execute_string(state, space, operation, size):
    """Execute the x86 string instruction MOVS or STOS once, or RCX times if it has a repeat prefix."""
    regs = array_at(state.regs, REGISTERS, _I8)
    if regs[FLAGS] & DF:
        state.status = LEFT
        return
    repeated = state.prefixes & REPEATED
    left = int(regs[RCX]) if repeated else 1
    while left > 0:
        value = int(regs[RAX]) if operation == x86.STOS else access_memory(state, space, int(regs[RSI]), size, 0, False)
        if state.status == DONE:
            access_memory(state, space, int(regs[RDI]), size, value, True)
        if state.status:
            return
        regs[RDI] += size
        if operation == x86.MOVS:
            regs[RSI] += size
        left -= 1
        if repeated:
            regs[RCX] = left


@hot
def _execute_jump(state, space, operation, value):
    """Execute an x86 jump, or an x86 instruction that uses the stack."""
    regs = array_at(state.regs, REGISTERS, _I8)
    top = int(regs[RSP])
    if operation in (x86.JMP, x86.JCC):
        state.at = value
    elif operation in (x86.CALL, x86.PUSH):
        access_memory(state, space, top - 8, 8, int(state.at) if operation == x86.CALL else value, True)
        if state.status == DONE:
            regs[RSP] = top - 8
            if operation == x86.CALL:
                state.at = value
    else:
        if operation == x86.LEAVE:
            top = int(regs[RBP])
        value = access_memory(state, space, top, 8, 0, False)
        if state.status == DONE:
            regs[RSP] = top + 8
            if operation == x86.RET:
                state.at = value
            elif operation == x86.POP:
                write_register(state, state.rm, 8, value)
            else:
                regs[RBP] = value


@hot
def _compute_move(state, operation, size, source_size, value, condition):
    """Compute the value that an x86 move, or a similar x86 instruction, writes to its target."""
    if operation == x86.MOVZX:
        return value & ((1 << 8 * source_size) - 1)
    if operation == x86.NOT:
        return ~value
    if operation == x86.SIGN:
        return -1 if value < 0 else 0
    if operation in (x86.SETCC, x86.CMOV):
        yes = is_condition_met(int(array_at(state.regs, REGISTERS, _I8)[FLAGS]), condition)
        if operation == x86.SETCC:
            return 1 if yes else 0
        return value if yes else read_register(state, state.reg, size)
    if operation in (x86.IMUL, x86.IMUL3):
        if size == 8:
            state.status = LEFT
            return 0
        product = value * (read_register(state, state.reg, size) if operation == x86.IMUL else int(state.immediate))
        state.mask, state.changes = CF | OF, 0 if sign_extend(product, size) == product else CF | OF
        return product
    return value


@hot
def _execute_exchange(state, space, opcode, size, value):
    """Execute the x86 instruction XCHG, which exchanges two operands."""
    other = read_operand(state, space, opcode.target, size)
    if state.status == DONE:
        write_operand(state, space, opcode.target, size, value)
    if state.status == DONE:
        write_operand(state, space, opcode.source, size, other)


@hot
def _execute_arithmetic(state, space, opcode, operation, size, value):
    """Execute an arithmetic or logical x86 instruction on its target and a value."""
    if x86.BT <= operation <= x86.BTC:
        if opcode.source == x86.IMM:
            value &= 8 * size - 1
        state.ea += value // (8 * size) * size
        value &= 8 * size - 1
    left = read_operand(state, space, opcode.target, size) if operation != x86.NEG else 0
    if state.status:
        return
    if operation <= x86.DEC:
        value = compute_sum(state, operation, left, value, size)
    elif operation < x86.MOV:
        value = compute_shift(state, operation, left, value, size)
    else:
        value = change_bit(state, operation, left, value, size)
    if state.status == DONE and operation != x86.CMP and operation != x86.TEST and operation != x86.BT:
        write_operand(state, space, opcode.target, size, value)


@hot
def _execute_decoded(state, space, opcode, operation, size, source_size, code):
    """Execute a decoded x86 instruction; the processor flags that result are stored in `state`."""
    if operation >= x86.MOVS:
        _execute_string(state, space, operation, size)
        return
    value = read_operand(state, space, opcode.source, source_size)
    if state.status:
        return
    if x86.PUSH <= operation <= x86.LEAVE:
        if opcode.source == x86.IMM and operation != x86.PUSH:
            value += int(state.at)
        if operation != x86.JCC or is_condition_met(int(array_at(state.regs, REGISTERS, _I8)[FLAGS]), code):
            _execute_jump(state, space, operation, value)
    elif operation == x86.XCHG:
        _execute_exchange(state, space, opcode, size, value)
    elif x86.MOV <= operation <= x86.NOP:
        value = _compute_move(state, operation, size, source_size, value, code)
        if state.status == DONE:
            write_operand(state, space, opcode.target, size, value)
    else:
        _execute_arithmetic(state, space, opcode, operation, size, value)


@hot
def _read_opcode(state):
    """Read the prefixes and the opcode of an x86 instruction; the result is 100h | opcode for one after 0Fh."""
    code = read_code(state, 1) & 0xFF
    while True:
        if code == 0x66:
            state.prefixes |= NARROW
        elif code == 0xF2 or code == 0xF3:
            state.prefixes |= REPEATED
        elif code == 0xF0:
            state.prefixes |= LOCKED
        elif code == 0x67:
            state.prefixes |= SHORT
        elif code & ~0x18 != 0x26:  # prefixes for segments that begin at 0
            break
        code = read_code(state, 1) & 0xFF
    if code >> 4 == 4:
        state.rex = code
        code = read_code(state, 1) & 0xFF
    if code == 0x0F:
        code = 0x100 | read_code(state, 1) & 0xFF
    return code


@hot
def _read_immediate(state, length_code, size):
    """Read the immediate number in an x86 instruction.

    `length_code` is the field `immediate` of the instruction's OPCODE record.
    """
    if length_code:
        state.immediate = read_code(
            state,
            size
            if length_code == x86.FULL
            else (4 if size > 4 else size)
            if length_code == x86.UP_TO_4
            else length_code,
        )
    if length_code == 8:  # it is an address
        state.memory, state.ea = 1, state.immediate


@hot
def execute_instruction(state, space):
    """Execute the x86 instruction at RIP, and move RIP behind it.

    If `state.status` is not DONE, nothing has happened.
    """
    regs = array_at(state.regs, REGISTERS, _I8)
    state.start = state.at = regs[RIP]
    state.status, state.rex, state.memory, state.ea, state.mask, state.prefixes = DONE, 0, 0, 0, 0, 0
    code = _read_opcode(state)
    state.rm = code & 7 | (state.rex & 1) << 3
    table = array_at(space.opcodes, _ROWS, x86.OPCODE)
    opcode = table[code]
    size = int(opcode.width) or (8 if state.rex & 8 else 2 if state.prefixes & NARROW else 4)
    relative = decode_modrm(state) if opcode.modrm else False
    variant = opcode
    if opcode.operation >= x86.GROUP:
        variant = table[x86.FIRST_GROUP_ROW + 8 * (opcode.operation - x86.GROUP) + (state.reg & 7)]
        if variant.target or variant.source:
            opcode = variant
            size = int(opcode.width) or size
    if variant.known == 0 or (code == 0x90 and state.rex & 1):
        state.status = LEFT
        return
    _read_immediate(state, int(opcode.immediate), size)
    state.ea += state.at if relative else 0
    if state.prefixes & SHORT:
        state.ea &= 0xFFFFFFFF
    if state.prefixes & LOCKED and state.memory and not _is_window(space, state.ea):
        state.status = LEFT  # only the processor does it in one step
        return
    source_size = size // 2 if code == 0x98 else int(opcode.source_width) or size
    _execute_decoded(state, space, opcode, int(variant.operation), size, source_size, code)
    if state.status == DONE:
        if state.mask:
            regs[FLAGS] = regs[FLAGS] & ~state.mask | state.changes & state.mask
        regs[RIP] = state.at


@exported("i4", "i4", "i8", "i8", HANDLER_DATA, INSTRUCTION)
def handle_fault(number, info, context, space, state):
    """Handle a memory fault of the firmware; return 0 for a fault that is no access to a memory window.

    C prototype: int32_t handle_fault(int32_t signal, siginfo_t *, ucontext_t *, HANDLER_DATA *, INSTRUCTION *). The thunk of
        memory_windows.py
    calls it with an INSTRUCTION record on the handler's stack.
    """
    address = int(array_at(info + ADDRESS, 1, _I8)[0])
    at, regs = find_span(space, address), array_at(context + REGS, REGISTERS, _I8)
    jumped = regs[RIP] == address  # registers are no instructions
    if at == 0 or jumped or not array_at(at, 1, SPAN)[0].kind & (WINDOW | PAGE):
        if space.previous > 1:
            return 0
        _call_signal(space.signal, (number, 0))  # it happens again, and then ends the process
        return 1
    space.faults += 1
    state.regs, state.since = context + REGS, 0
    state.stack = regs[RSP]
    same = 0 < state.stack - state.own < SAME_STACK
    state.floor = state.stack - RED_ZONE if same else state.stack & ~0xFFF
    execute_instruction(state, space)
    if state.status:
        operation = host_record.BEYOND_WINDOW if state.status == BEYOND else host_record.NO_CYCLE
        _call_request(space.request, (array_at(at, 1, SPAN)[0].host, operation, state.own, address))
        return 1
    while state.since < MAX_INSTRUCTIONS:
        if regs[RIP] == space.request:  # as ps_delay_us does: no reason to return to the processor
            back = access_memory(state, space, int(regs[RSP]), 8, 0, False)
            if state.status:
                return 1
            arguments = int(regs[RDI]), int(regs[RSI]), int(regs[RDX]), int(regs[RCX])
            regs[RAX] = _call_request(space.request, arguments)
            regs[RIP], regs[RSP], state.since = back, int(regs[RSP]) + 8, 0
        at = find_span(space, int(regs[RIP]))
        if at == 0 or not array_at(at, 1, SPAN)[0].kind & CODE:
            return 1
        state.since += 1
        execute_instruction(state, space)
        if state.status != DONE:
            return 1
    return 1
