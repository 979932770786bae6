"""`replay_capture`: play the edges of a logic analyzer's capture of a real controller into STEP/DIR axes of a stage.

machine = Stage("xyz", chips="stepdir", drives="drv8825")
report = replay_capture(machine, "capture.vcd", "x.step=D2,x.dir=D5")
print(report)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage.board.pin_assignment import DRIVEN_LINE_PINS, PRESETS, UART_LINE, PinLine, parse_pins
from stage.errors import ArgumentError
from stage.firmware.axis import check_seconds
from stage.recording.vcd_reader import Capture, CaptureError, read_capture
from stage.sim.pin_edge_player import PIN_EDGE, PinEdgeObservation, play_pin_edges
from stage.support.argument_checks import explain_arguments
from stage.units import DEVIATION_UNITS, POSITION_UNITS, format_lost_steps

if TYPE_CHECKING:
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

REST_S = 0.1
"""Simulated time after the end of a capture in which the carriages come to rest, s."""
MAX_DURATION_S = 86_400
"""Longest capture that is played, s."""
LISTED_EDGES = 10


class SwitchEdge(NamedTuple):
    """Edge of a limit or origin switch of the stage.

    Attributes:
        time: Time since the begin of the capture, s.
        switch: Name of the pin: el_plus, el_minus, org.
        on: Whether the switch is asserted from then on.
    """

    time: float
    switch: str
    on: bool


class SwitchComparison(NamedTuple):
    """Times of a switch line in the capture, compared with those of the stage's switch.

    Attributes:
        line: Name of the line, such as limit_plus.
        signal: Signal of the capture.
        captured: Times at which the line was asserted in the capture, s.
        simulated: Times at which it was asserted on the stage, s.
    """

    line: str
    signal: str
    captured: tuple[float, ...]
    simulated: tuple[float, ...]


@dataclass(frozen=True)
class AxisReplay:
    """Report of the replay of a capture on one axis.

    Attributes:
        axis: Name of the axis.
        unit: "m", or "rad" on a hinge.
        edges: Number of rising edges of STEP in the capture.
        accepted: Number of steps that the power stage accepted.
        disabled: Number of steps that came while ENABLE was not asserted.
        start: Position of the carriage before the replay, m (rad on a hinge).
        position: Position of the carriage afterwards, m (rad).
        commanded: Position according to the accepted steps, m (rad).
        lost_steps: Full steps lost.
        largest_error: Largest following error, m (rad).
        error_time: Time of the largest following error since the begin of the capture, s.
        switch_edges: Edges of the switches.
        comparisons: Comparisons of the capture's switch lines with the stage's switches.
        violations: Messages about times between edges that were too short for the power stage, each with its number of cases.
        has_direction: Whether `pins` names a DIR line of the axis; without one, all steps count as plus.
        lost_pulses: Lost steps in pulses.
    """

    axis: str
    unit: str
    edges: int
    accepted: int
    disabled: int
    start: float
    position: float
    commanded: float
    lost_steps: int
    largest_error: float
    error_time: float
    switch_edges: tuple[SwitchEdge, ...]
    comparisons: tuple[SwitchComparison, ...]
    violations: tuple[tuple[str, int], ...]
    has_direction: bool = True
    lost_pulses: int = 0

    @property
    def ok(self) -> bool:
        """True if the axis accepted all rising edges of its STEP in the capture, and lost no step."""
        return self.accepted == self.edges and not self.lost_steps

    def __str__(self) -> str:
        unit, deviation = POSITION_UNITS[self.unit], DEVIATION_UNITS[self.unit]
        lines = [
            f"{self.axis}: {self.accepted:,} of {self.edges:,} steps accepted, "
            f"{format_lost_steps(self.lost_steps, self.lost_pulses)}",
            f"  from {unit.format(self.start)} to {unit.format(self.position)}, commanded {unit.format(self.commanded)}",
            f"  largest following error {deviation.format(self.largest_error, '.1f')} at {self.error_time:.6f} s",
        ]
        if self.edges and not self.has_direction:
            lines.append(f"  all steps count as plus: --pins names no DIR signal, such as {self.axis}.dir=D5")
        if self.disabled:
            lines.append(
                f"  {self.disabled:,} steps came while ENABLE was not asserted, and the motor had no current: check the signal of "
                f"{self.axis}.enable in --pins, and whether it needs a !"
            )
        for edge in self.switch_edges[:LISTED_EDGES]:
            lines.append(f"  {edge.time:.6f} s: {edge.switch} {'on' if edge.on else 'off'}")
        if (more := len(self.switch_edges) - LISTED_EDGES) > 0:
            lines.append(f"  and {more} more edges of switches")
        for c in self.comparisons:
            lines.append(
                f"  {c.line}: {_describe_times(c.captured)} in the capture ({c.signal}), {_describe_times(c.simulated)} on the "
                "stage"
            )
        lines += [f"  {message} ({times} times)" for message, times in self.violations]
        return "\n".join(lines)


def _describe_times(times: Sequence[float]) -> str:
    """Return in words how many times there are, and the first of them in s."""
    if not times:
        return "never asserted"
    often = "once," if len(times) == 1 else f"{len(times)} times, first"
    return f"asserted {often} at {times[0]:.6f} s,"


@dataclass(frozen=True)
class ReplayReport:
    """Report of the replay of a capture on all axes of a stage.

    Attributes:
        path: The file.
        duration: Time from the begin to the end of the capture, s.
        axes: Report of each axis that has a line.
        absent: Lines of a board's wiring, such as y.step=D3, that were left out: the capture lacks them, or STEP of their axis.
    """

    path: str
    duration: float
    axes: tuple[AxisReplay, ...]
    absent: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """True if the capture has steps, every axis accepted all of its own, and no step was lost."""
        return self.has_steps and all(axis.ok for axis in self.axes)

    @property
    def has_steps(self) -> bool:
        """True if a STEP line changes in the capture."""
        return any(axis.edges for axis in self.axes)

    def __str__(self) -> str:
        lines = [f"{self.path}: {self.duration:.6f} s", *map(str, self.axes)]
        if self.absent:
            lines.append(f"left out, as the capture lacks them or STEP of their axis: {', '.join(self.absent)}")
        if not self.has_steps:
            lines.append("No STEP line of --pins changes in the capture. Name the signals that do.")
        return "\n".join(lines)

    def json(self) -> dict[str, Any]:
        """Return everything as numbers and texts, as `--json` prints it: s, m (rad)."""
        axes = [vars(axis) | {"ok": axis.ok} for axis in self.axes]
        return {"path": self.path, "duration": self.duration, "ok": self.ok, "axes": axes, "absent": self.absent}


class _LineChanges(NamedTuple):
    """Changes of a line of an axis in the capture.

    Attributes:
        line: The line.
        times: Times since the begin of the capture, ns.
        asserted: Whether the line is asserted from each time on.
    """

    line: PinLine
    times: np.ndarray
    asserted: np.ndarray

    def find_rising_edges(self) -> np.ndarray:
        """Return the times at which the line became asserted; a level at the begin is no edge."""
        before = np.concatenate([[self.asserted[0] if len(self.times) and not self.times[0] else False], self.asserted])
        return self.times[self.asserted & ~before[:-1]]


@explain_arguments
def replay_capture(stage: Stage, path: str | PathLike, pins: str | Iterable[str], rest: float = REST_S) -> ReplayReport:
    """Play the STEP, DIR and ENABLE edges of a capture into a stage, each at its nanosecond, to which times are rounded.

    The levels at the begin of the capture are no edges. A signal that is unknown (x, z) keeps its level.

    Args:
        stage: Stage with STEP/DIR axes.
        path: Capture, a VCD file.
        pins: Which signal is which line, see stage.board.pin_assignment: x.step=D2,x.dir=D5,x.enable=!D8. Lines that a controller
            reads are compared with the switches of the stage.
        rest: Simulated time after the end of the capture, s.

    Raises:
        CaptureError: The file is no capture, has no edges, or not the signals that `pins` names.
        ArgumentError: `pins` names no STEP line, or a line or axis that the stage does not have.
    """
    check_seconds(rest)
    texts = [pins] if isinstance(pins, str) else list(pins)
    lines = parse_pins(texts, {name: axis.chip for name, axis in stage.axes.items()})
    if uart := next((line for line in lines if line.line == UART_LINE), None):
        raise ArgumentError(f"--pins {uart}: a capture has signals, no serial lines. Leave it out.")
    if not any(line.line == "step" for line in lines):
        raise ArgumentError("--pins names no STEP line, so nothing would move: write x.step=D2,x.dir=D5.")
    capture = read_capture(path)
    absent = _find_absent_lines(capture, lines, texts)
    lines = tuple(line for line in lines if line not in absent)
    changes, duration_ns = _decode_lines(capture, lines)
    edges = _make_edges(stage, [c for c in changes if c.line.line in DRIVEN_LINE_PINS])
    begin = stage.now
    axes = [stage.axes[name] for name in dict.fromkeys(line.axis for line in lines)]
    before = [
        (a.position, a.lost_steps, a.lost_pulses, int(a.chip.state["accepted"]), a.chip.state["violations"].copy())
        for a in axes
    ]
    inputs = [axis.chip.input_word(axis.chip_axis) for axis in axes]
    observation = play_pin_edges(stage, edges, begin + duration_ns + round(rest * 1e9))
    reports = tuple(
        _report_axis(axis, [c for c in changes if c.line.axis == axis.name], observation, begin, word, *values)
        for axis, word, values in zip(axes, inputs, before, strict=True)
    )
    return ReplayReport(str(path), duration_ns * 1e-9, reports, tuple(map(str, absent)))


def _find_absent_lines(capture: Capture, lines: Sequence[PinLine], texts: Sequence[str]) -> list[PinLine]:
    """Return the lines of a board's wiring to leave out: the capture lacks them, or STEP of their axis.

    If it has no STEP line at all, or has STEP of an axis without DIR, no line is left out, and the missing signal is an error.
    """
    boards = [PRESETS.get(name.strip(), "") for text in texts for name in text.split(",")]
    wiring = {entry for board in boards for entry in board.split(",")}
    missing = [line for line in lines if not capture.has_signal(line.pin)]
    steps = {line.axis for line in lines if line.line == "step" and line not in missing}
    if not steps:
        return []
    return [
        line
        for line in lines
        if str(line) in wiring and (line.axis not in steps or (line in missing and line.line != "dir"))
    ]


def _decode_lines(capture: Capture, lines: Sequence[PinLine]) -> tuple[list[_LineChanges], int]:
    """Return the changes of each line, and the duration of the capture, ns."""
    signals = [capture.find_bit(line.pin) for line in lines]
    names = {signal: line.pin for signal, line in zip(signals, lines, strict=True)}
    for signal, line in zip(signals, lines, strict=True):
        if names[signal] != line.pin:
            raise CaptureError(
                f"{capture.path}: {line.pin} and {names[signal]} are the same signal. Give each line a signal of its own."
            )
    decoded = capture.decode(list(names.values()))
    if not len(decoded.edges):
        raise CaptureError(
            f"{capture.path} is empty: it has no level of {', '.join(names.values())}. Capture while the machine moves."
        )
    duration = (decoded.end - decoded.begin) * capture.unit_ns
    if duration > MAX_DURATION_S * 10**9:
        raise CaptureError(
            f"{capture.path} lasts {float(duration) * 1e-9:,.0f} s, from #{decoded.begin} to #{decoded.end}, and at most "
            f"{MAX_DURATION_S:,} s can be replayed. Cut it, or correct a damaged time."
        )
    line_changes, index = [], {signal: k for k, signal in enumerate(names)}
    for signal, line in zip(signals, lines, strict=True):
        rows = decoded.edges[decoded.edges["signal"] == index[signal]]
        times = _round_to_ns(rows["time"] - decoded.begin, capture.unit_ns)
        line_changes.append(_LineChanges(line, times, rows["level"] != line.inverted))
    return line_changes, int(_round_to_ns(decoded.end - decoded.begin, capture.unit_ns))


def _round_to_ns(times: Any, unit_ns: Fraction) -> Any:
    """Convert times in units of a capture to the nearest ns."""
    n, d = unit_ns.numerator, unit_ns.denominator
    return times // d * n + (times % d * n + d // 2) // d


def _make_edges(stage: Stage, changes: Sequence[_LineChanges]) -> np.ndarray:
    """Return PIN_EDGE records of the driven lines in the order of time. At equal times STEP comes last."""
    parts, is_step = [], []
    for line, times, asserted in changes:
        axis = stage.axes[line.axis]
        step = line.line == "step"
        played = ~asserted | (times > 0) if step else np.ones(len(times), bool)  # STEP high at the begin is no edge
        part = np.zeros(int(played.sum()), PIN_EDGE)
        mask = line.get_mask(axis.chip)
        part["time"], part["axis"], part["pins"] = times[played] + stage.now, axis.index, mask
        part["levels"] = np.where(asserted[played], mask, 0)
        parts.append(part)
        is_step.append(np.full(len(part), step))
    edges, last = np.concatenate(parts), np.concatenate(is_step)
    return edges[np.lexsort((last, edges["time"]))]


def _report_axis(
    axis: Axis, changes: Sequence[_LineChanges], observation: PinEdgeObservation, begin: int, inputs: int, *before: Any
) -> AxisReplay:
    """Return the report of one axis about the replay of a capture.

    Args:
        axis: The axis.
        changes: Changes of its lines.
        observation: Observations of the stage.
        begin: Time at which the capture began, ns.
        inputs: Input pins of the axis at that time.
        *before: Position, lost steps, lost pulses, accepted steps and violations at that time.
    """
    start, lost_steps, lost_pulses, accepted, violations = before
    state = axis.chip.state
    steps = np.concatenate([np.zeros(0, np.int64), *(c.find_rising_edges() for c in changes if c.line.line == "step")])
    was_enabled = bool(inputs & axis.chip.INPUTS["enable"])
    rows = observation.switch_edges[observation.switch_edges["axis"] == axis.index]
    words, times = np.concatenate([[inputs], rows["inputs"]]), (rows["time"] - begin) * 1e-9
    return AxisReplay(
        axis.name, axis.unit, len(steps), int(state["accepted"]) - accepted, _count_disabled(steps, changes, was_enabled), start,
        axis.position, axis.commanded,
        axis.lost_steps - lost_steps, float(observation.largest_errors[axis.index]),
        (int(observation.error_times[axis.index]) - begin) * 1e-9, tuple(_list_switch_edges(axis, words, times)),
        tuple(_compare_switch(axis, c, words, times) for c in changes if c.line.line not in DRIVEN_LINE_PINS),
        tuple(_count_violations(axis, state["violations"] - violations)),
        any(c.line.line == "dir" for c in changes), axis.lost_pulses - lost_pulses,
    )  # fmt: skip


def _count_disabled(steps: np.ndarray, changes: Sequence[_LineChanges], was_enabled: bool) -> int:
    """Count the steps of a capture that come while ENABLE is not asserted.

    A change of ENABLE at the time of a step counts as earlier.

    Args:
        steps: Times of rising edges of STEP since the begin of the capture, ns.
        changes: Changes of the lines of the axis.
        was_enabled: Whether ENABLE was asserted before.
    """
    enabled = np.full(len(steps), was_enabled)
    for change in changes:
        if change.line.line == "enable":
            levels = np.concatenate([[was_enabled], change.asserted])
            enabled = levels[np.searchsorted(change.times, steps, side="right")]
    return int((~enabled).sum())


def _list_switch_edges(axis: Axis, words: np.ndarray, times: np.ndarray) -> Iterable[SwitchEdge]:
    """Yield the edges of all switches of an axis.

    Args:
        axis: The axis.
        words: Its input pins at the begin and after each edge.
        times: Times of the edges since the begin, s.
    """
    for time, before, word in zip(times.tolist(), words[:-1].tolist(), words[1:].tolist(), strict=True):
        for switch in axis.switches.as_dict():
            bit = axis.chip.find_switch_input(switch)
            if (before ^ word) & bit:
                yield SwitchEdge(time, switch, bool(word & bit))


def _compare_switch(axis: Axis, changes: _LineChanges, words: np.ndarray, times: np.ndarray) -> SwitchComparison:
    """Compare a switch line of the capture with the switch of the stage. `words` and `times` are those of `_list_switch_edges`."""
    on = (words & changes.line.get_mask(axis.chip)) != 0
    return SwitchComparison(
        changes.line.line,
        changes.line.pin,
        tuple((changes.find_rising_edges() * 1e-9).tolist()),
        tuple(times[on[1:] & ~on[:-1]].tolist()),
    )


def _count_violations(axis: Axis, counts: np.ndarray) -> Iterable[tuple[str, int]]:
    """Yield, for each minimum time that edges of the capture violate, a message and the number of cases."""
    from stage.chips.stepdir.lint import TIMES

    for which, (rule, _) in TIMES.items():
        if counts[which]:
            message = next(d.message for d in axis.chip.diagnostics if d.key == rule.key)
            yield message, int(counts[which])
