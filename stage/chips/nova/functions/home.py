"""The automatic home search of the NOVA chips, compiled.

         ____ DV
        /    \\            step 1: to the signal, where it brakes
       /      \\__    HV
    SV/          |_  ____|  step 2: back out of it, then to its edge
                   \\/       ____  steps 3, 4: on to STOP2, and an offset

Step 1 at the drive speed to a signal, step 2 at HV to the next, step 3 at HV to STOP2, step 4 an offset at the drive speed.
Step 1 is skipped if its signal, or the limit ahead, is already asserted; the limit also ends it [M]. In step 2 the axis backs out
of a signal that is already asserted, or from a limit ahead over the signal, and then searches once more. Step 3 fails if STOP2 is
already asserted; any other stop ends the search, with its own error bit. `x.home_state` is HSST of the MCX514.

Inferred: a step at HV is an ordinary drive at that speed, constant where HV <= SV. STOP inputs end the step that waits for them
and no other, whatever their enable bits. Limits count where they are enabled, a limit that is the signal always. DCC comes
first, then the timer, which runs only where a step follows. D-STA and D-END come once, with n-DRV; H-END with any end.
"""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.functions import io as ports
from stage.chips.nova.motion import counters, drive
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.registers.words514 import HOME_TIMES
from stage.native import hot

IDLE, SEEK, PAUSE_1, PASS_SIGNAL, BACK_OUT, PAUSE_BACK, SEARCH, PAUSE_2, SEARCH_Z, PAUSE_3, OFFSET = (
    0, 3, 6, 11, 15, 18, 20, 23, 28, 32, 36)  # fmt: skip
"""HSST: step 1; back to the signal and out of it; step 2; step 3; step 4; the timer after each."""
STATES_304 = (0, 3, 15, 8, 12, 15, 15, 20, 20, 25, 25)
STATES = (IDLE, SEEK, PAUSE_1, PASS_SIGNAL, BACK_OUT, PAUSE_BACK, SEARCH, PAUSE_2, SEARCH_Z, PAUSE_3, OFFSET)
SIGNAL, LIMIT = 1, 2  # values of `home_trigger`


def _h1m_mask(name: str) -> int:
    return MCX514_MAP.mask("H1M", name)


def _h2m_mask(name: str) -> int:
    return MCX514_MAP.mask("H2M", name)


def _hm_mask(name: str) -> int:
    return MCX304_MAP.mask("HM", name)


ENABLE_BITS = (
    (_hm_mask("ST1-E"), _hm_mask("ST2-E"), _hm_mask("ST3-E"), _hm_mask("ST4-E")),
    (_h1m_mask("S1EN"), _h1m_mask("S2EN"), _h1m_mask("S3EN"), _h1m_mask("S4EN")),
)
DIRECTION_BITS = (
    (_hm_mask("ST1-D"), _hm_mask("ST2-D"), _hm_mask("ST3-D"), _hm_mask("ST4-D")),
    (_h1m_mask("S1DR"), _h1m_mask("S2DR"), _h1m_mask("S3DR"), 0),
)
S1G, S2SG = MCX514_MAP.bit("H1M", "S1G"), _h1m_mask("S2SG")
AFTER_2, AFTER_3 = (
    (_h1m_mask("S2DC"), _h1m_mask("S2RC"), _h1m_mask("S2LC")),
    (_h1m_mask("S3DC"), _h1m_mask("S3RC"), _h1m_mask("S3LC")),
)
"""DCC, clear RP, clear LP."""
SAND, LCLR, RCLR, HTME = _h2m_mask("SAND"), _h2m_mask("LCLR"), _h2m_mask("RCLR"), _h2m_mask("HTME")
HTM = MCX514_MAP.bit("H2M", "HTM")
CLOCKS_PER_MS = 16_000
LIMIT_304, SAND_304, PCLR, DCC_E = _hm_mask("LIMIT"), _hm_mask("SAND"), _hm_mask("PCLR"), _hm_mask("DCC-E")


@hot
def reset_search(x):
    """Clear the state of the home search."""
    x.home_state = x.home_trigger = x.pause_end = x.home_handles_limits = x.drives_at_hv = x.launch_direction = 0


@hot
def compute_hmst(x):
    """Compute HMST, the home state in RR2 of the older chips."""
    for k in range(len(STATES)):
        if STATES[k] == x.home_state:
            return STATES_304[k]
    return 0


# --- what the mode registers ask for ---


@hot
def _is_mcx514(c):
    """Return 1 for the MCX514 and its siblings, 0 for the older chips."""
    return 1 if c.variant == state.MCX514_TYPE else 0


@hot
def _find_direction(c, x, k):
    """Return the direction of step `k`, +1 or -1."""
    if k == 4 and c.variant == state.MCX514_TYPE:
        return 1 if x.reg[state.TP] >= 0 else -1
    return -1 if x.mode[state.H1M] & DIRECTION_BITS[_is_mcx514(c)][k - 1] else 1


@hot
def _find_stop_input(c, x, k):
    """Return the STOP input that step 1 or 2 searches; 0 if it searches the limit of its direction."""
    mode = x.mode[state.H1M]
    if c.variant != state.MCX514_TYPE:
        return 0 if mode & LIMIT_304 else state.STOP0 if k == 1 else state.STOP1
    if k == 2:
        return 0 if mode & S2SG else state.STOP1
    what = mode >> S1G & 3
    return state.STOP0 if what == 0 else state.STOP1 if what == 1 else 0


@hot
def _is_signal_active(c, x, k):
    """Return whether the signal of step 1 or 2 is active."""
    stop = _find_stop_input(c, x, k)
    return x.active_inputs & stop if stop else counters.is_limit_asserted(x, _find_direction(c, x, k))


@hot
def _is_limit_ahead(c, x, k):
    """Return whether the limit in the direction of a step is asserted, unless the step searches this limit."""
    return x.limits_stop and _find_stop_input(c, x, k) and counters.is_limit_asserted(x, _find_direction(c, x, k))


@hot
def _find_signal_cause(c, x, k):
    """Return the finishing status that the signal of step 1 or 2 sets, bits of RR2."""
    stop = _find_stop_input(c, x, k)
    if stop == 0:
        return _find_limit_cause(c, x, k)
    return state.F_STOP0 if stop == state.STOP0 else state.F_STOP1


@hot
def _find_limit_cause(c, x, k):
    """Return the finishing status that the limit in the direction of a step sets, bits of RR2."""
    return state.F_LMT_PLUS if _find_direction(c, x, k) > 0 else state.F_LMT_MINUS


# --- beginning and end ---


@hot
def start_search(c, x):
    """Start the home search (5Ah, 62h), unless the axis is busy."""
    if x.driving or x.awaits_inpos or x.home_state or x.interpolates:
        return
    drive.note_event(x, state.D_STA)
    _begin_step(c, x, 1)


@hot
def end_search(c, x):
    """End the home search, if one is in progress."""
    if not x.home_state:
        return
    reset_search(x)
    drive.note_event(x, state.H_END)
    if not x.driving and not x.awaits_inpos:
        drive.note_event(x, state.D_END)
    c.stale = 1


@hot
def _finish_search(c, x):
    """Clear the counters that the mode selects, and end the search."""
    if c.variant == state.MCX514_TYPE:
        mode = x.mode[state.H2M]
        _clear_counters(x, mode & RCLR, mode & LCLR)
    else:
        mode = x.mode[state.HM]
        _clear_counters(x, mode & PCLR, mode & PCLR)
        if mode & DCC_E:
            ports.start_dcc_pulse(c, x)
    end_search(c, x)


@hot
def _clear_counters(x, real, logical):
    """Clear the position counters: RP if `real`, LP if `logical`."""
    if real:
        x.reg[state.RP] = 0
    if logical:
        x.reg[state.LP] = 0


# --- steps ---


@hot
def launch_step_drive(c, x):
    """Begin the drive that a step has requested. It is separate from the steps because they compile much faster without it."""
    direction, x.launch_direction = x.launch_direction, 0
    drive.begin_drive(c, x, direction, x.launch_pulses)


@hot
def _request_drive(x, next_step, direction, slow):
    """Request a drive without an end for a step.

    Args:
        x: State of the axis.
        next_step: State of the search from now on.
        direction: +1 or -1.
        slow: Whether it runs at HV.
    """
    x.home_state, x.drives_at_hv = next_step, slow
    x.home_handles_limits = 1 if next_step in (SEEK, SEARCH) else 0
    x.launch_direction, x.launch_pulses = direction, -1


@hot
def _begin_step(c, x, k):
    """Begin step `k`, or the first later step that is enabled."""
    enabled, mode = ENABLE_BITS[_is_mcx514(c)], x.mode[state.H1M]
    x.home_trigger = x.pause_end = x.home_handles_limits = 0
    c.stale = 1
    if k <= 1 and mode & enabled[0] and not _is_signal_active(c, x, 1) and not _is_limit_ahead(c, x, 1):
        _request_drive(x, SEEK, _find_direction(c, x, 1), 0)
    elif k <= 2 and mode & enabled[1]:
        if _is_signal_active(c, x, 2):
            _request_drive(x, BACK_OUT, -_find_direction(c, x, 2), 1)
        elif _is_limit_ahead(c, x, 2):
            _request_drive(x, PASS_SIGNAL, -_find_direction(c, x, 2), 1)
        else:
            _request_drive(x, SEARCH, _find_direction(c, x, 2), 1)
    elif k <= 3 and mode & enabled[2]:
        x.home_state = SEARCH_Z
        if x.active_inputs & state.STOP2:
            x.stop_causes |= state.E_HOME
            end_search(c, x)
        else:
            _request_drive(x, SEARCH_Z, _find_direction(c, x, 3), 1)
    elif k <= 4 and mode & enabled[3]:
        x.home_state, x.drives_at_hv, x.absolute, x.pulse_sign = OFFSET, 0, 0, 1
        x.launch_direction, x.launch_pulses = (
            _find_direction(c, x, 4),
            abs(x.reg[state.TP]) if c.variant == state.MCX514_TYPE else x.reg[state.TP] & 0xFFFFFFFF,
        )
    else:
        x.home_state = OFFSET
        _finish_search(c, x)


@hot
def _watch_step_drive(c, x):
    """Stop the drive of a step if its signal or a limit has come."""
    if x.home_state == SEEK:
        if _is_limit_ahead(c, x, 1):
            x.home_trigger = LIMIT
            if x.limits_decelerate:
                drive.begin_decelerating_stop(c, x, _find_limit_cause(c, x, 1))
            else:
                drive.end_drive(c, x, _find_limit_cause(c, x, 1))
        elif not x.home_trigger and _is_signal_active(c, x, 1):
            x.home_trigger = SIGNAL
            drive.begin_decelerating_stop(c, x, _find_signal_cause(c, x, 1))
    elif x.home_state == SEARCH:
        if _is_signal_active(c, x, 2):
            x.home_trigger = SIGNAL
            drive.end_drive(c, x, _find_signal_cause(c, x, 2))
        elif _is_limit_ahead(c, x, 2):
            x.home_trigger = LIMIT
            drive.end_drive(c, x, _find_limit_cause(c, x, 2))
    elif x.home_state == PASS_SIGNAL:
        if _is_signal_active(c, x, 2):
            x.home_state = BACK_OUT
    elif x.home_state == BACK_OUT:
        if not _is_signal_active(c, x, 2):
            x.home_trigger = SIGNAL
            drive.end_drive(c, x, 0)
    elif (
        x.active_inputs & state.STOP2
        and (x.active_inputs & state.STOP1 or not _requires_stop1(c, x))
        and x.home_state == SEARCH_Z
    ):
        x.home_trigger = SIGNAL
        drive.end_drive(c, x, state.F_STOP2)


@hot
def _requires_stop1(c, x):
    """Return whether step 3 stops only while STOP1 is active as well."""
    return x.mode[state.H2M] & SAND if c.variant == state.MCX514_TYPE else x.mode[state.HM] & SAND_304


@hot
def _finish_step_drive(c, x):
    """Go on after the end of the drive of a step."""
    if x.home_state == OFFSET and x.pulses_done >= x.output_pulses:
        _finish_search(c, x)
    elif not x.home_trigger:
        end_search(c, x)
    elif x.home_state == SEEK:
        _begin_pause(c, x, PAUSE_1, 0)
    elif x.home_state == BACK_OUT:
        _begin_pause(c, x, PAUSE_BACK, 0)
    elif x.home_state == SEARCH and x.home_trigger == LIMIT:
        _begin_step(c, x, 2)
    elif x.home_state == SEARCH:
        _begin_pause(c, x, PAUSE_2, _clear_at_signal(c, x, AFTER_2))
    elif x.home_state == SEARCH_Z:
        _begin_pause(c, x, PAUSE_3, _clear_at_signal(c, x, AFTER_3))


@hot
def _clear_at_signal(c, x, what):
    """Clear counters and assert DCC after step 2 or 3, as the mode says.

    Args:
        c: State of the chip.
        x: State of the axis.
        what: Mode bits for DCC, RP and LP.

    Returns:
        Clocks for which DCC is asserted.
    """
    if c.variant != state.MCX514_TYPE:
        return 0
    mode = x.mode[state.H1M]
    _clear_counters(x, mode & what[1], mode & what[2])
    return ports.start_dcc_pulse(c, x) if mode & what[0] else 0


@hot
def _has_further_step(c, x, k):
    """Return whether a step after step `k` is enabled."""
    enabled, mode = ENABLE_BITS[_is_mcx514(c)], x.mode[state.H1M]
    return (k < 2 and mode & enabled[1]) or (k < 3 and mode & enabled[2]) or (k < 4 and mode & enabled[3])


@hot
def _find_step_after_pause(x):
    """Return the number of the step that follows the present pause."""
    return 4 if x.home_state == PAUSE_3 else 3 if x.home_state == PAUSE_2 else 2


@hot
def _begin_pause(c, x, next_step, clocks):
    """Begin the pause between two steps: DCC, then the timer if a step follows.

    Args:
        c: State of the chip.
        x: State of the axis.
        next_step: State of the search from now on.
        clocks: Duration of DCC.
    """
    x.home_state, x.home_handles_limits, x.drives_at_hv = next_step, 0, 0
    mode = x.mode[state.H2M]
    if c.variant == state.MCX514_TYPE and mode & HTME and _has_further_step(c, x, _find_step_after_pause(x) - 1):
        clocks += CLOCKS_PER_MS * HOME_TIMES[mode >> HTM & 7]
    x.pause_end = c.clock + clocks
    if clocks == 0:
        _begin_step(c, x, _find_step_after_pause(x))


# --- time ---


@hot
def update_search(c, x):
    """Do what is due at the present clock. Sets `stale` if that changes something."""
    if not x.home_state:
        return
    if x.pause_end:
        if c.emergency or (x.alarm_stops and x.active_inputs & state.ALARM):
            x.stop_causes |= (state.E_EMG | state.F_EMG) if c.emergency else (state.E_ALARM | state.F_ALARM)
            end_search(c, x)
        elif c.clock >= x.pause_end:
            _begin_step(c, x, _find_step_after_pause(x))
    elif x.driving:
        _watch_step_drive(c, x)
    elif not x.awaits_inpos:
        _finish_step_drive(c, x)


@hot
def find_next_event(c, x):
    """Return the clock at which a pause ends, NEVER if there is none."""
    return x.pause_end if x.pause_end else state.NEVER
