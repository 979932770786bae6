"""A line by several MCX514, tick by tick, from the page (shared/spec/nova_mcx514.md, sections 5 to 8): one maximum finish point
for all of them, each chip its own axes, the master's main axis the speed. Slow and plain; nothing here comes from stage.chips.

At tick k of L each axis is where it is nearest to its finish point times k / L, half-way away from zero.
"""

from reference.nova_profile import ceil_clock


def pulses(finish, times, longest=None, until=None):
    """Return the pulses (clock, direction) of each chip and axis since the start."""
    maximum = max(longest or 0, *(abs(f) for chip in finish for f in chip))
    pulse_count, at = [[[] for _ in chip] for chip in finish], [[0] * len(chip) for chip in finish]
    for k, time in zip(range(1, maximum + 1), times, strict=False):
        clock = ceil_clock(time)
        if until is not None and clock > until:
            break
        for i, chip in enumerate(finish):
            for j, f in enumerate(chip):
                place = (2 * abs(f) * k + maximum) // (2 * maximum) * (1 if f > 0 else -1)
                if place != at[i][j]:
                    pulse_count[i][j].append((clock, place - at[i][j]))
                at[i][j] = place
    return pulse_count
