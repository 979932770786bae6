"""Paths of lines, arcs and helices by the interpolation of an MCX514, without a stop between the segments.

    x, y, z = (stage.axes[n] for n in "xyz")
    move_along_path([ArcSegment(centre=(0, 4000))], x, y, speed=PathSpeed(8000))
    move_along_path([HelixSegment(centre=(0, 4000), rotations=3, along=(1600,))], x, y, z, speed=PathSpeed(8000))
    segments = [LineSegment((8000, 0)), ArcSegment(centre=(0, 4000), finish=(4000, 4000)), LineSegment((0, 8000))]
    move_along_path(segments, x, y, speed=PathSpeed(8000))

Coordinates are pulses from the beginning of a segment, one number for each axis in the order of the chip's axes. The pre-buffer
holds eight segments in addition to the one that runs, and the host refills it. The chip ramps down in the last segment; if that is
too short, the path ends above the initial speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stage.chips.exclusive_access import exclusive
from stage.errors import ArgumentError, RunTimeout
from stage.firmware.axis import Axis
from stage.firmware.nova.chip_port import MAP, POLL_INTERVAL_S, ChipPort, compute_mcx514_wr2, open_ports, stop_axes
from stage.support.argument_checks import check_timeout

CNEXT, DRIVING = MAP.masks("RR0", "CNEXT", "n-DRV")
TWO_AXES, THREE_AXES = 1, 2  # SPD of IPM
MAX_AXES = 4


@dataclass(frozen=True)
class PathSpeed:
    """Speeds of the whole path.

    Attributes:
        drive: Drive speed, pps.
        initial: Initial speed, pps.
        acceleration: Acceleration, pps/s.
        jerk: Jerk of S-curves, pps/s2; 0: linear ramps.
        even: True for constant vector speed, in which a pulse of two axes together takes sqrt(2) times as long. False: `drive` is
            the rate of the fastest axis.
    """

    drive: int
    initial: int = 400
    acceleration: int = 80_000
    jerk: int = 0
    even: bool = True


@dataclass(frozen=True, init=False)
class LineSegment:
    """Straight line to a finish point, which has a coordinate for each axis."""

    finish: tuple[int, ...]

    def __init__(self, *finish: int):
        object.__setattr__(self, "finish", finish)


@dataclass(frozen=True)
class ArcSegment:
    """Arc of the first two axes about a center to a finish point; the finish point (0, 0) means a whole circle."""

    centre: tuple[int, int]
    finish: tuple[int, int] = (0, 0)
    clockwise: bool = False


@dataclass(frozen=True)
class HelixSegment:
    """Turns of the first two axes about a center, while the other axes move in proportion.

    Attributes:
        centre: Center of the turns, pulses.
        along: Pulses of each other axis per rotation; without rotations, for the whole arc.
        rotations: Number of whole turns before the arc to `finish`. There is no arc if `finish` is (0, 0).
        finish: Finish point of the arc, pulses.
        clockwise: Whether the axes turn clockwise.
    """

    centre: tuple[int, int]
    along: tuple[int, ...]
    rotations: int = 1
    finish: tuple[int, int] = (0, 0)
    clockwise: bool = False


PathSegment = LineSegment | ArcSegment | HelixSegment


@dataclass(frozen=True)
class PathReport:
    """Report of a path that axes of an MCX514 or MCX512 have followed.

    Attributes:
        seconds: Time from the first segment's command to the end.
        pulses: Signed net pulses of each axis, by name.
        errors: Names of the error bits of RR2 that are set, by axis.
        segments: Number of segments.
    """

    seconds: float
    pulses: dict[str, int]
    errors: dict[str, tuple[str, ...]]
    segments: int

    @property
    def ok(self) -> bool:
        """Whether no error bit of the path's axes is set after the path."""
        return not any(self.errors.values())

    def __str__(self) -> str:
        what = "done" if self.ok else f"NOT as asked: {self.errors}"
        moved = ", ".join(f"{name} {n:+d}" for name, n in self.pulses.items())
        return f"{self.segments} segment{'s' * (self.segments > 1)} in {self.seconds:.3f} s: {what}, {moved} pulses"


@exclusive
def move_along_path(
    segments: Sequence[PathSegment], *axes: Axis, speed: PathSpeed, timeout: float = 60.0
) -> PathReport:
    """Move two to four axes of one MCX514, or both of an MCX512, along segments without a stop between them.

    Args:
        segments: Lines, arcs and helices.
        axes: Axes of one chip.
        speed: Speeds of the whole path.
        timeout: Simulated seconds to wait.

    Returns:
        The report.

    Raises:
        ArgumentError: A segment does not suit the axes. Nothing has moved.
        RunTimeout: The path was not complete after `timeout`. The axes are stopped.
    """
    check_timeout(timeout)
    ports = open_ports(axes)
    words = [_encode_segment(segment, len(ports)) for segment in segments]
    if not words:
        raise ArgumentError("no segments: give a Line, an Arc or a Helix at least.")
    _write_path_modes(ports, speed)
    words = [_add_helix_calculation(ports, w) for w in words]
    before, main = [port.read_value("R-LP") for port in ports], ports[0]
    main.write_command("DECDIS")
    begin = main.axis.time

    def wait_for(bits: int) -> int:
        """Poll RR0 until one of the bits `bits` is on or the chip has stopped; return the last RR0."""
        while (status := main.chip.read(0)) & DRIVING and not status & bits:
            if not main.axis.time - begin <= timeout:
                stop_axes(ports)
                raise RunTimeout(f"the path was not drawn after {timeout} s; the axes are stopped.")
            main.axis.wait(POLL_INTERVAL_S)
        return status

    for k, (command, chip_words, axis_words) in enumerate(words):
        if k and not wait_for(CNEXT) & DRIVING and any(port.read_error_names() for port in ports):
            break  # a limit has ended it
        if k == len(words) - 1:
            main.write_command("DECEN")
        main.write_parameters(**chip_words)
        for port, values in zip(ports, axis_words, strict=True):
            port.write_parameters(**values)
        main.write_command(command)
    wait_for(0)
    return PathReport(
        seconds=main.axis.time - begin,
        pulses={p.axis.name: p.read_value("R-LP") - b for p, b in zip(ports, before, strict=True)},
        errors={p.axis.name: p.read_error_names() for p in ports},
        segments=len(words),
    )


def _write_path_modes(ports: list[ChipPort], speed: PathSpeed) -> None:
    """Write the modes of a path's axes, the speeds of the main one, and which axes take part."""
    ports[0].write_parameters(
        SV=speed.initial, DV=speed.drive, AC=speed.acceleration, **({"JK": speed.jerk} if speed.jerk else {})
    )
    curves = MAP.mask("WR3", "SACC") if speed.jerk else 0
    for port in ports:
        port.write_mode_words(WR2=compute_mcx514_wr2(port.axis), WR3=curves)
        port.write_command("R2CLR")
    even = (THREE_AXES if len(ports) > 2 else TWO_AXES) << MAP.bit("IPM", "SPD") if speed.even else 0
    ports[0].write_parameters(IPM=sum(port.bit for port in ports) | even)


SegmentWords = tuple[str, dict[str, int], list[dict[str, int]]]
"""Command of a segment, values of the chip's registers by name, and values of the registers of each axis."""


def _encode_segment(segment: PathSegment, axes: int) -> SegmentWords:
    """Return the command and the register values of a segment for `axes` axes."""
    if not 2 <= axes <= MAX_AXES:
        raise ArgumentError(f"{axes} axes: an MCX514 interpolates 2 to {MAX_AXES}.")
    if isinstance(segment, LineSegment):
        if len(segment.finish) != axes:
            raise ArgumentError(f"{segment}: a finish point for each of {axes} axes.")
        return f"LHK{axes}", {}, [{"TP": v} for v in segment.finish]
    rotation = "CW" if segment.clockwise else "CCW"
    points = [{"TP": f, "CP": c} for f, c in zip(segment.finish, segment.centre, strict=True)]
    if isinstance(segment, ArcSegment):
        return f"CHK{rotation}", {}, points + [{} for _ in range(axes - 2)]
    if len(segment.along) != axes - 2 or axes < 3:
        raise ArgumentError(f"{segment}: `along` for each of the axes but the first two; {axes} axes are given.")
    return f"HL{rotation}", {"HLN": segment.rotations}, points + [{"TP": v} for v in segment.along]


def _add_helix_calculation(ports: list[ChipPort], words: SegmentWords) -> SegmentWords:
    """Add the result of the chip's helical calculation (6Bh, 6Ch) to a helix. The chip cannot calculate while it interpolates."""
    command, chip_words, axis_words = words
    if not command.startswith("HL"):
        return words
    ports[0].write_parameters(**chip_words)
    for port, values in zip(ports, axis_words, strict=True):
        port.write_parameters(**values)
    ports[0].write_command(command.replace("HL", "HLP"))
    ticks = ports[0].read_value("R-HLV")
    for port, values in zip(ports[2:], axis_words[2:], strict=True):
        if abs(values["TP"]) > ticks:
            raise ArgumentError(
                f"along={values['TP']} of {port.axis.name}: beside this circle an axis makes {ticks} pulses at most, one a tick; "
                "give fewer, or more rotations."
            )
    return command, {**chip_words, "HLV": ticks}, axis_words
