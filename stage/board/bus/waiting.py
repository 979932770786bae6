"""Advances time for a host, compiled: in a bus cycle, in a delay, in computing; and calls the hooks of interrupts."""

from __future__ import annotations

from stage.board.bus import host_record, interrupts
from stage.board.bus.host_record import call_python, stage_of
from stage.board.bus.interrupts import MARK, MARKED
from stage.chips import cores
from stage.native import array_at, greatest, hot, least, stack_mark
from stage.sim import records
from stage.sim.engine import advance
from stage.sim.handle import AXIS, INTEGER, clockwork, world

STACK_LEFT = 1 << 20
"""Bytes of the firmware's stack that hooks which interrupt each other leave."""


@hot
def _run(h, until):
    """Let the stage's time pass up to `until` ns; journals and recordings take part."""
    w = world(stage_of(h))
    while w.now < until and not h.stopped:
        status = advance(stage_of(h), until)
        if status == records.DIVERGED:
            call_python(h, host_record.DIVERGED)
        elif status == records.SAMPLES_FULL or status == records.EDGES_FULL:
            call_python(h, host_record.FULL)
        elif status != records.REACHED:
            h.call_value = until
            call_python(h, host_record.RUN_IN_PYTHON)
    h.reached = w.now


@hot
def catch_up(h):
    """Advance the whole stage to the host's time."""
    if h.ahead:
        ahead, h.ahead = h.ahead, 0
        _run(h, world(stage_of(h)).now + ahead)


@hot
def _find_quiet_time(h):
    """Find the time up to which nothing but the chips themselves moves: no edge, no end of a slice."""
    w, axes, dt = world(stage_of(h)), array_at(h.axes, h.n_axes, AXIS), clockwork(stage_of(h)).dt
    h.quiet = least(least(h.until, h.due), w.start + (w.slice + 1) * dt // records.SLICES)
    for a in range(len(axes)):
        h.quiet = least(h.quiet, axes[a].next_edge)
    if clockwork(stage_of(h)).linked:  # one of them alone cannot go ahead of the others
        h.quiet = 0


@hot
def _pass_time(h, ns):
    """Let `ns` pass; pause the firmware where it is to be paused on the way."""
    w, left = world(stage_of(h)), ns
    while left > 0 and not h.stopped:
        if w.now >= h.until:
            call_python(h, host_record.PAUSE)
            continue
        end = least(least(w.now + left, h.until), w.now + host_record.PAUSE_INTERVAL_NS)
        left -= end - w.now
        _run(h, end)


@hot
def _pass_cycle_time(h, ns):
    """Let the time of a bus cycle pass. While nothing but the chips moves, the stage follows later, and only the chip that the host
    accesses is advanced: all of them for each cycle would cost as much as the physics."""
    lazy = h.lazy and h.line_level <= h.level
    if lazy and host_record.now_of(h) + ns < h.quiet:
        h.ahead += ns
        return
    catch_up(h)
    _pass_time(h, ns)
    if host_record.now_of(h) >= h.due:
        interrupts.tick(h)
    if lazy:
        _find_quiet_time(h)


@hot
def advance_chip(h, chip):
    """Advance a chip to the host's time."""
    if h.ahead:
        c = host_record.chip_of(h, chip)
        cores.run(c, records.clock_at(host_record.now_of(h), c.hz))


@hot
def find_pulling(h):
    """Return the chips that pull the interrupt line, a bit each, and behind them the devices."""
    catch_up(h)
    irqs, pulling = array_at(h.irqs, h.n_chips, host_record.IRQ), 0
    for k in range(h.n_chips):
        irq = irqs[k]
        if irq.bits and cores.outputs(host_record.chip_of(h, k), irq.axis) & irq.bits:
            pulling |= 1 << k
    if h.n_devices:
        pulling |= host_record.pulling_devices(h) << h.n_chips
    return pulling


@hot
def call_hooks(h):
    """Let sources above the processor's level call their hooks."""
    if h.top_level > h.level:
        _call_hooks(h)


@hot
def _call_hooks(h):
    """Call hooks, that of the highest source first, until none is left."""
    calls = 0
    while h.top_level > h.level and not h.stopped:
        asserted = find_pulling(h) & h.hooked_lines if h.line_level > h.level else 0
        if asserted == 0 and h.n_pending == 0:
            return
        source = interrupts.choose(h, asserted)
        if source < 0:
            return
        if calls == host_record.STORM_CALLS:
            h.call_value = source
            call_python(h, host_record.STORM)
            return
        calls += 1
        _call_hook(h, source)


@hot
def _call_hook(h, source):
    """Call the hook of a source; the processor's level is as before when it has returned."""
    catch_up(h)
    s, level, outer, outer_number = interrupts.sources_of(h)[source], h.level, h.serving, 0
    mark, missed = stack_mark(MARK, MARKED), s.missed
    place = -1 if 0 < mark - h.stack_low < STACK_LEFT else interrupts.begin_hook(h, source, mark)
    if place < 0:
        h.call_value = -1
        call_python(h, host_record.STORM)
        return
    number, s.missed = h.called, 0
    host_record.trace_cycle(h, host_record.CALLED, source, missed, -1)
    host_record.call_outside(h, s.hook, s.argument)
    interrupts.end_hook(h, place, number, level, outer, outer_number, interrupts.BACK)


@hot
def _copy(source, target, words):
    a, b = array_at(source, words, INTEGER), array_at(target, words, INTEGER)
    for k in range(words):
        b[k] = a[k]


@hot
def _run_to_line(h, lines, end):
    """Advance to `end`, but no further than the end of the physics step; or to the ns at which one of the lines (bits) is
    asserted, if that comes before. They are off now, or their hooks were called."""
    w, dt = world(stage_of(h)), clockwork(stage_of(h)).dt
    stop = least(end, w.start + dt)
    inside = stop - 1 if stop == w.start + dt else stop  # where no physics has come between, time can be taken back
    begin, noted = w.now, h.noted
    _copy(h.userdata, h.before, h.words)
    _run(h, inside)
    if find_pulling(h) & lines == 0:
        _run(h, stop)
        return
    low, high = begin, inside  # off at `low`, asserted at `high`
    while high - low > 1:
        middle = (low + high) // 2
        _copy(h.before, h.userdata, h.words)
        h.noted = noted
        _run(h, middle)
        if find_pulling(h) & lines:
            high = middle
        else:
            low = middle
    _copy(h.before, h.userdata, h.words)
    h.noted = noted
    _run(h, high)


@hot
def wait(h, ns):
    """Let `ns` pass in a delay; an interrupt comes at the ns of its timer, or at which its line is asserted. The time that its hook
    takes is part of the delay."""
    catch_up(h)
    w = world(stage_of(h))
    end = w.now + ns
    while w.now < end and not h.stopped:
        stop = least(end, greatest(h.due, w.now + 1))
        if h.line_level <= h.level:
            _pass_time(h, stop - w.now)
        elif w.now >= h.until:
            call_python(h, host_record.PAUSE)
            continue
        else:
            _run_to_line(h, h.hooked_lines, least(stop, h.until))
        if w.now >= h.due:
            interrupts.tick(h)
        call_hooks(h)


@hot
def advance_host(h, until):
    """Advance the host's time to `until` ns, if it is not there."""
    ns = until - host_record.now_of(h)
    if ns > 0:
        _pass_cycle_time(h, ns)
        call_hooks(h)


@hot
def wait_for_line(h, ns):
    """Let time pass until the line is asserted, `ns` at most. Return 1 if it is, else 0."""
    asserted, w = find_pulling(h), world(stage_of(h))
    end = w.now + ns
    while not asserted and w.now < end and not h.stopped:
        if w.now >= h.until:
            call_python(h, host_record.PAUSE)
            continue
        _run_to_line(h, -1, least(end, h.until))
        asserted = find_pulling(h)
    if w.now >= h.due:
        interrupts.tick(h)
    return 1 if asserted else 0


@hot
def spend_computing(h):
    """Let the time pass that the firmware has computed since its last request."""
    counted = array_at(h.meter, 1, INTEGER)
    ps = h.rest + counted[0] * h.cost
    counted[0], h.rest = 0, ps % 1000
    ns = ps // 1000
    if ns > h.bus:
        wait(h, ns)
    elif ns > 0:
        _pass_cycle_time(h, ns)
        call_hooks(h)


@hot
def set_source(h, source, lines, settings, is_on):
    """Give a source another hook, or none. settings: number, level, period (ns), hook and argument."""
    catch_up(h)
    s = interrupts.sources_of(h)[source]
    s.level, s.hook, s.argument, s.lines = settings[1], settings[3] if is_on else 0, settings[4], lines
    s.period, s.next, s.missed = settings[2] if is_on else 0, host_record.now_of(h) + settings[2], 0
    if settings[2]:
        s.pending = 0
    interrupts.arm(h)
    h.quiet = 0
    call_hooks(h)


@hot
def pass_bus_cycle(h):
    """Let the time of one bus cycle pass."""
    if h.cycles >= h.max_cycles:
        catch_up(h)
        call_python(h, host_record.PAUSE)
        h.quiet = 0
    h.cycles += 1
    _pass_cycle_time(h, h.bus)
