"""Benchmark of starting in a fresh process: import, a first step compared with MuJoCo's own, and building the native library."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil

from bench.figures import Figure, Run
from bench.machines import find_model_path
from bench.timing import do_nothing, measure_alternately

TITLE = "Start, each in a fresh process"
BARE = f"import mujoco; m = mujoco.MjModel.from_xml_path({find_model_path()!r}); mujoco.mj_step(m, mujoco.MjData(m))"
FIRST_STEP = "from stage import Stage; Stage('xyz').step()"
ROOT = Path(__file__).resolve().parents[2]


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    works = {"python": "pass", "import": "import stage", "bare": BARE, "warm": FIRST_STEP}
    t = measure_alternately(
        {name: (do_nothing, lambda c=code: run_python(c)) for name, code in works.items()}, run.choose(run.rounds, 3), 3
    )
    yield Figure.of("startup.python", "python itself", "s", t["python"])
    yield Figure.of("startup.import", "python -c 'import stage'", "s", t["import"])
    yield Figure.of("startup.bare", "import mujoco, load the model, one mj_step", "s", t["bare"])
    yield Figure.of("startup.warm", "import stage, Stage('xyz'), one step", "s", t["warm"])
    yield Figure.of("startup.warm_bare", "  beside the bare one", "ratio", t["warm"] / t["bare"])
    if run.quick:
        print("    left out (quick): building the library")
        return
    yield Figure.of("startup.build", "building the native library, processor time", "s", measure_build())


def run_python(code: str) -> None:
    """Run code in a new process from bytecode, as an installed package runs; the first such process writes the bytecode."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, env=environment)


def measure_build() -> float:
    """Measure the processor time that building the library of a fresh checkout takes, s."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("stage", "envs", "models"):
            shutil.copytree(ROOT / name, Path(folder, name), ignore=shutil.ignore_patterns("__pycache__", "_native.so"))
        shutil.copy(ROOT / "pyproject.toml", folder)
        before = psutil.Process().cpu_times()
        command = [sys.executable, "-m", "stage.native"]
        subprocess.run(command, check=True, capture_output=True, cwd=folder, env={**os.environ, "PYTHONPATH": folder})
        after = psutil.Process().cpu_times()
        return after.children_user + after.children_system - before.children_user - before.children_system
