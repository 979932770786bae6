"""DC motors by name, and the servo amplifier with encoder that drives one. The values are those of the makers' data sheets."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, ClassVar

from stage.drives.drive_dispatch import SERVO
from stage.drives.motors import MAX_BUS_VOLTAGE, check_in_range
from stage.errors import ArgumentError, unknown_name_error
from stage.support.argument_checks import explain_constructor

MAX_COUNTS = 1 << 20
MAX_CURRENT_A = 1000


@explain_constructor
@dataclass(frozen=True)
class DCMotor:
    """Brushed DC motor with permanent magnets.

    Attributes:
        name: Maker's name of the motor.
        resistance: Resistance at the terminals, ohm.
        torque_constant: N m/A; the back-EMF constant in V s/rad as well.
        rotor_inertia: kg m^2.
        continuous_torque: N m.
        nominal_voltage: V.
        evidence: Source of a field's value, by the field's name, as `motors.EVIDENCE` has it.

    Raises:
        ArgumentError: A value that no motor has.
    """

    name: str
    resistance: float
    torque_constant: float
    rotor_inertia: float
    continuous_torque: float
    nominal_voltage: float = 24.0
    evidence: dict[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        check_in_range(f"{self.name}: resistance", self.resistance, 0, 1000, "ohm")
        check_in_range(f"{self.name}: torque_constant", self.torque_constant, 0, 1000, "N m/A")
        check_in_range(f"{self.name}: rotor_inertia", self.rotor_inertia, 0, 1, "kg m^2", zero_allowed=True)
        check_in_range(f"{self.name}: continuous_torque", self.continuous_torque, 0, 1000, "N m")
        check_in_range(f"{self.name}: nominal_voltage", self.nominal_voltage, 0, 400, "V")

    @property
    def stall_torque(self) -> float:
        """Torque at rest with the nominal voltage, N m."""
        return self.torque_constant * self.nominal_voltage / self.resistance


def _make_pittman_motor(
    name: str, torque_constant: float, motor_constant: float, inertia: float, continuous: float
) -> DCMotor:
    """Make a motor from the values that Pittman's data sheet lists."""
    evidence = dict.fromkeys(("torque_constant", "rotor_inertia", "continuous_torque"), "S")
    evidence["resistance"] = "S: (torque constant / motor constant)^2"
    evidence["nominal_voltage"] = "S: no-load speed times torque constant, rounded up"
    return DCMotor(name, (torque_constant / motor_constant) ** 2, torque_constant, inertia, continuous, 24.0, evidence)


DC_MOTORS: dict[str, DCMotor] = {
    m.name: m
    for m in (
        _make_pittman_motor("9233S013", 3.73e-2, 1.88e-2, 3.2e-6, 3.3e-2),
        _make_pittman_motor("14201S003", 5.25e-2, 3.14e-2, 1.1e-5, 7.1e-2),
        _make_pittman_motor("14203S010", 3.27e-2, 5.56e-2, 2.1e-5, 1.5e-1),
        _make_pittman_motor("14204S004", 3.06e-2, 6.09e-2, 2.6e-5, 1.8e-1),
    )
}
"""Presets of DC motors by name, all of Ametek Pittman."""


def find_dc_motor(name: str | DCMotor) -> DCMotor:
    """Return the preset of this name. A DCMotor is returned unchanged.

    Raises:
        ArgumentError: No preset has this name; the error proposes similar ones.
    """
    if isinstance(name, DCMotor):
        return name
    if not isinstance(name, str) or name not in DC_MOTORS:
        raise unknown_name_error("DC motor", name, DC_MOTORS)
    return DC_MOTORS[name]


@explain_constructor
@dataclass(frozen=True)
class Servo:
    """A servo amplifier, its DC motor and an incremental encoder on the motor's shaft.

    Attributes:
        motor: A DCMotor or a preset's name.
        bus_voltage: Voltage at full drive, V, up to 400.
        counts: Counts of the encoder per turn of the rotor, all four edges counted (500 lines make 2000).
        current_limit: Current that the amplifier never exceeds, A; None: the amplifier has no limit, so that a motor at rest takes
            its stall current.
        evidence: Source of a field's value, by the field's name, such as {"current_limit": "data sheet of the amplifier"}.

    Raises:
        ArgumentError: A value that no amplifier has.
    """

    PRESETS: ClassVar = DC_MOTORS
    has_encoder: ClassVar = True

    motor: DCMotor = DC_MOTORS["14201S003"]
    bus_voltage: float = 24.0
    counts: int = 2000
    current_limit: float | None = None
    evidence: dict[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "motor", find_dc_motor(self.motor))
        if self.current_limit is not None:
            otherwise = ", or None for an amplifier without a limit"
            check_in_range("current_limit", self.current_limit, 0, MAX_CURRENT_A, "A", alternative=otherwise)
        check_in_range("bus_voltage", self.bus_voltage, 0, MAX_BUS_VOLTAGE, "V")
        number = isinstance(self.counts, Real) and not isinstance(self.counts, bool)
        if not number or not 4 <= self.counts <= MAX_COUNTS or int(self.counts) != self.counts:
            raise ArgumentError(
                f"counts={self.counts!r}: an encoder has a whole number of counts a turn, 4 to {MAX_COUNTS:,}."
            )

    @property
    def peak_torque(self) -> float:
        """Stall torque with the full bus voltage, or at the current limit if that is less, N m."""
        stall = self.bus_voltage / self.motor.resistance
        if self.current_limit is not None and self.current_limit < stall:
            return self.motor.torque_constant * self.current_limit
        return self.motor.torque_constant * self.bus_voltage / self.motor.resistance

    @property
    def title(self) -> str:
        """Motor and settings in words."""
        return f"{self.motor.name}, encoder of {self.counts} counts"

    @property
    def pulses_per_turn(self) -> int:
        """Encoder counts per turn of the motor; a count is the unit of the chip."""
        return int(self.counts)

    def fill_record(self, record: Any) -> None:
        """Write the parameters into a DRIVE record."""
        record.resistance, record.torque_constant = self.motor.resistance, self.motor.torque_constant
        record.voltage, record.per_pulse, record.teeth = self.bus_voltage, 2 * math.pi / self.counts, 1.0
        record.mode, record.open, record.slice, record.offset = SERVO, 0, 0.0, 0.0
        record.current = self.current_limit or 0.0
