"""A custom profile: the host writes a command position to each chip in each sample, all axes in step by the SYNC pin.

    ports = [set_up(stage.axes[n]) for n in "xyz"]
    synchronize(ports)
    print(follow(ports, circle(6000, seconds=1.5, sample=ports[0].sample, axes=3)))

As the data sheet says: at the beginning of a sample the chip computes, and a command written then may throw it off. The host
reads the sample timer, which counts down from T, and writes when it has come down by the minimum of Table 4. SYNC starts the timers
of several chips at one clock: then one of them tells of all, and the axes take their commands at the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stage.chips.hctl1100.maps import TIMER
from stage.errors import ArgumentError
from stage.firmware.hctl1100.chip_port import SAFE_MARGIN_COUNTS, Port


@dataclass(frozen=True)
class StreamReport:
    """Report of a profile: commands written to each axis, samples that passed without a new one, seconds."""

    commands: int
    missed: int
    seconds: float

    def __str__(self) -> str:
        return f"{self.commands} commands in {self.seconds:.3f} s, {self.missed} samples missed"


def synchronize_sample_timers(ports: Sequence[Port]) -> None:
    """Let the sample timers of all chips begin at one clock, by the line to their SYNC pins.

    The chips obey SYNC in Init/Idle only: the axes are without a motor command for a few bus cycles, and hold afterwards.

    Args:
        ports: Ports of the axes.

    Raises:
        ArgumentError: The chips have different sample times.
    """
    if len({port.sample for port in ports}) != 1:
        raise ArgumentError(
            "SYNC keeps chips of one sample time in step: load the same T on all, and give them the same clock."
        )
    for port in ports:
        port.idle()
    for asserted in (True, False):
        for port in ports:
            port.axis.chip.axes[port.axis.chip_axis].pins.sync = asserted
    for port in ports:
        port.hold()


def stream_positions(
    ports: Sequence[Port], profile: np.ndarray, *, leader_only: bool = True, on_row: Callable[[], None] | None = None
) -> StreamReport:
    """Write command positions relative to the present ones, one row per sample, in the safe part of it.

    A host too slow for the sample time misses samples: see the report.

    Args:
        ports: Ports of the axes.
        profile: Positions (samples, axes), counts, whole numbers or rounded to them.
        leader_only: Read the timer of the first chip and write to all, as SYNC allows; otherwise each chip's own timer is read.
        on_row: Function that is called after each row.

    Returns:
        The report.

    Raises:
        ArgumentError: A profile of another shape.
    """
    rows = np.rint(np.asarray(profile)).astype(np.int64)
    if rows.ndim != 2 or rows.shape[1] != len(ports) or not len(ports):
        raise ArgumentError(f"a profile of shape {np.shape(profile)} for {len(ports)} axes: (samples, axes).")
    rows += [port.commanded() for port in ports]
    main = ports[0]
    begin = main.axis.time
    for row in rows.tolist():
        wait_for_next_sample(main)
        for port, value in zip(ports, row, strict=True):
            if not leader_only:
                port.wait_for_the_safe_part()
            port.load(command_position=value)
        if on_row is not None:
            on_row()
    seconds = main.axis.time - begin
    return StreamReport(len(rows), max(round(seconds / main.sample) - len(rows), 0), seconds)


def wait_for_next_sample(port: Port, mode: str = "position") -> None:
    """Wait for the safe part of the next sample, as a timer interrupt and a read of R0F would.

    Args:
        port: Port of the axis.
        mode: Control mode.
    """
    port.axis.wait((port.chip.read(TIMER) + SAFE_MARGIN_COUNTS) * port.count)
    port.wait_for_the_safe_part(mode)


def compute_circle_positions(
    radius: float, *, seconds: float, sample: float, axes: int = 2, revolutions: int = 1, ramp: float = 0.2
) -> np.ndarray:
    """Compute a profile for `stream_positions`: a circle, from rest to rest.

    With two axes the circle lies in their plane, begins at the lowest point to the right, and goes counter-clockwise; with three
    it lies in the plane that contains the first axis and stands at 45 degrees to the others.

    Args:
        radius: Radius, counts.
        seconds: Time of the whole motion, s.
        sample: Time of a sample, s.
        axes: Number of axes, 2 or 3.
        revolutions: Number of revolutions.
        ramp: Time in which the speed on the path rises, and that in which it falls, s.

    Returns:
        Positions relative to the start (samples, axes), counts.

    Raises:
        ArgumentError: A value is out of its range.
    """
    if axes not in CIRCLE_PLANES or not np.isfinite(radius) or not 0 < ramp <= 0.5 * seconds or not sample > 0:
        raise ArgumentError(
            f"radius={radius}, axes={axes}, ramp={ramp}, seconds={seconds}, sample={sample}: a finite radius, 2 or 3 axes, a ramp "
            "of half the time at most, and a sample time above 0."
        )
    t = np.minimum(np.arange(1, int(np.ceil(seconds / sample)) + 1) * sample, seconds)
    up, left = np.minimum(t, ramp), np.minimum(seconds - t, ramp)
    travel = np.where(
        t < ramp, up**2 / (2 * ramp), np.where(left < ramp, seconds - ramp - left**2 / (2 * ramp), t - 0.5 * ramp)
    )
    angle = 2 * np.pi * revolutions * travel / (seconds - ramp)
    right, forward = CIRCLE_PLANES[axes]
    return radius * (np.outer(np.sin(angle), right) + np.outer(1 - np.cos(angle), forward))


SQRT_HALF = np.sqrt(0.5)
CIRCLE_PLANES = {2: np.eye(2), 3: np.array([[1.0, 0.0, 0.0], [0.0, SQRT_HALF, SQRT_HALF]])}
"""Unit vectors at the circle's lowest point, by the number of axes: along it, and to the centre."""


def compute_circle_errors(places: np.ndarray, radius: float) -> np.ndarray:
    """Compute how far positions are from the circle that begins at the origin.

    Args:
        places: Positions (n, axes) in the radius' unit.
        radius: Radius.

    Returns:
        Distances (n,).
    """
    places = np.asarray(places, float)
    right, forward = CIRCLE_PLANES[places.shape[1]]
    u, v = places @ right, places @ forward - radius
    above = places - np.outer(u, right) - np.outer(v + radius, forward)
    return np.sqrt((np.hypot(u, v) - radius) ** 2 + (above**2).sum(axis=1))
