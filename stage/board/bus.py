"""One bus cycle of a host, compiled: time passes, the chip is written or read, the trace notes it, the interrupt line is checked.

A host, in C or in Python, makes all its requests by one function, `request(host, what, a, b)`, which C calls through a pointer.
`host` is the address of a HOST record, see host.py.
"""

from __future__ import annotations

from stage.board import host, interrupts, waiting
from stage.chips import cores
from stage.chips.entries import LOST, READ, WRITE
from stage.native import array_at, exported, float_mode_as_before, frame_address, greatest, hot, least, usual_float_mode
from stage.sim.handle import WHOLE


@hot
def _lost(h, chip, address, value):
    """1 if a fault of the bus keeps this write from its chip."""
    if h.asks >> chip & 1 == 0:
        return 0
    waiting.catch_up(h)
    h.asked_chip, h.asked_address, h.asked = chip, address, value
    host.ask(h, host.ASKED_WRITE)
    h.quiet = 0
    return h.asked


@hot
def _write(h, lost, chip, address, value):
    """A write cycle reaches a chip, or does not."""
    if h.stopped:
        return
    waiting.turn_to(h, chip)
    if not lost:
        cores.write(host.chip_of(h, chip), address, value)
    if h.journals:
        host.journal(h, LOST if lost else WRITE, chip, address, value)


@hot
def _read(h, chip, address):
    """A read cycle reaches a chip."""
    if h.stopped:
        return 0xFFFF
    waiting.turn_to(h, chip)
    value = cores.read(host.chip_of(h, chip), address)
    if h.journals and array_at(h.acts, h.n_chips, WHOLE)[chip] >> address & 1:
        host.journal(h, READ, chip, address, value)
    return value


@hot
def _place(h, port):
    """Where a port is in the table."""
    regions = array_at(h.regions, h.n_regions, host.REGION)
    for k in range(h.n_regions):
        n = port - regions[k].first
        if 0 <= n < regions[k].n:
            return regions[k].at + n
    return 0


@hot
def _latches(h):
    """The address that each chip's latch holds: part of the stage's state."""
    return array_at(h.latches, h.n_chips, WHOLE)


@hot
def _device(h, p, way, value):
    """A cycle reaches a device."""
    if host.device_of(h, p.chip).access == 0:
        waiting.catch_up(h)
    return host.at_device(h, p.chip, p.address, way, value)


@hot
def _in8(h, port):
    waiting.cycle(h)
    ports, value = array_at(h.ports, h.n_ports, host.PORT), 0xFF
    p = ports[_place(h, port)]
    kind = p.kind
    if kind in (host.NOTHING, host.LATCH):
        host.note(h, host.IN | host.STRAY, port, value, h.traced - 1)
    else:
        if kind == host.LATCHED:
            value = _read(h, p.chip, _latches(h)[p.chip])
        elif kind == host.PULLS:
            value = waiting.line_of(h) & (1 << least(h.n_chips, 8)) - 1
        elif kind == host.DEVICE:
            value = (
                _device(h, p, host.IN8 if p.mask == host.EIGHT else host.IN16, 0) >> (8 if p.mask == host.UPPER else 0)
                & 0xFF
            )
        elif kind == host.HALF:
            value = _read(h, p.chip, p.address) >> 8
        else:
            value = _read(h, p.chip, p.address) & 0xFF
        p.seen = host.note(h, host.IN, port, value, p.seen - 1) + 1
    waiting.serve(h)
    return value


@hot
def _out8(h, port, value):
    ports = array_at(h.ports, h.n_ports, host.PORT)
    p = ports[_place(h, port)]
    kind = p.kind
    if kind in (host.NOTHING, host.LATCH, host.PULLS):
        waiting.cycle(h)
        if kind == host.LATCH:
            _latches(h)[p.chip] = value & p.mask
        host.note(h, host.OUT if kind == host.LATCH else host.OUT | host.STRAY, port, value, -1)
    elif kind == host.DEVICE:
        waiting.cycle(h)
        word = value << 8 | 0xFF if p.mask == host.UPPER else value | 0xFF00  # the other half of the bus floats
        _device(h, p, host.OUT8 if p.mask == host.EIGHT else host.OUT16, value if p.mask == host.EIGHT else word)
        host.note(h, host.OUT | (0 if p.mask == host.EIGHT else host.STRAY), port, value, -1)
    else:
        address, word = p.address, value
        if kind == host.LATCHED:
            address = _latches(h)[p.chip]
        elif kind == host.WORD:  # the other half of the bus floats
            word = value | 0xFF00
        elif kind == host.HALF:
            word = value << 8 | 0xFF
        lost = _lost(h, p.chip, address, word)
        waiting.cycle(h)
        _write(h, lost, p.chip, address, word)
        host.note(
            h,
            host.OUT | lost * host.LOST_ON_THE_WAY | (host.STRAY if kind in (host.WORD, host.HALF) else 0),
            port,
            value,
            -1,
        )
    waiting.serve(h)


@hot
def _in16(h, port):
    p = array_at(h.ports, h.n_ports, host.PORT)[_place(h, port)]
    kind = p.kind
    wide = kind == host.DEVICE and p.mask == host.WIDE
    if not wide and kind not in (host.NOTHING, host.WORD):  # the bus makes two cycles of it
        low = _in8(h, port)
        return _in8(h, port + 1 & host.LAST_PORT) << 8 | low
    waiting.cycle(h)
    value = 0xFFFF
    if kind == host.NOTHING:
        host.note(h, host.IN_WIDE | host.STRAY, port, value, h.traced - 1)
    else:
        value = _device(h, p, host.IN16, 0) & 0xFFFF if wide else _read(h, p.chip, p.address)
        p.seen = host.note(h, host.IN_WIDE, port, value, p.seen - 1) + 1
    waiting.serve(h)
    return value


@hot
def _out16(h, port, value):
    p = array_at(h.ports, h.n_ports, host.PORT)[_place(h, port)]
    kind = p.kind
    wide = kind == host.DEVICE and p.mask == host.WIDE
    if not wide and kind not in (host.NOTHING, host.WORD):
        _out8(h, port, value & 0xFF)
        _out8(h, port + 1 & host.LAST_PORT, value >> 8)
        return
    if kind == host.WORD:
        lost = _lost(h, p.chip, p.address, value)
        waiting.cycle(h)
        _write(h, lost, p.chip, p.address, value)
        host.note(h, host.OUT_WIDE | lost * host.LOST_ON_THE_WAY, port, value, -1)
    elif wide:
        waiting.cycle(h)
        _device(h, p, host.OUT16, value)
        host.note(h, host.OUT_WIDE, port, value, -1)
    else:
        waiting.cycle(h)
        host.note(h, host.OUT_WIDE | host.STRAY, port, value, -1)
    waiting.serve(h)


@hot
def _look(h):
    """A look at a timer or a line takes a bus cycle: firmware that waits for either gets on."""
    waiting.cycle(h)
    waiting.serve(h)


@hot
def _refuse(h, what, a, b):
    h.asked_chip, h.asked_address, h.asked = what, a, b
    host.ask(h, host.REFUSED)


@hot
def _set_any_line(h, hook, argument):
    """The hook of all lines as one."""
    waiting.catch_up(h)
    s = interrupts.sources_of(h)[interrupts.ANY_LINE]
    s.level, s.hook, s.argument, s.lines = 1, hook, argument, -1
    interrupts.arm(h)
    h.quiet = 0
    waiting.serve(h)


@hot
def _set_source(h, what, given):
    """A hook of a timer, a line or a software interrupt; given: see TIMER."""
    which, level, source, lines = given[0], given[1], -1, 0
    if what == host.TIMER:
        if 0 <= which < interrupts.TIMERS and 0 <= given[2] < host.LONGEST_DELAY * 1000:
            source = interrupts.FIRST_TIMER + which
    elif 0 <= which < h.n_chips + h.n_devices:
        source, lines = interrupts.FIRST_LINE + which, 1 << which
    elif 0 <= which - interrupts.SOFTWARE_LINE < interrupts.SOFTWARE:
        source = interrupts.FIRST_SOFTWARE + which - interrupts.SOFTWARE_LINE
    is_on = given[3] != 0 and (what != host.TIMER or given[2] != 0)
    if source < 0 or (is_on and not 1 <= level <= interrupts.HIGHEST):
        _refuse(h, what if source < 0 else what | host.OF_LEVEL, which, given[2] if source < 0 else level)
    else:
        waiting.set_source(h, source, lines, given, is_on)


@hot
def _set_level(h, level):
    before = h.level
    if level > interrupts.HIGHEST:
        _refuse(h, host.LEVEL, level, 0)
    elif level >= 0:
        interrupts.set_level(h, level)
    waiting.serve(h)
    return before


@hot
def _raise(h, which):
    """The flag of a software interrupt is set."""
    if not 0 <= which < interrupts.SOFTWARE:
        _refuse(h, host.RAISE, which, 0)
        return
    interrupts.sources_of(h)[interrupts.FIRST_SOFTWARE + which].pending = 1
    interrupts.arm(h)
    waiting.serve(h)


@hot
def _check_stack(h):
    """Call Python about a request that comes from another stack than that of the firmware's own thread."""
    here = frame_address()
    if here < h.stack_low or here > h.stack_high:
        h.looks -= 1
        waiting.catch_up(h)
        host.ask(h, host.ANOTHER_STACK)


@hot
def answer(h, what, a, b):
    """The answer to a request of a host, see IN8."""
    if h.looks:
        _check_stack(h)
    if h.twice:
        h.twice = 0
        host.ask(h, host.TWICE)
    if h.stopped:
        host.ask(h, host.PAUSE)
        return -1
    if h.meter:
        waiting.spend(h)
    if what == host.IN8:
        return _in8(h, a & host.LAST_PORT)
    if what == host.OUT8:
        _out8(h, a & host.LAST_PORT, b & 0xFF)
    elif what == host.IN16:
        return _in16(h, a & host.LAST_PORT)
    elif what == host.OUT16:
        _out16(h, a & host.LAST_PORT, b & 0xFFFF)
    elif what == host.IN32:
        low = _in16(h, a & host.LAST_PORT)
        return _in16(h, a + 2 & host.LAST_PORT) << 16 | low
    elif what == host.OUT32:
        _out16(h, a & host.LAST_PORT, b & 0xFFFF)
        _out16(h, a + 2 & host.LAST_PORT, b >> 16 & 0xFFFF)
    elif host.WINDOW <= what <= host.BEYOND_WINDOW:
        waiting.catch_up(h)
        h.asked_chip, h.asked, h.asked_address = what, a, b
        host.ask(h, host.ABOUT_WINDOW)
        return h.asked
    elif what == host.DELAY:
        waiting.wait(h, least(greatest(a, 0), host.LONGEST_DELAY) * 1000)
    elif what == host.MICROS:
        _look(h)
        return host.now_of(h) // 1000
    elif what == host.LOG:
        waiting.catch_up(h)
        h.asked = a
        host.ask(h, host.LINE_OF_LOG)
    elif what == host.HOOK:
        _set_any_line(h, a, b)
    elif what == host.LINE:
        _look(h)
        return 1 if waiting.line_of(h) else 0
    elif what == host.SETTLE:
        waiting.catch_up(h)
        interrupts.arm(h)
        h.quiet = 0
    elif what == host.UNTIL:
        waiting.reach(h, a)
        return 1 if b and waiting.line_of(h) else 0
    elif what in (host.TIMER, host.ON_LINE):
        _set_source(h, what, array_at(a, 5, WHOLE))
    elif what == host.SPEND:
        waiting.wait(h, least(greatest(a, 0), host.LONGEST_DELAY * 1000))
    elif what == host.LEVEL:
        return _set_level(h, a)
    elif what == host.RAISE:
        _raise(h, a)
    return 0


@exported("i8", host.HOST, "i4", "i8", "i8")
def request(h, what, a, b):
    """int64_t request(void *host, int32_t what, int64_t a, int64_t b): what hosts call."""
    if (h.in_python and what < host.FROM_PYTHON) or not host.enter(h):
        if what < host.FROM_PYTHON:
            h.twice = 1
        return host.TWO_AT_ONCE
    if h.serving:
        interrupts.close_left(h, frame_address())
    mode = usual_float_mode()  # whatever the firmware has made of it, the stage has the same bits
    value = answer(h, what & (host.FROM_PYTHON - 1), a, b)
    float_mode_as_before(mode)
    host.leave(h)
    return value


@exported("i8", host.HOST)
def pulling(h):
    """The chips and devices that pull the interrupt line, a bit each: no bus cycle."""
    return waiting.line_of(h)


@exported(None, host.HOST)
def look_at_sources(h):
    """The table of interrupt sources was changed."""
    interrupts.arm(h)


@exported("i8")
def here():
    """About where the caller's stack is."""
    return frame_address()


@exported("i8")
def compute_as_usual():
    """From now on this thread computes in the usual mode; the mode of before."""
    return usual_float_mode()


@exported(None, "i8")
def compute_as_before(mode):
    """This thread computes in this mode again."""
    float_mode_as_before(mode)


REQUEST = request.kind
