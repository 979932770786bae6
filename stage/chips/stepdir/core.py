"""Core of the STEP/DIR axis, compiled: it advances from one edge to the next, see stage/chips/core_interface.py.

Firmware drives STEP, DIR and ENABLE as input pins. A host without firmware lets the step timer drive STEP and DIR: it writes rates,
ramps and a number of steps, and a start. The steps of a line's shorter axes are spread among those of the longest one by
Bresenham's rule, as firmware for machine tools does it.
"""

from __future__ import annotations

import numpy as np

from stage.chips.core_interface import SCAN_ROOM, run_slices
from stage.chips.stepdir import step_timer
from stage.chips.stepdir.state import ENABLE, INPUTS, OUTPUTS, RATE, STATE, STEP
from stage.chips.stepdir.step_edges import apply_line_levels, compute_mean_count
from stage.native import array_of, exported, greatest, record

__all__ = ["INPUTS", "OUTPUTS", "STATE"]

MARKED_CHANGE = 0.01
"""Share of RATE by which the rate changes between two edges of a course."""

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs counter net".split()] + [("rate", "f8")])


@exported(None, STATE, "i8")
def run(chip, until):
    """Let the clock run up to `until`."""
    while step_timer.advance_to_event(chip, until):
        pass


@exported("i8", STATE, "i8")
def advance(chip, until):
    """Let the clock run up to `until`, and return the steps."""
    before = chip.accepted
    run(chip, until)
    return greatest(0, chip.accepted - before)


@exported("i8", STATE, "i8", array_of(PULSE))
def trace_pulses(chip, until, pulses):
    """Let the clock run up to `until`, write each step into `pulses`, and return their number."""
    k, before = 0, chip.accepted
    while step_timer.advance_to_event(chip, until):
        if chip.accepted > before:
            pulses[k].clock, pulses[k].axis, pulses[k].direction = chip.clock, 0, chip.last_step
            k += 1
        before = chip.accepted
    return k


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def write_present_edge(chip, axis_index, edges, edge_index):
    """Write the present state of the axis into EDGE record `edge_index`."""
    e = edges[edge_index]
    e.clock, e.inputs, e.outputs, e.counter, e.net = (
        chip.clock,
        chip.inputs,
        read_outputs(chip, 0),
        read_counter(chip, 0),
        chip.net,
    )
    e.rate = compute_pulse_rate(chip, 0, 1.0)


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan_edges(chip, until, every_pulse, axis_index, edges):
    """Let the clock run up to `until`, and write an EDGE record at each change of the axis.

    Args:
        chip: State of the chip.
        until: Clock at the end.
        every_pulse: Include the edges of STEP and DIR.
        axis_index: Axis of the chip, 0.
        edges: EDGE records to fill.

    Returns:
        The number of records. If `edges` is nearly full the chip stops early.
    """
    k, word, rate = 0, read_outputs(chip, 0), compute_pulse_rate(chip, 0, 1.0)
    while chip.clock < until and k < len(edges) - SCAN_ROOM:
        if not step_timer.advance_to_event(chip, until):
            break
        now, new = read_outputs(chip, 0), compute_pulse_rate(chip, 0, 1.0)
        if every_pulse or now != word or abs(new - rate) > MARKED_CHANGE * chip.reg[RATE] / chip.hz:
            write_present_edge(chip, 0, edges, k)
            word, rate = now, new
            k += 1
    return k


@exported(None, STATE, "i8", "i8")
def run_window(chip, row_address, first_slice):
    """Let the chip's clock run through the slices of a window, see stage/chips/core_interface.py."""
    run_slices(chip, row_address, first_slice, run, read_net_count, compute_drive_input)


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(chip, axis_index, net_before, clocks):
    """Return the mean of the step count over the last `clocks` clocks; `net_before` is the count at their start."""
    return compute_mean_count(chip, net_before, clocks)


@exported(None, STATE)
def power_up(chip):
    """Clear the registers, the step timer and the violations. The host and the stage keep driving lines and switches."""
    step_timer.clear(chip)


@exported("i8", STATE, "i8")
def peek(chip, address):
    """Return what a host would read at an address, without a bus cycle and its side effects."""
    return step_timer.read_register(chip, address)


@exported("i8", STATE, "i8")
def read(chip, address):
    """Make a read cycle."""
    return step_timer.read_register(chip, address)


@exported(None, STATE, "i8", "i8")
def write(chip, address, value):
    """Make a write cycle."""
    step_timer.write_register(chip, address, value)


@exported(None, STATE, "i8", "i8")
def set_input(chip, axis_index, word):
    """Set the levels of the input pins, and process the edges of STEP, DIR and ENABLE."""
    rising = word & ~chip.inputs
    if rising & STEP and not chip.running:
        chip.steps_done = 0
    apply_line_levels(chip, word)
    step_timer.stop_at_switches(chip, rising)


@exported("i8", STATE, "i8")
def read_inputs(chip, axis_index):
    """Return the input pins."""
    return chip.inputs


@exported("i8", STATE, "i8")
def read_outputs(chip, axis_index):
    """Return the output pins."""
    return step_timer.compute_output_pins(chip)


@exported("i8", STATE, "i8")
def read_status(chip, axis_index):
    """Return the status word."""
    return step_timer.compute_status(chip)


@exported("i8", STATE, "i8")
def is_busy(chip, axis_index):
    """Return whether the step timer runs."""
    return chip.running


@exported("i8", STATE, "i8")
def read_net_count(chip, axis_index):
    """Return the accepted steps since power-up, plus less minus."""
    return chip.net


@exported("i8", STATE, "i8")
def read_counter(chip, axis_index):
    """Return the value of the register POSITION."""
    return step_timer.read_position(chip)


@exported("f8", STATE, "i8", "f8")
def compute_pulse_rate(chip, axis_index, hz):
    """Return the rate at which the count changes now, per second of a clock of `hz`."""
    return step_timer.compute_step_rate(chip, hz)


@exported("f8", STATE, "i8")
def read_motor_current(chip, axis_index):
    """Return the amplitude of the phase currents, A: none while ENABLE is not asserted."""
    return chip.amplitude if chip.inputs & ENABLE else 0.0


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(chip, axis_index, count, rate):
    """Do nothing: the axis has no input for an encoder."""
