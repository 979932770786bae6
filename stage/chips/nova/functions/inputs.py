"""NOVA chips, compiled: from the pins through the filters to the levels that the chip works with; the encoder's counts.

A pin that is set (True) is low, which is active while its level bit in WR1 or WR2 is 0; a level bit of 1 turns it round.
"""

from __future__ import annotations

from stage.chips.nova.motion.counters import count_encoder
from stage.chips.nova.state import ECA, ECB, EMG_FILTER, INPUT_PINS, NEVER, RP, STOP2
from stage.native import greatest, hot, least

UP_DOWN = 3  # PIMD


@hot
def turn(x, word):
    """Make these inputs active high from now on."""
    x.turned = word
    x.active = x.level ^ word


@hot
def _quarter(word):
    """Where in its period an encoder with these levels stands: A leads B forward."""
    a, b = 1 if word & ECA else 0, 1 if word & ECB else 0
    return 2 * b + (a ^ b)


@hot
def _encoder(c, x, old, new):
    """An edge of ECA or ECB: four counts a period, two, one, or up on ECA and down on ECB."""
    direction = -1 if x.exchanges else 1
    if x.encoder == UP_DOWN:
        rises = new & ~old
        count_encoder(c, x, direction * ((1 if rises & ECA else 0) - (1 if rises & ECB else 0)))
        return
    begin, end = _quarter(old), _quarter(new)
    step = (end - begin) & 3
    if step == 2:
        return  # both at once: no direction can be told
    step = 1 if step == 1 else -1
    seam = (
        greatest(begin, end) if abs(begin - end) == 1 else 0
    )  # between which quarters: 1, 2, 3, or 0 at the period's end
    if x.encoder == 0 or (x.encoder == 1 and seam % 2 == 0) or (x.encoder == 2 and seam == 0):
        count_encoder(c, x, direction * step)


@hot
def follow(c, x):
    """Let the levels follow the pins, through the filters where these are on. Returns the clock at which the next one may."""
    at = NEVER
    if x.inputs == x.level:
        for k in range(INPUT_PINS):
            x.pending[k] = 0
        return at
    old = x.level
    for k in range(INPUT_PINS):
        bit = 1 << k
        if not (x.inputs ^ x.level) & bit:
            x.pending[k] = 0
            continue
        if x.filtered & bit:
            if x.pending[k] == 0:
                x.pending[k] = c.clock + (x.slow_delay if bit & (STOP2 | ECA | ECB) else x.delay)
            if c.clock < x.pending[k]:
                at = least(at, x.pending[k])
                continue
            x.pending[k] = 0
        x.level ^= bit
    if (old ^ x.level) & (ECA | ECB):
        _encoder(c, x, old, x.level)
    if x.clears and x.driving and (x.level ^ x.turned) & ~x.active & STOP2 and (x.stops & 4 or x.home):
        x.reg[RP] = 0
    if old != x.level:
        x.active = x.level ^ x.turned
        c.stale = 1
    return at


@hot
def follow_emergency(c):
    """The same for EMG, whose filter is that of X."""
    x = c.ax[0]
    if c.emg == c.emergency:
        c.emg_pending = 0
        return NEVER
    if x.filtered & EMG_FILTER:
        if c.emg_pending == 0:
            c.emg_pending = c.clock + x.delay
        if c.clock < c.emg_pending:
            return c.emg_pending
    c.emg_pending = 0
    c.emergency = c.emg
    c.stale = 1
    return NEVER
