"""Functions of the cores of STEP/DIR axes, whose STATE begins with the fields of `stage.chips.stepdir.state.STATE`.

`make_line_functions` makes those that every axis has, `make_power_stage_functions` those that let time pass for an axis whose power
stage is a chip with events of its own, such as timers or a serial line.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stage.chips.event_loop import export_from, make_event_functions
from stage.chips.stepdir import step_timer
from stage.chips.stepdir.state import RATE
from stage.native import greatest, hot, least

MIN_RATE_CHANGE_SHARE = 0.01
"""Smallest change of the rate between two EDGE records, as a share of RATE."""


@hot
def get_min_rate_change(chip):
    """Return the smallest change of the rate for which an EDGE record is written, steps per clock."""
    return MIN_RATE_CHANGE_SHARE * chip.reg[RATE] / chip.hz


def make_line_functions(core: Any) -> tuple[Any, ...]:
    """Make the functions of a core that show the step timer.

    Args:
        core: Module of the core, with STATE.

    Returns:
        read_outputs, read_status, is_busy, read_counter, set_shaft.
    """

    @export_from(core, "i8", core.STATE, "i8")
    def read_outputs(chip: Any, axis_index: int) -> int:
        """Return the output pins of the step timer."""
        return step_timer.compute_output_pins(chip)

    @export_from(core, "i8", core.STATE, "i8")
    def read_status(chip: Any, axis_index: int) -> int:
        """Return the status word."""
        return step_timer.compute_status(chip)

    @export_from(core, "i8", core.STATE, "i8")
    def is_busy(chip: Any, axis_index: int) -> int:
        """Return whether the step timer runs."""
        return chip.running

    @export_from(core, "i8", core.STATE, "i8")
    def read_counter(chip: Any, axis_index: int) -> int:
        """Return the value of the register POSITION."""
        return step_timer.read_position(chip)

    @export_from(core, None, core.STATE, "i8", "f8", "f8")
    def set_shaft(chip: Any, axis_index: int, count: float, rate: float) -> None:
        """Do nothing: the axis has no input for an encoder."""

    return read_outputs, read_status, is_busy, read_counter, set_shaft


def make_power_stage_functions(
    core: Any,
    find_next_chip_event: Callable,
    process_chip_event: Callable,
    follow_lines: Callable,
    count_moves: Callable,
    get_direction: Callable,
    answered_inputs: int,
) -> tuple[Any, ...]:
    """Make the functions that let time pass for an axis whose power stage is a chip. The callables are hot functions.

    Args:
        core: Module of the core, see `make_event_functions`.
        find_next_chip_event: Returns the clock of the next event of the chip, or NEVER.
        process_chip_event: Processes the event of the chip at the present clock.
        follow_lines: (chip, before): lets the chip follow the lines after their levels have changed from `before`.
        count_moves: Returns the number of steps that the field has made.
        get_direction: Returns the direction of the last one, 1 or -1.
        answered_inputs: Bits of INPUTS that the chip itself drives, whose changes a scan marks.

    Returns:
        run, advance, trace_pulses, write_present_edge, scan_edges, run_window.
    """

    @hot
    def advance_to_event(chip: Any, until: int) -> bool:
        of_timer = step_timer.find_next_event(chip)
        at = greatest(least(of_timer, find_next_chip_event(chip)), chip.clock)
        if at > until:
            chip.clock = until
            return False
        chip.clock = at
        if of_timer <= at:
            before = chip.inputs
            step_timer.process_event(chip)
            follow_lines(chip, before)
        else:
            process_chip_event(chip)
        return True

    return make_event_functions(
        core, advance_to_event, count_moves, get_direction, get_min_rate_change, answered_inputs
    )
