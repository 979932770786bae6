"""16550 UART, compiled: registers, FIFOs of 16, and the line in simulated time.

Bytes that a peer has sent wait in `incoming` and arrive one behind the other, a character's time each. What the firmware has
written leaves likewise: when the last of it will have left says how many are still here.
"""

from __future__ import annotations

from stage.native import exported, hot, least, record

FIFO, ROOM = 16, 4096
SENT_ROOM = (
    ROOM + 2 * FIFO
)  # of what was sent: FIFO + 1 bytes in the transmitter may be written, cleared and written over
NEVER = 1 << 62
SECOND = 1_000_000_000
STATE = record(
    [
        (name, "i8")
        for name in "clock ier fcr lcr mcr scr divisor oe rbr fed taken due waiting first last written left armed".split()
    ]
    + [("fifo", "u1", (FIFO,)), ("incoming", "u1", (ROOM,)), ("sent", "u1", (SENT_ROOM,))]
)
"""clock (Hz); registers; overrun; the byte read last. fed, taken: bytes of the peer, and how many of them have arrived, the next of
them at `due` (ns); waiting in `fifo` from `first` on; `last`: time of the last arrival or read. written: bytes by the firmware, of
which the last leaves the transmitter at `left`; armed: the interrupt of an empty transmitter is still to come."""


@hot
def character(s):
    """Return the time of a character on the line, ns; 0 without a divisor."""
    halves = 2 * (6 + (s.lcr & 3) + (s.lcr >> 3 & 1)) + (2 if s.lcr & 4 == 0 else 3 if s.lcr & 3 == 0 else 4)
    return halves * 8 * s.divisor * SECOND // s.clock


@hot
def unsent(s, now):
    """Count the bytes in the transmitter, with the one on the line."""
    c = character(s)
    return (s.left - now + c - 1) // c if s.left > now and c else 0


@hot
def _arrived(s, now):
    """Count the bytes that have arrived by now and are not in the FIFO yet."""
    c = character(s)
    return least(s.fed - s.taken, (now - s.due) // c + 1) if s.fed > s.taken and now >= s.due and c else 0


@hot
def _update(s, now):
    """Put the bytes that have arrived into the FIFO."""
    c, n = character(s), _arrived(s, now)
    room = FIFO if s.fcr & 1 else 1
    for _ in range(n):
        byte = s.incoming[s.taken % ROOM]
        if s.waiting < room:
            s.fifo[(s.first + s.waiting) % FIFO] = byte
            s.waiting += 1
        else:
            s.oe = 1
            if room == 1:
                s.fifo[s.first] = byte
        s.taken += 1
        s.last = s.due
        s.due += c


@hot
def _identify(s, now):
    """Return IIR without the bits of the FIFO: the interrupt of the highest priority; 1: none."""
    n, room, c = _arrived(s, now), FIFO if s.fcr & 1 else 1, character(s)
    level = s.waiting + n
    if s.ier & 4 and (s.oe or level > room):
        return 6
    if s.ier & 1 and level:
        code = s.fcr >> 6 & 3
        if s.fcr & 1 == 0 or level >= (14 if code == 3 else 1 if code == 0 else 4 * code):
            return 4
        last = s.due + (n - 1) * c if n else s.last
        if now - last >= 4 * c:
            return 12
    return 2 if s.ier & 2 and s.armed and unsent(s, now) <= 1 else 1


@exported("i8", STATE, "i8", "i8")
def pulls(s, now, counts):
    """Return the output INTR, behind the driver that OUT2 enables."""
    return 1 if s.mcr & 8 and _identify(s, now) != 1 else 0


@hot
def _transmit(s, now, value):
    n, room = unsent(s, now), FIFO + 1 if s.fcr & 1 else 2
    if s.divisor == 0:  # no clock on the line
        return
    if n >= room:  # no room: lost; without a FIFO the last byte is
        if room == 2:
            s.sent[(s.written - 1) % SENT_ROOM] = value
        return
    s.armed = 1
    s.left = (s.left if n else now) + character(s)
    if s.mcr & 16:  # loop
        if s.fed - s.taken < ROOM:
            if s.fed == s.taken:
                s.due = s.left
            s.incoming[s.fed % ROOM] = value
            s.fed += 1
    else:
        s.sent[s.written % SENT_ROOM] = value
        s.written += 1


@hot
def _divide(s, now, divisor):
    """Change the speed, at which all that is still to arrive does so from now on."""
    s.divisor = divisor
    if s.fed > s.taken:
        s.due = now + character(s)


@hot
def _write(s, now, n, value):
    """Write register `n`; with bit 7 of LCR the first two are the divisor."""
    if n < 2 and s.lcr & 0x80:
        _divide(s, now, s.divisor & 0xFF00 | value if n == 0 else s.divisor & 0xFF | value << 8)
    elif n == 0:
        _transmit(s, now, value)
    elif n == 1:
        if value & 2 and s.ier & 2 == 0:
            s.armed = 1
        s.ier = value & 15
    elif n == 2:
        _control_fifos(s, now, value)
    elif n == 3:
        s.lcr = value
    elif n == 4:
        s.mcr = value & 31
    elif n == 7:
        s.scr = value


@hot
def _control_fifos(s, now, value):
    if value & 2 or (value ^ s.fcr) & 1:
        s.waiting = 0
    if value & 4 and unsent(s, now) > 1:
        s.written -= unsent(s, now) - 1
        s.left = now + character(s)
    s.fcr = value & 0xC9 if value & 1 else 0


@hot
def _receive(s, now):
    if s.waiting:
        s.rbr = s.fifo[s.first]
        s.first = (s.first + 1) % FIFO
        s.waiting -= 1
        s.last = now
    return s.rbr


@hot
def _line_status(s, now):
    n, oe = unsent(s, now), s.oe
    s.oe = 0
    return (1 if s.waiting else 0) | oe << 1 | (0x20 if n <= 1 else 0) | (0x40 if n == 0 else 0)


@hot
def _modem_status(s):
    """Return MSR: in the loop from the modem control register; else the peer is there and ready."""
    return (s.mcr & 2) << 3 | (s.mcr & 1) << 5 | (s.mcr & 12) << 4 if s.mcr & 16 else 0xB0


@hot
def _acknowledge(s, now):
    """Read IIR, which ends the interrupt of an empty transmitter."""
    code = _identify(s, now)
    if code == 2:
        s.armed = 0
    return code | (0xC0 if s.fcr & 1 else 0)


@exported("i8", STATE, "i8", "i8", "i8", "i8", "i8")
def access(s, now, counts, n, kind, value):
    """Make a cycle at register `n`."""
    _update(s, now)
    if kind & 1:
        _write(s, now, n, value)
        return 0
    if n < 2 and s.lcr & 0x80:
        return s.divisor >> 8 * n & 0xFF
    if n == 0:
        return _receive(s, now)
    if n == 2:
        return _acknowledge(s, now)
    if n == 5:
        return _line_status(s, now)
    if n == 6:
        return _modem_status(s)
    return s.ier if n == 1 else s.lcr if n == 3 else s.mcr if n == 4 else s.scr
