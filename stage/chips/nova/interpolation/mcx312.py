"""NOVA MCX312 and MCX314As, compiled: interpolation commands, WR5, and the three sets of a bit pattern that can be stacked.

The MCX314As has lines and patterns of three axes, too.
"""

from __future__ import annotations

from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.interpolation import segment
from stage.chips.nova.registers.mcx300 import MCX312_MAP as MAP
from stage.chips.nova.registers.mcx300 import MCX314AS_MAP
from stage.chips.nova.state import ARC, CP, LINE, PATTERN, TP
from stage.native import greatest, hot, least


def _code(symbol: str) -> int:
    return MAP.command(symbol).code


LINE_2, CIRCLE_CW, CIRCLE_CCW, PATTERN_2, BP_ON, BP_OFF, BP_STACK, BP_CLEAR, ONE_STEP, DEC_ON, DEC_OFF, CLEAR = (
    _code(n) for n in (
        "IP_2ST", "IP_CW", "IP_CCW", "IP_2BP", "BP_ENABLED", "BP_DISABLED", "BP_STACK", "BP_CLR", "IP_1STEP",
        "IP_DEC_VALID", "IP_DEC_INVALID", "IP_INTRPT_CLR")
)  # fmt: skip
LINE_3, PATTERN_3 = (MCX314AS_MAP.command(n).code for n in ("IP_3ST", "IP_3BP"))
AX1 = MAP.bit("WR5", "AX1")  # the others lie behind, two bits each
LSPD = MAP.bit("WR5", "LSPD")
EXPLS, CMPLS = (MAP.mask("WR5", n) for n in ("EXPLS", "CMPLS"))
VECTOR = (0, 2, 2, 3)
"""How many axes constant vector speed looks at, by LSPD."""
WORDS = 6  # of a set: + and - of three axes
I_DRV, CNEXT = MAP.masks("RR0", "I-DRV", "CNEXT")
ZONE, BPSC = MAP.bit("RR0", "ZONE"), MAP.bit("RR0", "BPSC")
SETS = 3


@hot
def command(c, code):
    """30h to 3Dh."""
    ip = c.ip
    if code in (LINE_2, CIRCLE_CW, CIRCLE_CCW, PATTERN_2):
        _segment(c, code, 2)
    elif code in (LINE_3, PATTERN_3):
        if c.extended:
            _segment(c, code, 3)
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
def _choose(c, g, axes, count):
    """Segment `g` is one of the first `count` axes in `axes`, a word like WR5."""
    g.axes = count
    for k in range(count):
        g.axis[k] = axes >> AX1 + 2 * k & 3
    g.fine = g.mirror = 1
    g.longest = g.turns = 0
    g.vector = least(VECTOR[c.outputs5 >> LSPD & 3], count)
    g.slows = c.ip.enabled


@hot
def _mask(c, axes, count):
    """Their bits; 0 where the chip lacks one of them, or one comes twice."""
    mask = 0
    for k in range(count):
        j = axes >> AX1 + 2 * k & 3
        if j >= c.axes or mask >> j & 1:
            return 0
        mask |= 1 << j
    return mask


@hot
def _segment(c, code, count):
    """30h to 35h."""
    w, ip = c.outputs5, c.ip
    mask, pattern = _mask(c, w, count), code in (PATTERN_2, PATTERN_3)
    if not interpolation.may_take(c, mask, ip.depth if c.interpolating else 1):
        return
    if c.interpolating and (pattern or c.queue[ip.head].kind == PATTERN):
        return
    stepped = 2 if w & EXPLS else w & CMPLS
    if pattern:
        sets, ip.stacked = ip.stacked, 0
        for k in range(sets):
            _submit_set(c, k, w, count, stepped)
            if not c.interpolating:
                return
        return
    g = c.queue[interpolation.place_for(c)]
    _choose(c, g, w, count)
    for k in range(count):
        x = c.ax[g.axis[k]]
        g.finish[k] = _coordinate(x.reg[TP])
        if k < 2:
            g.centre[k] = _coordinate(x.reg[CP])
        g.longest = greatest(g.longest, abs(g.finish[k]))
    g.kind = LINE if code in (LINE_2, LINE_3) else ARC
    g.mirror = -1 if code == CIRCLE_CW else 1
    interpolation.submit(c, mask, g.axis[0], 1, stepped)


@hot
def _submit_set(c, k, axes, count, stepped):
    """Set `k` of the stack becomes a segment."""
    ip, g = c.ip, c.queue[interpolation.place_for(c)]
    _choose(c, g, axes, count)
    g.kind = PATTERN
    for m in range(count):
        g.finish[m] = ip.stack[k, 2 * m] | ip.stack[k, 2 * m + 1] << 16
    if c.interpolating:
        g.slows = c.queue[ip.head].slows
    interpolation.submit(c, _mask(c, axes, count), g.axis[0], SETS - 1, stepped)
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
    for m in range(WORDS):
        ip.stack[ip.stacked, m] = ip.loading[m]
    if _runs_pattern(c):
        g, axes = c.queue[ip.head], 0
        for k in range(g.axes):
            axes |= g.axis[k] << AX1 + 2 * k
        _submit_set(c, 0, axes, g.axes, ip.stepped)
    else:
        ip.stacked += 1


@hot
def load_pattern(c, k, value):
    """BP1P, BP1M, BP2P, BP2M, BP3P, BP3M."""
    c.ip.loading[k] = value


@hot
def takes_pattern(c):
    """WR2 to WR5, on the MCX314As to WR7, are the bit pattern now."""
    return c.ip.writing


@hot
def status_bits(c):
    """RR0: I-DRV, CNEXT, ZONE, BPSC."""
    ip = c.ip
    word = _sets(c) << BPSC
    if c.interpolating:
        word |= I_DRV | (CNEXT if ip.waiting < ip.depth else 0) | ip.zone << ZONE
    return word
