"""Many requests of a host in one compiled call: `run_batch` takes an array of ENTRY records and gives an answer for each.

For hosts at the other end of a network, see stage.serve: a batch may contain "read this port until (value & mask) == x", so that
waiting for a chip takes no round trips.
"""

from __future__ import annotations

import numpy as np

from stage.board.bus import host_record, waiting
from stage.board.bus.requests import execute
from stage.native import array_of, exported, float_mode_as_before, hot, record, usual_float_mode

SLICE_NS, SLICE_CYCLES = 50_000_000, 100_000
"""Time and cycles of a batch between two pauses, in which Python may end it."""
UNTIL8, UNTIL16, UNTIL_LINE = range(100, 103)
"""What a batch knows beside the requests of `host_record`: read a port until (value & mask) == b, `times` times at most and
`every` us apart; wait until the interrupt line is asserted, `a` us at most."""
ENTRY = record([*((name, "i4") for name in ("what", "times", "every", "mask")), ("a", "i8"), ("b", "i8")])
"""what: IN8 ... or UNTIL8 ...; a: a port, or us; b: the value that is written, or waited for; times, every, mask: of UNTIL8 and
UNTIL16 only, the mask as 32 bits without a sign."""


@hot
def _is_invalid(entry):
    """Tell whether an entry is no request, or has a number that does not fit."""
    code = entry.what
    if code in (host_record.MICROS, host_record.LINE):
        return False
    if code in (host_record.DELAY, UNTIL_LINE):
        return entry.a < 0 or entry.a > host_record.MAX_DELAY_US
    if code == host_record.SPEND:
        return entry.a < 0 or entry.a > host_record.MAX_DELAY_US * 1000
    if entry.a < 0 or entry.a > 0xFFFFFFFF:
        return True
    if code in (host_record.IN8, host_record.IN16, host_record.IN32):
        return False
    if code in (host_record.OUT8, host_record.OUT16, host_record.OUT32):
        return entry.b < 0 or entry.b > (
            0xFF if code == host_record.OUT8 else 0xFFFF if code == host_record.OUT16 else 0xFFFFFFFF
        )
    if code in (UNTIL8, UNTIL16):
        return entry.times < 1 or entry.every < 0
    return True


@exported("i8", array_of(ENTRY))
def find_first_invalid(entries):
    """Return the index of the first entry that cannot be carried out, or their number."""
    for k in range(len(entries)):
        if _is_invalid(entries[k]):
            return k
    return len(entries)


@hot
def _read_until(host, entry):
    """Read a port until the value of an entry comes; return the last value that was read."""
    code, mask, value = host_record.IN8 if entry.what == UNTIL8 else host_record.IN16, int(entry.mask) & 0xFFFFFFFF, 0
    for k in range(entry.times):
        value = execute(host, code, entry.a, 0)
        if host.stopped or (value ^ entry.b) & mask == 0:
            break
        if entry.every and k < entry.times - 1:
            waiting.wait(host, int(entry.every) * 1000)
    return value


@hot
def _wait_for_line(host, us):
    """Wait until the line is asserted; return 1 if it is. Reading it takes a bus cycle, as LINE does."""
    waiting.pass_bus_cycle(host)
    asserted = waiting.wait_for_line(host, us * 1000)
    waiting.call_hooks(host)
    return asserted


@hot
def set_next_pause(host):
    """Set the time and the cycles of the next pause."""
    host.until, host.max_cycles = host_record.get_now(host) + SLICE_NS, host.cycles + SLICE_CYCLES


@exported("i8", host_record.HOST, array_of(ENTRY), array_of(np.int64))
def run_batch(host, entries, answers):
    """Execute the entries, one after the other, on a board that is not stopped. Python is called at each PAUSE, and calls `go_on`.

    Returns:
        How many were executed to the end: fewer than all if the board was stopped; -1 if another thread is inside.
    """
    if not host_record.enter(host):
        return -1
    mode, done = usual_float_mode(), 0
    lazy, until, max_cycles = host.lazy, host.until, host.max_cycles
    host.lazy, host.quiet = 1, 0
    set_next_pause(host)
    while done < len(entries):
        entry = entries[done]
        if entry.what == UNTIL8 or entry.what == UNTIL16:
            answers[done] = _read_until(host, entry)
        elif entry.what == UNTIL_LINE:
            answers[done] = _wait_for_line(host, entry.a)
        else:
            answers[done] = execute(host, entry.what, entry.a, entry.b)
        if host.stopped:
            break
        done += 1
    waiting.catch_up(host)
    if host.stopped and done == len(entries):
        done -= 1
    host.lazy, host.until, host.max_cycles = lazy, until, max_cycles
    float_mode_as_before(mode)
    host_record.leave(host)
    return done


@exported(None, host_record.HOST)
def resume_batch(host):
    """Let a paused batch go on, until the next pause."""
    set_next_pause(host)
