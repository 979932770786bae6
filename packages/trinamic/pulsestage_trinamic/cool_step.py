"""Compiled CoolStep, which all chips with it share: the current scale that follows the measured load."""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage
from stage.native import hot, least

MEASUREMENTS_PER_STEP_DOWN = (32, 8, 2, 1)
"""Measurements for one step down, by SEDN."""


@hot
def set_active(c, is_active, irun):
    """Switch CoolStep (current control by load) on or off. Where it ends, the current of a moving motor returns to IRUN.

    Args:
        c: State of the chip.
        is_active: Whether CoolStep works from now on.
        irun: Current scale of IRUN.
    """
    if c.cooling and not is_active:
        c.count = 0
        if c.current == common_power_stage.RUNS:
            c.cs = irun
    c.cooling = 1 if is_active else 0


@hot
def adapt_current(c, coolconf, irun):
    """Adapt the current scale `c.cs` to the StallGuard measurement `c.sg`, as CoolStep does.

    Args:
        c: State of the chip.
        coolconf: COOLCONF.
        irun: Current scale of IRUN, the upper limit.
    """
    low, top = 32 * (coolconf & 15), 32 * ((coolconf & 15) + (coolconf >> 8 & 15) + 1)
    if c.sg < low:
        c.cs = least(irun, c.cs + (1 << (coolconf >> 5 & 3)))
        c.count = 0
    elif c.sg >= top:
        c.count += 1
        if c.count >= MEASUREMENTS_PER_STEP_DOWN[coolconf >> 13 & 3]:
            c.count = 0
            bottom = irun >> (2 if coolconf >> 15 & 1 else 1)
            c.cs = bottom if c.cs - 1 < bottom else c.cs - 1
    else:
        c.count = 0
