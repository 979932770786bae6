"""`HOST`: the record of a host on the board's bus, and what all its requests have in common. Compiled.

Where compiled code cannot continue by itself (a buffer is full, the firmware must be paused), it calls Python, with one of the
reasons below.

A compiled device, of ours or of a C library, is two functions over its state, which see the time and the counts of its encoders:

    access(state, now, counts, n, way, value) -> value      a cycle at its port `n`; way: IN8, OUT8, IN16, OUT16
    pulls(state, now, counts) -> 1 if it pulls the interrupt line then; changes nothing
"""

from __future__ import annotations

from stage.chips import cores
from stage.native import array_at, called, floor, hot, record, usual_float_mode
from stage.sim import handle, records
from stage.sim.handle import ENGINE, INTEGER, REAL, chips, claim, clockwork, release, table, world

IN8, OUT8, IN16, OUT16, DELAY, MICROS, LOG, HOOK, LINE, SETTLE = range(10)
"""What a host asks: port cycles (a: port, b: value), a delay (a: us), the time (us), to note a line (a: its address), to call a
function (a: its address) with an argument (b) while the interrupt line is asserted, whether it is, that the stage catches up."""
TIMER, ON_LINE, SPEND = 10, 11, 12
"""A timer, a hook of one interrupt source (a: the address of five int64: which, its level, the period in ns, the hook, its
argument); computing that has taken time (a: ns, beside what the meter has counted)."""
IN32, OUT32, WINDOW, NO_CYCLE, BEYOND_WINDOW = range(13, 18)
"""Two cycles of 16 bits, the low half first; the address of a new window (a: its first port, b: how many). And, from the handler of
faults: that an instruction (a: its STEP) touches a window (b: where), but is no bus cycle, or goes beyond the window."""
LEVEL, RAISE = 18, 19
"""The processor's level (a; -1: as it is), the answer is that of before; a software interrupt (a: which)."""
UNTIL = 20
"""An emulated processor: its time (a: ns of the stage) is the board's; if `b`, whether the interrupt line then is asserted."""
OF_LEVEL = 64
"""Added to what is refused when its level is what makes no sense."""
FULL, DIVERGED, PAUSE, STORM, LINE_OF_LOG, ASKED_WRITE, BY_HAND, TWICE, DEVICE_CALLED, REFUSED, ANOTHER_STACK = range(
    1, 12
)
"""Why Python is called: buffers are full; the physics has diverged; time or cycles are up; an interrupt that nothing clears; a
line to note; a write that Python makes, since a fault of the bus looks at each; the stage's time is to pass and compiled code alone
may not let it; two threads of the firmware made requests at once; a cycle reaches a device that is written in Python; a request
that makes no sense; a request from another stack than that of the firmware's own thread."""
ABOUT_WINDOW = 20
"""Another: a request about a window."""
FROM_PYTHON = 64
"""Added to what a host in Python requests: it is told at once that another thread is in."""
TWO_AT_ONCE = -(1 << 62)
"""The answer to a host that asks while another asks in another thread."""
LONGEST_DELAY = 10**15
"""us: with more, ns would no longer fit 63 bits."""
STORM_CALLS = 1000
AT_ONCE = 10_000_000
"""ns that pass between two looks at whether the firmware is to stand still: Ctrl-C in a long delay."""

LAST_PORT = 0xFFFFFFFF
NOTHING, BYTE, WORD, HALF, LATCH, LATCHED, PULLS, DEVICE = range(8)
EIGHT, WIDE, UPPER = range(3)
REGION = record([(name, "i8") for name in "first n at".split()])
"""`n` ports from port `first` on: where the first of them is in the table of ports."""
PORT = record([(name, "i8") for name in "kind chip address mask seen".split()])
"""What a port reaches; the first of a table is what all ports in no region reach: nothing. BYTE, WORD: an address of a chip of 8,
16 bits; HALF: the upper byte of the WORD one below; LATCH: takes the address for the chip's LATCHED, as much of it (`mask`) as
the chip does; PULLS: which chips pull the interrupt line, a bit each; DEVICE: the port `address` of the device `chip`, and `mask`
says what of it: EIGHT bits, a WIDE word of 16, the UPPER byte of the word one below. `seen`: number of the trace's line about its
last read, plus one."""

IN, OUT, IN_WIDE, OUT_WIDE, CALLED, RETURNED = IN8, OUT8, IN16, OUT16, 4, 5
STRAY, LOST_ON_THE_WAY, RAISED = 8, 16, 32
CYCLE = record([(name, "i8") for name in "first last count kind port value".split()])
"""A line of the trace: when (ns) the cycle ended; the last of `count` that were alike, with no write between; kind, | STRAY if it
hit nothing, or only half of what is there, | LOST_ON_THE_WAY if a fault of the bus kept it from its chip, | RAISED if
the device in Python that it reached raised an error."""

HOST = record(
    handle.HANDLE_FIELDS
    + [(name, "i8") for name in "inside in_python".split()]
    + [(name, "i8") for name in "regions n_regions ports n_ports lines line_room traced changed".split()]
    + [(name, "i8") for name in "until lazy ahead quiet cycles most_cycles stopped twice call".split()]
    + [(name, "i8") for name in "sources level looked on_lines raised watched due".split()]
    + [(name, "i8") for name in "hooks serving called stack_low stack_high looks meter cost rest".split()]
    + [
        (name, "i8")
        for name in "irqs acts before userdata words journals asks asked_chip asked_address asked_way asked reached".split()
    ]
    + [(name, "i8") for name in "devices n_devices answers faults".split()]
)
"""A stage's handle, and
    inside                     whether a request is being answered, see stage.sim.handle; not while Python or a hook is called
    in_python                  whether Python is being called: what the firmware requests then comes from a handler of signals or
                               another thread, and calling Python once more would break it
    regions, ports             the table of ports, and what of the bus it is about
    lines, line_room, traced, changed   the trace, a ring; lines so far, and how many there were after the last write
    until, most_cycles         when (ns), and after how many cycles, to call Python; cycles: so far
    lazy, ahead, quiet         whether the stage may stay behind the host, by how much (ns) it does, and up to when it may
    stopped, twice, call       nothing more happens; two threads were in at once; how to call Python
    sources, level             the interrupt controller's table, see stage.board.bus.interrupts, and the processor's level
    looked, on_lines, raised, watched   lines (bits) with a hook, and the highest level of these; sources that are pending, and the
                               highest level of all that may call
    due                        when (ns) the next timer is
    hooks, serving, called     the hooks that are being called, the last of them (plus one, 0: none); how many there were so far
    stack_low, stack_high      where the stack of the firmware's own thread is
    looks                      how many requests from other stacks Python is still called about
    meter, cost, rest          where the firmware counts what it computes, or 0; ps for each; ps left over
    irqs, acts                 of each chip: its IRQ, and the addresses (bits) at which a read changes it
    before, userdata, words    room for a copy of the state in userdata; where that is, and how long
    reached                    the stage's time (ns), for whoever sees nothing but this record
    devices, n_devices         DEVICE_TABLE
    answers                    which device's own code runs (plus one, 0: none)
    faults                     how many faults were accesses to windows
    journals, asks, asked ...  whether journals are kept; chips (bits) whose writes Python looks at; what Python is called about
"""

DEVICE_TABLE = record([(name, "i8") for name in "state access pulls line counts encoders n_encoders".split()])
"""A device on the bus: addresses of its state, of its functions (0: it has none, and Python is called for its cycles), of the time
(ns) from which it pulls the interrupt line, of the counts of its encoders, and of the ENCODER records of these."""
ENCODER = record([("axis", "i8"), ("counts", "f8"), ("zero", "f8")])
"""On which axis an encoder is; counts per joint unit; at which position it counts 0."""

IRQ = record([("axis", "i8"), ("bits", "i8")])
"""Of each chip: the outputs that pull the interrupt line (0: none), and as which axis' they are asked for."""


INSIDE = int(dict(HOST.fields or {})["inside"][1])
_call = called(None, "i8")
_access = called("i8", "i8", "i8", "i8", "i8", "i8", "i8")
_pulls = called("i8", "i8", "i8", "i8")


@hot
def stage_of(h):
    """The HANDLE that a HOST record begins with."""
    return array_at(h.own, 1, handle.HANDLE)[0]


@hot
def chip_of(h, chip):
    return chips(stage_of(h))[chip]


@hot
def now_of(h):
    """The host's time, ns."""
    return world(stage_of(h)).now + h.ahead


@hot
def enter(h):
    """True if no other request is being answered, which none will be then until `leave`."""
    return claim(h.own + INSIDE, ENGINE)


@hot
def leave(h):
    release(h.own + INSIDE, ENGINE)


@hot
def call_out(h, function, argument):
    """Call a function that may make requests. What it makes of the floating-point mode is its own."""
    leave(h)
    _call(function, (argument,))
    usual_float_mode()
    while not enter(h):  # another thread is inside, and soon out
        pass


@hot
def ask(h, reason):
    """Call Python about `reason`."""
    before, h.in_python = h.in_python, 1
    call_out(h, h.call, reason)
    h.in_python = before


@hot
def note(h, kind, port, value, seen):
    """A line of the trace about the cycle that has just ended. seen: the last line about a read of this port that may say
    it all, or -1. Returns the line's number."""
    if h.stopped:
        return -1
    now, lines = now_of(h), array_at(h.lines, h.line_room, CYCLE)
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
def journal(h, kind, chip, address, value):
    """What a cycle did to a chip, for its journal, in the order of the switches' edges."""
    if h.noted >= h.edge_room - clockwork(stage_of(h)).most_edges:  # the engine needs that much in any step
        ask(h, FULL)
    e = array_at(h.edges, h.edge_room, records.EDGE)[h.noted]
    c = chip_of(h, chip)
    e.now, e.clock, e.axis = now_of(h), cores.clock(c), cores.axis_of(c, 0)
    e.kind, e.a, e.b = kind, address, value
    h.noted += 1


@hot
def device_of(h, k):
    return array_at(h.devices, h.n_devices, DEVICE_TABLE)[k]


@hot
def _look_at_encoders(h, d):
    """The counts of the device's encoders at the host's time."""
    s = stage_of(h)
    qpos, qvel, axes = array_at(h.qpos, h.nq, REAL), array_at(h.qvel, h.nv, REAL), table(s)
    counts, encoders = array_at(d.counts, d.n_encoders, INTEGER), array_at(d.encoders, d.n_encoders, ENCODER)
    tau = float(now_of(h) - world(s).start) / records.SECOND - clockwork(s).half
    for k in range(d.n_encoders):
        e = encoders[k]
        t = axes[e.axis]
        counts[k] = int(floor((qpos[t.qpos] + qvel[t.dof] * tau - e.zero) * e.counts + 0.5))


@hot
def at_device(h, k, n, way, value):
    """A cycle reaches port `n` of device `k`; the answer. Of one in Python the stage has caught up with the host."""
    if h.stopped:
        return 0xFFFF
    d = device_of(h, k)
    if d.access == 0:
        h.asked_chip, h.asked_address, h.asked_way, h.asked = k, n, way, value
        ask(h, DEVICE_CALLED)
        h.quiet = 0
        return h.asked
    if d.n_encoders:
        _look_at_encoders(h, d)
    h.answers = k + 1
    found = _access(d.access, (d.state, now_of(h), d.counts, n, way, value))
    h.answers = 0
    return found


@hot
def devices_pulling(h):
    """The devices that pull the interrupt line, a bit each."""
    found = 0
    for k in range(h.n_devices):
        d = device_of(h, k)
        on = array_at(d.line, 1, INTEGER)[0] <= now_of(h)
        if d.pulls and not on:
            if d.n_encoders:
                _look_at_encoders(h, d)
            h.answers = k + 1
            on = _pulls(d.pulls, (d.state, now_of(h), d.counts)) != 0
            h.answers = 0
        if on:
            found |= 1 << k
    return found
