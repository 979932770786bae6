"""One bus cycle of a host, compiled: time passes, the interrupt line is looked at, the chip answers, the trace notes it.

A host, in C or in Python, says everything through one function, `request(host, what, a, b)`; it lies behind a pointer that C calls.
`host` is the address of a HOST record. Where compiled code cannot go on by itself (a buffer is full, the firmware is to stand
still), it calls back, with one of the reasons below, and Python sees to it.
"""

from __future__ import annotations

from stage.chips import cores
from stage.chips.entries import LOST, READ, WRITE
from stage.native import array_at, called, exported, greatest, hot, least, record
from stage.sim import engine, handle
from stage.sim.handle import AXIS, WHOLE, chips, clockwork, world
from stage.sim.in_use import ENGINE, claim, release

IN8, OUT8, IN16, OUT16, DELAY, MICROS, LOG, HOOK, LINE, SETTLE = range(10)
"""What a host asks: port cycles (a: port, b: value), a delay (a: us), the time (us), to note a line (a: its address), to call a
function (a: its address) with an argument (b) while the interrupt line is asserted, whether it is, that the stage catches up."""
FULL, DIVERGED, PAUSE, STORM, LINE_OF_LOG, ASKED_WRITE, BY_HAND = range(1, 8)
"""Why Python is called: buffers are full; the physics has diverged; time or cycles are up; an interrupt that nothing clears; a
line to note; a write that Python makes, since a fault of the bus looks at each; the stage's time is to pass and compiled code alone
may not let it."""
TWO_AT_ONCE = -(1 << 62)
"""The answer to a host that asks while another asks in another thread."""
LONGEST_DELAY = 10**15
"""us: with more, ns would no longer fit 63 bits."""
STORM_CALLS = 1000
AT_ONCE = 10_000_000
"""ns that pass between two looks at whether the firmware is to stand still: Ctrl-C in a long delay."""

NOTHING, BYTE, WORD, HALF, LATCH, LATCHED, PULLS = range(7)
PORT = record([(name, "i8") for name in "kind chip address mask seen".split()])
"""What a port reaches. BYTE, WORD: an address of a chip of 8, 16 bits; HALF: the upper byte of the WORD one below; LATCH: takes
the address for LATCHED, as much of it (`mask`) as the chip does; PULLS: which chips pull the interrupt line, a bit each. `seen`:
number of the trace's line about its last read, plus one."""

IN, OUT, IN_WIDE, OUT_WIDE, CALLED, RETURNED = range(6)
STRAY, LOST_ON_THE_WAY = 8, 16
CYCLE = record([(name, "i8") for name in "first last count kind port value".split()])
"""A line of the trace: when (ns) the cycle ended; the last of `count` that were alike, with no write between; kind, | STRAY if it
hit nothing, or only half of what is there, | LOST_ON_THE_WAY if a fault of the bus kept it from its chip."""

HOST = record(
    handle.HANDLE_FIELDS
    + [("inside", "i8")]
    + [(name, "i8") for name in "ports first n_ports lines line_room traced changed".split()]
    + [(name, "i8") for name in "until lazy ahead quiet cycles most_cycles stopped call hook argument serving".split()]
    + [
        (name, "i8")
        for name in "irqs acts before userdata words journals asks asked_chip asked_address asked reached".split()
    ]
)
"""A stage's handle, and
    inside                     whether a request is being answered, see stage.in_use; not while Python or a hook is called
    ports, first, n_ports      the table of ports, and which is its first
    lines, line_room, traced, changed   the trace, a ring; lines so far, and how many there were after the last write
    until, most_cycles         when (ns), and after how many cycles, to call Python; cycles: so far
    lazy, ahead, quiet         whether the stage may stay behind the host, by how much (ns) it does, and up to when it may
    stopped, call              nothing more happens; how to call Python
    hook, argument, serving    the interrupt hook, and whether it is being called
    irqs, acts                 of each chip: its IRQ, and the addresses (bits) at which a read changes it
    before, userdata, words    room for a copy of the state in userdata; where that is, and how long
    reached                    the stage's time (ns), for whoever sees nothing but this record
    journals, asks, asked ...  whether journals are kept; chips (bits) whose writes Python looks at; what Python is called about
"""

IRQ = record([("axis", "i8"), ("bits", "i8")])
"""Of each chip: the outputs that pull the interrupt line (0: none), and as which axis' they are asked for."""


INSIDE = int(dict(HOST.fields or {})["inside"][1])
_call = called(None, "i8")


@hot
def stage_of(h):
    """The HANDLE that a HOST record begins with."""
    return array_at(h.own, 1, handle.HANDLE)[0]


@hot
def _enter(h):
    """True if no other request is being answered, which none will be then until `_leave`."""
    return claim(h.own + INSIDE, ENGINE)


@hot
def _leave(h):
    release(h.own + INSIDE, ENGINE)


@hot
def _call_out(h, function, argument):
    """Call a function that may make requests."""
    _leave(h)
    _call(function, (argument,))
    while not _enter(h):  # another thread is inside, and soon out
        pass


@hot
def _ask(h, reason):
    """Call Python about `reason`."""
    _call_out(h, h.call, reason)


@hot
def _run(h, until):
    """Let the stage's time pass up to `until` ns; journals and recordings take part."""
    w = world(stage_of(h))
    while w.now < until and not h.stopped:
        status = handle.advance(stage_of(h), until)
        if status == engine.DIVERGED:
            _ask(h, DIVERGED)
        elif status == engine.SAMPLES_FULL or status == engine.EDGES_FULL:
            _ask(h, FULL)
        elif status != engine.REACHED:
            h.asked = until
            _ask(h, BY_HAND)
    h.reached = w.now


@hot
def _catch_up(h):
    """The whole stage stands where the host does."""
    if h.ahead:
        ahead, h.ahead = h.ahead, 0
        _run(h, world(stage_of(h)).now + ahead)


@hot
def _foresee(h):
    """Up to when nothing but the chips themselves moves: no edge, no end of a slice."""
    w, axes, dt = world(stage_of(h)), array_at(h.axes, h.n_axes, AXIS), clockwork(stage_of(h)).dt
    h.quiet = least(h.until, w.start + (w.slice + 1) * dt // engine.SLICES)
    for a in range(len(axes)):
        h.quiet = least(h.quiet, axes[a].next_edge)


@hot
def _now(h):
    """The host's time, ns."""
    return world(stage_of(h)).now + h.ahead


@hot
def _pass_cycle(h):
    """A bus cycle's time passes. While nothing but the chips moves, the stage follows later, and of the chips only the one
    that the host turns to is taken along: all of them for each cycle would cost as much as the physics."""
    if h.lazy and h.hook == 0:
        if _now(h) + h.bus < h.quiet:
            h.ahead += h.bus
            return
        _catch_up(h)
        _pass(h, h.bus)
        _foresee(h)
    else:
        _catch_up(h)
        _pass(h, h.bus)


@hot
def _turn_to(h, chip):
    """The chip stands where the host does."""
    if h.ahead:
        c = _chip(h, chip)
        cores.run(c, engine.clock_at(_now(h), c.hz))


@hot
def _chip(h, chip):
    return chips(stage_of(h))[chip]


@hot
def _pass(h, ns):
    """`ns` pass; where the firmware is to stand still on the way, it does."""
    w, left = world(stage_of(h)), ns
    while left > 0 and not h.stopped:
        if w.now >= h.until:
            _ask(h, PAUSE)
            continue
        end = least(least(w.now + left, h.until), w.now + AT_ONCE)
        left -= end - w.now
        _run(h, end)


@hot
def _line(h):
    """The chips that pull the interrupt line, a bit each."""
    _catch_up(h)
    irqs, pulling = array_at(h.irqs, h.n_chips, IRQ), 0
    for k in range(h.n_chips):
        irq = irqs[k]
        if irq.bits and cores.outputs(_chip(h, k), irq.axis) & irq.bits:
            pulling |= 1 << k
    return pulling


@hot
def _serve(h):
    """The line is looked at: while it is asserted, the firmware's hook is called."""
    if h.hook == 0 or h.serving:
        return
    calls = 0
    while _line(h) and h.hook and not h.stopped:
        if calls == STORM_CALLS:
            _ask(h, STORM)
        calls += 1
        _note(h, CALLED, 0, 0, -1)
        h.serving = 1
        _call_out(h, h.hook, h.argument)
        h.serving = 0
        _note(h, RETURNED, 0, 0, -1)


@hot
def _copy(source, target, words):
    a, b = array_at(source, words, WHOLE), array_at(target, words, WHOLE)
    for k in range(words):
        b[k] = a[k]


@hot
def _wait(h, ns):
    """`ns` pass in a delay; an interrupt comes at the ns at which the line is asserted. What its hook takes is part of the
    delay."""
    _catch_up(h)
    w, dt = world(stage_of(h)), clockwork(stage_of(h)).dt
    end = w.now + ns
    while w.now < end and not h.stopped:
        if h.hook == 0 or h.serving:
            _pass(h, end - w.now)
            return
        if w.now >= h.until:
            _ask(h, PAUSE)
            continue
        stop = least(least(end, h.until), w.start + dt)
        inside = stop - 1 if stop == w.start + dt else stop  # where no physics has come between, time can be taken back
        begin, noted = w.now, h.noted
        _copy(h.userdata, h.before, h.words)
        _run(h, inside)
        if _line(h):
            low, high = begin, inside  # off at `low`, asserted at `high`
            while high - low > 1:
                middle = (low + high) // 2
                _copy(h.before, h.userdata, h.words)
                h.noted = noted
                _run(h, middle)
                if _line(h):
                    high = middle
                else:
                    low = middle
            _copy(h.before, h.userdata, h.words)
            h.noted = noted
            _run(h, high)
        else:
            _run(h, stop)
        _serve(h)


@hot
def _note(h, kind, port, value, seen):
    """A line of the trace about the cycle that has just ended. seen: the last line about a read of this port that may say
    it all, or -1. Returns the line's number."""
    if h.stopped:
        return -1
    now, lines = _now(h), array_at(h.lines, h.line_room, CYCLE)
    if seen >= h.changed and h.traced - seen <= h.line_room:
        line = lines[seen % h.line_room]
        if line.value == value and line.kind == kind and line.port == port:
            line.last, line.count = now, line.count + 1
            return seen
    line = lines[h.traced % h.line_room]
    line.first, line.last, line.count, line.kind, line.port, line.value = now, now, 1, kind, port, value
    h.traced += 1
    if kind & ~STRAY not in (IN, IN_WIDE):
        h.changed = h.traced
    return h.traced - 1


@hot
def _journal(h, kind, chip, address, value):
    """What a cycle did to a chip, for its journal, in the order of the switches' edges."""
    if h.noted >= h.edge_room - engine.EDGES_A_WINDOW * h.n_axes:  # the engine needs that much in any step
        _ask(h, FULL)
    e = array_at(h.edges, h.edge_room, engine.EDGE)[h.noted]
    c = _chip(h, chip)
    e.now, e.clock, e.axis = _now(h), cores.clock(c), c.axis[0]
    e.kind, e.a, e.b = kind, address, value
    h.noted += 1


@hot
def _lost(h, chip, address, value):
    """1 if a fault of the bus keeps this write from its chip."""
    if h.asks >> chip & 1 == 0:
        return 0
    _catch_up(h)
    h.asked_chip, h.asked_address, h.asked = chip, address, value
    _ask(h, ASKED_WRITE)
    h.quiet = 0
    return h.asked


@hot
def _write(h, lost, chip, address, value):
    """A write cycle reaches a chip, or does not."""
    if h.stopped:
        return
    _turn_to(h, chip)
    if not lost:
        cores.write(_chip(h, chip), address, value)
    if h.journals:
        _journal(h, LOST if lost else WRITE, chip, address, value)


@hot
def _read(h, chip, address):
    """A read cycle reaches a chip."""
    if h.stopped:
        return 0xFFFF
    _turn_to(h, chip)
    value = cores.read(_chip(h, chip), address)
    if h.journals and array_at(h.acts, h.n_chips, WHOLE)[chip] >> address & 1:
        _journal(h, READ, chip, address, value)
    return value


@hot
def _cycle(h):
    """The time of one bus cycle."""
    if h.cycles >= h.most_cycles:
        _catch_up(h)
        _ask(h, PAUSE)
        h.quiet = 0
    h.cycles += 1
    _pass_cycle(h)


@hot
def _kind(h, port):
    p = port - h.first
    return array_at(h.ports, h.n_ports, PORT)[p].kind if 0 <= p < h.n_ports else NOTHING


@hot
def _in8(h, port):
    _cycle(h)
    kind, value, ports = _kind(h, port), 0xFF, array_at(h.ports, h.n_ports, PORT)
    if kind in (NOTHING, LATCH):
        _note(h, IN | STRAY, port, value, h.traced - 1)
    else:
        p = ports[port - h.first]
        if kind == LATCHED:
            value = _read(h, p.chip, ports[p.address].address)
        elif kind == PULLS:
            value = _line(h)
        elif kind == HALF:
            value = _read(h, p.chip, p.address) >> 8
        else:
            value = _read(h, p.chip, p.address) & 0xFF
        p.seen = _note(h, IN, port, value, p.seen - 1) + 1
    _serve(h)
    return value


@hot
def _out8(h, port, value):
    kind, ports = _kind(h, port), array_at(h.ports, h.n_ports, PORT)
    if kind in (NOTHING, LATCH, PULLS):
        _cycle(h)
        if kind == LATCH:
            ports[port - h.first].address = value & ports[port - h.first].mask
        _note(h, OUT if kind == LATCH else OUT | STRAY, port, value, -1)
    else:
        p = ports[port - h.first]
        address, word = p.address, value
        if kind == LATCHED:
            address = ports[address].address
        elif kind == WORD:  # the other half of the bus floats
            word = value | 0xFF00
        elif kind == HALF:
            word = value << 8 | 0xFF
        lost = _lost(h, p.chip, address, word)
        _cycle(h)
        _write(h, lost, p.chip, address, word)
        _note(h, OUT | lost * LOST_ON_THE_WAY | (STRAY if kind in (WORD, HALF) else 0), port, value, -1)
    _serve(h)


@hot
def _in16(h, port):
    kind = _kind(h, port)
    if kind not in (NOTHING, WORD):  # the bus makes two cycles of it
        low = _in8(h, port)
        return _in8(h, port + 1) << 8 | low
    _cycle(h)
    value = 0xFFFF
    if kind == WORD:
        p = array_at(h.ports, h.n_ports, PORT)[port - h.first]
        value = _read(h, p.chip, p.address)
        p.seen = _note(h, IN_WIDE, port, value, p.seen - 1) + 1
    else:
        _note(h, IN_WIDE | STRAY, port, value, h.traced - 1)
    _serve(h)
    return value


@hot
def _out16(h, port, value):
    kind = _kind(h, port)
    if kind not in (NOTHING, WORD):
        _out8(h, port, value & 0xFF)
        _out8(h, port + 1, value >> 8)
        return
    if kind == WORD:
        p = array_at(h.ports, h.n_ports, PORT)[port - h.first]
        lost = _lost(h, p.chip, p.address, value)
        _cycle(h)
        _write(h, lost, p.chip, p.address, value)
        _note(h, OUT_WIDE | lost * LOST_ON_THE_WAY, port, value, -1)
    else:
        _cycle(h)
        _note(h, OUT_WIDE | STRAY, port, value, -1)
    _serve(h)


@hot
def _look(h):
    """A look at a timer or a line takes a bus cycle: firmware that waits for either gets on."""
    _cycle(h)
    _serve(h)


@hot
def _answer(h, what, a, b):
    """What a host asks, see IN8."""
    if h.stopped:
        _ask(h, PAUSE)
        return -1
    if what == IN8:
        return _in8(h, a & 0xFFFFFFFF)
    if what == OUT8:
        _out8(h, a & 0xFFFFFFFF, b & 0xFF)
    elif what == IN16:
        return _in16(h, a & 0xFFFFFFFF)
    elif what == OUT16:
        _out16(h, a & 0xFFFFFFFF, b & 0xFFFF)
    elif what == DELAY:
        _wait(h, least(greatest(a, 0), LONGEST_DELAY) * 1000)
    elif what == MICROS:
        _look(h)
        return _now(h) // 1000
    elif what == LOG:
        _catch_up(h)
        h.asked = a
        _ask(h, LINE_OF_LOG)
    elif what == HOOK:
        _catch_up(h)
        h.hook, h.argument, h.quiet = a, b, 0
        _serve(h)
    elif what == LINE:
        _look(h)
        return 1 if _line(h) else 0
    elif what == SETTLE:
        _catch_up(h)
    return 0


@exported("i8", HOST, "i4", "i8", "i8")
def request(h, what, a, b):
    """int64_t request(void *host, int32_t what, int64_t a, int64_t b): what hosts call."""
    if not _enter(h):
        return TWO_AT_ONCE
    answer = _answer(h, what, a, b)
    _leave(h)
    return answer


REQUEST = request.kind
