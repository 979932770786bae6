"""Power stages by name: the electronics between STEP and DIR and the currents of a stepper motor.

    power_stage = find_power_stage("drv8825")
    power_stage.compute_current_limit(vref=0.65)           1.3 A with the sense resistors of the usual module
    Stage("xyz", chips="stepdir", drives=Drive(power_stage="drv8825", microsteps=32))

A package brings more of them by entry points, and they are then known by their names everywhere:

    [project.entry-points."pulsestage.power_stages"]
    acme100 = "acme_power:ACME100"
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field

from stage.errors import ArgumentError, unknown_name_error
from stage.support.argument_checks import explain_constructor
from stage.support.entry_points import PackageEntryPoint, find_entry_points, load_entry_point, may_have_entry_point

ENTRY_POINT_GROUP = "pulsestage.power_stages"
"""The entry points of a package that name power stages."""
EVIDENCE = {"S": "data sheet", "I": "inferred"}
"""Letters that begin the evidence of a value, and what they mean; after ": " comes a reason."""
MAX_TIME_S = 1.0


@explain_constructor
@dataclass(frozen=True)
class PowerStage:
    """Limits of a power stage, and the times that it demands between edges of STEP, DIR and ENABLE.

    Attributes:
        name: Name by which users choose it, in lower case.
        title: Maker and type.
        max_current: Largest amplitude of a phase current, A.
        min_supply: Lowest supply voltage, V.
        max_supply: Highest supply voltage, V.
        microsteps: Levels of `mode_pins` as H and L, by the microsteps per full step that they select.
        mode_pins: Names of the pins or switches that select the microsteps.
        step_high: Shortest time that STEP is high, s.
        step_low: Shortest time that STEP is low, s.
        dir_setup: Shortest time from a change of DIR to a rising edge of STEP, s.
        dir_hold: Shortest time from a rising edge of STEP to a change of DIR, s.
        enable_setup: Shortest time from ENABLE to a rising edge of STEP, s.
        counts_disabled: Steps are counted while ENABLE is not asserted.
        enable_level: Level of the ENABLE pin that switches the outputs on, "low" or "high".
        current_divider: The current limit is the reference voltage over this number and the sense resistor.
        sense_resistor: Sense resistor of the usual module, ohm.
        internal_resistance: Resistance inside the power stage, in series with the sense resistor, ohm.
        chip: STEP/DIR chip with the registers and further pins of the power stage, as "package.module:Class" of a subclass of
            `stage.chips.STEPDIR`; "": the power stage has none. Microsteps that only registers select have no levels of
            `mode_pins`: "".
        evidence: Source of a field's value, by the field's name: a letter of EVIDENCE and a reason.

    Raises:
        ArgumentError: A value that no power stage has.
    """

    name: str
    title: str
    max_current: float
    min_supply: float
    max_supply: float
    microsteps: Mapping[int, str] = field(hash=False)
    mode_pins: tuple[str, ...] = ()
    step_high: float = 0.0
    step_low: float = 0.0
    dir_setup: float = 0.0
    dir_hold: float = 0.0
    enable_setup: float = 0.0
    counts_disabled: bool = True
    enable_level: str = "low"
    current_divider: float | None = None
    sense_resistor: float | None = None
    internal_resistance: float = 0.0
    chip: str = ""
    evidence: Mapping[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if self.name != self.name.lower() or not self.name.isidentifier():
            raise ArgumentError(
                f"power stage {self.name!r}: a name has lower-case letters and digits only, as 'a4988'."
            )
        if not self.max_current > 0 or not 0 <= self.min_supply < self.max_supply:
            raise ArgumentError(
                f"{self.name}: {self.max_current!r} A at {self.min_supply!r} to {self.max_supply!r} V is no power stage."
            )
        for time in EDGE_TIME_FIELDS:
            if not 0 <= getattr(self, time) <= MAX_TIME_S:
                raise ArgumentError(f"{self.name}: {time}={getattr(self, time)!r}: from 0 up to {MAX_TIME_S:g} s.")
        if not self.microsteps:
            raise ArgumentError(f"{self.name}: microsteps={{}}: a power stage has at least one number of microsteps.")
        for microsteps, levels in self.microsteps.items():
            is_by_register = bool(self.chip) and levels == ""
            if not 1 <= microsteps <= 256 or not (
                is_by_register or (len(levels) == len(self.mode_pins) and not set(levels) - set("HL"))
            ):
                raise ArgumentError(
                    f"{self.name}: microsteps {microsteps!r} by {levels!r}: 1 to 256 microsteps, and H or L for each of the "
                    f"pins {', '.join(self.mode_pins) or '(none)'}."
                )
        if self.enable_level not in ("low", "high"):
            raise ArgumentError(f"{self.name}: enable_level={self.enable_level!r}: 'low' or 'high'.")
        if self.chip and not all(self.chip.partition(":")[::2]):
            raise ArgumentError(f"{self.name}: chip={self.chip!r}: write 'package.module:Class'.")

    @property
    def times(self) -> tuple[float, ...]:
        """Shortest allowed times between edges, s, in the order of EDGE_TIME_FIELDS."""
        return tuple(getattr(self, time) for time in EDGE_TIME_FIELDS)

    def find_microsteps(self, levels: str) -> int:
        """Return the microsteps per full step that the levels of the mode pins select, for example 16 for "HHH".

        Raises:
            ArgumentError: The data sheet has no microsteps for these levels.
        """
        for microsteps, known in self.microsteps.items():
            if known == levels.upper():
                return microsteps
        known = ", ".join(f"{levels} 1/{n}" for n, levels in self.microsteps.items() if levels)
        raise ArgumentError(f"{self.name}: {levels!r} on {' '.join(self.mode_pins)} selects nothing. Known: {known}.")

    def compute_current_limit(self, vref: float, sense_resistor: float | None = None) -> float:
        """Compute the amplitude of the phase currents.

        Args:
            vref: Reference voltage, V.
            sense_resistor: Sense resistor, ohm; None: that of the usual module.

        Returns:
            Amplitude, A, at most `max_current`.

        Raises:
            ArgumentError: The power stage has no reference voltage, or a value is not above 0.
        """
        resistor = self.sense_resistor if sense_resistor is None else sense_resistor
        if self.current_divider is None or resistor is None:
            raise ArgumentError(f"{self.name} has no reference voltage: give Drive(current=...).")
        if not vref > 0 or not resistor > 0:
            raise ArgumentError(f"vref={vref!r} V with {resistor!r} ohm: both must be greater than 0.")
        return min(vref / (self.current_divider * (resistor + self.internal_resistance)), self.max_current)


EDGE_TIME_FIELDS = ("step_high", "step_low", "dir_setup", "dir_hold", "enable_setup")
"""Fields that are times between edges, in the order of stage.chips.stepdir.state."""

IDEAL = PowerStage(
    "ideal", "a power stage without limits", 1000.0, 0.0, 400.0, dict.fromkeys(range(1, 257), ""),
    evidence={"max_current": "I: none is modeled"},
)  # fmt: skip
A4988 = PowerStage(
    "a4988", "Allegro A4988", 2.0, 8.0, 35.0, {1: "LLL", 2: "HLL", 4: "LHL", 8: "HHL", 16: "HHH"}, ("MS1", "MS2", "MS3"),
    step_high=1e-6, step_low=1e-6, dir_setup=200e-9, dir_hold=200e-9, current_divider=8.0, sense_resistor=0.068,
    evidence={
        "max_current": "S", "min_supply": "S", "max_supply": "S", "microsteps": "S", "step_high": "S", "step_low": "S",
        "dir_setup": "S", "dir_hold": "S", "counts_disabled": "S: the translator stays active", "current_divider": "S",
        "enable_setup": "I: none after ENABLE; after SLEEP, which is not modeled, the data sheet asks for 1 ms",
        "sense_resistor": "I: that of common modules; others have 0.05 or 0.1 ohm",
    },
)  # fmt: skip
DRV8825 = PowerStage(
    "drv8825", "Texas Instruments DRV8825", 2.5, 8.2, 45.0,
    {1: "LLL", 2: "HLL", 4: "LHL", 8: "HHL", 16: "LLH", 32: "HHH"}, ("MODE0", "MODE1", "MODE2"),
    step_high=1.9e-6, step_low=1.9e-6, dir_setup=650e-9, dir_hold=650e-9, enable_setup=650e-9, counts_disabled=False,
    current_divider=5.0, sense_resistor=0.1,
    evidence={
        "max_current": "S", "min_supply": "S", "max_supply": "S", "microsteps": "S", "step_high": "S", "step_low": "S",
        "dir_setup": "S", "dir_hold": "S", "enable_setup": "S: after ENABLE; after SLEEP, which is not modeled, it is 1.7 ms",
        "counts_disabled": "S: ENABLE stops the indexer", "current_divider": "S",
        "sense_resistor": "I: that of common modules",
    },
)  # fmt: skip
TB6600 = PowerStage(
    "tb6600", "Toshiba TB6600HG", 4.5, 8.0, 42.0, {1: "LLH", 2: "LHL", 4: "HLL", 8: "HLH", 16: "HHL"}, ("M1", "M2", "M3"),
    step_high=2.2e-6, step_low=2.2e-6, enable_level="high", current_divider=3.0, sense_resistor=0.11,
    evidence={
        "max_current": "S", "min_supply": "S", "max_supply": "S", "current_divider": "S",
        "microsteps": "I: from memory of the data sheet; driver boxes print a table of their own",
        "step_high": "I: from memory of the data sheet; boxes with slow optocouplers need 3 to 5 us",
        "step_low": "I: as step_high", "dir_setup": "I: the data sheet gives none", "dir_hold": "I: the data sheet gives none",
        "counts_disabled": "I", "enable_level": "S", "sense_resistor": "I: modules differ",
    },
)  # fmt: skip
POWER_STAGES: dict[str, PowerStage] = {p.name: p for p in (IDEAL, A4988, DRV8825, TB6600)}
"""PulseStage's own power stages, by name."""
_checked_names = {IDEAL.name}
"""Names whose conflicts with packages were looked for. Each drive has the ideal power stage by default, so its name is left out."""


def is_power_stage(name: object) -> bool:
    """Return whether PulseStage or an installed package has a power stage of this name."""
    return isinstance(name, str) and (name.lower() in POWER_STAGES or name.lower() in _find_package_power_stages())


def list_power_stages() -> list[str]:
    """Return the names of all power stages, PulseStage's own first."""
    return list(dict.fromkeys((*POWER_STAGES, *_find_package_power_stages())))


def find_power_stage(name: str | PowerStage) -> PowerStage:
    """Return the power stage of this name. A PowerStage is returned unchanged.

    Raises:
        ArgumentError: There is none, two packages provide it, or what a package provides is no PowerStage of this name.
        LoadError: The package that provides it cannot be imported.
    """
    if isinstance(name, PowerStage):
        return name
    if isinstance(name, str) and name.lower() in POWER_STAGES:
        _warn_of_name_conflict(name.lower())
        return POWER_STAGES[name.lower()]
    parts = _find_package_power_stages()
    if not isinstance(name, str) or name.lower() not in parts:
        raise unknown_name_error("power stage", name, list_power_stages())
    return _load_power_stage(name.lower(), parts[name.lower()])


def _warn_of_name_conflict(name: str) -> None:
    """Warn once, on stderr, if a package brings a power stage under one of PulseStage's own names."""
    if name in _checked_names:
        return
    _checked_names.add(name)
    parts = _find_package_power_stages().get(name) if may_have_entry_point(ENTRY_POINT_GROUP, name, str.lower) else None
    if parts:
        print(
            f"PulseStage: {name} is one of PulseStage's own power stages, and stays it, though {' and '.join(map(str, parts))} has "
            "one of this name: give its entry point another name.",
            file=sys.stderr,
            flush=True,
        )


def _load_power_stage(name: str, parts: list[PackageEntryPoint]) -> PowerStage:
    """Import the power stage that the entry points of a package name."""
    power_stage = load_entry_point("power stage", name, parts)
    if not isinstance(power_stage, PowerStage) or power_stage.name != name:
        raise ArgumentError(
            f"power stage {name} of {parts[0]} is {power_stage!r:.60}, and has to be a stage.drives.power_stages.PowerStage of "
            "this name."
        )
    return power_stage


def _find_package_power_stages() -> dict[str, list[PackageEntryPoint]]:
    """Find the power stages that installed packages bring."""
    return find_entry_points(ENTRY_POINT_GROUP, str.lower)
