"""The interrupt controller of a board, compiled: sources with levels, timers, and the hooks that are being called.

A source calls its hook when its level is above the level of the processor. The processor then has the level of the source until the
hook returns. A line requests an interrupt as long as it is asserted. A timer or a software interrupt has one flag, which the call
clears; requests that come while the flag is set are missed, and counted.

A hook may also be left by a jump (longjmp). Its stack frame is then gone, and the interrupt is over. `end_abandoned_hooks` finds
this out at the next request, from the stack position of the request and from the mark on the stack below which the hook ran.
"""

from __future__ import annotations

from stage.board.bus.host_record import RETURNED, append_to_trace, get_now
from stage.native import array_at, greatest, hot, least, record
from stage.sim.compiled_stage_access import INTEGER

LINES, TIMERS, PYTHON_TIMERS, SOFTWARE = 62, 8, 4, 8
ANY_INTERRUPT_LINE, FIRST_INTERRUPT_LINE = 0, 1
FIRST_TIMER = FIRST_INTERRUPT_LINE + LINES
FIRST_PYTHON_TIMER = FIRST_TIMER + TIMERS
FIRST_SOFTWARE_SOURCE = FIRST_PYTHON_TIMER + PYTHON_TIMERS
SOURCE_COUNT = FIRST_SOFTWARE_SOURCE + SOFTWARE
HIGHEST_LEVEL = 15
NEVER = 1 << 62
FIRST_SOFTWARE_LINE = 64
"""Number of the first software interrupt among the numbers of lines."""

SOURCE = record([(name, "i8") for name in "level hook argument interrupt_mask period next pending missed".split()])
"""A source: its level (1 to 15), its hook (0: none), the mask of interrupt lines that assert it; of a timer the period (ns, 0: off)
and when it is next; whether its flag is set, and how often it came again since."""
MAX_HOOK_CALLS = 256
HOOK_CALL = record([(name, "i8") for name in "number source level outer outer_number mark".split()])
"""A hook that is being called: the number of the call (0: free), its source; the processor's level before; the hook that it has
interrupted (plus one, and that one's number); where the stack is marked."""
BACK, JUMPED, LOWERED = range(3)
"""Ways in which a hook ends, as the value of its trace line."""
MARK, MARKED = 32, 0x5053_4D41_524B
"""Length of a stack mark in words, and its first value."""
MAX_FRAME_DISTANCE_BYTES = 1 << 14
"""Maximum distance in bytes of two frames on the same stack."""


@hot
def get_sources(host):
    """Return the SOURCE records of all interrupt sources of the board: lines, timers and software interrupts."""
    return array_at(host.sources, SOURCE_COUNT, SOURCE)


@hot
def _get_hook_calls(host):
    """Return the HOOK_CALL records of the board.

    Those in use belong to interrupt hooks that have begun and not ended.
    """
    return array_at(host.hooks, MAX_HOOK_CALLS, HOOK_CALL)


@hot
def update_source_summary(host):
    """Compute from the table of sources which interrupt lines, levels and timers the board has to check, and when. Call it after
    each change of the table."""
    host.hooked_interrupt_mask, host.hooked_interrupt_level, host.n_pending, host.top_level, host.due = (
        0,
        0,
        0,
        0,
        NEVER,
    )
    sources = get_sources(host)
    for k in range(SOURCE_COUNT):
        s = sources[k]
        if s.hook:
            if s.interrupt_mask:
                host.hooked_interrupt_mask |= s.interrupt_mask
                host.hooked_interrupt_level = greatest(host.hooked_interrupt_level, s.level)
            if s.pending:
                host.n_pending += 1
                host.top_level = greatest(host.top_level, s.level)
            if s.period:
                host.due = least(host.due, s.next)
    host.top_level = greatest(host.top_level, host.hooked_interrupt_level)


@hot
def mark_due_timers(host):
    """Set the flags of all timer interrupts whose time has come."""
    now, sources = get_now(host), get_sources(host)
    for k in range(FIRST_TIMER, FIRST_SOFTWARE_SOURCE):
        s = sources[k]
        if s.period and s.next <= now:
            ticks = (now - s.next) // s.period + 1
            s.next += ticks * s.period
            s.missed += ticks - 1 + s.pending
            s.pending = 1
    update_source_summary(host)


@hot
def choose_source(host, asserted):
    """Return the index of the pending interrupt source with the highest level above the processor's, or -1.

    Args:
        host: The HOST record.
        asserted: Bit mask of the asserted interrupt lines.
    """
    sources, best, level = get_sources(host), -1, host.level
    for k in range(SOURCE_COUNT):
        s = sources[k]
        if s.hook and s.level > level and (s.pending or s.interrupt_mask & asserted):
            best, level = k, s.level
    return best


@hot
def enter_hook(host, source, mark):
    """Reserve a HOOK_CALL record for an interrupt hook that is about to be called.

    Return its index, or -1 if none is free.
    """
    hooks, s = _get_hook_calls(host), get_sources(host)[source]
    for k in range(MAX_HOOK_CALLS):
        c = hooks[k]
        if c.number == 0:
            host.called += 1
            c.number, c.source, c.level, c.mark = host.called, source, host.level, mark
            c.outer, c.outer_number = host.serving, 0
            if host.serving:
                c.outer_number = hooks[host.serving - 1].number
            host.level, host.serving, s.pending = s.level, k + 1, 0
            update_source_summary(host)
            return k
    return -1


@hot
def end_hook(host, index, number, level, outer, outer_number, ending):
    """End an interrupt hook that has returned (BACK), was left by a jump, or has lowered the level.

    Args:
        host: The HOST record.
        index: Index of its HOOK_CALL record.
        number: Number of the call; a record with another number is left alone.
        level: Level of the processor from now on.
        outer: Hook that this hook interrupted, plus one; 0 if none.
        outer_number: Number of the call of that hook.
        ending: BACK, JUMPED or LOWERED.
    """
    hooks = _get_hook_calls(host)
    if hooks[index].number == number:
        append_to_trace(host, RETURNED, hooks[index].source, ending, -1)
        hooks[index].number = 0
    host.level = level
    host.serving = outer if outer and hooks[outer - 1].number == outer_number else 0


@hot
def end_abandoned_hooks(host, frame):
    """End interrupt hooks that the firmware has left by a jump, such as longjmp.

    Args:
        host: The HOST record.
        frame: Address of the stack frame that makes the request.
    """
    while host.serving:
        c = _get_hook_calls(host)[host.serving - 1]
        if c.mark == 0 or not _is_abandoned(host, c.mark, frame):
            return
        end_hook(host, host.serving - 1, c.number, c.level, c.outer, c.outer_number, JUMPED)


@hot
def _is_abandoned(host, mark, frame):
    """Return whether the stack position of a request shows that the firmware has left the interrupt hook below `mark`."""
    if frame > mark:
        on_firmware_stack = host.stack_low < mark and frame < host.stack_high
        return on_firmware_stack or frame - mark < MAX_FRAME_DISTANCE_BYTES
    words = array_at(mark, MARK, INTEGER)
    broken = 0
    for k in range(MARK):
        broken |= words[k] ^ (MARKED + k)
    return broken != 0


@hot
def set_level(host, level):
    """Set the interrupt level of the processor, which ends the interrupt hooks of higher levels."""
    while host.serving and level < get_sources(host)[_get_hook_calls(host)[host.serving - 1].source].level:
        c = _get_hook_calls(host)[host.serving - 1]
        end_hook(host, host.serving - 1, c.number, level, c.outer, c.outer_number, LOWERED)
    host.level = level
