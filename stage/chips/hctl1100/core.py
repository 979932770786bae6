"""The functions of the HCTL-1100 for a stage, a host and a journal, compiled; see stage/chips/cores.py.

`run` jumps from sample to sample, and over samples that change nothing. Between samples nothing changes.

The chip makes no pulses: for a stage `net` is the count that corresponds to the command position, and the motor receives
`drive_input`, a share of full drive.
"""

from __future__ import annotations

from stage.chips.cores import run_window, scan_shafts
from stage.chips.hctl1100 import bus, commutator, encoder, motor, state, timer
from stage.chips.hctl1100 import filter as law
from stage.chips.hctl1100.maps import ADDRESSES, PROPORTIONAL_HIGH, PROPORTIONAL_LOW, RING
from stage.chips.hctl1100.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, hot, least

EDGE_MARGIN = 8
ALL_OUTPUTS = sum(OUTPUTS.values())

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "inputs", "mark", "drive_input", "net",
           "outputs", "peek", "power_up", "pulse_rate", "read", "run", "scan", "scan_shaft", "set_shaft", "set_input",
           "status", "trace", "value", "write"]  # fmt: skip


@hot
def _run_sample(c, until):
    """Run the sample at which the timer ends. If it changes nothing, skip the samples after it up to `until` as well."""
    timer.start_period(c)
    if c.mode != state.CONTROL:
        commutator.run_align_sample(c)
    elif law.run_sample(c) and c.clock < until:
        more = (until - c.clock) // (c.sample_end - c.clock)
        motor.accumulate_drive(c, c.clock + more * (c.sample_end - c.clock))
        timer.skip_samples(c, more)


@exported(None, STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        if c.mode == state.IDLE:
            motor.accumulate_drive(c, until)
            timer.run_idle(c, until)
            c.clock = until
            return
        stop = least(until, c.sample_end)
        motor.accumulate_drive(c, stop)
        c.clock = stop
        if stop == c.sample_end:
            _run_sample(c, until)


# --- the functions for a stage, see stage/chips/cores.py; the only axis is 0 ---


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Put the shaft at `count + rate * (clock - now)` from now on.

    Args:
        c: State of the chip.
        j: Axis of the chip, 0.
        count: Counts of the encoder.
        rate: Counts per reference clock.
    """
    encoder.set_shaft(c, count, rate)


@exported("i8", STATE, "i8")
def net(c, j):
    """Return the raw count of the encoder that corresponds to the command position."""
    now = encoder.read_count(c)
    return now + state.to_signed(c.command - (now - c.position_origin), 24)


@exported("i8", STATE, "i8")
def counter(c, j):
    """Return the actual position, in counts."""
    return encoder.compute_actual_position(c)


@exported("i8", STATE, "i8")
def inputs(c, j):
    """Return the input pins, bits of INPUTS."""
    return c.inputs


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Set the input pins. They act at once.

    Args:
        c: State of the chip.
        j: Axis of the chip, 0.
        word: Bits of INPUTS.
    """
    bus.set_pins(c, word)


@exported("i8", STATE, "i8")
def status(c, j):
    """Return the status byte R07."""
    return bus.compute_status(c)


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return what a host would read at an address, without the side effects of a bus cycle."""
    return bus.peek_byte(c, address)


@exported("i8", STATE, "i8")
def busy(c, j):
    """Return whether a trapezoid is in progress."""
    return c.flag_bits & state.F0 if c.mode == state.CONTROL else 0


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Return the output pins, bits of OUTPUTS."""
    word = (state.PROF if c.flag_bits & state.F0 else 0) | (state.INIT if c.mode == state.IDLE else 0)
    return word | motor.compute_pins(c) | commutator.compute_phase_pins(c)


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """Return the commanded velocity in counts per second.

    Args:
        c: State of the chip.
        j: Axis of the chip, 0.
        hz: Reference clock, Hz.
    """
    if c.mode != state.CONTROL:
        return 0.0
    mode, sample = state.find_control_mode(c.flag_bits), 16.0 * (c.period + 1)
    if mode == state.PROPORTIONAL:
        return state.to_signed(c.reg[PROPORTIONAL_HIGH] << 8 | c.reg[PROPORTIONAL_LOW], 16) * hz / (16.0 * sample)
    return c.velocity * hz / (256.0 * sample) if mode in (state.TRAPEZOID, state.INTEGRAL) else 0.0


@exported("f8", STATE, "i8", "i8", "f8")
def drive_input(c, j, before, ticks):
    """Compute the mean, since the last call, of the motor command as a share of full drive.

    Args:
        c: State of the chip.
        j: Axis of the chip.
        before: The value at the start of these ticks.
        ticks: Reference clocks.
    """
    mean = c.drive_integral / (motor.FULL_DRIVE * ticks)
    c.drive_integral = 0
    return mean


# --- the chip by itself: no stage needs the mean motor command, so `advance` clears its integral ---


@exported(None, STATE, "i8", "i8")
def window(c, row, k):
    """Let the chip's clock run through the slices of a window, see stage/chips/cores.py."""
    run_window(c, row, k, run, net, drive_input)


@exported(None, STATE)
def power_up(c):
    """Make a cleared record the state of a chip that was just switched on."""
    bus.hard_reset(c)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """Make a bus write cycle between two clocks.

    Args:
        c: State of the chip.
        address: Bus address.
        value: Datum.
    """
    bus.write_byte(c, address & (ADDRESSES - 1), value & 0xFF)


@exported("i8", STATE, "i8")
def read(c, address):
    """Make a bus read cycle. A read of R14 latches the upper bytes of the actual position."""
    return bus.read_byte(c, address & (ADDRESSES - 1))


@exported("i8", STATE, "i8")
def value(c, address):
    """Return what a register reads as, without a bus cycle."""
    return bus.peek_byte(c, address)


@exported("i8", STATE)
def read_encoder(c):
    """Return the raw count of the encoder."""
    return encoder.read_count(c)


@exported("f8", STATE)
def compute_missed_counts(c):
    """Return the net number of counts that came too fast for the encoder's input filter."""
    return encoder.compute_missed_counts(c)


@exported("i8", STATE, "i8")
def advance(c, until):
    """Let the clock run up to `until`, and return the number of pulses, 0."""
    run(c, until)
    c.drive_integral = 0
    return 0


@exported("i8", STATE, "i8", array_of(PULSE))
def trace(c, until, out):
    """Let the clock run as `advance` does: a servo chip makes no pulses."""
    return advance(c, until)


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def mark(c, axis, out, k):
    """Write the present state of the chip into an EDGE record.

    Args:
        c: State of the chip.
        axis: Axis of the chip.
        out: EDGE records.
        k: Number of the record.
    """
    e = out[k]
    e.clock, e.inputs, e.outputs, e.counter, e.net = c.clock, c.inputs, outputs(c, 0), counter(c, 0), net(c, 0)
    e.command, e.motor, e.rate = c.command, c.motor_command, pulse_rate(c, 0, 1.0)


@hot
def _find_next_pin_change(c, until, every_pulse):
    """Return the next clock, at most `until`, at which an output pin may change; PULSE counts only with `every_pulse`."""
    stop = until if c.mode == state.IDLE else least(until, c.sample_end)
    if every_pulse:
        stop = least(stop, motor.find_next_pulse_edge(c))
    if c.clock < c.pulse_off_until:
        stop = least(stop, c.pulse_off_until)
    if c.reg[RING]:
        stop = least(stop, encoder.find_next_count(c, stop))
    return stop


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan(c, until, every_pulse, axis, out):
    """Let the clock run as `advance` does, and write an EDGE record at each change of the axis.

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
    watched = ALL_OUTPUTS if every_pulse else ALL_OUTPUTS & ~state.PULSE_ON
    while c.clock < until and k < len(out) - EDGE_MARGIN:
        word, rate, command, drive = outputs(c, 0), pulse_rate(c, 0, 1.0), c.command, c.motor_command
        run(c, _find_next_pin_change(c, until, every_pulse))
        changed = (outputs(c, 0) ^ word) & watched or pulse_rate(c, 0, 1.0) != rate
        if changed or (every_pulse and (c.command != command or c.motor_command != drive)):
            mark(c, axis, out, k)
            k += 1
    c.drive_integral = 0
    return k


@exported(
    "i8", STATE, "i8", "i8", "i8", array_of(EDGE),
    array_of("i8"), array_of("i8"), array_of("f8"), array_of("f8"), array_of("i8"),
)  # fmt: skip
def scan_shaft(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done):
    """Scan while the shafts of axes move, see `stage.chips.cores.scan_shafts`."""
    return scan_shafts(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done, scan, set_shaft)
