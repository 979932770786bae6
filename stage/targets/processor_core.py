"""What emulated processors have in common, compiled: the clock, bus cycles, and on Unicorn the interrupt line, ports and windows.

A processor counts its clock cycles. Before each of its bus cycles the time of the board advances to that of the processor, and at
the latest after a quantum, when the interrupt line is read. Where the board's bus cycle is longer, the processor waits (READY).

Unicorn does not know how long an instruction takes. Here each takes a number of cycles, and some for each of its bytes: an
approximation, which is stated for each processor.
"""

from __future__ import annotations

from stage.board.bus.host_record import HOST, IN8, IN16, IN32, OUT8, OUT16, OUT32, UNTIL, now_of
from stage.native import array_at, called, exported, greatest, hot, least, record
from stage.sim.handle import INTEGER

PROCESSOR_FIELDS = [(name, "i8") for name in "host request hz begin waits watched line ended code".split()]
"""Fields that the record of every processor begins with:
    host, request    the HOST record, and the function for its requests
    hz, begin, waits the clock; the board's time (ns) at cycle 0; ns that the processor stood still for the bus
    watched, line    whether the interrupt line leads to the processor; its level at the last tick (of an AVR), or whether it may
                     interrupt (of others)
    ended, code      the program has ended, with this code
"""
SECOND = 1_000_000_000
_request = called("i8", "i8", "i4", "i8", "i8")

MACHINE = record(
    PROCESSOR_FIELDS
    + [(name, "i8") for name in "own uc stop reg_read flags flags_at mask on".split()]
    + [(name, "i8") for name in "cycles each byte quantum due alarm edge raised device_waits before".split()]
    + [(name, "i8") for name in "windows n_windows outside internal_port n_internal_ports".split()]
)
"""own, uc               its own address; Unicorn's handle
    stop, reg_read        addresses of uc_emu_stop, uc_reg_read
    flags, flags_at       the register that says whether interrupts come, and where it is read to
    mask, on              they do if its bits `mask` are `on`
    cycles, each, byte    cycles so far; of each instruction, and of each of its bytes
    quantum, due, alarm   cycles between two polls of the line; when the next is; when Python is to be called
    edge, before, raised  whether an edge of the line counts, not its level; the level before; it has been asserted
    device_waits             an interrupt of the processor's own devices waits
    windows, n_windows    WINDOWs of the board
    outside               an address that no window has, plus one
    internal_port, n_internal_ports the function for ports below that number: (t, port, size, value or -1) -> value
"""
WINDOW = record([(name, "i8") for name in "address port length".split()])
PAGE = record([("machine", "i8"), ("address", "i8")])
"""A page of memory that holds windows, at this address."""
_stop, _reg_read = called("i4", "i8"), called("i4", "i8", "i4", "i8")
_internal_port = called("i8", "i8", "i8", "i8", "i8")


@hot
def _has_interrupts_on(t):
    _reg_read(t.reg_read, (t.uc, t.flags, t.flags_at))
    return array_at(t.flags_at, 1, INTEGER)[0] & t.mask == t.on


@hot
def poll(t):
    """Advance the board to the processor's time, and read the interrupt line; return 1 where Python has to do something."""
    line = reach(t, t.cycles)
    if line and not (t.edge and t.before):
        t.raised = 1
    elif not t.edge:
        t.raised = 0
    t.before = line
    t.due = least(t.cycles + t.quantum, t.alarm)
    if t.cycles >= t.alarm:
        t.due = t.cycles + t.quantum
        return 1
    return 1 if ((t.raised and t.line) or t.device_waits) and _has_interrupts_on(t) else 0


@exported("i8", MACHINE)
def poll_from_python(t):
    """Poll as compiled code does."""
    return poll(t)


@exported(None, MACHINE)
def wait(t):
    """Let time pass without instructions, until Python has something to do."""
    while not poll(t):
        t.cycles = t.due


@exported(None, "i8", "i8", "i4", MACHINE)
def instruction(_uc, _address, size, t):
    """Count an instruction before it is run, and stop Unicorn where Python has to do something."""
    t.cycles += t.each + t.byte * size
    if t.cycles >= t.due and poll(t):
        _stop(t.stop, (t.uc,))


@hot
def _in(t, size, port):
    what = IN8 if size == 1 else IN16 if size == 2 else IN32
    return bus_cycle(t, t.cycles, what, port, 0)


@hot
def _out(t, size, port, value):
    what = OUT8 if size == 1 else OUT16 if size == 2 else OUT32
    bus_cycle(t, t.cycles, what, port, value)


@exported("i4", "i8", "i4", "i4", MACHINE)
def port_in(_uc, port, size, t):
    """Execute IN."""
    if port < t.n_internal_ports:
        return _internal_port(t.internal_port, (t.own, port, size, -1))
    value = _in(t, size, port)
    t.due = t.cycles  # the line may have changed
    return value


@exported(None, "i8", "i4", "i4", "i4", MACHINE)
def port_out(_uc, port, size, value, t):
    """Execute OUT."""
    if port < t.n_internal_ports:
        _internal_port(t.internal_port, (t.own, port, size, value & (0xFF if size == 1 else 0xFFFF)))
        return
    _out(t, size, port, value & 0xFFFFFFFF)
    t.due = t.cycles


@hot
def _find_port(t, address, size):
    """Return the port that an address of a window is, or stop Unicorn and return -1."""
    windows = array_at(t.windows, t.n_windows, WINDOW)
    for k in range(t.n_windows):
        n = address - windows[k].address
        if n >= 0 and n + size <= windows[k].length:
            return windows[k].port + n
    t.outside = address + 1
    _stop(t.stop, (t.uc,))
    return -1


@exported("i8", "i8", "i8", "i4", PAGE)
def window_read(_uc, offset, size, p):
    """Load from memory that holds windows."""
    t = array_at(p.machine, 1, MACHINE)[0]
    port = _find_port(t, p.address + offset, size)
    if port < 0:
        return 0
    value = _in(t, size, port)
    t.due = t.cycles
    return value


@exported(None, "i8", "i8", "i4", "i8", PAGE)
def window_written(_uc, offset, size, value, p):
    """Store to memory that holds windows."""
    t = array_at(p.machine, 1, MACHINE)[0]
    port = _find_port(t, p.address + offset, size)
    if port >= 0:
        _out(t, size, port, value & 0xFFFFFFFF)
        t.due = t.cycles


@hot
def request(t, what, a, b):
    """Make a request of the board."""
    return _request(t.request, (t.host, what, a, b))


@hot
def time_of(t, cycles):
    """Return the board's time (ns) at which the processor has run so many cycles."""
    return t.begin + t.waits + cycles // t.hz * SECOND + cycles % t.hz * SECOND // t.hz


@hot
def reach(t, cycles):
    """Advance the board to the processor's time; return 1 if the interrupt line then is asserted and leads here."""
    return request(t, UNTIL, time_of(t, cycles), t.watched)


@hot
def bus_cycle(t, cycles, what, port, value):
    """Make a bus cycle that ends when the processor has run so many cycles."""
    h = array_at(t.host, 1, HOST)[0]
    end = time_of(t, cycles)
    request(t, UNTIL, end - h.bus, 0)
    answer = request(t, what, port, value)
    t.waits += greatest(now_of(h) - end, 0)
    return answer
