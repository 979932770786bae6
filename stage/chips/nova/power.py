"""The part of a reset that is common to all NOVA chips, compiled."""

from __future__ import annotations

from stage.chips.nova.functions import external, home, sync
from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.state import AXES, NO_PHASE
from stage.native import hot


@hot
def clear_state(c):
    """Clear registers, modes, counters and drives, select axis X and the + direction.

    The clock, the input pins and the pulse totals stay.
    """
    for j in range(AXES):
        x = c.ax[j]
        for k in range(len(x.reg)):
            x.reg[k] = 0
        for k in range(len(x.wr)):
            x.wr[k] = 0
        for k in range(len(x.mode)):
            x.mode[k] = 0
        x.driving = x.awaits_inpos = x.start_hold = x.pulses_done = x.output_pulses = x.fixed = x.stopping = 0
        x.pulse_off_clock, x.net_at_reset = 0, x.net
        x.events = x.new_events = x.stop_causes = 0
        x.direction = 1
        x.phase = NO_PHASE
        sync.reset_actions(c, x)
        home.reset_search(x)
        external.reset_external_drives(x)
    interpolation.reset_interpolation(c)
    c.selected = 1
    c.data_low = c.data_high = c.read_low = c.read_high = c.status_pages = c.outputs4 = c.outputs5 = 0
    c.stale = 1
