"""Pull-out curves that makers publish, and motors fitted to them.

    curve = PUBLISHED_CURVES["17HS19-2004S1"]
    fit = fit_curve("17HS19-2004S1", curve, [200, 500, 700, 900])
    print(fit)                      published, predicted and deviation at each speed

A curve includes the losses of the driver with which it was measured. A single curve cannot distinguish a core loss from an
inductance that is larger than the data sheet's; it determines at most two values of a motor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from stage.drives.dynamometer import simulate_pull_out
from stage.drives.motors import Drive, Motor, check_in_range, find_motor
from stage.errors import ArgumentError, unknown_name_error
from stage.support.argument_checks import explain_arguments

MIN_POINTS = 3
MAX_FITTED_POINTS = 6
MAX_FITTED_VALUES = 2
GAUSS_NEWTON_STEPS = 8
DIFFERENCE_STEP = 0.03  # of a value's start; the bench resolves 1/4000 of the holding torque
SMALLEST_FACTOR, LARGEST_FACTOR = 0.5, 2.0  # of a fitted value from that of the data sheet
CORE_LOSS_UNIT = 1e-3  # s/rad: a core loss is fitted in multiples of this and of the holding torque


@dataclass(frozen=True)
class PublishedCurve:
    """Pull-out curve as its maker publishes it.

    Attributes:
        motor: Name of the motor.
        bus_voltage: Supply of the driver, V.
        current: Peak current of a phase, A.
        microsteps: Microsteps per full step.
        rpm: Speeds, rising.
        torque: Pull-out torque at each speed, N m.
        source: Document, and the driver with which the curve was measured.
        reading: How its numbers were read, and how precisely.

    Raises:
        ArgumentError: Fewer than three points, speeds that do not rise, a torque that is not above 0 or not finite, or settings
            that no drive has.
    """

    motor: str
    bus_voltage: float
    current: float
    microsteps: int
    rpm: tuple[float, ...]
    torque: tuple[float, ...]
    source: str
    reading: str

    def __post_init__(self) -> None:
        for name in ("rpm", "torque"):
            values = getattr(self, name)
            if not isinstance(values, Sequence | np.ndarray) or not all(isinstance(value, Real) for value in values):
                raise ArgumentError(f"curve of the {self.motor}: {name}={values!r}; give a list of numbers.")
            object.__setattr__(self, name, tuple(values))
        if len(self.rpm) < MIN_POINTS or len(self.torque) != len(self.rpm):
            raise ArgumentError(
                f"curve of the {self.motor}: {len(self.rpm)} speeds and {len(self.torque)} torques; give {MIN_POINTS} points or "
                "more, a torque at each speed."
            )
        speeds, torques = np.array(self.rpm, float), np.array(self.torque, float)
        if not (np.isfinite(speeds).all() and speeds[0] > 0 and (np.diff(speeds) > 0).all()):
            raise ArgumentError(f"curve of the {self.motor}: rpm={self.rpm!r}; give speeds above 0 in rising order.")
        if not (np.isfinite(torques).all() and (torques > 0).all()):
            raise ArgumentError(
                f"curve of the {self.motor}: torque={self.torque!r}; give N m above 0, as deviations are relative to them."
            )
        Drive(microsteps=self.microsteps, bus_voltage=self.bus_voltage)  # raises for settings that no drive has
        check_in_range(f"curve of the {self.motor}: current", self.current, 0, 100, "A")

    def build_drive(self, motor: Motor | str) -> Drive:
        """Build a drive with `motor` and the supply, current and microsteps of the curve."""
        return Drive(find_motor(motor), microsteps=self.microsteps, bus_voltage=self.bus_voltage, current=self.current)

    def predict(self, motor: Motor | str) -> np.ndarray:
        """Simulate the pull-out torque of `motor` at the speeds and settings of the curve, N m, shape (n,)."""
        return simulate_pull_out(self.build_drive(motor), self.rpm)

    def compare(self, motor: Motor | str) -> CurveComparison:
        """Compare the curve with the simulated pull-out torque of `motor`."""
        return CurveComparison(np.array(self.rpm, float), np.array(self.torque, float), self.predict(motor))


class CurveComparison(NamedTuple):
    """Comparison of a published with a simulated pull-out curve. `print` shows it as a table.

    Attributes:
        rpm: Speeds, shape (n,).
        published: Published torque, N m, shape (n,).
        simulated: Simulated torque, N m, shape (n,).
    """

    rpm: np.ndarray
    published: np.ndarray
    simulated: np.ndarray

    @property
    def deviation(self) -> np.ndarray:
        """Relative deviation of the simulated from the published torque, shape (n,)."""
        return self.simulated / self.published - 1

    def compute_rms(self, speeds: Sequence[float] | None = None) -> float:
        """Compute the root mean square of the deviation at `speeds`; default: at all speeds.

        Raises:
            ArgumentError: No speed, or one that the curve does not have.
        """
        selected = np.isin(self.rpm, self.rpm if speeds is None else speeds)
        if speeds is not None and not (selected.any() and np.isin(speeds, self.rpm).all()):
            raise ArgumentError(f"speeds={speeds!r}: give some of the curve's, {self.rpm.tolist()} rpm.")
        return float(np.sqrt(np.mean(self.deviation[selected] ** 2)))

    def __str__(self) -> str:
        head = f"{'rpm':>6}{'published':>11}{'simulated':>11}{'deviation':>11}   N m"
        rows = zip(*self, self.deviation, strict=True)
        return "\n".join([head, *(f"{r:>6.0f}{p:>11.3f}{s:>11.3f}{d:>+11.1%}" for r, p, s, d in rows)])


class CurveFit(NamedTuple):
    """Motor fitted to some points of a curve.

    Attributes:
        motor: The motor.
        fitted: Speeds of the fitted points, rpm.
        comparison: Comparison at all speeds.
        rms_of_others: Root mean square of the deviation at the other speeds; NaN if all points were fitted.
    """

    motor: Motor
    fitted: tuple[float, ...]
    comparison: CurveComparison
    rms_of_others: float

    def __str__(self) -> str:
        others = "all were" if math.isnan(self.rms_of_others) else f"{self.rms_of_others:.1%}"
        return f"{self.comparison}\nrms deviation at the speeds that were not fitted: {others}"


@explain_arguments
def fit_curve(
    motor: Motor | str,
    curve: PublishedCurve,
    speeds: Sequence[float],
    values: Sequence[str] = ("holding_torque", "core_loss_resistance"),
) -> CurveFit:
    """Fit one or two values of a motor to points of a curve, and predict the other points.

    Gauss-Newton steps minimize the relative deviations of the simulated pull-out torque.

    Args:
        motor: Motor whose other values stay as they are.
        curve: Published curve.
        speeds: Speeds of the curve to fit, rpm; at least as many as values, at most 6.
        values: One or two of holding_torque, effective_inductance and core_loss_resistance.

    Raises:
        ArgumentError: A speed that the curve does not have, too few or too many speeds or values.
    """
    motor = find_motor(motor)
    for name in values:
        if name not in _VALUES:
            raise unknown_name_error("value to fit", name, _VALUES)
    selected = sorted({float(speed) for speed in speeds})
    if not 1 <= len(set(values)) == len(values) <= MAX_FITTED_VALUES:
        raise ArgumentError(f"values={tuple(values)!r}: a curve fixes one or two values; give different ones.")
    if not len(values) <= len(selected) <= MAX_FITTED_POINTS or not set(selected) <= set(curve.rpm):
        raise ArgumentError(
            f"speeds={list(speeds)!r}: give {len(values)} to {MAX_FITTED_POINTS} of the curve's speeds, {list(curve.rpm)} rpm."
        )
    fitted = _fit_values(motor, curve, np.array(selected), list(values))
    comparison = curve.compare(fitted)
    others = [speed for speed in curve.rpm if speed not in selected]
    return CurveFit(fitted, tuple(selected), comparison, comparison.compute_rms(others) if others else math.nan)


def _scale_holding_torque(motor: Motor, start_motor: Motor, factor: float) -> Motor:
    """Return the motor with `factor` times the holding torque of `start_motor`."""
    return replace(motor, holding_torque=factor * start_motor.holding_torque)


def _scale_effective_inductance(motor: Motor, start_motor: Motor, factor: float) -> Motor:
    """Return the motor with `factor` times the inductance of `start_motor` as its effective inductance."""
    return replace(motor, effective_inductance=factor * start_motor.inductance)


def _scale_core_loss(motor: Motor, start_motor: Motor, factor: float) -> Motor:
    """Return the motor with a core loss of `factor` units. Call it last, because the resistance depends on the torque constant."""
    damping = factor * CORE_LOSS_UNIT * start_motor.holding_torque
    return replace(motor, core_loss_resistance=motor.torque_constant**2 / damping if damping > 0 else None)


_VALUES: dict[str, Any] = {
    "holding_torque": (_scale_holding_torque, 1.0, SMALLEST_FACTOR),
    "effective_inductance": (_scale_effective_inductance, 1.0, SMALLEST_FACTOR),
    "core_loss_resistance": (_scale_core_loss, 0.5, 0.0),
}
"""What can be fitted, in the order in which the values are set: how, the factor to start from, and the least one."""


def _fit_values(motor: Motor, curve: PublishedCurve, speeds: np.ndarray, values: list[str]) -> Motor:
    """Return the motor with the values that minimize the deviations at some speeds of a curve."""
    names = [name for name in _VALUES if name in values]
    published = np.array(curve.torque, float)[np.isin(curve.rpm, speeds)]
    least = np.array([_VALUES[name][2] for name in names])

    def build(factors: np.ndarray) -> Motor:
        """Return the motor with these factors of the fitted values."""
        built = motor
        for name, factor in zip(names, factors, strict=True):
            built = _VALUES[name][0](built, motor, float(factor))
        return built

    def compute_deviations(factors: np.ndarray) -> np.ndarray:
        """Return the relative deviations of the motor with these factors."""
        return simulate_pull_out(curve.build_drive(build(factors)), speeds) / published - 1

    factors = np.array([_VALUES[name][1] for name in names])
    for _ in range(GAUSS_NEWTON_STEPS):
        now = compute_deviations(factors)
        slopes = [
            (compute_deviations(factors + step) - now) / DIFFERENCE_STEP
            for step in DIFFERENCE_STEP * np.eye(len(names))
        ]
        change = np.linalg.lstsq(np.array(slopes).T, -now, rcond=None)[0]
        factors = np.clip(factors + change, least, LARGEST_FACTOR)
        if np.abs(change).max() < DIFFERENCE_STEP / 10:
            break
    return build(factors)


PUBLISHED_CURVES: dict[str, PublishedCurve] = {
    curve.motor: curve
    for curve in (
        PublishedCurve(
            "17HS19-2004S1",
            bus_voltage=24.0,
            current=2.2,
            microsteps=8,
            rpm=(100, 200, 300, 400, 500, 600, 700, 800, 900, 1000, 1100, 1200),
            torque=(0.412, 0.406, 0.406, 0.422, 0.402, 0.362, 0.324, 0.286, 0.254, 0.232, 0.200, 0.172),
            source="STEPPERONLINE, pull-out curve of the 17HS19-2004S1 with driver DM320T at 24 V, 2.2 A peak, 1/8 steps",
            reading="read off the printed curve to 0.005 N m",
        ),
    )
}
"""The curves by the name of the motor. None is known of the 17HS4401, the 17HS15-1504S and the SS2422-5041: Sanyo Denki's catalog
draws one of the SS2422-5041 (24 V, 1 A, full steps, an inertia of 0.33e-4 kg m^2), which nobody has read off yet."""
