"""The command `stage export`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Container
from pathlib import Path
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts, report_written_file


def add_subcommand(commands: Any) -> None:
    """Add `stage export` to argparse's subparsers."""
    p = add_command(
        commands, "export", run, "write a recording as CSV, Parquet or NumPy columns",
        "Write the columns of a recording (.rrd) as a table in SI units, one row per sample. Without -o, list the columns. "
        "docs/recording.md says how exact they are.",
        ("stage export demo.rrd", "list the columns"),
        ("stage export demo.rrd -o demo.csv", "write all columns"),
        ("stage export demo.rrd -o demo.parquet --columns x/position,x/rate", "write two columns and the time"),
    )  # fmt: skip
    p.add_argument("file", metavar="FILE.rrd", help="recording that --record or Recording.save has written")
    p.add_argument("-o", "--output", metavar="FILE", help="file to write; its ending is .csv, .parquet or .npz")
    p.add_argument(
        "--columns", metavar="NAME,...", help="columns to write, for example x/position,x/rate (default: all)"
    )
    options.add_force_option(p)


def run(args: argparse.Namespace) -> int:
    """Write the columns of a recording to a file, or list them."""
    from stage.recording import read
    from stage.recording.column_files import find_writer_name
    from stage.support.files import FileError, check_writable

    if args.output is not None:
        if os.path.realpath(args.output) == os.path.realpath(args.file):
            raise FileError(f"-o {args.output}: this is the recording itself. Name another file.")
        find_writer_name(args.output)
        check_writable(args.output, args.force, overwrite_hint="give --force")
    saved = read(args.file)
    add_facts(args, model=saved.model, axes=saved.axes, samples=len(saved), every=saved.every, columns=saved.units)
    if args.output is None:
        print(f"{saved.path}: {saved.model}, {len(saved)} samples, {saved.every * 1e3:g} ms apart")
        for name, axis in saved.axes.items():
            print(f"  axis {name}: {axis}")
        for name, unit in saved.units.items():
            print(f"  {name:24} {unit}".rstrip())
        return 0
    names = None if args.columns is None else split_columns(args.columns, saved.units)
    saved.to_file(args.output, names, overwrite=args.force)
    columns = len(saved.units) if names is None else len({"time", *names})
    size = Path(args.output).stat().st_size / 1e6
    report_written_file(args, args.output, f"{len(saved)} samples of {columns} columns, {size:.1f} MB")
    return 0


def split_columns(text: str, known: Container[str]) -> list[str]:
    """Split a list of columns at its commas, except commas within a known column: the axis `a,b` has the column `a,b/position`."""
    parts, names = text.split(","), list[str]()
    while parts:
        joined = ((",".join(parts[:n]).strip(), n) for n in range(len(parts), 0, -1))
        name, n = next((found for found in joined if found[0] in known), (parts[0].strip(), 1))
        names.append(name)
        del parts[:n]
    return names
