"""PCL-240 family, compiled: `advance` jumps from event to event, never clock by clock.

Between two events the speed is constant, so phase, pulses and R0 follow in closed form from exact integers:

    phase(n) = phase + n speed        pulses = phase(n) // M        M = 8192 R7        POUT low while phase < M / 2

    phase   0 ... M/2 ... M=0          M/2            M=0
    POUT    |_________|-----------------|_________|-------      low is asserted; the pulse is counted where it begins
    ramp    R1 R1+1 R1+2 ... R2 R2 R2 ... R2-1 ... R1 R1        speed: a step every R4 (up) or R5 (down) clocks
            FUP              FKEEP        FDOWN    FKEEP

An event is a speed step of a ramp, R0 reaching 0, falling below R6 or to the automatic ramp-down point, the end of a pulse
that outlives its run, a changed input, or a bus write. The order inside a tick, and the names of the steps, are those of
the normative model: 1 limit switches, 2 pulse, 3 speed.
"""

from __future__ import annotations

from stage.chips.cores import through
from stage.chips.pcl240.bus import blocked, read_byte, register, write_byte
from stage.chips.pcl240.bus import outputs as output_word
from stage.chips.pcl240.ramp import NEVER, goal_speed, linear_rate, margin, next_step, step_speed, until_step, watching
from stage.chips.pcl240.state import (
    COUNTER_MASK,
    EDGE,
    EL_MINUS,
    EL_PLUS,
    EXTERNAL,
    EXTP,
    EZ,
    EZ_COUNT,
    EZ_FROM_FL,
    EZ_MOST,
    EZ_RETURN,
    INDEPENDENT,
    INPUTS,
    ORG,
    OUTPUTS,
    PDIR,
    POUT,
    PULSE,
    R10,
    R13,
    S_OPERATING,
    STATE,
    end,
    reset,
    stop,
)
from stage.native import array_of, exported, greatest, hot, least

FOREVER = 1 << 62

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "busy", "counter", "inputs", "mark", "drive_input", "net",
           "outputs", "peek", "power_up", "pulse_rate", "read", "run", "scan", "set_shaft",
           "set_input", "status", "trace",
           "value", "write"]  # fmt: skip


# --- what a stage asks, see stage/chips/cores.py; the only axis is 0 ---


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
    c.inputs = word


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
    return read_byte(c, 0) & S_OPERATING


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Output pins, see OUTPUTS."""
    return output_word(c)


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """Output frequency now, pulses per second (data sheet section 4, R7)."""
    if (c.running or c.finishing) and c.reg[7] >= 2:
        return c.speed * hz / (8192.0 * c.reg[7])
    return 0.0


@exported("f8", STATE, "i8", "i8", "f8")
def drive_input(c, j, before, ticks):
    """Mean over the last `ticks` of the net pulse count, which was `before` at their start.

    The last pulse began phase / speed ticks ago, the ones before it a period apart each.
    """
    n = abs(c.net - before)
    if n == 0:
        return float(c.net)
    if not (c.running or c.finishing) or c.speed == 0:
        return 0.5 * (before + c.net)
    ago = n * c.phase + 4096.0 * c.reg[7] * n * (n - 1)  # x speed
    missing = n - least(
        ago / (c.speed * ticks), float(n)
    )  # pulses x the part of the time in which they were still to come
    return c.net - missing if c.net > before else c.net + missing


@hot
def _sample(c):
    """What a changed input does at the tick that first sees it: EXTP counts on its rising edge. Returns the pins that
    have become asserted."""
    struck = c.inputs & ~c.sampled
    if c.sampled & EXTP and not c.inputs & EXTP and c.output & EXTERNAL:
        c.reg[0] = (c.reg[0] - 1) & COUNTER_MASK
        if c.running and c.preset and c.reg[0] == 0:
            stop(c)
    c.sampled = c.inputs
    return struck


@hot
def _obey_switches(c, struck):
    """Step 1 where it has something to do: a limit, or ORG, and with an EZ return what comes after ORG."""
    if c.inputs & (EL_MINUS if c.minus else EL_PLUS):
        stop(c)
        return
    if c.origin and c.inputs & ORG:
        if not (c.extended and c.reg[R13] & EZ_RETURN):
            stop(c)
            return
        c.homing = 1
    if c.homing and not c.counting and (not c.reg[R13] & EZ_FROM_FL or not c.ramps or c.speed <= c.reg[1]):
        c.counting = 1
    if c.counting and struck & EZ:
        if not c.ez_running:
            c.ez_running, c.ez_left = 1, c.reg[R13] >> EZ_COUNT & EZ_MOST
        if c.ez_left == 0:
            stop(c)
        else:
            c.ez_left -= 1


@hot
def _finish(c, n):
    """Ticks of a chip that is not running: complete the last pulse, or idle."""
    s = n
    if c.finishing and c.speed > 0 and c.reg[7] >= 2:
        half = 4096 * c.reg[7]
        s = greatest(1, -((c.phase - half) // c.speed))
        if s > n:
            s = n
        c.phase += s * c.speed
        if c.phase >= half:
            c.low = 0
            end(c)
    c.clock += s
    return s


@hot
def _span(c, n):
    """Run at least one and at most `n` ticks, up to the next event; returns the ticks run."""
    ran, c.quiet = c.running, 0
    struck = _sample(c) if c.inputs != c.sampled else 0
    if c.running and (c.homing or blocked(c)):
        _obey_switches(c, struck)
    if not c.running:  # a stop has its own tick, so that `scan` sees the edge of HOLD there and not after the idle ones
        return _finish(c, 1 if ran else n)
    goal = goal_speed(c)
    s = until_step(c, goal)
    own = not c.output & EXTERNAL
    if s == NEVER and not c.homing and (not c.ramps or c.speed == goal):
        c.quiet = _next_event(c, own)
    s = least(n, s)
    pulses = 0
    if c.reg[7] >= 2 and c.speed > 0:
        m = 8192 * c.reg[7]
        ahead = c.phase + s * c.speed
        pulses = ahead // m
        if pulses:
            far = _pulses_to_event(c, own)
            if pulses >= far:
                pulses = far
                s = -((c.phase - far * m) // c.speed)
                ahead = c.phase + s * c.speed
        c.phase = ahead - pulses * m
        if pulses or c.low:
            c.low = 1 if 2 * c.phase < m else 0
    if s > 1 and c.ramps:  # step 3 of the ticks before the last
        if c.speed == goal:
            c.ramp = 0
        else:
            c.timer += s - 1
    c.clock += s
    if c.quiet < c.clock:
        c.quiet = 0  # over: what is left of it must not tell how time was cut
    if pulses:
        _count(c, pulses, own)
        if c.preset and c.reg[0] == 0:
            stop(c)
            return s
    step_speed(c)
    return s


@hot
def _pulses_to_event(c, own):
    """Pulses until R0 or the counter of the ramp means something else: 0, below R6, wrapped, the automatic point."""
    r0 = c.reg[0]
    far = NEVER
    if own or (c.preset and r0 == 0):
        far = r0 if r0 else 1
        if 0 < c.reg[6] <= r0:
            far = r0 - c.reg[6] + 1
    if not c.down and watching(c):
        closer = (1 if own else 0) + c.rising
        if closer:
            far = least(far, greatest(1, -(-margin(c) // closer)))
    return far


@hot
def _next_event(c, own):
    """At constant speed: the clock before that of the next pulse that is an event."""
    far = _pulses_to_event(c, own)
    if far == NEVER or c.speed == 0 or c.reg[7] < 2:
        return FOREVER
    return c.clock + (far * 8192 * c.reg[7] - c.phase - 1) // c.speed


@hot
def _cruise(c, until):
    """Run up to `until`, while all is quiet: what `_span` would do, without its questions."""
    ahead = c.phase + (until - c.clock) * c.speed
    c.clock = until
    if c.reg[7] < 2 or c.speed == 0:  # a pulse in progress never ends
        return
    m = 8192 * c.reg[7]
    pulses = 0
    if ahead >= m:
        pulses = 1 if ahead < 2 * m else ahead // m
        ahead -= pulses * m
    c.phase = ahead
    if pulses or c.low:
        c.low = 1 if 2 * ahead < m else 0
    if pulses:
        _count(c, pulses, not c.output & EXTERNAL)


@hot
def _climb(c, until):
    """Take the steps of a ramp, but not its last, that come up to `until` and before anything else happens."""
    goal, way = goal_speed(c), c.ramp
    rate, last = linear_rate(c, way), goal - way
    if c.rising != (1 if way > 0 else 0) or (last - c.speed) * way <= 0 or rate < 2 or c.reg[7] < 2:
        return
    if blocked(c) or c.homing or (c.decel and c.speed <= c.reg[1]) or (not c.down and watching(c)):
        return
    if c.curved and c.goal != goal:
        return
    own = not c.output & EXTERNAL
    m, far, begun = 8192 * c.reg[7], _pulses_to_event(c, own), 0
    clock, phase, speed = c.clock, c.phase, c.speed
    wait = (c.next if c.curved else rate) - c.timer
    while speed != last and 0 < wait <= until - clock:
        ahead = phase + wait * speed
        pulses = 0
        if ahead >= m:
            pulses = 1 if ahead < 2 * m else ahead // m
            if begun + pulses >= far:
                break
            begun += pulses
        phase = ahead - pulses * m
        clock += wait
        speed += way
        if c.curved:
            c.timer = c.next
            c.step += 1
            next_step(c)
            wait = c.next - c.timer
        else:
            c.timer = 0
            wait = rate
    if clock == c.clock:
        return
    moved = phase != c.phase  # a step from speed 0 comes before any
    c.clock, c.phase, c.speed = clock, phase, speed
    if begun or (c.low and moved):
        c.low = 1 if 2 * phase < m else 0
    if begun:
        _count(c, begun, own)


@hot
def _count(c, pulses, own):
    """`pulses` have begun."""
    way = -pulses if c.minus else pulses
    c.total += pulses
    c.net += way
    if c.rising:
        c.risen += pulses
    if own:
        c.reg[0] = (c.reg[0] - pulses) & COUNTER_MASK
    if c.position:
        c.reg[R10] = (c.reg[R10] + way) & COUNTER_MASK


@exported(None, STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        if c.inputs != c.sampled:
            _span(c, until - c.clock)
        elif c.quiet >= until:
            _cruise(c, until)
        elif not (c.running or c.finishing):
            c.clock = until
        else:
            if c.ramp and c.ramps and c.running:
                _climb(c, until)
            if c.clock < until:
                _span(c, until - c.clock)


@hot
def _pulse_bit(c):
    """The pin that carries the pulses of the present direction."""
    return PDIR if c.output & INDEPENDENT and c.minus else POUT


@hot
def _log(c, out, k, clock, word, r0, net):
    e = out[k]
    e.clock, e.outputs, e.inputs, e.counter, e.net = clock, word, c.inputs, r0, net
    e.speed = c.speed if c.running or c.finishing else 0
    e.rate = e.speed / (8192.0 * c.reg[7]) if c.reg[7] >= 2 else 0.0
    return k + 1


@hot
def _log_pulses(c, out, k, clock, phase, low, s, pulses, base, r0, net):
    """POUT's edges within a span of `s` ticks with `pulses` pulses that began at `clock` with `phase` and `low`."""
    m = 8192 * c.reg[7]
    bit = _pulse_bit(c)
    way = -1 if c.minus else 1
    own = 0 if c.output & EXTERNAL else 1
    for j in range(pulses + 1):
        if j:
            k = _log(c, out, k, clock - (phase - j * m) // c.speed, base | bit, r0, net)
            r0 = (r0 - own) & COUNTER_MASK
            net += way
            out[k - 1].counter, out[k - 1].net = r0, net
            low = 1
        rise = greatest(1, -((phase - j * m - m // 2) // c.speed))
        if low and rise <= s and (j == pulses or rise < -((phase - (j + 1) * m) // c.speed)):
            k = _log(c, out, k, clock + rise, base, r0, net)
            low = 0
    return k


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def mark(c, axis, out, k):
    """Write the chip as it stands to `out[k]` (an EDGE record)."""
    _log(c, out, k, c.clock, output_word(c), c.reg[0], c.net)


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan(c, until, every_pulse, axis, out):
    """As advance, and fills `out` (EDGE records) with every change of speed or of an output pin, POUT's edges only with
    `every_pulse`. Returns how many; stops early when `out` is almost full: look at the clock and call again."""
    k = 0
    while c.clock < until and k < len(out) - 8:
        if not (c.running or c.finishing) and c.inputs == c.sampled:
            c.clock = until
            break
        n = until - c.clock
        pulsing = every_pulse and c.speed > 0 and c.reg[7] >= 2
        if pulsing:
            n = least(n, greatest(1, (len(out) - 8 - k) // 2 * 4096 * c.reg[7] // c.speed))
        clock, phase, low, r0, net, total = c.clock, c.phase, c.low, c.reg[0], c.net, c.total
        speed, word, bit = c.speed, output_word(c), _pulse_bit(c)
        s = _span(c, n)
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
    through(c, row, k, run, net, drive_input)


@exported(None, STATE)
def power_up(c):
    """A cleared record becomes a chip that was just switched on."""
    reset(c)


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
    """What the k-th register reads as, free of bus cycles."""
    return register(c, k)


@exported("i8", STATE, "i8")
def advance(c, until):
    """Run up to clock `until`; returns the pulses begun."""
    before = c.total
    run(c, until)
    return c.total - before


@exported("i8", STATE, "i8", array_of(PULSE))
def trace(c, until, out):
    """As advance, and fills `out` (PULSE records) with the pulses; `out` is long enough. Returns how many."""
    k = 0
    while c.clock < until:
        if not (c.running or c.finishing) and c.inputs == c.sampled:
            c.clock = until
            break
        clock, phase, total, net = c.clock, c.phase, c.total, c.net
        speed = c.speed
        _span(c, until - c.clock)
        n = c.total - total
        if n:
            m = 8192 * c.reg[7]
            way = 1 if c.net > net else -1
            t = -((phase - m) // speed)
            rest = phase + t * speed - m  # phase just after the pulse began, < speed
            q = m // speed
            r = m - q * speed
            t += clock
            for _ in range(n):
                out[k].clock = t
                out[k].axis = 0
                out[k].direction = way
                k += 1
                if r > rest:
                    t += q + 1
                    rest += speed - r
                else:
                    t += q
                    rest -= r
    return k
