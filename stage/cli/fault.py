"""`stage fault`: one thing breaks, and the same program runs on a healthy stage and on a faulty one.

A demonstration is a program with a fault in it, the figures that it measures, and what was claimed of them. `show` serves the
command, the tests and docs/faults.md.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from stage.cli.setup import is_pcl240, make_stage, note, outputs, plot, recorded
from stage.errors import StageError, unknown

DONE = ("R0 = 0", "all pulses")
"""What ends a move that nothing else ends: of a PCL-240, of a NOVA chip."""
EVERY = 2.5e-4  # s between the samples of a picture
Figures = dict[str, Any]
Strike = Callable[..., AbstractContextManager]
Record = Callable[[Any], AbstractContextManager]


@dataclass(frozen=True)
class Demo:
    """A fault shown.

    claim: what happens, in a sentence. notice: how a host can tell. program(stage, strike): runs, and returns its figures;
    strike(fault, *args) makes the fault on the faulty stage, nothing on the healthy one. happened(healthy, faulty): the
    claim, in figures. draws: two columns of the first axis' recording for the picture; close_up: from when to when, s.
    pcl240_only: its program, or the figures of its claim, are those of the PCL-240.
    """

    claim: str
    notice: str
    program: Callable[[Any, Strike], Figures]
    happened: Callable[[Figures, Figures], bool]
    draws: tuple[str, str] = ("position", "lost_steps")
    close_up: tuple[float, float] | None = None
    pcl240_only: bool = False


@dataclass(frozen=True)
class Shown:
    """What came of it: figures and recordings (None where none was kept) of the healthy run and of the faulty one.

    unit: "m", or "rad" where the first axis is a hinge; figures whose names end in mm and um are then mrad and urad.
    """

    name: str
    demo: Demo
    figures: tuple[Figures, Figures]
    recordings: tuple[Any, Any] = field(repr=False)
    unit: str = "m"

    @property
    def as_claimed(self) -> bool:
        return self.demo.happened(*self.figures)

    def table(self) -> str:
        """The figures of both runs, a line each."""
        healthy, faulty = self.figures
        rows = [
            ("", "healthy", "faulty"),
            *((named(k, self.unit), _text(v), _text(faulty[k])) for k, v in healthy.items()),
        ]
        widths = [max(len(r[k]) for r in rows) for k in range(3)]
        return "\n".join("  ".join(v.ljust(w) for v, w in zip(r, widths, strict=True)).rstrip() for r in rows)

    def plot(self, path: str | None = None, overwrite: bool = False) -> Any:
        """Both runs over time. Saves to `path` if given; returns the figure. Needs recordings, and matplotlib."""
        return _draw(self, path, overwrite)


def run(args: argparse.Namespace) -> int:
    """List the faults, or show one; exit code 0 if what was claimed happened."""
    from stage.chips import FAMILIES, chip_class
    from stage.chips.pcl240 import PCL240

    if args.name is None:
        width = max(map(len, DEMOS)) + 2
        print("\n".join(f"{name:{width}}{demo.claim}" for name, demo in DEMOS.items()))
        return 0
    demo, chips = DEMOS[_key(args.name)], chip_class(args.chips)
    if chips.SERVO or (demo.pcl240_only and not issubclass(chips, PCL240)):
        which = "of steppers" if chips.SERVO else f"of the PCL-240 family ({', '.join(FAMILIES['pcl240'])})"
        raise StageError(
            f"--chips {args.chips}: the demonstration of {args.name} is {which}. The faults themselves are those of any stage: "
            "stage.faults, docs/faults.md."
        )
    outputs(args)
    shown = show(args.name, partial(make_stage, args), partial(_kept, args), args.plot is not None)
    print(f"{shown.name}: {shown.demo.claim}\n\n{shown.table()}\n\nHow a host can tell: {shown.demo.notice}")
    plot(args, shown.plot)
    print("happened as claimed" if shown.as_claimed else "did NOT happen as claimed")
    return 0 if shown.as_claimed else 1


@contextmanager
def _kept(args: argparse.Namespace, stage: Any) -> Any:
    """The recording of the faulty run: what the options ask for, and in any case what a picture is made of."""
    with recorded(args, stage) as recording:
        if recording is None and args.plot:
            with stage.record(EVERY) as recording:
                yield recording
        else:
            yield recording


def _key(name: str) -> str:
    """The demonstration's name as DEMOS has it. Raises ArgumentError with near misses."""
    key = name.lower().replace("_", "-")
    if key not in DEMOS:
        raise unknown("fault", name, DEMOS)
    return key


def show(name: str, make: Callable[[], Any], record: Record | None = None, record_both: bool = False) -> Shown:
    """Run a demonstration on two stages that `make()` makes, the healthy one first.

    record(stage): context manager of the faulty run's recording, or None; record_both: the healthy run's is kept as well.
    Raises ArgumentError for an unknown name, with the near misses.
    """
    key = _key(name)
    demo = DEMOS[key]
    stage = make()
    note(f"{key}: the healthy run ...")
    with stage.record(EVERY) if record_both else nullcontext() as healthy_record:
        healthy = demo.program(stage, lambda *_: nullcontext())
    stage = make()
    note(f"{key}: the faulty run ...")
    with record(stage) if record else nullcontext() as faulty_record:
        faulty = demo.program(stage, lambda fault, *args: fault(*args))
    return Shown(key, demo, (healthy, faulty), (healthy_record, faulty_record), _first(stage).unit)


def named(figure: str, unit: str) -> str:
    """What a figure is called in a table: its mm and um are thousandths and millionths of `unit`."""
    what, comma, scale = figure.rpartition(", ")
    return f"{what}{comma}{scale[0]}{unit}" if comma and scale in ("mm", "um") else figure


def _text(value: Any) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)


def _draw(shown: Shown, path: str | None, overwrite: bool) -> Any:
    from stage.drives.picture import ACCENT, GRID, INK, MUTED
    from stage.files import save_figure
    from stage.recording.recording import COLUMNS
    from stage.recording.signals import rates

    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise StageError("drawing needs matplotlib: pip install 'pulsestage[plot]'.") from error
    figure = Figure(figsize=(9, 5.2), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    low, high = shown.demo.close_up or (-math.inf, math.inf)
    struck = [n.time for n in shown.recordings[1].notes if n.text.endswith("begins")]
    for panel, column in zip(panels, shown.demo.draws, strict=True):
        unit = COLUMNS[column][0] if column in COLUMNS else None
        unit, scale = (f"m{shown.unit}", 1e3) if unit == "m" else (unit, 1)
        for recording, style in zip(shown.recordings, ((MUTED, 2.6, "healthy"), (ACCENT, 1.4, "faulty")), strict=True):
            axis = next(iter(recording.axes))
            to_the_clock = unit is None or column == "rate"
            if to_the_clock:
                course = recording.journals[axis].course()
                time = recording.began + course.seconds
                values = course.pin(column) if unit is None else rates(course.edges, course.clock_hz)
            else:
                time, values = recording.column("time"), recording.column(f"{axis}/{column}") * scale
            drawn = {"color": style[0], "linewidth": style[1], "label": style[2]}
            panel.plot(time, values, drawstyle="steps-post" if to_the_clock else "default", **drawn)
        if unit is None:
            panel.set_yticks([0, 1], ["off", "on"])
        for when in struck[:1] if low <= struck[0] <= high else ():
            panel.axvline(when, color="#c53030", linewidth=1, linestyle=(0, (4, 2)), label="the fault begins")
        panel.set_ylabel(f"{column.replace('_', ' ')}{f' ({unit})' if unit else ''}", color=INK)
        panel.grid(True, color=GRID, linewidth=0.7)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].legend(frameon=False, fontsize=9)
    panels[1].set_xlabel("time (s)", color=INK)
    if shown.demo.close_up:
        panels[0].set_xlim(shown.demo.close_up)
    figure.suptitle(
        shown.recordings[1].notes[0].text.removesuffix(": begins"), x=0.01, ha="left", color=INK, weight="bold"
    )
    if path is not None:
        save_figure(figure, path, 150, overwrite)
    return figure


# --- programs ---


def _first(stage: Any) -> Any:
    return next(iter(stage.axes.values()))


def _touch(axis: Any, pin: str) -> float:
    """Where on its way the axis trips a switch, m."""
    return next(s.touch for s in axis.plant.switches if s.pin == pin)


def _start(axis: Any, pulses: int, armed: Callable[[Any], None] = lambda port: None, **speeds: Any) -> Callable:
    """Start a preset move by bus cycles. Returns a function that waits for its end, and for the motor, and gives the figures.

    armed(port) is called when everything but the start command is written.
    """
    from stage.firmware import Port, Profile
    from stage.firmware.driver import Speeds, driver_of, wait_until_stopped
    from stage.firmware.pcl240 import bus

    count, start, lost, net = abs(pulses), axis.position, axis.lost_steps, axis.chip.net(axis.chip_axis)

    def moved(reason: str) -> Figures:
        axis.wait(0.3)
        return {
            "stopped by": reason,
            "pulses made": axis.chip.net(axis.chip_axis) - net,
            "carriage moved, mm": (axis.position - start) * 1e3,
            "lost steps": axis.lost_steps - lost,
        }

    if not is_pcl240(axis):
        driver = driver_of(axis)
        driver.start(pulses, Speeds(speeds["fl"], speeds["fh1"], speeds["accel"], speeds["accel"]))

        def finish() -> Figures:
            wait_until_stopped([axis], 60.0)
            return moved(driver.stopped_by() or DONE[1])

        return finish
    profile = Profile.of(clock_hz=axis.chip.clock_hz, chip=type(axis.chip), **speeds).within(count)
    port = Port(axis)
    port.command(bus.RESET)
    port.write_registers(**profile.registers(), R0=count, R6=profile.down_point(count))
    port.control(bus.PRESET | (bus.MINUS if pulses < 0 else 0))
    armed(port)
    port.command(bus.RAMP["FH1"])
    patience = 1.5 * profile.seconds(count) + 1
    return lambda: moved(bus.stop_reason(port.wait_until_stopped(patience), pulses))


def _stuck_open(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = _first(stage)
    stage.place(**{x.name: _touch(x, "el_plus") - 0.010})
    with strike(faults.switch_stuck, x, "el_plus", False):
        figures = _start(x, 16_000, fl=1000, fh1=10_000, accel=0.1)()
        return figures | {"beyond EL+, mm": (x.position - _touch(x, "el_plus")) * 1e3}


def _stuck_closed(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = _first(stage)
    finish = _start(x, 32_000, fl=1000, fh1=20_000, accel=0.2)
    x.wait(0.5)
    with strike(faults.switch_stuck, x, "el_plus", True):
        figures = finish()
        return figures | {"before EL+, mm": (_touch(x, "el_plus") - x.position) * 1e3}


def _bounce(stage: Any, strike: Strike) -> Figures:
    from stage import faults
    from stage.firmware import Port, Profile, origin_return
    from stage.firmware.pcl240 import bus

    x = _first(stage)
    with strike(faults.bounce, x, "org", 3e-3):
        stage.place(**{x.name: _touch(x, "org") + 0.002})
        port = Port(x)
        port.command(bus.RESET)
        port.write_registers(**Profile.of(fl=1000, clock_hz=x.chip.clock_hz, chip=type(x.chip)).registers())
        port.control(bus.ORIGIN | bus.MINUS)
        journal = x.chip.journal()
        port.command(bus.START["FL"])
        first = port.wait_until(lambda s: not s.operating, timeout=5)
        looks = [port.status().org for _ in range(40) if x.wait(1e-4) is None]
        journal.close()
        org = journal.course().pin("org")
        report = origin_return(x)
        return {
            "edges of ORG that the chip saw": int((org[1:] != org[:-1]).sum()),
            "first look after the stop": "ORG" if first.org else "no ORG",
            "looks in 4 ms that saw no ORG": looks.count(False),
            "origin return stopped by": report.stopped_by,
            "origin, um": x.position * 1e6,
        }


def _vane_missing(stage: Any, strike: Strike) -> Figures:
    from stage import faults, firmware

    x = _first(stage)
    with strike(faults.vane_missing, x, "org"):
        report = firmware.origin_return(x)
        return {
            "stopped by": report.stopped_by,
            "pulses made": report.pulses,
            "past ORG, mm": (_touch(x, "org") - x.position) * 1e3,
            "lost steps": report.lost_steps,
        }


def _payload(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = _first(stage)
    stage.set_payload(10.0)
    with strike(faults.payload, stage, 2.0):
        figures = _start(x, 32_000, fl=1000, fh1=60_000, accel=0.09)()
        return {"payload, kg": stage.payload()} | figures


def _voltage(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = _first(stage)
    finish = _start(x, 40_000, fl=1500, fh1=60_000, accel=0.2)
    x.wait(0.3)
    with strike(faults.bus_voltage, x, 8.0):
        return finish()


def _jam(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = _first(stage)
    finish = _start(x, 32_000, fl=1000, fh1=20_000, accel=0.2)
    x.wait(0.5)
    at = x.position
    with strike(faults.jam, x):
        figures = finish()
        return figures | {"on from 0.5 s, mm": (x.position - at) * 1e3}


def _phase_open(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = _first(stage)
    with strike(faults.phase_open, x, "a"):
        figures = _start(x, 16_000, fl=1000, fh1=10_000, accel=0.2)()
    stage.place(**{x.name: -0.05})
    finish = _start(x, 24_000, fl=1000, fh1=20_000, accel=0.2)
    x.wait(0.5)
    with strike(faults.phase_open, x, "a"):
        return figures | {"opened at 20,000 pps: lost steps": finish()["lost steps"]}


def _start_skew(stage: Any, strike: Strike) -> Figures:
    from stage import faults, firmware

    first, second = list(stage.axes.values())[:2]
    with strike(faults.start_skew, first, 5e-3):
        report = firmware.synchronized_move({first.name: 20_000, second.name: -7_500}, stage.axes, rate=20_000)
    return {
        "done": "yes" if report.ok else "no",
        "started within, ms": report.skew * 1e3,
        "off the line, pulses": float(report.deviation.pulses),
        "carriages off the line, um": (report.carriage_deviation or 0.0) * 1e6,
        "finished within, ms": report.finish * 1e3,
    }


def _lost_write(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = _first(stage)
    read_back = []
    with strike(faults.lost_write, x, 2, 16_000 >> 8 & 0xFF):
        figures = _start(x, 16_000, lambda port: read_back.append(port.counter()), fl=1000, fh1=10_000, accel=0.1)()
    return {"R0, read before the start": read_back[0], "diagnostics": len(x.chip.diagnostics)} | figures


DEMOS = {
    "stuck-open": Demo(
        "EL+ stuck open: the chip never stops, the carriage runs onto the hard stop and the motor slips whole turns of four steps.",
        "not at all in the move: R0 runs out as it should. The next origin return needs more pulses or fewer than it should.",
        _stuck_open,
        lambda h, f: h["stopped by"] == "EL+" and h["lost steps"] == 0
        and f["stopped by"] in DONE and f["lost steps"] > 0 and f["lost steps"] % 4 == 0,
    ),
    "stuck-closed": Demo(
        "EL+ sticks closed in a move: the chip stops at once, without a ramp; the carriage runs on, out of step.",
        "at once: halted with R0 not 0, where no end limit is; towards plus nothing moves, the way back is free.",
        _stuck_closed,
        lambda h, f: h["stopped by"] in DONE and f["stopped by"] == "EL+" and f["before EL+, mm"] > 10
        and f["lost steps"] < 0,
        ("position", "rate"),
    ),
    "bounce": Demo(
        "ORG bounces for 3 ms: the chip sees seven edges for one and halts on the first, so the origin is the same to the pulse.",
        "a status byte read within the bounce may say that ORG is off, though ORG has stopped the axis: look again later.",
        _bounce,
        lambda h, f: (h["edges of ORG that the chip saw"], f["edges of ORG that the chip saw"]) == (1, 7)
        and f["looks in 4 ms that saw no ORG"] > 0 and f["origin return stopped by"] == "ORG"
        and abs(f["origin, um"] - h["origin, um"]) < 3.2,
        ("rate", "org"), (0.6385, 0.6485),
        pcl240_only=True,
    ),
    "vane-missing": Demo(
        "The vane of ORG has come off: the origin return passes the origin and ends at EL-.",
        "at once: halted, and the ORG bit of the status byte is off, which leaves the end limit (`stopped_by` EL-).",
        _vane_missing,
        lambda h, f: h["stopped by"] == "ORG" and f["stopped by"] == "EL-" and f["past ORG, mm"] > 1,
        ("position", "org"),
        pcl240_only=True,
    ),
    "payload-doubled": Demo(
        "The payload weighs 20 kg in place of 10: a ramp that 10 kg follow pulls the rotor out of step.",
        "not at all in the move: the chip counts pulses. An origin return afterwards shows it.",
        _payload,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and f["stopped by"] in DONE,
        pcl240_only=True,
    ),
    "bus-voltage": Demo(
        "The supply falls from 24 V to 8 V at speed, below the back-EMF: the current is too little, and the motor stalls.",
        "not at all in the move: the chip counts pulses. An origin return afterwards shows it.",
        _voltage,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and f["stopped by"] in DONE,
    ),
    "jam": Demo(
        "The axis jams in a move: the carriage stops, the chip sends the remaining pulses into a motor that stands.",
        "not at all in the move: the chip counts pulses. An origin return then ends in RunTimeout: pulses run, no switch comes.",
        _jam,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and abs(f["on from 0.5 s, mm"]) < 0.2
        and f["pulses made"] == h["pulses made"],
    ),
    "phase-open": Demo(
        "Phase A is open: a field of one phase has no direction, and from rest the motor shakes or runs off the wrong way.",
        "not at all in the move: the chip counts pulses. An origin return then ends in RunTimeout: pulses run, ORG does not come.",
        _phase_open,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 100
        and f["opened at 20,000 pps: lost steps"] < 0.1 * f["lost steps"],
        ("position", "lost_steps"), (-0.05, 1.98),
        pcl240_only=True,
    ),
    "start-skew": Demo(
        "The CPU is away for 5 ms between two start commands of an a:b move: both axes arrive, and leave the line on the way.",
        "by its clock around the start commands; both axes end on R0 = 0, and their status bytes are as they should be.",
        _start_skew,
        lambda h, f: h["done"] == f["done"] == "yes" and abs(f["started within, ms"] - 5) < 0.1
        and f["off the line, pulses"] > 10 * h["off the line, pulses"],
        ("position", "rate"),
        pcl240_only=True,
    ),
    "lost-write": Demo(
        "The middle byte of R0 does not arrive: the chip runs the move that it was told, 128 pulses in place of 16,000.",
        "by reading R0 back before the start; afterwards the status byte says R0 = 0, as after every good move.",
        _lost_write,
        lambda h, f: h["pulses made"] == 16_000 and f["pulses made"] == 16_000 & 0xFF and f["stopped by"] in DONE
        and f["diagnostics"] == h["diagnostics"],
        ("position", "counter"),
        pcl240_only=True,
    ),
}  # fmt: skip
"""Every fault by name."""
