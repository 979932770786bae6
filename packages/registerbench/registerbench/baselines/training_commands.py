"""Training commands of entries: each trains one run from its seed, plays a split, and writes the entry of that run again.

The learners write such a command into their entries (`Entry.training`), so `stage bench-table --spot-check` can train a run again
and compare its actions. Every learner has the command:

python -m registerbench.baselines.few_shot_learners enter sac --steps 4096 --split weak --run 3 -o again.bench
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from registerbench.benchmark_tasks import OPEN_ROUND
from stage.errors import ArgumentError


def format_training_command(module: str, method: str, options: Mapping[str, Any]) -> str:
    """Format the training command of a learner's entries.

    Args:
        module: Name of the learner's module in this package.
        method: Name of the method.
        options: Options that the run depends on, such as its steps, by name.

    Returns:
        A command with {task}, {split}, {round}, {run} and {out} in place of their values.
    """
    words = " ".join(f"--{name} {value}" for name, value in options.items())
    places = "--task {task} --split {split} --round {round} --run {run} -o {out}"
    return f"python -m registerbench.baselines.{module} enter {method} {words} {places}"


def add_enter_command(commands: Any, methods: list[str], tasks: list[str]) -> argparse.ArgumentParser:
    """Add the command `enter METHOD`, with the options that all learners share, to the parser of a learner.

    Args:
        commands: Commands of the parser.
        methods: Names of the methods.
        tasks: Names of the cards that the learner can play.

    Returns:
        The parser of the command, to which a learner adds its options and the function `run`.
    """
    p = commands.add_parser("enter", help="train a run and write its entry: the training command of entries")
    p.add_argument("method", choices=methods)
    p.add_argument("--task", choices=tasks, default=tasks[0])
    p.add_argument("--split", default="train")
    p.add_argument("--round", default=OPEN_ROUND, metavar="WORD", help="whose test episodes (default: the open ones)")
    p.add_argument("--run", dest="run_number", type=int, default=0, metavar="N", help="the seed of the run")
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FILE.bench")
    return p


def write_new_entry(train_and_submit: Callable[[Path], None], out: Path) -> None:
    """Train a run in an empty folder, and write its only entry to a file.

    Args:
        train_and_submit: Function that trains the run and submits it, both in the folder that is its argument.
        out: File of the entry.

    Raises:
        ArgumentError: The run did not write exactly one entry.
    """
    with tempfile.TemporaryDirectory() as folder:
        train_and_submit(Path(folder))
        entries = list(Path(folder).glob("*.bench"))
        if len(entries) != 1:
            raise ArgumentError(f"the run wrote {len(entries)} entries in place of one: does the task have this split?")
        out.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(entries[0], out)
