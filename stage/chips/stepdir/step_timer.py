"""Step timer of a STEP/DIR axis, compiled: its moves, the edges that it makes, and its stops.

The functions take the state of every axis that has the fields of `state.STATE`, so that the lines of a power stage with registers
of its own, whose state has more fields, use them as well.
"""

from __future__ import annotations

from stage.chips.stepdir.maps import CONTROL_ADDRESS, DATA_MASK, MAP
from stage.chips.stepdir.state import (
    BUSY,
    DIR,
    DOWN,
    EDGE_TIME_COUNT,
    EL_MINUS,
    EL_PLUS,
    EVENTS,
    HIGH,
    NEVER,
    ORG,
    POSITION,
    RATE,
    REGISTERS,
    STEP,
    STEPS,
    UP,
)
from stage.chips.stepdir.step_edges import apply_line_levels, measure_step_rate, to_clocks
from stage.chips.stepdir.step_timer_profile import (
    compute_present_rate,
    find_present_ramp,
    find_time_of_step,
    plan_move,
    plan_stop,
)
from stage.native import greatest, hot, least

GO, MINUS, CONTINUOUS, UNTIL_ORG, SLOW, AT_ONCE = MAP.masks(
    "control", "start", "minus", "continuous", "until_org", "ramp_down", "at_once"
)
END_REASON_SHIFT = MAP.field("status", "end").low
ALL_STEPS, END_EL_PLUS, END_EL_MINUS, END_ORG, STOPPED = 1, 2, 3, 4, 5
PINS_SHIFT = MAP.field("status", "plus_limit").low
HIGH_NS = MAP.register("HIGH").reset


@hot
def _schedule_rise(chip):
    """Schedule the next rising edge of STEP, so that STEP stays low at least as long as it was high."""
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
    """Return the number of clocks for which STEP stays high in each pulse of the step timer."""
    return greatest(1, to_clocks(chip, 1e-9 * chip.reg[HIGH]))


@hot
def end_move(chip, reason):
    """End the move at once; a pulse in progress is finished."""
    chip.running = chip.slowing = 0
    chip.next_rise = chip.profile_end = NEVER
    chip.end_reason = reason


@hot
def _find_limit_ahead(chip):
    """Return the end reason of the asserted end limit in the direction of the move, or 0 if none is asserted."""
    if chip.control & MINUS:
        return END_EL_MINUS if chip.inputs & EL_MINUS else 0
    return END_EL_PLUS if chip.inputs & EL_PLUS else 0


@hot
def start_move(chip, word):
    """Begin a move, unless one is in progress, it has no steps or no rate, or a switch ends it before its first step."""
    if chip.running or chip.reg[RATE] == 0 or (chip.reg[STEPS] == 0 and not word & CONTINUOUS):
        return
    chip.control = word
    reason = _find_limit_ahead(chip)
    if reason == 0 and word & UNTIL_ORG and chip.inputs & ORG:
        reason = END_ORG
    if reason:
        end_move(chip, reason)
        return
    apply_line_levels(chip, chip.inputs | DIR if word & MINUS else chip.inputs & ~DIR)
    chip.running, chip.slowing, chip.end_reason, chip.steps_done = 1, 0, 0, 0
    chip.steps = chip.reg[STEPS]
    chip.events = 0 if word & CONTINUOUS else greatest(chip.steps, chip.reg[EVENTS])
    plan_move(chip)
    _schedule_rise(chip)


@hot
def slow_down(chip, reason):
    """Begin the ramp down at whose end the move ends with this reason."""
    if chip.running and not chip.slowing:
        chip.slowing, chip.end_reason = 1, reason
        plan_stop(chip)
        _schedule_rise(chip)


@hot
def find_next_event(chip):
    """Return the clock of the next event of the step timer, or NEVER."""
    if chip.next_fall != NEVER:
        return least(chip.next_fall, chip.next_rise)
    if not chip.running:
        return NEVER
    return chip.next_rise if chip.next_rise != NEVER else chip.profile_end


@hot
def process_event(chip):
    """Process the event of the step timer at the present clock: an edge of STEP or the end of the move."""
    if chip.clock == chip.next_fall:
        chip.next_fall = NEVER
        apply_line_levels(chip, chip.inputs & ~STEP)
    elif chip.clock == chip.next_rise:
        chip.steps_done += 1
        chip.next_fall = chip.clock + _compute_high_clocks(chip)
        apply_line_levels(chip, chip.inputs | STEP)
        _schedule_rise(chip)
    else:
        end_move(chip, chip.end_reason if chip.end_reason else ALL_STEPS)


@hot
def advance_to_event(chip, until):
    """Let time pass to the next event or to `until`, and return whether an event happened."""
    at = greatest(find_next_event(chip), chip.clock)
    if at > until:
        chip.clock = until
        return False
    chip.clock = at
    process_event(chip)
    return True


@hot
def clear(chip):
    """Clear the registers, the step timer and the violations. The host and the stage keep driving lines and switches."""
    for k in range(REGISTERS):
        chip.reg[k] = 0
    for k in range(EDGE_TIME_COUNT):
        chip.violations[k] = chip.shortest[k] = chip.first_violation[k] = 0
    chip.reg[HIGH] = HIGH_NS
    chip.origin = chip.net
    chip.control = chip.events = chip.steps = chip.steps_done = chip.segment = chip.segments = 0
    chip.last_step = chip.started = 0
    chip.rose = chip.fell = chip.turned = chip.enabled = -NEVER
    chip.next_fall = NEVER
    end_move(chip, 0)


@hot
def stop_at_switches(chip, rising):
    """End the move at a limit ahead, and slow it down when ORG is among the pins that have become asserted."""
    if not chip.running:
        return
    reason = _find_limit_ahead(chip)
    if reason:
        end_move(chip, reason)
    elif chip.control & UNTIL_ORG and rising & ORG:
        slow_down(chip, END_ORG)


@hot
def compute_output_pins(chip):
    """Return the output pins."""
    if not chip.running:
        return 0
    ramp = find_present_ramp(chip)
    return BUSY | (UP if ramp > 0 else DOWN if ramp < 0 else 0)


@hot
def compute_status(chip):
    """Return the status word."""
    pins = chip.inputs // EL_PLUS & 0xF
    return (1 if chip.running else 0) | pins << PINS_SHIFT | chip.end_reason << END_REASON_SHIFT


@hot
def compute_step_rate(chip, clock_hz):
    """Return the signed rate of steps now, per second of a clock of `clock_hz`; 0 from the end of a move to a host's next step."""
    if not chip.running:
        return 0.0 if chip.steps_done else measure_step_rate(chip, clock_hz)
    share = float(chip.steps) / chip.events if chip.events else 1.0
    return (-1.0 if chip.control & MINUS else 1.0) * share * compute_present_rate(chip) * clock_hz / chip.hz


@hot
def read_position(chip):
    """Return the value of the register POSITION."""
    return (chip.net - chip.origin) & DATA_MASK


@hot
def read_register(chip, address):
    """Return the value that a read cycle at an address returns."""
    if address == CONTROL_ADDRESS:
        return compute_status(chip)
    return read_position(chip) if address == POSITION else chip.reg[address]


@hot
def write_register(chip, address, value):
    """Process a write cycle."""
    if address != CONTROL_ADDRESS:
        if address != POSITION:
            chip.reg[address] = value
    elif value & AT_ONCE:
        if chip.running:
            end_move(chip, STOPPED)
    elif value & SLOW:
        slow_down(chip, STOPPED)
    elif value & GO:
        start_move(chip, value)
