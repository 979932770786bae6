"""`stage fault`: one thing breaks, and the same program runs on a healthy stage and on a faulty one.

A demonstration is a program with a fault in it (programs.py), the figures that it measures, and what was claimed of them
(demos.py). `show` serves the command, the tests and docs/faults.md.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from typing import Any

from stage.cli.facts import tell
from stage.cli.fault.demo import Claim, Demo, Figures, Record, Shown, Strike
from stage.cli.fault.demos import DEMOS
from stage.cli.fault.programs import first_axis
from stage.cli.files import kept, outputs, plot
from stage.cli.progress import note
from stage.cli.setup import make_stage
from stage.errors import unknown

__all__ = ["DEMOS", "EVERY", "Claim", "Demo", "Figures", "Record", "Shown", "Strike", "run", "show"]

EVERY = 2.5e-4  # s between the samples of a picture


def run(args: argparse.Namespace) -> int:
    """List the faults, or show one; exit code 0 if what was claimed happened."""
    if args.name is None:
        tell(args, {name: demo.claim for name, demo in DEMOS.items()})
        width = max(map(len, DEMOS)) + 2
        print("\n".join(f"{name:{width}}{demo.claim}" for name, demo in DEMOS.items()))
        return 0
    _key(args.name)
    outputs(args)
    shown = show(args.name, partial(make_stage, args), partial(kept, args, every=EVERY), args.plot is not None)
    print(f"{shown.name}: {shown.demo.claim}\n\n{shown.table()}\n\nHow a host can tell: {shown.demo.notice}")
    healthy, faulty = shown.figures
    facts = {
        "fault": shown.name,
        "claim": shown.demo.claim,
        "notice": shown.demo.notice,
        "as_claimed": shown.as_claimed,
        "unit": shown.unit,
    }
    tell(args, facts | {"healthy": healthy, "faulty": faulty})
    plot(args, shown.plot)
    print("happened as claimed" if shown.as_claimed else "did NOT happen as claimed")
    return 0 if shown.as_claimed else 1


def _key(name: str) -> str:
    """The demonstration's name as DEMOS has it. Raises ArgumentError with near misses."""
    key = name.lower().replace("_", "-")
    if key not in DEMOS:
        raise unknown("fault", name, DEMOS)
    return key


def show(name: str, make: Callable[[], Any], record: Record | None = None, record_both: bool = False) -> Shown:
    """Run a demonstration on two stages that `make()` makes, the healthy one first.

    record(stage): context manager of the faulty run's recording, or None; record_both: the healthy run's is kept as well.
    Raises ArgumentError for an unknown name, with the near misses; StageError where the stage cannot show it, with the reason.
    """
    from stage.firmware.driver import driver_of

    key = _key(name)
    stage = make()
    demo = DEMOS[key].of(driver_of(first_axis(stage)).has_position_loop)
    note(f"{key}: the healthy run ...")
    with stage.record(EVERY) if record_both else nullcontext() as healthy_record:
        healthy = demo.program(stage, lambda *_: nullcontext())
    stage = make()
    note(f"{key}: the faulty run ...")
    with record(stage) if record else nullcontext() as faulty_record:
        faulty = demo.program(stage, lambda fault, *args: fault(*args))
    axis = first_axis(stage)
    turn = 2 * math.pi / abs(axis.gear)
    return Shown(key, demo, (healthy, faulty), (healthy_record, faulty_record), axis.unit, turn)
