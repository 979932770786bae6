"""`Pcl240Observer` of the PCL-240 family: it watches an axis, and finds in the chip's journal why a run ended.

A host can read R0 = 0 and ORG. An end limit has no status bit, and a carriage that rings has released a switch before the host
polls. The journal has every bus write and every change of an input by the clock, so a copy of the chip stops where the chip did.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.chips.journal import Journal
from stage.chips.journal_entries import RESET, WRITE
from stage.chips.pcl240 import state as bits
from stage.chips.pcl240.maps import OPERATE
from stage.firmware import move_report
from stage.firmware.axis import Axis
from stage.firmware.driver import SETTLING_TIME_S
from stage.firmware.move_report import Report
from stage.firmware.pcl240.chip_port import ChipPort, check_chip_family
from stage.firmware.stop_reasons import UNKNOWN


class Pcl240Observer(move_report.ProcedureObserver):
    """Observer of an axis with a PCL-240, which finds in the chip's journal why a run ended.

    Raises:
        ArgumentError: The chip is of another family.
    """

    def __init__(self, axis: Axis, name: str):
        check_chip_family(axis)
        super().__init__(axis, name)
        self.port = ChipPort(axis)

    def find_stop_reason(self) -> str:
        """Return what ended the axis' last run; UNKNOWN where no start command has reached the chip."""
        return find_stop_reason(self.journal) or UNKNOWN

    def read_residual(self) -> int:
        return self.port.read_counter()

    def finish(self, timeout: float, asked: int | None = None) -> Report:
        """Wait until the chip stops and the carriage has come to rest, and return the report.

        Args:
            timeout: Simulated seconds to wait for the stop.
            asked: Signed pulses commanded; None where the procedure has no such number.

        Raises:
            RunTimeout: The chip still moved after `timeout`.
        """
        self.port.wait_until_stopped(timeout)
        self.axis.wait(SETTLING_TIME_S)
        return self.make_report(self.find_stop_reason(), asked)


def find_stop_reason(journal: Journal) -> str:
    """Return what has ended the last run in a journal, or what has refused the start after it.

    Args:
        journal: Journal of the chip.

    Returns:
        "R0 = 0", "ORG", "EZ", "EL+", "EL-", "decelerating stop", "reset command" or "reset pin"; "" while the chip runs, and if
        it has not been started.
    """
    core, rows = journal.chip.CORE, np.frombuffer(bytearray(journal.start_state.tobytes()), journal.chip.CORE.STATE)
    chip, reason, slowing = rows[0], "", False
    for entry in (*journal.entries, None):
        was_running = bool(chip["running"])
        core.advance(rows, journal.end_clock if entry is None else entry.clock)
        if was_running and not chip["running"]:
            # inputs change with entries only: they are still as they were at the stop
            reason = find_present_stop_reason(chip) or ("decelerating stop" if slowing else "")
        if entry is None:
            break
        was_running = bool(chip["running"])
        entry.apply(core, rows)
        starts, stops = _decode_command(entry)
        if was_running and not chip["running"]:
            reason = "reset pin" if entry.kind == RESET else "decelerating stop" if starts else "reset command"
        elif chip["running"]:
            reason, slowing = "", stops or (slowing and not starts)
        elif starts and not stops and chip["armed"]:
            reason = find_present_stop_reason(chip) or reason
    return "" if chip["running"] else reason


def _decode_command(entry: Any) -> tuple[bool, bool]:
    """Return whether a journal entry is an operating-mode command with the start bit, and whether it is one with the stop bit."""
    if (entry.kind, entry.a) != (WRITE, 0) or entry.b & bits.GROUP != OPERATE:
        return False, False
    return bool(entry.b & bits.START), bool(entry.b & bits.STOP)


def find_present_stop_reason(chip: Any) -> str:
    """Return what stops a PCL-240 now, or keeps it from starting, apart from commands; "" for nothing.

    Args:
        chip: Record of the chip's state.
    """
    homes_by_index = chip["extended"] and chip["reg"][bits.R13] & bits.EZ_RETURN
    if chip["preset"] and chip["reg"][0] == 0:
        return "R0 = 0"
    if chip["origin_return"] and chip["active_inputs"] & bits.ORG and not homes_by_index:
        return "ORG"
    if chip["active_inputs"] & (bits.EL_MINUS if chip["minus"] else bits.EL_PLUS):
        return "EL-" if chip["minus"] else "EL+"
    return "EZ" if chip["passed_org"] and chip["active_inputs"] & bits.EZ else ""
