"""HCTL-1100, compiled: `run` jumps from sample to sample, and over those that change nothing. Between samples nothing changes.

The chip makes no pulses: for a stage `net` is the count that the command position stands for, and the motor gets `mean_count`, a
share of full drive.
"""

from __future__ import annotations

import numpy as np

from stage.chips.hctl1100 import bus, commutator, encoder, motor, timer
from stage.chips.hctl1100 import filter as law
from stage.chips.hctl1100.state import (
    CONTROL,
    EDGE,
    F0,
    IDLE,
    INIT,
    INPUTS,
    INTEGRAL,
    OUTPUTS,
    PROF,
    PROPORTIONAL,
    PULSE,
    STATE,
    TRAPEZOID,
    control_mode,
    signed,
)
from stage.compiled import hot, least
from stage.sealed import at, sealed

ROOM = 8
REAL, WHOLE = np.dtype("f8"), np.dtype("i8")

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "inputs", "mark", "mean_count", "net",
           "outputs", "peek", "pins", "power_up", "pulse_rate", "read", "run", "scan", "scan_seen", "see", "set_input",
           "status", "trace", "value", "write"]  # fmt: skip


@hot
def _sample(c, until):
    """The timer has come to its end. Where the sample changes nothing, those that follow up to `until` do not either."""
    timer.start(c)
    if c.mode != CONTROL:
        commutator.align_sample(c)
    elif law.sample(c) and c.clock < until:
        more = (until - c.clock) // (c.next - c.clock)
        motor.spend(c, c.clock + more * (c.next - c.clock))
        timer.skip(c, more)


@sealed(None, STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        if c.mode == IDLE:
            motor.spend(c, until)
            timer.idle_to(c, until)
            c.clock = until
            return
        stop = least(until, c.next)
        motor.spend(c, stop)
        c.clock = stop
        if stop == c.next:
            _sample(c, until)


# --- what a stage asks, see stage/chips/cores.py; the only axis is 0 ---


@sealed(None, STATE, "i8", "f8", "f8")
def see(c, j, count, rate):
    """From now on the shaft is at `count + rate * (clock - now)`, in counts of the encoder and counts a clock."""
    encoder.see(c, count, rate)


@sealed("i8", STATE, "i8")
def net(c, j):
    """The encoder's count that the command position stands for."""
    now = encoder.raw(c)
    return now + signed(c.command - (now - c.zero), 24)


@sealed("i8", STATE, "i8")
def counter(c, j):
    """The actual position."""
    return encoder.actual(c)


@sealed("i8", STATE, "i8")
def inputs(c, j):
    """Input pins, see INPUTS."""
    return c.inputs


@sealed(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Set the input pins, see INPUTS. They act at once."""
    bus.set_pins(c, word)


@sealed("i8", STATE, "i8")
def status(c, j):
    """R07."""
    return bus.status_byte(c)


@sealed("i8", STATE, "i8")
def peek(c, address):
    """A register as it reads, without what reading does."""
    return bus.peek_byte(c, address)


@sealed("i8", STATE, "i8")
def busy(c, j):
    """A trapezoid is in progress."""
    return c.flag & F0 if c.mode == CONTROL else 0


@sealed("i8", STATE, "i8")
def outputs(c, j):
    """Output pins, see OUTPUTS."""
    word = (PROF if c.flag & F0 else 0) | (INIT if c.mode == IDLE else 0)
    return word | motor.pins(c) | commutator.phases(c)


@sealed("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """The commanded velocity, counts per second."""
    if c.mode != CONTROL:
        return 0.0
    mode, sample = control_mode(c.flag), 16.0 * (c.period + 1)
    if mode == PROPORTIONAL:
        return signed(c.reg[0x24] << 8 | c.reg[0x23], 16) * hz / (16.0 * sample)
    return c.velocity * hz / (256.0 * sample) if mode in (TRAPEZOID, INTEGRAL) else 0.0


@sealed("f8", STATE, "i8", "i8", "f8")
def mean_count(c, j, before, ticks):
    """Mean over the last `ticks`, since it was asked last, of the motor command as a share of full drive, -1 to 1."""
    mean = c.moment / (motor.FULL_DRIVE * ticks)
    c.moment = 0
    return mean


# --- the chip by itself: no stage asks for the mean of what was, so it does not matter how time was cut ---


@sealed(None, STATE)
def power_up(c):
    """A cleared record becomes a chip that was just switched on."""
    bus.hard_reset(c)


@sealed(None, STATE, "i8", "i8")
def write(c, address, value):
    """One bus write cycle, between two clocks."""
    bus.write_byte(c, address & 0x3F, value & 0xFF)


@sealed("i8", STATE, "i8")
def read(c, address):
    """One bus read cycle; that of R14 latches."""
    return bus.read_byte(c, address & 0x3F)


@sealed("i8", STATE, "i8")
def value(c, address):
    """What a register reads as, free of bus cycles."""
    return bus.peek_byte(c, address)


@sealed("i8", STATE)
def encoder_count(c):
    """The encoder's raw count."""
    return encoder.raw(c)


@sealed("f8", STATE)
def lost(c):
    """Counts that came too fast for the encoder's filter, plus minus minus."""
    return encoder.lost(c)


@sealed("i8", STATE, "i8")
def pins(c, axis):
    """Output pins, see OUTPUTS."""
    return outputs(c, axis)


@sealed("i8", STATE, "i8")
def advance(c, until):
    """Run up to clock `until`; returns the pulses begun: none."""
    run(c, until)
    c.moment = 0
    return 0


@hot
def trace(rows, i, until, out):
    """As advance: there are no pulses to fill `out` with."""
    return advance(rows[i], until)


@hot
def mark(rows, i, out, k, axis):
    """Write chip `i` as it stands to `out[k]` (an EDGE record)."""
    c, e = rows[i], out[k]
    e.clock, e.inputs, e.outputs, e.counter, e.net = c.clock, c.inputs, outputs(c, 0), counter(c, 0), net(c, 0)
    e.command, e.motor, e.rate = c.command, c.drive, pulse_rate(c, 0, 1.0)


@hot
def _next_change(c, until):
    """The clock, at most `until`, at which a pin may change."""
    stop = until if c.mode == IDLE else least(until, c.next)
    if c.clock < c.dead:
        stop = least(stop, c.dead)
    if c.reg[commutator.RING]:
        stop = least(stop, encoder.next_count(c, stop))
    return stop


@hot
def scan(rows, i, until, every_pulse, out, axis):
    """As advance, and fills `out` (EDGE records) with every change of the commanded velocity or of an output pin, with
    `every_pulse` also of the command position and the motor command. Returns how many; stops early when `out` is almost full: look
    at the clock and call again."""
    c = rows[i]
    k = 0
    while c.clock < until and k < len(out) - ROOM:
        word, rate, command, drive = outputs(c, 0), pulse_rate(c, 0, 1.0), c.command, c.drive
        run(c, _next_change(c, until))
        changed = outputs(c, 0) != word or pulse_rate(c, 0, 1.0) != rate
        if changed or (every_pulse and (c.command != command or c.drive != drive)):
            mark(rows, i, out, k, axis)
            k += 1
    c.moment = 0
    return k


@hot
def scan_seen(rows, i, until, every_pulse, out, axis, clocks, counts, rates, at):
    """As scan, while the shaft is seen anew at `clocks`, in order and up to `until`, with these counts and rates, from number at[0]
    on, which goes up. Stops early as scan does: call again until at[0] is all of them and the clock is there."""
    c = rows[i]
    k = 0
    while k < len(out) - ROOM:
        n = at[0]
        while n < len(clocks) and clocks[n] <= c.clock:
            encoder.see(c, counts[n], rates[n])
            n += 1
        at[0] = n
        if c.clock >= until:
            return k
        k += scan(rows, i, clocks[n] if n < len(clocks) else until, every_pulse, out[k:], axis)
    return k


# --- the same for Python, which knows addresses: of the chip's state, and of arrays with their lengths ---


@sealed("i8", "i8", "i8", "i8", "i8")
def trace_at(chip, until, out, n):
    """`trace` of the chip at an address into `n` PULSE records at `out`."""
    return trace(at(chip, 1, STATE), 0, until, at(out, n, PULSE))


@sealed("i8", "i8", "i8", "i8", "i8", "i8", "i8")
def scan_at(chip, until, every_pulse, axis, out, n):
    """`scan` of the chip at an address into `n` EDGE records at `out`."""
    return scan(at(chip, 1, STATE), 0, until, every_pulse, at(out, n, EDGE), axis)


@sealed(None, "i8", "i8", "i8")
def mark_at(chip, axis, out):
    """`mark` of the chip at an address into the EDGE record at `out`."""
    mark(at(chip, 1, STATE), 0, at(out, 1, EDGE), 0, axis)


@sealed("i8", "i8", "i8", "i8", "i8", "i8", "i8", "i8", "i8", "i8", "i8", "i8")
def scan_seen_at(chip, until, every_pulse, axis, out, n, clocks, counts, rates, m, done):
    """`scan_seen` likewise; clocks, counts, rates: of `m` numbers each; done: of one."""
    shafts = at(clocks, m, WHOLE), at(counts, m, REAL), at(rates, m, REAL)
    return scan_seen(at(chip, 1, STATE), 0, until, every_pulse, at(out, n, EDGE), axis, *shafts, at(done, 1, WHOLE))
