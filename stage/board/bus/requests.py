"""One bus cycle of a host, compiled: time passes, the chip is written or read, the trace notes it, the interrupt line is checked.

A host, in C or in Python, makes all its requests by one function, `request(host, what, a, b)`, which C calls through a pointer.
`host` is the address of a HOST record, see host_record.py.
"""

from __future__ import annotations

from stage.board.bus import host_record, interrupts, waiting
from stage.chips import cores
from stage.chips.entries import LOST, READ, WRITE
from stage.native import array_at, exported, float_mode_as_before, frame_address, greatest, hot, least, usual_float_mode
from stage.sim.handle import INTEGER


@hot
def _lost(h, chip, address, value):
    """1 if a fault of the bus keeps this write from its chip."""
    if h.asks >> chip & 1 == 0:
        return 0
    waiting.catch_up(h)
    h.asked_chip, h.asked_address, h.asked = chip, address, value
    host_record.ask(h, host_record.ASKED_WRITE)
    h.quiet = 0
    return h.asked


@hot
def _write(h, lost, chip, address, value):
    """A write cycle reaches a chip, or does not."""
    if h.stopped:
        return
    waiting.turn_to(h, chip)
    if not lost:
        cores.write(host_record.chip_of(h, chip), address, value)
    if h.journals:
        host_record.journal(h, LOST if lost else WRITE, chip, address, value)


@hot
def _read(h, chip, address):
    """A read cycle reaches a chip."""
    if h.stopped:
        return 0xFFFF
    waiting.turn_to(h, chip)
    value = cores.read(host_record.chip_of(h, chip), address)
    if h.journals and array_at(h.acts, h.n_chips, INTEGER)[chip] >> address & 1:
        host_record.journal(h, READ, chip, address, value)
    return value


@hot
def _place(h, port):
    """Where a port is in the table."""
    regions = array_at(h.regions, h.n_regions, host_record.REGION)
    for k in range(h.n_regions):
        n = port - regions[k].first
        if 0 <= n < regions[k].n:
            return regions[k].at + n
    return 0


@hot
def _latches(h):
    """The address that each chip's latch holds: part of the stage's state."""
    return array_at(h.latches, h.n_chips, INTEGER)


@hot
def _device(h, p, way, value):
    """A cycle reaches a device."""
    if host_record.device_of(h, p.chip).access == 0:
        waiting.catch_up(h)
    return host_record.at_device(h, p.chip, p.address, way, value)


@hot
def _in8(h, port):
    waiting.cycle(h)
    ports, value = array_at(h.ports, h.n_ports, host_record.PORT), 0xFF
    p = ports[_place(h, port)]
    kind = p.kind
    if kind in (host_record.NOTHING, host_record.LATCH):
        host_record.note(h, host_record.IN | host_record.STRAY, port, value, h.traced - 1)
    else:
        if kind == host_record.LATCHED:
            value = _read(h, p.chip, _latches(h)[p.chip])
        elif kind == host_record.PULLS:
            value = waiting.line_of(h) & (1 << least(h.n_chips, 8)) - 1
        elif kind == host_record.DEVICE:
            value = (
                _device(h, p, host_record.IN8 if p.mask == host_record.EIGHT else host_record.IN16, 0)
                >> (8 if p.mask == host_record.UPPER else 0)
                & 0xFF
            )
        elif kind == host_record.HALF:
            value = _read(h, p.chip, p.address) >> 8
        else:
            value = _read(h, p.chip, p.address) & 0xFF
        p.seen = host_record.note(h, host_record.IN, port, value, p.seen - 1) + 1
    waiting.serve(h)
    return value


@hot
def _out8(h, port, value):
    ports = array_at(h.ports, h.n_ports, host_record.PORT)
    p = ports[_place(h, port)]
    kind = p.kind
    if kind in (host_record.NOTHING, host_record.LATCH, host_record.PULLS):
        waiting.cycle(h)
        if kind == host_record.LATCH:
            _latches(h)[p.chip] = value & p.mask
        host_record.note(
            h, host_record.OUT if kind == host_record.LATCH else host_record.OUT | host_record.STRAY, port, value, -1
        )
    elif kind == host_record.DEVICE:
        waiting.cycle(h)
        word = value << 8 | 0xFF if p.mask == host_record.UPPER else value | 0xFF00  # the other half of the bus floats
        _device(
            h,
            p,
            host_record.OUT8 if p.mask == host_record.EIGHT else host_record.OUT16,
            value if p.mask == host_record.EIGHT else word,
        )
        host_record.note(
            h, host_record.OUT | (0 if p.mask == host_record.EIGHT else host_record.STRAY), port, value, -1
        )
    else:
        address, word = p.address, value
        if kind == host_record.LATCHED:
            address = _latches(h)[p.chip]
        elif kind == host_record.WORD:  # the other half of the bus floats
            word = value | 0xFF00
        elif kind == host_record.HALF:
            word = value << 8 | 0xFF
        lost = _lost(h, p.chip, address, word)
        waiting.cycle(h)
        _write(h, lost, p.chip, address, word)
        host_record.note(
            h,
            host_record.OUT
            | lost * host_record.LOST_ON_THE_WAY
            | (host_record.STRAY if kind in (host_record.WORD, host_record.HALF) else 0),
            port,
            value,
            -1,
        )
    waiting.serve(h)


@hot
def _in16(h, port):
    p = array_at(h.ports, h.n_ports, host_record.PORT)[_place(h, port)]
    kind = p.kind
    wide = kind == host_record.DEVICE and p.mask == host_record.WIDE
    if not wide and kind not in (host_record.NOTHING, host_record.WORD):  # the bus makes two cycles of it
        low = _in8(h, port)
        return _in8(h, port + 1 & host_record.LAST_PORT) << 8 | low
    waiting.cycle(h)
    value = 0xFFFF
    if kind == host_record.NOTHING:
        host_record.note(h, host_record.IN_WIDE | host_record.STRAY, port, value, h.traced - 1)
    else:
        value = _device(h, p, host_record.IN16, 0) & 0xFFFF if wide else _read(h, p.chip, p.address)
        p.seen = host_record.note(h, host_record.IN_WIDE, port, value, p.seen - 1) + 1
    waiting.serve(h)
    return value


@hot
def _out16(h, port, value):
    p = array_at(h.ports, h.n_ports, host_record.PORT)[_place(h, port)]
    kind = p.kind
    wide = kind == host_record.DEVICE and p.mask == host_record.WIDE
    if not wide and kind not in (host_record.NOTHING, host_record.WORD):
        _out8(h, port, value & 0xFF)
        _out8(h, port + 1 & host_record.LAST_PORT, value >> 8)
        return
    if kind == host_record.WORD:
        lost = _lost(h, p.chip, p.address, value)
        waiting.cycle(h)
        _write(h, lost, p.chip, p.address, value)
        host_record.note(h, host_record.OUT_WIDE | lost * host_record.LOST_ON_THE_WAY, port, value, -1)
    elif wide:
        waiting.cycle(h)
        _device(h, p, host_record.OUT16, value)
        host_record.note(h, host_record.OUT_WIDE, port, value, -1)
    else:
        waiting.cycle(h)
        host_record.note(h, host_record.OUT_WIDE | host_record.STRAY, port, value, -1)
    waiting.serve(h)


@hot
def _look(h):
    """A look at a timer or a line takes a bus cycle: firmware that waits for either gets on."""
    waiting.cycle(h)
    waiting.serve(h)


@hot
def _refuse(h, what, a, b):
    h.asked_chip, h.asked_address, h.asked = what, a, b
    host_record.ask(h, host_record.REFUSED)


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
    if what == host_record.TIMER:
        if 0 <= which < interrupts.TIMERS and 0 <= given[2] < host_record.LONGEST_DELAY * 1000:
            source = interrupts.FIRST_TIMER + which
    elif 0 <= which < h.n_chips + h.n_devices:
        source, lines = interrupts.FIRST_LINE + which, 1 << which
    elif 0 <= which - interrupts.SOFTWARE_LINE < interrupts.SOFTWARE:
        source = interrupts.FIRST_SOFTWARE + which - interrupts.SOFTWARE_LINE
    is_on = given[3] != 0 and (what != host_record.TIMER or given[2] != 0)
    if source < 0 or (is_on and not 1 <= level <= interrupts.HIGHEST):
        _refuse(h, what if source < 0 else what | host_record.OF_LEVEL, which, given[2] if source < 0 else level)
    else:
        waiting.set_source(h, source, lines, given, is_on)


@hot
def _set_level(h, level):
    before = h.level
    if level > interrupts.HIGHEST:
        _refuse(h, host_record.LEVEL, level, 0)
    elif level >= 0:
        interrupts.set_level(h, level)
    waiting.serve(h)
    return before


@hot
def _raise(h, which):
    """The flag of a software interrupt is set."""
    if not 0 <= which < interrupts.SOFTWARE:
        _refuse(h, host_record.RAISE, which, 0)
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
        host_record.ask(h, host_record.ANOTHER_STACK)


@hot
def answer(h, what, a, b):
    """The answer to a request of a host, see IN8."""
    if h.looks:
        _check_stack(h)
    if h.twice:
        h.twice = 0
        host_record.ask(h, host_record.TWICE)
    if h.stopped:
        host_record.ask(h, host_record.PAUSE)
        return -1
    if h.meter:
        waiting.spend(h)
    if what == host_record.IN8:
        return _in8(h, a & host_record.LAST_PORT)
    if what == host_record.OUT8:
        _out8(h, a & host_record.LAST_PORT, b & 0xFF)
    elif what == host_record.IN16:
        return _in16(h, a & host_record.LAST_PORT)
    elif what == host_record.OUT16:
        _out16(h, a & host_record.LAST_PORT, b & 0xFFFF)
    elif what == host_record.IN32:
        low = _in16(h, a & host_record.LAST_PORT)
        return _in16(h, a + 2 & host_record.LAST_PORT) << 16 | low
    elif what == host_record.OUT32:
        _out16(h, a & host_record.LAST_PORT, b & 0xFFFF)
        _out16(h, a + 2 & host_record.LAST_PORT, b >> 16 & 0xFFFF)
    elif host_record.WINDOW <= what <= host_record.BEYOND_WINDOW:
        waiting.catch_up(h)
        h.asked_chip, h.asked, h.asked_address = what, a, b
        host_record.ask(h, host_record.ABOUT_WINDOW)
        return h.asked
    elif what == host_record.DELAY:
        waiting.wait(h, least(greatest(a, 0), host_record.LONGEST_DELAY) * 1000)
    elif what == host_record.MICROS:
        _look(h)
        return host_record.now_of(h) // 1000
    elif what == host_record.LOG:
        waiting.catch_up(h)
        h.asked = a
        host_record.ask(h, host_record.LINE_OF_LOG)
    elif what == host_record.HOOK:
        _set_any_line(h, a, b)
    elif what == host_record.LINE:
        _look(h)
        return 1 if waiting.line_of(h) else 0
    elif what == host_record.SETTLE:
        waiting.catch_up(h)
        interrupts.arm(h)
        h.quiet = 0
    elif what == host_record.UNTIL:
        waiting.reach(h, a)
        return 1 if b and waiting.line_of(h) else 0
    elif what in (host_record.TIMER, host_record.ON_LINE):
        _set_source(h, what, array_at(a, 5, INTEGER))
    elif what == host_record.SPEND:
        waiting.wait(h, least(greatest(a, 0), host_record.LONGEST_DELAY * 1000))
    elif what == host_record.LEVEL:
        return _set_level(h, a)
    elif what == host_record.RAISE:
        _raise(h, a)
    return 0


@exported("i8", host_record.HOST, "i4", "i8", "i8")
def request(h, what, a, b):
    """int64_t request(void *host, int32_t what, int64_t a, int64_t b): what hosts call."""
    if (h.in_python and what < host_record.FROM_PYTHON) or not host_record.enter(h):
        if what < host_record.FROM_PYTHON:
            h.twice = 1
        return host_record.TWO_AT_ONCE
    if h.serving:
        interrupts.close_left(h, frame_address())
    mode = usual_float_mode()  # whatever the firmware has made of it, the stage has the same bits
    value = answer(h, what & (host_record.FROM_PYTHON - 1), a, b)
    float_mode_as_before(mode)
    host_record.leave(h)
    return value


@exported("i8", host_record.HOST)
def pulling(h):
    """The chips and devices that pull the interrupt line, a bit each: no bus cycle."""
    return waiting.line_of(h)


@exported(None, host_record.HOST)
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


REQUEST = request.prototype
