"""16550 UART, compiled: registers, FIFOs of 16 bytes, and the line in simulated time.

Bytes of the peer wait in `incoming` and arrive one after the other, each after the time of a character. Bytes of the firmware
leave in the same way. The time at which the last of them will have left tells how many are still in the transmitter.
"""

from __future__ import annotations

from stage.native import exported, hot, least, record

FIFO, ROOM = 16, 4096
SENT_BUFFER_SIZE = ROOM + 2 * FIFO
"""Room for sent bytes: FIFO + 1 bytes in the transmitter may be written, cleared and written over."""
NEVER = 1 << 62
SECOND = 1_000_000_000
STATE = record(
    [
        (name, "i8")
        for name in "clock ier fcr lcr mcr scr divisor oe rbr fed taken due waiting first last written left armed".split()
    ]
    + [("fifo", "u1", (FIFO,)), ("incoming", "u1", (ROOM,)), ("sent", "u1", (SENT_BUFFER_SIZE,))]
)
"""clock (Hz); registers; overrun; the byte read last. fed, taken: bytes of the peer, and how many of them have arrived, the next of
them at `due` (ns); waiting in `fifo` from `first` on; `last`: time of the last arrival or read. written: bytes by the firmware, of
which the last leaves the transmitter at `left`; armed: the interrupt of an empty transmitter is still to come."""


@hot
def compute_character_ns(state):
    """Return the time, ns, of a character on the UART's line; 0 while no divisor is set."""
    halves = 2 * (6 + (state.lcr & 3) + (state.lcr >> 3 & 1)) + (
        2 if state.lcr & 4 == 0 else 3 if state.lcr & 3 == 0 else 4
    )
    return halves * 8 * state.divisor * SECOND // state.clock


@hot
def count_unsent(state, now):
    """Return the number of bytes in the transmitter of the UART, including the byte on the line."""
    c = compute_character_ns(state)
    return (state.left - now + c - 1) // c if state.left > now and c else 0


@hot
def _count_arrived(state, now):
    """Return the number of bytes that have arrived at the UART by `now` (ns) and are not in its FIFO yet."""
    c = compute_character_ns(state)
    return (
        least(state.fed - state.taken, (now - state.due) // c + 1)
        if state.fed > state.taken and now >= state.due and c
        else 0
    )


@hot
def _receive_arrived_bytes(state, now):
    """Put the bytes that have arrived at the UART into its receiver FIFO."""
    c, register = compute_character_ns(state), _count_arrived(state, now)
    room = FIFO if state.fcr & 1 else 1
    for _ in range(register):
        byte = state.incoming[state.taken % ROOM]
        if state.waiting < room:
            state.fifo[(state.first + state.waiting) % FIFO] = byte
            state.waiting += 1
        else:
            state.oe = 1
            if room == 1:
                state.fifo[state.first] = byte
        state.taken += 1
        state.last = state.due
        state.due += c


@hot
def _identify_interrupt(state, now):
    """Return IIR of the UART without its FIFO bits: the pending interrupt of the highest priority, or 1 for none."""
    register, room, c = _count_arrived(state, now), FIFO if state.fcr & 1 else 1, compute_character_ns(state)
    level = state.waiting + register
    if state.ier & 4 and (state.oe or level > room):
        return 6
    if state.ier & 1 and level:
        code = state.fcr >> 6 & 3
        if state.fcr & 1 == 0 or level >= (14 if code == 3 else 1 if code == 0 else 4 * code):
            return 4
        last = state.due + (register - 1) * c if register else state.last
        if now - last >= 4 * c:
            return 12
    return 2 if state.ier & 2 and state.armed and count_unsent(state, now) <= 1 else 1


@exported("i8", STATE, "i8", "i8")
def pulls(state, now, counts):
    """Return whether the UART asserts INTR: an interrupt is pending, and OUT2 enables the driver of the line."""
    return 1 if state.mcr & 8 and _identify_interrupt(state, now) != 1 else 0


@hot
def _put_into_transmitter(state, now, value):
    """Put a byte into the transmitter of the UART, or return it to the receiver in loop mode."""
    unsent, room = count_unsent(state, now), FIFO + 1 if state.fcr & 1 else 2
    if state.divisor == 0:  # no clock on the line
        return
    if unsent >= room:  # no room: lost; without a FIFO the last byte is
        if room == 2:
            state.sent[(state.written - 1) % SENT_BUFFER_SIZE] = value
        return
    state.armed = 1
    state.left = (state.left if unsent else now) + compute_character_ns(state)
    if state.mcr & 16:  # loop
        if state.fed - state.taken < ROOM:
            if state.fed == state.taken:
                state.due = state.left
            state.incoming[state.fed % ROOM] = value
            state.fed += 1
    else:
        state.sent[state.written % SENT_BUFFER_SIZE] = value
        state.written += 1


@hot
def _set_divisor(state, now, divisor):
    """Set the speed of the UART's line by its divisor. Bytes that have not arrived yet arrive at the new speed."""
    state.divisor = divisor
    if state.fed > state.taken:
        state.due = now + compute_character_ns(state)


@hot
def _write_register(state, now, register, value):
    """Write a register of the UART. If bit 7 of LCR is set, the first two registers are the divisor."""
    if register < 2 and state.lcr & 0x80:
        _set_divisor(state, now, state.divisor & 0xFF00 | value if register == 0 else state.divisor & 0xFF | value << 8)
    elif register == 0:
        _put_into_transmitter(state, now, value)
    elif register == 1:
        if value & 2 and state.ier & 2 == 0:
            state.armed = 1
        state.ier = value & 15
    elif register == 2:
        _control_fifos(state, now, value)
    elif register == 3:
        state.lcr = value
    elif register == 4:
        state.mcr = value & 31
    elif register == 7:
        state.scr = value


@hot
def _control_fifos(state, now, value):
    """Write FCR of the UART, which enables and clears its FIFOs."""
    if value & 2 or (value ^ state.fcr) & 1:
        state.waiting = 0
    if value & 4 and count_unsent(state, now) > 1:
        state.written -= count_unsent(state, now) - 1
        state.left = now + compute_character_ns(state)
    state.fcr = value & 0xC9 if value & 1 else 0


@hot
def _take_received_byte(state, now):
    """Return the UART's next received byte (RBR) and remove it from the receiver FIFO."""
    if state.waiting:
        state.rbr = state.fifo[state.first]
        state.first = (state.first + 1) % FIFO
        state.waiting -= 1
        state.last = now
    return state.rbr


@hot
def _read_line_status(state, now):
    """Return LSR, the line status of the UART; the read clears the overrun bit."""
    unsent, overrun = count_unsent(state, now), state.oe
    state.oe = 0
    return (1 if state.waiting else 0) | overrun << 1 | (0x20 if unsent <= 1 else 0) | (0x40 if unsent == 0 else 0)


@hot
def _read_modem_status(state):
    """Return MSR of the UART: in loop mode its modem control register, else that the peer is present and ready."""
    return (state.mcr & 2) << 3 | (state.mcr & 1) << 5 | (state.mcr & 12) << 4 if state.mcr & 16 else 0xB0


@hot
def _read_interrupt_identification(state, now):
    """Return IIR of the UART; the read ends the interrupt of an empty transmitter."""
    code = _identify_interrupt(state, now)
    if code == 2:
        state.armed = 0
    return code | (0xC0 if state.fcr & 1 else 0)


@exported("i8", STATE, "i8", "i8", "i8", "i8", "i8")
def access(state, now, counts, register, kind, value):
    """Execute a bus cycle at one of the eight registers of the 16550 UART."""
    _receive_arrived_bytes(state, now)
    if kind & 1:
        _write_register(state, now, register, value)
        return 0
    if register < 2 and state.lcr & 0x80:
        return state.divisor >> 8 * register & 0xFF
    if register == 0:
        return _take_received_byte(state, now)
    if register == 2:
        return _read_interrupt_identification(state, now)
    if register == 5:
        return _read_line_status(state, now)
    if register == 6:
        return _read_modem_status(state)
    return state.ier if register == 1 else state.lcr if register == 3 else state.mcr if register == 4 else state.scr
