"""`stage erratum`: the S-curve failure of MCX302, MCX304 and MCX312 on a stage, beside a work-around of NOVA's notice.

The same move twice: a decelerating stop is asked for in area d, the end of the deceleration, once by 26h whatever the chip is
doing, once by `stop_by_speed`. `show` serves the command, the tests and docs/erratum.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from stage.cli.facts import tell
from stage.cli.fault import EVERY, Figures, Record
from stage.cli.fault.demo import table
from stage.cli.fault.programs import first_axis, touch
from stage.cli.files import kept, outputs, plot
from stage.cli.progress import note
from stage.errors import StageError

MULTIPLE = 10
MOVE = {"R": 8_000_000 // MULTIPLE, "K": 20_000, "A": 8000, "SV": 400, "V": 2000, "AO": 0}
PULSES = 40_000
SHORT = 5e-3  # m from the target to EL+
LOOK = 2.0  # s after the stop was asked for


@dataclass(frozen=True)
class Shown:
    """The result: figures and recordings (None where none was kept) with the bare 26h and with the work-around.

    unit: as of stage.cli.fault.Shown.
    """

    chip: str
    mended: bool
    figures: tuple[Figures, Figures]
    recordings: tuple[Any, Any] = field(repr=False)
    unit: str = "m"

    @property
    def as_claimed(self) -> bool:
        """As sold, the bare 26h runs away and loses steps; with the work-around, or mended, the drive ends on its target."""
        bare, guarded = self.figures
        good = [
            f["n-DRV 2 s later"] == 0 and f["pulses past the target"] == 0 == f["lost steps"] for f in (bare, guarded)
        ]
        return good[1] and (good[0] if self.mended else bare["n-DRV 2 s later"] == 1 and bare["lost steps"] > 0)

    def table(self) -> str:
        """The figures of both runs, a line each."""
        return table(("", "26h", "stop_by_speed"), self.figures, self.unit)

    def plot(self, path: str | None = None, overwrite: bool = False) -> Any:
        """Both runs over time, and the areas of the notice. Saves to `path` if given; returns the figure. Needs recordings, and
        matplotlib."""
        from stage.cli.erratum_plot import draw

        return draw(self, path, overwrite)


def run(args: argparse.Namespace) -> int:
    """Show the failure; exit code 0 if it is as claimed."""
    beside = _beside(args)
    outputs(args)
    outputs(beside)
    shown = show(partial(_make, args), (partial(kept, args, every=EVERY), partial(kept, beside, every=EVERY)))
    print(
        f"{shown.chip}{', mended' if shown.mended else ''}: a decelerating stop is asked for in area d\n\n{shown.table()}"
    )
    bare, guarded = shown.figures
    facts = {"chip": shown.chip, "mended": shown.mended, "as_claimed": shown.as_claimed}
    tell(args, facts | {"26h": bare, "stop_by_speed": guarded})
    plot(args, shown.plot)
    print("as claimed" if shown.as_claimed else "NOT as claimed")
    return 0 if shown.as_claimed else 1


def _beside(args: argparse.Namespace) -> argparse.Namespace:
    """The options for the run with the work-around: its files have names of their own, and no viewer is opened."""
    named = {}
    for what in ("record", "vcd", "picture"):
        path = getattr(args, what)
        named[what] = path and str(Path(path).with_stem(f"{Path(path).stem}-work-around"))
    if named["picture"] and not named["record"]:
        named["default_record"] = "stage-work-around.rrd"
    return argparse.Namespace(**vars(args) | named | {"view": False, "web": False})


def _make(args: argparse.Namespace) -> Any:
    from stage import Drive, Stage
    from stage.chips import MCX302, MCX304, MCX312, chip_class

    cls = chip_class(args.chips)
    if not issubclass(cls, (MCX302, MCX304, MCX312)):
        raise StageError(f"--chips {args.chips}: the failure is one of MCX302, MCX304, MCX312.")
    motor = {} if args.motor is None else {"motor": args.motor}
    drive = Drive(microsteps=args.microsteps, bus_voltage=args.bus_voltage, **motor)
    chips = partial(cls, errata=not args.mended)
    return Stage(args.model, chips=chips, drives=drive, bus_cycle=args.bus_cycle)


def show(make: Callable[[], Any], records: tuple[Record | None, Record | None] = (None, None)) -> Shown:
    """Make the move on two stages that `make()` makes: with a bare 26h, and, before that, with the work-around.

    records: context managers of the recordings of the one and the other.
    """
    figures, kept = [], []
    for program, record in ((_guarded, records[1]), (_bare, records[0])):  # somebody may watch the last one
        stage = make()
        note(f"{program.__name__.strip('_')}: the move ...")
        context: AbstractContextManager = record(stage) if record else nullcontext()
        with context as recording:
            figures.append(_move(stage, program))
        kept.append(recording)
    x = first_axis(stage)
    return Shown(type(x.chip).__name__, not x.chip.errata, (figures[1], figures[0]), (kept[1], kept[0]), x.unit)


def _bare(port: Any) -> bool:
    from stage.firmware.nova import erratum

    port.command(erratum.DECELERATING_STOP)
    return True


def _guarded(port: Any) -> bool:
    from stage.firmware.nova.erratum import judgmental_speed, stop_by_speed

    return stop_by_speed(port, judgmental_speed(MOVE["SV"], MOVE["V"]))


def _move(stage: Any, stop: Callable[[Any], bool]) -> Figures:
    """An S-curve drive up to 5 mm before EL+, by bus cycles; once RR1 shows area d, stop(port). Its figures."""
    from stage.firmware.nova import erratum

    x = first_axis(stage)
    end = touch(x, "el_plus")
    stage.place(**{x.name: end - SHORT - PULSES * x.meters_per_pulse})
    port = erratum.port_of(x)
    port.load(**MOVE)
    port.mode(WR2=erratum.LIMITS_DECELERATE, WR3=erratum.S_CURVE)
    port.start(PULSES)
    while not port.word(1) & erratum.DSND:
        x.wait(1e-3)
    while port.word(1) & erratum.DSND:
        x.wait(5e-4)
    x.wait(1e-6 * MOVE["K"])  # area d lasts 2 K us
    left = PULSES - port.position()
    given = stop(port)
    status = port.word(1)
    x.wait(LOOK)
    away = port.driving()
    speed = port.speed() * MULTIPLE
    figures: Figures = {
        "pulses left in area d": left,
        "26h given": "yes" if given else "no",
        "ASND CNST DSND then": " ".join(
            str(int(bool(status & bit))) for bit in (erratum.ASND, erratum.CNST, erratum.DSND)
        ),
        "n-DRV 2 s later": int(away),
        "speed, pps": speed,
        "pulses past the target": port.position() - PULSES,
        "position, mm": x.position * 1e3,
        "beyond EL+, mm": max(x.position - end, 0.0) * 1e3,
        "lost steps": x.lost_steps,
    }
    port.command(erratum.SUDDEN_STOP)
    x.wait(0.3)
    return figures
