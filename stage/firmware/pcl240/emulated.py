"""A row of registers (fit.py) on an emulated chip: its pulses, and the offset of its automatic ramp-down point."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from stage.chips.pcl240 import PCL240, PCL240K, core
from stage.firmware.pcl240 import fit


@cache
def _powered_up(chip: Any) -> bytes:
    return chip().snapshot().record


def _fresh(chip: Any) -> np.ndarray:
    """The record of a chip just powered up, to play with."""
    return np.frombuffer(bytearray(_powered_up(chip)), core.STATE)


def offset(r: np.ndarray, chip: type[PCL240]) -> int:
    """R6 that makes the automatic ramp-down come at the same pulse as without it (normative model, section 7): the one begins
    once R0 <= pulses of the ramp-up + offset, the other once R0 < R6."""
    return int(r[6]) - 1 - int(fit.risen(_fresh(chip), r))


def run(r: np.ndarray, chip: type[PCL240] = PCL240K, automatic: bool = False) -> np.ndarray:
    """Ticks from the start to each pulse (int64), by an emulated `chip` with row `r`."""
    r = np.asarray(r, np.int64)
    out = np.empty(int(r[0]), core.PULSE)
    fit.play(_fresh(chip), r, automatic, offset(r, chip) if automatic else int(r[6]), out)
    return out["clock"].copy()
