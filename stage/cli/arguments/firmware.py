"""run, include, serve, panel."""

from __future__ import annotations

import argparse
from typing import Any

from stage.cli.arguments.options import command, machine, model_help, number, port, stage_and_outputs
from stage.cli.quantities import FREQUENCY, HERTZ, TIME


def add(commands: Any) -> None:
    """These commands."""
    p = command(
        commands, "run", "firmware:run", "firmware in C on an emulated board",
        "Run firmware (a shared library, or a C or C++ source, which is built first) against the chips: print what it notes, where "
        "the axes end, and what a reader of the data sheet would say to its writes. Exit code 0 if it returns 0 and loses no step.",
        ("stage run driver.c --chips pcl240mk", "built, and run against the chips"),
        ("stage run driver.c --trace - --vcd bus.vcd", "bus cycles in words, and as waveforms"),
        ("stage run mill.ino --for 2 --chips hctl1100", "an Arduino sketch, for 2 simulated seconds"),
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
        "--timeout", type=TIME, default=60.0, help="simulated seconds after which it has to return (default: 60)"
    )
    g.add_argument(
        "--patience",
        type=TIME,
        default=20.0,
        metavar="S",
        help="seconds of real time that it may compute without a bus cycle (default: 20)",
    )
    g.add_argument(
        "--for",
        dest="seconds",
        type=TIME,
        metavar="SECONDS",
        help="run it for so many simulated seconds: firmware that never returns, as a sketch",
    )
    g.add_argument(
        "--cost",
        type=TIME,
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
    _beside(p)
    stage_and_outputs(p)
    command(
        commands, "include", "firmware:include", "where pulsestage.h is",
        'Print the folder of the one header that firmware needs: cc -shared -fPIC -I"$(stage include)" driver.c -o driver.so',
        ("stage include", "the folder"),
    )  # fmt: skip
    p = command(
        commands, "serve", "serve:run", "the chips behind a TCP port, for a host elsewhere",
        "Serve the bus, time and pins of a stage over TCP: a driver in another language, in a virtual machine or an emulator makes "
        "its bus cycles here; clients in Python and C come along, docs/serve.md. One host drives, others may look. Ctrl-C or "
        "SIGTERM ends it, and what --record, --vcd and --trace ask for is written.",
        ("stage serve --chips mcx304", "the chips behind 127.0.0.1:7240"),
        ("stage serve --listen 0 --fresh --trace bus.txt", "a free port, a stage from the start for each host"),
        json=False,
    )  # fmt: skip
    g = p.add_argument_group("server")
    g.add_argument(
        "--bind",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="where it listens (default: 127.0.0.1, this machine only)",
    )
    g.add_argument(
        "--listen", type=port, default=7240, metavar="PORT", help="TCP port; 0: one that is free (default: 7240)"
    )
    g.add_argument(
        "--fresh",
        action="store_true",
        help="each host begins at the start (default: where the one before has left the stage)",
    )
    _board(p)
    _beside(p)
    stage_and_outputs(p)
    _add_panel(commands)


def _beside(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("panel")
    g.add_argument(
        "--panel", action="store_true",
        help="a live page beside it, in real time; it begins when somebody looks, and the page lives on at the end; docs/panel.md",
    )  # fmt: skip
    g.add_argument("--panel-port", type=port, default=7241, help="TCP port; 0: one that is free (default: 7241)")
    g.add_argument("--no-browser", action="store_true", help="print the link, and open no browser")
    g.add_argument("--speed", type=float, default=1.0, help="simulated seconds a second, 0.001 to 1000 (default: 1)")


def _add_panel(commands: Any) -> None:
    p = command(
        commands, "panel", "panel:run", "a live stage in a browser",
        "Serve a page on which the stage moves in real time and each chip has a front panel: registers, commands, pins, the bus. "
        "This machine only, unless --host says otherwise. Ctrl-C ends it.",
        ("stage panel xy", "a live stage in a browser"),
        ("stage panel my.xml --chips mcx514 --no-browser", "your own axes; the link is printed"),
        json=False,
    )  # fmt: skip
    p.add_argument("model", nargs="?", default="xyz", help=model_help())
    g = p.add_argument_group("page")
    g.add_argument("--port", type=port, default=7241, help="TCP port; 0: one that is free (default: 7241)")
    g.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="where it listens; another than 127.0.0.1 lets in whoever has the link with its token (default: 127.0.0.1)",
    )
    g.add_argument("--no-browser", action="store_true", help="print the link, and open no browser")
    g.add_argument("--speed", type=float, default=1.0, help="simulated seconds a second, 0.001 to 1000 (default: 1)")
    g.add_argument("--paused", action="store_true", help="begin with time standing still")
    g.add_argument(
        "--open",
        metavar="FILE",
        help="go on from what the page's menu has saved; MODEL and the options of the stage are those of the file",
    )
    g = p.add_argument_group("stage")
    machine(g)
    p.set_defaults(encoder=[])


def _board(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("board")
    g.add_argument(
        "--layout",
        help="which ports reach the chips: pcl240, pcl240-card, nova, nova-8bit, hctl1100, or a file of your own, card.toml "
        "(default: the chip's); docs/layouts.md",
    )
    g.add_argument(
        "--base", type=number, help="first port of the first chip, for example 0x300 (default: the layout's)"
    )
    g.add_argument("--stride", type=number, help="ports from one chip to the next (default: the layout's)")
    g.add_argument(
        "--clock", type=HERTZ, metavar="HZ", help="reference clock of the chips, Hz (default: the data sheet's)"
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
        metavar="AXIS=PLACE",
        help="where a carriage starts, for example x=62mm; without a unit mm, degrees on a hinge",
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
    g.add_argument(
        "--mcu-clock", type=FREQUENCY, metavar="HZ", help="its clock, for example 16e6 (default: what is usual)"
    )
    g.add_argument("--gdb", type=number, metavar="PORT", help="wait for GDB on 127.0.0.1")
