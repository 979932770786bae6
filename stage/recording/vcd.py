"""A recording as waveforms for GTKWave: every pulse, pin and status bit of every chip, by its own clock.

Levels are the electrical ones: an active-low signal (POUT, SD, EL, ORG, EXTP, INT) is 0 while asserted. Time is in
nanoseconds; a clock of 4.9152 MHz is 203.45 ns, rounded once an edge.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from stage.recording.recording import Recording

ACTIVE_LOW = {"el_plus", "el_minus", "sd_plus", "sd_minus", "org", "extp", "pout", "pdir", "irq"}
NAMES = {
    "pout": "POUT", "pdir": "PDIR", "hold": "HOLD", "fup": "FUP", "fkeep": "FKEEP", "fdown": "FDOWN", "lt": "LT",
    "zero": "ZERO", "irq": "INT", "ots": "OTS", "el_plus": "EL_PLUS", "el_minus": "EL_MINUS", "sd_plus": "SD_PLUS",
    "sd_minus": "SD_MINUS", "org": "ORG", "ins": "INS", "extp": "EXTP",
}  # fmt: skip


def write(recording: Recording, path: Path) -> Path:
    """Write the chips of `recording` to `path`."""
    from vcd import VCDWriter

    with open(path, "w", encoding="ascii") as file, VCDWriter(file, timescale="1 ns", init_timestamp=0) as writer:
        changes: list[tuple[np.ndarray, np.ndarray, Any]] = []
        for axis in recording.axes:
            changes += _axis(recording, axis, writer)
        times = np.concatenate([t for t, _, _ in changes])
        which = np.concatenate([np.full(len(t), k) for k, (t, _, _) in enumerate(changes)])
        index = np.concatenate([np.arange(len(t)) for t, _, _ in changes])
        for k in np.argsort(times, kind="stable"):
            _, values, variable = changes[which[k]]
            writer.change(variable, int(times[k]), int(values[index[k]]))
        writer.close(int(times.max()) if len(times) else 0)
    return path


def _axis(recording: Recording, axis: str, writer: Any) -> list[tuple[np.ndarray, np.ndarray, Any]]:
    """(times in ns, values, variable) for each signal of an axis, only where it changes."""
    course = recording.course(axis, every_pulse=True)
    e = course.edges
    ns = np.rint((recording.seconds(axis, e["clock"]) - recording.began) * 1e9).astype(np.int64)
    signals = {NAMES[p]: course.pin(p) ^ (p in ACTIVE_LOW) for p in NAMES if p in course.chip.INPUTS or p in course.chip.OUTPUTS}
    out = []
    for name, level in signals.items():
        variable = writer.register_var(axis, name, "wire", size=1, init=int(level[0]))
        out.append(_changes(ns, level.astype(np.int64), variable))
    for name, column, size in (("R0", "r0", 24), ("SPEED", "speed", 13)):
        variable = writer.register_var(axis, name, "wire", size=size, init=int(e[column][0]))
        out.append(_changes(ns, e[column], variable))
    return out


def _changes(ns: np.ndarray, values: np.ndarray, variable: Any) -> tuple[np.ndarray, np.ndarray, Any]:
    """Of edges at one time only the last counts, and only where the value differs from the one before."""
    last = np.concatenate([ns[1:] != ns[:-1], [True]])
    ns, values = ns[last], values[last]
    keep = np.concatenate([[False], values[1:] != values[:-1]])
    return ns[keep], values[keep], variable
