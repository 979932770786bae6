"""`Report` of a procedure, and `ProcedureObserver`, which observes the chip from the first byte to the last and makes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from stage.chips.cycle_descriptions import Statement, decode
from stage.chips.journal import Waveforms
from stage.errors import RunTimeout
from stage.firmware.axis import Axis
from stage.firmware.stop_reasons import UNWANTED_REASONS
from stage.support import html
from stage.units import POSITION_UNITS, format_lost_steps

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.axes import Axes as PlotAxes
    from matplotlib.figure import Figure


PRESET_JUMP_COUNTS = 8  # counts at once, faster than any rate: a host has written the position, and nothing has moved


@dataclass(frozen=True, repr=False)
class Report:
    """Report of one axis in one procedure: what the host observed, and the true state beside it.

    Attributes:
        procedure: Name of the procedure.
        axis: Name of the axis.
        pulses: Signed net pulses made; counts of a servo's command.
        asked: Signed pulses commanded; None if the procedure has no such number.
        duration: Seconds from the first start to the last stop.
        peak_rate: Highest pulse rate, pps.
        start: Position of the carriage before the procedure, m (rad on a hinge); None without a stage.
        position: Position of the carriage afterwards, m (rad on a hinge); None without a stage.
        lost_steps: Full steps lost in the procedure, a multiple of four; None without a motor.
        stopped_by: Reason of the end: "R0 = 0" (of a NOVA chip "all pulses", of a servo "end of profile"), "ORG", "EZ", "EL+",
            "EL-", "decelerating stop", "reset command", "stop command", "timeout", "Ctrl-C", the name of another input, "another
            axis" of a
            line, or "unknown".
        residual: Down counter (R0) at the end; None for a chip without one.
        waveforms: Waveforms of the chip's pins and speed, by the clock.
        statements: Decoded bytes that the host wrote: commands, and registers with all their bytes.
        unit: "m", or "rad" on a hinge.
        lost_pulses: Lost steps in pulses; None without a motor.
        missing_current: Why the motor has no current afterwards, for example "ENABLE is not asserted"; "" if it has.
    """

    procedure: str
    axis: str
    pulses: int
    asked: int | None
    duration: float
    peak_rate: float
    start: float | None
    position: float | None
    lost_steps: int | None
    stopped_by: str
    residual: int | None
    waveforms: Waveforms = field(repr=False)
    statements: tuple[Statement, ...] = field(repr=False)
    unit: str = "m"
    missing_current: str = ""
    lost_pulses: int | None = None

    @property
    def ok(self) -> bool:
        """True if the chip made every commanded pulse, no step was lost, and neither an end limit nor a timeout ended the move."""
        done = self.asked is None or self.pulses == self.asked
        return done and not self.lost_steps and self.stopped_by not in UNWANTED_REASONS

    @cached_property
    def average_rate(self) -> float:
        """Pulses in both directions divided by `duration`, pps."""
        steps, seconds = np.abs(np.diff(self.waveforms.edges["net"])), np.diff(self.waveforms.seconds)
        counted = int(steps[steps <= 2 * self.peak_rate * seconds + PRESET_JUMP_COUNTS].sum())
        return counted / self.duration if self.duration else 0.0

    @property
    def began(self) -> float:
        """Seconds from the first byte to the first start; 0 if the axis never started."""
        return (
            float(self.waveforms.seconds[running[0]]) if len(running := np.flatnonzero(self.waveforms.running)) else 0.0
        )

    @property
    def rates(self) -> np.ndarray:
        """Pulse rate after each edge of the waveforms, pps."""
        return compute_rates(self.waveforms)

    def __str__(self) -> str:
        asked = "" if self.asked is None else f" of {self.asked}"
        left = "" if self.residual is None else f", R0 {self.residual}{self._describe_undershoot()}"
        lines = [
            f"{self.procedure} on {self.axis}: {'done' if self.ok else 'NOT as asked'}, stopped by {self.stopped_by}",
            f"  pulses {self.pulses}{asked}{left}; {self.duration:.4f} s, peak {self.peak_rate:.1f} pps, "
            f"average {self.average_rate:.1f} pps",
        ]
        if self.position is not None and self.start is not None:
            lines.append(
                f"  from {POSITION_UNITS[self.unit].format(self.start)} to {POSITION_UNITS[self.unit].format(self.position)}, "
                f"{self.describe_loss()}"
            )
        if self.missing_current:
            lines.append(f"  the motor has no current: {self.missing_current}")
        return "\n".join(lines)

    def describe_loss(self) -> str:
        """Describe the lost steps in full steps and in pulses; a carriage that went farther than its pulses went "too far"."""
        lost = self.lost_steps or 0
        return format_lost_steps(lost, self.lost_pulses or 0, ahead=lost * self.pulses < 0)

    def _describe_undershoot(self) -> str:
        """Describe how far the down counter has counted below 0; "" if it has not."""
        of = getattr(self.waveforms.chip, "COUNTER", None)
        if of is None or self.residual is None:
            return ""
        _, bits = of
        if not max(abs(self.asked or 0), 1 << (bits - 1)) < self.residual:
            return ""
        return f" ({bits}-bit counter: {self.residual - (1 << bits)})"

    def writes(self) -> list[tuple[float, str, str]]:
        """Return for each written command or register: seconds from the first start, bytes in hex, meaning.

        The first byte of a row goes to address 0. Further bytes belong to a register and go to the addresses 3, 2, 1 (the last
        byte always to 1).
        """
        begin, hz = self.waveforms.edges["clock"][0], self.waveforms.clock_hz
        return [(float(s.clock - begin) / hz - self.began, s.code, s.meaning) for s in self.statements]

    def listing(self) -> str:
        """Return `writes` as text, one line each: ms from the first start, bytes, meaning."""
        return "\n".join(f"{t * 1e3:11.4f} ms  {code:14}{meaning}" for t, code, meaning in self.writes())

    def __repr__(self) -> str:
        return f"<Report {str(self).splitlines()[0]}, {self.pulses} pulses, {self.duration:.4f} s>"

    def _repr_html_(self) -> str:
        written = html.format_table(
            [(f"{t * 1e3:.4f}", code, said) for t, code, said in self.writes()], ("ms", "bytes", "meaning")
        )
        return (
            html.format_preformatted(str(self))
            + html.embed_figure(self.plot)
            + html.format_collapsible("what was written", written)
        )

    def json(self) -> dict[str, Any]:
        """Return everything as numbers and texts, as `--json` prints it: s, m (rad), pps; `writes` as (s, bytes, meaning)."""
        names = (
            "procedure",
            "axis",
            "ok",
            "stopped_by",
            "asked",
            "pulses",
            "residual",
            "duration",
            "peak_rate",
            "average_rate",
        )
        numbers = {name: getattr(self, name) for name in (*names, "start", "position", "unit", "lost_steps")}
        return numbers | {"writes": self.writes()}

    def plot(
        self,
        path: str | PathLike | None = None,
        title: str | None = None,
        *,
        ax: PlotAxes | None = None,
        overwrite: bool = False,
    ) -> Figure:
        """Draw the move as data sheets draw operation patterns. Needs matplotlib (extra `plot`).

        Args:
            path: File to save the figure in, if any.
            title: Title; default: the procedure and the axis.
            ax: Existing Matplotlib axes for the pulse rate; the lanes of signals are then not drawn.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The figure.

        Raises:
            FileError: The file exists, and `overwrite` is False.
        """
        from stage.firmware.operation_pattern_figure import draw_operation_pattern

        return draw_operation_pattern(self, path, title, ax, overwrite)


def compute_rates(waveforms: Waveforms) -> np.ndarray:
    """Return the unsigned pulse rate after each edge of waveforms, pps."""
    return waveforms.chip.compute_rates(waveforms.edges) * waveforms.clock_hz


class ProcedureObserver:
    """Observer of an axis: `with ProcedureObserver(axis, "preset move") as p: ...; return p.report(...)`.

    A RunTimeout in the `with` block gets the report so far as `error.report`; a KeyboardInterrupt gets the reports of all observed
    axes as `error.reports`.
    """

    def __init__(self, axis: Axis, name: str):
        self.axis, self.name = axis, name

    def __enter__(self) -> Self:
        self.journal = self.axis.chip.journal(self.axis.chip_axis)
        self.began = self.axis.time
        self._position, self._lost = self.axis.position, self.axis.lost_steps
        self._lost_pulses = getattr(self.axis, "lost_pulses", None)
        self._net = self.axis.chip.net(self.axis.chip_axis)
        return self

    @property
    def pulses_made(self) -> int:
        """Signed net pulses since the beginning."""
        return self.axis.chip.net(self.axis.chip_axis) - self._net

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, RunTimeout):
            error.report = self.make_report("timeout")  # type: ignore[attr-defined]
        if isinstance(error, KeyboardInterrupt):
            error.reports = [self.make_report("Ctrl-C"), *getattr(error, "reports", ())]  # type: ignore[attr-defined]
        self.journal.close()

    def read_residual(self) -> int | None:
        """Read the chip's down counter; None if the chip has none."""
        return None

    def make_report(self, stopped_by: str, asked: int | None = None) -> Report:
        """End the observation and make the report.

        Args:
            stopped_by: Stop reason.
            asked: Signed pulses commanded; None if the procedure has no such number.

        Returns:
            The report.
        """
        axis = self.axis
        residual = self.read_residual()
        self.journal.close()
        waveforms = self.journal.replay_waveforms()
        net, running, seconds = waveforms.edges["net"], np.flatnonzero(waveforms.running), waveforms.seconds
        duration = float(seconds[min(running[-1] + 1, len(net) - 1)] - seconds[running[0]]) if len(running) else 0.0
        lost, lost_pulses = axis.lost_steps, getattr(axis, "lost_pulses", None)
        return Report(
            self.name, axis.name, int(net[-1] - net[0]), asked, duration, float(compute_rates(waveforms).max()),
            self._position, axis.position, None if lost is None else lost - (self._lost or 0),
            stopped_by, residual, waveforms, tuple(decode(axis.chip.decoder(axis.chip_axis), self.journal.entries)),
            getattr(axis, "unit", "m"), axis.chip.explain_missing_current(axis.chip_axis),
            None if lost_pulses is None else lost_pulses - (self._lost_pulses or 0),
        )  # fmt: skip
