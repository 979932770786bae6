"""Commands with JSON, with models that are not usual, with wires; what options become; facts; words of wrong usage."""

import argparse
import contextlib
import io
import math
from types import SimpleNamespace

import numpy as np
from recorded.recorded_cli import group
from recorded.recorded_texts import tried
from recorded.store import digits

from stage import Drive, Stage
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MS
from stage.cli import build_parser, demo, facts, files, output, parser, quantities, setup, tune
from stage.cli.arguments import options
from stage.cli.fault import DEMOS
from stage.cli.fault.demo import Shown, table
from stage.cli.fault.programs import first_axis, touch

LINES = """
move x 800 --json --model xy
sync x=400 y=-100 --json --rate 3000 --model xy
dual-rate x 12000 --json --model xy --from -20
move x 999999 --json --model xy --fh1 40000
list motors
list motors --json
list models --json
view gantry --text
view xya --text --json
new-model --json --axes a:hinge:90deg
new-model --axes x:slide:90mm,a:hinge:360deg -o m.xml
new-model --axes x:slide:90mm -o m.xml
new-model --axes x:slide:90mm -o m.txt
new-model --axes x:slide:90mm,x:slide:90mm
view m.xml --text
view m.xml --text --json
home x --model m.xml
home a --model m.xml --from 0.5rad
move a -30deg --model m.xml
move a 1mm --model m.xml
move x 44mm --model m.xml
move x 60mm --model m.xml --from 44mm
move a 400deg --model m.xml --fh1 40000
sync x=10mm a=-45deg --model m.xml
sync x=10mm a=-45deg --model m.xml --chips x=mcx304,a=mcx514
move x 5 --model m.xml --chips x=mcx304,x=mcx514
move x 5 --model m.xml --chips x=
move x 5mm --model m.xml --chips a=mcx304,x=hctl1100
move x 500 --model m.xml --wiring x.org=positive --wiring x.el_plus=positive
move x 500 --model m.xml --wiring x.org
move x 500 --model m.xml --wiring x.ez=positive
move x 500 --model m.xml --syni a=x
move x 500 --model m.xml --syni a
move x 500 --model m.xml --syni a=x,a=x
move x 500 --model m.xml --multichip x,
move x 500 --model m.xml --multichip x,a --chips mcx514
move y 500 --model gantry
move w 5mm --model gantry --json --from -3
sync x=200 y=500 --model gantry
sync w=500 y=500 --model gantry
home y --model gantry --by index
home y --model gantry --ez 1
home y --model gantry --fh2 900
home x --model xy --by stall
home x --model xy --by index --chips mcx304 --from 0.2
example
example --json
example stall
example stall
example stall --force
example acme_chip
example stal
fault stuck-closed --model xy
fault stuck_open --model xy --json
fault start-skew --model xy
fault start-skew --model xy --chips mcx514
fault phase-open --model xy --chips hctl1100
fault lost-write --model m.xml --chips a=mcx304,x=pcl240k
fault jam --model m.xml --chips a=pcl240k
fault bounce --model xy --chips hctl1100
tune xy --distance 10mm --seed -1 --by formula
tune xy --distance 10 --axis q --by formula
tune xy --distance 100 --settle 1mm 0ms --by formula
tune xy --distance 100 --overshoot 1deg --by formula
tune xy --distance 100 --spare 5x --by formula
"""

WRONG = """
mov x 100
move x 100 --fh 200
move x 100 mm
move x 100 --json --fh 200
move
sync
registers
registers --json
move x 100 --motr 17HS4401
list motor
list
panel --json
completion csh
serve --listen 99999
serve --listen x
move x 100 --fh1 10mm
move x 100 --fh1 1,5
move x 100 --accel 5pps
move x 100 --bus-voltage 5kg
run a.c --for 5m
mcp --moves 0x1g
mcp xy --mode truths
fault --plots a.png
bench-submit
home -x
"""


def session(folder):
    """Commands one after the other, in one folder; the files there at the end."""
    found = group(SESSION, folder)
    for line, said in found.items():
        if len(said["out"]) > 60:
            found[line] = {**said, "out": [len(said["out"]), digits("\n".join(said["out"]), 4)]}
    return found | {
        "files": sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and "/." not in str(p))
    }


def wrong():
    """What is said of wrong usage, and its code."""
    found = {}
    made = build_parser()
    for line in WRONG.split("\n"):
        if not line:
            continue
        err = io.StringIO()
        with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
            try:
                made.parse(line.split())
                code = "taken"
            except SystemExit as end:
                code = end.code
        found[line] = [code, err.getvalue()]
    found["left over"] = [parser._no_option(w) for w in ("-2mm", "-2", "-.5deg", "-x", "--x", "-5e3", "2mm", "-2 mm")]
    found["examples"] = parser.examples([("a", "does a"), ("bc", ""), ("x" * 70, "long")], "more")
    found["unknown"] = [
        parser.unknown("k", g, ["alpha", "beta"], both) for g in ("alpa", "z") for both in (False, True)
    ]
    return found


def optioned():
    """What options become: stages, encoders, wires, speeds, profiles, distances, places, warnings."""
    found = {}
    words = {
        "usual": "move x 5",
        "servo": "move x 5 --chips hctl1100 --motor 9233S013",
        "both": "move x 5 --chips x=pcl240ms,y=hctl1100 --motor 14201S003",
        "drive": "move x 5 --model xy --motor 17HS15-1504S --microsteps 8 --bus-voltage 36V --bus-cycle 2us",
        "two": "move x 5 --chips y=mcx304,x=pcl240k --microsteps 4",
        "run": "run a.c --model xy --chips mcx514 --encoder x=2e5 --encoder y=-400/turn --clock 8MHz --place x=5mm --place y=-3",
        "run bad": "run a.c --model xy --chips mcx514 --encoder x=2e5/turns",
        "run encoder": "run a.c --encoder =5",
        "run 0": "run a.c --encoder x=0",
        "run nan": "run a.c --encoder x=nan",
        "wires": "move x 5 --chips pcl240ms --wiring x.org=positive --wiring x.ez=positive --wiring y.el_plus=positive --syni y=x",
        "place": "run a.c --model xy --place x=999",
        "place of hinge": "run a.c --model xya --place a=90deg --place x=1cm",
        "place bad": "run a.c --model xya --place a=5mm",
        "place comma": "run a.c --model xy --place x=1,5",
    }
    for name, line in words.items():
        args = build_parser().parse(line.split())
        stage = tried(setup.make_board if line.startswith("run") else setup.make_stage, args)
        if isinstance(stage, str):
            found[name] = stage
            continue
        stage = getattr(stage, "stage", stage)
        found[name] = [
            repr(stage),
            [[a.drive.title, a.supply, a.wiring, a.position, type(a.drive).__name__] for a in stage.axes.values()],
            stage.state.bus,
            [c.clock_hz for c in stage.chips],
            stage.state.axis_table["counts"],
            [p for p in stage.header.parts if "SYNI" in p[0] or "enc" in p[0]],
        ]
    for cls in (PCL240K, PCL240MS, MCX514, MCX304, HCTL1100):
        x = Stage("xy", chips=cls, visuals=False).axes["x"]
        for given in (
            {},
            {"fl": 500.0},
            {"fh1": 700.0},
            {"accel": 0.2},
            {"accel": 0.2, "decel": 0.1},
            {"decel": 0.3, "fh1": 4e4},
            {"fh1": -1.0},
            {"accel": math.inf},
        ):
            args = argparse.Namespace(**given)
            found[f"{cls.__name__} {given}"] = [
                tried(setup.speeds, args, x),
                str(tried(setup.profile, args, x)) if issubclass(cls, PCL240K) else 0,
            ]
    axes = [*Stage("xya", visuals=False).axes.values(), Stage("xy", chips=HCTL1100, visuals=False).axes["x"]]
    for axis in axes:
        found[f"{axis.name} {axis.chip.SERVO}"] = [
            str(tried(setup.distance, axis, t))
            for t in (
                "8000",
                "0x20",
                "-5",
                "1.5",
                "10mm",
                "-0.5deg",
                "2cm",
                "3rad",
                "1,5mm",
                "mm",
                "1e3",
                "0",
                "0.0001mm",
                " 7 ",
                "infmm",
            )
        ]
        warned = SimpleNamespace(json=True)
        ends = [s.touch for s in axis.plant.switches if s.pin == "el_plus"] or [axis.travel[1]]
        reach = round(ends[0] / axis.meters_per_pulse)
        found[f"{axis.name} {axis.chip.SERVO} ends"] = [
            [setup.told_of_its_end(warned, axis, n) - n for n in (reach, reach + 3, -reach - 9999, 10 * reach, 0)],
            getattr(warned, "warnings", []),
        ]
    found["find"] = str(tried(setup.find_axis, axes[0].stage, "z"))
    return found


def told():
    """Facts as JSON has them, warnings, errors, what is not there at an interruption; text that cannot be printed."""
    found = {
        "plain": facts.plain(
            {
                1: (2, 3.0),
                "n": math.nan,
                "i": math.inf,
                "a": np.arange(3),
                "d": Drive(),
                "b": True,
                "f": np.float64(0.5),
                "p": PCL240K,
                "s": {1},
            }
        )
    }
    for as_json in (False, True):
        args = SimpleNamespace(
            json=as_json, wrote=["a.rrd"], output="a.rrd", record=None, vcd="b.vcd", trace="-", plot="c.png"
        )
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out):
            facts.warn(args, "one")
            facts.warn(args, "two")
            facts.fail(args, ValueError("v"))
            facts.fail(args, ValueError("v"), "other words")
            facts.tell(args, {"a": 1}, b=2)
            facts.tell(args, c=math.nan)
            facts.wrote(args, "d.png", "drawn")

            def work(given):
                print("a text that nobody sees")
                facts.tell(given, e=5)
                return 1

            code = facts.as_json(work, args)
            with contextlib.suppress(KeyboardInterrupt):
                facts.as_json(stopped, args)
            facts.as_json(lambda given: facts.tell(given, [1, 2]) or 0, args)
        found[str(as_json)] = [
            code,
            out.getvalue(),
            err.getvalue(),
            facts.interrupted(args),
            facts.interrupted(SimpleNamespace()),
            args.wrote,
            getattr(args, "warnings", []),
        ]
    found["broken"] = []
    for error in (BrokenPipeError(32, "Broken pipe"), OSError(28, "No space left on device")):
        err = io.StringIO()
        with contextlib.redirect_stderr(err), contextlib.redirect_stdout(Broken(error)):
            code = output.printing(lambda: print("a", flush=True) or print("b") or 1)
        found["broken"].append([code, err.getvalue()])
    return found


def stopped(args):
    facts.tell(args, far=3)
    raise KeyboardInterrupt


class Broken(io.StringIO):
    """Takes nothing."""

    def __init__(self, error):
        super().__init__()
        self.error = error

    def write(self, text):
        raise self.error


def small(folder):
    """Names that are free, quantities, ports, shares, distances that were meant, ways of the demonstration, tables."""
    found = {}
    for name in ("demo.rrd", "demo-2.rrd", "demo-3.rrd"):
        found[f"free before {name}"] = [
            files._free("demo.rrd", False),
            files._free("demo.rrd", True),
            files._free("x.vcd", False),
        ]
        (folder / name).write_text("a")
    for q in (
        quantities.RATE,
        quantities.TIME,
        quantities.VOLTAGE,
        quantities.MASS,
        quantities.FREQUENCY,
        quantities.HERTZ,
    ):
        found[q.kind + type(q).__name__] = [
            said(q, t)
            for t in (
                "5",
                "5kpps",
                "5ms",
                " 3 min",
                "2min",
                "12V",
                "300mV",
                "4kg",
                "7g",
                "8MHz",
                "1.5Hz",
                "0x10",
                "1,5",
                "x",
                "",
                "-2",
                "1e3",
            )
        ]
    found["numbers"] = [
        [said(f, t) for t in ("0", "0x1f", "65535", "65536", "-1", "1.5", "a")] for f in (options.number, options.port)
    ]
    found["spare"] = [
        str(tried(tune._spare, t, p))
        for t in ("30%", "0%", "0.6", "600g", "5x", "-1", "30%x", "nan", "1kg")
        for p in (0.0, 2.0)
    ]
    stage = Stage("xya", visuals=False)
    x, a = stage.axes["x"], stage.axes["a"]
    found["meant"] = [tune._meant(axis, t) for axis in (x, a) for t in ("10", " 5 ", "10mm", "x")]
    found["settle"] = [
        str(tried(tune._settle, axis, g))
        for axis in (x, a)
        for g in (None, ["5um", "20ms"], ["5mdeg", "1s"], ["0um", "1ms"], ["5um", "1"], ["5", "1ms"])
    ]
    found["ways"] = [
        [demo._way(axis, share) for share in (0.3956, -0.3956, 0.9, -0.9, 1e-4, 1e-7, 0.0)] for axis in (x, a)
    ]
    stage.place(x=0.06)
    found["ways of 60 mm"] = [demo._way(x, share) for share in (0.3956, 0.2, -0.2, -0.3956)]
    found["table"] = demo._table(
        [
            ("x", "move", "+5", "+5", "1.0", "9", "1 mm", "0", "R0", "yes"),
            ("long name", "m", "", "", "", "", "", "", "", "NO"),
        ]
    )
    both = (
        {"a, mm": 1.5, "b, um": 2.0, "c": 3, "d": 0.123456, "e, f": "x"},
        {"a, mm": 2.5, "b, um": -2.0, "c": 4, "d": -0.5, "e, f": "y"},
    )
    found["tables"] = [table(("", "one", "two"), both, unit) for unit in ("m", "rad")]
    for name, d in DEMOS.items():
        for servo in (False, True):
            one = d.of(servo)
            found[f"{name} {servo}"] = [digits(one.claim + one.notice), one.draws, one.close_up]
    shown = Shown("jam", DEMOS["jam"], both, (None, None), "rad", 0.5)
    found["screw"] = shown._as_of_the_screw(both[0])
    found["touch"] = [str(tried(touch, axis, pin)) for axis in (x, a) for pin in ("org", "el_plus", "nothing")] + [
        first_axis(stage).name
    ]
    return found


def said(call, text):
    try:
        return call(text)
    except (argparse.ArgumentTypeError, ValueError) as error:
        return str(error)


SESSION = [line for line in LINES.split("\n") if line]
FILES = {
    "own_commands": {
        "session": session,
        "wrong": wrong,
        "optioned": optioned,
        "told": told,
        "small": small,
    },
}
