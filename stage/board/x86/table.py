"""The instructions of x86-64 that an access to a window may be part of, or stand between two of them: as a table.

`TABLE[opcode]`, of those that begin with 0Fh `TABLE[0x100 | opcode]`, says what an instruction does, by which operands, of how many
bytes. E is a register or memory, as the byte behind the opcode says, G a register of that byte, A the register AL, AX, EAX or RAX.
(Intel 64 and IA-32 Architectures Software Developer's Manual, volume 2, appendix A.)
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stage.native import record

ADD, OR, ADC, SBB, AND, SUB, XOR, CMP = range(8)
TEST, NOT, NEG, INC, DEC = range(8, 13)
ROL, ROR, SHL, SHR, SAR = 16, 17, 20, 21, 23
MOV, MOVZX, MOVSX, LEA, XCHG, IMUL, SETCC, CMOV = range(24, 32)
BT, BTS, BTR, BTC = range(36, 40)
PUSH, POP, CALL, RET, JMP, JCC, LEAVE, NOP, WIDEN, SIGN, MOVS, STOS, LODS = range(40, 53)
ARITHMETIC, SHIFTS, BITS, UNARY, COUNT, MOVE, OFF = range(64, 71)
"""Groups: the byte behind the opcode says which one it is."""

NO, E_G, G_E, E_IMM8, E_IMM, A_IMM, E_ONE, E_ONCE, E_CL, G_E_IMM8, G_E_IMM, A_AT, AT_A, R_IMM, R, IMM8, IMM, ALONE = (
    range(18)
)
"""Operands: target and source. E_ONE: E and nothing else; E_ONCE: E and 1; A_AT: A and the memory at the address that follows;
R: the register that the opcode names."""
WITH_MODRM = (
    1 << E_G | 1 << G_E | 1 << E_IMM8 | 1 << E_IMM | 1 << E_ONE | 1 << E_ONCE | 1 << E_CL | 1 << G_E_IMM8 | 1 << G_E_IMM
)

OPCODE = record([("what", "i8"), ("form", "i8"), ("size", "i8"), ("source", "i8")])
"""size: bytes of the operands; 0 where prefixes say it. source: bytes of the source, if they are others."""


def _table() -> np.ndarray:
    table = np.zeros(512, OPCODE)

    def put(opcodes: Iterable[int], what: int, form: int, size: int = 0, source: int = 0) -> None:
        for opcode in opcodes:
            table[opcode] = (what, form, size, source)

    for what in range(8):
        for k, (form, size) in enumerate(((E_G, 1), (E_G, 0), (G_E, 1), (G_E, 0), (A_IMM, 1), (A_IMM, 0))):
            put([what * 8 + k], what, form, size)
    for opcode, what, form in (
            (0x84, TEST, E_G), (0x86, XCHG, E_G), (0x88, MOV, E_G), (0x8A, MOV, G_E), (0xA0, MOV, A_AT), (0xA2, MOV, AT_A),
            (0xA4, MOVS, ALONE), (0xA8, TEST, A_IMM), (0xAA, STOS, ALONE), (0xAC, LODS, ALONE), (0xC0, SHIFTS, E_IMM8),
            (0xC6, MOVE, E_IMM), (0xD0, SHIFTS, E_ONCE), (0xD2, SHIFTS, E_CL), (0xF6, UNARY, E_ONE), (0xFE, COUNT, E_ONE),
    ):  # fmt: skip
        put([opcode], what, form, 1)
        put([opcode + 1], OFF if opcode == 0xFE else what, form)
    put([0x80], ARITHMETIC, E_IMM, 1)
    put([0x81], ARITHMETIC, E_IMM)
    put([0x83], ARITHMETIC, E_IMM8)
    put(range(0x50, 0x58), PUSH, R, 8)
    put(range(0x58, 0x60), POP, R, 8)
    put([0x63], MOVSX, G_E, 0, 4)
    put([0x68], PUSH, IMM, 8)
    put([0x6A], PUSH, IMM8, 8)
    put([0x69], IMUL, G_E_IMM)
    put([0x6B], IMUL, G_E_IMM8)
    put(range(0x70, 0x80), JCC, IMM8, 4)
    put([0x8D], LEA, G_E)
    put(range(0x90, 0x98), XCHG, R)
    put([0x98], WIDEN, ALONE)
    put([0x99], SIGN, ALONE)
    put(range(0xB0, 0xB8), MOV, R_IMM, 1)
    put(range(0xB8, 0xC0), MOV, R_IMM)
    put([0xC3], RET, ALONE)
    put([0xC9], LEAVE, ALONE)
    put([0xE8], CALL, IMM, 4)
    put([0xE9], JMP, IMM, 4)
    put([0xEB], JMP, IMM8, 4)
    two = 0x100
    put([two | 0x1E, two | 0x1F], NOP, E_ONE)
    put(range(two | 0x40, two | 0x50), CMOV, G_E)
    put(range(two | 0x80, two | 0x90), JCC, IMM, 4)
    put(range(two | 0x90, two | 0xA0), SETCC, E_ONE, 1)
    for opcode, what in ((0xA3, BT), (0xAB, BTS), (0xB3, BTR), (0xBB, BTC)):
        put([two | opcode], what, E_G)
    put([two | 0xBA], BITS, E_IMM8)
    put([two | 0xAF], IMUL, G_E)
    for opcode, what in ((0xB6, MOVZX), (0xBE, MOVSX)):
        put([two | opcode], what, G_E, 0, 1)
        put([two | opcode | 1], what, G_E, 0, 2)
    return table


TABLE = _table()
