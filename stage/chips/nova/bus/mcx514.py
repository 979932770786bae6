"""NOVA MCX514, compiled: its bus. A data command takes WR6 and WR7, a reading command fills RR6 and RR7."""

from __future__ import annotations

from stage.chips.nova import power, state
from stage.chips.nova.bus.common import busy, lowest, meant, parameters, phase_bits
from stage.chips.nova.functions import home, sync, timer
from stage.chips.nova.functions import io as ports
from stage.chips.nova.functions.inputs import turn
from stage.chips.nova.interpolation import multichip
from stage.chips.nova.interpolation import queue as prebuffer
from stage.chips.nova.motion import drive, rates
from stage.chips.nova.registers.mcx514 import GENERATION
from stage.chips.nova.registers.mcx514 import MCX514_MAP as MAP
from stage.native import exported, hot

WRITES, SIGNED, SHORT, RESET_PLACES, RESET_VALUES = parameters(MAP)
ALONE = sum(1 << c.code for c in MAP.commands if c.kind == "data write" and not c.axes)


def _code(symbol: str) -> int:
    return MAP.command(symbol).code


def _of(word: str, name: str) -> int:
    return MAP.mask(word, name)


RST = _code("RST")
CODE, AXIS_BITS, FIRST_AXIS = _of("WR0", "CODE"), _of("WR0", "AXIS"), MAP.bit("WR0", "AXIS")
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
DRVRL, DRVNR, DRVVP, DRVVM, DRVAB, DRVSBRK, DRVFBRK, DIRCP, DIRCM, HMSRC = (_code(n) for n in (
    "DRVRL", "DRVNR", "DRVVP", "DRVVM", "DRVAB", "DRVSBRK", "DRVFBRK", "DIRCP", "DIRCM", "HMSRC"))  # fmt: skip
VINC, VDEC, DHOLD, DFREE, R2CLR, RR3P0, RR3P1 = (_code(n) for n in (
    "VINC", "VDEC", "DHOLD", "DFREE", "R2CLR", "RR3P0", "RR3P1"))  # fmt: skip
MFPC = _code("MFPC")
_CODES = {m.axes: set(m.by_code) for m in GENERATION}
LACKED = tuple(
    sum(1 << axes for axes, its in _CODES.items() if code not in its) if code in set().union(*_CODES.values()) else 0
    for code in range(256)
)
"""Of a command that a chip of the generation has: bit k is set if the one with k axes lacks it."""
_INTERPOLATING = [c.code for c in MAP.commands if c.kind == "interpolation"]
INTERPOLATION_FIRST, INTERPOLATION_LAST = min(_INTERPOLATING), max(_INTERPOLATING)

SP0_E, SP1_E, SP2_E, INP_E, ALM_E, HLM_E, HLM_M, SLM_E, SLM_O, SLM_M = (_of("WR2", n) for n in (
    "SP0-E", "SP1-E", "SP2-E", "INP-E", "ALM-E", "HLM-E", "HLM-M", "SLM-E", "SLM-O", "SLM-M"))  # fmt: skip
SP0_L, SP1_L, SP2_L, INP_L, ALM_L, HLM_L = (_of("WR2", f"{n}-L") for n in ("SP0", "SP1", "SP2", "INP", "ALM", "HLM"))
MANLD, DSNDE, SACC, PIINV, LMINV, AVTRI = (_of("WR3", n) for n in ("MANLD", "DSNDE", "SACC", "PIINV", "LMINV", "AVTRI"))
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
def reset(c):
    """Reset: registers to their values, modes and counters 0, X selected; the clock, the input pins and the pulse totals go on."""
    power.clear(c)
    for j in range(state.AXES):
        x = c.ax[j]
        for k in range(len(RESET_PLACES)):
            x.reg[RESET_PLACES[k]] = RESET_VALUES[k]
        configure(x)


@hot
def configure(x):
    """WR2, WR3 and the filters in plain terms."""
    w = x.wr[2]
    x.stops = (1 if w & SP0_E else 0) | (2 if w & SP1_E else 0) | (4 if w & SP2_E else 0)
    x.inpos_waits, x.alarm_stops = w & INP_E, w & ALM_E
    x.limits, x.limit_slow = w & HLM_E, w & HLM_M
    x.soft_plus = x.soft_minus = w & SLM_E
    x.soft_rp, x.soft_instant = w & SLM_O, w & SLM_M
    turned = (state.STOP0 if w & SP0_L else 0) | (state.STOP1 if w & SP1_L else 0) | (state.STOP2 if w & SP2_L else 0)
    turned |= (state.INPOS if w & INP_L else 0) | (state.ALARM if w & ALM_L else 0)
    turn(x, turned | (state.LMT_PLUS | state.LMT_MINUS if w & HLM_L else 0))
    w = x.wr[3]
    x.manual, x.asymmetric = w & MANLD, 1 if w & DSNDE else 0
    x.s_curve, x.prevents = 1 if w & SACC else 0, 0 if w & AVTRI else 1
    x.swaps, x.exchanges, x.encoder = w & LMINV, w & PIINV, w >> PIMD & 3
    f = x.mode[state.FLM]
    x.filtered = 0
    for k in range(8):
        if f >> k & 1:
            x.filtered |= _FILTERS[k]
    x.delay, x.slow_delay = 8 << (f >> FL0 & 15), 8 << (f >> FL1 & 15)


@hot
def _data(c):
    return c.high << 16 | c.low


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
def _read_data(c, code):
    """A data-reading command: RR6 and RR7."""
    x = c.ax[lowest(c)]
    place = PLACES[code]
    if code == R_TX:
        value = prebuffer.longest(c)
    elif 0 <= place < state.REGISTERS:
        value = c.ax[0].reg[place] if ALONE >> place & 1 else x.reg[place]
    elif MODE_PLACES[code] >= 0:
        value = x.mode[MODE_PLACES[code]]
    elif code == R_CV:
        value = rates.speed_reading(c, x)
    elif code == R_CA:
        value = rates.rate_reading(c, x)
    elif code == R_CT:
        value = timer.reading(c, x)
    elif code == R_CHLN:
        value = prebuffer.rotations(c)
    elif R_WR1 <= code <= R_WR3:
        value = x.wr[code - R_WR1 + 1]
    else:
        value = 0
    c.read_low, c.read_high = value & 0xFFFF, value >> 16 & 0xFFFF


@hot
def _axis_command(c, x, j, code):
    if code == DRVRL:
        drive.start(c, x, drive.RELATIVE)
    elif code == DRVNR:
        drive.start(c, x, drive.COUNTER_RELATIVE)
    elif code == DRVVP:
        drive.start(c, x, drive.FORWARD)
    elif code == DRVVM:
        drive.start(c, x, drive.BACKWARD)
    elif code == DRVAB:
        drive.start(c, x, drive.ABSOLUTE)
    elif code == DRVSBRK:
        home.end(c, x)
        drive.request_stop(c, x, 0)
    elif code == DRVFBRK:
        home.end(c, x)
        drive.stop(c, x, 0)
    elif code in (DIRCP, DIRCM):
        if not (x.driving or x.interpolates):
            x.way = 1 if code == DIRCP else -1
    elif code == HMSRC:
        home.start(c, x)
    elif code in (VINC, VDEC):
        drive.step_speed(c, x, 1 if code == VINC else -1)
    elif code in (DHOLD, DFREE):
        drive.hold(c, x, code == DHOLD)
    elif code == R2CLR:
        x.causes = c.failed = 0
    elif code == RR3P0:
        c.pages &= ~(1 << j)
    elif code == RR3P1:
        c.pages |= 1 << j
    else:
        sync.command(c, x, code)


@hot
def command(c, value):
    """A write to WR0."""
    c.unused = 0
    code, axes = value & CODE, (value & AXIS_BITS) >> FIRST_AXIS
    if axes == 0 and code == RST:
        reset(c)
        return
    axes = 1 if c.axes == 1 else axes & (1 << c.axes) - 1
    if axes:
        c.selected = axes
    c.stale = 1
    if LACKED[code] >> c.axes & 1:
        if READ_FIRST <= code <= READ_LAST:
            c.read_low = c.read_high = 0
        return
    if code < state.REGISTERS and WRITES >> code & 1:
        if ALONE >> code & 1:
            _set(c, c.ax[0], code, _data(c))
            return
        for j in range(state.AXES):
            if axes >> j & 1:
                _set(c, c.ax[j], code, _data(c))
    elif state.MODE_FIRST <= code <= MODE_LAST:
        if code == state.MODE_FIRST + state.IPM:
            c.ax[0].mode[state.IPM] = c.low & ~(MEMBERS & ~0 << c.axes)
            return
        for j in range(state.AXES):
            if axes >> j & 1:
                c.ax[j].mode[code - state.MODE_FIRST] = c.low
                configure(c.ax[j])
    elif READ_FIRST <= code <= READ_LAST:
        _read_data(c, code)
    elif INTERPOLATION_FIRST <= code <= INTERPOLATION_LAST or code == MFPC:
        prebuffer.command(c, code)
    else:
        for j in range(state.AXES):
            if axes >> j & 1:
                _axis_command(c, c.ax[j], j, code)


@exported(None, state.STATE, "i8", "i8")
def write(c, address, value):
    """WR0 to WR7."""
    if address == 0:
        command(c, value)
    elif address <= 3:
        for j in range(state.AXES):
            if c.selected >> j & 1:
                c.ax[j].wr[address] = value
                configure(c.ax[j])
        c.stale = 1
    elif address == 4:
        c.outputs4 = value
    elif address == 5:
        c.outputs5 = value
    else:
        drive.keep_data(c, address, value)


@hot
def content(c, address):
    """Return what was last written to WR1 to WR7, for a write of half a word."""
    if address <= 3:
        return c.ax[lowest(c)].wr[address]
    if address == 4:
        return c.outputs4
    if address == 5:
        return c.outputs5
    return c.low if address == 6 else c.high


@hot
def _low(x, bit):
    """The electrical level of an input that is low while its pin is set."""
    return 0 if x.inputs & bit else 1


@hot
def _pins_page(c, x):
    return (
        _low(x, state.STOP0) | _low(x, state.STOP1) << 1 | _low(x, state.STOP2) << 2
        | (1 - _low(x, state.ECA)) << 3 | (1 - _low(x, state.ECB)) << 4 | _low(x, state.INPOS) << 5 | _low(x, state.ALARM) << 6
        | _low(x, state.LMT_PLUS) << 7 | _low(x, state.LMT_MINUS) << 8 | x.home << HSST
    )  # fmt: skip


@hot
def status(c):
    """RR0."""
    word = 0
    for j in range(state.AXES):
        x = c.ax[j]
        word |= (DRIVES << j if busy(x) else 0) | (FAILS << j if x.causes & ERRORS else 0)
    return word | prebuffer.status_bits(c)


@hot
def read(c, address):
    """RR0 to RR7."""
    j = lowest(c)
    x = c.ax[j]
    if address == 0:
        return status(c)
    if address == 1:
        word = x.factors & 0xFFFF
        x.factors = 0
        return word
    if address == 2:
        return x.causes & 0xFFFF
    if address == 3:
        if c.pages >> j & 1:
            more = multichip.MCERR if c.failed else 0
            return sync.status_bits(x) | phase_bits(c, x) << FIRST_PHASE | more
        return _pins_page(c, x)
    if address == 4:
        return ports.word(c, 0)
    if address == 5:
        return ports.word(c, 2)
    return c.read_low if address == 6 else c.read_high


@hot
def interrupts(c):
    """The interrupt pin INT0N: an enabled factor of an axis."""
    for j in range(state.AXES):
        if c.ax[j].factors & c.ax[j].wr[1]:
            return 1
    return 0
