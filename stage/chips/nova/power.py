"""NOVA chips, compiled: what a reset does on all of them."""

from __future__ import annotations

from stage.chips.nova.functions import external, home, sync
from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.state import AXES, NO_PHASE
from stage.native import hot


@hot
def clear(c):
    """Registers, modes, counters and drives 0, X selected, the direction plus; the clock, the input pins and the pulse totals go
    on."""
    for j in range(AXES):
        x = c.ax[j]
        for k in range(len(x.reg)):
            x.reg[k] = 0
        for k in range(len(x.wr)):
            x.wr[k] = 0
        for k in range(len(x.mode)):
            x.mode[k] = 0
        x.driving = x.waiting = x.held = x.done = x.output = x.fixed = x.slow = 0
        x.high, x.net_at_reset = 0, x.net
        x.factors = x.fired = x.causes = 0
        x.way = 1
        x.phase = NO_PHASE
        sync.reset(c, x)
        home.reset(x)
        external.reset(x)
    interpolation.reset(c)
    c.selected = 1
    c.low = c.high = c.read_low = c.read_high = c.pages = c.outputs4 = c.outputs5 = 0
    c.stale = 1
