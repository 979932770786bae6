"""The functions of the NOVA chips for a stage, a host and a journal, compiled; see stage/chips/cores.py.

`run` jumps from event to event; between two events pulses follow in closed form. An event is the end of a drive or of a piece
of its profile, a counter that reaches a value that matters, an input that passes its filter, a timer, or a bus write. drive.py
has the drive of one axis, profile.py the clocks of its pulses, trace.py their order for a trace.
"""

from __future__ import annotations

from stage.chips.cores import run_window
from stage.chips.nova import state
from stage.chips.nova.bus import mcx300 as bus304
from stage.chips.nova.bus import mcx514 as bus514
from stage.chips.nova.bus.common import compute_phase_bits, find_lowest_axis
from stage.chips.nova.bus.common import is_busy as driving
from stage.chips.nova.functions import comparators, encoder, external, home, sync
from stage.chips.nova.functions import inputs as pins_in
from stage.chips.nova.functions import io as ports
from stage.chips.nova.interpolation import multichip
from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.motion import drive
from stage.chips.nova.motion import trace as pulses
from stage.chips.nova.motion.profile import compute_speed
from stage.chips.nova.motion.pulse_output import (
    compute_pulse_pins,
    compute_pulse_width,
    compute_resting_pins,
    find_pulse_end,
)
from stage.chips.nova.motion.trace import EDGE_MARGIN, find_scan_stop, write_edge
from stage.chips.nova.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, greatest, hot, least

MAX_ROUNDS = 100  # of events that cause others at one clock
HZ = 16_000_000

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "inputs", "mark", "drive_input", "net",
           "outputs", "peek", "power_up", "pulse_rate", "read", "run", "scan", "scan_shaft", "set_shaft",
           "set_input", "status", "trace",
           "value", "write"]  # fmt: skip


@exported(None, STATE)
def _settle(c):
    """Do everything that is due at the present clock, then find the clock of the next event."""
    if c.encoder_axes:
        encoder.follow_shafts(c)
    for j in range(c.axes):
        c.ax[j].finished_sets = 0
    for _ in range(MAX_ROUNDS):
        c.stale = 0
        at = pins_in.update_emergency(c)
        for j in range(c.axes):
            x = c.ax[j]
            at = least(at, pins_in.update_inputs(c, x))
            drive.check_drive(c, x)
            drive.apply_inputs(c, x)
            external.apply_pin_changes(c, x)
            if x.launch_direction:
                home.launch_step_drive(c, x)
            home.update_search(c, x)
        interpolation.update_interpolation(c)
        for j in range(c.axes):
            sync.run_due_sets(c, j)
        if not c.stale:
            break
    c.stale = 0
    for j in range(c.axes):
        x = c.ax[j]
        at = least(at, home.find_next_event(c, x))
        at = least(at, sync.find_next_event(c, x))
        if x.driving:
            at = least(at, drive.find_next_event(c, x, sync.count_pulses_to_event(c, x)))
        if encoder.has_encoder(c, j) and comparators.uses_rp(c, x):
            at = least(at, comparators.find_next_rp_change(c, x))
    if c.interpolating:
        at = least(at, interpolation.find_next_event(c))
    c.quiet_until = greatest(at, c.clock + 1)


@hot
def _advance_time(c, until):
    """Let time pass in which only pulses happen. A tick of an interpolation that causes an event ends it early."""
    if c.interpolating:
        until = interpolation.make_ticks(c, until)
    _advance_drives(c, until)


@hot
def _advance_drives(c, until):
    """Advance the clock, and the drives of single axes, to `until`."""
    for j in range(c.axes):
        if c.ax[j].driving:
            drive.begin_pulses_until(c, c.ax[j], until)
    c.clock = until


@exported(None, STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`.

    Afterwards the counters are up to date and nothing is due, so that reading them changes no bit of the state.
    """
    if c.stale:
        _settle(c)
    while c.clock < until:
        _advance_time(c, least(until, c.quiet_until))
        if c.stale or c.clock >= c.quiet_until:
            _settle(c)
    if c.encoder_axes:
        encoder.follow_shafts(c)


# --- the functions for a stage, see stage/chips/cores.py ---


@exported("i8", STATE, "i8")
def net(c, j):
    """Return the net number of pulses since power-up."""
    return c.ax[j].net


@exported("i8", STATE, "i8")
def counter(c, j):
    """Return the logical position counter LP."""
    return c.ax[j].reg[state.LP]


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Put the encoder of an axis at `count + rate * (clock - now)` from now on.

    Args:
        c: State of the chip.
        j: Number of the axis.
        count: Edges of the encoder.
        rate: Edges per reference clock.
    """
    encoder.set_shaft(c, j, count, rate)
    if comparators.uses_rp(c, c.ax[j]):
        _settle(c)


@exported("i8", STATE, "i8")
def inputs(c, j):
    """Return the input pins of axis `j`, bits of INPUTS; for the number after the last axis those of the chip, COMMON_INPUTS."""
    return c.emg_pin if j == c.axes else c.ax[j].inputs


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Set the input pins, except those of an encoder. They act at once, so that later reads change nothing.

    Args:
        c: State of the chip.
        j: Number of the axis, or the number after the last axis for pins of the chip.
        word: Bits of INPUTS or COMMON_INPUTS.
    """
    if j == c.axes:
        c.emg_pin = word
    else:
        if encoder.has_encoder(c, j):
            word = word & ~encoder.PINS | c.ax[j].inputs & encoder.PINS
        c.ax[j].inputs = word
    _settle(c)


@exported("i8", STATE)
def wire_output(c):
    """Return what the chip drives onto the wires to others, see stage/chips/links.py."""
    if c.stale:
        _settle(c)
    return multichip.compute_wire_output(c)


@exported("i8", STATE)
def wire_output_until(c):
    """The clock up to which that does not change."""
    return multichip.find_wire_change(c)


@exported("i8", STATE)
def wire_word(c):
    """Return the word that the wires brought last."""
    return c.wire_word


@exported(None, STATE, "i8")
def set_wire_word(c, word):
    """Bring the chip a new word from the wires to other chips."""
    if c.stale:
        _settle(c)
    multichip.apply_wire_word(c, word, _settle)


@exported("i8", STATE, "i8")
def status(c, j):
    """Return RR0."""
    return read_word(c, 0)


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return what a host would read at an address, without the side effects of a bus cycle."""
    x = c.ax[find_lowest_axis(c)]
    factors, compared = x.events, x.comparison_events
    word = read_word(c, address)
    x.events, x.comparison_events = factors, compared
    return word


@exported("i8", STATE, "i8")
def busy(c, j):
    """Return whether a drive is in progress, n-DRV of RR0."""
    return driving(c.ax[j])


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Return the output pins of axis `j`, bits of OUTPUTS; for the number after the last axis those of the chip, COMMON_OUTPUTS."""
    if j == c.axes:
        return _compute_interrupt_pins(c)
    x = c.ax[j]
    return _compute_other_outputs(c, j) | compute_pulse_pins(c, x, c.clock < find_pulse_end(x))


@hot
def _compute_other_outputs(c, j):
    """Compute the output pins of axis `j` except PLS and DIR."""
    x = c.ax[j]
    word = state.DRIVE if driving(x) else 0
    bits = compute_phase_bits(c, c.ax[c.ip.main_axis] if x.interpolates else x)
    word |= (state.ASND if bits & 1 else 0) | (state.CNST if bits & 2 else 0) | (state.DSND if bits & 4 else 0)
    word |= (state.DCC if c.clock < x.dcc_end else 0) | (state.SPLIT if x.split_output else 0)
    return word | ports.find_driven_outputs(c, j) * state.OUT


@hot
def _compute_interrupt_pins(c):
    """Compute INT0N and INT1N, bits of COMMON_OUTPUTS."""
    return (
        bus514.is_interrupt_asserted(c) | c.ip.interrupt << 1
        if c.variant == state.MCX514_TYPE
        else bus304.is_interrupt_asserted(c)
    )


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """Return the present output frequency in pulses per second.

    Args:
        c: State of the chip.
        j: Number of the axis.
        hz: Reference clock, Hz.
    """
    x = c.ax[j]
    if x.interpolates:
        return interpolation.compute_axis_rate(c, j) * hz
    return compute_speed(x, c.clock - x.origin) * hz if x.driving else 0.0


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
    if x.first_pulse_clock > start:
        late = float(x.pulse_clock_sum - x.recent_net * start)
        rest -= x.recent_net
    _clear_pulse_times(x)
    return x.net - late / ticks - _compute_mean_lag(c, x, rest, ticks)


@hot
def _clear_pulse_times(x):
    """Clear the times of interpolated pulses, which only the mean of the present slice needs."""
    x.pulse_clock_sum = x.recent_net = x.first_pulse_clock = 0


@hot
def _compute_mean_lag(c, x, rest, ticks):
    """Compute by how much the mean pulse count over the last ticks is less than the count now.

    Args:
        c: State of the chip.
        x: State of the axis.
        rest: Net number of pulses in these ticks, without interpolated ones.
        ticks: Reference clocks.
    """
    n = abs(rest)
    if n == 0:
        return 0.0
    if not x.driving:
        return 0.5 * rest
    s = drive.find_piece(x, c.clock - x.origin)
    t = (float(c.clock - x.origin) - x.t[s, 0]) - x.t[s, 1]
    r = x.p[s, 0] + t * (x.v[s, 0] + t * (x.a2[s, 0] + t * x.j6[s, 0])) + (x.from_pulse[s] - x.pulses_done)
    v = x.v[s, 0] + t * (2.0 * x.a2[s, 0] + 3.0 * t * x.j6[s, 0])
    if v <= 0.0:
        return 0.5 * rest
    ago = (n * greatest(r, 0.0) + 0.5 * n * (n - 1)) / v
    return (1.0 if rest > 0 else -1.0) * (n - least(ago / ticks, float(n)))


# --- the chip by itself ---


@hot
def _clear_all_pulse_times(c):
    """Clear the times of interpolated pulses of all axes, after a run without a stage."""
    for j in range(c.axes):
        _clear_pulse_times(c.ax[j])


@hot
def write_word(c, address, value):
    """Write a word to WR0 to WR7."""
    if c.variant == state.MCX514_TYPE:
        bus514.write_register(c, address, value)
    else:
        bus304.write_register(c, address, value)


@hot
def read_word(c, address):
    """Read a word of RR0 to RR7."""
    return bus514.read_register(c, address) if c.variant == state.MCX514_TYPE else bus304.read_register(c, address)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """Make a bus write cycle.

    Args:
        c: State of the chip.
        address: 0 to 7: a word of WRn; from 16 on: a byte. The high byte of WR0 waits for its low byte.
        value: The word or byte.
    """
    value &= 0xFFFF
    if address < 16:
        write_word(c, address & 7, value)
    else:
        n, high = address >> 1 & 7, address & 1
        old = c.command_high_byte if n == 0 else bus514.find_written_word(c, n)
        word = old & 0xFF | (value & 0xFF) << 8 if high else old & 0xFF00 | value & 0xFF
        if n == 0 and high:
            c.command_high_byte = word
        else:
            write_word(c, n, word)
    if c.stale:
        _settle(c)


@exported("i8", STATE, "i8")
def read(c, address):
    """Make a bus read cycle.

    Args:
        c: State of the chip.
        address: 0 to 7: a word of RRn; from 16 on: a byte.
    """
    if address < 16:
        return read_word(c, address & 7)
    return read_word(c, address >> 1 & 7) >> (8 if address & 1 else 0) & 0xFF


@exported("i8", STATE, "i8", "i8")
def value(c, k, page):
    """Return what RRk reads, without a bus cycle and its side effects.

    Args:
        c: State of the chip.
        k: Number of the register.
        page: Page of RR3, 0 or 1.
    """
    pages, c.status_pages = c.status_pages, 15 if page else 0
    word = peek(c, k)
    c.status_pages = pages
    return word


@exported(None, STATE, "i8", "i8")
def window(c, row, k):
    """Let the chip's clock run through the slices of a window, see stage/chips/cores.py."""
    run_window(c, row, k, run, net, drive_input)


@exported(None, STATE)
def power_up(c):
    """Make a cleared record the state of a chip that was just switched on."""
    if c.variant == state.MCX514_TYPE:
        bus514.reset_chip(c)
    else:
        bus304.reset_chip(c)
    _settle(c)


@exported("i8", STATE, "i8")
def advance(c, until):
    """Let the clock run up to `until`, and return the number of pulses that have begun on all axes."""
    before = c.total
    run(c, until)
    _clear_all_pulse_times(c)
    return c.total - before


@exported("i8", STATE, "i8", array_of(PULSE))
def trace(c, until, out):
    """Let the clock run as `advance` does, and write a PULSE record for each pulse.

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
        stop, first = least(until, c.quiet_until), k
        if c.interpolating:
            stop, k = interpolation.trace_ticks(c, stop, out, k)
        k = pulses.log_pulses(c, stop, out, first, k)
        _advance_drives(c, stop)
        if c.stale or c.clock >= c.quiet_until:
            _settle(c)
    if c.encoder_axes:
        encoder.follow_shafts(c)
    _clear_all_pulse_times(c)
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
def _compute_watched_outputs(c, j, every_pulse, off):
    """Compute the output pins that a scan watches.

    Args:
        c: State of the chip.
        j: Number of the axis.
        every_pulse: Include pulses; else PLS and DIR count as without a pulse.
        off: Clock at which the present pulse goes off.
    """
    x = c.ax[j]
    return _compute_other_outputs(c, j) | (
        compute_pulse_pins(c, x, c.clock < off) if every_pulse else compute_resting_pins(c, x)
    )


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan(c, until, every_pulse, axis, out):
    """Let the clock run as `advance` does, and write an EDGE record at each change of an axis.

    Args:
        c: State of the chip.
        until: Clock at the end.
        every_pulse: Include the edges of the pulse output.
        axis: Axis of the chip.
        out: EDGE records to fill.

    Returns:
        The number of records. If `out` is nearly full the chip stops early.
    """
    k = 0
    if c.stale:
        _settle(c)
    x = c.ax[axis]
    off = find_pulse_end(x)
    while c.clock < until and k < len(out) - EDGE_MARGIN:
        before, net_before, pins_before = _compute_watched_outputs(c, axis, every_pulse, off), x.net, x.inputs
        rate = pulse_rate(c, axis, 1.0)
        stop = find_scan_stop(c, axis, every_pulse, off, least(until, c.quiet_until))
        if every_pulse and c.interpolating:
            stop = least(stop, interpolation.find_next_tick(c))
        if every_pulse and encoder.has_encoder(c, axis):
            stop = least(stop, encoder.find_next_edge(c, x))
        _advance_time(c, greatest(stop, c.clock + 1))
        if c.encoder_axes:
            encoder.follow_shafts(c)
        if x.net != net_before:
            off = (
                c.clock + compute_pulse_width(compute_speed(x, c.clock - x.origin)) if x.driving else x.pulse_off_clock
            )
        if c.stale or c.clock >= c.quiet_until:
            _settle(c)
        word = _compute_watched_outputs(c, axis, every_pulse, off)
        now = pulse_rate(c, axis, 1.0)
        if word != before or now != rate or (every_pulse and (x.net != net_before or x.inputs != pins_before)):
            k = write_edge(c, axis, out, k, word if every_pulse else outputs(c, axis), now)
    _clear_all_pulse_times(c)
    return k


@exported(
    "i8", STATE, "i8", "i8", "i8", array_of(EDGE),
    array_of("i8"), array_of("i8"), array_of("f8"), array_of("f8"), array_of("i8"),
)  # fmt: skip
def scan_shaft(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done):
    """Scan while the shafts of axes move, see `stage.chips.cores.scan_shafts`."""
    k = 0
    while k < len(out) - 2 * EDGE_MARGIN:
        n = done[0]
        while n < len(clocks) and clocks[n] <= c.clock and k < len(out) - 2 * EDGE_MARGIN:
            if axes[n] < 0:
                k = _apply_wire_word(c, every_pulse, axis, out, k, -axes[n])
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
def _apply_wire_word(c, every_pulse, axis, out, k, word):
    """Apply a new word on the wires, and write an EDGE record if that changes the axis: the word can make a pulse.

    Args:
        c: State of the chip.
        every_pulse: Include the edges of the pulse output.
        axis: Axis of the chip.
        out: EDGE records.
        k: Number of the next record.
        word: The word.

    Returns:
        The number of the next record.
    """
    x = c.ax[axis]
    before, net_before = _compute_watched_outputs(c, axis, every_pulse, find_pulse_end(x)), x.net
    rate = pulse_rate(c, axis, 1.0)
    set_wire_word(c, word)
    now = pulse_rate(c, axis, 1.0)
    word = _compute_watched_outputs(c, axis, every_pulse, find_pulse_end(x))
    if word != before or now != rate or (every_pulse and x.net != net_before):
        k = write_edge(c, axis, out, k, outputs(c, axis), now)
    return k
