"""Core of the STEP/DIR axis, compiled: it advances from one edge to the next, see stage/chips/core_interface.py.

Firmware drives STEP, DIR and ENABLE as input pins. A host without firmware lets the step timer drive STEP and DIR: it writes rates,
ramps and a number of steps, and a start. The steps of a line's shorter axes are spread among those of the longest one by
Bresenham's rule, as firmware for machine tools does it.
"""

from __future__ import annotations

import sys

from stage.chips.event_loop import EDGE, PULSE, make_event_functions
from stage.chips.stepdir import step_timer
from stage.chips.stepdir.core_functions import get_min_rate_change, make_line_functions
from stage.chips.stepdir.state import ENABLE, INPUTS, OUTPUTS, STATE, STEP
from stage.chips.stepdir.step_edges import apply_line_levels, compute_mean_count
from stage.native import exported, hot

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE"]


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
def read_net_count(chip, axis_index):
    """Return the accepted steps since power-up, plus less minus."""
    return chip.net


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(chip, axis_index, clock_hz):
    """Return the rate at which the count changes now, per second of a clock of `clock_hz`."""
    return step_timer.compute_step_rate(chip, clock_hz)


@exported("f8", STATE, "i8")
def read_motor_current(chip, axis_index):
    """Return the amplitude of the phase currents, A: none while ENABLE is not asserted."""
    return chip.amplitude if chip.inputs & ENABLE else 0.0


@hot
def _count_steps(chip):
    return chip.accepted


@hot
def _get_direction(chip):
    return chip.last_step


read_outputs, read_status, is_busy, read_counter, set_shaft = make_line_functions(sys.modules[__name__])
run, advance, trace_pulses, write_present_edge, scan_edges, run_window = make_event_functions(
    sys.modules[__name__], step_timer.advance_to_event, _count_steps, _get_direction, get_min_rate_change
)
