"""One bus cycle of a host, compiled: time passes, the chip is written or read, the trace notes it, the interrupt line is checked.

A host, in C or in Python, makes all its requests by one function, `request(host, what, a, b)`, which C calls through a pointer.
`host` is the address of a HOST record, see host.py.
"""

from __future__ import annotations

from stage.board.host import (
    ABOUT_WINDOW,
    ANOTHER_STACK,
    ASKED_WRITE,
    BEYOND_WINDOW,
    DELAY,
    DEVICE,
    EIGHT,
    FROM_PYTHON,
    HALF,
    HOOK,
    HOST,
    IN,
    IN8,
    IN16,
    IN32,
    IN_WIDE,
    LAST_PORT,
    LATCH,
    LATCHED,
    LEVEL,
    LINE,
    LINE_OF_LOG,
    LOG,
    LONGEST_DELAY,
    LOST_ON_THE_WAY,
    MICROS,
    NOTHING,
    OF_LEVEL,
    ON_LINE,
    OUT,
    OUT8,
    OUT16,
    OUT32,
    OUT_WIDE,
    PAUSE,
    PORT,
    PULLS,
    RAISE,
    REFUSED,
    REGION,
    SETTLE,
    SPEND,
    STRAY,
    TIMER,
    TWICE,
    TWO_AT_ONCE,
    UNTIL,
    UPPER,
    WIDE,
    WINDOW,
    WORD,
    ask,
    chip_of,
    enter,
    leave,
    now_of,
)
from stage.board.interrupts import (
    ANY_LINE,
    FIRST_LINE,
    FIRST_SOFTWARE,
    FIRST_TIMER,
    HIGHEST,
    SOFTWARE,
    SOFTWARE_LINE,
    TIMERS,
    arm,
    close_left,
    set_level,
    sources_of,
)
from stage.board.notes import journal, note
from stage.board.reaching import at_device, device_of
from stage.board.waiting import catch_up, cycle, line_of, reach, serve, set_source, spend, turn_to, wait
from stage.chips import cores
from stage.chips.entries import LOST, READ, WRITE
from stage.native import array_at, exported, float_mode_as_before, frame_address, greatest, hot, least, usual_float_mode
from stage.sim.handle import WHOLE


@hot
def _lost(h, chip, address, value):
    """1 if a fault of the bus keeps this write from its chip."""
    if h.asks >> chip & 1 == 0:
        return 0
    catch_up(h)
    h.asked_chip, h.asked_address, h.asked = chip, address, value
    ask(h, ASKED_WRITE)
    h.quiet = 0
    return h.asked


@hot
def _write(h, lost, chip, address, value):
    """A write cycle reaches a chip, or does not."""
    if h.stopped:
        return
    turn_to(h, chip)
    if not lost:
        cores.write(chip_of(h, chip), address, value)
    if h.journals:
        journal(h, LOST if lost else WRITE, chip, address, value)


@hot
def _read(h, chip, address):
    """A read cycle reaches a chip."""
    if h.stopped:
        return 0xFFFF
    turn_to(h, chip)
    value = cores.read(chip_of(h, chip), address)
    if h.journals and array_at(h.acts, h.n_chips, WHOLE)[chip] >> address & 1:
        journal(h, READ, chip, address, value)
    return value


@hot
def _place(h, port):
    """Where a port is in the table."""
    regions = array_at(h.regions, h.n_regions, REGION)
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
    if device_of(h, p.chip).access == 0:
        catch_up(h)
    return at_device(h, p.chip, p.address, way, value)


@hot
def _in8(h, port):
    cycle(h)
    ports, value = array_at(h.ports, h.n_ports, PORT), 0xFF
    p = ports[_place(h, port)]
    kind = p.kind
    if kind in (NOTHING, LATCH):
        note(h, IN | STRAY, port, value, h.traced - 1)
    else:
        if kind == LATCHED:
            value = _read(h, p.chip, _latches(h)[p.chip])
        elif kind == PULLS:
            value = line_of(h) & (1 << least(h.n_chips, 8)) - 1
        elif kind == DEVICE:
            value = _device(h, p, IN8 if p.mask == EIGHT else IN16, 0) >> (8 if p.mask == UPPER else 0) & 0xFF
        elif kind == HALF:
            value = _read(h, p.chip, p.address) >> 8
        else:
            value = _read(h, p.chip, p.address) & 0xFF
        p.seen = note(h, IN, port, value, p.seen - 1) + 1
    serve(h)
    return value


@hot
def _out8(h, port, value):
    ports = array_at(h.ports, h.n_ports, PORT)
    p = ports[_place(h, port)]
    kind = p.kind
    if kind in (NOTHING, LATCH, PULLS):
        cycle(h)
        if kind == LATCH:
            _latches(h)[p.chip] = value & p.mask
        note(h, OUT if kind == LATCH else OUT | STRAY, port, value, -1)
    elif kind == DEVICE:
        cycle(h)
        word = value << 8 | 0xFF if p.mask == UPPER else value | 0xFF00  # the other half of the bus floats
        _device(h, p, OUT8 if p.mask == EIGHT else OUT16, value if p.mask == EIGHT else word)
        note(h, OUT | (0 if p.mask == EIGHT else STRAY), port, value, -1)
    else:
        address, word = p.address, value
        if kind == LATCHED:
            address = _latches(h)[p.chip]
        elif kind == WORD:  # the other half of the bus floats
            word = value | 0xFF00
        elif kind == HALF:
            word = value << 8 | 0xFF
        lost = _lost(h, p.chip, address, word)
        cycle(h)
        _write(h, lost, p.chip, address, word)
        note(h, OUT | lost * LOST_ON_THE_WAY | (STRAY if kind in (WORD, HALF) else 0), port, value, -1)
    serve(h)


@hot
def _in16(h, port):
    p = array_at(h.ports, h.n_ports, PORT)[_place(h, port)]
    kind = p.kind
    wide = kind == DEVICE and p.mask == WIDE
    if not wide and kind not in (NOTHING, WORD):  # the bus makes two cycles of it
        low = _in8(h, port)
        return _in8(h, port + 1 & LAST_PORT) << 8 | low
    cycle(h)
    value = 0xFFFF
    if kind == NOTHING:
        note(h, IN_WIDE | STRAY, port, value, h.traced - 1)
    else:
        value = _device(h, p, IN16, 0) & 0xFFFF if wide else _read(h, p.chip, p.address)
        p.seen = note(h, IN_WIDE, port, value, p.seen - 1) + 1
    serve(h)
    return value


@hot
def _out16(h, port, value):
    p = array_at(h.ports, h.n_ports, PORT)[_place(h, port)]
    kind = p.kind
    wide = kind == DEVICE and p.mask == WIDE
    if not wide and kind not in (NOTHING, WORD):
        _out8(h, port, value & 0xFF)
        _out8(h, port + 1 & LAST_PORT, value >> 8)
        return
    if kind == WORD:
        lost = _lost(h, p.chip, p.address, value)
        cycle(h)
        _write(h, lost, p.chip, p.address, value)
        note(h, OUT_WIDE | lost * LOST_ON_THE_WAY, port, value, -1)
    elif wide:
        cycle(h)
        _device(h, p, OUT16, value)
        note(h, OUT_WIDE, port, value, -1)
    else:
        cycle(h)
        note(h, OUT_WIDE | STRAY, port, value, -1)
    serve(h)


@hot
def _look(h):
    """A look at a timer or a line takes a bus cycle: firmware that waits for either gets on."""
    cycle(h)
    serve(h)


@hot
def _refuse(h, what, a, b):
    h.asked_chip, h.asked_address, h.asked = what, a, b
    ask(h, REFUSED)


@hot
def _set_any_line(h, hook, argument):
    """The hook of all lines as one."""
    catch_up(h)
    s = sources_of(h)[ANY_LINE]
    s.level, s.hook, s.argument, s.lines = 1, hook, argument, -1
    arm(h)
    h.quiet = 0
    serve(h)


@hot
def _set_source(h, what, given):
    """A hook of a timer, a line or a software interrupt; given: see TIMER."""
    which, level, source, lines = given[0], given[1], -1, 0
    if what == TIMER:
        if 0 <= which < TIMERS and 0 <= given[2] < LONGEST_DELAY * 1000:
            source = FIRST_TIMER + which
    elif 0 <= which < h.n_chips + h.n_devices:
        source, lines = FIRST_LINE + which, 1 << which
    elif 0 <= which - SOFTWARE_LINE < SOFTWARE:
        source = FIRST_SOFTWARE + which - SOFTWARE_LINE
    is_on = given[3] != 0 and (what != TIMER or given[2] != 0)
    if source < 0 or (is_on and not 1 <= level <= HIGHEST):
        _refuse(h, what if source < 0 else what | OF_LEVEL, which, given[2] if source < 0 else level)
    else:
        set_source(h, source, lines, given, is_on)


@hot
def _set_level(h, level):
    before = h.level
    if level > HIGHEST:
        _refuse(h, LEVEL, level, 0)
    elif level >= 0:
        set_level(h, level)
    serve(h)
    return before


@hot
def _raise(h, which):
    """The flag of a software interrupt is set."""
    if not 0 <= which < SOFTWARE:
        _refuse(h, RAISE, which, 0)
        return
    sources_of(h)[FIRST_SOFTWARE + which].pending = 1
    arm(h)
    serve(h)


@hot
def _check_stack(h):
    """Call Python about a request that comes from another stack than that of the firmware's own thread."""
    here = frame_address()
    if here < h.stack_low or here > h.stack_high:
        h.looks -= 1
        catch_up(h)
        ask(h, ANOTHER_STACK)


@hot
def answer(h, what, a, b):
    """The answer to a request of a host, see IN8."""
    if h.looks:
        _check_stack(h)
    if h.twice:
        h.twice = 0
        ask(h, TWICE)
    if h.stopped:
        ask(h, PAUSE)
        return -1
    if h.meter:
        spend(h)
    if what == IN8:
        return _in8(h, a & LAST_PORT)
    if what == OUT8:
        _out8(h, a & LAST_PORT, b & 0xFF)
    elif what == IN16:
        return _in16(h, a & LAST_PORT)
    elif what == OUT16:
        _out16(h, a & LAST_PORT, b & 0xFFFF)
    elif what == IN32:
        low = _in16(h, a & LAST_PORT)
        return _in16(h, a + 2 & LAST_PORT) << 16 | low
    elif what == OUT32:
        _out16(h, a & LAST_PORT, b & 0xFFFF)
        _out16(h, a + 2 & LAST_PORT, b >> 16 & 0xFFFF)
    elif WINDOW <= what <= BEYOND_WINDOW:
        catch_up(h)
        h.asked_chip, h.asked, h.asked_address = what, a, b
        ask(h, ABOUT_WINDOW)
        return h.asked
    elif what == DELAY:
        wait(h, least(greatest(a, 0), LONGEST_DELAY) * 1000)
    elif what == MICROS:
        _look(h)
        return now_of(h) // 1000
    elif what == LOG:
        catch_up(h)
        h.asked = a
        ask(h, LINE_OF_LOG)
    elif what == HOOK:
        _set_any_line(h, a, b)
    elif what == LINE:
        _look(h)
        return 1 if line_of(h) else 0
    elif what == SETTLE:
        catch_up(h)
        arm(h)
        h.quiet = 0
    elif what == UNTIL:
        reach(h, a)
        return 1 if b and line_of(h) else 0
    elif what in (TIMER, ON_LINE):
        _set_source(h, what, array_at(a, 5, WHOLE))
    elif what == SPEND:
        wait(h, least(greatest(a, 0), LONGEST_DELAY * 1000))
    elif what == LEVEL:
        return _set_level(h, a)
    elif what == RAISE:
        _raise(h, a)
    return 0


@exported("i8", HOST, "i4", "i8", "i8")
def request(h, what, a, b):
    """int64_t request(void *host, int32_t what, int64_t a, int64_t b): what hosts call."""
    if (h.in_python and what < FROM_PYTHON) or not enter(h):
        if what < FROM_PYTHON:
            h.twice = 1
        return TWO_AT_ONCE
    if h.serving:
        close_left(h, frame_address())
    mode = usual_float_mode()  # whatever the firmware has made of it, the stage has the same bits
    value = answer(h, what & (FROM_PYTHON - 1), a, b)
    float_mode_as_before(mode)
    leave(h)
    return value


@exported("i8", HOST)
def pulling(h):
    """The chips and devices that pull the interrupt line, a bit each: no bus cycle."""
    return line_of(h)


@exported(None, HOST)
def look_at_sources(h):
    """The table of interrupt sources was changed."""
    arm(h)


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
