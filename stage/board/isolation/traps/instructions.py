"""The instructions of x86-64 that an access to a window may be part of, or that stand between two of them: as a table.

`TABLE[opcode]`, of those that begin with 0Fh `TABLE[0x100 | opcode]`, says what an instruction does, to which target, from which
source, with operands of how many bytes. What the byte behind the opcode decides is in `TABLE[GROUPS + 8 * group + reg]`.
(Intel 64 and IA-32 Architectures Software Developer's Manual, volume 2, appendix A.)
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stage.native import record

ADD, OR, ADC, SBB, AND, SUB, XOR, CMP, TEST, NEG, INC, DEC = range(12)
ROL, ROR, SHL, SHR, SAR = 16, 17, 20, 21, 23
MOV, MOVZX, NOT, SIGN, CMOV, SETCC, IMUL, IMUL3, XCHG, NOP = range(24, 34)
BT, BTS, BTR, BTC = range(36, 40)
PUSH, POP, CALL, RET, JMP, JCC, LEAVE = range(40, 47)
MOVS, STOS = range(48, 50)
GROUP, GROUP_DONE = 64, 72
"""From here on: groups."""

NONE, E, G, A, D, R, IMM, ONE, CL, EA = range(10)
"""Operands: E is a register or memory, as the byte behind the opcode says, G a register that it names, A RAX or the lower part of
it, D RDX, R the register that the opcode names; what follows; 1; CL; the address of E itself."""

OPCODE = record([(name, "i8") for name in "what known modrm width source_width target source immediate".split()])
"""known: whether it is in the table. modrm: whether a byte with E and G follows. width: bytes of the operands, 0 where prefixes say
it; source_width: of the source, 0 for the same. immediate: bytes that follow; FULL: as many as operands have,
UP_TO_4: but 4 at most."""
FULL, UP_TO_4 = 16, 17
GROUPS = 512


def _table() -> np.ndarray:
    table = np.zeros(GROUPS + 8 * (GROUP_DONE - GROUP), OPCODE)

    def put(
        opcodes: Iterable[int], what: int, target: int = NONE, source: int = NONE, size: int = 0, source_size: int = 0,
        immediate: int = 0, modrm: bool = False,
    ) -> None:  # fmt: skip
        for opcode in opcodes:
            modrm = modrm or E in (target, source) or G in (target, source)
            table[opcode] = (what, 1, modrm, size, source_size, target, source, immediate)

    def both(opcode: int, what: int, target: int, source: int, immediate: int = 0, modrm: bool = False) -> None:
        """An opcode for bytes, and the next one for what prefixes say."""
        for k, size in enumerate((1, 0)):
            put([opcode + k], what, target, source, size, 0, immediate, modrm)

    def group(
        number: int, members: Iterable[tuple[int, int]], target: int, source: int, size: int = 0, immediate: int = 0
    ) -> None:
        """The members of a group: (number in the byte, what it does)."""
        for reg, what in members:
            put([GROUPS + 8 * number + reg], what, target, source, size, 0, immediate)

    for what in range(ADD, TEST):
        both(8 * what, what, E, G)
        both(8 * what + 2, what, G, E)
        both(8 * what + 4, what, A, IMM, UP_TO_4)
    for opcode, what, target, source, immediate in (
        (0x84, TEST, E, G, 0), (0x86, XCHG, E, G, 0), (0x88, MOV, E, G, 0), (0x8A, MOV, G, E, 0), (0xA0, MOV, A, E, 8),
        (0xA2, MOV, E, A, 8), (0xA4, MOVS, NONE, NONE, 0), (0xA8, TEST, A, IMM, UP_TO_4), (0xAA, STOS, NONE, NONE, 0),
        (0xC6, MOV, E, IMM, UP_TO_4),
    ):  # fmt: skip
        both(opcode, what, target, source, immediate)
    for k in range(4):  # these say the address of E themselves
        table[0xA0 + k]["modrm"] = 0
    arithmetic, shifts, unary, count, off, bits = range(6)
    both(0x80, GROUP + arithmetic, E, IMM, UP_TO_4)
    put([0x83], GROUP + arithmetic, E, IMM, immediate=1)
    for opcode, source, immediate in ((0xC0, IMM, 1), (0xD0, ONE, 0), (0xD2, CL, 0)):
        both(opcode, GROUP + shifts, E, source, immediate)
    both(0xF6, GROUP + unary, E, NONE)
    put([0xFE], GROUP + count, E, ONE, 1)
    put([0xFF], GROUP + off, E)
    put([0x1BA], GROUP + bits, E, IMM, immediate=1)
    group(arithmetic, ((k, k) for k in range(8)), NONE, NONE)
    group(shifts, ((0, ROL), (1, ROR), (4, SHL), (5, SHR), (6, SHL), (7, SAR)), NONE, NONE)
    group(unary, ((0, TEST), (1, TEST)), E, IMM, immediate=UP_TO_4)
    group(unary, ((2, NOT), (3, NEG)), E, E)
    group(count, ((0, INC), (1, DEC)), E, ONE)
    group(off, ((0, INC), (1, DEC)), E, ONE)
    group(off, ((2, CALL), (4, JMP), (6, PUSH)), NONE, E, 8)
    group(bits, ((4, BT), (5, BTS), (6, BTR), (7, BTC)), NONE, NONE)
    for opcode, what in ((0x1A3, BT), (0x1AB, BTS), (0x1B3, BTR), (0x1BB, BTC)):
        put([opcode], what, E, G)
    put(range(0x50, 0x58), PUSH, NONE, R, 8)
    put(range(0x58, 0x60), POP, R, NONE, 8)
    put([0x63], MOV, G, E, 0, 4)
    put([0x68], PUSH, NONE, IMM, 8, 0, 4)
    put([0x6A], PUSH, NONE, IMM, 8, 0, 1)
    put([0x69], IMUL3, G, E, immediate=UP_TO_4)
    put([0x6B], IMUL3, G, E, immediate=1)
    put([0x1AF], IMUL, G, E)
    put(range(0x70, 0x80), JCC, NONE, IMM, 8, 0, 1)
    put(range(0x180, 0x190), JCC, NONE, IMM, 8, 0, 4)
    put([0x8D], MOV, G, EA)
    put([0x90], NOP)
    put(range(0x91, 0x98), XCHG, R, A)
    put([0x98], MOV, A, A)  # of half the size
    put([0x99], SIGN, D, A)
    put(range(0xB0, 0xB8), MOV, R, IMM, 1, 0, FULL)
    put(range(0xB8, 0xC0), MOV, R, IMM, 0, 0, FULL)
    put([0xC3], RET)
    put([0xC9], LEAVE)
    put([0xE8], CALL, NONE, IMM, 8, 0, 4)
    put([0xE9], JMP, NONE, IMM, 8, 0, 4)
    put([0xEB], JMP, NONE, IMM, 8, 0, 1)
    put([0x11E, 0x11F], NOP, modrm=True)
    put(range(0x140, 0x150), CMOV, G, E)
    put(range(0x190, 0x1A0), SETCC, E, ONE, 1)
    for opcode, what in ((0x1B6, MOVZX), (0x1BE, MOV)):
        put([opcode], what, G, E, 0, 1)
        put([opcode | 1], what, G, E, 0, 2)
    return table


TABLE = _table()
