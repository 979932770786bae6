"""One bus cycle of a host, compiled: time passes, the chip is written or read, the trace notes it, the interrupt line is checked.

A host, in C or in Python, makes all its requests by one function, `request(host, what, a, b)`, which C calls through a pointer.
`host` is the address of a HOST record, see host_record.py.
"""

from __future__ import annotations

from stage.board.bus import host_record, interrupts, waiting
from stage.board.bus.host_record import DEVICE, EIGHT, IN8, IN16, LAST_PORT, OUT, OUT16, STRAY, trace_cycle
from stage.chips import cores
from stage.chips.entries import LOST, READ, WRITE
from stage.native import array_at, exported, float_mode_as_before, frame_address, greatest, hot, least, usual_float_mode
from stage.sim.handle import INTEGER


@hot
def _is_lost(h, chip, address, value):
    """Return 1 if a fault of the bus keeps a write from its chip."""
    if h.checked_chips >> chip & 1 == 0:
        return 0
    waiting.catch_up(h)
    h.call_chip, h.call_address, h.call_value = chip, address, value
    host_record.call_python(h, host_record.CHECK_WRITE)
    h.quiet = 0
    return h.call_value


@hot
def _write(h, chip, address, value, kind, port, data):
    """Make a write cycle. address, value: as the chip gets them; kind, port, data: as the trace shows it."""
    lost = _is_lost(h, chip, address, value)
    waiting.pass_bus_cycle(h)
    if not h.stopped:
        waiting.advance_chip(h, chip)
        if not lost:
            cores.write(host_record.chip_of(h, chip), address, value)
        if h.journals:
            host_record.journal_cycle(h, LOST if lost else WRITE, chip, address, value)
    trace_cycle(h, kind | lost * host_record.WRITE_LOST, port, data, -1)


@hot
def _read(h, chip, address):
    """Read a chip, whose time is the host's then."""
    if h.stopped:
        return 0xFFFF
    waiting.advance_chip(h, chip)
    value = cores.read(host_record.chip_of(h, chip), address)
    if h.journals and array_at(h.acts, h.n_chips, INTEGER)[chip] >> address & 1:
        host_record.journal_cycle(h, READ, chip, address, value)
    return value


@hot
def _port(h, port):
    """Find the PORT record of a port."""
    regions, at = array_at(h.regions, h.n_regions, host_record.REGION), 0
    for k in range(h.n_regions):
        n = port - regions[k].first
        if 0 <= n < regions[k].n:
            at = regions[k].at + n
            break
    return array_at(h.ports, h.n_ports, host_record.PORT)[at]


@hot
def _latches(h):
    """The address that each chip's latch holds: part of the stage's state."""
    return array_at(h.latches, h.n_chips, INTEGER)


@hot
def _access_device(h, p, kind, value):
    """Make a cycle at a device."""
    if host_record.device_of(h, p.chip).access == 0:
        waiting.catch_up(h)
    return host_record.reach_device(h, p.chip, p.address, kind, value)


@hot
def _in8(h, port):
    waiting.pass_bus_cycle(h)
    p, value = _port(h, port), 0xFF
    kind = p.kind
    if kind in (host_record.NOTHING, host_record.LATCH):
        trace_cycle(h, host_record.IN | STRAY, port, value, h.traced - 1)
    else:
        if kind == host_record.LATCHED:
            value = _read(h, p.chip, _latches(h)[p.chip])
        elif kind == host_record.PULLS:
            value = waiting.find_pulling(h) & (1 << least(h.n_chips, 8)) - 1
        elif kind == DEVICE:
            value = (
                _access_device(h, p, IN8 if p.mask == EIGHT else IN16, 0) >> (8 if p.mask == host_record.UPPER else 0)
                & 0xFF
            )
        elif kind == host_record.HALF:
            value = _read(h, p.chip, p.address) >> 8
        else:
            value = _read(h, p.chip, p.address) & 0xFF
        p.read_line = trace_cycle(h, host_record.IN, port, value, p.read_line - 1) + 1
    waiting.call_hooks(h)
    return value


@hot
def _out8(h, port, value):
    """Make a write cycle of 8 bits. The other half of a bus of 16 bits floats."""
    p = _port(h, port)
    kind = p.kind
    if kind == host_record.WORD:
        _write(h, p.chip, p.address, value | 0xFF00, OUT | STRAY, port, value)
    elif kind == host_record.HALF:
        _write(h, p.chip, p.address, value << 8 | 0xFF, OUT | STRAY, port, value)
    elif kind in (host_record.BYTE, host_record.LATCHED):
        _write(h, p.chip, _latches(h)[p.chip] if kind == host_record.LATCHED else p.address, value, OUT, port, value)
    else:
        waiting.pass_bus_cycle(h)
        if kind == host_record.LATCH:
            _latches(h)[p.chip] = value & p.mask
        elif kind == DEVICE and p.mask == EIGHT:
            _access_device(h, p, host_record.OUT8, value)
        elif kind == DEVICE:
            _access_device(h, p, OUT16, value << 8 | 0xFF if p.mask == host_record.UPPER else value | 0xFF00)
        whole = kind == host_record.LATCH or (kind == DEVICE and p.mask == EIGHT)
        trace_cycle(h, OUT if whole else OUT | STRAY, port, value, -1)
    waiting.call_hooks(h)


@hot
def _is_wide(p):
    """Tell whether a cycle of 16 bits is one here; the bus makes two of any other."""
    return p.kind in (host_record.NOTHING, host_record.WORD) or (p.kind == DEVICE and p.mask == host_record.WIDE)


@hot
def _in16(h, port):
    p = _port(h, port)
    if not _is_wide(p):
        low = _in8(h, port)
        return _in8(h, port + 1 & LAST_PORT) << 8 | low
    waiting.pass_bus_cycle(h)
    value = 0xFFFF
    if p.kind == host_record.NOTHING:
        trace_cycle(h, host_record.IN_WIDE | STRAY, port, value, h.traced - 1)
    else:
        value = _access_device(h, p, IN16, 0) & 0xFFFF if p.kind == DEVICE else _read(h, p.chip, p.address)
        p.read_line = trace_cycle(h, host_record.IN_WIDE, port, value, p.read_line - 1) + 1
    waiting.call_hooks(h)
    return value


@hot
def _out16(h, port, value):
    p = _port(h, port)
    if not _is_wide(p):
        _out8(h, port, value & 0xFF)
        _out8(h, port + 1 & LAST_PORT, value >> 8)
        return
    if p.kind == host_record.WORD:
        _write(h, p.chip, p.address, value, host_record.OUT_WIDE, port, value)
    else:
        waiting.pass_bus_cycle(h)
        if p.kind == DEVICE:
            _access_device(h, p, OUT16, value)
        trace_cycle(h, host_record.OUT_WIDE if p.kind == DEVICE else host_record.OUT_WIDE | STRAY, port, value, -1)
    waiting.call_hooks(h)


@hot
def _pass_poll(h):
    """Let the bus cycle of a poll of a timer or a line pass, so that firmware that waits for either gets on."""
    waiting.pass_bus_cycle(h)
    waiting.call_hooks(h)


@hot
def _refuse(h, what, a, b):
    h.call_chip, h.call_address, h.call_value = what, a, b
    host_record.call_python(h, host_record.REFUSED)


@hot
def _set_line_hook(h, hook, argument):
    """Set the hook of all lines as one."""
    waiting.catch_up(h)
    s = interrupts.sources_of(h)[interrupts.ANY_LINE]
    s.level, s.hook, s.argument, s.lines = 1, hook, argument, -1
    interrupts.arm(h)
    h.quiet = 0
    waiting.call_hooks(h)


@hot
def _set_source(h, what, settings):
    """Set the hook of a timer, a line or a software interrupt. settings: see TIMER."""
    number, level, source, lines = settings[0], settings[1], -1, 0
    if what == host_record.TIMER:
        if 0 <= number < interrupts.TIMERS and 0 <= settings[2] < host_record.MAX_DELAY_US * 1000:
            source = interrupts.FIRST_TIMER + number
    elif 0 <= number < h.n_chips + h.n_devices:
        source, lines = interrupts.FIRST_LINE + number, 1 << number
    elif 0 <= number - interrupts.SOFTWARE_LINE < interrupts.SOFTWARE:
        source = interrupts.FIRST_SOFTWARE + number - interrupts.SOFTWARE_LINE
    is_on = settings[3] != 0 and (what != host_record.TIMER or settings[2] != 0)
    if source < 0:
        _refuse(h, what, number, settings[2])
    elif is_on and not 1 <= level <= interrupts.HIGHEST:
        _refuse(h, what | host_record.WRONG_LEVEL, number, level)
    else:
        waiting.set_source(h, source, lines, settings, is_on)


@hot
def _set_level(h, level):
    before = h.level
    if level > interrupts.HIGHEST:
        _refuse(h, host_record.LEVEL, level, 0)
    elif level >= 0:
        interrupts.set_level(h, level)
    waiting.call_hooks(h)
    return before


@hot
def _raise(h, number):
    """Set the flag of a software interrupt."""
    if not 0 <= number < interrupts.SOFTWARE:
        _refuse(h, host_record.RAISE, number, 0)
        return
    interrupts.sources_of(h)[interrupts.FIRST_SOFTWARE + number].pending = 1
    interrupts.arm(h)
    waiting.call_hooks(h)


@hot
def _check_stack(h):
    """Call Python about a request that comes from another stack than that of the firmware's own thread."""
    position = frame_address()
    if position < h.stack_low or position > h.stack_high:
        h.stack_checks -= 1
        waiting.catch_up(h)
        host_record.call_python(h, host_record.ANOTHER_STACK)


@hot
def _access_ports(h, what, port, value):
    """Make the bus cycles of a request."""
    if what == IN8:
        return _in8(h, port)
    if what == IN16:
        return _in16(h, port)
    if what == host_record.IN32:
        low = _in16(h, port)
        return _in16(h, port + 2 & LAST_PORT) << 16 | low
    if what == host_record.OUT8:
        _out8(h, port, value & 0xFF)
    else:
        _out16(h, port, value & 0xFFFF)
        if what == host_record.OUT32:
            _out16(h, port + 2 & LAST_PORT, value >> 16 & 0xFFFF)
    return 0


@hot
def _control_interrupts(h, what, a, b):
    """Carry out a request to the interrupt controller; return the level before."""
    if what == host_record.HOOK:
        _set_line_hook(h, a, b)
    elif what in (host_record.TIMER, host_record.ON_LINE):
        _set_source(h, what, array_at(a, 5, INTEGER))
    elif what == host_record.LEVEL:
        return _set_level(h, a)
    elif what == host_record.RAISE:
        _raise(h, a)
    return 0


@hot
def _control_time(h, what, a, b):
    """Let time pass, or answer what it is."""
    if what == host_record.DELAY:
        waiting.wait(h, least(greatest(a, 0), host_record.MAX_DELAY_US) * 1000)
    elif what == host_record.SPEND:
        waiting.wait(h, least(greatest(a, 0), host_record.MAX_DELAY_US * 1000))
    elif what == host_record.MICROS:
        _pass_poll(h)
        return host_record.now_of(h) // 1000
    elif what == host_record.LINE:
        _pass_poll(h)
        return 1 if waiting.find_pulling(h) else 0
    elif what == host_record.UNTIL:
        waiting.advance_host(h, a)
        return 1 if b and waiting.find_pulling(h) else 0
    elif what == host_record.SETTLE:
        waiting.catch_up(h)
        interrupts.arm(h)
        h.quiet = 0
    return 0


@hot
def execute(h, what, a, b):
    """Execute one host request and return its result, or 0.

    Args:
        h: The HOST record.
        what: IN8, host_record.OUT8, ...
        a: First operand of the request.
        b: Second operand.
    """
    if h.stack_checks:
        _check_stack(h)
    if h.collided:
        h.collided = 0
        host_record.call_python(h, host_record.COLLIDED)
    if h.stopped:
        host_record.call_python(h, host_record.PAUSE)
        return -1
    if h.meter:
        waiting.spend_computing(h)
    if what <= OUT16 or what in (host_record.IN32, host_record.OUT32):
        return _access_ports(h, what, a & LAST_PORT, b)
    if host_record.WINDOW <= what <= host_record.BEYOND_WINDOW:
        waiting.catch_up(h)
        h.call_chip, h.call_value, h.call_address = what, a, b
        host_record.call_python(h, host_record.WINDOW_REQUEST)
        return h.call_value
    if what == host_record.LOG:
        waiting.catch_up(h)
        h.call_value = a
        host_record.call_python(h, host_record.LINE_OF_LOG)
        return 0
    if what in (host_record.HOOK, host_record.TIMER, host_record.ON_LINE, host_record.LEVEL, host_record.RAISE):
        return _control_interrupts(h, what, a, b)
    return _control_time(h, what, a, b)


@exported("i8", host_record.HOST, "i4", "i8", "i8")
def request(h, what, a, b):
    """Execute a request of a host.

    In C: int64_t request(void *host, int32_t what, int64_t a, int64_t b).
    """
    if (h.in_python and what < host_record.FROM_PYTHON) or not host_record.enter(h):
        if what < host_record.FROM_PYTHON:
            h.collided = 1
        return host_record.BUS_BUSY
    if h.serving:
        interrupts.close_left(h, frame_address())
    mode = usual_float_mode()  # whatever the firmware has made of it, the stage has the same bits
    value = execute(h, what & (host_record.FROM_PYTHON - 1), a, b)
    float_mode_as_before(mode)
    host_record.leave(h)
    return value


@exported("i8", host_record.HOST)
def pulling_mask(h):
    """Return the chips and devices that pull the interrupt line, a bit each, without a bus cycle."""
    return waiting.find_pulling(h)


@exported(None, host_record.HOST)
def rearm(h):
    """Take over a changed table of interrupt sources."""
    interrupts.arm(h)


@exported("i8")
def stack_position():
    """Return about where the caller's stack is."""
    return frame_address()


@exported("i8")
def set_usual_float_mode():
    """Let this thread compute in the usual mode; return the mode before."""
    return usual_float_mode()


@exported(None, "i8")
def restore_float_mode(mode):
    """Let this thread compute in an earlier mode again."""
    float_mode_as_before(mode)


REQUEST = request.prototype
