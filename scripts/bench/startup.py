"""Starting, each time a fresh process: import, first compile with an empty cache, the first step of a second start."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator

from bench.figures import Figure, Run
from bench.machines import model_path
from bench.timing import nothing, race, timed

TITLE = "Start, each in a fresh process"
BARE = f"import mujoco; m = mujoco.MjModel.from_xml_path({model_path()!r}); mujoco.mj_step(m, mujoco.MjData(m))"
FIRST_STEP = "from stage import Stage; Stage('xyz').step()"


def measure(run: Run) -> Iterator[Figure]:
    works = {
        "python": "pass",
        "import": "import stage",
        "bare": BARE,
        "warm": FIRST_STEP,
    }
    t = race({name: (nothing, lambda c=code: start(c)) for name, code in works.items()}, run.pick(run.rounds, 3), 1)
    yield Figure.of("startup.python", "python itself", "s", t["python"])
    yield Figure.of("startup.import", "python -c 'import stage'", "s", t["import"])
    yield Figure.of("startup.bare", "import mujoco, load the model, one mj_step", "s", t["bare"])
    yield Figure.of("startup.warm", "warm start: import stage, Stage('xyz'), one step", "s", t["warm"])
    yield Figure.of("startup.warm_bare", "  beside the bare one", "ratio", t["warm"] / t["bare"])
    if run.quick:
        print("    left out (quick): first compile")
        return
    seconds = [compiled_first() for _ in range(2)]
    yield Figure.of("startup.compile", "first start, which compiles: the same with an empty cache", "s", seconds)


def start(code: str, **environment: str) -> None:
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, env={**os.environ, **environment})


def compiled_first() -> float:
    """Seconds of a first start on a machine, with nothing compiled before."""
    with tempfile.TemporaryDirectory() as folder:
        return timed(lambda: start(FIRST_STEP, NUMBA_CACHE_DIR=folder))
