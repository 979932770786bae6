"""HCTL-1100, compiled: `run` jumps from sample to sample, and over those that change nothing. Between samples nothing changes.

The chip makes no pulses: for a stage `net` is the count that the command position stands for, and the motor gets `drive_input`, a
share of full drive.
"""

from __future__ import annotations

import numpy as np

from stage.chips.cores import scan_shafts, through
from stage.chips.hctl1100 import bus, commutator, encoder, motor, state, timer
from stage.chips.hctl1100 import filter as law
from stage.chips.hctl1100.maps import ADDRESSES, PROPORTIONAL_HIGH, PROPORTIONAL_LOW, RING
from stage.chips.hctl1100.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, hot, least

ROOM = 8
ALL_OUTPUTS = sum(OUTPUTS.values())
REAL, WHOLE = np.dtype("f8"), np.dtype("i8")

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "inputs", "mark", "drive_input", "net",
           "outputs", "peek", "power_up", "pulse_rate", "read", "run", "scan", "scan_shaft", "set_shaft", "set_input",
           "status", "trace", "value", "write"]  # fmt: skip


@hot
def _sample(c, until):
    """The timer has come to its end. Where the sample changes nothing, those that follow up to `until` do not either."""
    timer.start(c)
    if c.mode != state.CONTROL:
        commutator.align_sample(c)
    elif law.sample(c) and c.clock < until:
        more = (until - c.clock) // (c.next - c.clock)
        motor.spend(c, c.clock + more * (c.next - c.clock))
        timer.skip(c, more)


@exported(None, STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        if c.mode == state.IDLE:
            motor.spend(c, until)
            timer.idle_to(c, until)
            c.clock = until
            return
        stop = least(until, c.next)
        motor.spend(c, stop)
        c.clock = stop
        if stop == c.next:
            _sample(c, until)


# --- the functions for a stage, see stage/chips/cores.py; the only axis is 0 ---


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Put the shaft at `count + rate * (clock - now)` from now on, in counts of the encoder."""
    encoder.set_shaft(c, count, rate)


@exported("i8", STATE, "i8")
def net(c, j):
    """The encoder's count that the command position stands for."""
    now = encoder.raw(c)
    return now + state.signed(c.command - (now - c.zero), 24)


@exported("i8", STATE, "i8")
def counter(c, j):
    """The actual position."""
    return encoder.actual(c)


@exported("i8", STATE, "i8")
def inputs(c, j):
    """Input pins, see INPUTS."""
    return c.inputs


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Set the input pins, see INPUTS. They act at once.

    Args:
        c: State of the chip.
        j: Axis of the chip.
        word: Bits of INPUTS.
    """
    bus.set_pins(c, word)


@exported("i8", STATE, "i8")
def status(c, j):
    """R07."""
    return bus.status_byte(c)


@exported("i8", STATE, "i8")
def peek(c, address):
    """A register as it reads, without what reading does."""
    return bus.peek_byte(c, address)


@exported("i8", STATE, "i8")
def busy(c, j):
    """A trapezoid is in progress."""
    return c.flag & state.F0 if c.mode == state.CONTROL else 0


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Output pins, see OUTPUTS."""
    word = (state.PROF if c.flag & state.F0 else 0) | (state.INIT if c.mode == state.IDLE else 0)
    return word | motor.pins(c) | commutator.phases(c)


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """The commanded velocity, counts per second."""
    if c.mode != state.CONTROL:
        return 0.0
    mode, sample = state.control_mode(c.flag), 16.0 * (c.period + 1)
    if mode == state.PROPORTIONAL:
        return state.signed(c.reg[PROPORTIONAL_HIGH] << 8 | c.reg[PROPORTIONAL_LOW], 16) * hz / (16.0 * sample)
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
    mean = c.moment / (motor.FULL_DRIVE * ticks)
    c.moment = 0
    return mean


# --- the chip by itself: no stage asks for the mean of what was, so it does not matter how time was cut ---


@exported(None, STATE, "i8", "i8")
def window(c, row, k):
    """Let the chip's clock run through the slices of a window, see stage/chips/cores.py."""
    through(c, row, k, run, net, drive_input)


@exported(None, STATE)
def power_up(c):
    """A cleared record becomes a chip that was just switched on."""
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
    """One bus read cycle; that of R14 latches."""
    return bus.read_byte(c, address & (ADDRESSES - 1))


@exported("i8", STATE, "i8")
def value(c, address):
    """Return what a register reads as, without a bus cycle."""
    return bus.peek_byte(c, address)


@exported("i8", STATE)
def encoder_count(c):
    """The encoder's raw count."""
    return encoder.raw(c)


@exported("f8", STATE)
def lost(c):
    """Counts that came too fast for the encoder's filter, plus minus minus."""
    return encoder.lost(c)


@exported("i8", STATE, "i8")
def advance(c, until):
    """Run up to clock `until`; returns the pulses begun: none."""
    run(c, until)
    c.moment = 0
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
    e.command, e.motor, e.rate = c.command, c.drive, pulse_rate(c, 0, 1.0)


@hot
def _next_change(c, until, every_pulse):
    """The clock, at most `until`, at which a pin may change; PULSE only with `every_pulse`."""
    stop = until if c.mode == state.IDLE else least(until, c.next)
    if every_pulse:
        stop = least(stop, motor.next_edge(c))
    if c.clock < c.dead:
        stop = least(stop, c.dead)
    if c.reg[RING]:
        stop = least(stop, encoder.next_count(c, stop))
    return stop


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
    watched = ALL_OUTPUTS if every_pulse else ALL_OUTPUTS & ~state.PULSE_ON
    while c.clock < until and k < len(out) - ROOM:
        word, rate, command, drive = outputs(c, 0), pulse_rate(c, 0, 1.0), c.command, c.drive
        run(c, _next_change(c, until, every_pulse))
        changed = (outputs(c, 0) ^ word) & watched or pulse_rate(c, 0, 1.0) != rate
        if changed or (every_pulse and (c.command != command or c.drive != drive)):
            mark(c, axis, out, k)
            k += 1
    c.moment = 0
    return k


@exported(
    "i8", STATE, "i8", "i8", "i8", array_of(EDGE),
    array_of("i8"), array_of("i8"), array_of("f8"), array_of("f8"), array_of("i8"),
)  # fmt: skip
def scan_shaft(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done):
    """Scan while the shafts of axes move, see stage.chips.cores."""
    return scan_shafts(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done, scan, set_shaft)
