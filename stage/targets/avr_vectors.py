"""The interrupts of an AVR on simavr: which of them are enabled, and which come without a routine.

avr-libc leads each vector without a routine to one place, __bad_interrupt, which jumps to 0: the program begins again with its
memory as it is. Nobody means that. The word there is replaced by one that is no instruction, so that such an interrupt ends it.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from stage.native import array_at

NO_INSTRUCTION = b"\x07\x00"
_JMP, _RJMP = 0x940C, 0xC000
_BEFORE = (16, 24)
"""Bytes of an avr_int_vector_t in front of its IRQs: simavr 1.6 and 1.7 by the size of a regbit. The first is its number."""
_MOST = 128
_IRQ, _VALUE = 40, 20
"""Bytes of an avr_irq_t, and where the value stands in it."""
_STACK_POINTER = 0x5D
_ONE_WORD = 8192
"""Up to this size of the flash (bytes) a vector is one word."""
_THREE_BYTES = 0x20000
"""Above this size a return address has three bytes."""


class Vectors:
    """c: simavr's library; avr: the avr_t; flash: its bytes of flash.

    Attributes: addresses: of the avr_int_vector_t of each interrupt; none where this version of simavr is not known.
    """

    def __init__(self, c: Any, avr: int, flash: int):
        self._c, self._avr, self._flash = c, avr, flash
        get = c["avr_get_interrupt_irq"]
        get.restype = ctypes.c_void_p
        irqs = {n: at for n in range(1, _MOST) if (at := get(ctypes.c_void_p(avr), ctypes.c_uint8(n)))}
        self.addresses = np.zeros(0, "i8")
        self._running = {n: at + _IRQ + _VALUE for n, at in irqs.items()}
        for before in _BEFORE:
            if all(array_at(at - before, 1, np.dtype("u1"))[0] == n for n, at in irqs.items()):
                self.addresses = np.array([at - before for at in irqs.values()], "i8")
                break

    def guard(self, code: bytes) -> int:
        """The address to which the vectors without routines lead, in code that begins at 0; -1 if there is none. From now on the
        instruction there ends the run."""
        size = 2 if self._flash <= _ONE_WORD else 4
        targets = {_target(code, n * size, self._flash) for n in self._running}
        for place in sorted(targets):
            if place > 0 and _target(code, place, self._flash) == 0:
                self._c["avr_loadcode"](ctypes.c_void_p(self._avr), NO_INSTRUCTION, 2, place)
                return place
        return -1

    def come(self) -> str:
        """The interrupt whose routine is to run, by its name in avr-libc; "" if it is not known."""
        found = [n for n, at in self._running.items() if array_at(at, 1, np.dtype("u4"))[0]]
        return f"interrupt {found[0]} (__vector_{found[0]})" if found else "an interrupt"

    def interrupted(self) -> int:
        """The address that the routine would return to."""
        look = self._c["avr_core_watch_read"]

        def byte(at: int) -> int:
            return int(look(ctypes.c_void_p(self._avr), ctypes.c_uint16(at))) & 0xFF

        stack = byte(_STACK_POINTER) | byte(_STACK_POINTER + 1) << 8
        size = 3 if self._flash > _THREE_BYTES else 2
        return 2 * sum(byte(stack + 1 + k) << 8 * (size - 1 - k) for k in range(size))


def _target(code: bytes, at: int, flash: int) -> int:
    """Where the jump at an address leads, or -1 if there is none."""
    words = np.frombuffer(code[at : at + 4].ljust(4, b"\0"), "<u2")
    if words[0] & 0xFE0E == _JMP:
        return 2 * (int(words[0] & 0x01F0) << 13 | int(words[0] & 1) << 16 | int(words[1]))
    if words[0] & 0xF000 == _RJMP:
        distance = int(words[0] & 0xFFF)
        return (at + 2 + 2 * (distance - (distance >> 11 << 12))) % flash
    return -1
