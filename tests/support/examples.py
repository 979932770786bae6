"""How many random examples a test takes, and which, by the environment.

The everyday suite takes few, and the same ones in every run. PULSESTAGE_EXAMPLES scales all of them, as `make test-slow` does, and
draws others in every run. PULSESTAGE_SEED repeats a run of the tests that draw for themselves; Hypothesis prints its own way.
"""

import os
import random

DAILY = 20
EXAMPLES = int(os.environ.get("PULSESTAGE_EXAMPLES", DAILY // 2))
FIXED = "PULSESTAGE_EXAMPLES" not in os.environ
SEED = int(os.environ.get("PULSESTAGE_SEED", 240 if FIXED else random.SystemRandom().getrandbits(32)))


def scaled(daily: int) -> int:
    """`daily` examples for PULSESTAGE_EXAMPLES of 20, as many more as it says; the everyday suite takes half of them."""
    return max(daily * EXAMPLES // DAILY, 1)


def assert_axes_are_named(figure):
    """Each panel of a path's picture says what is drawn upwards, the lowest what is drawn to the right, and in which unit."""
    lowest = min(figure.axes, key=lambda ax: ax.get_position().y0)
    for said in (lowest.get_xlabel(), *(ax.get_ylabel() for ax in figure.axes)):
        assert "(" in said or "," in said, f"{said!r} says no unit"
