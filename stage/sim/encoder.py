"""`Encoder`: an incremental encoder on an axis, for a chip that counts it or for a device on the bus."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stage.chips import CHIPS, ChipAxis
from stage.errors import ArgumentError, add_article, unknown_name_error

if TYPE_CHECKING:
    from stage.sim.plant import PlantAxis
    from stage.sim.stage import Stage


@dataclass(frozen=True)
class Encoder:
    """Incremental encoder: Encoder("x", per_metre=200_000) on a carriage, or Encoder("x", per_turn=2000) on its motor.

    All edges count, four for each line of the encoder.

    Attributes:
        axis: Name of the axis.
        per_metre: Counts per meter (per rad on a hinge).
        per_turn: Counts per turn of the motor.
        zero: Position (m, rad) at which the count is 0; default: the position of the axis when the device is added to the board.
            The counter of a chip ignores it: that counter is 0 after a reset.

    Raises:
        ArgumentError: Neither or both of `per_metre` and `per_turn` are given, or a value is not a finite number.
    """

    axis: str
    per_metre: float | None = None
    per_turn: float | None = None
    zero: float | None = None

    def __post_init__(self) -> None:
        rates = [n for n in (self.per_metre, self.per_turn) if n is not None]
        if len(rates) != 1 or not _is_finite_and_nonzero(rates[0]):
            raise ArgumentError(
                f"{self!r}: give either per_metre= or per_turn=, counts a metre or a turn of the motor; below 0 it is mounted the "
                "other way round."
            )
        if self.zero is not None and not _is_finite(self.zero):
            raise ArgumentError(f"{self!r}: zero= is the position at which it counts 0, m (rad on a hinge).")

    def compute_counts_per_unit(self, gear: float) -> float:
        """Compute the counts per unit of the joint (m, rad).

        Args:
            gear: Rotor radians per joint unit.
        """
        return self.per_metre if self.per_metre is not None else (self.per_turn or 0.0) * gear / (2 * math.pi)

    def make_record(self, stage: Stage) -> tuple[int, float, float]:
        """Return the values of the ENCODER record of stage.board.

        Args:
            stage: Stage whose axis the encoder measures.

        Returns:
            Index of the axis, counts per unit of its joint, and the joint position at which the encoder counts 0.

        Raises:
            ArgumentError: The stage has no such axis.
        """
        if self.axis not in stage.axes:
            raise unknown_name_error("axis", self.axis, stage.axes)
        axis = stage.axes[self.axis]
        gear = float(stage.state.axis_table[axis.index].gear)
        return axis.index, self.compute_counts_per_unit(gear), axis.position if self.zero is None else self.zero

    def __str__(self) -> str:
        per, unit = (self.per_metre, "metre") if self.per_metre is not None else (self.per_turn, "turn of the motor")
        return f"{per:,.12g} counts a {unit}"


EncoderChoice = Mapping[str, float] | Iterable[Encoder] | Encoder | None


def choose_encoders(
    encoder_choice: EncoderChoice, names: Sequence[str], chip_axes: Sequence[ChipAxis]
) -> tuple[Encoder, ...]:
    """Choose the encoders that the chips of a stage count, from the argument of `Stage`.

    Args:
        encoder_choice: Argument `encoders` of `Stage`.
        names: Names of the stage's axes.
        chip_axes: For each axis of the stage, the axis of its chip.

    Raises:
        ArgumentError: An axis does not exist, has two encoders, or a chip that counts no encoder.
    """
    chosen: dict[str, Encoder] = {}
    for encoder in _list_encoders(encoder_choice):
        if encoder.axis not in names:
            raise unknown_name_error("axis", encoder.axis, names)
        if encoder.axis in chosen:
            raise ArgumentError(f"encoders: axis {encoder.axis} is given two; a chip counts one an axis.")
        chip = type(chip_axes[names.index(encoder.axis)].chip)
        if chip.SERVO:
            raise ArgumentError(
                f"encoders for axis {encoder.axis}: {chip.__name__} has one already, that of the Servo: "
                f'drives={{"{encoder.axis}": Servo(counts=...)}}.'
            )
        if not chip.ENCODERS:
            able = ", ".join(line.name for line in CHIPS.list_chips() if line.chip and line.chip.ENCODERS)
            raise ArgumentError(
                f"encoders for axis {encoder.axis}: {chip.__name__} has no input for an encoder; {able} have. Or put a counter on "
                "the bus: board.attach_device(HCTL2016(encoder), port)."
            )
        if encoder.zero is not None:
            raise ArgumentError(
                f"{encoder!r}: zero= is for devices; the counter of {add_article(chip.__name__)} is 0 after a reset, and "
                "a host can set it."
            )
        chosen[encoder.axis] = encoder
    return tuple(chosen[name] for name in names if name in chosen)


def list_counts_per_unit(encoders: Iterable[Encoder], plant: Sequence[PlantAxis]) -> list[float]:
    """List for each axis the counts per unit of its joint; 0 for an axis whose chip counts no encoder.

    Args:
        encoders: Encoders that chips count.
        plant: Axes of the model.
    """
    of = {e.axis: e for e in encoders}
    return [of[p.name].compute_counts_per_unit(p.gear) if p.name in of else 0.0 for p in plant]


def _list_encoders(choice: EncoderChoice) -> list[Encoder]:
    """Convert the argument `encoders` of `Stage` to a list of encoders."""
    if choice is None:
        return []
    if isinstance(choice, Encoder):
        return [choice]
    if isinstance(choice, Mapping):
        for axis, counts in choice.items():
            if not _is_finite_and_nonzero(counts):
                raise ArgumentError(
                    f"encoders for axis {axis}: {counts!r}: a number of counts a metre is wanted, not 0, for example 200_000; "
                    f'below 0 it is mounted the other way round. On the motor: encoders=[Encoder("{axis}", per_turn=2000)].'
                )
        return [Encoder(axis, per_metre=float(counts)) for axis, counts in choice.items()]
    encoders = list(choice) if isinstance(choice, Iterable) and not isinstance(choice, str) else [choice]
    for encoder in encoders:
        if not isinstance(encoder, Encoder):
            raise ArgumentError(
                f'encoders={choice!r}: a mapping axis -> counts a metre, {{"x": 200_000}}, or Encoders, '
                '[Encoder("x", per_turn=2000)].'
            )
    return encoders


def _is_finite_and_nonzero(number: Any) -> bool:
    """Return whether a value is finite and not 0."""
    return not isinstance(number, bool) and _is_finite(number) and number != 0


def _is_finite(value: Any) -> bool:
    """Return whether a value is a finite number."""
    try:
        return math.isfinite(value)
    except (TypeError, OverflowError):
        return False
