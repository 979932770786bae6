"""Synchronous actions of the MCX514, compiled: an event on an axis triggers an action of the same or of another axis.

An enabled set acts at the clock of its factor, or of command A0h + m, and activates other sets: of its axis, or SYNC0 of other
axes. Inferred: only enabled sets act, whatever activates them; a set without repeat is disabled when it acts; a set acts once
at a clock, however often it is activated, so that two sets cannot activate each other for ever; PIO edges count on general
inputs; a stop by a set ends a home search as 56h and 57h do.
"""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.functions import comparators as compare
from stage.chips.nova.functions import general_ports as ports
from stage.chips.nova.functions import home_search, split_pulse, timer
from stage.chips.nova.motion import rate_registers, single_axis_drive
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.registers.mcx514_words import ACTIONS
from stage.native import hot, least

DCC, TMSTA, TMSTP, SPSTA, SPSTP = MCX514_MAP.command_codes("DCC", "TMSTA", "TMSTP", "SPSTA", "SPSTP")
ENABLE, DISABLE, ACTIVATE = MCX514_MAP.command_codes("SYNCEN", "SYNCDIS", "SYNCACT")
ALL_SETS = (1 << state.SYNC_SETS) - 1
ACT, SNC, AXIS = (MCX514_MAP.bit("S0M", n) for n in ("ACT", "SNC+1", "AXIS1"))
REP = MCX514_MAP.mask("S0M", "REP")
SYNC0 = MCX514_MAP.mask("RR1", "SYNC0")
STATUS_BITS = MCX514_MAP.masks("RR3-1", "TIMER", "SPLIT")

COMPARISON, RISES, FALLS = 1, 10, 11
RISES_LOW, RISES_HIGH, FALLS_LOW, FALLS_HIGH = range(12, 16)
EVENT_BY_FACTOR = (
    0,
    0,
    state.TIMER,
    state.D_STA,
    state.C_STA,
    state.C_END,
    state.D_END,
    state.SPLIT_START,
    state.SPLTE,
    state.SPLTP,
)
"""The event of a factor, from 2 (timer up) to 9 (split pulse output)."""

(TO_DV, TO_TP, TO_SP1, TO_REGISTER, FROM_LP, FROM_RP, FROM_CT, FROM_READING, PULSE, DRIVE, COUNTER_DRIVE, ABSOLUTE_DRIVE,
 PLUS, MINUS, DRIVE_BY, DRIVE_TO, SLOW_STOP, STOP, FASTER, SLOWER, TIMER_START, TIMER_STOP, SPLIT_ON, SPLIT_OFF
 ) = range(1, len(ACTIONS))  # fmt: skip
DRIVE_KINDS = (
    single_axis_drive.RELATIVE,
    single_axis_drive.COUNTER_RELATIVE,
    single_axis_drive.ABSOLUTE,
    single_axis_drive.FORWARD,
    single_axis_drive.BACKWARD,
    single_axis_drive.RELATIVE_BY,
    single_axis_drive.ABSOLUTE_TO,
)
"""Kinds of the drives of the actions DRIVE to DRIVE_TO, by action; the last two are those of SYNC0."""
MR_TARGET_REGISTERS = (state.LP, state.RP, state.SV, state.AC)
"""Registers into which action 4 of SYNC0 to SYNC3 copies its MR."""


@hot
def reset_actions(chip, axis):
    """Clear the timer, the split pulses and the synchronous action sets of an axis."""
    axis.timer_end = axis.split_running = axis.split_output = axis.enabled_sets = axis.due_sets = 0
    axis.last_port_levels = axis.filtered_inputs >> state.PIO0_SHIFT & 0xFF
    ports.reset_pulses(axis)
    compare.reset_comparisons(chip, axis)


@hot
def execute_synchronous_command(chip, axis, code):
    """Execute a command of the deviation counter clear output (DCC), timer, split pulses or SYNC sets; ignore other codes."""
    family, sets = code & ~ALL_SETS, code & ALL_SETS
    if code == DCC:
        ports.start_dcc_pulse(chip, axis)
    elif code == TMSTA:
        timer.start_timer(chip, axis)
    elif code == TMSTP:
        timer.stop_timer(chip, axis)
    elif code == SPSTA:
        split_pulse.start_split_pulses(chip, axis)
    elif code == SPSTP:
        split_pulse.stop_split_pulses(chip, axis)
    elif family == ENABLE:
        axis.enabled_sets |= sets
    elif family == DISABLE:
        axis.enabled_sets &= ~sets
    elif family == ACTIVATE:
        axis.due_sets |= sets


@hot
def compute_status_bits(axis):
    """Compute page 1 of the register RR3: enabled synchronous action sets, TIMER, SPLIT."""
    return axis.enabled_sets | (STATUS_BITS[0] if axis.timer_end else 0) | (STATUS_BITS[1] if axis.split_running else 0)


# --- factors ---


@hot
def _has_factor_occurred(factor, set_index, events, rises, falls, levels):
    """Return whether the activation factor of synchronous action set `set_index` has occurred.

    Args:
        factor: The factor, bits 3 to 0 of SmM.
        set_index: Number of the set.
        events: Events of the axis since the last check, as bits.
        rises: PIO inputs that have risen.
        falls: PIO inputs that have fallen.
        levels: PIO levels.
    """
    if factor == 0:
        return False
    if factor == COMPARISON:
        return events >> compare.FIRST_CMR + set_index & 1 != 0
    if factor < RISES:
        return events & EVENT_BY_FACTOR[factor] != 0
    edge = falls if factor in (FALLS, FALLS_LOW, FALLS_HIGH) else rises
    if not edge >> set_index & 1:
        return False
    beside = levels >> set_index + 4 & 1
    if factor in (RISES_LOW, FALLS_LOW):
        return beside == 0
    return beside == 1 or factor in (RISES, FALLS)


@hot
def _find_due_sets(axis):
    """Find the synchronous action sets whose activation factors have occurred since the last call."""
    levels = axis.filtered_inputs >> state.PIO0_SHIFT & 0xFF
    as_inputs = ports.find_general_input_pins(axis)
    rises, falls = levels & ~axis.last_port_levels & as_inputs, axis.last_port_levels & ~levels & as_inputs
    fired = axis.new_events
    axis.last_port_levels, axis.new_events = levels, 0
    if axis.enabled_sets and fired | rises | falls:
        for m in range(state.SYNC_SETS):
            if _has_factor_occurred(axis.mode[state.S0M + m] & 15, m, fired, rises, falls, levels):
                axis.due_sets |= 1 << m


# --- actions ---


@hot
def _perform_action(chip, axis, set_index, action):
    """Perform the action of synchronous action set `set_index`."""
    mr = state.MR0 + set_index
    value = axis.reg[mr]
    if action == TO_DV:
        single_axis_drive.change_drive_speed(chip, axis, value & 0xFFFFFFFF)
    elif action == TO_TP:
        single_axis_drive.change_pulse_count(chip, axis, value)
    elif action == TO_SP1:
        axis.reg[state.SP1] = value & 0xFFFFFFFF
    elif action == TO_REGISTER:
        axis.reg[MR_TARGET_REGISTERS[set_index]] = value if set_index < 2 else value & 0xFFFFFFFF
    elif action == FROM_LP:
        axis.reg[mr] = axis.reg[state.LP]
    elif action == FROM_RP:
        axis.reg[mr] = axis.reg[state.RP]
    elif action == FROM_CT:
        axis.reg[mr] = timer.read_timer(chip, axis)
    elif action == FROM_READING:
        if set_index < 2:
            axis.reg[mr] = (
                rate_registers.read_acceleration(chip, axis) if set_index else rate_registers.read_speed(chip, axis)
            )
    elif action == PULSE:
        ports.start_sync_pulse(chip, axis, set_index)
    elif DRIVE <= action <= DRIVE_TO:
        _start_drive(chip, axis, set_index, action)
    elif action in (SLOW_STOP, STOP):
        home_search.end_search(chip, axis)
        if axis.driving and action == SLOW_STOP:
            single_axis_drive.begin_decelerating_stop(chip, axis, state.F_SYNC)
        elif axis.driving:
            single_axis_drive.end_drive(chip, axis, state.F_SYNC)
    elif action in (FASTER, SLOWER):
        single_axis_drive.step_drive_speed(chip, axis, 1 if action == FASTER else -1)
    elif action == TIMER_START:
        timer.start_timer(chip, axis)
    elif action == TIMER_STOP:
        timer.stop_timer(chip, axis)
    elif action == SPLIT_ON:
        split_pulse.start_split_pulses(chip, axis)
    elif action == SPLIT_OFF:
        split_pulse.stop_split_pulses(chip, axis)


@hot
def _start_drive(chip, axis, set_index, action):
    """Start the drive that is the action of synchronous action set `set_index`."""
    kind = DRIVE_KINDS[action - DRIVE] + (set_index if action >= DRIVE_BY else 0)
    single_axis_drive.execute_drive_command(chip, axis, kind)


@hot
def _activate_set(chip, axis_index, set_index):
    """Perform the action of synchronous action set `set_index`, and activate the other sets that this set selects."""
    axis = chip.ax[axis_index]
    mode = axis.mode[state.S0M + set_index]
    axis.finished_sets |= 1 << set_index
    axis.events |= SYNC0 << set_index
    if not mode & REP:
        axis.enabled_sets &= ~(1 << set_index)
    for k in range(1, state.SYNC_SETS):
        if mode >> SNC + k - 1 & 1:
            axis.due_sets |= 1 << (set_index + k) % state.SYNC_SETS
    for k in range(1, chip.axes):
        if mode >> AXIS + k - 1 & 1:
            chip.ax[(axis_index + k) % chip.axes].due_sets |= 1
    chip.stale = 1
    _perform_action(chip, axis, set_index, mode >> ACT & 31)


# --- time ---


@hot
def run_due_synchronous_actions(chip, axis_index):
    """Run the synchronous actions that are due at the present clock. Sets `chip.stale` if that changes the chip."""
    axis = chip.ax[axis_index]
    if chip.variant != state.MCX514_TYPE:
        compare.update_comparisons(chip, axis)
        return
    timer.update_timer(chip, axis)
    split_pulse.update_split_pulses(chip, axis)
    compare.update_comparisons(chip, axis)
    _find_due_sets(axis)
    due = axis.due_sets & axis.enabled_sets & ~axis.finished_sets
    axis.due_sets = 0
    for m in range(state.SYNC_SETS):
        if due >> m & 1:
            _activate_set(chip, axis_index, m)


@hot
def count_pulses_to_event(chip, axis):
    """Return the number of pulses of the drive until a comparison or the split pulse changes."""
    return least(compare.count_pulses_to_change(chip, axis), split_pulse.count_pulses_to_edge(axis))


@hot
def find_next_event(chip, axis):
    """Return the clock of the next event of an axis' timer, comparisons or pin pulses; NEVER if there is none."""
    return least(
        least(timer.find_timer_end(axis), compare.find_next_speed_or_timer_comparison_change(chip, axis)),
        ports.find_next_pulse_end(chip, axis),
    )
