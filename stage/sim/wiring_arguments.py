"""Checks of the arguments of `Stage` for wires that differ from the default.

These are sensors of positive logic, chips whose SYNI is connected to another chip's SYNO, and lines of multichip interpolation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stage.chips import Chip, ChipAxis
from stage.errors import ArgumentError, add_article, unknown_name_error
from stage.sim.plant import PlantAxis

WiringChoice = Mapping[str, Mapping[str, str]] | None
SENSOR_LOGICS = ("negative", "positive")
"""Low while it is on; high while it is on. The default is what the chip takes as asserted after a reset, see `Chip.LOGIC`."""


def choose_wiring(
    wiring: WiringChoice, plant: Sequence[PlantAxis], chip_axes: Sequence[ChipAxis]
) -> tuple[Mapping[str, str], ...]:
    """Return for each axis the sensors whose logic differs from the one that its chip expects, from the argument of `Stage`.

    Args:
        wiring: Argument `wiring` of `Stage`.
        plant: Axes of the model.
        chip_axes: For each axis of the stage, the axis of its chip.

    Raises:
        ArgumentError: An axis or a sensor does not exist, or a logic is neither "negative" nor "positive".
    """
    if wiring is not None and not isinstance(wiring, Mapping):
        raise _make_wiring_error(wiring)
    names = [p.name for p in plant]
    for name, sensors in (wiring or {}).items():
        if name not in names:
            raise unknown_name_error("axis", name, names)
        if not isinstance(sensors, Mapping):
            raise _make_wiring_error(wiring)
    return tuple(
        _choose_axis_wiring((wiring or {}).get(p.name, {}), p, type(axis.chip))
        for p, axis in zip(plant, chip_axes, strict=True)
    )


def _make_wiring_error(wiring: Any) -> ArgumentError:
    """Make the error for an argument `wiring` that has another form."""
    return ArgumentError(f'wiring={wiring!r}: a mapping axis -> sensor -> logic, {{"x": {{"org": "positive"}}}}.')


def _choose_axis_wiring(sensors: Mapping[str, str], plant: PlantAxis, chip: Any) -> Mapping[str, str]:
    """Return the sensors of one axis whose logic differs from the one that its chip expects."""
    fitted = [*(s.pin for s in plant.switches), "ez"]
    for sensor, logic in sensors.items():
        if sensor not in fitted:
            raise unknown_name_error(f"sensor of axis {plant.name}", sensor, fitted)
        if logic not in SENSOR_LOGICS:
            raise ArgumentError(
                f"wiring of {sensor} of axis {plant.name}: {logic!r} is no logic; it is {SENSOR_LOGICS[0]!r} (low "
                f"while the sensor is "
                f"on) or {SENSOR_LOGICS[1]!r} (high); the default is {chip.LOGIC!r}."
            )
        if not chip.find_switch_input(sensor):
            raise ArgumentError(
                f"wiring of {sensor} of axis {plant.name}: no pin of {add_article(chip.__name__)} is wired to it; leave it out."
            )
    turned = {sensor: logic for sensor, logic in sensors.items() if logic != chip.LOGIC}
    for sensor in turned:
        others = [s for s in fitted if chip.find_switch_input(s) == chip.find_switch_input(sensor) and s not in turned]
        if others:
            raise ArgumentError(
                f"wiring of {sensor} of axis {plant.name}: {', '.join(others)} is on the same pin of "
                f"{add_article(chip.__name__)}; give all "
                "of them one logic."
            )
    return turned


def choose_leaders(
    syni: Mapping[str, str] | None, names: Sequence[str], chip_axes: Sequence[ChipAxis]
) -> tuple[tuple[str, str], ...]:
    """Return the pairs (follower, leader) of axes whose chips share the leader's clock, from the argument of `Stage`.

    Args:
        syni: Argument `syni` of `Stage`.
        names: Names of the stage's axes.
        chip_axes: For each axis of the stage, the axis of its chip.

    Raises:
        ArgumentError: An axis does not exist, or two chips cannot share a clock.
    """
    if syni is not None and not isinstance(syni, Mapping):
        raise ArgumentError(f'syni={syni!r}: a mapping follower -> leader, {{"y": "x"}}.')
    chip_of = {name: axis.chip for name, axis in zip(names, chip_axes, strict=True)}
    wanted = dict(syni or {})
    for pair in wanted.items():
        for name in pair:
            if name not in chip_of:
                raise unknown_name_error("axis", name, names)
        if pair[1] in wanted:
            raise ArgumentError(
                f"syni: axis {pair[1]} leads {pair[0]}, and follows {wanted[pair[1]]}: connect all to one leader."
            )
        check_shared_clock(chip_of[pair[0]], chip_of[pair[1]], f"syni of axis {pair[0]}")
    return tuple(wanted.items())


def check_shared_clock(follower: Chip, leader: Chip, connection: str) -> None:
    """Check that two chips can share a clock by SYNO and SYNI.

    Args:
        follower: Chip whose SYNI is connected.
        leader: Chip whose SYNO is connected to that SYNI.
        connection: Description of the connection, with which the error begins.

    Raises:
        ArgumentError: The chips cannot share a clock.
    """
    for chip in (follower, leader):
        if not chip.SYNCHRO:
            raise ArgumentError(
                f"{connection}: {add_article(type(chip).__name__)} has no SYNI and SYNO; chips of the PCL-240 family have."
            )
    if follower is leader:
        raise ArgumentError(f"{connection}: a chip does not follow itself.")
    if follower.clock_hz != leader.clock_hz:
        raise ArgumentError(
            f"{connection}: its reference clock is {follower.clock_hz:,} Hz, the leader's {leader.clock_hz:,} Hz; "
            "give both the same."
        )


def choose_linked_axes(
    multichip: Sequence[str] | None, names: Sequence[str], chip_axes: Sequence[ChipAxis]
) -> tuple[tuple[str, ...], tuple[Chip, ...]]:
    """Return the axes whose chips are wired to each other for multichip interpolation, from the argument of `Stage`, and the chips.

    Args:
        multichip: Argument `multichip` of `Stage`.
        names: Names of the stage's axes.
        chip_axes: For each axis of the stage, the axis of its chip.

    Raises:
        ArgumentError: An axis does not exist, or its chip has no such lines.
    """
    if multichip is None:
        return (), ()
    if isinstance(multichip, str | Mapping) or not isinstance(multichip, Sequence):
        raise ArgumentError(f'multichip={multichip!r}: an axis of each chip that the lines join, ["x", "u"].')
    chip_of = {name: axis.chip for name, axis in zip(names, chip_axes, strict=True)}
    for name in multichip:
        if name not in chip_of:
            raise unknown_name_error("axis", name, names)
    chips = tuple(dict.fromkeys(chip_of[name] for name in multichip))
    for name, chip in zip(multichip, (chip_of[name] for name in multichip), strict=True):
        if not chip.MULTICHIP:
            raise ArgumentError(
                f"multichip of axis {name}: {add_article(type(chip).__name__)} has no lines of multichip interpolation; an MCX514 "
                "and an MCX512 have."
            )
        if chip.clock_hz != chips[0].clock_hz or chip.clock != chips[0].clock:
            raise ArgumentError(
                f"multichip of axis {name}: its clock is at {chip.clock:,} of {chip.clock_hz:,} Hz, that of axis {multichip[0]} at "
                f"{chips[0].clock:,} of {chips[0].clock_hz:,} Hz; join fresh chips of one clock."
            )
    if len(chips) < 2:
        on = [
            f"{', '.join(n for n in names if chip_of[n] is c)} on one {type(c).__name__}"
            for c in dict.fromkeys(chip_of.values())
        ]
        raise ArgumentError(
            f"multichip={list(multichip)}: these axes are on one chip, which needs no lines; give axes of two chips or more. Here "
            f"are {'; '.join(on)}: axes share a chip of one kind as long as it has some left, so give a kind of fewer "
            "axes, or another."
        )
    return tuple(multichip), chips


@dataclass(frozen=True)
class Wires:
    """Wires of a stage that differ from the default.

    Attributes:
        inverted: For each axis the sensors whose logic is the opposite of the one that its chip expects.
        leaders: Follower chip -> its leader, whose SYNO is connected to SYNI of the follower.
        linked: Chips that are wired to each other for multichip interpolation.
    """

    inverted: Sequence[Mapping[str, str]]
    leaders: Mapping[Chip, Chip]
    linked: Sequence[Chip]

    def find_inverted_pins(self, axis: int, chip: Chip) -> int:
        """Return the mask of a chip's input pins to which sensors of the opposite logic are wired.

        Args:
            axis: Index of the axis.
            chip: Chip of the axis.
        """
        word = 0
        for sensor in self.inverted[axis]:
            word |= chip.find_switch_input(sensor)
        return word
