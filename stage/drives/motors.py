"""Motors by name, and the drive that feeds one. Values of the makers' data sheets; what they leave out is tagged."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from stage.drives import stepper
from stage.errors import ArgumentError, unknown


@dataclass(frozen=True)
class Motor:
    """A two-phase hybrid stepper motor, SI units.

    holding_torque is with both phases at rated current; evidence maps the fields that no data sheet gives to a reason.
    """

    name: str
    rated_current: float
    resistance: float
    inductance: float
    holding_torque: float
    detent_torque: float
    rotor_inertia: float
    steps_per_turn: int = 200
    evidence: dict[str, str] = field(default_factory=dict, hash=False)

    @property
    def rotor_teeth(self) -> int:
        """Nr: a full step is a quarter of a tooth."""
        return self.steps_per_turn // 4

    @property
    def torque_constant(self) -> float:
        """Km = T / (sqrt2 I), N m/A; the back-EMF constant in V s/rad as well."""
        return self.holding_torque / (math.sqrt(2) * self.rated_current)


_DETENT = "inferred: 5 % of the holding torque, as for the 17HS4401"
MOTORS: dict[str, Motor] = {
    m.name: m
    for m in (
        Motor("17HS4401", 1.7, 1.5, 2.8e-3, 0.40, 0.022, 54e-7),
        Motor(
            "17HS19-2004S1", 2.0, 1.4, 3.0e-3, 0.59, 0.030, 82e-7,
            evidence={"detent_torque": _DETENT, "rotor_inertia": "inferred: about 82 g cm2, by its length of 48 mm"},
        ),
        Motor(
            "17HS15-1504S", 1.5, 2.3, 4.4e-3, 0.45, 0.022, 54e-7,
            evidence={"detent_torque": _DETENT, "rotor_inertia": "inferred: that of other motors 39 mm long"},
        ),
        Motor("SS2422-5041", 1.0, 5.4, 2.9e-3, 0.186, 0.009, 28e-7, evidence={"detent_torque": _DETENT}),
    )
}  # fmt: skip
"""Presets by name."""


def motor(name: str | Motor) -> Motor:
    """A preset by name, or the motor itself. Raises ArgumentError with near misses."""
    if isinstance(name, Motor):
        return name
    if name not in MOTORS:
        raise unknown("motor", name, MOTORS)
    return MOTORS[name]


@dataclass(frozen=True)
class Drive:
    """A microstepping drive with its motor.

    motor: a Motor or a preset's name; microsteps per full step, 1 to 256; bus_voltage V; current A per phase at its peak
    (default: rated); mode "chopper", or "sine" for the ideal drive of the closed form.
    """

    motor: Motor = MOTORS["17HS4401"]
    microsteps: int = 16
    bus_voltage: float = 24.0
    current: float | None = None
    mode: str = "chopper"

    def __post_init__(self):
        object.__setattr__(self, "motor", motor(self.motor))
        if int(self.microsteps) != self.microsteps or not 1 <= self.microsteps <= 256:
            raise ArgumentError(f"microsteps={self.microsteps!r}: a drive takes a whole number from 1 to 256.")
        if not 0 < self.bus_voltage <= 400:
            raise ArgumentError(f"bus_voltage={self.bus_voltage!r}: a drive takes more than 0, up to 400 V.")
        peak = self.motor.rated_current
        if self.current is not None and not 0 < self.current <= 2 * peak:
            raise ArgumentError(
                f"current={self.current!r}: the {self.motor.name} takes more than 0, up to {2 * peak} A."
            )
        if self.mode not in ("chopper", "sine"):
            raise unknown("drive mode", self.mode, ("chopper", "sine"))

    @property
    def pulses_per_turn(self) -> int:
        return self.motor.steps_per_turn * self.microsteps

    def fill(self, record: Any) -> None:
        """Write the parameters into a STEPPER record; its state stays."""
        m = self.motor
        record.resistance, record.inductance, record.torque_constant = m.resistance, m.inductance, m.torque_constant
        record.detent, record.teeth, record.voltage = m.detent_torque, m.rotor_teeth, self.bus_voltage
        record.current = self.current if self.current is not None else m.rated_current
        record.per_pulse = math.pi / 2 / self.microsteps
        record.mode = stepper.SINE if self.mode == "sine" else stepper.CHOPPER
        record.slice = 0.0
