"""The command `stage new-model`."""

from __future__ import annotations

import argparse
import shlex
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts, report_written_file


def add_subcommand(commands: Any) -> None:
    """Add `stage new-model` to argparse's subparsers."""
    p = add_command(
        commands, "new-model", run, "write a commented MJCF of your own axes to start from",
        "Write an MJCF that follows the naming contract (docs/models.md): screws and rotary tables with limit switches, hard stops "
        "and motors. Each axis carries the next one. Change the numbers as you need.",
        ("stage new-model --axes x:slide:300mm -o my.xml", "write a model of one axis"),
        ("stage new-model --axes x:slide:300mm,z:slide:80mm,a:hinge:360deg -o my.xml", "write three axes"),
        ("stage home --model my.xml", "home its axes"),
    )  # fmt: skip
    p.add_argument(
        "--axes", default="x:slide:300mm,y:slide:200mm", metavar="NAME:KIND:TRAVEL,...",
        help="x:slide:300mm, or a:hinge:90deg, with the travel between the end limits; 360deg turns endlessly (default: "
        "x:slide:300mm,y:slide:200mm)",
    )  # fmt: skip
    p.add_argument("-o", "--output", metavar="FILE.xml", help="file to write; - prints the model (default: -)")
    options.add_force_option(p)


def run(args: argparse.Namespace) -> int:
    """Write a new model to a file, or print it."""
    from stage.sim import plant
    from stage.sim.plant.new_model import NewAxis, build_model_text
    from stage.support.files import MODEL, check_ending, check_writable, write_atomically

    text = build_model_text([NewAxis.parse(item) for item in args.axes.split(",")])
    if args.output in (None, "-"):
        add_facts(args, mjcf=text)
        print(text, end="")
        return 0
    check_ending(args.output, *MODEL)
    check_writable(args.output, args.force, overwrite_hint="give --force")
    with write_atomically(args.output, args.force) as part:
        part.write_text(text, encoding="utf-8")
    model = plant.open_spec(args.output).compile()
    add_facts(args, axes=[a.name for a in plant.bind_axes(model)])
    print(plant.format_axes(model))
    name = shlex.quote(args.output)
    report_written_file(
        args, args.output, f"written. `stage home --model {name}` homes it, `stage view {name}` shows it."
    )
    return 0
