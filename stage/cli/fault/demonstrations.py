"""Demonstrations of faults by name: their host programs, the claim that each one shows, and their results.

Claims are about steppers; a demonstration has a second claim if a servo behaves differently. The command, the tests and
docs/faults.md call `run_demonstration`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

from stage.cli.fault import SAMPLE_INTERVAL_S, host_programs
from stage.cli.output_and_progress import show_status
from stage.errors import unknown_name_error
from stage.firmware.driver import get_driver
from stage.units import DEVIATION_UNITS, POSITION_UNITS

MeasuredValues = dict[str, Any]
MakeFault = Callable[..., AbstractContextManager]
"""Called with a function of `stage.faults` and its arguments: makes the fault on the faulty stage, nothing on the healthy one."""
RecordingFactory = Callable[[Any], AbstractContextManager]
"""Context manager of the recording of a stage, or of None."""

SCREW_M = 10e-3
"""Travel per turn of the motor to which claims in millimeters refer."""
UNFINISHED_STOP_REASONS = ("EL+", "EL-", "timeout")
HYSTERESIS_UM = 28.0  # 25 of a switch, and a pulse


@dataclass(frozen=True)
class ServoClaim:
    """Claim of a demonstration about a servo, if it differs from that about a stepper; for the attributes see `Demo`."""

    claim: str
    notice: str
    happened: Callable[[MeasuredValues, MeasuredValues], bool]
    draws: tuple[str, str] = ("position", "following_error")


@dataclass(frozen=True)
class Demo:
    """Demonstration of a fault.

    Attributes:
        claim: Sentence that says what happens.
        notice: Sentence that says how a host can detect the fault.
        program: Host program; a function of the stage and of a function that makes the fault, which returns the measured values.
        happened: Function that returns whether the measured values of the healthy and the faulty run are as claimed.
        draws: Two columns of the first axis' recording for the picture.
        close_up: Times before and after the interesting moment that the picture shows, s. This moment is the begin of the fault, or
            the first edge of a switch that `draws` names. None: the whole run.
        servo: Claim about servos; None: the same as about steppers.
    """

    claim: str
    notice: str
    program: Callable[[Any, MakeFault], MeasuredValues]
    happened: Callable[[MeasuredValues, MeasuredValues], bool]
    draws: tuple[str, str] = ("position", "lost_steps")
    close_up: tuple[float, float] | None = None
    servo: ServoClaim | None = None

    def for_servo(self) -> Demo:
        """Return the demonstration with its claim about servos."""
        return replace(self, **vars(self.servo)) if self.servo else self


@dataclass(frozen=True)
class DemoResult:
    """Result of a demonstration: the healthy run and the faulty run.

    Attributes:
        name: Name of the demonstration.
        demo: The demonstration.
        figures: Measured values of the two runs; those whose names end in mm or um are in meters or radians.
        recordings: Recordings of the two runs, or None.
        unit: Unit of lengths: "m", or "rad" if the first axis is a hinge.
        turn: Distance of the axis for a turn of the motor, m (rad).
    """

    name: str
    demo: Demo
    figures: tuple[MeasuredValues, MeasuredValues]
    recordings: tuple[Any, Any] = field(repr=False)
    unit: str = "m"
    turn: float = SCREW_M

    @property
    def as_claimed(self) -> bool:
        """Verdict of the demonstration: the claim has come true."""
        return self.demo.happened(*map(self._scale_to_reference_screw, self.figures))

    def _scale_to_reference_screw(self, figures: MeasuredValues) -> MeasuredValues:
        """Scale lengths to an axis that moves SCREW_M per turn of its motor, for which the claims are written."""
        return {k: v * SCREW_M / self.turn if k.endswith(", mm") else v for k, v in figures.items()}

    def format_table(self) -> str:
        """Return the measured values of both runs, a line for each."""
        return format_measured_values(("", "healthy", "faulty"), self.figures, self.unit)

    def plot(self, path: str | None = None, overwrite: bool = False) -> Any:
        """Draw both runs over time, and return the figure. Needs recordings, and matplotlib."""
        from stage.cli.fault.demonstration_plot import draw_demonstration

        return draw_demonstration(self, path, overwrite)


def format_measured_values(
    head: tuple[str, str, str], figures: tuple[MeasuredValues, MeasuredValues], unit: str
) -> str:
    """Return the measured values of two runs as a table, a line for each.

    Args:
        head: Headings of the columns.
        figures: Measured values of each run by name; those whose names end in mm or um are lengths.
        unit: "m", or "rad": lengths are angles, and the table shows degrees.
    """
    first, second = figures
    rows = [head, *(_format_measured_value(name, value, second[name], unit) for name, value in first.items())]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(v.ljust(w) for v, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def _format_measured_value(name: str, first: Any, second: Any, unit: str) -> tuple[str, ...]:
    title, comma, scale = name.rpartition(", ")
    units = {"mm": POSITION_UNITS, "um": DEVIATION_UNITS}.get(scale) if comma else None
    if units is not None:
        name, factor = f"{title}, {units[unit].symbol}", units[unit].factor / units["m"].factor
        first, second = first * factor, second * factor
    return name, *(f"{v:.4f}" if isinstance(v, float) else str(v) for v in (first, second))


def find_demonstration_key(name: str) -> str:
    """Return the key of DEMOS for a typed name of a demonstration. Raises ArgumentError, with similar names, for an unknown one."""
    key = name.lower().replace("_", "-")
    if key not in DEMOS:
        raise unknown_name_error("fault", name, DEMOS)
    return key


def run_demonstration(
    name: str, make: Callable[[], Any], record: RecordingFactory | None = None, record_both: bool = False
) -> DemoResult:
    """Run a demonstration on two stages, the healthy one first.

    Args:
        name: Name of the demonstration.
        make: Function that returns a new stage.
        record: Function of the stage that returns the context manager of the faulty run's recording; None: no recording.
        record_both: Whether to record the healthy run, too.

    Raises:
        ArgumentError: No demonstration has this name.
        StageError: The stage cannot show the fault; the error says why.
    """
    key = find_demonstration_key(name)
    stage = make()
    demo, axis = DEMOS[key], host_programs.get_first_axis(stage)
    if get_driver(axis).has_position_loop:
        demo = demo.for_servo()
    show_status(f"{key}: the healthy run ...")
    with stage.record(SAMPLE_INTERVAL_S) if record_both else nullcontext() as healthy_recording:
        healthy = demo.program(stage, lambda *_: nullcontext())
    stage = make()
    show_status(f"{key}: the faulty run ...")
    with record(stage) if record else nullcontext() as faulty_recording:
        faulty = demo.program(stage, lambda fault, *args: fault(*args))
    turn = 2 * math.pi / abs(axis.gear)
    return DemoResult(key, demo, (healthy, faulty), (healthy_recording, faulty_recording), axis.unit, turn)


def has_arrived(figures: MeasuredValues) -> bool:
    """Return whether the chip has completed its move."""
    return figures["stopped by"] not in UNFINISHED_STOP_REASONS


DEMOS = {
    "stuck-open": Demo(
        "EL+ is stuck open: the chip never stops, the carriage hits the hard stop, and the motor slips by "
        "multiples of four full steps.",
        "During the move, it cannot: the chip makes all its pulses. The next origin return needs more pulses, or fewer.",
        host_programs.run_into_stuck_open_limit,
        lambda h, f: h["stopped by"] == "EL+" and h["lost steps"] == 0
        and has_arrived(f) and f["lost steps"] > 0 and f["lost steps"] % 4 == 0,
        servo=ServoClaim(
            "EL+ is stuck open: the chip never stops, the carriage hits the hard stop, and the motor pushes against it.",
            "At once: the actual position stays constant, and the command position moves away from it.",
            lambda h, f: h["stopped by"] == "EL+" and has_arrived(f) and f["beyond EL+, mm"] < 10 < f["behind at the end, mm"],
        ),
    ),
    "stuck-closed": Demo(
        "EL+ sticks closed during a move: the chip stops at once, without a ramp, and the carriage overruns and "
        "loses synchronism.",
        "At once: the chip has halted with pulses left, where there is no end limit. It refuses to move towards "
        "plus, and moves towards minus.",
        host_programs.move_with_stuck_closed_limit,
        lambda h, f: has_arrived(h) and f["stopped by"] == "EL+" and f["before EL+, mm"] > 10 and f["lost steps"] < 0,
        ("position", "rate"),
        servo=ServoClaim(
            "EL+ sticks closed during a move: the chip sets its motor command to zero at once, and the carriage coasts.",
            "At once: the chip is in Init/Idle with LIMIT in its status, where there is no end limit. The position is "
            "still known.",
            lambda h, f: has_arrived(h) and f["stopped by"] == "EL+" and f["before EL+, mm"] > 10,
        ),
    ),
    "bounce": Demo(
        "ORG bounces for 3 ms: the chip sees several edges in place of each one, and finds the origin within the "
        "hysteresis of the switch.",
        "A status read during the bounce may show ORG off, although ORG has stopped the axis: read it again later.",
        host_programs.home_with_bouncing_origin,
        lambda h, f: f["edges of ORG that the chip saw"] > 4 * h["edges of ORG that the chip saw"] > 0
        and h["after the first edge ORG is off for, ms"] == 0 < f["after the first edge ORG is off for, ms"]
        and h["origin return stopped by"] == f["origin return stopped by"] == "ORG"
        and abs(f["origin, um"] - h["origin, um"]) < HYSTERESIS_UM,
        ("rate", "org"), (-2e-3, 8e-3),
    ),
    "vane-missing": Demo(
        "The vane of ORG has come off: the origin return passes the origin and ends at EL-.",
        "At once: the chip has halted and ORG is off, so the end limit has stopped it (`stopped_by` EL-).",
        host_programs.home_without_vane,
        lambda h, f: h["stopped by"] == "ORG" and f["stopped by"] == "EL-" and f["past ORG, mm"] > 1,
        ("position", "org"),
    ),
    "payload-doubled": Demo(
        "The payload weighs 20 kg instead of 10 kg: a ramp that is suitable for 10 kg pulls the rotor out of step.",
        "During the move, it cannot: the chip only counts pulses. An origin return afterwards reveals it.",
        host_programs.move_with_heavy_payload,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and has_arrived(f),
        servo=ServoClaim(
            "The payload weighs 20 kg instead of 10 kg: the same loop follows the ramps less closely, but the axis "
            "still arrives.",
            "By comparing the command position with the actual position in each sample. No count is lost.",
            lambda h, f: has_arrived(f) and f["behind at most, mm"] > 1.1 * h["behind at most, mm"]
            and abs(f["carriage moved, mm"] - h["carriage moved, mm"]) < 0.05,
        ),
    ),
    "bus-voltage": Demo(
        "The supply falls from 24 V to 8 V at speed, below the back-EMF: the current is too small, and the motor stalls.",
        "During the move, it cannot: the chip only counts pulses. An origin return afterwards reveals it.",
        host_programs.move_with_falling_supply,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and has_arrived(f),
        servo=ServoClaim(
            "The supply falls from 24 V to 8 V at speed: the motor has a third of its force, lags behind, and arrives.",
            "By comparing the command position with the actual position in each sample. No count is lost.",
            lambda h, f: has_arrived(f) and f["behind at most, mm"] > 2 * h["behind at most, mm"]
            and abs(f["carriage moved, mm"] - h["carriage moved, mm"]) < 0.05,
        ),
    ),
    "jam": Demo(
        "The axis jams during a move: the carriage stops, and the chip sends the remaining pulses to a motor that stands still.",
        "During the move, it cannot: the chip only counts pulses. An origin return then ends in RunTimeout: the "
        "chip makes pulses, and no switch trips.",
        host_programs.move_with_jam,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and abs(f["on from 0.5 s, mm"]) < 0.2
        and f["pulses made"] == h["pulses made"],
        servo=ServoClaim(
            "The axis jams during a move: the carriage almost stops, the motor pushes with full force, and the "
            "command position advances.",
            "At once: the actual position stays constant, and the command position moves away from it. "
            "`firmware.move` ends in RunTimeout.",
            lambda h, f: has_arrived(f) and abs(f["on from 0.5 s, mm"]) < 3 < 30 < f["behind at the end, mm"]
            and abs(h["behind at the end, mm"]) < 1
            and f["counts commanded"] == h["counts commanded"],
        ),
    ),
    "phase-open": Demo(
        "Phase B is open: the field of one phase has no direction, and a motor at rest stays at its position of power-up.",
        "During the move, it cannot: the chip only counts pulses. An origin return then ends in RunTimeout: the "
        "chip makes pulses, and ORG does not trip.",
        host_programs.move_with_open_phase,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 100
        and f["opened at 6.25 turns/s: lost steps"] < 0.1 * f["lost steps"],
        ("position", "lost_steps"), (-0.05, 1.98),
    ),
    "start-skew": Demo(
        "The CPU is busy for 5 ms between two start commands of an a:b move: both axes arrive, but leave the line in between.",
        "By measuring the time between the start commands. Both axes make all their pulses, and their status is normal.",
        host_programs.move_line_with_start_skew,
        lambda h, f: h["done"] == f["done"] == "yes" and abs(f["started within, ms"] - 5) < 0.1
        and f["off the line, pulses"] > 10 * h["off the line, pulses"],
        ("position", "rate"),
    ),
    "lost-write": Demo(
        "A write of the distance does not arrive: the chip moves by the distance in its register instead of the requested one.",
        "By reading the distance back before the start, if the chip supports that. Afterwards, the status is that "
        "of a good move.",
        host_programs.move_with_lost_write,
        lambda h, f: h["pulses made"] == h["asked"] != f["pulses made"] and has_arrived(f),
        ("position", "pulses"),
        servo=ServoClaim(
            "A byte of the final position does not arrive: the chip moves to the position in its registers instead of "
            "the requested one.",
            "By reading the final position back before the start. Afterwards, the status is that of a good move.",
            lambda h, f: h["counts commanded"] == h["asked"] != f["counts commanded"] and has_arrived(f)
            and f["diagnostics"] == h["diagnostics"],
            ("position", "pulses"),
        ),
    ),
}  # fmt: skip
"""Every fault by name."""
