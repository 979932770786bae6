"""The command `stage export`: the columns of a recording as a table."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from stage.cli.facts import tell, wrote


def run(args: argparse.Namespace) -> int:
    """Write them, or list them."""
    from stage.files import FileError, writable
    from stage.recording import read
    from stage.recording.table import writer_of

    if args.output is not None:
        if os.path.realpath(args.output) == os.path.realpath(args.file):
            raise FileError(f"-o {args.output}: that is the recording itself. Name another file.")
        writer_of(args.output)
        writable(args.output, args.force, ask="give --force")
    saved = read(args.file)
    tell(args, model=saved.model, axes=saved.axes, samples=len(saved), every=saved.every, columns=saved.units)
    if args.output is None:
        print(f"{saved.path}: {saved.model}, {len(saved)} samples, {saved.every * 1e3:g} ms apart")
        for name, axis in saved.axes.items():
            print(f"  axis {name}: {axis}")
        for name, unit in saved.units.items():
            print(f"  {name:24} {unit}".rstrip())
        return 0
    names = None if args.columns is None else [name.strip() for name in args.columns.split(",")]
    saved.to_file(args.output, names, overwrite=args.force)
    count = len(saved.units) if names is None else len({"time", *names})
    size = Path(args.output).stat().st_size / 1e6
    wrote(args, args.output, f"{len(saved)} samples of {count} columns, {size:.1f} MB")
    return 0
