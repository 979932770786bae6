"""Comparison of compiled code with plain Python.

`python -m stage.testing.uncompiled_comparison` runs the programs in a separate process without compilation.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import import_module
from typing import Any

from stage.chips import Chip
from stage.support.subprocesses import ENCODING, ERRORS
from stage.testing.chip_actions import perform_act
from stage.testing.promise_trial import PromiseTrial


def compare_with_plain_python(
    chip_class: type[Chip], options: dict[str, Any], seed: int, programs: int, limit: float | None = None
) -> str:
    """Compare the answers and states of compiled code with those of plain Python.

    Args:
        chip_class: Class of the chip.
        options: Arguments of the chip's constructor.
        seed: Seed of the programs.
        programs: Number of programs.
        limit: Real time for the plain Python, s; None: no limit.

    Returns:
        The first difference in words; "" if there is none.
    """
    compiled = run_programs(chip_class, options, seed, programs)
    job = json.dumps([chip_class.__module__, chip_class.__qualname__, options, seed, programs, sys.path])
    try:
        done = subprocess.run(
            [sys.executable, "-m", "stage.testing.uncompiled_comparison"], input=job, capture_output=True, encoding=ENCODING,
            errors=ERRORS, env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, timeout=limit,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"as plain Python it has not ended after {limit:g} s"
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no word"]
        places = [line.strip() for line in lines if line.startswith("  File ")]
        return f"as plain Python it fails: {lines[-1]}" + (f" ({places[-1]})" if places else "")
    for k, (one, other) in enumerate(zip(compiled, json.loads(done.stdout.splitlines()[-1]), strict=True)):
        if one != other:
            n = next((n for n in range(len(one)) if one[n] != other[n]), 0)
            return f"in program {k}, act {n}, compiled code leaves {one[n]}, and plain Python {other[n]}"
    return ""


def run_programs(chip_class: type[Chip], options: dict[str, Any], seed: int, programs: int) -> list[list[str]]:
    """Return, for each program, the chip's answer and state after each act."""
    trial = PromiseTrial(chip_class, lambda: chip_class(**options), seed, programs)
    found = []
    for rng in trial.make_seeded_generators():
        chip, answers = trial.make(), []
        for act in trial.draw_program(rng):
            answer = perform_act(chip, act)
            answers.append(f"{act.kind} {answer} {chip.state.tobytes().hex()}")
        found.append(answers)
    return found


def main() -> None:
    """Read a job that `compare_with_plain_python` has written, and print the result of `run_programs`."""
    module, name, options, seed, programs, path = json.load(sys.stdin)
    sys.path[:] = path
    kind: Any = import_module(module)
    for part in name.split("."):
        kind = getattr(kind, part)
    print(json.dumps(run_programs(kind, options, seed, programs)))


if __name__ == "__main__":
    main()
