"""The command `stage erratum`: the S-curve failure of MCX302, MCX304 and MCX312, and the work-around of NOVA's notice.

The command makes the same move twice, and commands a decelerating stop in area d, the end of the deceleration: once by command 26h,
whatever the chip is doing, and once by `stop_by_speed`. The command, the tests and docs/erratum.md call `run_demonstration`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts
from stage.cli.fault import SAMPLE_INTERVAL_S
from stage.cli.output_and_progress import show_status
from stage.cli.output_files import check_outputs, draw_plot, record_for_plot
from stage.errors import StageError

if TYPE_CHECKING:
    from stage.cli.fault.demonstrations import MeasuredValues, RecordingFactory

ERRATUM_CHIP_NAMES = ("MCX304", "MCX302", "MCX312")
MULTIPLE = 10
MOVE = {"R": 8_000_000 // MULTIPLE, "K": 20_000, "A": 8000, "SV": 400, "V": 2000, "AO": 0}
"""Registers of the move."""
PULSES = 40_000
TARGET_TO_LIMIT_M = 5e-3
"""Distance from the target to EL+."""
OBSERVATION_S = 2.0
"""Time from the command to stop until the figures are read."""


def add_subcommand(commands: Any) -> None:
    """Add `stage erratum` to argparse's subparsers."""
    p = add_command(
        commands, "erratum", run, "show the S-curve failure of MCX304, MCX302 and MCX312, and a work-around",
        "Command a decelerating stop at the end of an S-curve move. After the bare command 26h the chip never stops "
        "sending pulses, and the carriage meets the hard stop; with a work-around of NOVA's notice it stops on its target. "
        "Files of the second run have '-work-around' in their names. Exit code 0 if both runs end so.",
        ("stage erratum --plot erratum.png", "draw both runs"),
        ("stage erratum --mended", "simulate chips without the failure"),
    )  # fmt: skip
    p.add_argument("--mended", action="store_true", help="simulate chips without the failure (errata=False)")
    options.add_plot_option(p)
    options.add_stage_and_output_options(p, ERRATUM_CHIP_NAMES)


@dataclass(frozen=True)
class ErratumResult:
    """Result of the demonstration. Each pair has the run with command 26h alone first, and then the run with the work-around.

    Attributes:
        chip: Name of the chip.
        lacks_erratum: Whether the chip does not have the failure at all (`errata=False`).
        figures: Measured values of each run; those whose names end in mm are in meters or radians.
        recordings: Recording of each run, or None.
        unit: Unit of lengths: "m", or "rad" if the axis is a hinge.
    """

    chip: str
    lacks_erratum: bool
    figures: tuple[MeasuredValues, MeasuredValues]
    recordings: tuple[Any, Any] = field(repr=False)
    unit: str = "m"

    @property
    def as_claimed(self) -> bool:
        """True if the behavior is that of the erratum.

        The axis runs away after a decelerating stop by command 26h alone, unless `lacks_erratum`, and stops on the target with the
        work-around.
        """
        bare, guarded = self.figures
        good = [
            f["n-DRV 2 s later"] == 0 and f["pulses past the target"] == 0 == f["lost steps"] for f in (bare, guarded)
        ]
        return good[1] and (good[0] if self.lacks_erratum else bare["n-DRV 2 s later"] == 1 and bare["lost steps"] > 0)

    def format_table(self) -> str:
        """Return the measured values of both runs, a line for each."""
        from stage.cli.fault.demonstrations import format_measured_values

        return format_measured_values(("", "26h", "stop_by_speed"), self.figures, self.unit)

    def plot(self, path: str | None = None, overwrite: bool = False) -> Any:
        """Draw both runs over time, with the areas of the notice, and return the figure. Needs recordings, and matplotlib."""
        from stage.cli.erratum_plot import draw_erratum_plot

        return draw_erratum_plot(self, path, overwrite)


def run(args: argparse.Namespace) -> int:
    """Demonstrate the failure; return 0 if it happens as claimed."""
    both = args, _rename_files_of_work_around(args)
    for named in both:
        check_outputs(named)
    first, second = (partial(record_for_plot, named, interval=SAMPLE_INTERVAL_S) for named in both)
    result = run_demonstration(partial(_make_stage, args), (first, second))
    name = f"{result.chip}{', mended' if result.lacks_erratum else ''}"
    print(f"{name}: a decelerating stop is commanded in area d\n\n{result.format_table()}")
    bare, guarded = result.figures
    facts = {"chip": result.chip, "mended": result.lacks_erratum, "as_claimed": result.as_claimed}
    add_facts(args, facts | {"26h": bare, "stop_by_speed": guarded})
    draw_plot(args, result.plot)
    print("as claimed" if result.as_claimed else "NOT as claimed")
    return 0 if result.as_claimed else 1


def _rename_files_of_work_around(args: argparse.Namespace) -> argparse.Namespace:
    """Return the options for the second run, which uses the work-around of NOVA's notice; its files get other names."""
    named = {}
    for what in ("record", "vcd", "picture"):
        path = getattr(args, what)
        named[what] = path and str(Path(path).with_stem(f"{Path(path).stem}-work-around"))
    if named["picture"] and not named["record"]:
        named["default_record"] = "stage-work-around.rrd"
    return argparse.Namespace(**vars(args) | named | {"view": False, "web": False})


def _make_stage(args: argparse.Namespace) -> Any:
    """Create the stage that the options describe. Raises StageError for a chip without the failure."""
    from stage import Drive, Stage
    from stage.chips import MCX302, MCX304, MCX312, chip_class

    cls = chip_class(args.chips)
    if not issubclass(cls, (MCX302, MCX304, MCX312)):
        raise StageError(f"--chips {args.chips}: the failure is one of MCX302, MCX304, MCX312.")
    motor = {} if args.motor is None else {"motor": args.motor}
    drive = Drive(microsteps=args.microsteps, bus_voltage=args.bus_voltage, **motor)
    chips = partial(cls, errata=not args.mended)
    return Stage(args.model, chips=chips, drives=drive, bus_cycle=args.bus_cycle)


def run_demonstration(
    make: Callable[[], Any], records: tuple[RecordingFactory | None, RecordingFactory | None] = (None, None)
) -> ErratumResult:
    """Make the move on two stages: first with the work-around, then with command 26h alone.

    Args:
        make: Function that returns a new stage.
        records: Functions that return the context manager of a recording, for the run with 26h and for the one with the work-
            around.
    """
    from stage.cli.fault.host_programs import get_first_axis

    figures, recordings = [], []
    for program, record in ((_stop_by_speed, records[1]), (_stop_by_26h, records[0])):  # a viewer shows the last one
        stage = make()
        show_status(f"{program.__name__.removeprefix('_stop_')}: the move ...")
        context: AbstractContextManager = record(stage) if record else nullcontext()
        with context as recording:
            figures.append(_drive_s_curve(stage, program))
        recordings.append(recording)
    x = get_first_axis(stage)
    return ErratumResult(
        type(x.chip).__name__, not x.chip.errata, (figures[1], figures[0]), (recordings[1], recordings[0]), x.unit
    )


def _stop_by_26h(port: Any) -> bool:
    """Send the command 26h of a decelerating stop, and return True."""
    from stage.firmware.nova import s_curve_workarounds

    port.write_command(s_curve_workarounds.DECELERATING_STOP)
    return True


def _stop_by_speed(port: Any) -> bool:
    """Command a decelerating stop by the work-around, and return whether it is under way."""
    from stage.firmware.nova.s_curve_workarounds import compute_judgmental_speed, stop_by_speed

    return stop_by_speed(port, compute_judgmental_speed(MOVE["SV"], MOVE["V"]))


def _drive_s_curve(stage: Any, stop: Callable[[Any], bool]) -> MeasuredValues:
    """Drive an S-curve that ends 5 mm before EL+, by bus cycles, and return its measured values.

    Args:
        stage: The stage.
        stop: Function of the chip's port that commands a stop; it is called once RR1 shows area d, until it returns True.
    """
    from stage.cli.fault.host_programs import find_switch_position, get_first_axis
    from stage.firmware.nova import s_curve_workarounds

    x = get_first_axis(stage)
    end = find_switch_position(x, "el_plus")
    stage.place(**{x.name: end - TARGET_TO_LIMIT_M - PULSES * x.meters_per_pulse})
    port = s_curve_workarounds.open_port(x)
    port.write_parameters(**MOVE)
    port.write_mode_words(WR2=s_curve_workarounds.LIMIT_DECELERATION_MASK, WR3=s_curve_workarounds.S_CURVE)
    port.start_drive(PULSES)
    while not port.read_status_register(1) & s_curve_workarounds.DSND:
        x.wait(1e-3)
    while port.read_status_register(1) & s_curve_workarounds.DSND:
        x.wait(5e-4)
    x.wait(1e-6 * MOVE["K"])  # area d lasts 2 K us
    left = PULSES - port.read_position()
    given = stop(port)
    status = port.read_status_register(1)
    x.wait(OBSERVATION_S)
    away = port.is_driving()
    speed = port.read_speed() * MULTIPLE
    figures: MeasuredValues = {
        "pulses left in area d": left,
        "26h given": "yes" if given else "no",
        "ASND CNST DSND then": " ".join(
            str(int(bool(status & bit)))
            for bit in (s_curve_workarounds.ASND, s_curve_workarounds.CNST, s_curve_workarounds.DSND)
        ),
        "n-DRV 2 s later": int(away),
        "speed, pps": speed,
        "pulses past the target": port.read_position() - PULSES,
        "position, mm": x.position * 1e3,
        "beyond EL+, mm": max(x.position - end, 0.0) * 1e3,
        "lost steps": x.lost_steps,
    }
    port.write_command(s_curve_workarounds.SUDDEN_STOP)
    x.wait(0.3)
    return figures
