"""Advances time for a host, compiled: in a bus cycle, in a delay; and checks the interrupt line."""

from __future__ import annotations

from stage.board.host import (
    AT_ONCE,
    BY_HAND,
    CALLED,
    DIVERGED,
    FULL,
    IRQ,
    PAUSE,
    RETURNED,
    STORM,
    STORM_CALLS,
    ask,
    call_out,
    chip_of,
    now_of,
    stage_of,
)
from stage.board.notes import note
from stage.board.reaching import pulling as devices_pulling
from stage.chips import cores
from stage.native import array_at, hot, least
from stage.sim import handle, records
from stage.sim.handle import AXIS, WHOLE, clockwork, world


@hot
def _run(h, until):
    """Let the stage's time pass up to `until` ns; journals and recordings take part."""
    w = world(stage_of(h))
    while w.now < until and not h.stopped:
        status = handle.advance(stage_of(h), until)
        if status == records.DIVERGED:
            ask(h, DIVERGED)
        elif status == records.SAMPLES_FULL or status == records.EDGES_FULL:
            ask(h, FULL)
        elif status != records.REACHED:
            h.asked = until
            ask(h, BY_HAND)
    h.reached = w.now


@hot
def catch_up(h):
    """Advances the whole stage to the host's time."""
    if h.ahead:
        ahead, h.ahead = h.ahead, 0
        _run(h, world(stage_of(h)).now + ahead)


@hot
def _foresee(h):
    """Up to when nothing but the chips themselves moves: no edge, no end of a slice."""
    w, axes, dt = world(stage_of(h)), array_at(h.axes, h.n_axes, AXIS), clockwork(stage_of(h)).dt
    h.quiet = least(h.until, w.start + (w.slice + 1) * dt // records.SLICES)
    for a in range(len(axes)):
        h.quiet = least(h.quiet, axes[a].next_edge)


@hot
def _pass(h, ns):
    """`ns` pass; where the firmware is to stand still on the way, it does."""
    w, left = world(stage_of(h)), ns
    while left > 0 and not h.stopped:
        if w.now >= h.until:
            ask(h, PAUSE)
            continue
        end = least(least(w.now + left, h.until), w.now + AT_ONCE)
        left -= end - w.now
        _run(h, end)


@hot
def _pass_cycle(h):
    """A bus cycle's time passes. While nothing but the chips moves, the stage follows later, and of the chips only the one
    that the host turns to is taken along: all of them for each cycle would cost as much as the physics."""
    if h.lazy and h.hook == 0:
        if now_of(h) + h.bus < h.quiet:
            h.ahead += h.bus
            return
        catch_up(h)
        _pass(h, h.bus)
        _foresee(h)
    else:
        catch_up(h)
        _pass(h, h.bus)


@hot
def turn_to(h, chip):
    """Advances the chip to the host's time."""
    if h.ahead:
        c = chip_of(h, chip)
        cores.run(c, records.clock_at(now_of(h), c.hz))


@hot
def line_of(h):
    """The chips that pull the interrupt line, a bit each, and behind them the devices."""
    catch_up(h)
    irqs, pulling = array_at(h.irqs, h.n_chips, IRQ), 0
    for k in range(h.n_chips):
        irq = irqs[k]
        if irq.bits and cores.outputs(chip_of(h, k), irq.axis) & irq.bits:
            pulling |= 1 << k
    if h.n_devices:
        pulling |= devices_pulling(h) << h.n_chips
    return pulling


@hot
def serve(h):
    """The line is looked at: while it is asserted, the firmware's hook is called."""
    if h.hook == 0 or h.serving:
        return
    calls = 0
    while line_of(h) and h.hook and not h.stopped:
        if calls == STORM_CALLS:
            ask(h, STORM)
            return
        calls += 1
        note(h, CALLED, 0, 0, -1)
        h.serving = 1
        call_out(h, h.hook, h.argument)
        h.serving = 0
        note(h, RETURNED, 0, 0, -1)


@hot
def _copy(source, target, words):
    a, b = array_at(source, words, WHOLE), array_at(target, words, WHOLE)
    for k in range(words):
        b[k] = a[k]


@hot
def _to_line(h, end):
    """Advances to `end`, but no further than the end of the physics step; or to the ns at which the line is asserted, if that
    comes before. The line is off now, or its hook was called."""
    w, dt = world(stage_of(h)), clockwork(stage_of(h)).dt
    stop = least(end, w.start + dt)
    inside = stop - 1 if stop == w.start + dt else stop  # where no physics has come between, time can be taken back
    begin, noted = w.now, h.noted
    _copy(h.userdata, h.before, h.words)
    _run(h, inside)
    if not line_of(h):
        _run(h, stop)
        return
    low, high = begin, inside  # off at `low`, asserted at `high`
    while high - low > 1:
        middle = (low + high) // 2
        _copy(h.before, h.userdata, h.words)
        h.noted = noted
        _run(h, middle)
        if line_of(h):
            high = middle
        else:
            low = middle
    _copy(h.before, h.userdata, h.words)
    h.noted = noted
    _run(h, high)


@hot
def wait(h, ns):
    """`ns` pass in a delay; an interrupt comes at the ns at which the line is asserted. What its hook takes is part of the
    delay."""
    catch_up(h)
    w = world(stage_of(h))
    end = w.now + ns
    while w.now < end and not h.stopped:
        if h.hook == 0 or h.serving:
            _pass(h, end - w.now)
            return
        if w.now >= h.until:
            ask(h, PAUSE)
            continue
        _to_line(h, least(end, h.until))
        serve(h)


@hot
def reach(h, until):
    """The host's time gets to `until` ns, if it is not there."""
    ns = until - now_of(h)
    if ns <= 0:
        return
    if h.lazy and h.hook == 0 and until < h.quiet:
        h.ahead += ns
        return
    catch_up(h)
    _pass(h, ns)
    serve(h)
    _foresee(h)


@hot
def wait_for_line(h, ns):
    """Time passes until the line is asserted, `ns` at most. Returns 1 if it is, else 0."""
    asserted, w = line_of(h), world(stage_of(h))
    end = w.now + ns
    while not asserted and w.now < end and not h.stopped:
        if w.now >= h.until:
            ask(h, PAUSE)
            continue
        _to_line(h, least(end, h.until))
        asserted = line_of(h)
    return 1 if asserted else 0


@hot
def cycle(h):
    """The time of one bus cycle."""
    if h.cycles >= h.most_cycles:
        catch_up(h)
        ask(h, PAUSE)
        h.quiet = 0
    h.cycles += 1
    _pass_cycle(h)
