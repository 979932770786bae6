"""NOVA MCX304, MCX302, MCX312, compiled: their bus. Speeds and accelerations are in multiples of R, see drive.py."""

from __future__ import annotations

from stage.chips.nova import power, state
from stage.chips.nova.bus.common import busy, lowest, meant, parameters, phase_bits
from stage.chips.nova.functions import home
from stage.chips.nova.functions import io as ports
from stage.chips.nova.functions.inputs import turn
from stage.chips.nova.interpolation import mcx312 as interpolation312
from stage.chips.nova.motion import counters, drive, rates
from stage.chips.nova.registers.mcx300 import MCX304_MAP, MCX314AS_MAP, RESET
from stage.chips.nova.registers.mcx300 import MCX312_MAP as MAP
from stage.chips.nova.registers.words300 import DELAYS
from stage.native import exported, hot, least

WRITES, SIGNED, SHORT, RESET_PLACES, RESET_VALUES = parameters(MAP)


def _code(symbol: str) -> int:
    return MAP.command(symbol).code


def _of(word: str, name: str) -> int:
    return MAP.mask(word, name)


PLUS, MINUS, PLUS_ON, MINUS_ON, HOLD, FREE, DSTOP, SSTOP = (_code(n) for n in (
    "F_DRV_P", "F_DRV_M", "C_DRV_P", "C_DRV_M", "START_HOLD", "START_FREE", "STOP_DEC", "STOP_SUDDEN"))  # fmt: skip
R_LP, R_EP, R_CV, R_CA = (_code(n) for n in ("R-LP", "R-EP", "CV", "CA"))
R_BR = MCX314AS_MAP.command("BR").code
_INTERPOLATING = [c.code for c in MAP.commands if c.kind == "interpolation"]
INTERPOLATION_FIRST, INTERPOLATION_LAST = min(_INTERPOLATING), max(_INTERPOLATING)
HM_CODE, HV_CODE, HOME, DCC = (_code(n) for n in ("HM", "HV", "HOME_EXEC", "DEVCTR_CLR"))
CODE, AXIS_BITS, FIRST_AXIS = _of("WR0", "CODE"), _of("WR0", "AXIS"), MAP.bit("WR0", "AXIS")
DRIVES, FAILS, HOMES = (1 << MCX304_MAP.bit("RR0", n) for n in ("n-DRV", "n-ERR", "n-HOM"))  # of X
CMP_PLUS, CMP_MINUS = MAP.masks("RR1", "CMP+", "CMP-")
FIRST_PHASE = MAP.bit("RR1", "ASND")
BY_STOPS, BY_REST = (
    sum(MAP.masks("RR1", "STOP0", "STOP1", "STOP2")),
    sum(MAP.masks("RR1", "LMT+", "LMT-", "ALARM", "EMG")),
)
"""Causes of the last stop; of the MCX514, whose bits `causes` holds, those of STOP0 to STOP2 are one bit higher."""
HOME_ERROR, HMST = _of("RR2", "HOME"), MAP.bit("RR2", "HMST")
CONSTANT_END, CONSTANT_START, DRIVE_END, HOME_END = MAP.masks("RR3", "C-END", "C-STA", "D-END", "HMEND")
FIRST_INTERRUPT = MAP.bit("WR1", "PULSE")
INTERRUPTS = sum(f.mask for f in MAP.word("WR1").fields if f.low >= FIRST_INTERRUPT) >> FIRST_INTERRUPT
IN_EMG, IN_EXP_PLUS, IN_EXP_MINUS, IN_INPOS, IN_ALARM, IN_IN, IN_LMT_PLUS, IN_LMT_MINUS = (
    *MAP.masks("RR4", "EMG", "X-EXP+", "X-EXP-", "X-INPOS", "X-ALARM", "X-IN", "X-LMT+", "X-LMT-"),
)  # fmt: skip
"""Input levels of X; those of another axis lie alike in its half or word."""
SP0_E, SP1_E, SP2_E = (_of("WR1", f"SP{k}-E") for k in range(3))
SP0_L, SP1_L, SP2_L = (_of("WR1", f"SP{k}-L") for k in range(3))
SLMT_PLUS, SLMT_MINUS, LMTMD, HLMT_PLUS, HLMT_MINUS, CMPSL, PINMD, ALM_E, INP_E, ALM_L, INP_L = (_of("WR2", n) for n in (
    "SLMT+", "SLMT-", "LMTMD", "HLMT+", "HLMT-", "CMPSL", "PINMD", "ALM-E", "INP-E", "ALM-L", "INP-L"))  # fmt: skip
PIND, FL = MAP.bit("WR2", "PIND"), MAP.bit("WR3", "FL")
MANLD, DSNDE, SACC, AVTRI = (_of("WR3", n) for n in ("MANLD", "DSNDE", "SACC", "AVTRI"))
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
def reset(c):
    """Reset: registers to their values, modes and counters 0, X selected; the clock, the input pins and the pulse totals go on."""
    power.clear(c)
    for j in range(state.AXES):
        x = c.ax[j]
        for k in range(len(RESET_PLACES)):
            x.reg[RESET_PLACES[k]] = RESET_VALUES[k]
        x.reg[state.LX] = 1  # L; LX is the other chips'
        x.reg[state.HV] = 1
        configure(c, x)


@hot
def configure(c, x):
    """WR1 to WR3 in plain terms."""
    w = x.wr[1]
    x.stops = (1 if w & SP0_E else 0) | (2 if w & SP1_E else 0) | (4 if w & SP2_E else 0)
    e = x.mode[state.EM]
    if c.extended:
        x.stops |= 8 if w & SP3_E else 0
        x.exchanges, x.clears = e & EM_EPINV, e & EM_EPCLR
    else:
        x.exchanges, x.clears = w & EPINV, w & EPCLR
    turned = state.STOP3 if c.extended and w & SP3_L else 0
    turned |= (state.STOP0 if w & SP0_L else 0) | (state.STOP1 if w & SP1_L else 0) | (state.STOP2 if w & SP2_L else 0)
    w = x.wr[2]
    turned |= (state.LMT_PLUS if w & HLMT_PLUS else 0) | (state.LMT_MINUS if w & HLMT_MINUS else 0)
    turn(x, turned | (state.INPOS if w & INP_L else 0) | (state.ALARM if w & ALM_L else 0))
    x.limits, x.limit_slow = 1, w & LMTMD
    x.soft_plus, x.soft_minus, x.soft_rp, x.soft_instant = w & SLMT_PLUS, w & SLMT_MINUS, w & CMPSL, 0
    x.inpos_waits, x.alarm_stops = w & INP_E, w & ALM_E
    x.encoder = 3 if w & PINMD else least(w >> PIND & 3, 2)
    w = x.wr[3]
    x.manual, x.asymmetric = w & MANLD, 1 if w & DSNDE else 0
    x.s_curve = 1 if w & SACC else 0
    x.prevents = (1 if e & EM_AVTRI else 0) if c.extended else (1 if w & AVTRI else 0)
    x.swaps = 0
    x.filtered = 0
    filters = e >> EM_FE0 & 31 if c.extended else w >> FE0 & 15
    for k in range(len(_FILTERS)):
        if filters >> k & 1:
            x.filtered |= _FILTERS[k]
    x.delay = x.slow_delay = 16 * DELAYS[(e >> EM_FL if c.extended else w >> FL) & 7]


@hot
def _set(c, x, code, value):
    """Write parameter `code` of an axis."""
    value = meant(value, SIGNED >> code & 1, SHORT >> code & 1)
    if code == state.DV:
        drive.change_speed(c, x, value)
    elif code == state.TP:
        drive.change_output(c, x, value)
    else:
        x.reg[code] = value
    c.stale = 1


@hot
def _axis_command(c, x, j, code):
    if PLUS <= code <= MINUS_ON:
        kind = drive.FIXED_PLUS if code == PLUS else drive.FIXED_MINUS if code == MINUS else (
            drive.FORWARD if code == PLUS_ON else drive.BACKWARD)  # fmt: skip
        drive.start(c, x, kind)
    elif code in (HOLD, FREE):
        if code == FREE:
            x.causes = 0
        drive.hold(c, x, code == HOLD)
    elif code == DSTOP:
        home.end(c, x)
        drive.request_stop(c, x, 0)
    elif code == SSTOP:
        home.end(c, x)
        drive.stop(c, x, 0)
    elif code == HM_CODE:
        x.mode[state.HM] = c.high if c.extended else c.low
        if c.extended:
            x.mode[state.EM] = c.low
            configure(c, x)
    elif code == HV_CODE:
        x.reg[state.HV] = c.low
    elif code == HOME:
        home.start(c, x)
    elif code == DCC:
        ports.clear_deviation(c, x)


@hot
def command(c, value):
    """A write to WR0."""
    c.unused = 0
    if value == RESET:
        reset(c)
        return
    code, axes = value & CODE, (value & AXIS_BITS) >> FIRST_AXIS & ((1 << c.axes) - 1)
    if axes:
        c.selected = axes
    c.stale = 1
    if code < state.REGISTERS and WRITES >> code & 1:
        for j in range(c.axes):
            if axes >> j & 1:
                _set(c, c.ax[j], code, c.high << 16 | c.low)
    elif c.extended and code == R_BR:
        c.read_low = c.read_high = 0
    elif R_LP <= code <= R_CA:
        x = c.ax[lowest(c)]
        if code in (R_LP, R_EP):
            data = x.reg[state.LP] if code == R_LP else x.reg[state.EP]
        else:
            data = rates.speed_reading(c, x) if code == R_CV else rates.rate_reading(c, x)
        c.read_low, c.read_high = data & 0xFFFF, data >> 16 & 0xFFFF
    elif INTERPOLATION_FIRST <= code <= INTERPOLATION_LAST:
        if c.has_l:
            interpolation312.command(c, code)
    else:
        for j in range(c.axes):
            if axes >> j & 1:
                _axis_command(c, c.ax[j], j, code)


@exported(None, state.STATE, "i8", "i8")
def write(c, address, value):
    """WR0 to WR7; on the MCX312 after 36h the bit pattern in place of WR2 to WR5."""
    if address == 0:
        command(c, value)
    elif c.has_l and interpolation312.takes_pattern(c) and 2 <= address <= (7 if c.extended else 5):
        interpolation312.load_pattern(c, address - 2, value)
    elif address <= 3:
        for j in range(c.axes):
            if c.selected >> j & 1:
                c.ax[j].wr[address] = value
                configure(c, c.ax[j])
        c.stale = 1
    elif address == 4:
        c.outputs4 = value
    elif address == 5:
        c.outputs5 = value
        c.stale = 1
    else:
        drive.keep_data(c, address, value)


@hot
def _compared(x):
    """CMP+ and CMP-."""
    counter = counters.limited(x)
    return (CMP_PLUS if counter >= x.reg[state.COMP_PLUS] else 0) | (
        CMP_MINUS if counter < x.reg[state.COMP_MINUS] else 0
    )


@hot
def errors(c, x):
    """RR2: soft limits while they are passed, hardware limits, ALARM and EMG while their levels are there."""
    word = 0
    if x.soft_plus and _compared(x) & CMP_PLUS:
        word |= state.E_SLMT_PLUS
    if x.soft_minus and _compared(x) & CMP_MINUS:
        word |= state.E_SLMT_MINUS
    if x.active & state.LMT_PLUS:
        word |= state.E_HLMT_PLUS
    if x.active & state.LMT_MINUS:
        word |= state.E_HLMT_MINUS
    if x.alarm_stops and x.active & state.ALARM:
        word |= state.E_ALARM
    if c.emergency:
        word |= state.E_EMG
    if x.causes & state.E_HOME:
        word |= HOME_ERROR
    return word


@hot
def status(c):
    """RR0."""
    word = 0
    for j in range(c.axes):
        x = c.ax[j]
        word |= (DRIVES << j if busy(x) else 0) | (
            FAILS << j if errors(c, x) or x.causes & (state.F_ALARM | state.F_EMG) else 0
        )
        if not c.has_l and x.home:
            word |= HOMES << j
    return word | (interpolation312.status_bits(c) if c.has_l else 0)


@hot
def _levels(c, x, j):
    """RR4, RR5: the electrical levels of an axis; STOP0, STOP1, STOP2, EMG, EX+, EX-, INPOS, ALARM. A pin that is set is low."""
    word = 0
    for k in range(3):
        word |= (0 if x.inputs & state.STOP0 << k else 1) << k
    if c.extended:
        word |= 0 if x.inputs & state.STOP3 else IN_STOP3
    elif j == 0:
        word |= 0 if c.emg else IN_EMG
    word |= (0 if x.inputs >> state.EXP & 1 else IN_EXP_PLUS) | (0 if x.inputs >> state.EXP & 2 else IN_EXP_MINUS)
    word |= 0 if x.inputs & state.INPOS else IN_INPOS
    word |= 0 if x.inputs & state.ALARM else IN_ALARM
    if c.axes == 2:
        word |= IN_IN
        word |= 0 if x.inputs & state.LMT_PLUS else IN_LMT_PLUS
        word |= 0 if x.inputs & state.LMT_MINUS else IN_LMT_MINUS
    return word


@hot
def factors(x):
    """RR3."""
    word = x.compared  # PULSE and the comparisons, see comparators.py
    word |= (CONSTANT_END if x.factors & state.C_END else 0) | (CONSTANT_START if x.factors & state.C_STA else 0)
    return word | (DRIVE_END if x.factors & state.D_END else 0) | (HOME_END if x.factors & state.H_END else 0)


@hot
def read(c, address):
    """RR0 to RR7."""
    x = c.ax[lowest(c)]
    if address == 0:
        return status(c)
    if address == 1:
        bits = phase_bits(c, x)
        more = BY_STOP3 if x.causes & state.F_STOP3 else 0
        return _compared(x) | bits << FIRST_PHASE | (x.causes >> 1 & BY_STOPS) | (x.causes & BY_REST) | more
    if address == 2:
        return errors(c, x) | home.state304(x) << HMST
    if address == 3:
        word = factors(x)
        x.factors = x.compared = 0
        return word
    if address == 4 or address == 5:
        if c.axes == 2:
            return _levels(c, c.ax[address - 4], address - 4)
        j = 2 * (address - 4)
        return _levels(c, c.ax[j], j) | _levels(c, c.ax[j + 1], 1) << 8
    return c.read_low if address == 6 else c.read_high


@hot
def interrupts(c):
    """INTN: an enabled factor of an axis, or the interpolation's."""
    if c.ip.interrupt:
        return 1
    for j in range(c.axes):
        x = c.ax[j]
        if factors(x) & x.wr[1] >> FIRST_INTERRUPT & INTERRUPTS:
            return 1
    return 0
