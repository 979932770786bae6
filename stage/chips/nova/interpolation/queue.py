"""NOVA MCX514, compiled: interpolation commands, and the pre-buffer of eight segments that they write to."""

from __future__ import annotations

from stage.chips.nova.interpolation import helix as helical
from stage.chips.nova.interpolation import multichip, segment
from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.registers.mcx514 import MCX514_MAP as MAP
from stage.chips.nova.state import ARC, AXES, CP, HELIX, HLN, HLV, IPM, LINE, PATTERN, STAGES, TP, TX
from stage.native import greatest, hot, least


def _code(symbol: str) -> int:
    return MAP.command(symbol).code


LINES, CIRCLE_CW, CIRCLE_CCW, PATTERNS, HELIX_CW, HELIX_CCW, COUNT_CW, COUNT_CCW = (_code(n) for n in (
    "LHK1", "CHKCW", "CHKCCW", "BHK2", "HLCW", "HLCCW", "HLPCW", "HLPCCW"))  # fmt: skip
DECEN, DECDIS, CLRSTEP, MFPC = (_code(n) for n in ("DECEN", "DECDIS", "CLRSTEP", "MFPC"))
CXIV, LMDF, STEP, MAXM = (MAP.mask("IPM", n) for n in ("CXIV", "LMDF", "STEP", "MAXM"))
SPD = MAP.bit("IPM", "SPD")
CNEXT = MAP.mask("RR0", "CNEXT")
ZONE, SC = MAP.bit("RR0", "ZONE"), MAP.bit("RR0", "SC")
ENABLES = (1 << AXES) - 1
VECTOR = (0, 2, 3, 2)
"""How many axes constant vector speed looks at, by SPD."""


@hot
def command(c, code):
    """60h to 6Fh, 7Ch."""
    ip = c.ip
    if code in (DECEN, DECDIS):
        ip.enabled = 1 if code == DECEN else 0
    elif code == CLRSTEP:
        ip.interrupt = 0
        interpolation.single_step(c)
    elif code == MFPC:
        c.ax[0].reg[TX] = 0
    elif code in (COUNT_CW, COUNT_CCW):
        _calculate(c, code)
    else:
        _segment(c, code)
    c.stale = 1


@hot
def _axes(mask):
    return (mask & 1) + (mask >> 1 & 1) + (mask >> 2 & 1) + (mask >> 3 & 1)


@hot
def coordinate(value, fine):
    """A finish point or centre: 31 bits with a sign; an eighth of that where inner ticks are finer."""
    half = (1 << 30) // fine
    return (value + half) % (2 * half) - half


@hot
def _choose(c, g, word, count):
    """The lowest `count` axes of IPM take part in segment `g`."""
    g.axes = 0
    for j in range(AXES):
        if word >> j & 1 and g.axes < count:
            g.axis[g.axes] = j
            g.axes += 1
    for k in range(AXES):
        g.finish[k] = 0
    g.centre[0] = g.centre[1] = g.turns = g.longest = 0
    g.mirror = g.fine = 1
    g.vector = VECTOR[word >> SPD & 3]
    g.slows = c.ip.enabled


@hot
def _circle(c, g, word, clockwise):
    """Finish point and centre of the first two axes."""
    if word & LMDF:
        g.fine = segment.INNER
    if word & CXIV:
        g.axis[0], g.axis[1] = g.axis[1], g.axis[0]
    g.mirror = -1 if clockwise else 1
    g.vector = least(g.vector, 2)
    for k in range(2):
        x = c.ax[g.axis[k]]
        g.finish[k], g.centre[k] = coordinate(x.reg[TP], g.fine), coordinate(x.reg[CP], g.fine)


@hot
def _segment(c, code):
    """60h to 6Ah."""
    word = c.ax[0].mode[IPM]
    mask = word & ENABLES
    count = _axes(mask)
    if code < CIRCLE_CW:
        need = code - LINES + 1
    elif PATTERNS <= code < HELIX_CW:
        need = code - PATTERNS + 2
    else:
        need = 2 if code in (CIRCLE_CW, CIRCLE_CCW) else 3
    if count < need:
        interpolation.refuse(c)
        return
    role = multichip.role_of(c, word)
    if role and (code >= CIRCLE_CW or not multichip.may_take(c, role)):
        return
    if not interpolation.may_take(c, mask, STAGES):
        return
    g = c.queue[interpolation.place_for(c)]
    helix = code in (HELIX_CW, HELIX_CCW)
    _choose(c, g, word, count if helix else need)
    main = g.axis[0]
    if code < CIRCLE_CW:
        g.kind = LINE
        if word & LMDF and not role:
            g.fine = segment.INNER
        for k in range(g.axes):
            g.finish[k] = coordinate(c.ax[g.axis[k]].reg[TP], g.fine)
            g.longest = greatest(g.longest, abs(g.finish[k]))
        if word & MAXM:
            g.longest = greatest(g.longest, c.ax[0].reg[TX])
    elif PATTERNS <= code < HELIX_CW:
        g.kind = PATTERN
        for k in range(g.axes):
            g.finish[k] = c.ax[g.axis[k]].reg[TP]
    else:
        _circle(c, g, word, code in (CIRCLE_CW, HELIX_CW))
        g.kind = HELIX if helix else ARC
        if helix:
            g.turns = c.ax[0].reg[HLN]
            g.longest = helical.inner_ticks(c.ip.probe, g, greatest(c.ax[0].reg[HLV], 1))
            for k in range(2, g.axes):
                g.finish[k] = coordinate(c.ax[g.axis[k]].reg[TP], g.fine)
    if role:
        multichip.wait(c, mask, main, word & STEP, role, word & MAXM)
    else:
        interpolation.submit(c, mask, main, STAGES, word & STEP)


@hot
def _calculate(c, code):
    """6Bh, 6Ch: HLV, at once."""
    word = c.ax[0].mode[IPM]
    if c.interpolating or _axes(word & ENABLES) < 2:
        return
    g = c.queue[interpolation.place_for(c)]
    _choose(c, g, word, 2)
    _circle(c, g, word & ~LMDF, code == COUNT_CW)
    g.turns = c.ax[0].reg[HLN]
    c.ax[0].reg[HLV] = helical.calculate(c.ip.probe, g)


@hot
def longest(c):
    """TX as it reads: the maximum finish point of the running segment, or of the one that is being written."""
    word = c.ax[0].mode[IPM]
    if word & MAXM:
        return c.ax[0].reg[TX]
    if c.interpolating:
        g = c.queue[c.ip.head]
        return g.longest if g.kind == LINE else 0
    maximum = 0
    for j in range(AXES):
        if word >> j & 1:
            maximum = greatest(maximum, abs(coordinate(c.ax[j].reg[TP], 1)))
    return maximum


@hot
def status_bits(c):
    """RR0: ZONE, CNEXT, SC."""
    ip = c.ip
    if not c.interpolating:
        return 0
    return ip.zone << ZONE | (CNEXT if ip.waiting < ip.depth else 0) | ip.waiting << SC


@hot
def rotations(c):
    """CHLN: the turns that a helix has made."""
    return c.ip.rotations
