"""Assertions about a stage, an axis or a board, for tests of firmware.

A message gives the expected and the actual value, and where to look next.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from stage.chips.write_diagnostics import BUS_WRITE, summarize_diagnostics
from stage.errors import ArgumentError
from stage.support.argument_checks import explain_arguments
from stage.units import DEVIATION_UNITS, POSITION_UNITS, format_lost_steps

if TYPE_CHECKING:
    from stage.board import Board
    from stage.sim.stage import Axis, Stage

MAX_LISTED_LINES = 20  # lines of a list
MAX_STILL_SPEED_M_S = 0.01  # m/s, rad/s: a motor that swings about its step is slower


@explain_arguments
def assert_no_lost_steps(what: Stage | Axis | Iterable[Axis]) -> None:
    """Assert that no axis has lost steps: every rotor is within a full step of the position that its pulses command.

    The assertion fails as well if STEP/DIR lines of an axis are at the wrong pins of its firmware, see `Host.wiring_problems`.

    Args:
        what: A stage, an axis, or several axes.
    """
    __tracebackhide__ = True
    check_wiring(list_axes(what))
    bad = [axis for axis in list_axes(what) if axis.lost_steps]
    if bad:
        lines = [f"steps were lost, at {bad[0].time:.6f} s:"]
        for axis in bad:
            lines.append(
                f"  {axis.name} is {abs(axis.lost_steps)} full steps {'behind' if axis.lost_steps > 0 else 'ahead of'} its pulses: "
                f"commanded {format_position(axis.commanded, axis.unit)}, is at {format_position(axis.position, axis.unit)}"
                + describe_missing_current(axis)
            )
        lines.append(
            "The motor could not follow, or a hard stop was in the way. Look where x/lost_steps leaves 0 in the recording, and at "
            "x/rate and x/load_angle before: a lower rate, a longer ramp or more current helps.".replace(
                "x/", f"{bad[0].name}/"
            )
        )
        raise AssertionError("\n".join(lines))


@explain_arguments
def assert_at(axis: Axis, position: float, within: float = 25e-6) -> None:
    """Assert that the carriage is at `position`. The assertion uses the true position, not that of a counter.

    Args:
        axis: Axis of a stage.
        position: Expected position, m (rad on a hinge).
        within: Allowed deviation, m (rad); the default is half a full step of the shipped stages.
    """
    __tracebackhide__ = True
    if not within >= 0:
        raise ArgumentError(f"within={within!r}: 0 m or more.")
    check_wiring([axis])
    at, unit = axis.position, axis.unit
    if not abs(at - position) <= within:
        side = "short of" if abs(at) < abs(position) else "beyond"
        lines = [
            f"{axis.name} is not where it was expected, at {axis.time:.6f} s:",
            f"  expected  {format_position(position, unit)} +- {format_deviation(within, unit)}",
            f"  is at     {format_position(at, unit)}: {format_deviation(at - position, unit, sign=True)}, {side} it",
            f"  commanded {format_position(axis.commanded, unit)} by its pulses, "
            f"{format_lost_steps(axis.lost_steps, axis.lost_pulses)}",
        ]
        if read_pulse_rate(axis):
            lines.append(
                f"It still moves, {read_pulse_rate(axis):+,.0f} pulses a second: did the test wait for the end of the move?"
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


@explain_arguments
def assert_stopped(what: Stage | Axis | Iterable[Axis], speed: float = MAX_STILL_SPEED_M_S) -> None:
    """Assert that no axis gets pulses and none moves, for example after a limit switch has tripped.

    Args:
        what: A stage, an axis, or several axes.
        speed: Speed below which an axis stands still, m/s (rad/s on a hinge).
    """
    __tracebackhide__ = True
    check_wiring(list_axes(what))
    lines = []
    for axis in list_axes(what):
        rate, velocity = read_pulse_rate(axis), read_velocity(axis)
        if rate or abs(velocity) > speed:
            on = [name for name, asserted in axis.switches.as_dict().items() if asserted]
            lines.append(
                f"  {axis.name} gets {rate:+,.0f} pulses a second and moves at {velocity * 1e3:+.3f} m{axis.unit}/s, at "
                f"{format_position(axis.position, axis.unit)}; switches asserted: {', '.join(on) or 'none'}"
            )
    if lines:
        time = next(iter(list_axes(what))).time
        raise AssertionError(
            "\n".join([f"expected to stand still at {time:.6f} s:", *lines, "Look at the last bus cycles before that."])
        )


@explain_arguments
def assert_pins(axis: Axis, **expected: bool) -> None:
    """Assert that pins of an axis are asserted or not, whatever their polarity: `assert_pins(x, org=True, irq=False)`.

    Args:
        axis: Axis of a stage.
        expected: Pins of its axis of the chip by name, True for asserted.
    """
    __tracebackhide__ = True
    levels = {name: bool(getattr(axis.pins, name)) for name in expected}
    wrong = [name for name in expected if levels[name] != bool(expected[name])]
    if wrong:
        words = {True: "asserted", False: "not asserted"}
        raise AssertionError(
            f"pins of {axis.name} ({type(axis.chip).__name__}) at {axis.time:.6f} s:\n"
            + "\n".join(f"  {name} is {words[levels[name]]}, expected {words[not levels[name]]}" for name in wrong)
            + f"\n{axis.name} is at {format_position(axis.position, axis.unit)}; asserted are: "
            + (", ".join(name for name, on in axis.pins.as_dict().items() if on) or "none")
        )


@explain_arguments
def assert_no_diagnostics(stage: Stage) -> None:
    """Assert that no bus write, and no edge of a STEP/DIR line, was a mistake according to the data sheet.

    A real chip ignores such mistakes silently.

    The assertion fails as well if STEP/DIR lines are at the wrong pins of the firmware, see `Host.wiring_problems`.
    """
    __tracebackhide__ = True
    check_wiring(list_axes(stage))
    mistakes = []
    for chip in stage.chips:
        names = "".join(axis.name for axis in stage.axes.values() if axis.chip is chip)
        digits = 4 if chip.DATA_MASK > 0xFF else 2
        for d in chip.diagnostics:
            cause = chip.find_cause_of(d)
            cycle = f"address {d.address} W {d.value:0{digits}X}h  " if cause.kind == BUS_WRITE else ""
            times = f", {cause.times:,} times" if cause.times > 1 else ""
            mistakes.append((d.clock / chip.clock_hz, f"{names}: {cycle}{d.message} ({d.source}){times}"))
    if mistakes:
        raise AssertionError(
            format_list(
                f"{summarize_diagnostics(stage.chips)} that a reader of the data sheet would call a mistake:",
                [f"  {seconds:.9f} s  {text}" for seconds, text in sorted(mistakes)],
                "The bus trace shows what came before each.",
            )
        )


@explain_arguments
def assert_no_strays(board: Board) -> None:
    """Assert that every bus cycle in the board's trace reached a chip."""
    __tracebackhide__ = True
    strays = board.strays
    if strays:
        ports, n = sorted(board.ports), sum(c.times for c in strays)
        raise AssertionError(
            format_list(
                f"{n:,} bus cycle{'s' * (n > 1)} reached no chip, or half of a register only:",
                [f"  {cycle}" for cycle in strays],
                f"Chips are at {', '.join(format_ranges(ports))}: {board!r}. Wrong base or stride in the firmware, or in "
                "@pytest.mark.board?",
            )
        )


# --- what the messages are made of ---


def list_axes(what: Any) -> list[Axis]:
    """List the axes of a stage, an axis, or several axes."""
    axes = getattr(what, "axes", what)
    if hasattr(axes, "values"):
        return list(axes.values())
    if hasattr(axes, "pins"):
        return [axes]
    try:
        axes_found = list(axes)
    except TypeError:
        axes_found = [axes]
    for axis in axes_found:
        if not hasattr(axis, "lost_steps"):
            raise ArgumentError(f"{axis!r} is no axis: give a stage, stage.axes['x'], or several axes.")
    return axes_found


def check_wiring(axes: Iterable[Axis]) -> None:
    """Assert that firmware on the board of the axes has their STEP/DIR lines at the right pins."""
    __tracebackhide__ = True
    axes = list(axes)
    stage = axes[0].stage if axes else None
    host = stage.host.board.driver if stage is not None and stage.host is not None else None
    names = {"", *(axis.name for axis in axes)}
    texts = [f.text for f in getattr(host, "wiring_findings", ()) if f.is_problem and f.axis in names]
    if texts:
        raise AssertionError(
            "\n".join(["the axes are not wired as the firmware drives them:", *(f"  {t}" for t in texts)])
        )


def read_pulse_rate(axis: Axis) -> float:
    """Return the present pulse rate, pps (counts a second for a servo), signed."""
    chip = axis.chip
    return float(chip.CORE.read_pulse_rate.c(chip.pointer, axis.chip_axis, float(chip.clock_hz)))


def read_velocity(axis: Axis) -> float:
    """Return the velocity, m/s (rad/s on a hinge)."""
    return float(axis.stage.data.qvel[axis.plant.dof])


def describe_missing_current(axis: Axis) -> str:
    """Explain, as the end of a sentence, why the motor of an axis has no current; "" if it has current."""
    why = axis.chip.explain_missing_current(axis.chip_axis)
    return f"; {why}" if why else ""


def format_position(value: float, unit: str) -> str:
    """Format a position with its unit."""
    return POSITION_UNITS[unit].format(value)


def format_deviation(value: float, unit: str, sign: bool = False) -> str:
    """Format a deviation with its unit."""
    return DEVIATION_UNITS[unit].format(value, f"{'+' if sign else ''},.1f")


def format_list(head: str, lines: list[str], tail: str) -> str:
    """Format a message with the first lines of a list."""
    more = [f"  ... and {len(lines) - MAX_LISTED_LINES:,} more"] if len(lines) > MAX_LISTED_LINES else []
    return "\n".join([head, *lines[:MAX_LISTED_LINES], *more, tail])


def format_ranges(ports: list[int]) -> list[str]:
    """Format runs of neighboring ports."""
    firsts = [p for p in ports if p - 1 not in ports]
    lasts = [p for p in ports if p + 1 not in ports]
    return [f"{a:03X}h to {b:03X}h" if a != b else f"{a:03X}h" for a, b in zip(firsts, lasts, strict=True)]
