"""export, example."""

from __future__ import annotations

from typing import Any

from stage.cli.arguments.options import command


def add(commands: Any) -> None:
    """These commands."""
    p = command(
        commands, "export", "export:run", "a recording as CSV, Parquet or NumPy columns",
        "Read the columns of a recording (.rrd) back and write them as a table, a row a sample, in SI units: docs/recording.md "
        "says how exactly a recording keeps them. Without -o: list them.",
        ("stage export demo.rrd", "what columns there are"),
        ("stage export demo.rrd -o demo.csv", "all of them"),
        ("stage export demo.rrd -o demo.parquet --columns x/position,x/rate", "some of them"),
    )  # fmt: skip
    p.add_argument("file", metavar="FILE.rrd", help="a recording, of --record or Recording.save")
    p.add_argument("-o", "--output", metavar="FILE", help="a name that ends in .csv, .parquet or .npz")
    p.add_argument("--columns", metavar="NAME,...", help="only these, for example x/position,x/rate (default: all)")
    p.add_argument("--force", action="store_true", help="overwrite a file that exists")
    p = command(
        commands, "example", "example:run", "a copy of an example: programs, drivers, chips, notebooks",
        "Copy one of the examples that the pages speak of into a folder. Without a name: list them.",
        ("stage example", "what there is"),
        ("stage example home_and_move", "home_and_move.py, here"),
        ("stage example drivers --to ~/firmware", "drivers in C, C++, Rust and Zig"),
    )  # fmt: skip
    p.add_argument("name", nargs="?", metavar="NAME", help="for example stall (default: list them)")
    p.add_argument("--to", default=".", metavar="FOLDER", help="where to (default: here)")
    p.add_argument("--force", action="store_true", help="overwrite files that exist")
