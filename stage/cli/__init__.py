"""The command `stage`.

Exit codes: 0 done as asked; 1 it ran, but not as asked (lost steps, stopped by a limit); 2 wrong usage or an error that
says what to do; 130 interrupted.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from typing import Any

EPILOG = """\
examples:
  stage demo                              home three axes, dual-rate move, a:b move; writes demo.rrd
  stage home x --plot home.png            origin return, drawn like the data sheet's operation patterns
  stage move x 8000 --fh1 20000           a preset move of 8000 pulses
  stage move x 10mm --chips hctl1100      any chip: 10 mm by a servo
  stage move x 8000 --chips pcl240ms --s-curve --plot s.png
  stage sync x=20000 y=-7500              two axes along a straight line, in the ratio a:b
  stage tune xy --payload 2 --distance 100mm     registers for an axis: formula, search, proof
  stage bench-submit formula -o formula.bench    plays the test episodes of a benchmark; `stage bench-verify` replays them
  stage run driver.c --chips pcl240mk     firmware in C drives the chips
  stage panel xy                          a live stage in a browser
  stage serve --chips mcx304              the chips behind a TCP port, for a host elsewhere
  stage fault                             what can break; `stage fault jam --plot jam.png` breaks it
  stage erratum                           the S-curve failure of the MCX304: pulses for ever, and a work-around
  stage chips                             the chips that there are, also those of other packages
  stage registers pcl240k                 the register map
  stage pullout --motor 17HS4401          the pull-out curve

exit codes: 0 done as asked, 1 ran but not as asked (lost steps, limit switch), 2 wrong usage, 130 interrupted
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    from stage.cli.output import printing

    return printing(lambda: _main(argv))


def _main(argv: Sequence[str] | None) -> int:
    from stage.errors import StageError

    parser = build_parser()
    args = parser.parse_args([_distance(text) for text in (sys.argv[1:] if argv is None else argv)])
    if args.run is None:
        parser.print_help()
        return 2
    try:
        return args.run(args)
    except (StageError, FileNotFoundError, PermissionError) as error:
        print(f"stage: {error}", file=sys.stderr)
        return 2
    except (OSError, MemoryError) as error:
        what = getattr(error, "strerror", None) or str(error) or "no memory"
        print(
            f"stage: the system refuses it: {what}. `ulimit -a` shows what this process may have, `df` how full disks are.",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        return 130


def _distance(text: str) -> str:
    """argparse takes -2000 for a number, and -2mm for an option unless there is a blank in it."""
    return f" {text}" if re.match(r"-\.?\d.*[a-z]$", text) else text


def build_parser() -> argparse.ArgumentParser:
    """The whole command line; cheap: nothing heavy is imported before a command runs."""
    from stage import __version__

    parser = argparse.ArgumentParser(
        prog="stage",
        description="Emulated motion-control chips drive an XYZ stage in MuJoCo, register for register.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"pulsestage {__version__}")
    parser.set_defaults(run=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    _add_moves(commands)
    _add_tune(commands)
    _add_bench(commands)
    _add_firmware(commands)
    _add_fault(commands)
    _add_erratum(commands)
    _add_tools(commands)
    return parser


def _command(commands: Any, name: str, run: str, help_: str, description: str) -> argparse.ArgumentParser:
    """A subcommand whose work is the function `module:function`, imported when it runs."""
    p = commands.add_parser(name, help=help_, description=description)

    def call(args: argparse.Namespace) -> int:
        from importlib import import_module

        module, function = run.split(":")
        return getattr(import_module(f"stage.cli.{module}"), function)(args)

    p.set_defaults(run=call)
    return p


PCL240 = ("PCL240K", "PCL240MK", "PCL240MS")
ALL = (*PCL240, "MCX514", "MCX512", "MCX501", "MCX314AS", "MCX304", "MCX302", "MCX312", "HCTL1100")


def _bench(p: argparse.ArgumentParser, chips: Sequence[str] = ALL) -> None:
    g = p.add_argument_group("stage")
    g.add_argument("--model", default="xyz", help="a shipped model (xyz, xy) or an MJCF file (default: xyz)")
    _machine(g, chips)
    _outputs(p)


def _machine(g: Any, chips: Sequence[str] = ALL) -> None:
    others = ", or one that another package brings, see `stage chips`; or x=CHIP,y=CHIP" if chips is ALL else ""
    known = f"chip on every axis: {', '.join(chips)}{others} (default: {chips[0]})"
    g.add_argument("--chips", default=chips[0], help=known)
    g.add_argument("--motor", help="motor on every axis (default: 17HS4401)")
    g.add_argument("--microsteps", type=int, default=16, help="microsteps per full step (default: 16)")
    g.add_argument("--bus-voltage", type=float, default=24.0, help="drive supply, V (default: 24)")
    g.add_argument("--bus-cycle", type=float, default=1e-6, help="seconds a host's bus cycle takes (default: 1e-6)")
    g.add_argument(
        "--wiring",
        action="append",
        default=[],
        metavar="AXIS.SENSOR=LOGIC",
        help="the logic of a sensor, where it is not negative: x.org=positive is high while it is on; ez is the encoder's index",
    )
    g.add_argument(
        "--multichip",
        metavar="AXIS,AXIS",
        help="wire the multichip lines of MCX514 and MCX512 together: an axis of each chip, x,z (see docs/nova.md)",
    )
    g.add_argument(
        "--syni",
        action="append",
        default=[],
        metavar="FOLLOWER=LEADER",
        help="connect SYNI of an axis' chip (PCL-240 family) to SYNO of another's: y=x",
    )


def _outputs(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("output")
    g.add_argument("--record", metavar="FILE.rrd", help="write a rerun recording")
    g.add_argument("--picture", metavar="FILE.png", help="render the recording's dashboard, no screen needed")
    g.add_argument("--vcd", metavar="FILE.vcd", help="write waveforms for GTKWave")
    g.add_argument("--force", action="store_true", help="overwrite files that exist")
    g.add_argument("--view", action="store_true", help="open the recording in the rerun viewer")
    g.add_argument("--web", action="store_true", help="serve the dashboard to a browser, on 127.0.0.1 only")
    g.add_argument("--port", type=int, default=9090, help="port for --web (default: 9090)")


def _speeds(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("speeds (pulses per second; the nearest that the registers reach is used and printed)")
    g.add_argument("--fl", type=float, help="FL: start and stop rate")
    g.add_argument("--fh1", type=float, help="FH1: first high rate")
    g.add_argument("--fh2", type=float, help="FH2: second high rate")
    g.add_argument("--accel", type=float, help="seconds from FL to the highest rate")
    g.add_argument("--decel", type=float, help="seconds back to FL (default: as --accel)")


def _ramps(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("ramps")
    g.add_argument(
        "--s-curve", nargs="?", type=float, const=True, metavar="SHARE",
        help="S-curves; with SHARE (0 to 0.5) that part of the ramp is curved at each end (needs PCL240MS)",
    )  # fmt: skip
    g.add_argument(
        "--automatic", action=argparse.BooleanOptionalAction,
        help="let the chip find the ramp-down point (PCL240MK, PCL240MS)",
    )  # fmt: skip


def _place(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        "--from",
        dest="start",
        type=float,
        metavar="MM",
        help="where the carriage starts, mm; mrad on a hinge (default: 0)",
    )


def _add_moves(commands: Any) -> None:
    p = _command(
        commands, "demo", "demo:run", "origin return, dual-rate and a:b moves; writes demo.rrd",
        "Home all axes, make a dual-rate move and an a:b move, print a table and write a recording.",
    )  # fmt: skip
    _bench(p)
    p.set_defaults(default_record="demo.rrd")
    p.add_argument("--no-view", action="store_true", help="do not open the viewer even where there is a screen")
    p = _command(
        commands, "home", "moves:home", "origin return",
        "Origin return: find ORG fast (slowed by SD), back off, approach it again slowly.",
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
    _place(p)
    _speeds(p)
    _plot(p)
    _bench(p)
    p = _command(
        commands, "move", "moves:move", "a move by pulses, or by a distance",
        "Move by a number of pulses, or a distance, and stop on the last one. On a PCL-240 a preset move: R0 counts the pulses "
        "down, the ramp-down point R6 is set by the data sheet's formula, or found by the chip itself where it can.",
    )  # fmt: skip
    p.add_argument("axis", metavar="AXIS")
    p.add_argument(
        "distance", metavar="DISTANCE", help="pulses (of a servo counts), or 10mm, 30deg; the sign is the direction"
    )
    p.add_argument("--constant", action="store_true", help="constant speed, no ramps")
    _place(p)
    _speeds(p)
    _ramps(p)
    _plot(p)
    _bench(p)
    p = _command(
        commands, "dual-rate", "moves:dual_rate", "FL to FH1 to FH2 and back in one move",
        "A dual-rate move: ramp to FH1, in motion on to FH2 (or down to it), then stop on the pulse.",
    )  # fmt: skip
    p.add_argument("axis", metavar="AXIS")
    p.add_argument("distance", metavar="DISTANCE", help="pulses, or 10mm, 30deg; the sign is the direction")
    _place(p)
    _speeds(p)
    _plot(p)
    _bench(p)
    p = _command(
        commands, "sync", "moves:sync", "several axes along a straight line, in the ratio a:b",
        "A synchronized move: registers in the ratio of the distances, equal ramp times, one start after the other.",
    )  # fmt: skip
    p.add_argument(
        "distances", nargs="+", metavar="AXIS=DISTANCE", help="for example x=20000 y=-7500, or x=10mm y=-2mm"
    )
    p.add_argument("--rate", type=float, help="pulse rate of the longest axis, pps")
    p.add_argument("--fl", type=float, help="start rate of the longest axis, pps")
    p.add_argument("--accel", type=float, help="seconds of ramp")
    _ramps(p)
    _plot(p)
    _bench(p)


TUNE = """\
examples:
  stage tune xy --payload 2 --distance 100mm                   a PCL-240 on the X axis of xy: prints registers, bytes and C
  stage tune xy --payload 2 --distance 100mm -o tuned          the same as files, with a picture
  stage tune my.xml --axis z --chips mcx514 --motor 17HS4401 --payload 0.5 --spare 0.2 --distance 20mm
  stage tune xy --distance 8000 --settle 20um 100ms --by formula      without Optuna

docs/tuning.md says how it works, and what the proof proves.
"""


def _add_tune(commands: Any) -> None:
    p = _command(
        commands, "tune", "tune:run", "registers for an axis: formula, search, proof",
        "Find the registers of one move of an axis: by the data sheet's formula, then by a search that keeps a margin, and prove "
        "them by moves that the search has not seen. Prints registers, bus bytes and a C header.",
    )  # fmt: skip
    p.epilog, p.formatter_class = TUNE, argparse.RawDescriptionHelpFormatter
    p.add_argument("model", nargs="?", default="xyz", help="a shipped model (xyz, xy) or an MJCF file (default: xyz)")
    p.add_argument("--axis", help="the axis (default: the first of the model)")
    p.add_argument("--distance", help="of the move: 100mm, 30deg, or pulses (of a servo counts)")
    p.add_argument("--payload", type=float, default=0.0, metavar="KG", help="that it carries at most (default: 0)")
    p.add_argument(
        "--payload-on",
        metavar="NAME",
        help="body or site that carries it (default: site work, if it rides on the axis, else what the axis moves)",
    )
    p.add_argument(
        "--spare",
        default="30%",
        metavar="KG|PERCENT",
        help="margin: so much more payload, and still no step is lost; percent of the payload, or without one of what the axis "
        "moves by itself (default: 30%%)",
    )
    p.add_argument(
        "--settle",
        nargs=2,
        metavar=("WITHIN", "FOR"),
        help="arrived is who stays within WITHIN of the goal for FOR: 50um 50ms (default: a full step, of a servo 10 counts; 50ms)",
    )
    p.add_argument("--overshoot", metavar="LENGTH", help="no move goes farther beyond its goal (default: twice WITHIN)")
    p.add_argument(
        "--site", metavar="NAME", help="site or body whose place counts, as a camera on a mast (default: the axis)"
    )
    g = p.add_argument_group("search")
    g.add_argument("--by", choices=("search", "formula"), default="search", help="formula: no search, no Optuna needed")
    g.add_argument("--trials", type=int, default=200, help="registers that are tried (default: 200)")
    g.add_argument("--moves", type=int, default=48, help="moves of a proof (default: 48)")
    g.add_argument("--seed", type=int, default=0, help="the same seed gives the same registers (default: 0)")
    g.add_argument("--workers", type=int, help="threads; the result does not depend on them (default: one a processor)")
    _machine(p.add_argument_group("stage"))
    g = p.add_argument_group("output")
    g.add_argument("-o", "--output", metavar="FOLDER", help="write tuned.h, tuned.txt, tuned.json and tuned.png there")
    g.add_argument("--json", action="store_true", help="print JSON")
    g.add_argument("--force", action="store_true", help="overwrite files that exist")


BENCH = """\
examples:
  stage bench-submit formula -o formula.bench                        a player that is shipped
  stage bench-submit mine:policy -o mine.bench --split weak          function `policy` of mine.py: (observation, info) -> action
  stage bench-submit moves.npz -o moves.bench --name "by hand"       recorded actions
  stage bench-verify mine.bench                                      plays the actions again and compares bit for bit

docs/benchmark.md says what is promised, and what is not.
"""


def _add_bench(commands: Any) -> None:
    p = _command(
        commands, "bench", "bench:cards", "the tasks of the benchmark and their test episodes",
        "List the tasks of the benchmark, or show one: what is asked, splits, tracks, settings, players that are shipped.",
    )  # fmt: skip
    p.add_argument("task", nargs="?", metavar="TASK", help="for example few-shot (default: list them all)")
    p.add_argument("--json", action="store_true", help="print JSON, with the seeds of all test episodes")
    p = _command(
        commands, "bench-submit", "bench:submit", "play the test episodes of the benchmark, and pack them into a file",
        "Play the test episodes of a split with a policy and write its actions, rewards, scores and versions to a file, which "
        "anybody can replay.",
    )  # fmt: skip
    p.epilog, p.formatter_class = BENCH, argparse.RawDescriptionHelpFormatter
    p.add_argument(
        "policy", metavar="POLICY", help="module:name, actions.npz, or a player that is shipped: see `stage bench`"
    )
    p.add_argument("-o", "--output", metavar="FILE", required=True, help="of the entry")
    p.add_argument("--task", default="few-shot", help="see `stage bench` (default: few-shot)")
    p.add_argument("--split", default="train", help="where the machines of the episodes come from (default: train)")
    p.add_argument("--track", default="host", help="what the policy sees: host, truth or tools (default: host)")
    p.add_argument("--round", default="open", metavar="NAME", help="whose seeds are played (default: open)")
    p.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting that players may choose")
    p.add_argument("--name", help="of the player (default: POLICY)")
    p.add_argument(
        "--run", dest="run_number", type=int, default=0, metavar="N", help="number of the training run (default: 0)"
    )
    p.add_argument("--notes", default="", help="a line that goes with it")
    p.add_argument(
        "--cost", action="append", default=[], metavar="NAME=NUMBER", help="what it took: moves=, processor_s=, tokens="
    )
    p.add_argument("--episodes", type=int, metavar="N", help="only the first N, for a trial")
    p.add_argument("--json", action="store_true", help="print JSON")
    p.add_argument("--force", action="store_true", help="overwrite a file that exists")
    p = _command(
        commands, "bench-verify", "bench:verify", "replay an entry of the benchmark and compare it bit for bit",
        "Play the actions of an entry again, without the policy, and compare every reward, observation and score. Exit code 0 if "
        "they are equal, 1 if not, 2 if the file is refused.",
    )  # fmt: skip
    p.add_argument("file", metavar="FILE")
    p.add_argument(
        "--tolerance", type=float, metavar="T", help="rewards and scores may differ by so much, as on another processor"
    )
    p.add_argument("--json", action="store_true", help="print JSON")
    p = _command(
        commands, "bench-table", "bench:table", "compare entries of the benchmark, as tables in Markdown",
        "Print a table for each task and split: interquartile mean of the return with its interval, and who beats whom. Entries of "
        "one player are its runs. Nothing is replayed.",
    )  # fmt: skip
    p.add_argument("files", nargs="+", metavar="FILE")
    p.add_argument("--json", action="store_true", help="print JSON")


def _plot(p: argparse.ArgumentParser) -> None:
    p.add_argument("--plot", metavar="FILE.png", help="draw the move")


def _add_firmware(commands: Any) -> None:
    p = _command(
        commands, "run", "firmware:run", "firmware in C on an emulated board",
        "Run firmware (a shared library, or a C or C++ source, which is built first) against the chips: print what it notes, where "
        "the axes end, and what a reader of the data sheet would say to its writes. Exit code 0 if it returns 0 and loses no step.",
    )  # fmt: skip
    p.add_argument(
        "firmware",
        nargs="+",
        metavar="FIRMWARE",
        help="driver.so, or C or C++ sources, or a sketch (.ino); docs/firmware_in_the_loop.md",
    )
    _add_target(p)
    g = p.add_argument_group("firmware")
    g.add_argument("--cflags", default="", help='for the compiler, for example --cflags="-Ihal -DSLOW"')
    g.add_argument(
        "--platform",
        help="what the sources were written for: arduino (a .ino always is), avr, vxworks, dos, freertos; docs/porting.md",
    )
    g.add_argument(
        "--timeout", type=float, default=60.0, help="simulated seconds after which it has to return (default: 60)"
    )
    g.add_argument(
        "--patience",
        type=float,
        default=20.0,
        metavar="S",
        help="seconds of real time that it may compute without a bus cycle (default: 20)",
    )
    g.add_argument(
        "--for",
        dest="seconds",
        type=float,
        metavar="SECONDS",
        help="run it for so many simulated seconds: firmware that never returns, as a sketch",
    )
    g.add_argument(
        "--cost",
        type=float,
        default=0.0,
        metavar="S",
        help="simulated seconds that each basic block of the firmware takes, for example 50e-9 (default: computing takes no time); "
        "docs/interrupts.md",
    )
    g.add_argument(
        "--in-process",
        action="store_true",
        help="run it in this process, for debuggers (default: in a process of its own; a crash ends only that)",
    )
    g.add_argument("--isolated", action="store_true", help=argparse.SUPPRESS)  # what is the default now
    _board(p)
    _bench(p)
    _command(
        commands, "include", "firmware:include", "where pulsestage.h is",
        'Print the folder of the one header that firmware needs: cc -shared -fPIC -I"$(stage include)" driver.c -o driver.so',
    )  # fmt: skip
    p = _command(
        commands, "serve", "serve:run", "the chips behind a TCP port, for a host elsewhere",
        "Serve the bus, time and pins of a stage over TCP: a driver in another language, in a virtual machine or an emulator makes "
        "its bus cycles here; clients in Python and C come along, docs/serve.md. One host drives, others may look. Ctrl-C or "
        "SIGTERM ends it, and what --record, --vcd and --trace ask for is written.",
    )  # fmt: skip
    g = p.add_argument_group("server")
    g.add_argument(
        "--bind",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="where it listens (default: 127.0.0.1, this machine only)",
    )
    g.add_argument(
        "--listen", type=_number, default=7240, metavar="PORT", help="TCP port; 0: one that is free (default: 7240)"
    )
    g.add_argument(
        "--fresh",
        action="store_true",
        help="each host begins at the start (default: where the one before has left the stage)",
    )
    _board(p)
    _bench(p)
    _add_panel(commands)


def _add_panel(commands: Any) -> None:
    p = _command(
        commands, "panel", "panel:run", "a live stage in a browser",
        "Serve a page on which the stage moves in real time and each chip has a front panel: registers, commands, pins, the bus. "
        "This machine only, unless --host says otherwise. Ctrl-C ends it.",
    )  # fmt: skip
    p.add_argument("model", nargs="?", default="xyz", help="a shipped model or a file.xml (default: xyz)")
    g = p.add_argument_group("page")
    g.add_argument("--port", type=_number, default=7241, help="TCP port; 0: one that is free (default: 7241)")
    g.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="where it listens; another than 127.0.0.1 lets in whoever has the link with its token (default: 127.0.0.1)",
    )
    g.add_argument("--no-browser", action="store_true", help="print the link, and open no browser")
    g.add_argument("--speed", type=float, default=1.0, help="simulated seconds a second, 0.001 to 1000 (default: 1)")
    g.add_argument("--paused", action="store_true", help="begin with time standing still")
    g = p.add_argument_group("stage")
    _machine(g)
    p.set_defaults(encoder=[])


def _board(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("board")
    g.add_argument(
        "--layout",
        help="which ports reach the chips: pcl240, pcl240-card, nova, nova-8bit, hctl1100, or a file of your own, card.toml "
        "(default: the chip's); docs/layouts.md",
    )
    g.add_argument(
        "--base", type=_number, help="first port of the first chip, for example 0x300 (default: the layout's)"
    )
    g.add_argument("--stride", type=_number, help="ports from one chip to the next (default: the layout's)")
    g.add_argument(
        "--clock", type=_number, metavar="HZ", help="reference clock of the chips, Hz (default: the data sheet's)"
    )
    g.add_argument("--trace", metavar="FILE.txt", help="write the bus cycles in words; - prints them")
    g.add_argument("--keep", type=int, default=1_000_000, help="lines of bus cycles that are kept (default: 1,000,000)")
    g.add_argument(
        "--device",
        action="append",
        default=[],
        metavar="KIND:PORT",
        help="another device on the bus: hctl2000, hctl2016, hctl2020, ls7166 with the axis that it counts, hctl2016:0x320:x, and "
        "counts a turn of the motor if not 2000, ls7166:0x330:y:4000; uart:0x3F8; latch:0x378; one of your own in C, adc.c:0x340+2 "
        "(2 ports)",
    )
    g.add_argument(
        "--encoder",
        action="append",
        default=[],
        metavar="AXIS=COUNTS",
        help="an encoder that the chip's counter of the real position counts (RP, EP of NOVA's): counts a metre (rad on a hinge), "
        "for example x=200000, or a turn of the motor, x=2000/turn",
    )
    g.add_argument(
        "--place",
        action="append",
        default=[],
        metavar="AXIS=MM",
        help="where a carriage starts, mm (mrad on a hinge), for example x=62",
    )


def _add_target(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("programs of another processor (docs/targets.md)")
    g.add_argument("--mcu", help="the processor: atmega2560 and other AVRs, cortex-m3, 8086")
    g.add_argument(
        "--map",
        action="append",
        default=[],
        help="memory-mapped registers, with or without --mcu: 0x40021000=0x300+0x40 has 40h ports, from 300h on, at 40021000h "
        "(docs/memory_mapped.md); of an AVR its pins: data=A,address=C:0-1,cs=B0,wr=G0,rd=G1,irq=D0",
    )
    g.add_argument("--mcu-clock", type=float, metavar="HZ", help="its clock, for example 16e6 (default: what is usual)")
    g.add_argument("--gdb", type=_number, metavar="PORT", help="wait for GDB on 127.0.0.1")


def _number(text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number, as 0x300 or 768") from None


def _add_fault(commands: Any) -> None:
    p = _command(
        commands, "fault", "fault:run", "something breaks: a switch, a wire, the supply, the bus",
        "Run a program on a healthy stage and on a faulty one and print what differs. Without a name: list the faults. "
        "Recordings are of the faulty run. Exit code 0 if what was claimed happened.",
    )  # fmt: skip
    p.add_argument("name", nargs="?", metavar="NAME", help="for example jam (default: list them all)")
    _plot(p)
    _bench(p)


def _add_erratum(commands: Any) -> None:
    p = _command(
        commands, "erratum", "erratum:run", "the S-curve failure of MCX304, MCX302 and MCX312, and a work-around",
        "A decelerating stop is asked for at the end of an S-curve move: with the bare command 26h the chip makes pulses for ever "
        "and the carriage meets the hard stop; with a work-around of NOVA's notice it ends on its target. "
        "Files of the second run have '-work-around' in their names. Exit code 0 if it is as claimed.",
    )  # fmt: skip
    p.add_argument("--mended", action="store_true", help="chips without the failure (errata=False)")
    _plot(p)
    _bench(p, ("MCX304", "MCX302", "MCX312"))


def _add_tools(commands: Any) -> None:
    _command(
        commands, "chips", "tools:chips", "the chips that there are",
        "List every chip: PulseStage's own, and those that installed packages bring (docs/your_own_chip.md).",
    )  # fmt: skip
    p = _command(
        commands, "registers", "tools:registers", "the register map of a chip",
        "Print a chip's registers, commands and status bits with the evidence for each.",
    )  # fmt: skip
    p.add_argument("chip", metavar="CHIP", help="for example pcl240k")
    p = _command(
        commands, "pullout", "tools:pullout", "pull-out torque of a motor and drive over speed",
        "Measure at which torque the motor slips, beside the closed form of an ideal drive.",
    )  # fmt: skip
    p.add_argument("--motor", default="17HS4401")
    p.add_argument("--bus-voltage", type=float, default=24.0, help="V (default: 24)")
    p.add_argument("--microsteps", type=int, default=16)
    p.add_argument("--plot", metavar="FILE.png", help="draw the curve")
    p.add_argument("--force", action="store_true", help="overwrite files that exist")
    p = _command(
        commands, "view", "tools:view", "look at a model in the MuJoCo viewer",
        "Open a model in MuJoCo's viewer (needs a screen), or print its axes.",
    )  # fmt: skip
    p.add_argument("model", nargs="?", default="xyz")
    p.add_argument("--text", action="store_true", help="print axes, travel and switches instead")
