"""TMC5160, compiled: time.

`tick` is one clock as the data sheet has it; `leap` makes many at once, in closed form, where nothing happens in between but steps.
"""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import bus, encoder, power, ramp, sequencer, speeds, stallguard, state, switches
from pulsestage_trinamic.tmc5160.state import EDGE, INPUTS, OUTPUTS, PULSE, STATE
from stage.chips.cores import run_window, scan_shafts
from stage.drives.trig import sincos
from stage.native import array_of, exported, hot, least

ROOM = 8
M32 = (1 << 32) - 1
MAX_LEAP_CLOCKS = 1 << 20  # clocks of a leap with changing speed: the way still fits 63 bits
FINE = 1 << 13  # clocks of a ramp between two edges of a course
WATCH, EACH, EDGES = 1, 2, 4  # a leap ends before a step to or from X_COMPARE; every step; every edge of the encoder

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "current", "drive_input", "inputs", "mark",
           "net", "outputs", "peek", "power_up", "pulse_rate", "read", "register", "run", "scan", "set_input", "set_load",
           "scan_shaft", "set_shaft", "status", "trace", "window", "write"]  # fmt: skip


@hot
def _halt(c):
    """Note that the speed is 0 for the thresholds of the next clock; those of this clock are done."""
    ramp.halt(c)
    c.fresh = 1


@hot
def _tick(c):
    """Process one clock."""
    c.clock += 1
    c.fresh = 0
    switches.look(c)
    encoder.look(c)
    goes = False
    if speeds.gated(c):
        pass
    elif c.zw > 0:
        c.zw -= 1
    else:
        goes = ramp.speed(c) and c.q > 0
    stallguard.settle(c)
    if goes:
        c.ph += c.q
        if c.ph >= state.STEP:
            c.ph -= state.STEP
            c.x = state.signed32(c.x + c.dir)
            if stallguard.step(c):
                _halt(c)
        if c.dir and c.reg[state.RAMPMODE] == state.POSITION and c.x == c.target and c.q <= ramp.low(c):
            _halt(c)
    bus.arrived(c)
    power.timers(c)
    power.faults(c)
    stallguard.blind(c)
    if encoder.deviates(c):
        c.enc_flags |= encoder.DEVIATION


@hot
def _steps(c, delta, m):
    """Count the steps that m clocks make."""
    return (c.ph + m * c.q + delta * (m * (m + 1) // 2)) >> 41


@hot
def _even(c, test, delta, m, step_limit, thresholds):
    """Return whether only steps happen within m clocks."""
    if _steps(c, delta, m) >= step_limit:
        return False
    if thresholds and delta and speeds.speeds_at(c, c.q + delta * m) != c.speeds:
        return False
    return ramp.holds(c, test, delta, m, _steps(c, delta, m - 1) if test == ramp.FALLING or test == ramp.SLOWING else 0)


@hot
def _limit_steps(c, watch):
    """Return the number of the step, counted from 1, at which something other than a step may happen."""
    ahead = ((c.target - c.x) * c.dir) & M32
    max_steps = ahead if ahead else 1 << 32
    if c.reg[state.RAMPMODE] == state.POSITION:
        n = abs(ramp.away(c))
        if ramp.wanted(c) != c.dir:
            max_steps = least(max_steps, (1 << 31) - n)
    if stallguard.measures(c):
        max_steps = least(max_steps, sequencer.steps_to_full(c))
    limit = c.reg[state.ENC_DEVIATION]
    if limit and not c.enc_flags & encoder.DEVIATION:
        max_steps = least(max_steps, limit - (c.x - c.enc) * c.dir + 1)
    if watch & EACH:
        return 1
    if watch & WATCH:
        ahead = ((c.reg[state.X_COMPARE] - c.x) * c.dir) & M32
        max_steps = least(max_steps, ahead if ahead else 1)
    return max_steps


@hot
def _leap(c, until, watch):
    """Process many clocks at once, up to `until`; return their number, or 0 where `_tick` has to process the next one."""
    if c.fresh:
        return 0
    m = least(until, power.next_timer(c)) - c.clock
    if encoder.watched(c) or (c.fed and watch & EDGES):
        m = least(m, encoder.next_edge(c) - c.clock - 1)
        if m == 0:
            return 0
    if speeds.gated(c):
        c.clock += m
        return m
    if c.zw > 0:
        m = least(m, c.zw)
        c.zw -= m
        c.clock += m
        return m
    if c.dir == 0:
        if ramp.starts(c):
            return 0
        c.clock += m
        return m
    test, delta, max_steps = ramp.plan(c)
    if test == ramp.CANNOT or max_steps == 0:
        return 0
    m = least(m, max_steps)
    m = least(m, MAX_LEAP_CLOCKS) if delta or c.q == 0 else least(m, ((1 << 61) - c.ph) // c.q)
    step_limit = _limit_steps(c, watch)
    thresholds = c.reg[state.TPWMTHRS] | c.reg[state.TCOOLTHRS] | c.reg[state.THIGH]
    if not _even(c, test, delta, m, step_limit, thresholds):
        low = 0
        while m - low > 1:
            middle = (low + m) >> 1
            if _even(c, test, delta, middle, step_limit, thresholds):
                low = middle
            else:
                m = middle
        m = low
    if m:
        _go(c, delta, m)
    return m


@hot
def _go(c, delta, m):
    """Process m clocks in which nothing but steps happens."""
    k = _steps(c, delta, m)
    if k:
        low, high = 0, m  # the clock of the last step
        while high - low > 1:
            middle = (low + high) >> 1
            if _steps(c, delta, middle) >= k:
                high = middle
            else:
                low = middle
        c.x = state.signed32(c.x + c.dir * k)
        c.reached = 0
        sequencer.steps(c, k, c.clock + high)
    c.ph = (c.ph + m * c.q + delta * (m * (m + 1) // 2)) & (state.STEP - 1)
    c.q += delta * m
    c.clock += m


@hot
def _on(c, until, watch):
    """Run to the next event, but not beyond `until`."""
    if _leap(c, until, watch):
        if c.fed:
            encoder.catch_up(c)
        power.timers(c)
    else:
        _tick(c)


@exported(None, STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        _on(c, until, 0)


# --- the functions for a stage, see stage/chips/cores.py; the only axis is 0 ---


@exported(None, STATE, "i8", "i8")
def window(c, row, k):
    """Compute the slices of a window."""
    run_window(c, row, k, run, net, drive_input)


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Connect an encoder to ENCA and ENCB: `count` edges now, and `rate` edges a clock."""
    encoder.set_shaft(c, count, rate)


@exported("f8", STATE, "i8")
def current(c, j):
    """Return the amplitude of the phase currents, A."""
    return power.amplitude(c)


@exported("i8", STATE, "i8", "f8", "f8")
def set_load(c, j, angle, emf):
    """Take a sample of the load, and return whether it can change anything.

    Args:
        c: State of the chip.
        j: Axis, 0.
        angle: Electrical radians by which the field leads the rotor.
        emf: Back EMF as a share of the supply.
    """
    sin, cos = sincos(angle)
    way = -c.dir if c.reg[state.GCONF] & state.SHAFT else c.dir
    sin *= way
    lam = 1024 if cos <= 0.0 else int(1024.0 * sin + 0.5) if sin > 0.0 else 0
    return stallguard.sample_load(c, lam, int(1024.0 * (emf if emf < 1.0 else 1.0) + 0.5))


@exported(None, STATE, "i8", "i8")
def load(c, lam, emf):
    """Set the load, 0 to 1024 each, of a chip that is not on a stage."""
    stallguard.load(c, lam, emf)


@exported("i8", STATE, "i8")
def net(c, j):
    """Return the position of the field: 1/256 full steps since power-up."""
    return c.net


@exported("f8", STATE, "i8", "i8", "f8")
def drive_input(c, j, before, ticks):
    """Return the mean position of the field over the last `ticks`."""
    return 0.5 * (before + c.net)


@hot
def _rate(c):
    """Return the rate of the field, 1/256 full steps a clock."""
    way = -c.dir if c.reg[state.GCONF] & state.SHAFT else c.dir
    return 0.0 if speeds.gated(c) else way * float(c.q) * (1 << state.mres(c)) / float(state.STEP)


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """Return the rate of the field, 1/256 full steps a second."""
    return _rate(c) * hz


@exported("i8", STATE, "i8")
def counter(c, j):
    """Return XACTUAL."""
    return c.x & M32


@exported("i8", STATE, "i8")
def inputs(c, j):
    """Return the levels of the input pins, as bits of INPUTS."""
    return c.inputs


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Set the levels of the input pins, except A and B of an encoder whose shaft is known.

    They act at the next clock; DRV_ENN acts at once.
    """
    if c.fed:
        word = word & ~encoder.PINS | c.inputs & encoder.PINS
    if word != c.inputs:
        c.inputs, c.fresh = word, 1


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Return the levels of the output pins, as bits of OUTPUTS."""
    return bus.outputs(c)


@exported("i8", STATE, "i8")
def status(c, j):
    """Return RAMP_STAT."""
    return bus.ramp_stat(c)


@exported("i8", STATE, "i8")
def busy(c, j):
    """Return whether a drive is in progress."""
    return bus.drives(c)


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return the value that a read cycle would find, without its side effects."""
    return bus.peek(c, address & 0xFF)


@exported("i8", STATE, "i8")
def read(c, address):
    """Make one read cycle on the bus."""
    return bus.peek(c, address & 0xFF)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """Make one write cycle on the bus, between two clocks."""
    bus.write(c, address & 0xFF, value)


@exported("i8", STATE, "i8")
def register(c, address):
    """Return the value that a register holds, also of one that cannot be read."""
    return bus.register(c, address)


@exported(None, STATE)
def power_up(c):
    """Turn a cleared record into a chip that was just switched on."""
    bus.power_up(c)


# --- the chip by itself ---


@exported("i8", STATE, "i8")
def advance(c, until):
    """Run up to clock `until`; return by how many 1/256 full steps the field has moved, counting both directions."""
    made = 0
    while c.clock < until:
        before = c.net
        _on(c, until, 0)
        made += abs(c.net - before)
    return made


@exported("i8", STATE, "i8", array_of(PULSE))
def trace(c, until, out):
    """Advance, and fill `out` with the pulses (PULSE records); return how many records all pulses would take."""
    made = 0
    while c.clock < until:
        before = c.net
        _on(c, until, EACH)
        way = 1 if c.net > before else -1
        for _ in range(abs(c.net - before)):
            if made < len(out):
                e = out[made]
                e.clock, e.axis, e.direction = c.clock, 0, way
            made += 1
    return made


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def mark(c, axis, out, k):
    """Write the present state of the chip to `out[k]` (an EDGE record)."""
    e = out[k]
    e.clock, e.inputs, e.outputs, e.counter, e.net, e.rate = (
        c.clock,
        c.inputs,
        bus.outputs(c),
        c.x & M32,
        c.net,
        _rate(c),
    )


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan(c, until, every_pulse, axis, out):
    """Advance, and fill `out` (EDGE records) with the changes of speed and pins.

    With `every_pulse`, every step and every edge of an encoder whose shaft is known gets a record. Returns the number of records.
    Stops early when `out` is almost full: look at the clock and call again.
    """
    k = 0
    while c.clock < until and k < len(out) - ROOM:
        word, rate, at, pins = bus.outputs(c), _rate(c), c.x, c.inputs
        _on(c, least(until, c.clock + FINE) if c.dir else until, EACH | EDGES if every_pulse else WATCH)
        if bus.outputs(c) != word or _rate(c) != rate or (every_pulse and (c.x != at or c.inputs != pins)):
            mark(c, axis, out, k)
            k += 1
    return k


@exported(
    "i8", STATE, "i8", "i8", "i8", array_of(EDGE),
    array_of("i8"), array_of("i8"), array_of("f8"), array_of("f8"), array_of("i8"),
)  # fmt: skip
def scan_shaft(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done):
    """Scan while the position of the shaft is sampled at `clocks`, see stage/chips/cores.py."""
    return scan_shafts(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done, scan, set_shaft)
