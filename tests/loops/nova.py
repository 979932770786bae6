"""Loops over a NOVA chip."""

from stage.chips.nova.motion import profile_evaluation
from stage.chips.nova.state import AXIS
from stage.native import array_of, exported


@exported("i8", AXIS, array_of("i8"))
def one_by_one(x, out):
    """The clocks of the next pulses of a drive, each found alone. Returns how many there are."""
    k = 0
    while k < len(out) and (x.fixed == 0 or x.pulses_done + k < x.output_pulses):
        out[k] = x.origin + profile_evaluation.find_clock_of_pulse(x, x.pulses_done + k + 1)
        k += 1
    return k
