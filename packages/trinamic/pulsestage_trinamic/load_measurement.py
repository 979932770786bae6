"""Compiled measurement of a motor's load for StallGuard2 and StallGuard4: load angle and back EMF, as means over a full step.

The stage gives the true angle between field and rotor, and the back EMF, once per physics step. Nothing here depends on a position
or a switch.
"""

from __future__ import annotations

from stage.drives.trig import compute_sincos
from stage.native import hot

FULL_LOAD = 1024
"""LAM at the load angle of the greatest torque, 90 degrees, and beyond."""


@hot
def compute_load(angle, direction):
    """Return LAM, 0 to 1024: the motor's load torque as a share of the greatest one.

    Args:
        angle: Electrical radians by which the field leads the rotor.
        direction: Direction in which the field turns, 1 or -1. A rotor that is ahead of the field has no load.
    """
    sin, cos = compute_sincos(angle)
    sin *= direction
    return FULL_LOAD if cos <= 0.0 else int(FULL_LOAD * sin + 0.5) if sin > 0.0 else 0


@hot
def add_load_sample(c, lam, emf):
    """Add a sample to the means of LAM (load) and EMF over the present full step, which `c.full` counts."""
    if c.load_of != c.full:
        c.load_of, c.load_n, c.load_sum, c.emf_sum = c.full, 0, 0, 0
    c.load_n += 1
    c.load_sum += lam
    c.emf_sum += emf
    c.lam, c.emf = c.load_sum // c.load_n, c.emf_sum // c.load_n
