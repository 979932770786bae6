"""Bus registers and commands of the MCX304, MCX302, MCX312 and MCX314As, compiled.

Speeds and accelerations are written in multiples of R; rate_registers.py converts them.
"""

from __future__ import annotations

from stage.chips.nova import common_reset, state
from stage.chips.nova.bus.parameters import find_lowest_axis, list_parameters, read_parameter_value, write_parameter
from stage.chips.nova.functions import general_ports as ports
from stage.chips.nova.functions import home_search
from stage.chips.nova.functions.input_pins import set_active_high
from stage.chips.nova.interpolation import mcx312_commands as interpolation312
from stage.chips.nova.motion import counters, rate_registers, single_axis_drive
from stage.chips.nova.motion.drive_phases import compute_ramp_phase_bits, is_axis_busy
from stage.chips.nova.registers.mcx300 import MCX304_MAP, MCX314AS_MAP, RESET
from stage.chips.nova.registers.mcx300 import MCX312_MAP as MAP
from stage.chips.nova.registers.mcx300_words import FILTER_DELAYS_US
from stage.native import exported, hot, least

WRITES, SIGNED, SHORT, RESET_PLACES, RESET_VALUES = list_parameters(MAP)
PLUS, MINUS_ON, HOLD, FREE, DSTOP, SSTOP = MAP.command_codes(
    "F_DRV_P", "C_DRV_M", "START_HOLD", "START_FREE", "STOP_DEC", "STOP_SUDDEN"
)
DRIVE_KINDS = (
    single_axis_drive.FIXED_PLUS,
    single_axis_drive.FIXED_MINUS,
    single_axis_drive.FORWARD,
    single_axis_drive.BACKWARD,
)
"""Kinds of the drives of the commands F_DRV_P to C_DRV_M, by code."""
R_LP, R_EP, R_CV, R_CA = MAP.command_codes("R-LP", "R-EP", "CV", "CA")
R_BR = MCX314AS_MAP.command("BR").code
_INTERPOLATING = [c.code for c in MAP.commands if c.kind == "interpolation"]
INTERPOLATION_FIRST, INTERPOLATION_LAST = min(_INTERPOLATING), max(_INTERPOLATING)
HM_CODE, HV_CODE, HOME, DCC = MAP.command_codes("HM", "HV", "HOME_EXEC", "DEVCTR_CLR")
(CODE, AXIS_BITS), FIRST_AXIS = MAP.masks("WR0", "CODE", "AXIS"), MAP.bit("WR0", "AXIS")
DRIVES, FAILS, HOMES = (1 << MCX304_MAP.bit("RR0", n) for n in ("n-DRV", "n-ERR", "n-HOM"))  # of X
CMP_PLUS, CMP_MINUS = MAP.masks("RR1", "CMP+", "CMP-")
FIRST_PHASE = MAP.bit("RR1", "ASND")
BY_STOPS = sum(MAP.masks("RR1", "STOP0", "STOP1", "STOP2"))
BY_OTHERS = sum(MAP.masks("RR1", "LMT+", "LMT-", "ALARM", "EMG"))
"""Causes of the last stop; of the MCX514, whose bits `causes` holds, those of STOP0 to STOP2 are one bit higher."""
HOME_ERROR, HMST = MAP.mask("RR2", "HOME"), MAP.bit("RR2", "HMST")
CONSTANT_END, CONSTANT_START, DRIVE_END, HOME_END = MAP.masks("RR3", "C-END", "C-STA", "D-END", "HMEND")
FIRST_INTERRUPT = MAP.bit("WR1", "PULSE")
INTERRUPTS = sum(f.mask for f in MAP.word("WR1").fields if f.low >= FIRST_INTERRUPT) >> FIRST_INTERRUPT
IN_EMG, IN_EXP_PLUS, IN_EXP_MINUS, IN_INPOS, IN_ALARM, IN_IN, IN_LMT_PLUS, IN_LMT_MINUS = (
    *MAP.masks("RR4", "EMG", "X-EXP+", "X-EXP-", "X-INPOS", "X-ALARM", "X-IN", "X-LMT+", "X-LMT-"),
)  # fmt: skip
"""Input levels of X; those of another axis lie alike in its half or word."""
SP0_E, SP1_E, SP2_E, SP0_L, SP1_L, SP2_L = MAP.masks("WR1", "SP0-E", "SP1-E", "SP2-E", "SP0-L", "SP1-L", "SP2-L")
SLMT_PLUS, SLMT_MINUS, LMTMD, HLMT_PLUS, HLMT_MINUS, CMPSL, PINMD, ALM_E, INP_E, ALM_L, INP_L = MAP.masks(
    "WR2", "SLMT+", "SLMT-", "LMTMD", "HLMT+", "HLMT-", "CMPSL", "PINMD", "ALM-E", "INP-E", "ALM-L", "INP-L"
)
PIND, FL = MAP.bit("WR2", "PIND"), MAP.bit("WR3", "FL")
MANLD, DSNDE, SACC, AVTRI = MAP.masks("WR3", "MANLD", "DSNDE", "SACC", "AVTRI")
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
    3 << state.EXP_PLUS_SHIFT,
    state.STOP3,
)
"""Masks of the inputs that the filter bits FE0 to FE4 enable; only the MCX314As has FE4."""


@hot
def reset_chip(chip):
    """Reset the chip: registers to their reset values, modes and counters to 0, axis X selected.

    The clock, the input pins and the pulse totals stay.
    """
    common_reset.clear_state(chip)
    for j in range(state.MAX_CHIP_AXES):
        axis = chip.ax[j]
        for k in range(len(RESET_PLACES)):
            axis.reg[RESET_PLACES[k]] = RESET_VALUES[k]
        axis.reg[state.LX] = 1  # L; LX is the other chips'
        axis.reg[state.HV] = 1
        apply_mode_registers(chip, axis)


@hot
def apply_mode_registers(chip, axis):
    """Update the fields of an axis that depend on the registers WR1 to WR3 and EM."""
    w = axis.wr[1]
    axis.stop_inputs = (1 if w & SP0_E else 0) | (2 if w & SP1_E else 0) | (4 if w & SP2_E else 0)
    e = axis.mode[state.EM]
    if chip.extended:
        axis.stop_inputs |= 8 if w & SP3_E else 0
        axis.encoder_reversed, axis.stop2_clears_ep = e & EM_EPINV, e & EM_EPCLR
    else:
        axis.encoder_reversed, axis.stop2_clears_ep = w & EPINV, w & EPCLR
    turned = state.STOP3 if chip.extended and w & SP3_L else 0
    turned |= (state.STOP0 if w & SP0_L else 0) | (state.STOP1 if w & SP1_L else 0) | (state.STOP2 if w & SP2_L else 0)
    w = axis.wr[2]
    turned |= (state.LMT_PLUS if w & HLMT_PLUS else 0) | (state.LMT_MINUS if w & HLMT_MINUS else 0)
    set_active_high(axis, turned | (state.INPOS if w & INP_L else 0) | (state.ALARM if w & ALM_L else 0))
    axis.limits_stop, axis.limits_decelerate = 1, w & LMTMD
    axis.soft_plus, axis.soft_minus, axis.soft_rp, axis.soft_instant = w & SLMT_PLUS, w & SLMT_MINUS, w & CMPSL, 0
    axis.inpos_enabled, axis.alarm_stops = w & INP_E, w & ALM_E
    axis.encoder_mode = 3 if w & PINMD else least(w >> PIND & 3, 2)
    w = axis.wr[3]
    axis.manual_deceleration, axis.asymmetric = w & MANLD, 1 if w & DSNDE else 0
    axis.s_curve = 1 if w & SACC else 0
    axis.prevents_triangle = (1 if e & EM_AVTRI else 0) if chip.extended else (1 if w & AVTRI else 0)
    axis.limits_swapped = 0
    axis.inputs_with_filter = 0
    filters = e >> EM_FE0 & 31 if chip.extended else w >> FE0 & 15
    for k in range(len(_FILTERS)):
        if filters >> k & 1:
            axis.inputs_with_filter |= _FILTERS[k]
    axis.filter_delay = axis.second_filter_delay = 16 * FILTER_DELAYS_US[(e >> EM_FL if chip.extended else w >> FL) & 7]


@hot
def _execute_axis_command(chip, axis, axis_index, code):
    """Execute a command for one axis.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        axis_index: Number of the axis.
        code: Code of the command.
    """
    if PLUS <= code <= MINUS_ON:
        single_axis_drive.execute_drive_command(chip, axis, DRIVE_KINDS[code - PLUS])
    elif code in (HOLD, FREE):
        if code == FREE:
            axis.stop_causes = 0
        single_axis_drive.set_start_hold(chip, axis, code == HOLD)
    elif code == DSTOP:
        home_search.end_search(chip, axis)
        single_axis_drive.begin_decelerating_stop(chip, axis, 0)
    elif code == SSTOP:
        home_search.end_search(chip, axis)
        single_axis_drive.stop_at_once(chip, axis, 0)
    elif code == HM_CODE:
        axis.mode[state.HM] = chip.data_high if chip.extended else chip.data_low
        if chip.extended:
            axis.mode[state.EM] = chip.data_low
            apply_mode_registers(chip, axis)
    elif code == HV_CODE:
        axis.reg[state.HV] = chip.data_low
    elif code == HOME:
        home_search.start_search(chip, axis)
    elif code == DCC:
        ports.start_dcc_pulse(chip, axis)


@hot
def execute_command(chip, value):
    """Execute a write to WR0, the command register of an MCX300 series chip."""
    chip.has_unused_data = 0
    if value == RESET:
        reset_chip(chip)
        return
    code, axes = value & CODE, (value & AXIS_BITS) >> FIRST_AXIS & ((1 << chip.axes) - 1)
    if axes:
        chip.selected = axes
    chip.stale = 1
    if code < state.REGISTERS and WRITES >> code & 1:
        value = read_parameter_value(chip, SIGNED >> code & 1, SHORT >> code & 1)
        for j in range(chip.axes):
            if axes >> j & 1:
                write_parameter(chip, chip.ax[j], code, value)
    elif chip.extended and code == R_BR:
        chip.read_low = chip.read_high = 0
    elif R_LP <= code <= R_CA:
        axis = chip.ax[find_lowest_axis(chip)]
        if code in (R_LP, R_EP):
            data = axis.reg[state.LP] if code == R_LP else axis.reg[state.EP]
        else:
            data = (
                rate_registers.read_speed(chip, axis) if code == R_CV else rate_registers.read_acceleration(chip, axis)
            )
        chip.read_low, chip.read_high = data & 0xFFFF, data >> 16 & 0xFFFF
    elif INTERPOLATION_FIRST <= code <= INTERPOLATION_LAST:
        if chip.has_l:
            interpolation312.execute_command(chip, code)
    else:
        for j in range(chip.axes):
            if axes >> j & 1:
                _execute_axis_command(chip, chip.ax[j], j, code)


@exported(None, state.STATE, "i8", "i8")
def write_register(chip, address, value):
    """Write WR0 to WR7. On a chip with bit patterns WR2 and above take the pattern after command 36h.

    Args:
        chip: State of the chip.
        address: Number of the register.
        value: The word.
    """
    if address == 0:
        execute_command(chip, value)
    elif chip.has_l and interpolation312.is_loading_pattern(chip) and 2 <= address <= (7 if chip.extended else 5):
        interpolation312.store_pattern_word(chip, address - 2, value)
    elif address <= 3:
        for j in range(chip.axes):
            if chip.selected >> j & 1:
                chip.ax[j].wr[address] = value
                apply_mode_registers(chip, chip.ax[j])
        chip.stale = 1
    elif address == 4:
        chip.outputs4 = value
    elif address == 5:
        chip.outputs5 = value
        chip.stale = 1
    else:
        single_axis_drive.store_data_register(chip, address, value)


@hot
def _compute_comparisons(axis):
    """Compute CMP+ and CMP-, the comparison bits of RR1, of an axis."""
    counter = counters.read_soft_limit_counter(axis)
    return (CMP_PLUS if counter >= axis.reg[state.COMP_PLUS] else 0) | (
        CMP_MINUS if counter < axis.reg[state.COMP_MINUS] else 0
    )


@hot
def compute_errors(chip, axis):
    """Compute the errors that RR2 shows while they are present: limits, ALARM and EMG."""
    word = 0
    if axis.soft_plus and _compute_comparisons(axis) & CMP_PLUS:
        word |= state.E_SLMT_PLUS
    if axis.soft_minus and _compute_comparisons(axis) & CMP_MINUS:
        word |= state.E_SLMT_MINUS
    if axis.active_inputs & state.LMT_PLUS:
        word |= state.E_HLMT_PLUS
    if axis.active_inputs & state.LMT_MINUS:
        word |= state.E_HLMT_MINUS
    if axis.alarm_stops and axis.active_inputs & state.ALARM:
        word |= state.E_ALARM
    if chip.emergency:
        word |= state.E_EMG
    if axis.stop_causes & state.E_HOME:
        word |= HOME_ERROR
    return word


@hot
def compute_status(chip):
    """Compute RR0, the main status of an MCX300 series chip."""
    word = 0
    for j in range(chip.axes):
        axis = chip.ax[j]
        word |= (DRIVES << j if is_axis_busy(axis) else 0) | (
            FAILS << j if compute_errors(chip, axis) or axis.stop_causes & (state.F_ALARM | state.F_EMG) else 0
        )
        if not chip.has_l and axis.home_state:
            word |= HOMES << j
    return word | (interpolation312.compute_status_bits(chip) if chip.has_l else 0)


@hot
def _compute_input_levels(chip, axis, axis_index):
    """Compute the electrical input levels of an axis, as in RR4 and RR5. A pin that is set is low."""
    word = 0
    for k in range(3):
        word |= (0 if axis.inputs & state.STOP0 << k else 1) << k
    if chip.extended:
        word |= 0 if axis.inputs & state.STOP3 else IN_STOP3
    elif axis_index == 0:
        word |= 0 if chip.emg_pin else IN_EMG
    word |= (0 if axis.inputs >> state.EXP_PLUS_SHIFT & 1 else IN_EXP_PLUS) | (
        0 if axis.inputs >> state.EXP_PLUS_SHIFT & 2 else IN_EXP_MINUS
    )
    word |= 0 if axis.inputs & state.INPOS else IN_INPOS
    word |= 0 if axis.inputs & state.ALARM else IN_ALARM
    if chip.axes == 2:
        word |= IN_IN
        word |= 0 if axis.inputs & state.LMT_PLUS else IN_LMT_PLUS
        word |= 0 if axis.inputs & state.LMT_MINUS else IN_LMT_MINUS
    return word


@hot
def compute_interrupt_factors(axis):
    """Compute the interrupt factors of an axis that RR3 shows."""
    word = axis.comparison_events  # PULSE and the comparisons, see comparators.py
    word |= (CONSTANT_END if axis.events & state.C_END else 0) | (CONSTANT_START if axis.events & state.C_STA else 0)
    return word | (DRIVE_END if axis.events & state.D_END else 0) | (HOME_END if axis.events & state.H_END else 0)


@hot
def read_register(chip, address):
    """Read RR0 to RR7. A read of RR3 clears its factors.

    Args:
        chip: State of the chip.
        address: Number of the register.
    """
    axis = chip.ax[find_lowest_axis(chip)]
    if address == 0:
        return compute_status(chip)
    if address == 1:
        bits = compute_ramp_phase_bits(chip, axis)
        more = BY_STOP3 if axis.stop_causes & state.F_STOP3 else 0
        return (
            _compute_comparisons(axis)
            | bits << FIRST_PHASE
            | (axis.stop_causes >> 1 & BY_STOPS)
            | (axis.stop_causes & BY_OTHERS)
            | more
        )
    if address == 2:
        return compute_errors(chip, axis) | home_search.compute_hmst(axis) << HMST
    if address == 3:
        word = compute_interrupt_factors(axis)
        axis.events = axis.comparison_events = 0
        return word
    if address == 4 or address == 5:
        if chip.axes == 2:
            return _compute_input_levels(chip, chip.ax[address - 4], address - 4)
        j = 2 * (address - 4)
        return _compute_input_levels(chip, chip.ax[j], j) | _compute_input_levels(chip, chip.ax[j + 1], 1) << 8
    return chip.read_low if address == 6 else chip.read_high


@hot
def is_interrupt_asserted(chip):
    """Return whether INTN is asserted, by an enabled factor of an axis or by the interpolation."""
    if chip.ip.interrupt:
        return 1
    for j in range(chip.axes):
        axis = chip.ax[j]
        if compute_interrupt_factors(axis) & axis.wr[1] >> FIRST_INTERRUPT & INTERRUPTS:
            return 1
    return 0
