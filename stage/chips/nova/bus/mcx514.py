"""Bus registers and commands of the MCX514, MCX512 and MCX501, compiled.

A command that writes data takes it from WR6 and WR7; a command that reads data puts it into RR6 and RR7.
"""

from __future__ import annotations

from stage.chips.nova import common_reset, state
from stage.chips.nova.bus.parameters import find_lowest_axis, list_parameters, read_parameter_value, write_parameter
from stage.chips.nova.functions import general_ports as ports
from stage.chips.nova.functions import home_search, synchronous_actions, timer
from stage.chips.nova.functions.input_pins import set_active_high
from stage.chips.nova.interpolation import mcx514_commands as prebuffer
from stage.chips.nova.interpolation import multichip
from stage.chips.nova.motion import rate_registers, single_axis_drive
from stage.chips.nova.motion.drive_phases import compute_ramp_phase_bits, is_axis_busy
from stage.chips.nova.registers.mcx514 import MCX514_GENERATION_MAPS
from stage.chips.nova.registers.mcx514 import MCX514_MAP as MAP
from stage.native import exported, hot

WRITES, SIGNED, SHORT, RESET_PLACES, RESET_VALUES = list_parameters(MAP)
SHARED_REGISTERS = sum(1 << c.code for c in MAP.commands if c.kind == "data write" and not c.axes)
RST, MFPC = MAP.command_codes("RST", "MFPC")
(CODE, AXIS_BITS), FIRST_AXIS = MAP.masks("WR0", "CODE", "AXIS"), MAP.bit("WR0", "AXIS")
MODE_LAST = max(c.code for m in MCX514_GENERATION_MAPS for c in m.commands if c.kind == "mode write")
READS = {c.symbol: c.code for m in MCX514_GENERATION_MAPS for c in m.commands if c.kind == "data read"}
R_CV, R_CA, R_CT, R_CHLN, R_TX = (READS[n] for n in ("CV", "CA", "CT", "CHLN", "R-TX"))
_REGISTER_BY_READ_CODE = {
    READS[f"R-{r.name}"]: r.number for m in MCX514_GENERATION_MAPS for r in m.registers if f"R-{r.name}" in READS
}
REGISTER_INDEX_BY_CODE = tuple(
    k if (k := _REGISTER_BY_READ_CODE.get(code, -1)) < state.REGISTERS else -1 for code in range(256)
)
"""Index in `reg` that each data reading command reads, or -1."""
MODE_INDEX_BY_CODE = tuple(
    k - state.MODE_FIRST if (k := _REGISTER_BY_READ_CODE.get(code, -1)) >= state.MODE_FIRST else -1
    for code in range(256)
)
"""Index in `mode` that each data reading command reads, or -1."""
READ_FIRST, READ_LAST = min(READS.values()), max(READS.values()) | 15
"""Reading commands; the others among them read as 0."""
R_WR1, R_WR3 = READS["R-WR1"], READS["R-WR3"]
DRVRL, DRVAB, DRVSBRK, DRVFBRK, DIRCP, DIRCM, HMSRC = MAP.command_codes(
    "DRVRL", "DRVAB", "DRVSBRK", "DRVFBRK", "DIRCP", "DIRCM", "HMSRC"
)
DRIVE_KINDS = (
    single_axis_drive.RELATIVE,
    single_axis_drive.COUNTER_RELATIVE,
    single_axis_drive.FORWARD,
    single_axis_drive.BACKWARD,
    single_axis_drive.ABSOLUTE,
)
"""Kinds of the drives of the commands DRVRL to DRVAB, by code."""
VINC, VDEC, DHOLD, DFREE, R2CLR, RR3P0, RR3P1 = MAP.command_codes(
    "VINC", "VDEC", "DHOLD", "DFREE", "R2CLR", "RR3P0", "RR3P1"
)
_CODES = {m.axes: set(m.by_code) for m in MCX514_GENERATION_MAPS}
LACKING_CHIPS = tuple(
    sum(1 << axes for axes, its in _CODES.items() if code not in its) if code in set().union(*_CODES.values()) else 0
    for code in range(256)
)
"""Mask for each command: bit k is set if the chip of this generation with k axes lacks the command."""
_INTERPOLATING = [c.code for c in MAP.commands if c.kind == "interpolation"]
INTERPOLATION_FIRST, INTERPOLATION_LAST = min(_INTERPOLATING), max(_INTERPOLATING)

SP0_E, SP1_E, SP2_E, INP_E, ALM_E, HLM_E, HLM_M, SLM_E, SLM_O, SLM_M = MAP.masks(
    "WR2", "SP0-E", "SP1-E", "SP2-E", "INP-E", "ALM-E", "HLM-E", "HLM-M", "SLM-E", "SLM-O", "SLM-M"
)
SP0_L, SP1_L, SP2_L, INP_L, ALM_L, HLM_L = MAP.masks("WR2", "SP0-L", "SP1-L", "SP2-L", "INP-L", "ALM-L", "HLM-L")
MANLD, DSNDE, SACC, PIINV, LMINV, AVTRI = MAP.masks("WR3", "MANLD", "DSNDE", "SACC", "PIINV", "LMINV", "AVTRI")
PIMD = MAP.bit("WR3", "PIMD")
DRIVES, FAILS = 1 << MAP.bit("RR0", "n-DRV"), 1 << MAP.bit("RR0", "n-ERR")  # of X
ERRORS = sum(MAP.masks("RR2", "SLMT+", "SLMT-", "HLMT+", "HLMT-", "ALARM", "EMG", "HOME", "CERR"))
HSST, FIRST_PHASE = MAP.bit("RR3-0", "HSST"), MAP.bit("RR3-1", "ASND")
INTERPOLATION_AXES_MASK = sum(MAP.masks("IPM", "X-EN", "Y-EN", "Z-EN", "U-EN"))
FL0, FL1 = MAP.bit("FLM", "FL0"), MAP.bit("FLM", "FL1")
_FILTERS = (
    state.EMG_FILTER,
    state.LMT_PLUS | state.LMT_MINUS,
    state.STOP0 | state.STOP1,
    state.INPOS | state.ALARM,
    15 << state.PIO0_SHIFT,
    15 << state.PIO0_SHIFT + 4,
    state.STOP2,
    state.ECA | state.ECB,
)


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
        apply_mode_registers(axis)


@hot
def apply_mode_registers(axis):
    """Update the fields of an axis that depend on the registers WR2, WR3 and the filter mode."""
    w = axis.wr[2]
    axis.stop_inputs = (1 if w & SP0_E else 0) | (2 if w & SP1_E else 0) | (4 if w & SP2_E else 0)
    axis.inpos_enabled, axis.alarm_stops = w & INP_E, w & ALM_E
    axis.limits_stop, axis.limits_decelerate = w & HLM_E, w & HLM_M
    axis.soft_plus = axis.soft_minus = w & SLM_E
    axis.soft_rp, axis.soft_instant = w & SLM_O, w & SLM_M
    turned = (state.STOP0 if w & SP0_L else 0) | (state.STOP1 if w & SP1_L else 0) | (state.STOP2 if w & SP2_L else 0)
    turned |= (state.INPOS if w & INP_L else 0) | (state.ALARM if w & ALM_L else 0)
    set_active_high(axis, turned | (state.LMT_PLUS | state.LMT_MINUS if w & HLM_L else 0))
    w = axis.wr[3]
    axis.manual_deceleration, axis.asymmetric = w & MANLD, 1 if w & DSNDE else 0
    axis.s_curve, axis.prevents_triangle = 1 if w & SACC else 0, 0 if w & AVTRI else 1
    axis.limits_swapped, axis.encoder_reversed, axis.encoder_mode = w & LMINV, w & PIINV, w >> PIMD & 3
    f = axis.mode[state.FLM]
    axis.inputs_with_filter = 0
    for k in range(8):
        if f >> k & 1:
            axis.inputs_with_filter |= _FILTERS[k]
    axis.filter_delay, axis.second_filter_delay = 8 << (f >> FL0 & 15), 8 << (f >> FL1 & 15)


@hot
def _execute_read_command(chip, code):
    """Execute a data reading command, which puts a value of an axis or of the chip into RR6 and RR7."""
    axis = chip.ax[find_lowest_axis(chip)]
    place = REGISTER_INDEX_BY_CODE[code]
    if code == R_TX:
        value = prebuffer.read_maximum_finish_point(chip)
    elif 0 <= place < state.REGISTERS:
        value = chip.ax[0].reg[place] if SHARED_REGISTERS >> place & 1 else axis.reg[place]
    elif MODE_INDEX_BY_CODE[code] >= 0:
        value = axis.mode[MODE_INDEX_BY_CODE[code]]
    elif code == R_CV:
        value = rate_registers.read_speed(chip, axis)
    elif code == R_CA:
        value = rate_registers.read_acceleration(chip, axis)
    elif code == R_CT:
        value = timer.read_timer(chip, axis)
    elif code == R_CHLN:
        value = prebuffer.read_helix_rotations(chip)
    elif R_WR1 <= code <= R_WR3:
        value = axis.wr[code - R_WR1 + 1]
    else:
        value = 0
    chip.read_low, chip.read_high = value & 0xFFFF, value >> 16 & 0xFFFF


@hot
def _execute_axis_command(chip, axis, axis_index, code):
    """Execute a command for one axis.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        axis_index: Number of the axis.
        code: Code of the command.
    """
    if DRVRL <= code <= DRVAB:
        single_axis_drive.execute_drive_command(chip, axis, DRIVE_KINDS[code - DRVRL])
    elif code == DRVSBRK:
        home_search.end_search(chip, axis)
        single_axis_drive.begin_decelerating_stop(chip, axis, 0)
    elif code == DRVFBRK:
        home_search.end_search(chip, axis)
        single_axis_drive.stop_at_once(chip, axis, 0)
    elif code in (DIRCP, DIRCM):
        if not (axis.driving or axis.interpolates):
            axis.direction = 1 if code == DIRCP else -1
    elif code == HMSRC:
        home_search.start_search(chip, axis)
    elif code in (VINC, VDEC):
        single_axis_drive.step_drive_speed(chip, axis, 1 if code == VINC else -1)
    elif code in (DHOLD, DFREE):
        single_axis_drive.set_start_hold(chip, axis, code == DHOLD)
    elif code == R2CLR:
        axis.stop_causes = chip.multichip_error = 0
    elif code == RR3P0:
        chip.status_pages &= ~(1 << axis_index)
    elif code == RR3P1:
        chip.status_pages |= 1 << axis_index
    else:
        synchronous_actions.execute_synchronous_command(chip, axis, code)


@hot
def execute_command(chip, value):
    """Execute a write to WR0, the command register of a chip of the MCX514's kind."""
    chip.has_unused_data = 0
    code, axes = value & CODE, (value & AXIS_BITS) >> FIRST_AXIS
    if axes == 0 and code == RST:
        reset_chip(chip)
        return
    axes = 1 if chip.axes == 1 else axes & (1 << chip.axes) - 1
    if axes:
        chip.selected = axes
    chip.stale = 1
    if LACKING_CHIPS[code] >> chip.axes & 1:
        if READ_FIRST <= code <= READ_LAST:
            chip.read_low = chip.read_high = 0
        return
    if code < state.REGISTERS and WRITES >> code & 1:
        value = read_parameter_value(chip, SIGNED >> code & 1, SHORT >> code & 1)
        if SHARED_REGISTERS >> code & 1:
            axes = 1
        for j in range(state.MAX_CHIP_AXES):
            if axes >> j & 1:
                write_parameter(chip, chip.ax[j], code, value)
    elif state.MODE_FIRST <= code <= MODE_LAST:
        if code == state.MODE_FIRST + state.IPM:
            chip.ax[0].mode[state.IPM] = chip.data_low & ~(INTERPOLATION_AXES_MASK & ~0 << chip.axes)
            return
        for j in range(state.MAX_CHIP_AXES):
            if axes >> j & 1:
                chip.ax[j].mode[code - state.MODE_FIRST] = chip.data_low
                apply_mode_registers(chip.ax[j])
    elif READ_FIRST <= code <= READ_LAST:
        _execute_read_command(chip, code)
    elif INTERPOLATION_FIRST <= code <= INTERPOLATION_LAST or code == MFPC:
        prebuffer.execute_command(chip, code)
    else:
        for j in range(state.MAX_CHIP_AXES):
            if axes >> j & 1:
                _execute_axis_command(chip, chip.ax[j], j, code)


@exported(None, state.STATE, "i8", "i8")
def write_register(chip, address, value):
    """Write WR0 to WR7.

    Args:
        chip: State of the chip.
        address: Number of the register.
        value: The word.
    """
    if address == 0:
        execute_command(chip, value)
    elif address <= 3:
        for j in range(state.MAX_CHIP_AXES):
            if chip.selected >> j & 1:
                chip.ax[j].wr[address] = value
                apply_mode_registers(chip.ax[j])
        chip.stale = 1
    elif address == 4:
        chip.outputs4 = value
    elif address == 5:
        chip.outputs5 = value
    else:
        single_axis_drive.store_data_register(chip, address, value)


@hot
def find_written_word(chip, address):
    """Return the word that was last written to one of WR1 to WR7, into which a write of the 8-bit bus puts its byte."""
    if address <= 3:
        return chip.ax[find_lowest_axis(chip)].wr[address]
    if address == 4:
        return chip.outputs4
    if address == 5:
        return chip.outputs5
    return chip.data_low if address == 6 else chip.data_high


@hot
def _is_high(axis, bit):
    """Return whether the pin of an input is electrically high. An input that is set is low."""
    return 0 if axis.inputs & bit else 1


@hot
def _compute_rr3_page_0(chip, axis):
    """Compute page 0 of RR3 of an axis: input levels and the state of the home search."""
    return (
        _is_high(axis, state.STOP0) | _is_high(axis, state.STOP1) << 1 | _is_high(axis, state.STOP2) << 2
        | (1 - _is_high(axis, state.ECA)) << 3 | (1 - _is_high(axis, state.ECB)) << 4
        | _is_high(axis, state.INPOS) << 5 | _is_high(axis, state.ALARM) << 6
        | _is_high(axis, state.LMT_PLUS) << 7 | _is_high(axis, state.LMT_MINUS) << 8 | axis.home_state << HSST
    )  # fmt: skip


@hot
def compute_status(chip):
    """Compute RR0, the main status of a chip of the MCX514's kind."""
    word = 0
    for j in range(state.MAX_CHIP_AXES):
        axis = chip.ax[j]
        word |= (DRIVES << j if is_axis_busy(axis) else 0) | (FAILS << j if axis.stop_causes & ERRORS else 0)
    return word | prebuffer.compute_status_bits(chip)


@hot
def read_register(chip, address):
    """Read RR0 to RR7. A read of RR1 clears its events.

    Args:
        chip: State of the chip.
        address: Number of the register.
    """
    j = find_lowest_axis(chip)
    axis = chip.ax[j]
    if address == 0:
        return compute_status(chip)
    if address == 1:
        word = axis.events & 0xFFFF
        axis.events = 0
        return word
    if address == 2:
        return axis.stop_causes & 0xFFFF
    if address == 3:
        if chip.status_pages >> j & 1:
            more = multichip.MCERR if chip.multichip_error else 0
            return (
                synchronous_actions.compute_status_bits(axis)
                | compute_ramp_phase_bits(chip, axis) << FIRST_PHASE
                | more
            )
        return _compute_rr3_page_0(chip, axis)
    if address == 4:
        return ports.compute_port_word(chip, 0)
    if address == 5:
        return ports.compute_port_word(chip, 2)
    return chip.read_low if address == 6 else chip.read_high


@hot
def is_interrupt_asserted(chip):
    """Return whether INT0N is asserted, by an enabled event of an axis."""
    for j in range(state.MAX_CHIP_AXES):
        if chip.ax[j].events & chip.ax[j].wr[1]:
            return 1
    return 0
