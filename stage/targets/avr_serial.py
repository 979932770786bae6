"""Serial lines of an AVR on simavr, compiled: the log of what it sends, and the line to the board, byte by byte at its time.

A character takes the bits that UBRR, U2X and the frame format of UCSRC say. A received byte reaches the program at the end of its
stop bit; a sent one leaves at the end of its own. Bytes wait while the receiver is off, and are lost while it is full. The UART
of simavr interrupts once a character at most, so it gets a byte only when the program has read the one before.
"""

from __future__ import annotations

import numpy as np

from stage.board.bus.host_record import HOST, LOG, READ_SERIAL, SEND_SERIAL, TAKE
from stage.board.bus.serial_core import SECOND, SERIAL_LINE, SERIAL_LINE_COUNT
from stage.native import array_at, declare_address_call, exported, greatest, hot, record
from stage.sim.compiled_stage_access import INTEGER
from stage.targets.avr_clock_and_pins import AVR, get_cycle_count
from stage.targets.processor_clock_and_bus_cycles import advance_board, request

SEND_QUEUE_BYTES = 64
IDLE_POLL_FACTOR = 20
"""Ratio of the times between two looks at a line without another end and at one that has it."""
RECEIVER_BYTES = 64
"""Bytes that a receiver holds, as simavr's does; that of the chip holds three. With three, programs would lose bytes that a chip
does not lose, since simavr's transmitter has no buffer beside its shift register and is slower."""
UART = record(
    [(name, "i8") for name in "avr address text room length connected line input register_timer deliver".split()]
    + [
        (name, "i8")
        for name in "byte_cycles_at rxen u2x usbs ucsz ucsz2 ubrrl ubrrh upm idle receiving done queued first".split()
    ]
    + [(name, "i8") for name in "presented waiting oldest overruns warning".split()]
    + [("queue", "u1", (SEND_QUEUE_BYTES,)), ("ends", "i8", (SEND_QUEUE_BYTES,)), ("received", "u1", (RECEIVER_BYTES,))]
)
"""avr, address       its AVR, and the address of this record
    text, room, length  the text since its last line end; the size of the buffer, the bytes in it
    connected, line    whether it is a serial line of the board; its number there
    input              simavr's IRQ that a received byte raises
    register_timer, deliver   addresses of avr_cycle_timer_register and of `deliver_sent_byte`
    byte_cycles_at     where simavr keeps the cycles of a character
    rxen ... upm       bits of its registers, as simavr's avr_regbit_t; 0: there is none
    idle               cycles between two looks for a byte while none is on its way
    receiving          whether a byte is on its way
    done               the cycle at which the last sent byte has left
    queued, first      number of bytes that are being sent, and the place of the first of them
    presented          whether simavr's UART has a byte that the program has not read
    overruns, warning  bytes that were lost because the receiver was full; the text about the first
    queue, ends        the bytes that are being sent, and the cycles at which they have left
    received           the `waiting` bytes of the receiver behind the one that is presented, from place `oldest` on
"""
BYTE_TYPE = np.dtype("u1")
LINE_END, CARRIAGE_RETURN = 10, 13
_register_timer = declare_address_call(None, "i8", "i8", "i8", "i8")
_raise_irq, _read_memory = declare_address_call(None, "i8", "i4"), declare_address_call("i4", "i8", "i4")


@hot
def _read_bits(cpu, bits):
    """Return the register bits that an avr_regbit_t describes; 0 if `bits` is 0."""
    if bits == 0:
        return 0
    return _read_memory(cpu.read_memory, (cpu.avr, bits & 0x1FF)) >> (bits >> 9 & 7) & (bits >> 12 & 0xFF)


@hot
def _count_character_cycles(cpu, uart):
    """Return the cycles of a character: a start bit, 5 to 9 data bits, a parity bit if enabled, one or two stop bits."""
    size = _read_bits(cpu, uart.ucsz) | _read_bits(cpu, uart.ucsz2) << 2
    data = 9 if size == 7 else 5 + size if size < 4 else 8
    bits = 2 + data + _read_bits(cpu, uart.upm) + _read_bits(cpu, uart.usbs)
    divisor = _read_bits(cpu, uart.ubrrl) | _read_bits(cpu, uart.ubrrh) << 8
    return bits * (divisor + 1) * (8 if _read_bits(cpu, uart.u2x) else 16)


@hot
def _get_serial_line(cpu, uart):
    """Return the board's serial line of a UART."""
    return array_at(array_at(cpu.host, 1, HOST)[0].serial, SERIAL_LINE_COUNT, SERIAL_LINE)[uart.line]


@exported(None, "i8", "i4", UART)
def handle_sent_byte(_irq, value, uart):
    """Add a byte that the program sends to the log, and begin to send it to the board. simavr calls this."""
    cpu = array_at(uart.avr, 1, AVR)[0]
    if uart.line == 0 or not _get_serial_line(cpu, uart).is_open:
        _log_byte(cpu, uart, value)
    if uart.byte_cycles_at == 0:
        return
    duration = _count_character_cycles(cpu, uart)
    array_at(uart.byte_cycles_at, 1, INTEGER)[0] = duration  # simavr counts a parity bit that is not there
    if uart.connected and uart.queued < SEND_QUEUE_BYTES:
        now = get_cycle_count(cpu)
        _get_serial_line(cpu, uart).sent_byte_ns = duration * SECOND // cpu.hz
        uart.done = greatest(uart.done, now) + duration
        place = (uart.first + uart.queued) % SEND_QUEUE_BYTES
        uart.queue[place], uart.ends[place] = value, uart.done
        uart.queued += 1
        if uart.queued == 1:
            _register_timer(uart.register_timer, (cpu.avr, uart.done - now, uart.deliver, uart.address))


@hot
def _log_byte(cpu, uart, value):
    """Add a byte to the line of text for the log, and log the line if it is complete."""
    text = array_at(uart.text, uart.room, BYTE_TYPE)
    if value != LINE_END and value != CARRIAGE_RETURN:
        text[uart.length] = value
        uart.length += 1
    if (value == LINE_END or uart.length == uart.room - 1) and uart.length:
        text[uart.length] = 0
        uart.length = 0
        advance_board(cpu, get_cycle_count(cpu))
        request(cpu, LOG, uart.text, 0)


@exported("i8", "i8", "i8", UART)
def deliver_sent_byte(_avr, when, uart):
    """Pass a byte whose stop bit has ended to the board.

    Returns:
        The cycle at which the next byte ends, or 0.
    """
    cpu = array_at(uart.avr, 1, AVR)[0]
    advance_board(cpu, when)
    _send_oldest_byte(cpu, uart)
    return uart.ends[uart.first] if uart.queued else 0


@hot
def _send_oldest_byte(cpu, uart):
    """Pass the oldest byte of the AVR's send queue to the board."""
    byte = uart.queue[uart.first]
    uart.first, uart.queued = (uart.first + 1) % SEND_QUEUE_BYTES, uart.queued - 1
    request(cpu, SEND_SERIAL, byte, uart.line)


@exported(None, UART)
def flush_sent_bytes(uart):
    """Pass the bytes that are still being sent to the board, at the end of a run."""
    cpu = array_at(uart.avr, 1, AVR)[0]
    while uart.queued:
        _send_oldest_byte(cpu, uart)


@hot
def _present_byte(cpu, uart, byte):
    """Pass a received byte to simavr's UART, which raises RXC in the next cycle. The byte's time on the line has passed."""
    simavr_cycles = array_at(uart.byte_cycles_at, 1, INTEGER)
    before, simavr_cycles[0] = simavr_cycles[0], 1
    uart.presented = 1
    _raise_irq(cpu.raise_irq, (uart.input, byte))
    simavr_cycles[0] = before


@hot
def _store_byte(cpu, uart, byte):
    """Store a received byte in the receiver of the AVR's UART. A byte that finds the receiver full is lost."""
    if not uart.presented:
        _present_byte(cpu, uart, byte)
    elif uart.waiting < RECEIVER_BYTES - 1:
        uart.received[(uart.oldest + uart.waiting) % RECEIVER_BYTES] = byte
        uart.waiting += 1
    else:
        if uart.overruns == 0:
            request(cpu, LOG, uart.warning, 0)
        uart.overruns += 1


@exported(None, "i8", "i4", UART)
def handle_read_byte(_irq, _value, uart):
    """Present the next byte of the receiver, because the program has read the last one. simavr calls this."""
    if uart.presented == 0:
        return
    uart.presented = 0
    if uart.waiting:
        byte = uart.received[uart.oldest]
        uart.oldest, uart.waiting = (uart.oldest + 1) % RECEIVER_BYTES, uart.waiting - 1
        _present_byte(array_at(uart.avr, 1, AVR)[0], uart, byte)


@exported("i8", "i8", "i8", UART)
def receive_byte(_avr, when, uart):
    """Pass a byte from the board to the receiver when its stop bit has ended.

    Returns:
        The cycle at which simavr calls this function next.
    """
    cpu = array_at(uart.avr, 1, AVR)[0]
    line = _get_serial_line(cpu, uart)
    if line.fed <= line.removed:
        uart.receiving = 0
        return when + (uart.idle if line.is_open else IDLE_POLL_FACTOR * uart.idle)
    is_on = _read_bits(cpu, uart.rxen)
    if not is_on:
        uart.presented = uart.waiting = 0  # simavr has cleared its buffer, too
    elif uart.receiving:
        advance_board(cpu, when)
        _store_byte(cpu, uart, request(cpu, READ_SERIAL, TAKE, uart.line))
    uart.receiving = 1 if is_on and line.fed > line.removed else 0
    return when + (_count_character_cycles(cpu, uart) if uart.receiving else uart.idle)
