"""`HOST`: the record of a host on the board's bus, and what all its requests have in common. Compiled.

Where compiled code cannot continue by itself (a buffer is full, the firmware must be paused), it calls Python with one of the
reasons below.

A compiled device, shipped or in C, is two functions over its state, which get the time and the counts of its encoders:

    access(state, now, counts, n, kind, value) -> value     one cycle at its port `n`; kind: IN8, OUT8, IN16, OUT16
    pulls(state, now, counts) -> 1 if it pulls the interrupt line then; changes nothing
"""

from __future__ import annotations

from stage.chips import core_interface
from stage.native import array_at, declare_address_call, enter_usual_float_mode, floor, hot, record
from stage.sim import compiled_stage_access, engine_records
from stage.sim.compiled_stage_access import (
    ENGINE_CLAIM_TOKEN,
    INTEGER,
    REAL,
    claim,
    get_axis_table,
    get_chip_table,
    get_clockwork,
    get_world,
    release,
)

IN8, OUT8, IN16, OUT16, DELAY, MICROS, LOG, HOOK, LINE, SETTLE = range(10)
"""Requests of a host: port cycles (a: port, b: value), a delay (a: us), the time (us), a line for the log (a: its address), a
hook of the interrupt line (a: the function's address, b: its argument), whether the line is asserted, and that the stage
catches up."""
TIMER, ON_LINE, SPEND = 10, 11, 12
"""A timer, a hook of one interrupt source (a: the address of five int64: number, level, period in ns, hook, argument);
computing that takes time (a: ns, besides what the meter has counted)."""
IN32, OUT32, WINDOW, NO_CYCLE, BEYOND_WINDOW = range(13, 18)
"""Two cycles of 16 bits, the low half first; the address of a new window (a: its first port, b: how many). And, from the handler of
faults: that an instruction (a: its STEP) touches a window (b: where), but is no bus cycle, or goes beyond the window."""
LEVEL, RAISE = 18, 19
"""The processor's level (a; -1: unchanged), answered with the level before; a software interrupt (a: its number)."""
UNTIL = 20
"""Emulated processors: advance the board to a time (a: ns of the stage); if `b`, answer whether the interrupt line then is
asserted."""
SET_LINES, READ_LINES = 21, 22
"""Input pins of a chip, such as the STEP and DIR lines that a microcontroller drives, without a bus cycle: set the pins of a
mask (a: the chip's number; b: the mask, shifted left by LINES_SHIFT, and the levels), or read the word of all of them."""
LINES_SHIFT = 32
WITH_CYCLE = 1 << LINES_SHIFT
"""Added to the number of the chip in SET_LINES and READ_LINES: one bus cycle passes first."""
SEND_SERIAL, READ_SERIAL, SET_SERIAL_RATE = 23, 24, 25
"""A serial line (b: its number): send a byte (a); take a byte, look at it or count the bytes that have arrived (a: TAKE, PEEK or
COUNT), which takes a bus cycle if there is none; set the rate (a: bits per second, 0: bytes take no time)."""
TAKE, PEEK, COUNT = range(3)
WATCH_LINES = 26
"""Have the line of a chip (a) be asserted from now on while input pins of a mask (b) have other levels than now; answered with all
levels. A host acknowledges a change by the same request."""
NANOSECONDS = 27
"""The time (ns), without a bus cycle: for models of a microcontroller's timers in the firmware's own code."""
WRONG_LEVEL = 64
"""Added to a refused request whose level is out of range."""
(
    FULL, DIVERGED, PAUSE, STORM, LINE_OF_LOG, CHECK_WRITE, RUN_IN_PYTHON, COLLIDED, DEVICE_CALLED, REFUSED, ANOTHER_STACK,
) = range(1, 12)  # fmt: skip
"""Reasons to call Python: buffers are full; the physics has diverged; time or cycles are up; an interrupt that nothing clears;
a line for the log; a write that a fault of the bus may lose; time that compiled code alone may not let pass; two threads of the
firmware made requests at once; a cycle reaches a device that is written in Python; a request that makes no sense; a request
from another stack than that of the firmware's own thread."""
WINDOW_REQUEST = 20
"""Another reason: a request about a window."""
FROM_PYTHON = 64
"""Added to requests of a host in Python, which is told at once that another thread is inside."""
BUS_BUSY = -(1 << 62)
"""Answer to a request that another thread's request prevents."""
MAX_DELAY_US = 10**15
"""Maximum delay: longer ones would not fit into 63 bits of nanoseconds."""
STORM_CALLS = 1000
PAUSE_INTERVAL_NS = 10_000_000
"""Simulated time between two checks whether the firmware has to pause, so that Ctrl-C works in a long delay."""

LAST_PORT = 0xFFFFFFFF
NOTHING, BYTE, WORD, HALF, LATCH, LATCHED, PULLS, DEVICE = range(8)
EIGHT, WIDE, UPPER = range(3)
REGION = record([(name, "i8") for name in "first n at".split()])
"""`n` ports from port `first` on; `at`: index of the first of them in the table of ports."""
PORT = record([(name, "i8") for name in "kind chip address mask read_line".split()])
"""What a port reaches; the first entry of a table is what ports in no region reach: nothing. BYTE, WORD: an address of a chip of 8,
16 bits; HALF: the upper byte of the WORD one below; LATCH: takes the address for the chip's LATCHED, as much of it (`mask`) as
the chip does; PULLS: which chips pull the interrupt line, a bit each; DEVICE: the port `address` of the device `chip`, and `mask`
says what of it: EIGHT bits, a WIDE word of 16, the UPPER byte of the word one below. `read_line`: number of the trace's line about
its last read, plus one."""

IN, OUT, IN_WIDE, OUT_WIDE, CALLED, RETURNED = IN8, OUT8, IN16, OUT16, 4, 5
STRAY, WRITE_LOST, RAISED = 8, 16, 32
CYCLE = record([(name, "i8") for name in "first last count kind port value".split()])
"""A line of the trace: when (ns) the first and the last of `count` equal cycles ended, with no write between; kind, | STRAY if they
reached nothing, or only half of a register, | WRITE_LOST if a fault of the bus kept the write from its chip, | RAISED if the
device in Python that it reached raised an error."""

HOST = record(
    compiled_stage_access.HANDLE_FIELDS
    + [(name, "i8") for name in "inside in_python".split()]
    + [(name, "i8") for name in "regions n_regions ports n_ports trace_cycles trace_capacity traced changed".split()]
    + [(name, "i8") for name in "until lazy ahead quiet cycles max_cycles stopped collided call".split()]
    + [
        (name, "i8")
        for name in "sources level hooked_interrupt_mask hooked_interrupt_level n_pending top_level due".split()
    ]
    + [(name, "i8") for name in "hooks serving called stack_low stack_high stack_checks meter cost rest".split()]
    + [(name, "i8") for name in "irqs acts before userdata words journals".split()]
    + [(name, "i8") for name in "checked_chips call_chip call_address call_kind call_value reached".split()]
    + [(name, "i8") for name in "devices n_devices answers faults serial".split()]
)
"""A stage's handle, and
    inside                     whether a request is being answered, see compiled_stage_access.py; 0 while Python or a hook is called
    in_python                  whether Python is being called: what the firmware requests then comes from a handler of signals or
                               another thread, and calling Python once more would break it
    regions, ports             the table of ports
    trace_cycles, trace_capacity   the trace's circular buffer, and its size
    traced, changed            bus cycles in the trace so far, and those up to the last write
    until, max_cycles          when (ns), and after how many cycles, to call Python; cycles: so far
    lazy, ahead, quiet         whether the stage may stay behind the host, by how much (ns) it does, and up to when it may
    stopped, collided, call    nothing more happens; two threads were inside at once; how to call Python
    sources, level             the interrupt controller's table, see `interrupt_controller`, and the processor's level
    hooked_interrupt_mask      interrupt lines that have a hook
    hooked_interrupt_level     the highest level of these
    n_pending, top_level       sources that are pending, and the highest level of all that may call
    due                        when (ns) the next timer is
    hooks, serving, called     the hooks that are being called, the last of them (plus one, 0: none); number of calls so far
    stack_low, stack_high      where the stack of the firmware's own thread is
    stack_checks               how many requests from other stacks Python is still called about
    meter, cost, rest          where the firmware counts its basic blocks, or 0; ps for each; ps left over
    irqs, acts                 of each chip: its IRQ, and the addresses (bits) at which a read changes it
    before, userdata, words    room for a copy of the state in userdata; where that is, and how long
    journals                   whether journals are kept
    checked_chips              chips (bits) whose writes Python checks for faults of the bus
    call_chip ... call_value   what Python is called about, and what it answers
    reached                    the stage's time (ns), for whoever sees nothing but this record
    devices, n_devices         DEVICE_TABLE
    answers                    the device whose own code runs (plus one, 0: none)
    faults                     how many faults were accesses to windows
    serial                     the LINE of the serial line
"""

DEVICE_TABLE = record(
    [(name, "i8") for name in "state access pulls interrupt_start counts encoders n_encoders".split()]
)
"""A device on the bus: addresses of its state, of its functions (0: it has none, and Python is called for its cycles), of the time
(ns) from which it pulls the interrupt line, of the counts of its encoders, and of the ENCODER records of these."""
ENCODER = record([("axis", "i8"), ("counts", "f8"), ("zero", "f8")])
"""On which axis an encoder is; counts per joint unit; the position at which it counts 0."""

IRQ = record([(name, "i8") for name in "axis bits watched levels".split()])
"""The outputs of a chip that pull the interrupt line (0: none), and the axis as whose they are read; the input pins that pull it
while their levels are others than `levels`, see WATCH_LINES."""


INSIDE_OFFSET = int(dict(HOST.fields or {})["inside"][1])
_call_function = declare_address_call(None, "i8")
_call_access = declare_address_call("i8", "i8", "i8", "i8", "i8", "i8", "i8")
_call_pulls = declare_address_call("i8", "i8", "i8", "i8")


@hot
def get_stage_handle(host):
    """Return the HANDLE with which a HOST record begins."""
    return array_at(host.own, 1, compiled_stage_access.HANDLE)[0]


@hot
def get_chip(host, chip):
    """Return the record of the chip with this number."""
    return get_chip_table(get_stage_handle(host))[chip]


@hot
def get_now(host):
    """Return the time of the host in ns since power-up, which may be ahead of the stage's time."""
    return get_world(get_stage_handle(host)).now + host.ahead


@hot
def claim_board(host):
    """Claim the board for a request; return False if another request is being answered."""
    return claim(host.own + INSIDE_OFFSET, ENGINE_CLAIM_TOKEN)


@hot
def release_board(host):
    """Release the board at the end of a request."""
    release(host.own + INSIDE_OFFSET, ENGINE_CLAIM_TOKEN)


@hot
def call_host_function(host, function, argument):
    """Release the board while a function of the host runs, because the function may access the bus.

    Afterwards, claim the board again and restore the usual floating-point mode.

    Args:
        host: The HOST record.
        function: Address of the function.
        argument: Argument of the function.
    """
    release_board(host)
    _call_function(function, (argument,))
    enter_usual_float_mode()
    while not claim_board(host):  # another thread is inside, and soon out
        pass


@hot
def call_python(host, reason):
    """Let compiled code call Python for one of the reasons that this module defines, such as a full buffer."""
    before, host.in_python = host.in_python, 1
    call_host_function(host, host.call, reason)
    host.in_python = before


@hot
def append_to_trace(host, kind, port, value, same):
    """Append a bus cycle that has just ended to the trace.

    Args:
        host: The HOST record.
        kind: IN, OUT, ... with flags.
        port: Port of the cycle.
        value: Value that was read or written.
        same: Number of the row of an earlier read of this port, which counts the new cycle if the value is equal
            and no write came between; or -1.

    Returns:
        Number of the row of the trace.
    """
    if host.stopped:
        return -1
    now, cycles = get_now(host), array_at(host.trace_cycles, host.trace_capacity, CYCLE)
    if same >= host.changed and host.traced - same <= host.trace_capacity:
        cycle = cycles[same % host.trace_capacity]
        if cycle.value == value and cycle.kind == kind and cycle.port == port:
            cycle.last, cycle.count = now, cycle.count + 1
            return same
    cycle = cycles[host.traced % host.trace_capacity]
    cycle.first, cycle.last, cycle.count, cycle.kind, cycle.port, cycle.value = now, now, 1, kind, port, value
    host.traced += 1
    if kind & ~STRAY not in (IN, IN_WIDE):
        host.changed = host.traced
    return host.traced - 1


@hot
def append_to_journal(host, kind, chip, address, value):
    """Record a bus cycle that has reached a chip, in order with the edges of the switches, for the chip's journal."""
    # the engine needs room for `most_edges` in any step
    if host.noted >= host.edge_room - get_clockwork(get_stage_handle(host)).most_edges:
        call_python(host, FULL)
    e = array_at(host.edges, host.edge_room, engine_records.LOGGED_EDGE)[host.noted]
    c = get_chip(host, chip)
    e.now, e.clock, e.axis = get_now(host), core_interface.read_clock(c), core_interface.find_stage_axis(c, 0)
    e.kind, e.a, e.b = kind, address, value
    host.noted += 1


@hot
def get_device(host, index):
    """Return the DEVICE_TABLE record of device `index`."""
    return array_at(host.devices, host.n_devices, DEVICE_TABLE)[index]


@hot
def _read_encoders(host, device):
    """Compute the counts of the encoders that a device reads, at the host's time."""
    s = get_stage_handle(host)
    qpos, qvel, axes = array_at(host.qpos, host.nq, REAL), array_at(host.qvel, host.nv, REAL), get_axis_table(s)
    counts, encoders = (
        array_at(device.counts, device.n_encoders, INTEGER),
        array_at(device.encoders, device.n_encoders, ENCODER),
    )
    tau = float(get_now(host) - get_world(s).start) / engine_records.NS_PER_SECOND - get_clockwork(s).half
    for k in range(device.n_encoders):
        e = encoders[k]
        t = axes[e.axis]
        counts[k] = int(floor((qpos[t.qpos] + qvel[t.dof] * tau - e.zero) * e.counts + 0.5))


@hot
def access_device(host, device, register, kind, value):
    """Make a bus cycle at a register of a device, and return the answer.

    For a device in Python, the caller advances the stage first.

    Args:
        host: The HOST record.
        device: Index of the device.
        register: Number of the register.
        kind: IN8, OUT8, IN16 or OUT16.
        value: Value that is written.
    """
    if host.stopped:
        return 0xFFFF
    d = get_device(host, device)
    if d.access == 0:
        host.call_chip, host.call_address, host.call_kind, host.call_value = device, register, kind, value
        call_python(host, DEVICE_CALLED)
        host.quiet = 0
        return host.call_value
    if d.n_encoders:
        _read_encoders(host, d)
    host.answers = device + 1
    answer = _call_access(d.access, (d.state, get_now(host), d.counts, register, kind, value))
    host.answers = 0
    return answer


@hot
def find_interrupting_devices(host):
    """Return a bit mask of the devices that pull the interrupt line."""
    pulling = 0
    for k in range(host.n_devices):
        d = get_device(host, k)
        on = array_at(d.interrupt_start, 1, INTEGER)[0] <= get_now(host)
        if d.pulls and not on:
            if d.n_encoders:
                _read_encoders(host, d)
            host.answers = k + 1
            on = _call_pulls(d.pulls, (d.state, get_now(host), d.counts)) != 0
            host.answers = 0
        if on:
            pulling |= 1 << k
    return pulling
