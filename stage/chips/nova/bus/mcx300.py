"""The bus of the MCX304, MCX302, MCX312 and MCX314As, compiled. Speeds and accelerations are in multiples of R, see rates.py."""

from __future__ import annotations

from stage.chips.nova import power, state
from stage.chips.nova.bus.common import (
    compute_phase_bits,
    find_lowest_axis,
    is_busy,
    list_parameters,
    to_parameter_value,
)
from stage.chips.nova.functions import home
from stage.chips.nova.functions import io as ports
from stage.chips.nova.functions.inputs import set_active_high
from stage.chips.nova.interpolation import mcx312 as interpolation312
from stage.chips.nova.motion import counters, drive, rates
from stage.chips.nova.registers.mcx300 import MCX304_MAP, MCX314AS_MAP, RESET
from stage.chips.nova.registers.mcx300 import MCX312_MAP as MAP
from stage.chips.nova.registers.words300 import DELAYS
from stage.native import exported, hot, least

WRITES, SIGNED, SHORT, RESET_PLACES, RESET_VALUES = list_parameters(MAP)


def _find_code(symbol: str) -> int:
    return MAP.command(symbol).code


def _find_mask(word: str, name: str) -> int:
    return MAP.mask(word, name)


PLUS, MINUS, PLUS_ON, MINUS_ON, HOLD, FREE, DSTOP, SSTOP = (_find_code(n) for n in (
    "F_DRV_P", "F_DRV_M", "C_DRV_P", "C_DRV_M", "START_HOLD", "START_FREE", "STOP_DEC", "STOP_SUDDEN"))  # fmt: skip
R_LP, R_EP, R_CV, R_CA = (_find_code(n) for n in ("R-LP", "R-EP", "CV", "CA"))
R_BR = MCX314AS_MAP.command("BR").code
_INTERPOLATING = [c.code for c in MAP.commands if c.kind == "interpolation"]
INTERPOLATION_FIRST, INTERPOLATION_LAST = min(_INTERPOLATING), max(_INTERPOLATING)
HM_CODE, HV_CODE, HOME, DCC = (_find_code(n) for n in ("HM", "HV", "HOME_EXEC", "DEVCTR_CLR"))
CODE, AXIS_BITS, FIRST_AXIS = _find_mask("WR0", "CODE"), _find_mask("WR0", "AXIS"), MAP.bit("WR0", "AXIS")
DRIVES, FAILS, HOMES = (1 << MCX304_MAP.bit("RR0", n) for n in ("n-DRV", "n-ERR", "n-HOM"))  # of X
CMP_PLUS, CMP_MINUS = MAP.masks("RR1", "CMP+", "CMP-")
FIRST_PHASE = MAP.bit("RR1", "ASND")
BY_STOPS, BY_OTHERS = (
    sum(MAP.masks("RR1", "STOP0", "STOP1", "STOP2")),
    sum(MAP.masks("RR1", "LMT+", "LMT-", "ALARM", "EMG")),
)
"""Causes of the last stop; of the MCX514, whose bits `causes` holds, those of STOP0 to STOP2 are one bit higher."""
HOME_ERROR, HMST = _find_mask("RR2", "HOME"), MAP.bit("RR2", "HMST")
CONSTANT_END, CONSTANT_START, DRIVE_END, HOME_END = MAP.masks("RR3", "C-END", "C-STA", "D-END", "HMEND")
FIRST_INTERRUPT = MAP.bit("WR1", "PULSE")
INTERRUPTS = sum(f.mask for f in MAP.word("WR1").fields if f.low >= FIRST_INTERRUPT) >> FIRST_INTERRUPT
IN_EMG, IN_EXP_PLUS, IN_EXP_MINUS, IN_INPOS, IN_ALARM, IN_IN, IN_LMT_PLUS, IN_LMT_MINUS = (
    *MAP.masks("RR4", "EMG", "X-EXP+", "X-EXP-", "X-INPOS", "X-ALARM", "X-IN", "X-LMT+", "X-LMT-"),
)  # fmt: skip
"""Input levels of X; those of another axis lie alike in its half or word."""
SP0_E, SP1_E, SP2_E = (_find_mask("WR1", f"SP{k}-E") for k in range(3))
SP0_L, SP1_L, SP2_L = (_find_mask("WR1", f"SP{k}-L") for k in range(3))
SLMT_PLUS, SLMT_MINUS, LMTMD, HLMT_PLUS, HLMT_MINUS, CMPSL, PINMD, ALM_E, INP_E, ALM_L, INP_L = (_find_mask("WR2", n) for n in (
    "SLMT+", "SLMT-", "LMTMD", "HLMT+", "HLMT-", "CMPSL", "PINMD", "ALM-E", "INP-E", "ALM-L", "INP-L"))  # fmt: skip
PIND, FL = MAP.bit("WR2", "PIND"), MAP.bit("WR3", "FL")
MANLD, DSNDE, SACC, AVTRI = (_find_mask("WR3", n) for n in ("MANLD", "DSNDE", "SACC", "AVTRI"))
EPCLR, EPINV = MAP.masks("WR1", "EPCLR", "EPINV")
FE0 = MAP.bit("WR3", "FE0")
SP3_L, SP3_E = MCX314AS_MAP.masks("WR1", "SP3-L", "SP3-E")
EM_EPCLR, EM_EPINV, EM_AVTRI = MCX314AS_MAP.masks("EM", "EPCLR", "EPINV", "AVTRI")
EM_FE0, EM_FL = MCX314AS_MAP.bit("EM", "FE0"), MCX314AS_MAP.bit("EM", "FL")
BY_STOP3, IN_STOP3 = MCX314AS_MAP.mask("RR1", "STOP3"), MCX314AS_MAP.mask("RR4", "X-STOP3")
_FILTERS = (
    state.EMG_FILTER | state.LMT_PLUS | state.LMT_MINUS | state.STOP0 | state.STOP1,
    state.STOP2,
    state.INPOS | state.ALARM,
    3 << state.EXP,
    state.STOP3,
)
"""Of FE0 to FE4; the last one is the MCX314As's alone."""


@hot
def reset_chip(c):
    """Reset the chip: registers to their reset values, modes and counters to 0, axis X selected.

    The clock, the input pins and the pulse totals stay.
    """
    power.clear_state(c)
    for j in range(state.AXES):
        x = c.ax[j]
        for k in range(len(RESET_PLACES)):
            x.reg[RESET_PLACES[k]] = RESET_VALUES[k]
        x.reg[state.LX] = 1  # L; LX is the other chips'
        x.reg[state.HV] = 1
        apply_mode_registers(c, x)


@hot
def apply_mode_registers(c, x):
    """Set the fields of an axis that follow from WR1 to WR3 and EM."""
    w = x.wr[1]
    x.stop_inputs = (1 if w & SP0_E else 0) | (2 if w & SP1_E else 0) | (4 if w & SP2_E else 0)
    e = x.mode[state.EM]
    if c.extended:
        x.stop_inputs |= 8 if w & SP3_E else 0
        x.encoder_reversed, x.stop2_clears_ep = e & EM_EPINV, e & EM_EPCLR
    else:
        x.encoder_reversed, x.stop2_clears_ep = w & EPINV, w & EPCLR
    turned = state.STOP3 if c.extended and w & SP3_L else 0
    turned |= (state.STOP0 if w & SP0_L else 0) | (state.STOP1 if w & SP1_L else 0) | (state.STOP2 if w & SP2_L else 0)
    w = x.wr[2]
    turned |= (state.LMT_PLUS if w & HLMT_PLUS else 0) | (state.LMT_MINUS if w & HLMT_MINUS else 0)
    set_active_high(x, turned | (state.INPOS if w & INP_L else 0) | (state.ALARM if w & ALM_L else 0))
    x.limits_stop, x.limits_decelerate = 1, w & LMTMD
    x.soft_plus, x.soft_minus, x.soft_rp, x.soft_instant = w & SLMT_PLUS, w & SLMT_MINUS, w & CMPSL, 0
    x.inpos_enabled, x.alarm_stops = w & INP_E, w & ALM_E
    x.encoder_mode = 3 if w & PINMD else least(w >> PIND & 3, 2)
    w = x.wr[3]
    x.manual_deceleration, x.asymmetric = w & MANLD, 1 if w & DSNDE else 0
    x.s_curve = 1 if w & SACC else 0
    x.prevents_triangle = (1 if e & EM_AVTRI else 0) if c.extended else (1 if w & AVTRI else 0)
    x.limits_swapped = 0
    x.inputs_with_filter = 0
    filters = e >> EM_FE0 & 31 if c.extended else w >> FE0 & 15
    for k in range(len(_FILTERS)):
        if filters >> k & 1:
            x.inputs_with_filter |= _FILTERS[k]
    x.filter_delay = x.second_filter_delay = 16 * DELAYS[(e >> EM_FL if c.extended else w >> FL) & 7]


@hot
def _write_parameter(c, x, code, value):
    """Write a parameter of an axis.

    Args:
        c: State of the chip.
        x: State of the axis.
        code: Code of the command that writes it.
        value: 32 bits of data.
    """
    value = to_parameter_value(value, SIGNED >> code & 1, SHORT >> code & 1)
    if code == state.DV:
        drive.change_drive_speed(c, x, value)
    elif code == state.TP:
        drive.change_pulse_count(c, x, value)
    else:
        x.reg[code] = value
    c.stale = 1


@hot
def _execute_axis_command(c, x, j, code):
    """Execute a command for one axis.

    Args:
        c: State of the chip.
        x: State of the axis.
        j: Number of the axis.
        code: Code of the command.
    """
    if PLUS <= code <= MINUS_ON:
        kind = drive.FIXED_PLUS if code == PLUS else drive.FIXED_MINUS if code == MINUS else (
            drive.FORWARD if code == PLUS_ON else drive.BACKWARD)  # fmt: skip
        drive.execute_drive_command(c, x, kind)
    elif code in (HOLD, FREE):
        if code == FREE:
            x.stop_causes = 0
        drive.set_start_hold(c, x, code == HOLD)
    elif code == DSTOP:
        home.end_search(c, x)
        drive.begin_decelerating_stop(c, x, 0)
    elif code == SSTOP:
        home.end_search(c, x)
        drive.stop_at_once(c, x, 0)
    elif code == HM_CODE:
        x.mode[state.HM] = c.data_high if c.extended else c.data_low
        if c.extended:
            x.mode[state.EM] = c.data_low
            apply_mode_registers(c, x)
    elif code == HV_CODE:
        x.reg[state.HV] = c.data_low
    elif code == HOME:
        home.start_search(c, x)
    elif code == DCC:
        ports.start_dcc_pulse(c, x)


@hot
def execute_command(c, value):
    """Execute a write to WR0."""
    c.has_unused_data = 0
    if value == RESET:
        reset_chip(c)
        return
    code, axes = value & CODE, (value & AXIS_BITS) >> FIRST_AXIS & ((1 << c.axes) - 1)
    if axes:
        c.selected = axes
    c.stale = 1
    if code < state.REGISTERS and WRITES >> code & 1:
        for j in range(c.axes):
            if axes >> j & 1:
                _write_parameter(c, c.ax[j], code, c.data_high << 16 | c.data_low)
    elif c.extended and code == R_BR:
        c.read_low = c.read_high = 0
    elif R_LP <= code <= R_CA:
        x = c.ax[find_lowest_axis(c)]
        if code in (R_LP, R_EP):
            data = x.reg[state.LP] if code == R_LP else x.reg[state.EP]
        else:
            data = rates.read_speed(c, x) if code == R_CV else rates.read_acceleration(c, x)
        c.read_low, c.read_high = data & 0xFFFF, data >> 16 & 0xFFFF
    elif INTERPOLATION_FIRST <= code <= INTERPOLATION_LAST:
        if c.has_l:
            interpolation312.execute_command(c, code)
    else:
        for j in range(c.axes):
            if axes >> j & 1:
                _execute_axis_command(c, c.ax[j], j, code)


@exported(None, state.STATE, "i8", "i8")
def write_register(c, address, value):
    """Write WR0 to WR7. On a chip with bit patterns WR2 and above take the pattern after command 36h.

    Args:
        c: State of the chip.
        address: Number of the register.
        value: The word.
    """
    if address == 0:
        execute_command(c, value)
    elif c.has_l and interpolation312.is_loading_pattern(c) and 2 <= address <= (7 if c.extended else 5):
        interpolation312.store_pattern_word(c, address - 2, value)
    elif address <= 3:
        for j in range(c.axes):
            if c.selected >> j & 1:
                c.ax[j].wr[address] = value
                apply_mode_registers(c, c.ax[j])
        c.stale = 1
    elif address == 4:
        c.outputs4 = value
    elif address == 5:
        c.outputs5 = value
        c.stale = 1
    else:
        drive.store_data(c, address, value)


@hot
def _compute_comparisons(x):
    """Compute CMP+ and CMP-, bits of RR1."""
    counter = counters.read_limited_counter(x)
    return (CMP_PLUS if counter >= x.reg[state.COMP_PLUS] else 0) | (
        CMP_MINUS if counter < x.reg[state.COMP_MINUS] else 0
    )


@hot
def compute_errors(c, x):
    """Compute the errors in RR2: limits, ALARM and EMG, as long as they are present."""
    word = 0
    if x.soft_plus and _compute_comparisons(x) & CMP_PLUS:
        word |= state.E_SLMT_PLUS
    if x.soft_minus and _compute_comparisons(x) & CMP_MINUS:
        word |= state.E_SLMT_MINUS
    if x.active_inputs & state.LMT_PLUS:
        word |= state.E_HLMT_PLUS
    if x.active_inputs & state.LMT_MINUS:
        word |= state.E_HLMT_MINUS
    if x.alarm_stops and x.active_inputs & state.ALARM:
        word |= state.E_ALARM
    if c.emergency:
        word |= state.E_EMG
    if x.stop_causes & state.E_HOME:
        word |= HOME_ERROR
    return word


@hot
def compute_status(c):
    """Compute RR0."""
    word = 0
    for j in range(c.axes):
        x = c.ax[j]
        word |= (DRIVES << j if is_busy(x) else 0) | (
            FAILS << j if compute_errors(c, x) or x.stop_causes & (state.F_ALARM | state.F_EMG) else 0
        )
        if not c.has_l and x.home_state:
            word |= HOMES << j
    return word | (interpolation312.compute_status_bits(c) if c.has_l else 0)


@hot
def _compute_input_levels(c, x, j):
    """Compute the electrical input levels of an axis, as in RR4 and RR5. A pin that is set is low."""
    word = 0
    for k in range(3):
        word |= (0 if x.inputs & state.STOP0 << k else 1) << k
    if c.extended:
        word |= 0 if x.inputs & state.STOP3 else IN_STOP3
    elif j == 0:
        word |= 0 if c.emg_pin else IN_EMG
    word |= (0 if x.inputs >> state.EXP & 1 else IN_EXP_PLUS) | (0 if x.inputs >> state.EXP & 2 else IN_EXP_MINUS)
    word |= 0 if x.inputs & state.INPOS else IN_INPOS
    word |= 0 if x.inputs & state.ALARM else IN_ALARM
    if c.axes == 2:
        word |= IN_IN
        word |= 0 if x.inputs & state.LMT_PLUS else IN_LMT_PLUS
        word |= 0 if x.inputs & state.LMT_MINUS else IN_LMT_MINUS
    return word


@hot
def compute_interrupt_factors(x):
    """Compute the interrupt factors in RR3."""
    word = x.comparison_events  # PULSE and the comparisons, see comparators.py
    word |= (CONSTANT_END if x.events & state.C_END else 0) | (CONSTANT_START if x.events & state.C_STA else 0)
    return word | (DRIVE_END if x.events & state.D_END else 0) | (HOME_END if x.events & state.H_END else 0)


@hot
def read_register(c, address):
    """Read RR0 to RR7. A read of RR3 clears its factors.

    Args:
        c: State of the chip.
        address: Number of the register.
    """
    x = c.ax[find_lowest_axis(c)]
    if address == 0:
        return compute_status(c)
    if address == 1:
        bits = compute_phase_bits(c, x)
        more = BY_STOP3 if x.stop_causes & state.F_STOP3 else 0
        return (
            _compute_comparisons(x)
            | bits << FIRST_PHASE
            | (x.stop_causes >> 1 & BY_STOPS)
            | (x.stop_causes & BY_OTHERS)
            | more
        )
    if address == 2:
        return compute_errors(c, x) | home.compute_hmst(x) << HMST
    if address == 3:
        word = compute_interrupt_factors(x)
        x.events = x.comparison_events = 0
        return word
    if address == 4 or address == 5:
        if c.axes == 2:
            return _compute_input_levels(c, c.ax[address - 4], address - 4)
        j = 2 * (address - 4)
        return _compute_input_levels(c, c.ax[j], j) | _compute_input_levels(c, c.ax[j + 1], 1) << 8
    return c.read_low if address == 6 else c.read_high


@hot
def is_interrupt_asserted(c):
    """Return whether INTN is asserted, by an enabled factor of an axis or by the interpolation."""
    if c.ip.interrupt:
        return 1
    for j in range(c.axes):
        x = c.ax[j]
        if compute_interrupt_factors(x) & x.wr[1] >> FIRST_INTERRUPT & INTERRUPTS:
            return 1
    return 0
