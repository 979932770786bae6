"""NOVA MCX312, compiled: interpolation commands, WR5, and the three sets of a bit pattern that can be stacked."""

from __future__ import annotations

from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.interpolation import segment
from stage.chips.nova.registers.mcx300 import MCX312_MAP as MAP
from stage.chips.nova.state import ARC, AXES, CP, LINE, PATTERN, TP
from stage.native import greatest, hot


def _code(symbol: str) -> int:
    return MAP.command(symbol).code


LINE_2, CIRCLE_CW, CIRCLE_CCW, PATTERN_2, BP_ON, BP_OFF, BP_STACK, BP_CLEAR, ONE_STEP, DEC_ON, DEC_OFF, CLEAR = (
    _code(n) for n in (
        "IP_2ST", "IP_CW", "IP_CCW", "IP_2BP", "BP_ENABLED", "BP_DISABLED", "BP_STACK", "BP_CLR", "IP_1STEP",
        "IP_DEC_VALID", "IP_DEC_INVALID", "IP_INTRPT_CLR")
)  # fmt: skip
AX1, AX2 = MAP.bit("WR5", "AX1"), MAP.bit("WR5", "AX2")
LSPD, EXPLS, CMPLS = (MAP.mask("WR5", n) for n in ("LSPD", "EXPLS", "CMPLS"))
I_DRV, CNEXT = MAP.masks("RR0", "I-DRV", "CNEXT")
ZONE, BPSC = MAP.bit("RR0", "ZONE"), MAP.bit("RR0", "BPSC")
SETS = 3


@hot
def command(c, code):
    """30h to 3Dh."""
    ip = c.ip
    if code in (LINE_2, CIRCLE_CW, CIRCLE_CCW, PATTERN_2):
        _segment(c, code)
    elif code in (BP_ON, BP_OFF):
        ip.writing = 1 if code == BP_ON else 0
    elif code == BP_STACK:
        _stack(c)
    elif code == BP_CLEAR:
        ip.stacked = 0
        if _runs_pattern(c):
            ip.waiting = 0
            segment.extend(c)
    elif code in (DEC_ON, DEC_OFF):
        ip.enabled = 1 if code == DEC_ON else 0
    elif code == CLEAR:
        ip.interrupt = 0
    elif code == ONE_STEP and c.outputs5 & CMPLS:
        interpolation.single_step(c)
    c.stale = 1


@hot
def _coordinate(value):
    """32 bits with a sign, of which 31 are used."""
    return (value + (1 << 30) & (1 << 31) - 1) - (1 << 30)


@hot
def _choose(c, g, first, second):
    g.axes, g.axis[0], g.axis[1] = 2, first, second
    g.fine = g.mirror = 1
    g.longest = g.turns = 0
    g.vector = 2 if c.outputs5 & LSPD else 0
    g.slows = c.ip.enabled


@hot
def _segment(c, code):
    """30h, 32h, 33h, 34h."""
    w, ip = c.outputs5, c.ip
    first, second = w >> AX1 & 3, w >> AX2 & 3
    if first == second or first >= c.axes or second >= c.axes:
        return
    if not interpolation.may_take(c, 1 << first | 1 << second, ip.depth if c.interpolating else 1):
        return
    if c.interpolating and (code == PATTERN_2 or c.queue[ip.head].kind == PATTERN):
        return
    stepped = 2 if w & EXPLS else w & CMPLS
    if code == PATTERN_2:
        sets, ip.stacked = ip.stacked, 0
        for k in range(sets):
            _submit_set(c, k, first, second, stepped)
            if not c.interpolating:
                return
        return
    g = c.queue[interpolation.place_for(c)]
    _choose(c, g, first, second)
    for k in range(2):
        x = c.ax[g.axis[k]]
        g.finish[k], g.centre[k] = _coordinate(x.reg[TP]), _coordinate(x.reg[CP])
        g.longest = greatest(g.longest, abs(g.finish[k]))
    g.kind = LINE if code == LINE_2 else ARC
    g.mirror = -1 if code == CIRCLE_CW else 1
    interpolation.submit(c, 1 << first | 1 << second, first, 1, stepped)


@hot
def _submit_set(c, k, first, second, stepped):
    """Set `k` of the stack becomes a segment."""
    ip, g = c.ip, c.queue[interpolation.place_for(c)]
    _choose(c, g, first, second)
    g.kind = PATTERN
    for m in range(2):
        g.finish[m] = ip.stack[k, 2 * m] | ip.stack[k, 2 * m + 1] << 16
    if c.interpolating:
        g.slows = c.queue[ip.head].slows
    interpolation.submit(c, 1 << first | 1 << second, first, SETS - 1, stepped)
    segment.extend(c)


@hot
def _runs_pattern(c):
    return c.interpolating and c.queue[c.ip.head].kind == PATTERN


@hot
def _sets(c):
    """BPSC."""
    return c.ip.waiting + 1 if _runs_pattern(c) else c.ip.stacked


@hot
def _stack(c):
    """38h: behind the sets that wait, or straight behind the running one; a fourth is lost."""
    ip = c.ip
    if _sets(c) >= SETS:
        return
    for m in range(AXES):
        ip.stack[ip.stacked, m] = ip.loading[m]
    if _runs_pattern(c):
        g = c.queue[ip.head]
        _submit_set(c, 0, g.axis[0], g.axis[1], ip.stepped)
    else:
        ip.stacked += 1


@hot
def load_pattern(c, k, value):
    """BP1P, BP1M, BP2P, BP2M."""
    c.ip.loading[k] = value


@hot
def takes_pattern(c):
    """WR2 to WR5 are the bit pattern now."""
    return c.ip.writing


@hot
def status_bits(c):
    """RR0: I-DRV, CNEXT, ZONE, BPSC."""
    ip = c.ip
    word = _sets(c) << BPSC
    if c.interpolating:
        word |= I_DRV | (CNEXT if ip.waiting < ip.depth else 0) | ip.zone << ZONE
    return word
