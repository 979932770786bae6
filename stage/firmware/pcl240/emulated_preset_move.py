"""Pulses of rows of registers, measured on an emulated chip, and the offset of their automatic ramp-down point.

A row has the registers of one axis of a line, see follower_register_search.py.
"""

from __future__ import annotations

import numpy as np

from stage.chips.pcl240 import PCL240, PCL240K
from stage.firmware.pcl240 import chip_port

ROW_REGISTERS = (*(f"R{k}" for k in range(8)), "R14", "R15")
"""Registers of a row in order. Only rows of chips with S-curves have R14 and R15."""
MAX_CLOCKS = 1 << 44


def trace_preset_move(row: np.ndarray, chip: type[PCL240] = PCL240K, automatic: bool = False) -> np.ndarray:
    """Run the preset move that a row of registers describes on an emulated chip.

    Args:
        row: Registers of the move.
        chip: Class of the chip.
        automatic: Whether the chip finds the ramp-down point itself.

    Returns:
        Ticks from the start to each pulse (int64).
    """
    row = np.asarray(row, np.int64)
    r6 = compute_ramp_down_offset(row, chip) & chip.MAP.register("R6").mask if automatic else int(row[6])
    emulated = _start_row_on_chip(row, chip, r6, automatic)
    pulses = np.empty(int(row[0]), emulated.CORE.PULSE)
    emulated.CORE.trace_pulses.c(emulated.pointer, MAX_CLOCKS, pulses.ctypes.data, len(pulses))
    return pulses["clock"].copy()


def compute_ramp_down_offset(row: np.ndarray, chip: type[PCL240]) -> int:
    """Compute the R6 with which the automatic ramp-down begins at the same pulse as an ordinary one with the row's R6.

    The automatic ramp-down begins at R0 <= pulses of the ramp-up + offset, the ordinary one at R0 < R6 (normative model, section
    7).
    """
    emulated = _start_row_on_chip(row, chip, int(row[6]), False)
    emulated.CORE.advance.c(emulated.pointer, MAX_CLOCKS)
    return int(row[6]) - 1 - int(emulated.state["rise_pulses"])


def _start_row_on_chip(row: np.ndarray, chip: type[PCL240], r6: int, automatic: bool) -> PCL240:
    """Return a new chip that has started the preset move of a row of registers, but with R6 = `r6`."""
    emulated = chip()
    for name, value in zip(ROW_REGISTERS, [*row[:6].tolist(), r6, *row[7:].tolist()], strict=False):
        for cycle in emulated.register_cycles(name, value):
            emulated.write(*cycle)
    emulated.write(0, chip_port.CONTROL | chip_port.PRESET | (chip_port.AUTOMATIC if automatic else 0))
    emulated.write(0, (chip_port.RAMP_START_COMMANDS if row[2] > row[1] else chip_port.START)["FH1"])
    return emulated
