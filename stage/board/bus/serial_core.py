"""A serial line between firmware and its other end, compiled: bytes in both directions, in memory.

Firmware takes the bytes that have arrived and sends its own in simulated time. The other end moves bytes while the firmware
is paused, see `stage.board.serial_line`.
"""

from __future__ import annotations

from stage.native import hot, least, record

LINE_BUFFER_SIZE = 4096
"""Bytes that can be on their way in each direction."""
SERIAL_LINE_COUNT = 8
"""Serial lines of a host."""
NO_BYTE, ANY_BYTE = -1, -2
SECOND = 1_000_000_000
BITS_PER_BYTE = 10
"""Bits of a character on the line: a start bit, 8 data bits, a stop bit."""
SERIAL_LINE = record(
    [
        (name, "i8")
        for name in "fed removed sent read lost pausing_byte is_open is_wired byte_ns due sent_byte_ns".split()
    ]
    + [("incoming", "u1", (LINE_BUFFER_SIZE,)), ("outgoing", "u1", (LINE_BUFFER_SIZE,))]
)
"""fed, removed    bytes from the other end so far, and how many of them the firmware has read
    sent, read      bytes of the firmware so far, and how many of them the other end has taken
    lost            bytes of the firmware that found no room
    pausing_byte    the byte after which the firmware pauses, NO_BYTE or ANY_BYTE
    is_open         whether the other end takes bytes
    is_wired        whether the firmware has a serial line
    byte_ns, due    ns that a byte takes (0: none), where no emulated UART counts that itself; when the next byte has arrived
    sent_byte_ns    ns that the last byte of an emulated UART took
    incoming, outgoing   circular buffers
"""


@hot
def count_arrived(line, now):
    """Count the bytes of a serial line that have arrived at `now` (ns) and that the firmware has not taken."""
    waiting = line.fed - line.removed
    if waiting <= 0 or line.byte_ns == 0:
        return waiting
    return least(waiting, (now - line.due) // line.byte_ns + 1) if now >= line.due else 0


@hot
def peek_byte(line, now):
    """Return the next byte that has arrived on a serial line at `now` (ns), without removing it.

    NO_BYTE if there is none.
    """
    return line.incoming[line.removed % LINE_BUFFER_SIZE] if count_arrived(line, now) > 0 else NO_BYTE


@hot
def remove_byte(line, now):
    """Remove the next byte that has arrived on a serial line and return it; NO_BYTE if there is none."""
    if count_arrived(line, now) <= 0:
        return NO_BYTE
    byte = line.incoming[line.removed % LINE_BUFFER_SIZE]
    line.removed += 1
    line.due += line.byte_ns
    return byte


@hot
def set_rate(line, now, bits_per_second):
    """Set the bit rate of a serial line. Bytes on their way arrive at the new rate; at rate 0, bytes take no time."""
    line.byte_ns = BITS_PER_BYTE * SECOND // bits_per_second if bits_per_second > 0 else 0
    line.due = now + line.byte_ns


@hot
def put_byte(line, value):
    """Put a byte of the firmware on a serial line. Return whether the firmware must pause after it."""
    if line.sent - line.read >= LINE_BUFFER_SIZE:
        line.lost += 1
        return False
    line.outgoing[line.sent % LINE_BUFFER_SIZE] = value
    line.sent += 1
    return line.pausing_byte in (value, ANY_BYTE)
