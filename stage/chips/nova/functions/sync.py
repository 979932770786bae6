"""NOVA MCX514, compiled: the synchronous actions, and what can be their factor: comparisons, timer, split pulse, PIO edges.

A set that is enabled acts at the clock of its factor, or of A0h + m, and activates others: sets of its axis, SYNC0 of other axes.
Inferred: only enabled sets act, whatever activates them; a set without repeat is disabled when it acts; a set acts once at a clock,
however often it is activated, so that two sets cannot activate each other for ever; PIO edges count on general inputs; a stop by a
set ends a home search as 56h and 57h do.
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
ALL = (1 << state.SYNC_SETS) - 1
ACT, SNC, AXIS = (MCX514_MAP.bit("S0M", n) for n in ("ACT", "SNC+1", "AXIS1"))
REP = MCX514_MAP.mask("S0M", "REP")
SYNC0 = MCX514_MAP.mask("RR1", "SYNC0")
SHOWN = tuple(MCX514_MAP.mask("RR3-1", n) for n in ("TIMER", "SPLIT"))

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

(TO_DV, TO_TP, TO_SP1, TO_OWN, FROM_LP, FROM_RP, FROM_CT, FROM_OWN, PULSE, DRIVE, COUNTER_DRIVE, ABSOLUTE_DRIVE, PLUS, MINUS,
 DRIVE_BY, DRIVE_TO, SLOW_STOP, STOP, FASTER, SLOWER, TIMER_START, TIMER_STOP, SPLIT_ON, SPLIT_OFF
 ) = range(1, len(ACTIONS))  # fmt: skip
OWN = (state.LP, state.RP, state.SV, state.AC)
"""Where action 4 of SYNC0 to SYNC3 puts its MR."""


@hot
def reset(c, x):
    x.timer = x.split = x.split_on = x.sync = x.triggered = 0
    x.ports = x.level >> state.PIO & 0xFF
    ports.reset(x)
    compare.reset(c, x)


@hot
def command(c, x, code):
    """DCC, timer, split pulse, SYNC sets; others are not known."""
    family, sets = code & ~ALL, code & ALL
    if code == DCC:
        ports.clear_deviation(c, x)
    elif code == TMSTA:
        timer.start(c, x)
    elif code == TMSTP:
        timer.stop(c, x)
    elif code == SPSTA:
        split_pulse.start(c, x)
    elif code == SPSTP:
        split_pulse.stop(c, x)
    elif family == ENABLE:
        x.sync |= sets
    elif family == DISABLE:
        x.sync &= ~sets
    elif family == ACTIVATE:
        x.triggered |= sets


@hot
def status_bits(x):
    """RR3 page 1: SYNC0-3 enabled, TIMER, SPLIT."""
    return x.sync | (SHOWN[0] if x.timer else 0) | (SHOWN[1] if x.split else 0)


# --- factors ---


@hot
def _due(factor, m, fired, rises, falls, levels):
    """The factor of set `m` has come. fired: events; rises, falls, levels: of PIO."""
    if factor == 0:
        return False
    if factor == COMPARISON:
        return fired >> compare.CMR + m & 1 != 0
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
def _look(x):
    """Find the sets whose activation factors have occurred since the last call."""
    levels = x.level >> state.PIO & 0xFF
    as_inputs = ports.inputs(x)
    rises, falls = levels & ~x.ports & as_inputs, x.ports & ~levels & as_inputs
    fired = x.fired
    x.ports, x.fired = levels, 0
    if x.sync and fired | rises | falls:
        for m in range(state.SYNC_SETS):
            if _due(x.mode[state.S0M + m] & 15, m, fired, rises, falls, levels):
                x.triggered |= 1 << m


# --- actions ---


@hot
def _act(c, x, m, action):
    """The action of set `m`."""
    mr = state.MR0 + m
    value = x.reg[mr]
    if action == TO_DV:
        drive.change_speed(c, x, value & 0xFFFFFFFF)
    elif action == TO_TP:
        drive.change_output(c, x, value)
    elif action == TO_SP1:
        x.reg[state.SP1] = value & 0xFFFFFFFF
    elif action == TO_OWN:
        x.reg[OWN[m]] = value if m < 2 else value & 0xFFFFFFFF
    elif action == FROM_LP:
        x.reg[mr] = x.reg[state.LP]
    elif action == FROM_RP:
        x.reg[mr] = x.reg[state.RP]
    elif action == FROM_CT:
        x.reg[mr] = timer.reading(c, x)
    elif action == FROM_OWN:
        if m < 2:
            x.reg[mr] = rates.rate_reading(c, x) if m else rates.speed_reading(c, x)
    elif action == PULSE:
        ports.sync_pulse(c, x, m)
    elif DRIVE <= action <= DRIVE_TO:
        _start(c, x, m, action)
    elif action in (SLOW_STOP, STOP):
        home.end(c, x)
        if x.driving and action == SLOW_STOP:
            drive.request_stop(c, x, state.F_SYNC)
        elif x.driving:
            drive.end(c, x, state.F_SYNC)
    elif action in (FASTER, SLOWER):
        drive.step_speed(c, x, 1 if action == FASTER else -1)
    elif action == TIMER_START:
        timer.start(c, x)
    elif action == TIMER_STOP:
        timer.stop(c, x)
    elif action == SPLIT_ON:
        split_pulse.start(c, x)
    elif action == SPLIT_OFF:
        split_pulse.stop(c, x)


@hot
def _start(c, x, m, action):
    """A drive begins."""
    if action == DRIVE:
        drive.start(c, x, drive.RELATIVE)
    elif action == COUNTER_DRIVE:
        drive.start(c, x, drive.COUNTER_RELATIVE)
    elif action == ABSOLUTE_DRIVE:
        drive.start(c, x, drive.ABSOLUTE)
    elif action in (PLUS, MINUS):
        drive.start(c, x, drive.FORWARD if action == PLUS else drive.BACKWARD)
    else:
        drive.start(c, x, (drive.RELATIVE_BY if action == DRIVE_BY else drive.ABSOLUTE_TO) + m)


@hot
def _activate(c, j, m):
    """Set `m` acts, and asks others to."""
    x = c.ax[j]
    mode = x.mode[state.S0M + m]
    x.acted |= 1 << m
    x.factors |= SYNC0 << m
    if not mode & REP:
        x.sync &= ~(1 << m)
    for k in range(1, state.SYNC_SETS):
        if mode >> SNC + k - 1 & 1:
            x.triggered |= 1 << (m + k) % state.SYNC_SETS
    for k in range(1, c.axes):
        if mode >> AXIS + k - 1 & 1:
            c.ax[(j + k) % c.axes].triggered |= 1
    c.stale = 1
    _act(c, x, m, mode >> ACT & 31)


# --- time ---


@hot
def step(c, j):
    """What is due at the present clock; sets `stale` where it changes something."""
    x = c.ax[j]
    if c.variant != state.MCX514_TYPE:
        compare.step(c, x)
        return
    timer.step(c, x)
    split_pulse.step(c, x)
    compare.step(c, x)
    _look(x)
    due = x.triggered & x.sync & ~x.acted
    x.triggered = 0
    for m in range(state.SYNC_SETS):
        if due >> m & 1:
            _activate(c, j, m)


@hot
def pulses_ahead(c, x):
    """Pulses of the drive until a comparison or the split pulse cares."""
    return least(compare.pulses_ahead(c, x), split_pulse.pulses_ahead(x))


@hot
def next_event(c, x):
    """The clock of the next event, NEVER if none is coming."""
    return least(least(timer.next_event(x), compare.next_event(c, x)), ports.next_event(c, x))
