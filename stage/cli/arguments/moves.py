"""demo, home, move, dual-rate, sync."""

from __future__ import annotations

from typing import Any

from stage.cli.arguments.options import command, place, plot, ramps, speeds, stage_and_outputs
from stage.cli.quantities import RATE, TIME


def add(commands: Any) -> None:
    """These commands."""
    p = command(
        commands, "demo", "demo:run", "origin return, dual-rate and a:b moves; writes demo.rrd",
        "Home all axes, make a dual-rate move and an a:b move, print a table and write a recording.",
        ("stage demo", "all of it on xyz; writes demo.rrd"),
        ("stage demo --chips mcx514 --model xy --no-view", "with other chips, and without a window"),
        ("stage demo --picture demo.png", "the dashboard as a picture, no screen needed"),
    )  # fmt: skip
    stage_and_outputs(p)
    p.set_defaults(default_record="demo.rrd")
    p.add_argument("--no-view", action="store_true", help="do not open the viewer even where there is a screen")
    p = command(
        commands, "home", "moves:home", "origin return",
        "Origin return: find ORG fast (slowed by SD), back off, approach it again slowly.",
        ("stage home", "all axes, one after the other"),
        ("stage home x --from 62mm --plot home.png", "from 62 mm, drawn like the data sheet's operation patterns"),
        ("stage home x --chips mcx514 --by index", "to the encoder's index pulse after the switch"),
    )  # fmt: skip
    p.add_argument("axes", nargs="*", metavar="AXIS", help="axes to home, one after the other (default: all)")
    p.add_argument("--plus", action="store_true", help="search towards plus (default: minus)")
    p.add_argument("--constant", action="store_true", help="constant-speed return at FL")
    p.add_argument("--fast-only", action="store_true", help="without back-off and slow approach")
    p.add_argument(
        "--by", metavar="HOW",
        help="what to home by: switch, index (the encoder's index pulse after it), or what else the chip has, as stall",
    )  # fmt: skip
    p.add_argument("--ez", type=int, metavar="N", help="end at the N-th index pulse after ORG (PCL240MK, PCL240MS)")
    place(p)
    speeds(p)
    plot(p)
    stage_and_outputs(p)
    p = command(
        commands, "move", "moves:move", "a move by pulses, or by a distance",
        "Move by a number of pulses, or a distance, and stop on the last one. On a PCL-240 a preset move: R0 counts the pulses "
        "down, the ramp-down point R6 is set by the data sheet's formula, or found by the chip itself where it can.",
        ("stage move x 8000 --fh1 20000", "8000 pulses, at 20,000 pps"),
        ("stage move x -10mm --chips hctl1100", "10 mm towards minus, by a servo"),
        ("stage move x 8000 --chips pcl240ms --s-curve --plot s.png", "an S-curve, drawn"),
    )  # fmt: skip
    p.add_argument("axis", metavar="AXIS")
    p.add_argument(
        "distance", metavar="DISTANCE", help="pulses (of a servo counts), or 10mm, 30deg; the sign is the direction"
    )
    p.add_argument("--constant", action="store_true", help="constant speed, no ramps")
    place(p)
    speeds(p)
    ramps(p)
    plot(p)
    stage_and_outputs(p)
    p = command(
        commands, "dual-rate", "moves:dual_rate", "FL to FH1 to FH2 and back in one move",
        "A dual-rate move: ramp to FH1, in motion on to FH2 (or down to it) and back, then stop on the pulse. With --rates any "
        "order of the three: FL,FH1 is the data sheet's dual rate mode (1), ramping up; FH1,FL its mode (2), ramping down.",
        ("stage dual-rate x 40000 --fh1 10000 --fh2 20000", "two rates in one move"),
        ("stage dual-rate x 8000 --rates FL,FH1 --dwell 0.5", "dual rate mode (1): constant FL, then a ramp up to FH1"),
        ("stage dual-rate x 8000 --rates FH1,FL", "dual rate mode (2): FH1, then a ramp down to FL"),
        ("stage dual-rate x 100mm --plot dual.png", "the same over 100 mm, drawn"),
    )  # fmt: skip
    p.add_argument("axis", metavar="AXIS")
    p.add_argument("distance", metavar="DISTANCE", help="pulses, or 10mm, 30deg; the sign is the direction")
    p.add_argument(
        "--rates",
        default="FH1,FH2,FH1",
        metavar="RATE,RATE",
        help="FL, FH1 and FH2 in any order (default: FH1,FH2,FH1)",
    )
    p.add_argument(
        "--dwell", type=TIME, default=0.1, help="seconds at each rate but the last, after its ramp (default: 0.1)"
    )
    place(p)
    speeds(p)
    plot(p)
    stage_and_outputs(p)
    p = command(
        commands, "sync", "moves:sync", "several axes along a straight line, in the ratio a:b",
        "A synchronized move: registers in the ratio of the distances, equal ramp times, one start after the other.",
        ("stage sync x=20000 y=-7500", "two axes along a straight line"),
        ("stage sync x=10mm y=-2mm z=1mm --rate 5000", "three axes, the longest at 5,000 pps"),
        ("stage sync x=20000 y=-7500 --chips mcx514", "by the chip's own interpolation"),
    )  # fmt: skip
    p.add_argument(
        "distances", nargs="+", metavar="AXIS=DISTANCE", help="for example x=20000 y=-7500, or x=10mm y=-2mm"
    )
    p.add_argument("--rate", type=RATE, help="pulse rate of the longest axis, pps")
    p.add_argument("--fl", type=RATE, help="start rate of the longest axis, pps")
    p.add_argument("--accel", type=TIME, help="seconds of ramp")
    ramps(p)
    plot(p)
    stage_and_outputs(p)
