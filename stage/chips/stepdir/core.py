"""Core of the STEP/DIR axis, compiled: it advances from one edge to the next, see stage/chips/cores.py.

Firmware drives STEP, DIR and ENABLE as input pins. A host without firmware lets the step timer drive STEP and DIR: it writes rates,
ramps and a number of steps, and a start. The steps of a line's shorter axes are spread among those of the longest one by
Bresenham's rule, as firmware for machine tools does it.
"""

from __future__ import annotations

import numpy as np

from stage.chips.cores import SCAN_ROOM, run_slices
from stage.chips.stepdir.maps import CONTROL_ADDRESS, DATA_MASK, MAP
from stage.chips.stepdir.state import (
    BUSY,
    DIR,
    DOWN,
    EL_MINUS,
    EL_PLUS,
    ENABLE,
    EVENTS,
    HIGH,
    INPUTS,
    NEVER,
    ORG,
    OUTPUTS,
    POSITION,
    RATE,
    REGISTERS,
    STATE,
    STEP,
    STEPS,
    TIMES,
    UP,
)
from stage.chips.stepdir.step_edges import apply_line_levels, compute_mean_count, measure_step_rate, to_clocks
from stage.chips.stepdir.step_timer_profile import (
    compute_present_rate,
    find_present_ramp,
    find_time_of_step,
    plan_move,
    plan_stop,
)
from stage.native import array_of, exported, greatest, hot, least, record

__all__ = ["INPUTS", "OUTPUTS", "STATE"]

GO, MINUS, CONTINUOUS, UNTIL_ORG, SLOW, AT_ONCE = MAP.masks(
    "control", "start", "minus", "continuous", "until_org", "ramp_down", "at_once"
)
END = MAP.field("status", "end").low
ALL_STEPS, END_EL_PLUS, END_EL_MINUS, END_ORG, STOPPED = 1, 2, 3, 4, 5
PINS_SHIFT = MAP.field("status", "plus_limit").low
HIGH_NS = MAP.register("HIGH").reset
MARKED_CHANGE = 0.01
"""Share of RATE by which the rate changes between two edges of a course."""

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs counter net".split()] + [("rate", "f8")])


@hot
def _schedule_rise(chip):
    """Set the clock of the next rising edge of STEP; STEP stays low at least as long as it was high."""
    if chip.events and chip.steps_done >= chip.steps:
        chip.next_rise = NEVER
        return
    event = chip.steps_done + 1
    if chip.events > chip.steps:  # Bresenham: step k comes with event ceil((k events - events // 2) / steps)
        event = -((chip.events // 2 - event * chip.events) // chip.steps)
    at = find_time_of_step(chip, event - 0.5)
    chip.next_rise = (
        NEVER if at == NEVER else greatest(at, greatest(chip.rose + 2 * _compute_high_clocks(chip), chip.clock + 1))
    )


@hot
def _compute_high_clocks(chip):
    """Return the clocks that STEP stays high."""
    return greatest(1, to_clocks(chip, 1e-9 * chip.reg[HIGH]))


@hot
def _end_move(chip, reason):
    """End the move at once; a pulse in progress is finished."""
    chip.running = chip.slowing = 0
    chip.next_rise = chip.profile_end = NEVER
    chip.end_reason = reason


@hot
def _is_limit_ahead(chip):
    """Return the reason of an end limit that blocks the direction of the move, or 0."""
    if chip.control & MINUS:
        return END_EL_MINUS if chip.inputs & EL_MINUS else 0
    return END_EL_PLUS if chip.inputs & EL_PLUS else 0


@hot
def _start_move(chip, word):
    """Begin a move, unless one is in progress, it has no steps or no rate, or a switch ends it before its first step."""
    if chip.running or chip.reg[RATE] == 0 or (chip.reg[STEPS] == 0 and not word & CONTINUOUS):
        return
    chip.control = word
    reason = _is_limit_ahead(chip)
    if reason == 0 and word & UNTIL_ORG and chip.inputs & ORG:
        reason = END_ORG
    if reason:
        _end_move(chip, reason)
        return
    apply_line_levels(chip, chip.inputs | DIR if word & MINUS else chip.inputs & ~DIR)
    chip.running, chip.slowing, chip.end_reason, chip.steps_done = 1, 0, 0, 0
    chip.steps = chip.reg[STEPS]
    chip.events = 0 if word & CONTINUOUS else greatest(chip.steps, chip.reg[EVENTS])
    plan_move(chip)
    _schedule_rise(chip)


@hot
def _slow_down(chip, reason):
    """Begin the ramp down; the move ends for this reason."""
    if chip.running and not chip.slowing:
        chip.slowing, chip.end_reason = 1, reason
        plan_stop(chip)
        _schedule_rise(chip)


@hot
def _find_next_event(chip):
    """Return the clock of the next event of the step timer, or NEVER."""
    if chip.next_fall != NEVER:
        return least(chip.next_fall, chip.next_rise)
    if not chip.running:
        return NEVER
    return chip.next_rise if chip.next_rise != NEVER else chip.profile_end


@hot
def _process_event(chip):
    """Let the event of the present clock happen."""
    if chip.clock == chip.next_fall:
        chip.next_fall = NEVER
        apply_line_levels(chip, chip.inputs & ~STEP)
    elif chip.clock == chip.next_rise:
        chip.steps_done += 1
        chip.next_fall = chip.clock + _compute_high_clocks(chip)
        apply_line_levels(chip, chip.inputs | STEP)
        _schedule_rise(chip)
    else:
        _end_move(chip, chip.end_reason if chip.end_reason else ALL_STEPS)


@hot
def _advance_to_event(chip, until):
    """Let time pass to the next event or to `until`, and return whether an event happened."""
    at = greatest(_find_next_event(chip), chip.clock)
    if at > until:
        chip.clock = until
        return False
    chip.clock = at
    _process_event(chip)
    return True


@exported(None, STATE, "i8")
def run(chip, until):
    """Let the clock run up to `until`."""
    while _advance_to_event(chip, until):
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
    while _advance_to_event(chip, until):
        if chip.accepted > before:
            pulses[k].clock, pulses[k].axis, pulses[k].direction = chip.clock, 0, chip.last_step
            k += 1
        before = chip.accepted
    return k


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def write_present_edge(chip, axis_index, edges, edge_index):
    """Write the axis as it is now into edge `edge_index`."""
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
    """Let the clock run up to `until` and mark changes of outputs and rate, and each edge of the lines if `every_pulse`."""
    k, word, rate = 0, read_outputs(chip, 0), compute_pulse_rate(chip, 0, 1.0)
    while chip.clock < until and k < len(edges) - SCAN_ROOM:
        if not _advance_to_event(chip, until):
            break
        now, new = read_outputs(chip, 0), compute_pulse_rate(chip, 0, 1.0)
        if every_pulse or now != word or abs(new - rate) > MARKED_CHANGE * chip.reg[RATE] / chip.hz:
            write_present_edge(chip, 0, edges, k)
            word, rate = now, new
            k += 1
    return k


@exported(None, STATE, "i8", "i8")
def run_window(chip, row_address, first_slice):
    """Run the slices of a physics step."""
    run_slices(chip, row_address, first_slice, run, read_net_count, compute_drive_input)


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(chip, axis_index, net_before, clocks):
    """Return the mean count of the last `clocks` clocks, which began with the count `net_before`."""
    return compute_mean_count(chip, net_before, clocks)


@exported(None, STATE)
def power_up(chip):
    """Clear registers, step timer and violations; lines and switches stay as the host and the stage drive them."""
    for k in range(REGISTERS):
        chip.reg[k] = 0
    for k in range(TIMES):
        chip.violations[k] = chip.shortest[k] = chip.first_violation[k] = 0
    chip.reg[HIGH] = HIGH_NS
    chip.origin = chip.net
    chip.control = chip.events = chip.steps = chip.steps_done = chip.segment = chip.segments = 0
    chip.last_step = chip.started = 0
    chip.rose = chip.fell = chip.turned = chip.enabled = -NEVER
    chip.next_fall = NEVER
    _end_move(chip, 0)


@exported("i8", STATE, "i8")
def peek(chip, address):
    """Return what a read would give."""
    if address == CONTROL_ADDRESS:
        return read_status(chip, 0)
    return read_counter(chip, 0) if address == POSITION else chip.reg[address]


@exported("i8", STATE, "i8")
def read(chip, address):
    """Make a read cycle."""
    return peek(chip, address)


@exported(None, STATE, "i8", "i8")
def write(chip, address, value):
    """Make a write cycle."""
    if address != CONTROL_ADDRESS:
        if address != POSITION:
            chip.reg[address] = value
    elif value & AT_ONCE:
        if chip.running:
            _end_move(chip, STOPPED)
    elif value & SLOW:
        _slow_down(chip, STOPPED)
    elif value & GO:
        _start_move(chip, value)


@exported(None, STATE, "i8", "i8")
def set_input(chip, axis_index, word):
    """Take new levels of the input pins."""
    reached = word & ~chip.inputs & ORG
    apply_line_levels(chip, word)
    if not chip.running:
        return
    reason = _is_limit_ahead(chip)
    if reason:
        _end_move(chip, reason)
    elif chip.control & UNTIL_ORG and reached:
        _slow_down(chip, END_ORG)


@exported("i8", STATE, "i8")
def read_inputs(chip, axis_index):
    """Return the input pins."""
    return chip.inputs


@exported("i8", STATE, "i8")
def read_outputs(chip, axis_index):
    """Return the output pins."""
    if not chip.running:
        return 0
    ramp = find_present_ramp(chip)
    return BUSY | (UP if ramp > 0 else DOWN if ramp < 0 else 0)


@exported("i8", STATE, "i8")
def read_status(chip, axis_index):
    """Return the status word."""
    pins = chip.inputs // EL_PLUS & 0xF
    return (1 if chip.running else 0) | pins << PINS_SHIFT | chip.end_reason << END


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
    """Return POSITION."""
    return (chip.net - chip.origin) & DATA_MASK


@exported("f8", STATE, "i8", "f8")
def compute_pulse_rate(chip, axis_index, hz):
    """Return the rate at which the count changes now, per second of a clock of `hz`."""
    if not chip.running:
        return measure_step_rate(chip, hz)
    share = float(chip.steps) / chip.events if chip.events else 1.0
    return (-1.0 if chip.control & MINUS else 1.0) * share * compute_present_rate(chip) * hz / chip.hz


@exported("f8", STATE, "i8")
def read_motor_current(chip, axis_index):
    """Return the amplitude of the phase currents, A: none while ENABLE is not asserted."""
    return chip.amplitude if chip.inputs & ENABLE else 0.0


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(chip, axis_index, count, rate):
    """Do nothing: the axis has no input for an encoder."""
