"""`Report`: what a procedure did. Made by `Procedure`, which watches the chip from the first byte to the last."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stage.chips.decode import Said, decode
from stage.chips.journal import Course
from stage.firmware.axis import Axis, check
from stage.firmware.bus import Port


@dataclass(frozen=True)
class Report:
    """What one axis did in one procedure.

    Attributes:
        procedure, axis: names.
        pulses: pulses made, + minus - (signed). asked: pulses asked for, None where a procedure asks for none.
        duration: seconds from the first start to the last stop. peak_rate: pps.
        start, position: m, where the carriage was before and is after (None without a stage).
        lost_steps: full steps lost meanwhile, a multiple of four (None without a motor).
        stopped_by: why it stopped: "R0 = 0", "ORG", "EL+", "EL-", "decelerating stop", "reset command".
        residual: R0 at the end. course: every change of the chip's pins and speed, by the clock.
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
    residual: int
    course: Course = field(repr=False)
    said: tuple[Said, ...] = field(repr=False)

    @property
    def ok(self) -> bool:
        """Every pulse asked for was made, and none of them lost."""
        return (self.asked is None or self.pulses == self.asked) and not self.lost_steps

    def __str__(self) -> str:
        asked = "" if self.asked is None else f" of {self.asked}"
        lines = [
            f"{self.procedure} on {self.axis}: {'done' if self.ok else 'NOT as asked'}, stopped by {self.stopped_by}",
            f"  pulses {self.pulses}{asked}, R0 {self.residual}; {self.duration:.4f} s, peak {self.peak_rate:.1f} pps",
        ]
        if self.position is not None and self.start is not None:
            lines.append(f"  from {self.start * 1e3:.4f} mm to {self.position * 1e3:.4f} mm, lost steps {self.lost_steps}")
        return "\n".join(lines)

    def listing(self) -> str:
        """The bytes of the move, one command or register a line: time, bytes, meaning."""
        begin = self.course.edges["clock"][0]
        return "\n".join(
            f"{(s.clock - begin) / self.course.clock_hz * 1e3:11.4f} ms  {s.code:14}{s.meaning}" for s in self.said
        )

    def plot(self, path: str | None = None, title: str | None = None) -> Any:
        """Draw the move as the data sheet draws operation patterns; saves to `path` if given. Returns the figure.

        Needs matplotlib (extra `plot`).
        """
        from stage.firmware.plot import draw

        return draw(self, path, title)


class Procedure:
    """Watches an axis: `with Procedure(axis, "preset move") as p: ...; return p.report(...)`."""

    def __init__(self, axis: Axis, name: str):
        check(axis)
        self.axis, self.name, self.port = axis, name, Port(axis)

    def __enter__(self) -> Procedure:
        self.journal = self.axis.chip.journal()
        self.began = self.axis.time
        self._position, self._lost = self.axis.position, self.axis.lost_steps
        return self

    def __exit__(self, *exc: object) -> None:
        self.journal.close()

    def report(self, stopped_by: str, asked: int | None = None) -> Report:
        """Close the books."""
        axis = self.axis
        residual = self.port.counter()
        self.journal.close()
        course = self.journal.course()
        e = course.edges
        active = np.flatnonzero(~course.pin("hold"))
        seconds = course.seconds
        duration = float(seconds[min(active[-1] + 1, len(e) - 1)] - seconds[active[0]]) if len(active) else 0.0
        rate = e["speed"] * course.clock_hz / (8192.0 * np.maximum(e["multiplier"], 1))
        lost = axis.lost_steps
        return Report(
            self.name, axis.name, int(e["net"][-1] - e["net"][0]), asked, duration, float(rate.max()),
            self._position, axis.position, None if lost is None else lost - (self._lost or 0),
            stopped_by, residual, course, tuple(decode(axis.chip.MAP, self.journal.entries)),
        )  # fmt: skip
