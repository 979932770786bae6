"""Streaming of positions: the host writes a command position to each chip in each sample, synchronized by the SYNC pins.

    ports = [set_up_servo(stage.axes[n]) for n in "xyz"]
    synchronize_sample_timers(ports)
    print(stream_positions(ports, compute_circle_positions(6000, seconds=1.5, sample=ports[0].sample, axes=3)))

According to the data sheet, the chip computes at the beginning of a sample, and a command that arrives then may disturb it. So the
host reads the sample timer, which counts down from T, and writes after it has counted down by the minimum of Table 4. SYNC starts
the timers of several chips at the same clock: the host then reads one timer only, and all axes accept their commands at the same
time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stage.chips.hctl1100.maps import TIMER
from stage.errors import ArgumentError
from stage.firmware.hctl1100.chip_port import SAFE_MARGIN_COUNTS, ChipPort


@dataclass(frozen=True)
class StreamReport:
    """Report of command positions that were streamed to servo axes.

    Attributes:
        commands: Number of command positions written to each axis.
        missed: Number of samples that passed without a new command position.
        seconds: Duration.
    """

    commands: int
    missed: int
    seconds: float

    def __str__(self) -> str:
        return f"{self.commands} commands in {self.seconds:.3f} s, {self.missed} samples missed"


def synchronize_sample_timers(ports: Sequence[ChipPort]) -> None:
    """Start the sample timers of all chips at the same clock, by the line to their SYNC pins.

    The chips obey SYNC only in Init/Idle, so the axes have no motor command for a few bus cycles. They hold their positions
    afterwards.

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
        port.enter_init_idle_mode()
    for asserted in (True, False):
        for port in ports:
            port.axis.chip.axes[port.axis.chip_axis].pins.sync = asserted
    for port in ports:
        port.hold_position()


def stream_positions(
    ports: Sequence[ChipPort],
    profile: np.ndarray,
    *,
    leader_only: bool = True,
    on_row: Callable[[], None] | None = None,
) -> StreamReport:
    """Write one row of command positions, relative to the present ones, in the safe part of each sample.

    A host that is too slow for the sample time misses samples; the report counts them.

    Args:
        ports: Ports of the axes.
        profile: Positions (samples, axes), counts; they are rounded to whole numbers.
        leader_only: True to read only the timer of the first chip, which requires synchronized chips; False to read the timer of
            each chip.
        on_row: Function to call after each row.

    Returns:
        The report.

    Raises:
        ArgumentError: The profile has another shape.
    """
    rows = np.rint(np.asarray(profile)).astype(np.int64)
    if rows.ndim != 2 or rows.shape[1] != len(ports) or not len(ports):
        raise ArgumentError(f"a profile of shape {np.shape(profile)} for {len(ports)} axes: (samples, axes).")
    rows += [port.read_command_position() for port in ports]
    main = ports[0]
    begin = main.axis.time
    for row in rows.tolist():
        wait_for_next_sample(main)
        for port, value in zip(ports, row, strict=True):
            if not leader_only:
                port.wait_for_safe_part_of_sample()
            port.write_quantities(command_position=value)
        if on_row is not None:
            on_row()
    seconds = main.axis.time - begin
    return StreamReport(len(rows), max(round(seconds / main.sample) - len(rows), 0), seconds)


def wait_for_next_sample(port: ChipPort, mode: str = "position") -> None:
    """Wait for the safe part of the next sample, as firmware would by a timer interrupt and a read of R0F.

    Args:
        port: Port of the axis.
        mode: Control mode.
    """
    port.axis.wait((port.chip.read(TIMER) + SAFE_MARGIN_COUNTS) * port.timer_count_s)
    port.wait_for_safe_part_of_sample(mode)


def compute_circle_positions(
    radius: float, *, seconds: float, sample: float, axes: int = 2, revolutions: int = 1, ramp: float = 0.2
) -> np.ndarray:
    """Compute positions for `stream_positions`: a circle, from rest to rest.

    With two axes the circle lies in their plane, begins at the lowest point to the right, and goes counter-clockwise; with three
    it lies in the plane that contains the first axis and stands at 45 degrees to the others.

    Args:
        radius: Radius, counts.
        seconds: Time of the whole motion, s.
        sample: Time of a sample, s.
        axes: Number of axes, 2 or 3.
        revolutions: Number of revolutions.
        ramp: Time in which the path speed rises, equal to the time in which it falls, s.

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
"""Number of axes -> unit vectors at the lowest point of the circle: along the circle, and towards its center."""


def compute_circle_errors(places: np.ndarray, radius: float) -> np.ndarray:
    """Compute the distances of positions from the circle that begins at the origin.

    Args:
        places: Positions (n, axes), in the unit of the radius.
        radius: Radius.

    Returns:
        Distances (n,).
    """
    places = np.asarray(places, float)
    right, forward = CIRCLE_PLANES[places.shape[1]]
    u, v = places @ right, places @ forward - radius
    above = places - np.outer(u, right) - np.outer(v + radius, forward)
    return np.sqrt((np.hypot(u, v) - radius) ** 2 + (above**2).sum(axis=1))
