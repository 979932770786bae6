"""Assertion that a recorded path follows a polyline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stage.errors import ArgumentError, unknown_name_error
from stage.support.argument_checks import explain_arguments
from stage.testing.assertions import format_deviation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from stage.recording import Recording


@explain_arguments
def assert_path_within(
    recording: Recording,
    line: ArrayLike,
    within: float,
    axes: Sequence[str] | None = None,
    *,
    begin: float = 0.0,
    end: float = float("inf"),
) -> None:
    """Assert that the carriages followed a line: every sample is near the line, and the path passed every point of the line.

    Args:
        recording: Recording of the move: `with stage.record() as recording:`.
        line: Points of a polyline, (n, 2) or (n, 3) meters, n of 2 or more; one number for each of `axes`. A circle is many points.
        within: Distance that is near, m.
        axes: Names; default: the first two or three axes of the stage.
        begin: Beginning of the part of the recording that counts, stage time, s.
        end: End of that part, s.

    Raises:
        AssertionError: A sample or a point is farther away.
        ArgumentError: The line is none, an axis does not exist, or there are no samples.
    """
    import numpy as np

    __tracebackhide__ = True
    try:
        points = np.asarray(line, float)
    except (TypeError, ValueError):
        raise ArgumentError(f"line={line!r}: give points of two or three numbers each, in meters.") from None
    if points.ndim != 2 or len(points) < 2 or points.shape[1] not in (2, 3) or not np.isfinite(points).all():
        raise ArgumentError(
            f"line of shape {points.shape}: two points or more, each of two or three numbers, in meters."
        )
    names = list(axes) if axes is not None else list(recording.axes)[: points.shape[1]]
    if len(names) != points.shape[1]:
        raise ArgumentError(f"axes={names}: the points of the line have {points.shape[1]} numbers, one an axis.")
    for name in names:
        if name not in recording.axes:
            raise unknown_name_error("axis", name, recording.axes)
    time = recording.column("time")
    selected = (time >= begin) & (time <= end)
    time = time[selected]
    path = np.stack([recording.column(f"{name}/position")[selected] for name in names], axis=1)
    if len(path) < 2:
        raise ArgumentError(f"{len(path)} samples from {begin} s to {end} s: nothing to judge. {recording!r}")

    off, foot = _measure_distances(path, points)
    worst = int(np.argmax(off))
    if not off[worst] <= within:
        raise AssertionError(
            f"the path of {', '.join(names)} left its line: expected within {format_deviation(within, 'm')}, was "
            f"{format_deviation(off[worst], 'm')} off\n"
            f"  at   {time[worst]:.6f} s: {_format_point(names, path[worst])}\n"
            f"  line {_format_point(names, foot[worst])}, the nearest point of it\n"
            f"{int((off > within).sum()):,} of {len(path):,} samples are off, first at {time[int(np.argmax(off > within))]:.6f} s. "
            "Look at following_error, lost_steps and rate of these axes there."
        )
    missed, nearest = _measure_distances(points, path)
    worst = int(np.argmax(missed))
    if not missed[worst] <= within:
        raise AssertionError(
            f"the path of {', '.join(names)} kept to its line and did not pass point {worst} of it: expected within "
            f"{format_deviation(within, 'm')}, was {format_deviation(missed[worst], 'm')} off\n"
            f"  point {_format_point(names, points[worst])}\n"
            f"  path  {_format_point(names, nearest[worst])}, the nearest point of it\n"
            f"It was recorded from {time[0]:.6f} s, {_format_point(names, path[0])}, to {time[-1]:.6f} s, "
            f"{_format_point(names, path[-1])}: is the whole move inside?"
        )


def _measure_distances(points: Any, line: Any) -> tuple[Any, Any]:
    """Measure how far points are from a polyline.

    Args:
        points: (n, d).
        line: (m, d), corners of the polyline.

    Returns:
        Distance of each point, (n,), and the nearest point of the line, (n, d).
    """
    import numpy as np

    a, along = line[:-1], np.diff(line, axis=0)
    length2 = np.maximum((along**2).sum(axis=1), 1e-300)
    off, foot = np.full(len(points), np.inf), np.zeros(points.shape)
    for begin in range(0, len(a), rows := max(1, 1_000_000 // len(points))):  # so that it fits any memory
        part = slice(begin, begin + rows)
        t = np.einsum("nmd,md->nm", points[:, None] - a[None, part], along[part]) / length2[part]
        feet = a[part] + np.clip(t, 0, 1)[..., None] * along[part]
        d = np.sqrt(((points[:, None] - feet) ** 2).sum(axis=-1))
        k = np.argmin(d, axis=1)
        nearest = d[np.arange(len(points)), k]
        better = nearest < off
        off[better], foot[better] = nearest[better], feet[np.arange(len(points)), k][better]
    return off, foot


def _format_point(names: list[str], values: Any) -> str:
    return ", ".join(f"{name} {value * 1e3:.4f} mm" for name, value in zip(names, values, strict=True))
