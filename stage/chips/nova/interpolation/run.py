"""NOVA chips, compiled: interpolation. The profile of the main axis makes ticks; at each, an axis makes one pulse at most.

The k-th tick begins when the profile has come to place k; with constant vector speed a tick that moves two axes is sqrt2 places
from the one before, one that moves three sqrt3. The next tick is always prepared: its steps, directions, place and clock. When the
last tick of a segment has begun the next segment is taken from the pre-buffer, so that its first tick comes one period later.
"""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.functions import sync
from stage.chips.nova.interpolation import segment
from stage.chips.nova.motion import counters, drive, rates
from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.planner import from_here, pair, put, slow_down
from stage.chips.nova.motion.profile import piece_at, speed_at
from stage.chips.nova.motion.pulse_output import half_period
from stage.chips.nova.registers.mcx300 import MCX312_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.native import exported, greatest, hot, least

INTA, INTB = MCX514_MAP.mask("IPM", "INTA"), MCX514_MAP.mask("IPM", "INTB")
CIINT, BPINT = MCX312_MAP.mask("WR5", "CIINT"), MCX312_MAP.mask("WR5", "BPINT")


@hot
def reset(c):
    ip = c.ip
    c.interpolating = 0
    ip.enabled = ip.interrupt = ip.waiting = ip.head = ip.rotations = ip.writing = ip.stacked = 0
    ip.role = ip.waits = c.fails = c.failed = 0
    ip.due = state.NEVER
    for j in range(state.AXES):
        c.ax[j].interpolates = c.ax[j].moves = 0
    for k in range(len(ip.loading)):
        ip.loading[k] = 0


# --- start, segments, end ---


@hot
def place_for(c):
    """The place in the queue that takes the next segment."""
    return (c.ip.head + 1 + c.ip.waiting) % (state.STAGES + 1) if c.interpolating else c.ip.head


@hot
def refuse(c):
    """A segment that cannot be taken: an error of continuous interpolation, if there is one."""
    if c.interpolating and c.variant == state.MCX514_TYPE:
        c.ax[c.ip.main].causes |= state.E_CERR


@hot
def may_take(c, mask, depth):
    """Tell whether a segment can be written now, and note what is refused.

    Args:
        c: State of the chip.
        mask: Axes of the segment, as bits.
        depth: Segments that the queue holds.
    """
    if mask == 0:
        return False
    if c.interpolating:
        if mask != c.ip.mask or c.ip.waiting >= depth:
            refuse(c)
            return False
        return True
    for j in range(c.axes):
        x = c.ax[j]
        if mask >> j & 1 and (x.driving or x.waiting or x.home):
            return False
    return True


@hot
def submit(c, mask, main, depth, stepped):
    """Start the segment at `place_for`, or queue it behind those before it.

    Args:
        c: State of the chip.
        mask: Axes of the segment, as bits.
        main: Main axis.
        depth: Segments that the queue holds.
        stepped: Whether single steps move it.
    """
    ip = c.ip
    c.stale = 1
    if c.interpolating:
        ip.waiting += 1
        ip.continuous = 1
        return
    prepare(c, mask, main, depth, stepped)
    ip.role = 0
    start(c)


@hot
def prepare(c, mask, main, depth, stepped):
    """Prepare the axes of an interpolation that begins now, or when other chips do.

    Args:
        c: State of the chip.
        mask: Its axes, as bits.
        main: Main axis.
        depth: Segments that the queue holds.
        stepped: Whether single steps move it.
    """
    ip = c.ip
    ip.mask, ip.main, ip.depth, ip.stepped = mask, main, depth, stepped
    ip.continuous = ip.waiting = ip.slow = 0
    for j in range(c.axes):
        if ip.mask >> j & 1:
            y = c.ax[j]
            y.causes &= 0xFF
            y.done = y.slow = y.fixed = y.output = 0


@exported(None, state.STATE)
def start(c):
    """The prepared interpolation begins."""
    ip, x = c.ip, c.ax[c.ip.main]
    ip.began = c.clock
    put(ip.place, dd.ZERO)
    put(ip.begun, dd.ZERO)
    segment.find_end(c)
    if not segment.load(c):
        for j in range(c.axes):
            if ip.mask >> j & 1:
                drive.note(c.ax[j], state.D_STA | state.D_END)
        return
    segment.prepare(c)
    stopped = 0
    for j in range(c.axes):
        if c.ax[j].moves:
            stopped |= drive.blocked(c, c.ax[j], c.ax[j].way)
    if stopped:
        c.fails = ip.role
        return
    for j in range(c.axes):
        if ip.mask >> j & 1:
            c.ax[j].interpolates = state.MAIN if j == ip.main and ip.role != state.SLAVE else 1
            drive.note(c.ax[j], state.D_STA)
    c.interpolating = 1
    x.phase = state.NO_PHASE
    if ip.role == state.SLAVE:
        return
    rates.take_rates(c, x)
    segment.replan(c, x)


@hot
def end(c):
    """The interpolation ends now, and what waits is dropped."""
    ip = c.ip
    c.interpolating = ip.waiting = ip.slow = ip.stepped = ip.zone = ip.waits = 0
    ip.due = state.NEVER
    for j in range(c.axes):
        if c.ax[j].interpolates:
            drive.end(c, c.ax[j], 0)
    c.stale = 1


@exported(None, state.STATE)
def _after_the_last(c):
    """The last tick of a segment has begun: the next segment, or the end."""
    ip, x = c.ip, c.ax[c.ip.main]
    c.stale = 1
    ends = ip.ends
    while True:
        if ip.waiting == 0 or (ip.slow and x.end >= state.NEVER):
            end(c)
            return
        ip.waiting -= 1
        ip.head = (ip.head + 1) % (state.STAGES + 1)
        _ask(c)
        put(ip.begun, pair(ip.place))
        segment.find_end(c)
        if segment.load(c):
            break
    segment.prepare(c)
    if not ip.slow and not segment.sets_follow(c) and (ends or c.queue[ip.head].slows):
        segment.replan(c, x)
    else:
        segment.next_clock(c, x)


@hot
def _ask(c):
    """A segment has left the pre-buffer: interrupts."""
    ip = c.ip
    if c.variant == state.MCX514_TYPE:
        word = c.ax[0].mode[state.IPM]
        interrupts = (ip.waiting == 3 and word & INTA) or (ip.waiting == 7 and word & INTB)
    elif c.queue[ip.head].kind == state.PATTERN:
        interrupts = ip.waiting == 0 and c.outputs5 & BPINT
    else:
        interrupts = c.outputs5 & CIINT
    if interrupts:
        ip.interrupt = 1


# --- time ---


@hot
def _tick_rate(c):
    """Ticks per clock."""
    ip, x = c.ip, c.ax[c.ip.main]
    if ip.role == state.SLAVE:
        return 1.0 / ip.gap if ip.gap > 0 else 0.0
    return 0.0 if ip.waits else speed_at(x, c.clock - x.origin)


@hot
def tick(c):
    """The prepared tick begins, at the present clock."""
    ip, g = c.ip, c.queue[c.ip.head]
    if ip.closing:
        end(c)
        return
    if ip.role == state.MASTER:
        c.beats += 1
    off = c.clock + half_period(_tick_rate(c))
    for k in range(g.axes):
        if ip.step[k]:
            x = c.ax[g.axis[k]]
            counters.count(c, x, 1)
            x.high = off
            x.moment += x.way * c.clock
            x.shift += x.way
            if x.since == 0:
                x.since = c.clock
    ip.watch -= 1
    if ip.watch <= 0:
        c.stale = 1
    if ip.last:
        _after_the_last(c)
    else:
        segment.prepare(c)
        segment.next_clock(c, c.ax[ip.main])


@exported("i8", state.STATE, "i8")
def move(c, until):
    """Let the ticks up to a clock begin. Returns how far it came: it stops where something is to be looked at."""
    while c.ip.due <= until:
        c.clock = c.ip.due
        tick(c)
        if c.stale:
            return c.clock
    return until


@hot
def trace(c, until, out, k):
    """Move as `move` does, and log the pulses by clock, then axis.

    Args:
        c: State of the chip.
        until: Clock at the end.
        out: PULSE records.
        k: First record to fill.

    Returns:
        The clock that was reached, and the next record.
    """
    ip = c.ip
    while ip.due <= until:
        c.clock = ip.due
        g = c.queue[ip.head]
        for j in range(c.axes):
            for m in range(g.axes):
                if g.axis[m] == j and ip.step[m] and not ip.closing and k < len(out):
                    e = out[k]
                    e.clock, e.axis, e.direction = c.clock, j, c.ax[j].way
                    k += 1
        tick(c)
        if c.stale:
            return c.clock, k
    return until, k


@hot
def step(c):
    """What is due at the present clock; sets `stale` where it changes something."""
    if not c.interpolating:
        return
    ip, x = c.ip, c.ax[c.ip.main]
    stop = 0
    for j in range(c.axes):
        if c.ax[j].interpolates:
            stop = greatest(stop, c.ax[j].slow)
    if ip.waits or ip.role == state.SLAVE:
        if stop:
            c.fails = 1 if ip.role == state.SLAVE else 0
            end(c)
        return
    n = c.clock - x.origin
    if stop == drive.AT_ONCE or n >= x.end or (stop and ip.stepped):
        if ip.role == state.MASTER and errors(c) & ~ip.errors:
            c.fails = 1
        end(c)
        return
    s = piece_at(x, n)
    if stop and not ip.slow:
        ip.slow = 1
        if s < x.brake or not x.curved or c.variant == state.MCX514_TYPE:
            from_here(x, n)
            slow_down(x)
            segment.schedule(c, x)
        c.stale = 1
    elif not ip.slow and s < x.brake and ip.speed != segment.limited(c, x):
        segment.replan(c, x)
        c.stale = 1
    drive.watch_phase(x, c.clock - x.origin)


@hot
def errors(c):
    """Those of RR2, a byte an axis."""
    found = 0
    for j in range(c.axes):
        found |= (c.ax[j].causes & 0xFF) << 8 * j
    return found


@hot
def next_event(c):
    """The clock of the next event but ticks; how many of these may pass until somebody looks at a counter goes to `watch`."""
    ip, x = c.ip, c.ax[c.ip.main]
    ip.watch = state.NEVER
    for j in range(c.axes):
        y = c.ax[j]
        if y.interpolates:
            ip.watch = least(ip.watch, least(drive.pulses_ahead(c, y), sync.pulses_ahead(c, y)))
    if ip.waits or ip.role == state.SLAVE:
        return state.NEVER
    n = c.clock - x.origin
    s = piece_at(x, n)
    at = x.end
    if s + 1 < x.pieces:
        at = least(at, x.from_clock[s + 1])
    return x.origin + at if at < state.NEVER else state.NEVER


@hot
def single_step(c):
    """A command makes the next tick."""
    if c.interpolating and c.ip.stepped and not c.ip.waits and c.ip.role != state.SLAVE:
        tick(c)
        c.stale = 1


# --- what can be read ---


@hot
def rate(c, j):
    """Pulses per clock of an axis that takes part; the ticks of constant vector speed are taken as even."""
    ip, g = c.ip, c.queue[c.ip.head]
    share = 0.0
    for k in range(g.axes):
        if g.axis[k] == j:
            if g.kind == state.PATTERN:
                share = float(ip.step[k])
            elif g.kind == state.LINE or k >= 2:
                share = abs(g.finish[k]) / greatest(g.longest, 1)
            else:
                u, v = abs(ip.arc.x), abs(ip.arc.y)
                share = (v if k == 0 else u) / greatest(greatest(u, v), 1)
    return share * _tick_rate(c)


@hot
def next_tick(c):
    """The clock of the next tick."""
    return c.ip.due
