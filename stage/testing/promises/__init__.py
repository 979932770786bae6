"""Promises that every chip must keep.

Each promise is a function that raises `BrokenPromise` if a chip breaks it; see conformance.py. The functions check random actions
(chip_actions.py) and moves as the chip's host driver writes them. The report of a broken promise shows the first paragraph of the
function's docstring without "Check that".
"""

from __future__ import annotations

from collections.abc import Callable

from stage.testing.promise_trial import PromiseTrial
from stage.testing.promises.axis_actions import check_actions
from stage.testing.promises.bus import (
    check_bus_lines,
    check_command_cycles,
    check_contract,
    check_cycle_descriptions,
    check_diagnostics,
    check_pins_by_name,
    check_reads,
    check_register_cycles,
)
from stage.testing.promises.journal import check_journals
from stage.testing.promises.moves import check_axis_independence, check_limit_switches, check_outputs_during_move
from stage.testing.promises.state import check_determinism, check_resets, check_snapshots
from stage.testing.promises.timing import (
    check_drive_inputs,
    check_elapsed_clocks,
    check_time_in_pieces,
    check_trace,
    check_windows,
)

PROMISES: dict[str, Callable[[PromiseTrial], None]] = {
    "has_what_every_chip_has": check_contract, "pins_by_name": check_pins_by_name, "register_cycles": check_register_cycles,
    "command_cycles": check_command_cycles, "bus_lines": check_bus_lines, "time_that_passes": check_elapsed_clocks,
    "reads": check_reads, "diagnostics": check_diagnostics, "words": check_cycle_descriptions, "determinism": check_determinism,
    "traced": check_trace, "cut_time": check_time_in_pieces, "windows": check_windows, "drive_inputs": check_drive_inputs,
    "courses": check_outputs_during_move, "limit_switches": check_limit_switches, "axes_alone": check_axis_independence,
    "actions": check_actions,
    "snapshots": check_snapshots, "journals": check_journals, "resets": check_resets,
}  # fmt: skip
"""Name of a promise, as users pass it to `chip_conformance` -> function that checks it. Its docstring is what reports show."""
