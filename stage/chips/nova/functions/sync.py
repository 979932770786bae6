"""The synchronous actions of the MCX514 and their activation factors: comparisons, timer, split pulse, PIO edges; compiled.

An enabled set acts at the clock of its factor, or of command A0h + m, and activates other sets: of its axis, or SYNC0 of other
axes. Inferred: only enabled sets act, whatever activates them; a set without repeat is disabled when it acts; a set acts once
at a clock, however often it is activated, so that two sets cannot activate each other for ever; PIO edges count on general
inputs; a stop by a set ends a home search as 56h and 57h do.
"""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.functions import comparators as compare
from stage.chips.nova.functions import home, split_pulse, timer
from stage.chips.nova.functions import io as ports
from stage.chips.nova.motion import drive, rates
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.registers.words514 import ACTIONS
from stage.native import hot, least

DCC, TMSTA, TMSTP, SPSTA, SPSTP = (MCX514_MAP.command(n).code for n in ("DCC", "TMSTA", "TMSTP", "SPSTA", "SPSTP"))
ENABLE, DISABLE, ACTIVATE = (MCX514_MAP.command(n).code for n in ("SYNCEN", "SYNCDIS", "SYNCACT"))
ALL_SETS = (1 << state.SYNC_SETS) - 1
ACT, SNC, AXIS = (MCX514_MAP.bit("S0M", n) for n in ("ACT", "SNC+1", "AXIS1"))
REP = MCX514_MAP.mask("S0M", "REP")
SYNC0 = MCX514_MAP.mask("RR1", "SYNC0")
STATUS_BITS = tuple(MCX514_MAP.mask("RR3-1", n) for n in ("TIMER", "SPLIT"))

COMPARISON, RISES, FALLS = 1, 10, 11
RISES_LOW, RISES_HIGH, FALLS_LOW, FALLS_HIGH = range(12, 16)
EVENTS = (
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
EXCHANGED_REGISTERS = (state.LP, state.RP, state.SV, state.AC)
"""Registers into which action 4 of SYNC0 to SYNC3 copies its MR."""


@hot
def reset_actions(c, x):
    """Clear the timer, the split pulses and the synchronous action sets of an axis."""
    x.timer_end = x.split_running = x.split_output = x.enabled_sets = x.due_sets = 0
    x.last_port_levels = x.filtered_inputs >> state.PIO & 0xFF
    ports.reset_pulses(x)
    compare.reset_comparisons(c, x)


@hot
def execute_command(c, x, code):
    """Execute a command of DCC, timer, split pulses or SYNC sets; ignore others."""
    family, sets = code & ~ALL_SETS, code & ALL_SETS
    if code == DCC:
        ports.start_dcc_pulse(c, x)
    elif code == TMSTA:
        timer.start_timer(c, x)
    elif code == TMSTP:
        timer.stop_timer(c, x)
    elif code == SPSTA:
        split_pulse.start_split_pulses(c, x)
    elif code == SPSTP:
        split_pulse.stop_split_pulses(c, x)
    elif family == ENABLE:
        x.enabled_sets |= sets
    elif family == DISABLE:
        x.enabled_sets &= ~sets
    elif family == ACTIVATE:
        x.due_sets |= sets


@hot
def compute_status_bits(x):
    """Compute page 1 of RR3: enabled SYNC sets, TIMER, SPLIT."""
    return x.enabled_sets | (STATUS_BITS[0] if x.timer_end else 0) | (STATUS_BITS[1] if x.split_running else 0)


# --- factors ---


@hot
def _has_occurred(factor, m, fired, rises, falls, levels):
    """Return whether the activation factor of set `m` has occurred.

    Args:
        factor: The factor, bits 3 to 0 of SmM.
        m: Number of the set.
        fired: Events since the last check.
        rises: PIO inputs that have risen.
        falls: PIO inputs that have fallen.
        levels: PIO levels.
    """
    if factor == 0:
        return False
    if factor == COMPARISON:
        return fired >> compare.FIRST_CMR + m & 1 != 0
    if factor < RISES:
        return fired & EVENTS[factor] != 0
    edge = falls if factor in (FALLS, FALLS_LOW, FALLS_HIGH) else rises
    if not edge >> m & 1:
        return False
    beside = levels >> m + 4 & 1
    if factor in (RISES_LOW, FALLS_LOW):
        return beside == 0
    return beside == 1 or factor in (RISES, FALLS)


@hot
def _find_due_sets(x):
    """Find the sets whose activation factors have occurred since the last call."""
    levels = x.filtered_inputs >> state.PIO & 0xFF
    as_inputs = ports.find_general_inputs(x)
    rises, falls = levels & ~x.last_port_levels & as_inputs, x.last_port_levels & ~levels & as_inputs
    fired = x.new_events
    x.last_port_levels, x.new_events = levels, 0
    if x.enabled_sets and fired | rises | falls:
        for m in range(state.SYNC_SETS):
            if _has_occurred(x.mode[state.S0M + m] & 15, m, fired, rises, falls, levels):
                x.due_sets |= 1 << m


# --- actions ---


@hot
def _perform_action(c, x, m, action):
    """Perform the action of set `m`."""
    mr = state.MR0 + m
    value = x.reg[mr]
    if action == TO_DV:
        drive.change_drive_speed(c, x, value & 0xFFFFFFFF)
    elif action == TO_TP:
        drive.change_pulse_count(c, x, value)
    elif action == TO_SP1:
        x.reg[state.SP1] = value & 0xFFFFFFFF
    elif action == TO_REGISTER:
        x.reg[EXCHANGED_REGISTERS[m]] = value if m < 2 else value & 0xFFFFFFFF
    elif action == FROM_LP:
        x.reg[mr] = x.reg[state.LP]
    elif action == FROM_RP:
        x.reg[mr] = x.reg[state.RP]
    elif action == FROM_CT:
        x.reg[mr] = timer.read_timer(c, x)
    elif action == FROM_READING:
        if m < 2:
            x.reg[mr] = rates.read_acceleration(c, x) if m else rates.read_speed(c, x)
    elif action == PULSE:
        ports.start_sync_pulse(c, x, m)
    elif DRIVE <= action <= DRIVE_TO:
        _start_drive(c, x, m, action)
    elif action in (SLOW_STOP, STOP):
        home.end_search(c, x)
        if x.driving and action == SLOW_STOP:
            drive.begin_decelerating_stop(c, x, state.F_SYNC)
        elif x.driving:
            drive.end_drive(c, x, state.F_SYNC)
    elif action in (FASTER, SLOWER):
        drive.step_drive_speed(c, x, 1 if action == FASTER else -1)
    elif action == TIMER_START:
        timer.start_timer(c, x)
    elif action == TIMER_STOP:
        timer.stop_timer(c, x)
    elif action == SPLIT_ON:
        split_pulse.start_split_pulses(c, x)
    elif action == SPLIT_OFF:
        split_pulse.stop_split_pulses(c, x)


@hot
def _start_drive(c, x, m, action):
    """Start the drive that is the action of set `m`."""
    if action == DRIVE:
        drive.execute_drive_command(c, x, drive.RELATIVE)
    elif action == COUNTER_DRIVE:
        drive.execute_drive_command(c, x, drive.COUNTER_RELATIVE)
    elif action == ABSOLUTE_DRIVE:
        drive.execute_drive_command(c, x, drive.ABSOLUTE)
    elif action in (PLUS, MINUS):
        drive.execute_drive_command(c, x, drive.FORWARD if action == PLUS else drive.BACKWARD)
    else:
        drive.execute_drive_command(c, x, (drive.RELATIVE_BY if action == DRIVE_BY else drive.ABSOLUTE_TO) + m)


@hot
def _activate_set(c, j, m):
    """Let set `m` of axis `j` act, and activate the other sets that it names."""
    x = c.ax[j]
    mode = x.mode[state.S0M + m]
    x.finished_sets |= 1 << m
    x.events |= SYNC0 << m
    if not mode & REP:
        x.enabled_sets &= ~(1 << m)
    for k in range(1, state.SYNC_SETS):
        if mode >> SNC + k - 1 & 1:
            x.due_sets |= 1 << (m + k) % state.SYNC_SETS
    for k in range(1, c.axes):
        if mode >> AXIS + k - 1 & 1:
            c.ax[(j + k) % c.axes].due_sets |= 1
    c.stale = 1
    _perform_action(c, x, m, mode >> ACT & 31)


# --- time ---


@hot
def run_due_sets(c, j):
    """Do what is due at the present clock. Sets `stale` if that changes something."""
    x = c.ax[j]
    if c.variant != state.MCX514_TYPE:
        compare.update_comparisons(c, x)
        return
    timer.update_timer(c, x)
    split_pulse.update_split_pulses(c, x)
    compare.update_comparisons(c, x)
    _find_due_sets(x)
    due = x.due_sets & x.enabled_sets & ~x.finished_sets
    x.due_sets = 0
    for m in range(state.SYNC_SETS):
        if due >> m & 1:
            _activate_set(c, j, m)


@hot
def count_pulses_to_event(c, x):
    """Return the number of pulses of the drive until a comparison or the split pulse changes."""
    return least(compare.count_pulses_to_change(c, x), split_pulse.count_pulses_to_edge(x))


@hot
def find_next_event(c, x):
    """Return the clock of the next event of timer, comparisons or pulses; NEVER if there is none."""
    return least(least(timer.find_timer_end(x), compare.find_next_change(c, x)), ports.find_next_pulse_end(c, x))
