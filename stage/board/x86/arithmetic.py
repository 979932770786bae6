"""Results and flags of arithmetic, shifts and single bits, compiled. Numbers are signed, and fit their size."""

from __future__ import annotations

import numpy as np

from stage.board.x86.operands import fit
from stage.board.x86.records import AF, CF, FLAGS, LEFT, OF, PF, REGISTERS, SF, ZF
from stage.board.x86.table import ADC, ADD, AND, BT, BTR, BTS, DEC, INC, OR, ROL, SAR, SBB, SHL, SHR, TEST, XOR
from stage.native import array_at, hot

_I8 = np.dtype("i8")


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
    if what in (ADD, ADC, INC):
        result = fit(left + right + (old if what == ADC else 0), size)
        out = (left & right) | ((left | right) & ~result)
        carry, overflow, adjust = out < 0, (left ^ result) & (right ^ result) < 0, out
    elif what == OR:
        result = left | right
    elif what in (AND, TEST):
        result = left & right
    elif what == XOR:
        result = left ^ right
    else:
        result = fit(left - right - (old if what == SBB else 0), size)
        out = (~left & right) | ((~left | right) & result)
        carry, overflow, adjust = out < 0, (left ^ right) & (left ^ result) < 0, out
    _flags(s, mask & ~CF if what in (INC, DEC) else mask, carry, overflow, result)
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
    if what == SHL:
        result = fit(left << count, size)
        carry = count <= bits and left >> (bits - count) & 1 == 1
        overflow = carry != (result < 0)
    elif what == SAR:
        result = left >> count
    elif what == SHR:
        result, overflow = fit(unsigned >> count & ((1 << (64 - count)) - 1), size), left < 0
        carry = unsigned >> (count - 1) & 1 == 1
    elif size == 8:
        s.status = LEFT
        return left
    else:
        turn, mask = count % bits if what == ROL else -count % bits, CF | OF
        result = fit(unsigned << turn | unsigned >> (bits - turn), size)
        low, high, second = result & 1 == 1, result < 0, result >> (bits - 2) & 1 == 1
        carry, overflow = low if what == ROL else high, high != (low if what == ROL else second)
    _flags(s, mask, carry, overflow, result)
    return result


@hot
def change_bit(s, what, left, number, size):
    """One bit, which goes to the carry, is set, reset or turned."""
    one = 1 << number
    _flags(s, CF, left >> number & 1 == 1, False, 0)
    if what == BT:
        return left
    return fit(left | one if what == BTS else left & ~one if what == BTR else left ^ one, size)
