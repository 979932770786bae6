"""Core of the HCTL-1100, compiled: the functions that stages, hosts and journals call, see stage/chips/core_interface.py.

`run` jumps from sample to sample, and over samples that change nothing. Between samples nothing changes.

The chip makes no pulses: for a stage its net count is the encoder count that corresponds to the command position, and the motor
receives the drive input, a share of full drive.
"""

from __future__ import annotations

from stage.chips.core_interface import run_slices, scan_while_shafts_move
from stage.chips.hctl1100 import bus, commutator, encoder, motor_port, sample_timer, state
from stage.chips.hctl1100 import digital_filter as law
from stage.chips.hctl1100.maps import ADDRESS_COUNT, PROPORTIONAL_HIGH, PROPORTIONAL_LOW, RING
from stage.chips.hctl1100.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, hot, least

EDGE_MARGIN = 8
ALL_OUTPUTS = sum(OUTPUTS.values())

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE"]


@hot
def _run_sample(chip, until):
    """Run the sample at which the timer ends. If it changes nothing, skip the samples after it up to `until` as well."""
    sample_timer.start_period(chip)
    if chip.mode != state.CONTROL:
        commutator.run_align_sample(chip)
    elif law.run_sample(chip) and chip.clock < until:
        more = (until - chip.clock) // (chip.sample_end - chip.clock)
        motor_port.integrate_motor_command(chip, chip.clock + more * (chip.sample_end - chip.clock))
        sample_timer.skip_samples(chip, more)


@exported(None, STATE, "i8")
def run(chip, until):
    """Let the chip's clock run up to `until`."""
    while chip.clock < until:
        if chip.mode == state.IDLE:
            motor_port.integrate_motor_command(chip, until)
            sample_timer.run_in_init_idle(chip, until)
            chip.clock = until
            return
        stop = least(until, chip.sample_end)
        motor_port.integrate_motor_command(chip, stop)
        chip.clock = stop
        if stop == chip.sample_end:
            _run_sample(chip, until)


# --- the functions for a stage, see stage/chips/core_interface.py; the only axis is 0 ---


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(chip, axis_index, count, rate):
    """Put the shaft at `count + rate * (clock - now)` from now on.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip, 0.
        count: Counts of the encoder.
        rate: Counts per reference clock.
    """
    encoder.set_shaft(chip, count, rate)


@exported("i8", STATE, "i8")
def read_net_count(chip, axis_index):
    """Return the net count of this servo: the raw encoder count that corresponds to the command position."""
    now = encoder.read_count(chip)
    return now + state.to_signed(chip.command - (now - chip.position_origin), 24)


@exported("i8", STATE, "i8")
def read_counter(chip, axis_index):
    """Return the actual position of the HCTL-1100, in counts."""
    return encoder.compute_actual_position(chip)


@exported("i8", STATE, "i8")
def read_inputs(chip, axis_index):
    """Return the input pins of the HCTL-1100, bits of INPUTS."""
    return chip.inputs


@exported(None, STATE, "i8", "i8")
def set_input(chip, axis_index, word):
    """Set the input pins. They act at once.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip, 0.
        word: Bits of INPUTS.
    """
    bus.set_pins(chip, word)


@exported("i8", STATE, "i8")
def read_status(chip, axis_index):
    """Return R07, the status byte of the HCTL-1100."""
    return bus.compute_status(chip)


@exported("i8", STATE, "i8")
def peek(chip, address):
    """Return what a host would read at an address, without the side effects of a bus cycle."""
    return bus.peek_byte(chip, address)


@exported("i8", STATE, "i8")
def is_busy(chip, axis_index):
    """Return whether a trapezoid of the HCTL-1100 is in progress."""
    return chip.flag_bits & state.F0 if chip.mode == state.CONTROL else 0


@exported("i8", STATE, "i8")
def read_outputs(chip, axis_index):
    """Return the output pins of the HCTL-1100, bits of OUTPUTS."""
    word = (state.PROF if chip.flag_bits & state.F0 else 0) | (state.INIT if chip.mode == state.IDLE else 0)
    return word | motor_port.compute_pins(chip) | commutator.compute_phase_pins(chip)


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(chip, axis_index, clock_hz):
    """Return the commanded velocity in counts per second.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip, 0.
        clock_hz: Reference clock, Hz.
    """
    if chip.mode != state.CONTROL:
        return 0.0
    mode, sample = state.find_control_mode(chip.flag_bits), 16.0 * (chip.period + 1)
    if mode == state.PROPORTIONAL:
        return (
            state.to_signed(chip.reg[PROPORTIONAL_HIGH] << 8 | chip.reg[PROPORTIONAL_LOW], 16)
            * clock_hz
            / (16.0 * sample)
        )
    return chip.velocity * clock_hz / (256.0 * sample) if mode in (state.TRAPEZOID, state.INTEGRAL) else 0.0


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(chip, axis_index, net_before, clocks):
    """Compute the mean, since the last call, of the motor command as a share of full drive.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip.
        net_before: Not used: the chip integrates its motor command itself.
        clocks: Number of reference clocks since the last call.
    """
    mean = chip.drive_integral / (motor_port.FULL_DRIVE * clocks)
    chip.drive_integral = 0
    return mean


# --- the chip by itself: no stage needs the mean motor command, so `advance` clears its integral ---


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
    bus.hard_reset(chip)


@exported(None, STATE, "i8", "i8")
def write(chip, address, value):
    """Make a bus write cycle between two clocks.

    Args:
        chip: State of the chip.
        address: Bus address.
        value: Datum.
    """
    bus.write_byte(chip, address & (ADDRESS_COUNT - 1), value & 0xFF)


@exported("i8", STATE, "i8")
def read(chip, address):
    """Make a bus read cycle. A read of R14 latches the upper bytes of the actual position."""
    return bus.read_byte(chip, address & (ADDRESS_COUNT - 1))


@exported("i8", STATE, "i8")
def read_register_value(chip, address):
    """Return the value that a host would read from a register, without a bus cycle."""
    return bus.peek_byte(chip, address)


@exported("i8", STATE)
def read_encoder(chip):
    """Return the raw count of the encoder."""
    return encoder.read_count(chip)


@exported("f8", STATE)
def compute_missed_counts(chip):
    """Return the net number of counts that came too fast for the encoder's input filter."""
    return encoder.compute_missed_counts(chip)


@exported("i8", STATE, "i8")
def advance(chip, until):
    """Let the clock run up to `until`, and return the number of pulses for core_interface.py: 0, a servo chip makes none."""
    run(chip, until)
    chip.drive_integral = 0
    return 0


@exported("i8", STATE, "i8", array_of(PULSE))
def trace_pulses(chip, until, pulses):
    """Let the clock run as `advance` does: a servo chip makes no pulses."""
    return advance(chip, until)


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def write_present_edge(chip, axis_index, edges, edge_index):
    """Write the present state of the chip into an EDGE record.

    Args:
        chip: State of the chip.
        axis_index: Axis of the chip.
        edges: EDGE records.
        edge_index: Number of the record.
    """
    e = edges[edge_index]
    e.clock = chip.clock
    e.inputs = chip.inputs
    e.outputs = read_outputs(chip, 0)
    e.counter = read_counter(chip, 0)
    e.net = read_net_count(chip, 0)
    e.command, e.motor, e.rate = chip.command, chip.motor_command, read_pulse_rate(chip, 0, 1.0)


@hot
def _find_next_pin_change(chip, until, every_pulse):
    """Return the next clock, at most `until`, at which an output pin may change. PULSE is considered only with `every_pulse`."""
    stop = until if chip.mode == state.IDLE else least(until, chip.sample_end)
    if every_pulse:
        stop = least(stop, motor_port.find_next_pulse_edge(chip))
    if chip.clock < chip.pulse_off_until:
        stop = least(stop, chip.pulse_off_until)
    if chip.reg[RING]:
        stop = least(stop, encoder.find_next_count(chip, stop))
    return stop


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
    watched = ALL_OUTPUTS if every_pulse else ALL_OUTPUTS & ~state.PULSE_ON
    while chip.clock < until and k < len(edges) - EDGE_MARGIN:
        word = read_outputs(chip, 0)
        rate = read_pulse_rate(chip, 0, 1.0)
        command = chip.command
        drive = chip.motor_command
        run(chip, _find_next_pin_change(chip, until, every_pulse))
        changed = (read_outputs(chip, 0) ^ word) & watched or read_pulse_rate(chip, 0, 1.0) != rate
        if changed or (every_pulse and (chip.command != command or chip.motor_command != drive)):
            write_present_edge(chip, axis_index, edges, k)
            k += 1
    chip.drive_integral = 0
    return k


@exported(
    "i8", STATE, "i8", "i8", "i8", array_of(EDGE),
    array_of("i8"), array_of("i8"), array_of("f8"), array_of("f8"), array_of("i8"),
)  # fmt: skip
def scan_edges_and_shafts(chip, until, every_pulse, axis_index, edges, clocks, axes, counts, rates, done):
    """Write the edges of an axis while encoder shafts move, see `stage.chips.core_interface.scan_while_shafts_move`."""
    return scan_while_shafts_move(
        chip, until, every_pulse, axis_index, edges, clocks, axes, counts, rates, done, scan_edges, set_shaft
    )
