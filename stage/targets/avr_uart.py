"""`AvrUart`: a serial line of a program on simavr, connected to the log and to the board.

simavr has no functions for the rate of a UART. Its registers and the cycles of a character are read from the structure avr_uart_t,
which `stage.targets.simavr_structure_offsets` describes. If `find_uart_layout` does not find them, the program's output still
goes to the log.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from stage.board.board import Board
from stage.native import array_at, get_function_address
from stage.targets import avr_serial
from stage.targets.simavr_structure_offsets import AVR_IRQ_T, AVR_MODULE_T, AVR_UART_T, list_modules, view_structure

UART_NAMES = "0123"
INPUT, OUTPUT, EMPTY = 0, 1, 2
"""simavr's IRQs of a UART: a byte for the program, a byte of the program, and that all bytes for it have been read."""
OVERRUN_MESSAGE = (
    b"UART: a byte was lost: the program had not read the 64 before it, of which a chip holds three (data overrun); "
    b"it is said once"
)
LOG_LINE_SIZE = 256  # bytes of a line of the log
IDLE_POLL_INTERVAL_S = 50e-6
"""Simulated time between two polls for a byte."""
RESET_BYTE_US = 100
"""Microseconds that simavr gives a character after a reset."""
_BIT_FIELDS = ("rxen", "u2x", "usbs", "ucsz", "ucsz2", "ubrrl", "ubrrh")
"""Fields of an avr_uart_t that are register bits as simavr packs them."""
_SEARCH_RANGE = slice(136, 624)
"""Bytes of an avr_uart_t in which the cycles of a character are."""
_UPM1 = 5
"""Bit of UCSRC that enables parity."""


@dataclass(frozen=True)
class UartLayout:
    """Position of the fields of an avr_uart_t that this module needs.

    Attributes:
        bits: The avr_regbit_t of each name of _BIT_FIELDS, and of upm.
        byte_cycles_at: Address of the field with the cycles of a character.
    """

    bits: dict[str, int]
    byte_cycles_at: int


def find_uart_layout(irqs: int, avr: int, name: str, hz: int) -> UartLayout | None:
    """Find the registers and the rate of a UART after a reset; return None if the structure is not as expected.

    Args:
        irqs: Address of the UART's simavr IRQs.
        avr: Address of the avr_t.
        name: Name of the UART, a digit.
        hz: Clock of the AVR, Hz.
    """
    uart = next((at for at in list_modules(avr) if int(view_structure(at, AVR_MODULE_T)["irq"]) == irqs), 0)
    if not uart:
        return None
    content: Any = array_at(uart, _SEARCH_RANGE.stop, np.dtype("u1"))
    places = np.flatnonzero(content[_SEARCH_RANGE].view("<u8") == hz * RESET_BYTE_US // 1_000_000)
    fields = view_structure(uart, AVR_UART_T)
    words = {bits: int(fields[bits]) for bits in _BIT_FIELDS}
    if fields["name"] != ord(name) or len(places) != 1 or words["ubrrl"] >> 12 != 0xFF or words["rxen"] >> 12 != 1:
        return None
    ucsrc = int(fields["frame"])
    words["upm"] = ucsrc | _UPM1 << 9 | 1 << 12 if ucsrc else 0
    return UartLayout(words, uart + _SEARCH_RANGE.start + 8 * int(places[0]))


class AvrUart:
    """Serial line of a program on simavr.

    Args:
        name: Name of the UART, a digit.
        avr: A LoadedAvr after its reset.
        irqs: Address of the UART's simavr IRQs.
        board: The board.
        line: Number of the board's serial line that it is.
    """

    def __init__(self, name: str, avr: Any, irqs: int, board: Board, line: int):
        self._avr, record = avr, avr.record
        self._text = ctypes.create_string_buffer(LOG_LINE_SIZE)
        self._row = np.zeros(1, avr_serial.UART)
        u = self._row[0]
        u.avr, u.address = record.own, self._row.ctypes.data
        u.text, u.room = ctypes.addressof(self._text), LOG_LINE_SIZE
        u.input, u.idle = irqs + INPUT * AVR_IRQ_T.itemsize, max(1, round(IDLE_POLL_INTERVAL_S * record.hz))
        u.register_timer = avr.find_function_address("avr_cycle_timer_register")
        self._sent_handler, self._receive = avr_serial.handle_sent_byte.pointer, avr_serial.receive_byte.pointer
        self._deliver = avr_serial.deliver_sent_byte.pointer
        u.deliver = get_function_address(self._deliver)
        layout = find_uart_layout(irqs, int(record.avr), name, int(record.hz))
        if layout is not None:
            u.connected, u.line, u.byte_cycles_at = 1, line, layout.byte_cycles_at
            for key, word in layout.bits.items():
                u[key] = word
        if u.connected:
            board.serial_lines.lines[line].record["is_wired"] = 1
            self._warning = ctypes.create_string_buffer(OVERRUN_MESSAGE)
            u.warning = ctypes.addressof(self._warning)
            self._read_handler = avr_serial.handle_read_byte.pointer
            avr.register_callback(irqs + EMPTY * AVR_IRQ_T.itemsize, self._read_handler, self._row)
        avr.register_callback(irqs + OUTPUT * AVR_IRQ_T.itemsize, self._sent_handler, self._row)

    def start_receiving(self) -> None:
        """Begin to receive bytes from the board."""
        u = self._row[0]
        if u.connected:
            self._avr.schedule_call(int(u.idle), self._receive, int(u.address))

    def flush_sent_bytes(self) -> None:
        """Pass the bytes that are still being sent to the board, at the end of a run."""
        avr_serial.flush_sent_bytes.c(int(self._row[0].address))
