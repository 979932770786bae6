"""fault, erratum."""

from __future__ import annotations

from typing import Any

from stage.cli.arguments.options import command, plot, stage_and_outputs


def add(commands: Any) -> None:
    """These commands."""
    _add_fault(commands)
    _add_erratum(commands)


def _add_fault(commands: Any) -> None:
    p = command(
        commands, "fault", "fault:run", "something breaks: a switch, a wire, the supply, the bus",
        "Run a program on a healthy stage and on a faulty one and print what differs. Without a name: list the faults. "
        "Recordings are of the faulty run. Exit code 0 if what was claimed happened.",
        ("stage fault", "what can break"),
        ("stage fault jam --plot jam.png", "a healthy axis beside one that jams"),
        ("stage fault bounce --chips mcx514 --record bounce.rrd", "a switch that bounces; the faulty run is recorded"),
    )  # fmt: skip
    p.add_argument("name", nargs="?", metavar="NAME", help="for example jam (default: list them all)")
    plot(p)
    stage_and_outputs(p)


def _add_erratum(commands: Any) -> None:
    p = command(
        commands, "erratum", "erratum:run", "the S-curve failure of MCX304, MCX302 and MCX312, and a work-around",
        "A decelerating stop is asked for at the end of an S-curve move: with the bare command 26h the chip makes pulses for ever "
        "and the carriage meets the hard stop; with a work-around of NOVA's notice it ends on its target. "
        "Files of the second run have '-work-around' in their names. Exit code 0 if it is as claimed.",
        ("stage erratum --plot erratum.png", "both runs, drawn"),
        ("stage erratum --mended", "chips without the failure"),
    )  # fmt: skip
    p.add_argument("--mended", action="store_true", help="chips without the failure (errata=False)")
    plot(p)
    stage_and_outputs(p, ("MCX304", "MCX302", "MCX312"))
