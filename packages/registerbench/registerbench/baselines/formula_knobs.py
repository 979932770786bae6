"""Factors on the rates and ramps of the formula, which searches choose instead of raw registers."""

from __future__ import annotations

import numpy as np

from stage.firmware import Axis
from stage.firmware.driver import get_driver
from stage.tune.formula import Load, plan_profile


class FormulaKnobs:
    """Factors on the formula's answer: on its rates and accelerations, and on the ramp-down point.

    A chip without R6 finds its ramp-down point itself, and has one acceleration for both ramps.

    Args:
        axis: Axis with its payload.
        pulses: Length of the move.
    """

    RANGES = (3.0, 1.3, 1.7, 1.7, 1.06)  # FL, FH, acceleration, deceleration, R6: factors from 1 / range to range

    def __init__(self, axis: Axis, pulses: int):
        self.pulses, self.middle, self.driver = pulses, plan_profile(Load.from_axis(axis), pulses), get_driver(axis)
        self.ranges = self.RANGES if "R6" in self.driver.list_move_registers(s_curve=False) else self.RANGES[:3]

    def compute_registers(self, knobs: np.ndarray) -> dict[str, int]:
        """Compute registers.

        Args:
            knobs: Numbers from -1 to 1, (len(ranges),); 0 stands for the value of the formula.
        """
        fl, fh, up, *others = np.array(self.ranges) ** np.asarray(knobs, float)
        down, point = others or (up, 1.0)
        m = self.middle
        low, high = m.fl * fl, m.fh1 * fh
        low = min(low, high)
        longer = (high - low) / (m.fh1 - m.fl)
        ramps = (
            max(ramp * longer / factor, 1e-3) for ramp, factor in ((m.get_accel_time(), up), (m.get_decel_time(), down))
        )
        values = self.driver.compute_move_registers(low, high, *ramps, self.pulses, s_curve=False)
        return {**values, "R6": min(round(values["R6"] * point), 0xFFFFF)} if others else values
