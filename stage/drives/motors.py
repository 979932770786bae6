"""Stepper motors by name, and the microstepping drive for them. Each value of a preset states its source."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, ClassVar, NamedTuple

from stage.drives import stepper
from stage.drives.power_stages import IDEAL, PowerStage, find_power_stage
from stage.errors import ArgumentError, unknown_name_error
from stage.support.argument_checks import explain_constructor

EVIDENCE = {"C": "fitted to a published pull-out curve", "S": "data sheet", "I": "inferred"}
"""Letters that begin the evidence of a preset's value, and what they mean; after ": " comes a tolerance or a reason."""
UNITS = {
    "rated_current": "A", "resistance": "ohm", "inductance": "H", "holding_torque": "N m", "detent_torque": "N m",
    "rotor_inertia": "kg m^2", "steps_per_turn": "", "core_loss_resistance": "ohm", "effective_inductance": "H",
    "torque_constant": "N m/A", "continuous_torque": "N m", "nominal_voltage": "V",
}  # fmt: skip
"""Unit of each value of a stepper or DC motor."""
MICROSTEPS = range(1, 257)
MAX_BUS_VOLTAGE = 400.0
"""V."""
MAX_CORE_LOSS_RESISTANCE_OHM = 1e6
LIKELY_CORE_LOSS_S = (5e-4, 9e-4, 1.6e-3)
"""Least, middle and most core loss damping of a NEMA 17 motor over its holding torque, s/rad.

From the one published curve, that of the 17HS19-2004S1: the most is its fit with the inductance of the data sheet, the least
that with an inductance a third larger (spec/drives.md); the middle is their geometric mean.
"""
MODES = {"chopper": stepper.CHOPPER, "sine": stepper.SINE}


def check_in_range(
    quantity: str, value: object, low: float, high: float, unit: str, zero_allowed: bool = False, alternative: str = ""
) -> None:
    """Raise ArgumentError unless `value` is a number above `low` (with `zero_allowed`, or equal to it) and at most `high`.

    Args:
        quantity: Name of the value, for the message.
        value: Value to check.
        low: Lower limit.
        high: Upper limit.
        unit: Unit of the value.
        zero_allowed: Whether the lower limit itself is allowed.
        alternative: End of the message that says what may be given in place of a number.
    """
    fits = isinstance(value, Real) and not isinstance(value, bool)
    if fits and (low <= value <= high if zero_allowed else low < value <= high):  # type: ignore[operator]
        return
    bound = f"from {low:g}" if zero_allowed else f"above {low:g},"
    raise ArgumentError(f"{quantity}={value!r}: give a number {bound} up to {high:g} {unit}{alternative}.")


@dataclass(frozen=True)
class Motor:
    """A two-phase hybrid stepper motor.

    Attributes:
        name: Maker's name of the motor.
        rated_current: Current of a phase with both phases on, A.
        resistance: Resistance of a phase, ohm.
        inductance: Inductance of a phase as the data sheet states it, H.
        holding_torque: Torque with both phases at the rated current, N m.
        detent_torque: Torque without current, N m.
        rotor_inertia: kg m^2.
        steps_per_turn: Full steps of a turn.
        evidence: Source of a field's value, by the field's name: a letter of EVIDENCE and a tolerance or reason, "S: +-10 %".
        core_loss_resistance: Resistance across the back-EMF of a phase that stands for iron loss and eddy currents, ohm; None: the
            motor has no core loss.
        effective_inductance: Inductance that a published pull-out curve supports, H, used in place of `inductance`; None: there is
            no such curve.

    Raises:
        ArgumentError: A value that no motor has.
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
    core_loss_resistance: float | None = None
    effective_inductance: float | None = None

    def __post_init__(self) -> None:
        _check_evidence(self)
        check_in_range(f"{self.name}: rated_current", self.rated_current, 0, 100, "A")
        check_in_range(f"{self.name}: resistance", self.resistance, 0, 1000, "ohm")
        check_in_range(f"{self.name}: inductance", self.inductance, 0, 1, "H")
        check_in_range(f"{self.name}: holding_torque", self.holding_torque, 0, 1000, "N m")
        check_in_range(
            f"{self.name}: detent_torque", self.detent_torque, 0, self.holding_torque, "N m", zero_allowed=True
        )
        check_in_range(f"{self.name}: rotor_inertia", self.rotor_inertia, 0, 1, "kg m^2")
        check_in_range(f"{self.name}: steps_per_turn", self.steps_per_turn, 0, 4000, "")
        if self.steps_per_turn % 4:
            raise ArgumentError(
                f"{self.name}: steps_per_turn={self.steps_per_turn!r}: a tooth is 4 steps; try 200 or 400."
            )
        if self.effective_inductance is not None:
            check_in_range(f"{self.name}: effective_inductance", self.effective_inductance, 0, 1, "H")
        if self.core_loss_resistance is not None:
            least = self.torque_constant**2 * 2 * math.pi / self.holding_torque  # one turn a second takes all torque
            check_in_range(
                f"{self.name}: core_loss_resistance", self.core_loss_resistance, least, MAX_CORE_LOSS_RESISTANCE_OHM, "ohm",
                alternative=", or None for a motor without core loss",
            )  # fmt: skip

    @property
    def rotor_teeth(self) -> int:
        """Number of rotor teeth Nr; a full step is a quarter of a tooth."""
        return self.steps_per_turn // 4

    @property
    def torque_constant(self) -> float:
        """Km = T / (sqrt2 I), N m/A; the back-EMF constant in V s/rad as well."""
        return self.holding_torque / (math.sqrt(2) * self.rated_current)

    @property
    def core_loss_damping(self) -> float:
        """Braking torque of the core loss over the rotor's speed, Km^2 / Rm, N m s/rad; 0 without core loss.

        Each phase loses e / Rm of its current, and so Km e / Rm of its torque; of both phases that is Km^2 w / Rm at any angle.
        """
        return 0.0 if self.core_loss_resistance is None else self.torque_constant**2 / self.core_loss_resistance

    @property
    def phase_inductance(self) -> float:
        """Inductance of a phase in the model, H: the effective one where a curve supports it, else that of the data sheet."""
        return self.inductance if self.effective_inductance is None else self.effective_inductance


def _check_evidence(motor: Motor) -> None:
    """Raise ArgumentError for evidence of a value that a motor does not have, or without a letter of EVIDENCE."""
    if not isinstance(motor.evidence, Mapping):
        raise ArgumentError(
            f"{motor.name}: evidence={motor.evidence!r}: give a mapping, as {{'resistance': 'S: +-10 %'}}."
        )
    for name, source in motor.evidence.items():
        if name not in UNITS:
            raise unknown_name_error(f"value of the {motor.name} in its evidence", name, UNITS)
        letter, _, _ = source.partition(":") if isinstance(source, str) else ("", "", "")
        if letter not in EVIDENCE:
            letters = ", ".join(f"{letter} ({text})" for letter, text in EVIDENCE.items())
            raise ArgumentError(
                f"{motor.name}: evidence of {name}, {source!r}: begin with {letters}, as in 'S: +-10 %'."
            )


_DATA_SHEET_EVIDENCE = dict.fromkeys(
    (
        "rated_current", "resistance", "inductance", "holding_torque", "detent_torque", "rotor_inertia", "steps_per_turn",
    ), "S",
)  # fmt: skip
_DETENT_EVIDENCE = "I: about 5 % of the holding torque, as the 17HS4401 has 5.5 %; the data sheet gives none"
_CORE_LOSS_EVIDENCE = (
    "I: no pull-out curve is at hand; a damping of 9e-4 s/rad times the holding torque, likely 5e-4 to 1.6e-3, after the "
    "17HS19-2004S1"
)
MOTORS: dict[str, Motor] = {
    m.name: m
    for m in (
        Motor(
            "17HS4401", 1.7, 1.5, 2.8e-3, 0.40, 0.022, 54e-7, core_loss_resistance=77.0,
            evidence=_DATA_SHEET_EVIDENCE | {"core_loss_resistance": _CORE_LOSS_EVIDENCE},
        ),
        Motor(
            "17HS19-2004S1", 2.0, 1.6, 3.0e-3, 0.56, 0.030, 82e-7, core_loss_resistance=44.0,
            evidence=_DATA_SHEET_EVIDENCE | {
                "resistance": "S: +-10 %", "inductance": "S: +-20 %", "detent_torque": _DETENT_EVIDENCE,
                "holding_torque": "C: fitted with the core loss to six points of the curve; the data sheet gives 0.59 N m",
                "core_loss_resistance": "C: fitted with the holding torque to six points of the curve, driver losses included",
            },
        ),
        Motor(
            "17HS15-1504S", 1.5, 2.3, 4.4e-3, 0.45, 0.022, 54e-7, core_loss_resistance=111.0,
            evidence=_DATA_SHEET_EVIDENCE | {
                "detent_torque": _DETENT_EVIDENCE,
                "core_loss_resistance": _CORE_LOSS_EVIDENCE,
                "rotor_inertia": "I: that of the 17HS4401, the nearest in holding torque; the data sheet gives none",
            },
        ),
        Motor(
            "SS2422-5041", 1.0, 5.4, 2.9e-3, 0.186, 0.009, 28e-7, core_loss_resistance=103.0,
            evidence=_DATA_SHEET_EVIDENCE | {"detent_torque": _DETENT_EVIDENCE, "core_loss_resistance": _CORE_LOSS_EVIDENCE},
        ),
    )
}  # fmt: skip
"""Presets of stepper motors by name."""


class LikelyCoreLoss(NamedTuple):
    """Core loss damping that a motor without a published curve is likely to have, N m s/rad."""

    low: float
    middle: float
    high: float


def estimate_core_loss(motor: Motor | str) -> LikelyCoreLoss:
    """Estimate the core loss of a motor from its holding torque, in the proportion of the motor whose curve is published."""
    return LikelyCoreLoss(*(find_motor(motor).holding_torque * share for share in LIKELY_CORE_LOSS_S))


def is_core_loss_known(motor: Motor | str) -> bool:
    """Return whether the core loss of a motor is fitted to a published curve of that motor or stated by its data sheet."""
    return find_motor(motor).evidence.get("core_loss_resistance", "")[:1] in ("C", "S")


def read_tolerance(motor: Any, field: str) -> float | None:
    """Return the tolerance that the evidence of a motor's value states, for example 0.1 for "S: +-10 %"; None if it states none.

    Args:
        motor: Stepper motor or DC motor.
        field: Name of the value.

    Raises:
        ArgumentError: A tolerance of 100 % or more.
    """
    evidence = motor.evidence.get(field, "")
    stated = re.search(r"(?:\+-|±)\s*(\d+(?:\.\d+)?)\s*%", evidence)
    if stated is None:
        return None
    percent = float(stated[1])
    if percent >= 100:
        raise ArgumentError(f"{motor.name}: evidence of {field}, {evidence!r}: give a tolerance below 100 %.")
    return percent / 100


def describe_core_loss(motor: Motor | str) -> str:
    """Say in one sentence how well the core loss of a motor is known."""
    motor = find_motor(motor)
    if is_core_loss_known(motor):
        fitted = motor.evidence["core_loss_resistance"].startswith("C")
        source = "fitted to its published pull-out curve" if fitted else "stated by its data sheet"
        return f"The core loss of the {motor.name}, {motor.core_loss_damping:.2g} N m s/rad, is {source}."
    likely = estimate_core_loss(motor)
    return (
        f"No pull-out curve of the {motor.name} is at hand: its core loss is likely {likely.low:.2g} to {likely.high:.2g} "
        f"N m s/rad, simulated with {motor.core_loss_damping:.2g}."
    )


def find_motor(name: str | Motor) -> Motor:
    """Return the preset of this name. A Motor is returned unchanged.

    Raises:
        ArgumentError: No preset has this name; the error proposes similar ones.
    """
    if isinstance(name, Motor):
        return name
    if not isinstance(name, str) or name not in MOTORS:
        raise unknown_name_error("motor", name, MOTORS)
    return MOTORS[name]


@explain_constructor
@dataclass(frozen=True)
class Drive:
    """Microstepping drive with its motor.

    Attributes:
        motor: A Motor or a preset's name.
        microsteps: Microsteps per full step, 1 to 256.
        bus_voltage: Supply voltage, V, up to 400.
        current: Amplitude of a phase's sine, A, up to twice the rated current; default: the rated current, or the largest current
            of the power stage if that is less.
        mode: "chopper", or "sine" for the ideal drive of the closed form.
        detent: Detent torque that replaces the motor's own, N m; 0: none.
        power_stage: A PowerStage or its name, which limits microsteps, supply and current and demands times of STEP/DIR edges.
        drops_edges: Whether STEP edges that violate these times are lost. Otherwise a diagnostic says what silicon may do.

    Raises:
        ArgumentError: A value that no drive, or not this power stage, has.
    """

    PRESETS: ClassVar = MOTORS
    """Motors that the drive can have, by name."""
    has_encoder: ClassVar = False
    """Whether an encoder on the motor's shaft counts its position, as that of a Servo does."""

    motor: Motor = MOTORS["17HS4401"]
    microsteps: int = 16
    bus_voltage: float = 24.0
    current: float | None = None
    mode: str = "chopper"
    detent: float | None = None
    power_stage: PowerStage = IDEAL
    drops_edges: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "motor", find_motor(self.motor))
        if isinstance(self.microsteps, bool) or self.microsteps not in MICROSTEPS:
            raise ArgumentError(f"microsteps={self.microsteps!r}: a drive takes a whole number from 1 to 256.")
        check_in_range("bus_voltage", self.bus_voltage, 0, MAX_BUS_VOLTAGE, "V")
        if self.current is not None:
            check_in_range(f"current of the {self.motor.name}", self.current, 0, 2 * self.motor.rated_current, "A")
        if self.detent is not None:
            check_in_range(
                f"detent of the {self.motor.name}", self.detent, 0, self.motor.holding_torque, "N m", zero_allowed=True
            )
        if self.mode not in MODES:
            raise unknown_name_error("drive mode", self.mode, MODES)
        object.__setattr__(self, "power_stage", find_power_stage(self.power_stage))
        self._check_power_stage()

    def _check_power_stage(self) -> None:
        """Raise ArgumentError for microsteps, a supply or a current that the power stage does not have."""
        power_stage = self.power_stage
        if self.microsteps not in power_stage.microsteps:
            raise ArgumentError(
                f"microsteps={self.microsteps}: {power_stage.title} has {', '.join(map(str, power_stage.microsteps))}."
            )
        if not power_stage.min_supply <= self.bus_voltage <= power_stage.max_supply:
            raise ArgumentError(
                f"bus_voltage={self.bus_voltage:g}: {power_stage.title} works from {power_stage.min_supply:g} to "
                f"{power_stage.max_supply:g} V."
            )
        if self.current is not None and self.current > power_stage.max_current:
            raise ArgumentError(
                f"current={self.current:g}: {power_stage.title} gives up to {power_stage.max_current:g} A."
            )

    @property
    def amplitude(self) -> float:
        """Amplitude of the phase current, A."""
        if self.current is not None:
            return self.current
        return min(self.motor.rated_current, self.power_stage.max_current)

    @property
    def detent_torque(self) -> float:
        """Detent torque in use, N m: `detent`, or the motor's own."""
        return self.motor.detent_torque if self.detent is None else self.detent

    @property
    def peak_torque(self) -> float:
        """Largest torque that the motor holds, with both phases at the amplitude, N m."""
        return math.sqrt(2) * self.motor.torque_constant * self.amplitude

    @property
    def title(self) -> str:
        """Motor and settings of the drive in words."""
        power_stage = "" if self.power_stage.name == IDEAL.name else f", {self.power_stage.name}"
        return f"{self.motor.name}, 1/{self.microsteps} steps{power_stage}"

    @property
    def pulses_per_turn(self) -> int:
        """Pulses per turn of the motor."""
        return int(self.motor.steps_per_turn * self.microsteps)

    @property
    def per_pulse(self) -> float:
        """Electrical radians per pulse."""
        return math.pi / 2 / self.microsteps

    def fill_record(self, record: Any) -> None:
        """Write the parameters into a DRIVE record; the state in the record stays."""
        m = self.motor
        record.resistance = m.resistance
        record.inductance = m.phase_inductance
        record.torque_constant = m.torque_constant
        record.detent, record.teeth, record.voltage = self.detent_torque, m.rotor_teeth, self.bus_voltage
        record.current, record.per_pulse, record.mode = self.amplitude, self.per_pulse, MODES[self.mode]
        record.open, record.slice = 0, 0.0
