"""What the command `stage` prints for many command lines, good and bad, and its exit codes."""

import contextlib
import io
import re
from functools import partial

from recorded.store import digits

from stage.cli import build_parser, main

MOVES = """
home --model xy --fh1 20000 --fast-only
home x --from 3
home y --from 85 --plus --fast-only
home x --constant --fl 2000 --from 1
home x --fast-only --from 5
home x --chips pcl240ms --from 2 --ez 1 --fl 2000 --fh1 4000 --accel 0.1
home x --from -60 --fh1 60000 --fh2 60000 --accel 0.15 --fast-only
home x --chips mcx514 --from 2
home x --chips mcx304 --from 2 --fh1 8000
home x --chips hctl1100 --from 1
home x --chips hctl1100 --from 1 --ez 1
move x 1600 --fh1 8000
move x 0x640 --from 10
move y -2mm --constant --fl 900
move y -0.5mm --fl 400 --fh1 3000 --fh2 5000 --accel 0.05 --decel 0.1
move x 3000 --chips pcl240ms --s-curve
move x 3000 --chips pcl240ms --s-curve 0.2 --automatic
move x 3000 --chips pcl240mk --automatic
move x 3000 --chips pcl240mk --no-automatic
move x 2mm --chips mcx514 --s-curve
move x 2mm --chips mcx302
move x -2mm --chips mcx312 --fl 900 --fh1 5000 --accel 0.1
move x 1mm --chips hctl1100
move x -2000 --chips hctl1100 --fh1 20000
move x 8000 --fh1 150000 --fh2 150000 --accel 0.02
move x 40000 --from 110 --fh1 10000
move x 1600 --microsteps 8 --bus-voltage 12 --motor 17HS4401
dual-rate x 12000
dual-rate x -12mm --fh1 6000 --fh2 3000
sync x=4000 y=-1500
sync x=4000 y=-1500 --rate 5000 --fl 500 --accel 0.1
sync x=2mm y=0.5mm --chips pcl240ms --s-curve --automatic
sync x=4000 y=-1500 --chips mcx514
sync x=4000 y=-1500 --chips mcx312 --s-curve
sync x=2000 y=-1000 --chips mcx304
sync x=2000 y=-1000 --chips hctl1100
"""
BAD = """
home q
home x --ez 2
home x --ez 2 --chips mcx514
home x --ez 0 --chips pcl240mk
home x --fl 0
home x --constant --chips mcx514
home x --fast-only --chips hctl1100
home x --from 500
home x --from -99999
move x 0
move x 1e9
move x 99999999
move x 10furlongs
move x 10deg
move x ten
move x 100 --model xyzz
move x 100 --model nowhere.xml
move x 100 --chips PCL241
move x 100 --chips hctl1100 --s-curve
move x 100 --chips HCTL-1100 --constant
move x 100 --chips mcx514 --s-curve 0.2
move x 100 --chips mcx514 --fh2 100
move x 100 --s-curve
move x 100 --automatic
move x 100 --chips pcl240ms --s-curve 0.7
move x 100 --motor 17HS9999
move x 100 --microsteps 0
move x 100 --microsteps 3
move x 100 --bus-voltage -1
move x 100 --bus-cycle -1
move x 100 --fl 9000 --fh1 3000
move x 100 --fh1 1e9
move x 100 --accel -1
move x 100 --record nowhere/x.rrd
move x 100 --record x.txt
move x 100 --vcd a.vcd --record a.vcd
move x 100 --plot x.xyz
move x 100 --picture x.jpg
move
move x
dual-rate x 100 --chips mcx514
dual-rate x 0
sync x=1000 y=500 x=2000
sync x
sync x=
sync q=100
sync x=100
sync x=0 y=0
sync x=100 y=100 --automatic
sync x=100 y=100 --chips hctl1100 --automatic
run nowhere.so
run nowhere.c
run x.so --layout nonsense
run x.so --base abc
run x.so --place x
run x.so --place x=1 --place x=2
run x.so --place q=1
run x.so --cflags "'"
fault nothing
fault stuck --chips mcx514
erratum --chips pcl240k
erratum --chips mcx514
registers pcl240
registers nova
pullout --motor nothing
pullout --microsteps 0
view nothing
nonsense
"""
TOOLS = """
fault
erratum --mended --chips mcx302
fault stuck-open
fault lost-write
view --text
view xy --text
registers pcl240k
registers PCL-240MK
registers pcl240ms
registers mcx514
registers mcx304
registers mcx302
registers mcx312
registers hctl1100
"""


def printed(line, folder):
    """The exit code, standard output and error of a command line."""
    import shlex

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(shlex.split(line))
        except SystemExit as end:  # argparse, whose own words are Python's
            code = end.code
            err = io.StringIO("wrong usage" if code else "")
    said = [clean(some.getvalue(), folder) for some in (out, err)]
    return {"code": code, "out": said[0].splitlines(), "err": said[1].splitlines()}


def clean(text, folder):
    """Without the names of folders, and how long things took."""
    text = re.sub(r"/\S*/(?=\w+\.(xml|so|c)\b)", "", text.replace(str(folder), "FOLDER"))
    return re.sub(r"in [\d.]+ s of wall time", "in ... s of wall time", text)


def group(lines, folder):
    return {line: printed(line, folder) for line in lines}


def options():
    """Every option of every command: its names, default and help."""
    found = {}
    for action in build_parser()._subparsers._group_actions:
        for name, parser in action.choices.items():
            found[name] = [
                f"{' '.join(a.option_strings) or a.dest} = {a.default!r} {a.nargs or ''} {a.metavar or ''}: {a.help}"
                for a in parser._actions
            ]
            found[f"{name}: what it does"] = digits(parser.description or "")
    return found


def lines_of(text):
    return [line for line in text.split("\n") if line]


def parts(lines, size):
    return {f"{k // size + 1}: {lines[k].split()[0]}": lines[k : k + size] for k in range(0, len(lines), size)}


FILES = {
    "cli_moves": {name: partial(group, some) for name, some in parts(lines_of(MOVES), 4).items()},
    "cli_bad": {name: partial(group, some) for name, some in parts(lines_of(BAD), 12).items()},
    "cli_tools": {"options": options}
    | {name: partial(group, some) for name, some in parts(lines_of(TOOLS), 4).items()},
}
