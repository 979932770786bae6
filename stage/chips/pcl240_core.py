"""PCL-240 family, compiled: one record holds a chip; `advance` jumps from event to event, never clock by clock.

Between two events the speed is constant, so phase, pulses and R0 follow in closed form from exact integers:

    phase(n) = phase + n speed        pulses = phase(n) // M        M = 8192 R7        POUT low while phase < M / 2

An event is a speed step of a ramp, R0 reaching 0 or falling below R6, the end of a pulse that outlives its run, a
changed input, or a bus write. The order inside a tick, and the names of the steps, are those of the normative model:
1 limit switches, 2 pulse, 3 speed.
"""

from __future__ import annotations

import numpy as np

from stage.compiled import hot, record

REGISTERS = 8
COUNTER_MASK = 0xFFFFFF

STATE = record(
    [
        (name, "i8")
        for name in (
            "clock phase speed timer ramp running finishing armed low "  # low: POUT is low, a pulse is in progress
            "ramps select decel int_at_stop irq "  # operating-mode command
            "origin sd_enable preset minus "  # control-mode command
            "selected output "  # register-select and output-mode commands
            "inputs sampled total net"  # pins now and at the last tick; pulses begun ever, and + minus -
        ).split()
    ]
    + [("reg", "i8", (REGISTERS,)), ("mask", "i8", (REGISTERS,))]
)
"""One chip. `mask` holds the width of each register, so that variants differ by data alone."""

EL_PLUS, EL_MINUS, SD_PLUS, SD_MINUS, ORG, INS, EXTP = (1 << k for k in range(7))
INPUTS = {
    "el_plus": EL_PLUS,
    "el_minus": EL_MINUS,
    "sd_plus": SD_PLUS,
    "sd_minus": SD_MINUS,
    "org": ORG,
    "ins": INS,
    "extp": EXTP,
}
OTS, POUT, PDIR, HOLD, FDOWN, FKEEP, FUP, LT, ZERO, IRQ = (1 << k for k in range(10))
OUTPUTS = {
    "ots": OTS,
    "pout": POUT,
    "pdir": PDIR,
    "hold": HOLD,
    "fdown": FDOWN,
    "fkeep": FKEEP,
    "fup": FUP,
    "lt": LT,
    "zero": ZERO,
    "irq": IRQ,
}
INDEPENDENT, EXTERNAL, OTS_LEVEL = 0x01, 0x10, 0x20  # bits of the output-mode command

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs speed multiplier r0 net".split()])


@hot
def reset(c):
    """The /RESET pin: everything 0 except `armed`; the clock, the input pins and the pulse totals go on."""
    c.phase = c.speed = c.timer = c.ramp = c.running = c.finishing = c.low = 0
    c.armed = 1
    c.ramps = c.select = c.decel = c.int_at_stop = c.irq = 0
    c.origin = c.sd_enable = c.preset = c.minus = 0
    c.selected = c.output = 0
    for k in range(REGISTERS):
        c.reg[k] = 0


@hot
def _selected_speed(c):
    if c.select == 1:
        return c.reg[2]
    if c.select == 3:
        return c.reg[3]
    return c.reg[1]


@hot
def _slowed(c):
    """SD enabled and the SD switch of the direction asserted."""
    return c.sd_enable and c.inputs & (SD_MINUS if c.minus else SD_PLUS)


@hot
def goal_speed(c):
    """Where a ramp leads: FL or the selected register."""
    if c.decel or _slowed(c) or (c.preset and c.reg[0] < c.reg[6]):
        return c.reg[1]
    return _selected_speed(c)


@hot
def _end(c):
    c.finishing = 0
    if c.int_at_stop:
        c.irq = 1


@hot
def _stop(c):
    """Stop; a pulse in progress is completed first."""
    c.running = c.armed = c.decel = 0
    if c.low:
        c.finishing = 1
    else:
        _end(c)


@hot
def _blocked(c):
    """Step 1: a limit switch of the direction, or ORG during origin return."""
    return c.inputs & (EL_MINUS if c.minus else EL_PLUS) or (c.origin and c.inputs & ORG)


@hot
def _operate(c, value):
    """A command of group 00: start, stop, speed change."""
    c.int_at_stop = value >> 5 & 1
    if not c.int_at_stop:
        c.irq = 0
    start, stop = value & 0x10, value & 0x08
    if stop and not start:
        if c.running:
            _stop(c)
        c.armed = 1
    elif stop and c.running:
        if not value & 0x04 and not c.ramps:
            _stop(c)
        else:
            c.ramps = c.decel = 1
            if c.speed <= c.reg[1]:
                _stop(c)
    elif start and not stop:
        if c.running:
            c.ramps, c.select, c.decel = value >> 2 & 1, value & 3, 0
        elif c.armed and not c.finishing and not _blocked(c) and not (c.preset and c.reg[0] == 0):
            c.ramps, c.select, c.decel = value >> 2 & 1, value & 3, 0
            c.speed = c.reg[1] if c.ramps else _selected_speed(c)
            c.phase = c.timer = c.ramp = 0
            c.running = 1


@hot
def _write(c, address, value):
    address &= 3
    value &= 0xFF
    if address:
        shift = 8 * (address - 1)
        k = c.selected
        c.reg[k] = (c.reg[k] & ~(0xFF << shift) | value << shift) & c.mask[k]
        if k == 7:
            c.phase = min(c.phase, max(8192 * c.reg[7] - 1, 0))
        return
    group = value >> 6
    if group == 0:
        _operate(c, value)
    elif group == 1:
        c.origin, c.sd_enable, c.preset, c.minus = value & 1, value >> 1 & 1, value >> 2 & 1, value >> 3 & 1
    elif group == 2:
        c.selected = value & 7
    else:
        c.output = value & 0x3F


@hot
def outputs(c):
    """The output pins, a bit mask of OUTPUTS; set = asserted (active-low pins: low)."""
    word = 0 if c.running or c.finishing else HOLD
    goal = goal_speed(c)
    if not c.running or not c.ramps or c.speed == goal:
        word |= FKEEP
    elif c.speed < goal:
        word |= FUP
    else:
        word |= FDOWN
    if c.output & INDEPENDENT:
        if c.low:
            word |= PDIR if c.minus else POUT
    else:
        word |= (POUT if c.low else 0) | (PDIR if c.minus else 0)
    if c.reg[0] < c.reg[6]:
        word |= LT
    if c.reg[0] == 0:
        word |= ZERO
    if c.output & OTS_LEVEL:
        word |= OTS
    if c.irq:
        word |= IRQ
    return word


@hot
def pulse_rate(c, hz):
    """Output frequency now, pulses per second (data sheet section 4, R7)."""
    if (c.running or c.finishing) and c.reg[7] >= 2:
        return c.speed * hz / (8192.0 * c.reg[7])
    return 0.0


@hot
def mean_count(c, before, ticks):
    """Mean over the last `ticks` of the net pulse count, which was `before` at their start.

    The last pulse began phase / speed ticks ago, the ones before it a period apart each.
    """
    n = abs(c.net - before)
    if n == 0:
        return float(c.net)
    if not (c.running or c.finishing) or c.speed == 0:
        return 0.5 * (before + c.net)
    ago = (n * c.phase + 4096.0 * c.reg[7] * n * (n - 1)) / c.speed
    missing = n - min(ago / ticks, float(n))  # pulses x the part of the time in which they were still to come
    return c.net - missing if c.net > before else c.net + missing


@hot
def _read(c, address):
    address &= 3
    if address:
        return c.reg[0] >> 8 * (address - 1) & 0xFF
    word = outputs(c)
    status = 0 if word & IRQ else 0x80
    if not word & HOLD:
        status |= 0x40
    if word & FKEEP:
        status |= 0x20
    if word & LT:
        status |= 0x10
    if word & ZERO:
        status |= 0x08
    if c.inputs & (SD_MINUS if c.minus else SD_PLUS):
        status |= 0x04
    if c.inputs & ORG:
        status |= 0x02
    if c.inputs & INS:
        status |= 0x01
    return status


@hot
def _sample(c):
    """What a changed input does at the tick that first sees it: EXTP counts on its rising edge, switches stop."""
    if c.sampled & EXTP and not c.inputs & EXTP and c.output & EXTERNAL:
        c.reg[0] = (c.reg[0] - 1) & COUNTER_MASK
        if c.running and c.preset and c.reg[0] == 0:
            _stop(c)
    c.sampled = c.inputs


@hot
def _finish(c, n):
    """Ticks of a chip that is not running: complete the last pulse, or idle."""
    s = n
    if c.finishing and c.speed > 0 and c.reg[7] >= 2:
        half = 4096 * c.reg[7]
        s = max(1, -((c.phase - half) // c.speed))
        if s > n:
            s = n
        c.phase += s * c.speed
        if c.phase >= half:
            c.low = 0
            _end(c)
    c.clock += s
    return s


@hot
def _until_step(c, goal):
    """Ticks for which the speed surely holds, plus one: the next tick at which step 3 may change something."""
    if not c.ramps:
        return 1 if c.speed != _selected_speed(c) else 1 << 40
    if c.decel and c.speed <= c.reg[1]:
        return 1
    if c.speed == goal:
        return 1 << 40
    if c.ramp != (1 if c.speed < goal else -1):
        return 1
    rate = c.reg[4] if c.ramp > 0 else c.reg[5]
    return max(1, rate - c.timer) if rate >= 2 else 1 << 40


@hot
def _step_speed(c):
    """Step 3 of one tick."""
    if not c.ramps:
        c.speed = _selected_speed(c)
        c.ramp = 0
        return
    goal = goal_speed(c)
    if c.speed == goal:
        c.ramp = 0
    else:
        way = 1 if c.speed < goal else -1
        first = c.ramp != way
        if first:
            c.ramp = way
            c.timer = 0
        c.timer += 1
        rate = c.reg[4] if way > 0 else c.reg[5]
        if rate >= 2 and (c.timer >= rate or (first and way < 0)):
            c.speed += way
            c.timer = 0
    if c.decel and c.speed <= c.reg[1]:
        _stop(c)


@hot
def _span(c, n):
    """Run at least one and at most `n` ticks, up to the next event; returns the ticks run."""
    ran = c.running
    if c.inputs != c.sampled:
        _sample(c)
    if c.running and _blocked(c):
        _stop(c)
    if not c.running:  # a stop has its own tick, so that `scan` sees the edge of HOLD there and not after the idle ones
        return _finish(c, 1 if ran else n)
    goal = goal_speed(c)
    s = min(n, _until_step(c, goal))
    pulses = 0
    own = not c.output & EXTERNAL
    r0 = c.reg[0]
    if c.reg[7] >= 2 and c.speed > 0:
        m = 8192 * c.reg[7]
        end = c.phase + s * c.speed
        pulses = end // m
        if pulses and (own or (c.preset and r0 == 0)):
            # the next pulse after which R0 means something else: 0, below R6, or wrapped
            far = r0 if r0 else 1
            if 0 < c.reg[6] <= r0:
                far = r0 - c.reg[6] + 1
            if pulses >= far:
                pulses = far
                s = -((c.phase - far * m) // c.speed)
                end = c.phase + s * c.speed
        c.phase = end - pulses * m
        if pulses or c.low:
            c.low = 1 if 2 * c.phase < m else 0
    if s > 1 and c.ramps:  # step 3 of the ticks before the last
        if c.speed == goal:
            c.ramp = 0
        else:
            c.timer += s - 1
    c.clock += s
    if pulses:
        c.total += pulses
        c.net += -pulses if c.minus else pulses
        if own:
            c.reg[0] = (r0 - pulses) & COUNTER_MASK
        if c.preset and c.reg[0] == 0:
            _stop(c)
            return s
    _step_speed(c)
    return s


@hot
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        if not (c.running or c.finishing) and c.inputs == c.sampled:
            c.clock = until
        else:
            _span(c, until - c.clock)


@hot
def _pulse_bit(c):
    """The pin that carries the pulses of the present direction."""
    return PDIR if c.output & INDEPENDENT and c.minus else POUT


@hot
def _log(c, out, k, clock, word, r0, net):
    e = out[k]
    e.clock, e.outputs, e.inputs, e.r0, e.net = clock, word, c.inputs, r0, net
    e.speed = c.speed if c.running or c.finishing else 0
    e.multiplier = c.reg[7]
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
            out[k - 1].r0, out[k - 1].net = r0, net
            low = 1
        rise = max(1, -((phase - j * m - m // 2) // c.speed))
        if low and rise <= s and (j == pulses or rise < -((phase - (j + 1) * m) // c.speed)):
            k = _log(c, out, k, clock + rise, base, r0, net)
            low = 0
    return k


@hot
def mark(rows, i, out, k):
    """Write chip `i` as it stands to `out[k]` (an EDGE record)."""
    c = rows[i]
    _log(c, out, k, c.clock, outputs(c), c.reg[0], c.net)


@hot
def scan(rows, i, until, every_pulse, out):
    """As advance, and fills `out` (EDGE records) with every change of speed or of an output pin, POUT's edges only with
    `every_pulse`. Returns how many; stops early when `out` is almost full: look at the clock and call again."""
    c = rows[i]
    k = 0
    while c.clock < until and k < len(out) - 8:
        if not (c.running or c.finishing) and c.inputs == c.sampled:
            c.clock = until
            break
        n = until - c.clock
        pulsing = every_pulse and c.speed > 0 and c.reg[7] >= 2
        if pulsing:
            n = min(n, max(1, (len(out) - 8 - k) // 2 * 4096 * c.reg[7] // c.speed))
        clock, phase, low, r0, net, total = c.clock, c.phase, c.low, c.reg[0], c.net, c.total
        speed, word, bit = c.speed, outputs(c), _pulse_bit(c)
        s = _span(c, n)
        pulses = c.total - total
        after = c.speed
        if pulsing and (pulses or low != c.low):
            c.speed = speed
            k = _log_pulses(c, out, k, clock, phase, low, s, pulses, word & ~bit, r0, net)
            c.speed = after
        new = outputs(c)
        changed = (new ^ word) & ~bit
        if after != speed or changed:
            k = _log(c, out, k, c.clock, new, c.reg[0], c.net)
    return k


@hot
def power_up(rows, i):
    """A cleared record becomes a chip that was just switched on."""
    reset(rows[i])


@hot
def write(rows, i, address, value):
    """One bus write cycle to chip `i`, between two ticks."""
    _write(rows[i], address, value)


@hot
def read(rows, i, address):
    """One bus read cycle from chip `i`."""
    return _read(rows[i], address)


@hot
def set_inputs(rows, i, axis, word):
    """Set the input pins of chip `i`, see INPUTS."""
    rows[i].inputs = word


@hot
def pins(rows, i):
    """Output pins of chip `i`, see OUTPUTS."""
    return outputs(rows[i])


@hot
def advance(rows, i, until):
    """Run chip `i` up to clock `until`; returns the pulses begun."""
    c = rows[i]
    before = c.total
    run(c, until)
    return c.total - before


@hot
def trace(rows, i, until, out):
    """As advance, and fills `out` (PULSE records) with the pulses; `out` is long enough. Returns how many."""
    c = rows[i]
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
