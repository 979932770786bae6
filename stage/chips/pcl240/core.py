"""The functions of the PCL-240 family for a stage, a host and a journal, compiled; see stage/chips/cores.py. Pulses: motion.py."""

from __future__ import annotations

from stage.chips.cores import run_window
from stage.chips.pcl240 import state
from stage.chips.pcl240.bus import compute_outputs as output_word
from stage.chips.pcl240.bus import read_byte, read_register, write_byte
from stage.chips.pcl240.motion import compute_mean_count, run, run_to_event, run_window_at_constant_speed
from stage.chips.pcl240.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, greatest, hot, least

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "inputs", "mark", "drive_input", "net",
           "outputs", "peek", "power_up", "pulse_rate", "read", "run", "scan", "set_shaft",
           "set_input", "status", "trace",
           "value", "write"]  # fmt: skip


# --- the functions for a stage, see stage/chips/cores.py; the only axis is 0 ---


@exported("i8", STATE, "i8")
def net(c, j):
    """Return the net number of pulses since power-up."""
    return c.net


@exported("i8", STATE, "i8")
def counter(c, j):
    """Return the down counter R0."""
    return c.reg[0]


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Ignore the shaft: these chips have no inputs for an encoder."""


@exported("i8", STATE, "i8")
def inputs(c, j):
    """Return the input pins, bits of INPUTS."""
    return c.inputs


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Set the input pins.

    Args:
        c: State of the chip.
        j: Axis of the chip, 0.
        word: Bits of INPUTS.
    """
    multiplier = c.multiplier
    c.inputs = word
    state.read_pins(c)
    if c.multiplier != multiplier:
        c.quiet_until = 0


@exported("i8", STATE, "i8")
def status(c, j):
    """Return the status byte."""
    return read_byte(c, 0)


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return the status byte, or a byte of R0 whatever register is selected, without a bus cycle."""
    return c.reg[0] >> 8 * (address - 1) & 0xFF if address else read_byte(c, 0)


@exported("i8", STATE, "i8")
def busy(c, j):
    """Return status bit 6: a run is in operation."""
    return read_byte(c, 0) & state.S_OPERATING


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Return the output pins, bits of OUTPUTS."""
    return output_word(c)


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """Return the present output frequency in pulses per second.

    Source: data sheet, section 4, R7.

    Args:
        c: State of the chip.
        j: Axis of the chip, 0.
        hz: Reference clock, Hz.
    """
    if (c.running or c.finishing) and c.multiplier >= 2:
        return c.speed * hz / (8192.0 * c.multiplier)
    return 0.0


@exported("f8", STATE, "i8", "i8", "f8")
def drive_input(c, j, before, ticks):
    """Compute the mean over the last ticks of the net pulse count.

    Args:
        c: State of the chip.
        j: Axis of the chip.
        before: The value at the start of these ticks.
        ticks: Reference clocks.
    """
    if before != c.net and (not (c.running or c.finishing) or c.speed == 0):
        return 0.5 * (before + c.net)
    return compute_mean_count(before, c.net, c.phase, c.multiplier, c.speed, ticks)


@hot
def _find_pulse_pin(c):
    """Return the output pin that carries the pulses of the present direction."""
    return state.PDIR if c.output_mode & state.INDEPENDENT and c.minus else state.POUT


@hot
def _write_edge(c, out, k, clock, word, r0, net):
    """Write an EDGE record, and return the number of the next one.

    Args:
        c: State of the chip.
        out: EDGE records.
        k: Number of the record.
        clock: Its clock.
        word: Output pins.
        r0: Down counter.
        net: Net pulses.
    """
    e = out[k]
    e.clock, e.outputs, e.inputs, e.counter, e.net = clock, word, c.inputs, r0, net
    e.seen = c.active_inputs
    e.speed = c.speed if c.running or c.finishing else 0
    e.rate = e.speed / (8192.0 * c.multiplier) if c.multiplier >= 2 else 0.0
    return k + 1


@hot
def _write_pulse_edges(c, out, k, clock, phase, low, s, pulses, base, r0, net):
    """POUT's edges within a span of `s` ticks with `pulses` pulses that began at `clock` with `phase` and `low`."""
    m = 8192 * c.multiplier
    bit = _find_pulse_pin(c)
    direction = -1 if c.minus else 1
    counts_output = 0 if c.output_mode & state.EXTERNAL else 1
    for j in range(pulses + 1):
        if j:
            k = _write_edge(c, out, k, clock - (phase - j * m) // c.speed, base | bit, r0, net)
            r0 = (r0 - counts_output) & state.COUNTER_MASK
            net += direction
            out[k - 1].counter, out[k - 1].net = r0, net
            low = 1
        rise = greatest(1, -((phase - j * m - m // 2) // c.speed))
        if low and rise <= s and (j == pulses or rise < -((phase - (j + 1) * m) // c.speed)):
            k = _write_edge(c, out, k, clock + rise, base, r0, net)
            low = 0
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
    _write_edge(c, out, k, c.clock, output_word(c), c.reg[0], c.net)


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
    while c.clock < until and k < len(out) - 8:
        if not (c.running or c.finishing) and c.active_inputs == c.last_inputs:
            c.clock = until
            break
        n = until - c.clock
        pulsing = every_pulse and c.speed > 0 and c.multiplier >= 2
        if pulsing:
            n = least(n, greatest(1, (len(out) - 8 - k) // 2 * 4096 * c.multiplier // c.speed))
        clock, phase, low, r0, net, total = c.clock, c.phase, c.pout_low, c.reg[0], c.net, c.total
        speed, word, bit = c.speed, output_word(c), _find_pulse_pin(c)
        s = run_to_event(c, n)
        pulses = c.total - total
        after = c.speed
        if pulsing and (pulses or low != c.pout_low):
            c.speed = speed
            k = _write_pulse_edges(c, out, k, clock, phase, low, s, pulses, word & ~bit, r0, net)
            c.speed = after
        new = output_word(c)
        changed = (new ^ word) & ~bit
        if after != speed or changed:
            k = _write_edge(c, out, k, c.clock, new, c.reg[0], c.net)
    return k


@exported(None, STATE, "i8", "i8")
def window(c, row, k):
    """Let the chip's clock run through the slices of a window, see stage/chips/cores.py."""
    if not run_window_at_constant_speed(c, row, k):
        run_window(c, row, k, run, net, drive_input)


@exported(None, STATE)
def power_up(c):
    """Make a cleared record the state of a chip that was just switched on."""
    state.reset_chip(c)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """Make a bus write cycle between two ticks.

    Args:
        c: State of the chip.
        address: Bus address.
        value: Datum.
    """
    write_byte(c, address, value)


@exported("i8", STATE, "i8")
def read(c, address):
    """Make a bus read cycle.

    Args:
        c: State of the chip.
        address: Bus address.
    """
    return read_byte(c, address)


@exported("i8", STATE, "i8")
def value(c, k):
    """Return what the register with index `k` reads, without a bus cycle."""
    return read_register(c, k)


@exported("i8", STATE, "i8")
def advance(c, until):
    """Let the clock run up to `until`, and return the number of pulses that have begun."""
    before = c.total
    run(c, until)
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
    while c.clock < until:
        if not (c.running or c.finishing) and c.active_inputs == c.last_inputs:
            c.clock = until
            break
        clock, phase, total, net = c.clock, c.phase, c.total, c.net
        speed = c.speed
        run_to_event(c, until - c.clock)
        n = c.total - total
        if n:
            m = 8192 * c.multiplier
            direction = 1 if c.net > net else -1
            t = -((phase - m) // speed)
            rest = phase + t * speed - m  # phase just after the pulse began, < speed
            q = m // speed
            r = m - q * speed
            t += clock
            for _ in range(n):
                out[k].clock = t
                out[k].axis = 0
                out[k].direction = direction
                k += 1
                if r > rest:
                    t += q + 1
                    rest += speed - r
                else:
                    t += q
                    rest -= r
    return k
