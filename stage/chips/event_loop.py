"""Functions of a core that every chip of one axis has whose time goes on from event to event.

    run, advance, trace_pulses, write_present_edge, scan_edges, run_window = make_event_functions(
        sys.modules[__name__], advance_to_event, count_pulses, get_direction, get_marked_change
    )

at the end of a core's module compiles them for its STATE; see stage/chips/core_interface.py and stage/chips/stepdir/core.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stage.chips.core_interface import SCAN_ROOM, run_slices
from stage.native import array_of, exported, greatest, record

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs counter net".split()] + [("rate", "f8")])


def export_from(core: Any, result: str | None, *arguments: Any) -> Callable[[Callable], Any]:
    """Export a function that is made for a core, see `stage.native.exported`, as if it stood in the core's module."""

    def export(function: Callable) -> Any:
        function.__module__, function.__qualname__ = core.__name__, function.__name__
        return exported(result, *arguments)(function)

    return export


def make_event_functions(
    core: Any,
    advance_to_event: Callable,
    count_pulses: Callable,
    get_direction: Callable,
    get_marked_change: Callable,
    answered_inputs: int = 0,
) -> tuple[Any, ...]:
    """Make the functions of a core that let time pass. The callables are hot functions whose first argument is the chip's state.

    Args:
        core: Module of the core, with STATE, read_inputs, read_outputs, read_counter, read_net_count, read_pulse_rate and
            compute_drive_input.
        advance_to_event: (chip, until): lets time pass to the next event or to `until`, and returns whether an event happened.
        count_pulses: Returns a number that increases with each pulse.
        get_direction: Returns the direction of the last pulse, 1 or -1.
        get_marked_change: Returns the change of the rate from which on a scan marks it, pulses per clock.
        answered_inputs: Bits of INPUTS that the chip itself drives, whose changes a scan marks.

    Returns:
        run, advance, trace_pulses, write_present_edge, scan_edges, run_window.
    """
    state, read_net_count, compute_drive_input = core.STATE, core.read_net_count, core.compute_drive_input

    @export_from(core, None, state, "i8")
    def run(chip: Any, until: int) -> None:
        """Let the chip's clock run up to clock `until`."""
        while advance_to_event(chip, until):
            pass

    @export_from(core, "i8", state, "i8")
    def advance(chip: Any, until: int) -> int:
        """Let the chip's clock run up to clock `until`, and return the number of pulses."""
        before = count_pulses(chip)
        run(chip, until)
        return greatest(0, count_pulses(chip) - before)

    @export_from(core, "i8", state, "i8", array_of(PULSE))
    def trace_pulses(chip: Any, until: int, pulses: Any) -> int:
        """Let the chip's clock run up to clock `until`, write each pulse into `pulses`, and return their number."""
        k, before = 0, count_pulses(chip)
        while advance_to_event(chip, until):
            if count_pulses(chip) > before:
                pulses[k].clock, pulses[k].axis, pulses[k].direction = chip.clock, 0, get_direction(chip)
                k += 1
            before = count_pulses(chip)
        return k

    @export_from(core, None, state, "i8", "i8")
    def run_window(chip: Any, row_address: int, first_slice: int) -> None:
        """Let the chip's clock run through the slices of a window, see stage/chips/core_interface.py."""
        run_slices(chip, row_address, first_slice, run, read_net_count, compute_drive_input)

    write_present_edge, scan_edges = _make_scan_functions(core, advance_to_event, get_marked_change, answered_inputs)
    return run, advance, trace_pulses, write_present_edge, scan_edges, run_window


def _make_scan_functions(
    core: Any, advance_to_event: Callable, get_marked_change: Callable, answered_inputs: int
) -> tuple[Any, Any]:
    """Make write_present_edge and scan_edges, see `make_event_functions`."""
    state, read_inputs, read_outputs = core.STATE, core.read_inputs, core.read_outputs
    read_counter, read_net_count, read_pulse_rate = core.read_counter, core.read_net_count, core.read_pulse_rate

    @export_from(core, None, state, "i8", array_of(EDGE), "i8")
    def write_present_edge(chip: Any, axis_index: int, edges: Any, edge_index: int) -> None:
        """Write the present state of the chip's axis into EDGE record `edge_index`."""
        e = edges[edge_index]
        e.clock, e.inputs, e.outputs = chip.clock, read_inputs(chip, 0), read_outputs(chip, 0)
        e.counter, e.net = read_counter(chip, 0), read_net_count(chip, 0)
        e.rate = read_pulse_rate(chip, 0, 1.0)

    @export_from(core, "i8", state, "i8", "i8", "i8", array_of(EDGE))
    def scan_edges(chip: Any, until: int, every_pulse: int, axis_index: int, edges: Any) -> int:
        """Let the clock run up to `until`, and write an EDGE record at each change of the axis.

        Args:
            chip: State of the chip.
            until: Clock at the end.
            every_pulse: Write a record at every event.
            axis_index: Axis of the chip, 0.
            edges: EDGE records to fill.

        Returns:
            The number of records. If `edges` is nearly full the chip stops early.
        """
        k, word, pins, rate = 0, read_outputs(chip, 0), read_inputs(chip, 0), read_pulse_rate(chip, 0, 1.0)
        while chip.clock < until and k < len(edges) - SCAN_ROOM:
            if not advance_to_event(chip, until):
                break
            now, new = read_outputs(chip, 0), read_pulse_rate(chip, 0, 1.0)
            answers = (pins ^ read_inputs(chip, 0)) & answered_inputs
            if every_pulse or now != word or answers or abs(new - rate) > get_marked_change(chip):
                write_present_edge(chip, 0, edges, k)
                word, pins, rate = now, read_inputs(chip, 0), new
                k += 1
        return k

    return write_present_edge, scan_edges
