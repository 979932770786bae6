"""Compiled single-wire UART of the TMC2209: bytes of the host arrive in simulated time, datagrams act, replies leave.

A byte is a start bit, 8 data bits from the lowest on, and a stop bit. The chip takes the host's rate from the sync nibble, so a
rate within its range needs no setting; it replies at the same rate.
"""

from __future__ import annotations

from pulsestage_trinamic.tmc2209 import maps, power_stage, register_file, state
from stage.native import greatest, hot

BYTE_BITS = 10
SYNC = 0x5
MASTER_ADDRESS = 0xFF
WRITE_BIT = 0x80
READ_SIZE, WRITE_SIZE = 4, 8
PAUSE_BITS = 63
"""A datagram ends without effect when two start bits are further apart."""
RECOVERY_BITS = 12
"""Idle time after which the chip listens again when it has lost a datagram."""
SLOWEST_BAUD, CLOCKS_PER_BIT = 9000, 16
"""Limits of the automatic rate: bits per second, and clocks of the chip per bit."""


@hot
def add_to_crc(crc, byte):
    """Add a byte to the CRC of polynomial x^8 + x^2 + x + 1, lowest bit first."""
    for _ in range(8):
        crc = (crc << 1 ^ 0x07) & 0xFF if (crc >> 7 ^ byte) & 1 else crc << 1 & 0xFF
        byte >>= 1
    return crc


@hot
def compute_bit_clocks(c):
    return greatest(1, c.bit_ns * c.hz // 1_000_000_000)


@hot
def reset_uart(c):
    """Clear the TMC2209's side of the UART line. Bytes of the host that are on their way stay."""
    c.received = c.lost_sync = 0
    c.byte_begin = c.byte_end = -state.NEVER
    c.replied, c.replies = state.MAX_DATAGRAM_BYTES, state.NEVER
    c.datagrams = c.others = 0
    for kind in range(state.IGNORED_KIND_COUNT):
        c.mistakes[kind] = 0


@hot
def send_to_chip(c, byte):
    """Let the host send a byte, after those that it has sent before. A byte beyond QUEUE is lost."""
    if c.queued - c.delivered >= state.UART_QUEUE_BYTES:
        return
    if c.queued == c.delivered:
        c.arrives = greatest(c.clock, c.byte_end) + BYTE_BITS * compute_bit_clocks(c)
    c.to_chip[c.queued % state.UART_QUEUE_BYTES] = byte & 0xFF
    c.queued += 1


@hot
def take_byte(c):
    """Return the next byte that the TMC2209 has sent to the host over its UART, or -1."""
    if c.collected == c.sent:
        return -1
    c.collected += 1
    return c.to_host[(c.collected - 1) % state.UART_QUEUE_BYTES]


@hot
def find_next_event(c):
    """Return the clock of the next byte on the UART line in either direction, or NEVER."""
    return c.arrives if c.arrives < c.replies else c.replies


@hot
def process_event(c):
    """Process the byte that the UART has received, or send the next byte of a reply, at this clock."""
    if c.clock >= c.arrives:
        byte = c.to_chip[c.delivered % state.UART_QUEUE_BYTES]
        c.delivered += 1
        receive_byte(c, byte, True)
        c.arrives = c.clock + BYTE_BITS * compute_bit_clocks(c) if c.queued > c.delivered else state.NEVER
    elif c.clock >= c.replies:
        _send_reply_byte(c)


@hot
def _is_rate_understood(c, bits):
    return bits * SLOWEST_BAUD <= c.hz and bits * c.f_clk >= CLOCKS_PER_BIT * c.hz


@hot
def _count_ignored_datagram(c, kind, detail):
    """Count a datagram or byte on the UART line that has no effect."""
    if c.mistakes[kind] == 0:
        c.mistake_clock[kind], c.mistake_detail[kind] = c.clock, detail
    c.mistakes[kind] += 1


@hot
def _raise_line(c):
    """Raise PDN_UART: the line is high while it is idle, and the current then stays at IRUN without pdn_disable."""
    if not c.inputs & state.PDN:
        c.inputs |= state.PDN
        power_stage.apply_current_registers(c)


@hot
def receive_byte(c, byte, is_of_host):
    """Let the TMC2209 receive a byte whose stop bit ends now, of the host or of another chip on the wire."""
    bits = compute_bit_clocks(c)
    begin = c.clock - BYTE_BITS * bits
    if c.received and begin - c.byte_begin > PAUSE_BITS * bits:
        c.received = 0
    if c.lost_sync and begin - c.byte_end >= RECOVERY_BITS * bits:
        c.lost_sync = 0
    c.byte_begin, c.byte_end = begin, c.clock
    _raise_line(c)
    if not is_of_host:
        c.others += 1
    if not _is_rate_understood(c, bits):
        _count_ignored_datagram(c, state.BAD_RATE, c.bit_ns)
        return
    if c.lost_sync or c.replied < state.MAX_DATAGRAM_BYTES:
        return
    if c.received == 0 and byte & 0xF != SYNC:
        c.lost_sync = 1
        if is_of_host:
            _count_ignored_datagram(c, state.BAD_SYNC, byte)
        return
    c.datagram[c.received] = byte
    c.received += 1
    if c.received < READ_SIZE:
        return
    size = WRITE_SIZE if c.datagram[2] & WRITE_BIT else READ_SIZE
    if c.received == size:
        c.received = 0
        _execute_datagram(c, size, bits, is_of_host)


@hot
def _execute_datagram(c, size, bits, is_of_host):
    """Execute a whole UART datagram, if its CRC is right and it is for this TMC2209."""
    crc = 0
    for k in range(size - 1):
        crc = add_to_crc(crc, c.datagram[k])
    if crc != c.datagram[size - 1]:
        c.lost_sync = 1
        if is_of_host:
            _count_ignored_datagram(c, state.BAD_CRC, c.datagram[2])
        return
    address = (1 if c.inputs & state.MS1 else 0) | (2 if c.inputs & state.MS2 else 0)
    if c.datagram[1] != address:
        if is_of_host:
            _count_ignored_datagram(c, state.OTHER_ADDRESS, c.datagram[1])
        return
    c.datagrams += 1
    register = c.datagram[2] & 0x7F
    if size == WRITE_SIZE:
        value = c.datagram[3] << 24 | c.datagram[4] << 16 | c.datagram[5] << 8 | c.datagram[6]
        c.ifcnt = c.ifcnt + 1 & 0xFF
        if maps.STORED_BITS[register] == 0:
            _count_ignored_datagram(c, state.READ_ONLY if maps.IS_READABLE[register] else state.NO_REGISTER, register)
        register_file.write_register(c, register, value)
        return
    _prepare_reply(c, register, register_file.read_register(c, register))
    delay = ((c.registers[state.SLAVECONF] >> 9 & 7) * 2 + 1) * 8
    c.replied = 0
    c.replies = c.clock + (delay + BYTE_BITS) * bits


@hot
def _prepare_reply(c, register, value):
    c.reply[0], c.reply[1], c.reply[2] = SYNC, MASTER_ADDRESS, register
    crc = 0
    for k in range(4):
        c.reply[3 + k] = value >> 8 * (3 - k) & 0xFF
    for k in range(state.MAX_DATAGRAM_BYTES - 1):
        crc = add_to_crc(crc, c.reply[k])
    c.reply[state.MAX_DATAGRAM_BYTES - 1] = crc


@hot
def _send_reply_byte(c):
    """Send the byte of the reply whose stop bit ends now; the oldest unread byte is lost when the host reads none."""
    if c.sent - c.collected >= state.UART_QUEUE_BYTES:
        c.collected += 1
    c.to_host[c.sent % state.UART_QUEUE_BYTES] = c.reply[c.replied]
    c.sent += 1
    c.replied += 1
    c.byte_end = c.clock
    c.replies = c.clock + BYTE_BITS * compute_bit_clocks(c) if c.replied < state.MAX_DATAGRAM_BYTES else state.NEVER
