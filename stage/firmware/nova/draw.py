"""Lines, arcs and helices by the interpolation of an MCX514, one after the other without a stop.

    x, y, z = (stage.axes[n] for n in "xyz")
    draw([Arc(centre=(0, 4000))], x, y, speed=Speed(8000))
    draw([Helix(centre=(0, 4000), rotations=3, along=(1600,))], x, y, z)
    draw([Line(8000, 0), Arc(centre=(0, 4000), finish=(4000, 4000)), Line(0, 8000)], x, y)

Coordinates are pulses from where a segment begins, a number for each axis in the order of the chip's. The pre-buffer holds eight
segments beside the one that runs; the host fills it as it empties. The ramp-down is made in the last segment: if that is too short,
the path ends above the initial speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stage.chips.sharing import exclusive
from stage.errors import ArgumentError, RunTimeout
from stage.firmware.axis import Axis
from stage.firmware.nova.port import MAP, POLL, Port, inputs_514, mask, same_chip, stop
from stage.support.arguments import patience

CNEXT, DRIVING = MAP.mask("RR0", "CNEXT"), MAP.mask("RR0", "n-DRV")
TWO_AXES, THREE_AXES = 1, 2  # SPD of IPM
MAX_AXES = 4


@dataclass(frozen=True)
class Speed:
    """Of the path, for all of it: pps, pps/s; jerk in pps/s2 makes S-curves, 0 linear ramps.

    even: constant vector speed, at which a step of two axes at once takes sqrt(2) times as long. Otherwise `drive` is the rate of
    whichever axis is the fastest.
    """

    drive: int
    initial: int = 400
    acceleration: int = 80_000
    jerk: int = 0
    even: bool = True


@dataclass(frozen=True, init=False)
class Line:
    """A straight line to a point, of as many axes as there are."""

    finish: tuple[int, ...]

    def __init__(self, *finish: int):
        object.__setattr__(self, "finish", finish)


@dataclass(frozen=True)
class Arc:
    """An arc of the first two axes about a centre to a finish point; to (0, 0), where it began, a whole circle."""

    centre: tuple[int, int]
    finish: tuple[int, int] = (0, 0)
    clockwise: bool = False


@dataclass(frozen=True)
class Helix:
    """Turns of the first two axes about a centre, while the other axes move in proportion.

    rotations: whole turns, then an arc to `finish` where that is not (0, 0); with 0 the arc alone. along: pulses of each of the
    other axes a rotation; of the whole arc where there is none.
    """

    centre: tuple[int, int]
    along: tuple[int, ...]
    rotations: int = 1
    finish: tuple[int, int] = (0, 0)
    clockwise: bool = False


Segment = Line | Arc | Helix


@dataclass(frozen=True)
class Drawn:
    """The result of a path.

    Attributes:
        seconds: from the first segment's command to the end. pulses: net pulses of each axis by name (signed).
        errors: by axis, names of the bits of RR2 that are set. segments: how many were given.
    """

    seconds: float
    pulses: dict[str, int]
    errors: dict[str, tuple[str, ...]]
    segments: int

    @property
    def ok(self) -> bool:
        """No error bit is set."""
        return not any(self.errors.values())

    def __str__(self) -> str:
        what = "done" if self.ok else f"NOT as asked: {self.errors}"
        moved = ", ".join(f"{name} {n:+d}" for name, n in self.pulses.items())
        return f"{self.segments} segment{'s' * (self.segments > 1)} in {self.seconds:.3f} s: {what}, {moved} pulses"


@exclusive
def draw(segments: Sequence[Segment], *axes: Axis, speed: Speed, timeout: float = 60.0) -> Drawn:
    """Draw segments with two to four axes of one MCX514, one after the other without a stop.

    Raises ArgumentError, before the axes move, where a segment does not suit them; RunTimeout after `timeout` s, and stops the
    axes.
    """
    patience(timeout)
    ports = same_chip(axes)
    words = [_words(segment, len(ports)) for segment in segments]
    if not words:
        raise ArgumentError("no segments: give a Line, an Arc or a Helix at least.")
    _prepare(ports, speed)
    words = [_with_calculation(ports, w) for w in words]
    before, main = [port.value("R-LP") for port in ports], ports[0]
    main.command("DECDIS")
    begin = main.axis.time

    def wait_while(bits: int, value: int) -> int:
        """Poll RR0 while the chip drives and RR0 has this value; returns its next value."""
        while (status := main.chip.read(0)) & DRIVING and status & bits == value:
            if not main.axis.time - begin <= timeout:
                stop(ports)
                raise RunTimeout(f"the path was not drawn after {timeout} s; the axes are stopped.")
            main.axis.wait(POLL)
        return status

    for k, (command, chip_words, axis_words) in enumerate(words):
        if k and not wait_while(CNEXT, 0) & DRIVING and any(port.errors() for port in ports):
            break  # a limit has ended it
        if k == len(words) - 1:
            main.command("DECEN")
        main.load(**chip_words)
        for port, values in zip(ports, axis_words, strict=True):
            port.load(**values)
        main.command(command)
    wait_while(0, 0)
    return Drawn(
        seconds=main.axis.time - begin,
        pulses={p.axis.name: p.value("R-LP") - b for p, b in zip(ports, before, strict=True)},
        errors={p.axis.name: p.errors() for p in ports},
        segments=len(words),
    )


def _prepare(ports: list[Port], speed: Speed) -> None:
    """Modes of the axes, speeds of the main one, and which axes take part."""
    ports[0].load(SV=speed.initial, DV=speed.drive, AC=speed.acceleration, **({"JK": speed.jerk} if speed.jerk else {}))
    curves = mask("WR3", "SACC") if speed.jerk else 0
    for port in ports:
        port.mode(WR2=inputs_514(port.axis), WR3=curves)
        port.command("R2CLR")
    even = (THREE_AXES if len(ports) > 2 else TWO_AXES) << MAP.bit("IPM", "SPD") if speed.even else 0
    ports[0].load(IPM=sum(port.bit for port in ports) | even)


Words = tuple[str, dict[str, int], list[dict[str, int]]]
"""A segment's command, the registers of the chip, and those of each axis."""


def _words(segment: Segment, axes: int) -> Words:
    if not 2 <= axes <= MAX_AXES:
        raise ArgumentError(f"{axes} axes: an MCX514 interpolates 2 to {MAX_AXES}.")
    if isinstance(segment, Line):
        if len(segment.finish) != axes:
            raise ArgumentError(f"{segment}: a finish point for each of {axes} axes.")
        return f"LHK{axes}", {}, [{"TP": v} for v in segment.finish]
    rotation = "CW" if segment.clockwise else "CCW"
    points = [{"TP": f, "CP": c} for f, c in zip(segment.finish, segment.centre, strict=True)]
    if isinstance(segment, Arc):
        return f"CHK{rotation}", {}, points + [{} for _ in range(axes - 2)]
    if len(segment.along) != axes - 2 or axes < 3:
        raise ArgumentError(f"{segment}: `along` for each of the axes but the first two; {axes} axes are given.")
    return f"HL{rotation}", {"HLN": segment.rotations}, points + [{"TP": v} for v in segment.along]


def _with_calculation(ports: list[Port], words: Words) -> Words:
    """A helix with what the chip's helical calculation (6Bh, 6Ch) makes of it: the chip cannot calculate while it draws."""
    command, chip_words, axis_words = words
    if not command.startswith("HL"):
        return words
    ports[0].load(**chip_words)
    for port, values in zip(ports, axis_words, strict=True):
        port.load(**values)
    ports[0].command(command.replace("HL", "HLP"))
    ticks = ports[0].value("R-HLV")
    for port, values in zip(ports[2:], axis_words[2:], strict=True):
        if abs(values["TP"]) > ticks:
            raise ArgumentError(
                f"along={values['TP']} of {port.axis.name}: beside this circle an axis makes {ticks} pulses at most, one a tick; "
                "give fewer, or more rotations."
            )
    return command, {**chip_words, "HLV": ticks}, axis_words
