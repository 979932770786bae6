"""Execute many requests of a host in one compiled call: `run_batch` takes an array of ENTRY records and returns one
answer for each.

Hosts that drive the board over a network (stage.serve) send batches. A batch may contain "read this port until (value &
mask) == x", so that waiting for a chip takes no network round trips.
"""

from __future__ import annotations

import numpy as np

from stage.board.bus import host_record, host_time
from stage.board.bus.host_requests import execute_request
from stage.chips.stepdir.state import DIR, ENABLE, STEP
from stage.native import array_of, enter_usual_float_mode, exported, hot, record, restore_previous_float_mode

SLICE_NS, SLICE_CYCLES = 50_000_000, 100_000
"""Simulated time and bus cycles between two pauses of a batch, at which Python may end it."""
UNTIL8, UNTIL16, UNTIL_LINE = range(100, 103)
"""Requests that only a batch has: read a port until (value & mask) == b, at most `times` times, `every` microseconds
apart; wait at most `a` microseconds until the interrupt line is asserted."""
ENTRY = record([*((name, "i4") for name in ("what", "times", "every", "mask")), ("a", "i8"), ("b", "i8")])
"""Request in a batch. what: IN8, ..., UNTIL8, ...; a: port, or time in us; b: value that is written or awaited; times,
every, mask: for UNTIL8 and UNTIL16 only, the mask as 32 unsigned bits."""

DRIVEN_LINES = STEP | DIR | ENABLE
"""Lines of a STEP/DIR axis that a host may drive; the stage drives the others."""


@hot
def _is_invalid(entry, n_chips):
    """Return whether an entry of a batch of host requests has an unknown request code or an operand out of range."""
    code = entry.what
    if code == host_record.SET_LINES and entry.b >> host_record.LINES_SHIFT & ~DRIVEN_LINES:
        return True
    if code in (host_record.SET_LINES, host_record.READ_LINES, host_record.WATCH_LINES):
        return not 0 <= entry.a & ~host_record.WITH_CYCLE < n_chips or entry.b < 0
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


@exported("i8", array_of(ENTRY), "i8")
def find_first_invalid(entries, n_chips):
    """Return the index of the first batch entry that a board with so many chips cannot execute, or the number of entries."""
    for k in range(len(entries)):
        if _is_invalid(entries[k], n_chips):
            return k
    return len(entries)


@hot
def _read_until(host, entry):
    """Read a port until the value of the batch entry appears; return the last value that was read."""
    code, mask, value = host_record.IN8 if entry.what == UNTIL8 else host_record.IN16, int(entry.mask) & 0xFFFFFFFF, 0
    for k in range(entry.times):
        value = execute_request(host, code, entry.a, 0)
        if host.stopped or (value ^ entry.b) & mask == 0:
            break
        if entry.every and k < entry.times - 1:
            host_time.wait(host, int(entry.every) * 1000)
    return value


@hot
def _wait_for_line(host, us):
    """Wait until the interrupt line is asserted; return 1 if it is. Like a LINE request, this takes one bus cycle."""
    host_time.pass_bus_cycle(host)
    asserted = host_time.wait_for_line(host, us * 1000)
    host_time.call_hooks(host)
    return asserted


@hot
def set_next_pause(host):
    """Set the time and the number of bus cycles at which a batch of host requests will pause."""
    host.until, host.max_cycles = host_record.get_now(host) + SLICE_NS, host.cycles + SLICE_CYCLES


@exported("i8", host_record.HOST, array_of(ENTRY), array_of(np.int64))
def run_batch(host, entries, answers):
    """Execute the requests of a batch in order. At each PAUSE, Python is called, which has to call `resume_batch`.

    Args:
        host: HOST record of a board that is not stopped.
        entries: ENTRY records.
        answers: Array that receives the answer to each entry.

    Returns:
        Number of entries that were executed completely, fewer than all if the board was stopped; -1 if another thread
        uses the board.
    """
    if not host_record.claim_board(host):
        return -1
    mode, done = enter_usual_float_mode(), 0
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
            answers[done] = execute_request(host, entry.what, entry.a, entry.b)
        if host.stopped:
            break
        done += 1
    host_time.advance_stage_to_host(host)
    if host.stopped and done == len(entries):
        done -= 1
    host.lazy, host.until, host.max_cycles = lazy, until, max_cycles
    restore_previous_float_mode(mode)
    host_record.release_board(host)
    return done


@exported(None, host_record.HOST)
def resume_batch(host):
    """Let a paused batch of host requests continue until its next pause."""
    set_next_pause(host)
