"""Automatic home search of the NOVA chips, compiled: four steps that search signals and clear the counters.

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
from stage.chips.nova.functions import general_ports as ports
from stage.chips.nova.motion import counters, single_axis_drive
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.registers.mcx514_words import HOME_TIMER_MS
from stage.native import hot

IDLE, SEEK, PAUSE_1, PASS_SIGNAL, BACK_OUT, PAUSE_BACK, SEARCH, PAUSE_2, SEARCH_Z, PAUSE_3, OFFSET = (
    0, 3, 6, 11, 15, 18, 20, 23, 28, 32, 36)  # fmt: skip
"""HSST: step 1; back to the signal and out of it; step 2; step 3; step 4; the timer after each."""
HMST_CODES = (0, 3, 15, 8, 12, 15, 15, 20, 20, 25, 25)
HSST_CODES = (IDLE, SEEK, PAUSE_1, PASS_SIGNAL, BACK_OUT, PAUSE_BACK, SEARCH, PAUSE_2, SEARCH_Z, PAUSE_3, OFFSET)
SIGNAL, LIMIT = 1, 2  # values of `home_trigger`

STEP_ENABLE_MASKS = (
    MCX304_MAP.masks("HM", "ST1-E", "ST2-E", "ST3-E", "ST4-E"),
    MCX514_MAP.masks("H1M", "S1EN", "S2EN", "S3EN", "S4EN"),
)
STEP_DIRECTION_MASKS = (
    MCX304_MAP.masks("HM", "ST1-D", "ST2-D", "ST3-D", "ST4-D"),
    (*MCX514_MAP.masks("H1M", "S1DR", "S2DR", "S3DR"), 0),
)
S1G, S2SG = MCX514_MAP.bit("H1M", "S1G"), MCX514_MAP.mask("H1M", "S2SG")
AFTER_2 = MCX514_MAP.masks("H1M", "S2DC", "S2RC", "S2LC")
AFTER_3 = MCX514_MAP.masks("H1M", "S3DC", "S3RC", "S3LC")
"""Mode bits after step 2 and after step 3 of the search: assert DCC, clear RP, clear LP."""
SAND, LCLR, RCLR, HTME = MCX514_MAP.masks("H2M", "SAND", "LCLR", "RCLR", "HTME")
HTM = MCX514_MAP.bit("H2M", "HTM")
CLOCKS_PER_MS = 16_000
LIMIT_304, SAND_304, PCLR, DCC_E = MCX304_MAP.masks("HM", "LIMIT", "SAND", "PCLR", "DCC-E")


@hot
def reset_search(axis):
    """Clear the state of an axis' home search."""
    axis.home_state = axis.home_trigger = axis.pause_end = 0
    axis.home_handles_limits = axis.drives_at_hv = axis.launch_direction = 0


@hot
def compute_hmst(axis):
    """Compute HMST, the home state in RR2 of the older chips."""
    for k in range(len(HSST_CODES)):
        if HSST_CODES[k] == axis.home_state:
            return HMST_CODES[k]
    return 0


# --- what the mode registers ask for ---


@hot
def _is_mcx514(chip):
    """Return 1 for the MCX514 and its siblings, 0 for the older chips."""
    return 1 if chip.variant == state.MCX514_TYPE else 0


@hot
def _find_step_direction(chip, axis, search_step):
    """Return the direction of step `search_step` of the home search, +1 or -1."""
    if search_step == 4 and chip.variant == state.MCX514_TYPE:
        return 1 if axis.reg[state.TP] >= 0 else -1
    return -1 if axis.mode[state.H1M] & STEP_DIRECTION_MASKS[_is_mcx514(chip)][search_step - 1] else 1


@hot
def _find_stop_input(chip, axis, search_step):
    """Return the STOP input that step 1 or 2 of the home search looks for; 0 if it looks for the limit of its direction."""
    mode = axis.mode[state.H1M]
    if chip.variant != state.MCX514_TYPE:
        return 0 if mode & LIMIT_304 else state.STOP0 if search_step == 1 else state.STOP1
    if search_step == 2:
        return 0 if mode & S2SG else state.STOP1
    what = mode >> S1G & 3
    return state.STOP0 if what == 0 else state.STOP1 if what == 1 else 0


@hot
def _is_signal_active(chip, axis, search_step):
    """Return whether the signal that step 1 or 2 of the home search looks for (a STOP input or a limit) is active."""
    stop = _find_stop_input(chip, axis, search_step)
    return (
        axis.active_inputs & stop
        if stop
        else counters.is_limit_asserted(axis, _find_step_direction(chip, axis, search_step))
    )


@hot
def _is_limit_ahead(chip, axis, search_step):
    """Return whether the limit in the direction of a home search's step is asserted, unless the step looks for this limit."""
    return (
        axis.limits_stop
        and _find_stop_input(chip, axis, search_step)
        and counters.is_limit_asserted(axis, _find_step_direction(chip, axis, search_step))
    )


@hot
def _find_signal_status_bits(chip, axis, search_step):
    """Return the finishing status that the signal of step 1 or 2 of the home search sets, bits of RR2."""
    stop = _find_stop_input(chip, axis, search_step)
    if stop == 0:
        return _find_limit_status_bits(chip, axis, search_step)
    return state.F_STOP0 if stop == state.STOP0 else state.F_STOP1


@hot
def _find_limit_status_bits(chip, axis, search_step):
    """Return the finishing status that the limit in the direction of a home search's step sets, bits of RR2."""
    return state.F_LMT_PLUS if _find_step_direction(chip, axis, search_step) > 0 else state.F_LMT_MINUS


# --- beginning and end ---


@hot
def start_search(chip, axis):
    """Start the home search (5Ah, 62h), unless the axis is busy."""
    if axis.driving or axis.awaits_inpos or axis.home_state or axis.interpolates:
        return
    single_axis_drive.note_event(axis, state.D_STA)
    _begin_search_step(chip, axis, 1)


@hot
def end_search(chip, axis):
    """End the home search, if one is in progress."""
    if not axis.home_state:
        return
    reset_search(axis)
    single_axis_drive.note_event(axis, state.H_END)
    if not axis.driving and not axis.awaits_inpos:
        single_axis_drive.note_event(axis, state.D_END)
    chip.stale = 1


@hot
def _clear_counters_and_end_search(chip, axis):
    """Clear the position counters that the home search mode selects, and end the home search."""
    if chip.variant == state.MCX514_TYPE:
        mode = axis.mode[state.H2M]
        _clear_counters(axis, mode & RCLR, mode & LCLR)
    else:
        mode = axis.mode[state.HM]
        _clear_counters(axis, mode & PCLR, mode & PCLR)
        if mode & DCC_E:
            ports.start_dcc_pulse(chip, axis)
    end_search(chip, axis)


@hot
def _clear_counters(axis, clear_rp, clear_lp):
    """Clear the position counters: RP if `clear_rp`, LP if `clear_lp`."""
    if clear_rp:
        axis.reg[state.RP] = 0
    if clear_lp:
        axis.reg[state.LP] = 0


# --- steps ---


@hot
def launch_search_step_drive(chip, axis):
    """Begin the drive that a step of the home search has requested.

    The steps do not call `begin_drive` themselves, because they then compile much faster.
    """
    direction, axis.launch_direction = axis.launch_direction, 0
    single_axis_drive.begin_drive(chip, axis, direction, axis.launch_pulses)


@hot
def _request_drive(axis, search_step, direction, at_hv):
    """Request an endless drive for a step of the home search; `launch_search_step_drive` begins it.

    Args:
        axis: State of the axis.
        search_step: State of the search from now on.
        direction: +1 or -1.
        at_hv: Whether the drive runs at the home search speed HV.
    """
    axis.home_state, axis.drives_at_hv = search_step, at_hv
    axis.home_handles_limits = 1 if search_step in (SEEK, SEARCH) else 0
    axis.launch_direction, axis.launch_pulses = direction, -1


@hot
def _begin_search_step(chip, axis, search_step):
    """Begin step `search_step` of the home search, or the first later step that is enabled."""
    enabled, mode = STEP_ENABLE_MASKS[_is_mcx514(chip)], axis.mode[state.H1M]
    axis.home_trigger = axis.pause_end = axis.home_handles_limits = 0
    chip.stale = 1
    if (
        search_step <= 1
        and mode & enabled[0]
        and not _is_signal_active(chip, axis, 1)
        and not _is_limit_ahead(chip, axis, 1)
    ):
        _request_drive(axis, SEEK, _find_step_direction(chip, axis, 1), 0)
    elif search_step <= 2 and mode & enabled[1]:
        if _is_signal_active(chip, axis, 2):
            _request_drive(axis, BACK_OUT, -_find_step_direction(chip, axis, 2), 1)
        elif _is_limit_ahead(chip, axis, 2):
            _request_drive(axis, PASS_SIGNAL, -_find_step_direction(chip, axis, 2), 1)
        else:
            _request_drive(axis, SEARCH, _find_step_direction(chip, axis, 2), 1)
    elif search_step <= 3 and mode & enabled[2]:
        axis.home_state = SEARCH_Z
        if axis.active_inputs & state.STOP2:
            axis.stop_causes |= state.E_HOME
            end_search(chip, axis)
        else:
            _request_drive(axis, SEARCH_Z, _find_step_direction(chip, axis, 3), 1)
    elif search_step <= 4 and mode & enabled[3]:
        axis.home_state, axis.drives_at_hv, axis.absolute, axis.pulse_sign = OFFSET, 0, 0, 1
        axis.launch_direction = _find_step_direction(chip, axis, 4)
        axis.launch_pulses = (
            abs(axis.reg[state.TP]) if chip.variant == state.MCX514_TYPE else axis.reg[state.TP] & 0xFFFFFFFF
        )
    else:
        axis.home_state = OFFSET
        _clear_counters_and_end_search(chip, axis)


@hot
def _stop_search_step_at_signal(chip, axis):
    """Stop the drive of a step of the home search if the signal that ends the step, or a limit, has come."""
    if axis.home_state == SEEK:
        if _is_limit_ahead(chip, axis, 1):
            axis.home_trigger = LIMIT
            if axis.limits_decelerate:
                single_axis_drive.begin_decelerating_stop(chip, axis, _find_limit_status_bits(chip, axis, 1))
            else:
                single_axis_drive.end_drive(chip, axis, _find_limit_status_bits(chip, axis, 1))
        elif not axis.home_trigger and _is_signal_active(chip, axis, 1):
            axis.home_trigger = SIGNAL
            single_axis_drive.begin_decelerating_stop(chip, axis, _find_signal_status_bits(chip, axis, 1))
    elif axis.home_state == SEARCH:
        if _is_signal_active(chip, axis, 2):
            axis.home_trigger = SIGNAL
            single_axis_drive.end_drive(chip, axis, _find_signal_status_bits(chip, axis, 2))
        elif _is_limit_ahead(chip, axis, 2):
            axis.home_trigger = LIMIT
            single_axis_drive.end_drive(chip, axis, _find_limit_status_bits(chip, axis, 2))
    elif axis.home_state == PASS_SIGNAL:
        if _is_signal_active(chip, axis, 2):
            axis.home_state = BACK_OUT
    elif axis.home_state == BACK_OUT:
        if not _is_signal_active(chip, axis, 2):
            axis.home_trigger = SIGNAL
            single_axis_drive.end_drive(chip, axis, 0)
    elif (
        axis.active_inputs & state.STOP2
        and (axis.active_inputs & state.STOP1 or not _requires_stop1(chip, axis))
        and axis.home_state == SEARCH_Z
    ):
        axis.home_trigger = SIGNAL
        single_axis_drive.end_drive(chip, axis, state.F_STOP2)


@hot
def _requires_stop1(chip, axis):
    """Return whether step 3 of the home search stops only while the input STOP1 is active as well."""
    return axis.mode[state.H2M] & SAND if chip.variant == state.MCX514_TYPE else axis.mode[state.HM] & SAND_304


@hot
def _continue_after_search_step(chip, axis):
    """Continue the search when the drive of one of its steps has ended: begin a pause or the next step, or end the search."""
    if axis.home_state == OFFSET and axis.pulses_done >= axis.output_pulses:
        _clear_counters_and_end_search(chip, axis)
    elif not axis.home_trigger:
        end_search(chip, axis)
    elif axis.home_state == SEEK:
        _begin_pause(chip, axis, PAUSE_1, 0)
    elif axis.home_state == BACK_OUT:
        _begin_pause(chip, axis, PAUSE_BACK, 0)
    elif axis.home_state == SEARCH and axis.home_trigger == LIMIT:
        _begin_search_step(chip, axis, 2)
    elif axis.home_state == SEARCH:
        _begin_pause(chip, axis, PAUSE_2, _clear_at_signal(chip, axis, AFTER_2))
    elif axis.home_state == SEARCH_Z:
        _begin_pause(chip, axis, PAUSE_3, _clear_at_signal(chip, axis, AFTER_3))


@hot
def _clear_at_signal(chip, axis, mode_bits):
    """Clear position counters and assert the output DCC after step 2 or 3 of the home search, as the mode registers select.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        mode_bits: Mode bits for DCC, RP and LP.

    Returns:
        Clocks for which DCC is asserted.
    """
    if chip.variant != state.MCX514_TYPE:
        return 0
    mode = axis.mode[state.H1M]
    _clear_counters(axis, mode & mode_bits[1], mode & mode_bits[2])
    return ports.start_dcc_pulse(chip, axis) if mode & mode_bits[0] else 0


@hot
def _has_further_step(chip, axis, search_step):
    """Return whether the home search has an enabled step after step `search_step`."""
    enabled, mode = STEP_ENABLE_MASKS[_is_mcx514(chip)], axis.mode[state.H1M]
    return (
        (search_step < 2 and mode & enabled[1])
        or (search_step < 3 and mode & enabled[2])
        or (search_step < 4 and mode & enabled[3])
    )


@hot
def _find_step_after_pause(axis):
    """Return the number of the home search's step that follows the present pause."""
    return 4 if axis.home_state == PAUSE_3 else 3 if axis.home_state == PAUSE_2 else 2


@hot
def _begin_pause(chip, axis, next_step, clocks):
    """Begin the pause between two steps of the home search: the pulse on DCC, then the timer if a step follows.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        next_step: State of the search from now on.
        clocks: Duration of the pulse on DCC, clocks.
    """
    axis.home_state, axis.home_handles_limits, axis.drives_at_hv = next_step, 0, 0
    mode = axis.mode[state.H2M]
    if (
        chip.variant == state.MCX514_TYPE
        and mode & HTME
        and _has_further_step(chip, axis, _find_step_after_pause(axis) - 1)
    ):
        clocks += CLOCKS_PER_MS * HOME_TIMER_MS[mode >> HTM & 7]
    axis.pause_end = chip.clock + clocks
    if clocks == 0:
        _begin_search_step(chip, axis, _find_step_after_pause(axis))


# --- time ---


@hot
def update_search(chip, axis):
    """Process the events of the home search that are due at the present clock. Sets `chip.stale` if that changes the chip."""
    if not axis.home_state:
        return
    if axis.pause_end:
        if chip.emergency or (axis.alarm_stops and axis.active_inputs & state.ALARM):
            axis.stop_causes |= (state.E_EMG | state.F_EMG) if chip.emergency else (state.E_ALARM | state.F_ALARM)
            end_search(chip, axis)
        elif chip.clock >= axis.pause_end:
            _begin_search_step(chip, axis, _find_step_after_pause(axis))
    elif axis.driving:
        _stop_search_step_at_signal(chip, axis)
    elif not axis.awaits_inpos:
        _continue_after_search_step(chip, axis)


@hot
def find_next_event(chip, axis):
    """Return the clock at which the pause between two steps of the home search ends, NEVER if there is none."""
    return axis.pause_end if axis.pause_end else state.NEVER
