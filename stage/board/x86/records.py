"""What the handler of faults knows of windows and memory, and of the instruction that it does."""

from __future__ import annotations

from stage.native import record

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
STEP = record(
    [
        (name, "i8")
        for name in (
            "own regs start at rex memory ea rm reg immediate repeated status changes mask stack floor since"
        ).split()
    ]
)
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
