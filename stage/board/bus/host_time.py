"""Advance the time of a host, compiled: in bus cycles, delays and computing. Due interrupt hooks are called on the way."""

from __future__ import annotations

from stage.board.bus import host_record, interrupt_controller
from stage.board.bus.host_record import call_python, get_stage_handle
from stage.board.bus.interrupt_controller import MARK, MARKED
from stage.chips import core_interface
from stage.native import array_at, greatest, hot, least, stack_mark
from stage.sim import engine_records
from stage.sim.compiled_stage_access import AXIS, INTEGER, get_clockwork, get_world
from stage.sim.engine import advance

MIN_FREE_STACK_BYTES = 1 << 20
"""Bytes of the firmware's stack that nested hooks must leave free."""


@hot
def _run_stage(host, until):
    """Advance the stage to `until` ns, with journals and recordings."""
    w = get_world(get_stage_handle(host))
    while w.now < until and not host.stopped:
        status = advance(get_stage_handle(host), until)
        if status == engine_records.DIVERGED:
            call_python(host, host_record.DIVERGED)
        elif status == engine_records.SAMPLES_FULL or status == engine_records.EDGES_FULL:
            call_python(host, host_record.FULL)
        elif status != engine_records.REACHED:
            host.call_value = until
            call_python(host, host_record.RUN_IN_PYTHON)
    host.reached = w.now


@hot
def advance_stage_to_host(host):
    """Advance the whole stage to the time of the host."""
    if host.ahead:
        ahead, host.ahead = host.ahead, 0
        _run_stage(host, get_world(get_stage_handle(host)).now + ahead)


@hot
def _update_quiet_time(host):
    """Compute the time, ns, up to which only chips change: no switch edge and no end of a drive's slice comes before it."""
    w, axes, dt = (
        get_world(get_stage_handle(host)),
        array_at(host.axes, host.n_axes, AXIS),
        get_clockwork(get_stage_handle(host)).dt,
    )
    host.quiet = least(least(host.until, host.due), w.start + (w.slice + 1) * dt // engine_records.SLICES)
    for a in range(len(axes)):
        host.quiet = least(host.quiet, axes[a].next_edge)
    if get_clockwork(get_stage_handle(host)).linked:  # one of them alone cannot go ahead of the others
        host.quiet = 0


@hot
def _pass_time(host, ns):
    """Let `ns` of host time pass, and pause the firmware where it reaches the limit of its run."""
    w, left = get_world(get_stage_handle(host)), ns
    while left > 0 and not host.stopped:
        if w.now >= host.until:
            call_python(host, host_record.PAUSE)
            continue
        end = least(least(w.now + left, host.until), w.now + host_record.PAUSE_INTERVAL_NS)
        left -= end - w.now
        _run_stage(host, end)


@hot
def _pass_cycle_time(host, ns):
    """Let the time of a bus cycle pass.

    While only the chips change, the stage stays behind the host, and only the accessed chip advances. Advancing all chips in
    each cycle would cost as much as the physics.
    """
    lazy = host.lazy and host.hooked_interrupt_level <= host.level
    if lazy and host_record.get_now(host) + ns < host.quiet:
        host.ahead += ns
        return
    advance_stage_to_host(host)
    _pass_time(host, ns)
    if host_record.get_now(host) >= host.due:
        interrupt_controller.mark_due_timers(host)
    if lazy:
        _update_quiet_time(host)


@hot
def advance_chip(host, chip):
    """Advance one chip to the host's time."""
    if host.ahead:
        c = host_record.get_chip(host, chip)
        core_interface.run(c, engine_records.compute_clock_at(host_record.get_now(host), c.hz))


@hot
def find_interrupt_mask(host):
    """Return a bit mask of the chips and devices that pull the interrupt line: first the chips, then the devices."""
    advance_stage_to_host(host)
    irqs, pulling = array_at(host.irqs, host.n_chips, host_record.IRQ), 0
    for k in range(host.n_chips):
        irq = irqs[k]
        c = host_record.get_chip(host, k)
        is_pulling = irq.bits and core_interface.read_outputs(c, irq.axis) & irq.bits
        if is_pulling or (irq.watched and (core_interface.read_inputs(c, 0) ^ irq.levels) & irq.watched):
            pulling |= 1 << k
    if host.n_devices:
        pulling |= host_record.find_interrupting_devices(host) << host.n_chips
    return pulling


@hot
def call_hooks(host):
    """Call the interrupt hooks whose level is above the present interrupt level of the processor."""
    if host.top_level > host.level:
        _call_hooks(host)


@hot
def _call_hooks(host):
    """Call interrupt hooks, the one with the highest level first, until no interrupt is pending."""
    calls = 0
    while host.top_level > host.level and not host.stopped:
        asserted = (
            find_interrupt_mask(host) & host.hooked_interrupt_mask if host.hooked_interrupt_level > host.level else 0
        )
        if asserted == 0 and host.n_pending == 0:
            return
        source = interrupt_controller.choose_source(host, asserted)
        if source < 0:
            return
        if calls == host_record.STORM_CALLS:
            host.call_value = source
            call_python(host, host_record.STORM)
            return
        calls += 1
        _call_hook(host, source)


@hot
def _call_hook(host, source):
    """Call the interrupt hook of a source, and restore the processor's interrupt level after it."""
    advance_stage_to_host(host)
    s, level, outer, outer_number = interrupt_controller.get_sources(host)[source], host.level, host.serving, 0
    mark, missed = stack_mark(MARK, MARKED), s.missed
    place = (
        -1 if 0 < mark - host.stack_low < MIN_FREE_STACK_BYTES else interrupt_controller.enter_hook(host, source, mark)
    )
    if place < 0:
        host.call_value = -1
        call_python(host, host_record.STORM)
        return
    number, s.missed = host.called, 0
    host_record.append_to_trace(host, host_record.CALLED, source, missed, -1)
    host_record.call_host_function(host, s.hook, s.argument)
    interrupt_controller.end_hook(host, place, number, level, outer, outer_number, interrupt_controller.BACK)


@hot
def _copy_words(source, target, words):
    """Copy `words` 64-bit words from one address to another."""
    a, b = array_at(source, words, INTEGER), array_at(target, words, INTEGER)
    for k in range(words):
        b[k] = a[k]


@hot
def _run_until_interrupt(host, interrupt_mask, end):
    """Advance to the earliest of `end`, the end of the physics step and the nanosecond at which one of some lines is asserted.

    Args:
        host: The HOST record.
        interrupt_mask: Bit mask of the interrupt lines. None of them is asserted now, or their hooks were called.
        end: Time, ns.
    """
    w, dt = get_world(get_stage_handle(host)), get_clockwork(get_stage_handle(host)).dt
    stop = least(end, w.start + dt)
    inside = stop - 1 if stop == w.start + dt else stop  # where no physics has come between, time can be taken back
    begin, noted = w.now, host.noted
    _copy_words(host.userdata, host.before, host.words)
    _run_stage(host, inside)
    if find_interrupt_mask(host) & interrupt_mask == 0:
        _run_stage(host, stop)
        return
    low, high = begin, inside  # off at `low`, asserted at `high`
    while high - low > 1:
        middle = (low + high) // 2
        _copy_words(host.before, host.userdata, host.words)
        host.noted = noted
        _run_stage(host, middle)
        if find_interrupt_mask(host) & interrupt_mask:
            high = middle
        else:
            low = middle
    _copy_words(host.before, host.userdata, host.words)
    host.noted = noted
    _run_stage(host, high)


@hot
def wait(host, ns):
    """Let `ns` pass in a delay of the host, and call each interrupt hook at the exact nanosecond of its timer or line.

    The time that a hook takes is part of the delay.
    """
    advance_stage_to_host(host)
    w = get_world(get_stage_handle(host))
    end = w.now + ns
    while w.now < end and not host.stopped:
        stop = least(end, greatest(host.due, w.now + 1))
        if host.hooked_interrupt_level <= host.level:
            _pass_time(host, stop - w.now)
        elif w.now >= host.until:
            call_python(host, host_record.PAUSE)
            continue
        else:
            _run_until_interrupt(host, host.hooked_interrupt_mask, least(stop, host.until))
        if w.now >= host.due:
            interrupt_controller.mark_due_timers(host)
        call_hooks(host)


@hot
def advance_host(host, until):
    """Advance the host's time to `until`, ns since power-up, if that is later than the present time."""
    ns = until - host_record.get_now(host)
    if ns > 0:
        _pass_cycle_time(host, ns)
        call_hooks(host)


@hot
def wait_for_line(host, ns):
    """Let at most `ns` of host time pass until the interrupt line is asserted. Return 1 if it is asserted, else 0."""
    asserted, w = find_interrupt_mask(host), get_world(get_stage_handle(host))
    end = w.now + ns
    while not asserted and w.now < end and not host.stopped:
        if w.now >= host.until:
            call_python(host, host_record.PAUSE)
            continue
        _run_until_interrupt(host, -1, least(end, host.until))
        asserted = find_interrupt_mask(host)
    if w.now >= host.due:
        interrupt_controller.mark_due_timers(host)
    return 1 if asserted else 0


@hot
def pass_computing_time(host):
    """Let the time pass that the firmware has spent computing since its last request."""
    counted = array_at(host.meter, 1, INTEGER)
    ps = host.rest + counted[0] * host.cost
    counted[0], host.rest = 0, ps % 1000
    ns = ps // 1000
    if ns > host.bus:
        wait(host, ns)
    elif ns > 0:
        _pass_cycle_time(host, ns)
        call_hooks(host)


@hot
def set_source_hook(host, source, interrupt_mask, settings, is_on):
    """Set or remove the hook of an interrupt source.

    Args:
        host: The HOST record.
        source: Index of the source.
        interrupt_mask: Bit mask of the interrupt lines that assert it.
        settings: Five int64: number, level, period (ns), hook, argument.
        is_on: Whether the source has a hook from now on.
    """
    advance_stage_to_host(host)
    s = interrupt_controller.get_sources(host)[source]
    s.level, s.hook, s.argument, s.interrupt_mask = (
        settings[1],
        settings[3] if is_on else 0,
        settings[4],
        interrupt_mask,
    )
    s.period, s.next, s.missed = settings[2] if is_on else 0, host_record.get_now(host) + settings[2], 0
    if settings[2]:
        s.pending = 0
    interrupt_controller.update_source_summary(host)
    host.quiet = 0
    call_hooks(host)


@hot
def pass_bus_cycle(host):
    """Let the time of one bus cycle pass."""
    if host.cycles >= host.max_cycles:
        advance_stage_to_host(host)
        call_python(host, host_record.PAUSE)
        host.quiet = 0
    host.cycles += 1
    _pass_cycle_time(host, host.bus)
