"""Interpolation commands of the MCX514 and MCX512, and the pre-buffer of eight segments that they fill; compiled."""

from __future__ import annotations

from stage.chips.nova.interpolation import helix as helical
from stage.chips.nova.interpolation import multichip, segment
from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.registers.mcx514 import MCX514_MAP as MAP
from stage.chips.nova.state import ARC, AXES, CP, HELIX, HLN, HLV, IPM, LINE, PATTERN, STAGES, TP, TX
from stage.native import greatest, hot, least


def _find_code(symbol: str) -> int:
    return MAP.command(symbol).code


LINES, CIRCLE_CW, CIRCLE_CCW, PATTERNS, HELIX_CW, HELIX_CCW, COUNT_CW, COUNT_CCW = (_find_code(n) for n in (
    "LHK1", "CHKCW", "CHKCCW", "BHK2", "HLCW", "HLCCW", "HLPCW", "HLPCCW"))  # fmt: skip
DECEN, DECDIS, CLRSTEP, MFPC = (_find_code(n) for n in ("DECEN", "DECDIS", "CLRSTEP", "MFPC"))
CXIV, LMDF, STEP, MAXM = (MAP.mask("IPM", n) for n in ("CXIV", "LMDF", "STEP", "MAXM"))
SPD = MAP.bit("IPM", "SPD")
CNEXT = MAP.mask("RR0", "CNEXT")
ZONE, SC = MAP.bit("RR0", "ZONE"), MAP.bit("RR0", "SC")
ENABLE_BITS = (1 << AXES) - 1
VECTOR_AXES = (0, 2, 3, 2)
"""Number of axes that constant vector speed considers, by SPD."""


@hot
def execute_command(c, code):
    """Execute an interpolation command, 60h to 6Fh or 7Ch."""
    ip = c.ip
    if code in (DECEN, DECDIS):
        ip.deceleration_enabled = 1 if code == DECEN else 0
    elif code == CLRSTEP:
        ip.interrupt = 0
        interpolation.make_single_step(c)
    elif code == MFPC:
        c.ax[0].reg[TX] = 0
    elif code in (COUNT_CW, COUNT_CCW):
        _calculate_hlv(c, code)
    else:
        _load_segment(c, code)
    c.stale = 1


@hot
def _count_axes(mask):
    """Count the axes in a mask."""
    return (mask & 1) + (mask >> 1 & 1) + (mask >> 2 & 1) + (mask >> 3 & 1)


@hot
def to_coordinate(value, fine):
    """Convert a register to a finish point or center: 31 bits with a sign, less by the factor of the inner ticks.

    Args:
        value: Value of the register.
        fine: Inner ticks per tick.
    """
    half = (1 << 30) // fine
    return (value + half) % (2 * half) - half


@hot
def _select_axes(c, g, word, count):
    """Let the lowest axes of IPM take part in a segment, and set its other fields to their defaults.

    Args:
        c: State of the chip.
        g: The segment.
        word: IPM.
        count: Number of axes.
    """
    g.axis_count = 0
    for j in range(AXES):
        if word >> j & 1 and g.axis_count < count:
            g.axis_numbers[g.axis_count] = j
            g.axis_count += 1
    for k in range(AXES):
        g.finish[k] = 0
    g.center[0] = g.center[1] = g.rotations = g.tick_count = 0
    g.y_sign = g.inner_ticks = 1
    g.vector_axes = VECTOR_AXES[word >> SPD & 3]
    g.decelerates = c.ip.deceleration_enabled


@hot
def _load_circle(c, g, word, clockwise):
    """Load the finish point and the center of the first two axes into a segment.

    Args:
        c: State of the chip.
        g: The segment.
        word: IPM.
        clockwise: Whether the circle is clockwise.
    """
    if word & LMDF:
        g.inner_ticks = segment.INNER_TICKS
    if word & CXIV:
        g.axis_numbers[0], g.axis_numbers[1] = g.axis_numbers[1], g.axis_numbers[0]
    g.y_sign = -1 if clockwise else 1
    g.vector_axes = least(g.vector_axes, 2)
    for k in range(2):
        x = c.ax[g.axis_numbers[k]]
        g.finish[k], g.center[k] = to_coordinate(x.reg[TP], g.inner_ticks), to_coordinate(x.reg[CP], g.inner_ticks)


@hot
def _load_segment(c, code):
    """Execute a command of a segment, 60h to 6Ah: start it, queue it, or refuse it."""
    word = c.ax[0].mode[IPM]
    mask = word & ENABLE_BITS
    count = _count_axes(mask)
    if code < CIRCLE_CW:
        need = code - LINES + 1
    elif PATTERNS <= code < HELIX_CW:
        need = code - PATTERNS + 2
    else:
        need = 2 if code in (CIRCLE_CW, CIRCLE_CCW) else 3
    if count < need:
        interpolation.note_refused_segment(c)
        return
    role = multichip.find_role(c, word)
    if role and (code >= CIRCLE_CW or not multichip.can_take_line(c, role)):
        return
    if not interpolation.can_take_segment(c, mask, STAGES):
        return
    g = c.queue[interpolation.find_free_place(c)]
    helix = code in (HELIX_CW, HELIX_CCW)
    _select_axes(c, g, word, count if helix else need)
    main = g.axis_numbers[0]
    if code < CIRCLE_CW:
        g.kind = LINE
        if word & LMDF and not role:
            g.inner_ticks = segment.INNER_TICKS
        for k in range(g.axis_count):
            g.finish[k] = to_coordinate(c.ax[g.axis_numbers[k]].reg[TP], g.inner_ticks)
            g.tick_count = greatest(g.tick_count, abs(g.finish[k]))
        if word & MAXM:
            g.tick_count = greatest(g.tick_count, c.ax[0].reg[TX])
    elif PATTERNS <= code < HELIX_CW:
        g.kind = PATTERN
        for k in range(g.axis_count):
            g.finish[k] = c.ax[g.axis_numbers[k]].reg[TP]
    else:
        _load_circle(c, g, word, code in (CIRCLE_CW, HELIX_CW))
        g.kind = HELIX if helix else ARC
        if helix:
            g.rotations = c.ax[0].reg[HLN]
            g.tick_count = helical.compute_inner_ticks(c.ip.scratch_arc, g, greatest(c.ax[0].reg[HLV], 1))
            for k in range(2, g.axis_count):
                g.finish[k] = to_coordinate(c.ax[g.axis_numbers[k]].reg[TP], g.inner_ticks)
    if role:
        multichip.await_start(c, mask, main, word & STEP, role, word & MAXM)
    else:
        interpolation.submit_segment(c, mask, main, STAGES, word & STEP)


@hot
def _calculate_hlv(c, code):
    """Execute a helical calculation, 6Bh or 6Ch, which writes HLV at once."""
    word = c.ax[0].mode[IPM]
    if c.interpolating or _count_axes(word & ENABLE_BITS) < 2:
        return
    g = c.queue[interpolation.find_free_place(c)]
    _select_axes(c, g, word, 2)
    _load_circle(c, g, word & ~LMDF, code == COUNT_CW)
    g.rotations = c.ax[0].reg[HLN]
    c.ax[0].reg[HLV] = helical.calculate_hlv(c.ip.scratch_arc, g)


@hot
def read_tx(c):
    """Return what TX reads: the maximum finish point of the running segment, or of the one that is being written."""
    word = c.ax[0].mode[IPM]
    if word & MAXM:
        return c.ax[0].reg[TX]
    if c.interpolating:
        g = c.queue[c.ip.queue_head]
        return g.tick_count if g.kind == LINE else 0
    maximum = 0
    for j in range(AXES):
        if word >> j & 1:
            maximum = greatest(maximum, abs(to_coordinate(c.ax[j].reg[TP], 1)))
    return maximum


@hot
def compute_status_bits(c):
    """Compute ZONE, CNEXT and SC, bits of RR0."""
    ip = c.ip
    if not c.interpolating:
        return 0
    return ip.zone << ZONE | (CNEXT if ip.waiting_segments < ip.queue_depth else 0) | ip.waiting_segments << SC


@hot
def read_chln(c):
    """Return what CHLN reads: the rotations that the helix has made."""
    return c.ip.finished_rotations
