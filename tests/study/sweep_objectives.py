"""Artificial objectives, for worker processes to import. Each evaluation leaves a line "id pid" in options["log"]."""

import math
import os
import signal
import time

import numpy as np


def _note(trial):
    if "log" in trial.options:
        with open(trial.options["log"], "ab", buffering=0) as log:
            log.write(b"%d %d\n" % (trial.id, os.getpid()))


def valley(trial):
    """Cheap, with a sleep; uses the registers and the seed."""
    _note(trial)
    time.sleep(trial.options.get("sleep", 0.02))
    noise = np.random.default_rng(trial.seed).normal()
    return {"score": math.sin(trial.registers["R2"]) + noise, "twice": 2 * trial.registers["R4"]}


def raises_at_five(trial):
    if trial.id == 5:
        _note(trial)
        raise ValueError(f"R4 = {trial.registers['R4']} is not to my taste")
    return valley(trial)


def exits_at_five(trial):
    if trial.id == 5:
        raise SystemExit("enough")
    return valley(trial)


def kills_its_worker_at_five(trial):
    if trial.id == 5:
        _note(trial)
        os.kill(os.getpid(), signal.SIGKILL)
    return valley(trial)


def fails_at_first(trial):
    """Like a flaky license server: the first call of each trial raises."""
    with open(trial.options["log"], "a+") as log:
        log.seek(0)
        seen = f"{trial.id}\n" in log.readlines()
        log.write(f"{trial.id}\n")
    if not seen:
        raise OSError("try again")
    return {"score": trial.id}


def columns_vary(trial):
    """No column at first, whole numbers, then fractions, then a column more."""
    if trial.id < 2:
        raise ValueError("nothing yet")
    return {"score": trial.id if trial.id < 4 else trial.id + 0.5} | ({"late": trial.id} if trial.id > 5 else {})


def measures_nonsense(trial):
    name = trial.options["name"]
    return {"nothing": None, "words": {"a": "ten"}, "register": {"R2": 1}, "own": {"id": 1}, "huge": {"a": 2**64}}[name]


not_a_function = 5
