"""Core of the PCL-240 family, compiled: the functions that stages, hosts and journals call, see stage/chips/core_interface.py.

motion.py makes the pulses.
"""

from __future__ import annotations

from stage.chips.core_interface import run_slices
from stage.chips.pcl240 import state
from stage.chips.pcl240.bus import compute_outputs, read_byte, read_register, write_byte
from stage.chips.pcl240.motion import compute_mean_count, run, run_to_event, run_window_at_constant_speed
from stage.chips.pcl240.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, greatest, hot, least

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE"]


# --- the functions for a stage, see stage/chips/core_interface.py; the only axis is 0 ---


@exported("i8", STATE, "i8")
def read_net_count(chip, axis_index):
    """Return the net number of pulses (plus less minus) of the PCL-240 since power-up."""
    return chip.net


@exported("i8", STATE, "i8")
def read_counter(chip, axis_index):
    """Return R0, the down counter of the PCL-240."""
    return chip.reg[0]


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(chip, axis_index, count, rate):
    """Ignore the shaft: these chips have no inputs for an encoder."""


@exported("i8", STATE, "i8")
def read_inputs(chip, axis_index):
    """Return the input pins of the PCL-240, bits of INPUTS."""
    return chip.inputs


@exported(None, STATE, "i8", "i8")
def set_input(chip, axis_index, word):
    """Set the input pins.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip, 0.
        word: Bits of INPUTS.
    """
    multiplier = chip.multiplier
    chip.inputs = word
    state.update_active_inputs(chip)
    if chip.multiplier != multiplier:
        chip.quiet_until = 0


@exported("i8", STATE, "i8")
def read_status(chip, axis_index):
    """Return the status byte of the PCL-240."""
    return read_byte(chip, 0)


@exported("i8", STATE, "i8")
def peek(chip, address):
    """Return the status byte, or a byte of R0 whatever register is selected, without a bus cycle."""
    return chip.reg[0] >> 8 * (address - 1) & 0xFF if address else read_byte(chip, 0)


@exported("i8", STATE, "i8")
def is_busy(chip, axis_index):
    """Return whether status bit 6 is on: a run is in operation."""
    return read_byte(chip, 0) & state.S_OPERATING


@exported("i8", STATE, "i8")
def read_outputs(chip, axis_index):
    """Return the output pins of the PCL-240, bits of OUTPUTS."""
    return compute_outputs(chip)


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(chip, axis_index, clock_hz):
    """Return the present output frequency in pulses per second.

    Source: data sheet, section 4, R7.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip, 0.
        clock_hz: Reference clock, Hz.
    """
    if (chip.running or chip.finishing) and chip.multiplier >= 2:
        return chip.speed * clock_hz / (8192.0 * chip.multiplier)
    return 0.0


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(chip, axis_index, net_before, clocks):
    """Compute the mean of the net pulse count over the last `clocks` reference clocks.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip.
        net_before: Net pulse count at the start of these clocks.
        clocks: Number of reference clocks.
    """
    if net_before != chip.net and (not (chip.running or chip.finishing) or chip.speed == 0):
        return 0.5 * (net_before + chip.net)
    return compute_mean_count(net_before, chip.net, chip.phase, chip.multiplier, chip.speed, clocks)


@hot
def _find_pulse_pin(chip):
    """Return the output pin of the PCL-240 that carries the pulses of the present direction."""
    return state.PDIR if chip.output_mode & state.INDEPENDENT and chip.minus else state.POUT


@hot
def _write_edge(chip, edges, edge_index, clock, outputs, r0, net):
    """Write an EDGE record, and return the number of the next one.

    Args:
        chip: State of the chip.
        edges: EDGE records.
        edge_index: Number of the record.
        clock: Clock of the edge.
        outputs: Output pins, bits of OUTPUTS.
        r0: Down counter R0.
        net: Net pulses since power-up.
    """
    e = edges[edge_index]
    e.clock, e.outputs, e.inputs, e.counter, e.net = clock, outputs, chip.inputs, r0, net
    e.seen = chip.active_inputs
    e.speed = chip.speed if chip.running or chip.finishing else 0
    e.rate = e.speed / (8192.0 * chip.multiplier) if chip.multiplier >= 2 else 0.0
    return edge_index + 1


@hot
def _write_pulse_edges(chip, edges, edge_index, clock, phase, pulse_low, duration, pulses, outputs, r0, net):
    """Write the edges of the output POUT during a time of constant speed.

    Args:
        chip: State of the chip.
        edges: EDGE records.
        edge_index: Number of the next record.
        clock: Clock at the start of the time.
        phase: Phase of the pulse generator at the start.
        pulse_low: Whether POUT is asserted (low) at the start.
        duration: Duration of the time, clocks.
        pulses: Number of pulses that begin in this time.
        outputs: Output pins without POUT, bits of OUTPUTS.
        r0: Down counter R0 at the start.
        net: Net pulses since power-up at the start.

    Returns:
        The number of the next record.
    """
    m = 8192 * chip.multiplier
    bit = _find_pulse_pin(chip)
    direction = -1 if chip.minus else 1
    counts_output = 0 if chip.output_mode & state.EXTERNAL else 1
    for j in range(pulses + 1):
        if j:
            edge_index = _write_edge(
                chip, edges, edge_index, clock - (phase - j * m) // chip.speed, outputs | bit, r0, net
            )
            r0 = (r0 - counts_output) & state.COUNTER_MASK
            net += direction
            edges[edge_index - 1].counter, edges[edge_index - 1].net = r0, net
            pulse_low = 1
        rise = greatest(1, -((phase - j * m - m // 2) // chip.speed))
        if pulse_low and rise <= duration and (j == pulses or rise < -((phase - (j + 1) * m) // chip.speed)):
            edge_index = _write_edge(chip, edges, edge_index, clock + rise, outputs, r0, net)
            pulse_low = 0
    return edge_index


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def write_present_edge(chip, axis_index, edges, edge_index):
    """Write the present state of the chip into an EDGE record.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip.
        edges: EDGE records.
        edge_index: Number of the record.
    """
    _write_edge(chip, edges, edge_index, chip.clock, compute_outputs(chip), chip.reg[0], chip.net)


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan_edges(chip, until, every_pulse, axis_index, edges):
    """Let the clock run as `advance` does, and write an EDGE record at each change of the axis.

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
    while chip.clock < until and k < len(edges) - 8:
        if not (chip.running or chip.finishing) and chip.active_inputs == chip.last_inputs:
            chip.clock = until
            break
        n = until - chip.clock
        pulsing = every_pulse and chip.speed > 0 and chip.multiplier >= 2
        if pulsing:
            n = least(n, greatest(1, (len(edges) - 8 - k) // 2 * 4096 * chip.multiplier // chip.speed))
        clock, phase, low, r0, net, total = chip.clock, chip.phase, chip.pout_low, chip.reg[0], chip.net, chip.total
        speed, word, bit = chip.speed, compute_outputs(chip), _find_pulse_pin(chip)
        s = run_to_event(chip, n)
        pulses = chip.total - total
        after = chip.speed
        if pulsing and (pulses or low != chip.pout_low):
            chip.speed = speed
            k = _write_pulse_edges(chip, edges, k, clock, phase, low, s, pulses, word & ~bit, r0, net)
            chip.speed = after
        new = compute_outputs(chip)
        changed = (new ^ word) & ~bit
        if after != speed or changed:
            k = _write_edge(chip, edges, k, chip.clock, new, chip.reg[0], chip.net)
    return k


@exported(None, STATE, "i8", "i8")
def run_window(chip, row_address, first_slice):
    """Let the chip's clock run through a window, the time of one physics step, from slice `first_slice` on.

    Args:
        chip: State of the chip.
        row_address: Address of the chip's row in the table of chips, see stage/chips/core_interface.py.
        first_slice: First slice to run, from 0; a slice is an eighth of a window.
    """
    if not run_window_at_constant_speed(chip, row_address, first_slice):
        run_slices(chip, row_address, first_slice, run, read_net_count, compute_drive_input)


@exported(None, STATE)
def power_up(chip):
    """Make a cleared record the state of a chip that was just switched on."""
    state.reset_chip(chip)


@exported(None, STATE, "i8", "i8")
def write(chip, address, value):
    """Make a bus write cycle between two ticks.

    Args:
        chip: State of the chip.
        address: Bus address.
        value: Datum.
    """
    write_byte(chip, address, value)


@exported("i8", STATE, "i8")
def read(chip, address):
    """Make a bus read cycle.

    Args:
        chip: State of the chip.
        address: Bus address.
    """
    return read_byte(chip, address)


@exported("i8", STATE, "i8")
def read_register_value(chip, register_number):
    """Return the value that a host would read from the register with index `register_number`, without a bus cycle."""
    return read_register(chip, register_number)


@exported("i8", STATE, "i8")
def advance(chip, until):
    """Let the clock run up to `until`, and return the number of pulses that have begun."""
    before = chip.total
    run(chip, until)
    return chip.total - before


@exported("i8", STATE, "i8", array_of(PULSE))
def trace_pulses(chip, until, pulses):
    """Let the clock run as `advance` does, and write a PULSE record for each pulse.

    Args:
        chip: State of the chip.
        until: Clock at the end.
        pulses: PULSE records, as many as there will be pulses.

    Returns:
        The number of pulses.
    """
    k = 0
    while chip.clock < until:
        if not (chip.running or chip.finishing) and chip.active_inputs == chip.last_inputs:
            chip.clock = until
            break
        clock, phase, total, net = chip.clock, chip.phase, chip.total, chip.net
        speed = chip.speed
        run_to_event(chip, until - chip.clock)
        n = chip.total - total
        if n:
            m = 8192 * chip.multiplier
            direction = 1 if chip.net > net else -1
            t = -((phase - m) // speed)
            rest = phase + t * speed - m  # phase just after the pulse began, < speed
            q = m // speed
            r = m - q * speed
            t += clock
            for _ in range(n):
                pulses[k].clock = t
                pulses[k].axis = 0
                pulses[k].direction = direction
                k += 1
                if r > rest:
                    t += q + 1
                    rest += speed - r
                else:
                    t += q
                    rest -= r
    return k
