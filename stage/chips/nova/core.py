"""NOVA chips, compiled: `run` jumps from event to event, never clock by clock; in between, pulses follow in closed form.

An event is the end of a drive or of a piece of its profile, a counter that reaches something, an input that comes through its
filter, a timer, or a bus write. See drive.py for one axis' drive, profile.py for when its pulses begin,
trace.py for a trace of them.
"""

from __future__ import annotations

from stage.chips.cores import through
from stage.chips.nova import state
from stage.chips.nova.bus import mcx300 as bus304
from stage.chips.nova.bus import mcx514 as bus514
from stage.chips.nova.bus.common import busy as driving
from stage.chips.nova.bus.common import lowest, phase_bits
from stage.chips.nova.functions import comparators, encoder, external, home, sync
from stage.chips.nova.functions import inputs as pins_in
from stage.chips.nova.functions import io as ports
from stage.chips.nova.interpolation import multichip
from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.motion import drive
from stage.chips.nova.motion import trace as pulses
from stage.chips.nova.motion.profile import speed_at
from stage.chips.nova.motion.pulse_output import half_period, levels, pulse_end, resting_levels
from stage.chips.nova.motion.trace import ROOM, stop_at, write_edge
from stage.chips.nova.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, greatest, hot, least

ROUNDS = 100  # of events that cause others at one clock
HZ = 16_000_000

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "inputs", "mark", "drive_input", "net",
           "outputs", "peek", "power_up", "pulse_rate", "read", "run", "scan", "scan_shaft", "set_shaft",
           "set_input", "status", "trace",
           "value", "write"]  # fmt: skip


@exported(None, STATE)
def _settle(c):
    """Everything that is due at the present clock; then when the next event is."""
    if c.fed:
        encoder.see(c)
    for j in range(c.axes):
        c.ax[j].acted = 0
    for _ in range(ROUNDS):
        c.stale = 0
        at = pins_in.follow_emergency(c)
        for j in range(c.axes):
            x = c.ax[j]
            at = least(at, pins_in.follow(c, x))
            drive.look(c, x)
            drive.obey_inputs(c, x)
            external.step(c, x)
            if x.go:
                home.go(c, x)
            home.step(c, x)
        interpolation.step(c)
        for j in range(c.axes):
            sync.step(c, j)
        if not c.stale:
            break
    c.stale = 0
    for j in range(c.axes):
        x = c.ax[j]
        at = least(at, home.next_event(c, x))
        at = least(at, sync.next_event(c, x))
        if x.driving:
            at = least(at, drive.next_event(c, x, sync.pulses_ahead(c, x)))
        if encoder.fed(c, j) and comparators.looks_at_rp(c, x):
            at = least(at, comparators.next_of_rp(c, x))
    if c.interpolating:
        at = least(at, interpolation.next_event(c))
    c.quiet = greatest(at, c.clock + 1)


@hot
def _pass(c, until):
    """Let time pass; nothing happens but pulses. An interpolation can end it early, with a tick that somebody has to look at."""
    if c.interpolating:
        until = interpolation.move(c, until)
    _drive(c, until)


@hot
def _drive(c, until):
    """Let the drives of single axes, and the clock, come to `until`."""
    for j in range(c.axes):
        if c.ax[j].driving:
            drive.move(c, c.ax[j], until)
    c.clock = until


@exported(None, STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`. Whoever looks at the chip afterwards finds its counters as they are then, and nothing
    to be done: so observing changes no bit."""
    if c.stale:
        _settle(c)
    while c.clock < until:
        _pass(c, least(until, c.quiet))
        if c.stale or c.clock >= c.quiet:
            _settle(c)
    if c.fed:
        encoder.see(c)


# --- the functions for a stage, see stage/chips/cores.py ---


@exported("i8", STATE, "i8")
def net(c, j):
    """Pulses ever begun, plus minus minus."""
    return c.ax[j].net


@exported("i8", STATE, "i8")
def counter(c, j):
    """The logical position counter LP."""
    return c.ax[j].reg[state.LP]


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Put the encoder of axis `j` at `count + rate * (clock - now)` from now on."""
    encoder.set_shaft(c, j, count, rate)
    if comparators.looks_at_rp(c, c.ax[j]):
        _settle(c)


@exported("i8", STATE, "i8")
def inputs(c, j):
    """Input pins of axis `j`, see INPUTS; of the whole chip, see COMMON_INPUTS, where j is one more than its last."""
    return c.emg if j == c.axes else c.ax[j].inputs


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Set the input pins, see `inputs`, but for those of an encoder. They act at once, so that it does not matter who looks at the
    chip meanwhile."""
    if j == c.axes:
        c.emg = word
    else:
        if encoder.fed(c, j):
            word = word & ~encoder.PINS | c.ax[j].inputs & encoder.PINS
        c.ax[j].inputs = word
    _settle(c)


@exported("i8", STATE)
def says(c):
    """Return what the chip drives onto the wires to others, see stage/chips/links.py."""
    if c.stale:
        _settle(c)
    return multichip.says(c)


@exported("i8", STATE)
def silent(c):
    """The clock up to which that does not change."""
    return multichip.silent(c)


@exported("i8", STATE)
def heard(c):
    """Return the word that the wires brought last."""
    return c.heard


@exported(None, STATE, "i8")
def hear_wires(c, word):
    """Bring the chip a new word from the wires to other chips."""
    if c.stale:
        _settle(c)
    multichip.hear(c, word, _settle)


@exported("i8", STATE, "i8")
def status(c, j):
    """RR0."""
    return read_word(c, 0)


@exported("i8", STATE, "i8")
def peek(c, address):
    """RR0 to RR7 as they read, without what reading does."""
    x = c.ax[lowest(c)]
    factors, compared = x.factors, x.compared
    word = read_word(c, address)
    x.factors, x.compared = factors, compared
    return word


@exported("i8", STATE, "i8")
def busy(c, j):
    """n-DRV of RR0."""
    return driving(c.ax[j])


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Output pins of axis `j`, see OUTPUTS."""
    if j == c.axes:
        return _interrupts(c)
    x = c.ax[j]
    return _other_outputs(c, j) | levels(c, x, c.clock < pulse_end(x))


@hot
def _other_outputs(c, j):
    """The output pins of axis `j` but those of its pulses."""
    x = c.ax[j]
    word = state.DRIVE if driving(x) else 0
    bits = phase_bits(c, c.ax[c.ip.main] if x.interpolates else x)
    word |= (state.ASND if bits & 1 else 0) | (state.CNST if bits & 2 else 0) | (state.DSND if bits & 4 else 0)
    word |= (state.DCC if c.clock < x.dcc else 0) | (state.SPLIT if x.split_on else 0)
    return word | ports.driven(c, j) * state.OUT


@hot
def _interrupts(c):
    """INT0N, INT1N: see COMMON_OUTPUTS."""
    return bus514.interrupts(c) | c.ip.interrupt << 1 if c.variant == state.MCX514_TYPE else bus304.interrupts(c)


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """Output frequency now, pulses per second."""
    x = c.ax[j]
    if x.interpolates:
        return interpolation.rate(c, j) * hz
    return speed_at(x, c.clock - x.origin) * hz if x.driving else 0.0


@exported("f8", STATE, "i8", "i8", "f8")
def drive_input(c, j, before, ticks):
    """Compute the mean over the last ticks of the net pulse count.

    Args:
        c: State of the chip.
        j: Axis of the chip.
        before: The value at the start of these ticks.
        ticks: Reference clocks.
    """
    x = c.ax[j]
    start, late, rest = c.clock - ticks, 0.0, x.net - before
    if x.since > start:
        late = float(x.moment - x.shift * start)
        rest -= x.shift
    _forget(x)
    return x.net - late / ticks - _missing(c, x, rest, ticks)


@hot
def _forget(x):
    """Drop the times of pulses that no mean can need any more."""
    x.moment = x.shift = x.since = 0


@hot
def _missing(c, x, rest, ticks):
    """Compute by how much the mean over the last `ticks` is less than the count now."""
    n = abs(rest)
    if n == 0:
        return 0.0
    if not x.driving:
        return 0.5 * rest
    s = drive.piece_at(x, c.clock - x.origin)
    t = (float(c.clock - x.origin) - x.t[s, 0]) - x.t[s, 1]
    r = x.p[s, 0] + t * (x.v[s, 0] + t * (x.a2[s, 0] + t * x.j6[s, 0])) + (x.from_pulse[s] - x.done)
    v = x.v[s, 0] + t * (2.0 * x.a2[s, 0] + 3.0 * t * x.j6[s, 0])
    if v <= 0.0:
        return 0.5 * rest
    ago = (n * greatest(r, 0.0) + 0.5 * n * (n - 1)) / v
    return (1.0 if rest > 0 else -1.0) * (n - least(ago / ticks, float(n)))


# --- the chip by itself ---


@hot
def _alone(c):
    """Time passed without a stage."""
    for j in range(c.axes):
        _forget(c.ax[j])


@hot
def write_word(c, address, value):
    if c.variant == state.MCX514_TYPE:
        bus514.write(c, address, value)
    else:
        bus304.write(c, address, value)


@hot
def read_word(c, address):
    return bus514.read(c, address) if c.variant == state.MCX514_TYPE else bus304.read(c, address)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """One bus write cycle: WR0 to WR7, or from 16 on a byte of them, where the high byte of WR0 waits for the low one."""
    value &= 0xFFFF
    if address < 16:
        write_word(c, address & 7, value)
    else:
        n, high = address >> 1 & 7, address & 1
        old = c.first if n == 0 else bus514.content(c, n)
        word = old & 0xFF | (value & 0xFF) << 8 if high else old & 0xFF00 | value & 0xFF
        if n == 0 and high:
            c.first = word
        else:
            write_word(c, n, word)
    if c.stale:
        _settle(c)


@exported("i8", STATE, "i8")
def read(c, address):
    """One bus read cycle: RR0 to RR7, or from 16 on a byte of them."""
    if address < 16:
        return read_word(c, address & 7)
    return read_word(c, address >> 1 & 7) >> (8 if address & 1 else 0) & 0xFF


@exported("i8", STATE, "i8", "i8")
def value(c, k, page):
    """Return what RRk reads as (of RR3 this page), without a bus cycle and what a read changes."""
    pages, c.pages = c.pages, 15 if page else 0
    word = peek(c, k)
    c.pages = pages
    return word


@exported(None, STATE, "i8", "i8")
def window(c, row, k):
    """Let the chip's clock run through the slices of a window, see stage/chips/cores.py."""
    through(c, row, k, run, net, drive_input)


@exported(None, STATE)
def power_up(c):
    """A cleared record becomes a chip that was just switched on."""
    if c.variant == state.MCX514_TYPE:
        bus514.reset(c)
    else:
        bus304.reset(c)
    _settle(c)


@exported("i8", STATE, "i8")
def advance(c, until):
    """Run up to clock `until`; returns the pulses begun, all axes."""
    before = c.total
    run(c, until)
    _alone(c)
    return c.total - before


@exported("i8", STATE, "i8", array_of(PULSE))
def trace(c, until, out):
    """Let the clock run as `advance` does, and fill `out` (PULSE records) with the pulses.

    Args:
        c: State of the chip.
        until: Clock at the end.
        out: PULSE records, as many as there will be pulses.

    Returns:
        The number of pulses.
    """
    k = 0
    if c.stale:
        _settle(c)
    while c.clock < until:
        stop, first = least(until, c.quiet), k
        if c.interpolating:
            stop, k = interpolation.trace(c, stop, out, k)
        k = pulses.log(c, stop, out, first, k)
        _drive(c, stop)
        if c.stale or c.clock >= c.quiet:
            _settle(c)
    if c.fed:
        encoder.see(c)
    _alone(c)
    return k


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def mark(c, axis, out, k):
    """Write the present state of the chip into an EDGE record.

    Args:
        c: State of the chip.
        axis: Axis of the chip.
        out: EDGE records.
        k: Number of the record.
    """
    write_edge(c, axis, out, k, outputs(c, axis), pulse_rate(c, axis, 1.0))


@hot
def _watched_outputs(c, j, every_pulse, off):
    """The output pins of axis `j`, whose present pulse goes off at clock `off`; without `every_pulse` as if there were none."""
    x = c.ax[j]
    return _other_outputs(c, j) | (levels(c, x, c.clock < off) if every_pulse else resting_levels(c, x))


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan(c, until, every_pulse, axis, out):
    """Let the clock run as `advance` does, and fill `out` (EDGE records) with every change of the axis' course.

    Args:
        c: State of the chip.
        until: Clock at the end.
        every_pulse: Include the edges of the pulse output.
        axis: Axis of the chip.
        out: EDGE records.

    Returns:
        The number of edges; where `out` is nearly full the chip stops early.
    """
    k = 0
    if c.stale:
        _settle(c)
    x = c.ax[axis]
    off = pulse_end(x)
    while c.clock < until and k < len(out) - ROOM:
        before, net_before, pins_before = _watched_outputs(c, axis, every_pulse, off), x.net, x.inputs
        rate = pulse_rate(c, axis, 1.0)
        stop = stop_at(c, axis, every_pulse, off, least(until, c.quiet))
        if every_pulse and c.interpolating:
            stop = least(stop, interpolation.next_tick(c))
        if every_pulse and encoder.fed(c, axis):
            stop = least(stop, encoder.next_edge(c, x))
        _pass(c, greatest(stop, c.clock + 1))
        if c.fed:
            encoder.see(c)
        if x.net != net_before:
            off = c.clock + half_period(speed_at(x, c.clock - x.origin)) if x.driving else x.high
        if c.stale or c.clock >= c.quiet:
            _settle(c)
        word = _watched_outputs(c, axis, every_pulse, off)
        now = pulse_rate(c, axis, 1.0)
        if word != before or now != rate or (every_pulse and (x.net != net_before or x.inputs != pins_before)):
            k = write_edge(c, axis, out, k, word if every_pulse else outputs(c, axis), now)
    _alone(c)
    return k


@exported(
    "i8", STATE, "i8", "i8", "i8", array_of(EDGE),
    array_of("i8"), array_of("i8"), array_of("f8"), array_of("f8"), array_of("i8"),
)  # fmt: skip
def scan_shaft(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done):
    """Scan while the shafts of axes move, see stage.chips.cores."""
    k = 0
    while k < len(out) - 2 * ROOM:
        n = done[0]
        while n < len(clocks) and clocks[n] <= c.clock and k < len(out) - 2 * ROOM:
            if axes[n] < 0:
                k = _hear(c, every_pulse, axis, out, k, -axes[n])
            else:
                set_shaft(c, axes[n], counts[n], rates[n])
            n += 1
        done[0] = n
        if n < len(clocks) and clocks[n] <= c.clock:
            return k
        if c.clock >= until:
            return k
        k += scan(c, least(clocks[n], until) if n < len(clocks) else until, every_pulse, axis, out[k:])
    return k


@hot
def _hear(c, every_pulse, axis, out, k, word):
    """Apply the word of the wires, which can make a pulse: note the edges that come of it."""
    x = c.ax[axis]
    before, net_before = _watched_outputs(c, axis, every_pulse, pulse_end(x)), x.net
    rate = pulse_rate(c, axis, 1.0)
    hear_wires(c, word)
    now = pulse_rate(c, axis, 1.0)
    word = _watched_outputs(c, axis, every_pulse, pulse_end(x))
    if word != before or now != rate or (every_pulse and x.net != net_before):
        k = write_edge(c, axis, out, k, outputs(c, axis), now)
    return k
