"""Assertions about a stage, an axis or a board, for tests of firmware. A message gives the expected and the actual value and where
to look next."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from stage.errors import ArgumentError
from stage.support.arguments import told
from stage.units import PLACES, SMALL

if TYPE_CHECKING:
    from stage.board import Board
    from stage.sim.stage import Axis, Stage

SHOWN = 20  # lines of a list
STILL = 0.01  # m/s, rad/s: a motor that swings about its step is slower


@told
def assert_no_lost_steps(what: Stage | Axis | Iterable[Axis]) -> None:
    """The rotor of every axis is where its pulses say, to the full step. what: a stage, an axis, or several axes."""
    __tracebackhide__ = True
    bad = [axis for axis in axes_of(what) if axis.lost_steps]
    if bad:
        lines = [f"steps were lost, at {bad[0].time:.6f} s:"]
        for axis in bad:
            lines.append(
                f"  {axis.name} is {abs(axis.lost_steps)} full steps {'behind' if axis.lost_steps > 0 else 'ahead of'} its pulses: "
                f"commanded {distance(axis.commanded, axis.unit)}, is at {distance(axis.position, axis.unit)}"
                + without_current(axis)
            )
        lines.append(
            "The motor could not follow, or a hard stop was in the way. Look where x/lost_steps leaves 0 in the recording, and at "
            "x/rate and x/load_angle before: a lower rate, a longer ramp or more current helps.".replace(
                "x/", f"{bad[0].name}/"
            )
        )
        raise AssertionError("\n".join(lines))


@told
def assert_at(axis: Axis, position: float, within: float = 25e-6) -> None:
    """The carriage is at `position`, give or take `within`: metres (rad on a hinge), from the truth and not from any counter.

    The default is half a full step of the shipped stages.
    """
    __tracebackhide__ = True
    if not within >= 0:
        raise ArgumentError(f"within={within!r}: 0 m or more.")
    at, unit = axis.position, axis.unit
    if not abs(at - position) <= within:
        side = "short of" if abs(at) < abs(position) else "beyond"
        lines = [
            f"{axis.name} is not where it was expected, at {axis.time:.6f} s:",
            f"  expected  {distance(position, unit)} +- {fine(within, unit)}",
            f"  is at     {distance(at, unit)}: {fine(at - position, unit, sign=True)}, {side} it",
            f"  commanded {distance(axis.commanded, unit)} by its pulses, {axis.lost_steps} full steps lost",
        ]
        if pulse_rate(axis):
            lines.append(
                f"It still moves, {pulse_rate(axis):+,.0f} pulses a second: did the test wait for the end of the move?"
            )
        elif axis.lost_steps:
            lines.append("The motor lost its steps: see assert_no_lost_steps.")
        elif abs(axis.commanded - position) > within:
            lines.append(
                "The motor is where its pulses say: the firmware sent the wrong number of them, or homed elsewhere."
            )
        else:
            lines.append(
                "The pulses are right and the carriage is not there yet: it still swings, or a load holds it off."
            )
        raise AssertionError("\n".join(lines))


@told
def assert_stopped(what: Stage | Axis | Iterable[Axis], speed: float = STILL) -> None:
    """No axis gets pulses, and none is faster than `speed` (m/s; rad/s on a hinge). For what happens after a limit switch."""
    __tracebackhide__ = True
    lines = []
    for axis in axes_of(what):
        rate, velocity = pulse_rate(axis), velocity_of(axis)
        if rate or abs(velocity) > speed:
            on = [name for name, asserted in axis.switches.as_dict().items() if asserted]
            lines.append(
                f"  {axis.name} gets {rate:+,.0f} pulses a second and moves at {velocity * 1e3:+.3f} m{axis.unit}/s, at "
                f"{distance(axis.position, axis.unit)}; switches asserted: {', '.join(on) or 'none'}"
            )
    if lines:
        time = next(iter(axes_of(what))).time
        raise AssertionError(
            "\n".join([f"expected to stand still at {time:.6f} s:", *lines, "Look at the last bus cycles before that."])
        )


@told
def assert_pins(axis: Axis, **expected: bool) -> None:
    """Pins of an axis of its chip are asserted or not, whatever their polarity: `assert_pins(x, org=True, irq=False)`."""
    __tracebackhide__ = True
    found = {name: bool(getattr(axis.pins, name)) for name in expected}
    wrong = [name for name in expected if found[name] != bool(expected[name])]
    if wrong:
        words = {True: "asserted", False: "not asserted"}
        raise AssertionError(
            f"pins of {axis.name} ({type(axis.chip).__name__}) at {axis.time:.6f} s:\n"
            + "\n".join(f"  {name} is {words[found[name]]}, expected {words[not found[name]]}" for name in wrong)
            + f"\n{axis.name} is at {distance(axis.position, axis.unit)}; asserted are: "
            + (", ".join(name for name, on in axis.pins.as_dict().items() if on) or "none")
        )


@told
def assert_no_diagnostics(stage: Stage) -> None:
    """No bus write that a data-sheet reader would call a mistake: what silicon swallows in silence."""
    __tracebackhide__ = True
    found = []
    for chip in stage.chips:
        names = "".join(axis.name for axis in stage.axes.values() if axis.chip is chip)
        digits = 4 if chip.DATA_MASK > 0xFF else 2
        for d in chip.diagnostics:
            found.append(
                (
                    d.clock / chip.clock_hz,
                    f"{names}: address {d.address} W {d.value:0{digits}X}h  {d.message} ({d.source})",
                )
            )
    if found:
        raise AssertionError(
            listed(
                f"{len(found)} bus write{'s' * (len(found) > 1)} that a reader of the data sheet would call a mistake:",
                [f"  {seconds:.9f} s  {text}" for seconds, text in sorted(found)],
                "The bus trace shows what came before each.",
            )
        )


@told
def assert_no_strays(board: Board) -> None:
    """Every bus cycle that the board's trace keeps reached a chip."""
    __tracebackhide__ = True
    strays = board.strays
    if strays:
        ports, n = sorted(board.ports), sum(c.times for c in strays)
        raise AssertionError(
            listed(
                f"{n:,} bus cycle{'s' * (n > 1)} reached no chip, or half of a register only:",
                [f"  {cycle}" for cycle in strays],
                f"Chips are at {', '.join(ranges(ports))}: {board!r}. Wrong base or stride in the firmware, or in "
                "@pytest.mark.board?",
            )
        )


# --- what the messages are made of ---


def axes_of(what: Any) -> list[Axis]:
    """The axes of a stage, an axis, or several."""
    axes = getattr(what, "axes", what)
    if hasattr(axes, "values"):
        return list(axes.values())
    if hasattr(axes, "pins"):
        return [axes]
    try:
        found = list(axes)
    except TypeError:
        found = [axes]
    for axis in found:
        if not hasattr(axis, "lost_steps"):
            raise ArgumentError(f"{axis!r} is no axis: give a stage, stage.axes['x'], or several axes.")
    return found


def pulse_rate(axis: Axis) -> float:
    """Pulses a second now (counts of a servo), signed."""
    chip = axis.chip
    return float(chip.CORE.pulse_rate.c(chip.pointer, axis.chip_axis, float(chip.clock_hz)))


def velocity_of(axis: Axis) -> float:
    """m/s, rad/s on a hinge."""
    return float(axis.stage.data.qvel[axis.plant.dof])


def without_current(axis: Axis) -> str:
    """Say why its motor has no current, as the end of a sentence; "" while it has."""
    why = axis.chip.explain_missing_current(axis.chip_axis)
    return f"; {why}" if why else ""


def distance(value: float, unit: str) -> str:
    """A position, in words."""
    return PLACES[unit].text(value)


def fine(value: float, unit: str, sign: bool = False) -> str:
    """A deviation, in words."""
    return SMALL[unit].text(value, f"{'+' if sign else ''},.1f")


def listed(head: str, lines: list[str], tail: str) -> str:
    """A message with the first lines of a list."""
    more = [f"  ... and {len(lines) - SHOWN:,} more"] if len(lines) > SHOWN else []
    return "\n".join([head, *lines[:SHOWN], *more, tail])


def ranges(ports: list[int]) -> list[str]:
    """Runs of neighbouring ports."""
    firsts = [p for p in ports if p - 1 not in ports]
    lasts = [p for p in ports if p + 1 not in ports]
    return [f"{a:03X}h to {b:03X}h" if a != b else f"{a:03X}h" for a, b in zip(firsts, lasts, strict=True)]
