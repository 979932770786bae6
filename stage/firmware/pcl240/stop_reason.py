"""Why a run of a PCL-240 ended: `find_stop_reason` replays the chip's journal.

A host can read R0 = 0 and ORG. An end limit has no status bit, and a carriage that rings has let go of a switch before the host
looks. The journal has every bus write and every change of an input by the clock, so a copy of the chip stops where the chip did.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.chips.entries import RESET, WRITE
from stage.chips.journal import Journal
from stage.chips.pcl240 import state as bits
from stage.chips.pcl240.maps import OPERATE


def find_stop_reason(journal: Journal) -> str:
    """Return what ended the last run that a journal has seen, or what refused the start after it.

    Returns:
        "R0 = 0", "ORG", "EZ", "EL+", "EL-", "decelerating stop", "reset command" or "reset pin"; "" while the chip runs, and where
        it has not been started.
    """
    core, rows = journal.chip.CORE, np.frombuffer(bytearray(journal.start.tobytes()), journal.chip.CORE.STATE)
    chip, reason, slowing = rows[0], "", False
    for entry in (*journal.entries, None):
        was_running = bool(chip["running"])
        core.advance(rows, journal.until if entry is None else entry.clock)
        if was_running and not chip["running"]:
            # inputs change with entries only: they are still as they were at the stop
            reason = find_cause(chip) or ("decelerating stop" if slowing else "")
        if entry is None:
            break
        was_running = bool(chip["running"])
        entry.apply(core, rows)
        command = entry.b & ~bits.INT_AT_STOP if (entry.kind, entry.a) == (WRITE, 0) else -1
        starts = command >= 0 and command & bits.GROUP == OPERATE and bool(command & bits.START)
        stops = command >= 0 and command & bits.GROUP == OPERATE and bool(command & bits.STOP)
        if was_running and not chip["running"]:
            reason = "reset pin" if entry.kind == RESET else "decelerating stop" if starts else "reset command"
        elif chip["running"]:
            reason, slowing = "", stops or (slowing and not starts)
        elif starts and not stops and chip["armed"]:
            reason = find_cause(chip) or reason
    return "" if chip["running"] else reason


def find_cause(chip: Any) -> str:
    """Return what stops a chip, a record of its state, or keeps it from starting; "" for nothing but commands."""
    homes_by_index = chip["extended"] and chip["reg"][bits.R13] & bits.EZ_RETURN
    if chip["preset"] and chip["reg"][0] == 0:
        return "R0 = 0"
    if chip["origin"] and chip["seen"] & bits.ORG and not homes_by_index:
        return "ORG"
    if chip["seen"] & (bits.EL_MINUS if chip["minus"] else bits.EL_PLUS):
        return "EL-" if chip["minus"] else "EL+"
    return "EZ" if chip["homing"] and chip["seen"] & bits.EZ else ""
