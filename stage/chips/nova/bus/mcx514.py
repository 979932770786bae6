"""The bus of the MCX514, MCX512 and MCX501, compiled. Data commands take WR6 and WR7, reading commands fill RR6 and RR7."""

from __future__ import annotations

from stage.chips.nova import power, state
from stage.chips.nova.bus.common import (
    compute_phase_bits,
    find_lowest_axis,
    is_busy,
    list_parameters,
    to_parameter_value,
)
from stage.chips.nova.functions import home, sync, timer
from stage.chips.nova.functions import io as ports
from stage.chips.nova.functions.inputs import set_active_high
from stage.chips.nova.interpolation import multichip
from stage.chips.nova.interpolation import queue as prebuffer
from stage.chips.nova.motion import drive, rates
from stage.chips.nova.registers.mcx514 import GENERATION
from stage.chips.nova.registers.mcx514 import MCX514_MAP as MAP
from stage.native import exported, hot

WRITES, SIGNED, SHORT, RESET_PLACES, RESET_VALUES = list_parameters(MAP)
SHARED_REGISTERS = sum(1 << c.code for c in MAP.commands if c.kind == "data write" and not c.axes)


def _find_code(symbol: str) -> int:
    return MAP.command(symbol).code


def _find_mask(word: str, name: str) -> int:
    return MAP.mask(word, name)


RST = _find_code("RST")
CODE, AXIS_BITS, FIRST_AXIS = _find_mask("WR0", "CODE"), _find_mask("WR0", "AXIS"), MAP.bit("WR0", "AXIS")
MODE_LAST = max(c.code for m in GENERATION for c in m.commands if c.kind == "mode write")
READS = {c.symbol: c.code for m in GENERATION for c in m.commands if c.kind == "data read"}
R_CV, R_CA, R_CT, R_CHLN, R_TX = (READS[n] for n in ("CV", "CA", "CT", "CHLN", "R-TX"))
_READ = {READS[f"R-{r.name}"]: r.number for m in GENERATION for r in m.registers if f"R-{r.name}" in READS}
PLACES = tuple(k if (k := _READ.get(code, -1)) < state.REGISTERS else -1 for code in range(256))
"""Of a reading command: the place in `reg` that it reads, or -1."""
MODE_PLACES = tuple(
    k - state.MODE_FIRST if (k := _READ.get(code, -1)) >= state.MODE_FIRST else -1 for code in range(256)
)
"""The place in `mode` that it reads, or -1."""
READ_FIRST, READ_LAST = min(READS.values()), max(READS.values()) | 15
"""Reading commands; the others among them read as 0."""
R_WR1, R_WR3 = READS["R-WR1"], READS["R-WR3"]
DRVRL, DRVNR, DRVVP, DRVVM, DRVAB, DRVSBRK, DRVFBRK, DIRCP, DIRCM, HMSRC = (_find_code(n) for n in (
    "DRVRL", "DRVNR", "DRVVP", "DRVVM", "DRVAB", "DRVSBRK", "DRVFBRK", "DIRCP", "DIRCM", "HMSRC"))  # fmt: skip
VINC, VDEC, DHOLD, DFREE, R2CLR, RR3P0, RR3P1 = (_find_code(n) for n in (
    "VINC", "VDEC", "DHOLD", "DFREE", "R2CLR", "RR3P0", "RR3P1"))  # fmt: skip
MFPC = _find_code("MFPC")
_CODES = {m.axes: set(m.by_code) for m in GENERATION}
LACKING_CHIPS = tuple(
    sum(1 << axes for axes, its in _CODES.items() if code not in its) if code in set().union(*_CODES.values()) else 0
    for code in range(256)
)
"""Of a command that a chip of the generation has: bit k is set if the one with k axes lacks it."""
_INTERPOLATING = [c.code for c in MAP.commands if c.kind == "interpolation"]
INTERPOLATION_FIRST, INTERPOLATION_LAST = min(_INTERPOLATING), max(_INTERPOLATING)

SP0_E, SP1_E, SP2_E, INP_E, ALM_E, HLM_E, HLM_M, SLM_E, SLM_O, SLM_M = (_find_mask("WR2", n) for n in (
    "SP0-E", "SP1-E", "SP2-E", "INP-E", "ALM-E", "HLM-E", "HLM-M", "SLM-E", "SLM-O", "SLM-M"))  # fmt: skip
SP0_L, SP1_L, SP2_L, INP_L, ALM_L, HLM_L = (
    _find_mask("WR2", f"{n}-L") for n in ("SP0", "SP1", "SP2", "INP", "ALM", "HLM")
)
MANLD, DSNDE, SACC, PIINV, LMINV, AVTRI = (
    _find_mask("WR3", n) for n in ("MANLD", "DSNDE", "SACC", "PIINV", "LMINV", "AVTRI")
)
PIMD = MAP.bit("WR3", "PIMD")
DRIVES, FAILS = 1 << MAP.bit("RR0", "n-DRV"), 1 << MAP.bit("RR0", "n-ERR")  # of X
ERRORS = sum(MAP.masks("RR2", "SLMT+", "SLMT-", "HLMT+", "HLMT-", "ALARM", "EMG", "HOME", "CERR"))
HSST, FIRST_PHASE = MAP.bit("RR3-0", "HSST"), MAP.bit("RR3-1", "ASND")
MEMBERS = sum(MAP.masks("IPM", "X-EN", "Y-EN", "Z-EN", "U-EN"))
FL0, FL1 = MAP.bit("FLM", "FL0"), MAP.bit("FLM", "FL1")
_FILTERS = (
    state.EMG_FILTER,
    state.LMT_PLUS | state.LMT_MINUS,
    state.STOP0 | state.STOP1,
    state.INPOS | state.ALARM,
    15 << state.PIO,
    15 << state.PIO + 4,
    state.STOP2,
    state.ECA | state.ECB,
)


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
        apply_mode_registers(x)


@hot
def apply_mode_registers(x):
    """Set the fields of an axis that follow from WR2, WR3 and the filter mode."""
    w = x.wr[2]
    x.stop_inputs = (1 if w & SP0_E else 0) | (2 if w & SP1_E else 0) | (4 if w & SP2_E else 0)
    x.inpos_enabled, x.alarm_stops = w & INP_E, w & ALM_E
    x.limits_stop, x.limits_decelerate = w & HLM_E, w & HLM_M
    x.soft_plus = x.soft_minus = w & SLM_E
    x.soft_rp, x.soft_instant = w & SLM_O, w & SLM_M
    turned = (state.STOP0 if w & SP0_L else 0) | (state.STOP1 if w & SP1_L else 0) | (state.STOP2 if w & SP2_L else 0)
    turned |= (state.INPOS if w & INP_L else 0) | (state.ALARM if w & ALM_L else 0)
    set_active_high(x, turned | (state.LMT_PLUS | state.LMT_MINUS if w & HLM_L else 0))
    w = x.wr[3]
    x.manual_deceleration, x.asymmetric = w & MANLD, 1 if w & DSNDE else 0
    x.s_curve, x.prevents_triangle = 1 if w & SACC else 0, 0 if w & AVTRI else 1
    x.limits_swapped, x.encoder_reversed, x.encoder_mode = w & LMINV, w & PIINV, w >> PIMD & 3
    f = x.mode[state.FLM]
    x.inputs_with_filter = 0
    for k in range(8):
        if f >> k & 1:
            x.inputs_with_filter |= _FILTERS[k]
    x.filter_delay, x.second_filter_delay = 8 << (f >> FL0 & 15), 8 << (f >> FL1 & 15)


@hot
def _read_data_registers(c):
    """Return the 32 bits of data in WR6 and WR7."""
    return c.data_high << 16 | c.data_low


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
def _execute_read_command(c, code):
    """Execute a data reading command, which fills RR6 and RR7."""
    x = c.ax[find_lowest_axis(c)]
    place = PLACES[code]
    if code == R_TX:
        value = prebuffer.read_tx(c)
    elif 0 <= place < state.REGISTERS:
        value = c.ax[0].reg[place] if SHARED_REGISTERS >> place & 1 else x.reg[place]
    elif MODE_PLACES[code] >= 0:
        value = x.mode[MODE_PLACES[code]]
    elif code == R_CV:
        value = rates.read_speed(c, x)
    elif code == R_CA:
        value = rates.read_acceleration(c, x)
    elif code == R_CT:
        value = timer.read_timer(c, x)
    elif code == R_CHLN:
        value = prebuffer.read_chln(c)
    elif R_WR1 <= code <= R_WR3:
        value = x.wr[code - R_WR1 + 1]
    else:
        value = 0
    c.read_low, c.read_high = value & 0xFFFF, value >> 16 & 0xFFFF


@hot
def _execute_axis_command(c, x, j, code):
    """Execute a command for one axis.

    Args:
        c: State of the chip.
        x: State of the axis.
        j: Number of the axis.
        code: Code of the command.
    """
    if code == DRVRL:
        drive.execute_drive_command(c, x, drive.RELATIVE)
    elif code == DRVNR:
        drive.execute_drive_command(c, x, drive.COUNTER_RELATIVE)
    elif code == DRVVP:
        drive.execute_drive_command(c, x, drive.FORWARD)
    elif code == DRVVM:
        drive.execute_drive_command(c, x, drive.BACKWARD)
    elif code == DRVAB:
        drive.execute_drive_command(c, x, drive.ABSOLUTE)
    elif code == DRVSBRK:
        home.end_search(c, x)
        drive.begin_decelerating_stop(c, x, 0)
    elif code == DRVFBRK:
        home.end_search(c, x)
        drive.stop_at_once(c, x, 0)
    elif code in (DIRCP, DIRCM):
        if not (x.driving or x.interpolates):
            x.direction = 1 if code == DIRCP else -1
    elif code == HMSRC:
        home.start_search(c, x)
    elif code in (VINC, VDEC):
        drive.step_drive_speed(c, x, 1 if code == VINC else -1)
    elif code in (DHOLD, DFREE):
        drive.set_start_hold(c, x, code == DHOLD)
    elif code == R2CLR:
        x.stop_causes = c.multichip_error = 0
    elif code == RR3P0:
        c.status_pages &= ~(1 << j)
    elif code == RR3P1:
        c.status_pages |= 1 << j
    else:
        sync.execute_command(c, x, code)


@hot
def execute_command(c, value):
    """Execute a write to WR0."""
    c.has_unused_data = 0
    code, axes = value & CODE, (value & AXIS_BITS) >> FIRST_AXIS
    if axes == 0 and code == RST:
        reset_chip(c)
        return
    axes = 1 if c.axes == 1 else axes & (1 << c.axes) - 1
    if axes:
        c.selected = axes
    c.stale = 1
    if LACKING_CHIPS[code] >> c.axes & 1:
        if READ_FIRST <= code <= READ_LAST:
            c.read_low = c.read_high = 0
        return
    if code < state.REGISTERS and WRITES >> code & 1:
        if SHARED_REGISTERS >> code & 1:
            _write_parameter(c, c.ax[0], code, _read_data_registers(c))
            return
        for j in range(state.AXES):
            if axes >> j & 1:
                _write_parameter(c, c.ax[j], code, _read_data_registers(c))
    elif state.MODE_FIRST <= code <= MODE_LAST:
        if code == state.MODE_FIRST + state.IPM:
            c.ax[0].mode[state.IPM] = c.data_low & ~(MEMBERS & ~0 << c.axes)
            return
        for j in range(state.AXES):
            if axes >> j & 1:
                c.ax[j].mode[code - state.MODE_FIRST] = c.data_low
                apply_mode_registers(c.ax[j])
    elif READ_FIRST <= code <= READ_LAST:
        _execute_read_command(c, code)
    elif INTERPOLATION_FIRST <= code <= INTERPOLATION_LAST or code == MFPC:
        prebuffer.execute_command(c, code)
    else:
        for j in range(state.AXES):
            if axes >> j & 1:
                _execute_axis_command(c, c.ax[j], j, code)


@exported(None, state.STATE, "i8", "i8")
def write_register(c, address, value):
    """Write WR0 to WR7.

    Args:
        c: State of the chip.
        address: Number of the register.
        value: The word.
    """
    if address == 0:
        execute_command(c, value)
    elif address <= 3:
        for j in range(state.AXES):
            if c.selected >> j & 1:
                c.ax[j].wr[address] = value
                apply_mode_registers(c.ax[j])
        c.stale = 1
    elif address == 4:
        c.outputs4 = value
    elif address == 5:
        c.outputs5 = value
    else:
        drive.store_data(c, address, value)


@hot
def find_written_word(c, address):
    """Return the word that was last written to one of WR1 to WR7, into which a write of the 8-bit bus puts its byte."""
    if address <= 3:
        return c.ax[find_lowest_axis(c)].wr[address]
    if address == 4:
        return c.outputs4
    if address == 5:
        return c.outputs5
    return c.data_low if address == 6 else c.data_high


@hot
def _is_high(x, bit):
    """Return whether the pin of an input is electrically high. An input that is set is low."""
    return 0 if x.inputs & bit else 1


@hot
def _compute_rr3_page_0(c, x):
    """Compute page 0 of RR3: input levels and the home state."""
    return (
        _is_high(x, state.STOP0) | _is_high(x, state.STOP1) << 1 | _is_high(x, state.STOP2) << 2
        | (1 - _is_high(x, state.ECA)) << 3 | (1 - _is_high(x, state.ECB)) << 4
        | _is_high(x, state.INPOS) << 5 | _is_high(x, state.ALARM) << 6
        | _is_high(x, state.LMT_PLUS) << 7 | _is_high(x, state.LMT_MINUS) << 8 | x.home_state << HSST
    )  # fmt: skip


@hot
def compute_status(c):
    """Compute RR0."""
    word = 0
    for j in range(state.AXES):
        x = c.ax[j]
        word |= (DRIVES << j if is_busy(x) else 0) | (FAILS << j if x.stop_causes & ERRORS else 0)
    return word | prebuffer.compute_status_bits(c)


@hot
def read_register(c, address):
    """Read RR0 to RR7. A read of RR1 clears its events.

    Args:
        c: State of the chip.
        address: Number of the register.
    """
    j = find_lowest_axis(c)
    x = c.ax[j]
    if address == 0:
        return compute_status(c)
    if address == 1:
        word = x.events & 0xFFFF
        x.events = 0
        return word
    if address == 2:
        return x.stop_causes & 0xFFFF
    if address == 3:
        if c.status_pages >> j & 1:
            more = multichip.MCERR if c.multichip_error else 0
            return sync.compute_status_bits(x) | compute_phase_bits(c, x) << FIRST_PHASE | more
        return _compute_rr3_page_0(c, x)
    if address == 4:
        return ports.compute_port_word(c, 0)
    if address == 5:
        return ports.compute_port_word(c, 2)
    return c.read_low if address == 6 else c.read_high


@hot
def is_interrupt_asserted(c):
    """Return whether INT0N is asserted, by an enabled event of an axis."""
    for j in range(state.AXES):
        if c.ax[j].events & c.ax[j].wr[1]:
            return 1
    return 0
