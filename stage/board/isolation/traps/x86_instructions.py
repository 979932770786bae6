"""Table of the x86-64 instructions that may access a window, or that stand between two such accesses.

`TABLE[opcode]`, and `TABLE[0x100 | opcode]` for opcodes after 0Fh, says what an instruction does, its target, its source, and the
size of its operands in bytes. If the byte after the opcode decides, the entry is in `TABLE[FIRST_GROUP_ROW + 8 * group + reg]`.
(Intel 64 and IA-32 Architectures Software Developer's Manual, volume 2, appendix A.)
"""

from __future__ import annotations

import numpy as np

from stage.native import record

ADD, OR, ADC, SBB, AND, SUB, XOR, CMP, TEST, NEG, INC, DEC = range(12)
ROL, ROR, SHL, SHR, SAR = 16, 17, 20, 21, 23
MOV, MOVZX, NOT, SIGN, CMOV, SETCC, IMUL, IMUL3, XCHG, NOP = range(24, 34)
BT, BTS, BTR, BTC = range(36, 40)
PUSH, POP, CALL, RET, JMP, JCC, LEAVE = range(40, 47)
MOVS, STOS = range(48, 50)
GROUP, GROUP_DONE = 64, 72
"""Operation of an opcode that stands for group 0 of instructions; the other groups follow, up to GROUP_DONE."""

NONE, E, G, A, D, R, IMM, ONE, CL, EA = range(10)
"""Operands: E is a register or memory, as the byte behind the opcode says, G a register that it names, A RAX or the lower part of
it, D RDX, R the register that the opcode names; what follows; 1; CL; the address of E itself."""

OPCODE = record([(name, "i8") for name in "operation known modrm width source_width target source immediate".split()])
"""known: whether it is in the table. modrm: whether a byte with E and G follows. width: bytes of the operands, 0 where prefixes say
it; source_width: of the source, 0 for the same. immediate: bytes that follow; FULL: as many as operands have,
UP_TO_4: but 4 at most."""
FULL, UP_TO_4 = 16, 17
FIRST_GROUP_ROW = 512


ARITHMETIC, SHIFTS, UNARY, COUNT, OFF, BITS = range(6)
"""Groups of instructions that share an opcode; the byte after the opcode selects one of them."""
PAIRED_OPCODES = (
    *((8 * operation, operation, E, G, 0) for operation in range(ADD, TEST)),
    *((8 * operation + 2, operation, G, E, 0) for operation in range(ADD, TEST)),
    *((8 * operation + 4, operation, A, IMM, UP_TO_4) for operation in range(ADD, TEST)),
    (0x80, GROUP + ARITHMETIC, E, IMM, UP_TO_4), (0x84, TEST, E, G, 0), (0x86, XCHG, E, G, 0), (0x88, MOV, E, G, 0),
    (0x8A, MOV, G, E, 0), (0xA0, MOV, A, E, 8), (0xA2, MOV, E, A, 8), (0xA4, MOVS, NONE, NONE, 0), (0xA8, TEST, A, IMM, UP_TO_4),
    (0xAA, STOS, NONE, NONE, 0), (0xC0, GROUP + SHIFTS, E, IMM, 1), (0xC6, MOV, E, IMM, UP_TO_4), (0xD0, GROUP + SHIFTS, E, ONE, 0),
    (0xD2, GROUP + SHIFTS, E, CL, 0), (0xF6, GROUP + UNARY, E, NONE, 0),
)  # fmt: skip
"""Opcodes for bytes, each with the next one for operands whose size prefixes say: opcode, what it does, target, source,
immediate."""
SINGLE_OPCODES = (
    ((0x83,), GROUP + ARITHMETIC, E, IMM, 0, 0, 1), ((0xFE,), GROUP + COUNT, E, ONE, 1, 0, 0),
    ((0xFF,), GROUP + OFF, E, NONE, 0, 0, 0), ((0x1BA,), GROUP + BITS, E, IMM, 0, 0, 1), ((0x1A3,), BT, E, G, 0, 0, 0),
    ((0x1AB,), BTS, E, G, 0, 0, 0),
    ((0x1B3,), BTR, E, G, 0, 0, 0), ((0x1BB,), BTC, E, G, 0, 0, 0), (range(0x50, 0x58), PUSH, NONE, R, 8, 0, 0),
    (range(0x58, 0x60), POP, R, NONE, 8, 0, 0), ((0x63,), MOV, G, E, 0, 4, 0), ((0x68,), PUSH, NONE, IMM, 8, 0, 4),
    ((0x6A,), PUSH, NONE, IMM, 8, 0, 1), ((0x69,), IMUL3, G, E, 0, 0, UP_TO_4), ((0x6B,), IMUL3, G, E, 0, 0, 1),
    ((0x1AF,), IMUL, G, E, 0, 0, 0), (range(0x70, 0x80), JCC, NONE, IMM, 8, 0, 1), (range(0x180, 0x190), JCC, NONE, IMM, 8, 0, 4),
    ((0x8D,), MOV, G, EA, 0, 0, 0), ((0x90,), NOP, NONE, NONE, 0, 0, 0), (range(0x91, 0x98), XCHG, R, A, 0, 0, 0),
    ((0x98,), MOV, A, A, 0, 0, 0),  # of half the size
    ((0x99,), SIGN, D, A, 0, 0, 0), (range(0xB0, 0xB8), MOV, R, IMM, 1, 0, FULL), (range(0xB8, 0xC0), MOV, R, IMM, 0, 0, FULL),
    ((0xC3,), RET, NONE, NONE, 0, 0, 0), ((0xC9,), LEAVE, NONE, NONE, 0, 0, 0), ((0xE8,), CALL, NONE, IMM, 8, 0, 4),
    ((0xE9,), JMP, NONE, IMM, 8, 0, 4), ((0xEB,), JMP, NONE, IMM, 8, 0, 1), ((0x11E, 0x11F), NOP, NONE, NONE, 0, 0, 0),
    (range(0x140, 0x150), CMOV, G, E, 0, 0, 0), (range(0x190, 0x1A0), SETCC, E, ONE, 1, 0, 0), ((0x1B6,), MOVZX, G, E, 0, 1, 0),
    ((0x1B7,), MOVZX, G, E, 0, 2, 0), ((0x1BE,), MOV, G, E, 0, 1, 0), ((0x1BF,), MOV, G, E, 0, 2, 0),
)  # fmt: skip
"""Other opcodes: what they do, target, source, size of operands, size of the source, immediate."""
GROUP_MEMBERS = (
    *((ARITHMETIC, k, k, NONE, NONE, 0, 0) for k in range(8)),
    *((SHIFTS, k, operation, NONE, NONE, 0, 0) for k, operation in ((0, ROL), (1, ROR), (4, SHL), (5, SHR), (6, SHL), (7, SAR))),
    (UNARY, 0, TEST, E, IMM, 0, UP_TO_4), (UNARY, 1, TEST, E, IMM, 0, UP_TO_4), (UNARY, 2, NOT, E, E, 0, 0),
    (UNARY, 3, NEG, E, E, 0, 0), (COUNT, 0, INC, E, ONE, 0, 0), (COUNT, 1, DEC, E, ONE, 0, 0), (OFF, 0, INC, E, ONE, 0, 0),
    (OFF, 1, DEC, E, ONE, 0, 0), (OFF, 2, CALL, NONE, E, 8, 0), (OFF, 4, JMP, NONE, E, 8, 0), (OFF, 6, PUSH, NONE, E, 8, 0),
    *((BITS, k, operation, NONE, NONE, 0, 0) for k, operation in ((4, BT), (5, BTS), (6, BTR), (7, BTC))),
)  # fmt: skip
"""Members of groups: group, number in the byte, what they do, target, source, size of operands, immediate."""


def _make_table() -> np.ndarray:
    """Build the table of OPCODE records of the x86 interpreter: for opcodes, and for the members of groups behind them."""
    table = np.zeros(FIRST_GROUP_ROW + 8 * (GROUP_DONE - GROUP), OPCODE)

    def put(opcode: int, operation: int, target: int, source: int, size: int, source_size: int, immediate: int) -> None:
        """Store the OPCODE record of one x86 opcode in the table."""
        modrm = E in (target, source) or G in (target, source) or opcode in (0x11E, 0x11F)
        by_address = immediate == 8  # it says the address of E itself
        table[opcode] = (operation, 1, modrm and not by_address, size, source_size, target, source, immediate)

    for opcode, operation, target, source, immediate in PAIRED_OPCODES:
        put(opcode, operation, target, source, 1, 0, immediate)
        put(opcode + 1, operation, target, source, 0, 0, immediate)
    for opcodes, *rest in SINGLE_OPCODES:
        for opcode in opcodes:
            put(opcode, *rest)
    for number, reg, operation, target, source, size, immediate in GROUP_MEMBERS:
        put(FIRST_GROUP_ROW + 8 * number + reg, operation, target, source, size, 0, immediate)
    return table


TABLE = _make_table()
