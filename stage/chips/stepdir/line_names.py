"""Lines of a STEP/DIR axis by the names that firmware for machine tools uses, and the pins that they stand for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stage.errors import ArgumentError, StageError

if TYPE_CHECKING:
    from stage.chips.chip import Chip

DRIVEN_LINE_PINS = {"step": ("step",), "dir": ("dir",), "enable": ("enable",)}
"""Lines that a host drives -> input pins of the axis."""
POWER_STAGE_OUTPUTS = ("diag", "diag0", "diag1", "index")
"""Lines that only axes have whose power stage has such outputs."""
READ_LINE_PINS = {
    "limit": ("el_plus", "el_minus"), "limit_plus": ("el_plus",), "limit_minus": ("el_minus",), "origin": ("org",),
    "probe": ("probe",), **{name: (name,) for name in POWER_STAGE_OUTPUTS},
}  # fmt: skip
"""Lines that a host reads -> pins of the axis; the line is asserted while one of them is."""


def has_line(chip: Chip, name: str) -> bool:
    """Return whether a chip is a STEP/DIR axis with this line."""
    return all(pin in chip.INPUTS for pin in ("step", *(DRIVEN_LINE_PINS | READ_LINE_PINS)[name]))


class Line:
    """Descriptor of a line as an attribute of the chip: True while the line is asserted. A line that a host drives can be set."""

    def __init__(self, name: str):
        self._name, self._pins = name, (DRIVEN_LINE_PINS | READ_LINE_PINS)[name]
        self.__doc__ = f"Line `{name}`, True while it is asserted: pin {' or '.join(self._pins)}."

    def __get__(self, chip: Chip | None, owner: type | None = None) -> Any:
        if chip is None:
            return self
        return any(getattr(chip.pins, pin) for pin in self._pins)

    def __set__(self, chip: Chip, is_asserted: bool) -> None:
        if self._name not in DRIVEN_LINE_PINS:
            pins = " and ".join(f"pins.{pin}" for pin in self._pins)
            raise StageError(f"{self._name} is driven by the stage and can only be read; {pins} can be set for a test.")
        if is_asserted not in (False, True):  # a text such as "minus" would count as asserted
            raise ArgumentError(f"{self._name} = {is_asserted!r}: a line is asserted or not; give True or False.")
        setattr(chip.pins, self._name, bool(is_asserted))
