"""Tolerances of motors: ranges of the core loss and the inductance of a motor on which nobody has measured them.

    tolerances = estimate_tolerances("17HS4401")
    tolerances["core_loss_damping"]                        low, high, and the evidence for them
    vary_motor("17HS4401", inductance=tolerances["inductance"].interpolate(0.5))

The hidden machines of the environments and the machines of `stage tune` are drawn from these ranges.

A single pull-out curve cannot distinguish a core loss from an inductance. So each of the two is drawn independently of the other,
which covers more machines than any curve allows.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from stage.drives.motors import (
    Motor,
    check_in_range,
    estimate_core_loss,
    find_motor,
    is_core_loss_known,
    read_tolerance,
)
from stage.support import portable_math

INDUCTANCE_TOLERANCE = 0.2
"""Tolerance of an inductance, as a share of the data sheet's value, which the data sheet of the 17HS19-2004S1 states."""
FITTED_LOSS_RANGE = 0.65, 1.25
"""Core loss over the fitted one: fits to the 17HS19-2004S1's curve with inductances 20 % above and below the data sheet's."""


class ToleranceRange(NamedTuple):
    """Range of a motor's value over all machines.

    Attributes:
        low: Smallest value, in the unit of the value.
        high: Largest value.
        evidence: Letter of EVIDENCE and a reason.
    """

    low: float
    high: float
    evidence: str

    def interpolate(self, share: float) -> float:
        """Return a value between low (share 0) and high (share 1), interpolated by the logarithm."""
        low, high = portable_math.log((self.low, self.high))
        return float(portable_math.exp(low + (high - low) * share))


def estimate_tolerances(motor: Motor | str) -> dict[str, ToleranceRange]:
    """Estimate the ranges of a motor's core loss damping, N m s/rad, and inductance, H, from their evidence.

    Args:
        motor: Motor or name of a preset.

    Returns:
        Ranges by name: "core_loss_damping" and "inductance".
    """
    motor = find_motor(motor)
    tolerance = read_tolerance(motor, "core_loss_resistance")
    if tolerance is not None:
        low, high = (share * motor.core_loss_damping for share in (1 - tolerance, 1 + tolerance))
        loss = ToleranceRange(low, high, motor.evidence["core_loss_resistance"])
    elif is_core_loss_known(motor):
        low, high = (share * motor.core_loss_damping for share in FITTED_LOSS_RANGE)
        fitted = motor.evidence["core_loss_resistance"].startswith("C")
        loss = ToleranceRange(
            low,
            high,
            "C: fits to the pull-out curve with the inductance 20 % above and below the data sheet's"
            if fitted
            else "I: 0.65 to 1.25 times the data sheet's, as a fit to the curve of the 17HS19-2004S1",
        )
    else:
        likely = estimate_core_loss(motor)
        loss = ToleranceRange(
            likely.low, likely.high, f"I: no pull-out curve of the {motor.name} is at hand; after the 17HS19-2004S1"
        )
    field = "inductance" if motor.effective_inductance is None else "effective_inductance"
    stated = read_tolerance(motor, field)
    tolerance = INDUCTANCE_TOLERANCE if stated is None else stated
    inductance = ToleranceRange(
        (1 - tolerance) * motor.phase_inductance,
        (1 + tolerance) * motor.phase_inductance,
        "I: +-20 %, as the data sheet of the 17HS19-2004S1 states" if stated is None else motor.evidence[field],
    )
    return {"core_loss_damping": loss, "inductance": inductance}


def vary_motor(motor: Motor | str, core_loss_damping: float | None = None, inductance: float | None = None) -> Motor:
    """Return the motor with another core loss damping or inductance.

    Args:
        motor: Motor or name of a preset.
        core_loss_damping: Core loss damping, N m s/rad, 0 for none; None: unchanged.
        inductance: Inductance, H; None: unchanged.

    Raises:
        ArgumentError: A value that no motor has.
    """
    motor = find_motor(motor)
    if core_loss_damping is not None:
        max_loss = motor.holding_torque / (2 * math.pi)  # one turn a second takes all torque
        check_in_range(
            f"{motor.name}: core_loss_damping", core_loss_damping, 0, max_loss, "N m s/rad", zero_allowed=True
        )
        resistance = motor.torque_constant**2 / core_loss_damping if core_loss_damping else None
        motor = replace(motor, core_loss_resistance=resistance)
    return motor if inductance is None else replace(motor, effective_inductance=inductance)
