"""Reset of the state that all NOVA chips have in common, compiled."""

from __future__ import annotations

from stage.chips.nova.functions import external_drives, home_search, synchronous_actions
from stage.chips.nova.interpolation import interpolator as interpolation
from stage.chips.nova.state import MAX_CHIP_AXES, NO_PHASE
from stage.native import hot


@hot
def clear_state(chip):
    """Clear registers, modes, counters and drives, select axis X and the + direction.

    The clock, the input pins and the pulse totals stay.
    """
    for j in range(MAX_CHIP_AXES):
        x = chip.ax[j]
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
        synchronous_actions.reset_actions(chip, x)
        home_search.reset_search(x)
        external_drives.reset_external_drives(x)
    interpolation.reset_interpolation(chip)
    chip.selected = 1
    chip.data_low = chip.data_high = chip.read_low = chip.read_high = 0
    chip.status_pages = chip.outputs4 = chip.outputs5 = 0
    chip.stale = 1
