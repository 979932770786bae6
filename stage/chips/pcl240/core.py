"""PCL-240 family, compiled: its functions for a stage, a host and a journal, see stage/chips/cores.py. Its pulses: motion.py."""

from __future__ import annotations

from stage.chips.cores import through
from stage.chips.pcl240 import state
from stage.chips.pcl240.bus import outputs as output_word
from stage.chips.pcl240.bus import read_byte, register, write_byte
from stage.chips.pcl240.motion import cruise_through, mean_count, run, span
from stage.chips.pcl240.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.native import array_of, exported, greatest, hot, least

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "inputs", "mark", "drive_input", "net",
           "outputs", "peek", "power_up", "pulse_rate", "read", "run", "scan", "set_shaft",
           "set_input", "status", "trace",
           "value", "write"]  # fmt: skip


# --- the functions for a stage, see stage/chips/cores.py; the only axis is 0 ---


@exported("i8", STATE, "i8")
def net(c, j):
    """Pulses ever begun, plus minus minus."""
    return c.net


@exported("i8", STATE, "i8")
def counter(c, j):
    """The down counter R0."""
    return c.reg[0]


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """No encoder is connected: these chips make pulses, and nobody looks where the shaft goes."""


@exported("i8", STATE, "i8")
def inputs(c, j):
    """Input pins, see INPUTS."""
    return c.inputs


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Set the input pins, see INPUTS."""
    multiplier = c.multiplier
    c.inputs = word
    state.read_pins(c)
    if c.multiplier != multiplier:
        c.quiet = 0


@exported("i8", STATE, "i8")
def status(c, j):
    """The status byte."""
    return read_byte(c, 0)


@exported("i8", STATE, "i8")
def peek(c, address):
    """The status byte, and R0's bytes whatever register is selected."""
    return c.reg[0] >> 8 * (address - 1) & 0xFF if address else read_byte(c, 0)


@exported("i8", STATE, "i8")
def busy(c, j):
    """Status b6: in operation."""
    return read_byte(c, 0) & state.S_OPERATING


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Output pins, see OUTPUTS."""
    return output_word(c)


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """Output frequency now, pulses per second (data sheet section 4, R7)."""
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
    return mean_count(before, c.net, c.phase, c.multiplier, c.speed, ticks)


@hot
def _pulse_bit(c):
    """The pin that carries the pulses of the present direction."""
    return state.PDIR if c.output & state.INDEPENDENT and c.minus else state.POUT


@hot
def _log(c, out, k, clock, word, r0, net):
    e = out[k]
    e.clock, e.outputs, e.inputs, e.counter, e.net = clock, word, c.inputs, r0, net
    e.seen = c.seen
    e.speed = c.speed if c.running or c.finishing else 0
    e.rate = e.speed / (8192.0 * c.multiplier) if c.multiplier >= 2 else 0.0
    return k + 1


@hot
def _log_pulses(c, out, k, clock, phase, low, s, pulses, base, r0, net):
    """POUT's edges within a span of `s` ticks with `pulses` pulses that began at `clock` with `phase` and `low`."""
    m = 8192 * c.multiplier
    bit = _pulse_bit(c)
    direction = -1 if c.minus else 1
    counts_output = 0 if c.output & state.EXTERNAL else 1
    for j in range(pulses + 1):
        if j:
            k = _log(c, out, k, clock - (phase - j * m) // c.speed, base | bit, r0, net)
            r0 = (r0 - counts_output) & state.COUNTER_MASK
            net += direction
            out[k - 1].counter, out[k - 1].net = r0, net
            low = 1
        rise = greatest(1, -((phase - j * m - m // 2) // c.speed))
        if low and rise <= s and (j == pulses or rise < -((phase - (j + 1) * m) // c.speed)):
            k = _log(c, out, k, clock + rise, base, r0, net)
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
    _log(c, out, k, c.clock, output_word(c), c.reg[0], c.net)


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
    while c.clock < until and k < len(out) - 8:
        if not (c.running or c.finishing) and c.seen == c.sampled:
            c.clock = until
            break
        n = until - c.clock
        pulsing = every_pulse and c.speed > 0 and c.multiplier >= 2
        if pulsing:
            n = least(n, greatest(1, (len(out) - 8 - k) // 2 * 4096 * c.multiplier // c.speed))
        clock, phase, low, r0, net, total = c.clock, c.phase, c.low, c.reg[0], c.net, c.total
        speed, word, bit = c.speed, output_word(c), _pulse_bit(c)
        s = span(c, n)
        pulses = c.total - total
        after = c.speed
        if pulsing and (pulses or low != c.low):
            c.speed = speed
            k = _log_pulses(c, out, k, clock, phase, low, s, pulses, word & ~bit, r0, net)
            c.speed = after
        new = output_word(c)
        changed = (new ^ word) & ~bit
        if after != speed or changed:
            k = _log(c, out, k, c.clock, new, c.reg[0], c.net)
    return k


@exported(None, STATE, "i8", "i8")
def window(c, row, k):
    """Let the chip's clock run through the slices of a window, see stage/chips/cores.py."""
    if not cruise_through(c, row, k):
        through(c, row, k, run, net, drive_input)


@exported(None, STATE)
def power_up(c):
    """A cleared record becomes a chip that was just switched on."""
    state.reset(c)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """One bus write cycle, between two ticks."""
    write_byte(c, address, value)


@exported("i8", STATE, "i8")
def read(c, address):
    """One bus read cycle."""
    return read_byte(c, address)


@exported("i8", STATE, "i8")
def value(c, k):
    """Return what the k-th register reads as, without a bus cycle."""
    return register(c, k)


@exported("i8", STATE, "i8")
def advance(c, until):
    """Run up to clock `until`; returns the pulses begun."""
    before = c.total
    run(c, until)
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
    while c.clock < until:
        if not (c.running or c.finishing) and c.seen == c.sampled:
            c.clock = until
            break
        clock, phase, total, net = c.clock, c.phase, c.total, c.net
        speed = c.speed
        span(c, until - c.clock)
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
