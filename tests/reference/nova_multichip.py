"""A line by several MCX514, tick by tick, from the page (shared/spec/nova_mcx514.md, sections 5 to 8): one maximum finish point
for all of them, each chip its own axes, the master's main axis the speed. Slow and plain; nothing here comes from stage.chips.

At tick k of L each axis is where it is nearest to its finish point times k / L, half-way away from zero.
"""

from reference.nova_profile import ceil_clock


def pulses(finish, times, longest=None, until=None):
    """Of each chip and axis the pulses (clock, direction) since the start.

    finish: of each chip the finish points of its axes; times: when the main axis makes its pulses, clocks, exactly;
    longest: a maximum finish point of the host's; until: the clock at which all of them are stopped.
    """
    most = max(longest or 0, *(abs(f) for chip in finish for f in chip))
    made, at = [[[] for _ in chip] for chip in finish], [[0] * len(chip) for chip in finish]
    for k, time in zip(range(1, most + 1), times, strict=False):
        clock = ceil_clock(time)
        if until is not None and clock > until:
            break
        for i, chip in enumerate(finish):
            for j, f in enumerate(chip):
                place = (2 * abs(f) * k + most) // (2 * most) * (1 if f > 0 else -1)
                if place != at[i][j]:
                    made[i][j].append((clock, place - at[i][j]))
                at[i][j] = place
    return made
