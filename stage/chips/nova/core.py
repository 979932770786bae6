"""Core of the NOVA chips, compiled: the functions that stages, hosts and journals call, see stage/chips/core_interface.py.

`run` jumps from event to event; between two events the pulses are computed in closed form. An event is the end of a drive or of a
piece of its profile, a counter that reaches a compared value, an input that passes its filter, the end of a timer, or a bus write.
single_axis_drive.py has the drive of one axis, profile_evaluation.py the clocks of its pulses, pulse_trace.py their order for a
trace.
"""

from __future__ import annotations

from stage.chips.core_interface import run_slices
from stage.chips.nova import state
from stage.chips.nova.bus import mcx300 as bus304
from stage.chips.nova.bus import mcx514 as bus514
from stage.chips.nova.bus.parameters import find_lowest_axis
from stage.chips.nova.functions import comparators, encoder, external_drives, home_search, synchronous_actions
from stage.chips.nova.functions import general_ports as ports
from stage.chips.nova.functions import input_pins as pins_in
from stage.chips.nova.interpolation import interpolator as interpolation
from stage.chips.nova.interpolation import multichip
from stage.chips.nova.motion import pulse_trace, single_axis_drive
from stage.chips.nova.motion.drive_phases import compute_ramp_phase_bits, is_axis_busy
from stage.chips.nova.motion.profile_evaluation import compute_speed
from stage.chips.nova.motion.pulse_output import (
    compute_pulse_pins,
    compute_pulse_width,
    compute_resting_pins,
    find_pulse_end,
)
from stage.chips.nova.motion.pulse_trace import SPARE_EDGE_RECORDS, find_scan_stop, write_edge
from stage.chips.nova.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, greatest, hot, least

MAX_ROUNDS = 100  # of events that cause others at one clock
HZ = 16_000_000

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE"]


@exported(None, STATE)
def _process_due_events(chip):
    """Process all events that are due at the present clock, and find the clock of the next event."""
    if chip.encoder_axes:
        encoder.update_encoder_inputs(chip)
    for j in range(chip.axes):
        chip.ax[j].finished_sets = 0
    for _ in range(MAX_ROUNDS):
        chip.stale = 0
        at = pins_in.update_emergency_input(chip)
        for j in range(chip.axes):
            axis = chip.ax[j]
            at = least(at, pins_in.update_inputs(chip, axis))
            single_axis_drive.update_drive(chip, axis)
            single_axis_drive.apply_inputs(chip, axis)
            external_drives.apply_pin_changes(chip, axis)
            if axis.launch_direction:
                home_search.launch_search_step_drive(chip, axis)
            home_search.update_search(chip, axis)
        interpolation.update_interpolation(chip)
        for j in range(chip.axes):
            synchronous_actions.run_due_synchronous_actions(chip, j)
        if not chip.stale:
            break
    chip.stale = 0
    for j in range(chip.axes):
        axis = chip.ax[j]
        at = least(at, home_search.find_next_event(chip, axis))
        at = least(at, synchronous_actions.find_next_event(chip, axis))
        if axis.driving:
            at = least(
                at, single_axis_drive.find_next_event(chip, axis, synchronous_actions.count_pulses_to_event(chip, axis))
            )
        if encoder.has_encoder(chip, j) and comparators.uses_real_position_counter(chip, axis):
            at = least(at, comparators.find_next_rp_comparison_change(chip, axis))
    if chip.interpolating:
        at = least(at, interpolation.find_next_event(chip))
    chip.quiet_until = greatest(at, chip.clock + 1)


@hot
def _advance_time(chip, until):
    """Advance the clock to `until`, with nothing but pulses. A tick of an interpolation that causes an event ends this early."""
    if chip.interpolating:
        until = interpolation.make_interpolation_ticks(chip, until)
    _advance_drives(chip, until)


@hot
def _advance_drives(chip, until):
    """Advance the clock of the NOVA chip, and the drives of single axes, to clock `until`."""
    for j in range(chip.axes):
        if chip.ax[j].driving:
            single_axis_drive.begin_pulses_until(chip, chip.ax[j], until)
    chip.clock = until


@exported(None, STATE, "i8")
def run(chip, until):
    """Let the chip's clock run up to `until`.

    Afterwards the counters are up to date and no event is due, so that a read of a counter changes no bit of the state.
    """
    if chip.stale:
        _process_due_events(chip)
    while chip.clock < until:
        _advance_time(chip, least(until, chip.quiet_until))
        if chip.stale or chip.clock >= chip.quiet_until:
            _process_due_events(chip)
    if chip.encoder_axes:
        encoder.update_encoder_inputs(chip)


# --- the functions for a stage, see stage/chips/core_interface.py ---


@exported("i8", STATE, "i8")
def read_net_count(chip, axis_index):
    """Return the net number of pulses (plus less minus) of the axis since power-up."""
    return chip.ax[axis_index].net


@exported("i8", STATE, "i8")
def read_counter(chip, axis_index):
    """Return LP, the logical position counter of the axis."""
    return chip.ax[axis_index].reg[state.LP]


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(chip, axis_index, count, rate):
    """Put the encoder of an axis at `count + rate * (clock - now)` from now on.

    Args:
        chip: State of the chip.
        axis_index: Number of the axis.
        count: Edges of the encoder.
        rate: Edges per reference clock.
    """
    encoder.set_shaft(chip, axis_index, count, rate)
    if comparators.uses_real_position_counter(chip, chip.ax[axis_index]):
        _process_due_events(chip)


@exported("i8", STATE, "i8")
def read_inputs(chip, axis_index):
    """Return the input pins of an axis, bits of INPUTS.

    If `axis_index` is the number of axes, return the input pins that all axes share, bits of COMMON_INPUTS.
    """
    return chip.emg_pin if axis_index == chip.axes else chip.ax[axis_index].inputs


@exported(None, STATE, "i8", "i8")
def set_input(chip, axis_index, word):
    """Set the input pins, except those of an encoder. They act at once, so that later reads change nothing.

    Args:
        chip: State of the chip.
        axis_index: Number of the axis, or the number after the last axis for pins of the chip.
        word: Bits of INPUTS or COMMON_INPUTS.
    """
    if axis_index == chip.axes:
        chip.emg_pin = word
    else:
        if encoder.has_encoder(chip, axis_index):
            word = word & ~encoder.PINS | chip.ax[axis_index].inputs & encoder.PINS
        chip.ax[axis_index].inputs = word
    _process_due_events(chip)


@exported("i8", STATE)
def read_wire_output(chip):
    """Return the word that the chip drives onto the wires to other chips, see stage/chips/linked_chips.py."""
    if chip.stale:
        _process_due_events(chip)
    return multichip.compute_wire_output(chip)


@exported("i8", STATE)
def find_wire_output_end(chip):
    """Return the clock up to which `read_wire_output` does not change."""
    return multichip.find_wire_change(chip)


@exported("i8", STATE)
def read_wire_word(chip):
    """Return the last word that the chip received from the wires to other chips."""
    return chip.wire_word


@exported(None, STATE, "i8")
def set_wire_word(chip, word):
    """Pass the chip a new word from the wires to other chips."""
    if chip.stale:
        _process_due_events(chip)
    multichip.apply_wire_word(chip, word, _process_due_events)


@exported("i8", STATE, "i8")
def read_status(chip, axis_index):
    """Return RR0, the main status of the NOVA chip."""
    return read_word(chip, 0)


@exported("i8", STATE, "i8")
def peek(chip, address):
    """Return what a host would read at an address, without the side effects of a bus cycle."""
    axis = chip.ax[find_lowest_axis(chip)]
    factors, compared = axis.events, axis.comparison_events
    word = read_word(chip, address)
    axis.events, axis.comparison_events = factors, compared
    return word


@exported("i8", STATE, "i8")
def is_busy(chip, axis_index):
    """Return whether the axis has a drive in progress, bit n-DRV of RR0."""
    return is_axis_busy(chip.ax[axis_index])


@exported("i8", STATE, "i8")
def read_outputs(chip, axis_index):
    """Return the output pins of an axis, bits of OUTPUTS.

    If `axis_index` is the number of axes, return the output pins that all axes share, bits of COMMON_OUTPUTS.
    """
    if axis_index == chip.axes:
        return _compute_interrupt_pins(chip)
    axis = chip.ax[axis_index]
    return _compute_other_outputs(chip, axis_index) | compute_pulse_pins(chip, axis, chip.clock < find_pulse_end(axis))


@hot
def _compute_other_outputs(chip, axis_index):
    """Compute the levels of all output pins of axis `axis_index` except PLS and DIR."""
    axis = chip.ax[axis_index]
    word = state.DRIVE if is_axis_busy(axis) else 0
    bits = compute_ramp_phase_bits(chip, chip.ax[chip.ip.main_axis] if axis.interpolates else axis)
    word |= (state.ASND if bits & 1 else 0) | (state.CNST if bits & 2 else 0) | (state.DSND if bits & 4 else 0)
    word |= (state.DCC if chip.clock < axis.dcc_end else 0) | (state.SPLIT if axis.split_output else 0)
    return word | ports.compute_driven_levels(chip, axis_index) * state.OUT


@hot
def _compute_interrupt_pins(chip):
    """Compute INT0N and INT1N, bits of COMMON_OUTPUTS."""
    return (
        bus514.is_interrupt_asserted(chip) | chip.ip.interrupt << 1
        if chip.variant == state.MCX514_TYPE
        else bus304.is_interrupt_asserted(chip)
    )


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(chip, axis_index, clock_hz):
    """Return the present output frequency in pulses per second.

    Args:
        chip: State of the chip.
        axis_index: Number of the axis.
        clock_hz: Reference clock, Hz.
    """
    axis = chip.ax[axis_index]
    if axis.interpolates:
        return interpolation.compute_axis_rate(chip, axis_index) * clock_hz
    return compute_speed(axis, chip.clock - axis.origin) * clock_hz if axis.driving else 0.0


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(chip, axis_index, net_before, clocks):
    """Compute the mean of the net pulse count over the last `clocks` reference clocks.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip.
        net_before: Net pulse count at the start of these clocks.
        clocks: Number of reference clocks.
    """
    axis = chip.ax[axis_index]
    start, late, rest = chip.clock - clocks, 0.0, axis.net - net_before
    if axis.first_pulse_clock > start:
        late = float(axis.pulse_clock_sum - axis.recent_net * start)
        rest -= axis.recent_net
    _clear_pulse_times(axis)
    return axis.net - late / clocks - _compute_mean_lag(chip, axis, rest, clocks)


@hot
def _clear_pulse_times(axis):
    """Clear the times of an axis' interpolated pulses, which are needed only for the mean count of the present slice."""
    axis.pulse_clock_sum = axis.recent_net = axis.first_pulse_clock = 0


@hot
def _compute_mean_lag(chip, axis, even_pulses, clocks):
    """Compute the difference between the present pulse count and its mean over the last `clocks` reference clocks.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        even_pulses: Net number of pulses in these clocks, without those of an interpolation.
        clocks: Number of reference clocks.
    """
    n = abs(even_pulses)
    if n == 0:
        return 0.0
    if not axis.driving:
        return 0.5 * even_pulses
    s = single_axis_drive.find_piece(axis, chip.clock - axis.origin)
    t = (float(chip.clock - axis.origin) - axis.t[s, 0]) - axis.t[s, 1]
    r = (
        axis.p[s, 0]
        + t * (axis.v[s, 0] + t * (axis.a2[s, 0] + t * axis.j6[s, 0]))
        + (axis.from_pulse[s] - axis.pulses_done)
    )
    v = axis.v[s, 0] + t * (2.0 * axis.a2[s, 0] + 3.0 * t * axis.j6[s, 0])
    if v <= 0.0:
        return 0.5 * even_pulses
    ago = (n * greatest(r, 0.0) + 0.5 * n * (n - 1)) / v
    return (1.0 if even_pulses > 0 else -1.0) * (n - least(ago / clocks, float(n)))


# --- the chip by itself ---


@hot
def _clear_all_pulse_times(chip):
    """Clear the times of interpolated pulses of all axes, after a run without a stage."""
    for j in range(chip.axes):
        _clear_pulse_times(chip.ax[j])


@hot
def write_word(chip, address, value):
    """Write a word to one of the registers WR0 to WR7."""
    if chip.variant == state.MCX514_TYPE:
        bus514.write_register(chip, address, value)
    else:
        bus304.write_register(chip, address, value)


@hot
def read_word(chip, address):
    """Read a word from one of the registers RR0 to RR7."""
    return (
        bus514.read_register(chip, address)
        if chip.variant == state.MCX514_TYPE
        else bus304.read_register(chip, address)
    )


@exported(None, STATE, "i8", "i8")
def write(chip, address, value):
    """Make a bus write cycle.

    Args:
        chip: State of the chip.
        address: 0 to 7: a word of WRn; from 16 on: a byte. The high byte of WR0 waits for its low byte.
        value: The word or byte.
    """
    value &= 0xFFFF
    if address < 16:
        write_word(chip, address & 7, value)
    else:
        n, high = address >> 1 & 7, address & 1
        old = chip.command_high_byte if n == 0 else bus514.find_written_word(chip, n)
        word = old & 0xFF | (value & 0xFF) << 8 if high else old & 0xFF00 | value & 0xFF
        if n == 0 and high:
            chip.command_high_byte = word
        else:
            write_word(chip, n, word)
    if chip.stale:
        _process_due_events(chip)


@exported("i8", STATE, "i8")
def read(chip, address):
    """Make a bus read cycle.

    Args:
        chip: State of the chip.
        address: 0 to 7: a word of RRn; from 16 on: a byte.
    """
    if address < 16:
        return read_word(chip, address & 7)
    return read_word(chip, address >> 1 & 7) >> (8 if address & 1 else 0) & 0xFF


@exported("i8", STATE, "i8", "i8")
def read_register_value(chip, register_number, page):
    """Return the value that a host would read from an RR register, without the side effects of a bus cycle.

    Args:
        chip: State of the chip.
        register_number: Number of the register.
        page: Page of RR3, 0 or 1.
    """
    pages, chip.status_pages = chip.status_pages, 15 if page else 0
    word = peek(chip, register_number)
    chip.status_pages = pages
    return word


@exported(None, STATE, "i8", "i8")
def run_window(chip, row_address, first_slice):
    """Let the chip's clock run through a window, the time of one physics step, from slice `first_slice` on.

    Args:
        chip: State of the chip.
        row_address: Address of the chip's row in the table of chips, see stage/chips/core_interface.py.
        first_slice: First slice to run, from 0; a slice is an eighth of a window.
    """
    run_slices(chip, row_address, first_slice, run, read_net_count, compute_drive_input)


@exported(None, STATE)
def power_up(chip):
    """Make a cleared record the state of a chip that was just switched on."""
    if chip.variant == state.MCX514_TYPE:
        bus514.reset_chip(chip)
    else:
        bus304.reset_chip(chip)
    _process_due_events(chip)


@exported("i8", STATE, "i8")
def advance(chip, until):
    """Let the clock run up to `until`, and return the number of pulses that have begun on all axes."""
    before = chip.total
    run(chip, until)
    _clear_all_pulse_times(chip)
    return chip.total - before


@exported("i8", STATE, "i8", array_of(PULSE))
def trace_pulses(chip, until, edges):
    """Let the clock run as `advance` does, and write a PULSE record for each pulse.

    Args:
        chip: State of the chip.
        until: Clock at the end.
        edges: PULSE records, as many as there will be pulses.

    Returns:
        The number of pulses.
    """
    k = 0
    if chip.stale:
        _process_due_events(chip)
    while chip.clock < until:
        stop, first = least(until, chip.quiet_until), k
        if chip.interpolating:
            stop, k = interpolation.trace_interpolation_ticks(chip, stop, edges, k)
        k = pulse_trace.log_pulses(chip, stop, edges, first, k)
        _advance_drives(chip, stop)
        if chip.stale or chip.clock >= chip.quiet_until:
            _process_due_events(chip)
    if chip.encoder_axes:
        encoder.update_encoder_inputs(chip)
    _clear_all_pulse_times(chip)
    return k


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def write_present_edge(chip, axis_index, edges, edge_index):
    """Write the present state of the chip into an EDGE record.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip.
        edges: EDGE records.
        edge_index: Number of the record.
    """
    write_edge(
        chip, axis_index, edges, edge_index, read_outputs(chip, axis_index), read_pulse_rate(chip, axis_index, 1.0)
    )


@hot
def _compute_watched_outputs(chip, axis_index, every_pulse, pulse_end):
    """Compute the output pins that a scan watches.

    Args:
        chip: State of the chip.
        axis_index: Number of the axis.
        every_pulse: Whether to include pulses; otherwise PLS and DIR have the levels between two pulses.
        pulse_end: Clock at which the present pulse goes off.
    """
    axis = chip.ax[axis_index]
    return _compute_other_outputs(chip, axis_index) | (
        compute_pulse_pins(chip, axis, chip.clock < pulse_end) if every_pulse else compute_resting_pins(chip, axis)
    )


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan_edges(chip, until, every_pulse, axis_index, edges):
    """Let the clock run as `advance` does, and write an EDGE record at each change of an axis.

    Args:
        chip: State of the chip.
        until: Clock at the end.
        every_pulse: Include the edges of the pulse output.
        axis_index: Axis of the chip.
        edges: EDGE records to fill.

    Returns:
        The number of records. If `edges` is nearly full the chip stops early.
    """
    k = 0
    if chip.stale:
        _process_due_events(chip)
    axis = chip.ax[axis_index]
    off = find_pulse_end(axis)
    while chip.clock < until and k < len(edges) - SPARE_EDGE_RECORDS:
        before = _compute_watched_outputs(chip, axis_index, every_pulse, off)
        net_before = axis.net
        pins_before = axis.inputs
        rate = read_pulse_rate(chip, axis_index, 1.0)
        stop = find_scan_stop(chip, axis_index, every_pulse, off, least(until, chip.quiet_until))
        if every_pulse and chip.interpolating:
            stop = least(stop, interpolation.find_next_tick(chip))
        if every_pulse and encoder.has_encoder(chip, axis_index):
            stop = least(stop, encoder.find_next_edge(chip, axis))
        _advance_time(chip, greatest(stop, chip.clock + 1))
        if chip.encoder_axes:
            encoder.update_encoder_inputs(chip)
        if axis.net != net_before:
            off = (
                chip.clock + compute_pulse_width(compute_speed(axis, chip.clock - axis.origin))
                if axis.driving
                else axis.pulse_off_clock
            )
        if chip.stale or chip.clock >= chip.quiet_until:
            _process_due_events(chip)
        word = _compute_watched_outputs(chip, axis_index, every_pulse, off)
        now = read_pulse_rate(chip, axis_index, 1.0)
        if word != before or now != rate or (every_pulse and (axis.net != net_before or axis.inputs != pins_before)):
            k = write_edge(chip, axis_index, edges, k, word if every_pulse else read_outputs(chip, axis_index), now)
    _clear_all_pulse_times(chip)
    return k


@exported(
    "i8", STATE, "i8", "i8", "i8", array_of(EDGE),
    array_of("i8"), array_of("i8"), array_of("f8"), array_of("f8"), array_of("i8"),
)  # fmt: skip
def scan_edges_and_shafts(chip, until, every_pulse, axis_index, edges, clocks, axes, counts, rates, done):
    """Write the edges of an axis while encoder shafts move, see `stage.chips.core_interface.scan_while_shafts_move`."""
    k = 0
    while k < len(edges) - 2 * SPARE_EDGE_RECORDS:
        n = done[0]
        while n < len(clocks) and clocks[n] <= chip.clock and k < len(edges) - 2 * SPARE_EDGE_RECORDS:
            if axes[n] < 0:
                k = _apply_wire_word(chip, every_pulse, axis_index, edges, k, -axes[n])
            else:
                set_shaft(chip, axes[n], counts[n], rates[n])
            n += 1
        done[0] = n
        if n < len(clocks) and clocks[n] <= chip.clock:
            return k
        if chip.clock >= until:
            return k
        k += scan_edges(chip, least(clocks[n], until) if n < len(clocks) else until, every_pulse, axis_index, edges[k:])
    return k


@hot
def _apply_wire_word(chip, every_pulse, axis_index, edges, edge_index, word):
    """Apply a new word from the wires to other chips, and write an EDGE record if it changes the axis, for example by a pulse.

    Args:
        chip: State of the chip.
        every_pulse: Include the edges of the pulse output.
        axis_index: Axis of the chip.
        edges: EDGE records.
        edge_index: Number of the next record.
        word: The word.

    Returns:
        The number of the next record.
    """
    axis = chip.ax[axis_index]
    before, net_before = _compute_watched_outputs(chip, axis_index, every_pulse, find_pulse_end(axis)), axis.net
    rate = read_pulse_rate(chip, axis_index, 1.0)
    set_wire_word(chip, word)
    now = read_pulse_rate(chip, axis_index, 1.0)
    word = _compute_watched_outputs(chip, axis_index, every_pulse, find_pulse_end(axis))
    if word != before or now != rate or (every_pulse and axis.net != net_before):
        edge_index = write_edge(chip, axis_index, edges, edge_index, read_outputs(chip, axis_index), now)
    return edge_index
