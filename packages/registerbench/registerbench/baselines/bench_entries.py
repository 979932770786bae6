"""Entries of learners and of the oracle, in a folder, each under the name TASK-SPLIT-METHOD-RUN.bench."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import registerbench


def write_entry(policy: Any, task: str, split: str, folder: Path, method: str, run: int, **settings: Any) -> None:
    """Play the test episodes of a split, write the entry, and print its scores.

    Args:
        policy: Policy or player, as `registerbench.play` takes it.
        task: Name of a card.
        split: Split of the machines.
        folder: Folder of the file.
        method: Name of the method, a part of the file name.
        run: Number of the training run.
        **settings: Other arguments of `registerbench.play`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    entry = registerbench.play(policy, task, split, run=run, **settings)
    entry.write(folder / f"{task}-{split}-{method}-{run}.bench", overwrite=True)
    print(f"{task} {split} {entry.player} {run}: return {entry.scores['return'].mean():.3f}", flush=True)
